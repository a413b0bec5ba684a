//! `boresight export`: a calibrated camera in the format of another program.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use boresight::exchange::{self, Exported, Format, LIMIT_PX, Places, Subject};
use boresight::provenance::Provenance;
use clap::Args;
use serde::Serialize;

use super::map::read_calibration;
use super::options::heading;
use super::{Answer, output};

/// Arguments of `export`.
#[derive(Debug, Args)]
#[command(next_help_heading = heading::OUTPUT)]
pub(crate) struct ExportArgs {
    /// A calibration: calibrate.json, as `boresight calibrate … -o DIR` writes it
    #[arg(value_name = "CALIBRATION", help_heading = None)]
    calibration: PathBuf,
    /// opencv, ros, mrcal, tetra3 (and cedar-solve), tetra3rs; sip or tpv for one FITS header a frame
    #[arg(long, value_name = "FORMAT")]
    to: Format,
    /// The file to write, or a folder; for sip and tpv it is a folder
    #[arg(short, long, value_name = "FILE|DIR")]
    output: PathBuf,
    /// What sip and tpv map the pixels to: places of the catalogue (ICRS, at the frame's epoch; aberration and refraction are in the map), or the
    /// directions of the light as it arrives (apparent), which hold the camera alone
    #[arg(long, value_name = "catalog|apparent", default_value = "catalog")]
    wcs: Places,
    /// Write it even if the format misses the camera by more than 0.01 px
    #[arg(long)]
    force: bool,
    /// Print the result as one JSON object on stdout, and nothing else
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct ExportObject {
    #[serde(flatten)]
    exported: Exported,
    /// The files written; none if the format does not hold the camera.
    files: Vec<String>,
    provenance: Provenance,
}

/// Writes the files.
pub(crate) fn export(args: &ExportArgs) -> Result<Answer> {
    let calibration = read_calibration(&args.calibration)?;
    let mut provenance = output::provenance();
    provenance.add_input(&args.calibration)?;
    let exported = exchange::export(&Subject { places: args.wcs, ..Subject::from(&calibration) }, args.to)?;
    let written = exported.expressible || args.force;
    let mut files = Vec::new();
    for file in exported.files.iter().filter(|_| written) {
        let path = place(&args.output, &file.name, args.to)?;
        boresight::recording::write_file(&path, &file.bytes)?;
        files.push(path.display().to_string());
    }
    let max_px = exported.residual.max_px;
    if !exported.expressible {
        let consequence =
            if args.force { "it was written because of --force" } else { "nothing was written; --force writes it all the same" };
        tracing::warn!(
            "{} misses the camera by up to {max_px:.3} px over the frame, more than {LIMIT_PX} px: {consequence}",
            args.to.name()
        );
    }
    let object = ExportObject { exported, files, provenance };
    if args.json {
        output::print(&output::json_text(&object)?)?;
    } else {
        output::print(&summary(&object))?;
    }
    Ok(if written { Answer::Yes } else { Answer::No })
}

/// The path of a file: the one asked for, or its own name in the folder asked for.
fn place(asked: &Path, name: &str, format: Format) -> Result<PathBuf> {
    if format.is_per_frame() {
        anyhow::ensure!(
            !asked.is_file(),
            "{}: is a file, but {} writes one file for each frame; name a folder",
            asked.display(),
            format.name()
        );
        return Ok(asked.join(name));
    }
    let text = asked.to_str().with_context(|| format!("{}: the name is no text", asked.display()))?;
    Ok(if asked.is_dir() || text.ends_with('/') { asked.join(name) } else { asked.to_owned() })
}

fn summary(object: &ExportObject) -> String {
    let Exported { model, residual, notes, .. } = &object.exported;
    let mut text = format!("{model}\nresidual over the frame: rms {:.2e} px, at most {:.2e} px", residual.rms_px, residual.max_px);
    text += &residual.beyond_max_px.map_or("\n".to_owned(), |beyond| format!("; a tenth beyond its edges at most {beyond:.2e} px\n"));
    for note in notes {
        text += &format!("note: {note}\n");
    }
    match object.files.as_slice() {
        [] => text + "nothing written\n",
        [one] => text + &format!("written: {one}\n"),
        [first, .., last] => text + &format!("written: {} files, {first} to {last}\n", object.files.len()),
    }
}

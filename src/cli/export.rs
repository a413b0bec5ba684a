//! `boresight export`: a calibrated camera in the format of another program.

use std::path::PathBuf;

use anyhow::Result;
use boresight::exchange::{self, ExportResult, Exported, Format, LIMIT_PX, Places, Subject};
use boresight::recording::{ResultFolder, check_file};
use clap::Args;

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
    /// Replace a file that is there, or what an earlier export wrote into the folder
    #[arg(long)]
    force: bool,
    /// Write it even if the format misses the camera by more than 0.01 px
    #[arg(long)]
    inexact: bool,
    /// Print the result as one JSON object on stdout, and nothing else
    #[arg(long)]
    json: bool,
}

/// Writes the files.
pub(crate) fn export(args: &ExportArgs) -> Result<Answer> {
    let is_folder = args.to.is_per_frame() || args.output.is_dir() || args.output.as_os_str().as_encoded_bytes().ends_with(b"/");
    let _folder = if is_folder {
        Some(ResultFolder::open(&args.output, "export", args.force)?)
    } else {
        check_file(&args.output, args.force)?;
        None
    };
    let calibration = read_calibration(&args.calibration)?;
    let mut provenance = output::provenance();
    provenance.add_input(&args.calibration)?;
    let exported = exchange::export(&Subject { places: args.wcs, ..Subject::from(&calibration) }, args.to)?;
    let written = exported.expressible || args.inexact;
    let mut files = Vec::new();
    for file in exported.files.iter().filter(|_| written) {
        let path = if is_folder { args.output.join(&file.name) } else { args.output.clone() };
        boresight::recording::write_file(&path, &file.bytes)?;
        files.push(path.display().to_string());
    }
    let max_px = exported.residual.max_px;
    if !exported.expressible {
        let consequence =
            if args.inexact { "it was written because of --inexact" } else { "nothing was written; --inexact writes it all the same" };
        tracing::warn!(
            "{} misses the camera by up to {max_px:.3} px over the frame, more than {LIMIT_PX} px: {consequence}",
            args.to.name()
        );
    }
    let object = ExportResult { exported, files, provenance };
    if args.json {
        output::print(&output::json_text(&object)?)?;
    } else {
        output::print_page(&summary(&object))?;
    }
    Ok(if written { Answer::Yes } else { Answer::No })
}

fn summary(object: &ExportResult) -> String {
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

//! `boresight import`: the camera of another program in our model.

use std::path::PathBuf;

use anyhow::{Context, Result};
use boresight::exchange::{self, Format, ImportResult, LIMIT_PX};
use boresight::guard::guarded;
use clap::Args;

use super::options::{OutputArgs, heading};
use super::{Answer, output};

/// Arguments of `import`.
#[derive(Debug, Args)]
#[command(next_help_heading = heading::OUTPUT)]
pub(crate) struct ImportArgs {
    /// A camera as OpenCV, ROS, mrcal, tetra3 or tetra3rs has it, or a FITS file with world coordinates (TAN, TAN-SIP, TPV)
    #[arg(value_name = "FILE", help_heading = None)]
    file: PathBuf,
    /// Its format, if the file does not show it: opencv, ros, mrcal, sip, tpv, tetra3, tetra3rs
    #[arg(long, value_name = "FORMAT", help_heading = heading::INPUT)]
    from: Option<Format>,
    /// Columns of the frame, for files that do not say
    #[arg(long, value_name = "PX", requires = "height", help_heading = heading::INPUT)]
    width: Option<usize>,
    /// Rows of the frame, for files that do not say
    #[arg(long, value_name = "PX", requires = "width", help_heading = heading::INPUT)]
    height: Option<usize>,
    /// Take it even if our model misses the camera by more than 0.01 px
    #[arg(long)]
    inexact: bool,
    #[command(flatten)]
    output: OutputArgs,
}

/// Reads the camera; with -o DIR it is import.json and camera.toml, the [camera] table of a recording or a scene.
pub(crate) fn import(args: &ImportArgs) -> Result<Answer> {
    let _folder = args.output.open("import")?;
    let name = args.file.display().to_string();
    let bytes = std::fs::read(&args.file).with_context(|| format!("{name}: the camera cannot be read"))?;
    let size = args.width.zip(args.height).map(|(width, height)| [width, height]);
    let imported = guarded(|| exchange::import(&name, &bytes, args.from, size)).with_context(|| name.clone())??;
    let mut provenance = output::provenance();
    provenance.add_input_bytes(&name, &bytes);
    let accepted = imported.expressible || args.inexact;
    if !imported.expressible {
        let max_px = imported.residual.max_px;
        let consequence = if args.inexact { "it was taken because of --inexact" } else { "--inexact takes it all the same" };
        tracing::warn!(
            "{name}: our model misses this camera by up to {max_px:.3} px over the frame, more than {LIMIT_PX} px: {consequence}"
        );
    }
    let object = ImportResult { imported, provenance };
    let directory = args.output.output.as_deref().filter(|_| accepted);
    output::deliver("import", &object, args.output.json, directory, || {
        let notes = object.imported.notes.iter().fold(String::new(), |text, note| text + &format!("# note: {note}\n"));
        notes + &object.imported.camera_toml()
    })?;
    if let Some(directory) = directory {
        boresight::recording::write_file(&directory.join("camera.toml"), object.imported.camera_toml().as_bytes())?;
    }
    Ok(if accepted { Answer::Yes } else { Answer::No })
}

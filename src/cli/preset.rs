//! `boresight preset`: scenes of real cameras.

use anyhow::{Result, bail};
use boresight::report::table;
use boresight::scene::{PRESETS, preset as named};
use clap::{Args, Subcommand};

use super::{Answer, output};

/// Arguments of `preset`.
#[derive(Debug, Args)]
pub(crate) struct PresetArgs {
    #[command(subcommand)]
    verb: PresetVerb,
}

#[derive(Debug, Subcommand)]
enum PresetVerb {
    /// List the presets
    List,
    /// Print a preset: a scene file with its numbers and their sources
    Show {
        /// Its name
        name: String,
    },
}

/// Lists the presets, or prints one.
pub(crate) fn preset(args: &PresetArgs) -> Result<Answer> {
    match &args.verb {
        PresetVerb::List => {
            let rows: Vec<[String; 2]> = PRESETS.iter().map(|preset| [preset.name.to_owned(), preset.title().to_owned()]).collect();
            output::print(&table(&["preset", "camera"], &rows))?;
        }
        PresetVerb::Show { name } => {
            let Some(preset) = named(name) else {
                let nearest = PRESETS.iter().map(|preset| preset.name).min_by_key(|known| strsim::damerau_levenshtein(name, known));
                bail!("there is no preset {name}; did you mean {}? (`boresight preset list` lists them all)", nearest.unwrap_or_default());
            };
            output::print(preset.toml)?;
        }
    }
    Ok(Answer::Yes)
}

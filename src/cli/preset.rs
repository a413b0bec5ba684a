//! `boresight preset`: scenes of real cameras.

use anyhow::Result;
use boresight::report::table;
use boresight::scene::{ListedPreset, PRESET_FORMAT, PRESETS, PresetList, preset as named};
use clap::{Args, Subcommand};

use super::{Answer, Usage, output};

/// Arguments of `preset`.
#[derive(Debug, Args)]
pub(crate) struct PresetArgs {
    #[command(subcommand)]
    verb: PresetVerb,
    /// Print the result as one JSON object on stdout, and nothing else
    #[arg(long, global = true, help_heading = super::options::heading::OUTPUT)]
    json: bool,
}

fn print_json(presets: Vec<ListedPreset>) -> Result<()> {
    output::print(&output::json_text(&PresetList { format: PRESET_FORMAT, presets, provenance: output::provenance() })?)
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
        PresetVerb::List if args.json => {
            print_json(PRESETS.iter().map(|preset| ListedPreset { name: preset.name, camera: preset.title(), toml: None }).collect())?;
        }
        PresetVerb::List => {
            let rows: Vec<[String; 2]> = PRESETS.iter().map(|preset| [preset.name.to_owned(), preset.title().to_owned()]).collect();
            output::print_page(&table(&["preset", "camera"], &rows))?;
        }
        PresetVerb::Show { name } => {
            let Some(preset) = named(name) else {
                let nearest = PRESETS.iter().map(|preset| preset.name).min_by_key(|known| strsim::damerau_levenshtein(name, known));
                let nearest = nearest.unwrap_or_default();
                return Err(
                    Usage(format!("there is no preset {name}; did you mean {nearest}? (`boresight preset list` lists them all)")).into()
                );
            };
            if args.json {
                print_json(vec![ListedPreset { name: preset.name, camera: preset.title(), toml: Some(preset.toml) }])?;
            } else {
                output::print(preset.toml)?;
            }
        }
    }
    Ok(Answer::Yes)
}

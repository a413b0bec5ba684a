//! `boresight effects`: what this build knows.

use std::path::PathBuf;

use anyhow::{Result, bail};
use boresight::effects::detector::{colour_filters, quantum_efficiency};
use boresight::effects::optics::sampled_psf;
use boresight::effects::optics::tables::IMAGE_KINDS;
use boresight::effects::pixel::{pixel_effect, psf_2d, separable_psf};
use boresight::effects::sky::glow::sky_glow;
use boresight::effects::{ParameterSpec, page_of, stem_of};
use boresight::provenance::Provenance;
use boresight::recording::ResultFolder;
use boresight::scene::LIGHT_PAGES;
use boresight::scene::effect_demo::{COLOUR_FILTERS, Known, QUANTUM_EFFICIENCY, SAMPLED, kind_id, known};
use clap::Args;
use serde::Serialize;

use super::options::{folder, heading};
use super::{Answer, Usage, effect_pictures, output, signature};

/// Arguments of `effects`.
#[derive(Debug, Args)]
#[command(next_help_heading = heading::OUTPUT)]
pub(crate) struct EffectsArgs {
    /// Print the page of this effect
    #[arg(help_heading = None)]
    id: Option<String>,
    /// Write a picture of what each effect does to a frame (off, on, difference), and a page that holds them; with an id, of that one
    #[arg(long, value_name = "DIR", conflicts_with = "json", value_parser = folder())]
    pictures: Option<PathBuf>,
    /// Replace the pictures or the signature that an earlier run wrote there
    #[arg(long)]
    force: bool,
    /// Print the result as one JSON object on stdout, and nothing else
    #[arg(long)]
    json: bool,
    /// Render and measure what this effect on pixels does to stars, beside the formula of its page
    #[arg(long, value_name = "ID", conflicts_with_all = ["id", "pictures"])]
    signature: Option<String>,
    /// The parameter that is changed, if it is not the effect's first
    #[arg(long, value_name = "NAME", conflicts_with = "id", requires = "signature")]
    parameter: Option<String>,
    /// The scene whose camera and sky are taken
    #[arg(long, value_name = "FILE", conflicts_with = "id", requires = "signature")]
    scene: Option<PathBuf>,
    /// Also write the signature into this folder
    #[arg(short, long, value_name = "DIR", conflicts_with = "id", requires = "signature", value_parser = folder())]
    output: Option<PathBuf>,
}

/// One line of the list.
#[derive(Debug, Serialize)]
struct Line {
    id: String,
    acts_on: &'static str,
    parameters: Vec<Parameter>,
}

const FORMAT: &str = "boresight-effects/1";

/// The list, or the one that was asked for with its page.
#[derive(Serialize)]
struct List {
    format: &'static str,
    effects: Vec<Line>,
    #[serde(skip_serializing_if = "Option::is_none")]
    page: Option<String>,
    provenance: Provenance,
}

fn line(known: Known) -> Line {
    let parameter = |spec: &ParameterSpec| Parameter { name: spec.name, unit: spec.unit };
    Line { id: known.id, acts_on: known.acts_on, parameters: known.parameters.iter().map(parameter).collect() }
}

#[derive(Debug, Serialize)]
struct Parameter {
    name: &'static str,
    unit: &'static str,
}

/// Lists the effects, or prints one page.
pub(crate) fn effects(args: &EffectsArgs) -> Result<Answer> {
    let known = known();
    if let Some(id) = &args.signature {
        if known.iter().all(|line| line.id != *id) {
            return Err(unknown(id, &known));
        }
        let _folder = args.output.as_deref().map(|folder| ResultFolder::open(folder, "signature", args.force)).transpose()?;
        signature::print(id, args.parameter.as_deref(), args.scene.as_deref(), (args.json, args.output.as_deref()))?;
    } else if let Some(directory) = &args.pictures {
        if !boresight::report::DRAWS {
            bail!("this build draws no pictures: it was compiled without the feature `plots`; compile it with that feature");
        }
        let wanted = |line: &&Known| args.id.as_ref().is_none_or(|id| *id == line.id);
        let wanted: Vec<_> = known.iter().filter(wanted).cloned().collect();
        if wanted.is_empty() {
            return Err(unknown(args.id.as_deref().unwrap_or_default(), &known));
        }
        let _folder = ResultFolder::open(directory, "effects", args.force)?;
        output::print_page(&effect_pictures::write(directory, &wanted)?)?;
    } else if let Some(id) = &args.id {
        let Some(page) = page(id) else {
            return Err(unknown(id, &known));
        };
        if args.json {
            let effects = known.into_iter().filter(|known| known.id == *id).map(line).collect();
            let object = List { format: FORMAT, effects, page: Some(page), provenance: output::provenance() };
            output::print(&output::json_text(&object)?)?;
        } else {
            output::print_page(&page)?;
        }
    } else if args.json {
        let effects = known.into_iter().map(line).collect();
        let object = List { format: FORMAT, effects, page: None, provenance: output::provenance() };
        output::print(&output::json_text(&object)?)?;
    } else {
        let rows: Vec<Vec<String>> = known
            .iter()
            .map(|line| {
                let parameters: Vec<String> =
                    line.parameters
                        .iter()
                        .map(|parameter| {
                            if parameter.unit.is_empty() {
                                parameter.name.into()
                            } else {
                                format!("{} ({})", parameter.name, parameter.unit)
                            }
                        })
                        .collect();
                vec![line.id.clone(), line.acts_on.to_owned(), parameters.join(", ")]
            })
            .collect();
        output::print_page(&boresight::report::table(&["effect", "acts on", "parameters"], &rows))?;
    }
    Ok(Answer::Yes)
}

fn unknown(id: &str, known: &[Known]) -> anyhow::Error {
    let nearest = known.iter().map(|line| line.id.as_str()).min_by_key(|known| strsim::damerau_levenshtein(id, known));
    let nearest = nearest.unwrap_or_default();
    Usage(format!("there is no effect {id}; did you mean {nearest}? (`boresight effects` lists them all)")).into()
}

fn page(id: &str) -> Option<String> {
    let displacement = boresight::effects::displacement(id).map(boresight::effects::AnyDisplacement::page);
    // What works on pixels bears the name of a function in its shader.
    let name = stem_of(id);
    let pixels = || pixel_effect(&name).map(|effect| page_of(effect.source()));
    let glow = || sky_glow(id).map(|glow| page_of(glow.source()));
    let spread = || separable_psf(&name).map(|spread| page_of(spread.source()));
    let plane = || psf_2d(&name).map(|spread| page_of(spread.source()));
    let kind = || IMAGE_KINDS.iter().find(|kind| kind_id(kind.id()) == id).map(|kind| page_of(kind.source()));
    let sampled = || (id == SAMPLED).then(|| page_of(sampled_psf::source()));
    let by_colour = || (id == QUANTUM_EFFICIENCY).then(|| page_of(quantum_efficiency::source()));
    let by_filter = || (id == COLOUR_FILTERS).then(|| page_of(colour_filters::source()));
    let light = || LIGHT_PAGES.iter().find(|page| page.id == id).map(|page| page_of((page.source)()));
    let by_colour = || by_colour().or_else(by_filter).or_else(light);
    displacement.or_else(by_colour).or_else(pixels).or_else(glow).or_else(spread).or_else(plane).or_else(kind).or_else(sampled)
}

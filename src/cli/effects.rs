//! `boresight effects`: what this build knows.

use std::path::PathBuf;

use anyhow::{Result, anyhow};
use boresight::effects::detector::{colour_filters, quantum_efficiency};
use boresight::effects::optics::sampled_psf;
use boresight::effects::optics::tables::IMAGE_KINDS;
use boresight::effects::pixel::{PIXEL_EFFECTS, PLANE_SPREADS, POINT_SPREADS, Work, pixel_effect, plane_spread, point_spread};
use boresight::effects::sky::glow::{SKY_GLOWS, sky_glow};
use boresight::effects::{DISPLACEMENTS, ParameterSpec, Segment, page_of};
use boresight::scene::LIGHT_PAGES;
use clap::Args;
use serde::Serialize;

use super::{Answer, effect_pictures, output};

/// Arguments of `effects`.
#[derive(Debug, Args)]
pub(crate) struct EffectsArgs {
    /// Print the page of this effect
    id: Option<String>,
    /// Print the list as one JSON object
    #[arg(long, conflicts_with = "id")]
    json: bool,
    /// Write a picture of what each effect does to a frame (off, on, difference), and a page that holds them; with an id, of that one
    #[arg(long, value_name = "DIR", conflicts_with = "json")]
    pictures: Option<PathBuf>,
}

/// One line of the list.
#[derive(Debug, Serialize)]
struct Line {
    id: String,
    acts_on: &'static str,
    parameters: Vec<Parameter>,
}

#[derive(Debug, Serialize)]
struct Parameter {
    name: &'static str,
    unit: &'static str,
}

/// Lists the effects, or prints one page.
pub(crate) fn effects(args: &EffectsArgs) -> Result<Answer> {
    let known = lines();
    if let Some(directory) = &args.pictures {
        let wanted = |line: &&Line| args.id.as_ref().is_none_or(|id| *id == line.id);
        let wanted: Vec<_> = known.iter().filter(wanted).map(|line| (line.id.clone(), line.acts_on)).collect();
        if wanted.is_empty() {
            return Err(unknown(args.id.as_deref().unwrap_or_default(), &known));
        }
        output::print(&effect_pictures::write(directory, &wanted)?)?;
    } else if let Some(id) = &args.id {
        let Some(page) = page(id) else {
            return Err(unknown(id, &known));
        };
        output::print(&page)?;
    } else if args.json {
        #[derive(Serialize)]
        struct List {
            format: &'static str,
            effects: Vec<Line>,
        }
        output::print(&output::json_text(&List { format: "boresight-effects/1", effects: known })?)?;
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
        output::print(&boresight::report::table(&["effect", "acts on", "parameters"], &rows))?;
    }
    Ok(Answer::Yes)
}

fn unknown(id: &str, known: &[Line]) -> anyhow::Error {
    let nearest = known.iter().map(|line| line.id.as_str()).min_by_key(|known| strsim::damerau_levenshtein(id, known));
    anyhow!("there is no effect {id}; did you mean {}? (`boresight effects` lists them all)", nearest.unwrap_or_default())
}

fn lines() -> Vec<Line> {
    let line = |id: &str, acts_on, specs: &[ParameterSpec]| Line {
        id: id.replace('_', "-"),
        acts_on,
        parameters: specs.iter().map(|spec| Parameter { name: spec.name, unit: spec.unit }).collect(),
    };
    let displacements = DISPLACEMENTS.iter().map(|effect| {
        let acts_on = match effect.segment() {
            Segment::Sky => "direction",
            Segment::Camera => "direction in the camera",
            Segment::Projection => "projection",
            Segment::Focal => "focal plane",
        };
        line(effect.id(), acts_on, effect.parameters())
    });
    let spreads = POINT_SPREADS.iter().map(|spread| line(spread.id(), "star image", &[]));
    let planes = PLANE_SPREADS.iter().filter(|spread| point_spread(spread.id()).is_none());
    let spreads = spreads.chain(planes.map(|spread| line(spread.id(), "star image", spread.parameters())));
    let spreads = spreads.chain(IMAGE_KINDS.iter().map(|kind| line(&kind_id(kind.id()), "star image", kind.parameters())));
    let spreads = spreads.chain([line(SAMPLED, "star image", &[])]);
    let pixels = PIXEL_EFFECTS.iter().map(|effect| {
        let acts_on = match effect.work() {
            Work::Pixels(_) => "pixels",
            Work::Frame(..) => "charge between pixels",
        };
        line(effect.id(), acts_on, effect.parameters())
    });
    let by_colour = line(QUANTUM_EFFICIENCY, "a star's electrons", quantum_efficiency::PARAMETERS);
    let by_filter = line(COLOUR_FILTERS, "a star's electrons", colour_filters::PARAMETERS);
    let glows = SKY_GLOWS.iter().map(|glow| line(glow.id(), "sky between the stars", glow.parameters()));
    let lights = LIGHT_PAGES.iter().map(|page| line(page.id, "light beside the stars", (page.parameters)()));
    displacements.chain(spreads).chain([by_colour, by_filter]).chain(glows).chain(lights).chain(pixels).collect()
}

fn page(id: &str) -> Option<String> {
    let displacement = boresight::effects::displacement(id).map(boresight::effects::AnyDisplacement::page);
    // What works on pixels bears the name of a function in its shader.
    let name = id.replace('-', "_");
    let pixels = || pixel_effect(&name).map(|effect| page_of(effect.source()));
    let glow = || sky_glow(id).map(|glow| page_of(glow.source()));
    let spread = || point_spread(&name).map(|spread| page_of(spread.source()));
    let plane = || plane_spread(&name).map(|spread| page_of(spread.source()));
    let kind = || IMAGE_KINDS.iter().find(|kind| kind_id(kind.id()) == id).map(|kind| page_of(kind.source()));
    let sampled = || (id == SAMPLED).then(|| page_of(sampled_psf::source()));
    let by_colour = || (id == QUANTUM_EFFICIENCY).then(|| page_of(quantum_efficiency::source()));
    let by_filter = || (id == COLOUR_FILTERS).then(|| page_of(colour_filters::source()));
    let light = || LIGHT_PAGES.iter().find(|page| page.id == id).map(|page| page_of((page.source)()));
    let by_colour = || by_colour().or_else(by_filter).or_else(light);
    displacement.or_else(by_colour).or_else(pixels).or_else(glow).or_else(spread).or_else(plane).or_else(kind).or_else(sampled)
}

/// The name of the page of how electrons follow the colour.
const QUANTUM_EFFICIENCY: &str = "quantum-efficiency";

/// The name of the page of how filters share it.
const COLOUR_FILTERS: &str = "colour-filters";

/// The name of the page of an image given point by point.
const SAMPLED: &str = "sampled-image";

/// The name of the page of a kind of image that fills tables.
fn kind_id(kind: &str) -> String {
    format!("{kind}-image")
}

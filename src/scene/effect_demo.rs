//! Demonstration of every effect: a small scene without it and the same scene with it, made from the registries. Pictures are taken of them, and
//! their cost is measured.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use super::LIGHT_PAGES;
use crate::effects::detector::{colour_filters, quantum_efficiency};
use crate::effects::ids;
use crate::effects::optics::tables::IMAGE_KINDS;
use crate::effects::pixel::{PIXEL_EFFECTS, PLANE_SPREADS, POINT_SPREADS, Work, pixel_effect, separable_psf};
use crate::effects::sky::glow::SKY_GLOWS;
use crate::effects::{DISPLACEMENTS, ParameterSpec, Segment, displacement, id_of, stem_of};

/// An effect that this build knows.
#[derive(Clone, Debug)]
pub struct Known {
    /// Its id, with `-`.
    pub id: String,
    /// What it acts on, in words.
    pub acts_on: &'static str,
    /// Its parameters.
    pub parameters: &'static [ParameterSpec],
}

/// The name of the page of how electrons follow the colour.
pub const QUANTUM_EFFICIENCY: &str = "quantum-efficiency";

/// The name of the page of how filters share it.
pub const COLOUR_FILTERS: &str = "colour-filters";

/// The name of the page of an image given point by point.
pub const SAMPLED: &str = "sampled-image";

/// The name of the page of a kind of image that fills tables.
#[must_use]
pub fn kind_id(kind: &str) -> String {
    format!("{kind}-image")
}

/// Every effect that this build knows, from the registries; a cause that displaces and acts on pixels stands twice.
#[must_use]
pub fn known() -> Vec<Known> {
    let line = |id: &str, acts_on, parameters| Known { id: id_of(id), acts_on, parameters };
    let displacements = DISPLACEMENTS.iter().map(|effect| {
        let acts_on = match effect.segment() {
            Segment::Sky => "direction",
            Segment::Camera => "direction in the camera",
            Segment::Projection => ids::PROJECTION,
            Segment::Focal => "focal plane",
        };
        line(effect.id(), acts_on, effect.parameters())
    });
    let spreads = POINT_SPREADS.iter().map(|spread| line(spread.id(), "star image", &[]));
    let planes = PLANE_SPREADS.iter().filter(|spread| separable_psf(spread.id()).is_none());
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

impl Known {
    /// Whether this is the half on pixels of a cause that also displaces.
    #[must_use]
    pub fn is_second(&self) -> bool {
        self.acts_on.contains("pixels") && crate::effects::effect(&self.id).is_some_and(|effect| effect.has_both_faces())
    }

    /// Why no scene of its own shows it, if none does.
    #[must_use]
    pub fn not_shown(&self) -> Option<&'static str> {
        if self.is_second() {
            return None;
        }
        let of_effect = displacement(&self.id).and_then(|effect| effect.facts().not_shown);
        of_effect.or_else(|| NOT_SHOWN.iter().find(|(id, _)| *id == self.id).map(|(_, why)| *why))
    }

    /// The scenes without and with it, of a camera; `None` where it is not shown.
    #[must_use]
    pub fn pair(&self, view: View) -> Option<Pair> {
        if self.not_shown().is_some() {
            return None;
        }
        pair(&self.id, self.acts_on, view)
    }
}

/// Frame and stars of the scenes.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Columns and rows.
    pub side_px: usize,
    /// Principal distance.
    pub focal_length_px: f64,
    /// The faintest stars.
    pub faintest_magnitude: f64,
}

/// The scene that changes: three exposures an hour apart of the belt of Orion, with the noise that every camera has.
const SCENE: &str = r#"
format = "boresight-scene/1"
seed = 5
camera = { width_px = $SIDE, height_px = $SIDE, focal_length_px = $FOCAL $CAMERA }
detector = { psf_sigma_px = 1.2, zero_point_e_per_s = 4e5, gain_e_per_dn = 1.0, read_noise_e = 0.0, full_well_e = 1e6 $DETECTOR }
sky = { background_e_per_px_s = $BACKGROUND, faintest_magnitude = $FAINTEST, physics = "none" }
site = { latitude_deg = 45.0, longitude_deg = 10.0, pressure_hpa = 1000.0, temperature_c = 10.0 }
$MORE
$FRAMES
"#;

/// One exposure of it: middle, temperature of the optics, pressure, rate.
const FRAME: &str = r#"
[[frames]]
time_utc = "$HOUR:00:00Z"
exposure_s = 1.0
boresight_radec_deg = [83.8, -1.2]
temperature_c = $TEMPERATURE
pressure_hpa = $PRESSURE
velocity_km_s = [-28.0, 8.0, 4.0]
$RATE
"#;

/// The exposure that is shown: the last, which is farthest from the mean in everything that telemetry tells.
pub const SHOWN: usize = 2;

/// Where a typical parameter is what the scene's detector has anyway.
const OF_DETECTOR: &[&str] = &["gain_e_per_dn", "bias_dn", "saturation_dn", "full_well_e"];

/// What a scene says in tables of its own: what is added to `[detector]`, and to the scene.
const WRITTEN: &[(&str, &str, &str)] = &[
    (
        "quantum-efficiency",
        ", quantum_efficiency = { wavelengths_nm = [350.0, 500.0, 600.0, 800.0, 1000.0], values = [0.2, 0.6, 0.55, 0.3, 0.05] }",
        "",
    ),
    (
        "colour-filters",
        ", colour_filters = { relative_per_mag = 0.2 }",
        "[[effects]]\nid = \"bayer\"\nparameters = { red_relative = 0.6, blue_relative = 0.5 }\n",
    ),
    ("ghosts", "", "[[ghosts]]\nscale = -0.8\nfraction = 0.01\nradius_px = 14.0\nobstruction = 0.3\n"),
    (
        "streaks",
        "",
        "[[streaks]]\nkind = \"meteor\"\nframe = 2\nstart_px = [60.0, 200.0]\nend_px = [190.0, 90.0]\nelectrons = 4e5\nlight_curve = [2.0, 1.0]\n",
    ),
    ("cosmic-rays", "", "[cosmic_rays]\nexpected_per_s = 25.0\n"),
];

/// What no scene of its own shows, and why.
const NOT_SHOWN: &[(&str, &str)] = &[
    ("gaussian-psf", "every scene is made of it"),
    ("gaussian-image", "the same image from a table"),
    ("disc-psf", "ghosts are discs of it"),
    ("atlas-psf", "it shows what its tables hold: airy-image, moffat-image, zernike-image"),
    ("sampled-image", "it shows what its file holds"),
];

/// A scene without and with something.
#[derive(Clone, Debug)]
pub struct Pair {
    /// The scene without it.
    pub off: String,
    /// The scene with it.
    pub on: String,
    /// What is one of the noises that both scenes have: its id, with `-`.
    pub noise: Option<&'static str>,
    /// What is on, in words.
    pub summary: String,
}

/// The parts of the scene that change.
#[derive(Clone, Default)]
struct Parts {
    camera: String,
    detector: String,
    no_background: bool,
    more: String,
    rate: String,
    dawn: bool,
}

impl Parts {
    fn text(&self, view: View) -> String {
        // A night of the full Moon, and a morning in autumn with the Sun 10° below the horizon.
        let hours = if self.dawn {
            ["2026-09-20T02", "2026-09-20T03", "2026-09-20T04"]
        } else {
            ["2026-01-01T00", "2026-01-01T01", "2026-01-01T02"]
        };
        let frame = |(number, hour): (usize, &str)| {
            FRAME
                .replace("$HOUR", hour)
                .replace("$TEMPERATURE", &format!("{:.1}", 20.0 * number as f64))
                .replace("$PRESSURE", &format!("{:.1}", 1000.0 - 100.0 * number as f64))
                .replace("$RATE", &self.rate)
        };
        let frames: String = hours.into_iter().enumerate().map(frame).collect();
        SCENE
            .replace("$SIDE", &view.side_px.to_string())
            .replace("$FOCAL", &format!("{:?}", view.focal_length_px))
            .replace("$FAINTEST", &format!("{:?}", view.faintest_magnitude))
            .replace("$CAMERA", &self.camera)
            .replace("$DETECTOR", &self.detector)
            .replace("$BACKGROUND", if self.no_background { "0.0" } else { "30.0" })
            .replace("$MORE", &self.more)
            .replace("$FRAMES", &frames)
    }
}

/// The parameters that are shown.
fn shown(id: &str, specs: &[ParameterSpec], skip: &[&str]) -> BTreeMap<&'static str, f64> {
    let of_places = displacement(id).map(|effect| effect.facts().demo_sizes).unwrap_or_default();
    let of_pixels = pixel_effect(id).map_or(&[][..], |effect| effect.demo_sizes());
    let chosen = || of_places.iter().chain(of_pixels);
    let value = |spec: &ParameterSpec| chosen().find(|(name, _)| *name == spec.name).map(|(_, value)| *value);
    let wanted = specs.iter().filter(|spec| value(spec).is_some() || !skip.contains(&spec.name));
    wanted.map(|spec| (spec.name, value(spec).unwrap_or(spec.typical))).collect()
}

fn inline(parameters: &BTreeMap<&str, f64>) -> String {
    parameters.iter().map(|(name, value)| format!("{name} = {value:?}")).collect::<Vec<_>>().join(", ")
}

/// The scenes of an effect; `acts_on` as [`known`] has it.
fn pair(id: &str, acts_on: &str, view: View) -> Option<Pair> {
    let (mut off, mut on) = (Parts::default(), Parts::default());
    let mut noise = None;
    if let Some((_, detector, more)) = WRITTEN.iter().find(|(written, ..)| *written == id) {
        (on.detector, on.more) = ((*detector).to_owned(), (*more).to_owned());
        let summary = format!("{}{}", detector.trim_start_matches(", "), more.trim().replace('\n', ", "));
        return Some(Pair { off: off.text(view), on: on.text(view), noise, summary });
    }
    let name = stem_of(id);
    let specs = |id: &str| displacement(id).map_or(&[][..], |effect| effect.parameters());
    let parameters = match acts_on {
        "projection" => {
            let own = shown(id, specs(id), &["x0", "y0", "f"]);
            on.camera = format!(", projection = {id:?}");
            if id == ids::KANNALA_BRANDT {
                let values = ["k1_theta", "k2_theta", "k3_theta", "k4_theta"].map(|name| own.get(name).copied().unwrap_or_default());
                let _ = write!(on.camera, ", projection_parameters = {values:?}");
            }
            own
        }
        "star image" => {
            let kind = IMAGE_KINDS.iter().find(|kind| kind_id(kind.id()) == id);
            let spread = PLANE_SPREADS.iter().find(|spread| spread.id() == name);
            let (kind, mut own) = match (kind, spread) {
                (Some(kind), _) => (kind.id(), shown(id, kind.parameters(), &[])),
                (None, Some(spread)) => ("elliptic-gaussian", shown(id, spread.parameters(), &[])),
                (None, None) => return None,
            };
            own.retain(|_, value| *value != 0.0);
            on.more = format!("[psf]\nkind = {kind:?}\nparameters = {{ {} }}\n", inline(&own));
            own
        }
        "sky between the stars" => {
            let glow = SKY_GLOWS.iter().find(|glow| glow.id() == id);
            (off.dawn, on.dawn) = (id == "twilight", id == "twilight");
            on.more = format!("[[effects]]\nid = {id:?}\n");
            shown(id, glow.map_or(&[][..], |glow| glow.parameters()), &[])
        }
        "pixels" | "charge between pixels" => {
            let effect = pixel_effect(&name)?;
            let own = shown(id, effect.parameters(), OF_DETECTOR);
            noise = [ids::PHOTON_NOISE, ids::READ_NOISE].into_iter().find(|noisy| *noisy == id);
            match id {
                ids::BACKGROUND => off.no_background = true,
                ids::PHOTON_NOISE => {}
                _ => on.more = format!("[[effects]]\nid = {id:?}\nparameters = {{ {} }}\n", inline(&own)),
            }
            own
        }
        _ if id == ids::BROWN_CONRADY => {
            let own = shown(id, specs(id), &[]);
            on.camera = format!(", {}", inline(&own));
            own
        }
        _ => {
            let own = shown(id, specs(id), &[]);
            if id == ids::ROLLING_SHUTTER {
                (off.rate, on.rate) = ("rate_deg_s = [0.0, 0.5, 0.0]".into(), "rate_deg_s = [0.0, 0.5, 0.0]".into());
            }
            on.more = format!("[[effects]]\nid = {id:?}\nparameters = {{ {} }}\n", inline(&own));
            own
        }
    };
    Some(Pair { off: off.text(view), on: on.text(view), noise, summary: inline(&parameters) })
}

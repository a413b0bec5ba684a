//! `--init`: a suite to begin from, with the cases of ECSS-E-ST-60-20C (Rev. 2, 2019) for a scene: lost in space, slewing, tracking, errors split by cause,
//! stray light, radiation. The frames of each case are those that its limits need.

use super::junit::number;
use super::verdict::{RequirementLimit, SampleKind, fewest_frames};
use crate::scene::Scene;
use crate::units::ARCSEC_RAD;

const CONFIDENCE: f64 = 0.95;
/// Frames of a sequence of the drift.
const SEQUENCE: usize = 5;
/// The suite with <NAMES> in the place of numbers.
const TEMPLATE: &str = include_str!("init.toml");

/// What a suite begins from.
#[derive(Clone, Debug)]
pub struct SuiteSource<'s> {
    /// The line of the case that names it: `preset = "…"` or `scene = "…"`.
    pub key: String,
    /// The scene.
    pub scene: &'s Scene,
    /// Whether its tables of a mount have to go, so that it can be pointed.
    pub is_fixed: bool,
}

/// A rate that is required, with the fewest frames that can show it.
fn frames(kind: SampleKind, limit: RequirementLimit) -> usize {
    fewest_frames(kind, limit, 1.0 - CONFIDENCE).unwrap_or(1)
}

/// The text of a suite.
#[must_use]
pub fn init_suite(source: &SuiteSource<'_>) -> String {
    let SuiteSource { key, scene, is_fixed } = source;
    let pixel_arcsec = 1.0 / scene.camera.focal_length_px / ARCSEC_RAD;
    let width_deg = 2.0 * (0.5 * scene.camera.width_px as f64 / scene.camera.focal_length_px).atan().to_degrees();
    // About the boresight a field of this size is worse by so much.
    let lever = (2.0 / width_deg.to_radians()).max(1.0);
    let tidy = |value: f64| {
        let step = 10.0_f64.powf(value.log10().floor());
        (value / step).ceil() * step
    };
    let (within, cross, about) = (tidy(3.0 * pixel_arcsec), tidy(0.5 * pixel_arcsec), tidy(0.5 * pixel_arcsec * lever));
    let head = if *is_fixed {
        format!("{key}\nset = {{ mount = false }}                     # the camera is pointed all over the sky")
    } else {
        key.clone()
    };
    let found = frames(SampleKind::Share, RequirementLimit::AtLeast(0.99));
    let wrong = frames(SampleKind::Share, RequirementLimit::AtMost(0.001));
    let p99 = frames(SampleKind::Quantile(0.99), RequirementLimit::AtMost(1.0));
    let slow = found.max(p99);
    let background = scene.sky.background_e_per_px_s.unwrap_or(1.0).max(1.0);
    let stray = [1.0, 10.0, 100.0].map(|factor| tidy(factor * background));
    let first = frames(SampleKind::Quantile(0.95), RequirementLimit::AtMost(1.0));
    let values = [
        ("WIDTH_DEG", format!("{width_deg:.1}")),
        ("PIXEL_ARCSEC", format!("{pixel_arcsec:.1}")),
        ("CONFIDENCE", CONFIDENCE.to_string()),
        ("HEAD", head),
        ("SLOW", slow.to_string()),
        ("FOUND", found.to_string()),
        ("WRONG", wrong.to_string()),
        ("MOST", (2 * wrong).to_string()),
        ("SEQUENCE", SEQUENCE.to_string()),
        ("TRACKED", (SEQUENCE * first).to_string()),
        ("WITHIN", number(within)),
        ("CROSS", number(cross)),
        ("ABOUT", number(about)),
        ("STRAY0", number(stray[0])),
        ("STRAY1", number(stray[1])),
        ("STRAY2", number(stray[2])),
    ];
    values.into_iter().fold(TEMPLATE.to_owned(), |text, (name, value)| text.replace(&format!("<{name}>"), &value))
}

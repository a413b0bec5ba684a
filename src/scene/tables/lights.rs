//! `[[ghosts]]`, `[[streaks]]` and `[cosmic_rays]`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[[ghosts]]`: a pair of reflecting surfaces; the page of `disc-psf` has the equation.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GhostTable {
    /// How far from the principal point the ghost stands, in distances of its star; below 0 on the other side.
    pub scale: f64,
    /// Share of the star's light.
    pub fraction: f64,
    /// Radius of the disc.
    pub radius_px: f64,
    /// Radius of its hole over its radius.
    #[serde(default)]
    pub obstruction: f64,
}

/// `[[streaks]]`: a satellite or a meteor. It moves evenly from start to end and is imaged by the optics like a star.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StreakTable {
    /// `satellite` or `meteor`: what the truth calls it.
    pub kind: StreakKind,
    /// The exposure in which it is seen.
    pub frame: Option<usize>,
    /// Instead: the number expected in an exposure, by chance; each crosses the frame through a point by chance, in any direction.
    pub expected_per_frame: Option<f64>,
    /// Where it is when it is first seen (with `frame`).
    pub start_px: Option<[f64; 2]>,
    /// Where it is last seen.
    pub end_px: Option<[f64; 2]>,
    /// Electrons of the whole trail.
    pub electrons: f64,
    /// The light curve along the trail is sᵃ·(1 − s)ᵇ, s = 0 … 1: `[0, 0]` is even, `[2, 1]` a meteor that flares up late.
    #[serde(default)]
    pub light_curve: [f64; 2],
}

/// What leaves a trail.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum StreakKind {
    /// A satellite.
    Satellite,
    /// A meteor.
    Meteor,
}

/// `[cosmic_rays]`: particles that cross the detector and leave charge along straight tracks, without the optics.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CosmicRayTable {
    /// Particles that cross the whole frame in a second.
    pub expected_per_s: f64,
    /// Depth of the detector in which charge is collected.
    #[serde(default = "default_thickness_um")]
    pub thickness_um: f64,
    /// Distance from pixel to pixel.
    #[serde(default = "default_pitch_um")]
    pub pitch_um: f64,
    /// Most probable charge of a track per length (silicon, minimum ionising: about 80).
    #[serde(default = "default_electrons_per_um")]
    pub electrons_per_um: f64,
    /// Width σ to which the charge diffuses.
    #[serde(default = "default_diffusion_px")]
    pub diffusion_px: f64,
}

fn default_thickness_um() -> f64 {
    15.0
}

fn default_pitch_um() -> f64 {
    5.5
}

fn default_electrons_per_um() -> f64 {
    80.0
}

fn default_diffusion_px() -> f64 {
    0.3
}

//! Light and charge that no star of the catalogue sends: ghosts of bright stars, trails of satellites and meteors, cosmic rays.
//!
//! **Ghosts** are discs of light on a fixed map of the stars; see the page of `disc-psf`.
//!
//! **Trails** are lines of light that the optics image like stars, along a straight way, evenly or with a light curve. Neglected: the size of the
//! object, and the shutter's rolling.
//!
//! **Cosmic rays** cross the depth h of the detector in straight lines whose directions come evenly from all sides (cos²θ is even between 0 and 1);
//! over a path of h/cos θ a particle leaves q·h/cos θ·(1 + 0.15·λ) electrons, λ by Moyal's law, the approximation of Landau's (J. E. Moyal,
//! Phil. Mag. 46, 263 (1955)), spread along its track on the pixels and diffused by a Gaussian. Neglected: secondary particles, charge that diffuses
//! more from greater depth, and that the charge's scatter is smaller than that of photons, with whose noise it is drawn.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Poisson};
use rand_pcg::Pcg64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::track::{Sample, StarTrack};
use super::{Scene, SceneError};
use crate::coordinates::PixelPoint;
use crate::effects::optics::disc_psf::DiscPsf;
use crate::effects::pixel::PlaneSpread;
use crate::rng::StageKey;

/// The keys of the random numbers of trails and of cosmic rays.
const STREAK_STAGE: u32 = 0x5354_524b;
const COSMIC_RAY_STAGE: u32 = 0x4352_4159;

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

/// What a light of this kind is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum LightKind {
    /// The ghost of a star.
    Ghost,
    /// A satellite's trail.
    Satellite,
    /// A meteor's trail.
    Meteor,
    /// A particle's track.
    CosmicRay,
}

/// A light in an exposure that is no star.
#[derive(Clone, Debug, PartialEq)]
pub struct OtherLight {
    /// What it is.
    pub kind: LightKind,
    /// Of a ghost: the star's catalogue number.
    pub hip: Option<u32>,
    /// Electrons that it sends.
    pub electrons: f64,
    /// Where it begins and ends; a ghost's middle.
    pub ends: [PixelPoint; 2],
    /// How it is spread.
    pub form: LightForm,
}

/// How such a light is spread.
#[derive(Clone, Debug, PartialEq)]
pub enum LightForm {
    /// A ring of even light between two radii, px.
    Disc {
        /// Outer radius.
        radius_px: f64,
        /// Inner radius.
        hole_px: f64,
    },
    /// By the optics, like a star with this way.
    Trail(StarTrack),
    /// Charge of this width along the line.
    Track {
        /// Width σ, px.
        sigma_px: f64,
    },
}

impl Scene {
    /// Everything in frame number `index` that shines or leaves charge and is no star. `tracks`: the frame's stars.
    ///
    /// # Panics
    /// If `index` is not below the number of exposures.
    #[must_use]
    pub fn other_lights(&self, index: usize, tracks: &[StarTrack]) -> Vec<OtherLight> {
        let mut lights = self.ghosts_of(tracks);
        lights.extend(self.streaks_in(index));
        lights.extend(self.cosmic_rays_in(index));
        lights
    }

    fn ghosts_of(&self, tracks: &[StarTrack]) -> Vec<OtherLight> {
        /// A disc with less light in a pixel is left out, electrons.
        const FAINTEST_E_PER_PX: f64 = 1e-3;
        let centre = self.camera.principal_point_px;
        let mut lights = Vec::new();
        for ghost in &self.ghosts {
            let (radius_px, hole_px) = (ghost.radius_px, ghost.obstruction * ghost.radius_px);
            let area = std::f64::consts::PI * (radius_px * radius_px - hole_px * hole_px);
            for track in tracks {
                let electrons = ghost.fraction * track.electrons * track.samples.iter().map(|sample| sample.weight).sum::<f64>();
                if electrons < FAINTEST_E_PER_PX * area {
                    continue;
                }
                let mean = track.mean();
                let place = PixelPoint {
                    x_px: centre[0] + ghost.scale * (mean.x_px - centre[0]),
                    y_px: centre[1] + ghost.scale * (mean.y_px - centre[1]),
                };
                let form = LightForm::Disc { radius_px, hole_px };
                lights.push(OtherLight { kind: LightKind::Ghost, hip: Some(track.hip), electrons, ends: [place; 2], form });
            }
        }
        lights
    }

    /// Random numbers of a frame for one kind of light; each kind has its own.
    fn chance(&self, index: usize, stage: u32, number: u32) -> Pcg64 {
        let words = StageKey { seed: self.seed, frame: index as u32, stage }.words(number, 0);
        Pcg64::seed_from_u64(u64::from(words[0]) << 32 | u64::from(words[1]))
    }

    fn streaks_in(&self, index: usize) -> Vec<OtherLight> {
        let mut lights = Vec::new();
        let size = [self.camera.width_px as f64, self.camera.height_px as f64];
        for (number, streak) in (0..).zip(&self.streaks) {
            match (streak.frame, streak.start_px, streak.end_px) {
                (Some(frame), Some(start), Some(end)) if frame == index => lights.push(self.trail(index, streak, start, end)),
                (Some(_), ..) => {}
                (None, ..) => {
                    let mut rng = self.chance(index, STREAK_STAGE, number);
                    for _ in 0..draw_count(streak.expected_per_frame.unwrap_or_default(), &mut rng) {
                        let through = size.map(|side| rng.random_range(-0.5..side - 0.5));
                        let angle: f64 = rng.random_range(0.0..std::f64::consts::TAU);
                        let [start, end] = across(size, through, [angle.cos(), angle.sin()]);
                        lights.push(self.trail(index, streak, start, end));
                    }
                }
            }
        }
        lights
    }

    /// A trail at Gauss–Legendre nodes, piece by piece, as a star's.
    fn trail(&self, index: usize, streak: &StreakTable, start: [f64; 2], end: [f64; 2]) -> OtherLight {
        let temperature_offset_k = self.exposures[index].sky.observation().temperature_offset_k.unwrap_or_default();
        let length = (end[0] - start[0]).hypot(end[1] - start[1]);
        let [rise, fall] = streak.light_curve;
        let curve = |s: f64| s.powf(rise) * (1.0 - s).powf(fall);
        let place = |s: f64| PixelPoint { x_px: start[0] + s * (end[0] - start[0]), y_px: start[1] + s * (end[1] - start[1]) };
        let mut samples: Vec<Sample> = super::track::nodes_along(length / self.psf.smooth_px)
            .into_iter()
            .map(|[s, weight]| Sample { time_s: 0.0, weight: weight * curve(s), place: place(s), shear: [0.0; 2] })
            .collect();
        let sum: f64 = samples.iter().map(|sample| sample.weight).sum();
        for sample in &mut samples {
            sample.weight /= sum;
        }
        let track = StarTrack {
            hip: 0,
            magnitude: 0.0,
            colour: None,
            temperature_offset_k,
            electrons: streak.electrons,
            ideal: None,
            start_mid_end: [Some(place(0.0)), Some(place(0.5)), Some(place(1.0))],
            samples,
            blur_px2: [0.0; 3],
        };
        let kind = match streak.kind {
            StreakKind::Satellite => LightKind::Satellite,
            StreakKind::Meteor => LightKind::Meteor,
        };
        OtherLight { kind, hip: None, electrons: streak.electrons, ends: [place(0.0), place(1.0)], form: LightForm::Trail(track) }
    }

    /// Directions come evenly from all sides; the charge of a track follows Moyal's approximation of Landau's law.
    fn cosmic_rays_in(&self, index: usize) -> Vec<OtherLight> {
        /// Steepest tracks are cut here: half a degree above the surface.
        const LEAST_COSINE: f64 = 0.01;
        /// Width of Landau's law over its most probable value in a few µm of silicon.
        const WIDTH: f64 = 0.15;
        let Some(rays) = &self.cosmic_rays else { return Vec::new() };
        let mut rng = self.chance(index, COSMIC_RAY_STAGE, 0);
        let count = draw_count(rays.expected_per_s * self.exposures[index].exposure_s, &mut rng);
        let normal = rand_distr::StandardNormal;
        (0..count)
            .map(|_| {
                let size = [self.camera.width_px as f64, self.camera.height_px as f64];
                let from = size.map(|side| rng.random_range(-0.5..side - 0.5));
                let azimuth: f64 = rng.random_range(0.0..std::f64::consts::TAU);
                // Through a surface the flux falls with the cosine, whose square is even between 0 and 1.
                let cosine = rng.random_range(LEAST_COSINE * LEAST_COSINE..1.0_f64).sqrt();
                let z: f64 = normal.sample(&mut rng);
                let path_um = rays.thickness_um / cosine;
                let along_px = path_um * (1.0 - cosine * cosine).sqrt() / rays.pitch_um;
                // −ln z² has its most probable value at 0.
                let electrons = rays.electrons_per_um * path_um * (1.0 - WIDTH * (z * z).max(1e-12).ln()).max(0.1);
                let to = [from[0] + along_px * azimuth.cos(), from[1] + along_px * azimuth.sin()];
                let ends = [from, to].map(|[x_px, y_px]| PixelPoint { x_px, y_px });
                OtherLight {
                    kind: LightKind::CosmicRay,
                    hip: None,
                    electrons,
                    ends,
                    form: LightForm::Track { sigma_px: rays.diffusion_px },
                }
            })
            .collect()
    }
}

/// Where a line through a point of the frame crosses the frame's edges, a little way outside.
fn across(size: [f64; 2], through: [f64; 2], direction: [f64; 2]) -> [[f64; 2]; 2] {
    const OUTSIDE_PX: f64 = 30.0;
    let (mut from, mut to) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..2 {
        let edges = [-0.5 - OUTSIDE_PX, size[axis] - 0.5 + OUTSIDE_PX].map(|edge| (edge - through[axis]) / direction[axis]);
        if edges.iter().all(|edge| edge.is_finite()) {
            from = from.max(edges[0].min(edges[1]));
            to = to.min(edges[0].max(edges[1]));
        }
    }
    [from, to].map(|along| [0, 1].map(|axis| through[axis] + along * direction[axis]))
}

/// A number by chance with this mean.
fn draw_count(mean: f64, rng: &mut Pcg64) -> u64 {
    Poisson::new(mean).map_or(0, |poisson: Poisson<f64>| poisson.sample(rng) as u64)
}

/// Checks the tables.
pub(super) fn check(
    path: &str,
    ghosts: &[GhostTable],
    streaks: &[StreakTable],
    cosmic_rays: Option<&CosmicRayTable>,
) -> Result<(), SceneError> {
    let refuse = |key: String, value: String, remedy: &'static str| Err(SceneError::Value { path: path.to_owned(), key, value, remedy });
    for (index, ghost) in ghosts.iter().enumerate() {
        let values = [ghost.scale, ghost.fraction, ghost.radius_px, ghost.obstruction];
        for (spec, value) in DiscPsf.parameters().iter().zip(values) {
            if !(spec.range.0..=spec.range.1).contains(&value) {
                let remedy = "must have scale -10 … 10, fraction 0 … 0.5, radius_px 1 … 2000 and obstruction 0 … 0.95";
                return refuse(format!("ghosts[{index}].{}", spec.name), value.to_string(), remedy);
            }
        }
    }
    for (index, streak) in streaks.iter().enumerate() {
        let key = |name: &str| format!("streaks[{index}].{name}");
        let is_placed = streak.frame.is_some() && streak.start_px.is_some() && streak.end_px.is_some();
        let is_drawn = streak.frame.is_none() && streak.start_px.is_none() && streak.end_px.is_none();
        if is_placed == streak.expected_per_frame.is_some() || !(is_placed || is_drawn) {
            return refuse(key("frame"), format!("{:?}", streak.frame), "must stand with start_px and end_px, or expected_per_frame alone");
        }
        if streak.expected_per_frame.is_some_and(|mean| !(0.0..=1e4).contains(&mean)) {
            return refuse(key("expected_per_frame"), format!("{:?}", streak.expected_per_frame), "must lie between 0 and 10000");
        }
        if ![streak.start_px, streak.end_px].into_iter().flatten().flatten().all(|place| place.abs() <= 1e5) {
            return refuse(key("start_px"), format!("{:?}", streak.start_px), "and end_px must be points within 100000 px of the frame");
        }
        if !(0.0..=1e12).contains(&streak.electrons) {
            return refuse(key("electrons"), streak.electrons.to_string(), "must lie between 0 and 1e12");
        }
        if !streak.light_curve.iter().all(|power| (0.0..=10.0).contains(power)) {
            return refuse(key("light_curve"), format!("{:?}", streak.light_curve), "must be two powers between 0 and 10");
        }
    }
    if let Some(rays) = cosmic_rays {
        let ranges = [
            ("expected_per_s", rays.expected_per_s, 0.0, 1e6),
            ("thickness_um", rays.thickness_um, 0.1, 2000.0),
            ("pitch_um", rays.pitch_um, 0.5, 1000.0),
            ("electrons_per_um", rays.electrons_per_um, 0.0, 1e5),
            ("diffusion_px", rays.diffusion_px, 0.1, 10.0),
        ];
        for (name, value, low, high) in ranges {
            if !(low..=high).contains(&value) {
                let remedy =
                    "must have rates 0 … 1e6 a second, 0.1 … 2000 and 0.5 … 1000 µm, 0 … 1e5 electrons a µm, a diffusion of 0.1 … 10 px";
                return refuse(format!("cosmic_rays.{name}"), value.to_string(), remedy);
            }
        }
    }
    Ok(())
}

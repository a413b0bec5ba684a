//! # Trails of satellites and meteors
//!
//! ## What it does
//!
//! Something bright crosses the frame while it is exposed and leaves a line.
//!
//! ## Equation
//!
//! It goes from start to end along a straight line; at the share s of the way it gives light in proportion to sᵃ·(1 − s)ᵇ, `electrons` in all,
//! and the optics image each point of the line as a star there.
//!
//! ## Parameters
//!
//! In a scene, `[[streaks]]`: `kind` (satellite or meteor: what the truth calls it), `electrons`, `light_curve` ([a, b]; [0, 0] is even, [2, 1] a
//! meteor that flares up late); with `frame` (the exposure's number) `start_px` and `end_px`, or `expected_per_frame` alone: that many by chance in each
//! exposure (Poisson), through places and in directions by chance, all across the frame.
//!
//! ## Signature
//!
//! Lines of false stars; stars under them that are drawn along.
//!
//! ## Confused with
//!
//! A row of hot pixels or a bleeding column, which follow the detector's axes and stay; tracks of cosmic rays, which are not as wide as the
//! images of stars.
//!
//! ## Neglected
//!
//! The size of the object, its own turning and flashes, a curved way, and the rolling of a shutter.
//!
//! ## Source
//!
//! G. Nir, B. Zackay, E. O. Ofek, AJ 156, 229 (2018), for a streak as a line that the point spread broadens: the sum along the way is that of
//! smeared stars. The light curve is a form of its own that rises and falls.

use rand::RngExt;

use super::{LightForm, LightKind, OtherLight, Refuse, draw_count};
use crate::coordinates::PixelPoint;
use crate::effects::ParameterSpec;
use crate::scene::track::{Sample, nodes_along};
use crate::scene::{Scene, SceneError, StarTrack, StreakKind, StreakTable};

/// What the table has, for the list of effects.
pub(super) const PARAMETERS: &[ParameterSpec] = &[
    ParameterSpec { name: "frame", unit: "", typical: 0.0, range: (0.0, 1e6) },
    ParameterSpec { name: "expected_per_frame", unit: "1/frame", typical: 0.2, range: (0.0, 1e4) },
    ParameterSpec { name: "start_px", unit: "px", typical: 0.0, range: (-1e5, 1e5) },
    ParameterSpec { name: "end_px", unit: "px", typical: 1000.0, range: (-1e5, 1e5) },
    ParameterSpec { name: "electrons", unit: "e-", typical: 1e5, range: (0.0, 1e12) },
    ParameterSpec { name: "light_curve", unit: "", typical: 0.0, range: (0.0, 10.0) },
];

/// The page's text.
pub(super) fn source() -> &'static str {
    page_source!("streaks.rs")
}

/// The key of its random numbers.
const STREAK_STAGE: u32 = 0x5354_524b;

impl Scene {
    pub(super) fn streaks_in(&self, index: usize) -> Vec<OtherLight> {
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
        let temperature_offset_k = self.exposures.get(index).sky.observation().temperature_offset_k.unwrap_or_default();
        let length = (end[0] - start[0]).hypot(end[1] - start[1]);
        let [rise, fall] = streak.light_curve;
        let curve = |s: f64| s.powf(rise) * (1.0 - s).powf(fall);
        let place = |s: f64| PixelPoint { x_px: start[0] + s * (end[0] - start[0]), y_px: start[1] + s * (end[1] - start[1]) };
        let mut samples: Vec<Sample> = nodes_along(length / self.psf.smooth_px)
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

/// Checks the tables.
pub(super) fn check(refuse: Refuse<'_>, streaks: &[StreakTable]) -> Result<(), SceneError> {
    for (index, streak) in streaks.iter().enumerate() {
        let key = |name: &str| format!("streaks[{index}].{name}");
        let is_placed = streak.frame.is_some() && streak.start_px.is_some() && streak.end_px.is_some();
        let is_drawn = streak.frame.is_none() && streak.start_px.is_none() && streak.end_px.is_none();
        if is_placed == streak.expected_per_frame.is_some() || !(is_placed || is_drawn) {
            return refuse(
                key("frame"),
                streak.frame.map_or("not given".to_owned(), |frame| frame.to_string()),
                "must stand with start_px and end_px, or expected_per_frame alone",
            );
        }
        if let Some(mean) = streak.expected_per_frame.filter(|mean| !(0.0..=1e4).contains(mean)) {
            return refuse(key("expected_per_frame"), mean.to_string(), "must lie between 0 and 10000");
        }
        for (name, place) in [("start_px", streak.start_px), ("end_px", streak.end_px)] {
            if let Some(place) = place.filter(|place| !place.iter().all(|at| at.abs() <= 1e5)) {
                return refuse(key(name), format!("{place:?}"), "must be a point within 100000 px of the frame");
            }
        }
        if !(0.0..=1e12).contains(&streak.electrons) {
            return refuse(key("electrons"), streak.electrons.to_string(), "must lie between 0 and 1e12");
        }
        if !streak.light_curve.iter().all(|power| (0.0..=10.0).contains(power)) {
            return refuse(key("light_curve"), format!("{:?}", streak.light_curve), "must be two powers between 0 and 10");
        }
    }
    Ok(())
}

//! Displacements that no library holds: what a diagnosis must not give a name to.

use std::f64::consts::TAU;

use rand::Rng;

use super::kind::{Hidden, Kind};
use super::random::{between, normal, on_circle, pick};
use super::world::{DetectorPlace, GeneratedStarImage, World};

/// Bumps of a map.
const BUMPS: usize = 14;

impl Hidden {
    /// Displacement of unit size.
    pub(super) fn off_library(&self, world: &World, image: &GeneratedStarImage, place: DetectorPlace) -> [f64; 2] {
        let half = world.optics.width_px as f64 / 2.0;
        let (u, v) = (place.x / half, place.y / half);
        let square = u * u + v * v;
        let frame = &world.frames[image.frame];
        let numbers = &self.numbers;
        let n = |index: usize| numbers.get(index).copied().unwrap_or_default();
        match self.kind {
            Kind::DistortionOfOneFrame if image.frame == n(0) as usize => [u * square, v * square],
            Kind::QuadrantStep => {
                let inside = (u * n(2) > 0.0) && (v * n(3) > 0.0);
                if inside { [n(0), n(1)] } else { [0.0; 2] }
            }
            Kind::HalfTimeScale if frame.hours >= n(0) => [u, v],
            Kind::ColourWave => {
                let wave = (TAU * (image.colour / n(2) + n(3))).sin();
                [n(0) * wave, n(1) * wave]
            }
            Kind::TreeRings => {
                let (dx, dy) = (place.column - n(0), place.row - n(1));
                let radius = dx.hypot(dy).max(1.0);
                let wave = (TAU * (radius / n(2) + n(3))).cos();
                [wave * dx / radius, wave * dy / radius]
            }
            Kind::BumpMap => {
                let mut sum = [0.0; 2];
                for bump in numbers.chunks_exact(5) {
                    let distance2 = ((place.column - bump[0]).powi(2) + (place.row - bump[1]).powi(2)) / (bump[4] * bump[4]);
                    let weight = (-distance2 / 2.0).exp();
                    sum = [sum[0] + weight * bump[2], sum[1] + weight * bump[3]];
                }
                sum
            }
            Kind::RadialSquare => [u * square.sqrt(), v * square.sqrt()],
            Kind::ShearOfFrames => [n(image.frame) * v, n(image.frame) * u],
            Kind::MagnitudeWave => {
                let wave = (TAU * (image.magnitude / n(2) + n(3))).sin();
                [n(0) * wave, n(1) * wave]
            }
            Kind::UntoldScale => [frame.untold * u, frame.untold * v],
            Kind::HalfRotation if u * n(0) + v * n(1) > 0.0 => [-v, u],
            Kind::RowWave => [(TAU * (place.row / n(0) + n(1))).sin(), 0.0],
            Kind::ColourTrefoil => [image.colour * (u * u - v * v), -image.colour * 2.0 * u * v],
            Kind::FocusStepTrefoil => {
                let steps = frame.extra.iter().find(|(name, _)| *name == "focus_position").map_or(0.0, |(_, value)| *value);
                [steps * (u * u - v * v), -steps * 2.0 * u * v]
            }
            _ => [0.0; 2],
        }
    }

    /// A shape for what is in no library.
    pub(super) fn draw_off_library(kind: Kind, rng: &mut impl Rng, world: &World) -> Vec<f64> {
        let [cos, sin] = on_circle(rng);
        let (width, height) = (world.optics.width_px as f64, world.optics.height_px as f64);
        let frames = world.frames.len();
        match kind {
            Kind::DistortionOfOneFrame => vec![pick(rng, frames) as f64],
            Kind::QuadrantStep => {
                let side = |positive: bool| if positive { 1.0 } else { -1.0 };
                vec![cos, sin, side(pick(rng, 2) == 0), side(pick(rng, 2) == 0)]
            }
            Kind::HalfTimeScale => {
                let mut hours: Vec<f64> = world.frames.iter().map(|frame| frame.hours).collect();
                hours.sort_by(f64::total_cmp);
                vec![hours[frames / 2]]
            }
            Kind::ColourWave => vec![cos, sin, between(rng, 0.3, 0.6), between(rng, 0.0, 1.0)],
            Kind::MagnitudeWave => vec![cos, sin, between(rng, 0.5, 1.2), between(rng, 0.0, 1.0)],
            Kind::TreeRings => {
                let away = 0.7 * width;
                vec![width / 2.0 + away * cos, height / 2.0 + away * sin, between(rng, 60.0, 140.0), between(rng, 0.0, 1.0)]
            }
            Kind::BumpMap => {
                let bump = |rng: &mut _| {
                    [
                        between(rng, 0.0, width),
                        between(rng, 0.0, height),
                        normal(rng),
                        normal(rng),
                        width / 1024.0 * between(rng, 50.0, 120.0),
                    ]
                };
                (0..BUMPS).flat_map(|_| bump(rng)).collect()
            }
            Kind::ShearOfFrames => (0..frames).map(|_| normal(rng)).collect(),
            Kind::HalfRotation => vec![cos, sin],
            Kind::RowWave => vec![width / 1024.0 * between(rng, 60.0, 200.0), between(rng, 0.0, 1.0)],
            _ => Vec::new(),
        }
    }
}

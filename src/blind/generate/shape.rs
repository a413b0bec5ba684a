//! Shapes of what is hidden: drawn for a recording, and the whole space of an effect for comparisons.

use rand::Rng;

use super::kind::{Hidden, Kind, LIBRARY};
use super::random::{between, chance, direction, on_circle};
use super::vector::times;
use super::world::World;

/// The Earth's mean speed, for a velocity that nobody tells.
const EARTH_KM_S: f64 = 29.8;
/// Length of the roll-off at the edges where nothing else is known.
const EDGE_PX: f64 = 15.0;

impl Hidden {
    /// A displacement of this kind of unit size.
    pub(super) fn draw(kind: Kind, rng: &mut impl Rng, world: &World) -> Self {
        let width = world.optics.width_px as f64;
        let numbers = match kind {
            Kind::AberrationOfUnknownVelocity => times(direction(rng), EARTH_KM_S).to_vec(),
            Kind::ProperMotionLeftOut => vec![world.years_of_motion],
            Kind::QuadraticRest
            | Kind::WedgeColour
            | Kind::SCurve
            | Kind::MagnitudeEquation
            | Kind::ThinPrism
            | Kind::DetectorTilt
            | Kind::BoresightDrift => on_circle(rng).to_vec(),
            Kind::SensorStep => {
                let [x, y] = on_circle(rng);
                // Seams lie in the middle as often as elsewhere.
                let line = if chance(rng, 0.5) { 0.5 } else { between(rng, 0.3, 0.7) };
                vec![x, y, (width * line).round()]
            }
            Kind::EdgeRollOff => vec![between(rng, 11.0, 20.0)],
            kind if kind.is_off_library() => Self::draw_off_library(kind, rng, world),
            _ => Vec::new(),
        };
        Self { kind, size: 1.0, numbers }
    }

    /// The same displacement times a number.
    #[must_use]
    pub fn scaled(&self, by: f64) -> Self {
        Self { size: self.size * by, ..self.clone() }
    }
}

/// Displacements that span what a library can offer for a kind in this world; sizes of the order of a tenth of a pixel.
fn span(kind: Kind, world: &World) -> Vec<Hidden> {
    let width = world.optics.width_px as f64;
    let of = |size: f64, lists: &[&[f64]]| lists.iter().map(|numbers| Hidden { kind, size, numbers: numbers.to_vec() }).collect::<Vec<_>>();
    let (first, second): (&[f64], &[f64]) = (&[1.0, 0.0], &[0.0, 1.0]);
    let half_fov = width / 2.0 / world.optics.focal_px;
    match kind {
        Kind::AberrationOfUnknownVelocity => of(30.0, &[&[1.0, 0.0, 0.0], &[0.0, 1.0, 0.0], &[0.0, 0.0, 1.0]]),
        Kind::QuadraticRest | Kind::WedgeColour | Kind::SCurve | Kind::MagnitudeEquation => of(0.1, &[first, second]),
        Kind::SensorStep => of(0.1, &[&[1.0, 0.0, (width / 2.0).round()], &[0.0, 1.0, (width / 2.0).round()]]),
        Kind::EdgeRollOff => of(0.1, &[&[EDGE_PX]]),
        Kind::RadialFifth => of(0.2 / width / half_fov.powi(4), &[&[]]),
        Kind::RadialSeventh => of(0.2 / width / half_fov.powi(6), &[&[]]),
        Kind::EpochOffset | Kind::RollingShutter => of(5.0, &[&[]]),
        Kind::ThermalFocalLength | Kind::FocalLengthDrift | Kind::ThermalDistortion => of(1e-5, &[&[]]),
        Kind::PixelAspect | Kind::Shear | Kind::LateralColour | Kind::Spiral => of(1e-4, &[&[]]),
        Kind::Aberration | Kind::Refraction | Kind::ChromaticRefraction => of(1.0, &[&[]]),
        _ => of(0.1, &[&[]]),
    }
}

/// What every effect of the library could offer in this world, by id.
pub(super) fn offers(world: &World, times_told: bool) -> Vec<(&'static str, Vec<Hidden>)> {
    let mut offers: Vec<(&'static str, Vec<Hidden>)> = Vec::new();
    for kind in LIBRARY {
        let there = match kind {
            Kind::Aberration => times_told,
            Kind::AberrationOfUnknownVelocity => !times_told,
            Kind::Refraction | Kind::ChromaticRefraction => world.site.is_some(),
            _ => true,
        };
        if !there {
            continue;
        }
        match offers.iter_mut().find(|(id, _)| *id == kind.id()) {
            Some((_, list)) => list.extend(span(kind, world)),
            None => offers.push((kind.id(), span(kind, world))),
        }
    }
    offers
}

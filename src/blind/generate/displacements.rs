//! The equations of the effects that libraries hold, written from the literature: Δ = measured − ideal, px, at the measured point.

use super::kind::{Hidden, Kind, TrueParameter};
use super::sky::{aberration, dispersion, refraction, refraction_at_45deg_arcsec};
use super::vector::{V3, cross, east_and_north, plus, times};
use super::world::{DetectorPlace, FrameTruth, GeneratedStarImage, World};
use crate::units::DEG_RAD;

/// The sky turns so fast, rad/s.
const SIDEREAL_RATE_RAD_S: f64 = 15.041_067 / 3600.0 * DEG_RAD;
/// Flux at which a charge transfer inefficiency is stated.
const CTI_FLUX_E: f64 = 1e4;
/// Flux at which an overshoot is stated.
const OVERSHOOT_FLUX_E: f64 = 1e4;
/// Displacement for even columns that count 1 + ε and odd ones that count 1 − ε, over ε (centre of mass, σ = 0.7 px).
const EVEN_ODD_PX: f64 = 0.211;
/// Magnitude from which a coma counts; what all stars share of it is a distortion.
const COMA_MAGNITUDE: f64 = 5.0;

impl Hidden {
    /// Change of the direction from which the light arrives.
    #[must_use]
    pub fn sky(&self, frame: &FrameTruth, image: &GeneratedStarImage, at: V3) -> V3 {
        let change = match self.kind {
            Kind::Aberration => aberration(at, frame.velocity_km_s),
            Kind::AberrationOfUnknownVelocity => aberration(at, [self.numbers[0], self.numbers[1], self.numbers[2]]),
            Kind::EpochOffset => motion(image, at),
            Kind::ProperMotionLeftOut => times(motion(image, at), self.numbers[0]),
            // Linear in the strength to 1 part in 10⁴; evaluated at its size so that this is of no account.
            Kind::Refraction => return frame.zenith.map_or([0.0; 3], |zenith| refraction(at, zenith, self.size)),
            Kind::ChromaticRefraction => frame.zenith.map_or([0.0; 3], |zenith| dispersion(at, zenith, image.colour, 1.0)),
            Kind::TimeTag => times(cross([0.0, 0.0, 1.0], at), -SIDEREAL_RATE_RAD_S),
            _ => return [0.0; 3],
        };
        times(change, self.size)
    }

    /// Displacement on the detector, px.
    #[must_use]
    pub fn plane(&self, world: &World, image: &GeneratedStarImage, place: DetectorPlace) -> [f64; 2] {
        let (x, y, f) = (place.x, place.y, world.optics.focal_px);
        let half = world.optics.width_px as f64 / 2.0;
        let (u, v) = (x / half, y / half);
        let ray2 = (x * x + y * y) / (f * f);
        let frame = &world.frames[image.frame];
        let fainter = image.magnitude - world.mean_magnitude;
        let n = |index: usize| self.numbers.get(index).copied().unwrap_or_default();
        let field = match self.kind {
            Kind::ThermalFocalLength => [frame.kelvin * x, frame.kelvin * y],
            Kind::FocalLengthDrift => [frame.hours * x, frame.hours * y],
            Kind::ThermalDistortion => [frame.kelvin * ray2 * x, frame.kelvin * ray2 * y],
            Kind::RadialFifth => [ray2 * ray2 * x, ray2 * ray2 * y],
            Kind::RadialSeventh => [ray2.powi(3) * x, ray2.powi(3) * y],
            Kind::PixelAspect => [x / 2.0, -y / 2.0],
            Kind::Shear => [y / 2.0, x / 2.0],
            Kind::QuadraticRest => {
                let (even, odd) = (u * u - v * v, 2.0 * u * v);
                [n(0) * even + n(1) * odd, n(1) * even - n(0) * odd]
            }
            Kind::LateralColour => [image.colour * x, image.colour * y],
            Kind::WedgeColour => [n(0) * image.colour, n(1) * image.colour],
            Kind::RollingShutter => rolling(world, frame, place),
            Kind::SensorStep => {
                let beyond = if place.column >= n(2) - 0.5 { 1.0 } else { 0.0 };
                [n(0) * beyond, n(1) * beyond]
            }
            Kind::Spiral => [-ray2 * y, ray2 * x],
            Kind::EdgeRollOff => {
                let inward =
                    |at: f64, length: usize| (-(at + 0.5).max(0.0) / n(0)).exp() - (-(length as f64 - 0.5 - at).max(0.0) / n(0)).exp();
                [inward(place.column, world.optics.width_px), inward(place.row, world.optics.height_px)]
            }
            Kind::Coma => {
                // Stated in the corner, where r·(ξ, η) is r² long.
                let corner2 = 1.0 + (world.optics.height_px as f64 / world.optics.width_px as f64).powi(2);
                let stretch = (image.magnitude - COMA_MAGNITUDE) * u.hypot(v) / corner2;
                [stretch * u, stretch * v]
            }
            Kind::ChargeTransfer => {
                let rows = (place.row + 0.5) / world.optics.height_px as f64;
                // Read out before row 0: what is held back comes later, from higher rows as it seems.
                [0.0, rows * (image.flux_e / CTI_FLUX_E).powf(-0.5)]
            }
            Kind::SCurve => {
                let wave = |at: f64| (std::f64::consts::TAU * at).sin();
                [n(0) * wave(place.column), n(1) * wave(place.row)]
            }
            Kind::EvenOdd => [-EVEN_ODD_PX * (std::f64::consts::PI * place.column).sin(), 0.0],
            Kind::MagnitudeEquation => [n(0) * fainter, n(1) * fainter],
            Kind::Overshoot => [image.flux_e / OVERSHOOT_FLUX_E, 0.0],
            Kind::ThinPrism => [n(0) * (u * u + v * v), n(1) * (u * u + v * v)],
            Kind::DetectorTilt => {
                let slope = (x * n(1) - y * n(0)) / f;
                [x * slope, y * slope]
            }
            Kind::BoresightDrift => [n(0) * frame.kelvin, n(1) * frame.kelvin],
            kind if kind.is_off_library() => self.off_library(world, image, place),
            _ => return [0.0; 2],
        };
        [self.size * field[0], self.size * field[1]]
    }

    /// Its parameters as result files name them; what is in no library has none.
    #[must_use]
    pub fn parameters(&self) -> Vec<TrueParameter> {
        let s = self.size;
        let n = |index: usize| self.numbers.get(index).copied().unwrap_or_default();
        let list: Vec<(&str, f64, &str)> = match self.kind {
            Kind::Aberration => vec![("amplitude", 1.0, "")],
            Kind::AberrationOfUnknownVelocity => {
                vec![("velocity_x_km_s", s * n(0), "km/s"), ("velocity_y_km_s", s * n(1), "km/s"), ("velocity_z_km_s", s * n(2), "km/s")]
            }
            Kind::EpochOffset => vec![("epoch_offset_yr", s, "yr")],
            // The recording's epoch minus that of the model, which is the catalogue's.
            Kind::ProperMotionLeftOut => vec![("epoch_offset_yr", s * n(0), "yr")],
            Kind::Refraction => vec![("refraction_at_45deg_arcsec", refraction_at_45deg_arcsec(s), "arcsec")],
            Kind::ChromaticRefraction => vec![("arcsec_per_mag_at_45deg", s, "arcsec/mag")],
            Kind::ThermalFocalLength => vec![("relative_per_kelvin", s, "K^-1")],
            Kind::FocalLengthDrift => vec![("relative_per_hour", s, "h^-1")],
            Kind::ThermalDistortion => vec![("k1_norm_per_kelvin", s, "K^-1")],
            Kind::RadialFifth => vec![("k2_norm", s, ""), ("k3_norm", 0.0, "")],
            Kind::RadialSeventh => vec![("k2_norm", 0.0, ""), ("k3_norm", s, "")],
            Kind::PixelAspect => vec![("epsilon", s, "")],
            Kind::Shear => vec![("shear_rad", s, "rad")],
            Kind::QuadraticRest => vec![("a_px", s * n(0), "px"), ("b_px", s * n(1), "px")],
            Kind::LateralColour => vec![("relative_scale_per_mag", s, "1/mag")],
            Kind::WedgeColour | Kind::MagnitudeEquation => vec![("x_px_per_mag", s * n(0), "px/mag"), ("y_px_per_mag", s * n(1), "px/mag")],
            Kind::RollingShutter => vec![("line_time_us", s, "us")],
            Kind::SensorStep => vec![("x_px", s * n(0), "px"), ("y_px", s * n(1), "px"), ("line_px", n(2), "px")],
            Kind::Spiral => vec![("spiral_norm", s, "")],
            Kind::EdgeRollOff => vec![("amplitude_px", s, "px"), ("length_px", n(0), "px")],
            Kind::Coma => vec![("coma_px_at_corner", s, "px/mag")],
            Kind::ChargeTransfer => vec![("px_at_far_row_10000e", s, "px")],
            Kind::SCurve => vec![("x_px", s * n(0), "px"), ("y_px", s * n(1), "px")],
            Kind::EvenOdd => vec![("relative", s, "")],
            Kind::Overshoot => vec![("x_px", s, "px")],
            Kind::ThinPrism => vec![("s1_px", s * n(0), "px"), ("s2_px", s * n(1), "px")],
            Kind::DetectorTilt => vec![("tilt_x_rad", s * n(0), "rad"), ("tilt_y_rad", s * n(1), "rad")],
            Kind::BoresightDrift => vec![("x_px_per_kelvin", s * n(0), "px/K"), ("y_px_per_kelvin", s * n(1), "px/K")],
            Kind::TimeTag => vec![("offset_s", s, "s")],
            _ => Vec::new(),
        };
        list.into_iter().map(|(name, value, unit)| TrueParameter { name: name.to_owned(), value, unit: unit.to_owned() }).collect()
    }
}

/// Change of a direction by a year of its proper motion.
fn motion(image: &GeneratedStarImage, at: V3) -> V3 {
    let (east, north) = east_and_north(at);
    plus(times(east, image.motion_rad_yr[0]), image.motion_rad_yr[1], north)
}

/// A row's own attitude: the direction moves as ḋ = −ω × d from the middle row's time to this row's, a microsecond a row.
fn rolling(world: &World, frame: &FrameTruth, place: DetectorPlace) -> [f64; 2] {
    let f = world.optics.focal_px;
    let later_s = (place.row - (world.optics.height_px as f64 - 1.0) / 2.0) * 1e-6;
    let ray = [place.x / f, place.y / f, 1.0];
    let [dx, dy, dz] = times(cross(frame.rate_rad_s, ray), -later_s);
    [f * (dx - ray[0] * dz), f * (dy - ray[1] * dz)]
}

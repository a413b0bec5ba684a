//! A camera, its frames and the stars in them: what is there before anything is hidden.

use hifitime::Epoch;

use super::kind::Hidden;
use super::vector::{V3, plus, turned, unit};

/// Steps to the measured point; each shrinks what is left by the slope of the displacement.
const PASSES: usize = 8;

/// The camera, as it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Optics {
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// Focal length, px.
    pub focal_px: f64,
    /// Principal point, px.
    pub centre_px: [f64; 2],
    /// Radial distortion, px⁻².
    pub k1: f64,
    /// Decentring distortion, px⁻¹.
    pub p1: f64,
    /// Decentring distortion, px⁻¹.
    pub p2: f64,
}

/// A frame, as it is.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameTruth {
    /// Middle of the exposure.
    pub time: Epoch,
    /// Hours from the mean time of the frames.
    pub hours: f64,
    /// Temperature.
    pub temperature_c: f64,
    /// Temperature minus the mean of the frames.
    pub kelvin: f64,
    /// Turning of the camera, camera axes.
    pub rate_rad_s: V3,
    /// Barycentric velocity of the camera, ICRS axes.
    pub velocity_km_s: V3,
    /// Zenith, ICRS axes, on the ground.
    pub zenith: Option<V3>,
    /// Camera axes in ICRS components.
    pub rows: [V3; 3],
    /// A number that no telemetry tells.
    pub untold: f64,
    /// Numbers beside the known telemetry.
    pub extra: Vec<(&'static str, f64)>,
}

/// The image of a star in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeneratedStarImage {
    /// Index of its frame.
    pub frame: usize,
    /// Hipparcos number.
    pub hip: u32,
    /// From where its light arrives, by the physics that is not hidden: ICRS axes.
    pub direction: V3,
    /// Proper motion, rad per year, east and north.
    pub motion_rad_yr: [f64; 2],
    /// V.
    pub magnitude: f64,
    /// B − V less 0.6; zero where the catalogue does not know it.
    pub colour: f64,
    /// True standard error per axis.
    pub sigma_px: f64,
    /// Electrons.
    pub flux_e: f64,
}

/// A place on the detector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectorPlace {
    /// Relative to the principal point, px.
    pub x: f64,
    /// Relative to the principal point, px.
    pub y: f64,
    /// Pixel coordinates.
    pub column: f64,
    /// Pixel coordinates.
    pub row: f64,
}

/// Everything.
#[derive(Clone, Debug, PartialEq)]
pub struct World {
    /// Name of the camera.
    pub setup: &'static str,
    /// The camera.
    pub optics: Optics,
    /// Its frames.
    pub frames: Vec<FrameTruth>,
    /// The stars.
    pub images: Vec<GeneratedStarImage>,
    /// Mean magnitude of the star images.
    pub mean_magnitude: f64,
    /// Latitude, longitude, pressure, temperature of a site on the ground.
    pub site: Option<[f64; 4]>,
    /// Exposure.
    pub exposure_s: f64,
    /// Electrons per second of a star of V = 0.
    pub zero_point_e_per_s: f64,
    /// Ids of the effects that are in the sky AND told to the model.
    pub known: Vec<&'static str>,
    /// Years of proper motion that the stars' directions contain.
    pub years_of_motion: f64,
}

impl Optics {
    /// The distortion at a measured point.
    pub(super) fn distortion(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let square = x * x + y * y;
        let radial = self.k1 * square;
        [
            x * radial + self.p1 * (square + 2.0 * x * x) + 2.0 * self.p2 * x * y,
            y * radial + self.p2 * (square + 2.0 * y * y) + 2.0 * self.p1 * x * y,
        ]
    }

    /// Direction in camera axes → point on the detector; `None` behind the camera.
    pub(super) fn place(&self, direction: V3) -> Option<DetectorPlace> {
        if direction[2] <= 0.1 {
            return None;
        }
        let ideal = [self.focal_px * direction[0] / direction[2], self.focal_px * direction[1] / direction[2]];
        let mut point = ideal;
        for _ in 0..40 {
            let moved = self.distortion(point);
            let next = [ideal[0] + moved[0], ideal[1] + moved[1]];
            let step = (next[0] - point[0]).abs() + (next[1] - point[1]).abs();
            point = next;
            if step < 1e-11 {
                break;
            }
        }
        Some(self.at(point))
    }

    /// The place of a point relative to the principal point.
    pub(super) fn at(&self, [x, y]: [f64; 2]) -> DetectorPlace {
        DetectorPlace { x, y, column: x + self.centre_px[0], row: y + self.centre_px[1] }
    }

    /// Whether a place lies on the detector, this far from its edges.
    pub(super) fn holds(&self, place: DetectorPlace, margin_px: f64) -> bool {
        let inside = |at: f64, length: usize| at >= margin_px - 0.5 && at <= length as f64 - 0.5 - margin_px;
        inside(place.column, self.width_px) && inside(place.row, self.height_px)
    }
}

impl World {
    /// Where each star image falls without noise, with what is hidden: column and row.
    #[must_use]
    pub fn predict(&self, hidden: &[Hidden]) -> Vec<[f64; 2]> {
        self.images.iter().map(|image| self.predict_one(image, hidden)).collect()
    }

    fn predict_one(&self, image: &GeneratedStarImage, hidden: &[Hidden]) -> [f64; 2] {
        let frame = &self.frames[image.frame];
        let mut direction = image.direction;
        for one in hidden {
            direction = unit(plus(direction, 1.0, one.sky(frame, image, direction)));
        }
        let Some(plain) = self.optics.place(turned(&frame.rows, direction)) else {
            return [f64::NAN; 2];
        };
        // Displacements belong to the measured point, which is found by going where they lead.
        let mut place = plain;
        for _ in 0..PASSES {
            let mut point = [plain.x, plain.y];
            for one in hidden {
                let shift = one.plane(self, image, place);
                point = [point[0] + shift[0], point[1] + shift[1]];
            }
            place = self.optics.at(point);
        }
        [place.column, place.row]
    }
}

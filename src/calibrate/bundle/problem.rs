//! The least-squares problem of a bundle adjustment: star images, free parameters, attitudes, and their linearisation.
//!
//! A star image with measured pixel x is seen in the direction d(x, θ) of the camera's axes; its star's light arrives from R·v(θ). With
//! J = ∂d/∂x the residual, measured minus predicted, is to first order in its own size
//!
//! ```text
//! r = −J⁺·(R·v − d),   ∂r/∂θ = J⁺·(∂d/∂θ − R·∂v/∂θ),   ∂r/∂φ = −J⁺·[φ × R·v]   (R ← exp(φ)·R)
//! ```
//! so no distortion has to be inverted. The neglected part is r²/f, a thousandth of a residual of a few pixels. Where the model changes
//! within a pixel (S-curve) all of it is taken at the point x − r that is predicted so: at the measured one its error would enter twice.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::memory::Carried;
use super::normal::{MAX_LOCAL, MAX_PARAMETERS};
use super::reference::Reference;
use crate::calibrate::LitCircle;
use crate::camera::{Model, PARAMETER_COUNT};
use crate::effects::{Context, Observation, StarImage, StarState};
use crate::identify::{ControlPoints, KnownAttitude};

/// Steps to a predicted point at most, and the last of them.
const PREDICTIONS: usize = 4;
const PREDICTED_PX: f64 = 1e-3;
/// A star that is measured farther from where it is predicted is no measure of what happens within a pixel,
const WITHIN_REACH_PX: f64 = 1.0;
/// nor, this far, of anything.
const REACH_PX: f64 = 100.0;
/// A star image.
#[derive(Clone, Copy, Debug)]
pub(in crate::calibrate) struct Image {
    /// Index of its control point.
    pub(in crate::calibrate) point: usize,
    /// Measured position.
    pub(in crate::calibrate) pixel: [f64; 2],
    /// Where its star's light comes from; used where no effect of the sky is solved.
    pub(in crate::calibrate) apparent: [f64; 3],
    /// The star.
    pub(in crate::calibrate) star: StarState,
    /// What else is known of the image.
    pub(in crate::calibrate) state: StarImage,
    /// Covariance of the measured position, xx, xy, yy, px².
    pub(in crate::calibrate) covariance_px2: [f64; 3],
    /// Standard error of the star's place, rad per axis.
    pub(in crate::calibrate) catalog_sigma_rad: f64,
}

impl Image {
    /// All that effects depend on, in an exposure of which this is known.
    pub(in crate::calibrate) fn context(&self, observation: &Observation) -> Context {
        Context::new(self.star, *observation).with_image(self.state)
    }
}

/// The images of one exposure.
#[derive(Clone, Debug)]
pub(in crate::calibrate) struct Exposure {
    /// Index of the frame in its recording.
    pub(in crate::calibrate) frame: usize,
    /// What is known of it.
    pub(in crate::calibrate) observation: Observation,
    /// An attitude from elsewhere.
    pub(in crate::calibrate) known_attitude: Option<KnownAttitude>,
    /// Its star images.
    pub(in crate::calibrate) images: Vec<Image>,
}

/// A parameter's value as known beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::calibrate) struct Prior {
    /// Index among the free parameters.
    pub(in crate::calibrate) free: usize,
    /// Value.
    pub(in crate::calibrate) value: f64,
    /// Its standard error.
    pub(in crate::calibrate) sigma: f64,
}

/// How the attitudes of the frames hang together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::calibrate) enum Attitudes {
    /// One for each frame.
    Free,
    /// One for each frame, and three rates: the rows are exposed one after the other, and nobody says how the camera turned.
    FreeWithRates,
    /// One to the ground; the Earth turns.
    FixedToEarth,
}

/// What is adjusted.
#[derive(Clone, Debug)]
pub(in crate::calibrate) struct Problem {
    /// The model with its starting values.
    pub(in crate::calibrate) model: Model,
    /// Indices of the parameters solved, into the model's.
    pub(in crate::calibrate) free: Vec<usize>,
    /// Values known beforehand.
    pub(in crate::calibrate) priors: Vec<Prior>,
    /// What earlier solutions know of all free parameters together.
    pub(in crate::calibrate) carried: Option<Carried>,
    /// The star images, by frame.
    pub(in crate::calibrate) exposures: Vec<Exposure>,
    /// The attitudes.
    pub(in crate::calibrate) attitudes: Attitudes,
    /// Whether effects of the sky are among the free parameters.
    pub(in crate::calibrate) solves_sky: bool,
    /// Whether all is linearised at the predicted points, not at the measured ones: where columns are held against residuals an error
    /// that stands in both would look like a relation between them.
    pub(in crate::calibrate) at_predicted: bool,
    /// What of the frame the lens lights; `None`: all of it.
    pub(in crate::calibrate) lit: Option<LitCircle>,
}

/// Where the adjustment stands.
#[derive(Clone, Debug)]
pub(in crate::calibrate) struct State {
    /// All parameters of the model.
    pub(in crate::calibrate) values: Vec<f64>,
    /// One for each exposure, camera from ICRS (apparent places); `None` where the frame found no attitude and does not take part.
    pub(in crate::calibrate) attitudes: Vec<Option<UnitQuaternion<f64>>>,
    /// Rates, rad/s; zero unless they are solved.
    pub(in crate::calibrate) rates: Vec<[f64; 3]>,
    /// Camera from the Earth's axes, where the mount is fixed.
    pub(in crate::calibrate) mount: UnitQuaternion<f64>,
}

/// What one frame has of its own.
#[derive(Clone, Copy, Debug)]
pub(in crate::calibrate) struct FrameParameters {
    /// Camera from ICRS (apparent places).
    pub(in crate::calibrate) attitude: UnitQuaternion<f64>,
    /// Rates, rad/s.
    pub(in crate::calibrate) rates: [f64; 3],
}

impl FrameParameters {
    /// Moves by a step in the attitude and the rates.
    pub(in crate::calibrate) fn step(&mut self, step: [f64; MAX_LOCAL]) {
        self.attitude = UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2])) * self.attitude;
        for (rate, step) in self.rates.iter_mut().zip(&step[3..]) {
            *rate += step;
        }
    }
}

impl State {
    /// Moves a frame's own parameters: its attitude and its rates.
    pub(in crate::calibrate) fn move_own(&mut self, exposure: usize, step: [f64; MAX_LOCAL]) {
        let Some(attitude) = self.attitudes[exposure] else { return };
        let mut own = FrameParameters { attitude, rates: self.rates[exposure] };
        own.step(step);
        (self.attitudes[exposure], self.rates[exposure]) = (Some(own.attitude), own.rates);
    }
}

/// One star image, linearised: residual and its columns.
#[derive(Clone, Copy, Debug)]
pub(in crate::calibrate) struct Row {
    /// Measured minus predicted, px.
    pub(in crate::calibrate) residual: [f64; 2],
    /// ∂r/∂θ by axis, in the order of the free parameters.
    pub(in crate::calibrate) by_parameter: [[f64; MAX_PARAMETERS]; 2],
    /// ∂r/∂φ by axis, px/rad.
    pub(in crate::calibrate) by_rotation: [[f64; 3]; 2],
}

impl Row {
    /// A residual taken at another point than the measured one becomes the measured point's.
    fn count_from(&mut self, image: &Image, at: [f64; 2]) {
        for (residual, (measured, at)) in self.residual.iter_mut().zip(image.pixel.iter().zip(at)) {
            *residual += measured - at;
        }
    }
}

impl Problem {
    /// The images of the points that take part, by frame; `chosen` gives for each frame the points' indices.
    pub(in crate::calibrate) fn exposures<'a>(
        points: &ControlPoints,
        chosen: impl IntoIterator<Item = (usize, &'a [usize])>,
    ) -> Vec<Exposure> {
        let image = |index: &usize| {
            let point = &points.points[*index];
            Image {
                point: *index,
                pixel: [point.x_px, point.y_px],
                apparent: point.direction.xyz,
                star: point.star,
                state: point.image,
                covariance_px2: point.covariance_px2,
                catalog_sigma_rad: point.catalog_sigma_rad,
            }
        };
        let exposure = |(frame, indices): (usize, &[usize])| Exposure {
            frame,
            observation: points.observation(frame),
            known_attitude: points.frames.get(frame).and_then(|frame| frame.known_attitude),
            images: indices.iter().map(image).collect(),
        };
        chosen.into_iter().map(exposure).collect()
    }

    /// Star images in all.
    pub(in crate::calibrate) fn image_count(&self) -> usize {
        self.exposures.iter().map(|exposure| exposure.images.len()).sum()
    }

    /// How many parameters of its own each frame has.
    pub(in crate::calibrate) fn local_count(&self) -> usize {
        match self.attitudes {
            Attitudes::Free => 3,
            Attitudes::FreeWithRates => 6,
            Attitudes::FixedToEarth => 0,
        }
    }

    /// How many parameters all frames share: those of the model, and the mount's attitude.
    pub(in crate::calibrate) fn shared_count(&self) -> usize {
        self.free.len() + if self.attitudes == Attitudes::FixedToEarth { 3 } else { 0 }
    }

    /// The attitude of an exposure.
    pub(in crate::calibrate) fn attitude(&self, state: &State, exposure: usize) -> Option<UnitQuaternion<f64>> {
        match self.attitudes {
            Attitudes::FixedToEarth => Some(state.mount * earth_from_icrs(&self.exposures[exposure].observation)?),
            Attitudes::Free | Attitudes::FreeWithRates => state.attitudes[exposure],
        }
    }

    /// Time of an image's row after that of the middle row, s.
    pub(in crate::calibrate) fn row_time_s(observation: &Observation, y_px: f64) -> f64 {
        observation.sensor.map_or(0.0, |sensor| sensor.line_time_s.unwrap_or(0.0) * (y_px - sensor.middle_px()[1]))
    }

    /// Calls `each` with every image of an exposure (index) and its linearisation. Images whose pixel has no direction are left out.
    pub(in crate::calibrate) fn linearise(&self, state: &State, exposure: usize, each: impl FnMut(usize, &Row)) {
        if let Some(own) = self.own(state, exposure) {
            self.linearise_at(&state.values, own, exposure, each);
        }
    }

    /// What a frame has of its own; `None` where it takes no part.
    pub(in crate::calibrate) fn own(&self, state: &State, exposure: usize) -> Option<FrameParameters> {
        Some(FrameParameters { attitude: self.attitude(state, exposure)?, rates: state.rates[exposure] })
    }

    /// The same as [`Self::linearise`] from the model's values and what the frame has of its own.
    pub(in crate::calibrate) fn linearise_at(
        &self,
        values: &[f64],
        own: FrameParameters,
        exposure: usize,
        mut each: impl FnMut(usize, &Row),
    ) {
        let rates = own.rates;
        let rotation = own.attitude.to_rotation_matrix();
        let of = &self.exposures[exposure];
        let plain = self.model.is_reference_behind_the_lens();
        let reach_px = if self.model.changes_within_pixels() {
            WITHIN_REACH_PX
        } else if self.at_predicted {
            REACH_PX
        } else {
            0.0
        };
        let reference =
            (plain && !self.solves_sky && self.free.iter().all(|index| *index < PARAMETER_COUNT)).then(|| Reference::new(values));
        let mut row = Row { residual: [0.0; 2], by_parameter: [[0.0; MAX_PARAMETERS]; 2], by_rotation: [[0.0; 3]; 2] };
        for (index, image) in of.images.iter().enumerate() {
            let done = match &reference {
                Some(reference) => self.row_of_reference(reference, &rotation, image, reach_px, &mut row),
                None => self.row_of_model(values, &rotation, of, image, reach_px, &mut row),
            };
            if done.is_none() {
                continue;
            }
            if self.attitudes == Attitudes::FreeWithRates {
                // Seen a time t after the middle row, the star stands where the rotation −ω·t takes it.
                let time_s = Self::row_time_s(&of.observation, image.pixel[1]);
                for (residual, columns) in row.residual.iter_mut().zip(&row.by_rotation) {
                    *residual -= (0..3).map(|axis| columns[axis] * rates[axis] * time_s).sum::<f64>();
                }
            }
            each(index, &row);
        }
    }

    fn row_of_reference(
        &self,
        reference: &Reference,
        rotation: &Rotation3<f64>,
        image: &Image,
        reach_px: f64,
        row: &mut Row,
    ) -> Option<()> {
        let mut point = reference.at(image.pixel)?;
        let arrives = rotation * Vector3::from(image.apparent);
        // J⁺ takes nothing from d itself.
        row.residual = point.pixels((-arrives).into());
        if let Some(predicted) = predicted(image, row, reach_px) {
            point = reference.at(predicted)?;
            row.residual = point.pixels((-arrives).into());
            row.count_from(image, predicted);
        }
        for (axis, column) in point.by_rotation(arrives.into()).into_iter().enumerate() {
            (row.by_rotation[0][axis], row.by_rotation[1][axis]) = (-column[0], -column[1]);
        }
        for (k, index) in self.free.iter().enumerate() {
            let column = point.by_parameter[*index];
            (row.by_parameter[0][k], row.by_parameter[1][k]) = (column[0], column[1]);
        }
        row.residual.iter().all(|r| r.is_finite()).then_some(())
    }

    fn row_of_model(
        &self,
        values: &[f64],
        rotation: &Rotation3<f64>,
        of: &Exposure,
        image: &Image,
        reach_px: f64,
        row: &mut Row,
    ) -> Option<()> {
        let context = image.context(&of.observation);
        let (apparent, sky) =
            if self.solves_sky { self.model.apparent_columns(values, &self.free, &context) } else { (image.apparent, Vec::new()) };
        let arrives = rotation * Vector3::from(apparent);
        let mut at = image.pixel;
        // Once, or to the end where the model bends within the way.
        let turns = if reach_px <= 0.0 { 0 } else { PREDICTIONS };
        for _ in 0..turns {
            let seen = self.model.seen(values, &[], at, &context)?;
            Inverse::of(seen.direction, seen.by_pixel, arrives, row)?;
            row.count_from(image, at);
            let Some(next) = predicted(image, row, reach_px) else {
                at = image.pixel;
                break;
            };
            let step_px = (next[0] - at[0]).hypot(next[1] - at[1]);
            at = next;
            if step_px < PREDICTED_PX {
                break;
            }
        }
        let seen = self.model.seen(values, &self.free, at, &context)?;
        let inverse = Inverse::of(seen.direction, seen.by_pixel, arrives, row)?;
        row.count_from(image, at);
        for k in 0..self.free.len() {
            let mut change = seen.by_parameter[k];
            if let Some(sky) = sky.get(k).filter(|sky| **sky != [0.0; 3]) {
                let turned = rotation * Vector3::from(*sky);
                for axis in 0..3 {
                    change[axis] -= turned[axis];
                }
            }
            let [x, y] = inverse.pixels(change);
            row.by_parameter[0][k] = x;
            row.by_parameter[1][k] = y;
        }
        Some(())
    }
}

/// Where a star is predicted, from its residual at the measured point, if that is within reach.
fn predicted(image: &Image, row: &Row, reach_px: f64) -> Option<[f64; 2]> {
    let [x, y] = row.residual;
    (x.hypot(y) < reach_px).then(|| [image.pixel[0] - x, image.pixel[1] - y])
}

/// J⁺, the change of the pixel that goes with a change of the direction.
struct Inverse([[f64; 3]; 2]);

impl Inverse {
    /// From J; fills in the residual and its columns by rotation.
    fn of(direction: [f64; 3], by_pixel: [[f64; 2]; 3], arrives: Vector3<f64>, row: &mut Row) -> Option<Self> {
        let product =
            |i: usize, j: usize| by_pixel[0][i] * by_pixel[0][j] + by_pixel[1][i] * by_pixel[1][j] + by_pixel[2][i] * by_pixel[2][j];
        let (uu, uv, vv) = (product(0, 0), product(0, 1), product(1, 1));
        let determinant = uu * vv - uv * uv;
        if determinant.is_nan() || determinant <= 0.0 {
            return None;
        }
        let inverse = Self([
            std::array::from_fn(|axis| (vv * by_pixel[axis][0] - uv * by_pixel[axis][1]) / determinant),
            std::array::from_fn(|axis| (uu * by_pixel[axis][1] - uv * by_pixel[axis][0]) / determinant),
        ]);
        let [x, y, z] = [arrives.x, arrives.y, arrives.z];
        row.residual = inverse.pixels([direction[0] - x, direction[1] - y, direction[2] - z]);
        for (columns, j) in row.by_rotation.iter_mut().zip(&inverse.0) {
            // φ × a for the unit rotations about the three axes.
            *columns = [-(j[2] * y - j[1] * z), -(j[0] * z - j[2] * x), -(j[1] * x - j[0] * y)];
        }
        row.residual.iter().all(|r| r.is_finite()).then_some(inverse)
    }

    fn pixels(&self, change: [f64; 3]) -> [f64; 2] {
        self.0.map(|j| j[0] * change[0] + j[1] * change[1] + j[2] * change[2])
    }
}

/// The rotation from ICRS axes to the Earth's.
pub(in crate::calibrate) fn earth_from_icrs(observation: &Observation) -> Option<UnitQuaternion<f64>> {
    let rows = observation.earth_from_icrs?;
    let matrix = Matrix3::from_fn(|row, column| rows[row][column]);
    Some(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix)))
}

//! State of a sequential calibration between updates, and its check when it is read from a file.

use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{SequentialError, UpdateOptions};
use crate::calibrate::bundle::{self, NoiseMemory, Updated};
use crate::calibrate::{CalibrateOptions, Calibration, Method, Status};
use crate::camera::Model;
use crate::identify::ControlPoints;

/// The name of the file format.
pub const SEQUENTIAL_FORMAT: &str = "boresight-sequential/2";
/// The format before it, in which parameters stand in the order of their effects; it is read, too.
const OLDER_FORMAT: &str = "boresight-sequential/1";

/// The state as files have it. Its size depends on the number of parameters alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub(super) struct State {
    /// [`SEQUENTIAL_FORMAT`].
    pub(super) format: String,
    /// −1 if the images are mirrored; everything here is of the un-mirrored image.
    pub(super) parity: i8,
    /// The camera with every effect in force, at the estimate.
    pub(super) model: Model,
    /// Names of the solved parameters, in the model's order.
    pub(super) solved: Vec<String>,
    /// Information on them for unit weight, in their own units, attitudes eliminated.
    pub(super) information: Vec<Vec<f64>>,
    /// Frames so far.
    pub(super) frames: usize,
    /// Star images used so far.
    pub(super) stars: usize,
    /// Updates so far.
    pub(super) updates: usize,
    /// τ², px² per axis.
    pub(super) floor_px2: f64,
    /// Share of wrong identifications.
    pub(super) wrong_share: f64,
    /// Radius in which they fall.
    pub(super) wrong_radius_px: f64,
    /// Sums over the star images, for the noise.
    pub(super) noise: NoiseMemory,
    /// Ids of the effects that the star directions contain.
    pub(super) physics: Vec<String>,
    /// How it was solved; new frames are selected and solved in the same way.
    pub(super) options: CalibrateOptions,
}

fn bad(place: impl Into<String>, value: impl std::fmt::Display, remedy: &'static str) -> SequentialError {
    SequentialError::BadState { place: place.into(), value: value.to_string(), remedy }
}

impl State {
    /// From a calibration of the joint method.
    pub(super) fn of(calibration: &Calibration) -> Result<Self, SequentialError> {
        let found = match calibration.noise {
            Some(noise) if calibration.method == Method::Bundle => noise,
            _ => return Err(SequentialError::NotJoint { method: calibration.method.name() }),
        };
        if calibration.status != Status::Converged {
            return Err(SequentialError::NotConverged);
        }
        let n = calibration.parameters.len();
        let square = calibration.covariance.len() == n && calibration.covariance.iter().all(|row| row.len() == n);
        let covariance = square.then(|| DMatrix::from_fn(n, n, |i, j| calibration.covariance[i][j]));
        let information = covariance.and_then(|covariance| bundle::inverse(&covariance));
        let information = information
            .ok_or_else(|| bad("covariance", "a matrix without inverse", "give a calibration whose parameters are determined"))?;
        let camera = calibration.camera;
        let mut state = Self {
            format: SEQUENTIAL_FORMAT.to_owned(),
            parity: calibration.parity,
            model: calibration.full_chain(),
            solved: calibration.parameters.iter().map(|parameter| parameter.name.clone()).collect(),
            information: rows(&(information * found.unit_weight_variance)),
            frames: calibration.per_frame.iter().filter(|frame| frame.stars > 0).count(),
            stars: calibration.stars,
            updates: 0,
            floor_px2: found.floor_px * found.floor_px,
            wrong_share: found.wrong_share,
            wrong_radius_px: 0.05 * (camera.width_px as f64).hypot(camera.height_px as f64),
            noise: memory(calibration),
            physics: calibration.physics.clone(),
            options: calibration.options.clone(),
        };
        let mut wrong: Vec<f64> = calibration.rejected.iter().filter_map(|point| point.residual_px.map(|[x, y]| x.hypot(y))).collect();
        if wrong.len() >= 5 {
            wrong.sort_by(f64::total_cmp);
            state.wrong_radius_px = 1.5 * wrong[wrong.len() / 2];
        }
        state.wrong_radius_px = state.wrong_radius_px.max(20.0 * calibration.predicted_sigma_px);
        state.check()?;
        Ok(state)
    }

    /// Whether it can be gone on with.
    pub(super) fn check(&self) -> Result<(), SequentialError> {
        if ![SEQUENTIAL_FORMAT, OLDER_FORMAT].contains(&self.format.as_str()) {
            return Err(bad(
                "format",
                &self.format,
                "give a file of the format boresight-sequential/2, as `calibrate --update … -o DIR` writes it",
            ));
        }
        if self.parity.abs() != 1 {
            return Err(bad("parity", self.parity, "it is 1 or -1"));
        }
        let known = self.model.parameters();
        let places: Option<Vec<usize>> = self.solved.iter().map(|name| known.iter().position(|p| p.name == *name)).collect();
        if self.solved.is_empty() || places.is_none_or(|places| places.windows(2).any(|pair| pair[0] >= pair[1])) {
            return Err(bad("solved", self.solved.join(", "), "name parameters of the model, once each and in its order"));
        }
        if let Some((value, parameter)) = self.model.values().iter().zip(&known).find(|(value, _)| !value.is_finite()) {
            return Err(bad(format!("model.{}", parameter.name), value, "parameters are finite numbers"));
        }
        let n = self.solved.len();
        if self.information.len() != n || self.information.iter().any(|row| row.len() != n) {
            let columns = self.information.first().map_or(0, Vec::len);
            return Err(bad(
                "information",
                format!("a matrix of {} × {columns}", self.information.len()),
                "it has a row and a column for each solved parameter",
            ));
        }
        let entries = (0..n).flat_map(|i| (0..n).map(move |j| (i, j)));
        let size = |i: usize, j: usize| (self.information[i][i] * self.information[j][j]).sqrt();
        let wrong = |(i, j): &(usize, usize)| {
            let (value, other) = (self.information[*i][*j], self.information[*j][*i]);
            !value.is_finite() || (value - other).abs() > 1e-9 * size(*i, *j)
        };
        if let Some((i, j)) = entries.into_iter().find(wrong) {
            return Err(bad(format!("information[{i}][{j}]"), self.information[i][j], "the matrix is finite and symmetric"));
        }
        if bundle::inverse(&self.matrix()).is_none() {
            return Err(bad("information", "a matrix that is not positive definite", "every combination of parameters must be known"));
        }
        self.check_noise()
    }

    fn check_noise(&self) -> Result<(), SequentialError> {
        let numbers = [
            ("floor_px2", self.floor_px2),
            ("wrong_share", self.wrong_share),
            ("wrong_radius_px", self.wrong_radius_px),
            ("noise.images", self.noise.images),
            ("noise.lost", self.noise.lost),
        ];
        if let Some((name, value)) = numbers.into_iter().find(|(_, value)| !(value.is_finite() && *value >= 0.0)) {
            return Err(bad(name, value, "it is a finite number, 0 or above"));
        }
        if self.wrong_share >= 1.0 {
            return Err(bad("wrong_share", self.wrong_share, "it is below 1"));
        }
        if self.noise.classes.len() != bundle::CLASSES {
            return Err(bad("noise.classes", format!("{} classes", self.noise.classes.len()), "there are 36"));
        }
        for (k, class) in self.noise.classes.iter().enumerate() {
            for (name, value) in [("weight", class.weight), ("stated_px2", class.stated_px2), ("square_px2", class.square_px2)] {
                if !(value.is_finite() && value >= 0.0) {
                    return Err(bad(format!("noise.classes[{k}].{name}"), value, "it is a finite number, 0 or above"));
                }
            }
        }
        if self.freedom() <= 0.0 {
            return Err(bad("noise.classes", format!("{} star images", self.noise.weight()), "there are more equations than unknowns"));
        }
        Ok(())
    }

    /// Whether new frames and options go with it.
    pub(super) fn check_update(&self, points: &ControlPoints, options: &UpdateOptions) -> Result<(), SequentialError> {
        let camera = self.model.camera();
        let (new, known) = ([points.nominal.width_px, points.nominal.height_px], [camera.width_px, camera.height_px]);
        if new != known {
            return Err(SequentialError::OtherFrame { new, known });
        }
        let refuse =
            |name: &'static str, value: String, allowed: &str| Err(SequentialError::BadOption { name, value, allowed: allowed.to_owned() });
        if let Some(frames) = options.forget_frames.filter(|frames| !(frames.is_finite() && *frames > 0.0)) {
            return refuse("forget_frames", frames.to_string(), "give a number of frames above 0");
        }
        if !(0.0..1.0).contains(&options.change_probability) {
            return refuse("change_probability", options.change_probability.to_string(), "give a probability from 0 to below 1");
        }
        for drift in &options.drift {
            if !self.solved.contains(&drift.name) {
                return refuse("drift", drift.name.clone(), &format!("name a solved parameter ({})", self.solved.join(", ")));
            }
            if !(drift.sigma_per_frame.is_finite() && drift.sigma_per_frame > 0.0) {
                return refuse("drift", format!("{}={}", drift.name, drift.sigma_per_frame), "give a standard deviation above 0");
            }
        }
        Ok(())
    }

    /// Time passes: `frames` new frames have come.
    pub(super) fn forget(&mut self, frames: usize, options: &UpdateOptions) -> Result<(), SequentialError> {
        if let Some(memory) = options.forget_frames {
            let kept = (-(frames as f64) / memory).exp();
            self.information.iter_mut().flatten().for_each(|value| *value *= kept);
            self.noise.scale(kept);
        }
        if options.drift.is_empty() {
            return Ok(());
        }
        let lost = || bad("information", "a matrix that is not positive definite", "every combination of parameters must be known");
        let mut covariance = bundle::inverse(&self.matrix()).ok_or_else(lost)?;
        let unit = self.unit();
        for drift in &options.drift {
            if let Some(k) = self.solved.iter().position(|name| *name == drift.name) {
                covariance[(k, k)] += frames as f64 * drift.sigma_per_frame.powi(2) / unit;
            }
        }
        self.information = rows(&bundle::inverse(&covariance).ok_or_else(lost)?);
        Ok(())
    }

    /// What was known before counts for nothing.
    pub(super) fn restart(&mut self) {
        (self.noise, self.frames, self.stars) = (NoiseMemory::default(), 0, 0);
    }

    /// Goes on from the solution with the new frames.
    pub(super) fn take(&mut self, updated: Updated) -> Result<(), SequentialError> {
        self.model = updated.model;
        self.information = rows(&updated.information);
        self.frames += updated.frames;
        self.stars += updated.stars;
        self.updates += 1;
        self.floor_px2 = updated.noise.floor_px2;
        self.wrong_share = updated.noise.wrong_share;
        self.wrong_radius_px = updated.noise.wrong_radius_px;
        self.noise.merge(&updated.memory, updated.squares);
        self.check()
    }

    /// The information matrix.
    pub(super) fn matrix(&self) -> DMatrix<f64> {
        let n = self.solved.len();
        DMatrix::from_fn(n, n, |i, j| self.information[i][j])
    }

    /// Degrees of freedom of the residuals so far.
    fn freedom(&self) -> f64 {
        2.0 * self.noise.weight() - self.noise.lost - self.solved.len() as f64
    }

    /// The variance of unit weight.
    pub(super) fn unit(&self) -> f64 {
        self.noise.chi_squared(self.floor_px2) / self.freedom().max(1.0)
    }
}

fn rows(matrix: &DMatrix<f64>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

/// Sums over the star images of a calibration.
fn memory(calibration: &Calibration) -> NoiseMemory {
    let mut memory = NoiseMemory::default();
    let f = calibration.camera.focal_length_px;
    let factor = |frame: usize| calibration.per_frame.iter().find(|of| of.frame == frame).map_or(1.0, |of| of.variance_factor);
    let (mut frame, mut of_frame) = (usize::MAX, 1.0);
    for (result, point) in calibration.points.iter().zip(&calibration.control_points.points).filter(|(r, _)| r.left_out.is_none()) {
        let Some([x, y]) = result.residual_px else { continue };
        if point.frame != frame {
            (frame, of_frame) = (point.frame, factor(point.frame));
        }
        let stated = f64::midpoint(point.covariance_px2[0], point.covariance_px2[2]) + (point.catalog_sigma_rad * f).powi(2);
        memory.add(stated, (x * x + y * y) / of_frame, result.weight);
    }
    let lost = (2 * calibration.stars).saturating_sub(calibration.degrees_of_freedom + calibration.parameters.len());
    memory.lost = lost as f64;
    memory
}

//! Sequential calibration: a solution is updated with new frames, and what is kept of the old ones does not grow.
//!
//! Kept are a Gaussian for the parameters (value and information matrix, the attitudes eliminated) and sums over the star images by stated
//! variance, from which the noise is found. New frames are solved with that Gaussian as the prior; it is linearised anew at
//! every estimate. Before they count, they are tested for being of the same camera: a sudden change is reported and not averaged in.
//!
//! What differs from all frames solved at once: the Gaussian is good to the second order of the mapping (a few hundredths of a standard
//! error, least if the first calibration is of eight frames or more), old star images keep the probability of being right that they had when they came, and
//! frames of a fixed mount share its attitude within one update only.

mod options;
mod state;

use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use options::{Drift, OnChange, ParameterChange, SequentialError, UpdateOptions, UpdateReport};
pub use state::SEQUENTIAL_FORMAT;
use state::State;

use super::bundle::{self, Known, Updated};
use super::check::check_points;
use super::{CalibrateError, Calibration, ParameterEstimate, select};
use crate::camera::{Camera, Model};
use crate::identify::ControlPoints;

/// What remains of the information after a restart: hardly anything, but no parameter is left open.
const RESTART: f64 = 1e-4;

/// A calibration that goes on with new frames, in constant memory. In files it is [`SEQUENTIAL_FORMAT`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "State", into = "State")]
pub struct Sequential {
    state: State,
}

impl From<Sequential> for State {
    fn from(sequential: Sequential) -> Self {
        sequential.state
    }
}

impl TryFrom<State> for Sequential {
    type Error = SequentialError;

    fn try_from(state: State) -> Result<Self, SequentialError> {
        state.check()?;
        Ok(Self { state })
    }
}

impl Sequential {
    /// Begins with a calibration by the joint method.
    ///
    /// # Errors
    /// If it is of another method, has not converged, or its covariance cannot be inverted.
    pub fn from_calibration(calibration: &Calibration) -> Result<Self, SequentialError> {
        Ok(Self { state: State::of(calibration)? })
    }

    /// The camera, of the un-mirrored image.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        self.state.model.camera()
    }

    /// The camera with every effect in force, of the un-mirrored image.
    #[must_use]
    pub fn model(&self) -> &Model {
        &self.state.model
    }

    /// −1 if the images are mirrored, else +1.
    #[must_use]
    pub fn parity(&self) -> i8 {
        self.state.parity
    }

    /// Frames so far.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.state.frames
    }

    /// Star images used so far.
    #[must_use]
    pub fn stars(&self) -> usize {
        self.state.stars
    }

    /// Updates so far.
    #[must_use]
    pub fn updates(&self) -> usize {
        self.state.updates
    }

    /// Error per axis that all star images have beyond what their measurement states, px.
    #[must_use]
    pub fn floor_px(&self) -> f64 {
        self.state.floor_px2.sqrt()
    }

    /// Share of wrong identifications so far.
    #[must_use]
    pub fn wrong_share(&self) -> f64 {
        self.state.wrong_share
    }

    /// Weighted sum of squares over its degrees of freedom: one if the stated errors and the floor are right.
    #[must_use]
    pub fn unit_weight_variance(&self) -> f64 {
        self.state.unit()
    }

    /// The solved parameters with their standard errors.
    #[must_use]
    pub fn parameters(&self) -> Vec<ParameterEstimate> {
        let covariance = self.covariance();
        let all = self.state.model.parameters();
        let values = self.state.model.values();
        let estimate = |(k, name): (usize, &String)| {
            let place = all.iter().position(|parameter| parameter.name == *name)?;
            let sigma = covariance[k][k].max(0.0).sqrt();
            Some(ParameterEstimate {
                name: name.clone(),
                value: values[place],
                sigma,
                sigma_joint: sigma,
                unit: all[place].unit.to_owned(),
            })
        };
        self.state.solved.iter().enumerate().filter_map(estimate).collect()
    }

    /// Covariance of the solved parameters, in their order and units.
    #[must_use]
    pub fn covariance(&self) -> Vec<Vec<f64>> {
        let n = self.state.solved.len();
        let unit = self.state.unit();
        // A state is checked when it is made, so the inverse exists.
        let inverse = bundle::inverse(&self.state.matrix()).unwrap_or_else(|| DMatrix::from_element(n, n, f64::NAN));
        (0..n).map(|i| (0..n).map(|j| unit * inverse[(i, j)]).collect()).collect()
    }

    /// Takes new frames; nothing is forgotten, and frames of a changed camera are refused.
    ///
    /// # Errors
    /// See [`Self::update_with`].
    pub fn update(&mut self, points: &ControlPoints) -> Result<UpdateReport, SequentialError> {
        self.update_with(points, &UpdateOptions::default())
    }

    /// Takes new frames, of the un-mirrored image.
    ///
    /// # Errors
    /// If the options or points make no sense, the frames are of another size, the star directions contain other effects, or no frame
    /// finds an attitude. Then the calibration stays as it was.
    pub fn update_with(&mut self, points: &ControlPoints, options: &UpdateOptions) -> Result<UpdateReport, SequentialError> {
        self.state.check_update(points, options)?;
        check_points(points, &self.state.options)?;
        let selection = select::select(points, &self.state.options);
        let mut prior = self.clone();
        prior.state.forget(selection.frames.len(), options)?;
        let before = prior.parameters();
        let mut solved = prior.solve(points, &selection, 1.0)?;
        let change = solved.change.clone();
        let changed = change.probability < options.change_probability;
        if changed && options.on_change == OnChange::Restart {
            prior.state.restart();
            solved = prior.solve(points, &selection, RESTART)?;
        }
        let taken = solved.converged && !(changed && options.on_change == OnChange::Refuse);
        let (frames, stars, rms_px, converged, warnings) =
            (solved.frames, solved.stars, solved.rms_px, solved.converged, std::mem::take(&mut solved.notes));
        if taken {
            prior.state.take(solved)?;
            self.state = prior.state;
        }
        let parameters = before
            .into_iter()
            .zip(self.parameters())
            .zip(change.steps_sigma)
            .map(|((before, after), moved_sigma)| ParameterChange {
                name: before.name,
                before: before.value,
                sigma_before: before.sigma,
                after: after.value,
                sigma_after: after.sigma,
                moved_sigma,
                unit: before.unit,
            })
            .collect();
        Ok(UpdateReport {
            taken,
            converged,
            changed,
            change_chi_squared: change.chi_squared,
            change_degrees: change.degrees,
            change_probability: change.probability,
            frames,
            stars_offered: points.points.len(),
            stars,
            rms_px,
            parameters,
            warnings,
        })
    }

    fn solve(&self, points: &ControlPoints, selection: &select::Selection, factor: f64) -> Result<Updated, CalibrateError> {
        let state = &self.state;
        let known = Known {
            model: &state.model,
            names: &state.solved,
            information: state.matrix() * factor,
            memory: &state.noise,
            floor_px2: state.floor_px2,
            wrong_radius_px: state.wrong_radius_px,
        };
        bundle::update(points, &state.options, selection, &known)
    }
}

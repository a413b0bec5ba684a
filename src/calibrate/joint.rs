//! Bundle adjustment for other modules: residuals of every star image, the design columns of any effect at the solution, and the solution anew with
//! other effects and given weights. Nothing is left out and nothing is decided here. All columns are taken at the predicted points.

use std::collections::BTreeMap;

use super::bundle::{self, Noise, Problem, Run, Solved, State, scales};
use super::check::check_points;
use super::{CalibrateError, CalibrateOptions, select};
use crate::camera::{Model, Term};
use crate::coordinates::{Apparent, Attitude, Direction};
use crate::effects::{Observation, Segment, Signature, displacement};
use crate::identify::ControlPoints;
use crate::parallel;

/// Own parameters of a frame at most: its attitude, and its rates where they are solved.
pub const MAX_FRAME_PARAMETERS: usize = bundle::MAX_FRAME_PARAMETERS;

/// One star image at the solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BundleImage {
    /// Index of its control point.
    pub point: usize,
    /// Its frame in the recording.
    pub frame: usize,
    /// Catalogue direction of its star, which tells stars apart.
    pub star_direction: [f64; 3],
    /// Measured position.
    pub measured_px: [f64; 2],
    /// Measured minus predicted, px.
    pub residual_px: [f64; 2],
    /// Covariance that the measurement states, the catalogue's error included: xx, xy, yy, px².
    pub stated_px2: [f64; 3],
    /// Change of the residual with the frame's own parameters (attitude about the camera's axes in rad, rates in rad/s), by axis.
    pub own: [[f64; MAX_FRAME_PARAMETERS]; 2],
    /// The probability that the identification is right, as the robust solution has it.
    pub weight: f64,
}

/// Columns of a parameter: the change of every image's residual with it, px per unit, in the order of [`BundleSolution::images`].
pub type Column = Vec<[f64; 2]>;

/// The errors that an adjustment reckons with: stated covariance times the frame's factor, plus a floor; and a weight for each image.
#[derive(Clone, Debug, PartialEq)]
pub struct FixedNoise {
    /// Floor, px² per axis.
    pub floor_px2: f64,
    /// Factor on the variances of every frame taking part, in the order of [`BundleSolution::frames`].
    pub factors: Vec<f64>,
    /// Weight of every image, in the order of [`BundleSolution::images`].
    pub weights: Vec<f64>,
}

/// A joint solution.
#[derive(Clone, Debug)]
pub struct BundleSolution {
    solved: Solved,
}

impl BundleSolution {
    /// Solves for the camera from nothing but ground values; robust. Every point takes part but those that a rule of `options` leaves out.
    pub fn solve(points: &ControlPoints, options: &CalibrateOptions) -> Result<Self, CalibrateError> {
        check_points(points, options)?;
        let selection = select::select(points, options);
        let usable: usize = selection.frames.iter().map(|frame| frame.stars.len()).sum();
        if usable == 0 {
            return Err(CalibrateError::TooFewPoints { offered: points.points.len(), usable, frames: selection.frames.len() });
        }
        let mut solved = bundle::solve(points, options, &selection)?;
        solved.problem.at_predicted = true;
        Ok(Self { solved })
    }

    /// The model at the solution.
    #[must_use]
    pub fn model(&self) -> &Model {
        &self.solved.problem.model
    }

    /// Names of the parameters that were solved, in the model's order.
    #[must_use]
    pub fn solved_for(&self) -> Vec<String> {
        bundle::names(&self.solved.problem)
    }

    /// What the solution wants to be minded.
    #[must_use]
    pub fn notes(&self) -> &[String] {
        &self.solved.notes
    }

    /// Frames (their places in the recording) that take part, with what is known of them.
    #[must_use]
    pub fn frames(&self) -> Vec<(usize, Observation)> {
        let of = |exposure: &bundle::Exposure| (exposure.frame, exposure.observation);
        self.solved.problem.exposures.iter().map(of).collect()
    }

    /// The attitude of a frame (by its place among [`Self::frames`]), if it has one.
    #[must_use]
    pub fn attitude(&self, place: usize) -> Option<Attitude> {
        self.solved.problem.attitude(&self.solved.adjusted.state, place).map(Attitude::new)
    }

    /// Own parameters of each frame: 3, or 6 with rates, or none where the mount is fixed.
    #[must_use]
    pub fn own_count(&self) -> usize {
        self.solved.problem.local_count()
    }

    /// Variance factors of the frames as the robust solution found them, in the order of [`Self::frames`].
    #[must_use]
    pub fn frame_factors(&self) -> &[f64] {
        &self.solved.adjusted.noise.frame_factors
    }

    /// What all star images have beyond their stated errors, px² per axis, as the robust solution found it.
    #[must_use]
    pub fn floor_px2(&self) -> f64 {
        self.solved.adjusted.noise.floor_px2
    }

    /// Every star image that has a residual, frame by frame.
    #[must_use]
    pub fn images(&self) -> Vec<BundleImage> {
        let (problem, adjusted) = (&self.solved.problem, &self.solved.adjusted);
        let of = |place: usize| {
            let exposure = &problem.exposures[place];
            let mut found = Vec::with_capacity(exposure.images.len());
            problem.linearise(&adjusted.state, place, |index, row| {
                let image = &exposure.images[index];
                let [xx, xy, yy] = image.covariance_px2;
                let catalog = (image.catalog_sigma_rad * adjusted.noise.focal_length_px).powi(2);
                let mut own = [[0.0; MAX_FRAME_PARAMETERS]; 2];
                let time_s = Problem::row_time_s(&exposure.observation, image.pixel[1]);
                for (own, columns) in own.iter_mut().zip(&row.by_rotation) {
                    own[..3].copy_from_slice(columns);
                    for axis in 0..3 {
                        own[3 + axis] = -time_s * columns[axis];
                    }
                }
                found.push(BundleImage {
                    point: image.point,
                    frame: exposure.frame,
                    star_direction: image.star.direction,
                    measured_px: image.pixel,
                    residual_px: row.residual,
                    stated_px2: [xx + catalog, xy, yy + catalog],
                    own,
                    weight: adjusted.weights[place].get(index).copied().unwrap_or(0.0),
                });
            });
            found
        };
        parallel::map_numbers(problem.exposures.len(), of).into_iter().flatten().collect()
    }

    /// The same star images as the solution simulates them, without errors: every star's light sent through the model the way a renderer sends
    /// it, from the catalogue to the pixel. Control point and place. Where each frame's own rates are solved, from the residuals.
    #[must_use]
    pub fn simulated_px(&self) -> Vec<(usize, [f64; 2])> {
        let (problem, state) = (&self.solved.problem, &self.solved.adjusted.state);
        let of = |place: usize| {
            let exposure = &problem.exposures[place];
            let mut found = Vec::with_capacity(exposure.images.len());
            let turns = state.rates[place].iter().any(|rate| *rate != 0.0);
            problem.linearise(state, place, |index, row| {
                let image = &exposure.images[index];
                let context = image.context(&exposure.observation);
                let sent = problem.attitude(state, place).filter(|_| !turns).and_then(|attitude| {
                    let apparent = if problem.solves_sky {
                        problem.model.apparent(&context)
                    } else {
                        Direction::<Apparent>::from_unit(image.apparent)
                    };
                    problem.model.pixel(&Attitude::new(attitude).camera_from_apparent(&apparent), &context)
                });
                let [x, y] = [0, 1].map(|axis| image.pixel[axis] - row.residual[axis]);
                found.push((image.point, sent.map_or([x, y], |point| [point.x_px, point.y_px])));
            });
            found
        };
        parallel::map_numbers(problem.exposures.len(), of).into_iter().flatten().collect()
    }

    /// The same problem with other measured positions, by control point; images of which none is given keep theirs. Not solved yet: see
    /// [`Self::again`].
    #[must_use]
    pub fn with_measured(&self, measured: &[(usize, [f64; 2])]) -> Self {
        let by_point: BTreeMap<usize, [f64; 2]> = measured.iter().copied().collect();
        let mut other = self.clone();
        for image in other.solved.problem.exposures.iter_mut().flat_map(|exposure| &mut exposure.images) {
            image.pixel = by_point.get(&image.point).copied().unwrap_or(image.pixel);
        }
        other
    }

    /// Columns of the parameters that were solved.
    #[must_use]
    pub fn solved_columns(&self) -> Vec<Column> {
        columns(&self.solved.problem, &self.solved.adjusted.state)
    }

    /// Columns of parameters of an effect, at the effect's present values if it is in force, else at `start`. `None` where a value
    /// is out of the effect's range.
    #[must_use]
    pub fn columns_of(&self, effect: &str, start: &[f64], wanted: &[usize]) -> Option<Vec<Column>> {
        let mut problem = self.solved.problem.clone();
        if problem.model.terms().all(|(id, _)| id != effect) {
            problem.model.set(effect, start).ok()?;
        }
        let parameters = problem.model.parameters();
        let mine = |index: &usize| parameters[*index].effect == effect && wanted.contains(&parameters[*index].index);
        problem.free = (0..parameters.len()).filter(mine).collect();
        problem.priors.clear();
        problem.carried = None;
        problem.solves_sky |= displacement(effect)?.segment() == Segment::Sky;
        let state = State { values: problem.model.values(), ..self.solved.adjusted.state.clone() };
        Some(columns(&problem, &state))
    }

    /// The same solution with other knowledge of the frames.
    #[must_use]
    pub fn with_observations(&self, change: impl Fn(&Observation) -> Observation) -> Self {
        let mut other = self.clone();
        for exposure in &mut other.solved.problem.exposures {
            exposure.observation = change(&exposure.observation);
        }
        other
    }

    /// The same with a change for each frame by its place.
    #[must_use]
    pub fn with_frames(&self, change: impl Fn(usize, &Observation) -> Observation) -> Self {
        let mut other = self.clone();
        for (place, exposure) in other.solved.problem.exposures.iter_mut().enumerate() {
            exposure.observation = change(place, &exposure.observation);
        }
        other
    }

    /// The same solution with shifts of measured centres that were found by rendering, by control point: where an effect on the measured centre
    /// is in force, they stand in the place of its formula.
    #[must_use]
    pub fn with_signatures(&self, found: &BTreeMap<usize, Signature>) -> Self {
        let mut other = self.clone();
        for image in other.solved.problem.exposures.iter_mut().flat_map(|exposure| &mut exposure.images) {
            if let Some(signature) = found.get(&image.point) {
                // Without room for it the formula stays.
                let _has_room = image.state.signatures.set(*signature);
            }
        }
        other
    }

    /// The solution anew, from here: with `terms` in force beside the model's own (replacing those of the same id), the parameters that
    /// `solve` names free, and the errors as given. What is minimised is the plain weighted sum of squares.
    pub fn again(&self, terms: &[Term], solve: &[String], noise: &FixedNoise) -> Result<Self, CalibrateError> {
        let mut problem = self.solved.problem.clone();
        let refuse =
            |name: &str, error: crate::camera::ModelError| CalibrateError::NotSolvable { name: name.to_owned(), reason: error.to_string() };
        for term in terms {
            problem.model.set(&term.effect, &term.parameters).map_err(|error| refuse(&term.effect, error))?;
        }
        problem.solves_sky |= terms.iter().any(|term| displacement(&term.effect).is_some_and(|effect| effect.segment() == Segment::Sky));
        let observations: Vec<_> = problem.exposures.iter().map(|exposure| exposure.observation).collect();
        let first = problem.exposures.iter().find_map(|exposure| Some(exposure.images.first()?.context(&exposure.observation)));
        let first = first.ok_or(CalibrateError::TooFewPoints { offered: 0, usable: 0, frames: 0 })?;
        problem.free = bundle::solve_for(&mut problem.model, solve, &first, &observations)?;
        problem.priors.clear();
        problem.carried = None;
        let state = State { values: problem.model.values(), ..self.solved.adjusted.state.clone() };
        let mut given = noise.weights.iter();
        let mut weights: Vec<Vec<f64>> = problem.exposures.iter().map(|exposure| vec![0.0; exposure.images.len()]).collect();
        for (place, own) in weights.iter_mut().enumerate() {
            problem.linearise(&state, place, |index, _| own[index] = given.next().copied().unwrap_or(0.0));
        }
        let noise = Noise {
            floor_px2: noise.floor_px2,
            frame_factors: noise.factors.clone(),
            focal_length_px: state.values[2],
            unit_variance: 1.0,
            ..self.solved.adjusted.noise.clone()
        };
        let scale = scales(&problem, &state);
        let mut notes = self.solved.notes.clone();
        notes.extend(bundle::drop_without_effect(&mut problem, &scale));
        let scale = scales(&problem, &state);
        let run = Run { epsilon_px: 1e-6, max_turns: 20, from_afar: false, hold_noise: true };
        let adjusted = problem.adjust(state, noise, &scale, &run, Some(&weights));
        problem.model.set_values(&adjusted.state.values);
        Ok(Self { solved: Solved { problem, adjusted, notes, alternative: None } })
    }
}

/// Columns of the free parameters of a problem.
fn columns(problem: &Problem, state: &State) -> Vec<Column> {
    let count = problem.free.len();
    let of = |place: usize| {
        let mut own: Vec<Column> = vec![Column::new(); count];
        problem.linearise(state, place, |_, row| {
            for (k, column) in own.iter_mut().enumerate() {
                column.push([row.by_parameter[0][k], row.by_parameter[1][k]]);
            }
        });
        own
    };
    let parts: Vec<Vec<Column>> = parallel::map_numbers(problem.exposures.len(), of);
    let mut all: Vec<Column> = vec![Column::new(); count];
    for part in parts {
        for (column, own) in all.iter_mut().zip(part) {
            column.extend(own);
        }
    }
    all
}

//! Robust bundle adjustment: Gauss–Newton steps with Levenberg–Marquardt damping, attitudes eliminated, weights and noise estimated on the way.
//!
//! Each iteration linearises all star images once, weighs them ([`super::noise`]), eliminates the attitudes ([`super::normal`]) and moves.
//! Parameters come in stages: the focal length, then the radial distortion, then the rest of the reference model, then everything, so
//! that wrong identifications lose their weight before weakly determined parameters are let free. While the steps are large the scale of
//! the noise comes from a median; then from the likelihood; at last it is held, and the iteration runs to its end.
//!
//! The result does not depend on the number of threads: frames are summed in their order.

use nalgebra::{DMatrix, DVector, UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::noise::{Noise, Sample, Totals, Whitened};
use super::normal::{Eliminated, FrameSums, MAX_LOCAL, MAX_PARAMETERS, Reduced, WIDTH};
use super::problem::{Attitudes, FrameParameters, Problem, Row, State};
use crate::camera::PARAMETER_NAMES;
use crate::parallel;

/// A step below this (px of mapping) ends the search for the noise.
const HOLD_NOISE_PX: f64 = 1e-3;
/// A step below this ends the robust phase.
const END_ROBUST_PX: f64 = 0.02;
/// Turns of the robust phase at most.
const ROBUST_TURNS: usize = 15;
/// Frames whose equations are summed by one thread.
const FRAMES_TOGETHER: usize = 64;
/// Turns in which the noise may change after that, at most.
const NOISE_TURNS: usize = 12;
/// Where parameters can hardly be told apart, steps may go to and fro, up and down by less than any error, and never become as small as is asked for: with
/// the noise held, so many steps uphill in all are the end if the last two are so small a part of the standard error of the mean of all images.
const UPHILL_STEPS: usize = 8;
const NEGLIGIBLE_SIGMAS: f64 = 0.01;

/// One turn of the iteration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::calibrate) struct Turn {
    /// Length of the step, px of mapping at the star images.
    pub(in crate::calibrate) step_px: f64,
    /// Typical standard error of a star image (per axis) at this turn, px.
    pub(in crate::calibrate) sigma_px: f64,
    /// Star images with a weight of at most one half.
    pub(in crate::calibrate) down_weighted: usize,
}

impl Turn {
    /// Whether the step is small against the error of the mean of so many images.
    fn is_negligible(&self, images: f64) -> bool {
        self.step_px < NEGLIGIBLE_SIGMAS * self.sigma_px / images.max(1.0).sqrt()
    }
}

/// Where an adjustment ended.
#[derive(Clone, Debug)]
pub(in crate::calibrate) struct Adjusted {
    /// Parameters and attitudes.
    pub(in crate::calibrate) state: State,
    /// The noise found.
    pub(in crate::calibrate) noise: Noise,
    /// px of mapping at the star images for a unit of each free parameter.
    pub(in crate::calibrate) scale: Vec<f64>,
    /// Whether the last step was small enough.
    pub(in crate::calibrate) converged: bool,
    /// The turns.
    pub(in crate::calibrate) turns: Vec<Turn>,
    /// Weight of each image, by exposure; 0 where the frame takes no part or the image has no direction.
    pub(in crate::calibrate) weights: Vec<Vec<f64>>,
    /// Information of the shared parameters (scaled), attitudes eliminated.
    pub(in crate::calibrate) information: DMatrix<f64>,
    /// Information on each exposure's attitude, the camera held.
    pub(in crate::calibrate) attitude_information: Vec<Option<nalgebra::Matrix3<f64>>>,
    /// Σ w·rᵀΣ⁻¹r.
    pub(in crate::calibrate) chi_squared: f64,
    /// Σ w.
    pub(in crate::calibrate) weight_sum: f64,
    /// What is minimised, with what is known beforehand.
    pub(in crate::calibrate) cost: f64,
}

/// Sums over all star images at one place.
struct Pass {
    frames: Vec<Option<FrameSums>>,
    samples: Vec<Vec<Sample>>,
    weights: Vec<Vec<f64>>,
    cost: f64,
    chi_squared: f64,
    totals: Totals,
}

/// How an adjustment runs.
#[derive(Clone, Copy, Debug)]
pub(in crate::calibrate) struct Run {
    /// The last step allowed, px.
    pub(in crate::calibrate) epsilon_px: f64,
    /// Turns at most.
    pub(in crate::calibrate) max_turns: usize,
    /// Whether to come from afar: stages and a robust scale; otherwise the state and the noise are near the end already.
    pub(in crate::calibrate) from_afar: bool,
    /// Whether the noise is held as it is.
    pub(in crate::calibrate) hold_noise: bool,
}

/// px of mapping at the star images for a unit of each free parameter; zero for one that moves none.
pub(in crate::calibrate) fn scales(problem: &Problem, state: &State) -> Vec<f64> {
    let of = |exposure: usize| {
        let (mut sums, mut count) = ([0.0; MAX_PARAMETERS], 0_usize);
        problem.linearise(state, exposure, |_, row| {
            for (k, sum) in sums.iter_mut().enumerate().take(problem.free.len()) {
                *sum += row.by_parameter[0][k].powi(2) + row.by_parameter[1][k].powi(2);
            }
            count += 1;
        });
        (sums, count)
    };
    let parts: Vec<_> = parallel::map_numbers(problem.exposures.len(), of);
    let (mut sums, mut count) = ([0.0; MAX_PARAMETERS], 0_usize);
    for (part, images) in parts {
        count += images;
        for (sum, one) in sums.iter_mut().zip(part) {
            *sum += one;
        }
    }
    (0..problem.free.len()).map(|k| (sums[k] / count.max(1) as f64).sqrt()).collect()
}

impl Problem {
    /// Sums over one exposure. `weigh` says how much each image counts; `scale` is that of the first free parameters, and the others are held.
    pub(super) fn frame_sums(
        &self,
        values: &[f64],
        own: Option<FrameParameters>,
        noise: &Noise,
        scale: &[f64],
        exposure: usize,
        mut weigh: impl FnMut(usize, &Row, &Whitened) -> f64,
    ) -> FrameSums {
        let fixed = self.attitudes == Attitudes::FixedToEarth;
        let (free, local) = (scale.len(), self.local_count());
        let shared = free + if fixed { 3 } else { 0 };
        let of = &self.exposures[exposure];
        let mut sums = FrameSums::new(shared, local);
        let Some(own) = own else { return sums };
        // Both rows of an image as the sums take them; every place below `width` is written anew for each image.
        let width = shared + local + 1;
        let mut rows = [[0.0; WIDTH]; 2];
        self.linearise_at(values, own, exposure, |index, row| {
            let image = &of.images[index];
            let white = noise.whiten(exposure, image, row.residual);
            let root = weigh(index, row, &white).sqrt();
            let [l_xx, l_yx, l_yy] = white.inverse.map(|l| root * l);
            let whiten = |x: f64, y: f64| [l_xx * x, l_yx * x + l_yy * y];
            for (k, scale) in scale.iter().enumerate() {
                let column = whiten(row.by_parameter[0][k] / scale, row.by_parameter[1][k] / scale);
                (rows[0][k], rows[1][k]) = (column[0], column[1]);
            }
            let time_s = if local == MAX_LOCAL { Self::row_time_s(&of.observation, image.pixel[1]) } else { 0.0 };
            // The mount's attitude follows the free parameters, a frame's own all that are shared.
            let at = if fixed { free } else { shared };
            let residual = whiten(row.residual[0], row.residual[1]);
            for axis in 0..3 {
                let column = whiten(row.by_rotation[0][axis], row.by_rotation[1][axis]);
                for side in 0..2 {
                    rows[side][at + axis] = column[side];
                    if local == MAX_LOCAL {
                        rows[side][at + 3 + axis] = -time_s * column[side];
                    }
                }
            }
            (rows[0][width - 1], rows[1][width - 1]) = (residual[0], residual[1]);
            sums.add_both(&rows);
        });
        if let Some(known) = of.known_attitude {
            let off = (own.attitude * known.camera_from_icrs.camera_from_icrs.inverse()).scaled_axis();
            let weight = noise.unit_variance / (known.sigma_rad * known.sigma_rad);
            for axis in 0..3 {
                // A turn of the mount turns the camera by as much.
                sums.add_known(if fixed { free + axis } else { shared + axis }, weight, off[axis]);
            }
        }
        if local == MAX_LOCAL {
            for axis in 0..3 {
                sums.add_known(shared + 3 + axis, noise.unit_variance / (RATE_SIGMA_RAD_S * RATE_SIGMA_RAD_S), own.rates[axis]);
            }
        }
        sums
    }

    fn pass(&self, state: &State, noise: &Noise, scale: &[f64], held: Option<&[Vec<f64>]>) -> Pass {
        let of = |exposure: usize| {
            let images = &self.exposures[exposure].images;
            let mut samples = Vec::with_capacity(images.len());
            let mut weights = vec![0.0; images.len()];
            let (mut cost, mut chi_squared, mut totals) = (0.0, 0.0, Totals::default());
            let own = self.own(state, exposure);
            let sums = self.frame_sums(&state.values, own, noise, scale, exposure, |index, row, white| {
                let image = &images[index];
                let weight = held.map_or(white.weight, |held| held[exposure][index]);
                cost += if held.is_some() { weight * white.square } else { 2.0 * white.cost };
                chi_squared += weight * white.square;
                weights[index] = weight;
                let catalog_px = image.catalog_sigma_rad * noise.focal_length_px;
                let sample = Sample {
                    stated_px2: f64::midpoint(image.covariance_px2[0], image.covariance_px2[2]) + catalog_px * catalog_px,
                    square_px2: row.residual[0].powi(2) + row.residual[1].powi(2),
                    weight,
                };
                totals.add(&sample);
                samples.push(sample);
                weight
            });
            cost += sums.prior_cost();
            (sums, samples, weights, cost, chi_squared, totals)
        };
        let parts: Vec<_> = parallel::map_numbers(self.exposures.len(), of);
        let (frames, samples, weights) = (Vec::new(), Vec::new(), Vec::new());
        let mut pass = Pass { frames, samples, weights, cost: 0.0, chi_squared: 0.0, totals: Totals::default() };
        for (sums, samples, weights, cost, chi_squared, totals) in parts {
            pass.frames.push((!samples.is_empty()).then_some(sums));
            pass.samples.push(samples);
            pass.totals.merge(&totals);
            pass.weights.push(weights);
            pass.cost += cost;
            pass.chi_squared += chi_squared;
        }
        for prior in &self.priors {
            pass.cost += noise.unit_variance * ((state.values[self.free[prior.free]] - prior.value) / prior.sigma).powi(2);
        }
        pass.cost += self.carried.as_ref().map_or(0.0, |carried| carried.cost(&self.free, &state.values));
        pass
    }

    /// The equations of the shared parameters, and what is needed to find the frames' own steps.
    fn reduce(&self, state: &State, pass: &Pass, noise: &Noise, scale: &[f64], damping: f64) -> (Reduced, Vec<Option<Eliminated>>) {
        // Always the same frames together, so that the sum does not depend on who makes it.
        let parts: Vec<(Reduced, Vec<Option<Eliminated>>)> = pass
            .frames
            .par_chunks(FRAMES_TOGETHER)
            .map(|frames| {
                let mut part = Reduced::zero(self.shared_count());
                let eliminated = frames.iter().map(|frame| frame.as_ref().and_then(|sums| sums.eliminate(damping, &mut part))).collect();
                (part, eliminated)
            })
            .collect();
        let mut reduced = Reduced::zero(self.shared_count());
        let mut eliminated = Vec::with_capacity(pass.frames.len());
        for (part, own) in parts {
            reduced.matrix += part.matrix;
            reduced.right += part.right;
            eliminated.extend(own);
        }
        for prior in &self.priors {
            let weight = noise.unit_variance / (prior.sigma * scale[prior.free]).powi(2);
            let off = (state.values[self.free[prior.free]] - prior.value) * scale[prior.free];
            reduced.matrix[(prior.free, prior.free)] += weight;
            reduced.right[prior.free] -= weight * off;
        }
        if let Some(carried) = &self.carried {
            carried.add_to(&mut reduced, &self.free, &state.values, scale);
        }
        (reduced, eliminated)
    }

    /// Adjusts.
    ///
    /// With `held` weights (by exposure and image) what is adjusted is a plain weighted sum of squares, with the noise held too: what nested
    /// models are compared by.
    pub(in crate::calibrate) fn adjust(
        &self,
        mut state: State,
        mut noise: Noise,
        scale: &[f64],
        run: &Run,
        held: Option<&[Vec<f64>]>,
    ) -> Adjusted {
        let all: Vec<bool> = vec![true; self.free.len()];
        let frames_lost: Vec<usize> = vec![self.local_count(); self.exposures.len()];
        let mut turns = if run.from_afar { self.approach(&mut state, &mut noise, scale, held, &frames_lost) } else { Vec::new() };
        let (mut robust, mut hold) = (run.from_afar, run.hold_noise || held.is_some());
        let (mut robust_turns, mut noise_turns) = (0, 0);
        let mut damping = 0.0;
        let mut before: Option<(State, Pass)> = None;
        let (mut converged, mut uphill) = (false, 0);
        let mut pass = self.pass(&state, &noise, scale, held);
        while turns.len() < run.max_turns {
            if let Some((old_state, old_pass)) = &before {
                // Only with the noise held is the cost of two turns the same function.
                if hold && pass.cost > old_pass.cost + 1e-9 * old_pass.cost.abs() && damping < 1e6 {
                    damping = (damping * 10.0_f64).max(1e-4);
                    uphill += 1;
                    let mut again = old_state.clone();
                    turns.push(self.turn(&mut again, old_pass, &noise, scale, &all, damping));
                    state = again;
                    pass = self.pass(&state, &noise, scale, held);
                    let mut last_two = turns.iter().rev().take(2);
                    let goes_to_and_fro = uphill >= UPHILL_STEPS && last_two.all(|turn| turn.is_negligible(pass.totals.weight));
                    if goes_to_and_fro || turns.last().is_some_and(|turn| turn.step_px <= run.epsilon_px) {
                        converged = true;
                        break;
                    }
                    continue;
                }
            }
            if !hold {
                self.learn(&mut noise, &pass, &state, &frames_lost, robust);
            }
            damping /= 10.0;
            let old_state = state.clone();
            let turn = self.turn(&mut state, &pass, &noise, scale, &all, if damping < 1e-8 { 0.0 } else { damping });
            turns.push(turn);
            before = hold.then_some((old_state, pass));
            pass = self.pass(&state, &noise, scale, held);
            if turn.step_px.is_nan() {
                break;
            }
            if robust {
                robust_turns += 1;
                robust = turn.step_px > END_ROBUST_PX && robust_turns < ROBUST_TURNS;
            } else if !hold {
                noise_turns += 1;
                hold = turn.step_px < HOLD_NOISE_PX || noise_turns >= NOISE_TURNS;
            } else if turn.step_px <= run.epsilon_px {
                converged = true;
                break;
            }
        }
        let (reduced, _) = self.reduce(&state, &pass, &noise, scale, 0.0);
        Adjusted {
            attitude_information: pass.frames.iter().map(|frame| frame.as_ref().map(FrameSums::own)).collect(),
            weight_sum: pass.totals.weight,
            cost: pass.cost,
            weights: pass.weights,
            information: reduced.matrix,
            chi_squared: pass.chi_squared,
            converged,
            turns,
            noise,
            scale: scale.to_vec(),
            state,
        }
    }

    /// The turns of an adjustment from afar, in which more and more parameters are free.
    fn approach(&self, state: &mut State, noise: &mut Noise, scale: &[f64], held: Option<&[Vec<f64>]>, frames_lost: &[usize]) -> Vec<Turn> {
        let mut turns = Vec::new();
        for (free, most) in self.stages() {
            for _ in 0..most {
                let pass = self.pass(state, noise, scale, held);
                let turn = self.turn(state, &pass, noise, scale, &free, 0.0);
                self.learn(noise, &pass, state, frames_lost, true);
                turns.push(turn);
                if turn.step_px < END_ROBUST_PX {
                    break;
                }
            }
        }
        turns
    }

    /// Which parameters are free in the stages of an adjustment from afar, and how many turns each may take.
    fn stages(&self) -> Vec<(Vec<bool>, usize)> {
        let with = |names: &[&str]| -> Vec<bool> {
            self.free.iter().map(|index| PARAMETER_NAMES.get(*index).is_some_and(|name| names.contains(name))).collect()
        };
        let mut stages = vec![(with(&["f"]), 2), (with(&["f", "k1"]), 3), (with(&PARAMETER_NAMES), 4)];
        stages.dedup_by(|a, b| a.0 == b.0);
        stages
    }

    fn learn(&self, noise: &mut Noise, pass: &Pass, state: &State, frames_lost: &[usize], robust: bool) {
        noise.focal_length_px = state.values[2];
        let active = pass.frames.iter().flatten().count();
        let lost = self.shared_count() + active * self.local_count();
        noise.update(&pass.samples, &pass.totals, lost, frames_lost, robust);
        let weight = pass.totals.weight + noise.before.weight();
        let freedom = (2.0 * weight - lost as f64 - noise.before.lost).max(1.0);
        let chi_squared = pass.chi_squared + noise.before.chi_squared(noise.floor_px2);
        noise.unit_variance = (chi_squared / freedom).clamp(MIN_UNIT_VARIANCE, 1.0 / MIN_UNIT_VARIANCE);
    }

    /// Moves by one step; parameters that are not `free` in this stage stay.
    fn turn(&self, state: &mut State, pass: &Pass, noise: &Noise, scale: &[f64], free: &[bool], damping: f64) -> Turn {
        let (mut reduced, eliminated) = self.reduce(state, pass, noise, scale, damping);
        for (k, _) in free.iter().enumerate().filter(|(_, free)| !**free) {
            reduced.matrix.row_mut(k).fill(0.0);
            reduced.matrix.column_mut(k).fill(0.0);
            reduced.matrix[(k, k)] = 1.0;
            reduced.right[k] = 0.0;
        }
        let camera = self.model.camera();
        let most_px = MAX_OPEN_STEP * (camera.width_px as f64).hypot(camera.height_px as f64);
        let step = solve(&reduced, self.free.len(), most_px);
        for (k, index) in self.free.iter().enumerate() {
            state.values[*index] += step[k] / scale[k];
        }
        if self.attitudes == Attitudes::FixedToEarth {
            let at = self.free.len();
            state.mount = UnitQuaternion::from_scaled_axis(Vector3::new(step[at], step[at + 1], step[at + 2])) * state.mount;
        } else {
            for (exposure, eliminated) in eliminated.iter().enumerate() {
                if let Some(eliminated) = eliminated {
                    state.move_own(exposure, eliminated.own_step(&step));
                }
            }
        }
        let stated = pass.totals.stated_px2 / pass.totals.count.max(1) as f64;
        Turn {
            step_px: step.rows(0, self.free.len()).norm(),
            sigma_px: (stated + noise.floor_px2).sqrt(),
            down_weighted: pass.totals.count - pass.totals.right,
        }
    }
}

/// Bounds of the residuals' variance against that stated, while the noise is not known yet.
const MIN_UNIT_VARIANCE: f64 = 1e-4;
/// Standard deviation of the rates' prior: a quick slew.
const RATE_SIGMA_RAD_S: f64 = 0.1;

/// Directions with less than this share of the largest eigenvalue (all parameters scaled alike) are open: no step goes along them, and
/// no standard error is stated for them.
pub(in crate::calibrate) const OPEN: f64 = 1e-12;
/// With less than this share a direction is hardly determined at all.
const HARDLY: f64 = 1e-4;
/// A step along such a direction is at most this share of the frame's diagonal: further than that the linearisation is not to be believed,
/// and the adjustment would begin anew at a place that nothing but noise has chosen.
const MAX_OPEN_STEP: f64 = 0.005;

/// The step; along directions that the star images leave open it is zero, and short along those hardly determined. The first `free` are
/// in px.
fn solve(reduced: &Reduced, free: usize, most_px: f64) -> DVector<f64> {
    let n = reduced.right.len();
    let root: Vec<f64> = (0..n).map(|k| reduced.matrix[(k, k)].max(0.0).sqrt()).collect();
    let inverse = |k: usize| if root[k] > 0.0 { 1.0 / root[k] } else { 0.0 };
    let matrix = DMatrix::from_fn(n, n, |i, j| reduced.matrix[(i, j)] * inverse(i) * inverse(j));
    let right = DVector::from_fn(n, |i, _| reduced.right[i] * inverse(i));
    let solved = match matrix.clone().cholesky() {
        Some(factor) if factor.l_dirty().diagonal().iter().all(|d| d * d > HARDLY) => factor.solve(&right),
        _ => {
            let eigen = matrix.symmetric_eigen();
            let largest = eigen.eigenvalues.max();
            let mut projected = eigen.eigenvectors.transpose() * right;
            for (k, (value, eigenvalue)) in projected.iter_mut().zip(eigen.eigenvalues.iter()).enumerate() {
                *value = if *eigenvalue > OPEN * largest { *value / eigenvalue } else { 0.0 };
                if *eigenvalue < HARDLY * largest {
                    let px_per_unit = (0..free).map(|i| (eigen.eigenvectors[(i, k)] * inverse(i)).powi(2)).sum::<f64>().sqrt();
                    let most = most_px / px_per_unit.max(f64::MIN_POSITIVE);
                    *value = value.clamp(-most, most);
                }
            }
            eigen.eigenvectors * projected
        }
    };
    DVector::from_fn(n, |i, _| solved[i] * inverse(i))
}

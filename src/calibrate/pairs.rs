//! Attitude-independent equations of pairs of stars within frames, in a stream.
//!
//! One equation a pair: R = v_iᵀv_j − w_iᵀw_j(X̂) = A·ΔX with A = +∂(w_iᵀw_j)/∂X. Only the stars' vectors and one weight a pair
//! are kept; the rows of A are made anew whenever they are needed. Work is cut into fixed chunks of rows whose sums are added
//! in order, so the result does not depend on the number of threads.

use std::ops::Range;

use rayon::prelude::*;

use super::geometry::{LocalDirection, Matrix6, Scaling, Vector6};
use crate::camera::{Camera, PARAMETER_COUNT};
use crate::coordinates::PixelPoint;
use crate::dual::dot;
use crate::parallel;

/// Pairs that one task works on, about.
const CHUNK_PAIRS: usize = 4096;

/// A control point as the solvers see it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Star {
    /// Index into the control points.
    pub(super) point: usize,
    /// Where it was measured.
    pub(super) pixel: PixelPoint,
    /// Direction of the star, ICRS axes.
    pub(super) direction: [f64; 3],
}

/// The control points of one frame.
#[derive(Clone, Debug)]
pub(super) struct FrameStars {
    /// Index of the frame in the recording.
    pub(super) frame: usize,
    /// Its control points.
    pub(super) stars: Vec<Star>,
}

/// A star of a pair at the present camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct PairStar {
    /// Direction of the star, ICRS axes (v).
    pub(super) v: [f64; 3],
    /// Measured direction (w) and its derivatives.
    pub(super) local: LocalDirection,
}

/// Rows `stars` of the triangle of pairs of one frame, and where their pairs stand among all pairs.
#[derive(Clone, Debug)]
struct Chunk {
    frame: usize,
    stars: Range<usize>,
    pairs: usize,
}

/// All pairs of a set of frames.
#[derive(Clone, Debug)]
pub(super) struct Pairs {
    frames: Vec<Vec<PairStar>>,
    chunks: Vec<Chunk>,
    count: usize,
}

/// Normal equations AᵀPA·ΔX = AᵀPR.
#[derive(Clone, Copy, Debug)]
pub(super) struct NormalEquations {
    /// AᵀPA.
    pub(super) matrix: Matrix6,
    /// AᵀPR.
    pub(super) right: Vector6,
}

impl Pairs {
    /// The pairs of the frames, linearised at a camera. Every frame's pairs stand in the order (0,1), (0,2), …, (1,2), ….
    pub(super) fn at(frames: &[FrameStars], camera: &Camera, scaling: &Scaling) -> Self {
        let linearised: Vec<Vec<PairStar>> = parallel::map(frames, |frame| {
            let star = |star: &Star| PairStar { v: star.direction, local: scaling.local_direction(camera, star.pixel) };
            frame.stars.iter().map(star).collect()
        });
        let (mut chunks, mut count) = (Vec::new(), 0);
        for (frame, stars) in linearised.iter().enumerate() {
            let mut first = 0;
            while first + 1 < stars.len() {
                let (mut last, mut pairs) = (first, 0);
                while last + 1 < stars.len() && pairs < CHUNK_PAIRS {
                    pairs += stars.len() - 1 - last;
                    last += 1;
                }
                chunks.push(Chunk { frame, stars: first..last, pairs });
                count += pairs;
                first = last;
            }
        }
        Self { frames: linearised, chunks, count }
    }

    /// How many pairs there are.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// The stars of one frame.
    pub(super) fn stars(&self, frame: usize) -> &[PairStar] {
        &self.frames[frame]
    }

    /// AᵀPA and AᵀPR.
    pub(super) fn normal_equations(&self, weights: &[f64]) -> NormalEquations {
        let partial: Vec<_> = self
            .with_weights(weights)
            .into_par_iter()
            .map(|(chunk, weights)| {
                let mut matrix = [[0.0; PARAMETER_COUNT]; PARAMETER_COUNT];
                let mut right = [0.0; PARAMETER_COUNT];
                self.for_pairs(chunk, |t, a, b| {
                    let row = cosine_columns(&a.local, &b.local);
                    let residual = cosine_residual(a, b);
                    for k in 0..PARAMETER_COUNT {
                        let weighted = weights[t] * row[k];
                        right[k] += weighted * residual;
                        for l in k..PARAMETER_COUNT {
                            matrix[k][l] += weighted * row[l];
                        }
                    }
                });
                (matrix, right)
            })
            .collect();
        let mut sum = NormalEquations { matrix: Matrix6::zeros(), right: Vector6::zeros() };
        for (matrix, right) in partial {
            sum.matrix += Matrix6::from_fn(|k, l| matrix[k.min(l)][k.max(l)]);
            sum.right += Vector6::from(right);
        }
        sum
    }

    /// UᵀPU, with U = A·ΔX − R.
    pub(super) fn weighted_square_sum(&self, weights: &[f64], step: &Vector6) -> f64 {
        let shifts = self.shifts(step);
        let partial: Vec<f64> = self
            .with_weights(weights)
            .into_par_iter()
            .map(|(chunk, weights)| {
                let mut sum = 0.0;
                let shifts = &shifts[chunk.frame];
                self.for_pair_indices(chunk, |t, i, j| {
                    let u = self.remaining(chunk.frame, shifts, i, j);
                    sum += weights[t] * u * u;
                });
                sum
            })
            .collect();
        partial.iter().sum()
    }

    /// Gives every pair its new weight: `weight(p, u², aᵀ·N⁻¹·a)`. `whitening` is L⁻¹ of N = L·Lᵀ.
    pub(super) fn reweigh(&self, weights: &mut [f64], step: &Vector6, whitening: &Matrix6, weight: impl Fn(f64, f64, f64) -> f64 + Sync) {
        let shifts = self.shifts(step);
        let whitened: Vec<Vec<LocalDirection>> = parallel::map(&self.frames, |stars| {
            stars
                .iter()
                .map(|star| {
                    let by_parameter = star.local.by_parameter.map(|row| (whitening * Vector6::from(row)).into());
                    LocalDirection { by_parameter, ..star.local }
                })
                .collect()
        });
        self.with_weights_mut(weights).into_par_iter().for_each(|(chunk, weights)| {
            let (shifts, whitened) = (&shifts[chunk.frame], &whitened[chunk.frame]);
            self.for_pair_indices(chunk, |t, i, j| {
                let u = self.remaining(chunk.frame, shifts, i, j);
                let row = cosine_columns(&whitened[i], &whitened[j]);
                weights[t] = weight(weights[t], u * u, row.iter().map(|a| a * a).sum());
            });
        });
    }

    /// The weights of each star's pairs, frame by frame and star by star.
    pub(super) fn weights_by_star(&self, weights: &[f64]) -> Vec<Vec<Vec<f64>>> {
        let mut by_star: Vec<Vec<Vec<f64>>> = self.frames.iter().map(|stars| vec![Vec::new(); stars.len()]).collect();
        for (chunk, weights) in self.with_weights(weights) {
            self.for_pair_indices(chunk, |t, i, j| {
                by_star[chunk.frame][i].push(weights[t]);
                by_star[chunk.frame][j].push(weights[t]);
            });
        }
        by_star
    }

    /// Calls `f(frame, i, j, weight)` for every pair, in order.
    pub(super) fn for_each(&self, weights: &[f64], mut f: impl FnMut(usize, usize, usize, f64)) {
        for (chunk, weights) in self.with_weights(weights) {
            self.for_pair_indices(chunk, |t, i, j| f(chunk.frame, i, j, weights[t]));
        }
    }

    /// Where each star's measured direction goes with a step.
    fn shifts(&self, step: &Vector6) -> Vec<Vec<[f64; 3]>> {
        let shift = |star: &PairStar| star.local.by_parameter.map(|row| row.iter().zip(step.iter()).map(|(a, b)| a * b).sum());
        parallel::map(&self.frames, |stars| stars.iter().map(shift).collect())
    }

    /// u = a·ΔX − R of one pair.
    fn remaining(&self, frame: usize, shifts: &[[f64; 3]], i: usize, j: usize) -> f64 {
        let (a, b) = (&self.frames[frame][i], &self.frames[frame][j]);
        dot(shifts[i], b.local.direction) + dot(a.local.direction, shifts[j]) - cosine_residual(a, b)
    }

    fn for_pair_indices(&self, chunk: &Chunk, mut f: impl FnMut(usize, usize, usize)) {
        let count = self.frames[chunk.frame].len();
        let mut t = 0;
        for i in chunk.stars.clone() {
            for j in i + 1..count {
                f(t, i, j);
                t += 1;
            }
        }
    }

    fn for_pairs(&self, chunk: &Chunk, mut f: impl FnMut(usize, &PairStar, &PairStar)) {
        let stars = &self.frames[chunk.frame];
        self.for_pair_indices(chunk, |t, i, j| f(t, &stars[i], &stars[j]));
    }

    fn with_weights<'a>(&'a self, mut weights: &'a [f64]) -> Vec<(&'a Chunk, &'a [f64])> {
        self.chunks
            .iter()
            .map(|chunk| {
                let (own, rest) = weights.split_at(chunk.pairs);
                weights = rest;
                (chunk, own)
            })
            .collect()
    }

    fn with_weights_mut<'a>(&'a self, mut weights: &'a mut [f64]) -> Vec<(&'a Chunk, &'a mut [f64])> {
        self.chunks
            .iter()
            .map(|chunk| {
                let (own, rest) = std::mem::take(&mut weights).split_at_mut(chunk.pairs);
                weights = rest;
                (chunk, own)
            })
            .collect()
    }
}

/// ∂(w_iᵀw_j)/∂X: one row of A.
pub(super) fn cosine_columns(a: &LocalDirection, b: &LocalDirection) -> [f64; PARAMETER_COUNT] {
    let mut row = [0.0; PARAMETER_COUNT];
    for c in 0..3 {
        for (k, value) in row.iter_mut().enumerate() {
            *value += a.by_parameter[c][k] * b.direction[c] + a.direction[c] * b.by_parameter[c][k];
        }
    }
    row
}

/// R = v_iᵀv_j − w_iᵀw_j.
pub(super) fn cosine_residual(a: &PairStar, b: &PairStar) -> f64 {
    dot(a.v, b.v) - dot(a.local.direction, b.local.direction)
}

#[cfg(test)]
mod tests {
    use super::super::geometry::frame_grid;
    use super::*;

    const CAMERA: Camera = Camera {
        width_px: 1024,
        height_px: 768,
        principal_point_px: [520.0, 390.0],
        focal_length_px: 1500.0,
        k1: 2e-8,
        p1: 3e-7,
        p2: -2e-7,
    };

    /// Stars on a grid, turned by nothing, seen by a camera a little different.
    fn frames() -> Vec<FrameStars> {
        let true_camera = Camera { focal_length_px: 1502.0, ..CAMERA };
        let star = |(point, pixel)| Star { point, pixel, direction: true_camera.direction(pixel).xyz };
        let grid = frame_grid(&CAMERA, 12);
        vec![
            FrameStars { frame: 0, stars: grid.iter().copied().enumerate().map(star).collect() },
            FrameStars { frame: 1, stars: grid.iter().copied().enumerate().step_by(7).map(star).collect() },
        ]
    }

    #[test]
    fn rows_agree_with_central_differences() {
        let scaling = Scaling::of(&CAMERA, [true; PARAMETER_COUNT]);
        let (a, b) = (PixelPoint { x_px: 13.0, y_px: 700.0 }, PixelPoint { x_px: 981.5, y_px: 40.25 });
        let row = cosine_columns(&scaling.local_direction(&CAMERA, a), &scaling.local_direction(&CAMERA, b));
        for (k, slope) in row.into_iter().enumerate() {
            let cosine = |sign: f64| {
                let mut step = Vector6::zeros();
                step[k] = 0.01 * sign;
                let camera = scaling.moved(&CAMERA, &step);
                dot(camera.direction(a).xyz, camera.direction(b).xyz)
            };
            let difference = (cosine(1.0) - cosine(-1.0)) / 0.02;
            assert!((difference - slope).abs() < 1e-6 * slope.abs() + 1e-12, "{k}: {difference} {slope}");
        }
    }

    #[test]
    fn every_pair_is_met_once_and_chunks_change_nothing() {
        let scaling = Scaling::of(&CAMERA, [true; PARAMETER_COUNT]);
        let pairs = Pairs::at(&frames(), &CAMERA, &scaling);
        assert_eq!(pairs.count(), 144 * 143 / 2 + 21 * 20 / 2);
        assert!(pairs.chunks.len() > 2, "the case must be cut");
        let weights: Vec<f64> = (0..pairs.count()).map(|t| 1.0 / (1.0 + (t % 5) as f64)).collect();
        let (mut direct, mut met) = (Matrix6::zeros(), 0);
        pairs.for_each(&weights, |frame, i, j, weight| {
            assert_eq!(weight, weights[met]);
            met += 1;
            let row = Vector6::from(cosine_columns(&pairs.stars(frame)[i].local, &pairs.stars(frame)[j].local));
            direct += row * row.transpose() * weight;
        });
        assert_eq!(met, pairs.count());
        let difference = (pairs.normal_equations(&weights).matrix - direct).amax();
        assert!(difference < 1e-12 * direct.amax(), "{difference}");
    }

    #[test]
    fn leverages_sum_to_the_number_of_parameters() {
        // Σ l_t = L is Σ p_t·aᵀN⁻¹a = 6.
        let scaling = Scaling::of(&CAMERA, [true; PARAMETER_COUNT]);
        let pairs = Pairs::at(&frames(), &CAMERA, &scaling);
        let weights: Vec<f64> = (0..pairs.count()).map(|t| 1.0 / (1.0 + (t % 3) as f64)).collect();
        let normal = pairs.normal_equations(&weights).matrix;
        let whitening = normal.cholesky().unwrap().l().try_inverse().unwrap();
        let mut shares = weights.clone();
        pairs.reweigh(&mut shares, &Vector6::zeros(), &whitening, |p, _, leverage| p * leverage);
        let sum: f64 = shares.iter().sum();
        assert!((sum - 6.0).abs() < 1e-6, "{sum}");
        // UᵀPU with no step is RᵀPR.
        let mut direct = 0.0;
        pairs.for_each(&weights, |frame, i, j, p| direct += p * cosine_residual(&pairs.stars(frame)[i], &pairs.stars(frame)[j]).powi(2));
        assert!((pairs.weighted_square_sum(&weights, &Vector6::zeros()) / direct - 1.0).abs() < 1e-12);
    }
}

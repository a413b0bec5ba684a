//! One step of the ePSF: the correction by least squares over all stars, their positions, fluxes and backgrounds projected out.
//!
//! The ePSF is degenerate with flux and position; the gauge fixes its sum to 1 and its centroid to 0 everywhere in the frame. The centroid is that
//! in a window as wide as the Gaussian. It is degenerate with the background too, of which a constant under the whole window is a part: along the rim of
//! the window the correction sums to nothing. All conditions are linear in the correction. Without them the step would wander along what no pixel
//! determines.

use nalgebra::{Matrix4, Vector4};
use rayon::prelude::*;

use super::epsf::{Grid, Lines, NARROW, knots_of_light, light_of_knots};
use super::image_model::{Model, Shape};
use super::stamp::Stamp;

/// Width of the rim of the window, px.
const RIM_PX: f64 = 1.5;
/// Steps of the linear solution, and the squared residual over that of the start at which it ends: of the usual grid, and of a finer one, whose turns of
/// image and places go on anyway.
const MAX_STEPS: (usize, usize) = (300, 80);
const ENOUGH: (f64, f64) = (1e-9, 1e-6);
/// What the correction may be, one σ: share of the image where it is, and of its top anywhere.
const PRIOR: (f64, f64) = (0.3, 0.01);
/// Correction that changes over the frame, over that which does not.
const PRIOR_OF_FIELD: f64 = 0.5;

/// One star under the present image: what the step for the image reads.
pub(super) struct Turn<'a> {
    pub(super) model: Model,
    pub(super) chi2: f64,
    pub(super) lines: [Lines; 2],
    pub(super) terms: Vec<f64>,
    pub(super) weights: Vec<f64>,
    /// Counts less the Gaussian and the background.
    pub(super) rest: Vec<f64>,
    /// Derivatives of the counts by flux, background, x and y.
    pub(super) rows: Vec<[f64; 4]>,
    /// Inverse of the normal matrix of those four.
    pub(super) covariance: [[f64; 7]; 7],
    /// What the sky says of the place: from here to there over its variance, in the order of `rows`; 0 where it says nothing.
    pub(super) pull: [f64; 4],
    pub(super) stamp: &'a Stamp,
}

impl Turn<'_> {
    /// Weights the vector and takes out what flux, background and position would take up, which are drawn by `pull` besides.
    fn weigh(&self, vector: &mut [f64], pull: [f64; 4]) {
        let mut sums = pull;
        for ((v, w), row) in vector.iter_mut().zip(&self.weights).zip(&self.rows) {
            *v *= w;
            for (sum, r) in sums.iter_mut().zip(row) {
                *sum += *v * r;
            }
        }
        let steps: [f64; 4] = std::array::from_fn(|a| (0..4).map(|b| self.covariance[a][b] * sums[b]).sum());
        for ((v, w), row) in vector.iter_mut().zip(&self.weights).zip(&self.rows) {
            *v -= w * row.iter().zip(steps).map(|(r, s)| r * s).sum::<f64>();
        }
    }
}

/// The correction as unknowns: what is linear in it.
pub(super) struct Unknowns {
    grid: Grid,
    terms: usize,
    /// Whether the grid is finer than the usual.
    is_fine: bool,
    /// Inverse of the prior's variance for each knot.
    prior: Vec<f64>,
    /// What must be zero, as weights of a term's knots: its light, its first moments in the window, and its light along the rim, which would be one
    /// with every star's background.
    held: [Vec<f64>; HELD],
}

/// Conditions on the knots of a term.
const HELD: usize = 4;

impl Unknowns {
    /// `freedom`: by how much the correction may be more than usual.
    pub(super) fn new(grid: Grid, base: Shape, terms: usize, freedom: f64) -> Self {
        let sigma2 = base.axes_px().0.powi(2);
        let top = grid.step_px.powi(2) / (2.0 * std::f64::consts::PI * base.determinant().sqrt());
        let allowed = |knot: usize| {
            let [x, y] = grid.place_px(knot);
            // the wings of real images reach further than a Gaussian's
            // Of finer knots more stand together for a detail of the same size: each may be more, for the same freedom of the image.
            freedom
                * top
                * (NARROW * base.axes_px().0 / grid.narrow_px)
                * (PRIOR.0 * (-0.5 * (x * x + y * y) / (2.25 * sigma2)).exp() + PRIOR.1)
        };
        let of_term = |term: usize| if term == 0 { 1.0 } else { PRIOR_OF_FIELD };
        let prior = (0..terms * grid.knots()).map(|i| (of_term(i / grid.knots()) * allowed(i % grid.knots())).powi(-2)).collect();
        // first moments of a knot's narrow Gaussian under a Gaussian weight as wide as the image
        let spread = grid.narrow_px.powi(2);
        let window = Shape::ellipse(base.xx + spread, base.xy, base.yy + spread);
        let moment = |axis: usize| {
            let of = |knot: usize| {
                let at = grid.place_px(knot);
                at[axis] * (-0.5 * window.radius_in_sigma(at[0], at[1]).powi(2)).exp()
            };
            (0..grid.knots()).map(of).collect()
        };
        let rim_px = grid.place_px(0)[0].abs() - RIM_PX;
        let is_rim = |knot: usize| grid.place_px(knot).iter().any(|along| along.abs() > rim_px);
        let rim = (0..grid.knots()).map(|knot| if is_rim(knot) { 1.0 } else { 0.0 }).collect();
        Self { grid, terms, is_fine: freedom > 1.0, prior, held: [vec![1.0; grid.knots()], moment(0), moment(1), rim] }
    }

    /// For each term the inverse of what the held sums would be of steps along their own weights, scaled by `diagonal`.
    fn holds(&self, diagonal: &[f64]) -> Vec<Matrix4<f64>> {
        let of_term = |scale: &[f64]| {
            let between = |a: usize, b: usize| self.held[a].iter().zip(&self.held[b]).zip(scale).map(|((a, b), d)| a * b / d).sum::<f64>();
            Matrix4::from_fn(between).try_inverse().unwrap_or_else(Matrix4::zeros)
        };
        diagonal.chunks_exact(self.grid.knots()).map(of_term).collect()
    }

    /// The residual scaled by the diagonal, less what would change the held sums.
    fn scaled(&self, residual: &[f64], diagonal: &[f64], holds: &[Matrix4<f64>]) -> Vec<f64> {
        let n = self.grid.knots();
        let mut out: Vec<f64> = residual.iter().zip(diagonal).map(|(r, d)| r / d).collect();
        for ((part, scale), hold) in out.chunks_exact_mut(n).zip(diagonal.chunks_exact(n)).zip(holds) {
            let sums = Vector4::from_fn(|a, _| self.held[a].iter().zip(&*part).map(|(h, p)| h * p).sum::<f64>());
            let back = hold * sums;
            for (knot, (p, d)) in part.iter_mut().zip(scale).enumerate() {
                *p -= (0..HELD).map(|a| back[a] * self.held[a][knot]).sum::<f64>() / d;
            }
        }
        out
    }

    /// The stars' part of the normal matrix times a vector (or, of their rests, the right side), summed in a fixed order.
    fn over_stars(&self, turns: &[Turn<'_>], knots: Option<&[f64]>) -> Vec<f64> {
        const STARS_A_TASK: usize = 16;
        let n = self.grid.knots();
        let task = |chunk: &[Turn<'_>]| {
            let mut sum = vec![0.0; n * self.terms];
            let (mut local, mut back) = (vec![0.0; n], vec![0.0; n]);
            for turn in chunk {
                let mut vector = vec![0.0; turn.stamp.data.len()];
                let pull = if knots.is_none() { turn.pull } else { [0.0; 4] };
                match knots {
                    None => vector.copy_from_slice(&turn.rest),
                    Some(knots) => {
                        local.fill(0.0);
                        for (term, grid) in turn.terms.iter().zip(knots.chunks_exact(n)) {
                            for (l, g) in local.iter_mut().zip(grid) {
                                *l += term * g;
                            }
                        }
                        light_of_knots(&local, &turn.lines, turn.model.flux_dn, &mut vector);
                    }
                }
                turn.weigh(&mut vector, pull);
                knots_of_light(&vector, &turn.lines, turn.model.flux_dn, &mut back);
                for (term, grid) in turn.terms.iter().zip(sum.chunks_exact_mut(n)) {
                    for (g, b) in grid.iter_mut().zip(&back) {
                        *g += term * b;
                    }
                }
            }
            sum
        };
        let parts: Vec<Vec<f64>> = turns.par_chunks(STARS_A_TASK).map(task).collect();
        let mut total = vec![0.0; n * self.terms];
        for part in parts {
            for (t, p) in total.iter_mut().zip(part) {
                *t += p;
            }
        }
        total
    }

    /// Diagonal of the normal matrix, about: what scales the unknowns.
    fn diagonal(&self, turns: &[Turn<'_>]) -> Vec<f64> {
        let n = self.grid.knots();
        let mut diagonal = self.prior.clone();
        let mut back = vec![0.0; n];
        for turn in turns {
            knots_of_light(&turn.weights, &[turn.lines[0].squared(), turn.lines[1].squared()], turn.model.flux_dn.powi(2), &mut back);
            for (term, grid) in turn.terms.iter().zip(diagonal.chunks_exact_mut(n)) {
                for (d, b) in grid.iter_mut().zip(&back) {
                    *d += term * term * b;
                }
            }
        }
        diagonal
    }

    /// Conjugate gradients (Hestenes & Stiefel 1952) within what is held (Gould, Hribar & Nocedal 2001, SIAM J. Sci. Comput. 23, 1376), from the
    /// present knots on, which keep to it.
    pub(super) fn solve(&self, turns: &[Turn<'_>], knots: &mut [f64]) {
        let apply = |vector: &[f64]| {
            let mut out = self.over_stars(turns, Some(vector));
            for ((o, v), p) in out.iter_mut().zip(vector).zip(&self.prior) {
                *o += p * v;
            }
            out
        };
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let diagonal = self.diagonal(turns);
        let holds = self.holds(&diagonal);
        let scaled = |r: &[f64]| self.scaled(r, &diagonal, &holds);
        let mut residual = self.over_stars(turns, None);
        let aim = dot(&residual, &scaled(&residual));
        for (r, a) in residual.iter_mut().zip(apply(knots)) {
            *r -= a;
        }
        let mut z = scaled(&residual);
        let mut direction = z.clone();
        let mut square = dot(&residual, &z);
        let (steps, enough) = if self.is_fine { (MAX_STEPS.1, ENOUGH.1) } else { (MAX_STEPS.0, ENOUGH.0) };
        for _ in 0..steps {
            if square <= enough * aim {
                break;
            }
            let image = apply(&direction);
            let length = square / dot(&direction, &image);
            for ((k, r), (d, i)) in knots.iter_mut().zip(&mut residual).zip(direction.iter().zip(&image)) {
                *k += length * d;
                *r -= length * i;
            }
            z = scaled(&residual);
            let next = dot(&residual, &z);
            for (d, z) in direction.iter_mut().zip(&z) {
                *d = z + next / square * *d;
            }
            square = next;
        }
    }
}

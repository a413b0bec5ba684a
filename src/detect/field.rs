//! Trails over the frame: a constant length and direction, and linear terms along x and y if the camera rolled. (A small rotation moves star images
//! linearly in their position, up to second orders of the field's width.)
//!
//! One fit to the scores of all stars: a faint star determines its own trail badly, and the median over single stars is biased.

use super::fit::Freedom;
use super::image_model::{Model, Shape};
use super::psf::Profile;
use super::stamp::Scene;
use super::trail::Trail;
use super::work::WEIGHED;
use crate::statistics::cholesky::inverse;
use crate::statistics::median;

/// Flux, background and position come before the numbers of the trail.
const FIXED: usize = Freedom::Fixed.parameters();
/// Unknowns of a field without slopes: length along x and y, width.
const EVEN: usize = 3;
/// With slopes of both lengths along x, then along y.
const SLOPED: usize = 7;

/// The trail at every place of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Field {
    middle_px: [f64; 2],
    half_px: f64,
    unknowns: [f64; SLOPED],
}

impl Field {
    fn even(scene: &Scene<'_>, trail: Trail) -> Self {
        let size = [scene.frame.width_px as f64, scene.frame.height_px as f64];
        let [x, y] = trail.along_px;
        Self {
            middle_px: size.map(|s| 0.5 * (s - 1.0)),
            half_px: 0.5 * size[0].max(size[1]),
            unknowns: [x, y, trail.sigma_px, 0.0, 0.0, 0.0, 0.0],
        }
    }

    fn terms(&self, x: f64, y: f64) -> [f64; 2] {
        [(x - self.middle_px[0]) / self.half_px, (y - self.middle_px[1]) / self.half_px]
    }

    /// The trail of a star at a place.
    pub(super) fn at(&self, x: f64, y: f64) -> Trail {
        let [u, v] = self.terms(x, y);
        let of = |axis: usize| self.unknowns[axis] + u * self.unknowns[EVEN + axis] + v * self.unknowns[EVEN + 2 + axis];
        Trail { along_px: [of(0), of(1)], sigma_px: self.unknowns[2] }
    }

    /// The field that fits stars best, from their typical trail on; with slopes where these clearly say so.
    pub(super) fn of(scene: &Scene<'_>, starts: &[Model], typical: Trail) -> Option<Self> {
        /// What four slopes are by chance in squared σ, and ten σ of that: a slope that is not there costs more than one left out.
        const CHANCE: f64 = 4.0 + 10.0 * 2.83;
        let (even, _) = Self::even(scene, typical).settled(scene, starts, EVEN)?;
        let sloped = even.settled(scene, starts, SLOPED).filter(|(_, slopes)| *slopes > CHANCE);
        Some(sloped.map_or(even, |(field, _)| field))
    }

    /// The field that the camera's roll makes of stars whose images lie each its own way; `trails`: places, and each star's own.
    pub(super) fn turning(scene: &Scene<'_>, starts: &[Model], trails: &[([f64; 2], Trail)]) -> Option<Self> {
        let sigma_px = median(&trails.iter().map(|t| t.1.sigma_px).collect::<Vec<_>>())?;
        let none = Self::even(scene, Trail { along_px: [0.0; 2], sigma_px });
        // a trail has no direction, both signs mean the same: they are taken from a field that is even one way or the other, or turns, and then from what is found
        let guesses = [[1.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0, -1.0, 0.0]]
            .map(|[x, y, xu, yu, xv, yv]| Self { unknowns: [x, y, sigma_px, xu, yu, xv, yv], ..none });
        let best = guesses.into_iter().filter_map(|guess| guess.drawn_through(trails)).min_by(|a, b| a.1.total_cmp(&b.1))?;
        best.0.settled(scene, starts, SLOPED).map(|(field, _)| field)
    }

    /// Least squares through trails whose signs are those of the field, again until these stay; with the middle of what it leaves.
    fn drawn_through(mut self, trails: &[([f64; 2], Trail)]) -> Option<(Self, f64)> {
        const MAX_ROUNDS: usize = 10;
        const TERMS: usize = 3;
        let mut left = f64::INFINITY;
        for _ in 0..MAX_ROUNDS {
            let (mut matrix, mut vectors) = ([[0.0; SLOPED]; SLOPED], [[0.0; TERMS]; 2]);
            for ([x, y], trail) in trails {
                let ([u, v], [own_x, own_y]) = (self.terms(*x, *y), trail.like(self.at(*x, *y)).along_px);
                let terms = [1.0, u, v];
                for i in 0..TERMS {
                    vectors[0][i] += terms[i] * own_x;
                    vectors[1][i] += terms[i] * own_y;
                    for j in 0..TERMS {
                        matrix[i][j] += terms[i] * terms[j];
                    }
                }
            }
            let covariance = inverse(&matrix, TERMS)?;
            let [along_x, along_y] =
                vectors.map(|vector| -> [f64; TERMS] { std::array::from_fn(|i| (0..TERMS).map(|j| covariance[i][j] * vector[j]).sum()) });
            self.unknowns = [along_x[0], along_y[0], self.unknowns[2], along_x[1], along_y[1], along_x[2], along_y[2]];
            let off = |([x, y], trail): &([f64; 2], Trail)| {
                let (own, field) = (trail.like(self.at(*x, *y)).along_px, self.at(*x, *y).along_px);
                (own[0] - field[0]).hypot(own[1] - field[1])
            };
            let now = median(&trails.iter().map(off).collect::<Vec<_>>())?;
            if now >= left {
                break;
            }
            left = now;
        }
        Some((self, left))
    }

    /// Gauss–Newton steps of the first `count` unknowns; what the slopes are in squared σ.
    fn settled(mut self, scene: &Scene<'_>, starts: &[Model], count: usize) -> Option<(Self, f64)> {
        const MAX_ROUNDS: usize = 8;
        /// Steps below this many standard errors are settled.
        const SETTLED: f64 = 0.1;
        for _ in 0..MAX_ROUNDS {
            let pull = |start: &Model| Pull::of(scene, *start, self.at(start.x, start.y));
            let pulls: Vec<Option<Pull>> = scene.work.each(starts, WEIGHED, pull).into_iter().map(Option::flatten).collect();
            let (mut matrix, mut vector) = ([[0.0; SLOPED]; SLOPED], [0.0; SLOPED]);
            for (pull, start) in pulls.iter().zip(starts).filter_map(|(pull, start)| Some((pull.as_ref()?, start))) {
                // unknown i moves the trail's number i.1 by the term i.0
                let [u, v] = self.terms(start.x, start.y);
                let moves = [(1.0, 0), (1.0, 1), (1.0, 2), (u, 0), (u, 1), (v, 0), (v, 1)];
                for (i, (term, number)) in moves.into_iter().enumerate() {
                    vector[i] += term * pull.vector[number];
                    for (j, (other, other_number)) in moves.into_iter().enumerate() {
                        matrix[i][j] += term * other * pull.matrix[number][other_number];
                    }
                }
            }
            let covariance = inverse(&matrix, count)?;
            let step: [f64; SLOPED] = std::array::from_fn(|i| (0..count).map(|j| covariance[i][j] * vector[j]).sum());
            let width_px = self.unknowns[2];
            for (unknown, step) in self.unknowns.iter_mut().zip(step) {
                *unknown += step;
            }
            if !(0.5 * width_px..2.0 * width_px).contains(&self.unknowns[2]) {
                return None;
            }
            if (0..count).all(|i| step[i].abs() < SETTLED * covariance[i][i].sqrt()) {
                return Some((self, self.slopes(&covariance, count)));
            }
        }
        None
    }

    /// The slopes in squared σ.
    fn slopes(&self, covariance: &[[f64; SLOPED]; SLOPED], count: usize) -> f64 {
        let slopes = count - EVEN;
        let mut block = [[0.0; SLOPED]; SLOPED];
        for i in 0..slopes {
            block[i][..slopes].copy_from_slice(&covariance[EVEN + i][EVEN..count]);
        }
        let Some(weights) = inverse(&block, slopes) else { return 0.0 };
        let own = &self.unknowns[EVEN..count];
        (0..slopes).map(|i| (0..slopes).map(|j| own[i] * weights[i][j] * own[j]).sum::<f64>()).sum()
    }
}

/// How a star pulls on its trail: its normal equations for length along x and y and width, with flux, background and position free.
struct Pull {
    matrix: [[f64; EVEN]; EVEN],
    vector: [f64; EVEN],
}

impl Pull {
    fn of(scene: &Scene<'_>, start: Model, trail: Trail) -> Option<Self> {
        let mut profile = Profile::new().counted(scene.work);
        let shape: Shape = trail.shape();
        let start = Model { shape, ..start };
        let mut stamp = scene.stamp(start, &[], &mut profile);
        let (model, offset) = scene.photons().settle(&mut stamp, start, Freedom::Fixed, &mut profile)?;
        profile.draw(stamp.window, &model, true);
        let normal = scene.photons().normal(&stamp, &profile, model.flux_dn, offset, FIXED + EVEN);
        let own = inverse(&normal.matrix, FIXED)?;
        let used = stamp.used.iter().filter(|u| **u).count();
        // stars that are not of this image count less; and the sign of a trail that was drawn is that of its shape
        let weight = (normal.chi2 / used.saturating_sub(FIXED).max(1) as f64).max(1.0).powi(-2);
        let drawn = Trail::of(shape);
        let turned = if drawn.like(trail) == drawn { 1.0 } else { -1.0 };
        let signs = [turned, turned, 1.0];
        let cross = |i: usize, k: usize| normal.matrix[FIXED + i][k];
        let taken: [[f64; FIXED]; EVEN] =
            std::array::from_fn(|i| std::array::from_fn(|k| (0..FIXED).map(|l| cross(i, l) * own[l][k]).sum()));
        let of = |i: usize, j: usize| {
            let (high, low) = (FIXED + i.max(j), FIXED + i.min(j));
            normal.matrix[high][low] - (0..FIXED).map(|k| taken[i][k] * cross(j, k)).sum::<f64>()
        };
        let rest = |i: usize| normal.vector[FIXED + i] - (0..FIXED).map(|k| taken[i][k] * normal.vector[k]).sum::<f64>();
        Some(Self {
            matrix: std::array::from_fn(|i| std::array::from_fn(|j| weight * signs[i] * signs[j] * of(i, j))),
            vector: std::array::from_fn(|i| weight * signs[i] * rest(i)),
        })
    }
}

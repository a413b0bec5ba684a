//! Companions: light beside a star in the residuals of its fit.

use super::fit::{Fit, Freedom};
use super::image_model::{Model, Shape};
use super::stamp::{Scene, Stamp};
use super::work::Work;
use crate::statistics::cholesky::solve;

/// The image that stars are held against.
#[derive(Clone, Copy)]
pub(super) struct Image {
    pub(super) typical: Shape,
    /// Whether it is the empirical one.
    pub(super) empirical: bool,
}

/// One star, and how light at a place beside it would show.
pub(super) struct IsolatedFit {
    pub(super) stamp: Stamp,
    pub(super) model: Model,
    /// Residuals and their weights.
    rest: Vec<f64>,
    weights: Vec<f64>,
    /// Derivatives by flux, background, x, y.
    rows: Vec<[f64; 4]>,
    matrix: [[f64; 4]; 4],
    value: Vec<f64>,
    right: [f64; 4],
}

/// Light beside a star, as its residuals show it.
#[derive(Clone, Copy)]
pub(super) struct CompanionMap {
    pub(super) flux_dn: f64,
    pub(super) sigma_dn: f64,
}

impl Scene<'_> {
    /// A star under the typical image, all pixels in; `settled` where its place is that of its image as fitted, which is as good.
    pub(super) fn alone(&self, fit: &Fit, image: Image, neighbours: &[Model], settled: bool) -> Option<IsolatedFit> {
        let mut profile = self.profile();
        let start = Model { shape: image.typical, empirical: image.empirical, ..fit.model };
        let stamp = self.stamp(start, neighbours, &mut profile);
        let freedom = if image.empirical { Freedom::Empirical } else { Freedom::Fixed };
        let as_fitted = Some((start, fit.offset_dn)).filter(|_| settled);
        let (model, offset) = as_fitted.or_else(|| self.photons().climb(&stamp, start, freedom, &mut profile))?;
        profile.draw(stamp.window, &model, false);
        let pixels = stamp.data.len();
        let (mut rest, mut weights, mut rows) = (Vec::with_capacity(pixels), Vec::with_capacity(pixels), Vec::with_capacity(pixels));
        let (mut matrix, mut right) = ([[0.0; 4]; 4], [0.0; 4]);
        for i in 0..pixels {
            let light = model.flux_dn * profile.value[i];
            let variance = stamp.variance[i] + light.max(0.0) * self.variance_per_dn;
            let weight = if stamp.used[i] { 1.0 / variance } else { 0.0 };
            let full = profile.row(i, model.flux_dn);
            let row = [full[0], full[1], full[2], full[3]];
            let left = stamp.data[i] - light - offset;
            for a in 0..4 {
                right[a] += weight * row[a] * left;
                for b in 0..=a {
                    matrix[a][b] += weight * row[a] * row[b];
                }
            }
            rest.push(left);
            weights.push(weight);
            rows.push(row);
        }
        let value = std::mem::take(&mut profile.value);
        Some(IsolatedFit { stamp, model, rest, weights, rows, matrix, value, right })
    }

    /// Light at a place beside a star.
    pub(super) fn beside(&self, alone: &IsolatedFit, toward_px: [f64; 2]) -> Option<CompanionMap> {
        let mut profile = self.profile();
        let there = Model { x: alone.model.x + toward_px[0], y: alone.model.y + toward_px[1], ..alone.model };
        profile.draw(alone.stamp.window, &there, false);
        alone.light(&profile.value)
    }
}

impl IsolatedFit {
    /// Light of the image `there` in the residuals, beside what flux, background and place of the star take up.
    fn light(&self, there: &[f64]) -> Option<CompanionMap> {
        let (mut along, mut own, mut shared) = (0.0, 0.0, [0.0; 4]);
        for (i, g) in there.iter().enumerate() {
            let weighted = self.weights[i] * g;
            along += weighted * self.rest[i];
            own += weighted * g;
            for (s, r) in shared.iter_mut().zip(&self.rows[i]) {
                *s += weighted * r;
            }
        }
        let steps = solve(&self.matrix, &shared, 4, 0.0)?;
        let dot = |a: &[f64; 4]| a.iter().zip(&steps).map(|(a, s)| a * s).sum::<f64>();
        let left = own - dot(&shared);
        (left > 1e-6 * own && own > 0.0).then(|| CompanionMap { flux_dn: (along - dot(&self.right)) / left, sigma_dn: left.sqrt().recip() })
    }

    /// Where light beside the star explains most of its residuals; not where another star is nearer.
    pub(super) fn brightest_beside(&self, neighbours: &[Model], work: &Work) -> Option<([f64; 2], f64)> {
        /// What a pixel costs at each place.
        const PIXEL_NS: u64 = 5;
        /// Pixels with less than this share of the image's top say little of it.
        const FAINT: f64 = 2e-3;
        let (columns, rows) = (self.stamp.window.columns.cast_signed(), self.stamp.window.rows.cast_signed());
        let top = self.value.iter().copied().fold(0.0, f64::max);
        let bright: Vec<(isize, isize, f64)> = (0..self.value.len())
            .filter(|i| self.value[*i] > FAINT * top)
            .map(|i| (i.cast_signed() % columns, i.cast_signed() / columns, self.value[i]))
            .collect();
        let reach = self.model.radius.cast_signed() - 1;
        work.spend(PIXEL_NS * (bright.len() as u64) * ((3 * reach * reach).max(0).cast_unsigned() as u64));
        let mut best: Option<(f64, [f64; 2])> = None;
        for sy in -reach..=reach {
            for sx in -reach..=reach {
                if sx * sx + sy * sy > reach * reach || (sx == 0 && sy == 0) {
                    continue;
                }
                let (x, y) = (self.model.x + sx as f64, self.model.y + sy as f64);
                let own = self.model.shape.radius_in_sigma(sx as f64, sy as f64);
                if neighbours.iter().any(|n| n.flux_dn > 0.0 && n.shape.radius_in_sigma(n.x - x, n.y - y) < own) {
                    continue;
                }
                let (mut along, mut norm, mut shared) = (0.0, 0.0, [0.0; 4]);
                for (column, row, g) in &bright {
                    let (c, r) = (column + sx, row + sy);
                    if c < 0 || r < 0 || c >= columns || r >= rows {
                        continue;
                    }
                    let i = (r * columns + c).cast_unsigned();
                    let weighted = self.weights[i] * g;
                    along += weighted * self.rest[i];
                    norm += weighted * g;
                    for (s, d) in shared.iter_mut().zip(&self.rows[i]) {
                        *s += weighted * d;
                    }
                }
                let Some(steps) = solve(&self.matrix, &shared, 4, 0.0) else { continue };
                let dot = |a: &[f64; 4]| a.iter().zip(&steps).map(|(a, s)| a * s).sum::<f64>();
                let left = norm - dot(&shared);
                let light = along - dot(&self.right);
                if left > 1e-6 * norm && light > 0.0 {
                    let gain = light * light / left;
                    if best.is_none_or(|(most, _)| gain > most) {
                        best = Some((gain, [sx as f64, sy as f64]));
                    }
                }
            }
        }
        best.map(|(gain, at)| (at, gain))
    }
}

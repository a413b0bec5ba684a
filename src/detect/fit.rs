//! Position, flux, background and width of one star image by maximum likelihood.
//!
//! Weights are those of the model, not of the data: variance = noise² + signal / gain. The equations solved are then the
//! score of Poisson plus read noise (quasi-likelihood: McCullagh & Nelder 1989, chapter 9), so the estimate is unbiased and
//! efficient where weights from the data would pull it to low counts. Levenberg–Marquardt steps; covariance from the Fisher matrix.

use super::background::Background;
use super::epsf::EmpiricalPsf;
use super::moments::{Moments, moments};
use super::psf::{PROFILE_PARAMETERS, Profile, Shape, Window};
use super::trail::Trail;
use super::work::Work;
use crate::frame::Frame;

/// Flux, offset of the background, x, y, and up to three numbers of shape.
const MAX_PARAMETERS: usize = 2 + PROFILE_PARAMETERS;
pub(super) const MAX_ITERATIONS: usize = 40;
/// Residuals of a single pixel beyond this many σ are no noise: a hot pixel, a cosmic ray, another star.
const OUTLIER_SIGMA: f64 = 6.0;
/// So often they are looked for anew.
pub(super) const MAX_DROPS: usize = 3;
/// How far a real star's image may differ from the Gaussian at any pixel: share of the model there, and of its peak.
const MODEL_SLACK: (f64, f64) = (0.1, 0.02);

/// Which numbers of the shape are free.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Freedom {
    /// The shape is known.
    Fixed,
    /// Round, of free width.
    Width,
    /// Any ellipse, or any trail of a star that is one.
    Ellipse,
    /// The empirical image, of which no number is free.
    Empirical,
}

impl Freedom {
    /// Number of free parameters in all.
    pub(super) const fn parameters(self) -> usize {
        match self {
            Self::Fixed | Self::Empirical => 4,
            Self::Width => 5,
            Self::Ellipse => 7,
        }
    }
}

/// A star as modelled.
#[derive(Clone, Copy, Debug)]
pub(super) struct Model {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) flux_dn: f64,
    pub(super) shape: Shape,
    /// Half the side of its window, px.
    pub(super) radius: usize,
    /// Whether its image is the empirical one; the shape is then only a measure of its size.
    pub(super) empirical: bool,
}

/// A fitted star.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    pub(super) model: Model,
    pub(super) offset_dn: f64,
    pub(super) covariance_px2: [f64; 3],
    pub(super) flux_sigma_dn: f64,
    pub(super) chi2: f64,
    pub(super) dof: usize,
    pub(super) peak_dn: f64,
    pub(super) gradient_dn: [f64; 2],
    pub(super) edge: bool,
    /// χ² of a lone bright pixel in place of the star, less that of the star; at or below zero the pixel explains more.
    pub(super) lone_pixel_excess: f64,
    pub(super) freedom: Freedom,
}

/// What fits read.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub(super) frame: &'a Frame,
    pub(super) background: &'a Background,
    /// Pixels that say nothing: hot or saturated.
    pub(super) masked: &'a [bool],
    /// Variance of the counts per count of signal: 1 / gain.
    pub(super) variance_per_dn: f64,
    /// Smallest noise of a pixel, DN, as declared.
    pub(super) noise_floor_dn: f64,
    /// The image of a star where it is known from the recording's own stars.
    pub(super) psf: Option<&'a EmpiricalPsf>,
    /// What fits cost.
    pub(super) work: &'a Work,
}

/// How the noise grows with the light: all that the fit of a stamp needs besides it.
#[derive(Clone, Copy)]
pub(super) struct Photons {
    /// Variance of the counts per count of signal: 1 / gain.
    pub(super) variance_per_dn: f64,
}

/// The pixels of one star.
#[derive(Clone)]
pub(super) struct Stamp {
    pub(super) window: Window,
    /// Counts less the mesh background and the neighbours.
    pub(super) data: Vec<f64>,
    /// Noise² without the star.
    pub(super) variance: Vec<f64>,
    pub(super) used: Vec<bool>,
    pub(super) edge: bool,
    pub(super) peak_dn: f64,
}

pub(super) struct Normal {
    pub(super) matrix: [[f64; MAX_PARAMETERS]; MAX_PARAMETERS],
    pub(super) vector: [f64; MAX_PARAMETERS],
    pub(super) chi2: f64,
}

/// Half the side of the window for a shape.
pub(super) fn radius_px(shape: Shape) -> usize {
    ((shape.reach_px(4.0) + 1.0).ceil() as usize).clamp(4, if shape.trail { 64 } else { 32 })
}

/// The window of a star, and whether the edge of the frame cuts it.
fn window(frame: &Frame, x: f64, y: f64, radius: usize) -> (Window, bool) {
    let span = |at: f64, length: usize| {
        let at = at.round().clamp(0.0, (length - 1) as f64) as usize;
        let (low, high) = (at.saturating_sub(radius), (at + radius + 1).min(length));
        (low, high - low, high - low < 2 * radius + 1)
    };
    let ((x0, columns, cut_x), (y0, rows, cut_y)) = (span(x, frame.width_px), span(y, frame.height_px));
    (Window { x0, y0, columns, rows }, cut_x || cut_y)
}

impl<'a> Scene<'a> {
    /// What draws images, counted.
    pub(super) fn profile(&self) -> Profile<'a> {
        Profile::of(self.psf).counted(self.work)
    }

    pub(super) fn photons(&self) -> Photons {
        Photons { variance_per_dn: self.variance_per_dn }
    }

    pub(super) fn stamp(&self, start: Model, neighbours: &[Model], profile: &mut Profile<'_>) -> Stamp {
        let (window, edge) = window(self.frame, start.x, start.y, start.radius);
        let pixels = window.columns * window.rows;
        let mut stamp = Stamp {
            window,
            data: Vec::with_capacity(pixels),
            variance: Vec::with_capacity(pixels),
            used: Vec::with_capacity(pixels),
            edge,
            peak_dn: f64::NEG_INFINITY,
        };
        for y in window.y0..window.y0 + window.rows {
            for x in window.x0..window.x0 + window.columns {
                let count = f64::from(self.frame.at(x, y));
                stamp.peak_dn = stamp.peak_dn.max(count);
                stamp.data.push(count - self.background.level_dn(x, y));
                let noise = self.background.noise_dn(x, y).max(self.noise_floor_dn);
                stamp.variance.push(noise * noise);
                stamp.used.push(!self.masked[y * self.frame.width_px + x]);
            }
        }
        for other in neighbours {
            profile.draw(window, other, false);
            for ((data, variance), share) in stamp.data.iter_mut().zip(&mut stamp.variance).zip(&profile.value) {
                let light = (other.flux_dn * share).max(0.0);
                *data -= light;
                *variance += light * self.variance_per_dn;
            }
        }
        stamp
    }

    /// Fits one star; `None` where no star can be fitted.
    pub(super) fn fit(&self, start: Model, freedom: Freedom, neighbours: &[Model]) -> Option<Fit> {
        let mut profile = self.profile();
        let mut stamp = self.stamp(start, neighbours, &mut profile);
        let start = Model { empirical: freedom == Freedom::Empirical, ..start };
        let fit = self.photons().settle(&mut stamp, start, freedom, &mut profile)?;
        self.finish(&stamp, fit, freedom, &mut profile)
    }

    fn finish(&self, stamp: &Stamp, fit: (Model, f64), freedom: Freedom, profile: &mut Profile<'_>) -> Option<Fit> {
        let (model, offset) = fit;
        let count = freedom.parameters();
        profile.draw(stamp.window, &model, freedom == Freedom::Ellipse);
        let normal = self.photons().normal(stamp, profile, model.flux_dn, offset, count);
        let covariance = inverse(&normal.matrix, count)?;
        let used = stamp.used.iter().filter(|u| **u).count();
        let flux_sigma_dn = covariance[0][0].sqrt();
        if !(model.flux_dn > 0.0 && flux_sigma_dn.is_finite() && model.x.is_finite() && model.y.is_finite()) {
            return None;
        }
        let (gradient, lone_pixel_excess) = self.leftovers(stamp, profile, model, offset);
        let (x, y) = (model.x.round().max(0.0) as usize, model.y.round().max(0.0) as usize);
        let mesh = self.background.slope_dn(x.min(self.frame.width_px - 1), y.min(self.frame.height_px - 1));
        Some(Fit {
            model,
            offset_dn: offset,
            covariance_px2: [covariance[2][2], covariance[3][2], covariance[3][3]],
            flux_sigma_dn,
            chi2: normal.chi2,
            dof: used.saturating_sub(count).max(1),
            peak_dn: stamp.peak_dn,
            gradient_dn: [gradient[0] + mesh[0], gradient[1] + mesh[1]],
            edge: stamp.edge,
            lone_pixel_excess,
            freedom,
        })
    }

    /// Moments of a fitted star, of the pixels that the fit used.
    pub(super) fn moments(&self, fit: &Fit, neighbours: &[Model]) -> Option<Moments> {
        let mut profile = self.profile();
        let mut stamp = self.stamp(fit.model, neighbours, &mut profile);
        self.photons().drop_all_outliers(&mut stamp, &(fit.model, fit.offset_dn), &mut profile);
        profile.draw(stamp.window, &fit.model, fit.freedom == Freedom::Ellipse);
        let count = fit.freedom.parameters();
        let normal = self.photons().normal(&stamp, &profile, fit.model.flux_dn, fit.offset_dn, count);
        let mut of_offset = [0.0; MAX_PARAMETERS];
        of_offset[1] = 1.0;
        let row = solve(&normal.matrix, &of_offset, count, 0.0)?;
        let told = self.photons().told(&stamp, &profile, fit.model.flux_dn, &row[..count]);
        moments(&stamp, fit, &told, self.photons())
    }

    /// What the residuals tell: slope of the background, and whether one pixel would do.
    pub(super) fn leftovers(&self, stamp: &Stamp, profile: &Profile<'_>, model: Model, offset: f64) -> ([f64; 2], f64) {
        let (mut slope, mut square) = ([0.0; 2], [0.0; 2]);
        let mut chi2_star = 0.0;
        let (mut sum, mut sum_square, mut sum_weight) = (0.0, 0.0, 0.0);
        let mut brightest: Option<(f64, f64)> = None;
        for i in 0..stamp.data.len() {
            if !stamp.used[i] {
                continue;
            }
            let x = (stamp.window.x0 + i % stamp.window.columns) as f64 - model.x;
            let y = (stamp.window.y0 + i / stamp.window.columns) as f64 - model.y;
            let (data, variance) = (stamp.data[i], stamp.variance[i]);
            let signal = model.flux_dn * profile.value[i];
            let residual = data - signal - offset;
            let weight = 1.0 / (variance + signal.max(0.0) * self.variance_per_dn);
            for (k, d) in [x, y].into_iter().enumerate() {
                slope[k] += weight * residual * d;
                square[k] += weight * d * d;
            }
            chi2_star += residual * residual / variance;
            sum += data / variance;
            sum_square += data * data / variance;
            sum_weight += 1.0 / variance;
            if x * x + y * y < 4.0 && brightest.is_none_or(|(most, _)| data > most) {
                brightest = Some((data, 1.0 / variance));
            }
        }
        let lone = brightest.map_or(f64::INFINITY, |(data, w)| {
            let (s, q, n) = (sum - data * w, sum_square - data * data * w, sum_weight - w);
            q - s * s / n.max(f64::MIN_POSITIVE) - chi2_star
        });
        ([slope[0] / square[0].max(1e-300), slope[1] / square[1].max(1e-300)], lone)
    }
}

impl Photons {
    /// The best model and its offset, pixels far off it left out of the stamp.
    pub(super) fn settle(self, stamp: &mut Stamp, start: Model, freedom: Freedom, profile: &mut Profile<'_>) -> Option<(Model, f64)> {
        let mut fit = self.climb(stamp, start, freedom, profile)?;
        for _ in 0..MAX_DROPS {
            if !self.drop_outliers(stamp, &fit, profile) {
                break;
            }
            fit = self.climb(stamp, fit.0, freedom, profile)?;
        }
        Some(fit)
    }

    fn drop_all_outliers(self, stamp: &mut Stamp, fit: &(Model, f64), profile: &mut Profile<'_>) {
        for _ in 0..MAX_DROPS {
            if !self.drop_outliers(stamp, fit, profile) {
                break;
            }
        }
    }

    /// Leaves out pixels far off the model; says whether there were any.
    fn drop_outliers(self, stamp: &mut Stamp, (model, offset): &(Model, f64), profile: &mut Profile<'_>) -> bool {
        profile.draw(stamp.window, model, false);
        self.drop_far(stamp, |i| model.flux_dn * profile.value[i], *offset)
    }

    /// The same of any light.
    pub(super) fn drop_far(self, stamp: &mut Stamp, light_dn: impl Fn(usize) -> f64, offset: f64) -> bool {
        let top = (0..stamp.data.len()).map(&light_dn).fold(0.0, f64::max);
        let mut worst: Vec<(f64, usize)> = Vec::new();
        for i in 0..stamp.data.len() {
            let signal = light_dn(i);
            let slack = MODEL_SLACK.0 * signal + MODEL_SLACK.1 * top;
            let sigma = (stamp.variance[i] + signal.max(0.0) * self.variance_per_dn + slack * slack).sqrt();
            let excess = (stamp.data[i] - signal - offset).abs() / sigma;
            if stamp.used[i] && excess > OUTLIER_SIGMA {
                worst.push((excess, i));
            }
        }
        worst.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        worst.truncate(stamp.data.len() / 30 + 1);
        for (_, i) in &worst {
            stamp.used[*i] = false;
        }
        !worst.is_empty()
    }

    pub(super) fn normal(self, stamp: &Stamp, profile: &Profile<'_>, flux: f64, offset: f64, count: usize) -> Normal {
        let mut n = Normal { matrix: [[0.0; MAX_PARAMETERS]; MAX_PARAMETERS], vector: [0.0; MAX_PARAMETERS], chi2: 0.0 };
        for i in 0..stamp.data.len() {
            if !stamp.used[i] {
                continue;
            }
            let signal = flux * profile.value[i];
            let weight = 1.0 / (stamp.variance[i] + signal.max(0.0) * self.variance_per_dn);
            let residual = stamp.data[i] - signal - offset;
            let row = profile.row(i, flux);
            n.chi2 += weight * residual * residual;
            for (a, weighted) in row[..count].iter().map(|r| r * weight).enumerate() {
                n.vector[a] += weighted * residual;
                for (cell, r) in n.matrix[a][..=a].iter_mut().zip(&row) {
                    *cell += weighted * r;
                }
            }
        }
        n
    }

    /// What the count of each pixel adds to a fitted number; `row` is that number's row of the covariance.
    fn told(self, stamp: &Stamp, profile: &Profile<'_>, flux: f64, row: &[f64]) -> Vec<f64> {
        let of = |i: usize| {
            let weight = 1.0 / (stamp.variance[i] + (flux * profile.value[i]).max(0.0) * self.variance_per_dn);
            weight * row.iter().zip(profile.row(i, flux)).map(|(c, r)| c * r).sum::<f64>()
        };
        (0..stamp.data.len()).map(|i| if stamp.used[i] { of(i) } else { 0.0 }).collect()
    }

    /// The best model and its offset.
    pub(super) fn climb(self, stamp: &Stamp, start: Model, freedom: Freedom, profile: &mut Profile<'_>) -> Option<(Model, f64)> {
        let count = freedom.parameters();
        let used = stamp.used.iter().filter(|u| **u).count();
        if used < count + 2 {
            return None;
        }
        let elliptical = freedom == Freedom::Ellipse;
        let reach = (1.5 + start.shape.axes_px().0).max(start.radius as f64 / 4.0);
        let (mut model, mut offset, mut damping) = (start, 0.0, 0.0_f64);
        profile.draw(stamp.window, &model, elliptical);
        (model.flux_dn, offset) = self.linear(stamp, profile, model.flux_dn, offset)?;
        let mut trial_profile = profile.like();
        let mut weights = vec![0.0; stamp.data.len()];
        let mut left = f64::INFINITY;
        let dof = (used - count) as f64;
        for _ in 0..MAX_ITERATIONS {
            let normal = self.normal(stamp, profile, model.flux_dn, offset, count);
            // where the image is not the model's, errors are larger in that measure, and steps need not be finer
            let misfit = (normal.chi2 / dof).max(1.0);
            for (w, (v, share)) in weights.iter_mut().zip(stamp.variance.iter().zip(&profile.value)) {
                *w = 1.0 / (v + (model.flux_dn * share).max(0.0) * self.variance_per_dn);
            }
            loop {
                let Some(step) = solve(&normal.matrix, &normal.vector, count, damping) else {
                    damping = (damping * 10.0).max(1e-3);
                    if damping > 1e8 {
                        return None;
                    }
                    continue;
                };
                let (next, next_offset) = advanced(model, offset, &step, freedom);
                let valid = (next.x - start.x).abs() <= reach && (next.y - start.y).abs() <= reach && plausible(next.shape, stamp);
                if valid {
                    trial_profile.draw(stamp.window, &next, elliptical);
                }
                let gain: f64 = (0..count).map(|i| step[i] * normal.vector[i]).sum();
                if valid && trial_chi2(stamp, &trial_profile, next.flux_dn, next_offset, &weights) <= normal.chi2 * (1.0 + 1e-12) {
                    std::mem::swap(profile, &mut trial_profile);
                    (model, offset) = (next, next_offset);
                    damping = if damping < 1e-4 { 0.0 } else { damping / 10.0 };
                    // the step is worth less than a thousandth of a standard error
                    if gain < 1e-6 * misfit {
                        return Some((model, offset));
                    }
                    left = gain / misfit;
                    break;
                }
                if gain < 1e-6 * misfit {
                    return Some((model, offset));
                }
                damping = (damping * 10.0).max(1e-3);
                if damping > 1e8 {
                    return None;
                }
            }
        }
        // weights that follow the model may keep it moving by a little where it fits badly: a tenth of a standard error is settled enough
        (left < 1e-2).then_some((model, offset))
    }

    /// Best flux and offset at a given position and shape.
    pub(super) fn linear(self, stamp: &Stamp, profile: &Profile<'_>, flux: f64, offset: f64) -> Option<(f64, f64)> {
        let (mut flux, mut offset) = (flux, offset);
        for _ in 0..2 {
            let normal = self.normal(stamp, profile, flux, offset, 2);
            let step = solve(&normal.matrix, &normal.vector, 2, 0.0)?;
            (flux, offset) = (flux + step[0], offset + step[1]);
        }
        (flux > 0.0).then_some((flux, offset))
    }
}

/// χ² of a trial under given weights: a step is judged by those it started with.
fn trial_chi2(stamp: &Stamp, profile: &Profile<'_>, flux: f64, offset: f64, weights: &[f64]) -> f64 {
    let pixels = stamp.data.iter().zip(&profile.value).zip(weights).zip(&stamp.used);
    pixels.filter(|(_, used)| **used).map(|(((data, share), w), _)| w * (data - flux * share - offset).powi(2)).sum()
}

fn advanced(model: Model, offset: f64, step: &[f64; MAX_PARAMETERS], freedom: Freedom) -> (Model, f64) {
    let shape = match freedom {
        Freedom::Fixed | Freedom::Empirical => model.shape,
        Freedom::Width => Shape::round(model.shape.sigma_px() + step[4]),
        Freedom::Ellipse if model.shape.trail => Trail::of(model.shape).advanced([step[4], step[5], step[6]]).shape(),
        Freedom::Ellipse => Shape::ellipse(model.shape.xx + step[4], model.shape.xy + step[5], model.shape.yy + step[6]),
    };
    (Model { x: model.x + step[2], y: model.y + step[3], flux_dn: model.flux_dn + step[0], shape, ..model }, offset + step[1])
}

/// Narrower than this a star image cannot be told from a lone pixel, px.
const NARROWEST_PX: f64 = 0.1;

fn plausible(shape: Shape, stamp: &Stamp) -> bool {
    let (long, short) = shape.axes_px();
    let room = stamp.window.columns.max(stamp.window.rows) as f64 / 2.0;
    // of a trail that leaves its window the ends are not seen
    let fits = long <= room && !(shape.trail && shape.reach_px(1.0) > room);
    short.is_finite() && short >= NARROWEST_PX && fits && shape.determinant() > 0.0 && shape.xx > 0.0
}

/// Cholesky factor of the leading block, the diagonal raised by `damping`.
fn factor<const N: usize>(matrix: &[[f64; N]; N], count: usize, damping: f64) -> Option<[[f64; N]; N]> {
    let mut l = [[0.0; N]; N];
    for i in 0..count {
        for j in 0..=i {
            let raised = if i == j { matrix[i][i] * (1.0 + damping) } else { matrix[i][j] };
            let rest = raised - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            if i == j {
                if rest.is_nan() || rest <= 1e-13 * matrix[i][i] {
                    return None;
                }
                l[i][i] = rest.sqrt();
            } else {
                l[i][j] = rest / l[j][j];
            }
        }
    }
    Some(l)
}

pub(super) fn solve<const N: usize>(matrix: &[[f64; N]; N], vector: &[f64; N], count: usize, damping: f64) -> Option<[f64; N]> {
    let l = factor(matrix, count, damping)?;
    let mut x = *vector;
    for i in 0..count {
        let known: f64 = (0..i).map(|k| l[i][k] * x[k]).sum();
        x[i] = (x[i] - known) / l[i][i];
    }
    for i in (0..count).rev() {
        let known: f64 = (i + 1..count).map(|k| l[k][i] * x[k]).sum();
        x[i] = (x[i] - known) / l[i][i];
    }
    x[..count].iter().all(|v| v.is_finite()).then_some(x)
}

pub(super) fn inverse<const N: usize>(matrix: &[[f64; N]; N], count: usize) -> Option<[[f64; N]; N]> {
    let mut out = [[0.0; N]; N];
    for column in 0..count {
        let mut unit = [0.0; N];
        unit[column] = 1.0;
        let solved = solve(matrix, &unit, count, 0.0)?;
        for row in 0..count {
            out[row][column] = solved[row];
        }
    }
    Some(out)
}

//! Position, flux, background and width of one star image by maximum likelihood.
//!
//! Weights are those of the model, not of the data: variance = noise² + signal / gain. The equations solved are then the
//! score of Poisson plus read noise (quasi-likelihood: McCullagh & Nelder 1989, chapter 9), so the estimate is unbiased and
//! efficient where weights from the data would pull it to low counts. Levenberg–Marquardt steps; covariance from the Fisher matrix.

use super::image_model::{Model, PROFILE_PARAMETERS, Shape};
use super::psf::Profile;
use super::stamp::{MAX_DROPS, Photons, Scene, Stamp};
use super::trail::Trail;
use crate::statistics::cholesky::{inverse, solve};
use crate::statistics::levenberg_marquardt::{Attempt, End, LeastSquares, Rules, minimise};

/// Flux, offset of the background, x, y, and up to three numbers of shape.
pub(super) const MAX_PARAMETERS: usize = 2 + PROFILE_PARAMETERS;
/// The steps of fits of star images.
pub(super) const RULES: Rules = Rules {
    first_damping: 0.0,
    smaller: |damping| if damping < 1e-4 { 0.0 } else { damping / 10.0 },
    larger: |damping| (damping * 10.0).max(1e-3),
    most_damping: 1e8,
    most_rejected: usize::MAX,
    linearisations: 40,
    steps: usize::MAX,
    ends_without_step: false,
};
/// A step is the last that is worth less, in χ² over the misfit, than a thousandth of a standard error. Where the image is not the model's, errors
/// are larger in that measure, and steps need not be finer.
pub(super) const WORTH: f64 = 1e-6;
/// Sums that differ by less are the same.
pub(super) const ROUNDING: f64 = 1e-12;

/// Whether the fit has come to rest, its last step worth so much. Weights that follow the model may keep it moving by a little where it fits badly:
/// a tenth of a standard error is settled enough.
pub(super) fn settled(end: End, left: f64) -> bool {
    end == End::Settled || (end == End::Exhausted && left < 1e-2)
}

/// Stars from this signal-to-noise ratio on have their own width fitted.
pub(super) const SNR_FOR_WIDTH: f64 = 30.0;

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

pub(super) struct Normal {
    pub(super) matrix: [[f64; MAX_PARAMETERS]; MAX_PARAMETERS],
    pub(super) vector: [f64; MAX_PARAMETERS],
    pub(super) chi2: f64,
}

impl Normal {
    const ZERO: Self = Self { matrix: [[0.0; MAX_PARAMETERS]; MAX_PARAMETERS], vector: [0.0; MAX_PARAMETERS], chi2: 0.0 };
}

impl Scene<'_> {
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

    pub(super) fn normal(self, stamp: &Stamp, profile: &Profile<'_>, flux: f64, offset: f64, count: usize) -> Normal {
        // Loops of known length are unrolled: most of the time of all fits is spent here.
        match count {
            2 => self.normal_of::<2>(stamp, profile, flux, offset),
            4 => self.normal_of::<4>(stamp, profile, flux, offset),
            5 => self.normal_of::<5>(stamp, profile, flux, offset),
            _ => self.normal_of::<MAX_PARAMETERS>(stamp, profile, flux, offset),
        }
    }

    /// The same of the first `COUNT` parameters.
    fn normal_of<const COUNT: usize>(self, stamp: &Stamp, profile: &Profile<'_>, flux: f64, offset: f64) -> Normal {
        let mut n = Normal::ZERO;
        for i in 0..stamp.data.len() {
            if !stamp.used[i] {
                continue;
            }
            let signal = flux * profile.value[i];
            let weight = 1.0 / (stamp.variance[i] + signal.max(0.0) * self.variance_per_dn);
            let residual = stamp.data[i] - signal - offset;
            let row = profile.row(i, flux);
            n.chi2 += weight * residual * residual;
            for a in 0..COUNT {
                let weighted = row[a] * weight;
                n.vector[a] += weighted * residual;
                for (cell, r) in n.matrix[a][..=a].iter_mut().zip(&row) {
                    *cell += weighted * r;
                }
            }
        }
        n
    }

    /// Twice the quasi-likelihood that a model lacks to the data themselves, whose score the fit solves: that of Poisson's law, shifted by the noise without
    /// light. χ² rewards a model for the variance that it claims; this does not, so models are compared by it.
    pub(super) fn deviance(self, stamp: &Stamp, profile: &Profile<'_>, flux: f64, offset: f64) -> f64 {
        let pixels = stamp.data.iter().zip(&stamp.variance).zip(&profile.value).zip(&stamp.used).filter(|(_, used)| **used);
        pixels.map(|(((data, variance), share), _)| deviance(data - offset, flux * share, *variance, self.variance_per_dn)).sum()
    }

    /// The best model and its offset.
    pub(super) fn climb(self, stamp: &Stamp, start: Model, freedom: Freedom, profile: &mut Profile<'_>) -> Option<(Model, f64)> {
        let count = freedom.parameters();
        let used = stamp.used.iter().filter(|u| **u).count();
        if used < count + 2 {
            return None;
        }
        let elliptical = freedom == Freedom::Ellipse;
        profile.draw(stamp.window, &start, elliptical);
        let (flux_dn, offset) = self.linear(stamp, profile, start.flux_dn, 0.0)?;
        let mut climb = Climb {
            photons: self,
            stamp,
            start,
            freedom,
            reach: (1.5 + start.shape.axes_px().0).max(start.radius as f64 / 4.0),
            dof: (used - count) as f64,
            fit: (Model { flux_dn, ..start }, offset),
            trial_profile: profile.like(),
            profile,
            weights: vec![0.0; stamp.data.len()],
            normal: Normal::ZERO,
            misfit: 1.0,
            left: f64::INFINITY,
        };
        settled(minimise(&mut climb, &RULES), climb.left).then_some(climb.fit)
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

/// The same of a pixel with so much light, of which the model has `signal`.
fn deviance(data: f64, signal: f64, variance: f64, per_dn: f64) -> f64 {
    /// Nearer than this to the model, by the share of the variance, the series is more accurate.
    const NEAR: f64 = 1e-2;
    let (variance, per_dn) = if signal > 0.0 { (variance + per_dn * signal, per_dn) } else { (variance, 0.0) };
    let rest = data - signal;
    let share = per_dn * rest / variance;
    if share.abs() < NEAR {
        return rest * rest / variance * (1.0 - share / 3.0 + share * share / 6.0);
    }
    let entropy = if share > -1.0 { (1.0 + share) * share.ln_1p() } else { 0.0 };
    2.0 * variance / (per_dn * per_dn) * (entropy - share)
}

/// The fit of a star on its way.
struct Climb<'c, 'p> {
    photons: Photons,
    stamp: &'c Stamp,
    start: Model,
    freedom: Freedom,
    /// How far it may go from its start along each axis, px.
    reach: f64,
    dof: f64,
    fit: (Model, f64),
    /// The image as it is, and as a step would have it.
    profile: &'c mut Profile<'p>,
    trial_profile: Profile<'p>,
    weights: Vec<f64>,
    normal: Normal,
    misfit: f64,
    /// What the last step was worth.
    left: f64,
}

impl LeastSquares for Climb<'_, '_> {
    type Step = [f64; MAX_PARAMETERS];

    fn linearise(&mut self) {
        let ((model, offset), stamp, photons) = (self.fit, self.stamp, self.photons);
        self.normal = photons.normal(stamp, self.profile, model.flux_dn, offset, self.freedom.parameters());
        self.misfit = (self.normal.chi2 / self.dof).max(1.0);
        for (w, (v, share)) in self.weights.iter_mut().zip(stamp.variance.iter().zip(&self.profile.value)) {
            *w = 1.0 / (v + (model.flux_dn * share).max(0.0) * photons.variance_per_dn);
        }
    }

    fn step(&self, damping: f64) -> Option<Self::Step> {
        solve(&self.normal.matrix, &self.normal.vector, self.freedom.parameters(), damping)
    }

    fn attempt(&mut self, step: &Self::Step) -> Attempt {
        let (start, stamp, reach) = (self.start, self.stamp, self.reach);
        let (next, offset) = advanced(self.fit.0, self.fit.1, step, self.freedom);
        let valid = (next.x - start.x).abs() <= reach && (next.y - start.y).abs() <= reach && plausible(next.shape, stamp);
        if valid {
            self.trial_profile.draw(stamp.window, &next, self.freedom == Freedom::Ellipse);
        }
        let gain: f64 = (0..self.freedom.parameters()).map(|i| step[i] * self.normal.vector[i]).sum();
        let trial = || trial_chi2(stamp, &self.trial_profile, next.flux_dn, offset, &self.weights);
        let is_better = valid && trial() <= self.normal.chi2 * (1.0 + ROUNDING);
        if is_better {
            std::mem::swap(self.profile, &mut self.trial_profile);
            self.fit = (next, offset);
            self.left = gain / self.misfit;
        }
        Attempt { is_better, is_last: gain < WORTH * self.misfit }
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The deviance has the score that the fit solves, and no model is better than the data themselves.
    #[test]
    fn the_deviance_has_the_score_of_the_fit() {
        for (data, signal, variance, per_dn) in
            [(40.0, 30.0, 25.0, 1.0), (10.0, 300.0, 25.0, 6.0), (31.0, 30.0, 400.0, 0.1), (-9.0, 4.0, 25.0, 2.0)]
        {
            let h = 1e-5 * signal;
            let slope = (deviance(data, signal + h, variance, per_dn) - deviance(data, signal - h, variance, per_dn)) / (2.0 * h);
            let score = -2.0 * (data - signal) / (variance + per_dn * signal);
            assert!((slope - score).abs() < 1e-5 * score.abs(), "{data} {signal}: {slope} {score}");
            assert!(deviance(data, signal, variance, per_dn) > 0.0 && deviance(signal, signal, variance, per_dn).abs() < 1e-12);
        }
        assert!((deviance(5.0, 2.0, 3.0, 0.0) - 3.0).abs() < 1e-12);
    }
}

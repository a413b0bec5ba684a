//! Photon transfer of the stars: how their noise grows with their light, where the sky has one level and its line no slope.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Fewer stars tell nothing that could be held against their scatter.
const MIN_STARS: usize = 30;
/// Stars whose value lies beyond this are doubles, or struck by a ray.
const OUTLIER_SIGMAS: f64 = 5.0;
/// Prior of the squared misfit, zero with this standard error (0.7 % of the light, squared): an image that was learnt, or a Gaussian that stars held out
/// prefer to it, is as good as that,
const MISFIT2_SIGMA: f64 = 5e-5;
/// unless the stars show a misfit of so many standard errors: then it is fitted without the prior.
const MIN_MISFIT_SIGMAS: f64 = 3.0;

/// Variance per count of light, as the stars tell it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StarTransfer {
    /// Variance of the counts per count of light: 1 / gain, DN.
    pub slope_dn: f64,
    /// Its standard error.
    pub slope_sigma_dn: f64,
    /// Square of the share of the light by which images differ from the one that was learnt; below zero by chance.
    pub misfit2: f64,
    /// Its standard error.
    pub misfit2_sigma: f64,
    /// χ² of the stars' values per degree of freedom; standard errors are larger by its root where it is above one.
    pub chi2_per_dof: f64,
    /// Stars.
    pub stars: usize,
}

impl StarTransfer {
    /// From what single stars tell: variance per count, its standard error, and what a squared misfit adds to it.
    #[must_use]
    pub fn fitted(told: &[[f64; 3]]) -> Option<Self> {
        let free = Self::without_outliers(told, 0.0)?;
        let is_shown = free.misfit2 > MIN_MISFIT_SIGMAS * free.misfit2_sigma;
        if is_shown { Some(free) } else { Self::without_outliers(told, MISFIT2_SIGMA.powi(-2)) }
    }

    /// `known`: inverse square of the standard error to which no misfit is known beforehand.
    fn without_outliers(told: &[[f64; 3]], known: f64) -> Option<Self> {
        let mut fit = Self::of(told, known)?;
        for _ in 0..8 {
            let scale = fit.chi2_per_dof.max(1.0).sqrt();
            let near = |own: &&[f64; 3]| fit.rest(own).abs() < OUTLIER_SIGMAS * scale;
            let kept: Vec<[f64; 3]> = told.iter().filter(near).copied().collect();
            let again = Self::of(&kept, known)?;
            let is_settled = again.stars == fit.stars;
            fit = again;
            if is_settled {
                break;
            }
        }
        let scale = fit.chi2_per_dof.max(1.0).sqrt();
        Some(Self { slope_sigma_dn: fit.slope_sigma_dn * scale, misfit2_sigma: fit.misfit2_sigma * scale, ..fit })
    }

    /// Weighted least squares.
    fn of(told: &[[f64; 3]], known: f64) -> Option<Self> {
        if told.len() < MIN_STARS {
            return None;
        }
        let sums = told.iter().fold([0.0; 5], |sum, [value, sigma, by]| {
            let weight = sigma.powi(-2);
            [sum[0] + weight, sum[1] + weight * by, sum[2] + weight * by * by, sum[3] + weight * value, sum[4] + weight * by * value]
        });
        let [one, by, mut by2, value, both] = sums;
        by2 += known;
        let determinant = one * by2 - by * by;
        if !(determinant > 1e-12 * one * by2 && determinant.is_finite()) {
            return None;
        }
        let own = Self {
            slope_dn: (by2 * value - by * both) / determinant,
            slope_sigma_dn: (by2 / determinant).sqrt(),
            misfit2: (one * both - by * value) / determinant,
            misfit2_sigma: (one / determinant).sqrt(),
            chi2_per_dof: 0.0,
            stars: told.len(),
        };
        let chi2: f64 = told.iter().map(|told| own.rest(told).powi(2)).sum();
        Some(Self { chi2_per_dof: chi2 / (told.len() - 2) as f64, ..own })
    }

    /// How far a star's value lies from what is expected of it, in its standard errors.
    fn rest(&self, [value, sigma, by]: &[f64; 3]) -> f64 {
        (value - self.slope_dn - self.misfit2 * by) / sigma
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, StandardNormal};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// Stars of unlike brightness with the slope 0.4 and a squared misfit, and among them some doubles.
    fn told(seed: u64, misfit2: f64) -> Vec<[f64; 3]> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        (0..400)
            .map(|star| {
                let by = 20.0 * 50.0_f64.powf(rng.random_range(0.0..1.0));
                let sigma = 0.1 + 3.0 / by;
                let noise: f64 = StandardNormal.sample(&mut rng);
                [0.4 + misfit2 * by + sigma * noise + if star % 50 == 0 { 20.0 * sigma } else { 0.0 }, sigma, by]
            })
            .collect()
    }

    /// Slope and squared misfit scatter by their standard errors about the truth.
    #[test]
    fn stars_tell_the_slope_beside_a_misfit() {
        const SEEDS: u64 = 200;
        let (mut mean, mut square) = ([0.0; 2], [0.0; 2]);
        for seed in 0..SEEDS {
            let own = StarTransfer::fitted(&told(seed, 9e-4)).unwrap();
            assert!(own.stars > 380 && own.stars <= 392, "doubles are left out: {}", own.stars);
            for (k, pull) in [(own.slope_dn - 0.4) / own.slope_sigma_dn, (own.misfit2 - 9e-4) / own.misfit2_sigma].into_iter().enumerate() {
                mean[k] += pull / SEEDS as f64;
                square[k] += pull * pull / SEEDS as f64;
            }
        }
        assert!(mean.iter().all(|mean| mean.abs() < 0.25), "means {mean:?}");
        assert!(square.iter().all(|square| (0.8..1.25).contains(square)), "squares {square:?}");
        assert!(StarTransfer::fitted(&told(1, 9e-4)[..20]).is_none());
    }

    /// Where the image is right the slope of stars of like brightness is known better, and its scatter is what is stated.
    #[test]
    fn a_right_image_tells_more() {
        const SEEDS: u64 = 200;
        let alike = |seed: u64| -> Vec<[f64; 3]> { told(seed, 0.0).into_iter().filter(|[_, _, by]| *by < 80.0).collect() };
        let all: Vec<StarTransfer> = (0..SEEDS).map(|seed| StarTransfer::fitted(&alike(seed)).unwrap()).collect();
        let square = all.iter().map(|own| ((own.slope_dn - 0.4) / own.slope_sigma_dn).powi(2)).sum::<f64>() / SEEDS as f64;
        assert!((0.7..1.25).contains(&square), "{square}");
        let mean = |own: &[StarTransfer]| own.iter().map(|own| own.slope_sigma_dn).sum::<f64>() / own.len() as f64;
        let free: Vec<StarTransfer> = (0..SEEDS).map(|seed| StarTransfer::without_outliers(&alike(seed), 0.0).unwrap()).collect();
        assert!(mean(&all) < 0.6 * mean(&free), "{} {}", mean(&all), mean(&free));
    }
}

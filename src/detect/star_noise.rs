//! How the noise grows with the light, told by the pixels of single stars: what is left of them under the image that the recording's stars were seen to have.
//!
//! Of a weighted least-squares fit with hat matrix H the residuals have E r_i² = Σ_j (δ_ij − H_ij)² v_j with v_j = σ_j² + κ·s_j: sky's noise σ_j, light
//! s_j, and κ the variance of the counts per count of light, which is 1 / gain. Where the image differs by a share ε of the light, E r_i² is larger by
//! ε²·s_i²: a star says how much of its value such a share would make, so that many stars of unlike brightness tell the two apart. What an image that was
//! learnt from the same stars follows of their noise is drawn and added.

use super::epsf::EmpiricalPsf;
use super::epsf_build::PsfStar;
use super::epsf_sky::{PredictedStar, SkyImage};
use super::fit::Freedom;
use super::image_model::{Model, Shape};
use super::image_noise::{Drawn, ImageNoise};
use super::psf::Profile;
use super::stamp::Photons;
use crate::parallel;
use crate::statistics::cholesky::inverse;
use crate::statistics::order::ascending;

/// What one star tells of the noise of its light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StarNoise {
    /// Variance of the counts per count of light: 1 / gain, if the image is right.
    pub variance_per_dn: f64,
    /// Its standard error.
    pub sigma: f64,
    /// What the square of a misfit of the whole light would add to it.
    pub per_misfit2: f64,
}

/// What each star tells, as its noise is expected with `expected` per count of light. Stars that no image fits tell nothing. `image`: what was learnt of
/// these stars where the sky says that they are; where that is no image, each has a Gaussian of the shape of the stars nearest to it.
#[must_use]
pub fn star_noise(stars: &[PredictedStar], image: Option<&SkyImage>, expected: f64) -> Vec<StarNoise> {
    let psf = image.and_then(|image| image.psf.as_ref());
    let drawn = image.and_then(|image| ImageNoise::draw(image, expected));
    let shapes: Vec<Shape> = if psf.is_some() { Vec::new() } else { parallel::map(stars, |one| shape_near(stars, &one.star)) };
    let of = |index: usize| {
        let PredictedStar { star, conditions, .. } = &stars[index];
        let fit = StarFit::of(star, psf.map(|psf| psf.under(*conditions)).as_deref(), shapes.get(index).copied(), expected)?;
        let drawn = drawn.as_ref().map(|noise| noise.at(index, (star.stamp.window, &fit.model), *conditions)).unwrap_or_default();
        fit.noise(&drawn, expected)
    };
    parallel::map_numbers(stars.len(), of).into_iter().flatten().collect()
}

/// The mean shape of the stars nearest to one, by what each tells, without its own, which follows its noise.
fn shape_near(stars: &[PredictedStar], about: &PsfStar) -> Shape {
    const NEAREST: usize = 25;
    let apart2 = |star: &PsfStar| (star.model.x - about.model.x).powi(2) + (star.model.y - about.model.y).powi(2);
    let is_alike = |star: &&PsfStar| star.model.shape.trail == about.model.shape.trail && !std::ptr::eq(*star, about);
    let mut near: Vec<&PsfStar> = stars.iter().map(|one| &one.star).filter(is_alike).collect();
    if near.is_empty() {
        return about.model.shape;
    }
    ascending(&mut near, |star| apart2(star));
    near.truncate(NEAREST);
    let sums = near.iter().fold([0.0; 4], |sum, star| {
        let (weight, shape) = (star.snr * star.snr, star.model.shape);
        [sum[0] + weight, sum[1] + weight * shape.xx, sum[2] + weight * shape.xy, sum[3] + weight * shape.yy]
    });
    let [weight, xx, xy, yy] = sums;
    Shape { xx: xx / weight, xy: xy / weight, yy: yy / weight, trail: about.model.shape.trail }
}

/// A star's pixels under its fit, those that are used.
struct StarFit {
    model: Model,
    /// Their index in the stamp.
    used: Vec<usize>,
    light_dn: Vec<f64>,
    /// What the fit leaves, counts.
    rest_dn: Vec<f64>,
    /// Sky's variance, and that of all light.
    sky_dn2: Vec<f64>,
    variance_dn2: Vec<f64>,
    /// Rows of the design matrix, and these times the covariance of the parameters.
    rows: Vec<[f64; 7]>,
    levers: Vec<[f64; 7]>,
}

fn dot(a: &[f64; 7], b: &[f64; 7]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl StarFit {
    fn of(star: &PsfStar, psf: Option<&EmpiricalPsf>, shape: Option<Shape>, expected: f64) -> Option<Self> {
        let photons = Photons { variance_per_dn: expected };
        let shape = shape.unwrap_or(star.model.shape);
        let freedom = match psf {
            Some(_) => Freedom::Empirical,
            None if shape.is_round() => Freedom::Fixed,
            None => Freedom::Ellipse,
        };
        let mut profile = Profile::of(psf);
        let start = Model { empirical: psf.is_some(), shape, ..star.model };
        let (model, offset) = photons.climb(&star.stamp, start, freedom, &mut profile)?;
        profile.draw(star.stamp.window, &model, freedom == Freedom::Ellipse);
        let count = freedom.parameters();
        let covariance = inverse(&photons.normal(&star.stamp, &profile, model.flux_dn, offset, count).matrix, count)?;
        let used: Vec<usize> = (0..profile.value.len()).filter(|i| star.stamp.used[*i]).collect();
        let light_dn: Vec<f64> = used.iter().map(|i| (profile.value[*i] * model.flux_dn).max(0.0)).collect();
        let rest_dn = used.iter().zip(&light_dn).map(|(i, light)| star.stamp.data[*i] - light - offset).collect();
        let sky_dn2: Vec<f64> = used.iter().map(|i| star.stamp.variance[*i]).collect();
        let variance_dn2 = sky_dn2.iter().zip(&light_dn).map(|(sky, light)| sky + light * expected).collect();
        let rows: Vec<[f64; 7]> = used.iter().map(|i| profile.row(*i, model.flux_dn)).collect();
        // Beyond the parameters of the fit the covariance is zero.
        let levers = rows.iter().map(|row| std::array::from_fn(|a| dot(&covariance[a], row))).collect();
        Some(Self { model, used, light_dn, rest_dn, sky_dn2, variance_dn2, rows, levers })
    }

    /// What the fit of a star leaves of counts in the pixels that are used.
    fn left_of(&self, counts: &[f64]) -> Vec<f64> {
        let mut taken = [0.0; 7];
        for ((lever, value), variance) in self.levers.iter().zip(counts).zip(&self.variance_dn2) {
            taken.iter_mut().zip(lever).for_each(|(sum, lever)| *sum += lever * value / variance);
        }
        self.rows.iter().zip(counts).map(|(row, value)| value - dot(row, &taken)).collect()
    }

    /// Of noise that was drawn for the stars of an image, how much larger the square of what is left of each pixel is without the image that follows it;
    /// mean of the draws.
    fn followed(&self, drawn: &[Drawn]) -> Vec<f64> {
        let mut mean = vec![0.0; self.used.len()];
        for own in drawn {
            let without: Vec<f64> = self.used.iter().map(|i| own.noise_dn[*i]).collect();
            let with: Vec<f64> = self.used.iter().map(|i| own.noise_dn[*i] - own.image_dn[*i]).collect();
            for ((mean, without), with) in mean.iter_mut().zip(self.left_of(&without)).zip(self.left_of(&with)) {
                *mean += (without * without - with * with) / drawn.len() as f64;
            }
        }
        mean
    }

    /// What its pixels with light tell.
    fn noise(&self, drawn: &[Drawn], expected: f64) -> Option<StarNoise> {
        /// Pixels with less of the light at the peak tell of the sky alone.
        const MIN_SHARE: f64 = 0.01;
        let least = MIN_SHARE * self.light_dn.iter().copied().fold(0.0, f64::max);
        let followed = self.followed(drawn);
        let (mut excess, mut information, mut misfit) = (0.0, 0.0, 0.0);
        let mut weights = vec![0.0; self.used.len()];
        for i in (0..self.used.len()).filter(|i| self.light_dn[*i] > least) {
            let (mut quiet, mut lit) = (0.0, 0.0);
            for (j, other) in self.rows.iter().enumerate() {
                let hat = dot(&self.levers[i], other) / self.variance_dn2[j];
                let left = (if i == j { 1.0 - hat } else { -hat }).powi(2);
                quiet += left * self.sky_dn2[j];
                lit += left * self.light_dn[j];
            }
            // The variance of a squared normal number is twice the square of its mean.
            let weight = 0.5 * lit * (quiet + expected * lit).powi(-2);
            excess += weight * (self.rest_dn[i].powi(2) + followed[i] - quiet);
            information += weight * lit;
            misfit += weight * self.light_dn[i].powi(2);
            weights[i] = weight;
        }
        let is_told = information > 0.0 && information.is_finite();
        is_told.then(|| StarNoise {
            variance_per_dn: excess / information,
            sigma: self.variance_of_squares(&weights).sqrt() / information,
            per_misfit2: misfit / information,
        })
    }

    /// Variance of Σ w_i r_i²: 2 Σ w_i w_j C_ij², where the fit leaves residuals with the covariance C = V − A (Aᵀ V⁻¹ A)⁻¹ Aᵀ of noise V and design
    /// matrix A.
    fn variance_of_squares(&self, weights: &[f64]) -> f64 {
        let lit: Vec<usize> = (0..weights.len()).filter(|i| weights[*i] > 0.0).collect();
        let of = |i: usize| {
            let pair = |j: &usize| {
                let shared = if i == *j { self.variance_dn2[i] } else { 0.0 } - dot(&self.levers[i], &self.rows[*j]);
                weights[i] * weights[*j] * shared * shared
            };
            lit.iter().map(pair).sum::<f64>()
        };
        2.0 * lit.iter().map(|i| of(*i)).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, Normal};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::detect::DetectOptions;
    use crate::detect::epsf_sky::learn_from_sky;
    use crate::detect::image_model::paint_star;
    use crate::detect::measure::{Aids, detect_aided};
    use crate::frame::Frame;

    const SIDE: usize = 400;
    const SKY_DN: f64 = 4.0;
    const PER_DN: f64 = 0.4;

    /// Stars of a frame, as detection keeps them where no gain is declared. `halo`: the share of their light in a wide skirt, which no Gaussian is.
    fn kept(seed: u64, halo: f64) -> Vec<PredictedStar> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut light = vec![0.0; SIDE * SIDE];
        let mut places = Vec::new();
        for cell in 0..100 {
            let at = [cell % 10, cell / 10].map(|k| 24.0 + 38.0 * f64::from(k) + rng.random_range(-4.0..4.0));
            let flux = 500.0 * 40.0_f64.powf(rng.random_range(0.0..1.0));
            paint_star(&mut light, SIDE, at, flux, &[(1.0 - halo, 0.9), (halo, 2.0)]);
            places.push(at);
        }
        let mut count = |light: f64| {
            let noise = Normal::new(0.0, (SKY_DN * SKY_DN + PER_DN * light).sqrt()).unwrap();
            (100.0 + light + noise.sample(&mut rng)).round() as f32
        };
        let pixels_dn = light.into_iter().map(&mut count).collect();
        let frame = Frame { width_px: SIDE, height_px: SIDE, pixels_dn, saturation_dn: f32::INFINITY };
        let (_, kept) = detect_aided(&frame, &DetectOptions::default(), &Aids { keep: 100, ..Aids::default() }).unwrap();
        let predicted = |star: PsfStar| {
            let [x, y] = star.place_px();
            let predicted_px = places.iter().find(|at| (at[0] - x).hypot(at[1] - y) < 1.0).copied()?;
            Some(PredictedStar { frame: seed as usize, predicted_px, conditions: [0.0; 2], star })
        };
        kept.into_iter().filter_map(predicted).collect()
    }

    /// Weighted mean of what the stars tell, in its standard errors off the truth, and χ² per star about it.
    fn pull(told: &[StarNoise]) -> [f64; 2] {
        let weight: f64 = told.iter().map(|own| own.sigma.powi(-2)).sum();
        let mean = told.iter().map(|own| own.variance_per_dn * own.sigma.powi(-2)).sum::<f64>() / weight;
        let chi2: f64 = told.iter().map(|own| ((own.variance_per_dn - mean) / own.sigma).powi(2)).sum();
        [(mean - PER_DN) * weight.sqrt(), chi2 / told.len() as f64]
    }

    /// The gain that photons were drawn with, as well as it is said to be known; a skirt that the image lacks shows as a value that is too large.
    #[test]
    fn the_noise_of_stars_tells_their_gain() {
        const SEEDS: u64 = 96;
        let mut sums = [0.0; 3];
        for seed in 0..SEEDS {
            let stars = kept(seed, 0.0);
            let told = star_noise(&stars, None, PER_DN);
            assert!(told.len() > 60 && told.iter().all(|own| own.per_misfit2 > 0.0), "seed {seed}: {} stars", told.len());
            let [off, scatter] = pull(&told);
            for (sum, value) in sums.iter_mut().zip([off, off * off, scatter]) {
                *sum += value / SEEDS as f64;
            }
        }
        let [mean, square, scatter] = sums;
        assert!(mean.abs() < 0.35, "mean pull {mean}");
        assert!((0.65..1.4).contains(&square), "mean squared pull {square}, mean {mean}, {scatter}");
        assert!((0.85..1.2).contains(&scatter), "scatter of stars about their mean {scatter}");
        let [off, _] = pull(&star_noise(&kept(3, 0.25), None, PER_DN));
        assert!(off > 6.0, "a wrong image passes for photons: {off}");
    }

    /// The same under an image that a third of the stars taught: without what it follows of their noise the values are too small.
    #[test]
    fn an_image_learnt_from_the_stars_takes_none_of_their_noise() {
        const NIGHTS: u64 = 8;
        let (mut mean, mut square, mut without) = (0.0, 0.0, 0.0);
        for night in 0..NIGHTS {
            let stars: Vec<PredictedStar> = (0..3).flat_map(|frame| kept(1000 + 3 * night + frame, 0.25)).collect();
            let image = learn_from_sky(&stars, [false; 2]);
            assert!(image.psf.is_some(), "{:?}", image.report);
            let [off, _] = pull(&star_noise(&stars, Some(&image), PER_DN));
            let [unaware, _] = pull(&star_noise(&stars, Some(&SkyImage { learnt_from: Vec::new(), ..image }), PER_DN));
            for (sum, value) in [&mut mean, &mut square, &mut without].into_iter().zip([off, off * off, unaware]) {
                *sum += value / NIGHTS as f64;
            }
        }
        // The mean of so many pulls is known to 0.35.
        assert!(mean.abs() < 1.0, "mean pull {mean}");
        assert!((0.3..2.5).contains(&square), "mean squared pull {square}");
        assert!(without < mean - 0.7, "{without} without what the image follows, {mean} with it");
    }
}

//! How the noise grows with the light, told by the pixels of single stars: what is left of them under the image that the recording's stars were seen to have.
//!
//! Of a weighted least-squares fit with hat matrix H the residuals have E r_i² = Σ_j (δ_ij − H_ij)² v_j with v_j = σ_j² + κ·s_j: sky's noise σ_j, light
//! s_j, and κ the variance of the counts per count of light, which is 1 / gain. Where the image differs by a share ε of the light, E r_i² is larger by
//! ε²·s_i²: a star says how much of its value such a share would make, so that many stars of unlike brightness tell the two apart.

use super::epsf::EmpiricalPsf;
use super::epsf_build::PsfStar;
use super::epsf_sky::PredictedStar;
use super::fit::Freedom;
use super::image_model::{Model, Shape};
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

/// What each star tells, as its noise is expected with `expected` per count of light. Stars that no image fits tell nothing. `psf`: the image that was
/// learnt, else a Gaussian of the shape of the stars nearest to it.
#[must_use]
pub fn star_noise(stars: &[PredictedStar], psf: Option<&EmpiricalPsf>, expected: f64) -> Vec<StarNoise> {
    let shapes: Vec<Shape> = if psf.is_some() { Vec::new() } else { parallel::map(stars, |one| shape_near(stars, &one.star)) };
    let of = |index: usize| {
        let PredictedStar { star, conditions, .. } = &stars[index];
        star.noise(psf.map(|psf| psf.under(*conditions)).as_deref(), shapes.get(index).copied(), expected)
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

impl PsfStar {
    fn noise(&self, psf: Option<&EmpiricalPsf>, shape: Option<Shape>, expected: f64) -> Option<StarNoise> {
        /// Pixels with less of the light at the peak tell of the sky alone.
        const MIN_SHARE: f64 = 0.01;
        let photons = Photons { variance_per_dn: expected };
        let shape = shape.unwrap_or(self.model.shape);
        let freedom = match psf {
            Some(_) => Freedom::Empirical,
            None if shape.is_round() => Freedom::Fixed,
            None => Freedom::Ellipse,
        };
        let mut profile = Profile::of(psf);
        let start = Model { empirical: psf.is_some(), shape, ..self.model };
        let (model, offset) = photons.climb(&self.stamp, start, freedom, &mut profile)?;
        profile.draw(self.stamp.window, &model, freedom == Freedom::Ellipse);
        let count = freedom.parameters();
        let covariance = inverse(&photons.normal(&self.stamp, &profile, model.flux_dn, offset, count).matrix, count)?;
        let light: Vec<f64> = profile.value.iter().map(|share| (share * model.flux_dn).max(0.0)).collect();
        let least = MIN_SHARE * light.iter().copied().fold(0.0, f64::max);
        let used: Vec<usize> = (0..light.len()).filter(|i| self.stamp.used[*i]).collect();
        let rows: Vec<[f64; 7]> = used.iter().map(|i| profile.row(*i, model.flux_dn)).collect();
        let (mut excess, mut information, mut misfit) = (0.0, 0.0, 0.0);
        for (row, i) in rows.iter().zip(&used).filter(|(_, i)| light[**i] > least) {
            // Beyond the parameters of the fit the covariance is zero.
            let lever: [f64; 7] = std::array::from_fn(|a| covariance[a].iter().zip(row).map(|(own, row)| own * row).sum());
            let (mut quiet, mut lit) = (0.0, 0.0);
            for (other, j) in rows.iter().zip(&used) {
                let weight = 1.0 / (self.stamp.variance[*j] + light[*j] * expected);
                let hat = (0..count).map(|a| lever[a] * other[a]).sum::<f64>() * weight;
                let left = (if i == j { 1.0 - hat } else { -hat }).powi(2);
                quiet += left * self.stamp.variance[*j];
                lit += left * light[*j];
            }
            let rest = self.stamp.data[*i] - light[*i] - offset;
            // The variance of a squared normal number is twice the square of its mean.
            let weight = 0.5 * lit * (quiet + expected * lit).powi(-2);
            excess += weight * (rest * rest - quiet);
            information += weight * lit;
            misfit += weight * light[*i] * light[*i];
        }
        let is_told = information > 0.0 && information.is_finite();
        is_told.then(|| StarNoise {
            variance_per_dn: excess / information,
            sigma: information.sqrt().recip(),
            per_misfit2: misfit / information,
        })
    }
}

//! What a learnt image follows of the noise of the stars that it was learnt from.
//!
//! Numbers of an image that stars determine take up a part of their noise: the residuals of these stars are too small, and those of all others too
//! large. Both are told by drawing noise for the pixels of the stars that taught the image and solving the image's linear step for it (parametric
//! bootstrap: Efron & Tibshirani 1993, *An Introduction to the Bootstrap*, 6.5). Only second moments are asked for: noise of either sign will do
//! (Hutchinson 1990, Commun. Stat. Simul. Comput. 19, 433).

use std::collections::BTreeMap;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::epsf::{Conditions, EmpiricalPsf, FREEDOM_BY_SKY, light_of_knots};
use super::epsf_build::{PsfStar, turn};
use super::epsf_sky::SkyImage;
use super::epsf_step::{Turn, Unknowns};
use super::image_model::{Model, Window};
use super::psf::Profile;
use crate::parallel;

/// Draws of noise. Even one of them scatters less than the stars' own values do.
const DRAWS: u64 = 6;

/// Noise that was drawn, and images that follow it.
pub(super) struct ImageNoise<'a> {
    psf: &'a EmpiricalPsf,
    draws: Vec<Draw>,
}

/// Noise of the pixels of the stars that the image was learnt from, by their index, counts, and the change that it makes of the image's knots.
struct Draw {
    noise_dn: BTreeMap<usize, Vec<f64>>,
    knots: Vec<f64>,
}

/// A drawn noise in the window of a star, counts, all zero where the image was learnt without it, and what the image that follows the noise adds there.
pub(super) struct Drawn {
    pub(super) noise_dn: Vec<f64>,
    pub(super) image_dn: Vec<f64>,
}

impl<'a> ImageNoise<'a> {
    /// Of an image that was learnt where the sky says that the stars are. `per_dn`: variance of the counts per count of light.
    pub(super) fn draw(image: &'a SkyImage, per_dn: f64) -> Option<Self> {
        let psf = image.psf.as_ref()?;
        let unknowns = Unknowns::new(psf.grid, psf.base, psf.terms.count(), FREEDOM_BY_SKY);
        let settled = |number: usize| {
            let own = &image.learnt_from[number];
            Some((own, turn(&own.1, Model { empirical: true, shape: psf.base, ..own.1.model }, psf)?))
        };
        let stars: Vec<(&(usize, PsfStar), Turn<'_>)> =
            parallel::map_numbers(image.learnt_from.len(), settled).into_iter().flatten().collect();
        let sigmas: Vec<Vec<f64>> = stars.iter().map(|((_, star), turn)| sigmas_dn(star, &turn.model, psf, per_dn)).collect();
        let (indices, mut turns): (Vec<usize>, Vec<Turn<'_>>) = stars.into_iter().map(|((index, _), turn)| (*index, turn)).unzip();
        let draws = (0..DRAWS).map(|number| {
            let mut rng = Pcg64Mcg::seed_from_u64(number);
            let mut either_sign = |sigma: f64| if rng.random() { sigma } else { -sigma };
            for (turn, sigmas) in turns.iter_mut().zip(&sigmas) {
                turn.rest = sigmas.iter().map(|sigma| either_sign(*sigma)).collect();
                turn.pull = [0.0, 0.0, either_sign(image.place_sigma_px.recip()), either_sign(image.place_sigma_px.recip())];
            }
            let mut knots = vec![0.0; psf.knots.len()];
            unknowns.solve(&turns, &mut knots);
            Draw { noise_dn: indices.iter().copied().zip(turns.iter().map(|turn| turn.rest.clone())).collect(), knots }
        });
        Some(Self { psf, draws: draws.collect() })
    }

    /// What was drawn, in the window of a star that is fitted so; `index`: its place among the stars of which some taught the image.
    pub(super) fn at(&self, index: usize, (window, model): (Window, &Model), conditions: Conditions) -> Vec<Drawn> {
        let (grid, pixels) = (self.psf.grid, window.columns * window.rows);
        let lines = grid.lines(window, [model.x, model.y]);
        let terms = self.psf.terms.at(self.psf.size_px, [model.x, model.y], conditions);
        let of = |draw: &Draw| {
            let (mut local, mut image_dn) = (vec![0.0; grid.knots()], vec![0.0; pixels]);
            for (term, knots) in terms.iter().zip(draw.knots.chunks_exact(grid.knots())) {
                local.iter_mut().zip(knots).for_each(|(sum, knot)| *sum += term * knot);
            }
            light_of_knots(&local, &lines, model.flux_dn, &mut image_dn);
            Drawn { noise_dn: draw.noise_dn.get(&index).cloned().unwrap_or_else(|| vec![0.0; pixels]), image_dn }
        };
        self.draws.iter().map(of).collect()
    }
}

/// Noise of the pixels of a star that are used, counts.
fn sigmas_dn(star: &PsfStar, model: &Model, psf: &EmpiricalPsf, per_dn: f64) -> Vec<f64> {
    let of_star = psf.under(star.conditions);
    let mut profile = Profile::of(Some(&of_star));
    profile.draw(star.stamp.window, model, false);
    let sigma = |i: usize| (star.stamp.variance[i] + per_dn * (profile.value[i] * model.flux_dn).max(0.0)).sqrt();
    (0..profile.value.len()).map(|i| if star.stamp.used[i] { sigma(i) } else { 0.0 }).collect()
}

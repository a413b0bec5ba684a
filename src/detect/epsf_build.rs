//! Builds the ePSF from the recording's own stars.
//!
//! ePSF and positions are fitted in turns, as by Anderson & King 2000 (PASP 112, 1360, section 4), but each step for the ePSF projects out
//! position, flux and background of every star, so that few iterations suffice and errors of the first positions leave no trace. A prior
//! regularises what few stars determine: a correction is small against the image, and smaller in its wings.

use rayon::prelude::*;

use super::epsf::{EmpiricalPsf, FIELD_TERMS, Grid, PsfReport, field_terms};
use super::epsf_step::{Turn, Unknowns};
use super::fit::Freedom;
use super::image_model::{Model, Shape, radius_px};
use super::psf::Profile;
use super::stamp::{Photons, Stamp};
use crate::statistics::cholesky::inverse;
use crate::statistics::median;

/// A star that may tell the image: its pixels and how a Gaussian fits them.
#[derive(Clone)]
pub struct PsfStar {
    pub(super) stamp: Stamp,
    pub(super) model: Model,
    pub(super) photons: Photons,
    pub(super) snr: f64,
    /// χ² and degrees of freedom under a Gaussian of free shape.
    pub(super) gaussian: (f64, f64),
    pub(super) size_px: [f64; 2],
}

/// Fewer stars tell no image.
const MIN_STARS: usize = 25;
/// Pixels that are used for it, about: more make it no better and take time.
const MAX_PIXELS: usize = 200_000;
/// Stars for each term of the field polynomial, at least.
const STARS_PER_TERM: usize = 40;
/// One in so many is held out.
const HELD_OUT: usize = 4;
/// With so many stars those held out once are enough to judge by.
const MANY_STARS: usize = 400;
/// Turns of image and positions, at most, and by which share χ² must fall for another.
const MAX_TURNS: usize = 12;
const WORTH_A_TURN: f64 = 0.003;
/// A step for the image is linear in the positions, and from Gaussians it goes too far: of one that makes χ² larger a part is tried, down to this.
const PART: f64 = 0.4;
const MIN_SHARE: f64 = 0.02;
/// A more complex image must fit held-out stars better by so many σ of what chance makes.
const CLEARLY_SIGMA: f64 = 3.0;
/// An image that leaves held-out stars more than this per degree of freedom has not been found: places would be worse with it, not better.
const MAX_CHI2: f64 = 1.5;

/// The image that held-out stars prefer to Gaussians, if there is one, and what they said.
#[must_use]
pub fn learn(stars: &[PsfStar]) -> (Option<EmpiricalPsf>, PsfReport) {
    let mut chosen: Vec<&PsfStar> = stars.iter().collect();
    chosen.sort_by(|a, b| b.snr.total_cmp(&a.snr));
    let mut pixels = 0;
    chosen.retain(|s| {
        pixels += s.stamp.data.len();
        pixels <= MAX_PIXELS
    });
    let mut report = PsfReport {
        empirical: false,
        stars: chosen.len(),
        held_out_stars: 0,
        gaussian_chi2_per_dof: 0.0,
        empirical_chi2_per_dof: 0.0,
        field_order: 0,
    };
    if chosen.len() < MIN_STARS {
        return (None, report);
    }
    // of few stars every one is held out in turn
    let folds = if chosen.len() < MANY_STARS { HELD_OUT } else { 1 };
    let part = |fold: usize, held: bool| -> Vec<&PsfStar> {
        chosen.iter().enumerate().filter(|(i, _)| (i % HELD_OUT == HELD_OUT - 1 - fold) == held).map(|(_, star)| *star).collect()
    };
    let held: Vec<Vec<&PsfStar>> = (0..folds).map(|fold| part(fold, true)).collect();
    report.held_out_stars = held.iter().map(Vec::len).sum();
    let mut best: Vec<(f64, f64)> = held.iter().flatten().map(|s| s.gaussian).collect();
    report.gaussian_chi2_per_dof = per_dof(&best);
    report.empirical_chi2_per_dof = f64::INFINITY;
    let mut images: Vec<Option<EmpiricalPsf>> = vec![None; folds];
    for (order, terms) in FIELD_TERMS.into_iter().enumerate() {
        if order > 0 && chosen.len() < STARS_PER_TERM * terms {
            break;
        }
        for (fold, image) in images.iter_mut().enumerate() {
            *image = fit_image(&part(fold, false), order, image.as_ref());
        }
        let judged: Option<Vec<Vec<(f64, f64)>>> =
            images.iter().zip(&held).map(|(image, held)| image.as_ref().map(|trial| judge(held, trial))).collect();
        let Some(judged) = judged.map(|j| j.concat()) else { break };
        if order == 0 || per_dof(&judged) < report.empirical_chi2_per_dof {
            report.empirical_chi2_per_dof = per_dof(&judged);
        }
        if clearly_better(&judged, &best) && per_dof(&judged) < MAX_CHI2 {
            (report.empirical, report.field_order) = (true, order);
            best = judged;
        }
    }
    let psf = report.empirical.then(|| fit_image(&chosen, report.field_order, images[0].as_ref())).flatten();
    report.empirical = psf.is_some();
    (psf, report)
}

fn per_dof(judged: &[(f64, f64)]) -> f64 {
    judged.iter().map(|j| j.0).sum::<f64>() / judged.iter().map(|j| j.1).sum::<f64>().max(1.0)
}

/// Whether the first are clearly better: the sum of the differences against their own scatter, which one odd star cannot decide.
fn clearly_better(new: &[(f64, f64)], old: &[(f64, f64)]) -> bool {
    let differences = || new.iter().zip(old).map(|(n, o)| o.0 / o.1 - n.0 / n.1);
    let (sum, square) = (differences().sum::<f64>(), differences().map(|d| d * d).sum::<f64>());
    square > 0.0 && sum > CLEARLY_SIGMA * square.sqrt()
}

/// χ² and degrees of freedom of stars under an image; a star that it cannot fit counts as its Gaussian, thrice as bad.
fn judge(stars: &[&PsfStar], psf: &EmpiricalPsf) -> Vec<(f64, f64)> {
    let of = |star: &&PsfStar| {
        let mut profile = Profile::of(Some(psf));
        let start = Model { empirical: true, ..star.model };
        let dof = star.gaussian.1;
        let Some((model, offset)) = star.photons.climb(&star.stamp, start, Freedom::Empirical, &mut profile) else {
            return (3.0 * star.gaussian.0, dof);
        };
        profile.draw(star.stamp.window, &model, false);
        let count = Freedom::Empirical.parameters();
        let used = star.stamp.used.iter().filter(|u| **u).count();
        (star.photons.normal(&star.stamp, &profile, model.flux_dn, offset, count).chi2, used.saturating_sub(count).max(1) as f64)
    };
    stars.par_iter().map(of).collect()
}

/// The image of these stars, from `start` on if there is one.
fn fit_image(stars: &[&PsfStar], order: usize, start: Option<&EmpiricalPsf>) -> Option<EmpiricalPsf> {
    let middle = |pick: fn(&Shape) -> f64| median(&stars.iter().map(|s| pick(&s.model.shape)).collect::<Vec<_>>());
    let trail = stars.iter().all(|s| s.model.shape.trail);
    let shape = Shape { xx: middle(|s| s.xx)?, xy: middle(|s| s.xy)?, yy: middle(|s| s.yy)?, trail };
    let base = if stars.iter().all(|s| s.model.shape.is_round()) { Shape::round(shape.sigma_px()) } else { shape };
    let grid = Grid::for_image(base.axes_px().0, radius_px(base));
    let unknowns = Unknowns::new(grid, base, FIELD_TERMS[order]);
    let size_px = stars.first()?.size_px;
    let mut psf = EmpiricalPsf { base, grid, size_px, knots: vec![0.0; grid.knots() * FIELD_TERMS[order]] };
    if let Some(start) = start.filter(|start| start.grid == grid && start.base == base) {
        for (knot, from) in psf.knots.iter_mut().zip(&start.knots) {
            *knot = *from;
        }
    }
    let models: Vec<Model> = stars.iter().map(|s| Model { empirical: true, shape: base, ..s.model }).collect();
    let mut now = Look::at(stars, models, &psf)?;
    for _ in 0..MAX_TURNS {
        let mut knots = psf.knots.clone();
        unknowns.solve(&now.turns, &mut knots);
        let mut share = 1.0;
        let better = loop {
            let between = psf.knots.iter().zip(&knots).map(|(from, to)| from + share * (to - from)).collect();
            let trial = EmpiricalPsf { knots: between, ..psf.clone() };
            match Look::at(stars, now.models.clone(), &trial) {
                Some(look) if look.chi2 < now.chi2 => break Some((trial, look)),
                _ if share < MIN_SHARE => break None,
                _ => share *= PART,
            }
        };
        let Some((trial, look)) = better else { break };
        let settled = share == 1.0 && look.chi2 > (1.0 - WORTH_A_TURN) * now.chi2;
        (psf, now) = (trial, look);
        if settled {
            break;
        }
    }
    Some(psf)
}

/// The stars under an image.
struct Look<'a> {
    models: Vec<Model>,
    turns: Vec<Turn<'a>>,
    chi2: f64,
}

impl<'a> Look<'a> {
    /// `None` where more than half cannot be fitted.
    fn at(stars: &[&'a PsfStar], mut models: Vec<Model>, psf: &EmpiricalPsf) -> Option<Self> {
        let found: Vec<Option<Turn<'_>>> = stars.par_iter().zip(&models).map(|(star, model)| turn(star, *model, psf)).collect();
        for (model, turn) in models.iter_mut().zip(&found) {
            if let Some(turn) = turn {
                *model = turn.model;
            }
        }
        let turns: Vec<Turn<'_>> = found.into_iter().flatten().collect();
        let chi2 = turns.iter().map(|t| t.chi2).sum::<f64>() / turns.iter().map(|t| t.rows.len() as f64).sum::<f64>();
        (turns.len() * 2 >= stars.len()).then_some(Self { models, turns, chi2 })
    }
}

/// Fits one star with the present image.
fn turn<'a>(star: &'a PsfStar, model: Model, psf: &EmpiricalPsf) -> Option<Turn<'a>> {
    let mut profile = Profile::of(Some(psf));
    let mut stay = |model: Model| {
        profile.draw(star.stamp.window, &model, false);
        let (flux_dn, offset) = star.photons.linear(&star.stamp, &profile, model.flux_dn, 0.0)?;
        Some((Model { flux_dn, ..model }, offset))
    };
    // an image that is far off yet may give no place: then the star stays where it was
    let settled = star.photons.climb(&star.stamp, model, Freedom::Empirical, &mut Profile::of(Some(psf)));
    let (model, offset) = settled.or_else(|| stay(model))?;
    profile.draw(star.stamp.window, &model, false);
    let normal = star.photons.normal(&star.stamp, &profile, model.flux_dn, offset, 4);
    let rows: Vec<[f64; 4]> = (0..profile.value.len()).map(|i| profile.row(i, model.flux_dn)).map(|r| [r[0], r[1], r[2], r[3]]).collect();
    let weight = |((v, share), used): ((&f64, &f64), &bool)| {
        if *used { 1.0 / (v + (model.flux_dn * share).max(0.0) * star.photons.variance_per_dn) } else { 0.0 }
    };
    let weights: Vec<f64> = star.stamp.variance.iter().zip(&profile.value).zip(&star.stamp.used).map(weight).collect();
    let mut matrix = [[0.0; 7]; 7];
    for (row, w) in rows.iter().zip(&weights) {
        for a in 0..4 {
            for b in 0..4 {
                matrix[a][b] += w * row[a] * row[b];
            }
        }
    }
    let covariance = inverse(&matrix, 4)?;
    profile.draw(star.stamp.window, &Model { empirical: false, shape: psf.base, ..model }, false);
    let rest = star.stamp.data.iter().zip(&profile.value).map(|(d, share)| d - model.flux_dn * share - offset).collect();
    let terms = field_terms(psf.size_px, [model.x, model.y]);
    let lines = psf.grid.lines(star.stamp.window, [model.x, model.y]);
    Some(Turn { model, chi2: normal.chi2, lines, terms, weights, rest, rows, covariance, stamp: &star.stamp })
}

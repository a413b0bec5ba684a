//! Builds the ePSF from the recording's own stars.
//!
//! ePSF and positions are fitted in turns, as by Anderson & King 2000 (PASP 112, 1360, section 4), but each step for the ePSF projects out
//! position, flux and background of every star, so that few iterations suffice and errors of the first positions leave no trace. A prior
//! regularises what few stars determine: a correction is small against the image, and smaller in its wings.

use super::epsf::{Conditions, EmpiricalPsf, FIELD_TERMS, FREEDOM_BY_SKY, Grid, PsfReport, Terms};
use super::epsf_step::{Turn, Unknowns};
use super::fit::Freedom;
use super::image_model::{Model, Shape, radius_px};
use super::psf::Profile;
use super::stamp::{Photons, Stamp};
use crate::parallel;
use crate::statistics::cholesky::inverse;
use crate::statistics::median;
use crate::statistics::order::descending;

/// A star that may tell the image: its pixels and how a Gaussian fits them.
#[derive(Clone, Debug)]
pub struct PsfStar {
    pub(super) stamp: Stamp,
    pub(super) model: Model,
    pub(super) photons: Photons,
    pub(super) snr: f64,
    /// Deviance and degrees of freedom under a Gaussian of free shape.
    pub(super) gaussian: (f64, f64),
    /// Covariance of its place under it: xx, xy, yy, px².
    pub(super) covariance_px2: [f64; 3],
    pub(super) size_px: [f64; 2],
    pub(super) conditions: Conditions,
    /// Where it must stand, if anything but its own pixels says.
    pub(super) sky: Option<SkyPlace>,
}

/// Where the sky says a star stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SkyPlace {
    pub(super) at_px: [f64; 2],
    /// Standard error along each axis.
    pub(super) sigma_px: f64,
}

impl SkyPlace {
    /// The likeliest place of a star that its pixels place so, given the sky.
    fn likeliest_px(self, at_px: [f64; 2], [xx, xy, yy]: [f64; 3]) -> [f64; 2] {
        let [dx, dy] = [0, 1].map(|axis| self.at_px[axis] - at_px[axis]);
        let variance = self.sigma_px * self.sigma_px;
        let (sum_xx, sum_yy) = (xx + variance, yy + variance);
        let determinant = sum_xx * sum_yy - xy * xy;
        let [x, y] = [(sum_yy * dx - xy * dy) / determinant, (sum_xx * dy - xy * dx) / determinant];
        [at_px[0] + xx * x + xy * y, at_px[1] + xy * x + yy * y]
    }

    /// χ² of a place that is known so well.
    fn chi2(self, at_px: [f64; 2], [xx, xy, yy]: [f64; 3]) -> f64 {
        let [dx, dy] = [0, 1].map(|axis| self.at_px[axis] - at_px[axis]);
        let variance = self.sigma_px * self.sigma_px;
        let (sum_xx, sum_yy) = (xx + variance, yy + variance);
        (sum_yy * dx * dx - 2.0 * xy * dx * dy + sum_xx * dy * dy) / (sum_xx * sum_yy - xy * xy)
    }
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
/// Where the sky says the places an image need not be so clear: what it is wrong by counts for less in a place than that the true image is no Gaussian,
/// which no lens's is.
const BY_SKY_SIGMA: f64 = 1.0;
/// An image that leaves held-out stars more than this per degree of freedom has not been found: places would be worse with it, not better.
const MAX_CHI2: f64 = 1.5;

/// The image that held-out stars prefer to Gaussians, if there is one, and what they said.
#[must_use]
pub fn learn(stars: &[PsfStar]) -> (Option<EmpiricalPsf>, PsfReport) {
    learn_with(&brightest(stars, |star| star, MAX_PIXELS), Terms { order: FIELD_TERMS.len() - 1, by: [false; 2] })
}

/// The same, which may change with at most so much.
pub(super) fn learn_with(chosen: &[&PsfStar], most: Terms) -> (Option<EmpiricalPsf>, PsfReport) {
    let mut trial = Trial::new(chosen);
    if chosen.len() < MIN_STARS {
        return (None, trial.report);
    }
    for order in 0..=most.order {
        let terms = Terms { order, by: [false; 2] };
        if order > 0 && chosen.len() < STARS_PER_TERM * terms.count() || !trial.offer(terms) {
            break;
        }
    }
    for condition in (0..2).filter(|condition| most.by[*condition]) {
        let mut terms = trial.terms;
        terms.by[condition] = true;
        if trial.report.empirical && chosen.len() >= STARS_PER_TERM * terms.count() {
            trial.offer(terms);
        }
    }
    let mut report = trial.report;
    let psf = report.empirical.then(|| fit_image(chosen, trial.terms, trial.images[0].as_ref())).flatten();
    report.empirical = psf.is_some();
    (psf, report)
}

/// The brightest stars, as many as have so many pixels. `of`: the star of what is listed.
pub(super) fn brightest<T>(listed: &[T], of: impl Fn(&T) -> &PsfStar, most_pixels: usize) -> Vec<&T> {
    let mut chosen: Vec<&T> = listed.iter().collect();
    descending(&mut chosen, |one| of(one).snr);
    let mut pixels = 0;
    chosen.retain(|one| {
        pixels += of(one).stamp.data.len();
        pixels <= most_pixels
    });
    chosen
}

/// Images on trial before stars that are held out.
struct Trial<'a> {
    /// Stars that each image is learnt from, and those held out.
    parts: Vec<[Vec<&'a PsfStar>; 2]>,
    images: Vec<Option<EmpiricalPsf>>,
    /// χ² and degrees of freedom of the stars held out under the best image so far.
    best: Vec<(f64, f64)>,
    /// What that one changes with.
    terms: Terms,
    report: PsfReport,
}

impl<'a> Trial<'a> {
    fn new(chosen: &[&'a PsfStar]) -> Self {
        // of few stars every one is held out in turn
        let folds = match chosen.len() {
            ..MIN_STARS => 0,
            MIN_STARS..MANY_STARS => HELD_OUT,
            _ => 1,
        };
        let part = |fold: usize, held: bool| -> Vec<&PsfStar> {
            chosen.iter().enumerate().filter(|(i, _)| (i % HELD_OUT == HELD_OUT - 1 - fold) == held).map(|(_, star)| *star).collect()
        };
        let parts: Vec<[Vec<&PsfStar>; 2]> = (0..folds).map(|fold| [part(fold, false), part(fold, true)]).collect();
        let best: Vec<(f64, f64)> = parts.iter().flat_map(|[_, held]| held).map(|star| star.under_gaussian()).collect();
        let report = PsfReport {
            empirical: false,
            stars: chosen.len(),
            held_out_stars: best.len(),
            gaussian_deviance_per_dof: if best.is_empty() { 0.0 } else { per_dof(&best) },
            empirical_deviance_per_dof: if best.is_empty() { 0.0 } else { f64::INFINITY },
            field_order: 0,
        };
        Self { images: vec![None; parts.len()], parts, best, terms: Terms::default(), report }
    }

    /// Tries an image that changes with so much; it is taken if the stars held out clearly prefer it. Whether it could be fitted.
    fn offer(&mut self, terms: Terms) -> bool {
        let images: Option<Vec<EmpiricalPsf>> =
            self.parts.iter().zip(&self.images).map(|([own, _], image)| fit_image(own, terms, image.as_ref())).collect();
        let Some(images) = images else { return false };
        let judged: Vec<(f64, f64)> = images.iter().zip(&self.parts).flat_map(|(image, [_, held])| judge(held, image)).collect();
        let chi2 = per_dof(&judged);
        self.report.empirical_deviance_per_dof = self.report.empirical_deviance_per_dof.min(chi2);
        let by_sky = self.parts.iter().flatten().flatten().all(|star| star.sky.is_some());
        let sigmas = if by_sky && !self.report.empirical { BY_SKY_SIGMA } else { CLEARLY_SIGMA };
        if clearly_better(&judged, &self.best, sigmas) && chi2 < MAX_CHI2 {
            (self.report.empirical, self.report.field_order, self.terms) = (true, terms.order, terms);
            self.best = judged;
        }
        self.images = images.into_iter().map(Some).collect();
        true
    }
}

fn per_dof(judged: &[(f64, f64)]) -> f64 {
    judged.iter().map(|j| j.0).sum::<f64>() / judged.iter().map(|j| j.1).sum::<f64>().max(1.0)
}

/// Whether the first are better by so many standard errors: the sum of the differences against their own scatter, which one odd star cannot decide.
fn clearly_better(new: &[(f64, f64)], old: &[(f64, f64)], sigmas: f64) -> bool {
    let differences = || new.iter().zip(old).map(|(n, o)| o.0 / o.1 - n.0 / n.1);
    let (sum, square) = (differences().sum::<f64>(), differences().map(|d| d * d).sum::<f64>());
    square > 0.0 && sum > sigmas * square.sqrt()
}

impl PsfStar {
    /// Column and row where its pixels place it, under a Gaussian.
    #[must_use]
    pub const fn place_px(&self) -> [f64; 2] {
        [self.model.x, self.model.y]
    }

    /// Variance of the counts per count of light that it was fitted with.
    #[must_use]
    pub const fn variance_per_dn(&self) -> f64 {
        self.photons.variance_per_dn
    }

    /// χ² and degrees of freedom of a Gaussian of free shape, and of the place if the sky says it.
    fn under_gaussian(&self) -> (f64, f64) {
        let (chi2, dof) = self.gaussian;
        self.sky.map_or((chi2, dof), |sky| (chi2 + sky.chi2([self.model.x, self.model.y], self.covariance_px2), dof + 2.0))
    }
}

/// χ² and degrees of freedom of stars under an image; a star that it cannot fit counts as its Gaussian, thrice as bad.
fn judge(stars: &[&PsfStar], psf: &EmpiricalPsf) -> Vec<(f64, f64)> {
    let of = |star: &&PsfStar| {
        let psf = psf.under(star.conditions);
        let mut profile = Profile::of(Some(&psf));
        let start = Model { empirical: true, ..star.model };
        let (chi2, dof) = star.under_gaussian();
        let Some((model, offset)) = star.photons.climb(&star.stamp, start, Freedom::Empirical, &mut profile) else {
            return (3.0 * chi2, dof);
        };
        profile.draw(star.stamp.window, &model, false);
        let count = Freedom::Empirical.parameters();
        let used = star.stamp.used.iter().filter(|u| **u).count();
        let normal = star.photons.normal(&star.stamp, &profile, model.flux_dn, offset, count);
        let of_place = star.sky.zip(inverse(&normal.matrix, count));
        let place = of_place.map_or(0.0, |(sky, own)| sky.chi2([model.x, model.y], [own[2][2], own[3][2], own[3][3]]));
        let of_sky = if of_place.is_some() { 2.0 } else { 0.0 };
        let deviance = star.photons.deviance(&star.stamp, &profile, model.flux_dn, offset);
        (deviance + place, used.saturating_sub(count).max(1) as f64 + of_sky)
    };
    parallel::map(stars, of)
}

/// The image of these stars, from `start` on if there is one.
pub(super) fn fit_image(stars: &[&PsfStar], terms: Terms, start: Option<&EmpiricalPsf>) -> Option<EmpiricalPsf> {
    let middle = |pick: fn(&Shape) -> f64| median(&stars.iter().map(|s| pick(&s.model.shape)).collect::<Vec<_>>());
    let trail = stars.iter().all(|s| s.model.shape.trail);
    let shape = Shape { xx: middle(|s| s.xx)?, xy: middle(|s| s.xy)?, yy: middle(|s| s.yy)?, trail };
    let base = if stars.iter().all(|s| s.model.shape.is_round()) { Shape::round(shape.sigma_px()) } else { shape };
    let (sigma_px, radius) = (base.axes_px().0, radius_px(base));
    let (grid, freedom) = if stars.iter().all(|star| star.sky.is_some()) {
        (Grid::by_sky(sigma_px, radius), FREEDOM_BY_SKY)
    } else {
        (Grid::for_image(sigma_px, radius), 1.0)
    };
    let unknowns = Unknowns::new(grid, base, terms.count(), freedom);
    let size_px = stars.first()?.size_px;
    let mut psf = EmpiricalPsf { base, grid, size_px, terms, knots: vec![0.0; grid.knots() * terms.count()] };
    // Terms of the field begin where those of another image are; what changes with conditions begins at nothing.
    if let Some(start) = start.filter(|start| start.grid == grid && start.base == base) {
        let shared = FIELD_TERMS[terms.order.min(start.terms.order)] * grid.knots();
        psf.knots[..shared].copy_from_slice(&start.knots[..shared]);
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
        let found: Vec<Option<Turn<'_>>> = parallel::map_numbers(stars.len(), |number| turn(stars[number], models[number], psf));
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
pub(super) fn turn<'a>(star: &'a PsfStar, model: Model, psf: &EmpiricalPsf) -> Option<Turn<'a>> {
    let of_star = psf.under(star.conditions);
    let mut profile = Profile::of(Some(&of_star));
    let mut stay = |model: Model| {
        profile.draw(star.stamp.window, &model, false);
        let (flux_dn, offset) = star.photons.linear(&star.stamp, &profile, model.flux_dn, 0.0)?;
        Some((Model { flux_dn, ..model }, offset))
    };
    // an image that is far off yet may give no place: then the star stays where it was
    let settled = star.photons.climb(&star.stamp, model, Freedom::Empirical, &mut Profile::of(Some(&of_star)));
    let (mut model, mut offset) = settled.or_else(|| stay(model))?;
    if let Some(sky) = star.sky {
        profile.draw(star.stamp.window, &model, false);
        let own = inverse(&star.photons.normal(&star.stamp, &profile, model.flux_dn, offset, 4).matrix, 4)?;
        let [x, y] = sky.likeliest_px([model.x, model.y], [own[2][2], own[3][2], own[3][3]]);
        profile.draw(star.stamp.window, &Model { x, y, ..model }, false);
        let (flux_dn, level) = star.photons.linear(&star.stamp, &profile, model.flux_dn, offset)?;
        (model, offset) = (Model { x, y, flux_dn, ..model }, level);
    }
    profile.draw(star.stamp.window, &model, false);
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
    let (mut pull, mut chi2) = ([0.0; 4], star.photons.deviance(&star.stamp, &profile, model.flux_dn, offset));
    if let Some(sky) = star.sky {
        let known = sky.sigma_px.powi(-2);
        for (axis, at) in [model.x, model.y].into_iter().enumerate() {
            let off = sky.at_px[axis] - at;
            matrix[2 + axis][2 + axis] += known;
            pull[2 + axis] = known * off;
            chi2 += known * off * off;
        }
    }
    let covariance = inverse(&matrix, 4)?;
    profile.draw(star.stamp.window, &Model { empirical: false, shape: psf.base, ..model }, false);
    let rest = star.stamp.data.iter().zip(&profile.value).map(|(d, share)| d - model.flux_dn * share - offset).collect();
    let terms = psf.terms.at(psf.size_px, [model.x, model.y], star.conditions);
    let lines = psf.grid.lines(star.stamp.window, [model.x, model.y]);
    Some(Turn { model, chi2, lines, terms, weights, rest, rows, covariance, pull, stamp: &star.stamp })
}

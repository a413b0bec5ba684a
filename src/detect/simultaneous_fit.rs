//! Simultaneous fit of all stars of a frame: repeated until stars in each other's light converge.

use std::collections::BTreeMap;

use super::blend_fit::WidthFactor;
use super::candidates::{Candidate, neighbours};
use super::companion::Image;
use super::deblend::{DeblendOutcome, Deblender};
use super::field_fit::FieldFit;
use super::fit::{Fit, Freedom};
use super::image_model::{Model, Shape};
use super::reference_stars::ReferenceStars;
use super::stamp::Scene;
use super::work::{FITTED, PARTED, RESTED};

/// So often stars are fitted again with their neighbours as these were fitted last. Of two that are 4 px apart (σ 1.1 px) after 2 rounds 0.02 px are
/// left of what each took for the other's light.
const ROUNDS: usize = 8;
/// Stars nearer than this, in σ, are fitted together.
const TOGETHER_SIGMA: f64 = 5.5;

/// How stars are fitted.
pub(super) struct FitSettings<'a, F> {
    pub(super) scene: &'a Scene<'a>,
    /// What is free of a star's shape.
    pub(super) freedom: F,
    pub(super) typical: Shape,
    pub(super) scatter: f64,
    pub(super) width_is_known: bool,
    /// Whether with the empirical image: those that are not saturated.
    pub(super) empirical: bool,
}

impl<F: Fn(&Candidate) -> Freedom + Sync> FitSettings<'_, F> {
    /// Each star alone, the guessed light of its neighbours taken off; then with the neighbours as fitted.
    pub(super) fn begin(&self, stars: &mut FieldFit) {
        let order = order(&stars.candidates);
        let first = |i: &usize| self.single(stars, *i, &stars.guesses(&stars.neighbours[*i]));
        let fits = self.scene.work.each(&order, FITTED, first);
        for (i, fit) in order.into_iter().zip(fits) {
            stars.fits[i] = fit.flatten();
        }
        self.rest(stars, vec![true; stars.fits.len()], RESTED);
    }

    /// Each again, from where it is.
    pub(super) fn again(&self, stars: &mut FieldFit) {
        let all: Vec<usize> = (0..stars.candidates.len()).collect();
        let fits = self.scene.work.each(&all, PARTED, |i| self.single(stars, *i, &stars.around(&[*i])));
        for (fit, again) in stars.fits.iter_mut().zip(fits) {
            if let Some(again) = again {
                *fit = again;
            }
        }
        self.rest(stars, vec![true; stars.fits.len()], PARTED);
    }

    /// Takes apart what was taken for one star, and fits together those that are near to each other. Who is not alone says nothing of images any
    /// more: then others may be seen.
    pub(super) fn part(&self, stars: &mut FieldFit) {
        const MAX_PASSES: usize = 3;
        /// Where fewer than one in so many was not alone, images are known well enough.
        const FEW: usize = 10;
        for _ in 0..MAX_PASSES {
            let others = ReferenceStars::of(stars, Image { typical: self.typical, empirical: self.empirical });
            let found = self.split(stars, &others);
            if self.join(stars, &others) {
                let together = stars.partner.iter().map(Option::is_some).collect();
                self.rest(stars, together, PARTED);
            }
            if found * FEW <= others.count() {
                break;
            }
        }
    }

    fn single(&self, stars: &FieldFit, i: usize, others: &[Model]) -> Option<Fit> {
        let candidate = &stars.candidates[i];
        if self.empirical {
            let earlier = stars.fits[i].as_ref()?;
            let fit = if candidate.full_radius_px > 0.0 { None } else { self.scene.fit(earlier.model, Freedom::Empirical, others) };
            // those that it cannot fit stay as they are
            return fit.or_else(|| Some(earlier.clone()));
        }
        let first = self.scene.fit(candidate.start, (self.freedom)(candidate), others);
        // a width that runs away takes the star with it: then the shape of the others must do
        first.or_else(|| self.scene.fit(candidate.start, Freedom::Fixed, others))
    }

    /// Fits stars in each other's light until they rest.
    fn rest(&self, stars: &mut FieldFit, mut moved: Vec<bool>, until: f64) {
        for _ in 0..ROUNDS {
            let again = |i: usize| stars.neighbours[i].iter().any(|&j| moved[j]);
            let left: Vec<usize> = (0..stars.fits.len())
                .filter(|&i| match stars.partner[i] {
                    Some((j, _)) => j > i && (again(i) || again(j)),
                    None => again(i),
                })
                .collect();
            let next = self.scene.work.each(&left, until, |&i| match stars.partner[i] {
                Some((j, breadth)) => self.two(stars, [i, j], breadth),
                None => vec![(i, self.single(stars, i, &stars.around(&[i])))],
            });
            moved.fill(false);
            for (i, fit) in next.into_iter().flatten().flatten() {
                moved[i] = has_moved(fit.as_ref(), stars.fits[i].as_ref());
                stars.fits[i] = fit;
            }
            if !moved.iter().any(|m| *m) {
                break;
            }
        }
    }

    /// Two stars together; where that fails each as before.
    fn two(&self, stars: &FieldFit, pair: [usize; 2], breadth: WidthFactor) -> Vec<(usize, Option<Fit>)> {
        let starts = pair.map(|i| Model { empirical: self.empirical, ..stars.model(i) });
        let fits = self.scene.fit_two(starts, self.typical, breadth, &stars.around(&pair));
        match fits {
            Some([a, b]) => vec![(pair[0], Some(a)), (pair[1], Some(b))],
            None => pair.map(|i| (i, self.single(stars, i, &stars.around(&[i])))).to_vec(),
        }
    }

    /// Says of how many it turned out that they are not alone.
    fn split(&self, stars: &mut FieldFit, others: &ReferenceStars) -> usize {
        let inquiry = Deblender { scene: self.scene, stars, others, scatter: self.scatter, breadth_is_known: self.width_is_known };
        let verdicts = inquiry.deblend_all();
        let found = verdicts.len();
        let mut companions = Vec::new();
        for (i, verdict) in verdicts {
            match verdict {
                DeblendOutcome::Blend(wider) => stars.wider[i] = Some(wider),
                DeblendOutcome::Two(fits) => {
                    let [a, b] = *fits;
                    let (bright, faint) = if a.model.flux_dn >= b.model.flux_dn { (a, b) } else { (b, a) };
                    stars.fits[i] = Some(bright);
                    companions.push(faint);
                }
            }
        }
        if companions.is_empty() {
            return found;
        }
        for fit in companions {
            let snr = fit.model.flux_dn / fit.flux_sigma_dn;
            stars.candidates.push(Candidate { start: fit.model, snr, full_radius_px: 0.0, lone: true });
            stars.fits.push(Some(fit));
            stars.partner.push(None);
            stars.wider.push(None);
        }
        let models: Vec<Model> = (0..stars.fits.len()).map(|i| stars.model(i)).collect();
        stars.neighbours = neighbours(&models);
        found
    }

    /// Finds those that are fitted together: nearest to each other. Says whether there are any.
    fn join(&self, stars: &mut FieldFit, others: &ReferenceStars) -> bool {
        let usable =
            |i: usize| stars.candidates[i].full_radius_px == 0.0 && stars.fits[i].as_ref().is_some_and(|f| f.lone_pixel_excess > 0.0);
        let nearest = |i: usize| {
            let own = stars.model(i);
            let far = |j: usize| self.typical.radius_in_sigma(stars.model(j).x - own.x, stars.model(j).y - own.y);
            let near = stars.neighbours[i].iter().copied().filter(|&j| usable(j) && far(j) < TOGETHER_SIGMA);
            near.min_by(|a, b| far(*a).total_cmp(&far(*b)).then(a.cmp(b)))
        };
        let found: Vec<Option<usize>> = (0..stars.fits.len()).map(|i| if usable(i) { nearest(i) } else { None }).collect();
        let mut any = false;
        for (i, j) in found.iter().enumerate() {
            let mutual = j.filter(|&j| found[j] == Some(i));
            stars.partner[i] = mutual.map(|j| {
                let model = stars.model(i);
                let known = self.width_is_known || self.empirical || j < i;
                (j, if known { WidthFactor::KNOWN } else { others.breadth([model.x, model.y], &[i, j]) })
            });
            any |= mutual.is_some();
        }
        any
    }
}

/// In which order stars are fitted where there may be no time for all: what looks like a star before what does not, and of these the brightest of
/// every part of the frame before the others there.
fn order(candidates: &[Candidate]) -> Vec<usize> {
    /// Side of a part, px.
    const PART_PX: f64 = 128.0;
    let mut in_part: BTreeMap<(bool, u32, u32), usize> = BTreeMap::new();
    let mut order: Vec<(bool, usize, usize)> = Vec::with_capacity(candidates.len());
    for (index, candidate) in candidates.iter().enumerate() {
        let part = |at: f64| (at.max(0.0) / PART_PX) as u32;
        let rank = in_part.entry((candidate.lone, part(candidate.start.x), part(candidate.start.y))).or_default();
        order.push((!candidate.lone, *rank, index));
        *rank += 1;
    }
    order.sort_unstable();
    order.into_iter().map(|(_, _, index)| index).collect()
}

/// Whether a fit differs from the one before by more than a twentieth of its errors.
fn has_moved(new: Option<&Fit>, old: Option<&Fit>) -> bool {
    const LITTLE: f64 = 0.05;
    let (Some(new), Some(old)) = (new, old) else { return new.is_some() != old.is_some() };
    let sigma_px = new.covariance_px2[0].min(new.covariance_px2[2]).sqrt();
    let distance_px = (new.model.x - old.model.x).hypot(new.model.y - old.model.y);
    let width_px = (new.model.shape.sigma_px() - old.model.shape.sigma_px()).abs();
    distance_px.max(width_px) > LITTLE * sigma_px || (new.model.flux_dn - old.model.flux_dn).abs() > LITTLE * new.flux_sigma_dn
}

//! Deblending. A star whose χ² or width exceeds that of nearby reference stars is refitted as two; the split is kept if one image fits worse than
//! chance and the reference stars allow and two fit as well as the reference stars do.
//!
//! A matched filter of the residuals finds where the second star may be (as in crowdsource: Schlafly et al. 2018, ApJS 234, 39), and both are
//! fitted together (`blend_fit`). Light at the same offset beside the reference stars belongs to the optics and makes no second star. A star that
//! is clearly blended but cannot be split stays one, is flagged, and its error includes the possible shift by the companion.

use super::blend_fit::{BlendFit, WidthFactor};
use super::companion::{CompanionMap, IsolatedFit};
use super::field_fit::FieldFit;
use super::fit::{Fit, Freedom};
use super::image_model::{Model, Shape};
use super::psf::Profile;
use super::reference_stars::{Local, ReferenceStar, ReferenceStars, Share, expected};
use super::stamp::{Scene, Stamp};
use super::work::PARTED;
use crate::parallel;

/// Fainter stars cannot be two.
const MIN_SNR: f64 = 10.0;
/// Of a companion.
const MIN_COMPANION_SNR: f64 = 5.5;
/// χ² that a second star must gain beyond what three more numbers gain by chance, at any of the places it may have.
const MIN_GAIN: f64 = 36.0;
/// So many σ wider than the stars near by a star is looked at.
const WIDER_SIGMA: f64 = 2.5;
/// Less light than this beside a star, in χ², and it is not looked at further.
const MIN_LINEAR_GAIN: f64 = 12.0;
/// How much larger squared residuals must be than those of the stars near by, in units of the light.
const BEYOND_OTHERS: f64 = 4.0;
/// The image of a star may differ by so much of its light from what is fitted where no others tell.
const SLACK: f64 = 0.01;
/// Light beside a star must be so much more than beside the stars near by, at the same place.
const LIKE_OTHERS: f64 = 0.35;
/// Where the shape alone is the evidence: so many σ, of itself and of the stars near by, light must lie above theirs, and so much of χ² a free
/// ellipse must gain over a star's image.
const CLEARLY: (f64, f64) = (5.0, 64.0);
/// The same where it is only said that a star is not alone.
const NOT_ONE: (f64, f64) = (3.5, 36.0);
/// As much better than two stars one of any ellipse may fit by chance, in χ².
const WORSE_BY_CHANCE: f64 = 9.0;
/// χ² that a pixel counts for that is left out of a fit, and by which a star must do better than a lone pixel.
const COST_OF_A_PIXEL: f64 = 40.0;
const MIN_OVER_PIXEL: f64 = 18.0;
/// Stars nearer than this, in σ, are one.
const NEAREST_SIGMA: f64 = 1.1;

/// What became of a star that was looked at.
pub(super) enum DeblendOutcome {
    Two(Box<[Fit; 2]>),
    /// No lone star, but no two that could be told apart: by how much its image is wider, px².
    Blend([f64; 3]),
}

/// What is held against a star.
pub(super) struct Deblender<'a> {
    pub(super) scene: &'a Scene<'a>,
    pub(super) stars: &'a FieldFit,
    pub(super) others: &'a ReferenceStars,
    /// By how much noise of the background goes together.
    pub(super) scatter: f64,
    pub(super) breadth_is_known: bool,
}

impl Deblender<'_> {
    /// Looks at all stars that seem to be no lone ones. Which these are costs little to tell, and each of them much: work is shared out among them alone.
    pub(super) fn deblend_all(&self) -> Vec<(usize, DeblendOutcome)> {
        let odd: Vec<(usize, Local<'_>, f64)> =
            parallel::map_numbers(self.stars.fits.len(), |i| self.odd(i)).into_iter().flatten().collect();
        let judge = |(i, local, allowed): &(usize, Local<'_>, f64)| {
            let verdict = self.judge(*i, self.stars.fits[*i].as_ref()?, local, *allowed)?;
            Some((*i, verdict))
        };
        self.scene.work.each(&odd, PARTED, judge).into_iter().flatten().flatten().collect()
    }

    /// A star that is no star's image as the frame's other stars have it: what those near by say, and the χ² that their images allow it.
    fn odd(&self, i: usize) -> Option<(usize, Local<'_>, f64)> {
        let fit = self.stars.fits[i].as_ref()?;
        if self.stars.candidates[i].full_radius_px > 0.0 || fit.edge || fit.lone_pixel_excess <= 0.0 {
            return None;
        }
        let snr = fit.model.flux_dn / fit.flux_sigma_dn;
        if snr < MIN_SNR || self.stars.partner[i].is_some() || self.stars.wider[i].is_some() {
            return None;
        }
        let dof = fit.dof as f64;
        let chance = 3.0 * (2.0 * dof).sqrt();
        let dropped = self.pixels(fit) > fit.dof + fit.freedom.parameters();
        let ln_breadth = (fit.model.shape.sigma_px() / self.others.image.typical.sigma_px()).ln();
        let wide = ln_breadth * snr > WIDER_SIGMA;
        if !(dropped || wide || fit.chi2 > dof + chance) {
            return None;
        }
        let local = self.others.near([fit.model.x, fit.model.y], &[i])?;
        let allowed = (BEYOND_OTHERS * local.misfit).max(SLACK * SLACK) * snr * snr;
        let wide = ln_breadth - local.breadth.ln > WIDER_SIGMA * local.breadth.sigma.hypot(1.0 / snr);
        (dropped || wide || fit.chi2 > dof + chance + allowed).then_some((i, local, allowed))
    }

    /// Pixels of a star's window that say something.
    fn pixels(&self, fit: &Fit) -> usize {
        let frame = self.scene.frame;
        let span = |at: f64, n: usize| {
            let at = at.round().clamp(0.0, (n - 1) as f64) as usize;
            at.saturating_sub(fit.model.radius)..(at + fit.model.radius + 1).min(n)
        };
        let columns = span(fit.model.x, frame.width_px);
        span(fit.model.y, frame.height_px)
            .map(|y| self.scene.masked[y * frame.width_px..][columns.clone()].iter().filter(|m| !**m).count())
            .sum()
    }

    fn judge(&self, i: usize, fit: &Fit, local: &Local<'_>, allowed: f64) -> Option<DeblendOutcome> {
        let neighbours = self.stars.around(&[i]);
        let known = self.breadth_is_known || self.others.image.empirical;
        let breadth = if known { WidthFactor::KNOWN } else { local.breadth };
        let shape = breadth.of(self.others.image.typical);
        let alone = self.scene.alone(fit, self.others.image, &neighbours, false)?;
        let (at, linear_gain) = alone.brightest_beside(&neighbours, self.scene.work)?;
        if linear_gain < MIN_LINEAR_GAIN * self.scatter * self.scatter {
            return None;
        }
        let [dx, dy] = at;
        let best = self.best_two(&alone, [dx, dy], shape, breadth, &neighbours, allowed);
        let two = best.as_ref().and_then(|found| Some((self.two(found, breadth, allowed)?, found)));
        let toward = two.as_ref().map_or(at, |(fits, _)| {
            let faint = if fits[1].model.flux_dn < fits[0].model.flux_dn { fits[1].model } else { fits[0].model };
            [faint.x - alone.model.x, faint.y - alone.model.y]
        });
        let (beside, expected, clearly) = self.compared(&alone, toward, local)?;
        if clearly < NOT_ONE.0 || expected * alone.model.flux_dn > LIKE_OTHERS * beside.flux_dn {
            return None;
        }
        let factor = self.scatter * self.scatter;
        let Some((fits, found)) = two else {
            let mut stamp = alone.stamp;
            let wide = self.wide(&mut stamp, Model { shape, ..alone.model }, shape, true)?;
            return (wide.gain > NOT_ONE.1 * factor).then_some(DeblendOutcome::Blend(wide.by_px2));
        };
        let wide = self.wide(&mut found.stamp.clone(), found.as_one(), shape, false);
        let misfit = (found.chi2 / fits[0].dof as f64).max(1.0);
        let gain = wide.as_ref().map_or(f64::INFINITY, |w| (w.chi2 - found.chi2) / misfit);
        let of_shape = wide.as_ref().map_or(0.0, |w| w.gain);
        let enough = gain > (MIN_GAIN + allowed) * factor || (of_shape > CLEARLY.1 * factor && gain > -WORSE_BY_CHANCE);
        if clearly > CLEARLY.0 && enough {
            return Some(DeblendOutcome::Two(Box::new(fits)));
        }
        wide.filter(|w| w.gain > NOT_ONE.1 * factor).map(|w| DeblendOutcome::Blend(w.by_px2))
    }

    /// The best two stars: light beside the star, or both aside of its middle.
    fn best_two(
        &self,
        alone: &IsolatedFit,
        [dx, dy]: [f64; 2],
        shape: Shape,
        breadth: WidthFactor,
        neighbours: &[Model],
        allowed: f64,
    ) -> Option<Found> {
        let light = alone.model.flux_dn;
        let model =
            |x: f64, y: f64, share: f64| Model { x: alone.model.x + x, y: alone.model.y + y, flux_dn: share * light, shape, ..alone.model };
        let beside = [model(0.0, 0.0, 0.8), model(dx, dy, 0.2)];
        let stamp = self.scene.stamp_of_two(&beside, neighbours);
        let dof = stamp.used.iter().filter(|u| **u).count() as f64;
        let settled = |starts: [Model; 2]| {
            let mut own = stamp.clone();
            let duet = self.scene.settle_two(&mut own, starts, self.others.image.typical, breadth)?;
            let lost = stamp.used.iter().zip(&own.used).filter(|(a, b)| **a && !**b).count();
            let chi2 = self.scene.photons().chi2_of_two(&own, &duet, self.scene.psf);
            Some(Found { stamp: own, duet, chi2, cost: chi2 + COST_OF_A_PIXEL * lost as f64 })
        };
        let mut best: Option<Found> = None;
        // two equal ones are on both sides of the middle, and on which axis whole pixels tell roughly; beside other stars a bad fit has other reasons
        let turned = if neighbours.is_empty() { 4 } else { 2 };
        let starts = [
            beside,
            [model(-0.4 * dx, -0.4 * dy, 0.5), model(0.4 * dx, 0.4 * dy, 0.5)],
            [model(-0.4 * (dx - dy), -0.4 * (dx + dy), 0.5), model(0.4 * (dx - dy), 0.4 * (dx + dy), 0.5)],
            [model(-0.4 * (dx + dy), -0.4 * (dy - dx), 0.5), model(0.4 * (dx + dy), 0.4 * (dy - dx), 0.5)],
        ];
        for starts in starts.into_iter().take(turned) {
            if best.as_ref().is_some_and(|b| b.cost < dof + 2.0 * (2.0 * dof).sqrt() + allowed) {
                break;
            }
            best = best.into_iter().chain(settled(starts)).min_by(|a, b| a.cost.total_cmp(&b.cost));
        }
        best
    }

    /// Whether two stars are what is seen.
    fn two(&self, found: &Found, breadth: WidthFactor, allowed: f64) -> Option<[Fit; 2]> {
        let fits = self.scene.finish_two(&found.stamp, &found.duet, self.others.image.typical, breadth)?;
        let dof = fits[0].dof as f64;
        let [a, b] = [fits[0].model, fits[1].model];
        let far = a.shape.radius_in_sigma(a.x - b.x, a.y - b.y) > NEAREST_SIGMA;
        let bright = |f: &Fit| f.model.flux_dn > MIN_COMPANION_SNR * f.flux_sigma_dn && f.lone_pixel_excess > MIN_OVER_PIXEL;
        let size = (self.scene.frame.width_px as f64 - 0.5, self.scene.frame.height_px as f64 - 0.5);
        let inside = |m: &Model| m.x > -0.5 && m.y > -0.5 && m.x < size.0 && m.y < size.1;
        let fits_well = found.chi2 < dof + 4.0 * (2.0 * dof).sqrt() + allowed;
        (far && fits_well && fits.iter().all(bright) && [a, b].iter().all(inside)).then_some(fits)
    }

    /// The image as an ellipse, against that of a star. `drop`: pixels far off it are left out.
    fn wide(&self, stamp: &mut Stamp, start: Model, shape: Shape, drop: bool) -> Option<Wide> {
        let photons = self.scene.photons();
        let start = Model { empirical: false, ..start };
        let mut profile = Profile::new().counted(self.scene.work);
        let (model, offset) = if drop {
            photons.settle(stamp, start, Freedom::Ellipse, &mut profile)?
        } else {
            photons.climb(stamp, start, Freedom::Ellipse, &mut profile)?
        };
        profile.draw(stamp.window, &model, true);
        let chi2 = photons.normal(stamp, &profile, model.flux_dn, offset, Freedom::Ellipse.parameters()).chi2;
        let dof = stamp.used.iter().filter(|u| **u).count().saturating_sub(Freedom::Ellipse.parameters()).max(1);
        let start = Model { empirical: self.others.image.empirical, shape, ..start };
        let freedom = if self.others.image.empirical { Freedom::Empirical } else { Freedom::Fixed };
        let mut profile = self.scene.profile();
        let (star, offset) = photons.climb(stamp, start, freedom, &mut profile)?;
        profile.draw(stamp.window, &star, false);
        let as_star = photons.normal(stamp, &profile, star.flux_dn, offset, freedom.parameters()).chi2;
        let gain = (as_star - chi2) / (chi2 / dof as f64).max(1.0);
        Some(Wide { by_px2: positive_part(model.shape, shape), gain, chi2: chi2.min(as_star) })
    }

    /// Light at a place beside a star, the share of it that the stars near by lead to expect there, and how far apart these are, in σ.
    fn compared(&self, alone: &IsolatedFit, toward_px: [f64; 2], local: &Local<'_>) -> Option<(CompanionMap, f64, f64)> {
        let own = self.scene.beside(alone, toward_px)?;
        let light = alone.model.flux_dn;
        let aside = |at_px: [f64; 2]| [at_px[0] - alone.model.x, at_px[1] - alone.model.y];
        let reach_px = local.near.iter().map(|t| aside(t.at_px)).map(|[x, y]| x.hypot(y)).fold(1.0, f64::max);
        let told = |telling: &&ReferenceStar| {
            let other = self.others.alone(telling, self.scene, self.stars)?;
            let beside = self.scene.beside(other, toward_px)?;
            let place = aside(telling.at_px).map(|d| d / reach_px);
            Some(Share { place, of_light: beside.flux_dn / other.model.flux_dn, sigma: beside.sigma_dn / other.model.flux_dn })
        };
        let shares: Vec<Share> = local.near.iter().filter_map(told).collect();
        let (expected, variance) = expected(&shares, self.others.are_many())?;
        let clearly = (own.flux_dn / light - expected) / ((own.sigma_dn / light).powi(2) + variance).sqrt();
        Some((own, expected, clearly))
    }
}

/// Two stars that were found in the pixels of one.
struct Found {
    stamp: Stamp,
    duet: BlendFit,
    chi2: f64,
    /// With what pixels cost that were left out.
    cost: f64,
}

impl Found {
    /// One star with the place, light and moments of both.
    fn as_one(&self) -> Model {
        let [a, b] = self.duet.models;
        let light = a.flux_dn + b.flux_dn;
        let (p, q) = (a.flux_dn / light, b.flux_dn / light);
        let (dx, dy) = (b.x - a.x, b.y - a.y);
        let shape = Shape::ellipse(a.shape.xx + p * q * dx * dx, a.shape.xy + p * q * dx * dy, a.shape.yy + p * q * dy * dy);
        Model { x: p * a.x + q * b.x, y: p * a.y + q * b.y, flux_dn: light, shape, ..a }
    }
}

/// An image as an ellipse: how much wider than a star's, what that gains of χ², and the least χ² of one star.
struct Wide {
    by_px2: [f64; 3],
    gain: f64,
    chi2: f64,
}

/// By how much a shape is wider than another, where it is wider: xx, xy, yy, px².
fn positive_part(wide: Shape, than: Shape) -> [f64; 3] {
    let [xx, xy, yy] = [wide.xx - than.xx, wide.xy - than.xy, wide.yy - than.yy];
    let (mean, half) = (f64::midpoint(xx, yy), (xx - yy) / 2.0);
    let root = half.hypot(xy);
    let (high, low) = ((mean + root).max(0.0), (mean - root).max(0.0));
    let (c, s) = if root > 0.0 { (half / root, xy / root) } else { (0.0, 0.0) };
    let (sum, difference) = (f64::midpoint(high, low), (high - low) / 2.0);
    [sum + difference * c, difference * s, sum - difference * c]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_wider_counts() {
        // turned by 30°: 3 px² more along, 0.5 px² less across
        let (s, c) = (0.5, 0.75_f64.sqrt());
        let than = Shape::round(1.2);
        let of = |along: f64, across: f64| [along * c * c + across * s * s, (along - across) * c * s, along * s * s + across * c * c];
        let [xx, xy, yy] = of(3.0, -0.5);
        let wide = Shape::ellipse(than.xx + xx, than.xy + xy, than.yy + yy);
        for (got, expected) in positive_part(wide, than).into_iter().zip(of(3.0, 0.0)) {
            assert!((got - expected).abs() < 1e-12, "{got} {expected}");
        }
        assert_eq!(positive_part(than, than), [0.0; 3]);
    }
}

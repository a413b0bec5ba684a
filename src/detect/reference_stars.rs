//! Reference stars of a star: the fit residuals, widths and companions of the stars near it.

use std::sync::OnceLock;

use super::blend_fit::WidthFactor;
use super::companion::{Image, IsolatedFit};
use super::field_fit::FieldFit;
use super::stamp::Scene;
use crate::statistics::cholesky::solve;
use crate::statistics::order::ascending;
use crate::statistics::{mad_sigma, median};

/// Stars that tell what images are like: from this signal-to-noise ratio on, so many near by, at least and at most.
const SNR_TO_TELL: f64 = 30.0;
const TELLING: (usize, usize) = (8, 24);
/// With so many of them in the frame those near by cover a small part of it.
const MANY: usize = 72;
/// Among bright stars so many are surely alone.
const LONE_SHARE: f64 = 0.3;
/// The narrowest scatter of widths that few stars may tell.
const MIN_SCATTER: f64 = 0.003;

/// What a bright star tells of images near it.
#[derive(Clone, Copy)]
pub(super) struct ReferenceStar {
    pub(super) star: usize,
    /// Among those that tell.
    index: usize,
    pub(super) at_px: [f64; 2],
    snr2: f64,
    /// χ² beyond chance over SNR²: the square of the share of the light that is not as fitted, about.
    misfit: f64,
    ln_breadth: f64,
}

/// The frame's bright stars.
pub(super) struct ReferenceStars {
    all: Vec<ReferenceStar>,
    /// Each under the typical image, once it was looked at.
    alone: Vec<OnceLock<Option<IsolatedFit>>>,
    pub(super) image: Image,
}

/// What the stars near a place say.
pub(super) struct Local<'a> {
    pub(super) near: Vec<&'a ReferenceStar>,
    pub(super) misfit: f64,
    pub(super) breadth: WidthFactor,
}

impl ReferenceStars {
    pub(super) fn of(stars: &FieldFit, image: Image) -> Self {
        let telling = |i: usize| {
            let lone = stars.partner[i].is_none() && stars.wider[i].is_none() && stars.candidates[i].full_radius_px == 0.0;
            let fit = stars.fits[i].as_ref().filter(|f| lone && !f.edge && f.lone_pixel_excess > 0.0)?;
            let snr = fit.model.flux_dn / fit.flux_sigma_dn;
            let dof = fit.dof as f64;
            (snr > SNR_TO_TELL).then(|| ReferenceStar {
                star: i,
                index: 0,
                at_px: [fit.model.x, fit.model.y],
                snr2: snr * snr,
                misfit: (fit.chi2 - dof) / (snr * snr),
                ln_breadth: (fit.model.shape.sigma_px() / image.typical.sigma_px()).ln(),
            })
        };
        let all: Vec<ReferenceStar> =
            (0..stars.fits.len()).filter_map(telling).enumerate().map(|(index, told)| ReferenceStar { index, ..told }).collect();
        Self { alone: all.iter().map(|_| OnceLock::new()).collect(), all, image }
    }

    pub(super) fn count(&self) -> usize {
        self.all.len()
    }

    /// The nearest stars but these; `None` where they are too few.
    pub(super) fn near(&self, at_px: [f64; 2], but: &[usize]) -> Option<Local<'_>> {
        let count = TELLING.1;
        let far = |t: &ReferenceStar| (t.at_px[0] - at_px[0]).hypot(t.at_px[1] - at_px[1]);
        let mut near: Vec<&ReferenceStar> = self.all.iter().filter(|t| !but.contains(&t.star)).collect();
        if near.len() < TELLING.0 {
            return None;
        }
        if near.len() > count {
            near.select_nth_unstable_by(count, |a, b| far(a).total_cmp(&far(b)).then(a.star.cmp(&b.star)));
            near.truncate(count);
        }
        let misfit = weighted_quantile(near.iter().map(|t| (t.misfit, t.snr2)).collect(), LONE_SHARE);
        let widths: Vec<f64> = near.iter().map(|t| t.ln_breadth).collect();
        // scatter beyond noise, of which few stars tell little, and that of the middle; a width is told about as well as the light
        let scatter2 = mad_sigma(&widths)?.powi(2);
        let noise2 = median(&near.iter().map(|t| 1.0 / t.snr2).collect::<Vec<_>>())?;
        let sigma = ((scatter2 - noise2).max(0.0) + 2.0 * scatter2 / near.len() as f64).sqrt();
        let breadth = WidthFactor { ln: median(&widths)?, sigma: sigma.max(MIN_SCATTER) };
        Some(Local { near, misfit: misfit.max(0.0), breadth })
    }

    /// Whether those near by cover a small part of the frame.
    pub(super) fn are_many(&self) -> bool {
        self.all.len() >= MANY
    }

    /// A star that tells, under the image.
    pub(super) fn alone(&self, telling: &ReferenceStar, scene: &Scene<'_>, stars: &FieldFit) -> Option<&IsolatedFit> {
        let look = || {
            let fit = stars.fits[telling.star].as_ref()?;
            scene.alone(fit, self.image, &stars.around(&[telling.star]), true)
        };
        self.alone[telling.index].get_or_init(look).as_ref()
    }

    /// The breadth of images at a place.
    pub(super) fn breadth(&self, at_px: [f64; 2], but: &[usize]) -> WidthFactor {
        self.near(at_px, but).map_or(WidthFactor::KNOWN, |local| local.breadth)
    }
}

/// The value below which a share of the weight lies.
fn weighted_quantile(mut values: Vec<(f64, f64)>, share: f64) -> f64 {
    ascending(&mut values, |a| a.0);
    let below = share * values.iter().map(|v| v.1).sum::<f64>();
    let mut sum = 0.0;
    let reaches = |v: &&(f64, f64)| {
        sum += v.1;
        sum >= below
    };
    values.iter().find(reaches).map_or(0.0, |v| v.0)
}

/// What a star shows beside it, and where it lies from the one that is asked about, in units of the farthest.
pub(super) struct Share {
    pub(super) place: [f64; 2],
    pub(super) of_light: f64,
    pub(super) sigma: f64,
}

/// The share to be expected at the place (0, 0) and its variance, from a surface through those around it: images change over the frame. Among
/// many stars those off the surface are two themselves; of few they may be what the corners of the frame look like, and all count.
pub(super) fn expected(shares: &[Share], many: bool) -> Option<(f64, f64)> {
    const ROUNDS: usize = 8;
    /// Least standard error of a share.
    const FLOOR: f64 = 0.003;
    let n = shares.len();
    if n < TELLING.0 {
        return None;
    }
    let terms = if n >= 2 * TELLING.0 { 6 } else { 3 };
    let rows: Vec<[f64; 6]> = shares
        .iter()
        .map(|s| {
            let [x, y] = s.place;
            [1.0, x, y, x * x, x * y, y * y]
        })
        .collect();
    let noise: Vec<f64> = shares.iter().map(|s| s.sigma * s.sigma + FLOOR * FLOOR).collect();
    let mut rest: Vec<f64> = {
        let middle = median(&shares.iter().map(|s| s.of_light).collect::<Vec<_>>())?;
        shares.iter().map(|s| s.of_light - middle).collect()
    };
    let typical_noise = median(&noise)?;
    let (mut at_place, mut covariance, mut scale) = (0.0, 0.0, 0.0);
    for _ in 0..ROUNDS {
        // squared rests in units of what noise makes them; stars that are two themselves count for little
        let over: Vec<f64> = rest.iter().zip(&noise).map(|(r, v)| r.abs() / v.sqrt()).collect();
        let spread = if many { 1.4826 * median(&over)? } else { (over.iter().map(|o| o * o).sum::<f64>() / n as f64).sqrt() };
        scale = (spread * (n as f64 / (n - terms) as f64).sqrt()).max(1.0);
        let (mut matrix, mut vector) = ([[0.0; 6]; 6], [0.0; 6]);
        for (((row, share), v), over) in rows.iter().zip(shares).zip(&noise).zip(&over) {
            let off = if many { (over / (2.0 * scale)).powi(2) } else { 0.0 };
            // where images scatter more than noise all stars tell alike
            let weight = 1.0 / (v.max((scale * scale - 1.0) * typical_noise) * (1.0 + off).powi(2));
            for a in 0..terms {
                vector[a] += weight * row[a] * share.of_light;
                for b in 0..=a {
                    matrix[a][b] += weight * row[a] * row[b];
                }
            }
        }
        let surface = solve(&matrix, &vector, terms, 0.0)?;
        let mut unit = [0.0; 6];
        unit[0] = 1.0;
        (at_place, covariance) = (surface[0], solve(&matrix, &unit, terms, 0.0)?[0]);
        for ((r, row), share) in rest.iter_mut().zip(&rows).zip(shares) {
            *r = share.of_light - (0..terms).map(|a| row[a] * surface[a]).sum::<f64>();
        }
    }
    // scatter beyond noise is of the images
    Some((at_place, covariance * scale * scale + (scale * scale - 1.0) * typical_noise))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shares that grow over the field, known to `sigma`, some of them of stars that are two.
    fn shares(count: usize, two: usize, sigma: f64) -> Vec<Share> {
        let place = |k: usize| [((k * 7) % count) as f64 / count as f64 - 0.5, ((k * 11 + 3) % count) as f64 / count as f64 - 0.5];
        let noise = |k: usize| sigma * [0.9, -0.4, -1.1, 0.3, 0.6, -0.3][k % 6];
        let surface = |[x, y]: [f64; 2]| 0.05 + 0.1 * x - 0.2 * y + 0.1 * x * x;
        (0..count)
            .map(|k| Share { place: place(k), of_light: surface(place(k)) + noise(k) + if k < two { 0.5 } else { 0.0 }, sigma })
            .collect()
    }

    #[test]
    fn what_is_expected_follows_the_field() {
        for (count, two, many) in [(24, 0, false), (24, 0, true), (24, 5, true)] {
            let (expected, variance) = expected(&shares(count, two, 0.01), many).unwrap();
            assert!((expected - 0.05).abs() < 0.01 && variance.sqrt() < 0.01, "{expected} {variance}");
        }
        // few stars: those off the surface may be what images are like
        let (_, variance) = expected(&shares(24, 3, 0.01), false).unwrap();
        assert!(variance.sqrt() > 0.1, "{variance}");
        assert!(expected(&shares(7, 0, 0.01), true).is_none());
    }

    #[test]
    fn quantiles_count_by_weight() {
        let values = vec![(3.0, 1.0), (1.0, 1.0), (2.0, 8.0)];
        assert_eq!([0.05, 0.3, 0.95].map(|share| weighted_quantile(values.clone(), share)), [1.0, 2.0, 3.0]);
    }
}

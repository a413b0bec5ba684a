//! Cosmic rays: pixels of light that no lens has drawn, in one frame alone.
//!
//! What a lens draws is its narrowest star image laid over itself: a star, a blend, a trail, an edge. Of a star image that is centred on a pixel both
//! neighbours together have 2ρ of its light, and none that lies elsewhere leaves them less; so no sum of star images does. A pixel that has more
//! was not lit through the lens. That is the idea of edges that are too steep (van Dokkum, PASP 113, 1420 (2001)) as a bound, along the rows,
//! the columns, the diagonals and all around, so that a track shows across its own direction. A pixel that stands out in another frame as well is hot, or
//! jumps.
//!
//! How far a pixel has to stand out follows from how often noise does it (Chernoff's bound of a Poisson variable, which is at least that of a Gaussian
//! one of the same variance).

use std::collections::{BTreeMap, BTreeSet};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::fixed_pattern::PatternFrame;
use super::ray_candidates::{Candidate, RayFrame, square};
use crate::statistics::significance::normal_cdf;

/// Frames that tell what stays with a pixel, at least.
pub(crate) const MIN_RAY_FRAMES: usize = 3;
/// Pixels of a frame that noise alone brings so far, on average.
const BY_NOISE: f64 = 1e-5;
/// The same where nobody knows how many electrons a count stands for.
const FAR_SIGMAS: f64 = 10.0;
/// What stands out so far in another frame too is a hot pixel, or one that jumps; and what does so in the mean of the others.
const HOT_SIGMAS: f64 = 4.5;
const MEAN_HOT_SIGMAS: f64 = 4.0;
/// The neighbours have less than this share of what the lens would give them: in the sky, and in a star that was found. Images differ over the
/// frame, and are no Gaussians.
const SHARPER: f64 = 0.75;
const SHARPER_IN_STAR: f64 = 0.5;
/// By so many standard deviations: what is so bright and no ray is a star, and would have been found.
const CLEARLY: f64 = 3.5;
const CLEARLY_IN_STAR: f64 = 5.0;
/// Narrower images than this are as sharp as cosmic rays, px.
pub(crate) const MIN_STAR_SIGMA_PX: f64 = 0.42;
/// At most so many rays are lost since others fell on the same pixels in other frames.
const BY_CHANCE: f64 = 0.05;
/// Where more than this share of the stars are too sharp, it is the stars.
const SHARP_STARS: f64 = 0.1;

/// Cosmic rays counted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CosmicRays {
    /// How many.
    pub count: usize,
    /// Frames that were searched.
    pub frames: usize,
    /// Share of their pixels that was searched.
    pub share: f64,
    /// Per frame of full size.
    pub per_frame: f64,
    /// Per second, where exposures are known.
    pub per_s: Option<f64>,
}

/// What is known of image and noise.
#[derive(Clone, Copy, Debug)]
pub(super) struct RayConditions {
    /// Width of the narrowest star images.
    pub(super) sigma_px: f64,
    /// Electrons per count, where known.
    pub(super) gain_e_per_dn: Option<f64>,
}

/// Counts them; nothing where images are as sharp as they, frames too few or of a mosaic.
pub(super) fn cosmic_rays(frames: &[RayFrame], patterns: &[PatternFrame], known: &RayConditions) -> Option<CosmicRays> {
    let size_px = frames.first()?.size_px;
    let frames: Vec<&RayFrame> = frames.iter().filter(|frame| frame.size_px == size_px && frame.pixels > 0).collect();
    if frames.len() < MIN_RAY_FRAMES || known.sigma_px < MIN_STAR_SIGMA_PX {
        return None;
    }
    let lens = Lens::new(known);
    let mut sharp: Vec<Vec<&Candidate>> =
        frames.iter().map(|frame| frame.candidates.iter().filter(|own| lens.is_sharper(own, frame.pixels)).collect()).collect();
    let stars: usize = frames.iter().map(|frame| frame.stars).sum();
    let sharp_stars = sharp.iter().flatten().filter(|own| own.in_star).count();
    if sharp_stars as f64 > SHARP_STARS * stars as f64 {
        for own in &mut sharp {
            own.retain(|one| !one.in_star);
        }
    }
    // In how many frames each pixel, or one beside it, is too sharp.
    let mut seen: BTreeMap<usize, usize> = BTreeMap::new();
    for own in &sharp {
        let around: BTreeSet<usize> = own.iter().flat_map(|one| square(one.index, size_px[0])).collect();
        for index in around {
            *seen.entry(index).or_default() += 1;
        }
    }
    let by_chance = 1 + coincidences(seen.len() as f64 / (size_px[0] * size_px[1]) as f64);
    let mut count = 0;
    for (frame, own) in frames.iter().zip(&sharp) {
        // One track, one ray: of its pixels more than half show in this frame alone.
        let mut tracks: BTreeMap<u32, [usize; 2]> = BTreeMap::new();
        for one in own {
            let is_alone = seen.get(&one.index).is_none_or(|frames| *frames <= by_chance) && !is_hot(patterns, frame.number, one.index);
            tracks.entry(one.group).or_default()[usize::from(is_alone)] += 1;
        }
        count += tracks.values().filter(|[known, alone]| alone > known).count();
    }
    let pixels = (size_px[0] * size_px[1]) as f64;
    let searched: f64 = frames.iter().map(|frame| frame.pixels as f64 / pixels).sum();
    let seconds: Option<f64> = frames.iter().map(|frame| frame.exposure_s.map(|time| time * frame.pixels as f64 / pixels)).sum();
    Some(CosmicRays {
        count,
        frames: frames.len(),
        share: searched / frames.len() as f64,
        per_frame: count as f64 / searched,
        per_s: seconds.filter(|seconds| *seconds > 0.0).map(|seconds| count as f64 / seconds),
    })
}

/// In how many other frames a pixel of a ray may be too sharp as well, by chance: of many frames other rays fall there. More do so for less than
/// [`BY_CHANCE`] of the rays. `share`: that of the pixels that are near one in any frame.
fn coincidences(share: f64) -> usize {
    let expected = -(-share.min(0.99)).ln_1p();
    let (mut term, mut count) = ((-expected).exp(), 0);
    let mut beyond = 1.0 - term;
    while beyond > BY_CHANCE {
        count += 1;
        term *= expected / count as f64;
        beyond -= term;
    }
    count
}

/// Whether a pixel stands out in frames beside its own.
fn is_hot(patterns: &[PatternFrame], own: usize, index: usize) -> bool {
    let others = || patterns.iter().filter(|frame| frame.frame != own).map(|frame| frame.deviation(index));
    let (sum, count) = others().fold((0.0, 0.0_f64), |(sum, count), z| (sum + z, count + 1.0));
    others().any(|z| z >= HOT_SIGMAS) || (count > 2.0 && sum > MEAN_HOT_SIGMAS * count.sqrt())
}

/// The narrowest image of a point, centred on a pixel.
struct Lens {
    /// Light of a neighbour in the row over that of the middle.
    beside: f64,
    gain_e_per_dn: Option<f64>,
}

impl Lens {
    fn new(known: &RayConditions) -> Self {
        let up_to = |px: f64| normal_cdf(px / known.sigma_px);
        let beside = (up_to(1.5) - up_to(0.5)) / (2.0 * up_to(0.5) - 1.0);
        Self { beside, gain_e_per_dn: known.gain_e_per_dn.filter(|gain| *gain > 0.0) }
    }

    /// Whether a pixel has more light than its neighbours allow, and more than noise brings in so many pixels.
    fn is_sharper(&self, own: &Candidate, pixels: usize) -> bool {
        let peak = own.around[4];
        if !self.is_beyond_noise(peak, f64::from(own.sigma_dn), pixels) {
            return false;
        }
        let (share, clearly) = if own.in_star { (SHARPER_IN_STAR, CLEARLY_IN_STAR) } else { (SHARPER, CLEARLY) };
        let (beside, across) = (self.beside, self.beside * self.beside);
        let bounds: [(&[usize], f64); 6] = [
            (&[3, 5], 2.0 * beside),
            (&[1, 7], 2.0 * beside),
            (&[0, 8], 2.0 * across),
            (&[2, 6], 2.0 * across),
            (&[1, 3, 5, 7], 4.0 * beside),
            (&[0, 1, 2, 3, 5, 6, 7, 8], 4.0 * (beside + across)),
        ];
        // Variance that light adds, in units of the sky's, per standard deviation of light.
        let by_light = (self.gain_e_per_dn.unwrap_or(1.0) * f64::from(own.sigma_dn)).recip();
        bounds.into_iter().any(|(places, of_peak)| {
            let least = share * of_peak;
            let neighbours: f64 = places.iter().map(|place| own.around[*place]).sum();
            let variance = least * least * (1.0 + by_light * peak) + places.len() as f64 + by_light * neighbours.max(least * peak);
            least * peak - neighbours > clearly * variance.sqrt()
        })
    }

    fn is_beyond_noise(&self, peak: f64, sigma_dn: f64, pixels: usize) -> bool {
        let Some(gain) = self.gain_e_per_dn else { return peak > FAR_SIGMAS };
        let sigma_e = (gain * sigma_dn).max(1e-3);
        let above_e = peak * sigma_e;
        let mean_e = sigma_e * sigma_e;
        (mean_e + above_e) * (above_e / mean_e).ln_1p() - above_e > (pixels.max(1) as f64 / BY_NOISE).ln()
    }
}

#[cfg(test)]
#[path = "events_tests.rs"]
mod tests;

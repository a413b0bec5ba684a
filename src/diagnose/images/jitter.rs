//! Jitter: images that are wider in some frames than in others, with nothing that explains it.
//!
//! The camera shakes by another amount in each exposure, and adds its variance to that of every image. A camera that looks through air sees the same of
//! seeing, so that it has this name in space alone. What goes with temperature, time or a declared rate is taken off before.

use super::counted::{Counted, MAX_SURPRISE};
use super::judge::Judged;
use super::stars::SIZE;
use crate::diagnose::causes::JITTER;
use crate::diagnose::channels::Channel;
use crate::statistics::significance::neg_ln_chi2_sf;

/// Fewer frames tell no scatter, and fewer stars of one no width.
const MIN_FRAMES: usize = 5;
const MIN_STARS: usize = 5;

/// What the mean widths of the frames say; nothing where they cannot.
pub(super) fn jitter(judged: &Judged, looks_through_air: bool) -> Option<Counted> {
    let means = frame_means(judged)?;
    let total: f64 = means.iter().map(|(_, variance)| variance.recip()).sum();
    let mean = means.iter().map(|(value, variance)| value / variance).sum::<f64>() / total;
    let chi2: f64 = means.iter().map(|(value, variance)| (value - mean).powi(2) / variance).sum();
    let surprise = neg_ln_chi2_sf((means.len() - 1) as f64, chi2).min(MAX_SURPRISE);
    // From the steadiest frame to the mean one, the noise of a minimum taken off.
    let scatter = means.iter().map(|(value, _)| (value - mean).powi(2)).sum::<f64>() / (means.len() - 1) as f64;
    let noise = means.iter().map(|(_, variance)| variance).sum::<f64>() / means.len() as f64;
    let added_px2 = (scatter - noise).max(0.0).sqrt();
    let sigma_px2 = noise.sqrt() / (2.0 * (means.len() - 1) as f64).sqrt();
    let sigma_px = added_px2.sqrt();
    let error = if sigma_px > 0.0 { 0.5 * sigma_px2 / sigma_px } else { sigma_px2.sqrt() };
    let sentence = format!(
        "The images are wider in some frames than in others: their variance scatters by {added_px2:.3} px² from frame to frame, as a camera that shakes makes it."
    );
    let counted = Counted::of_stars(JITTER, Channel::Shape, vec![("sigma_px", sigma_px, error, "px")], surprise, "frame", sentence);
    Some(if looks_through_air { counted.withheld("the air does the same: its seeing differs from frame to frame") } else { counted })
}

/// Mean size of the images of each frame less what the findings make of it, with its variance, px².
fn frame_means(judged: &Judged) -> Option<Vec<(f64, f64)>> {
    let kind = judged.rows.kinds.iter().position(|kind| kind.name == SIZE)?;
    let (own, noise) = (&judged.rows.kinds[kind], &judged.fit.noise[kind]);
    let range = judged.rows.ranges()[kind].clone();
    let mut sums: std::collections::BTreeMap<usize, (f64, f64, usize)> = std::collections::BTreeMap::new();
    for (row, k) in own.rows.iter().zip(range).filter(|(row, k)| judged.fit.take[*k] && row.point.is_some()) {
        let variance = noise.variance(row);
        // What is far off its frame counts little: a blend.
        let off = judged.fit.rest[k] / (variance + noise.shared).sqrt();
        let weight = super::row_noise::weight(off) / variance;
        let sum = sums.entry(row.frame).or_default();
        *sum = (sum.0 + weight * judged.fit.rest[k], sum.1 + weight, sum.2 + 1);
    }
    let means: Vec<(f64, f64)> =
        sums.into_values().filter(|(_, _, stars)| *stars >= MIN_STARS).map(|(sum, weight, _)| (sum / weight, weight.recip())).collect();
    (means.len() >= MIN_FRAMES).then_some(means)
}

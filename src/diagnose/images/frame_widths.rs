//! How wide the images of single frames are, and what their widths follow.
//!
//! Of a few frames whose scatter only they tell, no trend is beyond chance as a finding has to be: the more a trend explains, the larger is the scatter
//! without it. In space a scatter is a finding itself, and whether it is jitter or a trend is asked at lower odds ([`trend`]).

use super::counted::MAX_SURPRISE;
use super::row_fit::RowFit;
use super::rows::Rows;
use super::selection::{answers, directions, fitted};
use super::stars::SIZE;
use crate::statistics::significance::neg_ln_chi2_sf;

/// Fewer frames tell no scatter, and fewer stars of one no width.
const MIN_FRAMES: usize = 5;
const MIN_STARS: usize = 5;
/// Surprise of a trend that has the name instead: p of a thousandth for all trends that are asked.
const TREND: f64 = 6.9;
/// A trend leaves at most this part of the surprise; what is left is jitter beside it.
const MAX_LEFT: f64 = 0.5;

/// An effect that frames follow: its question, and the surprise of the scatter that it explains.
pub(super) struct Trend {
    pub(super) question: usize,
    pub(super) surprise: f64,
}

/// The effect that explains why images are wider in some frames than in others, where they scatter beyond `threshold` beside what is accepted: the most
/// surprising of those that leave little of it.
pub(super) fn trend(rows: &Rows, allowed: &[bool], (accepted, fit): (&[usize], &RowFit), threshold: f64) -> Option<Trend> {
    let surprise = scatter(&frame_means(rows, fit)?).1;
    if surprise < threshold {
        return None;
    }
    let kind = rows.kinds.iter().position(|kind| kind.name == SIZE)?;
    let range = rows.ranges()[kind].clone();
    let is_trend = |question: usize| {
        let own = directions(rows, fit, &rows.questions[question].columns);
        let within: f64 = own.iter().map(|own| own.rows(range.start, range.len()).norm_squared()).sum();
        within > 0.5 * own.len() as f64 && fit.share_of_means(rows, &own).is_some()
    };
    let asked: Vec<_> = answers(rows, fit, accepted).into_iter().filter(|answer| is_trend(answer.question)).collect();
    let least = TREND + (asked.len().max(1) as f64).ln();
    let explains = |question: usize| {
        let with: Vec<usize> = accepted.iter().copied().chain([question]).collect();
        frame_means(rows, &fitted(rows, allowed, &with, None)).is_some_and(|means| scatter(&means).1 < MAX_LEFT * surprise)
    };
    let best = asked
        .iter()
        .filter(|answer| answer.surprise > least && explains(answer.question))
        .max_by(|a, b| a.surprise.total_cmp(&b.surprise).then(a.statistic.total_cmp(&b.statistic)))?;
    Some(Trend { question: best.question, surprise })
}

/// Mean of the frames' means, and how surprising their scatter about it is by their own errors.
pub(super) fn scatter(means: &[(f64, f64)]) -> (f64, f64) {
    let total: f64 = means.iter().map(|(_, variance)| variance.recip()).sum();
    let mean = means.iter().map(|(value, variance)| value / variance).sum::<f64>() / total;
    let chi2: f64 = means.iter().map(|(value, variance)| (value - mean).powi(2) / variance).sum();
    (mean, neg_ln_chi2_sf((means.len() - 1) as f64, chi2).min(MAX_SURPRISE))
}

/// Mean size of the images of each frame less what is fitted makes of it, with its variance, px².
pub(super) fn frame_means(rows: &Rows, fit: &RowFit) -> Option<Vec<(f64, f64)>> {
    let kind = rows.kinds.iter().position(|kind| kind.name == SIZE)?;
    let (own, noise) = (&rows.kinds[kind], &fit.noise[kind]);
    let range = rows.ranges()[kind].clone();
    let mut sums: std::collections::BTreeMap<usize, (f64, f64, usize)> = std::collections::BTreeMap::new();
    for (row, k) in own.rows.iter().zip(range).filter(|(row, k)| fit.take[*k] && row.point.is_some()) {
        let variance = noise.variance(row);
        // What is far off its frame counts little: a blend.
        let off = fit.rest[k] / (variance + noise.shared).sqrt();
        let weight = super::row_noise::weight(off) / variance;
        let sum = sums.entry(row.frame).or_default();
        *sum = (sum.0 + weight * fit.rest[k], sum.1 + weight, sum.2 + 1);
    }
    let means: Vec<(f64, f64)> =
        sums.into_values().filter(|(_, _, stars)| *stars >= MIN_STARS).map(|(sum, weight, _)| (sum / weight, weight.recip())).collect();
    (means.len() >= MIN_FRAMES).then_some(means)
}

//! Ordinary sizes of effects in real cameras and skies, and the power of this recording to show them. A null result says no more than what would
//! have been detected.

use super::channels::Detectable;
use super::evidence::Evidence;
use super::fit_state::{FitState, SelectedEffect, UNOBSERVABLE, amplitude, survival};
use super::hypotheses::Hypothesis;
use super::zenith::with_zenith;
use crate::effects::{OrdinarySize, UsualSize};
use crate::statistics::order::sort_by;
use crate::statistics::significance::neg_ln_chi2_sf;

/// A normal number is above −SURE with 95 %.
const SURE: f64 = 1.645;

/// The ordinary size of a hypothesis's first fitted parameter and its source; `reach_px` is the largest displacement for one unit of it.
fn ordinary(hypothesis: &Hypothesis, reach_px: f64) -> Option<(f64, &'static str)> {
    let facts = hypothesis.effect.facts();
    let OrdinarySize { size, source } = facts.ordinary_size?;
    let first = *hypothesis.fitted.first()?;
    let value = match size {
        // Of a velocity that nobody knows the components are fitted, not the amplitude.
        UsualSize::FirstParameter(value) => facts.ordinary_component.filter(|_| first > 0).unwrap_or(value),
        UsualSize::LargestPx(px) => px / reach_px,
    };
    value.is_finite().then_some((value, source))
}

/// Noncentrality of a χ² of `rank` degrees of freedom that exceeds, with 95 %, what has a surprise of `threshold` by chance.
///
/// Source: Sankaran's approximation of the noncentral distribution, Biometrika 50, 199 (1963).
fn needed(rank: usize, threshold: f64) -> f64 {
    let rank = rank as f64;
    let bisect = |is_enough: &dyn Fn(f64) -> bool| {
        let (mut low, mut high) = (0.0, 1e5);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if is_enough(middle) {
                high = middle;
            } else {
                low = middle;
            }
        }
        high
    };
    let least = bisect(&|t| neg_ln_chi2_sf(rank, t) >= threshold);
    bisect(&|lambda| {
        let (mean, twice) = (rank + lambda, rank + 2.0 * lambda);
        let h = 1.0 - 2.0 / 3.0 * mean * (rank + 3.0 * lambda) / (twice * twice);
        let p = twice / (mean * mean);
        let m = (h - 1.0) * (1.0 - 3.0 * h);
        let below = (least / mean).powf(h) - (1.0 + h * p * (h - 1.0 - 0.5 * (2.0 - h) * m * p));
        below / (h * (2.0 * p).sqrt() * (1.0 + 0.5 * m * p)) <= -SURE
    })
}

/// The variant of which the ordinary size is asked: the middle one of a search; of zeniths that nobody knows one under which the frames stand
/// halfway up, as those of the table's refraction do.
fn usual_variant(evidence: &Evidence, hypothesis: &Hypothesis) -> usize {
    let height = |zenith: [f64; 3]| {
        let of = |k: usize| {
            let icrs = with_zenith(&evidence.frames[evidence.place[k]].1, zenith).zenith.unwrap_or(zenith);
            icrs.iter().zip(evidence.images[k].star_direction).map(|(a, b)| a * b).sum::<f64>()
        };
        (0..evidence.images.len()).map(of).sum::<f64>() / evidence.images.len().max(1) as f64
    };
    let off = |zenith: [f64; 3]| (height(zenith) - std::f64::consts::FRAC_1_SQRT_2).abs();
    let zeniths = hypothesis.variants.iter().enumerate().filter_map(|(index, variant)| Some((index, off(variant.zenith?))));
    zeniths.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(hypothesis.variants.len() / 2, |(index, _)| index)
}

/// What the recording could have shown beside what was found, the effects that show best (in units of their ordinary size) first.
/// `threshold` is the surprise that a name needs.
pub(super) fn detectable(
    evidence: &Evidence,
    stand: &FitState,
    base: &FitState,
    found: &[SelectedEffect],
    threshold: f64,
) -> Vec<Detectable> {
    let mut all: Vec<Detectable> = Vec::new();
    for (index, hypothesis) in evidence.hypotheses.iter().enumerate() {
        if hypothesis.variants.is_empty() || found.iter().any(|entry| entry.hypothesis == index) {
            continue;
        }
        let variant = usual_variant(evidence, hypothesis);
        let Some(column) = hypothesis.variants[variant].columns.first() else { continue };
        let reach_px = column.iter().map(|[x, y]| x.hypot(*y)).fold(0.0, f64::max);
        let Some((ordinary, source)) = ordinary(hypothesis, reach_px) else { continue };
        let entry = [SelectedEffect { hypothesis: index, variant }];
        let white = |stand: &FitState| stand.white(evidence, &entry);
        let own = white(stand);
        let (_, rank) = stand.score(&own);
        let threshold = threshold + 0.5 * (hypothesis.variants.len() as f64).ln();
        // Of what attitudes and camera take up nothing is ever claimed.
        let observable = rank > 0 && survival(base, &white(base)) >= UNOBSERVABLE;
        let sigma = amplitude(stand, &own[0]).map(|[_, sigma]| sigma).filter(|sigma| observable && sigma.is_finite());
        let size_95 = sigma.map(|sigma| sigma * needed(rank, threshold).sqrt());
        let spec = &hypothesis.effect.parameters()[hypothesis.fitted[0]];
        all.push(Detectable {
            id: hypothesis.id().to_owned(),
            name: spec.name.to_owned(),
            unit: spec.unit.to_owned(),
            size_95,
            ordinary,
            source: source.to_owned(),
            would_show: size_95.is_some_and(|size| size <= ordinary),
        });
    }
    let ratio = |own: &Detectable| own.size_95.map_or(f64::INFINITY, |size| size / own.ordinary);
    sort_by(&mut all, |a, b| ratio(a).total_cmp(&ratio(b)).then(a.id.cmp(&b.id)));
    all
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::effects::DISPLACEMENTS;

    /// Whatever is tried has an ordinary size, within what is possible, and a source.
    #[test]
    fn every_hypothesis_has_an_ordinary_size() {
        for effect in DISPLACEMENTS.iter().filter(|effect| effect.is_hypothesis()) {
            let line = effect.facts().ordinary_size;
            let OrdinarySize { size, source } = line.unwrap_or_else(|| panic!("{} has no ordinary size", effect.id()));
            let (low, high) = effect.parameters()[0].range;
            assert!(!source.is_empty());
            match size {
                UsualSize::FirstParameter(value) => assert!(value > 0.0 && (low..=high).contains(&value), "{}: {value}", effect.id()),
                UsualSize::LargestPx(px) => assert!((0.001..1.0).contains(&px), "{}", effect.id()),
            }
        }
    }

    /// The size needed is one that is found with 95 %: of many draws of a normal score with that mean.
    #[test]
    fn what_is_needed_is_seen_with_95_percent() {
        const DRAWS: usize = 4000;
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(3);
        for (rank, threshold) in [(1_usize, 13.0), (2, 13.0), (4, 16.0)] {
            let mean = needed(rank, threshold).sqrt();
            let seen = (0..DRAWS).filter(|_| {
                let t: f64 = (0..rank)
                    .map(|k| {
                        let draw: f64 = StandardNormal.sample(&mut rng);
                        (draw + if k == 0 { mean } else { 0.0 }).powi(2)
                    })
                    .sum();
                neg_ln_chi2_sf(rank as f64, t) >= threshold
            });
            let share = seen.count() as f64 / DRAWS as f64;
            assert!((share - 0.95).abs() < 0.012, "rank {rank}: {share}");
        }
    }
}

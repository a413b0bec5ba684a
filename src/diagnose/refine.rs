//! Refinement of searched parameters (positions and lengths without a useful derivative): profile likelihood on a finer grid.
//!
//! Its standard error includes the search. Where a seam lies the likelihood is no parabola: from star to star it goes up and down at random as the
//! seam passes them, about a tent, and its fall within some distance says little. So estimate and error are mean and standard deviation of the
//! position under its profile likelihood with a flat prior: over all recordings the square of the error then has the mean that is stated, however
//! many maxima there are. Source: for the likelihood about a place of change, B. E. Hansen, Econometrica 68, 575 (2000).

use rayon::prelude::*;

use super::evidence::Evidence;
use super::fit_state::{FitState, SelectedEffect, columns};
use super::hypotheses::{Hypothesis, Variant, at_value, finer};
use super::linear_fit::Fit;
use super::linear_system::Whitened;
use super::noise::NoiseModel;
use crate::calibrate::BundleSolution;
use crate::statistics::order::ascending;
use crate::statistics::student_t::cost;

/// Halvings of the search over places and lengths.
const REFINEMENTS: usize = 5;
/// Places tried at once for the profile,
const PLACES: usize = 48;
/// in so many rounds, each about where the profile has not fallen
const ROUNDS: usize = 4;
/// by so much (χ²): beyond, a ten-thousandth is left.
const DEEP: f64 = 20.0;
/// A round that leaves more of the range is the last.
const NARROWER: f64 = 0.7;
/// The mean is taken for the place where the profile is no lower there than this below its top: else the top.
const AS_GOOD: f64 = 4.0;

/// Makes the search over places and lengths finer about what was found.
pub(super) fn refine(evidence: &mut Evidence, joint: &BundleSolution, entries: &mut [SelectedEffect], all: &[bool], begin: &NoiseModel) {
    for k in 0..entries.len() {
        let others: Vec<SelectedEffect> = entries.iter().enumerate().filter(|(index, _)| *index != k).map(|(_, entry)| *entry).collect();
        let hypothesis = entries[k].hypothesis;
        if evidence.hypotheses[hypothesis].searched.is_none() {
            continue;
        }
        let stand = FitState::new(evidence, all, &others, begin);
        for step in 0..REFINEMENTS {
            let best = evidence.hypotheses[hypothesis].variants[entries[k].variant].clone();
            let tried = finer(&evidence.hypotheses[hypothesis], &best, joint, step);
            if tried.is_empty() {
                break;
            }
            let at = evidence.hypotheses[hypothesis].variants.len();
            let count = tried.len();
            evidence.hypotheses[hypothesis].variants.extend(tried);
            let score = |variant: usize| {
                let entry = SelectedEffect { hypothesis, variant };
                let own: Vec<Whitened> = stand.white(evidence, &[entry]);
                stand.score(&own).0
            };
            let from = if step == 0 { 0 } else { at };
            let options: Vec<(f64, usize)> =
                std::iter::once(entries[k].variant).chain(from..at + count).map(|variant| (score(variant), variant)).collect();
            if let Some((_, variant)) = options.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)) {
                entries[k].variant = variant;
            }
        }
    }
}

/// Tells of each entry's searched parameter that is not fitted once found where it is, and its standard error.
pub(super) fn place(evidence: &mut Evidence, joint: &BundleSolution, entries: &mut [SelectedEffect], all: &[bool], begin: &NoiseModel) {
    for k in 0..entries.len() {
        let SelectedEffect { hypothesis, variant } = entries[k];
        let own = &evidence.hypotheses[hypothesis];
        let best = own.variants[variant].clone();
        let Some(searched) = own.searched.as_ref().filter(|searched| !searched.then_fitted) else { continue };
        let parameter = searched.parameter;
        let stand = FitState::new(evidence, all, entries, begin);
        let others: Vec<Whitened> = entries
            .iter()
            .filter(|entry| entry.hypothesis != hypothesis)
            .flat_map(|entry| columns(evidence, std::slice::from_ref(entry)).map(|column| evidence.white(&stand.noise, column)))
            .collect();
        let gain = |tried: &Variant| {
            let own: Vec<Whitened> = tried.columns.iter().map(|column| evidence.white(&stand.noise, column)).collect();
            let fit = Fit::new(&stand.system, &stand.take, &others.iter().chain(&own).collect::<Vec<_>>());
            -cost(&fit.residual, &stand.take, stand.system.tail_degrees) * stand.fit.d / stand.fit.c
        };
        let seen = profile(own, &best, joint, &gain);
        let Some((mean, sigma)) = moments(&seen) else { continue };
        let top = seen.iter().map(|(_, gain)| *gain).fold(f64::NEG_INFINITY, f64::max);
        let at_mean = at_value(own, &best, joint, mean).filter(|tried| gain(tried) > top - AS_GOOD);
        let chosen = at_mean.or_else(|| {
            let (value, _) = seen.iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
            at_value(own, &best, joint, *value)
        });
        let Some(chosen) = chosen else { continue };
        let off = chosen.start[parameter] - mean;
        let own = &mut evidence.hypotheses[hypothesis];
        own.variants.push(Variant { searched_sigma: Some(sigma.hypot(off)), ..chosen });
        entries[k].variant = own.variants.len() - 1;
    }
}

/// What the fit gains at places all over the range, more of them where it is best; in rising order.
fn profile(own: &Hypothesis, best: &Variant, joint: &BundleSolution, gain: &(impl Fn(&Variant) -> f64 + Sync)) -> Vec<(f64, f64)> {
    let Some((mut low, mut high)) = own.searched.as_ref().and_then(|searched| Some((*searched.values.first()?, *searched.values.last()?)))
    else {
        return Vec::new();
    };
    let mut seen: Vec<(f64, f64)> = Vec::new();
    for _ in 0..ROUNDS {
        let step = (high - low) / (PLACES - 1) as f64;
        let tried = (0..PLACES).into_par_iter().filter_map(|k| {
            let value = low + step * k as f64;
            Some((value, gain(&at_value(own, best, joint, value)?)))
        });
        seen.extend(tried.collect::<Vec<_>>());
        ascending(&mut seen, |a| a.0);
        seen.dedup_by(|a, b| a.0 == b.0);
        let top = seen.iter().map(|(_, gain)| *gain).fold(f64::NEG_INFINITY, f64::max);
        let near = |(_, gain): &(f64, f64)| *gain > top - DEEP;
        let (Some(first), Some(last)) = (seen.iter().position(near), seen.iter().rposition(near)) else { break };
        let (from, to) = (seen[first.saturating_sub(1)].0, seen[(last + 1).min(seen.len() - 1)].0);
        if to - from > NARROWER * (high - low) {
            break;
        }
        (low, high) = (from, to);
    }
    seen
}

/// Mean and standard deviation of a place under its profile of gains (χ²), by trapezoids.
fn moments(seen: &[(f64, f64)]) -> Option<(f64, f64)> {
    let top = seen.iter().map(|(_, gain)| *gain).fold(f64::NEG_INFINITY, f64::max);
    let mut sums = [0.0; 3];
    let middle = seen.iter().max_by(|a, b| a.1.total_cmp(&b.1))?.0;
    for pair in seen.windows(2) {
        let width = pair[1].0 - pair[0].0;
        for (value, gain) in pair {
            let weight = 0.5 * width * (0.5 * (gain - top)).exp();
            let off = value - middle;
            for (sum, power) in sums.iter_mut().zip([1.0, off, off * off]) {
                *sum += weight * power;
            }
        }
    }
    let [whole, first, second] = sums;
    (whole > 0.0).then(|| {
        let mean = first / whole;
        (middle + mean, (second / whole - mean * mean).max(0.0).sqrt())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A parabola gives its own mean and width; two tops as high give the way between them, where a fall about one of them would give its width.
    #[test]
    fn the_error_of_a_place_is_that_of_all_places_as_good() {
        let seen = |tops: &[f64]| -> Vec<(f64, f64)> {
            (0..=2000)
                .map(|k| {
                    let value = f64::from(k) * 0.01;
                    (value, tops.iter().map(|top| -((value - top) / 0.5).powi(2)).fold(f64::NEG_INFINITY, f64::max))
                })
                .collect()
        };
        let (mean, sigma) = moments(&seen(&[8.0])).unwrap();
        assert!((mean - 8.0).abs() < 1e-6 && (sigma - 0.5).abs() < 1e-3, "{mean} {sigma}");
        let (mean, sigma) = moments(&seen(&[5.0, 15.0])).unwrap();
        assert!((mean - 10.0).abs() < 1e-6 && (sigma - 5.0_f64.hypot(0.5)).abs() < 1e-3, "{mean} {sigma}");
    }
}

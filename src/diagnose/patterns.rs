//! Hausman test of a finding's name: is the effect's estimate the same beside a free pattern over the field?
//!
//! A pattern that can imitate most of the effect may be the better description of both. It is fitted beside the effect: what
//! it cannot imitate of the effect measures the effect alone. If the name is right, that part shows it, and shows it at the same size: the two
//! estimates differ by chance only, with the variance σ₁² − σ₀², σ₁ the error beside the pattern, σ₀ that without it (the estimate without the
//! pattern is the efficient one). If the effect is no more than a likeness of the pattern, nothing of it is left, or another size. Where the
//! size is known beforehand it is the known one that is the efficient estimate: a pattern of another origin moves what is estimated without
//! it, and not what is estimated beside it.
//!
//! Every pattern is a test of its own; the p-value is that of the largest of all statistics.
//!
//! Source: Hausman, Econometrica 46, 1251 (1978), for the difference of two estimates of which one is efficient.

use nalgebra::{DMatrix, DVector};

use super::evidence::Evidence;
use super::final_fit::FinalFit;
use super::fit_state::{AGREES, FitState, SelectedEffect};
use super::linear_system::{Whitened, dot};
use super::scan::{Asks, Group, Scan, orthonormal};
use crate::calibrate::Column;
use crate::statistics::significance::{family_wise_p_value, neg_ln_chi2_sf};

/// A pattern remains if chance leaves the largest of as many with less than this probability.
const REMAINS_P: f64 = 1e-3;
/// What is left must be this share of what the effect explains, or it is no fault of the name.
const MIN_LEFT: f64 = 0.03;
/// Covariates that patterns of the field go by.
pub(super) const IN_THE_FIELD: &[&str] = &["field-map", "colour", "magnitude", "field-radius", "x", "y", "edge-distance"];
/// An effect is of the kind of a pattern if the pattern spans so much of it.
const OF_THE_KIND: f64 = 0.5;
/// −ln of the probability of three standard deviations: by less a size may move beside a pattern, by more the effect has to show there.
pub(super) const THREE_SIGMA: f64 = 5.915;

/// An accepted effect among others: where it was looked for, and where everything is solved.
pub(super) struct Named<'a> {
    /// Linearised without the effects, and the fit of all of them there.
    pub(super) evidence: &'a Evidence,
    pub(super) stand: &'a FitState,
    pub(super) entries: &'a [SelectedEffect],
    /// Everything with the effects in force.
    pub(super) solved: &'a FinalFit,
    /// Which of them.
    pub(super) k: usize,
}

/// What the patterns of `scan`, taken beside the whole model, have against a name; `statistic` is what the effect explains.
pub(super) fn veto(named: &Named, scan: &Scan, statistic: f64) -> Option<String> {
    let evidence = &named.solved.evidence;
    let asked: Vec<(&Group, usize)> = scan
        .groups
        .iter()
        .filter_map(|group| match group.asks {
            Asks::Covariate(index) if IN_THE_FIELD.contains(&evidence.covariates[index].name.as_str()) => Some((group, index)),
            _ => None,
        })
        .collect();
    let remaining = asked.iter().filter_map(|(group, index)| {
        let p = family_wise_p_value((-group.surprise()).exp(), asked.len() as f64);
        (p < REMAINS_P && group.statistic - group.rank as f64 > MIN_LEFT * statistic).then_some((*group, *index, p))
    });
    for (group, index, p) in remaining {
        let covariate = &evidence.covariates[index];
        let Some(against) = against(named, index, group.pattern) else { continue };
        let over = if covariate.name == "field-map" { "the field".to_owned() } else { format!("the field by {}", covariate.name) };
        return Some(format!("a pattern over {over} remains beside it (p = {p:.1e}), and with it free {against}"));
    }
    None
}

/// What becomes of the effect with a pattern free beside it, if that speaks against it.
fn against(named: &Named, index: usize, pattern: usize) -> Option<String> {
    let at_start = beside(named.evidence, named.stand, named.entries, named.k, &named.evidence.covariates.get(index)?.patterns[pattern]);
    let (own, stand) = (&named.solved.evidence, &named.solved.stand);
    let solved = beside(own, stand, &named.solved.entries, named.k, &own.covariates[index].patterns[pattern]);
    if solved.within() <= OF_THE_KIND {
        return None; // it is of another kind than the pattern
    }
    let (shows, rank) = at_start.with_pattern.score(&at_start.own);
    if neg_ln_chi2_sf(rank as f64, shows) < THREE_SIGMA {
        return Some("nothing of the effect is left".to_owned());
    }
    let moved = solved.moved()?;
    let before = &named.evidence.hypotheses[named.entries[named.k].hypothesis].variants[named.entries[named.k].variant];
    let known = named.solved.ratio_beside(named.k, before, &solved.with_pattern);
    let is_known = known.is_some_and(|[ratio, sigma]| (ratio - 1.0).abs() <= AGREES * sigma);
    (moved > THREE_SIGMA && !is_known).then(|| "its size is another".to_owned())
}

/// An effect's own columns, the fit of all others, and that of all others with a pattern.
struct Beside {
    own: Vec<Whitened>,
    pattern: Vec<Whitened>,
    without: FitState,
    with_pattern: FitState,
}

fn beside(evidence: &Evidence, stand: &FitState, entries: &[SelectedEffect], k: usize, pattern: &[Column]) -> Beside {
    let white = |column: &Column| evidence.white(&stand.noise, column);
    let without = stand.without(evidence, entries, k);
    let pattern: Vec<Whitened> = pattern.iter().map(white).collect();
    let with_pattern = stand.beside(without.more.iter().chain(&pattern).cloned().collect());
    Beside { own: stand.white(evidence, &entries[k..=k]), pattern, without, with_pattern }
}

impl Beside {
    /// The largest share of one of the effect's columns (squared) that the pattern spans.
    fn within(&self) -> f64 {
        let fit = &self.without.fit;
        let basis = orthonormal(&self.without.system, fit, &self.pattern);
        let share = |column: &Whitened| {
            let rest = fit.project(column);
            basis.column_iter().map(|b| dot(b.as_slice(), &rest).powi(2)).sum::<f64>() / dot(&rest, &rest).max(f64::MIN_POSITIVE)
        };
        self.own.iter().map(share).fold(0.0, f64::max)
    }

    /// The surprise that the effect's sizes move so far as the pattern is set free.
    fn moved(&self) -> Option<f64> {
        let (before, error) = estimate(&self.without, &self.own)?;
        let (after, larger) = estimate(&self.with_pattern, &self.own)?;
        let moved = after - before;
        // A direction that the pattern does not touch neither moves nor gets a larger error.
        let difference = (&larger - error) + &larger * 1e-6;
        let square = moved.dot(&(difference.pseudo_inverse(0.0).ok()? * &moved));
        Some(neg_ln_chi2_sf(moved.len() as f64, square))
    }
}

/// Change of an effect's sizes beside a fit, and its covariance; none where the fit leaves nothing of one of them.
fn estimate(stand: &FitState, own: &[Whitened]) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let fit = &stand.fit;
    let rest: Vec<Whitened> = own.iter().map(|column| fit.project(column)).collect();
    let gram = DMatrix::from_fn(own.len(), own.len(), |i, j| dot(&rest[i], &rest[j]));
    let inverse = gram.cholesky()?.inverse();
    let scores = DVector::from_iterator(own.len(), rest.iter().map(|column| -dot(column, &fit.psi) / fit.d));
    Some((&inverse * scores, inverse * (fit.c / (fit.d * fit.d))))
}

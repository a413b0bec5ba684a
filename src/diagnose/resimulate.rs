//! Resimulation of the recording with the findings: every star is sent through camera and sky as a renderer sends it, without linearisation, and
//! the result is fitted by the same model as the real recording. If the findings are what was missing, the two differ by errors alone.

use super::evidence::Evidence;
use super::final_fit::FinalFit;
use super::fit_state::{FitState, SelectedEffect};
use super::linear_fit::Fit;
use super::linear_system::{Whitened, WhitenedSystem};
use super::null_distribution::{NullDistribution, family_p};
use super::options::DiagnoseOptions;
use super::scan::{Asks, Scan};
use super::star_images::StarImages;
use crate::calibrate::{BundleSolution, Column, FixedNoise};
use crate::statistics::significance::neg_ln_chi2_sf;
use crate::statistics::student_t::weight;

/// Real and simulated recording differ, and what was found is not what is missing, below this.
pub(super) const DIFFERS: f64 = 0.01;

/// The simulated recording beside the real one.
#[derive(Clone, Debug)]
pub(super) struct Resimulated {
    /// Probability that two recordings of the same camera differ as much by chance, all questions counted.
    pub(super) p_value: f64,
    /// The same for each finding's own displacement alone.
    pub(super) own_p: Vec<f64>,
}

/// Simulates with the effects of `solved` in force. `baseline` is the model that the recording was held against, `evidence` its linearisation
/// with the columns of `entries`, `chance` what its questions answer without any effect.
pub(super) fn resimulate(
    baseline: &BundleSolution,
    evidence: &Evidence,
    entries: &[SelectedEffect],
    solved: &FinalFit,
    chance: &NullDistribution,
    options: &DiagnoseOptions,
) -> Option<Resimulated> {
    let stand = &solved.stand;
    // Both solved alike: by least squares with the same weights.
    let weights = (0..evidence.images.len()).map(|k| {
        let q = stand.fit.residual[2 * k].powi(2) + stand.fit.residual[2 * k + 1].powi(2);
        if stand.take[k] { weight(stand.noise.tail_degrees, q) } else { 0.0 }
    });
    let factors = stand.noise.frame_factors.iter().map(|factor| factor * stand.noise.factor).collect();
    let noise = FixedNoise { floor_px2: stand.noise.floor_px2 / stand.noise.factor, factors, weights: weights.collect() };
    let fitted = |joint: &BundleSolution| Some(StarImages::new(&joint.again(&[], &options.solve, &noise).ok()?));
    let real = fitted(baseline)?;
    let simulated = fitted(&baseline.with_measured(&solved.joint.simulated_px()))?;
    if [&real, &simulated].iter().any(|other| other.images.len() != evidence.images.len()) {
        return None;
    }
    let difference: Column = real
        .residual_px
        .chunks_exact(2)
        .zip(simulated.residual_px.chunks_exact(2))
        .map(|(real, simulated)| [real[0] - simulated[0], real[1] - simulated[1]])
        .collect();
    let system = WhitenedSystem { residual: evidence.white(&stand.noise, &difference), ..evidence.system(&stand.noise) };
    let fit = Fit::new(&system, &stand.take, &[]);
    let scan = Scan::new(evidence, &stand.noise, &system, &fit, |_| true);
    let most = |of_hypotheses: bool| {
        let asked = scan.groups.iter().filter(|group| matches!(group.asks, Asks::Hypothesis(..)) == of_hypotheses);
        asked.map(super::scan::Group::surprise).fold(0.0, f64::max)
    };
    let p = family_p(&chance.hypotheses, most(true)).min(family_p(&chance.covariates, most(false)));
    let beside = FitState { noise: stand.noise.clone(), system, take: stand.take.clone(), more: Vec::new(), fit };
    let own = |entry: &SelectedEffect| {
        let white: Vec<Whitened> = stand.white(evidence, std::slice::from_ref(entry));
        let (t, rank) = beside.score(&white);
        (-neg_ln_chi2_sf(rank as f64, t)).exp()
    };
    Some(Resimulated { p_value: (2.0 * p).min(1.0), own_p: entries.iter().map(own).collect() })
}

//! The final fit: all findings in the model, all frames, no linearisation. Sizes and their standard errors come from here.

use nalgebra::{DMatrix, DVector};

use super::diagnosis::{FoundParameter, FoundZenith, Rival};
use super::error::DiagnoseError;
use super::evidence::Evidence;
use super::fit_state::{FitState, SelectedEffect, amplitude};
use super::hypotheses::{Hypothesis, Variant};
use super::linear_system::Whitened;
use super::noise::NoiseModel;
use super::omitted_nature::is_needed;
use super::omnibus::{Omnibus, omnibus};
use super::options::{DiagnoseOptions, Telemetry};
use super::scan::Scan;
use super::star_images::StarImages;
use super::stepwise::{self, candidates};
use super::zenith::supposed;
use crate::calibrate::{BundleSolution, Column, FixedNoise};
use crate::camera::{Model, Term};
use crate::coordinates::{Direction, Icrs};
use crate::effects::sky::refraction::{Refraction, zenith_at};
use crate::effects::{Displacement as _, Facts, Observation};
use crate::identify::ControlPoints;
use crate::statistics::student_t::weight;
use crate::units::DEG_RAD;

/// Effects with a larger cosine stand beside a size that is held against the known one,
const RESEMBLES: f64 = 0.5;
/// so many of them.
const MAX_BESIDE: usize = 4;
/// Effects that all frames show beside those of a part, at most.
const MAX_MORE: usize = 4;

/// Everything with the findings in force, all frames, solved without linearisation.
pub(super) struct FinalFit {
    /// The joint solution.
    pub(super) joint: BundleSolution,
    /// Linearised there.
    pub(super) evidence: Evidence,
    /// The accepted effects there.
    pub(super) entries: Vec<SelectedEffect>,
    /// The fit there.
    pub(super) stand: FitState,
}

impl FinalFit {
    /// Where nothing was found: as it was.
    pub(super) fn unchanged(joint: &BundleSolution, evidence: &Evidence, base: &FitState) -> Self {
        Self { joint: joint.clone(), evidence: evidence.clone(), entries: Vec::new(), stand: base.clone() }
    }

    /// Solves with the accepted effects from their linear sizes; under a zenith that was searched for, from where a solution with more effects
    /// (`nearer`) has it.
    #[allow(clippy::too_many_arguments, reason = "all that was found, and where to begin")]
    pub(super) fn new(
        joint: &BundleSolution,
        points: &ControlPoints,
        telemetry: &Telemetry,
        options: &DiagnoseOptions,
        evidence: &Evidence,
        entries: &[SelectedEffect],
        nearer: Option<&Model>,
    ) -> Result<Self, DiagnoseError> {
        const TURNS: usize = 8;
        let all = vec![true; evidence.images.len()];
        let begin = NoiseModel::stated(evidence.frame_factors.clone());
        let mut stand = FitState::new(evidence, &all, entries, &begin);
        let mut at = evidence.system(&stand.noise).camera.len();
        let mut terms = Vec::new();
        let mut names = Vec::new();
        let mut now = joint.clone();
        for entry in entries {
            let hypothesis = &evidence.hypotheses[entry.hypothesis];
            let variant = &hypothesis.variants[entry.variant];
            let mut parameters = variant.start.clone();
            for (index, _) in hypothesis.fitted.iter().zip(&variant.columns) {
                parameters[*index] += stand.fit.change[at];
                at += 1;
            }
            for (value, spec) in parameters.iter_mut().zip(hypothesis.effect.parameters()) {
                *value = value.clamp(spec.range.0, spec.range.1);
            }
            if let Some(zenith) = variant.zenith {
                now = supposed(&now, zenith, &variant.turns_rad);
                let there = nearer.and_then(|model| model.terms().find(|(id, _)| *id == hypothesis.id()));
                parameters = there.map_or(parameters, |(_, found)| found.to_vec());
            }
            if let Some(shifts) = hypothesis.shifts.as_ref().filter(|_| variant.rendered) {
                now = now.with_signatures(shifts);
            }
            terms.push(Term { effect: hypothesis.id().to_owned(), parameters });
            names.extend(hypothesis.full_names());
        }
        let mut here = evidence.clone();
        for turn in 0..TURNS {
            now = solve_again(&now, options, &here, &stand, if turn == 0 { &terms } else { &[] }, &names)?;
            here = Evidence::of_stars(StarImages::new(&now), evidence.frame_factors.clone());
            // The camera's columns are those of all free parameters, the effects' included.
            let next = FitState::new(&here, &all, &[], &stand.noise);
            let settled = turn > 1 && next.take == stand.take;
            stand = next;
            if settled {
                break;
            }
        }
        let mut full = Evidence::at(&now, points, telemetry, options, evidence.rendered.clone());
        full.frame_factors.clone_from(&evidence.frame_factors);
        full.stars.camera = camera_columns(&now, &full, options);
        let entries: Vec<SelectedEffect> =
            entries.iter().map(|entry| SelectedEffect { hypothesis: entry.hypothesis, variant: 0 }).collect();
        let stand = FitState::new(&full, &all, &entries, &stand.noise);
        Ok(Self { joint: now, evidence: full, entries, stand })
    }

    /// The zenith of each frame that refraction was found with, where the recording does not tell it.
    pub(super) fn zeniths(&self) -> Vec<FoundZenith> {
        let model = self.joint.model();
        let Some((_, parameters)) = model.terms().find(|(id, _)| *id == Refraction::ID) else { return Vec::new() };
        let of = |(frame, observation): (usize, Observation)| {
            let zenith = Direction::<Icrs>::from_unit(zenith_at(parameters, &observation).filter(|_| observation.zenith_is_guessed)?);
            let (ra_rad, dec_rad) = zenith.radec_rad();
            Some(FoundZenith { frame, radec_deg: [ra_rad / DEG_RAD, dec_rad / DEG_RAD] })
        };
        self.joint.frames().into_iter().filter_map(of).collect()
    }

    /// The questions beside the whole model.
    pub(super) fn scan(&self) -> Scan {
        let free = |index: usize| self.entries.iter().all(|entry| entry.hypothesis != index);
        Scan::new(&self.evidence, &self.stand.noise, &self.stand.system, &self.stand.fit, free)
    }

    /// The test of what is left.
    pub(super) fn omnibus(&self, scan: &Scan, options: &DiagnoseOptions, stream: u64) -> Omnibus {
        omnibus(&self.evidence, &self.stand, scan, options, (stream, options.alpha))
    }

    /// Size found over size known of an accepted effect, with the effects free beside it that resemble it: what they could take of it is
    /// in the error. For effects of one parameter.
    pub(super) fn ratio_beside_rivals(&self, k: usize, before: &Variant, rivals: &[Rival]) -> Option<[f64; 2]> {
        let (evidence, stand) = (&self.evidence, &self.stand);
        let hypothesis = &evidence.hypotheses[self.entries[k].hypothesis];
        if hypothesis.variants[self.entries[k].variant].columns.len() != 1 {
            return None;
        }
        let white = |entry: SelectedEffect| stand.white(evidence, &[entry]);
        let mut beside: Vec<Whitened> =
            self.entries.iter().enumerate().filter(|(index, _)| *index != k).flat_map(|(_, entry)| white(*entry)).collect();
        for rival in rivals.iter().filter(|rival| rival.cos > RESEMBLES && rival.cos < stepwise::SAME).take(MAX_BESIDE) {
            let index = evidence.hypotheses.iter().position(|other| other.id() == rival.id)?;
            if !evidence.hypotheses[index].variants.is_empty() {
                beside.extend(white(SelectedEffect { hypothesis: index, variant: evidence.hypotheses[index].variants.len() / 2 }));
            }
        }
        self.ratio_beside(k, before, &stand.beside(beside))
    }

    /// Size found over size known of an accepted effect beside whatever `free` holds, and its standard error; none where it has not one
    /// parameter alone, or no known size.
    pub(super) fn ratio_beside(&self, k: usize, before: &Variant, free: &FitState) -> Option<[f64; 2]> {
        let hypothesis = &self.evidence.hypotheses[self.entries[k].hypothesis];
        let variant = &hypothesis.variants[self.entries[k].variant];
        let [column] = variant.columns.as_slice() else { return None };
        let [change, sigma] = amplitude(free, &self.evidence.white(&free.noise, column))?;
        let first = *hypothesis.fitted.first()?;
        let spec = &hypothesis.effect.parameters()[first];
        let value = variant.start[first] + change - difference(hypothesis.effect.facts(), &before.start, first);
        let found = FoundParameter { name: spec.name.to_owned(), value, sigma, unit: spec.unit.to_owned() };
        known_ratio(hypothesis, &before.start, &found)
    }

    /// Values of some of an accepted effect's fitted parameters, by their indices, and their covariance.
    pub(super) fn sizes(&self, k: usize, before: &Variant, wanted: &[usize]) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let hypothesis = &self.evidence.hypotheses[self.entries[k].hypothesis];
        let first = self.first_column(k);
        let fitted = &hypothesis.fitted[..hypothesis.variants[0].columns.len()];
        let places: Vec<usize> = wanted.iter().map(|index| fitted.iter().position(|own| own == index)).collect::<Option<_>>()?;
        let value = |place: &usize| {
            let index = fitted[*place];
            let present = hypothesis.variants[0].start[index] + self.stand.fit.change[first + place];
            present - difference(hypothesis.effect.facts(), &before.start, index)
        };
        let covariance = self.stand.fit.covariance();
        let of = |i: usize, j: usize| covariance[(first + places[i], first + places[j])];
        Some((DVector::from_iterator(places.len(), places.iter().map(value)), DMatrix::from_fn(places.len(), places.len(), of)))
    }

    /// Where an accepted effect's columns begin among those of the fit.
    fn first_column(&self, k: usize) -> usize {
        let columns = |entry: &SelectedEffect| self.evidence.hypotheses[entry.hypothesis].variants[0].columns.len();
        self.stand.system.camera.len() + self.entries[..k].iter().map(columns).sum::<usize>()
    }

    /// Values and standard errors of an accepted effect's fitted parameters.
    pub(super) fn parameters(&self, k: usize, before: &Variant) -> Vec<FoundParameter> {
        let (start, searched_sigma) = (&before.start, before.searched_sigma);
        let hypothesis = &self.evidence.hypotheses[self.entries[k].hypothesis];
        let first = self.first_column(k);
        let covariance = self.stand.fit.covariance();
        let present = &hypothesis.variants[0].start;
        let mut all: Vec<FoundParameter> = Vec::new();
        for (j, index) in hypothesis.fitted.iter().enumerate().take(hypothesis.variants[0].columns.len()) {
            let spec = &hypothesis.effect.parameters()[*index];
            let value = present[*index] + self.stand.fit.change[first + j] - difference(hypothesis.effect.facts(), start, *index);
            let sigma = covariance[(first + j, first + j)].max(0.0).sqrt();
            all.push(FoundParameter { name: spec.name.to_owned(), value, sigma, unit: spec.unit.to_owned() });
        }
        // What was searched for and not fitted is a parameter too.
        if let Some((searched, sigma)) = hypothesis.searched.as_ref().zip(searched_sigma)
            && !hypothesis.fitted.contains(&searched.parameter)
        {
            let spec = &hypothesis.effect.parameters()[searched.parameter];
            let value = present[searched.parameter];
            all.push(FoundParameter { name: spec.name.to_owned(), value, sigma, unit: spec.unit.to_owned() });
        }
        all
    }

    /// Effects that all frames show beside those found, the found ones first.
    pub(super) fn more(&self, evidence: &Evidence, entries: &[SelectedEffect], rejected: &[usize], threshold: f64) -> Vec<SelectedEffect> {
        let mut more = entries.to_vec();
        let all = vec![true; evidence.images.len()];
        for _ in 0..MAX_MORE {
            let stand = FitState::new(evidence, &all, &more, &self.stand.noise);
            let scan = Scan::hypotheses(evidence, &stand.noise, &stand.system, &stand.fit, |index| {
                !rejected.contains(&index) && more.iter().all(|e| e.hypothesis != index)
            });
            let mut found = candidates(evidence, &stand, &scan, threshold);
            found.retain(|candidate| {
                let asked = threshold + stepwise::searched(evidence, candidate.entry.hypothesis);
                candidate.surprise > asked
                    && stepwise::is_observable(evidence, &stand, candidate.entry)
                    && is_needed(evidence, &stand, &more, candidate.entry, asked)
            });
            let Some(entry) = stepwise::choose(evidence, &stand, &found) else { break };
            more.push(entry);
        }
        more
    }
}

/// The joint solution with the findings in force, errors and weights as the diagnosis has them.
pub(super) fn solve_again(
    joint: &BundleSolution,
    options: &DiagnoseOptions,
    evidence: &Evidence,
    stand: &FitState,
    terms: &[Term],
    names: &[String],
) -> Result<BundleSolution, DiagnoseError> {
    let mut solve = options.solve.clone();
    solve.extend(names.iter().cloned());
    let weights = (0..evidence.images.len())
        .map(|k| {
            let q = stand.fit.residual[2 * k].powi(2) + stand.fit.residual[2 * k + 1].powi(2);
            if stand.take[k] { weight(stand.noise.tail_degrees, q) } else { 0.0 }
        })
        .collect();
    let factors = stand.noise.frame_factors.iter().map(|factor| factor * stand.noise.factor);
    // The floor is inside the factors in the joint method: Σ = κ·(stated + φ).
    let floor_px2 = stand.noise.floor_px2 / stand.noise.factor;
    let noise = FixedNoise { floor_px2, factors: factors.collect(), weights };
    Ok(joint.again(terms, &solve, &noise)?)
}

/// What the reported value counts from: zero, but for parameters that are differences from the model's value.
pub(super) fn difference(facts: &Facts, start: &[f64], index: usize) -> f64 {
    if facts.counts_from_model { start[index] } else { 0.0 }
}

/// Size found over size known, and its standard error, what is open of the known size included.
fn known_ratio(hypothesis: &Hypothesis, start: &[f64], found: &FoundParameter) -> Option<[f64; 2]> {
    let first = *hypothesis.fitted.first()?;
    let known = if hypothesis.effect.facts().counts_from_model { -start[first] } else { hypothesis.known? };
    (known != 0.0).then(|| [found.value / known, (found.sigma / known).abs().hypot(hypothesis.effect.facts().open_share)])
}

/// Columns of the camera's own parameters at a solution where effects are solved too.
fn camera_columns(joint: &BundleSolution, evidence: &Evidence, options: &DiagnoseOptions) -> Vec<Column> {
    let names = joint.solved_for();
    let mut all: Vec<Column> = joint
        .solved_columns()
        .into_iter()
        .zip(&names)
        .filter(|(_, name)| options.solve.iter().any(|own| own == *name) || !name.contains('.'))
        .map(|(column, _)| column)
        .collect();
    all.extend(evidence.camera.iter().skip(names.len()).cloned());
    all
}

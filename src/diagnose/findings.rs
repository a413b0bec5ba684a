//! From accepted effects to findings: the solution with everything free, sizes with errors, what located them, the status of every effect.

use super::attribute::{self, Entry, Stand, UNOBSERVABLE, amplitude, columns};
use super::chance::Chance;
use super::diagnosis::{
    EffectState, EffectStatus, Finding, FoundParameter, Limit, Located, MeasuredNoise, NoiseState, Profile, ResidualRow, Rival,
};
use super::evidence::Evidence;
use super::hypotheses::{Hypothesis, Variant, with_zenith};
use super::noise::NoiseModel;
use super::omnibus::{Effort, Omnibus, among_covariates, omnibus};
use super::prove::Proof;
use super::rivals::{decided_by, rivals};
use super::run::{family, p_of, solve_again};
use super::scan::{Asks, Scan};
use super::sheet::{Fit, Whitened};
use super::{DiagnoseError, DiagnoseOptions, Telemetry, words};
use crate::calibrate::Joint;
use crate::camera::Term;
use crate::identify::ControlPoints;
use crate::statistics::significance::chi_squared_surprise;

/// A covariate locates a finding if chance does as well with less than this probability.
const LOCATES_P: f64 = 0.01;
/// So many are named.
const NAMED: usize = 3;
/// A size that is known beforehand and found to be another by more standard errors is not that effect alone.
const DISAGREES: f64 = 5.0;
/// Effects with a larger cosine stand beside a size that is held against the known one,
const RESEMBLES: f64 = 0.5;
/// so many of them.
const MOST_BESIDE: usize = 4;
/// An effect of which a smaller share is left is not observable where one of usual size would not be seen at
const WEAKLY: f64 = 0.1;
/// so many standard errors.
const SEEN: f64 = 5.0;
/// What site, air and clock leave open of a size that is known, as a share.
const OPEN_SHARE: f64 = 0.04;

/// Whether any parameter of an effect would be seen if it were of usual size.
fn usual_shows(hypothesis: &Hypothesis, stand: &Stand, white: &[Whitened]) -> bool {
    hypothesis.fitted.iter().zip(white).any(|(index, column)| {
        let sigma = amplitude(stand, column).map_or(f64::INFINITY, |[_, sigma]| sigma);
        SEEN * sigma < hypothesis.effect.parameters()[*index].typical.abs()
    })
}

/// Everything with the findings in force, all frames, solved without linearisation.
pub(super) struct Solved {
    /// The joint solution.
    pub(super) joint: Joint,
    /// Linearised there.
    pub(super) evidence: Evidence,
    /// The accepted effects there.
    pub(super) entries: Vec<Entry>,
    /// The fit there.
    pub(super) stand: Stand,
}

impl Solved {
    /// Where nothing was found: as it was.
    pub(super) fn unchanged(joint: &Joint, evidence: &Evidence, base: &Stand) -> Self {
        Self { joint: joint.clone(), evidence: evidence.clone(), entries: Vec::new(), stand: base.clone() }
    }

    /// Solves with the accepted effects from their linear sizes.
    pub(super) fn new(
        joint: &Joint,
        points: &ControlPoints,
        telemetry: &Telemetry,
        options: &DiagnoseOptions,
        evidence: &Evidence,
        entries: &[Entry],
    ) -> Result<Self, DiagnoseError> {
        const TURNS: usize = 8;
        let all = vec![true; evidence.images.len()];
        let begin = NoiseModel::stated(evidence.frame_factors.clone());
        let mut stand = Stand::new(evidence, &all, entries, &begin);
        let mut at = evidence.sheet(&stand.noise).camera.len();
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
                now = now.with_observations(|observation| with_zenith(observation, zenith));
            }
            terms.push(Term { effect: hypothesis.id().to_owned(), parameters });
            names.extend(hypothesis.full_names());
        }
        let mut here = evidence.clone();
        for turn in 0..TURNS {
            now = solve_again(&now, options, &here, &stand, if turn == 0 { &terms } else { &[] }, &names)?;
            here = Evidence::without_hypotheses(&now);
            here.frame_factors.clone_from(&evidence.frame_factors);
            // The camera's columns are those of all free parameters, the effects' included.
            let next = Stand::new(&here, &all, &[], &stand.noise);
            let settled = turn > 1 && next.take == stand.take;
            stand = next;
            if settled {
                break;
            }
        }
        let mut full = Evidence::at(&now, points, telemetry, options);
        full.frame_factors.clone_from(&evidence.frame_factors);
        full.camera = camera_columns(&now, &full, options);
        let entries: Vec<Entry> = entries.iter().map(|entry| Entry { hypothesis: entry.hypothesis, variant: 0 }).collect();
        let stand = Stand::new(&full, &all, &entries, &stand.noise);
        Ok(Self { joint: now, evidence: full, entries, stand })
    }

    /// The questions beside the whole model.
    pub(super) fn scan(&self) -> Scan {
        let free = |index: usize| self.entries.iter().all(|entry| entry.hypothesis != index);
        Scan::new(&self.evidence, &self.stand.noise, &self.stand.sheet, &self.stand.fit, free)
    }

    /// The test of what is left.
    pub(super) fn omnibus(&self, scan: &Scan, options: &DiagnoseOptions, stream: u64) -> Omnibus {
        omnibus(&self.evidence, &self.stand, scan, options, (stream, options.alpha, Effort::Whole))
    }

    /// Size found over size known of an accepted effect, with the effects free beside it that resemble it: what they could take of it is
    /// in the error. For effects of one parameter.
    pub(super) fn ratio_beside_rivals(&self, k: usize, before: &Variant, rivals: &[Rival]) -> Option<[f64; 2]> {
        let (evidence, stand) = (&self.evidence, &self.stand);
        let hypothesis = &evidence.hypotheses[self.entries[k].hypothesis];
        let variant = &hypothesis.variants[self.entries[k].variant];
        let [column] = variant.columns.as_slice() else { return None };
        let white = |entry: Entry| columns(evidence, &[entry]).map(|c| evidence.white(&stand.noise, c)).collect::<Vec<Whitened>>();
        let mut beside: Vec<Whitened> =
            self.entries.iter().enumerate().filter(|(index, _)| *index != k).flat_map(|(_, entry)| white(*entry)).collect();
        for rival in rivals.iter().filter(|rival| rival.cos > RESEMBLES && rival.cos < attribute::SAME).take(MOST_BESIDE) {
            let index = evidence.hypotheses.iter().position(|other| other.id() == rival.id)?;
            if !evidence.hypotheses[index].variants.is_empty() {
                beside.extend(white(Entry { hypothesis: index, variant: evidence.hypotheses[index].variants.len() / 2 }));
            }
        }
        let fit = Fit::new(&stand.sheet, &stand.take, &beside.iter().collect::<Vec<_>>());
        let free = Stand { fit: fit.with_noise_of(&stand.fit), more: beside, ..stand.clone() };
        let [change, sigma] = amplitude(&free, &evidence.white(&stand.noise, column))?;
        let first = *hypothesis.fitted.first()?;
        let spec = &hypothesis.effect.parameters()[first];
        let value = variant.start[first] + change - difference(hypothesis.id(), &before.start, first);
        let found = FoundParameter { name: spec.name.to_owned(), value, sigma, unit: spec.unit.to_owned() };
        known_ratio(hypothesis, &before.start, &found)
    }

    /// Values and standard errors of an accepted effect's fitted parameters.
    pub(super) fn parameters(&self, k: usize, before: &Variant) -> Vec<FoundParameter> {
        let (start, searched_sigma) = (&before.start, before.searched_sigma);
        let hypothesis = &self.evidence.hypotheses[self.entries[k].hypothesis];
        let shared: usize =
            self.entries[..k].iter().map(|entry| self.evidence.hypotheses[entry.hypothesis].variants[0].columns.len()).sum();
        let first = self.stand.sheet.camera.len() + shared;
        let covariance = self.stand.fit.covariance();
        let present = &hypothesis.variants[0].start;
        let mut all: Vec<FoundParameter> = Vec::new();
        for (j, index) in hypothesis.fitted.iter().enumerate().take(hypothesis.variants[0].columns.len()) {
            let spec = &hypothesis.effect.parameters()[*index];
            let value = present[*index] + self.stand.fit.change[first + j] - difference(hypothesis.id(), start, *index);
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
}

/// Whether a size that the recording tells beforehand is another: judged where everything is solved, what resembles the effect free beside it.
pub(super) fn amplitude_veto(before: &Evidence, stand: &Stand, entries: &[Entry], k: usize, solved: &Solved) -> Option<String> {
    let hypothesis = &before.hypotheses[entries[k].hypothesis];
    let id = hypothesis.id();
    if hypothesis.in_force && id == "proper-motion" {
        return None; // another epoch is the finding itself
    }
    let variant = &hypothesis.variants[entries[k].variant];
    if let Some((least, most)) = hypothesis.effect.natural().filter(|_| !hypothesis.in_force && hypothesis.known.is_none())
        && let Some(found) = solved.parameters(k, variant).first()
        && (found.value + DISAGREES * found.sigma < least || found.value - DISAGREES * found.sigma > most)
    {
        let size = words::with_error(found.value, found.sigma);
        return Some(format!("its size, {} = {size} {}, is none that nature has ({least} to {most})", found.name, found.unit));
    }
    let listed: Vec<Rival> = rivals(before, stand, entries, k).into_iter().map(|(rival, _)| rival).collect();
    let [ratio, error] = solved.ratio_beside_rivals(k, variant, &listed)?;
    // That what the model has is not there at all is a finding too.
    let is_absent = hypothesis.in_force && ratio.abs() <= DISAGREES * error;
    ((ratio - 1.0).abs() > DISAGREES * error && !is_absent)
        .then(|| format!("its size is {ratio:.3} ± {error:.3} of what is known of it: not {id} alone, or more than this effect"))
}

/// What the reported value counts from: zero, but for parameters that are differences from the model's value.
fn difference(id: &str, start: &[f64], index: usize) -> f64 {
    if id == "proper-motion" { start[index] } else { 0.0 }
}

/// Size found over size known, and its standard error, what is open of the known size included.
pub(super) fn known_ratio(hypothesis: &Hypothesis, start: &[f64], found: &FoundParameter) -> Option<[f64; 2]> {
    let first = *hypothesis.fitted.first()?;
    let known = if hypothesis.id() == "proper-motion" { -start[first] } else { hypothesis.known? };
    (known != 0.0).then(|| {
        let open = if matches!(hypothesis.id(), "refraction") { OPEN_SHARE } else { 0.0 };
        [found.value / known, (found.sigma / known).abs().hypot(open)]
    })
}

/// Columns of the camera's own parameters at a solution where effects are solved too.
fn camera_columns(joint: &Joint, evidence: &Evidence, options: &DiagnoseOptions) -> Vec<crate::calibrate::Column> {
    let names = joint.solved_for();
    let mut all: Vec<crate::calibrate::Column> = joint
        .solved_columns()
        .into_iter()
        .zip(&names)
        .filter(|(_, name)| options.solve.iter().any(|own| own == *name) || !name.contains('.'))
        .map(|(column, _)| column)
        .collect();
    all.extend(evidence.camera.iter().skip(names.len()).cloned());
    all
}

/// T of an accepted effect beside the others, and its degrees of freedom.
pub(super) fn statistic(evidence: &Evidence, stand: &Stand, entries: &[Entry], k: usize) -> (f64, usize) {
    let white =
        |entry: &Entry| columns(evidence, std::slice::from_ref(entry)).map(|c| evidence.white(&stand.noise, c)).collect::<Vec<Whitened>>();
    let others: Vec<Whitened> = entries.iter().enumerate().filter(|(index, _)| *index != k).flat_map(|(_, entry)| white(entry)).collect();
    let fit = Fit::new(&stand.sheet, &stand.take, &others.iter().collect::<Vec<_>>());
    let without = Stand { fit: fit.with_noise_of(&stand.fit), more: others, ..stand.clone() };
    without.score(&white(&entries[k]))
}

/// Covariates by how surprisingly residuals follow them.
fn ranked(evidence: &Evidence, stand: &Stand, scan: &Scan) -> Vec<(usize, f64, f64)> {
    let mut best: Vec<Option<(f64, f64)>> = vec![None; evidence.covariates.len()];
    for group in &scan.groups {
        let Asks::Covariate(index) = group.asks else { continue };
        let surprise = group.surprise();
        let explained = (group.statistic - group.rank as f64) / stand.fit.degrees;
        if best[index].is_none_or(|(most, _)| surprise > most) {
            best[index] = Some((surprise, explained));
        }
    }
    let mut all: Vec<(usize, f64, f64)> = best.into_iter().enumerate().filter_map(|(k, b)| b.map(|(s, e)| (k, s, e))).collect();
    all.sort_by(|a, b| b.1.total_cmp(&a.1));
    all
}

/// The covariates that residuals follow, each also with those before it taken out.
pub(super) fn located(evidence: &Evidence, stand: &Stand, scan: &Scan, chance: &Chance) -> Vec<Located> {
    let all = ranked(evidence, stand, scan);
    let mut leaders: Vec<Whitened> = Vec::new();
    let mut found = Vec::new();
    for (place, (index, surprise, explained)) in all.into_iter().enumerate() {
        let p_value = among_covariates(chance, surprise);
        if p_value > 0.05 && place > 0 {
            break;
        }
        let conditional_p_value = (place > 0 && place <= NAMED).then(|| {
            let fit = Fit::new(&stand.sheet, &stand.take, &leaders.iter().collect::<Vec<_>>());
            let beside = Stand { fit, ..stand.clone() };
            let most = evidence.covariates[index].patterns.iter().map(|pattern| {
                let own: Vec<Whitened> = pattern.iter().map(|column| evidence.white(&stand.noise, column)).collect();
                let (t, rank) = beside.score(&own);
                chi_squared_surprise(rank as f64, t)
            });
            among_covariates(chance, most.fold(0.0, f64::max))
        });
        if place < NAMED {
            let patterns = evidence.covariates[index].patterns.iter().flatten();
            leaders.extend(patterns.map(|column| evidence.white(&stand.noise, column)));
        }
        let covariate = evidence.covariates[index].name.clone();
        found.push(Located { covariate, explained: explained.max(0.0), p_value, conditional_p_value });
    }
    found
}

/// The noise, for the result.
pub(super) fn noise_state(stand: &Stand) -> NoiseState {
    let wrong = stand.take.iter().filter(|take| !**take).count() as f64 / stand.take.len().max(1) as f64;
    NoiseState {
        floor_px: stand.noise.floor_px2.sqrt(),
        variance_factor: stand.noise.factor,
        tail_degrees: if stand.noise.tail_degrees.is_finite() { stand.noise.tail_degrees } else { 1e9 },
        wrong_share: wrong,
        measured: MeasuredNoise::default(),
    }
}

/// Residuals of every star image before and after.
pub(super) fn residual_rows(evidence: &Evidence, before: &Stand, after: &Stand, points: &ControlPoints) -> Vec<ResidualRow> {
    let px = |stand: &Stand| stand.noise.unwhiten(&evidence.images, &evidence.place, &stand.everywhere());
    let (before_px, after_px) = (px(before), px(after));
    let of = |(k, image): (usize, &crate::calibrate::JointImage)| {
        let point = &points.points[image.point];
        let q = after.fit.residual[2 * k].powi(2) + after.fit.residual[2 * k + 1].powi(2);
        ResidualRow {
            point: image.point,
            frame: image.frame,
            hip: point.hip,
            x_px: point.x_px,
            y_px: point.y_px,
            before_px: [before_px[2 * k], before_px[2 * k + 1]],
            after_px: [after_px[2 * k], after_px[2 * k + 1]],
            sigma_px: after.noise.sigma_px(image, evidence.place[k]),
            weight: if after.take[k] { super::sheet::weight(after.noise.tail_degrees, q) } else { 0.0 },
        }
    };
    evidence.images.iter().enumerate().map(of).collect()
}

/// What the findings are made of.
pub(super) struct Context<'a> {
    pub(super) evidence: &'a Evidence,
    pub(super) joint: &'a Joint,
    pub(super) points: &'a ControlPoints,
    pub(super) base: &'a Stand,
    pub(super) with_all: &'a Stand,
    pub(super) entries: &'a [Entry],
    pub(super) proofs: &'a [Proof],
    pub(super) hypotheses: f64,
    pub(super) locked: bool,
}

impl Context<'_> {
    /// The model without entry `k`, all others in it.
    fn without(&self, k: usize) -> Stand {
        let others: Vec<Entry> = self.entries.iter().enumerate().filter(|(index, _)| *index != k).map(|(_, entry)| *entry).collect();
        let own: Vec<Whitened> = columns(self.evidence, &others).map(|c| self.evidence.white(&self.with_all.noise, c)).collect();
        let fit = Fit::new(&self.with_all.sheet, &self.with_all.take, &own.iter().collect::<Vec<_>>());
        Stand { fit: fit.with_noise_of(&self.with_all.fit), more: own, ..self.with_all.clone() }
    }

    /// The finding of entry `k`.
    pub(super) fn finding(&self, k: usize, solved: &Solved, options: &DiagnoseOptions) -> Finding {
        let entry = self.entries[k];
        let hypothesis = &self.evidence.hypotheses[entry.hypothesis];
        let variant = &hypothesis.variants[entry.variant];
        let parameters = solved.parameters(k, variant);
        let (t, rank) = statistic(self.evidence, self.with_all, self.entries, k);
        let p_value = p_of(t, rank);
        let without = self.without(k);
        let scan = Scan::new(self.evidence, &without.noise, &without.sheet, &without.fit, |_| false);
        let chance = scan.chance(&without.fit, &without.take, options.seed ^ 0x0010_ca7e, 0, options.nulls.min(200));
        let mut located_by: Vec<String> = Vec::new();
        for (index, surprise, _) in ranked(self.evidence, &without, &scan) {
            if located_by.is_empty() || (located_by.len() < NAMED && among_covariates(&chance, surprise) < LOCATES_P) {
                located_by.push(self.evidence.covariates[index].name.clone());
            }
        }
        let listed = rivals(self.evidence, self.with_all, self.entries, k);
        let set: Vec<String> = listed.iter().filter(|(_, in_set)| *in_set).map(|(rival, _)| rival.id.clone()).collect();
        let magnitudes: Vec<f64> = self.evidence.images.iter().map(|image| self.points.points[image.point].magnitude).collect();
        let mean = magnitudes.iter().sum::<f64>() / magnitudes.len().max(1) as f64;
        let faintness: Vec<f64> = magnitudes.iter().map(|m| m - mean).collect();
        let nearest = set.first().or_else(|| listed.first().map(|(rival, _)| &rival.id));
        let rival = nearest.and_then(|id| self.evidence.hypotheses.iter().position(|hypothesis| hypothesis.id() == id));
        let decided = rival.and_then(|index| {
            let other = Entry { hypothesis: index, variant: self.evidence.hypotheses[index].variants.len() / 2 };
            decided_by(self.evidence, self.with_all, self.joint, [entry, other], &faintness)
        });
        let proof = self.proofs.get(k).copied().unwrap_or_default();
        let mut finding = Finding {
            id: hypothesis.id().to_owned(),
            known_amplitude: None,
            parameters,
            located_by,
            delta_chi2: attribute::fall(self.with_all, &without.fit, &self.with_all.fit),
            p_value,
            family_p_value: family(p_value, self.hypotheses),
            held_out_delta_chi2: proof.delta_chi2,
            held_out_expected: proof.expected,
            held_out_score: proof.score,
            snr: (t - rank as f64 + 1.0).max(0.0).sqrt(),
            indistinguishable_from: set,
            rivals: listed.into_iter().map(|(rival, _)| rival).collect(),
            decided_by: decided.unwrap_or_else(|| "nothing stands beside it that would have to be decided from".to_owned()),
            sentence: String::new(),
        };
        finding.known_amplitude = solved.ratio_beside_rivals(k, variant, &finding.rivals);
        finding.sentence = words::finding(&finding, hypothesis.effect, hypothesis.in_force, self.locked);
        finding
    }

    /// The status of every effect of the registry.
    pub(super) fn effects(&self, solved: &Solved, found: &[Finding], kept: &[Entry]) -> Vec<EffectStatus> {
        let sets: Vec<&String> = found.iter().flat_map(|finding| &finding.indistinguishable_from).collect();
        let all = vec![true; self.evidence.images.len()];
        let stand = Stand::new(self.evidence, &all, kept, &solved.stand.noise);
        let of = |(index, hypothesis): (usize, &Hypothesis)| {
            let id = hypothesis.id().to_owned();
            let mut status = EffectStatus {
                id: id.clone(),
                status: EffectState::NotFound,
                p_value: None,
                survival: None,
                parameters: Vec::new(),
                upper_limit_95: None,
                reason: String::new(),
            };
            if let Some(reason) = &hypothesis.missing {
                status.status = EffectState::NotApplicable;
                status.reason.clone_from(reason);
                return status;
            }
            // At its best variant, beside what was found.
            let own = |variant: usize| {
                let entry = Entry { hypothesis: index, variant };
                columns(self.evidence, &[entry]).map(|c| self.evidence.white(&stand.noise, c)).collect::<Vec<Whitened>>()
            };
            let scored = (0..hypothesis.variants.len()).map(|variant| (variant, stand.score(&own(variant))));
            let best = scored.max_by(|a, b| a.1.0.total_cmp(&b.1.0));
            let Some((variant, (t, rank))) = best else { return status };
            let white = own(variant);
            // Beside camera and attitudes alone, and in their units: with other noise nothing would be taken up in full.
            let entry = Entry { hypothesis: index, variant };
            let bare: Vec<Whitened> =
                columns(self.evidence, &[entry]).map(|column| self.evidence.white(&self.base.noise, column)).collect();
            status.survival = Some(attribute::survival(self.base, &bare));
            if let Some(finding) = found.iter().find(|finding| finding.id == id) {
                status.status = EffectState::Found;
                status.p_value = Some(finding.p_value);
                status.parameters.clone_from(&finding.parameters);
                return status;
            }
            let searched = hypothesis.variants.len() as f64;
            status.p_value = (rank > 0).then(|| (p_of(t, rank) * searched.sqrt()).min(1.0));
            let moves = white.iter().any(|column| stand.fit.length_squared(column) > 0.0);
            if !moves {
                status.status = EffectState::NotObservable;
                "what it depends on does not vary or is not known: it moves no star image here".clone_into(&mut status.reason);
                return status;
            }
            let start = &hypothesis.variants[variant].start;
            let first = hypothesis.fitted[0];
            let spec = &hypothesis.effect.parameters()[first];
            // The other parameters of the effect are free beside the first.
            let rest: Vec<&Whitened> = stand.more.iter().chain(white.iter().skip(1)).collect();
            let fit =
                if white.len() > 1 { Fit::new(&stand.sheet, &stand.take, &rest).with_noise_of(&stand.fit) } else { stand.fit.clone() };
            let beside = Stand { fit, ..stand.clone() };
            if let Some([change, sigma]) = amplitude(&beside, &white[0]) {
                let value = start[first] + change - difference(&id, start, first);
                status.parameters.push(FoundParameter { name: spec.name.to_owned(), value, sigma, unit: spec.unit.to_owned() });
                status.upper_limit_95 =
                    Some(Limit { name: spec.name.to_owned(), value: value.abs() + 1.645 * sigma, unit: spec.unit.to_owned() });
                if sigma.is_nan() || sigma > spec.range.1 - spec.range.0 {
                    status.upper_limit_95 = None;
                }
            }
            if sets.contains(&&id) {
                status.status = EffectState::Indistinguishable;
                let of: Vec<&str> = found.iter().filter(|f| f.indistinguishable_from.contains(&id)).map(|f| f.id.as_str()).collect();
                status.reason = format!("explains about as much as {}", of.join(", "));
            } else if status.survival.is_some_and(|survival| survival < UNOBSERVABLE) {
                status.status = EffectState::NotObservable;
                "attitudes and camera parameters take it up".clone_into(&mut status.reason);
            } else if status.survival.is_some_and(|survival| survival < WEAKLY) && !usual_shows(hypothesis, &stand, &white) {
                status.status = EffectState::NotObservable;
                "attitudes and camera parameters take up most of it, and of one of usual size the rest would not show"
                    .clone_into(&mut status.reason);
            } else if hypothesis.in_force {
                "in the model; its size there is confirmed within the errors".clone_into(&mut status.reason);
            }
            status
        };
        self.evidence.hypotheses.iter().enumerate().map(of).collect()
    }

    /// Data for a picture of each finding: residuals against the covariate that located it.
    pub(super) fn profiles(&self, standing: &[usize], found: &[Finding]) -> Vec<Profile> {
        standing.iter().zip(found).filter_map(|(k, finding)| super::profile::profile(self, *k, &finding.located_by)).collect()
    }

    /// The covariates that residuals without entry `k` follow, the most surprising first.
    pub(super) fn located_names(&self, k: usize) -> Vec<String> {
        let without = self.without(k);
        let scan = Scan::new(self.evidence, &without.noise, &without.sheet, &without.fit, |_| false);
        ranked(self.evidence, &without, &scan).into_iter().map(|(index, ..)| self.evidence.covariates[index].name.clone()).collect()
    }
}

//! The diagnosis from end to end.

use std::time::Instant;

use super::adequacy::{concentration, superseded, vetoes};
use super::attribute::{self, Entry, Stand, candidates, select};
use super::chance::independent;
use super::diagnosis::{ChannelTest, Channels, Diagnosis, FORMAT, Finding, Fit, FitQuality, LockBox, StarsUsed, Verdict};
use super::evidence::Evidence;
use super::findings::{self, Solved};
use super::halves::half_nights;
use super::hypotheses::finer;
use super::noise::NoiseModel;
use super::omnibus::{Effort, omnibus};
use super::prove::{Proof, folds, held_out_quality, locked_away, prove};
use super::scan::Scan;
use super::sheet::Whitened;
use super::{DiagnoseError, DiagnoseOptions, Telemetry, left, words};
use crate::calibrate::{CalibrateOptions, GivenNoise, Joint};
use crate::camera::Term;
use crate::identify::ControlPoints;
use crate::statistics::significance::chi_squared_surprise;

/// Halvings of the search over places and lengths.
const REFINEMENTS: usize = 5;
/// Fewer numbers beyond the parameters say nothing.
const FEWEST_DEGREES: f64 = 20.0;

/// See [`super::diagnose`].
pub(super) fn diagnose(points: &ControlPoints, telemetry: &Telemetry, options: &DiagnoseOptions) -> Result<Diagnosis, DiagnoseError> {
    let started = Instant::now();
    let solve = CalibrateOptions {
        solve: options.solve.clone(),
        leave_out_imprecise: false,
        proper_motion_only: options.proper_motion_only,
        held_out: false,
        physics: options.physics.clone(),
        terms: options.terms.clone(),
        ..CalibrateOptions::default()
    };
    let joint = Joint::solve(points, &solve)?;
    let evidence = Evidence::at(&joint, points, telemetry, options);
    let too_few = DiagnoseError::TooFew { images: evidence.images.len(), frames: evidence.frames.len() };
    let locked = locked_away(evidence.frames.len(), hash(points));
    let all = vec![true; evidence.images.len()];
    let training: Vec<bool> = evidence.place.iter().map(|place| !locked.contains(place)).collect();
    let begin = NoiseModel::stated(evidence.frame_factors.clone());
    let stand = Stand::new(&evidence, &training, &[], &begin);
    if stand.fit.degrees < FEWEST_DEGREES {
        return Err(too_few);
    }
    let scan = Scan::new(&evidence, &stand.noise, &stand.sheet, &stand.fit, |_| true);
    let mut first = omnibus(&evidence, &stand, &scan, options, (1, options.alpha, Effort::Whole));
    let hypotheses = independent(&first.chance.hypotheses);
    let threshold = (2.0 * hypotheses / options.alpha).ln();
    let mut located = findings::located(&evidence, &stand, &scan, &first.chance);
    let mut warnings: Vec<String> = joint.notes().to_vec();

    let base = Stand::new(&evidence, &all, &[], &begin);

    // Found on the training part; whoever the lock-box does not confirm goes. What shows on all frames only is proved frame by frame.
    let (mut entries, mut on_training) = (Vec::new(), stand);
    let (mut locked, mut training) = (locked, training);
    let mut significant = first.p_value < options.alpha;
    if !significant && !locked.is_empty() {
        let scan = Scan::new(&evidence, &base.noise, &base.sheet, &base.fit, |_| true);
        let second = omnibus(&evidence, &base, &scan, options, (5, options.alpha / 2.0, Effort::Decide));
        if second.p_value < options.alpha / 2.0 {
            significant = true;
            located = findings::located(&evidence, &base, &scan, &second.chance);
            first = second;
            (locked, training) = (Vec::new(), all.clone());
        }
    }
    if significant {
        (entries, on_training) = select(&evidence, &training, &begin, threshold);
    }
    let mut evidence = evidence;
    if !entries.is_empty() {
        refine(&mut evidence, &joint, &mut entries, &training, &begin);
        on_training = Stand::new(&evidence, &training, &entries, &begin);
    }
    let tests = folds(&evidence, &locked);
    let mut proofs = proofs(&evidence, &on_training, &entries, &tests);
    let mut rejected: Vec<usize> = Vec::new();
    let mut unproven: Vec<(Entry, Vec<String>)> = Vec::new();
    loop {
        if proofs.iter().any(|proof| proof.powerless && !proof.confirms) && tests.len() == 1 {
            // The locked frames hold too little of it: every frame in its turn decides.
            let turns = folds(&evidence, &[]);
            let stand = Stand::new(&evidence, &all, &entries, &begin);
            for (k, own) in proofs.iter_mut().enumerate().filter(|(_, own)| own.powerless && !own.confirms) {
                *own = proof(&evidence, &stand, &entries, k, &turns);
            }
        }
        // The least of those that do not stand goes, and the others are asked anew: beside it they may not have been needed.
        let weakest =
            (0..entries.len()).filter(|k| !proofs[*k].confirms).min_by(|a, b| proofs[*a].expected.total_cmp(&proofs[*b].expected));
        let Some(weakest) = weakest else { break };
        let Proof { delta_chi2: held, expected, .. } = proofs[weakest];
        let entry = entries.remove(weakest);
        let id = evidence.hypotheses[entry.hypothesis].id();
        warnings.push(format!(
            "{id} was found on the training part and not confirmed on the held-out one (χ² falls by {held:.1} where {expected:.1} is expected): it is not claimed"
        ));
        rejected.push(entry.hypothesis);
        unproven.push((
            entry,
            vec![format!("frames that were not used do not confirm it (χ² falls by {held:.1} where {expected:.1} is expected)")],
        ));
        on_training = Stand::new(&evidence, &training, &entries, &begin);
        proofs = self::proofs(&evidence, &on_training, &entries, &tests);
    }
    // All frames: what was found, solved anew with everything free, and with the search made finer.
    let mut refined = evidence;
    refine(&mut refined, &joint, &mut entries, &all, &begin);
    let mut solved = if entries.is_empty() {
        Solved::unchanged(&joint, &refined, &base)
    } else {
        Solved::new(&joint, points, telemetry, options, &refined, &entries)?
    };
    // Where nothing shows nothing can be left: it is not asked for.
    let mut final_scan = significant.then(|| solved.scan());
    let mut final_omnibus = final_scan.as_ref().map(|scan| solved.omnibus(scan, options, 2));
    if final_omnibus.as_ref().is_some_and(|test| test.p_value < options.alpha) {
        // More may show on all frames than did on a part of them; it is proved frame by frame.
        let more = solved.more(&refined, &entries, &rejected, threshold);
        if more.len() > entries.len() {
            let stand = Stand::new(&refined, &all, &more, &begin);
            let turns = folds(&refined, &[]);
            let late: Vec<Proof> = (0..more.len()).map(|k| proof(&refined, &stand, &more, k, &turns)).collect();
            let kept: Vec<usize> = (0..more.len()).filter(|k| *k < entries.len() || late[*k].confirms).collect();
            if kept.len() > entries.len() {
                proofs = kept.iter().map(|k| if *k < entries.len() { proofs[*k] } else { late[*k] }).collect();
                entries = kept.iter().map(|k| more[*k]).collect();
                refine(&mut refined, &joint, &mut entries, &all, &begin);
                solved = Solved::new(&joint, points, telemetry, options, &refined, &entries)?;
                final_scan = Some(solved.scan());
                final_omnibus = final_scan.as_ref().map(|scan| solved.omnibus(scan, options, 3));
            }
        }
    }

    // Names that do not stand.
    let with_all = if entries.is_empty() { base.clone() } else { Stand::new(&refined, &all, &entries, &begin) };
    let something_remains = !entries.is_empty() && final_omnibus.as_ref().is_some_and(|test| test.p_value < options.alpha);
    let is_free = |index: usize| entries.iter().all(|entry| entry.hypothesis != index);
    let linear_scan = something_remains.then(|| Scan::new(&refined, &with_all.noise, &with_all.sheet, &with_all.fit, is_free));
    let mut veto: Vec<(usize, Vec<String>)> = Vec::new();
    for k in 0..entries.len() {
        let statistic = findings::statistic(&refined, &with_all, &entries, k).0;
        let mut against = Vec::new();
        if let Some(scan) = &final_scan {
            against.extend(vetoes(&solved.evidence, &solved.stand, scan, &solved.entries, k, statistic));
        }
        against.extend(concentration(&refined, points, &with_all, &entries, k));
        against.extend(findings::amplitude_veto(&refined, &with_all, &entries, k, &solved));
        if let Some(scan) = &linear_scan {
            against.extend(superseded(&refined, &with_all, scan, &entries, k, threshold));
        }
        if !against.is_empty() {
            veto.push((k, against));
        }
    }
    let vetoed = veto.iter().map(|(k, against)| (entries[*k], against.clone()));
    let resembling: Vec<(Entry, Vec<String>)> = vetoed.chain(unproven).collect();
    let standing: Vec<usize> = (0..entries.len()).filter(|k| veto.iter().all(|(vetoed, _)| vetoed != k)).collect();

    let context = findings::Context {
        evidence: &refined,
        joint: &joint,
        points,
        base: &base,
        with_all: &with_all,
        entries: &entries,
        proofs: &proofs,
        hypotheses,
        locked: !locked.is_empty(),
    };
    let found: Vec<Finding> = standing.iter().map(|k| context.finding(*k, &solved, options)).collect();
    let kept: Vec<Entry> = standing.iter().map(|k| entries[*k]).collect();
    // What is left has to be significant on all frames, however the training part fell out.
    let everything = if kept == entries { with_all.clone() } else { Stand::new(&refined, &all, &kept, &begin) };
    let rest = if veto.is_empty() {
        final_omnibus
    } else {
        let scan =
            Scan::new(&refined, &everything.noise, &everything.sheet, &everything.fit, |index| kept.iter().all(|e| e.hypothesis != index));
        Some(omnibus(&refined, &everything, &scan, options, (4, options.alpha, Effort::Whole)))
    };
    let left = rest.as_ref().filter(|rest| rest.p_value < options.alpha);
    let something_left = left.is_some();
    let unknown = left.map(|rest| left::unknown(&refined, &everything, &resembling, rest, &joint, &tests));
    let verdict = match (found.is_empty(), something_left) {
        (_, true) => Verdict::Unexplained,
        (false, false) => Verdict::Explained,
        (true, false) => Verdict::Consistent,
    };
    if let Some(rest) = rest.as_ref().filter(|_| verdict == Verdict::Consistent) {
        warnings.push(format!(
            "the training part alone looks inconsistent (p = {:.1e}, {}), all frames together do not (p = {:.1e}): taken for chance",
            first.p_value, first.largest, rest.p_value
        ));
    }
    let effects = context.effects(&solved, &found, &kept);
    let profiles = context.profiles(&standing, &found);
    let fit = Fit {
        baseline: quality(&refined, &base, &solved.stand.noise, &[], &tests),
        after: quality(&refined, &everything, &solved.stand.noise, &kept, &tests),
    };
    let largest = if first.largest.is_empty() { "nothing".to_owned() } else { first.largest.clone() };
    let mut diagnosis = Diagnosis {
        format: FORMAT.to_owned(),
        verdict,
        physics: options.physics.clone(),
        findings: found,
        unknown,
        effects,
        fit,
        channels: Channels { astrometry: Some(ChannelTest { p_value: first.p_value, largest }), ..Channels::default() },
        stars_used: stars_used(&refined, points, &everything),
        located,
        noise: findings::noise_state(&solved.stand),
        lock_box: LockBox {
            kind: if locked.is_empty() { "leave-one-out" } else { "blocks" }.to_owned(),
            frames: locked.iter().map(|place| refined.frames[*place].0).collect(),
        },
        nulls: first.chance.nulls,
        resimulated_p_value: rest.as_ref().map(|rest| rest.p_value),
        half_nights: half_nights(&solved, options),
        effective_hypotheses: hypotheses,
        summary: Vec::new(),
        warnings,
        camera: Some(solved.joint.model().clone()),
        residuals: findings::residual_rows(&refined, &base, &everything, points),
        profiles,
        seconds: 0.0,
        provenance: None,
    };
    diagnosis.summary = words::summary(&diagnosis, rest.map_or(1.0, |rest| rest.p_value));
    diagnosis.seconds = started.elapsed().as_secs_f64();
    Ok(diagnosis)
}

fn proof(evidence: &Evidence, stand: &Stand, entries: &[Entry], k: usize, tests: &[Vec<bool>]) -> Proof {
    let (t, rank) = findings::statistic(evidence, stand, entries, k);
    prove(evidence, stand, entries, k, tests, t, rank)
}

fn proofs(evidence: &Evidence, stand: &Stand, entries: &[Entry], tests: &[Vec<bool>]) -> Vec<Proof> {
    (0..entries.len()).map(|k| proof(evidence, stand, entries, k, tests)).collect()
}

/// Makes the search over places and lengths finer about what was found, and tells how well it is known.
fn refine(evidence: &mut Evidence, joint: &Joint, entries: &mut [Entry], all: &[bool], begin: &NoiseModel) {
    for k in 0..entries.len() {
        let others: Vec<Entry> = entries.iter().enumerate().filter(|(index, _)| *index != k).map(|(_, entry)| *entry).collect();
        let hypothesis = entries[k].hypothesis;
        if evidence.hypotheses[hypothesis].searched.is_none() {
            continue;
        }
        let stand = Stand::new(evidence, all, &others, begin);
        let mut seen: Vec<(f64, f64)> = Vec::new();
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
                let entry = Entry { hypothesis, variant };
                let own: Vec<Whitened> =
                    attribute::columns(evidence, &[entry]).map(|column| evidence.white(&stand.noise, column)).collect();
                stand.score(&own).0
            };
            let from = if step == 0 { 0 } else { at };
            let options: Vec<(f64, usize)> =
                std::iter::once(entries[k].variant).chain(from..at + count).map(|variant| (score(variant), variant)).collect();
            seen.extend(options.iter().filter_map(|(t, variant)| Some((evidence.hypotheses[hypothesis].searched_value(*variant)?, *t))));
            if let Some((_, variant)) = options.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)) {
                entries[k].variant = variant;
            }
        }
        if let Some(here) = evidence.hypotheses[hypothesis].searched_value(entries[k].variant).filter(|_| !seen.is_empty()) {
            let most = seen.iter().map(|(_, t)| *t).fold(0.0, f64::max);
            // Half of how far T stays within 4 of its largest (two standard errors, other places as good included). Where it falls lies between
            // two places tried, the last within and the first beyond: halfway.
            let reach = |sign: f64| {
                let on_this_side = |within: bool| {
                    let of = move |(value, t): &(f64, f64)| ((*t > most - 4.0) == within).then_some(sign * (value - here));
                    seen.iter().filter_map(of).filter(|distance| *distance >= 0.0)
                };
                let last = on_this_side(true).fold(0.0, f64::max);
                let beyond = on_this_side(false).filter(|distance| *distance > last).fold(f64::INFINITY, f64::min);
                if beyond.is_finite() { f64::midpoint(last, beyond) } else { last }
            };
            let sigma = 0.5 * reach(1.0).max(reach(-1.0));
            evidence.hypotheses[hypothesis].variants[entries[k].variant].searched_sigma = Some(sigma).filter(|sigma| *sigma > 0.0);
        }
    }
}

impl Solved {
    /// Effects that all frames show beside those found, the found ones first.
    fn more(&self, evidence: &Evidence, entries: &[Entry], rejected: &[usize], threshold: f64) -> Vec<Entry> {
        let mut more = entries.to_vec();
        let all = vec![true; evidence.images.len()];
        for _ in 0..4 {
            let stand = Stand::new(evidence, &all, &more, &self.stand.noise);
            let scan = Scan::hypotheses(evidence, &stand.noise, &stand.sheet, &stand.fit, |index| {
                !rejected.contains(&index) && more.iter().all(|e| e.hypothesis != index)
            });
            let mut found = candidates(evidence, &stand, &scan, threshold);
            found.retain(|candidate| candidate.surprise > threshold + attribute::searched(evidence, candidate));
            found.retain(|candidate| attribute::is_observable(evidence, &stand, candidate.entry));
            let Some(entry) = attribute::choose(evidence, &stand, &found) else { break };
            more.push(entry);
        }
        more
    }
}

/// How well a model does, with the noise of the final one.
fn quality(evidence: &Evidence, stand: &Stand, noise: &NoiseModel, entries: &[Entry], tests: &[Vec<bool>]) -> FitQuality {
    let residual_px = stand.noise.unwhiten(&evidence.images, &evidence.place, &stand.fit.residual);
    let used: Vec<usize> = (0..evidence.images.len()).filter(|k| stand.take[*k]).collect();
    let square: f64 = used.iter().map(|k| residual_px[2 * k].powi(2) + residual_px[2 * k + 1].powi(2)).sum();
    let white: Whitened = {
        let pairs = residual_px.chunks_exact(2).map(|pair| [pair[0], pair[1]]).collect();
        evidence.white(noise, &pairs)
    };
    let (psi, _) = super::descent::psi_of(&white, &stand.take, noise.tail_degrees);
    let held = {
        let judged = Stand { noise: noise.clone(), sheet: evidence.sheet(noise), ..stand.clone() };
        held_out_quality(evidence, &judged, entries, tests)
    };
    FitQuality {
        rms_px: (square / used.len().max(1) as f64).sqrt(),
        chi2_per_dof: super::sheet::dot(&psi, &white) / stand.fit.degrees,
        held_out_rms_px: held.map(|(_, rms)| rms),
        held_out_chi2_per_dof: held.map(|(chi, _)| chi),
    }
}

fn stars_used(evidence: &Evidence, points: &ControlPoints, stand: &Stand) -> StarsUsed {
    let mut used = StarsUsed { left_out: points.points.len() - stand.take.iter().filter(|take| **take).count(), ..StarsUsed::default() };
    for (image, _) in evidence.images.iter().zip(&stand.take).filter(|(_, take)| **take) {
        if points.points[image.point].has_proper_motion {
            used.with_proper_motion += 1;
        } else {
            used.without += 1;
        }
    }
    used
}

/// A number that depends on the recording alone: which blocks are locked away.
fn hash(points: &ControlPoints) -> u64 {
    let mut state = 0xcbf2_9ce4_8422_2325_u64;
    for point in &points.points {
        for bits in [point.x_px.to_bits(), point.y_px.to_bits()] {
            state = (state ^ bits).wrapping_mul(0x0100_0000_01b3);
        }
    }
    state ^ (state >> 29)
}

/// The joint solution with the findings in force, errors and weights as the diagnosis has them.
pub(super) fn solve_again(
    joint: &Joint,
    options: &DiagnoseOptions,
    evidence: &Evidence,
    stand: &Stand,
    terms: &[Term],
    names: &[String],
) -> Result<Joint, DiagnoseError> {
    let mut solve = options.solve.clone();
    solve.extend(names.iter().cloned());
    let weights = (0..evidence.images.len())
        .map(|k| {
            let q = stand.fit.residual[2 * k].powi(2) + stand.fit.residual[2 * k + 1].powi(2);
            if stand.take[k] { super::sheet::weight(stand.noise.tail_degrees, q) } else { 0.0 }
        })
        .collect();
    let factors = stand.noise.frame_factors.iter().map(|factor| factor * stand.noise.factor);
    // The floor is inside the factors in the joint method: Σ = κ·(stated + φ).
    let floor_px2 = stand.noise.floor_px2 / stand.noise.factor;
    let noise = GivenNoise { floor_px2, factors: factors.collect(), weights };
    Ok(joint.again(terms, &solve, &noise)?)
}

/// p-value of a statistic of so many degrees of freedom.
pub(super) fn p_of(t: f64, rank: usize) -> f64 {
    (-chi_squared_surprise(rank as f64, t)).exp()
}

/// p-value once all hypotheses are counted.
pub(super) fn family(p: f64, hypotheses: f64) -> f64 {
    -(hypotheses * (-p).ln_1p()).exp_m1()
}

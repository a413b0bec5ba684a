//! The diagnosis from end to end.

use std::sync::Arc;
use std::time::Instant;

use super::adequacy::{amplitude_veto, concentration, disagreement, superseded, vetoes};
use super::attribute::{Entry, Stand, select};
use super::chance::independent;
use super::confirm::{Confirmation, Withheld, proof};
use super::diagnosis::{ChannelTest, Channels, Diagnosis, FORMAT, Finding, Fit, LockBox, Verdict};
use super::evidence::Evidence;
use super::findings;
use super::halves::half_nights;
use super::located::located;
use super::noise::NoiseModel;
use super::omnibus::{Effort, Omnibus, omnibus};
use super::permute::{Deals, deal};
use super::prove::{LOCK_BOX_FROM, Proof, folds, locked_away};
use super::quality::{noise_state, quality, residual_rows, stars_used};
use super::refine::refine;
use super::rendered::{self, Rendered};
use super::resimulate::{DIFFERS, resimulate};
use super::scan::Scan;
use super::signs::sign_test;
use super::solved::Solved;
use super::{DiagnoseError, DiagnoseOptions, Step, Telemetry, left, words};
use crate::calibrate::{CalibrateOptions, Joint};
use crate::identify::ControlPoints;
use crate::statistics::significance::chi_squared_surprise;

/// Fewer numbers beyond the parameters say nothing.
const FEWEST_DEGREES: f64 = 20.0;

/// See [`super::diagnose`].
pub(super) fn diagnose(
    points: &ControlPoints,
    telemetry: &Telemetry,
    options: &DiagnoseOptions,
    tell: &dyn Fn(Step),
) -> Result<Diagnosis, DiagnoseError> {
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
    tell(Step::Baseline);
    let joint = Joint::solve(points, &solve)?;
    let columns = Rendered::new(&Evidence::without_hypotheses(&joint), &joint, points, options.looks.as_ref());
    let evidence = Evidence::at(&joint, points, telemetry, options, Arc::new(columns));
    let too_few = DiagnoseError::TooFew { images: evidence.images.len(), frames: evidence.frames.len() };
    let locked = locked_away(evidence.frames.len(), hash(points));
    let all = vec![true; evidence.images.len()];
    let training: Vec<bool> = evidence.place.iter().map(|place| !locked.contains(place)).collect();
    let begin = NoiseModel::stated(evidence.frame_factors.clone());
    let stand = Stand::new(&evidence, &training, &[], &begin);
    if stand.fit.degrees < FEWEST_DEGREES {
        return Err(too_few);
    }
    tell(Step::Omnibus);
    let scan = Scan::new(&evidence, &stand.noise, &stand.sheet, &stand.fit, |_| true);
    let mut first = omnibus(&evidence, &stand, &scan, options, (1, options.alpha, Effort::Whole));
    let hypotheses = independent(&first.chance.hypotheses);
    let threshold = (2.0 * hypotheses / options.alpha).ln();
    let mut warnings: Vec<String> = joint.notes().to_vec();
    warnings.extend(rendered::left_out(&evidence, options.looks.as_ref()));
    let base = Stand::new(&evidence, &all, &[], &begin);
    let (mut locked, mut training) = (locked, training);
    let mut significant = first.p_value < options.alpha;
    let follows = |stand: &Stand, scan: &Scan, test: &Omnibus, significant: bool| {
        let deals = if significant { deal(&evidence, stand, scan, options.seed) } else { Deals::default() };
        located(&evidence, stand, scan, &test.chance, &deals)
    };
    let mut follows_now = follows(&stand, &scan, &first, significant);
    if !significant && !locked.is_empty() {
        // What shows on all frames only is proved frame by frame.
        let scan = Scan::new(&evidence, &base.noise, &base.sheet, &base.fit, |_| true);
        let second = omnibus(&evidence, &base, &scan, options, (5, options.alpha / 2.0, Effort::Decide));
        if second.p_value < options.alpha / 2.0 {
            significant = true;
            follows_now = follows(&base, &scan, &second, true);
            first = second;
            (locked, training) = (Vec::new(), all.clone());
        }
    }
    // Found on the training part; whoever the lock-box does not confirm goes.
    tell(Step::Attribution);
    let mut entries = if significant { select(&evidence, &training, &begin, threshold).0 } else { Vec::new() };
    let mut refined = evidence.clone();
    refine(&mut refined, &joint, &mut entries, &training, &begin);
    tell(Step::Proof);
    let tests = folds(&refined, &locked);
    // Few frames leave no part to lock away: each is left out in its turn, and the choice is made again without it.
    let repeated = (refined.frames.len() < LOCK_BOX_FROM && !entries.is_empty()).then_some(threshold);
    let (mut proofs, unproven, mut chosen_again) = {
        let confirmation = Confirmation::new(&refined, &training, &tests, &begin, repeated);
        let (proofs, unproven, said) = confirmation.confirm(&mut entries);
        warnings.extend(said);
        let again: Vec<Option<[usize; 2]>> = entries.iter().map(|entry| confirmation.chosen_again(*entry)).collect();
        (proofs, unproven, again)
    };
    // All frames: what was found, solved anew with everything free, and with the search made finer.
    tell(Step::Solution);
    refine(&mut refined, &joint, &mut entries, &all, &begin);
    let mut solved = if entries.is_empty() {
        Solved::unchanged(&joint, &refined, &base)
    } else {
        Solved::new(&joint, points, telemetry, options, &refined, &entries)?
    };
    tell(Step::Remainder);
    // Where nothing shows nothing can be left: it is not asked for.
    let mut final_scan = significant.then(|| solved.scan());
    let mut final_omnibus = final_scan.as_ref().map(|scan| solved.omnibus(scan, options, 2));
    if final_omnibus.as_ref().is_some_and(|test| test.p_value < options.alpha) {
        // More may show on all frames than did on a part of them; it is proved frame by frame.
        let rejected: Vec<usize> = unproven.iter().map(|(entry, _)| entry.hypothesis).collect();
        let more = solved.more(&refined, &entries, &rejected, threshold);
        if more.len() > entries.len() {
            let stand = Stand::new(&refined, &all, &more, &begin);
            let turns = folds(&refined, &[]);
            let late: Vec<Proof> = (0..more.len()).map(|k| proof(&refined, &stand, &more, k, &turns, None)).collect();
            let kept: Vec<usize> = (0..more.len()).filter(|k| *k < entries.len() || late[*k].confirms).collect();
            if kept.len() > entries.len() {
                proofs = kept.iter().map(|k| if *k < entries.len() { proofs[*k] } else { late[*k] }).collect();
                entries = kept.iter().map(|k| more[*k]).collect();
                chosen_again.resize(entries.len(), None);
                refine(&mut refined, &joint, &mut entries, &all, &begin);
                solved = Solved::new(&joint, points, telemetry, options, &refined, &entries)?;
                final_scan = Some(solved.scan());
                final_omnibus = final_scan.as_ref().map(|scan| solved.omnibus(scan, options, 3));
            }
        }
    }

    // Names that do not stand.
    tell(Step::Adequacy);
    let with_all = if entries.is_empty() { base.clone() } else { Stand::new(&refined, &all, &entries, &begin) };
    let something_remains = !entries.is_empty() && final_omnibus.as_ref().is_some_and(|test| test.p_value < options.alpha);
    let is_free = |index: usize| entries.iter().all(|entry| entry.hypothesis != index);
    let linear_scan = something_remains.then(|| Scan::new(&refined, &with_all.noise, &with_all.sheet, &with_all.fit, is_free));
    let signs: Vec<_> = (0..entries.len()).map(|k| sign_test(&refined, &with_all, &entries, k, options.seed)).collect();
    let simulated = |entries: &[Entry], solved: &Solved| {
        (!entries.is_empty()).then(|| resimulate(&joint, &refined, entries, solved, &first.chance, options)).flatten()
    };
    let anew = simulated(&entries, &solved);
    let own_anew = anew.as_ref().map_or_else(Vec::new, |anew| anew.own_p.clone());
    let mut veto: Vec<(usize, Vec<String>)> = Vec::new();
    for (k, agreement) in signs.iter().enumerate() {
        let statistic = findings::statistic(&refined, &with_all, &entries, k).0;
        let mut against = Vec::new();
        if let Some(scan) = &final_scan {
            against.extend(vetoes(&solved.evidence, &solved.stand, scan, &solved.entries, k, statistic));
        }
        against.extend(concentration(&refined, points, &with_all, &entries, k));
        against.extend(amplitude_veto(&refined, &with_all, &entries, k, &solved));
        against.extend(disagreement(agreement));
        if let Some(p) = own_anew.get(k).filter(|p| **p < DIFFERS) {
            against.push(format!("the recording simulated anew with it does not look the same (p = {p:.1e})"));
        }
        if let Some(scan) = &linear_scan {
            against.extend(superseded(&refined, &with_all, scan, &entries, k, threshold));
        }
        if !against.is_empty() {
            veto.push((k, against));
        }
    }
    let vetoed = veto.iter().map(|(k, against)| (entries[*k], against.clone()));
    let resembling: Vec<Withheld> = vetoed.chain(unproven).collect();
    let standing: Vec<usize> = (0..entries.len()).filter(|k| veto.iter().all(|(vetoed, _)| vetoed != k)).collect();

    tell(Step::Findings);
    let context = findings::Context {
        evidence: &refined,
        joint: &joint,
        points,
        base: &base,
        with_all: &with_all,
        entries: &entries,
        proofs: &proofs,
        signs: &signs,
        chosen_again: &chosen_again,
        resimulated: &own_anew,
        tests: &tests,
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
    let anew = if veto.is_empty() || kept.is_empty() {
        anew.filter(|_| !kept.is_empty())
    } else {
        simulated(&kept, &Solved::new(&joint, points, telemetry, options, &refined, &kept)?)
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
    if let Some(anew) = anew.as_ref().filter(|anew| verdict == Verdict::Explained && anew.p_value < DIFFERS) {
        warnings.push(format!(
            "a recording simulated anew with what was found differs from this one by more than chance would have it (p = {:.1e}): something small may be left",
            anew.p_value
        ));
    }
    let effects = context.effects(&solved, &found, &kept);
    let profiles = context.profiles(&standing, &found);
    let fit = Fit {
        baseline: quality(&refined, &base, &solved.stand.noise, &[], &tests),
        after: quality(&refined, &everything, &solved.stand.noise, &kept, &tests),
    };
    if options.half_nights > 0 {
        tell(Step::HalfNights);
    }
    let half_nights = half_nights(&solved, options);
    if options.half_nights > 0 && half_nights.is_none() {
        let frames = refined.frames.len();
        warnings.push(format!("--half-nights was not answered: {frames} frames have too few different halves"));
    }
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
        located: follows_now,
        noise: noise_state(&solved.stand),
        lock_box: LockBox {
            kind: if locked.is_empty() { "leave-one-out" } else { "blocks" }.to_owned(),
            frames: locked.iter().map(|place| refined.frames[*place].0).collect(),
        },
        nulls: first.chance.nulls,
        resimulated_p_value: anew.map(|anew| anew.p_value),
        left_p_value: rest.as_ref().map(|rest| rest.p_value),
        half_nights,
        effective_hypotheses: hypotheses,
        summary: Vec::new(),
        warnings,
        camera: Some(solved.joint.model().clone()),
        residuals: residual_rows(&refined, &base, &everything, points),
        profiles,
        seconds: 0.0,
        provenance: None,
    };
    diagnosis.summary = words::summary(&diagnosis, rest.map_or(1.0, |rest| rest.p_value));
    diagnosis.seconds = started.elapsed().as_secs_f64();
    Ok(diagnosis)
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

/// p-value of a statistic of so many degrees of freedom.
pub(super) fn p_of(t: f64, rank: usize) -> f64 {
    (-chi_squared_surprise(rank as f64, t)).exp()
}

/// p-value once all hypotheses are counted.
pub(super) fn family(p: f64, hypotheses: f64) -> f64 {
    -(hypotheses * (-p).ln_1p()).exp_m1()
}

//! Making, and answering.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;

use rayon::prelude::*;

use super::generate::{Concealed, Family, Lists, Truth, concealed};
use super::{Answer, AnswerFinding, AnswerParameter, AnswerProposal, BlindError, Seal};
use super::{
    answers, append, control_points, image_answer, pixel_answer, recording, rival_fits, seal, telemetry, write_images, write_pixels,
};
use crate::catalog::Catalog;
use crate::diagnose::{Channel, ChannelMeasure, DiagnoseOptions, Diagnosis, EffectState, Verdict, diagnose};
use crate::recording::write_manifest;

/// Makes recordings and seals their truths; with `written`, writes them into DIR/recordings too.
pub fn make(
    directory: &Path,
    family: Family,
    indices: impl IntoIterator<Item = u32>,
    seed_of_all: u64,
    written: bool,
) -> Result<Seal, BlindError> {
    let catalog = Catalog::embedded();
    let indices: Vec<u32> = indices.into_iter().collect();
    let truths = indices
        .into_par_iter()
        .map(|index| {
            let made = concealed(family, index, seed_of_all, catalog);
            if written {
                let folder = directory.join("recordings").join(format!("{}-{index:05}", family.name()));
                match (&made.canvas, &made.images) {
                    (Some(canvas), _) => write_pixels(&folder, &made.lists, canvas)?,
                    (None, Some(images)) => write_images(&folder, &made.lists, images)?,
                    (None, None) => drop(write_manifest(&folder, &recording(&made.lists))?),
                }
            }
            Ok(made.truth)
        })
        .collect::<Result<Vec<Truth>, BlindError>>()?;
    seal(directory, seed_of_all, &truths)
}

/// Diagnoses the recordings that have no answer yet, each answer appended as it comes; `done` is called after each. The number of new answers.
pub fn run(
    directory: &Path,
    family: Family,
    indices: impl IntoIterator<Item = u32>,
    options: &DiagnoseOptions,
    done: impl Fn() + Sync,
) -> Result<usize, BlindError> {
    let sealed = Seal::read(directory)?.ok_or_else(|| BlindError::NoSeal { directory: directory.to_owned() })?;
    let answered: Vec<u32> = answers(directory, family)?.iter().map(|answer| answer.index).collect();
    let open: Vec<u32> =
        indices.into_iter().filter(|index| sealed.holds(family, *index) && answered.binary_search(index).is_err()).collect();
    let file = Mutex::new(());
    let one = |index: &u32| {
        let answer = answer(family, *index, sealed.seed, options);
        let _whole = file.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        append(directory, &answer)?;
        done();
        Ok::<(), BlindError>(())
    };
    // Frames of pixels keep all processors busy by themselves; one after the other, their time is what a user waits.
    let answered = if family.of_lists().is_some() || family.is_of_images() {
        open.iter().try_for_each(one)
    } else {
        open.par_iter().try_for_each(one)
    };
    answered?;
    Ok(open.len())
}

/// The answer for one recording: its truth is dropped unseen.
#[must_use]
pub fn answer(family: Family, index: u32, seed: u64, options: &DiagnoseOptions) -> Answer {
    if family.of_lists().is_some() {
        return pixel_answer(family, index, seed, options);
    }
    if family.is_of_images() {
        return image_answer(family, index, seed, options);
    }
    let Concealed { lists, .. } = concealed(family, index, seed, Catalog::embedded());
    let options = DiagnoseOptions { seed: u64::from(index), ..options.clone() };
    // Rivals are held against the diagnosis as it is used, not against one that is made loose to see what chance brings.
    let as_used = options.alpha <= DiagnoseOptions::default().alpha;
    answer_of_lists(&lists, family, index, seed, &options, as_used)
}

/// The answer about star lists; with `rivals`, other ways of mending are tried on them too.
pub(super) fn answer_of_lists(lists: &Lists, family: Family, index: u32, seed: u64, options: &DiagnoseOptions, rivals: bool) -> Answer {
    let recording = recording(lists);
    let points = match control_points(&recording, &lists.model, Catalog::embedded()) {
        Ok(points) => points,
        Err(error) => return Answer::none(family, index, seed, error.to_string()),
    };
    let physics = lists.model.iter().map(|id| (*id).to_owned()).collect();
    let options = DiagnoseOptions { physics, ..options.clone() };
    match diagnose(&points, &telemetry(&recording), &options) {
        Err(error) => Answer::none(family, index, seed, error.to_string()),
        Ok(diagnosis) => {
            let mut answer = shortened(&diagnosis, family, index, seed);
            let frames = points.attitudes.len();
            let held_out =
                if answer.held_out_frames.is_empty() { (3 * frames / 4..frames).collect() } else { answer.held_out_frames.clone() };
            answer.alpha = options.alpha;
            answer.rivals = rivals.then(|| rival_fits(&points, &options.physics, &answer.findings, &held_out)).flatten();
            answer
        }
    }
}

/// What a finding leaves on frames and stars that took no part, by channel.
fn held_out_chi2(finding: &crate::diagnose::Finding) -> BTreeMap<String, [f64; 3]> {
    let told = |(channel, measure): (&Channel, &Option<ChannelMeasure>)| {
        let own = (*measure)?;
        let [before, after] = own.held_out_chi2_per_dof?;
        Some((serde_json::to_value(channel).ok()?.as_str()?.to_owned(), [before, after, own.held_out_dof?]))
    };
    finding.channels.iter().filter_map(told).collect()
}

/// What counts of a diagnosis.
pub(super) fn shortened(diagnosis: &Diagnosis, family: Family, index: u32, seed: u64) -> Answer {
    let finding = |finding: &crate::diagnose::Finding| AnswerFinding {
        id: finding.id.clone(),
        parameters: finding
            .parameters
            .iter()
            .map(|parameter| AnswerParameter { name: parameter.name.clone(), value: parameter.value, sigma: parameter.sigma })
            .collect(),
        located_by: finding.located_by.clone(),
        snr: finding.snr,
        delta_chi2: finding.delta_chi2,
        set: finding.indistinguishable_from.clone(),
        held_out_chi2: held_out_chi2(finding),
    };
    let proposal = |own: &crate::diagnose::Proposed| AnswerProposal {
        id: own.id.clone(),
        named: own.named,
        by_all_images: own.by_all_images,
        delta_chi2: own.delta_chi2,
        held_out_delta_chi2: own.held_out_delta_chi2,
        held_out_expected: own.held_out_expected,
        chosen_again: own.chosen_again,
    };
    let verdict = match diagnosis.verdict {
        Verdict::Consistent => "consistent",
        Verdict::Explained => "explained",
        Verdict::Unexplained => "unexplained",
        Verdict::Undecided => "undecided",
    };
    let status = |state: EffectState| match state {
        EffectState::Found => "found",
        EffectState::Indistinguishable => "indistinguishable",
        EffectState::NotFound => "not-found",
        EffectState::Withheld => "withheld",
        EffectState::NotObservable => "not-observable",
        EffectState::NotApplicable => "not-applicable",
    };
    Answer {
        error: None,
        verdict: verdict.to_owned(),
        findings: diagnosis.findings.iter().map(finding).collect(),
        proposed: diagnosis.proposed.iter().map(proposal).collect(),
        unknown_located_by: diagnosis.unknown.first().map(|unknown| unknown.located_by.clone()),
        unknown_resembles: diagnosis
            .unknown
            .iter()
            .flat_map(|unknown| unknown.resembles.iter().map(|resemblance| (resemblance.id.clone(), resemblance.cos)))
            .collect(),
        unknown_vetoes: diagnosis.unknown.first().map_or_else(Vec::new, |unknown| unknown.vetoes.clone()),
        effects: diagnosis.effects.iter().map(|effect| (effect.id.clone(), status(effect.status).to_owned())).collect(),
        located: diagnosis.located.iter().map(|located| located.covariate.clone()).collect(),
        held_out: [diagnosis.fit.baseline.held_out_chi2_per_dof, diagnosis.fit.after.held_out_chi2_per_dof],
        held_out_frames: diagnosis.left_out.blocks.first().cloned().unwrap_or_default(),
        rivals: None,
        pixels: None,
        seconds: diagnosis.seconds,
        ..Answer::none(family, index, seed, String::new())
    }
}

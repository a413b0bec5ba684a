//! The verdict on the rows: effects that stand, effects withheld, and what is left in each channel.

use std::collections::{BTreeMap, BTreeSet};

use super::background::{Background, add_background};
use super::confirmed;
use super::noise::add_noise;
use super::patterns::patterns;
pub(in crate::diagnose) use super::proposed::{ChannelState, Pixels, Proposed};
use super::row_fit::RowFit;
use super::rows::{KNOWN_BEFOREHAND, Question, Row, Rows};
use super::selection::{Answer, answer, answers, chance, columns, cosine, directions, fitted, select};
use super::stars::{StarMeasurement, rows_of_stars};
use super::turns::{HeldOut, held_out};
use crate::diagnose::channels::{Channel, ChannelMeasure};
use crate::diagnose::null_distribution::{family_p, independent};
use crate::effects::CentroidShift;
use crate::effects::detector::amplifier_step::AmplifierStep;
use crate::effects::detector::brighter_fatter::BrighterFatter;
use crate::effects::pixel::pass::PassHead;
use crate::statistics::significance::neg_ln_chi2_sf;

/// Simulations at most: more tell nothing that their tail does not.
const MAX_NULLS: usize = 1000;
/// A covariate locates what is left below this probability among all.
const LOCATES_P: f64 = 0.01;
/// In the turns an effect is chosen at this probability already: what is asked for there is that it is there again, in less than half of the rows.
const TURN_P: f64 = 1e-2;
/// Effects whose columns in the size of images are taken for the cause of a loss of light too, from this surprise on.
const SIZE_SURPRISE: f64 = 6.9;
/// Magnitudes that the sum of the light may lose where the variance of the image doubles: 0.1 where a lens goes out of focus from half a depth of
/// focus to a whole one; light in the far wings is not seen under the weight.
const LEAK_SIGMA: f64 = 0.15;
/// The variance of an image is larger or smaller than the typical one by at most this share of it, for its light to be told.
const MOST_WIDER: f64 = 0.8;
/// What is as alike as this to an effect that is known to be there may be what its formula leaves.
const SHADOW: f64 = 0.3;
/// What is as alike as this and better by no more than odds of 100 : 1 cannot be told apart.
const SAME_TRACE: f64 = 0.9;
const AS_GOOD: f64 = 4.6;
/// Amplitudes of two channels that differ by more (in standard errors: p of a thousandth) are not this effect alone.
const DISAGREES: f64 = 3.3;

/// What is asked.
#[derive(Clone, Copy, Debug)]
pub(in crate::diagnose) struct Asked {
    pub(in crate::diagnose) nulls: usize,
    pub(in crate::diagnose) alpha: f64,
    pub(in crate::diagnose) seed: u64,
    /// Independent questions that other channels ask.
    pub(in crate::diagnose) other_questions: f64,
}

/// An effect that was not proposed.
#[derive(Clone, Debug)]
pub(in crate::diagnose) struct NotProposed {
    pub(in crate::diagnose) id: &'static str,
    pub(in crate::diagnose) p_value: f64,
    /// Size and standard error of the first parameter.
    pub(in crate::diagnose) size: Option<[f64; 2]>,
    pub(in crate::diagnose) question: usize,
}

/// The verdict.
#[derive(Clone, Debug)]
pub(in crate::diagnose) struct Judged {
    pub(in crate::diagnose) rows: Rows,
    pub(in crate::diagnose) fit: RowFit,
    pub(in crate::diagnose) proposed: Vec<Proposed>,
    pub(in crate::diagnose) others: Vec<NotProposed>,
    /// Effects that were not asked, and why.
    pub(in crate::diagnose) unasked: BTreeMap<&'static str, String>,
    pub(in crate::diagnose) channels: BTreeMap<Channel, ChannelState>,
    /// What the sky between the stars adds; nothing where no frame has any.
    pub(in crate::diagnose) background: Option<Background>,
    /// Independent questions.
    pub(in crate::diagnose) questions: f64,
    /// Surprise that a finding needs.
    pub(in crate::diagnose) threshold: f64,
}

/// Judges the stars and the noise of a recording, their frames numbered by their place among all; nothing where there are no numbers. `found`: the
/// effects that the places have shown, which are there whatever is asked here.
pub(in crate::diagnose) fn judge(
    stars: &[StarMeasurement],
    pixels: Option<&Pixels<'_>>,
    frames: usize,
    asked: &Asked,
    found: &[String],
) -> Option<Judged> {
    let (mut rows, mut unasked, stars) = rows_of_stars(stars, frames);
    if let Some(star) = stars.first() {
        take_size_out_of_flux(&mut rows, star.image.sigma_px);
    }
    let mut background = None;
    if let Some(pixels) = pixels {
        add_noise(&mut rows, pixels.statistics, pixels.detector, |frame| pixels.places.get(&frame).copied().unwrap_or(0));
        background = Some(add_background(&mut rows, pixels, &stars));
    }
    for (id, reason) in background.iter().flat_map(|own| &own.unasked) {
        unasked.entry(id).or_insert_with(|| reason.clone());
    }
    if rows.kinds.is_empty() || rows.questions.is_empty() {
        return None;
    }
    let all = vec![true; rows.len()];
    let given: Vec<usize> = (0..rows.questions.len()).filter(|index| found.iter().any(|id| id == rows.questions[*index].id)).collect();
    let nothing = fitted(&rows, &all, &[], None);
    let nulls = asked.nulls.min(MAX_NULLS);
    let every: Vec<&Question> = rows.questions.iter().collect();
    let by_chance = chance(&rows, &nothing, &every, nulls, asked.seed);
    let questions = independent(&by_chance);
    // −ln of the probability that a single question may have for the family of all to have α.
    let threshold = -(-(-asked.alpha).ln_1p() / (questions + asked.other_questions)).ln();
    let (accepted, fit) = select(&rows, &all, &given, threshold);
    let held = held_out(&rows, &fit, (&accepted, &given), -TURN_P.ln());
    let mut proposed: Vec<Proposed> = accepted
        .iter()
        .enumerate()
        .skip(given.len())
        .filter_map(|(k, question)| proposal(&rows, &accepted, k, *question, &fit, held[k].clone(), &by_chance))
        .map(|own| beside(&rows, &nothing, &given, own))
        .collect();
    let mut answers = answers(&rows, &fit, &accepted);
    // Of an effect with many shapes the most surprising answers for all.
    answers.sort_by(|a, b| rows.questions[a.question].id.cmp(rows.questions[b.question].id).then(b.surprise.total_cmp(&a.surprise)));
    answers.dedup_by_key(|answer| rows.questions[answer.question].id);
    answers.sort_by_key(|answer| answer.question);
    let others = answers
        .into_iter()
        .map(|answer| NotProposed {
            id: rows.questions[answer.question].id,
            // Of a size on the wrong side of zero there is no surprise, but there may be something.
            p_value: (-if answer.surprise > 0.0 { answer.surprise } else { neg_ln_chi2_sf(answer.rank as f64, answer.statistic) }).exp(),
            size: fit.amplitude(&rows, &rows.questions[answer.question].columns[0], |_| true),
            question: answer.question,
        })
        .collect();
    let of_sky = background.iter().flat_map(|own| own.patterns.iter().cloned());
    let named: Vec<Question> = patterns(&rows, &stars).into_iter().chain(of_sky).collect();
    let looked_at = background.as_ref().filter(|own| own.why_not.is_none());
    if let Some(own) = looked_at {
        confirmed::withhold_what_leaves_much(&rows, own, [&nothing, &fit], &mut proposed);
    }
    // What is withheld explains nothing.
    let left = confirmed::standing(&rows, (&given, &accepted), &fit, &proposed);
    let mut channels = channel_states(&rows, &named, [&nothing, left.as_ref().unwrap_or(&fit)], nulls, asked.seed);
    if let Some((own, state)) = looked_at.and_then(|own| Some((own, channels.remove(&Channel::Background)?))) {
        channels.insert(Channel::Background, own.with_uneven(state, &sizes_of(&rows, &accepted, &fit)));
    }
    Some(Judged { rows, fit, proposed, others, unasked, channels, background, questions, threshold })
}

/// Sizes of the columns of a fit, by question and parameter.
fn sizes_of(rows: &Rows, accepted: &[usize], fit: &RowFit) -> BTreeMap<(usize, usize), f64> {
    let places = accepted.iter().flat_map(|question| (0..rows.questions[*question].columns.len()).map(|k| (*question, k)));
    places.zip(fit.size.iter().copied()).collect()
}

/// Where images widen some light is lost to the sum: what the images' sizes follow beyond chance, and its square, are nuisance parameters of the
/// magnitudes.
fn take_size_out_of_flux(rows: &mut Rows, sigma_px: f64) {
    let all = &vec![true; rows.len()];
    let ranges = rows.ranges();
    let Some(flux) = rows.kinds.iter().position(|kind| kind.channel == Channel::Flux) else { return };
    let size = rows.kinds.iter().position(|kind| kind.name == super::stars::SIZE);
    let Some(size) = size else { return };
    let in_size =
        |question: &Question| question.columns.iter().any(|column| column[ranges[size].clone()].iter().any(|value| *value != 0.0));
    // The questions of the sizes alone, their columns elsewhere left out.
    let mut alone = rows.clone();
    for question in &mut alone.questions {
        for column in &mut question.columns {
            for (k, value) in column.iter_mut().enumerate() {
                if !ranges[size].contains(&k) {
                    *value = 0.0;
                }
            }
        }
    }
    alone.questions.retain(in_size);
    let (accepted, fit) = select(&alone, all, &[], SIZE_SURPRISE);
    if accepted.is_empty() {
        return;
    }
    let mut by_point: BTreeMap<usize, f64> = BTreeMap::new();
    let mut first = 0;
    for question in accepted {
        for column in &alone.questions[question].columns {
            for (row, value) in alone.kinds[size].rows.iter().zip(&column[ranges[size].clone()]) {
                *by_point.entry(row.point.unwrap_or(usize::MAX)).or_default() += fit.size[first] * value;
            }
            first += 1;
        }
    }
    let leak: Vec<f64> =
        rows.kinds[flux].rows.iter().map(|row| row.point.and_then(|point| by_point.get(&point)).copied().unwrap_or(0.0)).collect();
    // In units of the image's variance: a parameter of one means that all the light that the width adds is lost.
    let mut leak: Vec<f64> = leak.iter().map(|change| change / (sigma_px * sigma_px)).collect();
    keep_alike(rows, flux, &mut leak);
    let squares: Vec<f64> = leak.iter().map(|change| change * change).collect();
    add_leak(rows, flux, &leak);
    add_leak(rows, flux, &squares);
}

/// Leaves out the magnitudes of stars whose images differ too much from the typical one: how much of their light is seen nobody knows.
fn keep_alike(rows: &mut Rows, flux: usize, leak: &mut Vec<f64>) {
    let start = rows.ranges()[flux].start;
    let keep: Vec<bool> = leak.iter().map(|change| change.abs() < MOST_WIDER).collect();
    let kept = |column: &mut Vec<f64>, start: usize| {
        let mut k = 0_usize;
        column.retain(|_| {
            k += 1;
            (k - 1).checked_sub(start).and_then(|k| keep.get(k)).copied().unwrap_or(true)
        });
    };
    rows.questions.iter_mut().flat_map(|question| &mut question.columns).for_each(|column| kept(column, start));
    let kind = &mut rows.kinds[flux];
    kind.per_frame.iter_mut().chain(&mut kind.common).for_each(|column| kept(column, 0));
    let mut all = keep.iter();
    kind.rows.retain(|_| *all.next().unwrap_or(&true));
    kept(leak, 0);
}

/// The nuisance parameter with what is known of it: a row of its own says that it is zero within [`LEAK_SIGMA`].
fn add_leak(rows: &mut Rows, flux: usize, leak: &[f64]) {
    let at = rows.ranges()[flux].end;
    let kind = &mut rows.kinds[flux];
    let star = kind.rows.iter().map(|row| row.star).max().unwrap_or(0) + 1;
    kind.rows.push(Row { value: 0.0, sigma: LEAK_SIGMA, frame: KNOWN_BEFOREHAND, star, point: None });
    for column in kind.per_frame.iter_mut().chain(&mut kind.common) {
        column.push(0.0);
    }
    let before = kind.rows.len() - 1;
    let mut column = leak.to_vec();
    column.resize(before, 0.0);
    column.push(1.0);
    kind.common.push(column);
    for column in rows.questions.iter_mut().flat_map(|question| &mut question.columns) {
        column.insert(at, 0.0);
    }
}

#[allow(clippy::too_many_arguments, reason = "one proposal of a selection, with what it was selected from")]
fn proposal(
    rows: &Rows,
    accepted: &[usize],
    k: usize,
    question: usize,
    fit: &RowFit,
    held_out: HeldOut,
    by_chance: &[f64],
) -> Option<Proposed> {
    let others: Vec<usize> = accepted.iter().copied().filter(|other| *other != question).collect();
    let without = RowFit::under(rows, &fit.take, &columns(rows, &others), fit);
    let answer = answer(rows, &without, question)?;
    let first: usize = accepted[..k].iter().map(|index| rows.questions[*index].columns.len()).sum();
    let own = &rows.questions[question];
    let sizes: Vec<[f64; 2]> =
        (0..own.columns.len()).map(|j| [fit.size[first + j], fit.covariance[(first + j, first + j)].max(0.0).sqrt()]).collect();
    let channels = by_channel(rows, [fit, &without], own, (fit.size[first], &held_out));
    let mut against: Vec<String> = held_out.fails().into_iter().collect();
    against.extend(disagreement(&channels));
    against.extend(confirmed::by_sky_alone(own, &channels));
    against.extend(implausible(own, &sizes));
    against.extend(confirmed::by_fields(rows, &without, own, &sizes));
    against.extend(own.sign.filter(|sign| sign * fit.size[first] < 0.0).map(|_| "its size has the wrong sign".to_owned()));
    Some(Proposed {
        question,
        sizes,
        statistic: answer.statistic,
        rank: answer.rank,
        surprise: answer.surprise,
        family_p: family_p(by_chance, answer.surprise),
        held_out,
        channels,
        alike: alike(rows, &without, accepted, &answer),
        against,
    })
}

/// The effects that leave the same trace and explain about as much as one that was chosen.
fn alike(rows: &Rows, without: &RowFit, accepted: &[usize], chosen: &Answer) -> Vec<&'static str> {
    let own = rows.questions[chosen.question].id;
    let is_alike = |other: &Answer| {
        rows.questions[other.question].id != own
            && other.surprise > chosen.surprise - AS_GOOD
            && cosine(rows, without, chosen.question, other.question) > SAME_TRACE
    };
    let mut all: Vec<&'static str> =
        answers(rows, without, accepted).iter().filter(|other| is_alike(other)).map(|other| rows.questions[other.question].id).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// Sizes that no detector has: halves that differ by too much, charge that is pushed aside and adds noise.
fn implausible(question: &Question, sizes: &[[f64; 2]]) -> Option<String> {
    const MAX_GAIN_STEP: f64 = 0.2;
    let is_step = question.id == <AmplifierStep as CentroidShift>::ID && question.parameters.first()?.name == "gain_relative";
    let size = sizes.first()?[0];
    // Pixels that push charge aside share their noise: none has more of it.
    if question.id == <BrighterFatter as PassHead>::ID && sizes.get(1).is_some_and(|[lost, sigma]| *lost < -2.0 * sigma) {
        return Some("the noise of the sky grows with the light, and charge that is pushed aside makes it fall".to_owned());
    }
    (is_step && size.abs() > MAX_GAIN_STEP).then(|| format!("no two amplifiers differ by {:.0} %", 100.0 * size.abs()))
}

/// Of what the places have found the columns here are a formula: what is left of it is not to be named after another effect.
fn beside(rows: &Rows, nothing: &RowFit, given: &[usize], mut own: Proposed) -> Proposed {
    for known in given {
        let cosine = cosine(rows, nothing, *known, own.question);
        if cosine > SHADOW {
            own.against.push(format!(
                "it may be what the formula of {} leaves, which the positions show (cosine {cosine:.2})",
                rows.questions[*known].id
            ));
        }
    }
    own
}

/// The first parameter by the rows of each channel alone, the others of the effect free in them: what all rows have made of it, and what the
/// channel's residuals add to that.
fn by_channel(
    rows: &Rows,
    [fit, without]: [&RowFit; 2],
    question: &Question,
    (size, held_out): (f64, &HeldOut),
) -> BTreeMap<Channel, ChannelMeasure> {
    let channels: BTreeSet<Channel> = rows.kinds.iter().map(|kind| kind.channel).collect();
    let psi = nalgebra::DVector::from_column_slice(&without.psi);
    let mut found = BTreeMap::new();
    for channel in channels {
        let is_own: Vec<bool> = rows.kinds.iter().flat_map(|kind| vec![kind.channel == channel; kind.rows.len()]).collect();
        let columns: Vec<Vec<f64>> = question
            .columns
            .iter()
            .map(|column| column.iter().zip(&is_own).map(|(value, own)| if *own { *value } else { 0.0 }).collect())
            .collect();
        let delta_chi2: f64 = directions(rows, without, &columns).iter().map(|direction| direction.dot(&psi).powi(2)).sum();
        let measured = confirmed::beside_the_others(rows, [fit, without], &columns).filter(|_| delta_chi2 > 0.0);
        let Some([more, sigma]) = measured else { continue };
        let amplitude = size + more;
        let held: f64 = rows.kinds.iter().zip(&held_out.by_kind).filter(|(kind, _)| kind.channel == channel).map(|(_, gain)| gain).sum();
        found.insert(channel, ChannelMeasure { delta_chi2, held_out_delta_chi2: Some(held), amplitude, sigma });
    }
    found
}

/// Channels that measure different sizes of one effect.
fn disagreement(channels: &BTreeMap<Channel, ChannelMeasure>) -> Option<String> {
    let (weight, sum) = channels.values().fold((0.0, 0.0), |(weight, sum), own| {
        let own_weight = own.sigma.powi(-2);
        (weight + own_weight, sum + own.amplitude * own_weight)
    });
    let mean = sum / weight;
    let (channel, own) =
        channels.iter().max_by(|a, b| ((a.1.amplitude - mean) / a.1.sigma).abs().total_cmp(&((b.1.amplitude - mean) / b.1.sigma).abs()))?;
    let off = (own.amplitude - mean).abs() / own.sigma;
    (channels.len() > 1 && off > DISAGREES).then(|| {
        format!(
            "it is not this effect alone: by the {} it is {:.3e} ± {:.1e}, by all channels {mean:.3e}",
            channel.words(),
            own.amplitude,
            own.sigma
        )
    })
}

/// What is said of every channel, before and after.
fn channel_states(
    rows: &Rows,
    patterns: &[Question],
    [before, after]: [&RowFit; 2],
    nulls: usize,
    seed: u64,
) -> BTreeMap<Channel, ChannelState> {
    let ranges = rows.ranges();
    let channels: BTreeSet<Channel> = rows.kinds.iter().map(|kind| kind.channel).collect();
    let mut states = BTreeMap::new();
    for (number, channel) in channels.into_iter().enumerate() {
        let is_of = |question: &&Question| {
            let of_kind = |(kind, range): (&super::rows::Kind, &std::ops::Range<usize>)| {
                kind.channel == channel && question.columns.iter().any(|column| column[range.clone()].iter().any(|value| *value != 0.0))
            };
            rows.kinds.iter().zip(&ranges).any(of_kind)
        };
        // Where no covariate is of stars the effects' own columns are the patterns.
        let of_stars: Vec<&Question> = patterns.iter().filter(is_of).collect();
        let own: Vec<&Question> = if of_stars.is_empty() { rows.questions.iter().filter(is_of).collect() } else { of_stars };
        let tested = |fit: &RowFit, stream: u64| -> (f64, Vec<String>) {
            let psi = nalgebra::DVector::from_column_slice(&fit.psi);
            let mut found: Vec<(f64, &'static str)> = own
                .iter()
                .filter_map(|question| {
                    let basis = directions(rows, fit, &question.columns);
                    let statistic: f64 = basis.iter().map(|direction| direction.dot(&psi).powi(2)).sum();
                    (!basis.is_empty()).then(|| (neg_ln_chi2_sf(basis.len() as f64, statistic), question.follows))
                })
                .collect();
            found.sort_by(|a, b| b.0.total_cmp(&a.0));
            let by_chance = chance(rows, fit, &own, nulls, seed ^ 0x5eed_0000 ^ stream);
            let p_value = found.first().map_or(1.0, |(surprise, _)| family_p(&by_chance, *surprise));
            let mut located: Vec<String> = Vec::new();
            for (surprise, follows) in &found {
                if family_p(&by_chance, *surprise) < LOCATES_P && !located.iter().any(|own| own == follows) {
                    located.push((*follows).to_owned());
                }
            }
            (p_value, located)
        };
        let stream = 2 * number as u64;
        let ((p_value, located_by), (left_p_value, left_located_by)) = (tested(before, stream), tested(after, stream + 1));
        states.insert(channel, ChannelState { p_value, located_by, left_p_value, left_located_by });
    }
    states
}

//! The verdict on the rows: effects that stand, effects withheld, and what is left in each channel.

use std::collections::{BTreeMap, BTreeSet};

use super::noise::{DeclaredDetector, add_noise};
use super::patterns::patterns;
use super::row_fit::RowFit;
use super::rows::{Question, Row, Rows};
use super::selection::{answer, answers, chance, columns, cosine, directions, fitted, select};
use super::stars::{StarMeasurement, rows_of_stars};
use super::turns::{HeldOut, held_out};
use crate::diagnose::channels::{Channel, ChannelMeasure};
use crate::diagnose::null_distribution::{family_p, independent};
use crate::pixel_statistics::PixelStatistics;
use crate::statistics::significance::neg_ln_chi2_sf;

/// Simulations at most: more tell nothing that their tail does not.
const MAX_NULLS: usize = 1000;
/// A covariate locates what is left below this probability among all.
const LOCATES_P: f64 = 0.01;
/// In the turns an effect is chosen at this probability already: what is asked for there is that it is there again, in less than half of the rows.
const TURN_P: f64 = 1e-2;
/// Effects whose columns in the size of images are taken for the cause of a loss of light too, from this surprise on.
const SIZE_SURPRISE: f64 = 6.9;
/// Magnitudes that the fit of the flux may lose where the variance of the image doubles: a Gaussian's free width follows its core, and the wings
/// that it misses are a part of the light.
const LEAK_SIGMA: f64 = 0.3;
/// What is as alike as this to an effect that is known to be there may be what its formula leaves.
const SHADOW: f64 = 0.3;
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

/// An effect that all rows propose.
#[derive(Clone, Debug)]
pub(in crate::diagnose) struct Proposed {
    pub(in crate::diagnose) question: usize,
    pub(in crate::diagnose) sizes: Vec<[f64; 2]>,
    pub(in crate::diagnose) statistic: f64,
    pub(in crate::diagnose) rank: usize,
    pub(in crate::diagnose) surprise: f64,
    pub(in crate::diagnose) family_p: f64,
    pub(in crate::diagnose) held_out: HeldOut,
    /// The first parameter as each channel alone measures it.
    pub(in crate::diagnose) channels: BTreeMap<Channel, ChannelMeasure>,
    /// Why it is withheld; none where it stands.
    pub(in crate::diagnose) against: Vec<String>,
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

/// What is said of a channel.
#[derive(Clone, Debug, Default)]
pub(in crate::diagnose) struct ChannelState {
    /// Probability by chance that it differs as much from the model, before anything is found.
    pub(in crate::diagnose) p_value: f64,
    pub(in crate::diagnose) located_by: Vec<String>,
    /// The same with the findings.
    pub(in crate::diagnose) left_p_value: f64,
    pub(in crate::diagnose) left_located_by: Vec<String>,
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
    /// Independent questions.
    pub(in crate::diagnose) questions: f64,
    /// Surprise that a finding needs.
    pub(in crate::diagnose) threshold: f64,
}

/// Judges the stars and the noise of a recording, their frames numbered by their place among all; nothing where there are no numbers. `found`: the
/// effects that the places have shown, which are there whatever is asked here.
pub(in crate::diagnose) fn judge(
    stars: &[StarMeasurement],
    noise: Option<(&PixelStatistics, &DeclaredDetector, &BTreeMap<usize, usize>)>,
    frames: usize,
    asked: &Asked,
    found: &[String],
) -> Option<Judged> {
    let (mut rows, unasked, stars) = rows_of_stars(stars, frames);
    if let Some(star) = stars.first() {
        take_size_out_of_flux(&mut rows, star.image.sigma_px);
    }
    if let Some((pixels, detector, places)) = noise {
        add_noise(&mut rows, pixels, detector, |frame| places.get(&frame).copied().unwrap_or(0));
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
    let proposed: Vec<Proposed> = accepted
        .iter()
        .enumerate()
        .skip(given.len())
        .filter_map(|(k, question)| proposal(&rows, &accepted, k, *question, &fit, held[k].clone(), &by_chance))
        .map(|own| beside(&rows, &nothing, &given, own))
        .collect();
    let others = answers(&rows, &fit, &accepted)
        .into_iter()
        .map(|answer| NotProposed {
            id: rows.questions[answer.question].id,
            p_value: (-neg_ln_chi2_sf(answer.rank as f64, answer.statistic)).exp(),
            size: fit.amplitude(&rows, &rows.questions[answer.question].columns[0], |_| true),
            question: answer.question,
        })
        .collect();
    let channels = channel_states(&rows, &stars, [&nothing, &fit], nulls, asked.seed);
    Some(Judged { rows, fit, proposed, others, unasked, channels, questions, threshold })
}

/// Where images widen the fit of the flux loses light: what the images' sizes follow beyond chance is a nuisance parameter of the magnitudes, with
/// a factor that is free.
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
    add_leak(rows, flux, &leak, sigma_px);
}

/// The nuisance parameter with what is known of it: a row of its own says that it is zero within [`LEAK_SIGMA`].
fn add_leak(rows: &mut Rows, flux: usize, leak: &[f64], sigma_px: f64) {
    let at = rows.ranges()[flux].end;
    // A parameter of one: all the light that the width adds is lost.
    let by_square = (sigma_px * sigma_px).recip();
    let kind = &mut rows.kinds[flux];
    let star = kind.rows.iter().map(|row| row.star).max().unwrap_or(0) + 1;
    kind.rows.push(Row { value: 0.0, sigma: LEAK_SIGMA, frame: 0, star, point: None });
    for column in kind.per_frame.iter_mut().chain(&mut kind.common) {
        column.push(0.0);
    }
    kind.common.push(leak.iter().map(|change| change * by_square).chain([1.0]).collect());
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
    let sizes = (0..own.columns.len()).map(|j| [fit.size[first + j], fit.covariance[(first + j, first + j)].max(0.0).sqrt()]).collect();
    let channels = by_channel(rows, &without, own, &held_out);
    let mut against: Vec<String> = held_out.fails().into_iter().collect();
    against.extend(disagreement(&channels));
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
        against,
    })
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

/// The first parameter by the rows of each channel alone.
fn by_channel(rows: &Rows, without: &RowFit, question: &Question, held_out: &HeldOut) -> BTreeMap<Channel, ChannelMeasure> {
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
        let Some([amplitude, sigma]) = without.amplitude(rows, &columns[0], |_| true).filter(|_| delta_chi2 > 0.0) else { continue };
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
    stars: &[StarMeasurement],
    [before, after]: [&RowFit; 2],
    nulls: usize,
    seed: u64,
) -> BTreeMap<Channel, ChannelState> {
    let patterns = patterns(rows, stars);
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

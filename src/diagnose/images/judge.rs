//! The verdict on the rows: effects that stand, effects withheld, and what is left in each channel.

use std::collections::{BTreeMap, BTreeSet};

use super::background::{Background, add_background};
use super::bouguer_line;
use super::channel_states::channel_states;
use super::confirmed;
use super::expected_stars::StarMeasurement;
use super::forward_selection::select;
use super::frame_levels::{Air, TestedFrame};
use super::frame_widths::{Trend, trend};
use super::light_lost::take_size_out_of_flux;
use super::noise::{add_noise, unasked_pattern};
use super::patterns::patterns;
use super::profiles::profiles;
pub(in crate::diagnose) use super::proposed::{ChannelState, Pixels, Proposed};
use super::rendered::StampCamera;
use super::row_fit::RowFit;
use super::rows::{Question, Rows};
use super::selection::{Answer, answer, answers, chance, columns, cosine, directions, fitted};
use super::stars::rows_of_stars;
use super::turns::{HeldOut, Turns, held_out, of_channel, sized_alone};
use crate::diagnose::channels::{Channel, ChannelMeasure};
use crate::diagnose::image_profiles::ImageProfile;
use crate::diagnose::null_distribution::{family_p, independent};
use crate::effects::CentroidShift;
use crate::effects::detector::amplifier_step::{AmplifierStep, is_gain_step};
use crate::effects::detector::brighter_fatter::BrighterFatter;
use crate::effects::pixel::pass::PassHead;
use crate::statistics::order::{sort_by, sort_by_key};
use crate::statistics::significance::neg_ln_chi2_sf;

/// Simulations at most: more tell nothing that their tail does not.
const MAX_NULLS: usize = 1000;
/// In the turns an effect is chosen at this probability already: what is asked for there is that it is there again, in less than half of the rows.
const TURN_P: f64 = 1e-2;
/// What is as alike as this to an effect that is known to be there may be what its formula leaves.
const SHADOW: f64 = 0.3;
/// What is as alike as this to a formula can do all that the formula does,
const CONTAINS: f64 = 0.999;
/// and is an effect of its own where it explains more than this share of it: a formula leaves less.
const LEFT_BY_FORMULA: f64 = 0.1;
/// What is as alike as this and better by no more than odds of 100 : 1 cannot be told apart.
const SAME_TRACE: f64 = 0.9;
const AS_GOOD: f64 = 4.6;
/// Amplitudes of two channels that differ by more (in standard errors: p of a thousandth) are not this effect alone.
const DISAGREES: f64 = 3.3;

/// What is asked.
#[derive(Clone, Copy, Debug)]
pub(in crate::diagnose) struct Asked<'a> {
    pub(in crate::diagnose) nulls: usize,
    pub(in crate::diagnose) alpha: f64,
    pub(in crate::diagnose) seed: u64,
    /// Independent questions that other channels ask.
    pub(in crate::diagnose) other_questions: f64,
    /// How the stars are rendered for columns of effects on pixels; formulas stand in where that is not known.
    pub(in crate::diagnose) stamps: Option<StampCamera>,
    /// Whether the camera looks through air.
    pub(in crate::diagnose) looks_through_air: bool,
    /// The frames by their places, with their exposure times where these are known; empty where nothing is known of them.
    pub(in crate::diagnose) tested: &'a [TestedFrame],
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
    /// The fit without what is withheld, where anything is.
    without_withheld: Option<RowFit>,
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
    /// Brightness and size against what they may follow.
    pub(in crate::diagnose) profiles: Vec<ImageProfile>,
}

impl Judged {
    /// The fit of what stands: what is withheld explains nothing.
    pub(in crate::diagnose) fn standing(&self) -> &RowFit {
        self.without_withheld.as_ref().unwrap_or(&self.fit)
    }
}

/// Judges the stars and the noise of a recording, their frames numbered by their place among all; nothing where there are no numbers. `found`: the
/// effects that the places have shown, which are there whatever is asked here.
pub(in crate::diagnose) fn judge(
    stars: &[StarMeasurement],
    pixels: Option<&Pixels<'_>>,
    frames: usize,
    asked: &Asked<'_>,
    found: &[String],
) -> Option<Judged> {
    let matched = stars;
    let (mut rows, mut unasked, stars) = rows_of_stars(matched, frames, asked.stamps.as_ref());
    if let Some(star) = stars.first() {
        take_size_out_of_flux(&mut rows, star.image.sigma_px);
    }
    let mut background = None;
    if let Some(pixels) = pixels {
        add_noise(&mut rows, pixels.statistics, pixels.detector, |frame| pixels.place(frame));
        unasked.extend(unasked_pattern(&rows, pixels.statistics));
        background = Some(add_background(&mut rows, pixels, &stars, matched));
    }
    for (id, reason) in background.iter().flat_map(|own| &own.unasked) {
        unasked.entry(id).or_insert_with(|| reason.clone());
    }
    if rows.kinds.is_empty() || rows.questions.is_empty() {
        return None;
    }
    let all = vec![true; rows.len()];
    let given: Vec<usize> = (0..rows.questions.len())
        .filter(|index| !rows.questions[*index].is_part && found.iter().any(|id| id == rows.questions[*index].id))
        .collect();
    let nothing = fitted(&rows, &all, &[], None);
    let nulls = asked.nulls.min(MAX_NULLS);
    let every: Vec<&Question> = rows.questions.iter().collect();
    let by_chance = chance(&rows, &nothing, &every, nulls, asked.seed);
    let questions = independent(&by_chance);
    // −ln of the probability that a single question may have for the family of all to have α.
    let threshold = -(-(-asked.alpha).ln_1p() / (questions + asked.other_questions)).ln();
    let (mut accepted, mut fit) = select(&rows, &all, &given, threshold);
    let trend = if asked.looks_through_air { None } else { trend(&rows, &all, (&accepted, &fit), threshold) };
    if let Some(trend) = &trend {
        accepted.push(trend.question);
        (accepted, fit) = select(&rows, &all, &accepted, threshold);
    }
    let tried = accepted.clone();
    let turns = in_turns(&rows, (&accepted, &given), &fit, trend.as_ref(), (matched, asked));
    let Proposal { accepted, fit, proposed, left: held_out } = propose(&rows, &given, (accepted, fit), turns, &by_chance);
    let mut proposed: Vec<Proposed> = proposed.into_iter().map(|own| beside(&rows, &nothing, &given, own)).collect();
    if let Some(trend) = &trend {
        as_surprising_as(trend, &mut proposed, &by_chance);
    }
    let others = not_proposed(&rows, &fit, &tried);
    let of_sky = background.iter().flat_map(|own| own.patterns.iter().cloned());
    let named: Vec<Question> = patterns(&rows, &stars).into_iter().chain(of_sky).collect();
    let looked_at = background.as_ref().filter(|own| own.why_not.is_none());
    if let Some(own) = looked_at {
        confirmed::withhold_what_leaves_much(&rows, own, [&nothing, &fit], &mut proposed);
        confirmed::withhold_what_a_gradient_tells(&rows, own, (&accepted, &fit), &mut proposed);
    }
    confirmed::withhold_gain_beside_other_noise(&rows, &held_out, &mut proposed);
    // What is withheld explains nothing.
    let left = confirmed::standing(&rows, (&given, &accepted), &fit, &proposed);
    let after = left.as_ref().unwrap_or(&fit);
    let mut channels = channel_states(&rows, &named, [&nothing, after], nulls, asked.seed);
    for (channel, state) in &mut channels {
        let [chi2, dof] = of_channel(&rows, &held_out, *channel);
        state.held_out = (dof > 0.0).then(|| [chi2 / dof, dof]);
    }
    let profiles = profiles(&rows, &stars, &nothing.rest, after);
    if let Some((own, state)) = looked_at.and_then(|own| Some((own, channels.remove(&Channel::Background)?))) {
        channels.insert(Channel::Background, own.with_uneven(state, &sizes_of(&rows, &accepted, &fit)));
    }
    Some(Judged { rows, fit, without_withheld: left, proposed, others, unasked, channels, background, questions, threshold, profiles })
}

/// What the turns say of each of the effects that all rows have found, and the zero points of the frames of an extinction that no turn confirms.
fn in_turns(
    rows: &Rows,
    (accepted, given): (&[usize], &[usize]),
    fit: &RowFit,
    trend: Option<&Trend>,
    (stars, asked): (&[StarMeasurement], &Asked<'_>),
) -> Turns {
    let mut turns = held_out(rows, fit, (accepted, given), -TURN_P.ln());
    if let Some(trend) = trend {
        sized_alone(rows, fit, (accepted, given), (trend.question, -TURN_P.ln()), &mut turns);
    }
    if asked.looks_through_air {
        let air = Air::of(stars, true);
        for (question, own) in accepted.iter().zip(&mut turns.effects).filter(|(_, own)| own.fails().is_some()) {
            own.by_zero_points = bouguer_line::confirmed(rows, (accepted, fit), *question, (&air, asked.tested));
        }
    }
    turns
}

/// A selection and its proposals.
struct Proposal {
    accepted: Vec<usize>,
    fit: RowFit,
    proposed: Vec<Proposed>,
    /// By kind: χ² of what took no part, and its degrees of freedom.
    left: Vec<[f64; 2]>,
}

/// The proposals of a selection. What makes frames and stars that took no part worse is not there: the others are fitted without it, and it is withheld
/// as it was.
fn propose(rows: &Rows, given: &[usize], (accepted, fit): (Vec<usize>, RowFit), turns: Turns, by_chance: &[f64]) -> Proposal {
    let Turns { effects: held, left } = turns;
    let of = |accepted: &[usize], fit: &RowFit, held: &[HeldOut]| -> Vec<Proposed> {
        let own = accepted.iter().enumerate().skip(given.len());
        own.filter_map(|(k, question)| proposal(rows, accepted, k, *question, fit, held[k].clone(), by_chance)).collect()
    };
    let mut proposed = of(&accepted, &fit, &held);
    let is_worse: Vec<bool> =
        held.iter().enumerate().map(|(k, held)| k >= given.len() && held.delta_chi2 < 0.0 && held.by_zero_points.is_none()).collect();
    if !is_worse.contains(&true) {
        return Proposal { accepted, fit, proposed, left };
    }
    let is_left = |k: &usize| !is_worse[*k];
    let kept: Vec<usize> = (0..accepted.len()).filter(is_left).map(|k| accepted[k]).collect();
    let held: Vec<HeldOut> = (0..accepted.len()).filter(is_left).map(|k| held[k].clone()).collect();
    proposed.retain(|own| !kept.contains(&own.question));
    let fit = fitted(rows, &vec![true; rows.len()], &kept, None);
    proposed.extend(of(&kept, &fit, &held));
    Proposal { accepted: kept, fit, proposed, left }
}

/// The effects that were not accepted.
fn not_proposed(rows: &Rows, fit: &RowFit, accepted: &[usize]) -> Vec<NotProposed> {
    let mut answers = answers(rows, fit, accepted);
    // Of an effect with many shapes the most surprising answers for all.
    sort_by(&mut answers, |a, b| rows.questions[a.question].id.cmp(rows.questions[b.question].id).then(b.surprise.total_cmp(&a.surprise)));
    answers.dedup_by_key(|answer| rows.questions[answer.question].id);
    sort_by_key(&mut answers, |answer| answer.question);
    answers
        .into_iter()
        .map(|answer| NotProposed {
            id: rows.questions[answer.question].id,
            // Of a size on the wrong side of zero there is no surprise, but there may be something.
            p_value: (-if answer.surprise > 0.0 { answer.surprise } else { neg_ln_chi2_sf(answer.rank as f64, answer.statistic) }).exp(),
            size: fit.amplitude(rows, &rows.questions[answer.question].columns[0], |_| true),
            question: answer.question,
        })
        .collect()
}

/// What a trend explains is as surprising as the scatter of the frames without it.
fn as_surprising_as(trend: &Trend, proposed: &mut [Proposed], by_chance: &[f64]) {
    for own in proposed.iter_mut().filter(|own| own.question == trend.question) {
        own.surprise = own.surprise.max(trend.surprise);
        own.family_p = family_p(by_chance, own.surprise);
    }
}

/// Sizes of the columns of a fit, by question and parameter.
fn sizes_of(rows: &Rows, accepted: &[usize], fit: &RowFit) -> BTreeMap<(usize, usize), f64> {
    let places = accepted.iter().flat_map(|question| (0..rows.questions[*question].columns.len()).map(|k| (*question, k)));
    places.zip(fit.size.iter().copied()).collect()
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
    let count = own.columns.len();
    let covariance = fit.covariance.view((first, first), (count, count)).into_owned();
    let sizes: Vec<[f64; 2]> = (0..count).map(|j| [fit.size[first + j], covariance[(j, j)].max(0.0).sqrt()]).collect();
    let channels = by_channel(rows, [fit, &without], own, (fit.size[first], &held_out));
    let mut against: Vec<String> = held_out.fails().into_iter().collect();
    against.extend(disagreement(&channels));
    against.extend(confirmed::by_sky_alone(own, &channels));
    against.extend(implausible(own, &sizes));
    let (between_fields, scatters) = confirmed::by_fields(rows, [fit, &without], own, &sizes);
    against.extend(scatters);
    against.extend(own.sign.filter(|sign| sign * fit.size[first] < 0.0).map(|_| "its size has the wrong sign".to_owned()));
    Some(Proposed {
        question,
        sizes,
        covariance,
        statistic: answer.statistic,
        rank: answer.rank,
        surprise: answer.surprise,
        family_p: family_p(by_chance, answer.surprise),
        held_out,
        channels,
        alike: alike(rows, &without, accepted, &answer),
        between_fields,
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
    let step =
        question.parameters.iter().zip(sizes).filter(|(own, _)| is_gain_step(own.name)).map(|(_, size)| size[0].abs()).fold(0.0, f64::max);
    // Pixels that push charge aside share their noise: none has more of it.
    if question.id == <BrighterFatter as PassHead>::ID && sizes.get(1).is_some_and(|[lost, sigma]| *lost < -2.0 * sigma) {
        return Some("the noise of the sky grows with the light, and charge that is pushed aside makes it fall".to_owned());
    }
    let is_of_amplifiers = question.id == <AmplifierStep as CentroidShift>::ID;
    (is_of_amplifiers && step > MAX_GAIN_STEP).then(|| format!("no two amplifiers differ by {:.0} %", 100.0 * step))
}

/// Of what the places have found the columns here are a formula: what is left of it is not to be named after another effect. A mosaic of colours has
/// even and odd columns in it, and rows and diagonals, which no formula of these leaves.
fn beside(rows: &Rows, nothing: &RowFit, given: &[usize], mut own: Proposed) -> Proposed {
    for known in given {
        let cosine = cosine(rows, nothing, *known, own.question);
        let explained = answer(rows, nothing, *known).map_or(0.0, |answer| answer.statistic);
        let goes_beyond = cosine > CONTAINS && own.statistic > LEFT_BY_FORMULA * explained;
        if cosine > SHADOW && !goes_beyond {
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
        let (held, chi2_per_dof) = held_out.of_channel(rows, channel);
        let held_out_dof = chi2_per_dof.map(|(_, dof)| dof);
        let held_out_chi2_per_dof = chi2_per_dof.map(|(both, _)| both);
        found.insert(
            channel,
            ChannelMeasure { delta_chi2, held_out_delta_chi2: Some(held), held_out_chi2_per_dof, held_out_dof, amplitude, sigma },
        );
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

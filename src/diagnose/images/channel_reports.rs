//! What is reported of each channel: its verdict, what would show in it, and what is left without a name.

use std::collections::BTreeSet;

use super::judge::{ChannelState, Judged};
use super::noise::ordinary;
use super::sky_columns;
use crate::diagnose::causes::IMAGE_CAUSES;
use crate::diagnose::channels::{Channel, ChannelReport, ChannelVerdict, Detectable};
use crate::diagnose::diagnosis::{Diagnosis, Finding, RemainderMap, Unknown};
use crate::diagnose::wording;
use crate::effects::sky::glow::sky_glow;
use crate::effects::{IMAGE_EFFECTS, ImageEffect};
use crate::statistics::order::ascending;

/// What is found in 95 of 100 recordings lies so many standard errors above the threshold.
pub(super) const NINETY_FIVE: f64 = 1.645;

fn effect_of(id: &str) -> Option<&'static dyn ImageEffect> {
    IMAGE_EFFECTS.iter().chain(IMAGE_CAUSES).copied().find(|effect| effect.id() == id)
}

/// How large the effects with columns in a channel would have to be to be found.
fn detectable(judged: &Judged, channel: Channel) -> Vec<Detectable> {
    let ranges = judged.rows.ranges();
    let in_channel = |question: &super::rows::Question| {
        judged
            .rows
            .kinds
            .iter()
            .zip(&ranges)
            .any(|(kind, range)| kind.channel == channel && question.columns[0][range.clone()].iter().any(|value| *value != 0.0))
    };
    let mut all: Vec<Detectable> = judged
        .rows
        .questions
        .iter()
        .filter(|question| !question.is_part && in_channel(question))
        .filter_map(|question| {
            let of_stars = || effect_of(question.id).map(ImageEffect::ordinary);
            let is_glow = || sky_glow(question.id).is_some();
            // Ordinary sizes are of electrons.
            let is_in_counts = question.parameters.first().is_some_and(|own| own.unit.starts_with("DN/"));
            let of_rates = || sky_columns::ordinary(question.id).filter(|_| !is_in_counts);
            let of_sky = || of_rates().or_else(|| is_glow().then_some((1.0, "the model's own brightness")));
            let (ordinary, source) = match channel {
                Channel::Noise => ordinary(question.id),
                Channel::Background => of_sky().or_else(of_stars),
                _ => of_stars(),
            }?;
            let sigma = judged.fit.amplitude(&judged.rows, &question.columns[0], |_| true).map(|[_, sigma]| sigma);
            let size_95 = sigma.map(|sigma| ((2.0 * judged.threshold).sqrt() + NINETY_FIVE) * sigma);
            let spec = question.parameters.first()?;
            // A gain is told as a ratio, and its size is how far from one.
            let told = |size: f64| if spec.shown.is_root() { size.sqrt() } else { size };
            Some(Detectable {
                id: question.id.to_owned(),
                name: spec.name.to_owned(),
                unit: spec.unit.to_owned(),
                size_95: size_95.map(told),
                ordinary: told(ordinary),
                source: source.to_owned(),
                would_show: size_95.is_some_and(|size| size <= ordinary),
            })
        })
        .collect();
    let relative = |own: &Detectable| own.size_95.map_or(f64::INFINITY, |size| size / own.ordinary);
    ascending(&mut all, |a| relative(a));
    if channel == Channel::Background {
        // Of an effect with many shapes that which shows worst stands for all.
        let mut listed = BTreeSet::new();
        all.reverse();
        all.retain(|own| listed.insert(own.id.clone()));
        all.reverse();
    }
    all
}

pub(super) fn channel_report(diagnosis: &Diagnosis, judged: &Judged, channel: Channel, state: &ChannelState, alpha: f64) -> ChannelReport {
    let detectable = detectable(judged, channel);
    let is_of = |finding: &&Finding| finding.channels.get(&channel).is_some_and(Option::is_some);
    let has_findings = diagnosis
        .findings
        .iter()
        .any(|finding| is_of(&finding) && judged.proposed.iter().any(|own| judged.rows.questions[own.question].id == finding.id));
    let verdict = if state.left_p_value < alpha {
        ChannelVerdict::Unexplained
    } else if has_findings {
        ChannelVerdict::Explained
    } else if detectable.iter().any(|own| own.would_show) {
        ChannelVerdict::Consistent
    } else {
        ChannelVerdict::Undecided
    };
    let largest = state.located_by.first().map_or("", String::as_str);
    ChannelReport {
        looked_at: true,
        verdict,
        p_value: Some(state.p_value),
        p_value_is: None,
        located_by: state.located_by.clone(),
        reason: wording::reason(verdict, largest, &detectable),
        held_out_chi2_per_dof: state.held_out.map(|[per_dof, _]| per_dof),
        held_out_dof: state.held_out.map(|[_, dof]| dof),
        detectable,
    }
}

/// What is left of a channel and has no name.
pub(super) fn unknown(channel: Channel, state: &ChannelState) -> Unknown {
    let what = match channel {
        Channel::Background => "background between the stars".to_owned(),
        _ => format!("{} of the stars", channel.words()),
    };
    Unknown {
        channel,
        located_by: state.left_located_by.clone(),
        p_value: state.left_p_value,
        p_value_is: None,
        resembles: Vec::new(),
        vetoes: Vec::new(),
        map: None,
        field: RemainderMap::default(),
        sentence: format!(
            "In the {what} something is left that no effect of the registry explains: it goes with {}.",
            state.left_located_by.join(", ")
        ),
    }
}

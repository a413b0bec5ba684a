//! Each channel by itself: whether anything is in it, and what it goes with.

use std::collections::{BTreeMap, BTreeSet};

use super::proposed::ChannelState;
use super::row_fit::RowFit;
use super::rows::{Question, Rows};
use super::selection::{chance, directions};
use crate::diagnose::channels::Channel;
use crate::diagnose::null_distribution::family_p;
use crate::statistics::order::descending;
use crate::statistics::significance::neg_ln_chi2_sf;

/// A covariate locates what is left below this probability among all.
const LOCATES_P: f64 = 0.01;

/// What is said of every channel, before and after.
pub(super) fn channel_states(
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
        let own: Vec<&Question> =
            if of_stars.is_empty() { rows.questions.iter().filter(|question| !question.is_part).filter(is_of).collect() } else { of_stars };
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
            descending(&mut found, |a| a.0);
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
        states.insert(channel, ChannelState { p_value, located_by, left_p_value, left_located_by, held_out: None });
    }
    states
}

//! Light that is lost to the sum where images widen: nuisance parameters of the magnitudes.

use std::collections::BTreeMap;

use super::forward_selection::select;
use super::rows::{KNOWN_BEFOREHAND, Question, Row, Rows};
use crate::diagnose::channels::Channel;

/// Effects whose columns in the size of images are taken for the cause of a loss of light too, from this surprise on.
const SIZE_SURPRISE: f64 = 6.9;
/// Magnitudes that the sum of the light may lose where the variance of the image doubles: 0.1 where a lens goes out of focus from half a depth of
/// focus to a whole one; light in the far wings is not seen under the weight.
const LEAK_SIGMA: f64 = 0.15;
/// The variance of an image is larger or smaller than the typical one by at most this share of it, for its light to be told.
const MAX_WIDER: f64 = 0.8;

/// Where images widen some light is lost to the sum: what the images' sizes follow beyond chance, and its square, are nuisance parameters of the
/// magnitudes.
pub(super) fn take_size_out_of_flux(rows: &mut Rows, sigma_px: f64) {
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
    let keep: Vec<bool> = leak.iter().map(|change| change.abs() < MAX_WIDER).collect();
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

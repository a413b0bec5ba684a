//! Whether a name that the sky takes part in is confirmed: by the stars where both must show it, by what it leaves.

use std::collections::BTreeMap;

use statrs::distribution::{ContinuousCDF, StudentsT};

use super::background::Background;
use super::proposed::Proposed;
use super::row_fit::RowFit;
use super::rows::{Question, Rows};
use super::selection::{columns, directions};
use crate::diagnose::channels::{Channel, ChannelMeasure};
use crate::effects::optics::vignetting::Vignetting;
use crate::effects::pixel::PixelEffect;
use crate::statistics::significance::neg_ln_chi2_sf;

/// The stars must show a loss of light at this probability themselves (as −ln).
const SHOWN_BY_STARS: f64 = 6.9;
/// What the sky alone shows must be there in every field, at this probability.
const SHOWN_BY_FIELDS: f64 = 6.9;
/// Names of what the sky alone shows stand where they leave no more than this share of it,
const MAX_LEFT: f64 = 0.1;
/// or no more than chance does, at this probability (as −ln).
const LEFT_BY_CHANCE: f64 = 6.9;

/// Size and standard error of a first column beside the others of its effect, of what a fit with all of them has left. `without`: the fit of the same
/// noise without the effect.
pub(super) fn beside_the_others(rows: &Rows, [fit, without]: [&RowFit; 2], columns: &[Vec<f64>]) -> Option<[f64; 2]> {
    let mut own: Vec<nalgebra::DVector<f64>> = columns.iter().rev().map(|column| fit.response_beside(without, rows, column)).collect();
    for k in 0..own.len() {
        let (known, rest) = own.split_at_mut(k);
        let length = rest[0].norm();
        for _ in 0..2 {
            for known in known.iter().filter(|known| known.norm_squared() > 0.0) {
                let along = known.dot(&rest[0]) / known.norm_squared();
                rest[0].axpy(-along, known, 1.0);
            }
        }
        // What is nothing but rounding is no direction.
        if rest[0].norm() < 1e-6 * length {
            rest[0].fill(0.0);
        }
    }
    let first = own.pop()?;
    let square = first.norm_squared();
    let psi = nalgebra::DVector::from_column_slice(&fit.psi);
    (square > 0.0).then(|| [first.dot(&psi) / square, square.sqrt().recip()])
}

/// Light that is brighter in the middle of the frame looks like a loss at the corners, in the sky alone: stars must show it too.
pub(super) fn by_sky_alone(question: &Question, channels: &BTreeMap<Channel, ChannelMeasure>) -> Option<String> {
    if question.id != <Vignetting as PixelEffect>::ID || !channels.contains_key(&Channel::Background) {
        return None;
    }
    let is_shown =
        channels.get(&Channel::Flux).is_some_and(|flux| neg_ln_chi2_sf(question.columns.len() as f64, flux.delta_chi2) > SHOWN_BY_STARS);
    (!is_shown).then(|| "the sky alone shows it, and light that is brighter in the middle leaves the same there".to_owned())
}

/// Whether an effect is in the sky's rows and in no others.
fn is_of_sky_alone(rows: &Rows, question: &Question) -> bool {
    let is_in =
        |range: &std::ops::Range<usize>| question.columns.iter().any(|column| column[range.clone()].iter().any(|value| *value != 0.0));
    rows.kinds.iter().zip(rows.ranges()).all(|(kind, range)| is_in(&range) == (kind.channel == Channel::Background))
}

/// What the sky alone shows must be there field by field: its size in each is measured, and their scatter judges the mean (a test of Student's, the
/// fields weighted by what the effect does in them). A sky that happens to lean one way in most fields scatters from field to field.
pub(super) fn by_fields(rows: &Rows, without: &RowFit, question: &Question, sizes: &[[f64; 2]]) -> Option<String> {
    if !is_of_sky_alone(rows, question) {
        return None;
    }
    let mut own = nalgebra::DVector::zeros(rows.len());
    for (column, [size, _]) in question.columns.iter().zip(sizes) {
        own += without.response(rows, column) * *size;
    }
    let mut fields: BTreeMap<usize, [f64; 2]> = BTreeMap::new();
    for ((row, of_effect), psi) in rows.rows().zip(own.iter()).zip(&without.psi) {
        if *of_effect != 0.0 {
            let sums = fields.entry(row.frame).or_default();
            *sums = [sums[0] + of_effect * psi, sums[1] + of_effect * of_effect];
        }
    }
    let (along, square) = fields.values().fold((0.0, 0.0), |sum, field| (sum.0 + field[0], sum.1 + field[1]));
    let (mean, count) = (along / square, fields.len() as f64);
    let scatter =
        fields.values().map(|field| (field[0] - mean * field[1]).powi(2)).sum::<f64>().sqrt() / square * (count / (count - 1.0)).sqrt();
    let p_value = StudentsT::new(0.0, 1.0, count - 1.0).ok().map(|law| 2.0 * law.sf((mean / scatter).abs()))?;
    (-p_value.ln() < SHOWN_BY_FIELDS).then(|| format!("its size scatters from field to field: p = {p_value:.1e} over {count} fields"))
}

/// Names that only the sky speaks for are withheld where most of what it shows is left beside them: then the shape is another one.
pub(super) fn withhold_what_leaves_much(rows: &Rows, background: &Background, [nothing, fit]: [&RowFit; 2], proposed: &mut [Proposed]) {
    let columns: Vec<Vec<f64>> = background.patterns.iter().flat_map(|pattern| pattern.columns.iter().cloned()).collect();
    let shown = |of: &RowFit| -> (f64, f64) {
        let psi = nalgebra::DVector::from_column_slice(&of.psi);
        let basis = directions(rows, of, &columns);
        (basis.iter().map(|direction| direction.dot(&psi).powi(2)).sum(), basis.len() as f64)
    };
    let ((before, _), (after, rank)) = (shown(nothing), shown(fit));
    if after <= rank || after - rank < MAX_LEFT * before || neg_ln_chi2_sf(rank, after) < LEFT_BY_CHANCE {
        return;
    }
    for own in proposed {
        if is_of_sky_alone(rows, &rows.questions[own.question]) {
            own.against.push(format!(
                "{:.0} % of what the sky shows is left beside it: its shape is another one",
                100.0 * (after - rank) / before
            ));
        }
    }
}

/// The fit with the effects that stand alone, under the noise of all; nothing where all do.
pub(super) fn standing(rows: &Rows, (given, accepted): (&[usize], &[usize]), fit: &RowFit, proposed: &[Proposed]) -> Option<RowFit> {
    let is_withheld = |question: &usize| proposed.iter().any(|own| own.question == *question && !own.against.is_empty());
    let kept: Vec<usize> = accepted.iter().copied().filter(|question| given.contains(question) || !is_withheld(question)).collect();
    (kept.len() < accepted.len()).then(|| RowFit::under(rows, &fit.take, &columns(rows, &kept), fit))
}

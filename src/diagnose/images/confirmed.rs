//! Whether a name that the sky takes part in is confirmed: by the stars where both must show it, by what it leaves.

use std::collections::BTreeMap;

use statrs::distribution::{ContinuousCDF, StudentsT};

use super::background::Background;
use super::proposed::Proposed;
use super::row_fit::RowFit;
use super::rows::{KNOWN_BEFOREHAND, Question, Rows};
use super::selection::{AS_GOOD, columns, directions};
use super::sky_columns::AMPLIFIER_GLOW;
use super::turns::of_channel;
use crate::diagnose::causes::{EXTINCTION, GAIN_NOISE};
use crate::diagnose::channels::{Channel, ChannelMeasure};
use crate::effects::detector::amplifier_step::AmplifierHalves;
use crate::effects::optics::vignetting::Vignetting;
use crate::effects::pixel::PixelEffect;
use crate::statistics::significance::neg_ln_chi2_sf;

/// The stars must show a loss of light at this probability themselves (as −ln).
const SHOWN_BY_STARS: f64 = 6.9;
/// What the sky alone shows must be there in every field, at this probability (as −ln).
const SHOWN_BY_FIELDS: f64 = 6.9;
/// What thin clouds over parts of the frames imitate must be there in every field, at this one: the stars of a frame lose light together.
const EXTINCTION_BY_FIELDS: f64 = 4.6;
/// Where clouds are found, at this one.
const EXTINCTION_BESIDE_CLOUDS: f64 = 6.9;
/// Names of what the sky alone shows stand where they leave no more than this share of it,
const MAX_LEFT: f64 = 0.1;
/// or no more than chance does, at this probability (as −ln).
const LEFT_BY_CHANCE: f64 = 6.9;
/// χ² of the noise per degree of freedom that a line against the level may leave,
const MAX_NOISE: f64 = 1.4;
/// of which so much is no more than errors that are stated too small.
const ERRORS_OFF: f64 = 1.1;

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

/// What the sky alone shows, and extinction, must be there field by field: its size in each is measured, and their scatter judges the mean (a test of Student's, the
/// fields weighted by what the effect does in them). A sky that happens to lean one way in most fields, and clouds, scatter from field to field. Sizes are
/// those of the fit plus what each field has left beside it: without the effect, stars that it changes by many standard deviations would be cut as outliers. The
/// p-value of that, where it is asked and there are fields for it, and what speaks against the effect.
pub(super) fn by_fields(
    rows: &Rows,
    [fit, without]: [&RowFit; 2],
    question: &Question,
    sizes: &[[f64; 2]],
) -> (Option<f64>, Option<String>) {
    let least = match question.id {
        EXTINCTION => EXTINCTION_BY_FIELDS,
        _ if is_of_sky_alone(rows, question) => SHOWN_BY_FIELDS,
        _ => return (None, None),
    };
    let mut own = nalgebra::DVector::zeros(rows.len());
    for (column, [size, _]) in question.columns.iter().zip(sizes) {
        own += fit.response_beside(without, rows, column) * *size;
    }
    let mut fields: BTreeMap<usize, [f64; 2]> = BTreeMap::new();
    for (k, ((row, of_effect), psi)) in rows.rows().zip(own.iter()).zip(&fit.psi).enumerate() {
        // What is fitted beside it spreads a column over rows of other fields, and a prior is no field.
        let is_own = row.frame != KNOWN_BEFOREHAND && question.columns.iter().any(|column| column[k] != 0.0);
        if is_own && *of_effect != 0.0 {
            let sums = fields.entry(row.frame).or_default();
            *sums = [sums[0] + of_effect * (of_effect + psi), sums[1] + of_effect * of_effect];
        }
    }
    let (along, square) = fields.values().fold((0.0, 0.0), |sum, field| (sum.0 + field[0], sum.1 + field[1]));
    let (mean, count) = (along / square, fields.len() as f64);
    if fields.len() < 2 {
        return (None, Some("one field alone shows it: whether others do is not known".to_owned()));
    }
    let scatter =
        fields.values().map(|field| (field[0] - mean * field[1]).powi(2)).sum::<f64>().sqrt() / square * (count / (count - 1.0)).sqrt();
    let p_value = StudentsT::new(0.0, 1.0, count - 1.0).ok().map(|law| 2.0 * law.sf((mean / scatter).abs()));
    let does_scatter = |p: &f64| -p.ln() < least;
    (p_value, p_value.filter(does_scatter).map(|p| format!("its size scatters from field to field: p = {p:.1e} over {count} fields")))
}

/// Clouds that are found have slopes over the frames of their own, which look like extinction in a few of them.
pub(super) fn by_clouds(id: &str, between_fields: Option<f64>) -> Option<String> {
    let p_value = between_fields.filter(|p| id == EXTINCTION && -p.ln() < EXTINCTION_BESIDE_CLOUDS)?;
    Some(format!("clouds over parts of the frames do the same: its size scatters from field to field (p = {p_value:.1e})"))
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

/// A sky that leans or bends evenly over the frame (the light of a lens, of a wall nearby) is told as well by the place and its squares, which point at no
/// corner and have no step: neither a glow nor halves that differ have the name then.
pub(super) fn withhold_what_a_gradient_tells(
    rows: &Rows,
    background: &Background,
    (accepted, fit): (&[usize], &RowFit),
    proposed: &mut [Proposed],
) {
    /// What has a shape of its own, and what a gradient lacks of it.
    const SHAPES: [(&str, &str); 2] = [(AMPLIFIER_GLOW, "points at no corner"), (<AmplifierHalves as PixelEffect>::ID, "has no step")];
    let columns_of = |pattern: &Question| match pattern.follows {
        "x" | "y" | "field-azimuth" => pattern.columns.clone(),
        "field-radius" => pattern.columns[..1].to_vec(),
        _ => Vec::new(),
    };
    let squares: Vec<Vec<f64>> = background.patterns.iter().flat_map(columns_of).collect();
    for own in proposed {
        let Some((_, lacks)) = SHAPES.iter().find(|(id, _)| *id == rows.questions[own.question].id) else { continue };
        let others: Vec<usize> = accepted.iter().copied().filter(|other| *other != own.question).collect();
        let without = RowFit::under(rows, &fit.take, &columns(rows, &others), fit);
        let psi = nalgebra::DVector::from_column_slice(&without.psi);
        let basis = directions(rows, &without, &squares);
        let told: f64 = basis.iter().map(|direction| direction.dot(&psi).powi(2)).sum();
        if neg_ln_chi2_sf(basis.len() as f64, told) > own.surprise - AS_GOOD {
            own.against.push(format!("a sky that bends evenly over the frame tells as much, and {lacks}"));
        }
    }
}

/// A wrong gain or read noise is a line of the noise against the level. Where frames that took no part keep much beside it, the noise is another's: of
/// charge that is trapped, of a smoothing. `left`: by kind χ² of what took no part, and its degrees of freedom.
pub(super) fn withhold_gain_beside_other_noise(rows: &Rows, left: &[[f64; 2]], proposed: &mut [Proposed]) {
    let [chi2, dof] = of_channel(rows, left, Channel::Noise);
    for own in proposed.iter_mut().filter(|own| rows.questions[own.question].id == GAIN_NOISE) {
        own.against.extend(leaves_other_noise([chi2, dof], own.held_out.delta_chi2));
    }
}

/// The same of the numbers: `explained`: by how much the line makes χ² less.
fn leaves_other_noise([chi2, dof]: [f64; 2], explained: f64) -> Option<String> {
    let left = chi2 - dof;
    let is_much = chi2 > MAX_NOISE * dof && left > MAX_LEFT * (left + explained.max(0.0));
    (is_much && neg_ln_chi2_sf(dof, chi2 / ERRORS_OFF) > LEFT_BY_CHANCE).then(|| {
        format!(
            "the noise of frames that took no part keeps χ² {:.1} per degree of freedom beside it: it is no line against the level",
            chi2 / dof
        )
    })
}

/// The fit with the effects that stand alone, under the noise of all; nothing where all do.
pub(super) fn standing(rows: &Rows, (given, accepted): (&[usize], &[usize]), fit: &RowFit, proposed: &[Proposed]) -> Option<RowFit> {
    let is_withheld = |question: &usize| proposed.iter().any(|own| own.question == *question && !own.against.is_empty());
    let kept: Vec<usize> = accepted.iter().copied().filter(|question| given.contains(question) || !is_withheld(question)).collect();
    (kept.len() < accepted.len()).then(|| RowFit::under(rows, &fit.take, &columns(rows, &kept), fit))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn extinction_stands_beside_clouds_where_every_field_shows_it() {
        assert!(by_clouds(EXTINCTION, Some(5e-3)).is_some());
        assert!(by_clouds(EXTINCTION, Some(1e-4)).is_none() && by_clouds(GAIN_NOISE, Some(5e-3)).is_none());
    }

    #[test]
    fn a_line_of_the_noise_stands_only_where_it_leaves_little() {
        // As frames without another effect have it, and with charge that is trapped.
        assert_eq!(leaves_other_noise([1.15 * 570.0, 570.0], 90.0), None);
        assert!(leaves_other_noise([3.0 * 402.0, 402.0], 300.0).is_some_and(|reason| reason.contains("χ² 3.0")));
        // A gain that is wrong by far is one whatever small thing is beside it, and few numbers tell nothing.
        assert_eq!(leaves_other_noise([2.0 * 402.0, 402.0], 9000.0), None);
        assert_eq!(leaves_other_noise([9.0, 6.0], 10.0), None);
    }
}

//! Adequacy of a finding's name: tests that tell the true cause of a mismatch from an effect that only resembles it.

use super::diagnosis::Rival;
use super::evidence::Evidence;
use super::final_fit::FinalFit;
use super::fit_state::{AGREES, FitState, SelectedEffect, columns};
use super::linear_fit::Fit;
use super::linear_system::Whitened;
use super::patterns::{self, IN_THE_FIELD, Named};
use super::plausible_size;
use super::rivals::rivals;
use super::scan::{Asks, Scan};
use super::wild_bootstrap::{LEVEL, WildBootstrap};
use crate::identify::ControlPoints;
use crate::statistics::significance::neg_ln_chi2_sf;

/// A veto needs p below this.
const VETO_P: f64 = 1e-3;
/// An effect is superseded by a pattern if less than this share of its evidence is left beside it.
const SUPERSEDED: f64 = 0.3;
/// Blocks of time.
const TIME_BLOCKS: usize = 4;
/// An improvement in one frame (or star) above this share,
const CONCENTRATED: f64 = 0.5;
/// and above this many times its share of the information.
const DISPROPORTIONATE: f64 = 2.5;

/// p-value of the mean against the scatter between frames, below which an effect stands beside something that is not explained.
const BESIDE_OTHERS: f64 = 1e-3;

/// What speaks against a name; empty if nothing does. `scan` holds the covariates' patterns beside the whole model.
pub(super) fn vetoes(named: &Named, scan: &Scan, statistic: f64) -> Vec<String> {
    let mut found: Vec<String> = patterns::veto(named, scan, statistic).into_iter().collect();
    let solved = named.solved;
    let effect = solved.evidence.hypotheses[solved.entries[named.k].hypothesis].effect;
    let over_time = || over_time(&solved.evidence, &solved.stand, &solved.entries, named.k).filter(|p| *p < VETO_P);
    if let (false, Some(p)) = (effect.facts().follows_sky_level, over_time()) {
        found.push(format!("its size is not the same through the recording (p = {p:.1e})"));
    }
    found
}

/// Whether the frames (or stars) do not agree on it. `is_left`: whether something stays unexplained beside all findings. The stars of a frame may share
/// errors then, and the effect may be the one of many that follows them best by chance: the scatter between frames is judged more strictly.
pub(super) fn disagreement(signs: &WildBootstrap, is_left: bool) -> Option<String> {
    let level = if is_left { BESIDE_OTHERS } else { LEVEL };
    if let Some(p) = signs.between_frames.filter(|p| *p >= level) {
        return Some(format!("its size scatters between frames, as errors that the stars of a frame share make it (p = {p:.1e})"));
    }
    let p = signs.p_value.filter(|p| *p >= LEVEL)?;
    Some(format!("the {} do not agree on it (choosing a sign for each does as well in {:.1} % of the choices)", signs.units, 100.0 * p))
}

/// Whether an effect is not needed beside the pattern that remains: a focal length that drifts with time resembles one that follows a telescope's
/// focus, and if the residuals still follow the focus it is the focus that explains both. `threshold` is the surprise that a finding needs.
pub(super) fn superseded(
    evidence: &Evidence,
    stand: &FitState,
    scan: &Scan,
    entries: &[SelectedEffect],
    k: usize,
    threshold: f64,
) -> Option<String> {
    // Patterns over the field are so free that they hold every static effect: they have a test of their own.
    let in_the_field = |index: usize| IN_THE_FIELD.contains(&evidence.covariates[index].name.as_str());
    let of_covariates = scan.groups.iter().filter(|group| matches!(group.asks, Asks::Covariate(index) if !in_the_field(index)));
    let most = of_covariates.map(|group| (group, group.surprise())).max_by(|a, b| a.1.total_cmp(&b.1));
    let (group, surprise) = most.filter(|(_, surprise)| *surprise > threshold)?;
    let Asks::Covariate(index) = group.asks else { return None };
    let covariate = &evidence.covariates[index];
    let own = stand.white(evidence, &entries[k..=k]);
    let without = stand.without(evidence, entries, k);
    let mut beside = without.more.clone();
    beside.extend(covariate.patterns[group.pattern].iter().map(|column| evidence.white(&stand.noise, column)));
    let with_pattern = stand.beside(beside);
    let (before, _) = without.score(&own);
    let (after, rank) = with_pattern.score(&own);
    (neg_ln_chi2_sf(rank as f64, after) < threshold && after < SUPERSEDED * before).then(|| {
        let name = &covariate.name;
        format!("residuals still follow {name} (p = {:.1e}), and beside a pattern of {name} it is not needed", (-surprise).exp())
    })
}

/// Whether a size that the recording tells beforehand is another: judged where everything is solved, what resembles the effect free beside it.
pub(super) fn amplitude_veto(
    before: &Evidence,
    stand: &FitState,
    entries: &[SelectedEffect],
    k: usize,
    solved: &FinalFit,
) -> Option<String> {
    let hypothesis = &before.hypotheses[entries[k].hypothesis];
    let id = hypothesis.id();
    if hypothesis.in_force && hypothesis.effect.facts().counts_from_model {
        return None; // another epoch is the finding itself
    }
    let variant = &hypothesis.variants[entries[k].variant];
    if let Some(unnatural) = plausible_size::veto(solved, k, hypothesis, variant) {
        return Some(unnatural);
    }
    let listed: Vec<Rival> = rivals(before, stand, entries, k).into_iter().map(|own| own.rival).collect();
    let [ratio, error] = solved.ratio_beside_rivals(k, variant, &listed)?;
    // That what the model has is not there at all is a finding too.
    let is_absent = hypothesis.in_force && ratio.abs() <= AGREES * error;
    ((ratio - 1.0).abs() > AGREES * error && !is_absent)
        .then(|| format!("its size is {ratio:.3} ± {error:.3} of what is known of it: not {id} alone, or more than this effect"))
}

/// Probability that the amplitude in four blocks of time differs as much by chance.
fn over_time(evidence: &Evidence, stand: &FitState, entries: &[SelectedEffect], k: usize) -> Option<f64> {
    let frames = evidence.frames.len();
    let hours: Vec<Option<f64>> = evidence.frames.iter().map(|(_, observation)| observation.time_offset_h).collect();
    let (least, most) = hours.iter().flatten().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| (a.min(*t), b.max(*t)));
    if frames < 2 * TIME_BLOCKS || (most.is_finite() && most - least <= 0.0) {
        return None;
    }
    let own: Vec<Whitened> = stand.white(evidence, &entries[k..=k]);
    let mut split = Vec::new();
    for column in &own {
        for block in 1..TIME_BLOCKS {
            let of = |(k, value): (usize, &f64)| if evidence.place[k / 2] * TIME_BLOCKS / frames == block { *value } else { 0.0 };
            split.push(column.iter().enumerate().map(of).collect::<Whitened>());
        }
    }
    // What is there by nature and not yet in the model may vary as it likes: it is free beside.
    let by_nature = evidence.hypotheses.iter().enumerate().filter(|(index, hypothesis)| {
        hypothesis.known.is_some() && !hypothesis.in_force && entries.iter().all(|entry| entry.hypothesis != *index)
    });
    let mut beside = stand.more.clone();
    for (index, _) in by_nature.filter(|(_, hypothesis)| hypothesis.variants.len() == 1) {
        beside.extend(stand.white(evidence, &[SelectedEffect { hypothesis: index, variant: 0 }]));
    }
    let (t, rank) = stand.beside(beside).score(&split);
    (rank > 0).then(|| (-neg_ln_chi2_sf(rank as f64, t)).exp())
}

/// Whether one frame or one star carries the improvement out of proportion. At the baseline's linearisation, where the effect is not yet
/// in the model.
pub(super) fn concentration(
    evidence: &Evidence,
    points: &ControlPoints,
    stand: &FitState,
    entries: &[SelectedEffect],
    k: usize,
) -> Vec<String> {
    let white = |entry: &SelectedEffect| stand.white(evidence, std::slice::from_ref(entry));
    let others: Vec<Whitened> = entries.iter().enumerate().filter(|(index, _)| *index != k).flat_map(|(_, entry)| white(entry)).collect();
    let without = Fit::new(&stand.system, &stand.take, &others.iter().collect::<Vec<_>>());
    let tried = white(&entries[k]);
    let (mut gain, mut information) = (vec![0.0; evidence.images.len()], vec![0.0; evidence.images.len()]);
    let rest: Vec<Whitened> = tried.iter().map(|column| without.project(column)).collect();
    let behind: usize = entries[k + 1..].iter().map(|entry| columns(evidence, std::slice::from_ref(entry)).count()).sum();
    let first = stand.fit.change.len() - tried.len() - behind;
    for image in (0..evidence.images.len()).filter(|image| stand.take[*image]) {
        let of = |residual: &[f64]| residual[2 * image].powi(2) + residual[2 * image + 1].powi(2);
        gain[image] = of(&without.residual) - of(&stand.fit.residual);
        // What the effect as found moves this image by.
        let mut moved = [0.0; 2];
        for (j, column) in rest.iter().enumerate() {
            for axis in 0..2 {
                moved[axis] += stand.fit.change[first + j] * column[2 * image + axis];
            }
        }
        information[image] = moved[0] * moved[0] + moved[1] * moved[1];
    }
    let total: f64 = gain.iter().sum();
    let all: f64 = information.iter().sum();
    if total <= 0.0 || all <= 0.0 {
        return Vec::new();
    }
    let mut found = Vec::new();
    if evidence.frames.len() >= 4 {
        let (mut by_frame, mut expected) = (vec![0.0; evidence.frames.len()], vec![0.0; evidence.frames.len()]);
        for image in 0..gain.len() {
            by_frame[evidence.place[image]] += gain[image] / total;
            expected[evidence.place[image]] += information[image] / all;
        }
        for frame in 0..by_frame.len() {
            if by_frame[frame] > CONCENTRATED.max(DISPROPORTIONATE * expected[frame]) {
                found.push(format!("{:.0} % of the improvement lie in frame {}", 100.0 * by_frame[frame], evidence.frames[frame].0));
            }
        }
    }
    let mut stars: std::collections::BTreeMap<[u64; 3], [f64; 2]> = std::collections::BTreeMap::new();
    for image in 0..gain.len() {
        let of = stars.entry(points.points[evidence.images[image].point].star.direction.map(f64::to_bits)).or_default();
        of[0] += gain[image] / total;
        of[1] += information[image] / all;
    }
    if let Some((star, [share, _])) =
        stars.into_iter().find(|(_, [share, expected])| *share > CONCENTRATED.max(DISPROPORTIONATE * expected))
    {
        let [x, y, z] = star.map(f64::from_bits);
        let (right_ascension, declination) = (y.atan2(x).to_degrees().rem_euclid(360.0), z.asin().to_degrees());
        found.push(format!("{:.0} % of the improvement lie in one star, at {right_ascension:.2}° {declination:+.2}°", 100.0 * share));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_speak_more_clearly_where_something_is_left() {
        let signs = |p| WildBootstrap { units: "parts of frames", effective: 30.0, p_value: Some(1e-4), between_frames: Some(p) };
        assert_eq!(disagreement(&signs(5e-3), false), None);
        assert!(disagreement(&signs(5e-3), true).is_some() && disagreement(&signs(0.02), false).is_some());
        assert_eq!(disagreement(&signs(5e-4), true), None);
    }
}

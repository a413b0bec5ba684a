//! What is withheld beside other findings: they leave the same trace, and are the more usual cause.

use super::confirmed::by_clouds;
use super::counted::{COMPRESSED, FoundByCount};
use super::judge::{Judged, Proposed};
use crate::diagnose::causes::{CLOUDS, COMPRESSION, GAIN_NOISE};
use crate::diagnose::channels::{Channel, ChannelVerdict};
use crate::diagnose::diagnosis::{Diagnosis, EffectState, Finding};
use crate::effects::detector::amplifier_step::{AmplifierStep, is_gain_step};
use crate::effects::detector::brighter_fatter::BrighterFatter;
use crate::effects::detector::charge_transfer_inefficiency::ChargeTransferInefficiency;
use crate::effects::detector::{even_odd, magnitude_equation, overshoot, s_curve};
use crate::effects::pixel::pass::PassHead;
use crate::effects::{CentroidShift, ids};

/// What a compression does to places of stars looks like these causes in the pixels.
const LIKE_COMPRESSION: [&str; 6] = [
    ids::STRAY_LIGHT,
    ids::BAYER,
    <s_curve::SCurve as CentroidShift>::ID,
    <even_odd::EvenOdd as CentroidShift>::ID,
    <overshoot::Overshoot as CentroidShift>::ID,
    <magnitude_equation::MagnitudeEquation as CentroidShift>::ID,
];
/// What changes the noise of the pixels, so that the declared gain seems wrong.
const CHANGE_NOISE: [&str; 5] = [
    ids::ADC,
    ids::NONLINEARITY,
    <BrighterFatter as PassHead>::ID,
    <ChargeTransferInefficiency as CentroidShift>::ID,
    <overshoot::Overshoot as CentroidShift>::ID,
];

/// What the rounding of a compression does to places of stars is not named after other causes in the pixels.
pub(super) fn withhold_shadows(diagnosis: &mut Diagnosis) {
    let is_shadow = |id: &str| LIKE_COMPRESSION.contains(&id);
    let shadows: Vec<Finding> = diagnosis.findings.extract_if(.., |finding| is_shadow(&finding.id)).collect();
    for shadow in shadows {
        if let Some(status) = diagnosis.effects.iter_mut().find(|own| own.id == shadow.id) {
            status.status = EffectState::Withheld;
            status.held_out_delta_chi2 = Some(shadow.held_out_delta_chi2);
            status.upper_limit_95 = None;
            COMPRESSED.clone_into(&mut status.reason);
        }
        if diagnosis.channels.astrometry.verdict == ChannelVerdict::Explained {
            diagnosis.channels.astrometry.verdict = ChannelVerdict::Unexplained;
        }
    }
}

/// Why a proposal is withheld: by itself, and since something else that is there does the same to the noise.
pub(super) fn against(diagnosis: &Diagnosis, judged: &Judged, proposed: &Proposed, by_count: &FoundByCount) -> Vec<String> {
    let beside = beside_others(diagnosis, judged, proposed, by_count).or_else(|| by_memory(judged, proposed, by_count));
    proposed.against.iter().cloned().chain(beside).collect()
}

/// What else that is there explains a proposal.
fn beside_others(diagnosis: &Diagnosis, judged: &Judged, proposed: &Proposed, by_count: &FoundByCount) -> Option<String> {
    let id = |own: &Proposed| judged.rows.questions[own.question].id;
    let is_of_noise = proposed.channels.keys().all(|channel| *channel == Channel::Noise);
    let by_images = judged.proposed.iter().filter(|own| own.against.is_empty()).map(id);
    let by_places = diagnosis.findings.iter().map(|finding| finding.id.as_str());
    let there: Vec<&str> = by_places.chain(by_images).chain(by_count.ids.iter().copied()).collect();
    let are_clouds = by_count.ids.contains(&CLOUDS);
    done_by_others(id(proposed), is_of_noise, &there)
        .or_else(|| by_clouds(id(proposed), proposed.between_fields.filter(|_| are_clouds)))
        .or_else(|| by_two_gains(judged, proposed))
        .or_else(|| by_coupling(judged, proposed, by_count))
}

/// Of halves with two gains the declared gain is that of neither, or of one: the noise of all pixels shows one that is off by up to the step.
fn by_two_gains(judged: &Judged, proposed: &Proposed) -> Option<String> {
    const STEP: &str = <AmplifierStep as CentroidShift>::ID;
    let id = |own: &Proposed| judged.rows.questions[own.question].id;
    let is_step = |own: &&Proposed| id(own) == STEP && own.against.is_empty();
    let found = judged.proposed.iter().find(is_step)?;
    let gains = judged.rows.questions[found.question].parameters.iter().zip(&found.sizes).filter(|(own, _)| is_gain_step(own.name));
    let step = gains.map(|(_, size)| *size).max_by(|a, b| a[0].abs().total_cmp(&b[0].abs()))?;
    let gain = proposed.sizes.first().copied().filter(|_| id(proposed) == GAIN_NOISE)?;
    let beside = proposed.sizes.get(1).copied().unwrap_or([0.0, 1.0]);
    is_within_step(gain, beside, step).then(|| format!("{STEP} gives the two halves gains that differ by as much"))
}

/// What one amplifier adds of another's counts raises the level of the sky, and its noise by no more than the square of that share.
fn by_coupling(judged: &Judged, proposed: &Proposed, by_count: &FoundByCount) -> Option<String> {
    let coupling = by_count.coupling?;
    let is_gain = judged.rows.questions[proposed.question].id == GAIN_NOISE;
    let gain = proposed.sizes.first().copied().filter(|_| is_gain)?;
    let beside = proposed.sizes.get(1).copied().unwrap_or([0.0, 1.0]);
    is_within_step(gain, beside, coupling).then(|| "the crosstalk raises the level by as much, and not the noise".to_owned())
}

/// Noise that neighbours share along one axis has another variance: a read-out that remembers, charge that arrives late. Which of them is not told, so that
/// the channel stays unexplained.
fn by_memory(judged: &Judged, proposed: &Proposed, by_count: &FoundByCount) -> Option<String> {
    let memory = by_count.gain_by_memory?;
    let is_gain = judged.rows.questions[proposed.question].id == GAIN_NOISE;
    let gain = proposed.sizes.first().copied().filter(|[ratio, _]| is_gain && ratio * memory[0] > 0.0)?;
    let beside = proposed.sizes.get(1).copied().unwrap_or([0.0, 1.0]);
    is_within_step(gain, beside, memory)
        .then(|| "neighbouring pixels share noise along one axis alone, which changes its variance by as much".to_owned())
}

/// Whether the ratio of a gain (less one) is no farther off than a step of the gains, and nothing but a gain is (sizes with their errors). In a frame the half
/// with more counts has the square of that more noise: over both the line of noise against level is steeper, and lies lower at no light. So a read noise that
/// is less than declared cannot be told beside a step.
fn is_within_step(gain: [f64; 2], beside: [f64; 2], step: [f64; 2]) -> bool {
    const SIGMAS: f64 = 3.0;
    gain[0].abs() < step[0].abs() + SIGMAS * gain[1].hypot(step[1]) && beside[0] < SIGMAS * beside[1]
}

/// Whether a gain that nothing else speaks against seems wrong since something that is there changes the noise.
pub(super) fn is_gain_explained(diagnosis: &Diagnosis, judged: &Judged, by_count: &FoundByCount) -> bool {
    let is_gain = |own: &&Proposed| judged.rows.questions[own.question].id == GAIN_NOISE && own.against.is_empty();
    judged.proposed.iter().find(is_gain).is_some_and(|own| beside_others(diagnosis, judged, own, by_count).is_some())
}

/// What else that is there explains an effect.
fn done_by_others(id: &str, is_of_noise: bool, there: &[&str]) -> Option<String> {
    if is_of_noise && there.contains(&COMPRESSION) {
        return Some(COMPRESSED.to_owned());
    }
    let other = there.iter().find(|other| id == GAIN_NOISE && CHANGE_NOISE.contains(other))?;
    Some(format!("{other} changes the noise of the pixels too"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_gains_explain_one_that_is_off_by_no_more_than_their_difference() {
        let step = [-0.0393, 0.0007];
        assert!(is_within_step([0.0287, 0.0037], [-1.1, 3.5], step));
        assert!(!is_within_step([0.08, 0.0037], [-1.1, 3.5], step));
        // Crosstalk of 1.7 %.
        assert!(is_within_step([0.0187, 0.0035], [-0.21, 0.64], [0.0166, 0.0007]));
        assert!(is_within_step([-0.0369, 0.0054], [-92.6, 15.4], [0.1184, 0.0016]));
        // A read noise that is more than declared is no matter of two gains.
        assert!(!is_within_step([0.0287, 0.0037], [30.0, 3.5], step));
    }

    #[test]
    fn a_gain_is_not_wrong_where_charge_is_lost_or_blocks_are_rounded() {
        assert_eq!(done_by_others(GAIN_NOISE, true, &["vignetting", "hot-pixels"]), None);
        for other in CHANGE_NOISE {
            assert!(done_by_others(GAIN_NOISE, true, &["vignetting", other]).is_some_and(|reason| reason.starts_with(other)));
            // Other effects of the noise stand beside it.
            assert_eq!(done_by_others("banding", true, &[other]), None);
        }
        assert_eq!(done_by_others("banding", true, &[COMPRESSION]).as_deref(), Some(COMPRESSED));
        // What stars show too is no matter of rounding.
        assert_eq!(done_by_others("vignetting", false, &[COMPRESSION]), None);
    }
}

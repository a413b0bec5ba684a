//! What brightness and shape say, as it stands in the result: findings, statuses, channels.

use std::collections::{BTreeMap, BTreeSet};

use super::channel_reports::{NINETY_FIVE, channel_report, unknown};
use super::copies::copies;
use super::counted::{Counted, FoundByCount, counted};
use super::ends_and_rays::{cosmic_rays, field_stop, streaks};
use super::expected_stars::{MIN_SNR, StarMeasurement};
use super::frame_levels::{Air, TestedFrame};
use super::halo::{self, halo};
use super::jitter::jitter;
use super::judge::{Asked, ChannelState, Judged, Pixels, Proposed, judge};
use super::measured_detector::measured_detector;
use super::noise_kind::DeclaredDetector;
use super::profiles::shape_map;
use super::rendered::StampCamera;
use super::rows::{Parameter, Question};
use super::shared_noise::{gain_by_memory, shared_noise};
use super::single_frames::single_frames;
use super::sky_view::SkyView;
use super::stars::MIN_ROWS;
use super::turns::HeldOut;
use super::withheld::{against, is_gain_explained, withhold_shadows};
use crate::diagnose::causes::{COMPRESSION, INTRAPIXEL_RESPONSE, MOTION_SMEAR};
use crate::diagnose::channels::{ByChannel, Channel, ChannelReport, ChannelVerdict};
use crate::diagnose::diagnosis::{ColumnSource, Diagnosis, EffectState, EffectStatus, Finding, FoundParameter, Limit, Signs};
use crate::diagnose::options::DiagnoseOptions;
use crate::diagnose::wording;
use crate::effects::detector::amplifier_step::{AmplifierHalves, is_gain_step, relative_step};
use crate::effects::optics::vignetting::{Vignetting, losses};
use crate::effects::pixel::PixelEffect;
use crate::pixel_statistics::{ElsewhereFrame, LOOKS, PixelStatistics};
use crate::statistics::significance::deviations;

/// Fewer frames and stars than this tell nothing of a channel.
const MIN_STARS: usize = 30;
/// Frames that are tested at most: every one has a zero point, and a fit costs the square of their number.
const MAX_FRAMES: usize = 24;
/// Of an effect whose score has a smaller probability by chance it is not said that it was not found.
const SIGNIFICANT: f64 = 1e-4;

/// What was measured of a recording's images beside the places of stars.
#[derive(Clone, Copy, Debug, Default)]
pub struct ImageMeasurements<'a> {
    /// The stars.
    pub stars: &'a [StarMeasurement],
    /// The pixels between them.
    pub pixels: Option<&'a PixelStatistics>,
    /// The detector as declared.
    pub detector: DeclaredDetector,
    /// Where the sky of the frames lies; none where no attitude is known.
    pub views: &'a [SkyView],
    /// Whether the camera may look through air.
    pub looks_through_air: bool,
    /// Exposure times of the recording's frames, by their number, where they are declared.
    pub exposures_s: &'a [Option<f64>],
    /// How its stars are rendered; nothing where nobody tells how many electrons a count stands for.
    pub stamps: Option<StampCamera>,
}

/// Adds what the images say to a diagnosis of the places.
pub(in crate::diagnose) fn add_images(diagnosis: &mut Diagnosis, images: &ImageMeasurements<'_>, options: &DiagnoseOptions) {
    let of_pixels = images.pixels.iter().flat_map(|pixels| &pixels.by_frame).map(|frame| frame.frame);
    let numbers: BTreeSet<usize> = images.stars.iter().map(|star| star.frame).chain(of_pixels).collect();
    let all = numbers.len();
    let places: BTreeMap<usize, usize> = spread(numbers).into_iter().zip(0..).collect();
    if places.len() < all {
        diagnosis
            .warnings
            .push(format!("brightness, shape, noise and background are tested on {} of {all} frames, spread evenly", places.len()));
    }
    let place = |star: &StarMeasurement| Some(StarMeasurement { frame: *places.get(&star.frame)?, ..*star });
    let stars: Vec<StarMeasurement> = images.stars.iter().filter_map(place).collect();
    let of_places = images.pixels.map(|pixels| of_frames(pixels, &places));
    let frames = places.len();
    let tested = tested(images, &places);
    let asked = Asked {
        nulls: options.nulls,
        alpha: options.alpha,
        seed: options.seed ^ 0x1a6e_5000,
        other_questions: diagnosis.effective_hypotheses,
        stamps: images.stamps,
        looks_through_air: images.looks_through_air,
        tested: &tested,
    };
    let is_enough = stars.len() >= MIN_STARS;
    let pixels =
        of_places.as_ref().map(|statistics| Pixels { statistics, detector: &images.detector, places: &places, views: images.views });
    let found: Vec<String> = diagnosis.findings.iter().map(|finding| finding.id.clone()).collect();
    let judged = judge(if is_enough { &stars } else { &[] }, pixels.as_ref(), frames, &asked, &found);
    if !is_enough {
        too_few_stars(diagnosis, stars.len());
    }
    diagnosis.shape_map = shape_map(images.stars);
    let Some(mut judged) = judged else { return };
    diagnosis.image_profiles = std::mem::take(&mut judged.profiles);
    if is_enough {
        too_few_bright_stars(diagnosis, &judged);
    }
    if let Some(reason) = judged.background.as_ref().and_then(|own| own.why_not.as_ref()) {
        diagnosis.channels.background = ChannelReport::not_looked_at(reason);
    }
    let (mut counted, is_compressed) = images.pixels.map_or_else(Default::default, counted_in);
    let mut by_count = FoundByCount::new(&counted);
    by_count.gain_by_memory = images.pixels.and_then(|pixels| gain_by_memory(pixels, &images.detector));
    if let Some(overshoot) = images.pixels.and_then(|pixels| shared_noise(pixels, &images.detector, &by_count.ids)) {
        by_count.ids.extend(overshoot.found_id());
        counted.push(overshoot);
    }
    if is_compressed {
        withhold_shadows(diagnosis);
    }
    let of_single = single_frames(&judged, images.pixels, &Air::of(&stars, images.looks_through_air), images.detector.bias_dn, &tested);
    by_count.ids.extend(of_single.iter().filter_map(Counted::found_id));
    counted.extend(of_single);
    for proposed in &judged.proposed {
        add_proposed(diagnosis, &judged, proposed, &by_count);
    }
    add_others(diagnosis, &judged);
    if let Some(status) = images.pixels.and_then(|pixels| measured_detector(pixels, &images.detector)) {
        set_status(diagnosis, status);
    }
    let has_moved = counted.iter().any(|own| own.found_id() == Some(MOTION_SMEAR));
    counted.extend(shaken(&judged, images.looks_through_air, has_moved).into_iter().chain([intrapixel_response()]));
    for (channel, state) in &judged.channels {
        // Rounded blocks explain what the noise shows, whatever it looks like, and what else changes the noise explains a gain that seems wrong.
        let is_explained = *channel == Channel::Noise && (is_compressed || is_gain_explained(diagnosis, &judged, &by_count));
        let state = &ChannelState { left_p_value: if is_explained { 1.0 } else { state.left_p_value }, ..state.clone() };
        let report = channel_report(diagnosis, &judged, *channel, state, options.alpha);
        if report.verdict == ChannelVerdict::Unexplained && state.left_p_value < options.alpha {
            diagnosis.unknown.push(unknown(*channel, state));
        }
        *diagnosis.channels.of_mut(*channel) = report;
    }
    add_counted(diagnosis, counted);
    diagnosis.effective_hypotheses += judged.questions;
    diagnosis.scope = diagnosis.channels.scope();
    diagnosis.verdict = diagnosis.channels.verdict();
    diagnosis.summary = wording::summary(diagnosis, diagnosis.left_p_value.unwrap_or(1.0));
    crate::diagnose::resolved::bound(diagnosis);
}

/// The frames by their places.
fn tested(images: &ImageMeasurements<'_>, places: &BTreeMap<usize, usize>) -> Vec<TestedFrame> {
    let exposure_s = |number: usize| images.exposures_s.get(number).copied().flatten();
    places.keys().map(|number| TestedFrame { number: *number, exposure_s: exposure_s(*number) }).collect()
}

/// Frames whose images are wider than those of others; a motion that single frames show makes them so too.
fn shaken(judged: &Judged, looks_through_air: bool, has_moved: bool) -> Option<Counted> {
    let own = jitter(judged, looks_through_air)?;
    Some(if has_moved { own.withheld("the motion during the exposure widens the images of a frame as well") } else { own })
}

/// What is counted in the pixels, and whether they were compressed.
fn counted_in(pixels: &PixelStatistics) -> (Vec<Counted>, bool) {
    let mut all = counted(pixels);
    let is_compressed = all.iter().any(|own| own.found_id() == Some(COMPRESSION));
    all.extend([cosmic_rays(pixels, is_compressed), field_stop(pixels), streaks(pixels, is_compressed)]);
    all.extend(elsewhere(&pixels.elsewhere));
    (all, is_compressed)
}

/// How the pixels cut the image goes with the place in the pixel as well.
fn intrapixel_response() -> Counted {
    let reason =
        "it is a part of the image of a star: what goes with the place in the pixel is a nuisance parameter of brightness and shape";
    Counted::untold(INTRAPIXEL_RESPONSE, Channel::Flux, reason)
}

/// Says why brightness and shape are not tested.
fn too_few_stars(diagnosis: &mut Diagnosis, stars: usize) {
    let reason = if stars == 0 {
        "there are no images: a list of stars tells places alone".to_owned()
    } else {
        format!("{stars} clean star images are too few (at least {MIN_STARS})")
    };
    for channel in [&mut diagnosis.channels.flux, &mut diagnosis.channels.shape] {
        *channel = ChannelReport::not_looked_at(&reason);
    }
}

/// Says why brightness or shape is not tested, where there are stars but hardly any is bright enough.
fn too_few_bright_stars(diagnosis: &mut Diagnosis, judged: &Judged) {
    for channel in [Channel::Flux, Channel::Shape] {
        if !judged.rows.kinds.iter().any(|kind| kind.channel == channel) {
            let reason =
                format!("fewer than {MIN_ROWS} star images are expected to be {MIN_SNR} times as bright as the error of their light");
            *diagnosis.channels.of_mut(channel) = ChannelReport::not_looked_at(&reason);
        }
    }
}

/// As many frames as are tested, spread evenly.
fn spread(numbers: BTreeSet<usize>) -> Vec<usize> {
    let all: Vec<usize> = numbers.into_iter().collect();
    let tested = all.len().min(MAX_FRAMES);
    (0..tested).map(|k| all[k * all.len() / tested]).collect()
}

/// The numbers of some frames alone; what is of all frames together stays, and so do pairs: the frames that are compared pixel by pixel are others than
/// those that are tested, and few of their pairs are of two of these.
fn of_frames(pixels: &PixelStatistics, places: &BTreeMap<usize, usize>) -> PixelStatistics {
    let mut own = pixels.clone();
    // The pattern of the pixels was measured in seconds or in frames by all of them.
    own.is_untimed = !pixels.are_timed();
    own.by_frame.retain(|frame| places.contains_key(&frame.frame));
    own.sky.retain(|mesh| places.contains_key(&mesh.frame));
    own.transfer_points.retain(|point| places.contains_key(&point.frame));
    own
}

/// What bright stars leave at other places.
fn elsewhere(frames: &[ElsewhereFrame]) -> Vec<Counted> {
    let mut all = copies(frames, halo::TESTS);
    all.push(halo(frames, LOOKS.len()));
    all
}

/// Findings that are counted: each is beyond any chance by itself.
fn add_counted(diagnosis: &mut Diagnosis, counted: Vec<Counted>) {
    for own in counted {
        let channel = diagnosis.channels.of_mut(own.channel());
        if own.is_found() && channel.looked_at && channel.verdict != ChannelVerdict::Unexplained {
            channel.verdict = ChannelVerdict::Explained;
        }
        let (status, finding) = own.reported();
        set_status(diagnosis, status);
        let Some(finding) = finding else { continue };
        match diagnosis.findings.iter_mut().find(|known| known.id == finding.id) {
            // Found by places or rows already: what was counted stands beside it.
            Some(known) => known.channels.extend(finding.channels.into_iter().filter(|(_, measure)| measure.is_some())),
            None => diagnosis.findings.push(finding),
        }
    }
}

fn parameter(spec: &Parameter, size: [f64; 2]) -> FoundParameter {
    let [value, sigma] = spec.told(size);
    FoundParameter { name: spec.name.to_owned(), value, sigma, unit: spec.unit.to_owned() }
}

/// Sizes as the equation of the effect's page has them, where the columns are linear in others.
fn in_the_equation(question: &Question, proposed: &Proposed) -> Vec<[f64; 2]> {
    let is = |id: &str, first: &str| question.id == id && question.parameters.first().is_some_and(|own| own.name == first);
    match &proposed.sizes[..] {
        sizes if is(<Vignetting as PixelEffect>::ID, "loss_at_corner") => {
            losses(&sizes.iter().map(|size| size[0]).collect::<Vec<_>>(), &proposed.covariance)
        }
        sizes if question.id == <AmplifierHalves as PixelEffect>::ID => {
            let told = |(own, size): (&Parameter, &[f64; 2])| if is_gain_step(own.name) { relative_step(*size) } else { *size };
            question.parameters.iter().zip(sizes).map(told).collect()
        }
        sizes => sizes.to_vec(),
    }
}

/// A finding, or the status of what is withheld.
fn add_proposed(diagnosis: &mut Diagnosis, judged: &Judged, proposed: &Proposed, by_count: &FoundByCount) {
    let question = &judged.rows.questions[proposed.question];
    // Parameters without a column stand last.
    let own = in_the_equation(question, proposed);
    let sizes = own.iter().chain(std::iter::repeat(&[0.0; 2]));
    let parameters: Vec<FoundParameter> = question.parameters.iter().zip(sizes).map(|(spec, size)| parameter(spec, *size)).collect();
    let p_value = (-proposed.surprise).exp();
    let mut status = EffectStatus {
        id: question.id.to_owned(),
        status: EffectState::Found,
        p_value: Some(p_value),
        p_value_is: None,
        score_sigma: Some(deviations(proposed.surprise)),
        survival: None,
        parameters: parameters.clone(),
        upper_limit_95: None,
        held_out_delta_chi2: None,
        reason: String::new(),
    };
    let against = against(diagnosis, judged, proposed, by_count);
    if !against.is_empty() {
        status.status = EffectState::Withheld;
        status.held_out_delta_chi2 = Some(proposed.held_out.delta_chi2);
        status.reason = against.join("; ");
        set_status(diagnosis, status);
        return;
    }
    set_status(diagnosis, status);
    let channels: ByChannel = Channel::ALL.into_iter().map(|channel| (channel, proposed.channels.get(&channel).copied())).collect();
    let is_of_images = |own: &Proposed| own.question != proposed.question && judged.rows.questions[own.question].id == question.id;
    let is_second =
        judged.proposed.iter().take_while(|own| own.question != proposed.question).any(|own| own.against.is_empty() && is_of_images(own));
    if let Some(known) = diagnosis.findings.iter_mut().find(|finding| finding.id == question.id) {
        if is_second {
            // Another part of the same effect: both are one finding.
            known.parameters.extend(parameters);
            known.delta_chi2 += proposed.statistic;
            known.held_out_delta_chi2 += proposed.held_out.delta_chi2;
            known.held_out_expected += (proposed.statistic - 2.0 * proposed.rank as f64).max(0.0);
            known.sentence = wording::image_finding(known);
            return;
        }
        // Found by places already: what the images say stands beside it.
        for (channel, measure) in channels {
            if measure.is_some() {
                known.channels.insert(channel, measure);
            }
        }
        return;
    }
    let mut finding = Finding {
        id: question.id.to_owned(),
        parameters,
        columns: ColumnSource::Formula,
        located_by: vec![question.follows.to_owned()],
        delta_chi2: proposed.statistic,
        p_value,
        p_value_is: None,
        family_p_value: proposed.family_p,
        family_p_value_is: None,
        held_out_delta_chi2: proposed.held_out.delta_chi2,
        held_out_expected: (proposed.statistic - 2.0 * proposed.rank as f64).max(0.0),
        held_out_score: proposed.held_out.score(),
        held_out_remark: remark(&proposed.held_out),
        chosen_again: proposed.held_out.chosen,
        left_out: "thirds of the frames and of the stars".to_owned(),
        signs: Signs::default(),
        resimulated_p_value: None,
        score_sigma: deviations(proposed.surprise),
        snr: proposed.sizes.iter().map(|[value, sigma]| (value / sigma).abs()).fold(0.0, f64::max),
        channels,
        indistinguishable_from: proposed.alike.iter().map(|id| (*id).to_owned()).collect(),
        rivals: Vec::new(),
        decided_by: String::new(),
        known_amplitude: None,
        sentence: String::new(),
    };
    finding.sentence = wording::image_finding(&finding);
    diagnosis.findings.push(finding);
}

/// What took no part, where that is not what the turns left out of all.
fn remark(held_out: &HeldOut) -> Option<String> {
    let by_zero_points =
        |[slope, sigma]: [f64; 2]| format!("{}, which follow the air mass by {slope:.3} ± {sigma:.3} mag", wording::BY_ZERO_POINTS);
    let sized_alone = || held_out.is_sized_alone.then(|| wording::SIZED_ALONE.to_owned());
    held_out.by_zero_points.map(by_zero_points).or_else(sized_alone)
}

/// Sets the status of an effect; what places found stands.
fn set_status(diagnosis: &mut Diagnosis, status: EffectStatus) {
    match diagnosis.effects.iter_mut().find(|own| own.id == status.id) {
        Some(own) if own.status == EffectState::Found => {}
        Some(own) => *own = status,
        None => diagnosis.effects.push(status),
    }
}

/// The statuses of effects that were not proposed, or not asked.
fn add_others(diagnosis: &mut Diagnosis, judged: &Judged) {
    let is_listed = |diagnosis: &Diagnosis, id: &str| diagnosis.effects.iter().any(|own| own.id == id);
    for other in &judged.others {
        if is_listed(diagnosis, other.id) {
            continue;
        }
        let spec = judged.rows.questions[other.question].parameters.first();
        let parameters: Vec<FoundParameter> = spec.zip(other.size).map(|(spec, size)| parameter(spec, size)).into_iter().collect();
        let is_significant = other.p_value < SIGNIFICANT;
        let upper_limit_95 = parameters.first().filter(|_| !is_significant).map(|own| Limit {
            name: own.name.clone(),
            value: own.value.abs() + NINETY_FIVE * own.sigma,
            unit: own.unit.clone(),
        });
        diagnosis.effects.push(EffectStatus {
            id: other.id.to_owned(),
            status: if is_significant { EffectState::Withheld } else { EffectState::NotFound },
            p_value: Some(other.p_value),
            p_value_is: None,
            score_sigma: None,
            survival: None,
            parameters,
            upper_limit_95,
            held_out_delta_chi2: None,
            reason: if is_significant { "the choice among all effects did not take it".to_owned() } else { String::new() },
        });
    }
    for (id, reason) in &judged.unasked {
        if !is_listed(diagnosis, id) {
            diagnosis.effects.push(EffectStatus {
                id: (*id).to_owned(),
                status: EffectState::NotApplicable,
                p_value: None,
                p_value_is: None,
                score_sigma: None,
                survival: None,
                parameters: Vec::new(),
                upper_limit_95: None,
                held_out_delta_chi2: None,
                reason: reason.clone(),
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::causes::EXTINCTION;
    use crate::diagnose::images::counted::MAX_SURPRISE;
    use crate::diagnose::images::judge::Pixels;
    use crate::pixel_statistics::{Estimate, FrameNoise, PatternPair};

    /// Of 32 frames that are compared pixel by pixel and 24 that are tested few are the same: all pairs count, each by a tested frame near it.
    #[test]
    fn pairs_of_frames_that_are_not_tested_stay() {
        const ALL: usize = 1000;
        let compared: Vec<usize> = (0..32).map(|k| k * ALL / 32).collect();
        let places: BTreeMap<usize, usize> = spread((0..ALL).collect()).into_iter().zip(0..).collect();
        let covariance = Estimate { value: 0.0, sigma: 1e-3 };
        let pair = |frames: [usize; 2]| PatternPair { frames, covariance, by_light: None, by_exposure: 1.0 };
        let mut statistics = PixelStatistics::default();
        statistics.fixed_pattern.pairs =
            (0..32).flat_map(|a| (a + 1..32).map(move |b| (a, b))).map(|(a, b)| pair([compared[a], compared[b]])).collect();
        assert_eq!(of_frames(&statistics, &places).fixed_pattern.pairs.len(), 496);
        let noise = |frame: usize| FrameNoise {
            frame,
            exposure_s: Some(1.0).filter(|_| frame != 7),
            level_dn: 200.0,
            sigma_dn: 2.0,
            row_variance_dn2: None,
            column_variance_dn2: None,
            parity_dn: None,
            middle_step_dn: None,
        };
        // The one frame whose exposure is not known is none of those that are tested.
        statistics.by_frame = (0..ALL).map(noise).collect();
        let tested = of_frames(&statistics, &places);
        assert!(tested.by_frame.iter().all(|frame| frame.exposure_s.is_some()) && !tested.are_timed());
        let detector = DeclaredDetector::default();
        let pixels = Pixels { statistics: &statistics, detector: &detector, places: &places, views: &[] };
        assert_eq!([0, 41, 82, 83, 999].map(|frame| pixels.place(frame)), [0, 1, 1, 2, 23]);
    }

    /// What turns can not test does not read as a test that was passed.
    #[test]
    fn what_the_zero_points_confirm_is_said_to_be() {
        let sizes = vec![("mag_per_airmass", 0.9, 0.05, "mag")];
        let counted = Counted::of_stars(EXTINCTION, Channel::Flux, sizes, MAX_SURPRISE, "zenith", String::new());
        let mut finding = counted.reported().1.unwrap();
        (finding.held_out_delta_chi2, finding.left_out) = (-0.3, "thirds".to_owned());
        let held_out = |by_zero_points| HeldOut { by_zero_points, ..HeldOut::default() };
        finding.held_out_remark = remark(&held_out(Some([0.88, 0.04])));
        let own = "Turns that leave thirds out cannot test it: χ² falls by 0 there. It is confirmed by the zero points of the frames, which follow the air \
                   mass by 0.880 ± 0.040 mag.";
        assert!(wording::image_finding(&finding).ends_with(own), "{}", wording::image_finding(&finding));
        finding.held_out_remark = remark(&held_out(None));
        assert!(wording::image_finding(&finding).ends_with("it lowers χ² there by 0."), "{}", wording::image_finding(&finding));
    }
}

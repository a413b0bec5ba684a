//! Control points of identified frames, and the camera and options of their diagnosis.

use super::crowding::{self, take_disturbed};
use super::learnt_image::take_phase_bias_off;
use super::one_camera::check_sizes;
use super::overfull::{self, Seen};
use super::{IdentifiedFrame, Measured, MeasuredFrame, PipelineError, SkyChoice, circumstances, image_conditions, physics_in_force};
use crate::calibrate::{CalibrateOptions, MeasuredStarImage, calibrate, calibrate_identifying_anew};
use crate::camera::Term;
use crate::catalog::Catalog;
use crate::detect::LearntImage;
use crate::diagnose::{DiagnoseOptions, Telemetry};
use crate::effects;
use crate::identify::{
    BackgroundSlope, ControlPoint, ControlPoints, FrameState, Identification, KnownAttitude, Misidentification, Projection, Refusal,
    Solution, add_listed_points, control_points as build_control_points, handedness, image_state,
};
use crate::recording::{FrameEntry, Mount, Recording};
use crate::units::ARCSEC_RAD;

/// Control points with what is to be minded of them.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct PreparedPoints {
    /// The points, in the un-mirrored image.
    pub points: ControlPoints,
    /// −1 if the images are mirrored.
    pub parity: i8,
    /// Identifications that were made wrong on purpose afterwards; none from here.
    pub misidentified: Vec<Misidentification>,
    /// What was left out, one sentence each.
    pub notes: Vec<String>,
}

/// The control points of identified frames. `trusted`: a star list's own identifications are taken in the place of ours.
pub fn control_points(
    measured: &Measured,
    identified: &[IdentifiedFrame],
    catalog: &Catalog,
    max_magnitude: Option<f64>,
    trusted: bool,
) -> Result<PreparedPoints, PipelineError> {
    let overfull = overfull_frames(measured, identified, catalog);
    let none = Identification::NotIdentified { reason: Refusal::Overfull, hypotheses: 0 };
    let frames: Vec<crate::identify::FrameIdentification> = measured
        .frames
        .iter()
        .zip(identified)
        .zip(&overfull)
        .map(|((frame, identified), overfull)| crate::identify::FrameIdentification {
            frame: frame.index,
            detections: &frame.detections,
            identification: if overfull.is_some() { &none } else { &identified.identification },
            sky: Some(&identified.sky),
            years_since_epoch: identified.sky.observation().epoch_yr.map_or(0.0, |epoch| epoch - catalog.epoch_yr),
            gain_e_per_dn: measured.gain_e_per_dn(frame),
        })
        .collect();
    let nominal = measured.recording.nominal_camera();
    if nominal.is_none() {
        check_sizes(&measured.recording)?;
    }
    let declared = nominal.is_some();
    let (mut points, notes) = build_control_points(&frames, measured.recording.frames.len(), catalog, nominal);
    let mut notes: Vec<String> = notes.iter().map(|note| with_name(note, &measured.recording)).collect();
    notes.extend(overfull.into_iter().flatten());
    if trusted {
        trust(&mut points, measured, identified, catalog, &mut notes)?;
    }
    for (frame, identified) in measured.frames.iter().zip(identified) {
        if let (Identification::NotIdentified { reason, .. }, false) = (&identified.identification, trusted) {
            notes.push(format!("{} is not identified and left out: {reason}", frame.name));
        }
    }
    if let Some(limit) = max_magnitude {
        points.points.retain(|point| point.magnitude <= limit);
    }
    let parity = points.parity;
    if parity < 0 && declared {
        points.nominal = points.nominal.mirrored(); // what is declared is of the images as stored
    }
    let mut points = points.unmirrored();
    know_frames(&mut points, measured, identified)?;
    Ok(PreparedPoints { points, parity, misidentified: Vec::new(), notes })
}

/// A sentence that begins with a frame's number ("frame 5 is …"), with the frame's name in its place.
#[must_use]
pub fn with_name(sentence: &str, recording: &Recording) -> String {
    let number = sentence.strip_prefix("frame ").or_else(|| sentence.strip_prefix("Frame ")).and_then(|rest| {
        let (number, rest) = rest.split_once(' ')?;
        Some((number.parse::<usize>().ok().filter(|number| *number < recording.frames.len())?, rest))
    });
    number.map_or_else(|| sentence.to_owned(), |(number, rest)| format!("{} {rest}", recording.frame_name(number)))
}

/// Of each frame why it is left out though it is identified, if it is. A list's stars were chosen by whoever made it.
fn overfull_frames(measured: &Measured, identified: &[IdentifiedFrame], catalog: &Catalog) -> Vec<Option<String>> {
    let solved = |(number, (frame, identified))| Some((number, frame, IdentifiedFrame::solution(identified)?));
    let solved: Vec<(usize, &MeasuredFrame, &Solution)> = measured.frames.iter().zip(identified).enumerate().filter_map(solved).collect();
    let mut all = vec![None; measured.frames.len()];
    if measured.recording.stars.is_none() {
        let seen: Vec<Seen<'_>> =
            solved.iter().map(|(_, frame, solution)| Seen { name: &frame.name, detections: &frame.detections, solution }).collect();
        for ((number, ..), sentence) in solved.iter().zip(overfull::left_out(&seen, catalog)) {
            all[*number] = sentence;
        }
    }
    all
}

/// All star images of the frames, in the un-mirrored image.
#[must_use]
pub fn star_images(measured: &Measured, points: &PreparedPoints) -> Vec<MeasuredStarImage> {
    let width_px = points.points.nominal.width_px as f64;
    let place = |x_px: f64| if points.parity < 0 { width_px - 1.0 - x_px } else { x_px };
    let recording_gradient_e_px = points.points.points.iter().find_map(|point| point.image.recording_gradient_e_px);
    let of = |frame: &MeasuredFrame| {
        let index = frame.index;
        let gain_e_per_dn = measured.gain_e_per_dn(frame);
        let slope = BackgroundSlope::of(&frame.detections);
        let usable = frame.detections.stars.iter().filter(|star| !star.flags.saturated && !star.flags.edge);
        let image = move |star: &crate::detect::Detection| {
            let [xx, xy, yy] = star.covariance_px2;
            let xy = if points.parity < 0 { -xy } else { xy };
            let state = effects::StarImage { recording_gradient_e_px, ..image_state(star, slope.as_ref(), gain_e_per_dn) };
            let state = if points.parity < 0 { state.mirrored() } else { state };
            MeasuredStarImage { frame: index, x_px: place(star.x_px), y_px: star.y_px, covariance_px2: [xx, xy, yy], state }
        };
        usable.map(image).collect::<Vec<_>>()
    };
    measured.frames.iter().flat_map(of).collect()
}

/// The effects of known size behind the lens that the model is to contain.
pub fn known_behind_the_lens(measured: &Measured, points: &PreparedPoints, choice: &SkyChoice) -> Result<Vec<Term>, PipelineError> {
    let observations: Vec<_> = measured.frames.iter().map(|frame| points.points.observation(frame.index)).collect();
    Ok(choice.physics.terms_behind_the_lens(&observations)?)
}

/// Hands on what is known of each frame, and which effects the directions contain.
fn know_frames(points: &mut ControlPoints, measured: &Measured, identified: &[IdentifiedFrame]) -> Result<(), PipelineError> {
    let recording = &measured.recording;
    let observations = circumstances(recording)?;
    points.frames = recording
        .frames
        .iter()
        .zip(observations)
        .map(|(entry, observation)| {
            let known_attitude = entry.camera_from_icrs.zip(entry.attitude_sigma_arcsec);
            let known_attitude =
                known_attitude.map(|(camera_from_icrs, sigma)| KnownAttitude { camera_from_icrs, sigma_rad: sigma * ARCSEC_RAD });
            FrameState { observation, known_attitude }
        })
        .collect();
    // Where no time is known the stars are taken at an assumed one.
    for (frame, identified) in measured.frames.iter().zip(identified) {
        points.frames[frame.index].observation.epoch_yr = identified.sky.observation().epoch_yr;
    }
    // Where only some frames know enough for an effect, the others' knowledge is empty and the effect does nothing there.
    points.sky.clear();
    for (id, parameters) in identified.iter().flat_map(|frame| frame.sky.effects()) {
        if points.sky.iter().all(|term| term.effect != id) {
            points.sky.push(Term { effect: id.to_owned(), parameters: parameters.to_vec() });
        }
    }
    points.fixed_mount = recording.mount == Some(Mount::Fixed);
    points.frame_names = (0..recording.frames.len()).map(|frame| recording.frame_name(frame)).collect();
    Ok(())
}

/// Takes the identifications of a star list as they stand, in the place of ours.
fn trust(
    points: &mut ControlPoints,
    measured: &Measured,
    identified: &[IdentifiedFrame],
    catalog: &Catalog,
    notes: &mut Vec<String>,
) -> Result<(), PipelineError> {
    let list = measured.recording.stars.as_ref().ok_or(PipelineError::NoList)?;
    points.points.clear();
    for (frame, identified) in measured.frames.iter().zip(identified) {
        let stars = list.frames.get(frame.index).map_or(&[][..], Vec::as_slice);
        let unknown = add_listed_points(points, frame.index, stars, catalog, &identified.sky);
        if !unknown.is_empty() {
            notes.push(format!("{}: the catalogue does not hold HIP {unknown:?}; these stars are left out", frame.name));
        }
    }
    points.parity = handedness(points);
    Ok(())
}

/// What a mismatch may follow from frame to frame: every number of the frames under its own name.
#[must_use]
pub fn telemetry(recording: &Recording) -> Telemetry {
    let of = |frame: &FrameEntry| {
        let own = [("temperature", frame.temperature_c), ("exposure", frame.exposure_s)];
        let own = own.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?)));
        frame.covariates.iter().map(|(name, value)| (name.clone(), *value)).chain(own).collect()
    };
    recording.frames.iter().map(of).collect()
}

/// All that a diagnosis is asked with.
#[derive(Clone, Debug)]
pub struct DiagnosisRequest {
    /// The control points of the camera that the recording is held against.
    pub points: ControlPoints,
    /// Points that take no part: they stand in the light of stars that were not measured.
    pub left_out: Vec<ControlPoint>,
    /// The numbers of its frames.
    pub telemetry: Telemetry,
    /// The options, the physics in force filled in.
    pub options: DiagnoseOptions,
    /// The image that the recording's stars show, whose bias was taken off the places.
    pub image: Option<LearntImage>,
    /// What is to be minded: physics that acts in a part of the frames only, star images that were left out; one sentence each.
    pub notes: Vec<String>,
}

/// How control points come to be a question.
#[derive(Clone, Copy, Debug)]
pub struct DiagnosisInput<'a> {
    /// The stars.
    pub catalog: &'a Catalog,
    /// The physics of the model.
    pub choice: &'a SkyChoice,
    /// Fainter stars are left out, V.
    pub max_magnitude: Option<f64>,
    /// Identifications stay as they are.
    pub trusted: bool,
}

/// What a diagnosis is asked about prepared control points. The camera that the recording is held against is identified anew with itself: its
/// control points have few wrong and few missing stars. Imprecise stars stay, since nothing is known yet of what makes them so.
///
/// Where the stars' pixels were kept, the bias of the places that follows the pixel phase is taken off them, in `measured` too.
pub fn diagnosis_request(
    measured: &mut Measured,
    identified: &[IdentifiedFrame],
    prepared: &PreparedPoints,
    asked: &DiagnosisInput,
    mut options: DiagnoseOptions,
) -> Result<DiagnosisRequest, PipelineError> {
    if prepared.points.projection != Projection::Pinhole {
        return Err(PipelineError::Fisheye(prepared.points.projection.id()));
    }
    let (physics, uneven) = physics_in_force(identified);
    options.physics = physics.iter().map(|id| (*id).to_owned()).collect();
    for term in known_behind_the_lens(measured, prepared, asked.choice)? {
        options.physics.push(term.effect.clone());
        if options.terms.iter().all(|given| given.effect != term.effect) {
            options.terms.push(term);
        }
    }
    options.looks = options.looks.or_else(|| image_conditions(measured));
    let solver = CalibrateOptions {
        solve: options.solve.clone(),
        terms: options.terms.clone(),
        physics: options.physics.clone(),
        leave_out_imprecise: false,
        proper_motion_only: options.proper_motion_only,
        held_out: false,
        ..CalibrateOptions::default()
    };
    let mut baseline = if asked.trusted {
        calibrate(&prepared.points, &solver)?
    } else {
        calibrate_identifying_anew(&prepared.points, &star_images(measured, prepared), asked.catalog, asked.max_magnitude, &solver)?
    };
    let image = take_phase_bias_off(measured, &mut baseline, prepared.parity, &solver);
    let left_out = take_disturbed(&mut baseline.control_points, prepared.parity, measured, asked.catalog);
    let points = baseline.control_points;
    let notes = uneven.into_iter().chain(crowding::sentence(left_out.len(), points.points.len())).collect();
    Ok(DiagnosisRequest { points, left_out, telemetry: telemetry(&measured.recording), options, image, notes })
}

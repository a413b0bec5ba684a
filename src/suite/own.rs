//! boresight itself as the system under test: detect, identify, attitude under the declared camera; a night at a time calibrate and diagnose.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::answers::{AnswerStatus, AnsweredCamera, AnsweredStar, TrackerAnswer};
use super::conventions::WrittenAttitude;
use super::error::SuiteError;
use super::frames::{FrameBatch, HandedFrame};
use super::suite_file::{OwnCentroid, OwnTable};
use super::system::ObservedAnswer;
use crate::calibrate::{CalibrateOptions, Calibration, Status, calibrate};
use crate::camera::{Camera, Physics};
use crate::catalog::Catalog;
use crate::coordinates::{Attitude, PixelPoint};
use crate::diagnose::{DiagnoseOptions, diagnose};
use crate::effects::ids;
use crate::frame::Frame;
use crate::identify::{IdentifyOptions, Solution};
use crate::pipeline::{
    Centroid, DiagnosisInput, DiagnosisRequest, IdentifiedFrame, MeasureOptions, Measured, MeasuredFrame, SkyChoice, control_points,
    diagnosis_request, identify_frames, measure_frames, physics_in_force,
};
use crate::recording::{FrameEntry, Recording, RecordingError, SkippedFrame};
use crate::scene::{declared_entry, declared_recording};

/// What a diagnosis named.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct NightAnswer {
    /// Ids of the findings; `None`: no diagnosis could be made, or none was asked for.
    pub(super) named: Option<Vec<String>>,
}

/// The answers of boresight to frames of one night.
pub(super) struct OwnAnswers {
    pub(super) frames: Vec<ObservedAnswer>,
    pub(super) night: Option<NightAnswer>,
}

/// Measures, identifies and, where the suite asks for it, calibrates and diagnoses frames of one night. `calibrates`: whether a metric needs cameras.
pub(super) fn answers(
    case: &str,
    own: &OwnTable,
    (batch, frames): (&FrameBatch, &[HandedFrame]),
    catalog: &Catalog,
    calibrates: bool,
) -> Result<OwnAnswers, SuiteError> {
    let wrong = |source| SuiteError::Pipeline { case: case.to_owned(), source: Box::new(source) };
    let recording = recording_of(batch, frames);
    let centroid = match own.centroid {
        OwnCentroid::Windowed => Centroid::Windowed,
        OwnCentroid::Gaussian => Centroid::Gaussian,
        OwnCentroid::Empirical => Centroid::Empirical,
    };
    let options = MeasureOptions { centroid, ..MeasureOptions::default() };
    let load = |recording: &Recording, index: usize| -> Result<Result<Frame, SkippedFrame>, RecordingError> {
        Ok(Ok(Frame {
            width_px: recording.camera.width_px,
            height_px: recording.camera.height_px,
            pixels_dn: frames[index].pixels_dn.iter().map(|count| f32::from(*count)).collect(),
            saturation_dn: recording.camera.saturation_dn.unwrap_or(65_535.0) as f32,
        }))
    };
    let mut measured = measure_frames(recording, load, &options, || ()).map_err(wrong)?;
    let search =
        IdentifyOptions { nominal_focal_length_px: measured.recording.camera.nominal_focal_length_px(), ..IdentifyOptions::default() };
    let identified = identify_frames(&measured, catalog, &SkyChoice::from(Physics::Known), &search, || ()).map_err(wrong)?;
    let solved = if calibrates || own.calibrate { camera_of(&measured, &identified, catalog) } else { None };
    let mut answers: Vec<ObservedAnswer> = frames.iter().map(|_| ObservedAnswer::default()).collect();
    let declared = batch.scene.nominal;
    let used = solved.as_ref().filter(|_| own.calibrate).map_or(declared, |calibration| calibration.camera);
    for (frame, identified) in measured.frames.iter().zip(&identified) {
        answers[frame.index] = answer_of(frame, identified, catalog, &used);
    }
    if let (Some(calibration), Some(first)) = (&solved, answers.first_mut()) {
        first.answer.camera = Some(answered(calibration));
    }
    let night = own.diagnose.then(|| NightAnswer { named: named(&mut measured, catalog).map_err(wrong).ok() });
    Ok(OwnAnswers { frames: answers, night })
}

/// The frames as a recording that lies in memory.
fn recording_of(batch: &FrameBatch, frames: &[HandedFrame]) -> Recording {
    let mut recording = declared_recording(&batch.scene);
    let own = frames.iter().enumerate().map(|(number, frame)| FrameEntry { number, ..declared_entry(&batch.scene, frame.in_scene) });
    recording.frames = own.collect();
    recording
}

fn answer_of(frame: &MeasuredFrame, identified: &IdentifiedFrame, catalog: &Catalog, camera: &Camera) -> ObservedAnswer {
    let stars = &frame.detections.stars;
    let mut centroids: Vec<AnsweredStar> = stars.iter().map(|star| AnsweredStar { x: star.x_px, y: star.y_px, hip: None }).collect();
    let mut answer = TrackerAnswer::without(AnswerStatus::None, None);
    if let Some(solution) = identified.solution() {
        for own in &solution.matches {
            centroids[own.detection].hip = Some(catalog.stars[own.star].hip);
        }
        let attitude = attitude_under(camera, frame, identified, solution, catalog).unwrap_or(solution.attitude);
        answer.status = AnswerStatus::Solved;
        answer.attitude = Some(WrittenAttitude::Matrix(attitude.rows()));
    }
    answer.centroids = Some(centroids);
    ObservedAnswer { answer, latency_s: Some(identified.seconds), peak_mib: None }
}

/// The attitude that puts the named stars where they are, with a camera that is known: the solution by singular values of Wahba's problem (Markley,
/// J. Astronaut. Sci. 36, 245, 1988), each star by its stated variance. `None` for mirrored images.
fn attitude_under(
    camera: &Camera,
    frame: &MeasuredFrame,
    identified: &IdentifiedFrame,
    solution: &Solution,
    catalog: &Catalog,
) -> Option<Attitude> {
    if solution.parity < 0 {
        return None;
    }
    let mut sum = Matrix3::zeros();
    for own in &solution.matches {
        let star = &frame.detections.stars[own.detection];
        let [xx, _, yy] = star.covariance_px2;
        let seen = camera.direction(PixelPoint { x_px: star.x_px, y_px: star.y_px });
        let known = identified.direction(catalog, own.star);
        sum += Vector3::from(seen.xyz) * Vector3::from(known.xyz).transpose() / (xx + yy).max(1e-8);
    }
    let parts = sum.svd(true, true);
    let (u, v) = (parts.u?, parts.v_t?);
    let mut turned = u * v;
    if turned.determinant() < 0.0 {
        let mut flip = Matrix3::identity();
        flip[(2, 2)] = -1.0;
        turned = u * flip * v;
    }
    Some(Attitude::new(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&turned))))
}

/// The camera of a night, if there is one.
fn camera_of(measured: &Measured, identified: &[IdentifiedFrame], catalog: &Catalog) -> Option<Calibration> {
    let points = control_points(measured, identified, catalog, None, false).ok()?;
    let (physics, _) = physics_in_force(identified);
    let moved = measured.times_are_known() && physics.contains(&ids::PROPER_MOTION);
    let options = CalibrateOptions {
        physics: physics.iter().map(|id| (*id).to_owned()).collect(),
        leave_out_imprecise: true,
        proper_motion_only: moved,
        held_out: false,
        ..CalibrateOptions::default()
    };
    calibrate(&points.points, &options).ok().filter(|calibration| calibration.status == Status::Converged)
}

fn answered(calibration: &Calibration) -> AnsweredCamera {
    let sigma = |name: &str| calibration.parameters.iter().find(|own| own.name == name).map(|own| own.sigma);
    let camera = &calibration.camera;
    let [f, x0, y0, k1] = ["f", "x0", "y0", "k1"].map(sigma);
    AnsweredCamera {
        focal_length_px: Some(camera.focal_length_px),
        focal_length_sigma_px: f,
        principal_point_px: Some(camera.principal_point_px),
        principal_point_sigma_px: x0.zip(y0).map(|(x0, y0)| [x0, y0]),
        k1: Some(camera.k1),
        k1_sigma: k1,
    }
}

/// What the diagnosis of a night's positions names.
fn named(measured: &mut Measured, catalog: &Catalog) -> Result<Vec<String>, crate::pipeline::PipelineError> {
    let choice = SkyChoice { physics: Physics::List(vec![ids::PROPER_MOTION.to_owned()]), assumes_time: true };
    let search =
        IdentifyOptions { nominal_focal_length_px: measured.recording.camera.nominal_focal_length_px(), ..IdentifyOptions::default() };
    let identified = identify_frames(measured, catalog, &choice, &search, || ())?;
    let prepared = control_points(measured, &identified, catalog, None, false)?;
    let asked = DiagnosisInput { catalog, choice: &choice, max_magnitude: None, trusted: false };
    let options = DiagnoseOptions { proper_motion_only: measured.times_are_known(), ..DiagnoseOptions::default() };
    let DiagnosisRequest { points, telemetry, options, .. } = diagnosis_request(measured, &identified, &prepared, &asked, options)?;
    let found = diagnose(&points, &telemetry, &options)?;
    Ok(found.findings.into_iter().map(|finding| finding.id).collect())
}

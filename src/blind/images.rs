//! Recordings with effects hidden in their pixels: in the program's own form, on disk and straight in memory with the same content, and diagnosed
//! as `boresight diagnose` does it, brightness, shape and noise included.

use std::path::{Path, PathBuf};
use std::time::Instant;

use super::answer::{AnswerParameter, AnswerSize};
use super::generate::images::ImageCanvas;
use super::generate::{Concealed, Family, Lists, concealed};
use super::pixels::whole;
use super::run::shortened;
use super::{Answer, BlindError, recording};
use crate::camera::Physics;
use crate::catalog::Catalog;
use crate::diagnose::{Channel, DeclaredDetector, DiagnoseOptions, Diagnosis, EffectState, ImageMeasurements, diagnose_recording};
use crate::frame::Frame;
use crate::identify::IdentifyOptions;
use crate::pipeline::{
    DiagnosisInput, DiagnosisRequest, MeasureOptions, Measured, PipelineError, SkyChoice, control_points, diagnosis_request,
    identify_frames, looks_through_air, measure_frames, sky_views,
};
use crate::pipeline::{stamp_camera, star_measurements};
use crate::recording::{FitsHeaders, Form, FrameEntry, FrameSize, Recording, write_fits_u16, write_manifest};

/// The recording, as it would be read back from its folder.
#[must_use]
pub fn image_recording(lists: &Lists, images: &ImageCanvas) -> Recording {
    let mut recording = recording(lists);
    recording.form = Form::Manifest;
    recording.stars = None;
    let (camera, own) = (&mut recording.camera, &images.world.camera);
    camera.gain_e_per_dn = Some(own.gain_e_per_dn);
    camera.bias_dn = Some(own.bias_dn);
    camera.read_noise_e = Some(own.read_noise_e);
    camera.saturation_dn = Some(own.full_dn());
    let [width_px, height_px] = images.size_px();
    for (FrameEntry { file, number, size, exposure_s, .. }, frame) in recording.frames.iter_mut().zip(&images.world.frames) {
        *file = Some(PathBuf::from(format!("frames/{number:04}.fits")));
        *size = Some(FrameSize { width_px, height_px });
        *exposure_s = Some(frame.exposure_s);
    }
    recording
}

/// Writes the recording: recording.toml and frames.
pub fn write_images(folder: &Path, lists: &Lists, images: &ImageCanvas) -> Result<(), BlindError> {
    let recording = image_recording(lists, images);
    let [width_px, height_px] = images.size_px();
    for (entry, pixels_dn) in recording.frames.iter().zip(images.frames()) {
        let headers = FitsHeaders::new(&recording.camera, recording.site.as_ref(), entry);
        let file = entry.file.as_deref().unwrap_or(Path::new(""));
        write_fits_u16(&folder.join(file), width_px, height_px, &pixels_dn, &headers)?;
    }
    write_manifest(folder, &recording)?;
    Ok(())
}

/// Paints the frames and goes the way of `boresight diagnose --physics MODEL` with them, up to the question: what was measured, what the diagnosis is
/// asked, and the parity of the images.
pub fn image_request(
    lists: &Lists,
    images: &ImageCanvas,
    catalog: &Catalog,
    options: &DiagnoseOptions,
) -> Result<(Measured, DiagnosisRequest, i8), PipelineError> {
    let [width_px, height_px] = images.size_px();
    let frames = images.frames();
    let saturation_dn = images.world.camera.full_dn() as f32;
    let frame = |_: &Recording, index: usize| {
        let pixels_dn = frames[index].iter().map(|count| f32::from(*count)).collect();
        Ok(Ok(Frame { width_px, height_px, pixels_dn, saturation_dn }))
    };
    let measuring = MeasureOptions { pixels: true, ..MeasureOptions::default() };
    let mut measured = measure_frames(image_recording(lists, images), frame, &measuring, || ())?;
    let physics = lists.model.iter().map(|id| (*id).to_owned()).collect();
    let choice = SkyChoice { physics: Physics::List(physics), assumes_time: true };
    let search =
        IdentifyOptions { nominal_focal_length_px: measured.recording.camera.nominal_focal_length_px(), ..IdentifyOptions::default() };
    let identified = identify_frames(&measured, catalog, &choice, &search, || ())?;
    let prepared = control_points(&measured, &identified, catalog, None, false)?;
    let asked = DiagnosisInput { catalog, choice: &choice, max_magnitude: None, trusted: false };
    let options = DiagnoseOptions { proper_motion_only: measured.times_are_known(), ..options.clone() };
    let request = diagnosis_request(&mut measured, &identified, &prepared, &asked, options)?;
    Ok((measured, request, prepared.parity))
}

/// The answer for one recording: its truth is dropped unseen.
#[must_use]
pub fn image_answer(family: Family, index: u32, seed: u64, options: &DiagnoseOptions) -> Answer {
    let catalog = Catalog::embedded();
    let Concealed { lists, images, .. } = concealed(family, index, seed, catalog);
    let none = |reason: String| Answer::none(family, index, seed, reason);
    let Some(images) = images else { return none("nothing is painted".to_owned()) };
    let options = DiagnoseOptions { seed: u64::from(index), ..options.clone() };
    let start = Instant::now();
    let (measured, request, parity) = match image_request(&lists, &images, catalog, &options) {
        Ok(all) => all,
        Err(error) => return none(whole(&error)),
    };
    let DiagnosisRequest { points, telemetry, options: asked, .. } = request;
    let stars = star_measurements(&measured, &points, parity);
    let camera = &measured.recording.camera;
    let detector = DeclaredDetector::from(camera);
    let exposures_s: Vec<Option<f64>> = measured.recording.frames.iter().map(|frame| frame.exposure_s).collect();
    let views = sky_views(&measured, &points, parity);
    let of_images = ImageMeasurements {
        stars: &stars,
        pixels: measured.pixels.as_ref(),
        detector,
        views: &views,
        exposures_s: &exposures_s,
        looks_through_air: looks_through_air(&measured.recording),
        stamps: stamp_camera(&measured, &points),
    };
    let diagnosis = match diagnose_recording(&points, &telemetry, &of_images, &asked, &|_| ()) {
        Ok(diagnosis) => diagnosis,
        Err(error) => return none(error.to_string()),
    };
    let mut answer = shortened(&diagnosis, family, index, seed);
    answer.alpha = options.alpha;
    answer.seconds = start.elapsed().as_secs_f64();
    with_channels(&mut answer, &diagnosis);
    answer
}

/// What every channel says, why names were withheld, and the sizes of what is not found.
fn with_channels(answer: &mut Answer, diagnosis: &Diagnosis) {
    let name = |channel: Channel| serde_json::to_value(channel).ok()?.as_str().map(str::to_owned);
    for channel in diagnosis.channels.scope() {
        let report = diagnosis.channels.of(channel);
        let verdict = report.verdict.words();
        let told = if report.located_by.is_empty() { verdict.to_owned() } else { format!("{verdict}: {}", report.located_by.join(", ")) };
        let held_out = report.held_out_chi2_per_dof.zip(report.held_out_dof);
        answer.held_out_by_channel.extend(name(channel).zip(held_out).map(|(name, (per_dof, dof))| (name, [per_dof, dof])));
        answer.channels.extend(name(channel).map(|name| (name, told)));
    }
    let withheld = diagnosis.effects.iter().filter(|effect| effect.status == EffectState::Withheld);
    answer.withheld.extend(withheld.map(|effect| (effect.id.clone(), effect.reason.clone())));
    let sizes = diagnosis.effects.iter().filter(|effect| effect.status == EffectState::NotFound);
    answer.not_found.extend(sizes.filter_map(|effect| {
        let own = effect.parameters.first()?;
        let parameter = AnswerParameter { name: own.name.clone(), value: own.value, sigma: own.sigma };
        Some(AnswerSize { id: effect.id.clone(), parameter })
    }));
}

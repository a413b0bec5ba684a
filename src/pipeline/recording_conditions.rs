//! What a recording and its frames tell of the conditions they were taken in: air or space, how the stars look, and the noise.

use super::{Measured, MeasuredFrame};
use crate::calibrate::{DetectorNumber, DetectorNumbers, Surroundings};
use crate::detect::Detections;
use crate::diagnose::{DeclaredDetector, FoundParameter, ImageConditions, MeasuredNoise, StampCamera, detector_numbers as told};
use crate::identify::ControlPoints;
use crate::pixel_statistics::{PhotonTransfer, StarTransfer};
use crate::recording::{Mount, Recording};
use crate::statistics::{mad_sigma, median, median_in_place};

/// Whether a camera looks through air: it is in space where its recording tells how it moves and knows of no ground.
#[must_use]
pub fn surroundings(recording: &Recording) -> Surroundings {
    let flies = recording.frames.iter().any(|frame| frame.velocity_km_s.is_some());
    let stands = recording.site.is_some() || recording.mount == Some(Mount::Fixed);
    if flies && !stands { Surroundings::Space } else { Surroundings::MayBeGround }
}

/// Whether a camera may look through air.
#[must_use]
pub fn looks_through_air(recording: &Recording) -> bool {
    surroundings(recording) == Surroundings::MayBeGround
}

/// How the stars of a recording look, to render them as they are; `None` where there are no pixels, or nobody says how many electrons a
/// count stands for.
#[must_use]
pub fn image_conditions(measured: &Measured) -> Option<ImageConditions> {
    conditions_at(measured, measured.recording.camera.gain_e_per_dn?)
}

/// How the stars of a recording are rendered for columns in brightness and shape: by the gain as declared, else as the noise of the sky tells it.
#[must_use]
pub fn stamp_camera(measured: &Measured, points: &ControlPoints) -> Option<StampCamera> {
    let by_noise = || measured.pixels.as_ref()?.photon_transfer.as_ref()?.gain_e_per_dn;
    let gain_e_per_dn = measured.recording.camera.gain_e_per_dn.or_else(by_noise).filter(|gain| *gain > 0.0)?;
    Some(StampCamera { camera: points.nominal, gain_e_per_dn, looks: conditions_at(measured, gain_e_per_dn)? })
}

/// What the noise of stars and sky tells of a detector of which no gain is declared.
#[must_use]
pub fn detector_numbers(measured: &Measured) -> Option<DetectorNumbers> {
    if measured.recording.camera.gain_e_per_dn.is_some() {
        return None;
    }
    let (parameters, reason) = told(&line_with_stars(measured)?, &DeclaredDetector::from(&measured.recording.camera))?;
    let number = |own: FoundParameter| DetectorNumber { name: own.name, value: own.value, sigma: own.sigma };
    Some(DetectorNumbers { parameters: parameters.into_iter().map(number).collect(), reason })
}

/// The line of photon transfer: through the sky's pixels where these were looked at, else through the level and the noise that the stars were found in; with
/// what the stars tell. Where the frames were processed neither tells a gain.
pub(super) fn line_with_stars(measured: &Measured) -> Option<PhotonTransfer> {
    let line = joined_line(measured)?;
    let is_altered = measured.pixels.as_ref().is_some_and(|pixels| pixels.altered_noise().is_some());
    Some(if is_altered { line.without_gain() } else { line })
}

fn joined_line(measured: &Measured) -> Option<PhotonTransfer> {
    let of_sky = measured.pixels.as_ref().and_then(|pixels| pixels.photon_transfer.clone());
    match (of_sky, measured.star_noise) {
        // Stars that are in it already are not counted twice.
        (Some(line), Some(stars)) if line.stars.is_none() => Some(line.with_stars(stars)),
        (Some(line), _) => Some(line),
        (None, Some(stars)) => line_of_levels(measured, stars),
        (None, None) => None,
    }
}

/// The line through the frames' typical level and noise, with the slope of the stars.
fn line_of_levels(measured: &Measured, stars: StarTransfer) -> Option<PhotonTransfer> {
    let of = |number: fn(&Detections) -> f64| -> Vec<f64> { measured.frames.iter().map(|frame| number(&frame.detections)).collect() };
    let (level_dn, variances) = (median(&of(|own| own.background_dn))?, of(|own| own.noise_dn * own.noise_dn));
    let sigma_dn2 = mad_sigma(&variances)? / (variances.len() as f64).sqrt();
    Some(PhotonTransfer::at_level(level_dn, [median(&variances)?, sigma_dn2], step_of_peaks_dn(measured), stars))
}

/// Step of the codes, by the peaks of the stars: their greatest common distance; 1 where they are no whole numbers.
fn step_of_peaks_dn(measured: &Measured) -> f64 {
    let peaks: Vec<f64> = measured.frames.iter().flat_map(|frame| &frame.detections.stars).map(|star| star.peak_dn).collect();
    let common = |mut a: u64, mut b: u64| {
        while b != 0 {
            (a, b) = (b, a % b);
        }
        a
    };
    let is_whole = peaks.iter().all(|peak| peak.fract() == 0.0 && peak.abs() < 1e9);
    let first = peaks.first().copied().unwrap_or(0.0);
    let step = if is_whole { peaks.iter().fold(0, |step, peak| common(step, (peak - first).abs() as u64)) } else { 0 };
    step.max(1) as f64
}

fn conditions_at(measured: &Measured, gain: f64) -> Option<ImageConditions> {
    if measured.recording.stars.is_some() {
        return None;
    }
    let camera = &measured.recording.camera;
    let mut widths: Vec<f64> = measured.clean_stars().map(|star| star.width_px).filter(|width| *width > 0.0).collect();
    let mut noises: Vec<f64> = measured.frames.iter().map(|frame| frame.detections.noise_dn * gain).collect();
    let noise_e = median_in_place(&mut noises).filter(|noise| *noise > 0.0)?;
    // Where the level of no light is not known, the noise tells how much there is.
    let by_noise = (noise_e * noise_e - camera.read_noise_e.unwrap_or(0.0).powi(2)).max(0.0);
    let mut levels: Vec<f64> = measured
        .frames
        .iter()
        .map(|frame| camera.bias_dn.map_or(by_noise, |bias_dn| ((frame.detections.background_dn - bias_dn) * gain).max(0.0)))
        .collect();
    Some(ImageConditions { psf_sigma_px: median_in_place(&mut widths)?, background_e: median_in_place(&mut levels)?, noise_e })
}

/// The noise as the pixels show it: the stamps of the stars, and the photon-transfer relation of the background. Nothing for a list of stars.
#[must_use]
pub fn measured_noise(measured: &Measured) -> MeasuredNoise {
    if measured.recording.stars.is_some() {
        return MeasuredNoise::default();
    }
    let mut chi2: Vec<f64> = measured.clean_stars().map(|star| star.chi2_per_dof).filter(|value| value.is_finite()).collect();
    let camera = &measured.recording.camera;
    let declared = camera.gain_e_per_dn.zip(camera.bias_dn).zip(camera.read_noise_e);
    let mut ratios: Vec<f64> = declared.map_or_else(Vec::new, |((gain, bias_dn), read_noise_e)| {
        let of = |frame: &MeasuredFrame| {
            let electrons = ((frame.detections.background_dn - bias_dn) * gain).max(0.0);
            frame.detections.noise_dn * gain / (electrons + read_noise_e * read_noise_e).sqrt()
        };
        measured.frames.iter().map(of).filter(|ratio| ratio.is_finite() && *ratio > 0.0).collect()
    });
    MeasuredNoise { stamp_chi2_per_dof: median_in_place(&mut chi2), background_ratio: median_in_place(&mut ratios) }
}

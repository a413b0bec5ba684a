//! What was measured of the control points' images beside their places: brightness and shape, and what these may depend on.

use std::collections::BTreeMap;

use super::{Measured, MeasuredFrame};
use crate::detect::{Detection, Moments};
use crate::diagnose::StarMeasurement;
use crate::effects::{ImageContext, Observation, REFERENCE_FLUX_E};
use crate::identify::{ControlPoint, ControlPoints};
use crate::pixel_statistics::SummedImage;
use crate::recording::FirstRow;
use crate::statistics::median;

/// A control point and a detection nearer than this are the same, px.
const SAME_PX: f64 = 1e-6;
/// Nearer to the horizon than this (cosine of the zenith distance) the air mass has no simple law.
const MIN_COS_ZENITH: f64 = 0.1;

/// Of every control point whose image is neither full nor cut nor blended; none for a list of stars. `parity` −1 where the files' images are
/// mirrored.
#[must_use]
pub fn star_measurements(measured: &Measured, points: &ControlPoints, parity: i8) -> Vec<StarMeasurement> {
    if measured.recording.stars.is_some() {
        return Vec::new();
    }
    let width_px = points.nominal.width_px as f64;
    let detections: BTreeMap<usize, _> = measured.frames.iter().map(|frame| (frame.index, &frame.detections)).collect();
    let has_images = measured.frames.iter().any(|frame| !frame.images.is_empty());
    let of_frame =
        |frame: &MeasuredFrame| -> Places { frame.images.iter().map(|image| (image.found_px.map(f64::to_bits), *image)).collect() };
    let images: BTreeMap<usize, Places> =
        if has_images { measured.frames.iter().map(|frame| (frame.index, of_frame(frame))).collect() } else { BTreeMap::new() };
    let variance_per_dn = variance_per_dn(measured);
    let all_light = all_light(images.values().flat_map(BTreeMap::values), variance_per_dn);
    let mut stars: BTreeMap<[u64; 3], usize> = BTreeMap::new();
    let mut all = Vec::with_capacity(points.points.len());
    // Full is where the recording says, else at the highest peak of all stars.
    let peaks = measured.frames.iter().flat_map(|frame| &frame.detections.stars).map(|star| star.peak_dn);
    let full_dn = measured.recording.camera.saturation_dn.unwrap_or_else(|| peaks.fold(0.0, f64::max));
    for (index, point) in points.points.iter().enumerate() {
        let next = stars.len();
        let star = *stars.entry(point.star.direction.map(f64::to_bits)).or_insert(next);
        let x_px = if parity < 0 { width_px - 1.0 - point.x_px } else { point.x_px };
        let is_same = |own: &&Detection| (own.x_px - x_px).abs() < SAME_PX && (own.y_px - point.y_px).abs() < SAME_PX;
        let Some(own) = detections.get(&point.frame).and_then(|found| found.stars.iter().find(is_same)) else { continue };
        // Sums take the light of other stars off, a fit has it in its numbers.
        if own.flags.saturated || own.flags.edge || (own.flags.blended && !has_images) || own.flux_dn <= 0.0 {
            continue;
        }
        let images = has_images.then(|| images.get(&point.frame)).flatten();
        let Some((flux_dn, flux_sigma_dn, moments)) = light(images, own, variance_per_dn) else { continue };
        all.push(StarMeasurement {
            point: index,
            frame: point.frame,
            star,
            magnitude: point.magnitude,
            flux_dn: flux_dn * all_light,
            flux_sigma_dn: flux_sigma_dn * all_light,
            moments,
            image: context(measured, points, point, own, [x_px, full_dn]),
        });
    }
    let widths: Vec<f64> = all.iter().filter_map(|star| star.moments.as_ref()?.width_px()).collect();
    let fluxes: Vec<f64> = all.iter().map(|star| star.flux_dn).collect();
    let (sigma_px, typical_dn) = (median(&widths).unwrap_or(1.0), median(&fluxes).unwrap_or(1.0));
    let gain = measured.recording.camera.gain_e_per_dn;
    for star in &mut all {
        star.image.sigma_px = sigma_px;
        star.image.relative_flux = Some(gain.map_or(star.flux_dn / typical_dn, |gain| star.flux_dn * gain / REFERENCE_FLUX_E));
    }
    all
}

/// The images of a frame by where their stars were found.
type Places = BTreeMap<[u64; 2], SummedImage>;

/// Variance of the counts per count of light: by the gain as declared, else as the noise of the sky tells it; 0 where neither does.
fn variance_per_dn(measured: &Measured) -> f64 {
    let by_noise = || measured.pixels.as_ref()?.photon_transfer.as_ref()?.gain_e_per_dn;
    measured.recording.camera.gain_e_per_dn.or_else(by_noise).filter(|gain| *gain > 0.0).map_or(0.0, f64::recip)
}

/// What all the light of an image is over the light under the weight: the same for all stars, so that it changes no comparison between them, but the
/// zero point, which says how bright the sky's own light is.
fn all_light<'a>(images: impl Iterator<Item = &'a SummedImage>, variance_per_dn: f64) -> f64 {
    /// Fainter stars tell little of their wings.
    const MIN_SNR: f64 = 50.0;
    let is_bright = |image: &&SummedImage| image.flux_dn > MIN_SNR * image.flux_variance.sigma(variance_per_dn);
    let ratios: Vec<f64> = images.filter(is_bright).map(|image| image.within_ring_dn / image.flux_dn).collect();
    median(&ratios).filter(|ratio| ratio.is_finite() && *ratio > 0.0).unwrap_or(1.0)
}

/// Light with its standard error, and moments: by sums where they were made, else as fitted; nothing where the sums tell nothing.
fn light(images: Option<&Places>, own: &Detection, variance_per_dn: f64) -> Option<(f64, f64, Option<Moments>)> {
    let Some(images) = images else { return Some((own.flux_dn, own.flux_sigma_dn, own.moments.as_deref().copied())) };
    let image = images.get(&[own.x_px, own.y_px].map(f64::to_bits))?;
    let moments = Moments {
        second_px2: image.second_px2,
        second_sigma_px2: image.second_variance.map(|variance| variance.sigma(variance_per_dn)),
        skewness: image.skewness,
        skewness_sigma: image.skewness_variance.map(|variance| variance.sigma(variance_per_dn)),
    };
    Some((image.flux_dn, image.flux_variance.sigma(variance_per_dn), Some(moments)))
}

/// What brightness and shape of an image may depend on, in the columns of the images as stored.
fn context(measured: &Measured, points: &ControlPoints, point: &ControlPoint, own: &Detection, [x_px, full_dn]: [f64; 2]) -> ImageContext {
    let camera = &measured.recording.camera;
    let size = [points.nominal.width_px as f64, points.nominal.height_px as f64];
    let half_px = 0.5 * size[0].hypot(size[1]);
    let observation = points.observation(point.frame);
    let black_dn = camera.bias_dn.unwrap_or(0.0);
    let full_dn = Some(full_dn - black_dn).filter(|full| *full > 0.0);
    let direction = point.direction.xyz;
    let airmass = observation.zenith.filter(|_| !observation.zenith_is_guessed).and_then(|zenith| {
        let cosine: f64 = zenith.iter().zip(direction).map(|(a, b)| a * b).sum();
        (cosine > MIN_COS_ZENITH).then(|| cosine.recip())
    });
    let from_top = (own.y_px + 0.5) / size[1];
    ImageContext {
        at: [(x_px - 0.5 * (size[0] - 1.0)) / half_px, (own.y_px - 0.5 * (size[1] - 1.0)) / half_px],
        phase_px: [x_px - x_px.round(), own.y_px - own.y_px.round()],
        colour_offset: point.colour.map(|_| point.star.colour_offset()),
        fullness: full_dn.map(|full| (own.peak_dn - own.background_dn) / full),
        background_fullness: full_dn.map_or(0.0, |full| (own.background_dn - black_dn).max(0.0) / full),
        relative_flux: None,
        rows_moved: if camera.first_row == Some(FirstRow::Bottom) { 1.0 - from_top } else { from_top },
        airmass,
        temperature_offset_k: observation.temperature_offset_k,
        time_offset_h: observation.time_offset_h,
        trail_px: trail_px(&observation, &points.nominal, [x_px, own.y_px]),
        sigma_px: 1.0,
    }
}

/// The way of a star over the detector while the camera turns at its declared rates: the direction s goes with −ω × s.
fn trail_px(observation: &Observation, camera: &crate::camera::Camera, at_px: [f64; 2]) -> Option<[f64; 2]> {
    let (rate_rad_s, exposure_s) = observation.rate_rad_s.zip(observation.exposure_s)?;
    let focal_px = camera.focal_length_px;
    let [x, y] = [0, 1].map(|axis| (at_px[axis] - camera.principal_point_px[axis]) / focal_px);
    let [turn_x, turn_y, roll] = rate_rad_s;
    // What the direction gains in depth it loses in its tangent.
    let deeper = turn_x * y - turn_y * x;
    Some([roll * y - turn_y + x * deeper, turn_x - roll * x + y * deeper].map(|speed| speed * focal_px * exposure_s))
}

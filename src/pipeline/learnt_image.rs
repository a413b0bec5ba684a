//! The image of a star, learnt where the sky says that the stars are, and places without the bias that follows the pixel phase and the brightness.
//!
//! Whatever estimator measured the places, an image that is not the estimator's shifts them with the phase within the pixel: an S-curve that no physics
//! of the sensor makes; and where it is lopsided, with the brightness: a magnitude equation that is none. The image learnt from pixels alone cannot tell it from another image; the one learnt at the places that catalogue, camera and
//! attitude predict can. The estimator's bias under that image, less its mean over the phases of a faint star, is taken off every place.

use std::collections::BTreeMap;

use super::recording_conditions::line_with_stars;
use super::{Centroid, Measured, MeasuredFrame};
use crate::calibrate::{CalibrateOptions, Calibration, Status, calibrate};
use crate::detect::{
    BiasedStar, Detection, Estimator, LearntImage, PhaseBias, PixelNoise, PredictedStar, SkyImage, learn_from_sky, star_noise,
};
use crate::identify::{ControlPoint, ControlPoints};
use crate::pixel_statistics::StarTransfer;
use crate::statistics::median;

/// A kept star and a control point nearer than this are the same, px.
const SAME_PX: f64 = 0.5;
/// Kelvin that are one unit of what an image changes with.
const TEMPERATURE_UNIT_K: f64 = 10.0;
/// So many of the stars must have a colour, and so many kelvin the temperatures must span, for an image to change with them.
const COLOURED: f64 = 0.8;
const MIN_SPAN_K: f64 = 1.0;

/// Learns the image at the places of a baseline solution, takes the bias that it predicts off the places of all star images of the recording and of the
/// baseline's control points, and solves once more. Of a camera without a declared gain the noise of these stars tells it, too. Places do not change where
/// too few stars' pixels were kept, where stars held out do not prefer an image to Gaussians, or where the residuals of the same stars do not fall.
pub fn take_phase_bias_off(
    measured: &mut Measured,
    baseline: &mut Calibration,
    parity: i8,
    solver: &CalibrateOptions,
) -> Option<LearntImage> {
    let stars = sky_stars(measured, baseline, parity);
    for frame in &mut measured.frames {
        frame.kept = Vec::new();
    }
    let spans = |axis: usize| stars.iter().map(|one| one.conditions[axis]).fold([0.0_f64; 2], |[low, high], v| [low.min(v), high.max(v)]);
    let coloured = stars.iter().filter(|one| one.conditions[0] != 0.0).count() as f64 > COLOURED * stars.len() as f64;
    let [low, high] = spans(1);
    let conditions = [coloured, (high - low) * TEMPERATURE_UNIT_K > MIN_SPAN_K];
    let image = learn_from_sky(&stars, conditions);
    tracing::info!("image at the places of the sky (known to {:.3} px): {}", image.place_sigma_px, image.report.sentence());
    tell_gain(measured, &stars, &image);
    let SkyImage { psf, report, place_sigma_px, .. } = image;
    let psf = psf?;
    let named = conditions_of(baseline);
    let all: Vec<Vec<BiasedStar>> =
        measured.frames.iter().map(|frame| biased(baseline, frame.index, &frame.detections.stars, &named)).collect();
    let estimator = match measured.centroid {
        Centroid::Gaussian => Estimator::Gaussian,
        Centroid::Empirical => measured.own_image.as_ref().map_or(Estimator::Gaussian, Estimator::Empirical),
        Centroid::Windowed => Estimator::Windowed(typical_width_px(measured)?),
    };
    let bias = PhaseBias::predict(&psf, estimator, noise(measured, &stars)?, &all.concat())?;
    let moves = moves(measured, &all, &bias);
    let mut points = baseline.control_points.clone();
    move_points(&mut points, &moves, parity);
    let nearer = |again: &Calibration| {
        let [as_measured, without_bias] = misfits(&points, [baseline, again]);
        again.status == Status::Converged && without_bias < as_measured
    };
    let Some(again) = calibrate(&points, solver).ok().filter(nearer) else {
        tracing::info!("the image that was learnt does not bring the stars nearer to their places: they stay as measured");
        return None;
    };
    let bias_rms_px = move_stars(measured, &moves);
    *baseline = Calibration { reidentified: baseline.reidentified.take(), ..again };
    Some(LearntImage {
        stars: report.stars,
        held_out_stars: report.held_out_stars,
        gaussian_deviance_per_dof: report.gaussian_deviance_per_dof,
        learnt_deviance_per_dof: report.empirical_deviance_per_dof,
        field_order: report.field_order,
        by_colour: psf.changes_with()[0],
        by_temperature: psf.changes_with()[1],
        place_sigma_px,
        bias_rms_px,
    })
}

/// Where no gain is declared, the noise of the stars' light tells it beside the sky's: under the image that was learnt, else under Gaussians.
fn tell_gain(measured: &mut Measured, stars: &[PredictedStar], image: &SkyImage) {
    /// The better the weights, the better the values: the second look has those of the first.
    const LOOKS: usize = 2;
    if measured.recording.camera.gain_e_per_dn.is_some() {
        return;
    }
    let Some(mut expected) = median(&stars.iter().map(|one| one.star.variance_per_dn()).collect::<Vec<_>>()) else { return };
    let mut told = None;
    for _ in 0..LOOKS {
        let noises = star_noise(stars, Some(image), expected);
        told = StarTransfer::fitted(&noises.iter().map(|own| [own.variance_per_dn, own.sigma, own.per_misfit2]).collect::<Vec<_>>());
        expected = told.map_or(expected, |told| told.slope_dn).max(0.0);
    }
    if let Some(told) = told {
        tracing::info!("noise of the light of {} stars: {:.4} ± {:.4} DN per DN", told.stars, told.slope_dn, told.slope_sigma_dn);
    }
    measured.star_noise = told;
    let line = line_with_stars(measured);
    if let Some(pixels) = &mut measured.pixels {
        pixels.photon_transfer = line;
    }
}

/// How far each star image was found from where it is, px: by frame and row, which no mirroring changes.
type Moves = BTreeMap<(usize, u64), [f64; 2]>;

/// The bias of the stars of all frames.
fn moves(measured: &Measured, asked: &[Vec<BiasedStar>], bias: &PhaseBias) -> Moves {
    let of_frame = |(frame, asked): (&MeasuredFrame, &Vec<BiasedStar>)| {
        let index = frame.index;
        frame.detections.stars.iter().zip(asked).map(|(star, asked)| ((index, star.y_px.to_bits()), bias.at(asked))).collect::<Vec<_>>()
    };
    measured.frames.iter().zip(asked).flat_map(of_frame).collect()
}

/// Takes the bias off the stars of all frames and their images by sums. Its rms along columns and rows, px.
fn move_stars(measured: &mut Measured, moves: &Moves) -> [f64; 2] {
    for frame in &mut measured.frames {
        for image in &mut frame.images {
            if let Some(off) = moves.get(&(frame.index, image.found_px[1].to_bits())) {
                image.found_px = [0, 1].map(|axis| image.found_px[axis] - off[axis]);
            }
        }
        for star in &mut frame.detections.stars {
            if let Some(off) = moves.get(&(frame.index, star.y_px.to_bits())) {
                [star.x_px, star.y_px] = [star.x_px - off[0], star.y_px - off[1]];
            }
        }
    }
    let sums = moves.values().fold([0.0; 2], |sum, off| [0, 1].map(|axis| sum[axis] + off[axis] * off[axis]));
    sums.map(|sum| (sum / moves.len().max(1) as f64).sqrt())
}

/// The same for the control points made of them.
fn move_points(points: &mut ControlPoints, moves: &Moves, parity: i8) {
    for point in &mut points.points {
        if let Some(off) = moves.get(&(point.frame, point.y_px.to_bits())) {
            point.x_px -= f64::from(parity) * off[0];
            point.y_px -= off[1];
        }
    }
}

/// A control point in the columns of the files: where it was found, where it is predicted, px, and what it is taken under.
struct PointPlace {
    found: [f64; 2],
    predicted: [f64; 2],
    conditions: [f64; 2],
}

/// Squares of the residuals in stated standard errors, summed over the stars that both solutions hold against their cameras, those of little weight too:
/// the stars that a bias moves farthest are those that the first solution rejects. No star counts for more than a wrong name.
fn misfits(points: &ControlPoints, solutions: [&Calibration; 2]) -> [f64; 2] {
    const MAX_SQUARE: f64 = 25.0;
    let mut sums = [0.0; 2];
    for (index, point) in points.points.iter().enumerate() {
        let [Some(one), Some(other)] = solutions.map(|solution| solution.points.get(index).and_then(|own| own.residual_px)) else {
            continue;
        };
        let variance_px2 = f64::midpoint(point.covariance_px2[0], point.covariance_px2[2]);
        for (sum, [dx, dy]) in sums.iter_mut().zip([one, other]) {
            *sum += ((dx * dx + dy * dy) / variance_px2).min(MAX_SQUARE);
        }
    }
    sums
}

/// The stars whose pixels were kept and that are control points in their place, in the columns of the files.
fn sky_stars(measured: &Measured, baseline: &Calibration, parity: i8) -> Vec<PredictedStar> {
    let width_px = baseline.control_points.nominal.width_px as f64;
    let mut places: BTreeMap<usize, Vec<PointPlace>> = BTreeMap::new();
    for (point, result) in baseline.control_points.points.iter().zip(&baseline.points) {
        let Some([dx, dy]) = result.residual_px.filter(|_| result.weight > 0.5) else { continue };
        let stored = |x_px: f64| if parity < 0 { width_px - 1.0 - x_px } else { x_px };
        let (found, predicted) = ([stored(point.x_px), point.y_px], [stored(point.x_px - dx), point.y_px - dy]);
        places.entry(point.frame).or_default().push(PointPlace { found, predicted, conditions: conditions(baseline, point) });
    }
    let mut stars = Vec::new();
    for frame in &measured.frames {
        let Some(places) = places.get(&frame.index) else { continue };
        for star in &frame.kept {
            let at = star.place_px();
            let near = places.iter().find(|own| (own.found[0] - at[0]).hypot(own.found[1] - at[1]) < SAME_PX);
            stars.extend(near.map(|own| PredictedStar {
                star: star.clone(),
                frame: frame.index,
                predicted_px: own.predicted,
                conditions: own.conditions,
            }));
        }
    }
    stars
}

/// Colour and temperature of a star image as departures from the usual.
fn conditions(baseline: &Calibration, point: &ControlPoint) -> [f64; 2] {
    let warmer_k = baseline.control_points.observation(point.frame).temperature_offset_k.unwrap_or(0.0);
    [point.colour.map_or(0.0, |_| point.star.colour_offset()), warmer_k / TEMPERATURE_UNIT_K]
}

/// The same of all control points, by frame and row, which no mirroring changes.
fn conditions_of(baseline: &Calibration) -> BTreeMap<(usize, u64), [f64; 2]> {
    let points = &baseline.control_points.points;
    points.iter().map(|point| ((point.frame, point.y_px.to_bits()), conditions(baseline, point))).collect()
}

/// What the bias of a frame's stars is asked with; a star without a name has the usual colour.
fn biased(baseline: &Calibration, frame: usize, stars: &[Detection], named: &BTreeMap<(usize, u64), [f64; 2]>) -> Vec<BiasedStar> {
    let warmer_k = baseline.control_points.observation(frame).temperature_offset_k.unwrap_or(0.0);
    let of = |star: &Detection| BiasedStar {
        at_px: [star.x_px, star.y_px],
        flux_dn: star.flux_dn,
        conditions: named.get(&(frame, star.y_px.to_bits())).copied().unwrap_or([0.0, warmer_k / TEMPERATURE_UNIT_K]),
    };
    stars.iter().map(of).collect()
}

/// The frames' typical width of images: in a window it is that of all faint stars.
fn typical_width_px(measured: &Measured) -> Option<f64> {
    median(&measured.frames.iter().flat_map(|frame| &frame.detections.stars).map(|star| star.width_px).collect::<Vec<_>>())
}

/// The noise that the estimator weighted with, and from where on pixels took no part.
fn noise(measured: &Measured, stars: &[PredictedStar]) -> Option<PixelNoise> {
    let sky_dn = median(&measured.frames.iter().map(|frame| frame.detections.noise_dn).collect::<Vec<_>>())?;
    let per_dn = median(&stars.iter().map(|one| one.star.variance_per_dn()).collect::<Vec<_>>())?;
    let all = measured.frames.iter().flat_map(|frame| &frame.detections.stars);
    let full = all.filter(|star| star.flags.saturated).map(|star| star.peak_dn - star.background_dn);
    let full_dn = median(&full.collect::<Vec<_>>()).unwrap_or(f64::INFINITY);
    (sky_dn > 0.0).then_some(PixelNoise { sky_dn2: sky_dn * sky_dn, per_dn, full_dn })
}

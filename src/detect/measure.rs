//! The stages of detection in sequence: from a frame to its list of stars.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use rayon::prelude::*;

use super::background::Background;
use super::candidates::{Candidate, candidates, full_blobs};
use super::defects;
use super::epsf::EmpiricalPsf;
use super::epsf_build::PsfStar;
use super::field_fit::FieldFit;
use super::filter_run::{Ground, Search};
use super::fit::{Fit, Freedom, SNR_FOR_WIDTH};
use super::gain;
use super::image_circle;
use super::image_model::{Model, Shape};
use super::psf::Profile;
use super::search::{FIRST_SIGMA_PX, SHARPEST_PX, search};
use super::simultaneous_fit::FitSettings;
use super::stamp::Scene;
use super::work::{DESCRIBED, PARTED, WEIGHED, Work};
use super::{DetectError, DetectOptions, Detection, Detections, Flags};
use crate::frame::Frame;
use crate::parallel;
use crate::statistics::order::sort_by;

/// Smallest side of a frame, px: a star's window.
const MIN_SIDE_PX: usize = 9;
/// What is known besides the frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct Aids<'a> {
    /// The image of a star. Position, flux and χ² come from fits of it, widths still from Gaussians.
    pub psf: Option<&'a EmpiricalPsf>,
    /// Pixels that say nothing, row by row: hot ones of a dark frame.
    pub bad: Option<&'a [bool]>,
    /// At most so many clean stars are handed back with their pixels, the brightest, for [`super::learn()`].
    pub keep: usize,
    /// When to come to an end: what is found by then is the answer, and depends on the machine.
    pub deadline: Option<Instant>,
    /// Where it is said that something was left undone: by the deadline, or since more in the frame looks like stars than can be measured.
    pub is_unfinished: Option<&'a AtomicBool>,
}

/// Finds and measures the stars of a frame, brightest first. The same frame gives the same result at any number of threads.
///
/// ```
/// use boresight::detect::{DetectOptions, detect};
/// use boresight::frame::Frame;
///
/// // One star of σ 1.2 px at (20.3, 14.8) on a flat sky.
/// let light = |x: f64, y: f64| 4000.0 * (-0.5 * ((x - 20.3).powi(2) + (y - 14.8).powi(2)) / 1.44).exp();
/// let grain = |i: usize| f64::from((i as u32).wrapping_mul(2_654_435_761) >> 28) - 7.5;
/// let pixels_dn = (0..48 * 40).map(|i| (100.0 + light((i % 48) as f64, (i / 48) as f64) + grain(i)) as f32).collect();
/// let frame = Frame { width_px: 48, height_px: 40, pixels_dn, saturation_dn: 65_535.0 };
/// let found = detect(&frame, &DetectOptions { psf_sigma_px: Some(1.2), ..DetectOptions::default() })?;
/// let star = &found.stars[0];
/// assert!((star.x_px - 20.3).abs() < 0.02 && (star.y_px - 14.8).abs() < 0.02, "{star:?}");
/// # Ok::<(), boresight::detect::DetectError>(())
/// ```
pub fn detect(frame: &Frame, options: &DetectOptions) -> Result<Detections, DetectError> {
    detect_aided(frame, options, &Aids::default()).map(|found| found.0)
}

/// The same with what else is known.
pub fn detect_aided(frame: &Frame, options: &DetectOptions, aids: &Aids<'_>) -> Result<(Detections, Vec<PsfStar>), DetectError> {
    check(frame, options)?;
    if let Some(bad) = aids.bad.filter(|bad| bad.len() != frame.pixels_dn.len()) {
        return Err(DetectError::MaskSize { mask: bad.len(), frame: frame.pixels_dn.len() });
    }
    let work = Work::on(frame.pixels_dn.len(), aids.deadline);
    let full = full(frame);
    let around = image_circle::surround(frame);
    let no_sky: Vec<bool> =
        (0..full.len()).map(|i| full[i] || around.as_ref().is_some_and(|around| around[i]) || aids.bad.is_some_and(|bad| bad[i])).collect();
    let mut background = Background::measure(frame, &no_sky);
    let (mut residual, mut normalised) = residuals(frame, &background);
    let hot = unusable(&normalised, frame.width_px, [aids.bad, around.as_deref()]);
    darken(&mut residual, &mut normalised, &hot);
    let masked: Vec<bool> = hot.iter().zip(&full).map(|(h, f)| *h || *f).collect();
    // a first look shows where stars are, so that their light can be kept out of background and noise
    let first_shape = Shape::round(options.psf_sigma_px.unwrap_or(FIRST_SIGMA_PX));
    let (is_cut, is_in_blocks) = (background.is_cut, background.is_in_blocks);
    let ground = Ground { normalised: &normalised, width: frame.width_px, is_cut, is_in_blocks, options, work: &work };
    let first = Search::at_shape(first_shape, false, &ground);
    background.refine(frame, &masked, &first.lit);
    (residual, normalised) = residuals(frame, &background);
    darken(&mut residual, &mut normalised, &hot);
    let (background_dn, noise_dn) = background.typical();
    let mut found = Detections { width_px: frame.width_px, height_px: frame.height_px, background_dn, noise_dn, stars: Vec::new() };
    if full.iter().all(|f| *f) {
        return Ok((found, Vec::new()));
    }

    let blobs = full_blobs(frame.width_px, &full, &hot);
    let variance_per_dn = options.gain_e_per_dn.map(|g| 1.0 / g);
    let noise_floor_dn = options.read_noise_e.zip(options.gain_e_per_dn).map_or(0.0, |(e, g)| e / g);
    let mut scene = Scene {
        frame,
        background: &background,
        masked: &masked,
        variance_per_dn: variance_per_dn.unwrap_or(0.0),
        noise_floor_dn,
        psf: aids.psf,
        work: &work,
    };
    let ground = Ground { normalised: &normalised, width: frame.width_px, is_cut, is_in_blocks, options, work: &work };
    let search = search(&scene, options, first, &residual, &ground, &blobs);
    let candidates = candidates(frame, &background, &search, &blobs);
    let freedom = |c: &Candidate| free_shape(options, &search, c);

    let mut stars = FieldFit::new(candidates);
    if variance_per_dn.is_none() {
        scene.variance_per_dn = gain::variance_per_dn(&scene, &stars.samples(frame, freedom, false), WEIGHED);
    }
    let fitting = |scene, empirical| FitSettings {
        scene,
        freedom,
        typical: search.shape,
        scatter: search.scatter,
        width_is_known: options.psf_sigma_px.is_some(),
        empirical,
    };
    let with_gaussians = scene;
    fitting(&with_gaussians, false).begin(&mut stars);
    if aids.psf.is_some() && variance_per_dn.is_none() {
        scene.variance_per_dn = gain::variance_per_dn(&scene, &stars.samples(frame, |_| Freedom::Empirical, true), PARTED);
    }
    if aids.psf.is_some() {
        fitting(&scene, true).again(&mut stars);
    }
    // trails differ from place to place, and two near each other are no other than a longer one
    if search.field.is_none() && !search.shape.trail {
        fitting(&scene, aids.psf.is_some()).part(&mut stars);
    }
    let kept = learnable(&scene, &stars, &search, aids.keep);

    let chosen = chosen(&scene, &stars, &search, options.max_stars);
    found.stars = described(&scene, &stars, &search, chosen);
    if let Some(told) = aids.is_unfinished.filter(|_| work.is_unfinished()) {
        told.store(true, Ordering::Relaxed);
    }
    Ok((found, kept))
}

/// The fits that are of stars, each star once, with the indices of their candidates; the brightest first, and at most so many.
fn chosen(scene: &Scene<'_>, stars: &FieldFit, search: &Search, most: usize) -> Vec<(usize, Detection)> {
    let mut chosen: Vec<(usize, Detection)> = Vec::with_capacity(stars.candidates.len());
    for (i, (candidate, fit)) in stars.candidates.iter().zip(&stars.fits).enumerate() {
        let Some(fit) = fit.as_ref().filter(|f| is_star(candidate, f, search, (scene.frame.width_px, scene.frame.height_px))) else {
            continue;
        };
        let own = search.shape_at(fit.model.x, fit.model.y);
        let duplicate = |s: &Detection| own.radius_in_sigma(s.x_px - fit.model.x, s.y_px - fit.model.y) < 1.0;
        if !chosen.iter().any(|(_, star)| duplicate(star)) {
            let wider = stars.wider[i].unwrap_or_default();
            let flags = Flags {
                saturated: candidate.full_radius_px > 0.0,
                blended: stars.is_blended(i),
                edge: fit.edge,
                is_unresolved: stars.wider[i].is_some(),
            };
            chosen.push((i, detection(scene, fit, flags, search.scatter).wider_by(wider)));
        }
    }
    sort_by(&mut chosen, |(_, a), (_, b)| b.flux_dn.total_cmp(&a.flux_dn).then(a.y_px.total_cmp(&b.y_px)).then(a.x_px.total_cmp(&b.x_px)));
    chosen.truncate(most);
    chosen
}

/// The stars chosen, with the moments of their images.
fn described(scene: &Scene<'_>, stars: &FieldFit, search: &Search, chosen: Vec<(usize, Detection)>) -> Vec<Detection> {
    let moments = |(i, star): &(usize, Detection)| {
        let moments = stars.fits[*i].as_ref().and_then(|fit| scene.moments(fit, &stars.around(&[*i])));
        // they are of the image as it is, whatever the fit takes it for: of what enlarges errors only the noise's going together counts
        let factor = correlated(scene, star.peak_dn, star.x_px, star.y_px, search.scatter).sqrt();
        moments.map(|m| Box::new(m.with_errors_times(factor)))
    };
    let moments = scene.work.each(&chosen, DESCRIBED, moments);
    chosen.into_iter().zip(moments).map(|((_, star), moments)| Detection { moments: moments.flatten(), ..star }).collect()
}

/// Clean stars with their pixels, the brightest first.
fn learnable(scene: &Scene<'_>, stars: &FieldFit, search: &Search, most: usize) -> Vec<PsfStar> {
    /// Fainter stars tell little.
    const MIN_SNR: f64 = 12.0;
    let size_px = (scene.frame.width_px, scene.frame.height_px);
    let clean = |i: &usize| {
        let (candidate, fit) = (&stars.candidates[*i], stars.fits[*i].as_ref());
        candidate.full_radius_px == 0.0
            && !stars.is_blended(*i)
            && fit.is_some_and(|f| !f.edge && f.model.flux_dn > MIN_SNR * f.flux_sigma_dn && is_star(candidate, f, search, size_px))
    };
    let keep = |i: usize| {
        let fit = stars.fits[i].as_ref()?;
        let mut profile = Profile::new();
        let mut stamp = scene.stamp(Model { shape: search.shape, ..fit.model }, &[], &mut profile);
        let freedom = if fit.model.shape.is_round() { Freedom::Width } else { Freedom::Ellipse };
        let (model, offset) = scene.photons().settle(&mut stamp, fit.model, freedom, &mut profile)?;
        profile.draw(stamp.window, &model, freedom == Freedom::Ellipse);
        let count = freedom.parameters();
        let deviance = scene.photons().deviance(&stamp, &profile, model.flux_dn, offset);
        let dof = stamp.used.iter().filter(|u| **u).count().saturating_sub(count).max(1);
        Some(PsfStar {
            stamp,
            model,
            photons: scene.photons(),
            snr: model.flux_dn / fit.flux_sigma_dn,
            gaussian: (deviance, dof as f64),
            covariance_px2: fit.covariance_px2,
            conditions: [0.0; 2],
            sky: None,
            size_px: [size_px.0 as f64, size_px.1 as f64],
        })
    };
    let chosen: Vec<usize> = (0..stars.candidates.len()).filter(clean).take(most).collect();
    parallel::map(&chosen, |index| keep(*index)).into_iter().flatten().collect()
}

/// Whether any count is no number: a look without branches, which is quick.
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn odd(counts: &[f32]) -> bool {
    counts.iter().fold(0_u32, |odd, v| odd | u32::from(!v.is_finite())) != 0
}

pub(super) fn check(frame: &Frame, options: &DetectOptions) -> Result<(), DetectError> {
    let (width_px, height_px) = (frame.width_px, frame.height_px);
    if width_px.checked_mul(height_px) != Some(frame.pixels_dn.len()) {
        return Err(DetectError::SizeMismatch { width_px, height_px, found: frame.pixels_dn.len() });
    }
    if width_px < MIN_SIDE_PX || height_px < MIN_SIDE_PX {
        return Err(DetectError::TooSmall { width_px, height_px, least_px: MIN_SIDE_PX });
    }
    if let Some(i) = odd(&frame.pixels_dn).then(|| frame.pixels_dn.iter().position(|v| !v.is_finite())).flatten() {
        return Err(DetectError::NotFinite { x: i % width_px, y: i / width_px, value: frame.pixels_dn[i] });
    }
    let positive = |name, value: Option<f64>, range, good: fn(f64) -> bool| match value {
        Some(value) if !good(value) => Err(DetectError::Option { name, value, range }),
        _ => Ok(()),
    };
    positive("false_alarms_per_frame", Some(options.false_alarms_per_frame), "above 0 and finite", |v| v > 0.0 && v.is_finite())?;
    positive("psf_sigma_px", options.psf_sigma_px, "between 0.3 and 12", |v| (0.3..=12.0).contains(&v))?;
    positive("detection_threshold", options.detection_threshold, "from 2 to 1000", |v| (2.0..=1000.0).contains(&v))?;
    positive("gain_e_per_dn", options.gain_e_per_dn, "above 0 and finite", |v| v > 0.0 && v.is_finite())?;
    positive("read_noise_e", options.read_noise_e, "0 or above and finite", |v| v >= 0.0 && v.is_finite())
}

/// Which pixels are full.
fn full(frame: &Frame) -> Vec<bool> {
    let saturation_dn = defects::saturation_dn(frame);
    frame.pixels_dn.iter().map(|&v| v >= saturation_dn).collect()
}

/// Hot pixels, and those of masks that say nothing either.
fn unusable(normalised: &[f32], width_px: usize, masks: [Option<&[bool]>; 2]) -> Vec<bool> {
    let mut hot = defects::hot_pixels(normalised, width_px);
    for bad in masks.into_iter().flatten() {
        for (hot, bad) in hot.iter_mut().zip(bad) {
            *hot |= bad;
        }
    }
    hot
}

/// Takes hot pixels out.
fn darken(residual: &mut [f32], normalised: &mut [f32], hot: &[bool]) {
    for ((r, n), _) in residual.iter_mut().zip(normalised).zip(hot).filter(|(_, hot)| **hot) {
        (*r, *n) = (0.0, 0.0);
    }
}

/// Counts less the background, in DN and in units of the noise.
fn residuals(frame: &Frame, background: &Background) -> (Vec<f32>, Vec<f32>) {
    let width = frame.width_px;
    let mut residual = vec![0.0_f32; frame.pixels_dn.len()];
    let mut normalised = residual.clone();
    residual.par_chunks_mut(width).zip(normalised.par_chunks_mut(width)).enumerate().for_each(|(y, (r, n))| {
        background.subtract_row(frame, y, r);
        background.noise_row(y, n);
        for (n, r) in n.iter_mut().zip(r) {
            *n = *r / *n;
        }
    });
    (residual, normalised)
}

fn free_shape(options: &DetectOptions, search: &Search, candidate: &Candidate) -> Freedom {
    if candidate.full_radius_px > 0.0 {
        return Freedom::Width;
    }
    if options.psf_sigma_px.is_some() || (candidate.snr < SNR_FOR_WIDTH && search.shape_known) {
        Freedom::Fixed
    } else if candidate.start.shape.is_round() {
        Freedom::Width
    } else {
        Freedom::Ellipse
    }
}

/// Whether the fit is that of a star: on the frame, of positive flux, near where it was found, and as wide as light makes it.
fn is_star(candidate: &Candidate, fit: &Fit, search: &Search, frame_px: (usize, usize)) -> bool {
    /// Fits of σ below this share of the frame's width are hot pixels in groups, or cosmic rays.
    const SHARP: f64 = 0.5;
    /// A fit may find so much less than the filter; if less, the peak was a ripple on other light.
    const MIN_SHARE: f64 = 0.6;
    // A star beside the frame whose wing reaches in: only the tail of its image is seen, and no position worth the name.
    let on_frame = |v: f64, n: usize| v > -0.5 && v < n as f64 - 0.5;
    if !on_frame(fit.model.x, frame_px.0) || !on_frame(fit.model.y, frame_px.1) {
        return false;
    }
    let snr = fit.model.flux_dn / fit.flux_sigma_dn;
    if snr < MIN_SHARE * search.threshold {
        return false;
    }
    if candidate.full_radius_px > 0.0 {
        return true;
    }
    let (_, short) = fit.model.shape.axes_px();
    let sharp = short < if search.shape_known { 0.3_f64.max(SHARP * search.shape.axes_px().1) } else { SHARPEST_PX };
    fit.lone_pixel_excess > 0.0 && !sharp
}

fn pixel_of(frame: &Frame, x: f64, y: f64) -> (usize, usize) {
    let inside = |v: f64, n: usize| v.round().clamp(0.0, (n - 1) as f64) as usize;
    (inside(x, frame.width_px), inside(y, frame.height_px))
}

/// By what the variance grows where the noise goes together from pixel to pixel, as far as it is the background's.
fn correlated(scene: &Scene<'_>, peak_dn: f64, x: f64, y: f64, scatter: f64) -> f64 {
    let (x, y) = pixel_of(scene.frame, x, y);
    let sigma = scene.background.noise_dn(x, y);
    let light = peak_dn - scene.background.level_dn(x, y);
    let share = sigma * sigma / (sigma * sigma + 0.5 * light.max(0.0) * scene.variance_per_dn);
    1.0 + (scatter * scatter - 1.0) * share
}

fn detection(scene: &Scene<'_>, fit: &Fit, flags: Flags, scatter: f64) -> Detection {
    let model = fit.model;
    let (x, y) = pixel_of(scene.frame, model.x, model.y);
    let chi2_per_dof = fit.chi2 / fit.dof as f64;
    // where the model fits worse than chance allows the errors are larger in that measure
    let misfit = (chi2_per_dof / (1.0 + 3.0 * (2.0 / fit.dof as f64).sqrt())).max(1.0);
    let factor = misfit * correlated(scene, fit.peak_dn, model.x, model.y, scatter);
    Detection {
        x_px: model.x,
        y_px: model.y,
        covariance_px2: fit.covariance_px2.map(|c| c * factor),
        flux_dn: model.flux_dn,
        flux_sigma_dn: fit.flux_sigma_dn * factor.sqrt(),
        background_dn: scene.background.level_dn(x, y) + fit.offset_dn,
        background_gradient_dn: fit.gradient_dn,
        width_px: model.shape.sigma_px(),
        moments: None,
        chi2_per_dof,
        peak_dn: fit.peak_dn,
        flags,
    }
}

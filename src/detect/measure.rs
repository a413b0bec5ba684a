//! The stages put together: from one frame to its list of stars.

use rayon::prelude::*;

use super::background::Background;
use super::candidates::{Candidate, candidates, full_blobs, neighbours};
use super::defects;
use super::empirical::EmpiricalPsf;
use super::fit::{Fit, Freedom, Model, Scene};
use super::gain::{self, Sample};
use super::learn::PsfStar;
use super::psf::{Profile, Shape};
use super::search::{FIRST_SIGMA_PX, SHARPEST_PX, Search, search};
use super::surround;
use super::{DetectError, DetectOptions, Detection, Detections, Flags};
use crate::frame::Frame;

/// Smallest side of a frame, px: a star's window.
const LEAST_SIDE_PX: usize = 9;
/// Stars from this signal-to-noise ratio on have their own width fitted.
pub(super) const SNR_FOR_WIDTH: f64 = 30.0;
/// So often stars are fitted again with their neighbours as these were fitted last. Of two that are 4 px apart (σ 1.1 px) after 2 rounds 0.02 px are
/// left of what each took for the other's light.
const ROUNDS: usize = 8;

/// What is known besides the frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct Aids<'a> {
    /// The image of a star. Position, flux and χ² come from fits of it, widths still from Gaussians.
    pub psf: Option<&'a EmpiricalPsf>,
    /// Pixels that say nothing, row by row: hot ones of a dark frame.
    pub bad: Option<&'a [bool]>,
    /// At most so many clean stars are handed back with their pixels, the brightest, for [`super::learn`].
    pub keep: usize,
}

/// Finds and measures the stars of a frame, brightest first. The same frame gives the same result at any number of threads.
pub fn detect(frame: &Frame, options: &DetectOptions) -> Result<Detections, DetectError> {
    detect_aided(frame, options, &Aids::default()).map(|found| found.0)
}

/// The same with what else is known.
pub fn detect_aided(frame: &Frame, options: &DetectOptions, aids: &Aids<'_>) -> Result<(Detections, Vec<PsfStar>), DetectError> {
    check(frame, options)?;
    if let Some(bad) = aids.bad.filter(|bad| bad.len() != frame.pixels_dn.len()) {
        return Err(DetectError::MaskSize { mask: bad.len(), frame: frame.pixels_dn.len() });
    }
    let saturation_dn = defects::saturation_dn(frame);
    let full: Vec<bool> = frame.pixels_dn.iter().map(|&v| v >= saturation_dn).collect();
    let around = surround::surround(frame);
    let no_sky: Vec<bool> = full.iter().enumerate().map(|(i, f)| *f || around.as_ref().is_some_and(|around| around[i])).collect();
    let mut background = Background::measure(frame, &no_sky);
    let (mut residual, mut normalised) = residuals(frame, &background);
    let mut hot = defects::hot_pixels(&normalised, frame.width_px);
    for bad in [aids.bad, around.as_deref()].into_iter().flatten() {
        for (hot, bad) in hot.iter_mut().zip(bad) {
            *hot |= bad;
        }
    }
    darken(&mut residual, &mut normalised, &hot);
    let masked: Vec<bool> = hot.iter().zip(&full).map(|(h, f)| *h || *f).collect();
    // a first look shows where stars are, so that their light can be kept out of background and noise
    let first_shape = Shape::round(options.psf_sigma_px.unwrap_or(FIRST_SIGMA_PX));
    let first = Search::at_shape(first_shape, false, &normalised, frame.width_px, options.false_alarms_per_frame);
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
    };
    let search = search(&scene, options, first, &residual, &normalised, &blobs);
    let candidates = candidates(frame, &background, &search, &blobs);
    let freedom = |c: &Candidate| free_shape(options, &search, c);

    // each star alone, the guessed light of its neighbours taken off; then with the neighbours as fitted
    let guesses: Vec<Model> = candidates.iter().map(|c| c.start).collect();
    let neighbours = neighbours(&guesses);
    if variance_per_dn.is_none() {
        let sample = |(i, c): (usize, &Candidate)| Sample {
            start: c.start,
            snr: c.snr,
            freedom: freedom(c),
            neighbours: neighbours[i].iter().map(|&j| guesses[j]).collect(),
        };
        let samples: Vec<Sample> = candidates.iter().enumerate().filter(|(_, c)| c.full_radius_px == 0.0).map(sample).collect();
        scene.variance_per_dn = gain::variance_per_dn(&scene, &samples);
    }
    let mut fits = fit_all(&scene, &candidates, &guesses, &neighbours, &freedom, None);
    let mut moved = vec![true; candidates.len()];
    for _ in 0..ROUNDS {
        let again: Vec<bool> = neighbours.iter().map(|near| near.iter().any(|&j| moved[j])).collect();
        let next = fit_all(&scene, &candidates, &fitted(&guesses, &fits), &neighbours, &freedom, Some((&fits, &again)));
        moved = next.iter().zip(&fits).map(|(new, old)| has_moved(new.as_ref(), old.as_ref())).collect();
        fits = next;
    }
    let kept = learnable(&scene, &candidates, &fits, &neighbours, &search, aids.keep);
    if aids.psf.is_some() {
        fits = fit_empirical(&mut scene, &candidates, &fits, &neighbours, options.gain_e_per_dn.is_none());
    }

    let mut stars: Vec<(usize, Detection)> = Vec::with_capacity(candidates.len());
    for (i, (candidate, fit)) in candidates.iter().zip(&fits).enumerate() {
        let Some(fit) = fit.as_ref().filter(|f| is_star(candidate, f, &search, (scene.frame.width_px, scene.frame.height_px))) else {
            continue;
        };
        let own = search.shape_at(fit.model.x, fit.model.y);
        let duplicate = |s: &Detection| own.radius_in_sigma(s.x_px - fit.model.x, s.y_px - fit.model.y) < 1.0;
        if !stars.iter().any(|(_, star)| duplicate(star)) {
            stars.push((i, detection(&scene, fit, candidate, !neighbours[i].is_empty(), search.scatter)));
        }
    }
    stars.sort_by(|(_, a), (_, b)| b.flux_dn.total_cmp(&a.flux_dn).then(a.y_px.total_cmp(&b.y_px)).then(a.x_px.total_cmp(&b.x_px)));
    stars.truncate(options.max_stars);
    let models = fitted(&guesses, &fits);
    let with_moments = |(i, star): (usize, Detection)| {
        let others: Vec<Model> = neighbours[i].iter().map(|&j| models[j]).collect();
        let moments = fits[i].as_ref().and_then(|fit| scene.moments(fit, &others));
        // they are of the image as it is, whatever the fit takes it for: of what enlarges errors only the noise's going together counts
        let factor = correlated(&scene, star.peak_dn, star.x_px, star.y_px, search.scatter).sqrt();
        Detection { moments: moments.map(|m| m.with_errors_times(factor)), ..star }
    };
    found.stars = stars.into_par_iter().map(with_moments).collect();
    Ok((found, kept))
}

/// Fits again with the empirical image all stars that are not saturated; those that it cannot fit stay as they are.
fn fit_empirical(
    scene: &mut Scene<'_>,
    candidates: &[Candidate],
    gaussian: &[Option<Fit>],
    neighbours: &[Vec<usize>],
    gain_is_sought: bool,
) -> Vec<Option<Fit>> {
    let starts: Vec<Option<Candidate>> = candidates
        .iter()
        .zip(gaussian)
        .map(|(c, fit)| fit.as_ref().filter(|_| c.full_radius_px == 0.0).map(|f| Candidate { start: f.model, ..*c }))
        .collect();
    let mut models: Vec<Model> = candidates.iter().zip(gaussian).map(|(c, fit)| model_or_dark(&c.start, fit.as_ref())).collect();
    if gain_is_sought {
        let sample = |(i, c): (usize, &Candidate)| Sample {
            start: c.start,
            snr: c.snr,
            freedom: Freedom::Empirical,
            neighbours: neighbours[i].iter().map(|&j| models[j]).collect(),
        };
        let samples: Vec<Sample> = starts.iter().enumerate().filter_map(|(i, c)| c.as_ref().map(|c| sample((i, c)))).collect();
        scene.variance_per_dn = gain::variance_per_dn(scene, &samples);
    }
    let mut fits = gaussian.to_vec();
    for round in 0..3 {
        let again = |i: usize| -> Option<Fit> {
            let Some(candidate) = starts[i].filter(|_| round == 0 || !neighbours[i].is_empty()) else {
                return fits[i].clone();
            };
            let others: Vec<Model> = neighbours[i].iter().map(|&j| models[j]).collect();
            let fit = scene.fit(candidate.start, Freedom::Empirical, &others);
            fit.or_else(|| gaussian[i].clone())
        };
        fits = (0..fits.len()).into_par_iter().map(again).collect();
        models = models.iter().zip(&fits).map(|(m, fit)| model_or_dark(m, fit.as_ref())).collect();
    }
    fits
}

/// Clean stars with their pixels, the brightest first.
fn learnable(
    scene: &Scene<'_>,
    candidates: &[Candidate],
    fits: &[Option<Fit>],
    neighbours: &[Vec<usize>],
    search: &Search,
    most: usize,
) -> Vec<PsfStar> {
    /// Fainter stars tell little.
    const LEAST_SNR: f64 = 12.0;
    let size_px = (scene.frame.width_px, scene.frame.height_px);
    let clean = |i: &usize| {
        let (candidate, fit) = (&candidates[*i], fits[*i].as_ref());
        candidate.full_radius_px == 0.0
            && neighbours[*i].is_empty()
            && fit.is_some_and(|f| !f.edge && f.model.flux_dn > LEAST_SNR * f.flux_sigma_dn && is_star(candidate, f, search, size_px))
    };
    let keep = |i: usize| {
        let fit = fits[i].as_ref()?;
        let mut profile = Profile::new();
        let mut stamp = scene.stamp(Model { shape: search.shape, ..fit.model }, &[], &mut profile);
        let freedom = if fit.model.shape.is_round() { Freedom::Width } else { Freedom::Ellipse };
        let (model, offset) = scene.photons().settle(&mut stamp, fit.model, freedom, &mut profile)?;
        profile.draw(stamp.window, &model, freedom == Freedom::Ellipse);
        let count = freedom.parameters();
        let chi2 = scene.photons().normal(&stamp, &profile, model.flux_dn, offset, count).chi2;
        let dof = stamp.used.iter().filter(|u| **u).count().saturating_sub(count).max(1);
        Some(PsfStar {
            stamp,
            model,
            photons: scene.photons(),
            snr: model.flux_dn / fit.flux_sigma_dn,
            gaussian: (chi2, dof as f64),
            size_px: [size_px.0 as f64, size_px.1 as f64],
        })
    };
    let chosen: Vec<usize> = (0..candidates.len()).filter(clean).take(most).collect();
    chosen.into_par_iter().map(keep).collect::<Vec<_>>().into_iter().flatten().collect()
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
    if width_px < LEAST_SIDE_PX || height_px < LEAST_SIDE_PX {
        return Err(DetectError::TooSmall { width_px, height_px, least_px: LEAST_SIDE_PX });
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
    positive("gain_e_per_dn", options.gain_e_per_dn, "above 0 and finite", |v| v > 0.0 && v.is_finite())?;
    positive("read_noise_e", options.read_noise_e, "0 or above and finite", |v| v >= 0.0 && v.is_finite())
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

/// Whether a fit differs from the one before by more than a twentieth of its errors.
fn has_moved(new: Option<&Fit>, old: Option<&Fit>) -> bool {
    const LITTLE: f64 = 0.05;
    let (Some(new), Some(old)) = (new, old) else { return new.is_some() != old.is_some() };
    let sigma_px = new.covariance_px2[0].min(new.covariance_px2[2]).sqrt();
    let distance_px = (new.model.x - old.model.x).hypot(new.model.y - old.model.y);
    let width_px = (new.model.shape.sigma_px() - old.model.shape.sigma_px()).abs();
    distance_px.max(width_px) > LITTLE * sigma_px || (new.model.flux_dn - old.model.flux_dn).abs() > LITTLE * new.flux_sigma_dn
}

/// Fits all stars, or, given earlier fits, again those that are marked.
fn fit_all(
    scene: &Scene<'_>,
    candidates: &[Candidate],
    models: &[Model],
    neighbours: &[Vec<usize>],
    freedom: &(impl Fn(&Candidate) -> Freedom + Sync),
    earlier: Option<(&[Option<Fit>], &[bool])>,
) -> Vec<Option<Fit>> {
    candidates
        .par_iter()
        .enumerate()
        .map(|(i, candidate)| {
            if let Some((earlier, _)) = earlier.filter(|(_, again)| !again[i]) {
                return earlier[i].clone();
            }
            let others: Vec<Model> = neighbours[i].iter().map(|&j| models[j]).collect();
            let first = scene.fit(candidate.start, freedom(candidate), &others);
            // a width that runs away takes the star with it: then the shape of the others must do
            first.or_else(|| scene.fit(candidate.start, Freedom::Fixed, &others))
        })
        .collect()
}

/// Models as fitted; where the fit failed no light at all.
fn fitted(guesses: &[Model], fits: &[Option<Fit>]) -> Vec<Model> {
    guesses.iter().zip(fits).map(|(guess, fit)| model_or_dark(guess, fit.as_ref())).collect()
}

fn model_or_dark(guess: &Model, fit: Option<&Fit>) -> Model {
    fit.map_or(Model { flux_dn: 0.0, ..*guess }, |f| f.model)
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
    const LEAST_SHARE: f64 = 0.6;
    // A star beside the frame whose wing reaches in: only the tail of its image is seen, and no position worth the name.
    let on_frame = |v: f64, n: usize| v > -0.5 && v < n as f64 - 0.5;
    if !on_frame(fit.model.x, frame_px.0) || !on_frame(fit.model.y, frame_px.1) {
        return false;
    }
    let snr = fit.model.flux_dn / fit.flux_sigma_dn;
    if snr < LEAST_SHARE * search.threshold {
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

fn detection(scene: &Scene<'_>, fit: &Fit, candidate: &Candidate, blended: bool, scatter: f64) -> Detection {
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
        flags: Flags { saturated: candidate.full_radius_px > 0.0, blended, edge: fit.edge },
    }
}

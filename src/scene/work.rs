//! Work limit of a scene: a frame that would cost too much is refused before the work, with the number that is too large.

use super::JitterTable;
use super::{Psf, PsfKind, SceneError, SceneFile};
use crate::units::{ARCSEC_RAD, DEG_RAD};

/// Pixels of the detector: more than any detector that was built has.
const MAX_PIXELS: f64 = 160e6;
/// The way of a star over the detector during an exposure, px.
const LONGEST_TRAIL_PX: f64 = 1e5;
/// The turn of the camera during an exposure.
const LARGEST_TURN_DEG: f64 = 400.0;
/// Motion that is faster than the exposure, in pixels of the detector and, where images are tables, in widths of the image too.
const WIDEST_BLUR_PX: f64 = 50.0;
const WIDEST_BLUR_WIDTHS: f64 = 5.0;
/// Particles, trails of satellites, points of light along all tracks and trails of a frame.
const MAX_PARTICLES: f64 = 1e5;
const MAX_TRAILS: f64 = 1e3;
const MAX_POINTS: f64 = 1e7;

/// What is too large, for a message.
struct TooLarge {
    key: String,
    value: String,
    what: String,
}

/// Says no if a number is beyond its limit (or is none).
fn limit(key: impl Into<String>, value: &dyn std::fmt::Display, amount: f64, most: f64, what: &str) -> Result<(), TooLarge> {
    if amount <= most {
        return Ok(());
    }
    let what = format!("{amount:.3e} {what}, and at most {most:.0e} are rendered");
    Err(TooLarge { key: key.into(), value: value.to_string(), what })
}

/// Checks a scene of which every number is in its range.
pub(super) fn check(path: &str, file: &SceneFile, psf: &Psf) -> Result<(), SceneError> {
    let all = || {
        pixels(file)?;
        motion(file, psf)?;
        lights(file, psf)
    };
    all().map_err(|TooLarge { key, value, what }| SceneError::Parse {
        path: path.to_owned(),
        message: format!("{key} = {value} is too much work for a frame: {what}; choose a smaller number"),
    })
}

fn pixels(file: &SceneFile) -> Result<(), TooLarge> {
    let factor = file.camera.binning.map_or(1.0, |table| table.binning().factor as f64);
    let (width, height) = (file.camera.width_px as f64, file.camera.height_px as f64);
    let (key, side) = if width >= height { ("camera.width_px", width) } else { ("camera.height_px", height) };
    limit(key, &side, width * height * factor * factor, MAX_PIXELS, "own pixels of the detector")
}

fn exposures(file: &SceneFile) -> impl Iterator<Item = (String, f64, Option<[f64; 3]>)> {
    let series = file.series.iter().map(|series| ("series".to_owned(), series.exposure_s, series.rate_deg_s));
    let frames = file.frames.iter().enumerate();
    series.chain(frames.map(|(index, frame)| (format!("frames[{index}]"), frame.exposure_s, frame.rate_deg_s)))
}

/// How far the camera turns while a row or the whole frame is exposed.
fn motion(file: &SceneFile, psf: &Psf) -> Result<(), TooLarge> {
    let factor = file.camera.binning.map_or(1.0, |table| table.binning().factor as f64);
    let f_px = factor * file.camera.focal_length_px;
    let rows_s = file.camera.line_time_us.unwrap_or_default() * 1e-6 * file.camera.height_px as f64;
    for (key, exposure_s, rate_deg_s) in exposures(file) {
        let [x, y, z] = rate_deg_s.unwrap_or_default();
        let rate_deg_s = (x * x + y * y + z * z).sqrt();
        let turn_deg = rate_deg_s * (exposure_s + rows_s);
        let key = format!("{key}.rate_deg_s");
        limit(key.clone(), &rate_deg_s, turn_deg, LARGEST_TURN_DEG, "degrees by which the camera turns")?;
        limit(key, &rate_deg_s, turn_deg * DEG_RAD * f_px, LONGEST_TRAIL_PX, "px of a star's way")?;
    }
    let Some(JitterTable { sigma_arcsec, lines, bands }) = &file.jitter else { return Ok(()) };
    let most_blur_px = match psf.kind {
        PsfKind::Gaussian | PsfKind::Elliptic => WIDEST_BLUR_PX,
        PsfKind::Tables(_) | PsfKind::Sampled(_) => WIDEST_BLUR_PX.min(WIDEST_BLUR_WIDTHS * psf.smooth_px),
    };
    let of_lines = lines.iter().enumerate().map(|(index, line)| (format!("jitter.lines[{index}].amplitude_arcsec"), line.amplitude_arcsec));
    let of_bands = bands.iter().enumerate().map(|(index, band)| (format!("jitter.bands[{index}].sigma_arcsec"), band.sigma_arcsec));
    let mut sum = 0.0;
    for (key, angles) in [("jitter.sigma_arcsec".to_owned(), *sigma_arcsec)].into_iter().chain(of_lines).chain(of_bands) {
        let largest = angles.into_iter().fold(0.0, f64::max);
        sum += (largest * ARCSEC_RAD * f_px).powi(2);
        limit(key, &largest, sum.sqrt(), most_blur_px, "px of trembling")?;
    }
    Ok(())
}

/// What shines or leaves charge and is no star.
fn lights(file: &SceneFile, psf: &Psf) -> Result<(), TooLarge> {
    let factor = file.camera.binning.map_or(1.0, |table| table.binning().factor as f64);
    let longest_s = exposures(file).map(|(_, exposure_s, _)| exposure_s).fold(0.0, f64::max);
    if let Some(rays) = &file.cosmic_rays {
        let count = rays.expected_per_s * longest_s;
        limit("cosmic_rays.expected_per_s", &rays.expected_per_s, count, MAX_PARTICLES, "particles")?;
        // The mean of tan θ over the directions from which they come is π/2.
        let track_px = 1.6 * rays.thickness_um / rays.pitch_um;
        let points = count * (track_px / rays.diffusion_px).max(1.0);
        let (key, value) = if track_px > 100.0 {
            ("cosmic_rays.thickness_um", rays.thickness_um)
        } else {
            ("cosmic_rays.expected_per_s", rays.expected_per_s)
        };
        limit(key, &value, points, MAX_POINTS, "points of light along their tracks")?;
    }
    let diagonal_px = (file.camera.width_px as f64).hypot(file.camera.height_px as f64);
    let (mut trails, mut points) = (0.0, 0.0);
    for (index, streak) in file.streaks.iter().enumerate() {
        let (key, count, length_px) = match (streak.start_px, streak.end_px) {
            (Some([x, y]), Some([to_x, to_y])) => ("end_px", 1.0, (to_x - x).hypot(to_y - y)),
            _ => ("expected_per_frame", streak.expected_per_frame.unwrap_or_default(), diagonal_px),
        };
        let key = format!("streaks[{index}].{key}");
        let value = if key.ends_with("end_px") { format!("{:?}", streak.end_px.unwrap_or_default()) } else { count.to_string() };
        trails += count;
        points += count * 1.15 * factor * length_px / psf.smooth_px;
        limit(key.clone(), &value, trails, MAX_TRAILS, "trails")?;
        limit(key, &value, points, MAX_POINTS, "points of light along the trails")?;
    }
    Ok(())
}

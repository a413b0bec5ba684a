//! Zero points that scatter over all frames, though none of them stands out: exposures that are not as declared, or air that is not steady.
//!
//! What goes smoothly with the number of the frame (a lens that dews) is taken off as a parabola, and what goes with the air mass as a line. A scatter
//! of stars and sky together is one of the exposures, however small: nothing else does that. One of the stars alone has to be more than that of a clear
//! night, or of a shutter.

use super::counted::{Counted, MAX_SURPRISE};
use super::frame_levels::{Level, Steady};
use crate::diagnose::causes::{CLOUDS, EXPOSURE_TIME, EXTINCTION, ZERO_POINT};
use crate::diagnose::channels::Channel;
use crate::effects::MAGNITUDES;
use crate::statistics::significance::neg_ln_chi2_sf;

/// Fewer frames tell no scatter beside a parabola.
const MIN_FRAMES: usize = 8;
/// Coefficients of the parabola.
pub(super) const PARABOLA: usize = 3;
/// Air masses that differ by less are the same.
const MIN_AIRMASS: f64 = 0.01;
/// The scatter of a shutter, and the least of one that is told, magnitudes.
const SHUTTER_MAG: f64 = 0.005;
const MIN_SHUTTER_MAG: f64 = 0.01;
/// A scatter that is told is so many times that of a clear night.
const TIMES_CLEAR: f64 = 2.0;
/// The sky does as the stars where their difference scatters by less than this share of what the stars do, and has none of it where the sky does.
const SAME_SHARE: f64 = 0.5;

/// A scatter beyond that of the errors.
struct Scatter {
    /// Root of the mean square, magnitudes, errors taken off, and its standard error.
    rms_mag: [f64; 2],
    /// −ln of the probability by chance.
    surprise: f64,
}

/// What the scatter of the zero points shows; nothing where it is ordinary.
pub(super) fn scattered(levels: &[Level], steady: Steady) -> Option<Counted> {
    if levels.len() < MIN_FRAMES {
        return None;
    }
    let airmass: Option<Vec<f64>> = levels.iter().map(|level| level.airmass).collect();
    let smooth = smooth(levels.len(), airmass.as_deref());
    let stars = beside(&smooth, &levels.iter().map(|level| level.stars).collect::<Vec<_>>())?;
    let errors: Vec<f64> = levels.iter().map(|level| level.sigma).collect();
    let sky: Option<Vec<f64>> = levels.iter().map(|level| level.sky).collect();
    let sky = sky.and_then(|sky| beside(&smooth, &sky));
    let rms = |values: &[f64]| (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt();
    let apart = sky.as_ref().map(|sky| sky.iter().zip(&stars).map(|(sky, star)| sky - star).collect::<Vec<_>>());
    let is_exposure = apart.is_some_and(|apart| rms(&apart) < SAME_SHARE * rms(&stars));
    let is_star_alone = sky.is_some_and(|sky| rms(&sky) < SAME_SHARE * rms(&stars));
    let (id, ordinary_mag, least_mag) = match (is_exposure, steady.has_clouds) {
        (true, _) => (EXPOSURE_TIME, SHUTTER_MAG, MIN_SHUTTER_MAG),
        (false, true) => (CLOUDS, steady.scatter_mag, TIMES_CLEAR * steady.scatter_mag),
        (false, false) if is_star_alone => (ZERO_POINT, steady.scatter_mag, TIMES_CLEAR * steady.scatter_mag),
        (false, false) => (EXPOSURE_TIME, steady.scatter_mag, TIMES_CLEAR * steady.scatter_mag),
    };
    let Scatter { rms_mag: [rms_mag, error_mag], surprise } =
        scatter(&stars, &errors, ordinary_mag, smooth.ncols()).filter(|own| own.rms_mag[0] > least_mag)?;
    let mut alike: Vec<&'static str> = match (id, is_exposure, is_star_alone) {
        (CLOUDS, _, false) => vec![EXPOSURE_TIME, ZERO_POINT],
        (CLOUDS, ..) | (EXPOSURE_TIME, false, _) => vec![ZERO_POINT],
        _ => Vec::new(),
    };
    if id == CLOUDS && airmass.is_none() {
        alike.push(EXTINCTION);
    }
    let (parameter, what) = match id {
        EXPOSURE_TIME => {
            (("relative_scatter", rms_mag / MAGNITUDES, error_mag / MAGNITUDES, ""), "their exposures are not all as declared")
        }
        CLOUDS => (("scatter_mag", rms_mag, error_mag, "mag"), "the air is not as steady as that of a clear night"),
        _ => (("scatter_mag", rms_mag, error_mag, "mag"), "and the sky does not"),
    };
    let sentence = format!("The light of the stars scatters from frame to frame by {rms_mag:.3} mag (rms), in all frames: {what}.");
    Some(Counted::of_stars(id, Channel::Flux, vec![parameter], surprise, "frame", sentence).or(&alike))
}

/// What is smooth: a parabola in the number of the frame, and the air mass where it is known and differs.
pub(super) fn smooth(frames: usize, airmass: Option<&[f64]>) -> nalgebra::DMatrix<f64> {
    let at = |k: usize| 2.0 * k as f64 / (frames - 1) as f64 - 1.0;
    let powers = |at: f64| [1.0, at, at * at];
    let differs = |own: &&[f64]| own.iter().any(|other| (other - own[0]).abs() > MIN_AIRMASS);
    let airmass = airmass.filter(differs);
    nalgebra::DMatrix::from_fn(frames, PARABOLA + usize::from(airmass.is_some()), |row, column| match airmass {
        Some(airmass) if column == PARABOLA => airmass[row] - 1.0,
        _ => powers(at(row))[column],
    })
}

/// Deviations from what is smooth; nothing where there are too few.
pub(super) fn beside(smooth: &nalgebra::DMatrix<f64>, values: &[f64]) -> Option<Vec<f64>> {
    let right = nalgebra::DVector::from_column_slice(values);
    let solved = smooth.clone().svd(true, true).solve(&right, 1e-12).ok()?;
    Some((right - smooth * solved).iter().copied().collect())
}

/// The scatter of the frames; nothing where it is no more than that of the errors. Whether there is one is asked without the frame that is farthest off,
/// for one frame is another question; its size is that of all, since without the farthest it is too small.
fn scatter(deviations: &[f64], errors: &[f64], ordinary_mag: f64, fitted: usize) -> Option<Scatter> {
    let farthest = (0..deviations.len()).max_by(|a, b| deviations[*a].abs().total_cmp(&deviations[*b].abs()))?;
    let of = |which: &dyn Fn(usize) -> bool| -> Vec<[f64; 2]> {
        deviations.iter().zip(errors).enumerate().filter(|(k, _)| which(*k)).map(|(_, (off, error))| [off * off, error * error]).collect()
    };
    let (all, others) = (of(&|_| true), of(&|k| k != farthest));
    let sum = |own: &[[f64; 2]], which: usize| own.iter().map(|squares| squares[which]).sum::<f64>();
    let degrees = (others.len() - fitted) as f64;
    let error2 = sum(&all, 1) / all.len() as f64;
    // Errors that are stated too small are no scatter.
    if sum(&others, 0) / degrees < 2.0 * error2 {
        return None;
    }
    let chi2: f64 = others.iter().map(|[off2, error2]| off2 / (error2 + ordinary_mag * ordinary_mag)).sum();
    let square = sum(&all, 0) / (degrees + 1.0);
    let rms_mag = (square - error2).max(0.0).sqrt();
    let error_mag = square / rms_mag / (2.0 * (degrees + 1.0)).sqrt();
    Some(Scatter { rms_mag: [rms_mag, error_mag], surprise: neg_ln_chi2_sf(degrees, chi2).min(MAX_SURPRISE) })
}

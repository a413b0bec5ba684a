//! A zenith that the recording does not tell: those that are possible, and frames under one that is supposed.

use nalgebra::Vector3;

use super::star_images::StarImages;
use crate::calibrate::BundleSolution;
use crate::effects::Observation;
use crate::identify::ControlPoints;

/// Directions of an unknown zenith that are tried.
const ZENITHS: usize = 60;
/// Stars are seen down to this altitude, radians, when a zenith is looked for.
const LOWEST_RAD: f64 = 0.09;

/// Zeniths under which every star image is above the horizon, evenly spread; in axes fixed to the Earth where all times are known.
pub(super) fn unknown_zeniths(stars: &StarImages, points: &ControlPoints) -> Result<Vec<[f64; 3]>, String> {
    let timed = stars.frames.iter().filter(|(_, observation)| observation.earth_from_icrs.is_some()).count();
    if timed > 0 && timed < stars.frames.len() {
        return Err("the site is not known, and the time of some frames only".to_owned());
    }
    let in_earth = timed > 0;
    let turned = |direction: [f64; 3], observation: &Observation| match observation.earth_from_icrs.filter(|_| in_earth) {
        Some(rows) => std::array::from_fn(|k| rows[k].iter().zip(direction).map(|(a, b)| a * b).sum()),
        None => direction,
    };
    let directions: Vec<Vector3<f64>> = stars
        .images
        .iter()
        .zip(&stars.place)
        .map(|(image, place)| Vector3::from(turned(points.points[image.point].direction.xyz, &stars.frames[*place].1)))
        .collect();
    // A spiral over the whole sphere, thinned by what must be above the horizon.
    let count = 12 * ZENITHS;
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let all = (0..count).map(|k| {
        let z = 1.0 - 2.0 * (k as f64 + 0.5) / count as f64;
        let (r, angle) = ((1.0 - z * z).sqrt(), golden * k as f64);
        [r * angle.cos(), r * angle.sin(), z]
    });
    let least = LOWEST_RAD.sin();
    let possible: Vec<[f64; 3]> = all.filter(|zenith| directions.iter().all(|star| star.dot(&Vector3::from(*zenith)) > least)).collect();
    if possible.is_empty() {
        return Err("neither site nor time is known, and no one horizon has all frames above it".to_owned());
    }
    let every = possible.len().div_ceil(ZENITHS);
    Ok(possible.into_iter().step_by(every).collect())
}

/// A solution with a zenith supposed, and each frame's turned about the pole from there.
pub(super) fn supposed(joint: &BundleSolution, zenith: [f64; 3], turns_rad: &[f64]) -> BundleSolution {
    joint.with_frames(|place, observation| {
        with_zenith(observation, turns_rad.get(place).map_or(zenith, |turn_rad| turned(zenith, *turn_rad)))
    })
}

/// What is known of a frame with the zenith supposed.
pub(super) fn with_zenith(observation: &Observation, zenith: [f64; 3]) -> Observation {
    let icrs = match observation.earth_from_icrs {
        Some(rows) => std::array::from_fn(|k| (0..3).map(|row| rows[row][k] * zenith[row]).sum()),
        None => zenith,
    };
    Observation { zenith: Some(icrs), zenith_is_guessed: true, ..*observation }
}

/// A direction turned about the pole of the ICRS to the east.
pub(super) fn turned([x, y, z]: [f64; 3], angle_rad: f64) -> [f64; 3] {
    let (sin, cos) = angle_rad.sin_cos();
    [cos * x - sin * y, sin * x + cos * y, z]
}

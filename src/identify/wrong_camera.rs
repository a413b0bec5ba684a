//! Misidentification through a wrong camera: each star image gets the catalogue star nearest to where that camera sees it.

use std::f64::consts::{PI, TAU};

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use rand::seq::SliceRandom;
use rand::{Rng, RngExt};

use super::{ControlPoint, ControlPoints};
use crate::catalog::Catalog;
use crate::coordinates::{Attitude, Direction, Icrs};

/// The most that the wrong camera's focal length is off, as a share of it.
pub(super) const MAX_SCALE: f64 = 0.5;
/// The most that it points elsewhere, as a share of the angle from the middle of the frame to its farthest star.
const MAX_SHIFT: f64 = 0.25;
/// Halvings of the camera's error: to 1e-8 of the most.
const HALVINGS: usize = 26;

/// A star image with another star's name: index of the point, index into the catalogue.
pub(super) type Misnamed = (usize, usize);

/// Wrong names for `wanted` points, in order; fewer where even the worst camera misleads no more of them.
///
/// Directions are scaled about the middle of each frame and then turned, by the same part of the most in every frame: the least at which
/// enough are wrong. Of the few too many `rng` says which stay right.
pub(super) fn wrong_names(points: &ControlPoints, catalog: &Catalog, wanted: usize, rng: &mut impl Rng) -> Vec<Misnamed> {
    if wanted == 0 {
        return Vec::new();
    }
    let sign = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
    let towards_rad = rng.random_range(0.0..TAU);
    let frames = frames(points, catalog);
    let misnamed =
        |part: f64| -> Vec<Misnamed> { frames.iter().flat_map(|frame| frame.misnamed(sign * part, part, towards_rad)).collect() };
    let (mut enough, mut too_little) = (1.0, 0.0);
    let mut wrong = misnamed(enough);
    if wrong.len() > wanted {
        for _ in 0..HALVINGS {
            let middle = f64::midpoint(enough, too_little);
            let fewer = misnamed(middle);
            if fewer.len() >= wanted {
                (enough, wrong) = (middle, fewer);
            } else {
                too_little = middle;
            }
        }
    }
    wrong.shuffle(rng);
    wrong.truncate(wanted);
    wrong.sort_unstable();
    wrong
}

/// A star image of a frame.
struct StarView {
    /// Index of the point.
    point: usize,
    hip: u32,
    /// Where the catalogue has its star, camera axes.
    at: Vector3<f64>,
}

/// One frame as a matcher sees it.
struct Frame {
    sights: Vec<StarView>,
    /// The catalogue's stars that may be named: their directions in camera axes, their index and their number.
    stars: Vec<(Vector3<f64>, usize, u32)>,
    /// From the middle to the farthest star image, rad.
    radius_rad: f64,
}

impl Frame {
    /// The names that are wrong if directions are scaled by 1 + `scale`·[`MAX_SCALE`] about the middle and turned by `shift` of the most.
    fn misnamed(&self, scale: f64, shift: f64, towards_rad: f64) -> Vec<Misnamed> {
        let axis = Vector3::new(towards_rad.cos(), towards_rad.sin(), 0.0);
        let turn = Rotation3::new(axis * (shift * MAX_SHIFT * self.radius_rad));
        let wrong = |sight: &StarView| {
            let seen = turn * scaled(&sight.at, 1.0 + scale * MAX_SCALE);
            let others = self.stars.iter().filter(|(_, _, hip)| *hip != sight.hip);
            let (nearness, nearest) =
                others.map(|(at, star, _)| (at.dot(&seen), *star)).max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))?;
            (nearness > sight.at.dot(&seen)).then_some((sight.point, nearest))
        };
        self.sights.iter().filter_map(wrong).collect()
    }
}

/// The direction at `factor` times the angle from the boresight, at the same azimuth around it.
fn scaled(at: &Vector3<f64>, factor: f64) -> Vector3<f64> {
    let across = at.x.hypot(at.y);
    let angle_rad = across.atan2(at.z) * factor;
    if across == 0.0 {
        return *at;
    }
    Vector3::new(at.x / across * angle_rad.sin(), at.y / across * angle_rad.sin(), angle_rad.cos())
}

/// The frames that have points, with the stars bright enough to be in them: no fainter than the faintest of their points.
fn frames(points: &ControlPoints, catalog: &Catalog) -> Vec<Frame> {
    let mut numbers: Vec<usize> = points.points.iter().map(|point| point.frame).collect();
    numbers.sort_unstable();
    numbers.dedup();
    let mut frames = Vec::with_capacity(numbers.len());
    for number in numbers {
        let own = || points.points.iter().enumerate().filter(|(_, point)| point.frame == number);
        let attitude = points.attitudes.get(number).copied().flatten();
        let attitude = attitude.unwrap_or_else(|| towards_middle(own().map(|(_, point)| point)));
        let camera = |xyz: [f64; 3]| attitude.camera_from_icrs * Vector3::from(xyz);
        let sight = |(index, point): (usize, &ControlPoint)| {
            let place = catalog.by_hip(point.hip).map_or(point.direction.xyz, |star| star.direction.xyz);
            StarView { point: index, hip: point.hip, at: camera(place) }
        };
        let sights: Vec<StarView> = own().map(sight).collect();
        let radius_rad = sights.iter().map(|sight| sight.at.x.hypot(sight.at.y).atan2(sight.at.z)).fold(0.0, f64::max);
        let faintest = own().map(|(_, point)| point.magnitude).fold(f64::NEG_INFINITY, f64::max);
        // A name is no farther from where a star is seen than its own star is.
        let reach_rad = (radius_rad * (1.0 + 2.0 * (MAX_SCALE + MAX_SHIFT))).min(PI);
        let boresight = Direction::<Icrs>::from_unit((attitude.camera_from_icrs.inverse() * Vector3::z()).into());
        let star = |index: usize| (camera(catalog.stars[index].direction.xyz), index, catalog.stars[index].hip);
        let stars = catalog.stars_within(&boresight, reach_rad, faintest).into_iter().map(star).collect();
        frames.push(Frame { sights, stars, radius_rad });
    }
    frames
}

/// An attitude that looks at the middle of the stars, for a frame that has none.
fn towards_middle<'a>(points: impl Iterator<Item = &'a ControlPoint>) -> Attitude {
    let sum: Vector3<f64> = points.map(|point| Vector3::from(point.direction.xyz)).sum();
    let turn = UnitQuaternion::rotation_between(&sum, &Vector3::z());
    Attitude::new(turn.unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_scaled_about_the_boresight() {
        let at = Vector3::new(0.3_f64.sin() * 0.6, 0.3_f64.sin() * -0.8, 0.3_f64.cos());
        let expected = Vector3::new(0.36_f64.sin() * 0.6, 0.36_f64.sin() * -0.8, 0.36_f64.cos());
        assert!((scaled(&at, 1.2) - expected).norm() < 1e-15);
        assert_eq!(scaled(&Vector3::z(), 1.2), Vector3::z());
    }
}

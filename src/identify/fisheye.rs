//! Search in fisheye frames: where in the frame the pattern is looked up, and how a match is followed outwards.

use nalgebra::Vector3;

use super::fit::{AT_REST_PX, MIN_FOR_KAPPA, fit};
use super::index::Index;
use super::overlay::Overlay;
use super::pose::{Pair, Points, Pose};
use super::projection::Projection;
use crate::units::DEG_RAD;

/// A fisheye is looked for among the points around the middle, as far out as half of all points are and a little more: there the laws of
/// lenses differ little, and lamps, trees and writing are further out.
const INNER: f64 = 1.1;
/// The angles from the boresight at which the outermost of these are searched, rad: least, most.
pub(super) const REACH_RAD: [f64; 2] = [30.0 * DEG_RAD, 75.0 * DEG_RAD];
/// Half the step in ln f.
pub(super) const HALF_STEP: f64 = 0.01;
/// Fewer points are not looked at so: chance would match as many.
const MIN_POINTS: usize = 8;
/// By how much more of the frame is taken from fit to fit.
const WIDEN: f64 = 1.12;
/// Within this part of the frame's size a point belongs to a star then.
const BELONGS: f64 = 0.006;
/// By this factor in their misfit laws may differ that fit alike.
const ALIKE: f64 = 1.1;
/// So many of the brightest points decide between the laws of lenses.
const DECIDE: usize = 200;

/// The points around the middle of the frame among which a fisheye is looked for; `None`: too few.
pub(super) fn inner(points: &Points) -> Option<Points> {
    let mut radii: Vec<f64> = points.centred_px.iter().map(|[x, y]| x.hypot(*y)).collect();
    radii.sort_unstable_by(f64::total_cmp);
    let mut inner = within(points, INNER * radii.get(radii.len() / 2)?);
    // Lengths within which places agree are measured in it: lenses that follow no law need them wider than others.
    inner.size_px = 2.0 * inner.area_px2().sqrt();
    (inner.centred_px.len() >= MIN_POINTS).then_some(inner)
}

/// The points within a distance from the middle of the frame.
fn within(points: &Points, reach_px: f64) -> Points {
    let inside = |point: &usize| {
        let [x, y] = points.centred_px[*point];
        x.hypot(y) <= reach_px
    };
    let inside: Vec<usize> = (0..points.centred_px.len()).filter(inside).collect();
    Points { reach_px: reach_px.min(points.corner_px), ..points.only(&inside) }
}

/// Follows a pose that is right around the middle to the edges of the frame, by each law of lenses, and returns that which fits best.
pub(super) fn widen(found: &Pose, from_px: f64, points: &Points, index: &Index, vectors: &[Vector3<f64>]) -> Pose {
    let by_law = |projection: Projection| {
        let mut pose = Pose { projection, ..*found };
        let mut reach_px = from_px;
        loop {
            let part = within(points, reach_px);
            // Twice where more is known of the lens with every turn.
            for _ in 0..2 {
                let pairs = pairs(&pose, &part, index, vectors);
                pose = fit(&pose, &part, vectors, &pairs, pairs.len() >= MIN_FOR_KAPPA, AT_REST_PX).unwrap_or(pose);
            }
            if reach_px >= points.corner_px {
                return pose;
            }
            reach_px *= WIDEN;
        }
    };
    let misfit = |pose: &Pose| {
        let limit_px = BELONGS * points.size_px;
        let mut left = vec![limit_px * limit_px; points.centred_px.len().min(DECIDE)];
        for (point, star) in pairs(pose, points, index, vectors) {
            if let (Some(left), Some([x, y])) = (left.get_mut(point), pose.project(&vectors[star as usize], points.corner_px)) {
                let [px, py] = points.centred_px[point];
                *left = left.min((px * pose.parity - x).powi(2) + (py - y).powi(2));
            }
        }
        left.iter().sum::<f64>()
    };
    let poses = Projection::FISHEYES.map(by_law);
    let misfits = poses.each_ref().map(misfit);
    // Laws that fit alike differ by what the distortion has to make up for.
    let limit_px = BELONGS * points.size_px;
    let alike = ALIKE * misfits.iter().copied().fold(f64::INFINITY, f64::min) + limit_px * limit_px;
    let plainer =
        |best: Pose, (pose, misfit): (&Pose, f64)| if misfit <= alike && pose.kappa.abs() < best.kappa.abs() { *pose } else { best };
    let none = Pose { kappa: f64::INFINITY, ..poses[0] };
    poses.iter().zip(misfits).fold(none, plainer)
}

/// How many points around the middle of the frame, where it was found, belong to stars as a pose has them.
pub(super) fn matched(found: &Pose, reach_px: f64, points: &Points, index: &Index, vectors: &[Vector3<f64>]) -> usize {
    pairs(found, &within(points, reach_px), index, vectors).len()
}

/// The stars laid over the points, as many as there are points, and those that belong together.
fn pairs(pose: &Pose, points: &Points, index: &Index, vectors: &[Vector3<f64>]) -> Vec<Pair> {
    let count = points.centred_px.len();
    let boresight = Vector3::from(pose.rotation.row(2).transpose());
    let near = index.brightest_within(&boresight, pose.reach_rad(points, 1.15), 3 * count);
    let overlay = Overlay::new(pose, points, vectors, &near, count);
    overlay.pairs(pose, points, count, BELONGS * points.size_px)
}

//! Candidates checked many at a time, to single precision: nearly all are dismissed so, and the rest are asked again with all digits.
#![allow(clippy::inline_always, reason = "inlined into what is compiled for several processors")]

use super::candidate::{Context, Trial, View};

/// Candidates that are checked together.
pub(super) const BLOCK: usize = 16;

type Lanes = [f32; BLOCK];

/// What poses are made of, side by side.
struct Corners {
    /// The catalogue's stars: by corner, then axis.
    stars: [[Lanes; 3]; 3],
    /// The detections, undistorted, px.
    points_px: [[Lanes; 2]; 3],
    /// The focal length of the step, px, one over the chord of the longest side at it, and one over d ln longest / d ln f.
    focal_px: Lanes,
    per_longest: Lanes,
    per_sensitivity: Lanes,
}

/// Views side by side: from a direction to x·z, y·z and z, by row, then column.
type Views = [[Lanes; 3]; 3];

type Vector = [f32; 3];

/// Which of the candidates, at most [`BLOCK`], check out: a bit for each. For tangent planes; see [`Trial::checks_out`].
pub(super) fn check_out(candidates: &[(&Context<'_>, &Trial, [u32; 3])]) -> u32 {
    let none = [0.0; BLOCK];
    let mut corners =
        Corners { stars: [[none; 3]; 3], points_px: [[none; 2]; 3], focal_px: none, per_longest: none, per_sensitivity: none };
    for (lane, (context, trial, triangle)) in candidates.iter().enumerate().take(BLOCK) {
        for (lanes, star) in corners.stars.iter_mut().zip(triangle) {
            for (lanes, component) in lanes.iter_mut().zip(context.level.direction_f32(*star)) {
                lanes[lane] = component;
            }
        }
        for (lanes, point) in corners.points_px.iter_mut().zip(trial.own_px) {
            (lanes[0][lane], lanes[1][lane]) = (point[0], point[1]);
        }
        corners.focal_px[lane] = context.focal_px as f32;
        corners.per_longest[lane] = (1.0 / trial.longest) as f32;
        corners.per_sensitivity[lane] = (1.0 / trial.sensitivity) as f32;
    }
    passing(&corners, candidates)
}

#[multiversion::multiversion(targets("x86_64+avx2"))]
fn passing(corners: &Corners, candidates: &[(&Context<'_>, &Trial, [u32; 3])]) -> u32 {
    let none = [0.0; BLOCK];
    let mut views: Views = [[none; 3]; 3];
    // Of candidates alone in their block the other lanes are worked out for nothing, which costs no more.
    for lane in 0..BLOCK {
        view(corners, lane, &mut views);
    }
    let mut passing = 0;
    for (lane, (context, trial, triangle)) in candidates.iter().enumerate().take(BLOCK) {
        let row = |row: usize| [views[row][0][lane], views[row][1][lane], views[row][2][lane]];
        let view = View([row(0), row(1), row(2)]);
        passing |= u32::from(view.checks_out(context, trial, *triangle)) << lane;
    }
    passing
}

#[inline(always)]
fn dot(a: Vector, b: Vector) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn less(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
fn times(a: Vector, factor: f32) -> Vector {
    [a[0] * factor, a[1] * factor, a[2] * factor]
}

#[inline(always)]
fn unit(a: Vector) -> Vector {
    times(a, 1.0 / dot(a, a).sqrt())
}

/// The axes of three directions, see [`Trial::pose`].
#[inline(always)]
fn axes([a, b, c]: [Vector; 3]) -> [Vector; 3] {
    let mean = unit([a[0] + b[0] + c[0], a[1] + b[1] + c[1], a[2] + b[2] + c[2]]);
    let side = less(c, b);
    let along = unit(less(side, times(mean, dot(mean, side))));
    let across =
        [mean[1] * along[2] - mean[2] * along[1], mean[2] * along[0] - mean[0] * along[2], mean[0] * along[1] - mean[1] * along[0]];
    [mean, along, across]
}

/// The view that lays the detections of one lane over its catalogue triangle, see [`Trial::pose`].
#[inline(always)]
fn view(corners: &Corners, lane: usize, views: &mut Views) {
    let star = |corner: usize| [corners.stars[corner][0][lane], corners.stars[corner][1][lane], corners.stars[corner][2][lane]];
    let sky = [star(0), star(1), star(2)];
    let side = less(sky[1], sky[2]);
    let ratio = dot(side, side).sqrt() * corners.per_longest[lane];
    let t = (ratio - 1.0) / (ratio + 1.0);
    let log = 2.0 * t * (1.0 + t * t * (1.0 / 3.0 + t * t * 0.2)) * corners.per_sensitivity[lane];
    let focal_px = corners.focal_px[lane] * (1.0 + log * (1.0 + log * (0.5 + log * (1.0 / 6.0))));
    let ray = |corner: usize| unit([corners.points_px[corner][0][lane], corners.points_px[corner][1][lane], focal_px]);
    let image = [ray(0), ray(1), ray(2)];
    let (in_image, on_sky) = (axes(image), axes(sky));
    let hand = dot(in_image[2], less(image[0], image[1])) * dot(on_sky[2], less(sky[0], sky[1]));
    let parity = if hand < 0.0 { -1.0 } else { 1.0 };
    // A focal length that is none has no view: what is no number is nowhere.
    let focal_px = if focal_px > 0.0 { focal_px } else { f32::NAN };
    let [mean, along, across] = in_image;
    let (mean, along) = ([parity * mean[0], mean[1], mean[2]], [parity * along[0], along[1], along[2]]);
    let across = [across[0], parity * across[1], parity * across[2]];
    for column in 0..3 {
        let of = |row: usize| mean[row] * on_sky[0][column] + along[row] * on_sky[1][column] + across[row] * on_sky[2][column];
        views[0][column][lane] = focal_px * parity * of(0);
        views[1][column][lane] = focal_px * of(1);
        views[2][column][lane] = of(2);
    }
}

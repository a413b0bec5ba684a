//! The search: triangles of detections against triangles of the catalogue, over focal lengths and distortions.

use std::time::{Duration, Instant};

use nalgebra::{Matrix3, Vector3};

use super::index::{Index, Level, MAX_CHECK_RADIUS, Shape, Triangle};
use super::refine::{self, Points, Pose, Supported};
use super::{IdentifyOptions, odds};

/// Radius within which a further detection must find a star, over the frame's size.
const CHECK_RADIUS: f64 = 0.008;
/// Further detections that are looked at in the check of a candidate.
const CHECKED: usize = 24;

/// One pass over the focal lengths.
#[derive(Clone, Copy, Debug)]
struct Stage {
    /// Triangles are formed of the brightest so many detections.
    detections: usize,
    /// Tolerance of the ratios of the sides.
    ratio_tolerance: f64,
    /// Relative displacement at the corner that is taken away first.
    kappa: f64,
    /// Steps up to a sparser level.
    coarser: usize,
}

const fn stage(detections: usize, ratio_tolerance: f64, kappa: f64, coarser: usize) -> Stage {
    Stage { detections, ratio_tolerance, kappa, coarser }
}

/// From the likely and cheap to the rest: more detections for false stars, distortions of either sign, a wider tolerance for
/// noise, and sparser stars for images that show only few.
const STAGES: [Stage; 14] = [
    stage(10, 0.005, 0.0, 0),
    stage(16, 0.005, 0.0, 0),
    stage(10, 0.010, 0.0, 2),
    stage(14, 0.007, -0.04, 0),
    stage(24, 0.005, 0.0, 0),
    stage(14, 0.007, -0.09, 0),
    stage(14, 0.007, 0.04, 0),
    stage(14, 0.015, 0.0, 0),
    stage(32, 0.005, 0.0, 0),
    stage(20, 0.007, -0.16, 0),
    stage(20, 0.007, -0.04, 0),
    stage(20, 0.007, -0.24, 0),
    stage(20, 0.015, 0.0, 1),
    stage(48, 0.005, 0.0, 0),
];

/// Why a search ended without an answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Failure {
    /// Everything was tried; the hypotheses and the best support found.
    Exhausted { hypotheses: u64, best_probability: f64 },
    /// The time limit came first.
    TimeLimit { limit: Duration },
}

/// An accepted hypothesis.
#[derive(Clone, Debug)]
pub(super) struct Found {
    pub(super) pose: Pose,
    pub(super) false_match_probability: f64,
}

/// The state of a search over one image.
pub(super) struct Search<'a> {
    points: &'a Points,
    index: &'a Index,
    /// Directions of the catalogue stars as they appear in this frame.
    apparent: &'a [Vector3<f64>],
    options: &'a IdentifyOptions,
    deadline: Option<(Instant, Duration)>,
    hypotheses: u64,
    best_probability: f64,
    found: Option<Found>,
    late: bool,
}

impl<'a> Search<'a> {
    pub(super) fn new(points: &'a Points, index: &'a Index, apparent: &'a [Vector3<f64>], options: &'a IdentifyOptions) -> Self {
        let deadline = options.time_limit.and_then(|limit| Some((Instant::now().checked_add(limit)?, limit)));
        Self { points, index, apparent, options, deadline, hypotheses: 0, best_probability: 1.0, found: None, late: false }
    }

    /// Runs all stages over each list of focal lengths in turn until a hypothesis is accepted.
    pub(super) fn run(mut self) -> Result<Found, Failure> {
        for (pass, focal_lengths) in self.focal_lengths().into_iter().enumerate() {
            // What the first pass (around the nominal value) tried is small against the second and is tried again.
            let stages = if pass == 0 && self.options.nominal_focal_length_px.is_some() { &STAGES[..] } else { &STAGES[..STAGES.len() - 1] };
            for (number, stage) in stages.iter().enumerate() {
                // Triangles of detections that an earlier stage with the same settings has tried are not tried again.
                let done = STAGES[..number]
                    .iter()
                    .filter(|s| s.kappa == stage.kappa && s.coarser == stage.coarser && s.ratio_tolerance >= stage.ratio_tolerance)
                    .map(|s| s.detections)
                    .max()
                    .unwrap_or(0);
                for &(focal_px, log_tolerance) in &focal_lengths {
                    if !self.try_focal_length(stage, done, focal_px, log_tolerance) {
                        if let Some(found) = self.found {
                            return Ok(found);
                        }
                        let limit = self.deadline.map_or(Duration::ZERO, |(_, limit)| limit);
                        return Err(Failure::TimeLimit { limit });
                    }
                }
            }
        }
        Err(Failure::Exhausted { hypotheses: self.hypotheses, best_probability: self.best_probability })
    }

    /// The focal lengths to try, each with its half step in ln f: first those around the nominal one from the middle outwards,
    /// then all, from wide fields (few triangles, quickly tried) to narrow ones.
    fn focal_lengths(&self) -> Vec<Vec<(f64, f64)>> {
        let mut passes = Vec::new();
        if let Some(nominal) = self.options.nominal_focal_length_px {
            let reach = (1.0 + self.options.focal_length_tolerance).ln();
            let half_step = self.half_step(nominal).min(reach.max(1e-6));
            let steps = (reach / (2.0 * half_step)).ceil() as i32;
            let mut pass = vec![(nominal, half_step)];
            for k in 1..=steps {
                let factor = (2.0 * half_step * f64::from(k)).exp();
                pass.push((nominal * factor, half_step));
                pass.push((nominal / factor, half_step));
            }
            passes.push(pass);
        }
        if self.options.nominal_focal_length_px.is_none() || self.options.search_beyond_tolerance {
            let [narrow, wide] = self.options.field_width_range_rad;
            let half_width = self.points.half_px[0];
            let (mut f, last) = (half_width / (wide / 2.0).tan(), half_width / (narrow / 2.0).tan());
            let mut pass = Vec::new();
            while f < last * 1.02 {
                let half_step = self.half_step(f);
                pass.push((f * half_step.exp(), half_step));
                f *= (2.0 * half_step).exp();
            }
            passes.push(pass);
        }
        passes
    }

    /// Half the step in ln f: 2 %, less in wide fields, where a wrong focal length changes the shape of triangles.
    fn half_step(&self, focal_px: f64) -> f64 {
        let t = self.points.corner_px / focal_px;
        0.02 / (1.0 + t * t)
    }

    /// Tries all triangles of a stage at one focal length. `false` = stop (found, or out of time).
    fn try_focal_length(&mut self, stage: &Stage, done: usize, focal_px: f64, half_step: f64) -> bool {
        let points = self.points;
        let count = points.centred_px.len().min(stage.detections);
        if count <= done {
            return true;
        }
        let width_rad = 2.0 * (points.size_px / (2.0 * focal_px)).atan();
        let index = self.index;
        let (_, level) = index.level_for(width_rad, stage.coarser);
        let ideal: Vec<[f64; 2]> = points.centred_px.iter().take(count.max(CHECKED + 3)).map(|p| undistort(*p, stage.kappa, points.corner_px)).collect();
        let rays = |f: f64| -> Vec<Vector3<f64>> { ideal[..count].iter().map(|&[x, y]| Vector3::new(x, y, f).normalize()).collect() };
        // The same at a focal length 1 % larger tells how the sides depend on it.
        let (at, above) = (rays(focal_px), rays(focal_px * 1.01));
        let mut sides = vec![0.0; count * count];
        for i in 0..count {
            for j in 0..count {
                sides[i * count + j] = (at[i] - at[j]).norm();
            }
        }
        let [least, most] = level.longest_range();
        for k in done.max(2)..count {
            if let Some((deadline, _)) = self.deadline
                && Instant::now() >= deadline
            {
                self.late = true;
                return false;
            }
            for j in 1..k {
                let jk = sides[j * count + k];
                if jk > most {
                    continue;
                }
                for i in 0..j {
                    let (ij, ik) = (sides[i * count + j], sides[i * count + k]);
                    let Some(shape) = Shape::new([jk, ik, ij]) else { continue };
                    if shape.longest < least || shape.longest > most {
                        continue;
                    }
                    let corners = shape.order.map(|corner| [i, j, k][corner]);
                    let longer = (above[corners[1]] - above[corners[2]]).norm();
                    let sensitivity = (longer / shape.longest).ln() / 0.01; // d ln side / d ln f, about −1
                    let trial = Trial { stage, level, ideal: &ideal, corners, longest: shape.longest, focal_px, sensitivity };
                    // Noise of a pixel or two in the longest side adds to the step.
                    let log_tolerance = half_step * sensitivity.abs() + 0.004;
                    if !level.look_up(&shape, log_tolerance, stage.ratio_tolerance, |triangle| self.try_candidate(&trial, triangle)) {
                        return false;
                    }
                }
            }
        }
        true
    }

    /// Tries one pair of triangles. `false` = accepted, stop.
    fn try_candidate(&mut self, trial: &Trial<'_>, triangle: &Triangle) -> bool {
        self.hypotheses += 1;
        let Some(pose) = trial.pose(triangle, &self.index.vectors) else { return true };
        if self.options.parity.is_some_and(|parity| f64::from(parity) != pose.parity) || !self.checks_out(trial, &pose) {
            return true;
        }
        let boresight = Vector3::from(pose.rotation.row(2).transpose());
        let radius = (self.points.corner_px * (1.0 - pose.kappa.min(0.0)) * 1.15 / pose.focal_px).atan();
        let near = self.index.brightest_within(&boresight, radius, 2 * self.points.centred_px.len().clamp(8, 100) + 100);
        let Some(Supported { pose, ln_probability }) = refine::refine(&pose, self.points, self.apparent, &near) else { return true };
        let probability = odds::over_all_tries(ln_probability, self.hypotheses as f64);
        self.best_probability = self.best_probability.min(probability);
        if probability < self.options.max_false_match_probability && self.within_range(pose.focal_px) {
            self.found = Some(Found { pose, false_match_probability: probability });
            return false;
        }
        true
    }

    fn within_range(&self, focal_px: f64) -> bool {
        let [narrow, wide] = self.options.field_width_range_rad;
        let width = 2.0 * (self.points.half_px[0] / focal_px).atan();
        let nominal = self.options.nominal_focal_length_px;
        (width > 0.9 * narrow && width < 1.1 * wide) || nominal.is_some_and(|f| (focal_px / f).ln().abs() < 1.5 * self.options.focal_length_tolerance)
    }

    /// Whether enough of the other bright detections find a star.
    fn checks_out(&self, trial: &Trial<'_>, pose: &Pose) -> bool {
        let others = trial.ideal.len().min(CHECKED + 3).saturating_sub(3);
        let needed = if others >= 8 { 2 } else { 1 };
        let radius = (CHECK_RADIUS * self.points.size_px / pose.focal_px).min(MAX_CHECK_RADIUS * trial.level.width_rad);
        let to_sky = pose.rotation.transpose();
        let (mut looked, mut hits) = (0, 0);
        for (number, &[x, y]) in trial.ideal.iter().enumerate() {
            if trial.corners.contains(&number) {
                continue;
            }
            let direction = to_sky * Vector3::new(x * pose.parity, y, pose.focal_px).normalize();
            looked += 1;
            hits += usize::from(trial.level.near.has_star_near(&self.index.vectors, &direction, radius * radius));
            if hits > needed {
                return true;
            }
            if (looked == 8 || looked == 12) && hits == 0 {
                return false;
            }
        }
        hits >= needed
    }
}

/// A triangle of detections at a focal length.
struct Trial<'a> {
    stage: &'a Stage,
    level: &'a Level,
    /// Undistorted points of the brightest detections.
    ideal: &'a [[f64; 2]],
    /// The triangle's detections, opposite the longest, middle, shortest side.
    corners: [usize; 3],
    longest: f64,
    focal_px: f64,
    sensitivity: f64,
}

impl Trial<'_> {
    /// The attitude, focal length and parity that lay the detections over the catalogue triangle.
    fn pose(&self, triangle: &Triangle, vectors: &[Vector3<f64>]) -> Option<Pose> {
        let sky = triangle.stars.map(|star| vectors[star as usize]);
        let longest = (sky[1] - sky[2]).norm();
        // The focal length at which the longest side has the catalogue's length.
        let focal_px = self.focal_px * ((longest / self.longest).ln() / self.sensitivity).exp();
        if !(focal_px.is_finite() && focal_px > 0.0) {
            return None;
        }
        let mut image = self.corners.map(|corner| {
            let [x, y] = self.ideal[corner];
            Vector3::new(x, y, focal_px).normalize()
        });
        let hand = |[a, b, c]: [Vector3<f64>; 3]| (b - a).cross(&(c - a)).dot(&a);
        let parity = if hand(sky) * hand(image) < 0.0 { -1.0 } else { 1.0 };
        for v in &mut image {
            v.x *= parity;
        }
        let rotation = axes(image) * axes(sky).transpose();
        Some(Pose { rotation, focal_px, kappa: self.stage.kappa, parity })
    }
}

/// Axes that belong to three directions: towards their mean, along the longest side, and across.
fn axes([a, b, c]: [Vector3<f64>; 3]) -> Matrix3<f64> {
    let mean = (a + b + c).normalize();
    let along = (c - b) - mean * mean.dot(&(c - b));
    let along = along.normalize();
    Matrix3::from_columns(&[mean, along, mean.cross(&along)])
}

/// Takes the distortion of a hypothesis away.
fn undistort([x, y]: [f64; 2], kappa: f64, corner_px: f64) -> [f64; 2] {
    let scale = 1.0 - kappa * (x * x + y * y) / (corner_px * corner_px);
    [x * scale, y * scale]
}

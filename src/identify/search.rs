//! The search: triangles of detections against triangles of the catalogue, over focal lengths and distortions.

use std::time::{Duration, Instant};

use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::index::{Index, Level, Shape, Triangle};
use super::refine::{self, Points, Pose, Supported};
use super::{IdentifyOptions, odds};

/// Detections that are looked at in the check of a candidate of the brightest.
const CHECKED: usize = 64;
/// A candidate must find so many stars that chance finds as many with less than this (ln).
const CHECK_LN_PROBABILITY: f64 = -3.0;
/// Triangles by chance are drawn from so many of the brightest detections, and checked against as many.
const DRAWN_FROM: usize = 200;

/// Hypotheses in one pass over the focal lengths after which the rest of it is given up: narrow fields full of false
/// detections would take for ever.
const MOST_HYPOTHESES: u64 = 2_000_000;

/// Which triangles of detections a stage tries.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Choice {
    /// All of the brightest so many detections.
    Brightest(usize),
    /// So many by chance, of all detections: where false ones are brighter than the stars, the brightest are no better than others.
    Drawn(usize),
}
use Choice::{Brightest, Drawn};

/// One pass over the focal lengths.
#[derive(Clone, Copy, Debug)]
struct Stage {
    choice: Choice,
    /// Tolerance of the ratios of the sides.
    ratio_tolerance: f64,
    /// Relative displacement at the corner that is taken away first.
    kappa: f64,
    /// Steps up to a level with sparser stars and larger triangles, or (negative) down to a denser one.
    coarser: i32,
    /// Too long for a search over all focal lengths.
    narrow_only: bool,
}

impl Stage {
    /// How many detections speak about a candidate.
    const fn judges(&self) -> usize {
        match self.choice {
            Brightest(_) => CHECKED,
            Drawn(_) => DRAWN_FROM,
        }
    }
}

const fn stage(choice: Choice, ratio_tolerance: f64, kappa: f64, coarser: i32) -> Stage {
    Stage { choice, ratio_tolerance, kappa, coarser, narrow_only: false }
}

const fn narrow_only(choice: Choice, ratio_tolerance: f64, kappa: f64, coarser: i32) -> Stage {
    Stage { choice, ratio_tolerance, kappa, coarser, narrow_only: true }
}

/// From the likely and cheap to the rest: more detections for false stars, distortions of either sign, a wider tolerance for
/// noise, and sparser stars for images that show only few.
const STAGES: [Stage; 20] = [
    stage(Brightest(10), 0.003, 0.0, 0),
    stage(Brightest(16), 0.003, 0.0, 0),
    stage(Drawn(250), 0.003, 0.0, 0),
    stage(Brightest(9), 0.008, 0.0, 2),
    stage(Brightest(13), 0.006, -0.04, 0),
    stage(Brightest(22), 0.003, 0.0, 0),
    stage(Brightest(13), 0.006, -0.09, 0),
    stage(Brightest(13), 0.006, 0.04, 0),
    stage(Brightest(11), 0.010, 0.0, 0),
    stage(Brightest(13), 0.006, -0.16, 0),
    stage(Brightest(13), 0.006, -0.24, 0),
    stage(Brightest(11), 0.008, 0.0, 1),
    stage(Brightest(12), 0.005, 0.0, -1),
    stage(Drawn(700), 0.003, 0.0, 0),
    narrow_only(Brightest(16), 0.012, 0.0, 0),
    narrow_only(Brightest(18), 0.006, -0.04, 0),
    narrow_only(Brightest(32), 0.003, 0.0, 0),
    narrow_only(Brightest(18), 0.006, -0.16, 0),
    narrow_only(Brightest(12), 0.010, 0.0, -2),
    narrow_only(Drawn(6000), 0.003, 0.0, 0),
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
}

impl<'a> Search<'a> {
    pub(super) fn new(points: &'a Points, index: &'a Index, apparent: &'a [Vector3<f64>], options: &'a IdentifyOptions) -> Self {
        let deadline = options.time_limit.and_then(|limit| Some((Instant::now().checked_add(limit)?, limit)));
        Self { points, index, apparent, options, deadline, hypotheses: 0, best_probability: 1.0, found: None }
    }

    /// Runs all stages over each list of focal lengths in turn until a hypothesis is accepted.
    pub(super) fn run(mut self) -> Result<Found, Failure> {
        for (focal_lengths, narrow) in self.focal_lengths() {
            let begun = self.hypotheses;
            for (number, stage) in STAGES.iter().enumerate().filter(|(_, stage)| narrow || !stage.narrow_only) {
                // Triangles of detections that an earlier stage with the same settings has tried are not tried again.
                let same = |s: &&Stage| s.kappa == stage.kappa && s.coarser == stage.coarser && s.ratio_tolerance >= stage.ratio_tolerance;
                let tried = |s: &Stage| if let Brightest(count) = s.choice { count } else { 0 };
                let done = STAGES[..number].iter().filter(same).map(tried).max().unwrap_or(0);
                for &(focal_px, log_tolerance) in &focal_lengths {
                    if self.hypotheses > begun + MOST_HYPOTHESES {
                        continue;
                    }
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

    /// The focal lengths to try, each with its half step in ln f, and whether they are few: first those around the nominal one from the middle outwards,
    /// then all, from wide fields (few triangles, quickly tried) to narrow ones.
    fn focal_lengths(&self) -> Vec<(Vec<(f64, f64)>, bool)> {
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
            passes.push((pass, true));
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
            passes.push((pass, false));
        }
        passes
    }

    /// Half the step in ln f: 2 %, less in wide fields, where a wrong focal length changes the shape of triangles.
    fn half_step(&self, focal_px: f64) -> f64 {
        let t = self.points.corner_px / focal_px;
        0.02 / (1.0 + t * t)
    }

    /// Tries the triangles of a stage at one focal length. `false` = stop (found, or out of time).
    fn try_focal_length(&mut self, stage: &Stage, done: usize, focal_px: f64, half_step: f64) -> bool {
        if self.out_of_time() {
            return false;
        }
        let points = self.points;
        let all = points.centred_px.len();
        let used = match stage.choice {
            Brightest(count) if all <= done || count <= done => return true,
            Brightest(count) => count.min(all),
            Drawn(_) => all.min(DRAWN_FROM),
        };
        let width_rad = 2.0 * (points.size_px / (2.0 * focal_px)).atan();
        let index = self.index;
        let level = index.level_for(width_rad, stage.coarser);
        let ideal: Vec<[f64; 2]> =
            points.centred_px.iter().take(used.max(stage.judges())).map(|p| undistort(*p, stage.kappa, points.corner_px)).collect();
        let rays: Vec<Vector3<f64>> = ideal[..used].iter().map(|&[x, y]| Vector3::new(x, y, focal_px).normalize()).collect();
        let context = Context { stage, level, ideal: &ideal, focal_px, half_step };
        match stage.choice {
            Brightest(_) => {
                let mut sides = vec![0.0; used * used];
                for i in 0..used {
                    for j in 0..used {
                        sides[i * used + j] = (rays[i] - rays[j]).norm();
                    }
                }
                let most = level.longest_range()[1];
                for k in done.max(2)..used {
                    for j in 1..k {
                        let jk = sides[j * used + k];
                        if jk > most {
                            continue;
                        }
                        for i in 0..j {
                            if !self.try_triangle(&context, [i, j, k], [jk, sides[i * used + k], sides[i * used + j]]) {
                                return false;
                            }
                        }
                    }
                }
            }
            Drawn(wanted) => {
                let mut rng = Pcg64Mcg::seed_from_u64(used as u64);
                let (mut tried, mut draws) = (0, 0);
                // Narrow fields have more catalogue triangles for each of the image.
                let most = self.hypotheses + 12 * wanted as u64;
                while tried < wanted && draws < 8 * wanted && self.hypotheses < most {
                    draws += 1;
                    let corners = [0; 3].map(|_| rng.random_range(0..used));
                    let side = |a: usize, b: usize| (rays[corners[a]] - rays[corners[b]]).norm();
                    let sides = [side(1, 2), side(0, 2), side(0, 1)];
                    tried += usize::from(context.usable(sides).is_some());
                    if !self.try_triangle(&context, corners, sides) {
                        return false;
                    }
                }
            }
        }
        true
    }

    fn out_of_time(&self) -> bool {
        self.deadline.is_some_and(|(deadline, _)| Instant::now() >= deadline)
    }

    /// Tries one triangle of detections. `false` = accepted or out of time, stop.
    fn try_triangle(&mut self, context: &Context<'_>, corners: [usize; 3], sides: [f64; 3]) -> bool {
        let Some(shape) = context.usable(sides) else { return true };
        let corners = shape.order.map(|corner| corners[corner]);
        // d ln side / d ln f, about −1, from the side at a focal length 1 % larger.
        let ray = |corner: usize| {
            let [x, y] = context.ideal[corner];
            Vector3::new(x, y, 1.01 * context.focal_px).normalize()
        };
        let sensitivity = ((ray(corners[1]) - ray(corners[2])).norm() / shape.longest).ln() / 0.01;
        let trial = Trial { context, corners, longest: shape.longest, sensitivity };
        // Noise of a pixel or two in the longest side adds to the step.
        let log_tolerance = context.half_step * sensitivity.abs() + 0.004;
        context.level.look_up(&shape, log_tolerance, context.stage.ratio_tolerance, |triangle| self.try_candidate(&trial, triangle))
    }

    /// Tries one pair of triangles. `false` = accepted, stop.
    fn try_candidate(&mut self, trial: &Trial<'_>, triangle: &Triangle) -> bool {
        self.hypotheses += 1;
        if self.hypotheses.is_multiple_of(1024) && self.out_of_time() {
            return false;
        }
        let Some(pose) = trial.pose(triangle, &self.index.vectors) else { return true };
        if self.options.parity.is_some_and(|parity| f64::from(parity) != pose.parity) || !trial.checks_out(&pose) {
            return true;
        }
        let boresight = Vector3::from(pose.rotation.row(2).transpose());
        let radius = (self.points.corner_px * (1.0 - pose.kappa.min(0.0)) * 1.15 / pose.focal_px).atan();
        let judges = trial.context.stage.judges();
        let near = self.index.brightest_within(&boresight, radius, 3 * self.points.centred_px.len().clamp(8, judges));
        let Some(Supported { pose, ln_probability }) = refine::refine(&pose, self.points, self.apparent, &near, judges) else {
            return true;
        };
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
        (width > 0.9 * narrow && width < 1.1 * wide)
            || nominal.is_some_and(|f| (focal_px / f).ln().abs() < 1.5 * self.options.focal_length_tolerance)
    }
}

/// Primes: fewer than 37·41·23 detections are never a multiple of all.
const CHECK_STRIDES: [usize; 3] = [37, 41, 23];

/// A stage at one focal length.
struct Context<'a> {
    stage: &'a Stage,
    level: &'a Level,
    /// Undistorted points: at least of the detections that form triangles.
    ideal: &'a [[f64; 2]],
    focal_px: f64,
    half_step: f64,
}

impl Context<'_> {
    /// The shape of a triangle, if the level has such.
    fn usable(&self, sides: [f64; 3]) -> Option<Shape> {
        let [least, most] = self.level.longest_range();
        Shape::new(sides).filter(|shape| shape.longest >= least && shape.longest <= most)
    }
}

/// A triangle of detections at a focal length.
struct Trial<'a> {
    context: &'a Context<'a>,
    /// The triangle's detections, opposite the longest, middle, shortest side.
    corners: [usize; 3],
    longest: f64,
    sensitivity: f64,
}

impl Trial<'_> {
    /// The attitude, focal length and parity that lay the detections over the catalogue triangle.
    fn pose(&self, triangle: &Triangle, vectors: &[Vector3<f64>]) -> Option<Pose> {
        let sky = triangle.stars.map(|star| vectors[star as usize]);
        let longest = (sky[1] - sky[2]).norm();
        // The focal length at which the longest side has the catalogue's length.
        let focal_px = self.context.focal_px * ((longest / self.longest).ln() / self.sensitivity).exp();
        if !(focal_px.is_finite() && focal_px > 0.0) {
            return None;
        }
        let mut image = self.corners.map(|corner| {
            let [x, y] = self.context.ideal[corner];
            Vector3::new(x, y, focal_px).normalize()
        });
        let hand = |[a, b, c]: [Vector3<f64>; 3]| (b - a).cross(&(c - a)).dot(&a);
        let parity = if hand(sky) * hand(image) < 0.0 { -1.0 } else { 1.0 };
        for v in &mut image {
            v.x *= parity;
        }
        let rotation = axes(image) * axes(sky).transpose();
        Some(Pose { rotation, focal_px, kappa: self.context.stage.kappa, parity })
    }

    /// Whether more of the other detections find a star than would by chance.
    fn checks_out(&self, pose: &Pose) -> bool {
        let context = self.context;
        let count = context.ideal.len().min(context.stage.judges());
        let others = count.saturating_sub(3);
        let to_sky = pose.rotation.transpose();
        // Where most detections are false, more must be looked at before a candidate is given up.
        let patience = if matches!(context.stage.choice, Brightest(_)) { 4 } else { 8 };
        let (mut looked, mut hits) = (0, 0);
        // Through the list in strides, so that bright and faint ones come early alike.
        let stride = CHECK_STRIDES.into_iter().find(|stride| !count.is_multiple_of(*stride)).unwrap_or(1);
        for step in 0..count {
            let number = step * stride % count;
            if self.corners.contains(&number) {
                continue;
            }
            let [x, y] = context.ideal[number];
            let direction = to_sky * Vector3::new(x * pose.parity, y, pose.focal_px);
            looked += 1;
            hits += usize::from(context.level.map.has_star_near(&direction));
            if (looked == patience && hits == 0) || (looked == 16 && hits < 2) {
                return false;
            }
        }
        let by_chance = others as f64 * context.level.map.covered;
        hits > 0 && odds::ln_poisson_tail(by_chance, hits) < CHECK_LN_PROBABILITY
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

//! The search: triangles of detections against triangles of the catalogue, over focal lengths and distortions.

use std::time::{Duration, Instant};

use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::index::{Index, Level, Shape};
use super::refine::{self, Points, Pose, Supported};
use super::{IdentifyOptions, odds};

/// Detections that are looked at in the check of a candidate of the brightest.
const CHECKED: usize = 64;
/// Radius within which a catalogue star must find a detection, over the size of the frame.
const CHECK_RADIUS: f64 = 0.0085;
/// The share of the brightest catalogue stars in the frame that a right candidate finds, at least; and where there are only few
/// detections, so that some of the brightest stars may be missing.
const FOUND: f64 = 0.5;
const FOUND_OF_FEW: f64 = 0.3;
/// So many are few.
const FEW: usize = 16;
/// A candidate is given up at this ln of the likelihood over that of chance, and passed on at the other.
const GIVE_UP: f64 = -2.6;
const PASS_ON: f64 = 6.0;
/// Passed on too if all neighbours are asked and it stands here.
const PASS_AT_LAST: f64 = 3.0;
/// Triangles by chance are drawn from so many of the brightest detections, and checked against as many.
const DRAWN_FROM: usize = 200;

/// Hypotheses in one pass over the focal lengths after which the rest of it is given up: narrow fields full of false
/// detections would take for ever.
const MOST_HYPOTHESES: u64 = 2_000_000;
/// The same for one stage at one focal length, where all are searched: the catalogue has so many more triangles for fields of
/// three degrees than for wide ones that they would take nearly all of the time.
const MOST_IN_A_STEP: u64 = 2000;
/// Hypotheses between two looks at the clock.
const BETWEEN_LOOKS: u64 = 32;

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

/// From the likely and cheap to the rest: sparser stars for images that show only few, more detections for false stars,
/// distortions of either sign, a wider tolerance for noise.
const STAGES: [Stage; 19] = [
    stage(Brightest(10), 0.003, 0.0, 0),
    stage(Brightest(7), 0.003, 0.0, 2),
    stage(Brightest(16), 0.003, 0.0, 0),
    stage(Drawn(250), 0.003, 0.0, 0),
    stage(Brightest(9), 0.008, 0.0, 2),
    stage(Brightest(13), 0.006, -0.04, 0),
    stage(Brightest(22), 0.003, 0.0, 0),
    stage(Brightest(13), 0.006, -0.09, 0),
    stage(Brightest(13), 0.006, 0.04, 0),
    stage(Brightest(13), 0.006, -0.16, 0),
    stage(Brightest(13), 0.006, -0.24, 0),
    stage(Brightest(11), 0.008, 0.0, 1),
    stage(Brightest(12), 0.005, 0.0, -1),
    stage(Drawn(700), 0.003, 0.0, 0),
    narrow_only(Brightest(13), 0.012, 0.0, 0),
    narrow_only(Brightest(18), 0.006, -0.04, 0),
    narrow_only(Brightest(18), 0.006, -0.16, 0),
    narrow_only(Brightest(12), 0.010, 0.0, -2),
    narrow_only(Drawn(3000), 0.003, 0.0, 0),
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
    /// Hypotheses at which the stage goes on to the next focal length.
    most: u64,
    best_probability: f64,
    found: Option<Found>,
}

impl<'a> Search<'a> {
    pub(super) fn new(points: &'a Points, index: &'a Index, apparent: &'a [Vector3<f64>], options: &'a IdentifyOptions) -> Self {
        let deadline = options.time_limit.and_then(|limit| Some((Instant::now().checked_add(limit)?, limit)));
        Self { points, index, apparent, options, deadline, hypotheses: 0, most: 0, best_probability: 1.0, found: None }
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
                let (kappa, corner_px) = (stage.kappa, self.points.corner_px);
                let judges = self.points.centred_px.iter().take(stage.judges());
                let ideal: Vec<[f64; 2]> = judges.map(|p| undistort(*p, kappa, corner_px)).collect();
                let map = PointMap::new(&ideal, self.points);
                for &focal_length in &focal_lengths {
                    if self.hypotheses > begun + MOST_HYPOTHESES {
                        continue;
                    }
                    self.most = if narrow { u64::MAX } else { self.hypotheses + MOST_IN_A_STEP };
                    if !self.try_focal_length(stage, done, (&ideal, &map), focal_length) {
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
            let steps = ((reach / self.half_step(nominal) - 1.0) / 2.0).ceil().max(0.0) as i32;
            let half_step = (reach / (2.0 * f64::from(steps) + 1.0)).max(1e-6);
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

    /// Half the step in ln f: the less the wider the field, where a wrong focal length changes the shape of triangles.
    fn half_step(&self, focal_px: f64) -> f64 {
        let t2 = (self.points.corner_px / focal_px).powi(2);
        (0.001_2 / t2).min(0.05).max(0.02 / (1.0 + t2))
    }

    /// Tries the triangles of a stage at one focal length. `false` = stop (found, or out of time).
    fn try_focal_length(
        &mut self,
        stage: &Stage,
        done: usize,
        (ideal, map): (&[[f64; 2]], &PointMap),
        (focal_px, half_step): (f64, f64),
    ) -> bool {
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
        let rays: Vec<Vector3<f64>> = ideal[..used].iter().map(|&[x, y]| Vector3::new(x, y, focal_px).normalize()).collect();
        let context = Context { stage, level, ideal, map, half_px: points.half_px, corner_px: points.corner_px, focal_px, half_step };
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
                        if self.hypotheses > self.most {
                            return true;
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
                let most = self.most.min(self.hypotheses + 12 * wanted as u64);
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
    fn try_candidate(&mut self, trial: &Trial<'_>, triangle: [u32; 3]) -> bool {
        self.hypotheses += 1;
        if self.hypotheses.is_multiple_of(BETWEEN_LOOKS) && self.out_of_time() {
            return false;
        }
        let Some(pose) = trial.pose(triangle) else { return true };
        if self.options.parity.is_some_and(|parity| f64::from(parity) != pose.parity) || !trial.checks_out(triangle, &pose) {
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

/// A stage at one focal length.
struct Context<'a> {
    stage: &'a Stage,
    level: &'a Level,
    /// Undistorted points: at least of the detections that form triangles.
    ideal: &'a [[f64; 2]],
    map: &'a PointMap,
    half_px: [f64; 2],
    corner_px: f64,
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
    fn pose(&self, triangle: [u32; 3]) -> Option<Pose> {
        let sky = triangle.map(|star| self.context.level.vectors[star as usize]);
        let longest = (sky[1] - sky[2]).norm();
        // The focal length at which the longest side has the catalogue's length.
        let log = ln_near_1(longest / self.longest) / self.sensitivity;
        let focal_px = self.context.focal_px * (1.0 + log * (1.0 + log * (0.5 + log / 6.0)));
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

    /// Whether the brightest catalogue stars around the triangle are found in the image, more of them than by chance: a sequential
    /// test, which for most candidates ends after four stars (Wald, Annals of Mathematical Statistics 16, 117, 1945).
    fn checks_out(&self, triangle: [u32; 3], pose: &Pose) -> bool {
        let context = self.context;
        // Around the corner of the triangle nearest to the middle most neighbours are in the frame.
        let from_middle = |side: usize| {
            let [x, y] = context.ideal[self.corners[side]];
            x * x + y * y
        };
        let central = (1..3).fold(0, |best, side| if from_middle(side) < from_middle(best) { side } else { best });
        let (gain, loss) = (context.map.gain, context.map.loss);
        let mut support = 0.0;
        // The triangle itself is among the neighbours and always found: it is known by its place.
        let own = self.corners.map(|corner| context.ideal[corner]);
        for direction in context.level.neighbours(triangle[central]) {
            let v = pose.rotation * direction;
            if v.z <= 0.05 {
                continue;
            }
            let scale = pose.focal_px / v.z;
            let (x, y) = (v.x * scale * pose.parity, v.y * scale);
            // Where the measured point would be, roughly.
            let shrink = 1.0 - pose.kappa * ((x * x + y * y) / (context.corner_px * context.corner_px)).min(1.0);
            if x.abs() > context.half_px[0] * shrink || y.abs() > context.half_px[1] * shrink {
                continue;
            }
            let reach_px = context.map.radius_px;
            if own.iter().any(|[px, py]| (px - x).abs() < reach_px && (py - y).abs() < reach_px) {
                continue;
            }
            support += if context.map.has_point_near(x, y) { gain } else { loss };
            if support < GIVE_UP {
                return false;
            }
            if support > PASS_ON {
                return true;
            }
        }
        support > PASS_AT_LAST
    }
}

/// Answers "is there a detection near this place?" by one bit; small enough for the fastest cache.
struct PointMap {
    origin_px: [f64; 2],
    cells_per_px: f64,
    columns: usize,
    rows: usize,
    bits: Vec<u64>,
    radius_px: f64,
    /// ln of the likelihood, over that of chance, of a star that is found and of one that is not.
    gain: f64,
    loss: f64,
}

impl PointMap {
    fn new(ideal: &[[f64; 2]], points: &Points) -> Self {
        let radius_px = CHECK_RADIUS * points.size_px;
        let cells_per_px = 2.5 / radius_px;
        // Distortion may carry points out of the frame.
        let reach = |axis: usize| ideal.iter().map(|p| p[axis].abs()).fold(points.half_px[axis], f64::max) + 2.0 * radius_px;
        let origin_px = [-reach(0), -reach(1)];
        let cells = |axis: usize| (-2.0 * origin_px[axis] * cells_per_px) as usize + 1;
        let (columns, rows) = (cells(0), cells(1));
        let mut bits = vec![0_u64; (columns * rows).div_ceil(64)];
        for &[x, y] in ideal {
            let (cx, cy) = ((x - origin_px[0]) * cells_per_px, (y - origin_px[1]) * cells_per_px);
            for row in (cy - 2.5).max(0.0) as usize..=((cy + 2.5) as usize).min(rows - 1) {
                for column in (cx - 2.5).max(0.0) as usize..=((cx + 2.5) as usize).min(columns - 1) {
                    let (dx, dy) = (column as f64 + 0.5 - cx, row as f64 + 0.5 - cy);
                    if dx * dx + dy * dy <= 2.5 * 2.5 {
                        let cell = row * columns + column;
                        bits[cell / 64] |= 1 << (cell % 64);
                    }
                }
            }
        }
        let disc = std::f64::consts::PI * radius_px * radius_px / (4.0 * points.half_px[0] * points.half_px[1]);
        let covered = (ideal.len() as f64 * disc).clamp(1e-6, 0.3);
        let found = if ideal.len() <= FEW { FOUND_OF_FEW } else { FOUND };
        let (gain, loss) = ((found / covered).ln(), ((1.0 - found) / (1.0 - covered)).ln());
        Self { origin_px, cells_per_px, columns, rows, bits, radius_px, gain, loss }
    }

    fn has_point_near(&self, x_px: f64, y_px: f64) -> bool {
        let (cx, cy) = ((x_px - self.origin_px[0]) * self.cells_per_px, (y_px - self.origin_px[1]) * self.cells_per_px);
        if !(cx >= 0.0 && cy >= 0.0) || cx >= self.columns as f64 || cy >= self.rows as f64 {
            return false;
        }
        let cell = cy as usize * self.columns + cx as usize;
        self.bits[cell / 64] >> (cell % 64) & 1 == 1
    }
}

/// ln, to 1e-6 for what a step of the focal length brings: the library's takes as long as the rest of a candidate.
fn ln_near_1(ratio: f64) -> f64 {
    let t = (ratio - 1.0) / (ratio + 1.0);
    2.0 * t * (1.0 + t * t * (1.0 / 3.0 + t * t / 5.0))
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

//! Triangle search: triangles of detections against triangles of the catalogue, over focal lengths and distortions.

use std::borrow::Cow;
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::candidate::{Context, LONGER, Trial, undistort};
use super::index::Index;
use super::index_scale::{Ranges, Window};
use super::point_map::PointMap;
use super::pose::{Points, Pose};
use super::projection::Projection;
use super::refine::{self, Supported};
use super::search_plan::FramePoints;
use super::stages::Choice::{Brightest, Drawn};
use super::stages::{DRAWN_FROM, Stage};
use super::{IdentifyOptions, false_match, fisheye, search_plan};
use crate::units::DEG_RAD;

/// The angle from the middle to the corner of the widest fields that are searched: beyond that of any square frame that may be asked for.
const MAX_TO_CORNER_RAD: f64 = 80.0 * DEG_RAD;

/// Hypotheses in one pass over the focal lengths after which the rest of it is given up: narrow fields full of false
/// detections would take for ever.
const MAX_HYPOTHESES: u64 = 2_000_000;
/// The same for one stage at one focal length, where all are searched: the catalogue has so many more triangles for fields of
/// three degrees than for wide ones that they would take nearly all of the time.
const MAX_IN_A_STEP: u64 = 2000;
/// Hypotheses between two readings of the clock.
const BETWEEN_LOOKS: u64 = 32;

/// Triangles of detections that are looked up together.
const BATCH: usize = 24;

/// A search without an answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Failure {
    /// The hypotheses that were tried.
    pub(super) hypotheses: u64,
    pub(super) end: End,
}

/// Why a search ended without an answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum End {
    /// Everything was tried, or (`was_cut`) as much of everything as there is time for; of the best hypothesis the bound on
    /// the probability that it comes by chance and what would be stated of it.
    Exhausted { least_bound: f64, least_stated: f64, was_cut: bool },
    /// The time limit came first.
    TimeLimit { limit: Duration },
}

/// An accepted hypothesis.
#[derive(Clone, Debug)]
pub(super) struct Found {
    pub(super) pose: Pose,
    /// The points that it was found among are within this distance from the middle, px.
    pub(super) reach_px: f64,
    /// The hypotheses that had been tried.
    pub(super) hypotheses: u64,
    pub(super) false_match_probability: f64,
}

/// Triangles of detections that wait to be looked up, all at one focal length.
#[derive(Default)]
struct Batch {
    /// The cosine of the angle from the boresight held to be within which all stars of the frame lie, if one is.
    cos_near: Option<f64>,
    /// The directions of the detections at a focal length longer by [`LONGER`].
    rays_at_longer: Vec<Vector3<f64>>,
    trials: Vec<Trial>,
    windows: Vec<Window>,
    ranges: Ranges,
    found: Vec<(u32, u32)>,
    candidates: Vec<(u32, [u32; 3])>,
}

/// Focal lengths to try, each with its half step in ln f, and whether they are few.
type Pass = (Vec<(f64, f64)>, bool);

/// Points without the distortion that is held to be, and their map.
type Mapped = (Vec<[f64; 2]>, PointMap);

/// One search pass over a frame: which of its points, through which lens, what is tried.
pub(super) struct SearchPass<'a> {
    /// The frame's points.
    pub(super) frame: &'a Points,
    /// Those among which is searched.
    pub(super) points: Cow<'a, Points>,
    pub(super) projection: Projection,
    pub(super) stages: &'static [Stage],
}

/// What has been tried so far, in all search passes over a frame together.
#[derive(Clone, Copy, Debug)]
struct Tally {
    hypotheses: u64,
    least_bound: f64,
    least_stated: f64,
    /// Whether a part of what the stages ask for was left out.
    was_cut: bool,
}

/// The state of a search over one image.
struct Search<'a> {
    points: &'a Points,
    projection: Projection,
    stages: &'static [Stage],
    index: &'a Index,
    /// Directions of the catalogue stars as they appear in this frame.
    apparent: &'a [Vector3<f64>],
    options: &'a IdentifyOptions,
    deadline: Option<(Instant, Duration)>,
    tally: Tally,
    /// Hypotheses at which the stage goes on to the next focal length.
    most: u64,
    /// Memory for triangles, kept from one focal length to the next.
    batch: Batch,
    found: Option<Found>,
}

/// Looks at a frame in each way in turn until a hypothesis is accepted. `begin`: when the work on this frame began, from which a time limit
/// counts.
pub(super) fn search<'a>(
    seen: &'a FramePoints,
    index: &Index,
    apparent: &[Vector3<f64>],
    options: &IdentifyOptions,
    begin: Instant,
) -> Result<(Found, &'a Points), Failure> {
    let deadline = options.time_limit.and_then(|limit| Some((begin.checked_add(limit.saturating_sub(options.time_spent))?, limit)));
    let mut tally = Tally { hypotheses: 0, least_bound: 1.0, least_stated: 1.0, was_cut: false };
    for look in search_plan::search_passes(seen, options) {
        let SearchPass { frame, points, projection, stages } = &look;
        let (projection, stages) = (*projection, *stages);
        let mut search =
            Search { points, projection, stages, index, apparent, options, deadline, tally, most: 0, batch: Batch::default(), found: None };
        if !search.run() {
            let limit = deadline.map_or(Duration::ZERO, |(_, limit)| limit);
            return search
                .found
                .map(|found| (found, *frame))
                .ok_or(Failure { hypotheses: search.tally.hypotheses, end: End::TimeLimit { limit } });
        }
        tally = search.tally;
    }
    let Tally { hypotheses, least_bound, least_stated, was_cut } = tally;
    Err(Failure { hypotheses, end: End::Exhausted { least_bound, least_stated, was_cut } })
}

impl Search<'_> {
    /// Runs all stages over each list of focal lengths in turn. `false` = accepted or out of time.
    fn run(&mut self) -> bool {
        let stages = self.stages;
        for (focal_lengths, narrow) in self.focal_lengths() {
            let begun = self.tally.hypotheses;
            // Around an attitude that is held to be there is time for all stages.
            let all_stages = narrow || self.options.near.is_some();
            // Of how many of the brightest detections each stage has tried all triangles, at each focal length.
            let mut tried = vec![vec![0_usize; stages.len()]; focal_lengths.len()];
            // The points of each distortion and number of judges, and their map: many stages ask for the same.
            let mut mapped: Vec<((f64, usize), Mapped)> = Vec::new();
            for (number, stage) in stages.iter().enumerate().filter(|(_, stage)| all_stages || !stage.narrow_only) {
                let covers = |s: &Stage| s.kappa == stage.kappa && s.coarser == stage.coarser && s.ratio_tolerance >= stage.ratio_tolerance;
                let (kappa, corner_px) = (stage.kappa, self.points.corner_px);
                let asked = (kappa, stage.judges().min(self.points.centred_px.len()));
                let place = mapped.iter().position(|(of, _)| *of == asked).unwrap_or_else(|| {
                    let judges = self.points.centred_px.iter().take(asked.1);
                    let ideal: Vec<[f64; 2]> = judges.map(|p| undistort(*p, kappa, corner_px)).collect();
                    let map = PointMap::new(&ideal, self.points);
                    mapped.push((asked, (ideal, map)));
                    mapped.len() - 1
                });
                let (ideal, map) = &mapped[place].1;
                for (&focal_length, tried) in focal_lengths.iter().zip(&mut tried) {
                    if self.tally.hypotheses > begun + MAX_HYPOTHESES {
                        self.tally.was_cut = true;
                        continue;
                    }
                    self.most = if narrow { u64::MAX } else { self.tally.hypotheses + MAX_IN_A_STEP };
                    // Triangles of detections that an earlier stage with the same settings has tried are not tried again.
                    let before = stages[..number].iter().zip(&*tried).filter(|(s, _)| covers(s));
                    let done = before.map(|(_, tried)| *tried).max().unwrap_or(0);
                    let Some(reached) = self.try_focal_length(stage, done, (ideal, map), focal_length) else { return false };
                    tried[number] = reached;
                }
            }
        }
        true
    }

    /// The focal lengths to try, each with its half step in ln f, and whether they are few: first those around the nominal one from the middle outwards,
    /// then all, from wide fields (few triangles, quickly tried) to narrow ones.
    fn focal_lengths(&self) -> Vec<Pass> {
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
            passes.push((self.all_focal_lengths(), false));
        }
        passes
    }

    /// The focal lengths of all fields, from wide to narrow ones.
    fn all_focal_lengths(&self) -> Vec<(f64, f64)> {
        let (mut f, last) = if self.projection == Projection::Pinhole {
            let [narrow, wide] = self.options.field_width_range_rad;
            let half_width = self.points.half_px[0];
            // Of a frame far taller than wide no more is searched than a plane shows: the steps would have no end.
            let shortest = self.points.corner_px / MAX_TO_CORNER_RAD.tan();
            ((half_width / (wide / 2.0).tan()).max(shortest), half_width / (narrow / 2.0).tan())
        } else {
            let [least, most] = fisheye::REACH_RAD.map(|angle| self.projection.radius(angle));
            (self.points.reach_px / most, self.points.reach_px / least)
        };
        let mut all = Vec::new();
        while f < last * 1.02 {
            let half_step = self.half_step(f);
            all.push((f * half_step.exp(), half_step));
            f *= (2.0 * half_step).exp();
        }
        all
    }

    /// Half the step in ln f: the less the wider the field, where a wrong focal length changes the shape of triangles.
    fn half_step(&self, focal_px: f64) -> f64 {
        if self.projection != Projection::Pinhole {
            return fisheye::HALF_STEP;
        }
        let t2 = (self.points.reach_px / focal_px).powi(2);
        (0.001_2 / t2).min(0.05).max(0.02 / (1.0 + t2))
    }

    /// Tries the triangles of a stage at one focal length, except those of the `done` brightest detections. Of how many of the
    /// brightest all triangles are tried then; `None` = stop (found, or out of time).
    fn try_focal_length(
        &mut self,
        stage: &Stage,
        done: usize,
        (ideal, map): (&[[f64; 2]], &PointMap),
        (focal_px, half_step): (f64, f64),
    ) -> Option<usize> {
        if self.out_of_time() {
            return None;
        }
        let points = self.points;
        let all = points.centred_px.len();
        let used = match stage.choice {
            Brightest(count) if all <= done || count <= done => return Some(done),
            Brightest(count) => count.min(all),
            Drawn(_) => all.min(DRAWN_FROM),
        };
        let width_rad = self.width_rad(focal_px);
        let index = self.index;
        let level = index.level_for(width_rad, stage.coarser);
        let context = Context {
            kappa: stage.kappa,
            ratio_tolerance: stage.ratio_tolerance,
            judges: stage.judges(),
            level,
            ideal,
            map,
            half_px: points.half_px,
            corner_px: points.corner_px,
            reach_px: points.reach_px,
            projection: self.projection,
            focal_px,
            half_step,
            corner_rad: self.projection.angle_rad(1.15 * points.reach_px * (1.0 - stage.kappa.min(0.0)) / (focal_px * (1.0 - half_step))),
        };
        let cos_near = self.options.near.map(|near| near.cos_reach(context.corner_rad));
        // What lies beyond the image of a fisheye forms no triangle.
        let nowhere = Vector3::from_element(f64::NAN);
        let rays_at = |focal_px: f64| -> Vec<Vector3<f64>> {
            ideal[..used].iter().map(|at| self.projection.ray(*at, focal_px).unwrap_or(nowhere)).collect()
        };
        let rays = rays_at(focal_px);
        let mut batch = std::mem::take(&mut self.batch);
        (batch.cos_near, batch.rays_at_longer) = (cos_near, rays_at(focal_px * (1.0 + LONGER)));
        let reached = match stage.choice {
            Brightest(_) => self.try_brightest(&context, &mut batch, &rays, done),
            Drawn(wanted) => self.try_drawn(&context, &mut batch, &rays, wanted),
        };
        self.batch = batch;
        reached
    }

    /// Tries all triangles of the brightest detections, except those of the `done` brightest; the answer is that of [`Self::try_focal_length`].
    fn try_brightest(&mut self, context: &Context<'_>, batch: &mut Batch, rays: &[Vector3<f64>], done: usize) -> Option<usize> {
        let (used, most) = (rays.len(), context.level.longest_range()[1]);
        let mut sides = vec![0.0; used * used];
        for i in 0..used {
            for j in 0..i {
                let side = (rays[i] - rays[j]).norm();
                (sides[i * used + j], sides[j * used + i]) = (side, side);
            }
        }
        for k in done.max(2)..used {
            for j in 1..k {
                let jk = sides[j * used + k];
                if jk > most {
                    continue;
                }
                if self.tally.hypotheses > self.most {
                    self.tally.was_cut = true;
                    return Some(k);
                }
                for i in 0..j {
                    if !self.try_triangle(context, batch, [i, j, k], [jk, sides[i * used + k], sides[i * used + j]]) {
                        return None;
                    }
                }
            }
        }
        self.flush(context, batch).then_some(used)
    }

    /// Tries triangles drawn at random; the answer is that of [`Self::try_focal_length`].
    fn try_drawn(&mut self, context: &Context<'_>, batch: &mut Batch, rays: &[Vector3<f64>], wanted: usize) -> Option<usize> {
        let (used, most) = (rays.len(), context.level.longest_range()[1]);
        // Other draws than those of the other stages.
        let mut rng = Pcg64Mcg::seed_from_u64((wanted as u64) << 32 | used as u64);
        let (mut tried, mut draws) = (0, 0);
        // Narrow fields have more catalogue triangles for each of the image.
        let enough = self.most.min(self.tally.hypotheses + 12 * wanted as u64);
        while tried < wanted && draws < 8 * wanted && self.tally.hypotheses < enough {
            draws += 1;
            let corners = [0; 3].map(|_| rng.random_range(0..used));
            let chord2 = |a: usize, b: usize| (rays[corners[a]] - rays[corners[b]]).norm_squared();
            let squares = [chord2(1, 2), chord2(0, 2), chord2(0, 1)];
            if squares.iter().any(|square| *square > most * most) {
                continue;
            }
            let sides = squares.map(f64::sqrt);
            tried += usize::from(context.usable(sides).is_some());
            if !self.try_triangle(context, batch, corners, sides) {
                return None;
            }
        }
        self.tally.was_cut |= tried < wanted && self.tally.hypotheses >= self.most;
        self.flush(context, batch).then_some(0)
    }

    fn out_of_time(&self) -> bool {
        self.deadline.is_some_and(|(deadline, _)| Instant::now() >= deadline)
    }

    /// Tries one triangle of detections, by and by. `false` = accepted or out of time, stop.
    fn try_triangle(&mut self, context: &Context<'_>, batch: &mut Batch, corners: [usize; 3], sides: [f64; 3]) -> bool {
        let Some(shape) = context.usable(sides) else { return true };
        let trial = Trial::new(context, &shape, shape.order.map(|corner| corners[corner]), &batch.rays_at_longer);
        let Some(window) = context.level.window(&shape, trial.log_tolerance(context), context.ratio_tolerance) else { return true };
        batch.trials.push(trial);
        batch.windows.push(window);
        batch.windows.len() < BATCH || self.flush(context, batch)
    }

    /// Tries the triangles that wait. `false` = accepted or out of time, stop.
    fn flush(&mut self, context: &Context<'_>, batch: &mut Batch) -> bool {
        if self.out_of_time() {
            return false;
        }
        batch.found.clear();
        context.level.look_up(&batch.windows, &mut batch.ranges, &mut batch.found);
        batch.candidates.clear();
        batch.candidates.extend(batch.found.iter().map(|(window, triangle)| (*window, context.level.triangle(*triangle))));
        if let Some((near, least)) = self.options.near.zip(batch.cos_near) {
            let towards = Vector3::from(near.boresight.xyz);
            batch.candidates.retain(|(_, stars)| context.level.direction(stars[0]).dot(&towards) >= least);
        }
        let of = |&(window, stars): &(u32, [u32; 3])| (stars, batch.trials[window as usize].central);
        context.level.touch(batch.candidates.iter().map(of));
        let goes_on =
            batch.candidates.iter().all(|(window, triangle)| self.try_candidate(context, &batch.trials[*window as usize], *triangle));
        batch.trials.clear();
        batch.windows.clear();
        goes_on
    }

    /// Tries one pair of triangles. `false` = accepted or out of time, stop.
    fn try_candidate(&mut self, context: &Context<'_>, trial: &Trial, triangle: [u32; 3]) -> bool {
        self.tally.hypotheses += 1;
        if self.tally.hypotheses.is_multiple_of(BETWEEN_LOOKS) && self.out_of_time() {
            return false;
        }
        let Some(pose) = trial.pose(context, triangle) else { return true };
        // A triangle with the noise of its corners tells the attitude to a part of the field.
        if self.options.near.is_some_and(|near| !near.allows(&pose.rotation, 0.1 * context.corner_rad)) {
            return true;
        }
        if self.options.parity.is_some_and(|parity| f64::from(parity) != pose.parity) || !trial.checks_out(context, triangle, &pose) {
            return true;
        }
        let judges = context.judges;
        let tried = self.tally.hypotheses as f64;
        let near = self.index.brightest_near(&pose, self.points, 5 * self.points.centred_px.len().clamp(8, judges));
        let ln_enough = false_match::ln_below(self.options.max_false_match_probability, tried);
        let Some(Supported { pose, ln_best, ln_probability, judges }) =
            refine::refine(&pose, self.points, self.apparent, &near, judges, ln_enough)
        else {
            return true;
        };
        let bound = false_match::over_all_tries(ln_probability, tried);
        // What was tried before this search counts in what is stated; accepted is what this search finds by itself, as the others did.
        let of_all = tried + self.options.hypotheses_before as f64;
        let width_rad = self.width_rad(pose.focal_px);
        let stated = false_match::calibrated_false_match_probability(ln_best, of_all, width_rad, judges)
            .min(false_match::over_all_tries(ln_probability, of_all));
        self.tally.least_bound = self.tally.least_bound.min(bound);
        let is_near = self.options.near.is_none_or(|near| near.allows(&pose.rotation, 0.0));
        if self.within_range(pose.focal_px) && is_near {
            self.tally.least_stated = self.tally.least_stated.min(stated);
            if bound < self.options.max_false_match_probability {
                self.found = Some(Found {
                    pose,
                    reach_px: self.points.reach_px,
                    hypotheses: self.tally.hypotheses,
                    false_match_probability: stated,
                });
                return false;
            }
        }
        true
    }

    /// The width of a square field as large as the part of the sky in which there are points, rad.
    fn width_rad(&self, focal_px: f64) -> f64 {
        match self.projection {
            Projection::Pinhole => 2.0 * (self.points.size_px / (2.0 * focal_px)).atan(),
            fisheye => (std::f64::consts::TAU * (1.0 - fisheye.angle_rad(self.points.reach_px / focal_px).cos())).sqrt(),
        }
    }

    fn within_range(&self, focal_px: f64) -> bool {
        if self.projection != Projection::Pinhole {
            return true;
        }
        let [narrow, wide] = self.options.field_width_range_rad;
        let width = 2.0 * (self.points.half_px[0] / focal_px).atan();
        let nominal = self.options.nominal_focal_length_px;
        (width > 0.9 * narrow && width < 1.1 * wide)
            || nominal.is_some_and(|f| (focal_px / f).ln().abs() < 1.5 * self.options.focal_length_tolerance)
    }
}

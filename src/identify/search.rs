//! Triangle search: triangles of detections against triangles of the catalogue, over focal lengths and distortions.

use std::borrow::Cow;
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::candidate::{Context, LONGER, Limits, Trial, undistort};
use super::candidate_block::{BLOCK, check_out};
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
/// Room is made for so many at first: mostly no more are looked up.
const FEW: usize = 8;

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

/// Triangles of detections that wait to be looked up.
#[derive(Default)]
struct Batch {
    trials: Vec<Trial>,
    windows: Vec<Window>,
    ranges: Ranges,
    found: Vec<(u32, u32)>,
    candidates: Vec<(u32, [u32; 3])>,
}

impl Batch {
    fn with_room() -> Self {
        let (trials, windows) = (Vec::with_capacity(FEW), Vec::with_capacity(FEW));
        Self { trials, windows, ranges: Ranges::default(), found: Vec::with_capacity(2 * FEW), candidates: Vec::with_capacity(2 * FEW) }
    }

    /// Forgets the triangles that wait.
    fn clear(&mut self) {
        self.trials.clear();
        self.windows.clear();
    }
}

/// A stage at one focal length, with the directions of the detections that form its triangles.
struct Step<'a> {
    context: Context<'a>,
    /// At the context's focal length, and at one longer by [`LONGER`].
    rays: Vec<[Vector3<f64>; 2]>,
    /// The cosine of the angle from the boresight held to be within which all stars of the frame lie, if one is.
    cos_near: Option<f64>,
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
        let mut search = Search {
            points,
            projection,
            stages,
            index,
            apparent,
            options,
            deadline,
            tally,
            most: 0,
            batch: Batch::with_room(),
            found: None,
        };
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

impl<'a> Search<'a> {
    /// Runs all stages over each list of focal lengths in turn. `false` = accepted or out of time.
    fn run(&mut self) -> bool {
        let passes: [fn(&Self) -> Option<Pass>; 2] = [Self::around_nominal, Self::everywhere];
        for pass in passes {
            if pass(self).is_some_and(|pass| !self.run_over(pass)) {
                return false;
            }
        }
        true
    }

    /// Runs all stages over some focal lengths. `false` = accepted or out of time.
    fn run_over(&mut self, (focal_lengths, narrow): Pass) -> bool {
        let (stages, begun) = (self.stages, self.tally.hypotheses);
        // Around an attitude that is held to be there is time for all stages.
        let all_stages = narrow || self.options.near.is_some();
        // Of how many of the brightest detections each stage has tried all triangles, at each focal length.
        let mut tried = vec![0_usize; stages.len() * focal_lengths.len()];
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
            let mapped = &mapped[place].1;
            if let (true, Brightest(count)) = (narrow && stage.by_triangle, stage.choice) {
                let Some(reached) = self.try_by_triangle(stage, count, mapped, &focal_lengths) else { return false };
                tried.chunks_mut(stages.len()).for_each(|tried| tried[number] = reached);
                continue;
            }
            for (&focal_length, tried) in focal_lengths.iter().zip(tried.chunks_mut(stages.len())) {
                if self.tally.hypotheses > begun + MAX_HYPOTHESES {
                    self.tally.was_cut = true;
                    continue;
                }
                self.most = if narrow { u64::MAX } else { self.tally.hypotheses + MAX_IN_A_STEP };
                // Triangles of detections that an earlier stage with the same settings has tried are not tried again.
                let before = stages[..number].iter().zip(&*tried).filter(|(s, _)| covers(s));
                let done = before.map(|(_, tried)| *tried).max().unwrap_or(0);
                let Some(reached) = self.try_focal_length(stage, done, mapped, focal_length) else { return false };
                tried[number] = reached;
            }
        }
        true
    }

    /// Focal lengths around the nominal one, if there is one, from the middle outwards.
    fn around_nominal(&self) -> Option<Pass> {
        let nominal = self.options.nominal_focal_length_px?;
        let reach = (1.0 + self.options.focal_length_tolerance).ln();
        let steps = ((reach / self.half_step(nominal) - 1.0) / 2.0).ceil().max(0.0) as i32;
        let half_step = (reach / (2.0 * f64::from(steps) + 1.0)).max(1e-6);
        let mut pass = vec![(nominal, half_step)];
        for k in 1..=steps {
            let factor = (2.0 * half_step * f64::from(k)).exp();
            pass.push((nominal * factor, half_step));
            pass.push((nominal / factor, half_step));
        }
        Some((pass, true))
    }

    /// The focal lengths of all fields, if they are to be searched: from wide ones (few triangles, quickly tried) to narrow ones.
    fn everywhere(&self) -> Option<Pass> {
        let is_asked = self.options.nominal_focal_length_px.is_none() || self.options.search_beyond_tolerance;
        is_asked.then(|| (self.all_focal_lengths(), false))
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
    fn try_focal_length(&mut self, stage: &Stage, done: usize, mapped: &Mapped, focal_length: (f64, f64)) -> Option<usize> {
        if self.out_of_time() {
            return None;
        }
        let all = self.points.centred_px.len();
        let used = match stage.choice {
            Brightest(count) if all <= done || count <= done => return Some(done),
            Brightest(count) => count.min(all),
            Drawn(_) => all.min(DRAWN_FROM),
        };
        let step = self.step(stage, used, mapped, focal_length);
        let mut batch = std::mem::take(&mut self.batch);
        let reached = match stage.choice {
            Brightest(_) => self.try_brightest(&step, &mut batch, done),
            Drawn(wanted) => self.try_drawn(&step, &mut batch, wanted),
        };
        self.batch = batch;
        reached
    }

    /// Tries each triangle of the brightest detections at all focal lengths before the next; the answer is that of [`Self::try_focal_length`]. They are
    /// so few that none of its limits is reached.
    fn try_by_triangle(&mut self, stage: &Stage, count: usize, mapped: &Mapped, focal_lengths: &[(f64, f64)]) -> Option<usize> {
        let used = count.min(self.points.centred_px.len());
        let steps: Vec<Step<'_>> = focal_lengths.iter().map(|focal_length| self.step(stage, used, mapped, *focal_length)).collect();
        let mut batch = std::mem::take(&mut self.batch);
        let mut all = (2..used).flat_map(|k| (1..k).flat_map(move |j| (0..j).map(move |i| [i, j, k])));
        let goes_on = all.all(|corners| self.try_at_all(&steps, &mut batch, corners));
        self.batch = batch;
        goes_on.then_some(used)
    }

    /// Tries one triangle of detections at all focal lengths. `false` = accepted or out of time, stop.
    fn try_at_all(&mut self, steps: &[Step<'_>], batch: &mut Batch, corners: [usize; 3]) -> bool {
        let [i, j, k] = corners;
        for (number, Step { rays, .. }) in steps.iter().enumerate() {
            let side = |a: usize, b: usize| (rays[a][0] - rays[b][0]).norm();
            if !self.try_triangle(steps, number, batch, corners, [side(j, k), side(i, k), side(i, j)]) {
                return false;
            }
        }
        self.flush(steps, batch)
    }

    /// A stage at a focal length, for triangles of the first `used` detections.
    fn step<'b>(&self, stage: &Stage, used: usize, (ideal, map): &'b Mapped, (focal_px, half_step): (f64, f64)) -> Step<'b>
    where
        'a: 'b,
    {
        let points = self.points;
        let context = Context {
            kappa: stage.kappa,
            ratio_tolerance: stage.ratio_tolerance,
            judges: stage.judges(),
            looks_first: stage.by_triangle,
            level: self.index.level_for(self.width_rad(focal_px), stage.coarser),
            ideal,
            map,
            limits: Limits::new(points, stage.kappa, map),
            projection: self.projection,
            focal_px,
            half_step,
            // The angle from the middle to the corner at the shortest focal length of the step and with distortion.
            corner_rad: match self.options.near {
                Some(_) => {
                    self.projection.angle_rad(1.15 * points.reach_px * (1.0 - stage.kappa.min(0.0)) / (focal_px * (1.0 - half_step)))
                }
                None => std::f64::consts::PI,
            },
        };
        let cos_near = self.options.near.map(|near| near.cos_reach(context.corner_rad));
        // What lies beyond the image of a fisheye forms no triangle.
        let ray = |at: [f64; 2], focal_px: f64| self.projection.ray(at, focal_px).unwrap_or(Vector3::from_element(f64::NAN));
        let rays = ideal[..used].iter().map(|at| [ray(*at, focal_px), ray(*at, focal_px * (1.0 + LONGER))]).collect();
        Step { context, rays, cos_near }
    }

    /// Tries all triangles of the brightest detections, except those of the `done` brightest; the answer is that of [`Self::try_focal_length`].
    fn try_brightest(&mut self, step: &Step<'_>, batch: &mut Batch, done: usize) -> Option<usize> {
        let (rays, used, most) = (&step.rays, step.rays.len(), step.context.level.longest_range()[1]);
        let mut sides = vec![0.0; used * used];
        for i in 0..used {
            for j in 0..i {
                let side = (rays[i][0] - rays[j][0]).norm();
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
                    // Those that wait are of this focal length alone.
                    batch.clear();
                    return Some(k);
                }
                for i in 0..j {
                    let sides = [jk, sides[i * used + k], sides[i * used + j]];
                    if !self.try_triangle(std::slice::from_ref(step), 0, batch, [i, j, k], sides) {
                        return None;
                    }
                }
            }
        }
        self.flush(std::slice::from_ref(step), batch).then_some(used)
    }

    /// Tries triangles drawn at random; the answer is that of [`Self::try_focal_length`].
    fn try_drawn(&mut self, step: &Step<'_>, batch: &mut Batch, wanted: usize) -> Option<usize> {
        let (rays, used, most) = (&step.rays, step.rays.len(), step.context.level.longest_range()[1]);
        // Other draws than those of the other stages.
        let mut rng = Pcg64Mcg::seed_from_u64((wanted as u64) << 32 | used as u64);
        let (mut tried, mut draws) = (0, 0);
        // Narrow fields have more catalogue triangles for each of the image.
        let enough = self.most.min(self.tally.hypotheses + 12 * wanted as u64);
        while tried < wanted && draws < 8 * wanted && self.tally.hypotheses < enough {
            draws += 1;
            let mut draw = || rng.random_range(0..used);
            let corners = [draw(), draw(), draw()];
            let chord2 = |a: usize, b: usize| (rays[corners[a]][0] - rays[corners[b]][0]).norm_squared();
            let [a, b, c] = [chord2(1, 2), chord2(0, 2), chord2(0, 1)];
            if a > most * most || b > most * most || c > most * most {
                continue;
            }
            let sides = [a.sqrt(), b.sqrt(), c.sqrt()];
            tried += usize::from(step.context.usable(sides).is_some());
            if !self.try_triangle(std::slice::from_ref(step), 0, batch, corners, sides) {
                return None;
            }
        }
        self.tally.was_cut |= tried < wanted && self.tally.hypotheses >= self.most;
        self.flush(std::slice::from_ref(step), batch).then_some(0)
    }

    fn out_of_time(&self) -> bool {
        self.deadline.is_some_and(|(deadline, _)| Instant::now() >= deadline)
    }

    /// Tries one triangle of detections at one of the focal lengths, by and by. `false` = accepted or out of time, stop.
    fn try_triangle(&mut self, steps: &[Step<'_>], number: usize, batch: &mut Batch, corners: [usize; 3], sides: [f64; 3]) -> bool {
        let Step { context, rays, .. } = &steps[number];
        let Some(shape) = context.usable(sides) else { return true };
        let [longest, middle, shortest] = shape.order;
        let trial = Trial::new(context, number, &shape, [corners[longest], corners[middle], corners[shortest]], rays);
        let Some(window) = context.level.window(&shape, trial.log_tolerance(context), context.ratio_tolerance) else { return true };
        batch.trials.push(trial);
        batch.windows.push(window);
        batch.windows.len() < BATCH || self.flush(steps, batch)
    }

    /// Tries the triangles that wait. `false` = accepted or out of time, stop.
    fn flush(&mut self, steps: &[Step<'_>], batch: &mut Batch) -> bool {
        if self.out_of_time() {
            return false;
        }
        let Batch { trials, windows, ranges, found, candidates } = batch;
        let context = |window: u32| &steps[trials[window as usize].step].context;
        found.clear();
        // Those of one level together.
        let mut first = 0;
        while first < windows.len() {
            let level = context(first as u32).level;
            let rest = first as u32..windows.len() as u32;
            let end = rest.clone().find(|window| !std::ptr::eq(context(*window).level, level)).unwrap_or(rest.end) as usize;
            level.look_up(windows, first..end, ranges, found);
            first = end;
        }
        candidates.clear();
        candidates.extend(found.iter().map(|(window, triangle)| (*window, context(*window).level.triangle(*triangle))));
        if let Some(near) = self.options.near {
            let towards = Vector3::from(near.boresight.xyz);
            candidates.retain(|(window, [star, ..])| {
                let Step { context, cos_near, .. } = &steps[trials[*window as usize].step];
                cos_near.is_none_or(|least| context.level.direction(*star).dot(&towards) >= least)
            });
        }
        let touched = |(window, stars): &(u32, [u32; 3])| context(*window).level.touch(*stars, trials[*window as usize].central);
        std::hint::black_box(candidates.iter().map(touched).sum::<f32>());
        let mut of: Vec<(&Context<'_>, &Trial, [u32; 3])> = Vec::with_capacity(BLOCK);
        let goes_on = candidates.chunks(BLOCK).all(|block| {
            of.clear();
            of.extend(block.iter().map(|(window, triangle)| (context(*window), &trials[*window as usize], *triangle)));
            let passing = if self.projection == Projection::Pinhole { check_out(&of) } else { u32::MAX };
            of.iter()
                .enumerate()
                .all(|(number, (context, trial, triangle))| self.try_candidate(context, trial, *triangle, passing >> number & 1 == 1))
        });
        batch.clear();
        goes_on
    }

    /// Tries one pair of triangles, of which single precision has said whether it may be right. `false` = accepted or out of time, stop.
    fn try_candidate(&mut self, context: &Context<'_>, trial: &Trial, triangle: [u32; 3], may_check_out: bool) -> bool {
        self.tally.hypotheses += 1;
        if self.tally.hypotheses.is_multiple_of(BETWEEN_LOOKS) && self.out_of_time() {
            return false;
        }
        if !may_check_out {
            return true;
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
        let ln_enough = false_match::ln_below(self.options.max_false_match_probability, tried);
        let first_look = || refine::first_look(&pose, self.points, (self.index, self.apparent), judges, ln_enough);
        let refined = || {
            let near = self.index.brightest_near(&pose, self.points, 5 * self.points.centred_px.len().clamp(8, judges));
            refine::refine(&pose, self.points, self.apparent, &near, judges, ln_enough)
        };
        let supported = context.looks_first.then(first_look).flatten().or_else(refined);
        let Some(Supported { pose, ln_best, ln_probability, judges }) = supported else { return true };
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

//! Exposures of a scene: listed ones are stored, those of a series are computed on demand.

use std::sync::{Arc, Mutex, PoisonError};

use hifitime::{Epoch, Unit};
use nalgebra::UnitQuaternion;
use rand::SeedableRng;
use rand_pcg::Pcg64;

use super::motion::{Course, Motion};
use super::pointing::{self, Plan};
use super::{Exposure, JitterTable, SceneError, SceneFile, SeriesTable, effects, orbit};
use crate::camera::{GroundSite, Orbit, Physics, SkyChain, Term, observation};
use crate::effects::Observation;
use crate::recording::{FrameEntry, Mount, Offsets, Recording};

/// The exposures of a scene in order of time. A series of a million takes no more memory than one of a single exposure.
#[derive(Clone, Debug)]
pub struct Exposures(Source);

#[derive(Clone, Debug)]
enum Source {
    Listed(Arc<[Arc<Exposure>]>),
    Series(Arc<Series>),
}

/// What makes an exposure of a plan, the same for all.
#[derive(Clone, Debug)]
pub(super) struct Making {
    pub(super) path: String,
    pub(super) seed: u64,
    pub(super) first_frame: u32,
    pub(super) physics: Physics,
    pub(super) terms: Vec<Term>,
    pub(super) jitter: Option<JitterTable>,
    /// Site and camera as a recording has them, without frames.
    pub(super) recording: Recording,
}

impl Making {
    fn entry(number: usize, plan: &Plan) -> FrameEntry {
        FrameEntry { number, time_utc: plan.time, exposure_s: Some(plan.exposure_s), ..plan.telemetry.entry() }
    }

    /// The exposure with the physics in force. Its circumstances are those that a recording with this telemetry tells.
    fn exposure(&self, number: usize, plan: Plan, observation: &Observation) -> Result<Exposure, SceneError> {
        let wrong = |source| SceneError::Physics { path: self.path.clone(), source };
        let known = SkyChain::new(&self.physics, *observation).map_err(wrong)?;
        let sky = effects::on_the_sky(&known, &self.terms);
        let Plan { time, exposure_s, attitude: course, telemetry, .. } = plan;
        let motion = Motion::new(plan.course, self.jitter.as_ref(), self.seed, self.first_frame.wrapping_add(number as u32), exposure_s);
        Ok(Exposure { time, exposure_s, attitude: motion.attitude(&course, 0.0), course, motion, sky, telemetry })
    }
}

/// A series, and how far its pointings have been drawn.
#[derive(Debug)]
struct Series {
    making: Making,
    table: SeriesTable,
    start: Option<Epoch>,
    site: Option<GroundSite>,
    orbit: Option<Orbit>,
    /// With a mount that is fixed to the ground, how the camera stands on it.
    camera_from_earth: Option<UnitQuaternion<f64>>,
    /// Mean of the times from the first, h.
    mean_time_h: Option<f64>,
    first: Arc<Exposure>,
    drawn: Mutex<Drawn>,
}

/// Pointings are drawn one after the other.
#[derive(Debug)]
struct Drawn {
    next: usize,
    chance: Pcg64,
    recent: (usize, Arc<Exposure>),
}

const SECONDS_PER_HOUR: f64 = 3600.0;

impl Exposures {
    /// The exposures of a scene file.
    pub(super) fn new(file: &SceneFile, making: Making) -> Result<Self, SceneError> {
        Ok(Self(match &file.series {
            Some(series) => Source::Series(Arc::new(Series::new(file, series, making)?)),
            None => Source::Listed(listed(file, &making)?),
        }))
    }

    /// How many there are.
    #[must_use]
    #[allow(clippy::len_without_is_empty, reason = "a scene has at least one exposure")]
    pub fn len(&self) -> usize {
        match &self.0 {
            Source::Listed(all) => all.len(),
            Source::Series(series) => series.table.count,
        }
    }

    /// Exposure number `index`.
    ///
    /// # Panics
    /// If `index` is not below the number of exposures.
    #[must_use]
    pub fn get(&self, index: usize) -> Arc<Exposure> {
        assert!(index < self.len(), "there are {} exposures, none has the number {index}", self.len());
        match &self.0 {
            Source::Listed(all) => Arc::clone(&all[index]),
            Source::Series(series) => series.get(index),
        }
    }

    /// All of them, one after the other.
    #[must_use]
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Arc<Exposure>> {
        (0..self.len()).map(|index| self.get(index))
    }

    /// Those of which each may know something else than the others: of a series one stands for all.
    pub(super) fn kinds(&self) -> impl ExactSizeIterator<Item = Arc<Exposure>> {
        let count = if matches!(self.0, Source::Series(_)) { 1 } else { self.len() };
        (0..count).map(|index| self.get(index))
    }
}

/// The exposures of a list.
fn listed(file: &SceneFile, making: &Making) -> Result<Arc<[Arc<Exposure>]>, SceneError> {
    let path = &making.path;
    let site = file.site.as_ref().map(super::SiteTable::ground_site);
    let circumstances = |time: Option<Epoch>, velocity| -> Result<Observation, SceneError> {
        observation(time, site.as_ref(), velocity).map_err(|source| SceneError::Time { path: path.clone(), source })
    };
    let mut plans = pointing::listed(path, file)?;
    if is_fixed(file) {
        let mut camera_from_earth = None;
        for plan in &mut plans {
            pointing::stand_fast(path, plan, &circumstances(plan.time, None)?, &mut camera_from_earth)?;
        }
    }
    if let Some(orbit) = orbit::of(path, file)? {
        let mut seen = orbit::Seen::default();
        for (number, plan) in plans.iter_mut().enumerate() {
            let of_earth = circumstances(plan.time, None)?.velocity_km_s.unwrap_or_default();
            plan.telemetry.velocity_km_s = Some(orbit::velocity_km_s(path, &orbit, number, plan.time, of_earth)?);
            seen.look(path, &orbit, number, plan)?;
        }
        seen.tell(path, file, plans.len());
    }
    let frames = plans.iter().enumerate().map(|(number, plan)| Making::entry(number, plan)).collect();
    let recording = Recording { frames, ..making.recording.clone() };
    let observations = recording.observations().map_err(|(_, source)| SceneError::Time { path: path.clone(), source })?;
    let exposure = |(number, (plan, known)): (usize, (Plan, &Observation))| {
        let observation = file.frames.get(number).map_or(*known, |frame| frame.under_its_zenith(known));
        making.exposure(number, plan, &observation).map(Arc::new)
    };
    plans.into_iter().zip(&observations).enumerate().map(exposure).collect()
}

fn is_fixed(file: &SceneFile) -> bool {
    file.mount.is_some_and(|mount| mount.kind == Mount::Fixed)
}

impl Series {
    fn new(file: &SceneFile, table: &SeriesTable, making: Making) -> Result<Self, SceneError> {
        let path = making.path.clone();
        let start = table.start_utc.as_deref().map(|text| pointing::time(&path, "series.start_utc", text)).transpose()?;
        let site = file.site.as_ref().map(super::SiteTable::ground_site);
        let orbit = orbit::of(&path, file)?;
        let chance = Self::chance(making.seed);
        let nothing = Arc::new(Exposure::default());
        let drawn = Mutex::new(Drawn { next: 0, chance: chance.clone(), recent: (usize::MAX, Arc::clone(&nothing)) });
        let mut series =
            Self { making, table: table.clone(), start, site, orbit, camera_from_earth: None, mean_time_h: None, first: nothing, drawn };
        series.mean_time_h = start.map(|start| {
            let hours = |index| series.time(index).map_or(0.0, |time| (time - start).to_seconds() / SECONDS_PER_HOUR);
            (0..table.count).map(hours).sum::<f64>() / table.count as f64
        });
        // What can be wrong with one exposure is wrong with the first or, where time goes beyond what is known, with the last.
        series.circumstances(table.count - 1)?;
        if is_fixed(file) {
            let mut plan = series.draw(0, &mut chance.clone())?;
            pointing::stand_fast(&path, &mut plan, &series.circumstances(0)?, &mut series.camera_from_earth)?;
        }
        if let Some(orbit) = &series.orbit {
            let (mut chance, mut seen) = (chance.clone(), orbit::Seen::default());
            for number in 0..table.count {
                seen.look(&path, orbit, number, &series.draw(number, &mut chance)?)?;
            }
            seen.tell(&path, file, table.count);
        }
        series.first = Arc::new(series.exposure(0, &mut chance.clone())?);
        Ok(series)
    }

    /// Its own stream of random numbers: pointings do not change when the noise of the frames is drawn in another way.
    fn chance(seed: u64) -> Pcg64 {
        Pcg64::seed_from_u64(seed)
    }

    fn time(&self, index: usize) -> Option<Epoch> {
        self.start.map(|start| start + self.table.interval_s * index as f64 * Unit::Second)
    }

    fn circumstances(&self, index: usize) -> Result<Observation, SceneError> {
        let wrong = |source| SceneError::Time { path: self.making.path.clone(), source };
        observation(self.time(index), self.site.as_ref(), None).map_err(wrong)
    }

    /// The plan of the next exposure, which is number `index`.
    fn draw(&self, index: usize, chance: &mut Pcg64) -> Result<Plan, SceneError> {
        let zenith = if self.site.is_some() { self.circumstances(index)?.zenith } else { None };
        Ok(pointing::drawn(&self.table, self.time(index), zenith, chance))
    }

    /// The next exposure, which is number `index`.
    fn exposure(&self, index: usize, chance: &mut Pcg64) -> Result<Exposure, SceneError> {
        let path = &self.making.path;
        let mut plan = self.draw(index, chance)?;
        if let Some(stands) = self.camera_from_earth {
            pointing::stand_fast(path, &mut plan, &self.circumstances(index)?, &mut Some(stands))?;
        }
        if let Some(orbit) = &self.orbit {
            let of_earth = self.circumstances(index)?.velocity_km_s.unwrap_or_default();
            plan.telemetry.velocity_km_s = Some(orbit::velocity_km_s(path, orbit, index, plan.time, of_earth)?);
        }
        let count = self.table.count as f64;
        let offsets = Offsets {
            time_h: self
                .mean_time_h
                .zip(self.start)
                .zip(plan.time)
                .map(|((mean_h, start), time)| (time - start).to_seconds() / SECONDS_PER_HOUR - mean_h),
            order: Some(index as f64 - (count * (count - 1.0) / 2.0) / count),
            ..Offsets::default()
        };
        let entry = Making::entry(index, &plan);
        let wrong = |source| SceneError::Time { path: path.clone(), source };
        let observation = self.making.recording.observation_of(&entry, offsets).map_err(wrong)?;
        self.making.exposure(index, plan, &observation)
    }

    fn get(&self, index: usize) -> Arc<Exposure> {
        let mut drawn = self.drawn.lock().unwrap_or_else(PoisonError::into_inner);
        if drawn.recent.0 == index {
            return Arc::clone(&drawn.recent.1);
        }
        match self.draw_up_to(index, &mut drawn) {
            Ok(exposure) => {
                let exposure = Arc::new(exposure);
                drawn.recent = (index, Arc::clone(&exposure));
                exposure
            }
            Err(error) => {
                // Not reached: the times lie between two that were tried, and every state of an orbit was.
                tracing::error!("{error}; the first exposure is taken in the place of number {index}");
                Arc::clone(&self.first)
            }
        }
    }

    fn draw_up_to(&self, index: usize, drawn: &mut Drawn) -> Result<Exposure, SceneError> {
        if index < drawn.next {
            (drawn.next, drawn.chance) = (0, Self::chance(self.making.seed));
        }
        while drawn.next < index {
            self.draw(drawn.next, &mut drawn.chance)?;
            drawn.next += 1;
        }
        drawn.next += 1;
        self.exposure(index, &mut drawn.chance)
    }
}

impl Default for Exposure {
    fn default() -> Self {
        let attitude = crate::coordinates::Attitude::from_pointing(0.0, 0.0, 0.0);
        Self {
            time: None,
            exposure_s: 0.0,
            attitude,
            course: attitude,
            motion: Motion::new(Course::Still, None, 0, 0, 0.0),
            sky: SkyChain::default(),
            telemetry: super::ExposureTelemetry::default(),
        }
    }
}

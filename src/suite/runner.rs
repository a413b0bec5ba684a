//! Frames of a case are rendered, handed over and scored, until every requirement is decided or the frames are at an end.

use std::time::Instant;

use super::conventions::Conventions;
use super::error::SuiteError;
use super::frames::{FrameBatch, HandedFrame};
use super::metric::AnswerNeeds;
use super::own;
use super::plan::{PlannedCase, SuitePlan};
use super::result::SpentSeconds;
use super::samples::CaseScores;
use super::score::{CameraScore, Judging, scored};
use super::system::ForeignSystem;
use crate::camera::Camera;
use crate::catalog::Catalog;
use crate::render::PsfTables;

/// Frames are rendered and handed over in pieces of about so many, so that memory does not grow with their number.
const PIECE: usize = 48;

/// What runs the cases of a suite.
pub(super) struct Runner<'a> {
    pub(super) plan: &'a SuitePlan,
    pub(super) catalog: &'a Catalog,
    foreign: Option<ForeignSystem<'a>>,
    tables: PsfTables,
}

/// What was seen at a value of a sweep.
#[derive(Default)]
pub(super) struct CaseRun {
    pub(super) scores: CaseScores,
    pub(super) seconds: SpentSeconds,
    /// The true camera of the last frames.
    pub(super) camera: Option<Camera>,
}

impl<'a> Runner<'a> {
    pub(super) fn new(plan: &'a SuitePlan, catalog: &'a Catalog) -> Self {
        let foreign = plan.file.system.as_ref().map(ForeignSystem::new);
        Self { plan, catalog, foreign, tables: PsfTables::default() }
    }

    /// Adds the frames from the number that `run` has to `upto`; `done` is told how many were added.
    pub(super) fn extend(
        &mut self,
        case: &PlannedCase,
        value: usize,
        run: &mut CaseRun,
        upto: usize,
        done: &dyn Fn(usize),
    ) -> Result<(), SuiteError> {
        run.scores.hidden.clone_from(&case.hidden);
        // Nights of the own pipeline are not cut, nor are fields of a design.
        let whole = if self.foreign.is_none() { case.night_frames } else { 1 };
        let piece = PIECE.div_ceil(whole) * whole;
        let mut from = run.scores.frames.len();
        while from < upto {
            let to = (from + piece).min(upto);
            for batch in case.batches(value, from..to)? {
                self.batch(case, &batch, run)?;
            }
            done(to - from);
            from = to;
        }
        Ok(())
    }

    /// Renders frames, hands them over and scores the answers.
    pub(super) fn batch(&mut self, case: &PlannedCase, batch: &FrameBatch, run: &mut CaseRun) -> Result<(), SuiteError> {
        let begin = Instant::now();
        let frames = batch.render(&case.name, self.catalog, &self.tables)?;
        let rendered = Instant::now();
        run.seconds.rendering += (rendered - begin).as_secs_f64();
        let answers = match &mut self.foreign {
            Some(foreign) => foreign.answers(batch, &frames)?,
            None => self.own(case, batch, &frames, run)?,
        };
        let answered = Instant::now();
        run.seconds.answering += (answered - rendered).as_secs_f64();
        let camera = batch.scene.camera;
        let judging = Judging {
            conventions: &self.plan.conventions,
            within_rad: case.within_rad,
            about_within_rad: case.about_within_rad,
            size_px: [camera.width_px, camera.height_px],
        };
        let is_own = self.foreign.is_none();
        for (frame, answer) in frames.iter().zip(answers) {
            if let Some(own) = &answer.answer.camera {
                run.scores.cameras.push(CameraScore::of(&in_our_pixels(own, &self.plan.conventions, is_own), &camera));
            }
            run.scores.frames.push(scored(frame, answer, &judging));
        }
        run.camera = Some(camera);
        run.seconds.scoring += answered.elapsed().as_secs_f64();
        Ok(())
    }

    /// The answers of boresight, a night at a time.
    fn own(
        &self,
        case: &PlannedCase,
        batch: &FrameBatch,
        frames: &[HandedFrame],
        run: &mut CaseRun,
    ) -> Result<Vec<super::system::ObservedAnswer>, SuiteError> {
        let calibrates = case.requirements.iter().any(|requirement| requirement.metric.needs == AnswerNeeds::Camera);
        let mut all = Vec::with_capacity(frames.len());
        for night in frames.chunks(case.night_frames) {
            // What is left at the end is no whole night: it is neither calibrated nor diagnosed.
            let is_whole = night.len() == case.night_frames;
            let mut table = self.plan.file.own.clone();
            table.diagnose &= is_whole;
            let answers = own::answers(&case.name, &table, (batch, night), self.catalog, calibrates && is_whole)?;
            all.extend(answers.frames);
            run.scores.nights.extend(answers.night);
        }
        Ok(all)
    }
}

/// A principal point counts pixels as centroids do.
fn in_our_pixels(camera: &super::answers::AnsweredCamera, conventions: &Conventions, is_own: bool) -> super::answers::AnsweredCamera {
    let mut camera = *camera;
    if let (super::conventions::PixelOrigin::At(first), Some(point), false) =
        (conventions.pixel_origin, &mut camera.principal_point_px, is_own)
    {
        *point = point.map(|own| own - first);
    }
    camera
}

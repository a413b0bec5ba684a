//! The frames of a case: scenes of its attitudes, rendered with their truth.

use std::ops::Range;

use hifitime::Epoch;
use toml::{Table, Value};

use super::attitudes::DesignPlace;
use super::error::SuiteError;
use super::plan::{CaseFrames, PlannedCase};
use super::scene_tables::{put, series_time, templates, with_frames, zenith};
use super::suite_file::AttitudeKind;
use crate::catalog::Catalog;
use crate::coordinates::Attitude;
use crate::dataset::{DatasetSplit, FrameKey};
use crate::parallel;
use crate::render::{Backend, PsfTables, Renderer, TrueStar};
use crate::scene::Scene;

/// What is true of a frame.
#[derive(Clone, Debug)]
pub(super) struct TestedTruth {
    /// The attitude at the middle of the exposure.
    pub attitude: Attitude,
    /// Velocity of the camera, barycentric, ICRS axes.
    pub velocity_km_s: Option<[f64; 3]>,
    /// Middle of the exposure.
    pub time: Option<Epoch>,
    /// Its length.
    pub exposure_s: f64,
    /// The stars, brightest first.
    pub stars: Vec<TrueStar>,
}

/// A frame as it is handed over.
#[derive(Clone, Debug)]
pub(super) struct HandedFrame {
    /// Its number in the case.
    pub number: usize,
    /// Its place in the design.
    pub place: DesignPlace,
    /// Its number in its scene.
    pub in_scene: usize,
    /// What is true of it.
    pub truth: TestedTruth,
    /// Counts, row by row, the first row on top.
    pub pixels_dn: Vec<u16>,
}

/// Frames of one scene.
#[derive(Debug)]
pub(super) struct FrameBatch {
    /// The scene.
    pub scene: Scene,
    /// Number in the scene, number in the case, place in the design.
    pub frames: Vec<(usize, usize, DesignPlace)>,
}

impl FrameBatch {
    /// Renders the frames.
    pub(super) fn render(&self, case: &str, catalog: &Catalog, tables: &PsfTables) -> Result<Vec<HandedFrame>, SuiteError> {
        let wrong = |source| SuiteError::Imaging { case: case.to_owned(), source: Box::new(source) };
        let renderer = Renderer::with_tables(&self.scene, catalog, Backend::Cpu, tables).map_err(wrong)?.with_pixel_shifts(false);
        let one = |&(in_scene, number, place): &(usize, usize, DesignPlace)| {
            let rendered = renderer.render(in_scene).map_err(wrong)?;
            let exposure = self.scene.exposures.get(in_scene);
            let truth = TestedTruth {
                attitude: exposure.attitude,
                velocity_km_s: exposure.sky.observation().velocity_km_s,
                time: exposure.time,
                exposure_s: exposure.exposure_s,
                stars: rendered.stars,
            };
            Ok(HandedFrame { number, place, in_scene, truth, pixels_dn: rendered.pixels_dn })
        };
        parallel::try_map(&self.frames, one)
    }
}

impl PlannedCase {
    /// The tables of the scene at a value of the sweep, with the seed of the suite.
    pub(super) fn tables(&self, value: usize) -> Result<Option<Table>, String> {
        let CaseFrames::Scene { tables, .. } = &self.frames_of else { return Ok(None) };
        let mut tables = (**tables).clone();
        if let Some(sweep) = &self.sweep {
            put(&sweep.path, &mut tables, &sweep.values[value])?;
        }
        tables.insert("seed".to_owned(), Value::Integer(self.attitudes.noise_seed()));
        Ok(Some(tables))
    }

    /// The text of the scene of frames at a value of the sweep; of a recipe, none.
    pub(super) fn scene_text(&self, value: usize, range: Range<usize>) -> Result<Option<String>, String> {
        Ok(self.tables(value)?.map(|tables| self.scene_of(&tables, range).0))
    }

    /// The scene of frames with their places.
    pub(super) fn scene_of(&self, tables: &Table, range: Range<usize>) -> (String, Vec<(usize, usize, DesignPlace)>) {
        if self.attitudes.table.kind == AttitudeKind::Scene {
            let frames = range.map(|number| (number, number, DesignPlace::alone(number))).collect();
            return (with_frames(tables, &[], true), frames);
        }
        let all = templates(tables);
        let made = range.enumerate().map(|(in_scene, number)| {
            let template = all.get(number % all.len().max(1));
            let of_template = template.and_then(|frame| frame.get("time_utc")).and_then(Value::as_str).map(str::to_owned);
            let time = series_time(tables, number).or(of_template);
            let (attitude, place) = self.attitudes.frame(number, zenith(tables, time.as_deref()));
            ((attitude, number), (in_scene, number, place))
        });
        let (attitudes, places): (Vec<_>, Vec<_>) = made.unzip();
        (with_frames(tables, &attitudes, false), places)
    }

    /// The frames of a range as scenes: one, or of a recipe one each.
    pub(super) fn batches(&self, value: usize, range: Range<usize>) -> Result<Vec<FrameBatch>, SuiteError> {
        match &self.frames_of {
            CaseFrames::Scene { path, .. } => {
                let wrong = |message| SuiteError::Parse { path: path.clone(), message };
                let tables = self.tables(value).map_err(wrong)?.unwrap_or_default();
                Ok(vec![self.batch_of(&tables, range)?])
            }
            CaseFrames::Dataset(plan) => {
                let one = |number: usize| {
                    let wrong = |source| SuiteError::Dataset { case: self.name.clone(), source: Box::new(source) };
                    let key = FrameKey { split: DatasetSplit::Test, index: number as u64 };
                    let scene = plan.frame_scene(key).and_then(|frame| plan.scene_of(&frame)).map_err(wrong)?;
                    Ok(FrameBatch { scene, frames: vec![(0, number, DesignPlace::alone(number))] })
                };
                range.map(one).collect()
            }
        }
    }

    /// The frames of a range of a scene whose tables may have been changed.
    pub(super) fn batch_of(&self, tables: &Table, range: Range<usize>) -> Result<FrameBatch, SuiteError> {
        let CaseFrames::Scene { path, .. } = &self.frames_of else {
            return Err(SuiteError::Parse { path: self.name.clone(), message: "a recipe has no tables of a scene".to_owned() });
        };
        let (text, frames) = self.scene_of(tables, range);
        let scene = Scene::parse(path, &text).map_err(|source| SuiteError::Scene { case: self.name.clone(), source: Box::new(source) })?;
        let frames = frames.into_iter().filter(|(in_scene, ..)| *in_scene < scene.exposures.len()).collect();
        Ok(FrameBatch { scene, frames })
    }

    /// How many frames there are at most: of a scene's own exposures and of a recipe, not more than they have.
    pub(super) fn frames_there_are(&self, value: usize) -> Result<usize, SuiteError> {
        match &self.frames_of {
            CaseFrames::Dataset(plan) => Ok(plan.recipe.size.frames.of(DatasetSplit::Test) as usize),
            CaseFrames::Scene { path, .. } if self.attitudes.table.kind == AttitudeKind::Scene => {
                let wrong = |message| SuiteError::Parse { path: path.clone(), message };
                let text = self.scene_text(value, 0..1).map_err(wrong)?.unwrap_or_default();
                let scene =
                    Scene::parse(path, &text).map_err(|source| SuiteError::Scene { case: self.name.clone(), source: Box::new(source) })?;
                Ok(scene.exposures.len())
            }
            CaseFrames::Scene { .. } => Ok(usize::MAX),
        }
    }
}

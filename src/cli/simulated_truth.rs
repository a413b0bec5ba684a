//! The truth of a simulated recording, beside its frames.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use boresight::effects::displacement;
use boresight::provenance::Provenance;
use boresight::recording::ImageFileForm;
use boresight::render::{MaskFlag, SimulatedTruth, TRUTH_FORMAT, TrueFrame, TruthEffect};
use boresight::scene::{EffectSetting, Exposure, PsfTable, Scene};
use serde::Serialize;

use super::simulate::TruthArgs;

/// The scene within the folder of the truth, as it was given.
pub(super) const SCENE_FILE: &str = "scene.toml";

/// What a recording of a scene does not tell. `psf` is the image of a star where the scene has no table of it.
pub(super) fn simulated_truth<'a>(frames: TrueFrames<'a>, provenance: &'a Provenance) -> SimulatedTruth<'a, TrueFrames<'a>> {
    let (scene, wanted) = (frames.scene, frames.wanted);
    SimulatedTruth {
        format: TRUTH_FORMAT,
        camera: &scene.camera,
        projection: scene.model.projection(),
        projection_parameters: by_name(scene.model.projection(), scene.model.projection_parameters()),
        nominal: &scene.nominal,
        detector: &scene.detector,
        binning: scene.binning,
        psf: scene.psf_table.clone().unwrap_or_else(|| PsfTable::gaussian(scene.detector.psf_sigma_px)),
        pixel_effects: scene.pixel_effects.iter().map(pixel_effect).collect(),
        sky_lights: scene.glows().map(|(id, parameters)| TruthEffect { id: id.to_owned(), parameters }).collect(),
        sky: &scene.sky,
        site: scene.site.as_ref(),
        frames,
        mask_flags: wanted.masks.then_some(MaskFlag::ALL),
        provenance,
    }
}

/// The frames as they are written, one after the other.
pub(super) struct TrueFrames<'a> {
    pub(super) scene: &'a Scene,
    pub(super) wanted: TruthArgs,
    pub(super) form: ImageFileForm,
    /// Which exposures of the scene.
    pub(super) numbers: Range<usize>,
}

impl Serialize for TrueFrames<'_> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let of = |index: usize| true_frame(index, self, &self.scene.exposures.get(index));
        serializer.collect_seq(self.numbers.clone().map(of))
    }
}

/// An effect's parameters by name.
fn by_name(id: &str, values: &[f64]) -> BTreeMap<String, f64> {
    let Some(effect) = displacement(id) else { return BTreeMap::new() };
    effect.parameters().iter().map(|spec| spec.name.to_owned()).zip(values.iter().copied()).collect()
}

/// An effect on pixels as it works.
fn pixel_effect(setting: &EffectSetting) -> TruthEffect {
    TruthEffect { id: setting.id.clone(), parameters: setting.parameters.iter().cloned().collect() }
}

/// A table that grows with the frames, in a folder in the making.
pub(super) struct Rows {
    path: PathBuf,
    table: csv::Writer<File>,
    is_empty: bool,
}

impl Rows {
    pub(super) fn new(path: PathBuf) -> Result<Self> {
        let table = csv::Writer::from_path(&path).with_context(|| format!("writing {}", path.display()))?;
        Ok(Self { path, table, is_empty: true })
    }

    pub(super) fn add(&mut self, rows: &[impl Serialize]) -> Result<()> {
        for row in rows {
            self.is_empty = false;
            self.table.serialize(row).with_context(|| format!("writing {}", self.path.display()))?;
        }
        Ok(())
    }

    /// Ends the table; one without rows stays only if it `stays_empty`.
    pub(super) fn finish(mut self, stays_empty: bool) -> Result<()> {
        self.table.flush().with_context(|| format!("writing {}", self.path.display()))?;
        if self.is_empty && !stays_empty {
            std::fs::remove_file(&self.path).with_context(|| format!("removing {}", self.path.display()))?;
        }
        Ok(())
    }
}

/// Writes an object piece by piece into a folder in the making.
pub(super) fn write_json(path: &Path, object: &impl Serialize) -> Result<()> {
    let context = || format!("writing {}", path.display());
    let mut file = BufWriter::new(File::create(path).with_context(context)?);
    serde_json::to_writer_pretty(&mut file, object).with_context(context)?;
    file.write_all(b"\n").and_then(|()| file.flush()).with_context(context)
}

/// Where in a recording a frame is.
pub(super) fn frame_file(frame: usize, form: ImageFileForm) -> String {
    format!("frames/{frame:04}.{}", form.ending())
}

/// Where in truth/ a frame's expected electrons are.
pub(super) fn clean_file(frame: usize) -> String {
    format!("clean/{frame:04}.fits")
}

/// Where in truth/ a frame's mask is.
pub(super) fn mask_file(frame: usize) -> String {
    format!("masks/{frame:04}.fits")
}

fn true_frame(frame: usize, of: &TrueFrames<'_>, exposure: &Exposure) -> TrueFrame {
    let TrueFrames { scene, wanted, form, .. } = of;
    let term = |(id, parameters): (&'static str, &[f64])| TruthEffect { id: id.to_owned(), parameters: by_name(id, parameters) };
    let turned = |seconds: f64| exposure.motion.attitude(&exposure.course, seconds);
    TrueFrame {
        frame,
        file: frame_file(frame, *form),
        clean_file: wanted.clean.then(|| clean_file(frame)),
        mask_file: wanted.masks.then(|| mask_file(frame)),
        time_utc: exposure.time.map(|time| time.to_isoformat() + "Z"),
        exposure_s: exposure.exposure_s,
        effects: exposure.sky.effects().into_iter().chain(scene.model.terms()).map(term).collect(),
        camera_from_icrs_start: turned(-0.5 * exposure.exposure_s),
        camera_from_icrs_mid: turned(0.0),
        camera_from_icrs_end: turned(0.5 * exposure.exposure_s),
        velocity_km_s: exposure.sky.observation().velocity_km_s,
        zenith_icrs: exposure.sky.observation().zenith,
    }
}

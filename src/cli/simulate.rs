//! `boresight simulate`: renders a scene into a recording, with its truth beside it.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use boresight::catalog::Catalog;
use boresight::effects::displacement;
use boresight::provenance::{Provenance, word};
use boresight::recording::{
    FitsHeaders, FrameEntry, OutputDirectory, Recording, write_file, write_fits_f32, write_fits_u8, write_fits_u16, write_manifest_of,
};
use boresight::render::{
    MaskFlag, Rendered, Renderer, SIMULATE_FORMAT, SimulateResult, SimulatedTruth, TRUTH_FORMAT, TrueFrame, TruthEffect,
};
use boresight::scene::{Exposure, Scene, declared_frames, declared_recording};
use clap::{Args, ValueEnum};
use serde::Serialize;

use super::options::{BackendChoice, SceneArgs, heading};
use super::{Answer, output};

/// How photons are counted. There is no rougher way beside the exact one: it would save a fifth of a frame's time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum NoiseChoice {
    /// Poisson numbers at every brightness
    Exact,
}

/// Arguments of `simulate`.
#[derive(Debug, Args)]
#[command(next_help_heading = heading::OUTPUT)]
pub(crate) struct SimulateArgs {
    /// The scene
    #[arg(value_name = "SCENE.toml", help_heading = None)]
    scene: PathBuf,
    #[command(flatten)]
    options: SceneArgs,
    /// The folder that becomes the recording
    #[arg(short, long, value_name = "DIR", value_parser = super::options::folder())]
    output: PathBuf,
    /// How photons are counted
    #[arg(long, value_enum, default_value_t = NoiseChoice::Exact, help_heading = heading::RENDERING)]
    noise: NoiseChoice,
    #[command(flatten)]
    truth: TruthArgs,
    /// Replace a folder that an earlier run wrote
    #[arg(long)]
    force: bool,
    /// Print the result as one JSON object on stdout, and nothing else
    #[arg(long)]
    json: bool,
}

/// What is told of a simulated recording beside its frames.
#[derive(Clone, Copy, Debug, Default, Args)]
#[command(next_help_heading = heading::OUTPUT)]
pub(crate) struct TruthArgs {
    /// Also write each frame's expected electrons, without noise, before charge is moved or read: truth/clean/, FITS of real numbers
    #[arg(long)]
    clean: bool,
    /// Also write which pixels are hot, dead, full or lit by trails, ghosts and particles: truth/masks/, FITS; truth.json has the flags
    #[arg(long)]
    masks: bool,
    /// Leave out what pixel effects add to each star (x_pixels_px, y_pixels_px, flux_pixels_ratio), which costs up to three frames without
    /// noise on the CPU for each frame where such effects are on
    #[arg(long)]
    no_pixel_shifts: bool,
}

/// The frames as they are written, one after the other.
struct TrueFrames<'a> {
    scene: &'a Scene,
    wanted: TruthArgs,
}

impl Serialize for TrueFrames<'_> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let of = |(index, exposure): (usize, Arc<Exposure>)| true_frame(index, self.scene, &exposure, self.wanted);
        serializer.collect_seq(self.scene.exposures.iter().enumerate().map(of))
    }
}

/// An effect's parameters by name.
fn by_name(id: &str, values: &[f64]) -> BTreeMap<&'static str, f64> {
    let Some(effect) = displacement(id) else { return BTreeMap::new() };
    effect.parameters().iter().map(|spec| spec.name).zip(values.iter().copied()).collect()
}

/// Renders, and says what was written.
pub(crate) fn simulate(args: &SimulateArgs) -> Result<Answer> {
    let NoiseChoice::Exact = args.noise;
    let (scene, mut provenance) = args.options.open(&args.scene)?;
    let catalog = args.options.catalog(&mut provenance)?;
    let object = write_recording(&scene, &catalog, args.options.backend, args.truth, &args.output, args.force, provenance)?;
    if args.json {
        output::print(&output::json_text(&object)?)?;
    } else {
        output::print(&format!(
            "{}: {} frames, {} star images, rendered on {}; the truth is in {}\n",
            object.recording.display(),
            object.frames,
            object.stars,
            object.provenance.adapter.as_deref().unwrap_or("the CPU"),
            object.truth.display()
        ))?;
    }
    Ok(Answer::Yes)
}

/// Renders a scene into a folder: recording.toml, frames/, truth/ and simulate.json, all of it or nothing.
pub(crate) fn write_recording(
    scene: &Scene,
    catalog: &Catalog,
    backend: BackendChoice,
    wanted: TruthArgs,
    target: &Path,
    force: bool,
    mut provenance: Provenance,
) -> Result<SimulateResult> {
    let directory = OutputDirectory::create(target, force)?;
    let renderer = Renderer::new(scene, catalog, backend.into())?
        .with_clean(wanted.clean)
        .with_masks(wanted.masks)
        .with_pixel_shifts(!wanted.no_pixel_shifts);
    provenance.adapter = Some(renderer.adapter());
    let recording = declared_recording(scene);
    tracing::info!(
        "{} frames of {} × {} px to render on {}",
        scene.exposures.len(),
        scene.camera.width_px,
        scene.camera.height_px,
        renderer.adapter()
    );
    let (bar, clock) = (output::progress("rendering", scene.exposures.len()), output::Clock::new());
    let folder = directory.path().join("truth");
    std::fs::create_dir_all(&folder).with_context(|| format!("creating {}", folder.display()))?;
    let (mut truth, mut lights) = (Rows::new(folder.join("stars.csv"))?, Rows::new(folder.join("lights.csv"))?);
    let mut stars = 0;
    for (index, entry) in declared_frames(scene, "fits").enumerate() {
        let frame = renderer.render(index)?;
        write_frame(directory.path(), scene, &recording, (index, &entry), &frame)?;
        stars += frame.stars.len();
        tracing::debug!("frame {index}: {} stars, {} other lights, after {clock}", frame.stars.len(), frame.lights.len());
        truth.add(&frame.stars)?;
        lights.add(&frame.lights)?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    tracing::info!("rendered in {clock}: {stars} star images");
    write_manifest_of(directory.path(), &recording, declared_frames(scene, "fits"))?;
    truth.finish(true)?;
    lights.finish(false)?;
    let object = SimulatedTruth {
        format: TRUTH_FORMAT,
        camera: &scene.camera,
        projection: scene.model.projection(),
        projection_parameters: by_name(scene.model.projection(), scene.model.projection_parameters()),
        nominal: &scene.nominal,
        detector: &scene.detector,
        binning: scene.binning,
        psf: scene.psf_table.as_ref(),
        sky: &scene.sky,
        site: scene.site.as_ref(),
        frames: TrueFrames { scene, wanted },
        mask_flags: wanted.masks.then_some(MaskFlag::ALL),
        provenance: &provenance,
    };
    write_json(&folder.join("truth.json"), &object)?;
    let object = SimulateResult {
        format: SIMULATE_FORMAT,
        recording: target.to_owned(),
        truth: target.join("truth"),
        clean: wanted.clean.then(|| word(target.join("truth/clean").as_os_str())),
        masks: wanted.masks.then(|| word(target.join("truth/masks").as_os_str())),
        frames: scene.exposures.len(),
        stars,
        provenance,
    };
    write_file(&directory.path().join("simulate.json"), output::json_text(&object)?.as_bytes())?;
    directory.finish()?;
    Ok(object)
}

/// Writes the files of a frame: its image, and what was asked for beside it.
fn write_frame(
    directory: &Path,
    scene: &Scene,
    recording: &Recording,
    (index, entry): (usize, &FrameEntry),
    frame: &Rendered,
) -> Result<()> {
    let file = entry.file.as_ref().context("a simulated frame has a file")?;
    let headers = FitsHeaders::new(&recording.camera, recording.site.as_ref(), entry);
    let path = directory.join(file);
    let (width_px, height_px) = (scene.camera.width_px, scene.camera.height_px);
    if scene.detector.bits <= 8 && scene.detector.joined(scene.binning).top_dn() <= 255.0 {
        // What rounding of frequencies adds beyond the top is cut there, as where pictures are kept.
        let bytes: Vec<u8> = frame.pixels_dn.iter().map(|count| u8::try_from(*count).unwrap_or(u8::MAX)).collect();
        write_fits_u8(&path, width_px, height_px, &bytes, &headers)?;
    } else {
        write_fits_u16(&path, width_px, height_px, &frame.pixels_dn, &headers)?;
    }
    let beside = FitsHeaders { gain_e_per_dn: None, ..headers };
    if let Some(clean_e) = &frame.clean_e {
        write_fits_f32(&directory.join("truth").join(clean_file(index)), width_px, height_px, clean_e, &beside)?;
    }
    if let Some(mask) = &frame.mask {
        write_fits_u16(&directory.join("truth").join(mask_file(index)), width_px, height_px, mask, &beside)?;
    }
    Ok(())
}

/// A table that grows with the frames, in a folder in the making.
struct Rows {
    path: PathBuf,
    table: csv::Writer<File>,
    is_empty: bool,
}

impl Rows {
    fn new(path: PathBuf) -> Result<Self> {
        let table = csv::Writer::from_path(&path).with_context(|| format!("writing {}", path.display()))?;
        Ok(Self { path, table, is_empty: true })
    }

    fn add(&mut self, rows: &[impl Serialize]) -> Result<()> {
        for row in rows {
            self.is_empty = false;
            self.table.serialize(row).with_context(|| format!("writing {}", self.path.display()))?;
        }
        Ok(())
    }

    /// Ends the table; one without rows stays only if it `stays_empty`.
    fn finish(mut self, stays_empty: bool) -> Result<()> {
        self.table.flush().with_context(|| format!("writing {}", self.path.display()))?;
        if self.is_empty && !stays_empty {
            std::fs::remove_file(&self.path).with_context(|| format!("removing {}", self.path.display()))?;
        }
        Ok(())
    }
}

/// Writes an object piece by piece into a folder in the making.
fn write_json(path: &Path, object: &impl Serialize) -> Result<()> {
    let context = || format!("writing {}", path.display());
    let mut file = BufWriter::new(File::create(path).with_context(context)?);
    serde_json::to_writer_pretty(&mut file, object).with_context(context)?;
    file.write_all(b"\n").and_then(|()| file.flush()).with_context(context)
}

/// Where in truth/ a frame's expected electrons are.
fn clean_file(frame: usize) -> String {
    format!("clean/{frame:04}.fits")
}

/// Where in truth/ a frame's mask is.
fn mask_file(frame: usize) -> String {
    format!("masks/{frame:04}.fits")
}

fn true_frame(frame: usize, scene: &Scene, exposure: &Exposure, wanted: TruthArgs) -> TrueFrame {
    let term = |(id, parameters): (&'static str, &[f64])| TruthEffect { id, parameters: by_name(id, parameters) };
    let turned = |seconds: f64| exposure.motion.attitude(&exposure.course, seconds);
    TrueFrame {
        frame,
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

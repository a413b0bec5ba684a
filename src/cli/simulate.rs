//! `boresight simulate`: renders a scene into a recording, with its truth beside it.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context, Result};
use boresight::catalog::Catalog;
use boresight::provenance::{Provenance, word};
use boresight::recording::{
    FitsHeaders, FrameEntry, ImageFileForm, OutputDirectory, Recording, write_file, write_fits_f32, write_fits_u16, write_image,
    write_manifest_of,
};
use boresight::render::{Rendered, Renderer, SIMULATE_FORMAT, SimulateResult};
use boresight::scene::{Scene, declared_entry, declared_recording};
use clap::{Args, ValueEnum};

use super::options::{BackendChoice, SceneArgs, heading};
use super::simulated_truth::{Rows, SCENE_FILE, TrueFrames, clean_file, frame_file, mask_file, simulated_truth, write_json};
use super::{Answer, Usage, output};

/// How photons are counted. There is no rougher way beside the exact one: it would save a fifth of a frame's time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum NoiseChoice {
    /// Poisson numbers at every brightness
    Exact,
}

/// The form of the frames' files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum ImageFormatChoice {
    /// Integers of 8 bits where the converter has no more, else of 16
    Fits,
    /// FITS, packed without loss (Rice)
    FitsRice,
    /// PNG, grey, 16 bits
    Png16,
    /// PNG, grey, 8 bits: for converters of 8 bits
    Png8,
    /// TIFF, grey, 16 bits
    Tiff16,
    /// Bare counts of 16 bits, row by row, low byte first
    Raw16,
}

impl From<ImageFormatChoice> for ImageFileForm {
    fn from(choice: ImageFormatChoice) -> Self {
        match choice {
            ImageFormatChoice::Fits => Self::Fits,
            ImageFormatChoice::FitsRice => Self::FitsRice,
            ImageFormatChoice::Png16 => Self::Png16,
            ImageFormatChoice::Png8 => Self::Png8,
            ImageFormatChoice::Tiff16 => Self::Tiff16,
            ImageFormatChoice::Raw16 => Self::Raw16,
        }
    }
}

/// Exposures of a scene by their numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct FrameRange {
    start: usize,
    /// The first that is left out; `None`: the end of the scene.
    end: Option<usize>,
}

impl FromStr for FrameRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || "give two whole numbers with two dots between, as 0..25".to_owned();
        let (start, end) = text.split_once("..").ok_or_else(wrong)?;
        let number = |text: &str| if text.is_empty() { Ok(None) } else { text.parse::<usize>().map(Some).map_err(|_| wrong()) };
        let range = Self { start: number(start)?.unwrap_or(0), end: number(end)? };
        match range.end {
            Some(end) if end <= range.start => Err(format!("there is no exposure from {} up to and without {end}", range.start)),
            _ => Ok(range),
        }
    }
}

impl FrameRange {
    /// As numbers of exposures of a scene that has so many.
    fn of(&self, exposures: usize) -> Result<Range<usize>> {
        let end = self.end.unwrap_or(exposures);
        if self.start < end && end <= exposures {
            return Ok(self.start..end);
        }
        let asked = format!("{}..{}", self.start, self.end.map_or_else(String::new, |end| end.to_string()));
        Err(Usage(format!("--frames {asked} is not within the scene, which has the exposures 0..{exposures}")).into())
    }
}

/// How a scene is made into a recording.
#[derive(Clone, Debug)]
pub(crate) struct RecordingOrder<'a> {
    /// The text of the scene, which is kept beside the truth as it is.
    pub(crate) scene_text: &'a str,
    pub(crate) backend: BackendChoice,
    pub(crate) frames: FrameRange,
    pub(crate) form: ImageFileForm,
    pub(crate) truth: TruthArgs,
    pub(crate) target: &'a Path,
    pub(crate) force: bool,
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
    /// Render these exposures alone, from A up to and without B, counted from 0 (A.. and ..B go to the end and from the beginning): the same bytes, names
    /// and numbers as in the whole, so machines can share the work
    #[arg(long, value_name = "A..B", help_heading = heading::RENDERING)]
    frames: Option<FrameRange>,
    /// The form of the frames' files
    #[arg(long, value_enum, default_value_t = ImageFormatChoice::Fits)]
    image_format: ImageFormatChoice,
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
    pub(super) clean: bool,
    /// Also write which pixels are hot, dead, full or lit by trails, ghosts and particles: truth/masks/, FITS; truth.json has the flags
    #[arg(long)]
    pub(super) masks: bool,
    /// Leave out what pixel effects add to each star (x_pixels_px, y_pixels_px, flux_pixels_ratio), which costs up to three frames without
    /// noise on the CPU for each frame where such effects are on
    #[arg(long)]
    no_pixel_shifts: bool,
}

/// Renders, and says what was written.
pub(crate) fn simulate(args: &SimulateArgs) -> Result<Answer> {
    let NoiseChoice::Exact = args.noise;
    let name = args.scene.display().to_string();
    let scene_text = &SceneArgs::read(&args.scene)?;
    let (scene, mut provenance) = args.options.parse(&name, scene_text)?;
    for note in scene.idle_effects() {
        tracing::warn!("{name}: {note}");
    }
    let catalog = args.options.catalog(&mut provenance)?;
    let form = args.image_format.into();
    let SimulateArgs { truth, force, .. } = *args;
    let frames = args.frames.clone().unwrap_or_default();
    let order = RecordingOrder { scene_text, backend: args.options.backend, frames, form, truth, target: &args.output, force };
    let object = write_recording(&scene, &catalog, &order, provenance)?;
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
    order: &RecordingOrder<'_>,
    mut provenance: Provenance,
) -> Result<SimulateResult> {
    let (wanted, target) = (order.truth, order.target);
    let numbers = order.frames.of(scene.exposures.len())?;
    if !order.form.holds(bits(scene)) {
        let top_dn = scene.detector.joined(scene.binning).top_dn();
        let told = format!(
            "--image-format png8 holds counts of 8 bits, and those of the scene have {} and go up to {top_dn}: choose png16, or detector.bits = 8",
            scene.detector.bits
        );
        return Err(Usage(told).into());
    }
    let directory = OutputDirectory::create(target, order.force)?;
    let renderer = Renderer::new(scene, catalog, order.backend.into())?
        .with_clean(wanted.clean)
        .with_masks(wanted.masks)
        .with_pixel_shifts(!wanted.no_pixel_shifts);
    provenance.adapter = Some(renderer.adapter());
    let recording = declared_recording(scene);
    tracing::info!(
        "{} frames of {} × {} px to render on {}",
        numbers.len(),
        scene.camera.width_px,
        scene.camera.height_px,
        renderer.adapter()
    );
    let (bar, clock) = (output::progress("rendering", numbers.len()), output::Clock::new());
    let folder = directory.path().join("truth");
    std::fs::create_dir_all(&folder).with_context(|| format!("creating {}", folder.display()))?;
    write_file(&folder.join(SCENE_FILE), order.scene_text.as_bytes())?;
    let (mut truth, mut lights) = (Rows::new(folder.join("stars.csv"))?, Rows::new(folder.join("lights.csv"))?);
    let mut stars = 0;
    for (index, entry) in entries(scene, order.form, numbers.clone()) {
        let frame = renderer.render(index)?;
        write_frame(directory.path(), scene, &recording, (index, &entry), (&frame, order.form))?;
        stars += frame.stars.len();
        tracing::debug!("frame {index}: {} stars, {} other lights, after {clock}", frame.stars.len(), frame.lights.len());
        truth.add(&frame.stars)?;
        lights.add(&frame.lights)?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    tracing::info!("rendered in {clock}: {stars} star images");
    write_manifest_of(directory.path(), &recording, entries(scene, order.form, numbers.clone()).map(|(_, entry)| entry))?;
    truth.finish(true)?;
    lights.finish(false)?;
    let frames = TrueFrames { scene, wanted, form: order.form, numbers: numbers.clone() };
    write_json(&folder.join("truth.json"), &simulated_truth(frames, &provenance))?;
    let object = SimulateResult {
        format: SIMULATE_FORMAT,
        recording: target.to_owned(),
        truth: target.join("truth"),
        clean: wanted.clean.then(|| word(target.join("truth/clean").as_os_str())),
        masks: wanted.masks.then(|| word(target.join("truth/masks").as_os_str())),
        first_frame: numbers.start,
        frames: numbers.len(),
        stars,
        provenance,
    };
    write_file(&directory.path().join("simulate.json"), output::json_text(&object)?.as_bytes())?;
    directory.finish()?;
    Ok(object)
}

/// Bits of the counts, 8 or 16: joined pixels may count beyond those of the converter.
fn bits(scene: &Scene) -> u32 {
    if scene.detector.bits <= 8 && scene.detector.joined(scene.binning).top_dn() <= 255.0 { 8 } else { 16 }
}

/// Writes the files of a frame: its image, and what was asked for beside it.
fn write_frame(
    directory: &Path,
    scene: &Scene,
    recording: &Recording,
    (index, entry): (usize, &FrameEntry),
    (frame, form): (&Rendered, ImageFileForm),
) -> Result<()> {
    let file = entry.file.as_ref().context("a simulated frame has a file")?;
    let headers = FitsHeaders::new(&recording.camera, recording.site.as_ref(), entry);
    let (width_px, height_px) = (scene.camera.width_px, scene.camera.height_px);
    write_image(&directory.join(file), form, [width_px, height_px], (&frame.pixels_dn, bits(scene)), &headers)?;
    let beside = FitsHeaders { gain_e_per_dn: None, ..headers };
    if let Some(clean_e) = &frame.clean_e {
        write_fits_f32(&directory.join("truth").join(clean_file(index)), width_px, height_px, clean_e, &beside)?;
    }
    if let Some(mask) = &frame.mask {
        write_fits_u16(&directory.join("truth").join(mask_file(index)), width_px, height_px, mask, &beside)?;
    }
    Ok(())
}

/// Frames of it with their numbers, one after the other.
fn entries(scene: &Scene, form: ImageFileForm, numbers: Range<usize>) -> impl Iterator<Item = (usize, FrameEntry)> {
    numbers.map(move |number| {
        let file = Some(PathBuf::from(frame_file(number, form)));
        (number, FrameEntry { file, ..declared_entry(scene, number) })
    })
}

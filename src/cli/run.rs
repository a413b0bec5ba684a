//! `boresight run` and `demo`: simulates, measures, identifies and calibrates, and compares with the truth.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use boresight::calibrate::{Calibration, Method, Status, calibrate, mapping_error_px};
use boresight::camera::{Camera, PARAMETER_NAMES, PARAMETER_UNITS};
use boresight::effects::ids;
use boresight::identify::ControlPoints;
use boresight::pipeline::{CameraRow, ParameterRow, PreparedPoints, RUN_FORMAT, RunLimit, RunResult};
use boresight::provenance::Provenance;
use boresight::recording::{ImageFileForm, Recording, ResultFolder, write_file};
use boresight::scene::{DEMO_TOML, Scene};
use clap::Args;
use serde::Serialize;

use super::calibrate::{SolveArgs, control_points};
use super::options::{BackendChoice, SceneArgs, heading};
use super::pipeline::{IdentifiedFrame, Measured};
use super::{Answer, identify_files, output, pictures, pipeline, simulate};

/// Arguments of `run`.
#[derive(Debug, Args)]
pub(crate) struct RunArgs {
    /// The scene
    #[arg(value_name = "SCENE.toml")]
    scene: PathBuf,
    #[command(flatten)]
    common: CommonArgs,
}

/// Arguments of `demo`.
#[derive(Debug, Args)]
pub(crate) struct DemoArgs {
    #[command(flatten)]
    common: CommonArgs,
}

/// Arguments that both share. A heading of the whole would be replaced by those of its parts.
#[derive(Debug, Args)]
struct CommonArgs {
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    sky: PhysicsArgs,
    /// Detection threshold, signal-to-noise ratio [default: such that noise makes one false star a frame]
    #[arg(long, value_name = "SNR", value_parser = super::options::threshold, allow_negative_numbers = true, help_heading = heading::MEASURING)]
    detection_threshold: Option<f64>,
    #[command(flatten)]
    solve: SolveArgs,
    /// A limit on the result, as mapping_error_rms_px<=0.05; exit code 3 where it is not kept; may be given several times
    #[arg(long, value_name = "METRIC<=VALUE", value_parser = clap::value_parser!(RunLimit), help_heading = heading::STATISTICS)]
    require: Vec<RunLimit>,
    /// Write the recording, the results and the pictures into this folder [default: outputs/NAME]
    #[arg(short, long, value_name = "DIR", value_parser = super::options::folder(), help_heading = heading::OUTPUT)]
    output: Option<PathBuf>,
    /// Replace what an earlier run of this verb wrote there
    #[arg(long, help_heading = heading::OUTPUT)]
    force: bool,
    /// Print the result as one JSON object on stdout, and nothing else
    #[arg(long, help_heading = heading::OUTPUT)]
    json: bool,
}

/// The physics of the calibration; the scene says which physics is rendered.
#[derive(Debug, Args)]
#[command(next_help_heading = heading::MODEL)]
struct PhysicsArgs {
    /// The effects of known size that the calibration's model contains
    #[arg(long, value_name = "LIST|none|known", default_value = "known")]
    physics: boresight::camera::Physics,
}

/// A solution, or why there is none.
struct Solved {
    method: Method,
    result: Result<Calibration, boresight::calibrate::CalibrateError>,
}

/// `boresight run`.
pub(crate) fn run(args: &RunArgs) -> Result<Answer> {
    let text = SceneArgs::read(&args.scene)?;
    let (scene, provenance) = args.common.scene.parse(&args.scene.display().to_string(), &text)?;
    let projection = scene.model.projection();
    if projection != ids::PINHOLE {
        let file = args.scene.display();
        bail!(
            "{file}: camera.projection = {projection:?}: `run` compares pinhole cameras alone; use `simulate`, then `calibrate --projection {projection}`"
        );
    }
    let stem = args.scene.file_stem().map_or_else(|| "run".into(), |stem| stem.to_string_lossy().into_owned());
    night(
        (&scene, &text),
        provenance,
        &args.common,
        args.common.scene.backend,
        &args.common.solve,
        ("run", &Path::new("outputs").join(stem)),
    )
}

/// `boresight demo`.
pub(crate) fn demo(args: &DemoArgs) -> Result<Answer> {
    let (scene, provenance) = args.common.scene.parse("the demo scene", DEMO_TOML)?;
    // The demonstration is of the compute pipeline: it takes any adapter, software or not, before the CPU.
    let mut backend = args.common.scene.backend;
    if backend == BackendChoice::Auto {
        backend = BackendChoice::Gpu;
        if let Err(reason) = boresight::gpu::Gpu::open(boresight::gpu::Need::Any) {
            tracing::warn!("{reason}; the CPU renders");
            backend = BackendChoice::Cpu;
        }
    }
    let solve = SolveArgs { misidentify: args.common.solve.misidentify.or(Some(0.2)), ..args.common.solve.clone() };
    night((&scene, DEMO_TOML), provenance, &args.common, backend, &solve, ("demo", Path::new("outputs/demo")))
}

fn night(
    (scene, scene_text): (&Scene, &str),
    mut provenance: Provenance,
    args: &CommonArgs,
    backend: BackendChoice,
    solve: &SolveArgs,
    (verb, default_output): (&'static str, &Path),
) -> Result<Answer> {
    let target = args.output.as_deref().unwrap_or(default_output);
    let folder = ResultFolder::open(target, verb, args.force)?;
    let catalog = args.scene.catalog(&mut provenance)?;
    let recording_path = target.join("recording");
    // The results of an earlier run go first, so that none outlives its input.
    folder.begin()?;
    let order = simulate::RecordingOrder {
        scene_text,
        backend,
        frames: simulate::FrameRange::default(),
        form: ImageFileForm::default(),
        truth: simulate::TruthArgs::default(),
        target: &recording_path,
        force: args.force,
    };
    let simulated = simulate::write_recording(scene, &catalog, &order, provenance.clone())?;
    provenance = simulated.provenance;

    let recording = Recording::open(&[&recording_path])?;
    let measured = pipeline::measure(recording, args.detection_threshold)?;
    let options = search_options(&measured);
    let identified = pipeline::identify_frames(&measured, &catalog, &args.sky.physics.clone().into(), &options)?;
    let frames_identified = identified.iter().filter(|frame| frame.solution().is_some()).count();
    let true_points = control_points(&measured, &identified, &catalog, &SolveArgs { misidentify: None, ..solve.clone() }, false)?.points;
    let points = control_points(&measured, &identified, &catalog, solve, false)?;

    let (physics, _) = pipeline::physics_in_force(&identified);
    let moved = measured.times_are_known() && physics.contains(&ids::PROPER_MOTION);
    let base = solve.options(&physics, moved)?;
    let solve_by = |method: Method| {
        let clock = output::Clock::new();
        let options = boresight::calibrate::CalibrateOptions { method, ..base.clone() };
        let solved = Solved { method, result: calibrate(&points.points, &options) };
        tracing::info!("{} of {} star images in {clock}", method.name(), points.points.points.len());
        solved
    };
    let solutions = [Method::LeastSquares, Method::VariableWeights, Method::Bundle].map(solve_by);
    let [_, _, bundle] = &solutions;

    let wrong = wrong_identifications(&recording_path, &true_points)?;
    let [misidentified_rejected, misidentified_left_out] = rejected(&points.misidentified, bundle);
    let mut object = RunResult {
        format: RUN_FORMAT,
        parameters: parameter_rows(scene, &solutions),
        cameras: camera_rows(scene, &solutions),
        frames: scene.exposures.len(),
        frames_identified,
        wrong_identifications: wrong,
        control_points: points.points.points.len(),
        misidentified: points.misidentified.len(),
        misidentify_share: solve.misidentify.unwrap_or(0.0),
        misidentify_seed: solve.misidentify_seed,
        misidentified_rejected,
        misidentified_left_out,
        notes: points.notes.clone(),
        requirements: Vec::new(),
        provenance,
    };
    object.requirements = args.require.iter().map(|limit| limit.judged(&object)).collect();
    write_file(&target.join("run.json"), output::json_text(&object)?.as_bytes())?;
    write_truth_of_points(&recording_path, &points)?;
    write_calibrations(target, &solutions, &object.provenance)?;
    draw(target, &measured, &identified, &catalog, bundle)?;
    if args.json {
        output::print(&output::json_text(&object)?)?;
    } else {
        output::print_page(&text(&object, target))?;
    }
    let converged = matches!(&bundle.result, Ok(calibration) if calibration.status == Status::Converged);
    let is_met = object.requirements.iter().all(|limit| limit.is_met);
    Ok(if converged && frames_identified > 0 && is_met { Answer::Yes } else { Answer::No })
}

/// Writes the calibration of each method that has one.
fn write_calibrations(target: &Path, solutions: &[Solved], provenance: &Provenance) -> Result<()> {
    for solved in solutions {
        if let Ok(calibration) = &solved.result {
            let mut calibration = calibration.clone();
            calibration.provenance = Some(provenance.clone());
            let path = target.join(format!("{}/calibrate.json", solved.method.name()));
            write_file(&path, output::json_text(&calibration)?.as_bytes())?;
        }
    }
    Ok(())
}

/// The recording tells the focal length, so the search has nothing to be told.
fn search_options(measured: &Measured) -> boresight::identify::IdentifyOptions {
    boresight::identify::IdentifyOptions {
        nominal_focal_length_px: measured.recording.camera.nominal_focal_length_px(),
        ..boresight::identify::IdentifyOptions::default()
    }
}

fn parameter_rows(scene: &Scene, [least_squares, variable_weights, bundle]: &[Solved; 3]) -> Vec<ParameterRow> {
    let of = |solved: &Solved, index: usize| solved.result.as_ref().ok().map(|calibration| calibration.camera.parameters()[index]);
    let sigma = |solved: &Solved, index: usize| {
        let calibration = solved.result.as_ref().ok()?;
        calibration.parameters.iter().find(|parameter| parameter.name == PARAMETER_NAMES[index]).map(|parameter| parameter.sigma)
    };
    (0..PARAMETER_NAMES.len())
        .map(|index| ParameterRow {
            name: PARAMETER_NAMES[index],
            unit: PARAMETER_UNITS[index],
            nominal: scene.nominal.parameters()[index],
            truth: scene.camera.parameters()[index],
            least_squares: of(least_squares, index),
            variable_weights: of(variable_weights, index),
            variable_weights_sigma: sigma(variable_weights, index),
            bundle: of(bundle, index),
            bundle_sigma: sigma(bundle, index),
        })
        .collect()
}

fn camera_rows(scene: &Scene, solutions: &[Solved]) -> Vec<CameraRow> {
    let error = |camera: &Camera| mapping_error_px(&scene.camera, camera);
    let nominal = error(&scene.nominal);
    let mut rows = vec![CameraRow {
        camera: "nominal",
        status: "as declared".into(),
        mapping_error_rms_px: nominal.map(|error| error.rms_px),
        mapping_error_max_px: nominal.map(|error| error.max_px),
        residual_rms_px: None,
        held_out_rms_px: None,
    }];
    rows.extend(solutions.iter().map(|solved| match &solved.result {
        Ok(calibration) => {
            let error = error(&calibration.camera);
            CameraRow {
                camera: solved.method.name(),
                status: match calibration.status {
                    Status::Converged => format!("converged after {}", calibration.iterations.len()),
                    Status::NotConverged => "not converged".into(),
                },
                mapping_error_rms_px: error.map(|error| error.rms_px),
                mapping_error_max_px: error.map(|error| error.max_px),
                residual_rms_px: calibration.rms_px,
                held_out_rms_px: calibration.held_out_rms_px,
            }
        }
        Err(reason) => CameraRow {
            camera: solved.method.name(),
            status: format!("failed: {reason}"),
            mapping_error_rms_px: None,
            mapping_error_max_px: None,
            residual_rms_px: None,
            held_out_rms_px: None,
        },
    }));
    rows
}

/// How many of the program's own identifications are wrong: the star that it names landed elsewhere in that frame.
fn wrong_identifications(recording: &Path, points: &ControlPoints) -> Result<usize> {
    /// A star image further than this from where the star truly landed is another star.
    const SAME_STAR_PX: f64 = 3.0;
    let path = recording.join("truth/stars.csv");
    let mut reader = csv::Reader::from_path(&path).with_context(|| format!("reading {}", path.display()))?;
    let mut landed = std::collections::BTreeMap::new();
    for star in reader.deserialize() {
        let star: boresight::render::TrueStar = star.with_context(|| format!("reading {}", path.display()))?;
        landed.insert((star.frame, star.hip), (star.x_px, star.y_px));
    }
    Ok(points
        .points
        .iter()
        .filter(|point| {
            landed.get(&(point.frame, point.hip)).is_none_or(|(x_px, y_px)| (point.x_px - x_px).hypot(point.y_px - y_px) > SAME_STAR_PX)
        })
        .count())
}

/// How many of the deliberate misidentifications the calibration rejected, and how many never entered it.
fn rejected(misidentified: &[boresight::identify::Misidentification], solved: &Solved) -> [usize; 2] {
    let Ok(calibration) = &solved.result else { return [0; 2] };
    let found = || misidentified.iter().map(|wrong| calibration.points.get(wrong.point));
    let left_out = found().filter(|point| point.is_none_or(|point| point.left_out.is_some())).count();
    [found().flatten().filter(|point| point.left_out.is_none() && point.weight <= 0.5).count(), left_out]
}

/// Writes which identifications were made wrong on purpose: truth/misidentified.csv.
fn write_truth_of_points(recording: &Path, points: &PreparedPoints) -> Result<()> {
    #[derive(Serialize)]
    struct Row {
        frame: usize,
        x_px: f64,
        y_px: f64,
        true_hip: u32,
        given_hip: Option<u32>,
        error_arcsec: f64,
    }
    let mut table = csv::Writer::from_writer(Vec::new());
    for wrong in &points.misidentified {
        let point = &points.points.points[wrong.point];
        table
            .serialize(Row {
                frame: point.frame,
                x_px: point.x_px,
                y_px: point.y_px,
                true_hip: wrong.true_hip,
                given_hip: wrong.given_hip,
                error_arcsec: wrong.error_rad / boresight::units::ARCSEC_RAD,
            })
            .context("writing truth/misidentified.csv")?;
    }
    let bytes = table.into_inner().context("writing truth/misidentified.csv")?;
    Ok(write_file(&recording.join("truth/misidentified.csv"), &bytes)?)
}

fn draw(
    target: &Path,
    measured: &Measured,
    identified: &[IdentifiedFrame],
    catalog: &boresight::catalog::Catalog,
    solved: &Solved,
) -> Result<()> {
    let pictures = target.join("pictures");
    if let (Some(frame), Some(identified)) = (measured.frames.first(), identified.first()) {
        identify_files::write_picture(&pictures.join("frame.png"), measured, frame, Some(identified), catalog)?;
    }
    if let Ok(calibration) = &solved.result {
        pictures::residuals(&pictures.join("residuals.png"), calibration)?;
    }
    Ok(())
}

/// The tables for people.
fn text(object: &RunResult, target: &Path) -> String {
    let number = |value: Option<f64>, unit: &str| match value {
        None => "–".to_owned(),
        Some(value) if unit == "px" => format!("{value:.3}"),
        Some(value) => format!("{value:.3e}"),
    };
    let rows: Vec<Vec<String>> = object
        .parameters
        .iter()
        .map(|row| {
            let all = [Some(row.nominal), Some(row.truth), row.least_squares, row.variable_weights, row.bundle, row.bundle_sigma];
            let mut cells = vec![row.name.to_owned(), row.unit.to_owned()];
            cells.extend(all.map(|value| number(value, row.unit)));
            cells
        })
        .collect();
    let header = ["parameter", "unit", "nominal", "truth", "least squares", "variable weights", "bundle", "± σ"];
    let mut text = boresight::report::table(&header, &rows);
    text.push('\n');
    let rows: Vec<Vec<String>> = object
        .cameras
        .iter()
        .map(|row| {
            let numbers = [row.mapping_error_rms_px, row.mapping_error_max_px, row.residual_rms_px, row.held_out_rms_px];
            let mut cells = vec![row.camera.to_owned()];
            cells.extend(numbers.map(|value| value.map_or_else(|| "–".to_owned(), |value| format!("{value:.4}"))));
            cells.push(row.status.clone());
            cells
        })
        .collect();
    let header = ["camera", "mapping error rms/px", "max/px", "residual rms/px", "held out/px", ""];
    text += &boresight::report::table(&header, &rows);
    text += &format!(
        "\n{} of {} frames identified, {} of {} identifications wrong; then {} made wrong on purpose: {} rejected, {} left out beforehand\n",
        object.frames_identified,
        object.frames,
        object.wrong_identifications,
        object.control_points,
        object.misidentified,
        object.misidentified_rejected,
        object.misidentified_left_out
    );
    for note in &object.notes {
        text += &format!("{note}\n");
    }
    for limit in &object.requirements {
        let value = limit.value.map_or_else(|| "not known".to_owned(), pictures::significant);
        text +=
            &format!("{}: {} {} {}, it is {value}\n", if limit.is_met { "met" } else { "NOT MET" }, limit.metric, limit.sign, limit.limit);
    }
    text += &format!(
        "rendered on {}; recording, truth, results and pictures are in {}\n",
        object.provenance.adapter.as_deref().unwrap_or("the CPU"),
        target.display()
    );
    text
}

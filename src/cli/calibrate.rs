//! `boresight calibrate`: solves for the camera.

use anyhow::{Context, Result};
use boresight::calibrate::{CalibrateOptions, Calibration, Method, Status, calibrate as calibrate_points};
use boresight::camera::PARAMETER_NAMES;
use boresight::catalog::Catalog;
use boresight::identify::{
    ControlPoints, Identification, Misidentification, MisidentificationKind, control_points as build_control_points, misidentify,
};
use clap::{Args, ValueEnum};

use super::identify::SearchArgs;
use super::options::{InputArgs, OutputArgs, SkyArgs};
use super::pipeline::{IdentifiedFrame, Measured};
use super::{Answer, output, pictures, pipeline, star_list};

/// Arguments of `calibrate`.
#[derive(Debug, Args)]
pub(crate) struct CalibrateArgs {
    #[command(flatten)]
    input: InputArgs,
    #[command(flatten)]
    sky: SkyArgs,
    #[command(flatten)]
    search: SearchArgs,
    #[command(flatten)]
    solve: SolveArgs,
    #[command(flatten)]
    output: OutputArgs,
}

/// How the camera is solved, and from which control points.
#[derive(Clone, Debug, Args)]
pub(crate) struct SolveArgs {
    /// How to solve
    #[arg(long, value_enum, default_value_t = MethodChoice::VariableWeights)]
    pub(crate) method: MethodChoice,
    /// F of the variable weights: pairs with T above it are weighted down
    #[arg(long, value_name = "F", default_value_t = 10.83, value_parser = super::identify::positive)]
    pub(crate) threshold: f64,
    /// The parameters to solve, others keep their ground values: any of x0,y0,f,k1,p1,p2
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = PARAMETER_NAMES)]
    pub(crate) solve: Option<Vec<String>>,
    /// At most this many iterations
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) max_iterations: u16,
    /// Use only stars brighter than this V magnitude
    #[arg(long, value_name = "V", allow_negative_numbers = true)]
    pub(crate) max_magnitude: Option<f64>,
    /// Use all stars that are identified, the imprecise ones and those without proper motion too
    #[arg(long)]
    pub(crate) all_stars: bool,
    /// Take the identifications of a star list (`hip`, or `ra_deg` and `dec_deg`) as they are, instead of making our own
    #[arg(long)]
    pub(crate) trust_identifications: bool,
    /// Replace this share of the identifications deliberately, to test the method (default 0; 0.2 in `demo`)
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub(crate) misidentify: Option<f64>,
    /// By what they are replaced
    #[arg(long, value_enum, default_value_t = MisidentifyChoice::Random, value_name = "KIND")]
    pub(crate) misidentify_kind: MisidentifyChoice,
    /// Seed of the deliberate misidentification
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    pub(crate) misidentify_seed: u64,
}

/// The methods.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum MethodChoice {
    /// The reference method: pairs of stars, iterated with variable weights
    VariableWeights,
    /// Pairs of stars, all weights one: for comparison
    LeastSquares,
}

/// What a deliberately wrong identification is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum MisidentifyChoice {
    /// Any star of the field
    Random,
    /// A star near by
    NearNeighbour,
}

fn share(text: &str) -> std::result::Result<f64, String> {
    text.parse::<f64>().ok().filter(|value| (0.0..=0.9).contains(value)).ok_or_else(|| "give a share from 0 to 0.9".into())
}

impl From<MisidentifyChoice> for MisidentificationKind {
    fn from(choice: MisidentifyChoice) -> Self {
        match choice {
            MisidentifyChoice::Random => Self::Random,
            MisidentifyChoice::NearNeighbour => Self::NearNeighbour,
        }
    }
}

impl SolveArgs {
    /// The options of the solver.
    pub(crate) fn options(&self, physics: &[&str], time_is_known: bool) -> CalibrateOptions {
        let defaults = CalibrateOptions::default();
        CalibrateOptions {
            method: match self.method {
                MethodChoice::VariableWeights => Method::VariableWeights,
                MethodChoice::LeastSquares => Method::LeastSquares,
            },
            f_threshold: self.threshold,
            max_iterations: usize::from(self.max_iterations),
            solve: self.solve.clone().unwrap_or(defaults.solve.clone()),
            leave_out_imprecise: !self.all_stars,
            proper_motion_only: time_is_known && !self.all_stars,
            physics: physics.iter().map(|id| (*id).to_owned()).collect(),
            ..defaults
        }
    }
}

/// Control points with what was done to them on purpose.
pub(crate) struct Prepared {
    /// The points, in the un-mirrored image.
    pub(crate) points: ControlPoints,
    /// −1 if the images are mirrored.
    pub(crate) parity: i8,
    /// The deliberate misidentifications.
    pub(crate) misidentified: Vec<Misidentification>,
    /// What was left out, one sentence each.
    pub(crate) notes: Vec<String>,
}

/// The control points of identified frames.
pub(crate) fn control_points(measured: &Measured, identified: &[IdentifiedFrame], catalog: &Catalog, args: &SolveArgs) -> Result<Prepared> {
    let frames: Vec<boresight::identify::IdentifiedFrame> = measured
        .frames
        .iter()
        .zip(identified)
        .map(|(frame, identified)| boresight::identify::IdentifiedFrame {
            frame: frame.index,
            detections: &frame.detections,
            identification: &identified.identification,
            directions: &identified.directions,
            years_since_epoch: identified.sky.observation().epoch_yr.map_or(0.0, |epoch| epoch - catalog.epoch_yr),
        })
        .collect();
    let nominal = measured.recording.nominal_camera();
    if nominal.is_none() {
        measured.recording.common_size().context("a calibration is of one camera")?;
    }
    let (mut points, mut notes) = build_control_points(&frames, measured.recording.frames.len(), catalog, nominal);
    if args.trust_identifications {
        trust(&mut points, measured, identified, catalog, &mut notes)?;
    }
    for (frame, identified) in measured.frames.iter().zip(identified) {
        if let (Identification::NotIdentified { reason }, false) = (&identified.identification, args.trust_identifications) {
            notes.push(format!("{} is not identified and left out: {reason}", frame.name));
        }
    }
    if let Some(limit) = args.max_magnitude {
        points.points.retain(|point| point.magnitude <= limit);
    }
    let parity = points.parity;
    let mut points = points.unmirrored();
    let misidentified =
        misidentify(&mut points, catalog, args.misidentify.unwrap_or(0.0), args.misidentify_kind.into(), args.misidentify_seed);
    Ok(Prepared { points, parity, misidentified, notes })
}

/// Takes the identifications of a star list as they stand, in the place of ours.
fn trust(
    points: &mut ControlPoints,
    measured: &Measured,
    identified: &[IdentifiedFrame],
    catalog: &Catalog,
    notes: &mut Vec<String>,
) -> Result<()> {
    let list = measured
        .recording
        .stars
        .as_ref()
        .context("--trust-identifications: only a star list names its stars; this recording holds images")?;
    points.points.clear();
    for (frame, identified) in measured.frames.iter().zip(identified) {
        let stars = list.frames.get(frame.index).map_or(&[][..], Vec::as_slice);
        let unknown = star_list::listed_control_points(points, frame.index, stars, catalog, &identified.sky);
        if !unknown.is_empty() {
            notes.push(format!("{}: the catalogue does not hold HIP {unknown:?}; these stars are left out", frame.name));
        }
    }
    Ok(())
}

/// Calibrates, and prints the camera.
pub(crate) fn calibrate(args: &CalibrateArgs) -> Result<Answer> {
    let catalog = args.sky.catalog()?;
    let recording = pipeline::open(&args.input)?;
    let mut provenance = pipeline::provenance(&recording, Some(&args.sky))?;
    provenance.seed = args.solve.misidentify.map(|_| args.solve.misidentify_seed);
    let measured = pipeline::measure(recording)?;
    let identified = pipeline::identify_frames(&measured, &catalog, &args.sky.physics, &args.search.options(&measured))?;
    let points = control_points(&measured, &identified, &catalog, &args.solve)?;
    let moved = identified.iter().all(|frame| frame.sky.ids().contains(&"proper-motion"));
    let physics = identified.first().map_or_else(Vec::new, |frame| frame.sky.ids());
    let mut calibration = calibrate_points(&points.points, &args.solve.options(&physics, moved))?;
    calibration.parity = points.parity;
    calibration.warnings.extend(points.notes.iter().cloned());
    calibration.provenance = Some(provenance);
    if let Some(directory) = &args.output.output {
        std::fs::create_dir_all(directory).with_context(|| format!("creating {}", directory.display()))?;
        pictures::residuals(&directory.join("residuals.png"), &calibration)?;
    }
    output::deliver("calibrate", &calibration.with_stored_columns(), args.output.json, args.output.output.as_deref(), || {
        text(&calibration)
    })?;
    Ok(if calibration.status == Status::Converged { Answer::Yes } else { Answer::No })
}

/// The calibration for people.
fn text(calibration: &Calibration) -> String {
    let rows: Vec<Vec<String>> = calibration
        .parameters
        .iter()
        .map(|parameter| {
            let [value, sigma] = with_sigma(parameter.value, parameter.sigma);
            vec![parameter.name.clone(), value, format!("± {sigma}"), parameter.unit.clone()]
        })
        .collect();
    let mut text = boresight::report::table(&["parameter", "value", "σ", "unit"], &rows);
    let px = |value: Option<f64>| value.map_or_else(|| "unknown".to_owned(), |value| format!("{value:.4} px"));
    text += &format!(
        "\n{} in {} iterations of {} over {} pairs; physics: {}\n",
        if calibration.status == Status::Converged { "converged" } else { "NOT CONVERGED" },
        calibration.iterations.len(),
        calibration.method.name(),
        calibration.pairs,
        if calibration.physics.is_empty() { "none".to_owned() } else { calibration.physics.join(", ") }
    );
    text += &format!(
        "{} of {} star images used ({} stars, {} frames), {} rejected\n",
        calibration.stars,
        calibration.stars_offered,
        calibration.distinct_stars,
        calibration.frames,
        calibration.rejected.len()
    );
    text += &format!(
        "rms {} in sample, {} held out; σ of the map {} (median over the frame)\n",
        px(calibration.rms_px),
        px(calibration.held_out_rms_px),
        px(calibration.map_sigma_px.map(|sigma| sigma.median))
    );
    for warning in &calibration.warnings {
        text += &format!("warning: {warning}\n");
    }
    text
}

/// A value and its standard error with as many digits as the error deserves.
fn with_sigma(value: f64, sigma: f64) -> [String; 2] {
    if value != 0.0 && value.abs() < 1e-3 {
        return [format!("{value:.4e}"), format!("{sigma:.1e}")];
    }
    let digits = if sigma > 0.0 { (1.0 - sigma.log10().floor()).clamp(0.0, 8.0) as usize } else { 3 };
    [format!("{value:.digits$}"), format!("{sigma:.digits$}")]
}

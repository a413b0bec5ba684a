//! `boresight calibrate`: solves for the camera.

use std::path::PathBuf;

use anyhow::{Context, Result};
use boresight::calibrate::{
    AttitudeModel, CalibrateError, CalibrateOptions, Calibration, Method, MisidentifiedPoint, ParameterPrior, SolvedCamera, Status,
    UnsolvedCamera, calibrate as calibrate_points, calibrate_identifying_anew, check_parameter_name,
};
use boresight::catalog::Catalog;
use boresight::detect::LearntImage;
use boresight::effects;
use boresight::effects::ids;
use boresight::guard::guarded;
use boresight::identify::{Misidentification, MisidentificationKind, misidentify};
use boresight::pipeline::{
    PipelineError, PreparedPoints, SkyChoice, check_focal_lengths, check_sizes, detector_numbers, known_behind_the_lens, star_images,
    surroundings, take_phase_bias_off, with_name,
};
use boresight::provenance::Provenance;
use boresight::units::ARCSEC_RAD;
use clap::{Args, ValueEnum};

use super::identify::SearchArgs;
use super::options::{InputArgs, MeasureArgs, OutputArgs, SkyArgs, heading};
use super::pipeline::{IdentifiedFrame, Measured};
use super::update::{self, NewFrames, UpdateArgs};
use super::{Answer, calibrate_text, output, pictures, pipeline};

/// Arguments of `calibrate`.
#[derive(Debug, Args)]
pub(crate) struct CalibrateArgs {
    #[command(flatten)]
    input: InputArgs,
    #[command(flatten)]
    measure: MeasureArgs,
    #[command(flatten)]
    sky: SkyArgs,
    #[command(flatten)]
    search: SearchArgs,
    /// Calibration method [default: bundle]
    #[arg(long, value_enum, help_heading = heading::SOLVER)]
    method: Option<MethodChoice>,
    /// Take the identifications of a star list (`hip`, or `ra_deg` and `dec_deg`) as they are, instead of making our own
    #[arg(long, help_heading = heading::SEARCH)]
    trust_identifications: bool,
    /// Do not re-identify the stars with the improved camera
    #[arg(long, help_heading = heading::SEARCH)]
    no_reidentify: bool,
    /// Leave the positions as the centroid estimator measures them; else the image of a star is learnt at the positions that the sky predicts, and the
    /// estimator's bias under that image, which follows the pixel phase, is taken off
    #[arg(long, help_heading = heading::MEASURING)]
    no_learnt_image: bool,
    #[command(flatten)]
    solve: SolveArgs,
    #[command(flatten)]
    update: UpdateArgs,
    #[command(flatten)]
    output: OutputArgs,
}

/// The laws by which a lens maps angles.
const PROJECTIONS: [&str; 5] = [ids::PINHOLE, ids::EQUIDISTANT, ids::EQUISOLID, ids::STEREOGRAPHIC, ids::KANNALA_BRANDT];

/// How the camera is solved, and from which control points.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = heading::SOLVER)]
pub(crate) struct SolveArgs {
    /// Read the solver's options from this TOML file (keys as under "options" in a calibrate.json); options of the command line take precedence
    #[arg(long, value_name = "FILE")]
    pub(crate) options: Option<PathBuf>,
    /// Threshold F of the variable weights: pairs whose statistic T is above it are weighted down [default: 10.83]
    #[arg(long, value_name = "F", value_parser = super::identify::positive)]
    pub(crate) threshold: Option<f64>,
    /// The parameters to solve, others keep their starting values: x0, y0, f, k1, p1, p2, k2, k3, any effect or effect.parameter of
    /// `boresight effects`, or `auto`: those of the camera that the data support [default: x0,y0,f,k1,p1,p2, and in `calibrate` what the
    /// data support of k2 and k3]
    #[arg(long, value_name = "LIST|auto", value_delimiter = ',', value_parser = solvable, help_heading = heading::MODEL)]
    pub(crate) solve: Option<Vec<String>>,
    /// Gaussian prior of a parameter: name=value:sigma, in its own unit; may be repeated
    #[arg(long, value_name = "NAME=VALUE:SIGMA", value_parser = prior, help_heading = heading::MODEL)]
    pub(crate) prior: Vec<ParameterPrior>,
    /// The projection; without one, that by which the frames were identified
    #[arg(long, value_name = "ID", value_parser = PROJECTIONS, help_heading = heading::MODEL)]
    pub(crate) projection: Option<String>,
    /// `free`: one attitude a frame, even if the recording says that the mount is fixed [default: auto]
    #[arg(long, value_enum)]
    pub(crate) attitudes: Option<AttitudeChoice>,
    /// At most this many iterations [default: 100]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) max_iterations: Option<u16>,
    /// Use only stars brighter than this V magnitude
    #[arg(long, value_name = "V", allow_negative_numbers = true, help_heading = heading::CATALOGUE)]
    pub(crate) max_magnitude: Option<f64>,
    /// Use all stars that are identified, the imprecise ones and those without proper motion too
    #[arg(long, help_heading = heading::CATALOGUE)]
    pub(crate) all_stars: bool,
    /// Replace this share of the identifications deliberately, to test the method (default 0; 0.2 in `demo`)
    #[arg(long, value_name = "SHARE", value_parser = share, help_heading = heading::TRIAL)]
    pub(crate) misidentify: Option<f64>,
    /// Kind of the wrong identifications
    #[arg(long, value_enum, default_value_t = MisidentifyChoice::Random, value_name = "KIND", help_heading = heading::TRIAL)]
    pub(crate) misidentify_kind: MisidentifyChoice,
    /// Seed of the deliberate misidentification
    #[arg(long, value_name = "SEED", default_value_t = 0, help_heading = heading::TRIAL)]
    pub(crate) misidentify_seed: u64,
}

/// The methods.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum MethodChoice {
    /// Robust bundle adjustment of camera and attitudes
    Bundle,
    /// Pairs of stars, iteratively reweighted (the published method)
    VariableWeights,
    /// Pairs of stars, unweighted least squares, for comparison
    LeastSquares,
}

/// What a deliberately wrong identification is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum MisidentifyChoice {
    /// A wrong direction without a star, 0.05° to 2° from the right one
    #[default]
    Random,
    /// A star near by
    NearNeighbour,
    /// The star that a match through a wrong camera gives
    #[value(alias = "natural")]
    WrongCamera,
}

pub(crate) fn share(text: &str) -> std::result::Result<f64, String> {
    text.parse::<f64>().ok().filter(|value| (0.0..=0.9).contains(value)).ok_or_else(|| "give a share from 0 to 0.9".into())
}

/// How the attitudes hang together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum AttitudeChoice {
    /// As the recording says: free, or fixed to the turning Earth
    Auto,
    /// One for each frame
    Free,
}

/// Priors are given of the images as stored, and used in the un-mirrored image.
fn unmirror_priors(options: &mut CalibrateOptions, width_px: usize) {
    for prior in &mut options.priors {
        match prior.name.as_str() {
            "x0" => prior.value = width_px as f64 - 1.0 - prior.value,
            "p1" => prior.value = -prior.value,
            _ => {}
        }
    }
}

/// The name of a parameter or an effect, or `auto`.
fn solvable(name: &str) -> std::result::Result<String, String> {
    let name = name.trim();
    if name == "auto" { Ok(name.to_owned()) } else { parameter_name(name) }
}

/// The name of a parameter or an effect.
pub(crate) fn parameter_name(name: &str) -> std::result::Result<String, String> {
    check_parameter_name(name.trim()).map_err(|error| error.to_string())?;
    Ok(name.trim().to_owned())
}

/// A prior as written on the command line.
fn prior(text: &str) -> std::result::Result<ParameterPrior, String> {
    let parts = text.split_once('=').and_then(|(name, rest)| Some((name, rest.split_once(':')?)));
    let parsed = parts.and_then(|(name, (value, sigma))| {
        let (value, sigma) = (value.trim().parse().ok()?, sigma.trim().parse().ok()?);
        Some(ParameterPrior { name: name.trim().to_owned(), value, sigma })
    });
    parsed.filter(|prior| prior.sigma > 0.0).ok_or_else(|| "write name=value:sigma, for example f=5115:10".into())
}

impl From<MethodChoice> for Method {
    fn from(choice: MethodChoice) -> Self {
        match choice {
            MethodChoice::Bundle => Self::Bundle,
            MethodChoice::VariableWeights => Self::VariableWeights,
            MethodChoice::LeastSquares => Self::LeastSquares,
        }
    }
}

impl From<MisidentifyChoice> for MisidentificationKind {
    fn from(choice: MisidentifyChoice) -> Self {
        match choice {
            MisidentifyChoice::Random => Self::Random,
            MisidentifyChoice::NearNeighbour => Self::NearNeighbour,
            MisidentifyChoice::WrongCamera => Self::WrongCamera,
        }
    }
}

impl SolveArgs {
    /// The options of the solver: those of the file, with what the command line says in their place.
    pub(crate) fn options(&self, physics: &[&str], time_is_known: bool) -> Result<CalibrateOptions> {
        let mut options = match &self.options {
            None => CalibrateOptions::default(),
            Some(path) => {
                let text =
                    std::fs::read_to_string(path).with_context(|| format!("--options {}: the file cannot be read", path.display()))?;
                guarded(|| toml::from_str(&text))?.with_context(|| format!("--options {}", path.display()))?
            }
        };
        if let Some(names) = &self.solve {
            options.select_model = names.iter().any(|name| name == "auto");
            // `auto` chooses among the camera's parameters; effects named beside it are always solved.
            options.solve = names.iter().filter(|name| *name != "auto").cloned().collect();
        }
        options.priors.extend(self.prior.iter().cloned());
        if let Some(projection) = &self.projection {
            options.projection.clone_from(projection);
            options.projection_parameters = projection_start(projection);
        }
        options.attitudes = match self.attitudes {
            None => options.attitudes,
            Some(AttitudeChoice::Auto) => AttitudeModel::Auto,
            Some(AttitudeChoice::Free) => AttitudeModel::Free,
        };
        options.f_threshold = self.threshold.unwrap_or(options.f_threshold);
        options.max_iterations = self.max_iterations.map_or(options.max_iterations, usize::from);
        if self.options.is_none() || self.all_stars {
            options.leave_out_imprecise = !self.all_stars;
            options.proper_motion_only = time_is_known && !self.all_stars;
        }
        options.physics = physics.iter().map(|id| (*id).to_owned()).collect();
        Ok(options)
    }
}

/// Where the parameters of a projection begin that it has beyond x0, y0 and f: zero, as without them.
fn projection_start(id: &str) -> Vec<f64> {
    effects::displacement(id).map_or_else(Vec::new, |effect| vec![0.0; effect.parameters().len().saturating_sub(3)])
}

/// The control points of identified frames, some of them made wrong on purpose if that is asked for.
pub(crate) fn control_points(
    measured: &Measured,
    identified: &[IdentifiedFrame],
    catalog: &Catalog,
    args: &SolveArgs,
    trusted: bool,
) -> Result<PreparedPoints> {
    let mut prepared = boresight::pipeline::control_points(measured, identified, catalog, args.max_magnitude, trusted).map_err(trusting)?;
    let share = args.misidentify.unwrap_or(0.0);
    let (wrong, too_few) = misidentify(&mut prepared.points, catalog, share, args.misidentify_kind.into(), args.misidentify_seed);
    prepared.misidentified = wrong;
    prepared.notes.extend(too_few);
    Ok(prepared)
}

/// The error with the option that led to it.
pub(crate) fn trusting(error: PipelineError) -> anyhow::Error {
    match error {
        PipelineError::NoList => anyhow::Error::new(error).context("--trust-identifications"),
        other => other.into(),
    }
}

/// Whether stars were looked for and solved, and the answer is no; else it could not be tried.
pub(crate) fn is_an_answer(error: &CalibrateError) -> bool {
    matches!(
        error,
        CalibrateError::TooFewPoints { .. }
            | CalibrateError::TooFewPairs { .. }
            | CalibrateError::Diverged { .. }
            | CalibrateError::Singular { .. }
            | CalibrateError::Uncovered { .. }
            | CalibrateError::NoConsensus { .. }
            | CalibrateError::NoDegreesOfFreedom { .. }
    )
}

/// Calibrates, and prints the camera.
pub(crate) fn calibrate(args: &CalibrateArgs) -> Result<Answer> {
    let _folder = match &args.update.update {
        None => args.output.open("calibrate")?,
        Some(path) => {
            // What cannot be gone on from is said before the work.
            update::read(path)?;
            update::folder(path, &args.output)?
        }
    };
    let catalog = args.sky.catalog()?;
    let recording = pipeline::open(&args.input)?;
    check_sizes(&recording)?;
    let mut provenance = pipeline::provenance(&recording, Some(&args.sky))?;
    provenance.seed = args.solve.misidentify.map(|_| args.solve.misidentify_seed);
    let learns = !args.no_learnt_image && args.update.update.is_none() && args.method.is_none_or(|method| method == MethodChoice::Bundle);
    let measure = if learns { pipeline::measure_keeping_stars } else { pipeline::measure_as };
    let mut measured = measure(recording, &args.measure, args.search.time_limit(), &mut provenance)?;
    let choice = args.sky.choice();
    let identified = if args.trust_identifications {
        pipeline::take_identifications(&measured, &choice)?
    } else {
        pipeline::identify_frames(&measured, &catalog, &choice, &args.search.options(&measured))?
    };
    check_focal_lengths(&measured, &identified, &catalog)?;
    let points = control_points(&measured, &identified, &catalog, &args.solve, args.trust_identifications)?;
    if let Some(path) = &args.update.update {
        let notes = measured.recording.notes.iter().chain(&points.notes).cloned().collect();
        let new = NewFrames { points: &points.points, parity: points.parity, skipped: &measured.skipped, notes };
        return update::update(path, &args.update, new, provenance, &args.output);
    }
    let (options, uneven) = options(args, &measured, &identified, &points, &choice)?;
    tracing::info!(
        "solving by {} for {} from {} star images of {} frames",
        options.method.name(),
        output::listed(&options.solve),
        points.points.points.len(),
        points.points.attitudes.len()
    );
    let clock = output::Clock::new();
    let anew = options.method == Method::Bundle && !args.no_reidentify && !args.trust_identifications;
    let result = if anew {
        calibrate_identifying_anew(&points.points, &star_images(&measured, &points), &catalog, args.solve.max_magnitude, &options)
    } else {
        calibrate_points(&points.points, &options)
    };
    tracing::info!("solved in {clock}{}", if anew { ", the stars being identified anew with the improved camera" } else { "" });
    let mut calibration = match result {
        Ok(calibration) => calibration,
        Err(reason) if is_an_answer(&reason) => {
            let object = unsolved(&options, &reason, &points, provenance);
            let text = || format!("NOT CONVERGED: {}\n", object.warnings.join("\n"));
            output::deliver("calibrate", &object, args.output.json, args.output.output.as_deref(), text)?;
            return Ok(Answer::No);
        }
        Err(error) => return Err(error.into()),
    };
    let image = if learns { without_phase_bias(&mut calibration, &mut measured, points.parity, &options) } else { None };
    tell(&mut calibration, &measured, &points, uneven);
    calibration.warnings.extend(image.as_ref().map(LearntImage::sentence));
    let detector = detector_numbers(&measured);
    calibration.warnings.extend(detector.as_ref().map(|own| own.reason.clone()));
    calibration.provenance = Some(provenance);
    if let Some(directory) = &args.output.output {
        pictures::residuals(&directory.join("residuals.png"), &calibration)?;
        pictures::map_sigma(&directory.join("map_sigma.png"), &calibration)?;
    }
    let object = SolvedCamera {
        calibration: calibration.with_stored_columns(),
        skipped: &measured.skipped,
        notes: &measured.recording.notes,
        image,
        detector,
        misidentified_on_purpose: points.misidentified.iter().map(|wrong| misidentified(wrong, &points, &calibration)).collect(),
    };
    output::deliver("calibrate", &object, args.output.json, args.output.output.as_deref(), || calibrate_text::text(&object.calibration))?;
    Ok(if calibration.status == Status::Converged { Answer::Yes } else { Answer::No })
}

/// Learns the image of a star at the places of a solution, takes the bias that follows the pixel phase off the places, and solves once more. Nothing
/// changes where the stars show no image but the estimator's, or where the residuals do not fall.
fn without_phase_bias(
    calibration: &mut Calibration,
    measured: &mut Measured,
    parity: i8,
    options: &CalibrateOptions,
) -> Option<LearntImage> {
    if calibration.status != Status::Converged || measured.frames.iter().all(|frame| frame.kept.is_empty()) {
        return None;
    }
    let clock = output::Clock::new();
    let image = take_phase_bias_off(measured, calibration, parity, options);
    if image.is_some() {
        tracing::info!("image learnt and solved once more in {clock}");
    }
    image
}

/// How to solve, and what to mind of it.
fn options(
    args: &CalibrateArgs,
    measured: &Measured,
    identified: &[IdentifiedFrame],
    points: &PreparedPoints,
    choice: &SkyChoice,
) -> Result<(CalibrateOptions, Option<String>)> {
    let moved = measured.times_are_known() && identified.iter().all(|frame| frame.sky.ids().contains(&ids::PROPER_MOTION));
    let (physics, uneven) = pipeline::physics_in_force(identified);
    let mut options = args.solve.options(&physics, moved)?;
    options.method = args.method.map_or(options.method, Method::from);
    // What is not asked for is what the data support; who names the parameters, or reads them from a file, has them so.
    let names_none = args.solve.solve.is_none() && args.solve.options.is_none();
    options.extend_model |= names_none && options.method == Method::Bundle;
    if args.solve.projection.is_none() && args.solve.options.is_none() {
        points.points.projection.id().clone_into(&mut options.projection);
    }
    if options.method == Method::Bundle {
        let known = known_behind_the_lens(measured, points, choice)?;
        options.physics.extend(known.iter().map(|term| term.effect.clone()));
        let given: Vec<String> = options.terms.iter().map(|term| term.effect.clone()).collect();
        options.terms.extend(known.into_iter().filter(|term| !given.contains(&term.effect)));
        if points.parity < 0 {
            unmirror_priors(&mut options, points.points.nominal.width_px);
        }
    }
    Ok((options, uneven))
}

/// Adds to a calibration what follows from its recording: parity, what is not modelled, names of frames, what to mind.
fn tell(calibration: &mut Calibration, measured: &Measured, points: &PreparedPoints, uneven: Option<String>) {
    calibration.parity = points.parity;
    calibration.systematics = calibration.unmodelled(surroundings(&measured.recording));
    calibration.warnings.extend(calibration.systematics.iter().map(|systematic| systematic.sentence.clone()).collect::<Vec<_>>());
    for warning in &mut calibration.warnings {
        *warning = with_name(warning, &measured.recording);
    }
    calibration.warnings.extend(uneven);
    calibration.warnings.extend(points.notes.iter().cloned());
    if !measured.times_are_known() {
        calibration.warnings.push(
            "the time of the frames is not known: stars are taken where they stood at J2000.0 (with --physics none, at the catalogue's epoch), and those that moved since are off".to_owned(),
        );
    }
}

fn misidentified(wrong: &Misidentification, points: &PreparedPoints, calibration: &Calibration) -> MisidentifiedPoint {
    let point = &points.points.points[wrong.point];
    MisidentifiedPoint {
        frame: point.frame,
        x_px: calibration.stored_column_px(point.x_px),
        y_px: point.y_px,
        true_hip: wrong.true_hip,
        given_hip: wrong.given_hip,
        error_arcsec: wrong.error_rad / ARCSEC_RAD,
    }
}

fn unsolved(options: &CalibrateOptions, reason: &CalibrateError, points: &PreparedPoints, provenance: Provenance) -> UnsolvedCamera {
    UnsolvedCamera {
        format: boresight::calibrate::FORMAT,
        method: options.method,
        status: Status::NotConverged,
        reason: reason.to_string(),
        physics: options.physics.clone(),
        model: options.solve.clone(),
        parameters: [],
        camera: None,
        stars: 0,
        stars_offered: points.points.points.len(),
        warnings: std::iter::once(reason.to_string()).chain(points.notes.iter().cloned()).collect(),
        provenance,
    }
}

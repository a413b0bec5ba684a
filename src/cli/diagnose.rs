//! `boresight diagnose`: which physical effect the model lacks, how large it is, which rivals remain, and what is left.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use boresight::detect::LearntImage;
use boresight::diagnose::{
    AnsweredDiagnosis, DeclaredDetector, DiagnoseError, DiagnoseOptions, Diagnosis, FORMAT, ImageMeasurements, MeasuredNoise, Step,
    UnaskedDiagnosis, Verdict, diagnose_recording,
};
use boresight::guard::guarded;
use boresight::pipeline::{
    DiagnosisInput, DiagnosisRequest, PipelineError, PreparedPoints, SkyChoice, check_sizes, diagnosis_request, looks_through_air,
    measured_noise, sky_views, stamp_camera, star_measurements,
};
use boresight::provenance::Provenance;
use boresight::recording::check_file;
use clap::Args;

use super::calibrate::{SolveArgs, control_points, is_an_answer, parameter_name};
use super::identify::SearchArgs;
use super::options::{InputArgs, MeasureArgs, OutputArgs, SkyArgs, heading};
use super::pipeline::Measured;
use super::{Answer, diagnose_files, diagnose_text, output, pipeline, write_camera};

/// Arguments of `diagnose`.
#[derive(Debug, Args)]
pub(crate) struct DiagnoseArgs {
    #[command(flatten)]
    input: InputArgs,
    #[command(flatten)]
    measure: MeasureArgs,
    #[command(flatten)]
    sky: SkyArgs,
    #[command(flatten)]
    search: SearchArgs,
    /// Read options from this TOML file (nulls, alpha, seed, solve, terms, `proper_motion_only`); options of the command line take precedence
    #[arg(long, value_name = "FILE", help_heading = heading::STATISTICS)]
    options: Option<PathBuf>,
    /// Minimum number of null simulations for the omnibus test [default: 1000]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000), help_heading = heading::STATISTICS)]
    nulls: Option<u32>,
    /// Family-wise probability of a false finding in a recording [default: 3e-4]
    #[arg(long, value_name = "P", value_parser = probability, help_heading = heading::STATISTICS)]
    alpha: Option<f64>,
    /// Split-half validation: N random half-splits of the frames, whose p-values must be uniform
    #[arg(long = "split-half", alias = "half-nights", value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000), help_heading = heading::STATISTICS)]
    half_nights: Option<u32>,
    /// Seed of the simulations and permutations [default: 0]
    #[arg(long, value_name = "N", help_heading = heading::STATISTICS)]
    seed: Option<u64>,
    /// Free camera parameters of the baseline model [default: x0,y0,f,k1,p1,p2]
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = parameter_name, help_heading = heading::MODEL)]
    solve: Option<Vec<String>>,
    /// Use only stars brighter than this V magnitude
    #[arg(long, value_name = "V", allow_negative_numbers = true, help_heading = heading::CATALOGUE)]
    max_magnitude: Option<f64>,
    /// Use stars without known proper motion too, at their catalogue places
    #[arg(long, help_heading = heading::CATALOGUE)]
    all_stars: bool,
    /// Take the identifications of a star list (`hip`, or `ra_deg` and `dec_deg`) as they are, instead of making our own
    #[arg(long, help_heading = heading::SEARCH)]
    trust_identifications: bool,
    /// Use analytic columns only; do not render the recording's stars (faster, less accurate)
    #[arg(long, help_heading = heading::MODEL)]
    formulas: bool,
    /// Write camera and sky with the findings into this scene, for `boresight simulate`
    #[arg(long, value_name = "FILE", help_heading = heading::OUTPUT)]
    write_camera: Option<PathBuf>,
    #[command(flatten)]
    output: OutputArgs,
}

/// All stars take part where fewer than one in so many has a known proper motion.
const MIN_MOVING: usize = 5;
/// Noise off by this factor is said.
const NOISE_OFF: f64 = 1.3;

fn probability(text: &str) -> std::result::Result<f64, String> {
    text.parse::<f64>().ok().filter(|value| *value > 0.0 && *value < 1.0).ok_or_else(|| "give a probability between 0 and 1".into())
}

impl DiagnoseArgs {
    /// The options of the diagnosis: those of the file, with what the command line says in their place.
    fn options(&self) -> Result<DiagnoseOptions> {
        let (mut options, is_given) = match &self.options {
            None => (DiagnoseOptions::default(), false),
            Some(path) => {
                let name = path.display();
                let text = std::fs::read_to_string(path).with_context(|| format!("--options {name}: the file cannot be read"))?;
                let table: toml::Table = guarded(|| toml::from_str(&text))?.with_context(|| format!("--options {name}"))?;
                let is_given = table.contains_key("proper_motion_only");
                (guarded(|| toml::from_str(&text))?.with_context(|| format!("--options {name}"))?, is_given)
            }
        };
        options.nulls = self.nulls.map_or(options.nulls, |nulls| nulls as usize);
        if !(1..=1_000_000).contains(&options.nulls) {
            let name = self.options.as_deref().unwrap_or(std::path::Path::new("")).display();
            bail!("--options {name}: nulls = {}: give 1 to 1000000", options.nulls);
        }
        options.alpha = self.alpha.unwrap_or(options.alpha);
        options.half_nights = self.half_nights.map_or(options.half_nights, |splits| splits as usize);
        options.seed = self.seed.unwrap_or(options.seed);
        if let Some(solve) = &self.solve {
            options.solve.clone_from(solve);
        }
        // A star whose motion is not known is off by more than it is measured to.
        if !is_given || self.all_stars {
            options.proper_motion_only = !self.all_stars;
        }
        Ok(options)
    }
}

/// Why nothing can be said of frames that could be read: too few stars, or none that lead to a camera. `None`: it could not be tried.
fn no_answer(error: &anyhow::Error) -> Option<String> {
    let of_diagnosis = error.downcast_ref::<DiagnoseError>();
    let error = of_diagnosis.or_else(|| match error.downcast_ref::<PipelineError>() {
        Some(PipelineError::Baseline(error)) => Some(error),
        _ => None,
    })?;
    let is_no = match error {
        DiagnoseError::TooFew { .. } => true,
        DiagnoseError::Baseline(reason) => is_an_answer(reason),
        _ => false,
    };
    is_no.then(|| error.to_string())
}

/// Diagnoses, and prints a page.
pub(crate) fn diagnose(args: &DiagnoseArgs) -> Result<Answer> {
    let _folder = args.output.open("diagnose")?;
    if let Some(path) = &args.write_camera {
        check_file(path, args.output.force)?;
    }
    let mut of_input = output::provenance();
    let done = diagnose_into(args, &mut of_input);
    let Some(reason) = done.as_ref().err().and_then(no_answer) else { return done };
    let text = format!("UNDECIDED: {reason}\n");
    let object = UnaskedDiagnosis { format: FORMAT, verdict: Verdict::Undecided, reason, findings: [], provenance: of_input };
    output::deliver("diagnose", &object, args.output.json, args.output.output.as_deref(), || text)?;
    Ok(Answer::No)
}

/// The same; what was read goes into `of_input` as soon as it is known.
fn diagnose_into(args: &DiagnoseArgs, of_input: &mut Provenance) -> Result<Answer> {
    let catalog = args.sky.catalog()?;
    let recording = pipeline::open(&args.input)?;
    check_sizes(&recording)?;
    let mut provenance = pipeline::provenance(&recording, Some(&args.sky))?;
    let mut measured = pipeline::measure_with_pixels(recording, &args.measure, args.search.time_limit(), &mut provenance)?;
    let mut options = args.options()?;
    provenance.seed = Some(options.seed);
    of_input.clone_from(&provenance);
    let choice = args.sky.choice_of_diagnosis();
    let identified = if args.trust_identifications {
        pipeline::take_identifications(&measured, &choice)?
    } else {
        pipeline::identify_frames(&measured, &catalog, &choice, &args.search.options(&measured))?
    };
    let limits = SolveArgs { max_magnitude: args.max_magnitude, ..SolveArgs::default() };
    let prepared = control_points(&measured, &identified, &catalog, &limits, args.trust_identifications)?;
    let moving = prepared.points.points.iter().filter(|point| point.has_proper_motion).count();
    let too_few_move = options.proper_motion_only && MIN_MOVING * moving < prepared.points.points.len();
    options.proper_motion_only &= !too_few_move;
    let asked =
        DiagnosisInput { catalog: &catalog, choice: &choice, max_magnitude: args.max_magnitude, trusted: args.trust_identifications };
    let DiagnosisRequest { points, telemetry, mut options, image, notes, .. } =
        diagnosis_request(&mut measured, &identified, &prepared, &asked, options)?;
    // What is rendered is measured by the Gaussian fit: columns for other places would be those of another estimator.
    options.looks = options.looks.filter(|_| args.measure.is_gaussian() && !args.formulas);
    tracing::info!(
        "{} star images of {} frames are held against {}; physics in force: {}",
        points.points.len(),
        points.attitudes.len(),
        options.solve.join(", "),
        output::listed(&options.physics)
    );
    let (bar, clock) = (output::steps(Step::COUNT), output::Clock::new());
    let stars = star_measurements(&measured, &points, prepared.parity);
    let camera = &measured.recording.camera;
    let detector = DeclaredDetector::from(camera);
    let exposures_s: Vec<Option<f64>> = measured.recording.frames.iter().map(|frame| frame.exposure_s).collect();
    let views = sky_views(&measured, &points, prepared.parity);
    let images = ImageMeasurements {
        stars: &stars,
        pixels: measured.pixels.as_ref(),
        detector,
        views: &views,
        exposures_s: &exposures_s,
        looks_through_air: looks_through_air(&measured.recording),
        stamps: stamp_camera(&measured, &points).filter(|_| !args.formulas),
    };
    let result = diagnose_recording(&points, &telemetry, &images, &options, &|step| {
        bar.set_position(step.number() as u64);
        bar.set_message(step.words());
        tracing::info!("{} (after {clock})", step.words());
    });
    bar.finish_and_clear();
    let mut diagnosis = result?;
    tracing::info!("diagnosed in {clock}: {} findings", diagnosis.findings.len());
    diagnosis.warnings.extend(warnings(args, &measured, &prepared, &choice));
    diagnosis.warnings.extend(notes);
    if too_few_move {
        let all = prepared.points.points.len();
        diagnosis.warnings.push(format!("only {moving} of {all} star images are of stars with a known proper motion: all take part"));
    }
    diagnosis.noise.measured = measured_noise(&measured);
    diagnosis.warnings.extend(image.as_ref().map(LearntImage::sentence));
    diagnosis.image = image;
    diagnosis.warnings.extend(noise_warning(&diagnosis.noise.measured));
    if let Some(path) = &args.write_camera {
        let more = write_camera::write(path, &diagnosis, &points, &measured, &catalog, options.seed)?;
        diagnosis.warnings.extend(more);
    }
    finish(args, diagnosis, &measured, &prepared, options.alpha, provenance)
}

/// Writes everything in the columns of the images as stored.
fn finish(
    args: &DiagnoseArgs,
    mut diagnosis: Diagnosis,
    measured: &Measured,
    prepared: &PreparedPoints,
    alpha: f64,
    provenance: Provenance,
) -> Result<Answer> {
    diagnosis.provenance = Some(provenance);
    let size = (prepared.points.nominal.width_px, prepared.points.nominal.height_px);
    if prepared.parity < 0 {
        store_columns(&mut diagnosis, size.0);
    }
    if let Some(directory) = &args.output.output {
        diagnose_files::write(directory, &mut diagnosis, measured, size, alpha)?;
    }
    let object =
        AnsweredDiagnosis { diagnosis: &diagnosis, parity: prepared.parity, skipped: &measured.skipped, notes: &measured.recording.notes };
    output::deliver("diagnose", &object, args.output.json, args.output.output.as_deref(), || diagnose_text::text(&diagnosis))?;
    Ok(if matches!(diagnosis.verdict, Verdict::Unexplained | Verdict::Undecided) { Answer::No } else { Answer::Yes })
}

/// Images whose noise is not as the camera is said to have it.
fn noise_warning(measured: &MeasuredNoise) -> Option<String> {
    let ratio = measured.background_ratio.filter(|ratio| !(1.0 / NOISE_OFF..NOISE_OFF).contains(ratio))?;
    Some(format!(
        "the background scatters {ratio:.2} times as much as gain_e_per_dn, bias_dn and read_noise_e say: one of them is not as declared, or the frames have been processed"
    ))
}

/// What is to be minded of how the points came about.
fn warnings(args: &DiagnoseArgs, measured: &Measured, prepared: &PreparedPoints, choice: &SkyChoice) -> Vec<String> {
    let mut warnings = prepared.notes.clone();
    if !measured.times_are_known() {
        let where_taken = if choice.assumes_time {
            "stars are taken where they stood at J2000.0"
        } else {
            "stars are taken where the catalogue has them"
        };
        warnings.push(format!(
            "the time of the frames is not known: {where_taken}, and those that moved since are off; what needs the time is not judged"
        ));
    }
    if !args.measure.is_gaussian() {
        warnings.push(
            "places are not those of the Gaussian fit (--centroid): what is known of effects within a pixel, such as the S-curve, is of that fit"
                .to_owned(),
        );
    }
    if args.all_stars {
        warnings.push("stars whose proper motion is not known take part, and are off by it".to_owned());
    }
    if prepared.parity < 0 {
        warnings.push("the images are mirrored: columns are those of the images as stored, parameters are those of the un-mirrored image (x replaced by width − 1 − x)".to_owned());
    }
    warnings
}

/// From the columns of the un-mirrored image to those of the images as stored.
fn store_columns(diagnosis: &mut Diagnosis, width_px: usize) {
    let flip = |x_px: &mut f64| *x_px = width_px as f64 - 1.0 - *x_px;
    for row in &mut diagnosis.residuals {
        flip(&mut row.x_px);
        for residual in [&mut row.before_px, &mut row.after_px] {
            residual[0] = -residual[0];
        }
    }
    for point in diagnosis.unknown.iter_mut().flat_map(|unknown| &mut unknown.field.points) {
        flip(&mut point[0]);
        point[2] = -point[2];
    }
    for profile in &mut diagnosis.profiles {
        let turned = matches!(profile.component.as_str(), "along x" | "across the radius");
        for bin in &mut profile.bins {
            bin.at = mirrored(&profile.covariate, bin.at, width_px as f64);
            if turned {
                (bin.mean, bin.model) = (-bin.mean, -bin.model);
            }
        }
    }
}

/// A covariate's value in the mirrored image.
fn mirrored(covariate: &str, value: f64, width_px: f64) -> f64 {
    match covariate {
        "x" => width_px - 1.0 - value,
        "column-half" => 1.0 - value,
        "pixel-phase-x" => -value,
        "pixel-parity-x" => (width_px - value).rem_euclid(2.0),
        "field-azimuth" => {
            let turned = std::f64::consts::PI - value;
            turned.sin().atan2(turned.cos())
        }
        _ => value,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn covariates_are_those_of_the_mirrored_image() {
        for (x, width) in [(3.2_f64, 10.0_f64), (7.9, 11.0)] {
            let other = width - 1.0 - x;
            let phase = |x: f64| (x + 0.5).rem_euclid(1.0) - 0.5;
            let parity = |x: f64| (x + 0.5).rem_euclid(2.0);
            let azimuth = |x: f64| 2.0_f64.atan2(x - (width - 1.0) / 2.0);
            let half = |x: f64| f64::from(u8::from(x > (width - 1.0) / 2.0));
            for (name, here, there) in [
                ("x", x, other),
                ("pixel-phase-x", phase(x), phase(other)),
                ("pixel-parity-x", parity(x), parity(other)),
                ("field-azimuth", azimuth(x), azimuth(other)),
                ("column-half", half(x), half(other)),
                ("y", 4.0, 4.0),
            ] {
                let found = mirrored(name, here, width);
                assert!((found - there).abs() < 1e-12, "{name}: {found} instead of {there}");
            }
        }
    }
}

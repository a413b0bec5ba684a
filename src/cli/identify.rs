//! `boresight identify`: says which stars are in the images.

use std::path::Path;
use std::time::Duration;

use anyhow::Result;
use boresight::camera::{Camera, SkyChain};
use boresight::catalog::Catalog;
use boresight::effects::ids;
use boresight::effects::{StarImage, StarState};
use boresight::exchange::Places;
use boresight::identify::{
    AttitudePrior, ControlPoint, ControlPoints, FORMAT, FrameStatus, Identification, IdentifyFrameResult, IdentifyOptions, IdentifyResult,
    MisnamedMatch, NamedStar, Solution, misidentify,
};
use boresight::report;
use boresight::units::DEG_RAD;
use clap::Args;

use super::calibrate::MisidentifyChoice;
use super::identify_files::{self, MatchRow};
use super::options::{InputArgs, MeasureArgs, OutputArgs, SkyArgs, heading};
use super::pipeline::{IdentifiedFrame, Measured};
use super::{Answer, output, pipeline};

/// Arguments of `identify`.
#[derive(Debug, Args)]
pub(crate) struct IdentifyArgs {
    #[command(flatten)]
    input: InputArgs,
    #[command(flatten)]
    measure: MeasureArgs,
    #[command(flatten)]
    sky: SkyArgs,
    #[command(flatten)]
    search: SearchArgs,
    /// Misidentify this share of the matches deliberately; the result lists which
    #[arg(long, value_name = "SHARE", value_parser = super::calibrate::share, help_heading = heading::TRIAL)]
    misidentify: Option<f64>,
    /// Which wrong star (of `random` ones, which are directions without a star, the match is left out)
    #[arg(long, value_enum, default_value_t = MisidentifyChoice::NearNeighbour, value_name = "KIND", help_heading = heading::TRIAL)]
    misidentify_kind: MisidentifyChoice,
    /// Seed of the deliberate misidentification
    #[arg(long, value_name = "SEED", default_value_t = 0, help_heading = heading::TRIAL)]
    misidentify_seed: u64,
    /// With -o: also write every identified frame as FITS with world coordinates (TAN-SIP) in its header
    #[arg(long, requires = "output", help_heading = heading::OUTPUT)]
    fits: bool,
    /// With -o: what the world coordinates map the pixels to: places of the catalogue (ICRS, at the frame's epoch; aberration and refraction are in the
    /// map), or the directions of the light as it arrives (apparent)
    #[arg(long, value_name = "catalog|apparent", default_value = "catalog", help_heading = heading::OUTPUT)]
    wcs: Places,
    #[command(flatten)]
    output: OutputArgs,
}

/// How the stars are searched for.
#[derive(Debug, Args)]
#[command(next_help_heading = heading::SEARCH)]
pub(crate) struct SearchArgs {
    /// Focal length in pixels, if the recording states none; without one, all fields from 3° to 90° are tried, and fisheyes
    #[arg(long, value_name = "PX", value_parser = positive, allow_negative_numbers = true)]
    pub(crate) focal_length_px: Option<f64>,
    /// Prior pointing: right ascension and declination of the middle of the frames, degrees, and optionally the position angle of their
    /// upward direction, from north through east
    #[arg(long, value_name = "RA,DEC[,ROLL]", value_parser = pointing, allow_hyphen_values = true)]
    pub(crate) near: Option<Pointing>,
    /// Radius of the search about --near
    #[arg(long, value_name = "DEG", value_parser = angle, default_value_t = 10.0, allow_negative_numbers = true)]
    pub(crate) near_within_deg: f64,
    /// Give up on a frame after this time, measuring included (the answer may then depend on the machine)
    #[arg(long, alias = "time-limit", value_name = "SECONDS", value_parser = positive, allow_negative_numbers = true)]
    pub(crate) time_limit_s: Option<f64>,
}

/// Where a camera points: right ascension, declination and, if known, roll, degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pointing {
    radec_deg: [f64; 2],
    roll_deg: Option<f64>,
}

/// Reads a pointing.
fn pointing(text: &str) -> std::result::Result<Pointing, String> {
    let numbers: Vec<f64> = text.split(',').map_while(|part| part.trim().parse().ok()).filter(|number: &f64| number.is_finite()).collect();
    let told = (numbers.len() == text.split(',').count()).then_some(&numbers[..]);
    let pointing = match told {
        Some(&[ra_deg, dec_deg]) => Some(Pointing { radec_deg: [ra_deg, dec_deg], roll_deg: None }),
        Some(&[ra_deg, dec_deg, roll_deg]) => Some(Pointing { radec_deg: [ra_deg, dec_deg], roll_deg: Some(roll_deg) }),
        _ => None,
    };
    let on_the_sky = pointing.filter(|Pointing { radec_deg: [ra, dec], .. }| ra.abs() <= 360.0 && dec.abs() <= 90.0);
    on_the_sky
        .ok_or_else(|| "write right ascension and declination in degrees, and the roll if it is known: 83.8,-5.4 or 83.8,-5.4,120".into())
}

/// Reads an angle above 0° and not above 180°.
fn angle(text: &str) -> std::result::Result<f64, String> {
    positive(text).ok().filter(|degrees| *degrees <= 180.0).ok_or_else(|| "give a number of degrees above 0 and not above 180".into())
}

/// Reads a number above 0.
pub(crate) fn positive(text: &str) -> std::result::Result<f64, String> {
    text.parse::<f64>().ok().filter(|value| value.is_finite() && *value > 0.0).ok_or_else(|| "give a number above 0".into())
}

impl SearchArgs {
    /// What a frame may take; a time too long for the clock is no limit.
    pub(crate) fn time_limit(&self) -> Option<Duration> {
        self.time_limit_s.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok())
    }

    /// The options of the search for this recording.
    pub(crate) fn options(&self, measured: &Measured) -> IdentifyOptions {
        IdentifyOptions {
            nominal_focal_length_px: self.focal_length_px.or(measured.recording.camera.nominal_focal_length_px()),
            near: self.near.map(|near| {
                let roll_rad = near.roll_deg.map(|roll| roll * DEG_RAD);
                let [ra_rad, dec_rad] = near.radec_deg.map(|degrees| degrees * DEG_RAD);
                AttitudePrior::pointing(ra_rad, dec_rad, roll_rad, self.near_within_deg * DEG_RAD)
            }),
            time_limit: self.time_limit(),
            ..IdentifyOptions::default()
        }
    }
}

/// A frame as the result has it.
fn shown_frame(frame: &pipeline::MeasuredFrame, identified: &IdentifiedFrame, catalog: &Catalog, time_known: bool) -> IdentifyFrameResult {
    let mut object = IdentifyFrameResult {
        file: frame.name.clone(),
        status: FrameStatus::NotIdentified,
        reason: None,
        centre_radec_deg: None,
        centre_epoch_yr: None,
        time_known,
        roll_deg: None,
        focal_length_px: None,
        width_deg: None,
        height_deg: None,
        stars_detected: frame.detections.stars.len(),
        stars_matched: 0,
        rms_px: None,
        false_match_probability: None,
        camera_from_icrs: None,
        parity: None,
        projection: None,
        camera: None,
        matches: Vec::new(),
        seconds: identified.seconds,
    };
    match &identified.identification {
        Identification::NotIdentified { reason, .. } => object.reason = Some(reason.to_string()),
        Identification::Identified(solution) => fill(&mut object, frame, identified, solution, catalog),
    }
    object
}

/// Adds what its solution says.
fn fill(
    object: &mut IdentifyFrameResult,
    frame: &pipeline::MeasuredFrame,
    identified: &IdentifiedFrame,
    solution: &Solution,
    catalog: &Catalog,
) {
    let (ra, dec) = identified.sky.icrs_from_apparent(&solution.centre()).radec_rad();
    object.status = FrameStatus::Identified;
    object.centre_radec_deg = Some([ra / DEG_RAD, dec / DEG_RAD]);
    let moved = identified.sky.ids().contains(&ids::PROPER_MOTION);
    object.centre_epoch_yr = identified.sky.observation().epoch_yr.filter(|_| moved).or(Some(catalog.epoch_yr));
    object.roll_deg = Some(solution.roll_deg());
    object.focal_length_px = Some(solution.camera.focal_length_px);
    object.width_deg = Some(solution.width_deg());
    object.height_deg = Some(solution.height_deg());
    object.stars_matched = solution.matches.len();
    object.rms_px = Some(solution.rms_px);
    object.false_match_probability = Some(solution.false_match_probability);
    object.camera_from_icrs = Some(solution.attitude.into());
    object.parity = Some(solution.parity);
    object.projection = Some(solution.projection.id());
    object.camera = Some(if solution.parity < 0 { solution.camera.mirrored() } else { solution.camera });
    object.matches = solution
        .matches
        .iter()
        .map(|matched| {
            let (star, detection) = (&catalog.stars[matched.star], &frame.detections.stars[matched.detection]);
            NamedStar {
                detection: matched.detection,
                hip: star.hip,
                name: catalog.name(star),
                x_px: detection.x_px,
                y_px: detection.y_px,
                residual_px: matched.residual_px,
                magnitude: star.magnitude,
                flux_dn: detection.flux_dn,
            }
        })
        .collect();
}

/// The frames as the result has them. Unless files of their detections are written too, these go as the frames come: there may be millions.
fn shown_frames(measured: &mut Measured, identified: &[IdentifiedFrame], catalog: &Catalog, keep: bool) -> Vec<IdentifyFrameResult> {
    let mut shown = Vec::with_capacity(identified.len());
    for (frame, identified) in measured.frames.iter_mut().zip(identified) {
        let time_known = measured.recording.frames[frame.index].time_utc.is_some();
        shown.push(shown_frame(frame, identified, catalog, time_known));
        if !keep {
            frame.detections.stars = Vec::new();
        }
    }
    shown
}

/// The rows of a frame's matches.
fn rows<'a>(shown: &'a IdentifyFrameResult, frame: usize, catalog: &'a Catalog, sky: &'a SkyChain) -> impl Iterator<Item = MatchRow<'a>> {
    shown.matches.iter().map(move |named| {
        let star = catalog.by_hip(named.hip);
        let place = star.map(|star| sky.place(star, catalog.epoch_yr));
        let (ra, dec) = place.map_or((f64::NAN, f64::NAN), |(place, _)| place.radec_rad());
        MatchRow {
            frame,
            file: &shown.file,
            detection: named.detection,
            hip: named.hip,
            name: named.name,
            ra_deg: ra / DEG_RAD,
            dec_deg: dec / DEG_RAD,
            epoch_yr: place.map_or(f64::NAN, |(_, epoch_yr)| epoch_yr),
            magnitude: named.magnitude,
            colour_mag: star.and_then(|star| star.colour),
            x_px: named.x_px,
            y_px: named.y_px,
            residual_x_px: named.residual_px[0],
            residual_y_px: named.residual_px[1],
            flux_dn: named.flux_dn,
        }
    })
}

/// Identifies, and prints a line a frame.
pub(crate) fn identify(args: &IdentifyArgs) -> Result<Answer> {
    let _folder = args.output.open("identify")?;
    let catalog = args.sky.catalog()?;
    let recording = pipeline::open(&args.input)?;
    let mut provenance = pipeline::provenance(&recording, Some(&args.sky))?;
    let mut measured = pipeline::measure_stars(recording, &args.measure, args.search.time_limit(), &mut provenance)?;
    let options = args.search.options(&measured);
    let identified = pipeline::identify_frames(&measured, &catalog, &args.sky.choice(), &options)?;
    let mut frames = shown_frames(&mut measured, &identified, &catalog, args.output.output.is_some());
    let (misidentified_on_purpose, too_few) = match args.misidentify {
        Some(share) => misname(&mut frames, &identified, &catalog, share, args),
        None => (Vec::new(), None),
    };
    if let Some(sentence) = &too_few {
        tracing::warn!("{sentence}");
    }
    provenance.seed = args.misidentify.map(|_| args.misidentify_seed);
    let all = frames.iter().all(|frame| frame.status == FrameStatus::Identified);
    let (physics, uneven) = pipeline::physics_in_force(&identified);
    let object = IdentifyResult {
        format: FORMAT,
        frames,
        physics,
        skipped: &measured.skipped,
        notes: measured.recording.notes.iter().map(String::as_str).chain(uneven.as_deref()).chain(too_few.as_deref()).collect(),
        misidentified_on_purpose,
        catalog: &catalog.source,
        provenance,
    };
    if let Some(directory) = &args.output.output {
        write_files(directory, &measured, &identified, &object, &catalog, args)?;
    }
    output::deliver("identify", &object, args.output.json, args.output.output.as_deref(), || text(&object.frames))?;
    Ok(if all { Answer::Yes } else { Answer::No })
}

/// Writes tables, regions, world coordinates and pictures.
fn write_files(
    directory: &Path,
    measured: &Measured,
    identified: &[IdentifiedFrame],
    object: &IdentifyResult<'_>,
    catalog: &Catalog,
    args: &IdentifyArgs,
) -> Result<()> {
    let rows: Vec<MatchRow<'_>> = measured
        .frames
        .iter()
        .zip(identified)
        .zip(&object.frames)
        .flat_map(|((frame, own), shown)| rows(shown, frame.index, catalog, &own.sky))
        .collect();
    identify_files::write_matches(directory, &rows, &object.provenance)?;
    identify_files::write_detections(directory, &measured.frames, &object.provenance)?;
    let bar = output::progress("writing", measured.frames.len());
    for (frame, identified) in measured.frames.iter().zip(identified) {
        identify_files::write_regions(directory, frame, &identify_files::marks(frame, Some(identified), catalog))?;
        identify_files::write_world_coordinates(directory, measured, frame, identified, args.wcs, args.fits)?;
        let path = identify_files::frame_path(directory, frame, "png");
        identify_files::write_picture(&path, measured, frame, Some(identified), catalog)?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(())
}

/// Gives a share of the matches a wrong star. A match that gets a direction without a star is taken out. The second value is a sentence if
/// they are fewer than asked for.
fn misname(
    frames: &mut [IdentifyFrameResult],
    identified: &[IdentifiedFrame],
    catalog: &Catalog,
    share: f64,
    args: &IdentifyArgs,
) -> (Vec<MisnamedMatch>, Option<String>) {
    let mut places = Vec::new();
    let mut points = Vec::new();
    for (frame, (object, identified)) in frames.iter().zip(identified).enumerate() {
        let matches = identified.solution().map_or(&[][..], |solution| &solution.matches);
        for (index, (matched, shown)) in matches.iter().zip(&object.matches).enumerate() {
            let star = &catalog.stars[matched.star];
            places.push((frame, index));
            points.push(ControlPoint {
                frame,
                hip: star.hip,
                direction: identified.direction(catalog, matched.star),
                x_px: shown.x_px,
                y_px: shown.y_px,
                covariance_px2: [0.0; 3],
                catalog_sigma_rad: 0.0,
                has_proper_motion: star.proper_motion_rad_yr.is_some(),
                magnitude: star.magnitude,
                colour: star.colour,
                star: StarState::of(star, catalog.epoch_yr),
                image: StarImage::default(),
            });
        }
    }
    let attitudes = identified.iter().map(|identified| identified.solution().map(|solution| solution.attitude)).collect();
    let mut points = ControlPoints::new(Camera::pinhole(1, 1, 1.0), attitudes, points);
    let (wrong, too_few) = misidentify(&mut points, catalog, share, args.misidentify_kind.into(), args.misidentify_seed);
    // From the last to the first, so that taking one out moves none that is still to come.
    let mut listed: Vec<MisnamedMatch> = wrong
        .iter()
        .rev()
        .map(|wrong| {
            let (frame, index) = places[wrong.point];
            let object = &mut frames[frame];
            let (x_px, y_px) = (object.matches[index].x_px, object.matches[index].y_px);
            match wrong.given_hip.and_then(|hip| catalog.by_hip(hip)) {
                Some(star) => {
                    let shown = &mut object.matches[index];
                    (shown.hip, shown.name, shown.magnitude) = (star.hip, catalog.name(star), star.magnitude);
                }
                None => {
                    object.matches.remove(index);
                }
            }
            let error_arcsec = wrong.error_rad / boresight::units::ARCSEC_RAD;
            MisnamedMatch { file: object.file.clone(), x_px, y_px, true_hip: wrong.true_hip, given_hip: wrong.given_hip, error_arcsec }
        })
        .collect();
    listed.reverse();
    (listed, too_few)
}

fn text(frames: &[IdentifyFrameResult]) -> String {
    let number = |value: Option<f64>, digits: usize| value.map_or_else(String::new, |value| format!("{value:.digits$}"));
    let rows: Vec<Vec<String>> = frames
        .iter()
        .map(|frame| {
            vec![
                frame.file.clone(),
                frame.status.name().to_owned(),
                number(frame.centre_radec_deg.map(|centre| centre[0]), 4),
                number(frame.centre_radec_deg.map(|centre| centre[1]), 4),
                number(frame.roll_deg, 3),
                number(frame.width_deg, 3),
                number(frame.focal_length_px, 1),
                format!("{}/{}", frame.stars_matched, frame.stars_detected),
                number(frame.rms_px, 3),
                frame.false_match_probability.map_or_else(String::new, |p| format!("{p:.0e}")),
                format!("{:.2}", frame.seconds),
            ]
        })
        .collect();
    let header = ["frame", "status", "RA/deg", "Dec/deg", "roll/deg", "width/deg", "f/px", "stars", "rms/px", "P(false)", "s"];
    let mut text = report::table(&header, &rows);
    for frame in frames {
        if let Some(reason) = &frame.reason {
            text += &format!("{}: {reason}\n", frame.file);
        }
        if let Some(projection) = frame.projection.filter(|id| *id != ids::PINHOLE) {
            text += &format!("{}: a fisheye, {projection}\n", frame.file);
        }
    }
    text
}

//! What `identify -o` and `detect -o` write beside their result: tables, headers with world coordinates, regions, pictures.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use boresight::camera::SkyChain;
use boresight::catalog::{Catalog, constellation_lines};
use boresight::coordinates::{Apparent, Direction};
use boresight::detect::Detection;
use boresight::exchange::{self, Format, Places, Subject, SubjectFrame};
use boresight::identify::Solution;
use boresight::provenance::Provenance;
use boresight::recording::{FitsHeaders, write_file, write_fits_with};
use boresight::report::{self, DataTable, Figure, Mark, MarkKind};
use serde::Serialize;

use super::pipeline::{IdentifiedFrame, Measured, MeasuredFrame};

/// The largest distance between two places of a constellation's line that a straight piece joins, rad.
const PIECE_RAD: f64 = 0.004;

/// No lens sees further from the middle of the frame, rad.
const MAX_FROM_MIDDLE_RAD: f64 = 1.75;

/// A row of `detections.csv` and `detections.parquet`.
#[derive(Debug, Default, Serialize)]
struct DetectionRow<'a> {
    frame: usize,
    file: &'a str,
    detection: usize,
    x_px: f64,
    y_px: f64,
    sigma_x_px: f64,
    sigma_y_px: f64,
    covariance_xy_px2: f64,
    flux_dn: f64,
    flux_sigma_dn: f64,
    snr: f64,
    background_dn: f64,
    width_px: f64,
    moment_xx_px2: Option<f64>,
    moment_xy_px2: Option<f64>,
    moment_yy_px2: Option<f64>,
    moment_sigma_xx_px2: Option<f64>,
    moment_sigma_xy_px2: Option<f64>,
    moment_sigma_yy_px2: Option<f64>,
    skewness_x: Option<f64>,
    skewness_y: Option<f64>,
    skewness_sigma_x: Option<f64>,
    skewness_sigma_y: Option<f64>,
    chi2_per_dof: f64,
    peak_dn: f64,
    saturated: bool,
    blended: bool,
    edge: bool,
}

impl<'a> DetectionRow<'a> {
    fn new(frame: &'a MeasuredFrame, number: usize, star: &Detection) -> Self {
        let [xx, xy, yy] = star.covariance_px2;
        let second = |k: usize| star.moments.as_ref().map(|m| m.second_px2[k]);
        let second_sigma = |k: usize| star.moments.as_ref().map(|m| m.second_sigma_px2[k]);
        let skewness = |k: usize| star.moments.as_ref().map(|m| m.skewness[k]);
        let skewness_sigma = |k: usize| star.moments.as_ref().map(|m| m.skewness_sigma[k]);
        Self {
            frame: frame.index,
            file: &frame.name,
            detection: number,
            x_px: star.x_px,
            y_px: star.y_px,
            sigma_x_px: xx.sqrt(),
            sigma_y_px: yy.sqrt(),
            covariance_xy_px2: xy,
            flux_dn: star.flux_dn,
            flux_sigma_dn: star.flux_sigma_dn,
            snr: star.snr(),
            background_dn: star.background_dn,
            width_px: star.width_px,
            moment_xx_px2: second(0),
            moment_xy_px2: second(1),
            moment_yy_px2: second(2),
            moment_sigma_xx_px2: second_sigma(0),
            moment_sigma_xy_px2: second_sigma(1),
            moment_sigma_yy_px2: second_sigma(2),
            skewness_x: skewness(0),
            skewness_y: skewness(1),
            skewness_sigma_x: skewness_sigma(0),
            skewness_sigma_y: skewness_sigma(1),
            chi2_per_dof: star.chi2_per_dof,
            peak_dn: star.peak_dn,
            saturated: star.flags.saturated,
            blended: star.flags.blended,
            edge: star.flags.edge,
        }
    }
}

/// A row of `matches.csv` and `matches.parquet`.
#[derive(Debug, Default, Serialize)]
pub(super) struct MatchRow<'a> {
    pub(super) frame: usize,
    pub(super) file: &'a str,
    pub(super) detection: usize,
    pub(super) hip: u32,
    pub(super) name: Option<&'a str>,
    pub(super) ra_deg: f64,
    pub(super) dec_deg: f64,
    /// The date of the place (right ascension and declination, ICRS, from the barycentre of the solar system), Julian year.
    pub(super) epoch_yr: f64,
    pub(super) magnitude: f64,
    pub(super) colour_mag: Option<f64>,
    pub(super) x_px: f64,
    pub(super) y_px: f64,
    pub(super) residual_x_px: f64,
    pub(super) residual_y_px: f64,
    pub(super) flux_dn: f64,
}

/// The path of a frame's file: its number and its own name, so that files sort as the frames do.
pub(super) fn frame_path(directory: &Path, frame: &MeasuredFrame, ending: &str) -> PathBuf {
    let stem = Path::new(&frame.name).file_stem().map_or_else(|| frame.name.clone(), |stem| stem.to_string_lossy().into_owned());
    directory.join(format!("{:04}-{stem}.{ending}", frame.index))
}

/// A table as CSV and as Parquet, with what the result says of its making.
fn write_table<R: Serialize>(directory: &Path, name: &str, rows: &[R], empty: &R, provenance: &Provenance) -> Result<()> {
    let table = DataTable::new(rows, empty).with_context(|| format!("a row of {name} holds more than numbers and words"))?;
    let about = serde_json::to_string(provenance).context("writing the provenance as JSON")?;
    Ok(table.write(&directory.join(name), &[("boresight.provenance", about)])?)
}

/// Writes the table of all detections.
pub(super) fn write_detections(directory: &Path, frames: &[MeasuredFrame], provenance: &Provenance) -> Result<()> {
    let rows: Vec<DetectionRow<'_>> = frames
        .iter()
        .flat_map(|frame| frame.detections.stars.iter().enumerate().map(move |(number, star)| DetectionRow::new(frame, number, star)))
        .collect();
    write_table(directory, "detections", &rows, &DetectionRow::default(), provenance)
}

/// Writes the table of all identified stars.
pub(super) fn write_matches(directory: &Path, rows: &[MatchRow<'_>], provenance: &Provenance) -> Result<()> {
    write_table(directory, "matches", rows, &MatchRow::default(), provenance)
}

/// Every star image of a frame as a mark, named where the star is known.
pub(super) fn marks(frame: &MeasuredFrame, identified: Option<&IdentifiedFrame>, catalog: &Catalog) -> Vec<Mark> {
    let matches = identified.and_then(IdentifiedFrame::solution).map_or(&[][..], |solution| &solution.matches);
    let mark = |(number, detection): (usize, &Detection)| {
        let star = matches.iter().find(|matched| matched.detection == number).map(|matched| &catalog.stars[matched.star]);
        let kind = if star.is_some() { MarkKind::Identified } else { MarkKind::Detected };
        Mark { x_px: detection.x_px, y_px: detection.y_px, label: star.map(|star| catalog.label(star)), kind }
    };
    frame.detections.stars.iter().enumerate().map(mark).collect()
}

/// Writes the regions of a frame for DS9.
pub(super) fn write_regions(directory: &Path, frame: &MeasuredFrame, marks: &[Mark]) -> Result<()> {
    Ok(write_file(&frame_path(directory, frame, "reg"), report::ds9_regions(marks, &frame.name).as_bytes())?)
}

/// Writes the world coordinates of an identified frame, TAN-SIP: as a header alone, and with the image if `with_image`.
pub(super) fn write_world_coordinates(
    directory: &Path,
    measured: &Measured,
    frame: &MeasuredFrame,
    identified: &IdentifiedFrame,
    places: Places,
    with_image: bool,
) -> Result<()> {
    let Some(solution) = identified.solution() else { return Ok(()) };
    let subject = Subject {
        model: solution.model(),
        parity: solution.parity,
        physics: identified.sky.ids().into_iter().map(str::to_owned).collect(),
        frames: vec![SubjectFrame { frame: frame.index, attitude: solution.attitude, sky: Some(identified.sky.clone()) }],
        places,
    };
    let exported = match exchange::export(&subject, Format::Sip) {
        Ok(exported) if exported.expressible => exported,
        Ok(exported) => {
            let max_px = exported.residual.max_px;
            tracing::warn!("{}: TAN-SIP misses the camera by up to {max_px:.3} px, so no world coordinates are written", frame.name);
            return Ok(());
        }
        Err(error) => {
            tracing::warn!("{}: no world coordinates are written ({error})", frame.name);
            return Ok(());
        }
    };
    for file in &exported.files {
        write_file(&frame_path(directory, frame, "wcs"), &file.bytes)?;
        if with_image && measured.recording.frame_path(frame.index).is_some() {
            let recording = &measured.recording;
            let headers = FitsHeaders::new(&recording.camera, recording.site.as_ref(), &recording.frames[frame.index]);
            let pixels = recording.load_frame(frame.index)?;
            write_fits_with(&frame_path(directory, frame, "fits"), &pixels, &headers, &file.bytes)?;
        }
    }
    Ok(())
}

/// The figures of the constellations as the frame shows them.
pub(super) fn figures(solution: &Solution, sky: &SkyChain) -> Vec<Figure> {
    let catalog = Catalog::embedded();
    let model = solution.model();
    let context = model.reference_context();
    let half_diagonal_rad = 0.6 * solution.width_deg().hypot(solution.height_deg()).to_radians();
    let place = |direction: &Direction<Apparent>| {
        // What stands far outside has no place that a camera's polynomials would give.
        if solution.centre().angle_rad(direction) > half_diagonal_rad.min(MAX_FROM_MIDDLE_RAD) {
            return None;
        }
        let point = model.pixel(&solution.attitude.camera_from_apparent(direction), &context)?;
        let x_px = if solution.parity < 0 { solution.camera.width_px as f64 - 1.0 - point.x_px } else { point.x_px };
        Some([x_px, point.y_px])
    };
    let direction_of = |hip: u32| catalog.by_hip(hip).map(|star| sky.apparent(star, catalog.epoch_yr));
    let mut figures: Vec<Figure> = Vec::new();
    for line in constellation_lines() {
        let [Some(from), Some(to)] = line.hips.map(direction_of) else { continue };
        let pieces = (from.angle_rad(&to) / PIECE_RAD).ceil().max(1.0);
        let between = |step: usize| {
            let share = step as f64 / pieces;
            Direction::along([0, 1, 2].map(|axis| (1.0 - share) * from.xyz[axis] + share * to.xyz[axis]))
        };
        let chain: Vec<[f64; 2]> = (0..=pieces as usize).map(|step| place(&between(step)).unwrap_or([f64::NAN; 2])).collect();
        if chain.iter().all(|place| place[0].is_nan()) {
            continue;
        }
        if figures.last().is_none_or(|figure| figure.name != line.name) {
            figures.push(Figure { name: line.name.to_owned(), chains: Vec::new() });
        }
        if let Some(figure) = figures.last_mut() {
            figure.chains.push(chain);
        }
    }
    figures
}

/// The frame with its stars marked and named and the figures of the constellations; nothing where there are no pixels.
pub(super) fn write_picture(
    path: &Path,
    measured: &Measured,
    frame: &MeasuredFrame,
    identified: Option<&IdentifiedFrame>,
    catalog: &Catalog,
) -> Result<()> {
    if measured.recording.frame_path(frame.index).is_none() {
        return Ok(());
    }
    let pixels = measured.recording.load_frame(frame.index)?;
    let figures = identified.and_then(|one| Some(figures(one.solution()?, &one.sky))).unwrap_or_default();
    Ok(report::frame_picture(path, &pixels, &marks(frame, identified, catalog), &figures)?)
}

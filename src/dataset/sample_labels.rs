//! Labels of a sample, KEY.json: every key always there, stars as arrays of the same length, no nulls, numbers with a fixed number of digits.

use std::fmt::Write as _;

use schemars::JsonSchema;
use serde::Serialize;

use super::distribution::rounded;
use super::frame_scene::FrameScene;
use crate::render::{Footprint, Rendered};
use crate::scene::{LightKind, Scene};

/// The name of the format.
pub const SAMPLE_FORMAT: &str = "boresight-sample/1";

/// The labels of a sample. Quaternions are `camera_from_icrs`, scalar last; places count from the centre of the first pixel.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct SampleLabels {
    /// Always `boresight-sample/1`.
    pub format: &'static str,
    /// The number of the frame, which is also the name of the sample.
    pub key: u64,
    /// Its split.
    pub split: &'static str,
    /// The number of its camera instance.
    pub camera: u64,
    /// The number of its recording.
    pub recording: u64,
    /// The number that both frames of a pair have; −1: it is alone.
    pub pair: i64,
    /// Whether it has no stars on purpose.
    pub no_stars: bool,
    /// Seed of its scene: that of the camera instance.
    pub seed: u64,
    /// Columns and rows.
    pub size_px: [usize; 2],
    /// Middle of the exposure, UTC; empty if it is not known.
    pub time_utc: String,
    /// TAI − UTC then; 0 if the time is not known.
    pub tai_minus_utc_s: f64,
    /// Length of the exposure.
    pub exposure_s: f64,
    /// From row to row of a rolling shutter, below 0 if the last row is read first; 0: all rows at once.
    pub line_time_s: f64,
    /// Attitude at the start of the exposure of the middle row.
    pub camera_from_icrs_start: [f64; 4],
    /// In its middle.
    pub camera_from_icrs_mid: [f64; 4],
    /// At its end.
    pub camera_from_icrs_end: [f64; 4],
    /// Turn of the camera in its own axes; 0 where none is stated.
    pub rate_deg_s: [f64; 3],
    /// Velocity of the camera, barycentric, ICRS axes; 0 where it is not known.
    pub velocity_km_s: [f64; 3],
    /// Focal length.
    pub focal_length_px: f64,
    /// Principal point.
    pub principal_point_px: [f64; 2],
    /// Distortion k1 (px⁻²), p1 and p2 (px⁻¹) at the measured point.
    pub distortion: [f64; 3],
    /// How angles are mapped to the focal plane.
    pub projection: &'static str,
    /// Width σ that stands for the image of a star.
    pub psf_sigma_px: f64,
    /// Electrons per count.
    pub gain_e_per_dn: f64,
    /// Count of an empty pixel.
    pub bias_dn: f64,
    /// Noise of reading a pixel.
    pub read_noise_e: f64,
    /// Electrons that a pixel holds.
    pub full_well_e: f64,
    /// Count of a full pixel.
    pub saturation_dn: f64,
    /// Even background.
    pub background_e_per_px_s: f64,
    /// Temperature of the optics; 20 where none is stated.
    pub temperature_c: f64,
    /// Effects that are on.
    pub effects: Vec<String>,
    /// Share of pixels with the count of a full one.
    pub saturated_share: f64,
    /// SHA-256 of the counts, row by row, low byte first.
    pub pixels_sha256: String,
}

/// Beyond this a place cannot be told at all, px.
const MAX_BOUND_PX: f64 = 1000.0;
/// Electrons over their standard error from which a light counts as visible.
pub(super) const MIN_VISIBLE_SNR: f64 = 5.0;

/// Columns of the table of lights in the labels, with what each holds.
pub const LIGHT_COLUMNS: [(&str, &str); 28] = [
    ("hip", "Hipparcos number (or that of the catalogue's row); 0 where there is none"),
    ("kind", "star, false-star, satellite, meteor, ghost or cosmic-ray"),
    ("x_px", "column of the centre of its light over the exposure"),
    ("y_px", "row of the same"),
    ("x_mid_px", "column in the middle of the exposure"),
    ("y_mid_px", "row of the same"),
    ("x_start_px", "column at the start of the exposure; where it has no image then, that of x_px"),
    ("y_start_px", "row of the same"),
    ("x_end_px", "column at the end of the exposure; where it has no image then, that of x_px"),
    ("y_end_px", "row of the same"),
    ("x_ideal_px", "column without any displacement from proper motion to distortion; where there is none, that of x_px"),
    ("y_ideal_px", "row of the same"),
    ("crlb_x_px", "least standard error of the column (Cramér–Rao bound); 1000 where it cannot be told"),
    ("crlb_y_px", "least standard error of the row"),
    ("magnitude", "V magnitude; 99 for what is no star"),
    ("electrons_asked", "electrons that it sends during the exposure"),
    ("electrons_landed", "electrons that are expected to be counted"),
    ("peak_electrons", "the same in its brightest pixel"),
    ("background_e", "expected electrons of everything else there"),
    ("snr", "electrons over their least standard error"),
    ("box_left_px", "first column of the pixels that hold its light but for a fortieth beyond each side"),
    ("box_top_px", "first row"),
    ("box_right_px", "last column"),
    ("box_bottom_px", "last row"),
    ("visible", "1: snr is 5 or more and the centre of its light is on the frame"),
    ("saturated", "1: a pixel is expected to be full"),
    ("blended", "1: another star with at least a twentieth of its light is near"),
    ("edge", "1: more than a hundredth of its light falls beside the frame"),
];

/// One light, column by column.
struct LightRow<'r> {
    hip: u32,
    kind: &'static str,
    centre: [f64; 2],
    middle: [f64; 2],
    start: [f64; 2],
    end: [f64; 2],
    ideal: [f64; 2],
    magnitude: f64,
    /// Asked, landed, in the brightest pixel.
    electrons: [f64; 3],
    footprint: &'r Footprint,
    is_blended: bool,
    is_at_edge: bool,
}

/// The lights of a frame: stars, brightest first, then what is no star.
fn rows<'r>(rendered: &'r Rendered, footprints: &'r [Footprint]) -> impl Iterator<Item = LightRow<'r>> {
    let (of_stars, of_lights) = footprints.split_at(rendered.stars.len().min(footprints.len()));
    let pair = |x: Option<f64>, y: Option<f64>, otherwise: [f64; 2]| x.zip(y).map_or(otherwise, |(x, y)| [x, y]);
    let stars = rendered.stars.iter().zip(of_stars).map(move |(star, footprint)| {
        let centre = [star.x_mean_px, star.y_mean_px];
        LightRow {
            hip: star.hip,
            kind: "star",
            centre,
            middle: [star.x_px, star.y_px],
            start: pair(star.x_start_px, star.y_start_px, centre),
            end: pair(star.x_end_px, star.y_end_px, centre),
            ideal: pair(star.x_ideal_px, star.y_ideal_px, centre),
            magnitude: star.magnitude,
            electrons: [star.electrons_asked, star.electrons_landed, star.peak_electrons],
            footprint,
            is_blended: star.blended,
            is_at_edge: star.edge,
        }
    });
    let lights = rendered.lights.iter().zip(of_lights).map(|(light, footprint)| {
        let (start, end) = ([light.x_start_px, light.y_start_px], [light.x_end_px, light.y_end_px]);
        let middle = [0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1])];
        LightRow {
            hip: light.hip.unwrap_or(0),
            kind: kind(light.kind, start == end),
            centre: middle,
            middle,
            start,
            end,
            ideal: middle,
            magnitude: NO_MAGNITUDE,
            electrons: [light.electrons_asked, light.electrons_landed, light.peak_electrons],
            footprint,
            is_blended: false,
            is_at_edge: light.electrons_landed < 0.99 * light.electrons_asked,
        }
    });
    stars.chain(lights)
}

/// Of what is no star.
const NO_MAGNITUDE: f64 = 99.0;
/// Detectors are stated for this temperature where a scene has none.
const USUAL_TEMPERATURE_C: f64 = 20.0;

/// What a light is called; `is_point`: it does not move.
fn kind(kind: LightKind, is_point: bool) -> &'static str {
    match kind {
        LightKind::Satellite if is_point => "false-star",
        LightKind::Satellite => "satellite",
        LightKind::Meteor => "meteor",
        LightKind::Ghost => "ghost",
        LightKind::CosmicRay => "cosmic-ray",
    }
}

/// Whether a light looks like a star and is none.
pub(super) fn is_false_star(light: &crate::render::TrueLight) -> bool {
    kind(light.kind, light.x_start_px == light.x_end_px && light.y_start_px == light.y_end_px) == "false-star"
}

/// Whether a place is on the frame.
fn is_on(size: [usize; 2], [x, y]: [f64; 2]) -> bool {
    let within = |at: f64, side: usize| -0.5 <= at && at < side as f64 - 0.5;
    within(x, size[0]) && within(y, size[1])
}

/// Centres of the stars that count as visible.
pub(super) fn visible_stars<'r>(size: [usize; 2], rendered: &'r Rendered, footprints: &'r [Footprint]) -> impl Iterator<Item = [f64; 2]> + use<'r> {
    let places = rendered.stars.iter().zip(footprints).filter(|(_, footprint)| footprint.snr >= MIN_VISIBLE_SNR);
    places.map(|(star, _)| [star.x_mean_px, star.y_mean_px]).filter(move |place| is_on(size, *place))
}

impl SampleLabels {
    /// Of a rendered frame. `size`: columns and rows.
    pub(super) fn new(frame: &FrameScene, scene: &Scene, rendered: &Rendered, pixels_sha256: String) -> Self {
        let exposure = scene.exposures.get(0);
        let attitude = |seconds: f64| <[f64; 4]>::from(exposure.motion.attitude(&exposure.course, seconds)).map(rounded);
        let detector = scene.detector.joined(scene.binning);
        let full_dn = detector.full_pixel_dn();
        let full = rendered.pixels_dn.iter().filter(|count| f64::from(**count) >= full_dn).count();
        let effects = scene.pixel_effects.iter().map(|effect| effect.id.clone());
        let others = exposure.sky.effects().into_iter().chain(scene.model.terms()).map(|(id, _)| id.to_owned());
        Self {
            format: SAMPLE_FORMAT,
            key: frame.key.number(),
            split: frame.key.split.name(),
            camera: frame.camera,
            recording: frame.recording,
            pair: frame.pair.map_or(-1, |pair| pair as i64),
            no_stars: frame.is_starless,
            seed: scene.seed,
            size_px: [scene.camera.width_px, scene.camera.height_px],
            time_utc: exposure.time.map_or_else(String::new, |time| time.to_isoformat() + "Z"),
            tai_minus_utc_s: exposure.time.and_then(|time| time.leap_seconds(true)).unwrap_or(0.0),
            exposure_s: rounded(exposure.exposure_s),
            line_time_s: rounded(scene.line_time_s),
            camera_from_icrs_start: attitude(-0.5 * exposure.exposure_s),
            camera_from_icrs_mid: attitude(0.0),
            camera_from_icrs_end: attitude(0.5 * exposure.exposure_s),
            rate_deg_s: exposure.telemetry.rate_deg_s.unwrap_or_default().map(rounded),
            velocity_km_s: exposure.sky.observation().velocity_km_s.unwrap_or_default().map(rounded),
            focal_length_px: rounded(scene.camera.focal_length_px),
            principal_point_px: scene.camera.principal_point_px.map(rounded),
            distortion: [scene.camera.k1, scene.camera.p1, scene.camera.p2].map(rounded),
            projection: scene.model.projection(),
            psf_sigma_px: rounded(scene.detector.psf_sigma_px),
            gain_e_per_dn: rounded(detector.gain_e_per_dn),
            bias_dn: rounded(detector.bias_dn),
            read_noise_e: rounded(detector.read_noise_e),
            full_well_e: rounded(detector.full_well_e),
            saturation_dn: rounded(full_dn),
            background_e_per_px_s: rounded(scene.sky.even_e_per_px_s()),
            temperature_c: rounded(exposure.telemetry.temperature_c.unwrap_or(USUAL_TEMPERATURE_C)),
            effects: effects.chain(others).collect(),
            saturated_share: rounded(full as f64 / rendered.pixels_dn.len().max(1) as f64),
            pixels_sha256,
        }
    }

    /// The text of KEY.json.
    pub(super) fn json(&self, rendered: &Rendered, footprints: &[Footprint]) -> Result<String, serde_json::Error> {
        let mut text = serde_json::to_string(self)?;
        text.truncate(text.len() - 1);
        text += ",\"lights\":{";
        let rows: Vec<LightRow<'_>> = rows(rendered, footprints).collect();
        for (place, (name, _)) in LIGHT_COLUMNS.iter().enumerate() {
            let _ = write!(text, "{}\"{name}\":[", if place == 0 { "" } else { "," }); // writing to a String cannot fail
            for (number, row) in rows.iter().enumerate() {
                if number > 0 {
                    text.push(',');
                }
                self.put(&mut text, row, place);
            }
            text.push(']');
        }
        text += "}}\n";
        Ok(text)
    }

    /// Writes a light's value of a column of [`LIGHT_COLUMNS`].
    fn put(&self, text: &mut String, row: &LightRow<'_>, column: usize) {
        const PLACE: u32 = 6;
        const LIGHT: u32 = 3;
        let footprint = row.footprint;
        let bound = |axis: usize| footprint.bound_px[axis].min(MAX_BOUND_PX);
        let (value, digits) = match column {
            0 => (f64::from(row.hip), 0),
            1 => {
                let _ = write!(text, "\"{}\"", row.kind); // writing to a String cannot fail
                return;
            }
            2 | 3 => (row.centre[column - 2], PLACE),
            4 | 5 => (row.middle[column - 4], PLACE),
            6 | 7 => (row.start[column - 6], PLACE),
            8 | 9 => (row.end[column - 8], PLACE),
            10 | 11 => (row.ideal[column - 10], PLACE),
            12 | 13 => (bound(column - 12), PLACE),
            14 => (row.magnitude, LIGHT),
            15..=17 => (row.electrons[column - 15], LIGHT),
            18 => (footprint.background_e, LIGHT),
            19 => (footprint.snr, LIGHT),
            20..=23 => (footprint.box_px[column - 20] as f64, 0),
            24 => (f64::from(footprint.snr >= MIN_VISIBLE_SNR && is_on(self.size_px, row.centre)), 0),
            25 => (f64::from(footprint.is_saturated), 0),
            26 => (f64::from(row.is_blended), 0),
            _ => (f64::from(row.is_at_edge), 0),
        };
        fixed(text, value, digits);
    }
}

/// Writes a number with so many digits behind the point; what is no number is 0.
fn fixed(text: &mut String, value: f64, digits: u32) {
    const MAX: f64 = 9e17;
    let unit = 10_u64.pow(digits);
    let scaled = (value * unit as f64).round();
    let scaled = if scaled.is_finite() { scaled.clamp(-MAX, MAX) } else { 0.0 };
    let whole = scaled.abs() as u64;
    if scaled < 0.0 {
        text.push('-');
    }
    let width = digits as usize;
    let _ = if digits == 0 { write!(text, "{whole}") } else { write!(text, "{}.{:0width$}", whole / unit, whole % unit) }; // as above
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_fixed_digits() {
        for (value, digits, told) in [
            (1.5, 6, "1.500000"),
            (-0.25, 3, "-0.250"),
            (-1e-9, 6, "0.000000"),
            (123_456_789.0, 0, "123456789"),
            (f64::INFINITY, 3, "0.000"),
            (511.999_999_6, 6, "512.000000"),
        ] {
            let mut text = String::new();
            fixed(&mut text, value, digits);
            assert_eq!(text, told);
        }
    }
}

//! Labels of a sample, KEY.json: every key always there, stars as arrays of the same length, no nulls, numbers with a fixed number of digits.

use std::borrow::Cow;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::distribution::rounded;
use super::frame_scene::FrameScene;
use super::table_columns::TableCells;
use crate::catalog::Catalog;
use crate::render::{Footprint, Rendered};
use crate::scene::{LightKind, Scene};

/// The name of the format.
pub const SAMPLE_FORMAT: &str = "boresight-sample/1";

/// The labels of a sample. Quaternions are `camera_from_icrs`, scalar last; places count from the centre of the first pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SampleLabels {
    /// Always `boresight-sample/1`.
    pub format: Cow<'static, str>,
    /// The number of the frame, which is also the name of the sample.
    pub key: u64,
    /// Its split.
    pub split: Cow<'static, str>,
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
    /// SHA-256 of its scene: of what `boresight dataset --scene` prints behind the first line.
    #[serde(default)]
    pub scene_sha256: String,
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
    pub projection: Cow<'static, str>,
    /// Kind of the image of a star, as `[psf]` of a scene names it.
    pub psf: String,
    /// Width σ that stands for the image of a star.
    pub psf_sigma_px: f64,
    /// Electrons per count.
    pub gain_e_per_dn: f64,
    /// Count of an empty pixel.
    pub bias_dn: f64,
    /// Noise of reading a pixel; with a real frame under the stars, the noise of that.
    pub read_noise_e: f64,
    /// Electrons that a pixel holds.
    pub full_well_e: f64,
    /// Count of a full pixel.
    pub saturation_dn: f64,
    /// Even background.
    pub background_e_per_px_s: f64,
    /// The real frame under the stars, a file beside the recipe; empty: none.
    pub background_file: String,
    /// Temperature of the optics; 20 where none is stated.
    pub temperature_c: f64,
    /// Effects that are on.
    pub effects: Vec<String>,
    /// Share of pixels with the count of a full one.
    pub saturated_share: f64,
    /// SHA-256 of the counts, row by row, low byte first.
    pub pixels_sha256: String,
    /// Stars and other lights.
    pub lights: LightColumns,
}

/// Beyond this a place cannot be told at all, px.
const MAX_BOUND_PX: f64 = 1000.0;
/// Electrons over their standard error from which a light counts as visible.
pub(super) const MIN_VISIBLE_SNR: f64 = 5.0;

/// Lights of a frame, column by column: stars of the catalogue, brightest first, then what is no star. Places and bounds have six digits behind the point,
/// magnitudes and electrons three.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LightColumns {
    /// Hipparcos number (or that of the catalogue's row); 0 where there is none.
    pub hip: Vec<u32>,
    /// `star`, `false-star`, `satellite`, `meteor`, `ghost` or `cosmic-ray`.
    pub kind: Vec<Cow<'static, str>>,
    /// Column of the centre of its light over the exposure; of a trail that is no star's, of the light on the frame.
    pub x_px: Vec<f64>,
    /// Row of the same.
    pub y_px: Vec<f64>,
    /// Column in the middle of the exposure.
    pub x_mid_px: Vec<f64>,
    /// Row of the same.
    pub y_mid_px: Vec<f64>,
    /// Column at the start of the exposure; where it has no image then, that of `x_px`.
    pub x_start_px: Vec<f64>,
    /// Row of the same.
    pub y_start_px: Vec<f64>,
    /// Column at the end of the exposure; where it has no image then, that of `x_px`.
    pub x_end_px: Vec<f64>,
    /// Row of the same.
    pub y_end_px: Vec<f64>,
    /// Column without any displacement, from proper motion to distortion; where there is none, that of `x_px`.
    pub x_ideal_px: Vec<f64>,
    /// Row of the same.
    pub y_ideal_px: Vec<f64>,
    /// Least standard error of the column (Cramér–Rao bound); 1000 where it cannot be told.
    pub crlb_x_px: Vec<f64>,
    /// Least standard error of the row.
    pub crlb_y_px: Vec<f64>,
    /// V magnitude; 99 for what is no star.
    pub magnitude: Vec<f64>,
    /// Colour B − V; 99 for what is no star, and where the catalogue knows none.
    pub colour: Vec<f64>,
    /// Electrons that it sends during the exposure.
    pub electrons_asked: Vec<f64>,
    /// Electrons that are expected to be counted.
    pub electrons_landed: Vec<f64>,
    /// The same in its brightest pixel.
    pub peak_electrons: Vec<f64>,
    /// Expected electrons of everything else there.
    pub background_e: Vec<f64>,
    /// Electrons over their least standard error.
    pub snr: Vec<f64>,
    /// First column of the pixels that hold its light but for a fortieth beyond each side.
    pub box_left_px: Vec<usize>,
    /// First row.
    pub box_top_px: Vec<usize>,
    /// Last column.
    pub box_right_px: Vec<usize>,
    /// Last row.
    pub box_bottom_px: Vec<usize>,
    /// Whether `snr` is 5 or more and the centre of its light is on the frame.
    pub visible: Vec<bool>,
    /// Whether a pixel is expected to be full.
    pub saturated: Vec<bool>,
    /// Whether another star with at least a twentieth of its light is near.
    pub blended: Vec<bool>,
    /// Whether more than a hundredth of its light falls beside the frame.
    pub edge: Vec<bool>,
}

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
    colour: f64,
    /// Asked, landed, in the brightest pixel.
    electrons: [f64; 3],
    footprint: &'r Footprint,
    is_blended: bool,
    is_at_edge: bool,
}

/// The lights of a frame: stars, brightest first, then what is no star.
fn rows<'r>(rendered: &'r Rendered, footprints: &'r [Footprint], catalog: &'r Catalog) -> impl Iterator<Item = LightRow<'r>> {
    let (of_stars, of_lights) = footprints.split_at(rendered.stars.len().min(footprints.len()));
    let pair = |x: Option<f64>, y: Option<f64>, otherwise: [f64; 2]| x.zip(y).map_or(otherwise, |(x, y)| [x, y]);
    let stars = rendered.stars.iter().zip(of_stars).map(move |(star, footprint)| {
        let centre = [star.x_mean_px, star.y_mean_px];
        LightRow {
            hip: star.hip,
            kind: STAR,
            centre,
            middle: [star.x_px, star.y_px],
            start: pair(star.x_start_px, star.y_start_px, centre),
            end: pair(star.x_end_px, star.y_end_px, centre),
            ideal: pair(star.x_ideal_px, star.y_ideal_px, centre),
            magnitude: star.magnitude,
            colour: catalog.by_hip(star.hip).and_then(|star| star.colour).unwrap_or(NO_MAGNITUDE),
            electrons: [star.electrons_asked, star.electrons_landed, star.peak_electrons],
            footprint,
            is_blended: star.blended,
            is_at_edge: star.edge,
        }
    });
    let lights = rendered.lights.iter().zip(of_lights).map(|(light, footprint)| {
        let (start, end) = ([light.x_start_px, light.y_start_px], [light.x_end_px, light.y_end_px]);
        let middle = [0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1])];
        // The light of a trail may be uneven along it, or begin beside the frame.
        let of_trail = footprint.centre_px.filter(|_| start != end);
        LightRow {
            hip: light.hip.unwrap_or(0),
            kind: kind(light.kind, start == end),
            centre: of_trail.unwrap_or(middle),
            middle,
            start,
            end,
            ideal: middle,
            magnitude: NO_MAGNITUDE,
            colour: NO_MAGNITUDE,
            electrons: [light.electrons_asked, light.electrons_landed, light.peak_electrons],
            footprint,
            is_blended: false,
            is_at_edge: light.electrons_landed < 0.99 * light.electrons_asked,
        }
    });
    stars.chain(lights)
}

/// What stars of the catalogue are called.
pub(super) const STAR: &str = "star";
/// Magnitude and colour of what is no star.
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
pub(super) fn visible_stars<'r>(
    size: [usize; 2],
    rendered: &'r Rendered,
    footprints: &'r [Footprint],
) -> impl Iterator<Item = [f64; 2]> + use<'r> {
    let places = rendered.stars.iter().zip(footprints).filter(|(_, footprint)| footprint.snr >= MIN_VISIBLE_SNR);
    places.map(|(star, _)| [star.x_mean_px, star.y_mean_px]).filter(move |place| is_on(size, *place))
}

impl SampleLabels {
    /// Of a rendered frame. `size`: columns and rows.
    pub(super) fn new(
        frame: &FrameScene,
        scene: &Scene,
        (rendered, catalog): (&Rendered, &Catalog),
        (scene_sha256, pixels_sha256): (String, String),
    ) -> Self {
        let exposure = scene.exposures.get(0);
        let attitude = |seconds: f64| <[f64; 4]>::from(exposure.motion.attitude(&exposure.course, seconds)).map(rounded);
        let footprints = rendered.footprints.as_deref().unwrap_or_default();
        let mut lights = LightColumns::default();
        rows(rendered, footprints, catalog).for_each(|row| lights.add(&row, [scene.camera.width_px, scene.camera.height_px]));
        let detector = scene.detector.joined(scene.binning);
        let full_dn = detector.full_pixel_dn();
        let full = rendered.pixels_dn.iter().filter(|count| f64::from(**count) >= full_dn).count();
        let effects = scene.pixel_effects.iter().map(|effect| effect.id.clone());
        let others = exposure.sky.effects().into_iter().chain(scene.model.terms()).map(|(id, _)| id.to_owned());
        Self {
            format: Cow::Borrowed(SAMPLE_FORMAT),
            key: frame.key.number(),
            split: Cow::Borrowed(frame.key.split.name()),
            camera: frame.camera,
            recording: frame.recording,
            pair: frame.pair.map_or(-1, u64::cast_signed),
            no_stars: frame.is_starless,
            seed: scene.seed,
            scene_sha256,
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
            projection: Cow::Borrowed(scene.model.projection()),
            psf: scene.psf_table.as_ref().map_or_else(|| "gaussian".to_owned(), |psf| psf.kind.clone()),
            psf_sigma_px: rounded(scene.detector.psf_sigma_px),
            gain_e_per_dn: rounded(detector.gain_e_per_dn),
            bias_dn: rounded(detector.bias_dn),
            read_noise_e: rounded(detector.read_noise_e),
            full_well_e: rounded(detector.full_well_e),
            saturation_dn: rounded(full_dn),
            background_e_per_px_s: rounded(scene.sky.even_e_per_px_s()),
            background_file: frame.background.clone().unwrap_or_default(),
            temperature_c: rounded(exposure.telemetry.temperature_c.unwrap_or(USUAL_TEMPERATURE_C)),
            effects: effects.chain(others).chain(scene.glow_ids().map(str::to_owned)).collect(),
            saturated_share: rounded(full as f64 / rendered.pixels_dn.len().max(1) as f64),
            pixels_sha256,
            lights,
        }
    }
}

impl SampleLabels {
    /// Right ascension and declination of the boresight in the middle of the exposure, degrees: the third row of the rotation.
    pub(super) fn boresight_radec_deg(&self) -> [f64; 2] {
        let [x, y, z] = self.boresight();
        let (ra, dec) = (y.atan2(x).rem_euclid(std::f64::consts::TAU), z.atan2(x.hypot(y)));
        [rounded(ra.to_degrees()), rounded(dec.to_degrees())]
    }

    /// The boresight in ICRS axes in the middle of the exposure.
    pub(super) fn boresight(&self) -> [f64; 3] {
        let [i, j, k, w] = self.camera_from_icrs_mid;
        [2.0 * (i * k - j * w), 2.0 * (j * k + i * w), 1.0 - 2.0 * (i * i + j * j)]
    }
}

impl LightColumns {
    /// How many stars of the catalogue are visible.
    pub(super) fn visible_stars(&self) -> usize {
        self.kind.iter().zip(&self.visible).filter(|(kind, is_visible)| *kind == STAR && **is_visible).count()
    }

    /// Every column with its name, in their order.
    pub(super) fn columns(&self) -> Vec<(&'static str, TableCells)> {
        let number = |name, cells: &[f64]| (name, TableCells::Number(cells.to_vec()));
        let whole = |name, cells: &[usize]| (name, TableCells::Whole(cells.iter().map(|cell| cell.cast_signed() as i64).collect()));
        let flag = |name, cells: &[bool]| (name, TableCells::Flag(cells.to_vec()));
        vec![
            ("hip", TableCells::Whole(self.hip.iter().map(|hip| i64::from(*hip)).collect())),
            ("kind", TableCells::Text(self.kind.iter().map(ToString::to_string).collect())),
            number("x_px", &self.x_px),
            number("y_px", &self.y_px),
            number("x_mid_px", &self.x_mid_px),
            number("y_mid_px", &self.y_mid_px),
            number("x_start_px", &self.x_start_px),
            number("y_start_px", &self.y_start_px),
            number("x_end_px", &self.x_end_px),
            number("y_end_px", &self.y_end_px),
            number("x_ideal_px", &self.x_ideal_px),
            number("y_ideal_px", &self.y_ideal_px),
            number("crlb_x_px", &self.crlb_x_px),
            number("crlb_y_px", &self.crlb_y_px),
            number("magnitude", &self.magnitude),
            number("colour", &self.colour),
            number("electrons_asked", &self.electrons_asked),
            number("electrons_landed", &self.electrons_landed),
            number("peak_electrons", &self.peak_electrons),
            number("background_e", &self.background_e),
            number("snr", &self.snr),
            whole("box_left_px", &self.box_left_px),
            whole("box_top_px", &self.box_top_px),
            whole("box_right_px", &self.box_right_px),
            whole("box_bottom_px", &self.box_bottom_px),
            flag("visible", &self.visible),
            flag("saturated", &self.saturated),
            flag("blended", &self.blended),
            flag("edge", &self.edge),
        ]
    }

    fn add(&mut self, row: &LightRow<'_>, size: [usize; 2]) {
        let LightRow { footprint, centre, .. } = row;
        self.hip.push(row.hip);
        self.kind.push(Cow::Borrowed(row.kind));
        let bound = footprint.bound_px.map(|bound| bound.min(MAX_BOUND_PX));
        let places = [
            (&mut self.x_px, &mut self.y_px, *centre),
            (&mut self.x_mid_px, &mut self.y_mid_px, row.middle),
            (&mut self.x_start_px, &mut self.y_start_px, row.start),
            (&mut self.x_end_px, &mut self.y_end_px, row.end),
            (&mut self.x_ideal_px, &mut self.y_ideal_px, row.ideal),
            (&mut self.crlb_x_px, &mut self.crlb_y_px, bound),
        ];
        for (x_px, y_px, place) in places {
            x_px.push(fixed(place[0], 1e6));
            y_px.push(fixed(place[1], 1e6));
        }
        let [asked, landed, peak] = row.electrons;
        let amounts = [
            (&mut self.magnitude, row.magnitude),
            (&mut self.colour, row.colour),
            (&mut self.electrons_asked, asked),
            (&mut self.electrons_landed, landed),
            (&mut self.peak_electrons, peak),
            (&mut self.background_e, footprint.background_e),
            (&mut self.snr, footprint.snr),
        ];
        for (column, amount) in amounts {
            column.push(fixed(amount, 1e3));
        }
        let [left, top, right, bottom] = footprint.box_px;
        self.box_left_px.push(left);
        self.box_top_px.push(top);
        self.box_right_px.push(right);
        self.box_bottom_px.push(bottom);
        self.visible.push(footprint.snr >= MIN_VISIBLE_SNR && is_on(size, *centre));
        self.saturated.push(footprint.is_saturated);
        self.blended.push(row.is_blended);
        self.edge.push(row.is_at_edge);
    }
}

/// A number in whole parts of a unit, `per_unit` of them; what is no number is 0.
fn fixed(value: f64, per_unit: f64) -> f64 {
    let fixed = (value * per_unit).round() / per_unit;
    // −0 is 0.
    if fixed.is_finite() { fixed + 0.0 } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::frame_key::{DatasetSplit, FrameKey};
    use crate::dataset::plan::tests::{SCENE, plan_of, recipe};
    use crate::render::PsfTables;

    /// A meteor that fades, and a satellite that comes from far beside the frame: where their light is, and that it is seen.
    #[test]
    fn a_trail_is_where_its_light_is() {
        let scene = format!(
            "{SCENE}[[streaks]]\nkind = \"meteor\"\nframe = 0\nstart_px = [10.0, 10.0]\nend_px = [50.0, 10.0]\nelectrons = 1e6\nlight_curve = [2.0, 1.0]\n\
             [[streaks]]\nkind = \"satellite\"\nframe = 0\nstart_px = [-200.0, 30.0]\nend_px = [40.0, 30.0]\nelectrons = 1e6\n"
        );
        let plan = plan_of(&recipe("[hard]\nno_stars = 1.0\n"), &scene).unwrap();
        let sample = plan.sample(Catalog::embedded(), &PsfTables::default(), FrameKey { split: DatasetSplit::Train, index: 0 }).unwrap();
        let lights = &sample.labels.lights;
        assert_eq!(lights.kind, ["meteor", "satellite"]);
        // Brightness goes as t²(1 − t): its centre is at three fifths of the 40 px.
        assert!((lights.x_px[0] - 34.0).abs() < 0.1 && (lights.y_px[0] - 10.0).abs() < 0.02, "{:?}", lights.x_px);
        assert!((lights.x_px[1] - 20.0).abs() < 0.5 && (lights.y_px[1] - 30.0).abs() < 0.02, "{:?}", lights.x_px);
        assert_eq!((lights.x_mid_px[1], &lights.visible), (-80.0, &vec![true, true]));
    }

    #[test]
    fn numbers_have_fixed_digits() {
        for (value, per_unit, told) in [
            (1.5, 1e6, "1.5"),
            (-0.25, 1e3, "-0.25"),
            (-1e-9, 1e6, "0.0"),
            (f64::INFINITY, 1e3, "0.0"),
            (511.999_999_6, 1e6, "512.0"),
            (100.123_456_789, 1e6, "100.123457"),
        ] {
            assert_eq!(serde_json::to_string(&fixed(value, per_unit)).unwrap(), told);
        }
    }
}

//! Background light of the sky on the pixels of a frame: models of its brightness, and a given image.
//!
//! A pixel of the solid angle Ω in a direction of the surface brightness B (stars of V = 0 per square arcsecond) receives B·Ω·z electrons per second, z the
//! zero point. Ω follows from the camera's own map at every place of the field, and below the horizon of a site there is nothing. The models are smooth
//! but for a few edges (the horizon, the circle of a fisheye): they are evaluated on squares, interpolated by parabolas within, and squares on
//! which that misses by more than [`TOLERANCE`] are cut into four, down to single pixels. The sky stands still during an exposure, as in its middle.

use std::path::Path;
use std::sync::Arc;

use rayon::prelude::*;

use super::{Exposure, Scene, SceneError, SkyTable};
use crate::camera::circumstances;
use crate::coordinates::{Direction, PixelPoint};
use crate::effects::sky::glow::{Circumstances, Needs, SkyGlow};
use crate::recording::load_image;
use crate::units::ARCSEC_RAD;

/// The error of interpolation at which a square is cut, relative; with it no pixel is off by more than 0.5 %.
const TOLERANCE: f64 = 1e-3;
/// Less than this is no error, electrons.
const NEGLIGIBLE_E: f64 = 1e-5;
/// Side of the largest squares.
const SQUARE_PX: usize = 64;
/// Pixels of a piece on which all are evaluated: as many as its nodes and tests would be.
const FEW_PX: usize = 15;

/// A light of the sky that is switched on.
#[derive(Clone)]
pub(super) struct GlowSetting {
    /// Its place in `[[effects]]`.
    pub(super) index: usize,
    pub(super) glow: &'static dyn SkyGlow,
    pub(super) parameters: Vec<f64>,
}

impl std::fmt::Debug for GlowSetting {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}{:?}", self.glow.id(), self.parameters)
    }
}

/// What lights the sky between the stars unevenly.
#[derive(Clone, Debug, Default)]
pub(super) struct SkyLight {
    pub(super) glows: Vec<GlowSetting>,
    /// Electrons per pixel and second, row by row.
    image: Option<Arc<[f32]>>,
}

impl SkyLight {
    /// The glows, by their ids.
    pub(super) fn glow_ids(&self) -> impl Iterator<Item = &'static str> + '_ {
        self.glows.iter().map(|setting| setting.glow.id())
    }

    /// Checks that every exposure has what the models need, and reads the image. Where these give the sky, an even background that nobody asked for
    /// is set to nothing.
    pub(super) fn new(
        path: &str,
        sky: &mut SkyTable,
        glows: Vec<GlowSetting>,
        size_px: [usize; 2],
        exposures: impl ExactSizeIterator<Item = Arc<Exposure>>,
    ) -> Result<Self, SceneError> {
        let exposures: Vec<Arc<Exposure>> = exposures.collect();
        let wrong = |message: String| SceneError::Parse { path: path.to_owned(), message };
        for GlowSetting { index, glow, .. } in &glows {
            let is_missing = |exposure: &Arc<Exposure>| match glow.needs() {
                Needs::Nothing => false,
                Needs::Time => exposure.time.is_none(),
                Needs::Site => exposure.time.is_none() || exposure.sky.observation().zenith.is_none(),
            };
            if let Some(number) = exposures.iter().position(is_missing) {
                let what = match glow.needs() {
                    Needs::Site => "a [site] and the time of every exposure",
                    Needs::Time | Needs::Nothing => "the time of every exposure",
                };
                let remedy = "give series.start_utc, or time_utc of each frame";
                return Err(wrong(format!("effects[{index}]: {} needs {what}, and exposure {number} lacks it; {remedy}", glow.id())));
            }
        }
        if !glows.is_empty() {
            sky.background_e_per_px_s.get_or_insert(0.0);
        }
        let image = sky.background_image.as_ref().map(|file| {
            let frame = load_image(&Path::new(path).parent().unwrap_or(Path::new("")).join(file));
            let of_file = |problem: String| wrong(format!("sky.background_image = {file:?}: {problem}"));
            let frame = frame.map_err(|problem| of_file(problem.to_string()))?;
            if [frame.width_px, frame.height_px] != size_px {
                let [width, height] = size_px;
                let has = format!("it has {} × {} px", frame.width_px, frame.height_px);
                return Err(of_file(format!("{has}, but the frame {width} × {height} px; give an image of the size of the frame")));
            }
            let scaled = frame.pixels_dn.iter().map(|value| (f64::from(*value) * sky.background_image_scale) as f32);
            let pixels: Arc<[f32]> = scaled.collect();
            match pixels.iter().position(|rate| !(*rate >= 0.0 && rate.is_finite())) {
                None => Ok(pixels),
                Some(at) => {
                    let (x, y) = (at % size_px[0], at / size_px[0]);
                    let remedy = "a background is not negative and finite";
                    Err(of_file(format!("{} electrons per second in the pixel ({x}, {y}): {remedy}", pixels[at])))
                }
            }
        });
        Ok(Self { glows, image: image.transpose()? })
    }
}

/// The models in an exposure.
struct View<'a> {
    scene: &'a Scene,
    exposure: Arc<Exposure>,
    circumstances: Circumstances,
    /// The camera's parameters.
    values: Vec<f64>,
}

impl View<'_> {
    /// Electrons of a pixel with its middle here.
    fn electrons(&self, [x, y]: [f64; 2]) -> f64 {
        let optics = &self.scene.optics;
        let Some(seen) = optics.seen(&self.values, &[], [x, y], &optics.reference_context()) else { return 0.0 };
        let direction = self.exposure.attitude.apparent_from_camera(&Direction::from_unit(seen.direction)).xyz;
        if self.circumstances.is_below_horizon(direction) {
            return 0.0;
        }
        let [a, b, c] = seen.by_pixel;
        let cross = [b[0] * c[1] - c[0] * b[1], c[0] * a[1] - a[0] * c[1], a[0] * b[1] - b[0] * a[1]];
        let solid_angle_arcsec2 = crate::dual::dot(cross, cross).sqrt() / (ARCSEC_RAD * ARCSEC_RAD);
        let of_glow = |one: &GlowSetting| one.glow.brightness(&one.parameters, direction, &self.circumstances);
        let brightness: f64 = self.scene.sky_light.glows.iter().map(of_glow).sum();
        let electrons = brightness * solid_angle_arcsec2 * self.scene.detector.zero_point_e_per_s * self.exposure.exposure_s;
        if electrons.is_finite() { electrons } else { 0.0 }
    }
}

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug)]
struct Piece {
    left: usize,
    top: usize,
    width: usize,
    height: usize,
}

/// Shares of three nodes at 0, ½ and 1 in the value of the parabola through them at `t`.
fn parabola(t: f64) -> [f64; 3] {
    [(1.0 - t) * (1.0 - 2.0 * t), 4.0 * t * (1.0 - t), t * (2.0 * t - 1.0)]
}

/// Fills a piece of the rows that begin with row `first_row`, `stride` pixels each, with a function of the place.
fn fill(piece: Piece, rows: &mut [f32], first_row: usize, stride: usize, at: &impl Fn([f64; 2]) -> f64) {
    let Piece { left, top, width, height } = piece;
    if width * height <= FEW_PX {
        for y in top..top + height {
            for x in left..left + width {
                rows[(y - first_row) * stride + x] = at([x as f64, y as f64]) as f32;
            }
        }
        return;
    }
    // From edge to edge of the piece's pixels.
    let place = |u: f64, v: f64| [left as f64 - 0.5 + u * width as f64, top as f64 - 0.5 + v * height as f64];
    let nodes = [0.0, 0.5, 1.0].map(|v| [0.0, 0.5, 1.0].map(|u| at(place(u, v))));
    let through = |shares: [f64; 3], values: [f64; 3]| shares[0] * values[0] + shares[1] * values[1] + shares[2] * values[2];
    let tests = [[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75], [0.25, 0.5], [0.5, 0.75]];
    let is_smooth = tests.iter().all(|[u, v]| {
        let exact = at(place(*u, *v));
        let found = through(parabola(*v), nodes.map(|row| through(parabola(*u), row)));
        (found - exact).abs() <= TOLERANCE * exact + NEGLIGIBLE_E
    });
    if !is_smooth {
        let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
        for (top, height) in [(top, half_height), (top + half_height, height - half_height)] {
            for (left, width) in [(left, half_width), (left + half_width, width - half_width)] {
                fill(Piece { left, top, width, height }, rows, first_row, stride, at);
            }
        }
        return;
    }
    for y in 0..height {
        let shares = parabola((y as f64 + 0.5) / height as f64);
        let across = [0, 1, 2].map(|column| through(shares, nodes.map(|row| row[column])));
        let row = &mut rows[(top + y - first_row) * stride + left..][..width];
        for (x, electrons) in (0..).zip(row) {
            *electrons = through(parabola((f64::from(x) + 0.5) / width as f64), across).max(0.0) as f32;
        }
    }
}

impl Scene {
    fn view(&self, index: usize) -> View<'_> {
        let exposure = self.exposures.get(index);
        let SkyTable { extinction_mag_per_airmass, faintest_magnitude, .. } = self.sky;
        let known = circumstances(exposure.time, exposure.sky.observation());
        let circumstances = Circumstances { extinction_mag_per_airmass, faintest_magnitude, ..known };
        View { scene: self, exposure, circumstances, values: self.optics.values() }
    }

    /// Expected electrons of the uneven light of the sky in frame number `index`, row by row; empty where there is none. It is what comes to the pixels:
    /// nothing of the lens and the detector has touched it.
    ///
    /// # Panics
    /// If `index` is not below the number of exposures.
    #[must_use]
    pub fn sky_light_e(&self, index: usize) -> Vec<f32> {
        let SkyLight { glows, image } = &self.sky_light;
        if glows.is_empty() && image.is_none() {
            return Vec::new();
        }
        let (width, height) = (self.camera.width_px, self.camera.height_px);
        let view = self.view(index);
        let mut frame = vec![0.0_f32; width * height];
        if !glows.is_empty() {
            frame.par_chunks_mut(width * SQUARE_PX).enumerate().for_each(|(band, rows)| {
                let (top, height) = (band * SQUARE_PX, rows.len() / width);
                for left in (0..width).step_by(SQUARE_PX) {
                    let piece = Piece { left, top, width: SQUARE_PX.min(width - left), height };
                    fill(piece, rows, top, width, &|place| view.electrons(place));
                }
            });
        }
        if let Some(image) = image {
            let exposure_s = view.exposure.exposure_s as f32;
            frame.iter_mut().zip(image.iter()).for_each(|(electrons, rate)| *electrons += rate * exposure_s);
        }
        frame
    }

    /// The light of the models at one place of frame number `index`, as they give it, electrons in a pixel there.
    ///
    /// # Panics
    /// If `index` is not below the number of exposures.
    #[must_use]
    pub fn sky_light_at_e(&self, index: usize, place: PixelPoint) -> f64 {
        self.view(index).electrons([place.x_px, place.y_px])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Smooth places are met within the tolerance with few evaluations, an edge to the pixel.
    #[test]
    fn squares_follow_what_is_smooth_and_what_is_not() {
        let (width, height) = (200, 130);
        let asked = std::cell::Cell::new(0);
        let at = |[x, y]: [f64; 2]| {
            asked.set(asked.get() + 1);
            let is_dark = (x - 90.0).hypot(y - 60.0) > 75.0;
            if is_dark { 0.0 } else { 1000.0 * (0.01 * x + 0.004 * y).exp() }
        };
        let mut frame = vec![f32::NAN; width * height];
        for top in (0..height).step_by(SQUARE_PX) {
            for left in (0..width).step_by(SQUARE_PX) {
                let piece = Piece { left, top, width: SQUARE_PX.min(width - left), height: SQUARE_PX.min(height - top) };
                fill(piece, &mut frame, 0, width, &at);
            }
        }
        assert!(asked.get() < width * height / 3, "{} evaluations", asked.get());
        let mut off = 0;
        for (index, found) in frame.iter().enumerate() {
            let exact = at([(index % width) as f64, (index / width) as f64]);
            off += usize::from((f64::from(*found) - exact).abs() > 0.005 * exact + 1e-3);
        }
        assert!(off <= 2, "{off} pixels are off");
    }
}

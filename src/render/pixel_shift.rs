//! What pixel effects add to the place and the flux of every star: the frame's light before the first of them and after the last, without noise.
//!
//! What follows the charge (brighter-fatter, losses in transfer, non-linearity) depends on all that is in the frame, so the whole frame goes
//! through the effects: once with all its light, once with everything but the stars. Their difference is the stars' light as it is
//! counted. It is compared, in a window around each star, with the same light before any effect, seen by pixels that answer evenly.

use super::light::{FrameLight, Spreader};
use super::mosaic::on_pixels;
use super::truth::blended;
use crate::imaging::{BinnedNoiseFree, FrameExposure, ImagingError, NoiseFree, PlaneLight};
use crate::scene::{Scene, StarTrack};

/// What pixel effects add to a star.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PixelShift {
    pub(super) x_px: f64,
    pub(super) y_px: f64,
    pub(super) flux_ratio: f64,
}

impl PixelShift {
    /// Where no pixel effect is on.
    pub(super) const NONE: Self = Self { x_px: 0.0, y_px: 0.0, flux_ratio: 1.0 };
}

/// Half the side of a window beyond the star's way: so many widths of its image, and so many pixels more.
const WINDOW_SIGMAS: f64 = 4.0;
const WINDOW_MORE_PX: f64 = 3.0;
/// Another star with this share of a star's light in its window leaves its columns empty.
const MIN_NEIGHBOUR: f64 = 0.01;

/// What the camera makes of light, without noise.
pub(super) struct Chain<'a> {
    /// The detector's own pixels.
    pub(super) own: &'a NoiseFree<'a>,
    /// Where they are joined.
    pub(super) binned: Option<&'a BinnedNoiseFree<'a>>,
}

impl Chain<'_> {
    pub(super) fn shapes_light(&self) -> bool {
        self.binned.map_or_else(|| self.own.shapes_light(), BinnedNoiseFree::shapes_light)
    }

    /// The frame's pixels with this light, after all effects.
    fn readout(&self, exposure: &FrameExposure<'_>, planes: &[PlaneLight<'_>]) -> Result<Vec<f32>, ImagingError> {
        match self.binned {
            Some(binned) => binned.readout(exposure, planes),
            None => self.own.readout(exposure, planes),
        }
    }

    /// The frame's pixels with this light, before any effect.
    fn light_alone(&self, exposure: &FrameExposure<'_>, planes: &[PlaneLight<'_>]) -> Result<Vec<f32>, ImagingError> {
        match self.binned {
            Some(binned) => binned.light_alone(exposure, planes),
            None => self.own.light_alone(exposure, planes),
        }
    }
}

/// The light of a frame, and how it is spread.
pub(super) struct Light<'a> {
    pub(super) stars: &'a FrameLight,
    pub(super) others: &'a FrameLight,
    /// How the pixels see it.
    pub(super) seen: &'a Spreader,
    /// How pixels would see it that answer evenly.
    pub(super) even: &'a Spreader,
}

/// For each star what pixel effects add to it; `None` where other stars or the edge of the frame are too near. `exposure`: the
/// frame's, with any stars.
pub(super) fn pixel_shifts(
    scene: &Scene,
    exposure: &FrameExposure<'_>,
    chain: &Chain<'_>,
    light: &Light<'_>,
    tracks: &[StarTrack],
) -> Result<Vec<Option<PixelShift>>, ImagingError> {
    let all = light.stars.with(light.others);
    let of = |frame: &FrameLight| {
        let lit = on_pixels(frame, light.seen, exposure.sky_e, |lights| chain.own.behind_filters(exposure, lights))?;
        chain.readout(&FrameExposure { stars: lit.stars, sky_e: &lit.spread_e, ..*exposure }, &lit.planes)
    };
    let (with, without) = (of(&all)?, of(light.others)?);
    let counted: Vec<f32> = with.iter().zip(&without).map(|(with, without)| with - without).collect();
    let sent = chain.light_alone(&FrameExposure { stars: &light.stars.stars, ..*exposure }, &light.even.planes(light.stars))?;
    let reach_px = WINDOW_SIGMAS * light.seen.widest_px() / scene.own_psf.own_per_px as f64;
    let half_px = reach_px + WINDOW_MORE_PX;
    let crowded = blended(tracks, half_px + reach_px, MIN_NEIGHBOUR);
    let size = [scene.camera.width_px, scene.camera.height_px];
    let shift = |(track, crowded): (&StarTrack, bool)| {
        let window = Window::around(track, half_px, size).filter(|_| !crowded)?;
        let (before, after) = (window.moments(&sent, size[0]), window.moments(&counted, size[0]));
        let shift = PixelShift {
            x_px: after.centre_px[0] - before.centre_px[0],
            y_px: after.centre_px[1] - before.centre_px[1],
            flux_ratio: after.electrons / before.electrons,
        };
        (shift.x_px.is_finite() && shift.y_px.is_finite() && shift.flux_ratio.is_finite()).then_some(shift)
    };
    Ok(tracks.iter().zip(crowded).map(shift).collect())
}

/// Pixels around a star: first and last column, first and last row.
struct Window([usize; 4]);

/// Light in a window and its centre.
struct Moments {
    electrons: f64,
    centre_px: [f64; 2],
}

impl Window {
    /// The smallest that reaches so far beyond the star's way; `None` where the frame does not hold it.
    fn around(track: &StarTrack, half_px: f64, size: [usize; 2]) -> Option<Self> {
        let mut span = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
        for sample in &track.samples {
            let (x, y) = (sample.place.x_px, sample.place.y_px);
            span = [span[0].min(x), span[1].max(x), span[2].min(y), span[3].max(y)];
        }
        let [left, right, top, bottom] = [span[0] - half_px, span[1] + half_px, span[2] - half_px, span[3] + half_px].map(f64::round);
        let is_held = left >= 0.0 && top >= 0.0 && right <= size[0] as f64 - 1.0 && bottom <= size[1] as f64 - 1.0;
        is_held.then(|| Self([left, right, top, bottom].map(|edge| edge as usize)))
    }

    fn moments(&self, frame: &[f32], width_px: usize) -> Moments {
        let [left, right, top, bottom] = self.0;
        let (mut electrons, mut x, mut y) = (0.0, 0.0, 0.0);
        for row in top..=bottom {
            for column in left..=right {
                let own = f64::from(frame[row * width_px + column]);
                // Counted from the window's corner: sums of differences lose nothing to the size of the frame.
                (electrons, x, y) = (electrons + own, x + own * (column - left) as f64, y + own * (row - top) as f64);
            }
        }
        Moments { electrons, centre_px: [x / electrons, y / electrons] }
    }
}

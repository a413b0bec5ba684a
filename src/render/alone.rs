//! Stars of a frame, each by itself and without noise: what labels and pixels of a frame are both held against.

use super::light::StarLight;
use super::truth::Seen;
use super::{FrameLight, Renderer, Sources};
use crate::imaging::{FrameExposure, ImagingError, NoiseFree};
use crate::parallel;

/// A star by itself, on the pixels of the frame that hold any of its light.
#[derive(Clone, Debug, PartialEq)]
pub struct StarAlone {
    /// Catalogue number.
    pub hip: u32,
    /// First column.
    pub left_px: usize,
    /// First row.
    pub top_px: usize,
    /// Columns.
    pub width_px: usize,
    /// Expected electrons, row by row.
    pub electrons: Vec<f64>,
    /// By how much they grow when the star moves to the right, and down, a pixel.
    pub slopes: [Vec<f64>; 2],
    /// Column and row of the centre of all its light, by these pixels.
    pub centre_px: [f64; 2],
}

/// Stars of a frame, and the frame.
#[derive(Clone, Debug, PartialEq)]
pub struct StarsAlone {
    /// Those that were asked for, as far as the frame holds all their light.
    pub stars: Vec<StarAlone>,
    /// Expected electrons of the frame, row by row.
    pub expected_e: Vec<f32>,
    /// Noise of reading a pixel.
    pub read_noise_e: f64,
}

/// Step of the slopes, px: small beside any image, large beside the rounding of places.
const STEP_PX: f64 = 0.02;

impl Renderer<'_> {
    /// Stars of exposure number `index` by themselves; `wanted` tells by catalogue number which.
    pub(crate) fn stars_alone(&self, index: usize, wanted: &(dyn Fn(u32) -> bool + Sync)) -> Result<StarsAlone, ImagingError> {
        let Sources { tracks, lights, .. } = self.sources(index);
        let frame: FrameLight = lights.iter().collect();
        let sky_e = self.sky_e(index);
        let exposure = self.exposure(index, &frame, &sky_e);
        let chain = self.imager.noise_free(&exposure, &self.spreader.planes(&frame))?;
        let chosen: Vec<usize> = (0..tracks.len()).filter(|number| wanted(tracks[*number].hip)).collect();
        let alone = |number: &usize| self.alone(&chain, tracks[*number].hip, &lights[*number]);
        let stars = parallel::try_map::<_, _, ImagingError>(&chosen, alone)?.into_iter().flatten().collect();
        let lit = self.on_pixels(&exposure, &frame)?;
        let expected_e = self.clean_e(&FrameExposure { stars: lit.stars, sky_e: &lit.spread_e, ..exposure }, &lit.planes)?;
        Ok(StarsAlone { stars, expected_e, read_noise_e: chain.read_noise_e() })
    }

    /// A star by itself; `None` where the frame does not hold all its light.
    fn alone(&self, chain: &NoiseFree<'_>, hip: u32, light: &StarLight) -> Result<Option<StarAlone>, ImagingError> {
        let stamp = |by_px: [f64; 2]| self.spreader.stamp(&self.spreader.moved(light, by_px), &self.imager);
        let (Some(own), Some(right), Some(down)) = (stamp([0.0; 2])?, stamp([STEP_PX, 0.0])?, stamp([0.0, STEP_PX])?) else {
            return Ok(None);
        };
        let seen = Seen::new(self.scene, chain, &own);
        let camera = &self.scene.camera;
        let Some(centre_px) = seen.centre_px([camera.width_px, camera.height_px]) else { return Ok(None) };
        let slope = |moved| {
            let beside = seen.beside(self.scene, moved);
            beside.iter().zip(&seen.light.electrons).map(|(moved, own)| (moved - own) / STEP_PX).collect()
        };
        Ok(Some(StarAlone {
            hip,
            left_px: seen.left_px,
            top_px: seen.top_px,
            width_px: seen.width_px,
            slopes: [slope(&right), slope(&down)],
            electrons: seen.light.electrons,
            centre_px,
        }))
    }
}

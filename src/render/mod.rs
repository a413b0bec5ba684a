//! Scene → Frame: projects the catalogue (f64, here), then lets the pixel effects make an image of it (f32, on the GPU or the CPU).

mod light;
mod truth;

pub use truth::TrueStar;

use rayon::prelude::*;

use crate::catalog::Catalog;
use crate::imaging::{Backend, Exposure, Imager, ImagingConfig, ImagingError, Stage};
use crate::scene::{Scene, StarTrack};
use light::{FrameLight, StarLight};
use truth::{Landed, true_stars};

/// How far outside the frame a star may lie and still send light into it, in widths of its image: beyond, less than 1e-9 of it.
const MARGIN_SIGMAS: f64 = 6.0;

/// A rendered exposure.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    /// Counts, row by row, the first row on top.
    pub pixels_dn: Vec<u16>,
    /// The stars that reach the frame, brightest first.
    pub stars: Vec<TrueStar>,
}

/// Renders the frames of a scene, in any order: each depends on the scene and its own number alone.
#[derive(Debug)]
pub struct Renderer<'a> {
    scene: &'a Scene,
    catalog: &'a Catalog,
    imager: Imager,
}

impl<'a> Renderer<'a> {
    /// Opens the backend for a scene.
    pub fn new(scene: &'a Scene, catalog: &'a Catalog, backend: Backend) -> Result<Self, ImagingError> {
        let config = ImagingConfig {
            width_px: scene.camera.width_px,
            height_px: scene.camera.height_px,
            seed: scene.seed,
            point_spread: "gaussian_psf".to_owned(),
            effects: scene.pixel_effects.clone(),
        };
        Ok(Self { scene, catalog, imager: Imager::new(backend, &config)? })
    }

    /// On what frames are rendered: the adapter and its driver, or `cpu`.
    #[must_use]
    pub fn adapter(&self) -> String {
        self.imager.adapter()
    }

    /// Renders exposure number `index` of the scene.
    ///
    /// # Panics
    /// If `index` is not below the number of exposures.
    pub fn render(&self, index: usize) -> Result<Rendered, ImagingError> {
        let (tracks, lights) = self.light(index);
        let landed = |light: &StarLight| Ok(Landed::new(self.scene, index, light.stamp(&self.imager)?.as_ref()));
        let landed = lights.par_iter().map(landed).collect::<Result<Vec<_>, ImagingError>>()?;
        let stars = true_stars(self.scene, index, &tracks, &landed);
        let frame: FrameLight = lights.into_iter().collect();
        let exposure = self.exposure(index, &frame);
        let image = self.imager.expose_with(&exposure, &frame.planes())?;
        Ok(Rendered { pixels_dn: image.pixels_dn, stars })
    }

    /// The expected electrons of exposure number `index`, without noise, row by row: stars and sky.
    ///
    /// # Panics
    /// If `index` is not below the number of exposures.
    pub fn expected_electrons(&self, index: usize) -> Result<Vec<f32>, ImagingError> {
        let frame: FrameLight = self.light(index).1.into_iter().collect();
        let exposure = self.exposure(index, &frame);
        self.imager.electrons_after_with(Some(Stage::Light), &exposure, &frame.planes())
    }

    fn exposure<'b>(&self, index: usize, frame: &'b FrameLight) -> Exposure<'b> {
        let crate::scene::Exposure { exposure_s, telemetry, .. } = &self.scene.exposures[index];
        let (frame_index, temperature_c) = (index as u32, telemetry.temperature_c);
        Exposure { stars: &frame.stars, exposure_s: *exposure_s, frame_index, temperature_c }
    }

    /// The stars of an exposure on their way over the frame, and their light, brightest first.
    fn light(&self, index: usize) -> (Vec<StarTrack>, Vec<StarLight>) {
        let sigma_px = self.scene.detector.psf_sigma_px;
        let tracks = self.scene.star_tracks(self.catalog, index, sigma_px, MARGIN_SIGMAS * sigma_px + 1.0);
        let lights = tracks.iter().map(|track| StarLight::gaussian(track, sigma_px)).collect();
        (tracks, lights)
    }
}

//! Scene → Frame: projects the catalogue (f64, here), then lets the pixel effects make an image of it (f32, on the GPU or the CPU).

mod light;
mod truth;

pub use truth::{TrueLight, TrueStar};

use rayon::prelude::*;

use crate::catalog::Catalog;
use crate::imaging::{Backend, Exposure, Imager, ImagingConfig, ImagingError, Stage};
use crate::scene::{OtherLight, Scene, StarTrack};
use light::{FrameLight, Spreader, StarLight};
use truth::{Landed, true_stars};

/// A rendered exposure.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    /// Counts, row by row, the first row on top.
    pub pixels_dn: Vec<u16>,
    /// The stars that reach the frame, brightest first.
    pub stars: Vec<TrueStar>,
    /// What else shines or leaves charge.
    pub lights: Vec<TrueLight>,
}

/// Renders the frames of a scene, in any order: each depends on the scene and its own number alone.
#[derive(Debug)]
pub struct Renderer<'a> {
    scene: &'a Scene,
    catalog: &'a Catalog,
    imager: Imager,
    spreader: Spreader,
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
        let imager = Imager::new(backend, &config)?;
        Ok(Self { scene, catalog, imager, spreader: Spreader::new(&scene.psf) })
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
        let Sources { tracks, others, lights } = self.sources(index);
        let landed = |light: &StarLight| Ok(Landed::new(self.scene, index, self.spreader.stamp(light, &self.imager)?.as_ref()));
        let landed = lights.par_iter().map(landed).collect::<Result<Vec<_>, ImagingError>>()?;
        let (of_stars, of_others) = landed.split_at(tracks.len());
        let stars = true_stars(self.scene, index, &tracks, of_stars);
        let others = others.iter().zip(of_others).map(|(other, landed)| TrueLight::new(index, other, *landed)).collect();
        let frame: FrameLight = lights.into_iter().collect();
        let exposure = self.exposure(index, &frame);
        let image = self.imager.expose_with(&exposure, &self.spreader.planes(&frame))?;
        Ok(Rendered { pixels_dn: image.pixels_dn, stars, lights: others })
    }

    /// The expected electrons of exposure number `index`, without noise, row by row: stars and sky.
    ///
    /// # Panics
    /// If `index` is not below the number of exposures.
    pub fn expected_electrons(&self, index: usize) -> Result<Vec<f32>, ImagingError> {
        let frame: FrameLight = self.sources(index).lights.into_iter().collect();
        let exposure = self.exposure(index, &frame);
        self.imager.electrons_after_with(Some(Stage::Light), &exposure, &self.spreader.planes(&frame))
    }

    fn exposure<'b>(&self, index: usize, frame: &'b FrameLight) -> Exposure<'b> {
        let crate::scene::Exposure { exposure_s, telemetry, .. } = &self.scene.exposures[index];
        let (frame_index, temperature_c) = (index as u32, telemetry.temperature_c);
        Exposure { stars: &frame.stars, sky_e: &[], exposure_s: *exposure_s, frame_index, temperature_c }
    }

    /// Everything that lights an exposure.
    fn sources(&self, index: usize) -> Sources {
        /// Beyond so many widths lies less than 1e-9 of a Gaussian's light.
        const SIGMAS: f64 = 6.0;
        let fast_rad = self.scene.exposures[index].motion.fast_rad2().into_iter().fold(0.0, f64::max).sqrt();
        let jitter_px = fast_rad * self.scene.camera.focal_length_px;
        let (width_px, margin_px) = (self.scene.psf.smooth_px, self.spreader.margin_px() + SIGMAS * jitter_px);
        let tracks = self.scene.star_tracks(self.catalog, index, width_px, margin_px);
        let others = self.scene.other_lights(index, &tracks);
        let mut lights: Vec<StarLight> = tracks.par_iter().map(|track| self.spreader.light(track)).collect();
        lights.extend(others.iter().map(|other| self.spreader.other(other)));
        Sources { tracks, others, lights }
    }
}

/// What lights an exposure.
struct Sources {
    /// The stars on their way over the frame, brightest first.
    tracks: Vec<StarTrack>,
    others: Vec<OtherLight>,
    /// The light of the stars, then that of the others.
    lights: Vec<StarLight>,
}

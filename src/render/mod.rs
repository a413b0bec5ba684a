//! Scene → Frame: projects the catalogue (f64, here), then lets the pixel effects make an image of it (f32, on the GPU or the CPU).

mod truth;

pub use truth::{TrueStar, true_stars};

use crate::catalog::Catalog;
use crate::imaging::{Backend, EffectSetting, Exposure, Imager, ImagingConfig, ImagingError, StarImage};
use crate::scene::{DetectorTable, Scene};

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
        let DetectorTable { gain_e_per_dn, bias_dn, read_noise_e, saturation_dn, full_well_e, .. } = scene.detector;
        let config = ImagingConfig {
            width_px: scene.camera.width_px,
            height_px: scene.camera.height_px,
            seed: scene.seed,
            point_spread: "gaussian_psf".to_owned(),
            effects: vec![
                EffectSetting::new("background", &[("background_e_per_px_s", scene.sky.background_e_per_px_s)]),
                EffectSetting::new("photon_noise", &[]),
                EffectSetting::new("read_noise", &[("read_noise_e", read_noise_e)]),
                EffectSetting::new(
                    "adc",
                    &[
                        ("gain_e_per_dn", gain_e_per_dn),
                        ("bias_dn", bias_dn),
                        ("full_well_e", full_well_e),
                        ("saturation_dn", saturation_dn),
                    ],
                ),
            ],
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
        let sigma_px = self.scene.detector.psf_sigma_px;
        let images = self.scene.star_images(self.catalog, index, MARGIN_SIGMAS * sigma_px + 1.0);
        let stars: Vec<StarImage> = images
            .iter()
            .map(|image| StarImage { x_px: image.position.x_px, y_px: image.position.y_px, electrons: image.electrons, sigma_px })
            .collect();
        let exposure = Exposure { stars: &stars, exposure_s: self.scene.exposures[index].exposure_s, frame_index: index as u32 };
        let image = self.imager.expose(&exposure)?;
        Ok(Rendered { pixels_dn: image.pixels_dn, stars: true_stars(self.scene, index, &images) })
    }
}

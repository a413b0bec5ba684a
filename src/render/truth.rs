//! The truth of a rendered frame: where every star landed and how bright it was. The measuring side of the program never reads it.

use serde::{Deserialize, Serialize};
use statrs::function::erf::erf;

use crate::scene::{DetectorTable, Scene, StarImage};

/// One star in one frame; a row of `truth/stars.csv`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrueStar {
    /// Index of the frame.
    pub frame: usize,
    /// Catalogue number.
    pub hip: u32,
    /// Column at the middle of the exposure.
    pub x_px: f64,
    /// Row at the middle of the exposure.
    pub y_px: f64,
    /// Mean column over the exposure.
    pub x_mean_px: f64,
    /// Mean row over the exposure.
    pub y_mean_px: f64,
    /// V magnitude.
    pub magnitude: f64,
    /// Electrons that the star sends during the exposure.
    pub electrons_asked: f64,
    /// Of these, how many are expected to land on the frame's pixels (before saturation).
    pub electrons_landed: f64,
    /// Expected electrons of the star in its brightest pixel.
    pub peak_electrons: f64,
    /// The brightest pixel is expected to be full.
    pub saturated: bool,
    /// Another star with at least a twentieth of this one's light lies within 6 σ of the PSF.
    pub blended: bool,
    /// Part of the light falls beside the frame (more than 1 %).
    pub edge: bool,
}

/// Share of a Gaussian's light between two edges, px from its centre.
fn share(from_px: f64, to_px: f64, sigma_px: f64) -> f64 {
    let scale = std::f64::consts::SQRT_2 * sigma_px;
    0.5 * (erf(to_px / scale) - erf(from_px / scale))
}

/// The truth of frame `index`, in the order of `images`.
#[must_use]
pub fn true_stars(scene: &Scene, index: usize, images: &[StarImage]) -> Vec<TrueStar> {
    let blended = blended(images, 6.0 * scene.detector.psf_sigma_px);
    images.iter().zip(blended).map(|(image, blended)| true_star(scene, index, image, blended)).collect()
}

fn true_star(scene: &Scene, index: usize, image: &StarImage, blended: bool) -> TrueStar {
    let DetectorTable { psf_sigma_px: sigma, gain_e_per_dn, bias_dn, .. } = scene.detector;
    let (x, y) = (image.position.x_px, image.position.y_px);
    let (width, height) = (scene.camera.width_px as f64, scene.camera.height_px as f64);
    let on_frame = share(-0.5 - x, width - 0.5 - x, sigma) * share(-0.5 - y, height - 0.5 - y, sigma);
    let pixel = |centre: f64| share(centre.round() - 0.5 - centre, centre.round() + 0.5 - centre, sigma);
    let peak_electrons = image.electrons * pixel(x) * pixel(y);
    let background = scene.sky.background_e_per_px_s * scene.exposures[index].exposure_s;
    TrueStar {
        frame: index,
        hip: image.hip,
        x_px: x,
        y_px: y,
        x_mean_px: x,
        y_mean_px: y,
        magnitude: image.magnitude,
        electrons_asked: image.electrons,
        electrons_landed: image.electrons * on_frame,
        peak_electrons,
        saturated: bias_dn + (peak_electrons + background) / gain_e_per_dn >= scene.detector.full_pixel_dn(),
        blended,
        edge: on_frame < 0.99,
    }
}

/// For each image, whether another one close by has at least a twentieth of its light.
fn blended(images: &[StarImage], reach_px: f64) -> Vec<bool> {
    let mut order: Vec<usize> = (0..images.len()).collect();
    order.sort_by(|a, b| images[*a].position.x_px.total_cmp(&images[*b].position.x_px));
    let mut blended = vec![false; images.len()];
    for (rank, &a) in order.iter().enumerate() {
        for &b in order[rank + 1..].iter().take_while(|b| images[**b].position.x_px - images[a].position.x_px < reach_px) {
            let (one, other) = (&images[a], &images[b]);
            let distance = (one.position.x_px - other.position.x_px).hypot(one.position.y_px - other.position.y_px);
            if distance < reach_px {
                blended[a] |= other.electrons >= 0.05 * one.electrons;
                blended[b] |= one.electrons >= 0.05 * other.electrons;
            }
        }
    }
    blended
}

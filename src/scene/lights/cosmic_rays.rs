//! # Cosmic rays
//!
//! ## What it does
//!
//! Particles cross the detector and leave charge along their way, without the optics.
//!
//! ## Equation
//!
//! They cross the depth h of the detector in straight lines whose directions come evenly from all sides (cos²θ is even between 0 and 1); over a path
//! of h/cos θ a particle leaves q·h/cos θ·(1 + 0.15·λ) electrons, λ by Moyal's law, the approximation of Landau's, spread along its track on the pixels and
//! diffused by a Gaussian.
//!
//! ## Parameters
//!
//! In a scene, `[cosmic_rays]`: `expected_per_s`: particles that cross the whole frame in a second; in low orbit about one for each cm² (1.7 in a
//! CCD of the first wide-field camera of the Space Telescope), up to 1100 in the South Atlantic anomaly; `thickness_um` (h); `pitch_um`: from pixel to pixel; `electrons_per_um` (q): most probable charge per length, about 80 in
//! silicon; `diffusion_px`: width σ to which the charge diffuses.
//!
//! ## Signature
//!
//! False stars, sharper than real ones, or short lines, in one frame only; stars that are drawn towards them.
//!
//! ## Confused with
//!
//! Hot pixels, which come back; faint stars, which are as wide as the optics make them.
//!
//! ## Neglected
//!
//! Secondary particles, charge that diffuses more from greater depth, and that the charge's scatter is smaller than that of photons, with whose
//! noise it is drawn.
//!
//! ## Source
//!
//! J. E. Moyal, Phil. Mag. 46, 263 (1955), for the law of the charge; N. D. Miles et al., arXiv:2006.00909, and the HST Data Handbook for
//! rates.

use rand::RngExt;
use rand_distr::Distribution;

use super::{LightForm, LightKind, OtherLight, Refuse, draw_count};
use crate::coordinates::PixelPoint;
use crate::effects::ParameterSpec;
use crate::scene::{CosmicRayTable, Scene, SceneError};

/// What the table has, with its ranges.
pub(super) const PARAMETERS: &[ParameterSpec] = &[
    ParameterSpec { name: "expected_per_s", unit: "1/s", typical: 0.1, range: (0.0, 1e6) },
    ParameterSpec { name: "thickness_um", unit: "um", typical: 15.0, range: (0.1, 2000.0) },
    ParameterSpec { name: "pitch_um", unit: "um", typical: 5.5, range: (0.5, 1000.0) },
    ParameterSpec { name: "electrons_per_um", unit: "e-/um", typical: 80.0, range: (0.0, 1e5) },
    ParameterSpec { name: "diffusion_px", unit: "px", typical: 0.3, range: (0.1, 10.0) },
];

/// The page's text.
pub(super) fn source() -> &'static str {
    page_source!("cosmic_rays.rs")
}

/// The key of its random numbers.
const COSMIC_RAY_STAGE: u32 = 0x4352_4159;

impl Scene {
    /// Directions come evenly from all sides; the charge of a track follows Moyal's approximation of Landau's law.
    pub(super) fn cosmic_rays_in(&self, index: usize) -> Vec<OtherLight> {
        /// Steepest tracks are cut here: half a degree above the surface.
        const MIN_COSINE: f64 = 0.01;
        /// Width of Landau's law over its most probable value in a few µm of silicon.
        const WIDTH: f64 = 0.15;
        let Some(rays) = &self.cosmic_rays else { return Vec::new() };
        let mut rng = self.chance(index, COSMIC_RAY_STAGE, 0);
        let count = draw_count(rays.expected_per_s * self.exposures.get(index).exposure_s, &mut rng);
        let normal = rand_distr::StandardNormal;
        (0..count)
            .map(|_| {
                let size = [self.camera.width_px as f64, self.camera.height_px as f64];
                let from = size.map(|side| rng.random_range(-0.5..side - 0.5));
                let azimuth: f64 = rng.random_range(0.0..std::f64::consts::TAU);
                // Through a surface the flux falls with the cosine, whose square is even between 0 and 1.
                let cosine = rng.random_range(MIN_COSINE * MIN_COSINE..1.0_f64).sqrt();
                let z: f64 = normal.sample(&mut rng);
                let path_um = rays.thickness_um / cosine;
                let along_px = path_um * (1.0 - cosine * cosine).sqrt() / rays.pitch_um;
                // −ln z² has its most probable value at 0.
                let electrons = rays.electrons_per_um * path_um * (1.0 - WIDTH * (z * z).max(1e-12).ln()).max(0.1);
                let to = [from[0] + along_px * azimuth.cos(), from[1] + along_px * azimuth.sin()];
                let ends = [from, to].map(|[x_px, y_px]| PixelPoint { x_px, y_px });
                OtherLight {
                    kind: LightKind::CosmicRay,
                    hip: None,
                    electrons,
                    ends,
                    form: LightForm::Track { sigma_px: rays.diffusion_px },
                }
            })
            .collect()
    }
}

/// Checks the table.
pub(super) fn check(refuse: Refuse<'_>, rays: &CosmicRayTable) -> Result<(), SceneError> {
    let values = [rays.expected_per_s, rays.thickness_um, rays.pitch_um, rays.electrons_per_um, rays.diffusion_px];
    for (spec, value) in PARAMETERS.iter().zip(values) {
        if !(spec.range.0..=spec.range.1).contains(&value) {
            let remedy =
                "must have rates 0 … 1e6 a second, 0.1 … 2000 and 0.5 … 1000 µm, 0 … 1e5 electrons a µm, a diffusion of 0.1 … 10 px";
            return refuse(format!("cosmic_rays.{}", spec.name), value.to_string(), remedy);
        }
    }
    Ok(())
}

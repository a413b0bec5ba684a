//! Agreement of GPU and CPU, measured on this machine.

use super::{Backend, EffectSetting, FrameExposure, Imager, ImagingConfig, ImagingError, PlacedStar, Stage};
use crate::effects::ids;

/// Differences between a frame made on the GPU and the same frame made on the CPU.
#[derive(Clone, Debug, PartialEq)]
pub struct TwinReport {
    /// The adapter that was compared with the CPU.
    pub adapter: String,
    /// Pixels of the frame.
    pub pixels: usize,
    /// Largest difference of expected electrons, in units of the tolerance: 1e-5 of the pixel, or 1e-6 of the brightest star that lights it
    /// where that is more. Up to 1 is agreement.
    pub electrons_in_tolerances: f64,
    /// Pixels whose counts differ in the noisy frame.
    pub differing_pixels: usize,
    /// The largest of those differences.
    pub largest_difference_dn: u16,
}

impl TwinReport {
    /// Whether the twins agree as they should: electrons within the tolerance, at most 1e-4 of the noisy pixels different, by at most 1 DN.
    #[must_use]
    pub fn agrees(&self) -> bool {
        self.electrons_in_tolerances <= 1.0 && self.differing_pixels as f64 <= 1e-4 * self.pixels as f64 && self.largest_difference_dn <= 1
    }
}

/// Number of counts that differ, and the largest difference.
#[must_use]
pub fn compare_counts(a: &[u16], b: &[u16]) -> (usize, u16) {
    let differences = a.iter().zip(b).map(|(a, b)| a.abs_diff(*b));
    let differing = differences.clone().filter(|difference| *difference > 0).count();
    (differing + a.len().abs_diff(b.len()), differences.max().unwrap_or(0))
}

/// Makes a small frame of stars, with and without noise, on the GPU (any adapter) and on the CPU, and compares them.
pub fn twin_check() -> Result<TwinReport, ImagingError> {
    let config = ImagingConfig {
        width_px: 256,
        height_px: 256,
        seed: 1,
        point_spread: "gaussian_psf".to_owned(),
        effects: vec![
            EffectSetting::new(ids::BACKGROUND, &[("background_e_per_px_s", 20.0)]),
            EffectSetting::new(ids::PHOTON_NOISE, &[]),
            EffectSetting::new(ids::READ_NOISE, &[("read_noise_e", 5.0)]),
            EffectSetting::new(
                ids::ADC,
                &[("gain_e_per_dn", 2.0), ("bias_dn", 200.0), ("full_well_e", 1e5), ("saturation_dn", 65_535.0), ("bits", 16.0)],
            ),
        ],
    };
    // Places by the golden ratio: even over the frame, with every sub-pixel phase.
    let stars: Vec<PlacedStar> = (0..60)
        .map(|i| {
            let turn = |ratio: f64| (f64::from(i) * ratio).fract();
            let electrons = 10.0_f64.powf(2.0 + 4.0 * turn(0.381_966_011));
            PlacedStar { x_px: 256.0 * turn(0.754_877_666), y_px: 256.0 * turn(0.569_840_291), electrons, sigma_px: 0.6 + 1.5 * turn(0.22) }
        })
        .collect();
    let exposure = FrameExposure { stars: &stars, sky_e: &[], exposure_s: 0.5, frame_index: 0, temperature_c: None };
    let (gpu, cpu) = (Imager::new(Backend::Gpu, &config)?, Imager::new(Backend::Cpu, &config)?);
    let (on_gpu, on_cpu) = (gpu.electrons_after(Some(Stage::Light), &exposure)?, cpu.electrons_after(Some(Stage::Light), &exposure)?);
    let electrons_in_tolerances = electrons_in_tolerances(&on_gpu, &on_cpu, &stars, config.width_px);
    let (on_gpu, on_cpu) = (gpu.expose(&exposure)?, cpu.expose(&exposure)?);
    let (differing_pixels, largest_difference_dn) = compare_counts(&on_gpu.pixels_dn, &on_cpu.pixels_dn);
    Ok(TwinReport {
        adapter: gpu.adapter(),
        pixels: on_cpu.pixels_dn.len(),
        electrons_in_tolerances,
        differing_pixels,
        largest_difference_dn,
    })
}

/// Largest difference of two images of expected electrons in units of the tolerance of [`TwinReport::electrons_in_tolerances`].
fn electrons_in_tolerances(a: &[f32], b: &[f32], stars: &[PlacedStar], width_px: usize) -> f64 {
    let mut floor = vec![0.0_f64; b.len()];
    for star in stars {
        let reach = (9.0 * star.sigma_px + 1.0).ceil();
        for y in (star.y_px - reach).max(0.0) as usize..=(star.y_px + reach) as usize {
            for x in (star.x_px - reach).max(0.0) as usize..=((star.x_px + reach) as usize).min(width_px - 1) {
                if let Some(pixel) = floor.get_mut(y * width_px + x) {
                    *pixel = pixel.max(1e-6 * star.electrons);
                }
            }
        }
    }
    let in_tolerances = |((a, b), floor): ((&f32, &f32), &f64)| {
        let tolerance = (1e-5 * f64::from(*b)).max(*floor);
        let difference = (f64::from(*a) - f64::from(*b)).abs();
        if difference == 0.0 { 0.0 } else { difference / tolerance }
    };
    // NaN counts as infinitely far: f64::max would pass over it.
    a.iter().zip(b).zip(&floor).map(in_tolerances).fold(0.0, |worst, one| if one.is_nan() { f64::INFINITY } else { worst.max(one) })
}

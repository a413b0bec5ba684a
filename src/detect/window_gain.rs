//! Photon noise without a declared gain, for stars measured in windows: the counterpart of [`super::gain`], which is for fits. It estimates the
//! variance of the counts per count of light.
//!
//! Flux and centre are sums of the counts, so what is left of a pixel is linear in them: r = (1 − H) d with H of rank three, and
//! E r_i² = v_i (1 − 2 H_ii) + Σ_j H_ij² v_j takes no more than sums over the window.

use super::gain::{GainStatistics, pooled};
use super::image_model::axis_shares;
use crate::frame::Frame;
use crate::statistics::order::ascending;

/// Fainter stars tell nothing, brighter ones more of their image than of photons.
const SNR_RANGE: (f64, f64) = (8.0, 60.0);
const MIN_STARS: usize = 5;
/// Where all are brighter the faintest must do.
const FAINTEST: usize = 20;

/// A measured star and how it was measured.
pub(super) struct WindowStar {
    pub(super) centre: [f64; 2],
    pub(super) level_dn: f64,
    pub(super) noise_dn: f64,
    /// As stated without photons: more than it is.
    pub(super) snr: f64,
}

/// How stars are measured: σ of the image before the pixels sum it, variance of the weight, half the side of the window, and what a shift is
/// multiplied with.
#[derive(Clone, Copy)]
pub(super) struct Way {
    pub(super) sigma_px: f64,
    pub(super) weight2: f64,
    pub(super) radius: usize,
    pub(super) gain: f64,
}

/// The value that these stars tell together; 0 where there are too few.
pub(super) fn variance_per_dn(frame: &Frame, mut stars: Vec<WindowStar>, way: Way) -> f64 {
    stars.retain(|star| star.snr > SNR_RANGE.0);
    ascending(&mut stars, |a| a.snr);
    let in_range = stars.iter().filter(|star| star.snr < SNR_RANGE.1).count();
    stars.truncate(if in_range < MIN_STARS { FAINTEST } else { in_range });
    let told: Vec<GainStatistics> = stars.iter().filter_map(|star| told(frame, star, way)).collect();
    if told.len() < MIN_STARS { 0.0 } else { pooled(&told, 0.0) }
}

/// A pixel of a star: what is left of it, its share of the light, what its count does to flux, x and y, and what these do to it.
struct Pixel {
    rest: f64,
    share: f64,
    to: [f64; 3],
    from: [f64; 3],
}

fn told(frame: &Frame, star: &WindowStar, way: Way) -> Option<GainStatistics> {
    let axis = |centre: f64, length: usize| {
        let from = centre.round() - way.radius as f64;
        // stars at the rim tell no less, but there are others
        (from >= 0.0 && from + 2.0 * way.radius as f64 <= (length - 1) as f64).then_some(from as usize)
    };
    let side = 2 * way.radius + 1;
    let [cx, cy] = star.centre;
    let (x0, y0) = (axis(cx, frame.width_px)?, axis(cy, frame.height_px)?);
    let (across, down) = (axis_shares(x0, side, cx, way.sigma_px), axis_shares(y0, side, cy, way.sigma_px));
    let (mut own, mut light, mut mass) = (0.0, 0.0, 0.0);
    let mut pixels = Vec::with_capacity(side * side);
    for (row, v) in down.iter().enumerate() {
        for (column, u) in across.iter().enumerate() {
            let (dx, dy) = ((x0 + column) as f64 - cx, (y0 + row) as f64 - cy);
            let count = f64::from(frame.at(x0 + column, y0 + row)) - star.level_dn;
            if frame.at(x0 + column, y0 + row) >= frame.saturation_dn {
                return None;
            }
            let share = u[0] * v[0];
            let weight = (-0.5 * (dx * dx + dy * dy) / way.weight2).exp();
            own += share * share;
            light += share * count;
            mass += weight * share;
            let to = [share, way.gain * weight * dx, way.gain * weight * dy];
            pixels.push(Pixel { rest: count, share, to, from: [share, u[1] * v[0], u[0] * v[1]] });
        }
    }
    let flux_dn = light / own;
    for pixel in &mut pixels {
        pixel.rest -= flux_dn * pixel.share;
        // a shift is a share of the flux, and so is what it does: the flux cancels
        pixel.to = [pixel.to[0] / own, pixel.to[1] / mass, pixel.to[2] / mass];
    }
    // Σ_j v_j t_j t_jᵀ for noise of one and for light of one
    let (mut dark, mut lit) = ([[0.0; 3]; 3], [[0.0; 3]; 3]);
    for pixel in &pixels {
        for a in 0..3 {
            for b in 0..3 {
                let product = pixel.to[a] * pixel.to[b];
                dark[a][b] += product;
                lit[a][b] += product * pixel.share;
            }
        }
    }
    let through =
        |matrix: &[[f64; 3]; 3], f: &[f64; 3]| (0..3).map(|a| (0..3).map(|b| f[a] * matrix[a][b] * f[b]).sum::<f64>()).sum::<f64>();
    let least = 0.01 * pixels.iter().map(|p| p.share).fold(0.0, f64::max);
    let mut told = GainStatistics::default();
    for pixel in pixels.iter().filter(|p| p.share > least) {
        let hat: f64 = (0..3).map(|a| pixel.from[a] * pixel.to[a]).sum();
        let quiet = star.noise_dn.powi(2) * (1.0 - 2.0 * hat + through(&dark, &pixel.from));
        let bright = flux_dn * (pixel.share * (1.0 - 2.0 * hat) + through(&lit, &pixel.from));
        told.add(flux_dn * pixel.share, pixel.rest, quiet, bright);
    }
    told.is_telling().then_some(told)
}

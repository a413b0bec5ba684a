//! # Point spread from tables
//!
//! ## What it does
//!
//! What way of spreading light has no closed form (a Moffat function, diffraction, a wavefront, a measured image) is worked out
//! once, with the pixel's own response in it, on a grid finer than the pixels; stars read it there. Several tables serve images that change over
//! the field and with colour: each star mixes those nearest to it.
//!
//! ## Equation
//!
//! T(d) = ∫ p(u)·R(d − u) d²u, p = the density of light around the star, R = the response of the pixel, d = the pixel's
//! centre minus the star. The tables hold the coefficients of the cubic B-spline that takes the values T at the grid's points; a star's
//! share is the spline at d, and with several tables their weighted sum.
//!
//! ## Parameters
//!
//! None of its own: those of the kind of image that fills the tables.
//!
//! ## Signature
//!
//! See the kinds of image.
//!
//! ## Confused with
//!
//! See there.
//!
//! ## Neglected
//!
//! Between the grid's points the spline is off by about 0.013·T⁗/K⁴, K = points a pixel: K is chosen so that this stays below 3e-6
//! of the light. Light is followed to `reach_px` of the scene; over the last fifth of it the image fades to nothing.
//!
//! ## Source
//!
//! M. Unser, IEEE Signal Processing Magazine 16(6), 22 (1999) for the spline; J. Anderson, I. King, PASP 112, 1360 (2000) for tables
//! that have the pixel in them.

use crate::effects::ParameterSpec;
use crate::effects::pixel::{Atlas, Psf2d, Psf2dStar, Rows};

/// Point spread from tables.
#[derive(Clone, Copy, Debug)]
pub struct AtlasPsf;

/// Values before the tables.
pub const HEADER: usize = 4;

/// The four weights of the cubic B-spline at the share `u` of a step behind the second of its knots.
fn weights(u: f32) -> [f32; 4] {
    let v = 1.0 - u;
    [
        v * v * v * (1.0 / 6.0),
        (3.0 * u - 6.0) * u * u * (1.0 / 6.0) + 2.0 / 3.0,
        ((3.0 - 3.0 * u) * u + 3.0) * u * (1.0 / 6.0) + 1.0 / 6.0,
        u * u * u * (1.0 / 6.0),
    ]
}

/// Where four taps around an offset lie: whole pixels, phases, weights.
struct Taps {
    pixel: i32,
    phase: i32,
    weights: [f32; 4],
}

impl Taps {
    fn new(offset: f32, oversampling: i32) -> Self {
        let whole = offset.floor();
        let fine = (offset - whole) * oversampling as f32;
        let phase = (fine as i32).min(oversampling - 1);
        Self { pixel: whole as i32, phase, weights: weights(fine - phase as f32) }
    }

    /// The k-th tap: pixels and phase.
    fn tap(&self, k: i32, oversampling: i32) -> (i32, i32) {
        let fine = self.phase + k - 1;
        if fine < 0 {
            (self.pixel - 1, fine + oversampling)
        } else if fine >= oversampling {
            (self.pixel + 1, fine - oversampling)
        } else {
            (self.pixel, fine)
        }
    }
}

#[allow(clippy::cast_possible_wrap, clippy::cast_sign_loss, reason = "a row has at most 65 535 pixels, a table fewer")]
/// The twin: adds `star` to the rows.
fn atlas_psf(star: &Psf2dStar, atlas: &Atlas, rows: &mut Rows<'_>) {
    let [oversampling, side, ..] = *atlas.values else { return };
    let (oversampling, side) = (oversampling as i32, side as i32);
    let middle = side / 2;
    let plane = (side * side) as usize;
    star.for_each_row(rows, |dy, first_dx, pixels, sum| {
        let (down, across) = (Taps::new(dy, oversampling), Taps::new(first_dx, oversampling));
        let row = down.pixel + middle;
        if row < 1 || row + 2 > side - 1 {
            return;
        }
        // Pixels whose taps all lie in the table.
        let skipped = (1 - (across.pixel + middle)).max(0) as usize;
        let first = across.pixel + middle + skipped as i32;
        let count = (side - 2 - first).clamp(0, (pixels.len() as i32 - skipped as i32).max(0)) as usize;
        if count == 0 {
            return;
        }
        sum.clear();
        sum.resize(count, 0.0);
        for node in 0..star.nodes as usize {
            let table = HEADER + star.node[node] as usize * (oversampling * oversampling) as usize * plane;
            for j in 0..4 {
                let (pixel_y, phase_y) = down.tap(j, oversampling);
                for k in 0..4 {
                    let (pixel_x, phase_x) = across.tap(k, oversampling);
                    let weight = star.weight[node] * (down.weights[j as usize] * across.weights[k as usize]);
                    let from = table
                        + (phase_y * oversampling + phase_x) as usize * plane
                        + ((pixel_y + middle) * side + first + pixel_x - across.pixel) as usize;
                    let Some(values) = atlas.values.get(from..from + count) else { return };
                    for (sum, value) in sum.iter_mut().zip(values) {
                        *sum += weight * value;
                    }
                }
            }
        }
        for (pixel, share) in pixels[skipped..].iter_mut().zip(sum.iter()) {
            *pixel += star.electrons * share;
        }
    });
}

impl Psf2d for AtlasPsf {
    fn id(&self) -> &'static str {
        "atlas_psf"
    }
    fn parameters(&self) -> &'static [ParameterSpec] {
        &[]
    }
    fn wgsl(&self) -> &'static str {
        include_str!("../../../shaders/atlas_psf.wgsl")
    }
    fn wgsl_share(&self) -> &'static str {
        "atlas_psf(star, dx, dy)"
    }
    fn loop_iterations(&self) -> u32 {
        // Up to eight tables, four rows and four columns of taps in each.
        8 * (4 * (4 + 1) + 1) + 1
    }
    fn source(&self) -> &'static str {
        page_source!("atlas_psf.rs")
    }
    fn add_plane(&self, star: &Psf2dStar, atlas: &Atlas, rows: &mut Rows<'_>) {
        atlas_psf(star, atlas, rows);
    }
}

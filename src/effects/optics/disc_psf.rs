//! # Ghosts: defocused images of bright stars
//!
//! ## What it does
//!
//! Light that is reflected twice between surfaces of the optics comes to its focus elsewhere: a disc, often with the hole of the
//! central obstruction, on the other side of the field.
//!
//! ## Equation
//!
//! A star at x sends the share `fraction` of its light to the disc around c + `scale`·(x − c), c = the principal point: `scale` below 0
//! is a reflection in the point c. The disc has even light between the radii `obstruction`·`radius_px` and `radius_px`. The share of a pixel is
//! exact along x, and along y a Gauss–Legendre sum of sixteen nodes.
//!
//! ## Parameters
//!
//! `scale`, `fraction`, `radius_px`, `obstruction`, in `[[ghosts]]` of a scene, one table for each pair of surfaces.
//!
//! ## Signature
//!
//! Faint discs that no star of the catalogue explains, at a fixed map of the bright ones.
//!
//! ## Confused with
//!
//! Nebulae and stray light, which do not follow the stars when the camera turns; crosstalk, which is sharp.
//!
//! ## Neglected
//!
//! Changes of radius and brightness over the field, vignetting of the disc, rings of diffraction at its edges, its own smear; stars
//! outside the frame.
//!
//! ## Source
//!
//! Ray tracing of a pair of surfaces to first order: W. T. Welford, Aberrations of Optical Systems (1986).

use crate::effects::ParameterSpec;
use crate::effects::pixel::{Atlas, Psf2d, Psf2dStar, Rows};

/// A disc or ring of even light.
#[derive(Clone, Copy, Debug)]
pub struct DiscPsf;

/// Nodes in (−½, ½) and weights of the Gauss–Legendre rule with sixteen nodes, one of each pair (Abramowitz and Stegun 1964, table 25.4, halved).
const NODES: [[f32; 2]; 8] = [
    [0.047_506_254, 0.094_725_31],
    [0.140_801_78, 0.091_301_71],
    [0.229_008_39, 0.084_578_26],
    [0.308_938_12, 0.074_797_99],
    [0.377_702_2, 0.062_314_486],
    [0.432_815_6, 0.047_579_255],
    [0.472_287_5, 0.031_126_762],
    [0.494_700_47, 0.013_576_23],
];

/// What a deposit carries for a ring between these radii, px.
#[must_use]
pub fn shape(radius_px: f64, hole_px: f64) -> [f32; 4] {
    let area = std::f64::consts::PI * (radius_px * radius_px - hole_px * hole_px);
    [radius_px as f32, hole_px as f32, (1.0 / area) as f32, 0.0]
}

/// Length of the pixel at `dx` that lies within ±half of the middle.
fn within(dx: f32, half: f32) -> f32 {
    ((dx + 0.5).min(half) - (dx - 0.5).max(-half)).max(0.0)
}

/// The twin: adds `star` to the rows.
fn disc_psf(star: &Psf2dStar, rows: &mut Rows<'_>) {
    let [radius, hole, density, _] = star.shape;
    star.for_each_row(rows, |dy, first_dx, pixels, _| {
        for [node, weight] in NODES {
            for v in [dy - node, dy + node] {
                let outer = (radius * radius - v * v).max(0.0).sqrt();
                let inner = (hole * hole - v * v).max(0.0).sqrt();
                let electrons = star.electrons * (weight * density);
                for (i, pixel) in pixels.iter_mut().enumerate() {
                    let dx = first_dx + i as f32;
                    *pixel += electrons * (within(dx, outer) - within(dx, inner));
                }
            }
        }
    });
}

impl Psf2d for DiscPsf {
    fn id(&self) -> &'static str {
        "disc_psf"
    }
    fn parameters(&self) -> &'static [ParameterSpec] {
        &[
            ParameterSpec { name: "scale", unit: "", typical: -1.0, range: (-10.0, 10.0) },
            ParameterSpec { name: "fraction", unit: "", typical: 1e-4, range: (0.0, 0.5) },
            ParameterSpec { name: "radius_px", unit: "px", typical: 20.0, range: (1.0, 2000.0) },
            ParameterSpec { name: "obstruction", unit: "", typical: 0.0, range: (0.0, 0.95) },
        ]
    }
    fn wgsl(&self) -> &'static str {
        include_str!("../../../shaders/disc_psf.wgsl")
    }
    fn wgsl_share(&self) -> &'static str {
        "disc_psf(star, dx, dy)"
    }
    fn loop_iterations(&self) -> u32 {
        9
    }
    fn source(&self) -> &'static str {
        page_source!("disc_psf.rs")
    }
    fn add_plane(&self, star: &Psf2dStar, _: &Atlas, rows: &mut Rows<'_>) {
        disc_psf(star, rows);
    }
}

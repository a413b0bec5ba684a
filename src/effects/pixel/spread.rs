//! Point spreads: how the light of a star is spread over pixels.
//!
//! A **separable** spread ([`SeparablePsf`]) is the product of a profile along the columns and one along the rows: the fast way. A **plane**
//! spread ([`Psf2d`]) is any function of the two offsets; its stars ([`Psf2dStar`]) may move from row to row, as under a rolling
//! shutter, and may be read from tables ([`Atlas`]).

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use crate::effects::{ParameterSpec, optics};

/// A star's image as the GPU and the twins read it: integer pixel plus fraction, so that f32 does not blur its place.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct SeparableStar {
    /// Column of the pixel whose centre is nearest.
    pub column: i32,
    /// Its row.
    pub row: i32,
    /// Offset from that centre to the right, px, in [−0.5, 0.5].
    pub fraction_x: f32,
    /// Offset downwards.
    pub fraction_y: f32,
    /// Expected electrons over the exposure.
    pub electrons: f32,
    /// 1/σ of the image, px⁻¹.
    pub inverse_sigma: f32,
    /// Half the side of the square of pixels that receive light, not counting the middle one.
    pub reach: i32,
    /// Keeps the size a multiple of 16 bytes.
    pub unused: u32,
}

/// A run of whole rows of a frame, in electrons.
#[derive(Debug)]
pub struct Rows<'a> {
    /// Columns of the frame.
    pub width: usize,
    /// The first of the rows.
    pub first_row: usize,
    /// Electrons, row by row.
    pub electrons: &'a mut [f32],
    /// Space for a twin's own use, kept between calls.
    pub scratch: &'a mut Vec<f32>,
}

/// How the light of a star is spread: as the product of a profile along the columns and one along the rows. A spread that is no such product is
/// a [`Psf2d`].
pub trait SeparablePsf: Sync {
    /// Its id in files, and the name of its twin and of its WGSL function `fn id_quad(star: Star, first_px: f32, fraction_px: f32) -> vec4<f32>`:
    /// the shares of the star's light, along one axis, in four pixels of which the first lies `first_px` (a whole number) from the star's
    /// own pixel; the star lies `fraction_px` from that one's centre.
    fn id(&self) -> &'static str;
    /// Its parameters, which each star carries.
    fn parameters(&self) -> &'static [ParameterSpec];
    /// The text of its shader.
    fn wgsl(&self) -> &'static str;
    /// The text of its source file, whose head is its page.
    fn source(&self) -> &'static str;
    /// [`Star::reach`] for a star of so many electrons and this σ.
    fn reach(&self, electrons: f64, sigma_px: f64) -> i32;
    /// The CPU twin: adds the star's light to the rows.
    fn add(&self, star: &SeparableStar, rows: &mut Rows<'_>);
}

/// Tables that one star may be a mixture of.
pub const MAX_NODES: usize = 8;

/// A star's image for a [`Psf2d`].
///
/// Under a rolling shutter each row sees the star at a time of its own. Near the star its place is linear in the row: in the row at y the
/// star stands `shear_x`·(y − y₀) px to the right of (x₀, y₀) and `shear_y`·(y − y₀) px below.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Psf2dStar {
    /// Column of the pixel whose centre is nearest to (x₀, y₀).
    pub column: i32,
    /// Its row.
    pub row: i32,
    /// Offset of x₀ from that centre, px, in [−0.5, 0.5].
    pub fraction_x: f32,
    /// Offset of y₀.
    pub fraction_y: f32,
    /// Expected electrons over the exposure.
    pub electrons: f32,
    /// 1/σ for a round spread, px⁻¹.
    pub inverse_sigma: f32,
    /// Columns that the star moves from one row to the next.
    pub shear_x: f32,
    /// Rows that it moves.
    pub shear_y: f32,
    /// What the spread makes of its parameters.
    pub shape: [f32; 4],
    /// Half the side of the square of pixels that receive light, not counting the middle one.
    pub reach: i32,
    /// Tables of the atlas that are mixed; 0 without an atlas.
    pub nodes: u32,
    /// Keeps the size a multiple of 16 bytes.
    pub unused: [u32; 2],
    /// Their indices.
    pub node: [u32; MAX_NODES],
    /// Their weights.
    pub weight: [f32; MAX_NODES],
}

impl Psf2dStar {
    /// Calls `line` with the pixels of each row that the star lights: the row's offset from the star (px), the first pixel's, the pixels,
    /// and space for the spread's own use.
    #[allow(clippy::cast_possible_wrap, reason = "the sides of a frame are at most 65 535 px")]
    pub fn for_each_row(&self, rows: &mut Rows<'_>, mut line: impl FnMut(f32, f32, &mut [f32], &mut Vec<f32>)) {
        let clip = |middle: i32, first: i64, count: usize| {
            let (low, high) = (i64::from(middle) - i64::from(self.reach) - first, i64::from(middle) + i64::from(self.reach) - first);
            (low.clamp(0, count as i64) as usize, (high + 1).clamp(0, count as i64) as usize)
        };
        let (left, right) = clip(self.column, 0, rows.width);
        let (top, bottom) = clip(self.row, rows.first_row as i64, rows.electrons.len() / rows.width.max(1));
        if left >= right {
            return;
        }
        for row in top..bottom {
            let along = ((rows.first_row + row) as i64 - i64::from(self.row)) as f32 - self.fraction_y;
            let first = (left as i64 - i64::from(self.column)) as f32 - (self.fraction_x + self.shear_x * along);
            let pixels = &mut rows.electrons[row * rows.width + left..row * rows.width + right];
            line(along - self.shear_y * along, first, pixels, rows.scratch);
        }
    }
}

/// Tables of point spreads, integrated over the pixel: what has no closed form.
///
/// A table holds the share of light in a pixel at offsets of 1/`oversampling` px, as coefficients of a cubic spline, phase by phase:
/// `values[4 + ((node·K + phase_y)·K + phase_x)·side² + iy·side + ix]` belongs to the offset ((ix·K + phase_x)/K − middle, …), middle =
/// side/2 rounded down. The first four values are K, side, the number of tables and 0.
#[derive(Clone, Debug, Default)]
pub struct Atlas {
    /// The values, shared by all who use them; their place in memory tells one atlas from another.
    pub values: Arc<[f32]>,
}

impl Atlas {
    /// The light that each table holds: its sum over the pixels of one phase, for all phases have the same.
    #[must_use]
    pub(crate) fn shares(&self) -> Vec<f64> {
        let [oversampling, side, ..] = *self.values else { return Vec::new() };
        let plane = (side * side) as usize;
        let tables = self.values[4..].chunks_exact((oversampling * oversampling) as usize * plane);
        tables.map(|table| table[..plane].iter().map(|share| f64::from(*share)).sum()).collect()
    }
}

/// How light is spread that is no product of two profiles.
pub trait Psf2d: Sync {
    /// Its id in files, and the name of its twin and of its function in WGSL.
    fn id(&self) -> &'static str;
    /// Its parameters.
    fn parameters(&self) -> &'static [ParameterSpec];
    /// The text of another shader whose functions its own calls.
    fn wgsl_library(&self) -> &'static str {
        ""
    }
    /// The text of its shader.
    fn wgsl(&self) -> &'static str;
    /// The share of light in the pixel at the offset (`dx`, `dy`) px from `star`, as an expression of WGSL.
    fn wgsl_share(&self) -> &'static str;
    /// Iterations of loops that one share costs an invocation, at most.
    fn loop_iterations(&self) -> u32;
    /// The text of its source file, whose head is its page.
    fn source(&self) -> &'static str;
    /// The CPU twin: adds the star's light to the rows.
    fn add_plane(&self, star: &Psf2dStar, atlas: &Atlas, rows: &mut Rows<'_>);
}

/// Every separable point spread.
pub static POINT_SPREADS: &[&dyn SeparablePsf] = &[&optics::gaussian_psf::GaussianPsf];

/// Every plane point spread.
pub static PLANE_SPREADS: &[&dyn Psf2d] = &[
    &optics::gaussian_psf::GaussianPsf,
    &optics::elliptic_gaussian_psf::EllipticGaussianPsf,
    &optics::atlas_psf::AtlasPsf,
    &optics::disc_psf::DiscPsf,
];

/// The separable point spread with this id.
#[must_use]
pub fn separable_psf(id: &str) -> Option<&'static dyn SeparablePsf> {
    POINT_SPREADS.iter().copied().find(|spread| spread.id() == id)
}

/// The plane point spread with this id.
#[must_use]
pub fn psf_2d(id: &str) -> Option<&'static dyn Psf2d> {
    PLANE_SPREADS.iter().copied().find(|spread| spread.id() == id)
}

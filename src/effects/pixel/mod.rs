//! What works on pixels: point spreads, which turn a star into light, and pixel effects, which change what a pixel holds.
//!
//! Each is one file here and one shader of the same name: a CPU twin written to be fast, and a WGSL function. The renderer joins the
//! shaders of what is switched on into one program ([`crate::imaging`]); what is off is not in it. A new one needs its two files and one
//! line in [`PIXEL_EFFECTS`] or [`POINT_SPREADS`]; the tests that walk the registries then compare its twins, its uniforms and its page.
//!
//! A pixel effect sees one pixel. What moves charge between pixels is a pass over the whole frame ([`pass`]), in its place in the same list:
//! the effects before it and those after it are programs of their own.

pub(crate) mod defect_pixels;
mod found_stage;
pub(crate) mod lanes;
pub mod math;
pub mod pass;
pub mod pattern;
pub(crate) mod poisson;
mod spread;

pub use found_stage::{DetectorScale, found_parameter, found_stage};
pub use spread::{
    Atlas, MAX_NODES, PLANE_SPREADS, POINT_SPREADS, Psf2d, Psf2dStar, Rows, SeparablePsf, SeparableStar, psf_2d, separable_psf,
};

use bytemuck::Pod;

use self::pass::{FrameBuffer, Lines, Neighbours, PassShape};
use super::{ParameterSpec, detector, id_of, optics, sky, stem_of};
use crate::rng::StageKey;

/// Where along the way from light to count a pixel effect acts. The order of the variants is the order of the stages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// On the expected electrons of the exposure, before any chance.
    Light,
    /// From expected to collected electrons.
    Charge,
    /// On the way from the pixel to the converter, in electrons.
    Readout,
    /// From electrons to counts.
    Digital,
}

/// What an effect does to the light of a star, as far as truth without noise must know.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Role {
    /// It changes that light or moves it.
    #[default]
    Shapes,
    /// It adds electrons of its own, the same whether a star is there or not.
    Adds,
    /// It is chance, drawn anew in every frame.
    Noise,
    /// It ends or rounds what a pixel holds: full well, converter, compression.
    Cuts,
}

/// Everything of an exposure that an effect may need besides its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExposureContext {
    /// Exposure time.
    pub exposure_s: f64,
    /// Index of the frame in its series.
    pub frame_index: u32,
    /// The key of all noise.
    pub seed: u64,
    /// Columns of the frame.
    pub width_px: usize,
    /// Rows of the frame.
    pub height_px: usize,
    /// Temperature of the detector; `None`: that at which its parameters were measured.
    pub temperature_c: Option<f64>,
    /// Expected electrons of all stars that light the frame, with the part of their light that falls beside it, and of the sky behind them.
    pub star_light_e: f64,
}

impl ExposureContext {
    /// The middle of the frame, px.
    #[must_use]
    pub fn middle_px(&self) -> [f64; 2] {
        [self.width_px, self.height_px].map(|side| (side as f64 - 1.0) / 2.0)
    }

    /// Distance from the middle of the frame to the outer corner of its last pixel, px.
    #[must_use]
    pub fn half_diagonal_px(&self) -> f64 {
        (self.width_px as f64).hypot(self.height_px as f64) / 2.0
    }
}

impl Default for ExposureContext {
    /// One second of a dark frame of one pixel.
    fn default() -> Self {
        Self { exposure_s: 1.0, frame_index: 0, seed: 0, width_px: 1, height_px: 1, temperature_c: None, star_light_e: 0.0 }
    }
}

/// What the author of a pixel effect writes.
pub trait PixelEffect: Sync {
    /// Its id in files. With `_` for `-` it is the name of its twin and of its WGSL function: `fn id(electrons: f32, pixel: Pixel) -> f32`, or
    /// `fn id_quad(electrons: vec4<f32>, quad: u32) -> vec4<f32>` for the pixels 4 quad … 4 quad + 3 of the frame, where they share work.
    const ID: &'static str;
    /// Parameters that show more of it than the typical ones on the small frame of its picture.
    const DEMO_SIZES: &'static [(&'static str, f64)] = &[];
    /// Where it acts.
    const STAGE: Stage;
    /// What it does to the light of a star.
    const ROLE: Role = Role::Shapes;
    /// Its parameters.
    const PARAMETERS: &'static [ParameterSpec];
    /// Whether it draws random numbers.
    const DRAWS: bool = false;
    /// The key of its random numbers, different from that of every other effect; 0 if it draws none. It follows from the id; the eight effects
    /// that are older than this rule keep the numbers 1 to 8, with which their frames were made.
    /// The shader has it as the constant `ID_STAGE` (the id in capitals).
    const RNG_STAGE: u32 = if Self::DRAWS { stage_of(Self::ID) } else { 0 };
    /// The text of its shader.
    const WGSL: &'static str;
    /// The text of its source file, whose head is its page.
    const SOURCE: &'static str;
    /// What the parameters become on their way to the pixels: 4-byte numbers, `#[repr(C)]`. The shader has the same struct under the
    /// name `IdUniforms` (the id in camel case) and finds it in `effects.id`; `()` if there is none.
    type Uniforms: Pod;
    /// Name and offset in bytes of each member of [`Self::Uniforms`].
    const FIELDS: &'static [(&'static str, usize)];

    /// Below so many electrons it takes a way of its own, which the shader leaves out where the constant `ID_MAY_BE_FAINT` is false: where no pixel
    /// can hold less. Some drivers run both sides of every branch.
    const FAINT_BELOW_E: Option<f64> = None;

    /// Uniforms from parameters in the order of [`Self::PARAMETERS`].
    fn uniforms(parameters: &[f64], exposure: &ExposureContext) -> Self::Uniforms;
    /// The CPU twin: changes a run of pixels, of which the first has the index `first_pixel` in the frame.
    fn apply(uniforms: &Self::Uniforms, key: StageKey, first_pixel: u32, pixels: &mut [f32]);
    /// Parameters with which it changes nothing, if there are any.
    fn identity() -> Option<Vec<f64>>;
    /// Electrons that every pixel holds at least after it, if each held at least `least_e` before; 0 where that is not known.
    #[must_use]
    fn least_e(_parameters: &[f64], _exposure: &ExposureContext, _least_e: f64) -> f64 {
        0.0
    }
}

/// The key of the random numbers of an effect, from its id: FNV-1a with the highest bit set, above all keys that were given by hand.
const fn stage_of(id: &str) -> u32 {
    const OFFSET: u32 = 0x811c_9dc5;
    const PRIME: u32 = 0x0100_0193;
    let (bytes, mut hash, mut k) = (id.as_bytes(), OFFSET, 0);
    while k < bytes.len() {
        hash = (hash ^ bytes[k] as u32).wrapping_mul(PRIME);
        k += 1;
    }
    hash | 0x8000_0000
}

/// What an effect does, as the runner on the CPU calls it. The bytes are those of the effect's uniforms.
#[derive(Clone, Copy)]
pub enum Work {
    /// Changes a run of pixels, each by itself; see [`PixelEffect::apply`].
    Pixels(fn(&[u8], StageKey, u32, &mut [f32])),
    /// Moves charge over the whole frame.
    Frame(PassShape, fn(&[u8], &mut FrameBuffer<'_>)),
}

/// A pixel effect, or a pass, as the registry holds it.
pub trait AnyPixelEffect: Sync {
    /// See [`PixelEffect::ID`].
    fn id(&self) -> &'static str;
    /// Its id as the names of files, functions and shaders have it.
    fn stem(&self) -> String {
        stem_of(self.id())
    }
    /// See [`PixelEffect::DEMO_SIZES`].
    fn demo_sizes(&self) -> &'static [(&'static str, f64)];
    /// See [`PixelEffect::STAGE`].
    fn stage(&self) -> Stage;
    /// See [`PixelEffect::ROLE`].
    fn role(&self) -> Role;
    /// See [`PixelEffect::PARAMETERS`].
    fn parameters(&self) -> &'static [ParameterSpec];
    /// See [`PixelEffect::RNG_STAGE`].
    fn rng_stage(&self) -> u32;
    /// See [`PixelEffect::WGSL`].
    fn wgsl(&self) -> &'static str;
    /// See [`PixelEffect::SOURCE`].
    fn source(&self) -> &'static str;
    /// See [`PixelEffect::FIELDS`].
    fn fields(&self) -> &'static [(&'static str, usize)];
    /// The bytes of [`PixelEffect::uniforms`].
    fn uniforms(&self, parameters: &[f64], exposure: &ExposureContext) -> Vec<u8>;
    /// The CPU twin, which takes the bytes of [`Self::uniforms`] and no others.
    fn work(&self) -> Work;
    /// See [`PixelEffect::identity`].
    fn identity(&self) -> Option<Vec<f64>>;
    /// See [`PixelEffect::FAINT_BELOW_E`].
    fn faint_below_e(&self) -> Option<f64> {
        None
    }
    /// See [`PixelEffect::least_e`].
    fn least_e(&self, _parameters: &[f64], _exposure: &ExposureContext, _least_e: f64) -> f64 {
        0.0
    }
    /// Whether the frame holds as much charge after it as before, but for what leaves over an edge.
    fn conserves_charge(&self) -> bool {
        false
    }
}

impl<E: PixelEffect> AnyPixelEffect for E {
    fn id(&self) -> &'static str {
        E::ID
    }
    fn demo_sizes(&self) -> &'static [(&'static str, f64)] {
        E::DEMO_SIZES
    }
    fn stage(&self) -> Stage {
        E::STAGE
    }
    fn role(&self) -> Role {
        E::ROLE
    }
    fn parameters(&self) -> &'static [ParameterSpec] {
        E::PARAMETERS
    }
    fn rng_stage(&self) -> u32 {
        E::RNG_STAGE
    }
    fn wgsl(&self) -> &'static str {
        E::WGSL
    }
    fn source(&self) -> &'static str {
        E::SOURCE
    }
    fn fields(&self) -> &'static [(&'static str, usize)] {
        E::FIELDS
    }
    fn uniforms(&self, parameters: &[f64], exposure: &ExposureContext) -> Vec<u8> {
        bytemuck::bytes_of(&E::uniforms(parameters, exposure)).to_vec()
    }
    fn work(&self) -> Work {
        Work::Pixels(|uniforms, key, first_pixel, pixels| E::apply(&bytemuck::pod_read_unaligned(uniforms), key, first_pixel, pixels))
    }
    fn identity(&self) -> Option<Vec<f64>> {
        E::identity()
    }
    fn faint_below_e(&self) -> Option<f64> {
        E::FAINT_BELOW_E
    }
    fn least_e(&self, parameters: &[f64], exposure: &ExposureContext, least_e: f64) -> f64 {
        E::least_e(parameters, exposure, least_e)
    }
}

/// Goes through a run of pixels, of which the first has the index `first_pixel` in a frame of `width` columns, a piece of a row at a time: its
/// first column, its row and its pixels.
pub fn by_rows(width: u32, first_pixel: u32, mut pixels: &mut [f32], mut each: impl FnMut(u32, u32, &mut [f32])) {
    let (mut x, mut y) = (first_pixel % width, first_pixel / width);
    while !pixels.is_empty() {
        let (row, rest) = pixels.split_at_mut(((width - x) as usize).min(pixels.len()));
        each(x, y, row);
        (x, y, pixels) = (0, y + 1, rest);
    }
}

/// The same, a pixel at a time, with the square of its distance from a point, px². Its twin in the shaders is `radius2_px`.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]
pub fn by_radius2(width: u32, centre_px: [f32; 2], first_pixel: u32, pixels: &mut [f32], mut each: impl FnMut(f32, &mut f32)) {
    by_rows(width, first_pixel, pixels, |x, y, row| {
        let dy = y as f32 - centre_px[1];
        for (i, electrons) in (0..).zip(row) {
            let dx = (x + i) as f32 - centre_px[0];
            each(dx * dx + dy * dy, electrons);
        }
    });
}

/// Names and offsets of the members of a `#[repr(C)]` struct.
macro_rules! uniform_fields {
    ($uniforms:ty { $($field:ident),+ }) => { &[$((stringify!($field), core::mem::offset_of!($uniforms, $field))),+] };
}
pub(crate) use uniform_fields;

/// Every pixel effect and every pass, in the order in which they act.
pub static PIXEL_EFFECTS: &[&dyn AnyPixelEffect] = &[
    &optics::veiling_glare::VeilingGlare,
    &sky::background::Background,
    &detector::stray_light::StrayLightSlope,
    &optics::vignetting::Vignetting,
    &optics::field_stop::FieldStop,
    &detector::bayer::BayerMosaic,
    &detector::prnu::Prnu,
    &detector::dark_current::DarkCurrent,
    &detector::hot_pixels::HotPixels,
    &detector::random_telegraph::RandomTelegraph,
    &detector::photon_noise::PhotonNoise,
    &Neighbours(detector::brighter_fatter::BrighterFatter),
    &Lines(detector::blooming::Blooming),
    &Lines(detector::charge_transfer_inefficiency::TrappedCharge),
    &detector::nonlinearity::Nonlinearity,
    &detector::read_noise::ReadNoise,
    &detector::even_odd::EvenOddGain,
    &detector::amplifier_step::AmplifierHalves,
    &Lines(detector::overshoot::Settling),
    &Neighbours(detector::crosstalk::Crosstalk),
    &detector::banding::Banding,
    &detector::dnl::Dnl,
    &detector::adc::Adc,
    &Neighbours(detector::jpeg::Jpeg),
];

/// The pixel effect with this id; `_` is as good as `-`.
#[must_use]
pub fn pixel_effect(id: &str) -> Option<&'static dyn AnyPixelEffect> {
    let id = id_of(id);
    PIXEL_EFFECTS.iter().copied().find(|effect| effect.id() == id)
}

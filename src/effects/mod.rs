//! The physics: every effect is one file, and one line in a registry.
//!
//! - A **displacement** moves a star's image. It is one generic body ([`Displacement`]) over numbers: with `f64` it is
//!   rendered, with dual numbers the same body gives the columns that the calibrator fits.
//!   What moves the measured centre of an image is written as a [`CentroidShift`], and is a displacement by that.
//! - A **pixel effect** works on the frame. It is a CPU twin and a WGSL shader of the same name; see [`pixel`] and, for the engine that runs
//!   them, the module `imaging`.
//!
//! The folder says where the light meets the effect: [`sky`], [`optics`], [`motion`] or [`detector`].
//! The documentation of an effect's module is its page.

pub mod detector;
pub mod ids;
pub mod motion;
pub mod optics;
pub mod pixel;
pub mod sky;

mod centroid;
mod displacement;
mod facts;
mod page;
mod registry;
mod rendering;
mod result;
mod star_image;

pub use centroid::CentroidShift;
pub use displacement::{
    AnyDisplacement, Context, Displacement, Light, Natural, Observation, ParameterSpec, ReferenceValue, RefractionConstants, Searched,
    Segment, Sensor, StarState, invert,
};
pub use facts::{Facts, OrdinarySize, UsualSize, id_of, stem_of};
pub use page::{PAGE_HEADINGS, page_as_text, page_of};
pub use registry::{DISPLACEMENTS, Effect, displacement, effect, effects};
pub use rendering::Rendering;
pub use result::{EffectList, LIST_FORMAT, ListedEffect, ListedParameter};
pub use star_image::{MAX_SHIFTS, MAX_SIGNATURES, REFERENCE_FLUX_E, REFERENCE_MAGNITUDE, Signature, Signatures, StarImage};

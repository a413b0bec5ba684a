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

#[macro_use]
mod page; // its macro is used below and in `scene`

#[cfg(feature = "bench")]
pub mod detector;
#[cfg(not(feature = "bench"))]
pub(crate) mod detector;
#[cfg(feature = "bench")]
pub mod ids;
#[cfg(not(feature = "bench"))]
pub(crate) mod ids;
#[cfg(feature = "bench")]
pub mod motion;
#[cfg(not(feature = "bench"))]
pub(crate) mod motion;
#[cfg(feature = "bench")]
pub mod optics;
#[cfg(not(feature = "bench"))]
pub(crate) mod optics;
#[cfg(feature = "bench")]
pub mod pixel;
#[cfg(not(feature = "bench"))]
pub(crate) mod pixel;
#[cfg(feature = "bench")]
pub mod sky;
#[cfg(not(feature = "bench"))]
pub(crate) mod sky;

mod centroid;
mod displacement;
mod facts;
mod image_response;
mod registry;
mod rendering;
mod result;
mod star_image;

pub use centroid::CentroidShift;
pub use displacement::{
    AnyDisplacement, Context, Displacement, Light, Natural, Observation, ParameterSpec, ReferenceValue, RefractionConstants, Searched,
    Segment, Sensor, StarState,
};
pub use facts::{Facts, OrdinarySize, UsualSize};
pub use registry::{DISPLACEMENTS, Effect, displacement, effect, effects};
pub use rendering::Rendering;
pub use star_image::{Signature, Signatures, StarImage};
inner!(displacement::invert);
inner!(facts::{ModelGroup, id_of, stem_of});
inner!(image_response::{IMAGE_EFFECTS, ImageContext, ImageEffect, ImageResponse, MAGNITUDES});
inner!(page::{PAGE_HEADINGS, page_as_text, page_of});
pub(crate) use page::{head, head_length};
inner!(star_image::{MAX_SHIFTS, MAX_SIGNATURES, REFERENCE_FLUX_E, REFERENCE_MAGNITUDE});

pub use crate::dual::{Dual, Jet, Real};
inner!(result::{EffectList, LIST_FORMAT, ListedEffect, ListedParameter});

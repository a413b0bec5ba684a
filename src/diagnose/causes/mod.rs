//! Causes that are no effect of the registry: a declared number that is wrong, an image that is not the declared one. One file each.

mod axial_colour;
mod extinction;
mod focus_drift;
mod motion_smear;
mod passband;
mod psf_shape;

use crate::effects::ImageEffect;
pub(super) use extinction::EXTINCTION;
pub(super) use motion_smear::MOTION_SMEAR;

/// Those with columns in brightness or shape.
pub(super) static IMAGE_CAUSES: &[&dyn ImageEffect] = &[
    &passband::Passband,
    &extinction::Extinction,
    &psf_shape::FieldOfFocus,
    &psf_shape::FieldOfFocusBeyond,
    &axial_colour::AxialColour,
    &focus_drift::FocusDrift(&focus_drift::WITH_TEMPERATURE),
    &focus_drift::FocusDriftByPlace(&focus_drift::WITH_TEMPERATURE),
    &focus_drift::FocusDrift(&focus_drift::WITH_TIME),
    &focus_drift::FocusDriftByPlace(&focus_drift::WITH_TIME),
    &motion_smear::MotionSmear,
];

/// A declared gain, read noise or bias that is wrong.
pub(super) const GAIN_NOISE: &str = "gain-noise";
/// Rounding of blocks by the file format; the registry renders it as `jpeg`.
pub(super) const COMPRESSION: &str = "compression";
/// A frame exposed for another time than declared.
pub(super) const EXPOSURE_TIME: &str = "exposure-time";
/// Light of the stars lost in some frames.
pub(super) const CLOUDS: &str = "clouds";
/// A frame whose stars are brighter than in the others.
pub(super) const ZERO_POINT: &str = "zero-point";
/// Light that the lens reflects to the point mirrored in its axis.
pub(super) const GHOST: &str = "ghost";
/// Charge of a bright star that is released in the frame after.
pub(super) const PERSISTENCE: &str = "persistence";
/// A camera that shakes.
pub(super) const JITTER: &str = "jitter";
/// Straight lines of light: satellites, meteors, aircraft.
pub(super) const STREAKS: &str = "streaks";
/// A response that changes within a pixel: a part of the image of a star.
pub(super) const INTRAPIXEL_RESPONSE: &str = "intrapixel-response";
/// Tracks of charged particles.
pub(super) const COSMIC_RAYS: &str = "cosmic-rays";

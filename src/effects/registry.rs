//! The registry of displacements. A new one needs its file and a line here.

use super::AnyDisplacement;
use super::detector::{amplifier_step, bayer, charge_transfer_inefficiency, even_odd, overshoot, stray_light};
use super::detector::{detector_tilt, edge_roll_off, magnitude_equation, pixel_aspect, s_curve, sensor_step, shear};
use super::motion::{boresight_drift, rolling_shutter};
use super::optics::{brown_conrady, equidistant, equisolid, kannala_brandt, pinhole, stereographic};
use super::optics::{coma, lateral_colour, projection, quadratic_rest, radial_high_order, spiral, thin_prism, wedge_colour};
use super::optics::{focal_length_drift, pressure_scale, thermal_distortion, thermal_focal_length};
use super::sky::{
    chromatic_refraction, frame_rotation, light_deflection, parallax, proper_motion, refraction, stellar_aberration, time_tag,
};

/// Every displacement, in the order in which the light meets them.
pub static DISPLACEMENTS: &[&dyn AnyDisplacement] = &[
    &proper_motion::ProperMotion,
    &parallax::Parallax,
    &light_deflection::LightDeflection,
    &stellar_aberration::StellarAberration,
    &frame_rotation::FrameRotation,
    &time_tag::TimeTag,
    &refraction::Refraction,
    &chromatic_refraction::ChromaticRefraction,
    &rolling_shutter::RollingShutter,
    &pinhole::Pinhole,
    &equidistant::Equidistant,
    &equisolid::Equisolid,
    &stereographic::Stereographic,
    &kannala_brandt::KannalaBrandt,
    &wedge_colour::WedgeColour,
    &lateral_colour::LateralColour,
    &projection::ProjectionMismatch,
    &brown_conrady::BrownConrady,
    &radial_high_order::RadialHighOrder,
    &quadratic_rest::QuadraticRest,
    &thin_prism::ThinPrism,
    &spiral::Spiral,
    &detector_tilt::DetectorTilt,
    &pixel_aspect::PixelAspect,
    &shear::Shear,
    &sensor_step::SensorStep,
    &edge_roll_off::EdgeRollOff,
    &boresight_drift::BoresightDrift,
    &pressure_scale::PressureScale,
    &thermal_focal_length::ThermalFocalLength,
    &thermal_distortion::ThermalDistortion,
    &focal_length_drift::FocalLengthDrift,
    &coma::Coma,
    &s_curve::SCurve,
    &even_odd::EvenOdd,
    &bayer::Bayer,
    &charge_transfer_inefficiency::ChargeTransferInefficiency,
    &overshoot::Overshoot,
    &stray_light::StrayLight,
    &amplifier_step::AmplifierStep,
    &magnitude_equation::MagnitudeEquation,
];

/// The displacement with this id.
///
/// ```
/// use boresight::effects::displacement;
///
/// let refraction = displacement("refraction").unwrap();
/// assert_eq!(refraction.parameters()[0].unit, "arcsec");
/// assert!(refraction.page().contains("## Equation"));
/// ```
#[must_use]
pub fn displacement(id: &str) -> Option<&'static dyn AnyDisplacement> {
    DISPLACEMENTS.iter().copied().find(|effect| effect.id() == id)
}

//! The registry of displacements, in which a new one needs a line, and effects with their two faces.

use super::detector::{amplifier_step, bayer, charge_transfer_inefficiency, even_odd, overshoot, stray_light};
use super::detector::{detector_tilt, edge_roll_off, magnitude_equation, pixel_aspect, s_curve, sensor_step, shear};
use super::motion::{boresight_drift, rolling_shutter};
use super::optics::{brown_conrady, equidistant, equisolid, kannala_brandt, pinhole, stereographic};
use super::optics::{coma, lateral_colour, projection, quadratic_rest, radial_high_order, spiral, thin_prism, wedge_colour};
use super::optics::{focal_length_drift, pressure_scale, thermal_distortion, thermal_focal_length};
use super::pixel::{AnyPixelEffect, PIXEL_EFFECTS};
use super::sky::{
    chromatic_refraction, frame_rotation, light_deflection, parallax, proper_motion, refraction, stellar_aberration, time_tag,
};
use super::{AnyDisplacement, ParameterSpec, id_of, page_of};

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

/// An effect and its faces. Most have one; a cause that moves the measured centres of stars by what it does to pixels has two, of one id and
/// one page: the displacement is its formula, with parameters for the calibrator, and the pixel effect renders it.
#[derive(Clone, Copy)]
pub struct Effect {
    /// What moves the images of stars.
    pub displacement: Option<&'static dyn AnyDisplacement>,
    /// What changes pixels.
    pub pixels: Option<&'static dyn AnyPixelEffect>,
}

impl Effect {
    /// Its id.
    #[must_use]
    pub fn id(&self) -> &'static str {
        self.displacement.map(AnyDisplacement::id).or_else(|| self.pixels.map(AnyPixelEffect::id)).unwrap_or_default()
    }

    /// Its page.
    #[must_use]
    pub fn page(&self) -> String {
        self.displacement.map(AnyDisplacement::page).or_else(|| self.pixels.map(|effect| page_of(effect.source()))).unwrap_or_default()
    }

    /// Whether it has both faces.
    #[must_use]
    pub fn has_both_faces(&self) -> bool {
        self.displacement.is_some() && self.pixels.is_some()
    }

    /// Its parameters, those of the displacement first.
    pub fn parameters(&self) -> impl Iterator<Item = &'static ParameterSpec> + use<> {
        let moves = self.displacement.map_or(&[][..], |effect| effect.parameters());
        moves.iter().chain(self.pixels.map_or(&[][..], |effect| effect.parameters()))
    }

    /// The face on pixels, where parameters of these names are its own: a scene means the face whose parameters it gives. Without any the
    /// displacement is meant, if there is one.
    #[must_use]
    pub fn on_pixels<'a>(&self, mut names: impl Iterator<Item = &'a str>) -> Option<&'static dyn AnyPixelEffect> {
        let pixels = self.pixels?;
        let is_own = |name: &str| pixels.parameters().iter().any(|spec| spec.name == name);
        let is_meant = self.displacement.is_none() || (names.next().is_some_and(is_own) && names.all(is_own));
        is_meant.then_some(pixels)
    }
}

/// Every effect that moves images or changes pixels, once: the displacements in their order, then what works on pixels alone in its.
pub fn effects() -> impl Iterator<Item = Effect> {
    let alone = PIXEL_EFFECTS.iter().filter(|effect| displacement(effect.id()).is_none());
    DISPLACEMENTS.iter().map(|effect| effect.id()).chain(alone.map(|effect| effect.id())).filter_map(effect)
}

/// The effect with this id, `-` or `_` in it.
#[must_use]
pub fn effect(id: &str) -> Option<Effect> {
    let found = Effect { displacement: displacement(&id_of(id)), pixels: super::pixel::pixel_effect(id) };
    (found.displacement.is_some() || found.pixels.is_some()).then_some(found)
}

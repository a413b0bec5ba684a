//! What is known of one star image, beyond its star and its exposure: what moves the measured centre depends on it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Context;

/// Magnitudes count from this one in effects that depend on brightness: what a star of it suffers is taken up by the attitude or the scale.
pub const REFERENCE_MAGNITUDE: f64 = 5.0;
/// Electrons to which parameters refer that depend on a star's electrons. Where an image's electrons are not known, a star of
/// [`REFERENCE_MAGNITUDE`] is held to have so many: the parameter then is that of a star of this magnitude.
pub const REFERENCE_FLUX_E: f64 = 1e4;
/// Parameters that an effect on the measured centre has at most.
pub const MAX_SHIFTS: usize = 2;
/// Effects at most of which an image carries measured shifts.
pub const MAX_SIGNATURES: usize = 8;

/// One star image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct StarImage {
    /// Electrons above the background.
    pub flux_e: Option<f64>,
    /// Magnitude as measured; where it is not, the catalogue's stands in.
    pub magnitude: Option<f64>,
    /// Gradient of the background under the image in x and y, electrons per px per px.
    pub background_gradient_e_px: Option<[f64; 2]>,
    /// Root mean square of the size of that gradient over all star images of the recording.
    pub recording_gradient_e_px: Option<f64>,
    /// Width of the image (σ of a Gaussian), px.
    pub psf_sigma_px: Option<f64>,
    /// Shifts found by rendering this image with effects on and off.
    #[serde(skip)]
    pub signatures: Signatures,
}

/// How far an effect moves one image's measured centre, found by rendering the image with and without it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signature {
    /// The effect's id.
    pub effect: &'static str,
    /// Shift (x, y) in px per unit of each of its parameters, in their order; zero beyond the last.
    pub shift_px: [[f64; 2]; MAX_SHIFTS],
}

/// The signatures that an image carries, of no more than [`MAX_SIGNATURES`] effects.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Signatures([Option<Signature>; MAX_SIGNATURES]);

impl Signatures {
    /// Adds one; replaces that of the same effect. False, and nothing is changed, where there is no room left.
    #[must_use]
    pub fn set(&mut self, signature: Signature) -> bool {
        let is_place = |place: &&mut Option<Signature>| place.is_none_or(|own| own.effect == signature.effect);
        self.0.iter_mut().find(is_place).map(|place| *place = Some(signature)).is_some()
    }

    /// That of an effect.
    #[must_use]
    pub fn of(&self, effect: &str) -> Option<&Signature> {
        self.0.iter().flatten().find(|signature| signature.effect == effect)
    }
}

impl StarImage {
    /// Whether nothing is known of it.
    #[must_use]
    pub fn is_unknown(&self) -> bool {
        *self == Self::default()
    }

    /// The same image in the frame with left and right exchanged. Signatures belong to the frame in which they were found, and are dropped.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        let gradient = self.background_gradient_e_px.map(|[x, y]| [-x, y]);
        Self { background_gradient_e_px: gradient, signatures: Signatures::default(), ..*self }
    }
}

impl Context {
    /// Magnitude minus [`REFERENCE_MAGNITUDE`]: the measured one, else the catalogue's; zero where neither is known.
    #[must_use]
    pub fn magnitude_offset(&self) -> f64 {
        self.magnitude().map_or(0.0, |magnitude| magnitude - REFERENCE_MAGNITUDE)
    }

    /// Electrons over [`REFERENCE_FLUX_E`]: the measured ones, else as many as the magnitude lets expect; `None` where neither is known.
    #[must_use]
    pub fn relative_flux(&self) -> Option<f64> {
        let measured = self.image.flux_e.filter(|flux| *flux > 0.0 && flux.is_finite()).map(|flux| flux / REFERENCE_FLUX_E);
        measured.or_else(|| self.magnitude().map(|magnitude| 10.0_f64.powf(-0.4 * (magnitude - REFERENCE_MAGNITUDE))))
    }

    /// The measured magnitude, else the catalogue's. Tables write 99 where there is none.
    fn magnitude(&self) -> Option<f64> {
        const NONE: f64 = 90.0;
        self.image.magnitude.or(Some(self.star.magnitude)).filter(|magnitude| magnitude.abs() < NONE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{Observation, StarState};

    #[test]
    fn what_is_measured_goes_before_the_catalogue() {
        let star = StarState { magnitude: 7.5, ..StarState::default() };
        let catalogue = Context::new(star, Observation::default());
        assert_eq!((catalogue.magnitude_offset(), catalogue.relative_flux()), (2.5, Some(0.1)));
        let image = StarImage { flux_e: Some(5e3), magnitude: Some(4.0), ..StarImage::default() };
        let measured = catalogue.with_image(image);
        assert_eq!((measured.magnitude_offset(), measured.relative_flux()), (-1.0, Some(0.5)));
        for magnitude in [f64::NAN, 99.0] {
            let unknown = Context::new(StarState { magnitude, ..star }, Observation::default());
            assert_eq!((unknown.magnitude_offset(), unknown.relative_flux()), (0.0, None));
        }
    }

    #[test]
    fn signatures_are_replaced_and_run_out_of_room() {
        let mut all = Signatures::default();
        let own = |effect, x| Signature { effect, shift_px: [[x, 0.0], [0.0; 2]] };
        assert!(["a", "b", "c", "d", "e", "f", "g", "h"].into_iter().all(|effect| all.set(own(effect, 1.0))));
        assert!(all.set(own("b", 2.0)) && !all.set(own("i", 1.0)));
        assert_eq!(all.of("b").map(|signature| signature.shift_px[0][0]), Some(2.0));
        assert!(all.of("i").is_none() && all.of("a") == Some(&own("a", 1.0)));
    }
}

//! Effects that move the measured centre of a star's image: what is written for each, and how it becomes a displacement.
//!
//! They act on pixels; what they do to a position depends on the image and on the estimator. The formula of such an effect gives the shift
//! of the measured centre per unit of each parameter. Where the image has been rendered with the effect on and off and measured by the
//! estimator in use, the shift found so ([`super::Signatures`]) takes the formula's place. Either way the effect is a [`Displacement`] in
//! [`Segment::Focal`] like any other: what solves or tests it knows nothing of this.

use super::star_image::MAX_SHIFTS;
use super::{Context, Displacement, Facts, Light, Observation, ParameterSpec, ReferenceValue, Rendering, Segment};
use crate::dual::Real;

/// What the author of an effect on the measured centre writes. The ideal point is the measured one minus Σ pₖ·uₖ.
pub trait CentroidShift: Sync {
    /// Its id in files.
    const ID: &'static str;
    /// Its parameters: amplitudes, in which the shift is linear, of which zero means no effect. At most [`MAX_SHIFTS`].
    const PARAMETERS: &'static [ParameterSpec];
    /// See [`Displacement::FACTS`].
    const FACTS: Facts = Facts::NONE;
    /// See [`Displacement::WITHIN_PIXELS`].
    const WITHIN_PIXELS: bool = false;

    /// Shift (x, y) of the measured centre, px, per unit of the parameter with this index, at the measured point. Zero where what it
    /// depends on is not known of this image.
    fn unit_shift<T: Real>(parameter: usize, measured: &Light<T>, context: &Context) -> [T; 2];

    /// What this exposure lacks for the effect to be computed or fitted.
    #[must_use]
    fn missing(_observation: &Observation) -> Option<&'static str> {
        None
    }

    /// What this image lacks for its shift to be computed.
    #[must_use]
    fn missing_in(_context: &Context) -> Option<&'static str> {
        None
    }

    /// See [`Displacement::rendering`].
    #[must_use]
    fn rendering(_parameter: usize) -> Option<Rendering> {
        None
    }

    /// Cases from outside.
    fn reference_values() -> Vec<ReferenceValue>;

    /// The source file of the effect, whose module documentation is its page.
    fn source() -> &'static str;
}

impl<C: CentroidShift> Displacement for C {
    const ID: &'static str = C::ID;
    const SEGMENT: Segment = Segment::Focal;
    const FACTS: Facts = C::FACTS;
    const WITHIN_PIXELS: bool = C::WITHIN_PIXELS;
    const PARAMETERS: &'static [ParameterSpec] = {
        assert!(C::PARAMETERS.len() <= MAX_SHIFTS);
        C::PARAMETERS
    };

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let found = context.image.signatures.of(<C as CentroidShift>::ID);
        let mut point_px = light.point_px;
        for (index, parameter) in parameters.iter().enumerate() {
            let shift = match found {
                Some(signature) => signature.shift_px[index].map(T::constant),
                None => C::unit_shift(index, &light, context),
            };
            for axis in 0..2 {
                point_px[axis] = point_px[axis] - *parameter * shift[axis];
            }
        }
        Light { point_px, ..light }
    }

    fn unmet_requirement(observation: &Observation) -> Option<&'static str> {
        C::missing(observation)
    }

    fn unmet_in_context(context: &Context) -> Option<&'static str> {
        let is_measured = context.image.signatures.of(<C as CentroidShift>::ID).is_some();
        if is_measured { None } else { C::missing(&context.observation).or_else(|| C::missing_in(context)) }
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0; <C as CentroidShift>::PARAMETERS.len()])
    }

    fn predicted(_: &Observation) -> Option<Vec<f64>> {
        None
    }

    fn rendering(parameter: usize) -> Option<Rendering> {
        C::rendering(parameter)
    }

    fn reference_values() -> Vec<ReferenceValue> {
        C::reference_values()
    }

    fn source() -> &'static str {
        C::source()
    }
}

/// The shift of a centre along one axis, per unit of the ripple ε of the gain, where the pixels with an even number count 1 + ε and those
/// with an odd one 1 − ε: −A₂·sin πx for the centre of mass, A₂ = 4·e^(−π²σ²/2)·(σ² + 1/π²), by Poisson's sum of a Gaussian of σ = 0.7 px
/// that is integrated over the pixels.
pub(in crate::effects) fn ripple_shift<T: Real>(pixel_px: T) -> T {
    const SIGMA_PX: f64 = 0.7;
    const PI: f64 = std::f64::consts::PI;
    let amplitude = 4.0 * (-PI * PI * SIGMA_PX * SIGMA_PX / 2.0).exp() * (SIGMA_PX * SIGMA_PX + 1.0 / (PI * PI));
    -(pixel_px * PI).sin() * amplitude
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{Signature, StarImage, StarState, displacement};

    #[test]
    fn a_shift_found_by_rendering_takes_the_place_of_the_formula() {
        let effect = displacement("s-curve").unwrap();
        let mut image = StarImage::default();
        let plain = Context::new(StarState::default(), Observation::of_sensor(100, 100));
        let light = Light { direction: [0.0, 0.0, 1.0], point_px: [0.25, 3.0], pixel_px: [50.25, 53.0], focal_length_px: 900.0 };
        let by_formula = effect.displace(&[0.02, 0.0], light, &plain).point_px;
        assert!((by_formula[0] - 0.23).abs() < 1e-12 && (by_formula[1] - 3.0).abs() < 1e-12, "{by_formula:?}");
        assert!(image.signatures.set(Signature { effect: "s-curve", shift_px: [[0.5, 0.1], [0.0, -0.3]] }));
        let found = effect.displace(&[0.02, 0.1], light, &plain.with_image(image)).point_px;
        assert!((found[0] - 0.24).abs() < 1e-12 && (found[1] - 3.028).abs() < 1e-12, "{found:?}");
    }
}

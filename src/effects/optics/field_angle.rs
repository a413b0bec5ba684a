//! Functions of the angle from the boresight that wide-angle projections share, written so that values and derivatives stay finite at
//! the centre, where the square root of x² + y² has none.

use crate::dual::Real;

/// Below this square of an angle (or of its sine) series are used; what they leave out is below 1e-16.
const SMALL_SQUARE: f64 = 1e-4;

/// θ / sin θ of a unit vector in camera axes, θ = its angle from z. Infinite straight behind the camera.
pub(super) fn angle_over_sine<T: Real>([x, y, z]: [T; 3]) -> T {
    let square = x * x + y * y;
    if square.value() < SMALL_SQUARE && z.value() > 0.0 {
        // arcsin(s) / s
        return ((square * (5.0 / 112.0) + 3.0 / 40.0) * square + 1.0 / 6.0) * square + 1.0;
    }
    let sine = square.sqrt();
    sine.atan2(z) / sine
}

/// sin θ / θ and cos θ, from θ².
pub(super) fn sine_over_angle_and_cosine<T: Real>(square: T) -> [T; 2] {
    if square.value() < SMALL_SQUARE {
        let sine = ((square * (-1.0 / 5040.0) + 1.0 / 120.0) * square - 1.0 / 6.0) * square + 1.0;
        let cosine = (((square * (1.0 / 40_320.0) - 1.0 / 720.0) * square + 1.0 / 24.0) * square - 0.5) * square + 1.0;
        return [sine, cosine];
    }
    let angle = square.sqrt();
    [angle.sin() / angle, angle.cos()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dual::Jet;

    #[test]
    fn series_and_closed_forms_meet() {
        for angle in [0.999e-2_f64, 1.001e-2] {
            let [sine, cosine] = sine_over_angle_and_cosine(angle * angle);
            assert!((sine - angle.sin() / angle).abs() < 3e-16 && (cosine - angle.cos()).abs() < 3e-16);
            let ratio = angle_over_sine([angle.sin() * 0.6, angle.sin() * 0.8, angle.cos()]);
            assert!((ratio - angle / angle.sin()).abs() < 5e-16, "{ratio}");
        }
    }

    #[test]
    fn the_centre_has_derivatives() {
        let [sine, cosine] = sine_over_angle_and_cosine(Jet::variable(0.0, 0));
        assert_eq!([sine.value, sine.partials[0], cosine.value, cosine.partials[0]], [1.0, -1.0 / 6.0, 1.0, -0.5]);
        let centre = angle_over_sine([Jet::variable(0.0, 0), Jet::variable(0.0, 1), Jet::constant(1.0)]);
        assert_eq!([centre.value, centre.partials[0], centre.partials[1]], [1.0, 0.0, 0.0]);
    }
}

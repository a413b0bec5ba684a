//! Prior attitude: where the camera is held to point, with its uncertainty.

use nalgebra::{Matrix3, Vector3};

use super::refusal::Refusal;
use crate::coordinates::{Apparent, Attitude, Direction};

/// Where to search: the boresight within an angle of a direction and, if `up` is known, the upward direction of the image (−y) too.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AttitudePrior {
    /// Where the boresight points, ICRS axes.
    pub boresight: Direction<Apparent>,
    /// The upward direction of the image, ICRS axes, at right angles to it; `None`: any roll.
    pub up: Option<Direction<Apparent>>,
    /// Neither is further away than this, rad.
    pub within_rad: f64,
}

impl AttitudePrior {
    /// Near a pointing; `roll_rad` is the position angle of the image's upward direction, from north through east.
    #[must_use]
    pub fn pointing(ra_rad: f64, dec_rad: f64, roll_rad: Option<f64>, within_rad: f64) -> Self {
        let near = Self::attitude(&Attitude::from_pointing(ra_rad, dec_rad, roll_rad.unwrap_or(0.0)), within_rad);
        Self { up: near.up.filter(|_| roll_rad.is_some()), ..near }
    }

    /// Near an attitude, that of the frame before for example.
    #[must_use]
    pub fn attitude(attitude: &Attitude, within_rad: f64) -> Self {
        let of = |camera: [f64; 3]| attitude.apparent_from_camera(&Direction::from_unit(camera));
        Self { boresight: of([0.0, 0.0, 1.0]), up: Some(of([0.0, -1.0, 0.0])), within_rad }
    }

    /// What is wrong with it.
    pub(super) fn fault(&self) -> Option<Refusal> {
        let is_angle = self.within_rad > 0.0 && self.within_rad <= std::f64::consts::PI;
        if !is_angle {
            return Some(Refusal::PriorAngle { within_rad: self.within_rad });
        }
        let of_length_1 = |direction: &Direction<Apparent>| (Vector3::from(direction.xyz).norm() - 1.0).abs() < 1e-6;
        let wrong = [Some(self.boresight), self.up].into_iter().flatten().find(|direction| !of_length_1(direction));
        wrong.map(|direction| Refusal::PriorDirection { direction: direction.xyz })
    }

    /// Whether a rotation, `camera_from_icrs`, is within the angle and `more_rad`.
    pub(super) fn allows(&self, rotation: &Matrix3<f64>, more_rad: f64) -> bool {
        let least = (self.within_rad + more_rad).min(std::f64::consts::PI).cos();
        let along = |row: usize, direction: &Direction<Apparent>| rotation.row(row).transpose().dot(&Vector3::from(direction.xyz));
        along(2, &self.boresight) >= least && self.up.is_none_or(|up| -along(1, &up) >= least)
    }

    /// The cosine of the angle from the boresight beyond which no star is seen by a camera that sees as far as `reach_rad` around its own.
    pub(super) fn cos_reach(&self, reach_rad: f64) -> f64 {
        (self.within_rad + reach_rad).min(std::f64::consts::PI).cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::DEG_RAD;

    #[test]
    fn attitudes_within_the_angle_are_allowed_and_others_are_not() {
        let rotation = |ra: f64, dec: f64, roll: f64| {
            let attitude = Attitude::from_pointing(ra * DEG_RAD, dec * DEG_RAD, roll * DEG_RAD);
            *attitude.camera_from_icrs.to_rotation_matrix().matrix()
        };
        let any_roll = AttitudePrior::pointing(80.0 * DEG_RAD, -30.0 * DEG_RAD, None, 5.0 * DEG_RAD);
        let with_roll = AttitudePrior::pointing(80.0 * DEG_RAD, -30.0 * DEG_RAD, Some(120.0 * DEG_RAD), 5.0 * DEG_RAD);
        for (ra, dec, roll, any, with) in [
            (80.0, -30.0, 120.0, true, true),
            (80.0, -34.9, 120.0, true, true),
            (80.0, -35.1, 120.0, false, false),
            (80.0, -30.0, 124.9, true, true),
            (80.0, -30.0, 125.1, true, false),
            (80.0, -30.0, 300.0, true, false),
            (260.0, 30.0, 120.0, false, false),
        ] {
            let rotation = rotation(ra, dec, roll);
            assert_eq!((any_roll.allows(&rotation, 0.0), with_roll.allows(&rotation, 0.0)), (any, with), "{ra} {dec} {roll}");
        }
        assert!(any_roll.allows(&rotation(80.0, -35.1, 0.0), 0.01));
        assert!(any_roll.fault().is_none() && AttitudePrior { within_rad: 0.0, ..any_roll }.fault().is_some());
        let none = AttitudePrior { up: Some(Direction::from_unit([f64::NAN, 0.0, 1.0])), ..any_roll };
        assert!(none.fault().is_some_and(|fault| matches!(fault, Refusal::PriorDirection { .. })) && with_roll.fault().is_none());
        assert!(
            AttitudePrior { within_rad: f64::NAN, ..any_roll }.fault().is_some()
                && AttitudePrior { within_rad: 4.0, ..any_roll }.fault().is_some()
        );
    }
}

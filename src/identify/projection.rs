//! Projections: the law by which the angle from the boresight becomes a distance from the principal point.

use crate::effects::ids;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A lens's law, as identification tries them: the tangent plane, and those of fisheyes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Projection {
    /// r = f·tan θ.
    #[default]
    Pinhole,
    /// r = f·θ.
    Equidistant,
    /// r = 2·f·sin(θ/2).
    Equisolid,
    /// r = 2·f·tan(θ/2).
    Stereographic,
}

/// Directions nearer to the plane through the camera than this, z, are no image of a tangent plane.
const MIN_DEPTH: f64 = 0.05;
/// Fisheyes see no further than this, z: 10° behind the camera.
const MIN_DEPTH_OF_FISHEYE: f64 = -0.174;

impl Projection {
    /// Those of fisheyes, the most common first.
    pub(super) const FISHEYES: [Self; 3] = [Self::Equidistant, Self::Equisolid, Self::Stereographic];

    /// The id of the effect that it is, see [`crate::camera::Model::with_projection`].
    #[must_use]
    pub fn id(self) -> &'static str {
        match self {
            Self::Pinhole => ids::PINHOLE,
            Self::Equidistant => ids::EQUIDISTANT,
            Self::Equisolid => ids::EQUISOLID,
            Self::Stereographic => ids::STEREOGRAPHIC,
        }
    }

    /// The projection of this id, if identification knows it.
    #[must_use]
    pub fn of_id(id: &str) -> Option<Self> {
        [Self::Pinhole].into_iter().chain(Self::FISHEYES).find(|one| one.id() == id)
    }

    /// Whether a direction of this z, the cosine of its angle from the boresight, has an image.
    pub(super) fn sees(self, z: f64) -> bool {
        z > if self == Self::Pinhole { MIN_DEPTH } else { MIN_DEPTH_OF_FISHEYE }
    }

    /// s of the image f·s·(x, y) of the direction (x, y, z), and ds/dz.
    pub(super) fn scale(self, z: f64) -> [f64; 2] {
        match self {
            Self::Pinhole => [1.0 / z, -1.0 / (z * z)],
            Self::Equisolid => {
                let scale = (2.0 / (1.0 + z)).sqrt();
                [scale, -0.5 * scale / (1.0 + z)]
            }
            Self::Stereographic => [2.0 / (1.0 + z), -2.0 / ((1.0 + z) * (1.0 + z))],
            Self::Equidistant => {
                let sin2 = (1.0 - z * z).max(0.0);
                if sin2 < 1e-4 && z > 0.0 {
                    // θ/sin θ and its slope to the order of sin²θ.
                    return [1.0 + sin2 / 6.0, -(1.0 + 0.9 * sin2) / 3.0];
                }
                let (sin, theta) = (sin2.sqrt(), z.clamp(-1.0, 1.0).acos());
                [theta / sin, (theta * z / sin - 1.0) / sin2]
            }
        }
    }

    /// The unit vector of the ideal point (x, y), px; `None` beyond the image.
    pub(super) fn ray(self, [x, y]: [f64; 2], focal_px: f64) -> Option<Vector3<f64>> {
        if self == Self::Pinhole {
            let v = Vector3::new(x, y, focal_px);
            return Some(v * (1.0 / v.norm()));
        }
        let (x, y) = (x / focal_px, y / focal_px);
        let square = x * x + y * y;
        let [part, z] = match self {
            Self::Equidistant => {
                let theta = square.sqrt();
                [if theta < 1e-4 { 1.0 } else { theta.sin() / theta }, theta.min(std::f64::consts::PI).cos()]
            }
            Self::Equisolid => [(1.0 - square / 4.0).max(0.0).sqrt(), 1.0 - square / 2.0],
            Self::Pinhole | Self::Stereographic => [4.0 / (4.0 + square), (4.0 - square) / (4.0 + square)],
        };
        (z > -1.0).then(|| Vector3::new(x * part, y * part, z))
    }

    /// The distance from the principal point of what stands at this angle from the boresight, in units of f.
    pub(super) fn radius(self, theta_rad: f64) -> f64 {
        match self {
            Self::Pinhole => theta_rad.tan(),
            Self::Equidistant => theta_rad,
            Self::Equisolid => 2.0 * (theta_rad / 2.0).sin(),
            Self::Stereographic => 2.0 * (theta_rad / 2.0).tan(),
        }
    }

    /// The angle from the boresight of what appears at this distance, in units of f; that of the furthest beyond the image.
    pub(super) fn angle_rad(self, radius: f64) -> f64 {
        match self {
            Self::Pinhole => radius.atan(),
            Self::Equidistant => radius.min(std::f64::consts::PI),
            Self::Equisolid => 2.0 * (radius / 2.0).min(1.0).asin(),
            Self::Stereographic => 2.0 * (radius / 2.0).atan(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Camera, Model};
    use crate::coordinates::PixelPoint;

    const ALL: [Projection; 4] = [Projection::Pinhole, Projection::Equidistant, Projection::Equisolid, Projection::Stereographic];

    #[test]
    fn rays_are_those_of_the_camera_and_come_back() {
        for projection in ALL {
            assert_eq!(Projection::of_id(projection.id()), Some(projection));
            let camera = Camera { principal_point_px: [0.0; 2], ..Camera::pinhole(100, 100, 500.0) };
            let model = Model::new(camera).with_projection(projection.id(), &[]).unwrap();
            for theta_deg in [1e-3, 0.3, 0.7, 20.0, 60.0, 80.0, 95.0_f64] {
                let theta = theta_deg.to_radians();
                if projection == Projection::Pinhole && theta_deg > 85.0 {
                    continue;
                }
                let radius = projection.radius(theta);
                assert!((projection.angle_rad(radius) - theta).abs() < 1e-12);
                let at = [0.6 * radius, -0.8 * radius];
                let ray = projection.ray(at.map(|c| 500.0 * c), 500.0).unwrap();
                let point = PixelPoint { x_px: 500.0 * at[0], y_px: 500.0 * at[1] };
                let expected = model.direction(point, &model.reference_context()).unwrap();
                assert!((ray - Vector3::from(expected.xyz)).norm() < 1e-12, "{projection:?} {theta_deg}");
                let [scale, slope] = projection.scale(ray.z);
                assert!((scale * ray.x - at[0]).hypot(scale * ray.y - at[1]) < 1e-9 * radius.max(1.0), "{projection:?} {theta_deg}");
                let step = (1e-6 * (1.0 - ray.z)).max(1e-12);
                let by_difference = (projection.scale(ray.z + step)[0] - projection.scale(ray.z - step)[0]) / (2.0 * step);
                if theta_deg > 10.0 {
                    assert!((slope / by_difference - 1.0).abs() < 1e-4, "{projection:?} {theta_deg}: {slope} {by_difference}");
                }
            }
        }
    }
}

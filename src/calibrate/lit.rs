//! Illuminated part of the frame.
//!
//! A fisheye's image is a circle, often smaller than the frame; beyond it there is no light, no star and no map. Statements "over the frame" (the
//! map's uncertainty, its coverage by stars, the difference of two maps) are then over the circle. Its radius is estimated from the star images. A
//! lens that images the tangent plane lights the whole frame: a corner without stars is then unknown, and counts as such.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::geometry::frame_grid;
use crate::camera::Camera;
use crate::coordinates::PixelPoint;
use crate::effects::ids;
use crate::identify::ControlPoints;
use crate::statistics::order::descending;

/// So many star images stand as far out as the circle reaches, or farther: fewer may be wrong identifications.
const FARTHEST: usize = 3;
/// The circle reaches this much farther than these.
const MARGIN: f64 = 1.02;

/// A circle about the principal point, as far out as the star images of a fisheye reach.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LitCircle {
    /// Its middle.
    pub centre_px: [f64; 2],
    /// Its radius.
    pub radius_px: f64,
}

impl LitCircle {
    /// That of star images, seen through a lens of this law; `None` where the whole frame is lit.
    pub(super) fn of(points: &ControlPoints, projection: &str) -> Option<Self> {
        if projection == ids::PINHOLE {
            return None;
        }
        let centre_px = points.nominal.principal_point_px;
        let from_centre = |x_px: f64, y_px: f64| (x_px - centre_px[0]).hypot(y_px - centre_px[1]);
        let mut radii: Vec<f64> = points.points.iter().map(|point| from_centre(point.x_px, point.y_px)).collect();
        descending(&mut radii, |a| *a);
        let radius_px = MARGIN * radii.get(FARTHEST - 1)?;
        let (right, bottom) = (points.nominal.width_px as f64 - 1.0, points.nominal.height_px as f64 - 1.0);
        let corners = [(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)];
        let is_smaller = corners.into_iter().any(|(x_px, y_px)| from_centre(x_px, y_px) > radius_px);
        is_smaller.then_some(Self { centre_px, radius_px })
    }

    /// Whether a pixel lies in it.
    #[must_use]
    pub fn contains(&self, pixel: PixelPoint) -> bool {
        (pixel.x_px - self.centre_px[0]).hypot(pixel.y_px - self.centre_px[1]) <= self.radius_px
    }

    /// The part of the frame that it is, in words.
    #[must_use]
    pub fn in_words(&self) -> String {
        let Self { centre_px: [x, y], radius_px } = self;
        format!("the lit part of the frame (within {radius_px:.0} px of ({x:.0}, {y:.0}), as far out as star images reach)")
    }
}

/// The lit pixels of a grid over the frame, row by row.
pub(super) fn lit_grid(camera: &Camera, lit: Option<&LitCircle>, side: usize) -> Vec<PixelPoint> {
    let mut grid = frame_grid(camera, side);
    grid.retain(|pixel| lit.is_none_or(|lit| lit.contains(*pixel)));
    grid
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coordinates::Direction;
    use crate::effects::{StarImage, StarState};
    use crate::identify::ControlPoint;

    fn points(places: &[[f64; 2]]) -> ControlPoints {
        let point = |[x_px, y_px]: &[f64; 2]| ControlPoint {
            frame: 0,
            hip: 1,
            direction: Direction::along([0.0, 0.0, 1.0]),
            x_px: *x_px,
            y_px: *y_px,
            covariance_px2: [0.01, 0.0, 0.01],
            catalog_sigma_rad: 0.0,
            has_proper_motion: true,
            magnitude: 5.0,
            colour: None,
            star: StarState::default(),
            image: StarImage::default(),
        };
        ControlPoints::new(Camera::pinhole(1000, 800, 300.0), Vec::new(), places.iter().map(point).collect())
    }

    #[test]
    fn the_circle_reaches_as_far_as_three_star_images_do() {
        let circle = points(&[[499.5, 399.5], [499.5, 699.5], [199.5, 399.5], [799.5, 399.5], [999.0, 799.0]]);
        let lit = LitCircle::of(&circle, "equidistant").unwrap();
        assert!((lit.radius_px - 306.0).abs() < 1e-9, "{lit:?}");
        assert!(lit.contains(PixelPoint { x_px: 499.5, y_px: 100.0 }) && !lit.contains(PixelPoint { x_px: 0.0, y_px: 0.0 }));
        assert_eq!(LitCircle::of(&circle, "pinhole"), None, "a corner without stars counts there");
        assert_eq!(LitCircle::of(&points(&[[0.0, 0.0], [999.0, 799.0], [0.0, 799.0]]), "equisolid"), None, "the whole frame");
        assert_eq!(LitCircle::of(&points(&[[1.0, 1.0]]), "equisolid"), None, "nothing is known");
    }
}

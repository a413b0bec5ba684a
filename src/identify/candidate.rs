//! Candidate pose: a triangle of detections matched to one of the catalogue, and its verification by the stars around it.

use nalgebra::{Matrix3, Vector3};

use super::index_scale::{IndexScale, LANES, Neighbours, Shape};
use super::point_map::PointMap;
use super::pose::Pose;
use super::projection::Projection;

/// A candidate is given up at this ln of the likelihood over that of chance, and passed on at the other.
const GIVE_UP: f64 = -2.6;
const PASS_ON: f64 = 6.0;
/// Passed on too if all neighbours are asked and it stands here.
const PASS_AT_LAST: f64 = 3.0;

/// How much longer the focal length is that tells how a side depends on it, as a part of it.
pub(super) const LONGER: f64 = 0.01;

/// A stage at one focal length.
pub(super) struct Context<'a> {
    /// Relative displacement at the corner that was taken away.
    pub(super) kappa: f64,
    /// Tolerance of the ratios of the sides.
    pub(super) ratio_tolerance: f64,
    /// How many of the brightest detections speak about a candidate.
    pub(super) judges: usize,
    pub(super) level: &'a IndexScale,
    /// Undistorted points: at least of the detections that form triangles.
    pub(super) ideal: &'a [[f64; 2]],
    pub(super) map: &'a PointMap,
    pub(super) half_px: [f64; 2],
    pub(super) corner_px: f64,
    /// No star is asked for further from the middle than this.
    pub(super) reach_px: f64,
    pub(super) projection: Projection,
    pub(super) focal_px: f64,
    pub(super) half_step: f64,
    /// The angle from the middle to the corner, rad: at the shortest focal length of the step and with distortion.
    pub(super) corner_rad: f64,
}

impl Context<'_> {
    /// The shape of a triangle, if the scale has such.
    pub(super) fn usable(&self, sides: [f64; 3]) -> Option<Shape> {
        let [least, most] = self.level.longest_range();
        Shape::new(sides).filter(|shape| shape.longest >= least && shape.longest <= most)
    }
}

/// A triangle of detections at a focal length.
pub(super) struct Trial {
    /// The triangle's detections, opposite the longest, middle, shortest side.
    corners: [usize; 3],
    /// The chord of its longest side at the context's focal length.
    longest: f64,
    /// d ln longest / d ln f, about −1.
    sensitivity: f64,
    /// Which corner is the nearest to the middle: most of its neighbours are in the frame.
    pub(super) central: usize,
}

impl Trial {
    /// From detections opposite the longest, middle and shortest side; `rays` and `rays_at_longer` are the directions of the
    /// detections at the focal length of the context and at one longer by [`LONGER`].
    pub(super) fn new(context: &Context<'_>, shape: &Shape, corners: [usize; 3], rays_at_longer: &[Vector3<f64>]) -> Self {
        let longer = (rays_at_longer[corners[1]] - rays_at_longer[corners[2]]).norm();
        let from_middle2 = corners.map(|corner| context.ideal[corner].iter().map(|c| c * c).sum::<f64>());
        let central = (1..3).fold(0, |best, side| if from_middle2[side] < from_middle2[best] { side } else { best });
        Self { corners, longest: shape.longest, sensitivity: ln_near_1(longer / shape.longest) / LONGER, central }
    }

    /// Half the width of the window in ln(longest): the step of the focal length, and noise of a pixel or two.
    pub(super) fn log_tolerance(&self, context: &Context<'_>) -> f64 {
        context.half_step * self.sensitivity.abs() + 0.004
    }

    /// The attitude, focal length and parity that lay the detections over the catalogue triangle.
    pub(super) fn pose(&self, context: &Context<'_>, triangle: [u32; 3]) -> Option<Pose> {
        let [a, b, c] = triangle;
        let sky = [context.level.direction(a), context.level.direction(b), context.level.direction(c)];
        let longest = (sky[1] - sky[2]).norm();
        // The focal length at which the longest side has the catalogue's length.
        let log = ln_near_1(longest / self.longest) / self.sensitivity;
        let focal_px = context.focal_px * (1.0 + log * (1.0 + log * (0.5 + log / 6.0)));
        if !(focal_px.is_finite() && focal_px > 0.0) {
            return None;
        }
        let ray = |side: usize| context.projection.ray(context.ideal[self.corners[side]], focal_px);
        let image = [ray(0)?, ray(1)?, ray(2)?];
        let (mut in_image, on_sky) = (axes(&image), axes(&sky));
        // Seen from the middle of the longest side the first corner lies across it, on one side or the other.
        let hand = |axes: &Matrix3<f64>, corners: &[Vector3<f64>; 3]| axes.column(2).dot(&(corners[0] - corners[1]));
        let parity = if hand(&in_image, &image) * hand(&on_sky, &sky) < 0.0 { -1.0 } else { 1.0 };
        if parity < 0.0 {
            // The axes of the mirrored triangle: x is mirrored, and the vector product has the other sign.
            for (row, column) in [(0, 0), (0, 1), (1, 2), (2, 2)] {
                in_image[(row, column)] = -in_image[(row, column)];
            }
        }
        let rotation = in_image * on_sky.transpose();
        Some(Pose { rotation, focal_px, kappa: context.kappa, parity, projection: context.projection, principal_px: [0.0; 2] })
    }

    /// Whether the brightest catalogue stars around the triangle are found in the image, more of them than by chance: a sequential
    /// test, which for most candidates ends after four stars (Wald, Annals of Mathematical Statistics 16, 117, 1945).
    pub(super) fn checks_out(&self, context: &Context<'_>, triangle: [u32; 3], pose: &Pose) -> bool {
        let (x, y, asked) = self.places(context, context.level.neighbours(triangle[self.central]), pose);
        let mut support = 0.0;
        for lane in 0..LANES {
            if !asked[lane] {
                continue;
            }
            support += if context.map.has_point_near(x[lane], y[lane]) { context.map.gain } else { context.map.loss };
            if support < GIVE_UP {
                return false;
            }
            if support > PASS_ON {
                return true;
            }
        }
        support > PASS_AT_LAST
    }

    /// Where the neighbours would be in the image, px, and which of them can speak: those on the frame, but for the triangle's own
    /// stars, which are among them and always found. All at once, by operations that compilers do on many numbers together.
    fn places(
        &self,
        context: &Context<'_>,
        Neighbours([x, y, z]): &Neighbours,
        pose: &Pose,
    ) -> ([f32; LANES], [f32; LANES], [bool; LANES]) {
        let scale = [pose.focal_px * pose.parity, pose.focal_px, 1.0];
        let row = |axis: usize| std::array::from_fn::<f32, 3, _>(|column| (scale[axis] * pose.rotation[(axis, column)]) as f32);
        let (to_x, to_y, to_z) = (row(0), row(1), row(2));
        let [half_x, half_y] = context.half_px.map(|half| half as f32);
        let shrink = (pose.kappa / (context.corner_px * context.corner_px)) as f32;
        let least = 1.0 - pose.kappa as f32;
        let own = self.corners.map(|corner| context.ideal[corner].map(|c| c as f32));
        let reach = context.map.radius_px as f32;
        let along = |row: [f32; 3], lane: usize| row[0] * x[lane] + row[1] * y[lane] + row[2] * z[lane];
        let depths: [f32; LANES] = std::array::from_fn(|lane| along(to_z, lane));
        // From a direction to its image, and whether it has one; zeros are no star.
        let (mut scales, mut seen) = (depths.map(|depth| 1.0 / depth), depths.map(|depth| depth > 0.05));
        if context.projection != Projection::Pinhole {
            for lane in 0..LANES {
                let depth = f64::from(depths[lane]);
                seen[lane] = context.projection.sees(depth) && (x[lane] * x[lane] + y[lane] * y[lane] + z[lane] * z[lane] > 0.5);
                scales[lane] = context.projection.scale(depth.clamp(-0.9, 1.0))[0] as f32;
            }
        }
        let reach2 = (context.reach_px * context.reach_px) as f32;
        let (mut at_x, mut at_y, mut asked) = ([0.0; LANES], [0.0; LANES], [false; LANES]);
        for lane in 0..LANES {
            let (px, py) = (along(to_x, lane) * scales[lane], along(to_y, lane) * scales[lane]);
            (at_x[lane], at_y[lane]) = (px, py);
            // Where the measured point would be, roughly: beyond the corner the distortion stays as it is there.
            let radius2 = px * px + py * py;
            let inward = 1.0 - shrink * radius2;
            let inward = if shrink > 0.0 { inward.max(least) } else { inward.min(least) };
            let speaks = own.iter().fold(seen[lane], |is, [ox, oy]| is & ((ox - px).abs().max((oy - py).abs()) >= reach));
            let within_reach = radius2 <= reach2 * inward * inward;
            asked[lane] = speaks & within_reach & (px.abs() <= half_x * inward) & (py.abs() <= half_y * inward);
        }
        (at_x, at_y, asked)
    }
}

/// ln, to 1e-6 for what a step of the focal length brings: the library's takes as long as the rest of a candidate.
fn ln_near_1(ratio: f64) -> f64 {
    let t = (ratio - 1.0) / (ratio + 1.0);
    2.0 * t * (1.0 + t * t * (1.0 / 3.0 + t * t / 5.0))
}

/// The vector of length 1: one division, where the library's takes three.
fn unit(v: Vector3<f64>) -> Vector3<f64> {
    v * (1.0 / v.norm())
}

/// Axes that belong to three directions: towards their mean, along the longest side, and across.
fn axes([a, b, c]: &[Vector3<f64>; 3]) -> Matrix3<f64> {
    let mean = unit(a + b + c);
    let along = unit((c - b) - mean * mean.dot(&(c - b)));
    Matrix3::from_columns(&[mean, along, mean.cross(&along)])
}

/// Takes the distortion of a hypothesis away.
pub(super) fn undistort([x, y]: [f64; 2], kappa: f64, corner_px: f64) -> [f64; 2] {
    let scale = 1.0 - kappa * (x * x + y * y) / (corner_px * corner_px);
    [x * scale, y * scale]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::pose::Points;
    use crate::units::DEG_RAD;

    #[test]
    fn the_short_logarithm_is_right_over_a_step_of_the_focal_length() {
        for i in -100..=100 {
            let ratio = 1.0 + 0.001 * f64::from(i);
            assert!((ln_near_1(ratio) - ratio.ln()).abs() < 1e-6, "{ratio}");
        }
    }

    /// A camera in the middle of 12° × 12° of stars on a lattice that is a little uneven.
    fn stars() -> Vec<Vector3<f64>> {
        let at = |i: u32| {
            let jitter = |k: f64| (f64::from(i) * k).fract() - 0.5;
            let (x, y) = (f64::from(i % 6) - 2.5 + 0.6 * jitter(0.618_034), f64::from(i / 6) - 2.5 + 0.6 * jitter(0.754_877));
            Vector3::new((2.0 * x * DEG_RAD).tan(), (2.0 * y * DEG_RAD).tan(), 1.0).normalize()
        };
        (0..36).map(at).collect()
    }

    #[test]
    fn a_right_candidate_checks_out_and_the_same_triangle_on_other_stars_does_not() {
        let level = IndexScale::build(&stars(), 8.0 * DEG_RAD);
        let focal_px = 3889.0;
        for parity in [1.0, -1.0] {
            let see = |v: &Vector3<f64>| [parity * focal_px * v.x / v.z, focal_px * v.y / v.z];
            let ideal: Vec<[f64; 2]> = stars().iter().map(see).collect();
            let points = Points {
                detection: (0..ideal.len()).collect(),
                centred_px: ideal.clone(),
                half_px: [512.0; 2],
                size_px: 1024.0,
                corner_px: 724.0,
                reach_px: 724.0,
            };
            let check = |ideal: &[[f64; 2]], corners: [usize; 3], stars: [u32; 3]| {
                let map = PointMap::new(ideal, &points);
                let context = Context {
                    kappa: 0.0,
                    ratio_tolerance: 0.003,
                    judges: ideal.len(),
                    level: &level,
                    ideal,
                    map: &map,
                    half_px: points.half_px,
                    corner_px: points.corner_px,
                    reach_px: points.reach_px,
                    projection: Projection::Pinhole,
                    focal_px: 1.02 * focal_px,
                    half_step: 0.03,
                    corner_rad: 0.19,
                };
                let rays = |focal_px: f64| ideal.iter().map(|at| Projection::Pinhole.ray(*at, focal_px).unwrap()).collect::<Vec<_>>();
                let near = rays(context.focal_px);
                let side = |a: usize, b: usize| (near[corners[a]] - near[corners[b]]).norm();
                let shape = Shape { longest: side(1, 2), middle: 0.0, shortest: 0.0, order: [0, 1, 2] };
                let trial = Trial::new(&context, &shape, corners, &rays(context.focal_px * (1.0 + LONGER)));
                let pose = trial.pose(&context, stars).unwrap();
                (trial.checks_out(&context, stars, &pose), pose)
            };
            let triangle = [14_u32, 8, 27];
            let (checks_out, pose) = check(&ideal, triangle.map(|star| star as usize), triangle);
            assert!(checks_out);
            assert!((pose.focal_px / focal_px - 1.0).abs() < 1e-3 && pose.parity == parity, "{pose:?}");
            // The detections of three other stars are no such triangle, and the sky does not follow it.
            assert!(!check(&ideal, [14, 8, 27], [21, 7, 22]).0);
            // The triangle alone does not speak for itself.
            let alone: Vec<[f64; 2]> = triangle.iter().map(|star| ideal[*star as usize]).collect();
            assert!(!check(&alone, [0, 1, 2], triangle).0);
        }
    }
}

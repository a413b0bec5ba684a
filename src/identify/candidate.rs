//! Candidate pose: a triangle of detections matched to one of the catalogue, and its verification by the stars around it.

use nalgebra::{Matrix3, Vector3};

use super::index_scale::{IndexScale, LANES, Neighbours, Shape};
use super::point_map::PointMap;
use super::pose::{Points, Pose};
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
    /// Whether a candidate is weighed once before anything is fitted.
    pub(super) looks_first: bool,
    pub(super) level: &'a IndexScale,
    /// Undistorted points: at least of the detections that form triangles.
    pub(super) ideal: &'a [[f64; 2]],
    pub(super) map: &'a PointMap,
    pub(super) limits: Limits,
    pub(super) projection: Projection,
    pub(super) focal_px: f64,
    pub(super) half_step: f64,
    /// The angle from the middle to the corner, rad, where an attitude is held to be.
    pub(super) corner_rad: f64,
}

impl Context<'_> {
    /// The shape of a triangle, if the scale has such.
    pub(super) fn usable(&self, sides: [f64; 3]) -> Option<Shape> {
        let [least, most] = self.level.longest_range();
        Shape::new(sides).filter(|shape| shape.longest >= least && shape.longest <= most)
    }
}

/// Where on a frame stars are asked for, to single precision.
#[derive(Clone, Copy)]
pub(super) struct Limits {
    half_px: [f32; 2],
    /// No star is asked for further from the middle than this.
    reach2_px2: f32,
    /// κ over the square of the corner's radius, px⁻², and the least and most of 1 − κ·r²: beyond the corner the distortion stays as it is there.
    shrink: f32,
    inward: [f32; 2],
    /// Stars as near as this to a point of the triangle do not speak.
    own_px: f32,
}

impl Limits {
    pub(super) fn new(points: &Points, kappa: f64, map: &PointMap) -> Self {
        let least = 1.0 - kappa as f32;
        Self {
            half_px: [points.half_px[0] as f32, points.half_px[1] as f32],
            reach2_px2: (points.reach_px * points.reach_px) as f32,
            shrink: (kappa / (points.corner_px * points.corner_px)) as f32,
            inward: if kappa > 0.0 { [least, f32::INFINITY] } else { [f32::NEG_INFINITY, least] },
            own_px: map.radius_px as f32,
        }
    }

    /// Whether a star at this place can speak about a triangle of these points.
    #[inline(always)]
    #[allow(
        clippy::inline_always,
        clippy::needless_bitwise_bool,
        reason = "inlined into a loop over many stars, and without branches there"
    )]
    fn allow(&self, own_px: &[[f32; 2]; 3], x: f32, y: f32) -> bool {
        // Where the measured point would be, roughly.
        let radius2 = x * x + y * y;
        let inward = 1.0 - self.shrink * radius2;
        let inward = if inward < self.inward[0] { self.inward[0] } else { inward };
        let inward = if inward > self.inward[1] { self.inward[1] } else { inward };
        let apart = |[own_x, own_y]: [f32; 2]| ((own_x - x).abs() >= self.own_px) | ((own_y - y).abs() >= self.own_px);
        apart(own_px[0])
            & apart(own_px[1])
            & apart(own_px[2])
            & (radius2 <= self.reach2_px2 * inward * inward)
            & (x.abs() <= self.half_px[0] * inward)
            & (y.abs() <= self.half_px[1] * inward)
    }
}

/// A triangle of detections at a focal length.
pub(super) struct Trial {
    /// The number of the focal length among those that are tried together.
    pub(super) step: usize,
    /// The triangle's detections, opposite the longest, middle, shortest side.
    corners: [usize; 3],
    /// The same undistorted, px.
    pub(super) own_px: [[f32; 2]; 3],
    /// The chord of its longest side at the context's focal length.
    pub(super) longest: f64,
    /// d ln longest / d ln f, about −1.
    pub(super) sensitivity: f64,
    /// Which corner is the nearest to the middle: most of its neighbours are in the frame.
    pub(super) central: usize,
}

impl Trial {
    /// From detections opposite the longest, middle and shortest side; `rays` are the directions of the detections at
    /// the focal length of the context and at one longer by [`LONGER`].
    pub(super) fn new(context: &Context<'_>, step: usize, shape: &Shape, corners: [usize; 3], rays: &[[Vector3<f64>; 2]]) -> Self {
        let longer = (rays[corners[1]][1] - rays[corners[2]][1]).norm();
        let from_middle2 =
            |corner: usize| context.ideal[corner][0] * context.ideal[corner][0] + context.ideal[corner][1] * context.ideal[corner][1];
        let from_middle2 = [from_middle2(corners[0]), from_middle2(corners[1]), from_middle2(corners[2])];
        let central = (1..3).fold(0, |best, side| if from_middle2[side] < from_middle2[best] { side } else { best });
        let own = |side: usize| [context.ideal[corners[side]][0] as f32, context.ideal[corners[side]][1] as f32];
        Self {
            step,
            corners,
            own_px: [own(0), own(1), own(2)],
            longest: shape.longest,
            sensitivity: ln_near_1(longer / shape.longest) / LONGER,
            central,
        }
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
        let ([mut mean, mut along, mut across], on_sky) = (axes(&image), axes(&sky));
        // Seen from the middle of the longest side the first corner lies across it, on one side or the other.
        let hand = |across: &Vector3<f64>, corners: &[Vector3<f64>; 3]| across.dot(&(corners[0] - corners[1]));
        let parity = if hand(&across, &image) * hand(&on_sky[2], &sky) < 0.0 { -1.0 } else { 1.0 };
        if parity < 0.0 {
            // The axes of the mirrored triangle: x is mirrored, and the vector product has the other sign.
            (mean.x, along.x, across.y, across.z) = (-mean.x, -along.x, -across.y, -across.z);
        }
        let of =
            |row: usize, column: usize| mean[row] * on_sky[0][column] + along[row] * on_sky[1][column] + across[row] * on_sky[2][column];
        let row = |row: usize| [of(row, 0), of(row, 1), of(row, 2)];
        let ([xx, xy, xz], [yx, yy, yz], [zx, zy, zz]) = (row(0), row(1), row(2));
        let rotation = Matrix3::new(xx, xy, xz, yx, yy, yz, zx, zy, zz);
        Some(Pose { rotation, focal_px, kappa: context.kappa, parity, projection: context.projection, principal_px: [0.0; 2] })
    }

    /// Whether the brightest catalogue stars around the triangle are found in the image, more of them than by chance: a sequential
    /// test, which for most candidates ends after four stars (Wald, Annals of Mathematical Statistics 16, 117, 1945).
    pub(super) fn checks_out(&self, context: &Context<'_>, triangle: [u32; 3], pose: &Pose) -> bool {
        View::new(pose).checks_out(context, self, triangle)
    }
}

/// Neighbours that are asked together.
const HALF: usize = LANES / 2;

/// A candidate's view of the sky, to single precision: from a direction to x·z and y·z, px, and to z.
pub(super) struct View(pub(super) [[f32; 3]; 3]);

impl View {
    fn new(pose: &Pose) -> Self {
        let row = |axis: usize, scale: f64| {
            let along = |column: usize| (scale * pose.rotation[(axis, column)]) as f32;
            [along(0), along(1), along(2)]
        };
        Self([row(0, pose.focal_px * pose.parity), row(1, pose.focal_px), row(2, 1.0)])
    }

    /// What [`Trial::checks_out`] says.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "inlined into what is compiled for several processors")]
    pub(super) fn checks_out(&self, context: &Context<'_>, trial: &Trial, triangle: [u32; 3]) -> bool {
        let neighbours = context.level.neighbours(triangle[trial.central]);
        let (map, mut support) = (context.map, 0.0);
        // Mostly the first half of the neighbours decides.
        for half in 0..LANES / HALF {
            let (x, y, asked) = self.places(context, trial, neighbours, half);
            for lane in 0..HALF {
                if asked[lane] == 0 {
                    continue;
                }
                support += if map.has_point_near(x[lane], y[lane]) { map.gain } else { map.loss };
                if support < GIVE_UP {
                    return false;
                }
                if support > PASS_ON {
                    return true;
                }
            }
        }
        support > PASS_AT_LAST
    }

    /// Where one half of the neighbours would be in the image, px, and which of them can speak: those on the frame, but for the triangle's own
    /// stars, which are among them and always found. All at once, by operations that compilers do on many numbers together.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "inlined into what is compiled for several processors")]
    fn places(
        &self,
        context: &Context<'_>,
        trial: &Trial,
        neighbours: &Neighbours,
        half: usize,
    ) -> ([f32; HALF], [f32; HALF], [u32; HALF]) {
        let Neighbours([x, y, z]) = neighbours;
        let [x, y, z] = [&x.as_chunks::<HALF>().0[half], &y.as_chunks::<HALF>().0[half], &z.as_chunks::<HALF>().0[half]];
        let Self([to_x, to_y, to_z]) = *self;
        let along = |row: [f32; 3], lane: usize| row[0] * x[lane] + row[1] * y[lane] + row[2] * z[lane];
        let (mut at_x, mut at_y, mut asked) = ([0.0; HALF], [0.0; HALF], [0; HALF]);
        // Zeros are no star.
        if context.projection == Projection::Pinhole {
            for lane in 0..HALF {
                let depth = along(to_z, lane);
                let scale = 1.0 / depth;
                (at_x[lane], at_y[lane]) = (along(to_x, lane) * scale, along(to_y, lane) * scale);
                asked[lane] = u32::from((depth > 0.05) & context.limits.allow(&trial.own_px, at_x[lane], at_y[lane]));
            }
        } else {
            for lane in 0..HALF {
                let depth = f64::from(along(to_z, lane));
                let is_seen = context.projection.sees(depth) && (x[lane] * x[lane] + y[lane] * y[lane] + z[lane] * z[lane] > 0.5);
                let scale = context.projection.scale(depth.clamp(-0.9, 1.0))[0] as f32;
                (at_x[lane], at_y[lane]) = (along(to_x, lane) * scale, along(to_y, lane) * scale);
                asked[lane] = u32::from(is_seen & context.limits.allow(&trial.own_px, at_x[lane], at_y[lane]));
            }
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
fn axes([a, b, c]: &[Vector3<f64>; 3]) -> [Vector3<f64>; 3] {
    let mean = unit(a + b + c);
    let along = unit((c - b) - mean * mean.dot(&(c - b)));
    [mean, along, mean.cross(&along)]
}

/// Takes the distortion of a hypothesis away.
pub(super) fn undistort([x, y]: [f64; 2], kappa: f64, corner_px: f64) -> [f64; 2] {
    let scale = 1.0 - kappa * (x * x + y * y) / (corner_px * corner_px);
    [x * scale, y * scale]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::candidate_block::check_out;
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
                    looks_first: false,
                    level: &level,
                    ideal,
                    map: &map,
                    limits: Limits::new(&points, 0.0, &map),
                    projection: Projection::Pinhole,
                    focal_px: 1.02 * focal_px,
                    half_step: 0.03,
                    corner_rad: 0.19,
                };
                let rays = |focal_px: f64| ideal.iter().map(|at| Projection::Pinhole.ray(*at, focal_px).unwrap()).collect::<Vec<_>>();
                let (near, longer) = (rays(context.focal_px), rays(context.focal_px * (1.0 + LONGER)));
                let both: Vec<_> = near.iter().zip(&longer).map(|(near, longer)| [*near, *longer]).collect();
                let side = |a: usize, b: usize| (near[corners[a]] - near[corners[b]]).norm();
                let shape = Shape { longest: side(1, 2), middle: 0.0, shortest: 0.0, order: [0, 1, 2] };
                let trial = Trial::new(&context, 0, &shape, corners, &both);
                let pose = trial.pose(&context, stars).unwrap();
                let checks_out = trial.checks_out(&context, stars, &pose);
                let block = [(&context, &trial, stars); 3];
                assert_eq!(check_out(&block), if checks_out { 0b111 } else { 0 });
                (checks_out, pose)
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

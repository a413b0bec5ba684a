//! Conversion between detections and the search's points, and from the search's answer to a [`Solution`].

use nalgebra::{Rotation3, UnitQuaternion, Vector3};

use super::association;
use super::fisheye;
use super::fit::{AT_REST_PX, MIN_FOR_KAPPA, fit};
use super::laid_sky::{LaidSky, NearDetections, unmirrored_x};
use super::pose::{Pair, Points, Pose};
use super::projection::Projection;
use super::refusal::Refusal;
use super::search::Found;
use super::search_plan::FramePoints;
use super::{Identification, IdentifyOptions, Index, MAX_DETECTIONS, Match, Solution, clutter, spread};
use crate::camera::{Camera, Model};
use crate::catalog::Catalog;
use crate::coordinates::{Apparent, Attitude, CameraAxes, Direction, PixelPoint};
use crate::detect::Detections;
use crate::statistics::median_in_place;
use crate::statistics::order::descending;
use crate::units::DEG_RAD;

/// Stars are picked from so many detections, the brightest, where many look like none.
const MAX_LOOKED_THROUGH: usize = 4 * MAX_DETECTIONS;
/// Detections nearer to a brighter one than this are not used in the search, px: halves of one star image.
const MERGE_PX: f64 = 2.5;
/// Within this part of the frame's size a detection may belong to a star at first.
const FIRST_RADIUS: f64 = 0.006;
/// Turns of naming stars and fitting the pose to them.
const MAX_TURNS: usize = 4;

/// More pixels than these a side are a mistake.
const MAX_SIDE_PX: usize = 1_000_000;

/// Of the stars around the middle of a fisheye's frame one in so many has to be named in the end.
const MIN_KEPT: usize = 2;

/// The fewest matches with which an attitude is stated.
const MIN_MATCHES: usize = 4;

/// The catalogue's own directions, for frames about which nothing is known that would change them.
#[must_use]
pub fn catalog_directions(catalog: &Catalog) -> Vec<Direction<Apparent>> {
    catalog.stars.iter().map(|star| Direction::from_unit(star.direction.xyz)).collect()
}

/// What is wrong with the options, as a sentence.
pub(super) fn fault_in(options: &IdentifyOptions, detections: &Detections) -> Option<Refusal> {
    let [narrow, wide] = options.field_width_range_rad;
    let (width_px, height_px) = (detections.width_px, detections.height_px);
    if width_px == 0 || height_px == 0 {
        return Some(Refusal::EmptyFrame { width_px, height_px });
    }
    if width_px.max(height_px) > MAX_SIDE_PX {
        return Some(Refusal::FrameTooLarge { width_px, height_px, most_px: MAX_SIDE_PX });
    }
    if let Some(fault) = options.near.and_then(|near| near.fault()) {
        return Some(fault);
    }
    if let Some(parity) = options.parity.filter(|parity| ![1, -1].contains(parity)) {
        return Some(Refusal::Parity { parity });
    }
    let probability = options.max_false_match_probability;
    if !(probability > 0.0 && probability <= 1.0) {
        return Some(Refusal::Probability { probability });
    }
    if let Some(focal_length_px) = options.nominal_focal_length_px {
        let half = width_px.max(height_px) as f64 / 2.0;
        let width_deg = 2.0 * (half / focal_length_px).atan() / DEG_RAD;
        if !(focal_length_px > 0.0 && (0.5..=150.0).contains(&width_deg)) {
            return Some(Refusal::FocalLength { focal_length_px, width_px, height_px });
        }
    }
    if !(options.focal_length_tolerance >= 0.0 && options.focal_length_tolerance <= 10.0) {
        return Some(Refusal::Tolerance { tolerance: options.focal_length_tolerance });
    }
    if !(narrow > 0.5 * DEG_RAD && wide < 150.0 * DEG_RAD && narrow < wide) {
        return Some(Refusal::FieldWidths { range_rad: options.field_width_range_rad });
    }
    None
}

/// The detections that the search can use, brightest first: finite, on the frame, not the second half of a brighter one.
pub(super) fn usable_points(detections: &Detections) -> FramePoints {
    let (width, height) = (detections.width_px as f64, detections.height_px as f64);
    let middle = [(width - 1.0) / 2.0, (height - 1.0) / 2.0];
    let mut order = Vec::with_capacity(detections.stars.len());
    order.extend((0..detections.stars.len()).filter(|&number| {
        let star = &detections.stars[number];
        (-0.5..width - 0.5).contains(&star.x_px) && (-0.5..height - 0.5).contains(&star.y_px)
    }));
    let flux = |number: usize| Some(detections.stars[number].flux_dn).filter(|flux| flux.is_finite()).unwrap_or(f64::MIN);
    descending(&mut order, |&number| flux(number));
    let mut points = Points {
        centred_px: Vec::with_capacity(order.len().min(MAX_LOOKED_THROUGH)),
        detection: Vec::with_capacity(order.len().min(MAX_LOOKED_THROUGH)),
        half_px: [width / 2.0, height / 2.0],
        size_px: (width * height).sqrt(),
        corner_px: width.hypot(height) / 2.0,
        reach_px: width.hypot(height) / 2.0,
    };
    for number in order {
        let star = &detections.stars[number];
        let at = [star.x_px - middle[0], star.y_px - middle[1]];
        let apart = |other: &[f64; 2]| (other[0] - at[0]).powi(2) + (other[1] - at[1]).powi(2) >= MERGE_PX * MERGE_PX;
        if points.centred_px.iter().all(apart) {
            points.centred_px.push(at);
            points.detection.push(number);
            if points.centred_px.len() == MAX_LOOKED_THROUGH {
                break;
            }
        }
    }
    let widths_px: Vec<f64> = points.detection.iter().map(|&number| detections.stars[number].width_px).collect();
    let lone = clutter::without_clutter(&points, &widths_px).map(|lone| lone.first(MAX_DETECTIONS));
    let spread = spread::spread(&points).map(|spread| spread.first(MAX_DETECTIONS));
    FramePoints { all: points.first(MAX_DETECTIONS), lone, spread }
}

/// Fits an accepted hypothesis to all stars of the frame.
pub(super) fn solve(detections: &Detections, points: &Points, index: &Index, apparent: &[Vector3<f64>], found: &Found) -> Identification {
    let mut pose = match found.pose.projection {
        Projection::Pinhole => found.pose,
        _ => fisheye::widen(&found.pose, found.reach_px, points, index, apparent),
    };
    let mut point_of = vec![None; detections.stars.len()];
    for (point, &detection) in points.detection.iter().enumerate() {
        point_of[detection] = Some(point);
    }
    let mut radius_px = FIRST_RADIUS * points.size_px;
    let sky = LaidSky::new(detections, points, index, apparent, (parity_of(&pose), radius_px));
    let mut near = NearDetections::default();
    sky.find_near(&pose, &mut near);
    let (mut fitted, mut settled) = (Vec::new(), None);
    for _ in 0..MAX_TURNS {
        let matches = sky.matches(&pose, &mut near, radius_px);
        let mut pairs: Vec<Pair> = Vec::with_capacity(matches.len());
        pairs.extend(matches.iter().filter_map(|m| Some((point_of[m.detection]?, m.star as u32))));
        // The same pairs lead to where the pose is already.
        let is_fitted = pairs == fitted;
        if !is_fitted {
            let Some(next) = fit(&pose, points, apparent, &pairs, pairs.len() >= MIN_FOR_KAPPA, AT_REST_PX) else { break };
            (pose, fitted) = (next, pairs);
        }
        // Five robust standard deviations.
        let mut lengths: Vec<f64> = matches.iter().map(|m| (m.residual_px[0].powi(2) + m.residual_px[1].powi(2)).sqrt()).collect();
        let sigma_px = median_in_place(&mut lengths).map_or(1.0, |median| median / association::MEDIAN_LENGTH);
        let before_px = radius_px;
        radius_px = (5.0 * sigma_px).clamp(1.5_f64.min(radius_px), radius_px);
        if is_fitted && radius_px == before_px {
            settled = Some(matches);
            break;
        }
    }
    // Those of this very pose: pairs of an earlier turn would carry another's residuals.
    let matches = settled.unwrap_or_else(|| sky.matches(&pose, &mut near, radius_px));
    if matches.len() < MIN_MATCHES {
        return Identification::NotIdentified { reason: Refusal::TooFewMatches { matches: matches.len() }, hypotheses: found.hypotheses };
    }
    // A lens that follows no law may be lost on the way outwards: then few stars still lie on their places, and the attitude is degrees off.
    if pose.projection != Projection::Pinhole {
        let around_middle = fisheye::matched(&found.pose, found.reach_px, points, index, apparent);
        if MIN_KEPT * matches.len() < around_middle {
            return Identification::NotIdentified {
                reason: Refusal::FisheyeLost { around_middle, matches: matches.len() },
                hypotheses: found.hypotheses,
            };
        }
    }
    Identification::Identified(Solution {
        attitude: attitude_of(&pose),
        camera: camera_of(&pose, detections, points),
        projection: pose.projection,
        parity: parity_of(&pose),
        lit_radius_px: lit_radius_px(&pose, &matches, detections),
        rms_px: rms_px(&matches),
        matches,
        false_match_probability: found.false_match_probability,
    })
}

/// How far from the principal point of a fisheye there are stars. The law of its lens is known so far, and its image ends not far beyond.
fn lit_radius_px(pose: &Pose, matches: &[Match], detections: &Detections) -> f64 {
    /// Of a few stars the outermost is not at the rim.
    const BEYOND: f64 = 1.05;
    if pose.projection == Projection::Pinhole {
        return f64::INFINITY;
    }
    let (width, height) = (detections.width_px as f64, detections.height_px as f64);
    let [x0, y0] = [pose.principal_px[0] + (width - 1.0) / 2.0, pose.principal_px[1] + (height - 1.0) / 2.0];
    let far = |one: &Match| {
        let star = &detections.stars[one.detection];
        (unmirrored_x(parity_of(pose), detections.width_px, star.x_px) - x0).hypot(star.y_px - y0)
    };
    BEYOND * matches.iter().map(far).fold(0.0, f64::max)
}

fn rms_px(matches: &[Match]) -> f64 {
    let sum: f64 = matches.iter().map(|m| m.residual_px[0].powi(2) + m.residual_px[1].powi(2)).sum();
    (sum / matches.len().max(1) as f64).sqrt()
}

fn camera_of(pose: &Pose, detections: &Detections, points: &Points) -> Camera {
    let camera = Camera::pinhole(detections.width_px, detections.height_px, pose.focal_px);
    let [x0, y0] = camera.principal_point_px;
    let principal_point_px = [x0 + pose.principal_px[0], y0 + pose.principal_px[1]];
    Camera { k1: pose.kappa / (points.corner_px * points.corner_px), principal_point_px, ..camera }
}

fn attitude_of(pose: &Pose) -> Attitude {
    Attitude::new(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(pose.rotation)))
}

fn parity_of(pose: &Pose) -> i8 {
    if pose.parity < 0.0 { -1 } else { 1 }
}

impl Solution {
    /// The camera with its projection.
    #[must_use]
    pub fn model(&self) -> Model {
        let model = Model::new(self.camera);
        // Projections that identification knows have nothing beyond focal length and principal point.
        model.clone().with_projection(self.projection.id(), &[]).unwrap_or(model)
    }

    /// The direction in which a point of the un-mirrored frame looks; of one beyond the image of a fisheye, that of its edge.
    fn direction(&self, point: PixelPoint) -> Direction<CameraAxes> {
        if self.projection == Projection::Pinhole {
            return self.camera.direction(point);
        }
        let model = self.model();
        let context = model.reference_context();
        let [x0, y0] = self.camera.principal_point_px;
        // Beyond the image nothing is seen, whatever the law would say of it.
        let far = (point.x_px - x0).hypot(point.y_px - y0);
        let within = if far > self.lit_radius_px { self.lit_radius_px / far } else { 1.0 };
        let towards =
            |share: f64| PixelPoint { x_px: x0 + share * within * (point.x_px - x0), y_px: y0 + share * within * (point.y_px - y0) };
        let seen = (0..=100).find_map(|step| model.direction(towards(1.0 - 0.01 * f64::from(step)), &context));
        seen.unwrap_or_else(|| self.camera.direction(towards(0.0)))
    }

    /// The apparent direction of the middle of the frame, ICRS axes.
    #[must_use]
    pub fn centre(&self) -> Direction<Apparent> {
        self.attitude.apparent_from_camera(&self.direction(self.camera.middle()))
    }

    /// The position angle, north through east, of the frame's upward direction (−y) at its middle, degrees from 0 to 360.
    #[must_use]
    pub fn roll_deg(&self) -> f64 {
        let PixelPoint { x_px, y_px } = self.camera.middle();
        let sky = |y_px: f64| Vector3::from(self.attitude.apparent_from_camera(&self.direction(PixelPoint { x_px, y_px })).xyz);
        let (up, centre) = (sky(y_px - 0.5) - sky(y_px + 0.5), sky(y_px));
        let east = Vector3::new(-centre.y, centre.x, 0.0);
        let north = centre.cross(&east);
        (up.dot(&east).atan2(up.dot(&north)) / DEG_RAD).rem_euclid(360.0)
    }

    /// The angle from the left to the right edge of the frame, through its middle, degrees; of a fisheye whose image ends before, from edge to edge of
    /// the image, as far as there are stars in it.
    #[must_use]
    pub fn width_deg(&self) -> f64 {
        let PixelPoint { x_px, y_px } = self.camera.middle();
        self.angle_deg([-0.5, x_px, self.camera.width_px as f64 - 0.5].map(|x_px| PixelPoint { x_px, y_px }))
    }

    /// The angle from the upper to the lower edge of the frame, through its middle, degrees.
    #[must_use]
    pub fn height_deg(&self) -> f64 {
        let PixelPoint { x_px, y_px } = self.camera.middle();
        self.angle_deg([-0.5, y_px, self.camera.height_px as f64 - 0.5].map(|y_px| PixelPoint { x_px, y_px }))
    }

    /// The angle from the first to the last of three points of the frame: of a fisheye over the second, since it may be more than 180°.
    fn angle_deg(&self, [a, middle, b]: [PixelPoint; 3]) -> f64 {
        let between = |a: PixelPoint, b: PixelPoint| self.direction(a).angle_rad(&self.direction(b)) / DEG_RAD;
        if self.projection == Projection::Pinhole { between(a, b) } else { between(a, middle) + between(middle, b) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::{Detection, Flags};
    use rand::{RngExt, SeedableRng};

    /// A frame 15° wide with the seven brightest stars, displaced at random by up to `most_px`, and the pose that it has.
    fn frame(seed: u64, most_px: f64) -> (Detections, Pose) {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
        let mut angle = || rng.random_range(-1.2..1.2);
        let attitude = Attitude::from_pointing(angle(), angle(), angle());
        let rotation = *attitude.camera_from_icrs.to_rotation_matrix().matrix();
        let pose = Pose { rotation, focal_px: 3889.0, kappa: 0.0, parity: 1.0, projection: Projection::Pinhole, principal_px: [0.0; 2] };
        let star = |star: &crate::catalog::Star| {
            let [x, y] = pose.project(&Vector3::from(star.direction.xyz), 724.0).filter(|at| at.iter().all(|c| c.abs() < 500.0))?;
            let mut moved = |c: f64| c + 511.5 + rng.random_range(-most_px..most_px);
            Some(Detection {
                x_px: moved(x),
                y_px: moved(y),
                covariance_px2: [0.01, 0.0, 0.01],
                flux_dn: 1e5 * 10_f64.powf(-0.4 * star.magnitude),
                flux_sigma_dn: 10.0,
                background_dn: 0.0,
                background_gradient_dn: [0.0; 2],
                width_px: 1.0,
                moments: None,
                chi2_per_dof: 1.0,
                peak_dn: 1000.0,
                flags: Flags::default(),
            })
        };
        let stars = Catalog::embedded().stars.iter().filter_map(star).take(7).collect();
        (Detections { width_px: 1024, height_px: 1024, background_dn: 0.0, noise_dn: 1.0, stars }, pose)
    }

    #[test]
    fn the_matches_told_are_those_of_the_attitude_told() {
        let (catalog, index) = (Catalog::embedded(), Index::new(Catalog::embedded()));
        let (mut identified, mut refused) = (0, 0);
        for seed in 0..300 {
            // Displacements beyond what the first radius holds, so that pairs are lost from turn to turn.
            let (detections, pose) = frame(seed, 7.0);
            let points = usable_points(&detections).all;
            let found = Found { pose, reach_px: points.reach_px, hypotheses: 1, false_match_probability: 1e-9 };
            match solve(&detections, &points, &index, &index.vectors, &found) {
                Identification::NotIdentified { .. } => refused += 1,
                Identification::Identified(solution) => {
                    identified += 1;
                    assert!(solution.matches.len() >= MIN_MATCHES);
                    for one in &solution.matches {
                        let v = catalog.stars[one.star].direction.xyz;
                        let seen = solution.attitude.camera_from_apparent(&Direction::from_unit(v));
                        let (detection, place) = (&detections.stars[one.detection], solution.camera.pixel(&seen).unwrap());
                        let residual = [detection.x_px - place.x_px, detection.y_px - place.y_px];
                        let off = (residual[0] - one.residual_px[0]).hypot(residual[1] - one.residual_px[1]);
                        assert!(off < 1e-6, "seed {seed}: {residual:?} {:?}", one.residual_px);
                    }
                }
            }
        }
        assert!(identified > 100 && refused > 3, "{identified} {refused}");
    }
}

//! Synthetic control points of a known camera, for trials of calibrators: no image is rendered or measured.
//!
//! The stars are those of a catalogue, seen from random attitudes: in each frame the brightest that fall into it, as a camera with a
//! limit of magnitude would find them, clusters and gaps of the sky included. Each is measured where the true camera images it,
//! with normal errors. Then a share of the points is given another star, in one of three ways ([`WrongStars`]).
//!
//! The attitudes, the stars and the errors depend on the seed alone, and not on the wrong stars: the same seed with another kind or
//! share is the same night with other names.

use std::collections::BTreeSet;

use nalgebra::{UnitQuaternion, Vector3};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use crate::camera::Camera;
use crate::catalog::Catalog;
use crate::coordinates::{Apparent, Attitude, Direction, Icrs, PixelPoint};
use crate::effects::{StarImage, StarState};
use crate::identify::{ControlPoint, ControlPoints, MisidentificationKind, misidentify};
use crate::units::DEG_RAD;

/// What the wrong identifications look like.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum WrongStars {
    /// A direction 0.05° to 2° away from the right one, as if there were a star ([`MisidentificationKind::Random`]).
    Random,
    /// One of the nearest few other stars of the catalogue ([`MisidentificationKind::NearNeighbour`]).
    NearNeighbour,
    /// As a match through the camera before calibration makes them: the catalogue star nearest to where the measured pixel points
    /// through the nominal camera and the true attitude, other than the right one and those already named in the frame. So the
    /// wrong directions are correlated with the error of the nominal camera. Points without such a star keep their own.
    Natural {
        /// The star must lie within this angle.
        radius_rad: f64,
    },
}

impl WrongStars {
    /// [`Self::Natural`] within 2°.
    pub const NATURAL: Self = Self::Natural { radius_rad: 2.0 * DEG_RAD };
}

/// How a night is made.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// The camera that takes the frames.
    pub truth: Camera,
    /// The camera before calibration.
    pub nominal: Camera,
    /// Frames, each with an attitude of its own.
    pub frames: usize,
    /// Stars in each frame; fewer where the catalogue has fewer in the field.
    pub stars_per_frame: usize,
    /// Error of a measured position per axis.
    pub noise_px: f64,
    /// What wrong identifications look like.
    pub wrong_stars: WrongStars,
    /// Share of all points that is given a wrong star, 0 to 1, rounded to whole points.
    pub wrong_share: f64,
    /// Error per axis of the starting attitudes, rad; with `None` there are no starting attitudes.
    pub attitude_sigma_rad: Option<f64>,
}

/// A night with what is true of it.
#[derive(Clone, Debug, PartialEq)]
pub struct TrialNight {
    /// What a calibrator sees.
    pub control_points: ControlPoints,
    /// The camera that took the frames.
    pub truth: Camera,
    /// The attitude of each frame.
    pub attitudes: Vec<Attitude>,
    /// For each point, whether it was given a wrong star.
    pub wrong: Vec<bool>,
    /// For each point, the number of the star that it is.
    pub true_hip: Vec<u32>,
}

/// Made into the seed of the wrong stars, so that they do not follow the numbers of the night itself.
const WRONG_STARS_STREAM: u64 = 0x9e37_79b9_7f4a_7c15;

impl Trial {
    /// The setting of the published method's tables: 12 frames × 25 stars, 1024 px, f = 2800 px (before calibration 1 % longer, and
    /// no distortion known), 0.1 px; all stars right, starting attitudes good to 0.1°.
    #[must_use]
    pub fn published() -> Self {
        let truth = Camera { principal_point_px: [516.3, 507.9], k1: 5e-9, p1: 2e-7, p2: -1.5e-7, ..Camera::pinhole(1024, 1024, 2800.0) };
        Self {
            truth,
            nominal: Camera::pinhole(1024, 1024, 2800.0 * 1.01),
            frames: 12,
            stars_per_frame: 25,
            noise_px: 0.1,
            wrong_stars: WrongStars::Random,
            wrong_share: 0.0,
            attitude_sigma_rad: Some(0.1 * DEG_RAD),
        }
    }

    /// The night of a seed. The same seed gives the same night.
    #[must_use]
    pub fn night(&self, catalog: &Catalog, seed: u64) -> TrialNight {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let radius_rad = self.field_radius_rad();
        let (mut points, mut attitudes, mut starts) = (Vec::new(), Vec::new(), Vec::new());
        for frame in 0..self.frames {
            let attitude = random_attitude(&mut rng);
            let start = self.attitude_sigma_rad.map(|sigma| {
                let turn = UnitQuaternion::from_scaled_axis(Vector3::from(normals(&mut rng)) * sigma);
                Attitude::new(turn * attitude.camera_from_icrs)
            });
            points.extend(self.frame_points(catalog, frame, &attitude, radius_rad, &mut rng));
            attitudes.push(attitude);
            starts.push(start);
        }
        let true_hip: Vec<u32> = points.iter().map(|point| point.hip).collect();
        let mut control_points = ControlPoints::new(self.nominal, starts, points);
        let mut wrong = vec![false; true_hip.len()];
        for point in self.give_wrong_stars(&mut control_points, &attitudes, catalog, seed ^ WRONG_STARS_STREAM) {
            wrong[point] = true;
        }
        TrialNight { control_points, truth: self.truth, attitudes, wrong, true_hip }
    }

    /// From the middle of the frame to its farthest corner.
    fn field_radius_rad(&self) -> f64 {
        let (right, bottom) = (self.truth.width_px as f64 - 0.5, self.truth.height_px as f64 - 0.5);
        let at = |x_px: f64, y_px: f64| self.truth.direction(PixelPoint { x_px, y_px });
        let middle = self.middle();
        let corners = [(-0.5, -0.5), (right, -0.5), (-0.5, bottom), (right, bottom)];
        corners.into_iter().map(|(x, y)| at(x, y).angle_rad(&middle)).fold(0.0, f64::max)
    }

    fn middle(&self) -> Direction<crate::coordinates::CameraAxes> {
        let middle = |length: usize| (length as f64 - 1.0) / 2.0;
        self.truth.direction(PixelPoint { x_px: middle(self.truth.width_px), y_px: middle(self.truth.height_px) })
    }

    /// The brightest stars in a frame, as they are measured.
    fn frame_points(&self, catalog: &Catalog, frame: usize, attitude: &Attitude, radius_rad: f64, rng: &mut Pcg64Mcg) -> Vec<ControlPoint> {
        let centre = Direction::<Icrs>::from_unit(attitude.apparent_from_camera(&self.middle()).xyz);
        let (right, bottom) = (self.truth.width_px as f64 - 0.5, self.truth.height_px as f64 - 0.5);
        let variance = self.noise_px * self.noise_px;
        catalog
            .stars_within(&centre, radius_rad, f64::INFINITY)
            .into_iter()
            .filter_map(|index| {
                let star = &catalog.stars[index];
                let direction = Direction::<Apparent>::from_unit(star.direction.xyz);
                let image = self.truth.pixel(&attitude.camera_from_apparent(&direction))?;
                let inside = (-0.5..right).contains(&image.x_px) && (-0.5..bottom).contains(&image.y_px);
                inside.then_some((star, direction, image))
            })
            .take(self.stars_per_frame)
            .map(|(star, direction, image)| {
                let [x, y, _] = normals(rng);
                ControlPoint {
                    frame,
                    hip: star.hip,
                    direction,
                    x_px: image.x_px + self.noise_px * x,
                    y_px: image.y_px + self.noise_px * y,
                    covariance_px2: [variance, 0.0, variance],
                    catalog_sigma_rad: 0.0,
                    has_proper_motion: star.proper_motion_rad_yr.is_some(),
                    magnitude: star.magnitude,
                    colour: star.colour,
                    star: StarState::of(star, catalog.epoch_yr),
                    image: StarImage::default(),
                }
            })
            .collect()
    }

    /// Gives the share of the points wrong stars; which points they are.
    fn give_wrong_stars(&self, points: &mut ControlPoints, attitudes: &[Attitude], catalog: &Catalog, seed: u64) -> Vec<usize> {
        let by_kind = |points: &mut ControlPoints, kind| {
            misidentify(points, catalog, self.wrong_share, kind, seed).0.into_iter().map(|wrong| wrong.point).collect()
        };
        match self.wrong_stars {
            WrongStars::Random => by_kind(points, MisidentificationKind::Random),
            WrongStars::NearNeighbour => by_kind(points, MisidentificationKind::NearNeighbour),
            WrongStars::Natural { radius_rad } => self.match_through_nominal(points, attitudes, catalog, radius_rad, seed),
        }
    }

    fn match_through_nominal(
        &self,
        points: &mut ControlPoints,
        attitudes: &[Attitude],
        catalog: &Catalog,
        radius_rad: f64,
        seed: u64,
    ) -> Vec<usize> {
        let wanted = (self.wrong_share.clamp(0.0, 1.0) * points.points.len() as f64).round() as usize;
        let mut order: Vec<usize> = (0..points.points.len()).collect();
        order.shuffle(&mut Pcg64Mcg::seed_from_u64(seed));
        let mut named: BTreeSet<(usize, u32)> = points.points.iter().map(|point| (point.frame, point.hip)).collect();
        let mut changed = Vec::new();
        for index in order {
            if changed.len() == wanted {
                break;
            }
            let point = &mut points.points[index];
            let pixel = PixelPoint { x_px: point.x_px, y_px: point.y_px };
            let seen = attitudes[point.frame].apparent_from_camera(&self.nominal.direction(pixel));
            let seen = Direction::<Icrs>::from_unit(seen.xyz);
            let free = catalog
                .stars_within(&seen, radius_rad, f64::INFINITY)
                .into_iter()
                .filter(|star| !named.contains(&(point.frame, catalog.stars[*star].hip)))
                .map(|star| (catalog.stars[star].direction.angle_rad(&seen), star));
            let Some((_, nearest)) = free.min_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
            let star = &catalog.stars[nearest];
            named.remove(&(point.frame, point.hip));
            named.insert((point.frame, star.hip));
            point.hip = star.hip;
            point.direction = Direction::from_unit(star.direction.xyz);
            point.has_proper_motion = star.proper_motion_rad_yr.is_some();
            point.magnitude = star.magnitude;
            point.colour = star.colour;
            point.star = StarState::of(star, catalog.epoch_yr);
            changed.push(index);
        }
        changed
    }
}

/// Any rotation, all equally likely.
fn random_attitude(rng: &mut Pcg64Mcg) -> Attitude {
    let [i, j, k] = normals(rng);
    let [w, _, _] = normals(rng);
    Attitude::from([i, j, k, w])
}

fn normals(rng: &mut impl Rng) -> [f64; 3] {
    std::array::from_fn(|_| StandardNormal.sample(rng))
}

//! Deliberate misidentification, for trials of calibrators: a share of the control points is given another star's direction.

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use super::{ControlPoint, ControlPoints, wrong_camera};
use crate::catalog::Catalog;
use crate::coordinates::{Apparent, Direction};
use crate::effects::StarState;
use crate::statistics::order::sort_by;
use crate::units::DEG_RAD;

/// Kinds of deliberately wrong identifications.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MisidentificationKind {
    /// A direction 0.05° to 2° away from the right one, evenly in angle and in azimuth, as if there were a star.
    Random,
    /// One of the nearest few other stars of the catalogue within 2°.
    NearNeighbour,
    /// What a match through a wrong camera makes of it: the catalogue star nearest to where a camera with another focal length that points
    /// elsewhere sees it, no fainter than the faintest of the frame. The camera is as little wrong as gives the share, one for all frames,
    /// so the errors of neighbours in a frame are alike, and there are more of them where that camera errs more and where stars are dense.
    #[serde(alias = "natural")]
    WrongCamera,
}

/// A control point that was given a wrong star.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Misidentification {
    /// Index into [`ControlPoints::points`].
    pub point: usize,
    /// The star that it is.
    pub true_hip: u32,
    /// The star that it is said to be; `None` for a direction without a star.
    pub given_hip: Option<u32>,
    /// How far the given direction lies from the right one, rad.
    pub error_rad: f64,
}

/// How far the wrong direction lies from the right one, rad.
const ERROR_RANGE_RAD: [f64; 2] = [0.05 * DEG_RAD, 2.0 * DEG_RAD];
/// A near neighbour is one of so many nearest.
const NEAREST: usize = 4;

/// Gives the share `share` (0 to 1, rounded to whole points) of the control points wrong stars, chosen by `seed`; returns which, in
/// order, and a sentence if they are fewer than asked for. Points keep their frame, pixel and covariance. A point that has no other star
/// of the catalogue near enough gets a random direction, but for [`MisidentificationKind::WrongCamera`], where it stays right.
pub fn misidentify(
    points: &mut ControlPoints,
    catalog: &Catalog,
    share: f64,
    kind: MisidentificationKind,
    seed: u64,
) -> (Vec<Misidentification>, Option<String>) {
    let all = points.points.len();
    let wanted = (share.clamp(0.0, 1.0) * all as f64).round() as usize;
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    if kind == MisidentificationKind::WrongCamera {
        let names = wrong_camera::wrong_names(points, catalog, wanted, &mut rng);
        let wrong: Vec<_> = names.into_iter().map(|(number, star)| give_star(points, number, star, catalog)).collect();
        let sentence = (wrong.len() < wanted).then(|| {
            format!(
                "Only {} of the {wanted} wrong identifications asked for were made, of {all} in all: a camera whose focal length is {:.0} % off makes no more of them wrong; ask for a smaller share, or for those of another kind.",
                wrong.len(),
                100.0 * wrong_camera::MAX_SCALE
            )
        });
        return (wrong, sentence);
    }
    let mut chosen: Vec<usize> = (0..all).collect();
    chosen.shuffle(&mut rng);
    chosen.truncate(wanted);
    chosen.sort_unstable();
    let wrong = chosen.into_iter().map(|number| {
        let neighbour = match kind {
            MisidentificationKind::NearNeighbour => near_neighbour(&points.points[number], catalog, &mut rng),
            MisidentificationKind::Random | MisidentificationKind::WrongCamera => None,
        };
        match neighbour {
            Some(star) => give_star(points, number, star, catalog),
            None => give_direction(points, number, &mut rng),
        }
    });
    (wrong.collect(), None)
}

/// Gives a point another star of the catalogue.
fn give_star(points: &mut ControlPoints, number: usize, star: usize, catalog: &Catalog) -> Misidentification {
    let (point, star) = (&mut points.points[number], &catalog.stars[star]);
    let right = *point;
    // What the sky does to the right star's light it does to a neighbour's: the same small shift is added.
    let own = catalog.by_hip(right.hip).map_or(right.direction.xyz, |own| own.direction.xyz);
    let shifted = [0, 1, 2].map(|axis| star.direction.xyz[axis] + right.direction.xyz[axis] - own[axis]);
    point.direction = Direction::along(shifted);
    point.hip = star.hip;
    point.magnitude = star.magnitude;
    point.colour = star.colour;
    point.has_proper_motion = star.proper_motion_rad_yr.is_some();
    point.star = StarState::of(star, catalog.epoch_yr);
    let error_rad = point.direction.angle_rad(&right.direction);
    Misidentification { point: number, true_hip: right.hip, given_hip: Some(star.hip), error_rad }
}

/// Gives a point a direction by chance.
fn give_direction(points: &mut ControlPoints, number: usize, rng: &mut Pcg64Mcg) -> Misidentification {
    let point = &mut points.points[number];
    let right = *point;
    let [least, most] = ERROR_RANGE_RAD;
    point.direction = turned(&right.direction, rng.random_range(least..most), rng.random_range(0.0..std::f64::consts::TAU));
    // As if there were a star that the sky treats as it does the right one.
    let own = right.star.direction;
    let shifted = [0, 1, 2].map(|axis| point.direction.xyz[axis] - right.direction.xyz[axis] + own[axis]);
    point.star.direction = Direction::<Apparent>::along(shifted).xyz;
    let error_rad = point.direction.angle_rad(&right.direction);
    Misidentification { point: number, true_hip: right.hip, given_hip: None, error_rad }
}

/// One of the nearest other stars of the catalogue, as its index.
fn near_neighbour(point: &ControlPoint, catalog: &Catalog, rng: &mut Pcg64Mcg) -> Option<usize> {
    let [_, most] = ERROR_RANGE_RAD;
    let [x, y, z] = point.direction.xyz;
    let cos_most = most.cos();
    let mut near: Vec<(f64, usize)> = catalog
        .stars
        .iter()
        .enumerate()
        .filter(|(_, star)| star.hip != point.hip)
        .map(|(number, star)| (star.direction.xyz[0] * x + star.direction.xyz[1] * y + star.direction.xyz[2] * z, number))
        .filter(|(cosine, _)| *cosine > cos_most)
        .collect();
    sort_by(&mut near, |a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    near.truncate(NEAREST);
    (!near.is_empty()).then(|| near[rng.random_range(0..near.len())].1)
}

/// The direction at an angle from another, at an azimuth around it.
fn turned(direction: &Direction<Apparent>, angle_rad: f64, azimuth_rad: f64) -> Direction<Apparent> {
    let v = nalgebra::Vector3::from(direction.xyz);
    let helper = if v.z.abs() < 0.9 { nalgebra::Vector3::z() } else { nalgebra::Vector3::x() };
    let a = v.cross(&helper).normalize();
    let b = v.cross(&a);
    let w = v * angle_rad.cos() + (a * azimuth_rad.cos() + b * azimuth_rad.sin()) * angle_rad.sin();
    Direction::along([w.x, w.y, w.z])
}

//! Re-identification: calibrate, identify anew with the better camera, and repeat until nothing changes.
//!
//! A wrong camera makes wrong identifications; the solved one shows which star each image really is. For every frame with an attitude the
//! catalogue's stars are imaged through the solved chain. An image is associated with the nearest star within a gate (its own error, the estimated
//! noise and the map's uncertainty), if the star has no nearer image. An image without such a star keeps its identification (weighted by the fit),
//! unless its star has gone to another image.
//!
//! Where detections are so dense, or the gate so wide, that chance associations are frequent, the gate is narrowed until no more than a small share
//! of the new pairs is due to chance, and closed where no width does.

use std::collections::BTreeMap;

use super::calibration::Reidentified;
use super::{CalibrateError, CalibrateOptions, Calibration, calibrate};
use crate::camera::Model;
use crate::catalog::Catalog;
use crate::coordinates::{Apparent, CameraAxes, Direction, Icrs, PixelPoint};
use crate::effects::{self, Context, StarState};
use crate::identify::{ControlPoint, ControlPoints};
use crate::statistics::order::sort_by_key;

/// Rounds at most.
const ROUNDS: usize = 8;
/// The gate in standard errors, squared: 5σ.
const GATE: f64 = 25.0;
/// The gates that are tried, widest first, and the share of new pairs that may come by chance.
const GATES: [f64; 4] = [GATE, 12.0, 6.0, 3.0];
const MAX_BY_CHANCE: f64 = 0.1;
/// Stars this much fainter than the faintest that is surely identified are not looked for.
const FAINTER: f64 = 0.5;
/// Stars may stand this much off their catalogue place (aberration, refraction, motion), rad.
const MARGIN_RAD: f64 = 0.012;
/// A frame with fewer images of weight is not trusted to name stars.
const MIN_STARS: usize = 4;

/// A measured star image, identified or not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredStarImage {
    /// Index of the frame in its recording.
    pub frame: usize,
    /// Column, of the un-mirrored image.
    pub x_px: f64,
    /// Row.
    pub y_px: f64,
    /// Covariance of the position: xx, xy, yy.
    pub covariance_px2: [f64; 3],
    /// What else is known of it.
    pub state: effects::StarImage,
}

/// Calibrates, and identifies anew until nothing changes. `images` are further star images of the frames, those that had no star at
/// first; they may be none. Stars fainter than `max_magnitude` are not looked for. The result's control points are the last ones.
pub fn calibrate_identifying_anew(
    control_points: &ControlPoints,
    images: &[MeasuredStarImage],
    catalog: &Catalog,
    max_magnitude: Option<f64>,
    options: &CalibrateOptions,
) -> Result<Calibration, CalibrateError> {
    let quick = CalibrateOptions { held_out: false, ..options.clone() };
    let mut points = control_points.clone();
    let mut total = Reidentified { rounds: 0, changed: 0, added: 0, removed: 0 };
    for _ in 0..ROUNDS {
        let calibration = calibrate(&points, &quick)?;
        let (next, change) = identified_anew(&points, &calibration, images, catalog, max_magnitude.unwrap_or(f64::INFINITY));
        total.rounds += 1;
        if change == (Reidentified { rounds: 0, changed: 0, added: 0, removed: 0 }) {
            break;
        }
        total.changed += change.changed;
        total.added += change.added;
        total.removed += change.removed;
        points = next;
    }
    let mut calibration = calibrate(&points, options)?;
    calibration.reidentified = Some(total);
    Ok(calibration)
}

/// The points with the stars that the calibration sees in them, and what has changed.
fn identified_anew(
    points: &ControlPoints,
    calibration: &Calibration,
    images: &[MeasuredStarImage],
    catalog: &Catalog,
    max_magnitude: f64,
) -> (ControlPoints, Reidentified) {
    let mut chain = calibration.full_chain();
    if calibration.chain.is_none() {
        for term in &points.sky {
            // The effects are those that the directions were made with, so each is known.
            let _ = chain.set(&term.effect, &term.parameters);
        }
    }
    let mut next = points.clone();
    let mut change = Reidentified { rounds: 0, changed: 0, added: 0, removed: 0 };
    let mut gone = Vec::new();
    let mut by_frame: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (index, point) in points.points.iter().enumerate() {
        by_frame.entry(point.frame).or_default().push(index);
    }
    let floor_px2 = calibration.noise.map_or(calibration.unit_weight_sigma_px.powi(2), |noise| noise.floor_px.powi(2))
        + calibration.map_sigma_px.map_or(0.0, |map| map.max.powi(2));
    let surely = |index: &usize| calibration.points[*index].weight > 0.9;
    let faintest = points.points.iter().enumerate().filter(|(index, _)| surely(index)).map(|(_, point)| point.magnitude);
    let limit = faintest.filter(|magnitude| *magnitude < 90.0).fold(f64::NEG_INFINITY, f64::max) + FAINTER;
    let limit = limit.min(max_magnitude);
    for frame in &calibration.per_frame {
        let Some(attitude) = frame.camera_from_icrs.filter(|_| frame.stars >= MIN_STARS) else { continue };
        let of_frame = by_frame.get(&frame.frame).map_or(&[][..], Vec::as_slice);
        let known = |image: &&MeasuredStarImage| {
            of_frame.iter().any(|index| points.points[*index].x_px == image.x_px && points.points[*index].y_px == image.y_px)
        };
        let more: Vec<&MeasuredStarImage> =
            images.iter().filter(|image| image.frame == frame.frame).filter(|image| !known(image)).collect();
        let own = |index: &usize| {
            let ControlPoint { frame, x_px, y_px, covariance_px2, image: state, .. } = points.points[*index];
            MeasuredStarImage { frame, x_px, y_px, covariance_px2, state }
        };
        let all: Vec<MeasuredStarImage> = of_frame.iter().map(own).chain(more.into_iter().copied()).collect();
        let observation = points.observation(frame.frame);
        let field = Field { chain: &chain, catalog, limit, epoch_yr: observation.epoch_yr };
        let stars = field.stars(&attitude, &observation);
        let near = Near { floor_px2: floor_px2 * frame.variance_factor, focal_length_px: chain.camera().focal_length_px };
        let found = near.assign(&all, of_frame.len(), &stars, (chain.camera().width_px * chain.camera().height_px) as f64);
        let taken: Vec<u32> = found.iter().flatten().map(|star| stars[*star].hip).collect();
        for (place, found) in found.iter().enumerate() {
            let image = &all[place];
            match (of_frame.get(place), found.map(|star| &stars[star])) {
                (Some(&index), Some(star)) if is_another(&points.points[index], star) => {
                    let magnitude = if star.magnitude.is_finite() { star.magnitude } else { 99.0 };
                    next.points[index] = ControlPoint { magnitude, ..point_of(image, star) };
                    change.changed += 1;
                }
                (Some(&index), None) if taken.contains(&points.points[index].hip) && points.points[index].hip != 0 => {
                    gone.push(index);
                    change.removed += 1;
                }
                (None, Some(star)) => {
                    next.points.push(point_of(image, star));
                    change.added += 1;
                }
                _ => {}
            }
        }
    }
    gone.sort_unstable();
    for index in gone.into_iter().rev() {
        next.points.remove(index);
    }
    sort_by_key(&mut next.points, |point| point.frame);
    (next, change)
}

/// An image with the star that is seen in it.
fn point_of(image: &MeasuredStarImage, star: &Seen) -> ControlPoint {
    ControlPoint {
        frame: image.frame,
        hip: star.hip,
        direction: star.apparent,
        x_px: image.x_px,
        y_px: image.y_px,
        covariance_px2: image.covariance_px2,
        catalog_sigma_rad: star.sigma_rad,
        has_proper_motion: star.has_proper_motion,
        magnitude: star.magnitude,
        colour: star.star.colour,
        star: star.star,
        image: image.state,
    }
}

/// Whether the point names another star, or has a direction that is not this star's.
fn is_another(point: &ControlPoint, star: &Seen) -> bool {
    const SAME_RAD: f64 = 1e-7;
    point.hip != star.hip || point.direction.angle_rad(&star.apparent) > SAME_RAD
}

/// A catalogue star in a frame.
struct Seen {
    hip: u32,
    place: PixelPoint,
    apparent: Direction<Apparent>,
    star: StarState,
    magnitude: f64,
    sigma_rad: f64,
    has_proper_motion: bool,
}

/// What is looked at: the catalogue through a camera.
struct Field<'a> {
    chain: &'a Model,
    catalog: &'a Catalog,
    limit: f64,
    epoch_yr: Option<f64>,
}

impl Field<'_> {
    /// The stars that fall into the frame.
    fn stars(&self, attitude: &crate::coordinates::Attitude, observation: &effects::Observation) -> Vec<Seen> {
        let camera = self.chain.camera();
        let reference = self.chain.reference_context();
        let corner = |x_px: f64, y_px: f64| self.chain.direction(PixelPoint { x_px, y_px }, &reference);
        let (right, bottom) = (camera.width_px as f64 - 0.5, camera.height_px as f64 - 0.5);
        let Some(centre) = corner(right / 2.0, bottom / 2.0) else { return Vec::new() };
        let corners = [(-0.5, -0.5), (right, -0.5), (-0.5, bottom), (right, bottom)];
        let radius_rad = corners.iter().filter_map(|(x, y)| corner(*x, *y)).map(|d| d.angle_rad(&centre)).fold(0.0, f64::max) + MARGIN_RAD;
        let on_sky = attitude.apparent_from_camera(&Direction::<CameraAxes>::along(centre.xyz));
        let years = self.epoch_yr.map_or(0.0, |epoch| epoch - self.catalog.epoch_yr);
        let near = self.catalog.stars_within(&Direction::<Icrs>::along(on_sky.xyz), radius_rad, self.limit);
        near.into_iter()
            .filter_map(|index| {
                let star = &self.catalog.stars[index];
                let state = StarState::of(star, self.catalog.epoch_yr);
                let context = Context::new(state, *observation);
                let apparent = self.chain.apparent(&context);
                let place = self.chain.pixel(&attitude.camera_from_apparent(&apparent), &context)?;
                self.chain.contains(place).then(|| Seen {
                    hip: star.hip,
                    place,
                    apparent,
                    star: state,
                    magnitude: star.magnitude,
                    sigma_rad: self.catalog.position_sigma_rad(star, years),
                    has_proper_motion: star.proper_motion_rad_yr.is_some(),
                })
            })
            .collect()
    }
}

/// How near an image and a star have to be.
struct Near {
    floor_px2: f64,
    focal_length_px: f64,
}

impl Near {
    /// The covariance of the distance between an image and a star.
    fn covariance_px2(&self, image: &MeasuredStarImage, star: &Seen) -> [f64; 3] {
        let common = self.floor_px2 + (star.sigma_rad * self.focal_length_px).powi(2);
        let [xx, xy, yy] = image.covariance_px2;
        [xx + common, xy, yy + common]
    }

    /// The square of the distance in standard errors.
    fn distance(&self, image: &MeasuredStarImage, star: &Seen) -> f64 {
        let [xx, xy, yy] = self.covariance_px2(image, star);
        let (dx, dy) = (image.x_px - star.place.x_px, image.y_px - star.place.y_px);
        (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
    }

    /// For each image its star (index), if one lies within the gate and has no nearer image; the first `identified` of the images have a star
    /// already. `area_px2`: of the frame.
    fn assign(&self, images: &[MeasuredStarImage], identified: usize, stars: &[Seen], area_px2: f64) -> Vec<Option<usize>> {
        let nearest = |image: &MeasuredStarImage| {
            let all = stars.iter().enumerate().map(|(index, star)| (self.distance(image, star), index));
            all.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))).filter(|(distance, _)| *distance < GATE)
        };
        let mut found: Vec<Option<(f64, usize)>> = images.iter().map(nearest).collect();
        let gate = self.gate(images, identified, &found, stars, area_px2);
        for found in &mut found[identified..] {
            *found = found.filter(|(distance, _)| *distance < gate);
        }
        let mut of_star: BTreeMap<usize, (f64, usize)> = BTreeMap::new();
        for (place, (distance, star)) in found.iter().enumerate().filter_map(|(place, found)| Some((place, (*found)?))) {
            let best = of_star.entry(star).or_insert((distance, place));
            if distance < best.0 {
                *best = (distance, place);
            }
        }
        let is_nearest = |place: usize, star: usize| of_star.get(&star).is_some_and(|best| best.1 == place);
        found.iter().enumerate().map(|(place, found)| found.filter(|(_, star)| is_nearest(place, *star)).map(|(_, star)| star)).collect()
    }

    /// The gate for images that have no star yet: the widest in which not too many would meet one by chance.
    fn gate(&self, images: &[MeasuredStarImage], identified: usize, found: &[Option<(f64, usize)>], stars: &[Seen], area_px2: f64) -> f64 {
        let per_px2 = stars.len() as f64 / area_px2;
        // An image that has nothing to do with the stars has so many of them in a gate of one standard error.
        let by_chance: f64 = images[identified..]
            .iter()
            .zip(&found[identified..])
            .map(|(image, found)| {
                let [xx, xy, yy] = match found {
                    Some((_, star)) => self.covariance_px2(image, &stars[*star]),
                    None => image.covariance_px2.map(|c| c + self.floor_px2),
                };
                per_px2 * std::f64::consts::PI * (xx * yy - xy * xy).max(0.0).sqrt()
            })
            .sum();
        let new = |gate: f64| found[identified..].iter().flatten().filter(|(distance, _)| *distance < gate).count() as f64;
        GATES.into_iter().find(|gate| by_chance * gate <= MAX_BY_CHANCE * new(*gate)).unwrap_or(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// A frame of 1000 × 1000 px with stars anywhere, the first of them imaged to a pixel, and blobs anywhere.
    fn found(stars: usize, imaged: usize, blobs: usize, floor_px: f64) -> (usize, usize) {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(5);
        let mut place = || PixelPoint { x_px: rng.random_range(0.0..1000.0), y_px: rng.random_range(0.0..1000.0) };
        let along = Direction::<Apparent>::along([0.0, 0.0, 1.0]);
        let seen = |place| Seen {
            hip: 1,
            place,
            apparent: along,
            star: StarState::default(),
            magnitude: 5.0,
            sigma_rad: 0.0,
            has_proper_motion: true,
        };
        let stars: Vec<Seen> = (0..stars).map(|_| seen(place())).collect();
        let image = |at: PixelPoint| MeasuredStarImage {
            frame: 0,
            x_px: at.x_px,
            y_px: at.y_px,
            covariance_px2: [0.01, 0.0, 0.01],
            state: effects::StarImage::default(),
        };
        let moved = |at: PixelPoint| PixelPoint { x_px: at.x_px + 0.5 * floor_px, y_px: at.y_px - 0.5 * floor_px };
        let mut images: Vec<MeasuredStarImage> = stars[..imaged].iter().map(|star| image(moved(star.place))).collect();
        images.extend((0..blobs).map(|_| image(place())));
        let near = Near { floor_px2: floor_px * floor_px, focal_length_px: 1000.0 };
        let assigned = near.assign(&images, 0, &stars, 1e6);
        let right = assigned.iter().enumerate().filter(|(image, star)| **star == Some(*image)).count();
        (right, assigned.iter().flatten().count())
    }

    #[test]
    fn blobs_that_meet_stars_by_chance_are_not_named() {
        // Of 3000 blobs hundreds lie within 5σ of one of 800 stars where σ is 2 px.
        let (right, all) = found(800, 20, 3000, 2.0);
        assert!(all - right <= 10, "{right} of {all}");
        // What images tell to a tenth of a pixel is named, blobs or not.
        let (right, all) = found(800, 300, 3000, 0.1);
        assert!(right > 285 && all - right <= 30, "{right} of {all}");
        // Without blobs all are named. Another star lies nearer by chance, within the 1.4 px that images are off, for 0.4 of 200.
        let (right, all) = found(300, 200, 0, 2.0);
        assert!(right >= 198 && all == 200, "{right} of {all}");
    }
}

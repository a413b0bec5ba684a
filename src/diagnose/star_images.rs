//! The star images of a bundle solution, in px: residuals, and the columns of attitudes and camera. What hypotheses, covariates and noise are
//! made of.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use crate::calibrate::{BundleImage, BundleSolution, Column};
use crate::effects::{Context, Observation, ids};
use crate::identify::ControlPoints;

/// A star that is measured farther from where it is predicted may be another one.
pub(super) const REACH_PX: f64 = 100.0;
/// One that is measured farther from there tells nothing of what happens within a pixel.
pub(super) const WITHIN_REACH_PX: f64 = 1.0;

/// The star images at one point of linearisation.
#[derive(Clone, Debug)]
pub(super) struct StarImages {
    /// The star images.
    pub(super) images: Vec<BundleImage>,
    /// Place of each image's frame among the frames.
    pub(super) place: Vec<usize>,
    /// Number of each image's star among the distinct ones.
    pub(super) star: Vec<usize>,
    /// Where its star moves on the frame if it stands farther east, and north, px per rad.
    pub(super) sky_axes: Vec<[[f64; 2]; 2]>,
    /// Frames: number in the recording, and what is known of them.
    pub(super) frames: Vec<(usize, Observation)>,
    /// Residuals, x, y, x, y, …
    pub(super) residual_px: Vec<f64>,
    /// Own columns.
    pub(super) own: Vec<Column>,
    /// Columns of the camera's free parameters.
    pub(super) camera: Vec<Column>,
}

impl StarImages {
    /// Of a bundle solution.
    pub(super) fn new(joint: &BundleSolution) -> Self {
        let images = joint.images();
        let frames = joint.frames();
        let places: BTreeMap<usize, usize> = frames.iter().enumerate().map(|(place, (frame, _))| (*frame, place)).collect();
        let place: Vec<usize> = images.iter().map(|image| places.get(&image.frame).copied().unwrap_or(0)).collect();
        let mut numbers: BTreeMap<[u64; 3], usize> = BTreeMap::new();
        let star = images
            .iter()
            .map(|image| {
                let next = numbers.len();
                *numbers.entry(image.star_direction.map(f64::to_bits)).or_insert(next)
            })
            .collect();
        let sky_axes = images.iter().zip(&place).map(|(image, place)| sky_axes(joint, image, *place)).collect();
        let residual_px = images.iter().flat_map(|image| image.residual_px).collect();
        let column = |k: usize| images.iter().map(|image| [image.own[0][k], image.own[1][k]]).collect::<Column>();
        let mut own: Vec<Column> = (0..joint.own_count()).map(column).collect();
        let mut camera = joint.solved_columns();
        if own.is_empty() {
            // One attitude for all frames: it is shared as the camera is.
            camera.extend((0..3).map(column));
        }
        own.extend(hour_angle_column(joint));
        own.shrink_to_fit();
        Self { images, place, star, sky_axes, frames, residual_px, own, camera }
    }

    /// What is known of a star image: of its star, its exposure, itself.
    pub(super) fn context(&self, k: usize, points: &ControlPoints) -> Context {
        let point = &points.points[self.images[k].point];
        Context::new(point.star, self.frames[self.place[k]].1).with_image(point.image)
    }

    /// Where the star images are predicted; where they are measured if that is farther off than the reach. What is held against residuals
    /// must not hold their errors.
    pub(super) fn predicted_px(&self, reach_px: f64) -> impl Iterator<Item = [f64; 2]> + use<'_> {
        self.images.iter().map(move |image| {
            let ([x, y], [dx, dy]) = (image.measured_px, image.residual_px);
            if dx.hypot(dy) < reach_px { [x - dx, y - dy] } else { [x, y] }
        })
    }
}

/// Where a star moves on its frame if it stands farther east, and north, px per rad: as through a pinhole.
fn sky_axes(joint: &BundleSolution, image: &BundleImage, place: usize) -> [[f64; 2]; 2] {
    let Some(attitude) = joint.attitude(place) else { return [[0.0; 2]; 2] };
    let focal_px = joint.model().camera().focal_length_px;
    let direction = Vector3::from(image.star_direction);
    let east = Vector3::new(-direction.y, direction.x, 0.0).try_normalize(1e-9).unwrap_or_else(Vector3::x);
    let at = attitude.camera_from_icrs * direction;
    [east, direction.cross(&east)].map(|along| {
        let moved = attitude.camera_from_icrs * along;
        [0, 1].map(|axis| focal_px * (moved[axis] / at.z - at[axis] * moved.z / (at.z * at.z)))
    })
}

/// The column of a frame's own hour angle at a solution that has such a refraction: how its star images move as its zenith goes east.
fn hour_angle_column(joint: &BundleSolution) -> Option<Column> {
    let (_, parameters) = joint.model().terms().find(|(id, _)| *id == ids::REFRACTION)?;
    let frames = joint.frames();
    let untimed = |(_, observation): &(usize, Observation)| observation.zenith_is_guessed && observation.earth_from_icrs.is_none();
    (frames.len() > 1 && parameters.first().is_some_and(|size| *size != 0.0) && frames.iter().all(untimed)).then_some(())?;
    joint.columns_of(ids::REFRACTION, parameters, &[1])?.into_iter().next()
}

//! Input of the tests, in px: star images at the baseline solution, the design columns of every hypothesis, the covariates.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::Vector3;

use super::covariates::{Covariate, covariates};
use super::hypotheses::{Hypothesis, hypotheses};
use super::linear_system::{Whitened, WhitenedSystem};
use super::noise::{NoiseModel, whitened};
use super::rendered_columns::Rendered;
use super::untimed;
use super::{DiagnoseOptions, Telemetry};
use crate::calibrate::{BundleImage, BundleSolution, Column};
use crate::effects::{Context, Observation};
use crate::identify::ControlPoints;

/// A star that is measured farther from where it is predicted may be another one.
pub(super) const REACH_PX: f64 = 100.0;
/// One that is measured farther from there tells nothing of what happens within a pixel.
pub(super) const WITHIN_REACH_PX: f64 = 1.0;

/// Everything about the star images at one point of linearisation.
#[derive(Clone, Debug)]
pub(super) struct Evidence {
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
    /// The hypotheses.
    pub(super) hypotheses: Vec<Hypothesis>,
    /// Columns that were rendered.
    pub(super) rendered: Arc<Rendered>,
    /// The covariates; they stay the same however often the search among hypotheses is made finer.
    pub(super) covariates: Arc<Vec<Covariate>>,
    /// Variance factors of the frames.
    pub(super) frame_factors: Vec<f64>,
    whiteners: Whiteners,
}

/// What whitens the images under a noise: every column asks for it.
type Whitener = Arc<Vec<[f64; 3]>>;

/// The whiteners of the noises last asked for.
#[derive(Debug, Default)]
struct Whiteners(Mutex<Vec<(NoiseModel, Whitener)>>);

impl Clone for Whiteners {
    fn clone(&self) -> Self {
        Self(Mutex::new(self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()))
    }
}

impl Whiteners {
    const KEPT: usize = 4;

    fn of(&self, noise: &NoiseModel, make: impl FnOnce() -> Vec<[f64; 3]>) -> Whitener {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, whitener)) = kept.iter().find(|(known, _)| known == noise) {
            return whitener.clone();
        }
        let whitener = Arc::new(make());
        if kept.len() == Self::KEPT {
            kept.remove(0);
        }
        kept.push((noise.clone(), whitener.clone()));
        whitener
    }
}

impl Evidence {
    /// At a joint solution.
    pub(super) fn at(
        joint: &BundleSolution,
        points: &ControlPoints,
        telemetry: &Telemetry,
        options: &DiagnoseOptions,
        rendered: Arc<Rendered>,
    ) -> Self {
        let mut evidence = Self::without_hypotheses(joint);
        evidence.frame_factors = super::noise::frame_factors(&evidence, joint.floor_px2());
        evidence.hypotheses = hypotheses(joint, &evidence, points, options, &rendered);
        evidence.rendered = rendered;
        evidence.covariates = Arc::new(covariates(joint, &evidence, points, telemetry));
        evidence
    }

    /// Star images and camera alone.
    pub(super) fn without_hypotheses(joint: &BundleSolution) -> Self {
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
        own.extend(untimed::own_column(joint));
        own.shrink_to_fit();
        Self {
            place,
            star,
            sky_axes,
            frames,
            residual_px,
            own,
            camera,
            hypotheses: Vec::new(),
            rendered: Arc::default(),
            covariates: Arc::default(),
            frame_factors: joint.frame_factors().to_vec(),
            images,
            whiteners: Whiteners::default(),
        }
    }

    /// Whitened.
    pub(super) fn sheet(&self, noise: &NoiseModel) -> WhitenedSystem {
        let white = |column: &Column| self.white(noise, column);
        let residual: Column = self.residual_px.chunks_exact(2).map(|pair| [pair[0], pair[1]]).collect();
        WhitenedSystem {
            frame: self.place.clone(),
            frames: self.frames.len(),
            residual: white(&residual),
            own: self.own.iter().map(white).collect(),
            camera: self.camera.iter().map(white).collect(),
            tail_degrees: noise.tail_degrees,
        }
    }

    /// A column whitened.
    pub(super) fn white(&self, noise: &NoiseModel, column: &Column) -> Whitened {
        let whitener = self.whiteners.of(noise, || noise.whiteners(&self.images, &self.place));
        whitened(&whitener, column)
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

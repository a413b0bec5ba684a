//! Input of the tests, in px: star images at the baseline solution, the design columns of every hypothesis, the covariates.

use std::ops::Deref;
use std::sync::{Arc, Mutex, PoisonError};

use super::covariates::{Covariate, covariates};
use super::hypotheses::{Hypothesis, hypotheses};
use super::linear_system::{Whitened, WhitenedSystem};
use super::noise::{self, NoiseModel, whitened};
use super::options::{DiagnoseOptions, Telemetry};
use super::rendered_columns::Rendered;
use super::star_images::StarImages;
use crate::calibrate::{BundleSolution, Column};
use crate::identify::ControlPoints;

/// Everything about the star images at one point of linearisation.
#[derive(Clone, Debug)]
pub(super) struct Evidence {
    /// The star images, with the columns of attitudes and camera.
    pub(super) stars: StarImages,
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
        let stars = StarImages::new(joint);
        let frame_factors = noise::frame_factors(&stars, joint.frame_factors(), joint.floor_px2());
        let hypotheses = hypotheses(joint, &stars, points, options, &rendered);
        let covariates = Arc::new(covariates(joint, &stars, points, telemetry));
        Self { stars, hypotheses, rendered, covariates, frame_factors, whiteners: Whiteners::default() }
    }

    /// Star images that are asked nothing: to fit attitudes and camera alone.
    pub(super) fn of_stars(stars: StarImages, frame_factors: Vec<f64>) -> Self {
        let (hypotheses, rendered, covariates) = (Vec::new(), Arc::default(), Arc::default());
        Self { stars, hypotheses, rendered, covariates, frame_factors, whiteners: Whiteners::default() }
    }

    /// Whitened.
    pub(super) fn system(&self, noise: &NoiseModel) -> WhitenedSystem {
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
}

impl Deref for Evidence {
    type Target = StarImages;

    fn deref(&self) -> &StarImages {
        &self.stars
    }
}

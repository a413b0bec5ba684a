//! Classification of a frame's star images by their χ²: round, elliptic, or trailed.

use super::fit::{Fit, Freedom};
use super::image_model::{Model, Shape};
use super::shape::{self, Typical};
use super::stamp::Scene;
use super::trail::Trail;
use super::work::SEARCHED;
use crate::statistics::median;

/// What one star may say for one kind, in σ²: one odd star (a double, a galaxy) decides nothing.
const MAX_OF_ONE: f64 = 9.0;
/// A kind is taken if the stars together say so much for it, in units of what chance makes of as many stars.
const CLEARLY: f64 = 5.0;
const MIN_STARS: usize = 3;
/// Trails shorter than this, in widths of their Gaussian, are ellipses to all but a hundredth of their shape.
const SHORTEST: f64 = 1.0;

/// Stars fitted with images of one kind.
pub(super) struct ShapeStatistics {
    /// One for each star; nothing where no such image could be fitted.
    pub(super) fits: Vec<Option<Fit>>,
    pub(super) typical: Typical,
}

/// Fits stars as they start.
pub(super) fn fits(scene: &Scene<'_>, starts: &[Model], freedom: Freedom) -> Vec<Option<Fit>> {
    let each = |start: &Model| scene.fit(*start, freedom, &[]);
    scene.work.each(starts, SEARCHED, each).into_iter().map(Option::flatten).collect()
}

impl ShapeStatistics {
    /// Fits stars with images that start from this shape. `None` where fewer than `fewest` can be.
    pub(super) fn of(scene: &Scene<'_>, starts: &[Model], shape: Shape, fewest: usize, good: impl Fn(&Fit) -> bool) -> Option<Self> {
        let freedom = if shape.is_round() { Freedom::Width } else { Freedom::Ellipse };
        let starts: Vec<Model> = starts.iter().map(|start| Model { shape, ..*start }).collect();
        let fits = fits(scene, &starts, freedom);
        let shapes: Vec<Shape> = fits.iter().flatten().filter(|f| good(f)).map(|f| f.model.shape).collect();
        let mut typical = shape::middle(&shapes).filter(|t| t.stars >= fewest)?;
        if let Some(elongated) = typical.elongated.filter(|_| freedom == Freedom::Ellipse) {
            typical.shape = elongated;
        }
        Some(Self { fits, typical })
    }

    /// χ² over its degrees of freedom of the star in the middle.
    pub(super) fn misfit(&self) -> f64 {
        median(&self.fits.iter().flatten().map(|f| f.chi2 / f.dof as f64).collect::<Vec<_>>()).unwrap_or(0.0)
    }
}

/// What stars say for the kind that the first fits are of rather than that of the others, in units of what chance makes of as many stars.
fn said_for(fits: &[Option<Fit>], others: &[Option<Fit>]) -> f64 {
    let for_first = |(first, other): (&Option<Fit>, &Option<Fit>)| {
        let (first, other) = (first.as_ref()?, other.as_ref()?);
        let of = |f: &Fit| f.chi2 / f.dof as f64;
        // where neither is the image, chance is what the better leaves
        Some(((of(other) - of(first)) * first.dof as f64 / of(first).max(1.0)).clamp(-MAX_OF_ONE, MAX_OF_ONE))
    };
    let said: Vec<f64> = fits.iter().zip(others).filter_map(for_first).collect();
    if said.len() < MIN_STARS { 0.0 } else { said.iter().sum::<f64>() / (said.len() as f64).sqrt() }
}

/// Whether stars clearly say that their images are of the kind that the first fits are of rather than that of the others.
pub(super) fn is_better(fits: &[Option<Fit>], others: &[Option<Fit>]) -> bool {
    said_for(fits, others) > CLEARLY
}

/// Whether they rather say so.
pub(super) fn is_likelier(fits: &[Option<Fit>], others: &[Option<Fit>]) -> bool {
    said_for(fits, others) > 0.0
}

/// The stars fitted with the kind that they are. `told`: the fits so far; `elongated`: what moments say where they are not round.
pub(super) fn decided(
    scene: &Scene<'_>,
    starts: &[Model],
    told: ShapeStatistics,
    elongated: Option<Shape>,
    good: impl Fn(&Fit) -> bool,
) -> ShapeStatistics {
    let fewest = (told.typical.stars / 2).max(MIN_STARS);
    let told_shape = told.typical.shape;
    let Some(first) = (if told_shape.is_round() { elongated } else { Some(told_shape) }) else { return told };
    let mut best = told;
    let trial = |shape: Shape, best: ShapeStatistics| match ShapeStatistics::of(scene, starts, shape, fewest, &good) {
        Some(trial) if is_better(&trial.fits, &best.fits) => trial,
        _ => best,
    };
    if told_shape.is_round() || first.trail {
        best = trial(Shape { trail: false, ..first }, best);
    }
    let trail = Trail::of(best.typical.elongated.unwrap_or(first));
    if !first.trail && trail.length_px() > SHORTEST * trail.sigma_px {
        best = trial(trail.shape(), best);
    }
    best
}

//! Where stars may be: the matched filter, run with first guesses of the image and then with that of the frame's own stars.

use rayon::prelude::*;

use super::DetectOptions;
use super::candidates::{Blob, Candidate, candidates};
use super::filter::{self, Kernel, Peak};
use super::fit::{Fit, Freedom, Scene};
use super::measure::SNR_FOR_WIDTH;
use super::psf::Shape;
use super::shape;
use super::tail::Tail;

/// First guesses of the width before the frame's own stars tell: usual optics, then defocused or trailed ones.
pub(super) const FIRST_SIGMA_PX: f64 = 1.2;
const WIDE_SIGMA_PX: f64 = 3.5;
/// Fits narrower than this along the short axis are lone pixels or cosmic rays where the frame's own stars do not tell, px.
pub(super) const SHARPEST_PX: f64 = 0.45;
/// Peaks that are fitted, at most.
const MOST_PEAKS: usize = 20_000;

/// What the matched filter found.
#[derive(Clone)]
pub(super) struct Search {
    pub(super) shape: Shape,
    /// Whether the frame's stars, or the caller, told the shape.
    pub(super) shape_known: bool,
    /// Scatter of the filtered noise over that of white noise; 1 unless clearly more.
    pub(super) scatter: f64,
    /// Signal-to-noise ratio from which on peaks count.
    pub(super) threshold: f64,
    pub(super) peaks: Vec<Peak>,
    pub(super) kernel: Kernel,
    /// Pixels that the light of clear stars reaches.
    pub(super) lit: Vec<bool>,
}

impl Search {
    pub(super) fn at_shape(shape: Shape, shape_known: bool, normalised: &[f32], width: usize, false_alarms: f64) -> Self {
        /// Around maxima this much above the threshold for normal noise there is starlight.
        const STARLIGHT: f64 = 1.3;
        /// Where estimates of the noise differ by less than this from the normal case, it is by chance.
        const CHANCE: f64 = 1.02;
        /// From here on errors are stated larger; less comes by chance.
        const CLEARLY: f64 = 1.05;
        let kernel = Kernel::new(shape);
        let filtered = kernel.apply(normalised, width);
        let normal = kernel.threshold(normalised.len(), false_alarms);
        let stars = filter::peaks(&filtered, width, STARLIGHT * normal * filter::scatter(&filtered, &[]).max(1.0));
        let lit = kernel.lit(&stars, &filtered, width);
        let correlated = filter::scatter(&filtered, &lit);
        let step = (normalised.len() / 60_000).max(1) | 1;
        let dark = normalised.iter().zip(&lit).step_by(step).filter(|(_, lit)| !**lit).map(|(n, _)| *n);
        let (independent, scatter) = Tail::of(dark).map_or((normal, 1.0), |t| (t.equivalent(&kernel.weights(), normal), t.scatter()));
        let beyond = |ratio: f64| if ratio > CHANCE { ratio } else { 1.0 };
        let threshold = normal * beyond(independent / normal) * beyond(correlated / scatter.max(1.0));
        let scatter = Some(kernel.scatter_of_correlated(normalised, &lit, width)).filter(|s| *s > CLEARLY).unwrap_or(1.0);
        let mut peaks = filter::peaks(&filtered, width, threshold);
        peaks.truncate(MOST_PEAKS);
        Self { shape, shape_known, scatter, threshold, peaks, kernel, lit }
    }
}

/// Runs the filter with first guesses of the shape, learns the shape from the bright stars found, and runs it again.
pub(super) fn search(
    scene: &Scene<'_>,
    options: &DetectOptions,
    mut first: Search,
    residual: &[f32],
    normalised: &[f32],
    blobs: &[Blob],
) -> Search {
    let width = scene.frame.width_px;
    let at_shape = |shape, known| Search::at_shape(shape, known, normalised, width, options.false_alarms_per_frame);
    if let Some(sigma) = options.psf_sigma_px {
        return at_shape(Shape::round(sigma), true);
    }
    let mut typical = shape::typical(residual, width, scene.masked, &first.peaks);
    if typical.as_ref().is_none_or(|t| t.stars < 5) {
        let wide = at_shape(Shape::round(WIDE_SIGMA_PX), false);
        let other = shape::typical(residual, width, scene.masked, &wide.peaks);
        // glow and nebulae are wide too, but no two alike
        if other.as_ref().is_some_and(|o| o.stars >= 5 && o.spread < 0.25 && o.stars > typical.as_ref().map_or(0, |t| t.stars)) {
            (typical, first) = (other, wide);
        }
    }
    let guess = typical.as_ref().map_or(first.shape, |t| t.shape);
    let Some(shape) = shape_by_fits(scene, &Search { shape: guess, ..first.clone() }, blobs).or(typical.map(|t| t.shape)) else {
        return at_shape(first.shape, false);
    };
    at_shape(shape, true)
}

/// The middle of free-shape fits to bright stars: moments of images of a pixel's width are not those of the light before the
/// pixels summed it. `None` where too few stars tell, or they disagree.
fn shape_by_fits(scene: &Scene<'_>, search: &Search, blobs: &[Blob]) -> Option<Shape> {
    const MOST_STARS: usize = 48;
    const FEWEST_BRIGHT: usize = 3;
    const FEWEST_FAINT: usize = 8;
    const LARGEST_SPREAD: f64 = 0.3;
    let candidates = candidates(scene.frame, scene.background, search, blobs);
    let freedom = if search.shape.is_round() { Freedom::Width } else { Freedom::Ellipse };
    let good = |f: &Fit| f.lone_pixel_excess > 0.0 && f.model.shape.axes_px().1 > SHARPEST_PX && !f.edge;
    let told = |chosen: Vec<&Candidate>, fewest: usize| {
        let fits: Vec<Option<Fit>> = chosen.par_iter().map(|c| scene.fit(c.start, freedom, &[])).collect();
        let shapes: Vec<Shape> = fits.into_iter().flatten().filter(good).map(|f| f.model.shape).collect();
        shape::middle(&shapes).filter(|t| t.stars >= fewest)
    };
    let clear = |c: &&Candidate| c.full_radius_px == 0.0;
    let bright = candidates.iter().filter(clear).filter(|c| c.snr > SNR_FOR_WIDTH).take(MOST_STARS).collect();
    let typical = told(bright, FEWEST_BRIGHT).or_else(|| {
        let faint = candidates.iter().filter(clear).take(4 * MOST_STARS).collect();
        told(faint, FEWEST_FAINT).filter(|t| t.spread < LARGEST_SPREAD)
    })?;
    // whether it is round was found on more stars
    Some(if search.shape.is_round() { Shape::round(typical.shape.sigma_px()) } else { typical.shape })
}

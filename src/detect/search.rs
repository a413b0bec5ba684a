//! Search for stars: the matched filter, run with first guesses of the image and then with that of the frame's own stars.

use super::DetectOptions;
use super::candidates::{Blob, Candidate, candidates};
use super::field::Field;
use super::filter::{self, Kernel, Peak};
use super::fit::{Fit, Freedom, Model, Scene};
use super::measure::SNR_FOR_WIDTH;
use super::noise_tail::Tail;
use super::psf::Shape;
use super::psf_class::{self, ShapeStatistics};
use super::shape;
use super::trail::Trail;
use super::work::{SEARCHED, Work};
use crate::frame::Frame;
use crate::statistics::crowding::crowding;
use crate::statistics::median_in_place;

/// First guesses of the width before the frame's own stars tell: usual optics, then defocused or trailed ones.
pub(super) const FIRST_SIGMA_PX: f64 = 1.2;
const WIDE_SIGMA_PX: f64 = 3.5;
/// Stars that fit worse than this per degree of freedom may be trails that lie each its own way, as a roll of the camera makes them.
const MISFIT: f64 = 1.06;
/// Where peaks are drawn out to so many times what single ones show, they are pieces.
const LONGER: f64 = 1.5;
/// Fits narrower than this along the short axis are lone pixels or cosmic rays where the frame's own stars do not tell, px.
pub(super) const SHARPEST_PX: f64 = 0.45;
/// Peaks that are fitted, at most.
const MAX_PEAKS: usize = 20_000;

/// Input of the matched filter.
#[derive(Clone, Copy)]
pub(super) struct Ground<'a> {
    /// Counts less the background in units of the noise.
    pub(super) normalised: &'a [f32],
    pub(super) width: usize,
    /// Whether black is cut off above the level of the sky.
    pub(super) is_cut: bool,
    /// Whether what is left of it comes in the blocks of a compressed picture.
    pub(super) is_in_blocks: bool,
    pub(super) options: &'a DetectOptions,
    pub(super) work: &'a Work,
}

/// What the matched filter found.
#[derive(Clone)]
pub(super) struct Search {
    pub(super) shape: Shape,
    /// Trails that the frame's stars tell together.
    pub(super) field: Option<Field>,
    /// Whether the shape comes from the frame's stars or the caller.
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
    pub(super) fn at_shape(shape: Shape, shape_known: bool, ground: &Ground<'_>) -> Self {
        /// Around maxima this much above the threshold for normal noise there is starlight.
        const STARLIGHT: f64 = 1.3;
        /// Where estimates of the noise differ by less than this from the normal case, it is by chance.
        const CHANCE: f64 = 1.02;
        /// From here on errors are stated larger; less comes by chance.
        const CLEARLY: f64 = 1.05;
        /// Where black is cut off, sums of what is left may scatter so much less than the noise that it was.
        const MIN_OF_CUT: f64 = 0.2;
        let Ground { normalised, width, is_cut, is_in_blocks, options, work } = *ground;
        let kernel = Kernel::new(shape);
        work.spend(kernel.cost_ns(normalised.len()));
        let filtered = kernel.apply(normalised, width);
        let normal = kernel.threshold(normalised.len(), options.false_alarms_per_frame);
        // what is left of cut noise are lone pixels rather than a smooth field: there are no more maxima than pixels
        let normal = if is_cut { normal.min(filter::exceeded_in(normalised.len(), options.false_alarms_per_frame)) } else { normal };
        let stars = filter::peaks(&filtered, width, STARLIGHT * normal * filter::scatter(&filtered, &[]).max(1.0));
        let lit = kernel.lit(&stars, &filtered, width);
        let correlated = filter::scatter(&filtered, &lit);
        let step = (normalised.len() / 60_000).max(1) | 1;
        let tail = if is_cut {
            tail_of_cut(normalised, &lit, width)
        } else {
            Tail::of(normalised.iter().zip(&lit).step_by(step).filter(|(_, lit)| !**lit).map(|(n, _)| *n))
        };
        let (independent, scatter) = tail.map_or((normal, 1.0), |t| (t.equivalent(&kernel.weights(), normal), t.scatter()));
        let beyond = |ratio: f64| if ratio > CHANCE { ratio } else { 1.0 };
        let of_tail = if is_cut { (independent / normal).max(MIN_OF_CUT) } else { beyond(independent / normal) };
        let white = if is_cut { scatter.max(MIN_OF_CUT) } else { scatter.max(1.0) };
        let scatter = Some(kernel.scatter_of_correlated(normalised, &lit, width)).filter(|s| *s > CLEARLY).unwrap_or(1.0);
        // Noise in blocks leaves lone pixels darker than the rest of it: the tail of these is not all. Elsewhere what goes together are faint stars.
        let of_tail = if is_in_blocks { of_tail * scatter } else { of_tail };
        let threshold = options.detection_threshold.unwrap_or(normal * of_tail * beyond(correlated / white));
        let mut peaks = filter::peaks(&filtered, width, threshold);
        peaks.truncate(MAX_PEAKS);
        Self { shape, field: None, shape_known, scatter, threshold, peaks, kernel, lit }
    }
}

/// The tail of noise whose black is cut off: of pixels whose neighbours are no brighter than most, since starlight too faint to be known would be
/// taken for it, and hardly a pixel left out.
fn tail_of_cut(normalised: &[f32], lit: &[bool], width: usize) -> Option<Tail> {
    const SAMPLE: usize = 400_000;
    const OUTLYING: f64 = 5e-5;
    let inner = (width + 1..normalised.len().saturating_sub(width + 1)).step_by((normalised.len() / SAMPLE).max(1) | 1);
    let around = |i: usize| {
        let row = |i: usize| normalised[i - 1] + normalised[i] + normalised[i + 1];
        row(i - width) + row(i) + row(i + width) - normalised[i]
    };
    let all: Vec<(f32, f32)> = inner.filter(|i| !lit[*i]).map(|i| (normalised[i], around(i))).collect();
    let most = median_in_place(&mut all.iter().map(|(_, around)| f64::from(*around)).collect::<Vec<_>>())?;
    Tail::without(all.iter().filter(|(_, around)| f64::from(*around) <= most + 1e-3).map(|(own, _)| *own), OUTLYING)
}

impl Search {
    /// The shape of a star at a place.
    pub(super) fn shape_at(&self, x: f64, y: f64) -> Shape {
        self.field.map_or(self.shape, |field| field.at(x, y).shape())
    }
}

/// Runs the filter with first guesses of the shape, learns the shape from the bright stars found, and runs it again.
pub(super) fn search(
    scene: &Scene<'_>,
    options: &DetectOptions,
    mut first: Search,
    residual: &[f32],
    ground: &Ground<'_>,
    blobs: &[Blob],
) -> Search {
    let Ground { normalised, width, .. } = *ground;
    let at_shape = |shape, known| Search::at_shape(shape, known, ground);
    if let Some(sigma) = options.psf_sigma_px {
        return at_shape(Shape::round(sigma), true);
    }
    let typical_of = |peaks: &[Peak]| {
        let place = |peak: &Peak| [peak.x as f64, peak.y as f64];
        shape::typical(residual, width, scene.masked, &apart(peaks, place, scene.frame))
    };
    let mut typical = typical_of(&first.peaks);
    if typical.as_ref().is_none_or(|t| t.stars < 5) {
        let wide = at_shape(Shape::round(WIDE_SIGMA_PX), false);
        let other = typical_of(&wide.peaks);
        // glow and nebulae are wide too, but no two alike
        if other.as_ref().is_some_and(|o| o.stars >= 5 && o.spread < 0.25 && o.stars > typical.as_ref().map_or(0, |t| t.stars)) {
            (typical, first) = (other, wide);
        }
    }
    let seen_px = typical.as_ref().map_or(0.0, |t| Trail::of(t.shape).length_px());
    if let Some(trail) =
        shape::drawn_out(normalised, width, &first.peaks).filter(|t| t.length_px() > LONGER * seen_px && !ground.work.is_spent(SEARCHED))
        && let Some(found) = search_for_trails(scene, &first, trail, &at_shape, blobs)
    {
        return found;
    }
    let elongated = typical.as_ref().and_then(|t| t.elongated);
    let guess = typical.as_ref().map_or(first.shape, |t| t.shape);
    let told = shape_by_fits(scene, &Search { shape: guess, ..first.clone() }, blobs, elongated);
    let misfit = told.as_ref().map_or(f64::INFINITY, ShapeStatistics::misfit);
    let Some(shape) = told.map(|t| t.typical.shape).or(typical.map(|t| t.shape)) else {
        return at_shape(first.shape, false);
    };
    let found = at_shape(shape, true);
    // where the gain is not known yet photons' noise looks like misfit
    if !shape.trail && scene.variance_per_dn > 0.0 && misfit > MISFIT {
        return turning(scene, found, blobs);
    }
    refined(scene, found, blobs)
}

/// Those of some things, brightest first, that tell what stars are like: where the brightest stand together, those in other parts of the frame.
pub(super) fn apart<T: Copy>(some: &[T], place: impl Fn(&T) -> [f64; 2], frame: &Frame) -> Vec<T> {
    /// Fewer tell nothing, and all are asked.
    const MIN_STARS: usize = 8;
    let at_px: Vec<[f64; 2]> = some.iter().map(place).collect();
    let Some(standing) = crowding(&at_px, [frame.width_px as f64, frame.height_px as f64]) else { return some.to_vec() };
    let left: Vec<T> = some.iter().zip(&standing).filter(|(_, own)| !own.is_crowded).map(|(one, _)| *one).collect();
    if left.len() < MIN_STARS { some.to_vec() } else { left }
}

/// The same of stars with their first guesses.
fn stars_apart(candidates: &[Candidate], frame: &Frame) -> Vec<Candidate> {
    apart(candidates, |candidate| [candidate.start.x, candidate.start.y], frame)
}

/// Faint trails, which the round filter sees in pieces. `None` where there are none.
fn search_for_trails(
    scene: &Scene<'_>,
    first: &Search,
    guess: Trail,
    at_shape: &impl Fn(Shape, bool) -> Search,
    blobs: &[Blob],
) -> Option<Search> {
    let light = |s: &Search| s.peaks.iter().map(|p| p.snr * p.snr).sum::<f64>();
    let shape = shape_by_fits(scene, &at_shape(guess.shape(), false), blobs, None)?.typical.shape;
    let search = refined(scene, at_shape(shape, true), blobs);
    // one whole trail says more than its pieces
    (light(&search) > light(first)).then_some(search)
}

/// The middle of free-shape fits to bright stars: moments of images of a pixel's width are not those of the light before the
/// pixels summed it. `None` where too few stars tell, or they disagree. `elongated`: what moments say where they are not round.
fn shape_by_fits(scene: &Scene<'_>, search: &Search, blobs: &[Blob], elongated: Option<Shape>) -> Option<ShapeStatistics> {
    const MAX_STARS: usize = 48;
    const MIN_BRIGHT: usize = 3;
    const MIN_FAINT: usize = 8;
    const LARGEST_SPREAD: f64 = 0.3;
    let candidates = stars_apart(&candidates(scene.frame, scene.background, search, blobs), scene.frame);
    let good = |f: &Fit| f.lone_pixel_excess > 0.0 && f.model.shape.axes_px().1 > SHARPEST_PX && !f.edge;
    let told = |starts: &[Model], fewest: usize| ShapeStatistics::of(scene, starts, search.shape, fewest, good);
    let clear = || candidates.iter().filter(|c| c.full_radius_px == 0.0);
    let bright: Vec<Model> = clear().filter(|c| c.snr > SNR_FOR_WIDTH).take(MAX_STARS).map(|c| c.start).collect();
    if let Some(told) = told(&bright, MIN_BRIGHT) {
        return Some(psf_class::decided(scene, &bright, told, elongated, good));
    }
    let faint: Vec<Model> = clear().take(4 * MAX_STARS).map(|c| c.start).collect();
    let told = told(&faint, MIN_FAINT).filter(|t| t.typical.spread < LARGEST_SPREAD)?;
    Some(psf_class::decided(scene, &faint, told, elongated, good))
}

/// Trails with the field that all of them together tell. Only the filter that finds whole trails chooses stars to ask without preferring those that
/// noise makes short.
fn refined(scene: &Scene<'_>, found: Search, blobs: &[Blob]) -> Search {
    if !found.shape.trail {
        return found;
    }
    let (starts, _) = asked(scene, &found, blobs);
    let field = Field::of(scene, &starts, Trail::of(found.shape));
    Search { field, ..found }
}

/// The same where a roll of the camera makes trails that lie each its own way, if that fits the stars clearly better.
fn turning(scene: &Scene<'_>, found: Search, blobs: &[Blob]) -> Search {
    const MIN_STARS: usize = 12;
    /// So many first say whether it is worth a closer look.
    const SAMPLE: usize = 24;
    let (starts, bright) = asked(scene, &found, blobs);
    let sample: Vec<Model> = starts.iter().step_by((starts.len() / SAMPLE).max(1)).copied().collect();
    let free = |shape: Shape| if shape.is_round() { Freedom::Width } else { Freedom::Ellipse };
    let round = psf_class::fits(
        scene,
        &sample.iter().map(|s| Model { shape: Shape::round(s.shape.sigma_px()), ..*s }).collect::<Vec<_>>(),
        Freedom::Width,
    );
    if starts.len() < MIN_STARS || !psf_class::is_better(&psf_class::fits(scene, &sample, Freedom::Ellipse), &round) {
        return found;
    }
    let ellipses = psf_class::fits(scene, &starts, Freedom::Ellipse);
    let trails: Vec<([f64; 2], Trail)> = ellipses.iter().flatten().map(|f| ([f.model.x, f.model.y], Trail::of(f.model.shape))).collect();
    let Some(field) = Field::turning(scene, &starts, &trails) else { return found };
    let turned: Vec<Model> = starts.iter().map(|start| Model { shape: field.at(start.x, start.y).shape(), ..*start }).collect();
    // faint stars are fitted with the shape that they are given
    let freedom = |shape: Shape| if bright { free(shape) } else { Freedom::Fixed };
    let trails = psf_class::fits(scene, &turned, freedom(Shape { trail: true, ..found.shape }));
    let as_found = psf_class::fits(scene, &starts, freedom(found.shape));
    let of_trails = psf_class::is_better(&trails, &as_found) && (!bright || psf_class::is_likelier(&trails, &ellipses));
    if of_trails { Search { field: Some(field), ..found } } else { found }
}

/// Stars to ask for their shapes, and whether they are bright enough to tell their own.
fn asked(scene: &Scene<'_>, found: &Search, blobs: &[Blob]) -> (Vec<Model>, bool) {
    const MAX_FAINT: usize = 400;
    const ENOUGH_BRIGHT: usize = 100;
    let candidates = stars_apart(&candidates(scene.frame, scene.background, found, blobs), scene.frame);
    let bright = candidates.iter().filter(|c| c.snr > SNR_FOR_WIDTH).count() >= ENOUGH_BRIGHT;
    let most = if bright { ENOUGH_BRIGHT } else { MAX_FAINT };
    (candidates.iter().filter(|c| c.full_radius_px == 0.0).take(most).map(|c| c.start).collect(), bright)
}

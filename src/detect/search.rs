//! Search for stars: the matched filter, run with first guesses of the image and then with that of the frame's own stars.

use super::DetectOptions;
use super::candidates::{Blob, Candidate, candidates};
use super::field::Field;
use super::filter::Peak;
use super::filter_run::{Ground, Search};
use super::fit::{Fit, Freedom, SNR_FOR_WIDTH};
use super::image_model::{Model, Shape};
use super::psf_class::{self, ShapeStatistics};
use super::shape;
use super::stamp::Scene;
use super::trail::Trail;
use super::work::SEARCHED;
use crate::frame::Frame;
use crate::statistics::crowding::crowding;

/// First guesses of the width before the frame's own stars tell: usual optics, then defocused or trailed ones.
pub(super) const FIRST_SIGMA_PX: f64 = 1.2;
const WIDE_SIGMA_PX: f64 = 3.5;
/// Stars that fit worse than this per degree of freedom may be trails that lie each its own way, as a roll of the camera makes them.
const MISFIT: f64 = 1.06;
/// Where peaks are drawn out to so many times what single ones show, they are pieces.
const LONGER: f64 = 1.5;
/// Fits narrower than this along the short axis are lone pixels or cosmic rays where the frame's own stars do not tell, px.
pub(super) const SHARPEST_PX: f64 = 0.45;
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

//! The stages put together: from one frame to its list of stars.

use rayon::prelude::*;

use super::background::Background;
use super::defects;
use super::filter::{self, Kernel, Peak};
use super::fit::{Fit, Freedom, Model, Scene, radius_px};
use super::gain::{self, Sample};
use super::psf::Shape;
use super::shape;
use super::tail::Tail;
use super::{DetectError, DetectOptions, Detection, Detections, Flags};
use crate::frame::Frame;

/// Smallest side of a frame, px: a star's window.
const LEAST_SIDE_PX: usize = 9;
/// First guesses of the width before the frame's own stars tell: usual optics, then defocused or trailed ones.
const FIRST_SIGMA_PX: f64 = 1.2;
const WIDE_SIGMA_PX: f64 = 3.5;
/// Stars from this signal-to-noise ratio on have their own width fitted.
pub(super) const SNR_FOR_WIDTH: f64 = 30.0;
/// Fits narrower than this along the short axis are lone pixels or cosmic rays where the frame's own stars do not tell, px.
const SHARPEST_PX: f64 = 0.45;
/// Peaks that are fitted, at most.
const MOST_PEAKS: usize = 20_000;

/// A place to fit a star at.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    start: Model,
    snr: f64,
    /// Radius of the full pixels at its centre, 0 if there are none.
    full_radius_px: f64,
}

/// Finds and measures the stars of a frame, brightest first. The same frame gives the same result at any number of threads.
pub fn detect(frame: &Frame, options: &DetectOptions) -> Result<Detections, DetectError> {
    check(frame, options)?;
    let saturation_dn = defects::saturation_dn(frame);
    let full: Vec<bool> = frame.pixels_dn.iter().map(|&v| v >= saturation_dn).collect();
    let mut background = Background::measure(frame, &full);
    let (mut residual, mut normalised) = residuals(frame, &background);
    let hot = defects::hot_pixels(&normalised, frame.width_px);
    darken(&mut residual, &mut normalised, &hot);
    let masked: Vec<bool> = hot.iter().zip(&full).map(|(h, f)| *h || *f).collect();
    // a first look shows where stars are, so that their light can be kept out of background and noise
    let first_shape = Shape::round(options.psf_sigma_px.unwrap_or(FIRST_SIGMA_PX));
    let first = Search::at_shape(first_shape, false, &normalised, frame.width_px, options.false_alarms_per_frame);
    background.refine(frame, &masked, &first.lit);
    (residual, normalised) = residuals(frame, &background);
    darken(&mut residual, &mut normalised, &hot);
    let (background_dn, noise_dn) = background.typical();
    let mut found = Detections { width_px: frame.width_px, height_px: frame.height_px, background_dn, noise_dn, stars: Vec::new() };
    if full.iter().all(|f| *f) {
        return Ok(found);
    }

    let blobs = full_blobs(frame.width_px, &full, &hot);
    let variance_per_dn = options.gain_e_per_dn.map(|g| 1.0 / g);
    let noise_floor_dn = options.read_noise_e.zip(options.gain_e_per_dn).map_or(0.0, |(e, g)| e / g);
    let mut scene =
        Scene { frame, background: &background, masked: &masked, variance_per_dn: variance_per_dn.unwrap_or(0.0), noise_floor_dn };
    let search = search(&scene, options, first, &residual, &normalised, &blobs);
    let candidates = candidates(frame, &background, &search, &blobs);
    let freedom = |c: &Candidate| free_shape(options, &search, c);

    // each star alone, the guessed light of its neighbours taken off; then with the neighbours as fitted
    let guesses: Vec<Model> = candidates.iter().map(|c| c.start).collect();
    let neighbours = neighbours(&guesses);
    if variance_per_dn.is_none() {
        let sample = |(i, c): (usize, &Candidate)| Sample {
            start: c.start,
            snr: c.snr,
            freedom: freedom(c),
            neighbours: neighbours[i].iter().map(|&j| guesses[j]).collect(),
        };
        let samples: Vec<Sample> = candidates.iter().enumerate().filter(|(_, c)| c.full_radius_px == 0.0).map(sample).collect();
        scene.variance_per_dn = gain::variance_per_dn(&scene, &samples);
    }
    let mut fits = fit_all(&scene, &candidates, &guesses, &neighbours, &freedom, None);
    for _ in 0..2 {
        fits = fit_all(&scene, &candidates, &fitted(&guesses, &fits), &neighbours, &freedom, Some(&fits));
    }

    let mut stars: Vec<Detection> = Vec::with_capacity(candidates.len());
    for (i, (candidate, fit)) in candidates.iter().zip(&fits).enumerate() {
        let Some(fit) = fit.as_ref().filter(|f| is_star(candidate, f, &search, (scene.frame.width_px, scene.frame.height_px))) else {
            continue;
        };
        let duplicate = |s: &Detection| search.shape.radius_in_sigma(s.x_px - fit.model.x, s.y_px - fit.model.y) < 1.0;
        if !stars.iter().any(duplicate) {
            stars.push(detection(&scene, fit, candidate, !neighbours[i].is_empty(), search.scatter));
        }
    }
    stars.sort_by(|a, b| b.flux_dn.total_cmp(&a.flux_dn).then(a.y_px.total_cmp(&b.y_px)).then(a.x_px.total_cmp(&b.x_px)));
    stars.truncate(options.max_stars);
    found.stars = stars;
    Ok(found)
}

fn check(frame: &Frame, options: &DetectOptions) -> Result<(), DetectError> {
    let (width_px, height_px) = (frame.width_px, frame.height_px);
    if width_px.checked_mul(height_px) != Some(frame.pixels_dn.len()) {
        return Err(DetectError::SizeMismatch { width_px, height_px, found: frame.pixels_dn.len() });
    }
    if width_px < LEAST_SIDE_PX || height_px < LEAST_SIDE_PX {
        return Err(DetectError::TooSmall { width_px, height_px, least_px: LEAST_SIDE_PX });
    }
    if let Some(i) = frame.pixels_dn.iter().position(|v| !v.is_finite()) {
        return Err(DetectError::NotFinite { x: i % width_px, y: i / width_px, value: frame.pixels_dn[i] });
    }
    let positive = |name, value: Option<f64>, range, good: fn(f64) -> bool| match value {
        Some(value) if !good(value) => Err(DetectError::Option { name, value, range }),
        _ => Ok(()),
    };
    positive("false_alarms_per_frame", Some(options.false_alarms_per_frame), "above 0 and finite", |v| v > 0.0 && v.is_finite())?;
    positive("psf_sigma_px", options.psf_sigma_px, "between 0.3 and 12", |v| (0.3..=12.0).contains(&v))?;
    positive("gain_e_per_dn", options.gain_e_per_dn, "above 0 and finite", |v| v > 0.0 && v.is_finite())?;
    positive("read_noise_e", options.read_noise_e, "0 or above and finite", |v| v >= 0.0 && v.is_finite())
}

/// Takes hot pixels out.
fn darken(residual: &mut [f32], normalised: &mut [f32], hot: &[bool]) {
    for ((r, n), _) in residual.iter_mut().zip(normalised).zip(hot).filter(|(_, hot)| **hot) {
        (*r, *n) = (0.0, 0.0);
    }
}

/// Counts less the background, in DN and in units of the noise.
fn residuals(frame: &Frame, background: &Background) -> (Vec<f32>, Vec<f32>) {
    let width = frame.width_px;
    let mut residual = vec![0.0_f32; frame.pixels_dn.len()];
    let mut normalised = residual.clone();
    residual.par_chunks_mut(width).zip(normalised.par_chunks_mut(width)).enumerate().for_each(|(y, (r, n))| {
        background.subtract_row(frame, y, r);
        background.noise_row(y, n);
        for (n, r) in n.iter_mut().zip(r) {
            *n = *r / *n;
        }
    });
    (residual, normalised)
}

/// What the matched filter found.
#[derive(Clone)]
struct Search {
    shape: Shape,
    /// Whether the frame's stars, or the caller, told the shape.
    shape_known: bool,
    /// Scatter of the filtered noise over that of white noise; 1 unless clearly more.
    scatter: f64,
    /// Signal-to-noise ratio from which on peaks count.
    threshold: f64,
    peaks: Vec<Peak>,
    kernel: Kernel,
    /// Pixels that the light of clear stars reaches.
    lit: Vec<bool>,
}

impl Search {
    fn at_shape(shape: Shape, shape_known: bool, normalised: &[f32], width: usize, false_alarms: f64) -> Self {
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
fn search(scene: &Scene<'_>, options: &DetectOptions, mut first: Search, residual: &[f32], normalised: &[f32], blobs: &[Blob]) -> Search {
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

/// A group of touching full pixels.
struct Blob {
    x: f64,
    y: f64,
    radius_px: f64,
}

fn full_blobs(width: usize, full: &[bool], hot: &[bool]) -> Vec<Blob> {
    let height = full.len() / width;
    let mut seen = vec![false; full.len()];
    let mut blobs = Vec::new();
    for start in 0..full.len() {
        if !full[start] || hot[start] || seen[start] {
            continue;
        }
        seen[start] = true;
        let mut members = vec![start];
        let mut next = 0;
        while next < members.len() {
            let (x, y) = (members[next] % width, members[next] / width);
            next += 1;
            for ny in y.saturating_sub(1)..(y + 2).min(height) {
                for nx in x.saturating_sub(1)..(x + 2).min(width) {
                    let i = ny * width + nx;
                    if full[i] && !hot[i] && !seen[i] {
                        seen[i] = true;
                        members.push(i);
                    }
                }
            }
        }
        let count = members.len() as f64;
        let x = members.iter().map(|i| (i % width) as f64).sum::<f64>() / count;
        let y = members.iter().map(|i| (i / width) as f64).sum::<f64>() / count;
        let radius_px = members.iter().map(|i| ((i % width) as f64 - x).hypot((i / width) as f64 - y)).fold(0.5, f64::max);
        blobs.push(Blob { x, y, radius_px });
    }
    blobs
}

/// Peaks with first guesses, brightest first; those that a brighter star's wings or full pixels make are left out.
fn candidates(frame: &Frame, background: &Background, search: &Search, blobs: &[Blob]) -> Vec<Candidate> {
    /// How a bright star's wings may fall, over what they are at its centre (Moffat-like), and the share that ripples in them may reach.
    const RIPPLE: f64 = 0.04;
    const RIPPLE_OF_FULL: f64 = 0.15;
    const RESOLVED_SIGMA: f64 = 2.0;
    let (long, _) = search.shape.axes_px();
    let radius = radius_px(search.shape);
    let mut blob_taken = vec![false; blobs.len()];
    let mut kept: Vec<Candidate> = Vec::with_capacity(search.peaks.len());
    let mut grid = Grid::new(frame.width_px, frame.height_px);
    let loud = |c: &Candidate| if c.full_radius_px > 0.0 { RIPPLE_OF_FULL } else { RIPPLE };
    for peak in &search.peaks {
        let (mut x, mut y) = (peak.x as f64, peak.y as f64);
        let mut full_radius_px = 0.0;
        let inside = |b: &Blob| (b.x - x).hypot(b.y - y) <= b.radius_px + 1.5;
        if let Some(index) = blobs.iter().position(inside) {
            if std::mem::replace(&mut blob_taken[index], true) {
                continue;
            }
            (x, y, full_radius_px) = (blobs[index].x, blobs[index].y, blobs[index].radius_px);
        }
        // the filter cannot tell two such near stars apart: a second maximum is a ripple of the first
        let merged =
            grid.near(x, y).any(|i: usize| search.shape.radius_in_sigma(kept[i].start.x - x, kept[i].start.y - y) < RESOLVED_SIGMA);
        if merged {
            continue;
        }
        let wings = grid.near(x, y).map(|i: usize| {
            let c: &Candidate = &kept[i];
            let scale = 2.0 * long + c.full_radius_px;
            let distance = (c.start.x - x).hypot(c.start.y - y);
            c.snr * loud(c) * (1.0 + (distance / scale).powi(2)).powf(-1.5)
        });
        if wings.fold(0.0, f64::max) > peak.snr {
            continue;
        }
        let noise = background.noise_dn(peak.x, peak.y);
        let (mut shape, mut reach) = (search.shape, radius);
        if full_radius_px > 0.0 {
            // the wings beyond the full pixels must be in the window
            shape = Shape::round(search.shape.sigma_px().max(full_radius_px / 1.5));
            reach = (radius + full_radius_px.ceil() as usize).min(48);
        }
        let flux_dn = peak.snr * noise * search.kernel.flux_per_snr();
        grid.put(x, y, kept.len());
        kept.push(Candidate { start: Model { x, y, flux_dn, shape, radius: reach }, snr: peak.snr, full_radius_px });
    }
    kept
}

/// Buckets of places, to find those near a place.
struct Grid {
    columns: usize,
    rows: usize,
    cells: Vec<Vec<usize>>,
}

impl Grid {
    const CELL_PX: usize = 32;

    fn new(width: usize, height: usize) -> Self {
        let (columns, rows) = (width / Self::CELL_PX + 1, height / Self::CELL_PX + 1);
        Self { columns, rows, cells: vec![Vec::new(); columns * rows] }
    }

    fn cell(&self, x: f64, y: f64) -> (usize, usize) {
        let index = |v: f64, n: usize| ((v.max(0.0) as usize) / Self::CELL_PX).min(n - 1);
        (index(x, self.columns), index(y, self.rows))
    }

    fn put(&mut self, x: f64, y: f64, item: usize) {
        let (cx, cy) = self.cell(x, y);
        self.cells[cy * self.columns + cx].push(item);
    }

    fn near(&self, x: f64, y: f64) -> impl Iterator<Item = usize> + '_ {
        let (cx, cy) = self.cell(x, y);
        let rows = cy.saturating_sub(1)..(cy + 2).min(self.rows);
        let columns = cx.saturating_sub(1)..(cx + 2).min(self.columns);
        rows.flat_map(move |r| columns.clone().map(move |c| r * self.columns + c)).flat_map(|i| self.cells[i].iter().copied())
    }
}

/// For every star those whose light reaches into its window.
fn neighbours(models: &[Model]) -> Vec<Vec<usize>> {
    let extent = |pick: fn(&Model) -> f64| models.iter().map(pick).fold(0.0, f64::max) as usize + 1;
    let mut grid = Grid::new(extent(|m| m.x), extent(|m| m.y));
    for (i, m) in models.iter().enumerate() {
        grid.put(m.x, m.y, i);
    }
    let touches = |a: &Model, b: &Model| {
        let reach = a.radius as f64 + 2.5 * b.shape.axes_px().0;
        (a.x - b.x).abs() < reach && (a.y - b.y).abs() < reach
    };
    models
        .par_iter()
        .enumerate()
        .map(|(i, own)| grid.near(own.x, own.y).filter(|&j| j != i && touches(own, &models[j])).collect())
        .collect()
}

/// Fits all stars, or, given earlier fits, again those with neighbours.
fn fit_all(
    scene: &Scene<'_>,
    candidates: &[Candidate],
    models: &[Model],
    neighbours: &[Vec<usize>],
    freedom: &(impl Fn(&Candidate) -> Freedom + Sync),
    earlier: Option<&[Option<Fit>]>,
) -> Vec<Option<Fit>> {
    candidates
        .par_iter()
        .enumerate()
        .map(|(i, candidate)| {
            if let (Some(earlier), true) = (earlier, neighbours[i].is_empty()) {
                return earlier[i].clone();
            }
            let others: Vec<Model> = neighbours[i].iter().map(|&j| models[j]).collect();
            let first = scene.fit(candidate.start, freedom(candidate), &others);
            // a width that runs away takes the star with it: then the shape of the others must do
            first.or_else(|| scene.fit(candidate.start, Freedom::Fixed, &others))
        })
        .collect()
}

/// Models as fitted; where the fit failed no light at all.
fn fitted(guesses: &[Model], fits: &[Option<Fit>]) -> Vec<Model> {
    let dark = |guess: &Model| Model { flux_dn: 0.0, ..*guess };
    guesses.iter().zip(fits).map(|(guess, fit)| fit.as_ref().map_or_else(|| dark(guess), |f| f.model)).collect()
}

fn free_shape(options: &DetectOptions, search: &Search, candidate: &Candidate) -> Freedom {
    if candidate.full_radius_px > 0.0 {
        return Freedom::Width;
    }
    if options.psf_sigma_px.is_some() || (candidate.snr < SNR_FOR_WIDTH && search.shape_known) {
        Freedom::Fixed
    } else if search.shape.is_round() {
        Freedom::Width
    } else {
        Freedom::Ellipse
    }
}

/// Whether the fit is that of a star: on the frame, of positive flux, near where it was found, and as wide as light makes it.
fn is_star(candidate: &Candidate, fit: &Fit, search: &Search, frame_px: (usize, usize)) -> bool {
    /// Fits of σ below this share of the frame's width are hot pixels in groups, or cosmic rays.
    const SHARP: f64 = 0.5;
    /// A fit may find so much less than the filter; if less, the peak was a ripple on other light.
    const LEAST_SHARE: f64 = 0.6;
    // A star beside the frame whose wing reaches in: only the tail of its image is seen, and no position worth the name.
    let on_frame = |v: f64, n: usize| v > -0.5 && v < n as f64 - 0.5;
    if !on_frame(fit.model.x, frame_px.0) || !on_frame(fit.model.y, frame_px.1) {
        return false;
    }
    let snr = fit.model.flux_dn / fit.flux_sigma_dn;
    if snr < LEAST_SHARE * search.threshold {
        return false;
    }
    if candidate.full_radius_px > 0.0 {
        return true;
    }
    let (_, short) = fit.model.shape.axes_px();
    let sharp = short < if search.shape_known { 0.3_f64.max(SHARP * search.shape.axes_px().1) } else { SHARPEST_PX };
    fit.lone_pixel_excess > 0.0 && !sharp
}

fn detection(scene: &Scene<'_>, fit: &Fit, candidate: &Candidate, blended: bool, scatter: f64) -> Detection {
    let model = fit.model;
    let inside = |v: f64, n: usize| v.round().clamp(0.0, (n - 1) as f64) as usize;
    let (x, y) = (inside(model.x, scene.frame.width_px), inside(model.y, scene.frame.height_px));
    let chi2_per_dof = fit.chi2 / fit.dof as f64;
    // where the model fits worse than chance allows the errors are larger in that measure
    let misfit = (chi2_per_dof / (1.0 + 3.0 * (2.0 / fit.dof as f64).sqrt())).max(1.0);
    // and where the noise goes together from pixel to pixel, as far as it is the background's
    let sigma = scene.background.noise_dn(x, y);
    let light = fit.peak_dn - scene.background.level_dn(x, y);
    let share = sigma * sigma / (sigma * sigma + 0.5 * light.max(0.0) * scene.variance_per_dn);
    let factor = misfit * (1.0 + (scatter * scatter - 1.0) * share);
    Detection {
        x_px: model.x,
        y_px: model.y,
        covariance_px2: fit.covariance_px2.map(|c| c * factor),
        flux_dn: model.flux_dn,
        flux_sigma_dn: fit.flux_sigma_dn * factor.sqrt(),
        background_dn: scene.background.level_dn(x, y) + fit.offset_dn,
        background_gradient_dn: fit.gradient_dn,
        width_px: model.shape.sigma_px(),
        chi2_per_dof,
        peak_dn: fit.peak_dn,
        flags: Flags { saturated: candidate.full_radius_px > 0.0, blended, edge: fit.edge },
    }
}

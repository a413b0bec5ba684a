//! Windowed centroids, the quick way: a gate of 3 × 3 pixels over a coarse background, and centroids in a Gaussian window.
//!
//! Windowed centroid as in SExtractor (Bertin & Arnouts 1996, A&AS 117, 393; its manual, "Windowed positional parameters"):
//! x ← x + g Σ w I (x_i − x) / Σ w I with a Gaussian weight as wide as the star or wider, until it moves no more (g is 1 + the image's variance
//! over the weight's: 2 where they match). It needs no model of the image, and
//! pays with errors above the statistical limit, and with a bias that follows the phase in the pixel where images are narrow: so do the
//! moments, which come from the sums that are there (to 5 % of σ² at σ 0.6 px, 2 % at 0.8, 0.1 % from 1.2 on).

use super::background::{ROUNDING_SIGMA, quantum_dn};
use super::black;
use super::filter::Kernel;
use super::image_model::{PIXEL_VARIANCE, Shape};
use super::measure::check;
use super::window::{Bell, Bells, Noise, Scratch, weighted};
use super::window_gain::{self, Way, WindowStar};
use super::{DetectError, DetectOptions, Detection, Detections, Flags};
use crate::frame::Frame;
use crate::statistics::order::sort_by;
use crate::statistics::{clipped, median_in_place};

/// Side of a cell of the background, px, about.
const CELL_PX: usize = 64;
/// Pixels of a cell that are looked at: every so many rows and columns.
const SAMPLE_ROWS: usize = 7;
const SAMPLE_COLUMNS: usize = 9;
/// Pixels that the gate looks at together.
const BLOCK: usize = 32;
/// A lone pixel counts as hot from so many σ on, where its neighbours hold less than this share of its light.
const HOT: (f32, f32) = (8.0, 0.7);
/// Width before stars tell, and its range, px.
const FIRST_SIGMA_PX: f64 = 1.2;
const SIGMA_RANGE_PX: (f64, f64) = (0.4, 6.0);
/// The weight is at least so wide: in a narrower one the pixels are too coarse for moments, and the phase in the pixel shows.
const MIN_WEIGHT_PX: f64 = 1.0;
const MAX_STEPS: usize = 20;

/// Finds and measures the stars of a frame quickly: windowed centroids in the place of fits. `bad` pixels say nothing.
///
/// χ² is that of a Gaussian of the frame's typical width at the place found, so it is above 1 where the place or the width is not the best.
pub fn detect_windowed(frame: &Frame, options: &DetectOptions, bad: Option<&[bool]>) -> Result<Detections, DetectError> {
    check(frame, options)?;
    if let Some(bad) = bad.filter(|bad| bad.len() != frame.pixels_dn.len()) {
        return Err(DetectError::MaskSize { mask: bad.len(), frame: frame.pixels_dn.len() });
    }
    let mesh = Mesh::measure(frame);
    let darkened;
    let frame = match bad {
        Some(bad) => {
            darkened = mesh.filled(frame, bad);
            &darkened
        }
        None => frame,
    };
    let by_chance = || Kernel::new(Shape::round(1.0)).threshold(frame.pixels_dn.len(), options.false_alarms_per_frame);
    let normal = options.detection_threshold.unwrap_or_else(by_chance);
    let places = gate(frame, &mesh, normal as f32);
    let sigma_px = options.psf_sigma_px.unwrap_or_else(|| typical_sigma_px(frame, &mesh, &places));
    let mut window = Window::new(frame, &mesh, options, sigma_px);
    let mut scratch = Scratch::new();
    if options.gain_e_per_dn.is_none() {
        window.variance_per_dn = window.told_variance_per_dn(&places, normal, &mut scratch);
    }
    let mut stars: Vec<Detection> = places.iter().filter_map(|place| window.measure(*place, normal, &mut scratch)).collect();
    flag_neighbours(&mut stars, 2.0 * window.radius as f64);
    sort_by(&mut stars, |a, b| b.flux_dn.total_cmp(&a.flux_dn).then(a.y_px.total_cmp(&b.y_px)).then(a.x_px.total_cmp(&b.x_px)));
    stars.truncate(options.max_stars);
    let (background_dn, noise_dn) = mesh.typical();
    Ok(Detections { width_px: frame.width_px, height_px: frame.height_px, background_dn, noise_dn, stars })
}

/// Level and noise on a coarse mesh.
struct Mesh {
    columns: usize,
    rows: usize,
    cell_px: [f32; 2],
    level: Vec<f32>,
    noise: Vec<f32>,
}

impl Mesh {
    fn measure(frame: &Frame) -> Self {
        let cells = |length: usize| (length / CELL_PX).max(1);
        let (columns, rows) = (cells(frame.width_px), cells(frame.height_px));
        let mut samples = vec![Vec::with_capacity(256); columns * rows];
        for (index, y) in (0..frame.height_px).step_by(SAMPLE_ROWS).enumerate() {
            let line = &frame.pixels_dn[y * frame.width_px..(y + 1) * frame.width_px];
            let row = y * rows / frame.height_px;
            for column in 0..columns {
                let (from, to) = (column * frame.width_px / columns, (column + 1) * frame.width_px / columns);
                // columns in turns, so that a pattern of columns is not met at one phase
                samples[row * columns + column].extend(line[(from + index % SAMPLE_COLUMNS).min(to)..to].iter().step_by(SAMPLE_COLUMNS));
            }
        }
        let quantum = quantum_dn(samples.as_slice().concat().as_slice()).map_or(0.0, f64::from);
        let floor = (quantum * ROUNDING_SIGMA).max(1e-6);
        let told = samples.iter().map(|values| clipped(values, 1.5 * quantum).map_or((0.0, floor), |c| (c.mean, c.sigma.max(floor))));
        let (level, noise): (Vec<f32>, Vec<f32>) = told.map(|(mean, sigma)| (mean as f32, sigma as f32)).unzip();
        let mut mesh = Self {
            columns,
            rows,
            cell_px: [frame.width_px as f32 / columns as f32, frame.height_px as f32 / rows as f32],
            level: Vec::new(),
            noise: Vec::new(),
        };
        (mesh.level, mesh.noise) = (mesh.smoothed(&level), mesh.smoothed(&noise));
        if black::may_be_cut(&samples) {
            mesh.see_cut_noise(frame, floor);
        }
        mesh
    }

    /// Where black is cut off above the sky's level most counts are alike, and the scatter of those that are kept says nothing.
    fn see_cut_noise(&mut self, frame: &Frame, floor_dn: f64) {
        /// A sum over few pixels of such noise reaches further than that of a normal one as scattered.
        const TAIL: f64 = 1.4;
        let Some(cut) = black::cut_noise(frame, &[], floor_dn) else { return };
        for (cell, noise) in self.noise.iter_mut().enumerate() {
            let middle = |i: usize, cell_px: f32| ((i as f32 + 0.5) * cell_px) as usize;
            let at = (middle(cell % self.columns, self.cell_px[0]), middle(cell / self.columns, self.cell_px[1]));
            *noise = noise.max((TAIL * cut.left_at(at.0, at.1)) as f32);
        }
    }

    /// The median of each cell and those around it.
    fn smoothed(&self, raw: &[f32]) -> Vec<f32> {
        let around = |c: usize, n: usize| c.saturating_sub(1)..(c + 2).min(n);
        let mut near = Vec::with_capacity(9);
        (0..raw.len())
            .map(|cell| {
                near.clear();
                for row in around(cell / self.columns, self.rows) {
                    near.extend(around(cell % self.columns, self.columns).map(|column| f64::from(raw[row * self.columns + column])));
                }
                median_in_place(&mut near).unwrap_or(0.0) as f32
            })
            .collect()
    }

    /// The cells before and after a place along an axis, and the share of the latter; beyond the outermost centres all stays as there.
    fn between(at: f32, cell_px: f32, cells: usize) -> (usize, usize, f32) {
        let position = ((at + 0.5) / cell_px - 0.5).clamp(0.0, (cells - 1) as f32);
        let low = (position as usize).min(cells - 1);
        (low, (low + 1).min(cells - 1), position - low as f32)
    }

    fn at(&self, values: &[f32], x: f32, y: f32) -> f32 {
        let (left, right, across) = Self::between(x, self.cell_px[0], self.columns);
        let (top, bottom, down) = Self::between(y, self.cell_px[1], self.rows);
        let row = |r: usize| {
            let (a, b) = (values[r * self.columns + left], values[r * self.columns + right]);
            a + across * (b - a)
        };
        row(top) + down * (row(bottom) - row(top))
    }

    fn level_dn(&self, x: f64, y: f64) -> f64 {
        f64::from(self.at(&self.level, x as f32, y as f32))
    }

    fn noise_dn(&self, x: f64, y: f64) -> f64 {
        f64::from(self.at(&self.noise, x as f32, y as f32))
    }

    fn typical(&self) -> (f64, f64) {
        let middle = |values: &[f32]| median_in_place(&mut values.iter().map(|v| f64::from(*v)).collect::<Vec<_>>()).unwrap_or(0.0);
        (middle(&self.level), middle(&self.noise))
    }

    /// The frame with bad pixels at the level.
    fn filled(&self, frame: &Frame, bad: &[bool]) -> Frame {
        let mut out = frame.clone();
        for i in (0..bad.len()).filter(|i| bad[*i]) {
            out.pixels_dn[i] = self.at(&self.level, (i % frame.width_px) as f32, (i / frame.width_px) as f32);
        }
        out
    }

    /// What the sum over 3 × 3 pixels must exceed along a row of cell centres.
    fn thresholds(&self, row: usize, normal: f32, along: &[(usize, usize, f32)]) -> Vec<f32> {
        let cells = row * self.columns..(row + 1) * self.columns;
        let of = |(level, noise): (&f32, &f32)| 9.0 * level + 3.0 * normal * noise;
        let cells: Vec<f32> = self.level[cells.clone()].iter().zip(&self.noise[cells]).map(of).collect();
        along.iter().map(|(low, high, share)| cells[*low] + share * (cells[*high] - cells[*low])).collect()
    }
}

/// Thresholds of all rows: those at two rows of cell centres, and how far a row lies from one to the other.
struct Limits {
    /// Where each column lies between the cells' centres.
    along: Vec<(usize, usize, f32)>,
    top: Vec<f32>,
    /// From the top to the bottom.
    step: Vec<f32>,
    /// The least of both in each block.
    least: Vec<[f32; 2]>,
    rows: Option<(usize, usize)>,
    share: f32,
}

impl Limits {
    fn at_row(&mut self, mesh: &Mesh, y: usize, normal: f32) {
        let (top, bottom, share) = Mesh::between(y as f32, mesh.cell_px[1], mesh.rows);
        self.share = share;
        if self.rows != Some((top, bottom)) {
            self.rows = Some((top, bottom));
            self.top = mesh.thresholds(top, normal, &self.along);
            self.step = mesh.thresholds(bottom, normal, &self.along);
            for (step, top) in self.step.iter_mut().zip(&self.top) {
                *step -= top;
            }
            let least = |values: &[f32]| values.iter().copied().fold(f32::INFINITY, f32::min);
            let blocks = self.top.chunks(BLOCK).zip(self.step.chunks(BLOCK));
            self.least = blocks.map(|(top, step)| [least(top), least(step)]).collect();
        }
    }

    /// The columns of a block in which sums exceed their limits, as bits.
    fn exceeded(&self, sums: &[f32], block: usize) -> u32 {
        let columns = block * BLOCK..((block + 1) * BLOCK).min(sums.len());
        bits_above(&sums[columns.clone()], &self.top[columns.clone()], &self.step[columns], self.share)
    }
}

#[multiversion::multiversion(targets("x86_64+avx2"))]
fn bits_above(sums: &[f32], top: &[f32], step: &[f32], share: f32) -> u32 {
    let mut bits = 0;
    for (i, ((s, t), d)) in sums.iter().zip(top).zip(step).enumerate() {
        bits |= u32::from(*s > t + share * d) << i;
    }
    bits
}

/// Sums over 3 × 3 pixels along a row, and where they may exceed their limits.
struct Line {
    sums: Vec<f32>,
    /// Bits of each block.
    above: Vec<u32>,
}

/// Sums over 3 × 3 pixels along the middle of three rows, and the blocks in which one exceeds the least limit there; at the rim of the frame
/// what is there counts.
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn sum_rows(rows: [&[f32]; 3], column: &mut [f32], least: &[[f32; 2]], share: f32, sums: &mut [f32], marks: &mut [u32]) {
    let [above, own, below] = rows;
    let width = own.len();
    for (c, ((a, b), d)) in column[1..=width].iter_mut().zip(above.iter().zip(own).zip(below)) {
        *c = a + b + d;
    }
    // the rim once more beside it
    column[0] = column[1];
    column[width + 1] = column[width];
    for (block, (out, mark)) in sums.chunks_mut(BLOCK).zip(marks).enumerate() {
        let limit = least[block][0] + share * least[block][1];
        let near = &column[block * BLOCK..block * BLOCK + out.len() + 2];
        let mut any = 0_u32;
        for (o, ((a, b), d)) in out.iter_mut().zip(near.iter().zip(&near[1..]).zip(&near[2..])) {
            *o = a + b + d;
            any |= u32::from(*o > limit);
        }
        *mark = any;
    }
}

impl Line {
    fn new(width: usize) -> Self {
        Self { sums: vec![0.0; width], above: vec![0; width.div_ceil(BLOCK)] }
    }

    fn look(&mut self, frame: &Frame, y: usize, limits: &Limits, column: &mut [f32]) {
        let row = |y: usize| &frame.pixels_dn[y * frame.width_px..(y + 1) * frame.width_px];
        let rows = [row(y.saturating_sub(1)), row(y), row((y + 1).min(frame.height_px - 1))];
        sum_rows(rows, column, &limits.least, limits.share, &mut self.sums, &mut self.above);
        for block in 0..self.above.len() {
            if self.above[block] != 0 {
                self.above[block] = limits.exceeded(&self.sums, block);
            }
        }
    }
}

/// Places where the sum over 3 × 3 pixels is a maximum above the noise, row by row; lone bright pixels are left out.
fn gate(frame: &Frame, mesh: &Mesh, normal: f32) -> Vec<[usize; 2]> {
    let (width, height) = (frame.width_px, frame.height_px);
    let mut column = vec![0.0_f32; width + 2];
    let along = (0..width).map(|x| Mesh::between(x as f32, mesh.cell_px[0], mesh.columns)).collect();
    let mut limits = Limits { along, top: Vec::new(), step: Vec::new(), least: Vec::new(), rows: None, share: 0.0 };
    let mut lines = [Line::new(width), Line::new(width), Line::new(width)];
    let mut places = Vec::new();
    limits.at_row(mesh, 0, normal);
    lines[0].look(frame, 0, &limits, &mut column);
    for y in 0..height {
        let [before, own, after] = [(y + 2) % 3, y % 3, (y + 1) % 3];
        if y + 1 < height {
            limits.at_row(mesh, y + 1, normal);
            lines[after].look(frame, y + 1, &limits, &mut column);
        } else {
            lines[after].sums.fill(f32::NEG_INFINITY);
        }
        let line = &lines[own].sums;
        for (block, bits) in lines[own].above.iter().enumerate().filter(|(_, bits)| **bits != 0) {
            let mut left = *bits;
            while left != 0 {
                let x = block * BLOCK + left.trailing_zeros() as usize;
                left &= left - 1;
                let span = x.saturating_sub(1)..(x + 2).min(width);
                // of equal neighbours the first counts
                let beside = (x == 0 || line[x - 1] < line[x]) && (x + 1 == width || line[x + 1] <= line[x]);
                let earlier = || y == 0 || lines[before].sums[span.clone()].iter().all(|sum| *sum < line[x]);
                if beside && earlier() && lines[after].sums[span.clone()].iter().all(|sum| *sum <= line[x]) {
                    places.extend(seat(frame, mesh, x, y));
                }
            }
        }
    }
    places.dedup();
    places
}

/// The brightest pixel around a place; `None` where it is a hot one.
fn seat(frame: &Frame, mesh: &Mesh, x: usize, y: usize) -> Option<[usize; 2]> {
    let around = |at: usize, length: usize| at.saturating_sub(1)..(at + 2).min(length);
    let places = around(y, frame.height_px).flat_map(|py| around(x, frame.width_px).map(move |px| (px, py)));
    let (px, py) = places.fold((x, y), |best, place| if frame.at(place.0, place.1) > frame.at(best.0, best.1) { place } else { best });
    let (level, noise) = (mesh.at(&mesh.level, px as f32, py as f32), mesh.at(&mesh.noise, px as f32, py as f32));
    let own = frame.at(px, py) - level;
    let (mut sum, mut count) = (0.0, 0.0_f32);
    for ny in around(py, frame.height_px) {
        for nx in around(px, frame.width_px).filter(|&nx| (nx, ny) != (px, py)) {
            sum += frame.at(nx, ny) - level;
            count += 1.0;
        }
    }
    let hot = own > HOT.0 * noise && frame.at(px, py) < frame.saturation_dn && sum + 3.0 * count.sqrt() * noise < HOT.1 * own * count / 8.0;
    (!hot).then_some([px, py])
}

/// Width of the brightest stars: moments under a weight that is made as wide as they are.
fn typical_sigma_px(frame: &Frame, mesh: &Mesh, places: &[[usize; 2]]) -> f64 {
    const STARS: usize = 15;
    let full = |p: &[usize; 2]| frame.at(p[0], p[1]) >= frame.saturation_dn;
    let above = |p: &[usize; 2]| f64::from(frame.at(p[0], p[1])) - mesh.level_dn(p[0] as f64, p[1] as f64);
    let mut bright: Vec<([usize; 2], f64)> = places.iter().filter(|p| !full(p)).map(|p| (*p, above(p))).collect();
    if bright.len() > STARS {
        bright.select_nth_unstable_by(STARS, |a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        bright.truncate(STARS);
    }
    let mut scratch = Scratch::new();
    let mut width2 = |p: [usize; 2]| {
        let (mut centre, mut sigma2) = ([p[0] as f64, p[1] as f64], FIRST_SIGMA_PX * FIRST_SIGMA_PX);
        let level = mesh.level_dn(centre[0], centre[1]);
        for _ in 0..MAX_STEPS {
            let weight2 = sigma2.max(MIN_WEIGHT_PX * MIN_WEIGHT_PX);
            let radius = (3.0 * weight2.sqrt()).ceil() as usize;
            let sums = weighted(frame, level, centre, &Bell::new(weight2, radius), &mut scratch)?;
            let gain = 1.0 + sigma2 / weight2;
            centre = std::array::from_fn(|k| centre[k] + (gain * sums.shift[k] / sums.light).clamp(-1.0, 1.0));
            let inverse = sums.light / sums.square - 1.0 / weight2;
            let next = if inverse > 0.0 { (1.0 / inverse).min(2.0 * sigma2) } else { 2.0 * sigma2 };
            if !(0.1..=40.0).contains(&next) {
                return None;
            }
            let settled = (next - sigma2).abs() < 1e-2 * sigma2;
            sigma2 = next;
            if settled {
                return Some(sigma2);
            }
        }
        None
    };
    let mut widths: Vec<f64> = bright.iter().filter_map(|(p, _)| width2(*p)).collect();
    let sigma2 = median_in_place(&mut widths).map_or(FIRST_SIGMA_PX * FIRST_SIGMA_PX, |w| w - PIXEL_VARIANCE);
    sigma2.max(0.0).sqrt().clamp(SIGMA_RANGE_PX.0, SIGMA_RANGE_PX.1)
}

/// What stars are measured with.
struct Window<'a> {
    frame: &'a Frame,
    mesh: &'a Mesh,
    variance_per_dn: f64,
    floor_dn: f64,
    sigma_px: f64,
    bells: Bells,
    /// Variance of the weight, and what a shift of the moments is to be multiplied with: 1 + image over weight.
    weight2: f64,
    gain: f64,
    radius: usize,
}

impl<'a> Window<'a> {
    fn new(frame: &'a Frame, mesh: &'a Mesh, options: &DetectOptions, sigma_px: f64) -> Self {
        let sigma2 = sigma_px * sigma_px + PIXEL_VARIANCE;
        let weight2 = sigma2.max(MIN_WEIGHT_PX * MIN_WEIGHT_PX);
        let radius = (3.0 * weight2.sqrt()).ceil() as usize;
        Self {
            frame,
            mesh,
            variance_per_dn: options.gain_e_per_dn.map_or(0.0, |gain| 1.0 / gain),
            floor_dn: options.read_noise_e.zip(options.gain_e_per_dn).map_or(0.0, |(e, g)| e / g),
            sigma_px,
            bells: Bells { image: Bell::new(sigma2, radius), weight: Bell::new(weight2, radius) },
            weight2,
            gain: 1.0 + sigma2 / weight2,
            radius,
        }
    }

    /// The variance per count that the frame's own stars tell.
    fn told_variance_per_dn(&self, places: &[[usize; 2]], normal: f64, scratch: &mut Scratch) -> f64 {
        /// So many are looked at, spread over the frame.
        const MAX_PLACES: usize = 80;
        let seen = |place: &[usize; 2]| {
            let star = self.measure(*place, normal, scratch).filter(|star| !star.flags.saturated)?;
            let noise_dn = self.mesh.noise_dn(star.x_px, star.y_px).max(self.floor_dn);
            let snr = star.flux_dn / star.flux_sigma_dn;
            Some(WindowStar { centre: [star.x_px, star.y_px], level_dn: star.background_dn, noise_dn, snr })
        };
        let step = places.len().div_ceil(MAX_PLACES).max(1);
        let seen: Vec<WindowStar> = places.iter().step_by(step).filter_map(seen).collect();
        let way = Way { sigma_px: self.sigma_px, weight2: self.weight2, radius: self.radius, gain: self.gain };
        window_gain::variance_per_dn(self.frame, seen, way)
    }

    fn measure(&self, [px, py]: [usize; 2], normal: f64, scratch: &mut Scratch) -> Option<Detection> {
        let start = [px as f64, py as f64];
        let level = self.mesh.level_dn(start[0], start[1]);
        let way = CentreSteps { weight: &self.bells.weight, gain: self.gain, reach_px: 1.5 + self.sigma_px };
        let centre = way.take(self.frame, level, start, scratch)?;
        self.weigh(centre, level, normal, scratch)
    }

    /// Brightness, errors and χ² at a centre.
    fn weigh(&self, centre: [f64; 2], level: f64, normal: f64, scratch: &mut Scratch) -> Option<Detection> {
        /// A star holds at least so much of what the gate asks for.
        const MIN_SHARE: f64 = 0.6;
        /// Brighter stars than this SNR have a width of their own.
        const SNR_FOR_WIDTH: f64 = 30.0;
        let noise_dn = self.mesh.noise_dn(centre[0], centre[1]).max(self.floor_dn);
        let noise = Noise { variance_dn2: noise_dn * noise_dn, per_dn: self.variance_per_dn };
        let star = self.bells.weigh(self.frame, level, centre, noise, scratch)?;
        if star.flux_dn < MIN_SHARE * normal * star.flux_sigma_dn {
            return None;
        }
        let inverse = 1.0 / star.square_px2 - 1.0 / self.weight2;
        let is_bright = star.flux_dn >= SNR_FOR_WIDTH * star.flux_sigma_dn;
        let width2 = if is_bright && inverse > 0.0 { 1.0 / inverse - PIXEL_VARIANCE } else { self.sigma_px * self.sigma_px };
        let slope = |dx: f64, dy: f64| {
            (self.mesh.level_dn(centre[0] + dx, centre[1] + dy) - self.mesh.level_dn(centre[0] - dx, centre[1] - dy)) / 8.0
        };
        Some(Detection {
            x_px: centre[0],
            y_px: centre[1],
            covariance_px2: star.covariance_px2,
            flux_dn: star.flux_dn,
            flux_sigma_dn: star.flux_sigma_dn,
            background_dn: level,
            background_gradient_dn: [slope(4.0, 0.0), slope(0.0, 4.0)],
            width_px: width2.max(0.0).sqrt().clamp(0.1, 4.0 * self.sigma_px),
            moments: Some(Box::new(star.moments)),
            chi2_per_dof: star.chi2 / (star.pixels as f64 - 3.0).max(1.0),
            peak_dn: f64::from(star.peak_dn),
            flags: Flags { saturated: star.peak_dn >= self.frame.saturation_dn, blended: false, edge: star.is_cut, is_unresolved: false },
        })
    }
}

/// How a centre is stepped to.
struct CentreSteps<'a> {
    weight: &'a Bell,
    /// What a shift of the moments is multiplied with: 1 + the image's variance over the weight's.
    gain: f64,
    /// How far it may go.
    reach_px: f64,
}

impl CentreSteps<'_> {
    fn take(&self, frame: &Frame, level: f64, start: [f64; 2], scratch: &mut Scratch) -> Option<[f64; 2]> {
        let mut centre = start;
        for _ in 0..MAX_STEPS {
            let sums = weighted(frame, level, centre, self.weight, scratch)?;
            let step: [f64; 2] = std::array::from_fn(|k| (self.gain * sums.shift[k] / sums.light).clamp(-1.0, 1.0));
            centre = [centre[0] + step[0], centre[1] + step[1]];
            if (centre[0] - start[0]).powi(2) + (centre[1] - start[1]).powi(2) > self.reach_px.powi(2) {
                return None;
            }
            if step[0].abs().max(step[1].abs()) < 1e-4 {
                break;
            }
        }
        Some(centre)
    }
}

/// The centre of a star on an empty sky, in the window for images of this width (σ before the pixel integrates it).
pub(super) fn centre(frame: &Frame, start: [f64; 2], sigma_px: f64) -> Option<[f64; 2]> {
    let sigma2 = sigma_px * sigma_px + PIXEL_VARIANCE;
    let weight2 = sigma2.max(MIN_WEIGHT_PX * MIN_WEIGHT_PX);
    let weight = Bell::new(weight2, (3.0 * weight2.sqrt()).ceil() as usize);
    CentreSteps { weight: &weight, gain: 1.0 + sigma2 / weight2, reach_px: 1.5 + sigma_px }.take(frame, 0.0, start, &mut Scratch::new())
}

/// Marks stars in each other's windows; they are sorted by rows nearly.
fn flag_neighbours(stars: &mut Vec<Detection>, reach_px: f64) {
    sort_by(stars, |a, b| a.y_px.total_cmp(&b.y_px).then(a.x_px.total_cmp(&b.x_px)));
    stars.dedup_by(|a, b| (a.x_px - b.x_px).powi(2) + (a.y_px - b.y_px).powi(2) < 0.25);
    for i in 0..stars.len() {
        let mut j = i + 1;
        while j < stars.len() && stars[j].y_px - stars[i].y_px < reach_px {
            if (stars[j].x_px - stars[i].x_px).abs() < reach_px {
                stars[i].flags.blended = true;
                stars[j].flags.blended = true;
            }
            j += 1;
        }
    }
}

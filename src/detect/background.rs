//! Level and noise of the sky background: a mesh of robust cell means, interpolated, and offsets of rows.
//!
//! Cells as in SExtractor (Bertin & Arnouts 1996, A&AS 117, 393, section 2), with iterated clipping in place of the mode
//! formula, since the median of coarsely quantised counts cannot resolve a step.

use super::black::{self, CutNoise};
use crate::frame::Frame;
use crate::parallel;
use crate::statistics::{Clipped, clipped, median_in_place};

/// Side of a mesh cell, px: above ten times any usual star's width, fine enough for glow at the edge of a detector.
const CELL_PX: usize = 32;
/// Standard deviation of rounding to steps of one: 1/√12.
pub(super) const ROUNDING_SIGMA: f64 = 0.288_675_134_594_812_9;

/// Background of one frame.
pub(super) struct Background {
    /// Level and noise at the cells, row by row.
    columns: Vec<Axis>,
    rows: Vec<Axis>,
    cells_x: usize,
    level: Vec<f32>,
    noise: Vec<f32>,
    row_offset: Vec<f32>,
    /// Least half-width of the cut, DN.
    least: f64,
    /// The smallest noise that the steps of the counts allow, DN.
    pub(super) floor_dn: f64,
    /// Whether black is cut off above the level of the sky, nearly everywhere.
    pub(super) is_cut: bool,
    /// Whether what is left of noise whose black is cut off comes in the blocks of a compressed picture.
    pub(super) is_in_blocks: bool,
    /// Its noise before it was cut.
    before_cut: Option<CutNoise>,
}

/// Where a pixel lies between the cell centres of one axis: index of the lower one, and the share of the upper.
#[derive(Clone, Copy)]
struct Axis {
    low: usize,
    high: usize,
    share: f32,
}

/// The rounding of colours that were joined into one count, in steps of these: root of the sum of the squares of their weights.
const JOINED_STEP: f32 = 0.75;

/// Whether counts are those of three colours of eight bits, joined by weights of four digits: no whole numbers, but rounded all the same.
fn is_joined(pixels: &[f32]) -> bool {
    const PARTS: f64 = 1e4;
    const TOLERANCE: f64 = 0.2;
    let of_colours = |v: f32| {
        let parts = f64::from(v) * PARTS;
        v.abs() <= 255.5 && (parts - parts.round()).abs() < TOLERANCE
    };
    let stride = (pixels.len() / 8192).max(1);
    pixels.len() >= 64 && pixels.iter().step_by(stride).all(|v| of_colours(*v)) && pixels.iter().all(|v| of_colours(*v))
}

/// The step of the counts: greatest common divisor of their differences; `None` where counts are neither whole numbers nor made of such.
pub(super) fn quantum_dn(pixels: &[f32]) -> Option<f32> {
    const WHOLE_BELOW: f32 = 16_777_216.0;
    let first = *pixels.first()?;
    let whole = |v: f32| v.abs() < WHOLE_BELOW && (v as i32) as f32 == v;
    if !pixels.iter().all(|&v| whole(v)) {
        return is_joined(pixels).then_some(JOINED_STEP);
    }
    let mut step = 0_u32;
    let stride = (pixels.len() / 8192).max(1);
    for &v in pixels.iter().step_by(stride).chain(pixels) {
        let difference = (v - first).abs() as u32;
        // a multiple of the step known so far changes nothing; the test is quick for the usual powers of two
        let multiple = if step.is_power_of_two() { difference & (step - 1) == 0 } else { step != 0 && difference.is_multiple_of(step) };
        if !multiple {
            step = gcd(step, difference);
            if step == 1 {
                break;
            }
        }
    }
    Some(if step == 0 { 1.0 } else { step as f32 })
}

fn gcd(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { gcd(b, a % b) }
}

fn edges(length: usize) -> Vec<usize> {
    let cells = ((length + CELL_PX / 2) / CELL_PX).max(1);
    (0..=cells).map(|i| i * length / cells).collect()
}

fn axis(edges: &[usize]) -> Vec<Axis> {
    let centre = |i: usize| (edges[i] + edges[i + 1] - 1) as f32 / 2.0;
    let last = edges.len() - 2;
    let mut low = 0;
    (0..edges[last + 1])
        .map(|pixel| {
            let at = pixel as f32;
            while low + 1 < last && at >= centre(low + 1) {
                low += 1;
            }
            let high = (low + 1).min(last);
            let gap = centre(high) - centre(low);
            // beyond the outermost centres the slope is carried on
            let share = if gap > 0.0 { (at - centre(low)) / gap } else { 0.0 };
            Axis { low, high, share }
        })
        .collect()
}

impl Background {
    /// The same level and noise everywhere, DN.
    pub(super) fn even(frame: &Frame, level_dn: f64, noise_dn: f64) -> Self {
        let (x_edges, y_edges) = (edges(frame.width_px), edges(frame.height_px));
        let cells = (x_edges.len() - 1) * (y_edges.len() - 1);
        Self {
            columns: axis(&x_edges),
            rows: axis(&y_edges),
            cells_x: x_edges.len() - 1,
            level: vec![level_dn as f32; cells],
            noise: vec![noise_dn as f32; cells],
            row_offset: vec![0.0; frame.height_px],
            least: 0.0,
            floor_dn: noise_dn,
            is_cut: false,
            is_in_blocks: false,
            before_cut: None,
        }
    }

    /// Measures level and noise. `masked` pixels (hot, saturated) are left out.
    pub(super) fn measure(frame: &Frame, masked: &[bool]) -> Self {
        let (x_edges, y_edges) = (edges(frame.width_px), edges(frame.height_px));
        let largest = frame.pixels_dn.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
        let quantum = quantum_dn(&frame.pixels_dn);
        // counts that are not whole have no step; what is left is the rounding of f32 in the sums that made them
        let floor_dn = quantum.map_or(f64::from(largest) * 1e-6, |q| f64::from(q) * ROUNDING_SIGMA).max(1e-9);
        let least = quantum.map_or(0.0, |q| 1.5 * f64::from(q));
        let cells_x = x_edges.len() - 1;
        let mut background = Self {
            columns: axis(&x_edges),
            rows: axis(&y_edges),
            cells_x,
            level: Vec::new(),
            noise: Vec::new(),
            row_offset: vec![0.0; frame.height_px],
            least,
            floor_dn,
            is_cut: false,
            is_in_blocks: false,
            before_cut: None,
        };
        background.measure_cells(frame, masked, &x_edges, &y_edges, least);
        if background.measure_rows(frame, masked, least) {
            background.measure_cells(frame, masked, &x_edges, &y_edges, least);
        }
        background.measure_noise(frame, masked, &x_edges, &y_edges, least);
        if let Some(cut) = black::cut_noise(frame, masked, background.floor_dn) {
            background.is_in_blocks = cut.is_in_blocks(frame);
            background.raise_noise(&cut, &x_edges, &y_edges);
        }
        background
    }

    /// Where black is cut off the noise is what it was before.
    fn raise_noise(&mut self, cut: &CutNoise, x_edges: &[usize], y_edges: &[usize]) {
        self.is_cut = cut.is_everywhere();
        for (cell, noise) in self.noise.iter_mut().enumerate() {
            let middle = |edges: &[usize], i: usize| usize::midpoint(edges[i], edges[i + 1]);
            let before = cut.at(middle(x_edges, cell % self.cells_x), middle(y_edges, cell / self.cells_x));
            *noise = noise.max(before as f32);
        }
        self.before_cut = Some(cut.clone());
    }

    /// Measures the noise of the cells again, now that slopes within them are known and do not count as noise.
    fn measure_noise(&mut self, frame: &Frame, masked: &[bool], x_edges: &[usize], y_edges: &[usize], least: f64) {
        let measured = self.measure_residuals(frame, x_edges, y_edges, least, |i| !masked[i]);
        for (noise, (c, _)) in self.noise.iter_mut().zip(measured).filter_map(|(n, m)| m.map(|m| (n, m))) {
            *noise = noise.min(c.sigma.max(self.floor_dn) as f32);
        }
    }

    /// Measures level and noise again, leaving out pixels that stars light, in cells where enough pixels are left.
    pub(super) fn refine(&mut self, frame: &Frame, masked: &[bool], lit: &[bool]) {
        const MIN_LEFT: usize = 8;
        let (x_edges, y_edges) = (edges(frame.width_px), edges(frame.height_px));
        let measured = self.measure_residuals(frame, &x_edges, &y_edges, self.least, |i| !masked[i] && !lit[i]);
        for (cell, (c, left)) in measured.into_iter().enumerate().filter_map(|(i, m)| m.map(|m| (i, m))) {
            if left * MIN_LEFT > CELL_PX * CELL_PX {
                self.level[cell] += c.mean as f32;
                self.noise[cell] = c.sigma.max(self.floor_dn) as f32;
            }
        }
        if let Some(cut) = self.before_cut.take() {
            self.raise_noise(&cut, &x_edges, &y_edges);
        }
    }

    /// Mean and scatter of what the present background leaves in each cell, and of how many pixels.
    fn measure_residuals(
        &self,
        frame: &Frame,
        x_edges: &[usize],
        y_edges: &[usize],
        least: f64,
        usable: impl Fn(usize) -> bool + Sync,
    ) -> Vec<Option<(Clipped, usize)>> {
        let bands: Vec<Vec<Option<(Clipped, usize)>>> = parallel::map_numbers(y_edges.len().saturating_sub(1), |band| {
            let mut cells = vec![Vec::with_capacity(4 * CELL_PX * CELL_PX); self.cells_x];
            let mut residual = vec![0.0; frame.width_px];
            for y in y_edges[band]..y_edges[band + 1] {
                self.subtract_row(frame, y, &mut residual);
                let row = y * frame.width_px;
                for (cell, edge) in cells.iter_mut().zip(x_edges.windows(2)) {
                    cell.extend((edge[0]..edge[1]).filter(|&x| usable(row + x)).map(|x| residual[x]));
                }
            }
            cells.iter().map(|values| clipped(values, least).map(|c| (c, values.len()))).collect()
        });
        bands.into_iter().flatten().collect()
    }

    fn measure_cells(&mut self, frame: &Frame, masked: &[bool], x_edges: &[usize], y_edges: &[usize], least: f64) {
        let cells = self.cells_x * (y_edges.len() - 1);
        let measured: Vec<Option<(f32, f32)>> = parallel::map_numbers(cells, |cell| {
            let (cx, cy) = (cell % self.cells_x, cell / self.cells_x);
            let mut values = Vec::with_capacity(4 * CELL_PX * CELL_PX);
            for y in y_edges[cy]..y_edges[cy + 1] {
                let row = y * frame.width_px;
                let (from, to) = (row + x_edges[cx], row + x_edges[cx + 1]);
                let offset = self.row_offset[y];
                let pixels = frame.pixels_dn[from..to].iter().zip(&masked[from..to]);
                values.extend(pixels.filter(|(_, out)| !**out).map(|(v, _)| v - offset));
            }
            if values.len() * 4 < (x_edges[cx + 1] - x_edges[cx]) * (y_edges[cy + 1] - y_edges[cy]) {
                return None;
            }
            clipped(&values, least).map(|c| (c.mean as f32, c.sigma.max(self.floor_dn) as f32))
        });
        let fallback = || {
            let middle = |pick: fn(&(f32, f32)) -> f32| {
                median_in_place(&mut measured.iter().flatten().map(|m| f64::from(pick(m))).collect::<Vec<_>>())
            };
            match (middle(|m| m.0), middle(|m| m.1)) {
                (Some(level), Some(noise)) => (level as f32, noise as f32),
                _ => (frame.saturation_dn, self.floor_dn as f32),
            }
        };
        let fallback = fallback();
        let raw: Vec<(f32, f32)> = measured.iter().map(|m| m.unwrap_or(fallback)).collect();
        let smooth: Vec<(f32, f32)> = (0..cells).map(|cell| self.tamed(&raw, cell)).collect();
        self.level = smooth.iter().map(|c| c.0).collect();
        self.noise = smooth.iter().map(|c| c.1).collect();
    }

    /// The cell's values, the level replaced by the median of its neighbours where a bright star or an object has lifted it.
    fn tamed(&self, raw: &[(f32, f32)], cell: usize) -> (f32, f32) {
        let (cx, cy) = (cell % self.cells_x, cell / self.cells_x);
        let cells_y = raw.len() / self.cells_x;
        let around = |c: usize, n: usize| c.saturating_sub(1)..(c + 2).min(n);
        let mut levels = Vec::with_capacity(8);
        let mut noises = Vec::with_capacity(8);
        for y in around(cy, cells_y) {
            for x in around(cx, self.cells_x).filter(|&x| (x, y) != (cx, cy)) {
                let (level, noise) = raw[y * self.cells_x + x];
                levels.push(f64::from(level));
                noises.push(f64::from(noise));
            }
        }
        let own = raw[cell];
        let (Some(level), Some(noise)) = (median_in_place(&mut levels), median_in_place(&mut noises)) else {
            return own;
        };
        let mut deviations: Vec<f64> = levels.iter().map(|v| (v - level).abs()).collect();
        let spread = median_in_place(&mut deviations).unwrap_or(0.0) * crate::statistics::robust::SIGMA_PER_MAD;
        let lifted = f64::from(own.0) > level + 4.0 * spread + 0.3 * noise;
        (if lifted { level as f32 } else { own.0 }, own.1)
    }

    /// Measures offsets of rows from the mesh; keeps them, and says so, where they scatter more than the noise makes them.
    fn measure_rows(&mut self, frame: &Frame, masked: &[bool], least: f64) -> bool {
        const MIN_COLUMNS: usize = 64;
        if frame.width_px < MIN_COLUMNS {
            return false;
        }
        let rows: Vec<(f64, f64)> = parallel::map_numbers(frame.height_px, |y| {
            let mut residual = vec![0.0; frame.width_px];
            self.subtract_row(frame, y, &mut residual);
            let start = y * frame.width_px;
            let kept: Vec<f32> =
                residual.iter().zip(&masked[start..start + frame.width_px]).filter(|(_, out)| !**out).map(|(v, _)| *v).collect();
            clipped(&kept, least).map_or((0.0, 0.0), |c| (c.mean, c.sigma.max(self.floor_dn) / (c.kept.max(1) as f64).sqrt()))
        });
        let mean_square = rows.iter().map(|r| r.0 * r.0).sum::<f64>() / rows.len() as f64;
        let expected = rows.iter().map(|r| r.1 * r.1).sum::<f64>() / rows.len() as f64;
        if mean_square < 4.0 * expected {
            return false;
        }
        self.row_offset = rows.iter().map(|r| r.0 as f32).collect();
        true
    }

    fn interpolate(&self, mesh: &[f32], x: usize, y: usize) -> f32 {
        let (c, r) = (self.columns[x], self.rows[y]);
        let at = |row: usize, column: usize| mesh[row * self.cells_x + column];
        let top = at(r.low, c.low) + c.share * (at(r.low, c.high) - at(r.low, c.low));
        let bottom = at(r.high, c.low) + c.share * (at(r.high, c.high) - at(r.high, c.low));
        top + r.share * (bottom - top)
    }

    /// Level at a pixel, DN.
    pub(super) fn level_dn(&self, x: usize, y: usize) -> f64 {
        f64::from(self.interpolate(&self.level, x, y) + self.row_offset[y])
    }

    /// Slope of the mesh level at a pixel, DN per px, in x and y.
    pub(super) fn slope_dn(&self, x: usize, y: usize) -> [f64; 2] {
        let between = |low: f32, high: f32, steps: usize| f64::from(high - low) / steps.max(1) as f64;
        let (x0, x1) = (x.saturating_sub(4), (x + 4).min(self.columns.len() - 1));
        let (y0, y1) = (y.saturating_sub(4), (y + 4).min(self.rows.len() - 1));
        let mesh = &self.level;
        [
            between(self.interpolate(mesh, x0, y), self.interpolate(mesh, x1, y), x1 - x0),
            between(self.interpolate(mesh, x, y0), self.interpolate(mesh, x, y1), y1 - y0),
        ]
    }

    /// Noise of a pixel, DN.
    pub(super) fn noise_dn(&self, x: usize, y: usize) -> f64 {
        f64::from(self.interpolate(&self.noise, x, y)).max(self.floor_dn)
    }

    /// Median level and noise over the frame, DN.
    pub(super) fn typical(&self) -> (f64, f64) {
        let middle = |mesh: &[f32]| median_in_place(&mut mesh.iter().map(|&v| f64::from(v)).collect::<Vec<_>>()).unwrap_or(0.0);
        (middle(&self.level), middle(&self.noise))
    }

    /// Row `y` of the frame less the background, DN.
    pub(super) fn subtract_row(&self, frame: &Frame, y: usize, out: &mut [f32]) {
        self.along_row(&self.level, y, |x, level| out[x] = frame.pixels_dn[y * frame.width_px + x] - level - self.row_offset[y]);
    }

    /// The noise of row `y`, DN.
    pub(super) fn noise_row(&self, y: usize, out: &mut [f32]) {
        let floor = self.floor_dn as f32;
        self.along_row(&self.noise, y, |x, noise| out[x] = noise.max(floor));
    }

    fn along_row(&self, mesh: &[f32], y: usize, mut each: impl FnMut(usize, f32)) {
        let r = self.rows[y];
        let line: Vec<f32> = (0..self.cells_x)
            .map(|i| {
                let (low, high) = (mesh[r.low * self.cells_x + i], mesh[r.high * self.cells_x + i]);
                low + r.share * (high - low)
            })
            .collect();
        for (x, c) in self.columns.iter().enumerate() {
            each(x, line[c.low] + c.share * (line[c.high] - line[c.low]));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_step_of_the_counts_is_found() {
        assert_eq!(quantum_dn(&[0.0, 16.0, 160.0, 48.0]), Some(16.0));
        assert_eq!(quantum_dn(&[5.0; 9]), Some(1.0));
        assert_eq!(quantum_dn(&[7.0, 37.0, 22.0]), Some(15.0));
        assert_eq!(quantum_dn(&[0.5, 1.0]), None);
        let joined = |i: u32| ((2126.0 * f64::from(i % 3) + 7152.0 * f64::from(i % 5) + 722.0 * f64::from(i % 7)) / 1e4) as f32;
        assert_eq!(quantum_dn(&(0..400).map(joined).collect::<Vec<_>>()), Some(JOINED_STEP));
        assert_eq!(quantum_dn(&(0..400).map(|i| (f64::from(i) * 0.618_034).fract() as f32).collect::<Vec<_>>()), None);
    }

    #[test]
    fn a_slope_is_followed_to_the_edge() {
        let (w, h) = (200, 150);
        let pixels_dn = (0..w * h).map(|i| (10.0 + 0.5 * (i % w) as f32 + 0.25 * (i / w) as f32).round()).collect();
        let frame = Frame { width_px: w, height_px: h, pixels_dn, saturation_dn: 65535.0 };
        let b = Background::measure(&frame, &vec![false; w * h]);
        for (x, y) in [(0, 0), (199, 149), (100, 0), (57, 80)] {
            let truth = 10.0 + 0.5 * x as f64 + 0.25 * y as f64;
            assert!((b.level_dn(x, y) - truth).abs() < 0.6, "({x}, {y}): {} for {truth}", b.level_dn(x, y));
        }
        assert!(b.noise_dn(100, 75) < 0.5, "slope taken for noise: {}", b.noise_dn(100, 75));
        let slope = b.slope_dn(100, 75);
        assert!((slope[0] - 0.5).abs() < 0.05, "{slope:?}");
    }
}

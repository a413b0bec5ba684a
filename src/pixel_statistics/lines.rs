//! Rows, columns and halves: banding, columns of two amplifiers, a step in the middle.
//!
//! What a row adds to all its pixels shows in both of its halves: the covariance of the two halves' means over the rows is the variance of the row
//! offsets, free of the noise of the pixels and of any correlation of short range. Columns likewise with upper and lower halves.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::sky_pixels::{BLOCK_PX, SkyPixels};

/// A row (or column) half with fewer sky pixels says nothing.
const MIN_HALF_PX: usize = 24;
/// Of the variance of row offsets, the plane that was taken out of every block leaves this share.
pub(crate) const KEPT_BY_PLANE: f64 = 1.0 - 2.0 / BLOCK_PX as f64;

/// Of alternating columns a block's plane takes this share: its slope follows them a little.
const TAKEN_FROM_PARITY: f64 = 64.0 / (340.0 * BLOCK_PX as f64);

/// A number with its standard error.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Estimate {
    /// Value.
    pub value: f64,
    /// Its standard error; of a variance, where nothing is there.
    pub sigma: f64,
}

impl Estimate {
    /// Deviation from zero in standard errors.
    #[must_use]
    pub fn deviation(&self) -> f64 {
        if self.sigma > 0.0 { self.value / self.sigma } else { 0.0 }
    }

    /// The mean of several, weighted by their standard errors; nothing of none.
    pub(crate) fn pooled(of: &[Self]) -> Option<Self> {
        let (mut sum, mut weight) = (0.0, 0.0);
        for one in of.iter().filter(|one| one.sigma > 0.0 && one.sigma.is_finite()) {
            sum += one.value / (one.sigma * one.sigma);
            weight += 1.0 / (one.sigma * one.sigma);
        }
        (weight > 0.0).then(|| Self { value: sum / weight, sigma: 1.0 / weight.sqrt() })
    }
}

/// What the noise of one frame shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FrameNoise {
    /// Number of the frame in the recording.
    pub frame: usize,
    /// Exposure time, s.
    pub exposure_s: Option<f64>,
    /// Level of the sky, DN.
    pub level_dn: f64,
    /// Noise of a sky pixel, DN.
    pub sigma_dn: f64,
    /// Variance of what rows add to all their pixels, DN².
    pub row_variance_dn2: Option<Estimate>,
    /// The same of columns.
    pub column_variance_dn2: Option<Estimate>,
    /// Half the difference of odd and even columns, of odd and even rows, of the diagonals of a 2 × 2 cell, DN.
    pub parity_dn: Option<[Estimate; 3]>,
    /// Step of the level at the middle column, DN.
    pub middle_step_dn: Option<Estimate>,
}

/// What the rows and columns of one frame show.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct FrameLines {
    /// Variance of row offsets, DN².
    pub(super) rows: Option<Estimate>,
    /// Variance of column offsets, DN².
    pub(super) columns: Option<Estimate>,
    /// Half the difference of odd and even columns, of odd and even rows, and of the two diagonals of a 2 × 2 cell, DN.
    pub(super) parity: Option<[Estimate; 3]>,
    /// What the right half has more than the left one at the middle column, DN.
    pub(super) step: Option<Estimate>,
    /// Mean of every row, DN; NaN where it has no sky.
    pub(super) row_means: Vec<f32>,
    /// Mean of every column.
    pub(super) column_means: Vec<f32>,
    /// Means of the left and the right half of every row, DN; NaN where one has no sky.
    pub(super) row_halves: Vec<[f32; 2]>,
    /// Of the upper and the lower half of every column.
    pub(super) column_halves: Vec<[f32; 2]>,
}

impl FrameLines {
    pub(super) fn new(sky: &SkyPixels) -> Self {
        let Some(sigma_dn) = sky.sigma_dn() else { return Self::default() };
        let [rows, columns] = half_means(sky);
        let (of_rows, of_columns) = (covariance(&rows), covariance(&columns));
        // Offsets of the lines by chance make a difference of odd and even ones.
        let by_chance =
            |variance: Option<Estimate>, lines: usize| variance.map_or(0.0, |own| own.value.max(0.0) / lines.max(1) as f64).sqrt();
        let parity = parity(sky, sigma_dn).map(|[x, y, diagonal]| {
            let wider = |own: Estimate, by: f64| Estimate { sigma: own.sigma.hypot(by), ..own };
            [wider(x, by_chance(of_columns, sky.width_px)), wider(y, by_chance(of_rows, sky.height_px)), diagonal]
        });
        let ([row_means, column_means], [row_halves, column_halves]) =
            ([&rows, &columns].map(means), [&rows, &columns].map(means_of_halves));
        Self { rows: of_rows, columns: of_columns, parity, step: step(sky), row_means, column_means, row_halves, column_halves }
    }

    /// What the means of its row and its column add to a pixel, DN.
    pub(super) fn of_pixel(&self, [x, y]: [usize; 2]) -> f32 {
        let or_zero = |mean: f32| if mean.is_nan() { 0.0 } else { mean };
        or_zero(self.row_means[y]) + or_zero(self.column_means[x])
    }

    /// The lines whose means are taken off both pixels so far apart: of two in one row all rows, of two in one column all columns.
    pub(super) fn told_along(&self, [dx, dy]: [isize; 2]) -> usize {
        let told = |means: &[f32]| means.iter().filter(|mean| !mean.is_nan()).count();
        match (dx, dy) {
            (_, 0) => told(&self.row_means),
            (0, _) => told(&self.column_means),
            _ => 0,
        }
    }
}

/// Sums and numbers of the sky pixels of the two halves of every line.
type Halves = Vec<[(f64, usize); 2]>;

fn half_means(sky: &SkyPixels) -> [Halves; 2] {
    let mut rows = vec![[(0.0, 0); 2]; sky.height_px];
    let mut columns = vec![[(0.0, 0); 2]; sky.width_px];
    let (middle_x, middle_y) = (sky.width_px / 2, sky.height_px / 2);
    let event: std::collections::HashSet<usize> = sky.events.iter().copied().collect();
    for (y, line) in sky.residual_dn.chunks(sky.width_px).enumerate() {
        for (x, residual) in line.iter().enumerate() {
            if residual.is_nan() || (!event.is_empty() && event.contains(&(y * sky.width_px + x))) {
                continue;
            }
            let residual = f64::from(*residual);
            for half in [&mut rows[y][usize::from(x >= middle_x)], &mut columns[x][usize::from(y >= middle_y)]] {
                half.0 += residual;
                half.1 += 1;
            }
        }
    }
    [rows, columns]
}

fn means(lines: &Halves) -> Vec<f32> {
    let mean = |halves: &[(f64, usize); 2]| {
        let (sum, count) = (halves[0].0 + halves[1].0, halves[0].1 + halves[1].1);
        if count >= 2 * MIN_HALF_PX { (sum / count as f64) as f32 } else { f32::NAN }
    };
    lines.iter().map(mean).collect()
}

fn means_of_halves(lines: &Halves) -> Vec<[f32; 2]> {
    let mean = |(sum, count): (f64, usize)| if count >= MIN_HALF_PX { (sum / count as f64) as f32 } else { f32::NAN };
    lines.iter().map(|halves| halves.map(mean)).collect()
}

/// Covariance of the two halves' means over the lines; columns of two kinds are no offsets, so the means of odd and even lines are taken out.
fn covariance(lines: &Halves) -> Option<Estimate> {
    let told = |(line, halves): (usize, &[(f64, usize); 2])| {
        halves.iter().all(|half| half.1 >= MIN_HALF_PX).then(|| (line % 2, halves.map(|half| half.0 / half.1 as f64)))
    };
    let all: Vec<(usize, [f64; 2])> = lines.iter().enumerate().filter_map(told).collect();
    if all.len() < 2 * BLOCK_PX {
        return None;
    }
    let mut mean = [[(0.0, 0.0); 2]; 2];
    for (parity, halves) in &all {
        for half in 0..2 {
            mean[*parity][half].0 += halves[half];
            mean[*parity][half].1 += 1.0_f64;
        }
    }
    let mean = mean.map(|of| of.map(|(sum, count)| sum / count.max(1.0)));
    let rest: Vec<[f64; 2]> = all.iter().map(|(parity, halves)| [0, 1].map(|half| halves[half] - mean[*parity][half])).collect();
    let count = rest.len() as f64;
    let product = |a: usize, b: usize| rest.iter().map(|halves| halves[a] * halves[b]).sum::<f64>() / count;
    let lost = 1.0 - 2.0 / count;
    let value = product(0, 1) / (KEPT_BY_PLANE * lost);
    // Without offsets the halves are independent: the variance of their product is the product of their variances. What the plane of a block leaves of its
    // lines is so many fewer independent ones.
    let sigma = (product(0, 0) * product(1, 1) / (KEPT_BY_PLANE * count)).sqrt() / (KEPT_BY_PLANE * lost);
    (sigma > 0.0).then_some(Estimate { value, sigma })
}

fn parity(sky: &SkyPixels, sigma_dn: f64) -> Option<[Estimate; 3]> {
    let mut cells = [(0.0, 0.0); 4];
    let reach = 4.0 * sigma_dn;
    for (y, line) in sky.residual_dn.chunks(sky.width_px).enumerate() {
        for (x, residual) in line.iter().enumerate() {
            let residual = f64::from(*residual);
            if residual.abs() < reach {
                let cell = &mut cells[x % 2 + 2 * (y % 2)];
                cell.0 += residual;
                cell.1 += 1.0;
            }
        }
    }
    if cells.iter().any(|cell| cell.1 < 256.0) {
        return None;
    }
    // Of a mosaic the means were taken out before.
    let mean: [f64; 4] = std::array::from_fn(|cell| cells[cell].0 / cells[cell].1 + sky.cells_dn[cell]);
    let sigma = 0.25 * sigma_dn * cells.iter().map(|cell| 1.0 / cell.1).sum::<f64>().sqrt();
    let half = |signs: [f64; 4], kept: f64| {
        let value = 0.25 * (0..4).map(|k| signs[k] * mean[k]).sum::<f64>();
        Estimate { value: value / kept, sigma: sigma / kept }
    };
    let kept = 1.0 - TAKEN_FROM_PARITY;
    Some([half([-1.0, 1.0, -1.0, 1.0], kept), half([-1.0, -1.0, 1.0, 1.0], kept), half([1.0, -1.0, -1.0, 1.0], 1.0)])
}

/// The step of the level at the block border nearest to the middle column, against the steps at all other borders.
fn step(sky: &SkyPixels) -> Option<Estimate> {
    const MIN_BORDERS: usize = 8;
    let [along, _] = sky.shape;
    let mut level = std::collections::BTreeMap::new();
    for block in &sky.blocks {
        level.insert((block.place[1], block.place[0]), block);
    }
    // The columns on both sides of a border carried on to it by their own slopes.
    let half = BLOCK_PX as f64 / 2.0;
    let at_border = |border: usize| -> Option<f64> {
        let steps: Vec<f64> = (0..sky.shape[1])
            .filter_map(|row| {
                let (left, right) = (level.get(&(row, border - 1))?, level.get(&(row, border))?);
                Some(right.level_dn - half * right.slope_dn[0] - left.level_dn - half * left.slope_dn[0])
            })
            .collect();
        (steps.len() * 2 > sky.shape[1]).then(|| crate::statistics::median(&steps)).flatten()
    };
    // Only where a border of blocks is the middle of the frame.
    if !sky.width_px.is_multiple_of(2 * BLOCK_PX) {
        return None;
    }
    let middle = along / 2;
    let value = at_border(middle)?;
    let others: Vec<f64> = (1..along).filter(|border| *border != middle).filter_map(at_border).collect();
    if others.len() < MIN_BORDERS {
        return None;
    }
    let square = others.iter().map(|step| step * step).sum::<f64>() / others.len() as f64;
    Some(Estimate { value, sigma: square.sqrt() })
}

/// What the rows and columns of a recording show.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LineStatistics {
    /// Variance of what rows add to all their pixels, DN².
    pub row_variance_dn2: Option<Estimate>,
    /// The same of columns.
    pub column_variance_dn2: Option<Estimate>,
    /// Half the difference of odd and even columns, DN.
    pub column_parity_dn: Option<Estimate>,
    /// Half the difference of odd and even rows, DN.
    pub row_parity_dn: Option<Estimate>,
    /// Half the difference of the diagonals of a 2 × 2 cell, DN: a colour mosaic.
    pub diagonal_parity_dn: Option<Estimate>,
    /// Step of the level at the middle column, DN.
    pub middle_step_dn: Option<Estimate>,
    /// Correlation from frame to frame of the rows' means: 1 if rows are always the same.
    pub row_persistence: Option<Estimate>,
    /// The same of columns.
    pub column_persistence: Option<Estimate>,
}

impl LineStatistics {
    /// Of all frames.
    pub(super) fn of(frames: &[FrameLines]) -> Self {
        let pooled = |pick: &dyn Fn(&FrameLines) -> Option<Estimate>| Estimate::pooled(&frames.iter().filter_map(pick).collect::<Vec<_>>());
        let parity = |which: usize| pooled(&|frame: &FrameLines| frame.parity.map(|parity| parity[which]));
        Self {
            row_variance_dn2: pooled(&|frame| frame.rows),
            column_variance_dn2: pooled(&|frame| frame.columns),
            column_parity_dn: parity(0),
            row_parity_dn: parity(1),
            diagonal_parity_dn: parity(2),
            middle_step_dn: pooled(&|frame| frame.step),
            row_persistence: persistence(frames.iter().map(|frame| &frame.row_means[..])),
            column_persistence: persistence(frames.iter().map(|frame| &frame.column_means[..])),
        }
    }
}

/// Mean correlation of every frame's line means with those of the next one.
fn persistence<'a>(frames: impl Iterator<Item = &'a [f32]>) -> Option<Estimate> {
    let frames: Vec<&[f32]> = frames.filter(|means| !means.is_empty()).collect();
    let of_pair = |pair: &[&[f32]]| {
        let (mut product, mut first, mut second, mut count) = (0.0, 0.0, 0.0, 0.0_f64);
        for (a, b) in pair[0].iter().zip(pair[1]).filter(|(a, b)| !a.is_nan() && !b.is_nan()) {
            let (a, b) = (f64::from(*a), f64::from(*b));
            (product, first, second, count) = (product + a * b, first + a * a, second + b * b, count + 1.0);
        }
        (count > 2.0 && first > 0.0 && second > 0.0)
            .then(|| Estimate { value: product / (first * second).sqrt(), sigma: 1.0 / count.sqrt() })
    };
    // Every second pair, so that none shares a frame with another.
    Estimate::pooled(&frames.chunks_exact(2).filter_map(of_pair).collect::<Vec<_>>())
}

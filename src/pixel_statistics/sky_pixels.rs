//! Sky pixels of a frame less their local level: what is left is noise, pattern and defects.
//!
//! The frame is cut into blocks. In each the pixels that no star lights are fitted by a plane; level and variance of the block come from the fit, what
//! remains of each pixel is kept. Means over the four places of a 2 × 2 cell are taken out of the variance, so that neither a colour mosaic nor
//! columns of two amplifiers count as noise. Of a colour mosaic they are taken out of the pixels too: each colour has a level of its own, which is no
//! pattern, no hot pixel and no noise. A block of one value (a border of stacked frames, a clipped corner) has no noise to measure by, and is no sky.

use crate::frame::Frame;

/// Side of a block, px: small beside vignetting and glow, large beside the six numbers that a block gives up.
pub(super) const BLOCK_PX: usize = 16;
/// Its middle, px.
const MIDDLE_PX: f64 = (BLOCK_PX - 1) as f64 / 2.0;
/// A block with fewer sky pixels says nothing.
const MIN_SKY_PX: usize = BLOCK_PX * BLOCK_PX / 2;
/// Numbers fitted in a block: a plane, and the means of a 2 × 2 cell beside its own.
const FITTED: usize = 6;
/// A pixel farther from its block's plane than this is an event (a cosmic ray, a hot pixel, a star that was not found) and takes no part in the fit.
pub(super) const EVENT_SIGMAS: f64 = 5.0;
/// A variance below the square of this share of the level is the rounding of sums over pixels of one value.
const ROUNDING_SHARE: f64 = 1e-9;
/// The diagonals of a 2 × 2 cell differ by twice this share of the noise at least in a colour mosaic, whose greens lie on one of them,
pub(super) const MIN_MOSAIC_SIGMAS: f64 = 0.1;
/// and by so many standard errors.
pub(super) const MIN_MOSAIC_ERRORS: f64 = 6.0;
/// What is no sky pixel.
pub(super) const NOT_SKY: f32 = f32::NAN;

/// Level and noise of the sky in one block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Block {
    /// Column and row of the block among the blocks.
    pub(super) place: [usize; 2],
    /// Level in the middle of the block, DN.
    pub(super) level_dn: f64,
    /// Slope of the level along x and y, DN per px.
    pub(super) slope_dn: [f64; 2],
    /// Variance of a pixel, DN².
    pub(super) variance_dn2: f64,
    /// Sky pixels.
    pub(super) pixels: usize,
}

/// The sky pixels of a frame.
#[derive(Clone, Debug)]
pub(super) struct SkyPixels {
    pub(super) width_px: usize,
    pub(super) height_px: usize,
    /// Counts less the plane of their block (in a mosaic less the mean of their colour there too), DN, row by row; NaN where a pixel is no sky.
    pub(super) residual_dn: Vec<f32>,
    /// Blocks that have sky enough, row by row.
    pub(super) blocks: Vec<Block>,
    /// Blocks along x and y.
    pub(super) shape: [usize; 2],
    /// Places of events.
    pub(super) events: Vec<usize>,
    /// Means of the four places of a 2 × 2 cell above the planes, DN, where the frame is a mosaic and they were taken out; else zero.
    pub(super) cells_dn: [f64; 4],
    /// Noise of each of the four over that of all, in a mosaic: less light has less noise. Else one.
    pub(super) cell_noise: [f64; 4],
}

impl SkyPixels {
    /// Of a frame; `is_sky` tells of every pixel, row by row, that no star lights it and nothing is wrong with it.
    pub(super) fn new(frame: &Frame, is_sky: &[bool]) -> Self {
        let (width_px, height_px) = (frame.width_px, frame.height_px);
        let shape = [width_px / BLOCK_PX, height_px / BLOCK_PX];
        let residual_dn = vec![NOT_SKY; width_px * height_px];
        let (blocks, events) = (Vec::new(), Vec::new());
        let mut sky = Self { width_px, height_px, residual_dn, blocks, shape, events, cells_dn: [0.0; 4], cell_noise: [1.0; 4] };
        let mut cells_dn = Vec::new();
        let mut pixels = Vec::with_capacity(BLOCK_PX * BLOCK_PX);
        for (row, column) in (0..shape[1]).flat_map(|row| (0..shape[0]).map(move |column| (row, column))) {
            pixels.clear();
            for y in row * BLOCK_PX..(row + 1) * BLOCK_PX {
                let line = y * width_px;
                let sky = (line + column * BLOCK_PX..line + (column + 1) * BLOCK_PX).filter(|index| is_sky[*index]);
                pixels.extend(
                    sky.map(|index| Pixel::new(index, index - line - column * BLOCK_PX, y - row * BLOCK_PX, frame.pixels_dn[index])),
                );
            }
            cells_dn.extend(sky.add([column, row], &mut pixels));
        }
        sky.take_mosaic_out(&cells_dn);
        sky
    }

    /// Adds a block, and gives the means of its 2 × 2 cell; nothing where it tells nothing.
    fn add(&mut self, place: [usize; 2], pixels: &mut [Pixel]) -> Option<[f64; 4]> {
        let Fitted { plane, cells_dn, variance_dn2, kept } = fitted(pixels)?;
        if variance_dn2.sqrt() <= ROUNDING_SHARE * plane[0].abs() {
            return None;
        }
        for pixel in &*pixels {
            self.residual_dn[pixel.index] = pixel.rest(&plane) as f32;
            if pixel.is_event {
                self.events.push(pixel.index);
            }
        }
        self.blocks.push(Block { place, level_dn: plane[0], slope_dn: [plane[1], plane[2]], variance_dn2, pixels: kept });
        Some(cells_dn)
    }

    /// Of a mosaic, takes the means of the colours out of the pixels, block by block: their contrast goes with the light of the place.
    fn take_mosaic_out(&mut self, cells_dn: &[[f64; 4]]) {
        let Some(sigma_dn) = self.sigma_dn() else { return };
        let pixels: usize = self.blocks.iter().map(|block| block.pixels).sum();
        let diagonals: Vec<f64> = cells_dn.iter().map(|own| 0.25 * (own[0] - own[1] - own[2] + own[3])).collect();
        let least_dn = sigma_dn * MIN_MOSAIC_SIGMAS.max(MIN_MOSAIC_ERRORS / (pixels as f64).sqrt());
        if crate::statistics::median(&diagonals).is_none_or(|diagonal| diagonal.abs() <= least_dn) {
            return;
        }
        let mut squares = [(0.0, 0.0); 4];
        for (number, of_block) in cells_dn.iter().enumerate() {
            let (block, mut own, mut slope_dn) = (self.blocks[number], *of_block, [0.0; 2]);
            if let Some([a, b, c, d, along, down]) = self.colours(&block, &own) {
                (own, slope_dn) = ([a, b, c, d], [along, down]);
            }
            self.blocks[number].slope_dn = [0, 1].map(|axis| block.slope_dn[axis] + slope_dn[axis]);
            for (y, x) in (0..BLOCK_PX).flat_map(|y| (0..BLOCK_PX).map(move |x| (y, x))) {
                let index = (block.place[1] * BLOCK_PX + y) * self.width_px + block.place[0] * BLOCK_PX + x;
                let cell = x % 2 + 2 * (y % 2);
                let [along, down] = [x, y].map(|place| place as f64 - MIDDLE_PX);
                self.residual_dn[index] -= (own[cell] + slope_dn[0] * along + slope_dn[1] * down) as f32;
                let square = f64::from(self.residual_dn[index]).powi(2) / block.variance_dn2;
                if square < EVENT_SIGMAS * EVENT_SIGMAS {
                    squares[cell] = (squares[cell].0 + square, squares[cell].1 + 1.0);
                }
            }
            for (all, own) in self.cells_dn.iter_mut().zip(own) {
                *all += own * block.pixels as f64 / pixels as f64;
            }
        }
        self.cell_noise = squares.map(|(sum, count): (f64, f64)| if sum > 0.0 { (sum / count).sqrt() } else { 1.0 });
    }

    /// The levels of the four places of a block's cells with what they took of its slopes: the plane, which was fitted without them, follows them a little.
    fn colours(&self, block: &Block, cells_dn: &[f64; 4]) -> Option<[f64; 6]> {
        let reach = EVENT_SIGMAS * block.variance_dn2.sqrt();
        let mut normal = nalgebra::Matrix6::zeros();
        let mut right = nalgebra::Vector6::zeros();
        for (y, x) in (0..BLOCK_PX).flat_map(|y| (0..BLOCK_PX).map(move |x| (y, x))) {
            let rest = f64::from(self.residual_dn[(block.place[1] * BLOCK_PX + y) * self.width_px + block.place[0] * BLOCK_PX + x]);
            let cell = x % 2 + 2 * (y % 2);
            if (rest - cells_dn[cell]).abs() <= reach {
                let mut row = nalgebra::Vector6::zeros();
                row[cell] = 1.0;
                (row[4], row[5]) = (x as f64 - MIDDLE_PX, y as f64 - MIDDLE_PX);
                normal += row * row.transpose();
                right += row * rest;
            }
        }
        Some(normal.cholesky()?.solve(&right).into())
    }

    /// Typical standard deviation of a sky pixel, DN; nothing where there is no sky.
    pub(super) fn sigma_dn(&self) -> Option<f64> {
        let variances: Vec<f64> = self.blocks.iter().map(|block| block.variance_dn2).collect();
        crate::statistics::median(&variances).map(f64::sqrt)
    }
}

/// A sky pixel in its block.
struct Pixel {
    index: usize,
    /// Place from the block's middle, px.
    at: [f64; 2],
    /// Which of the four of a 2 × 2 cell.
    cell: usize,
    value_dn: f64,
    is_event: bool,
}

impl Pixel {
    fn new(index: usize, x: usize, y: usize, value_dn: f32) -> Self {
        let cell = x % 2 + 2 * (y % 2);
        Self { index, at: [x as f64 - MIDDLE_PX, y as f64 - MIDDLE_PX], cell, value_dn: f64::from(value_dn), is_event: false }
    }

    fn rest(&self, plane: &[f64; 3]) -> f64 {
        self.value_dn - plane[0] - plane[1] * self.at[0] - plane[2] * self.at[1]
    }
}

/// What a block's pixels tell.
struct Fitted {
    /// Level and slopes.
    plane: [f64; 3],
    /// Means of the four places of a 2 × 2 cell above it.
    cells_dn: [f64; 4],
    /// Variance about both.
    variance_dn2: f64,
    /// Pixels that took part.
    kept: usize,
}

/// The fit of a block; events are marked and left out.
fn fitted(pixels: &mut [Pixel]) -> Option<Fitted> {
    const TURNS: usize = 4;
    let mut found = None;
    for _ in 0..TURNS {
        let kept = pixels.iter().filter(|pixel| !pixel.is_event).count();
        if kept < MIN_SKY_PX {
            return None;
        }
        let plane = plane(pixels)?;
        let mut cells = [(0.0, 0.0); 4];
        for pixel in pixels.iter().filter(|pixel| !pixel.is_event) {
            cells[pixel.cell].0 += pixel.rest(&plane);
            cells[pixel.cell].1 += 1.0;
        }
        let mean = cells.map(|(sum, count): (f64, f64)| if count > 0.0 { sum / count } else { 0.0 });
        let rest = |pixel: &Pixel| pixel.rest(&plane) - mean[pixel.cell];
        let square: f64 = pixels.iter().filter(|pixel| !pixel.is_event).map(|pixel| rest(pixel).powi(2)).sum();
        let variance = square / (kept - FITTED) as f64;
        found = Some(Fitted { plane, cells_dn: mean, variance_dn2: variance, kept });
        let reach = EVENT_SIGMAS * variance.sqrt();
        let mut is_changed = false;
        for pixel in pixels.iter_mut() {
            let is_event = rest(pixel).abs() > reach;
            is_changed |= is_event && !pixel.is_event;
            pixel.is_event |= is_event;
        }
        if !is_changed {
            break;
        }
    }
    found
}

/// Least squares of level and slopes.
fn plane(pixels: &[Pixel]) -> Option<[f64; 3]> {
    let mut normal = nalgebra::Matrix3::zeros();
    let mut right = nalgebra::Vector3::zeros();
    let offset = pixels.first()?.value_dn;
    for pixel in pixels.iter().filter(|pixel| !pixel.is_event) {
        let row = nalgebra::Vector3::new(1.0, pixel.at[0], pixel.at[1]);
        normal += row * row.transpose();
        right += row * (pixel.value_dn - offset);
    }
    let solved = normal.cholesky()?.solve(&right);
    Some([solved[0] + offset, solved[1], solved[2]])
}

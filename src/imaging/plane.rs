//! Input of plane point spreads (those that are not separable), prepared for the pixels.

use super::tiles::{Entry, Grid, Placed, TileLists, bin};
use super::{ImagingError, PlacedStar};
use crate::effects::pixel::{Atlas, MAX_NODES, Psf2d, Psf2dStar, Rows};

/// Light from one point, for a plane point spread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointSource {
    /// Column x₀.
    pub x_px: f64,
    /// Row y₀, downwards.
    pub y_px: f64,
    /// Expected electrons over the exposure.
    pub electrons: f64,
    /// How far the light moves along x and y from one row of the frame to the next (rolling shutter), px per row.
    pub shear: [f64; 2],
    /// Half the side of the square of pixels that receive light.
    pub reach_px: u16,
    /// Width σ for a round spread; 1 where the spread has other numbers.
    pub sigma_px: f64,
    /// What the spread makes of its own parameters.
    pub shape: [f32; 4],
    /// Tables of the atlas and their weights; the first with no weight ends the list.
    pub nodes: [(u32, f32); MAX_NODES],
}

impl PointSource {
    /// A point of light that every row sees in the same place, with nothing but a width.
    #[must_use]
    pub fn round(image: &PlacedStar, reach_px: u16) -> Self {
        let &PlacedStar { x_px, y_px, electrons, sigma_px } = image;
        Self { x_px, y_px, electrons, shear: [0.0; 2], reach_px, sigma_px, shape: [0.0; 4], nodes: [(0, 0.0); MAX_NODES] }
    }
}

/// Light of one plane point spread.
#[derive(Clone, Copy, Debug)]
pub struct PlaneLight<'a> {
    /// How it is spread.
    pub spread: &'static dyn Psf2d,
    /// The spread's tables; empty where it needs none.
    pub atlas: &'a Atlas,
    /// From where; their order is the order in which light is added.
    pub deposits: &'a [PointSource],
}

impl std::fmt::Debug for dyn Psf2d {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.id())
    }
}

/// The same, ready for the pixels.
#[derive(Debug)]
pub(super) struct PlaneBatch<'a> {
    pub(super) spread: &'static dyn Psf2d,
    pub(super) atlas: &'a Atlas,
    pub(super) stars: Vec<Psf2dStar>,
}

impl Placed for Psf2dStar {
    fn place(&self) -> (i32, i32) {
        (self.column, self.row)
    }
    fn reach(&self) -> i32 {
        self.reach
    }
}

impl<'a> PlaneBatch<'a> {
    /// Integer pixel and f32 fraction from places in f64; what misses the frame is left out.
    pub(super) fn new(light: &PlaneLight<'a>, width: usize, height: usize) -> Result<Self, ImagingError> {
        let mut stars = Vec::with_capacity(light.deposits.len());
        for (index, deposit) in light.deposits.iter().enumerate() {
            let problem = |what, value| ImagingError::BadStar { index, what, value };
            let numbers = [
                ("x_px", deposit.x_px),
                ("y_px", deposit.y_px),
                ("shear along x", deposit.shear[0]),
                ("shear along y", deposit.shear[1]),
                ("shape", f64::from(deposit.shape.iter().sum::<f32>())),
            ];
            if let Some((what, value)) = numbers.into_iter().find(|(_, value)| !value.is_finite()) {
                return Err(problem(what, value));
            }
            if !(0.0..=1e30).contains(&deposit.electrons) {
                return Err(problem("electrons", deposit.electrons));
            }
            if !(0.05..=1e4).contains(&deposit.sigma_px) {
                return Err(problem("sigma_px", deposit.sigma_px));
            }
            let (column, row, reach) = (deposit.x_px.round(), deposit.y_px.round(), f64::from(deposit.reach_px));
            let misses = |middle: f64, count: usize| middle + reach < 0.0 || middle - reach > count as f64 - 1.0;
            if misses(column, width) || misses(row, height) {
                continue;
            }
            stars.push(Psf2dStar {
                column: column as i32,
                row: row as i32,
                fraction_x: (deposit.x_px - column) as f32,
                fraction_y: (deposit.y_px - row) as f32,
                electrons: deposit.electrons as f32,
                inverse_sigma: (1.0 / deposit.sigma_px) as f32,
                shear_x: deposit.shear[0] as f32,
                shear_y: deposit.shear[1] as f32,
                shape: deposit.shape,
                reach: i32::from(deposit.reach_px),
                nodes: deposit.nodes.iter().take_while(|(_, weight)| *weight != 0.0).count() as u32,
                unused: [0; 2],
                node: deposit.nodes.map(|(node, _)| node),
                weight: deposit.nodes.map(|(_, weight)| weight),
            });
        }
        Ok(Self { spread: light.spread, atlas: light.atlas, stars })
    }

    /// Lists by band for the CPU.
    pub(super) fn lists(&self, grid: &Grid) -> TileLists<Psf2dStar> {
        bin(&self.stars, grid, usize::MAX, usize::MAX).swap_remove(0)
    }

    /// Adds the light of a band's list.
    pub(super) fn add(&self, lists: &TileLists<Psf2dStar>, entries: &[Entry], rows: &mut Rows<'_>) {
        for entry in entries {
            self.spread.add_plane(&lists.stars[entry.star as usize], self.atlas, rows);
        }
    }
}

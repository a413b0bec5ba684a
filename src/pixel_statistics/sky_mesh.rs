//! Level of the sky over the frame, on a coarse mesh: what glow, stray light, vignetting and halves leave between the stars.
//!
//! A cell holds many blocks. Its level is a robust mean of theirs, taken about a smooth surface through all blocks of the frame, so that neither a
//! slope within the cell nor a star that was not found moves it. The standard error follows from the noise of the pixels; where blocks scatter more
//! (faint stars), from the scatter of the blocks about their cells, pooled over the frame. With weights w of a t distribution and ψ = w·r the
//! variance of a mean is ⟨ψ²⟩/⟨ψ′⟩² times that of least squares (Huber, Robust Statistics, 1981, 3.2).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::lines::Estimate;
use super::photon_transfer::smooth_levels;
use super::sky_pixels::{BLOCK_PX, Block};
use crate::statistics::median_in_place;

/// Cells of a frame, at most.
pub(super) const MAX_CELLS: usize = 64;
/// Blocks of a cell where no star lies, on average at least.
const MIN_BLOCKS: usize = 4;
/// Degrees of freedom of the t distribution of the blocks' errors.
const TAIL_DEGREES: f64 = 4.0;
/// Median of χ² of one degree of freedom.
const MEDIAN_CHI2: f64 = 0.454_936;
/// Reweightings.
const TURNS: usize = 12;

/// Level of the sky in a cell.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SkyCell {
    /// Middle of its sky from the middle of the frame, in half-diagonals: x to the right, y down.
    pub at: [f64; 2],
    /// Level, DN.
    pub level_dn: f64,
    /// Its standard error.
    pub sigma_dn: f64,
}

/// Level of the sky over a frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SkyMesh {
    /// Number of the frame in the recording.
    pub frame: usize,
    /// Exposure, where known.
    pub exposure_s: Option<f64>,
    /// Median of the cells, DN.
    pub level_dn: f64,
    /// Noise of a sky pixel, DN.
    pub noise_dn: f64,
    /// Width and height of the frame.
    pub size_px: [usize; 2],
    /// Cells along x and y. No cell lies on both sides of the frame's middle column or row.
    pub shape: [usize; 2],
    /// The cells row by row; nothing where stars leave no sky.
    pub cells: Vec<Option<SkyCell>>,
}

/// What is known of a frame beside its blocks.
pub(super) struct MeshFrame {
    pub(super) number: usize,
    pub(super) exposure_s: Option<f64>,
    pub(super) size_px: [usize; 2],
    pub(super) noise_dn: f64,
}

impl SkyMesh {
    /// Half the diagonal of the frame, px.
    #[must_use]
    pub fn half_diagonal_px(&self) -> f64 {
        0.5 * (self.size_px[0] as f64).hypot(self.size_px[1] as f64)
    }

    /// With the scatter of rows and columns in the errors of the cells. Cells beside each other have the same rows: as their number makes a mean of them no
    /// better, each has the error of the mean of all of them, times the root of their number.
    pub(super) fn with_lines(mut self, [rows, columns]: [Option<Estimate>; 2]) -> Self {
        /// Less is no scatter of lines.
        const CLEARLY: f64 = 3.0;
        let of = |variance: Option<Estimate>, along: usize| {
            let variance = variance.filter(|own| own.value > CLEARLY * own.sigma).map_or(0.0, |own| own.value);
            variance * (self.shape[along] * self.shape[1 - along]) as f64 / self.size_px[along] as f64
        };
        let variance_dn2 = of(rows, 1) + of(columns, 0);
        for cell in self.cells.iter_mut().flatten() {
            cell.sigma_dn = cell.sigma_dn.hypot(variance_dn2.sqrt());
        }
        self
    }

    /// Of the blocks of a frame, `blocks_shape` of them along x and y; nothing where they are too few.
    pub(super) fn of(frame: &MeshFrame, blocks: &[Block], blocks_shape: [usize; 2]) -> Option<Self> {
        let surface = smooth_levels(blocks, blocks_shape)?;
        // All frames of a size have the same cells, however many blocks their stars leave: cells are held against each other by their number.
        let shape = shape(blocks_shape);
        let mut mesh = Self {
            frame: frame.number,
            exposure_s: frame.exposure_s,
            level_dn: 0.0,
            noise_dn: frame.noise_dn,
            size_px: frame.size_px,
            shape,
            cells: Vec::new(),
        };
        let mut members: Vec<Vec<Member>> = vec![Vec::new(); shape[0] * shape[1]];
        for (block, surface) in blocks.iter().zip(surface) {
            let middle_px = block.place.map(|place| (place * BLOCK_PX) as f64 + 0.5 * (BLOCK_PX as f64 - 1.0));
            let Some(place) = cell_of(middle_px, frame.size_px, shape) else { continue };
            let at = [0, 1].map(|axis| (middle_px[axis] - 0.5 * (frame.size_px[axis] as f64 - 1.0)) / mesh.half_diagonal_px());
            let sigma = (block.variance_dn2 / block.pixels as f64).sqrt();
            if sigma > 0.0 {
                members[place].push(Member { at, surface, rest: block.level_dn - surface, sigma });
            }
        }
        mesh.cells = levels(&members);
        let mut all: Vec<f64> = mesh.cells.iter().flatten().map(|cell| cell.level_dn).collect();
        mesh.level_dn = median_in_place(&mut all)?;
        Some(mesh)
    }
}

/// A block in its cell.
#[derive(Clone, Copy)]
struct Member {
    at: [f64; 2],
    /// Level of the surface there.
    surface: f64,
    /// Level above the surface, and its standard error by the noise of the pixels.
    rest: f64,
    sigma: f64,
}

/// Cells along x and y: even numbers, about square, not more than the blocks allow.
fn shape(blocks: [usize; 2]) -> [usize; 2] {
    let most = (blocks[0] * blocks[1] / MIN_BLOCKS).clamp(4, MAX_CELLS) as f64;
    let ratio = (blocks[0] as f64 / blocks[1].max(1) as f64).sqrt();
    let even = |cells: f64, most: f64| 2 * (0.5 * cells.clamp(2.0, most.max(2.0))).floor() as usize;
    let columns = even((most.sqrt() * ratio + 0.5).floor(), 0.5 * most);
    [columns, even(most / columns as f64, 0.5 * most)]
}

/// Which cell a block with this middle belongs to; none if it lies on both sides of the frame's middle.
fn cell_of(middle_px: [f64; 2], size_px: [usize; 2], shape: [usize; 2]) -> Option<usize> {
    let mut place = [0; 2];
    for axis in 0..2 {
        let half_px = 0.5 * size_px[axis] as f64;
        let from_middle = middle_px[axis] + 0.5 - half_px;
        if from_middle.abs() < 0.5 * BLOCK_PX as f64 - 1e-9 {
            return None;
        }
        let along = (middle_px[axis] + 0.5) / (2.0 * half_px);
        place[axis] = ((along * shape[axis] as f64) as usize).min(shape[axis] - 1);
    }
    Some(place[0] + shape[0] * place[1])
}

fn weight(deviation: f64) -> f64 {
    (TAIL_DEGREES + 1.0) / (TAIL_DEGREES + deviation * deviation)
}

fn slope(deviation: f64) -> f64 {
    weight(deviation) * (TAIL_DEGREES - deviation * deviation) / (TAIL_DEGREES + deviation * deviation)
}

/// Robust mean of a cell's blocks above the surface, whose errors are `scale` times the stated ones.
fn location(members: &[Member], scale: f64) -> f64 {
    let mut sorted: Vec<f64> = members.iter().map(|own| own.rest).collect();
    let mut location = median_in_place(&mut sorted).unwrap_or(0.0);
    for _ in 0..TURNS {
        let of = |own: &Member| weight((own.rest - location) / (scale * own.sigma)) * own.sigma.powi(-2);
        let (sum, total) = members.iter().fold((0.0, 0.0), |(sum, total), own| (sum + of(own) * own.rest, total + of(own)));
        location = sum / total;
    }
    location
}

/// Levels of the cells.
fn levels(members: &[Vec<Member>]) -> Vec<Option<SkyCell>> {
    // Blocks about the median of their cell, with what the median takes of them given back.
    let mut squares = Vec::new();
    for own in members.iter().filter(|own| own.len() >= MIN_BLOCKS) {
        let mut rests: Vec<f64> = own.iter().map(|one| one.rest).collect();
        let middle = median_in_place(&mut rests).unwrap_or(0.0);
        let kept = 1.0 - (own.len() as f64).recip();
        squares.extend(own.iter().map(|one| ((one.rest - middle) / one.sigma).powi(2) / kept));
    }
    let scale = median_in_place(&mut squares).map_or(1.0, |typical| (typical / MEDIAN_CHI2).sqrt()).max(1.0);
    let locations: Vec<f64> = members.iter().map(|own| if own.is_empty() { 0.0 } else { location(own, scale) }).collect();
    let (mut square, mut slopes, mut count, mut lost) = (0.0, 0.0, 0.0, 0.0);
    for (own, location) in members.iter().zip(&locations).filter(|(own, _)| own.len() > 1) {
        for one in own {
            let deviation = (one.rest - location) / (scale * one.sigma);
            square += (weight(deviation) * deviation).powi(2);
            slopes += slope(deviation);
        }
        count += own.len() as f64;
        lost += 1.0;
    }
    // Variance of a robust mean over that of least squares with the stated errors.
    let factor =
        if count > lost && slopes > 0.0 { scale.powi(2) * square * count * count / ((count - lost) * slopes * slopes) } else { 1.0 };
    let factor = factor.max(1.0);
    members
        .iter()
        .zip(&locations)
        .map(|(own, location)| {
            let total: f64 = own.iter().map(|one| one.sigma.powi(-2)).sum();
            let mean = |of: fn(&Member) -> f64| own.iter().map(|one| of(one) * one.sigma.powi(-2)).sum::<f64>() / total;
            (!own.is_empty()).then(|| SkyCell {
                at: [mean(|one| one.at[0]), mean(|one| one.at[1])],
                level_dn: mean(|one| one.surface) + location,
                sigma_dn: (factor / total).sqrt(),
            })
        })
        .collect()
}

//! Wide halos about bright stars: what the sky around them has in proportion to their light.
//!
//! Scattered light falls off as the inverse square of the distance from its star (I. R. King, PASP 83, 199, 1971): a·F/(1 + r²/r₀²) on top of a sky that
//! is a surface of second order. The wings of an image fall off faster, as those of a Moffat image do, (1 + r²/α²)^−β with β from 2 up: two steep
//! profiles are free in every frame, and of the halo only what is orthogonal to them is asked for. The sky has structure of its own, and bright stars
//! stand anywhere in it: the same halos about the stars' mirrored and shifted places, fitted beside the true ones, say how much of it looks like a halo.

use super::lines::Estimate;
use super::partner_places::FoundStar;
use crate::frame::Frame;
use crate::statistics::{mad_sigma, median};

/// Radii r₀ that are asked, px.
pub(crate) const HALO_RADII_PX: [f64; 3] = [12.0, 25.0, 50.0];
/// Arrangements of the stars that have nothing to do with the sky.
pub(crate) const HALO_CONTROLS: usize = 8;
/// Stars that may have a halo, the brightest.
const STARS: usize = 40;
/// Nothing nearer to one of them is taken, px: it is the image.
const NEAREST_PX: f64 = 10.0;
/// Exponents of the wings, and their core, px.
const WINGS: [f64; 2] = [1.5, 2.5];
const WINGS_PX: f64 = 3.0;
/// Side of a block, px: a fortieth of the longer side of the frame between these limits.
const BLOCKS: usize = 40;
const BLOCK_PX: [usize; 2] = [8, 16];
/// Of more blocks than this only some are taken, but all that lie so near (px) to the brightest stars.
const MAX_BLOCKS: usize = 2500;
const NEAR_PX: f64 = 150.0;
const BRIGHTEST: usize = 12;
/// Share of a block that is sky, at least; blocks, at least.
const MIN_SKY: f64 = 0.3;
const MIN_BLOCKS: usize = 100;
/// A pixel, and a block, farther off than this (σ) takes no part.
const FAR_OFF: f64 = 4.0;

/// Level of the sky in a block.
struct Block {
    at: [f64; 2],
    level_dn: f64,
    /// Root of its pixels.
    weight: f64,
}

/// What the sky about the stars of a frame has in proportion to their light: of every radius a, DN per pixel in the middle of the halo per DN of light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FrameHalo {
    pub(crate) about_stars: [Estimate; HALO_RADII_PX.len()],
    /// The same about places that have nothing to do with the sky.
    pub(crate) controls: [[Estimate; HALO_CONTROLS]; HALO_RADII_PX.len()],
}

/// Light of the halo within a frame's longer side over that of the star, of a = 1.
pub(crate) fn halo_share(radius_px: f64, side_px: f64) -> f64 {
    std::f64::consts::PI * radius_px * radius_px * (side_px / radius_px).powi(2).ln_1p()
}

/// Of a frame; nothing where too little sky is seen. `noise_dn`: of a sky pixel.
pub(crate) fn frame_halo(frame: &Frame, stars: &[FoundStar], bad: Option<&[bool]>, noise_dn: f64) -> Option<FrameHalo> {
    let blocks = blocks(frame, stars, bad, noise_dn);
    let bright: Vec<[f64; 3]> = stars.iter().take(STARS).map(|star| [star.disc.x_px, star.disc.y_px, star.flux_dn]).collect();
    if blocks.len() < MIN_BLOCKS || bright.is_empty() {
        return None;
    }
    let size = [frame.width_px as f64, frame.height_px as f64];
    let values: Vec<f64> = blocks.iter().map(|block| block.weight * block.level_dn).collect();
    let mut smooth: Vec<Vec<f64>> = surface(&blocks, size);
    smooth.extend(WINGS.map(|exponent| about(&blocks, &bright, |square| (1.0 + square / (WINGS_PX * WINGS_PX)).powf(-exponent))));
    let halos = HALO_RADII_PX.map(|radius_px| of_radius(&blocks, &bright, radius_px));
    // Blocks that neither sky nor any halo explains hold something else.
    let mut all = Basis::of(smooth.clone());
    for halo in &halos {
        all.push(halo.clone());
    }
    let rest = all.left(values.clone());
    let sigma = mad_sigma(&rest)?;
    let kept: Vec<bool> = rest.iter().map(|rest| rest.abs() < FAR_OFF * sigma).collect();
    let keep =
        |column: Vec<f64>| -> Vec<f64> { column.into_iter().zip(&kept).filter(|(_, kept)| **kept).map(|(value, _)| value).collect() };
    let blocks: Vec<Block> = blocks.into_iter().zip(&kept).filter(|(_, kept)| **kept).map(|(block, _)| block).collect();
    let values = keep(values);
    let base = Basis::of(smooth.into_iter().map(keep).collect());
    let elsewhere: [Vec<[f64; 3]>; HALO_CONTROLS] = std::array::from_fn(|k| bright.iter().map(|star| arranged(*star, k, size)).collect());
    let none = [Estimate::default(); HALO_RADII_PX.len()];
    let mut found = FrameHalo { about_stars: none, controls: [[Estimate::default(); HALO_CONTROLS]; HALO_RADII_PX.len()] };
    for (which, (radius_px, halo)) in HALO_RADII_PX.into_iter().zip(halos).enumerate() {
        let halo = keep(halo);
        found.about_stars[which] = base.amplitude(&values, halo.clone())?;
        let mut beside = base.clone();
        beside.push(halo);
        for (control, stars) in found.controls[which].iter_mut().zip(&elsewhere) {
            *control = beside.amplitude(&values, of_radius(&blocks, stars, radius_px))?;
        }
    }
    Some(found)
}

/// A star's place mirrored, or shifted with what leaves the frame coming in on the other side.
fn arranged([x, y, flux]: [f64; 3], which: usize, [width, height]: [f64; 2]) -> [f64; 3] {
    let shifted = |shares: [f64; 2]| [(x + shares[0] * width).rem_euclid(width), (y + shares[1] * height).rem_euclid(height), flux];
    let [mirrored_x, mirrored_y] = [width - 1.0 - x, height - 1.0 - y];
    match which {
        0 => [mirrored_x, y, flux],
        1 => [x, mirrored_y, flux],
        2 => [mirrored_x, mirrored_y, flux],
        3 => shifted([0.5, 0.0]),
        4 => shifted([0.0, 0.5]),
        5 => shifted([0.5, 0.5]),
        6 => shifted([0.25, 0.25]),
        _ => shifted([0.75, 0.25]),
    }
}

/// Corners of the blocks that are taken, and their side.
fn corners(size: [usize; 2], stars: &[FoundStar]) -> (Vec<[usize; 2]>, usize) {
    let side = size[0].max(size[1]).div_ceil(BLOCKS).clamp(BLOCK_PX[0], BLOCK_PX[1]);
    let half = side as f64 / 2.0;
    let is_near = |[left, top]: [usize; 2]| {
        let to = |star: &FoundStar| (star.disc.x_px - left as f64 - half).hypot(star.disc.y_px - top as f64 - half);
        stars.iter().take(BRIGHTEST).any(|star| to(star) < NEAR_PX)
    };
    let all: Vec<[usize; 2]> = (0..size[1]).step_by(side).flat_map(|top| (0..size[0]).step_by(side).map(move |left| [left, top])).collect();
    let step = all.len().div_ceil(MAX_BLOCKS);
    let taken = all.into_iter().enumerate().filter(|(index, corner)| index % step == 0 || is_near(*corner));
    (taken.map(|(_, corner)| corner).collect(), side)
}

/// Levels of the sky, block by block.
fn blocks(frame: &Frame, stars: &[FoundStar], bad: Option<&[bool]>, noise_dn: f64) -> Vec<Block> {
    let (corners, side) = corners([frame.width_px, frame.height_px], stars);
    let is_usable = |index: usize| frame.pixels_dn[index] < frame.saturation_dn && bad.is_none_or(|bad| !bad[index]);
    let discs: Vec<[f64; 3]> = stars.iter().map(|star| [star.disc.x_px, star.disc.y_px, star.disc.radius_px.max(NEAREST_PX)]).collect();
    let half = side as f64 / 2.0;
    let mut all = Vec::new();
    let mut pixels: Vec<(f64, f64, f64)> = Vec::with_capacity(side * side);
    for [left, top] in corners {
        let is_near = |disc: &&[f64; 3]| {
            (disc[0] - left as f64 - half).abs() < disc[2] + half && (disc[1] - top as f64 - half).abs() < disc[2] + half
        };
        let near: Vec<&[f64; 3]> = discs.iter().filter(is_near).collect();
        pixels.clear();
        for y in top..(top + side).min(frame.height_px) {
            for x in left..(left + side).min(frame.width_px) {
                let (at_x, at_y) = (x as f64, y as f64);
                let is_lit = |disc: &&[f64; 3]| (at_x - disc[0]).powi(2) + (at_y - disc[1]).powi(2) < disc[2] * disc[2];
                if is_usable(y * frame.width_px + x) && !near.iter().any(is_lit) {
                    pixels.push((at_x, at_y, f64::from(frame.at(x, y))));
                }
            }
        }
        if pixels.len() as f64 >= MIN_SKY * (side * side) as f64 {
            all.extend(block(&mut pixels, noise_dn));
        }
    }
    all
}

/// Mean of the pixels without those far off: stars that were not found, defects.
fn block(pixels: &mut Vec<(f64, f64, f64)>, noise_dn: f64) -> Option<Block> {
    let middle = median(&pixels.iter().map(|pixel| pixel.2).collect::<Vec<f64>>())?;
    pixels.retain(|pixel| (pixel.2 - middle).abs() < FAR_OFF * noise_dn);
    let count = pixels.len() as f64;
    let mean = |pick: fn(&(f64, f64, f64)) -> f64| pixels.iter().map(pick).sum::<f64>() / count;
    (count > 0.0).then(|| Block { at: [mean(|own| own.0), mean(|own| own.1)], level_dn: mean(|own| own.2), weight: count.sqrt() })
}

/// A surface of second order.
fn surface(blocks: &[Block], [width, height]: [f64; 2]) -> Vec<Vec<f64>> {
    let column = |of: fn(f64, f64) -> f64| -> Vec<f64> {
        blocks.iter().map(|block| block.weight * of(2.0 * block.at[0] / width - 1.0, 2.0 * block.at[1] / height - 1.0)).collect()
    };
    vec![column(|_, _| 1.0), column(|u, _| u), column(|_, v| v), column(|u, _| u * u), column(|u, v| u * v), column(|_, v| v * v)]
}

/// Sum over stars of their light times a profile of the square of the distance.
fn about(blocks: &[Block], stars: &[[f64; 3]], profile: impl Fn(f64) -> f64) -> Vec<f64> {
    let at = |[x, y]: [f64; 2]| stars.iter().map(|star| star[2] * profile((x - star[0]).powi(2) + (y - star[1]).powi(2))).sum::<f64>();
    blocks.iter().map(|block| block.weight * at(block.at)).collect()
}

fn of_radius(blocks: &[Block], stars: &[[f64; 3]], radius_px: f64) -> Vec<f64> {
    about(blocks, stars, |square| (1.0 + square / (radius_px * radius_px)).recip())
}

/// Columns that are free, orthonormal.
#[derive(Clone, Default)]
struct Basis(Vec<Vec<f64>>);

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl Basis {
    fn of(columns: Vec<Vec<f64>>) -> Self {
        let mut own = Self::default();
        for column in columns {
            own.push(column);
        }
        own
    }

    /// What the columns leave of another. Twice, for rounding.
    fn left(&self, mut column: Vec<f64>) -> Vec<f64> {
        for known in self.0.iter().chain(&self.0) {
            let along = dot(known, &column);
            column.iter_mut().zip(known).for_each(|(value, known)| *value -= along * known);
        }
        column
    }

    fn push(&mut self, column: Vec<f64>) {
        /// What is left of a column that is a sum of others is rounding.
        const ROUNDING: f64 = 1e-9;
        let before = dot(&column, &column);
        let mut left = self.left(column);
        let after = dot(&left, &left);
        if after > ROUNDING * before {
            for value in &mut left {
                *value /= after.sqrt();
            }
            self.0.push(left);
        }
    }

    /// Size of a column in the values beside those that are free, its error by the scatter of what is left.
    fn amplitude(&self, values: &[f64], column: Vec<f64>) -> Option<Estimate> {
        let column = self.left(column);
        let square = dot(&column, &column);
        let value = dot(&column, values) / square;
        let rest: Vec<f64> = self.left(values.to_vec()).iter().zip(&column).map(|(rest, own)| rest - value * own).collect();
        let degrees = (values.len() as f64 - self.0.len() as f64 - 1.0).max(1.0);
        let sigma = (dot(&rest, &rest) / degrees / square).sqrt();
        (value.is_finite() && sigma > 0.0 && sigma.is_finite()).then_some(Estimate { value, sigma })
    }
}

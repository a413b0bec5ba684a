//! Tiling: lists of the star images that light each tile.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};

use super::{ImagingError, PlacedStar};
use crate::effects::pixel::{SeparablePsf, SeparableStar};

/// Side of a tile in px; a workgroup of the shader that collects light is one tile.
pub(super) const TILE_PX: usize = 16;

/// A star in the list of a tile.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub(super) struct Entry {
    /// Index of the star.
    pub(super) star: u32,
    /// Index of the tile.
    pub(super) tile: u32,
}

/// A part of the list of a tile; `TileList` of `shaders/lib/collect.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub(super) struct TileList {
    /// Which tile of its row.
    pub(super) column: u32,
    /// Which row of tiles.
    pub(super) row: u32,
    /// The first entry.
    pub(super) first: u32,
    /// The one after the last.
    pub(super) end: u32,
}

/// What lies in a square of pixels around a place.
pub(super) trait Placed: Copy {
    /// Column and row of the middle.
    fn place(&self) -> (i32, i32);
    /// Half the side of the square, px.
    fn reach(&self) -> i32;
}

impl Placed for SeparableStar {
    fn place(&self) -> (i32, i32) {
        (self.column, self.row)
    }
    fn reach(&self) -> i32 {
        self.reach
    }
}

/// Which stars may light a tile, for all tiles of a band.
#[derive(Debug)]
pub(super) struct TileLists<S> {
    /// The stars, in catalogue order.
    pub(super) stars: Vec<S>,
    /// Where each tile's entries begin; one more than there are tiles.
    pub(super) starts: Vec<u32>,
    /// The entries, tile by tile, in catalogue order within a tile.
    pub(super) entries: Vec<Entry>,
}

impl<S> TileLists<S> {
    /// The entries of a tile.
    pub(super) fn of(&self, tile: usize) -> &[Entry] {
        &self.entries[self.starts[tile] as usize..self.starts[tile + 1] as usize]
    }

    /// The tiles that have entries, `columns` of them in a row: parts of their lists that are no longer than `most`, as many times as the longest
    /// list asks for.
    pub(super) fn parts(&self, columns: usize, most: u32) -> Vec<Vec<TileList>> {
        let mut parts: Vec<Vec<TileList>> = Vec::new();
        for (tile, pair) in self.starts.windows(2).enumerate() {
            let (column, row) = ((tile % columns) as u32, (tile / columns) as u32);
            for (part, first) in (pair[0]..pair[1]).step_by(most as usize).enumerate() {
                if parts.len() == part {
                    parts.push(Vec::new());
                }
                parts[part].push(TileList { column, row, first, end: pair[1].min(first + most) });
            }
        }
        parts
    }
}

/// The tiles of a band of rows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    /// Columns of pixels.
    pub(super) width: usize,
    /// First row of pixels.
    pub(super) first_row: usize,
    /// Rows of pixels.
    pub(super) rows: usize,
    /// Width of a tile; a whole row where only bands of rows are wanted.
    pub(super) tile_width: usize,
}

impl Grid {
    pub(super) fn columns(&self) -> usize {
        self.width.div_ceil(self.tile_width)
    }
    pub(super) fn tile_rows(&self) -> usize {
        self.rows.div_ceil(TILE_PX)
    }

    #[allow(clippy::cast_possible_wrap, reason = "the sides of a frame are at most 65 535 px")]
    /// The tiles that a star's square touches: columns and rows, empty if it lies outside.
    fn touched(&self, star: &impl Placed) -> (Range<usize>, Range<usize>) {
        let along = |middle: i32, first: usize, count: usize, tile: usize| {
            let low = (i64::from(middle) - i64::from(star.reach()) - first as i64).max(0);
            let high = (i64::from(middle) + i64::from(star.reach()) - first as i64).min(count as i64 - 1);
            if low > high { 0..0 } else { low as usize / tile..high as usize / tile + 1 }
        };
        let (column, row) = star.place();
        (along(column, 0, self.width, self.tile_width), along(row, self.first_row, self.rows, TILE_PX))
    }
}

/// Integer pixel and f32 fraction from a place in f64. Stars whose square misses the frame are left out: no light of theirs falls in it.
pub(super) fn prepare(
    images: &[PlacedStar],
    spread: &dyn SeparablePsf,
    width: usize,
    height: usize,
) -> Result<Vec<SeparableStar>, ImagingError> {
    let mut stars = Vec::with_capacity(images.len());
    let sigma_range = spread.parameters().first().map_or((0.0, f64::INFINITY), |parameter| parameter.range);
    for (index, image) in images.iter().enumerate() {
        let problem = |what, value| ImagingError::BadStar { index, what, value };
        for (what, value) in [("x_px", image.x_px), ("y_px", image.y_px)] {
            if !value.is_finite() {
                return Err(problem(what, value));
            }
        }
        if !(0.0..=1e30).contains(&image.electrons) {
            return Err(problem("electrons", image.electrons));
        }
        if !(sigma_range.0..=sigma_range.1).contains(&image.sigma_px) {
            return Err(problem("sigma_px", image.sigma_px));
        }
        let (column, row) = (image.x_px.round(), image.y_px.round());
        let reach = spread.reach(image.electrons, image.sigma_px);
        let misses = |middle: f64, count: usize| middle + f64::from(reach) < 0.0 || middle - f64::from(reach) > count as f64 - 1.0;
        if misses(column, width) || misses(row, height) {
            continue;
        }
        stars.push(SeparableStar {
            column: column as i32,
            row: row as i32,
            fraction_x: (image.x_px - column) as f32,
            fraction_y: (image.y_px - row) as f32,
            electrons: image.electrons as f32,
            inverse_sigma: (1.0 / image.sigma_px) as f32,
            reach,
            unused: 0,
        });
    }
    Ok(stars)
}

/// Lists for a band, in as many chunks as keep below `most_stars` stars and `most_entries` entries each; at least one chunk.
/// Chunks follow in catalogue order, so their light adds up in the same order as in one list.
pub(super) fn bin<S: Placed>(stars: &[S], grid: &Grid, most_stars: usize, most_entries: usize) -> Vec<TileLists<S>> {
    let mut chunks = Vec::new();
    let mut chunk: Vec<(S, Range<usize>, Range<usize>)> = Vec::new();
    let mut entries = 0;
    for star in stars {
        let (columns, rows) = grid.touched(star);
        let count = columns.len() * rows.len();
        if count == 0 {
            continue;
        }
        if !chunk.is_empty() && (chunk.len() == most_stars || entries + count > most_entries) {
            chunks.push(lists(&chunk, grid, entries));
            chunk.clear();
            entries = 0;
        }
        chunk.push((*star, columns, rows));
        entries += count;
    }
    if !chunk.is_empty() || chunks.is_empty() {
        chunks.push(lists(&chunk, grid, entries));
    }
    chunks
}

fn lists<S: Placed>(chunk: &[(S, Range<usize>, Range<usize>)], grid: &Grid, count: usize) -> TileLists<S> {
    let columns_of_tiles = grid.columns();
    let mut starts = vec![0_u32; columns_of_tiles * grid.tile_rows() + 1];
    let tiles = |columns: &Range<usize>, rows: &Range<usize>| {
        let columns = columns.clone();
        rows.clone().flat_map(move |row| columns.clone().map(move |column| row * columns_of_tiles + column))
    };
    for (_, columns, rows) in chunk {
        for tile in tiles(columns, rows) {
            starts[tile + 1] += 1;
        }
    }
    for tile in 1..starts.len() {
        starts[tile] += starts[tile - 1];
    }
    let mut next = starts.clone();
    let mut entries = vec![Entry::default(); count];
    for (number, (_, columns, rows)) in (0..).zip(chunk) {
        for tile in tiles(columns, rows) {
            entries[next[tile] as usize] = Entry { star: number, tile: tile as u32 };
            next[tile] += 1;
        }
    }
    TileLists { stars: chunk.iter().map(|(star, _, _)| *star).collect(), starts, entries }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::pixel::separable_psf;

    fn star(x_px: f64, y_px: f64) -> PlacedStar {
        PlacedStar { x_px, y_px, electrons: 1e4, sigma_px: 1.0 }
    }

    fn grid(width: usize, first_row: usize, rows: usize) -> Grid {
        Grid { width, first_row, rows, tile_width: TILE_PX }
    }

    #[test]
    fn a_place_is_kept_to_f32_of_a_pixel() {
        let spread = separable_psf("gaussian_psf").unwrap();
        let stars = prepare(&[star(4_000.125_25, 0.499)], spread, 4096, 4096).unwrap();
        assert_eq!((stars[0].column, stars[0].row), (4000, 0));
        assert!((f64::from(stars[0].fraction_x) - 0.125_25).abs() < 1e-8);
    }

    #[allow(clippy::cast_possible_wrap, reason = "small numbers")]
    /// Every tile that a star's square touches lists it, and no other: by brute force over pixels.
    #[test]
    fn lists_hold_exactly_the_stars_that_touch() {
        let spread = separable_psf("gaussian_psf").unwrap();
        let images: Vec<_> = (0..40).map(|i| star(f64::from(i * 37 % 101) - 10.0, f64::from(i * 53 % 97) - 12.0)).collect();
        let stars = prepare(&images, spread, 75, 70).unwrap();
        let grid = grid(75, 16, 48);
        let chunks = bin(&stars, &grid, usize::MAX, usize::MAX);
        assert_eq!(chunks.len(), 1);
        for tile_row in 0..3 {
            for tile_column in 0..5 {
                let listed: Vec<SeparableStar> =
                    chunks[0].of(tile_row * 5 + tile_column).iter().map(|entry| chunks[0].stars[entry.star as usize]).collect();
                let touching: Vec<SeparableStar> = stars
                    .iter()
                    .filter(|star| {
                        (0..16 * 16).any(|i| {
                            let (x, y) = ((tile_column * 16 + i % 16) as i32, (16 + tile_row * 16 + i / 16) as i32);
                            x < 75 && (x - star.column).abs() <= star.reach && (y - star.row).abs() <= star.reach
                        })
                    })
                    .copied()
                    .collect();
                assert_eq!(listed, touching, "tile {tile_column}, {tile_row}");
            }
        }
    }

    /// Chunks hold the same stars in the same order.
    #[test]
    fn chunks_lose_nothing() {
        let spread = separable_psf("gaussian_psf").unwrap();
        let images: Vec<_> = (0..500).map(|i| star(f64::from(i % 100), f64::from(i % 83))).collect();
        let stars = prepare(&images, spread, 100, 100).unwrap();
        let whole = bin(&stars, &grid(100, 0, 100), usize::MAX, usize::MAX);
        for (most_stars, most_entries) in [(7, usize::MAX), (usize::MAX, 50), (1, 1)] {
            let chunks = bin(&stars, &grid(100, 0, 100), most_stars, most_entries);
            assert!(chunks.len() > 10);
            let joined: Vec<SeparableStar> = chunks.iter().flat_map(|chunk| chunk.stars.clone()).collect();
            assert_eq!(joined, whole[0].stars);
            assert_eq!(chunks.iter().map(|chunk| chunk.entries.len()).sum::<usize>(), whole[0].entries.len());
        }
    }

    /// Parts of lists hold every entry once and in order, none is empty, and the n-th part of a tile is in the n-th list.
    #[test]
    fn parts_lose_nothing() {
        let spread = separable_psf("gaussian_psf").unwrap();
        let images: Vec<_> = (0..90).map(|i| star(f64::from(i % 9), f64::from(i % 7) + 40.0 * f64::from(i % 2))).collect();
        let lists = bin(&prepare(&images, spread, 100, 100).unwrap(), &grid(100, 0, 100), usize::MAX, usize::MAX).swap_remove(0);
        for most in [1, 7, 1000] {
            let parts = lists.parts(7, most);
            let mut next = lists.starts.clone();
            for part in parts.iter().flatten() {
                let tile = (7 * part.row + part.column) as usize;
                assert!(part.first == next[tile] && (1..=most).contains(&(part.end - part.first)));
                next[tile] = part.end;
            }
            assert_eq!(next[..49], lists.starts[1..], "lists of {most}");
            assert!(parts.iter().all(|part| part.is_sorted_by_key(|one| one.first)));
        }
    }

    #[test]
    fn bad_stars_are_refused_by_number_and_value() {
        let spread = separable_psf("gaussian_psf").unwrap();
        for (bad, word) in [
            (PlacedStar { x_px: f64::NAN, ..star(1.0, 1.0) }, "x_px"),
            (PlacedStar { electrons: -1.0, ..star(1.0, 1.0) }, "electrons"),
            (PlacedStar { sigma_px: 0.0, ..star(1.0, 1.0) }, "sigma_px"),
        ] {
            let error = prepare(&[star(1.0, 1.0), bad], spread, 10, 10).unwrap_err().to_string();
            assert!(error.contains("number 1") && error.contains(word), "{error}");
        }
        assert!(prepare(&[star(1e300, 5.0), star(-1e300, 5.0)], spread, 10, 10).unwrap().is_empty());
    }
}

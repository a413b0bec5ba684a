//! Candidate positions for the fit: peaks of the matched filter, less the side lobes of brighter stars, with saturated pixels merged.

use super::background::Background;
use super::filter_run::Search;
use super::image_model::{Model, Shape, radius_px};
use crate::frame::Frame;
use crate::parallel;

/// A place to fit a star at.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub(super) start: Model,
    pub(super) snr: f64,
    /// Radius of the full pixels at its centre, 0 if there are none.
    pub(super) full_radius_px: f64,
    /// Whether it is dark around it, as it is around a star, and not at the edge of something or within it.
    pub(super) lone: bool,
}

/// A group of touching full pixels.
pub(super) struct Blob {
    x: f64,
    y: f64,
    radius_px: f64,
}

pub(super) fn full_blobs(width: usize, full: &[bool], hot: &[bool]) -> Vec<Blob> {
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
pub(super) fn candidates(frame: &Frame, background: &Background, search: &Search, blobs: &[Blob]) -> Vec<Candidate> {
    /// How a bright star's wings may fall, over what they are at its centre (Moffat-like), and the share that ripples in them may reach.
    const RIPPLE: f64 = 0.04;
    const RIPPLE_OF_FULL: f64 = 0.15;
    const RESOLVED_SIGMA: f64 = 2.0;
    /// A peak so near to full pixels is theirs.
    const FULL_BESIDE_PX: f64 = 1.5;
    let (long, _) = search.shape.axes_px();
    let mut blob_taken = vec![false; blobs.len()];
    let mut of_blobs = Grid::new(frame.width_px, frame.height_px);
    for (index, blob) in blobs.iter().enumerate() {
        of_blobs.put_around(blob.x, blob.y, blob.radius_px + FULL_BESIDE_PX, index);
    }
    let mut kept: Vec<Candidate> = Vec::with_capacity(search.peaks.len());
    let mut grid = Grid::new(frame.width_px, frame.height_px);
    let loud = |c: &Candidate| if c.full_radius_px > 0.0 { RIPPLE_OF_FULL } else { RIPPLE };
    for peak in &search.peaks {
        let (mut x, mut y) = (peak.x as f64, peak.y as f64);
        let mut full_radius_px = 0.0;
        let inside = |index: &usize| {
            let b = &blobs[*index];
            (b.x - x).powi(2) + (b.y - y).powi(2) <= (b.radius_px + FULL_BESIDE_PX).powi(2)
        };
        if let Some(index) = of_blobs.at(x, y).find(inside) {
            if std::mem::replace(&mut blob_taken[index], true) {
                continue;
            }
            (x, y, full_radius_px) = (blobs[index].x, blobs[index].y, blobs[index].radius_px);
        }
        // the filter cannot tell two such near stars apart: a second maximum is a ripple of the first
        let here = search.shape_at(x, y);
        let merged = grid.near(x, y).any(|i: usize| here.radius_in_sigma(kept[i].start.x - x, kept[i].start.y - y) < RESOLVED_SIGMA);
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
        let mut shape = here;
        let mut reach = radius_px(shape);
        if full_radius_px > 0.0 {
            // the wings beyond the full pixels must be in the window
            shape = Shape::round(search.shape.sigma_px().max(full_radius_px / 1.5));
            reach = (reach + full_radius_px.ceil() as usize).min(48);
        }
        let flux_dn = peak.snr * noise * search.kernel.flux_per_snr();
        grid.put(x, y, kept.len());
        let lone = is_lone(frame, background, [x, y], 3.0 * long + 1.5 + full_radius_px);
        kept.push(Candidate {
            start: Model { x, y, flux_dn, shape, radius: reach, empirical: false },
            snr: peak.snr,
            full_radius_px,
            lone,
        });
    }
    kept
}

/// Whether most of what lies around a place at some distance is darker than a part of what is at the place.
fn is_lone(frame: &Frame, background: &Background, [x, y]: [f64; 2], far_px: f64) -> bool {
    const AROUND: u32 = 12;
    const PART: f64 = 0.25;
    let light = |x: f64, y: f64| {
        let inside = |at: f64, length: usize| (at.round().max(0.0) as usize).min(length - 1);
        let (x, y) = (inside(x, frame.width_px), inside(y, frame.height_px));
        f64::from(frame.at(x, y)) - background.level_dn(x, y)
    };
    let (own, noise) = (light(x, y), background.noise_dn(x.max(0.0) as usize, y.max(0.0) as usize));
    let dark = |k: &u32| {
        let (sin, cos) = (f64::from(*k) * std::f64::consts::TAU / f64::from(AROUND)).sin_cos();
        light(x + far_px * cos, y + far_px * sin).abs() < PART * own + 2.0 * noise
    };
    (0..AROUND).filter(dark).count() >= (AROUND as usize * 3).div_ceil(4)
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

    /// Puts it into every cell that a square around its place reaches.
    fn put_around(&mut self, x: f64, y: f64, reach_px: f64, item: usize) {
        let ((left, top), (right, bottom)) = (self.cell(x - reach_px, y - reach_px), self.cell(x + reach_px, y + reach_px));
        for row in top..=bottom {
            for column in left..=right {
                self.cells[row * self.columns + column].push(item);
            }
        }
    }

    /// What was put into the cell of a place, in the order in which it was.
    fn at(&self, x: f64, y: f64) -> impl Iterator<Item = usize> + '_ {
        let (cx, cy) = self.cell(x, y);
        self.cells[cy * self.columns + cx].iter().copied()
    }

    fn near(&self, x: f64, y: f64) -> impl Iterator<Item = usize> + '_ {
        let (cx, cy) = self.cell(x, y);
        let rows = cy.saturating_sub(1)..(cy + 2).min(self.rows);
        let columns = cx.saturating_sub(1)..(cx + 2).min(self.columns);
        rows.flat_map(move |r| columns.clone().map(move |c| r * self.columns + c)).flat_map(|i| self.cells[i].iter().copied())
    }
}

/// For every star those whose light reaches into its window.
pub(super) fn neighbours(models: &[Model]) -> Vec<Vec<usize>> {
    let extent = |pick: fn(&Model) -> f64| models.iter().map(pick).fold(0.0, f64::max) as usize + 1;
    let mut grid = Grid::new(extent(|m| m.x), extent(|m| m.y));
    for (i, m) in models.iter().enumerate() {
        grid.put(m.x, m.y, i);
    }
    let touches = |a: &Model, b: &Model| {
        let reach = a.radius as f64 + 2.5 * b.shape.axes_px().0;
        (a.x - b.x).abs() < reach && (a.y - b.y).abs() < reach
    };
    parallel::map_numbers(models.len(), |i| {
        let own = &models[i];
        grid.near(own.x, own.y).filter(|&j| j != i && touches(own, &models[j])).collect()
    })
}

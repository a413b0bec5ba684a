//! The map of what is left: vectors on a grid over the frame, on the colours of how well they are known.

use std::path::Path;

use crate::report::{FieldMap, ReportError, Vector};
use crate::statistics::order::sort_by;

/// Points along each side of the picture's background.
const SIDE: usize = 41;
/// Arrows are drawn from this many standard errors per axis on: noise alone makes one in seven longer.
const ABOVE_NOISE: f64 = 2.0;
/// The most arrows along a side.
const MAX_ARROWS: usize = 16;

/// Writes the map as PNG. `points`: x, y, dx, dy, standard error per axis, in px, on the crossings of a grid in any order.
pub fn remainder_map(path: &Path, title: &str, summary: &str, frame_px: (usize, usize), points: &[[f64; 5]]) -> Result<(), ReportError> {
    let empty = |what| ReportError::Empty { path: path.to_owned(), what };
    let grid = Crossings::of(points).ok_or_else(|| empty("its points are not on the crossings of a grid"))?;
    let at = |k: usize, length: usize| k as f64 / (SIDE as f64 - 1.0) * (length as f64 - 1.0);
    let values = (0..SIDE * SIDE).map(|k| grid.sigma_px(at(k % SIDE, frame_px.0), at(k / SIDE, frame_px.1))).collect();
    let every = [&grid.columns, &grid.rows].map(|lines| lines.len().div_ceil(MAX_ARROWS).max(1));
    let drawn = |k: &usize| (k % grid.columns.len()).is_multiple_of(every[0]) && (k / grid.columns.len()).is_multiple_of(every[1]);
    // An arrow that is no longer than its own noise says nothing and would be read.
    let (shown, noise): (Vec<usize>, Vec<usize>) = (0..grid.points.len()).filter(drawn).partition(|k| {
        let [_, _, dx_px, dy_px, sigma_px] = grid.points[*k];
        dx_px.hypot(dy_px) > ABOVE_NOISE * sigma_px
    });
    let arrows = shown.iter().map(|k| {
        let [x_px, y_px, dx_px, dy_px, _] = grid.points[*k];
        Vector { x_px, y_px, dx_px, dy_px, rejected: false }
    });
    let note = format!(
        "arrows: measured − model, what no effect explains; {} below {ABOVE_NOISE} σ are not drawn. Colours: standard error of an arrow, per axis",
        noise.len()
    );
    let map = FieldMap {
        title: title.to_owned(),
        summary: summary.to_owned(),
        values,
        side: SIDE,
        reach: vec![0.0],
        unit: "σ / px".to_owned(),
        arrows: arrows.collect(),
        note,
        ..FieldMap::default()
    };
    map.write(path, frame_px)
}

/// Points in rows and columns.
struct Crossings {
    columns: Vec<f64>,
    rows: Vec<f64>,
    /// Row by row.
    points: Vec<[f64; 5]>,
}

impl Crossings {
    fn of(points: &[[f64; 5]]) -> Option<Self> {
        let lines = |axis: usize| {
            let mut lines: Vec<f64> = points.iter().map(|point| point[axis]).collect();
            lines.sort_by(f64::total_cmp);
            lines.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
            lines
        };
        let (columns, rows) = (lines(0), lines(1));
        let mut points = points.to_vec();
        sort_by(&mut points, |a, b| {
            let row = |y: f64| rows.partition_point(|line| *line < y - 1e-6);
            row(a[1]).cmp(&row(b[1])).then(a[0].total_cmp(&b[0]))
        });
        let whole = columns.len() >= 2 && rows.len() >= 2 && columns.len() * rows.len() == points.len();
        let finite = points.iter().flatten().all(|number| number.is_finite());
        (whole && finite).then_some(Self { columns, rows, points })
    }

    /// The standard error between the four crossings around a point; beyond the grid that of its edge.
    fn sigma_px(&self, x_px: f64, y_px: f64) -> f64 {
        let along = |lines: &[f64], at: f64| {
            let below = lines.partition_point(|line| *line <= at).clamp(1, lines.len() - 1) - 1;
            (below, ((at - lines[below]) / (lines[below + 1] - lines[below])).clamp(0.0, 1.0))
        };
        let ((column, right), (row, down)) = (along(&self.columns, x_px), along(&self.rows, y_px));
        let sigma = |column: usize, row: usize| self.points[row * self.columns.len() + column][4];
        let upper = sigma(column, row) * (1.0 - right) + sigma(column + 1, row) * right;
        let lower = sigma(column, row + 1) * (1.0 - right) + sigma(column + 1, row + 1) * right;
        upper * (1.0 - down) + lower * down
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_taken_between_the_crossings() {
        let mut points: Vec<[f64; 5]> =
            (0..12).map(|k| [f64::from(k % 4) * 100.0, f64::from(k / 4) * 50.0, 0.0, 0.1, f64::from(k % 4) + f64::from(k / 4)]).collect();
        points.reverse();
        let grid = Crossings::of(&points).unwrap();
        for (x, y, sigma) in [(0.0, 0.0, 0.0), (150.0, 25.0, 2.0), (300.0, 100.0, 5.0), (999.0, -7.0, 3.0)] {
            assert!((grid.sigma_px(x, y) - sigma).abs() < 1e-12, "{x} {y}: {}", grid.sigma_px(x, y));
        }
        assert!(Crossings::of(&points[1..]).is_none(), "a crossing is missing");
        let path = std::env::temp_dir().join("never-written-remainder.png");
        assert!(matches!(remainder_map(&path, "", "", (100, 100), &points[1..]), Err(ReportError::Empty { .. })));
    }
}

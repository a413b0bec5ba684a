//! Stamp of a single source: its light on its own piece of the frame, by the code that renders.

use super::plan::{Lit, Plan};
use super::tiles::Placed;
use crate::effects::pixel::Rows;

/// Expected electrons of one source on a rectangle of the frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Stamp {
    /// First column.
    pub left_px: usize,
    /// First row.
    pub top_px: usize,
    /// Columns.
    pub width_px: usize,
    /// Electrons, row by row.
    pub electrons: Vec<f32>,
}

#[allow(clippy::cast_possible_wrap, reason = "the sides of a frame are at most 65 535 px")]
/// Adds the light on the smallest rectangle of the frame that holds it.
pub(super) fn stamp(plan: &Plan, mut lit: Lit<'_>) -> Option<Stamp> {
    let squares = lit.stars.iter().map(square).chain(lit.planes.iter().flat_map(|batch| batch.stars.iter().map(square)));
    let [left, top, right, bottom] = squares.reduce(|a, b| [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])])?;
    let on_frame = |place: i64, length: usize| place.clamp(0, length as i64 - 1) as usize;
    let (left_px, right) = (on_frame(left, plan.width_px), on_frame(right, plan.width_px));
    let (top_px, bottom) = (on_frame(top, plan.height_px), on_frame(bottom, plan.height_px));
    let width_px = right + 1 - left_px;
    let mut electrons = vec![0.0; width_px * (bottom + 1 - top_px)];
    let mut scratch = Vec::new();
    let mut rows = Rows { width: width_px, first_row: top_px, electrons: &mut electrons, scratch: &mut scratch };
    for star in &mut lit.stars {
        star.column -= left_px as i32;
        plan.spread.add(star, &mut rows);
    }
    for batch in &mut lit.planes {
        for star in &mut batch.stars {
            star.column -= left_px as i32;
            batch.spread.add_plane(star, batch.atlas, &mut rows);
        }
    }
    Some(Stamp { left_px, top_px, width_px, electrons })
}

/// First and last column and row.
fn square(star: &impl Placed) -> [i64; 4] {
    let ((column, row), reach) = (star.place(), i64::from(star.reach()));
    let (column, row) = (i64::from(column), i64::from(row));
    [column - reach, row - reach, column + reach, row + reach]
}

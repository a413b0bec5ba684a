//! The way of a streak: where its light is along a line, and whether it is everywhere along it.

use super::line_sums::{Plane, StripLine};
use crate::statistics::order::ascending;

/// Parts of a line, and how many of the brightest may be stars.
const PARTS: usize = 8;
const TRIMMED: usize = 2;

/// A straight way down a plane: the column at the row 0, and by how much it grows from row to row.
#[derive(Clone, Copy)]
struct Way {
    column: f64,
    slope: f64,
    half_width: usize,
}

impl Way {
    fn of(line: &StripLine) -> Self {
        let slope = line.shift as f64 / (line.rows - 1) as f64;
        Self { column: line.start as f64 - slope * line.first_row as f64, slope, half_width: line.half_width }
    }

    fn at(&self, row: f64) -> f64 {
        self.column + self.slope * row
    }

    /// The pixels of some rows that lie within `half` of the way, each with how far it is off, its value and its count.
    fn pixels(self, plane: &Plane, rows: std::ops::Range<isize>, half: usize) -> impl Iterator<Item = (f64, f64, f64)> {
        let (width, height) = (plane.width.cast_signed(), plane.height.cast_signed());
        rows.filter(move |row| (0..height).contains(row)).flat_map(move |row| {
            let (at, half) = (self.at(row as f64), half.cast_signed());
            let middle = at.round() as isize;
            (middle - half..=middle + half).filter(move |x| (0..width).contains(x)).map(move |x| {
                let index = row.cast_unsigned() * plane.width + x.cast_unsigned();
                (x as f64 - at, f64::from(plane.values[index]), f64::from(plane.counts[index]))
            })
        })
    }

    /// Sum of the band in some rows, and its pixels.
    fn part(self, plane: &Plane, rows: std::ops::Range<isize>) -> (f64, f64) {
        self.pixels(plane, rows, self.half_width).fold((0.0, 0.0), |(sum, known), (_, value, count)| (sum + value, known + count))
    }

    /// Moved onto the light of these rows: a line through the middles of its parts.
    fn centred(self, plane: &Plane, rows: std::ops::Range<isize>) -> Self {
        const PART: usize = 8;
        const HALF: usize = 4;
        let (mut normal, mut right) = ([[0.0_f64; 2]; 2], [0.0_f64; 2]);
        for first in rows.clone().step_by(PART) {
            let own = self.pixels(plane, first..(first + PART.cast_signed()).min(rows.end), HALF);
            let (light, moment) = own.fold((0.0, 0.0), |(light, moment), (off, value, _)| (light + value, moment + value * off));
            // Of less light the middle is anywhere.
            let weight = (light / ((2 * HALF + 1) * PART) as f64).max(0.0).powi(2);
            if weight > 0.0 && (moment / light).abs() < HALF as f64 {
                let row = [1.0, first as f64 + 0.5 * (PART - 1) as f64];
                for a in 0..2 {
                    right[a] += weight * row[a] * moment / light;
                    for b in 0..2 {
                        normal[a][b] += weight * row[a] * row[b];
                    }
                }
            }
        }
        let determinant = normal[0][0] * normal[1][1] - normal[0][1] * normal[1][0];
        if determinant <= 0.0 {
            return self;
        }
        let column = (normal[1][1] * right[0] - normal[0][1] * right[1]) / determinant;
        let slope = (normal[0][0] * right[1] - normal[1][0] * right[0]) / determinant;
        Self { column: self.column + column, slope: self.slope + slope, ..self }
    }

    /// The rows of the light along the way: from these outwards until it stays dark.
    fn extended(self, plane: &Plane, rows: &std::ops::Range<isize>) -> std::ops::Range<isize> {
        const STEP: isize = 12;
        // Signal-to-noise ratio of light in one step, and in two: noise has either in one of a hundred.
        const LIT: [f64; 2] = [2.5, 3.0];
        let snr = |rows: std::ops::Range<isize>| {
            let (sum, known) = self.part(plane, rows);
            if known > 0.0 { sum / known.sqrt() } else { 0.0 }
        };
        let (mut start, mut end) = (rows.start, rows.end);
        while end < plane.height.cast_signed() && (snr(end..end + STEP) > LIT[0] || snr(end..end + 2 * STEP) > LIT[1]) {
            end += STEP;
        }
        while start > 0 && (snr(start - STEP..start) > LIT[0] || snr(start - 2 * STEP..start) > LIT[1]) {
            start -= STEP;
        }
        start.max(0)..end.min(plane.height.cast_signed())
    }
}

/// Signal-to-noise ratio of the faintest parts of a line.
pub(super) fn trimmed(plane: &Plane, line: &StripLine) -> f64 {
    let (way, rows) = (Way::of(line), line.rows / PARTS);
    let part = |k: usize| {
        let first = (line.first_row + k * rows).cast_signed();
        way.part(plane, first..first + rows.cast_signed())
    };
    let mut parts: Vec<(f64, f64)> = (0..PARTS).map(part).filter(|(_, known)| *known > 0.0).collect();
    if parts.len() < PARTS - TRIMMED {
        return 0.0;
    }
    ascending(&mut parts, |a| a.0 / a.1.sqrt());
    parts.truncate(PARTS - TRIMMED);
    let (sum, known) = parts.iter().fold((0.0, 0.0), |(sum, known), own| (sum + own.0, known + own.1));
    sum / known.sqrt()
}

/// The ends of the light along a line, column and row.
pub(super) fn ends(plane: &Plane, line: &StripLine) -> [[f64; 2]; 2] {
    const ROUNDS: usize = 4;
    let mut way = Way::of(line);
    let mut rows = line.first_row.cast_signed()..(line.first_row + line.rows).cast_signed();
    for _ in 0..ROUNDS {
        way = way.centred(plane, rows.clone());
        rows = way.extended(plane, &rows);
    }
    [rows.start as f64, (rows.end - 1) as f64].map(|row| [way.at(row), row])
}

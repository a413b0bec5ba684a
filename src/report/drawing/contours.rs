//! Lines of equal value on a regular grid.

use std::collections::BTreeMap;

/// A piece of a contour, in units of the grid's steps from its first point.
pub(super) type Segment = [(f64, f64); 2];

/// Values on a regular grid, row by row.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid<'a> {
    /// The values.
    pub(super) values: &'a [f64],
    /// Points along each side.
    pub(super) side: usize,
}

impl Grid<'_> {
    fn at(&self, column: usize, row: usize) -> f64 {
        self.values[row * self.side + column]
    }

    /// The value between the points, bilinear; places outside take the edge's.
    pub(super) fn between(&self, column: f64, row: f64) -> f64 {
        let last = self.side - 1;
        let cell = |at: f64| {
            let below = (at.max(0.0).floor() as usize).min(last.saturating_sub(1));
            (below, (below + 1).min(last), (at - below as f64).clamp(0.0, 1.0))
        };
        let ((left, right, u), (top, bottom, v)) = (cell(column), cell(row));
        let along = |row: usize| self.at(left, row) * (1.0 - u) + self.at(right, row) * u;
        along(top) * (1.0 - v) + along(bottom) * v
    }

    /// The line on which the values pass a level, by marching squares.
    ///
    /// Source: Maple, "Geometric design and space planning using the marching squares and marching cube algorithms" (2003).
    pub(super) fn contour(&self, level: f64) -> Vec<Segment> {
        let mut segments = Vec::new();
        for row in 0..self.side.saturating_sub(1) {
            for column in 0..self.side - 1 {
                let (x, y) = (column as f64, row as f64);
                let corners = [((x, y), 0, 0), ((x + 1.0, y), 1, 0), ((x + 1.0, y + 1.0), 1, 1), ((x, y + 1.0), 0, 1)]
                    .map(|(place, right, down)| (place, self.at(column + right, row + down) - level));
                if corners.iter().any(|(_, height)| !height.is_finite()) {
                    continue;
                }
                let crossings: Vec<(f64, f64)> = (0..4)
                    .filter_map(|edge| {
                        let ((a, from), (b, to)) = (corners[edge], corners[(edge + 1) % 4]);
                        let part = from / (from - to);
                        ((from < 0.0) != (to < 0.0)).then_some((a.0 + part * (b.0 - a.0), a.1 + part * (b.1 - a.1)))
                    })
                    .collect();
                match crossings[..] {
                    [a, b] => segments.push([a, b]),
                    // A saddle: the middle says which corners belong together.
                    [a, b, c, d] => {
                        let middle: f64 = corners.iter().map(|(_, height)| height).sum();
                        let first_alone = (middle < 0.0) != (corners[0].1 < 0.0);
                        segments.extend(if first_alone { [[d, a], [b, c]] } else { [[a, b], [c, d]] });
                    }
                    _ => {}
                }
            }
        }
        segments
    }

    /// The same in pieces that hang together.
    pub(super) fn pieces(&self, level: f64) -> Vec<Vec<Segment>> {
        // An end is computed from both sides of an edge, with other roundings.
        const SAME: f64 = 1e6;
        let key = |(x, y): (f64, f64)| ((x * SAME).round() as i64, (y * SAME).round() as i64);
        let segments = self.contour(level);
        let mut at: BTreeMap<(i64, i64), Vec<usize>> = BTreeMap::new();
        for (index, segment) in segments.iter().enumerate() {
            for end in segment {
                at.entry(key(*end)).or_default().push(index);
            }
        }
        let mut seen = vec![false; segments.len()];
        let mut pieces = Vec::new();
        for start in 0..segments.len() {
            let (mut piece, mut open) = (Vec::new(), vec![start]);
            while let Some(index) = open.pop() {
                if !std::mem::replace(&mut seen[index], true) {
                    piece.push(segments[index]);
                    open.extend(segments[index].iter().filter_map(|end| at.get(&key(*end))).flatten());
                }
            }
            if !piece.is_empty() {
                pieces.push(piece);
            }
        }
        pieces
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_contour_of_a_cone_is_a_circle() {
        let side = 41;
        let values: Vec<f64> = (0..side * side).map(|k| ((k % side) as f64 - 20.0).hypot((k / side) as f64 - 20.0)).collect();
        let grid = Grid { values: &values, side };
        let segments = grid.contour(12.3);
        let length: f64 = segments.iter().map(|[a, b]| (a.0 - b.0).hypot(a.1 - b.1)).sum();
        assert!((length / (std::f64::consts::TAU * 12.3) - 1.0).abs() < 0.01, "{length}");
        for (x, y) in segments.into_iter().flatten() {
            assert!(((x - 20.0).hypot(y - 20.0) - 12.3).abs() < 0.02, "{x} {y}");
            assert!((grid.between(x, y) - 12.3).abs() < 1e-9);
        }
        assert!(grid.contour(1e3).is_empty());
    }

    #[test]
    fn pieces_hang_together() {
        let side = 41;
        let ring = |k: usize| ((k % side) as f64 - 19.7).hypot((k / side) as f64 - 20.1) - 10.0;
        let values: Vec<f64> = (0..side * side).map(|k| ring(k).abs()).collect();
        let grid = Grid { values: &values, side };
        let pieces = grid.pieces(4.0);
        assert_eq!(pieces.len(), 2, "the circles of radius 6 and 14");
        assert_eq!(pieces.iter().map(Vec::len).sum::<usize>(), grid.contour(4.0).len());
        assert!(grid.pieces(-1.0).is_empty());
    }

    #[test]
    fn a_saddle_gives_two_lines_that_do_not_cross() {
        for (values, corner) in [([1.0, -0.5, -0.5, 1.0], true), ([1.0, -2.0, -2.0, 1.0], false)] {
            let segments = Grid { values: &values, side: 2 }.contour(0.0);
            assert_eq!(segments.len(), 2);
            // Where the middle is high, the low corners are cut off; else the high ones.
            let cut = if corner { (1.0, 0.0) } else { (0.0, 0.0) };
            let near = |[a, b]: Segment| {
                let middle = (f64::midpoint(a.0, b.0), f64::midpoint(a.1, b.1));
                (middle.0 - cut.0).hypot(middle.1 - cut.1) < 0.5
            };
            assert!(segments.iter().any(|segment| near(*segment)), "{segments:?}");
        }
        let hole = [f64::NAN, 1.0, -1.0, 1.0];
        assert!(Grid { values: &hole, side: 2 }.contour(0.0).is_empty());
    }
}

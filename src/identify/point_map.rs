//! Occupancy map of a frame's detections, one bit a cell.

use super::pose::Points;

/// Radius within which a catalogue star must find a detection, over the size of the frame.
const CHECK_RADIUS: f64 = 0.0085;
/// The share of the brightest catalogue stars in the frame that a right candidate finds, at least; and where there are only few
/// detections, so that some of the brightest stars may be missing.
const FOUND: f64 = 0.5;
const FOUND_OF_FEW: f64 = 0.3;
/// So many are few.
const FEW: usize = 16;

/// Answers "is there a detection near this place?" by one bit; small enough for the fastest cache.
pub(super) struct PointMap {
    origin_px: [f32; 2],
    cells_per_px: f32,
    columns: usize,
    rows: usize,
    bits: Vec<u64>,
    pub(super) radius_px: f64,
    /// ln of the likelihood, over that of chance, of a star that is found and of one that is not.
    pub(super) gain: f64,
    pub(super) loss: f64,
}

impl PointMap {
    pub(super) fn new(ideal: &[[f64; 2]], points: &Points) -> Self {
        let radius_px = CHECK_RADIUS * points.size_px;
        let cells_per_px = 2.5 / radius_px;
        // Distortion may carry points out of the frame.
        let reach = |axis: usize| ideal.iter().map(|p| p[axis].abs()).fold(points.half_px[axis], f64::max) + 2.0 * radius_px;
        let origin_px = [-reach(0), -reach(1)];
        let cells = |axis: usize| (-2.0 * origin_px[axis] * cells_per_px) as usize + 1;
        let (columns, rows) = (cells(0), cells(1));
        let mut bits = vec![0_u64; (columns * rows).div_ceil(64) + 1];
        for &[x, y] in ideal {
            let (cx, cy) = ((x - origin_px[0]) * cells_per_px, (y - origin_px[1]) * cells_per_px);
            let (first, last) = ((cx - 2.5).max(0.0) as usize, ((cx + 2.5) as usize).min(columns - 1));
            // At most six columns: the squares of their distances, and those of them that there are.
            let across2: [f64; 6] = std::array::from_fn(|column| ((first + column) as f64 + 0.5 - cx).powi(2));
            let columns_there = (1_u64 << (last + 1 - first)) - 1;
            for row in (cy - 2.5).max(0.0) as usize..=((cy + 2.5) as usize).min(rows - 1) {
                let along2 = (row as f64 + 0.5 - cy).powi(2);
                let near = (0..6).fold(0, |near, column| near | u64::from(across2[column] + along2 <= 2.5 * 2.5) << column) & columns_there;
                let cell = row * columns + first;
                // In one word or in two.
                bits[cell / 64] |= near << (cell % 64);
                bits[cell / 64 + 1] |= near >> 1 >> (63 - cell % 64);
            }
        }
        let disc = std::f64::consts::PI * radius_px * radius_px / points.area_px2();
        let covered = (ideal.len() as f64 * disc).clamp(1e-6, 0.3);
        let found = if ideal.len() <= FEW { FOUND_OF_FEW } else { FOUND };
        let (gain, loss) = ((found / covered).ln(), ((1.0 - found) / (1.0 - covered)).ln());
        Self { origin_px: origin_px.map(|c| c as f32), cells_per_px: cells_per_px as f32, columns, rows, bits, radius_px, gain, loss }
    }

    /// Whether a point is within about a radius of this place.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "inlined into what is compiled for several processors")]
    pub(super) fn has_point_near(&self, x_px: f32, y_px: f32) -> bool {
        let (cx, cy) = ((x_px - self.origin_px[0]) * self.cells_per_px, (y_px - self.origin_px[1]) * self.cells_per_px);
        if !(cx >= 0.0 && cy >= 0.0) || cx >= self.columns as f32 || cy >= self.rows as f32 {
            return false;
        }
        let cell = cy as i32 as usize * self.columns + cx as i32 as usize;
        self.bits[cell / 64] >> (cell % 64) & 1 == 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(centred_px: Vec<[f64; 2]>) -> Points {
        let detection = (0..centred_px.len()).collect();
        Points { centred_px, detection, half_px: [512.0, 384.0], size_px: 886.8, corner_px: 640.0, reach_px: 640.0 }
    }

    #[test]
    fn the_map_answers_as_looking_at_every_point_does_to_within_its_cells() {
        let places = [[0.0, 0.0], [-511.0, 380.0], [100.0, -50.0], [106.0, -44.0], [530.0, 10.0]];
        let points = points(places.to_vec());
        let map = PointMap::new(&points.centred_px, &points);
        // A cell is 0.4 radii wide: its middle lies within 0.29 radii of all of it.
        let slack_px = 0.3 * map.radius_px;
        let (mut near, mut far) = (0, 0);
        for row in -80..80 {
            for column in -110..110 {
                let (x, y) = (5.03 * f64::from(column), 5.07 * f64::from(row));
                let distance_px = places.iter().map(|[px, py]| (px - x).hypot(py - y)).fold(f64::INFINITY, f64::min);
                if distance_px < map.radius_px - slack_px {
                    near += 1;
                    assert!(map.has_point_near(x as f32, y as f32), "{x} {y}: {distance_px} px away");
                } else if distance_px > map.radius_px + slack_px {
                    far += 1;
                    assert!(!map.has_point_near(x as f32, y as f32), "{x} {y}: {distance_px} px away");
                }
            }
        }
        assert!(near > 10 && far > 10_000, "{near} {far}");
        for (x, y) in [(1e6, 0.0), (-1e6, 0.0), (0.0, 1e6), (0.0, -1e6), (f32::NAN, 0.0)] {
            assert!(!map.has_point_near(x, y));
        }
    }

    #[test]
    fn a_found_star_speaks_for_a_candidate_and_the_less_the_more_points_there_are() {
        let many = |count: u32| points((0..count).map(|i| [f64::from(i % 30) * 30.0 - 450.0, f64::from(i / 30) * 30.0 - 300.0]).collect());
        let map = |count| {
            let points = many(count);
            PointMap::new(&points.centred_px, &points)
        };
        let (few, more, most) = (map(10), map(40), map(200));
        for map in [&few, &more, &most] {
            assert!(map.gain > 0.0 && map.loss < 0.0, "{} {}", map.gain, map.loss);
        }
        assert!(few.gain > more.gain && more.gain > most.gain);
        // ln of 0.5 over the share of the frame that 40 circles cover.
        let covered = 40.0 * std::f64::consts::PI * more.radius_px * more.radius_px / (1024.0 * 768.0);
        assert!((more.gain - (0.5 / covered).ln()).abs() < 1e-12 && (more.loss - (0.5 / (1.0 - covered)).ln()).abs() < 1e-12);
    }
}

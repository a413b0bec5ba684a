//! Finding stars near a direction: exactly (declination zones) and fast (a table of cells on a cube around the sky).

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::Vector3;

/// Stars sorted into zones of declination and by right ascension inside a zone; answers cone searches exactly.
#[derive(Debug)]
pub(super) struct Zones {
    height_rad: f64,
    zones: Vec<Vec<(f64, u32)>>,
}

impl Zones {
    /// Sorts the stars `ids` of `vectors` into zones about `height_rad` high. Directions that are not finite are left out.
    pub(super) fn new(vectors: &[Vector3<f64>], ids: impl Iterator<Item = u32>, height_rad: f64) -> Self {
        let count = (PI / height_rad).ceil().clamp(1.0, 1800.0) as usize;
        let height_rad = PI / count as f64;
        let mut zones = vec![Vec::new(); count];
        for id in ids {
            let v = vectors[id as usize];
            if v.iter().all(|c| c.is_finite()) {
                let (ra, dec) = (v.y.atan2(v.x).rem_euclid(TAU), v.z.atan2(v.x.hypot(v.y)));
                let zone = (((dec + FRAC_PI_2) / height_rad) as usize).min(count - 1);
                zones[zone].push((ra, id));
            }
        }
        for zone in &mut zones {
            zone.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        }
        Self { height_rad, zones }
    }

    /// Appends to `found` the stars within `radius_rad` of `centre`, in no particular but always the same order.
    pub(super) fn within(&self, vectors: &[Vector3<f64>], centre: &Vector3<f64>, radius_rad: f64, found: &mut Vec<u32>) {
        let (ra, dec) = (centre.y.atan2(centre.x).rem_euclid(TAU), centre.z.atan2(centre.x.hypot(centre.y)));
        let chord2 = chord2_of_angle(radius_rad);
        let first = ((dec - radius_rad + FRAC_PI_2) / self.height_rad).max(0.0) as usize;
        let last = (((dec + radius_rad + FRAC_PI_2) / self.height_rad).max(0.0) as usize).min(self.zones.len() - 1);
        // The widest difference of right ascension on the circle: asin(sin r / cos δ), the whole round if a pole is inside.
        let half = if dec.abs() + radius_rad >= FRAC_PI_2 { PI } else { (radius_rad.sin() / dec.cos()).min(1.0).asin() + 1e-12 };
        let mut take = |zone: &[(f64, u32)], low: f64, high: f64| {
            let start = zone.partition_point(|s| s.0 < low);
            for &(star_ra, id) in &zone[start..] {
                if star_ra > high {
                    break;
                }
                if (vectors[id as usize] - centre).norm_squared() <= chord2 {
                    found.push(id);
                }
            }
        };
        for zone in self.zones.get(first..=last).unwrap_or_default() {
            if half >= PI {
                take(zone, 0.0, TAU);
            } else {
                take(zone, ra - half, ra + half);
                if ra - half < 0.0 {
                    take(zone, ra - half + TAU, TAU);
                }
                if ra + half > TAU {
                    take(zone, 0.0, ra + half - TAU);
                }
            }
        }
    }
}

/// The square of the chord of an angle on the unit sphere.
pub(super) fn chord2_of_angle(angle_rad: f64) -> f64 {
    let half = (angle_rad / 2.0).min(FRAC_PI_2).sin();
    4.0 * half * half
}

/// Answers "is there a star within ρ of here?" with one look into one cell: every star stands in all the cells that its
/// disc of the largest permitted ρ touches. The cells are squares on the faces of a cube around the sky.
#[derive(Debug)]
pub(super) struct NearTable {
    per_edge: usize,
    offsets: Vec<u32>,
    stars: Vec<u32>,
}

impl NearTable {
    /// A table of the stars `ids` for questions up to `radius_rad`, with cells about `cell_rad` wide.
    pub(super) fn new(vectors: &[Vector3<f64>], ids: &[u32], radius_rad: f64, cell_rad: f64) -> Self {
        let per_edge = (FRAC_PI_2 / cell_rad).clamp(2.0, 700.0) as usize;
        let cells = 6 * per_edge * per_edge;
        let mut entries: Vec<(u32, u32)> = Vec::new();
        for &id in ids {
            let v = vectors[id as usize];
            for face in 0..6 {
                let (a, b, m) = face_coordinates(face, &v);
                if m < 0.2 {
                    continue; // more than a radius away from this face
                }
                let (a, b) = (a / m, b / m);
                // An angle dθ covers at most dθ·(1 + a² + b²) on the face; a third more for the curvature.
                let reach = 1.3 * radius_rad * (1.0 + a * a + b * b);
                let range = |c: f64| {
                    let scale = per_edge as f64 / 2.0;
                    let (low, high) = ((c - reach + 1.0) * scale, (c + reach + 1.0) * scale);
                    (high >= 0.0 && low < per_edge as f64).then(|| (low.max(0.0) as usize, (high as usize).min(per_edge - 1)))
                };
                if let (Some((a0, a1)), Some((b0, b1))) = (range(a), range(b)) {
                    for row in b0..=b1 {
                        for column in a0..=a1 {
                            entries.push((((face * per_edge + row) * per_edge + column) as u32, id));
                        }
                    }
                }
            }
        }
        entries.sort_unstable();
        let mut offsets = vec![0_u32; cells + 1];
        for &(cell, _) in &entries {
            offsets[cell as usize + 1] += 1;
        }
        for cell in 0..cells {
            offsets[cell + 1] += offsets[cell];
        }
        Self { per_edge, offsets, stars: entries.into_iter().map(|(_, id)| id).collect() }
    }

    /// Whether a star stands within a chord whose square is `chord2` of the unit vector `v`.
    pub(super) fn has_star_near(&self, vectors: &[Vector3<f64>], v: &Vector3<f64>, chord2: f64) -> bool {
        let (x, y, z) = (v.x.abs(), v.y.abs(), v.z.abs());
        let axis = if x >= y && x >= z { 0 } else { 1 + usize::from(z > y) };
        let face = 2 * axis + usize::from(v[axis] < 0.0);
        let (a, b, m) = face_coordinates(face, v);
        let scale = self.per_edge as f64 / 2.0;
        let column = (((a / m + 1.0) * scale) as usize).min(self.per_edge - 1);
        let row = (((b / m + 1.0) * scale) as usize).min(self.per_edge - 1);
        let cell = (face * self.per_edge + row) * self.per_edge + column;
        let (start, end) = (self.offsets[cell] as usize, self.offsets[cell + 1] as usize);
        self.stars[start..end].iter().any(|&id| (vectors[id as usize] - v).norm_squared() <= chord2)
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        4 * (self.offsets.len() + self.stars.len())
    }
}

/// The two components along a face of the cube and the one across it (positive in front of it).
fn face_coordinates(face: usize, v: &Vector3<f64>) -> (f64, f64, f64) {
    let axis = face / 2;
    let sign = if face.is_multiple_of(2) { 1.0 } else { -1.0 };
    (v[(axis + 1) % 3], v[(axis + 2) % 3], sign * v[axis])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scattered(count: usize) -> Vec<Vector3<f64>> {
        // A Fibonacci lattice, jittered by an irrational step, plus both poles.
        let mut all: Vec<_> = (0..count)
            .map(|i| {
                let z = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
                let ra = i as f64 * 2.399_963_229 + (i as f64 * 0.754_877).fract();
                let r = (1.0 - z * z).sqrt();
                Vector3::new(r * ra.cos(), r * ra.sin(), z)
            })
            .collect();
        all.push(Vector3::z());
        all.push(-Vector3::z());
        all
    }

    #[test]
    fn cone_search_finds_what_looking_at_every_star_finds() {
        let vectors = scattered(4000);
        let zones = Zones::new(&vectors, 0..vectors.len() as u32, 0.05);
        for (k, radius) in [0.01, 0.04, 0.2, 1.0, 2.5].into_iter().enumerate() {
            for centre in scattered(37) {
                let mut found = Vec::new();
                zones.within(&vectors, &centre, radius, &mut found);
                found.sort_unstable();
                let expected: Vec<u32> =
                    (0..vectors.len() as u32).filter(|&i| (vectors[i as usize] - centre).norm_squared() <= chord2_of_angle(radius)).collect();
                assert_eq!(found, expected, "radius number {k}");
            }
        }
    }

    #[test]
    fn the_near_table_agrees_with_looking_at_every_star() {
        let vectors = scattered(3000);
        let ids: Vec<u32> = (0..vectors.len() as u32).filter(|i| i % 3 != 0).collect();
        let radius = 0.02;
        let table = NearTable::new(&vectors, &ids, radius, 0.07);
        let chord2 = chord2_of_angle(radius);
        let mut hits = 0;
        for question in scattered(20_000) {
            let expected = ids.iter().any(|&i| (vectors[i as usize] - question).norm_squared() <= chord2);
            assert_eq!(table.has_star_near(&vectors, &question, chord2), expected);
            hits += usize::from(expected);
        }
        assert!(hits > 1000 && hits < 19_000, "{hits}: the comparison must see both answers");
    }
}

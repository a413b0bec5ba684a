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

/// Answers "is there a star within ρ of here?" by one bit: a map of the sky, on the faces of a cube, in which every cell whose
/// middle lies within ρ of a star is set. With cells of [`CELL`]·ρ the edge of ρ is blurred by as much, which a check can bear
/// and a cache likes.
#[derive(Debug)]
pub(super) struct StarMap {
    per_edge: usize,
    bits: Vec<u64>,
    /// The part of the sky that is set, at most.
    pub(super) covered: f64,
}

/// Width of a cell of [`StarMap`] over ρ.
const CELL: f64 = 0.7;

impl StarMap {
    /// A map of the stars `ids` with ρ = `radius_rad`.
    pub(super) fn new(vectors: &[Vector3<f64>], ids: &[u32], radius_rad: f64) -> Self {
        let per_edge = (FRAC_PI_2 / (CELL * radius_rad)).clamp(2.0, 10_000.0) as usize;
        let mut bits = vec![0_u64; (6 * per_edge * per_edge).div_ceil(64)];
        let chord2 = chord2_of_angle(radius_rad);
        let scale = per_edge as f64 / 2.0;
        for &id in ids {
            let v = vectors[id as usize];
            for face in 0..6 {
                let (a, b, m) = face_coordinates(face, &v);
                if m.is_nan() || m < 0.2 {
                    continue; // more than a radius away from this face
                }
                let (a, b) = (a / m, b / m);
                // An angle dθ covers at most dθ·(1 + a² + b²) on the face; a third more for the curvature.
                let reach = 1.3 * radius_rad * (1.0 + a * a + b * b);
                let range = |c: f64| {
                    let (low, high) = ((c - reach + 1.0) * scale, (c + reach + 1.0) * scale);
                    (high >= 0.0 && low < per_edge as f64).then(|| (low.max(0.0) as usize, (high as usize).min(per_edge - 1)))
                };
                if let (Some((a0, a1)), Some((b0, b1))) = (range(a), range(b)) {
                    for row in b0..=b1 {
                        for column in a0..=a1 {
                            let middle = |c: usize| (c as f64 + 0.5) / scale - 1.0;
                            let u = along_face(face, middle(column), middle(row)).normalize();
                            if (u - v).norm_squared() <= chord2 {
                                let cell = (face * per_edge + row) * per_edge + column;
                                bits[cell / 64] |= 1 << (cell % 64);
                            }
                        }
                    }
                }
            }
        }
        Self { per_edge, bits, covered: ids.len() as f64 * chord2 / 4.0 }
    }

    /// Whether a star stands near the direction `v` (of any length).
    pub(super) fn has_star_near(&self, v: &Vector3<f64>) -> bool {
        let (x, y, z) = (v.x.abs(), v.y.abs(), v.z.abs());
        let axis = if x >= y && x >= z { 0 } else { 1 + usize::from(z > y) };
        let face = 2 * axis + usize::from(v[axis] < 0.0);
        let (a, b, m) = face_coordinates(face, v);
        let scale = self.per_edge as f64 / 2.0;
        let over = scale / m;
        let column = ((a * over + scale) as usize).min(self.per_edge - 1);
        let row = ((b * over + scale) as usize).min(self.per_edge - 1);
        let cell = (face * self.per_edge + row) * self.per_edge + column;
        self.bits[cell / 64] >> (cell % 64) & 1 == 1
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        8 * self.bits.len()
    }
}

/// The direction at a place on a face: the inverse of [`face_coordinates`].
fn along_face(face: usize, a: f64, b: f64) -> Vector3<f64> {
    let axis = face / 2;
    let mut v = Vector3::zeros();
    v[axis] = if face.is_multiple_of(2) { 1.0 } else { -1.0 };
    v[(axis + 1) % 3] = a;
    v[(axis + 2) % 3] = b;
    v
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
                let expected: Vec<u32> = (0..vectors.len() as u32)
                    .filter(|&i| (vectors[i as usize] - centre).norm_squared() <= chord2_of_angle(radius))
                    .collect();
                assert_eq!(found, expected, "radius number {k}");
            }
        }
    }

    #[test]
    fn the_map_agrees_with_looking_at_every_star_but_for_the_blur_of_its_cells() {
        let vectors = scattered(3000);
        let ids: Vec<u32> = (0..vectors.len() as u32).filter(|i| i % 3 != 0).collect();
        let radius = 0.02;
        let map = StarMap::new(&vectors, &ids, radius);
        let (mut set, mut inside) = (0, 0);
        for question in scattered(20_000) {
            let nearest = ids.iter().map(|&i| (vectors[i as usize] - question).norm()).fold(f64::INFINITY, f64::min);
            let answer = map.has_star_near(&(question * 3.7));
            // Half the diagonal of a cell, which is at most as wide in angle as at the middle of a face.
            let blur = CELL * radius * 0.5_f64.sqrt() * 4.0 / PI;
            assert!(!(answer && nearest > radius + blur), "{nearest}");
            assert!(answer || nearest > radius - blur, "{nearest}");
            set += usize::from(answer);
            inside += usize::from(nearest <= radius);
        }
        // The blur takes as much as it gives, and discs that overlap only lessen what is covered.
        assert!((set as f64 / inside as f64 - 1.0).abs() < 0.05, "{set} {inside}");
        assert!(map.covered > set as f64 / 20_002.0, "{}", map.covered);
    }
}

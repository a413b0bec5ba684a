//! Cone search: catalogue stars near a direction, by zones of declination.

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
}

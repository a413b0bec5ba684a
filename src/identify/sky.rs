//! Cone search: catalogue stars near a direction, by zones of declination.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::ops::Range;

use nalgebra::Vector3;

/// So many stars go through the processor together.
pub(super) const LANES: usize = 16;

/// Stars sorted into zones of declination and by right ascension inside a zone; answers cone searches exactly.
#[derive(Debug)]
pub(super) struct Zones {
    height_rad: f64,
    /// Where each zone begins in the lists, and where the last ends.
    ends: Vec<usize>,
    ra_rad: Vec<f64>,
    ids: Vec<u32>,
    /// The directions once more, in the same order, to be read one after another: x, y and z. Zeros follow the last, so that lanes can always be
    /// filled.
    xyz: [Vec<f32>; 3],
}

impl Zones {
    /// Sorts the stars `ids` of `vectors` into zones about `height_rad` high. Directions that are not finite are left out.
    pub(super) fn new(vectors: &[Vector3<f64>], ids: impl Iterator<Item = u32>, height_rad: f64) -> Self {
        let count = (PI / height_rad).ceil().clamp(1.0, 1800.0) as usize;
        let height_rad = PI / count as f64;
        let mut all: Vec<(usize, f64, u32)> = ids
            .filter(|id| vectors[*id as usize].iter().all(|c| c.is_finite()))
            .map(|id| {
                let v = vectors[id as usize];
                let (ra, dec) = (v.y.atan2(v.x).rem_euclid(TAU), v.z.atan2(v.x.hypot(v.y)));
                ((((dec + FRAC_PI_2) / height_rad) as usize).min(count - 1), ra, id)
            })
            .collect();
        all.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
        let zones = all.iter().map(|(zone, ..)| *zone);
        Self::of_sorted(vectors, height_rad, count, zones, all.iter().map(|(_, ra, id)| (*ra, *id)))
    }

    /// The same zones with the first `count` stars of the catalogue alone.
    pub(super) fn first(&self, vectors: &[Vector3<f64>], count: usize) -> Self {
        let of_zone = |zone: usize| (self.ends[zone]..self.ends[zone + 1]).map(move |place| (zone, place));
        let left: Vec<(usize, usize)> =
            (0..self.ends.len() - 1).flat_map(of_zone).filter(|(_, place)| (self.ids[*place] as usize) < count).collect();
        let stars = left.iter().map(|(_, place)| (self.ra_rad[*place], self.ids[*place]));
        Self::of_sorted(vectors, self.height_rad, self.ends.len() - 1, left.iter().map(|(zone, _)| *zone), stars)
    }

    fn of_sorted(
        vectors: &[Vector3<f64>],
        height_rad: f64,
        count: usize,
        zones: impl Iterator<Item = usize>,
        stars: impl Iterator<Item = (f64, u32)>,
    ) -> Self {
        let mut ends = vec![0; count + 1];
        for zone in zones {
            ends[zone + 1] += 1;
        }
        for zone in 0..count {
            ends[zone + 1] += ends[zone];
        }
        let (ra_rad, ids): (Vec<f64>, Vec<u32>) = stars.unzip();
        let axis = |axis: usize| ids.iter().map(|id| vectors[*id as usize][axis] as f32).chain([0.0; LANES]).collect();
        Self { height_rad, ends, ra_rad, xyz: [axis(0), axis(1), axis(2)], ids }
    }

    /// The stars in the order of the zones, as indices of the catalogue.
    pub(super) fn ids(&self) -> &[u32] {
        &self.ids
    }

    /// Directions of the stars from this place of the order on: as many as go together, zeros after the last.
    pub(super) fn lanes(&self, place: usize) -> [&[f32; LANES]; 3] {
        const NONE: [f32; LANES] = [0.0; LANES];
        self.xyz.each_ref().map(|axis| axis.get(place..).and_then(|rest| rest.first_chunk()).unwrap_or(&NONE))
    }

    /// Hands over the places, in the order of the zones, among which all stars within `radius_rad` of `centre` stand.
    pub(super) fn runs(&self, centre: &Vector3<f64>, radius_rad: f64, mut run: impl FnMut(Range<usize>)) {
        let (ra, dec) = (centre.y.atan2(centre.x).rem_euclid(TAU), centre.z.atan2(centre.x.hypot(centre.y)));
        let zones = self.ends.len() - 1;
        let first = ((dec - radius_rad + FRAC_PI_2) / self.height_rad).max(0.0) as usize;
        let last = (((dec + radius_rad + FRAC_PI_2) / self.height_rad).max(0.0) as usize).min(zones - 1);
        // The widest difference of right ascension on the circle: asin(sin r / cos δ), the whole round if a pole is inside.
        let half = if dec.abs() + radius_rad >= FRAC_PI_2 { PI } else { (radius_rad.sin() / dec.cos()).min(1.0).asin() + 1e-12 };
        for zone in first..=last {
            let all = self.ends[zone]..self.ends[zone + 1];
            if half >= PI {
                run(all);
                continue;
            }
            let between = |low: f64, high: f64| {
                let zone = &self.ra_rad[all.clone()];
                all.start + zone.partition_point(|ra| *ra < low)..all.start + zone.partition_point(|ra| *ra <= high)
            };
            run(between(ra - half, ra + half));
            if ra - half < 0.0 {
                run(between(ra - half + TAU, TAU));
            }
            if ra + half > TAU {
                run(between(0.0, ra + half - TAU));
            }
        }
    }

    /// Appends to `found` the stars within `radius_rad` of `centre`, in no particular but always the same order.
    pub(super) fn within(&self, vectors: &[Vector3<f64>], centre: &Vector3<f64>, radius_rad: f64, found: &mut Vec<u32>) {
        /// What single precision can be off by in the square of a chord, at most.
        const SLACK: f32 = 4e-6;
        let chord2 = chord2_of_angle(radius_rad);
        let (near2, [cx, cy, cz]) = (chord2 as f32, [centre.x as f32, centre.y as f32, centre.z as f32]);
        self.runs(centre, radius_rad, |run| {
            let [xs, ys, zs] = self.xyz.each_ref().map(|axis| &axis[run.clone()]);
            for (((x, y), z), id) in xs.iter().zip(ys).zip(zs).zip(&self.ids[run.clone()]) {
                let off = (x - cx) * (x - cx) + (y - cy) * (y - cy) + (z - cz) * (z - cz) - near2;
                // On the edge the full precision decides.
                if off < -SLACK || off < SLACK && (vectors[*id as usize] - centre).norm_squared() <= chord2 {
                    found.push(*id);
                }
            }
        });
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

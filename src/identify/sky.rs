//! Cone search: catalogue stars near a direction, by zones of declination.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::ops::Range;

use nalgebra::Vector3;

/// So many stars go through the processor together.
pub(super) const LANES: usize = 16;

/// Bins of right ascension are so wide as zones are high, times this, where they are widest.
const BIN_OVER_HEIGHT: f64 = 0.5;
/// What rounding may take from the half width of a zone's part, rad.
const ROUNDING_RAD: f64 = 1e-7;

/// Stars sorted into zones of declination and by right ascension inside a zone; answers cone searches exactly.
#[derive(Debug)]
pub(super) struct Zones {
    height_rad: f64,
    /// Of each zone, and of one after the last: the number of its first bin of right ascension, and its bins per radian.
    bins: Vec<(usize, f64)>,
    /// Where each bin begins in the order of the stars, and where the last ends.
    starts: Vec<u32>,
    /// The stars in their order.
    blocks: Vec<Block>,
}

/// Stars that stand side by side: their directions, zeros after the last, and their indices in the catalogue. In lines of the cache.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub(super) struct Block {
    pub(super) xyz: [[f32; LANES]; 3],
    pub(super) ids: [u32; LANES],
}

impl Zones {
    /// Sorts the stars `ids` of `vectors` into zones about `height_rad` high. Directions that are not finite are left out.
    pub(super) fn new(vectors: &[Vector3<f64>], ids: impl Iterator<Item = u32>, height_rad: f64) -> Self {
        let count = (PI / height_rad).ceil().clamp(1.0, 1800.0) as usize;
        let height_rad = PI / count as f64;
        let bins = bins(count, height_rad);
        let mut all: Vec<(usize, f64, u32)> = ids
            .filter(|id| vectors[*id as usize].iter().all(|c| c.is_finite()))
            .map(|id| {
                let v = vectors[id as usize];
                let (ra, dec) = (v.y.atan2(v.x).rem_euclid(TAU), v.z.atan2(v.x.hypot(v.y)));
                let zone = (((dec + FRAC_PI_2) / height_rad) as usize).min(count - 1);
                let ((first, per_rad), (end, _)) = (bins[zone], bins[zone + 1]);
                ((first + (ra * per_rad) as usize).min(end - 1), ra, id)
            })
            .collect();
        all.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
        Self::of_sorted(vectors, height_rad, bins, all.iter().map(|(bin, _, id)| (*bin, *id)))
    }

    /// The same zones with the first `count` stars of the catalogue alone.
    pub(super) fn first(&self, vectors: &[Vector3<f64>], count: usize) -> Self {
        let of_bin = |bin: usize| (self.starts[bin]..self.starts[bin + 1]).map(move |place| (bin, self.id(place as usize)));
        let left = (0..self.starts.len() - 1).flat_map(of_bin).filter(|(_, id)| (*id as usize) < count);
        Self::of_sorted(vectors, self.height_rad, self.bins.clone(), left)
    }

    /// From stars in their order, each with the number of its bin.
    fn of_sorted(vectors: &[Vector3<f64>], height_rad: f64, bins: Vec<(usize, f64)>, stars: impl Iterator<Item = (usize, u32)>) -> Self {
        let mut starts = vec![0; bins[bins.len() - 1].0 + 1];
        let mut blocks = Vec::new();
        for (place, (bin, id)) in stars.enumerate() {
            starts[bin + 1] += 1;
            if place % LANES == 0 {
                blocks.push(Block { xyz: [[0.0; LANES]; 3], ids: [0; LANES] });
            }
            let block = &mut blocks[place / LANES];
            block.ids[place % LANES] = id;
            for (lanes, component) in block.xyz.iter_mut().zip(vectors[id as usize].iter()) {
                lanes[place % LANES] = *component as f32;
            }
        }
        for bin in 1..starts.len() {
            starts[bin] += starts[bin - 1];
        }
        Self { height_rad, bins, starts, blocks }
    }

    /// The stars in the order of the zones, as indices of the catalogue.
    pub(super) fn ids(&self) -> impl Iterator<Item = u32> {
        (0..self.starts[self.starts.len() - 1]).map(|place| self.id(place as usize))
    }

    fn id(&self, place: usize) -> u32 {
        self.blocks[place / LANES].ids[place % LANES]
    }

    /// Goes through the blocks in which all stars within `radius_rad` of `centre` stand: the number of the block, the block, and which of its stars.
    pub(super) fn near<'a>(&'a self, centre: &Vector3<f64>, radius_rad: f64, mut with: impl FnMut(usize, &'a Block, Range<usize>)) {
        let mut runs = Vec::with_capacity(32);
        self.runs(centre, radius_rad, |run| runs.push(run));
        let blocks = |run: &Range<usize>| run.start / LANES..run.end.div_ceil(LANES);
        // The processor waits for all of them at once.
        let touch = |block: &Block| block.xyz[0][0] + block.xyz[1][0] + block.xyz[2][0] + block.ids[0] as f32;
        std::hint::black_box(runs.iter().flat_map(|run| &self.blocks[blocks(run)]).map(touch).sum::<f32>());
        for run in runs {
            for number in blocks(&run) {
                let first = number * LANES;
                with(number, &self.blocks[number], run.start.saturating_sub(first)..LANES.min(run.end - first));
            }
        }
    }

    /// Hands over the places, in the order of the zones, among which all stars within `radius_rad` of `centre` stand.
    fn runs(&self, centre: &Vector3<f64>, radius_rad: f64, mut run: impl FnMut(Range<usize>)) {
        let cone = Cone::new(centre, radius_rad);
        let zones = self.bins.len() - 1;
        let zone_of = |dec: f64| (((dec + FRAC_PI_2) / self.height_rad).max(0.0) as usize).min(zones - 1);
        for zone in zone_of(cone.dec - radius_rad)..=zone_of(cone.dec + radius_rad) {
            let ((first, per_rad), (end, _)) = (self.bins[zone], self.bins[zone + 1]);
            let mut bins = |from: usize, to: usize| run(self.starts[first + from] as usize..self.starts[first + to] as usize);
            let count = end - first;
            let half = cone.half_width(zone as f64 * self.height_rad - FRAC_PI_2, self.height_rad);
            // Counted from a whole turn before, so that no number is negative.
            let (low, high) = (((cone.ra - half + TAU) * per_rad) as usize, ((cone.ra + half + TAU) * per_rad) as usize);
            if half >= PI || high - low + 1 >= count {
                bins(0, count);
                continue;
            }
            let (low, high) = (low % count, high % count);
            if low <= high {
                bins(low, high + 1);
            } else {
                bins(low, count);
                bins(0, high + 1);
            }
        }
    }

    /// Appends to `found` the stars within `radius_rad` of `centre`, in no particular but always the same order.
    pub(super) fn within(&self, vectors: &[Vector3<f64>], centre: &Vector3<f64>, radius_rad: f64, found: &mut Vec<u32>) {
        /// What single precision can be off by in the square of a chord, at most.
        const SLACK: f32 = 4e-6;
        let chord2 = chord2_of_angle(radius_rad);
        let (near2, [cx, cy, cz]) = (chord2 as f32, [centre.x as f32, centre.y as f32, centre.z as f32]);
        self.near(centre, radius_rad, |_, Block { xyz: [xs, ys, zs], ids }, lanes| {
            for lane in lanes {
                let (x, y, z) = (xs[lane], ys[lane], zs[lane]);
                let off = (x - cx) * (x - cx) + (y - cy) * (y - cy) + (z - cz) * (z - cz) - near2;
                // On the edge the full precision decides.
                if off < -SLACK || off < SLACK && (vectors[ids[lane] as usize] - centre).norm_squared() <= chord2 {
                    found.push(ids[lane]);
                }
            }
        });
    }
}

/// Which places are within so much of the middle along either axis: ones and zeros.
#[inline(always)]
#[allow(clippy::inline_always, clippy::needless_bitwise_bool, reason = "inlined into loops over many stars, and without branches there")]
pub(super) fn within(x: &[f32; LANES], half_x: f32, y: &[f32; LANES], half_y: f32) -> [u32; LANES] {
    let mut inside = [0; LANES];
    for lane in 0..LANES {
        inside[lane] = u32::from((x[lane].abs() <= half_x) & (y[lane].abs() <= half_y));
    }
    inside
}

/// Those of some lanes that have a one, and how many they are. Without branches: along the edges of a frame nobody can guess them.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into loops over many stars")]
pub(super) fn those(lanes: Range<usize>, ones: &[u32; LANES]) -> ([usize; LANES], usize) {
    let (mut which, mut count) = ([0; LANES], 0);
    for lane in lanes {
        which[count % LANES] = lane % LANES;
        count += ones[lane % LANES] as usize;
    }
    (which, count)
}

/// The first bin of each zone and of one after the last, with the bins per radian.
fn bins(zones: usize, height_rad: f64) -> Vec<(usize, f64)> {
    let mut first = 0;
    let of_zone = |zone: usize| {
        let south = zone as f64 * height_rad - FRAC_PI_2;
        // Where the zone is widest.
        let widest = if south < 0.0 && south + height_rad > 0.0 { 1.0 } else { south.cos().max((south + height_rad).cos()) };
        let count = if zone == zones { 1.0 } else { (TAU * widest / (BIN_OVER_HEIGHT * height_rad)).ceil().max(1.0) };
        let own = (first, count / TAU);
        first += count as usize;
        own
    };
    (0..=zones).map(of_zone).collect()
}

/// A cone on the sky.
struct Cone {
    ra: f64,
    dec: f64,
    radius_rad: f64,
    sin_dec: f64,
    cos_dec: f64,
    cos_radius: f64,
    /// The declination at which it is widest in right ascension, and half its width there.
    widest_dec: f64,
    widest: f64,
}

impl Cone {
    fn new(centre: &Vector3<f64>, radius_rad: f64) -> Self {
        let (ra, dec) = (centre.y.atan2(centre.x).rem_euclid(TAU), centre.z.atan2(centre.x.hypot(centre.y)));
        let ((sin_dec, cos_dec), (sin_radius, cos_radius)) = (dec.sin_cos(), radius_rad.sin_cos());
        // asin(sin r / cos δ), the whole round if a pole is inside.
        let (widest_dec, widest) = if dec.abs() + radius_rad >= FRAC_PI_2 {
            (dec, PI)
        } else {
            ((sin_dec / cos_radius).clamp(-1.0, 1.0).asin(), (sin_radius / cos_dec).min(1.0).asin())
        };
        Self { ra, dec, radius_rad, sin_dec, cos_dec, cos_radius, widest_dec, widest }
    }

    /// Half of what a zone shares with it in right ascension, from the zone's southern border on.
    fn half_width(&self, south: f64, height_rad: f64) -> f64 {
        if self.widest >= PI {
            return PI;
        }
        if (south..=south + height_rad).contains(&self.widest_dec) {
            return self.widest + ROUNDING_RAD;
        }
        // The further from there, the narrower: the nearer border decides.
        let border = if south > self.widest_dec { south } else { south + height_rad };
        if (border - self.dec).abs() >= self.radius_rad {
            return ROUNDING_RAD;
        }
        let (sin, cos) = border.sin_cos();
        ((self.cos_radius - self.sin_dec * sin) / (self.cos_dec * cos)).clamp(-1.0, 1.0).acos() + ROUNDING_RAD
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

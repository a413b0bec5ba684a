//! One scale of the index: catalogue stars for one width of field, sorted by the shape and size of the triangles that they form.
//!
//! The scale for fields of width w holds the stars that are among the [`INDEX_STARS`] brightest in the disc of area w² around them (so that the
//! density of stars on the sky is even, and a camera of that field sees about as many), and the triangles that they form with sides below
//! [`LONGEST`]·w. A triangle is described by its longest side (chord on the unit sphere) and the ratios of the middle and the shortest side to it;
//! both are independent of attitude and of mirroring, and the ratios are nearly independent of the focal length.

use std::time::{Duration, Instant};

use nalgebra::Vector3;

use super::sky::Zones;
use crate::statistics::order::sort_by_key;

/// A star is in a scale's triangles if fewer than this many brighter ones stand in the disc of area w² around it.
const INDEX_STARS: usize = 18;
/// Neighbours that are kept of every star of a scale, the brightest: a candidate has to find them in the image.
const NEIGHBOURS: usize = 14;
/// Places for them: as many as go through the processor together.
pub(super) const LANES: usize = 16;
/// How far away they may be, over the width of the scale.
const NEIGHBOUR_REACH: f64 = 0.55;
/// The directions of a star's neighbours, brightest first: x, y and z. Where there are no more, zeros stand: behind no camera and in
/// front of none. In lines of the cache, that it takes three and not four to read them.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(super) struct Neighbours(pub(super) [[f32; LANES]; 3]);
/// Longest side of a triangle over the width of the scale: from, to.
const LONGEST: [f64; 2] = [0.12, 0.60];
/// Least ratio of the shortest side to the longest.
const MIN_RATIO: f64 = 0.15;
/// Least excess of middle + shortest over longest (ratio): flatter triangles have no clear handedness.
const MIN_EXCESS: f64 = 0.02;
const LOG_STEP: f64 = 0.04;
const LOG_BINS: usize = 41;
const RATIO_STEP: f64 = 0.01;
const MIDDLE_BINS: usize = 51;
const SHORT_BINS: usize = 86;
const QUANTUM: f64 = 65_535.0;

/// A catalogue triangle.
#[derive(Clone, Copy, Debug)]
struct Triangle {
    /// Indices into the scale's stars, in the order opposite the longest, the middle, the shortest side.
    stars: [u32; 3],
    /// ln(longest/width) over its range, middle/longest, shortest/longest, as parts of 65,535.
    features: [u16; 3],
}

/// Shape and size of a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Shape {
    /// Chord of the longest side.
    pub(super) longest: f64,
    /// Middle side over the longest.
    pub(super) middle: f64,
    /// Shortest side over the longest.
    pub(super) shortest: f64,
    /// Which corners (of the three given) stand opposite the longest, the middle, the shortest side.
    pub(super) order: [usize; 3],
}

impl Shape {
    /// From the sides opposite the corners 0, 1, 2; `None` if the triangle is too flat or too thin to be of use.
    pub(super) fn new(sides: [f64; 3]) -> Option<Self> {
        let mut order = [0, 1, 2];
        let swap = |order: &mut [usize; 3], i: usize, j: usize| {
            if sides[order[i]] < sides[order[j]] {
                order.swap(i, j);
            }
        };
        swap(&mut order, 0, 1);
        swap(&mut order, 1, 2);
        swap(&mut order, 0, 1);
        let longest = sides[order[0]];
        let (middle, shortest) = (sides[order[1]] / longest, sides[order[2]] / longest);
        // Written so that NaN (two equal points) is refused too.
        (shortest >= MIN_RATIO && middle + shortest >= 1.0 + MIN_EXCESS).then_some(Self { longest, middle, shortest, order })
    }
}

/// Where triangles like one of the image stand in a scale.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    /// First and last cell of ln(longest), middle and shortest.
    logs: [usize; 2],
    middles: [usize; 2],
    shorts: [usize; 2],
    /// Least value of each feature, and how far it may be above.
    limits: [(u16, u16); 3],
}

/// Memory of a look-up, kept from one to the next: the number of the window, first and end of a row of triangles.
#[derive(Debug, Default)]
pub(super) struct Ranges(Vec<(u32, u32, u32)>);

/// The stars of one width of field and their triangles.
#[derive(Debug)]
pub(super) struct IndexScale {
    /// Width of the fields that this scale is for.
    width_rad: f64,
    /// Directions of the scale's stars, brightest first: few, so that they stay in the processor's cache.
    vectors: Vec<[f32; 3]>,
    /// For each star the directions of its brightest neighbours, brightest first: side by side, so that a candidate costs one
    /// look into memory.
    neighbours: Vec<Neighbours>,
    /// The triangles in the order of their cells: shape and size, and apart from it (few are looked at) the stars.
    features: Vec<[u16; 3]>,
    pub(super) triangles: Vec<[u32; 3]>,
    offsets: Vec<u32>,
    pub(super) build_time: Duration,
}

impl IndexScale {
    /// The scale of fields of this width, of a catalogue's stars, brightest first.
    pub(super) fn build(vectors: &[Vector3<f64>], width_rad: f64) -> Self {
        let start = Instant::now();
        let vectors: Vec<Vector3<f64>> = select(vectors, width_rad).into_iter().map(|star| vectors[star as usize]).collect();
        let zones = Zones::new(&vectors, 0..vectors.len() as u32, reach_rad(LONGEST[1] * width_rad).min(0.5));
        let unsorted = triangles_of(&vectors, &zones, width_rad);
        let neighbours = neighbours_of(&vectors, &zones, width_rad);
        let mut offsets = vec![0_u32; LOG_BINS * MIDDLE_BINS * SHORT_BINS + 1];
        for triangle in &unsorted {
            offsets[triangle.cell() + 1] += 1;
        }
        for cell in 1..offsets.len() {
            offsets[cell] += offsets[cell - 1];
        }
        let mut places = offsets.clone();
        let (mut triangles, mut features) = (vec![[0; 3]; unsorted.len()], vec![[0; 3]; unsorted.len()]);
        for triangle in unsorted {
            let place = &mut places[triangle.cell()];
            (triangles[*place as usize], features[*place as usize]) = (triangle.stars, triangle.features);
            *place += 1;
        }
        let vectors = vectors.iter().map(|v| v.cast::<f32>().into()).collect();
        Self { width_rad, vectors, neighbours, features, triangles, offsets, build_time: start.elapsed() }
    }

    pub(super) fn bytes(&self) -> usize {
        let stars = size_of_val(&*self.vectors) + size_of_val(&*self.neighbours);
        stars + size_of_val(&*self.features) + size_of_val(&*self.triangles) + size_of_val(&*self.offsets)
    }

    /// The stars of a triangle, opposite its longest, middle and shortest side.
    pub(super) fn triangle(&self, number: u32) -> [u32; 3] {
        self.triangles[number as usize]
    }

    /// Brings into the cache what the check of a triangle asks for: of its stars, and of the neighbours of the `central` one.
    pub(super) fn touch(&self, stars: [u32; 3], central: usize) -> f32 {
        let Neighbours([x, y, z]) = &self.neighbours[stars[central] as usize];
        let own = |star: u32| self.vectors[star as usize][0];
        x[0] + y[0] + z[0] + own(stars[0]) + own(stars[1]) + own(stars[2])
    }

    /// The direction of a star, to 0.01″.
    pub(super) fn direction(&self, star: u32) -> Vector3<f64> {
        let [x, y, z] = self.vectors[star as usize];
        Vector3::new(f64::from(x), f64::from(y), f64::from(z))
    }

    /// The same as it is kept.
    pub(super) fn direction_f32(&self, star: u32) -> [f32; 3] {
        self.vectors[star as usize]
    }

    /// The directions of the brightest neighbours of a star.
    pub(super) fn neighbours(&self, star: u32) -> &Neighbours {
        &self.neighbours[star as usize]
    }

    /// The cells in which triangles of this shape stand, ln(longest) within `log_tolerance` and the ratios within `ratio_tolerance`;
    /// `None` if there are no such cells.
    pub(super) fn window(&self, shape: &Shape, log_tolerance: f64, ratio_tolerance: f64) -> Option<Window> {
        let log = (shape.longest / (LONGEST[0] * self.width_rad)).ln();
        let bins = |low: f64, high: f64, step: f64, count: usize| {
            let inside = high >= 0.0 && low < step * count as f64;
            inside.then(|| [(low / step).max(0.0) as usize, ((high / step) as usize).min(count - 1)])
        };
        let (middle, shortest) = (shape.middle - 0.5, shape.shortest - MIN_RATIO);
        let logs = bins(log - log_tolerance, log + log_tolerance, LOG_STEP, LOG_BINS)?;
        let middles = bins(middle - ratio_tolerance, middle + ratio_tolerance, RATIO_STEP, MIDDLE_BINS)?;
        let shorts = bins(shortest - ratio_tolerance, shortest + ratio_tolerance, RATIO_STEP, SHORT_BINS)?;
        let parts = |centre: f64, tolerance: f64| {
            let (low, high) = (to_parts(centre - tolerance), to_parts(centre + tolerance));
            (low, high - low)
        };
        let limits = [
            parts(log / (LOG_STEP * LOG_BINS as f64), log_tolerance / (LOG_STEP * LOG_BINS as f64)),
            parts(shape.middle, ratio_tolerance),
            parts(shape.shortest, ratio_tolerance),
        ];
        Some(Window { logs, middles, shorts, limits })
    }

    /// The triangles inside some of the windows, window by window: number of the window, number of the triangle.
    ///
    /// Each step is done for all windows before the next, so that the processor waits for many places in memory at once: the
    /// index is far larger than its caches.
    pub(super) fn look_up(&self, windows: &[Window], which: std::ops::Range<usize>, scratch: &mut Ranges, found: &mut Vec<(u32, u32)>) {
        let ranges = &mut scratch.0;
        ranges.clear();
        for (number, window) in (which.start as u32..).zip(&windows[which]) {
            let [l0, l1] = window.logs;
            for m in window.middles[0]..=window.middles[1] {
                for s in window.shorts[0]..=window.shorts[1] {
                    let row = (m * SHORT_BINS + s) * LOG_BINS;
                    ranges.push((number, self.offsets[row + l0], self.offsets[row + l1 + 1]));
                }
            }
        }
        ranges.retain(|(_, start, end)| start < end);
        std::hint::black_box(ranges.iter().fold(0, |touched, range| touched ^ self.features[range.1 as usize][0]));
        for &(number, start, end) in &*ranges {
            let [log, middle, shortest] = windows[number as usize].limits;
            let inside = |part: u16, (least, range): (u16, u16)| part.wrapping_sub(least) <= range;
            for (triangle, features) in (start..end).zip(&self.features[start as usize..end as usize]) {
                if inside(features[0], log) & inside(features[1], middle) & inside(features[2], shortest) {
                    found.push((number, triangle));
                }
            }
        }
    }

    /// The angle (chord) of the longest side from which and to which this scale has triangles.
    pub(super) fn longest_range(&self) -> [f64; 2] {
        LONGEST.map(|part| part * self.width_rad)
    }
}

impl Triangle {
    fn cell(&self) -> usize {
        let [l, m, s] = self.features.map(|part| f64::from(part) / QUANTUM);
        let log = ((l * LOG_BINS as f64) as usize).min(LOG_BINS - 1);
        let middle = (((m - 0.5) / RATIO_STEP).max(0.0) as usize).min(MIDDLE_BINS - 1);
        let short = (((s - MIN_RATIO) / RATIO_STEP).max(0.0) as usize).min(SHORT_BINS - 1);
        (middle * SHORT_BINS + short) * LOG_BINS + log
    }
}

fn to_parts(value: f64) -> u16 {
    // To the nearest: a library call rounds where the processor has no instruction for it.
    (value.clamp(0.0, 1.0) * QUANTUM + 0.5) as u16
}

/// The stars of a scale in order of brightness.
fn select(vectors: &[Vector3<f64>], width_rad: f64) -> Vec<u32> {
    let radius_rad = (width_rad / std::f64::consts::PI.sqrt()).min(1.4);
    // The brightest stars crowd along the Milky Way by a factor of two or three; fainter ones than these are never chosen.
    let enough = 10.0 * INDEX_STARS as f64 * 4.0 * std::f64::consts::PI / (width_rad * width_rad);
    let count = vectors.len().min(enough as usize + 100);
    let zones = Zones::new(vectors, 0..count as u32, radius_rad.min(0.5));
    let all: Vec<u32> = (0..count as u32).collect();
    let brighter: Vec<usize> = in_threads(&all, |stars| {
        let mut near = Vec::new();
        let count = |&star: &u32| {
            near.clear();
            zones.within(vectors, &vectors[star as usize], radius_rad, &mut near);
            near.iter().filter(|&&other| other < star).count()
        };
        stars.iter().map(count).collect()
    });
    (0..count as u32).filter(|&star| brighter[star as usize] < INDEX_STARS).collect()
}

/// The angle that belongs to a chord.
fn reach_rad(chord: f64) -> f64 {
    2.0 * (chord / 2.0).min(1.0).asin()
}

/// For each star the brightest of those around it.
fn neighbours_of(vectors: &[Vector3<f64>], zones: &Zones, width_rad: f64) -> Vec<Neighbours> {
    let all: Vec<u32> = (0..vectors.len() as u32).collect();
    in_threads(&all, |stars| {
        let mut near = Vec::new();
        let of = |&star: &u32| {
            near.clear();
            zones.within(vectors, &vectors[star as usize], NEIGHBOUR_REACH * width_rad, &mut near);
            near.retain(|&other| other != star);
            near.sort_unstable();
            let mut all = [[0.0; LANES]; 3];
            for (place, other) in near.iter().take(NEIGHBOURS).enumerate() {
                for axis in 0..3 {
                    all[axis][place] = vectors[*other as usize][axis] as f32;
                }
            }
            Neighbours(all)
        };
        stars.iter().map(of).collect()
    })
}

/// All usable triangles of the stars, each once.
fn triangles_of(vectors: &[Vector3<f64>], zones: &Zones, width_rad: f64) -> Vec<Triangle> {
    let (least, most) = (LONGEST[0] * width_rad, LONGEST[1] * width_rad);
    let reach_rad = reach_rad(most);
    let all: Vec<u32> = (0..vectors.len() as u32).collect();
    in_threads(&all, |firsts| {
        let (mut near, mut triangles) = (Vec::new(), Vec::new());
        for &first in firsts {
            near.clear();
            zones.within(vectors, &vectors[first as usize], reach_rad, &mut near);
            near.retain(|&other| other > first);
            near.sort_unstable();
            let a = vectors[first as usize];
            for (position, &second) in near.iter().enumerate() {
                let b = vectors[second as usize];
                let ab = (a - b).norm();
                for &third in &near[position + 1..] {
                    let c = vectors[third as usize];
                    let (bc, ca) = ((b - c).norm(), (c - a).norm());
                    let Some(shape) = Shape::new([bc, ca, ab]) else { continue };
                    if shape.longest >= least && shape.longest <= most {
                        let corners = [first, second, third];
                        let log = (shape.longest / least).ln() / (LOG_STEP * LOG_BINS as f64);
                        triangles.push(Triangle {
                            stars: shape.order.map(|corner| corners[corner]),
                            features: [to_parts(log), to_parts(shape.middle), to_parts(shape.shortest)],
                        });
                    }
                }
            }
        }
        triangles
    })
}

/// Gives chunks of `items` to `work` on several threads; the results stand in the order of the items.
///
/// Threads of its own, not rayon's: a scale is built inside a lock that only one thread may hold, and a rayon worker that
/// waits here would steal another frame's identification, which waits for the same lock.
fn in_threads<T: Send>(items: &[u32], work: impl Fn(&[u32]) -> Vec<T> + Sync) -> Vec<T> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(16);
    let chunk = items.len().div_ceil(threads * 4).max(64);
    let chunks: Vec<&[u32]> = items.chunks(chunk).collect();
    let next = std::sync::atomic::AtomicUsize::new(0);
    let mut done: Vec<(usize, Vec<T>)> = std::thread::scope(|scope| {
        let run = || {
            let mut mine = Vec::new();
            loop {
                let number = next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                let Some(part) = chunks.get(number) else { return mine };
                mine.push((number, work(part)));
            }
        };
        let others: Vec<_> = (1..threads).map(|_| scope.spawn(run)).collect();
        let mut all = run();
        for other in others {
            match other.join() {
                Ok(part) => all.extend(part),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        all
    });
    sort_by_key(&mut done, |(number, _)| *number);
    done.into_iter().flat_map(|(_, part)| part).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::DEG_RAD;

    /// 2000 directions all over the sky, in no order.
    fn scattered() -> Vec<Vector3<f64>> {
        let at = |i: u32| {
            let z = 1.0 - 2.0 * (f64::from(i) * 0.618_033_988_7).fract();
            let ra = std::f64::consts::TAU * (f64::from(i) * 0.754_877_666_2).fract();
            Vector3::new((1.0 - z * z).sqrt() * ra.cos(), (1.0 - z * z).sqrt() * ra.sin(), z)
        };
        (0..2000).map(at).collect()
    }

    #[test]
    fn the_neighbours_of_a_star_are_the_brightest_within_their_reach() {
        let level = IndexScale::build(&scattered(), 20.0 * DEG_RAD);
        let reach2 = crate::identify::sky::chord2_of_angle(NEIGHBOUR_REACH * 20.0 * DEG_RAD);
        let mut full = 0;
        for (star, own) in level.vectors.iter().enumerate() {
            let distance2 = |v: &[f32; 3]| v.iter().zip(own).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
            let near = level.vectors.iter().enumerate().filter(|(other, v)| *other != star && distance2(v) <= reach2);
            let expected: Vec<[f32; 3]> = near.map(|(_, v)| *v).take(NEIGHBOURS).collect();
            let Neighbours([x, y, z]) = level.neighbours(star as u32);
            let found: Vec<[f32; 3]> = (0..LANES).map(|i| [x[i], y[i], z[i]]).take_while(|v| *v != [0.0; 3]).collect();
            assert_eq!(found, expected, "star {star}");
            full += usize::from(found.len() == NEIGHBOURS);
        }
        assert!(full > 100 && full < level.vectors.len(), "{full} of {}", level.vectors.len());
    }

    #[test]
    fn a_level_holds_the_stars_that_few_brighter_ones_surround() {
        let (all, width_rad) = (scattered(), 25.0 * DEG_RAD);
        let level = IndexScale::build(&all, width_rad);
        let reach2 = crate::identify::sky::chord2_of_angle(width_rad / std::f64::consts::PI.sqrt());
        let brighter = |star: usize| all[..star].iter().filter(|v| (*v - all[star]).norm_squared() <= reach2).count();
        let expected: Vec<[f32; 3]> =
            (0..all.len()).filter(|&star| brighter(star) < INDEX_STARS).map(|star| all[star].cast::<f32>().into()).collect();
        assert!(expected.len() < all.len());
        assert_eq!(level.vectors, expected);
    }
}

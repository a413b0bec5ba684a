//! The index of triangles: catalogue stars sorted by the shape and size of the triangles that they form, one level for each
//! width of field.
//!
//! A level for fields of width w holds the stars that are among the [`INDEX_STARS`] brightest in the disc of area w² around
//! them (so that the density of stars on the sky is even, and a camera of that field sees about as many), and the triangles
//! that they form with sides below [`LONGEST`]·w. A triangle is described by its longest side (chord on the unit sphere) and
//! the ratios of the middle and the shortest side to it; both are independent of attitude and of mirroring, and the ratios are
//! nearly independent of the focal length.

use std::sync::OnceLock;
use std::time::{Duration, Instant};

use nalgebra::Vector3;

use super::sky::Zones;
use crate::catalog::Catalog;
use crate::units::DEG_RAD;

/// A star is in a level's triangles if fewer than this many brighter ones stand in the disc of area w² around it.
const INDEX_STARS: usize = 18;
/// Neighbours that are kept of every star of a level, the brightest: a candidate has to find them in the image.
const NEIGHBOURS: usize = 14;
/// How far away they may be, over the width of the level.
const NEIGHBOUR_REACH: f64 = 0.55;
/// Stands where a star has fewer neighbours.
const NOBODY: [f32; 3] = [0.0; 3];
/// Longest side of a triangle over the width of the level: from, to.
const LONGEST: [f64; 2] = [0.12, 0.60];
/// Least ratio of the shortest side to the longest.
const LEAST_RATIO: f64 = 0.15;
/// Least excess of middle + shortest over longest (ratio): flatter triangles have no clear handedness.
const LEAST_EXCESS: f64 = 0.02;
/// Width of the levels: the first, and the factor from one to the next.
const FIRST_WIDTH_RAD: f64 = 3.0 * DEG_RAD;
const LEVELS: usize = 12;

const LOG_STEP: f64 = 0.04;
const LOG_BINS: usize = 41;
const RATIO_STEP: f64 = 0.01;
const MIDDLE_BINS: usize = 51;
const SHORT_BINS: usize = 86;
const QUANTUM: f64 = 65_535.0;

/// A catalogue triangle.
#[derive(Clone, Copy, Debug)]
struct Triangle {
    /// Indices into the level's stars, in the order opposite the longest, the middle, the shortest side.
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
        (shortest >= LEAST_RATIO && middle + shortest >= 1.0 + LEAST_EXCESS).then_some(Self { longest, middle, shortest, order })
    }
}

/// The stars of one width of field and their triangles.
#[derive(Debug)]
pub(super) struct Level {
    /// Width of the fields that this level is for.
    width_rad: f64,
    /// Directions of the level's stars, brightest first: few, so that they stay in the processor's cache.
    pub(super) vectors: Vec<Vector3<f64>>,
    /// For each star the directions of its brightest neighbours, brightest first: side by side, so that a candidate costs one
    /// look into memory.
    neighbours: Vec<[[f32; 3]; NEIGHBOURS]>,
    /// The triangles in the order of their cells: shape and size, and apart from it (few are looked at) the stars.
    features: Vec<[u16; 3]>,
    triangles: Vec<[u32; 3]>,
    offsets: Vec<u32>,
    build_time: Duration,
}

/// What an index holds, for people.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct IndexSize {
    /// Levels built so far.
    pub levels: usize,
    /// Their triangles.
    pub triangles: usize,
    /// Their bytes.
    pub bytes: usize,
    /// The time that it took to build them, summed.
    pub build_time: Duration,
}

/// Triangles of catalogue stars for lost-in-space identification. Cheap to make: each level is built when first needed.
#[derive(Debug)]
pub struct Index {
    pub(super) vectors: Vec<Vector3<f64>>,
    /// All stars, the brightest quarter, the brightest sixteenth … for cone searches that want only the brightest.
    prefixes: OnceLock<Vec<(usize, Zones)>>,
    levels: [OnceLock<Level>; LEVELS],
}

impl Index {
    /// An index of a catalogue (brightest star first).
    #[must_use]
    pub fn new(catalog: &Catalog) -> Self {
        let vectors = catalog.stars.iter().map(|star| Vector3::from(star.direction.xyz)).collect();
        Self { vectors, prefixes: OnceLock::new(), levels: [const { OnceLock::new() }; LEVELS] }
    }

    /// Builds every level now (otherwise each is built when first needed) and says how large they are.
    pub fn build(&self) -> IndexSize {
        for number in 0..LEVELS {
            self.level(number);
        }
        self.size()
    }

    /// Size and build time of the levels built so far.
    #[must_use]
    pub fn size(&self) -> IndexSize {
        self.levels.iter().filter_map(OnceLock::get).fold(IndexSize::default(), |sum, level| IndexSize {
            levels: sum.levels + 1,
            triangles: sum.triangles + level.triangles.len(),
            bytes: sum.bytes + level.bytes(),
            build_time: sum.build_time + level.build_time,
        })
    }

    /// The number of stars in the catalogue that this index was made from.
    #[must_use]
    pub fn star_count(&self) -> usize {
        self.vectors.len()
    }

    /// The level whose width is nearest to `width_rad`, `coarser` steps up (for fields that show few stars) or down.
    pub(super) fn level_for(&self, width_rad: f64, coarser: i32) -> &Level {
        let number = (2.0 * (width_rad / FIRST_WIDTH_RAD).log2()).round() + f64::from(coarser);
        self.level(number.clamp(0.0, (LEVELS - 1) as f64) as usize)
    }

    fn level(&self, number: usize) -> &Level {
        self.levels[number].get_or_init(|| Level::build(&self.vectors, FIRST_WIDTH_RAD * 2_f64.powf(number as f64 / 2.0)))
    }

    /// About the `wanted` brightest stars within `radius_rad` of `centre`: all stars of the cone down to some magnitude, at
    /// least so many as are wanted if the catalogue has them; brightest first.
    pub(super) fn brightest_within(&self, centre: &Vector3<f64>, radius_rad: f64, wanted: usize) -> Vec<u32> {
        let prefixes = self.prefixes.get_or_init(|| {
            let mut all = Vec::new();
            let mut count = self.vectors.len();
            loop {
                all.push((count, Zones::new(&self.vectors, 0..count as u32, 4.0 * DEG_RAD)));
                if count < 1000 {
                    return all;
                }
                count /= 4;
            }
        });
        let share = (1.0 - radius_rad.min(std::f64::consts::PI).cos()) / 2.0;
        let mut found = Vec::new();
        for (count, zones) in prefixes.iter().rev() {
            if *count == self.vectors.len() || *count as f64 * share > 1.5 * wanted as f64 {
                found.clear();
                zones.within(&self.vectors, centre, radius_rad, &mut found);
                if found.len() >= wanted {
                    break;
                }
            }
        }
        found.sort_unstable();
        found
    }
}

impl Level {
    fn build(vectors: &[Vector3<f64>], width_rad: f64) -> Self {
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
        Self { width_rad, vectors, neighbours, features, triangles, offsets, build_time: start.elapsed() }
    }

    fn bytes(&self) -> usize {
        let stars = size_of_val(&*self.vectors) + size_of_val(&*self.neighbours);
        stars + size_of_val(&*self.features) + size_of_val(&*self.triangles) + size_of_val(&*self.offsets)
    }

    /// The directions of the brightest neighbours of a star, brightest first.
    pub(super) fn neighbours(&self, star: u32) -> impl Iterator<Item = Vector3<f64>> {
        let all = &self.neighbours[star as usize];
        all.iter().take_while(|v| **v != NOBODY).map(|v| Vector3::from(v.map(f64::from)))
    }

    /// Calls `found` with the stars (opposite the longest, the middle, the shortest side) of every triangle whose ln(longest) is within `log_tolerance` and whose ratios are within
    /// `ratio_tolerance` of the given shape; stops when it returns `false`.
    pub(super) fn look_up(&self, shape: &Shape, log_tolerance: f64, ratio_tolerance: f64, mut found: impl FnMut([u32; 3]) -> bool) -> bool {
        let log = (shape.longest / (LONGEST[0] * self.width_rad)).ln();
        let bins = |low: f64, high: f64, step: f64, count: usize| {
            (high >= 0.0 && low < step * count as f64).then(|| ((low / step).max(0.0) as usize, ((high / step) as usize).min(count - 1)))
        };
        let (middle, shortest) = (shape.middle - 0.5, shape.shortest - LEAST_RATIO);
        let (Some((l0, l1)), Some((m0, m1)), Some((s0, s1))) = (
            bins(log - log_tolerance, log + log_tolerance, LOG_STEP, LOG_BINS),
            bins(middle - ratio_tolerance, middle + ratio_tolerance, RATIO_STEP, MIDDLE_BINS),
            bins(shortest - ratio_tolerance, shortest + ratio_tolerance, RATIO_STEP, SHORT_BINS),
        ) else {
            return true;
        };
        let window = |centre: f64, tolerance: f64| (to_parts(centre - tolerance), to_parts(centre + tolerance));
        let log_window = window(log / (LOG_STEP * LOG_BINS as f64), log_tolerance / (LOG_STEP * LOG_BINS as f64));
        let middle_window = window(shape.middle, ratio_tolerance);
        let short_window = window(shape.shortest, ratio_tolerance);
        for m in m0..=m1 {
            for s in s0..=s1 {
                let row = (m * SHORT_BINS + s) * LOG_BINS;
                let (start, end) = (self.offsets[row + l0] as usize, self.offsets[row + l1 + 1] as usize);
                for (number, &[l, m, s]) in (start..end).zip(&self.features[start..end]) {
                    let inside = |value: u16, (low, high): (u16, u16)| value.wrapping_sub(low) <= high - low;
                    let inside = inside(l, log_window) & inside(m, middle_window) & inside(s, short_window);
                    if inside && !found(self.triangles[number]) {
                        return false;
                    }
                }
            }
        }
        true
    }

    /// The angle (chord) of the longest side from which and to which this level has triangles.
    pub(super) fn longest_range(&self) -> [f64; 2] {
        LONGEST.map(|part| part * self.width_rad)
    }
}

impl Triangle {
    fn cell(&self) -> usize {
        let [l, m, s] = self.features.map(|part| f64::from(part) / QUANTUM);
        let log = ((l * LOG_BINS as f64) as usize).min(LOG_BINS - 1);
        let middle = (((m - 0.5) / RATIO_STEP).max(0.0) as usize).min(MIDDLE_BINS - 1);
        let short = (((s - LEAST_RATIO) / RATIO_STEP).max(0.0) as usize).min(SHORT_BINS - 1);
        (middle * SHORT_BINS + short) * LOG_BINS + log
    }
}

fn to_parts(value: f64) -> u16 {
    (value.clamp(0.0, 1.0) * QUANTUM).round() as u16
}

/// The stars of a level in order of brightness.
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
fn neighbours_of(vectors: &[Vector3<f64>], zones: &Zones, width_rad: f64) -> Vec<[[f32; 3]; NEIGHBOURS]> {
    let all: Vec<u32> = (0..vectors.len() as u32).collect();
    in_threads(&all, |stars| {
        let mut near = Vec::new();
        let of = |&star: &u32| {
            near.clear();
            zones.within(vectors, &vectors[star as usize], NEIGHBOUR_REACH * width_rad, &mut near);
            near.retain(|&other| other != star);
            near.sort_unstable();
            let mut all = [NOBODY; NEIGHBOURS];
            for (place, other) in all.iter_mut().zip(&near) {
                *place = vectors[*other as usize].cast::<f32>().into();
            }
            all
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
/// Threads of its own, not rayon's: a level is built inside a lock that only one thread may hold, and a rayon worker that
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
    done.sort_by_key(|(number, _)| *number);
    done.into_iter().flat_map(|(_, part)| part).collect()
}

//! Index of triangles of catalogue stars: one [`IndexScale`] for each width of field, built when first needed.

use std::sync::OnceLock;
use std::time::Duration;

use nalgebra::Vector3;

use super::association::MagnitudeBin;
use super::frame_plane::FramePlane;
use super::index_scale::IndexScale;
use super::pose::{Points, Pose};
use super::projection::Projection;
use super::sky::{Block, LANES, Zones, those, within};
use crate::catalog::Catalog;
use crate::units::DEG_RAD;

/// Width of the scales: the first, and the factor from one to the next.
const FIRST_WIDTH_RAD: f64 = 3.0 * DEG_RAD;
const LEVELS: usize = 12;
/// Stars are looked for so much further than a frame reaches, since its pose is not known better at first.
const MARGIN: f64 = 1.15;
/// The part of the circle around a square frame that the frame covers.
const OF_CIRCLE: f64 = std::f64::consts::FRAC_2_PI;

/// What an index holds, for people.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
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

/// Triangles of catalogue stars for lost-in-space identification. Cheap to make: each scale is built when first needed.
#[derive(Debug)]
pub struct Index {
    pub(super) vectors: Vec<Vector3<f64>>,
    pub(super) magnitudes: Vec<f64>,
    /// All stars, the brightest quarter, the brightest sixteenth … for cone searches that want only the brightest.
    prefixes: OnceLock<Vec<(usize, Zones)>>,
    zone_magnitudes: OnceLock<Vec<[MagnitudeBin; LANES]>>,
    levels: [OnceLock<IndexScale>; LEVELS],
}

impl Index {
    /// An index of a catalogue (brightest star first).
    #[must_use]
    pub fn new(catalog: &Catalog) -> Self {
        let vectors = catalog.stars.iter().map(|star| Vector3::from(star.direction.xyz)).collect();
        let magnitudes = catalog.stars.iter().map(|star| star.magnitude).collect();
        Self {
            vectors,
            magnitudes,
            prefixes: OnceLock::new(),
            zone_magnitudes: OnceLock::new(),
            levels: [const { OnceLock::new() }; LEVELS],
        }
    }

    /// Builds everything now (otherwise each part is built when first needed) and says how large the scales are.
    pub fn build(&self) -> IndexSize {
        self.whole_sky();
        for number in 0..LEVELS {
            self.level(number);
        }
        self.size()
    }

    /// Size and build time of the scales built so far.
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

    /// The scale whose width is nearest to `width_rad`, `coarser` steps up (for fields that show few stars) or down.
    pub(super) fn level_for(&self, width_rad: f64, coarser: i32) -> &IndexScale {
        let number = (2.0 * (width_rad / FIRST_WIDTH_RAD).log2()).round() + f64::from(coarser);
        self.level(number.clamp(0.0, (LEVELS - 1) as f64) as usize)
    }

    fn prefixes(&self) -> &[(usize, Zones)] {
        self.prefixes.get_or_init(|| {
            let mut count = self.vectors.len();
            let mut all = vec![(count, Zones::new(&self.vectors, 0..count as u32, 4.0 * DEG_RAD))];
            while count >= 1000 {
                count /= 4;
                let fewer = all[all.len() - 1].1.first(&self.vectors, count);
                all.push((count, fewer));
            }
            all
        })
    }

    /// All stars, and their magnitudes by the zones' blocks.
    pub(super) fn whole_sky(&self) -> (&Zones, &[[MagnitudeBin; LANES]]) {
        let zones = &self.prefixes()[0].1;
        let magnitudes = || {
            let all: Vec<_> = zones.ids().map(|id| MagnitudeBin::of(self.magnitudes[id as usize] as f32)).collect();
            let of_block = |block: &[MagnitudeBin]| std::array::from_fn(|lane| block.get(lane).copied().unwrap_or_default());
            all.chunks(LANES).map(of_block).collect()
        };
        (zones, self.zone_magnitudes.get_or_init(magnitudes))
    }

    fn level(&self, number: usize) -> &IndexScale {
        self.levels[number].get_or_init(|| IndexScale::build(&self.vectors, FIRST_WIDTH_RAD * 2_f64.powf(number as f64 / 2.0)))
    }

    /// About the `wanted` brightest stars within `radius_rad` of `centre`: all stars of the cone down to some magnitude, at
    /// least so many as are wanted if the catalogue has them; brightest first.
    pub(super) fn brightest_within(&self, centre: &Vector3<f64>, radius_rad: f64, wanted: usize) -> Vec<u32> {
        let share = (1.0 - radius_rad.min(std::f64::consts::PI).cos()) / 2.0;
        let mut found = Vec::new();
        for (count, zones) in self.prefixes().iter().rev() {
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

    /// The same for a frame: those that may be in it, wherever its pose is refined to. So many are `wanted` in the whole circle around it.
    pub(super) fn brightest_near(&self, pose: &Pose, points: &Points, wanted: usize) -> Vec<u32> {
        let boresight = Vector3::from(pose.rotation.row(2).transpose());
        let radius_rad = pose.reach_rad(points, MARGIN);
        if pose.projection != Projection::Pinhole {
            return self.brightest_within(&boresight, radius_rad, wanted);
        }
        let wanted_in_frame = (OF_CIRCLE * wanted as f64) as usize;
        let plane = FramePlane::new(pose, points);
        let half_px = points.half_px.map(|half| (half * MARGIN * (1.0 - pose.kappa.min(0.0))) as f32);
        let share = (1.0 - radius_rad.min(std::f64::consts::PI).cos()) / 2.0;
        let mut found = Vec::new();
        for (count, zones) in self.prefixes().iter().rev() {
            if *count == self.vectors.len() || *count as f64 * share > 1.5 * wanted as f64 {
                in_frame(zones, &plane, (&boresight, radius_rad), half_px, &mut found);
                if found.len() >= wanted_in_frame {
                    break;
                }
            }
        }
        found.sort_unstable();
        found
    }

    /// The brightest stars of a tangent plane's frame as this very pose has it, without distortion: at least so many as are `wanted` if the
    /// catalogue has them, brightest first.
    pub(super) fn brightest_in_frame(&self, pose: &Pose, points: &Points, wanted: usize) -> Vec<u32> {
        let boresight = Vector3::from(pose.rotation.row(2).transpose());
        let radius_rad = pose.reach_rad(points, 1.0);
        let plane = FramePlane::new(pose, points);
        let share = 2.0 * points.half_px[0] * points.half_px[1] / (std::f64::consts::TAU * pose.focal_px * pose.focal_px);
        let mut found = Vec::with_capacity(4 * wanted);
        for (count, zones) in self.prefixes().iter().rev() {
            if *count == self.vectors.len() || *count as f64 * share > wanted as f64 {
                in_frame(zones, &plane, (&boresight, radius_rad), points.half_px.map(|half| half as f32), &mut found);
                if found.len() >= wanted {
                    break;
                }
            }
        }
        found.sort_unstable();
        found
    }
}

/// The stars of a cone that stand within so much of the middle of a frame.
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn in_frame(
    zones: &Zones,
    plane: &FramePlane,
    (boresight, radius_rad): (&Vector3<f64>, f64),
    [half_x, half_y]: [f32; 2],
    found: &mut Vec<u32>,
) {
    found.clear();
    zones.near(boresight, radius_rad, |_, Block { xyz, ids }, lanes| {
        let [x, y] = plane.ideal(xyz);
        let (inside, count) = those(lanes, &within(&x, half_x, &y, half_y));
        found.extend(inside[..count].iter().map(|lane| ids[*lane]));
    });
}

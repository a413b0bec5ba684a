//! The sky laid over a frame: which detections and catalogue stars belong together.

use nalgebra::Vector3;

use super::Match;
use super::association::{self, MagnitudeCounts, sure_pairs};
use super::frame_plane::FramePlane;
use super::index::Index;
use super::pose::{Points, Pose};
use super::projection::Projection;
use super::sky::LANES;
use crate::catalog::Catalog;
use crate::detect::Detections;
use crate::statistics::{mad_sigma, median};

/// A star is not a clean control point if another of similar brightness stands this near, px.
const CROWDED_PX: f64 = 3.0;
/// What similar means, magnitudes.
const CROWDED_MAG: f64 = 2.0;
/// The catalogue is looked through so much further than the frame reaches.
const MARGIN: f64 = 1.2;
/// By so much of the frame's size places may move before stars near detections are looked for anew.
const SLACK: f64 = 0.006;

/// Column in the un-mirrored image.
pub(super) fn unmirrored_x(parity: i8, width_px: usize, x_px: f64) -> f64 {
    if parity < 0 { width_px as f64 - 1.0 - x_px } else { x_px }
}

/// A frame and the sky that may be in it.
pub(super) struct LaidSky<'a> {
    pub(super) detections: &'a Detections,
    pub(super) catalog: &'a Catalog,
    pub(super) index: &'a Index,
    /// Directions of the catalogue stars as they appear in this frame.
    pub(super) apparent: &'a [Vector3<f64>],
    pub(super) points: &'a Points,
    pub(super) parity: i8,
    /// −2.5·log10 of each detection's flux.
    pub(super) detection_mag: Vec<Option<f64>>,
    /// Pairs are at most so far apart.
    pub(super) reach_px: f64,
}

/// Stars near detections, and all of the frame by their brightness.
pub(super) struct NearDetections {
    /// Index into the catalogue, and where the star was when they were looked for, relative to the middle, px.
    close: Vec<(usize, [f64; 2])>,
    in_frame: MagnitudeCounts,
}

/// Cells of a frame from which a detection can be reached: a bit for each.
struct Cells {
    rows: [u64; Self::SIDE],
    half_px: [f64; 2],
    per_px: [f64; 2],
}

impl Cells {
    const SIDE: usize = 64;

    fn new(half_px: [f64; 2]) -> Self {
        Self { rows: [0; Self::SIDE], half_px, per_px: half_px.map(|half| Self::SIDE as f64 / (2.0 * half)) }
    }

    /// The cell of a place along an axis; what lies beyond the frame belongs to its border.
    fn cell(&self, axis: usize, at: f64) -> usize {
        (((at + self.half_px[axis]) * self.per_px[axis]).max(0.0) as usize).min(Self::SIDE - 1)
    }

    fn mark(&mut self, [x, y]: [f64; 2], reach_px: f64) {
        let (first, last) = (self.cell(0, x - reach_px), self.cell(0, x + reach_px));
        let columns = (u64::MAX >> (Self::SIDE - 1 - (last - first))) << first;
        let rows = self.cell(1, y - reach_px)..=self.cell(1, y + reach_px);
        self.rows[rows].iter_mut().for_each(|row| *row |= columns);
    }

    fn holds(&self, [x, y]: [f64; 2]) -> bool {
        self.rows[self.cell(1, y)] >> self.cell(0, x) & 1 == 1
    }
}

impl<'a> LaidSky<'a> {
    pub(super) fn new(
        detections: &'a Detections,
        points: &'a Points,
        catalog: &'a Catalog,
        index: &'a Index,
        apparent: &'a [Vector3<f64>],
        (parity, reach_px): (i8, f64),
    ) -> Self {
        let bright = |flux: f64| (flux > 0.0 && flux.is_finite()).then(|| -2.5 * flux.log10());
        let detection_mag = detections.stars.iter().map(|detection| bright(detection.flux_dn)).collect();
        Self { detections, catalog, index, apparent, points, parity, detection_mag, reach_px }
    }

    /// Where a detection is in the un-mirrored frame, relative to its middle, px.
    fn place(&self, detection: usize) -> [f64; 2] {
        let star = &self.detections.stars[detection];
        let x = unmirrored_x(self.parity, self.detections.width_px, star.x_px);
        [x - (self.detections.width_px as f64 - 1.0) / 2.0, star.y_px - (self.detections.height_px as f64 - 1.0) / 2.0]
    }

    /// The stars that this pose, or one near it, lays near detections.
    pub(super) fn near_detections(&self, pose: &Pose) -> NearDetections {
        let slack_px = SLACK * self.points.size_px;
        let mut cells = Cells::new(self.points.half_px);
        for detection in 0..self.detections.stars.len() {
            let at = self.place(detection);
            if at.iter().all(|c| c.is_finite()) {
                cells.mark(at, self.reach_px + CROWDED_PX + slack_px);
            }
        }
        let margin_px = self.reach_px.max(CROWDED_PX);
        let [half_x, half_y] = self.points.half_px.map(|half| half + margin_px);
        let boresight = Vector3::from(pose.rotation.row(2).transpose());
        let radius_rad = pose.reach_rad(self.points, MARGIN);
        let (mut close, mut in_frame) = (Vec::new(), MagnitudeCounts::new());
        // Single precision and the catalogue's own directions are enough to see what is far from all detections; not for directions that an
        // effect of the sky may have moved by more than the slack.
        if pose.projection == Projection::Pinhole && std::ptr::eq(self.apparent, self.index.vectors.as_slice()) {
            let (zones, magnitudes) = self.index.whole_sky();
            let plane = FramePlane::new(pose, self.points);
            let (half_x, half_y) = (half_x as f32, half_y as f32);
            zones.runs(&boresight, radius_rad, |run| {
                for place in run.clone().step_by(LANES) {
                    let [xs, ys] = plane.places(zones.lanes(place));
                    let stars = place..run.end.min(place + LANES);
                    for ((x, y), star) in xs.iter().zip(&ys).zip(stars) {
                        if x.abs() <= half_x && y.abs() <= half_y {
                            in_frame.add(magnitudes[star]);
                            let at = [f64::from(*x), f64::from(*y)];
                            if cells.holds(at) {
                                close.push((zones.ids()[star] as usize, at));
                            }
                        }
                    }
                }
            });
        } else {
            for star in self.index.brightest_within(&boresight, radius_rad, usize::MAX) {
                let star = star as usize;
                let Some(at) = pose.project(&self.apparent[star], self.points.corner_px) else { continue };
                if at[0].abs() <= half_x && at[1].abs() <= half_y {
                    in_frame.add(self.catalog.stars[star].magnitude as f32);
                    if cells.holds(at) {
                        close.push((star, at));
                    }
                }
            }
        }
        NearDetections { close, in_frame }
    }

    /// The detections and catalogue stars that belong together: surely, uncrowded, of plausible brightness. `near` is found anew if the pose
    /// moves the stars too far from where they were.
    pub(super) fn matches(&self, pose: &Pose, near: &mut NearDetections, radius_px: f64) -> Vec<Match> {
        let project = |star: usize| pose.project(&self.apparent[star], self.points.corner_px);
        let slack2_px2 = (SLACK * self.points.size_px).powi(2);
        // A star without a place has moved far too.
        let stays =
            |&(star, [x, y]): &(usize, [f64; 2])| project(star).is_some_and(|at| (at[0] - x).powi(2) + (at[1] - y).powi(2) <= slack2_px2);
        if !near.close.iter().all(stays) {
            *near = self.near_detections(pose);
        }
        // (y, x, star), sorted by y so that neighbours are found in a narrow band.
        let mut stars: Vec<(f64, f64, usize)> =
            near.close.iter().filter_map(|&(star, _)| project(star).map(|[x, y]| (y, x, star))).collect();
        stars.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.2.cmp(&b.2)));
        let band = |y: f64, reach: f64| {
            let start = stars.partition_point(|s| s.0 < y - reach);
            stars.iter().enumerate().skip(start).take_while(move |(_, s)| s.0 <= y + reach)
        };
        let mut pairs = Vec::new();
        for detection in 0..self.detections.stars.len() {
            let [x, y] = self.place(detection);
            if !(x.is_finite() && y.is_finite()) {
                continue;
            }
            for (star, &(star_y, star_x, _)) in band(y, radius_px) {
                let distance2_px2 = (x - star_x).powi(2) + (y - star_y).powi(2);
                if distance2_px2 <= radius_px * radius_px {
                    pairs.push(association::Pair { detection, star, distance2_px2 });
                }
            }
        }
        let star_mag: Vec<f64> = stars.iter().map(|&(_, _, star)| self.catalog.stars[star].magnitude).collect();
        let area_px2 = (self.detections.width_px * self.detections.height_px) as f64;
        let field = association::Field { area_px2, radius_px };
        let of = |pair: association::Pair| {
            let ((star_y, star_x, star), [x, y]) = (stars[pair.star], self.place(pair.detection));
            Match { detection: pair.detection, star, residual_px: [x - star_x, y - star_y] }
        };
        let sure = sure_pairs(pairs, &self.detection_mag, &star_mag, &near.in_frame, field);
        let mut matches: Vec<Match> = sure.into_iter().map(of).collect();
        let crowded = |m: &Match| {
            let [x, y] = self.place(m.detection);
            let (x, y) = (x - m.residual_px[0], y - m.residual_px[1]);
            band(y, CROWDED_PX).any(|(_, &(other_y, other_x, other))| {
                other != m.star
                    && (other_x - x).powi(2) + (other_y - y).powi(2) < CROWDED_PX * CROWDED_PX
                    && self.catalog.stars[other].magnitude < self.catalog.stars[m.star].magnitude + CROWDED_MAG
            })
        };
        matches.retain(|m| !crowded(m));
        self.drop_implausible_brightness(&mut matches);
        let flux = |m: &Match| self.detections.stars[m.detection].flux_dn;
        matches.sort_by(|a, b| flux(b).total_cmp(&flux(a)).then(a.detection.cmp(&b.detection)));
        matches
    }

    /// Drops matches that are far brighter or fainter than the others say: a hot pixel on a faint star, a star missed beside a planet.
    fn drop_implausible_brightness(&self, matches: &mut Vec<Match>) {
        let zero_point = |m: &Match| self.detection_mag[m.detection].map(|magnitude| self.catalog.stars[m.star].magnitude - magnitude);
        let known: Vec<f64> = matches.iter().filter_map(zero_point).collect();
        let Some((middle, sigma)) = median(&known).zip(mad_sigma(&known)).filter(|_| known.len() >= 8) else { return };
        // Colours and saturation move bright stars by a magnitude or two in any camera.
        let limit = (5.0 * sigma).max(2.5);
        matches.retain(|m| zero_point(m).is_none_or(|value| (value - middle).abs() <= limit));
    }
}

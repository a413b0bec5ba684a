//! The sky laid over a frame: which detections and catalogue stars belong together.

use nalgebra::Vector3;

use super::Match;
use super::association::{self, MagnitudeBin, MagnitudeCounts};
use super::frame_plane::FramePlane;
use super::index::Index;
use super::pose::{Points, Pose};
use super::projection::Projection;
use super::sky::{Block, those, within};
use crate::detect::{Detection, Detections};
use crate::statistics::median_and_mad_sigma;

/// A star is not a clean control point if another of similar brightness stands this near, px.
const CROWDED_PX: f64 = 3.0;
/// What similar means, magnitudes.
const CROWDED_MAG: f64 = 2.0;
/// The catalogue is looked through so much further than the frame reaches.
const MARGIN: f64 = 1.2;
/// The same where the frame is a tangent plane and the pose is asked as it is: what the distortion adds beyond the corner.
const CLOSE_MARGIN: f64 = 1.03;
/// Room is made at first for so many stars near detections, beyond one for each.
const ROOM: usize = 40;
/// By so much of the frame's size places may move before stars near detections are looked for anew.
const SLACK: f64 = 0.006;

/// Column in the un-mirrored image.
pub(super) fn unmirrored_x(parity: i8, width_px: usize, x_px: f64) -> f64 {
    if parity < 0 { width_px as f64 - 1.0 - x_px } else { x_px }
}

/// A frame and the sky that may be in it.
pub(super) struct LaidSky<'a> {
    detections: &'a Detections,
    index: &'a Index,
    /// Directions of the catalogue stars as they appear in this frame.
    apparent: &'a [Vector3<f64>],
    points: &'a Points,
    /// −2.5·log10 of each detection's flux.
    detection_mag: Vec<Option<f64>>,
    /// Where each detection is in the un-mirrored frame, relative to its middle, px.
    places_px: Vec<[f64; 2]>,
    /// Pairs are at most so far apart.
    reach_px: f64,
}

/// Stars near detections, and all of the frame by their brightness.
#[derive(Default)]
pub(super) struct NearDetections {
    /// In the order of their rows when they were looked for.
    close: Vec<NearStar>,
    in_frame: MagnitudeCounts,
    /// Memory of [`LaidSky::find_near`].
    found: Vec<(usize, [f64; 2])>,
    /// Memory of [`LaidSky::matches`]: the stars where a pose has them, and what is made of them.
    laid: Vec<LaidStar>,
    star_mag: Vec<f64>,
    pairs: Vec<association::Pair>,
    zero_points: Vec<f64>,
    association: association::Scratch,
}

/// A star near a detection.
struct NearStar {
    /// Index into the catalogue.
    star: usize,
    /// As it appears in this frame.
    direction: Vector3<f64>,
    /// Where it was when stars were looked for, relative to the middle, px.
    found_px: [f64; 2],
}

/// A star where a pose has it, relative to the middle, px.
#[derive(Clone, Copy)]
struct LaidStar {
    y: f64,
    x: f64,
    /// Index into the catalogue.
    star: usize,
}

impl NearDetections {
    /// Lays the stars where a pose has them, in order of their rows. `false` if one has moved by more than the slack; one without a place has moved
    /// far too. Without a slack those without a place are left out.
    fn lay(&mut self, pose: &Pose, corner_px: f64, slack_px: f64) -> bool {
        self.laid.clear();
        self.laid.reserve(self.close.len());
        for &NearStar { star, direction, found_px: [x0, y0] } in &self.close {
            let at = pose.project(&direction, corner_px);
            let stays = |[x, y]: [f64; 2]| (x - x0).powi(2) + (y - y0).powi(2) <= slack_px * slack_px;
            if slack_px.is_finite() && !at.is_some_and(stays) {
                return false;
            }
            self.laid.extend(at.map(|[x, y]| LaidStar { y, x, star }));
        }
        // The order is nearly that in which they were found.
        for end in 1..self.laid.len() {
            let star = self.laid[end];
            let mut place = end;
            while place > 0 && self.laid[place - 1].y.total_cmp(&star.y).then(self.laid[place - 1].star.cmp(&star.star)).is_gt() {
                self.laid[place] = self.laid[place - 1];
                place -= 1;
            }
            self.laid[place] = star;
        }
        true
    }
}

/// The stars whose rows are within `reach_px` of a row, with their numbers.
fn band(laid: &[LaidStar], y: f64, reach_px: f64) -> impl Iterator<Item = (usize, &LaidStar)> {
    let start = laid.partition_point(|star| star.y < y - reach_px);
    (start..).zip(&laid[start..]).take_while(move |(_, star)| star.y <= y + reach_px)
}

/// Cells of a frame from which a detection can be reached: a bit for each.
struct Cells {
    rows: [u64; Self::SIDE],
    half_px: [f32; 2],
    per_px: [f32; 2],
}

impl Cells {
    const SIDE: usize = 64;

    fn new(half_px: [f64; 2]) -> Self {
        let per_px = half_px.map(|half| (Self::SIDE as f64 / (2.0 * half)) as f32);
        Self { rows: [0; Self::SIDE], half_px: half_px.map(|half| half as f32), per_px }
    }

    /// The cell of a place along an axis; what lies beyond the frame belongs to its border.
    fn cell(&self, axis: usize, at: f32) -> usize {
        (((at + self.half_px[axis]) * self.per_px[axis]).max(0.0) as i32 as usize).min(Self::SIDE - 1)
    }

    fn mark(&mut self, [x, y]: [f64; 2], reach_px: f64) {
        let cell = |axis: usize, at: f64| self.cell(axis, at as f32);
        let (first, last) = (cell(0, x - reach_px), cell(0, x + reach_px));
        let columns = (u64::MAX >> (Self::SIDE - 1 - (last - first))) << first;
        let rows = cell(1, y - reach_px)..=cell(1, y + reach_px);
        self.rows[rows].iter_mut().for_each(|row| *row |= columns);
    }

    fn holds(&self, [x, y]: [f32; 2]) -> bool {
        self.hold(&[x], &[y]) == [1]
    }

    /// Which places are held: ones and zeros.
    #[inline(always)]
    #[allow(
        clippy::inline_always,
        clippy::manual_clamp,
        reason = "inlined into what is compiled for several processors; what is no number is the first cell"
    )]
    fn hold<const N: usize>(&self, x: &[f32; N], y: &[f32; N]) -> [u32; N] {
        const LAST: f32 = (Cells::SIDE - 1) as f32;
        let (mut columns, mut rows) = ([0; N], [0; N]);
        for lane in 0..N {
            columns[lane] = ((x[lane] + self.half_px[0]) * self.per_px[0]).max(0.0).min(LAST) as i32;
            rows[lane] = ((y[lane] + self.half_px[1]) * self.per_px[1]).max(0.0).min(LAST) as i32;
        }
        std::array::from_fn(|lane| (self.rows[rows[lane] as usize % Self::SIDE] >> columns[lane]) as u32 & 1)
    }
}

impl<'a> LaidSky<'a> {
    pub(super) fn new(
        detections: &'a Detections,
        points: &'a Points,
        index: &'a Index,
        apparent: &'a [Vector3<f64>],
        (parity, reach_px): (i8, f64),
    ) -> Self {
        let bright = |flux: f64| (flux > 0.0 && flux.is_finite()).then(|| -2.5 * flux.log10());
        let detection_mag = detections.stars.iter().map(|detection| bright(detection.flux_dn)).collect();
        let (middle_x, middle_y) = ((detections.width_px as f64 - 1.0) / 2.0, (detections.height_px as f64 - 1.0) / 2.0);
        let place = |star: &Detection| [unmirrored_x(parity, detections.width_px, star.x_px) - middle_x, star.y_px - middle_y];
        let places_px = detections.stars.iter().map(place).collect();
        Self { detections, index, apparent, points, detection_mag, places_px, reach_px }
    }

    /// The stars that this pose, or one near it, lays near detections.
    pub(super) fn find_near(&self, pose: &Pose, near: &mut NearDetections) {
        let slack_px = SLACK * self.points.size_px;
        let mut cells = Cells::new(self.points.half_px);
        for at in self.places_px.iter().filter(|at| at.iter().all(|c| c.is_finite())) {
            cells.mark(*at, self.reach_px + CROWDED_PX + slack_px);
        }
        let margin_px = self.reach_px.max(CROWDED_PX);
        let [half_x, half_y] = self.points.half_px.map(|half| half + margin_px);
        let boresight = Vector3::from(pose.rotation.row(2).transpose());
        let NearDetections { close, found, in_frame, .. } = near;
        found.clear();
        found.reserve(self.places_px.len() + ROOM);
        in_frame.clear();
        // Single precision and the catalogue's own directions are enough to see what is far from all detections; not for directions that an
        // effect of the sky may have moved by more than the slack.
        if pose.projection == Projection::Pinhole && std::ptr::eq(self.apparent, self.index.vectors.as_slice()) {
            let radius_rad = pose.reach_rad(self.points, CLOSE_MARGIN * (1.0 + margin_px / self.points.reach_px));
            let plane = FramePlane::new(pose, self.points);
            look_over(self.index, (&boresight, radius_rad), (&plane, [half_x as f32, half_y as f32]), &cells, (in_frame, found));
        } else {
            let radius_rad = pose.reach_rad(self.points, MARGIN);
            for star in self.index.brightest_within(&boresight, radius_rad, usize::MAX) {
                let star = star as usize;
                let Some(at) = pose.project(&self.apparent[star], self.points.corner_px) else { continue };
                if at[0].abs() <= half_x && at[1].abs() <= half_y {
                    in_frame.add(MagnitudeBin::of(self.index.magnitudes[star] as f32));
                    if cells.holds(at.map(|c| c as f32)) {
                        found.push((star, at));
                    }
                }
            }
        }
        found.sort_unstable_by(|(a, [_, a_y]), (b, [_, b_y])| a_y.total_cmp(b_y).then(a.cmp(b)));
        close.clear();
        close.extend(found.iter().map(|&(star, found_px)| NearStar { star, direction: self.apparent[star], found_px }));
    }

    /// The detections and catalogue stars that belong together: surely, uncrowded, of plausible brightness. `near` is found anew if the pose
    /// moves the stars too far from where they were.
    pub(super) fn matches(&self, pose: &Pose, near: &mut NearDetections, radius_px: f64) -> Vec<Match> {
        let corner_px = self.points.corner_px;
        if !near.lay(pose, corner_px, SLACK * self.points.size_px) {
            self.find_near(pose, near);
            near.lay(pose, corner_px, f64::INFINITY);
        }
        let NearDetections { laid, star_mag, pairs, zero_points, association, in_frame, .. } = near;
        self.all_pairs(laid, radius_px, pairs);
        star_mag.clear();
        star_mag.extend(laid.iter().map(|one| self.index.magnitudes[one.star]));
        let area_px2 = (self.detections.width_px * self.detections.height_px) as f64;
        let field = association::Field { area_px2, radius_px };
        association::keep_sure(pairs, &self.detection_mag, star_mag, in_frame, field, association);
        pairs.retain(|pair| !is_crowded(laid, star_mag, pair.star));
        self.drop_implausible_brightness(pairs, star_mag, zero_points);
        let flux = |m: &Match| self.detections.stars[m.detection].flux_dn;
        let of = |pair: &association::Pair| {
            let (LaidStar { x: star_x, y: star_y, star }, [x, y]) = (laid[pair.star], self.places_px[pair.detection]);
            Match { detection: pair.detection, star, residual_px: [x - star_x, y - star_y] }
        };
        let mut matches: Vec<Match> = pairs.iter().map(of).collect();
        matches.sort_unstable_by(|a, b| flux(b).total_cmp(&flux(a)).then(a.detection.cmp(&b.detection)));
        matches
    }

    /// The detections and stars within a radius of each other.
    fn all_pairs(&self, laid: &[LaidStar], radius_px: f64, pairs: &mut Vec<association::Pair>) {
        pairs.clear();
        pairs.reserve(self.places_px.len());
        for (detection, &[x, y]) in self.places_px.iter().enumerate() {
            if !(x.is_finite() && y.is_finite()) {
                continue;
            }
            for (star, at) in band(laid, y, radius_px) {
                let distance2_px2 = (x - at.x).powi(2) + (y - at.y).powi(2);
                if distance2_px2 <= radius_px * radius_px {
                    pairs.push(association::Pair { detection, star, distance2_px2 });
                }
            }
        }
    }

    /// Drops pairs that are far brighter or fainter than the others say: a hot pixel on a faint star, a star missed beside a planet.
    fn drop_implausible_brightness(&self, pairs: &mut Vec<association::Pair>, star_mag: &[f64], zero_points: &mut Vec<f64>) {
        let zero_point = |pair: &association::Pair| self.detection_mag[pair.detection].map(|magnitude| star_mag[pair.star] - magnitude);
        zero_points.clear();
        zero_points.reserve(pairs.len());
        zero_points.extend(pairs.iter().filter_map(zero_point));
        let count = zero_points.len();
        let Some((middle, sigma)) = median_and_mad_sigma(zero_points).filter(|_| count >= 8) else { return };
        // Colours and saturation move bright stars by a magnitude or two in any camera.
        let limit = (5.0 * sigma).max(2.5);
        pairs.retain(|pair| zero_point(pair).is_none_or(|value| (value - middle).abs() <= limit));
    }
}

/// Counts the stars of a cone that are within so much of the middle of a frame, and finds those that `cells` hold.
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn look_over(
    index: &Index,
    (boresight, radius_rad): (&Vector3<f64>, f64),
    (plane, [half_x, half_y]): (&FramePlane, [f32; 2]),
    cells: &Cells,
    (in_frame, found): (&mut MagnitudeCounts, &mut Vec<(usize, [f64; 2])>),
) {
    let (zones, magnitudes) = index.whole_sky();
    zones.near(boresight, radius_rad, |number, Block { xyz, ids }, lanes| {
        let [x, y] = plane.places(xyz);
        let magnitudes = &magnitudes[number];
        let inside = within(&x, half_x, &y, half_y);
        let held = cells.hold(&x, &y);
        let (inside, count) = those(lanes, &inside);
        for &lane in &inside[..count] {
            in_frame.add(magnitudes[lane]);
            if held[lane] == 1 {
                found.push((ids[lane] as usize, [f64::from(x[lane]), f64::from(y[lane])]));
            }
        }
    });
}

/// Whether another star of similar brightness stands beside one, by its number among those laid.
fn is_crowded(laid: &[LaidStar], star_mag: &[f64], number: usize) -> bool {
    let LaidStar { x, y, .. } = laid[number];
    band(laid, y, CROWDED_PX).any(|(other, at)| {
        other != number
            && (at.x - x).powi(2) + (at.y - y).powi(2) < CROWDED_PX * CROWDED_PX
            && star_mag[other] < star_mag[number] + CROWDED_MAG
    })
}

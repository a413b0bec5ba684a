//! Streaks: straight lines of light in one frame alone, as satellites, meteors and aircraft leave them.
//!
//! Bright ones are found as pixels that hang together and form a line; the search for stars takes pieces of them for stars, so their stars are no reason to
//! leave them out. Faint ones are found by sums along lines of all places, slopes and lengths ([`super::line_sums`]) where no star was found, single pixels
//! held down so that none makes a line. Stars in a chain ([`super::star_chains`]) are pieces of a streak, and count as no stars. Of a line's eight parts the
//! sum of the six faintest must be significant: a chain of a few stars has none. What is at the same place in another frame is the detector's.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::line_sums::{Plane, StripLine};
use super::ray_candidates::{Deviations, square};
use super::sky_frame::{SkyFrame, StarDisc, covered, sky_mask};
use super::sky_pixels::SkyPixels;
use super::star_chains::in_chains;
use super::streak_way::{ends, trimmed};
use crate::statistics::median_in_place;
use crate::statistics::order::descending;

/// Frames are joined to at most so many pixels along a side: a streak is long, and its search costs N·log N.
const MAX_SIDE: usize = 1024;
/// A streak is at least so long, in pixels of the frame as searched.
const MIN_LENGTH: usize = 32;
/// Half the width of the bands that are summed, less half a pixel.
const HALF_WIDTHS: [usize; 2] = [1, 3];
/// Of the 10⁷ lines of a frame noise brings one so far in 10⁴ frames.
const MIN_SNR: f32 = 7.0;
/// Of the faintest parts.
const MIN_TRIMMED_SNR: f64 = 4.5;
/// Single pixels count no more than this.
const CLIP: f32 = 3.5;
/// A streak beside another is at least so bright against it.
const OF_BRIGHTEST: f64 = 0.25;
/// Pixels of a bright streak stand out by so much.
const BRIGHT_SIGMAS: f32 = 4.0;
/// A bright streak is so many times as long as wide.
const SLENDER: f64 = 6.0;
/// So many streaks of a frame are something else: stars that are drawn out, a grid.
const MAX_STREAKS: usize = 8;
/// Two lines are one where the ends of the shorter are no farther from the longer, px.
const SAME_PX: f64 = 6.0;
/// One frame alone does not tell what is at the same place in others.
pub(crate) const MIN_STREAK_FRAMES: usize = 2;
/// Where so large a part of the stars is drawn out, they all are.
const TRAILS: f64 = 0.1;

/// A line of light.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Streak {
    /// Number of the frame in the recording.
    pub frame: usize,
    /// Column and row of one end.
    pub start_px: [f64; 2],
    /// Of the other.
    pub end_px: [f64; 2],
    /// Signal-to-noise ratio of its light.
    pub snr: f64,
}

impl Streak {
    /// Its length in the frame, px.
    #[must_use]
    pub fn length_px(&self) -> f64 {
        (self.end_px[0] - self.start_px[0]).hypot(self.end_px[1] - self.start_px[1])
    }

    /// Whether both lie on one line, and the shorter beside the longer.
    fn is_at(&self, other: &Self) -> bool {
        let (long, short) = if self.length_px() > other.length_px() { (self, other) } else { (other, self) };
        let length = long.length_px().max(1.0);
        let along = [0, 1].map(|axis| (long.end_px[axis] - long.start_px[axis]) / length);
        let from = |at: [f64; 2]| [0, 1].map(|axis| at[axis] - long.start_px[axis]);
        let off = |at: [f64; 2]| (from(at)[0] * along[1] - from(at)[1] * along[0]).abs();
        let middle = from([0, 1].map(|axis| f64::midpoint(short.start_px[axis], short.end_px[axis])));
        let on = middle[0] * along[0] + middle[1] * along[1];
        off(short.start_px) < SAME_PX && off(short.end_px) < SAME_PX && (0.0..length).contains(&on)
    }
}

/// Streaks counted.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Streaks {
    /// How many.
    pub count: usize,
    /// Frames that were searched.
    pub frames: usize,
    /// Per frame.
    pub per_frame: f64,
    /// Per second, where exposures are known.
    pub per_s: Option<f64>,
    /// Where they are.
    pub found: Vec<Streak>,
}

/// Those of a frame.
#[derive(Clone, Debug)]
pub(super) struct StreakFrame {
    exposure_s: Option<f64>,
    /// Whether the stars themselves are drawn out.
    are_trails: bool,
    found: Vec<Streak>,
}

/// Counts the streaks of all frames; nothing where most frames show trails of stars, or where no second frame tells a streak from a line of the detector.
pub(super) fn streaks(frames: &[StreakFrame]) -> Option<Streaks> {
    let searched: Vec<&StreakFrame> = frames.iter().filter(|frame| !frame.are_trails).collect();
    if searched.len() < MIN_STREAK_FRAMES || 2 * searched.len() < frames.len() {
        return None;
    }
    let all: Vec<Streak> = searched.iter().flat_map(|frame| frame.found.iter().copied()).collect();
    let is_alone = |own: &&Streak| !all.iter().any(|other| other.frame != own.frame && other.is_at(own));
    let found: Vec<Streak> = all.iter().filter(is_alone).copied().collect();
    let seconds: Option<f64> = searched.iter().map(|frame| frame.exposure_s).sum();
    let count = found.len();
    Some(Streaks {
        count,
        frames: searched.len(),
        per_frame: count as f64 / searched.len() as f64,
        per_s: seconds.filter(|seconds| *seconds > 0.0).map(|seconds| count as f64 / seconds),
        found,
    })
}

impl StreakFrame {
    pub(super) fn of(sky_frame: &SkyFrame<'_>, sky: &SkyPixels, deviations: &Deviations) -> Self {
        let chained = in_chains(sky_frame.stars, [sky.width_px, sky.height_px]);
        if !chained.contains(&true) {
            return Self::among_stars(sky_frame, sky, deviations);
        }
        // The chain covers whole blocks of the sky, of which nothing would be known: they are measured with it.
        let stars: Vec<StarDisc> = sky_frame.stars.iter().zip(chained).filter(|(_, chained)| !chained).map(|(star, _)| *star).collect();
        let sky_frame = SkyFrame { stars: &stars, ..*sky_frame };
        let sky = SkyPixels::new(sky_frame.frame, &sky_mask(&sky_frame));
        Self::among_stars(&sky_frame, &sky, &Deviations::of(&sky_frame, &sky))
    }

    /// All of these stars taken for stars.
    fn among_stars(sky_frame: &SkyFrame<'_>, sky: &SkyPixels, deviations: &Deviations) -> Self {
        let mut found = Vec::new();
        let bright = bright_streaks(sky_frame.number, deviations);
        let mut are_trails = bright.len() >= MAX_STREAKS || bright.len() as f64 > 1.0 + TRAILS * sky_frame.stars.len() as f64;
        if !are_trails {
            found.extend(&bright);
            let searched = Searched::of(sky_frame, sky, deviations, &bright);
            found.extend(searched.faint_streaks(sky_frame.number));
            are_trails = found.len() >= MAX_STREAKS;
        }
        if are_trails {
            found.clear();
        }
        Self { exposure_s: sky_frame.exposure_s, are_trails, found }
    }
}

/// Groups of bright pixels that form a line.
fn bright_streaks(frame: usize, deviations: &Deviations) -> Vec<Streak> {
    let width = deviations.width_px;
    let is_bright = |index: usize| deviations.values.get(index).is_some_and(|value| *value > BRIGHT_SIGMAS);
    let mut seen = vec![false; deviations.values.len()];
    let mut found = Vec::new();
    for first in 0..seen.len() {
        if seen[first] || !is_bright(first) {
            continue;
        }
        let (mut open, mut group) = (vec![first], Vec::new());
        while let Some(index) = open.pop() {
            if !std::mem::replace(&mut seen[index], true) {
                group.push(index);
                open.extend(square(index, width).filter(|next| is_bright(*next) && !seen[*next]));
            }
        }
        if group.len() >= MIN_LENGTH {
            found.extend(line_of(frame, &group, deviations));
        }
    }
    found
}

/// The line that a group of pixels forms, if it is one: long, and thin beside its length. A column that bleeds along an axis is none.
fn line_of(frame: usize, group: &[usize], deviations: &Deviations) -> Option<Streak> {
    /// Charge bleeds within this of an axis, rad.
    const AXIS_RAD: f64 = 0.02;
    let width = deviations.width_px;
    let place = |index: usize| [(index % width) as f64, (index / width) as f64];
    let count = group.len() as f64;
    let mean = group.iter().map(|index| place(*index)).fold([0.0; 2], |sum, at| [sum[0] + at[0] / count, sum[1] + at[1] / count]);
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for index in group {
        let [x, y] = place(*index);
        let [x, y] = [x - mean[0], y - mean[1]];
        (xx, xy, yy) = (xx + x * x / count, xy + x * y / count, yy + y * y / count);
    }
    let (middle, half) = (0.5 * (xx + yy), (0.5 * (xx - yy)).hypot(xy));
    let [length, across] = [middle + half, (middle - half).max(0.0)].map(|variance| (12.0 * variance).sqrt());
    if length < MIN_LENGTH as f64 || length < SLENDER * across.max(2.0) {
        return None;
    }
    let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
    let off_axis = angle.rem_euclid(std::f64::consts::FRAC_PI_2);
    let is_on_axis = off_axis.min(std::f64::consts::FRAC_PI_2 - off_axis) < AXIS_RAD;
    let is_full = |index: usize| square(index, width).any(|next| deviations.values.get(next).is_some_and(|value| value.is_nan()));
    if is_on_axis && group.iter().any(|index| is_full(*index)) {
        return None;
    }
    let along = |index: usize| (place(index)[0] - mean[0]) * angle.cos() + (place(index)[1] - mean[1]) * angle.sin();
    let (low, high) = group.iter().map(|index| along(*index)).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), at| (l.min(at), h.max(at)));
    let at = |along: f64| [mean[0] + along * angle.cos(), mean[1] + along * angle.sin()];
    let light: f64 = group.iter().map(|index| f64::from(deviations.values[*index])).sum();
    Some(Streak { frame, start_px: at(low), end_px: at(high), snr: light / count.sqrt() })
}

/// A frame as searched for faint streaks.
struct Searched {
    /// Pixels of the frame along a side of one.
    joined: usize,
    plane: Plane,
}

impl Searched {
    fn of(sky_frame: &SkyFrame<'_>, sky: &SkyPixels, deviations: &Deviations, bright: &[Streak]) -> Self {
        let (width, height) = (sky.width_px, sky.height_px);
        let mut values = deviations.values.clone();
        for star in sky_frame.stars {
            for y in covered(star.y_px, star.radius_px, height) {
                let half = (star.radius_px.powi(2) - (y as f64 - star.y_px).powi(2)).max(0.0).sqrt();
                values[y * width..][covered(star.x_px, half, width)].fill(f32::NAN);
            }
        }
        take_lines_out(&mut values, width);
        let joined = width.max(height).div_ceil(MAX_SIDE).max(1);
        let mut searched = Self { joined, plane: binned(&values, width, height, joined) };
        for streak in bright {
            searched.leave_out(streak);
        }
        searched
    }

    fn faint_streaks(mut self, frame: usize) -> Vec<Streak> {
        let mut found = Vec::new();
        while found.len() < MAX_STREAKS {
            // What a bright one leaves of itself, in the planes of the sky that it has tilted, is none.
            let brightest = found.iter().map(|own: &Streak| own.snr).fold(0.0, f64::max);
            let Some(streak) = self.brightest(frame).filter(|own| own.snr > OF_BRIGHTEST * brightest) else { break };
            self.leave_out(&streak);
            found.push(streak);
        }
        found
    }

    /// The line with the most light over its noise that stands the test of its parts.
    fn brightest(&self, frame: usize) -> Option<Streak> {
        /// Lines that are looked at more closely.
        const LOOKED_AT: usize = 400;
        let turned = self.plane.transposed();
        let mut all: Vec<(bool, StripLine)> = Vec::new();
        for (is_turned, plane) in [(false, &self.plane), (true, &turned)] {
            plane.lines_above(MIN_LENGTH, &HALF_WIDTHS, MIN_SNR, |line| {
                all.push((is_turned, line));
                if all.len() >= 64 * LOOKED_AT {
                    descending(&mut all, |a| f64::from(a.1.snr));
                    all.truncate(LOOKED_AT);
                }
            });
        }
        descending(&mut all, |a| f64::from(a.1.snr));
        let stands =
            |(is_turned, line): &&(bool, StripLine)| trimmed(if *is_turned { &turned } else { &self.plane }, line) > MIN_TRIMMED_SNR;
        let (is_turned, line) = all.iter().take(LOOKED_AT).find(stands)?;
        let plane = if *is_turned { &turned } else { &self.plane };
        let [start, end] = ends(plane, line);
        let in_frame = |[along, row]: [f64; 2]| {
            let at = if *is_turned { [row, along] } else { [along, row] };
            at.map(|along| (along + 0.5) * self.joined as f64 - 0.5)
        };
        Some(Streak { frame, start_px: in_frame(start), end_px: in_frame(end), snr: f64::from(line.snr) })
    }

    /// Takes a streak's band out of what is searched, with some of its way beyond both ends.
    fn leave_out(&mut self, streak: &Streak) {
        const MARGIN: f64 = 6.0;
        const BEYOND: f64 = 0.15;
        let place = |at: [f64; 2]| at.map(|along| (along + 0.5) / self.joined as f64 - 0.5);
        let (start, end) = (place(streak.start_px), place(streak.end_px));
        let along = [end[0] - start[0], end[1] - start[1]];
        let length = along[0].hypot(along[1]).max(1.0);
        let along = along.map(|component| component / length);
        let more = BEYOND * length + MARGIN;
        for (k, (value, count)) in self.plane.values.iter_mut().zip(&mut self.plane.counts).enumerate() {
            let at = [(k % self.plane.width) as f64 - start[0], (k / self.plane.width) as f64 - start[1]];
            let (on, off) = (at[0] * along[0] + at[1] * along[1], at[0] * along[1] - at[1] * along[0]);
            if off.abs() <= MARGIN && on > -more && on < length + more {
                (*value, *count) = (0.0, 0.0);
            }
        }
    }
}

/// Takes the medians of rows and columns out: banding is no streak.
fn take_lines_out(values: &mut [f32], width: usize) {
    let rows = values.len() / width.max(1);
    let middle = |own: &mut Vec<f64>| median_in_place(own).unwrap_or(0.0) as f32;
    for row in values.chunks_exact_mut(width) {
        let level = middle(&mut row.iter().filter(|value| !value.is_nan()).map(|value| f64::from(*value)).collect());
        for value in row {
            *value -= level;
        }
    }
    for x in 0..width {
        let own = (0..rows).map(|y| values[y * width + x]).filter(|value| !value.is_nan());
        let level = middle(&mut own.map(f64::from).collect());
        (0..rows).for_each(|y| values[y * width + x] -= level);
    }
}

/// Pixels joined in squares, clipped before.
fn binned(values: &[f32], width: usize, height: usize, joined: usize) -> Plane {
    let (columns, rows) = (width / joined, height / joined);
    let (mut sums, mut counts) = (vec![0.0; columns * rows], vec![0.0; columns * rows]);
    for y in 0..rows {
        for x in 0..columns {
            let own = (0..joined * joined).map(|k| values[(y * joined + k / joined) * width + x * joined + k % joined]);
            let (sum, known) = own
                .filter(|value| !value.is_nan())
                .fold((0.0, 0.0), |(sum, known), value| (sum + value.clamp(-CLIP, CLIP), known + 1.0_f32));
            if 2.0 * known >= (joined * joined) as f32 {
                (sums[y * columns + x], counts[y * columns + x]) = (sum / known.sqrt(), 1.0);
            }
        }
    }
    Plane { width: columns, height: rows, values: sums, counts }
}

#[cfg(test)]
#[path = "streaks_tests.rs"]
mod tests;

//! The pixels of a star, as its labels have them.

use super::alone::core_px;
use super::symmetry::Symmetry;
use crate::dataset::sample_labels::SampleLabels;
use crate::render::StarAlone;

/// Pixels beside the box of a star that are summed too.
const MARGIN_PX: isize = 1;
/// Nothing of a frame is farther off, px; a label may say anything.
const FAR_PX: f64 = 1e9;
/// A light whose centre is further than this from the labelled place is another one, px; of a long trail, this share of its box: the centre of a faint
/// one scatters along it.
const MAX_APART_PX: f64 = 1.0;
const MAX_APART_SHARE: f64 = 0.1;

/// Columns and rows from and to which pixels are taken, the last included.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    pub(super) from: [isize; 2],
    pub(super) to: [isize; 2],
}

impl Window {
    /// The box of a light with its margin, moved to where a symmetry has it.
    pub(super) fn new(labels: &SampleLabels, index: usize, symmetry: Symmetry) -> Self {
        let lights = &labels.lights;
        let corner = |x: usize, y: usize| symmetry.applied([x as f64, y as f64], labels.size_px).map(|at| at.clamp(-FAR_PX, FAR_PX));
        let a = corner(lights.box_left_px[index], lights.box_top_px[index]);
        let b = corner(lights.box_right_px[index], lights.box_bottom_px[index]);
        let ends = |axis: usize| (a[axis].min(b[axis]) as isize - MARGIN_PX, a[axis].max(b[axis]) as isize + MARGIN_PX);
        let ((left, right), (top, bottom)) = (ends(0), ends(1));
        Self { from: [left, top], to: [right, bottom] }
    }

    /// The core of a star's image, moved from its own place to another.
    pub(super) fn of_core(star: &StarAlone, place: [f64; 2]) -> Self {
        let core = core_px(star);
        let end = |axis: usize, which: usize| {
            (core[axis][which] as f64 + (place[axis] - star.centre_px[axis]).clamp(-FAR_PX, FAR_PX)).round() as isize
        };
        Self { from: [end(0, 0), end(1, 0)], to: [end(0, 1), end(1, 1)] }.grown(MARGIN_PX)
    }

    pub(super) fn grown(self, by: isize) -> Self {
        Self { from: self.from.map(|from| from - by), to: self.to.map(|to| to + by) }
    }

    pub(super) fn is_on(self, size: [usize; 2]) -> bool {
        (0..2).all(|axis| self.from[axis] >= 0 && self.to[axis] < size[axis].cast_signed())
    }

    pub(super) fn touches(self, other: Self) -> bool {
        (0..2).all(|axis| self.from[axis] <= other.to[axis] && other.from[axis] <= self.to[axis])
    }

    /// Whether a centre of light in the window is that of a light at this place.
    pub(super) fn is_centre(self, centre: [f64; 2], place: [f64; 2]) -> bool {
        let apart_px = |axis: usize| MAX_APART_PX.max(MAX_APART_SHARE * (self.to[axis] - self.from[axis]) as f64);
        (0..2).all(|axis| (centre[axis] - place[axis]).abs() <= apart_px(axis))
    }

    pub(super) fn contains(self, [x, y]: [isize; 2]) -> bool {
        self.from[0] <= x && x <= self.to[0] && self.from[1] <= y && y <= self.to[1]
    }

    pub(super) fn places(self) -> impl Iterator<Item = [isize; 2]> {
        (self.from[1]..=self.to[1]).flat_map(move |y| (self.from[0]..=self.to[0]).map(move |x| [x, y]))
    }
}

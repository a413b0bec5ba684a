//! A round end of the field: the image of a stop, outside of which no light arrives.
//!
//! A few frames, spread over the recording, are laid over each other: each less its level, in units of its noise, the median pixel by pixel, so that
//! stars, which move, fall out and what stays with the camera remains. In it the circle is searched across which the level falls most, first about the
//! middle of the frame and then, by least squares, about a centre of its own: level a + b·(R − r) inside, c outside, and between them the logistic
//! 1/(1 + e^(4(r − R)/w)), half of the light at R. A vignette and the cosine law have no such edge: a smooth profile explains them better.
//! Source of the model: W. J. Smith, *Modern Optical Engineering* (2008), chapter 9; least squares with damped steps: Marquardt, J. SIAM 11, 431 (1963).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::stop_fit::{Edge, EdgeFit, Spot};
use crate::frame::Frame;
use crate::statistics::{median, median_in_place};

/// Frames that are laid over each other, at most, and at least: fewer do not tell what stays.
const MAX_FRAMES: usize = 9;
pub(crate) const MIN_STOP_FRAMES: usize = 3;
/// Columns or rows of what is searched, at most: larger frames are summed in squares.
const MAX_SIDE: usize = 768;
/// Half of the gap between the rings that are compared, in px of what is searched: penumbra, and a centre that is not the frame's.
const GAPS: [f64; 4] = [2.0, 6.0, 16.0, 40.0];
/// An edge is fitted to so many pixels, at most.
const MAX_SPOTS: usize = 20_000;
/// A ring tells a level with so many pixels.
const MIN_RING: usize = 12;
/// The smallest stop that is searched, in half-diagonals.
const MIN_RADIUS: f64 = 0.15;
/// The fall is at least so many standard errors, and in every frame so many.
const CLEARLY: f64 = 10.0;
const CLEARLY_IN_FRAME: f64 = 3.0;
/// The penumbra is narrower than this, px, or than this share of the radius.
const WIDEST_EDGE_PX: f64 = 10.0;
const WIDEST_EDGE: f64 = 0.05;
/// What is left beyond the stop, at most, of the sky inside, where the count of no light is known.
const DARK_SHARE: f64 = 0.5;
/// By so much of χ² the edge is better than a smooth profile.
const BETTER_THAN_SMOOTH: f64 = 100.0;
/// Every quadrant falls by at least this share of the mean fall, and so many quadrants show it.
const QUADRANT_SHARE: f64 = 0.5;
const MIN_QUADRANTS: usize = 3;
/// A penumbra may have another shape than that of the model: linear ramps move the radius by up to so much of their width.
const SHAPE_SHARE: f64 = 0.025;
/// Beside the edge: levels are taken from so many of its widths on (8 % of the light are left there), in rings so wide, px.
const BESIDE: f64 = 0.6;
const RING_PX: f64 = 8.0;
/// The penumbra and so many px more say nothing of the sky.
const MARGIN_PX: f64 = 2.0;

/// The image of a stop.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StopCircle {
    /// Width and height of the frame.
    pub size_px: [usize; 2],
    /// Column and row of its middle.
    pub centre_px: [f64; 2],
    /// Where half of the light is left.
    pub radius_px: f64,
    /// Its standard error.
    pub radius_sigma_px: f64,
    /// Width over which the light falls: four times the inverse of the steepest relative slope.
    pub edge_px: f64,
    /// The fall over its standard error.
    pub deviation: f64,
    /// Frames that were looked at; all of them show it.
    pub frames: usize,
}

impl StopCircle {
    /// Which of a recording's frames are looked at.
    pub(crate) fn looked_at(frames: usize) -> Vec<usize> {
        let count = frames.min(MAX_FRAMES);
        (0..count).map(|k| (2 * k + 1) * frames / (2 * count)).collect()
    }

    /// Of some frames; nothing where no circle ends the field of all of them. `bias_dn`: the count of no light, where known.
    pub(crate) fn of(frames: &[StopFrame], bias_dn: Option<f64>) -> Option<Self> {
        let first = frames.first()?;
        let frames: Vec<&StopFrame> = frames.iter().filter(|frame| frame.size_px == first.size_px && frame.noise_dn > 0.0).collect();
        if frames.len() < MIN_STOP_FRAMES {
            return None;
        }
        let overlay = Overlay::of(&frames)?;
        let starts = overlay.starts();
        let found =
            starts.into_iter().filter_map(|[radius, gap]| overlay.fitted(radius, gap)).max_by(|a, b| a.better.total_cmp(&b.better))?;
        let deviation = found.edge.fall() / found.sigma.fall;
        let square = first.square_px as f64;
        let widest = (WIDEST_EDGE_PX / square).max(WIDEST_EDGE * found.edge.radius);
        let is_edge = found.better > BETTER_THAN_SMOOTH && deviation > CLEARLY && found.edge.width < widest;
        if !is_edge || !overlay.is_all_round(&found.edge) || !frames.iter().all(|frame| frame.falls(&found.edge)) {
            return None;
        }
        if let Some(bias_dn) = bias_dn {
            let shares: Vec<f64> = frames.iter().filter_map(|frame| frame.left_beyond(&found.edge, bias_dn)).collect();
            if median(&shares).is_some_and(|share| share > DARK_SHARE) {
                return None;
            }
        }
        Some(Self {
            size_px: first.size_px,
            // The middle of the first square lies half a square less half a pixel from that of the first pixel.
            centre_px: found.edge.centre.map(|at| at * square + 0.5 * (square - 1.0)),
            radius_px: found.edge.radius * square,
            radius_sigma_px: found.sigma.radius.hypot(SHAPE_SHARE * found.edge.width) * square,
            edge_px: found.edge.width * square,
            deviation,
            frames: frames.len(),
        })
    }

    /// Its middle from that of the frame, to the right and downwards, px.
    pub(crate) fn off_middle_px(&self) -> [f64; 2] {
        [0, 1].map(|axis| self.centre_px[axis] - 0.5 * (self.size_px[axis] as f64 - 1.0))
    }

    /// Which pixels lie beyond it or in its penumbra, row by row.
    pub(crate) fn unlit(&self) -> Vec<bool> {
        let [width_px, height_px] = self.size_px;
        let reach2 = (self.radius_px - self.edge_px - MARGIN_PX).max(0.0).powi(2);
        let off = |index: usize| [(index % width_px) as f64 - self.centre_px[0], (index / width_px) as f64 - self.centre_px[1]];
        (0..width_px * height_px).map(|index| off(index).iter().map(|along| along * along).sum::<f64>() > reach2).collect()
    }
}

/// A frame summed in squares.
#[derive(Clone, Debug)]
pub(crate) struct StopFrame {
    size_px: [usize; 2],
    /// Side of a square, px.
    square_px: usize,
    /// Squares of a row.
    columns: usize,
    /// Mean counts of the squares, row by row.
    values_dn: Vec<f32>,
    level_dn: f64,
    /// Noise of a square.
    noise_dn: f64,
}

impl StopFrame {
    pub(crate) fn new(frame: &Frame) -> Self {
        let square_px = frame.width_px.max(frame.height_px).div_ceil(MAX_SIDE).max(1);
        let (columns, rows) = (frame.width_px / square_px, frame.height_px / square_px);
        let mean = |square: usize| {
            let corner = square / columns * square_px * frame.width_px + square % columns * square_px;
            let lines = (0..square_px).flat_map(|y| &frame.pixels_dn[corner + y * frame.width_px..][..square_px]);
            lines.sum::<f32>() / (square_px * square_px) as f32
        };
        let values_dn: Vec<f32> = (0..columns * rows).map(mean).collect();
        let mut all: Vec<f64> = values_dn.iter().map(|value| f64::from(*value)).collect();
        // Of a normal distribution the median of differences is 0.95 σ; a coarse step counts with its own scatter.
        let pairs = values_dn.chunks_exact(columns.max(1)).flat_map(|row| row.windows(2));
        let mut differences: Vec<f64> = pairs.map(|pair| f64::from((pair[1] - pair[0]).abs())).collect();
        let mean_difference = differences.iter().sum::<f64>() / differences.len().max(1) as f64;
        let noise_dn = (median_in_place(&mut differences).unwrap_or(0.0) / 0.95).max(0.2 * mean_difference);
        let level_dn = median_in_place(&mut all).unwrap_or(0.0);
        Self { size_px: [frame.width_px, frame.height_px], square_px, columns, values_dn, level_dn, noise_dn }
    }

    /// Median counts in the rings inside and outside of an edge, and how many squares each has.
    fn beside(&self, edge: &Edge) -> [(Option<f64>, usize); 2] {
        let ring_px = RING_PX / self.square_px as f64;
        let mut rings = [Vec::new(), Vec::new()];
        for (index, value) in self.values_dn.iter().enumerate() {
            let away = edge.away([(index % self.columns) as f64, (index / self.columns) as f64]);
            if (BESIDE * edge.width..BESIDE * edge.width + ring_px.max(2.0)).contains(&away.abs()) {
                rings[usize::from(away > 0.0)].push(f64::from(*value));
            }
        }
        rings.map(|mut ring| (median_in_place(&mut ring), ring.len()))
    }

    /// Whether the frame falls to less at an edge by itself.
    fn falls(&self, edge: &Edge) -> bool {
        let [(inside, n), (outside, m)] = self.beside(edge);
        let error = self.noise_dn * ((n.max(1) as f64).recip() + (m.max(1) as f64).recip()).sqrt();
        inside.zip(outside).is_some_and(|(inside, outside)| inside - outside > CLEARLY_IN_FRAME * error)
    }

    /// What share of the light inside is left outside; nothing where there is none.
    fn left_beyond(&self, edge: &Edge, bias_dn: f64) -> Option<f64> {
        let [(inside, _), (outside, _)] = self.beside(edge);
        let (inside, outside) = (inside? - bias_dn, outside? - bias_dn);
        (inside > 0.0).then(|| outside / inside)
    }
}

/// Frames laid over each other, in units of their noise.
struct Overlay {
    columns: usize,
    rows: usize,
    values: Vec<f64>,
}

impl Overlay {
    fn of(frames: &[&StopFrame]) -> Option<Self> {
        let columns = frames[0].columns;
        let rows = frames[0].values_dn.len().checked_div(columns)?;
        let mut column = Vec::with_capacity(frames.len());
        let of = |index: usize| {
            column.clear();
            column.extend(frames.iter().map(|frame| (f64::from(frame.values_dn[index]) - frame.level_dn) / frame.noise_dn));
            median_in_place(&mut column).unwrap_or(0.0)
        };
        Some(Self { columns, rows, values: (0..columns * rows).map(of).collect() })
    }

    fn middle(&self) -> [f64; 2] {
        [self.columns, self.rows].map(|side| 0.5 * (side as f64 - 1.0))
    }

    fn at(&self, index: usize) -> [f64; 2] {
        [(index % self.columns) as f64, (index / self.columns) as f64]
    }

    /// Radii about the middle of the frame across which the level falls most, one of every gap.
    fn starts(&self) -> Vec<[f64; 2]> {
        let middle = self.middle();
        let corner = middle[0].hypot(middle[1]);
        let mut rings: Vec<Vec<f64>> = vec![Vec::new(); corner as usize + 1];
        for (index, value) in self.values.iter().enumerate() {
            let at = self.at(index);
            rings[(at[0] - middle[0]).hypot(at[1] - middle[1]) as usize].push(*value);
        }
        let level = |from: f64, to: f64| {
            let (from, to) = (from.max(0.0) as usize, (to.max(0.0) as usize).min(rings.len()));
            let mut own: Vec<f64> = rings.get(from..to)?.iter().flatten().copied().collect();
            (own.len() >= MIN_RING).then(|| median_in_place(&mut own).map(|level| (level, own.len() as f64))).flatten()
        };
        let of_gap = |gap: &f64| {
            let wide = gap.max(4.0);
            let fall = |radius: f64| {
                let ((inside, n), (outside, m)) = (level(radius - gap - wide, radius - gap)?, level(radius + gap, radius + gap + wide)?);
                Some((inside - outside) / (n.recip() + m.recip()).sqrt())
            };
            let radii = ((MIN_RADIUS * corner) as usize..rings.len()).map(|radius| radius as f64);
            let falls = radii.filter_map(|radius| fall(radius).map(|fall| (fall, radius)));
            let (fall, radius) = falls.max_by(|a, b| a.0.total_cmp(&b.0))?;
            (fall > CLEARLY).then_some([radius, *gap])
        };
        GAPS.iter().filter_map(of_gap).collect()
    }

    /// The edge near a radius, its penumbra at first as wide as a gap.
    fn fitted(&self, radius: f64, gap: f64) -> Option<EdgeFit> {
        let mut edge = Edge { centre: self.middle(), radius, width: 2.0 * gap, inside: 0.0, slope: 0.0, outside: 0.0 };
        let mut fit = None;
        // From far to near: the set of squares beside the edge follows it.
        for reach in [3.0, 2.0, 2.0, 2.0] {
            let reach = (reach * edge.width).max(RING_PX).min(0.5 * edge.radius);
            let beside = || (0..self.values.len()).filter(|index| edge.away(self.at(*index)).abs() < reach);
            // Of many some tell enough: one in so many, scattered over the frame.
            let every = beside().count() / MAX_SPOTS + 1;
            let spots: Vec<Spot> = beside()
                .filter(|index| (index.wrapping_mul(0x9e37_79b9) >> 12) % every == 0)
                .map(|index| Spot { at: self.at(index), value: self.values[index] })
                .collect();
            let own = EdgeFit::of(&spots, edge)?;
            edge = own.edge;
            fit = Some(own);
        }
        fit
    }

    /// Whether all quadrants that show both sides of the edge fall, and so many show them.
    fn is_all_round(&self, edge: &Edge) -> bool {
        let mut sides: [[Vec<f64>; 2]; 4] = std::array::from_fn(|_| [Vec::new(), Vec::new()]);
        for (index, value) in self.values.iter().enumerate() {
            let at = self.at(index);
            let away = edge.away(at);
            if (BESIDE * edge.width..BESIDE * edge.width + RING_PX).contains(&away.abs()) {
                let quadrant = usize::from(at[0] > edge.centre[0]) + 2 * usize::from(at[1] > edge.centre[1]);
                sides[quadrant][usize::from(away > 0.0)].push(*value);
            }
        }
        let shown: Vec<f64> = sides
            .into_iter()
            .filter(|sides| sides.iter().all(|side| 2 * side.len() >= MIN_RING))
            .filter_map(|[inside, outside]| Some(median(&inside)? - median(&outside)?))
            .collect();
        shown.len() >= MIN_QUADRANTS && shown.iter().all(|fall| *fall > QUADRANT_SHARE * edge.fall())
    }
}

#[cfg(test)]
#[path = "field_stop_tests.rs"]
mod tests;

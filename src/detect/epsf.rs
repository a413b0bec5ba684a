//! Effective point-spread function (ePSF) of a recording, learned from its own stars.
//!
//! As in Anderson & King 2000 (PASP 112, 1360) it is sampled on a grid finer than the pixels, with a smooth interpolant. Unlike theirs it is the
//! light before integration over the pixels, and only its difference from the typical Gaussian, as a sum of narrower Gaussians on the grid, each
//! integrated over every pixel. A Gaussian camera loses nothing by that, and images that no optics make are excluded: without this bound any
//! displacement that depends on the pixel phase could be absorbed by the ePSF, since each star's position is free. The difference may change over
//! the frame as a polynomial of the position.

use std::borrow::Cow;
use std::ops::Range;

use schemars::JsonSchema;
use serde::Serialize;

use super::image_model::{PROFILE_PARAMETERS, Shape, Window, axis_shares};

/// Terms of the field polynomial of each order: 1; x, y; x², xy, y²; x³, x²y, xy², y³.
pub(super) const FIELD_TERMS: [usize; 4] = [1, 3, 6, 10];
/// Width of the narrow Gaussians over that of the image, where pixels alone tell it, and where the sky says the places: then images that no optics make
/// (a response within the pixels is in them) take up no error of the places.
pub(super) const NARROW: f64 = 0.7;
const NARROW_BY_SKY: f64 = 0.35;
/// Their distance then: detail that is missed is finer than the pixels show.
const SPACING_BY_SKY: f64 = 1.0;
/// Pixels farther from a narrow Gaussian than so many of its widths get nothing of it (1e-9).
const REACH_SIGMAS: f64 = 6.0;
/// By how much the image may then differ more from a Gaussian: what pixels alone must not be asked, since the places would pay for it, the sky decides.
/// Held-out χ² of real frames is flat from 1 to 10, and what is left of the phase's error falls up to 5.
pub(super) const FREEDOM_BY_SKY: f64 = 5.0;
/// Their distance over their width: at 1 a narrow Gaussian between two knots is missed by 0.7 % of its light in the finest detail (e^(−π²/2)),
/// which bright stars see; at 0.7 by 4e-5.
const SPACING: f64 = 0.7;

/// A grid of narrow Gaussians, its middle at the star's centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Grid {
    /// Distance of its knots.
    pub(super) step_px: f64,
    /// σ of the Gaussian at each.
    pub(super) narrow_px: f64,
    /// Knots on each side; odd.
    pub(super) side: usize,
}

/// What the pixels along one axis get of the Gaussians of the knots, and the derivatives by the star's place: pixel after pixel, a number for each knot.
pub(super) struct Lines {
    knots: usize,
    /// The knots that reach each pixel.
    reach: Vec<Range<usize>>,
    value: Vec<f64>,
    slope: Vec<f64>,
}

impl Lines {
    const fn pixels(&self) -> usize {
        self.reach.len()
    }

    /// The knots that reach a pixel, and their numbers there.
    #[inline]
    fn of<'a>(&self, values: &'a [f64], pixel: usize) -> (Range<usize>, &'a [f64]) {
        let reach = self.reach[pixel].clone();
        (reach.clone(), &values[pixel * self.knots..][reach])
    }

    #[inline]
    fn value(&self, pixel: usize) -> (Range<usize>, &[f64]) {
        self.of(&self.value, pixel)
    }

    #[inline]
    fn slope(&self, pixel: usize) -> &[f64] {
        self.of(&self.slope, pixel).1
    }

    /// The same with the squares of the values.
    pub(super) fn squared(&self) -> Self {
        let value = self.value.iter().map(|v| v * v).collect();
        Self { knots: self.knots, reach: self.reach.clone(), value, slope: Vec::new() }
    }

    /// What the knots of each column give a row of pixels: rows of knots weighted by what this row gets of them.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "inlined into loops compiled for several instruction sets")]
    fn row_sum(&self, weights: &[f64], knots: &[f64], pixel: usize, sum: &mut [f64]) {
        let (reach, weights) = self.of(weights, pixel);
        sum.fill(0.0);
        for (k, weight) in weights.iter().enumerate() {
            let row = (reach.start + k) * sum.len();
            add_scaled(sum, *weight, &knots[row..row + sum.len()]);
        }
    }
}

/// Σ a·b in four partial sums, whatever the processor: the same everywhere, and none waits for another.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into loops compiled for several instruction sets")]
#[allow(clippy::needless_range_loop, reason = "a Zip is not inlined here without thin LTO (dev profile): 1.7 times the time")]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<4>(), b.as_chunks::<4>());
    let mut sums = [0.0; 4];
    for i in 0..a.len().min(b.len()) {
        for k in 0..4 {
            sums[k] += a[i][k] * b[i][k];
        }
    }
    let mut rest = 0.0;
    for i in 0..a_rest.len().min(b_rest.len()) {
        rest += a_rest[i] * b_rest[i];
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into loops compiled for several instruction sets")]
#[allow(clippy::needless_range_loop, reason = "as above")]
fn add_scaled(target: &mut [f64], factor: f64, source: &[f64]) {
    for i in 0..target.len().min(source.len()) {
        target[i] += factor * source[i];
    }
}

impl Grid {
    /// For an image of this width in windows of this half side.
    pub(super) fn for_image(sigma_px: f64, radius: usize) -> Self {
        Self::of(NARROW * sigma_px, SPACING, radius)
    }

    /// The same where the sky says the places.
    pub(super) fn by_sky(sigma_px: f64, radius: usize) -> Self {
        Self::of(NARROW_BY_SKY * sigma_px, SPACING_BY_SKY, radius)
    }

    fn of(narrow_px: f64, spacing: f64, radius: usize) -> Self {
        let step_px = spacing * narrow_px;
        // all of the window: light of wings and rings beside a smaller grid is many times the noise of bright stars
        let half_px = radius as f64 + 0.5;
        Self { step_px, narrow_px, side: 2 * (half_px / step_px).round() as usize + 1 }
    }

    pub(super) fn knots(self) -> usize {
        self.side * self.side
    }

    fn along_px(self, knot: usize) -> f64 {
        (knot as f64 - (self.side / 2) as f64) * self.step_px
    }

    /// Place of a knot from the star's centre, px.
    pub(super) fn place_px(self, knot: usize) -> [f64; 2] {
        [self.along_px(knot % self.side), self.along_px(knot / self.side)]
    }

    fn line(self, start: usize, length: usize, centre: f64) -> Lines {
        let (mut value, mut slope) = (vec![0.0; length * self.side], vec![0.0; length * self.side]);
        let mut reach = vec![self.side..self.side; length];
        let far_px = REACH_SIGMAS * self.narrow_px + 0.5;
        for knot in 0..self.side {
            let at = centre + self.along_px(knot);
            let pixel = |at_px: f64| (at_px - start as f64).clamp(0.0, length as f64) as usize;
            let (first, end) = (pixel((at - far_px).ceil()), pixel((at + far_px).floor() + 1.0));
            for (pixel, [share, by_centre, _]) in (first..).zip(axis_shares(start + first, end.saturating_sub(first), at, self.narrow_px)) {
                value[pixel * self.side + knot] = share;
                slope[pixel * self.side + knot] = by_centre;
                // The farther the knot, the farther the pixels: those of a pixel stand together.
                reach[pixel] = reach[pixel].start.min(knot)..knot + 1;
            }
        }
        for own in reach.iter_mut().filter(|own| own.start == self.side) {
            *own = 0..0;
        }
        Lines { knots: self.side, reach, value, slope }
    }

    /// The lines across and down a window.
    pub(super) fn lines(self, window: Window, centre: [f64; 2]) -> [Lines; 2] {
        [self.line(window.x0, window.columns, centre[0]), self.line(window.y0, window.rows, centre[1])]
    }

    /// Adds the correction to shares and their derivatives by the centre.
    pub(super) fn add(
        self,
        knots: &[f64],
        window: Window,
        centre: [f64; 2],
        value: &mut [f64],
        derivatives: &mut [[f64; PROFILE_PARAMETERS]],
    ) {
        let [across, down] = self.lines(window, centre);
        add_light(knots, &across, &down, value, derivatives);
    }
}

/// The loops of [`Grid::add`].
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn add_light(knots: &[f64], across: &Lines, down: &Lines, value: &mut [f64], derivatives: &mut [[f64; PROFILE_PARAMETERS]]) {
    let (mut sum, mut by_y) = (vec![0.0; across.knots], vec![0.0; across.knots]);
    let rows = value.chunks_exact_mut(across.pixels()).zip(derivatives.chunks_exact_mut(across.pixels()));
    for (y, (values, derivatives)) in rows.enumerate() {
        down.row_sum(&down.value, knots, y, &mut sum);
        down.row_sum(&down.slope, knots, y, &mut by_y);
        for (x, (v, d)) in values.iter_mut().zip(derivatives).enumerate() {
            let (reach, shares) = across.value(x);
            *v += dot(shares, &sum[reach.clone()]);
            d[0] += dot(across.slope(x), &sum[reach.clone()]);
            d[1] += dot(shares, &by_y[reach]);
        }
    }
}

/// Adds the correction times `factor` to the values alone.
#[multiversion::multiversion(targets("x86_64+avx2"))]
pub(super) fn light_of_knots(knots: &[f64], [across, down]: &[Lines; 2], factor: f64, value: &mut [f64]) {
    let mut sum = vec![0.0; across.knots];
    for (y, row) in value.chunks_exact_mut(across.pixels()).enumerate() {
        down.row_sum(&down.value, knots, y, &mut sum);
        for (x, v) in row.iter_mut().enumerate() {
            let (reach, shares) = across.value(x);
            *v += factor * dot(shares, &sum[reach]);
        }
    }
}

/// The transpose of [`light_of_knots`]: what each knot gets of the pixels, times `factor`.
#[multiversion::multiversion(targets("x86_64+avx2"))]
pub(super) fn knots_of_light(value: &[f64], [across, down]: &[Lines; 2], factor: f64, knots: &mut [f64]) {
    let mut sum = vec![0.0; across.knots];
    knots.fill(0.0);
    for (y, row) in value.chunks_exact(across.pixels()).enumerate() {
        sum.fill(0.0);
        for (x, v) in row.iter().enumerate() {
            let (reach, shares) = across.value(x);
            add_scaled(&mut sum[reach], factor * v, shares);
        }
        let (reach, shares) = down.value(y);
        for (k, share) in shares.iter().enumerate() {
            let row = (reach.start + k) * across.knots;
            add_scaled(&mut knots[row..row + across.knots], *share, &sum);
        }
    }
}

/// What an image is taken under besides its place: the star's colour and the frame's temperature, as departures from the usual; 0 where unknown.
pub(super) type Conditions = [f64; 2];

/// What the correction is linear in: the terms of a field polynomial, then a term for each condition that it changes with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Terms {
    /// Order of the field polynomial.
    pub(super) order: usize,
    /// Whether it changes with colour, and with temperature.
    pub(super) by: [bool; 2],
}

impl Terms {
    pub(super) fn count(self) -> usize {
        FIELD_TERMS[self.order] + self.by.iter().filter(|by| **by).count()
    }

    /// The value of each at a place of frames of this size.
    pub(super) fn at(self, size_px: [f64; 2], at_px: [f64; 2], conditions: Conditions) -> Vec<f64> {
        let field = field_terms(size_px, at_px).into_iter().take(FIELD_TERMS[self.order]);
        field.chain(conditions.into_iter().zip(self.by).filter(|(_, by)| *by).map(|(value, _)| value)).collect()
    }
}

/// A camera's image of a star, pixel included, as learnt from its own stars.
#[derive(Clone, Debug, PartialEq)]
pub struct EmpiricalPsf {
    /// The Gaussian that is corrected.
    pub(super) base: Shape,
    pub(super) grid: Grid,
    /// Columns and rows of the frames.
    pub(super) size_px: [f64; 2],
    pub(super) terms: Terms,
    /// The correction's knots (share of the flux), one grid for each term, one after the other.
    pub(super) knots: Vec<f64>,
}

/// The terms of the field polynomial at a place: coordinates from −1 to 1 over the longer side.
pub(super) fn field_terms(size_px: [f64; 2], at_px: [f64; 2]) -> [f64; 10] {
    let half = 0.5 * size_px[0].max(size_px[1]);
    let [x, y]: [f64; 2] = std::array::from_fn(|k| (at_px[k] - 0.5 * (size_px[k] - 1.0)) / half);
    [1.0, x, y, x * x, x * y, y * y, x * x * x, x * x * y, x * y * y, y * y * y]
}

impl EmpiricalPsf {
    /// The correction's knots at a place of the frame.
    pub(super) fn correction_at(&self, at_px: [f64; 2]) -> Vec<f64> {
        let terms = self.terms.at(self.size_px, at_px, [0.0; 2]);
        let mut local = vec![0.0; self.grid.knots()];
        for (term, grid) in terms.iter().zip(self.knots.chunks_exact(self.grid.knots())) {
            for (sum, knot) in local.iter_mut().zip(grid) {
                *sum += term * knot;
            }
        }
        local
    }

    /// The image under these conditions, which changes with the place alone.
    #[must_use]
    pub fn under(&self, conditions: Conditions) -> Cow<'_, Self> {
        let (order, count) = (self.terms.order, self.grid.knots());
        if self.terms.by == [false; 2] {
            return Cow::Borrowed(self);
        }
        let (field, more) = self.knots.split_at(FIELD_TERMS[order] * count);
        let mut knots = field.to_vec();
        let values = conditions.into_iter().zip(self.terms.by).filter(|(_, by)| *by).map(|(value, _)| value);
        for (value, grid) in values.zip(more.chunks_exact(count)) {
            add_scaled(&mut knots[..count], value, grid);
        }
        Cow::Owned(Self { terms: Terms { order, by: [false; 2] }, knots, ..self.clone() })
    }

    /// Distance of the knots of its grid, px.
    #[must_use]
    pub fn step_px(&self) -> f64 {
        self.grid.step_px
    }

    /// Whether it changes with the stars' colour, and with the frames' temperature.
    #[must_use]
    pub const fn changes_with(&self) -> [bool; 2] {
        self.terms.by
    }

    /// Order of the polynomial by which it changes over the frame: 0 where it is the same everywhere.
    #[must_use]
    pub fn field_order(&self) -> usize {
        self.terms.order
    }
}

/// Which image stars are fitted with, and why.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct PsfReport {
    /// Whether the empirical image is used; else the Gaussian.
    pub empirical: bool,
    /// Stars from which it was learnt.
    pub stars: usize,
    /// Stars held out, by which it was judged.
    pub held_out_stars: usize,
    /// Deviance over degrees of freedom of the held-out stars under Gaussians of free shape: χ² of weights that no model chooses for itself.
    pub gaussian_deviance_per_dof: f64,
    /// The same under the empirical image learnt from the other stars.
    pub empirical_deviance_per_dof: f64,
    /// Order of the polynomial by which it changes over the frame.
    pub field_order: usize,
}

impl PsfReport {
    /// What was decided, in a sentence.
    #[must_use]
    pub fn sentence(&self) -> String {
        let (stars, held) = (self.stars, self.held_out_stars);
        if held == 0 {
            return format!("the stars are fitted with Gaussians: {stars} clean stars are too few to tell their image");
        }
        let chi2 = format!(
            "deviance per degree of freedom of {held} held-out stars: {:.3} under Gaussians, {:.3} under the image learnt from the others",
            self.gaussian_deviance_per_dof, self.empirical_deviance_per_dof
        );
        match (self.empirical, self.field_order) {
            (false, _) => format!("the stars are fitted with Gaussians; {chi2}"),
            (true, 0) => format!("the stars are fitted with the image that {stars} of them show, the same all over the frame; {chi2}"),
            (true, order) => format!(
                "the stars are fitted with the image that {stars} of them show, changing over the frame as a polynomial of order {order}; {chi2}"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WINDOW: Window = Window { x0: 10, y0: 20, columns: 9, rows: 11 };

    fn some_knots(grid: Grid) -> Vec<f64> {
        (0..grid.knots()).map(|k| ((k * 7919) % 101) as f64 / 100.0 - 0.5).collect()
    }

    #[test]
    fn derivatives_are_those_of_the_values() {
        let grid = Grid::for_image(0.7, 4);
        let knots = some_knots(grid);
        let draw = |x: f64, y: f64| {
            let (mut value, mut derivatives) = (vec![0.0; 99], vec![[0.0; PROFILE_PARAMETERS]; 99]);
            grid.add(&knots, WINDOW, [x, y], &mut value, &mut derivatives);
            (value, derivatives)
        };
        let h = 1e-6;
        let (x, y) = (13.6, 25.4);
        let (_, d) = draw(x, y);
        for (k, (up, down)) in [(draw(x + h, y), draw(x - h, y)), (draw(x, y + h), draw(x, y - h))].into_iter().enumerate() {
            for (derivative, (up, down)) in d.iter().zip(up.0.iter().zip(&down.0)) {
                let numeric = (up - down) / (2.0 * h);
                assert!((numeric - derivative[k]).abs() < 1e-7, "axis {k}: {numeric} {}", derivative[k]);
            }
        }
    }

    #[test]
    fn the_ways_to_draw_agree_and_back_is_the_transpose() {
        let grid = Grid::for_image(1.1, 5);
        let knots = some_knots(grid);
        let centre = [14.2, 24.7];
        let (mut value, mut derivatives) = (vec![0.0; 99], vec![[0.0; PROFILE_PARAMETERS]; 99]);
        grid.add(&knots, WINDOW, centre, &mut value, &mut derivatives);
        let lines = grid.lines(WINDOW, centre);
        let mut forward = vec![0.0; 99];
        light_of_knots(&knots, &lines, 2.0, &mut forward);
        assert!(value.iter().zip(&forward).all(|(a, b)| (2.0 * a - b).abs() < 1e-12));
        let pixels: Vec<f64> = (0..99).map(|i| f64::from(i % 13) - 6.0).collect();
        let mut back = vec![0.0; grid.knots()];
        knots_of_light(&pixels, &lines, 2.0, &mut back);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        assert!((dot(&pixels, &forward) - dot(&back, &knots)).abs() < 1e-9);
    }
}

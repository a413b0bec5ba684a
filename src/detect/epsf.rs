//! Effective point-spread function (ePSF) of a recording, learned from its own stars.
//!
//! As in Anderson & King 2000 (PASP 112, 1360) it is sampled on a grid finer than the pixels, with a smooth interpolant. Unlike theirs it is the
//! light before integration over the pixels, and only its difference from the typical Gaussian, as a sum of narrower Gaussians on the grid, each
//! integrated over every pixel. A Gaussian camera loses nothing by that, and images that no optics make are excluded: without this bound any
//! displacement that depends on the pixel phase could be absorbed by the ePSF, since each star's position is free. The difference may change over
//! the frame as a polynomial of the position.

use schemars::JsonSchema;
use serde::Serialize;

use super::image_model::{PROFILE_PARAMETERS, Shape, Window, axis_shares};

/// Terms of the field polynomial of each order: 1; x, y; x², xy, y²; x³, x²y, xy², y³.
pub(super) const FIELD_TERMS: [usize; 4] = [1, 3, 6, 10];
/// Width of the narrow Gaussians over that of the image.
const NARROW: f64 = 0.7;
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

/// What the pixels along one axis get of the Gaussians of each knot, and the derivatives by the star's place: knot after knot.
pub(super) struct Lines {
    length: usize,
    value: Vec<f64>,
    slope: Vec<f64>,
}

impl Lines {
    fn value(&self, knot: usize) -> &[f64] {
        &self.value[knot * self.length..(knot + 1) * self.length]
    }

    fn slope(&self, knot: usize) -> &[f64] {
        &self.slope[knot * self.length..(knot + 1) * self.length]
    }

    /// The same with the squares of the values.
    pub(super) fn squared(&self) -> Self {
        Self { length: self.length, value: self.value.iter().map(|v| v * v).collect(), slope: Vec::new() }
    }
}

fn add_scaled(target: &mut [f64], factor: f64, source: &[f64]) {
    for (t, s) in target.iter_mut().zip(source) {
        *t += factor * s;
    }
}

impl Grid {
    /// For an image of this width in windows of this half side.
    pub(super) fn for_image(sigma_px: f64, radius: usize) -> Self {
        let narrow_px = NARROW * sigma_px;
        let step_px = SPACING * narrow_px;
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
        let (mut value, mut slope) = (Vec::with_capacity(self.side * length), Vec::with_capacity(self.side * length));
        for knot in 0..self.side {
            for [share, by_centre, _] in axis_shares(start, length, centre + self.along_px(knot), self.narrow_px) {
                value.push(share);
                slope.push(by_centre);
            }
        }
        Lines { length, value, slope }
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
        let (mut light, mut slope) = (vec![0.0; window.columns], vec![0.0; window.columns]);
        for (ky, row_of_knots) in knots.chunks_exact(self.side).enumerate() {
            light.fill(0.0);
            slope.fill(0.0);
            for (kx, knot) in row_of_knots.iter().enumerate() {
                add_scaled(&mut light, *knot, across.value(kx));
                add_scaled(&mut slope, *knot, across.slope(kx));
            }
            let rows = value.chunks_exact_mut(window.columns).zip(derivatives.chunks_exact_mut(window.columns));
            for ((v, d), (share, by_y)) in rows.zip(down.value(ky).iter().zip(down.slope(ky))) {
                for (x, (v, d)) in v.iter_mut().zip(d).enumerate() {
                    *v += share * light[x];
                    d[0] += share * slope[x];
                    d[1] += by_y * light[x];
                }
            }
        }
    }

    /// Adds the correction times `factor` to the values alone.
    pub(super) fn forward(self, knots: &[f64], [across, down]: &[Lines; 2], factor: f64, value: &mut [f64]) {
        let mut light = vec![0.0; across.length];
        for (ky, row_of_knots) in knots.chunks_exact(self.side).enumerate() {
            light.fill(0.0);
            for (kx, knot) in row_of_knots.iter().enumerate() {
                add_scaled(&mut light, factor * knot, across.value(kx));
            }
            for (v, share) in value.chunks_exact_mut(across.length).zip(down.value(ky)) {
                add_scaled(v, *share, &light);
            }
        }
    }

    /// The transpose of [`Self::forward`]: what each knot gets of the pixels, times `factor`.
    pub(super) fn back(self, value: &[f64], [across, down]: &[Lines; 2], factor: f64, knots: &mut [f64]) {
        let mut light = vec![0.0; across.length];
        for (ky, row_of_knots) in knots.chunks_exact_mut(self.side).enumerate() {
            light.fill(0.0);
            for (v, share) in value.chunks_exact(across.length).zip(down.value(ky)) {
                add_scaled(&mut light, factor * share, v);
            }
            for (kx, knot) in row_of_knots.iter_mut().enumerate() {
                *knot = across.value(kx).iter().zip(&light).map(|(a, l)| a * l).sum();
            }
        }
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
    /// The correction's knots (share of the flux), one grid for each term of the field polynomial, one after the other.
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
        let terms = field_terms(self.size_px, at_px);
        let mut local = vec![0.0; self.grid.knots()];
        for (term, grid) in terms.iter().zip(self.knots.chunks_exact(self.grid.knots())) {
            for (sum, knot) in local.iter_mut().zip(grid) {
                *sum += term * knot;
            }
        }
        local
    }

    /// Distance of the knots of its grid, px.
    #[must_use]
    pub fn step_px(&self) -> f64 {
        self.grid.step_px
    }

    /// Order of the polynomial by which it changes over the frame: 0 where it is the same everywhere.
    #[must_use]
    pub fn field_order(&self) -> usize {
        FIELD_TERMS.iter().position(|n| n * self.grid.knots() == self.knots.len()).unwrap_or(0)
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
    /// χ² over degrees of freedom of the held-out stars under Gaussians of free width.
    pub gaussian_chi2_per_dof: f64,
    /// The same under the empirical image learnt from the other stars.
    pub empirical_chi2_per_dof: f64,
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
            "χ² per degree of freedom of {held} held-out stars: {:.3} under Gaussians, {:.3} under the image learnt from the others",
            self.gaussian_chi2_per_dof, self.empirical_chi2_per_dof
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
        grid.forward(&knots, &lines, 2.0, &mut forward);
        assert!(value.iter().zip(&forward).all(|(a, b)| (2.0 * a - b).abs() < 1e-12));
        let pixels: Vec<f64> = (0..99).map(|i| f64::from(i % 13) - 6.0).collect();
        let mut back = vec![0.0; grid.knots()];
        grid.back(&pixels, &lines, 2.0, &mut back);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        assert!((dot(&pixels, &forward) - dot(&back, &knots)).abs() < 1e-9);
    }
}

//! The image of a star in its pixels, drawn by the model that it has: a Gaussian, a trail, or the empirical image.

use super::epsf::EmpiricalPsf;
use super::gaussian::{Elliptic, Round};
use super::image_model::{ImageModel, Model, PROFILE_PARAMETERS, Shape, Window};
use super::trail::Trail;
use super::work::Work;

/// Share of the flux in every pixel of a window, and derivatives: `value`, then by x, y and the shape's numbers.
pub(super) struct Profile<'a> {
    pub(super) value: Vec<f64>,
    pub(super) derivatives: Vec<[f64; PROFILE_PARAMETERS]>,
    psf: Option<&'a EmpiricalPsf>,
    /// The correction of the empirical image as it is in the window last drawn.
    local: Option<((usize, usize), Vec<f64>)>,
    /// Where what it draws is counted.
    work: Option<&'a Work>,
}

impl<'a> Profile<'a> {
    pub(super) fn new() -> Self {
        Self::of(None)
    }

    /// One that can draw the empirical image too.
    pub(super) fn of(psf: Option<&'a EmpiricalPsf>) -> Self {
        Self { value: Vec::new(), derivatives: Vec::new(), psf, local: None, work: None }
    }

    /// An empty one that draws the same images.
    pub(super) fn like(&self) -> Self {
        Self { local: self.local.clone(), work: self.work, ..Self::of(self.psf) }
    }

    /// The same, counted.
    pub(super) fn counted(self, work: &'a Work) -> Self {
        Self { work: Some(work), ..self }
    }

    /// So much was done with what was drawn.
    pub(super) fn spend(&self, ns: u64) {
        if let Some(work) = self.work {
            work.spend(ns);
        }
    }

    /// Fills in the image of a star; `elliptical` asks for all derivatives by the shape, even of a round one.
    pub(super) fn draw(&mut self, window: Window, model: &Model, elliptical: bool) {
        let Some(psf) = self.psf.filter(|_| model.empirical) else {
            self.fill(window, model.x, model.y, model.shape, elliptical || !model.shape.is_round());
            return;
        };
        self.fill(window, model.x, model.y, psf.base, !psf.base.is_round());
        let at = (window.x0 + window.columns / 2, window.y0 + window.rows / 2);
        let local = match self.local.take() {
            Some((place, local)) if place == at => local,
            _ => psf.correction_at([at.0 as f64, at.1 as f64]),
        };
        psf.grid.add(&local, window, [model.x, model.y], &mut self.value, &mut self.derivatives);
        self.local = Some((at, local));
    }

    /// Derivatives of a pixel's counts by flux, background, x, y and the shape's numbers.
    pub(super) fn row(&self, pixel: usize, flux: f64) -> [f64; 2 + PROFILE_PARAMETERS] {
        let d = &self.derivatives[pixel];
        [self.value[pixel], 1.0, flux * d[0], flux * d[1], flux * d[2], flux * d[3], flux * d[4]]
    }

    /// Fills in the profile of a star at (`x`, `y`).
    pub(super) fn fill(&mut self, window: Window, x: f64, y: f64, shape: Shape, elliptical: bool) {
        if shape.trail {
            self.put(window, [x, y], &Trail::of(shape));
        } else if elliptical {
            self.put(window, [x, y], &Elliptic(shape));
        } else {
            self.put(window, [x, y], &Round { sigma_px: shape.sigma_px() });
        }
    }

    fn put(&mut self, window: Window, centre_px: [f64; 2], model: &impl ImageModel) {
        let pixels = window.columns * window.rows;
        self.value.clear();
        self.value.resize(pixels, 0.0);
        self.derivatives.clear();
        self.derivatives.resize(pixels, [0.0; PROFILE_PARAMETERS]);
        self.spend(model.cost_ns(pixels));
        model.fill(window, centre_px, &mut self.value, &mut self.derivatives);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WINDOW: Window = Window { x0: 10, y0: 20, columns: 31, rows: 31 };

    fn profile(x: f64, y: f64, shape: Shape, elliptical: bool) -> Profile<'static> {
        let mut p = Profile::new();
        p.fill(WINDOW, x, y, shape, elliptical);
        p
    }

    #[test]
    fn the_two_ways_agree_and_hold_all_flux() {
        for (sigma, tolerance) in [(0.5, 3e-4), (0.7, 1e-5), (1.1, 2e-5), (2.0, 1e-6)] {
            let shape = Shape::round(sigma);
            let (r, e) = (profile(25.3, 34.9, shape, false), profile(25.3, 34.9, shape, true));
            let difference = r.value.iter().zip(&e.value).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(difference < tolerance, "σ {sigma}: {difference}");
            assert!((r.value.iter().sum::<f64>() - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn derivatives_are_those_of_the_values() {
        let base = Shape::ellipse(2.0, 0.6, 1.2);
        let h = 1e-5;
        let moved = |k: usize, h: f64| {
            let mut s = base;
            match k {
                2 => s.xx += h,
                3 => s.xy += h,
                4 => s.yy += h,
                _ => {}
            }
            profile(25.3 + if k == 0 { h } else { 0.0 }, 34.9 + if k == 1 { h } else { 0.0 }, s, true)
        };
        let at = profile(25.3, 34.9, base, true);
        for k in 0..5 {
            let (up, down) = (moved(k, h), moved(k, -h));
            for i in 0..at.value.len() {
                let numeric = (up.value[i] - down.value[i]) / (2.0 * h);
                assert!((numeric - at.derivatives[i][k]).abs() < 1e-7, "{k} {i}: {numeric} {}", at.derivatives[i][k]);
            }
        }
        let at = profile(25.3, 34.9, Shape::round(0.8), false);
        let (up, down) = (profile(25.3, 34.9, Shape::round(0.8 + h), false), profile(25.3, 34.9, Shape::round(0.8 - h), false));
        for i in 0..at.value.len() {
            assert!(((up.value[i] - down.value[i]) / (2.0 * h) - at.derivatives[i][2]).abs() < 1e-8);
        }
    }

    #[test]
    fn axes_of_a_turned_ellipse() {
        let s = Shape::ellipse(5.0, 4.0, 5.0);
        let (long, short) = s.axes_px();
        assert!((long - 3.0).abs() < 1e-12 && (short - 1.0).abs() < 1e-12);
    }
}

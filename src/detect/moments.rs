//! Shape of every star image by adaptive moments, with their standard errors.
//!
//! Bernstein & Jarvis 2002 (AJ 123, 583), section 3, and Hirata & Seljak 2003 (MNRAS 343, 459), section 2: the elliptical Gaussian that, taken as
//! the weight too, leaves no light, no shift and no second moment of what it does not explain: Σ w (I − G) {1, d, d dᵀ} = 0. The weight keeps
//! the sums finite under noise; for a Gaussian image the matrix is the image's own. Here G is what the pixels make of it, by the series of
//! cumulants of a square pixel (−1/120 px⁴ of fourth, 1/252 px⁶ of sixth order along each axis), so neither the pixel's own variance of 1/12 px²
//! nor the phase in the pixel is left in the result, down to images of σ 0.5 px.
//!
//! Faint stars do not determine a weight of their own, and a weight that follows noise is biased: theirs is the image as fitted, and the moments
//! come of one step from there, which is linear in the counts. Errors are propagated from the noise of every pixel, that of the
//! background's offset in it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::fit::{Fit, Freedom, MAX_PARAMETERS};
use super::image_model::{Model, PIXEL_VARIANCE};
use super::psf::Profile;
use super::stamp::{MAX_DROPS, Photons, Scene, Stamp};
use crate::statistics::cholesky::{inverse, solve};

/// Moments of a star's image before the pixels sum it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Moments {
    /// Second central moments xx, xy, yy under the adaptive weight: of a Gaussian image its own matrix, σ² along each axis. Those of the
    /// counts are larger by the pixel's 1/12 px² in xx and yy. A faint star's may be no ellipse: noise has no sign.
    pub second_px2: [f64; 3],
    /// Their standard errors.
    pub second_sigma_px2: [f64; 3],
    /// Skewness along x and y, ⟨u |u|²⟩ of the image in units of its own width (u = M^(−½) d), to first order under the same weight: what coma
    /// and trails of uneven light make. 0 for every image that is its own mirror image in its centre.
    pub skewness: [f64; 2],
    /// Their standard errors.
    pub skewness_sigma: [f64; 2],
}

impl Moments {
    /// σ of the round Gaussian of the same area; `None` where noise made no ellipse of the moments.
    #[must_use]
    pub fn width_px(&self) -> Option<f64> {
        let [xx, xy, yy] = self.second_px2;
        let determinant = xx * yy - xy * xy;
        (determinant > 0.0 && xx > 0.0).then(|| determinant.sqrt().sqrt())
    }

    /// Ellipticity ((xx − yy) / (xx + yy), 2 xy / (xx + yy)): 0 of a round image, 1 in length of a line. `None` as above.
    #[must_use]
    pub fn ellipticity(&self) -> Option<[f64; 2]> {
        let [xx, xy, yy] = self.second_px2;
        self.width_px().map(|_| [(xx - yy) / (xx + yy), 2.0 * xy / (xx + yy)])
    }

    /// The same with all errors larger by a factor.
    pub(super) fn with_errors_times(self, factor: f64) -> Self {
        Self {
            second_sigma_px2: self.second_sigma_px2.map(|s| s * factor),
            skewness_sigma: self.skewness_sigma.map(|s| s * factor),
            ..self
        }
    }
}

/// Fourth and sixth cumulants of the box over 4! and 6!.
const BOX: [f64; 2] = [-1.0 / 2880.0, 1.0 / 181_440.0];
/// Stars from this signal-to-noise ratio on have a weight of their own: its noise then biases moments by less than a tenth of their error.
pub(super) const SNR_TO_ADAPT: f64 = 25.0;
const MAX_STEPS: usize = 25;
/// Steps smaller than this, in units of the width, leave nothing after the next, which is the last.
const SETTLED: f64 = 1e-3;
/// What a step may change the matrix by, at most, along its axes.
const MAX_CHANGE: (f64, f64) = (-0.5, 1.0);
/// Flux, shift, matrix.
const UNKNOWNS: usize = 6;
type Square = [[f64; 7]; 7];

/// A Gaussian as it stands in the counts, the pixel's variance in its matrix.
#[derive(Clone, Copy)]
struct Image {
    flux_dn: f64,
    centre_px: [f64; 2],
    /// xx, xy, yy.
    matrix_px2: [f64; 3],
}

/// A pixel under an image: weight, counts of the image, place in the image's widths, and what the image does not explain.
struct Pixel {
    index: usize,
    weight: f64,
    light_dn: f64,
    at: [f64; 2],
    rest_dn: f64,
}

impl Pixel {
    /// What flux, shift and matrix change the image by, over the image.
    fn forms(&self) -> [f64; UNKNOWNS] {
        let [u, v] = self.at;
        [1.0, u, v, u * u - 1.0, u * v, v * v - 1.0]
    }

    /// What the skewness along an axis is summed with.
    fn skew(&self, axis: usize) -> f64 {
        let [u, v] = self.at;
        self.weight * self.at[axis] * (u * u + v * v - 2.0)
    }
}

impl Image {
    /// Lower Cholesky factor of the matrix: (0, 0), (1, 0), (1, 1).
    fn factor(&self) -> Option<[f64; 3]> {
        let [xx, xy, yy] = self.matrix_px2;
        let first = (xx > 0.0).then(|| xx.sqrt())?;
        let cross = xy / first;
        let rest = yy - cross * cross;
        (rest > 1e-6 * xx).then(|| [first, cross, rest.sqrt()])
    }

    fn look(&self, stamp: &Stamp, offset_dn: f64, [a, b, c]: [f64; 3], pixels: &mut Vec<Pixel>) {
        let [xx, xy, yy] = self.matrix_px2;
        let determinant = xx * yy - xy * xy;
        let own = [yy / determinant, -xy / determinant, xx / determinant];
        let top = self.flux_dn / (2.0 * std::f64::consts::PI * determinant.sqrt());
        // a box's share of the image's shape, from its fourth and sixth derivatives along an axis
        let boxed = |slope: f64, curve: f64| {
            let s = slope * slope;
            BOX[0] * (s * (s - 6.0 * curve) + 3.0 * curve * curve)
                + BOX[1] * (s * (s * (s - 15.0 * curve) + 45.0 * curve * curve) - 15.0 * curve.powi(3))
        };
        pixels.clear();
        for index in (0..stamp.data.len()).filter(|i| stamp.used[*i]) {
            let dx = (stamp.window.x0 + index % stamp.window.columns) as f64 - self.centre_px[0];
            let dy = (stamp.window.y0 + index / stamp.window.columns) as f64 - self.centre_px[1];
            let u = dx / a;
            let v = (dy - b * u) / c;
            let weight = (-0.5 * (u * u + v * v)).exp();
            let shape = 1.0 + boxed(own[0] * dx + own[1] * dy, own[0]) + boxed(own[1] * dx + own[2] * dy, own[2]);
            let light_dn = top * weight * shape;
            pixels.push(Pixel { index, weight, light_dn, at: [u, v], rest_dn: stamp.data[index] - offset_dn - light_dn });
        }
    }

    /// The image a step further, its matrix changed by no more than it may.
    fn advanced(&self, [a, b, c]: [f64; 3], step: &[f64; UNKNOWNS]) -> Self {
        let (xx, xy, yy) = (2.0 * step[3], step[4], 2.0 * step[5]);
        let (mean, half) = (f64::midpoint(xx, yy), ((xx - yy) / 2.0).hypot(xy));
        let (low, high) = (mean - half, mean + half);
        let share = 1.0_f64.min(MAX_CHANGE.0 / low.min(-1e-9)).min(MAX_CHANGE.1 / high.max(1e-9));
        let shift = [step[1], step[2]].map(|s| s.clamp(-1.0, 1.0));
        Self {
            flux_dn: self.flux_dn * (1.0 + step[0].clamp(-0.5, 1.0)),
            centre_px: [self.centre_px[0] + a * shift[0], self.centre_px[1] + b * shift[0] + c * shift[1]],
            matrix_px2: added(self.matrix_px2, [a, b, c], [share * xx, share * xy, share * yy]),
        }
    }
}

/// A matrix and a change of it in the axes of its factor: M + L E Lᵀ.
fn added(matrix: [f64; 3], [a, b, c]: [f64; 3], [xx, xy, yy]: [f64; 3]) -> [f64; 3] {
    [matrix[0] + a * a * xx, matrix[1] + a * (b * xx + c * xy), matrix[2] + b * b * xx + 2.0 * b * c * xy + c * c * yy]
}

/// Normal equations of the weighted moments: Σ w I φ φᵀ and Σ w (rest) φ.
fn equations(pixels: &[Pixel]) -> (Square, [f64; UNKNOWNS]) {
    let (mut matrix, mut vector) = (Square::default(), [0.0; UNKNOWNS]);
    for pixel in pixels {
        let forms = pixel.forms();
        let (light, rest) = (pixel.weight * pixel.light_dn, pixel.weight * pixel.rest_dn);
        for (i, form) in forms.iter().enumerate() {
            vector[i] += rest * form;
            for (cell, other) in matrix[i][..=i].iter_mut().zip(&forms) {
                *cell += light * form * other;
            }
        }
    }
    (matrix, vector)
}

fn times(matrix: &Square, vector: &[f64; UNKNOWNS]) -> [f64; UNKNOWNS] {
    std::array::from_fn(|i| (0..UNKNOWNS).map(|j| matrix[i][j] * vector[j]).sum())
}

impl Scene<'_> {
    /// Moments of a fitted star, of the pixels that the fit used.
    pub(super) fn moments(&self, fit: &Fit, neighbours: &[Model]) -> Option<Moments> {
        let mut profile = self.profile();
        let mut stamp = self.stamp(fit.model, neighbours, &mut profile);
        self.photons().drop_all_outliers(&mut stamp, &(fit.model, fit.offset_dn), &mut profile);
        profile.draw(stamp.window, &fit.model, fit.freedom == Freedom::Ellipse);
        let count = fit.freedom.parameters();
        let normal = self.photons().normal(&stamp, &profile, fit.model.flux_dn, fit.offset_dn, count);
        let mut of_offset = [0.0; MAX_PARAMETERS];
        of_offset[1] = 1.0;
        let row = solve(&normal.matrix, &of_offset, count, 0.0)?;
        let told = self.photons().told(&stamp, &profile, fit.model.flux_dn, &row[..count]);
        moments(&stamp, fit, &told, self.photons())
    }
}

impl Photons {
    fn drop_all_outliers(self, stamp: &mut Stamp, fit: &(Model, f64), profile: &mut Profile<'_>) {
        for _ in 0..MAX_DROPS {
            if !self.drop_outliers(stamp, fit, profile) {
                break;
            }
        }
    }

    /// What the count of each pixel adds to a fitted number; `row` is that number's row of the covariance.
    fn told(self, stamp: &Stamp, profile: &Profile<'_>, flux: f64, row: &[f64]) -> Vec<f64> {
        let of = |i: usize| {
            let weight = 1.0 / (stamp.variance[i] + (flux * profile.value[i]).max(0.0) * self.variance_per_dn);
            weight * row.iter().zip(profile.row(i, flux)).map(|(c, r)| c * r).sum::<f64>()
        };
        (0..stamp.data.len()).map(|i| if stamp.used[i] { of(i) } else { 0.0 }).collect()
    }
}

/// The moments of a star that was fitted, of the pixels that the fit used. `told`: what each pixel's count adds to the fitted offset.
fn moments(stamp: &Stamp, fit: &Fit, told: &[f64], photons: Photons) -> Option<Moments> {
    let (model, shape, offset_dn) = (fit.model, fit.model.shape, fit.offset_dn);
    let adapt = model.flux_dn > SNR_TO_ADAPT * fit.flux_sigma_dn;
    let first = Image {
        flux_dn: model.flux_dn,
        centre_px: [model.x, model.y],
        matrix_px2: [shape.xx + PIXEL_VARIANCE, shape.xy, shape.yy + PIXEL_VARIANCE],
    };
    let mut pixels = Vec::with_capacity(stamp.data.len());
    let own = if adapt { settled(first, stamp, offset_dn, &mut pixels) } else { None };
    // the Gaussian of a trail as fitted: its second moments are not those under a weight
    let of_trail = || shape.trail.then(|| settled(first, &drawn(stamp, fit), 0.0, &mut Vec::new())).flatten();
    let image = own.or_else(of_trail).unwrap_or(first);
    let factor = image.factor()?;
    image.look(stamp, offset_dn, factor, &mut pixels);
    tell(&image, factor, &pixels, stamp, told, photons)
}

/// The stamp of a star as fitted, without noise.
fn drawn(stamp: &Stamp, fit: &Fit) -> Stamp {
    let (model, mut profile, mut stamp) = (fit.model, Profile::new(), stamp.clone());
    profile.fill(stamp.window, model.x, model.y, model.shape, true);
    stamp.data = profile.value.iter().map(|share| model.flux_dn * share).collect();
    stamp
}

/// The image that leaves no moments; `None` if it runs away.
fn settled(first: Image, stamp: &Stamp, offset_dn: f64, pixels: &mut Vec<Pixel>) -> Option<Image> {
    let reach_px = 1.5 + first.matrix_px2[0].max(first.matrix_px2[2]).sqrt();
    let widest_px2 = (stamp.window.columns.max(stamp.window.rows) as f64 / 2.0).powi(2);
    let mut image = first;
    for _ in 0..MAX_STEPS {
        let factor = image.factor()?;
        image.look(stamp, offset_dn, factor, pixels);
        let (matrix, vector) = equations(pixels);
        let step = times(&inverse(&matrix, UNKNOWNS)?, &vector);
        image = image.advanced(factor, &step);
        let far = (image.centre_px[0] - first.centre_px[0]).hypot(image.centre_px[1] - first.centre_px[1]);
        if far > reach_px || image.matrix_px2[0].max(image.matrix_px2[2]) > widest_px2 {
            return None;
        }
        if step.iter().all(|s| s.abs() < SETTLED) {
            return Some(image);
        }
    }
    None
}

/// The last step, and how the noise of each pixel goes into what it tells.
fn tell(image: &Image, factor: [f64; 3], pixels: &[Pixel], stamp: &Stamp, told: &[f64], photons: Photons) -> Option<Moments> {
    let (matrix, vector) = equations(pixels);
    let inverse = inverse(&matrix, UNKNOWNS)?;
    let step = times(&inverse, &vector);
    let second = added(image.matrix_px2, factor, [2.0 * step[3], step[4], 2.0 * step[5]]);
    // skewness, what the step explains taken off: its sum over the image as changed by each unknown
    let norm = 16.0 / image.flux_dn;
    let mut leak = [[0.0; UNKNOWNS]; 2];
    let mut sum_of_forms = [0.0; UNKNOWNS];
    let (mut sum_of_skew, mut skew) = ([0.0; 2], [0.0; 2]);
    for pixel in pixels {
        let forms = pixel.forms();
        for (sum, form) in sum_of_forms.iter_mut().zip(&forms) {
            *sum += pixel.weight * form;
        }
        for axis in 0..2 {
            let s = norm * pixel.skew(axis);
            sum_of_skew[axis] += s;
            skew[axis] += s * pixel.rest_dn;
            for (l, form) in leak[axis].iter_mut().zip(&forms) {
                *l += s * pixel.light_dn * form;
            }
        }
    }
    // rows that make numbers of Σ w (counts) φ: xx, xy, yy; what goes off the skewness
    let by_form = |row: [f64; UNKNOWNS]| times(&inverse, &row);
    let unit = |k: usize| -> [f64; 3] {
        let of = |at: usize, value: f64| if k == at { value } else { 0.0 };
        added([0.0; 3], factor, [of(3, 2.0), of(4, 1.0), of(5, 2.0)])
    };
    let rows: [[f64; UNKNOWNS]; 3] = std::array::from_fn(|i| by_form(std::array::from_fn(|k| unit(k)[i])));
    let off: [[f64; UNKNOWNS]; 2] = leak.map(by_form);
    for (skew, leak) in skew.iter_mut().zip(&leak) {
        *skew -= leak.iter().zip(&step).map(|(l, s)| l * s).sum::<f64>();
    }
    let dot = |a: &[f64; UNKNOWNS], b: &[f64; UNKNOWNS]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let by_offset: [f64; 3] = std::array::from_fn(|i| dot(&rows[i], &sum_of_forms));
    let skew_by_offset: [f64; 2] = std::array::from_fn(|axis| sum_of_skew[axis] - dot(&off[axis], &sum_of_forms));
    let turn = turn(image.matrix_px2, factor);
    let (mut second_variance, mut skew_variance) = ([0.0; 3], [0.0; 2]);
    for pixel in pixels {
        let forms = pixel.forms();
        let variance = stamp.variance[pixel.index] + pixel.light_dn.max(0.0) * photons.variance_per_dn;
        let offset = told[pixel.index];
        for i in 0..3 {
            let weight = pixel.weight * dot(&rows[i], &forms) - by_offset[i] * offset;
            second_variance[i] += variance * weight * weight;
        }
        let own: [f64; 2] =
            std::array::from_fn(|axis| norm * pixel.skew(axis) - pixel.weight * dot(&off[axis], &forms) - skew_by_offset[axis] * offset);
        for (sum, row) in skew_variance.iter_mut().zip(&turn) {
            *sum += variance * (row[0] * own[0] + row[1] * own[1]).powi(2);
        }
    }
    let moments = Moments {
        second_px2: [second[0] - PIXEL_VARIANCE, second[1], second[2] - PIXEL_VARIANCE],
        second_sigma_px2: second_variance.map(f64::sqrt),
        skewness: turn.map(|row| row[0] * skew[0] + row[1] * skew[1]),
        skewness_sigma: skew_variance.map(f64::sqrt),
    };
    let all = [moments.second_px2, moments.second_sigma_px2];
    let finite = all.as_flattened().iter().chain(&moments.skewness).chain(&moments.skewness_sigma).all(|v| v.is_finite());
    finite.then_some(moments)
}

/// What turns the factor's axes into those of the frame: M^(−½) L.
fn turn([xx, xy, yy]: [f64; 3], [a, b, c]: [f64; 3]) -> [[f64; 2]; 2] {
    // √M = (M + √|M|) / √(tr M + 2 √|M|), and its inverse
    let root = (xx * yy - xy * xy).sqrt();
    let scale = 1.0 / (root * (xx + yy + 2.0 * root).sqrt());
    let inverse = [scale * (yy + root), -scale * xy, scale * (xx + root)];
    [[inverse[0] * a + inverse[1] * b, inverse[1] * c], [inverse[1] * a + inverse[2] * b, inverse[2] * c]]
}

//! Light and shape of star images by sums under one weight, the same for all stars of a frame.
//!
//! A fit of a model that is not quite the image gives faint stars another share of their light than bright ones, since the noise that it weighs with
//! goes with the light. Here every number is a ratio of sums that are linear in the counts, under a weight and a background ring that know nothing
//! of the star's brightness: two stars with the same image have the same shape and the same share of light, whatever the image is. What
//! remains is how the pixels cut the image, which goes with the place in the pixel.
//!
//! With a Gaussian weight of matrix W the product with a Gaussian image of matrix C has the matrix (C⁻¹ + W⁻¹)⁻¹ and the light √(|W| / |W + C|)
//! (Bernstein & Jarvis 2002, AJ 123, 583, section 3; windowed parameters of SExtractor, Bertin & Arnouts 1996, A&AS 117, 393). Standard errors are
//! propagated from the noise of every pixel.

use super::sky_frame::StarDisc;
use super::star_neighbours::{MeanImage, Neighbours};
use crate::frame::Frame;

/// Variance of a pixel along an axis, px².
const PIXEL_VARIANCE: f64 = 1.0 / 12.0;
/// A narrower weight sees the places of the pixels more than the image.
const MIN_WEIGHT_PX: f64 = 0.75;
/// The weight of the shape is wider than the image by this. Of faint stars a weight as wide as the image tells most, of bright ones, whose own light is
/// their noise, a wider one. The test `shapes_are_known_nearly_as_well_as_pixels_allow` compares with the Fisher matrix of the pixels.
const WIDER_FOR_SHAPE: f64 = 1.2;
/// The light is summed under a wider weight, by this: the less of it the weight leaves out, the less goes with the width of the image.
const WIDER: f64 = 1.8;
/// The sums of the shape and of the light reach so far, and so far from the star the ring begins: in σ of the image.
const REACH: f64 = 4.5;
const REACH_OF_LIGHT: f64 = 3.5 * WIDER;
const RING: f64 = REACH_OF_LIGHT + 0.2;
/// A star stands alone where no other is nearer than this, in σ of the image.
const ALONE: f64 = 5.0;
/// Of a star that is nearer than this too little is known to take it off.
const NEAREST: f64 = 2.5;
/// Of the light under its weight so much may be that of other stars.
const MAX_BESIDE: f64 = 0.15;
/// Of the light that may be left of another star a pixel of the ring has no more than this, in standard deviations of the sky.
const MAX_LEFT: f64 = 0.3;
/// So many stars tell the mean image, of so large a signal-to-noise ratio.
const MANY_ALONE: usize = 40;
const MIN_SNR_ALONE: f64 = 30.0;
/// Width of the ring, px, and the pixels that it has at least.
const RING_PX: f64 = 4.0;
const MIN_RING: usize = 40;
/// Steps to the centre.
const STEPS: usize = 6;
/// Eigenvalues of the matrix under the weight, in units of the weight's (½ of an image as wide as the weight).
const NARROWEST: f64 = 0.05;
const WIDEST: f64 = 0.9;
/// The centre is no farther from where the star was found, in σ of the image.
const FARTHEST: f64 = 1.0;

/// A variance as far as it is of the sky, DN², and per DN of what a count of light adds to it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SplitVariance {
    /// Of the sky's noise.
    pub sky: f64,
    /// Of the star's light, where one count of light has the variance 1 DN²: times the variance of a count.
    pub light: f64,
}

impl SplitVariance {
    /// The standard error where a count of light has so large a variance (DN: the inverse of the gain).
    #[must_use]
    pub fn sigma(&self, variance_per_dn: f64) -> f64 {
        (self.sky + self.light * variance_per_dn).sqrt()
    }
}

/// A star image as its pixels sum up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SummedImage {
    /// Where the star was found, px.
    pub found_px: [f64; 2],
    /// Centre under the weight, px.
    pub centre_px: [f64; 2],
    /// Light, DN: of a Gaussian image all of it.
    pub flux_dn: f64,
    /// Its variance.
    pub flux_variance: SplitVariance,
    /// All the light within the ring, of whatever image, DN: noisier, and with that of faint neighbours.
    pub within_ring_dn: f64,
    /// Second moments xx, xy, yy of the image before the pixels sum it, px².
    pub second_px2: [f64; 3],
    /// Their variances.
    pub second_variance: [SplitVariance; 3],
    /// Skewness along x and y, as in [`crate::detect::Moments`].
    pub skewness: [f64; 2],
    /// Their variances.
    pub skewness_variance: [SplitVariance; 2],
}

/// A frame whose star images are summed.
#[derive(Clone, Copy, Debug)]
pub struct ImageFrame<'a> {
    /// Its pixels.
    pub frame: &'a Frame,
    /// All stars that were found, with how far their light reaches; the brightest first.
    pub stars: &'a [StarDisc],
    /// Their light and its standard error, DN, by which it is taken off the images of their neighbours; of full ones the error is infinite.
    pub flux_dn: &'a [[f64; 2]],
    /// Pixels that say nothing.
    pub bad: Option<&'a [bool]>,
    /// Typical width (Gaussian σ) of its images, px.
    pub sigma_px: f64,
    /// Noise of a sky pixel, DN.
    pub noise_dn: f64,
}

impl ImageFrame<'_> {
    /// The images of the stars, in their order; nothing where a bad or full pixel, the edge or too much of another star lies in the sums, or the sums are
    /// no image's.
    #[must_use]
    pub fn star_images(&self) -> Vec<Option<SummedImage>> {
        let near = Neighbours::of(self.stars);
        let mean = self.mean_image(&near);
        (0..self.stars.len()).map(|index| self.star_image(index, &near, &mean)).collect()
    }

    /// By the brightest stars that stand alone.
    fn mean_image(&self, near: &Neighbours) -> MeanImage {
        let weight_px = self.weight_px();
        let mut mean = MeanImage::new(weight_px, RING * weight_px);
        let untold = MeanImage::new(weight_px, 0.0);
        let is_bright = |index: &usize| self.flux_dn.get(*index).is_some_and(|[flux, sigma]| *flux > MIN_SNR_ALONE * sigma);
        let is_alone = |index: &usize| !self.has_another(*index, near, ALONE * weight_px);
        for index in (0..self.stars.len()).filter(is_bright).filter(is_alone).take(MANY_ALONE) {
            let at = [self.stars[index].x_px, self.stars[index].y_px];
            let Some((level_dn, _)) = self.ring(index, near, &untold, RING * weight_px) else { continue };
            let usable = self.within(at, RING * weight_px).filter(|(x, y)| self.is_usable(*x, *y));
            let of = |(x, y): (usize, usize)| ((x as f64 - at[0]).hypot(y as f64 - at[1]), f64::from(self.frame.at(x, y)) - level_dn);
            mean.add(self.flux_dn[index][0], usable.map(of));
        }
        mean
    }

    /// Whether another star is so near.
    fn has_another(&self, index: usize, near: &Neighbours, within_px: f64) -> bool {
        let star = &self.stars[index];
        let is_near = |other: usize| (self.stars[other].x_px - star.x_px).hypot(self.stars[other].y_px - star.y_px) < within_px;
        near.of_star(self.stars, index, within_px).into_iter().any(is_near)
    }

    fn weight_px(&self) -> f64 {
        (self.sigma_px * self.sigma_px + PIXEL_VARIANCE).sqrt().max(MIN_WEIGHT_PX)
    }

    fn is_usable(&self, x: usize, y: usize) -> bool {
        let index = y * self.frame.width_px + x;
        self.frame.pixels_dn[index] < self.frame.saturation_dn && self.bad.is_none_or(|bad| !bad[index])
    }

    /// The pixels around a place that are in the frame.
    fn within(&self, [x, y]: [f64; 2], reach_px: f64) -> impl Iterator<Item = (usize, usize)> {
        let span = |at: f64, length: usize| {
            (at - reach_px).ceil().max(0.0) as usize..((at + reach_px).floor() + 1.0).clamp(0.0, length as f64) as usize
        };
        let (columns, rows) = (span(x, self.frame.width_px), span(y, self.frame.height_px));
        rows.flat_map(move |y| columns.clone().map(move |x| (x, y)))
    }

    /// Whether a place is so far from the frame's edge.
    fn is_inside(&self, [x, y]: [f64; 2], margin_px: f64) -> bool {
        [(x, self.frame.width_px), (y, self.frame.height_px)]
            .into_iter()
            .all(|(at, length)| at >= margin_px && at <= length as f64 - 1.0 - margin_px)
    }

    /// The pixels of a star's sums, what other stars add taken off. Nothing where a pixel tells nothing, or of another star too little is known.
    fn pixels(&self, index: usize, level_dn: f64, near: &Neighbours, mean: &MeanImage) -> Option<StarPixels> {
        let weight_px = self.weight_px();
        let found = [self.stars[index].x_px, self.stars[index].y_px];
        if !self.is_inside(found, (REACH + FARTHEST) * weight_px) {
            return None;
        }
        let around = self.within(found, (REACH_OF_LIGHT + FARTHEST) * weight_px);
        let pixel = |(x, y): (usize, usize)| {
            let lit_dn = f64::from(self.frame.at(x, y)) - level_dn;
            self.is_usable(x, y).then_some(Pixel { x: x as f64, y: y as f64, counts: lit_dn, lit_dn })
        };
        let mut pixels = around.map(pixel).collect::<Option<Vec<Pixel>>>()?;
        let mut beside = Vec::new();
        for other in near.of_star(self.stars, index, REACH_OF_LIGHT * weight_px) {
            let [x_px, y_px] = [self.stars[other].x_px, self.stars[other].y_px];
            let [flux_dn, sigma_dn] = self.light_of(other);
            let added: Vec<f64> =
                pixels.iter().map(|own| flux_dn * mean.share((own.x - x_px).hypot(own.y - y_px)).unwrap_or(0.0)).collect();
            let is_near = (x_px - found[0]).hypot(y_px - found[1]) < ALONE * weight_px;
            if is_near && !sigma_dn.is_finite() {
                return None;
            }
            let error = if flux_dn > 0.0 && sigma_dn.is_finite() { (sigma_dn / flux_dn).hypot(mean.error()) } else { 1.0 };
            pixels.iter_mut().zip(&added).for_each(|(own, added)| own.counts -= added);
            beside.push(added.into_iter().map(|added| error * added).collect());
        }
        Some(StarPixels { pixels, beside })
    }

    fn star_image(&self, index: usize, near: &Neighbours, mean: &MeanImage) -> Option<SummedImage> {
        let found = [self.stars[index].x_px, self.stars[index].y_px];
        let weight_px = self.weight_px();
        if self.has_another(index, near, NEAREST * weight_px) {
            return None;
        }
        let (level_dn, ring) = self.ring(index, near, mean, RING * weight_px)?;
        let pixels = self.pixels(index, level_dn, near, mean)?;
        let mut centre = found;
        let shape_px = WIDER_FOR_SHAPE * weight_px;
        let of = |centre: [f64; 2]| Sums::of(&pixels.pixels, Weight { centre, sigma_px: shape_px, reach: REACH / WIDER_FOR_SHAPE });
        let mut sums = of(centre)?;
        for _ in 0..STEPS {
            let step = sums.to_centre();
            centre = [centre[0] + shape_px * step[0], centre[1] + shape_px * step[1]];
            if (centre[0] - found[0]).hypot(centre[1] - found[1]) > FARTHEST * weight_px {
                return None;
            }
            sums = of(centre)?;
        }
        let wide = Sums::of(&pixels.pixels, Weight { centre, sigma_px: WIDER * weight_px, reach: REACH_OF_LIGHT / WIDER })?;
        if wide.share_of_others(&pixels.pixels) > MAX_BESIDE {
            return None;
        }
        let noise = [self.noise_dn * self.noise_dn, ring];
        let (flux_dn, flux_variance) = wide.light(&pixels, noise)?;
        let is_within = |own: &&Pixel| (own.x - centre[0]).hypot(own.y - centre[1]) < REACH_OF_LIGHT * weight_px;
        let within_ring_dn = pixels.pixels.iter().filter(is_within).map(|own| own.counts).sum();
        sums.shape(&pixels, noise).map(|shape| SummedImage {
            found_px: found,
            centre_px: centre,
            flux_dn,
            flux_variance,
            within_ring_dn,
            ..shape
        })
    }

    /// Mean of a ring about a star, what other stars light taken off, or left out where it is much; and its pixels.
    fn ring(&self, index: usize, near: &Neighbours, mean: &MeanImage, from_px: f64) -> Option<(f64, f64)> {
        let star = &self.stars[index];
        let to_px = from_px + RING_PX;
        let others: Vec<(&StarDisc, [f64; 2])> =
            near.of_star(self.stars, index, to_px).into_iter().map(|other| (&self.stars[other], self.light_of(other))).collect();
        let (mut sum, mut count) = (0.0, 0_usize);
        'pixels: for (x, y) in self.within([star.x_px, star.y_px], to_px) {
            let at = [x as f64, y as f64];
            let square_px2 = star.distance_px2(at);
            if square_px2 < from_px * from_px || square_px2 > to_px * to_px || !self.is_usable(x, y) {
                continue;
            }
            let mut counts = f64::from(self.frame.at(x, y));
            for (other, [flux_dn, sigma_dn]) in others.iter().filter(|(other, _)| other.lights(at)) {
                let added_dn = mean.share(other.distance_px2(at).sqrt()).map(|share| flux_dn * share);
                match added_dn.filter(|added| sigma_dn.is_finite() && mean.error() * added < MAX_LEFT * self.noise_dn) {
                    Some(added_dn) => counts -= added_dn,
                    None => continue 'pixels,
                }
            }
            sum += counts;
            count += 1;
        }
        (count >= MIN_RING).then(|| (sum / count as f64, count as f64))
    }

    /// Light and its standard error, DN: infinite where nothing is known.
    fn light_of(&self, index: usize) -> [f64; 2] {
        self.flux_dn.get(index).copied().unwrap_or([0.0, f64::INFINITY])
    }
}

/// A pixel of a star's sums.
struct Pixel {
    x: f64,
    y: f64,
    /// Counts of the star, DN.
    counts: f64,
    /// Counts of all stars, DN: their noise is in it.
    lit_dn: f64,
}

/// The pixels of a star's sums, and of every other star in them how much light of it may be left in each, DN.
struct StarPixels {
    pixels: Vec<Pixel>,
    beside: Vec<Vec<f64>>,
}

/// A round Gaussian weight, and how far it reaches in its σ.
#[derive(Clone, Copy)]
struct Weight {
    centre: [f64; 2],
    sigma_px: f64,
    reach: f64,
}

impl Weight {
    /// Weight of a pixel and its place in σ of the weight, where it counts.
    fn at(&self, x: f64, y: f64) -> Option<(f64, f64, f64)> {
        let (u, v) = ((x - self.centre[0]) / self.sigma_px, (y - self.centre[1]) / self.sigma_px);
        let square = u * u + v * v;
        (square < self.reach * self.reach).then(|| ((-0.5 * square).exp(), u, v))
    }
}

/// Weighted sums about a place, in units of the weight's σ.
struct Sums {
    weight: Weight,
    light: f64,
    first: [f64; 2],
    /// Second moments over the light, xx, xy, yy.
    second: [f64; 3],
}

impl Sums {
    fn of(pixels: &[Pixel], weight: Weight) -> Option<Self> {
        let (mut light, mut first, mut second) = (0.0, [0.0; 2], [0.0; 3]);
        for pixel in pixels {
            let Some((share, u, v)) = weight.at(pixel.x, pixel.y) else { continue };
            let own = share * pixel.counts;
            light += own;
            first = [first[0] + own * u, first[1] + own * v];
            second = [second[0] + own * u * u, second[1] + own * u * v, second[2] + own * v * v];
        }
        (light > 0.0).then(|| Self { weight, light, first: first.map(|sum| sum / light), second: second.map(|sum| sum / light) })
    }

    /// (1 − Q)⁻¹, Q the matrix under the weight; nothing where it is no image's.
    fn spread(&self) -> Option<[f64; 3]> {
        let [xx, xy, yy] = self.second;
        let (mean, half) = (f64::midpoint(xx, yy), (0.5 * (xx - yy)).hypot(xy));
        let [a, b, c] = [1.0 - xx, -xy, 1.0 - yy];
        let determinant = a * c - b * b;
        (mean - half > NARROWEST && mean + half < WIDEST).then(|| [c / determinant, -b / determinant, a / determinant])
    }

    /// Where the centre lies from here, in σ of the weight: the shift under the weight, which is the smaller the narrower the image.
    fn to_centre(&self) -> [f64; 2] {
        let [xx, xy, yy] = self.spread().unwrap_or([2.0, 0.0, 2.0]);
        let [u, v] = self.first;
        // The weight pulls towards its own centre by the share that the image's matrix has in the sum of both.
        [xx * u + xy * v, xy * u + yy * v]
    }

    /// How much of other stars' light was taken off under the weight, over the star's.
    fn share_of_others(&self, pixels: &[Pixel]) -> f64 {
        let taken = |own: &Pixel| self.weight.at(own.x, own.y).map_or(0.0, |(weight, ..)| weight * (own.lit_dn - own.counts));
        pixels.iter().map(taken).sum::<f64>() / self.light
    }

    /// What a count in a pixel adds to the light, over the light, and to the matrix under the weight.
    fn of_count(&self, (x, y): (f64, f64)) -> Option<(f64, [f64; 3], f64, f64)> {
        let (weight, u, v) = self.weight.at(x, y)?;
        let share = weight / self.light;
        let [xx, xy, yy] = self.second;
        Some((share, [share * (u * u - xx), share * (u * v - xy), share * (v * v - yy)], u, v))
    }

    /// All the light, were the image a Gaussian, with its variance. `noise`: variance of a sky pixel, and pixels of the ring.
    fn light(&self, pixels: &StarPixels, noise: [f64; 2]) -> Option<(f64, SplitVariance)> {
        let [a, b, c] = self.spread()?;
        let flux_dn = self.light * (a * c - b * b).sqrt();
        let mut sums = Variances::<1>::beside(pixels.beside.len());
        for (k, own) in pixels.pixels.iter().enumerate() {
            let Some((share, [xx, xy, yy], ..)) = self.of_count((own.x, own.y)) else { continue };
            sums.add(pixels, k, [flux_dn * (share + 0.5 * (a * xx + 2.0 * b * xy + c * yy))]);
        }
        (flux_dn.is_finite() && flux_dn > 0.0).then(|| (flux_dn, sums.of(0, noise)))
    }

    /// Second moments and skewness with their variances.
    fn shape(&self, pixels: &StarPixels, noise: [f64; 2]) -> Option<SummedImage> {
        // Of an image that is as wide as it should be: what its product with the weight leaves of ⟨u |u|²⟩ about its centre, in widths of the weight for the
        // image's own; and what a shift of the centre adds to it.
        let square = WIDER_FOR_SHAPE * WIDER_FOR_SHAPE;
        let skew = ((1.0 + square) * (1.0 + square.recip())).powf(1.5);
        let by_shift = 4.0 / (1.0 + square);
        let [a, b, c] = self.spread()?;
        let area = self.weight.sigma_px * self.weight.sigma_px;
        // Q (1 − Q)⁻¹ = (1 − Q)⁻¹ − 1.
        let second_px2 = [area * (a - 1.0) - PIXEL_VARIANCE, area * b, area * (c - 1.0) - PIXEL_VARIANCE];
        let mut skewness = [0.0; 2];
        let mut sums = Variances::<5>::beside(pixels.beside.len());
        for (k, Pixel { x, y, counts, .. }) in pixels.pixels.iter().enumerate() {
            let Some((share, [xx, xy, yy], u, v)) = self.of_count((*x, *y)) else { continue };
            let radial = u * u + v * v;
            skewness = [skewness[0] + skew * share * counts * u * radial, skewness[1] + skew * share * counts * v * radial];
            sums.add(
                pixels,
                k,
                [
                    // (1 − Q)⁻¹ (u uᵀ − Q) (1 − Q)⁻¹
                    area * (a * (a * xx + b * xy) + b * (a * xy + b * yy)),
                    area * (a * (b * xx + c * xy) + b * (b * xy + c * yy)),
                    area * (b * (b * xx + c * xy) + c * (b * xy + c * yy)),
                    skew * share * u * (radial - by_shift),
                    skew * share * v * (radial - by_shift),
                ],
            );
        }
        let of = |k: usize| sums.of(k, noise);
        let is_finite = second_px2.iter().chain(&skewness).all(|value| value.is_finite());
        is_finite.then(|| SummedImage {
            second_px2,
            second_variance: [of(0), of(1), of(2)],
            skewness,
            skewness_variance: [of(3), of(4)],
            ..SummedImage::default()
        })
    }
}

/// Sums that make variances of numbers to which every pixel's count adds.
struct Variances<const N: usize> {
    square: [f64; N],
    lit: [f64; N],
    total: [f64; N],
    /// Of every other star what is left of its light may add.
    beside: Vec<[f64; N]>,
}

impl<const N: usize> Variances<N> {
    fn beside(others: usize) -> Self {
        Self { square: [0.0; N], lit: [0.0; N], total: [0.0; N], beside: vec![[0.0; N]; others] }
    }

    fn add(&mut self, pixels: &StarPixels, pixel: usize, own: [f64; N]) {
        let lit_dn = pixels.pixels[pixel].lit_dn.max(0.0);
        for (k, add) in own.into_iter().enumerate() {
            self.square[k] += add * add;
            self.lit[k] += add * add * lit_dn;
            self.total[k] += add;
        }
        for (sums, left) in self.beside.iter_mut().zip(&pixels.beside) {
            sums.iter_mut().zip(own).for_each(|(sum, add)| *sum += add * left[pixel]);
        }
    }

    /// Of a number: the noise of the pixels, of the mean of the ring that is taken off them all, and of what is left of other stars.
    fn of(&self, k: usize, [noise2, ring]: [f64; 2]) -> SplitVariance {
        let left: f64 = self.beside.iter().map(|sums| sums[k] * sums[k]).sum();
        SplitVariance { sky: noise2 * (self.square[k] + self.total[k] * self.total[k] / ring) + left, light: self.lit[k] }
    }
}

#[cfg(test)]
#[path = "star_images_tests.rs"]
mod tests;

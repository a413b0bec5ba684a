//! How well what is hidden in pixels can be seen: signal-to-noise ratios by Fisher information.
//!
//! Of stars: the change of the noiseless frame is taken by finite differences. In a star's stamp its own parameters (light, place, background, width)
//! take up what they can; what they take up of light and width is told by catalogue and neighbours, so these changes count: the light beside a zero point
//! of its frame and the catalogue's error of the star, the width less that of all; and so does what no parameter takes up. The light of neighbours in the
//! stamp is free too: it counts in their own. Of noise: variances of sample variances (Kendall & Stuart, *The Advanced Theory of Statistics* 1 (1977),
//! 10.9), of sample covariances, of means and of histograms.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, SMatrix, SVector};
use rayon::prelude::*;

use super::camera::{Conditions, ImageWorld, SIZE_PX, SLOPE_SHARE, SkyStar};
use super::charge::{Pixels, UNEQUAL_DARK, collected, moved};
use super::hidden::{Causes, HiddenImage};
use super::kind::{PixelKind, Reckoned};
use super::light::light;
use super::readout::{LINE_MEMORY, amplified};
use super::spread::Blur;

/// The size that is just seen, standard errors.
pub(super) const JUST_SEEN: f64 = 5.0;
/// Half the side of a star's stamp.
const HALF: usize = 5;
const SIDE: usize = 2 * HALF + 1;
/// Steps of finite differences of a star's own parameters: px and px².
const STEP_PX: f64 = 0.05;
const STEP_PX2: f64 = 0.05;
/// Share of a frame that holds no star's light.
const SKY_SHARE: f64 = 0.85;

/// What the electronics give for a frame without noise, electrons.
fn expected(world: &ImageWorld, number: usize, pixels: &Pixels, causes: Causes<'_>) -> Vec<f64> {
    let charge = collected(world, number, pixels, light(world, number, causes), causes, None);
    amplified(&world.camera, moved(&world.camera, charge, causes), causes)
}

/// The frames without the effects of which the differences are asked, perhaps with others.
pub(super) struct Noiseless<'w> {
    world: &'w ImageWorld,
    others: Vec<HiddenImage>,
    pixels: Pixels,
    frames: Vec<Vec<f64>>,
    stamps: Vec<Vec<Stamp>>,
}

/// A star's stamp: where it begins, and what its own parameters change: light, place, background, width, and the light of each neighbour that shines in.
struct Stamp {
    hip: u32,
    corner: usize,
    electrons: f64,
    own: DMatrix<f64>,
}

impl Stamp {
    /// A change of the light, electrons, and its variance.
    fn light(&self, change_e: f64, variance_e2: f64) -> StarLight {
        StarLight { hip: self.hip, change: change_e / self.electrons, variance: variance_e2 / self.electrons.powi(2) }
    }
}

impl<'w> Noiseless<'w> {
    pub(super) fn new(world: &'w ImageWorld) -> Self {
        Self::beside(world, &[])
    }

    /// With other effects hidden already: what adds up before its square is seen, as displacements of the focus do, is seen otherwise beside them.
    pub(super) fn beside(world: &'w ImageWorld, others: &[HiddenImage]) -> Self {
        let mut rng = super::super::random::stream(0, 0, 0, 0);
        let pixels = Pixels::draw(&mut rng, world, Causes(&[]));
        let all: Vec<usize> = (0..world.frames.len()).collect();
        let frames = all.par_iter().map(|number| expected(world, *number, &pixels, Causes(others))).collect();
        let stamps = world.frames.par_iter().map(|frame| stamps(world, frame)).collect();
        Self { world, others: others.to_vec(), pixels, frames, stamps }
    }

    /// Signal-to-noise ratio of an effect that stamps or background tell.
    pub(super) fn snr(&self, hidden: &HiddenImage) -> f64 {
        self.information(std::slice::from_ref(hidden)).sqrt()
    }

    /// Cosine between what two effects change that stamps tell, with what is free taken out of both: of two that are as large, each is told beside the other
    /// with the share √(1 − cos²) of its signal-to-noise ratio. Sizes are made small, so that changes add up.
    pub(super) fn cosine(&self, pair: [&HiddenImage; 2]) -> f64 {
        const SMALL: f64 = 0.1;
        let [a, b] = pair.map(|own| HiddenImage { size: SMALL * own.size, ..own.clone() });
        let (of_a, of_b) = (self.information(std::slice::from_ref(&a)), self.information(std::slice::from_ref(&b)));
        let product = 0.5 * (self.information(&[a, b]) - of_a - of_b);
        (product / (of_a * of_b).sqrt().max(f64::MIN_POSITIVE)).clamp(-1.0, 1.0)
    }

    /// What is known of the common size of effects that are reckoned alike, in units of it.
    fn information(&self, hidden: &[HiddenImage]) -> f64 {
        let first = hidden[0].kind;
        let all: Vec<HiddenImage> = self.others.iter().chain(hidden).cloned().collect();
        let reckoned = first.reckoned();
        let quiet = self.world.camera.quiet_e2();
        let catalogue = self.world.catalogue_mag * std::f64::consts::LN_10 / 2.5;
        let changes: Vec<FrameChange> = (0..self.frames.len())
            .into_par_iter()
            .map(|number| {
                let base = &self.frames[number];
                let mut change = expected(self.world, number, &self.pixels, Causes(&all));
                change.iter_mut().zip(base).for_each(|(value, base)| *value -= base);
                if reckoned == Reckoned::Background {
                    let slope_e = SLOPE_SHARE * self.world.frames[number].sky_e[0];
                    let is_image = if first == PixelKind::VeilingGlare { self.images(number) } else { Vec::new() };
                    FrameChange { left: of_background(&change, base, quiet, slope_e, &is_image), ..FrameChange::default() }
                } else {
                    let of = if first == PixelKind::IntrapixelResponse { of_all_light } else { of_stamps };
                    of(&change, base, quiet, &self.stamps[number])
                }
            })
            .collect();
        let width = changes.iter().map(|own| own.width).fold(Sums::default(), Sums::and).about_mean();
        let left: f64 = changes.iter().map(|own| own.left).sum();
        let is_ground = self.world.world.frames.iter().any(|frame| frame.zenith.is_some());
        let zero_points = match reckoned {
            Reckoned::StampsOfFrames if is_ground => ZeroPoints::Within(CLEAR_NIGHT),
            Reckoned::StampsOfFrames => ZeroPoints::Within(SHUTTER),
            _ => ZeroPoints::OfFrames,
        };
        let lights: Vec<Vec<StarLight>> = changes.into_iter().map(|own| own.lights).collect();
        (light_information(&lights, catalogue, zero_points) + width + left).max(0.0)
    }

    /// Pixels in the images of a frame's stars: the wings of an image are free, so that nothing wide is told there.
    fn images(&self, number: usize) -> Vec<bool> {
        const WINGS_PX: f64 = 10.0;
        let mut is_image = vec![false; SIZE_PX * SIZE_PX];
        for star in &self.world.frames[number].stars {
            let range = |at: f64| (at - WINGS_PX).max(0.0) as usize..((at + WINGS_PX + 1.0).max(0.0) as usize).min(SIZE_PX);
            for y in range(star.y_px) {
                for x in range(star.x_px) {
                    is_image[y * SIZE_PX + x] |= (x as f64 - star.x_px).hypot(y as f64 - star.y_px) < WINGS_PX;
                }
            }
        }
        is_image
    }
}

/// Weighted sums of a change.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    weight: f64,
    sum: f64,
    square: f64,
}

impl Sums {
    fn add(&mut self, value: f64, variance: f64) {
        self.weight += variance.recip();
        self.sum += value / variance;
        self.square += value * value / variance;
    }

    fn and(self, other: Self) -> Self {
        Self { weight: self.weight + other.weight, sum: self.sum + other.sum, square: self.square + other.square }
    }

    /// What is left of the square when the mean is free.
    fn about_mean(self) -> f64 {
        if self.weight > 0.0 { (self.square - self.sum * self.sum / self.weight).max(0.0) } else { 0.0 }
    }
}

/// Relative change of the light of a star in a frame, and its variance by the pixels.
#[derive(Clone, Copy, Debug)]
struct StarLight {
    hip: u32,
    change: f64,
    variance: f64,
}

/// What is known of the frames' zero points.
#[derive(Clone, Copy, Debug, PartialEq)]
enum ZeroPoints {
    /// They scatter by this share of the light about one for all.
    Within(f64),
    /// Nothing.
    OfFrames,
}

/// Share of the light by which the transparency of a clear night changes from frame to frame, and that of exposures by a shutter.
const CLEAR_NIGHT: f64 = 0.02;
const SHUTTER: f64 = 0.005;

/// χ² of changes of light of the stars of all frames. The catalogue's magnitude of a star is wrong by `catalogue` (relative light), the same in all frames
/// that show it: the images of a star are correlated, and more frames do not take that error away.
fn light_information(frames: &[Vec<StarLight>], catalogue: f64, zero_points: ZeroPoints) -> f64 {
    // A column for each frame's own, and the last for all.
    let count = frames.len() + 1;
    let known = if let ZeroPoints::Within(scatter) = zero_points { scatter.powi(-2) } else { 0.0 };
    let mut stars: BTreeMap<u32, Vec<(usize, StarLight)>> = BTreeMap::new();
    for (frame, lights) in frames.iter().enumerate() {
        for light in lights {
            stars.entry(light.hip).or_default().push((frame, *light));
        }
    }
    let (mut square, mut along, mut normal) = (0.0_f64, DVector::<f64>::zeros(count), DMatrix::<f64>::zeros(count, count));
    for images in stars.values() {
        let weight = |light: &StarLight| light.variance.recip();
        let (whole, changed) =
            images.iter().fold((0.0, 0.0), |(whole, changed), (_, own)| (whole + weight(own), changed + weight(own) * own.change));
        // Inverse of diag(v) + c²·1·1ᵀ by Sherman and Morrison.
        let common = (catalogue.powi(-2) + whole).recip();
        square -= common * changed * changed;
        for (k, own) in images {
            square += weight(own) * own.change * own.change;
            for k in [*k, count - 1] {
                along[k] += weight(own) * (own.change - common * changed);
            }
            for (k, j) in [(*k, *k), (*k, count - 1), (count - 1, *k), (count - 1, count - 1)] {
                normal[(k, j)] += weight(own);
            }
            for (j, other) in images {
                for (k, j) in [(*k, *j), (*k, count - 1), (count - 1, *j), (count - 1, count - 1)] {
                    normal[(k, j)] -= common * weight(own) * weight(other);
                }
            }
        }
    }
    for frame in 0..frames.len() {
        // A frame without stars has no zero point.
        normal[(frame, frame)] += if normal[(frame, frame)] == 0.0 { 1.0 } else { known };
    }
    // What all have in common is held by those of the frames already, where nothing is known of these.
    if known == 0.0 {
        normal = normal.remove_row(count - 1).remove_column(count - 1);
        along = along.remove_row(count - 1);
    }
    normal.cholesky().map_or(0.0, |factor| (square - along.dot(&factor.solve(&along))).max(0.0))
}

/// What an effect changes in one frame.
#[derive(Clone, Debug, Default)]
struct FrameChange {
    /// Light of the stars.
    lights: Vec<StarLight>,
    /// Variance of the images.
    width: Sums,
    /// χ² of what no parameter of a star takes up.
    left: f64,
}

/// χ² of the pixels of a frame under a free level, and slopes along columns and rows of which only the scatter from frame to frame is known. `left_out`:
/// pixels that tell nothing, if any.
fn of_background(change: &[f64], base: &[f64], quiet: f64, slope_e: f64, left_out: &[bool]) -> f64 {
    let half = SIZE_PX as f64 / 2.0;
    let (mut whole, mut right, mut information) = (0.0, SVector::<f64, 3>::zeros(), SMatrix::<f64, 3, 3>::zeros());
    for (k, (change, base)) in change.iter().zip(base).enumerate() {
        if left_out.get(k).is_some_and(|left_out| *left_out) {
            continue;
        }
        let weight = (base + quiet).recip();
        let own = SVector::from([1.0, (k % SIZE_PX) as f64 / half - 1.0, (k / SIZE_PX) as f64 / half - 1.0]);
        whole += weight * change * change;
        right += weight * change * own;
        information += weight * own * own.transpose();
    }
    for axis in 1..3 {
        information[(axis, axis)] += slope_e.powi(-2);
    }
    information.cholesky().map_or(0.0, |factor| (whole - right.dot(&factor.solve(&right))).max(0.0))
}

fn of_stamps(change: &[f64], base: &[f64], quiet: f64, stamps: &[Stamp]) -> FrameChange {
    let mut all = FrameChange::default();
    for stamp in stamps {
        let pixel = |k: usize| stamp.corner + k / SIDE * SIZE_PX + k % SIDE;
        let weights = DVector::from_fn(SIDE * SIDE, |k, _| (base[pixel(k)].max(0.0) + quiet).recip());
        let seen = DVector::from_fn(SIDE * SIDE, |k, _| change[pixel(k)]);
        let weighted = DMatrix::from_fn(SIDE * SIDE, stamp.own.ncols(), |k, j| stamp.own[(k, j)] * weights[k]);
        let Some(factor) = (stamp.own.transpose() * &weighted).cholesky() else { continue };
        let right = weighted.transpose() * &seen;
        let (taken, covariance) = (factor.solve(&right), factor.inverse());
        all.lights.push(stamp.light(taken[0], covariance[(0, 0)]));
        all.width.add(taken[4], covariance[(4, 4)]);
        let whole: f64 = (0..SIDE * SIDE).map(|k| seen[k] * seen[k] * weights[k]).sum();
        all.left += (whole - taken.dot(&right)).max(0.0);
    }
    all
}

/// The same of an effect that is a part of the image: what the pixels see of a star is the image that the lens draws, folded with their response, and
/// which of the two it is no stamp tells (Anderson & King, PASP 112, 1360 (2000), 2). Pixels of one response without gaps count the same light wherever
/// a star lies, so that all the light of a star is what the place in the pixel changes.
fn of_all_light(change: &[f64], base: &[f64], quiet: f64, stamps: &[Stamp]) -> FrameChange {
    let mut all = FrameChange::default();
    for stamp in stamps {
        let pixels = (0..SIDE * SIDE).map(|k| stamp.corner + k / SIDE * SIZE_PX + k % SIDE);
        let (seen, variance) =
            pixels.fold((0.0, 0.0), |(seen, variance), pixel| (seen + change[pixel], variance + base[pixel].max(0.0) + quiet));
        all.lights.push(stamp.light(seen, variance));
    }
    all
}

/// The stamps of a frame's stars that lie whole within it, are no companions, and are not full.
fn stamps(world: &ImageWorld, frame: &Conditions) -> Vec<Stamp> {
    const FULL_SHARE: f64 = 0.14;
    /// Stars so far outside shine in still.
    const BESIDE_PX: f64 = 5.0;
    let added = 0.25 * world.camera.blur_px.powi(2);
    // The image of so much light, over that light: the brighter a star, the further its wings.
    let image = |at: [f64; 2], electrons: f64, variance: f64| {
        let mut light = vec![0.0; SIDE * SIDE];
        let blur = Blur { added_px2: [variance, 0.0, variance], ..Blur::default() };
        world.camera.profile.shine(&mut light, [SIDE; 2], at, electrons, &blur);
        light.into_iter().map(|value| value / electrons).collect::<Vec<f64>>()
    };
    let of = |star: &SkyStar| {
        let [x, y] = [star.x_px, star.y_px].map(f64::round);
        let inside = |at: f64| at >= HALF as f64 && at + HALF as f64 <= SIZE_PX as f64 - 1.0;
        if !star.is_catalogued || !inside(x) || !inside(y) || star.electrons * FULL_SHARE > world.camera.full_e() {
            return None;
        }
        let within = |other: &SkyStar| [other.x_px - x + HALF as f64, other.y_px - y + HALF as f64];
        let render = |at: [f64; 2], variance: f64| image(at, star.electrons, variance);
        let at = within(star);
        let plain = render(at, added);
        let slope = |a: Vec<f64>, b: &[f64], step: f64| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| (a - b) / step).collect() };
        let columns = [
            plain.clone(),
            slope(render([at[0] + STEP_PX, at[1]], added), &plain, STEP_PX),
            slope(render([at[0], at[1] + STEP_PX], added), &plain, STEP_PX),
            vec![star.electrons.recip(); SIDE * SIDE],
            slope(render(at, added + STEP_PX2), &plain, STEP_PX2),
        ];
        let is_near = |along: f64| (-BESIDE_PX..SIDE as f64 - 1.0 + BESIDE_PX).contains(&along);
        let beside = frame.stars.iter().filter(|other| within(other) != at && within(other).into_iter().all(is_near));
        let neighbours: Vec<Vec<f64>> = beside.map(|other| image(within(other), other.electrons, added)).collect();
        let all: Vec<&Vec<f64>> = columns.iter().chain(&neighbours).collect();
        // Light in electrons, that of neighbours too; the others times the star's.
        let is_light = |column: usize| column == 0 || column >= columns.len();
        let own = DMatrix::from_fn(SIDE * SIDE, all.len(), |k, j| all[j][k] * if is_light(j) { 1.0 } else { star.electrons });
        Some(Stamp { hip: star.hip, corner: (y as usize - HALF) * SIZE_PX + x as usize - HALF, electrons: star.electrons, own })
    };
    frame.stars.iter().filter_map(of).collect()
}

/// The size whose signal-to-noise ratio is `snr`, of effects that noise, means of sky pixels and codes tell.
pub(super) fn noise_size(kind: PixelKind, world: &ImageWorld, snr: f64) -> f64 {
    let (variance, sky, frames) = (world.pixel_variance_e2(), world.mean_sky_e(), world.frames.len() as f64);
    let (side, pixels) = (SIZE_PX as f64, SKY_SHARE * (SIZE_PX * SIZE_PX) as f64);
    let pairs = frames * (frames - 1.0) / 2.0;
    // Standard error of the mean square of n numbers of variance v: v·√(2/n).
    let of_squares = |numbers: f64, variance: f64| variance * (2.0 / numbers).sqrt();
    match kind {
        // Means of rows have the variance v/W; each frame's are new.
        PixelKind::RowBanding => (snr * of_squares(side * frames, variance / side)).sqrt(),
        // Means of columns over all frames: the same offsets in each.
        PixelKind::ColumnBanding => (snr * of_squares(side, variance / (side * frames))).sqrt(),
        // Covariance of the same pixel in two frames: standard error v/√n of n pixels, over B².
        PixelKind::Prnu => (snr * variance / (pixels * pairs).sqrt()).sqrt() / sky,
        PixelKind::DarkCurrent => {
            let exposure_s = world.frames.iter().map(|frame| frame.exposure_s).sum::<f64>() / frames;
            (snr * variance / (pixels * pairs).sqrt()).sqrt() / (UNEQUAL_DARK * exposure_s)
        }
        // It makes all images lopsided alike, which no star tells from another image: the correlation of neighbours in a row is −s·(1 − q) of the
        // variance that the light makes, its standard error 1/√n.
        PixelKind::Overshoot => snr * variance / sky / ((1.0 - LINE_MEMORY) * (pixels * frames).sqrt()),
        // Difference of the means of two halves of the pixels, over 2B.
        PixelKind::EvenOdd => snr * (variance / (pixels * frames)).sqrt() / sky,
        // The same of two quarters.
        PixelKind::Bayer => snr * (2.0 * variance / (pixels * frames)).sqrt() / sky,
        // The variance of the photons in counts is B/g².
        PixelKind::WrongGain => snr * of_squares(pixels * frames, variance) / sky,
        PixelKind::WrongReadNoise => {
            let quiet = world.camera.read_noise_e;
            (quiet * quiet + snr * of_squares(pixels * frames, variance)).sqrt() - quiet
        }
        // n counts fall on a code; its width is known to 1/√n, the mean square of K widths to √(2/K)/n.
        PixelKind::CodeWidths => {
            let codes = (4.0 * variance.sqrt() / world.camera.gain_e_per_dn).max(1.0);
            (snr * (2.0 / codes).sqrt() * codes / (pixels * frames)).sqrt()
        }
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::family::Trap;
    use super::super::camera::Needs;
    use super::*;
    use crate::catalog::Catalog;

    /// χ² by the whole covariance matrix, zero points with a wide or a known scatter.
    fn by_covariance(frames: &[Vec<StarLight>], catalogue: f64, scatter: f64) -> f64 {
        let all: Vec<(usize, StarLight)> =
            frames.iter().enumerate().flat_map(|(frame, lights)| lights.iter().map(move |light| (frame, *light))).collect();
        let change = DVector::from_iterator(all.len(), all.iter().map(|(_, own)| own.change));
        let covariance = DMatrix::from_fn(all.len(), all.len(), |a, b| {
            let ((frame, own), (other_frame, other)) = (&all[a], &all[b]);
            let pixels = if a == b { own.variance } else { 0.0 };
            let star = if own.hip == other.hip { catalogue * catalogue } else { 0.0 };
            let zero_point = if frame == other_frame { scatter * scatter } else { 0.0 };
            pixels + star + zero_point + 1e4
        });
        change.dot(&covariance.cholesky().unwrap().solve(&change))
    }

    /// Three stars in five frames, and one that is seen once.
    fn frames(change: impl Fn(usize, u32) -> f64) -> Vec<Vec<StarLight>> {
        let star = |frame: usize, hip: u32| StarLight { hip, change: change(frame, hip), variance: 1e-4 * f64::from(hip) };
        let mut all: Vec<Vec<StarLight>> = (0..5).map(|frame| (1..4).map(|hip| star(frame, hip)).collect()).collect();
        all[2].push(star(2, 7));
        all
    }

    #[test]
    fn a_catalogue_that_is_wrong_alike_in_all_frames_is_counted_once() {
        let sloped = frames(|frame, hip| 0.01 * f64::from(hip) + 0.003 * frame as f64 * f64::from(hip % 2));
        for (zero_points, scatter) in [(ZeroPoints::OfFrames, 100.0), (ZeroPoints::Within(CLEAR_NIGHT), CLEAR_NIGHT)] {
            let [own, whole] = [light_information(&sloped, 0.02, zero_points), by_covariance(&sloped, 0.02, scatter)];
            assert!((own / whole - 1.0).abs() < 1e-3, "{zero_points:?}: {own} {whole}");
        }
        // What follows the star alone is not known better than the catalogue knows stars, however many frames there are: 2e-4/0.02².
        let by_star: Vec<Vec<StarLight>> =
            frames(|_, hip| 0.01 * f64::from(hip)).into_iter().map(|lights| lights.into_iter().take(3).collect()).collect();
        let told = light_information(&by_star, 0.02, ZeroPoints::OfFrames);
        assert!((0.4..0.5).contains(&told), "{told}");
        // One dim frame of five is told no better than nights are even.
        let dim = frames(|frame, _| if frame == 1 { 0.1 } else { 0.0 });
        let told = light_information(&dim, 0.02, ZeroPoints::Within(CLEAR_NIGHT)).sqrt();
        assert!(told < 0.1 / CLEAR_NIGHT && told > 0.3 * 0.1 / CLEAR_NIGHT, "{told}");
        assert!(light_information(&dim, 0.02, ZeroPoints::OfFrames) < 1e-6, "a zero point of its own takes it up");
    }

    /// An effect is itself, with its sign; a tilt of the focal surface is not another one across, nor is light that is lost with the colour.
    #[test]
    fn effects_are_as_alike_as_their_changes() {
        let mut rng = super::super::super::random::stream(6, 0, 0, 0);
        let needs = Needs { ground: Some(true), exposures: false, trap: None };
        let world = ImageWorld::draw(&mut rng, needs, Catalog::embedded());
        let noiseless = Noiseless::new(&world);
        let of = |kind: PixelKind, size: f64, numbers: &[f64]| HiddenImage { kind, size, numbers: numbers.to_vec() };
        let tilt = |size: f64, along: [f64; 2]| of(PixelKind::FieldTilt, size, &along);
        let same = noiseless.cosine([&tilt(0.1, [1.0, 0.0]), &tilt(-0.2, [1.0, 0.0])]);
        assert!((same + 1.0).abs() < 0.02, "{same}");
        // A few bright stars tell most, so that the two directions of a tilt are not quite independent.
        for (other, most) in [(tilt(0.1, [0.0, 1.0]), 0.8), (of(PixelKind::Passband, 0.02, &[]), 0.3)] {
            let cosine = noiseless.cosine([&tilt(0.1, [1.0, 0.0]), &other]);
            assert!(cosine.abs() < most, "{:?}: {cosine}", other.kind);
        }
    }

    /// A drift of the focus changes images that a curved focal surface has widened more than others.
    #[test]
    fn what_adds_up_before_its_square_is_seen_is_reckoned_beside_the_others() {
        let mut rng = super::super::super::random::stream(6, 0, 0, 0);
        let world = ImageWorld::draw(&mut rng, Needs { ground: Some(true), exposures: false, trap: None }, Catalog::embedded());
        let of = |kind: PixelKind, size: f64| HiddenImage { kind, size, numbers: Vec::new() };
        let drift = of(PixelKind::FocusWithTime, 0.02);
        let reckoned = |other: HiddenImage| Noiseless::beside(&world, &[other]).snr(&drift);
        let alone = Noiseless::new(&world).snr(&drift);
        let curved = reckoned(of(PixelKind::FieldCurvature, 4.0 * world.camera.blur_px));
        assert!(curved > 1.5 * alone, "{alone} {curved}");
        let coloured = reckoned(of(PixelKind::Passband, 0.02));
        assert!((coloured / alone - 1.0).abs() < 0.02, "{alone} {coloured}");
    }

    /// What dims all stars of a frame alike is the zero point's, also where stars stand in each other's stamps.
    #[test]
    fn the_same_loss_of_all_stars_is_not_seen() {
        let mut rng = super::super::super::random::stream(4, 0, 0, 0);
        let needs = Needs { ground: Some(true), exposures: false, trap: Some(Trap::BlendedField) };
        let mut world = ImageWorld::draw(&mut rng, needs, Catalog::embedded());
        let extinction = HiddenImage { kind: PixelKind::Extinction, size: 0.1, numbers: Vec::new() };
        let differs = Noiseless::new(&world).snr(&extinction);
        world.frames.iter_mut().flat_map(|frame| &mut frame.stars).for_each(|star| star.airmass = 1.5);
        let alike = Noiseless::new(&world).snr(&extinction);
        assert!(alike < 1.0 && differs > 5.0, "{alike} where all air masses are the same, {differs} as they are");
    }
}

//! Star images painted into frames, by a painter of the generator's own.
//!
//! A star is a round Gaussian integrated over each pixel. Its light and the background's are counted photon by photon (Poisson), read out
//! with normal noise and rounded to counts. What is hidden is hidden in the place of the star's image, as in a star list; the exposures are
//! so short that the camera's turning smears nothing worth the name, and the background is even.

use rand::Rng;
use rand_distr::{Distribution, Poisson};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, Normal};
use statrs::function::erf::erf;

use super::family::Family;
use super::kind::Hidden;
use super::random::{normal, stream};
use super::vector::dot;
use super::world::{GeneratedStarImage, World};

/// Width of the star images (Gaussian σ) before the pixels integrate them.
const PSF_SIGMA_PX: f64 = 0.7;
/// Half the side of a star's stamp: 8σ, beyond which the brightest star sheds no photon.
const REACH_PX: i64 = 6;
/// Background, electrons per pixel.
const BACKGROUND_E: f64 = 20.0;
/// Read noise, electrons.
const READ_NOISE_E: f64 = 5.0;
/// Electrons per count.
const GAIN_E_PER_DN: f64 = 2.0;
/// Count of a pixel without any light.
const BIAS_DN: f64 = 200.0;
/// Exposures are shorter than those of star lists by this factor: at 0.2° a second nothing moves by more than a sixth of a pixel.
const SHORTER: f64 = 10.0;
/// Stars nearer to each other than this shine into one another's images, px. They are painted, and stand in no list: nobody could measure
/// them as lists have them, and what is just seen is reckoned without them.
const APART_PX: f64 = 5.0;
/// Where brightness is stated: so much brighter than the faintest stars, mag.
const ABOVE_LIMIT_MAG: f64 = 0.5;
/// Part of a recording's random numbers that the first frame's noise takes; each frame has its own.
const PART_FRAMES: u32 = 1024;

/// A star as painted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaintedStar {
    /// Catalogue number.
    pub hip: u32,
    /// Column of its centre.
    pub x_px: f64,
    /// Row of its centre.
    pub y_px: f64,
    /// Its light on average.
    pub electrons: f64,
    /// Whether no other star shines into its image.
    pub is_alone: bool,
}

/// All that frames are painted from.
#[derive(Clone, Debug, PartialEq)]
pub struct Canvas {
    /// Columns and rows.
    pub size_px: [usize; 2],
    /// Electrons per count.
    pub gain_e_per_dn: f64,
    /// Count of a pixel without any light.
    pub bias_dn: f64,
    /// Read noise.
    pub read_noise_e: f64,
    /// Stars by frame.
    pub stars: Vec<Vec<PaintedStar>>,
    seed: u64,
    family: u32,
    index: u32,
}

/// Brings a world's photons, and with them its errors, to what is painted: half a magnitude above the limit a star's place is known to
/// `sigma_px`, and every star's standard error follows from its photons.
pub(super) fn expose(world: &mut World, faintest: f64, sigma_px: f64) {
    world.exposure_s /= SHORTER;
    let electrons = electrons_for(sigma_px);
    world.zero_point_e_per_s = electrons * 10.0_f64.powf(0.4 * (faintest - ABOVE_LIMIT_MAG)) / world.exposure_s;
    for image in &mut world.images {
        image.flux_e = world.zero_point_e_per_s * 10.0_f64.powf(-0.4 * image.magnitude) * world.exposure_s;
        image.sigma_px = centre_sigma_px(image.flux_e);
    }
}

/// The world without the star images that others shine into.
pub(super) fn without_blends(world: &World) -> World {
    let alone = alone(world);
    let images = world.images.iter().zip(alone).filter(|(_, alone)| *alone).map(|(image, _)| *image).collect();
    World { images, ..world.clone() }
}

/// For each star image whether no other lies near it. Images come frame by frame.
fn alone(world: &World) -> Vec<bool> {
    let near = (APART_PX / world.optics.focal_px).cos();
    let by_frame = world.images.chunk_by(|a, b| a.frame == b.frame);
    let of = |images: &[GeneratedStarImage]| -> Vec<bool> {
        let lonely = |at: usize| (0..images.len()).all(|other| other == at || dot(images[at].direction, images[other].direction) < near);
        (0..images.len()).map(lonely).collect()
    };
    by_frame.flat_map(of).collect()
}

/// Electrons of a star whose place is known to this standard error.
fn electrons_for(sigma_px: f64) -> f64 {
    let (mut low, mut high) = (1.0_f64, 1e9_f64);
    for _ in 0..60 {
        let middle = (low * high).sqrt();
        if centre_sigma_px(middle) > sigma_px { low = middle } else { high = middle }
    }
    high
}

/// The least standard error per axis of the centre of a star of so many electrons (Cramér and Rao), the mean information over places in the
/// pixel. Flux and background cost nothing: their derivatives are even where those by the place are odd.
#[must_use]
pub fn centre_sigma_px(electrons: f64) -> f64 {
    const PHASES: [f64; 4] = [-0.375, -0.125, 0.125, 0.375];
    let quiet = BACKGROUND_E + READ_NOISE_E * READ_NOISE_E + GAIN_E_PER_DN * GAIN_E_PER_DN / 12.0;
    let mut information = 0.0;
    for phase in PHASES {
        let slopes: Vec<f64> = (-REACH_PX..=REACH_PX).map(|at| slope(at as f64 - phase)).collect();
        let across: Vec<f64> = (-REACH_PX..=REACH_PX).map(|at| share(at as f64 - phase)).collect();
        for other in PHASES {
            for down in (-REACH_PX..=REACH_PX).map(|at| share(at as f64 - other)) {
                for (slope, across) in slopes.iter().zip(&across) {
                    information += (electrons * slope * down).powi(2) / (quiet + electrons * across * down);
                }
            }
        }
    }
    (information / (PHASES.len() * PHASES.len()) as f64).sqrt().recip()
}

/// Share of a line Gaussian that falls into the pixel whose middle is this far from the Gaussian's.
fn share(away_px: f64) -> f64 {
    let below = |edge: f64| erf(edge / (PSF_SIGMA_PX * std::f64::consts::SQRT_2));
    0.5 * (below(away_px + 0.5) - below(away_px - 0.5))
}

/// Its derivative by the Gaussian's place, 1/px.
fn slope(away_px: f64) -> f64 {
    let density = |edge: f64| (-0.5 * (edge / PSF_SIGMA_PX).powi(2)).exp() / (PSF_SIGMA_PX * std::f64::consts::TAU.sqrt());
    density(away_px - 0.5) - density(away_px + 0.5)
}

impl Canvas {
    /// The frames of a world with what is hidden in it.
    pub(super) fn new(family: Family, index: u32, seed: u64, world: &World, hidden: &[Hidden]) -> Self {
        let mut stars = vec![Vec::new(); world.frames.len()];
        for ((image, [x_px, y_px]), is_alone) in world.images.iter().zip(world.predict(hidden)).zip(alone(world)) {
            if x_px.is_finite() && y_px.is_finite() {
                stars[image.frame].push(PaintedStar { hip: image.hip, x_px, y_px, electrons: image.flux_e, is_alone });
            }
        }
        Self {
            size_px: [world.optics.width_px, world.optics.height_px],
            gain_e_per_dn: GAIN_E_PER_DN,
            bias_dn: BIAS_DN,
            read_noise_e: READ_NOISE_E,
            stars,
            seed,
            family: family.number(),
            index,
        }
    }

    /// Paints all frames: counts row by row, the first row on top.
    #[must_use]
    pub fn frames(&self) -> Vec<Vec<u16>> {
        let dark = Dark::new();
        (0..self.stars.len()).into_par_iter().map(|frame| self.frame(frame, &dark)).collect()
    }

    fn frame(&self, frame: usize, dark: &Dark) -> Vec<u16> {
        let [width, height] = self.size_px;
        let mut light = vec![0.0_f64; width * height];
        for star in &self.stars[frame] {
            shine(&mut light, [width, height], star);
        }
        let mut rng = stream(self.seed, self.family, self.index, PART_FRAMES + frame as u32);
        light.into_iter().map(|electrons| if electrons == 0.0 { dark.draw(&mut rng) } else { read_out(&mut rng, electrons) }).collect()
    }
}

/// Adds a star's light.
fn shine(light: &mut [f64], size_px: [usize; 2], star: &PaintedStar) {
    let axis = |at: f64, length: usize| -> Vec<(usize, f64)> {
        let middle = at.round() as i64;
        (middle - REACH_PX..=middle + REACH_PX)
            .filter_map(|pixel| Some((usize::try_from(pixel).ok().filter(|pixel| *pixel < length)?, share(pixel as f64 - at))))
            .collect()
    };
    let across = axis(star.x_px, size_px[0]);
    for (row, down) in axis(star.y_px, size_px[1]) {
        for (column, share) in &across {
            light[row * size_px[0] + column] += star.electrons * down * share;
        }
    }
}

/// The count of a pixel on which so many electrons of starlight fall on average.
fn read_out(rng: &mut Pcg64Mcg, starlight_e: f64) -> u16 {
    let photons: f64 = Poisson::new(BACKGROUND_E + starlight_e).map_or(0.0, |counts| counts.sample(rng));
    // The cast keeps to 0 and 65 535, as a converter does.
    ((photons + READ_NOISE_E * normal(rng)) / GAIN_E_PER_DN + BIAS_DN).round() as u16
}

/// Counts of pixels without starlight: most of a frame, drawn from the table of their probabilities.
struct Dark {
    first_dn: u16,
    /// Probability of the first count or less, the next or less and so on, in units of 2⁻³².
    up_to: Vec<u64>,
    /// For each value of the upper ten bits of a draw: the first count that it may stand for.
    guide: Vec<usize>,
}

impl Dark {
    fn new() -> Self {
        const GUIDE_BITS: u32 = 10;
        let (most_e, reach_e) = (BACKGROUND_E + 12.0 * BACKGROUND_E.sqrt(), 8.0 * READ_NOISE_E);
        let mut weights = vec![(-BACKGROUND_E).exp()];
        while (weights.len() as f64) < most_e {
            weights.push(weights[weights.len() - 1] * BACKGROUND_E / weights.len() as f64);
        }
        let read = Normal::standard();
        let below = |count: f64| {
            let electrons = (count + 0.5 - BIAS_DN) * GAIN_E_PER_DN;
            let of = |(photons, weight): (usize, &f64)| weight * read.cdf((electrons - photons as f64) / READ_NOISE_E);
            weights.iter().enumerate().map(of).sum::<f64>()
        };
        let (first, last) = (BIAS_DN - reach_e / GAIN_E_PER_DN, BIAS_DN + (most_e + reach_e) / GAIN_E_PER_DN);
        let mut up_to: Vec<u64> = (first as u16..=last as u16).map(|count| (below(f64::from(count)) * 2.0_f64.powi(32)) as u64).collect();
        up_to.push(1 << 32);
        let guide = (0..1_u64 << GUIDE_BITS).map(|upper| up_to.partition_point(|end| *end <= upper << (32 - GUIDE_BITS))).collect();
        Self { first_dn: first as u16, up_to, guide }
    }

    fn draw(&self, rng: &mut Pcg64Mcg) -> u16 {
        let draw = u64::from(rng.next_u32());
        let mut place = self.guide[(draw >> 22) as usize];
        while self.up_to[place] <= draw {
            place += 1;
        }
        self.first_dn + place as u16
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STAR: PaintedStar = PaintedStar { hip: 1, x_px: 20.3, y_px: 17.8, electrons: 330.0, is_alone: true };

    fn canvas(stars: Vec<PaintedStar>, frames: usize) -> Canvas {
        Canvas {
            size_px: [40, 36],
            gain_e_per_dn: GAIN_E_PER_DN,
            bias_dn: BIAS_DN,
            read_noise_e: READ_NOISE_E,
            stars: vec![stars; frames],
            seed: 5,
            family: 9,
            index: 3,
        }
    }

    /// Means and variances of painted pixels are those of the photons, with starlight and without.
    #[test]
    fn counts_have_the_mean_and_the_scatter_of_their_photons() {
        let frames = canvas(vec![PaintedStar { electrons: 4000.0, ..STAR }], 3000).frames();
        let (mut sum, mut square, mut count) = (0.0, 0.0, 0.0);
        for (x, y) in [(20, 18), (21, 18), (19, 17), (20, 20)] {
            let expected_e = 4000.0 * share(f64::from(x) - STAR.x_px) * share(f64::from(y) - STAR.y_px) + BACKGROUND_E;
            let values: Vec<f64> = frames.iter().map(|frame| (f64::from(frame[(y * 40 + x) as usize]) - BIAS_DN) * GAIN_E_PER_DN).collect();
            let mean = values.iter().sum::<f64>() / 3000.0;
            let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / 2999.0;
            let expected_variance = expected_e + READ_NOISE_E.powi(2) + GAIN_E_PER_DN.powi(2) / 12.0;
            assert!((mean - expected_e).abs() < 4.0 * (expected_variance / 3000.0).sqrt(), "{x} {y}: {mean}, {expected_e} expected");
            assert!((variance / expected_variance - 1.0).abs() < 0.12, "{x} {y}: {variance}, {expected_variance} expected");
        }
        for value in frames.iter().take(300).flat_map(|frame| &frame[..400]) {
            let electrons = (f64::from(*value) - BIAS_DN) * GAIN_E_PER_DN;
            (sum, square, count) = (sum + electrons, square + electrons * electrons, count + 1.0);
        }
        let (mean, expected) = (sum / count, BACKGROUND_E + READ_NOISE_E.powi(2) + GAIN_E_PER_DN.powi(2) / 12.0);
        let variance = square / count - mean * mean;
        assert!((mean - BACKGROUND_E).abs() < 0.1, "{mean}");
        assert!((variance / expected - 1.0).abs() < 0.02, "{variance}, {expected} expected");
    }

    /// The stated standard error is that of the best weighting of the pixels, tried on painted stars: one Newton step from the truth.
    #[test]
    fn the_error_of_a_centre_is_what_its_photons_allow() {
        let frames = canvas(vec![STAR], 4000).frames();
        let quiet = BACKGROUND_E + READ_NOISE_E.powi(2) + GAIN_E_PER_DN.powi(2) / 12.0;
        let (mut sum, mut square) = (0.0, 0.0);
        for frame in &frames {
            let (mut score, mut information) = (0.0, 0.0);
            for y in 12..24_u32 {
                for x in 14..27_u32 {
                    let (away, down) = (f64::from(x) - STAR.x_px, share(f64::from(y) - STAR.y_px));
                    let (signal, slope) = (STAR.electrons * share(away) * down, STAR.electrons * slope(away) * down);
                    let value = (f64::from(frame[(y * 40 + x) as usize]) - BIAS_DN) * GAIN_E_PER_DN - BACKGROUND_E;
                    score += slope * (value - signal) / (quiet + signal);
                    information += slope * slope / (quiet + signal);
                }
            }
            (sum, square) = (sum + score / information, square + (score / information).powi(2));
        }
        let (mean, sd) = (sum / 4000.0, (square / 4000.0).sqrt());
        let stated = centre_sigma_px(STAR.electrons);
        assert!(mean.abs() < 4.0 * stated / 4000.0_f64.sqrt(), "{mean}");
        assert!((sd / stated - 1.0).abs() < 0.06, "{sd} px, {stated} px stated");
        assert!((centre_sigma_px(electrons_for(0.07)) / 0.07 - 1.0).abs() < 1e-9);
    }
}

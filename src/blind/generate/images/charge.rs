//! Charge in the pixels: what collects beside light, and how it moves before it is read.
//!
//! Sources: boundaries of pixels that charge pushes: Antilogus et al., JINST 9, C03048 (2014); Guyonnet et al., A&A 575, A41 (2015), equations 9 to 11, with
//! the field of a point charge in the place of the fitted coefficients. Traps whose number goes with the volume of the packet: Short et al., MNRAS 430,
//! 3078 (2013); a way of many transfers in few steps: Massey et al., MNRAS 401, 371 (2010), 2.1.3.

use rand_distr::{Distribution, LogNormal, Poisson};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use super::super::random::{between, chance, normal, on_circle, pick};
use super::camera::{ImageCamera, ImageWorld, SIZE_PX};
use super::hidden::{Causes, HiddenImage};
use super::kind::PixelKind;
use super::spread::Blur;

/// Scatter of the dark current of pixels over its mean.
pub(super) const UNEQUAL_DARK: f64 = 0.3;
/// A packet whose loss is stated, electrons: the middle column of a star of 10 000.
const PACKET_E: f64 = 1500.0;
/// Steps in which the way to the register is gone.
const EXPRESS: usize = 6;
/// Charge of a particle's track, electrons per pixel (80 per µm of silicon).
const TRACK_E: [f64; 2] = [300.0, 1500.0];

/// What is fixed in the detector of a recording.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Pixels {
    /// Sensitivity over its mean; empty where all are the same.
    sensitivity: Vec<f64>,
    /// Dark current over its mean; empty where there is none.
    dark: Vec<f64>,
    /// Pixel and electrons more, in every frame.
    hot: Vec<(usize, f64)>,
    /// Pixel and electrons more, in about half of the frames.
    jumping: Vec<(usize, f64)>,
}

impl Pixels {
    pub(super) fn draw(rng: &mut Pcg64Mcg, world: &ImageWorld, causes: Causes<'_>) -> Self {
        let all = SIZE_PX * SIZE_PX;
        let noise_e = world.pixel_variance_e2().sqrt();
        let defects = |rng: &mut Pcg64Mcg, kind: PixelKind| -> Vec<(usize, f64)> {
            (0..causes.size(kind).round() as usize).map(|_| (pick(rng, all), noise_e * between(rng, 7.0, 25.0))).collect()
        };
        let (hot, jumping) = (defects(rng, PixelKind::HotPixels), defects(rng, PixelKind::RandomTelegraph));
        let prnu = causes.size(PixelKind::Prnu);
        let sensitivity = if prnu == 0.0 { Vec::new() } else { (0..all).map(|_| 1.0 + prnu * normal(rng)).collect() };
        let is_dark = causes.size(PixelKind::DarkCurrent) != 0.0;
        let spread = (1.0 + UNEQUAL_DARK * UNEQUAL_DARK).ln();
        let of = LogNormal::new(-0.5 * spread, spread.sqrt()).ok().filter(|_| is_dark);
        let dark = of.map_or_else(Vec::new, |of| (0..all).map(|_| of.sample(rng)).collect());
        Self { sensitivity, dark, hot, jumping }
    }
}

/// Electrons of a frame before they move: on average, or (with random numbers) as they are counted.
pub(super) fn collected(
    world: &ImageWorld,
    number: usize,
    pixels: &Pixels,
    mut charge: Vec<f64>,
    causes: Causes<'_>,
    noise: Option<&mut Pcg64Mcg>,
) -> Vec<f64> {
    let exposure_s = world.frames[number].exposure_s;
    for (value, sensitivity) in charge.iter_mut().zip(&pixels.sensitivity) {
        *value *= sensitivity;
    }
    let bayer = causes.size(PixelKind::Bayer);
    if bayer != 0.0 {
        for (k, value) in charge.iter_mut().enumerate() {
            *value *= 1.0 + bayer * [1.0, 0.0, 0.0, -1.0][2 * (k / SIZE_PX % 2) + k % 2];
        }
    }
    for (value, dark) in charge.iter_mut().zip(&pixels.dark) {
        *value += causes.size(PixelKind::DarkCurrent) * exposure_s * dark;
    }
    if let Some(own) = causes.find(PixelKind::AmplifierGlow) {
        add_glow(&mut charge, own, exposure_s);
    }
    for (pixel, electrons) in &pixels.hot {
        charge[*pixel] += electrons;
    }
    let Some(rng) = noise else { return charge };
    for (pixel, electrons) in &pixels.jumping {
        if chance(rng, 0.5) {
            charge[*pixel] += electrons;
        }
    }
    let streaks = Poisson::new(causes.size(PixelKind::Streaks)).map_or(0.0, |counts| counts.sample(rng));
    for _ in 0..streaks as usize {
        add_streak(&mut charge, world, rng);
    }
    for value in &mut charge {
        *value = Poisson::new(*value).map_or(0.0, |counts| counts.sample(rng));
    }
    let per_frame = causes.size(PixelKind::CosmicRays);
    let tracks = Poisson::new(per_frame).map_or(0.0, |counts| counts.sample(rng));
    for _ in 0..tracks as usize {
        add_track(&mut charge, rng);
    }
    charge
}

/// Light of an amplifier in a corner (0 top left, clockwise): falls off by e over a length.
fn add_glow(charge: &mut [f64], own: &HiddenImage, exposure_s: f64) {
    let last = SIZE_PX as f64 - 1.0;
    let [x, y] = [[0.0, 0.0], [last, 0.0], [last, last], [0.0, last]][own.number(0) as usize % 4];
    for (k, value) in charge.iter_mut().enumerate() {
        let away = ((k % SIZE_PX) as f64 - x).hypot((k / SIZE_PX) as f64 - y);
        *value += own.size * exposure_s * (-away / own.number(1)).exp();
    }
}

/// The track of a charged particle: straight, as long as its slant makes it.
fn add_track(charge: &mut [f64], rng: &mut Pcg64Mcg) {
    const STEPS_PER_PX: f64 = 8.0;
    let [cos, sin] = on_circle(rng);
    let start = [between(rng, 0.0, SIZE_PX as f64), between(rng, 0.0, SIZE_PX as f64)];
    let length_px = 1.0 + between(rng, 0.0, 1.0).powi(2) * 12.0;
    let per_step = between(rng, TRACK_E[0], TRACK_E[1]) / STEPS_PER_PX;
    for step in 0..(length_px * STEPS_PER_PX) as usize {
        let along = step as f64 / STEPS_PER_PX;
        let [x, y] = [start[0] + along * cos, start[1] + along * sin].map(|at| at as usize);
        if x < SIZE_PX && y < SIZE_PX {
            charge[y * SIZE_PX + x] += per_step;
        }
    }
}

/// The trail of a satellite all across the frame: the optics draw each of its points as a star (Nir, Zackay & Ofek, AJ 156, 229 (2018), 2.1).
fn add_streak(charge: &mut [f64], world: &ImageWorld, rng: &mut Pcg64Mcg) {
    /// Light of a pixel of its length over the noise of a pixel.
    const BRIGHTNESS: [f64; 2] = [2.0, 8.0];
    let [cos, sin] = on_circle(rng);
    let through = [between(rng, 0.2, 0.8), between(rng, 0.2, 0.8)].map(|share| share * SIZE_PX as f64);
    let per_px_e = world.pixel_variance_e2().sqrt() * between(rng, BRIGHTNESS[0], BRIGHTNESS[1]);
    let sigma_px = world.camera.profile.sigma_px.hypot(world.camera.blur_px / 2.0);
    for (k, value) in charge.iter_mut().enumerate() {
        let off_px = ((k % SIZE_PX) as f64 - through[0]) * sin - ((k / SIZE_PX) as f64 - through[1]) * cos;
        if off_px.abs() < 6.0 * sigma_px {
            *value += per_px_e * (-0.5 * (off_px / sigma_px).powi(2)).exp() / (sigma_px * std::f64::consts::TAU.sqrt());
        }
    }
}

/// Charge after the boundaries of the pixels have moved and the packets have gone to the register.
pub(super) fn moved(camera: &ImageCamera, mut charge: Vec<f64>, causes: Causes<'_>) -> Vec<f64> {
    let pushed = causes.size(PixelKind::BrighterFatter);
    if pushed != 0.0 {
        charge = pushed_apart(&charge, SIZE_PX, pushed / (4.0 * camera.full_e()));
    }
    if let Some(own) = causes.find(PixelKind::ChargeTransfer) {
        transferred(camera, &mut charge, own);
    }
    charge
}

/// A boundary moves towards the charge: by `per_e`·Q·(b − r)/|b − r|³ for a charge Q at r; half of it, for charge grows evenly during the exposure.
/// What lies between the old boundary and the new goes to the other pixel.
fn pushed_apart(charge: &[f64], width: usize, per_e: f64) -> Vec<f64> {
    let height = charge.len() / width;
    let at = |x: isize, y: isize| {
        let inside = x >= 0 && y >= 0 && x < width.cast_signed() && y < height.cast_signed();
        if inside { charge[y.cast_unsigned() * width + x.cast_unsigned()] } else { 0.0 }
    };
    // Weights of the charges beside a boundary: along it −1 to 1, across it −1 to 2 pixels from the one before it.
    let mut taps = Vec::new();
    for along in -1..=1_isize {
        for across in -1..=2_isize {
            let (b, a) = (0.5 - across as f64, along as f64);
            taps.push((across, along, -0.5 * per_e * b / b.hypot(a).powi(3)));
        }
    }
    let flows = |dx: isize, dy: isize| -> Vec<f64> {
        let of = |k: usize| {
            let (x, y) = ((k % width).cast_signed(), (k / width).cast_signed());
            // Charge beyond the edge is not known: boundaries there stay.
            if x < 1 || y < 1 || x + 2 >= width.cast_signed() || y + 2 >= height.cast_signed() {
                return 0.0;
            }
            let shift: f64 =
                taps.iter().map(|(across, along, weight)| weight * at(x + across * dx + along * dy, y + across * dy + along * dx)).sum();
            shift * 0.5 * (at(x, y) + at(x + dx, y + dy))
        };
        (0..charge.len()).map(of).collect()
    };
    let (right, down) = (flows(1, 0), flows(0, 1));
    let mut after = charge.to_vec();
    for k in 0..charge.len() {
        after[k] += right[k] + down[k];
        if k % width + 1 < width {
            after[k + 1] -= right[k];
        }
        if k + width < charge.len() {
            after[k + width] -= down[k];
        }
    }
    after
}

/// By how much a star whose peak is full is wider: the Gaussian σ that its second moment along x has under a weight as wide as its core.
pub(super) fn relative_width_at_full(camera: &ImageCamera, size: f64) -> f64 {
    const SIDE: usize = 31;
    let mut star = vec![0.0; SIDE * SIDE];
    let added = 0.25 * camera.blur_px * camera.blur_px;
    camera.profile.shine(&mut star, [SIDE; 2], [15.0, 15.0], 1.0, &Blur { added_px2: [added, 0.0, added], ..Blur::default() });
    let scale = camera.full_e() / star[15 * SIDE + 15];
    for value in &mut star {
        *value *= scale;
    }
    let weight = (camera.profile.sigma_px.powi(2) + added).recip();
    let variance = |light: &[f64]| {
        let (mut sum, mut square) = (0.0, 0.0);
        for (k, value) in light.iter().enumerate() {
            let [x, y] = [k % SIDE, k / SIDE].map(|at| at as f64 - 15.0);
            let weighed = value * (-0.5 * weight * (x * x + y * y)).exp();
            (sum, square) = (sum + weighed, square + x * x * weighed);
        }
        // A Gaussian of variance v under the weight has 1/(1/v + weight).
        (sum / square - weight).recip()
    };
    (variance(&pushed_apart(&star, SIDE, size / (4.0 * camera.full_e()))) / variance(&star)).sqrt() - 1.0
}

/// Columns go to the register above row 0, one packet after the other; traps take from each what its volume reaches, and give it to those behind.
fn transferred(camera: &ImageCamera, charge: &mut [f64], own: &HiddenImage) {
    let (release, power) = (1.0 - (-1.0 / own.number(0)).exp(), own.number(1));
    let full = camera.full_e();
    // A packet of the stated size loses the stated share from the farthest row.
    let traps = own.size * PACKET_E / (PACKET_E / full).powf(power);
    let columns: Vec<Vec<f64>> = (0..SIZE_PX)
        .into_par_iter()
        .map(|column| {
            let mut packets: Vec<f64> = (0..SIZE_PX).map(|row| charge[row * SIZE_PX + column]).collect();
            for _ in 0..EXPRESS {
                // Electrons held, as if all traps of a whole column lay in the way.
                let mut held = 0.0;
                for (row, packet) in packets.iter_mut().enumerate() {
                    let way = (row + 1) as f64 / (SIZE_PX * EXPRESS) as f64;
                    let given = held * release;
                    held -= given;
                    *packet += given * way;
                    let room = traps * (packet.max(0.0) / full).powf(power) - held;
                    let taken = (room.max(0.0) * way).min(packet.max(0.0));
                    *packet -= taken;
                    held += taken / way;
                }
            }
            packets
        })
        .collect();
    for (column, packets) in columns.iter().enumerate() {
        for (row, packet) in packets.iter().enumerate() {
            charge[row * SIZE_PX + column] = *packet;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// No charge is lost; a flat field stays flat; a peak gives to its four neighbours alike.
    #[test]
    fn boundaries_move_and_keep_the_charge() {
        let (width, per_e) = (15, 1e-7);
        let flat = pushed_apart(&vec![3e4; width * width], width, per_e);
        assert!(flat.iter().skip(4 * width + 4).take(6).all(|value| (value - 3e4).abs() < 1e-6));
        let mut star = vec![100.0; width * width];
        star[7 * width + 7] = 5e4;
        let after = pushed_apart(&star, width, per_e);
        assert!((after.iter().sum::<f64>() - star.iter().sum::<f64>()).abs() < 1e-6);
        let gains = [(6, 7), (8, 7), (7, 6), (7, 8)].map(|(x, y): (usize, usize)| after[y * width + x] - 100.0);
        assert!(gains.iter().all(|gain| *gain > 1.0 && (gain - gains[0]).abs() < 1e-9), "{gains:?}");
        // The boundary of a lone charge Q moves by half of 4·per_e·Q, over a mean charge of Q/2.
        assert!((gains[0] / (0.5 * 4.0 * per_e * 5e4 * 0.5 * 5e4) - 1.0).abs() < 0.02, "{gains:?}");
    }

    /// A packet of the stated size in an empty column loses the stated share, and most of it comes out behind it.
    #[test]
    fn a_far_packet_loses_its_share_to_its_tail() {
        use super::super::spread::PaintedProfile;
        let profile = PaintedProfile { sigma_px: 0.8, core: 0.9, wings: 2.0, beta: 3.0, axes: [0.0; 2] };
        let camera =
            ImageCamera { gain_e_per_dn: 2.0, bias_dn: 100.0, read_noise_e: 4.0, bits: 14, profile, blur_px: 0.5, tail_px: [0.0; 2] };
        let mut charge = vec![0.0; SIZE_PX * SIZE_PX];
        let (row, column) = (SIZE_PX - 40, 100);
        charge[row * SIZE_PX + column] = PACKET_E;
        let own = HiddenImage { kind: PixelKind::ChargeTransfer, size: 0.05, numbers: vec![2.0, 0.5] };
        transferred(&camera, &mut charge, &own);
        let left = charge[row * SIZE_PX + column] / PACKET_E;
        let expected = 1.0 - 0.05 * (row + 1) as f64 / SIZE_PX as f64;
        assert!((left - expected).abs() < 5e-3, "{left} {expected}");
        let tail: f64 = (1..40).map(|behind| charge[(row + behind) * SIZE_PX + column]).sum();
        assert!(tail > 0.5 * (1.0 - left) * PACKET_E && charge[(row - 1) * SIZE_PX + column] == 0.0, "{tail}");
    }
}

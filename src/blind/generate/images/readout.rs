//! From charge to counts: amplifiers, converter, file.
//!
//! Sources: saturating amplifier: Janesick, *Photon Transfer* (2007), chapter 7; weights of a successive-approximation converter and what their errors
//! do to its code widths: Maloberti, *Data Converters* (2007), 4.3; cosine transform and quantiser: Wallace, IEEE Trans. Consum. Electron. 38, xviii (1992).

use rand_pcg::Pcg64Mcg;

use super::super::random::normal;
use super::camera::{ImageCamera, SIZE_PX};
use super::hidden::Causes;
use super::kind::PixelKind;

/// Of a disturbed line so much is left a pixel later.
pub(super) const LINE_MEMORY: f64 = 0.5;
/// Side of a block.
const BLOCK: usize = 8;

/// What is fixed in the electronics of a recording.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Electronics {
    /// Offsets of the columns, electrons.
    columns_e: Vec<f64>,
    /// Weights of the converter's bits, DN, the highest first.
    weights_dn: Vec<f64>,
}

impl Electronics {
    /// `codes`: those of the sky, and how often each comes.
    pub(super) fn draw(rng: &mut Pcg64Mcg, camera: &ImageCamera, codes: &[(u32, f64)], causes: Causes<'_>) -> Self {
        let columns_e = (0..SIZE_PX).map(|_| causes.size(PixelKind::ColumnBanding) * normal(rng)).collect();
        Self { columns_e, weights_dn: weights_dn(rng, camera.bits, codes, causes.size(PixelKind::CodeWidths)) }
    }

    /// The code of a voltage: bits are tried from the highest on, and kept where their weight is not too much.
    fn code(&self, dn: f64) -> u32 {
        let (mut sum, mut code) = (0.0, 0);
        for weight in &self.weights_dn {
            code <<= 1;
            if sum + weight <= dn {
                sum += weight;
                code |= 1;
            }
        }
        code
    }
}

/// Weights of a converter's bits, DN, the highest first. Their errors are scaled so that the codes of the sky have the width error asked for in every
/// converter: of the few bits that change among them their rms would scatter by four tenths.
fn weights_dn(rng: &mut Pcg64Mcg, bits: u32, codes: &[(u32, f64)], dnl_dn: f64) -> Vec<f64> {
    let mut errors: Vec<f64> = (0..bits).rev().map(|bit| f64::from(1_u32 << bit).sqrt() * normal(rng)).collect();
    errors.reverse();
    // From a code to the next one the last bit that was not set is set, and those below it go.
    let of_width = |code: u32| {
        let bit = (code.trailing_ones() as usize).min(errors.len() - 1);
        errors[bit] - errors[..bit].iter().sum::<f64>()
    };
    let often: f64 = codes.iter().map(|(_, often)| often).sum();
    let square: f64 = codes.iter().map(|(code, often)| often * of_width(*code).powi(2)).sum();
    let scale = if square > 0.0 { dnl_dn * (often / square).sqrt() } else { 0.0 };
    (0..bits).rev().map(|bit| f64::from(1_u32 << bit) + scale * errors[bit as usize]).collect()
}

/// What the amplifiers make of the charge, electrons, without noise.
pub(super) fn amplified(camera: &ImageCamera, mut charge: Vec<f64>, causes: Causes<'_>) -> Vec<f64> {
    let step = causes.size(PixelKind::AmplifierStep);
    if step != 0.0 {
        charge[SIZE_PX * SIZE_PX / 2..].iter_mut().for_each(|value| *value *= 1.0 + step);
    }
    let even_odd = causes.size(PixelKind::EvenOdd);
    if even_odd != 0.0 {
        charge.iter_mut().enumerate().for_each(|(k, value)| *value *= if k % 2 == 0 { 1.0 + even_odd } else { 1.0 - even_odd });
    }
    let loss = causes.size(PixelKind::Nonlinearity);
    if loss != 0.0 {
        // S = Q0·(1 − e^(−Q/Q0)) lacks this share where the pixel is full: x/2 − x²/6 of x = full/Q0.
        let scale = camera.full_e() / (2.0 * loss + 4.0 / 3.0 * loss * loss);
        for value in &mut charge {
            *value = scale * (1.0 - (-*value / scale).exp());
        }
    }
    let crosstalk = causes.size(PixelKind::Crosstalk);
    if crosstalk != 0.0 {
        // Two amplifiers read from the sides to the middle at the same time.
        for row in charge.chunks_exact_mut(SIZE_PX) {
            let before = row.to_vec();
            row.iter_mut().zip(before.iter().rev()).for_each(|(value, other)| *value += crosstalk * other);
        }
    }
    let overshoot = causes.size(PixelKind::Overshoot);
    if overshoot != 0.0 {
        for row in charge.chunks_exact_mut(SIZE_PX) {
            let mut memory = row[0];
            for value in row {
                let own = *value;
                *value += overshoot * (own - memory);
                memory = LINE_MEMORY * memory + (1.0 - LINE_MEMORY) * own;
            }
        }
    }
    charge
}

/// Counts of what the amplifiers give.
pub(super) fn counts(
    camera: &ImageCamera,
    electronics: &Electronics,
    signal_e: &[f64],
    causes: Causes<'_>,
    rng: &mut Pcg64Mcg,
) -> Vec<u16> {
    let gain = camera.gain_e_per_dn * (1.0 + causes.size(PixelKind::WrongGain));
    let read_noise_e = camera.read_noise_e + causes.size(PixelKind::WrongReadNoise);
    let rows_e = causes.size(PixelKind::RowBanding);
    let lost = causes.size(PixelKind::LostBits).round() as u32;
    let last = (1_u32 << camera.bits) - 1;
    let exact = causes.size(PixelKind::CodeWidths) == 0.0;
    let mut codes = Vec::with_capacity(signal_e.len());
    for row in signal_e.chunks_exact(SIZE_PX) {
        let row_e = if rows_e == 0.0 { 0.0 } else { rows_e * normal(rng) };
        for (value, column_e) in row.iter().zip(&electronics.columns_e) {
            let dn = (value + row_e + column_e + read_noise_e * normal(rng)) / gain + camera.bias_dn + 0.5;
            // The cast keeps to zero what is below it.
            let code = if exact { dn as u32 } else { electronics.code(dn) };
            codes.push((code.min(last) >> lost << lost) as u16);
        }
    }
    let quantiser = causes.size(PixelKind::Compression);
    if quantiser > 0.0 {
        compress(&mut codes, quantiser, last);
    }
    codes
}

type Block = [[f64; BLOCK]; BLOCK];

/// Rounds the cosine transform of every block of 8 × 8 pixels, as a file format does.
fn compress(codes: &mut [u16], quantiser_dn: f64, last: u32) {
    let basis: Block = std::array::from_fn(|k| {
        std::array::from_fn(|x| {
            let scale = if k == 0 { 0.125_f64 } else { 0.25 }.sqrt();
            scale * (std::f64::consts::PI * (x as f64 + 0.5) * k as f64 / BLOCK as f64).cos()
        })
    });
    let product =
        |a: &Block, b: &Block| -> Block { std::array::from_fn(|i| std::array::from_fn(|j| (0..BLOCK).map(|k| a[i][k] * b[k][j]).sum())) };
    let turned = |a: &Block| -> Block { std::array::from_fn(|i| std::array::from_fn(|j| a[j][i])) };
    let back = turned(&basis);
    for top in (0..SIZE_PX).step_by(BLOCK) {
        for left in (0..SIZE_PX).step_by(BLOCK) {
            let block: Block = std::array::from_fn(|y| std::array::from_fn(|x| f64::from(codes[(top + y) * SIZE_PX + left + x])));
            let mut waves = product(&product(&basis, &block), &back);
            waves.iter_mut().flatten().for_each(|wave| *wave = (*wave / quantiser_dn).round() * quantiser_dn);
            let seen = product(&product(&back, &waves), &basis);
            for (y, row) in seen.iter().enumerate() {
                for (x, value) in row.iter().enumerate() {
                    codes[(top + y) * SIZE_PX + left + x] = value.round().clamp(0.0, f64::from(last)) as u16;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::hidden::HiddenImage;
    use super::super::spread::PaintedProfile;
    use super::*;
    use rand::SeedableRng;

    fn camera() -> ImageCamera {
        let profile = PaintedProfile { sigma_px: 0.8, core: 0.9, wings: 2.0, beta: 3.0, axes: [0.0; 2] };
        ImageCamera { gain_e_per_dn: 2.0, bias_dn: 100.0, read_noise_e: 4.0, bits: 12, profile, blur_px: 0.5, tail_px: [0.0; 2] }
    }

    /// A converter with true weights is exact, and one with errors has the width error asked for among the codes of a sky.
    #[test]
    fn code_widths_scatter_as_asked() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let hidden = |size| [HiddenImage { kind: PixelKind::CodeWidths, size, numbers: Vec::new() }];
        let sky: Vec<(u32, f64)> = (110..290).map(|code| (code, 1.0)).collect();
        let exact = Electronics::draw(&mut rng, &camera(), &sky, Causes(&hidden(0.0)));
        assert!([0.2, 99.7, 1234.5, 4000.1].iter().all(|dn| exact.code(*dn) == *dn as u32));
        for _ in 0..60 {
            let unequal = Electronics::draw(&mut rng, &camera(), &sky, Causes(&hidden(0.03)));
            let mut widths = [0.0; 300];
            for step in 0..80_000 {
                let code = unequal.code(100.0 + f64::from(step) * 0.0025) as usize;
                widths[code.min(299)] += 0.0025;
            }
            let square = sky.iter().map(|(code, _)| (widths[*code as usize] - 1.0_f64).powi(2)).sum::<f64>() / sky.len() as f64;
            assert!((square.sqrt() - 0.03).abs() < 0.003, "{}", square.sqrt());
        }
    }

    #[test]
    fn a_full_pixel_lacks_its_share() {
        let hidden = [HiddenImage { kind: PixelKind::Nonlinearity, size: 0.03, numbers: Vec::new() }];
        let full = camera().full_e();
        let seen = amplified(&camera(), vec![full; SIZE_PX * SIZE_PX], Causes(&hidden))[0];
        assert!((1.0 - seen / full - 0.03).abs() < 3e-4, "{seen} {full}");
    }

    /// The transform of what was compressed is whole numbers of quantisers, to the rounding of the counts.
    #[test]
    fn compressed_blocks_are_rounded_in_the_cosine_transform() {
        let mut codes: Vec<u16> = (0..SIZE_PX * SIZE_PX).map(|k| 200 + (k * 7919 % 23) as u16).collect();
        compress(&mut codes, 40.0, 4095);
        let mean = |top: usize| (0..64).map(|k| f64::from(codes[(top + k / 8) * SIZE_PX + k % 8])).sum::<f64>() / 8.0;
        for top in [0, 8, 64] {
            let away = (mean(top) / 40.0).fract();
            assert!(away.min(1.0 - away) < 0.05, "{}", mean(top));
        }
    }
}

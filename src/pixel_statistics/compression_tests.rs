//! Tests of the traces of JPEG: a codec after ITU-T T.81 without its lossless stage, and skies that never met one.

use super::*;
use crate::pixel_statistics::test_random::Random;

const SIDE: usize = 512;

#[derive(Clone, Copy, Debug)]
struct Sky {
    sigma: f64,
    span: f64,
    stars: usize,
    /// Counts are multiples of this.
    step: f64,
    level: f64,
}

/// The level of every pixel without noise.
fn scene(random: &mut Random, sky: Sky) -> Vec<f64> {
    let ramp = |index: usize| sky.level + sky.span * ((index % SIDE) as f64 + 0.5 * (index / SIDE) as f64) / SIDE as f64;
    let mut levels: Vec<f64> = (0..SIDE * SIDE).map(ramp).collect();
    for _ in 0..sky.stars {
        let (x, y) = (4.0 + 503.0 * random.uniform(), 4.0 + 503.0 * random.uniform());
        let flux = 10.0 * sky.sigma / random.uniform().max(1e-4);
        for row in y as usize - 4..y as usize + 5 {
            for column in x as usize - 4..x as usize + 5 {
                let squared = (column as f64 - x).powi(2) + (row as f64 - y).powi(2);
                levels[row * SIDE + column] += flux * (-squared / 2.0).exp() / std::f64::consts::TAU;
            }
        }
    }
    levels
}

fn expose(random: &mut Random, levels: &[f64], sky: Sky) -> Vec<f32> {
    let top = (65_535.0 / sky.step).floor();
    levels.iter().map(|level| (((level + sky.sigma * random.normal()) / sky.step).round().clamp(0.0, top) * sky.step) as f32).collect()
}

/// Quantises every block by `scale`·K.1.
fn jpeg(pixels: &mut [f32], scale: f64) {
    quantise(pixels, |index| scale * TABLE[index]);
}

fn quantise(pixels: &mut [f32], quantiser: impl Fn(usize) -> f64) {
    let basis = basis();
    for (top, left) in (0..SIDE).step_by(8).flat_map(|top| (0..SIDE).step_by(8).map(move |left| (top, left))) {
        let at = |row: usize, column: usize| (top + row) * SIDE + left + column;
        let mut coefficients = [0.0; 64];
        for (index, coefficient) in coefficients.iter_mut().enumerate() {
            let sum: f64 = (0..64)
                .map(|place| basis[index / 8][place / 8] * basis[index % 8][place % 8] * f64::from(pixels[at(place / 8, place % 8)]))
                .sum();
            let quantiser = quantiser(index);
            *coefficient = quantiser * (sum / quantiser + 0.5).floor();
        }
        for place in 0..64 {
            let sum: f64 = (0..64).map(|index| basis[index / 8][place / 8] * basis[index % 8][place % 8] * coefficients[index]).sum();
            pixels[at(place / 8, place % 8)] = sum.round().clamp(0.0, 65_535.0) as f32;
        }
    }
}

const PLAIN: Sky = Sky { sigma: 5.0, span: 20.0, stars: 30, step: 1.0, level: 300.3 };

fn measured(seed: u64, sky: Sky, frames: usize, still: bool, scale: Option<f64>) -> CompressionStatistics {
    let mut random = Random::new(seed);
    let mut dct = BlockDct::new(sky.step);
    let mut levels = scene(&mut random, sky);
    for frame in 0..frames {
        if !still && frame > 0 {
            levels = scene(&mut random, sky);
        }
        let mut pixels = expose(&mut random, &levels, sky);
        if let Some(scale) = scale {
            jpeg(&mut pixels, scale);
        }
        dct.add_frame(&pixels, SIDE, SIDE, |_| true);
    }
    dct.statistics(sky.step)
}

#[test]
fn no_alarm_without_compression() {
    let mut skies = Vec::new();
    for sigma in [0.5, 0.7, 1.0, 2.0, 5.0, 10.0, 30.0] {
        skies.push((Sky { sigma, span: 0.0, stars: 0, ..PLAIN }, 1, true));
        skies.push((Sky { sigma, span: 20.0 * sigma, stars: 100, ..PLAIN }, 1, true));
        skies.push((Sky { sigma, span: 0.0, stars: 100, ..PLAIN }, 8, true));
    }
    for sigma in [5.0, 8.0, 16.0, 40.0] {
        skies.push((Sky { sigma, step: 16.0, span: 0.0, level: 1600.0, ..PLAIN }, 1, true));
        skies.push((Sky { sigma, step: 16.0, span: 300.0, level: 1600.0, ..PLAIN }, 2, true));
    }
    skies.push((Sky { sigma: 2.0, span: 300.0, stars: 200, ..PLAIN }, 4, false));
    skies.push((Sky { sigma: 3.0, level: -2.0, span: 0.0, ..PLAIN }, 2, false));
    let (mut all, mut smallest, mut largest) = (0, f64::INFINITY, 0.0_f64);
    for (kind, (sky, frames, still)) in skies.iter().enumerate() {
        for seed in 0..4 {
            let result = measured(kind as u64 * 100 + seed, *sky, *frames, *still, None);
            all += 1;
            smallest = smallest.min(result.p_value);
            let pull = (result.border_ratio.unwrap() - 1.0) / result.border_ratio_error.unwrap();
            largest = largest.max(pull.abs());
            assert!(result.p_value > 1e-3 && result.block_px.is_none(), "{sky:?} {frames}: {result:?}");
        }
    }
    println!("{all} nulls, smallest p {smallest:.3}, border ratio off 1 by at most {largest:.1} errors");
}

/// A straight border makes a whole line of blocks constant at once, and says nothing of blocks.
#[test]
fn a_border_of_one_value_is_no_compression() {
    for (name, is_border) in [("top", (|index| index < 16 * SIDE) as fn(usize) -> bool), ("left", |index| index % SIDE < 32)] {
        let mut random = Random::new(11);
        let mut dct = BlockDct::new(1.0);
        let levels = scene(&mut random, PLAIN);
        let mut pixels = expose(&mut random, &levels, PLAIN);
        pixels.iter_mut().enumerate().filter(|(index, _)| is_border(*index)).for_each(|(_, value)| *value = 0.0);
        dct.add_frame(&pixels, SIDE, SIDE, |_| true);
        let result = dct.statistics(1.0);
        assert!(result.p_value > 1e-3 && result.constant_p_value == 1.0, "{name}: {result:?}");
    }
}

/// The contrast of colours displaces coefficients of odd frequency; less the means of the colours they are those of a grey frame.
#[test]
fn the_colours_of_a_mosaic_displace_no_coefficient() {
    const CONTRAST_DN: [f32; 4] = [-30.0, 40.0, 40.0, -50.0];
    let sky = Sky { span: 0.0, stars: 0, level: 400.0, ..PLAIN };
    let mut random = Random::new(12);
    let levels = scene(&mut random, sky);
    let grey = expose(&mut random, &levels, sky);
    let mosaic: Vec<f32> =
        grey.iter().enumerate().map(|(index, value)| value + CONTRAST_DN[index % SIDE % 2 + 2 * (index / SIDE % 2)]).collect();
    let of_blocks = |pixels: &[f32], prepare: fn(&[f64; 64]) -> [f64; 64]| {
        let mut dct = BlockDct::new(1.0);
        for (row, column) in (0..SIDE / BLOCK).flat_map(|row| (0..SIDE / BLOCK).map(move |column| (row, column))) {
            let at = |k: usize| f64::from(pixels[(row * BLOCK + k / BLOCK) * SIDE + column * BLOCK + k % BLOCK]);
            dct.add_block(&prepare(&std::array::from_fn(at)), &basis());
        }
        dct.histograms
    };
    let difference = |a: &[u32], b: &[u32]| a.iter().zip(b).map(|(a, b)| u64::from(a.abs_diff(*b))).sum::<u64>();
    let mut own = BlockDct::new(1.0);
    own.add_frame(&mosaic, SIDE, SIDE, |_| true);
    let (less, raw) = (of_blocks(&grey, without_colours), of_blocks(&mosaic, |block| *block));
    let (close, far) = (difference(&own.histograms, &less), difference(&own.histograms, &raw));
    println!("{close} counts differ from the grey frame, {far} from the mosaic with its colours");
    // Means of other numbers are rounded otherwise: a few coefficients fall beside the edge of a bin.
    assert!(close < 100 && far > 10_000, "{close} {far}");
}

/// Told quantisers further than 3 % and three errors from the truth.
fn wrong(result: &CompressionStatistics, truth: impl Fn(usize) -> f64) -> usize {
    let off = |comb: &&CoefficientComb| {
        let difference = (comb.quantiser_dn - truth(comb.row * 8 + comb.column)).abs();
        difference > (0.03 * comb.quantiser_dn).max(3.0 * comb.quantiser_error_dn)
    };
    result.combs.iter().filter(off).count()
}

#[test]
fn jpeg_is_named_in_one_frame() {
    for scale in [0.03, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 4.0, 8.0] {
        for sigma in [2.0, 5.0, 10.0] {
            for seed in 0..4 {
                let result = measured(seed, Sky { sigma, ..PLAIN }, 1, true, Some(scale));
                let (told, wrong) = (result.combs.len(), wrong(&result, |index| scale * TABLE[index]));
                let CompressionStatistics { comb_p_value, table_p_value, constant_p_value, constant_share, .. } = result;
                if seed == 0 {
                    println!(
                        "q {scale:4} σ {sigma:2}: p comb {comb_p_value:8.1e} table {table_p_value:8.1e} constant {constant_p_value:8.1e}; told {told:2}, wrong {wrong}; q {:.4?} s {:.4?} ± {:.4?} scatter {:.4?}; constant {constant_share:.3} {:.3}, zero {:.3} of {:.3}, border {:.3?} ± {:.3?}",
                        result.quantiser_dn,
                        result.table_scale_dn,
                        result.table_scale_error_dn,
                        result.table_scatter,
                        result.constant_share_shifted,
                        result.zero_share,
                        result.zero_share_expected,
                        result.border_ratio,
                        result.border_ratio_error
                    );
                }
                assert!(result.block_px == Some(8) && wrong == 0, "WRONG {scale} {sigma} {seed}: {result:?}");
                if let (Some(found), Some(error)) = (result.table_scale_dn, result.table_scale_error_dn) {
                    assert!((found - scale).abs() < 1.5 * error, "WRONG {scale} {sigma} {seed}: {found} ± {error}");
                }
            }
        }
    }
}

#[test]
fn jpeg_of_shifted_counts_and_of_many_frames() {
    // 12 bits are compressed, then multiplied by 16.
    let sky = Sky { sigma: 5.0, ..PLAIN };
    let mut random = Random::new(3);
    let mut dct = BlockDct::new(16.0);
    let levels = scene(&mut random, sky);
    let mut pixels = expose(&mut random, &levels, sky);
    jpeg(&mut pixels, 0.2);
    for pixel in &mut pixels {
        *pixel *= 16.0;
    }
    dct.add_frame(&pixels, SIDE, SIDE, |_| true);
    let result = dct.statistics(16.0);
    println!("× 16: q {:?} s {:?}, told {}", result.quantiser_dn, result.table_scale_dn, result.combs.len());
    assert!(result.block_px == Some(8) && wrong(&result, |index| 3.2 * TABLE[index]) == 0, "WRONG {result:?}");
    for still in [true, false] {
        let result = measured(3, sky, 4, still, Some(0.1));
        println!(
            "4 frames: p {:.1e} q {:?} s {:?}, told {}",
            result.p_value,
            result.quantiser_dn,
            result.table_scale_dn,
            result.combs.len()
        );
        assert!(result.block_px == Some(8) && wrong(&result, |index| 0.1 * TABLE[index]) == 0);
    }
}

#[test]
fn merging_in_any_order_is_the_same_and_strange_frames_do_no_harm() {
    let mut random = Random::new(4);
    let levels = scene(&mut random, PLAIN);
    let part = |random: &mut Random| {
        let mut dct = BlockDct::new(1.0);
        dct.add_frame(&expose(random, &levels, PLAIN), SIDE, SIDE, |index| index % 5000 != 1);
        dct
    };
    let parts = [part(&mut random), part(&mut random), part(&mut random)];
    let (mut forth, mut back) = (BlockDct::new(1.0), BlockDct::new(1.0));
    for part in &parts {
        forth.merge(part);
    }
    for part in parts.iter().rev() {
        back.merge(part);
    }
    assert_eq!(forth, back);
    assert_eq!(forth.statistics(1.0), back.statistics(1.0));
    for (pixels, width, height) in
        [(vec![], 0, 0), (vec![1.0; 7], 7, 1), (vec![1.0; 64], 8, 8), (vec![f32::NAN; 4096], 64, 64), (vec![3.0; 5], 64, 64)]
    {
        let mut dct = BlockDct::new(1.0);
        dct.add_frame(&pixels, width, height, |_| true);
        let result = dct.statistics(1.0);
        assert!(result.block_px.is_none() && result.p_value == 1.0);
    }
}

#[test]
fn blurred_skies_and_other_tables() {
    for seed in 0..10 {
        let mut random = Random::new(seed);
        let levels = scene(&mut random, PLAIN);
        let sharp = expose(&mut random, &levels, PLAIN);
        let mut blurred = sharp.clone();
        for (index, value) in blurred.iter_mut().enumerate().take(SIDE * SIDE - SIDE - 1).skip(SIDE + 1) {
            let near = [index - SIDE, index - 1, index, index + 1, index + SIDE];
            *value = (near.iter().map(|place| sharp[*place]).sum::<f32>() / 5.0).round();
        }
        let mut dct = BlockDct::new(1.0);
        dct.add_frame(&blurred, SIDE, SIDE, |_| true);
        assert!(dct.statistics(1.0).p_value > 1e-3);
    }
    // All coefficients by the same quantiser.
    let mut random = Random::new(1);
    let levels = scene(&mut random, PLAIN);
    let mut pixels = expose(&mut random, &levels, PLAIN);
    quantise(&mut pixels, |_| 3.0);
    let mut dct = BlockDct::new(1.0);
    dct.add_frame(&pixels, SIDE, SIDE, |_| true);
    let result = dct.statistics(1.0);
    println!(
        "flat table: told {}, q {:?}, s {:?} scatter {:?}",
        result.combs.len(),
        result.quantiser_dn,
        result.table_scale_dn,
        result.table_scatter
    );
    assert!(result.block_px == Some(8) && wrong(&result, |_| 3.0) == 0 && result.table_scatter.unwrap() > 0.3);
}

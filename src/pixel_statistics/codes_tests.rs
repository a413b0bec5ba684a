//! Tests of the histogram of counts: nulls, clips, missing codes, and converters with unequal codes after IEEE Std 1241.

use super::*;
use crate::pixel_statistics::test_random::Random;

/// Neighbours in a mosaic are of one colour two columns apart.
#[test]
fn the_noise_of_a_mosaic_is_that_of_one_colour() {
    let mut random = Random::new(8);
    let pixels: Vec<f32> =
        (0..1 << 16).map(|index| (if index % 2 == 0 { 100.0 } else { 140.0 } + 3.0 * random.normal()).round() as f32).collect();
    let noise = |apart: usize| {
        let mut histogram = CodeHistogram::new();
        histogram.add_frame_by(apart, &pixels, |_| true);
        histogram.statistics(1.0).noise_dn.unwrap()
    };
    assert!((noise(2) - 3.0).abs() < 0.1 && noise(1) > 9.0, "{} {}", noise(2), noise(1));
}

/// Where most of the noise stays with the pixels, what is left of it is narrower than codes need.
#[test]
fn a_fixed_pattern_leaves_the_widths_untold() {
    let mut random = Random::new(9);
    let pixels: Vec<f32> = (0..1 << 17).map(|_| (100.0 + 1.6 * random.normal()).round() as f32).collect();
    let mut histogram = CodeHistogram::new();
    histogram.add_frame(&pixels, |_| true);
    let told = |share: f64| histogram.statistics(1.0).beside_pattern(share).dnl.is_some();
    assert!(told(0.0) && told(0.2) && !told(0.6));
}

/// Displaced edges e_k of codes 0..count: code k reaches from k − 1/2 + e_k to k + 1/2 + e_(k+1).
fn edges(random: &mut Random, count: usize, d: f64) -> Vec<f64> {
    (0..=count).map(|_| (d / 2.0_f64.sqrt() * random.normal()).clamp(-0.45, 0.45)).collect()
}

/// A histogram drawn from its expectation: Gaussians (pixels, level, sigma) in steps through a converter.
fn drawn(random: &mut Random, levels: &[(f64, f64, f64)], edges: &[f64], step: usize) -> CodeHistogram {
    let mut histogram = CodeHistogram::new();
    let codes = edges.len() - 1;
    for place in 0..codes {
        let cdf = |edge: f64, level: f64, sigma: f64| normal_cdf((edge - level) / sigma);
        let (low, high) = (place as f64 - 0.5 + edges[place], place as f64 + 0.5 + edges[place + 1]);
        let mean = levels.iter().map(|&(pixels, level, sigma)| pixels * (cdf(high, level, sigma) - cdf(low, level, sigma))).sum();
        histogram.counts[4096 + place * step] = random.poisson(mean);
    }
    for &(_, level, sigma) in levels.iter().cycle().take(levels.len().max(20_000)) {
        let mut code = || (level + sigma * random.normal()).round();
        let difference = (code() - code()).abs() as usize * step;
        if difference < DIFFERENCES {
            histogram.differences[difference] += 1;
        }
    }
    histogram
}

fn truth(edges: &[f64]) -> f64 {
    (edges.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum::<f64>() / (edges.len() - 1) as f64).sqrt()
}

type Levels = Vec<(f64, f64, f64)>;
const FRAME_PX: f64 = 262_144.0;

/// p-values of converters without fault over 30 seeds.
fn null(name: &str, levels: &Levels) -> Vec<f64> {
    let results: Vec<_> = (0..30).map(|seed| drawn(&mut Random::new(seed), levels, &[0.0; 2001], 1).statistics(1.0)).collect();
    let p_values: Vec<f64> = results.iter().filter_map(|result| result.dnl.as_ref().map(|dnl| dnl.p_value)).collect();
    let below = |limit: f64| p_values.iter().filter(|p| **p < limit).count();
    let ends = results.iter().flat_map(|result| [&result.black, &result.white]).flatten().filter(|end| end.p_value < 1e-3).count();
    println!("{name:28} told {:3} below .5: {:2} .05: {} .001: {} ends {ends}", p_values.len(), below(0.5), below(0.05), below(0.001));
    assert!(results.iter().all(|result| result.step_dn == Some(1) && result.missing.as_ref().is_none_or(|missing| missing.number == 0)));
    assert_eq!(ends, 0, "{name}: no clip");
    p_values
}

#[test]
fn no_alarm_without_unequal_codes() {
    let gradient = |span: f64, sigma: f64, brighter: f64| -> Levels {
        let place = |index: i32| f64::from(index % 100) / 100.0;
        let level = |index: i32| 100.3 + span * place(index) + f64::from(index / 100) * 0.8 * sigma;
        (0..1600).map(|i| (FRAME_PX / 100.0, level(i), sigma * (1.0 + (brighter - 1.0) * place(i)))).collect()
    };
    let mut skies =
        vec![("gradient 100".to_owned(), gradient(100.0, 5.0, 1.0)), ("gradient 1000, brighter".to_owned(), gradient(1000.0, 10.0, 1.3))];
    for (sigma, frames) in [(1.5, 1.0), (1.5, 16.0), (2.0, 16.0), (5.0, 1.0), (5.0, 16.0), (5.0, 64.0), (10.0, 16.0), (30.0, 16.0)] {
        skies.push((format!("level, σ {sigma}, {frames} frames"), vec![(FRAME_PX * frames, 400.3, sigma)]));
    }
    for (sigma, gap) in [(1.5, 6.0), (3.0, 18.0), (10.0, 60.0), (30.0, 180.0)] {
        let half = FRAME_PX * 8.0;
        skies.push((format!("two levels, σ {sigma}, {gap} apart"), vec![(half, 300.3, sigma), (half, 300.3 + gap, sigma)]));
    }
    let (mut told, mut below_5, mut below_01) = (0, 0, 0);
    for (name, levels) in &skies {
        let p_values = null(name, levels);
        assert!(p_values.len() >= 15, "{name}");
        told += p_values.len();
        below_5 += p_values.iter().filter(|p| **p < 0.05).count();
        below_01 += p_values.iter().filter(|p| **p < 0.001).count();
    }
    println!("all: {told} told, {below_5} below 0.05, {below_01} below 0.001");
    assert!(below_5 * 100 < told * 8 && below_01 * 1000 < told * 8);
}

#[test]
fn narrow_noise_tells_no_widths() {
    for sigma in [0.3, 0.6, 0.8, 1.0] {
        for level in [400.0, 400.3, 400.5] {
            let result = drawn(&mut Random::new(7), &[(FRAME_PX * 16.0, level, sigma)], &[0.0; 2001], 1).statistics(1.0);
            assert!(result.dnl.is_none() && result.missing.is_none(), "{sigma} {result:?}");
            println!("{sigma} {level} {:?} {:?}", result.black, result.white);
            assert!(result.black.is_none_or(|end| end.p_value > 1e-3) && result.white.is_none_or(|end| end.p_value > 1e-3));
        }
    }
}

#[test]
fn widths_are_recovered_within_the_error() {
    for (frames, sigma, d) in [
        (1.0, 10.0, 0.1),
        (16.0, 2.0, 0.1),
        (16.0, 5.0, 0.1),
        (16.0, 10.0, 0.05),
        (16.0, 10.0, 0.1),
        (16.0, 10.0, 0.3),
        (16.0, 30.0, 0.1),
        (16.0, 30.0, 0.8),
    ] {
        let (mut pulls, mut ratio, mut error) = (Vec::new(), 0.0, 0.0);
        for seed in 0..200 {
            let mut random = Random::new(1000 + seed);
            let edges = edges(&mut random, 2000, d);
            let result = drawn(&mut random, &[(FRAME_PX * frames, 500.3, sigma)], &edges, 1).statistics(1.0).dnl.expect("told");
            assert!(result.p_value < 1e-6, "σ {sigma} D {d}: {result:?}");
            pulls.push((result.dnl_steps - truth(&edges)) / result.dnl_error_steps);
            ratio += result.dnl_steps / truth(&edges) / 200.0;
            error += result.dnl_error_steps / 200.0;
        }
        let mean = pulls.iter().sum::<f64>() / 200.0;
        let rms = (pulls.iter().map(|pull| pull * pull).sum::<f64>() / 200.0).sqrt();
        println!("frames {frames:2} σ {sigma:2} D {d}: found/true {ratio:.3}, error {error:.4}, pull mean {mean:.2} rms {rms:.2}");
        assert!((ratio - 1.0).abs() < if sigma < 3.0 { 0.13 } else { 0.08 } && rms > 0.5 && rms < 1.35);
    }
}

/// Frames of a sky with a gradient and stars, through a converter; counts in steps times `step`.
fn frames(
    random: &mut Random,
    number: usize,
    (sigma, span): (f64, f64),
    stars: usize,
    edges: &[f64],
    step: f64,
    top: f64,
) -> CodeHistogram {
    let side = 512;
    let mut histogram = CodeHistogram::new();
    for frame in 0..number {
        let mut sky: Vec<f64> = (0..side * side)
            .map(|index| 100.0 + 3.0 * frame as f64 + span * (index % side + index / side) as f64 / (2 * side) as f64)
            .collect();
        for _ in 0..stars {
            let (x, y) = (4.0 + 503.0 * random.uniform(), 4.0 + 503.0 * random.uniform());
            let flux = 200.0 * random.uniform().max(1e-3).powf(-1.0);
            for row in y as usize - 4..y as usize + 5 {
                for column in x as usize - 4..x as usize + 5 {
                    let squared = (column as f64 - x).powi(2) + (row as f64 - y).powi(2);
                    sky[row * side + column] += flux * (-squared / 2.0).exp() / std::f64::consts::TAU;
                }
            }
        }
        let convert = |level: f64, random: &mut Random| {
            let signal = level + (sigma * sigma + 0.2 * (level - 100.0)).sqrt() * random.normal();
            let code = signal.round().clamp(0.0, edges.len() as f64 - 3.0) as usize;
            let place = code as f64;
            let code = if signal < place - 0.5 + edges[code] {
                place - 1.0
            } else if signal >= place + 0.5 + edges[code + 1] {
                place + 1.0
            } else {
                place
            };
            (code.clamp(0.0, top) * step) as f32
        };
        let pixels: Vec<f32> = sky.iter().map(|level| convert(*level, random)).collect();
        histogram.add_frame(&pixels, |index| index % 1000 != 17);
    }
    histogram
}

#[test]
fn stars_make_no_alarm_and_saturation_is_named() {
    for seed in 0..6 {
        let mut random = Random::new(seed);
        let result = frames(&mut random, 8, (4.0, 60.0), 120, &vec![0.0; 66_000], 1.0, 4095.0).statistics(1.0);
        let (dnl, white) = (result.dnl.unwrap(), result.white.unwrap());
        println!(
            "stars: chi2 {:.0} of {} p {:.3}, white p {:e} excess {:e}",
            dnl.chi2, dnl.codes, dnl.p_value, white.p_value, white.excess_share
        );
        assert!(dnl.p_value > 1e-3 && result.missing.unwrap().number == 0);
        assert!(white.p_value < 1e-6 && result.highest_dn == Some(4095) && result.black.unwrap().p_value > 0.01);
        let open = frames(&mut random, 2, (4.0, 60.0), 120, &vec![0.0; 66_000], 1.0, 65_535.0).statistics(1.0);
        assert!(open.white.is_none_or(|end| end.p_value > 1e-3));
    }
}

#[test]
fn lost_bits_and_widths_in_steps() {
    for seed in 0..4 {
        let mut random = Random::new(seed);
        let edges = edges(&mut random, 4096, 0.1);
        let result = frames(&mut random, 16, (4.0, 0.0), 60, &edges, 16.0, 4095.0).statistics(1.0);
        let dnl = result.dnl.unwrap();
        println!("0 mod 16: D {:.3} ± {:.3} steps of {:.3}, p {:e}", dnl.dnl_steps, dnl.dnl_error_steps, truth(&edges), dnl.p_value);
        assert_eq!((result.step_dn, result.offset_dn, result.lost_bits), (Some(16), Some(0), Some(4)));
        assert!(
            (dnl.dnl_steps - 0.1).abs() < 4.0 * dnl.dnl_error_steps
                && dnl.p_value < 1e-9
                && (dnl.dnl_dn / dnl.dnl_steps - 16.0).abs() < 1e-9
        );
        let plain = frames(&mut random, 4, (4.0, 30.0), 60, &vec![0.0; 4097], 16.0, 4095.0).statistics(1.0);
        assert!(plain.dnl.unwrap().p_value > 1e-3);
    }
}

#[test]
fn clipped_black_is_named() {
    // The level lies −1 to 3 σ from the clip; at 3 σ the pile is as high as an unclipped code.
    for (distance, named) in [(-1.0, true), (0.0, true), (1.0, true), (2.0, true)] {
        let sigma = 8.0;
        let mut random = Random::new(3);
        let mut histogram = CodeHistogram::new();
        let pixels: Vec<f32> = (0..262_144).map(|_| (distance * sigma + sigma * random.normal()).round().max(0.0) as f32).collect();
        histogram.add_frame(&pixels, |_| true);
        let result = histogram.statistics(1.0);
        let black = result.black.unwrap();
        println!("clip {distance} σ: {black:?}, dnl {:?}", result.dnl.map(|dnl| dnl.p_value));
        assert!((black.p_value < 1e-6) == named && black.code_dn == 0);
        assert!((black.share - normal_cdf(-distance + 0.5 / sigma)).abs() < 0.005);
    }
}

#[test]
fn electrons_in_whole_numbers() {
    for (read_noise_e, frames, comb) in [(0.0, 1, true), (0.5, 1, false), (0.8, 8, false)] {
        let mut random = Random::new(9);
        let mut histogram = CodeHistogram::new();
        for _ in 0..frames {
            let count = |random: &mut Random| ((random.poisson(45.0) as f64 + read_noise_e * random.normal()) / 0.7 + 100.0).round() as f32;
            let pixels: Vec<f32> = (0..262_144).map(|_| count(&mut random)).collect();
            histogram.add_frame(&pixels, |_| true);
        }
        let result = histogram.statistics(1.0);
        let dnl = result.dnl.unwrap();
        println!("read noise {read_noise_e} e: {dnl:?}, missing {:?}", result.missing);
        assert!(if comb { dnl.p_value < 1e-9 } else { dnl.p_value > 1e-3 });
    }
}

#[test]
fn missing_codes_are_listed() {
    let mut edges = vec![0.0; 2001];
    // Code 402 has no width: its neighbours share it.
    (edges[402], edges[403]) = (0.5, -0.5);
    let result = drawn(&mut Random::new(1), &[(FRAME_PX, 400.3, 6.0)], &edges, 1).statistics(1.0);
    assert_eq!(result.missing, Some(MissingCodes { number: 1, codes_dn: vec![402] }));
    assert!(result.dnl.unwrap().p_value < 1e-9);
}

#[test]
fn merging_in_any_order_is_the_same_and_computed_counts_tell_nothing() {
    let mut random = Random::new(2);
    let parts: Vec<_> = (0..3).map(|_| frames(&mut random, 1, (3.0, 20.0), 10, &vec![0.0; 5000], 1.0, 4095.0)).collect();
    let (mut forth, mut back) = (CodeHistogram::new(), CodeHistogram::new());
    for part in &parts {
        forth.merge(part);
    }
    for part in parts.iter().rev() {
        back.merge(part);
    }
    assert_eq!(forth, back);
    assert_eq!(forth.statistics(1.0), back.statistics(1.0));
    forth.add_frame(&[0.5, f32::NAN, 1e9, 70_000.0, -5000.0], |_| true);
    let result = forth.statistics(1.0);
    assert_eq!((result.not_whole, result.outside, result.step_dn), (1, 3, None));
    for few in [vec![], vec![5.0], vec![5.0, 6.0], vec![5.0; 100], vec![5.0, 21.0, 37.0, 99.0]] {
        let mut histogram = CodeHistogram::new();
        histogram.add_frame(&few, |_| true);
        let result = histogram.statistics(1.0);
        assert!(result.dnl.is_none() && result.lost_bits.is_none_or(|bits| bits == 0), "{result:?}");
    }
}

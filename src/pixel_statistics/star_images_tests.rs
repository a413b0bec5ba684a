//! Sums of star images against images and noise that are known.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

use super::*;

const SIDE: usize = 49;
const SKY_DN: f64 = 300.0;

/// A frame with one star: `shape` gives the image's density at a place from its centre, which every pixel sums on a fine grid.
fn frame(centre: [f64; 2], flux_dn: f64, shape: impl Fn(f64, f64) -> f64) -> Frame {
    const FINE: usize = 9;
    let mut pixels = vec![0.0; SIDE * SIDE];
    for (index, pixel) in pixels.iter_mut().enumerate() {
        let (x, y) = ((index % SIDE) as f64, (index / SIDE) as f64);
        for fine in 0..FINE * FINE {
            let at = |k: usize| (k as f64 + 0.5) / FINE as f64 - 0.5;
            *pixel += shape(x + at(fine % FINE) - centre[0], y + at(fine / FINE) - centre[1]) / (FINE * FINE) as f64;
        }
    }
    let all: f64 = pixels.iter().sum();
    let pixels_dn = pixels.iter().map(|share| (SKY_DN + flux_dn * share / all) as f32).collect();
    Frame { width_px: SIDE, height_px: SIDE, pixels_dn, saturation_dn: 1e9 }
}

fn image(frame: &Frame, at: [f64; 2], sigma_px: f64, noise_dn: f64) -> SummedImage {
    let stars = [StarDisc { x_px: at[0], y_px: at[1], radius_px: 5.0 }];
    ImageFrame { frame, stars: &stars, flux_dn: &[], bad: None, sigma_px, noise_dn }.star_images()[0].expect("an image")
}

fn gaussian(sxx: f64, sxy: f64, syy: f64) -> impl Fn(f64, f64) -> f64 {
    let determinant = sxx * syy - sxy * sxy;
    move |x, y| (-0.5 * (syy * x * x - 2.0 * sxy * x * y + sxx * y * y) / determinant).exp()
}

/// (1 + (r/α)²)^−β with the wings of real lenses.
fn moffat(x: f64, y: f64) -> f64 {
    (1.0 + f64::midpoint(x * x, y * y)).powf(-2.5)
}

#[test]
fn a_gaussian_image_has_its_own_light_and_matrix_under_any_weight() {
    for (weight_px, matrix) in [(1.0, [1.2, 0.2, 0.9]), (1.2, [0.9, 0.0, 0.9]), (0.9, [1.5, -0.3, 1.1])] {
        let [xx, xy, yy] = matrix;
        let found = image(&frame([24.3, 23.8], 5e4, gaussian(xx, xy, yy)), [24.4, 23.7], weight_px, 1.0);
        assert!((found.flux_dn / 5e4 - 1.0).abs() < 3e-3, "{found:?}");
        for (got, want) in found.second_px2.iter().zip(matrix) {
            assert!((got - want).abs() < 0.015, "{found:?} for {matrix:?}");
        }
        // The places of the pixels leave two hundredths.
        assert!(found.skewness.iter().all(|skew| skew.abs() < 0.03), "{found:?}");
    }
}

/// Bright and faint stars with the same winged image have the same shape and the same share of light; a Gaussian fit would not.
#[test]
fn what_is_told_does_not_go_with_the_brightness() {
    let of = |flux_dn: f64| image(&frame([24.2, 24.4], flux_dn, moffat), [24.2, 24.4], 0.9, 1.0);
    let (faint, bright) = (of(300.0), of(3e6));
    assert!((faint.flux_dn / 300.0 / (bright.flux_dn / 3e6) - 1.0).abs() < 1e-3, "{faint:?} {bright:?}");
    for (a, b) in faint.second_px2.iter().zip(bright.second_px2) {
        assert!((a - b).abs() < 2e-3, "{faint:?} {bright:?}");
    }
}

/// Deviations over 400 noisy stars against the errors stated: Poisson noise of the light and normal noise of the sky.
#[test]
fn the_errors_are_those_of_many_stars() {
    const STARS: u64 = 400;
    let (gain, noise_dn) = (2.0, 4.0);
    for flux_dn in [1.5e3, 3e4] {
        let clean = frame([24.3, 24.1], flux_dn, gaussian(1.0, 0.0, 1.0));
        let pulls: Vec<[f64; 4]> = (0..STARS)
            .map(|seed| {
                let mut rng = Pcg64Mcg::seed_from_u64(seed);
                let mut noisy = clean.clone();
                for pixel in &mut noisy.pixels_dn {
                    let variance = noise_dn * noise_dn + (f64::from(*pixel) - SKY_DN).max(0.0) / gain;
                    let step: f64 = StandardNormal.sample(&mut rng);
                    *pixel += (step * variance.sqrt()) as f32;
                }
                let at = [24.3 + 0.02 * (rng.random::<f64>() - 0.5), 24.1];
                let own = image(&noisy, at, 1.0, noise_dn);
                let pull = |value: f64, truth: f64, variance: SplitVariance| (value - truth) / variance.sigma(1.0 / gain);
                [
                    pull(own.flux_dn, flux_dn, own.flux_variance),
                    pull(own.second_px2[0], 1.0, own.second_variance[0]),
                    pull(own.second_px2[1], 0.0, own.second_variance[1]),
                    pull(own.skewness[0], 0.0, own.skewness_variance[0]),
                ]
            })
            .collect();
        for k in 0..4 {
            let scatter = (pulls.iter().map(|own| own[k] * own[k]).sum::<f64>() / STARS as f64).sqrt();
            assert!((0.85..1.18).contains(&scatter), "number {k} at {flux_dn} DN: {scatter}");
        }
    }
}

/// The standard error of a second moment over the Cramér–Rao bound, with light, centre, the other moments and the level free: bright stars, whose own light
/// is their noise, and faint ones under the sky's. A weight as wide as the image gives 1.3 to 1.4 for the brightest.
#[test]
fn shapes_are_known_nearly_as_well_as_pixels_allow() {
    use nalgebra::{DMatrix, DVector};
    const NOISE_E: f64 = 11.4;
    const STEP: f64 = 1e-2;
    let mut ratios = Vec::new();
    for sigma_px in [0.7_f64, 1.0, 1.4] {
        let square = sigma_px * sigma_px;
        let pixels = |at: [f64; 2], [xx, xy, yy]: [f64; 3]| -> DVector<f64> {
            // Counts are kept as f32: of much light their rounding does not count.
            const MUCH_DN: f64 = 1e6;
            let frame = frame(at, MUCH_DN, gaussian(xx, xy, yy));
            DVector::from_iterator(SIDE * SIDE, frame.pixels_dn.iter().map(|own| (f64::from(*own) - SKY_DN) / MUCH_DN))
        };
        let at = |k: usize, step: f64| {
            let mut numbers = [24.3, 23.8, square, 0.0, square];
            numbers[k] += step;
            pixels([numbers[0], numbers[1]], [numbers[2], numbers[3], numbers[4]])
        };
        for flux_e in [1e3, 3e3, 1e4, 5e4] {
            let image_e = at(0, 0.0) * flux_e;
            let mut columns: Vec<DVector<f64>> = (0..5).map(|k| (at(k, STEP) - at(k, -STEP)) * (0.5 * flux_e / STEP)).collect();
            columns.extend([image_e.clone(), DVector::repeat(SIDE * SIDE, 1.0)]);
            let design = DMatrix::from_columns(&columns);
            let weight = image_e.map(|own| (own.max(0.0) + NOISE_E * NOISE_E).recip());
            let weighted = DMatrix::from_fn(design.nrows(), design.ncols(), |i, j| design[(i, j)] * weight[i]);
            let bound = design.tr_mul(&weighted).cholesky().unwrap().inverse()[(2, 2)].sqrt();
            let own = image(&frame([24.3, 23.8], flux_e, gaussian(square, 0.0, square)), [24.3, 23.8], sigma_px, NOISE_E);
            ratios.push((sigma_px, flux_e, own.second_variance[0].sigma(1.0) / bound));
        }
    }
    println!("width/px, electrons, standard error over the bound: {ratios:.2?}");
    assert!(ratios.iter().all(|(.., ratio)| (0.98..1.2).contains(ratio)), "{ratios:.2?}");
}

#[test]
fn a_star_at_the_edge_or_with_a_bad_pixel_is_left_out() {
    let frame = frame([24.0, 24.0], 1e4, moffat);
    let at = |x_px: f64, y_px: f64, bad: Option<&[bool]>| {
        let stars = [StarDisc { x_px, y_px, radius_px: 5.0 }];
        ImageFrame { frame: &frame, stars: &stars, flux_dn: &[], bad, sigma_px: 0.9, noise_dn: 1.0 }.star_images()[0]
    };
    assert!(at(24.0, 24.0, None).is_some());
    assert!(at(4.0, 24.0, None).is_none());
    let mut bad = vec![false; SIDE * SIDE];
    bad[24 * SIDE + 25] = true;
    assert!(at(24.0, 24.0, Some(&bad)).is_none());
}

/// A star with a neighbour of a twentieth to a third of its light: light and shape over many noisy frames against those of the star alone, in the errors
/// stated; and what the neighbour would have made of them.
#[test]
fn the_light_of_neighbours_is_taken_off() {
    const STARS: u64 = 200;
    const WIDTH: usize = 6 * SIDE;
    let (gain, noise_dn, flux_dn) = (2.0, 4.0, 3e4);
    // Six stars that stand alone tell the image; the last has a neighbour.
    let place = |k: usize| [(SIDE * k) as f64 + 24.3 + 0.13 * k as f64, 23.9 + 0.17 * (k % 3) as f64];
    for (share, apart) in [(0.05, [4.2, 0.0]), (0.1, [-3.5, 3.5]), (0.3, [0.0, 6.0])] {
        let middle = place(5);
        let beside = [middle[0] + apart[0], middle[1] + apart[1]];
        let mut clean = vec![SKY_DN as f32; WIDTH * SIDE];
        let lit = |at: [f64; 2], flux_dn: f64, clean: &mut [f32]| {
            let shift = SIDE * (at[0] as usize / SIDE);
            let own = frame([at[0] - shift as f64, at[1]], flux_dn, moffat);
            for (k, dn) in own.pixels_dn.iter().enumerate() {
                clean[k / SIDE * WIDTH + shift + k % SIDE] += dn - SKY_DN as f32;
            }
        };
        (0..6).for_each(|k| lit(place(k), flux_dn, &mut clean));
        let without = clean.clone();
        lit(beside, share * flux_dn, &mut clean);
        let stars: Vec<StarDisc> = (0..6).map(place).chain([beside]).map(|[x_px, y_px]| StarDisc { x_px, y_px, radius_px: 6.0 }).collect();
        let sigma_dn = 0.03 * share * flux_dn;
        let summed = |seed: u64, neighbour_dn: [f64; 2], clean: &[f32], has_noise: bool| -> SummedImage {
            let mut rng = Pcg64Mcg::seed_from_u64(seed);
            let noisy = |dn: &f32| {
                let variance = noise_dn * noise_dn + (f64::from(*dn) - SKY_DN).max(0.0) / gain;
                let step: f64 = StandardNormal.sample(&mut rng);
                if has_noise { dn + (step * variance.sqrt()) as f32 } else { *dn }
            };
            let pixels_dn = clean.iter().map(noisy).collect();
            let frame = Frame { width_px: WIDTH, height_px: SIDE, pixels_dn, saturation_dn: 1e9 };
            let mut flux = vec![[flux_dn, 0.01 * flux_dn]; 6];
            flux.push(neighbour_dn);
            ImageFrame { frame: &frame, stars: &stars, flux_dn: &flux, bad: None, sigma_px: 0.9, noise_dn }.star_images()[5].unwrap()
        };
        let alone = summed(0, [0.0, sigma_dn], &without, false);
        let numbers = |own: &SummedImage| [own.flux_dn, own.second_px2[0], own.second_px2[1], own.second_px2[2]];
        // A neighbour that is held to be dark stays in the image.
        let blended = summed(0, [0.0, sigma_dn], &clean, false);
        let mut squares = [0.0; 4];
        for seed in 0..STARS {
            let mut rng = Pcg64Mcg::seed_from_u64(1000 + seed);
            let step: f64 = StandardNormal.sample(&mut rng);
            let own = summed(seed, [share * flux_dn + step * sigma_dn, sigma_dn], &clean, true);
            let variances = [own.flux_variance, own.second_variance[0], own.second_variance[1], own.second_variance[2]];
            for k in 0..4 {
                squares[k] += ((numbers(&own)[k] - numbers(&alone)[k]) / variances[k].sigma(1.0 / gain)).powi(2);
            }
        }
        let scatter = squares.map(|sum| (sum / STARS as f64).sqrt());
        let errors = [alone.flux_variance, alone.second_variance[0], alone.second_variance[1], alone.second_variance[2]];
        let off = (0..4).map(|k| (numbers(&blended)[k] - numbers(&alone)[k]).abs() / errors[k].sigma(1.0 / gain)).fold(0.0, f64::max);
        println!(
            "{share} of the light at {apart:?}: rms over the errors {scatter:.2?}; {off:.1} standard errors of the worst if it stayed"
        );
        assert!(scatter.iter().all(|own| (0.6..1.3).contains(own)), "{share} at {apart:?}: {scatter:?}");
        assert!(off > 1.8, "{off}: the test could not fail");
    }
}

/// A neighbour that is full, or too near, or as bright as the star: nothing is told.
#[test]
fn a_star_beside_too_much_light_is_left_out() {
    let frame = frame([24.0, 24.0], 1e4, moffat);
    let at = |distance_px: f64, flux_dn: [f64; 2]| {
        let stars =
            [StarDisc { x_px: 24.0, y_px: 24.0, radius_px: 5.0 }, StarDisc { x_px: 24.0 + distance_px, y_px: 24.0, radius_px: 5.0 }];
        ImageFrame { frame: &frame, stars: &stars, flux_dn: &[[1e4, 1e2], flux_dn], bad: None, sigma_px: 0.9, noise_dn: 1.0 }.star_images()
            [0]
    };
    assert!(at(4.0, [300.0, 30.0]).is_some());
    assert!(at(2.0, [300.0, 30.0]).is_none());
    assert!(at(4.0, [300.0, f64::INFINITY]).is_none());
    assert!(at(2.8, [6e3, 30.0]).is_none());
}

/// Discs of faint stars cover the ring: their light is taken off there, and the level is that of the sky.
#[test]
fn a_ring_that_faint_stars_light_tells_the_level() {
    let place = |k: usize| {
        let (sin, cos) = (std::f64::consts::TAU * k as f64 / 6.0).sin_cos();
        [24.0 + 8.5 * cos, 24.0 + 8.5 * sin]
    };
    let faint_dn = 400.0;
    let mut whole = frame([24.0, 24.0], 1e4, gaussian(0.8, 0.0, 0.8));
    for k in 0..6 {
        let own = frame(place(k), faint_dn, gaussian(0.8, 0.0, 0.8));
        whole.pixels_dn.iter_mut().zip(own.pixels_dn).for_each(|(sum, dn)| *sum += dn - SKY_DN as f32);
    }
    let disc = |[x_px, y_px]: [f64; 2]| StarDisc { x_px, y_px, radius_px: 8.0 };
    let stars: Vec<StarDisc> = [[24.0, 24.0]].into_iter().chain((0..6).map(place)).map(disc).collect();
    let of = |faint: [f64; 2]| {
        let flux_dn: Vec<[f64; 2]> = [[1e4, 1e2]].into_iter().chain([faint; 6]).collect();
        ImageFrame { frame: &whole, stars: &stars, flux_dn: &flux_dn, bad: None, sigma_px: 0.9, noise_dn: 10.0 }.star_images()[0]
    };
    let told = of([faint_dn, 20.0]).expect("an image");
    assert!((told.flux_dn / 1e4 - 1.0).abs() < 0.01, "{told:?}");
    // Where their light is not known no pixel of the ring is left.
    assert!(of([faint_dn, f64::INFINITY]).is_none());
}

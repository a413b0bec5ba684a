//! Two calibrations of one camera: the p-value is what it says, and a change is found and put in its place.

use std::sync::LazyLock;

use boresight::calibrate::trial::Trial;
use boresight::calibrate::{
    CalibrateOptions, Calibration, Comparison, MapChange, Method, calibrate, compare, map_change, map_sigma, mapping_error_px,
};
use boresight::camera::Camera;
use boresight::catalog::Catalog;
use rayon::prelude::*;

use super::options;

const PAIRS: usize = 150;
const SIDE: usize = 17;

/// Small nights, so that there can be many.
fn small() -> Trial {
    Trial { frames: 6, stars_per_frame: 14, attitude_sigma_rad: None, ..Trial::published() }
}

fn solved(trial: &Trial, seed: u64, options: &CalibrateOptions) -> Calibration {
    calibrate(&trial.night(Catalog::embedded(), seed).control_points, options).unwrap()
}

/// Pairs of calibrations of the unchanged camera from independent nights.
static PAIRS_OF_NIGHTS: LazyLock<Vec<[Calibration; 2]>> = LazyLock::new(|| {
    let bundle = options(Method::Bundle);
    (0..PAIRS as u64).into_par_iter().map(|pair| [0, 1].map(|k| solved(&small(), 7_000 + 2 * pair + k, &bundle))).collect()
});

/// Largest distance between the distribution of these values and the uniform one.
fn kolmogorov_smirnov(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len() as f64;
    let off = |(k, p): (usize, &f64)| (p - k as f64 / n).max((k as f64 + 1.0) / n - p);
    values.iter().enumerate().map(off).fold(0.0, f64::max)
}

/// The distance that 1 % of sets of this size reach by chance (Smirnov's limit, with Stephens' correction for small sets).
fn limit_at_one_percent(count: usize) -> f64 {
    let root = (count as f64).sqrt();
    1.628 / (root + 0.12 + 0.11 / root)
}

#[test]
fn p_values_of_an_unchanged_camera_are_uniform() {
    let p: Vec<f64> = PAIRS_OF_NIGHTS.iter().map(|[a, b]| compare(a, b).unwrap().p_value.unwrap()).collect();
    let low = p.iter().filter(|p| **p < 0.05).count();
    let distance = kolmogorov_smirnov(p.clone());
    println!("{PAIRS} pairs: Kolmogorov-Smirnov distance {distance:.4} (limit {:.4}); p < 0.05 in {low}", limit_at_one_percent(PAIRS));
    assert!(distance < limit_at_one_percent(PAIRS));
    // The test can fail: errors stated 30 % too small or too large are seen.
    for factor in [0.7_f64, 1.3] {
        let skewed = PAIRS_OF_NIGHTS[..40].iter().map(|pair| {
            let [a, b] = pair.clone().map(|mut calibration| {
                calibration.covariance.iter_mut().flatten().for_each(|value| *value *= factor * factor);
                calibration
            });
            compare(&a, &b).unwrap().p_value.unwrap()
        });
        let distance = kolmogorov_smirnov(skewed.collect());
        println!("errors × {factor}: {distance:.4}");
        assert!(distance > limit_at_one_percent(40), "errors × {factor}: {distance}");
    }
}

#[test]
fn the_difference_over_the_frame_is_as_large_as_its_standard_error() {
    let mut sums = vec![(0.0, 0.0); SIDE * SIDE];
    for [a, b] in PAIRS_OF_NIGHTS.iter() {
        for (sum, point) in sums.iter_mut().zip(map_change(a, b, SIDE).unwrap()) {
            sum.0 += point.dx_px.powi(2) + point.dy_px.powi(2);
            sum.1 += point.sigma_px.unwrap().powi(2);
        }
    }
    let mean = |sums: &[(f64, f64)]| (sums.iter().map(|s| s.0).sum::<f64>() / sums.iter().map(|s| s.1).sum::<f64>()).sqrt();
    let corners = [0, SIDE - 1, SIDE * (SIDE - 1), SIDE * SIDE - 1].map(|k| sums[k]);
    let middle = sums[SIDE * SIDE / 2];
    let (all, corners, middle) = (mean(&sums), mean(&corners), mean(&[middle]));
    println!("rms difference over its standard error: {all:.3} over the frame, {corners:.3} in the corners, {middle:.3} in the middle");
    // 150 pairs of few independent combinations: about 3 % over the frame, 6 % at one place.
    assert!((all - 1.0).abs() < 0.1 && (corners - 1.0).abs() < 0.15 && (middle - 1.0).abs() < 0.2, "{all} {corners} {middle}");
}

#[test]
fn a_longer_focal_length_is_found_and_points_outwards() {
    let bundle = options(Method::Bundle);
    let before = &PAIRS_OF_NIGHTS[0][0];
    let sigma = |name: &str, calibration: &Calibration| calibration.parameters.iter().find(|p| p.name == name).unwrap().sigma;
    let step = 5.0 * 2_f64.sqrt() * sigma("f", before);
    let truth = Camera { focal_length_px: small().truth.focal_length_px + step, ..small().truth };
    let found: Vec<Comparison> = (0..12)
        .map(|k| compare(&PAIRS_OF_NIGHTS[k][0], &solved(&Trial { truth, ..small() }, 9_000 + k as u64, &bundle)).unwrap())
        .collect();
    let p: Vec<f64> = found.iter().map(|comparison| comparison.p_value.unwrap()).collect();
    println!("f + {step:.2} px (5 standard errors of the difference): p = {p:?}");
    // χ² grows by 25 at least: by as much as f alone is off, and by more, as no other parameter has changed to make up for it.
    assert!(p.iter().all(|p| *p < 1e-3), "{p:?}");
    for comparison in &found {
        let focal = comparison.parameters.iter().find(|p| p.name == "f").unwrap();
        assert!((focal.difference - step).abs() < 5.0 * focal.sigma, "{focal:?}");
        let map = &comparison.difference_map;
        assert_eq!(map.len(), 81);
        assert_eq!([map[0].x_px, map[0].y_px, map[80].x_px, map[80].y_px], [0.0, 0.0, 1023.0, 1023.0]);
    }
    // Exactly known cameras: f grows by a part in a thousand, and the images go outwards by that part of their distance.
    let exact = |f: f64| Calibration { chain: None, camera: Camera::pinhole(1024, 1024, f), ..before.clone() };
    let change = map_change(&exact(2800.0), &exact(2802.8), 3).unwrap();
    let [first, middle, last] = [change[0], change[4], change[8]];
    assert!((last.dx_px - 0.5115).abs() < 0.02 && (last.dy_px - 0.5115).abs() < 0.02, "{last:?}");
    assert!((first.dx_px + 0.5115).abs() < 0.02 && middle.dx_px.hypot(middle.dy_px) < 1e-6, "{first:?} {middle:?}");
    assert!(last.significance().unwrap() > middle.significance().unwrap());
}

#[test]
fn the_standard_error_of_the_map_is_the_scatter_of_the_map() {
    let all: Vec<&Calibration> = PAIRS_OF_NIGHTS.iter().map(|[first, _]| first).collect();
    let (mut square, mut stated) = (0.0, 0.0);
    for calibration in &all {
        let sigma = map_sigma(calibration, 25).unwrap();
        assert_eq!((sigma.len(), sigma[24].0.x_px, sigma[24].0.y_px), (625, 1023.0, 0.0));
        let summary = calibration.map_sigma_px.unwrap();
        let max = sigma.iter().map(|(_, sigma)| *sigma).fold(0.0, f64::max);
        assert!((max / summary.max - 1.0).abs() < 1e-9, "the summary is of the same map: {max} {summary:?}");
        stated += sigma.iter().map(|(_, sigma)| sigma * sigma).sum::<f64>() / 625.0;
        square += mapping_error_px(&small().truth, &calibration.camera).unwrap().rms_px.powi(2);
    }
    let ratio = (square / stated).sqrt();
    println!("{} nights: rms error of the map over its stated standard error {ratio:.3}", all.len());
    assert!((ratio - 1.0).abs() < 0.1, "{ratio}");
    // Methods on pairs know the reference model alone, and a calibration without covariance tells nothing.
    let pairs = solved(&Trial::published(), 3, &options(Method::VariableWeights));
    let sigma = map_sigma(&pairs, 25).unwrap().into_iter().map(|(_, sigma)| sigma).fold(0.0, f64::max);
    assert!(pairs.chain.is_none() && (sigma / pairs.map_sigma_px.unwrap().max - 1.0).abs() < 1e-3, "{sigma}");
    assert_eq!(map_sigma(&Calibration { covariance: Vec::new(), ..pairs }, 25), None);
}

#[test]
fn different_sets_of_effects_are_compared_by_what_both_mean() {
    // Outside the parallel part: made inside it, its own parallel work would wait for itself.
    let pairs = &*PAIRS_OF_NIGHTS;
    let six = options(Method::Bundle);
    let mut more = six.clone();
    more.solve.push("pixel-aspect".to_owned());
    let p: Vec<f64> = (0..60_u64)
        .into_par_iter()
        .map(|seed| {
            let other = solved(&small(), 11_000 + seed, &more);
            let comparison = compare(&pairs[seed as usize][0], &other).unwrap();
            assert_eq!(comparison.degrees_of_freedom, 7);
            assert!(comparison.warnings.iter().any(|warning| warning.contains("pixel-aspect.epsilon")), "{:?}", comparison.warnings);
            comparison.p_value.unwrap()
        })
        .collect();
    let distance = kolmogorov_smirnov(p);
    println!("6 against 7 parameters: distance {distance:.4} (limit {:.4})", limit_at_one_percent(60));
    assert!(distance < limit_at_one_percent(60));

    // Another projection gives the same names another meaning: the maps are compared, the parameters are not.
    let wide = CalibrateOptions { projection: "equidistant".to_owned(), ..six };
    let [pinhole, equidistant] = [&pairs[0][0], &solved(&small(), 12_000, &wide)];
    let comparison = compare(pinhole, equidistant).unwrap();
    assert_eq!((comparison.p_value, comparison.chi_squared), (None, None));
    assert!(comparison.warnings.iter().any(|warning| warning.contains("equidistant")), "{:?}", comparison.warnings);
    // k1 takes up nearly all of what the projections differ in over 10° from the middle.
    assert!(comparison.rms_px < 0.2 && comparison.difference_map.iter().all(|point| point.sigma_px.is_some()), "{}", comparison.rms_px);
}

#[test]
fn mirrored_images_differ_in_their_own_columns() {
    let [a, b] = &PAIRS_OF_NIGHTS[1];
    let mirrored = |calibration: &Calibration| Calibration { parity: -1, ..calibration.clone() };
    let plain = compare(a, b).unwrap();
    let turned = compare(&mirrored(a), &mirrored(b)).unwrap();
    assert_eq!(plain.p_value, turned.p_value);
    assert!((plain.rms_px / turned.rms_px - 1.0).abs() < 1e-12, "{} {}", plain.rms_px, turned.rms_px);
    for (one, other) in plain.parameters.iter().zip(&turned.parameters) {
        let sign = if ["x0", "p1"].contains(&one.name.as_str()) { -1.0 } else { 1.0 };
        assert_eq!(one.difference, sign * other.difference, "{}", one.name);
    }
    for (rows, turned) in plain.difference_map.chunks(9).zip(turned.difference_map.chunks(9)) {
        for (one, other) in rows.iter().zip(turned.iter().rev()) {
            let back = MapChange { x_px: 1023.0 - other.x_px, dx_px: -other.dx_px, ..*other };
            assert!((back.x_px - one.x_px).abs() < 1e-9 && (back.dx_px, back.dy_px, back.sigma_px) == (one.dx_px, one.dy_px, one.sigma_px));
        }
    }
    assert!(compare(a, &mirrored(b)).is_err());
}

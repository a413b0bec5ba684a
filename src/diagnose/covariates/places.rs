//! Covariates of position: rows and columns, radius and azimuth, edges, halves, phases within a pixel, and maps.

use super::covariate::{BINS, Carrier, Covariate, Fields, SHIFT};
use super::patterns::{LINEAR, binned, legendre, times};
use crate::calibrate::Column;
use crate::diagnose::star_images::StarImages;

/// Bins of places.
const PLACE_BINS: usize = 16;
/// A field's degree, where there are stars enough.
const MAP_DEGREE: usize = 7;
/// Pixels of a block of a compressed image.
const BLOCK_PX: f64 = 8.0;
/// Bins of rows, where so many images fall into each.
const ROW_BINS: usize = 32;
const ROW_BIN_IMAGES: usize = 20;

/// Covariates of the place on the frame.
pub(super) fn places(fields: &Fields, pixels: &[[f64; 2]], within: &[[f64; 2]], [width, height]: [f64; 2]) -> Vec<Covariate> {
    use std::f64::consts::PI;
    let mut all = Vec::new();
    let mut push = |name: &str, values: Vec<f64>, patterns: Vec<Vec<Column>>| {
        all.push(Covariate { name: name.to_owned(), values, direction: None, patterns, by_frame: Vec::new() });
    };
    let count = if pixels.len() > 20 * PLACE_BINS { PLACE_BINS } else { BINS };
    for (axis, name) in [(0, "x"), (1, "y")] {
        let values: Vec<f64> = pixels.iter().map(|pixel| pixel[axis]).collect();
        if axis == 1 && pixels.len() > ROW_BIN_IMAGES * ROW_BINS {
            push("row", values.clone(), vec![binned(&values, ROW_BINS, fields, &SHIFT)]);
        }
        let patterns = vec![binned(&values, count, fields, &SHIFT)];
        push(name, values, patterns);
    }
    let radius: Vec<f64> = fields.place.iter().map(|[x, y]| x.hypot(*y)).collect();
    let radial: [Carrier; 2] = [|[x, y]| [x, y], |[x, y]| [-y, x]];
    let powers = [2, 4, 6].map(|power| fields.each(|k, [x, y]| [x * radius[k].powi(power), y * radius[k].powi(power)]));
    let patterns = vec![binned(&radius, BINS, fields, &radial), powers.to_vec()];
    push("field-radius", radius, patterns);
    let azimuth: Vec<f64> = fields.place.iter().map(|[x, y]| y.atan2(*x)).collect();
    let mut waves = Vec::new();
    for order in 1..=4 {
        let order = f64::from(order);
        waves.push(fields.each(|k, [x, y]| [x, y].map(|c| c * (order * azimuth[k]).cos())));
        waves.push(fields.each(|k, [x, y]| [x, y].map(|c| c * (order * azimuth[k]).sin())));
        waves.push(fields.each(|k, [x, y]| [-y, x].map(|c| c * (order * azimuth[k]).cos())));
        waves.push(fields.each(|k, [x, y]| [-y, x].map(|c| c * (order * azimuth[k]).sin())));
    }
    push("field-azimuth", azimuth, vec![waves]);
    let edges = |[x, y]: [f64; 2]| [x + 0.5, width - 0.5 - x, y + 0.5, height - 0.5 - y];
    let distance: Vec<f64> = pixels.iter().map(|pixel| edges(*pixel).into_iter().fold(f64::INFINITY, f64::min)).collect();
    let mut decays = Vec::new();
    for length in [8.0, 25.0, 60.0] {
        for edge in 0..4 {
            let axis = edge / 2;
            decays.push(
                pixels
                    .iter()
                    .map(|pixel| {
                        let size = (-edges(*pixel)[edge] / length).exp();
                        if axis == 0 { [size, 0.0] } else { [0.0, size] }
                    })
                    .collect(),
            );
        }
    }
    push("edge-distance", distance, vec![decays]);
    let side: Vec<f64> = pixels.iter().map(|pixel| f64::from(u8::from(pixel[0] > (width - 1.0) / 2.0))).collect();
    let patterns = vec![times(&side, fields, &LINEAR)];
    push("column-half", side, patterns);
    for (axis, phase, parity) in [(0, "pixel-phase-x", "pixel-parity-x"), (1, "pixel-phase-y", "pixel-parity-y")] {
        // Both components of a wave along one axis: sine and cosine.
        let waves = |turns_per_px: f64| -> Vec<Column> {
            let of = |sine: bool, component: usize| {
                let value = |pixel: &[f64; 2]| {
                    let (sin, cos) = (2.0 * PI * turns_per_px * pixel[axis]).sin_cos();
                    let mut own = [0.0; 2];
                    own[component] = if sine { sin } else { cos };
                    own
                };
                within.iter().map(value).collect::<Column>()
            };
            vec![of(true, 0), of(true, 1), of(false, 0), of(false, 1)]
        };
        let values: Vec<f64> = within.iter().map(|pixel| (pixel[axis] + 0.5).rem_euclid(1.0) - 0.5).collect();
        push(phase, values, vec![[waves(1.0), waves(2.0)].concat()]);
        let values: Vec<f64> = within.iter().map(|pixel| (pixel[axis] + 0.5).rem_euclid(2.0)).collect();
        push(parity, values, vec![waves(0.5), waves(1.0 / BLOCK_PX)]);
    }
    all
}

pub(super) fn map(fields: &Fields, stars: &StarImages) -> Covariate {
    // No finer than the stars bear.
    let count = stars.images.len() as f64;
    let degree = (2..=MAP_DEGREE).rev().find(|d| ((d + 1) * (d + 2)) as f64 <= 0.4 * count).unwrap_or(2);
    let mut patterns = vec![legendre(fields, degree, |_, p| p)];
    if degree > 4 {
        patterns.push(legendre(fields, 4, |_, p| p));
    }
    Covariate { name: "field-map".to_owned(), values: vec![0.0; fields.place.len()], direction: None, patterns, by_frame: Vec::new() }
}

//! Clustered outliers: large residuals that belong together in one frame, on one star or in one corner of the field.
//!
//! They are left out when the noise is estimated and kept in everything else, however large they are. The tails of the noise are estimated from the
//! residuals themselves. A coherent displacement that is taken for tails would be weighted down, the more so the larger it is.

use nalgebra::{DMatrix, DVector};

use super::noise::NoiseModel;
use super::star_images::{REACH_PX, StarImages};
use crate::statistics::order::ascending;
use crate::statistics::significance::neg_ln_chi2_sf;

/// Chance puts so many large residuals into a group with less than this probability (as −ln), all groups counted.
const SURPRISE: f64 = 14.0;
/// Share of a group's squares that a simple field explains, at least, numbers and parameters counted.
const COHERENT: f64 = 0.4;
/// A group's images, at least.
const MIN_IMAGES: usize = 3;
/// Cells of the field along each axis.
const CELLS: usize = 6;
/// Turns: what is found no longer counts as a rank.
const TURNS: usize = 2;

/// A group of images, and the columns of a field that would move it as a whole, px.
struct Group {
    images: Vec<usize>,
    fields: Vec<Vec<[f64; 2]>>,
}

/// For every image whether it belongs to a group that stands off together. `residual_px` x, y, x, y, …; only images `allowed` count.
pub(super) fn coherent(stars: &StarImages, noise: &NoiseModel, residual_px: &[f64], allowed: &[bool]) -> Vec<bool> {
    let count = stars.images.len();
    let white: Vec<[f64; 2]> = (0..count)
        .map(|k| {
            let [a, b, c] = noise.whitener(&stars.images[k], stars.place[k]);
            let (x, y) = (residual_px[2 * k], residual_px[2 * k + 1]);
            [a * x, b * x + c * y]
        })
        .collect();
    let groups = groups(stars, allowed);
    let limit = SURPRISE + (groups.len().max(1) as f64).ln();
    let mut flagged = vec![false; count];
    for _ in 0..TURNS {
        let mut order: Vec<usize> = (0..count).filter(|k| allowed[*k] && !flagged[*k]).collect();
        ascending(&mut order, |a| square(white[*a]));
        let sorted: Vec<f64> = order.iter().map(|k| square(white[*k])).collect();
        // −ln of the share of images that are as large: exponentially distributed, whatever the tails.
        let rareness = |k: usize| {
            let below = sorted.partition_point(|value| *value < square(white[k]));
            -((sorted.len() - below) as f64 + 0.5).ln() + (sorted.len() as f64 + 0.5).ln()
        };
        let before = flagged.clone();
        for group in &groups {
            let sum: f64 = group.images.iter().map(|k| rareness(*k)).sum();
            let rank = 2.0 * group.images.len() as f64;
            if neg_ln_chi2_sf(rank, 2.0 * sum) > limit && moves_as_a_whole(group, stars, noise, &white) {
                for k in &group.images {
                    flagged[*k] = true;
                }
            }
        }
        if flagged == before {
            break;
        }
    }
    flagged
}

fn square([x, y]: [f64; 2]) -> f64 {
    x * x + y * y
}

fn groups(stars: &StarImages, allowed: &[bool]) -> Vec<Group> {
    let place: Vec<[f64; 2]> = stars.predicted_px(REACH_PX).collect();
    let most = place.iter().flatten().fold(1.0_f64, |most, value| most.max(*value));
    let at = |k: usize| place[k].map(|value| value / most);
    let members = |of: &dyn Fn(usize) -> usize| {
        let mut all: Vec<Vec<usize>> = Vec::new();
        for k in (0..allowed.len()).filter(|k| allowed[*k]) {
            let own = of(k);
            if all.len() <= own {
                all.resize(own + 1, Vec::new());
            }
            all[own].push(k);
        }
        all.into_iter().filter(|own| own.len() >= MIN_IMAGES)
    };
    let shift = |own: &[usize]| [[1.0, 0.0], [0.0, 1.0]].map(|unit| vec![unit; own.len()]).to_vec();
    let mut groups = Vec::new();
    for own in members(&|k| stars.place[k]) {
        let mut fields = shift(&own);
        fields.push(own.iter().map(|k| [at(*k)[0], 0.0]).collect());
        fields.push(own.iter().map(|k| [at(*k)[1], 0.0]).collect());
        fields.push(own.iter().map(|k| [0.0, at(*k)[0]]).collect());
        fields.push(own.iter().map(|k| [0.0, at(*k)[1]]).collect());
        groups.push(Group { images: own, fields });
    }
    for own in members(&|k| stars.star[k]) {
        let fields = (0..2).map(|axis| own.iter().map(|k| stars.sky_axes[*k][axis]).collect()).collect();
        groups.push(Group { images: own, fields });
    }
    let cell = |k: usize| {
        let [i, j] = at(k).map(|value| ((value * CELLS as f64).max(0.0) as usize).min(CELLS - 1));
        i * CELLS + j
    };
    for own in members(&cell) {
        let fields = shift(&own);
        groups.push(Group { images: own, fields });
    }
    groups.retain(|group| 2 * group.images.len() > group.fields.len() + 2);
    groups
}

fn moves_as_a_whole(group: &Group, stars: &StarImages, noise: &NoiseModel, white: &[[f64; 2]]) -> bool {
    let rows = 2 * group.images.len();
    let mut matrix = DMatrix::zeros(rows, group.fields.len());
    let mut right = DVector::zeros(rows);
    for (row, k) in group.images.iter().enumerate() {
        let [a, b, c] = noise.whitener(&stars.images[*k], stars.place[*k]);
        for (column, field) in group.fields.iter().enumerate() {
            let [x, y] = field[row];
            matrix[(2 * row, column)] = a * x;
            matrix[(2 * row + 1, column)] = b * x + c * y;
        }
        (right[2 * row], right[2 * row + 1]) = (white[*k][0], white[*k][1]);
    }
    let total = right.norm_squared();
    let columns = matrix.clone();
    let Ok(solution) = matrix.svd(true, true).solve(&right, 1e-9) else { return false };
    let rest = (right - columns * solution).norm_squared();
    let degrees = (rows - group.fields.len()) as f64;
    1.0 - (rest / degrees) / (total / rows as f64) > COHERENT
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean of −ln of a rank is one, so its sum over a group of m follows a gamma distribution of m: what the surprise supposes.
    #[test]
    fn a_group_of_usual_images_is_no_surprise() {
        let n = 400_usize;
        let sum: f64 = (0..n).map(|k| -((n - k) as f64 + 0.5).ln() + (n as f64 + 0.5).ln()).sum();
        assert!((sum / n as f64 - 1.0).abs() < 0.02, "{sum}");
        assert!(neg_ln_chi2_sf(2.0 * n as f64, 2.0 * sum) < 2.0);
    }
}

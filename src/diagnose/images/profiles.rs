//! Magnitudes and sizes of the star images in bins of what they may follow, and their shape over the frame: for pictures.

use std::collections::BTreeMap;

use super::expected_stars::StarMeasurement;
use super::row_fit::RowFit;
use super::row_noise::weight;
use super::rows::{Kind, KindNoise, Rows};
use super::stars::{MAGNITUDE, SIZE};
use crate::diagnose::image_profiles::{ImageProfile, ImageShape, ShapeCell};
use crate::diagnose::profile_bin::ProfileBin;
use crate::statistics::order::ascending;

/// Bins of a profile, and star images in one, at least.
const MAX_BINS: usize = 14;
const MIN_IN_BIN: usize = 8;
/// Star images in a cell of the map of shapes, about, and cells along the longer side, at most.
const IN_CELL: usize = 10;
const MAX_CELLS: f64 = 8.0;

/// A covariate of a star, by its name in the result files.
type Covariate = (&'static str, fn(&StarMeasurement) -> Option<f64>);

const COVARIATES: [Covariate; 6] = [
    ("field-radius", |star| Some(star.image.at[0].hypot(star.image.at[1]))),
    ("magnitude", |star| Some(star.magnitude)),
    ("colour", |star| star.image.colour_offset),
    ("zenith", |star| star.image.airmass),
    ("temperature", |star| star.image.temperature_offset_k),
    ("time", |star| star.image.time_offset_h),
];

/// The profiles of magnitude and size against each covariate that varies. `before` are the residuals with nothing found, in the rows' units.
pub(super) fn profiles(rows: &Rows, stars: &[StarMeasurement], before: &[f64], after: &RowFit) -> Vec<ImageProfile> {
    let of_point: BTreeMap<usize, &StarMeasurement> = stars.iter().map(|star| (star.point, star)).collect();
    let mut all = Vec::new();
    for ((kind, noise), range) in rows.kinds.iter().zip(&after.noise).zip(rows.ranges()) {
        let Some((_, unit)) = [(MAGNITUDE, "mag"), (SIZE, "px²")].into_iter().find(|(name, _)| kind.name == *name) else { continue };
        for (covariate, of) in COVARIATES {
            let told = |k: usize| {
                let star = kind.rows[k].point.and_then(|point| of_point.get(&point))?;
                let [before, left] = [before[range.start + k], after.rest[range.start + k]];
                Some(Told { at: of(star)?, row: k, before, model: before - left })
            };
            let mut own: Vec<Told> =
                (0..kind.rows.len()).filter(|k| after.take[range.start + k]).filter_map(told).filter(Told::is_finite).collect();
            ascending(&mut own, |a| a.at);
            let varies = own.first().zip(own.last()).is_some_and(|(first, last)| last.at > first.at);
            if varies && own.len() >= 2 * MIN_IN_BIN {
                all.push(ImageProfile::new(kind.channel, kind.name, unit, covariate, bins(kind, noise, &own)));
            }
        }
    }
    all
}

/// A row with what it is held against.
struct Told {
    at: f64,
    row: usize,
    before: f64,
    model: f64,
}

impl Told {
    fn is_finite(&self) -> bool {
        [self.at, self.before, self.model].iter().all(|number| number.is_finite())
    }
}

/// Weighted means in bins of equal numbers, with the errors that the rows of a group share.
fn bins(kind: &Kind, noise: &KindNoise, told: &[Told]) -> Vec<ProfileBin> {
    let count = (told.len() / MIN_IN_BIN).clamp(2, MAX_BINS);
    let of_bin = |bin: usize| {
        let own = &told[bin * told.len() / count..(bin + 1) * told.len() / count];
        // What is far off after the fit counts as little as it did there: a variable star, a blend.
        let counts = |one: &Told| {
            let variance = noise.variance(&kind.rows[one.row]) + noise.shared;
            weight((one.before - one.model) / variance.sqrt()) / variance
        };
        let weights: Vec<f64> = own.iter().map(counts).collect();
        let sum: f64 = weights.iter().sum();
        let mean = |of: fn(&Told) -> f64| own.iter().zip(&weights).map(|(one, weight)| weight * of(one)).sum::<f64>() / sum;
        let mut groups: BTreeMap<usize, f64> = BTreeMap::new();
        let mut variance = 0.0;
        for (one, weight) in own.iter().zip(&weights) {
            let row = &kind.rows[one.row];
            *groups.entry(kind.group(row)).or_default() += weight;
            variance += weight * weight * noise.variance(row);
        }
        variance += noise.shared * groups.values().map(|weight| weight * weight).sum::<f64>();
        ProfileBin {
            at: mean(|one| one.at),
            mean: mean(|one| one.before),
            sigma: variance.sqrt() / sum,
            model: mean(|one| one.model),
            stars: own.len(),
        }
    };
    (0..count).map(of_bin).collect()
}

/// Shape of the images over the frame, in cells.
pub(super) fn shape_map(stars: &[StarMeasurement]) -> Vec<ShapeCell> {
    let told = |star: &StarMeasurement| {
        let [xx, xy, yy] = star.moments?.second_px2;
        let sum = xx + yy;
        let shape = ImageShape { width_px: (0.5 * sum).sqrt(), ellipticity: [(xx - yy) / sum, 2.0 * xy / sum] };
        (sum > 0.0).then_some((star.image.at, shape))
    };
    let images: Vec<([f64; 2], ImageShape)> = stars.iter().filter_map(told).collect();
    let reach = [0, 1].map(|axis| images.iter().map(|(at, _)| at[axis].abs()).fold(0.0, f64::max));
    let longer = reach[0].max(reach[1]);
    if longer <= 0.0 {
        return Vec::new();
    }
    let along = ((images.len() / IN_CELL) as f64).sqrt().clamp(1.0, MAX_CELLS);
    let sides = reach.map(|reach| (along * reach / longer).round().max(1.0) as usize);
    let mut cells: BTreeMap<[usize; 2], Vec<ImageShape>> = BTreeMap::new();
    for (at, image) in images {
        let cell = [0, 1].map(|axis| {
            let share = 0.5 * (at[axis] / reach[axis].max(f64::MIN_POSITIVE) + 1.0);
            ((share * sides[axis] as f64) as usize).min(sides[axis] - 1)
        });
        cells.entry([cell[1], cell[0]]).or_default().push(image);
    }
    let of_cell = |([row, column], images): (&[usize; 2], &Vec<ImageShape>)| {
        let at = [(0, *column), (1, *row)].map(|(axis, k)| reach[axis] * ((2 * k + 1) as f64 / sides[axis] as f64 - 1.0));
        ShapeCell::of(at, images)
    };
    cells.iter().filter_map(of_cell).collect()
}

//! What a mismatch may follow: covariates of star images, and the patterns by which residuals are held against each.
//!
//! A covariate that belongs to a star image (its colour, its place) multiplies simple vector fields over the frame (a shift, and the four
//! linear fields); one that belongs to a frame (its temperature) multiplies what the frame's attitude leaves of them. Each is tried twice,
//! in proportion to the covariate and in bins of equal counts, so that laws of any shape are seen.

use super::Telemetry;
use super::evidence::{Evidence, REACH_PX, WITHIN_REACH_PX};
use crate::calibrate::{Column, Joint};
use crate::identify::ControlPoints;

/// Bins of equal counts.
const BINS: usize = 8;
/// Bins of places.
const PLACE_BINS: usize = 16;
/// A field's degree, where there are stars enough.
const MAP_DEGREE: usize = 7;
/// Degree of a map that a covariate multiplies.
const PRODUCT_DEGREE: usize = 3;
/// Pixels of a block of a compressed image.
const BLOCK_PX: f64 = 8.0;
/// Bins of rows, where so many images fall into each.
const ROW_BINS: usize = 32;
const ROW_BIN_IMAGES: usize = 20;
/// Stars are held against themselves if they are seen so often, and so many of them at most.
const STAR_IMAGES: usize = 3;
const MOST_STARS: usize = 40;
/// Frames are held against the others one by one up to this number.
const MOST_SINGLE: usize = 100;
/// Colours count from here.
const MIDDLE_COLOUR: f64 = 0.6;

/// A covariate with its patterns.
#[derive(Clone, Debug)]
pub(super) struct Covariate {
    /// Its name in files.
    pub(super) name: String,
    /// Its value for every star image, NaN where it is not known.
    pub(super) values: Vec<f64>,
    /// The direction in which it displaces, where it has one of its own (toward the zenith).
    pub(super) direction: Option<Column>,
    /// Patterns of residuals, each a set of columns that are tried together.
    pub(super) patterns: Vec<Vec<Column>>,
}

/// A vector field over the frame, of (ξ, η).
type Carrier = fn([f64; 2]) -> [f64; 2];

/// The frame's geometry for patterns.
struct Fields {
    /// ξ, η: from the middle of the frame, in half its width.
    place: Vec<[f64; 2]>,
}

impl Fields {
    fn each(&self, field: impl Fn(usize, [f64; 2]) -> [f64; 2]) -> Column {
        self.place.iter().enumerate().map(|(k, place)| field(k, *place)).collect()
    }
}

const LINEAR: [Carrier; 6] = [|_| [1.0, 0.0], |_| [0.0, 1.0], |[x, _]| [x, 0.0], |[_, y]| [y, 0.0], |[x, _]| [0.0, x], |[_, y]| [0.0, y]];
const BEHIND_ATTITUDE: [Carrier; 3] = [|[x, y]| [x, y], |[x, y]| [x, -y], |[x, y]| [y, x]];
const OF_FRAMES: [Carrier; 6] = [
    |[x, y]| [x, y],
    |[x, y]| [x, -y],
    |[x, y]| [y, x],
    |[x, y]| [x * (x * x + y * y), y * (x * x + y * y)],
    |[x, y]| [x * x - y * y, -2.0 * x * y],
    |[x, y]| [2.0 * x * y, x * x - y * y],
];
const SHIFT_AND_SCALE: [Carrier; 3] = [|_| [1.0, 0.0], |_| [0.0, 1.0], |[x, y]| [x, y]];
const SHIFT: [Carrier; 2] = [|_| [1.0, 0.0], |_| [0.0, 1.0]];

/// All that the recording has.
pub(super) fn covariates(joint: &Joint, evidence: &Evidence, points: &ControlPoints, telemetry: &Telemetry) -> Vec<Covariate> {
    let camera = joint.model().camera();
    let (width, height) = (camera.width_px as f64, camera.height_px as f64);
    let pixels: Vec<[f64; 2]> = evidence.predicted_px(REACH_PX).collect();
    let within: Vec<[f64; 2]> = evidence.predicted_px(WITHIN_REACH_PX).collect();
    let half = width / 2.0;
    let place = pixels.iter().map(|[x, y]| [(x - (width - 1.0) / 2.0) / half, (y - (height - 1.0) / 2.0) / half]).collect();
    let fields = Fields { place };
    let star = |value: &dyn Fn(usize) -> Option<f64>| -> Vec<f64> { (0..pixels.len()).map(|k| value(k).unwrap_or(f64::NAN)).collect() };
    let frame = |value: &dyn Fn(usize) -> Option<f64>| -> Vec<f64> {
        evidence.place.iter().map(|place| value(*place).unwrap_or(f64::NAN)).collect()
    };
    let point = |k: usize| &points.points[evidence.images[k].point];
    let mut all = places(&fields, &pixels, &within, [width, height]);
    all.push(map(&fields, evidence));
    for (name, values) in [
        ("colour", star(&|k| point(k).colour)),
        ("magnitude", star(&|k| point(k).image.magnitude.or(Some(point(k).magnitude)).filter(|m| *m < 50.0))),
        ("flux", star(&|k| point(k).image.flux_e.or_else(|| Some(10.0_f64.powf(-0.4 * point(k).magnitude)).filter(|f| *f > 1e-20)))),
    ] {
        let name = name.to_owned();
        all.extend(of_star(name, values, &fields));
    }
    let observation = |place: usize| &evidence.frames[place].1;
    let number = |place: usize| evidence.frames[place].0;
    let mut of_frames: Vec<(String, Vec<f64>)> = vec![
        ("time".to_owned(), frame(&|place| observation(place).time_offset_h)),
        ("frame".to_owned(), frame(&|place| Some(number(place) as f64))),
        ("exposure".to_owned(), frame(&|place| observation(place).exposure_s)),
        ("temperature".to_owned(), frame(&|place| observation(place).temperature_offset_k)),
    ];
    let names: std::collections::BTreeSet<&String> = telemetry.iter().flat_map(|frame| frame.keys()).collect();
    for name in names.into_iter().filter(|name| !matches!(name.as_str(), "temperature" | "exposure" | "time" | "frame")) {
        of_frames.push((name.clone(), frame(&|place| telemetry.get(number(place))?.get(name).copied())));
    }
    for (name, values) in of_frames {
        all.extend(of_frame(name, values, &fields));
    }
    if let Some(frames) = all.iter_mut().find(|covariate| covariate.name == "frame") {
        frames.patterns.extend(single_frames(evidence, &fields));
    }
    all.extend(rate(evidence, &fields));
    all.extend(background_gradient(evidence, points, &fields));
    all.extend(velocity(joint, evidence, &fields));
    for (name, id) in [("zenith", "refraction"), ("proper-motion", "proper-motion"), ("parallax", "parallax")] {
        all.extend(along(name, id, joint, evidence, points, &fields));
    }
    all.extend(stars(evidence));
    all.retain(|covariate| !covariate.patterns.is_empty());
    all
}

/// Stars that stand off their catalogue places in all of their images: a shift of each on the sky.
fn stars(evidence: &Evidence) -> Option<Covariate> {
    let mut seen = vec![0_usize; evidence.star.iter().max().map_or(0, |last| last + 1)];
    for star in &evidence.star {
        seen[*star] += 1;
    }
    let mut often: Vec<usize> = (0..seen.len()).filter(|star| seen[*star] >= STAR_IMAGES).collect();
    often.sort_by(|a, b| seen[*b].cmp(&seen[*a]).then(a.cmp(b)));
    often.truncate(MOST_STARS);
    let values: Vec<f64> =
        evidence.star.iter().map(|star| often.iter().position(|own| own == star).map_or(f64::NAN, |k| k as f64)).collect();
    let of = |(star, axis): (usize, usize)| -> Column {
        (0..values.len()).map(|k| if evidence.star[k] == star { evidence.sky_axes[k][axis] } else { [0.0; 2] }).collect()
    };
    let columns = often.iter().flat_map(|star| [(*star, 0), (*star, 1)]).map(of).collect();
    // All together, and each of those that may stand alone.
    let alone = often.iter().map(|star| vec![of((*star, 0)), of((*star, 1))]);
    let patterns = std::iter::once(columns).chain(alone).collect();
    (!often.is_empty()).then(|| Covariate { name: "star".to_owned(), values, direction: None, patterns })
}

/// Bins of equal counts: for each image its bin.
fn bins(values: &[f64], count: usize) -> Vec<Option<usize>> {
    let mut known: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    known.sort_by(f64::total_cmp);
    if known.is_empty() {
        return vec![None; values.len()];
    }
    let mut edges: Vec<f64> = (1..count).map(|k| known[k * known.len() / count]).collect();
    edges.dedup();
    let of = |value: &f64| value.is_finite().then(|| edges.partition_point(|edge| edge <= value));
    values.iter().map(of).collect()
}

fn binned(values: &[f64], count: usize, fields: &Fields, carriers: &[Carrier]) -> Vec<Column> {
    let own = bins(values, count);
    let highest = own.iter().flatten().max().copied().unwrap_or(0);
    let mut columns = Vec::new();
    for bin in 0..=highest {
        for carrier in carriers {
            columns.push(fields.each(|k, place| if own[k] == Some(bin) { carrier(place) } else { [0.0; 2] }));
        }
    }
    columns
}

fn times(values: &[f64], fields: &Fields, carriers: &[Carrier]) -> Vec<Column> {
    let known: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    let mean = known.iter().sum::<f64>() / known.len().max(1) as f64;
    let of = |carrier: &Carrier| {
        fields.each(|k, place| if values[k].is_finite() { carrier(place).map(|c| c * (values[k] - mean)) } else { [0.0; 2] })
    };
    carriers.iter().map(of).collect()
}

fn varies(values: &[f64]) -> bool {
    let known: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    let (least, most) = known.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
    known.len() * 2 > values.len() && most - least > 1e-9 * most.abs().max(least.abs())
}

fn of_star(name: String, values: Vec<f64>, fields: &Fields) -> Option<Covariate> {
    varies(&values).then(|| {
        let mut patterns = vec![times(&values, fields, &LINEAR), binned(&values, BINS, fields, &SHIFT_AND_SCALE)];
        let middle = if name == "colour" {
            MIDDLE_COLOUR
        } else {
            values.iter().copied().filter(|v| v.is_finite()).sum::<f64>() / values.len() as f64
        };
        if name != "flux" {
            let field = |k: usize, weight: f64| if values[k].is_finite() { (values[k] - middle) * weight } else { 0.0 };
            patterns.push(legendre(fields, PRODUCT_DEGREE, field));
        }
        Covariate { name, values, direction: None, patterns }
    })
}

fn of_frame(name: String, values: Vec<f64>, fields: &Fields) -> Option<Covariate> {
    varies(&values).then(|| {
        let patterns = vec![times(&values, fields, &OF_FRAMES), binned(&values, BINS, fields, &BEHIND_ATTITUDE)];
        Covariate { name, values, direction: None, patterns }
    })
}

/// One frame out of line with all others: a pattern for each.
fn single_frames(evidence: &Evidence, fields: &Fields) -> Vec<Vec<Column>> {
    let frames = evidence.frames.len();
    if !(3..=MOST_SINGLE).contains(&frames) {
        return Vec::new();
    }
    let of = |frame: usize| {
        let column = |carrier: &Carrier| fields.each(|k, place| if evidence.place[k] == frame { carrier(place) } else { [0.0; 2] });
        BEHIND_ATTITUDE.iter().map(column).collect()
    };
    (0..frames).map(of).collect()
}

/// Vector fields of products of Legendre polynomials up to a degree.
fn legendre(fields: &Fields, degree: usize, factor: impl Fn(usize, f64) -> f64) -> Vec<Column> {
    let polynomials = |t: f64| {
        let mut p = vec![1.0, t];
        for n in 2..=degree {
            let m = n as f64;
            p.push(((2.0 * m - 1.0) * t * p[n - 1] - (m - 1.0) * p[n - 2]) / m);
        }
        p
    };
    let values: Vec<(Vec<f64>, Vec<f64>)> = fields.place.iter().map(|[x, y]| (polynomials(*x), polynomials(*y))).collect();
    let mut columns = Vec::new();
    for i in 0..=degree {
        for j in 0..=degree - i {
            let scalar = |k: usize| factor(k, values[k].0[i] * values[k].1[j]);
            columns.push((0..values.len()).map(|k| [scalar(k), 0.0]).collect());
            columns.push((0..values.len()).map(|k| [0.0, scalar(k)]).collect());
        }
    }
    columns
}

fn map(fields: &Fields, evidence: &Evidence) -> Covariate {
    // No finer than the stars bear.
    let stars = evidence.images.len() as f64;
    let degree = (2..=MAP_DEGREE).rev().find(|d| ((d + 1) * (d + 2)) as f64 <= 0.4 * stars).unwrap_or(2);
    let mut patterns = vec![legendre(fields, degree, |_, p| p)];
    if degree > 4 {
        patterns.push(legendre(fields, 4, |_, p| p));
    }
    Covariate { name: "field-map".to_owned(), values: vec![0.0; fields.place.len()], direction: None, patterns }
}

/// Covariates of the place on the frame.
fn places(fields: &Fields, pixels: &[[f64; 2]], within: &[[f64; 2]], [width, height]: [f64; 2]) -> Vec<Covariate> {
    use std::f64::consts::PI;
    let mut all = Vec::new();
    let mut push = |name: &str, values: Vec<f64>, patterns: Vec<Vec<Column>>| {
        all.push(Covariate { name: name.to_owned(), values, direction: None, patterns });
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

fn rate(evidence: &Evidence, fields: &Fields) -> Option<Covariate> {
    let rate = |k: usize| evidence.frames[evidence.place[k]].1.rate_rad_s;
    let values: Vec<f64> = (0..fields.place.len()).map(|k| rate(k).map_or(f64::NAN, |[x, y, z]| (x * x + y * y + z * z).sqrt())).collect();
    let varied =
        (0..3).any(|axis| varies(&(0..fields.place.len()).map(|k| rate(k).map_or(f64::NAN, |rate| rate[axis])).collect::<Vec<_>>()));
    varied.then(|| {
        let mut patterns = Vec::new();
        let mut columns = Vec::new();
        for axis in 0..3 {
            let at = |k: usize| rate(k).map_or(0.0, |rate| rate[axis]);
            columns.push(fields.each(|k, [_, y]| [at(k) * y, 0.0]));
            columns.push(fields.each(|k, [_, y]| [0.0, at(k) * y]));
        }
        let roll = |k: usize| rate(k).map_or(0.0, |rate| rate[2]);
        columns.push(fields.each(|k, [x, y]| [-roll(k) * y * y, roll(k) * x * y]));
        patterns.push(columns);
        patterns.push(binned(&values, BINS, fields, &BEHIND_ATTITUDE));
        Covariate { name: "rate".to_owned(), values, direction: None, patterns }
    })
}

/// The local slope of the background over the star's flux: toward where it pulls a centroid.
fn background_gradient(evidence: &Evidence, points: &ControlPoints, fields: &Fields) -> Option<Covariate> {
    let slope = |k: usize| {
        let image = &points.points[evidence.images[k].point].image;
        let (gradient, flux) = (image.background_gradient_e_px?, image.flux_e.filter(|flux| *flux > 0.0)?);
        Some(gradient.map(|g| g / flux))
    };
    let slopes: Vec<[f64; 2]> = (0..fields.place.len()).map(|k| slope(k).unwrap_or_default()).collect();
    let values: Vec<f64> = (0..slopes.len()).map(|k| slope(k).map_or(f64::NAN, |[x, y]| x.hypot(y))).collect();
    varies(&values).then(|| {
        let patterns = vec![vec![
            fields.each(|k, _| slopes[k]),
            fields.each(|k, _| [slopes[k][0], 0.0]),
            fields.each(|k, _| [-slopes[k][1], slopes[k][0]]),
        ]];
        Covariate { name: "background-gradient".to_owned(), values, direction: None, patterns }
    })
}

fn velocity(joint: &Joint, evidence: &Evidence, fields: &Fields) -> Option<Covariate> {
    let in_camera: Vec<Option<[f64; 3]>> = evidence
        .frames
        .iter()
        .enumerate()
        .map(|(place, (_, observation))| {
            let velocity = nalgebra::Vector3::from(observation.velocity_km_s?);
            let turned = joint.attitude(place)?.camera_from_icrs * velocity;
            Some([turned.x, turned.y, turned.z])
        })
        .collect();
    let component =
        |axis: usize| -> Vec<f64> { evidence.place.iter().map(|place| in_camera[*place].map_or(f64::NAN, |v| v[axis])).collect() };
    let along = component(2);
    varies(&along).then(|| {
        let patterns = vec![times(&along, fields, &OF_FRAMES), binned(&along, BINS, fields, &BEHIND_ATTITUDE)];
        Covariate { name: "velocity".to_owned(), values: along, direction: None, patterns }
    })
}

/// A covariate with a direction of its own: that in which an effect displaces, with the size of the displacement as its value.
fn along(name: &str, id: &str, joint: &Joint, evidence: &Evidence, points: &ControlPoints, fields: &Fields) -> Option<Covariate> {
    let effect = crate::effects::displacement(id)?;
    if evidence.frames.iter().any(|(_, observation)| effect.missing(observation).is_some()) {
        return None;
    }
    let start = (!evidence.images.is_empty()).then(|| effect.identity(&evidence.context(0, points)))??;
    let column = joint.columns_of(id, &start, &[0])?.into_iter().next()?;
    let values: Vec<f64> = column.iter().map(|[x, y]| x.hypot(*y)).collect();
    // A residual falls where the model moves along: the star itself moves the other way.
    let unit: Column =
        column.iter().zip(&values).map(|([x, y], size)| if *size > 0.0 { [-x / size, -y / size] } else { [0.0; 2] }).collect();
    varies(&values).then(|| {
        let own = bins(&values, BINS);
        let highest = own.iter().flatten().max().copied().unwrap_or(0);
        let of = |bin: usize| fields.each(|k, _| if own[k] == Some(bin) { unit[k] } else { [0.0; 2] });
        let patterns = vec![vec![column.clone()], (0..=highest).map(of).collect()];
        Covariate { name: name.to_owned(), values, direction: Some(unit.clone()), patterns }
    })
}

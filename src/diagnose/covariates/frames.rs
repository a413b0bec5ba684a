//! Covariates of a frame: time, temperature, rate and every number of its telemetry. Each multiplies simple fields, less what the frame's attitude
//! takes up of them.

use super::covariate::{BINS, Carrier, Covariate, Fields, Separated, bins, varies};
use crate::calibrate::{BundleSolution, Column};
use crate::diagnose::star_images::StarImages;

/// Frames are held against the others one by one up to this number.
const MAX_SINGLE: usize = 100;

const BEHIND_ATTITUDE: [Carrier; 3] = [|[x, y]| [x, y], |[x, y]| [x, -y], |[x, y]| [y, x]];
const OF_FRAMES: [Carrier; 6] = [
    |[x, y]| [x, y],
    |[x, y]| [x, -y],
    |[x, y]| [y, x],
    |[x, y]| [x * (x * x + y * y), y * (x * x + y * y)],
    |[x, y]| [x * x - y * y, -2.0 * x * y],
    |[x, y]| [2.0 * x * y, x * x - y * y],
];

/// The number of each image's frame.
fn by_image(numbers: &[f64], stars: &StarImages) -> Vec<f64> {
    stars.place.iter().map(|place| numbers[*place]).collect()
}

/// Fields times the numbers of the frames, counted from their mean over the images.
fn times(numbers: &[f64], stars: &StarImages, fields: &Fields, carriers: &[Carrier]) -> Separated {
    let values = by_image(numbers, stars);
    let known: Vec<f64> = values.into_iter().filter(|value| value.is_finite()).collect();
    let mean = known.iter().sum::<f64>() / known.len().max(1) as f64;
    let weights: Vec<f64> = numbers.iter().map(|number| if number.is_finite() { number - mean } else { 0.0 }).collect();
    Separated::new(fields, carriers, (0..carriers.len()).map(|carrier| (carrier, weights.clone())).collect())
}

/// Fields in bins of the frames' numbers.
fn binned(numbers: &[f64], stars: &StarImages, fields: &Fields, carriers: &[Carrier]) -> Separated {
    let of_images = bins(&by_image(numbers, stars), BINS);
    let mut bin = vec![None; numbers.len()];
    for (place, own) in stars.place.iter().zip(&of_images) {
        bin[*place] = *own;
    }
    let highest = bin.iter().flatten().max().copied().unwrap_or(0);
    let mut columns = Vec::new();
    for wanted in 0..=highest {
        let weights: Vec<f64> = bin.iter().map(|own| f64::from(u8::from(*own == Some(wanted)))).collect();
        columns.extend((0..carriers.len()).map(|carrier| (carrier, weights.clone())));
    }
    Separated::new(fields, carriers, columns)
}

/// A covariate of frames with patterns that are separated.
fn covariate(name: String, values: Vec<f64>, stars: &StarImages, by_frame: Vec<Separated>) -> Covariate {
    let patterns = by_frame.iter().map(|separated| separated.pattern(&stars.place)).collect();
    Covariate { name, values, direction: None, patterns, by_frame }
}

/// A number of each frame; NaN where it is not known.
pub(super) fn of_frame(name: String, numbers: &[f64], stars: &StarImages, fields: &Fields) -> Option<Covariate> {
    let values = by_image(numbers, stars);
    varies(&values).then(|| {
        let by_frame = vec![times(numbers, stars, fields, &OF_FRAMES), binned(numbers, stars, fields, &BEHIND_ATTITUDE)];
        covariate(name, values, stars, by_frame)
    })
}

/// One frame out of line with all others: a pattern for each.
pub(super) fn single_frames(stars: &StarImages, fields: &Fields) -> Vec<Vec<Column>> {
    let frames = stars.frames.len();
    if !(3..=MAX_SINGLE).contains(&frames) {
        return Vec::new();
    }
    let of = |frame: usize| {
        let column = |carrier: &Carrier| fields.each(|k, place| if stars.place[k] == frame { carrier(place) } else { [0.0; 2] });
        BEHIND_ATTITUDE.iter().map(column).collect()
    };
    (0..frames).map(of).collect()
}

/// The camera's own rotation: what it displaces follows the row and each component of the rate.
pub(super) fn rate(stars: &StarImages, fields: &Fields) -> Option<Covariate> {
    const BY_ROW: [Carrier; 3] = [|[_, y]| [y, 0.0], |[_, y]| [0.0, y], |[x, y]| [-y * y, x * y]];
    let component = |axis: usize| -> Vec<f64> {
        stars.frames.iter().map(|(_, observation)| observation.rate_rad_s.map_or(f64::NAN, |rate| rate[axis])).collect()
    };
    let axes = [0, 1, 2].map(component);
    let varied = axes.iter().any(|numbers| varies(&by_image(numbers, stars)));
    varied.then(|| {
        let known = axes.clone().map(|numbers| numbers.iter().map(|rate| if rate.is_finite() { *rate } else { 0.0 }).collect::<Vec<f64>>());
        let mut columns = Vec::new();
        for own in &known {
            columns.extend([(0, own.clone()), (1, own.clone())]);
        }
        columns.push((2, known[2].clone()));
        let size: Vec<f64> = (0..stars.frames.len()).map(|h| axes[0][h].hypot(axes[1][h]).hypot(axes[2][h])).collect();
        let by_frame = vec![Separated::new(fields, &BY_ROW, columns), binned(&size, stars, fields, &BEHIND_ATTITUDE)];
        covariate("rate".to_owned(), by_image(&size, stars), stars, by_frame)
    })
}

/// The camera's velocity along its axis.
pub(super) fn velocity(joint: &BundleSolution, stars: &StarImages, fields: &Fields) -> Option<Covariate> {
    let along = |(place, (_, observation)): (usize, &(usize, crate::effects::Observation))| {
        let velocity = nalgebra::Vector3::from(observation.velocity_km_s?);
        Some((joint.attitude(place)?.camera_from_icrs * velocity).z)
    };
    let numbers: Vec<f64> = stars.frames.iter().enumerate().map(|frame| along(frame).unwrap_or(f64::NAN)).collect();
    of_frame("velocity".to_owned(), &numbers, stars, fields)
}

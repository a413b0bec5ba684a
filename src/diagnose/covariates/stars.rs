//! Covariates of a star image: its colour, its brightness, the slope of the background about it, the star itself, and the directions in which
//! effects of known geometry would displace it.

use super::covariate::{BINS, Carrier, Covariate, Fields, bins, varies};
use super::patterns::{LINEAR, binned, legendre, times};
use crate::calibrate::{BundleSolution, Column};
use crate::diagnose::star_images::StarImages;
use crate::identify::ControlPoints;
use crate::statistics::order::sort_by;

/// Degree of a map that a covariate multiplies.
const PRODUCT_DEGREE: usize = 3;
/// Stars are held against themselves if they are seen so often, and so many of them at most.
const STAR_IMAGES: usize = 3;
const MAX_STARS: usize = 40;
/// Colours count from here.
const MIDDLE_COLOUR: f64 = 0.6;

const SHIFT_AND_SCALE: [Carrier; 3] = [|_| [1.0, 0.0], |_| [0.0, 1.0], |[x, y]| [x, y]];

pub(super) fn of_star(name: String, values: Vec<f64>, fields: &Fields) -> Option<Covariate> {
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
        Covariate { name, values, direction: None, patterns, by_frame: Vec::new() }
    })
}

/// The local slope of the background over the star's flux: toward where it pulls a centroid.
pub(super) fn background_gradient(stars: &StarImages, points: &ControlPoints, fields: &Fields) -> Option<Covariate> {
    let slope = |k: usize| {
        let image = &points.points[stars.images[k].point].image;
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
        Covariate { name: "background-gradient".to_owned(), values, direction: None, patterns, by_frame: Vec::new() }
    })
}

/// A covariate with a direction of its own: that in which an effect displaces, with the size of the displacement as its value.
pub(super) fn along(
    name: &str,
    id: &str,
    joint: &BundleSolution,
    stars: &StarImages,
    points: &ControlPoints,
    fields: &Fields,
) -> Option<Covariate> {
    let effect = crate::effects::displacement(id)?;
    if stars.frames.iter().any(|(_, observation)| effect.unmet_requirement(observation).is_some()) {
        return None;
    }
    let start = (!stars.images.is_empty()).then(|| effect.identity(&stars.context(0, points)))??;
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
        Covariate { name: name.to_owned(), values, direction: Some(unit.clone()), patterns, by_frame: Vec::new() }
    })
}

/// Stars that stand off their catalogue places in all of their images: a shift of each on the sky.
pub(super) fn stars(stars: &StarImages) -> Option<Covariate> {
    let mut seen = vec![0_usize; stars.star.iter().max().map_or(0, |last| last + 1)];
    for star in &stars.star {
        seen[*star] += 1;
    }
    let mut often: Vec<usize> = (0..seen.len()).filter(|star| seen[*star] >= STAR_IMAGES).collect();
    sort_by(&mut often, |a, b| seen[*b].cmp(&seen[*a]).then(a.cmp(b)));
    often.truncate(MAX_STARS);
    let values: Vec<f64> = stars.star.iter().map(|star| often.iter().position(|own| own == star).map_or(f64::NAN, |k| k as f64)).collect();
    let of = |(star, axis): (usize, usize)| -> Column {
        (0..values.len()).map(|k| if stars.star[k] == star { stars.sky_axes[k][axis] } else { [0.0; 2] }).collect()
    };
    let columns = often.iter().flat_map(|star| [(*star, 0), (*star, 1)]).map(of).collect();
    // All together, and each of those that may stand alone.
    let alone = often.iter().map(|star| vec![of((*star, 0)), of((*star, 1))]);
    let patterns = std::iter::once(columns).chain(alone).collect();
    (!often.is_empty()).then(|| Covariate { name: "star".to_owned(), values, direction: None, patterns, by_frame: Vec::new() })
}

//! Patterns without a name that the rows of stars are held against: where a mismatch shows that no effect explains.

use super::expected_stars::StarMeasurement;
use super::rows::{Question, Rows};

/// A pattern over the rows of one kind, and the covariate that it follows.
pub(super) fn patterns(rows: &Rows, stars: &[StarMeasurement]) -> Vec<Question> {
    let of_point: std::collections::BTreeMap<usize, &StarMeasurement> = stars.iter().map(|star| (star.point, star)).collect();
    let mut all = Vec::new();
    for (kind, range) in rows.kinds.iter().zip(rows.ranges()) {
        let own: Vec<Option<&StarMeasurement>> =
            kind.rows.iter().map(|row| row.point.and_then(|point| of_point.get(&point).copied())).collect();
        if own.iter().flatten().next().is_none() {
            continue;
        }
        for (follows, columns) in COVARIATES {
            // Rows of no star have none of it, and neither have stars of which it is not known.
            let values: Vec<Option<Vec<f64>>> = own.iter().map(|star| star.and_then(columns)).collect();
            let count = values.iter().flatten().next().map_or(0, Vec::len);
            if count == 0 {
                continue;
            }
            let column = |k: usize| {
                let mut column = vec![0.0; rows.len()];
                for (value, own) in column[range.clone()].iter_mut().zip(&values) {
                    *value = own.as_ref().map_or(0.0, |own| own[k]);
                }
                column
            };
            let columns = (0..count).map(column).collect();
            all.push(Question { id: "", parameters: Vec::new(), follows, columns, rank: 0, sign: None, is_part: false, products_of: &[] });
        }
    }
    all
}

/// Columns of a covariate at a star.
type Columns = fn(&StarMeasurement) -> Option<Vec<f64>>;

/// The covariates, by the names of the result files.
const COVARIATES: &[(&str, Columns)] = &[
    ("x", |star| Some(vec![star.image.at[0]])),
    ("y", |star| Some(vec![star.image.at[1]])),
    ("field-radius", |star| {
        let radius2 = star.image.at[0].powi(2) + star.image.at[1].powi(2);
        Some(vec![radius2, radius2 * radius2])
    }),
    ("field-azimuth", |star| {
        let [u, v] = star.image.at;
        Some(vec![u * u - v * v, 2.0 * u * v])
    }),
    ("column-half", |star| Some(vec![if star.image.at[0] > 0.0 { 0.5 } else { -0.5 }])),
    ("flux", |star| star.image.fullness.map(|fullness| vec![fullness, fullness * fullness])),
    ("magnitude", |star| Some(vec![star.magnitude, star.magnitude * star.magnitude])),
    ("colour", |star| star.image.colour_offset.map(|colour| vec![colour, colour * colour])),
    ("pixel-phase-x", |star| Some(phase(star.image.phase_px[0]))),
    ("pixel-phase-y", |star| Some(phase(star.image.phase_px[1]))),
    ("zenith", |star| star.image.airmass.map(|airmass| vec![airmass])),
    ("rate", |star| star.image.trail_px.map(|[x, y]| vec![x * x + y * y, x * x - y * y, 2.0 * x * y])),
    ("temperature", |star| star.image.temperature_offset_k.map(|kelvin| vec![kelvin, kelvin * kelvin])),
    ("time", |star| star.image.time_offset_h.map(|hours| vec![hours, hours * hours])),
];

fn phase(offset_px: f64) -> Vec<f64> {
    let turn = std::f64::consts::TAU * offset_px;
    vec![turn.sin(), turn.cos()]
}

//! Other ways to mend the same recordings, without naming anything: k2 and k3 with clipped outliers, a polynomial of the seventh degree, and
//! LASSO on a list of columns. All start from the joint calibration, are fitted on the frames that were set aside for none of them, and are judged by
//! one function ([`super::judge`]), as is the diagnosis itself: the effects that it names, fitted on the same frames.

use serde::{Deserialize, Serialize};

use super::AnswerFinding;
use super::judge::Judge;
use super::lasso::lasso_before;
use crate::calibrate::Column;
use crate::effects::ids;
use crate::effects::{Context, Observation, StarState, displacement};
use crate::identify::ControlPoints;

/// Held-out χ² per degree of freedom, with the errors that the generator declared.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RivalFits {
    /// x0, y0, f, k1, p1, p2 alone.
    pub baseline: f64,
    /// With k2 and k3, outliers beyond 3.5σ clipped.
    pub radial_clipped: f64,
    /// With all displacements of up to the seventh degree in x and y.
    pub polynomial: f64,
    /// With the effects that the diagnosis names; absent in answers of older builds.
    #[serde(default)]
    pub diagnosis: Option<f64>,
    /// LASSO on the same library.
    pub lasso: Option<f64>,
    /// What LASSO names.
    pub lasso_names: Option<Vec<String>>,
}

/// Degree of the polynomial.
const DEGREE: i32 = 7;
/// Coefficients of `radial-high-order`: k2 and k3.
const RADIAL: &str = ids::RADIAL_HIGH_ORDER;

/// The rivals, and what the diagnosis `named`, on control points whose model contains the effects `predicted`, judged on these frames. `None` if there is no
/// calibration to start from.
#[must_use]
pub fn rival_fits(points: &ControlPoints, known: &[String], named: &[AnswerFinding], held_out: &[usize]) -> Option<RivalFits> {
    let judge = Judge::new(points, known, held_out)?;
    let radial = judge.joint.columns_of(RADIAL, &[0.0, 0.0], &[0, 1])?;
    let found: Option<Vec<Vec<Column>>> = named.iter().map(|finding| columns_of_finding(&judge, points, finding)).collect();
    let lasso = lasso_before(&judge, points);
    Some(RivalFits {
        baseline: judge.of_fit(&[], false)?,
        radial_clipped: judge.of_fit(&radial, true)?,
        polynomial: judge.of_fit(&polynomial(&judge, points), false)?,
        diagnosis: found.and_then(|columns| judge.of_fit(&columns.concat(), false)),
        lasso: lasso.as_ref().map(|lasso| lasso.held_out),
        lasso_names: lasso.map(|lasso| lasso.names),
    })
}

/// The columns of an effect as it was found: those of its fitted parameters, where the others (a line, a length) stand.
fn columns_of_finding(judge: &Judge, points: &ControlPoints, finding: &AnswerFinding) -> Option<Vec<Column>> {
    let effect = displacement(&finding.id)?;
    let first = judge.joint.frames().first().map_or_else(Observation::default, |(_, observation)| *observation);
    let star = points.points.first().map_or_else(StarState::default, |point| point.star);
    let mut start = effect.identity(&Context::new(star, first))?;
    let searched = effect.searched(&first).map(|searched| searched.parameter);
    if let Some(index) = searched {
        let name = effect.parameters().get(index)?.name;
        let found = finding.parameters.iter().find(|parameter| parameter.name == name || parameter.name.ends_with(&format!(".{name}")))?;
        *start.get_mut(index)? = found.value;
    }
    let fitted: Vec<usize> = effect.default_free(&first).into_iter().filter(|index| Some(*index) != searched).collect();
    judge.joint.columns_of(&finding.id, &start, &fitted)
}

/// All displacements of up to the seventh degree in x and y: of the place where a star is predicted, as the camera's own columns are. At the
/// place where it is measured they would differ from those by the errors themselves, and the fit would take these out of every frame,
/// of those set aside too.
fn polynomial(judge: &Judge, points: &ControlPoints) -> Vec<Column> {
    let images = judge.joint.images();
    let half = points.nominal.width_px as f64 / 2.0;
    let [x0, y0] = judge.joint.model().camera().principal_point_px;
    let terms = (0..=DEGREE).flat_map(|total| (0..=total).map(move |j| (total - j, j)));
    terms
        .flat_map(|(i, j)| {
            let value = |k: usize| {
                let [x_px, y_px] = [0, 1].map(|axis| images[k].measured_px[axis] - images[k].residual_px[axis]);
                legendre(i, (x_px - x0) / half) * legendre(j, (y_px - y0) / half)
            };
            let values: Vec<f64> = (0..images.len()).map(value).collect();
            let along = |axis: usize| values.iter().map(|value| if axis == 0 { [*value, 0.0] } else { [0.0, *value] }).collect();
            [along(0), along(1)]
        })
        .collect()
}

/// Legendre polynomial, by its recurrence.
fn legendre(degree: i32, x: f64) -> f64 {
    let (mut before, mut now) = (1.0, x);
    if degree == 0 {
        return before;
    }
    for n in 1..degree {
        let n = f64::from(n);
        (before, now) = (now, ((2.0 * n + 1.0) * x * now - n * before) / (n + 1.0));
    }
    now
}

//! Fit of the reference model to correspondences, the last step of an import.

use nalgebra::{DMatrix, DVector, Rotation3, Vector3};

use super::ExchangeError;
use super::fit::{self, GOOD_PX, Linearised, Pair, Residual};
use crate::camera::Model;
use crate::dual::cross;
use crate::effects::displacement;
use crate::effects::ids;

/// Radial terms of higher order; in our model if this build has them.
const HIGHER_RADIAL: &str = ids::RADIAL_HIGH_ORDER;
/// Different focal lengths along columns and rows; likewise.
const ASPECT: &str = ids::PIXEL_ASPECT;

/// A start that is as near as this needs no fit, px.
const SAME_PX: f64 = 1e-9;

/// What may be fitted.
pub(super) struct Freedom {
    /// Principal point and focal length are those of the start, as long as they can.
    pub(super) hold_centre: bool,
    /// The foreign camera has two focal lengths.
    pub(super) aspect: bool,
    /// A small rotation of the directions is free: a sky's own axes, not the camera's.
    pub(super) rotation: bool,
}

/// A camera of ours, the rotation (vector, rad) that takes the directions given to its axes, and how near it comes.
pub(super) struct Nearest {
    pub(super) model: Model,
    pub(super) rotation_rad: [f64; 3],
    pub(super) residual: Residual,
}

/// A rotation vector applied to a direction.
pub(super) fn turned(rotation_rad: [f64; 3], direction: [f64; 3]) -> [f64; 3] {
    let turned = Rotation3::from_scaled_axis(Vector3::from(rotation_rad)) * Vector3::from(direction);
    [turned.x, turned.y, turned.z]
}

/// The model nearest to the correspondences, with as few parameters as bring the residual below [`GOOD_PX`]: first k1, p1, p2 alone, then with
/// principal point and focal length, then with the terms of higher order that this build has.
pub(super) fn nearest(
    start: &Model,
    pairs: &[Pair],
    freedom: &Freedom,
    source: impl Fn([f64; 2]) -> Option<[f64; 3]>,
) -> Result<Nearest, ExchangeError> {
    let judged = |model: Model, rotation_rad: [f64; 3]| {
        let size_px = [model.camera().width_px, model.camera().height_px];
        let residual = fit::residual(size_px, |pixel| source(pixel).map(|xyz| turned(rotation_rad, xyz)), fit::pixels(&model));
        Nearest { model, rotation_rad, residual }
    };
    let as_is = judged(start.clone(), [0.0; 3]);
    if as_is.residual.max_px < SAME_PX {
        return Ok(as_is);
    }
    let with = |model: &Model, id: &str| -> Option<Model> {
        let effect = displacement(id)?;
        let mut model = model.clone();
        model.set(id, &vec![0.0; effect.parameters().len()]).ok()?;
        Some(model)
    };
    let base = freedom.aspect.then(|| with(start, ASPECT)).flatten().unwrap_or_else(|| start.clone());
    let mut best: Option<Nearest> = None;
    for model in [Some(base.clone()), with(&base, HIGHER_RADIAL)].into_iter().flatten() {
        for hold_centre in [true, false] {
            if hold_centre && !freedom.hold_centre {
                continue;
            }
            let first = if hold_centre { 3 } else { 0 };
            let free: Vec<usize> = (first..model.values().len()).collect();
            let Ok((model, rotation_rad)) = fit_model(&model, &free, pairs, freedom.rotation) else { continue };
            let found = judged(model, rotation_rad);
            let residual = found.residual;
            if best.as_ref().is_none_or(|known| residual.max_px < known.residual.max_px) {
                best = Some(found);
            }
            if residual.max_px < GOOD_PX {
                return best.ok_or(ExchangeError::NoFit { what: "the reference model" });
            }
        }
    }
    best.ok_or(ExchangeError::NoFit { what: "the reference model" })
}

/// Least squares in measured pixels: the parameters with these indices, and the rotation if it is free.
pub(super) fn fit_model(start: &Model, free: &[usize], pairs: &[Pair], rotation: bool) -> Result<(Model, [f64; 3]), ExchangeError> {
    let what = "the reference model";
    let context = start.reference_context();
    let all = start.values();
    let whole = |own: &[f64]| {
        let mut values = all.clone();
        for (index, value) in free.iter().zip(own) {
            values[*index] = *value;
        }
        let turn: [f64; 3] = std::array::from_fn(|k| own.get(free.len() + k).copied().unwrap_or(0.0));
        (values, turn)
    };
    let count = free.len() + if rotation { 3 } else { 0 };
    let mut own: Vec<f64> = free.iter().map(|index| all[*index]).collect();
    own.resize(count, 0.0);
    let found = fit::least_squares(own, what, |own| {
        let (values, turn) = whole(own);
        let mut residuals = DVector::zeros(2 * pairs.len());
        let mut columns = DMatrix::zeros(2 * pairs.len(), count);
        for (k, pair) in pairs.iter().enumerate() {
            let seen = start.seen(&values, free, pair.pixel_px, &context)?;
            let target = turned(turn, pair.direction);
            // The shift of the pixel that a shift of the direction stands for, in the plane that touches the sphere there.
            let column = |axis: usize| seen.by_pixel.map(|component| component[axis]);
            let (u, v) = (column(0), column(1));
            let product = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
            let (uu, uv, vv) = (product(u, u), product(u, v), product(v, v));
            let determinant = uu * vv - uv * uv;
            if determinant.is_nan() || determinant <= 0.0 {
                return None;
            }
            let shift = |direction: [f64; 3]| {
                let (a, b) = (product(u, direction), product(v, direction));
                [(vv * a - uv * b) / determinant, (uu * b - uv * a) / determinant]
            };
            let error = shift(std::array::from_fn(|axis| seen.direction[axis] - target[axis]));
            for axis in 0..2 {
                residuals[2 * k + axis] = error[axis];
            }
            for (place, by) in seen.by_parameter.iter().enumerate() {
                let moved = shift(*by);
                (columns[(2 * k, place)], columns[(2 * k + 1, place)]) = (moved[0], moved[1]);
            }
            for (place, about) in (free.len()..count).zip([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) {
                let moved = shift(cross(about, target));
                (columns[(2 * k, place)], columns[(2 * k + 1, place)]) = (-moved[0], -moved[1]);
            }
        }
        residuals.iter().all(|value: &f64| value.is_finite()).then_some(Linearised { residuals, columns })
    })?;
    let (values, turn) = whole(&found);
    let mut model = start.clone();
    model.set_values(&values);
    Ok((model, turn))
}

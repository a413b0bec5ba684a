//! TPV: a tangential plane with a polynomial on its own coordinates, as SCAMP and SWarp have it. The polynomial lives in the axes of the sky, so
//! every frame has its own coefficients, all of the same distortion.

use super::ExchangeError;
use super::fit::{GOOD_PX, Residual};
use super::plane::{NOTHING_PX, Plane, no_rotation};
use super::view::View;
use super::wcs::{Distortion, TPV_COUNT, Wcs, tpv_exponents};
use crate::coordinates::Attitude;

/// The largest order the convention has.
const MAXIMUM_ORDER: i32 = 7;

/// The distortion of a camera.
pub(super) struct Tpv {
    plane: Plane,
    /// Order of the polynomials; 1 without distortion.
    pub(super) order: i32,
    /// Pixel to sky; polynomials of a whole order turn into each other, so it is the same for every frame.
    pub(super) residual: Residual,
    /// Coefficients of both polynomials in the camera's own axes.
    pub(super) coefficients: usize,
}

impl Tpv {
    /// The lowest order that brings the residual below [`GOOD_PX`].
    pub(super) fn of(view: &View<'_>, parity: i8) -> Result<Self, ExchangeError> {
        let plane = Plane::of(view, parity, "TPV")?;
        let mut best: Option<(i32, Residual, usize)> = None;
        for order in 1..=MAXIMUM_ORDER {
            let wcs = at(&plane, &no_rotation(), order)?;
            let residual = plane.residual(view, &wcs);
            if best.is_none_or(|(_, known, _)| residual.max_px < known.max_px) {
                let Distortion::Tpv(pv) = &wcs.distortion else { continue };
                best = Some((order, residual, pv.iter().flatten().filter(|c| **c != 0.0).count()));
            }
            if residual.max_px < GOOD_PX {
                break;
            }
        }
        let (order, residual, coefficients) = best.ok_or(ExchangeError::NoFit { what: "the polynomial of the distortion" })?;
        Ok(Self { plane, order, residual, coefficients })
    }

    /// What the header of a frame is made of.
    pub(super) fn ready(&self, attitude: &Attitude) -> Result<Wcs, ExchangeError> {
        at(&self.plane, attitude, self.order)
    }
}

/// The coordinates of a frame with a polynomial of this order.
fn at(plane: &Plane, attitude: &Attitude, order: i32) -> Result<Wcs, ExchangeError> {
    let (crval, cd) = plane.towards_sky(attitude);
    let to_degrees = |points: &[[f64; 2]]| -> Vec<[f64; 2]> {
        points.iter().map(|p| cd * nalgebra::Vector2::new(p[0], p[1])).map(|p| [p.x.to_degrees(), p.y.to_degrees()]).collect()
    };
    let (from, to) = (to_degrees(&plane.points), to_degrees(&plane.ideal_px));
    let (exponents, both) = Plane::polynomials(order, &from, &to)?;
    let reach_deg = from.iter().flatten().fold(0.0, |most: f64, value| value.abs().max(most));
    let nothing_deg = NOTHING_PX * (1.0 / plane.focal_px).to_degrees();
    let mut pv = Box::new([[0.0; TPV_COUNT]; 2]);
    for (axis, coefficients) in both.iter().enumerate() {
        for (index, own) in pv[axis].iter_mut().enumerate() {
            // The second polynomial's first variable is η.
            let Some((p, q)) = tpv_exponents(index).map(|(p, q)| if axis == 0 { (p, q) } else { (q, p) }) else { continue };
            let found = exponents.iter().position(|known| *known == (p, q)).map_or(0.0, |place| coefficients[place]);
            if found.abs() * reach_deg.powi(p + q) > nothing_deg {
                *own = found;
            }
        }
    }
    Ok(plane.wcs(crval, cd, Distortion::Tpv(pv)))
}

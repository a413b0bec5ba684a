//! TAN with the Simple Imaging Polynomial: A and B from the pixel to the sky, AP and BP back.

use nalgebra::{Matrix2, Vector2};

use super::ExchangeError;
use super::fit::{GOOD_PX, Residual};
use super::plane::{NOTHING_PX, Plane, no_rotation};
use super::wcs::{Distortion, Polynomials, Wcs};
use crate::camera::Model;
use crate::coordinates::Attitude;

/// The largest order that the convention has.
const MAXIMUM_ORDER: i32 = 9;

/// The distortion of a camera, the same for every frame.
pub(super) struct Sip {
    plane: Plane,
    /// What the polynomials' terms of first order say; it goes into CD.
    linear: Matrix2<f64>,
    forward: Polynomials,
    inverse: Polynomials,
    /// Order of A and B; 1 without any.
    pub(super) order: i32,
    /// Pixel to sky.
    pub(super) residual: Residual,
    /// Largest error of AP and BP over the frame.
    pub(super) inverse_max_px: f64,
}

impl Sip {
    /// The polynomials of the lowest orders that bring the residual below [`GOOD_PX`].
    pub(super) fn of(model: &Model, parity: i8) -> Result<Self, ExchangeError> {
        let mut best: Option<Self> = None;
        for order in 1..=MAXIMUM_ORDER {
            let found = Self::of_order(model, parity, order)?;
            let residual = found.residual;
            if best.as_ref().is_none_or(|known| residual.max_px < known.residual.max_px) {
                best = Some(found);
            }
            if residual.max_px < GOOD_PX {
                break;
            }
        }
        let mut best = best.ok_or(ExchangeError::NoFit { what: "the polynomial of the distortion" })?;
        let back = best.linear.try_inverse().ok_or(ExchangeError::NoFit { what: "the scale of the image" })?;
        (best.inverse, best.inverse_max_px) = inverse(&best.plane, &back)?;
        Ok(best)
    }

    fn of_order(model: &Model, parity: i8, order: i32) -> Result<Self, ExchangeError> {
        let plane = Plane::of(model, parity, "TAN-SIP")?;
        let (exponents, [a, b]) = Plane::polynomials(order, &plane.points, &plane.ideal_px)?;
        let linear = Matrix2::new(a[0], a[1], b[0], b[1]);
        let back = linear.try_inverse().ok_or(ExchangeError::NoFit { what: "the scale of the image" })?;
        let reach = plane.reach_px();
        let mut forward: Polynomials = Default::default();
        for (&(i, j), (a, b)) in exponents.iter().zip(a.iter().zip(&b)).skip(2) {
            let own = back * Vector2::new(*a, *b);
            for axis in 0..2 {
                if own[axis].abs() * reach.powi(i + j) > NOTHING_PX {
                    forward[axis].push((i, j, own[axis]));
                }
            }
        }
        let residual = Residual { rms_px: f64::INFINITY, max_px: f64::INFINITY, beyond_max_px: None };
        let mut sip = Self { plane, linear, forward, inverse: Default::default(), order, residual, inverse_max_px: 0.0 };
        sip.residual = sip.plane.residual(model, &sip.at(&no_rotation()));
        Ok(sip)
    }

    /// The coordinates of a frame.
    fn at(&self, attitude: &Attitude) -> Wcs {
        let (crval, matrix) = self.plane.towards_sky(attitude);
        let distortion = if self.order > 1 { Distortion::Sip(self.forward.clone()) } else { Distortion::None };
        self.plane.wcs(crval, matrix * self.linear, distortion)
    }

    /// The header of a frame.
    pub(super) fn header(&self, attitude: &Attitude, comments: &[String]) -> Vec<u8> {
        self.at(attitude).header(Some(&self.inverse), comments)
    }

    /// Coefficients of A and B.
    pub(super) fn coefficients(&self) -> usize {
        self.forward.iter().map(Vec::len).sum()
    }
}

/// AP and BP, from the plane without distortion to the pixel, and their largest error.
fn inverse(plane: &Plane, back: &Matrix2<f64>) -> Result<(Polynomials, f64), ExchangeError> {
    let straight: Vec<[f64; 2]> = plane.ideal_px.iter().map(|p| back * Vector2::new(p[0], p[1])).map(|p| [p.x, p.y]).collect();
    let shifts: Vec<[f64; 2]> = plane.points.iter().zip(&straight).map(|(u, w)| [u[0] - w[0], u[1] - w[1]]).collect();
    let mut best: Option<(Polynomials, f64)> = None;
    for order in 1..=MAXIMUM_ORDER {
        let (exponents, both) = Plane::polynomials(order, &straight, &shifts)?;
        let error = |(w, shift): (&[f64; 2], &[f64; 2])| {
            let sum = |k: usize| exponents.iter().zip(&both[k]).map(|((i, j), c)| c * w[0].powi(*i) * w[1].powi(*j)).sum::<f64>();
            (sum(0) - shift[0]).hypot(sum(1) - shift[1])
        };
        let max_px = straight.iter().zip(&shifts).map(error).fold(0.0, f64::max);
        if best.as_ref().is_none_or(|(_, known)| max_px < *known) {
            let terms = |k: usize| exponents.iter().zip(&both[k]).map(|((i, j), c)| (*i, *j, *c)).collect();
            best = Some(([terms(0), terms(1)], max_px));
        }
        if max_px < GOOD_PX {
            break;
        }
    }
    best.ok_or(ExchangeError::NoFit { what: "the inverse polynomial of the distortion" })
}

//! TAN with the Simple Imaging Polynomial: A and B from the pixel to the sky, AP and BP back.

use nalgebra::{Matrix2, Vector2};

use super::ExchangeError;
use super::fit::{GOOD_PX, Residual};
use super::plane::{NOTHING_PX, Plane, no_rotation};
use super::view::View;
use super::wcs::{Distortion, Polynomials, Wcs};
use crate::coordinates::Attitude;

/// The largest order that the convention has.
const MAXIMUM_ORDER: i32 = 9;

/// An order whose own points are off by more is not looked at further, px.
const MISSES_PX: f64 = 10.0 * GOOD_PX;

/// The distortion of a camera; in camera axes the same for every frame.
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
    pub(super) fn of(view: &View<'_>, parity: i8) -> Result<Self, ExchangeError> {
        let plane = Plane::of(view, parity, "TAN-SIP")?;
        let mut best: Option<Self> = None;
        for order in 1..=MAXIMUM_ORDER {
            let found = Self::of_order(view, &plane, order)?;
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

    fn of_order(view: &View<'_>, plane: &Plane, order: i32) -> Result<Self, ExchangeError> {
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
        let mut sip = Self { plane: plane.clone(), linear, forward, inverse: Default::default(), order, residual, inverse_max_px: 0.0 };
        // The residual over the frame costs more than the fit, so an order that misses its own points is not asked for it.
        let misses_px = plane.misses_px(&exponents, [&a, &b]);
        if order == MAXIMUM_ORDER || misses_px < MISSES_PX {
            sip.residual = sip.plane.residual(view, &sip.at(&no_rotation()));
        }
        Ok(sip)
    }

    /// The coordinates of a frame.
    fn at(&self, attitude: &Attitude) -> Wcs {
        let (crval, matrix) = self.plane.towards_sky(attitude);
        let distortion = if self.order > 1 { Distortion::Sip(self.forward.clone()) } else { Distortion::None };
        self.plane.wcs(crval, matrix * self.linear, distortion)
    }

    /// What the header of a frame is made of.
    pub(super) fn ready(&self, attitude: &Attitude) -> (Wcs, Polynomials) {
        (self.at(attitude), self.inverse.clone())
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

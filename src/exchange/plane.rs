//! Tangential plane of a frame, to which SIP and TPV fit their polynomials.

use nalgebra::Matrix2;

use super::ExchangeError;
use super::fit::{self, FIT_SIDE, Residual};
use super::view::View;
use super::wcs::{self, Distortion, Wcs};
use crate::coordinates::Attitude;

/// Exponents, and the coefficients of both axes.
pub(super) type Fitted = (Vec<(i32, i32)>, [Vec<f64>; 2]);

/// A term that moves no point of the frame by more than this is left out, px.
pub(super) const NOTHING_PX: f64 = 1e-9;

/// Points of the frame as stored, and where they are without distortion.
#[derive(Clone)]
pub(super) struct Plane {
    /// The pixel of the boresight, columns and rows as stored, from 0.
    pub(super) centre_px: [f64; 2],
    /// Focal length, px.
    pub(super) focal_px: f64,
    /// Columns and rows.
    pub(super) size_px: [usize; 2],
    /// −1 for mirrored images.
    pub(super) parity: i8,
    /// Columns and rows from the centre.
    pub(super) points: Vec<[f64; 2]>,
    /// f·(x/z, y/z) of their directions; x turned where the images are mirrored.
    pub(super) ideal_px: Vec<[f64; 2]>,
}

impl Plane {
    /// Of a camera (of the un-mirrored image).
    pub(super) fn of(view: &View<'_>, parity: i8, format: &'static str) -> Result<Self, ExchangeError> {
        let camera = view.model().camera();
        let size_px = [camera.width_px, camera.height_px];
        let centre = view.pixel([0.0, 0.0, 1.0]).map(|[x_px, y_px]| [stored_column(x_px, size_px, parity), y_px]);
        let centre_px = centre.ok_or_else(|| ExchangeError::NoRoom { format, reason: "no pixel looks along its boresight".to_owned() })?;
        let pairs = fit::pairs_of(view, FIT_SIDE)?;
        if pairs.iter().any(|pair| pair.direction[2] <= 1e-3) {
            let reason = "part of its frame looks 90° or more from the boresight, where the tangential plane does not reach".to_owned();
            return Err(ExchangeError::NoRoom { format, reason });
        }
        let (f, sign) = (camera.focal_length_px, f64::from(parity));
        let point = |pixel: [f64; 2]| [stored_column(pixel[0], size_px, parity) - centre_px[0], pixel[1] - centre_px[1]];
        let points = pairs.iter().map(|pair| point(pair.pixel_px)).collect();
        let ideal_px = pairs.iter().map(|pair| pair.direction).map(|[x, y, z]| [sign * f * x / z, f * y / z]).collect();
        Ok(Self { centre_px, focal_px: f, size_px, parity, points, ideal_px })
    }

    /// CRVAL and the matrix from px on the plane to (ξ, η), rad.
    pub(super) fn towards_sky(&self, attitude: &Attitude) -> ([f64; 2], Matrix2<f64>) {
        let (crval, matrix) = wcs::plane(attitude, self.parity);
        (crval, matrix / self.focal_px)
    }

    /// Coefficients, on both axes, of all terms up to an order, without a constant, whose sums are nearest to the targets.
    pub(super) fn polynomials(order: i32, points: &[[f64; 2]], targets: &[[f64; 2]]) -> Result<Fitted, ExchangeError> {
        let exponents: Vec<(i32, i32)> = (1..=order).flat_map(|n| (0..=n).map(move |j| (n - j, j))).collect();
        let axis = |k: usize| {
            let targets: Vec<f64> = targets.iter().map(|target| target[k]).collect();
            fit::polynomial(&exponents, points, &targets, "the polynomial of the distortion")
        };
        let both = [axis(0)?, axis(1)?];
        Ok((exponents, both))
    }

    /// How far polynomials are off at the worst of the points that they were fitted to, px.
    pub(super) fn misses_px(&self, exponents: &[(i32, i32)], both: [&[f64]; 2]) -> f64 {
        let error = |(point, ideal): (&[f64; 2], &[f64; 2])| {
            let sum = |k: usize| exponents.iter().zip(both[k]).map(|((i, j), c)| c * point[0].powi(*i) * point[1].powi(*j)).sum::<f64>();
            (sum(0) - ideal[0]).hypot(sum(1) - ideal[1])
        };
        self.points.iter().zip(&self.ideal_px).map(error).fold(0.0, f64::max)
    }

    /// A header at an attitude.
    pub(super) fn wcs(&self, crval_rad: [f64; 2], cd_rad: Matrix2<f64>, distortion: Distortion) -> Wcs {
        let crpix = [self.centre_px[0] + 1.0, self.centre_px[1] + 1.0];
        Wcs { crpix, crval_rad, cd_rad, distortion, size_px: Some(self.size_px) }
    }

    /// Where the camera puts the directions that a header made for the view's own axes ([`no_rotation`]) gives to the pixels, against the pixels.
    pub(super) fn residual(&self, view: &View<'_>, wcs: &Wcs) -> Residual {
        let direction = |pixel: [f64; 2]| Some(wcs.direction([stored_column(pixel[0], self.size_px, self.parity), pixel[1]]));
        fit::residual(self.size_px, direction, |xyz| view.pixel(xyz))
    }

    /// The largest |coordinate| of the points, px.
    pub(super) fn reach_px(&self) -> f64 {
        self.points.iter().flatten().fold(0.0, |most, value| value.abs().max(most))
    }
}

/// The attitude at which the axes of the sky are those of the camera.
pub(super) fn no_rotation() -> Attitude {
    Attitude::new(nalgebra::UnitQuaternion::identity())
}

/// The column of the frame as stored of a column of the un-mirrored one; and the other way round.
pub(super) fn stored_column(x_px: f64, size_px: [usize; 2], parity: i8) -> f64 {
    if parity < 0 { size_px[0] as f64 - 1.0 - x_px } else { x_px }
}

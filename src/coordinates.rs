//! Directions on the sky and points on the detector, each with the frame it is given in.
//!
//! ```text
//! Icrs ──(proper motion, parallax, aberration, refraction)──▶ Apparent ──attitude──▶ CameraAxes ──camera──▶ pixel
//! ```
//! [`Icrs`] and [`Apparent`] share the same axes; they differ in what has been done to the light. A direction that came in
//! through aberration and refraction cannot be handed to code that expects a catalogue direction, and the other way round.

use std::marker::PhantomData;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::dual::{Real, constant, dot, normalize};

/// Catalogue directions: axes of the ICRS, seen from the barycentre of the solar system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Icrs;
/// Directions as the light arrives at the camera, in the axes of the ICRS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Apparent;
/// Camera axes: x right (columns), y down (rows), z out along the boresight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CameraAxes;

/// A direction (unit vector) given in the frame `F`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Direction<F, T = f64> {
    /// The components; their length is one.
    pub xyz: [T; 3],
    frame: PhantomData<F>,
}

impl<F, T: Real> Direction<F, T> {
    /// A direction from any vector along it.
    #[must_use]
    pub fn along(vector: [T; 3]) -> Self {
        Self { xyz: normalize(vector), frame: PhantomData }
    }

    /// A direction from components whose length is already one.
    #[must_use]
    pub fn from_unit(xyz: [T; 3]) -> Self {
        Self { xyz, frame: PhantomData }
    }
}

impl<F> Direction<F> {
    /// The direction at right ascension and declination, both in radians.
    ///
    /// ```
    /// use boresight::coordinates::{Direction, Icrs};
    ///
    /// let pole = Direction::<Icrs>::from_radec_rad(0.0, std::f64::consts::FRAC_PI_2);
    /// let equator = Direction::<Icrs>::from_radec_rad(1.0, 0.0);
    /// assert!((pole.angle_rad(&equator) - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    /// ```
    #[must_use]
    pub fn from_radec_rad(ra_rad: f64, dec_rad: f64) -> Self {
        let (sin_ra, cos_ra) = ra_rad.sin_cos();
        let (sin_dec, cos_dec) = dec_rad.sin_cos();
        Self::from_unit([cos_ra * cos_dec, sin_ra * cos_dec, sin_dec])
    }

    /// Right ascension (0…2π) and declination, in radians.
    #[must_use]
    pub fn radec_rad(&self) -> (f64, f64) {
        let [x, y, z] = self.xyz;
        (y.atan2(x).rem_euclid(std::f64::consts::TAU), z.atan2(x.hypot(y)))
    }

    /// The angle between two directions in radians, exact for small and for large angles.
    #[must_use]
    pub fn angle_rad(&self, other: &Self) -> f64 {
        let (a, b) = (Vector3::from(self.xyz), Vector3::from(other.xyz));
        a.cross(&b).norm().atan2(a.dot(&b))
    }

    /// The same direction as numbers that depend on no parameter.
    #[must_use]
    pub fn lift<T: Real>(&self) -> Direction<F, T> {
        Direction::from_unit(constant(self.xyz))
    }
}

/// How the camera is turned: takes components in ICRS axes to components in camera axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(from = "[f64; 4]", into = "[f64; 4]")]
pub struct Attitude {
    /// The rotation.
    pub camera_from_icrs: UnitQuaternion<f64>,
}

impl Attitude {
    /// From a rotation.
    #[must_use]
    pub fn new(camera_from_icrs: UnitQuaternion<f64>) -> Self {
        Self { camera_from_icrs }
    }

    /// The attitude whose boresight points at (`ra_rad`, `dec_rad`) and whose upward direction in the image (−y) stands at
    /// the position angle `roll_rad`, counted from north through east.
    #[must_use]
    pub fn from_pointing(ra_rad: f64, dec_rad: f64, roll_rad: f64) -> Self {
        let (sin_ra, cos_ra) = ra_rad.sin_cos();
        let (sin_dec, cos_dec) = dec_rad.sin_cos();
        let boresight = Vector3::new(cos_ra * cos_dec, sin_ra * cos_dec, sin_dec);
        let north = Vector3::new(-cos_ra * sin_dec, -sin_ra * sin_dec, cos_dec);
        let east = Vector3::new(-sin_ra, cos_ra, 0.0);
        let up = north * roll_rad.cos() + east * roll_rad.sin();
        let down = -up;
        let right = down.cross(&boresight);
        let rows = nalgebra::Matrix3::from_rows(&[right.transpose(), down.transpose(), boresight.transpose()]);
        let rotation = nalgebra::Rotation3::from_matrix_unchecked(rows);
        Self::new(UnitQuaternion::from_rotation_matrix(&rotation))
    }

    /// Right ascension and declination of the boresight, and the position angle of the image's upward direction there, rad: what
    /// [`Self::from_pointing`] takes.
    #[must_use]
    pub fn pointing_rad(&self) -> [f64; 3] {
        let [_, down, boresight] = self.rows();
        let (ra, dec) = Direction::<Apparent>::from_unit(boresight).radec_rad();
        let (sin_ra, cos_ra) = ra.sin_cos();
        let (sin_dec, cos_dec) = dec.sin_cos();
        let north = dot(down, [-cos_ra * sin_dec, -sin_ra * sin_dec, cos_dec]);
        let east = dot(down, [-sin_ra, cos_ra, 0.0]);
        [ra, dec, (-east).atan2(-north)]
    }

    /// The attitude after a turn of the camera by this vector, in its own axes, rad.
    #[must_use]
    pub fn turned(&self, by_rad: [f64; 3]) -> Self {
        Self::new(UnitQuaternion::from_scaled_axis(-Vector3::from(by_rad)) * self.camera_from_icrs)
    }

    /// The three rows of the rotation matrix: the camera's axes in ICRS components.
    #[must_use]
    pub fn rows(&self) -> [[f64; 3]; 3] {
        let matrix = self.camera_from_icrs.to_rotation_matrix();
        let m = matrix.matrix();
        [0, 1, 2].map(|row| [m[(row, 0)], m[(row, 1)], m[(row, 2)]])
    }

    /// Turns an apparent direction into camera axes.
    #[must_use]
    pub fn camera_from_apparent<T: Real>(&self, direction: &Direction<Apparent, T>) -> Direction<CameraAxes, T> {
        Direction::from_unit(self.rows().map(|row| dot(constant(row), direction.xyz)))
    }

    /// Turns a direction in camera axes into the axes of the ICRS.
    #[must_use]
    pub fn apparent_from_camera(&self, direction: &Direction<CameraAxes>) -> Direction<Apparent> {
        let v = self.camera_from_icrs.inverse() * Vector3::from(direction.xyz);
        Direction::from_unit([v.x, v.y, v.z])
    }
}

impl From<[f64; 4]> for Attitude {
    /// From a quaternion, scalar last.
    fn from([i, j, k, w]: [f64; 4]) -> Self {
        Self::new(UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k)))
    }
}

impl From<Attitude> for [f64; 4] {
    /// A quaternion, scalar last and not negative.
    fn from(attitude: Attitude) -> Self {
        let q = attitude.camera_from_icrs;
        let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
        [q.i * sign, q.j * sign, q.k * sign, q.w * sign]
    }
}

/// A point on the detector: x to the right, y down, (0, 0) = the centre of the first pixel stored.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PixelPoint<T = f64> {
    /// Column.
    pub x_px: T,
    /// Row.
    pub y_px: T,
}

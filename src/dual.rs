//! Forward-mode dual numbers: a value and its derivatives from one body of code.
//!
//! A displacement is written once, generic over [`Real`]. Called with `f64` it gives the position that the renderer uses;
//! called with [`Dual`] it gives the same position and the columns that the calibrator fits, so the two cannot disagree.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// How many derivatives one pass carries. Models with more parameters take several passes.
pub const PARTIALS: usize = 8;

/// The dual number that the program uses.
pub type Jet = Dual<PARTIALS>;

/// What a displacement may do with a number.
pub trait Real:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Add<f64, Output = Self>
    + Sub<f64, Output = Self>
    + Mul<f64, Output = Self>
    + Div<f64, Output = Self>
{
    /// A number that depends on no parameter.
    fn constant(value: f64) -> Self;
    /// The value without its derivatives.
    fn value(self) -> f64;
    /// Square root.
    #[must_use]
    fn sqrt(self) -> Self;
    /// Sine of an angle in radians.
    #[must_use]
    fn sin(self) -> Self;
    /// Cosine of an angle in radians.
    #[must_use]
    fn cos(self) -> Self;
    /// e to this power.
    #[must_use]
    fn exp(self) -> Self;
    /// Natural logarithm.
    #[must_use]
    fn ln(self) -> Self;
    /// The angle of the point (`x`, self) from the x axis, rad.
    #[must_use]
    fn atan2(self, x: Self) -> Self;
}

impl Real for f64 {
    fn constant(value: f64) -> Self {
        value
    }
    fn value(self) -> f64 {
        self
    }
    fn sqrt(self) -> Self {
        self.sqrt()
    }
    fn sin(self) -> Self {
        self.sin()
    }
    fn cos(self) -> Self {
        self.cos()
    }
    fn exp(self) -> Self {
        self.exp()
    }
    fn ln(self) -> Self {
        self.ln()
    }
    fn atan2(self, x: Self) -> Self {
        self.atan2(x)
    }
}

/// A value with its derivatives with respect to `N` parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual<const N: usize> {
    /// The value.
    pub value: f64,
    /// The derivatives.
    pub partials: [f64; N],
}

impl<const N: usize> Dual<N> {
    /// Parameter number `index`: its own derivative is one.
    ///
    /// # Panics
    /// If `index` is not below `N`.
    #[must_use]
    pub fn variable(value: f64, index: usize) -> Self {
        let mut partials = [0.0; N];
        partials[index] = 1.0;
        Self { value, partials }
    }

    /// The chain rule for a function of one number: `value` = g(self), `slope` = g′(self).
    fn chain(self, value: f64, slope: f64) -> Self {
        Self { value, partials: self.partials.map(|d| slope * d) }
    }

    /// A function of two numbers, given its value and its two slopes.
    fn chain2(self, other: Self, value: f64, slope: f64, slope_other: f64) -> Self {
        let mut partials = self.partials;
        for (d, e) in partials.iter_mut().zip(other.partials) {
            *d = slope * *d + slope_other * e;
        }
        Self { value, partials }
    }
}

impl<const N: usize> Real for Dual<N> {
    fn constant(value: f64) -> Self {
        Self { value, partials: [0.0; N] }
    }
    fn value(self) -> f64 {
        self.value
    }
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, 0.5 / root)
    }
    fn sin(self) -> Self {
        let (sin, cos) = self.value.sin_cos();
        self.chain(sin, cos)
    }
    fn cos(self) -> Self {
        let (sin, cos) = self.value.sin_cos();
        self.chain(cos, -sin)
    }
    fn exp(self) -> Self {
        let power = self.value.exp();
        self.chain(power, power)
    }
    fn ln(self) -> Self {
        self.chain(self.value.ln(), 1.0 / self.value)
    }
    fn atan2(self, x: Self) -> Self {
        let square = self.value * self.value + x.value * x.value;
        self.chain2(x, self.value.atan2(x.value), x.value / square, -self.value / square)
    }
}

impl<const N: usize> Add for Dual<N> {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        self.chain2(other, self.value + other.value, 1.0, 1.0)
    }
}
impl<const N: usize> Sub for Dual<N> {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self.chain2(other, self.value - other.value, 1.0, -1.0)
    }
}
impl<const N: usize> Mul for Dual<N> {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        self.chain2(other, self.value * other.value, other.value, self.value)
    }
}
impl<const N: usize> Div for Dual<N> {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let quotient = self.value / other.value;
        self.chain2(other, quotient, 1.0 / other.value, -quotient / other.value)
    }
}
impl<const N: usize> Neg for Dual<N> {
    type Output = Self;
    fn neg(self) -> Self {
        self.chain(-self.value, -1.0)
    }
}
impl<const N: usize> Add<f64> for Dual<N> {
    type Output = Self;
    fn add(self, other: f64) -> Self {
        self.chain(self.value + other, 1.0)
    }
}
impl<const N: usize> Sub<f64> for Dual<N> {
    type Output = Self;
    fn sub(self, other: f64) -> Self {
        self.chain(self.value - other, 1.0)
    }
}
impl<const N: usize> Mul<f64> for Dual<N> {
    type Output = Self;
    fn mul(self, other: f64) -> Self {
        self.chain(self.value * other, other)
    }
}
impl<const N: usize> Div<f64> for Dual<N> {
    type Output = Self;
    fn div(self, other: f64) -> Self {
        self.chain(self.value / other, 1.0 / other)
    }
}

/// Scalar product of two vectors.
pub fn dot<T: Real>(a: [T; 3], b: [T; 3]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Sum of two vectors.
pub fn add<T: Real>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// A vector times a number.
pub fn scale<T: Real>(a: [T; 3], factor: T) -> [T; 3] {
    a.map(|component| component * factor)
}

/// Vector product of two vectors.
pub fn cross<T: Real>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// A vector turned by an angle (rad) about an axis of length one, counterclockwise seen from its tip: Rodrigues' formula.
pub fn rotate<T: Real>(a: [T; 3], axis: [T; 3], angle: T) -> [T; 3] {
    let (sin, cos) = (angle.sin(), angle.cos());
    let along = dot(axis, a) * (T::constant(1.0) - cos);
    add(add(scale(a, cos), scale(cross(axis, a), sin)), scale(axis, along))
}

/// The vector of length one in the same direction.
pub fn normalize<T: Real>(a: [T; 3]) -> [T; 3] {
    let length = dot(a, a).sqrt();
    a.map(|component| component / length)
}

/// A vector that depends on no parameter.
pub fn constant<T: Real>(a: [f64; 3]) -> [T; 3] {
    a.map(T::constant)
}

//! Vectors of three, as the generator needs them.

/// A vector.
pub(super) type V3 = [f64; 3];

pub(super) fn dot(a: V3, b: V3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn cross(a: V3, b: V3) -> V3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// a + k·b
pub(super) fn plus(a: V3, k: f64, b: V3) -> V3 {
    [a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]]
}

pub(super) fn times(a: V3, k: f64) -> V3 {
    a.map(|component| component * k)
}

pub(super) fn unit(a: V3) -> V3 {
    times(a, 1.0 / dot(a, a).sqrt())
}

/// Unit vectors to the east and to the north.
pub(super) fn east_and_north(at: V3) -> (V3, V3) {
    let east = unit([-at[1], at[0], 0.0]);
    (east, cross(at, east))
}

/// Rows of a matrix times a vector.
pub(super) fn turned(rows: &[V3; 3], v: V3) -> V3 {
    [dot(rows[0], v), dot(rows[1], v), dot(rows[2], v)]
}

/// The transposed matrix times a vector.
pub(super) fn turned_back(rows: &[V3; 3], v: V3) -> V3 {
    plus(plus(times(rows[0], v[0]), v[1], rows[1]), v[2], rows[2])
}

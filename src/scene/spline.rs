//! Cubic spline through rotation vectors.

/// A curve through rotation vectors at given times: a cubic spline that is twice differentiable, with the ends that need no guess (not-a-knot:
/// the first two pieces are one cubic, and the last two).
#[derive(Clone, Debug, PartialEq)]
pub struct RotationSpline {
    times_s: Vec<f64>,
    turns_rad: Vec<[f64; 3]>,
    /// Second derivatives at the knots, rad/s².
    bends: Vec<[f64; 3]>,
}

impl RotationSpline {
    /// Through `turns_rad` at rising `times_s`, two or more.
    #[must_use]
    pub fn new(times_s: Vec<f64>, turns_rad: Vec<[f64; 3]>) -> Self {
        let mut bends = vec![[0.0; 3]; times_s.len()];
        for axis in 0..3 {
            let values: Vec<f64> = turns_rad.iter().map(|turn| turn[axis]).collect();
            for (bend, value) in bends.iter_mut().zip(second_derivatives(&times_s, &values)) {
                bend[axis] = value;
            }
        }
        Self { times_s, turns_rad, bends }
    }

    /// The piece that holds a time, and how far into it the time lies.
    fn piece(&self, time_s: f64) -> (usize, f64, f64) {
        let piece = self.times_s.partition_point(|time| *time <= time_s).clamp(1, self.times_s.len() - 1) - 1;
        (piece, self.times_s[piece + 1] - self.times_s[piece], time_s - self.times_s[piece])
    }

    /// The rotation vector, rad.
    #[must_use]
    pub fn at(&self, time_s: f64) -> [f64; 3] {
        let (piece, length, into) = self.piece(time_s);
        let (b, a) = (into / length, 1.0 - into / length);
        std::array::from_fn(|axis| {
            let (from, to) = (self.turns_rad[piece][axis], self.turns_rad[piece + 1][axis]);
            let (bend_from, bend_to) = (self.bends[piece][axis], self.bends[piece + 1][axis]);
            a * from + b * to + ((a * a * a - a) * bend_from + (b * b * b - b) * bend_to) * length * length / 6.0
        })
    }

    /// Its derivative, rad/s.
    #[must_use]
    pub fn rate_at(&self, time_s: f64) -> [f64; 3] {
        let (piece, length, into) = self.piece(time_s);
        let (b, a) = (into / length, 1.0 - into / length);
        std::array::from_fn(|axis| {
            let slope = (self.turns_rad[piece + 1][axis] - self.turns_rad[piece][axis]) / length;
            let (bend_from, bend_to) = (self.bends[piece][axis], self.bends[piece + 1][axis]);
            slope + ((3.0 * b * b - 1.0) * bend_to - (3.0 * a * a - 1.0) * bend_from) * length / 6.0
        })
    }

    /// The knots between −`half_s` and `half_s`, s.
    #[must_use]
    pub fn knots_within(&self, half_s: f64) -> &[f64] {
        let first = self.times_s.partition_point(|time| *time <= -half_s);
        let end = self.times_s.partition_point(|time| *time < half_s);
        &self.times_s[first.min(end)..end]
    }
}

/// Second derivatives of the not-a-knot spline; a parabola through three points, a straight line through two.
fn second_derivatives(x: &[f64], y: &[f64]) -> Vec<f64> {
    let n = x.len();
    let step: Vec<f64> = x.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let slope: Vec<f64> = (0..n - 1).map(|i| (y[i + 1] - y[i]) / step[i]).collect();
    if n == 2 {
        return vec![0.0; 2];
    }
    if n == 3 {
        return vec![2.0 * (slope[1] - slope[0]) / (step[0] + step[1]); 3];
    }
    // Unknowns are the inner ones; the outermost follow from them: m₀ = ((h₀ + h₁)·m₁ − h₀·m₂)/h₁.
    let inner = n - 2;
    let (mut diagonal, mut upper, mut lower) = (vec![0.0; inner], vec![0.0; inner], vec![0.0; inner]);
    let mut right = vec![0.0; inner];
    for row in 0..inner {
        let (before, after) = (step[row], step[row + 1]);
        diagonal[row] = 2.0 * (before + after);
        lower[row] = before;
        upper[row] = after;
        right[row] = 6.0 * (slope[row + 1] - slope[row]);
    }
    let (h0, h1) = (step[0], step[1]);
    diagonal[0] += h0 * (h0 + h1) / h1;
    upper[0] -= h0 * h0 / h1;
    let (g0, g1) = (step[n - 2], step[n - 3]);
    diagonal[inner - 1] += g0 * (g0 + g1) / g1;
    lower[inner - 1] -= g0 * g0 / g1;
    for row in 1..inner {
        let factor = lower[row] / diagonal[row - 1];
        diagonal[row] -= factor * upper[row - 1];
        right[row] -= factor * right[row - 1];
    }
    let mut bends = vec![0.0; n];
    for row in (0..inner).rev() {
        let beyond = if row + 1 < inner { upper[row] * bends[row + 2] } else { 0.0 };
        bends[row + 1] = (right[row] - beyond) / diagonal[row];
    }
    bends[0] = ((h0 + h1) * bends[1] - h0 * bends[2]) / h1;
    bends[n - 1] = ((g0 + g1) * bends[n - 2] - g0 * bends[n - 3]) / g1;
    bends
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cubic is met exactly, with uneven knots and at the ends; so is its slope.
    #[test]
    fn a_cubic_is_its_own_spline() {
        let cubic = |t: f64| [0.1 + 0.3 * t - 0.2 * t * t + 0.05 * t * t * t, -0.4 * t * t * t, 0.2 * t];
        let rate = |t: f64| [0.3 - 0.4 * t + 0.15 * t * t, -1.2 * t * t, 0.2];
        let times = vec![-1.0, -0.7, -0.1, 0.3, 0.4, 1.1];
        let spline = RotationSpline::new(times.clone(), times.iter().map(|t| cubic(*t)).collect());
        for step in 0..=42 {
            let t = -1.0 + 0.05 * f64::from(step);
            for axis in 0..3 {
                assert!((spline.at(t)[axis] - cubic(t)[axis]).abs() < 1e-13, "{t}");
                assert!((spline.rate_at(t)[axis] - rate(t)[axis]).abs() < 1e-12, "{t}");
            }
        }
    }

    #[test]
    fn few_knots_give_a_line_and_a_parabola() {
        let line = RotationSpline::new(vec![0.0, 2.0], vec![[0.0; 3], [2.0, 4.0, -2.0]]);
        assert_eq!(line.at(0.5), [0.5, 1.0, -0.5]);
        let parabola = RotationSpline::new(vec![0.0, 1.0, 3.0], vec![[0.0; 3], [1.0, 0.0, 0.0], [9.0, 0.0, 0.0]]);
        assert!((parabola.at(2.0)[0] - 4.0).abs() < 1e-14 && (parabola.rate_at(2.5)[0] - 5.0).abs() < 1e-14);
    }
}

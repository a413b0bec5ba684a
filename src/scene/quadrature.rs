//! Gauss–Legendre quadrature of an exposure over time.

use std::sync::LazyLock;

/// The largest rule kept.
pub(super) const MAX_NODES: usize = 64;

/// Nodes in (−1, 1) and weights, which add up to 1, of the rule with `count` nodes, 1 … [`MAX_NODES`].
pub(super) fn gauss_legendre(count: usize) -> &'static [[f64; 2]] {
    static RULES: LazyLock<Vec<Vec<[f64; 2]>>> = LazyLock::new(|| (1..=MAX_NODES).map(rule).collect());
    &RULES[count.clamp(1, MAX_NODES) - 1]
}

/// By Newton's method on the Legendre polynomial, from Tricomi's approximation of its zeros.
fn rule(count: usize) -> Vec<[f64; 2]> {
    let n = count as f64;
    let node = |index: usize| {
        let mut x = -(std::f64::consts::PI * (index as f64 + 0.75) / (n + 0.5)).cos();
        let mut slope = 1.0;
        for _ in 0..100 {
            let (mut before, mut now) = (1.0, x);
            for degree in 2..=count {
                let k = degree as f64;
                (before, now) = (now, ((2.0 * k - 1.0) * x * now - (k - 1.0) * before) / k);
            }
            slope = n * (x * now - before) / (x * x - 1.0);
            let step = now / slope;
            x -= step;
            if step.abs() < 1e-15 {
                break;
            }
        }
        [x, 1.0 / ((1.0 - x * x) * slope * slope)]
    };
    if count == 1 { vec![[0.0, 1.0]] } else { (0..count).map(node).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A rule of n nodes is exact for polynomials up to the degree 2n − 1.
    #[test]
    fn polynomials_are_integrated_exactly() {
        for count in [1, 2, 3, 5, 17, 50, MAX_NODES] {
            for degree in 0..i32::try_from(2 * count).unwrap().min(60) {
                let sum: f64 = gauss_legendre(count).iter().map(|[x, w]| w * x.powi(degree)).sum();
                let exact = if degree % 2 == 0 { 1.0 / f64::from(degree + 1) } else { 0.0 };
                assert!((sum - exact).abs() < 1e-14, "{count} nodes, degree {degree}: {sum} instead of {exact}");
            }
        }
    }
}

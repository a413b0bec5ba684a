//! Errors in two dimensions with a t distribution: weight, cost and ψ of residuals whitened by their scatter. Infinite ν means normal errors.
//!
//! Source: Lange, Little and Taylor, J. Am. Stat. Assoc. 84, 881 (1989).

/// Weight of a residual with square `q` under ν = `tail_degrees`.
pub(crate) fn weight(tail_degrees: f64, q: f64) -> f64 {
    if tail_degrees.is_finite() { (tail_degrees + 2.0) / (tail_degrees + q) } else { 1.0 }
}

/// −2·ln of the density over its value at zero, summed over the pairs taken. `residual`: x, y, x, y, …
pub(crate) fn cost(residual: &[f64], take: &[bool], tail_degrees: f64) -> f64 {
    let of = |k: usize| {
        let q = residual[2 * k].powi(2) + residual[2 * k + 1].powi(2);
        if tail_degrees.is_finite() { (tail_degrees + 2.0) * (q / tail_degrees).ln_1p() } else { q }
    };
    (0..take.len()).filter(|k| take[*k]).map(of).sum()
}

/// ψ, the residuals times their weights, and the mean of its derivative over the pairs taken.
pub(crate) fn psi_of(residual: &[f64], take: &[bool], tail_degrees: f64) -> (Vec<f64>, f64) {
    let mut psi = vec![0.0; residual.len()];
    let (mut slope, mut count) = (0.0, 0.0);
    for k in (0..take.len()).filter(|k| take[*k]) {
        let q = residual[2 * k].powi(2) + residual[2 * k + 1].powi(2);
        let w = weight(tail_degrees, q);
        psi[2 * k] = w * residual[2 * k];
        psi[2 * k + 1] = w * residual[2 * k + 1];
        slope += if tail_degrees.is_finite() { w * tail_degrees / (tail_degrees + q) } else { 1.0 };
        count += 1.0;
    }
    (psi, if count > 0.0 { slope / count } else { 1.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ψ is half the slope of the cost, and its mean derivative that of the trace of the second derivative over two.
    #[test]
    fn psi_is_the_slope_of_the_cost() {
        let (residual, take) = ([0.7, -1.3, 2.5, 0.4], [true, true]);
        for tail_degrees in [3.0, 10.0, f64::INFINITY] {
            let (psi, _) = psi_of(&residual, &take, tail_degrees);
            for k in 0..residual.len() {
                let at = |step: f64| {
                    let mut moved = residual;
                    moved[k] += step;
                    cost(&moved, &take, tail_degrees)
                };
                let slope = (at(1e-5) - at(-1e-5)) / 2e-5;
                assert!((slope - 2.0 * psi[k]).abs() < 1e-7, "ν = {tail_degrees}: {slope} for {}", 2.0 * psi[k]);
            }
        }
    }

    #[test]
    fn what_is_not_taken_does_not_count() {
        let (psi, slope) = psi_of(&[1.0, 1.0, 9.0, 9.0], &[true, false], f64::INFINITY);
        assert_eq!((psi, slope), (vec![1.0, 1.0, 0.0, 0.0], 1.0));
        assert!((cost(&[1.0, 1.0, 9.0, 9.0], &[true, false], f64::INFINITY) - 2.0).abs() < 1e-12);
    }
}

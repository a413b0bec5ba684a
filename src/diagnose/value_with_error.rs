//! A number with its standard error, as text.

/// `value ± sigma`, as many digits as the error bears.
pub(super) fn with_error(value: f64, sigma: f64) -> String {
    if !(sigma > 0.0 && sigma.is_finite()) {
        return format!("{value:.4}");
    }
    let digits = 1 - sigma.log10().floor() as i32;
    if (0..=6).contains(&digits) {
        let digits = usize::try_from(digits).unwrap_or(0);
        format!("{value:.digits$} ± {sigma:.digits$}")
    } else if digits < 0 && digits > -5 {
        format!("{value:.0} ± {sigma:.0}")
    } else {
        let exponent = sigma.log10().floor() as i32;
        let unit = 10.0_f64.powi(exponent);
        format!("({:.1} ± {:.1})e{exponent}", value / unit, sigma / unit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_has_two_digits_and_the_value_as_many_places() {
        let texts = [(0.78141, 7.5e-4), (-5.764e-4, 0.059), (101.4, 22.3), (12_345.0, 678.0), (3e-9, 4e-10)]
            .map(|(value, sigma)| with_error(value, sigma));
        assert_eq!(texts, ["0.78141 ± 0.00075", "-0.001 ± 0.059", "101 ± 22", "12345 ± 678", "(30.0 ± 4.0)e-10"].map(str::to_owned));
        assert_eq!(with_error(4.0, 0.0), "4.0000");
    }
}

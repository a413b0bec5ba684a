//! # Quantum efficiency by colour
//!
//! ## What it does
//!
//! A camera does not see stars through the V band: a detector that is sensitive to 1000 nm counts more electrons of a red star
//! than of a white one of the same V magnitude.
//!
//! ## Equation
//!
//! electrons = zero point · 10^(−0.4 V) · t · F(T)/F(T₀), F(T) = ∫ Q(λ) τ(λ) N(λ, T) dλ / ∫ V(λ) N(λ, T)/λ dλ, where N(λ, T) ∝
//! λ⁻⁴/(exp(c₂/λT) − 1) are the photons of a black body, Q is the quantum efficiency, τ the optics' transmission and V(λ) the V band as a response
//! to energy. T = 4600 K·(1/(0.92 c + 1.7) + 1/(0.92 c + 0.62)), c = B − V, held within −0.4 … 2; T₀ that of B − V = 0.6 (5968 K): the zero point is that of
//! a star like the Sun, and a star of unknown colour counts as one. With one number instead: F(T)/F(T₀) = 10^(−0.4 k (B − V − 0.6)).
//!
//! ## Parameters
//!
//! In a scene, `[detector.quantum_efficiency]`: `wavelengths_nm`, `values` (Q) and, if wanted, `transmission` (τ) at the same
//! wavelengths, straight lines between them; their scale is of no account, the zero point has it. Or `colour_term_mag_per_mag` (k) of `[detector]`:
//! −0.5 to 0 without a filter, 0 in the V band.
//!
//! ## Signature
//!
//! Magnitudes that follow the colour, by 0.35 mag from B − V = 0.6 to 1.5 for a silicon detector without a filter; weights
//! of stars that are too small or too large. No displacement by itself.
//!
//! ## Confused with
//!
//! Extinction in the air, which also depends on the altitude; the magnitude equation, which follows the brightness.
//!
//! ## Neglected
//!
//! Lines and jumps of spectra (such as Balmer's below 365 nm), reddening by dust, giants and dwarfs of one colour;
//! whether V(λ) answers to energy or to photons, which is 1 % at B − V = 1.5.
//!
//! ## Source
//!
//! F. J. Ballesteros, EPL 97, 34008 (2012), equation 14, for the temperature; M. S. Bessell, PASP 102, 1181 (1990), table 2, for V(λ).

use crate::effects::{ParameterSpec, StarState};

/// What a scene may say of it, for the list of effects.
pub const PARAMETERS: &[ParameterSpec] = &[
    ParameterSpec { name: "wavelengths_nm", unit: "nm", typical: 550.0, range: (100.0, 20_000.0) },
    ParameterSpec { name: "values", unit: "", typical: 0.6, range: (0.0, 1.0) },
    ParameterSpec { name: "transmission", unit: "", typical: 0.9, range: (0.0, 1.0) },
    ParameterSpec { name: "colour_term_mag_per_mag", unit: "mag/mag", typical: -0.3, range: (-2.0, 2.0) },
];

/// The page's text.
#[must_use]
pub fn source() -> &'static str {
    page_source!("quantum_efficiency.rs")
}

/// Second radiation constant h·c/k (CODATA 2018), nm·K.
const C2_NM_K: f64 = 1.438_776_877e7;

/// Bluest and reddest B − V for which a temperature is worked out.
const COLOURS: [f64; 2] = [-0.4, 2.0];

/// The V band from 470 nm in steps of 10 nm.
const V_BAND: [f64; 24] = [
    0.0, 0.030, 0.163, 0.458, 0.780, 0.967, 1.000, 0.973, 0.898, 0.792, 0.684, 0.574, 0.461, 0.359, 0.270, 0.197, 0.135, 0.081, 0.045,
    0.025, 0.017, 0.013, 0.009, 0.0,
];

/// Temperature of a star of this B − V, K.
#[must_use]
pub fn temperature_k(colour: f64) -> f64 {
    let scaled = 0.92 * colour.clamp(COLOURS[0], COLOURS[1]);
    4600.0 * (1.0 / (scaled + 1.7) + 1.0 / (scaled + 0.62))
}

/// Photons of a black body per wavelength, in units of its own.
fn photons(wavelength_nm: f64, temperature_k: f64) -> f64 {
    (550.0 / wavelength_nm).powi(4) / (C2_NM_K / (wavelength_nm * temperature_k)).exp_m1()
}

/// A response over the wavelengths, ready to be summed: wavelengths with response times the weight of Simpson's rule.
#[derive(Clone, Debug, PartialEq)]
pub struct ResponseCurve {
    points: Vec<[f64; 2]>,
}

impl ResponseCurve {
    /// Straight lines between points of increasing wavelength (nm), nothing beyond; as many values as wavelengths.
    #[must_use]
    pub fn new(wavelengths_nm: &[f64], values: &[f64]) -> Self {
        /// The black body of 3000 K at 300 nm, where it rises most steeply, is summed to 1e-6.
        const LONGEST_STEP_NM: f64 = 10.0;
        let mut points = Vec::new();
        for (ends, heights) in wavelengths_nm.windows(2).zip(values.windows(2)) {
            let steps = ((ends[1] - ends[0]) / LONGEST_STEP_NM).ceil().max(1.0) as usize;
            let step_nm = (ends[1] - ends[0]) / steps as f64;
            for half_step in 0..=2 * steps {
                let share = half_step as f64 / (2 * steps) as f64;
                let weight = match half_step {
                    0 => 1.0,
                    last if last == 2 * steps => 1.0,
                    odd if odd % 2 == 1 => 4.0,
                    _ => 2.0,
                };
                let response = heights[0] + share * (heights[1] - heights[0]);
                points.push([ends[0] + share * (ends[1] - ends[0]), response * weight * step_nm / 6.0]);
            }
        }
        points.retain(|[_, weighted]| *weighted != 0.0);
        Self { points }
    }

    /// The V band as a response to photons: that to energy over the wavelength.
    fn v_band() -> Self {
        let wavelengths_nm: [f64; 24] = std::array::from_fn(|step| 470.0 + 10.0 * step as f64);
        let mut band = Self::new(&wavelengths_nm, &V_BAND);
        for [wavelength_nm, weighted] in &mut band.points {
            *weighted *= 550.0 / *wavelength_nm;
        }
        band
    }

    /// Sum over the photons of a black body.
    fn of_black_body(&self, temperature_k: f64) -> f64 {
        self.points.iter().map(|[wavelength_nm, weighted]| weighted * photons(*wavelength_nm, temperature_k)).sum()
    }

    /// What the camera sees of a star of this B − V, over what the V band sees of it.
    #[must_use]
    pub fn over_v(&self, colour: f64) -> f64 {
        let temperature_k = temperature_k(colour);
        self.of_black_body(temperature_k) / Self::v_band().of_black_body(temperature_k)
    }
}

/// How the electrons of a star follow its colour.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum ColourResponse {
    /// Not at all: V is what counts.
    #[default]
    Grey,
    /// By a constant slope.
    Term {
        /// k, magnitudes per magnitude of B − V.
        mag_per_mag: f64,
    },
    /// By the camera's response over the wavelengths.
    Curve(ResponseCurve),
}

impl ColourResponse {
    /// Electrons of a star of this B − V over those of a star of B − V = 0.6 with the same V; 1 where the colour is not known.
    #[must_use]
    pub fn relative(&self, colour: Option<f64>) -> f64 {
        let Some(colour) = colour else { return 1.0 };
        match self {
            Self::Grey => 1.0,
            Self::Term { mag_per_mag } => 10.0_f64.powf(-0.4 * mag_per_mag * (colour - StarState::REFERENCE_COLOUR)),
            Self::Curve(curve) => curve.over_v(colour) / curve.over_v(StarState::REFERENCE_COLOUR),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WAVELENGTHS_NM: [f64; 7] = [350.0, 450.0, 550.0, 650.0, 750.0, 900.0, 1000.0];
    const VALUES: [f64; 7] = [0.2, 0.5, 0.6, 0.55, 0.45, 0.2, 0.05];

    /// scipy 1.17.1: the integrals of the page by `quad`, piece by piece to 1e-12, with the constants of `scipy.constants`.
    #[test]
    fn electrons_follow_the_black_body() {
        let silicon = ColourResponse::Curve(ResponseCurve::new(&WAVELENGTHS_NM, &VALUES));
        for (colour, expected) in
            [(-0.3, 0.944_727_699_023), (0.0, 0.929_419_995_195), (0.6, 1.0), (1.0, 1.123_728_859_225), (1.5, 1.379_207_847_807)]
        {
            let found = silicon.relative(Some(colour));
            assert!((found / expected - 1.0).abs() < 1e-6, "B - V = {colour}: {found} instead of {expected}");
        }
        // The temperature at the colour of the reference, from the formula by hand, and a colour beyond the relation.
        assert!((temperature_k(0.6) - 5_967.543_45).abs() < 1e-4);
        assert_eq!(silicon.relative(Some(9.0)), silicon.relative(Some(2.0)));
        assert_eq!(silicon.relative(None), 1.0);
    }

    /// Twice the response gives the same colours; a camera that sees the V band itself has none.
    #[test]
    fn only_the_shape_of_the_curve_counts() {
        let halves = VALUES.map(|value| 0.5 * value);
        let [whole, half] = [VALUES, halves].map(|values| ColourResponse::Curve(ResponseCurve::new(&WAVELENGTHS_NM, &values)));
        let v_band = ColourResponse::Curve(ResponseCurve::v_band());
        for colour in [-0.2, 0.3, 1.8] {
            assert!((whole.relative(Some(colour)) / half.relative(Some(colour)) - 1.0).abs() < 1e-12);
            assert!((v_band.relative(Some(colour)) - 1.0).abs() < 1e-12);
        }
        assert_ne!(whole.relative(Some(0.3)), 1.0);
    }

    #[test]
    fn a_colour_term_is_a_slope_in_magnitudes() {
        let term = ColourResponse::Term { mag_per_mag: -0.5 };
        assert!((term.relative(Some(1.6)) - 10.0_f64.powf(0.2)).abs() < 1e-15);
        assert_eq!(term.relative(None), 1.0);
        assert_eq!(ColourResponse::Grey.relative(Some(1.6)), 1.0);
    }
}

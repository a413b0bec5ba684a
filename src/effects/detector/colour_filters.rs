//! # Colour filters of a mosaic
//!
//! ## What it does
//!
//! The red, green and blue filters over the pixels of a colour sensor let a red star's light through in other shares than a white one's. In the
//! raw frame a star is a mosaic of its own: how bright it is on red pixels beside green ones depends on its colour.
//!
//! ## Equation
//!
//! Of a star of B − V = c the pixels of filter k (red at even columns of even rows, blue at odd columns of odd rows, green elsewhere) count
//! electrons · w_k, w_k = F_k(T)/F_k(T₀), F_k(T) = ∫ Q(λ) τ(λ) f_k(λ) N(λ, T) dλ / ∫ V(λ) N(λ, T)/λ dλ as on the page of `quantum-efficiency`, f_k the
//! filter's transmission, T₀ the temperature of B − V = 0.6. What a filter does to all light alike is the effect `bayer`: r = F_R(T₀)/F_G(T₀) on red and b =
//! F_B(T₀)/F_G(T₀) on blue pixels; a scene with curves has it without being told. With one number instead: w_R = 1 + q·(c − 0.6), w_G = 1, w_B = 1 − q·(c −
//! 0.6), the law of the displacement `bayer`.
//!
//! ## Parameters
//!
//! In a scene, `[detector.colour_filters]`: `wavelengths_nm` with `red`, `green` and `blue` (f_k), straight lines between the points; the zero
//! point is that of the green pixels and a star like the Sun. Or `relative_per_mag` (q), 0.1 to 0.5.
//!
//! ## Signature
//!
//! Shifts of the centre towards red or blue pixels in proportion to the colour, 0.03 px for 30 % between them; fluxes that
//! follow the phase within the pattern.
//!
//! ## Confused with
//!
//! `even-odd` and `bayer` without colour, which do the same to all stars; lateral colour, which is smooth over the field.
//!
//! ## Neglected
//!
//! As on the page of `quantum-efficiency`; light that goes through a neighbour's filter; other patterns; that the charge of cosmic rays passes
//! no filter (the effect `bayer` weakens it as if it did), and that the sky's light has the colour of B − V = 0.6.
//!
//! ## Source
//!
//! B. E. Bayer, US patent 3,971,065 (1976), for the pattern; else those of `quantum-efficiency`.

use super::quantum_efficiency::{ColourResponse, ResponseCurve};
use crate::effects::{ParameterSpec, StarState};

/// What a scene may say of it, for the list of effects.
pub const PARAMETERS: &[ParameterSpec] = &[
    ParameterSpec { name: "wavelengths_nm", unit: "nm", typical: 550.0, range: (100.0, 20_000.0) },
    ParameterSpec { name: "red", unit: "", typical: 0.8, range: (0.0, 1.0) },
    ParameterSpec { name: "green", unit: "", typical: 0.8, range: (0.0, 1.0) },
    ParameterSpec { name: "blue", unit: "", typical: 0.7, range: (0.0, 1.0) },
    ParameterSpec { name: "relative_per_mag", unit: "1/mag", typical: 0.2, range: (-1.0, 1.0) },
];

/// The page's text.
#[must_use]
pub fn source() -> &'static str {
    page_source!("colour_filters.rs")
}

/// The filter over a pixel: 0 red, 1 green, 2 blue.
#[must_use]
pub fn filter_at(column: usize, row: usize) -> usize {
    match (column % 2, row % 2) {
        (0, 0) => 0,
        (1, 1) => 2,
        _ => 1,
    }
}

/// How the filters share the light of stars of different colours.
#[derive(Clone, Debug, PartialEq)]
pub enum FilterResponse {
    /// By a constant slope.
    Slope {
        /// q, by how much more than green ones red pixels count, per magnitude of B − V.
        relative_per_mag: f64,
    },
    /// By the responses of red, green and blue pixels over the wavelengths.
    Curves(Box<[ResponseCurve; 3]>),
}

impl FilterResponse {
    /// What red, green and blue pixels count of a star of this B − V, over the electrons that `colours` says of it, before what filters do to all light
    /// alike; 1 where the colour is not known.
    #[must_use]
    pub fn relative(&self, colour: Option<f64>, colours: &ColourResponse) -> [f64; 3] {
        let Some(colour) = colour else { return [1.0; 3] };
        match self {
            Self::Slope { relative_per_mag } => {
                let share = relative_per_mag * (colour - StarState::REFERENCE_COLOUR);
                [(1.0 + share).max(0.0), 1.0, (1.0 - share).max(0.0)]
            }
            Self::Curves(curves) => {
                let said = colours.relative(Some(colour));
                [0, 1, 2].map(|k| curves[k].over_v(colour) / curves[k].over_v(StarState::REFERENCE_COLOUR) / said)
            }
        }
    }

    /// What red and blue pixels count over green ones of a star of B − V = 0.6; `None` where that is not said.
    #[must_use]
    pub fn white(&self) -> Option<[f64; 2]> {
        let Self::Curves(curves) = self else { return None };
        let [red, green, blue] = [0, 1, 2].map(|k| curves[k].over_v(StarState::REFERENCE_COLOUR));
        Some([red / green, blue / green])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCIPY_RELATIVE: [f64; 3] = [1.332_036_623_213, 0.991_408_871_758, 0.693_734_522_261];
    const SCIPY_WHITE: [f64; 2] = [1.103_442_112_465, 0.934_467_206_038];
    const WAVELENGTHS_NM: [f64; 5] = [400.0, 480.0, 550.0, 620.0, 700.0];

    fn filters() -> FilterResponse {
        let curve = |values: [f64; 5]| ResponseCurve::new(&WAVELENGTHS_NM, &values);
        FilterResponse::Curves(Box::new([
            curve([0.0, 0.0, 0.1, 0.9, 0.8]),
            curve([0.0, 0.3, 0.9, 0.2, 0.0]),
            curve([0.8, 0.9, 0.1, 0.0, 0.0]),
        ]))
    }

    /// scipy 1.17.1: the integrals by `quad`, piece by piece to 1e-12, for B − V = 1.4 and for the reference colour.
    #[test]
    fn filters_share_light_by_the_black_body() {
        let found = filters().relative(Some(1.4), &ColourResponse::Grey);
        for (found, expected) in found.into_iter().zip(SCIPY_RELATIVE) {
            assert!((found / expected - 1.0).abs() < 1e-6, "{found} instead of {expected}");
        }
        let [red, blue] = filters().white().unwrap();
        assert!((red / SCIPY_WHITE[0] - 1.0).abs() < 1e-6 && (blue / SCIPY_WHITE[1] - 1.0).abs() < 1e-6, "{red} {blue}");
        assert_eq!(filters().relative(None, &ColourResponse::Grey), [1.0; 3]);
        // What was said of the star's electrons already is not counted twice.
        let term = ColourResponse::Term { mag_per_mag: -0.5 };
        let after = filters().relative(Some(1.4), &term);
        assert!((after[0] * term.relative(Some(1.4)) / found[0] - 1.0).abs() < 1e-12);
    }

    #[test]
    fn one_number_is_the_law_of_the_displacement() {
        let slope = FilterResponse::Slope { relative_per_mag: 0.5 };
        assert_eq!(slope.relative(Some(1.6), &ColourResponse::Grey), [1.5, 1.0, 0.5]);
        assert_eq!(slope.relative(Some(3.6), &ColourResponse::Grey), [2.5, 1.0, 0.0]);
        assert_eq!((slope.white(), filter_at(0, 0), filter_at(1, 0), filter_at(4, 7), filter_at(3, 3)), (None, 0, 1, 1, 2));
    }
}

//! Gain, read noise and bias as the sky's own noise tells them, where the recording declares no gain.
//!
//! Nothing is missing where nothing is declared: they are no findings, but numbers that the recording gives. The line of variance against level tells
//! the gain; its intercept is one number for read noise and bias (`pixel_statistics/photon_transfer.rs`), so that one of them has to be known.

use super::noise_kind::DeclaredDetector;
use crate::diagnose::causes::GAIN_NOISE;
use crate::diagnose::diagnosis::{EffectState, EffectStatus, FoundParameter};
use crate::pixel_statistics::{PhotonTransfer, PixelStatistics};

/// Why sky and stars tell no gain, where the noise of the sky is as the light made it.
const TOO_LITTLE: &str = "the levels of the sky differ too little to tell it, or its noise is less than 0.6 steps of the counts, and the stars are too few or too faint";

/// The status of the detector's numbers; nothing where a gain is declared, for then it is held against the sky.
pub(super) fn measured_detector(pixels: &PixelStatistics, declared: &DeclaredDetector) -> Option<EffectStatus> {
    if declared.gain_e_per_dn.is_some() {
        return None;
    }
    let altered = pixels.altered_noise();
    let nothing = || (Vec::new(), format!("no gain is declared; {}", altered.unwrap_or(TOO_LITTLE)));
    let line = pixels.photon_transfer.as_ref().filter(|_| altered.is_none());
    let (parameters, reason) = line.and_then(|line| detector_numbers(line, declared)).unwrap_or_else(nothing);
    Some(EffectStatus {
        id: GAIN_NOISE.to_owned(),
        status: EffectState::NotApplicable,
        p_value: None,
        p_value_is: None,
        score_sigma: None,
        survival: None,
        parameters,
        upper_limit_95: None,
        held_out_delta_chi2: None,
        reason,
    })
}

/// Gain, and read noise or bias where the other one is declared, with a sentence that says whence; nothing where the line tells no gain.
#[must_use]
pub fn detector_numbers(line: &PhotonTransfer, declared: &DeclaredDetector) -> Option<(Vec<FoundParameter>, String)> {
    let (gain, sigma) = line.gain_e_per_dn.zip(line.gain_sigma)?;
    let number =
        |name: &str, [value, sigma]: [f64; 2], unit: &str| FoundParameter { name: name.to_owned(), value, sigma, unit: unit.to_owned() };
    let mut parameters = vec![number("gain_e_per_dn", [gain, sigma], "e/DN")];
    let read_noise = declared.bias_dn.and_then(|bias| line.read_noise_e(bias));
    let bias = declared.read_noise_e.and_then(|read_noise| line.bias_dn(read_noise));
    parameters.extend(read_noise.map(|(value, sigma)| number("read_noise_e", [value, sigma], "e")));
    parameters.extend(bias.map(|(value, sigma)| number("bias_dn", [value, sigma], "DN")));
    let rest = match (read_noise, bias) {
        (Some((value, sigma)), _) => format!("; with the bias as declared the read noise is {value:.2} ± {sigma:.2} e"),
        (None, Some((value, sigma))) => format!("; with the read noise as declared the bias is {value:.1} ± {sigma:.1} DN"),
        // σ_r² = g²·(c − q²/12) + g·b.
        (None, None) => {
            let at_no_bias_e2 = gain * gain * (line.intercept_dn2 - line.step_dn * line.step_dn / 12.0);
            format!(
                "; read noise and bias cannot be told apart: they lie on (read noise / e)² = {at_no_bias_e2:.1} + {gain:.4}·(bias / DN)"
            )
        }
    };
    Some((parameters, format!("no gain is declared: {} {gain:.4} ± {sigma:.4} electrons per count{rest}", told_by(line))))
}

/// Whose noise tells the gain, in words.
fn told_by(line: &PhotonTransfer) -> String {
    /// Of what differs by more the sky's value stands.
    const SIGMAS: f64 = 3.0;
    /// Who knows less than this share of the slope is not named.
    const MIN_SHARE: f64 = 0.04;
    let sky = "the noise of the sky gives".to_owned();
    let Some(stars) = &line.stars else { return sky };
    let share = line.share_of_stars();
    if (stars.slope_dn - line.slope_dn).abs() > SIGMAS * stars.slope_sigma_dn.hypot(line.slope_sigma_dn) {
        let [gain, sigma] = [stars.slope_dn.recip(), stars.slope_sigma_dn / (stars.slope_dn * stars.slope_dn)];
        return format!("the noise of the light of {} stars gives {gain:.4} ± {sigma:.4}, that of the sky, which is taken,", stars.stars);
    }
    match share {
        _ if share < MIN_SHARE => sky,
        _ if share > 1.0 - MIN_SHARE => format!("the noise of the light of {} stars gives", stars.stars),
        _ => format!("the noise of the sky and of the light of {} stars gives", stars.stars),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixel_statistics::{Estimate, NeighbourCorrelation, StarTransfer};

    /// Variance = level/2 + 3.5 DN²: of a bias of 100 DN and a gain of 2 e/DN the read noise is √(4·(3.5 − 1/12 + 50)) e.
    fn line() -> PhotonTransfer {
        PhotonTransfer {
            gain_e_per_dn: Some(2.0),
            gain_sigma: Some(0.01),
            slope_dn: 0.5,
            slope_sigma_dn: 0.0025,
            intercept_dn2: 3.5 - 50.0,
            intercept_sigma_dn2: 0.2,
            covariance_dn3: 0.0,
            curvature: 0.0,
            curvature_sigma: 1.0,
            chi2_per_dof: 1.0,
            step_dn: 1.0,
            levels_dn: [300.0, 900.0],
            points: 20,
            stars: None,
        }
    }

    #[test]
    fn what_is_not_declared_is_measured_as_far_as_it_can_be_told() {
        let pixels = PixelStatistics { photon_transfer: Some(line()), ..PixelStatistics::default() };
        let told = |declared: &DeclaredDetector| measured_detector(&pixels, declared).map(|own| (own.parameters, own.reason));
        let names = |declared: &DeclaredDetector| -> Vec<String> {
            told(declared).map_or_else(Vec::new, |(parameters, _)| parameters.into_iter().map(|own| own.name).collect())
        };
        let nothing = DeclaredDetector::default();
        assert_eq!(names(&nothing), ["gain_e_per_dn"]);
        // At the true bias the line has the true read noise.
        let (_, reason) = told(&nothing).unwrap();
        let numbers: Vec<f64> = reason.split([' ', '·']).filter_map(|word| word.parse().ok()).collect();
        let [.., at_no_bias_e2, slope] = numbers[..] else { panic!("{reason}") };
        assert!((at_no_bias_e2 + slope * 100.0 - 4.0 * (3.5 - 1.0 / 12.0)).abs() < 0.1, "{reason}");
        let (parameters, _) = told(&DeclaredDetector { bias_dn: Some(100.0), ..nothing }).unwrap();
        assert_eq!(parameters[1].name, "read_noise_e");
        assert!((parameters[1].value - (4.0 * (3.5 - 1.0 / 12.0_f64)).sqrt()).abs() < 1e-9);
        assert_eq!(names(&DeclaredDetector { read_noise_e: Some(3.7), ..nothing }), ["gain_e_per_dn", "bias_dn"]);
        assert!(told(&DeclaredDetector { gain_e_per_dn: Some(2.0), ..nothing }).is_none());
        let stars = |slope_dn: f64, slope_sigma_dn: f64| {
            let (misfit2, misfit2_sigma, chi2_per_dof, stars) = (0.0, 1e-5, 1.0, 200);
            StarTransfer { slope_dn, slope_sigma_dn, misfit2, misfit2_sigma, chi2_per_dof, stars }
        };
        let by = |own: StarTransfer| detector_numbers(&line().with_stars(own), &nothing).unwrap().1;
        assert!(by(stars(0.5, 1.0)).contains("the noise of the sky gives 2.0000"));
        assert!(by(stars(0.5, 0.0025)).contains("the noise of the sky and of the light of 200 stars gives 2.0000"));
        assert!(by(stars(0.5, 0.0001)).contains("the noise of the light of 200 stars gives 2.0000"));
        assert!(by(stars(0.8, 0.0025)).contains("of 200 stars gives 1.2500 ± 0.0039, that of the sky, which is taken, 2.0000"));
        let none = measured_detector(&PixelStatistics::default(), &nothing).unwrap();
        assert!(none.parameters.is_empty() && none.reason.contains("too little"));
    }

    #[test]
    fn processed_frames_tell_no_gain() {
        let shared = Estimate { value: 0.3, sigma: 6e-4 };
        let neighbours = NeighbourCorrelation { column: shared, row: shared, ..NeighbourCorrelation::default() };
        let pixels = PixelStatistics { photon_transfer: Some(line()), neighbours: Some(neighbours), ..PixelStatistics::default() };
        let told = measured_detector(&pixels, &DeclaredDetector::default()).unwrap();
        assert!(told.parameters.is_empty() && told.reason.contains("share their noise"), "{told:?}");
    }
}

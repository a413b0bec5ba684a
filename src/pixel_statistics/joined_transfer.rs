//! One line of photon transfer by the sky's pixels and the stars.

use super::photon_transfer::PhotonTransfer;
use super::star_transfer::StarTransfer;

/// A gain is told where the slope is at least so many of its standard errors.
const MIN_SLOPE_SIGMAS: f64 = 5.0;
/// Sky and stars that differ by more than this do not tell one gain.
const AGREE_SIGMAS: f64 = 3.0;

impl PhotonTransfer {
    /// The line through one level of the sky, its variance known to `sigma_dn2`, with the slope that the stars tell.
    #[must_use]
    pub fn at_level(level_dn: f64, [variance_dn2, sigma_dn2]: [f64; 2], step_dn: f64, stars: StarTransfer) -> Self {
        let (slope, slope_sigma) = (stars.slope_dn, stars.slope_sigma_dn);
        let line = Self {
            gain_e_per_dn: None,
            gain_sigma: None,
            slope_dn: slope,
            slope_sigma_dn: slope_sigma,
            intercept_dn2: variance_dn2 - slope * level_dn,
            intercept_sigma_dn2: sigma_dn2.hypot(slope_sigma * level_dn),
            covariance_dn3: -slope_sigma * slope_sigma * level_dn,
            curvature: 0.0,
            curvature_sigma: f64::INFINITY,
            chi2_per_dof: 1.0,
            step_dn,
            levels_dn: [level_dn; 2],
            points: 1,
            stars: Some(stars),
        };
        line.with_slope([slope, slope_sigma])
    }

    /// With another slope, and the gain that it tells.
    fn with_slope(self, [slope, sigma]: [f64; 2]) -> Self {
        let is_told = slope > MIN_SLOPE_SIGMAS * sigma;
        Self {
            gain_e_per_dn: is_told.then(|| 1.0 / slope),
            gain_sigma: is_told.then(|| sigma / (slope * slope)),
            slope_dn: slope,
            slope_sigma_dn: sigma,
            ..self
        }
    }

    /// The line through the sky's points with the slope that the stars tell, weighted by what each knows. Where the two differ beyond chance it stays as it is
    /// if the sky tells a gain; else what slope it has is of other things, and the stars' goes through its middle.
    #[must_use]
    pub fn with_stars(self, stars: StarTransfer) -> Self {
        let told = Self { stars: Some(stars), ..self };
        let [own2, theirs2] = [told.slope_sigma_dn, stars.slope_sigma_dn].map(|sigma| sigma * sigma);
        let differ = (stars.slope_dn - told.slope_dn) / (own2 + theirs2).sqrt();
        if differ.abs() >= AGREE_SIGMAS && told.gain_e_per_dn.is_none() {
            let middle_dn = -told.covariance_dn3 / own2;
            let variance_dn2 = told.intercept_dn2 + told.slope_dn * middle_dn;
            let sigma_dn2 = (told.intercept_sigma_dn2.powi(2) - middle_dn * middle_dn * own2).max(0.0).sqrt();
            let through = Self::at_level(middle_dn, [variance_dn2, sigma_dn2], told.step_dn, stars);
            return Self { points: told.points, levels_dn: told.levels_dn, ..through };
        }
        if !(differ.abs() < AGREE_SIGMAS && theirs2 > 0.0) {
            return told;
        }
        // One more measurement of the slope, by which the intercept moves as it goes with the slope.
        let [share, rest] = [own2, theirs2].map(|variance| variance / (own2 + theirs2));
        let carried = told.covariance_dn3 / (own2 + theirs2);
        let step = stars.slope_dn - told.slope_dn;
        let slope = [told.slope_dn + share * step, (own2 * rest).sqrt()];
        let moved = Self {
            intercept_dn2: told.intercept_dn2 + carried * step,
            intercept_sigma_dn2: (told.intercept_sigma_dn2.powi(2) - carried * told.covariance_dn3).max(0.0).sqrt(),
            covariance_dn3: told.covariance_dn3 * rest,
            ..told
        };
        moved.with_slope(slope)
    }

    /// The share of what is known of the slope that the stars tell.
    #[must_use]
    pub fn share_of_stars(&self) -> f64 {
        self.stars.map_or(0.0, |stars| (self.slope_sigma_dn / stars.slope_sigma_dn).powi(2))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sky(slope: [f64; 2], level_dn: f64) -> PhotonTransfer {
        // A well-known variance of 60 DN² at the level.
        let [slope_dn, sigma] = slope;
        PhotonTransfer {
            gain_e_per_dn: None,
            gain_sigma: None,
            slope_dn,
            slope_sigma_dn: sigma,
            intercept_dn2: 60.0 - slope_dn * level_dn,
            intercept_sigma_dn2: (0.01 + (sigma * level_dn).powi(2)).sqrt(),
            covariance_dn3: -sigma * sigma * level_dn,
            curvature: 0.0,
            curvature_sigma: 1.0,
            chi2_per_dof: 1.0,
            step_dn: 1.0,
            levels_dn: [level_dn; 2],
            points: 20,
            stars: None,
        }
    }

    #[test]
    fn stars_turn_the_line_about_the_level_of_the_sky() {
        let stars = StarTransfer { slope_dn: 0.4, slope_sigma_dn: 0.004, misfit2: 0.0, misfit2_sigma: 1e-5, chi2_per_dof: 1.0, stars: 300 };
        let line = sky([0.1, 0.3], 100.0).with_stars(stars);
        assert!((line.gain_e_per_dn.unwrap() - 2.5).abs() < 0.01, "{line:?}");
        assert!((line.slope_sigma_dn - 0.004).abs() < 1e-5);
        // The variance at the level is what the sky says, whatever the slope.
        assert!((line.intercept_dn2 + line.slope_dn * 100.0 - 60.0).abs() < 1e-9, "{line:?}");
        let at_level = line.intercept_sigma_dn2.powi(2) + 2.0 * 100.0 * line.covariance_dn3 + (100.0 * line.slope_sigma_dn).powi(2);
        assert!((at_level - 0.01).abs() < 1e-6, "{at_level}");
        let alone = PhotonTransfer::at_level(100.0, [60.0, 0.1], 1.0, stars);
        assert!((alone.intercept_dn2 - line.intercept_dn2).abs() < 0.03 && (alone.slope_dn - line.slope_dn).abs() < 1e-4, "{alone:?}");
        assert!((alone.intercept_sigma_dn2 / line.intercept_sigma_dn2 - 1.0).abs() < 0.01);
        assert!(
            line.share_of_stars() > 0.999 && (alone.share_of_stars() - 1.0).abs() < 1e-12 && sky([0.1, 0.3], 9.0).share_of_stars() == 0.0
        );
        let apart = PhotonTransfer { gain_e_per_dn: Some(1.0 / 0.6), ..sky([0.6, 0.01], 100.0) }.with_stars(stars);
        assert_eq!((apart.slope_dn, apart.stars), (0.6, Some(stars)), "where they differ the sky's line stays");
        let turned = sky([-0.1, 0.05], 100.0).with_stars(stars);
        assert!((turned.slope_dn - 0.4).abs() < 1e-9 && (turned.intercept_dn2 + 40.0 - 60.0).abs() < 1e-6, "it gives way: {turned:?}");
    }
}

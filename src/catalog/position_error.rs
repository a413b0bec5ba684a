//! How far a catalogue position may be off after some years.
//!
//! Where the proper motion is known, the error is that of the catalogue. Where it is not, the star has moved by an unknown
//! amount, and what such stars do is read off the stars whose motion is known: for magnitudes 4.0 ≤ V < 6.7, where the
//! sample is complete, the 68.27 % quantile σ of |μ| per axis (robust: it asks what most stars do) falls with magnitude as
//!
//! ```text
//! ln σ = ln σ₆.₅ − b (V − 6.5)
//! ```
//! The fit is made by the command that packs the catalogue, and repeated by a test on the packed one. Fainter stars are
//! farther away, hence the slope.
//!
//! **The tails are heavy.** The rms is about four times σ, and one star in a hundred moves more than 300 mas/yr. A calibration
//! should leave such stars out or weight them robustly; for identification the error is still far below a pixel.

use super::{Catalog, Star};
use crate::units::MAS_RAD;

/// Standard error per axis of a position at the catalogue's epoch: 1 mas (the two reductions of Hipparcos agree to 0.7 mas).
pub const POSITION_SIGMA_RAD: f64 = MAS_RAD;
/// Standard error per axis of a known proper motion: 1 mas/yr. The formal errors are near 0.5; what is added is the orbital
/// motion of unseen companions, which three years of measurement take for proper motion.
pub const KNOWN_PROPER_MOTION_SIGMA_RAD_YR: f64 = MAS_RAD;
/// σ of an unknown proper motion at V = 6.5, per axis.
const UNKNOWN_SIGMA_AT_6_5_MAS_YR: f64 = 29.2;
/// Its logarithmic slope per magnitude.
const UNKNOWN_SIGMA_SLOPE: f64 = 0.27;

/// What is to be expected of a proper motion that is not known: σ per axis, rad per year, at a V magnitude.
///
/// Outside 0 ≤ V ≤ 12 the value at the nearer end is given.
#[must_use]
pub fn expected_proper_motion_sigma_rad_yr(magnitude: f64) -> f64 {
    UNKNOWN_SIGMA_AT_6_5_MAS_YR * (-UNKNOWN_SIGMA_SLOPE * (magnitude.clamp(0.0, 12.0) - 6.5)).exp() * MAS_RAD
}

impl Catalog {
    /// Standard error per axis of a star's position `years_since_epoch` Julian years from [`Catalog::epoch_yr`], in rad.
    ///
    /// The position is the one carried along with the proper motion where that is known, and the one at the epoch where it is
    /// not. Stars whose two published solutions disagree carry the disagreement, as error of the position and per year.
    #[must_use]
    pub fn position_sigma_rad(&self, star: &Star, years_since_epoch: f64) -> f64 {
        let mut motion_sigma_rad_yr = match star.proper_motion_rad_yr {
            Some(_) => KNOWN_PROPER_MOTION_SIGMA_RAD_YR,
            None => expected_proper_motion_sigma_rad_yr(star.magnitude),
        };
        let mut position_sigma_rad = POSITION_SIGMA_RAD;
        if let Ok(place) = self.doubtful.binary_search_by_key(&star.hip, |&(number, _)| number) {
            let doubt_rad = self.doubtful[place].1;
            position_sigma_rad = position_sigma_rad.hypot(doubt_rad);
            motion_sigma_rad_yr = motion_sigma_rad_yr.hypot(doubt_rad);
        }
        position_sigma_rad.hypot(motion_sigma_rad_yr * years_since_epoch)
    }
}

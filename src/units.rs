//! Units and physical constants.
//!
//! Inside the program angles are radians, lengths on the detector pixels, light electrons or counts (DN), times seconds
//! and velocities km/s; the unit stands in the name (`_rad`, `_px`, `_e`, `_dn`, `_km_s`). Conversions happen at the edges,
//! with the factors below.

/// One degree in radians.
pub const DEG_RAD: f64 = std::f64::consts::PI / 180.0;
/// One arcsecond in radians.
pub const ARCSEC_RAD: f64 = DEG_RAD / 3600.0;
/// One milliarcsecond in radians.
pub const MAS_RAD: f64 = ARCSEC_RAD / 1000.0;
/// The speed of light in vacuum, km/s (exact, SI).
pub const SPEED_OF_LIGHT_KM_S: f64 = 299_792.458;
/// The astronomical unit in km (exact, IAU 2012 Resolution B2).
pub const AU_KM: f64 = 149_597_870.7;
/// A Julian year in days (exact).
pub const JULIAN_YEAR_DAYS: f64 = 365.25;
/// A day in seconds.
pub const DAY_S: f64 = 86_400.0;
/// The Julian date of J2000.0 (TT).
pub const J2000_JD: f64 = 2_451_545.0;

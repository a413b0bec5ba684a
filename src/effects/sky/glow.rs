//! Light of the sky between the stars: what shines, in which direction and how brightly.
//!
//! Each source is one file here and one line in [`SKY_GLOWS`]: a function from a direction and the circumstances to a surface brightness, in plain
//! f64. Their sum over the frame is worked out once for an exposure and put into the pixels before any star's light (the module `scene`).
//!
//! **Unit.** A surface brightness is given in stars of V = 0 per square arcsecond, 10^(−0.4·μ) for μ in magnitudes per square arcsecond: times the
//! electrons per second of a star of V = 0 and the pixel's solid angle it is a rate of electrons. The light that comes from beyond the air is weakened
//! on its way through it; the zero point counts light as it reaches the camera.

use super::{airglow, moonlight, starlight, twilight, zodiacal_light};
use crate::dual::dot;
use crate::effects::ParameterSpec;

/// Brightness of a nanolambert: B = 34.08·exp(20.7233 − 0.92104·μ) nL, μ in V magnitudes per square arcsecond (Garstang, PASP 98, 364, 1986, equation 19).
pub const NANOLAMBERT: f64 = 1e-9 / 34.08;
/// Brightness of one star of the tenth magnitude per square degree.
pub const S10: f64 = 1e-4 / (3600.0 * 3600.0);

/// Circumstances that a source needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Needs {
    /// None.
    Nothing,
    /// The time.
    Time,
    /// Time and place on the ground.
    Site,
}

/// The Moon as the camera has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moon {
    /// Unit vector, ICRS axes.
    pub direction: [f64; 3],
    /// Angle between Sun and camera, seen from the Moon, rad; 0 when it is full.
    pub phase_angle_rad: f64,
}

/// The circumstances of an exposure, as far as they are known. Directions are unit vectors in ICRS axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Circumstances {
    /// To the Sun.
    pub sun: Option<[f64; 3]>,
    /// The Moon, seen from the ground.
    pub moon: Option<Moon>,
    /// To the zenith, of a camera under the air.
    pub zenith: Option<[f64; 3]>,
    /// Extinction in the V band, magnitudes per air mass.
    pub extinction_mag_per_airmass: f64,
    /// The faintest V magnitude of the stars that are rendered one by one.
    pub faintest_magnitude: f64,
}

impl Circumstances {
    /// Cosine of the zenith distance, not below 0; `None` in space.
    #[must_use]
    pub fn cos_zenith_distance(&self, direction: [f64; 3]) -> Option<f64> {
        self.zenith.map(|zenith| dot(direction, zenith).clamp(0.0, 1.0))
    }

    /// Whether the ground is in the way.
    #[must_use]
    pub fn is_below_horizon(&self, direction: [f64; 3]) -> bool {
        self.zenith.is_some_and(|zenith| dot(direction, zenith) < 0.0)
    }

    /// The share of a light from beyond the air that comes through it; 1 in space. Air mass after Rozenberg (Twilight, 1966), 40 at the horizon.
    #[must_use]
    pub fn transmission(&self, direction: [f64; 3]) -> f64 {
        self.cos_zenith_distance(direction).map_or(1.0, |cosine| {
            let air_mass = 1.0 / (cosine + 0.025 * (-11.0 * cosine).exp());
            10.0_f64.powf(-0.4 * self.extinction_mag_per_airmass * air_mass)
        })
    }
}

/// A source of light between the stars.
pub trait SkyGlow: Sync {
    /// Its id.
    fn id(&self) -> &'static str;
    /// Its parameters; one that is not given has its typical value.
    fn parameters(&self) -> &'static [ParameterSpec];
    /// What must be known.
    fn needs(&self) -> Needs;
    /// Surface brightness in a direction above the horizon, stars of V = 0 per square arcsecond; 0 where what it needs is not known.
    fn brightness(&self, parameters: &[f64], direction: [f64; 3], circumstances: &Circumstances) -> f64;
    /// The text of its source file, whose head is its page.
    fn source(&self) -> &'static str;
}

/// Every source.
pub static SKY_GLOWS: &[&dyn SkyGlow] =
    &[&zodiacal_light::ZodiacalLight, &starlight::Starlight, &airglow::Airglow, &moonlight::Moonlight, &twilight::Twilight];

/// The source with this id.
#[must_use]
pub fn sky_glow(id: &str) -> Option<&'static dyn SkyGlow> {
    SKY_GLOWS.iter().copied().find(|glow| glow.id() == id)
}

/// The factor that most sources have.
pub(super) const RELATIVE: ParameterSpec = ParameterSpec { name: "relative", unit: "", typical: 1.0, range: (0.0, 1000.0) };

/// The way through the air that scattered light takes at a zenith distance, relative to that at the zenith: X = (1 − 0.96·sin²Z)^(−1/2) (Krisciunas and
/// Schaefer 1991, equation 3).
pub(super) fn scattering_air_mass(cos_zenith_distance: f64) -> f64 {
    1.0 / (1.0 - 0.96 * (1.0 - cos_zenith_distance * cos_zenith_distance)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_those_of_the_literature() {
        // 1 S10 is 27.78 mag/arcsec²; the dark zenith of 79.0 nL is 21.587 mag/arcsec² (Krisciunas and Schaefer 1991, section 3).
        assert!((-2.5 * S10.log10() - 27.78).abs() < 0.005);
        assert!((-2.5 * (79.0 * NANOLAMBERT).log10() - 21.587).abs() < 0.001);
    }

    #[test]
    fn air_weakens_what_comes_through_it() {
        let circumstances = Circumstances { zenith: Some([0.0, 0.0, 1.0]), extinction_mag_per_airmass: 0.2, ..Circumstances::default() };
        assert!((circumstances.transmission([0.0, 0.0, 1.0]) - 10.0_f64.powf(-0.08)).abs() < 1e-6);
        assert!((circumstances.transmission([1.0, 0.0, 0.0]) - 10.0_f64.powf(-3.2)).abs() < 1e-9);
        assert_eq!(Circumstances::default().transmission([1.0, 0.0, 0.0]), 1.0);
    }
}

//! Frame → Detections: finds stars and measures them.
//!
//! 1. `background`, `black`: level and noise on a mesh, offsets of rows; never zero noise, since counts come in steps.
//! 2. `defects`, `image_circle`: saturated and hot pixels, and what lies around the picture, are set aside.
//! 3. `filter`: matched filter; its threshold follows from the number of false stars allowed, and from the noise's own tail (`noise_tail`).
//! 4. `shape`, `search`: the frame's own stars determine width and elongation, and the filter is run again with it; `psf_class`: their χ² decides
//!    between round, elliptic and trailed (`trail`), and `field` is how these change over the frame.
//! 5. `fit`: maximum likelihood for position, flux, background and width; neighbours are subtracted from each other.
//! 6. `deblend`: blends are found by comparison with the stars near by (`reference_stars`) and by the light beside a star (`companion`); stars in each
//!    other's light are fitted together (`blend_fit`), all of a frame until they converge (`simultaneous_fit`).
//! 7. `moments`: second and third moments of every star's image.
//! 8. `epsf_build`, `epsf_step`, `epsf`: the ePSF from the recording's own stars, used instead of the Gaussian where held-out stars prefer it;
//!    `epsf_sky` learns it at the places that the sky says, and `phase_bias` predicts from it how far an estimator's places follow the pixel phase.
//!
//! `windowed` is the quick way: a gate and moments; `window_gain` estimates its photon noise.

mod background;
mod black;
mod blend_fit;
mod candidates;
mod companion;
mod deblend;
mod defects;
mod epsf;
mod epsf_build;
mod epsf_sky;
mod epsf_step;
mod field;
mod field_fit;
mod filter;
mod filter_run;
mod fit;
mod forced_fit;
mod gain;
mod gaussian;
mod image_circle;
mod image_model;
mod image_noise;
mod learnt_image;
mod measure;
mod moments;
mod noise_tail;
mod phase_bias;
mod psf;
mod psf_class;
mod reference_stars;
mod result;
mod search;
mod shape;
mod simultaneous_fit;
mod stamp;
mod star_noise;
mod trail;
mod window;
mod window_gain;
mod windowed;
mod work;

pub use epsf::{EmpiricalPsf, PsfReport};
pub use measure::detect;
pub use moments::Moments;
inner!(result::{DetectResult, DetectedFrame, FORMAT});
inner!(epsf_build::{PsfStar, learn});
inner!(epsf_sky::{SkyImage, PredictedStar, learn_from_sky});
inner!(forced_fit::{FixedBackground, ForcedFit, fit_forced});
inner!(learnt_image::LearntImage);
inner!(measure::{Aids, detect_aided});
inner!(phase_bias::{BiasedStar, Estimator, PhaseBias, PixelNoise});
inner!(star_noise::{StarNoise, star_noise});
inner!(windowed::detect_windowed);

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How to look for stars. The default suits any camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DetectOptions {
    /// Expected number of false stars that noise makes in one frame.
    pub false_alarms_per_frame: f64,
    /// Width (Gaussian σ before the pixel integrates it) of the star images where it is known; else the frame's stars tell it.
    pub psf_sigma_px: Option<f64>,
    /// Electrons per count where known; else estimated from the scatter of bright stars.
    pub gain_e_per_dn: Option<f64>,
    /// Read noise where known: a lower limit of the noise that the frame itself shows. Needs the gain.
    pub read_noise_e: Option<f64>,
    /// At most so many stars are returned, the brightest.
    pub max_stars: usize,
    /// The signal-to-noise ratio from which on a maximum counts, where it is not to follow from the number of false stars.
    pub detection_threshold: Option<f64>,
}

impl Default for DetectOptions {
    fn default() -> Self {
        Self {
            false_alarms_per_frame: 1.0,
            psf_sigma_px: None,
            gain_e_per_dn: None,
            read_noise_e: None,
            max_stars: 5000,
            detection_threshold: None,
        }
    }
}

/// Why a frame or an option cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DetectError {
    /// Too few pixels.
    #[error("the frame is {width_px} × {height_px} pixels; finding stars needs at least {least_px} pixels on each side")]
    TooSmall {
        /// Columns.
        width_px: usize,
        /// Rows.
        height_px: usize,
        /// Least number on each side.
        least_px: usize,
    },
    /// The number of pixels does not fit the size.
    #[error("the frame says {width_px} × {height_px} pixels but holds {found} counts; its file was read wrongly or cut short")]
    SizeMismatch {
        /// Columns.
        width_px: usize,
        /// Rows.
        height_px: usize,
        /// Counts held.
        found: usize,
    },
    /// A count is no number.
    #[error("the count at column {x}, row {y} is {value}; replace such pixels by a number before finding stars")]
    NotFinite {
        /// Column.
        x: usize,
        /// Row.
        y: usize,
        /// The count.
        value: f32,
    },
    /// A map of bad pixels of another size.
    #[error("the map of bad pixels holds {mask} pixels, the frame {frame}; a map must be of the frame's size")]
    MaskSize {
        /// Pixels of the map.
        mask: usize,
        /// Pixels of the frame.
        frame: usize,
    },
    /// An option is out of range.
    #[error("the option {name} is {value}; it must be {range}")]
    Option {
        /// Its name.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        range: &'static str,
    },
}

/// What is special about a detection.
#[allow(clippy::struct_excessive_bools, reason = "each stands for itself")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Flags {
    /// At least one pixel of the stamp is at or above saturation.
    pub saturated: bool,
    /// Another star's light is in the stamp: another detection's, or that of one too near to be told apart, of which only the image's shape
    /// speaks. Place, flux and width are then of both, and the covariance has in it how far the place may lie from either.
    pub blended: bool,
    /// The stamp is cut by the edge of the frame.
    pub edge: bool,
    /// The image's shape speaks of another star that is too near to be told apart.
    #[serde(skip)]
    pub is_unresolved: bool,
}

/// A star image as measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Detection {
    /// Column of the centre.
    pub x_px: f64,
    /// Row of the centre.
    pub y_px: f64,
    /// Covariance of the centre: xx, xy, yy.
    pub covariance_px2: [f64; 3],
    /// Flux above the background, DN.
    pub flux_dn: f64,
    /// Its standard error.
    pub flux_sigma_dn: f64,
    /// Local background under the star, DN per pixel.
    pub background_dn: f64,
    /// Gradient of the local background in x and y, DN per pixel per pixel.
    pub background_gradient_dn: [f64; 2],
    /// Width (Gaussian σ) of the star's image.
    pub width_px: f64,
    /// Moments of the image of second and third order; nothing where the pixels do not tell them, and of stars that come as a list (of which there may be
    /// millions: so they lie apart).
    pub moments: Option<Box<Moments>>,
    /// χ² of the stamp over its degrees of freedom.
    pub chi2_per_dof: f64,
    /// Highest count in the stamp, DN.
    pub peak_dn: f64,
    /// Flags.
    pub flags: Flags,
}

impl Detection {
    /// The same where its image is so much wider than a star's: what another star in it may have moved its place by.
    fn wider_by(self, px2: [f64; 3]) -> Self {
        Self { covariance_px2: std::array::from_fn(|k| self.covariance_px2[k] + px2[k]), ..self }
    }

    /// Flux over its standard error.
    #[must_use]
    pub fn snr(&self) -> f64 {
        self.flux_dn / self.flux_sigma_dn
    }
}

/// All star images of one frame, brightest first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Detections {
    /// Columns of the frame.
    pub width_px: usize,
    /// Rows of the frame.
    pub height_px: usize,
    /// Median background, DN.
    pub background_dn: f64,
    /// Noise of one background pixel (standard deviation), DN.
    pub noise_dn: f64,
    /// The star images.
    pub stars: Vec<Detection>,
}

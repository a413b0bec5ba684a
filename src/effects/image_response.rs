//! What an effect does to the brightness and shape of a star's image, per unit of its parameters: its columns in the channels beside places.

use super::Rendering;

/// What is known of a star image that its brightness and shape may depend on. What is `None` is not known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImageContext {
    /// Place from the middle of the frame, in half-diagonals.
    pub at: [f64; 2],
    /// Place of the centre within its pixel, from the pixel's middle, px.
    pub phase_px: [f64; 2],
    /// B − V less that of the reference.
    pub colour_offset: Option<f64>,
    /// Peak of the star above its background, as a share of a full pixel.
    pub fullness: Option<f64>,
    /// Background, as a share of a full pixel.
    pub background_fullness: f64,
    /// Electrons of the star, or counts where no gain is known, over those of the reference.
    pub relative_flux: Option<f64>,
    /// Rows (0 to 1) that the charge moves before it is read.
    pub rows_moved: f64,
    /// Air mass.
    pub airmass: Option<f64>,
    /// Temperature less the mean of the frames, K.
    pub temperature_offset_k: Option<f64>,
    /// Time from the mean of the frames, hours.
    pub time_offset_h: Option<f64>,
    /// How far and whither the star moves over the detector during the exposure by the declared rates, px.
    pub trail_px: Option<[f64; 2]>,
    /// Typical width of the images (Gaussian σ), px.
    pub sigma_px: f64,
}

/// By how much a unit of a parameter changes what is measured of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImageResponse {
    /// Magnitude; fainter is positive.
    pub magnitude: f64,
    /// Second moments xx, xy, yy, px².
    pub second_px2: [f64; 3],
    /// Skewness along x and y.
    pub skewness: [f64; 2],
}

/// Magnitudes of a small relative change of the light: 2.5/ln 10.
pub const MAGNITUDES: f64 = 1.085_736_204_758_129_6;

impl ImageResponse {
    /// A relative loss of light.
    #[must_use]
    pub fn loss(share: f64) -> Self {
        Self { magnitude: MAGNITUDES * share, ..Self::default() }
    }

    /// A change of σ, the same along all axes.
    #[must_use]
    pub fn width(sigma_px: f64, change_px: f64) -> Self {
        let square = 2.0 * sigma_px * change_px;
        Self { second_px2: [square, 0.0, square], ..Self::default() }
    }

    /// So many times as much.
    #[must_use]
    pub fn times(self, factor: f64) -> Self {
        Self {
            magnitude: self.magnitude * factor,
            second_px2: self.second_px2.map(|square| square * factor),
            skewness: self.skewness.map(|skewness| skewness * factor),
        }
    }

    /// Both.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self {
            magnitude: self.magnitude + other.magnitude,
            second_px2: std::array::from_fn(|k| self.second_px2[k] + other.second_px2[k]),
            skewness: std::array::from_fn(|k| self.skewness[k] + other.skewness[k]),
        }
    }
}

/// An effect with columns in brightness or shape.
pub trait ImageEffect: Sync {
    /// Its id.
    fn id(&self) -> &'static str;
    /// Its parameters: name and unit, as in `spec` of the result files.
    fn parameters(&self) -> &'static [(&'static str, &'static str)];
    /// The covariate that it follows.
    fn follows(&self) -> &'static str;
    /// Of effects that leave the same trace the one of the least rank gives the name.
    fn name_rank(&self) -> u8 {
        1
    }
    /// The sign of its first parameter, where nature leaves no choice.
    fn sign(&self) -> Option<f64> {
        None
    }
    /// Whether its parameters are squares, so that their roots are told.
    fn are_squares(&self) -> bool {
        false
    }
    /// Subsets of its parameters that are a cause of their own: they are asked beside all, and told where they say as much.
    fn parts(&self) -> &'static [&'static [usize]] {
        &[]
    }
    /// The covariate that a part follows.
    fn part_follows(&self, _part: &[usize]) -> &'static str {
        self.follows()
    }
    /// The effects of which its columns are products, where they are: what one of them explains is asked beside the others.
    fn products_of(&self) -> &'static [&'static str] {
        &[]
    }
    /// What it needs, in words, for where it is not known.
    fn needs(&self) -> &'static str;
    /// The size of its first parameter that real cameras and skies have, and where that is from.
    fn ordinary(&self) -> (f64, &'static str);
    /// What is rendered a little less and a little more of for the column of its first parameter, of which the formula then gives the unit alone;
    /// nothing where the formula says as much.
    fn rendering(&self) -> Option<Rendering> {
        None
    }
    /// The responses to its parameters; nothing where what it depends on is not known.
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>>;
}

/// The effects of the registry that have such columns.
pub static IMAGE_EFFECTS: &[&dyn ImageEffect] = &[
    &super::optics::vignetting::Vignetting,
    &super::detector::nonlinearity::Nonlinearity,
    &super::detector::brighter_fatter::BrighterFatter,
    &super::detector::charge_transfer_inefficiency::ChargeTransferInefficiency,
    &super::detector::amplifier_step::AmplifierStep,
    &super::optics::coma::Coma,
    &super::optics::coma::ComaOfRays,
];

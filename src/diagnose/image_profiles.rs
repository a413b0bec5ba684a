//! What brightness and shape of the star images follow, as the pictures of these channels show it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::channels::Channel;
use super::profile_bin::ProfileBin;

/// A quantity of the star images in bins of a covariate, its nuisance parameters taken off.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct ImageProfile {
    /// The channel that the quantity belongs to.
    pub channel: Channel,
    /// The quantity, in words.
    pub quantity: String,
    /// Its unit.
    pub unit: String,
    /// The covariate.
    pub covariate: String,
    /// The bins: what is seen there, and as the model what the findings make of it; both in the unit.
    pub bins: Vec<ProfileBin>,
}

/// Mean shape of the star images in a part of the frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct ShapeCell {
    /// Its middle, from the middle of the frame, over half the frame's diagonal.
    pub at: [f64; 2],
    /// Width (Gaussian σ) of the images, px.
    pub width_px: f64,
    /// Its standard error.
    pub width_sigma_px: f64,
    /// Ellipticity by the second moments: (xx − yy)/(xx + yy) and 2·xy/(xx + yy).
    pub ellipticity: [f64; 2],
    /// Its standard error along each.
    pub ellipticity_sigma: f64,
    /// Star images.
    pub stars: usize,
}

impl ImageProfile {
    pub(super) fn new(channel: Channel, quantity: &str, unit: &str, covariate: &str, bins: Vec<ProfileBin>) -> Self {
        let [quantity, unit, covariate] = [quantity, unit, covariate].map(str::to_owned);
        Self { channel, quantity, unit, covariate, bins }
    }
}

/// Width and ellipticity of one star image.
#[derive(Clone, Copy, Debug)]
pub(super) struct ImageShape {
    pub(super) width_px: f64,
    pub(super) ellipticity: [f64; 2],
}

impl ShapeCell {
    /// Of star images. Medians, so that a blend decides nothing.
    pub(super) fn of(at: [f64; 2], images: &[ImageShape]) -> Option<Self> {
        use crate::statistics::{mad_sigma, median};
        /// Fewer tell no scatter.
        const MIN_STARS: usize = 4;
        /// Standard error of a median over that of a mean.
        const OF_MEDIAN: f64 = 1.2533;
        if images.len() < MIN_STARS {
            return None;
        }
        let told = |of: fn(&ImageShape) -> f64| -> Option<[f64; 2]> {
            let values: Vec<f64> = images.iter().map(of).collect();
            Some([median(&values)?, OF_MEDIAN * mad_sigma(&values)? / (values.len() as f64).sqrt()])
        };
        let [width, one, other] = [told(|own| own.width_px)?, told(|own| own.ellipticity[0])?, told(|own| own.ellipticity[1])?];
        Some(Self {
            at,
            width_px: width[0],
            width_sigma_px: width[1],
            ellipticity: [one[0], other[0]],
            ellipticity_sigma: (0.5 * (one[1] * one[1] + other[1] * other[1])).sqrt(),
            stars: images.len(),
        })
    }
}

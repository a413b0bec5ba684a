//! Starlight behind the filters of a mosaic ([`FilterLight`]). Where there are no filters nothing of this happens.

use std::borrow::Cow;

use super::light::{FrameLight, Spreader};
use crate::effects::detector::colour_filters::filter_at;
use crate::imaging::{FilterLight, ImagingError, PlacedStar, PlaneLight, Stamp};

/// Light as it goes to the pixels.
pub(super) struct OnPixels<'a> {
    /// Stars to be spread.
    pub(super) stars: &'a [PlacedStar],
    /// Other light to be spread.
    pub(super) planes: Vec<PlaneLight<'a>>,
    /// Light that is spread already, row by row; empty: none.
    pub(super) spread_e: Cow<'a, [f32]>,
}

/// The light of a frame on the light of its sky. `behind`: spreads light that comes through red, green and blue filters, upon that sky.
pub(super) fn on_pixels<'a>(
    frame: &'a FrameLight,
    spreader: &'a Spreader,
    sky_e: &'a [f32],
    behind: impl Fn(&[FilterLight<'_>; 3]) -> Result<Vec<f32>, ImagingError>,
) -> Result<OnPixels<'a>, ImagingError> {
    let Some(filtered) = frame.filtered() else {
        return Ok(OnPixels { stars: &frame.stars, planes: spreader.planes(frame), spread_e: Cow::Borrowed(sky_e) });
    };
    let lights = filtered.each_ref().map(|light| FilterLight { stars: &light.stars, planes: spreader.planes(light) });
    Ok(OnPixels { stars: &[], planes: Vec::new(), spread_e: Cow::Owned(behind(&lights)?) })
}

/// What filters of these transmissions leave of a source's light.
pub(super) fn filter(stamp: &mut Stamp, through: [f64; 3]) {
    let (left, top, width) = (stamp.left_px, stamp.top_px, stamp.width_px);
    for (place, electrons) in stamp.electrons.iter_mut().enumerate() {
        *electrons *= through[filter_at(left + place % width, top + place / width)] as f32;
    }
}

//! Starlight behind the filters of a mosaic: the light that each filter lets through is collected as a frame of its own, and a pixel takes that of its
//! filter. Where there are no filters nothing of this happens.

use std::borrow::Cow;

use rayon::prelude::*;

use super::light::{FrameLight, Spreader};
use crate::effects::detector::colour_filters::filter_at;
use crate::imaging::{ImagingError, PlaneLight, Stamp, StarImage};

/// Light as it goes to the pixels.
pub(super) struct OnPixels<'a> {
    /// Stars to be spread.
    pub(super) stars: &'a [StarImage],
    /// Other light to be spread.
    pub(super) planes: Vec<PlaneLight<'a>>,
    /// Light that is spread already, row by row; empty: none.
    pub(super) spread_e: Cow<'a, [f32]>,
}

/// The light of a frame of `width_px` columns on the light of its sky. `alone`: spreads light, before any effect.
pub(super) fn on_pixels<'a>(
    frame: &'a FrameLight,
    spreader: &'a Spreader,
    width_px: usize,
    sky_e: &'a [f32],
    alone: impl Fn(&[StarImage], &[PlaneLight<'_>]) -> Result<Vec<f32>, ImagingError>,
) -> Result<OnPixels<'a>, ImagingError> {
    let Some(filtered) = frame.filtered() else {
        return Ok(OnPixels { stars: &frame.stars, planes: spreader.planes(frame), spread_e: Cow::Borrowed(sky_e) });
    };
    let mut mosaic: Vec<f32> = Vec::new();
    for (filter, light) in filtered.iter().enumerate() {
        let through = alone(&light.stars, &spreader.planes(light))?;
        mosaic.resize(through.len(), 0.0);
        mosaic.par_chunks_mut(width_px).zip(through.par_chunks(width_px)).enumerate().for_each(|(y, (row, through))| {
            for (x, (pixel, through)) in row.iter_mut().zip(through).enumerate() {
                if filter_at(x, y) == filter {
                    *pixel = *through;
                }
            }
        });
    }
    for (pixel, sky) in mosaic.iter_mut().zip(sky_e) {
        *pixel += sky;
    }
    Ok(OnPixels { stars: &[], planes: Vec::new(), spread_e: Cow::Owned(mosaic) })
}

/// What filters of these transmissions leave of a source's light.
pub(super) fn filter(stamp: &mut Stamp, through: [f64; 3]) {
    let (left, top, width) = (stamp.left_px, stamp.top_px, stamp.width_px);
    for (place, electrons) in stamp.electrons.iter_mut().enumerate() {
        *electrons *= through[filter_at(left + place % width, top + place / width)] as f32;
    }
}

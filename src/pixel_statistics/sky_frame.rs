//! A frame with its stars, and which of its pixels are sky.

use crate::frame::Frame;

/// A disc that holds a star's light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StarDisc {
    /// Column of the middle.
    pub x_px: f64,
    /// Row of the middle.
    pub y_px: f64,
    /// Light reaches so far.
    pub radius_px: f64,
}

impl StarDisc {
    /// Square of the distance from its middle to a place, px²: over many pixels roots are dear.
    pub(super) const fn distance_px2(&self, [x, y]: [f64; 2]) -> f64 {
        let (dx, dy) = (x - self.x_px, y - self.y_px);
        dx * dx + dy * dy
    }

    /// Whether its light reaches a place.
    pub(super) const fn lights(&self, at: [f64; 2]) -> bool {
        self.distance_px2(at) < self.radius_px * self.radius_px
    }
}

/// A frame and what is known of it.
#[derive(Clone, Copy, Debug)]
pub struct SkyFrame<'a> {
    /// Number in the recording.
    pub number: usize,
    /// The lowest count as read, DN, before a dark was taken off.
    pub lowest_read_dn: f32,
    /// The pixels.
    pub frame: &'a Frame,
    /// Its stars, the brightest first.
    pub stars: &'a [StarDisc],
    /// Pixels that say nothing, row by row.
    pub bad: Option<&'a [bool]>,
    /// Exposure, where known.
    pub exposure_s: Option<f64>,
    /// Whether it is one of those that are compared pixel by pixel.
    pub is_compared: bool,
}

/// Which pixels are sky: lit by no star, neither full nor at zero light, nor bad.
pub(super) fn sky_mask(sky_frame: &SkyFrame<'_>) -> Vec<bool> {
    let frame = sky_frame.frame;
    let full = frame.saturation_dn;
    let mut is_sky: Vec<bool> = match sky_frame.bad {
        Some(bad) => frame.pixels_dn.iter().zip(bad).map(|(value, bad)| *value < full && !bad).collect(),
        None => frame.pixels_dn.iter().map(|value| *value < full).collect(),
    };
    for star in sky_frame.stars {
        let rows = covered(star.y_px, star.radius_px, frame.height_px);
        for y in rows {
            let half = (star.radius_px.powi(2) - (y as f64 - star.y_px).powi(2)).max(0.0).sqrt();
            let columns = covered(star.x_px, half, frame.width_px);
            is_sky[y * frame.width_px..][columns].fill(false);
        }
    }
    is_sky
}

/// The pixels of a line that lie within `reach` of a place.
pub(super) fn covered(at: f64, reach: f64, length: usize) -> std::ops::Range<usize> {
    let from = (at - reach).ceil().max(0.0) as usize;
    let to = ((at + reach).floor() + 1.0).max(0.0) as usize;
    from.min(length)..to.min(length).max(from.min(length))
}

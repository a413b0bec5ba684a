//! From a star's way over the frame to points of light.

use crate::effects::optics::gaussian_psf::GaussianPsf;
use crate::effects::pixel::{Atlas, PointSpread};
use crate::imaging::{Deposit, Imager, ImagingError, PlaneLight, Stamp, StarImage};
use crate::scene::{Sample, StarTrack};

/// The light of one star: what the fast, separable spread takes, and what has to be spread point by point.
#[derive(Clone, Debug, Default)]
pub(super) struct StarLight {
    pub(super) stars: Vec<StarImage>,
    pub(super) deposits: Vec<Deposit>,
}

/// All the light of an exposure.
#[derive(Debug, Default)]
pub(super) struct FrameLight {
    pub(super) stars: Vec<StarImage>,
    deposits: Vec<Deposit>,
    atlas: Atlas,
}

impl FromIterator<StarLight> for FrameLight {
    fn from_iter<I: IntoIterator<Item = StarLight>>(lights: I) -> Self {
        let mut frame = Self::default();
        for light in lights {
            frame.stars.extend(light.stars);
            frame.deposits.extend(light.deposits);
        }
        frame
    }
}

impl FrameLight {
    /// What goes to the pixels besides the separable stars.
    pub(super) fn planes(&self) -> Vec<PlaneLight<'_>> {
        let batch = PlaneLight { spread: &GaussianPsf, atlas: &self.atlas, deposits: &self.deposits };
        [batch].into_iter().filter(|batch| !batch.deposits.is_empty()).collect()
    }
}

impl StarLight {
    /// A star as a round Gaussian of this width.
    ///
    /// Motion that is faster than the exposure widens it: by the smaller of the two variances in all directions, and by the rest along the
    /// axis of the larger, point by point.
    pub(super) fn gaussian(track: &StarTrack, sigma_px: f64) -> Self {
        let [xx, xy, yy] = track.blur_px2;
        let (middle, half) = (0.5 * (xx + yy), (0.5 * (xx - yy)).hypot(xy));
        let (least, rest) = ((middle - half).max(0.0), 2.0 * half);
        let sigma_px = (sigma_px * sigma_px + least).sqrt();
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        let spread = rest.sqrt();
        let offsets = if spread > 1e-3 * sigma_px { normal_nodes(spread, sigma_px) } else { vec![[0.0, 1.0]] };
        let mut light = Self::default();
        for sample in &track.samples {
            for [node, weight] in &offsets {
                light.put(track, sample, sigma_px, [node * angle.cos(), node * angle.sin()], *weight);
            }
        }
        light
    }

    fn put(&mut self, track: &StarTrack, sample: &Sample, sigma_px: f64, offset_px: [f64; 2], share: f64) {
        let image = StarImage {
            x_px: sample.place.x_px + offset_px[0],
            y_px: sample.place.y_px + offset_px[1],
            electrons: track.electrons * sample.weight * share,
            sigma_px,
        };
        if sample.shear == [0.0; 2] {
            self.stars.push(image);
        } else {
            let reach = GaussianPsf.reach(track.electrons, sigma_px) as u16;
            self.deposits.push(Deposit { shear: sample.shear, ..Deposit::round(&image, reach) });
        }
    }

    /// Its light on the pixels, and no other.
    pub(super) fn stamp(&self, imager: &Imager) -> Result<Option<Stamp>, ImagingError> {
        let atlas = Atlas::default();
        let batch = PlaneLight { spread: &GaussianPsf, atlas: &atlas, deposits: &self.deposits };
        imager.stamp(&self.stars, &[batch])
    }
}

/// Nodes and weights of a normal distribution of width `spread_px` for functions as smooth as a Gaussian of width `sigma_px`: the trapezoidal
/// rule, whose error falls as exp(−2π²w²/h²) with the step h and the width w of the product of the two.
fn normal_nodes(spread_px: f64, sigma_px: f64) -> Vec<[f64; 2]> {
    const REACH: f64 = 5.3;
    let step = 1.1 * spread_px * sigma_px / spread_px.hypot(sigma_px);
    let half = (REACH * spread_px / step).ceil() as i32;
    let nodes = (-half..=half).map(|index| f64::from(index) * step);
    let nodes: Vec<[f64; 2]> = nodes.map(|node| [node, (-0.5 * (node / spread_px).powi(2)).exp()]).collect();
    let sum: f64 = nodes.iter().map(|[_, weight]| weight).sum();
    nodes.into_iter().map(|[node, weight]| [node, weight / sum]).collect()
}

//! Places of stars whose images have wings or are lopsided: where the light is, measured by the image that each star should have.
//!
//! Of such images a sum over a window leaves out light on one side, and its centre is not that of all the light, which the labels tell. So the star is
//! rendered by itself without noise. What the frame shows beyond the light of everything else is fitted with that image, its changes when the star moves to the
//! right and down, and an even rest (least squares, each pixel by its expected variance). The place of the star is then the centre of all light of the
//! image, summed over its pixels, and what the fit moves it by. Neither of them knows where the renderer meant the star to be.

use nalgebra::{Matrix4, Vector4};

use crate::render::{StarAlone, StarsAlone};

/// Pixels with more than this share of the brightest one's light are the core of an image.
const CORE: f64 = 0.05;
/// Pixels about the core that take part in the fit.
const MARGIN_PX: usize = 2;

/// First and last column and row of the pixels that hold the core of a star's light.
pub(super) fn core_px(star: &StarAlone) -> [[usize; 2]; 2] {
    let least = CORE * star.electrons.iter().copied().fold(0.0, f64::max);
    let mut ends = [[usize::MAX, 0]; 2];
    for (place, _) in star.electrons.iter().enumerate().filter(|(_, electrons)| **electrons > least) {
        for (end, at) in ends.iter_mut().zip(at_px(star, place)) {
            *end = [end[0].min(at), end[1].max(at)];
        }
    }
    ends
}

/// Column and row of one of a star's pixels.
fn at_px(star: &StarAlone, place: usize) -> [usize; 2] {
    [star.left_px + place % star.width_px, star.top_px + place / star.width_px]
}

/// Where the light of a star is; `electrons` of the frame from its counts, `width_px` columns of it. `None` where it cannot be told.
pub(super) fn place_px(star: &StarAlone, frame: &StarsAlone, electrons: &dyn Fn(usize) -> f64, width_px: usize) -> Option<[f64; 2]> {
    let core = core_px(star);
    let is_near = |at: [usize; 2]| (0..2).all(|axis| at[axis] + MARGIN_PX >= core[axis][0] && at[axis] <= core[axis][1] + MARGIN_PX);
    let (mut normal, mut right_hand) = (Matrix4::zeros(), Vector4::zeros());
    for (place, own) in star.electrons.iter().enumerate() {
        let at = at_px(star, place);
        if !is_near(at) {
            continue;
        }
        let pixel = at[1] * width_px + at[0];
        let expected = f64::from(*frame.expected_e.get(pixel)?);
        let weight = 1.0 / (expected.max(0.0) + frame.read_noise_e.powi(2)).max(1.0);
        let row = Vector4::new(star.slopes[0][place], star.slopes[1][place], *own, 1.0);
        normal += weight * row * row.transpose();
        right_hand += weight * row * (electrons(pixel) - expected);
    }
    let step = normal.try_inverse()? * right_hand;
    Some([0, 1].map(|axis| star.centre_px[axis] + step[axis]))
}

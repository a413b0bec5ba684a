//! Images are drawn out along the way that the stars take over the detector while it is exposed, as the declared rates have it.
//!
//! A uniform motion by L during the exposure adds the variance of a box, L²/12, along its direction: L_i·L_j/12 to the second moments. The
//! parameter is the square of the part of the declared way that the images are drawn out by: 1 where the camera turned as declared and nothing followed
//! the sky. A steady motion of which no rates are known is told by the frames alone (`images/frame_motion.rs`).

use crate::effects::{ImageContext, ImageEffect, ImageResponse};

/// Images drawn out by a motion of the camera during the exposure.
pub(in crate::diagnose) const MOTION_SMEAR: &str = "motion-smear";

/// Second moments that follow the declared rates.
pub(super) struct MotionSmear;

impl ImageEffect for MotionSmear {
    fn id(&self) -> &'static str {
        MOTION_SMEAR
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        &[("relative", "")]
    }
    fn follows(&self) -> &'static str {
        "rate"
    }
    fn sign(&self) -> Option<f64> {
        Some(1.0)
    }
    fn are_squares(&self) -> bool {
        true
    }
    fn needs(&self) -> &'static str {
        "second moments of the images, and the rates and exposures of the frames"
    }
    fn ordinary(&self) -> (f64, &'static str) {
        (1.0, "all of the motion during the exposure")
    }
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>> {
        let [x, y] = image.trail_px?;
        Some(vec![ImageResponse { second_px2: [x * x / 12.0, x * y / 12.0, y * y / 12.0], ..ImageResponse::default() }])
    }
}

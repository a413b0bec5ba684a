//! What a renderer changes to show a shift of measured centres: the forward model that belongs to an effect's formula.
//!
//! The formula of an effect on the measured centre is somebody's approximation for somebody's estimator. Where stars can be rendered as the
//! recording has them, a little more and a little less of what is named here, and measured by the estimator in use, the difference is the
//! column of the parameter, with no formula in it.

/// What is rendered a little more and a little less of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rendering {
    /// A stage that works on pixels.
    Stage {
        /// Its id in the registry of pixel effects.
        effect: &'static str,
        /// Parameters that differ from the stage's typical ones: name, value for less, value for more.
        parameters: &'static [(&'static str, [f64; 2])],
        /// What the change from less to more is in units of the effect's own parameter, where stage and formula speak of the same quantity.
        step: Option<f64>,
        /// Whether it acts on a star's light in proportion to B − V − 0.6, as rendered at one magnitude, and not on the sky's.
        by_colour: bool,
    },
    /// The response within a pixel, 1 + a·cos 2πu, u from the pixel's middle along one axis (0: x, 1: y).
    WithinPixel {
        /// The axis.
        axis: usize,
        /// a for less, and for more.
        cosine: [f64; 2],
    },
    /// Coma of the third order that grows with the distance from the middle of the frame.
    Coma {
        /// Zernike coefficient (rms, waves) at the edge of the frame, for less and for more.
        waves: [f64; 2],
    },
    /// A background that rises across the image the way the measured one does, by so much along its steepest way.
    Slope,
}

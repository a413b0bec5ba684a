//! The image of a star that a recording shows, as a calibration and a diagnosis report it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The image learnt at the places that catalogue, camera and attitude predict, and what it changed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct LearntImage {
    /// Stars from which it was learnt.
    pub stars: usize,
    /// Stars held out, by which it was judged.
    pub held_out_stars: usize,
    /// Deviance over degrees of freedom of the held-out stars, pixels and places, under Gaussians of free shape.
    pub gaussian_deviance_per_dof: f64,
    /// The same under the image learnt from the other stars.
    pub learnt_deviance_per_dof: f64,
    /// Order of the polynomial by which it changes over the frame.
    pub field_order: usize,
    /// Whether it changes with the stars' colour.
    pub by_colour: bool,
    /// Whether it changes with the frames' temperature.
    pub by_temperature: bool,
    /// Standard error of the places that the sky says, px per axis.
    pub place_sigma_px: f64,
    /// What was taken off the measured places, rms along columns and rows, px: the bias of the estimator that follows the pixel phase.
    pub bias_rms_px: [f64; 2],
}

impl LearntImage {
    /// What was learnt and done, in a sentence.
    #[must_use]
    pub fn sentence(&self) -> String {
        let changes = [
            (self.field_order > 0).then(|| format!("place (order {})", self.field_order)),
            self.by_colour.then(|| "colour".to_owned()),
            self.by_temperature.then(|| "temperature".to_owned()),
        ];
        let changes: Vec<String> = changes.into_iter().flatten().collect();
        let with = if changes.is_empty() { String::new() } else { format!(", changing with {}", changes.join(" and ")) };
        let [x, y] = self.bias_rms_px;
        format!(
            "the image of a star was learnt from {} stars at the places that the sky predicts{with} (deviance per degree of freedom of {} held-out stars \
             {:.3}, under Gaussians {:.3}); the bias that it predicts, {x:.3} px along x and {y:.3} px along y (rms), is taken off the places",
            self.stars, self.held_out_stars, self.learnt_deviance_per_dof, self.gaussian_deviance_per_dof
        )
    }
}

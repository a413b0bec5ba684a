//! The result of a calibration, as it stands in files.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::lit::LitCircle;
use super::options::{CalibrateOptions, Method};
use super::select::LeftOutReason;
use crate::camera::{Camera, Model, SkyChain};
use crate::coordinates::Attitude;
use crate::identify::ControlPoints;
use crate::provenance::Provenance;

/// The name of the file format.
pub const FORMAT: &str = "boresight-calibrate/2";

/// How the iteration ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// The last step was below ε.
    Converged,
    /// It was not, after the most iterations allowed: the camera is where the iteration stood, and no result.
    NotConverged,
}

/// What an effect that is not modelled may have done to a parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct Systematic {
    /// The effect's id.
    pub cause: String,
    /// The parameter.
    pub parameter: String,
    /// By how much the value stated may be off: stated minus true, least and largest.
    pub range_px: [f64; 2],
    /// What that means, and the remedy.
    pub sentence: String,
}

/// A solved parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct ParameterEstimate {
    /// Its name: of the reference model, or `effect.parameter`.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// Standard error of the value.
    pub sigma: f64,
    /// The standard error that a joint adjustment with the same stars and noise would reach.
    pub sigma_joint: f64,
    /// Unit of the three.
    pub unit: String,
}

/// One solution of the normal equations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct Iteration {
    /// Length of the step, px of mapping over the frame.
    pub step_px: f64,
    /// σ̂0 of the pairs: weighted rms of the cosines' residuals (rad, about), not calibrated as a statistic. Zero for methods on stars.
    pub pair_sigma_rad: f64,
    /// Pairs with a weight other than one in this solution.
    pub pairs_down_weighted: usize,
    /// Typical standard error of a star image (per axis) as the method took it; zero for methods on pairs.
    #[serde(default)]
    pub star_sigma_px: f64,
    /// Star images with a weight of at most one half; zero for methods on pairs.
    #[serde(default)]
    pub stars_down_weighted: usize,
}

/// A combination of parameters, as well or as badly determined as the star images determine it: one line of the table of singular values.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Combination {
    /// Singular value of the columns (attitudes eliminated, weighted), each column scaled to length one: 1 = as well determined as if the
    /// parameters were alone, near 0 = the star images cannot tell them apart.
    pub singular_value: f64,
    /// What one standard error along the combination does to the map over the frame (2-D rms, best rotation out), px.
    pub sigma_px: f64,
    /// The parameters in it and their shares (signed, squares add to one), the largest first; those below a tenth are left out.
    pub parameters: Vec<(String, f64)>,
    /// What it means, where it is determined badly.
    pub sentence: Option<String>,
}

/// One set of parameters that was tried.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Candidate {
    /// What it adds to the set before it.
    pub added: Vec<String>,
    /// Change of −2·ln of the likelihood.
    pub delta_chi2: f64,
    /// Change of the Bayesian information criterion; negative = supported.
    pub delta_bic: f64,
    /// Change of Akaike's information criterion.
    pub delta_aic: f64,
    /// 2-D rms of held-out frames with it.
    pub held_out_rms_px: Option<f64>,
    /// Whether it was taken.
    pub taken: bool,
}

/// Which parameters the data support.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelSelection {
    /// The set that was begun with.
    pub begun_with: Vec<String>,
    /// What was tried, in order.
    pub tried: Vec<Candidate>,
}

/// Parameters that the star images do not support, and which may be there all the same: with them the covariance of the solved ones.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct LeftOpen {
    /// The solved parameters, in their order, and those left out.
    pub parameters: Vec<String>,
    /// Their covariance about the values stated, in their units: that of all of them solved, and by how much they would be others then.
    pub covariance: Vec<Vec<f64>>,
}

/// What identifying anew has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct Reidentified {
    /// Rounds.
    pub rounds: usize,
    /// Points whose star is another than at first.
    pub changed: usize,
    /// Star images that had no star at first.
    pub added: usize,
    /// Points whose star was taken away, because none fits.
    pub removed: usize,
}

/// What the joint method found of the noise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct NoiseFound {
    /// Error per axis that all star images have beyond what their measurement states, px.
    pub floor_px: f64,
    /// Share of wrong identifications.
    pub wrong_share: f64,
    /// Weighted sum of squares over its degrees of freedom: one if the stated errors and the floor are right.
    pub unit_weight_variance: f64,
    /// 2-D rms that the errors assumed predict for the star images used.
    pub predicted_rms_px: f64,
}

/// What became of one control point.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct PointResult {
    /// Index of the frame in its recording.
    pub frame: usize,
    /// Catalogue number.
    pub hip: u32,
    /// Measured column.
    pub x_px: f64,
    /// Measured row.
    pub y_px: f64,
    /// ≤ 0.5 = rejected; 0 if it was left out beforehand. Of methods on pairs the median of the weights of its pairs at the last
    /// iteration, of the joint method the probability that the identification is right.
    pub weight: f64,
    /// Measured minus predicted position with the frame's own attitude; absent where the camera has no image of the star, or
    /// the frame's attitude is open, or the point was left out.
    pub residual_px: Option<[f64; 2]>,
    /// Why the point did not enter, if it did not.
    pub left_out: Option<LeftOutReason>,
}

/// One frame at the solution.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct FrameResult {
    /// Index of the frame in its recording.
    pub frame: usize,
    /// Its attitude; absent if the stars used leave it open.
    pub camera_from_icrs: Option<Attitude>,
    /// Star images offered.
    pub stars_offered: usize,
    /// Star images used.
    pub stars: usize,
    /// 2-D rms of those used, px.
    pub rms_px: Option<f64>,
    /// How much larger than elsewhere the variance of this frame's positions is (trailed or unsharp frames); it is weighted by it.
    #[serde(default = "one")]
    pub variance_factor: f64,
}

fn one() -> f64 {
    1.0
}

/// Standard error of a frame's attitude, camera held.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct AttitudeSigma {
    /// Of the boresight's direction, per axis, arcsec; median over the frames.
    pub across: f64,
    /// Of the rotation about the boresight, arcsec; median over the frames.
    pub about: f64,
}

/// Standard error (2-D) of the pixel → direction map over the frame, the best rotation taken out.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MapSigma {
    /// Median over the frame.
    pub median: f64,
    /// Largest, mostly in a corner.
    pub max: f64,
}

/// A number of control points left out for one reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct LeftOutCount {
    /// The reason.
    pub reason: LeftOutReason,
    /// How many.
    pub points: usize,
}

/// A calibrated camera with everything needed to judge it and to solve it again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Calibration {
    /// [`FORMAT`].
    pub format: String,
    /// The method.
    pub method: Method,
    /// How the iteration ended.
    pub status: Status,
    /// Ids of the effects that the star directions contain.
    pub physics: Vec<String>,
    /// Names of the parameters solved.
    pub model: Vec<String>,
    /// The parameters solved.
    pub parameters: Vec<ParameterEstimate>,
    /// The camera; of the un-mirrored image.
    pub camera: Camera,
    /// The camera with every effect that stands between it and the sky, known and solved. Always of the un-mirrored image; absent in
    /// files of methods that know the reference model alone.
    #[serde(default)]
    pub chain: Option<Model>,
    /// −1 if the images are mirrored (x was replaced by width − 1 − x before everything else), else +1.
    #[serde(default = "not_mirrored")]
    pub parity: i8,
    /// 2-D rms of the star images used, in sample.
    pub rms_px: Option<f64>,
    /// The same as an angle on the sky.
    pub rms_arcsec: Option<f64>,
    /// 2-D rms with each frame's camera solved from other frames (k-fold; leave-one-out below 16 frames); the frame's attitude is free.
    pub held_out_rms_px: Option<f64>,
    /// Star images used (weight > 0.5).
    pub stars: usize,
    /// Star images offered.
    pub stars_offered: usize,
    /// Different stars among those used.
    pub distinct_stars: usize,
    /// Frames used.
    pub frames: usize,
    /// Pairs of star images solved.
    pub pairs: usize,
    /// rms difference of angles between stars, measured and catalogue, over the pairs of star images used.
    pub interstar_angle_rms_arcsec: Option<f64>,
    /// Standard error of a frame's attitude.
    pub attitude_sigma_arcsec: Option<AttitudeSigma>,
    /// Points that entered and were rejected (weight ≤ 0.5).
    pub rejected: Vec<PointResult>,
    /// Points that did not enter, by reason.
    pub left_out: Vec<LeftOutCount>,
    /// What to mind, one sentence each.
    pub warnings: Vec<String>,
    /// Standard error of the map, over what is lit.
    pub map_sigma_px: Option<MapSigma>,
    /// What of the frame the lens lights; absent where that is all of it.
    #[serde(default)]
    pub lit: Option<LitCircle>,
    /// What effects that are not modelled may have done to parameters, where that may be more than their errors say.
    #[serde(default)]
    pub systematics: Vec<Systematic>,
    /// Standard deviation of a star image's position per axis, from the residuals (degrees of freedom taken into account).
    pub unit_weight_sigma_px: f64,
    /// The same as predicted by the points' own covariances (rms over the star images used).
    pub predicted_sigma_px: f64,
    /// Degrees of freedom of the residuals.
    pub degrees_of_freedom: usize,
    /// Covariance of the parameters solved, in their order and units.
    pub covariance: Vec<Vec<f64>>,
    /// What the parameters left out do to the errors of those solved; present if there was a choice.
    #[serde(default)]
    pub left_open: Option<LeftOpen>,
    /// The table of singular values, the worst determined combination first.
    #[serde(default)]
    pub combinations: Vec<Combination>,
    /// What is free and what is held, in a sentence: in which sense the parameters are what they are.
    #[serde(default)]
    pub gauge: String,
    /// What was found of the noise; absent for methods on pairs.
    #[serde(default)]
    pub noise: Option<NoiseFound>,
    /// Which parameters the data support; present if they were to be selected.
    #[serde(default)]
    pub selection: Option<ModelSelection>,
    /// Times that the points were identified anew with the improved camera, and how many changed in all.
    #[serde(default)]
    pub reidentified: Option<Reidentified>,
    /// Time the solution took, s.
    #[serde(default)]
    pub seconds: f64,
    /// The iterations.
    pub iterations: Vec<Iteration>,
    /// Every frame used.
    pub per_frame: Vec<FrameResult>,
    /// Every control point, in the order given.
    pub points: Vec<PointResult>,
    /// How it was solved.
    pub options: CalibrateOptions,
    /// What it was solved from.
    pub control_points: ControlPoints,
    /// How the file came about; filled by who writes it.
    pub provenance: Option<Provenance>,
}

fn not_mirrored() -> i8 {
    1
}

/// Gives a covariance's parameters these signs.
fn change_signs(covariance: &mut [Vec<f64>], signs: &[f64]) {
    for (row, own) in covariance.iter_mut().zip(signs) {
        for (value, other) in row.iter_mut().zip(signs) {
            *value *= own * other;
        }
    }
}

impl Calibration {
    /// The same with all columns in the coordinates of the images as stored, which is how files have it; applied twice, it is
    /// the original. Only mirrored images differ in it.
    #[must_use]
    pub fn with_stored_columns(&self) -> Self {
        let mut other = self.clone();
        if self.parity > 0 {
            return other;
        }
        let flip = |x_px: &mut f64| *x_px = self.stored_column_px(*x_px);
        other.camera = self.camera.mirrored();
        other.control_points.nominal = self.control_points.nominal.mirrored();
        other.control_points.parity = -self.control_points.parity;
        for parameter in &mut other.parameters {
            match parameter.name.as_str() {
                "x0" => flip(&mut parameter.value),
                "p1" => parameter.value = -parameter.value,
                _ => {}
            }
        }
        // x0 and p1 change their sign.
        let sign = |name: &str| if matches!(name, "x0" | "p1") { -1.0 } else { 1.0 };
        let signs: Vec<f64> = self.parameters.iter().map(|parameter| sign(&parameter.name)).collect();
        change_signs(&mut other.covariance, &signs);
        if let Some(open) = &mut other.left_open {
            let signs: Vec<f64> = open.parameters.iter().map(|name| sign(name)).collect();
            change_signs(&mut open.covariance, &signs);
        }
        if let Some(lit) = &mut other.lit {
            flip(&mut lit.centre_px[0]);
        }
        for point in other.points.iter_mut().chain(&mut other.rejected) {
            flip(&mut point.x_px);
            point.residual_px = point.residual_px.map(|[x, y]| [-x, y]);
        }
        for point in &mut other.control_points.points {
            flip(&mut point.x_px);
            point.covariance_px2[1] = -point.covariance_px2[1];
        }
        other
    }

    /// The column, in the images as stored, of a column of the un-mirrored image; and the other way round.
    #[must_use]
    pub fn stored_column_px(&self, x_px: f64) -> f64 {
        if self.parity < 0 { self.camera.width_px as f64 - 1.0 - x_px } else { x_px }
    }

    /// The camera with every effect in force.
    #[must_use]
    pub fn full_chain(&self) -> Model {
        self.chain.clone().unwrap_or_else(|| Model::new(self.camera))
    }

    /// What was done to the light of a frame on its way, with what was fitted of it: the Sky effects of `model`, which is [`Self::full_chain`]. `None`
    /// where the file does not hold the frame's circumstances.
    #[must_use]
    pub fn sky_chain(&self, model: &Model, frame: usize) -> Option<SkyChain> {
        let observation = self.control_points.frames.get(frame).map(|state| state.observation);
        let known = || self.control_points.sky.iter().map(|term| (term.effect.as_str(), term.parameters.clone())).collect::<Vec<_>>();
        match (observation, &self.chain) {
            (Some(observation), Some(_)) => Some(model.sky_chain(observation)),
            (Some(observation), None) => Some(SkyChain::with_parameters(observation, &known())),
            // Nothing was done to it.
            (None, _) => self.physics.is_empty().then(SkyChain::default),
        }
    }

    /// Correlation of two parameters by name; `None` if either was not solved.
    #[must_use]
    pub fn correlation(&self, a: &str, b: &str) -> Option<f64> {
        let index = |name: &str| self.parameters.iter().position(|known| known.name == name);
        let (i, j) = (index(a)?, index(b)?);
        let scale = (self.covariance[i][i] * self.covariance[j][j]).sqrt();
        (scale > 0.0).then(|| self.covariance[i][j] / scale)
    }
}

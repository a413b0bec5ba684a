//! The result of a diagnosis, as it stands in files.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::channels::{ByChannel, Channel, Channels};
use super::image_profiles::{ImageProfile, ShapeCell};
use super::profile_bin::ProfileBin;
use super::value_with_error::with_error;
use super::verdict::{Bound, Verdict};
use crate::detect::LearntImage;
use crate::provenance::Provenance;

/// The format of the result file.
pub const FORMAT: &str = "boresight-diagnose/2";

/// What is known of one effect after the diagnosis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum EffectState {
    /// A finding has this id.
    Found,
    /// It stands in a finding's set, but is not its name.
    Indistinguishable,
    /// Tested, not significant.
    NotFound,
    /// Significant, but the name does not stand: the reason says which test failed.
    Withheld,
    /// Attitudes and the camera's own parameters take it up, or what it depends on does not vary.
    NotObservable,
    /// The recording lacks what it needs.
    NotApplicable,
}

/// A parameter as found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FoundParameter {
    /// Its name, without the effect's.
    pub name: String,
    /// Its value, that of the whole effect.
    pub value: f64,
    /// Standard error, scaled by the scatter of the residuals.
    pub sigma: f64,
    /// Its unit.
    pub unit: String,
}

impl FoundParameter {
    /// `value ± sigma`, as many digits as the error bears; small ones with a common power of ten.
    #[must_use]
    pub fn value_and_error(&self) -> String {
        with_error(self.value, self.sigma)
    }
}

/// An effect that a finding cannot be told apart from, or resembles.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct Resemblance {
    /// The effect.
    pub id: String,
    /// Cosine of the (largest) principal angle between the two effects' columns, attitudes and camera projected out.
    pub cos: f64,
}

/// A member of a finding's set, with the odds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct Rival {
    /// The effect.
    pub id: String,
    /// Cosine of the largest principal angle between its columns and the finding's.
    pub cos: f64,
    /// BIC with the rival in the finding's place minus BIC with the finding.
    pub delta_bic: f64,
    /// Probability that the finding, if true, is preferred to the rival at this signal-to-noise ratio: Φ(SNR·√((1 − cos)/2)).
    pub p_correct: f64,
    /// Fall of χ² on the held-out frames with the rival in the finding's place, of the nearest rivals.
    pub held_out_delta_chi2: Option<f64>,
}

/// Cluster-robust test (wild bootstrap of the score): the share of all Rademacher sign patterns over frames (or stars) that explain as much. It
/// supposes nothing of the correlation of errors within a unit.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct Signs {
    /// The units: frames, parts of frames where frames are few, or stars.
    pub units: String,
    /// How many units that tell alike the effect lives on.
    pub effective: f64,
    /// The share; nothing where even the smallest that so few units allow would not be small.
    pub p_value: Option<f64>,
    /// Probability by chance of as large a mean score, by its scatter between frames; where parts of frames are the units and six frames or more tell
    /// alike.
    #[serde(default)]
    pub between_frames_p_value: Option<f64>,
}

/// An effect that was left out (or is there at another size than the model has it).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct Finding {
    /// The effect.
    pub id: String,
    /// Its parameters.
    pub parameters: Vec<FoundParameter>,
    /// Whether its columns are stars rendered with a little more of the effect and measured as the recording was, or a formula.
    pub columns: ColumnSource,
    /// The covariates that the mismatch follows, the one that explains most first.
    pub located_by: Vec<String>,
    /// Fall of χ² on all frames, everything else refitted.
    pub delta_chi2: f64,
    /// Probability of such a fall by chance, for this effect alone.
    pub p_value: f64,
    /// Set where the simulations resolve no smaller one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p_value_is: Option<Bound>,
    /// The same, all effects tried counted.
    pub family_p_value: f64,
    /// Set where the simulations resolve no smaller one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub family_p_value_is: Option<Bound>,
    /// Fall of χ² on star images that took part neither in the choice of the effect nor in its size, summed over turns that leave parts of
    /// the recording out, each turn choosing and sizing anew; turns that do not choose it add nothing. A finding has passed the test of it, unless
    /// `held_out_remark` says what confirms it instead.
    pub held_out_delta_chi2: f64,
    /// What was to be expected of an effect of the size found, the chance of each turn to choose it counted.
    pub held_out_expected: f64,
    /// How far that fall lies above its mean without the effect, standard deviations.
    pub held_out_score: f64,
    /// What is said of a fall that is larger than the size lets expect, of an effect that all frames chose, or of one that frames left out cannot
    /// test and something else confirms.
    pub held_out_remark: Option<String>,
    /// In how many of how many turns the rest of the recording chose the effect, or one that leaves the same trace.
    pub chosen_again: [usize; 2],
    /// What the turns leave out: frames, blocks of frames, halves of the stars with them, parts of the stars.
    pub left_out: String,
    /// Whether the frames (or stars) agree on it.
    pub signs: Signs,
    /// Probability that the recording simulated anew with what was found differs from the real one along this effect by as much by chance.
    pub resimulated_p_value: Option<f64>,
    /// The fall of χ² as standard deviations of a normal distribution with the same probability by chance.
    #[serde(default)]
    pub score_sigma: f64,
    /// Size over standard error of the best determined combination of the parameters.
    pub snr: f64,
    /// The effect as each channel alone measures it.
    #[serde(default)]
    pub channels: ByChannel,
    /// The effects that explain the mismatch about as well.
    pub indistinguishable_from: Vec<String>,
    /// The same with figures, rejected rivals with a cosine above one half included.
    pub rivals: Vec<Rival>,
    /// The observation that would decide between the members of the set.
    pub decided_by: String,
    /// For an effect of known size: the size found over the known one, and its standard error (what site, air, clock leave open included).
    pub known_amplitude: Option<[f64; 2]>,
    /// The finding in one sentence.
    pub sentence: String,
}

/// What the columns of an effect come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ColumnSource {
    /// The formula on the effect's page.
    #[default]
    Formula,
    /// The recording's own stars, rendered with less and more of the effect and measured by the fit that measured the recording.
    Rendered,
}

/// What is left and has no name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct Unknown {
    /// In which channel it shows.
    pub channel: Channel,
    /// The covariates that it follows.
    pub located_by: Vec<String>,
    /// Probability of as much by chance.
    pub p_value: f64,
    /// Set where the simulations resolve no smaller one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p_value_is: Option<Bound>,
    /// The effects whose columns look most like it.
    pub resembles: Vec<Resemblance>,
    /// Why those names do not stand.
    pub vetoes: Vec<String>,
    /// The file with the vector map, where one was written.
    pub map: Option<String>,
    /// The map itself.
    pub field: RemainderMap,
    /// In one sentence.
    pub sentence: String,
}

/// A vector map of what is left, on a grid of points over the frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct RemainderMap {
    /// Scale over which it changes, px.
    pub length_px: f64,
    /// rms of the map over the frame, px.
    pub rms_px: f64,
    /// Share of the map's variance that is free of curl (gradient of a potential).
    pub curl_free_share: f64,
    /// Gain of log-evidence over no map at all.
    pub log_evidence_gain: f64,
    /// Fall of χ² on held-out frames with the map of the others.
    pub held_out_delta_chi2: f64,
    /// Points: x, y, dx, dy, standard error per axis, px.
    pub points: Vec<[f64; 5]>,
}

/// Limit of a parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Limit {
    /// The parameter, without the effect's name.
    pub name: String,
    /// Its absolute value is below this with 95 % confidence.
    pub value: f64,
    /// Unit.
    pub unit: String,
}

/// One effect of the registry.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EffectStatus {
    /// The effect.
    pub id: String,
    /// What is known of it.
    pub status: EffectState,
    /// Probability of its score by chance, given the findings.
    pub p_value: Option<f64>,
    /// Set where the simulations resolve no smaller one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p_value_is: Option<Bound>,
    /// The score as standard deviations of a normal distribution with the same probability by chance.
    #[serde(default)]
    pub score_sigma: Option<f64>,
    /// Share of its displacement (rms) that attitudes and camera parameters leave.
    pub survival: Option<f64>,
    /// Its parameters refitted beside the findings: what was found of it.
    pub parameters: Vec<FoundParameter>,
    /// Upper limit of its first parameter; for an effect that is found or withheld: none.
    pub upper_limit_95: Option<Limit>,
    /// For an effect that was proposed and does not stand: fall of χ² on what took part in nothing.
    #[serde(default)]
    pub held_out_delta_chi2: Option<f64>,
    /// Why, where that is not plain.
    pub reason: String,
}

/// How well a model describes the star images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct FitQuality {
    /// 2-D rms of the star images used, px.
    pub rms_px: f64,
    /// The same as the stated errors let expect of a model that is right.
    #[serde(default)]
    pub expected_rms_px: Option<f64>,
    /// χ² per degree of freedom, with the noise of the final model.
    pub chi2_per_dof: f64,
    /// 2-D rms on held-out frames.
    pub held_out_rms_px: Option<f64>,
    /// χ² per degree of freedom on held-out frames (attitudes refitted).
    pub held_out_chi2_per_dof: Option<f64>,
}

/// Before and after.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct Fit {
    /// The model that the recording was held against.
    pub baseline: FitQuality,
    /// With the findings in it.
    #[serde(rename = "final")]
    pub after: FitQuality,
}

/// The p-values of random halves of the frames held against one another.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct HalfNights {
    /// p-values, the smallest first.
    pub p_values: Vec<f64>,
    /// How often which effect was the most surprising.
    pub largest: std::collections::BTreeMap<String, usize>,
    /// Largest distance of their distribution from the uniform one (Kolmogorov and Smirnov).
    pub ks_distance: f64,
    /// Share of nights simulated with errors as the diagnosis takes them, split alike, whose p-values lie as far from uniform: halves of the
    /// same frames share their errors, so that no single night's p-values are spread evenly.
    pub ks_p_value: f64,
}

/// Star images that took part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct StarsUsed {
    /// Of stars whose proper motion is known.
    pub with_proper_motion: usize,
    /// Of stars whose proper motion is not.
    pub without: usize,
    /// Left out.
    pub left_out: usize,
}

/// Star images that took no part.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct Unused {
    /// How many.
    pub images: usize,
    /// Why.
    pub reason: String,
}

/// A covariate that residuals were held against.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct Located {
    /// The covariate.
    pub covariate: String,
    /// Variance of the residuals that it explains beyond chance, as a share.
    pub explained: f64,
    /// Probability by chance, all covariates counted.
    pub p_value: f64,
    /// Set where the simulations resolve no smaller one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p_value_is: Option<Bound>,
    /// p-value of the permutation test among all covariates of its kind; nothing where frames are too few for it.
    pub permutation_p_value: Option<f64>,
    /// What was permuted: star images within their frames, or frames.
    pub permuted: Option<String>,
    /// The same once the covariates before it in this list are taken out.
    pub conditional_p_value: Option<f64>,
}

/// The noise of the star positions as the residuals show it, once everything found is modelled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct NoiseState {
    /// Added to every star image's stated error in quadrature, px per axis.
    pub floor_px: f64,
    /// Stated variances times this.
    pub variance_factor: f64,
    /// Degrees of freedom of the t distribution that fits the tails; nothing where they are those of a normal one.
    pub tail_degrees: Option<f64>,
    /// Share of identifications held to be wrong.
    pub wrong_share: f64,
    /// What the images show of it, before any star is named.
    pub measured: MeasuredNoise,
}

/// The noise as the frames' pixels show it; nothing where a list of stars stands in their place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct MeasuredNoise {
    /// χ² per degree of freedom of the star images' stamps, the median: above one where images are not as the fit has them.
    pub stamp_chi2_per_dof: Option<f64>,
    /// Scatter of the background over that of photons and readout as declared (gain, bias and read noise), the median of the frames.
    pub background_ratio: Option<f64>,
}

/// What was left out, turn by turn.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct LeftOut {
    /// In words.
    pub what: String,
    /// The frames left out together, block by block; none where frames are too few and parts of the stars were left out.
    pub blocks: Vec<Vec<usize>>,
    /// Turns for effects that do not go by a star's own numbers.
    pub turns: usize,
    /// Turns for those that do, which leave halves of the stars out too.
    pub turns_of_stars: usize,
}

/// An effect that was proposed, by all star images or by the rest of a turn, and what the held-out ones say. Where nothing is missing the
/// held-out falls of all proposals have a mean below zero; those of the ones named alone have not, since these have passed the test of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct Proposed {
    /// The effect.
    pub id: String,
    /// Whether it is a finding.
    pub named: bool,
    /// Whether all star images together propose it; else only the rest of some turn does.
    pub by_all_images: bool,
    /// What it explains of all star images beside the findings: χ² of its score, in sample.
    pub delta_chi2: f64,
    /// As in a finding.
    pub held_out_delta_chi2: f64,
    /// As in a finding.
    pub held_out_expected: f64,
    /// As in a finding.
    pub held_out_score: f64,
    /// As in a finding.
    pub chosen_again: [usize; 2],
    /// As in a finding.
    pub left_out: String,
    /// Why it is withheld; empty for a finding.
    pub against: Vec<String>,
}

/// One star image's residuals, for tables and pictures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct ResidualRow {
    /// Index of the control point.
    pub point: usize,
    /// Frame.
    pub frame: usize,
    /// Star.
    pub hip: u32,
    /// Measured place.
    pub x_px: f64,
    /// Measured place.
    pub y_px: f64,
    /// Measured minus predicted by the baseline, px.
    pub before_px: [f64; 2],
    /// Measured minus predicted by the final model, px.
    pub after_px: [f64; 2],
    /// Standard error per axis, px.
    pub sigma_px: f64,
    /// Weight.
    pub weight: f64,
}

/// A zenith that was found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct FoundZenith {
    /// The frame.
    pub frame: usize,
    /// Right ascension and declination, ICRS axes.
    pub radec_deg: [f64; 2],
}

/// A covariate's picture: displacements in bins, and the model through them. The slope of the one on the other, weighted by their errors, has
/// the standard error of the parameter over its value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct Profile {
    /// The effect whose finding it shows.
    pub id: String,
    /// The parameter that it shows; the effect's others are taken off like all else.
    pub parameter: FoundParameter,
    /// The covariate, or `predicted-displacement`: how far the effect displaces each star image.
    pub covariate: String,
    /// The component that gives the sign, in words ("along the radius", "toward the zenith").
    pub component: String,
    /// The bins.
    pub bins: Vec<ProfileBin>,
}

/// The result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct Diagnosis {
    /// [`FORMAT`].
    pub format: String,
    /// The channels that were looked at: everything that follows speaks of these alone.
    pub scope: Vec<Channel>,
    /// The answer.
    pub verdict: Verdict,
    /// The effects of the model that the recording was held against.
    pub physics: Vec<String>,
    /// What was left out.
    pub findings: Vec<Finding>,
    /// All that was proposed, named or withheld, with what held-out images say of it.
    pub proposed: Vec<Proposed>,
    /// What is left and has no name, one a channel at most.
    pub unknown: Vec<Unknown>,
    /// Every effect of the registry.
    pub effects: Vec<EffectStatus>,
    /// Before and after.
    pub fit: Fit,
    /// What is said of each channel.
    pub channels: Channels,
    /// Star images that took part.
    pub stars_used: StarsUsed,
    /// The covariates that the baseline's residuals follow, the one that explains most first.
    pub located: Vec<Located>,
    /// The noise found.
    pub noise: NoiseState,
    /// The image of a star that the frames show, where it is another than that which places were measured with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub image: Option<LearntImage>,
    /// What was left out in turn, for proof.
    pub left_out: LeftOut,
    /// Simulated recordings without any effect that the omnibus test was held against.
    pub nulls: usize,
    /// Probability that the recording simulated anew with the findings in force, held against the same model, differs from the real one by as
    /// much by chance.
    pub resimulated_p_value: Option<f64>,
    /// Probability of what is left beside the findings by chance.
    pub left_p_value: Option<f64>,
    /// Random halves of the frames held against one another, where asked for.
    pub half_nights: Option<HalfNights>,
    /// Number of independent hypotheses that the family of tests amounts to.
    pub effective_hypotheses: f64,
    /// The summary in plain sentences.
    pub summary: Vec<String>,
    /// What to mind.
    pub warnings: Vec<String>,
    /// The camera and sky with the findings in force: names and values of all parameters.
    pub camera: Option<crate::camera::Model>,
    /// Why star images took no part.
    #[serde(default)]
    pub unused: Vec<Unused>,
    /// Where the zenith stands in each frame whose place or time is not known, as the refraction that was found has it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub zeniths: Vec<FoundZenith>,
    /// Residuals of every star image.
    pub residuals: Vec<ResidualRow>,
    /// Pictures' data: one for each finding in the places.
    pub profiles: Vec<Profile>,
    /// Pictures' data: brightness and size of the star images against what they may follow.
    pub image_profiles: Vec<ImageProfile>,
    /// Pictures' data: shape of the star images over the frame.
    pub shape_map: Vec<ShapeCell>,
    /// Wall time.
    pub seconds: f64,
    /// Where it comes from.
    pub provenance: Option<Provenance>,
}

//! Selection of the control points that enter a calibration.
//!
//! The reference method weighs all points alike, so a point that is known to be much worse than the others does harm: it adds
//! more noise than information. The rules, in this order:
//!
//! 1. A star named twice in one frame, or one image given to two stars: at least one is wrong and nothing says which; all are left out.
//! 2. Stars without proper motion, if the caller asks for it ([`super::CalibrateOptions::proper_motion_only`]).
//! 3. Points whose predicted error (centroid and catalogue together, per axis) is above an absolute limit, if one is given.
//! 4. Points that would make an equally weighted solution worse. Sorted by predicted variance σ², the first n points give an
//!    estimate whose variance goes as Σσ²/n²; it falls as long as the next point has less than about twice the mean variance
//!    of those before it. The largest n whose value is within a tenth of the
//!    smallest is taken (5 % in the standard errors: more points find wrong ones better and cover the frame better). A floor stands for what centroids of real cameras leave beyond
//!    their photon noise, so that very bright stars do not expel the others. Saturated and blended images fall here too,
//!    as their stated covariance is large.
//! 5. Frames that are left with fewer than three points: they say nothing that can be checked.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::pairs::{FrameStars, Star};
use super::{CalibrateOptions, Method};
use crate::coordinates::PixelPoint;
use crate::identify::{ControlPoint, ControlPoints};
use crate::statistics::order::sort_by;

/// Error per axis that real centroids have beyond their photon noise (pixel phase, PSF mismatch), px.
pub(super) const CENTROID_FLOOR_PX: f64 = 0.05;
/// How much larger than the smallest the variance may get for the sake of more points.
const TOLERATED_LOSS: f64 = 0.1;
/// A frame with fewer points is left out.
pub(super) const MIN_STARS: usize = 3;

/// Why a control point did not enter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum LeftOutReason {
    /// Its star is named twice in the frame, or its image is given to two stars.
    Duplicate,
    /// The catalogue does not know the star's proper motion.
    NoProperMotion,
    /// Its predicted error is above the limit that was asked for.
    AboveLimit,
    /// Its predicted error is so much larger than the others' that it would make an equally weighted solution worse.
    Imprecise,
    /// Its frame has fewer than three points.
    FewInFrame,
}

impl LeftOutReason {
    /// For a sentence: "… left out because …".
    pub(super) fn text(self) -> &'static str {
        match self {
            Self::Duplicate => "their star is named twice in the frame or their image is given to two stars",
            Self::NoProperMotion => "their star's proper motion is not known",
            Self::AboveLimit => "their predicted error is above the limit",
            Self::Imprecise => "their predicted error is so much larger than the others' that an equally weighted solution would get worse",
            Self::FewInFrame => "their frame has fewer than three usable points",
        }
    }
}

/// The points that enter and those that do not.
#[derive(Clone, Debug)]
pub(super) struct Selection {
    /// By frame, in order of the frames' numbers.
    pub(super) frames: Vec<FrameStars>,
    /// The rest: index of the point and why, in order of index.
    pub(super) left_out: Vec<(usize, LeftOutReason)>,
}

/// Standard error per axis that the point's own figures predict, px.
pub(super) fn predicted_sigma_px(point: &ControlPoint, focal_length_px: f64) -> f64 {
    let [xx, _, yy] = point.covariance_px2;
    let catalog = point.catalog_sigma_rad * focal_length_px;
    (f64::midpoint(xx, yy).max(0.0) + catalog * catalog).sqrt()
}

/// Applies the rules.
pub(super) fn select(control_points: &ControlPoints, options: &CalibrateOptions) -> Selection {
    let points = &control_points.points;
    let mut reasons: Vec<Option<LeftOutReason>> = vec![None; points.len()];
    mark_duplicates(points, &mut reasons);
    let sigma: Vec<f64> = points.iter().map(|point| predicted_sigma_px(point, control_points.nominal.focal_length_px)).collect();
    for (i, point) in points.iter().enumerate().filter(|(i, _)| reasons[*i].is_none()).collect::<Vec<_>>() {
        if options.proper_motion_only && !point.has_proper_motion {
            reasons[i] = Some(LeftOutReason::NoProperMotion);
        } else if options.max_position_sigma_px.is_some_and(|limit| sigma[i] > limit) {
            reasons[i] = Some(LeftOutReason::AboveLimit);
        }
    }
    // The joint method weighs every point by its own error.
    if options.leave_out_imprecise && options.method != Method::Bundle {
        let candidates: Vec<usize> = (0..points.len()).filter(|i| reasons[*i].is_none()).collect();
        for i in imprecise(&candidates, &sigma) {
            reasons[i] = Some(LeftOutReason::Imprecise);
        }
    }
    let mut by_frame: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for i in (0..points.len()).filter(|i| reasons[*i].is_none()) {
        by_frame.entry(points[i].frame).or_default().push(i);
    }
    let mut frames = Vec::new();
    for (frame, indices) in by_frame {
        if indices.len() < MIN_STARS {
            for i in indices {
                reasons[i] = Some(LeftOutReason::FewInFrame);
            }
            continue;
        }
        let star = |&i: &usize| Star {
            point: i,
            pixel: PixelPoint { x_px: points[i].x_px, y_px: points[i].y_px },
            direction: points[i].direction.xyz,
        };
        frames.push(FrameStars { frame, stars: indices.iter().map(star).collect() });
    }
    let left_out = reasons.iter().enumerate().filter_map(|(i, reason)| reason.map(|reason| (i, reason))).collect();
    Selection { frames, left_out }
}

/// Rule 1.
fn mark_duplicates(points: &[ControlPoint], reasons: &mut [Option<LeftOutReason>]) {
    // Without a number (0) a star is told by its own direction alone.
    let stars = (0..points.len()).filter(|i| points[*i].hip != 0).map(|i| ((points[i].frame, u64::from(points[i].hip), 0), i));
    let images = (0..points.len()).map(|i| ((points[i].frame, points[i].x_px.to_bits(), points[i].y_px.to_bits()), i));
    for mut keyed in [stars.collect::<Vec<_>>(), images.collect::<Vec<_>>()] {
        keyed.sort_unstable();
        for same in keyed.chunk_by(|a, b| a.0 == b.0).filter(|same| same.len() > 1) {
            for (_, i) in same {
                reasons[*i] = Some(LeftOutReason::Duplicate);
            }
        }
    }
}

/// Rule 4: those of the candidates that do more harm than good.
fn imprecise(candidates: &[usize], sigma: &[f64]) -> Vec<usize> {
    let mut sorted = candidates.to_vec();
    sort_by(&mut sorted, |a, b| sigma[*a].total_cmp(&sigma[*b]).then(a.cmp(b)));
    let mut sum = 0.0;
    let values: Vec<f64> = (1_u32..)
        .zip(&sorted)
        .map(|(n, &i)| {
            sum += sigma[i] * sigma[i] + CENTROID_FLOOR_PX * CENTROID_FLOOR_PX;
            sum / (f64::from(n) * f64::from(n))
        })
        .collect();
    let smallest = values.iter().copied().fold(f64::INFINITY, f64::min);
    let last = values.iter().rposition(|value| *value <= (1.0 + TOLERATED_LOSS) * smallest);
    sorted.split_off(last.map_or(0, |last| last + 1))
}

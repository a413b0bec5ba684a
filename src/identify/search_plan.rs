//! Search plan of a frame: the passes that are tried one after another, first through the tangent plane, then through the laws of fisheyes.

use std::borrow::Cow;

use super::pose::Points;
use super::projection::Projection;
use super::search::SearchPass;
use super::stages::{FISHEYE_STAGES, STAGES};
use super::{IdentifyOptions, fisheye};
use crate::units::DEG_RAD;

/// A frame whose fields are to be narrower than this is no fisheye's, rad.
const MIN_WIDTH_RAD: f64 = 80.0 * DEG_RAD;

/// The points of a frame.
#[derive(Clone, Debug)]
pub(super) struct FramePoints {
    /// All, the brightest of them.
    pub(super) all: Points,
    /// Those that look like stars, if many others do not.
    pub(super) lone: Option<Points>,
    /// Those spread over the frame, where the brightest stand together.
    pub(super) spread: Option<Points>,
}

/// The search passes over a frame, in their order, each made when it is asked for.
pub(super) fn search_passes<'a>(seen: &'a FramePoints, options: &IdentifyOptions) -> impl Iterator<Item = SearchPass<'a>> {
    let is_plane = matches!(options.projection, None | Some(Projection::Pinhole));
    let plane = seen.lone.iter().chain(&seen.spread).chain([&seen.all]).filter(move |_| is_plane).map(|points| SearchPass {
        frame: points,
        points: Cow::Borrowed(points),
        projection: Projection::Pinhole,
        stages: &STAGES,
    });
    let asked: &[Projection] = match &options.projection {
        None if may_be_fisheye(&seen.all, options) => &Projection::FISHEYES,
        Some(projection) if *projection != Projection::Pinhole => std::slice::from_ref(projection),
        _ => &[],
    };
    let both = seen.lone.iter().chain([&seen.all]).filter(move |_| !asked.is_empty());
    let inner = both.filter_map(|points| Some((points, fisheye::inner(points)?)));
    let fisheyes = inner.flat_map(move |(frame, inner)| {
        let pass =
            move |&projection: &Projection| SearchPass { frame, points: Cow::Owned(inner.clone()), projection, stages: &FISHEYE_STAGES };
        asked.iter().map(pass)
    });
    plane.chain(fisheyes)
}

/// Whether fields that only fisheyes see are to be searched.
fn may_be_fisheye(points: &Points, options: &IdentifyOptions) -> bool {
    let everywhere = options.nominal_focal_length_px.is_none() || options.search_beyond_tolerance;
    let told = options.nominal_focal_length_px.is_some_and(|f| 2.0 * (points.corner_px / f).atan() >= MIN_WIDTH_RAD);
    everywhere && options.field_width_range_rad[1] >= MIN_WIDTH_RAD || told
}

//! Stages of a search: which triangles of detections are tried, and how.

use Choice::{Brightest, Drawn};

/// Detections that are looked at in the check of a candidate of the brightest.
const CHECKED: usize = 64;
/// Triangles by chance are drawn from so many of the brightest detections, and checked against as many.
pub(super) const DRAWN_FROM: usize = 200;

/// Which triangles of detections a stage tries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Choice {
    /// All of the brightest so many detections.
    Brightest(usize),
    /// So many by chance, of all detections: where false ones are brighter than the stars, the brightest are no better than others.
    Drawn(usize),
}

/// One pass over the focal lengths.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stage {
    pub(super) choice: Choice,
    /// Tolerance of the ratios of the sides.
    pub(super) ratio_tolerance: f64,
    /// Relative displacement at the corner that is taken away first.
    pub(super) kappa: f64,
    /// Steps up to a scale with sparser stars and larger triangles, or (negative) down to a denser one.
    pub(super) coarser: i32,
    /// Too long for a search over all focal lengths.
    pub(super) narrow_only: bool,
    /// Whether each triangle of detections is tried at all focal lengths before the next where these are few, and not all triangles at each focal
    /// length: of the brightest stars the first triangle or two are mostly in the index, whatever the focal length.
    pub(super) by_triangle: bool,
}

impl Stage {
    /// How many detections speak about a candidate.
    pub(super) const fn judges(&self) -> usize {
        match self.choice {
            Brightest(_) => CHECKED,
            Drawn(_) => DRAWN_FROM,
        }
    }
}

const fn stage(choice: Choice, ratio_tolerance: f64, kappa: f64, coarser: i32) -> Stage {
    Stage { choice, ratio_tolerance, kappa, coarser, narrow_only: false, by_triangle: false }
}

const fn narrow_only(choice: Choice, ratio_tolerance: f64, kappa: f64, coarser: i32) -> Stage {
    Stage { narrow_only: true, ..stage(choice, ratio_tolerance, kappa, coarser) }
}

/// From the likely and cheap to the rest: sparser stars for images that show only few, more detections for false stars,
/// distortions of either sign, a wider tolerance for noise.
pub(super) const STAGES: [Stage; 21] = [
    Stage { by_triangle: true, ..stage(Brightest(5), 0.003, 0.0, 0) },
    stage(Brightest(7), 0.003, 0.0, 0),
    stage(Brightest(10), 0.003, 0.0, 0),
    stage(Brightest(7), 0.003, 0.0, 2),
    stage(Brightest(16), 0.003, 0.0, 0),
    stage(Drawn(250), 0.003, 0.0, 0),
    stage(Brightest(9), 0.008, 0.0, 2),
    stage(Brightest(13), 0.006, -0.04, 0),
    stage(Brightest(22), 0.003, 0.0, 0),
    stage(Brightest(13), 0.006, -0.09, 0),
    stage(Brightest(13), 0.006, 0.04, 0),
    stage(Brightest(13), 0.006, -0.16, 0),
    stage(Brightest(13), 0.006, -0.24, 0),
    narrow_only(Brightest(11), 0.008, 0.0, 1),
    stage(Brightest(12), 0.005, 0.0, -1),
    stage(Drawn(450), 0.003, 0.0, 0),
    narrow_only(Brightest(13), 0.012, 0.0, 0),
    narrow_only(Brightest(18), 0.006, -0.04, 0),
    narrow_only(Brightest(18), 0.006, -0.16, 0),
    narrow_only(Brightest(12), 0.010, 0.0, -2),
    narrow_only(Drawn(2000), 0.003, 0.0, 0),
];

/// Wide tolerances of shape, for lenses that follow no law and frames whose middle is not that of the lens.
pub(super) const FISHEYE_STAGES: [Stage; 3] =
    [stage(Brightest(12), 0.010, 0.0, 0), stage(Brightest(18), 0.010, 0.0, 0), stage(Drawn(300), 0.010, 0.0, 0)];

#[cfg(test)]
mod tests {
    use super::*;

    /// So few that a search over all focal lengths comes to none of its limits with them.
    #[test]
    fn few_triangles_are_tried_at_all_focal_lengths_before_the_next() {
        let by_triangle: Vec<_> = STAGES.iter().enumerate().filter(|(_, stage)| stage.by_triangle).collect();
        assert!(matches!(by_triangle[..], [(0, Stage { choice: Brightest(5), narrow_only: false, .. })]), "{by_triangle:?}");
        assert!(FISHEYE_STAGES.iter().all(|stage| !stage.by_triangle));
    }
}

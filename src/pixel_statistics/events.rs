//! Cosmic rays: pixels of light that no lens has drawn, in one frame alone.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::fixed_pattern::PatternFrame;

/// A cosmic ray stands out of the noise at least so far.
const MIN_SIGMAS: f64 = 7.5;
/// What is so far out in another frame too is a hot pixel, or one that jumps.
const HOT_SIGMAS: f64 = 4.5;
/// The brightest neighbour of a star's middle pixel has at least this share of what a Gaussian in the pixel's middle would give it.
const SHARPER_THAN_STAR: f64 = 0.4;
/// Narrower images than this are as sharp as cosmic rays, px.
const MIN_STAR_SIGMA_PX: f64 = 0.65;

/// Cosmic rays counted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CosmicRays {
    /// How many.
    pub count: usize,
    /// Frames that were searched.
    pub frames: usize,
    /// Share of their pixels that was searched: sky, away from stars.
    pub share: f64,
    /// Per frame of full size.
    pub per_frame: f64,
    /// Per second, where exposures are known.
    pub per_s: Option<f64>,
}

/// Counts them. `psf_sigma_px`: width of a star's image; without one, or with a narrow one, nothing can be told.
pub(super) fn cosmic_rays(frames: &[PatternFrame], events: &[Vec<usize>], psf_sigma_px: Option<f64>) -> Option<CosmicRays> {
    let sigma = psf_sigma_px.filter(|sigma| *sigma >= MIN_STAR_SIGMA_PX)?;
    let neighbour_share = SHARPER_THAN_STAR * (-0.5 / (sigma * sigma)).exp();
    let of_frame =
        |(own, events): (usize, &Vec<usize>)| events.iter().filter(|index| is_cosmic_ray(frames, own, **index, neighbour_share)).count();
    if frames.len() < 2 {
        return None;
    }
    let count = events.iter().enumerate().map(of_frame).sum::<usize>();
    let share = frames.iter().map(PatternFrame::sky_share).sum::<f64>() / frames.len() as f64;
    let searched = share * frames.len() as f64;
    let seconds: Option<f64> = frames.iter().map(|frame| frame.exposure_s).sum();
    Some(CosmicRays {
        count,
        frames: frames.len(),
        share,
        per_frame: count as f64 / searched,
        per_s: seconds.filter(|seconds| *seconds > 0.0).map(|seconds| count as f64 / (share * seconds)),
    })
}

fn is_cosmic_ray(frames: &[PatternFrame], own: usize, index: usize, neighbour_share: f64) -> bool {
    let frame = &frames[own];
    let peak = frame.deviation(index);
    if peak < MIN_SIGMAS {
        return false;
    }
    let width = frame.width_px();
    let around = [index.checked_sub(1), Some(index + 1), index.checked_sub(width), Some(index + width)];
    let neighbour = around.into_iter().flatten().map(|at| frame.deviation(at)).fold(f64::NEG_INFINITY, f64::max);
    // The noise of four neighbours reaches two standard deviations; only rays far above that can be judged by share.
    let is_sharp = neighbour < (neighbour_share * peak).max(2.5) && neighbour < peak;
    is_sharp && (0..frames.len()).filter(|other| *other != own).all(|other| frames[other].deviation(index) < HOT_SIGMAS)
}

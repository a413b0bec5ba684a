//! The second look at the frames, for what bright stars leave at other places: the stars of a frame and of the one before must be known.

use super::dark::Dark;
use super::{MeasuredFrame, pixels::discs};
use crate::detect::{Detection, Detections};
use crate::frame::MaskedFrame;
use crate::parallel;
use crate::pixel_statistics::{CopiesFrame, ElsewhereFrame, FoundStar};
use crate::statistics::median_in_place;
use crate::statistics::order::descending;

/// Frames that are looked at a second time, at most.
const MAX_FRAMES: usize = 64;

/// Of frames spread evenly over the recording, two and two, so that each second one has the frame before. `load` gives a frame's pixels once more;
/// frames that it does not give are left out.
pub(super) fn elsewhere(
    frames: &[MeasuredFrame],
    dark: Option<&Dark>,
    load: impl Fn(usize) -> Option<MaskedFrame> + Sync,
) -> Vec<ElsewhereFrame> {
    let stars: Vec<Vec<FoundStar>> = frames.iter().map(|frame| found_stars(&frame.detections)).collect();
    let step = frames.len().div_ceil(MAX_FRAMES).max(1);
    let looked_at: Vec<usize> = (0..frames.len()).filter(|place| place / 2 % step == 0).collect();
    parallel::map(&looked_at, |place| one(frames, &stars, *place, dark, &load)).into_iter().flatten().collect()
}

fn one(
    frames: &[MeasuredFrame],
    stars: &[Vec<FoundStar>],
    place: usize,
    dark: Option<&Dark>,
    load: &impl Fn(usize) -> Option<MaskedFrame>,
) -> Option<ElsewhereFrame> {
    let own = &frames[place];
    let is_next = |before: &&MeasuredFrame| before.index + 1 == own.index && size(&before.detections) == size(&own.detections);
    let before = place.checked_sub(1).filter(|before| is_next(&&frames[*before])).map_or(&[][..], |before| &stars[before]);
    let is_clean = |star: &&Detection| !star.flags.saturated && !star.flags.edge && !star.flags.blended && star.width_px > 0.0;
    let mut widths: Vec<f64> = own.detections.stars.iter().filter(is_clean).map(|star| star.width_px).collect();
    let sigma_px = median_in_place(&mut widths)?;
    let MaskedFrame { mut frame, undefined: mut bad } = load(own.index)?;
    frame.lower_saturation_to_step();
    if let Some(dark) = dark {
        dark.subtract(&mut frame).ok()?;
        match &mut bad {
            Some(bad) => bad.iter_mut().zip(dark.hot()).for_each(|(bad, hot)| *bad |= hot),
            None => bad = Some(dark.hot().to_vec()),
        }
    }
    let copies =
        CopiesFrame { frame: &frame, stars: &stars[place], before, bad: bad.as_deref(), sigma_px, noise_dn: own.detections.noise_dn };
    Some(ElsewhereFrame::of(own.index, &copies))
}

fn size(detections: &Detections) -> [usize; 2] {
    [detections.width_px, detections.height_px]
}

/// The stars of a frame, the brightest first.
fn found_stars(detections: &Detections) -> Vec<FoundStar> {
    let star = |(star, disc): (&Detection, _)| FoundStar {
        disc,
        flux_dn: star.flux_dn,
        is_whole: !star.flags.edge,
        is_full: star.flags.saturated,
    };
    let mut all: Vec<FoundStar> = detections.stars.iter().zip(discs(detections)).map(star).collect();
    descending(&mut all, |a| a.flux_dn);
    all
}

//! Jitter: images that are wider in some frames than in others, with nothing that explains it.
//!
//! The camera shakes by another amount in each exposure, and adds its variance to that of every image. On the ground seeing, haze and dew on the lens do
//! the same, so that it has this name in space alone. What goes with temperature, time or a declared rate is taken off before.

use super::counted::Counted;
use super::frame_widths::{frame_means, scatter};
use super::judge::Judged;
use crate::diagnose::causes::JITTER;
use crate::diagnose::channels::Channel;

/// What the mean widths of the frames say; nothing where they cannot.
pub(super) fn jitter(judged: &Judged, looks_through_air: bool) -> Option<Counted> {
    let means = frame_means(&judged.rows, &judged.fit)?;
    let (mean, surprise) = scatter(&means);
    // From the steadiest frame to the mean one, the noise of a minimum taken off.
    let scatter = means.iter().map(|(value, _)| (value - mean).powi(2)).sum::<f64>() / (means.len() - 1) as f64;
    let noise = means.iter().map(|(_, variance)| variance).sum::<f64>() / means.len() as f64;
    let added_px2 = (scatter - noise).max(0.0).sqrt();
    let sigma_px2 = noise.sqrt() / (2.0 * (means.len() - 1) as f64).sqrt();
    let sigma_px = added_px2.sqrt();
    let error = if sigma_px > 0.0 { 0.5 * sigma_px2 / sigma_px } else { sigma_px2.sqrt() };
    let sentence = format!(
        "The images are wider in some frames than in others: their variance scatters by {added_px2:.3} px² from frame to frame, as a camera that shakes makes it."
    );
    let counted = Counted::of_stars(JITTER, Channel::Shape, vec![("sigma_px", sigma_px, error, "px")], surprise, "frame", sentence);
    Some(if looks_through_air {
        counted.withheld("on the ground seeing, haze and dew on the lens do the same: they differ from frame to frame")
    } else {
        counted
    })
}

#[cfg(test)]
mod tests {
    use super::super::judge::{Asked, judge};
    use super::super::tests::{FRAMES, asked, found, nothing, stars};
    use super::*;

    /// Names where images are wider by `added_px2` of their frame and its time, in space; with that of the scatter, if it has one.
    fn told(seed: u64, added_px2: impl Fn(usize, f64) -> f64) -> Vec<&'static str> {
        let mut stars = stars(seed, nothing);
        for star in &mut stars {
            // Frames are not taken in the order of their numbers: what is left out lies between others.
            let time_h = ((5 * star.frame) % FRAMES) as f64 / 2.0 - 2.75;
            star.image.time_offset_h = Some(time_h);
            let more = added_px2(star.frame, time_h);
            let moments = star.moments.as_mut().unwrap();
            moments.second_px2[0] += more;
            moments.second_px2[2] += more;
        }
        let judged = judge(&stars, None, FRAMES, &Asked { looks_through_air: false, ..asked(1e-4) }, &[]).unwrap();
        let scatter = jitter(&judged, false).and_then(|own| own.found_id());
        found(&judged).into_iter().chain(scatter).collect()
    }

    /// So small a drift, beside what shakes, that its frames are no trend beyond chance among all effects; their scatter is there all the same, and
    /// follows the time.
    #[test]
    fn a_drift_of_the_focus_is_no_jitter() {
        let drift = |_: usize, time_h: f64| 0.018 * time_h;
        let names: Vec<_> = (0..6).map(|seed| told(seed, drift)).collect();
        let right = names.iter().filter(|names| names.first() == Some(&"focus-drift")).count();
        assert!(right >= 4, "{names:?}");
    }

    #[test]
    fn a_scatter_that_follows_nothing_is_jitter() {
        // No order of the frames.
        let shake = |frame: usize, _: f64| 0.05 * (7.3 * (frame as f64 + 1.0).powi(2)).sin();
        let names: Vec<_> = (20..26).map(|seed| told(seed, shake)).collect();
        assert!(names.iter().all(|names| **names == ["jitter"]), "{names:?}");
    }
}

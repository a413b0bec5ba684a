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
    let means = frame_means(&judged.rows, judged.standing())?;
    let (mean, surprise) = scatter(&means);
    // Standard deviation of what the frames add, the noise taken off: their mean, of variances that are distributed exponentially.
    let scatter = means.iter().map(|(value, _)| (value - mean).powi(2)).sum::<f64>() / (means.len() - 1) as f64;
    let noise = means.iter().map(|(_, variance)| variance).sum::<f64>() / means.len() as f64;
    let added_px2 = (scatter - noise).max(0.0).sqrt();
    let sigma_px = added_px2.sqrt();
    // A variance of n draws is known to √(2/(n − 1)) of itself, the draws of the shaking and those of the noise.
    let variance_error = scatter * (2.0 / (means.len() - 1) as f64).sqrt();
    let error = if added_px2 > 0.0 { 0.25 * variance_error / (added_px2 * sigma_px) } else { variance_error.powf(0.25) };
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
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use rand_pcg::Pcg64Mcg;

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

    /// Of twelve draws their standard deviation is known to 21 %, its root to half of that.
    #[test]
    fn the_error_holds_the_scatter_of_the_draws() {
        let mut pulls = Vec::new();
        for seed in 40..80 {
            let mut rng = Pcg64Mcg::seed_from_u64(seed);
            let shakes_px2: Vec<f64> =
                (0..FRAMES).map(|_| 0.2 + 0.05 * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut rng)).collect();
            let mut stars = stars(seed, nothing);
            for star in &mut stars {
                let moments = star.moments.as_mut().unwrap();
                moments.second_px2[0] += shakes_px2[star.frame];
                moments.second_px2[2] += shakes_px2[star.frame];
            }
            let judged = judge(&stars, None, FRAMES, &Asked { looks_through_air: false, ..asked(1e-4) }, &[]).unwrap();
            let Some(finding) = jitter(&judged, false).and_then(|own| own.reported().1) else { continue };
            let found = &finding.parameters[0];
            pulls.push((found.value - 0.05_f64.sqrt()) / found.sigma);
        }
        let rms = (pulls.iter().map(|pull| pull * pull).sum::<f64>() / pulls.len() as f64).sqrt();
        assert!(pulls.len() >= 30 && (0.7..1.5).contains(&rms), "{rms} of {}", pulls.len());
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

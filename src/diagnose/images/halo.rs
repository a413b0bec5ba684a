//! Wide halos about bright stars, of all frames: light that the lens scatters.

use super::copies::{at_most, told};
use super::counted::{Counted, MAX_SURPRISE};
use crate::diagnose::channels::Channel;
use crate::effects::optics::veiling_glare::VeilingGlare;
use crate::effects::pixel::PixelEffect;
use crate::pixel_statistics::{ElsewhereFrame, Estimate, FrameHalo, HALO_CONTROLS, HALO_RADII_PX, halo_share};
use crate::statistics::significance::neg_ln_chi2_sf;

const ID: &str = <VeilingGlare as PixelEffect>::ID;
/// Tests that are made.
pub(super) const TESTS: usize = HALO_RADII_PX.len();
/// Fewer frames tell nothing.
const MIN_FRAMES: usize = 4;
/// Each half of the frames shows it at so many standard errors, and at least this share of what the other shows.
const HALF_SHOWS: f64 = 2.0;
const HALF_SHARE: f64 = 1.0 / 3.0;

/// Weighted mean of some numbers with its error, and the χ² about it over its degrees of freedom.
fn mean(all: impl Iterator<Item = Estimate> + Clone) -> (Estimate, f64) {
    let weight: f64 = all.clone().map(|own| own.sigma.powi(-2)).sum();
    let value = all.clone().map(|own| own.value * own.sigma.powi(-2)).sum::<f64>() / weight;
    let (chi2, count) = all.fold((0.0, 0_usize), |(sum, count), own| (sum + ((own.value - value) / own.sigma).powi(2), count + 1));
    (Estimate { value, sigma: weight.sqrt().recip() }, chi2 / (count.max(2) - 1) as f64)
}

/// Size of a halo and its surprise, whether halves of the frames agree.
fn of_radius(halos: &[&FrameHalo], which: usize) -> (Estimate, f64, bool) {
    let own = halos.iter().map(|halo| halo.about_stars[which]);
    let (all, scatter) = mean(own.clone());
    let square = |k: usize| {
        let (control, _) = mean(halos.iter().map(|halo| halo.controls[which][k]));
        (control.value / control.sigma).powi(2)
    };
    let beside = at_most((0..HALO_CONTROLS).map(square).sum::<f64>() / HALO_CONTROLS as f64, HALO_CONTROLS);
    let inflation = beside.max(scatter).max(1.0).sqrt();
    let half = |odd: usize| mean(own.clone().skip(odd).step_by(2)).0;
    let [one, other] = [half(0), half(1)];
    let is_shown = |half: Estimate| half.value / (half.sigma * inflation) > HALF_SHOWS;
    let ratio = one.value / other.value;
    let agrees = is_shown(one) && is_shown(other) && ratio > HALF_SHARE && ratio < HALF_SHARE.recip();
    let size = Estimate { value: all.value, sigma: all.sigma * inflation };
    let surprise = if size.value > 0.0 { neg_ln_chi2_sf(1.0, (size.value / size.sigma).powi(2)) } else { 0.0 };
    (size, surprise, agrees)
}

/// What the sky about bright stars shows; `other_tests`: how many are made beside these.
pub(super) fn halo(frames: &[ElsewhereFrame], other_tests: usize) -> Counted {
    let halos: Vec<&FrameHalo> = frames.iter().filter_map(|frame| frame.halo.as_ref()).collect();
    let best = (0..HALO_RADII_PX.len()).map(|which| (which, of_radius(&halos, which))).max_by(|a, b| a.1.1.total_cmp(&b.1.1));
    let (Some((which, (size, surprise, agrees))), Some(frame)) = (best.filter(|_| halos.len() >= MIN_FRAMES), frames.first()) else {
        return Counted::untold(ID, Channel::Background, "too few frames with stars and sky");
    };
    let radius_px = HALO_RADII_PX[which];
    let per_share = halo_share(radius_px, frame.size_px[0].max(frame.size_px[1]) as f64);
    let [share, sigma] = [size.value, size.sigma].map(|value| value * per_share);
    let surprise = (surprise - ((TESTS + other_tests) as f64).ln()).clamp(0.0, MAX_SURPRISE);
    let sentence = format!(
        "{} of the light of bright stars lies in halos about them, half as bright {radius_px:.0} px away as in the middle: light that the lens scatters.",
        told(share, sigma)
    );
    let parameters = vec![("share", share, sigma, ""), ("radius_px", radius_px, 0.0, "px")];
    let own = Counted::of_stars(ID, Channel::Background, parameters, surprise, "flux", sentence);
    if agrees { own } else { own.withheld("halves of the frames do not show the same") }
}

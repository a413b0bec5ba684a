//! What single frames show and others do not: an exposure that is not as declared, clouds, and a camera that moved.
//!
//! Every frame has a zero point of its own in the fit of the stars, and so the fit is not changed by a frame that is dimmer: here the zero points are held
//! against each other. An exposure time that is wrong scales stars and sky alike; clouds take the light of stars alone.

use super::bouguer_line::{beside_the_others, extinction};
use super::counted::{Counted, MAX_SURPRISE};
use super::frame_levels::{Air, Level, Steady, TestedFrame, levels};
use super::frame_motion::moved;
use super::judge::Judged;
use super::zero_point_scatter::scattered;
use crate::diagnose::causes::{CLOUDS, EXPOSURE_TIME, EXTINCTION, MOTION_SMEAR, ZERO_POINT};
use crate::diagnose::channels::Channel;
use crate::pixel_statistics::PixelStatistics;
use crate::statistics::mad_sigma;
use crate::statistics::significance::neg_ln_chi2_sf;

/// Fewer frames tell nothing of one among them.
const MIN_FRAMES: usize = 5;
/// Stars and sky differ by the same factor within this share of it.
const SAME_SHARE: f64 = 0.25;

/// All that single frames show; `bias_dn`: the counts of no light, `tested`: the frames that are tested, in the order of their places.
pub(super) fn single_frames(
    judged: &Judged,
    pixels: Option<&PixelStatistics>,
    air: &Air,
    bias_dn: Option<f64>,
    tested: &[TestedFrame],
) -> Vec<Counted> {
    let mut all: Vec<Counted> = Vec::new();
    let levels = levels(&judged.rows, judged.standing(), pixels, (bias_dn, air), tested);
    if levels.len() >= MIN_FRAMES {
        let steady = Steady::under(air);
        // A frame that looks through more air is fainter than the others, and no other frame than they.
        all.extend(uneven(&if air.is_there { beside_the_others(&levels) } else { levels.clone() }, steady));
        // Where none stands out all may scatter.
        let all_scatter = if all.iter().any(Counted::is_found) { None } else { scattered(&levels, steady) };
        // Where the stars propose it within the frames they size it.
        let is_proposed = judged.proposed.iter().any(|own| judged.rows.questions[own.question].id == EXTINCTION);
        all.extend(if air.is_there && !is_proposed { extinction(&levels) } else { None });
        if let Some(own) = all_scatter.filter(Counted::is_found) {
            all.retain(|other| other.id() != own.id());
            all.push(own);
        }
    } else {
        let reason = if tested.iter().all(|frame| frame.exposure_s.is_none()) {
            "no exposure time is known: frames that are brighter or fainter may have been exposed for longer or shorter".to_owned()
        } else {
            format!("it needs {MIN_FRAMES} frames whose exposure times are known and whose zero points the stars tell")
        };
        all.extend([EXPOSURE_TIME, CLOUDS, ZERO_POINT].map(|id| Counted::untold(id, Channel::Flux, reason.clone())));
    }
    // Where the declared rates tell it the frames by themselves need not.
    let is_told = judged.proposed.iter().any(|own| own.against.is_empty() && judged.rows.questions[own.question].id == MOTION_SMEAR);
    all.extend(if is_told { None } else { moved(judged) });
    all
}

/// Frames whose zero points lie off those of the others.
fn uneven(levels: &[Level], steady: Steady) -> Vec<Counted> {
    let scatter = |values: Vec<f64>| mad_sigma(&values).unwrap_or(0.0);
    let floor = scatter(levels.iter().map(|level| level.stars).collect()).max(steady.scatter_mag);
    let sky_scatter = scatter(levels.iter().filter_map(|level| level.sky).collect());
    let surprise = |level: &Level| {
        let sigma = floor.hypot(level.sigma);
        // One of so many frames.
        (neg_ln_chi2_sf(1.0, (level.stars / sigma).powi(2)) - (levels.len() as f64).ln()).clamp(0.0, MAX_SURPRISE)
    };
    let is_off = |level: &&Level| level.stars.abs() > steady.least_mag && Counted::is_surprising(surprise(level));
    // Where the sky of the frames differs by more than the stars do it tells nothing.
    let is_sky_told = |level: &Level| level.sky.filter(|_| sky_scatter < 0.5 * level.stars.abs());
    let is_exposure = |level: &Level| match is_sky_told(level) {
        Some(sky) => (sky - level.stars).abs() < SAME_SHARE * level.stars.abs() + 2.0 * sky_scatter.min(floor),
        // No sky is clearer than clear, and in space nothing is.
        None => level.stars < 0.0 || !steady.has_clouds,
    };
    let mut all = Vec::new();
    let off: Vec<&Level> = levels.iter().filter(is_off).collect();
    let of = |id: &'static str| -> Vec<&Level> {
        let own = |level: &&&Level| match (is_exposure(level), level.stars > 0.0) {
            (true, _) => id == EXPOSURE_TIME,
            (false, true) if steady.has_clouds => id == CLOUDS,
            (false, _) => id == ZERO_POINT,
        };
        off.iter().filter(own).copied().collect()
    };
    for (id, what) in [
        (EXPOSURE_TIME, "the light of the stars: they were exposed otherwise than declared"),
        (CLOUDS, "the light of the stars, as clouds or dew do"),
        (ZERO_POINT, "the light of the stars, and not of the sky"),
    ] {
        let own = of(id);
        let Some(most) = own.iter().max_by(|a, b| a.stars.abs().total_cmp(&b.stars.abs())) else {
            all.push(if id == CLOUDS && !steady.has_clouds {
                Counted::untold(id, Channel::Flux, "there are no clouds where there is no air")
            } else {
                Counted::of_stars(id, Channel::Flux, Vec::new(), 0.0, "frame", String::new())
            });
            continue;
        };
        let ratio = 10.0_f64.powf(-0.4 * most.stars);
        let sigma = floor.hypot(most.sigma);
        let parameter =
            if id == EXPOSURE_TIME { ("relative", ratio - 1.0, ratio * sigma / 1.086, "") } else { ("mag", most.stars, sigma, "mag") };
        let frames = own.iter().map(|level| level.frame.to_string()).collect::<Vec<_>>().join(", ");
        let alike: &[&'static str] = match (own.iter().all(|level| is_sky_told(level).is_some()), id) {
            (true, CLOUDS) => &[ZERO_POINT],
            (true, _) => &[],
            (false, CLOUDS) => &[EXPOSURE_TIME, ZERO_POINT],
            (false, _) => &[ZERO_POINT],
        };
        let counted = Counted::of_stars(
            id,
            Channel::Flux,
            vec![parameter, ("frames", own.len() as f64, 0.0, "")],
            own.iter().map(|level| surprise(level)).fold(0.0, f64::max),
            "frame",
            format!("Frames {frames} (numbered from 0) differ from the others by up to {:.2} mag in {what}.", most.stars.abs()),
        );
        all.push(counted.or(alike));
    }
    all
}

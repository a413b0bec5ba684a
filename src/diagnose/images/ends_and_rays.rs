//! The round end of the field, cosmic rays and streaks, as they are told: all are counted in all frames together.

use super::counted::{Counted, MAX_SURPRISE, poisson_surprise};
use crate::diagnose::causes::{COSMIC_RAYS, STREAKS};
use crate::diagnose::channels::Channel;
use crate::effects::optics::field_stop;
use crate::effects::pixel::PixelEffect;
use crate::pixel_statistics::{MIN_RAY_FRAMES, MIN_STAR_SIGMA_PX, MIN_STOP_FRAMES, MIN_STREAK_FRAMES, PixelStatistics, Streak};

/// Cosmic rays by chance in a frame, at most: noise brings far fewer, pixels that jump once and are quiet ever after do not show what they are.
const EXPECTED_RAYS: f64 = 1e-2;
const FIELD_STOP: &str = <field_stop::FieldStop as PixelEffect>::ID;

/// Cosmic rays; blocks that a compression has rounded are sharp too.
pub(super) fn cosmic_rays(pixels: &PixelStatistics, is_compressed: bool) -> Counted {
    if is_compressed {
        return Counted::untold(COSMIC_RAYS, Channel::Noise, "the frames are compressed: rounding makes sharp pixels of its own");
    }
    let Some(rays) = &pixels.cosmic_rays else {
        let reason = if pixels.by_frame.len() < MIN_RAY_FRAMES {
            format!("fewer than {MIN_RAY_FRAMES} frames of one size do not tell them from hot pixels")
        } else {
            format!(
                "no star is measured, stars are as sharp as cosmic rays (narrower than {MIN_STAR_SIGMA_PX} px), or the pixels are a mosaic of colours"
            )
        };
        return Counted::untold(COSMIC_RAYS, Channel::Noise, reason);
    };
    let relative = (rays.count.max(1) as f64).sqrt().recip();
    let per_s = rays.per_s.map(|per_s| ("per_s", per_s, per_s * relative, "1/s"));
    let parameters: Vec<_> = per_s.into_iter().chain([("per_frame", rays.per_frame, rays.per_frame * relative, "")]).collect();
    let surprise = poisson_surprise(rays.count, EXPECTED_RAYS * rays.frames as f64);
    let rate = rays.per_s.map_or_else(String::new, |per_s| format!(", {per_s:.2} per second"));
    let sentence = format!(
        "{} flashes sharper than any star image show in one of {} frames alone, as cosmic rays do: {:.2} per frame{rate}.",
        rays.count, rays.frames, rays.per_frame
    );
    Counted::of_stars(COSMIC_RAYS, Channel::Noise, parameters, surprise, "frame", sentence)
}

/// Straight lines of light. Between blocks that a compression has rounded the noise hangs together over some blocks: shorter lines are its own.
pub(super) fn streaks(pixels: &PixelStatistics, is_compressed: bool) -> Counted {
    /// Lines by chance in a frame, at most, and lines that are summed in one, about.
    const EXPECTED: f64 = 1e-4;
    const LINES: f64 = 1e7;
    /// Places that are told.
    const LISTED: usize = 4;
    /// Blocks of a compression that a line is longer than, px.
    const BLOCKS_PX: f64 = 64.0;
    let Some(mut found) = pixels.streaks.clone() else {
        let reason = if pixels.by_frame.len() < MIN_STREAK_FRAMES {
            "one frame alone does not tell a streak from a line of the detector"
        } else {
            "the stars are drawn out themselves, or no sky is seen between them"
        };
        return Counted::untold(STREAKS, Channel::Background, reason);
    };
    if is_compressed {
        let all = found.count.max(1) as f64;
        found.found.retain(|own| own.length_px() > BLOCKS_PX);
        found.count = found.found.len();
        let share = found.count as f64 / all;
        (found.per_frame, found.per_s) = (share * found.per_frame, found.per_s.map(|per_s| share * per_s));
    }
    let relative = (found.count.max(1) as f64).sqrt().recip();
    let per_s = found.per_s.map(|per_s| ("per_s", per_s, per_s * relative, "1/s"));
    let parameters: Vec<_> = per_s.into_iter().chain([("per_frame", found.per_frame, found.per_frame * relative, "")]).collect();
    // By their number, or by the brightest alone: the tail of the normal distribution times the lines.
    let brightest = found.found.iter().map(|own| own.snr).fold(0.0, f64::max).max(1.0);
    let by_light = 0.5 * brightest * brightest + (brightest * std::f64::consts::TAU.sqrt()).ln() - (LINES * found.frames as f64).ln();
    let surprise = poisson_surprise(found.count, EXPECTED * found.frames as f64).max(by_light.clamp(0.0, MAX_SURPRISE));
    let longest = found.found.iter().map(Streak::length_px).fold(0.0, f64::max);
    let frames: std::collections::BTreeSet<usize> = found.found.iter().map(|own| own.frame).collect();
    let place = |own: &Streak| {
        let [from, to] = [own.start_px, own.end_px].map(|[x, y]| format!("({x:.0}, {y:.0})"));
        format!("frame {} from {from} to {to} px", own.frame)
    };
    let listed: Vec<String> = found.found.iter().take(LISTED).map(place).collect();
    let sentence = format!(
        "{} straight line{} of light, up to {longest:.0} px long, in {} of {} frames, as satellites, meteors and aircraft leave them: {}{}.",
        found.count,
        if found.count == 1 { "" } else { "s" },
        frames.len(),
        found.frames,
        listed.join("; "),
        if found.count > LISTED { "; …" } else { "" }
    );
    Counted::of_stars(STREAKS, Channel::Background, parameters, surprise, "frame", sentence)
}

/// A round end of the field.
pub(super) fn field_stop(pixels: &PixelStatistics) -> Counted {
    let Some(stop) = &pixels.field_stop else {
        if pixels.by_frame.len() < MIN_STOP_FRAMES {
            let reason = format!("fewer than {MIN_STOP_FRAMES} frames do not tell a stop from the sky");
            return Counted::untold(FIELD_STOP, Channel::Background, reason);
        }
        return Counted::of_stars(FIELD_STOP, Channel::Background, Vec::new(), 0.0, "field-radius", String::new());
    };
    let [right, down] = stop.off_middle_px();
    let sigma = stop.radius_sigma_px;
    let parameters = vec![
        ("radius_px", stop.radius_px, sigma, "px"),
        ("edge_px", stop.edge_px, 0.0, "px"),
        ("centre_x_px", right, 0.0, "px"),
        ("centre_y_px", down, 0.0, "px"),
    ];
    let surprise = (0.5 * stop.deviation * stop.deviation).min(MAX_SURPRISE);
    let sentence = format!(
        "The field ends at a circle with a radius of {:.1} ± {:.1} px; beyond it no light arrives, and nothing is measured there.",
        stop.radius_px,
        sigma.max(0.05)
    );
    Counted::of_stars(FIELD_STOP, Channel::Background, parameters, surprise, "field-radius", sentence)
}

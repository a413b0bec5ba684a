//! What single frames show and others do not: an exposure that is not as declared, clouds, and a camera that moved.
//!
//! Every frame has a zero point of its own in the fit of the stars, and so the fit is not changed by a frame that is dimmer: here the zero points are held
//! against each other. An exposure time that is wrong scales stars and sky alike; clouds take the light of stars alone. A uniform
//! motion of length L widens images along its direction by L²/12 (the variance of a box), so that what it adds to their elongation it adds to their
//! size: (xx + yy)/2 by L²/24, (xx − yy)/2 and xy by L²/24 times cosine and sine of twice its angle.

use std::collections::BTreeMap;

use super::counted::{Counted, MAX_SURPRISE};
use super::frame_levels::{Air, Level, Steady, TestedFrame, levels};
use super::judge::Judged;
use super::rows::Kind;
use super::stars::{DIAGONAL, ELONGATION, SIZE};
use super::zero_point_scatter::scattered;
use crate::diagnose::causes::{CLOUDS, EXPOSURE_TIME, MOTION_SMEAR, ZERO_POINT};
use crate::diagnose::channels::Channel;
use crate::pixel_statistics::PixelStatistics;
use crate::statistics::significance::neg_ln_chi2_sf;
use crate::statistics::{mad_sigma, median};

/// Fewer frames tell nothing of one among them.
const MIN_FRAMES: usize = 5;
/// Stars and sky differ by the same factor within this share of it.
const SAME_SHARE: f64 = 0.25;
/// Of what is added to the elongation by a motion so much at least is added to the size, and so much at most.
const SMEAR_SLOPE: [f64; 2] = [0.4, 1.6];
/// Both halves of the stars agree by so many standard deviations of the products of their means: blended images scatter far out.
const AGREES: f64 = 8.0;
/// Frames have stars on both sides, for what one half shows is held against the other.
const MIN_STARS: usize = 5;

/// All that single frames show; `bias_dn`: the counts of no light, `tested`: the frames that are tested, in the order of their places.
pub(super) fn single_frames(
    judged: &Judged,
    pixels: Option<&PixelStatistics>,
    air: &Air,
    bias_dn: Option<f64>,
    tested: &[TestedFrame],
) -> Vec<Counted> {
    let mut all: Vec<Counted> = Vec::new();
    let levels = levels(judged, pixels, (bias_dn, &air.mass_of_frame), tested);
    if levels.len() >= MIN_FRAMES {
        let steady = Steady::under(air);
        all.extend(uneven(&levels, steady));
        // Where none stands out all may scatter.
        let all_scatter = if all.iter().any(Counted::is_found) { None } else { scattered(&levels, steady) };
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
    all.extend(if is_told { None } else { smeared(judged) });
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

/// Mean residuals of a kind's rows by frame, of the stars of each half: value and variance.
fn means(judged: &Judged, name: &str) -> Option<BTreeMap<usize, [[f64; 2]; 2]>> {
    let number = judged.rows.kinds.iter().position(|kind| kind.name == name)?;
    let (kind, range): (&Kind, _) = (&judged.rows.kinds[number], judged.rows.ranges()[number].clone());
    let mut sums: BTreeMap<usize, [[f64; 3]; 2]> = BTreeMap::new();
    for (row, k) in kind.rows.iter().zip(range).filter(|(_, k)| judged.fit.take[*k]) {
        let weight = judged.fit.noise[number].variance(row).recip();
        let half = &mut sums.entry(row.frame).or_default()[(row.star.wrapping_mul(0x9e37_79b9) >> 9) % 2];
        *half = [half[0] + weight * judged.fit.rest[k], half[1] + weight, half[2] + 1.0];
    }
    let is_told = |halves: &[[f64; 3]; 2]| halves.iter().all(|half| half[2] >= MIN_STARS as f64);
    Some(
        sums.into_iter()
            .filter(|(_, halves)| is_told(halves))
            .map(|(frame, halves)| (frame, halves.map(|[sum, weight, _]| [sum / weight, weight.recip()])))
            .collect(),
    )
}

/// Elongations that change from frame to frame and that both halves of the stars show alike.
fn smeared(judged: &Judged) -> Option<Counted> {
    let [size, along, diagonal] = [SIZE, ELONGATION, DIAGONAL].map(|name| means(judged, name));
    let (size, along, diagonal) = (size?, along?, diagonal?);
    let frames: Vec<usize> = along.keys().copied().filter(|frame| size.contains_key(frame) && diagonal.contains_key(frame)).collect();
    if frames.len() < MIN_FRAMES {
        return None;
    }
    // What all frames have in common is the image.
    let centred = |own: &BTreeMap<usize, [[f64; 2]; 2]>| -> Vec<[[f64; 2]; 2]> {
        let all: Vec<[[f64; 2]; 2]> = frames.iter().map(|frame| own[frame]).collect();
        let middle = [0, 1].map(|half| median(&all.iter().map(|halves| halves[half][0]).collect::<Vec<_>>()).unwrap_or(0.0));
        all.into_iter().map(|halves| [0, 1].map(|half| [halves[half][0] - middle[half], halves[half][1]])).collect()
    };
    let (size, along, diagonal) = (centred(&size), centred(&along), centred(&diagonal));
    let joined = |[a, b]: [[f64; 2]; 2]| {
        let weight = a[1].recip() + b[1].recip();
        [(a[0] / a[1] + b[0] / b[1]) / weight, weight.recip()]
    };
    let mut statistic = 0.0;
    let mut agreement = [0.0; 2];
    let (mut sizes, mut lengths) = (Vec::new(), Vec::new());
    for k in 0..frames.len() {
        let ([s, s_variance], [e, e_variance], [d, d_variance]) = (joined(size[k]), joined(along[k]), joined(diagonal[k]));
        statistic += e * e / e_variance + d * d / d_variance;
        for halves in [along[k], diagonal[k]] {
            let variance = halves[0][1] * halves[1][1];
            agreement = [agreement[0] + halves[0][0] * halves[1][0] / variance.sqrt(), agreement[1] + 1.0];
        }
        let strength = (e * e + d * d - e_variance - d_variance).max(0.0).sqrt();
        sizes.push([strength, s, s_variance.recip()]);
        lengths.push((24.0 * strength).sqrt());
    }
    // The scatter of products of two normal numbers is one each.
    let held_out_sigmas = agreement[0] / f64::sqrt(agreement[1]);
    // Means take one from every number.
    let degrees = 2.0 * (frames.len() as f64 - 1.0);
    let surprise = neg_ln_chi2_sf(degrees, statistic).min(MAX_SURPRISE);
    let slope = slope(&sizes);
    let is_motion = held_out_sigmas > AGREES && slope > SMEAR_SLOPE[0] && slope < SMEAR_SLOPE[1];
    let rms = (lengths.iter().map(|length| length * length).sum::<f64>() / lengths.len() as f64).sqrt();
    let error = rms / (2.0 * statistic.max(1.0)).sqrt();
    is_motion.then(|| {
        Counted::of_stars(
            MOTION_SMEAR,
            Channel::Shape,
            vec![("length_px", rms, error, "px")],
            surprise,
            "frame",
            format!("Images are drawn out by {rms:.2} px (rms over the frames), in every frame along a direction of its own, and are wider by as much: the camera moved."),
        )
    })
}

/// Slope of a line through points (x, y, weight); 0 where all x are the same.
fn slope(points: &[[f64; 3]]) -> f64 {
    let sum = |of: &dyn Fn(&[f64; 3]) -> f64| points.iter().map(|point| point[2] * of(point)).sum::<f64>();
    let weight = sum(&|_| 1.0);
    let [x, y] = [sum(&|point| point[0]) / weight, sum(&|point| point[1]) / weight];
    let square = sum(&|point| (point[0] - x).powi(2));
    if square > 0.0 { sum(&|point| (point[0] - x) * (point[1] - y)) / square } else { 0.0 }
}

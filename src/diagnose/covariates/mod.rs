//! Covariates of star images, and the patterns of residuals that are tested for each.
//!
//! A covariate that belongs to a star image (its colour, its place) multiplies simple vector fields over the frame (a shift, and the four
//! linear fields); one that belongs to a frame (its temperature) multiplies what the frame's attitude leaves of them. Each is tried twice,
//! in proportion to the covariate and in bins of equal counts, so that laws of any shape are seen.

mod covariate;
mod frames;
mod patterns;
mod places;
mod stars;

pub(super) use covariate::{Covariate, Separated};

use self::covariate::Fields;
use super::options::Telemetry;
use super::star_images::{REACH_PX, StarImages, WITHIN_REACH_PX};
use crate::calibrate::BundleSolution;
use crate::effects::DISPLACEMENTS;
use crate::identify::ControlPoints;

/// All that the recording has.
pub(super) fn covariates(joint: &BundleSolution, stars: &StarImages, points: &ControlPoints, telemetry: &Telemetry) -> Vec<Covariate> {
    let camera = joint.model().camera();
    let (width, height) = (camera.width_px as f64, camera.height_px as f64);
    let pixels: Vec<[f64; 2]> = stars.predicted_px(REACH_PX).collect();
    let within: Vec<[f64; 2]> = stars.predicted_px(WITHIN_REACH_PX).collect();
    let half = width / 2.0;
    let place = pixels.iter().map(|[x, y]| [(x - (width - 1.0) / 2.0) / half, (y - (height - 1.0) / 2.0) / half]).collect();
    let fields = Fields { place };
    let star = |value: &dyn Fn(usize) -> Option<f64>| -> Vec<f64> { (0..pixels.len()).map(|k| value(k).unwrap_or(f64::NAN)).collect() };
    let point = |k: usize| &points.points[stars.images[k].point];
    let mut all = places::places(&fields, &pixels, &within, [width, height]);
    all.push(places::map(&fields, stars));
    for (name, values) in [
        ("colour", star(&|k| point(k).colour)),
        ("magnitude", star(&|k| point(k).image.magnitude.or(Some(point(k).magnitude)).filter(|m| *m < 50.0))),
        ("flux", star(&|k| point(k).image.flux_e.or_else(|| Some(10.0_f64.powf(-0.4 * point(k).magnitude)).filter(|f| *f > 1e-20)))),
    ] {
        let name = name.to_owned();
        all.extend(stars::of_star(name, values, &fields));
    }
    let observation = |place: usize| &stars.frames[place].1;
    let number = |place: usize| stars.frames[place].0;
    let frame = |value: &dyn Fn(usize) -> Option<f64>| -> Vec<f64> {
        (0..stars.frames.len()).map(|place| value(place).unwrap_or(f64::NAN)).collect()
    };
    let mut of_frames: Vec<(String, Vec<f64>)> = vec![
        ("time".to_owned(), frame(&|place| observation(place).time_offset_h)),
        ("frame".to_owned(), frame(&|place| Some(number(place) as f64))),
        ("exposure".to_owned(), frame(&|place| observation(place).exposure_s)),
        ("temperature".to_owned(), frame(&|place| observation(place).temperature_offset_k)),
    ];
    let names: std::collections::BTreeSet<&String> = telemetry.iter().flat_map(|frame| frame.keys()).collect();
    for name in names.into_iter().filter(|name| !matches!(name.as_str(), "temperature" | "exposure" | "time" | "frame")) {
        of_frames.push((name.clone(), frame(&|place| telemetry.get(number(place))?.get(name).copied())));
    }
    for (name, numbers) in of_frames {
        all.extend(frames::of_frame(name, &numbers, stars, &fields));
    }
    if let Some(own) = all.iter_mut().find(|covariate| covariate.name == "frame") {
        own.patterns.extend(frames::single_frames(stars, &fields));
    }
    all.extend(frames::rate(stars, &fields));
    all.extend(stars::background_gradient(stars, points, &fields));
    all.extend(frames::velocity(joint, stars, &fields));
    let mut along: Vec<_> = DISPLACEMENTS.iter().filter_map(|effect| Some((effect.facts().covariate?, effect.id()))).collect();
    along.sort_unstable_by(|a, b| b.cmp(a)); // one order, whatever that of the registry
    for (name, id) in along {
        all.extend(stars::along(name, id, joint, stars, points, &fields));
    }
    all.extend(stars::stars(stars));
    all.retain(|covariate| !covariate.patterns.is_empty());
    all
}

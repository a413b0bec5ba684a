//! Random sample consensus with local optimisation (Fischler and Bolles 1981; Chum, Matas and Kittler 2003).
//!
//! 1. A sample is three stars of one frame or three each of two frames: it gives their attitudes, the focal length and k1 (the
//!    other parameters stay at their nominal values). A sample whose own residuals exceed the threshold is dropped.
//! 2. Every frame gets an attitude under that camera: pairs of stars whose angle agrees are tried, and the attitude that most
//!    stars agree with is kept and refined on these.
//! 3. The score is that of MSAC: Σ min(r²/t², 1), t = 3σ with the true σ of the measurements.
//! 4. Whenever a sample is the best so far, all parameters and attitudes are adjusted to its inliers, with a threshold that falls
//!    from 4t to t; the result takes its place if its score is better.
//! 5. In the end the inliers are adjusted and chosen anew until they stay the same.

use boresight::camera::{Camera, PARAMETER_COUNT};
use nalgebra::{UnitQuaternion, Vector3};
use rand::seq::index;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::adjust::{Adjusted, Star, adjust, residual_px, wahba};

const SAMPLES: usize = 600;
/// Stars that a sample takes from a frame.
const FROM_FRAME: usize = 3;
/// The threshold in σ.
const THRESHOLD_SIGMA: f64 = 3.0;
/// What a sample solves besides attitudes: f and k1.
const OF_SAMPLE: [bool; PARAMETER_COUNT] = [false, false, true, true, false, false];
const ALL: [bool; PARAMETER_COUNT] = [true; PARAMETER_COUNT];
/// With fewer inliers than this, local optimisation solves what a sample does.
const FEW_INLIERS: usize = 20;
/// Thresholds of the local optimisation, times the final one.
const LOOSER: [f64; 6] = [4.0, 3.0, 2.0, 1.5, 1.0, 1.0];
/// A sample's focal length may differ from the nominal one by this share, its distortion move a corner by this share of its distance.
const PLAUSIBLE: f64 = 0.2;
/// Pairs whose angle agrees that are tried for a frame's attitude.
const PAIRS_TRIED: usize = 12;
/// Last adjustments at most.
const LAST_ROUNDS: usize = 20;

/// A camera with the attitudes under which the stars agree with it.
#[derive(Clone, Debug)]
struct Hypothesis {
    model: Adjusted,
    score: f64,
}

/// The camera; `None` if no sample leads to one. `sigma_px`: the true error of a position per axis.
pub(crate) fn solve(frames: &[Vec<Star>], start: &Camera, sigma_px: f64, seed: u64) -> Option<Camera> {
    let threshold_px = THRESHOLD_SIGMA * sigma_px;
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let eligible: Vec<usize> = (0..frames.len()).filter(|frame| frames[*frame].len() >= FROM_FRAME).collect();
    if eligible.len() < 2 {
        return None;
    }
    let mut best: Option<Hypothesis> = None;
    for sample in 0..SAMPLES {
        // Two of three samples lie within a frame: three stars are more often all right than six.
        let count = if sample % 3 == 2 { 2 } else { 1 };
        let Some(camera) = sampled_camera(frames, &eligible, count, start, threshold_px, &mut rng) else { continue };
        let limit = best.as_ref().map_or(f64::INFINITY, |best| best.score);
        let Some(found) = with_attitudes(frames, camera, threshold_px, limit, &mut rng) else { continue };
        let optimised = locally_optimised(frames, &found, threshold_px, &mut rng);
        best = [Some(found), optimised, best].into_iter().flatten().min_by(|a, b| a.score.total_cmp(&b.score));
    }
    let mut model = best?.model;
    let mut inliers = agreeing(frames, &model, threshold_px);
    for _ in 0..LAST_ROUNDS {
        model = adjust(frames, &inliers, &model.camera, ALL)?;
        let now = agreeing(frames, &model, threshold_px);
        if now == inliers {
            break;
        }
        inliers = now;
    }
    Some(model.camera)
}

/// The camera of a random sample, if its stars agree with one.
fn sampled_camera(
    frames: &[Vec<Star>],
    eligible: &[usize],
    count: usize,
    start: &Camera,
    threshold_px: f64,
    rng: &mut Pcg64Mcg,
) -> Option<Camera> {
    let sample: Vec<Vec<Star>> = index::sample(rng, eligible.len(), count)
        .into_iter()
        .map(|frame| {
            let stars = &frames[eligible[frame]];
            index::sample(rng, stars.len(), FROM_FRAME).into_iter().map(|star| stars[star]).collect()
        })
        .collect();
    let used: Vec<Vec<bool>> = sample.iter().map(|stars: &Vec<Star>| vec![true; stars.len()]).collect();
    let model = adjust(&sample, &used, start, OF_SAMPLE)?;
    let camera = model.camera;
    let corner_px = (camera.width_px as f64).hypot(camera.height_px as f64) / 2.0;
    let plausible = (camera.focal_length_px / start.focal_length_px - 1.0).abs() < PLAUSIBLE
        && ((camera.k1 - start.k1) * corner_px * corner_px).abs() < PLAUSIBLE;
    let agrees = || agreeing(&sample, &model, threshold_px).iter().flatten().all(|agrees| *agrees);
    (plausible && agrees()).then_some(camera)
}

/// The camera with the best attitude of each frame; `None` once its score is above `limit`.
fn with_attitudes(frames: &[Vec<Star>], camera: Camera, threshold_px: f64, limit: f64, rng: &mut Pcg64Mcg) -> Option<Hypothesis> {
    let (mut attitudes, mut score) = (Vec::with_capacity(frames.len()), 0.0);
    for stars in frames {
        let seen: Vec<(Vector3<f64>, Vector3<f64>)> =
            stars.iter().map(|star| (Vector3::from(camera.direction(star.pixel).xyz), star.direction)).collect();
        let (attitude, own) = best_attitude(&seen, threshold_px / camera.focal_length_px, rng);
        attitudes.push(attitude);
        score += own;
        if score >= limit {
            return None;
        }
    }
    Some(Hypothesis { model: Adjusted { camera, attitudes }, score })
}

/// The attitude that most stars of a frame agree with, and its score.
fn best_attitude(seen: &[(Vector3<f64>, Vector3<f64>)], threshold_rad: f64, rng: &mut Pcg64Mcg) -> (Option<UnitQuaternion<f64>>, f64) {
    let mut best = (None, seen.len() as f64);
    let mut pairs: Vec<(usize, usize)> = (0..seen.len()).flat_map(|a| (a + 1..seen.len()).map(move |b| (a, b))).collect();
    let mut tried = 0;
    while tried < PAIRS_TRIED && !pairs.is_empty() {
        let (a, b) = pairs.swap_remove(rng.random_range(0..pairs.len()));
        let angle = |first: &Vector3<f64>, second: &Vector3<f64>| first.cross(second).norm().atan2(first.dot(second));
        if (angle(&seen[a].0, &seen[b].0) - angle(&seen[a].1, &seen[b].1)).abs() > 2.0 * threshold_rad {
            continue;
        }
        tried += 1;
        let Some(first) = wahba([seen[a], seen[b]].into_iter()) else { continue };
        // Refined on those that agree roughly: two close stars leave the roll open.
        let near = |rotation: &UnitQuaternion<f64>, factor: f64| {
            let rotation = *rotation;
            seen.iter().copied().filter(move |(w, v)| (w - rotation * v).norm() < factor * threshold_rad)
        };
        let second = wahba(near(&first, 2.0)).unwrap_or(first);
        for rotation in [first, second] {
            let score = seen.iter().map(|(w, v)| ((w - rotation * v).norm() / threshold_rad).powi(2).min(1.0)).sum();
            if score < best.1 {
                best = (Some(rotation), score);
            }
        }
    }
    best
}

/// All parameters and attitudes adjusted to the stars that agree, with a falling threshold.
fn locally_optimised(frames: &[Vec<Star>], found: &Hypothesis, threshold_px: f64, rng: &mut Pcg64Mcg) -> Option<Hypothesis> {
    let mut model = found.model.clone();
    for factor in LOOSER {
        let inliers = agreeing(frames, &model, factor * threshold_px);
        let few = inliers.iter().flatten().filter(|agrees| **agrees).count() < FEW_INLIERS;
        model = adjust(frames, &inliers, &model.camera, if few { OF_SAMPLE } else { ALL })?;
    }
    // Frames that the sample's camera could not orient may be oriented under the better one.
    let again = with_attitudes(frames, model.camera, threshold_px, f64::INFINITY, rng)?;
    let own = Hypothesis { score: score(frames, &model, threshold_px), model };
    Some(if again.score < own.score { again } else { own })
}

fn distances_px<'a>(frames: &'a [Vec<Star>], model: &'a Adjusted) -> impl Iterator<Item = Vec<f64>> + 'a {
    frames.iter().zip(&model.attitudes).map(|(stars, attitude)| {
        let distance = |star: &Star| Some(residual_px(&model.camera, attitude.as_ref()?, star)?.norm());
        stars.iter().map(|star| distance(star).unwrap_or(f64::INFINITY)).collect()
    })
}

fn agreeing(frames: &[Vec<Star>], model: &Adjusted, threshold_px: f64) -> Vec<Vec<bool>> {
    distances_px(frames, model).map(|stars| stars.into_iter().map(|distance| distance < threshold_px).collect()).collect()
}

fn score(frames: &[Vec<Star>], model: &Adjusted, threshold_px: f64) -> f64 {
    distances_px(frames, model).flatten().map(|distance| (distance / threshold_px).powi(2).min(1.0)).sum()
}

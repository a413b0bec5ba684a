//! Sequential update: new frames are solved with the earlier solutions as a prior; the star images of those are not needed any more.
//!
//! 1. The attitudes of the new frames, by consensus through the camera as it is known.
//! 2. The new frames nearly alone (what is known is widened a hundredfold): weights and noise that do not depend on whether the camera
//!    is still the same.
//! 3. With these weights held, the solution with what is known. How far it moves is the test of whether the camera has changed: with Λ
//!    the information known and N that of the new frames, the step has the covariance Λ⁻¹ − (Λ + N)⁻¹ if it has not.
//! 4. The weights let go again, to the end.
//!
//! Source: recursive least squares in information form (Bierman, Factorization Methods for Discrete Sequential Estimation, 1977); the test
//! is that of the innovations of a Kalman filter.

use nalgebra::DMatrix;

use super::change::{Change, test};
use super::consensus::{TOLERANCE, attitudes, fix_mount};
use super::known::{Known, WIDE, inverse, lost, of_parameters};
use super::memory::{Carried, NoiseMemory};
use super::{Adjusted, Attitudes, Noise, Problem, Run, State, mapping, names, pose, scales};
use crate::calibrate::geometry::GRID;
use crate::calibrate::lit::lit_grid;
use crate::calibrate::result::REJECTED_WEIGHT;
use crate::calibrate::select::Selection;
use crate::calibrate::{CalibrateError, CalibrateOptions};
use crate::camera::Model;
use crate::effects::{Segment, displacement};
use crate::identify::ControlPoints;

/// Star images may be off by as many standard errors when the attitudes are looked for.
const SIGMAS: f64 = 8.0;
/// The steps end this much earlier than those of a calibration do: a small step is what is tested.
const FINER: f64 = 1e-2;

/// What is known with the new frames.
#[derive(Clone, Debug)]
pub(in crate::calibrate) struct Updated {
    /// The camera.
    pub(in crate::calibrate) model: Model,
    /// Information on the free parameters for unit weight, in their own units.
    pub(in crate::calibrate) information: DMatrix<f64>,
    /// The noise.
    pub(in crate::calibrate) noise: Noise,
    /// The new star images.
    pub(in crate::calibrate) memory: NoiseMemory,
    /// By how much the squares of the new images stand for those of all, whose residuals have changed too.
    pub(in crate::calibrate) squares: f64,
    /// The test.
    pub(in crate::calibrate) change: Change,
    /// Whether the last step was small enough.
    pub(in crate::calibrate) converged: bool,
    /// Frames that took part.
    pub(in crate::calibrate) frames: usize,
    /// Star images used.
    pub(in crate::calibrate) stars: usize,
    /// 2-D rms of those used.
    pub(in crate::calibrate) rms_px: Option<f64>,
    /// What to mind.
    pub(in crate::calibrate) notes: Vec<String>,
}

/// Solves the new frames with what is known.
pub(in crate::calibrate) fn update(
    points: &ControlPoints,
    options: &CalibrateOptions,
    selection: &Selection,
    known: &Known,
) -> Result<Updated, CalibrateError> {
    let (mut problem, mut notes) = pose_again(points, options, selection, known)?;
    let values = problem.model.values();
    let carried = Carried { values: problem.free.iter().map(|index| values[*index]).collect(), information: known.information.clone() };
    let (state, noise) = begin(&mut problem, points, known, &mut notes)?;
    let scale: Vec<f64> = scales(&problem, &state)
        .into_iter()
        .enumerate()
        // A parameter that these frames do not see at all is as large as it is known.
        .map(|(k, scale)| if scale.is_finite() && scale > 0.0 { scale } else { known.information[(k, k)].sqrt() })
        .collect();
    let run = Run { epsilon_px: FINER * options.epsilon_px, max_turns: options.max_iterations, from_afar: false, hold_noise: false };
    let at_floor = |noise: &Noise, factor: f64| {
        let factor = factor * known.memory.information_factor(known.floor_px2, noise.floor_px2);
        Some(Carried { values: carried.values.clone(), information: &carried.information * factor })
    };
    problem.carried = Some(Carried { values: carried.values.clone(), information: &carried.information * WIDE });
    let alone = problem.adjust(state, noise, &scale, &run, None);
    problem.carried = at_floor(&alone.noise, 1.0);
    let held = problem.adjust(alone.state.clone(), alone.noise.clone(), &scale, &run, Some(&alone.weights));
    let change = test(&mut problem, known, &alone, &held, &scale).ok_or_else(|| singular(known))?;
    // What the floor is depends on the camera, and how much the earlier images count on the floor.
    let first = problem.adjust(held.state, held.noise, &scale, &run, None);
    problem.carried = at_floor(&first.noise, 1.0);
    let run = Run { epsilon_px: options.epsilon_px, hold_noise: true, ..run };
    let last = problem.adjust(first.state, first.noise, &scale, &run, None);
    problem.model.set_values(&last.state.values);
    let penalty = problem.carried.as_ref().map_or(0.0, |carried| carried.cost(&problem.free, &last.state.values));
    let active = last.weights.iter().filter(|weights| weights.iter().any(|weight| *weight > REJECTED_WEIGHT)).count();
    let (memory, stars, rms_px) = remember(&problem, &last, active);
    Ok(Updated {
        information: of_parameters(&last.information, problem.free.len(), &scale).ok_or_else(|| singular(known))?,
        squares: 1.0 + penalty / last.chi_squared.max(f64::MIN_POSITIVE),
        change,
        converged: last.converged,
        frames: active,
        stars,
        rms_px,
        notes,
        memory,
        noise: last.noise,
        model: problem.model,
    })
}

fn singular(known: &Known) -> CalibrateError {
    CalibrateError::Singular { combination: known.names.join(", ") }
}

/// The problem of the new frames, with the camera as it is known.
fn pose_again(
    points: &ControlPoints,
    options: &CalibrateOptions,
    selection: &Selection,
    known: &Known,
) -> Result<(Problem, Vec<String>), CalibrateError> {
    let is_sky = |id: &str| displacement(id).is_some_and(|effect| effect.segment() == Segment::Sky);
    let terms = known.model.terms().filter(|(id, _)| !is_sky(id));
    let again = CalibrateOptions {
        solve: known.names.to_vec(),
        terms: terms.map(|(id, parameters)| crate::camera::Term { effect: id.to_owned(), parameters: parameters.to_vec() }).collect(),
        projection: known.model.projection().to_owned(),
        priors: Vec::new(),
        ..options.clone()
    };
    let (mut problem, notes) = pose(points, &again, selection)?;
    let (posed, held) = (problem.model.parameters(), known.model.parameters());
    let differs = held.iter().map(|p| &p.name).find(|name| posed.iter().all(|other| other.name != **name));
    let differs = differs.or_else(|| posed.iter().map(|p| &p.name).find(|name| held.iter().all(|other| other.name != **name)));
    if let Some(name) = differs {
        return Err(CalibrateError::NotSolvable {
            name: name.clone(),
            reason: "it belongs to the model of the earlier frames or of the new ones, but not of both; use the same --physics and catalogue for all".to_owned(),
        });
    }
    if names(&problem) != known.names {
        return Err(CalibrateError::NotSolvable {
            name: known.names.join(", "),
            reason: "the free parameters are named twice or not in the model's order".to_owned(),
        });
    }
    let mut values = problem.model.values();
    let known_values = known.model.values();
    for (k, parameter) in posed.iter().enumerate() {
        // What is known of the sky is known of these frames, not of the earlier ones.
        if problem.free.contains(&k) || !is_sky(parameter.effect) {
            let place = held.iter().position(|other| other.name == parameter.name);
            values[k] = place.map_or(values[k], |place| known_values[place]);
        }
    }
    problem.model.set_values(&values);
    Ok((problem, notes))
}

/// Attitudes of the new frames, and the noise to begin with: wide enough for what is not known of the camera.
fn begin(problem: &mut Problem, points: &ControlPoints, known: &Known, notes: &mut Vec<String>) -> Result<(State, Noise), CalibrateError> {
    let values = problem.model.values();
    let camera = problem.model.camera();
    let (f, diagonal_px) = (camera.focal_length_px, (camera.width_px as f64).hypot(camera.height_px as f64));
    let images = problem.exposures.iter().flat_map(|exposure| &exposure.images);
    let stated = images.map(|image| f64::midpoint(image.covariance_px2[0], image.covariance_px2[2])).sum::<f64>();
    let stated = stated / problem.image_count().max(1) as f64;
    let covariance = inverse(&known.information).ok_or_else(|| singular(known))?;
    let grid = lit_grid(problem.model.camera(), problem.lit.as_ref(), GRID);
    let map = mapping::map_sigma_px(&problem.model, &values, &problem.free, &covariance, &grid).ok_or(CalibrateError::NominalFolds)?;
    let map_px2 = map.into_iter().map(|(_, sigma)| sigma * sigma).fold(0.0, f64::max);
    let mut tolerance_px = (SIGMAS * (stated + known.floor_px2 + map_px2).sqrt()).max(0.5);
    let (mut found, agreeing) = attitudes(problem, tolerance_px / f);
    if 5 * agreeing < 2 * problem.image_count() {
        let wide_px = (TOLERANCE * diagonal_px).max(3.0 * tolerance_px);
        let wide = attitudes(problem, wide_px / f);
        if 2 * wide.1 > 3 * agreeing {
            (found, tolerance_px) = (wide.0, wide_px);
        }
    }
    for (attitude, exposure) in found.iter_mut().zip(&problem.exposures) {
        if attitude.is_none() {
            *attitude = points.attitudes.get(exposure.frame).copied().flatten().map(|attitude| attitude.camera_from_icrs);
        }
    }
    let lost = found.iter().filter(|attitude| attitude.is_none()).count();
    if lost == found.len() {
        return Err(CalibrateError::NoConsensus { images: problem.image_count(), frames: problem.exposures.len() });
    }
    if lost > 0 {
        notes.push(format!("{lost} frames take no part: no three of their star images agree on an attitude"));
    }
    let count = found.len();
    let mut state = State { values, rates: vec![[0.0; 3]; count], mount: nalgebra::UnitQuaternion::identity(), attitudes: found };
    if problem.attitudes == Attitudes::FixedToEarth && !fix_mount(problem, &mut state, 3.0 * tolerance_px / f) {
        notes.push("the mount is said to be fixed, but the attitudes do not fit one place on the turning Earth: each frame has an attitude of its own".to_owned());
        problem.attitudes = Attitudes::Free;
    }
    let noise = Noise {
        floor_px2: (tolerance_px / 3.0).powi(2).max(known.floor_px2),
        wrong_share: 0.3,
        wrong_radius_px: known.wrong_radius_px.max(2.0 * tolerance_px),
        frame_factors: vec![1.0; count],
        focal_length_px: f,
        before: known.memory.clone(),
        unit_variance: 1.0,
    };
    Ok((state, noise))
}

/// Sums over the new star images at the solution, how many were used, and their 2-D rms.
fn remember(problem: &Problem, last: &Adjusted, active: usize) -> (NoiseMemory, usize, Option<f64>) {
    let mut memory = NoiseMemory::default();
    let (mut square, mut stars) = (0.0, 0_usize);
    for (exposure, of) in problem.exposures.iter().enumerate() {
        let factor = last.noise.frame_factors[exposure];
        problem.linearise(&last.state, exposure, |index, row| {
            let (image, weight) = (&of.images[index], last.weights[exposure][index]);
            let catalog_px = image.catalog_sigma_rad * last.noise.focal_length_px;
            let stated = f64::midpoint(image.covariance_px2[0], image.covariance_px2[2]) + catalog_px * catalog_px;
            let own = row.residual[0].powi(2) + row.residual[1].powi(2);
            memory.add(stated, own / factor, weight);
            if weight > REJECTED_WEIGHT {
                square += own;
                stars += 1;
            }
        });
    }
    memory.lost = lost(problem, active);
    (memory, stars, (stars > 0).then(|| (square / stars as f64).sqrt()))
}

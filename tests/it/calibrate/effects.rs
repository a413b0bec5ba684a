//! The joint method solves every displacement of the registry, or says that it cannot be told apart from what else is free.
//!
//! A night is made through [`Model`] with the effect in force, of real stars over a real site; the directions of the control points do not
//! contain the effect. A new displacement in the registry takes part by itself.

use boresight::calibrate::{CalibrateOptions, Calibration, calibrate};
use boresight::camera::{Camera, GroundSite, Model, observation};
use boresight::catalog::Catalog;
use boresight::coordinates::{Attitude, Direction, Icrs};
use boresight::effects::{AnyDisplacement, Context, DISPLACEMENTS, Observation, Segment, Sensor, StarImage, StarState, displacement};
use boresight::identify::{ControlPoint, ControlPoints, FrameState};
use boresight::units::DEG_RAD;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use super::{know_attitudes, random_attitude};

const WIDTH_PX: usize = 1024;
const HEIGHT_PX: usize = 768;
const NOISE_PX: f64 = 0.05;

/// How the camera is pointed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Pointing {
    /// All over the sky above the ground.
    Anywhere,
    /// At one place of the ground while the Earth turns.
    Fixed,
}

/// A night through a model.
#[derive(Clone, Debug)]
pub(super) struct SkyNight {
    pub(super) truth: Model,
    pub(super) frames: usize,
    pub(super) stars: usize,
    pub(super) noise_px: f64,
    pub(super) pointing: Pointing,
}

impl SkyNight {
    pub(super) fn new(truth: Model) -> Self {
        Self { truth, frames: 20, stars: 30, noise_px: NOISE_PX, pointing: Pointing::Anywhere }
    }

    /// What the telemetry, the clock and the site say of each frame.
    fn observations(&self, rng: &mut Pcg64Mcg) -> Vec<Observation> {
        let site = GroundSite::from_degrees(52.22, 4.42, 5.0);
        let middle = (self.frames as f64 - 1.0) / 2.0;
        (0..self.frames)
            .map(|frame| {
                // Eight hours; the temperature falls and rises, so that it is no measure of time.
                let hours = (frame as f64 - middle) * 8.0 / self.frames as f64;
                let time = "2026-03-21T00:30:00Z".parse::<hifitime::Epoch>().unwrap() + hifitime::Duration::from_seconds(hours * 3600.0);
                let known = observation(Some(time), Some(&site), None).unwrap();
                Observation {
                    time_offset_h: Some(hours),
                    order_offset: Some(frame as f64 - middle),
                    temperature_offset_k: Some(rng.random_range(-10.0..10.0)),
                    pressure_offset_hpa: Some(rng.random_range(-400.0..400.0)),
                    rate_rad_s: Some(std::array::from_fn(|_| rng.random_range(-0.05..0.05))),
                    sensor: Some(Sensor { width_px: WIDTH_PX, height_px: HEIGHT_PX, line_time_s: None, last_row_first: false }),
                    ..known
                }
            })
            .collect()
    }

    /// Control points whose directions are the catalogue's, and the attitudes.
    pub(super) fn observe(&self, seed: u64) -> (ControlPoints, Vec<Attitude>) {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let catalog = Catalog::embedded();
        let camera = *self.truth.camera();
        let mut normal = {
            let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0x5eed);
            move || -> f64 { StandardNormal.sample(&mut rng) }
        };
        let observations = self.observations(&mut rng);
        let reference = self.truth.reference_context();
        let seen = |x_px: f64, y_px: f64| self.truth.direction(boresight::coordinates::PixelPoint { x_px, y_px }, &reference).unwrap();
        let centre = seen(WIDTH_PX as f64 / 2.0, HEIGHT_PX as f64 / 2.0);
        let radius_rad = centre.angle_rad(&seen(0.0, 0.0)).max(centre.angle_rad(&seen(1023.0, 767.0))) + DEG_RAD;
        let up = (20.0 * DEG_RAD + radius_rad).min(80.0 * DEG_RAD).sin();
        let earth: Vec<UnitQuaternion<f64>> = observations.iter().map(earth_from_icrs).collect();
        let to_zenith = |attitude: &Attitude, frame: usize| {
            let on_sky = attitude.apparent_from_camera(&centre).xyz;
            observations[frame].zenith.unwrap().iter().zip(on_sky).map(|(a, b)| a * b).sum::<f64>()
        };
        let above = |rng: &mut Pcg64Mcg, frame: usize| {
            std::iter::repeat_with(|| random_attitude(rng)).find(|attitude| to_zenith(attitude, frame) > up).unwrap()
        };
        let mount = above(&mut rng, 0).camera_from_icrs * earth[0].inverse();
        let (mut points, mut attitudes) = (Vec::new(), Vec::new());
        for (frame, known) in observations.iter().enumerate() {
            let attitude = match self.pointing {
                Pointing::Anywhere => above(&mut rng, frame),
                Pointing::Fixed => Attitude::new(mount * earth[frame]),
            };
            let on_sky = Direction::<Icrs>::from_unit(attitude.apparent_from_camera(&centre).xyz);
            let mut near = catalog.stars_within(&on_sky, radius_rad, 7.0);
            // Any of the stars, so that they are spread over the frame.
            for last in (1..near.len()).rev() {
                near.swap(last, rng.random_range(0..=last));
            }
            let imaged = near.into_iter().filter_map(|index| {
                let star = &catalog.stars[index];
                let context = Context::new(StarState::of(star, catalog.epoch_yr), *known).with_image(image_of(star.magnitude, frame));
                let arrives = self.truth.apparent(&context);
                let pixel = self.truth.pixel(&attitude.camera_from_apparent(&arrives), &context)?;
                camera.contains(pixel).then_some((star, context, pixel))
            });
            for (star, context, pixel) in imaged.take(self.stars) {
                points.push(ControlPoint {
                    frame,
                    hip: star.hip,
                    direction: Direction::from_unit(star.direction.xyz),
                    x_px: pixel.x_px + self.noise_px * normal(),
                    y_px: pixel.y_px + self.noise_px * normal(),
                    covariance_px2: [self.noise_px.powi(2), 0.0, self.noise_px.powi(2)],
                    catalog_sigma_rad: 0.0,
                    has_proper_motion: true,
                    magnitude: star.magnitude,
                    colour: star.colour,
                    star: context.star,
                    image: context.image,
                });
            }
            attitudes.push(attitude);
        }
        let nominal = Camera::pinhole(WIDTH_PX, HEIGHT_PX, camera.focal_length_px * 1.004);
        let mut control = ControlPoints::new(nominal, vec![None; self.frames], points);
        control.frames = observations.into_iter().map(|observation| FrameState { observation, known_attitude: None }).collect();
        control.fixed_mount = self.pointing == Pointing::Fixed;
        (control, attitudes)
    }
}

/// The image of a star of this magnitude: 20 000 electrons at V = 5, over a background that rises to another side in every frame.
fn image_of(magnitude: f64, frame: usize) -> StarImage {
    let (sin, cos) = (frame as f64).sin_cos();
    StarImage {
        flux_e: Some(2e4 * 10.0_f64.powf(-0.4 * (magnitude - 5.0))),
        magnitude: Some(magnitude),
        background_gradient_e_px: Some([0.5 * cos, 0.5 * sin]),
        recording_gradient_e_px: Some(0.5),
        psf_sigma_px: Some(0.8),
        ..StarImage::default()
    }
}

fn earth_from_icrs(observation: &Observation) -> UnitQuaternion<f64> {
    let rows = observation.earth_from_icrs.unwrap();
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(Matrix3::from_fn(|row, column| rows[row][column])))
}

pub(super) fn camera() -> Camera {
    Camera { principal_point_px: [517.0, 379.0], k1: 4e-9, ..Camera::pinhole(WIDTH_PX, HEIGHT_PX, 1800.0) }
}

/// f, x0, y0, k1 and what is asked for besides.
pub(super) fn solving(more: &[&str]) -> CalibrateOptions {
    let solve = ["f", "x0", "y0", "k1"].iter().chain(more).map(|name| (*name).to_owned()).collect();
    CalibrateOptions { solve, held_out: false, ..CalibrateOptions::default() }
}

/// Value of a parameter of a chain.
fn true_value(model: &Model, name: &str) -> f64 {
    let place = model.parameters().iter().position(|parameter| parameter.name == name).unwrap();
    model.values()[place]
}

/// The largest difference of a solved parameter from the truth in its own standard errors, and its name.
pub(super) fn largest_pull(result: &Calibration, truth: &Model) -> (f64, String) {
    let pull = |p: &boresight::calibrate::ParameterEstimate| {
        let truth = if truth.parameters().iter().any(|own| own.name == p.name) { true_value(truth, &p.name) } else { 0.0 };
        ((p.value - truth).abs() / p.sigma, p.name.clone())
    };
    result.parameters.iter().map(pull).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap()
}

/// What became of an effect.
#[derive(Debug)]
enum Outcome {
    /// Refused, with the sentence.
    Refused(String),
    /// Solved: the effect's change over its standard error (largest of its parameters), at how many times its typical size, and the
    /// result.
    Solved { ratio: f64, times_typical: f64, result: Box<Calibration>, truth: Model },
}

/// The effect's parameters that are asked for by its id, off and at their typical size.
fn sizes(effect: &dyn AnyDisplacement, context: &Context) -> (Vec<usize>, Vec<f64>, Vec<f64>) {
    let off = effect.identity(context).unwrap_or_else(|| vec![0.0; effect.parameters().len()]);
    let typical = effect.parameters().iter().map(|spec| spec.typical).collect();
    (effect.default_free(&context.observation), off, typical)
}

/// Solves a night with the effect, larger and larger until it is found or unreasonably large.
fn solve_with(
    effect: &dyn AnyDisplacement,
    more: &[&str],
    pointing: Pointing,
    prepare: impl Fn(&mut ControlPoints, &[Attitude]),
) -> Outcome {
    let plain = SkyNight { pointing, ..SkyNight::new(Model::new(camera())) };
    let (points, _) = plain.observe(1);
    let context = Context::new(points.points[0].star, points.frames[0].observation).with_image(points.points[0].image);
    let (fitted, off, typical) = sizes(effect, &context);
    let mut found = None;
    for times_typical in [1.0, 3.0, 10.0, 30.0] {
        let mut parameters = off.clone();
        for k in &fitted {
            let (low, high) = effect.parameters()[*k].range;
            parameters[*k] = (off[*k] + times_typical * (typical[*k] - off[*k])).clamp(low, high);
        }
        let mut truth = Model::new(camera());
        truth.set(effect.id(), &parameters).unwrap();
        let (mut points, attitudes) = SkyNight { truth: truth.clone(), ..plain.clone() }.observe(1);
        prepare(&mut points, &attitudes);
        let names: Vec<&str> = std::iter::once(effect.id()).chain(more.iter().copied()).collect();
        let result = match calibrate(&points, &solving(&names)) {
            Ok(result) => result,
            Err(error) => return Outcome::Refused(error.to_string()),
        };
        let ratio = fitted
            .iter()
            .map(|k| {
                let name = format!("{}.{}", effect.id(), effect.parameters()[*k].name);
                let sigma = result.parameters.iter().find(|p| p.name == name).map_or(f64::INFINITY, |p| p.sigma);
                (parameters[*k] - off[*k]).abs() / sigma
            })
            .fold(f64::INFINITY, f64::min);
        let done = ratio > SEEN;
        found = Some(Outcome::Solved { ratio, times_typical, result: Box::new(result), truth });
        if done {
            break;
        }
    }
    found.unwrap()
}

/// An effect is seen if it is so many standard errors.
const SEEN: f64 = 4.0;
/// Effects that free attitudes take up, or that are too small for a night like this one at thirty times their size.
const NOT_SEEN: [&str; 4] = ["frame-rotation", "time-tag", "light-deflection", "parallax"];

/// Says what became of an effect; a fault where a wrong value has a small error bar, or where it is not `seen` as it should be.
fn fault(id: &str, outcome: &Outcome, seen: bool) -> Option<String> {
    match outcome {
        Outcome::Refused(sentence) => {
            println!("{id}: {sentence}");
            (seen || !sentence.contains(id)).then(|| format!("{id}: {sentence}"))
        }
        Outcome::Solved { ratio, times_typical, result, truth } => {
            let (pull, name) = largest_pull(result, truth);
            let what = format!("{id}: {ratio:.1} σ at {times_typical} × typical, pull {pull:.2} ({name}), {:?}", result.status);
            println!("{what}");
            let sound = pull < 4.5 && result.parameters.iter().all(|p| p.sigma.is_finite() && p.sigma > 0.0);
            (!sound || (*ratio > SEEN) != seen).then(|| format!("{what} {:?} {:?}", result.parameters, result.warnings))
        }
    }
}

#[test]
fn every_effect_comes_back_or_is_said_to_be_lost() {
    let is_term = |effect: &&dyn AnyDisplacement| effect.segment() != Segment::Projection && effect.id() != "brown-conrady";
    let all: Vec<&dyn AnyDisplacement> = DISPLACEMENTS.iter().copied().filter(is_term).collect();
    let outcomes: Vec<Outcome> = all.par_iter().map(|effect| solve_with(*effect, &[], Pointing::Anywhere, |_, _| ())).collect();
    let faults: Vec<String> =
        all.iter().zip(&outcomes).filter_map(|(effect, outcome)| fault(effect.id(), outcome, !NOT_SEEN.contains(&effect.id()))).collect();
    assert!(faults.is_empty(), "{faults:#?}");
}

/// Several causes at once that move the measured centre, each with a size of its own, come back together. What no image tells is refused.
#[test]
fn what_moves_the_measured_centre_comes_back() {
    let mut truth = Model::new(camera());
    let asked = [
        ("s-curve", &[0.03, -0.02][..]),
        ("magnitude-equation", &[0.02, -0.03]),
        ("charge-transfer-inefficiency", &[0.08]),
        ("even-odd", &[0.15]),
    ];
    for (id, parameters) in asked {
        truth.set(id, parameters).unwrap();
    }
    let night = SkyNight { frames: 40, ..SkyNight::new(truth.clone()) };
    let (mut points, _) = night.observe(7);
    let result = calibrate(&points, &solving(&asked.map(|(id, _)| id))).unwrap();
    let (pull, name) = largest_pull(&result, &truth);
    assert!(pull < 3.5, "{name} is off by {pull} σ: {:?}", result.parameters);
    for (id, parameters) in asked {
        for (spec, size) in displacement(id).unwrap().parameters().iter().zip(parameters) {
            let found = result.parameters.iter().find(|p| p.name == format!("{id}.{}", spec.name)).unwrap();
            println!("{}: {:.4} ± {:.4}, true {size}", found.name, found.value, found.sigma);
            assert!(size.abs() > 5.0 * found.sigma, "{} ± {} says nothing", found.name, found.sigma);
        }
    }
    // Negative control: what was left out of the model is not there by another name.
    let without = calibrate(&points, &solving(&["magnitude-equation"])).unwrap();
    assert!(largest_pull(&without, &truth).0 > 5.0, "{:?}", without.parameters);
    for point in &mut points.points {
        point.image = StarImage::default();
    }
    let refused = calibrate(&points, &solving(&["stray-light"])).unwrap_err().to_string();
    assert!(refused.contains("stray-light") && refused.contains("gradient"), "{refused}");
}

#[test]
fn what_cannot_be_told_apart_is_said_by_name() {
    for (id, with) in [("thin-prism", ["p1", "p2"]), ("detector-tilt", ["p1", "p2"])] {
        match solve_with(displacement(id).unwrap(), &with, Pointing::Anywhere, |_, _| ()) {
            Outcome::Refused(sentence) => {
                println!("{id}: {sentence}");
                assert!(sentence.contains(id), "{sentence}");
            }
            Outcome::Solved { ratio, times_typical, result, truth } => {
                let (pull, name) = largest_pull(&result, &truth);
                println!("{id}: {ratio:.2} σ at {times_typical} × typical, pull {pull:.2} ({name}): {:?}", result.warnings);
                assert!(pull < 4.5, "{name} is off by {pull} σ: {:?}", result.parameters);
                let said = |warning: &String| warning.contains("cannot be told apart") && warning.contains(id);
                assert!(result.warnings.iter().any(said), "{:?}", result.warnings);
            }
        }
    }
}

#[test]
fn a_fixed_mount_tells_the_drift_of_the_boresight_but_not_the_clock() {
    let drift = solve_with(displacement("boresight-drift").unwrap(), &[], Pointing::Fixed, |_, _| ());
    assert_eq!(fault("boresight-drift", &drift, true), None);
    let Outcome::Solved { times_typical, .. } = drift else { unreachable!() };
    assert!(times_typical < 1.5, "{times_typical}");
    // The clock turns the sky about the Earth's axis, and the mount with it.
    let clock = displacement("time-tag").unwrap();
    assert_eq!(fault("time-tag", &solve_with(clock, &[], Pointing::Fixed, |_, _| ()), false), None);
    // With attitudes from elsewhere it is told, whether the mount is fixed or not.
    for pointing in [Pointing::Fixed, Pointing::Anywhere] {
        let known = solve_with(clock, &[], pointing, |points, attitudes| know_attitudes(points, attitudes, 2e-5));
        assert_eq!(fault("time-tag", &known, true), None, "{pointing:?}");
    }
}

#[test]
fn every_projection_comes_back() {
    let is_wide = |effect: &&dyn AnyDisplacement| effect.segment() == Segment::Projection && effect.id() != "pinhole";
    let all: Vec<&dyn AnyDisplacement> = DISPLACEMENTS.iter().copied().filter(is_wide).collect();
    assert!(all.len() >= 4);
    let results: Vec<_> = all
        .par_iter()
        .map(|effect| {
            let own: Vec<f64> = effect.parameters().iter().skip(3).map(|spec| spec.typical).collect();
            let camera = Camera { principal_point_px: [517.0, 379.0], ..Camera::pinhole(WIDTH_PX, HEIGHT_PX, 500.0) };
            // The radial law of some has a term like k1 of its own.
            let camera = if own.is_empty() { Camera { k1: 2e-8, ..camera } } else { camera };
            let truth = Model::new(camera).with_projection(effect.id(), &own).unwrap();
            let (points, _) = SkyNight::new(truth.clone()).observe(2);
            let solve: &[&str] = if own.is_empty() { &["f", "x0", "y0", "k1"] } else { &["f", "x0", "y0", effect.id()] };
            let options = CalibrateOptions {
                solve: solve.iter().map(|name| (*name).to_owned()).collect(),
                projection: effect.id().to_owned(),
                projection_parameters: vec![0.0; own.len()],
                ..solving(&[])
            };
            (truth, calibrate(&points, &options))
        })
        .collect();
    for (effect, (truth, result)) in all.iter().zip(results) {
        let result = result.unwrap();
        let (pull, name) = largest_pull(&result, &truth);
        println!(
            "{}: pull {pull:.2} ({name}), {:?}",
            effect.id(),
            result.parameters.iter().map(|p| (&p.name, p.value, p.sigma)).collect::<Vec<_>>()
        );
        assert!(pull < 4.5, "{}: {name} is off by {pull} σ: {:?}", effect.id(), result.parameters);
        assert!(result.parameters.iter().all(|p| p.sigma > 0.0) && result.parameters[2].sigma < 0.1, "{:?}", result.parameters);
        assert_eq!(result.model.len(), 4.max(effect.parameters().len()));
        assert!(result.chain.unwrap().projection() == effect.id());
    }
}

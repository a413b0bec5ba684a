//! Which terms the star images support, what is said of those that they do not, and what effects that nobody models do to the focal length.

use boresight::calibrate::{CalibrateOptions, Calibration, Surroundings, calibrate, compare, map_sigma};
use boresight::camera::{Camera, Model};
use boresight::coordinates::{Attitude, CameraAxes, Direction, PixelPoint};
use boresight::effects::{StarImage, StarState};
use boresight::identify::{ControlPoint, ControlPoints, Projection};
use boresight::units::{ARCSEC_RAD, DEG_RAD};
use nalgebra::{Unit, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use super::joint::{joint, rms, sigma};
use super::random_attitude;

fn value(result: &Calibration, name: &str) -> f64 {
    result.parameters.iter().find(|p| p.name == name).unwrap().value
}

/// What `calibrate` does where nobody names parameters.
fn supported() -> CalibrateOptions {
    CalibrateOptions { extend_model: true, ..joint() }
}

fn auto() -> CalibrateOptions {
    CalibrateOptions { select_model: true, solve: Vec::new(), ..joint() }
}

fn named(names: &[&str]) -> CalibrateOptions {
    CalibrateOptions { solve: names.iter().map(|name| (*name).to_owned()).collect(), ..joint() }
}

/// Star images all over what a chain lights.
struct Shown {
    truth: Model,
    nominal: Camera,
    frames: usize,
    stars: usize,
    noise_px: f64,
    /// How far from the principal point there is light.
    radius_px: f64,
}

impl Shown {
    fn observe(&self, seed: u64) -> ControlPoints {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let context = self.truth.reference_context();
        let camera = *self.truth.camera();
        let [x0, y0] = camera.principal_point_px;
        let (mut points, mut attitudes) = (Vec::new(), Vec::new());
        for frame in 0..self.frames {
            let attitude = random_attitude(&mut rng);
            attitudes.push(Some(attitude));
            let mut made = 0;
            while made < self.stars {
                let x_px = rng.random_range(0.0..camera.width_px as f64 - 1.0);
                let y_px = rng.random_range(0.0..camera.height_px as f64 - 1.0);
                if (x_px - x0).hypot(y_px - y0) > self.radius_px {
                    continue;
                }
                let Some(seen) = self.truth.direction(PixelPoint { x_px, y_px }, &context) else { continue };
                made += 1;
                let mut noise = || -> f64 {
                    self.noise_px * {
                        let n: f64 = StandardNormal.sample(&mut rng);
                        n
                    }
                };
                let (dx, dy) = (noise(), noise());
                points.push(point(frame, points.len(), &attitude, &seen, [x_px + dx, y_px + dy], self.noise_px));
            }
        }
        ControlPoints::new(self.nominal, attitudes, points)
    }
}

fn point(frame: usize, number: usize, attitude: &Attitude, seen: &Direction<CameraAxes>, at: [f64; 2], sigma_px: f64) -> ControlPoint {
    let direction = attitude.apparent_from_camera(seen);
    ControlPoint {
        frame,
        hip: number as u32 + 1,
        direction,
        x_px: at[0],
        y_px: at[1],
        covariance_px2: [sigma_px * sigma_px, 0.0, sigma_px * sigma_px],
        catalog_sigma_rad: 0.0,
        has_proper_motion: true,
        magnitude: 5.0,
        colour: None,
        star: StarState { direction: direction.xyz, ..StarState::default() },
        image: StarImage::default(),
    }
}

/// A lens of 50°: 38 px of k1, 14 px of k2 and 9 px of k3 in the corners, of which k2 and k3 nearly cancel beside another f and k1.
fn wide_lens(stars: usize) -> Shown {
    let base = Camera { principal_point_px: [519.0, 503.0], ..Camera::pinhole(1024, 1024, 1098.0) };
    let mut truth = Model::new(Camera { k1: -0.12 / (1098.0 * 1098.0), p1: 2e-7, p2: -1e-7, ..base });
    truth.set("radial-high-order", &[0.1, -0.15]).unwrap();
    Shown { truth, nominal: Camera::pinhole(1024, 1024, 1110.0), frames: 12, stars, noise_px: 0.1, radius_px: f64::INFINITY }
}

#[test]
fn a_wide_lens_gets_the_terms_that_it_needs() {
    let shown = wide_lens(60);
    let pulls: Vec<(f64, f64)> = (0..12_u64)
        .into_par_iter()
        .map(|seed| {
            let points = shown.observe(500 + seed);
            let found = calibrate(&points, &supported()).unwrap();
            for name in ["radial-high-order.k2_norm", "radial-high-order.k3_norm"] {
                assert!(found.model.iter().any(|own| own == name), "{seed}: {:?}, {:?}", found.model, found.selection);
            }
            assert!(found.rejected.len() < 10, "{seed}: {} of {} rejected", found.rejected.len(), found.stars_offered);
            let held = calibrate(&points, &named(&["x0", "y0", "f", "k1", "p1", "p2"])).unwrap();
            let pull = |result: &Calibration| (value(result, "f") - 1098.0) / sigma(result, "f");
            (pull(&found), pull(&held))
        })
        .collect();
    println!("pulls of f by default and with k1 alone: {pulls:.1?}");
    assert!(pulls.iter().all(|(found, _)| found.abs() < 3.0), "{pulls:?}");
    assert!(pulls.iter().all(|(_, held)| held.abs() > 5.0), "k1 alone is not enough here: {pulls:?}");
}

/// Pulls of f over nights whose k2 is so many of its standard errors large: none, and about the size at which it is chosen.
#[test]
fn errors_are_true_after_the_choice() {
    const NIGHTS: u64 = 60;
    let base = Camera { principal_point_px: [516.0, 508.0], ..Camera::pinhole(1024, 1024, 2800.0) };
    let lens = |k1: f64, k2: f64| {
        let mut truth = Model::new(Camera { k1, ..base });
        truth.set("radial-high-order", &[k2, 0.0]).unwrap();
        Shown { truth, nominal: Camera::pinhole(1024, 1024, 2810.0), frames: 12, stars: 25, noise_px: 0.1, radius_px: f64::INFINITY }
    };
    let night = lens(5e-9, 0.0).observe(1);
    let of_k2 = sigma(&calibrate(&night, &named(&["x0", "y0", "f", "k1", "p1", "p2", "k2"])).unwrap(), "radial-high-order.k2_norm");
    let of_k1 = sigma(&calibrate(&night, &named(&["f", "k1"])).unwrap(), "k1");
    let pulls = |shown: &Shown, options: &CalibrateOptions| -> Vec<f64> {
        let of = |seed: u64| {
            let result = calibrate(&shown.observe(7000 + seed), options).unwrap();
            (value(&result, "f") - 2800.0) / sigma(&result, "f")
        };
        (0..NIGHTS).into_par_iter().map(of).collect()
    };
    for (what, options, lenses) in [
        ("default", supported(), [0.0, 1.0, 2.0, 3.0].map(|sigmas| (sigmas, lens(5e-9, sigmas * of_k2)))),
        ("auto", auto(), [0.0, 1.0, 2.0, 3.0].map(|sigmas| (sigmas, lens(sigmas * of_k1, 0.0)))),
    ] {
        for (sigmas, shown) in &lenses {
            let pulls = pulls(shown, &options);
            let within = pulls.iter().filter(|pull| pull.abs() < 2.0).count();
            let size = rms(pulls.iter().copied());
            println!("{what}, a term of {sigmas} σ: pulls of f have an rms of {size:.2}, {within} of {NIGHTS} within two σ");
            // 57 of 60 are expected within two of their errors, and 52 are three standard deviations fewer.
            assert!((0.2..1.3).contains(&size) && within >= 52, "{what}, {sigmas} σ: {size} {within}");
        }
    }
}

/// Two fisheyes whose images are circles within the frame: all of it is solved, what the corners leave open is no reason to stop, and what is
/// said of the map is said of the circle.
#[test]
fn a_fisheye_is_solved_over_what_it_lights() {
    for (law, projection) in [("equidistant", Projection::Equidistant), ("equisolid", Projection::Equisolid)] {
        let base = Camera { principal_point_px: [516.0, 508.5], k1: 2e-8, ..Camera::pinhole(1024, 1024, 300.0) };
        let truth = Model::new(base).with_projection(law, &[]).unwrap();
        let nominal = Camera { k1: 0.0, focal_length_px: 301.0, principal_point_px: [513.0, 510.0], ..base };
        let shown = Shown { truth, nominal, frames: 6, stars: 150, noise_px: 0.1, radius_px: 430.0 };
        let solve = |seed: u64, options: CalibrateOptions| {
            let mut points = shown.observe(seed);
            points.projection = projection;
            points.nominal_is_found = true;
            calibrate(&points, &CalibrateOptions { projection: law.to_owned(), ..options }).unwrap()
        };
        let results = [solve(1, auto()), solve(2, auto()), solve(3, supported())];
        for result in &results {
            let [f, x0] = ["f", "x0"].map(|name| (value(result, name), sigma(result, name)));
            println!("{law}: {:?}, f {f:?}, x0 {x0:?}, map {:?} over {:?}", result.model, result.map_sigma_px, result.lit);
            assert!((f.0 - 300.0).abs() < 3.5 * f.1 && (x0.0 - 516.0).abs() < 3.5 * x0.1, "{law}: {f:?} {x0:?}");
            let lit = result.lit.unwrap();
            assert!((lit.radius_px - 430.0).abs() < 15.0, "{lit:?}");
            assert!(result.map_sigma_px.unwrap().max < 0.2, "{:?}", result.map_sigma_px);
            let places = map_sigma(result, 21).unwrap();
            let expected =
                (0..441).filter(|k| (f64::from(k % 21) * 51.15 - 513.0).hypot(f64::from(k / 21) * 51.15 - 510.0) < lit.radius_px).count();
            assert!(places.len().abs_diff(expected) <= 8 && places.iter().all(|(pixel, _)| lit.contains(*pixel)), "{}", places.len());
        }
        let same = compare(&results[0], &results[1]).unwrap();
        println!("{law}: {} px, p {:?}", same.rms_px, same.p_value);
        assert!(same.rms_px < 0.1 && same.p_value.unwrap() > 1e-3, "{} {:?}", same.rms_px, same.p_value);
        assert!(
            !same.lit.is_empty() && same.warnings.iter().any(|warning| warning.contains("lit part of the frame")),
            "{:?}",
            same.warnings
        );
        assert!(
            same.difference_map
                .iter()
                .all(|point| same.lit.iter().all(|lit| lit.contains(PixelPoint { x_px: point.x_px, y_px: point.y_px })))
        );
    }
}

/// The sentence about a frame.
fn sentence(result: &Calibration) -> &str {
    let about: Vec<&String> = result.warnings.iter().filter(|warning| warning.contains("is worse than the others")).collect();
    assert_eq!(about.len(), 1, "{:?}", result.warnings);
    about[0]
}

#[test]
fn a_worse_frame_is_called_by_its_name_and_its_reason() {
    let narrow = Shown {
        truth: Model::new(Camera { k1: 5e-9, ..Camera::pinhole(1024, 1024, 2800.0) }),
        nominal: Camera::pinhole(1024, 1024, 2810.0),
        frames: 12,
        stars: 40,
        noise_px: 0.1,
        radius_px: f64::INFINITY,
    };
    let mut night = narrow.observe(3);
    night.frame_names = (0..12).map(|frame| format!("night-{frame}.png")).collect();
    // Trailed: every star somewhere along two pixels.
    let mut trailed = night.clone();
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    for point in trailed.points.iter_mut().filter(|point| point.frame == 4) {
        point.x_px += rng.random_range(-1.0..1.0);
    }
    let said = calibrate(&trailed, &joint()).unwrap();
    assert!(sentence(&said).starts_with("night-4.png is worse") && sentence(&said).contains("trailed, unsharp"), "{}", sentence(&said));
    // Another camera: a tenth of a per cent longer.
    let mut another = night.clone();
    for point in another.points.iter_mut().filter(|point| point.frame == 7) {
        (point.x_px, point.y_px) = (511.5 + 1.001 * (point.x_px - 511.5), 511.5 + 1.001 * (point.y_px - 511.5));
    }
    let said = calibrate(&another, &joint()).unwrap();
    let words = sentence(&said);
    println!("{words}");
    assert!(words.starts_with("night-7.png is worse") && words.contains("focal length 280") && words.contains("another camera"), "{words}");
    // The model lacks k2 and k3: the frame with stars in the corners is worse, and nothing is wrong with it.
    let mut lens = wide_lens(60);
    let corners = |lens: &Shown| {
        let mut points = lens.observe(9);
        points.points.retain(|point| ((point.x_px - 519.0).hypot(point.y_px - 503.0) > 420.0) == (point.frame == 2));
        calibrate(&points, &named(&["x0", "y0", "f", "k1"])).unwrap()
    };
    // Where k3 nearly cancels k2 another f and k1 stand for both: no frame scatters more than the others, and none is said to.
    let said = corners(&lens);
    let of_corners = said.per_frame.iter().find(|frame| frame.frame == 2).and_then(|frame| frame.rms_px).unwrap();
    assert!(of_corners < 1.2 * said.rms_px.unwrap(), "{of_corners} {:?}", said.rms_px);
    assert!(said.warnings.iter().all(|warning| !warning.contains("is worse than the others")), "{:?}", said.warnings);
    lens.truth.set("radial-high-order", &[0.1, 0.0]).unwrap();
    let said = corners(&lens);
    let words =
        said.warnings.iter().find(|warning| warning.starts_with("frame 2 is worse")).unwrap_or_else(|| panic!("{:?}", said.warnings));
    println!("{words}");
    assert!(words.contains("lacks k2 and k3") && !words.contains("trailed"), "{words}");
}

/// Refraction and aberration as they are, on nights that model neither: what is said of f holds the truth.
#[test]
fn what_the_sky_does_to_f_is_said_with_a_number() {
    const FOCAL_PX: f64 = 5000.0;
    let narrow = Shown {
        truth: Model::new(Camera { k1: 2e-9, ..Camera::pinhole(1024, 1024, FOCAL_PX) }),
        nominal: Camera::pinhole(1024, 1024, 5010.0),
        frames: 10,
        stars: 40,
        noise_px: 0.02,
        radius_px: f64::INFINITY,
    };
    // The true direction of what arrives from here, the zenith so far from the middle of each frame: R = R45·tan z of the observed z.
    let under_air = |zenith_deg: f64| {
        let mut points = narrow.observe(11);
        let mut rng = Pcg64Mcg::seed_from_u64(12);
        let tilts: Vec<f64> = (0..10).map(|_| rng.random_range(0.0..std::f64::consts::TAU)).collect();
        for point in &mut points.points {
            let attitude = points.attitudes[point.frame].unwrap();
            let (sin, cos) = (zenith_deg * DEG_RAD).sin_cos();
            let (along_y, along_x) = tilts[point.frame].sin_cos();
            let up = attitude.apparent_from_camera(&Direction::along([sin * along_x, sin * along_y, cos]));
            let (up, seen) = (Vector3::from(up.xyz), Vector3::from(point.direction.xyz));
            let axis = seen.cross(&up);
            let tangent = axis.norm() / seen.dot(&up);
            let lower = UnitQuaternion::from_axis_angle(&Unit::new_normalize(axis), -57.08 * ARCSEC_RAD * tangent);
            let from = lower * seen;
            point.direction = Direction::along(from.into());
            point.star.direction = from.into();
        }
        points
    };
    let mut off = Vec::new();
    for zenith_deg in [0.5, 40.0, 60.0] {
        let result = calibrate(&under_air(zenith_deg), &joint()).unwrap();
        let open = result.unmodelled(Surroundings::MayBeGround);
        let air = open.iter().find(|systematic| systematic.cause == "refraction").unwrap();
        let found = value(&result, "f") - FOCAL_PX;
        println!("zenith {zenith_deg}°: f off by {found:.3} px, said {:?}: {}", air.range_px, air.sentence);
        let slack = 3.0 * sigma(&result, "f");
        assert!(found > air.range_px[0] - slack && found < air.range_px[1] + slack, "{found} {:?}", air.range_px);
        assert_eq!(air.parameter, "f");
        off.push((found, air.range_px));
    }
    // The ends of the range are those of the ends.
    assert!((off[0].0 - off[0].1[1]).abs() < 0.15 && (off[2].0 - off[2].1[0]).abs() < 0.25, "{off:?}");
    let result = calibrate(&under_air(40.0), &joint()).unwrap();
    let causes = |result: &Calibration, surroundings| -> Vec<String> {
        result.unmodelled(surroundings).into_iter().map(|systematic| systematic.cause).collect()
    };
    assert_eq!(causes(&result, Surroundings::MayBeGround), ["refraction", "stellar-aberration"]);
    assert_eq!(causes(&result, Surroundings::Space), ["stellar-aberration"]);
    // What is in force, or solved, or far below the errors, is not said.
    let modelled = Calibration { physics: vec!["refraction".to_owned(), "stellar-aberration".to_owned()], ..result.clone() };
    assert!(causes(&modelled, Surroundings::MayBeGround).is_empty());
    let mut vague = result;
    for parameter in &mut vague.parameters {
        parameter.sigma *= 1e4;
    }
    assert!(causes(&vague, Surroundings::MayBeGround).is_empty());
}

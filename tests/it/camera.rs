//! The camera model: inversion of the distortion, derivatives, and the chain from catalogue to pixel.

use boresight::camera::{Camera, PARAMETER_COUNT, Physics, SkyChain, direction_from_pixel, pixel_from_direction};
use boresight::coordinates::{Attitude, CameraAxes, Direction, PixelPoint};
use boresight::dual::{Dual, Real};
use boresight::effects::{Observation, RefractionConstants};

fn cameras() -> Vec<Camera> {
    let base = Camera::pinhole(1024, 768, 2000.0);
    vec![
        base,
        Camera { principal_point_px: [530.0, 370.0], k1: 4e-8, p1: 2e-7, p2: -3e-7, ..base },
        Camera { principal_point_px: [500.0, 390.0], k1: -8e-8, p1: -2e-6, p2: 1e-6, ..base },
    ]
}

#[test]
fn the_inverse_of_the_distortion_is_exact() {
    for camera in cameras() {
        for y in (-1..=8).map(|row| f64::from(row) * 96.0) {
            for x in (-1..=8).map(|column| f64::from(column) * 128.0) {
                let point = PixelPoint { x_px: x + 0.37, y_px: y - 0.21 };
                let back = camera.pixel(&camera.direction(point)).expect("inside the frame");
                let error = (back.x_px - point.x_px).hypot(back.y_px - point.y_px);
                assert!(error <= 1e-12 * 1024.0, "{camera:?} at {point:?}: {error:e} px");
            }
        }
    }
}

#[test]
fn derivatives_of_both_directions_agree_with_central_differences() {
    for camera in cameras() {
        let at = camera.parameters();
        let steps = [1e-3, 1e-3, 1e-2, 1e-12, 1e-10, 1e-10];
        let point = PixelPoint { x_px: 873.2, y_px: 91.7 };
        let direction = camera.direction(point);
        let jets: [Dual<PARAMETER_COUNT>; PARAMETER_COUNT] = std::array::from_fn(|index| Dual::variable(at[index], index));
        let forward = pixel_from_direction(&jets, &direction.lift()).unwrap();
        let backward = direction_from_pixel(&jets, PixelPoint { x_px: Dual::constant(point.x_px), y_px: Dual::constant(point.y_px) });
        for index in 0..PARAMETER_COUNT {
            let moved = |sign: f64| {
                let mut parameters = at;
                parameters[index] += sign * steps[index];
                let camera = camera.with_parameters(parameters);
                (camera.pixel(&direction).unwrap(), camera.direction(point).xyz)
            };
            let ((high_px, high), (low_px, low)) = (moved(1.0), moved(-1.0));
            let slope = |high: f64, low: f64| (high - low) / (2.0 * steps[index]);
            let size = forward.x_px.partials[index].hypot(forward.y_px.partials[index]);
            assert!((slope(high_px.x_px, low_px.x_px) - forward.x_px.partials[index]).abs() < 1e-5 * size, "parameter {index}");
            assert!((slope(high_px.y_px, low_px.y_px) - forward.y_px.partials[index]).abs() < 1e-5 * size, "parameter {index}");
            for axis in 0..3 {
                let difference = (slope(high[axis], low[axis]) - backward.xyz[axis].partials[index]).abs();
                assert!(difference < 1e-5 * size / at[2], "parameter {index}");
            }
        }
    }
}

#[test]
fn what_has_no_image_gets_none() {
    let camera = Camera { k1: 4e-7, ..Camera::pinhole(1024, 768, 2000.0) };
    assert!(camera.pixel(&Direction::along([0.0, 0.0, -1.0])).is_none(), "behind the camera");
    assert!(camera.pixel(&Direction::along([0.5, 0.0, 1.0])).is_none(), "beyond the fold at r = 1 / sqrt(3 k1)");
    assert!(camera.pixel(&Direction::along([0.1, 0.0, 1.0])).is_some());
}

#[test]
fn pointing_and_roll_follow_the_convention() {
    // Looking at the equator at right ascension 0 with north up: east is to the LEFT of a camera whose x runs right and y down.
    let attitude = Attitude::from_pointing(0.0, 0.0, 0.0);
    let east = attitude.camera_from_apparent(&Direction::from_radec_rad(0.01, 0.0));
    let north = attitude.camera_from_apparent(&Direction::from_radec_rad(0.0, 0.01));
    assert!(east.xyz[0] < -0.009 && north.xyz[1] < -0.009);
    // A roll of 90°: up points east.
    let rolled = Attitude::from_pointing(0.0, 0.0, std::f64::consts::FRAC_PI_2);
    assert!(rolled.camera_from_apparent(&Direction::from_radec_rad(0.01, 0.0)).xyz[1] < -0.009);
    let boresight: Direction<CameraAxes> = Direction::along([0.0, 0.0, 1.0]);
    let (ra, dec) = Attitude::from_pointing(1.2, -0.7, 0.3).apparent_from_camera(&boresight).radec_rad();
    assert!((ra - 1.2).abs() < 1e-14 && (dec + 0.7).abs() < 1e-14);
}

#[test]
fn the_sky_chain_can_be_undone() {
    let observation = Observation {
        epoch_yr: Some(2020.0),
        position_au: Some([0.1, 0.9, 0.4]),
        sun_au: Some([0.101, 0.906, 0.402]),
        velocity_km_s: Some([-29.0, 3.0, 1.0]),
        zenith: Some([0.0, 0.0, 1.0]),
        refraction: Some(RefractionConstants { a_rad: 2.8e-4, b_rad: -3e-7 }),
        ..Observation::default()
    };
    let chain = SkyChain::new(&Physics::Known, observation).unwrap();
    assert_eq!(chain.ids(), ["proper-motion", "parallax", "light-deflection", "stellar-aberration", "refraction"]);
    for altitude_deg in [8.0, 30.0, 89.9_f64] {
        let apparent = Direction::from_radec_rad(0.4, altitude_deg.to_radians());
        let icrs = chain.icrs_from_apparent(&apparent);
        let star = boresight::catalog::Star {
            hip: 1,
            direction: icrs,
            proper_motion_rad_yr: None,
            parallax_rad: 0.0,
            magnitude: 3.0,
            colour: None,
        };
        assert!(chain.apparent(&star, 1991.25).angle_rad(&apparent) < 1e-13, "altitude {altitude_deg}");
    }
}

#[test]
fn physics_is_parsed_and_refused_with_a_suggestion() {
    assert_eq!("known".parse(), Ok(Physics::Known));
    assert_eq!("proper-motion,refraction".parse(), Ok(Physics::List(vec!["proper-motion".into(), "refraction".into()])));
    let error = "stelar-aberration".parse::<Physics>().unwrap_err().to_string();
    assert!(error.contains("did you mean stellar-aberration?"), "{error}");
    let physics = "refraction".parse::<Physics>().unwrap();
    let error = SkyChain::new(&physics, Observation::default()).unwrap_err().to_string();
    assert!(error.contains("the site or the time of the frames is not known"), "{error}");
}

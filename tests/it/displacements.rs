//! Walks the registry of displacements: derivatives, identity, reference values, documentation.

use boresight::camera::{Camera, Model};
use boresight::coordinates::PixelPoint;
use boresight::dual::{Dual, Jet, PARTIALS, Real};
use boresight::effects::{
    Context, DISPLACEMENTS, Light, Observation, ParameterSpec, RefractionConstants, Segment, Sensor, StarImage, StarState, displacement,
};

/// A star and an exposure in which every effect has something to do.
fn context() -> Context {
    let star = StarState {
        direction: [0.6, 0.48, 0.64],
        epoch_yr: 1991.25,
        proper_motion_rad_yr: [3e-6, -5e-6],
        parallax_rad: 3e-6,
        magnitude: 4.0,
        colour: Some(0.9),
    };
    let observation = Observation {
        epoch_yr: Some(2026.25),
        position_au: Some([0.3, -0.8, -0.35]),
        velocity_km_s: Some([25.0, 9.0, -4.0]),
        sun_au: Some([0.302, -0.794, -0.348]),
        zenith: Some([0.36, 0.8, -0.48]),
        zenith_is_guessed: false,
        refraction: Some(RefractionConstants { a_rad: 2.8e-4, b_rad: -3.2e-7 }),
        earth_from_icrs: Some([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]]),
        time_offset_h: Some(1.5),
        order_offset: Some(-3.0),
        temperature_offset_k: Some(4.0),
        pressure_offset_hpa: Some(-20.0),
        rate_rad_s: Some([0.01, -0.02, 0.015]),
        exposure_s: Some(0.2),
        sensor: Some(Sensor { width_px: 1024, height_px: 768, line_time_s: Some(1.2e-5), last_row_first: false }),
    };
    let image = StarImage {
        flux_e: Some(8000.0),
        magnitude: Some(4.2),
        background_gradient_e_px: Some([0.4, -0.3]),
        recording_gradient_e_px: Some(0.6),
        psf_sigma_px: Some(0.9),
        ..StarImage::default()
    };
    Context::new(star, observation).with_image(image)
}

fn coordinates<T: Copy>(light: &Light<T>) -> [T; 5] {
    let ([x, y, z], [u, v]) = (light.direction, light.point_px);
    [x, y, z, u, v]
}

fn incoming(segment: Segment) -> Light<f64> {
    match segment {
        Segment::Sky => Light::from(context().star.direction),
        Segment::Projection => Light::from([0.1, -0.2, 0.974_679_434_480_896_3]),
        Segment::Camera | Segment::Focal => Light {
            direction: [0.1, -0.2, 0.974_679_434_480_896_3],
            point_px: [310.0, -220.0],
            pixel_px: [1010.0, 163.5],
            focal_length_px: 2900.0,
        },
    }
}

/// The light of [`incoming`], and for what acts at the measured pixel also light near the lower edge of the frame and at 0.7 of the usual
/// place of a seam: some effects are confined to such places.
fn everywhere(segment: Segment) -> Vec<Light<f64>> {
    let mut all = vec![incoming(segment)];
    if matches!(segment, Segment::Camera | Segment::Focal) {
        all.push(Light { point_px: [-341.4, 381.0], pixel_px: [358.6, 764.5], ..incoming(segment) });
    }
    all
}

/// The step of a central difference: a thousandth of the value. Places and lengths in px take at most a thousandth of a pixel, since an
/// effect may change within one.
fn step_of(unit: &str, value: f64) -> f64 {
    let step = 1e-3 * value.abs();
    if unit == "px" { step.min(1e-3) } else { step }
}

#[test]
fn derivatives_agree_with_central_differences() {
    for effect in DISPLACEMENTS {
        let count = effect.parameters().len();
        assert!(count <= PARTIALS, "{}: {count} parameters need more than one pass", effect.id());
        let at: Vec<f64> = effect
            .parameters()
            .iter()
            .map(|parameter| 0.7 * parameter.typical + if parameter.typical == 0.0 { 0.05 } else { 0.0 })
            .collect();
        let jets: Vec<Jet> = at.iter().enumerate().map(|(index, value)| Dual::variable(*value, index)).collect();
        let mut largest = 0.0_f64;
        let mut sizes = vec![0.0_f64; count];
        for before in everywhere(effect.segment()) {
            let lifted = Light {
                direction: before.direction.map(Jet::constant),
                point_px: before.point_px.map(Jet::constant),
                pixel_px: before.pixel_px.map(Jet::constant),
                focal_length_px: Jet::constant(before.focal_length_px),
            };
            let after = coordinates(&effect.displace_jet(&jets, lifted, &context()));
            let plain = coordinates(&effect.displace(&at, before, &context()));
            for index in 0..count {
                let step = step_of(effect.parameters()[index].unit, at[index]);
                let shifted = |sign: f64| {
                    let mut parameters = at.clone();
                    parameters[index] += sign * step;
                    coordinates(&effect.displace(&parameters, before, &context()))
                };
                let (high, low) = (shifted(1.0), shifted(-1.0));
                let slopes: Vec<f64> = (0..5).map(|axis| after[axis].partials[index]).collect();
                // A comparison of sizes would pass over a NaN.
                assert!(slopes.iter().all(|slope| slope.is_finite()), "{}: {slopes:?} at {before:?}", effect.id());
                let size = slopes.iter().fold(0.0_f64, |most, slope| most.max(slope.abs()));
                sizes[index] = sizes[index].max(size);
                for axis in 0..5 {
                    let difference = (high[axis] - low[axis]) / (2.0 * step);
                    largest = largest.max((difference - slopes[axis]).abs() / (size + 1e-13 / step));
                    assert_eq!(plain[axis].to_bits(), after[axis].value.to_bits(), "{}: value of the dual body", effect.id());
                }
            }
        }
        for (parameter, size) in effect.parameters().iter().zip(&sizes) {
            assert!(*size > 0.0, "{} does not depend on {}", effect.id(), parameter.name);
        }
        assert!(largest < 1e-4, "{}: derivatives differ from central differences by {largest:.1e}", effect.id());
    }
}

#[test]
fn identity_parameters_do_nothing() {
    for effect in DISPLACEMENTS {
        let before = incoming(effect.segment());
        let Some(off) = effect.identity(&context()) else {
            assert_eq!(effect.segment(), Segment::Projection, "{}: only a projection cannot be switched off", effect.id());
            continue;
        };
        let after = coordinates(&effect.displace(&off, before, &context()));
        for (after, before) in after.into_iter().zip(coordinates(&before)) {
            assert!((after - before).abs() < 1e-15 * before.abs().max(1.0), "{} with {off:?}", effect.id());
        }
        let Some(known) = effect.predicted(&context().observation) else {
            continue;
        };
        let moved = coordinates(&effect.displace(&known, before, &context()));
        assert!(
            moved.iter().zip(coordinates(&before)).any(|(after, before)| (after - before).abs() > 1e-8),
            "{} at its known size moves nothing",
            effect.id()
        );
    }
}

#[test]
fn reference_values_are_reproduced() {
    for effect in DISPLACEMENTS {
        let cases = effect.reference_values();
        assert!(!cases.is_empty(), "{} has no reference value from outside", effect.id());
        for case in cases {
            let after = coordinates(&effect.displace(&case.parameters, case.before, &case.context));
            for (got, want) in after.into_iter().zip(coordinates(&case.after)) {
                assert!((got - want).abs() <= case.tolerance, "{} against {}: {got} ≠ {want}", effect.id(), case.source);
            }
            // Negative control: the comparison sees a change of the size of a thousandth of the effect.
            let changed: Vec<f64> = case.parameters.iter().map(|value| value * 1.001 + f64::from(*value == 0.0) * 0.05).collect();
            let moved = coordinates(&effect.displace(&changed, case.before, &case.context));
            let seen = moved.into_iter().zip(coordinates(&case.after)).any(|(got, want)| (got - want).abs() > case.tolerance);
            assert!(seen, "{}: the reference value would not notice a wrong parameter", effect.id());
        }
    }
}

/// A projection and its inverse undo each other, and the inverse carries the derivatives of the parameters.
#[test]
fn projections_are_inverted_by_their_rays() {
    for effect in DISPLACEMENTS.iter().filter(|effect| effect.segment() == Segment::Projection) {
        let parameters: Vec<f64> = effect.parameters().iter().map(|parameter| 0.7 * parameter.typical).collect();
        let before = incoming(Segment::Projection);
        let point = effect.displace(&parameters, before, &context()).point_px;
        let at = |parameters: &[f64]| {
            let light = Light { point_px: [point[0] - parameters[0], point[1] - parameters[1]], ..before };
            boresight::dual::normalize(effect.ray(parameters, light).expect("the point is the image of a direction"))
        };
        let back = at(&parameters);
        for axis in 0..3 {
            assert!((back[axis] - before.direction[axis]).abs() < 1e-13, "{}: {back:?}", effect.id());
        }
        let jets: Vec<Jet> = parameters.iter().enumerate().map(|(index, value)| Dual::variable(*value, index)).collect();
        let lifted = Light {
            direction: before.direction.map(Jet::constant),
            point_px: [Jet::constant(point[0]) - jets[0], Jet::constant(point[1]) - jets[1]],
            pixel_px: before.pixel_px.map(Jet::constant),
            focal_length_px: Jet::constant(1.0),
        };
        let dual = boresight::dual::normalize(effect.ray_jet(&jets, lifted).expect("the point is the image of a direction"));
        for index in 0..parameters.len() {
            let step = 1e-4 * parameters[index].abs();
            let shifted = |sign: f64| {
                let mut moved = parameters.clone();
                moved[index] += sign * step;
                at(&moved)
            };
            let (high, low) = (shifted(1.0), shifted(-1.0));
            let size = (0..3).map(|axis| dual[axis].partials[index].abs()).fold(0.0_f64, f64::max);
            assert!(size > 0.0, "{}: the direction does not depend on {}", effect.id(), effect.parameters()[index].name);
            for axis in 0..3 {
                let difference = (high[axis] - low[axis]) / (2.0 * step);
                assert!(
                    (difference - dual[axis].partials[index]).abs() < 1e-5 * size + 1e-14 / step,
                    "{} {}: {difference} ≠ {}",
                    effect.id(),
                    effect.parameters()[index].name,
                    dual[axis].partials[index]
                );
            }
        }
    }
}

#[test]
fn what_is_missing_is_said() {
    for effect in DISPLACEMENTS {
        let nothing = Observation::default();
        let full = context().observation;
        assert!(effect.unmet_requirement(&full).is_none(), "{}: the context lacks nothing", effect.id());
        for observation in [nothing, full] {
            let (known, missing) = (effect.predicted(&observation), effect.unmet_requirement(&observation));
            assert!(known.is_none() || missing.is_none(), "{} is known, and yet {missing:?}", effect.id());
        }
        let before = incoming(effect.segment());
        let parameters: Vec<f64> = effect.parameters().iter().map(|parameter| parameter.typical).collect();
        let after = effect.displace(&parameters, before, &Context::new(context().star, nothing));
        assert!(coordinates(&after).iter().all(|value| value.is_finite()), "{} without knowledge", effect.id());
    }
}

/// The name of an effect alone stands for what the recording leaves open.
#[test]
fn what_is_fitted_follows_from_what_is_known() {
    let full = context().observation;
    let fitted = |id: &str, observation: &Observation| {
        let effect = displacement(id).unwrap();
        (effect.default_free(observation), effect.predicted(observation), effect.unmet_requirement(observation))
    };
    let resting = Observation { velocity_km_s: None, ..full };
    assert_eq!(fitted("stellar-aberration", &full), (vec![0], Some(vec![1.0, 0.0, 0.0, 0.0]), None));
    assert_eq!(fitted("stellar-aberration", &resting), (vec![1, 2, 3], None, None));
    let guessed = Observation { zenith_is_guessed: true, ..full };
    assert_eq!(fitted("refraction", &guessed), (vec![0, 1, 2], None, None));
    let (indices, known, missing) = fitted("refraction", &full);
    assert!(indices == [0] && known.is_some_and(|known| known[1..] == [0.0; 2]) && missing.is_none());
    let cool = Observation { temperature_offset_k: None, ..full };
    let timeless = Observation { time_offset_h: None, ..full };
    assert_eq!((fitted("boresight-drift", &full).0, fitted("boresight-drift", &cool).0), (vec![0, 1], vec![2, 3]));
    assert_eq!((fitted("focal-length-drift", &full).0, fitted("focal-length-drift", &timeless).0), (vec![0], vec![1]));
    for id in ["chromatic-refraction", "frame-rotation", "time-tag"] {
        assert_eq!(fitted(id, &full), (vec![0], None, None), "{id} has no known size");
    }
}

/// Where nobody says what the air is like, its total refraction can still be fitted.
#[test]
fn refraction_without_a_site_is_that_of_standard_air() {
    let observation = Observation { zenith: Some([0.0, 0.0, 1.0]), zenith_is_guessed: true, ..Observation::default() };
    let effect = displacement("refraction").unwrap();
    assert!(effect.unmet_requirement(&observation).is_none() && effect.predicted(&observation).is_none());
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let after = effect.displace(&[57.0, 0.0, 0.0], Light::from([half, 0.0, half]), &Context::new(context().star, observation)).direction;
    let lift_arcsec = (after[2].atan2(after[0]).to_degrees() - 45.0) * 3600.0;
    assert!((lift_arcsec / 57.0 - 1.0).abs() < 1e-3, "{lift_arcsec}″");
}

/// The manifest's line time is positive whichever row is read first, and so is the parameter.
#[test]
fn the_line_time_keeps_the_meaning_of_the_manifest() {
    let with = |line_time_s| {
        let sensor = Sensor { line_time_s, ..context().observation.sensor.unwrap() };
        Context::new(context().star, Observation { sensor: Some(sensor), ..context().observation })
    };
    let effect = displacement("rolling-shutter").unwrap();
    let before = incoming(Segment::Camera);
    let [down, up] = [1.2e-5, -1.2e-5].map(|line_time_s| {
        let known = effect.predicted(&with(Some(line_time_s)).observation).unwrap();
        assert!((known[0] - 12.0).abs() < 1e-12);
        effect.displace(&known, before, &with(Some(line_time_s))).direction
    });
    assert!((down[0] - before.direction[0]).abs() > 1e-5);
    for axis in 0..3 {
        let (one, other) = (down[axis] - before.direction[axis], before.direction[axis] - up[axis]);
        assert!((one - other).abs() < 1e-8, "{down:?} {up:?}");
    }
    assert_eq!(effect.displace(&[12.0], before, &with(None)).direction, down, "row 0 first where nobody says");
    assert!(effect.predicted(&with(None).observation).is_none() && effect.predicted(&with(Some(0.0)).observation).is_none());
    // Which row is read first may be known where the time from row to row is not.
    let mut last_first = with(None);
    last_first.observation.sensor = last_first.observation.sensor.map(|sensor| Sensor { last_row_first: true, ..sensor });
    assert_eq!(effect.displace(&[12.0], before, &last_first).direction, up);
}

#[test]
fn every_id_is_unique_and_has_its_file() {
    let mut ids: Vec<&str> = DISPLACEMENTS.iter().map(|effect| effect.id()).collect();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), DISPLACEMENTS.len());
    for effect in DISPLACEMENTS {
        let (id, stem) = (effect.id(), effect.id().replace('-', "_"));
        let text = ["sky", "optics", "motion", "detector"]
            .iter()
            .find_map(|place| std::fs::read_to_string(format!("{}/src/effects/{place}/{stem}.rs", env!("CARGO_MANIFEST_DIR"))).ok());
        let text = text.unwrap_or_else(|| panic!("{id} has no file of its own name"));
        let page = effect.page();
        assert_eq!(page, boresight::effects::page_of(&text), "{id} shows the page of another");
        crate::common::check_page(id, &page);
    }
}

/// Cameras with one Focal effect each in force, besides the reference model's own distortion, at three times its typical size, and one
/// with all of them at their typical sizes. A place (`line_px`) has no size and stays where it is.
fn distorted_cameras() -> Vec<(&'static str, Model)> {
    let camera = Camera { principal_point_px: [530.0, 370.0], k1: 2e-8, p1: 2e-7, p2: -3e-7, ..Camera::pinhole(1024, 768, 2000.0) };
    let mut all = Model::new(camera);
    let mut cameras = Vec::new();
    for effect in DISPLACEMENTS.iter().filter(|effect| effect.segment() == Segment::Focal && effect.id() != "brown-conrady") {
        let times = |factor: f64| {
            let strong = |parameter: &ParameterSpec| parameter.typical * if parameter.name == "line_px" { 1.0 } else { factor };
            effect.parameters().iter().map(strong).collect::<Vec<f64>>()
        };
        let mut model = Model::new(camera);
        model.set(effect.id(), &times(3.0)).expect("a Focal effect is a term");
        all.set(effect.id(), &times(1.0)).expect("a Focal effect is a term");
        cameras.push((effect.id(), model));
    }
    cameras.push(("all together", all));
    cameras
}

/// Points all over the frame of 1024 × 768 px, along its edges, and across the seam in its middle.
fn points_of_the_frame() -> Vec<[f64; 2]> {
    let mut points = Vec::new();
    for x in [-0.5, 0.3, 6.2, 250.7, 505.0, 511.1, 511.4, 511.6, 512.3, 530.0, 800.9, 1010.0, 1023.0] {
        points.extend([-0.5, 4.1, 190.6, 370.0, 600.2, 760.8, 767.5].map(|y| [x, y]));
    }
    points
}

#[test]
fn a_camera_with_any_focal_effect_is_inverted() {
    let cameras = distorted_cameras();
    assert!(cameras.len() > 12, "{} cameras", cameras.len());
    for (id, model) in cameras {
        let reference = Model::new(*model.camera());
        let mut moved = 0.0_f64;
        for [x_px, y_px] in points_of_the_frame() {
            let point = PixelPoint { x_px, y_px };
            let direction = model.direction(point, &context()).expect("the pinhole has a direction for every point");
            moved = moved.max(direction.angle_rad(&reference.direction(point, &context()).expect("as above")));
            let back = model.pixel(&direction, &context()).unwrap_or_else(|| panic!("{id}: the direction of {point:?} has no image"));
            let error = (back.x_px - x_px).hypot(back.y_px - y_px);
            assert!(error < 1e-8, "{id} at {point:?}: {error:e} px");
        }
        assert!(moved > 1e-7, "{id} moves nothing in a camera: {moved:e} rad");
    }
}

#[test]
fn derivatives_of_a_camera_with_any_focal_effect_agree_with_central_differences() {
    for (id, model) in distorted_cameras() {
        let values = model.values();
        let parameters = model.parameters();
        let own: Vec<usize> = (0..values.len()).filter(|index| !parameters[*index].effect.is_empty()).collect();
        assert!(!own.is_empty());
        let at = |values: &[f64], [x_px, y_px]: [f64; 2]| {
            let mut model = model.clone();
            model.set_values(values);
            model.direction(PixelPoint { x_px, y_px }, &context()).expect("the pinhole has a direction for every point").xyz
        };
        // [slope, central difference, step] of every component at every point, for every parameter and for the two coordinates.
        let mut pairs = vec![Vec::new(); own.len() + 2];
        for pixel in points_of_the_frame().into_iter().filter(|[x, y]| *x > 0.0 && *y > 0.0 && *y < 767.0) {
            let seen = model.seen(&values, &own, pixel, &context()).expect("the pinhole has a direction for every point");
            for k in 0..pairs.len() {
                let step = own.get(k).map_or(1e-3, |index| step_of(parameters[*index].unit, values[*index]));
                let shifted = |sign: f64| {
                    let (mut values, mut pixel) = (values.clone(), pixel);
                    match own.get(k) {
                        Some(index) => values[*index] += sign * step,
                        None => pixel[k - own.len()] += sign * step,
                    }
                    at(&values, pixel)
                };
                let (high, low) = (shifted(1.0), shifted(-1.0));
                for axis in 0..3 {
                    let slope = if k < own.len() { seen.by_parameter[k][axis] } else { seen.by_pixel[axis][k - own.len()] };
                    pairs[k].push([slope, (high[axis] - low[axis]) / (2.0 * step), step]);
                }
            }
        }
        for (k, pairs) in pairs.into_iter().enumerate() {
            let name = own.get(k).map_or("the pixel", |index| parameters[*index].name.as_str());
            let size = pairs.iter().fold(0.0_f64, |most, [slope, _, _]| most.max(slope.abs()));
            assert!(size > 0.0, "{id}: the direction does not depend on {name}");
            for [slope, difference, step] in pairs {
                assert!((difference - slope).abs() < 1e-5 * size + 1e-15 / step, "{id}, {name}: {difference} ≠ {slope}");
            }
        }
    }
}

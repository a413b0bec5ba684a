//! Scene files: what is read, and what is refused in which words.

use boresight::catalog::Catalog;
use boresight::effects::pixel::PIXEL_EFFECTS;
use boresight::imaging::Backend;
use boresight::render::Renderer;
use boresight::scene::{DEMO_TOML, PRESETS, Scene, schema};

fn refusal(change: &str, to: &str) -> String {
    assert!(DEMO_TOML.contains(change), "the demo scene has no {change:?}");
    Scene::parse("scene.toml", &DEMO_TOML.replace(change, to)).unwrap_err().to_string()
}

#[test]
fn the_demo_scene_is_what_it_says() {
    let scene = Scene::demo().unwrap();
    assert_eq!(scene.exposures.len(), 12);
    assert!((scene.nominal.focal_length_px / scene.camera.focal_length_px - 1.004).abs() < 1e-12);
    let sin_lowest = 35.0_f64.to_radians().sin();
    for exposure in scene.exposures.iter() {
        assert_eq!(exposure.sky.ids(), ["proper-motion", "parallax", "light-deflection", "stellar-aberration", "refraction"]);
        let zenith = exposure.sky.observation().zenith.unwrap();
        let boresight = exposure.attitude.rows()[2];
        assert!((0..3).map(|axis| zenith[axis] * boresight[axis]).sum::<f64>() >= sin_lowest);
    }
}

#[test]
fn the_seed_decides_the_pointings() {
    let attitudes = |seed| {
        let scene = Scene::parse_with_seed("scene.toml", DEMO_TOML, seed).unwrap();
        scene.exposures.iter().map(|exposure| exposure.attitude).collect::<Vec<_>>()
    };
    assert_eq!(attitudes(1), attitudes(1));
    assert_ne!(attitudes(1), attitudes(2));
}

#[test]
fn bad_scenes_get_one_clear_sentence() {
    for (change, to, parts) in [
        ("psf_sigma_px", "psf_sigma", &["line ", "unknown key psf_sigma; did you mean psf_sigma_px?"][..]),
        ("psf_sigma_px = 1.1", "psf_sigma_px = -1.0", &["detector.psf_sigma_px = -1", "above 0"][..]),
        ("psf_sigma_px = 1.1", "psf_sigma_px = nan", &["detector.psf_sigma_px = NaN", "above 0"][..]),
        ("width_px = 1024", "width_px = 1", &["camera.width_px = 1", "between 16 and 16384"][..]),
        ("width_px = 1024", "width_px = \"wide\"", &["line 6", "invalid type"][..]),
        ("boresight-scene/1", "boresight-scene/9", &["format = \"boresight-scene/9\"", "boresight-scene/1"][..]),
        ("\"known\"", "\"refractoin\"", &["did you mean refraction?"][..]),
        ("2026-03-01T20:00:00Z", "yesterday", &["series.start_utc = \"yesterday\"", "is no time"][..]),
        ("2026-03-01T20:00:00Z", "2226-03-01T20:00:00Z", &["1900–2100"][..]),
        ("principal_point_px = [518.3, 506.1]", "principal_point_px = [nan, 506.1]", &["camera.principal_point_px = [NaN, 506.1]"][..]),
        ("k1 = 6.0e-9", "k1 = 1.0e-2", &["folds over within the frame"][..]),
        ("count = 12", "count = 0", &["series.count = 0", "between 1 and"][..]),
        ("[series]", "[serie]", &["unknown key serie; did you mean series?"][..]),
        ("seed = 20260301", "seed = ", &["line 3"][..]),
        ("latitude_deg = 37.22", "latitude_deg = 137.22", &["site.latitude_deg = 137.22", "between -90 and 90"][..]),
    ] {
        let message = refusal(change, to);
        assert!(message.starts_with("scene.toml: ") && !message.contains('\n'), "{message}");
        for part in parts {
            assert!(message.contains(part), "{part:?} is not in: {message}");
        }
    }
}

/// The demo scene with more at its end.
fn demo_with(more: &str) -> Scene {
    Scene::parse("scene.toml", &format!("{DEMO_TOML}\n{more}")).unwrap()
}

#[test]
fn any_displacement_moves_the_stars_of_a_scene() {
    let catalog = Catalog::embedded();
    let plain = Scene::demo().unwrap();
    let aspect = demo_with("[[effects]]\nid = \"pixel-aspect\"\nparameters = { epsilon = 1e-3 }");
    let images = |scene: &Scene| scene.star_images(catalog, 3, 0.0);
    let (before, after) = (images(&plain), images(&aspect));
    let mut compared = 0;
    for star in &before {
        let Some(moved) = after.iter().find(|other| other.hip == star.hip) else { continue };
        // fx/fy − 1 = ε: half of it in x, half of it against y, from the principal point.
        let expected = [0.5e-3 * (star.position.x_px - 518.3), -0.5e-3 * (star.position.y_px - 506.1)];
        let found = [moved.position.x_px - star.position.x_px, moved.position.y_px - star.position.y_px];
        for axis in 0..2 {
            assert!((found[axis] - expected[axis]).abs() < 5e-3, "HIP {}: {found:?} instead of {expected:?}", star.hip);
        }
        compared += 1;
    }
    assert!(compared > 100, "{compared}");
    // Switched to nothing an effect is there and does nothing; one of the sky takes the place of its known size.
    let idle = demo_with("[[effects]]\nid = \"shear\"\nparameters = { shear_rad = 0.0 }");
    assert!(images(&idle).iter().zip(&before).all(|(a, b)| a.hip == b.hip && (a.position.x_px - b.position.x_px).abs() < 1e-7));
    let still = demo_with("[[effects]]\nid = \"stellar-aberration\"\nparameters = { amplitude = 0.0 }");
    assert_eq!(still.exposures.get(0).sky.ids(), plain.exposures.get(0).sky.ids());
    let shift = images(&still)[0].position.x_px - before[0].position.x_px;
    assert!(shift.abs() > 1e-3, "the stars are not aberrated: {shift}");
}

#[test]
fn rows_of_a_turning_camera_see_other_skies() {
    let frame = "boresight_radec_deg = [83.0, 5.0]\nexposure_s = 0.1";
    let text = |rate: &str, effects: &str| {
        let start = DEMO_TOML.find("[site]").unwrap();
        format!("{}\n[[frames]]\n{frame}\n{rate}\n{effects}", &DEMO_TOML[..start])
    };
    let shutter = "[[effects]]\nid = \"rolling-shutter\"\nparameters = { line_time_us = 12.0 }";
    let [still, turning] = ["rate_deg_s = [0.0, 0.0, 0.0]", "rate_deg_s = [0.0, 1.0, 0.0]"]
        .map(|rate| Scene::parse("scene.toml", &text(rate, shutter)).unwrap());
    let [before, after] = [&still, &turning].map(|scene| scene.star_images(Catalog::embedded(), 0, 0.0));
    let mut largest: f64 = 0.0;
    for star in &before {
        let Some(moved) = after.iter().find(|other| other.hip == star.hip) else { continue };
        // A turn about y by ω·t moves the image along x by f·ω·t; t is that of the row.
        let expected = 2900.0 * 1.0_f64.to_radians() * 12e-6 * (star.position.y_px - 511.5);
        let found = moved.position.x_px - star.position.x_px;
        assert!((found.abs() / expected.abs() - 1.0).abs() < 0.1 || expected.abs() < 0.02, "{found} instead of {expected}");
        largest = largest.max(found.abs());
    }
    assert!(largest > 0.2, "{largest}");
    assert_eq!(turning.exposures.get(0).telemetry.rate_deg_s, Some([0.0, 1.0, 0.0]));
}

#[test]
fn bad_effects_get_one_clear_sentence() {
    for (more, parts) in [
        ("[[effects]]\nid = \"sheer\"", &["effects[0]", "did you mean shear?"][..]),
        ("[[effects]]\nid = \"shear\"\nparameters = { sheer = 1.0 }", &["shear has no parameter sheer; it has shear_rad"][..]),
        ("[[effects]]\nid = \"bloomin\"", &["effects[0]", "did you mean blooming?"][..]),
        (
            "[[effects]]\nid = \"blooming\"\nparameters = { drain = 1.0 }",
            &["blooming has no parameter drain; it has full_well_e, drained"][..],
        ),
        ("[[effects]]\nid = \"blooming\"\nparameters = { drained = 2.0 }", &["blooming.drained = 2 must lie between 0 and 1"][..]),
        ("[[effects]]\nid = \"blooming\"\n[[effects]]\nid = \"blooming\"", &["effects[1]", "blooming is listed twice"][..]),
        ("[[effects]]\nid = \"pinhole\"", &["pinhole is part of [camera]"][..]),
        ("[[effects]]\nid = \"brown-conrady\"", &["brown-conrady is part of [camera]"][..]),
        (
            "[[effects]]\nid = \"shear\"\nparameters = { shear_rad = 1e-4 }\n[[effects]]\nid = \"shear\"\nparameters = { shear_rad = 1e-4 }",
            &["effects[1]", "shear is listed twice"][..],
        ),
        ("[[effects]]\nid = \"rolling-shutter\"\nparameters = { line_time_us = 1e9 }", &["line_time_us = 1000000000 must lie between"][..]),
    ] {
        let message = Scene::parse("scene.toml", &format!("{DEMO_TOML}\n{more}")).unwrap_err().to_string();
        assert!(message.starts_with("scene.toml: ") && !message.contains('\n'), "{message}");
        for part in parts {
            assert!(message.contains(part), "{part:?} is not in: {message}");
        }
    }
}

/// `[[effects]]` takes pixel effects too: by either spelling, with what `[detector]` has, in the place of the everyday ones; what does nothing
/// is left out, and where a cause is a displacement too the names of the parameters decide.
#[test]
fn pixel_effects_of_a_scene_are_those_of_its_camera_and_those_listed() {
    let ids = |scene: &Scene| scene.pixel_effects.iter().map(|effect| effect.id.clone()).collect::<Vec<_>>();
    let of = |scene: &Scene, id: &str, name: &str| {
        let effect = scene.pixel_effects.iter().find(|effect| effect.id == id).unwrap_or_else(|| panic!("{id} is not in force"));
        effect.parameters.iter().find(|(other, _)| other == name).unwrap_or_else(|| panic!("{id} has no {name}")).1
    };
    let usual = ["background", "photon-noise", "read-noise", "adc"];
    assert_eq!(ids(&Scene::demo().unwrap()), usual);
    for id in ["charge-transfer-inefficiency", "charge_transfer_inefficiency"] {
        let traps = demo_with(&format!("[[effects]]\nid = \"{id}\"\nparameters = {{ traps_per_px = 0.7 }}"));
        assert_eq!(ids(&traps), [&usual[..], &["charge-transfer-inefficiency"]].concat());
        assert_eq!(of(&traps, "charge-transfer-inefficiency", "traps_per_px"), 0.7);
        assert_eq!(of(&traps, "charge-transfer-inefficiency", "full_well_e"), 1e5);
        assert!(traps.model.is_reference_behind_the_lens());
        let moved = demo_with(&format!("[[effects]]\nid = \"{id}\"\nparameters = {{ px_at_far_row_10000e = 0.03 }}"));
        assert_eq!(ids(&moved), usual);
        assert!(!moved.model.is_reference_behind_the_lens());
    }
    let blooming = demo_with("[[effects]]\nid = \"blooming\"");
    assert_eq!(of(&blooming, "blooming", "full_well_e"), 1e5);
    let noisy = demo_with("[[effects]]\nid = \"read-noise\"\nparameters = { read_noise_e = 9.0 }");
    assert_eq!(ids(&noisy), ["background", "photon-noise", "adc", "read-noise"]);
    assert_eq!(of(&noisy, "read-noise", "read_noise_e"), 9.0);
    assert_eq!(ids(&demo_with("[[effects]]\nid = \"charge-transfer-inefficiency\"\nparameters = { traps_per_px = 0.0 }")), usual);
}

/// An effect that is listed and would do nothing is refused, not dropped.
#[test]
fn an_effect_without_parameters_is_refused() {
    // A pixel effect, a displacement, and a cause that is both.
    for (id, names) in [("banding", ["row_sigma_e", ""]), ("shear", ["shear_rad", ""]), ("bayer", ["relative_per_mag", "red_relative"])] {
        let text = format!("{DEMO_TOML}\n[[effects]]\nid = \"{id}\"\n");
        let error = Scene::parse("scene.toml", &text).unwrap_err().to_string();
        assert!(error.contains(&format!("{id} does nothing without parameters")), "{error}");
        assert!(names.iter().all(|name| error.contains(name)), "{error}");
    }
}

/// What a scene lists reaches the counts, with the temperature of each frame, on any number of threads.
#[test]
fn listed_effects_reach_the_counts() {
    let start = DEMO_TOML.find("[site]").unwrap();
    let camera = DEMO_TOML[..start].replace("width_px = 1024", "width_px = 96").replace("height_px = 1024", "height_px = 80");
    let camera = camera.replace("principal_point_px = [518.3, 506.1]", "");
    let frame =
        |temperature_c: f64| format!("[[frames]]\nboresight_radec_deg = [83.0, 5.0]\nexposure_s = 0.1\ntemperature_c = {temperature_c}\n");
    let dark = "[[effects]]\nid = \"dark-current\"\nparameters = { dark_e_per_px_s = 2000.0, dsnu_relative = 0.2 }\n";
    let bright = "[[effects]]\nid = \"blooming\"\nparameters = { full_well_e = 450.0 }\n[[effects]]\nid = \"jpeg\"\n";
    let rendered = |effects: &str, threads: usize| {
        let text = format!("{camera}\n{}{}{effects}", frame(20.0), frame(26.5));
        let scene = Scene::parse("scene.toml", &text).unwrap();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let renderer = Renderer::new(&scene, Catalog::embedded(), Backend::Cpu).unwrap();
            [0, 1].map(|index| renderer.render(index).unwrap().pixels_dn)
        })
    };
    let median = |pixels: &[u16]| {
        let mut sorted = pixels.to_vec();
        sorted.sort_unstable();
        f64::from(sorted[sorted.len() / 2])
    };
    let plain = rendered("", 1).map(|pixels| median(&pixels));
    let [cool, warm] = rendered(dark, 1).map(|pixels| median(&pixels));
    // 200 and 400 electrons at 2 electrons a count; the log-normal grain has its median 2 % below its mean.
    assert!((cool - plain[0] - 98.0).abs() < 3.0 && (warm - plain[1] - 196.0).abs() < 5.0, "{plain:?} {cool} {warm}");
    let all = format!("{dark}{bright}");
    assert_eq!(rendered(&all, 1), rendered(&all, 2));
    assert_ne!(rendered(&all, 1), rendered(dark, 1));
}

/// Every preset is a scene that shows stars, of which the brightest stand out of the noise and do not fill the frame.
#[test]
fn presets_show_stars() {
    for preset in PRESETS {
        let scene = Scene::parse(preset.name, preset.toml).unwrap();
        assert!(preset.title().len() > 20 && preset.toml.contains("Assumed:"), "{} says where its numbers come from", preset.name);
        let frame = Renderer::new(&scene, Catalog::embedded(), Backend::Cpu).unwrap().render(0).unwrap();
        let sky = scene.sky.even_e_per_px_s() * scene.exposures.get(0).exposure_s;
        let noise_e = (sky + scene.detector.read_noise_e.powi(2)).sqrt();
        let seen = frame.stars.iter().filter(|star| star.peak_electrons > 5.0 * noise_e).count();
        assert!(seen >= 5, "{}: {seen} of {} stars stand out", preset.name, frame.stars.len());
        let full = scene.detector.full_pixel_dn();
        let filled = frame.pixels_dn.iter().filter(|dn| f64::from(**dn) >= full).count();
        assert!(filled * 1000 < frame.pixels_dn.len(), "{}: {filled} pixels are full", preset.name);
    }
}

/// A fisheye shows the sky down to its circle: stars lie where the projection says, and none beyond 95 degrees from the axis.
#[test]
fn a_fisheye_is_rendered_by_its_own_projection() {
    let fisheye = PRESETS.iter().find(|preset| preset.name == "all-sky-fisheye").unwrap();
    let scene = Scene::parse(fisheye.name, fisheye.toml).unwrap();
    let stars = scene.star_images(Catalog::embedded(), 0, 0.0);
    assert!(stars.len() > 1000, "{} stars over half the sky", stars.len());
    let farthest = stars.iter().map(|star| (star.position.x_px - 1547.5).hypot(star.position.y_px - 1039.5)).fold(0.0, f64::max);
    // f·θ: the corner of the frame, 1865 px out, would be at 183 degrees, but the ground begins at 85 to 95.
    assert!(farthest > 900.0 && farthest <= 583.3 * 95.1_f64.to_radians(), "{farthest} px");
    let error = Scene::parse("s", &fisheye.toml.replace("\"equidistant\"", "\"fish\"")).unwrap_err().to_string();
    assert!(error.contains("camera.projection") && error.contains("equisolid"), "{error}");
}

/// The ground hides the stars below the horizon, and none above it: their altitudes by the mean sidereal time of Meeus, Astronomical Algorithms (1998),
/// chapter 12, which leaves out a third of a degree of precession since 2000.
#[test]
fn stars_below_the_horizon_have_no_image() {
    let (latitude_deg, longitude_deg) = (40.0_f64, 20.0_f64);
    let seen = |site: &str| {
        let text = format!(
            "format = \"boresight-scene/1\"\ncamera = {{ width_px = 900, height_px = 900, focal_length_px = 500.0 }}\n\
             sky = {{ faintest_magnitude = 5.0, physics = \"none\" }}\n{site}\n[[frames]]\ntime_utc = \"2026-03-01T22:00:00Z\"\n\
             exposure_s = 1.0\nboresight_radec_deg = [75.0, 5.0]\n"
        );
        let scene = Scene::parse("scene.toml", &text).unwrap();
        scene.star_images(Catalog::embedded(), 0, 0.0).into_iter().map(|star| star.hip).collect::<Vec<_>>()
    };
    let all = seen("");
    let above = seen(&format!("site = {{ latitude_deg = {latitude_deg:?}, longitude_deg = {longitude_deg:?} }}"));
    // 2026-03-01T22:00 UT is 2 461 101.416 667 JD.
    let sidereal_deg = (280.460_618_37 + 360.985_647_366_29 * (2_461_101.0 + 5.0 / 12.0 - 2_451_545.0) + longitude_deg).rem_euclid(360.0);
    let (mut up, mut down) = (0, 0);
    for star in Catalog::embedded().stars.iter().filter(|star| all.contains(&star.hip)) {
        let [x, y, z] = star.direction.xyz;
        let hour_angle = sidereal_deg.to_radians() - y.atan2(x);
        let sine = latitude_deg.to_radians().sin() * z + latitude_deg.to_radians().cos() * (1.0 - z * z).sqrt() * hour_angle.cos();
        let altitude_deg = sine.asin().to_degrees();
        if altitude_deg.abs() > 0.5 {
            assert_eq!(above.contains(&star.hip), altitude_deg > 0.0, "HIP {} at {altitude_deg}°", star.hip);
            *(if altitude_deg > 0.0 { &mut up } else { &mut down }) += 1;
        }
    }
    assert!(up > 50 && down > 50, "{up} stars above the horizon and {down} below it");
}

/// The schema knows every key of every preset, every effect with its parameters, and nothing beside.
#[test]
fn the_schema_is_that_of_the_files() {
    fn check(schema: &serde_json::Value, of: &serde_json::Value, value: &toml::Value, path: &str) {
        let of = of.get("$ref").map_or(of, |reference| schema.pointer(&reference.as_str().unwrap()[1..]).unwrap());
        let of = of.get("anyOf").map_or(of, |any| &any[0]);
        let of = of.get("$ref").map_or(of, |reference| schema.pointer(&reference.as_str().unwrap()[1..]).unwrap());
        match value {
            toml::Value::Table(table) => {
                // An effect is one of many, told by its id.
                let is_this =
                    |one: &&serde_json::Value| one["properties"]["id"]["const"].as_str() == table.get("id").and_then(toml::Value::as_str);
                let of = of["oneOf"].as_array().map_or(of, |all| all.iter().find(is_this).unwrap_or_else(|| panic!("{path}: {table:?}")));
                assert_eq!(of["additionalProperties"], serde_json::json!(false), "{path}");
                for (key, value) in table {
                    let own = of["properties"].get(key).unwrap_or_else(|| panic!("{path}.{key} is not in the schema"));
                    check(schema, own, value, &format!("{path}.{key}"));
                }
            }
            toml::Value::Array(list) => list.iter().for_each(|value| check(schema, &of["items"], value, path)),
            _ => assert!(
                of.get("type").is_some() || of.get("const").is_some() || of.get("enum").is_some() || of.get("oneOf").is_some(),
                "{path}: {of}"
            ),
        }
    }
    let schema = schema();
    for preset in PRESETS {
        check(&schema, &schema, &toml::from_str(preset.toml).unwrap(), preset.name);
    }
    let effects = schema["$defs"]["EffectTable"]["oneOf"].as_array().unwrap();
    for id in boresight::effects::DISPLACEMENTS
        .iter()
        .map(|effect| effect.id().to_owned())
        .chain(PIXEL_EFFECTS.iter().map(|effect| effect.id().replace('_', "-")))
    {
        let count = effects.iter().filter(|effect| effect["properties"]["id"]["const"] == serde_json::json!(id)).count();
        assert_eq!(count, 1, "{id}");
    }
}

//! Scene files: what is read, and what is refused in which words.

use boresight::scene::{DEMO_TOML, Scene};

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
    for exposure in &scene.exposures {
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

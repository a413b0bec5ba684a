//! Columns of effects on pixels that are rendered with the recording's own stars, from frames to names.

use serde_json::Value;

use crate::cli::{number, run, text};

/// Ten frames of a small tracker, of which the sensor loses charge in transfer as after years of radiation.
const SCENE: &str = r#"
format = "boresight-scene/1"
seed = 7
camera = { width_px = 512, height_px = 512, focal_length_px = 1600.0, principal_point_px = [258.3, 252.1] }
sky = { background_e_per_px_s = 250.0, faintest_magnitude = 7.2, physics = "known" }
[nominal]
focal_length_px = 1600.0
[detector]
psf_sigma_px = 0.9
zero_point_e_per_s = 2.0e6
gain_e_per_dn = 2.0
bias_dn = 200.0
read_noise_e = 5.0
saturation_dn = 65535.0
full_well_e = 2.0e5
[series]
count = 10
start_utc = "2026-03-01T20:00:00Z"
interval_s = 900.0
exposure_s = 0.5
[[effects]]
id = "charge-transfer-inefficiency"
parameters = { traps_per_px = 8.0, release_px = 2.0, second_traps_per_px = 0.0, serial_traps_per_px = 0.0 }
"#;

fn diagnosed(recording: &std::path::Path, more: &[&str]) -> Value {
    let args = [&["diagnose", text(recording), "--physics", "known", "--nulls", "100", "--quiet", "--json"], more].concat();
    let ran = run(&args);
    serde_json::from_str(&ran.stdout).unwrap_or_else(|error| panic!("{error}: {} {}", ran.stdout, ran.stderr))
}

/// Traps in the silicon move stars by another law than the formula's root of the flux. Rendered with the recording's own stars they are one
/// effect and explain everything; by the formula the recording is several things, or unexplained.
#[test]
fn traps_are_one_effect_where_they_are_rendered_and_several_by_the_formula() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, recording) = (folder.path().join("scene.toml"), folder.path().join("night"));
    std::fs::write(&scene, SCENE).unwrap();
    assert_eq!(run(&["simulate", text(&scene), "-o", text(&recording), "--backend", "cpu", "--quiet"]).code, 0);
    let names = |object: &Value| -> Vec<String> {
        object["findings"].as_array().unwrap().iter().map(|finding| finding["id"].as_str().unwrap().to_owned()).collect()
    };
    let camera = folder.path().join("found.toml");
    let rendered = diagnosed(&recording, &["--write-camera", text(&camera)]);
    let by_formula = diagnosed(&recording, &["--formulas"]);
    let left = |object: &Value| number(object, "/fit/final/chi2_per_dof");
    println!("rendered: {:?} {}; by formulas: {:?} {}", names(&rendered), left(&rendered), names(&by_formula), left(&by_formula));
    // Of brightness and shape the columns are formulas, which leave something of such traps: no other name is given to it.
    let positions = rendered["channels"]["astrometry"]["verdict"].as_str();
    assert_eq!((positions, names(&rendered)), (Some("explained"), vec!["charge-transfer-inefficiency".to_owned()]));
    let finding = &rendered["findings"][0];
    assert_eq!(finding["columns"], "rendered");
    assert!(finding["sentence"].as_str().unwrap().contains("rendered"), "{}", finding["sentence"]);
    assert!(number(finding, "/snr") > 20.0 && number(finding, "/held_out_delta_chi2") > 500.0, "{finding}");
    assert!((left(&rendered) - 1.0).abs() < 0.05, "{}", left(&rendered));
    let warnings = |object: &Value| object["warnings"].to_string();
    assert!(warnings(&rendered).contains("by the formula of charge-transfer-inefficiency"), "{}", warnings(&rendered));
    assert!(by_formula["verdict"] == "unexplained" || names(&by_formula) != names(&rendered), "the formula does as well");
    assert!(by_formula["findings"].as_array().unwrap().iter().all(|finding| finding["columns"] == "formula"));
}

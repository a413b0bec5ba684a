//! What the pixels of a recording show, written as a scene that renders it.

use serde_json::Value;

use crate::cli::{run, text};

/// A tracker that loses light in the corners and in the red, and offsets its rows.
const SCENE: &str = r#"
format = "boresight-scene/1"
seed = 11
camera = { width_px = 448, height_px = 448, focal_length_px = 1200.0 }
sky = { background_e_per_px_s = 400.0, faintest_magnitude = 7.4, physics = "known" }
[nominal]
focal_length_px = 1200.0
[detector]
psf_sigma_px = 1.0
zero_point_e_per_s = 2.0e6
gain_e_per_dn = 2.0
bias_dn = 200.0
read_noise_e = 5.0
saturation_dn = 65535.0
full_well_e = 1.3e5
colour_term_mag_per_mag = 0.25
[series]
count = 10
start_utc = "2026-03-01T20:00:00Z"
interval_s = 900.0
exposure_s = 0.5
[[effects]]
id = "vignetting"
parameters = { loss_at_corner = 0.4 }
[[effects]]
id = "banding"
parameters = { row_sigma_e = 3.0 }
"#;

fn diagnosed(recording: &std::path::Path, more: &[&str]) -> Value {
    let args = [&["diagnose", text(recording), "--physics", "known", "--nulls", "100", "--quiet", "--json"], more].concat();
    let ran = run(&args);
    serde_json::from_str(&ran.stdout).unwrap_or_else(|error| panic!("{error}: {} {}", ran.stdout, ran.stderr))
}

/// The first parameter of a finding and its standard error.
fn found(diagnosis: &Value, id: &str) -> [f64; 2] {
    let findings = diagnosis["findings"].as_array().unwrap();
    let own = findings.iter().find(|own| own["id"] == id).unwrap_or_else(|| panic!("{id} is not among {findings:?}"));
    ["value", "sigma"].map(|name| own["parameters"][0][name].as_f64().unwrap())
}

/// Every channel has its pictures, and what they are drawn from shows the light that the corners lose and the round images.
fn channels_are_drawn(folder: &std::path::Path, diagnosis: &Value) {
    let of_stars = ["brightness-field-radius", "brightness-magnitude", "brightness-colour", "size-field-radius", "size-colour", "shape"];
    for name in of_stars.into_iter().chain(["photon-transfer", "rows", "columns", "background", "fixed-pattern"]) {
        let (width, height) = image::image_dimensions(folder.join(format!("{name}.png"))).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert!(width >= 500 && height >= 400, "{name}: {width} × {height}");
    }
    let profiles = diagnosis["image_profiles"].as_array().unwrap();
    let own = profiles.iter().find(|own| own["unit"] == "mag" && own["covariate"] == "field-radius").unwrap();
    let bins: Vec<[f64; 4]> = own["bins"]
        .as_array()
        .unwrap()
        .iter()
        .map(|bin| ["at", "mean", "sigma", "model"].map(|name| bin[name].as_f64().unwrap()))
        .collect();
    let lost_mag = |radius: f64| -2.5 * (1.0 - 0.4 * radius * radius).log10();
    let ([inner, outer], count) = ([bins[0], bins[bins.len() - 1]], bins.len() as f64);
    let (rise, expected) = (outer[1] - inner[1], lost_mag(outer[0]) - lost_mag(inner[0]));
    // The means hold the colours of their stars too: 0.25 mag per magnitude of a scatter of 0.6 mag, of about 40 stars at each end.
    let of_colours = 0.25 * 0.6 * (2.0_f64 / 40.0).sqrt();
    assert!((rise - expected).abs() < 4.0 * outer[2].hypot(inner[2]) + of_colours, "{rise} {expected}: {bins:?}");
    let chi2: f64 = bins.iter().map(|[_, mean, sigma, model]| ((mean - model) / sigma).powi(2)).sum();
    assert!(chi2 < count + 4.0 * (2.0 * count).sqrt(), "{chi2}: {bins:?}");
    for cell in diagnosis["shape_map"].as_array().unwrap() {
        let number = |name: &str| cell[name].as_f64().unwrap();
        assert!((number("width_px") - 1.04).abs() < 0.05 + 4.0 * number("width_sigma_px"), "{cell}");
        for component in cell["ellipticity"].as_array().unwrap() {
            assert!(component.as_f64().unwrap().abs() < 0.02 + 4.5 * number("ellipticity_sigma"), "{cell}");
        }
    }
}

/// The scene that is written has the truth's numbers, and what it renders shows the same once more.
#[test]
fn what_pixels_show_is_written_and_rendered_again() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("scene.toml"), SCENE).unwrap();
    let simulate = |scene: &str, out: &str| {
        let ran = run(&["simulate", text(&at(scene)), "-o", text(&at(out)), "--quiet", "--backend", "cpu"]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
    };
    simulate("scene.toml", "first");
    let first = diagnosed(&at("first"), &["--write-camera", text(&at("found.toml")), "-o", text(&at("pictures"))]);
    channels_are_drawn(&at("pictures"), &first);
    let written: toml::Value = toml::from_str(&std::fs::read_to_string(at("found.toml")).unwrap()).unwrap();
    let stage = |id: &str, name: &str| {
        let effects = written["effects"].as_array().unwrap();
        let own = effects.iter().find(|own| own["id"].as_str() == Some(id)).unwrap_or_else(|| panic!("{id} is not among {effects:?}"));
        own["parameters"][name].as_float().unwrap()
    };
    let loss = stage("vignetting", "loss_at_corner");
    assert!((loss - 0.4).abs() < 0.02, "{written}");
    assert!((stage("banding", "row_sigma_e") - 3.0).abs() < 0.2, "{written}");
    assert!((written["detector"]["colour_term_mag_per_mag"].as_float().unwrap() - 0.25).abs() < 0.03, "{written}");
    simulate("found.toml", "second");
    let second = diagnosed(&at("second"), &[]);
    for id in ["vignetting", "passband", "banding"] {
        let ([one, sigma], [other, other_sigma]) = (found(&first, id), found(&second, id));
        assert!((one - other).abs() < 4.0 * sigma.hypot(other_sigma) + 0.02 * one.abs(), "{id}: {one} ± {sigma}, {other} ± {other_sigma}");
    }
}

/// A recording that declares nothing of its detector: gain, sky and stars that are written have the counts of the frames, whatever the gain.
#[test]
fn a_detector_that_nobody_declares_keeps_its_counts() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("scene.toml"), SCENE).unwrap();
    let ran = run(&["simulate", text(&at("scene.toml")), "-o", text(&at("first")), "--quiet", "--backend", "cpu"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let recording = at("first").join("recording.toml");
    let declared = std::fs::read_to_string(&recording).unwrap();
    let of_detector = ["gain_e_per_dn", "bias_dn", "read_noise_e", "zero_point_e_per_s"];
    let left: Vec<&str> = declared.lines().filter(|line| of_detector.iter().all(|name| !line.starts_with(name))).collect();
    assert_eq!(left.len() + of_detector.len(), declared.lines().count());
    std::fs::write(&recording, left.join("\n")).unwrap();
    diagnosed(&at("first"), &["--write-camera", text(&at("found.toml"))]);
    let written: toml::Value = toml::from_str(&std::fs::read_to_string(at("found.toml")).unwrap()).unwrap();
    let number = |table: &str, name: &str| written[table][name].as_float().unwrap();
    let gain = number("detector", "gain_e_per_dn");
    assert!((gain - 2.0).abs() < 0.1, "{written}");
    // Bias and sky together, less what the corners lose of the sky; and the stars' light, of which the typical one loses a tenth.
    let level_dn = number("sky", "background_e_per_px_s") * 0.5 / gain;
    assert!((265.0..300.0).contains(&level_dn), "{level_dn}: {written}");
    let star_dn_s = number("detector", "zero_point_e_per_s") / gain;
    assert!((0.75e6..1.05e6).contains(&star_dn_s), "{star_dn_s}: {written}");
}

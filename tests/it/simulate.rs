//! `boresight simulate`: parts of a scene, the forms of image files, and what the truth tells.

use std::path::Path;

use boresight::recording::Recording;
use serde_json::Value;

use crate::cli::{run, text};

const SCENE: &str = "# A comment stays.\nformat = \"boresight-scene/1\"\nseed = 3\n\
    camera = { width_px = 96, height_px = 64, focal_length_px = 300.0 }\ndetector = { bits = 12, gain_e_per_dn = 8.0 }\nsky = { physics = \"none\" }\n\
    [[effects]]\nid = \"prnu\"\nparameters = { relative = 0.01 }\n[[effects]]\nid = \"zodiacal-light\"\n\
    [series]\ncount = 5\nexposure_s = 1.0\nstart_utc = \"2026-03-01T22:00:00Z\"\n";

fn simulated(folder: &Path, scene: &str, name: &str, more: &[&str]) -> std::path::PathBuf {
    let (path, target) = (folder.join("scene.toml"), folder.join(name));
    std::fs::write(&path, scene).unwrap();
    let ran = run(&[&["simulate", text(&path), "-o", text(&target), "--backend", "cpu", "--quiet"], more].concat());
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    target
}

fn pixels(recording: &Path, frame: usize) -> Vec<f32> {
    Recording::open(&[recording]).unwrap().load_frame(frame).unwrap().pixels_dn
}

fn truth(recording: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(recording.join("truth/truth.json")).unwrap()).unwrap()
}

#[test]
fn a_part_of_a_scene_has_the_frames_names_and_numbers_of_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let whole = simulated(folder.path(), SCENE, "whole", &["--masks"]);
    let part = simulated(folder.path(), SCENE, "part", &["--frames", "2..4", "--masks"]);
    assert_eq!(std::fs::read_to_string(part.join("truth/scene.toml")).unwrap(), SCENE);
    for name in ["frames/0002.fits", "frames/0003.fits", "truth/masks/0003.fits"] {
        assert!(std::fs::read(whole.join(name)).unwrap() == std::fs::read(part.join(name)).unwrap(), "{name}");
    }
    assert!(!part.join("frames/0001.fits").exists() && !part.join("frames/0004.fits").exists());
    let recording = Recording::open(&[&part]).unwrap();
    assert_eq!(recording.frames.len(), 2);
    let (of_whole, of_part) = (truth(&whole), truth(&part));
    assert_eq!(of_part["frames"].as_array().unwrap(), &of_whole["frames"].as_array().unwrap()[2..4]);
    assert_eq!((&of_part["frames"][0]["frame"], &of_part["frames"][0]["file"]), (&Value::from(2), &Value::from("frames/0002.fits")));
    let rows = |path: &Path| std::fs::read_to_string(path.join("truth/stars.csv")).unwrap();
    let kept = rows(&whole).lines().filter(|row| row.starts_with("2,") || row.starts_with("3,")).map(str::to_owned).collect::<Vec<_>>();
    assert_eq!(rows(&part).lines().skip(1).collect::<Vec<_>>(), kept);
    let told: Value = serde_json::from_slice(&std::fs::read(part.join("simulate.json")).unwrap()).unwrap();
    assert_eq!((&told["first_frame"], &told["frames"]), (&Value::from(2), &Value::from(2)));
    // To the end and from the beginning.
    assert_eq!(Recording::open(&[simulated(folder.path(), SCENE, "end", &["--frames", "4.."])]).unwrap().frames.len(), 1);
    assert_eq!(Recording::open(&[simulated(folder.path(), SCENE, "begin", &["--frames", "..3"])]).unwrap().frames.len(), 3);
    let scene = folder.path().join("scene.toml");
    for (range, told) in [
        ("3..9", "--frames 3..9 is not within the scene, which has the exposures 0..5"),
        ("5..", "--frames 5.. is not within the scene, which has the exposures 0..5"),
        ("4..2", "there is no exposure from 4 up to and without 2"),
        ("4", "give two whole numbers with two dots between, as 0..25"),
        ("a..b", "give two whole numbers"),
    ] {
        let ran = run(&["simulate", text(&scene), "-o", text(&folder.path().join("no")), "--frames", range]);
        assert!(ran.code == 2 && ran.stderr.contains(told), "{range}: {} {}", ran.code, ran.stderr);
        assert!(!folder.path().join("no").exists());
    }
}

#[test]
fn every_form_of_image_holds_the_same_counts() {
    let folder = tempfile::tempdir().unwrap();
    let fits = simulated(folder.path(), SCENE, "fits", &["--frames", "0..2"]);
    let expected = pixels(&fits, 1);
    for (form, file, head) in [
        ("fits-rice", "frames/0001.fits", &b"SIMPLE"[..]),
        ("png16", "frames/0001.png", b"\x89PNG"),
        ("tiff16", "frames/0001.tiff", b"II*\0"),
        ("raw16", "frames/0001.raw", b""),
    ] {
        let made = simulated(folder.path(), SCENE, form, &["--frames", "0..2", "--image-format", form]);
        assert!(std::fs::read(made.join(file)).unwrap().starts_with(head), "{form}");
        assert!(pixels(&made, 1) == expected, "{form}");
    }
    let raw = folder.path().join("raw16");
    assert_eq!(std::fs::metadata(raw.join("frames/0000.raw")).unwrap().len(), 2 * 96 * 64);
    // Bare counts of another size are refused.
    std::fs::write(raw.join("frames/0000.raw"), vec![0; 100]).unwrap();
    let refused = run(&["detect", text(&raw)]);
    assert!(
        refused.code == 1 && refused.stderr.contains("it has 100 bytes, but 96 × 64 px of bare counts are 12288"),
        "{}",
        refused.stderr
    );
    let scene = folder.path().join("scene.toml");
    let deep = run(&["simulate", text(&scene), "-o", text(&folder.path().join("deep")), "--image-format", "png8"]);
    assert!(deep.code == 2 && deep.stderr.contains("have 12 and go up to 4095: choose png16, or detector.bits = 8"), "{}", deep.stderr);
    let shallow = SCENE.replace("bits = 12, gain_e_per_dn = 8.0", "bits = 8, gain_e_per_dn = 100.0, bias_dn = 10.0");
    let bytes = simulated(folder.path(), &shallow, "bytes", &["--image-format", "png8"]);
    let own = simulated(folder.path(), &shallow, "own", &[]);
    assert!(pixels(&bytes, 4) == pixels(&own, 4));
    assert_eq!(image::open(bytes.join("frames/0004.png")).unwrap().color(), image::ColorType::L8);
}

#[test]
fn the_truth_tells_pixel_effects_lights_of_the_sky_and_the_image_of_a_star_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let told = truth(&simulated(folder.path(), SCENE, "night", &["--frames", "0..1"]));
    assert_eq!(told["psf"]["kind"], "gaussian");
    assert_eq!(told["psf"]["parameters"]["sigma_px"], 1.2);
    let effects = told["pixel_effects"].as_array().unwrap();
    let of =
        |id: &str| &effects.iter().find(|effect| effect["id"] == id).unwrap_or_else(|| panic!("{id} is not in {effects:?}"))["parameters"];
    assert_eq!(of("prnu")["relative"], 0.01);
    assert_eq!(of("adc")["gain_e_per_dn"], 8.0);
    assert_eq!(of("read-noise")["read_noise_e"], 5.0);
    assert_eq!(told["sky_lights"][0]["id"], "zodiacal-light");
}

#[test]
fn an_effect_without_what_it_follows_is_refused_or_said() {
    let folder = tempfile::tempdir().unwrap();
    let scene = |more: &str, frame: &str| {
        format!(
            "format = \"boresight-scene/1\"\ncamera = {{ width_px = 96, height_px = 64, focal_length_px = 300.0 }}\nsky = {{ physics = \"none\" }}\n\
             {more}[[frames]]\nexposure_s = 1.0\nboresight_radec_deg = [10.0, 20.0]\n{frame}"
        )
    };
    let ran = |text_of_scene: &str| {
        let path = folder.path().join("s.toml");
        std::fs::write(&path, text_of_scene).unwrap();
        run(&["simulate", text(&path), "-o", text(&folder.path().join("night")), "--backend", "cpu", "--force"])
    };
    let thermal = "[[effects]]\nid = \"thermal-focal-length\"\nparameters = { relative_per_kelvin = 1e-5 }\n";
    let without = ran(&scene(thermal, ""));
    assert!(without.code == 1 && without.stderr.contains("the temperature of the frames is not known"), "{}", without.stderr);
    let same = ran(&scene(thermal, "temperature_c = 5.0\n"));
    assert!(
        same.code == 0 && same.stderr.contains("thermal-focal-length.relative_per_kelvin counts from the mean temperature"),
        "{}",
        same.stderr
    );
    let psf = "[psf]\nkind = \"gaussian\"\nparameters = { sigma_px = 1.0 }\n[[psf.vary]]\nparameter = \"sigma_px\"\ncoefficient = 0.1\ntemperature = 1\n";
    let cold = ran(&scene(psf, ""));
    assert!(cold.code == 1 && cold.stderr.contains("psf.vary[0]: the term follows the temperature and does nothing"), "{}", cold.stderr);
    let two = format!(
        "{}temperature_c = 5.0\n[[frames]]\nexposure_s = 1.0\nboresight_radec_deg = [10.0, 20.0]\ntemperature_c = 9.0\n",
        scene(thermal, "")
    );
    let differs = ran(&two);
    assert!(differs.code == 0 && !differs.stderr.contains("does nothing"), "{}", differs.stderr);
}

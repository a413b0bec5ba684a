//! `calibrate` from images: cameras that need more than k1, fisheyes, frames that are not of one camera, nights of which nobody tells the time.

use std::path::{Path, PathBuf};

use boresight::catalog::Catalog;
use boresight::imaging::Backend;
use boresight::recording::{Recording, write_png_u16};
use boresight::render::Renderer;
use boresight::scene::Scene;
use serde_json::Value;

use crate::cli::{json, number, run, short_night, text};
use crate::common::recordings_dir;

/// The frames of a scene as bare images, of which nothing else is known.
fn bare_images(scene: &str, directory: &Path, name: &str) -> Vec<PathBuf> {
    let scene = Scene::parse(name, scene).unwrap();
    let renderer = Renderer::new(&scene, Catalog::embedded(), Backend::Cpu).unwrap();
    (0..scene.exposures.len())
        .map(|index| {
            let frame = renderer.render(index).unwrap();
            let path = directory.join(format!("{name}-{index:02}.png"));
            write_png_u16(&path, scene.camera.width_px, scene.camera.height_px, &frame.pixels_dn).unwrap();
            path
        })
        .collect()
}

/// A lens of 50° with k1, k2 and k3 of 26, 5 and 1.5 px in the corners, pointed all over the sky.
fn wide_scene(seed: u64, camera: &str, frames: usize) -> String {
    format!(
        "format = \"boresight-scene/1\"\nseed = {seed}\n[camera]\n{camera}\n[detector]\npsf_sigma_px = 0.9\nzero_point_e_per_s = 2.0e5\n\
         gain_e_per_dn = 1.0\nbias_dn = 100.0\nread_noise_e = 5.0\nsaturation_dn = 65535.0\nfull_well_e = 60000.0\n\
         [sky]\nbackground_e_per_px_s = 20.0\nfaintest_magnitude = 7.0\nphysics = \"none\"\n\
         [series]\ncount = {frames}\nexposure_s = 1.0\n"
    )
}

fn parameter(object: &Value, name: &str) -> [f64; 2] {
    let all = object["parameters"].as_array().unwrap();
    let own = all.iter().find(|own| own["name"] == name).unwrap_or_else(|| panic!("{name} is not solved: {}", object["model"]));
    [number(own, "/value"), number(own, "/sigma")]
}

#[test]
fn the_default_solves_what_a_wide_lens_needs() {
    let folder = tempfile::tempdir().unwrap();
    let camera = "width_px = 800\nheight_px = 800\nfocal_length_px = 858.0\nprincipal_point_px = [404.0, 396.0]\nk1 = -1.63e-7";
    let scene = wide_scene(1, camera, 8) + "[[effects]]\nid = \"radial-high-order\"\nparameters = { k2_norm = 0.05, k3_norm = -0.03 }\n";
    let images = bare_images(&scene, folder.path(), "wide");
    let mut args = vec!["calibrate", "--json", "--physics", "none"];
    args.extend(images.iter().map(|path| text(path)));
    let object = json(&args);
    let [f, sigma] = parameter(&object, "f");
    println!("f {f:.3} ± {sigma:.3}, {}, rms {} px, {} star images", object["model"], object["rms_px"], object["stars"]);
    assert!((f - 858.0).abs() < 3.0 * sigma, "{f} ± {sigma}");
    assert!(object["model"].as_array().unwrap().iter().any(|name| name == "radial-high-order.k2_norm"), "{}", object["model"]);
    assert!(number(&object, "/rms_px") < 0.3, "{}", object["rms_px"]);
    args.extend(["--solve", "x0,y0,f,k1,p1,p2"]);
    let held = json(&args);
    let [f, sigma] = parameter(&held, "f");
    println!("    with k1 alone f {f:.3} ± {sigma:.3}, rms {} px", held["rms_px"]);
    assert!((f - 858.0).abs() > 5.0 * sigma, "k1 alone would do: {f} ± {sigma}");
    assert!(number(&object, "/held_out_rms_px") < number(&held, "/held_out_rms_px"));
}

#[test]
fn fisheyes_are_calibrated_from_images() {
    let folder = tempfile::tempdir().unwrap();
    for (law, seed) in [("equidistant", 3), ("equisolid", 4)] {
        let camera = format!(
            "width_px = 1100\nheight_px = 1000\nfocal_length_px = 310.0\nprincipal_point_px = [553.0, 497.0]\nprojection = \"{law}\""
        );
        // The image is a circle of some 87 degrees about the axis, smaller than the frame.
        let scene = wide_scene(seed, &camera, 5)
            + "[[effects]]\nid = \"field-stop\"\nparameters = { radius_px = 425.0, edge_px = 3.0, centre_x_px = 0.0, centre_y_px = 0.0 }\n";
        let images = bare_images(&scene, folder.path(), law);
        let mut args = vec!["calibrate", "--json", "--physics", "none", "--solve", "auto"];
        args.extend(images.iter().map(|path| text(path)));
        let object = json(&args);
        let [f, sigma] = parameter(&object, "f");
        println!("{law}: f {f:.3} ± {sigma:.3}, {}, map {}, lit {}", object["model"], object["map_sigma_px"], object["lit"]);
        assert_eq!(
            object["chain"]["projection"]["effect"].as_str().or(object["chain"]["projection"].as_str()),
            Some(law),
            "{}",
            object["chain"]
        );
        assert!((f - 310.0).abs() < 4.0 * sigma, "{law}: {f} ± {sigma}");
        let lit = number(&object, "/lit/radius_px");
        assert!(lit > 380.0 && lit < 450.0, "{lit}");
        assert!(number(&object, "/map_sigma_px/max") < 0.5, "{}", object["map_sigma_px"]);
    }
}

#[test]
fn two_cameras_in_one_call_are_told_apart_by_file() {
    let folder = tempfile::tempdir().unwrap();
    // Two sizes: nothing is measured first, so images without stars will do.
    let [small, large] = [("small.png", 300_usize), ("large.png", 400)].map(|(name, side)| {
        let path = folder.path().join(name);
        write_png_u16(&path, side, side, &vec![100; side * side]).unwrap();
        path
    });
    for verb in ["calibrate", "diagnose"] {
        let ran = run(&[verb, text(&small), text(&large)]);
        assert_eq!((ran.code, ran.stdout.as_str()), (1, ""), "{}", ran.stderr);
        for part in ["several cameras", "300 × 300 px", "small.png", "400 × 400 px", "large.png", "one camera's frames at a time"] {
            assert!(ran.stderr.contains(part), "{part}: {}", ran.stderr);
        }
    }
    // Two focal lengths in frames of one size.
    let camera = |f: f64| format!("width_px = 512\nheight_px = 512\nfocal_length_px = {f:?}");
    let mut images = bare_images(&wide_scene(5, &camera(1300.0), 4), folder.path(), "wide");
    images.extend(bare_images(&wide_scene(6, &camera(1380.0), 3), folder.path(), "long"));
    let mut args = vec!["calibrate", "--physics", "none"];
    args.extend(images.iter().map(|path| text(path)));
    let ran = run(&args);
    assert_eq!((ran.code, ran.stdout.as_str()), (1, ""), "{}", ran.stderr);
    println!("{}", ran.stderr);
    let said = &ran.stderr[ran.stderr.find("focal length").unwrap()..];
    let (first, second) = said.split_once("; focal length").unwrap();
    assert!(first.contains("wide-00.png") && first.contains("wide-03.png") && !first.contains("long"), "{said}");
    assert!(second.contains("long-00.png") && second.contains("long-02.png") && !second.contains("wide"), "{said}");
    // One camera's frames alone are no reason to stop.
    let alone = json(&["calibrate", "--json", "--physics", "none", text(&images[4]), text(&images[5]), text(&images[6])]);
    assert!((number(&alone, "/camera/focal_length_px") - 1380.0).abs() < 3.0, "{}", alone["camera"]);
}

/// A fixed camera on the ground for 32 minutes. As images alone neither time nor site are known, and f is off by what is said.
#[test]
fn a_night_without_times_says_what_refraction_may_have_done() {
    let folder = tempfile::tempdir().unwrap();
    let scene = "format = \"boresight-scene/1\"\nseed = 7\n[camera]\nwidth_px = 1000\nheight_px = 800\nfocal_length_px = 3200.0\n\
         [mount]\nkind = \"fixed\"\n[detector]\npsf_sigma_px = 0.9\nzero_point_e_per_s = 2.0e6\ngain_e_per_dn = 1.0\nbias_dn = 100.0\n\
         read_noise_e = 4.0\nsaturation_dn = 65535.0\nfull_well_e = 60000.0\n[sky]\nbackground_e_per_px_s = 20.0\n\
         faintest_magnitude = 8.0\nphysics = \"known\"\n[site]\nlatitude_deg = 46.8\nlongitude_deg = 4.4\nheight_m = 100.0\n\
         [series]\ncount = 11\nstart_utc = \"2026-03-01T22:00:00Z\"\ninterval_s = 192.0\nexposure_s = 1.0\nlowest_altitude_deg = 40.0\n";
    let images = bare_images(scene, folder.path(), "night");
    let mut args = vec!["calibrate", "--json"];
    args.extend(images.iter().map(|path| text(path)));
    let object = json(&args);
    let [f, sigma] = parameter(&object, "f");
    let found: Vec<&Value> = object["systematics"].as_array().unwrap().iter().filter(|own| own["cause"] == "refraction").collect();
    assert_eq!(found.len(), 1, "{}", object["systematics"]);
    let range = [0, 1].map(|end| number(found[0], &format!("/range_px/{end}")));
    println!("f {f:.2} ± {sigma:.2}, off by {:.2}; {}", f - 3200.0, found[0]["sentence"]);
    assert_eq!(found[0]["parameter"], "f");
    assert!(f - 3200.0 > range[0] - 3.0 * sigma && f - 3200.0 < range[1] + 3.0 * sigma, "{} {range:?}", f - 3200.0);
    assert!(range[1] < -3.0 * sigma, "{range:?} {sigma}");
    let warnings = object["warnings"].as_array().unwrap();
    assert!(warnings.iter().any(|warning| *warning == found[0]["sentence"]), "{warnings:?}");
    // With time and site it is modelled, and nothing is said.
    let path = folder.path().join("scene.toml");
    std::fs::write(&path, scene).unwrap();
    let told = folder.path().join("told");
    assert_eq!(run(&["simulate", text(&path), "-o", text(&told), "--backend", "cpu"]).code, 0);
    let object = json(&["calibrate", text(&told), "--json"]);
    assert_eq!(object["systematics"].as_array().unwrap().len(), 0, "{}", object["systematics"]);
    let [f, sigma] = parameter(&object, "f");
    assert!((f - 3200.0).abs() < 4.0 * sigma, "{f} ± {sigma}");
}

#[test]
fn a_listed_star_may_stand_a_little_beyond_the_edge() {
    let folder = tempfile::tempdir().unwrap();
    let list = |x: f64| {
        std::fs::write(folder.path().join("stars.csv"), format!("frame,x_px,y_px\n0,{x},20.0\n0,30.0,40.0\n")).unwrap();
        let manifest = "format = \"star-recording/1\"\nstars = \"stars.csv\"\n[camera]\nwidth_px = 1024\nheight_px = 1024\n[[frames]]\n";
        std::fs::write(folder.path().join("recording.toml"), manifest).unwrap();
        Recording::open(&[folder.path()])
    };
    for x in [1023.56, 1024.5, -0.56, -1.5] {
        assert_eq!(list(x).unwrap().stars.unwrap().frames[0].len(), 2, "{x}");
    }
    let far = list(1024.6).unwrap_err().to_string();
    assert!(far.contains("line 2") && far.contains("1024.6") && far.contains("within 1 px"), "{far}");
}

/// The scene that other tests use has time and site: nothing is open there, and the file's name stands in warnings.
#[test]
fn warnings_name_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let scene = short_night(folder.path(), &[]);
    let path = folder.path().join("night");
    assert_eq!(run(&["simulate", text(&scene), "-o", text(&path), "--backend", "cpu"]).code, 0);
    // One frame is drawn out by three pixels.
    let recording = Recording::open(&[&path]).unwrap();
    let frame = recording.load_frame(3).unwrap();
    let (width, height) = (frame.width_px, frame.height_px);
    let drawn: Vec<u16> = (0..width * height)
        .map(|k| {
            let (x, y) = (k % width, k / width);
            let sum: f32 = (0..4).map(|step| frame.pixels_dn[y * width + (x + step).min(width - 1)]).sum();
            (sum / 4.0) as u16
        })
        .collect();
    let images: Vec<PathBuf> = (0..recording.frames.len())
        .map(|index| {
            let own = recording.load_frame(index).unwrap();
            let pixels: Vec<u16> = if index == 3 { drawn.clone() } else { own.pixels_dn.iter().map(|dn| *dn as u16).collect() };
            let place = folder.path().join(format!("picture-{index}.png"));
            write_png_u16(&place, width, height, &pixels).unwrap();
            place
        })
        .collect();
    let mut args = vec!["calibrate", "--json"];
    args.extend(images.iter().map(|path| text(path)));
    let object = json(&args);
    let names: Vec<&Value> = object["control_points"]["frame_names"].as_array().unwrap().iter().collect();
    assert!(names[3].as_str().unwrap().ends_with("picture-3.png"), "{names:?}");
    let said: Vec<&str> = object["warnings"].as_array().unwrap().iter().filter_map(Value::as_str).collect();
    println!("{said:#?}");
    assert!(said.iter().filter(|warning| warning.contains("is worse than")).all(|warning| warning.contains("picture-")), "{said:?}");
}

/// A defocused lens with a central obstruction: no Gaussian, and bright stars.
const OBSTRUCTED: &str = r#"
format = "boresight-scene/1"
seed = 5
camera = { width_px = 640, height_px = 640, focal_length_px = 1600.0 }
sky = { background_e_per_px_s = 200.0, faintest_magnitude = 6.8, physics = "known" }
nominal = { focal_length_px = 1600.0 }
[psf]
kind = "zernike"
parameters = { lambda_n_px = 1.1, obstruction = 0.3, z4_waves = 0.12 }
[detector]
zero_point_e_per_s = 4.0e6
gain_e_per_dn = 2.0
bias_dn = 200.0
read_noise_e = 5.0
saturation_dn = 65535.0
full_well_e = 1.3e5
[series]
count = 10
start_utc = "2026-03-01T20:00:00Z"
interval_s = 900.0
exposure_s = 0.5
"#;

/// An image is learnt only where it brings the stars nearer to their places, and none where it is a Gaussian.
#[test]
fn an_image_is_learnt_where_it_helps() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let calibrated = |name: &str, scene: &str, more: &[&str]| {
        std::fs::write(at(name).with_extension("toml"), scene).unwrap();
        let ran =
            run(&["simulate", text(&at(name).with_extension("toml")), "-o", text(&at(name)), "--quiet", "--backend", "cpu", "--force"]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        json(&[&["calibrate", text(&at(name)), "--json", "--quiet"], more].concat())
    };
    let [learnt, plain] = [&[][..], &["--no-learnt-image"]].map(|more| calibrated("obstructed", OBSTRUCTED, more));
    let rms_px = [&learnt, &plain].map(|object| number(object, "/rms_px"));
    println!("obstructed: rms {rms_px:?} px, {}", learnt["image"]);
    assert!(plain["image"].is_null() && rms_px[0] <= rms_px[1], "{rms_px:?}");
    let gaussian =
        OBSTRUCTED.replace("[psf]\nkind = \"zernike\"\nparameters = { lambda_n_px = 1.1, obstruction = 0.3, z4_waves = 0.12 }\n", "");
    assert!(!gaussian.contains("psf"));
    let of_gaussian = calibrated("gaussian", &gaussian.replace("[detector]", "[detector]\npsf_sigma_px = 1.0"), &[]);
    assert!(of_gaussian["image"].is_null(), "{}", of_gaussian["image"]);
}

/// The images of a real camera are no Gaussians: the places lose a bias, and the residuals fall.
#[test]
fn the_image_of_a_real_camera_is_learnt() {
    let Some(directory) = recordings_dir("the_image_of_a_real_camera_is_learnt") else { return };
    let night = directory.join("tetra3_esa2019");
    let [learnt, plain] =
        [&[][..], &["--no-learnt-image"]].map(|more| json(&[&["calibrate", text(&night), "--json", "--quiet"], more].concat()));
    let rms_px = [&learnt, &plain].map(|object| number(object, "/rms_px"));
    assert!(rms_px[0] < 0.92 * rms_px[1] && learnt["image"].is_object(), "{rms_px:?}");
    let said = learnt["warnings"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|warning| warning.as_str().unwrap().contains("the image of a star was learnt"));
    assert_eq!(said.count(), 1);
}

/// The higher terms of a fisheye can hardly be told apart in eight frames: the iteration goes to and fro far below the errors, which is an end. The gain,
/// which is not declared, is told by the stars.
#[test]
fn a_fisheye_without_a_declared_detector_is_calibrated() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let preset = run(&["preset", "show", "meteor-camera"]).stdout;
    assert!(preset.contains("\nseed = 1\n") && preset.contains("\ngain_e_per_dn = 4.0\n"), "{preset}");
    std::fs::write(at("scene.toml"), preset.replace("\nseed = 1\n", "\nseed = 2\n")).unwrap();
    let night = at("night");
    assert_eq!(run(&["simulate", text(&at("scene.toml")), "-o", text(&night), "--image-format", "png16", "--backend", "cpu"]).code, 0);
    let manifest = std::fs::read_to_string(night.join("recording.toml")).unwrap();
    let is_of_detector = |line: &str| ["gain_e_per_dn", "bias_dn", "read_noise_e"].iter().any(|key| line.starts_with(key));
    let kept: Vec<&str> = manifest.lines().filter(|line| !is_of_detector(line)).collect();
    assert_eq!(kept.len() + 3, manifest.lines().count());
    std::fs::write(night.join("recording.toml"), kept.join("\n")).unwrap();
    let ran = run(&["calibrate", text(&night), "--physics", "known", "--json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let result: Value = serde_json::from_str(&ran.stdout).unwrap();
    assert_eq!(result["status"], "converged");
    // What the picture draws is what is left of the whole model, not of the camera's own parameters.
    let points = result["points"].as_array().unwrap().iter().filter(|point| point["weight"].as_f64() > Some(0.5));
    let squares: Vec<f64> =
        points.map(|point| [0, 1].iter().map(|axis| point["residual_px"][axis].as_f64().unwrap().powi(2)).sum()).collect();
    let rms_px = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    assert!((rms_px / number(&result, "/rms_px") - 1.0).abs() < 0.01, "{rms_px}");
    let [gain, sigma] = ["value", "sigma"].map(|key| number(&result, &format!("/detector/parameters/0/{key}")));
    assert!((gain - 4.0).abs() < 3.0 * sigma && sigma < 0.3, "{gain} ± {sigma}");
}

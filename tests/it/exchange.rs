//! Cameras in the files of other programs and back. What those programs make of the files was computed by themselves
//! (tests/interop/exchange.py, opencv-python-headless 5.0.0.93, mrcal 2.2, tetra3rs 0.14.0, astropy 8.0.2) and lies in tests/fixtures/exchange.

use std::path::PathBuf;

use assert_cmd::Command;
use boresight::calibrate::{Calibration, Method, calibrate, map};
use boresight::camera::{Camera, Model};
use boresight::coordinates::{Apparent, Attitude, CameraAxes, Direction, PixelPoint};
use boresight::effects::displacement;
use boresight::exchange::{Exported, Format, Imported, Places, Subject, SubjectFrame, detect, export, import};
use nalgebra::Vector3;

use crate::calibrate::{Night, options};
use crate::house::root;

fn narrow() -> Camera {
    Camera { principal_point_px: [510.0, 408.0], k1: 3.8e-9, ..Camera::pinhole(1024, 768, 5114.0) }
}

/// 25° wide, barrel.
fn wide() -> Camera {
    Camera { k1: -0.15 / 4619.0_f64.powi(2), ..Camera::pinhole(2048, 1536, 4619.0) }
}

fn decentred() -> Camera {
    let camera = Camera::pinhole(1280, 1024, 2400.0);
    Camera { principal_point_px: [655.25, 498.5], k1: 1.5e-8, p1: 4e-8, p2: -7e-8, ..camera }
}

fn subject(camera: Camera, parity: i8) -> Subject {
    let attitude = |ra: f64, dec: f64, roll: f64| Attitude::from_pointing(ra, dec, roll);
    let frame = |frame: usize, attitude: Attitude| SubjectFrame { frame, attitude, sky: None };
    Subject {
        model: Model::new(camera),
        parity,
        physics: vec!["proper-motion".to_owned(), "stellar-aberration".to_owned()],
        frames: vec![frame(0, attitude(1.0, 0.3, 2.0)), frame(3, attitude(6.2, -1.5, -0.4))],
        places: Places::Apparent,
    }
}

fn there_and_back(camera: Camera, parity: i8, format: Format) -> (Exported, Imported) {
    let exported = export(&subject(camera, parity), format).unwrap();
    let file = &exported.files[0];
    assert_eq!(detect(&file.bytes), Some(format), "{format:?}");
    let imported = import(&file.name, &file.bytes, None, None).unwrap();
    (exported, imported)
}

/// The largest distance between where two cameras put the same directions, px, over a grid of the first's frame.
fn distance_px(a: &Model, b: &Model) -> f64 {
    let (context, other) = (a.reference_context(), b.reference_context());
    let camera = a.camera();
    let mut largest: f64 = 0.0;
    for k in 0..21 * 21 {
        let at = |k: usize, side: usize| k as f64 / 20.0 * side as f64 - 0.5;
        let point = PixelPoint { x_px: at(k % 21, camera.width_px), y_px: at(k / 21, camera.height_px) };
        let there = b.pixel(&a.direction(point, &context).unwrap(), &other).unwrap();
        largest = largest.max((there.x_px - point.x_px).hypot(there.y_px - point.y_px));
    }
    largest
}

#[test]
fn cameras_come_back_within_the_stated_residuals() {
    for (name, camera) in [("narrow", narrow()), ("wide", wide()), ("decentred", decentred())] {
        for format in [Format::OpenCv, Format::Ros, Format::Mrcal, Format::Tetra3rs] {
            let (exported, imported) = there_and_back(camera, 1, format);
            assert!(exported.expressible && imported.expressible, "{name} {format:?}: {:?} {:?}", exported.residual, imported.residual);
            let stated = exported.residual.max_px + imported.residual.max_px;
            let found = distance_px(&Model::new(camera), &imported.model);
            println!("{name:10} {format:?}: there {:.1e}, back {:.1e} px", exported.residual.max_px, imported.residual.max_px);
            assert!(found <= stated + 1e-9, "{name} {format:?}: {found} px, stated {stated} px");
            assert!(exported.residual.max_px < 2e-3, "{name} {format:?}: {:?}", exported.residual);
        }
    }
}

#[test]
fn world_coordinates_hold_the_reference_model_without_loss() {
    for (camera, parity) in [(narrow(), 1), (wide(), 1), (decentred(), 1), (decentred(), -1)] {
        for format in [Format::Sip, Format::Tpv] {
            let (exported, imported) = there_and_back(camera, parity, format);
            assert!(exported.residual.max_px < 1e-8, "{format:?}: {:?}", exported.residual);
            assert_eq!(exported.files.len(), 2);
            assert_eq!(imported.parity, parity);
            let stored = if parity < 0 { camera.mirrored() } else { camera };
            assert!(distance_px(&Model::new(stored), &imported.model) < 1e-6, "{format:?}");
            let turn =
                imported.camera_from_icrs.unwrap().camera_from_icrs.angle_to(&subject(camera, parity).frames[0].attitude.camera_from_icrs);
            assert!(turn < 1e-9, "{format:?}: the attitude is off by {turn} rad");
        }
    }
}

#[test]
fn a_mirrored_camera_goes_to_tetra3rs_as_such_and_to_opencv_unmirrored() {
    let (_, imported) = there_and_back(decentred(), -1, Format::Tetra3rs);
    assert_eq!(imported.parity, -1);
    assert!(distance_px(&Model::new(decentred().mirrored()), &imported.model) < 0.01);
    let (exported, imported) = there_and_back(decentred(), -1, Format::OpenCv);
    assert!(distance_px(&Model::new(decentred()), &imported.model) < 0.01);
    assert!(exported.notes.iter().any(|note| note.contains("mirrored")), "{:?}", exported.notes);
}

#[test]
fn tetra3rs_gets_the_bytes_that_it_writes_itself() {
    // A camera that its model holds as it is: what comes back of its own file goes out the same, but for the last bits of the fit.
    let theirs = std::fs::read(fixture("tetra3rs.camera")).unwrap();
    let imported = import("tetra3rs.camera", &theirs, None, None).unwrap();
    let model = Model::new(imported.model.camera().mirrored());
    let exported = export(&Subject { model, ..subject(narrow(), -1) }, Format::Tetra3rs).unwrap();
    let ours = &exported.files[0].bytes;
    // Sides, handedness and the kind of distortion stand where they stand there.
    assert_eq!((ours.len(), &ours[8..12], &ours[28..30]), (theirs.len(), &theirs[8..12], &theirs[28..30]));
    // A byte less or more is another file.
    for wrong in [&theirs[..theirs.len() - 1], &[theirs.clone(), vec![0]].concat()] {
        let error = import("cut.camera", wrong, Some(Format::Tetra3rs), None).unwrap_err().to_string();
        assert!(error.contains("save_to_file"), "{error}");
    }
}

#[test]
fn tetra3_has_what_lies_in_the_middle_and_says_no_to_the_rest() {
    let (exported, imported) = there_and_back(wide(), 1, Format::Tetra3);
    assert!(exported.residual.max_px < 1e-9, "{:?}", exported.residual);
    assert!(distance_px(&Model::new(wide()), &imported.model) < 1e-8);
    let exported = export(&subject(decentred(), 1), Format::Tetra3).unwrap();
    assert!(!exported.expressible && exported.residual.max_px > 0.05, "{:?}", exported.residual);
}

#[test]
fn a_camera_with_terms_of_its_own_is_fitted_and_comes_back_with_them() {
    let mut model = Model::new(Camera { k1: -8e-9, ..Camera::pinhole(1280, 960, 2600.0) });
    model.set("radial-high-order", &[0.08, 0.5]).unwrap();
    model.set("pixel-aspect", &[2e-4]).unwrap();
    assert!(displacement("radial-high-order").is_some());
    for format in [Format::OpenCv, Format::Sip, Format::Tpv] {
        let exported = export(&Subject { model: model.clone(), ..subject(narrow(), 1) }, format).unwrap();
        assert!(exported.residual.max_px < 0.01, "{format:?}: {:?}", exported.residual);
        let imported = import("file", &exported.files[0].bytes, None, None).unwrap();
        assert!(imported.residual.max_px < 0.01, "{format:?}: {:?}", imported.residual);
        let turned = imported.camera_from_icrs.map_or(0.0, |_| 1e-3); // a small rotation may be taken up by the attitude
        let stated = exported.residual.max_px + imported.residual.max_px + turned;
        assert!(distance_px(&model, &imported.model) <= stated, "{format:?}");
        assert!(imported.model.terms().any(|(id, _)| id == "radial-high-order"), "{format:?}");
    }
}

#[test]
fn a_fisheye_is_opencvs_own() {
    let camera = Camera::pinhole(1280, 960, 700.0);
    let model = Model::new(camera).with_projection("kannala-brandt", &[-0.03, 0.004, -0.002, 0.0003]).unwrap();
    for format in [Format::OpenCv, Format::Ros] {
        let exported = export(&Subject { model: model.clone(), ..subject(camera, 1) }, format).unwrap();
        assert!(exported.residual.max_px < 1e-6, "{format:?}: {:?}", exported.residual);
        let imported = import("file", &exported.files[0].bytes, None, None).unwrap();
        assert_eq!(imported.model.projection(), "kannala-brandt");
        assert!(distance_px(&model, &imported.model) < 1e-6, "{format:?}");
    }
}

fn fixture(name: &str) -> PathBuf {
    root().join("tests/fixtures/exchange").join(name)
}

fn rows<const N: usize>(name: &str) -> Vec<[f64; N]> {
    let text = std::fs::read_to_string(fixture(name)).unwrap();
    let row = |line: &str| -> [f64; N] {
        let values: Vec<f64> = line.split(',').map(|value| value.parse().unwrap()).collect();
        values.try_into().unwrap()
    };
    text.lines().skip(1).map(row).collect()
}

#[test]
fn files_of_other_programs_mean_what_these_say() {
    for (name, from) in [
        ("opencv.yml", Format::OpenCv),
        ("opencv_fisheye.yml", Format::OpenCv),
        ("mrcal.cameramodel", Format::Mrcal),
        ("tetra3rs.json", Format::Tetra3rs),
        ("tetra3rs.camera", Format::Tetra3rs),
    ] {
        let imported = import(name, &std::fs::read(fixture(name)).unwrap(), None, None).unwrap();
        assert_eq!(imported.from, from);
        let context = imported.model.reference_context();
        let rows = rows::<5>(&format!("{name}.csv"));
        assert_eq!(rows.len(), 35);
        let mut largest: f64 = 0.0;
        for [x, y, z, x_px, y_px] in rows {
            // Directions in a mirrored camera have x turned.
            let direction = Direction::<CameraAxes>::along([x * f64::from(imported.parity), y, z]);
            let there = imported.model.pixel(&direction, &context).unwrap();
            largest = largest.max((there.x_px - x_px).hypot(there.y_px - y_px));
        }
        println!("{name}: {largest:.2e} px, stated {:.2e} px", imported.residual.max_px);
        assert!(largest <= imported.residual.max_px + 1e-6, "{name}: {largest} px, stated {:?}", imported.residual);
        assert!(imported.residual.max_px < 0.01, "{name}: {:?}", imported.residual);
    }
}

#[test]
fn world_coordinates_mean_what_astropy_says() {
    for name in ["sip.wcs", "tpv.wcs"] {
        let imported = import(name, &std::fs::read(fixture(name)).unwrap(), None, None).unwrap();
        assert_eq!(imported.parity, -1, "{name} is mirrored");
        let attitude = imported.camera_from_icrs.unwrap();
        let context = imported.model.reference_context();
        for [x_px, y_px, ra_deg, dec_deg] in rows::<4>(&format!("{name}.csv")) {
            let [x, y, z] = imported.model.direction(PixelPoint { x_px, y_px }, &context).unwrap().xyz;
            let seen = attitude.apparent_from_camera(&Direction::from_unit([-x, y, z]));
            let expected = Direction::<Apparent>::from_radec_rad(ra_deg.to_radians(), dec_deg.to_radians());
            let off_px = Vector3::from(seen.xyz).metric_distance(&Vector3::from(expected.xyz)) * 1210.0;
            assert!(off_px < 1e-6, "{name}: {off_px} px at ({x_px}, {y_px})");
        }
    }
}

#[test]
fn bad_files_get_a_sentence() {
    let camera = export(&subject(narrow(), 1), Format::OpenCv).unwrap().files.remove(0);
    let opencv = String::from_utf8(camera.bytes).unwrap();
    let ros = String::from_utf8(export(&subject(narrow(), 1), Format::Ros).unwrap().files.remove(0).bytes).unwrap();
    let header = std::fs::read_to_string(fixture("tpv.wcs")).unwrap();
    let cases: Vec<(String, &[&str])> = vec![
        (opencv.replace("cols: 3", "cols: 4"), &["line 12", "camera_matrix", "9 numbers"]),
        (opencv.replace("image_width: 1024", "image_width: -3"), &["line 6", "image_width", "-3"]),
        (opencv.replace("image_width: 1024", "image_wide: 1024"), &["image_width", "missing"]),
        (opencv.replace("data: [ 5114", "data: [ nine"), &["nine", "no number"]),
        (opencv.replace("data: [ 5114", "data: [ -5114"), &["focal length", "greater than 0"]),
        (opencv.replace("   rows: 5", "\t rows: 5"), &["tab"]),
        (opencv.replace("image_height: 768", "image_height: 768\nimage_height: 769"), &["twice"]),
        (opencv.replace(" ]", ""), &["never closed"]),
        (opencv.replace("1.0 ]", ".Nan ]"), &["no number"]),
        (opencv.replace("1.0 ]", "NaN ]"), &["NaN", "finite"]),
        (ros.replace("plumb_bob", "double_sphere"), &["double_sphere", "plumb_bob"]),
        (ros.replace("plumb_bob", "rational_polynomial"), &["8 numbers"]),
        (header.replace("RA---TPV", "GLON-TPV"), &["GLON-TPV", "RA---TPV"]),
        (header.replace("NAXIS1", "OTHER1"), &["--width"]),
        (
            "{'lensmodel': 'LENSMODEL_SPLINED_STEREOGRAPHIC_order=3', 'intrinsics': [1,2,], 'imagersize': [3,4]}".to_owned(),
            &["SPLINED", "mrcal-convert"],
        ),
        ("{'lensmodel': 'LENSMODEL_OPENCV8', 'intrinsics': [1,2,3,4,], 'imagersize': [3,4]}".to_owned(), &["12 intrinsics"]),
        ("{\"fov_estimate\": 200, \"distortion\": 0, \"image_width\": 3, \"image_height\": 3}".to_owned(), &["fov_estimate = 200"]),
        ("hello".to_owned(), &["--from"]),
        (String::new(), &["--from"]),
    ];
    for (text, words) in cases {
        let message = import("name.of.file", text.as_bytes(), None, None).expect_err(&text).to_string();
        assert!(message.starts_with("name.of.file"), "{message}");
        for word in words {
            assert!(message.contains(word), "{word:?} is not in: {message}");
        }
        assert!(!message.contains('\n'), "{message}");
    }
}

/// A calibration of a camera without noise.
fn calibration(camera: Camera) -> Calibration {
    let night = Night { truth: camera, nominal: camera, frames: 2, stars: 40, ..Night::published() };
    let solved = calibrate(&night.observe(5).0, &options(Method::VariableWeights)).unwrap();
    Calibration { camera, ..solved }
}

#[test]
fn our_own_file_reads_back_to_the_same_map() {
    let original = calibration(decentred());
    let text = serde_json::to_string_pretty(&original.with_stored_columns()).unwrap();
    let back: Calibration = serde_json::from_str(&text).unwrap();
    assert_eq!(map(&back.with_stored_columns(), 9), map(&original, 9));
}

#[test]
fn what_a_calibration_has_beyond_the_reference_model_is_exported_too() {
    let mut chain = Model::new(narrow());
    chain.set("radial-high-order", &[0.2, 0.0]).unwrap();
    let calibration = Calibration { chain: Some(chain.clone()), ..calibration(narrow()) };
    assert_eq!(Subject::from(&calibration).model, chain);
}

#[test]
fn the_verbs_write_read_and_say_no() {
    let folder = tempfile::tempdir().unwrap();
    let here = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(here("calibrate.json"), serde_json::to_string(&calibration(narrow())).unwrap()).unwrap();
    let run = |args: &[&str]| {
        let output = Command::cargo_bin("boresight").unwrap().args(args).output().unwrap();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        (output.status.code().unwrap(), text(output.stdout), text(output.stderr))
    };
    let (code, stdout, stderr) = run(&["export", &here("calibrate.json"), "--to", "opencv", "-o", &here("camera.yml"), "--json"]);
    assert_eq!(code, 0, "{stderr}");
    let object: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(object["format"], "boresight-export/1");
    assert!(object["residual"]["max_px"].as_f64().unwrap() < 1e-3, "{object}");
    let (code, _, stderr) = run(&["import", &here("camera.yml"), "-o", &here("in")]);
    assert_eq!(code, 0, "{stderr}");
    let table = std::fs::read_to_string(here("in/camera.toml")).unwrap();
    let table: toml::Table = table.parse().unwrap();
    let f = table["camera"]["focal_length_px"].as_float().unwrap();
    assert!((f - 5114.0).abs() < 1e-3, "{f}");
    let (code, _, stderr) = run(&["export", &here("calibrate.json"), "--to", "sip", "-o", &here("wcs")]);
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(std::fs::metadata(here("wcs/frame-0001.wcs")).unwrap().len() % 2880, 0);
    let (code, _, stderr) = run(&["export", &here("calibrate.json"), "--to", "tetra3", "-o", &here("tetra3.json")]);
    assert_eq!(code, 3, "{stderr}");
    assert!(stderr.contains("0.01 px") && stderr.contains("--inexact"), "{stderr}");
    assert!(!folder.path().join("tetra3.json").exists());
    let (code, _, stderr) = run(&["export", &here("calibrate.json"), "--to", "tetra3", "-o", &here("tetra3.json"), "--inexact"]);
    assert_eq!(code, 0, "{stderr}");
    assert!(folder.path().join("tetra3.json").exists());
    let (code, _, stderr) = run(&["export", &here("calibrate.json"), "--to", "zemax", "-o", &here("x")]);
    assert_eq!(code, 2);
    assert!(stderr.contains("opencv, ros"), "{stderr}");
    std::fs::write(
        here("recording.toml"),
        format!("format = \"star-recording/1\"\n{}", std::fs::read_to_string(here("in/camera.toml")).unwrap()),
    )
    .unwrap();
    let (_, _, stderr) = run(&["detect", folder.path().to_str().unwrap()]);
    assert!(!stderr.contains("camera"), "the table is one of a recording: {stderr}");
}

//! `boresight diagnose` as its user runs it: its result, its files, its exit codes.

use std::path::Path;

use serde_json::Value;

use crate::cli::{number, run, short_night, text};

/// Few simulated recordings: what is tested here is not the statistics.
const QUICK: [&str; 3] = ["--nulls", "20", "--quiet"];

/// Runs a diagnosis, whose answer may be yes or no, and reads its object.
fn diagnosed(args: &[&str]) -> Value {
    let all: Vec<&str> = ["diagnose"].iter().chain(args).chain(&QUICK).copied().collect();
    let ran = run(&all);
    let object: Value = serde_json::from_str(&ran.stdout).unwrap_or_else(|error| panic!("{all:?}: {error}: {} {}", ran.stdout, ran.stderr));
    let expected = if ["unexplained", "undecided"].contains(&object["verdict"].as_str().unwrap()) { 3 } else { 0 };
    assert_eq!(ran.code, expected, "{}", object["verdict"]);
    object
}

/// A recording of a few frames.
fn recorded(folder: &Path, changes: &[(&str, &str)]) -> std::path::PathBuf {
    let scene =
        short_night(folder, &[&[("count = 12", "count = 5"), ("faintest_magnitude = 8.5", "faintest_magnitude = 7.0")], changes].concat());
    let recording = folder.join("night");
    assert_eq!(run(&["simulate", text(&scene), "-o", text(&recording), "--backend", "cpu"]).code, 0);
    recording
}

fn rows(path: &Path) -> Vec<csv::StringRecord> {
    csv::Reader::from_path(path).unwrap().records().map(Result::unwrap).collect()
}

/// What format 2 says of each channel.
fn every_channel_is_told(object: &Value) {
    assert_eq!(object["scope"], serde_json::json!(["astrometry", "flux", "shape", "noise", "background"]));
    for name in ["astrometry", "flux", "shape", "stamp", "noise", "background"] {
        let channel = &object["channels"][name];
        let looked_at = name != "stamp";
        assert_eq!(channel["looked_at"], looked_at, "{name}: {channel}");
        assert_eq!(channel["verdict"] == "not-looked-at", !looked_at, "{name}: {channel}");
        assert_eq!(channel["p_value"].is_number(), looked_at, "{name}: {channel}");
        assert!(channel["located_by"].is_array() && !channel["reason"].as_str().unwrap().is_empty(), "{name}: {channel}");
        assert_eq!(channel["detectable"].as_array().unwrap().is_empty(), !looked_at, "{name}");
    }
    assert!(object["unknown"].is_array());
    for finding in object["findings"].as_array().unwrap() {
        let own = &finding["channels"];
        assert!(own["astrometry"]["sigma"].as_f64().unwrap() > 0.0 && own["flux"].is_null() && own["background"].is_null(), "{own}");
    }
    for profile in object["profiles"].as_array().unwrap() {
        assert!(profile["bins"].as_array().unwrap().iter().all(|bin| bin["stars"].as_u64() > Some(0)), "{profile}");
    }
    no_probability_is_smaller_than_resolved(object);
}

/// Wherever the object says a probability by chance.
fn no_probability_is_smaller_than_resolved(value: &Value) {
    match value {
        Value::Object(map) => {
            for (key, value) in map {
                if let (true, Some(p)) = (key.ends_with("p_value"), value.as_f64()) {
                    assert!(p >= 1e-6, "{key}: {p}");
                }
                no_probability_is_smaller_than_resolved(value);
            }
        }
        Value::Array(list) => list.iter().for_each(no_probability_is_smaller_than_resolved),
        _ => {}
    }
}

#[test]
fn a_diagnosis_is_an_object_a_page_tables_and_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let recording = recorded(folder.path(), &[]);
    let (out, scene) = (folder.path().join("out"), folder.path().join("found.toml"));
    let object = diagnosed(&[text(&recording), "--json", "-o", text(&out), "--write-camera", text(&scene)]);
    assert_eq!(object["format"], "boresight-diagnose/2");
    assert_eq!(object["physics"], serde_json::json!(["proper-motion"]));
    for key in ["findings", "effects", "warnings"] {
        assert!(object[key].is_array(), "{key}: {}", object[key]);
    }
    for pointer in ["/fit/baseline/rms_px", "/fit/final/chi2_per_dof", "/stars_used/with_proper_motion", "/stars_used/without", "/parity"] {
        let _ = number(&object, pointer);
    }
    every_channel_is_told(&object);
    let states = ["found", "indistinguishable", "not-found", "withheld", "not-observable", "not-applicable"];
    for effect in object["effects"].as_array().unwrap() {
        assert!(states.contains(&effect["status"].as_str().unwrap()), "{effect}");
        let surely = effect["p_value"].as_f64().is_some_and(|p| p < 1e-4);
        assert!(!surely || effect["status"] != "not-found", "{effect}");
        assert!(effect["status"] != "withheld" || effect["upper_limit_95"].is_null() && effect["reason"] != "", "{effect}");
    }
    assert_eq!(object["provenance"]["seed"], 0);
    assert!(object["provenance"]["inputs"].as_array().is_some_and(|inputs| !inputs.is_empty()), "{}", object["provenance"]);

    let file: Value = serde_json::from_slice(&std::fs::read(out.join("diagnose.json")).unwrap()).unwrap();
    assert_eq!(file["residuals"], object["residuals"]);
    let table = rows(&out.join("residuals.csv"));
    assert_eq!(table.len(), object["residuals"].as_array().unwrap().len());
    assert!(table.len() > 60 && table[0][1].contains("0000"), "{} rows, {:?}", table.len(), table[0]);
    let page = std::fs::read_to_string(out.join("summary.txt")).unwrap();
    assert!(page.lines().all(|line| line.chars().count() <= 100 || line.contains('─')), "{page}");
    let verdict = object["verdict"].as_str().unwrap().to_uppercase();
    assert!(page.starts_with(&verdict), "{page}");
    // The first lines say what was looked at and what was not.
    let first: String = page.lines().take(2).map(str::trim).collect::<Vec<_>>().join(" ");
    assert!(first.contains("positions: ") && first.contains("stamps: not looked at"), "{first}");
    assert!(object["summary"][0].as_str().unwrap().contains("not looked at"), "{}", object["summary"]);
    for picture in ["residuals.png", "ranking.png"] {
        assert!(image::image_dimensions(out.join(picture)).unwrap().0 > 500, "{picture}");
    }
    let mapped = object["unknown"].as_array().unwrap().iter().any(|unknown| !unknown["map"].is_null());
    assert_eq!(out.join("map.csv").exists(), mapped);

    // What was found is rendered again, and the stars are where they were.
    let again = folder.path().join("again");
    let ran = run(&["simulate", text(&scene), "-o", text(&again), "--backend", "cpu"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let stars = |folder: &Path| -> std::collections::BTreeMap<(String, String), [f64; 2]> {
        let table = folder.join("truth/stars.csv");
        let head = csv::Reader::from_path(&table).unwrap().headers().unwrap().clone();
        let column = |name: &str| head.iter().position(|other| other == name).unwrap();
        let [x, y] = ["x_px", "y_px"].map(column);
        let number = |text: &str| text.parse().unwrap();
        rows(&table).iter().map(|row| ((row[0].to_owned(), row[1].to_owned()), [number(&row[x]), number(&row[y])])).collect()
    };
    let (truth, found) = (stars(&recording), stars(&again));
    let mut distances: Vec<f64> = truth.iter().filter_map(|(star, [x, y])| found.get(star).map(|[a, b]| (x - a).hypot(y - b))).collect();
    distances.sort_by(f64::total_cmp);
    assert!(distances.len() > 150, "{}", distances.len());
    let median = distances[distances.len() / 2];
    assert!(median < 0.08, "{median} px");
}

#[test]
fn without_times_the_stars_are_taken_at_j2000_unless_motion_was_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let recording = recorded(folder.path(), &[("start_utc = \"2026-03-01T20:00:00Z\"\n", "")]);
    let object = diagnosed(&[text(&recording), "--json"]);
    assert_eq!(object["physics"], serde_json::json!(["proper-motion"]));
    let warned = |word: &str| object["warnings"].as_array().unwrap().iter().any(|warning| warning.as_str().unwrap().contains(word));
    assert!(warned("J2000.0"), "{}", object["warnings"]);
    // Nobody knows how far the others have moved, and since when.
    assert_eq!(number(&object, "/stars_used/without"), 0.0, "{}", object["stars_used"]);
    let all = diagnosed(&[text(&recording), "--all-stars", "--json"]);
    assert!(number(&all, "/stars_used/without") > 0.0 && number(&all, "/stars_used/left_out") < number(&object, "/stars_used/left_out"));
    let asked = run(&["diagnose", text(&recording), "--physics", "proper-motion"]);
    assert_eq!(asked.code, 1);
    assert!(asked.stderr.contains("proper-motion: the effect cannot be computed"), "{}", asked.stderr);
}

#[test]
fn mirrored_images_are_diagnosed_in_their_own_columns() {
    let folder = tempfile::tempdir().unwrap();
    let recording = recorded(folder.path(), &[]);
    let opened = boresight::recording::Recording::open(&[&recording]).unwrap();
    let (straight, mirrored) = (folder.path().join("straight"), folder.path().join("mirrored"));
    for path in [&straight, &mirrored] {
        std::fs::create_dir(path).unwrap();
    }
    let mut paths = [Vec::new(), Vec::new()];
    for index in 0..opened.frames.len() {
        let frame = opened.load_frame(index).unwrap();
        let pixels: Vec<u16> = frame.pixels_dn.iter().map(|count| *count as u16).collect();
        let turned: Vec<u16> = pixels.chunks(512).flat_map(|row| row.iter().rev().copied()).collect();
        for (place, (path, pixels)) in [(&straight, &pixels), (&mirrored, &turned)].into_iter().enumerate() {
            let file = path.join(format!("{index}.png"));
            boresight::recording::write_png_u16(&file, 512, 512, pixels).unwrap();
            paths[place].push(file);
        }
    }
    let [plain, turned] = paths.map(|paths| {
        let mut args: Vec<&str> = paths.iter().map(|path| text(path)).collect();
        args.push("--json");
        diagnosed(&args)
    });
    assert_eq!((number(&plain, "/parity"), number(&turned, "/parity")), (1.0, -1.0));
    let rows = |object: &Value| -> std::collections::BTreeMap<(u64, u64), [f64; 4]> {
        let row = |row: &Value| {
            let key = (row["frame"].as_u64().unwrap(), row["hip"].as_u64().unwrap());
            (key, ["/x_px", "/y_px", "/before_px/0", "/before_px/1"].map(|pointer| number(row, pointer)))
        };
        object["residuals"].as_array().unwrap().iter().map(row).collect()
    };
    let (plain, turned) = (rows(&plain), rows(&turned));
    let mut compared = 0;
    for (star, [x, y, dx, dy]) in &plain {
        let Some([other_x, other_y, other_dx, other_dy]) = turned.get(star) else { continue };
        assert!((511.0 - x - other_x).abs() < 0.05 && (y - other_y).abs() < 0.05, "{star:?}: {x} {other_x}, {y} {other_y}");
        compared += usize::from((dx + other_dx).abs() < 0.03 && (dy - other_dy).abs() < 0.03);
    }
    assert!(10 * compared > 9 * plain.len() && compared > 60, "{compared} of {}", plain.len());
}

#[test]
fn wrong_arguments_are_refused_in_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let options = folder.path().join("options.toml");
    std::fs::write(&options, "nuls = 3\n").unwrap();
    let image = folder.path().join("dark.png");
    image::GrayImage::from_pixel(64, 64, image::Luma([7])).save(&image).unwrap();
    for (args, code, part) in [
        (vec!["diagnose", "x.png", "--alpha", "2"], 2, "between 0 and 1"),
        (vec!["diagnose", "x.png", "--nulls", "0"], 2, "--nulls"),
        (vec!["diagnose", "x.png", "--solve", "k9"], 2, "k9"),
        (vec!["diagnose", text(&image), "--options", text(&options)], 1, "nuls"),
        (vec!["diagnose", text(&image), "--trust-identifications"], 1, "only a star list names its stars"),
    ] {
        let ran = run(&args);
        assert_eq!(ran.code, code, "{args:?}: {}", ran.stderr);
        assert!(ran.stderr.contains(part) && ran.stdout.is_empty(), "{args:?}: {} {}", ran.stdout, ran.stderr);
    }
    // A frame without stars can be looked at: the answer is no.
    let ran = run(&["diagnose", text(&image)]);
    assert!(ran.code == 3 && ran.stdout.starts_with("UNDECIDED") && ran.stdout.contains("control points"), "{} {}", ran.stdout, ran.stderr);
}

/// Half of the light is lost in the corners, and every star stands where it should: what is said is said of places alone.
#[test]
fn lost_light_is_found_in_the_brightness() {
    let folder = tempfile::tempdir().unwrap();
    let effect = "[sky]\n";
    let vignetting = "[[effects]]\nid = \"vignetting\"\nparameters = { loss_at_corner = 0.45 }\n\n[sky]\n";
    let recording = recorded(folder.path(), &[(effect, vignetting)]);
    let ran = run(&["diagnose", text(&recording), "--physics", "known", "--nulls", "20", "--quiet"]);
    let first: String = ran.stdout.lines().take(2).map(str::trim).collect::<Vec<_>>().join(" ");
    assert!(first.ends_with("stamps: not looked at"), "{}", ran.stdout);
    let object: Value =
        serde_json::from_str(&run(&["diagnose", text(&recording), "--physics", "known", "--nulls", "20", "--quiet", "--json"]).stdout)
            .unwrap();
    assert_eq!(object["channels"]["flux"]["verdict"], "explained", "{}", ran.stdout);
    let findings = object["findings"].as_array().unwrap();
    assert_eq!(findings.iter().map(|own| own["id"].as_str().unwrap()).collect::<Vec<_>>(), ["vignetting"]);
    let (loss, sigma) = (number(&findings[0], "/parameters/0/value"), number(&findings[0], "/parameters/0/sigma"));
    assert!((loss - 0.45).abs() < 3.0 * sigma && sigma < 0.1, "{loss} ± {sigma}");
    for overstated in ["othing is missing", "nothing is left"] {
        assert!(!ran.stdout.contains(overstated), "{overstated}: {}", ran.stdout);
    }
    assert!(ran.stdout.contains("of the errors that the measurement states") && ran.stdout.contains("could show"), "{}", ran.stdout);
}

/// One frame of 26 stars: in the positions nothing shows, and nothing of ordinary size could. That the frame is a JPEG does.
#[test]
fn one_real_frame_of_few_stars_is_undecided() {
    let Some(directory) = crate::common::recordings_dir("diagnose_cli::one_real_frame_of_few_stars_is_undecided") else { return };
    let object = diagnosed(&[text(&directory.join("cedar")), "--json"]);
    assert_eq!((object["verdict"].as_str(), object["channels"]["astrometry"]["verdict"].as_str()), (Some("explained"), Some("undecided")));
    assert_eq!(object["channels"]["flux"]["verdict"], "not-looked-at");
    assert!(object["findings"].as_array().unwrap().iter().all(|own| own["id"] == "compression"), "{}", object["findings"]);
    let detectable = object["channels"]["astrometry"]["detectable"].as_array().unwrap();
    assert!(!detectable.is_empty() && detectable.iter().all(|own| own["would_show"] == false && own["ordinary"].as_f64() > Some(0.0)));
    assert!(detectable[0]["size_95"].as_f64() > detectable[0]["ordinary"].as_f64(), "{}", detectable[0]);
}

/// On a real night, too, the pictures of what was found tell its size as well as the page does.
#[test]
fn profiles_of_a_real_night_are_of_its_data() {
    let Some(directory) = crate::common::recordings_dir("diagnose_cli::profiles_of_a_real_night_are_of_its_data") else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let object = diagnosed(&[text(&directory.join("tetra3_esa2019")), "--json", "-o", text(&out)]);
    let profiles = object["profiles"].as_array().unwrap();
    assert!(!profiles.is_empty());
    for profile in profiles {
        let id = profile["id"].as_str().unwrap();
        let sum: f64 = profile["bins"].as_array().unwrap().iter().map(|bin| (number(bin, "/model") / number(bin, "/sigma")).powi(2)).sum();
        let finding = object["findings"].as_array().unwrap().iter().find(|finding| finding["id"] == id).unwrap();
        let own = finding["parameters"].as_array().unwrap().iter().find(|own| own["name"] == profile["parameter"]["name"]).unwrap();
        let page = number(own, "/sigma") / number(own, "/value").abs();
        assert!((1.0 / sum.sqrt() / page - 1.0).abs() < 0.1, "{id}: {} drawn, {page} on the page", 1.0 / sum.sqrt());
    }
    no_probability_is_smaller_than_resolved(&object);
    let page = std::fs::read_to_string(out.join("summary.txt")).unwrap();
    assert!(!page.contains("1e-300") && page.contains("p < "), "{page}");
}

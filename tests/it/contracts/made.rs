//! A tiny recording of a fixed seed, put through every verb once: what the other tests here look at.

use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::LazyLock;

use serde_json::Value;

use crate::cli::short_night;

/// What a verb said.
pub(super) struct Said {
    pub(super) name: &'static str,
    pub(super) object: Value,
}

/// Results of the verbs, and the pages of some.
pub(super) struct Made {
    pub(super) results: Vec<Said>,
    pub(super) pages: Vec<(&'static str, String)>,
}

impl Made {
    /// The results of this name.
    pub(super) fn of(&self, name: &str) -> impl Iterator<Item = &Value> {
        self.results.iter().filter(move |said| said.name == name).map(|said| &said.object)
    }
}

/// All of it, made once for all tests.
pub(super) static MADE: LazyLock<Made> = LazyLock::new(make);

/// Runs the program in a folder with the width of the help fixed. Nothing of the terminal of the tests reaches it.
pub(super) fn run_in(folder: &Path, args: &[&str]) -> (i32, String, String) {
    let mut command = Command::new(assert_cmd::cargo::cargo_bin("boresight"));
    command.args(args).current_dir(folder).env("COLUMNS", "100").env_remove("RUST_LOG").stdin(Stdio::null());
    let output = command.output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (output.status.code().expect("not killed by a signal"), text(output.stdout), text(output.stderr))
}

fn read(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// The object that a command prints.
fn object(folder: &Path, args: &[&str]) -> Value {
    let (code, stdout, stderr) = run_in(folder, args);
    assert!([0, 3].contains(&code), "{args:?}: {code} {stderr}");
    serde_json::from_str(&stdout).unwrap_or_else(|error| panic!("{args:?}: {error}: {stdout}"))
}

fn make() -> Made {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut made = Made { results: Vec::new(), pages: Vec::new() };
    short_night(at, &[("count = 12", "count = 4"), ("faintest_magnitude = 8.5", "faintest_magnitude = 6.0")]);
    let table =
        boresight::catalog::Catalog::embedded().brighter_than(4.0).iter().fold("ra_deg,dec_deg,magnitude\n".to_owned(), |table, star| {
            let (ra, dec) = star.direction.radec_rad();
            format!("{table}{},{},{}\n", ra.to_degrees(), dec.to_degrees(), star.magnitude)
        });
    std::fs::write(at.join("table.csv"), table).unwrap();
    crate::dataset::recipe_in(at, crate::dataset::RECIPE);
    crate::suite::suite_in(at);
    let few = ["--nulls", "20", "--quiet"];
    let list = ["--family", "null", "--to", "1", "-o", "hidden", "--json"];
    let simulate = ["simulate", "scene.toml", "-o", "night", "--backend", "cpu", "--json"];
    made.results.push(Said { name: "simulate", object: object(at, &simulate) });
    for (name, args) in [
        ("identify", vec!["identify", "night", "-o", "stars"]),
        ("calibrate", vec!["calibrate", "night", "-o", "cal"]),
        ("diagnose", [&["diagnose", "night", "-o", "missing"][..], &few].concat()),
    ] {
        let (code, page, stderr) = run_in(at, &args);
        assert!([0, 3].contains(&code), "{args:?}: {code} {stderr}");
        made.pages.push((name, page));
        made.results.push(Said { name, object: read(&at.join(args[3]).join(format!("{name}.json"))) });
    }
    let verbs: Vec<(&'static str, Vec<&str>)> = vec![
        ("dataset", vec!["dataset", "recipe.toml", "-o", "set", "--json"]),
        ("verify", vec!["dataset", "verify", "set", "--frames", "4", "--json"]),
        ("detect", vec!["detect", "night", "--json"]),
        ("calibrate", vec!["calibrate", "night/frames/0000.fits", "--solve", "f,k1", "-o", "one", "--max-magnitude", "-1", "--json"]),
        ("update", vec!["calibrate", "night", "--update", "cal/calibrate.json", "-o", "updated", "--json"]),
        ("diagnose", [&["diagnose", "night", "--max-magnitude", "-1", "--json"][..], &few].concat()),
        ("map", vec!["map", "cal/calibrate.json", "--grid", "3", "--json"]),
        ("compare", vec!["compare", "cal/calibrate.json", "cal/calibrate.json", "--max-px", "1", "--json"]),
        ("export", vec!["export", "cal/calibrate.json", "--to", "opencv", "-o", "camera.yml", "--json"]),
        ("import", vec!["import", "camera.yml", "--json"]),
        ("run", vec!["run", "scene.toml", "-o", "ran", "--backend", "cpu", "--misidentify", "0.1", "--json"]),
        ("test", vec!["test", "suite.toml", "--json"]),
        ("catalog-import", vec!["catalog", "import", "table.csv", "-o", "bright.catalog", "--json"]),
        ("blind", [&["blind", "generate"][..], &list].concat()),
        ("blind", [&["blind", "run", "--nulls", "20"][..], &list].concat()),
        ("blind", vec!["blind", "score", "-o", "hidden", "--json"]),
        ("blind", vec!["blind", "held-out", "-o", "hidden", "--json"]),
        ("effects", vec!["effects", "--json"]),
        ("effects", vec!["effects", "prnu", "--json"]),
        ("signature", vec!["effects", "--signature", "prnu", "--json"]),
        ("preset", vec!["preset", "list", "--json"]),
        ("preset", vec!["preset", "show", "cubesat-tracker", "--json"]),
        ("doctor", vec!["doctor", "--json"]),
    ];
    for (name, args) in verbs {
        made.results.push(Said { name, object: object(at, &args) });
    }
    made.results.push(Said { name: "truth", object: read(&at.join("night/truth/truth.json")) });
    made.results.push(Said { name: "shard", object: read(&at.join("set/shards/train-000000.json")) });
    let (code, _, stderr) = run_in(at, &["dataset", "recipe.toml", "--frame", "5", "-o", "frame"]);
    assert_eq!(code, 0, "{stderr}");
    made.results.push(Said { name: "sample", object: read(&at.join("frame/000000005.json")) });
    // `demo` is `run` on the built-in scene, which takes longer and writes the same.
    let demo = made.of("run").next().unwrap().clone();
    made.results.push(Said { name: "demo", object: demo });
    add_inputs(at, &mut made);
    made
}

/// Files that people write, as a reader of TOML or CSV has them.
fn add_inputs(at: &Path, made: &mut Made) {
    let mut add = |name: &'static str, text: &str| {
        let table: toml::Table = toml::from_str(text).unwrap();
        made.results.push(Said { name, object: serde_json::to_value(table).unwrap() });
    };
    add("scene", boresight::scene::DEMO_TOML);
    for preset in boresight::scene::PRESETS {
        add("scene", preset.toml);
    }
    add("recipe", crate::dataset::RECIPE);
    add("suite", crate::suite::SUITE);
    add("recording", &std::fs::read_to_string(at.join("night/recording.toml")).unwrap());
    add(
        "recording",
        "format = \"star-recording/1\"\nstars = \"stars.csv\"\n[camera]\nwidth_px = 512\nheight_px = 512\nshutter = \"rolling\"\nline_time_us = 10.0\n\
         [mount]\nkind = \"fixed\"\n[[frames]]\nexposure_s = 1\nfocus_um = 12.5\ncamera_from_icrs = [0, 0, 0, 1]\n",
    );
    let mut rows = csv::Reader::from_reader(
        &b"frame,x_px,y_px,sigma_x_px,sigma_y_px,hip,ra_deg,dec_deg\n0,1.5,2,0.1,0.1,,,\n0,7,8,0.1,0.1,677,2.1,29.1\n"[..],
    );
    let header = rows.headers().unwrap().clone();
    let row = |record: csv::StringRecord| -> Value {
        let filled = header
            .iter()
            .zip(&record)
            .filter(|(_, field)| !field.is_empty())
            .map(|(key, field)| (key.to_owned(), serde_json::from_str(field).unwrap()));
        Value::Object(filled.collect())
    };
    let list: Vec<Value> = rows.records().map(Result::unwrap).map(row).collect();
    made.results.push(Said { name: "star-list", object: Value::Array(list) });
}

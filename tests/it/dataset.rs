//! `boresight dataset`: the same bytes whatever the threads, the processes and the kills; recipes that are refused.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::{Field, Row};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde_json::Value;

use crate::cli::{run, text};

const SCENE: &str = "format = \"boresight-scene/1\"\ncamera = { width_px = 64, height_px = 48, focal_length_px = 300.0 }\n\
                     sky = { physics = \"none\" }\n[[frames]]\nexposure_s = 1.0\n";

pub(crate) const RECIPE: &str = "format = \"boresight-recipe/1\"\nname = \"tiny\"\nseed = 5\nscene = \"sky.toml\"\nlicence = \"CC-BY-4.0\"\n\
    [size]\nframes = { train = 12, test = 4 }\nframes_per_shard = 2\nmembers = [\"mask\", \"distance\"]\n\
    [cameras]\ntrain = 2\ntest = 1\n[splits]\napart_by = [\"camera\", \"sky\"]\n\
    [[draw]]\nper = \"camera\"\npath = \"camera.focal_length_px\"\nuniform = [290.0, 310.0]\n\
    [[draw]]\nper = \"frame\"\npath = \"frames.rate_deg_s\"\nball = { radius = 0.5 }\nspread = \"even\"\n\
    [hard]\nno_stars = 0.2\nfalse_stars = { share = 0.3, count = [1, 4] }\n";

/// Writes the recipe and its scene.
pub(crate) fn recipe_in(folder: &Path, recipe: &str) -> PathBuf {
    std::fs::write(folder.join("sky.toml"), SCENE).unwrap();
    let path = folder.join("recipe.toml");
    std::fs::write(&path, recipe).unwrap();
    path
}

/// Every file of a folder with its bytes.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut ahead = vec![folder.to_owned()];
    while let Some(at) = ahead.pop() {
        for entry in std::fs::read_dir(&at).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                ahead.push(path);
            } else {
                found.insert(path.strip_prefix(folder).unwrap().to_owned(), std::fs::read(&path).unwrap());
            }
        }
    }
    found
}

fn made(recipe: &Path, folder: &Path, more: &[&str]) {
    let ran = run(&[&["dataset", text(recipe), "-o", text(folder)], more].concat());
    assert_eq!(ran.code, 0, "{more:?}: {}", ran.stderr);
}

#[test]
fn a_dataset_is_the_same_for_any_threads_processes_and_kills() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = recipe_in(folder.path(), RECIPE);
    let at = |name: &str| folder.path().join(name);
    made(&recipe, &at("one"), &["--threads", "1"]);
    let one = files(&at("one"));
    // Shards with marks and two tables each; dataset.json, recipe and scene, card, croissant.json, statistics, SHA256SUMS.
    assert_eq!(one.len(), 8 * 4 + 7, "{:?}", one.keys());
    let sums = String::from_utf8(one[Path::new("SHA256SUMS")].clone()).unwrap();
    assert_eq!(sums.lines().count(), one.len() - 1, "{sums}");
    made(&recipe, &at("two"), &["--threads", "2"]);
    assert!(one == files(&at("two")), "another number of threads");
    made(&recipe, &at("parts"), &["--shard", "1/2"]);
    assert!(!at("parts").join("SHA256SUMS").exists());
    let early = run(&["dataset", "finish", text(&at("parts"))]);
    assert!(early.code == 1 && early.stderr.contains("4 of 8 shards are not made, the first is train/000000.tar"), "{}", early.stderr);
    made(&recipe, &at("parts"), &["--shard", "0/2"]);
    assert!(one == files(&at("parts")), "in two parts");
    // As on a machine without these instructions: the system's mathematics takes other ways then.
    let old = Command::new(assert_cmd::cargo::cargo_bin("boresight"))
        .args(["dataset", text(&recipe), "-o", text(&at("old")), "--quiet"])
        .env("GLIBC_TUNABLES", "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX,-AVX512F,-AVX2_Usable,-FMA_Usable")
        .stdout(Stdio::null())
        .status()
        .unwrap();
    assert!(old.success() && one == files(&at("old")), "without AVX2 and FMA");
    let again = run(&["dataset", text(&recipe), "-o", text(&at("two"))]);
    assert!(again.stdout.contains("0 shards made, 8 were done before; whole"), "{}", again.stdout);
    // What is written at the end is written again as it was.
    for name in ["README.md", "croissant.json", "statistics.html", "SHA256SUMS"] {
        std::fs::remove_file(at("two").join(name)).unwrap();
    }
    let finished = run(&["dataset", "finish", text(&at("two"))]);
    assert!(finished.code == 0 && finished.stdout.contains("16 frames in 8 shards; whole"), "{}{}", finished.stdout, finished.stderr);
    assert!(one == files(&at("two")), "finished anew");
}

/// Twenty kills, at times drawn from a seed, for each way to share the work: at 1, 2 and 4 threads in one process, and in four processes.
#[test]
fn a_dataset_killed_at_random_times_is_the_same() {
    const KILLS: usize = 20;
    const LONGEST_MS: u64 = 150;
    let folder = tempfile::tempdir().unwrap();
    let recipe = recipe_in(folder.path(), RECIPE);
    let (whole, cut) = (folder.path().join("whole"), folder.path().join("cut"));
    made(&recipe, &whole, &[]);
    let whole = files(&whole);
    let mut rng = Pcg64Mcg::seed_from_u64(20);
    for (threads, processes) in [("1", 1), ("2", 1), ("4", 1), ("1", 4)] {
        let _ = std::fs::remove_dir_all(&cut);
        let mut unfinished = 0;
        for _ in 0..KILLS {
            // Whole before it was killed: that one is looked at, and the next begins from nothing.
            if cut.join("SHA256SUMS").exists() {
                assert!(whole == files(&cut), "{threads} threads, {processes} processes");
                std::fs::remove_dir_all(&cut).unwrap();
            }
            let begin = |part: usize| {
                let share = format!("{part}/{processes}");
                Command::new(assert_cmd::cargo::cargo_bin("boresight"))
                    .args(["dataset", text(&recipe), "-o", text(&cut), "--threads", threads, "--shard", &share, "--quiet"])
                    .stdout(Stdio::null())
                    .stderr(Stdio::null())
                    .spawn()
                    .unwrap()
            };
            let children: Vec<Child> = (0..processes).map(begin).collect();
            let begun = Instant::now();
            while !cut.join("train").exists() && begun.elapsed() < Duration::from_secs(20) {
                std::thread::sleep(Duration::from_millis(1));
            }
            for mut child in children {
                std::thread::sleep(Duration::from_millis(rng.random_range(0..LONGEST_MS / processes as u64)));
                unfinished += usize::from(child.try_wait().unwrap().is_none());
                let _ = child.kill(); // SIGKILL
                child.wait().unwrap();
            }
        }
        // A kill of what has ended already tries nothing.
        assert!(unfinished >= KILLS / 2, "{unfinished} of {} at work when killed", KILLS * processes);
        made(&recipe, &cut, &["--threads", threads]);
        assert!(whole == files(&cut), "{threads} threads, {processes} processes, after {unfinished} kills");
    }
}

#[test]
fn frames_of_a_gpu_say_so_and_never_stand_beside_those_of_the_cpu() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = recipe_in(folder.path(), &RECIPE.replace("train = 12, test = 4", "train = 2, test = 2"));
    let [cpu, gpu] = ["cpu", "gpu"].map(|name| folder.path().join(name));
    made(&recipe, &cpu, &[]);
    made(&recipe, &gpu, &["--backend", "gpu"]);
    let adapter = |set: &Path| {
        let told: Value = serde_json::from_slice(&std::fs::read(set.join("dataset.json")).unwrap()).unwrap();
        told["backend"].as_str().unwrap().to_owned()
    };
    assert_eq!(adapter(&cpu), "cpu");
    assert!(adapter(&gpu).len() > 5 && adapter(&gpu) != "cpu", "{}", adapter(&gpu));
    crate::common::log_gpu_test("frames_of_a_gpu_say_so_and_never_stand_beside_those_of_the_cpu", &adapter(&gpu));
    for (set, more) in [(&gpu, &[][..]), (&cpu, &["--backend", "gpu"][..])] {
        let ran = run(&[&["dataset", text(&recipe), "-o", text(set)], more].concat());
        assert!(ran.code == 1 && ran.stderr.contains("holds a dataset of another recipe"), "{}", ran.stderr);
    }
    let looked_at = run(&["dataset", "verify", text(&gpu)]);
    assert!(looked_at.code == 0 && looked_at.stdout.contains("4 frames made again"), "{}{}", looked_at.stdout, looked_at.stderr);
    // Within the tolerance of the twins: no count differs by more than one.
    let image = |set: &Path| {
        let (one, name) = (folder.path().join("one"), "000000001.image.png");
        let backend = if set == cpu { "cpu" } else { "gpu" };
        let ran = run(&["dataset", text(&recipe), "--frame", "1", "-o", text(&one), "--force", "--backend", backend]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        image::open(one.join(name)).unwrap().into_luma16().into_raw()
    };
    let differ = image(&cpu).iter().zip(image(&gpu)).map(|(cpu, gpu)| cpu.abs_diff(gpu)).max().unwrap();
    assert!(differ <= 1, "a count differs by {differ}");
}

#[test]
fn a_finished_dataset_tells_what_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = recipe_in(folder.path(), RECIPE);
    let set = folder.path().join("set");
    made(&recipe, &set, &[]);
    let read = |name: &str| std::fs::read_to_string(set.join(name)).unwrap();
    let card = read("README.md");
    assert!(card.starts_with("---\nlicense: cc-by-4.0\npretty_name: tiny\nsize_categories:\n- n<1K\n"), "{card}");
    for told in
        ["  - split: test\n    path: test/*.tar\n", "tables/train/*.stars.parquet", "| train | 12 | 6 of 2 | 2 |", "| train, test |"]
    {
        assert!(card.contains(told), "{told} is not in {card}");
    }
    let croissant: Value = serde_json::from_str(&read("croissant.json")).unwrap();
    assert_eq!(croissant["distribution"].as_array().unwrap().len(), 8 * 3 + 2);
    let page = read("statistics.html");
    assert!(page.contains("<svg") && page.contains("data:image/png;base64,") && page.contains("in a ball of radius 0.5"));
    assert!(!page.contains("http"), "the page needs nothing from elsewhere");
    // The tables say what the labels say.
    let table = |name: &str| SerializedFileReader::new(std::fs::File::open(set.join(name)).unwrap()).unwrap();
    let frames = table("tables/test/000001.frames.parquet");
    let cell = |row: &Row, name: &str| row.get_column_iter().find(|(own, _)| *own == name).unwrap().1.clone();
    let rows: Vec<Row> = frames.get_row_iter(None).unwrap().map(Result::unwrap).collect();
    let keys: Vec<Field> = rows.iter().map(|row| cell(row, "key")).collect();
    assert_eq!(keys, [Field::Long(200_000_002), Field::Long(200_000_003)]);
    let one = run(&["dataset", text(&recipe), "--frame", "200000003", "-o", text(&folder.path().join("one"))]);
    assert_eq!(one.code, 0, "{}", one.stderr);
    let labels: Value = serde_json::from_slice(&std::fs::read(folder.path().join("one/200000003.json")).unwrap()).unwrap();
    assert_eq!(cell(&rows[1], "camera"), Field::Long(labels["camera"].as_i64().unwrap()));
    assert_eq!(cell(&rows[1], "pixels_sha256"), Field::Str(labels["pixels_sha256"].as_str().unwrap().to_owned()));
    let stars = table("tables/test/000001.stars.parquet");
    let of_frame = stars.get_row_iter(None).unwrap().map(Result::unwrap).filter(|row| cell(row, "key") == Field::Long(200_000_003));
    let places: Vec<Field> = of_frame.map(|row| cell(&row, "x_px")).collect();
    let labelled: Vec<Field> = labels["lights"]["x_px"].as_array().unwrap().iter().map(|x| Field::Double(x.as_f64().unwrap())).collect();
    assert_eq!(places, labelled);
    for (args, code, told) in [
        (vec!["dataset", "finish", text(&recipe)], 1, "is a file and not the folder of a dataset"),
        (vec!["dataset", "finish", text(folder.path())], 1, "holds no dataset.json; make the dataset with"),
        (vec!["dataset", "verify", text(folder.path())], 1, "holds no dataset.json"),
    ] {
        let ran = run(&args);
        assert!(ran.code == code && ran.stderr.contains(told), "{args:?}: {} {}", ran.code, ran.stderr);
    }
}

#[test]
fn a_folder_belongs_to_its_recipe() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = recipe_in(folder.path(), RECIPE);
    let target = folder.path().join("set");
    made(&recipe, &target, &[]);
    std::fs::write(target.join("notes.txt"), "mine").unwrap();
    recipe_in(folder.path(), &RECIPE.replace("seed = 5", "seed = 6"));
    let refused = run(&["dataset", text(&recipe), "-o", text(&target)]);
    assert_eq!(refused.code, 1);
    assert!(refused.stderr.contains("holds a dataset of another recipe"), "{}", refused.stderr);
    made(&recipe, &target, &["--force"]);
    assert_eq!(std::fs::read_to_string(target.join("notes.txt")).unwrap(), "mine");
    // A shard that somebody cut is told, and one whose mark is gone is made anew.
    let shard = target.join("train/000001.tar");
    let whole = std::fs::read(&shard).unwrap();
    std::fs::write(&shard, &whole[..1000]).unwrap();
    let cut = run(&["dataset", text(&recipe), "-o", text(&target)]);
    assert!(cut.code == 1 && cut.stderr.contains("has 1000 bytes and not the"), "{}", cut.stderr);
    std::fs::remove_file(target.join("shards/train-000001.json")).unwrap();
    made(&recipe, &target, &[]);
    assert!(std::fs::read(&shard).unwrap() == whole);
    let foreign = folder.path().join("foreign");
    std::fs::create_dir(&foreign).unwrap();
    std::fs::write(foreign.join("a"), "b").unwrap();
    assert_eq!(run(&["dataset", text(&recipe), "-o", text(&foreign), "--force"]).code, 1);
    assert_eq!(files(&foreign).len(), 1);
}

#[test]
fn frames_and_scenes_are_had_one_by_one() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = recipe_in(folder.path(), RECIPE);
    let at = |name: &str| folder.path().join(name);
    let scene = run(&["dataset", text(&recipe), "--scene", "200000003"]);
    assert_eq!(scene.code, 0, "{}", scene.stderr);
    std::fs::write(at("frame.toml"), &scene.stdout).unwrap();
    assert_eq!(run(&["simulate", text(&at("frame.toml")), "-o", text(&at("night")), "--backend", "cpu", "--no-pixel-shifts"]).code, 0);
    let one = run(&["dataset", text(&recipe), "--frame", "200000003", "-o", text(&at("one"))]);
    assert_eq!(one.code, 0, "{}", one.stderr);
    let image = image::open(at("one").join("200000003.image.png")).unwrap().into_luma16().into_raw();
    let recording = boresight::recording::Recording::open(&[at("night")]).unwrap();
    let simulated = recording.load_frame(0).unwrap();
    assert!(simulated.pixels_dn.iter().zip(&image).all(|(simulated, own)| *simulated == f32::from(*own)));
    let labels: Value = serde_json::from_slice(&std::fs::read(at("one").join("200000003.json")).unwrap()).unwrap();
    assert_eq!((&labels["split"], &labels["camera"]), (&Value::from("test"), &Value::from(20_000)));
    for (args, code, told) in [
        (vec!["--scene", "12"], 1, "there is no frame 12; there are 0 to 11 (train), 200000000 to 200000003 (test)"),
        (vec![], 2, "dataset needs a folder"),
        (vec!["--shard", "2/2", "-o", "x"], 2, "give I/N with I from 0 to N − 1"),
    ] {
        let ran = run(&[&["dataset", text(&recipe)], args.as_slice()].concat());
        assert_eq!(ran.code, code, "{args:?}: {}", ran.stderr);
        assert!(ran.stderr.contains(told), "{args:?}: {}", ran.stderr);
    }
    let plan = run(&["dataset", text(&recipe), "--plan"]);
    assert!(plan.code == 0 && plan.stdout.contains("tiny: 16 frames in 8 shards of 2;"), "{}{}", plan.stdout, plan.stderr);
    assert!(
        plan.stdout.contains("train and test: nearest boresights ")
            && plan.stdout.contains("shared cameras 0, shared seeds 0, shared stars 0.00 %")
    );
    assert!(plan.stdout.contains("drawn per frame, even: frames.rate_deg_s, ball = { radius = 0.5 }\n"), "{}", plan.stdout);
    assert!(!at("set").exists());
}

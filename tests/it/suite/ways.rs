//! Ways to a program under test, what is wrong with a suite, and what becomes of a result.

use super::{folder, planted_tracker, tested};
use crate::cli::{run, text};

/// A suite of a tracker with 12 frames in a mode.
fn suite(words: &str, system: &str) -> String {
    format!(
        "format = \"boresight-suite/1\"\n[system]\ncommand = [{:?}, {words}]\n{system}\n\
         [[case]]\nname = \"all sky\"\nscene = \"scene.toml\"\nframes = 12\nwithin_arcsec = 400\n\
         [[case.require]]\nmetric = \"acquisition.correct_rate\"\nat_least = 0.7\n",
        planted_tracker().display().to_string()
    )
}

#[test]
fn frames_reach_a_process_each_and_a_stream() {
    let frame = "\"none\", \"--truth\", \"{truth}\", \"--answer\", \"{answer}\", \"--sidecars\", \"{image}\"";
    for (image, workers) in [("png8", 1), ("png16", 4), ("tiff16", 1), ("fits", 1), ("raw16", 1)] {
        let folder = folder(&suite(frame, &format!("image = {image:?}\nworkers = {workers}")));
        let (run, value) = tested(folder.path(), &[]);
        assert_eq!(run.code, 0, "{image}: {}", run.stderr);
        assert_eq!(value["cases"][0]["values"][0]["measured"][0]["value"], 1.0, "{image}");
    }
    let both = folder(&suite("\"none\", \"--stream\", \"{truth}\"", "mode = \"stream\""));
    assert_eq!(tested(both.path(), &[]).0.code, 0);
}

#[test]
fn a_program_that_is_not_there_is_said_so() {
    let folder = folder(&suite("\"none\", \"{image}\", \"{answer}\"", "").replace("planted_tracker", "no_such_tracker"));
    let (run, _) = tested(folder.path(), &[]);
    assert_eq!(run.code, 1);
    assert!(run.stderr.contains("the system under test cannot be started: ") && run.stderr.contains("no_such_tracker"), "{}", run.stderr);
}

#[test]
fn answers_cut_short_are_named() {
    let words = "\"partial\", \"--truth\", \"{truth}\", \"--answer\", \"{answer}\", \"{image}\"";
    let folder = folder(&suite(words, ""));
    let (run, value) = tested(folder.path(), &[]);
    assert_eq!(run.code, 3);
    let sentence = value["cases"][0]["values"][0]["faults"][0]["sentence"].as_str().unwrap();
    assert!(
        sentence.starts_with("the answer cannot be read at 12 of 12 frames; the first is frame 0: line 2: ")
            && sentence.contains("cut short"),
        "{sentence}"
    );
}

#[test]
fn conventions_are_guessed() {
    for (fault, code, words) in [
        ("none", 0, "20 of 20 answers agree with what is declared"),
        ("conjugated", 3, "rotation = \"icrs_from_camera\""),
        ("scalar-first", 3, "quaternion = \"wxyz\""),
        ("mirrored", 3, "x left, y down, z out"),
    ] {
        let folder = folder(&suite(&format!("{fault:?}, \"--stream\", \"--sidecars\", \"{{truth}}\""), "mode = \"stream\""));
        let told = run(&["test", text(&folder.path().join("suite.toml")), "--guess-conventions", "--quiet"]);
        assert_eq!(told.code, code, "{fault}: {}", told.stdout);
        assert!(told.stdout.contains(words), "{fault}: {}", told.stdout);
    }
    let folder = folder(&suite("\"half-pixel\", \"--stream\", \"--sidecars\", \"{truth}\"", "mode = \"stream\""));
    let told = run(&["test", text(&folder.path().join("suite.toml")), "--guess-conventions", "--quiet"]);
    assert!(told.stdout.contains("pixel_origin = 0.5"), "{}", told.stdout);
}

#[test]
fn files_of_answers_are_checked() {
    let folder = folder(&suite("\"none\", \"{image}\", \"{answer}\"", ""));
    let (suite, file) = (folder.path().join("suite.toml"), folder.path().join("answers.csv"));
    for (table, code, words) in [
        ("frame,status,qi,qj,qk,qw\n0,solved,0,0,0,1\n", 0, "nothing is wrong with it"),
        ("frame,status,qi,qj,qk,qw\n0,solved,0,0,0\n", 3, "line 2"),
        ("frame,status,qi,qj,qk\n", 3, "there is neither a quaternion"),
    ] {
        std::fs::write(&file, table).unwrap();
        let told = run(&["test", text(&suite), "--check-answer", text(&file)]);
        assert_eq!(told.code, code, "{table}: {}", told.stdout);
        assert!(told.stdout.contains(words), "{table}: {}", told.stdout);
    }
}

/// A wrong suite is told with line, value and remedy, before any frame.
#[test]
fn what_is_wrong_with_a_suite_is_told_with_its_line() {
    let good = "format = \"boresight-suite/1\"\n[[case]]\nname = \"a\"\nscene = \"scene.toml\"\nframes = 10\n";
    let rule = |text: &str| format!("{good}[[case.require]]\n{text}\n");
    let at_least = "at_least = 0.5\n";
    for (suite, words) in [
        (good.replace("boresight-suite/1", "suite"), "format = \"suite\" is no suite"),
        (good.replace("frames = 10", "framse = 10"), "line 5: unknown key framse; did you mean frames?"),
        (good.replace("frames = 10", "frames = \"many\""), "line 2: frames = \"many\"; give a number or \"auto\""),
        (good.replace("scene.toml", "scnee.toml"), "cannot be read"),
        (good.replace("frames = 10", "frames = 10\nattitudes = \"uniformly\""), "attitudes"),
        (
            good.replace("frames = 10", "frames = 10\nsweep = { path = \"camera.focal_lenght_px\", values = [1] }"),
            "camera has no key focal_lenght_px; did you mean focal_length_px?",
        ),
        (
            rule("metric = \"acquisition.corect_rate\"\nat_least = 0.5"),
            "line 6: there is no metric acquisition.corect_rate; did you mean acquisition.correct_rate?",
        ),
        (rule("metric = \"acquisition.correct_rate\""), "line 6: a requirement has either at_least or at_most"),
        (
            rule("metric = \"acquisition.correct_rate\"\nat_least = 0.999"),
            "by 10 frames: without a single failure it takes 2995; set frames = 2995 or more",
        ),
        (rule("metric = \"ecss.cross_boresight_arcsec.fov_spatial\"\nat_most = 1"), "needs attitudes = \"nested\"; this case has uniform"),
        (rule(&format!("metric = \"acquisition.correct_rate\"\n{at_least}when = \"rate < 1\"")), "the case has no sweep"),
        (rule("metric = \"diagnosis.right_name_rate\"\nat_least = 0.1\nconfidence = 0.5"), "write diagnose = true into [own]"),
        (format!("{good}{}", good.split_once('\n').unwrap().1), "line 6: the name \"a\" is that of the case in line 2"),
        (
            good.replace("[[case]]", "[system]\ncommand = [\"a\", \"{imgae}\", \"{image}\", \"{answer}\"]\n[[case]]"),
            "{imgae} is filled in by nothing; did you mean {image}?",
        ),
        (good.replace("[[case]]", "[system]\ncommand = [\"a\"]\n[[case]]"), "does not say where {image} goes"),
        (
            good.replace("[[case]]", "[system]\ncommand = [\"a\", \"{image}\", \"{answer}\"]\nconventions = { axes = \"x up\" }\n[[case]]"),
            "write where each axis points",
        ),
    ] {
        let folder = folder(&suite);
        let (run, _) = tested(folder.path(), &[]);
        assert_eq!(run.code, 1, "{suite}: {}", run.stdout);
        assert!(run.stderr.contains(words) && run.stderr.trim_end().lines().count() == 1, "{suite}\n{}\nwithout: {words}", run.stderr);
    }
}

const OWN: &str = "format = \"boresight-suite/1\"\n[[case]]\nname = \"own, all sky\"\nscene = \"scene.toml\"\nframes = 20\nwithin_arcsec = 400\n\
                   [[case.require]]\nmetric = \"acquisition.correct_rate\"\nat_least = 0.8\n\
                   [[case.require]]\nmetric = \"attitude.cross_boresight_arcsec.rms\"\nat_most = LIMIT\n\
                   [[case.require]]\nmetric = \"centroids.error_px.rms\"\nat_most = 1e-6\nlevel = \"stretch\"\n";

#[test]
fn the_own_pipeline_is_tested_the_same_every_time_and_its_result_is_kept() {
    let folder = folder(&OWN.replace("LIMIT", "100.0"));
    let out = folder.path().join("tested");
    let junit = folder.path().join("own.xml");
    let (first, value) = tested(folder.path(), &["-o", text(&out), "--junit", text(&junit)]);
    assert_eq!(first.code, 0, "{} {}", first.stderr, value["cases"]);
    assert_eq!(value["verdict"], "pass");
    let own = &value["cases"][0]["values"][0]["requirements"];
    assert_eq!((&own[0]["verdict"], &own[2]["verdict"]), (&"pass".into(), &"fail".into()));
    // A level above minimum decides nothing.
    let xml = std::fs::read_to_string(&junit).unwrap();
    assert!(xml.contains("<testsuite name=\"own, all sky\" tests=\"3\" skipped=\"1\"") && !xml.contains("disabled"), "{xml}");
    let page = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.starts_with("<!doctype html>") && !page.contains("<script") && !page.contains("http"), "{}", &page[..200]);
    let (again, other) = tested(folder.path(), &["--threads", "1"]);
    assert_eq!(again.code, 0);
    let without_times = |value: &serde_json::Value| {
        let mut value = value["cases"][0]["values"][0].clone();
        value["seconds"] = 0.into();
        for worst in value["worst"].as_array_mut().unwrap() {
            worst.as_object_mut().unwrap().remove("folder");
        }
        value["measured"].as_array_mut().unwrap().retain(|own| own["metric"] != "latency_s.p50");
        value
    };
    assert_eq!(without_times(&value), without_times(&other));
    let (fresh, other) = tested(folder.path(), &["--seed", "2"]);
    assert_eq!(fresh.code, 0);
    assert_ne!(without_times(&value), without_times(&other));
    // Against itself nothing is worse; a limit that is broken is exit code 3.
    let (same, told) = tested(folder.path(), &["--baseline", text(&out.join("test.json")), "--no-regression"]);
    assert_eq!((same.code, told["baseline"]["worse"].as_array().map(Vec::len)), (0, Some(0)));
    std::fs::write(folder.path().join("suite.toml"), OWN.replace("LIMIT", "0.5")).unwrap();
    let (broken, told) = tested(folder.path(), &[]);
    assert_eq!((broken.code, &told["verdict"]), (3, &"fail".into()));
}

/// The scene of a failure is that of the frame; the effect that makes it is named, and the sweep is bisected.
#[test]
fn a_failure_is_made_small() {
    let suite = "format = \"boresight-suite/1\"\n[[case]]\nname = \"Slewing\"\nscene = \"scene.toml\"\nframes = 30\nwithin_arcsec = 400\n\
                 set = { \"effects.prnu.relative\" = 0.001 }\n\
                 sweep = { path = \"frames.rate_deg_s[1]\", values = [0.0, 20.0], name = \"rate\" }\n\
                 [[case.require]]\nmetric = \"acquisition.correct_rate\"\nat_least = 0.85\n";
    let folder = folder(suite);
    let out = folder.path().join("tested");
    let (run, value) = tested(folder.path(), &["-o", text(&out)]);
    assert_eq!(run.code, 3, "{} {}", run.stderr, value["cases"]);
    let small = &value["cases"][0]["smallest_failure"];
    let between = small["fails_between"].as_array().unwrap();
    assert!(between[0].as_f64().unwrap() < between[1].as_f64().unwrap() && between[1].as_f64().unwrap() < 20.0, "{small}");
    assert_eq!(small["needed"], serde_json::json!(["turning of the camera"]), "{small}");
    assert!(small["superfluous"].as_array().unwrap().contains(&"prnu".into()), "{small}");
    assert!(small["sentence"].as_str().unwrap().starts_with("acquisition.correct_rate fails from rate = "), "{small}");
    let scene = out.join(small["scene"].as_str().unwrap());
    let rendered = crate::cli::run(&["simulate", text(&scene), "-o", text(&folder.path().join("night")), "--quiet"]);
    assert_eq!(rendered.code, 0, "{}", rendered.stderr);
    // The frame that was kept is the frame that its scene renders.
    let worst = value["cases"][0]["values"][1]["worst"][0]["folder"].as_str().unwrap();
    let kept = out.join(worst);
    let again = folder.path().join("again");
    let rendered = crate::cli::run(&[
        "simulate",
        text(&kept.join("scene.toml")),
        "-o",
        text(&again),
        "--image-format",
        "png16",
        "--backend",
        "cpu",
        "--quiet",
    ]);
    assert_eq!(rendered.code, 0, "{}", rendered.stderr);
    let pixels = |path: std::path::PathBuf| boresight::recording::load_image(&path).unwrap().pixels_dn;
    assert_eq!(pixels(kept.join("frame.png")), pixels(again.join("frames/0000.png")));
    assert!(kept.join("picture.png").exists() && kept.join("truth_and_answer.json").exists());
}

#[test]
fn a_suite_to_begin_from_is_a_suite() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("suite.toml");
    for preset in boresight::scene::PRESETS {
        let told = run(&["test", "--init", preset.name]);
        assert_eq!(told.code, 0, "{}: {}", preset.name, told.stderr);
        std::fs::write(&path, &told.stdout).unwrap();
        let plan = boresight::suite::SuitePlan::open(&path, None).unwrap_or_else(|error| panic!("{}: {error}", preset.name));
        assert!(plan.cases.len() >= 7 && plan.judged() > 10, "{}", preset.name);
    }
    assert_eq!(run(&["test", "--init", "no-such-preset"]).code, 2);
}

//! Ten faults that are planted into a tracker, each named by a sentence; and a tracker without any.

use serde_json::Value;

use super::{folder, planted_tracker, tested};

/// The suite that all are held against; `sidecars`: whether centroids and camera stand in the answer.
fn suite(fault: &str, sidecars: bool) -> String {
    let tracker = planted_tracker();
    let words = if sidecars { ", \"--sidecars\"" } else { "" };
    let mut text = format!(
        "format = \"boresight-suite/1\"\nconfidence = 0.9\n\
         [system]\nname = \"planted\"\ncommand = [{:?}, {fault:?}, \"--stream\"{words}, \"{{truth}}\"]\nmode = \"stream\"\nimage = \"raw16\"\ntimeout_s = 0.5\n\
         [[case]]\nname = \"all sky\"\nscene = \"scene.toml\"\nframes = 45\nwithin_arcsec = 400\nabout_within_arcsec = 4000\n\
         [[case.require]]\nmetric = \"acquisition.correct_rate\"\nat_least = 0.95\n\
         [[case.require]]\nmetric = \"attitude.cross_boresight_arcsec.rms\"\nat_most = 5.0\n",
        tracker.display().to_string()
    );
    if sidecars {
        text += "[[case.require]]\nmetric = \"identification.wrong_rate\"\nat_most = 0.02\nlevel = \"minimum\"\nconfidence = 0.5\n\
                 [[case.require]]\nmetric = \"calibration.focal_length_relative.max\"\nat_most = 5e-4\n";
    }
    text
}

/// The verdict, the names of faults, and the sentences.
fn found(fault: &str, sidecars: bool) -> (i32, Vec<String>, String) {
    let folder = folder(&suite(fault, sidecars));
    let (run, value) = tested(folder.path(), &["--no-smallest"]);
    assert!(run.code == 0 || run.code == 3, "{fault}: {} {}", run.code, run.stderr);
    let own = &value["cases"][0]["values"][0];
    let names = own["faults"].as_array().unwrap().iter().map(|one| one["name"].as_str().unwrap().to_owned()).collect();
    let reasons = own["requirements"].as_array().unwrap().iter().flat_map(|one| one["reasons"].as_array().unwrap());
    let sentences: Vec<&str> = reasons.filter_map(Value::as_str).collect();
    (run.code, names, sentences.join("\n"))
}

/// What is planted, whether the attitudes alone show it, the name of the fault, and words of its sentence.
const PLANTED: [(&str, bool, &str, &str); 11] = [
    ("y-flipped", true, "y-flipped", "the y axis"),
    ("half-pixel", true, "half-pixel-origin", "half a pixel off"),
    ("middle", true, "origin-in-the-middle", "in the middle of the frame and not at its first pixel"),
    ("conjugated", true, "conjugated", "the quaternion is conjugated"),
    ("scalar-first", true, "scalar-first", "the quaternion has the scalar first"),
    ("aberration", true, "aberration", "stellar aberration is left out"),
    ("mirrored", true, "mirrored", "mirrored"),
    ("focal-length", false, "focal-length", "the focal length is 0.100 % too long"),
    ("wrong-ids", false, "wrong-ids", "% of the star identifications are wrong"),
    ("crash", true, "crash", "the program ended by itself at 9 of 45 frames; the first is frame 3: ended by signal 6 (abort)"),
    ("hang", true, "hang", "the program did not answer in time at 9 of 45 frames"),
];

#[test]
fn every_planted_fault_is_named() {
    for (fault, shows_alone, name, words) in PLANTED {
        for sidecars in [true, false] {
            if !sidecars && !shows_alone {
                continue;
            }
            let (code, names, sentences) = found(fault, sidecars);
            assert_eq!(code, 3, "{fault}, sidecars {sidecars}: {names:?}");
            assert!(names.contains(&name.to_owned()), "{fault}, sidecars {sidecars}: {names:?}\n{sentences}");
            assert!(sentences.contains(words), "{fault}, sidecars {sidecars}: {sentences}");
            // And no other fault is named with it.
            assert_eq!(names.len(), 1, "{fault}, sidecars {sidecars}: {names:?}\n{sentences}");
        }
    }
}

#[test]
fn a_tracker_without_a_fault_is_told_of_none() {
    for sidecars in [true, false] {
        let (code, names, sentences) = found("none", sidecars);
        assert_eq!((code, names.len()), (0, 0), "{names:?} {sentences}");
    }
}

/// From attitudes alone nobody can tell focal length and names: that is said where something fails without a named fault.
#[test]
fn what_attitudes_cannot_show_is_said() {
    let (code, names, sentences) = found("false-per-1000=300", false);
    assert_eq!((code, names.len()), (3, 0), "{names:?}");
    assert!(
        sentences.contains("one cannot tell a wrong focal length and wrong star identifications (write camera.json and centroids.csv"),
        "{sentences}"
    );
}

#[test]
fn garbage_is_named_with_its_place() {
    let (code, names, sentences) = found("garbage", false);
    assert_eq!((code, names), (3, vec!["unreadable".to_owned()]), "{sentences}");
    assert!(sentences.contains("the answer cannot be read at 45 of 45 frames; the first is frame 0: line 1, column"), "{sentences}");
}

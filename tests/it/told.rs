//! What the command line says of bare images, and how much memory many frames take.

use std::process::Command;

use boresight::pipeline::with_name;
use boresight::recording::{Recording, write_png_u16};

use crate::cli::{json, number, run, short_night, text};

/// A folder of PNGs of a simulated night: no time, no exposure, no site.
fn bare_images() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let scene = short_night(folder.path(), &[("count = 12", "count = 2")]);
    let night = folder.path().join("night");
    assert_eq!(run(&["simulate", text(&scene), "-o", text(&night), "--backend", "cpu"]).code, 0);
    let recording = Recording::open(&[&night]).unwrap();
    let images = folder.path().join("images");
    std::fs::create_dir(&images).unwrap();
    for index in 0..recording.frames.len() {
        let frame = recording.load_frame(index).unwrap();
        let counts: Vec<u16> = frame.pixels_dn.iter().map(|count| *count as u16).collect();
        write_png_u16(&images.join(format!("{index}.png")), frame.width_px, frame.height_px, &counts).unwrap();
    }
    folder
}

#[test]
fn a_date_changes_the_answer_of_bare_images() {
    let folder = bare_images();
    let images = folder.path().join("images");
    let images = text(&images);
    let [without, with] = [&[][..], &["--time", "2026-03-01T22:15:00Z", "--interval-s", "20", "--exposure", "0.2"]]
        .map(|more| json(&[&["identify", images, "--json"], more].concat()));
    assert_eq!((without["frames"][0]["time_known"].as_bool(), with["frames"][0]["time_known"].as_bool()), (Some(false), Some(true)));
    assert_eq!(number(&without, "/frames/0/centre_epoch_yr"), 2000.0);
    assert!((number(&with, "/frames/0/centre_epoch_yr") - 2026.16).abs() < 0.02, "{}", with["frames"][0]["centre_epoch_yr"]);
    // aberration has 20 arcsec, which is taken out where the date is known
    let [ra, dec] = [0, 1].map(|axis| {
        let place = format!("/frames/0/centre_radec_deg/{axis}");
        number(&with, &place) - number(&without, &place)
    });
    let apart = (ra * number(&with, "/frames/0/centre_radec_deg/1").to_radians().cos()).hypot(dec);
    assert!((1e-5..0.01).contains(&apart), "{apart}");
    assert!(with["physics"].as_array().unwrap().iter().any(|id| id == "stellar-aberration"), "{}", with["physics"]);

    for (args, code, part) in [
        (vec!["--time", "last night"], 2, "is no time"),
        (vec!["--site", "95,0"], 2, "latitude from -90 to 90"),
        (vec!["--interval-s", "5"], 2, "--time"),
        (vec!["--plane", "0"], 2, "a number from 1"),
        (vec!["--time", "2026-03-01", "--site", "52,4"], 1, "give the time with its clock"),
        (vec!["--time", "2026-03-01T22:15:00Z,2026-03-01T22:16:00Z,2026-03-01T22:17:00Z"], 1, "3 times are given for 2 frames"),
    ] {
        let ran = run(&[&["detect", images][..], &args].concat());
        assert!(ran.code == code && ran.stderr.contains(part), "{args:?}: {} {}", ran.code, ran.stderr);
    }
}

#[test]
fn warnings_name_the_file_of_a_frame() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["first.png", "second.png"] {
        write_png_u16(&folder.path().join(name), 12, 10, &[5; 120]).unwrap();
    }
    let recording = Recording::open(&[folder.path()]).unwrap();
    assert_eq!(with_name("frame 1 is worse than the others", &recording), "second.png is worse than the others");
    assert_eq!(with_name("Frame 0 is mirrored otherwise than most", &recording), "first.png is mirrored otherwise than most");
    for other in ["frame 7 is not there", "frames differ", "frame one is"] {
        assert_eq!(with_name(other, &recording), other);
    }
}

/// The directions of 41,026 stars are 1 MB a frame; kept for every frame they would not fit into the limit.
#[test]
fn memory_does_not_grow_with_the_directions_of_all_frames() {
    const FRAMES: usize = 1500;
    let folder = tempfile::tempdir().unwrap();
    let head =
        "format = \"star-recording/1\"\nstars = \"stars.csv\"\n[camera]\nwidth_px = 1024\nheight_px = 1024\nfocal_length_px = 2900.0\n";
    std::fs::write(folder.path().join("recording.toml"), head.to_owned() + &"[[frames]]\nexposure_s = 0.2\n".repeat(FRAMES)).unwrap();
    let stars = (0..FRAMES).map(|frame| format!("{frame},100,200\n{frame},300,250")).collect::<Vec<_>>().join("\n");
    std::fs::write(folder.path().join("stars.csv"), format!("frame,x_px,y_px\n{stars}")).unwrap();
    let program = assert_cmd::cargo::cargo_bin("boresight");
    let script = "ulimit -v 900000; exec \"$@\"";
    let mut command = Command::new("sh");
    command.args(["-c", script, "sh"]).arg(program).args([
        "identify",
        text(folder.path()),
        "--json",
        "--physics",
        "none",
        "--threads",
        "2",
    ]);
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
    let object: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(object["frames"].as_array().unwrap().len(), FRAMES);
}

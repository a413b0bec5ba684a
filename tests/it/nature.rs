//! What nature does to a recording is found at sizes that nature has: known sizes together, speeds of the Earth, a zenith that moves on.

use std::collections::BTreeMap;
use std::path::Path;

use boresight::camera::{Camera, Model, Physics};
use boresight::catalog::Catalog;
use boresight::coordinates::{Apparent, Attitude, Direction};
use boresight::diagnose::{DiagnoseOptions, Diagnosis, Finding, Verdict, diagnose};
use boresight::effects::{Context, Observation, StarState};
use boresight::identify::{ControlPoints, listed_control_points};
use boresight::recording::{CameraInfo, Form, FrameEntry, ListedStar, Recording, Site, StarList, write_manifest};
use boresight::units::DEG_RAD;
use hifitime::{Duration, Epoch};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use crate::cli::{run, text};
use crate::common::recordings_dir;

/// A night of a camera on the ground.
struct Night {
    /// Minutes from the first frame to each.
    minutes: Vec<f64>,
    /// Altitude of each frame's boresight, degrees.
    altitudes_deg: Vec<f64>,
    noise_px: f64,
    focal_px: f64,
    faintest: f64,
    /// Effects of the sky at their known sizes.
    known: &'static [&'static str],
    /// Effects and their parameters.
    more: Vec<(&'static str, Vec<f64>)>,
}

const SIZE_PX: [usize; 2] = [808, 608];

/// The refraction of the site's air, arcsec.
fn refraction_arcsec(recording: &Recording) -> f64 {
    let air = recording.observations().unwrap()[0].refraction.unwrap();
    (air.a_rad + air.b_rad) / (DEG_RAD / 3600.0)
}

impl Night {
    fn recording(&self, seed: u64) -> Recording {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut recording = Recording::new(CameraInfo {
            width_px: SIZE_PX[0],
            height_px: SIZE_PX[1],
            focal_length_px: Some(self.focal_px.round()),
            passband: Some("V".to_owned()),
            ..CameraInfo::default()
        });
        recording.form = Form::StarList;
        recording.site = Some(Site {
            latitude_deg: 46.8,
            longitude_deg: 4.4,
            height_m: 300.0,
            pressure_hpa: Some(985.0),
            temperature_c: Some(12.0),
            relative_humidity: Some(0.5),
        });
        let start = Epoch::from_gregorian_utc(2023, 9, 7, 20, 40, 0, 0);
        let frame = |(number, minutes): (usize, &f64)| FrameEntry {
            number,
            time_utc: Some(start + Duration::from_milliseconds((minutes * 6e4).round())),
            exposure_s: Some(0.7),
            ..FrameEntry::default()
        };
        recording.frames = self.minutes.iter().enumerate().map(frame).collect();
        let observations = recording.observations().unwrap();
        let noise = Normal::new(0.0, self.noise_px).unwrap();
        let stars = observations.iter().zip(&self.altitudes_deg).map(|(observation, altitude)| {
            let model = self.model(observation);
            let attitude = pointed(observation, *altitude, rng.random_range(0.0..std::f64::consts::TAU), rng.random_range(-0.3..0.3));
            let mut listed = Vec::new();
            for star in Catalog::embedded().brighter_than(self.faintest) {
                let context = Context::new(StarState::of(star, Catalog::embedded().epoch_yr), *observation);
                let Some(at) = model.pixel(&attitude.camera_from_apparent(&model.apparent(&context)), &context) else { continue };
                let (x_px, y_px) = (at.x_px + noise.sample(&mut rng), at.y_px + noise.sample(&mut rng));
                let inside = |value: f64, size: usize| (0.0..size as f64 - 1.0).contains(&value);
                if inside(x_px, SIZE_PX[0]) && inside(y_px, SIZE_PX[1]) {
                    let covariance_px2 = Some([self.noise_px * self.noise_px, 0.0, self.noise_px * self.noise_px]);
                    listed.push(ListedStar {
                        x_px,
                        y_px,
                        flux_e: Some(1e6 * 10.0_f64.powf(-0.4 * star.magnitude)),
                        magnitude: None,
                        covariance_px2,
                        hip: Some(star.hip),
                        radec_deg: None,
                    });
                }
            }
            listed
        });
        recording.stars = Some(StarList { frames: stars.collect() });
        recording
    }

    fn model(&self, observation: &Observation) -> Model {
        let mut model = Model::new(Camera { k1: 2e-8, ..Camera::pinhole(SIZE_PX[0], SIZE_PX[1], self.focal_px) });
        for id in self.known {
            let parameters = boresight::effects::displacement(id).unwrap().predicted(observation).unwrap();
            model.set(id, &parameters).unwrap();
        }
        for (id, parameters) in &self.more {
            model.set(id, parameters).unwrap();
        }
        model
    }
}

/// A camera that looks at an altitude in some direction, its upward direction near the vertical.
fn pointed(observation: &Observation, altitude_deg: f64, azimuth_rad: f64, tilt_rad: f64) -> Attitude {
    let zenith = nalgebra::Vector3::from(observation.zenith.unwrap());
    let east = nalgebra::Vector3::z().cross(&zenith).normalize();
    let level = zenith.cross(&east) * azimuth_rad.cos() + east * azimuth_rad.sin();
    let (sin, cos) = (altitude_deg * DEG_RAD).sin_cos();
    let at = level * cos + zenith * sin;
    let (ra, dec) = Direction::<Apparent>::from_unit(at.into()).radec_rad();
    // Position angle of the zenith.
    let here_east = nalgebra::Vector3::z().cross(&at).normalize();
    let north = at.cross(&here_east);
    Attitude::from_pointing(ra, dec, zenith.dot(&here_east).atan2(zenith.dot(&north)) + tilt_rad)
}

fn without_times(mut recording: Recording) -> Recording {
    recording.site = None;
    recording.frames.iter_mut().for_each(|frame| frame.time_utc = None);
    recording
}

fn points(recording: &Recording, physics: &[&str]) -> ControlPoints {
    let physics = Physics::List(physics.iter().map(|id| (*id).to_owned()).collect());
    listed_control_points(recording, Catalog::embedded(), &physics).unwrap()
}

fn diagnosed(recording: &Recording, physics: &[&str], seed: u64) -> Diagnosis {
    let options =
        DiagnoseOptions { nulls: 100, seed, physics: physics.iter().map(|id| (*id).to_owned()).collect(), ..DiagnoseOptions::default() };
    diagnose(&points(recording, physics), &Vec::new(), &options).unwrap()
}

fn named<'a>(diagnosis: &'a Diagnosis, id: &str) -> Option<&'a Finding> {
    diagnosis.findings.iter().find(|finding| finding.id == id)
}

/// Eight frames of half an hour, of which nobody says when and where they were taken: the Earth turns by 8° meanwhile. The refraction has the size
/// of the site's air within its error, and the error is no smaller than the scatter.
#[test]
fn frames_without_times_are_not_taken_as_simultaneous() {
    const SEEDS: u64 = 20;
    let night = |seed: u64| {
        let mut rng = Pcg64Mcg::seed_from_u64(7000 + seed);
        Night {
            minutes: vec![0.0, 3.0, 8.0, 13.0, 19.0, 23.0, 28.0, 32.0],
            altitudes_deg: (0..8).map(|_| rng.random_range(32.0..68.0)).collect(),
            noise_px: 0.08,
            focal_px: 1500.0,
            faintest: 5.6,
            known: &["refraction"],
            more: Vec::new(),
        }
    };
    let pulls: Vec<Option<[f64; 3]>> = (0..SEEDS)
        .into_par_iter()
        .map(|seed| {
            let recording = night(seed).recording(seed);
            let truth = refraction_arcsec(&recording);
            let diagnosis = diagnosed(&without_times(recording), &[], seed);
            let size = &named(&diagnosis, "refraction")?.parameters[0];
            Some([size.value, size.sigma, (size.value - truth) / size.sigma])
        })
        .collect();
    let found: Vec<f64> = pulls.iter().flatten().map(|[.., pull]| *pull).collect();
    assert!(found.len() >= 16, "named in {} of {SEEDS}: {pulls:?}", found.len());
    // Normal errors: of 20 more than three lie beyond 2 standard errors with 2 %, one beyond 3.5 with 1 %.
    assert!(found.iter().filter(|pull| pull.abs() > 2.0).count() <= 3, "{pulls:?}");
    assert!(found.iter().all(|pull| pull.abs() < 3.5), "{pulls:?}");
    let mean = found.iter().sum::<f64>() / found.len() as f64;
    assert!(mean.abs() < 3.0 / (found.len() as f64).sqrt(), "all to one side: {mean} of {pulls:?}");
}

/// A speed that no camera at the Earth has is no aberration; the Earth's is.
#[test]
fn a_velocity_that_nature_does_not_have_is_no_aberration() {
    for (speed_km_s, is_natural) in [(300.0, false), (29.0, true)] {
        let night = Night {
            minutes: (0..14).map(f64::from).collect(),
            altitudes_deg: (0..14).map(|k| 35.0 + 5.0 * f64::from(k % 8)).collect(),
            noise_px: 0.03,
            focal_px: 1200.0,
            faintest: 6.2,
            known: &[],
            more: vec![("stellar-aberration", vec![0.0, 0.6 * speed_km_s, -0.7 * speed_km_s, 0.39 * speed_km_s])],
        };
        let diagnosis = diagnosed(&without_times(night.recording(3)), &[], 1);
        assert_eq!(named(&diagnosis, "stellar-aberration").is_some(), is_natural, "{speed_km_s} km/s: {:?}", diagnosis.summary);
        if !is_natural {
            assert_eq!(diagnosis.verdict, Verdict::Unexplained);
            let against = serde_json::to_string(&diagnosis.unknown).unwrap();
            assert!(against.contains("is none that nature has (0 to 42)"), "{against}");
        }
    }
}

/// Four frames at one altitude hardly show refraction, and what it does to them must not make another effect of nature larger than it is: with
/// place and time known all stand at their known sizes together, and a name stands at its known size or not at all.
#[test]
fn what_nature_adds_is_tried_together() {
    const SEEDS: u64 = 24;
    let found: Vec<Vec<Finding>> = (0..SEEDS)
        .into_par_iter()
        .map(|seed| {
            let night = Night {
                minutes: vec![0.0, 1.0, 2.0, 3.0],
                altitudes_deg: vec![60.0, 60.5, 59.5, 60.0],
                noise_px: 0.05,
                focal_px: 2200.0,
                faintest: 6.4,
                known: &["stellar-aberration", "refraction"],
                more: Vec::new(),
            };
            diagnosed(&night.recording(40 + seed), &[], seed).findings
        })
        .collect();
    for (night, Finding { id, known_amplitude, .. }) in found.iter().enumerate().flat_map(|(k, own)| own.iter().map(move |own| (k, own))) {
        assert!(["stellar-aberration", "refraction"].contains(&id.as_str()), "night {night}: {id}");
        let [ratio, sigma] = known_amplitude.unwrap_or_else(|| panic!("{id} has a known size"));
        println!("night {night}: {id} {ratio:.3} ± {sigma:.3}");
        assert!((ratio - 1.0).abs() < 3.0 * sigma, "night {night}: {id} {ratio} ± {sigma}");
    }
    // Either has four standard errors here and a name needs 4.3: something is named in a third of the nights (21 of the first 60 seeds).
    let count = found.iter().filter(|findings| !findings.is_empty()).count();
    assert!(count >= SEEDS as usize / 4, "something is named in {count} of {SEEDS}");
}

/// A seam of the sensor under a sky that nobody modelled keeps its name: it is more than what nature adds.
#[test]
fn a_seam_is_named_beside_what_nature_adds() {
    const SEEDS: u64 = 8;
    let found: Vec<Vec<String>> = (0..SEEDS)
        .into_par_iter()
        .map(|seed| {
            let night = Night {
                minutes: vec![0.0, 1.0, 2.0, 3.0],
                altitudes_deg: vec![60.0, 60.5, 59.5, 60.0],
                noise_px: 0.05,
                focal_px: 2200.0,
                faintest: 6.4,
                known: &["stellar-aberration", "refraction"],
                more: vec![("sensor-step", vec![0.09, -0.07, 600.0])],
            };
            diagnosed(&night.recording(640 + seed), &[], seed).findings.into_iter().map(|finding| finding.id).collect()
        })
        .collect();
    let named = found.iter().filter(|ids| ids.iter().any(|id| id == "sensor-step")).count();
    assert!(named >= 7, "{found:?}");
}

/// What the model contains at its size is no rival of what is missing, and a set holds only what leaves the same trace.
#[test]
fn a_set_holds_what_leaves_the_same_trace() {
    let physics = ["stellar-aberration", "refraction"];
    let mut tried = 0;
    for seed in 0..6 {
        let night = Night {
            minutes: (0..16).map(f64::from).collect(),
            altitudes_deg: (0..16).map(|k| 35.0 + 3.0 * f64::from(k % 9)).collect(),
            noise_px: 0.05,
            focal_px: 1500.0,
            faintest: 5.6,
            known: &["stellar-aberration", "refraction"],
            more: vec![("pixel-aspect", vec![6e-5])],
        };
        for finding in diagnosed(&night.recording(80 + seed), &physics, seed).findings {
            tried += 1;
            for rival in &finding.rivals {
                assert!(rival.cos >= 0.5, "{}: {rival:?}", finding.id);
            }
            for id in &finding.indistinguishable_from {
                assert!(finding.rivals.iter().any(|rival| rival.id == *id), "{id}");
            }
        }
    }
    assert!(tried >= 3, "{tried}");
}

/// Places of the stars of a simulated recording: frame and star, px.
fn places(folder: &Path) -> BTreeMap<(usize, u32), [f64; 2]> {
    let mut table = csv::Reader::from_path(folder.join("truth/stars.csv")).unwrap();
    let head = table.headers().unwrap().clone();
    let column = |name: &str| head.iter().position(|other| other == name).unwrap();
    let [frame, hip, x, y] = ["frame", "hip", "x_px", "y_px"].map(column);
    let row = |row: csv::StringRecord| {
        ((row[frame].parse().unwrap(), row[hip].parse().unwrap()), [x, y].map(|column| row[column].parse::<f64>().unwrap()))
    };
    table.records().map(|record| row(record.unwrap())).collect()
}

/// The refraction that a diagnosis without place and times found stands in the scene that it writes, and moves the stars of the rendered frames
/// as the fit has it. What lost its name is not written.
#[test]
fn what_is_written_of_an_unknown_zenith_is_rendered() {
    let folder = tempfile::tempdir().unwrap();
    let night = Night {
        minutes: vec![0.0, 6.0, 13.0, 19.0, 25.0, 32.0],
        altitudes_deg: vec![35.0, 50.0, 62.0, 41.0, 56.0, 38.0],
        noise_px: 0.05,
        focal_px: 1500.0,
        faintest: 5.6,
        known: &["refraction"],
        more: Vec::new(),
    };
    let recorded = folder.path().join("night");
    write_manifest(&recorded, &without_times(night.recording(5))).unwrap();
    let scene = folder.path().join("found.toml");
    let args = [
        "diagnose",
        text(&recorded),
        "--trust-identifications",
        "--physics",
        "none",
        "--json",
        "--nulls",
        "50",
        "--write-camera",
        text(&scene),
    ];
    let ran = run(&args);
    let object: serde_json::Value = serde_json::from_str(&ran.stdout).unwrap_or_else(|error| panic!("{error}: {}", ran.stderr));
    let findings = object["findings"].as_array().unwrap();
    let ids: Vec<&str> = findings.iter().map(|finding| finding["id"].as_str().unwrap()).collect();
    assert!(ids.contains(&"refraction"), "{ids:?} {}", object["summary"]);
    let written: toml::Table = std::fs::read_to_string(&scene).unwrap().parse().unwrap();
    let effects: Vec<&str> = written["effects"].as_array().unwrap().iter().map(|effect| effect["id"].as_str().unwrap()).collect();
    assert!(effects.iter().all(|id| ids.contains(id)), "written {effects:?}, named {ids:?}");

    // Rendered with it and without it.
    let mut bare = written.clone();
    bare["effects"].as_array_mut().unwrap().retain(|effect| effect["id"].as_str() != Some("refraction"));
    let without = folder.path().join("without.toml");
    std::fs::write(&without, toml::to_string(&bare).unwrap()).unwrap();
    let simulated = [&scene, &without].map(|scene| {
        let out = scene.with_extension("frames");
        let ran = run(&["simulate", text(scene), "-o", text(&out), "--backend", "cpu", "--quiet"]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        out
    });
    let first = |folder: &Path| {
        let frame = Recording::open(&[folder]).unwrap().frames[0].file.clone().unwrap();
        std::fs::read(if frame.is_absolute() { frame } else { folder.join(frame) }).unwrap()
    };
    assert_ne!(first(&simulated[0]), first(&simulated[1]), "the frames are the same with and without the refraction");
    let [with, without] = simulated.map(|folder| places(&folder));

    // The displacement that the fit has: of the model found under the zeniths found, between the same attitudes.
    let zeniths = object["zeniths"].as_array().unwrap();
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let mut compared = 0;
    let opened = boresight::scene::Scene::open(&scene).unwrap();
    let camera: Model = serde_json::from_value(object["camera"].clone()).unwrap();
    let size = camera.terms().find(|(id, _)| *id == "refraction").unwrap().1[0];
    let refraction = &findings.iter().find(|finding| finding["id"] == "refraction").unwrap()["parameters"][0];
    assert!((number(&refraction["value"]) - size).abs() < 0.5 * number(&refraction["sigma"]), "{size} {refraction}");
    for (frame, exposure) in opened.exposures.iter().enumerate() {
        let [ra, dec] = [0, 1].map(|axis| number(&zeniths[frame]["radec_deg"][axis]) * DEG_RAD);
        let zenith = Direction::<Apparent>::from_radec_rad(ra, dec).xyz;
        let observation = Observation { zenith: Some(zenith), zenith_is_guessed: true, ..Observation::default() };
        let mut model = opened.model.clone();
        let bare = model.clone();
        model.set("refraction", &[size, 0.0, 0.0]).unwrap();
        for star in Catalog::embedded().brighter_than(5.0) {
            let key = (frame, star.hip);
            let (Some(with), Some(without)) = (with.get(&key), without.get(&key)) else { continue };
            let context = Context::new(StarState::of(star, Catalog::embedded().epoch_yr), observation);
            let at = |model: &Model| {
                model.pixel(&exposure.attitude.camera_from_apparent(&model.apparent(&context)), &context).map(|at| [at.x_px, at.y_px])
            };
            let (Some(fitted), Some(plain)) = (at(&model), at(&bare)) else { continue };
            for axis in 0..2 {
                let off = (with[axis] - without[axis]) - (fitted[axis] - plain[axis]);
                assert!(off.abs() < 1e-3, "frame {frame}, HIP {}: {off} px", star.hip);
            }
            compared += 1;
        }
    }
    assert!(compared > 100, "{compared} star images compared");
}

/// What a scene says of a zenith is checked.
#[test]
fn a_zenith_of_a_scene_is_checked() {
    let scene = |more: &str, site: &str| {
        format!(
            "format = \"boresight-scene/1\"\nseed = 1\n{site}[camera]\nwidth_px = 64\nheight_px = 64\nfocal_length_px = 100.0\n\
             [[frames]]\nexposure_s = 1.0\nboresight_radec_deg = [10.0, 20.0]\n{more}"
        )
    };
    let refused = |more: &str, site: &str| boresight::scene::Scene::parse("a.toml", &scene(more, site)).unwrap_err().to_string();
    assert!(boresight::scene::Scene::parse("a.toml", &scene("zenith_radec_deg = [10.0, 60.0]\n", "")).is_ok());
    assert!(refused("zenith_radec_deg = [10.0, 95.0]\n", "").contains("frames[0].zenith_radec_deg = [10, 95] must be right ascension"));
    let both = refused(
        "time_utc = \"2026-03-01T20:00:00Z\"\nzenith_radec_deg = [10.0, 60.0]\n",
        "[site]\nlatitude_deg = 50.0\nlongitude_deg = 4.0\n",
    );
    assert!(both.contains("keep one of the two"), "{both}");
    let schema = boresight::scene::schema().to_string();
    assert!(schema.contains("zenith_radec_deg"));
}

/// Refraction on a real night is named however the stars are measured, and whichever of them take part.
#[test]
fn refraction_keeps_its_name_however_stars_are_measured() {
    let Some(recordings) = recordings_dir("refraction_keeps_its_name_however_stars_are_measured") else { return };
    let night = recordings.join("tetra3_esa2019");
    for how in [&["--centroid", "gaussian"][..], &["--centroid", "empirical"], &["--centroid", "windowed"], &["--all-stars"]] {
        let args = [&["diagnose", text(&night), "--json", "--nulls", "200", "--quiet"], how].concat();
        let ran = run(&args);
        let object: serde_json::Value = serde_json::from_str(&ran.stdout).unwrap_or_else(|error| panic!("{error}: {}", ran.stderr));
        let refraction = object["findings"].as_array().unwrap().iter().find(|finding| finding["id"] == "refraction");
        let refraction = refraction.unwrap_or_else(|| panic!("{how:?}: {}", object["summary"]));
        let [ratio, sigma] = [0, 1].map(|k| refraction["known_amplitude"][k].as_f64().unwrap());
        assert!((ratio - 1.0).abs() < 3.0 * sigma && sigma < 0.2, "{how:?}: {ratio} ± {sigma}");
        // Of what is significant no name may stand; that nothing shows is not said of it. Aberration is one by every estimator, most of it taken up.
        let effects = object["effects"].as_array().unwrap();
        let aberration = effects.iter().find(|effect| effect["id"] == "stellar-aberration").unwrap();
        assert!(aberration["p_value"].as_f64().unwrap() < 1e-4 && aberration["survival"].as_f64().unwrap() < 0.1, "{how:?}: {aberration}");
        assert!(["found", "withheld"].contains(&aberration["status"].as_str().unwrap()), "{how:?}: {aberration}");
    }
}

/// It keeps its name where the detector is declared: photons then tell how large the errors are, bright stars weigh more, and a pattern along x
/// that is no part of it shows. With that pattern free the size is the known one.
#[test]
fn refraction_keeps_its_name_where_the_detector_is_declared() {
    let Some(recordings) = recordings_dir("refraction_keeps_its_name_where_the_detector_is_declared") else { return };
    let night = recordings.join("tetra3_esa2019");
    let manifest = std::fs::read_to_string(night.join("recording.toml")).unwrap();
    let frames = format!("file = \"{}/frames/", night.display());
    let declared = manifest.replace("file = \"frames/", &frames).replacen(
        "[camera]",
        "[camera]\ngain_e_per_dn = 0.168\nread_noise_e = 4.6\nbias_dn = 14.0",
        1,
    );
    assert!(declared.contains("gain_e_per_dn = 0.168") && declared.contains(&frames));
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("recording.toml"), declared).unwrap();
    let ran = run(&["diagnose", text(folder.path()), "--json", "--nulls", "200", "--quiet"]);
    let object: serde_json::Value = serde_json::from_str(&ran.stdout).unwrap_or_else(|error| panic!("{error}: {}", ran.stderr));
    let refraction = object["findings"].as_array().unwrap().iter().find(|finding| finding["id"] == "refraction");
    let refraction = refraction.unwrap_or_else(|| panic!("{} {}", object["summary"], object["proposed"]));
    let [ratio, sigma] = [0, 1].map(|k| refraction["known_amplitude"][k].as_f64().unwrap());
    assert!((ratio - 1.0).abs() < 3.0 * sigma && sigma < 0.2, "{ratio} ± {sigma}");
    // Under the noise found the residuals are as large as they should be, on frames that took part in nothing too.
    let held_out = object["fit"]["final"]["held_out_chi2_per_dof"].as_f64().unwrap();
    assert!((0.8..1.3).contains(&held_out), "{held_out}");
}

/// A wide lens whose distortion goes on beyond k1: k2 and k3 are named, and that χ² falls on the frames that were not used by more than was expected is
/// nothing against them.
#[test]
fn a_wide_lens_has_k2_and_k3() {
    const TRUE: [f64; 2] = [0.06, -0.04];
    let night = Night {
        minutes: (0..10).map(f64::from).collect(),
        altitudes_deg: (0..10).map(|k| 40.0 + 4.0 * f64::from(k % 8)).collect(),
        noise_px: 0.12,
        focal_px: 620.0,
        faintest: 4.6,
        known: &[],
        more: vec![("radial-high-order", TRUE.to_vec())],
    };
    let diagnosis = diagnosed(&night.recording(11), &[], 1);
    let finding = named(&diagnosis, "radial-high-order").unwrap_or_else(|| panic!("{:?} {:?}", diagnosis.summary, diagnosis.warnings));
    for (parameter, truth) in finding.parameters.iter().zip(TRUE) {
        assert!((parameter.value - truth).abs() < 4.0 * parameter.sigma, "{parameter:?} of {truth}");
    }
}

//! Real frames, from the image alone, and frames without stars.

use boresight::coordinates::Direction;
use boresight::detect::{DetectOptions, Detections, detect};
use boresight::identify::{Identification, IdentifyOptions, identify};
use boresight::recording::Recording;

use super::{DEG, cpu_ms, sky};

/// Loads a frame and finds its stars, given nothing but the file.
fn detections_of(path: &std::path::Path) -> Detections {
    let recording = Recording::open(&[path]).unwrap();
    let frame = recording.load_frame(0).unwrap();
    detect(&frame, &DetectOptions::default()).unwrap()
}

#[test]
fn real_frames_are_identified_from_the_image_alone() {
    let Some(directory) = crate::common::recordings_dir("identify::real_frames_are_identified_from_the_image_alone") else { return };
    let (catalog, index) = sky();
    println!("index: {:?}", index.size());
    let mut reader = csv::Reader::from_path(directory.join("reference.csv")).unwrap();
    let mut faults = Vec::new();
    for record in reader.records() {
        let record = record.unwrap();
        let number = |column: usize| record[column].parse::<f64>().unwrap();
        let detections = detections_of(&directory.join(&record[0]));
        let begin = cpu_ms();
        let answer = identify(&detections, catalog, index, &[], &IdentifyOptions::default());
        let ms = cpu_ms() - begin;
        match answer {
            Identification::Identified(solution) => {
                let expected = Direction::from_radec_rad(number(1) * DEG, number(2) * DEG);
                let off_deg = solution.centre().angle_rad(&expected) / DEG;
                println!(
                    "{}: off {off_deg:.4}°, width {:.3} ({}), {}/{} matched, rms {:.3} px, k1·corner² {:.4}, P {:.1e}, parity {}, {ms:.1} ms",
                    &record[0],
                    solution.width_deg(),
                    &record[3],
                    solution.matches.len(),
                    detections.stars.len(),
                    solution.rms_px,
                    solution.camera.k1 * ((detections.width_px as f64).hypot(detections.height_px as f64) / 2.0).powi(2),
                    solution.false_match_probability,
                    solution.parity
                );
                if off_deg > 0.05 || (solution.width_deg() / number(3) - 1.0).abs() > 0.01 {
                    faults.push(format!("{}: {off_deg}° off", &record[0]));
                }
            }
            Identification::NotIdentified { reason, .. } => {
                println!("{}: {} detections, {ms:.1} ms: {reason}", &record[0], detections.stars.len());
                faults.push(format!("{}: {reason}", &record[0]));
            }
        }
    }
    assert!(faults.is_empty(), "{faults:#?}");
}

#[test]
fn real_dark_frames_are_refused() {
    let Some(directory) = crate::common::recordings_dir("identify::real_dark_frames_are_refused") else { return };
    let (catalog, index) = sky();
    let mut files: Vec<_> = std::fs::read_dir(directory.join("creusot_16mm/darks")).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert!(!files.is_empty());
    for file in files {
        let detections = detections_of(&file);
        // The most stubborn case too: the camera's true focal length is given.
        for nominal_focal_length_px in [None, Some(3234.0)] {
            let begin = cpu_ms();
            let options = IdentifyOptions { nominal_focal_length_px, search_beyond_tolerance: false, ..IdentifyOptions::default() };
            let answer = identify(&detections, catalog, index, &[], &options);
            let Identification::NotIdentified { reason, .. } = answer else { panic!("{}: {answer:?}", file.display()) };
            println!("{}: {} detections, {:.0} ms: {reason}", file.display(), detections.stars.len(), cpu_ms() - begin);
        }
    }
}

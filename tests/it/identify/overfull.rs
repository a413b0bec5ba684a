//! Frames in which noise is taken for stars by the thousand: a calibration has the stars of the others, and no blob for a star.

use boresight::calibrate::{CalibrateOptions, calibrate_identifying_anew};
use boresight::camera::Physics;
use boresight::catalog::Catalog;
use boresight::identify::{Identification, IdentifyOptions, Match};
use boresight::pipeline::{Centroid, Measured, MeasuredFrame, SkyChoice, control_points, identify_frames, star_images};
use boresight::recording::{CameraInfo, FrameEntry, Recording};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::star_lists::WIDTH_PX;
use super::{BASE, List, Scene, Told, detection, make};

/// A camera 30° wide that sees stars to V = 5.2, to half a pixel.
const CAMERA: Scene = Scene { width_deg: 30.0, faintest: 5.2, noise_px: 0.5, ..BASE };

fn measured(lists: &[List]) -> Measured {
    let mut recording = Recording::new(CameraInfo { width_px: WIDTH_PX, height_px: WIDTH_PX, ..CameraInfo::default() });
    recording.frames = vec![FrameEntry::default(); lists.len()];
    let frame = |(index, list): (usize, &List)| MeasuredFrame {
        index,
        name: format!("frame {index}"),
        detections: list.detections.clone(),
        images: Vec::new(),
        kept: Vec::new(),
        seconds: 0.0,
    };
    Measured {
        recording,
        frames: lists.iter().enumerate().map(frame).collect(),
        skipped: Vec::new(),
        psf: None,
        centroid: Centroid::Gaussian,
        own_image: None,
        pixels: None,
        star_noise: None,
    }
}

/// Six frames of the camera, in the last two of which there are thousands of blobs too, fainter than the stars.
fn night() -> Vec<List> {
    let mut rng = Pcg64Mcg::seed_from_u64(11);
    let mut lists: Vec<List> = (0..6).map(|seed| make(&CAMERA, Told::Nothing, 700 + 2 * seed)).collect();
    for list in &mut lists[4..] {
        let faintest = list.detections.stars.iter().map(|star| star.flux_dn).fold(f64::INFINITY, f64::min);
        for _ in 0..4000 {
            let [x, y] = [0; 2].map(|_| rng.random_range(0.0..WIDTH_PX as f64 - 1.0));
            list.detections.stars.push(detection(x, y, faintest * rng.random_range(0.2..0.9)));
            list.names.push(None);
        }
    }
    lists
}

#[test]
fn blobs_by_the_thousand_are_no_stars_of_a_calibration() {
    let (lists, catalog) = (night(), Catalog::embedded());
    let measured = measured(&lists);
    let choice = SkyChoice { physics: Physics::None, assumes_time: false };
    let mut identified = identify_frames(&measured, catalog, &choice, &IdentifyOptions::default(), || {}).unwrap();
    for (list, frame) in lists.iter().zip(&identified) {
        let Some(solution) = frame.solution() else { continue };
        let wrong = solution.matches.iter().filter(|one| list.names[one.detection] != Some(one.star)).count();
        println!("{} matches, {wrong} wrong, of {} stars", solution.matches.len(), list.names.iter().flatten().count());
        assert!(wrong * 20 <= solution.matches.len(), "{wrong} of {} are blobs", solution.matches.len());
    }
    let calibrated = |identified: &[_]| {
        let points = control_points(&measured, identified, catalog, None, false).unwrap();
        let images = star_images(&measured, &points);
        let options = CalibrateOptions { held_out: false, ..CalibrateOptions::default() };
        let calibration = calibrate_identifying_anew(&points.points, &images, catalog, None, &options).unwrap();
        (calibration, points.notes)
    };
    let (calibration, _) = calibrated(&identified);
    let stars: usize = lists.iter().map(|list| list.names.iter().flatten().count()).sum();
    let residuals = boresight::calibrate::residuals_px(&calibration, &calibration.camera);
    let rms_px = (residuals.iter().flatten().map(|[x, y]| x * x + y * y).sum::<f64>() / residuals.len() as f64).sqrt();
    println!("{} points of {stars} stars, {rms_px:.3} px", calibration.control_points.points.len());
    assert!(calibration.control_points.points.len() as f64 <= 1.05 * stars as f64);
    // Half a pixel a coordinate.
    assert!((0.6..0.8).contains(&rms_px), "{rms_px} px");

    // Were they identified all the same, they would be left out, with a sentence each.
    for (list, frame) in lists.iter().zip(&mut identified).skip(4) {
        let Identification::Identified(solution) = &mut frame.identification else { continue };
        let mut rng = Pcg64Mcg::seed_from_u64(2);
        for detection in list.names.len() - 900..list.names.len() {
            let residual_px = [0; 2].map(|_| rng.random_range(-8.0..8.0));
            solution.matches.push(Match { detection, star: catalog.stars.len() - 1 - detection % 4000, residual_px });
        }
        solution.rms_px = 6.0;
    }
    let (calibration, notes) = calibrated(&identified);
    assert!(calibration.control_points.points.iter().all(|point| point.frame < 4));
    let said: Vec<&String> = notes.iter().filter(|note| note.contains("is left out")).collect();
    assert!(said.len() == 2 && said[0].starts_with("frame 4") && said[1].starts_with("frame 5"), "{notes:?}");
}

//! Frames of a recording that resist alone are tried around the nearest one that is identified.

use boresight::camera::{Camera, Physics};
use boresight::catalog::Catalog;
use boresight::coordinates::{Attitude, Direction};
use boresight::detect::Detections;
use boresight::identify::{AttitudePrior, Identification, IdentifyOptions, identify};
use boresight::pipeline::{Centroid, IdentifiedFrame, Measured, MeasuredFrame, SkyChoice, identify_frames};
use boresight::recording::{CameraInfo, FrameEntry, Recording};
use nalgebra::UnitQuaternion;

use super::star_lists::WIDTH_PX;
use super::{BASE, DEG, List, Scene, Told, detection, make, sky};

/// So few stars that chance would match as many somewhere on the sky, but not within ten degrees.
const HARD: Scene = Scene { missing: 0.7, false_stars: 10, ..BASE };

/// What the camera of `list` sees without noise or false stars, turned by so much.
fn clear(list: &List, turned_deg: f64) -> Detections {
    let turn = UnitQuaternion::from_euler_angles(0.6 * turned_deg * DEG, 0.0, 0.8 * turned_deg * DEG);
    let attitude = Attitude::new(turn * list.attitude.camera_from_icrs);
    let camera = Camera::pinhole(WIDTH_PX, WIDTH_PX, list.focal_px);
    let stars = Catalog::embedded().brighter_than(BASE.faintest).iter().filter_map(|star| {
        let point = camera.pixel(&attitude.camera_from_apparent(&Direction::from_unit(star.direction.xyz)))?;
        camera.contains(point).then(|| detection(point.x_px, point.y_px, 1e5 * 10_f64.powf(-0.4 * star.magnitude)))
    });
    Detections { stars: stars.collect(), ..list.detections.clone() }
}

/// The frames of one recording, identified one after another and together.
fn identified(frames: &[&Detections], options: &IdentifyOptions) -> Vec<IdentifiedFrame> {
    let camera = CameraInfo { width_px: WIDTH_PX, height_px: WIDTH_PX, ..CameraInfo::default() };
    let mut recording = Recording::new(camera);
    recording.frames = vec![FrameEntry::default(); frames.len()];
    let frame = |(index, detections): (usize, &&Detections)| MeasuredFrame {
        index,
        name: format!("frame {index}"),
        detections: (*detections).clone(),
        images: Vec::new(),
        kept: Vec::new(),
        seconds: 0.0,
    };
    let measured = Measured {
        recording,
        frames: frames.iter().enumerate().map(frame).collect(),
        skipped: Vec::new(),
        psf: None,
        centroid: Centroid::Gaussian,
        own_image: None,
        pixels: None,
        star_noise: None,
    };
    let choice = SkyChoice { physics: Physics::None, assumes_time: false };
    identify_frames(&measured, Catalog::embedded(), &choice, options, || {}).unwrap()
}

#[test]
fn a_frame_that_resists_alone_is_found_around_the_nearest_identified_frame() {
    let (catalog, index) = sky();
    let options = |list: &List, near| IdentifyOptions {
        nominal_focal_length_px: Some(list.focal_px),
        focal_length_tolerance: 0.01,
        search_beyond_tolerance: false,
        near,
        ..IdentifyOptions::default()
    };
    let solves =
        |list: &List, near| matches!(identify(&list.detections, catalog, index, &[], &options(list, near)), Identification::Identified(_));
    let resists = |list: &List| !solves(list, None) && solves(list, Some(AttitudePrior::attitude(&list.attitude, 10.0 * DEG)));
    let hard = (0..200).map(|seed| make(&HARD, Told::Nothing, 40_051 + seed)).find(resists).expect("a list that is found only where it is");
    let (beside, elsewhere) = (clear(&hard, 5.0), clear(&make(&BASE, Told::Nothing, 3), 0.0));
    let options = options(&hard, None);
    let is_right = |frame: &IdentifiedFrame| frame.solution().is_some_and(|solution| hard.is_right(&HARD, solution));

    let led = identified(&[&elsewhere, &beside, &hard.detections], &options);
    assert!(led.iter().all(|frame| frame.solution().is_some()));
    assert!(is_right(&led[2]), "{:?}", led[2].solution());
    // The nearest in the order of the recording, not whichever helps: a camera turns on from frame to frame.
    let misled = identified(&[&beside, &elsewhere, &hard.detections], &options);
    assert!(misled[1].solution().is_some() && misled[2].solution().is_none());
    assert!(identified(&[&hard.detections], &options)[0].solution().is_none(), "there is no frame to be led by");
    // Nor is another frame believed where somebody says where the camera points.
    let anywhere = IdentifyOptions {
        near: Some(AttitudePrior { up: None, ..AttitudePrior::attitude(&hard.attitude, 180.0 * DEG) }),
        ..options.clone()
    };
    let told = identified(&[&elsewhere, &beside, &hard.detections], &anywhere);
    assert!(told[0].solution().is_some() && told[1].solution().is_some());
    assert!(told[2].solution().is_none());
}

//! Real recordings from BORESIGHT_RECORDINGS.

use boresight::recording::{Form, Recording};

use crate::common::recordings_dir;

#[test]
fn tetra3_esa2019_reads_as_its_manifest_says() {
    let Some(recordings) = recordings_dir("recording::tetra3_esa2019_reads_as_its_manifest_says") else { return };
    let recording = Recording::open(&[recordings.join("tetra3_esa2019")]).unwrap();
    assert_eq!(recording.form, Form::Manifest);
    assert_eq!(recording.frames.len(), 6);
    let camera = recording.nominal_camera().unwrap();
    assert!((camera.focal_length_px - 35_000.0 / 6.9).abs() < 1e-9);
    assert_eq!(camera.principal_point_px, [511.5, 383.5]);
    assert_eq!(recording.frames[1].altitude_azimuth_deg, Some([40.0, 135.0]));
    let frame = recording.load_frame(3).unwrap();
    assert_eq!((frame.width_px, frame.height_px, frame.saturation_dn), (1024, 768, 65520.0));
    // 12-bit data in steps of 16
    assert!(frame.pixels_dn.iter().all(|pixel| pixel % 16.0 == 0.0));
    assert!(frame.pixels_dn.iter().any(|&pixel| pixel >= 10_000.0));
}

#[test]
fn creusot_16mm_has_no_focal_length_in_pixels() {
    let Some(recordings) = recordings_dir("recording::creusot_16mm_has_no_focal_length_in_pixels") else { return };
    let recording = Recording::open(&[recordings.join("creusot_16mm").join("recording.toml")]).unwrap();
    assert_eq!(recording.frames.len(), 8);
    assert_eq!(recording.camera.focal_length_mm, Some(16.0));
    assert_eq!(recording.nominal_camera(), None);
    for frame in 0..recording.frames.len() {
        assert_eq!(recording.load_frame(frame).unwrap().saturation_dn, 255.0);
    }
}

#[test]
fn bare_images_of_several_cameras_are_read_one_by_one() {
    let Some(recordings) = recordings_dir("recording::bare_images_of_several_cameras_are_read_one_by_one") else { return };
    let paths = ["cedar/e050ms.jpg", "creusot_16mm/darks/000.png", "granasat/cisne_02sec.jpg"].map(|path| recordings.join(path));
    let recording = Recording::open(&paths).unwrap();
    assert_eq!(recording.form, Form::Images);
    for (frame, path) in paths.iter().enumerate() {
        let loaded = recording.load_frame(frame).unwrap();
        let size = recording.frames[frame].size.unwrap();
        assert_eq!((loaded.width_px, loaded.height_px), (size.width_px, size.height_px));
        assert_eq!(recording.frame_path(frame).unwrap(), *path);
    }
    let sentence = recording.common_size().unwrap_err().to_string();
    assert!(sentence.contains("000.png is 808 × 608 px") && sentence.contains("1280 × 960 px"), "{sentence}");

    let folder = Recording::open(&[recordings.join("granasat")]).unwrap();
    let names: Vec<String> = (0..folder.frames.len()).map(|frame| folder.frame_name(frame)).collect();
    assert_eq!(names[0], "andromeda_05seg.jpg");
    assert!(names.is_sorted());
    assert!(folder.common_size().is_ok());
}

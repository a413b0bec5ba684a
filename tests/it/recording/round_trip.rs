//! What is written is read back as it was.

use std::path::PathBuf;

use boresight::camera::Camera;
use boresight::coordinates::Attitude;
use boresight::recording::{
    CameraInfo, FirstRow, FitsHeaders, Form, FrameEntry, ListedStar, Mount, Recording, Shutter, Site, StarList, manifest_text,
    star_list_text, write_fits_u8, write_fits_u16, write_manifest, write_png_u16,
};
use hifitime::{Duration, Epoch};

/// Counts that reach both ends of the range.
fn pixels(width: usize, height: usize) -> Vec<u16> {
    let mut pixels: Vec<u16> = (0..width * height).map(|at| (at * 7919 % 65536) as u16).collect();
    pixels[width * height - 1] = 65535;
    pixels
}

fn recording() -> Recording {
    let camera = CameraInfo {
        width_px: 24,
        height_px: 16,
        pixel_pitch_um: Some([5.5, 5.6]),
        focal_length_mm: Some(35.1),
        focal_length_px: Some(6_363.636_363_636_363),
        principal_point_px: Some([11.25, 1.0 / 3.0]),
        k1: Some(-3.8e-9),
        p1: Some(1e-300),
        p2: Some(0.0),
        gain_e_per_dn: Some(2.0),
        bias_dn: Some(100.0),
        read_noise_e: Some(0.0),
        saturation_dn: Some(65535.0),
        zero_point_e_per_s: Some(2.0e6),
        shutter: Some(Shutter::Rolling),
        line_time_us: Some(12.0),
        first_row: Some(FirstRow::Bottom),
        passband: Some("V \"Johnson\"\n".to_owned()),
    };
    let mut recording = Recording::new(camera);
    recording.mount = Some(Mount::Free);
    recording.site = Some(Site {
        latitude_deg: -52.2,
        longitude_deg: 4.4,
        height_m: 5.0,
        pressure_hpa: Some(1013.25),
        temperature_c: None,
        relative_humidity: Some(0.5),
    });
    let start = Epoch::from_gregorian_utc(2026, 12, 31, 23, 59, 59, 123_456_789);
    for number in 0..3_usize {
        let mut frame = FrameEntry {
            file: Some(PathBuf::from(format!("frames/{number:04}.{}", if number == 2 { "png" } else { "fits" }))),
            number,
            time_utc: Some(start + Duration::from_seconds(0.1 * number as f64)),
            exposure_s: Some(0.2),
            temperature_c: Some(21.4 - number as f64),
            velocity_km_s: Some([-12.1, 24.9, 10.7]),
            rate_deg_s: Some([0.0, 0.05, -1e-17]),
            camera_from_icrs: Some(Attitude::from_pointing(0.1 * number as f64, -0.3, 0.5)),
            attitude_sigma_arcsec: Some(2.0),
            boresight_radec_deg: Some([83.6, -5.4]),
            altitude_azimuth_deg: Some([40.0, -135.0]),
            ..FrameEntry::default()
        };
        frame.covariates.insert("heater current [A]".to_owned(), 0.25);
        frame.covariates.insert("wheel_speed_rpm".to_owned(), -1200.0);
        recording.frames.push(frame);
    }
    recording
}

/// A recording as read, less what only reading tells.
fn as_written(mut recording: Recording) -> Recording {
    recording.directory = PathBuf::new();
    recording.manifest = None;
    recording.star_file = None;
    let bare = |frame: FrameEntry| FrameEntry { size: None, place: None, ..frame };
    recording.frames = recording.frames.into_iter().map(bare).collect();
    recording
}

/// Counts of 8 bits come back as they were, with the top of their range.
#[test]
fn images_of_eight_bits() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("one.fits");
    let pixels: Vec<u8> = (0..=255).collect();
    write_fits_u8(&path, 32, 8, &pixels, &FitsHeaders::default()).unwrap();
    let frame = Recording::open(&[&path]).unwrap().load_frame(0).unwrap();
    assert_eq!((frame.width_px, frame.height_px, frame.saturation_dn), (32, 8, 255.0));
    assert!(frame.pixels_dn.iter().zip(&pixels).all(|(read, written)| *read == f32::from(*written)));
    assert_eq!(std::fs::metadata(&path).unwrap().len(), 2 * 2880);
    assert!(write_fits_u8(&path, 32, 9, &pixels, &FitsHeaders::default()).is_err());
}

#[test]
fn a_recording_with_images() {
    let folder = tempfile::tempdir().unwrap();
    let written = recording();
    let pixels = pixels(24, 16);
    for frame in &written.frames {
        let path = folder.path().join(frame.file.as_ref().unwrap());
        if frame.number == 2 {
            write_png_u16(&path, 24, 16, &pixels).unwrap();
        } else {
            write_fits_u16(&path, 24, 16, &pixels, &FitsHeaders::new(&written.camera, written.site.as_ref(), frame)).unwrap();
        }
    }
    write_manifest(folder.path(), &written).unwrap();
    let read = Recording::open(&[folder.path()]).unwrap();
    for frame in 0..3 {
        let loaded = read.load_frame(frame).unwrap();
        assert_eq!((loaded.width_px, loaded.height_px, loaded.saturation_dn), (24, 16, 65535.0));
        assert!(loaded.pixels_dn.iter().zip(&pixels).all(|(read, written)| *read == f32::from(*written)));
        assert!(!read.frames[frame].rows_flipped);
        let (one, other) = (read.frames[frame].camera_from_icrs.unwrap(), written.frames[frame].camera_from_icrs.unwrap());
        assert!(one.camera_from_icrs.angle_to(&other.camera_from_icrs) < 1e-15);
    }
    let camera =
        Camera { principal_point_px: [11.25, 1.0 / 3.0], k1: -3.8e-9, p1: 1e-300, ..Camera::pinhole(24, 16, 6_363.636_363_636_363) };
    assert_eq!(read.nominal_camera(), Some(camera));
    let mut read = as_written(read);
    let mut written = written;
    for frame in written.frames.iter_mut().chain(&mut read.frames) {
        frame.camera_from_icrs = None; // compared above, its sign is open
    }
    assert_eq!(read, written);

    // without the manifest the headers tell the same of times and camera
    std::fs::remove_file(folder.path().join("recording.toml")).unwrap();
    std::fs::remove_file(folder.path().join("frames/0002.png")).unwrap();
    let bare = Recording::open(&[folder.path().join("frames")]).unwrap();
    assert_eq!(bare.form, Form::FitsFolder);
    for (bare, written) in bare.frames.iter().zip(&written.frames) {
        assert_eq!((bare.time_utc, bare.exposure_s, bare.temperature_c), (written.time_utc, written.exposure_s, written.temperature_c));
    }
    assert_eq!((bare.camera.focal_length_mm, bare.camera.pixel_pitch_um), (Some(35.1), Some([5.5, 5.6])));
    assert_eq!(bare.camera.gain_e_per_dn, Some(2.0));
    let site = bare.site.unwrap();
    assert_eq!((site.latitude_deg, site.longitude_deg, site.height_m), (-52.2, 4.4, 5.0));
}

#[test]
fn a_star_list() {
    let folder = tempfile::tempdir().unwrap();
    let mut written = recording();
    written.form = Form::StarList;
    for frame in &mut written.frames {
        frame.file = None;
        frame.camera_from_icrs = None;
    }
    let star = |x_px: f64, hip: Option<u32>| ListedStar {
        x_px,
        y_px: 1.0 / 3.0,
        flux_e: Some(1e4),
        magnitude: None,
        covariance_px2: hip.map(|_| [0.25, 0.125, 1.0]),
        hip,
        radec_deg: hip.map(|_| [359.999_999_999, -89.0]),
    };
    written.stars = Some(StarList { frames: vec![vec![star(0.1, None), star(23.5, Some(32349))], Vec::new(), vec![star(7.0, None)]] });
    write_manifest(folder.path(), &written).unwrap();
    assert_eq!(as_written(Recording::open(&[folder.path()]).unwrap()), written);
}

/// Letter by letter: people read these files, and numbers in them have as few digits as bring them back.
#[test]
fn the_texts_that_are_written() {
    let mut written = recording();
    written.camera = CameraInfo { width_px: 24, height_px: 16, k1: Some(-3.8e-9), shutter: Some(Shutter::Global), ..CameraInfo::default() };
    written.frames.truncate(1);
    let frame = &mut written.frames[0];
    *frame = FrameEntry { file: frame.file.take(), rate_deg_s: Some([0.0, 1.0 / 3.0, -1e-17]), ..FrameEntry::default() };
    frame.covariates.insert("heater current [A]".to_owned(), 2.0e22);
    frame.covariates.insert("wheel_speed_rpm".to_owned(), -1200.0);
    let text = "format = \"star-recording/1\"\n\n[camera]\nwidth_px = 24\nheight_px = 16\nk1 = -3.8e-9\nshutter = \"global\"\n\n\
                [mount]\nkind = \"free\"\n\n[site]\nlatitude_deg = -52.2\nlongitude_deg = 4.4\nheight_m = 5.0\npressure_hpa = 1013.25\n\
                relative_humidity = 0.5\n\n[[frames]]\nfile = \"frames/0000.fits\"\nrate_deg_s = [0.0, 0.3333333333333333, -1e-17]\n\
                \"heater current [A]\" = 2e22\nwheel_speed_rpm = -1200.0\n";
    assert_eq!(manifest_text(&written), text);

    let bare = ListedStar { x_px: 0.1, y_px: 2.0, flux_e: None, magnitude: None, covariance_px2: None, hip: None, radec_deg: None };
    let full = ListedStar { magnitude: Some(1e-7), covariance_px2: Some([0.25, -0.125, 1.0]), radec_deg: Some([10.0, -60.5]), ..bare };
    let list = |frames: Vec<Vec<ListedStar>>| star_list_text(&StarList { frames });
    assert_eq!(list(vec![vec![bare.clone()], vec![]]), "frame,x_px,y_px\n0,0.1,2.0\n");
    assert_eq!(
        list(vec![vec![bare], vec![full]]),
        "frame,x_px,y_px,magnitude,sigma_x_px,sigma_y_px,cov_xy_px2,ra_deg,dec_deg\n\
         0,0.1,2.0,,,,,,\n1,0.1,2.0,1e-7,0.5,1.0,-0.125,10.0,-60.5\n"
    );
    assert_eq!(list(Vec::new()), "frame,x_px,y_px\n");
}

#[test]
fn what_could_not_be_read_is_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let mut bad = recording();
    bad.frames[1].exposure_s = Some(f64::NAN);
    let sentence = write_manifest(folder.path(), &bad).unwrap_err().to_string();
    assert!(sentence.contains("\"exposure_s\"") && sentence.contains("nan"), "{sentence}");
    let sentence = write_fits_u16(&folder.path().join("a.fits"), 24, 16, &[0; 3], &FitsHeaders::default()).unwrap_err().to_string();
    assert!(sentence.contains("3 pixels do not fill 24 × 16"), "{sentence}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn the_same_frame_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let written = recording();
    let bytes = ["a.fits", "b.fits"].map(|name| {
        let path = folder.path().join(name);
        write_fits_u16(&path, 24, 16, &pixels(24, 16), &FitsHeaders::new(&written.camera, None, &written.frames[0])).unwrap();
        std::fs::read(path).unwrap()
    });
    assert_eq!(bytes[0], bytes[1]);
    assert_eq!(bytes[0].len() % 2880, 0);
    assert!(bytes[0].starts_with(b"SIMPLE  =                    T "));
}

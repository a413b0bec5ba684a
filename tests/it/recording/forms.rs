//! The four forms, read.

use approx::assert_abs_diff_eq;
use boresight::recording::{FirstRow, Form, Mount, Recording, Shutter};
use hifitime::Epoch;
use image::{DynamicImage, GrayImage, ImageBuffer, ImageFormat, Luma, Rgb, RgbImage, Rgba, RgbaImage};

use super::made::{Folder, counts, encoded, fits, png};

/// The example of the format's description, key by key.
const EVERY_KEY: &str = r#"
pixel_pitch_um = [5.5, 5.5]
focal_length_mm = 35.0
focal_length_px = 6363.6
principal_point_px = [5.5, 4.25]
k1 = 1e-9
p1 = 2.0e-8
p2 = -3
gain_e_per_dn = 2.0
bias_dn = 100.0
read_noise_e = 5.0
saturation_dn = 4095
zero_point_e_per_s = 2.0e6
shutter = "global"
line_time_us = 12.0
first_row = "bottom"
passband = "V"

[mount]
kind = "fixed"

[site]
latitude_deg = 52.2
longitude_deg = 4.4
height_m = 5.0
pressure_hpa = 1013.0
temperature_c = 11
relative_humidity = 0.7

[[frames]]
file = "frames/0.fits"
time_utc = "2026-03-01T22:15:07.250Z"
exposure_s = 0.2
temperature_c = 21.4
velocity_km_s = [-12.1, 24.9, 10.7]
rate_deg_s = [0.0, 0.05, 0.0]
camera_from_icrs = [0.0, 0.0, 0.0, 1.0]
attitude_sigma_arcsec = 2.0
boresight_radec_deg = [83.6, -5.4]
altitude_azimuth_deg = [40.0, -135.0]
heater_current_a = 0.25

[[frames]]
file = "frames/1.png"
time_utc = 2026-03-01T22:15:07.250Z
"#;

#[test]
fn a_manifest_is_read_key_by_key() {
    let folder =
        Folder::with_manifest(EVERY_KEY, &[("frames/0.fits", &fits(&["BZERO   = 32768"], &counts())), ("frames/1.png", &png(12, 10))]);
    let recording = folder.open();
    assert_eq!(recording.form, Form::Manifest);
    assert_eq!(recording, Recording::open(&[folder.path("recording.toml")]).unwrap());
    let camera = recording.nominal_camera().unwrap();
    assert_eq!(camera.parameters(), [5.5, 4.25, 6363.6, 1e-9, 2e-8, -3.0]);
    assert!(recording.notes.is_empty());
    let info = &recording.camera;
    assert_eq!((info.shutter, info.first_row, info.line_time_us), (Some(Shutter::Global), Some(FirstRow::Bottom), Some(12.0)));
    assert_eq!((info.gain_e_per_dn, info.bias_dn, info.read_noise_e), (Some(2.0), Some(100.0), Some(5.0)));
    assert_eq!((info.zero_point_e_per_s, info.passband.as_deref()), (Some(2e6), Some("V")));
    assert_eq!(recording.mount, Some(Mount::Fixed));
    let site = recording.site.unwrap();
    assert_eq!((site.latitude_deg, site.longitude_deg, site.height_m), (52.2, 4.4, 5.0));
    assert_eq!((site.pressure_hpa, site.temperature_c, site.relative_humidity), (Some(1013.0), Some(11.0), Some(0.7)));

    let frame = &recording.frames[0];
    let time = Epoch::from_gregorian_utc(2026, 3, 1, 22, 15, 7, 250_000_000);
    assert_eq!((frame.time_utc, recording.frames[1].time_utc), (Some(time), Some(time)));
    assert_eq!((frame.exposure_s, frame.temperature_c, frame.attitude_sigma_arcsec), (Some(0.2), Some(21.4), Some(2.0)));
    assert_eq!((frame.velocity_km_s, frame.rate_deg_s), (Some([-12.1, 24.9, 10.7]), Some([0.0, 0.05, 0.0])));
    assert_eq!((frame.boresight_radec_deg, frame.altitude_azimuth_deg), (Some([83.6, -5.4]), Some([40.0, -135.0])));
    assert_eq!(<[f64; 4]>::from(frame.camera_from_icrs.unwrap()), [0.0, 0.0, 0.0, 1.0]);
    assert_eq!(frame.covariates.iter().collect::<Vec<_>>(), [(&"heater_current_a".to_owned(), &0.25)]);

    let loaded = recording.load_frame(0).unwrap();
    assert_eq!((loaded.width_px, loaded.height_px, loaded.saturation_dn), (12, 10, 4095.0));
    assert_eq!(loaded.at(3, 2), 32768.0 + 27.0);
    // a pixel of 8 bits is full at 255, whatever the camera says of its own counts
    assert_eq!(recording.load_frame(1).unwrap().saturation_dn, 255.0);
    assert_eq!(recording.input_files(), ["recording.toml", "frames/0.fits", "frames/1.png"].map(|name| folder.path(name)));
}

#[test]
fn focal_length_comes_from_millimetres_and_pitch() {
    let frame = "[[frames]]\nfile = \"a.png\"";
    let folder = Folder::with_manifest(&format!("focal_length_mm = 16\npixel_pitch_um = [4.5, 8.0]\n{frame}"), &[("a.png", &png(12, 10))]);
    let camera = folder.open().nominal_camera().unwrap();
    assert_abs_diff_eq!(camera.focal_length_px, 16_000.0 / 6.0, epsilon = 1e-9);
    assert_eq!(camera.principal_point_px, [5.5, 4.5]);
    let folder = Folder::with_manifest(&format!("focal_length_mm = 16\n{frame}"), &[("a.png", &png(12, 10))]);
    assert_eq!(folder.open().nominal_camera(), None);
    let text = format!("focal_length_mm = 16\npixel_pitch_um = [4, 4]\nfocal_length_px = 3000\n{frame}");
    let recording = Folder::with_manifest(&text, &[("a.png", &png(12, 10))]).open();
    assert_eq!(recording.nominal_camera().unwrap().focal_length_px, 3000.0);
    assert!(recording.notes[0].contains("focal_length_px is 3000") && recording.notes[0].contains("4000.0"), "{:?}", recording.notes);
}

#[test]
fn a_fits_file_of_astropy_is_read_with_its_headers_and_turned_over() {
    let fixture = include_bytes!("../../fixtures/astropy_u16.fits");
    let folder = Folder::with(&[("a.fits", fixture)]);
    let recording = folder.open();
    assert_eq!(recording.form, Form::FitsFolder);
    let frame = &recording.frames[0];
    // the header gives the start, the recording holds the middle
    assert_eq!(frame.time_utc, Some(Epoch::from_gregorian_utc(2026, 3, 1, 22, 15, 7, 250_000_000)));
    assert_eq!((frame.exposure_s, frame.temperature_c), (Some(0.2), Some(-10.25)));
    assert_eq!(recording.camera.focal_length_mm, Some(35.0));
    assert_eq!(recording.camera.pixel_pitch_um, Some([6.9, 6.9]));
    // GAIN without a unit is the camera's dial, not electrons
    assert_eq!((recording.camera.gain_e_per_dn, frame.covariates["gain_setting"]), (Some(0.37), 120.0));
    let site = recording.site.unwrap();
    assert_abs_diff_eq!(site.latitude_deg, 52.22, epsilon = 1e-12);
    assert_abs_diff_eq!(site.longitude_deg, 4.42, epsilon = 1e-12);
    assert!(frame.rows_flipped);
    assert!(recording.notes.iter().any(|note| note.contains("BOTTOM-UP") && note.contains("a.fits")), "{:?}", recording.notes);

    let loaded = recording.load_frame(0).unwrap();
    assert_eq!((loaded.width_px, loaded.height_px, loaded.saturation_dn), (24, 16, 65535.0));
    for y in 0..16 {
        for x in 0..24 {
            let expected = match (x, y) {
                (0, 0) => 0,
                (23, 15) => 65535,
                _ => 4096 * y + 7 * x + 1,
            };
            assert_eq!(loaded.at(x, y), expected as f32, "({x}, {y})");
        }
    }
}

#[test]
fn fits_kinds_of_number_and_their_range() {
    let floats: Vec<u8> = (0..120).flat_map(|value| (value as f32 * 0.5).to_be_bytes()).collect();
    let bytes: Vec<u8> = (0..120).collect();
    for (cards, data, third, top) in [
        (vec!["BITPIX  = 8"], bytes.clone(), 3.0, 255.0),
        (vec!["BITPIX  = 8", "BZERO   = -128"], bytes, -125.0, 127.0),
        (vec![], counts(), 3.0, 32767.0),
        (vec!["BSCALE  = 2.0", "BZERO   = 10.0"], counts(), 16.0, 65544.0),
        (vec!["BITPIX  = -32"], floats, 1.5, f32::INFINITY),
    ] {
        let loaded = Folder::with(&[("a.fts", &fits(&cards, &data))]).open().load_frame(0).unwrap();
        assert_eq!((loaded.at(3, 0), loaded.saturation_dn), (third, top), "{cards:?}");
    }
}

#[test]
fn fits_images_in_an_extension_and_in_three_colours_are_read() {
    let mut extension = fits(&["NAXIS   = 0"], &[]);
    let image = String::from_utf8(fits(&[], &counts())).unwrap().replacen(
        &format!("{:<80}", "SIMPLE  = T"),
        &format!("{:<80}", "XTENSION= 'IMAGE   '"),
        1,
    );
    extension.extend_from_slice(image.as_bytes());
    let recording = Folder::with(&[("a.fits", &extension)]);
    assert_eq!(recording.open().load_frame(0).unwrap().at(1, 1), 13.0);
    assert!(recording.open().notes.is_empty());
    // a second image is not lost without a word
    extension.extend_from_slice(image.as_bytes());
    let notes = Folder::with(&[("a.fits", &extension)]).open().notes;
    assert!(notes[0].contains("a.fits: the file holds more than one image"), "{notes:?}");

    let planes: Vec<u8> = [counts(), counts(), counts()].concat();
    let colour = fits(&["NAXIS   = 3", "NAXIS3  = 3", "CTYPE3  = 'RGB'"], &planes);
    assert_eq!(Folder::with(&[("a.fits", &colour)]).open().load_frame(0).unwrap().at(1, 1), 13.0);
}

#[test]
fn fits_frames_come_in_order_of_time() {
    let at = |second: u32| fits(&[&format!("DATE-OBS= '2026-03-01T22:15:{second:02}'")], &counts());
    let folder = Folder::with(&[("frame_10.fit", &at(10)), ("frame_2.fit", &at(2)), ("notes.txt", b"a note"), (".hidden.fits", b"")]);
    let recording = folder.open();
    assert_eq!([0, 1].map(|frame| recording.frame_name(frame)), ["frame_2.fit", "frame_10.fit"]);
    assert!(recording.frames.iter().all(|frame| frame.exposure_s.is_none()));
}

#[test]
fn headers_that_disagree_are_not_used_and_said() {
    let with = |focal: &str| fits(&[&format!("FOCALLEN= {focal}"), "XPIXSZ  = 5.0"], &counts());
    let recording = Folder::with(&[("a.fits", &with("35.0")), ("b.fits", &with("50.0"))]).open();
    assert_eq!((recording.camera.focal_length_mm, recording.camera.pixel_pitch_um), (None, Some([5.0, 5.0])));
    assert!(recording.notes.iter().any(|note| note.contains("b.fits") && note.contains("FOCALLEN")), "{:?}", recording.notes);
}

#[test]
fn bare_images_of_every_kind_are_read_as_counts() {
    let grey = GrayImage::from_fn(12, 10, |x, y| Luma([(20 * x + y) as u8]));
    let deep: ImageBuffer<Luma<u16>, Vec<u16>> = ImageBuffer::from_fn(12, 10, |x, y| Luma([(5000 * x + y) as u16]));
    let folder = Folder::with(&[
        ("8.png", &encoded(&DynamicImage::ImageLuma8(grey.clone()), ImageFormat::Png)),
        ("8.tif", &encoded(&DynamicImage::ImageLuma8(grey.clone()), ImageFormat::Tiff)),
        ("8.bmp", &encoded(&DynamicImage::ImageLuma8(grey), ImageFormat::Bmp)),
        ("16.png", &encoded(&DynamicImage::ImageLuma16(deep.clone()), ImageFormat::Png)),
        ("16.tiff", &encoded(&DynamicImage::ImageLuma16(deep), ImageFormat::Tiff)),
    ]);
    for (names, scale, top) in [(vec!["8.png", "8.tif", "8.bmp"], 20.0, 255.0), (vec!["16.png", "16.tiff"], 5000.0, 65535.0)] {
        for name in names {
            let recording = Recording::open(&[folder.path(name)]).unwrap();
            assert_eq!((recording.form, recording.nominal_camera()), (Form::Images, None));
            let loaded = recording.load_frame(0).unwrap();
            assert_eq!((loaded.width_px, loaded.height_px, loaded.saturation_dn), (12, 10, top), "{name}");
            for y in 0..10 {
                for x in 0..12 {
                    assert_eq!(loaded.at(x, y), scale * x as f32 + y as f32, "{name} ({x}, {y})");
                }
            }
        }
    }
}

#[test]
fn colours_become_luminance_and_alpha_is_ignored() {
    let red = RgbImage::from_pixel(12, 10, Rgb([200, 0, 0]));
    let grey = RgbaImage::from_fn(12, 10, |x, y| Rgba([77, 77, 77, (x * y) as u8]));
    let folder = Folder::with(&[
        ("red.png", &encoded(&DynamicImage::ImageRgb8(red), ImageFormat::Png)),
        ("veil.png", &encoded(&DynamicImage::ImageRgba8(grey), ImageFormat::Png)),
    ]);
    let recording = folder.open();
    assert_abs_diff_eq!(recording.load_frame(0).unwrap().at(4, 4), 200.0 * 0.2126, epsilon = 1e-4);
    assert!(recording.load_frame(1).unwrap().pixels_dn.iter().all(|&pixel| pixel == 77.0));
}

#[test]
fn a_tiff_file_of_two_pages_says_so() {
    let grey = DynamicImage::ImageLuma8(GrayImage::from_pixel(12, 10, Luma([7])));
    let mut bytes = encoded(&grey, ImageFormat::Tiff);
    let folder = Folder::with(&[("a.tif", &bytes)]);
    assert!(folder.open().notes.is_empty());
    // a copy of the first directory behind the end as the second
    let at = u32::from_le_bytes(bytes[4..8].try_into().unwrap()) as usize;
    let entries = usize::from(u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap()));
    let next = at + 2 + 12 * entries;
    let directory = bytes[at..next + 4].to_vec();
    let second = u32::try_from(bytes.len()).unwrap().to_le_bytes();
    bytes[next..next + 4].copy_from_slice(&second);
    bytes.extend_from_slice(&directory);
    folder.add("a.tif", &bytes);
    let recording = folder.open();
    assert!(recording.notes[0].contains("a.tif: the file holds more than one image"), "{:?}", recording.notes);
    assert_eq!(recording.load_frame(0).unwrap().at(0, 0), 7.0);
}

#[test]
fn a_star_list_stands_in_the_place_of_images() {
    let manifest = "[[frames]]\ntime_utc = \"2026-03-01T22:15:07Z\"\n[[frames]]\nexposure_s = 0.2\n";
    let stars = "frame,x_px,y_px,flux_e,sigma_x_px,sigma_y_px,cov_xy_px2,hip,ra_deg,dec_deg\n\
                 1, 3.25, -0.5, 1e4, 0.1, 0.2, 0.005, 32349, 101.287, -16.716\n\
                 0,0,0,,,,,,,\n\
                 1,11.5,9.5,200,0.3,0.3,,0,,\n";
    let folder = Folder::with_manifest("", &[("stars.csv", stars.as_bytes())]);
    folder.add("recording.toml", format!("format = \"star-recording/1\"\nstars = \"stars.csv\"\n[camera]\nwidth_px = 12\nheight_px = 10\nfocal_length_px = 50.0\n{manifest}").as_bytes());
    let recording = folder.open();
    assert_eq!(recording.form, Form::StarList);
    assert_eq!(recording.nominal_camera().unwrap().focal_length_px, 50.0);
    let list = &recording.stars.as_ref().unwrap().frames;
    assert_eq!((list[0].len(), list[1].len()), (1, 2));
    let star = &list[1][0];
    assert_eq!(
        (star.x_px, star.y_px, star.flux_e, star.hip, star.radec_deg),
        (3.25, -0.5, Some(1e4), Some(32349), Some([101.287, -16.716]))
    );
    let [xx, xy, yy] = star.covariance_px2.unwrap();
    assert_abs_diff_eq!(xx, 0.01, epsilon = 1e-15);
    assert_abs_diff_eq!(yy, 0.04, epsilon = 1e-15);
    assert_eq!(xy, 0.005);
    assert_eq!((list[1][1].hip, list[0][0].covariance_px2), (None, None));
    assert_eq!(recording.frame_name(1), "frame 1");
    assert!(recording.load_frame(0).unwrap_err().to_string().contains("has no pixels"));
    assert_eq!(recording.input_files(), ["recording.toml", "stars.csv"].map(|name| folder.path(name)));
}

//! Bad input: one sentence that names file, line, key and remedy; skipped and listed where that is asked for.

use boresight::recording::{OpenOptions, Recording};

use super::made::{Folder, counts, encoded, fault, fits, png};

/// Asserts that a sentence holds every one of these parts.
fn assert_says(sentence: &str, parts: &[&str]) {
    for part in parts {
        assert!(sentence.contains(part), "{part:?} is not in: {sentence}");
    }
}

/// A manifest of a 12 × 10 px camera with one good frame, and this text in the place of `@`.
fn with(text: &str) -> String {
    Folder::with_manifest(text, &[("a.png", &png(12, 10)), ("b.png", &png(12, 10))]).fault()
}

#[test]
fn manifest_keys_and_values() {
    let frame = "[[frames]]\nfile = \"a.png\"\n";
    for (text, parts) in [
        (
            format!("focal_lenght_mm = 35.0\n{frame}"),
            vec!["recording.toml, line 5", "\"focal_lenght_mm\"", "did you mean \"focal_length_mm\"?"],
        ),
        (format!("focal_length = 35.0\n{frame}"), vec!["line 5", "did you mean \"focal_length_mm\"?"]),
        (format!("latitude_deg = 35.0\n{frame}"), vec!["line 5", "it belongs in [site]"]),
        (format!("wheels = 4\n{frame}"), vec!["line 5", "unknown key \"wheels\" in [camera]", "known keys are width_px"]),
        (format!("focal_length_mm = \"35\"\n{frame}"), vec!["line 5", "must be a number greater than 0", "\"35\""]),
        (format!("focal_length_mm = -35\n{frame}"), vec!["line 5", "must be a number greater than 0", "-35"]),
        (format!("k1 = nan\n{frame}"), vec!["line 5", "\"k1\"", "finite number", "nan"]),
        (format!("gain_e_per_dn = 0\n{frame}"), vec!["line 5", "greater than 0"]),
        (format!("read_noise_e = -1\n{frame}"), vec!["line 5", "0 or more"]),
        (format!("pixel_pitch_um = 5.5\n{frame}"), vec!["line 5", "two numbers greater than 0"]),
        (format!("principal_point_px = [1, 2, 3]\n{frame}"), vec!["line 5", "two numbers"]),
        (format!("shutter = \"roling\"\n{frame}"), vec!["line 5", "\"global\" or \"rolling\"", "roling"]),
        (format!("width_px = 12\n{frame}"), vec!["line 5", "duplicate key"]),
        (format!("k1 = = 1\n{frame}"), vec!["line 5", "not valid TOML"]),
        (format!("[mount]\nkind = \"fix\"\n{frame}"), vec!["line 6", "\"free\" or \"fixed\""]),
        (format!("[site]\nlatitude_deg = 95.0\nlongitude_deg = 0\n{frame}"), vec!["line 6", "-90 to 90", "95.0"]),
        (format!("[site]\nlatitude_deg = 52\n{frame}"), vec!["line 5", "\"longitude_deg\" is missing"]),
        (format!("[site]\nlatitude_deg = 52\nlongitude_deg = 0\nrelative_humidity = 70\n{frame}"), vec!["line 8", "from 0 to 1"]),
        (format!("[telescope]\nmirror = 1\n{frame}"), vec!["line 5", "unknown key \"telescope\""]),
        (format!("{frame}exposure_s = -0.2\n"), vec!["line 7", "\"exposure_s\"", "greater than 0", "-0.2"]),
        (format!("{frame}exposre_s = 0.2\n"), vec!["line 7", "\"exposre_s\"", "did you mean \"exposure_s\"?"]),
        (format!("{frame}comment = \"clouds\"\n"), vec!["line 7", "unknown key \"comment\""]),
        (format!("{frame}heater_current_a = inf\n"), vec!["line 7", "unknown key \"heater_current_a\""]),
        (format!("{frame}time_utc = \"yesterday\"\n"), vec!["line 7", "\"time_utc\"", "yesterday", "2026-03-01T22:15:07.250Z"]),
        (format!("{frame}time_utc = 5\n"), vec!["line 7", "must be a time"]),
        (format!("{frame}camera_from_icrs = [0, 0, 0, 0]\n"), vec!["line 7", "quaternion of length 1", "[0, 0, 0, 0]"]),
        (format!("{frame}camera_from_icrs = [1, 0, 0]\n"), vec!["line 7", "four numbers"]),
        (format!("{frame}velocity_km_s = [1, 0, 300000]\n"), vec!["line 7", "below 1000 km/s"]),
        (format!("{frame}boresight_radec_deg = [10, 95]\n"), vec!["line 7", "-90 to 90"]),
        (format!("{frame}temperature_c = -300\n"), vec!["line 7", "-273.15"]),
        ("[[frames]]\nexposure_s = 1.0\n".to_owned(), vec!["line 5", "\"file\" is missing"]),
        ("[frames]\nfile = \"a.png\"\n".to_owned(), vec!["line 5", "[[frames]]", "double brackets"]),
        (String::new(), vec!["no frames found in", "recording.toml", "[[frames]]"]),
    ] {
        assert_says(&with(&text), &parts);
    }
}

#[test]
fn numbers_far_from_any_known_key_are_kept() {
    let text = "[[frames]]\nfile = \"a.png\"\nheater_current_a = 1\n\"wheel speed\" = 2.5\n";
    let recording = Folder::with_manifest(text, &[("a.png", &png(12, 10))]).open();
    let kept: Vec<_> = recording.frames[0].covariates.iter().map(|(name, value)| (name.as_str(), *value)).collect();
    assert_eq!(kept, [("heater_current_a", 1.0), ("wheel speed", 2.5)]);
}

#[test]
fn the_head_of_the_manifest() {
    for (text, parts) in [
        ("", vec!["line 1", "\"format\" is missing", "star-recording/1"]),
        ("format = \"star-recording/9\"\n", vec!["line 1", "star-recording/9", "\"star-recording/1\""]),
        ("format = \"star-recording/1\"\n", vec!["[camera] is missing"]),
        ("format = \"star-recording/1\"\n[camera]\nwidth_px = 12\n", vec!["line 2", "\"height_px\" is missing"]),
        ("format = \"star-recording/1\"\n[camera]\nwidth_px = 12.5\nheight_px = 10\n", vec!["line 3", "whole number", "12.5"]),
        ("format = \"star-recording/1\"\n[camera]\nwidth_px = 0\nheight_px = 10\n", vec!["line 3", "\"width_px\"", "from 1"]),
        ("format = \"star-recording/1\"\n[camera]\nwidth_px = 1\nheight_px = 1\n", vec!["line 2", "1 × 1 px", "at least 8"]),
        ("format = \"star-recording/1\"\n[camera]\nwidth_px = 1000000\nheight_px = 1000000\n", vec!["line 2", "at most"]),
        ("camera = 5\nformat = \"star-recording/1\"\n", vec!["line 1", "must be a table [camera]", "integer"]),
        ("\u{feff}format = 1\r\n", vec!["line 1", "text in quotes"]),
    ] {
        assert_says(&Folder::with(&[("recording.toml", text.as_bytes())]).fault(), &parts);
    }
    assert_says(&Folder::with(&[("recording.toml", b"format = \"\n\xFF\"")]).fault(), &["recording.toml, line 2", "UTF-8"]);
}

#[test]
fn frames_of_a_manifest() {
    let two = "[[frames]]\nfile = \"a.png\"\n\n[[frames]]\nfile = \"b.fits\"\n";
    let good = png(12, 10);
    let whole = fits(&[], &counts());
    let infinite: Vec<u8> = vec![f32::INFINITY.to_be_bytes(); 120].concat();
    for (second, parts) in [
        (None, vec!["b.fits: no such file", "key \"file\" in", "recording.toml, line 9"]),
        (Some(whole[..2900].to_vec()), vec!["b.fits", "ends early", "3120 bytes, 2900 are there", "recording.toml, line 9"]),
        (Some(whole[..1000].to_vec()), vec!["b.fits", "no END card", "line 9"]),
        (Some(fits(&["NAXIS1  = 10", "NAXIS2  = 12"], &counts())), vec!["b.fits", "is 10 × 12 px", "line 3", "12 × 10 px", "line 9"]),
        (Some(fits(&["BITPIX  = -32"], &infinite)), vec!["b.fits", "none of its pixels has a value", "line 9"]),
        (Some(b"these are not the stars you are looking for".to_vec()), vec!["b.fits", "is no image that can be read", "PNG", "line 9"]),
        (Some(Vec::new()), vec!["b.fits", "the file is empty"]),
        (Some(png(1, 1)), vec!["b.fits: is 1 × 1 px", "too small", "at least 8 × 8"]),
        (Some(fits(&["NAXIS1  = 0"], &[])), vec!["b.fits: is 0 × 10 px", "too small"]),
        (Some(fits(&["NAXIS1  = 9223372036854775807", "NAXIS2  = 9223372036854775807"], &[])), vec!["too large"]),
        (Some(fits(&["NAXIS   = 123456789"], &[])), vec!["FITS keyword NAXIS", "from 0 to 999"]),
        (Some(fits(&["NAXIS1  = -12"], &counts())), vec!["FITS keyword NAXIS1", "whole number"]),
        (Some(fits(&["NAXIS1  = 'wide'"], &counts())), vec!["FITS keyword NAXIS1", "wide"]),
        (Some(fits(&["BITPIX  = 12"], &counts())), vec!["FITS keyword BITPIX", "12"]),
        (Some(fits(&["NAXIS   = 3", "NAXIS3  = 7"], &counts())), vec!["7 planes", "--plane 1 … 7"]),
        (Some(fits(&["NAXIS   = 0"], &[])), vec!["holds no image"]),
        (Some(fits(&["ROWORDER= 'SIDEWAYS'"], &counts())), vec!["FITS keyword ROWORDER", "SIDEWAYS"]),
        (Some(good[..good.len() - 20].to_vec()), vec!["b.fits", "PNG file is damaged"]),
    ] {
        let folder = Folder::with_manifest(two, &[("a.png", &good)]);
        if let Some(bytes) = &second {
            folder.add("b.fits", bytes);
        }
        assert_says(&folder.fault(), &parts);
        // the same, skipped and listed
        let recording = folder.keep_going();
        let skipped = match recording.skipped.as_slice() {
            [] => recording.load_frame_or_skip(1).unwrap().unwrap_err(),
            [skipped] => {
                assert_eq!(recording.frames.len(), 1);
                skipped.clone()
            }
            more => panic!("{more:?}"),
        };
        assert_eq!((skipped.file.as_str(), skipped.number), ("b.fits", 1));
        assert_says(&skipped.reason, &parts);
        assert!(recording.load_frame_or_skip(0).unwrap().is_ok());
    }
}

#[test]
fn time_that_runs_backwards() {
    let frame = |file: &str, second: u32| format!("[[frames]]\nfile = \"{file}\"\ntime_utc = \"2026-03-01T22:15:{second:02}Z\"\n");
    let text = [frame("a.png", 7), frame("b.png", 7), frame("c.png", 6), frame("d.png", 8)].concat();
    let image = png(12, 10);
    let folder = Folder::with_manifest(&text, &["a.png", "b.png", "c.png", "d.png"].map(|name| (name, image.as_slice())));
    assert_says(&folder.fault(), &["c.png", "2026-03-01T22:15:06", "earlier than 2026-03-01T22:15:07", "key \"time_utc\"", "line 13"]);
    let recording = folder.keep_going();
    assert_eq!(
        recording.frames.iter().map(|frame| (frame.name(), frame.number)).collect::<Vec<_>>(),
        [("a.png".to_owned(), 0), ("b.png".to_owned(), 1), ("d.png".to_owned(), 3)]
    );
    assert_eq!(recording.skipped[0].number, 2);
}

#[test]
fn bad_keys_of_one_frame_skip_only_that_frame() {
    let text = "[[frames]]\nfile = \"a.png\"\nexposure_s = 0\n[[frames]]\nfile = \"b.png\"\n";
    let recording = Folder::with_manifest(text, &[("a.png", &png(12, 10)), ("b.png", &png(12, 10))]).keep_going();
    assert_eq!(recording.frame_name(0), "b.png");
    assert_says(&recording.skipped[0].reason, &["recording.toml, line 7", "\"exposure_s\""]);
    // with nothing left there is no recording
    let folder = Folder::with_manifest("[[frames]]\nfile = \"a.png\"\n", &[]);
    let error = Recording::open_with(&[folder.root()], OpenOptions { keep_going: true, ..OpenOptions::default() }).unwrap_err().to_string();
    assert_says(&error, &["no frames found in", "every one of its 1 frames was skipped", "no such file"]);
}

#[test]
fn folders_and_paths() {
    let folder = Folder::with(&[("notes.txt", b"no stars tonight"), ("frames/a.png", &png(12, 10))]);
    assert_says(&folder.fault(), &["no frames found in", "recording.toml", "fits", "png"]);
    assert_says(&fault(&[folder.path("notes.txt")]), &["notes.txt", "is no image that can be read"]);
    assert_says(&fault(&[folder.path("absent")]), &["absent: no such file or folder"]);
    assert_says(&fault(&[]), &["no frames found", "give a recording or images"]);
    assert_says(&fault(&[folder.path("frames"), folder.path("frames/a.png")]), &["frames", "one recording, or images only"]);
    folder.add("stars.csv", b"frame,x_px,y_px\n");
    assert_says(&fault(&[folder.path("stars.csv")]), &["stars.csv", "through a recording.toml"]);
    folder.add("frames/b.fits", &fits(&[], &counts()));
    assert_says(&fault(&[folder.path("frames")]), &["FITS files (b.fits)", "other images (a.png)"]);
    assert_says(
        &Folder::with(&[("a.png", &png(12, 10)), ("b.png", &png(10, 12))]).fault(),
        &["b.png: is 10 × 12 px", "a.png is 12 × 10 px"],
    );
    assert_says(&Folder::with(&[("a.png", &png(1, 1))]).fault(), &["a.png: is 1 × 1 px", "too small"]);
}

#[test]
fn fits_headers_of_a_folder() {
    for (cards, parts) in [
        (vec!["DATE-OBS= 'last night'"], vec!["a.fits", "FITS keyword DATE-OBS", "last night"]),
        (vec!["DATE-OBS= '2026-03-01T22:15:07'", "TIMESYS = 'MARS'"], vec!["FITS keyword TIMESYS", "MARS"]),
        (vec!["EXPTIME = -1.0"], vec!["FITS keyword EXPTIME", "negative"]),
        (vec!["EXPTIME = 'long'"], vec!["FITS keyword EXPTIME", "no number"]),
        (vec!["SITELAT = '+95 00 00'"], vec!["FITS keyword SITELAT", "-90° to 90°"]),
        (vec!["SITELONG= 'west'"], vec!["FITS keyword SITELONG"]),
        (vec!["ZIMAGE  = T"], vec!["FITS keyword ZBITPIX", "is missing"]),
    ] {
        assert_says(&Folder::with(&[("a.fits", &fits(&cards, &counts()))]).fault(), &parts);
    }
    let recording = Folder::with(&[("a.fits", &fits(&["DATE-OBS= '2026-03-01'"], &counts()))]).open();
    assert_eq!(recording.frames[0].time_utc, None);
    assert_says(&recording.notes[0], &["a.fits", "DATE-OBS", "no time of day"]);
}

#[test]
fn images_that_were_cut_off() {
    let colour = image::DynamicImage::ImageRgb8(image::RgbImage::from_fn(64, 48, |x, y| image::Rgb([x as u8, y as u8, (x * y) as u8])));
    let grey = image::DynamicImage::ImageLuma16(image::ImageBuffer::from_fn(64, 48, |x, y| image::Luma([(900 * x + y) as u16])));
    for (name, bytes) in [
        ("a.jpg", encoded(&colour, image::ImageFormat::Jpeg)),
        ("a.png", encoded(&colour, image::ImageFormat::Png)),
        ("a.bmp", encoded(&colour, image::ImageFormat::Bmp)),
        ("a.tiff", encoded(&grey, image::ImageFormat::Tiff)),
        ("a.fits", fits(&["NAXIS1  = 64", "NAXIS2  = 45"], &vec![1; 64 * 45 * 2])),
    ] {
        Folder::with(&[(name, &bytes)]).open().load_frame(0).unwrap();
        for share in [0.3, 0.6, 0.9] {
            let kept = (bytes.len() as f64 * share) as usize;
            let sentence = Folder::with(&[(name, &bytes[..kept])]).fault();
            assert!(sentence.contains(name), "{name} cut to {kept} of {} bytes: {sentence}", bytes.len());
        }
    }
}

#[test]
fn star_lists() {
    let manifest = |stars: &str| {
        format!("format = \"star-recording/1\"\nstars = \"{stars}\"\n[camera]\nwidth_px = 12\nheight_px = 10\n[[frames]]\n[[frames]]\n")
    };
    for (stars, parts) in [
        ("frame,x_px\n0,1\n", vec!["stars.csv, line 1", "column \"y_px\" is missing"]),
        ("frame,x_px,y_px,flux\n0,1,2,3\n", vec!["stars.csv, line 1", "unknown column \"flux\"", "did you mean \"flux_e\"?"]),
        ("frame,x_px,y_px,x_px\n0,1,2,3\n", vec!["line 1", "\"x_px\" is there twice"]),
        ("frame,x_px,y_px,sigma_x_px\n0,1,2,3\n", vec!["line 1", "\"sigma_x_px\" is of no use without \"sigma_y_px\""]),
        ("frame,x_px,y_px\n0,1,2\n2,1,2\n", vec!["stars.csv, line 3", "no frame 2", "2 frames"]),
        ("frame,x_px,y_px\n0.5,1,2\n", vec!["line 2", "frame \"0.5\""]),
        ("frame,x_px,y_px\n0,1\n", vec!["line 2", "2 fields", "3 columns"]),
        ("frame,x_px,y_px\n0,12.6,2\n", vec!["line 2", "x_px is \"12.6\"", "from -0.5 to 11.5"]),
        ("frame,x_px,y_px\n0,1,nan\n", vec!["line 2", "y_px is \"nan\""]),
        ("frame,x_px,y_px\n0,1,\n", vec!["line 2", "y_px is missing"]),
        ("frame,x_px,y_px,sigma_x_px,sigma_y_px\n0,1,2,0.1,-0.1\n", vec!["line 2", "sigma_y_px", "greater than 0"]),
        ("frame,x_px,y_px,sigma_x_px,sigma_y_px,cov_xy_px2\n0,1,2,0.1,0.1,0.01\n", vec!["line 2", "cov_xy_px2 is 0.01"]),
        ("frame,x_px,y_px,hip\n0,1,2,Sirius\n", vec!["line 2", "hip is \"Sirius\""]),
        ("frame,x_px,y_px,ra_deg,dec_deg\n0,1,2,10,\n", vec!["line 2", "only one of ra_deg and dec_deg"]),
    ] {
        let folder = Folder::with(&[("recording.toml", manifest("stars.csv").as_bytes()), ("stars.csv", stars.as_bytes())]);
        let sentence = Recording::open(&[folder.root()]).expect_err(stars).to_string();
        assert_says(&sentence, &parts);
    }
    let folder = Folder::with(&[("recording.toml", manifest("stars.csv").as_bytes())]);
    assert_says(&folder.fault(), &["stars.csv", "no such star list", "key \"stars\"", "line 2"]);
    folder.add("recording.toml", manifest("stars.parquet").as_bytes());
    assert_says(&folder.fault(), &["stars.parquet", "not supported yet; convert to CSV", "line 2"]);
    folder.add("stars.csv", b"frame,x_px,y_px\n0,1,2\n1,99,2\n");
    folder.add("recording.toml", manifest("stars.csv").as_bytes());
    let recording = folder.keep_going();
    assert_eq!((recording.frames.len(), recording.stars.unwrap().frames.len()), (1, 1));
    assert_eq!((recording.skipped[0].file.as_str(), recording.skipped[0].number), ("frame 1", 1));
    assert_says(&recording.skipped[0].reason, &["stars.csv, line 3", "x_px"]);
    folder.add("recording.toml", format!("{}file = \"a.png\"\n", manifest("stars.csv")).as_bytes());
    folder.add("stars.csv", b"frame,x_px,y_px\n0,1,2\n");
    assert_says(&folder.fault(), &["recording.toml, line 8", "\"file\" and a star list", "exclude each other"]);
}

//! Kinds of files beyond the plain ones: packed FITS, cubes, pixels without a value, TIFF of every number, PGM, EXIF, and damaged palettes.

use std::io::Write;
use std::path::{Path, PathBuf};

use boresight::frame::Frame;
use boresight::pipeline::{MeasureOptions, measure};
use boresight::recording::{GivenCircumstances, OpenOptions, Plane, Recording, Site, ToldError};

use super::made::{Folder, counts, fault, fits, png};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/fits_tiles").join(name)
}

/// What astropy reads in a packed image, row by row.
fn by_astropy(name: &str) -> Vec<f32> {
    let bytes = std::fs::read(fixture(&format!("{name}.f32"))).unwrap();
    bytes.chunks_exact(4).map(|four| f32::from_le_bytes(four.try_into().unwrap())).collect()
}

#[test]
fn packed_fits_images_are_read_as_astropy_reads_them() {
    for (name, undefined) in [
        ("rice_1", 0),
        ("gzip_1", 0),
        ("gzip_2", 0),
        ("hcompress_1", 0),
        ("plio_1", 0),
        ("rice_u16", 0),
        ("rice_i32", 0),
        ("float_none", 0),
        ("float_dither_1", 3),
        ("float_dither_2", 0),
        ("float_lossless", 3),
        ("float_hcompress", 0),
        ("blank", 1),
    ] {
        let recording = Recording::open(&[fixture(&format!("{name}.fits.fz"))]).unwrap();
        assert_eq!(recording.frames[0].exposure_s, Some(0.5), "{name}: the header is read");
        let masked = recording.load_masked(0).unwrap();
        let expected = by_astropy(name);
        assert_eq!((masked.frame.width_px, masked.frame.height_px, masked.count_undefined()), (24, 20, undefined), "{name}");
        let mask = masked.undefined.unwrap_or_else(|| vec![false; expected.len()]);
        for (index, (found, expected)) in masked.frame.pixels_dn.iter().zip(&expected).enumerate() {
            if mask[index] {
                assert!(expected.is_nan() || name == "blank", "{name}, pixel {index}");
            } else {
                assert!((found - expected).abs() <= 1e-6 * expected.abs(), "{name}, pixel {index}: {found} for {expected}");
            }
        }
    }
}

#[test]
fn packed_fits_images_that_are_damaged_are_refused() {
    let whole = std::fs::read(fixture("gzip_1.fits.fz")).unwrap();
    let text = |bytes: &[u8], from: &str, to: &str| {
        let at = bytes.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
        let mut changed = bytes.to_vec();
        changed[at..at + from.len()].copy_from_slice(format!("{to:<width$}", width = from.len()).as_bytes());
        changed
    };
    let rice = std::fs::read(fixture("rice_1.fits.fz")).unwrap();
    let ending = |bytes: &[u8], keyword: &str, value: &str| {
        let at = bytes.chunks_exact(80).position(|card| card.starts_with(format!("{keyword:<8}=").as_bytes())).unwrap();
        let mut changed = bytes.to_vec();
        changed[80 * at..80 * at + 80].copy_from_slice(format!("{:<80}", format!("{keyword:<8}= {value}")).as_bytes());
        changed
    };
    for (bytes, parts) in [
        (whole[..whole.len() - 2880].to_vec(), vec!["ends early"]),
        (text(&whole, "'GZIP_1", "'LZMA_9"), vec!["ZCMPTYPE", "LZMA_9", "funpack"]),
        (ending(&rice, "ZVAL1", "0"), vec!["FITS keyword ZVAL1", "0 is not a whole number from 1"]),
        (ending(&rice, "ZVAL2", "3"), vec!["FITS keyword ZVAL2", "none of 1, 2, 4"]),
        (ending(&rice, "NAXIS2", "2"), vec!["FITS keyword NAXIS2", "2 rows cannot be the 9 tiles"]),
        (ending(&rice, "ZNAXIS1", "2000000000000"), vec!["FITS keyword ZNAXIS1"]),
        (ending(&rice, "ZTILE1", "-5"), vec!["FITS keyword ZTILE1", "-5"]),
        (ending(&rice, "ZBITPIX", "24"), vec!["FITS keyword ZBITPIX", "24"]),
    ] {
        let sentence = Folder::with(&[("a.fits.fz", &bytes)]).fault();
        for part in parts {
            assert!(sentence.contains(part), "{part:?} is not in: {sentence}");
        }
    }
    // a tile that unpacks to other than its pixels would leave others at zero
    let heap = whole.windows(3).position(|window| window == [0x1f, 0x8b, 8]).unwrap();
    let mut torn = whole;
    torn[heap + 12] ^= 0x55;
    let sentence = Folder::with(&[("a.fits.fz", &torn)]).fault();
    assert!(sentence.contains("its tile") && sentence.contains("copy it again"), "{sentence}");
}

fn gzipped(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

#[test]
fn gzipped_fits_images_are_read_in_a_folder_too() {
    let packed = gzipped(&fits(&["EXPTIME = 2.0"], &counts()));
    let folder = Folder::with(&[("a.fits.gz", &packed), ("notes.gz", &gzipped(b"notes"))]);
    let recording = folder.open();
    assert_eq!((recording.frames.len(), recording.frames[0].exposure_s), (1, Some(2.0)));
    assert_eq!(recording.load_frame(0).unwrap().at(1, 1), 13.0);
    for (name, bytes, part) in [
        ("b.fits.gz", packed[..packed.len() - 30].to_vec(), "gzip file is damaged"),
        ("c.fits.gz", gzipped(&fits(&[], &counts())[..2900]), "ends early"),
        ("d.fits.gz", gzipped(&vec![0; (1 << 30) + 4096]), "unpacks to more than 1024 MiB"),
    ] {
        let sentence = Folder::with(&[(name, &bytes)]).fault();
        assert!(sentence.contains(part), "{sentence}");
    }
}

#[test]
fn a_cube_is_not_taken_for_colours_unless_somebody_says_so() {
    let plane = |add: i16| (0..120_i16).flat_map(|count| (count + add).to_be_bytes()).collect::<Vec<u8>>();
    let data = [plane(0), plane(1000), plane(2000)].concat();
    let folder = Folder::with(&[("a.fits", &fits(&["NAXIS   = 3", "NAXIS3  = 3"], &data))]);
    let sentence = folder.fault();
    for part in ["a.fits", "3 exposures or colours", "--plane 1 … 3", "--plane colours"] {
        assert!(sentence.contains(part), "{sentence}");
    }
    let read = |plane| Recording::open_with(&[folder.root()], OpenOptions { plane: Some(plane), ..OpenOptions::default() });
    for index in 0..3 {
        assert_eq!(read(Plane::Index(index)).unwrap().load_frame(0).unwrap().at(1, 1), 13.0 + 1000.0 * index as f32);
    }
    let grey = read(Plane::Colours).unwrap().load_frame(0).unwrap().at(1, 1);
    assert!((grey - (13.0 + 0.7152 * 1000.0 + 0.0722 * 2000.0)).abs() < 1e-3, "{grey}");
    assert!(read(Plane::Index(3)).unwrap_err().to_string().contains("no plane 4: the file holds 3"));
    let single = Folder::with(&[("a.png", &png(12, 10))]);
    let other = Recording::open_with(&[single.root()], OpenOptions { plane: Some(Plane::Index(1)), ..OpenOptions::default() });
    assert!(other.unwrap_err().to_string().contains("no plane 2: the file holds 1"));
}

/// A frame of noise with a few stars, as 32-bit floating point.
fn night(holes: &[usize]) -> Vec<u8> {
    let (width, height) = (96, 80);
    let star = |x: usize, y: usize, at: [f64; 2]| 4000.0 * (-((x as f64 - at[0]).powi(2) + (y as f64 - at[1]).powi(2)) / 3.0).exp();
    let mut state = 1_u64;
    let pixels = (0..width * height).map(|index| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let noise = (state >> 40) as f64 / 2_f64.powi(24) * 20.0;
        let (x, y) = (index % width, index / width);
        let value = 100.0 + noise + star(x, y, [20.3, 30.6]) + star(x, y, [60.1, 50.2]) + star(x, y, [75.7, 15.4]);
        if holes.contains(&index) { f32::NAN } else { value as f32 }
    });
    let data: Vec<u8> = pixels.flat_map(f32::to_be_bytes).collect();
    fits(&["BITPIX  = -32", "NAXIS1  = 96", "NAXIS2  = 80"], &data)
}

#[test]
fn pixels_without_a_value_take_no_part_and_are_counted() {
    // a third of the frame, and the middle of one star
    let holes: Vec<usize> = (0..96 * 26).chain([50 * 96 + 60]).collect();
    let folders = [night(&[]), night(&holes)].map(|bytes| Folder::with(&[("a.fits", &bytes)]));
    let [whole, holed] = folders.each_ref().map(Folder::open);
    for windowed in [false, true] {
        let centroid = if windowed { boresight::pipeline::Centroid::Windowed } else { boresight::pipeline::Centroid::Gaussian };
        let options = MeasureOptions { centroid, ..MeasureOptions::default() };
        let [all, fewer] = [&whole, &holed].map(|recording| measure(recording.clone(), &options, || ()).unwrap());
        assert!(all.recording.notes.iter().all(|note| !note.contains("no value")));
        let said = format!("{} pixels of a.fits have no value (NaN, infinite or BLANK) and take no part", holes.len());
        assert!(fewer.recording.notes.contains(&said), "{:?}", fewer.recording.notes);
        let places = |measured: &boresight::pipeline::Measured| {
            measured.frames[0].detections.stars.iter().map(|star| [star.x_px, star.y_px]).collect::<Vec<_>>()
        };
        let near = |places: &[[f64; 2]], at: [f64; 2]| places.iter().any(|place| (place[0] - at[0]).hypot(place[1] - at[1]) < 0.1);
        assert!([[20.3, 30.6], [60.1, 50.2], [75.7, 15.4]].iter().all(|at| near(&places(&all), *at)), "{:?}", places(&all));
        assert!(near(&places(&fewer), [20.3, 30.6]), "{:?}", places(&fewer));
        assert!(places(&fewer).iter().all(|place| place[1] > 25.0), "nothing is found where nothing is: {:?}", places(&fewer));
        let [before, after] = [&all, &fewer].map(|measured| measured.frames[0].detections.noise_dn);
        assert!((after / before - 1.0).abs() < 0.2, "the noise is that of the sky: {before} and {after}");
    }
}

/// A TIFF file of one strip, little-endian, or BigTIFF; `format` is that of tag SampleFormat.
fn tiff(big: bool, bits: u16, format: u16, samples: u16, data: &[u8]) -> Vec<u8> {
    let entries: [(u16, u16, u64); 9] = [
        (256, 3, 12),
        (257, 3, 10),
        (258, 3, u64::from(bits)),
        (259, 3, 1),
        (262, 3, if samples == 3 { 2 } else { 1 }),
        (273, 4, if big { 16 } else { 8 }),
        (277, 3, u64::from(samples)),
        (279, 4, data.len() as u64),
        (339, 3, u64::from(format)),
    ];
    let mut bytes = if big { b"II\x2B\0\x08\0\0\0".to_vec() } else { b"II\x2A\0".to_vec() };
    let head = if big { 16 } else { 8 };
    let at = (head + data.len()).next_multiple_of(2);
    if big {
        bytes.extend_from_slice(&(at as u64).to_le_bytes());
    } else {
        bytes.extend_from_slice(&(at as u32).to_le_bytes());
    }
    bytes.extend_from_slice(data);
    bytes.resize(at, 0);
    if big {
        bytes.extend_from_slice(&(entries.len() as u64).to_le_bytes());
    } else {
        bytes.extend_from_slice(&(entries.len() as u16).to_le_bytes());
    }
    for (tag, kind, value) in entries {
        bytes.extend_from_slice(&tag.to_le_bytes());
        bytes.extend_from_slice(&kind.to_le_bytes());
        if big {
            bytes.extend_from_slice(&1_u64.to_le_bytes());
            bytes.extend_from_slice(&value.to_le_bytes());
        } else {
            bytes.extend_from_slice(&1_u32.to_le_bytes());
            bytes.extend_from_slice(&(value as u32).to_le_bytes());
        }
    }
    bytes.extend_from_slice(&[0; 8][..if big { 8 } else { 4 }]);
    bytes
}

#[test]
fn tiff_of_every_number_is_read() {
    let of = |write: &dyn Fn(i32) -> Vec<u8>| (0..120).flat_map(write).collect::<Vec<u8>>();
    for (bits, format, data, third, top) in [
        (8, 1, of(&|v| vec![v as u8]), 3.0, 255.0),
        (16, 1, of(&|v| (v as u16 * 500).to_le_bytes().to_vec()), 1500.0, 65535.0),
        (32, 1, of(&|v| (v as u32 * 70_000).to_le_bytes().to_vec()), 210_000.0, u32::MAX as f32),
        (16, 2, of(&|v| (v as i16 - 50).to_le_bytes().to_vec()), -47.0, 32767.0),
        (32, 2, of(&|v| (v - 50).to_le_bytes().to_vec()), -47.0, i32::MAX as f32),
        (32, 3, of(&|v| (v as f32 * 0.25).to_le_bytes().to_vec()), 0.75, f32::INFINITY),
        (64, 3, of(&|v| (f64::from(v) * 0.25).to_le_bytes().to_vec()), 0.75, f32::INFINITY),
        (4, 1, (0..60).map(|_| 0x5A).collect(), 10.0, 15.0),
    ] {
        for big in [false, true] {
            let loaded: Frame = Folder::with(&[("a.tif", &tiff(big, bits, format, 1, &data))]).open().load_frame(0).unwrap();
            assert_eq!((loaded.at(3, 0), loaded.saturation_dn), (third, top), "{bits} bits, format {format}, big {big}");
        }
    }
    let holed = of(&|v| (if v == 7 { f32::NAN } else { v as f32 }).to_le_bytes().to_vec());
    let masked = Folder::with(&[("a.tif", &tiff(false, 32, 3, 1, &holed))]).open().load_masked(0).unwrap();
    assert_eq!((masked.count_undefined(), masked.undefined.unwrap()[7]), (1, true));
}

#[test]
fn pages_of_a_tiff_file_are_said_and_chosen() {
    let mut bytes = tiff(false, 8, 1, 1, &(0..120).collect::<Vec<u8>>());
    let first = u32::from_le_bytes(bytes[4..8].try_into().unwrap()) as usize;
    let directory = bytes[first..].to_vec();
    let second_data = bytes.len() as u32;
    bytes.extend((0..120_u8).map(|value| value + 100));
    let second = bytes.len() as u32;
    let next = first + directory.len() - 4;
    bytes[next..next + 4].copy_from_slice(&second.to_le_bytes());
    let mut other = directory;
    other[2 + 5 * 12 + 8..2 + 5 * 12 + 12].copy_from_slice(&second_data.to_le_bytes());
    bytes.extend_from_slice(&other);
    let folder = Folder::with(&[("a.tif", &bytes)]);
    let notes = folder.open().notes;
    assert!(notes[0].contains("a.tif: the file holds more than one image") && notes[0].contains("--plane N"), "{notes:?}");
    let page = |index| Recording::open_with(&[folder.root()], OpenOptions { plane: Some(Plane::Index(index)), ..OpenOptions::default() });
    let second = page(1).unwrap();
    assert!(second.notes.is_empty(), "who chose a page knows: {:?}", second.notes);
    assert_eq!((page(0).unwrap().load_frame(0).unwrap().at(3, 0), second.load_frame(0).unwrap().at(3, 0)), (3.0, 103.0));
    assert!(page(2).unwrap_err().to_string().contains("no plane 3: the file holds 2"));
}

#[test]
fn pgm_and_ppm_are_read_as_text_and_as_bytes() {
    let text = (0..120).map(|value| value.to_string()).collect::<Vec<_>>().join(" ");
    let bytes: Vec<u8> = (0..120).collect();
    let words: Vec<u8> = (0..120_u16).flat_map(|value| (300 * value).to_be_bytes()).collect();
    let colours: Vec<u8> = (0..120).flat_map(|value| [value, 0, 0]).collect();
    for (head, data, third, top) in [
        ("P2\n# a remark\n12 10\n119\n", text.into_bytes(), 3.0, 119.0),
        ("P5 12 10 255\n", bytes, 3.0, 255.0),
        ("P5\n12\n10\n65535\n", words, 900.0, 65535.0),
        ("P6\n12 10\n255\n", colours, 3.0 * 0.2126, 255.0),
    ] {
        let file = [head.as_bytes(), &data].concat();
        let folder = Folder::with(&[("a.pgm", &file)]);
        let loaded = folder.open().load_frame(0).unwrap();
        assert_eq!((loaded.at(3, 0), loaded.saturation_dn), (third, top), "{head}");
        let sentence = Folder::with(&[("a.pgm", &file[..file.len() - 40])]).fault();
        assert!(sentence.contains("a.pgm") && (sentence.contains("ends early") || sentence.contains("sample")), "{sentence}");
    }
    for (text, part) in [("P5 12 10 0\n", "largest count is 0"), ("P5 12\n", "tells no"), ("P5 12 10 70000\n", "largest count is 70000")] {
        let sentence = Folder::with(&[("a.pgm", text.as_bytes())]).fault();
        assert!(sentence.contains(part), "{sentence}");
    }
    let above = Folder::with(&[("a.pgm", &[&b"P5 12 10 100\n"[..], &[101; 120]].concat())]).fault();
    assert!(above.contains("sample 0 is 101, above the largest count 100"), "{above}");
}

/// An EXIF block, little-endian: orientation, and behind a directory of its own time, zone, exposure and focal length.
fn exif(orientation: u16, zone: Option<&str>) -> Vec<u8> {
    let mut data = Vec::new();
    let mut entries = Vec::new();
    let data_at = 8 + 2 + 2 * 12 + 4 + 2 + 5 * 12 + 4;
    let mut far = |bytes: &[u8]| {
        let at = data_at + data.len() as u32;
        data.extend_from_slice(bytes);
        at
    };
    entries.push((0x829A_u16, 5_u16, 1_u32, far(&[4_u32.to_le_bytes(), 2_u32.to_le_bytes()].concat())));
    entries.push((0x9003, 2, 20, far(b"2023:08:12 23:10:05\0")));
    entries.push((0x9004, 2, 20, far(b"2023:08:12 23:10:05\0")));
    let zone_bytes = format!("{}\0", zone.unwrap_or("  :  "));
    entries.push((0x9011, 2, 7, far(zone_bytes.as_bytes())));
    entries.push((0x920A, 5, 1, far(&[35_u32.to_le_bytes(), 1_u32.to_le_bytes()].concat())));
    let mut block = b"II\x2A\0\x08\0\0\0".to_vec();
    let mut directory = |entries: &[(u16, u16, u32, u32)]| {
        block.extend_from_slice(&(entries.len() as u16).to_le_bytes());
        for (tag, kind, count, value) in entries {
            block.extend([&tag.to_le_bytes()[..], &kind.to_le_bytes(), &count.to_le_bytes(), &value.to_le_bytes()].concat());
        }
        block.extend_from_slice(&[0; 4]);
    };
    directory(&[(0x0112, 3, 1, u32::from(orientation)), (0x8769, 4, 1, 8 + 2 + 2 * 12 + 4)]);
    directory(&entries);
    block.extend_from_slice(&data);
    block
}

/// A JPEG with an EXIF block behind its first mark.
fn jpeg(exif: &[u8]) -> Vec<u8> {
    let image = image::DynamicImage::ImageLuma8(image::GrayImage::from_fn(12, 10, |x, y| image::Luma([(x + 2 * y) as u8])));
    let plain = super::made::encoded(&image, image::ImageFormat::Jpeg);
    let segment = [&b"Exif\0\0"[..], exif].concat();
    let length = (segment.len() as u16 + 2).to_be_bytes();
    [&plain[..2], &[0xFF, 0xE1], &length, &segment, &plain[2..]].concat()
}

#[test]
fn exif_is_used_where_it_is_sure_and_said_where_it_is_not() {
    let folder = Folder::with(&[("a.jpg", &jpeg(&exif(6, Some("+02:00")))), ("b.jpg", &jpeg(&exif(1, Some("+02:00"))))]);
    let recording = folder.open();
    // the middle of the two seconds that begin at 23:10:05 of that zone
    let middle = hifitime::Epoch::from_gregorian_utc(2023, 8, 12, 21, 10, 6, 0);
    let frame = &recording.frames[0];
    assert_eq!((frame.time_utc, frame.zone_unknown, frame.exposure_s), (Some(middle), false, Some(2.0)));
    assert_eq!(recording.camera.focal_length_mm, Some(35.0));
    assert_eq!(recording.notes.len(), 1, "{:?}", recording.notes);
    for part in ["1 of 2 frames have an EXIF orientation", "a.jpg", "turned clockwise by 90°", "10 × 12 px", "as stored, 12 × 10 px"] {
        assert!(recording.notes[0].contains(part), "{part:?}: {:?}", recording.notes);
    }
    assert_eq!(recording.load_frame(0).unwrap().width_px, 12);

    let mut without_zone = Folder::with(&[("a.jpg", &jpeg(&exif(1, None)))]).open();
    assert!(without_zone.frames[0].zone_unknown && without_zone.frames[0].time_utc.is_some());
    assert!(
        without_zone.notes[0].contains("zone") && without_zone.notes[0].contains("a.jpg at 2023-08-12T23:10:06"),
        "{:?}",
        without_zone.notes
    );
    let site = Some(Site {
        latitude_deg: 52.0,
        longitude_deg: 4.0,
        height_m: 0.0,
        pressure_hpa: None,
        temperature_c: None,
        relative_humidity: None,
    });
    without_zone.tell(&GivenCircumstances { site, ..GivenCircumstances::default() }).unwrap();
    assert_eq!(without_zone.frames[0].time_utc, None, "with a site the time of day counts");
    assert!(without_zone.notes.last().unwrap().contains("zone is unknown"));
}

#[test]
fn what_is_told_of_bare_images_is_theirs() {
    let images = ["a.png", "b.png", "c.png"].map(|name| (name, png(12, 10)));
    let folder = Folder::with(&images.each_ref().map(|(name, bytes)| (*name, bytes.as_slice())));
    let time = |text| GivenCircumstances::parse_time(text).unwrap().0;
    let tell = |told: &GivenCircumstances| {
        let mut recording = folder.open();
        recording.tell(told).map(|()| recording)
    };
    let first = time("2023-08-12T23:00:00Z");
    let told =
        GivenCircumstances { times_utc: vec![first], interval_s: Some(30.0), exposure_s: Some(2.0), ..GivenCircumstances::default() };
    let recording = tell(&told).unwrap();
    let seconds: Vec<f64> = recording.frames.iter().map(|frame| (frame.time_utc.unwrap() - first).to_seconds()).collect();
    assert_eq!((seconds, recording.frames[2].exposure_s), (vec![0.0, 30.0, 60.0], Some(2.0)));
    assert!(recording.notes.is_empty(), "{:?}", recording.notes);
    let one = tell(&GivenCircumstances { times_utc: vec![first], ..GivenCircumstances::default() }).unwrap();
    assert!(one.frames.iter().all(|frame| frame.time_utc == Some(first)) && one.notes[0].contains("one time is told for 3 frames"));
    assert_eq!(
        tell(&GivenCircumstances { times_utc: vec![first; 2], ..GivenCircumstances::default() }).unwrap_err(),
        ToldError::Count { times: 2, frames: 3 }
    );
    let backwards = vec![first, time("2023-08-12T22:00:00Z"), first];
    assert!(
        tell(&GivenCircumstances { times_utc: backwards, ..GivenCircumstances::default() })
            .unwrap_err()
            .to_string()
            .contains("of b.png is earlier")
    );
    let (midnight, is_date) = GivenCircumstances::parse_time("2023-08-12").unwrap();
    let site = Some(Site {
        latitude_deg: 52.0,
        longitude_deg: 4.0,
        height_m: 0.0,
        pressure_hpa: None,
        temperature_c: None,
        relative_humidity: None,
    });
    assert_eq!(
        tell(&GivenCircumstances { times_utc: vec![midnight], dates_only: is_date, site, ..GivenCircumstances::default() }).unwrap_err(),
        ToldError::NoClock
    );
    assert!(GivenCircumstances::parse_time("last night").unwrap_err().contains("is no time"));
}

/// CRC-32 of PNG (ISO 3309).
fn crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, byte| (0..8).fold(crc ^ u32::from(*byte), |crc, _| crc >> 1 ^ (0xEDB8_8320 * (crc & 1))))
}

/// A PNG of 8 × 8 px with a palette of so many bytes; its checksums are right.
fn palette_png(palette_bytes: usize) -> Vec<u8> {
    let chunk = |name: &[u8; 4], data: &[u8]| {
        let body = [&name[..], data].concat();
        [&(data.len() as u32).to_be_bytes()[..], &body, &crc(&body).to_be_bytes()].concat()
    };
    // 72 zeros in a stored block of zlib, with their Adler-32
    let packed = [&[0x78, 0x01, 0x01, 72, 0, 183, 255][..], &[0; 72], &[0, 72, 0, 1]].concat();
    let head = [&8_u32.to_be_bytes()[..], &8_u32.to_be_bytes(), &[8, 3, 0, 0, 0]].concat();
    [
        b"\x89PNG\r\n\x1A\n".to_vec(),
        chunk(b"IHDR", &head),
        chunk(b"PLTE", &vec![7; palette_bytes]),
        chunk(b"IDAT", &packed),
        chunk(b"IEND", &[]),
    ]
    .concat()
}

#[test]
fn a_damaged_palette_is_a_sentence_and_no_panic() {
    let kept = std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/png-palette.png")).unwrap();
    assert_eq!(kept, palette_png(4), "the file beside the report is the one that is made here");
    for length in [1, 2, 4, 5, 7] {
        let sentence = Folder::with(&[("a.png", &palette_png(length))]).fault();
        assert!(sentence.contains("a.png") && sentence.contains("the PNG file is damaged"), "{length}: {sentence}");
    }
    assert_eq!(Folder::with(&[("a.png", &palette_png(6))]).open().load_frame(0).unwrap().at(0, 0), 7.0);
}

#[test]
fn files_of_other_kinds_are_named_with_a_remedy() {
    for (bytes, parts) in [
        (&b"GIF89a"[..], ["a GIF image", "save it as PNG"]),
        (b"RIFF\0\0\0\0WEBPVP8 ", ["a WebP image", "save it as PNG"]),
        (b"LUCAM-RECORDER\0\0", ["a SER video", "single PNG"]),
        (b"\x93NUMPY\x01\0", ["a NumPy array", "astropy.io.fits"]),
        (b"FUJIFILMCCD-RAW 0201", ["raw file (RAF)", "dcraw"]),
        (b"PK\x03\x04", ["a ZIP archive", "unpack it"]),
    ] {
        let folder = Folder::with(&[("night.bin", bytes)]);
        let sentence = fault(&[folder.path("night.bin")]);
        assert!(parts.iter().all(|part| sentence.contains(part)) && sentence.contains("night.bin"), "{sentence}");
    }
}

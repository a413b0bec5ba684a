//! A zoo of image files, made from code: every format, depth, packing and header that the readers know, and broken ones.
#![allow(clippy::cast_possible_wrap, reason = "counts below 120 in numbers of every kind")]

use std::io::Write;

/// A file: its name and its bytes.
pub(crate) type File = (String, Vec<u8>);

/// Packed FITS images as another program wrote them.
const PACKED: [(&str, &[u8]); 13] = [
    ("rice_1", include_bytes!("../tests/fixtures/fits_tiles/rice_1.fits.fz")),
    ("gzip_1", include_bytes!("../tests/fixtures/fits_tiles/gzip_1.fits.fz")),
    ("gzip_2", include_bytes!("../tests/fixtures/fits_tiles/gzip_2.fits.fz")),
    ("hcompress_1", include_bytes!("../tests/fixtures/fits_tiles/hcompress_1.fits.fz")),
    ("plio_1", include_bytes!("../tests/fixtures/fits_tiles/plio_1.fits.fz")),
    ("rice_u16", include_bytes!("../tests/fixtures/fits_tiles/rice_u16.fits.fz")),
    ("rice_i32", include_bytes!("../tests/fixtures/fits_tiles/rice_i32.fits.fz")),
    ("float_none", include_bytes!("../tests/fixtures/fits_tiles/float_none.fits.fz")),
    ("float_dither_1", include_bytes!("../tests/fixtures/fits_tiles/float_dither_1.fits.fz")),
    ("float_dither_2", include_bytes!("../tests/fixtures/fits_tiles/float_dither_2.fits.fz")),
    ("float_lossless", include_bytes!("../tests/fixtures/fits_tiles/float_lossless.fits.fz")),
    ("float_hcompress", include_bytes!("../tests/fixtures/fits_tiles/float_hcompress.fits.fz")),
    ("blank", include_bytes!("../tests/fixtures/fits_tiles/blank.fits.fz")),
];

const WIDTH: usize = 12;
const HEIGHT: usize = 10;
const PIXELS: usize = WIDTH * HEIGHT;

/// All of them, in order of name.
pub(crate) fn zoo() -> Vec<File> {
    let mut files = [fits(), packed(), png(), tiff(), others(), foreign()].concat();
    files.sort();
    files
}

/// A FITS file of cards (those of the same keyword replace the first ones) and data.
pub(crate) fn fits_file(cards: &[&str], data: &[u8]) -> Vec<u8> {
    let mut header: Vec<String> =
        ["SIMPLE  = T", "BITPIX  = 16", "NAXIS   = 2", "NAXIS1  = 12", "NAXIS2  = 10"].map(str::to_owned).to_vec();
    for card in cards {
        let keyword = &card[..card.len().min(8)];
        match header.iter_mut().find(|there| there.starts_with(keyword)) {
            Some(there) => (*card).clone_into(there),
            None => header.push((*card).to_owned()),
        }
    }
    if !cards.contains(&"NO END") {
        header.push("END".to_owned());
    }
    let mut bytes: Vec<u8> = header.iter().flat_map(|card| format!("{card:<80}").into_bytes()).collect();
    bytes.resize(bytes.len().next_multiple_of(2880), b' ');
    bytes.extend_from_slice(data);
    bytes.resize(bytes.len().next_multiple_of(2880), 0);
    bytes
}

fn of<const N: usize>(write: impl Fn(usize) -> [u8; N]) -> Vec<u8> {
    (0..PIXELS).flat_map(write).collect()
}

fn fits() -> Vec<File> {
    let words = of(|v| (v as i16).to_be_bytes());
    let floats = of(|v| (v as f32 * 0.5).to_be_bytes());
    let holes = of(|v| (if v % 17 == 3 { f32::NAN } else { v as f32 }).to_be_bytes());
    let three = words.repeat(3);
    let image = String::from_utf8(fits_file(&[], &[])).unwrap_or_default();
    let extension = image.replacen(&format!("{:<80}", "SIMPLE  = T"), &format!("{:<80}", "XTENSION= 'IMAGE   '"), 1);
    let extension = [extension.as_bytes(), &words, &vec![0; 2880 - words.len()]].concat();
    let table = fits_file(&["NAXIS   = 0"], &[]);
    let whole = fits_file(&[], &words);
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    gzip.write_all(&whole).expect("memory takes all");
    let gzip = gzip.finish().expect("memory takes all");
    let f = |name: &str, cards: &[&str], data: &[u8]| (format!("fits-{name}.fits"), fits_file(cards, data));
    vec![
        f("u8", &["BITPIX  = 8"], &of(|v| [v as u8])),
        f("i16", &[], &words),
        f("u16", &["BZERO   = 32768"], &words),
        f("i32", &["BITPIX  = 32"], &of(|v| (v as i32 * 70_000).to_be_bytes())),
        f("u32", &["BITPIX  = 32", "BZERO   = 2147483648"], &of(|v| (v as i32).to_be_bytes())),
        f("i64", &["BITPIX  = 64"], &of(|v| (v as i64).to_be_bytes())),
        f("f32", &["BITPIX  = -32"], &floats),
        f("f64", &["BITPIX  = -64"], &of(|v| (v as f64).to_be_bytes())),
        f("scaled", &["BSCALE  = 2.0", "BZERO   = 10.0"], &words),
        f("nan", &["BITPIX  = -32"], &holes),
        f("blank", &["BLANK   = 5"], &words),
        f("all-nan", &["BITPIX  = -32"], &of(|_| f32::NAN.to_be_bytes())),
        f("infinite", &["BITPIX  = -32"], &of(|v| (if v == 0 { f32::INFINITY } else { 1.0 }).to_be_bytes())),
        f("cube-3", &["NAXIS   = 3", "NAXIS3  = 3"], &three),
        f("cube-rgb", &["NAXIS   = 3", "NAXIS3  = 3", "CTYPE3  = 'RGB     '"], &three),
        f("cube-7", &["NAXIS   = 3", "NAXIS3  = 7"], &words.repeat(7)),
        f("axes-of-one", &["NAXIS   = 4", "NAXIS3  = 1", "NAXIS4  = 1"], &words),
        ("fits-extension.fits".to_owned(), [table.clone(), extension.clone()].concat()),
        ("fits-two-images.fits".to_owned(), [whole.clone(), extension].concat()),
        ("fits-no-image.fits".to_owned(), table),
        f("bottom-up", &["ROWORDER= 'BOTTOM-UP'"], &words),
        f("sideways", &["ROWORDER= 'SIDEWAYS'"], &words),
        f("headers", &["DATE-OBS= '2026-03-01T22:15:07'", "EXPTIME = 2.0", "SITELAT = '52 13 12'", "SITELONG= 4.4"], &words),
        f("date-of-no-day", &["DATE-OBS= '2026-02-31T22:15:07'"], &words),
        f("negative-exposure", &["EXPTIME = -2.0"], &words),
        f("no-end", &["NO END"], &[]),
        ("fits-cut.fits".to_owned(), whole[..2900].to_vec()),
        f("negative-side", &["NAXIS1  = -102"], &words),
        f("huge-side", &["NAXIS1  = 9223372036854775807"], &words),
        f("too-large", &["NAXIS1  = 60000", "NAXIS2  = 60000"], &words),
        f("too-small", &["NAXIS1  = 4", "NAXIS2  = 4"], &words),
        f("bits-12", &["BITPIX  = 12"], &words),
        f("bits-missing", &["BITPIX  ="], &words),
        f("groups", &["NAXIS   = 3", "NAXIS1  = 0", "NAXIS3  = 4", "GROUPS  = T"], &words),
        ("fits-gzip.fits.gz".to_owned(), gzip.clone()),
        ("fits-gzip-cut.fits.gz".to_owned(), gzip[..gzip.len() / 2].to_vec()),
    ]
}

fn packed() -> Vec<File> {
    let mut files: Vec<File> = PACKED.iter().map(|(name, bytes)| (format!("packed-{name}.fits.fz"), bytes.to_vec())).collect();
    let with = |name: &str, keyword: &str, value: &str| {
        let mut bytes = PACKED[0].1.to_vec();
        let at = bytes.chunks_exact(80).position(|card| card.starts_with(keyword.as_bytes())).unwrap_or(0);
        bytes[80 * at..80 * at + 80].copy_from_slice(format!("{:<80}", format!("{keyword:<8}= {value}")).as_bytes());
        (format!("packed-{name}.fits.fz"), bytes)
    };
    files.push(with("method-unknown", "ZCMPTYPE", "'LZMA_9  '"));
    files.push(with("block-of-none", "ZVAL1", "0"));
    files.push(with("rows-too-few", "NAXIS2", "2"));
    files.push(("packed-cut.fits.fz".to_owned(), PACKED[1].1[..6000].to_vec()));
    files
}

/// CRC-32 of PNG (ISO 3309).
pub(crate) fn crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, byte| (0..8).fold(crc ^ u32::from(*byte), |crc, _| crc >> 1 ^ (0xEDB8_8320 * (crc & 1))))
}

/// A PNG of that size whose pixels are zero; `palette_bytes` of a palette.
fn png_file(size: [u32; 2], bits: u8, colour: u8, row_bytes: usize, palette_bytes: usize) -> Vec<u8> {
    let chunk = |name: &[u8; 4], data: &[u8]| {
        let body = [&name[..], data].concat();
        [&(data.len() as u32).to_be_bytes()[..], &body, &crc(&body).to_be_bytes()].concat()
    };
    let mut packed = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    for row in 0..HEIGHT {
        packed.write_all(&[0]).expect("memory takes all");
        packed.write_all(&vec![row as u8; row_bytes]).expect("memory takes all");
    }
    let head = [&size[0].to_be_bytes()[..], &size[1].to_be_bytes(), &[bits, colour, 0, 0, 0]].concat();
    let palette = if palette_bytes > 0 { chunk(b"PLTE", &vec![9; palette_bytes]) } else { Vec::new() };
    let data = chunk(b"IDAT", &packed.finish().expect("memory takes all"));
    [b"\x89PNG\r\n\x1a\n".to_vec(), chunk(b"IHDR", &head), palette, data, chunk(b"IEND", &[])].concat()
}

fn png() -> Vec<File> {
    let size = [WIDTH as u32, HEIGHT as u32];
    let f = |name: &str, bytes: Vec<u8>| (format!("png-{name}.png"), bytes);
    let grey = png_file(size, 8, 0, WIDTH, 0);
    let mut wrong_sum = grey.clone();
    if let Some(byte) = wrong_sum.get_mut(45) {
        *byte ^= 1;
    }
    vec![
        f("grey-1", png_file(size, 1, 0, 2, 0)),
        f("grey-2", png_file(size, 2, 0, 3, 0)),
        f("grey-4", png_file(size, 4, 0, 6, 0)),
        f("grey-16", png_file(size, 16, 0, 2 * WIDTH, 0)),
        f("grey-alpha-8", png_file(size, 8, 4, 2 * WIDTH, 0)),
        f("rgb-8", png_file(size, 8, 2, 3 * WIDTH, 0)),
        f("rgb-16", png_file(size, 16, 2, 6 * WIDTH, 0)),
        f("rgba-16", png_file(size, 16, 6, 8 * WIDTH, 0)),
        f("palette", png_file(size, 8, 3, WIDTH, 48)),
        f("palette-damaged", png_file(size, 8, 3, WIDTH, 4)),
        f("palette-missing", png_file(size, 8, 3, WIDTH, 0)),
        f("bits-3", png_file(size, 3, 0, 5, 0)),
        f("huge", png_file([60_000, 60_000], 8, 0, WIDTH, 0)),
        f("too-small", png_file([3, 3], 8, 0, 3, 0)),
        f("cut", grey[..grey.len() - 20].to_vec()),
        f("wrong-sum", wrong_sum),
        f("grey-8", grey),
    ]
}

/// A little-endian TIFF file of one strip: bits, sample format, samples a pixel, compression, photometric interpretation.
fn tiff_file([bits, format, samples, compression, photometric]: [u32; 5], data: &[u8], second: bool) -> Vec<u8> {
    let at = (8 + data.len()).next_multiple_of(2);
    let mut entries = vec![
        (256_u16, 3_u16, WIDTH as u32),
        (257, 3, HEIGHT as u32),
        (258, 3, bits),
        (259, 3, compression),
        (262, 3, photometric),
        (273, 4, 8),
        (277, 3, samples),
        (279, 4, data.len() as u32),
    ];
    if format > 0 {
        entries.push((339, 3, format));
    }
    let directory = |next: u32| {
        let mut bytes = (entries.len() as u16).to_le_bytes().to_vec();
        for (tag, kind, value) in &entries {
            bytes.extend([&tag.to_le_bytes()[..], &kind.to_le_bytes(), &1_u32.to_le_bytes(), &value.to_le_bytes()].concat());
        }
        bytes.extend(next.to_le_bytes());
        bytes
    };
    let mut bytes = [&b"II\x2A\0"[..], &(at as u32).to_le_bytes(), data].concat();
    bytes.resize(at, 0);
    let length = directory(0).len();
    bytes.extend(directory(if second { (at + length) as u32 } else { 0 }));
    if second {
        bytes.extend(directory(0));
    }
    bytes
}

fn tiff() -> Vec<File> {
    let f = |name: &str, shape: [u32; 5], data: Vec<u8>| (format!("tiff-{name}.tif"), tiff_file(shape, &data, false));
    let bytes: Vec<u8> = (0..PIXELS as u8).collect();
    let words = of(|v| (300 * v as u16).to_le_bytes());
    let whole = tiff_file([8, 1, 1, 1, 1], &bytes, false);
    let mut looped = whole.clone();
    let last = looped.len() - 4;
    looped[last..].copy_from_slice(&((8 + PIXELS) as u32).to_le_bytes());
    vec![
        f("u8", [8, 1, 1, 1, 1], bytes.clone()),
        f("u16", [16, 1, 1, 1, 1], words.clone()),
        f("u32", [32, 1, 1, 1, 1], of(|v| (v as u32).to_le_bytes())),
        f("i16", [16, 2, 1, 1, 1], words.clone()),
        f("f16", [16, 3, 1, 1, 1], of(|_| 0x3C00_u16.to_le_bytes())),
        f("f32", [32, 3, 1, 1, 1], of(|v| (v as f32).to_le_bytes())),
        f("f32-nan", [32, 3, 1, 1, 1], of(|v| (if v < 5 { f32::NAN } else { 1.0 }).to_le_bytes())),
        f("f64", [64, 3, 1, 1, 1], of(|v| (v as f64).to_le_bytes())),
        f("u4", [4, 1, 1, 1, 1], vec![0x5A; PIXELS / 2]),
        f("u12", [12, 1, 1, 1, 1], vec![0x5A; PIXELS * 3 / 2]),
        f("complex", [64, 6, 1, 1, 1], vec![0; PIXELS * 8]),
        f("white-is-zero", [8, 1, 1, 1, 0], bytes.clone()),
        f("palette", [8, 1, 1, 1, 3], bytes.clone()),
        f("mosaic", [16, 1, 1, 1, 32803], words),
        f("compression-unknown", [8, 1, 1, 34_925, 1], bytes.clone()),
        f("compression-jpeg2000", [8, 1, 1, 34_712, 1], bytes.clone()),
        f("strip-too-short", [8, 1, 1, 1, 1], vec![0; 20]),
        ("tiff-two-pages.tif".to_owned(), tiff_file([8, 1, 1, 1, 1], &bytes, true)),
        ("tiff-loop.tif".to_owned(), looped),
        ("tiff-cut.tif".to_owned(), whole[..60].to_vec()),
        ("tiff-directory-outside.tif".to_owned(), b"II\x2A\0\xFF\xFF\xFF\x7F".to_vec()),
    ]
}

fn encoded(image: &image::DynamicImage, format: image::ImageFormat) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).expect("an image of a common kind is encoded");
    bytes.into_inner()
}

fn others() -> Vec<File> {
    use image::{DynamicImage, ImageFormat};
    let grey = DynamicImage::ImageLuma8(image::GrayImage::from_fn(16, 12, |x, y| image::Luma([(x * y) as u8])));
    let colours = DynamicImage::ImageRgb8(image::RgbImage::from_fn(16, 12, |x, y| image::Rgb([x as u8, y as u8, (x * y) as u8])));
    let jpeg = encoded(&colours, ImageFormat::Jpeg);
    let bmp = encoded(&colours, ImageFormat::Bmp);
    let text = (0..PIXELS).map(|value| value.to_string()).collect::<Vec<_>>().join("\n");
    let words: Vec<u8> = of(|v| (300 * v as u16).to_be_bytes());
    let f = |name: &str, bytes: Vec<u8>| (name.to_owned(), bytes);
    vec![
        f("jpeg-grey.jpg", encoded(&grey, ImageFormat::Jpeg)),
        f("jpeg-cut.jpg", jpeg[..jpeg.len() * 2 / 3].to_vec()),
        f("jpeg-head-alone.jpg", jpeg[..20].to_vec()),
        f("jpeg-rgb.jpg", jpeg),
        f("bmp-cut.bmp", bmp[..60].to_vec()),
        f("bmp-rgb.bmp", bmp),
        f("bmp-grey.bmp", encoded(&grey, ImageFormat::Bmp)),
        f("tiff-rgb.tif", encoded(&colours, ImageFormat::Tiff)),
        f("pgm-text.pgm", [&b"P2 12 10 200\n"[..], text.as_bytes()].concat()),
        f("pgm-bytes.pgm", [&b"P5 12 10 255\n"[..], &[7; PIXELS]].concat()),
        f("pgm-words.pgm", [&b"P5 12 10 65535\n"[..], &words].concat()),
        f("pgm-colours.ppm", [&b"P6 12 10 255\n"[..], &[7; 3 * PIXELS]].concat()),
        f("pgm-cut.pgm", [&b"P5 12 10 255\n"[..], &[7; 50]].concat()),
        f("pgm-letters.pgm", b"P2 12 10 255\n1 2 three 4".repeat(20)),
        f("pgm-top-of-none.pgm", b"P5 12 10 0\n".to_vec()),
        f("pgm-huge.pgm", b"P5 99999999 99999999 255\n".to_vec()),
    ]
}

fn foreign() -> Vec<File> {
    let f = |name: &str, bytes: &[u8]| (format!("other-{name}"), bytes.to_vec());
    vec![
        f("empty.png", b""),
        f("notes.txt", b"no stars tonight"),
        f("page.gif", b"GIF89a\x01\0\x01\0"),
        f("page.webp", b"RIFF\x24\0\0\0WEBPVP8 "),
        f("film.avi", b"RIFF\x24\0\0\0AVI LIST"),
        f("film.ser", b"LUCAM-RECORDER\0\0\0\0"),
        f("film.mp4", b"\0\0\0\x18ftypisom"),
        f("array.npy", b"\x93NUMPY\x01\0v\0"),
        f("image.xisf", b"XISF0100\0\0\0\0"),
        f("raw.cr3", b"\0\0\0\x18ftypcrx "),
        f("raw.raf", b"FUJIFILMCCD-RAW 0201"),
        f("raw.orf", b"IIRO\x08\0\0\0"),
        f("raw.rw2", b"IIU\0\x18\0\0\0"),
        f("phone.heic", b"\0\0\0\x18ftypheic"),
        f("table.h5", b"\x89HDF\r\n\x1a\n"),
        f("frames.zip", b"PK\x03\x04\x14\0"),
        f("frames.bz2", b"BZh91AY&SY"),
        f("frames.xz", b"\xFD7zXZ\0\0\x04"),
        f("text.gz", &[0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 3, 3, 0, 0, 0, 0, 0, 0, 0, 0, 0]),
        f("stars.parquet", b"PAR1\x15\x04"),
        f("page.pdf", b"%PDF-1.7"),
        f("jpeg2000.jp2", b"\0\0\0\x0CjP  \r\n\x87\n"),
        f("bitmap.pbm", b"P4 12 10\n"),
        f("random.bin", &[0xA5; 64]),
    ]
}

/// What the readers make of a file, in a line: its size, the range and the pixels without a value, or the sentence.
pub(crate) fn line(folder: &std::path::Path, (name, bytes): &File) -> String {
    use boresight::recording::Recording;
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("a scratch file is written");
    let read = || {
        let recording = Recording::open(&[&path])?;
        let masked = recording.load_masked(0)?;
        let notes = if recording.notes.is_empty() { String::new() } else { format!("; {}", recording.notes.join("; ")) };
        let (frame, undefined) = (&masked.frame, masked.count_undefined());
        let sum: f64 = frame.pixels_dn.iter().map(|pixel| f64::from(*pixel)).sum();
        let without = if undefined > 0 { format!(", {undefined} without a value") } else { String::new() };
        Ok(format!("read: {} × {} px, full at {}, sum {sum}{without}{notes}", frame.width_px, frame.height_px, frame.saturation_dn))
    };
    let said: Result<String, boresight::recording::RecordingError> = read();
    let said = said.unwrap_or_else(|error| format!("refused: {error}"));
    let folder = format!("{}{}", folder.display(), std::path::MAIN_SEPARATOR);
    format!("{name}: {}", said.replace(&folder, ""))
}

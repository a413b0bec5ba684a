//! Images as bytes of files: PNG by the fast encoder, and NumPy arrays.

use image::DynamicImage;
use png::{BitDepth, ColorType, Compression, Encoder, Filter};

use super::error::DatasetError;
use super::samples::Sample;
use crate::guard::guarded;

/// A grey PNG; `rows` are bytes as PNG has them, 16 bits with the high byte first. Each row less the one above it, then the encoder's fastest way.
fn png(key: u64, [width_px, height_px]: [usize; 2], depth: BitDepth, rows: &[u8]) -> Result<Vec<u8>, DatasetError> {
    let wrong = |error: png::EncodingError| DatasetError::Encode { key, message: error.to_string() };
    let mut bytes = Vec::with_capacity(rows.len() / 2 + 1024);
    let mut encoder = Encoder::new(&mut bytes, width_px as u32, height_px as u32);
    encoder.set_color(ColorType::Grayscale);
    encoder.set_depth(depth);
    encoder.set_compression(Compression::Fast);
    encoder.set_filter(Filter::Up);
    let mut writer = encoder.write_header().map_err(wrong)?;
    writer.write_image_data(rows).map_err(wrong)?;
    writer.finish().map_err(wrong)?;
    Ok(bytes)
}

/// A PNG of 16 bits.
pub fn png16(key: u64, size: [usize; 2], pixels: &[u16]) -> Result<Vec<u8>, DatasetError> {
    // Written in place: that is what vectorises.
    let mut rows = vec![0; 2 * pixels.len()];
    for (bytes, pixel) in rows.as_chunks_mut().0.iter_mut().zip(pixels) {
        *bytes = pixel.to_be_bytes();
    }
    png(key, size, BitDepth::Sixteen, &rows)
}

/// A PNG of 8 bits.
pub fn png8(key: u64, size: [usize; 2], pixels: &[u8]) -> Result<Vec<u8>, DatasetError> {
    png(key, size, BitDepth::Eight, pixels)
}

/// The head of a NumPy array (version 1.0) of rows and columns, with the values to follow.
fn npy([width_px, height_px]: [usize; 2], kind: &str, bytes_per_value: usize) -> Vec<u8> {
    const ALIGNED: usize = 64;
    let mut head = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({height_px}, {width_px}), }}");
    let length = (10 + head.len() + 1).next_multiple_of(ALIGNED) - 10;
    head.extend(std::iter::repeat_n(' ', length - head.len() - 1));
    head.push('\n');
    let mut bytes = Vec::with_capacity(10 + length + width_px * height_px * bytes_per_value);
    bytes.extend_from_slice(b"\x93NUMPY\x01\x00");
    bytes.extend_from_slice(&(length as u16).to_le_bytes());
    bytes.extend_from_slice(head.as_bytes());
    bytes
}

/// A NumPy array of uint16; `rows` are its bytes, the low one of each number first.
pub(super) fn npy_u16(size: [usize; 2], rows: &[u8]) -> Vec<u8> {
    let mut bytes = npy(size, "<u2", 2);
    bytes.extend_from_slice(rows);
    bytes
}

/// Numbers as bytes, the low one of each first.
pub(super) fn low_byte_first(pixels: &[u16]) -> Vec<u8> {
    let mut rows = vec![0; 2 * pixels.len()];
    for (bytes, pixel) in rows.as_chunks_mut().0.iter_mut().zip(pixels) {
        *bytes = pixel.to_le_bytes();
    }
    rows
}

/// A NumPy array of float32.
pub(super) fn npy_f32(size: [usize; 2], pixels: &[f32]) -> Vec<u8> {
    let mut bytes = npy(size, "<f4", 4);
    bytes.extend(pixels.iter().flat_map(|pixel| pixel.to_le_bytes()));
    bytes
}

fn decoded(bytes: &[u8]) -> Result<DynamicImage, String> {
    let decode = || image::load_from_memory_with_format(bytes, image::ImageFormat::Png).map_err(|error| error.to_string());
    guarded(decode).map_err(|panicked| panicked.to_string())?
}

/// The counts of a sample, row by row.
pub(super) fn read_image(sample: &Sample) -> Result<Vec<u16>, String> {
    let of = |what: &str| format!("the image of the frame {:09} {what}", sample.key);
    if let Some(bytes) = sample.member("image.png") {
        return match decoded(bytes).map_err(|error| of(&format!("cannot be read: {error}")))? {
            DynamicImage::ImageLuma16(image) => Ok(image.into_raw()),
            _ => Err(of("has no grey values of 16 bits")),
        };
    }
    let Some(bytes) = sample.member("image.npy") else { return Err(of("is missing")) };
    read_npy(bytes, "<u2").map(|rows| rows.as_chunks().0.iter().map(|pixel| u16::from_le_bytes(*pixel)).collect()).map_err(|what| of(&what))
}

/// Grey values of a PNG of 8 bits.
pub(super) fn read_png8(bytes: &[u8]) -> Result<Vec<u8>, String> {
    match decoded(bytes)? {
        DynamicImage::ImageLuma8(image) => Ok(image.into_raw()),
        _ => Err("has no grey values of 8 bits".to_owned()),
    }
}

/// The values of a NumPy array of ours.
fn read_npy<'b>(bytes: &'b [u8], kind: &str) -> Result<&'b [u8], String> {
    let length = bytes.get(8..10).map_or(0, |field| usize::from(u16::from_le_bytes([field[0], field[1]])));
    let head = bytes.get(10..10 + length).map(String::from_utf8_lossy).unwrap_or_default();
    if bytes.starts_with(b"\x93NUMPY\x01\x00") && head.contains(kind) {
        Ok(&bytes[10 + length..])
    } else {
        Err(format!("is no NumPy array of {kind}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pngs_keep_every_bit() {
        let pixels: Vec<u16> = (0..20_u16).map(|index| index.wrapping_mul(7919)).collect();
        let read = image::load_from_memory(&png16(1, [5, 4], &pixels).unwrap()).unwrap();
        assert_eq!(read.as_luma16().unwrap().as_raw(), &pixels);
        let bytes: Vec<u8> = (0..20).collect();
        let read = image::load_from_memory(&png8(1, [5, 4], &bytes).unwrap()).unwrap();
        assert_eq!((read.width(), read.as_luma8().unwrap().as_raw()), (5, &bytes));
    }

    #[test]
    fn counts_come_back_from_either_form() {
        let pixels = [1, 2, 3, 4, 5, 60_000];
        for (name, bytes) in [("image.png", png16(1, [3, 2], &pixels).unwrap()), ("image.npy", npy_u16([3, 2], &low_byte_first(&pixels)))] {
            let mut sample = Sample { key: 7, members: vec![(name.to_owned(), bytes)] };
            assert_eq!(read_image(&sample).unwrap(), pixels);
            sample.members[0].1.truncate(5);
            assert!(read_image(&sample).unwrap_err().starts_with("the image of the frame 000000007 "));
        }
        assert_eq!(read_png8(&png8(1, [2, 2], &[1, 2, 3, 4]).unwrap()).unwrap(), [1, 2, 3, 4]);
    }

    #[test]
    fn arrays_have_the_head_that_numpy_writes() {
        let bytes = npy_u16([3, 2], &low_byte_first(&[1, 2, 3, 4, 5, 0x0102]));
        // numpy.save of an array of 2 rows and 3 columns of uint16 (NumPy 1.26), up to the padding.
        assert!(bytes.starts_with(b"\x93NUMPY\x01\x00\x76\x00{'descr': '<u2', 'fortran_order': False, 'shape': (2, 3), }  "));
        assert_eq!((bytes.len(), bytes[127], &bytes[138..]), (128 + 12, b'\n', &[2, 1][..]));
        assert_eq!(npy_f32([1, 1], &[1.0])[128..], 1.0_f32.to_le_bytes());
    }
}

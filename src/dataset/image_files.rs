//! Images as bytes of files: NumPy arrays; and what is read back of them.

use image::DynamicImage;

use super::error::DatasetError;
use super::sample_labels::SampleLabels;
use super::samples::Sample;
use crate::guard::guarded;
use crate::recording::{FitsHeaders, fits_rice_u16, image_of_bytes, png_u8, png_u16};

/// A PNG of 16 bits.
pub(super) fn png16(key: u64, size: [usize; 2], pixels: &[u16]) -> Result<Vec<u8>, DatasetError> {
    png_u16(size, pixels).map_err(|message| DatasetError::Encode { key, message })
}

/// A PNG of 8 bits.
pub(super) fn png8(key: u64, size: [usize; 2], pixels: &[u8]) -> Result<Vec<u8>, DatasetError> {
    png_u8(size, pixels).map_err(|message| DatasetError::Encode { key, message })
}

/// A FITS file, packed by Rice coding.
pub(super) fn fits_rice(labels: &SampleLabels, pixels: &[u16]) -> Result<Vec<u8>, DatasetError> {
    fits_rice_u16(labels.size_px, pixels, &fits_headers(labels)).map_err(|message| DatasetError::Encode { key: labels.key, message })
}

/// What the header of a FITS file says of a frame.
pub(super) fn fits_headers(labels: &SampleLabels) -> FitsHeaders {
    FitsHeaders {
        time_utc: labels.time_utc.parse().ok(),
        exposure_s: Some(labels.exposure_s),
        temperature_c: Some(labels.temperature_c),
        gain_e_per_dn: Some(labels.gain_e_per_dn),
        ..FitsHeaders::default()
    }
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
    if let Some(bytes) = sample.member("image.fits") {
        let frame = image_of_bytes(bytes.to_vec(), None).map_err(|problem| of(&format!("cannot be read: {problem}")))?.frame;
        return Ok(frame.pixels_dn.iter().map(|count| *count as u16).collect());
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
    use crate::recording::low_byte_first;

    #[test]
    fn counts_come_back_from_either_form() {
        let pixels = [1, 2, 3, 4, 5, 60_000];
        let rice = fits_rice_u16([8, 8], &[pixels[5]; 64], &FitsHeaders::default()).unwrap();
        let sample = Sample { key: 7, members: vec![("image.fits".to_owned(), rice)] };
        assert_eq!(read_image(&sample).unwrap(), [60_000; 64]);
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

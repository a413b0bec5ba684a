//! Frames as the images that a system under test reads.

use std::path::Path;

use super::suite_file::{ScalingTable, SystemImage};
use crate::recording::{FitsHeaders, ImageFileForm, OutputError, write_image};

/// The form of its files.
pub(super) fn file_form(image: SystemImage) -> ImageFileForm {
    match image {
        SystemImage::Png8 => ImageFileForm::Png8,
        SystemImage::Png16 => ImageFileForm::Png16,
        SystemImage::Tiff16 => ImageFileForm::Tiff16,
        SystemImage::Fits => ImageFileForm::Fits,
        SystemImage::Raw16 => ImageFileForm::Raw16,
    }
}

/// Counts as numbers of 16 bits.
pub(super) fn scaled16(pixels_dn: &[u16], scaling: Option<&ScalingTable>) -> Vec<u16> {
    match scaling {
        None => pixels_dn.to_vec(),
        Some(scaling) => mapped(pixels_dn, |count| scaling.of(count, f64::from(u16::MAX)) as u16),
    }
}

/// Counts as numbers of 8 bits; without a scaling the low bits are dropped, so that `top_dn` becomes 255.
pub(super) fn scaled8(pixels_dn: &[u16], top_dn: f64, scaling: Option<&ScalingTable>) -> Vec<u8> {
    let table: Vec<u8> = (0..=u16::MAX)
        .map(|count| match scaling {
            None => (f64::from(count) * 255.0 / top_dn).min(255.0).floor() as u8,
            Some(scaling) => scaling.of(count, 255.0) as u8,
        })
        .collect();
    pixels_dn.iter().map(|count| table[usize::from(*count)]).collect()
}

fn mapped(pixels_dn: &[u16], of: impl Fn(u16) -> u16) -> Vec<u16> {
    let table: Vec<u16> = (0..=u16::MAX).map(of).collect();
    pixels_dn.iter().map(|count| table[usize::from(*count)]).collect()
}

impl ScalingTable {
    /// What is wrong with it.
    pub(super) fn fault(&self) -> Option<String> {
        let Self { black_dn, white_dn, gamma } = *self;
        let is_good = black_dn.is_finite() && white_dn > black_dn && (0.1..=10.0).contains(&gamma);
        (!is_good).then(|| {
            format!("system.scaling: white_dn = {white_dn} must be above black_dn = {black_dn}, and gamma = {gamma} from 0.1 to 10")
        })
    }

    fn of(&self, count: u16, top: f64) -> f64 {
        let part = ((f64::from(count) - self.black_dn) / (self.white_dn - self.black_dn)).clamp(0.0, 1.0);
        (part.powf(self.gamma) * top).round()
    }
}

/// Writes a frame; `top_dn` is the largest count of the camera.
pub(super) fn write_scaled(
    path: &Path,
    size_px: [usize; 2],
    pixels_dn: &[u16],
    (image, top_dn, scaling): (SystemImage, f64, Option<&ScalingTable>),
    headers: &FitsHeaders,
) -> Result<(), OutputError> {
    if image == SystemImage::Png8 {
        let bytes: Vec<u16> = scaled8(pixels_dn, top_dn, scaling).into_iter().map(u16::from).collect();
        return write_image(path, ImageFileForm::Png8, size_px, (&bytes, 8), headers);
    }
    write_image(path, file_form(image), size_px, (&scaled16(pixels_dn, scaling), 16), headers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_scaled_as_the_suite_says() {
        assert_eq!(scaled8(&[0, 16, 4095, 5000], 4095.0, None), [0, 0, 255, 255]);
        let stretch = ScalingTable { black_dn: 100.0, white_dn: 300.0, gamma: 0.5 };
        assert_eq!(scaled8(&[50, 100, 150, 300, 900], 4095.0, Some(&stretch)), [0, 0, 128, 255, 255]);
        assert_eq!(scaled16(&[7, 9], None), [7, 9]);
        assert_eq!(scaled16(&[100, 300], Some(&stretch)), [0, u16::MAX]);
        assert!(stretch.fault().is_none() && ScalingTable { white_dn: 100.0, ..stretch }.fault().is_some());
    }
}

//! Frames of a dataset for the eye: small pictures within the page of statistics.

use std::fs::File;
use std::io::BufReader;

use super::error::DatasetError;
use super::image_files::{png8, read_image};
use super::sample_labels::SampleLabels;
use super::samples::{Sample, samples_of};
use super::whole_dataset::WholeDataset;

/// Frames that are shown, and the longest side of their pictures, px.
const SHOWN: usize = 12;
const SIDE_PX: usize = 240;

/// The first frames of shards that are spread over the dataset, with their stars.
pub(super) fn contact_sheet(whole: &WholeDataset<'_>) -> Result<String, DatasetError> {
    let mut text = String::new();
    let count = whole.marks.len();
    let step = count.div_ceil(SHOWN).max(1);
    for (shard, _) in whole.marks.iter().step_by(step) {
        let path = whole.folder.join(shard.file());
        let wrong = |source| DatasetError::Read { path: path.display().to_string(), source };
        let file = BufReader::new(File::open(&path).map_err(wrong)?);
        let Some(sample) = samples_of(file).next().transpose().map_err(wrong)? else { continue };
        text += &figure(&sample).map_err(|message| DatasetError::Parse { path: path.display().to_string(), message })?;
    }
    Ok(format!(
        "{text}<p class=\"note\">Brightness by the arcsine-hyperbolic of counts above the median; the brightest pixel of each part of the frame is shown.</p>\n"
    ))
}

fn figure(sample: &Sample) -> Result<String, String> {
    let labels: SampleLabels = sample.labels()?;
    let [width_px, height_px] = labels.size_px;
    let pixels = read_image(sample)?;
    if pixels.len() != width_px.saturating_mul(height_px) || pixels.is_empty() {
        return Err(format!("the frame {:09} has {} pixels and not {width_px} × {height_px}", sample.key, pixels.len()));
    }
    let step = width_px.max(height_px).div_ceil(SIDE_PX);
    let (columns, rows) = (width_px.div_ceil(step), height_px.div_ceil(step));
    let mut largest = vec![0_u16; columns * rows];
    for (place, pixel) in pixels.iter().enumerate() {
        let cell = &mut largest[place / width_px / step * columns + place % width_px / step];
        *cell = (*cell).max(*pixel);
    }
    let mut sorted = largest.clone();
    sorted.sort_unstable();
    let at = |share: f64| f64::from(sorted[((sorted.len() - 1) as f64 * share) as usize]);
    let (median, spread) = (at(0.5), (at(0.8) - at(0.5)).max(1.0));
    let top = ((at(0.998) - median) / spread).max(4.0).asinh();
    let grey = |count: u16| {
        let level = ((f64::from(count) - median) / spread).asinh() / top;
        (30.0 + 225.0 * level).clamp(0.0, 255.0) as u8
    };
    let shown: Vec<u8> = largest.iter().map(|count| grey(*count)).collect();
    let png = png8(sample.key, [columns, rows], &shown).map_err(|error| error.to_string())?;
    let scale = (SIDE_PX / columns.max(rows)).max(1);
    Ok(format!(
        "<figure><img width=\"{}\" height=\"{}\" alt=\"frame {:09}\" src=\"data:image/png;base64,{}\"><figcaption>{:09}, {}: {} stars</figcaption></figure>\n",
        columns * scale,
        rows * scale,
        sample.key,
        base64(&png),
        sample.key,
        escaped(&labels.split),
        labels.lights.visible_stars()
    ))
}

/// Text that HTML takes as it is.
#[must_use]
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// RFC 4648, section 4.
#[must_use]
pub fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let word = group.iter().fold(0_u32, |word, byte| word << 8 | u32::from(*byte)) << (8 * (3 - group.len()));
        for place in 0..4 {
            let letter = LETTERS[(word >> (18 - 6 * place)) as usize & 63];
            text.push(if place <= group.len() { char::from(letter) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    #[test]
    fn bytes_are_told_as_rfc_4648_has_them() {
        for (bytes, told) in [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")] {
            assert_eq!(super::base64(bytes.as_bytes()), told);
        }
    }
}

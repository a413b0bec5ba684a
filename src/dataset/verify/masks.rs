//! Masks and distances held against labels.

use crate::dataset::image_files::read_png8;
use crate::dataset::pixel_labels::{STAR, distances};
use crate::dataset::sample_labels::{STAR as STAR_KIND, SampleLabels};
use crate::dataset::samples::Sample;

/// Stars that stand out have at least this ratio of electrons to their standard error.
const MIN_SNR: f64 = 20.0;
/// The brightest pixel of a star, in standard deviations of its background, from which the mask must show it.
const MIN_PEAK: f64 = 3.0;
/// Beside the box of a star its light may still stand above the noise, px.
const MARGIN_PX: usize = 6;
/// The share of stars that masks must show, and of pixels of stars that must belong to one.
const MIN_SHARE: f64 = 0.95;
/// Steps of a distance by which rounded places may differ.
const MAX_STEPS: u8 = 1;

/// What masks and labels have in common, over many frames.
#[derive(Clone, Debug, Default)]
pub(super) struct MaskMeasure {
    /// Stars that stand out, and those that the mask shows.
    stars: [u64; 2],
    /// Pixels of stars, and those within the box of one.
    pixels: [u64; 2],
    /// Pixels whose distance is not that of the labels, and the first frame with one.
    wrong_distances: u64,
    first_wrong: Option<u64>,
    /// Frames with members that cannot be read.
    unread: Vec<String>,
}

impl MaskMeasure {
    /// Looks at a frame.
    pub(super) fn add(&mut self, labels: &SampleLabels, sample: &Sample) {
        let mut read = |name: &str| {
            let bytes = sample.member(name)?;
            match read_png8(bytes).and_then(|pixels| {
                let is_whole = pixels.len() == labels.size_px[0].saturating_mul(labels.size_px[1]);
                is_whole.then_some(pixels).ok_or_else(|| "is not of the size of its frame".to_owned())
            }) {
                Ok(pixels) => Some(pixels),
                Err(what) => {
                    self.unread.push(format!("the member {name} of the frame {:09}: {what}", sample.key));
                    None
                }
            }
        };
        let (classes, told) = (read("mask.png"), read("distance.png"));
        if let Some(classes) = classes {
            self.add_mask(labels, &classes);
        }
        if let Some(told) = told {
            let lights = &labels.lights;
            let visible = (0..lights.hip.len()).filter(|index| lights.visible[*index] && lights.kind[*index] == STAR_KIND);
            let wanted = distances(labels.size_px, visible.map(|index| [lights.x_px[index], lights.y_px[index]]));
            let wrong = told.iter().zip(&wanted).filter(|(told, wanted)| told.abs_diff(**wanted) > MAX_STEPS).count() as u64;
            if wrong > 0 {
                self.wrong_distances += wrong;
                self.first_wrong.get_or_insert(sample.key);
            }
        }
    }

    fn add_mask(&mut self, labels: &SampleLabels, classes: &[u8]) {
        let (lights, [width_px, height_px]) = (&labels.lights, labels.size_px);
        let mut is_near = vec![false; classes.len()];
        for index in (0..lights.hip.len()).filter(|index| lights.kind[*index] == STAR_KIND) {
            let (left, right) = (lights.box_left_px[index], lights.box_right_px[index].min(width_px - 1));
            let (top, bottom) = (lights.box_top_px[index], lights.box_bottom_px[index].min(height_px - 1));
            for row in top.saturating_sub(MARGIN_PX)..=bottom.saturating_add(MARGIN_PX).min(height_px - 1) {
                let columns = left.saturating_sub(MARGIN_PX)..=right.saturating_add(MARGIN_PX).min(width_px - 1);
                columns.for_each(|column| is_near[row * width_px + column] = true);
            }
            let noise_e = (lights.background_e[index] + labels.read_noise_e.powi(2)).sqrt();
            let stands_out = lights.snr[index] >= MIN_SNR && lights.peak_electrons[index] >= MIN_PEAK * noise_e && lights.visible[index];
            if stands_out {
                let is_shown = (top..=bottom).any(|row| (left..=right).any(|column| classes[row * width_px + column] > 0));
                self.stars[0] += 1;
                self.stars[1] += u64::from(is_shown);
            }
        }
        for (class, is_near) in classes.iter().zip(is_near) {
            if *class == STAR {
                self.pixels[0] += 1;
                self.pixels[1] += u64::from(is_near);
            }
        }
    }

    /// Adds what other frames show.
    pub(super) fn merge(&mut self, other: Self) {
        for which in 0..2 {
            self.stars[which] += other.stars[which];
            self.pixels[which] += other.pixels[which];
        }
        self.wrong_distances += other.wrong_distances;
        self.first_wrong = self.first_wrong.into_iter().chain(other.first_wrong).min();
        self.unread.extend(other.unread);
    }

    /// What is wrong, a sentence for each fault.
    pub(super) fn faults(&self) -> Vec<String> {
        let mut faults = self.unread.clone();
        faults.sort();
        let is_short = |[all, found]: [u64; 2]| (found as f64) < MIN_SHARE * all as f64;
        if is_short(self.stars) {
            faults.push(format!("masks show {} of {} stars that the labels have standing above the noise", self.stars[1], self.stars[0]));
        }
        if is_short(self.pixels) {
            faults.push(format!("of {} pixels that masks call a star {} are near a labelled one", self.pixels[0], self.pixels[1]));
        }
        if let Some(first) = self.first_wrong {
            faults.push(format!(
                "{} pixels have a distance that is not that to the nearest visible star of the labels, the first in the frame {first:09}",
                self.wrong_distances
            ));
        }
        faults
    }
}

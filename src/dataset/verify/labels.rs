//! Labels held against pixels: where the light of bright lone stars is, and where the labels say.
//!
//! The light of a star is the sum of the counts about its labelled place less the median around, and its place the centre of that light. Nothing of
//! the renderer takes part, but where images have wings or are lopsided: `alone.rs`. The median over many stars is held to a hundredth of a pixel,
//! where nothing pulls the light aside: stars of frames whose effects move charge between pixels are counted by themselves and held to a tenth. So axes that
//! are exchanged or mirrored and an origin that is half a pixel off show, whatever wrote the labels. That holds for trails as well: a label is the centre of
//! the light over the exposure.

use std::collections::HashMap;

use super::alone::place_px;
use super::label_window::Window;
use super::symmetry::Symmetry;
use crate::dataset::sample_labels::{STAR, SampleLabels};
use crate::effects::effect;
use crate::effects::pixel::{Work, pixel_effect};
use crate::render::StarsAlone;
use crate::statistics::{mad_sigma, median};

/// Stars that are measured have at least this ratio of electrons to their standard error.
const MIN_SNR: f64 = 20.0;
/// A neighbour with more than this share of the light disturbs.
const MAX_NEIGHBOUR: f64 = 0.02;
/// Pixels beyond the window of a star that the background is taken from.
const RING_PX: isize = 3;
/// The light at the labelled place, in units of the labelled one, that counts as found.
const FOUND: std::ops::Range<f64> = 0.5..2.0;
/// The share of stars that must be found.
const MIN_FOUND: f64 = 0.8;
/// The centre of the light of even images is its label to this, px.
const MAX_OFFSET_PX: f64 = 0.01;
/// Charge that is trailed or pushed aside, and wings of lopsided images that lie beyond the window where the star cannot be rendered by itself, move the
/// centre by less than this, px; what is further off is a wrong label.
const MAX_PULLED_PX: f64 = 0.1;
/// With a larger standard error half a pixel is not told from chance.
const MAX_ERROR_PX: f64 = 0.1;
/// Images of a star without wings: the box of its light holds all but next to nothing.
const COMPACT_IMAGES: [&str; 2] = ["gaussian", "elliptic-gaussian"];
/// Images of a star that are the same when they are turned by 180°.
const EVEN_IMAGES: [&str; 4] = ["gaussian", "elliptic-gaussian", "moffat", "airy"];
/// Standard errors that chance is granted.
const MAX_DEVIATIONS: f64 = 4.0;
/// Fewer stars than this tell nothing.
const MIN_STARS: usize = 10;

/// What was measured, over many frames.
#[derive(Clone, Debug, Default)]
pub(super) struct LabelMeasure {
    /// Measured less labelled place of the stars that were found, columns and rows, px: first where nothing pulls the light aside, then where something may.
    offsets_px: [[Vec<f64>; 2]; 2],
    /// Stars that were looked for.
    looked_for: usize,
    /// Those found, for each symmetry.
    found: [usize; 8],
    /// Those whose light is in the labelled box, wherever the labelled place is.
    in_boxes: usize,
}

/// What labels and pixels have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MeasuredOffset {
    pub(super) stars: usize,
    /// Median of measured less labelled place.
    pub(super) offset_px: [f64; 2],
    pub(super) standard_error_px: [f64; 2],
}

/// Whether something pulls the light of stars aside in the pixels of a frame: an effect that moves charge between pixels or has a displacement of its
/// own beside its face on pixels.
fn may_be_pulled(labels: &SampleLabels) -> bool {
    let moves = |id: &String| {
        let of_pixels = pixel_effect(id).is_some_and(|effect| matches!(effect.work(), Work::Frame(..)));
        of_pixels || effect(id).is_some_and(|effect| effect.has_both_faces())
    };
    labels.effects.iter().any(moves)
}

/// Whether stars of a frame are measured by the images that they should have, if those can be rendered.
pub(super) fn needs_images(labels: &SampleLabels) -> bool {
    !COMPACT_IMAGES.contains(&labels.psf.as_str())
}

/// Whether a light is a star that is bright and by itself.
fn is_good(labels: &SampleLabels, index: usize) -> bool {
    let lights = &labels.lights;
    lights.kind[index] == STAR
        && lights.visible[index]
        && lights.snr[index] >= MIN_SNR
        && !lights.saturated[index]
        && !lights.blended[index]
        && !lights.edge[index]
}

/// Catalogue numbers of the stars that are to be measured, with their place in the labels.
pub(super) fn good_stars(labels: &SampleLabels) -> HashMap<u32, usize> {
    (0..labels.lights.hip.len()).filter(|index| is_good(labels, *index)).map(|index| (labels.lights.hip[index], index)).collect()
}

/// Light in a window and its centre; `None` where the window is not on the frame. What lies behind the star is a plane through the pixels around.
fn light(pixel: &dyn Fn(usize) -> f64, size: [usize; 2], window: Window) -> Option<(f64, [f64; 2])> {
    let around = window.grown(RING_PX);
    if !around.is_on(size) {
        return None;
    }
    let count = |[x, y]: [isize; 2]| pixel(y.cast_unsigned() * size[0] + x.cast_unsigned());
    let ring: Vec<[isize; 2]> = around.places().filter(|place| !window.contains(*place)).collect();
    let level = median(&ring.iter().map(|place| count(*place)).collect::<Vec<_>>())?;
    let middle = [0, 1].map(|axis: usize| 0.5 * (window.from[axis] + window.to[axis]) as f64);
    // From the pixels on one side to those on the other.
    let slope = |axis: usize| -> Option<f64> {
        let side = |is_in: &dyn Fn(isize) -> bool| {
            let counts: Vec<f64> = ring.iter().filter(|place| is_in(place[axis])).map(|place| count(*place)).collect();
            median(&counts)
        };
        let (low, high) = (side(&|at| at < window.from[axis])?, side(&|at| at > window.to[axis])?);
        Some((high - low) / (window.to[axis] - window.from[axis] + 1 + RING_PX) as f64)
    };
    let slopes = [slope(0)?, slope(1)?];
    let (mut sum, mut moments) = (0.0, [0.0; 2]);
    for place in window.places() {
        let behind = level + slopes[0] * (place[0] as f64 - middle[0]) + slopes[1] * (place[1] as f64 - middle[1]);
        let own = count(place) - behind;
        sum += own;
        moments[0] += own * place[0] as f64;
        moments[1] += own * place[1] as f64;
    }
    Some((sum, moments.map(|moment| moment / sum)))
}

/// Whether a star of a frame can be measured by itself.
fn is_lone(labels: &SampleLabels, index: usize) -> bool {
    let lights = &labels.lights;
    if !is_good(labels, index) {
        return false;
    }
    let own = Window::new(labels, index, Symmetry::ALL[0]);
    let disturbs = |other: &usize| {
        *other != index
            && lights.electrons_landed[*other] > MAX_NEIGHBOUR * lights.electrons_landed[index]
            && Window::new(labels, *other, Symmetry::ALL[0]).touches(own.grown(RING_PX))
    };
    !(0..lights.hip.len()).any(|other| disturbs(&other))
}

/// A sentence for each axis along which the light is further than that from its labels.
fn off(offset: &MeasuredOffset, most_px: f64) -> Vec<String> {
    let axes = ["columns (x)", "rows (y)"].into_iter().zip(offset.offset_px).zip(offset.standard_error_px);
    let is_off = |((_, offset_px), error_px): &((&str, f64), f64)| offset_px.abs() > most_px + MAX_DEVIATIONS * error_px;
    axes.filter(is_off)
        .map(|((axis, offset_px), error_px)| {
            format!(
                "the light of {} bright lone stars is {offset_px:.4} ± {error_px:.4} px from its labels along {axis}, more than {most_px} px; places count from the centre of the first pixel",
                offset.stars
            )
        })
        .collect()
}

impl LabelMeasure {
    /// Measures the stars of a frame; `alone`: by the images that they should have.
    pub(super) fn add(&mut self, labels: &SampleLabels, pixels: &[u16], alone: Option<&StarsAlone>) {
        let (lights, size) = (&labels.lights, labels.size_px);
        if pixels.len() != size[0].saturating_mul(size[1]) {
            return;
        }
        if let Some(alone) = alone.filter(|alone| alone.expected_e.len() == pixels.len()) {
            return self.add_by_images(labels, pixels, alone);
        }
        let kind = usize::from(may_be_pulled(labels) || !EVEN_IMAGES.contains(&labels.psf.as_str()));
        let counts = |pixel: usize| f64::from(pixels[pixel]);
        for index in (0..lights.hip.len()).filter(|index| is_lone(labels, *index)) {
            let expected_dn = lights.electrons_landed[index] / labels.gain_e_per_dn;
            if !Window::new(labels, index, Symmetry::ALL[0]).grown(RING_PX).is_on(size) {
                continue;
            }
            self.looked_for += 1;
            let label = [lights.x_px[index], lights.y_px[index]];
            for (symmetry, found) in Symmetry::ALL.into_iter().zip(&mut self.found) {
                let window = Window::new(labels, index, symmetry);
                let Some((sum, centre)) = light(&counts, size, window) else { continue };
                if !FOUND.contains(&(sum / expected_dn)) {
                    continue;
                }
                let is_as_labelled = symmetry == Symmetry::ALL[0];
                self.in_boxes += usize::from(is_as_labelled);
                // The box alone does not tell: the place is a label of its own.
                if !window.is_centre(centre, symmetry.applied(label, size)) {
                    continue;
                }
                *found += 1;
                if is_as_labelled {
                    (0..2).for_each(|axis| self.offsets_px[kind][axis].push(centre[axis] - label[axis]));
                }
            }
        }
    }

    /// The same for images that are rendered. Where the core of an image is comes from the labels, so that wrong ones have no light there.
    fn add_by_images(&mut self, labels: &SampleLabels, pixels: &[u16], alone: &StarsAlone) {
        let (size, kind, stars) = (labels.size_px, usize::from(may_be_pulled(labels)), good_stars(labels));
        let electrons = |pixel: usize| (f64::from(pixels[pixel]) - labels.bias_dn) * labels.gain_e_per_dn;
        let expected = |pixel: usize| f64::from(alone.expected_e[pixel]);
        for (star, index) in alone.stars.iter().filter_map(|star| Some((star, *stars.get(&star.hip)?))) {
            let label = [labels.lights.x_px[index], labels.lights.y_px[index]];
            let Some((wanted, _)) = light(&expected, size, Window::of_core(star, star.centre_px)) else { continue };
            self.looked_for += 1;
            for (symmetry, found) in Symmetry::ALL.into_iter().zip(&mut self.found) {
                let Some((sum, _)) = light(&electrons, size, Window::of_core(star, symmetry.applied(label, size))) else { continue };
                if !FOUND.contains(&(sum / wanted)) {
                    continue;
                }
                *found += 1;
                if symmetry == Symmetry::ALL[0]
                    && let Some(place) = place_px(star, alone, &electrons, size[0])
                {
                    (0..2).for_each(|axis| self.offsets_px[kind][axis].push(place[axis] - label[axis]));
                }
            }
        }
    }

    /// Adds what was measured in other frames.
    pub(super) fn merge(&mut self, other: Self) {
        for (own, more) in self.offsets_px.iter_mut().flatten().zip(other.offsets_px.into_iter().flatten()) {
            own.extend(more);
        }
        self.looked_for += other.looked_for;
        self.in_boxes += other.in_boxes;
        self.found.iter_mut().zip(other.found).for_each(|(own, more)| *own += more);
    }

    /// The median offset where nothing pulls the light aside, or else where something may; `None` with too few stars.
    pub(super) fn offset(&self) -> Option<MeasuredOffset> {
        self.offset_of(0).or_else(|| self.offset_of(1))
    }

    fn offset_of(&self, kind: usize) -> Option<MeasuredOffset> {
        let offsets_px = &self.offsets_px[kind];
        let stars = offsets_px[0].len();
        let of = |values: &[f64]| {
            // Of a median of normal numbers: √(π/2) σ/√n.
            let error = 1.2533 * mad_sigma(values)? / (values.len() as f64).sqrt();
            Some((median(values)?, error))
        };
        let (x, y) = (of(&offsets_px[0])?, of(&offsets_px[1])?);
        (stars >= MIN_STARS).then_some(MeasuredOffset { stars, offset_px: [x.0, y.0], standard_error_px: [x.1, y.1] })
    }

    /// What is wrong with the labels, a sentence for each fault.
    pub(super) fn faults(&self) -> Vec<String> {
        let looked_for = self.looked_for;
        if looked_for < MIN_STARS {
            return Vec::new();
        }
        let share = |found: usize| found as f64 / looked_for as f64;
        if share(self.found[0]) < MIN_FOUND {
            let (best, symmetry) = self.found.iter().zip(Symmetry::ALL).max_by_key(|(found, _)| **found).unwrap_or((&0, Symmetry::ALL[0]));
            let told = if symmetry != Symmetry::ALL[0] && share(*best) >= MIN_FOUND {
                format!("they fit {}: {best} of {looked_for}", symmetry.words())
            } else if share(self.in_boxes) >= MIN_FOUND {
                format!("{} have it in their boxes, so that places and boxes of the labels disagree", self.in_boxes)
            } else {
                "no exchange or mirroring of the axes makes them fit".to_owned()
            };
            return vec![format!("of {looked_for} bright lone stars {} have their light where the labels say; {told}", self.found[0])];
        }
        let kinds = [(0, MAX_OFFSET_PX), (1, MAX_PULLED_PX)].into_iter();
        kinds
            .filter_map(|(kind, most_px)| Some((self.offset_of(kind)?, most_px)))
            .flat_map(|(offset, most_px)| off(&offset, most_px))
            .collect()
    }

    /// Why nothing can be said of the labels, if so.
    pub(super) fn silence(&self) -> Option<String> {
        let is_enough = self.offset().is_some_and(|offset| offset.standard_error_px.iter().all(|error| *error < MAX_ERROR_PX));
        (!is_enough && self.faults().is_empty()).then(|| {
            format!("labels against pixels: {} bright lone stars in the frames looked at are too few to tell half a pixel; look at more (--frames)", self.looked_for)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalog::Catalog;
    use crate::dataset::frame_key::{DatasetSplit, FrameKey};
    use crate::dataset::image_files::read_image;
    use crate::dataset::plan::tests::{plan_of, recipe};
    use crate::dataset::samples::Sample;
    use crate::render::PsfTables;

    /// Bright stars of a wide field that moves a little.
    const SCENE: &str = "format = \"boresight-scene/1\"\ncamera = { width_px = 200, height_px = 150, focal_length_px = 350.0 }\n\
                         sky = { physics = \"none\", faintest_magnitude = 7.0 }\n[[frames]]\nexposure_s = 1.0\n\
                         rate_deg_s = [0.2, 0.3, 0.0]\n";

    /// A frame with its labels, its counts, and its stars by themselves where they are measured so.
    type Frame = (SampleLabels, Vec<u16>, Option<StarsAlone>);

    fn frames_of(scene: &str, count: u64) -> Vec<Frame> {
        let plan = plan_of(&recipe("").replace("train = 8", "train = 80"), scene).unwrap();
        let (catalog, tables) = (Catalog::embedded(), PsfTables::default());
        let frame = |index| {
            let key = FrameKey { split: DatasetSplit::Train, index };
            let sample = plan.sample(catalog, &tables, key).unwrap();
            let members = sample.members.iter().map(|(name, bytes)| ((*name).to_owned(), bytes.clone())).collect();
            let good = good_stars(&sample.labels);
            let alone = || plan.stars_alone(catalog, &tables, key, &|hip| good.contains_key(&hip)).unwrap();
            let alone = needs_images(&sample.labels).then(alone);
            (sample.labels, read_image(&Sample { key: 0, members }).unwrap(), alone)
        };
        (0..count).map(frame).collect()
    }

    /// Measures frames whose labels are changed before.
    fn measured(frames: &[Frame], change: &dyn Fn(&mut SampleLabels)) -> LabelMeasure {
        let mut measure = LabelMeasure::default();
        for (labels, pixels, alone) in frames {
            let mut labels = labels.clone();
            change(&mut labels);
            measure.add(&labels, pixels, alone.as_ref());
        }
        measure
    }

    fn exchange(labels: &mut SampleLabels) {
        let lights = &mut labels.lights;
        std::mem::swap(&mut lights.x_px, &mut lights.y_px);
        std::mem::swap(&mut lights.box_left_px, &mut lights.box_top_px);
        std::mem::swap(&mut lights.box_right_px, &mut lights.box_bottom_px);
    }

    fn mirror(labels: &mut SampleLabels) {
        let last = labels.size_px[0] - 1;
        let lights = &mut labels.lights;
        lights.x_px.iter_mut().for_each(|x| *x = last as f64 - *x);
        std::mem::swap(&mut lights.box_left_px, &mut lights.box_right_px);
        for column in lights.box_left_px.iter_mut().chain(&mut lights.box_right_px) {
            *column = last - *column;
        }
    }

    #[test]
    fn right_labels_fit_and_wrong_ones_are_told_apart() {
        let all = frames_of(SCENE, 48);
        let frames = &all[..6];
        let right = measured(frames, &|_| {});
        assert_eq!(right.faults(), Vec::<String>::new());
        assert_eq!(right.silence(), None);
        let offset = right.offset().unwrap();
        assert!(offset.stars > 30 && offset.offset_px.iter().all(|px| px.abs() < 0.05), "{offset:?}");
        let told = |change: &dyn Fn(&mut SampleLabels)| measured(frames, change).faults().join("; ");
        assert!(told(&exchange).contains("they fit with x and y exchanged"), "{}", told(&exchange));
        assert!(told(&mirror).contains("they fit with x mirrored"), "{}", told(&mirror));
        // Places alone, with the boxes as they are.
        let places = told(&|labels| std::mem::swap(&mut labels.lights.x_px, &mut labels.lights.y_px));
        assert!(places.contains("places and boxes of the labels disagree"), "{places}");
        let half = told(&|labels| labels.lights.y_px.iter_mut().for_each(|y| *y += 0.5));
        assert!(half.contains("along rows (y)") && !half.contains("along columns") && half.contains("is -0."), "{half}");
        // Many stars: a label that is off by a twentieth of a pixel is found, and one that is right is not.
        let twentieth = measured(&all, &|labels| labels.lights.x_px.iter_mut().for_each(|x| *x += 0.05));
        assert!(
            twentieth.faults().join("; ").contains("along columns (x), more than 0.01 px"),
            "{:?} {:?}",
            twentieth.faults(),
            twentieth.offset()
        );
        let many = measured(&all, &|_| {});
        assert_eq!(many.faults(), Vec::<String>::new(), "{:?}", many.offset());
        assert!(many.offset().unwrap().offset_px.iter().all(|px| px.abs() < 0.02), "{:?}", many.offset());
        let quarter = told(&|labels| labels.lights.x_px.iter_mut().for_each(|x| *x -= 0.25));
        assert!(quarter.contains("along columns (x)"), "{quarter}");
        // What may be pulled aside is held to less, and found all the same.
        let lopsided = told(&|labels| {
            labels.psf = "zernike".to_owned();
            labels.lights.y_px.iter_mut().for_each(|y| *y += 0.4);
        });
        assert!(lopsided.contains("along rows (y), more than 0.1 px"), "{lopsided}");
        let nothing = LabelMeasure::default();
        assert!(nothing.faults().is_empty() && nothing.silence().is_some());
    }
    /// Rings, wings, coma and trefoil: as right labels as those of a Gaussian, and wrong ones as surely found.
    #[test]
    fn images_with_wings_and_lopsided_ones_are_held_to_the_same() {
        let airy = "kind = \"airy\"\nparameters = { lambda_n_px = 2.5, obstruction = 0.3 }\nreach_px = 24";
        let zernike =
            "kind = \"zernike\"\nparameters = { lambda_n_px = 1.2, z4_waves = 0.06, z8_waves = 0.1, z9_waves = 0.08 }\nreach_px = 24";
        for psf in [airy, zernike] {
            let scene = SCENE
                .replace("width_px = 200, height_px = 150", "width_px = 320, height_px = 240")
                .replace("magnitude = 7.0", "magnitude = 6.0");
            let scene = format!("{scene}[psf]\n{psf}\n");
            let frames = frames_of(&scene, 8);
            let right = measured(&frames, &|_| {});
            let offset = right.offset().unwrap();
            assert_eq!(right.faults(), Vec::<String>::new(), "{psf}: {offset:?}");
            assert_eq!(right.silence(), None);
            assert!(offset.stars > 40 && offset.standard_error_px.iter().all(|error| *error < 0.01), "{psf}: {offset:?}");
            assert!(offset.offset_px.iter().all(|px| px.abs() < 0.02), "{psf}: {offset:?}");
            let told = |change: &dyn Fn(&mut SampleLabels)| measured(&frames, change).faults().join("; ");
            assert!(told(&exchange).contains("they fit with x and y exchanged"), "{psf}: {}", told(&exchange));
            assert!(told(&mirror).contains("they fit with x mirrored"), "{psf}: {}", told(&mirror));
            let half = told(&|labels| labels.lights.y_px.iter_mut().for_each(|y| *y += 0.5));
            assert!(half.contains("along rows (y), more than 0.01 px") && !half.contains("along columns"), "{psf}: {half}");
            let twentieth = told(&|labels| labels.lights.x_px.iter_mut().for_each(|x| *x += 0.05));
            assert!(twentieth.contains("along columns (x), more than 0.01 px"), "{psf}: {twentieth}");
        }
    }
}

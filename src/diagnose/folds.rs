//! Folds of the cross-validation: which frames and stars are held out in each, and how often an effect must be chosen again.
//!
//! Frames are divided into blocks, and each block is held out once: attitudes, errors that a frame's stars share and telemetry are then independent
//! of the fit. Effects that depend on a star's own numbers (motion, distance, colour, brightness) share the errors of these with all images of the
//! star: for them one half of the stars is held out too, and an image is held out with its frame and its star. With fewer frames than
//! [`MIN_FRAMES`] parts of the stars are held out instead, for all effects.

use super::evidence::Evidence;
use super::hypotheses::Hypothesis;
use crate::calibrate::BundleSolution;
use crate::effects::{Context, Light, Segment};
use crate::identify::ControlPoints;
use crate::statistics::order::sort_by_key;
use crate::statistics::significance::{chi_squared_quantile, neg_ln_chi2_sf};

/// Fewer frames are not left out in turn.
const MIN_FRAMES: usize = 4;
/// Blocks of frames at most; up to so many frames each is a block.
const BLOCKS: usize = 8;
/// Where there are frames enough a block is two stretches of frames, half the recording apart.
const STRETCHES: usize = 2;
/// Parts of the stars where frames are too few.
const STAR_PARTS: usize = 4;
/// Parts of the stars beside blocks of frames.
const STAR_HALVES: usize = 2;

/// An effect that is just significant on all images is to be chosen in nine of ten turns: by so many standard deviations of the scatter of
/// what a part shows about what the whole shows.
const NEARLY_ALWAYS: f64 = 1.28;
/// But chance alone may enter in no more than this share of the turns.
const BY_CHANCE: f64 = 0.1;

/// Star images looked at for whether an effect goes by the star's own numbers.
const LOOKED_AT: usize = 64;

/// Which effects a turn judges.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Judges {
    /// All.
    All,
    /// Those that do not go by the star's own numbers.
    OfFrames,
    /// Those that do.
    OfStars,
}

impl Judges {
    /// Whether it judges an effect.
    pub(super) fn takes(self, goes_by_stars: bool) -> bool {
        match self {
            Self::All => true,
            Self::OfFrames => !goes_by_stars,
            Self::OfStars => goes_by_stars,
        }
    }
}

/// One turn: the images that effects are chosen and sized on, and those that judge them.
#[derive(Clone, Debug)]
pub(super) struct Fold {
    /// Which effects it judges.
    pub(super) judges: Judges,
    /// Images that are fitted to.
    pub(super) train: Vec<bool>,
    /// Images that are predicted.
    pub(super) held: Vec<bool>,
}

impl Fold {
    /// Share of the images that are fitted to.
    pub(super) fn share(&self) -> f64 {
        self.train.iter().filter(|train| **train).count() as f64 / self.train.len().max(1) as f64
    }
}

/// All turns.
#[derive(Clone, Debug)]
pub(super) struct Folds {
    /// The turns.
    pub(super) all: Vec<Fold>,
    /// Block of every frame by place; none where frames are too few.
    pub(super) block: Vec<usize>,
}

impl Folds {
    /// Of a recording.
    pub(super) fn new(evidence: &Evidence) -> Self {
        let frames = evidence.frames.len();
        let images = evidence.images.len();
        let fold = |judges, train: &dyn Fn(usize) -> bool, held: &dyn Fn(usize) -> bool| Fold {
            judges,
            train: (0..images).map(train).collect(),
            held: (0..images).map(held).collect(),
        };
        let order = star_order(evidence);
        if frames < MIN_FRAMES {
            let part = |k: usize| order[evidence.star[k]] % STAR_PARTS;
            let all = (0..STAR_PARTS).map(|own| fold(Judges::All, &|k| part(k) != own, &|k| part(k) == own)).collect();
            return Self { all, block: Vec::new() };
        }
        let block = blocks(frames);
        let half = |k: usize| order[evidence.star[k]] % STAR_HALVES;
        let of = |k: usize| block[evidence.place[k]];
        let count = block.iter().max().map_or(0, |last| last + 1);
        let mut all: Vec<Fold> = (0..count).map(|own| fold(Judges::OfFrames, &|k| of(k) != own, &|k| of(k) == own)).collect();
        for own in 0..count {
            for stars in 0..STAR_HALVES {
                let train = |k: usize| of(k) != own && half(k) != stars;
                all.push(fold(Judges::OfStars, &train, &|k| of(k) == own && half(k) == stars));
            }
        }
        Self { all, block }
    }

    /// What is left out in a turn for an effect, in words.
    pub(super) fn words(&self, goes_by_stars: bool) -> &'static str {
        let frame_by_frame = self.block.iter().max().is_some_and(|last| last + 1 == self.block.len());
        match (self.block.is_empty(), goes_by_stars, frame_by_frame) {
            (true, ..) => "parts of the stars",
            (false, false, true) => "frames",
            (false, false, false) => "blocks of frames",
            (false, true, true) => "frames and halves of the stars",
            (false, true, false) => "blocks of frames and halves of the stars",
        }
    }
}

/// The block of every frame.
fn blocks(frames: usize) -> Vec<usize> {
    let count = frames.min(BLOCKS);
    let stretches = if frames >= STRETCHES * BLOCKS { STRETCHES * count } else { count };
    (0..frames).map(|place| place * stretches / frames % count).collect()
}

/// The place of each star in an order that hangs on its catalogue direction alone, and is in step with nothing.
fn star_order(evidence: &Evidence) -> Vec<usize> {
    let count = evidence.star.iter().max().map_or(0, |last| last + 1);
    let mut hashes = vec![0_u64; count];
    for (star, image) in evidence.star.iter().zip(&evidence.images) {
        hashes[*star] = image.star_direction.iter().fold(0xcbf2_9ce4_8422_2325, |state, value| {
            let mixed = (state ^ value.to_bits()).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            mixed ^ (mixed >> 29)
        });
    }
    let mut order: Vec<usize> = (0..count).collect();
    sort_by_key(&mut order, |star| (hashes[*star], *star));
    let mut place = vec![0; count];
    for (at, star) in order.into_iter().enumerate() {
        place[star] = at;
    }
    place
}

/// The surprise that a choice needs on a `share` of the images, where it needs `whole` on all of them and `hypotheses` are tried.
///
/// An effect of so many standard deviations z on all images shows √share·z on the part, ± √(1 − share) about it given z. Whatever the
/// threshold here, what is held out is not asked, so that it changes power alone, never the mean of what chance brings there.
pub(super) fn threshold(whole: f64, hypotheses: f64, share: f64) -> f64 {
    let z = chi_squared_quantile(1.0, whole).sqrt();
    let asked = (share.sqrt() * z - NEARLY_ALWAYS * (1.0 - share).max(0.0).sqrt()).max(0.0);
    neg_ln_chi2_sf(1.0, asked * asked).max((hypotheses / BY_CHANCE).ln()).min(whole)
}

/// Whether an effect moves a star by numbers of the star's own: whether another motion, distance, colour or brightness moves it otherwise.
pub(super) fn goes_by_stars(hypothesis: &Hypothesis, joint: &BundleSolution, evidence: &Evidence, points: &ControlPoints) -> bool {
    let Some(variant) = hypothesis.variants.first() else { return false };
    let mut parameters = variant.start.clone();
    for index in &hypothesis.fitted {
        parameters[*index] = hypothesis.effect.parameters()[*index].typical;
    }
    let step = evidence.images.len().div_ceil(LOOKED_AT).max(1);
    (0..evidence.images.len()).step_by(step).any(|k| {
        let Some(light) = light_of(joint, evidence, k, hypothesis.effect.segment()) else { return false };
        let mut context = evidence.context(k, points);
        context.image.signatures = crate::effects::Signatures::default();
        let moved = |context: &Context| {
            let after = hypothesis.effect.displace(&parameters, light, context);
            [after.direction[0], after.direction[1], after.direction[2], after.point_px[0], after.point_px[1]]
        };
        moved(&context).map(f64::to_bits) != moved(&other_star(&context)).map(f64::to_bits)
    })
}

/// The same image of a star with other numbers.
fn other_star(context: &Context) -> Context {
    let mut other = *context;
    other.star.proper_motion_rad_yr = other.star.proper_motion_rad_yr.map(|motion| motion + 1e-6);
    other.star.parallax_rad += 1e-6;
    other.star.magnitude += 1.0;
    other.star.colour = Some(other.star.colour.unwrap_or(crate::effects::StarState::REFERENCE_COLOUR) + 0.5);
    other.image.flux_e = other.image.flux_e.map(|flux| 0.4 * flux);
    other.image.magnitude = other.image.magnitude.map(|magnitude| magnitude + 1.0);
    other
}

/// The light of a star image, wherever along its way an effect asks for it.
fn light_of(joint: &BundleSolution, evidence: &Evidence, k: usize, segment: Segment) -> Option<Light<f64>> {
    let image = &evidence.images[k];
    let camera = joint.model().camera();
    let from_star = nalgebra::Vector3::from(image.star_direction);
    let direction = if segment == Segment::Sky { from_star } else { joint.attitude(evidence.place[k])?.camera_from_icrs * from_star };
    let middle = [(camera.width_px as f64 - 1.0) / 2.0, (camera.height_px as f64 - 1.0) / 2.0];
    let [x, y] = image.measured_px;
    Some(Light {
        direction: direction.into(),
        point_px: [x - middle[0], y - middle[1]],
        pixel_px: [x, y],
        focal_length_px: camera.focal_length_px,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_frame_is_left_out_once_and_blocks_are_even() {
        for frames in 4..60 {
            let block = blocks(frames);
            let count = frames.min(BLOCKS);
            let sizes: Vec<usize> = (0..count).map(|own| block.iter().filter(|block| **block == own).count()).collect();
            let (least, most) = (sizes.iter().min().unwrap(), sizes.iter().max().unwrap());
            assert!(*least >= 1 && most - least <= STRETCHES, "{frames} frames: {sizes:?}");
            assert_eq!(sizes.iter().sum::<usize>(), frames);
        }
    }

    /// A part asks for less than the whole, the smaller the less, but never so little that chance enters all the time, nor more than the whole.
    #[test]
    fn a_part_asks_for_less() {
        let whole = 12.0;
        let of = |share: f64| threshold(whole, 30.0, share);
        assert!(of(7.0 / 8.0) < whole && of(0.75) < of(7.0 / 8.0) && of(0.4) <= of(0.75));
        assert!(of(0.1) >= (30.0_f64 / BY_CHANCE).ln() - 1e-12);
        assert!((threshold(4.0, 30.0, 0.75) - 4.0).abs() < 1e-12, "a loose threshold is that of the parts too");
        // An effect that just reaches the whole's threshold is chosen in nine of ten parts.
        let z = chi_squared_quantile(1.0, whole).sqrt();
        let share: f64 = 0.875;
        let asked = chi_squared_quantile(1.0, of(share)).sqrt();
        let chosen = crate::statistics::significance::normal_cdf((share.sqrt() * z - asked) / (1.0 - share).sqrt());
        assert!((chosen - 0.9).abs() < 0.01, "{chosen}");
    }
}

//! One run of the matched filter: what it looks at, its threshold by the frame's own noise, and what it finds.

use super::DetectOptions;
use super::field::Field;
use super::filter::{self, Kernel, Peak};
use super::image_model::Shape;
use super::noise_tail::Tail;
use super::work::Work;
use crate::statistics::median_in_place;

/// Peaks that are fitted, at most.
const MAX_PEAKS: usize = 20_000;

/// What the matched filter looks at.
#[derive(Clone, Copy)]
pub(super) struct Ground<'a> {
    /// Counts less the background in units of the noise.
    pub(super) normalised: &'a [f32],
    pub(super) width: usize,
    /// Whether black is cut off above the level of the sky.
    pub(super) is_cut: bool,
    /// Whether what is left of it comes in the blocks of a compressed picture.
    pub(super) is_in_blocks: bool,
    pub(super) options: &'a DetectOptions,
    pub(super) work: &'a Work,
}

/// What the matched filter found.
#[derive(Clone)]
pub(super) struct Search {
    pub(super) shape: Shape,
    /// Trails that the frame's stars tell together.
    pub(super) field: Option<Field>,
    /// Whether the frame's stars, or the caller, told the shape.
    pub(super) shape_known: bool,
    /// Scatter of the filtered noise over that of white noise; 1 unless clearly more.
    pub(super) scatter: f64,
    /// Signal-to-noise ratio from which on peaks count.
    pub(super) threshold: f64,
    pub(super) peaks: Vec<Peak>,
    pub(super) kernel: Kernel,
    /// Pixels that the light of clear stars reaches.
    pub(super) lit: Vec<bool>,
}

impl Search {
    pub(super) fn at_shape(shape: Shape, shape_known: bool, ground: &Ground<'_>) -> Self {
        /// Around maxima this much above the threshold for normal noise there is starlight.
        const STARLIGHT: f64 = 1.3;
        /// Where estimates of the noise differ by less than this from the normal case, it is by chance.
        const CHANCE: f64 = 1.02;
        /// From here on errors are stated larger; less comes by chance.
        const CLEARLY: f64 = 1.05;
        /// Where black is cut off, sums of what is left may scatter so much less than the noise that it was.
        const MIN_OF_CUT: f64 = 0.2;
        let Ground { normalised, width, is_cut, is_in_blocks, options, work } = *ground;
        let kernel = Kernel::new(shape);
        work.spend(kernel.cost_ns(normalised.len()));
        let filtered = kernel.apply(normalised, width);
        let normal = kernel.threshold(normalised.len(), options.false_alarms_per_frame);
        // what is left of cut noise are lone pixels rather than a smooth field: there are no more maxima than pixels
        let normal = if is_cut { normal.min(filter::exceeded_in(normalised.len(), options.false_alarms_per_frame)) } else { normal };
        let stars = filter::peaks(&filtered, width, STARLIGHT * normal * filter::scatter(&filtered, &[]).max(1.0));
        let lit = kernel.lit(&stars, &filtered, width);
        let correlated = filter::scatter(&filtered, &lit);
        let step = (normalised.len() / 60_000).max(1) | 1;
        let tail = if is_cut {
            tail_of_cut(normalised, &lit, width)
        } else {
            Tail::of(normalised.iter().zip(&lit).step_by(step).filter(|(_, lit)| !**lit).map(|(n, _)| *n))
        };
        let (independent, scatter) = tail.map_or((normal, 1.0), |t| (t.equivalent(&kernel.weights(), normal), t.scatter()));
        let beyond = |ratio: f64| if ratio > CHANCE { ratio } else { 1.0 };
        let of_tail = if is_cut { (independent / normal).max(MIN_OF_CUT) } else { beyond(independent / normal) };
        let white = if is_cut { scatter.max(MIN_OF_CUT) } else { scatter.max(1.0) };
        let scatter = Some(kernel.scatter_of_correlated(normalised, &lit, width)).filter(|s| *s > CLEARLY).unwrap_or(1.0);
        // Noise in blocks leaves lone pixels darker than the rest of it: the tail of these is not all. Elsewhere what goes together are faint stars.
        let of_tail = if is_in_blocks { of_tail * scatter } else { of_tail };
        let threshold = options.detection_threshold.unwrap_or(normal * of_tail * beyond(correlated / white));
        let mut peaks = filter::peaks(&filtered, width, threshold);
        peaks.truncate(MAX_PEAKS);
        Self { shape, field: None, shape_known, scatter, threshold, peaks, kernel, lit }
    }

    /// The shape of a star at a place.
    pub(super) fn shape_at(&self, x: f64, y: f64) -> Shape {
        self.field.map_or(self.shape, |field| field.at(x, y).shape())
    }
}

/// The tail of noise whose black is cut off: of pixels whose neighbours are no brighter than most, since starlight too faint to be known would be
/// taken for it, and hardly a pixel left out.
fn tail_of_cut(normalised: &[f32], lit: &[bool], width: usize) -> Option<Tail> {
    const SAMPLE: usize = 400_000;
    const OUTLYING: f64 = 5e-5;
    let inner = (width + 1..normalised.len().saturating_sub(width + 1)).step_by((normalised.len() / SAMPLE).max(1) | 1);
    let around = |i: usize| {
        let row = |i: usize| normalised[i - 1] + normalised[i] + normalised[i + 1];
        row(i - width) + row(i) + row(i + width) - normalised[i]
    };
    let all: Vec<(f32, f32)> = inner.filter(|i| !lit[*i]).map(|i| (normalised[i], around(i))).collect();
    let most = median_in_place(&mut all.iter().map(|(_, around)| f64::from(*around)).collect::<Vec<_>>())?;
    Tail::without(all.iter().filter(|(_, around)| f64::from(*around) <= most + 1e-3).map(|(own, _)| *own), OUTLYING)
}

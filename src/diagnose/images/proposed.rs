//! What the judgement of the rows is made of and what it comes to: the pixels that are asked, an effect that is proposed, the state of a channel.

use std::collections::BTreeMap;

use nalgebra::DMatrix;

use super::noise_kind::DeclaredDetector;
use super::sky_view::SkyView;
use super::turns::HeldOut;
use crate::diagnose::channels::{Channel, ChannelMeasure};
use crate::pixel_statistics::PixelStatistics;

/// The pixels between the stars, and what is known of them.
#[derive(Clone, Copy, Debug)]
pub(in crate::diagnose) struct Pixels<'a> {
    pub(in crate::diagnose) statistics: &'a PixelStatistics,
    pub(in crate::diagnose) detector: &'a DeclaredDetector,
    /// Place of every frame among those that are tested, by its number.
    pub(in crate::diagnose) places: &'a BTreeMap<usize, usize>,
    /// Where the sky of the frames lies.
    pub(in crate::diagnose) views: &'a [SkyView],
}

impl Pixels<'_> {
    /// Place of a frame by its number; of one that is not tested that of the tested one before it, else of the first.
    pub(super) fn place(&self, number: usize) -> usize {
        self.places.range(..=number).next_back().map_or(0, |(_, place)| *place)
    }
}

/// An effect that all rows propose.
#[derive(Clone, Debug)]
pub(in crate::diagnose) struct Proposed {
    pub(in crate::diagnose) question: usize,
    /// Sizes of the columns with their standard errors,
    pub(in crate::diagnose) sizes: Vec<[f64; 2]>,
    /// and their covariance.
    pub(in crate::diagnose) covariance: DMatrix<f64>,
    pub(in crate::diagnose) statistic: f64,
    pub(in crate::diagnose) rank: usize,
    pub(in crate::diagnose) surprise: f64,
    pub(in crate::diagnose) family_p: f64,
    pub(in crate::diagnose) held_out: HeldOut,
    /// The first parameter as each channel alone measures it.
    pub(in crate::diagnose) channels: BTreeMap<Channel, ChannelMeasure>,
    /// Effects that leave the same trace and explain about as much.
    pub(in crate::diagnose) alike: Vec<&'static str>,
    /// p-value of its mean against its scatter from field to field, where that is asked.
    pub(in crate::diagnose) between_fields: Option<f64>,
    /// Why it is withheld; none where it stands.
    pub(in crate::diagnose) against: Vec<String>,
}

/// What is said of a channel.
#[derive(Clone, Debug, Default)]
pub(in crate::diagnose) struct ChannelState {
    /// Probability by chance that it differs as much from the model, before anything is found.
    pub(in crate::diagnose) p_value: f64,
    pub(in crate::diagnose) located_by: Vec<String>,
    /// The same with the findings.
    pub(in crate::diagnose) left_p_value: f64,
    pub(in crate::diagnose) left_located_by: Vec<String>,
    /// χ² per degree of freedom of frames and stars that took no part, with all that is found without them, and its degrees of freedom.
    pub(in crate::diagnose) held_out: Option<[f64; 2]>,
}

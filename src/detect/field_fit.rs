//! The stars of a frame as they are guessed and fitted, each with those whose light reaches into its window.

use super::blend_fit::WidthFactor;
use super::candidates::{Candidate, neighbours};
use super::fit::{Fit, Freedom};
use super::gain::Sample;
use super::image_model::Model;
use super::search::apart;
use crate::frame::Frame;

/// The stars of a frame.
pub(super) struct FieldFit {
    pub(super) candidates: Vec<Candidate>,
    pub(super) fits: Vec<Option<Fit>>,
    pub(super) neighbours: Vec<Vec<usize>>,
    /// With whom each is fitted together; the first of two holds the breadth of their images.
    pub(super) partner: Vec<Option<(usize, WidthFactor)>>,
    /// By how much images are wider than a star's where they are no lone star's, px².
    pub(super) wider: Vec<Option<[f64; 3]>>,
}

impl FieldFit {
    /// Each as it was guessed.
    pub(super) fn new(candidates: Vec<Candidate>) -> Self {
        let guesses: Vec<Model> = candidates.iter().map(|c| c.start).collect();
        let count = candidates.len();
        Self { neighbours: neighbours(&guesses), candidates, fits: vec![None; count], partner: vec![None; count], wider: vec![None; count] }
    }

    pub(super) fn guesses(&self, of: &[usize]) -> Vec<Model> {
        of.iter().map(|&j| self.candidates[j].start).collect()
    }

    /// A star as fitted; where the fit failed no light at all.
    pub(super) fn model(&self, i: usize) -> Model {
        self.fits[i].as_ref().map_or(Model { flux_dn: 0.0, ..self.candidates[i].start }, |f| f.model)
    }

    /// The stars whose light reaches to these.
    pub(super) fn around(&self, group: &[usize]) -> Vec<Model> {
        let mut all: Vec<usize> = group.iter().flat_map(|&i| self.neighbours[i].iter().copied()).filter(|j| !group.contains(j)).collect();
        all.sort_unstable();
        all.dedup();
        all.into_iter().map(|j| self.model(j)).collect()
    }

    /// Those that tell the gain: of all, or where the brightest stand together, in the other parts of the frame.
    pub(super) fn samples(&self, frame: &Frame, freedom: impl Fn(&Candidate) -> Freedom, fitted: bool) -> Vec<Sample> {
        let candidates = |i: &usize| [self.candidates[*i].start.x, self.candidates[*i].start.y];
        let told = apart(&(0..self.candidates.len()).collect::<Vec<_>>(), candidates, frame);
        let sample = |i: usize| {
            let candidate = &self.candidates[i];
            let near = &self.neighbours[i];
            let neighbours = if fitted { self.around(&[i]) } else { self.guesses(near) };
            let start = if fitted { self.fits[i].as_ref()?.model } else { candidate.start };
            (candidate.full_radius_px == 0.0).then(|| Sample { start, snr: candidate.snr, freedom: freedom(candidate), neighbours })
        };
        told.into_iter().filter_map(sample).collect()
    }

    /// Whether another star's light, found or not, is in its image.
    pub(super) fn is_blended(&self, i: usize) -> bool {
        !self.neighbours[i].is_empty() || self.wider[i].is_some()
    }
}

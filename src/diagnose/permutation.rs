//! Permutation test of covariates. Star properties (colour, place on the frame) are permuted among the images of each frame, by exchanging the
//! images' residuals; frame properties (temperature, time, rate) are permuted among the frames, with all their images. Never both at once: images
//! of one frame share an attitude, and frames may share errors. A covariate's p-value is taken from the largest statistic over all covariates of
//! its kind (maxT).
//!
//! Source: D. Freedman and D. Lane, J. Bus. Econ. Stat. 1, 292 (1983), residuals beside a model permuted; Westfall and Young, Resampling-Based
//! Multiple Testing (1993), maxT.

use nalgebra::{DMatrix, DMatrixView};
use rand::{SeedableRng, seq::SliceRandom};
use rand_pcg::Pcg64Mcg;

use super::covariates::Separated;
use super::evidence::Evidence;
use super::fit_state::FitState;
use super::linear_fit::FrameSums;
use super::linear_system::Whitened;
use super::scan::{Asks, MIN_SHARE, Scan};
use crate::parallel;
use crate::statistics::order::descending;
use crate::statistics::significance::neg_ln_chi2_sf;

/// Permutations of a covariate.
pub(super) const DEALS: usize = 999;
/// Permutations that are computed together.
const BATCH: usize = 111;
/// Fewer frames have too few orders: 1/n! is above one in a hundred.
const MIN_FRAMES: usize = 5;

/// Null distributions of the permutation tests.
#[derive(Clone, Debug, Default)]
pub(super) struct Permutations {
    /// Of star images.
    of_images: Kind,
    /// Of frames; empty where frames are too few.
    of_frames: Kind,
}

/// Covariates of one kind.
#[derive(Clone, Debug, Default)]
struct Kind {
    /// The largest statistic over all covariates in each permutation, the largest first.
    largest: Vec<f64>,
    /// The statistic of each covariate without permutation; nothing for those of the other kind.
    seen: Vec<Option<f64>>,
}

impl Kind {
    fn p_value(&self, index: usize) -> Option<f64> {
        let surprise = self.seen.get(index).copied().flatten().filter(|_| !self.largest.is_empty())?;
        let as_large = self.largest.partition_point(|value| *value >= surprise * (1.0 - 1e-9));
        Some((as_large as f64 + 1.0) / (self.largest.len() as f64 + 1.0))
    }
}

impl Permutations {
    /// p-value of a covariate among all covariates of its kind, and what was permuted; `None` where frames are too few.
    pub(super) fn p_value(&self, index: usize) -> Option<(f64, &'static str)> {
        let images = self.of_images.p_value(index).map(|p| (p, "star images within their frames"));
        let frames = self.of_frames.p_value(index).map(|p| (p, "frames"));
        match (images, frames) {
            // One frame out of line is asked of its images, a law over the frames of the frames: two questions.
            (Some(images), Some(frames)) => Some(if images.0 < frames.0 { images } else { frames }).map(|(p, of)| ((2.0 * p).min(1.0), of)),
            (images, frames) => images.or(frames),
        }
    }
}

/// Deals all covariates out. `scan` holds their patterns beside the model of `stand`.
pub(super) fn permute(evidence: &Evidence, stand: &FitState, scan: &Scan, seed: u64) -> Permutations {
    Permutations { of_images: among_images(evidence, stand, scan, seed), of_frames: among_frames(evidence, stand, seed) }
}

fn sorted(mut values: Vec<f64>) -> Vec<f64> {
    descending(&mut values, |a| *a);
    values
}

/// Residuals permuted among the images of each frame.
fn among_images(evidence: &Evidence, stand: &FitState, scan: &Scan, seed: u64) -> Kind {
    let mut kind = Kind { seen: vec![None; evidence.covariates.len()], ..Kind::default() };
    let mut ranks = Vec::new();
    let mut flat: Vec<f32> = Vec::new();
    let mut at = 0;
    for group in &scan.groups {
        let columns = at..at + group.rank;
        at = columns.end;
        let Asks::Covariate(index) = group.asks else { continue };
        // Patterns of a frame's number stand first.
        if group.pattern >= evidence.covariates[index].by_frame.len() {
            ranks.push(group.rank);
            flat.extend(scan.columns.columns(columns.start, group.rank).iter());
            let seen = kind.seen[index].get_or_insert(0.0);
            *seen = seen.max(group.surprise());
        }
    }
    let rows = scan.columns.nrows();
    if ranks.is_empty() || rows == 0 {
        return kind;
    }
    let columns = DMatrix::from_vec(rows, flat.len() / rows, flat);
    let mut frames: Vec<Vec<usize>> = vec![Vec::new(); evidence.frames.len()];
    for (k, place) in evidence.place.iter().enumerate().filter(|(k, _)| stand.take[*k]) {
        frames[*place].push(k);
    }
    // Dealt out within a frame, n vectors of sum zero scatter as n − 1 free ones do.
    let free: usize = frames.iter().map(|own| 2 * own.len().saturating_sub(1)).sum();
    let square: f64 = stand.fit.psi.iter().map(|value| value * value).sum();
    let c = square / (free as f64).max(1.0);
    let batches: Vec<usize> = (0..DEALS).step_by(BATCH).collect();
    let largest: Vec<Vec<f64>> = parallel::map(&batches, |&first| {
        let deals = BATCH.min(DEALS - first);
        let mut dealt = vec![0.0_f32; rows * deals];
        for (deal, column) in (first..).zip(dealt.chunks_exact_mut(rows)) {
            let mut rng = Pcg64Mcg::seed_from_u64(seed ^ (deal as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
            for own in &frames {
                let mut order = own.clone();
                order.shuffle(&mut rng);
                for (to, from) in own.iter().zip(&order) {
                    column[2 * to] = stand.fit.psi[2 * from] as f32;
                    column[2 * to + 1] = stand.fit.psi[2 * from + 1] as f32;
                }
            }
        }
        let z = DMatrixView::from_slice_with_strides(&dealt, deals, rows, rows, 1) * &columns;
        (0..deals)
            .map(|deal| {
                let mut column = 0;
                let mut most = 0.0_f64;
                for rank in &ranks {
                    let t: f64 = (column..column + rank).map(|j| f64::from(z[(deal, j)]).powi(2)).sum::<f64>() / c;
                    most = most.max(neg_ln_chi2_sf(*rank as f64, t));
                    column += rank;
                }
                most
            })
            .collect()
    });
    kind.largest = sorted(largest.into_iter().flatten().collect());
    kind
}

/// A pattern of a frame's number as sums over frames.
struct Pattern<'a> {
    separated: &'a Separated,
    sums: FrameSums,
}

impl Pattern<'_> {
    /// Its surprise with the numbers of frame `order[h]` given to frame h.
    fn surprise(&self, order: &[usize], c: f64) -> f64 {
        let columns = &self.separated.columns;
        let n = columns.len();
        let sums = &self.sums;
        let shared = sums.shared.first().map_or(0, |of| of.first().map_or(0, Vec::len));
        let mut score = vec![0.0; n];
        let mut length = vec![0.0; n];
        let mut gram = DMatrix::<f64>::zeros(n, n);
        let mut along = DMatrix::<f64>::zeros(shared, n);
        for (frame, from) in order.iter().enumerate() {
            for i in 0..n {
                let (carrier, weights) = (columns[i].0, &columns[i].1);
                let weight = weights[*from];
                if weight == 0.0 {
                    continue;
                }
                score[i] += weight * sums.score[frame][carrier];
                length[i] += weight * weight * sums.length[frame][carrier];
                for (row, value) in sums.shared[frame][carrier].iter().enumerate() {
                    along[(row, i)] += weight * value;
                }
                for (j, (other, weights)) in columns.iter().enumerate().take(i + 1) {
                    gram[(i, j)] += weight * weights[*from] * sums.gram[frame][(carrier, *other)];
                }
            }
        }
        for i in 0..n {
            for j in 0..i {
                gram[(j, i)] = gram[(i, j)];
            }
        }
        gram -= along.tr_mul(&along);
        let scale: Vec<f64> = length.iter().map(|length| if *length > 0.0 { 1.0 / length.sqrt() } else { 0.0 }).collect();
        for (k, value) in gram.iter_mut().enumerate() {
            *value *= scale[k % n] * scale[k / n];
        }
        let eigen = gram.symmetric_eigen();
        let (mut t, mut rank) = (0.0, 0.0);
        for (k, value) in eigen.eigenvalues.iter().enumerate().filter(|(_, value)| **value > MIN_SHARE * MIN_SHARE) {
            let z: f64 = (0..n).map(|i| eigen.eigenvectors[(i, k)] * scale[i] * score[i]).sum();
            t += z * z / (value * c);
            rank += 1.0;
        }
        if rank > 0.0 { neg_ln_chi2_sf(rank, t) } else { 0.0 }
    }
}

/// Properties of frames permuted among the frames.
fn among_frames(evidence: &Evidence, stand: &FitState, seed: u64) -> Kind {
    let frames = evidence.frames.len();
    let of = |separated| pattern(evidence, stand, separated);
    let patterns: Vec<Vec<Pattern<'_>>> = evidence.covariates.iter().map(|covariate| covariate.by_frame.iter().map(of).collect()).collect();
    let c = stand.fit.c;
    let most = |own: &[Pattern<'_>], order: &[usize]| own.iter().map(|pattern| pattern.surprise(order, c)).fold(0.0, f64::max);
    let in_order: Vec<usize> = (0..frames).collect();
    let seen = patterns.iter().map(|own| (!own.is_empty()).then(|| most(own, &in_order))).collect();
    if frames < MIN_FRAMES || patterns.iter().all(Vec::is_empty) {
        return Kind { seen, ..Kind::default() };
    }
    let largest = parallel::map_numbers(DEALS, |deal| {
        let mut order = in_order.clone();
        order.shuffle(&mut Pcg64Mcg::seed_from_u64(seed ^ (deal as u64 + 1).wrapping_mul(0xd134_2543_de82_ef95)));
        patterns.iter().map(|own| most(own, &order)).fold(0.0, f64::max)
    });
    Kind { largest: sorted(largest), seen }
}

fn pattern<'a>(evidence: &Evidence, stand: &FitState, separated: &'a Separated) -> Pattern<'a> {
    let carriers: Vec<Whitened> = separated.carriers.iter().map(|carrier| evidence.white(&stand.noise, carrier)).collect();
    Pattern { separated, sums: stand.fit.frame_sums(&carriers) }
}

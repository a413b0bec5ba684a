//! Cluster-robust test of an effect: wild bootstrap of its score with Rademacher signs per frame (or star).
//!
//! The score is a sum over clusters; without the effect each term has either sign with equal probability. The p-value is the share of sign patterns
//! whose score is as large. It supposes nothing of the correlation of errors within a cluster, nor of their size.
//!
//! Clusters are the frames; for effects that displace a star by numbers of its own (proper motion, parallax) the stars; where frames are too few,
//! parts of them. Errors that hang together over whole frames (air in motion, attitude noise within the exposure) make parts of frames agree by chance:
//! there the scatter of the score between frames is asked too, by Hotelling's T² with as many degrees of freedom as frames tell alike.
//!
//! Source: the wild bootstrap of a score with Rademacher weights by cluster, its null imposed (P. Kline and A. Santos, J. Econometric Methods 1, 23
//! (2012); Cameron, Gelbach and Miller, Rev. Econ. Stat. 90, 414 (2008)); with symmetric parts it is exact. Scatter
//! between few clusters: C. B. Hansen, J. Econometrics 141, 597 (2007); T²: H. Hotelling, Ann. Math. Stat. 2, 360 (1931).

use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use statrs::function::beta::beta_reg;

use super::evidence::Evidence;
use super::fit_state::{FitState, SelectedEffect, basis};
use super::linear_fit::Fit;
use super::linear_system::Whitened;
use super::star_images::REACH_PX;

/// The test is passed below this. It guards against errors that hang together, not against chance, which the family of all tests holds far lower:
/// at a tenth of this three of 250 right names near the limit of detection failed it, where sixteen frames of unequal worth can say no more.
pub(super) const LEVEL: f64 = 1e-2;
/// From so many frames on these are the units.
const FRAMES_FROM: usize = 16;
/// The units where frames are fewer.
const PARTS: &str = "parts of frames";
/// Cells of the field along each axis, where parts of frames are the units.
const CELLS: usize = 3;
/// Frames that tell alike, at least, for their scatter to be asked.
const MIN_SCATTER_FRAMES: f64 = 6.0;
/// Sign patterns drawn at most,
const DRAWS: usize = 40_000;
/// until so many have done as well.
const ENOUGH: usize = 100;

/// The answer.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct WildBootstrap {
    /// What the units are.
    pub(super) units: &'static str,
    /// How many the effect lives on: of equal parts that tell as much.
    pub(super) effective: f64,
    /// p-value: share of the sign patterns whose score is as large; nothing where even the best could not be below [`LEVEL`].
    pub(super) p_value: Option<f64>,
    /// p-value of the mean score against its scatter between frames, where parts of frames are the units and the frames are enough for it.
    pub(super) between_frames: Option<f64>,
}

/// Of entry `k` beside the others.
pub(super) fn wild_bootstrap(evidence: &Evidence, stand: &FitState, entries: &[SelectedEffect], k: usize, seed: u64) -> WildBootstrap {
    let white = |entry: &SelectedEffect| stand.white(evidence, std::slice::from_ref(entry));
    let others: Vec<Whitened> = entries.iter().enumerate().filter(|(index, _)| *index != k).flat_map(|(_, entry)| white(entry)).collect();
    let without = Fit::new(&stand.system, &stand.take, &others.iter().collect::<Vec<_>>());
    let own = white(&entries[k]);
    let rest: Vec<Whitened> = own.iter().map(|column| without.project(column)).collect();
    let (directions, _) = basis(&rest, &own, &without);
    let (units, of) = units(evidence, entries[k]);
    let Scores { scores, told } = Scores::of(&directions, &without.psi, &of);
    let effective = effective(&told);
    let p_value = (2.0_f64.powf(1.0 - effective) < LEVEL).then(|| share_of_signs(&scores, seed));
    let between_frames = if units == PARTS { between_frames(&directions, &without.psi, &evidence.place) } else { None };
    WildBootstrap { units, effective, p_value, between_frames }
}

/// Scores of units.
struct Scores {
    /// By unit and direction.
    scores: Vec<Vec<f64>>,
    /// Information of every unit, over all directions.
    told: Vec<f64>,
}

impl Scores {
    /// `of`: the unit of every image, whose two coordinates stand side by side in the directions and in ψ.
    fn of(directions: &[Vec<f64>], psi: &[f64], of: &[usize]) -> Self {
        let count = of.iter().max().map_or(0, |last| last + 1);
        let mut scores = vec![vec![0.0; directions.len()]; count];
        let mut told = vec![0.0; count];
        for (j, direction) in directions.iter().enumerate() {
            for (index, value) in direction.iter().enumerate() {
                scores[of[index / 2]][j] += value * psi[index];
                told[of[index / 2]] += value * value;
            }
        }
        Self { scores, told }
    }
}

/// Of equal units that tell as much, how many there would be.
fn effective(told: &[f64]) -> f64 {
    let (sum, squares) = told.iter().fold((0.0, 0.0), |(sum, squares), told| (sum + told, squares + told * told));
    if squares > 0.0 { sum * sum / squares } else { 0.0 }
}

/// p-value of the sum of the frames' scores against their scatter about what one size of the effect makes of them.
fn between_frames(directions: &[Vec<f64>], psi: &[f64], frame: &[usize]) -> Option<f64> {
    let rank = directions.len();
    let Scores { scores, told } = Scores::of(directions, psi, frame);
    let degrees = effective(&told) - rank as f64;
    if rank == 0 || degrees + 1.0 < MIN_SCATTER_FRAMES {
        return None;
    }
    let mut shares = vec![DMatrix::<f64>::zeros(rank, rank); scores.len()];
    for (index, of) in frame.iter().enumerate() {
        for axis in [2 * index, 2 * index + 1] {
            let own = DVector::from_iterator(rank, directions.iter().map(|direction| direction[axis]));
            shares[*of] += &own * own.transpose();
        }
    }
    let sum = scores.iter().fold(DVector::zeros(rank), |sum: DVector<f64>, own| sum + DVector::from_column_slice(own));
    // Directions are orthonormal: the shares of the frames add up to one, and the sum of the scores is the size.
    let scatter = scores.iter().zip(&shares).fold(DMatrix::zeros(rank, rank), |scatter: DMatrix<f64>, (own, share)| {
        let rest = DVector::from_column_slice(own) - share * &sum;
        scatter + &rest * rest.transpose()
    });
    let count = told.iter().filter(|told| **told > 0.0).count() as f64;
    let t2 = sum.dot(&(scatter * (count / (count - 1.0))).cholesky()?.solve(&sum));
    let total = degrees + rank as f64 - 1.0;
    Some(beta_reg(0.5 * degrees, 0.5 * rank as f64, total / (total + t2)))
}

/// The unit of every image.
fn units(evidence: &Evidence, entry: SelectedEffect) -> (&'static str, Vec<usize>) {
    if evidence.hypotheses[entry.hypothesis].effect.is_of_the_star() {
        return ("stars", evidence.star.clone());
    }
    if evidence.frames.len() >= FRAMES_FROM {
        return ("frames", evidence.place.clone());
    }
    let places: Vec<[f64; 2]> = evidence.predicted_px(REACH_PX).collect();
    let most = places.iter().flatten().fold(1.0_f64, |most, value| most.max(*value));
    let cell = |value: f64| ((value / most * CELLS as f64).max(0.0) as usize).min(CELLS - 1);
    let of = |(place, [x, y]): (&usize, &[f64; 2])| (place * CELLS + cell(*x)) * CELLS + cell(*y);
    (PARTS, evidence.place.iter().zip(&places).map(of).collect())
}

/// Share of the sign patterns over the units for which the sum of the units' scores is as long as with their own signs.
fn share_of_signs(scores: &[Vec<f64>], seed: u64) -> f64 {
    let rank = scores.first().map_or(0, Vec::len);
    let mut sum = vec![0.0; rank];
    for score in scores {
        for (sum, score) in sum.iter_mut().zip(score) {
            *sum += score;
        }
    }
    let length = |sum: &[f64]| sum.iter().map(|value| value * value).sum::<f64>();
    let seen = length(&sum) * (1.0 - 1e-12);
    let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0xa076_1d64_78bd_642f);
    let (mut as_good, mut drawn) = (0_usize, 0_usize);
    while drawn < DRAWS && as_good < ENOUGH {
        sum.fill(0.0);
        for chunk in scores.chunks(64) {
            let mut bits: u64 = rng.random();
            for score in chunk {
                let sign = if bits & 1 == 1 { 1.0 } else { -1.0 };
                bits >>= 1;
                for (sum, score) in sum.iter_mut().zip(score) {
                    *sum += sign * score;
                }
            }
        }
        drawn += 1;
        as_good += usize::from(length(&sum) >= seen);
    }
    (as_good as f64 + 1.0) / (drawn as f64 + 1.0)
}

#[cfg(test)]
mod tests {
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    /// Scores of units of unequal weight, without an effect: p is below a level as often as the level says, whatever the units' sizes and
    /// however long their tails; and with an effect that is the same in all it is small.
    #[test]
    fn signs_are_fair_whatever_the_units() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let draw = |rng: &mut Pcg64Mcg, effect: f64, unit: usize| -> Vec<f64> {
            let weight = 1.0 + (unit % 5) as f64;
            (0..2)
                .map(|_| {
                    let normal: f64 = StandardNormal.sample(rng);
                    let tail: f64 = StandardNormal.sample(rng);
                    effect * weight + weight * normal / (0.3 + tail * tail)
                })
                .collect()
        };
        for units in [16, 40] {
            const NULLS: usize = 400;
            let mut below = [0_usize; 2];
            for null in 0..NULLS {
                let scores: Vec<Vec<f64>> = (0..units).map(|unit| draw(&mut rng, 0.0, unit)).collect();
                let p = share_of_signs(&scores, null as u64);
                below[0] += usize::from(p < 0.05);
                below[1] += usize::from(p < 0.3);
            }
            for (below, level) in below.into_iter().zip([0.05, 0.3]) {
                let expected = NULLS as f64 * level;
                let error = (expected * (1.0 - level)).sqrt();
                assert!((below as f64 - expected).abs() < 3.5 * error, "{units} units: p below {level} in {below} of {NULLS}");
            }
            let scores: Vec<Vec<f64>> =
                (0..units).map(|unit| draw(&mut rng, 6.0, unit).iter().map(|s| s.clamp(-20.0, 20.0)).collect()).collect();
            assert!(share_of_signs(&scores, 7) < LEVEL);
        }
    }

    /// The scatter between frames is fair where errors hang together over whole frames, as parts of frames are not; and it lets an effect pass that is
    /// the same in all.
    #[test]
    fn frames_are_asked_where_errors_hang_together() {
        const FRAMES: usize = 12;
        const IMAGES: usize = 40;
        const NULLS: usize = 400;
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let mut draw = || -> f64 { StandardNormal.sample(&mut rng) };
        for rank in [1, 2] {
            let count = 2 * FRAMES * IMAGES;
            // An effect lives on one axis each; frames have unequal weights.
            let of = |index: usize| 1.0 + (index / 2 / IMAGES % 3) as f64;
            let raw: Vec<Vec<f64>> =
                (0..rank).map(|axis| (0..count).map(|index| if index % 2 == axis { of(index) } else { 0.0 }).collect()).collect();
            let unit = |column: &Vec<f64>| {
                let norm = column.iter().map(|value| value * value).sum::<f64>().sqrt();
                column.iter().map(|value| value / norm).collect::<Vec<f64>>()
            };
            let directions: Vec<Vec<f64>> = raw.iter().map(unit).collect();
            let frame: Vec<usize> = (0..FRAMES * IMAGES).map(|image| image / IMAGES).collect();
            let parts: Vec<usize> = (0..FRAMES * IMAGES).map(|image| image / (IMAGES / 8)).collect();
            let (mut below, mut by_parts) = (0_u32, 0_u32);
            for null in 0..NULLS {
                let shared: Vec<[f64; 2]> = (0..FRAMES).map(|_| [draw(), draw()]).collect();
                let psi: Vec<f64> = (0..count).map(|index| draw() + 0.5 * shared[index / 2 / IMAGES][index % 2]).collect();
                below += u32::from(between_frames(&directions, &psi, &frame).unwrap() < 0.05);
                by_parts += u32::from(share_of_signs(&Scores::of(&directions, &psi, &parts).scores, null as u64) < 0.05);
            }
            let expected = 0.05 * NULLS as f64;
            println!("rank {rank}: p below 0.05 in {below} of {NULLS} by frames, in {by_parts} by parts of frames");
            // 20 ± 4.4.
            assert!((8..=34).contains(&below), "rank {rank}: {below} of {NULLS}");
            assert!(f64::from(by_parts) > 3.0 * expected, "rank {rank}: parts {by_parts} of {NULLS}");
            let psi: Vec<f64> = (0..count).map(|index| draw() + 8.0 * directions[0][index]).collect();
            assert!(between_frames(&directions, &psi, &frame).unwrap() < LEVEL);
        }
    }

    /// What one unit says alone is not believed: half of all signs do as well.
    #[test]
    fn one_unit_convinces_nobody() {
        let mut scores: Vec<Vec<f64>> = (0..30).map(|unit| vec![if unit % 2 == 0 { 0.01 } else { -0.01 }]).collect();
        scores[3][0] = 100.0;
        assert!(share_of_signs(&scores, 1) > 0.4);
    }
}

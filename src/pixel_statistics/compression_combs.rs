//! The combs that a quantiser leaves in the histograms of block coefficients: equations in `compression`.

use serde::{Deserialize, Serialize};

use crate::parallel;

/// The comb of one coefficient.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct CoefficientComb {
    /// Vertical frequency, half periods per block.
    pub row: usize,
    /// Horizontal frequency, half periods per block.
    pub column: usize,
    /// Quantiser, DN.
    pub quantiser_dn: f64,
    /// Its standard error, DN; 0.15 of the quantiser where most values are 0.
    pub quantiser_error_dn: f64,
    /// Upper bound with all trials.
    pub p_value: f64,
}

pub(super) const BINS_PER_DN: f64 = 8.0;

pub(super) const BLOCK: usize = 8;

/// A comb is told where its p-value, with all trials, is below this.
pub(super) const TOLD: f64 = 1e-3;

/// Quantisers tried, DN; the histogram ends at 256.
pub(super) const MIN_QUANTISER_DN: f64 = 0.5;
const MAX_QUANTISER_DN: f64 = 128.0;

/// Table K.1 of ITU-T T.81, luminance, rows of vertical frequency.
#[rustfmt::skip]
pub(super) const TABLE: [f64; 64] = [
    16., 11., 10., 16., 24., 40., 51., 61.,
    12., 12., 14., 19., 26., 58., 60., 55.,
    14., 13., 16., 24., 40., 57., 69., 56.,
    14., 17., 22., 29., 51., 87., 80., 62.,
    18., 22., 37., 56., 68., 109., 103., 77.,
    24., 35., 55., 64., 81., 104., 113., 92.,
    49., 64., 78., 87., 103., 121., 120., 101.,
    72., 92., 95., 98., 112., 100., 103., 99.,
];

/// The histogram of one coefficient.
pub(super) struct Coefficient {
    pub(super) index: usize,
    /// Value in DN, and how often.
    pub(super) values: Vec<(f64, f64)>,
    /// The same in bins from zero, and how often.
    bins: Vec<i32>,
    times: Vec<f32>,
    pub(super) median_dn: f64,
    /// Half the range of the middle two thirds, DN.
    pub(super) core_dn: f64,
    /// All values lie below this, DN.
    pub(super) reach_dn: f64,
    pub(super) frames: f64,
}

/// The quantisers of one coefficient.
pub(super) struct Scan {
    /// The fundamental, where there is one.
    pub(super) quantiser_dn: Option<f64>,
    /// The best N C².
    pub(super) score: f64,
    pub(super) trials: f64,
}

/// C of a comb that is blurred by the rounding of the counts.
fn blurred(quantiser_dn: f64, step_dn: f64) -> f64 {
    (-std::f64::consts::PI.powi(2) / 6.0 * (step_dn / quantiser_dn).powi(2)).exp()
}

/// Values that are taken together, and sums that run side by side.
const TOGETHER: usize = 256;
const LANES: usize = 8;

/// cos of an angle in units of 2⁻³² turns, to 4e-6: 1 − 2·sin²(π·r), by the sine's series.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into the loop over values, which is vectorised only then")]
fn cosine(turn: i32) -> f32 {
    const HALF_TURN: f32 = std::f32::consts::PI / 4_294_967_296.0;
    const SERIES: [f32; 4] = [1.0 / 6.0, 1.0 / 20.0, 1.0 / 42.0, 1.0 / 72.0];
    let angle = turn as f32 * HALF_TURN;
    let square = angle * angle;
    let rest = 1.0 - square * SERIES[1] * (1.0 - square * SERIES[2] * (1.0 - square * SERIES[3]));
    let sine = angle * (1.0 - square * SERIES[0] * rest);
    1.0 - 2.0 * sine * sine
}

/// Number of the values that lie `limit` bins or more from a tooth, and the sum of their cosines; `turn_per_bin` in units of 2⁻³² turns.
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn cosines_beyond(bins: &[i32], times: &[f32], turn_per_bin: i32, tooth: f32, limit: f32) -> [f64; 2] {
    let mut sums = [0.0_f64; 2];
    for (bins, times) in bins.chunks(TOGETHER).zip(times.chunks(TOGETHER)) {
        // The terms first, and then their sums: a loop that sums is not vectorised.
        let (mut counted, mut cosines) = ([0.0_f32; TOGETHER], [0.0_f32; TOGETHER]);
        for (((bin, times), counted), own) in bins.iter().zip(times).zip(&mut counted).zip(&mut cosines) {
            *counted = if (*bin as f32 - tooth).abs() >= limit { *times } else { 0.0 };
            *own = *counted * cosine(bin.wrapping_mul(turn_per_bin));
        }
        for (sum, terms) in sums.iter_mut().zip([&counted, &cosines]) {
            let mut lanes = [0.0_f32; LANES];
            for terms in terms.as_chunks::<LANES>().0 {
                lanes.iter_mut().zip(terms).for_each(|(lane, term)| *lane += term);
            }
            *sum += f64::from(lanes.iter().sum::<f32>());
        }
    }
    sums
}

impl Coefficient {
    /// Of values that are whole bins, of which the middle one and half the range of the middle two thirds are known.
    pub(super) fn new(index: usize, values: Vec<(f64, f64)>, [median_dn, core_dn]: [f64; 2], frames: f64) -> Option<Self> {
        // All of them: where nearly everything is quantised to 0, a few values far out show the comb.
        let reach_dn = values.first()?.0.abs().max(values.last()?.0.abs()).max(4.0);
        let bins = values.iter().map(|(value, _)| (value * BINS_PER_DN).round() as i32).collect();
        let times = values.iter().map(|(_, times)| *times as f32).collect();
        Some(Self { index, values, bins, times, median_dn, core_dn, reach_dn, frames })
    }

    /// Number of independent values outside of the tooth nearest to the median, and the sum of their cosines.
    fn cosines(&self, quantiser_dn: f64) -> (f64, f64) {
        let tooth = quantiser_dn * (self.median_dn / quantiser_dn).round();
        // A bin across the limit counts: its cosine is near −1, so that the test errs to the safe side.
        let limit = 0.5 * (quantiser_dn - 1.0 / BINS_PER_DN);
        // Whole turns do not count.
        let turn_per_bin = ((quantiser_dn * BINS_PER_DN).recip() * 2.0_f64.powi(32)).round() as i64 as i32;
        let [tooth, limit] = [tooth, limit].map(|dn| (dn * BINS_PER_DN) as f32);
        let [number, sum] = cosines_beyond(&self.bins, &self.times, turn_per_bin, tooth, limit);
        let repeats = self.frames.max(1.0);
        (number / repeats, sum / repeats)
    }

    /// C and N C², 0 where C is not positive.
    fn score(&self, quantiser_dn: f64) -> (f64, f64) {
        let (number, sum) = self.cosines(quantiser_dn);
        if sum > 0.0 { (sum / number, sum * sum / number) } else { (0.0, 0.0) }
    }

    pub(super) fn scan(&self, smallest_dn: f64, step_dn: f64) -> Scan {
        let step = 0.15 / self.reach_dn;
        let (low, high) = (1.0 / MAX_QUANTISER_DN, 1.0 / smallest_dn.max(self.core_dn / 30.0));
        let trials = ((high - low).max(0.0) / step).ceil() as usize + 1;
        let frequency = |index: usize| low + step * index as f64;
        let scores: Vec<(f64, f64)> = (0..trials).map(|index| self.score(1.0 / frequency(index))).collect();
        let score = scores.iter().map(|score| score.1).fold(0.0, f64::max);
        // The fundamental is the largest quantiser whose comb is as sharp as the rounding lets it be and scores nearly as the best one: its
        // harmonics (q/2, q/3, …) may score higher.
        let finest_dn = if self.sparse(step_dn) { 4.0 * step_dn } else { 0.0 };
        let sharp = |index: usize| {
            let quantiser_dn = 1.0 / frequency(index);
            quantiser_dn > finest_dn && scores[index].0 > 0.6 * blurred(quantiser_dn, step_dn).max(0.15)
        };
        let best = (0..trials).filter(|index| sharp(*index)).map(|index| scores[index].1).fold(0.0, f64::max);
        // 16: a chance of e^−16, small for all trials of all coefficients.
        let first = (0..trials).find(|index| best > 16.0 && sharp(*index) && scores[*index].1 > 0.6 * best);
        let quantiser_dn = first.map(|first| {
            // It may lie on the slope of the peak, which is wide where only ±q are populated.
            let range = (first..trials).take_while(|index| frequency(*index) < 1.5 * frequency(first));
            let peak = range.max_by(|a, b| scores[*a].1.total_cmp(&scores[*b].1)).unwrap_or(first);
            let fine = (-30..=30).map(|part| 1.0 / (frequency(peak) + step * f64::from(part) / 30.0).max(0.5 * low));
            let scored = fine.map(|quantiser_dn| (quantiser_dn, self.score(quantiser_dn).1));
            scored.fold((1.0 / frequency(peak), 0.0), |a, b| if b.1 > a.1 { b } else { a }).0
        });
        Scan { quantiser_dn, score, trials: trials as f64 }
    }

    /// Most values are 0. Then the rounding of the counts is no noise: it is the same in every block that holds the same one coefficient, so
    /// that it displaces the teeth and makes combs of its own below 4 steps.
    fn sparse(&self, step_dn: f64) -> bool {
        self.core_dn < 0.5 * step_dn
    }

    pub(super) fn comb(&self, scan: &Scan, trials: f64, step_dn: f64) -> Option<CoefficientComb> {
        let quantiser_dn = scan.quantiser_dn?;
        let (mut squares, mut residuals, mut number) = (0.0, 0.0, 0.0);
        let mut teeth = [0.0; 4];
        for &(value, times) in &self.values {
            let tooth = (value / quantiser_dn).round();
            if tooth != 0.0 {
                squares += times * tooth * tooth;
                residuals += times * (value - tooth * quantiser_dn).powi(2);
                number += times;
            }
            if let Some(sum) = teeth.get_mut(tooth.abs() as usize) {
                *sum += times;
            }
        }
        // A harmonic of a quantiser beyond the histogram: only every second or third tooth is populated.
        if teeth[1] < 0.5 * teeth[2].max(teeth[3]) {
            return None;
        }
        // A line through 0: values = quantiser · tooth.
        let by_chance_dn = if squares > 0.0 { (residuals / number / squares).sqrt() } else { 0.0 };
        let by_rounding_dn = if self.sparse(step_dn) { 0.15 * quantiser_dn } else { 0.0 };
        let quantiser_error_dn = by_chance_dn.hypot(by_rounding_dn);
        let p_value = trials * (-scan.score).exp();
        let (row, column) = (self.index / BLOCK, self.index % BLOCK);
        (p_value < TOLD).then_some(CoefficientComb { row, column, quantiser_dn, quantiser_error_dn, p_value })
    }
}

/// The scale of the standard's table that fits all coefficients best, and its p-value with all trials.
pub(super) fn table(coefficients: &[Coefficient], smallest_dn: f64, step_dn: f64) -> (f64, f64) {
    let score = |scale: f64| {
        let (mut sum, mut norm) = (0.0, 0.0);
        for coefficient in coefficients {
            let quantiser_dn = scale * TABLE[coefficient.index];
            if (smallest_dn.max(coefficient.core_dn / 8.0)..=MAX_QUANTISER_DN).contains(&quantiser_dn) {
                let weight = blurred(quantiser_dn, step_dn);
                let (number, cosine) = coefficient.cosines(quantiser_dn);
                sum += weight * cosine;
                norm += weight * weight * number;
            }
        }
        if sum > 0.0 { sum * sum / norm } else { 0.0 }
    };
    // From where the coarsest entry is visible to where the finest is at the end of the histogram.
    let (low, ratio) = (smallest_dn / 121.0, 1.004_f64);
    let trials = ((MAX_QUANTISER_DN / 10.0 / low).ln() / ratio.ln()).ceil().max(1.0) as usize;
    let scores: Vec<f64> = parallel::map_numbers(trials, |index| score(low * ratio.powf(index as f64)));
    let best = scores.iter().copied().fold(0.0, f64::max);
    let mut peak = scores.iter().rposition(|score| *score >= 0.8 * best).unwrap_or(0);
    while peak > 0 && scores[peak - 1] > scores[peak] {
        peak -= 1;
    }
    let fine = (-10..=10).map(|part| low * ratio.powf(peak as f64 + f64::from(part) / 10.0));
    let (scale, _) = fine.map(|scale| (scale, score(scale))).fold((low, -1.0), |a, b| if b.1 > a.1 { b } else { a });
    (scale, (trials as f64 * (-best).exp()).min(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cosines_are_those_of_the_library() {
        let values: Vec<(f64, f64)> = (-1003..1004).map(|k| (0.125 * f64::from(k), f64::from(1 + k * k % 7))).collect();
        for quantiser in [0.53, 1.7, 6.25, 40.0] {
            let limit = 0.5 * (quantiser - 1.0 / BINS_PER_DN);
            let plain = values.iter().filter(|(value, _)| value.abs() >= limit).fold([0.0, 0.0], |[number, sum], (value, times)| {
                [number + times, sum + times * (std::f64::consts::TAU * value / quantiser).cos()]
            });
            let coefficient = Coefficient::new(9, values.clone(), [0.0, 1.0], 1.0).unwrap();
            let (number, sum) = coefficient.cosines(quantiser);
            assert!(number == plain[0] && (sum - plain[1]).abs() < 1e-5 * number, "{quantiser}: {number} {sum} for {plain:?}");
        }
    }
}

//! What the converter did to the counts: their step, clipped ends, missing codes and unequal code widths (DNL), all from one histogram.
//!
//! The counts of all frames go into one histogram n_k of whole counts. All sums are sums of integers, so that the order of merging never
//! matters.
//!
//! - **Step**: the greatest common divisor of the differences between populated codes. The lowest and the highest code do not vote: a clip
//!   level need not lie on the grid of the others (12 bits × 16 clipped to 65535). A step of 2^b is b lost bits.
//! - **Clipped ends**: the count at the last code, against a quadratic of ln n through the codes next to it, or against the mean density of
//!   the codes before it where these are sparse (an exact bound on the binomial tail, Chernoff 1952).
//! - **Code widths**: `code_widths`.
//!
//! Limits. Noise below about 1.3 steps, or fewer than 9 codes of 20 counts, leave the widths untold. Poisson counts need independent
//! draws: where a fixed pattern is much wider than the noise from frame to frame, and that noise below a step, the same counts come back
//! in every frame, and φ must say so; where frames of different pointings tell the pattern, the widths are then left untold. Electrons in
//! whole numbers with less than 0.5 e of read noise make a true comb in the histogram; it is reported as unequal widths.

use super::code_widths::{CodeWidths, MissingCodes, dnl, local_fit, missing, widths};
use crate::statistics::significance::normal_cdf;
use serde::{Deserialize, Serialize};

const LOWEST_DN: i32 = -4096;
const CODES: usize = 65_536 + 4096;
const DIFFERENCES: usize = 4096;
/// Narrowest noise, in steps, whose rounded histogram is smooth enough (measured: below it the mixture can imitate the widths).
const MIN_SIGMA_STEPS: f64 = 1.2;
/// Fewer differences do not tell the noise of a frame.
const MIN_DIFFERENCES: u64 = 1000;

/// Histogram of whole counts from −4096 to 65535 DN, over all frames. Its size does not grow.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CodeHistogram {
    counts: Vec<u64>,
    /// Absolute differences of neighbouring pixels, DN: they tell the noise where the sky is not level.
    differences: Vec<u64>,
    /// Those of the frame with the least noise.
    quietest: Option<Vec<u64>>,
    not_whole: u64,
    outside: u64,
}

/// What the histogram of counts says about the converter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct CodeStatistics {
    /// Whole counts in the histogram.
    pub pixels: u64,
    /// Counts that are not whole. One is enough to leave everything below untold: such counts were computed, not converted.
    pub not_whole: u64,
    /// Counts below −4096 or above 65535 DN, left out.
    pub outside: u64,
    /// Lowest populated code, DN.
    pub lowest_dn: Option<i32>,
    /// Highest populated code, DN.
    pub highest_dn: Option<i32>,
    /// Step of the codes, DN. `None` where too few codes are populated to tell.
    pub step_dn: Option<u32>,
    /// The codes are this count modulo the step, DN.
    pub offset_dn: Option<u32>,
    /// log2 of the step, where the step is a power of two: low bits that never change.
    pub lost_bits: Option<u32>,
    /// Noise of a pixel from the differences of neighbours, without the rounding, DN.
    pub noise_dn: Option<f64>,
    /// Pile at the lowest code. `None` where the codes are too few to tell.
    pub black: Option<EndPile>,
    /// Pile at the highest code.
    pub white: Option<EndPile>,
    /// Codes without counts amid populated ones.
    pub missing: Option<MissingCodes>,
    /// Differential nonlinearity. `None` where it cannot be told.
    pub dnl: Option<CodeWidths>,
}

/// More counts at the last code than its neighbours lead to expect: clipping.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct EndPile {
    /// The last code, DN.
    pub code_dn: i32,
    /// Share of all counts at this code.
    pub share: f64,
    /// Share of all counts above the expectation at this code; 0 where there are fewer.
    pub excess_share: f64,
    /// Probability of as large a pile without clipping. An upper bound.
    pub p_value: f64,
}

impl Default for CodeHistogram {
    fn default() -> Self {
        Self { counts: vec![0; CODES], differences: vec![0; DIFFERENCES], quietest: None, not_whole: 0, outside: 0 }
    }
}

impl CodeHistogram {
    /// An empty histogram.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds the usable pixels of a frame. Counts that are no number are left out.
    pub fn add_frame(&mut self, pixels_dn: &[f32], usable: impl Fn(usize) -> bool) {
        self.add_frame_by(1, pixels_dn, usable);
    }

    /// The same, neighbours being so many columns apart: in a colour mosaic those of one colour are two apart.
    pub(super) fn add_frame_by(&mut self, apart: usize, pixels_dn: &[f32], usable: impl Fn(usize) -> bool) {
        let mut before = vec![None; apart];
        let mut own = vec![0_u64; DIFFERENCES];
        for (index, &value_dn) in pixels_dn.iter().enumerate() {
            let code = if usable(index) { self.add(value_dn) } else { None };
            if let (Some(left), Some(right)) = (std::mem::replace(&mut before[index % apart], code), code)
                && let Some(number) = own.get_mut(usize::abs_diff(left, right))
            {
                *number += 1;
            }
        }
        self.differences.iter_mut().zip(&own).for_each(|(all, own)| *all += own);
        self.take_quieter(own);
    }

    /// Keeps the differences of the frame with less noise.
    fn take_quieter(&mut self, own: Vec<u64>) {
        if own.iter().sum::<u64>() < MIN_DIFFERENCES {
            return;
        }
        let noise = |differences: &[u64]| noise_steps(differences, 1).unwrap_or(f64::INFINITY);
        let is_quieter = self.quietest.as_ref().is_none_or(|known| noise(&own).total_cmp(&noise(known)).then(own.cmp(known)).is_lt());
        if is_quieter {
            self.quietest = Some(own);
        }
    }

    fn add(&mut self, value_dn: f32) -> Option<usize> {
        if !value_dn.is_finite() {
            return None;
        }
        let whole = value_dn as i32;
        if whole as f32 != value_dn && value_dn.abs() < 8_388_608.0 {
            self.not_whole += 1;
            return None;
        }
        let index = usize::try_from(i64::from(whole) - i64::from(LOWEST_DN)).ok().filter(|index| *index < CODES);
        match index {
            Some(index) => self.counts[index] += 1,
            None => self.outside += 1,
        }
        index
    }

    /// Adds the counts of another histogram.
    pub fn merge(&mut self, other: &Self) {
        for (mine, theirs) in self.counts.iter_mut().zip(&other.counts) {
            *mine += theirs;
        }
        for (mine, theirs) in self.differences.iter_mut().zip(&other.differences) {
            *mine += theirs;
        }
        if let Some(own) = &other.quietest {
            self.take_quieter(own.clone());
        }
        self.not_whole += other.not_whole;
        self.outside += other.outside;
    }

    /// What the histogram says. `over_dispersion` is the variance of a count over its Poisson value: 1 for independent pixels.
    #[must_use]
    pub fn statistics(&self, over_dispersion: f64) -> CodeStatistics {
        let populated: Vec<usize> = (0..CODES).filter(|index| self.counts[*index] > 0).collect();
        let dn = |index: &usize| LOWEST_DN.saturating_add_unsigned(*index as u32);
        let mut result = CodeStatistics {
            pixels: self.counts.iter().sum(),
            not_whole: self.not_whole,
            outside: self.outside,
            lowest_dn: populated.first().map(dn),
            highest_dn: populated.last().map(dn),
            step_dn: None,
            offset_dn: None,
            lost_bits: None,
            noise_dn: None,
            black: None,
            white: None,
            missing: None,
            dnl: None,
        };
        let (Some(step), 0) = (step_of(&populated), self.not_whole) else { return result };
        let offset = (populated[1] + step - LOWEST_DN.unsigned_abs() as usize % step) % step;
        result.step_dn = Some(step as u32);
        result.offset_dn = Some(offset as u32);
        result.lost_bits = step.is_power_of_two().then(|| step.ilog2());
        // The ends go to the next place outside of the others, wherever they lie between two codes of the grid.
        let (first, second, last) = (populated[0], populated[1], populated[populated.len() - 1]);
        let shift = (second - first).div_ceil(step);
        let places = shift + (last - second).div_ceil(step) + 1;
        let mut counts = vec![0.0; places];
        counts[0] = self.counts[first] as f64;
        for index in &populated[1..] {
            counts[shift + (index - second).div_ceil(step)] += self.counts[*index] as f64;
        }
        result.black = end_pile(&counts, 8, dn(&first), over_dispersion);
        let reversed: Vec<f64> = counts.iter().rev().copied().collect();
        result.white = end_pile(&reversed, 4096, dn(&last), over_dispersion);
        let sigma = noise_steps(&self.differences, step);
        result.noise_dn = sigma.map(|sigma| sigma * step as f64);
        // Frames of a darker sky have less noise: the histogram of all is as smooth as theirs is.
        let narrowest = self.quietest.as_ref().and_then(|own| noise_steps(own, step)).or(sigma);
        if let Some(sigma) = sigma.zip(narrowest).map(|(all, least)| all.min(least)).filter(|sigma| *sigma >= MIN_SIGMA_STEPS) {
            let widths = widths(&counts, sigma, over_dispersion);
            result.missing = missing(&widths, |place| dn(&(second + place * step - shift * step)));
            result.dnl = dnl(&widths, sigma, over_dispersion, step as f64);
        }
        result
    }
}

impl CodeStatistics {
    /// Of noise of which the pixels keep this share (of its variance) from frame to frame: what is left has to be as wide as codes need it.
    pub(super) fn beside_pattern(self, share: f64) -> Self {
        let is_wide = |noise_dn: f64, step_dn: u32| noise_dn * (1.0 - share).max(0.0).sqrt() >= MIN_SIGMA_STEPS * f64::from(step_dn);
        if self.noise_dn.zip(self.step_dn).is_none_or(|(noise_dn, step_dn)| is_wide(noise_dn, step_dn)) {
            return self;
        }
        Self { missing: None, dnl: None, ..self }
    }
}

/// Noise in steps from the lower three tenths of the differences of neighbours: stars and edges only have large ones.
fn noise_steps(differences: &[u64], step: usize) -> Option<f64> {
    let total: u64 = differences.iter().sum();
    let mut below = 0;
    for (difference, number) in differences.iter().enumerate() {
        below += number;
        let share = below as f64 / total as f64;
        if share < 0.3 {
            continue;
        }
        let (mut low, mut high) = (0.0, 9.0);
        for _ in 0..50 {
            let middle = f64::midpoint(low, high);
            if 2.0 * normal_cdf(middle) - 1.0 < share { low = middle } else { high = middle }
        }
        let difference_sd = (difference as f64 / step as f64 + 0.5) / high;
        // Two pixels, and the rounding of each.
        return Some((difference_sd * difference_sd / 2.0 - 1.0 / 12.0).max(0.0).sqrt());
    }
    None
}

/// Greatest common divisor of the differences between the inner populated codes; told from 12 codes on, or from 4 neighbouring ones.
fn step_of(populated: &[usize]) -> Option<usize> {
    let inner = populated.get(1..populated.len().checked_sub(1)?)?;
    let step = inner.windows(2).fold(0, |divisor, pair| gcd(divisor, pair[1] - pair[0]));
    let neighbours = inner.windows(4).any(|run| run[3] - run[0] == 3 * step);
    (step > 0 && (step == 1 || inner.len() >= 12 || neighbours)).then_some(step)
}

fn gcd(mut a: usize, mut b: usize) -> usize {
    while b > 0 {
        (a, b) = (b, a % b);
    }
    a
}

/// The pile at the first of these counts. `reach`: how many codes tell the density before it where the codes next to it are sparse.
fn end_pile(counts: &[f64], reach: usize, code_dn: i32, over_dispersion: f64) -> Option<EndPile> {
    let total: f64 = counts.iter().sum();
    if counts.len() < 8 {
        return None;
    }
    let found = counts[0];
    let (expected, p_value) = if counts[1..5].iter().all(|count| *count >= 20.0) {
        if counts[1] > 12.0 * counts[2] {
            return None; // a noise narrower than a code: the pile may be its whole core
        }
        let window = counts.len().min(13);
        let points: Vec<(f64, f64, f64)> = (1..window).map(|place| (place as f64 / 12.0, counts[place], 1.0)).collect();
        let fit = local_fit(&points)?;
        let expected = fit.ln_factor.exp();
        // Two s.d. of the fit in favour of no clip; the shape counts as known to a quarter, because a narrow noise is no parabola.
        let most = expected * (2.0 * (fit.leverage + 0.0625).sqrt()).exp();
        (expected, poisson_bound((found - 1.0) / over_dispersion, most / over_dispersion))
    } else {
        let width = reach.min(counts.len() / 4);
        let before: f64 = counts[1..=width].iter().sum();
        // At the black end a lone code is a dead pixel, not a clipped noise.
        let lone = reach < 64 && before < 8.0;
        // The last populated code has at least one count: that one is no evidence.
        let (pile, trials) = ((found - 1.0) / over_dispersion, (found - 1.0 + before) / over_dispersion);
        let p_value = if found < 5.0 || lone { 1.0 } else { binomial_bound(pile, trials, 1.0 / (width as f64 + 1.0)) };
        (before / width as f64, p_value)
    };
    Some(EndPile { code_dn, share: found / total, excess_share: ((found - expected) / total).max(0.0), p_value })
}

/// Chernoff's bound on the probability of at least `found` of a Poisson variable.
fn poisson_bound(found: f64, mean: f64) -> f64 {
    if found > mean { (found - mean - found * (found / mean).ln()).exp() } else { 1.0 }
}

/// Chernoff's bound on the probability of at least `successes` of `trials`.
fn binomial_bound(successes: f64, trials: f64, probability: f64) -> f64 {
    let share = successes / trials;
    if share <= probability {
        return 1.0;
    }
    let rest = if share < 1.0 { (1.0 - share) * ((1.0 - share) / (1.0 - probability)).ln() } else { 0.0 };
    (-trials * (share * (share / probability).ln() + rest)).exp()
}

#[cfg(test)]
#[path = "codes_tests.rs"]
mod tests;

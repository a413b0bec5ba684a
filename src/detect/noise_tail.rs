//! Tail of the noise after the matched filter: how far it reaches beyond that of a normal distribution.
//!
//! Counts clipped at black, or a few photons in a pixel, are far from normal, and so is a sum over the few pixels of a star.
//! The tail of the sum follows from the pixels' own distribution by the saddle-point approximation of Lugannani & Rice 1980
//! (Adv. Appl. Prob. 12, 475) in Barndorff-Nielsen's form r* = r + ln(v/r)/r (1986, Biometrika 73, 307).

/// Bins of the pixels' histogram, and its range in σ.
const BINS: usize = 512;
const LOWEST: f64 = -8.0;
const HIGHEST: f64 = 16.0;
/// Table of the pixel's cumulant function: steps and their size.
const STEPS: usize = 160;
const STEP: f64 = 0.05;
/// The brightest pixels up to this share are left out: hot ones, which have a test of their own, and stars too faint to be masked.
const OUTLYING: f64 = 0.003;
/// Noise further from normal than this raises the threshold no further: it is faint stars then, or structure.
const MAX_RATIO: f64 = 2.5;

/// Cumulant generating function of a pixel's noise, with two derivatives, tabulated for arguments from 0 on.
pub(super) struct Tail {
    table: Vec<[f64; 3]>,
    variance: f64,
}

impl Tail {
    /// From pixels, in units of the noise that was estimated for them; `None` of too few.
    pub(super) fn of(pixels: impl Iterator<Item = f32>) -> Option<Self> {
        Self::without(pixels, OUTLYING)
    }

    /// The same without this share of the brightest.
    pub(super) fn without(pixels: impl Iterator<Item = f32>, outlying: f64) -> Option<Self> {
        let mut histogram = vec![0.0_f64; BINS];
        let width = (HIGHEST - LOWEST) / BINS as f64;
        for v in pixels.map(f64::from).filter(|v| *v >= LOWEST && *v < HIGHEST) {
            histogram[((v - LOWEST) / width) as usize] += 1.0;
        }
        let all: f64 = histogram.iter().sum();
        if all < 500.0 {
            return None;
        }
        let mut rare = 0.0;
        for count in histogram.iter_mut().rev() {
            rare += *count;
            if rare > outlying * all {
                break;
            }
            *count = 0.0;
        }
        let total: f64 = histogram.iter().sum();
        let value = |bin: usize| LOWEST + (bin as f64 + 0.5) * width;
        let mean = histogram.iter().enumerate().map(|(i, n)| n * value(i)).sum::<f64>() / total;
        let filled: Vec<(f64, f64)> =
            histogram.iter().enumerate().filter(|(_, n)| **n > 0.0).map(|(i, n)| (value(i) - mean, n / total)).collect();
        let table: Vec<[f64; 3]> = (0..=STEPS)
            .map(|k| {
                let s = k as f64 * STEP;
                let mut m = [0.0; 3];
                for &(v, share) in &filled {
                    let e = share * (s * v).exp();
                    for (m, term) in m.iter_mut().zip([e, e * v, e * v * v]) {
                        *m += term;
                    }
                }
                let slope = m[1] / m[0];
                [m[0].ln(), slope, m[2] / m[0] - slope * slope]
            })
            .collect();
        let variance = table[0][2];
        (variance > 0.0).then_some(Self { table, variance })
    }

    fn at(&self, s: f64) -> [f64; 3] {
        let position = (s / STEP).clamp(0.0, STEPS as f64);
        let low = (position as usize).min(STEPS - 1);
        let share = position - low as f64;
        std::array::from_fn(|k| self.table[low][k] + share * (self.table[low + 1][k] - self.table[low][k]))
    }

    /// Scatter of the filtered noise, were its pixels independent.
    pub(super) fn scatter(&self) -> f64 {
        self.variance.sqrt()
    }

    /// What the filter (weights whose squares sum to at most 1; the rest is taken as normal) exceeds as rarely as a standard
    /// normal number exceeds `normal`.
    pub(super) fn equivalent(&self, weights: &[f64], normal: f64) -> f64 {
        let rest = (1.0 - weights.iter().map(|w| w * w).sum::<f64>()).max(0.0) * self.variance;
        // sum's cumulants at t: its mean under tilting is the level, r* the normal number as rare
        let level = |t: f64| {
            let mut k = [0.5 * rest * t * t, rest * t, rest];
            for w in weights {
                let p = self.at(w * t);
                k[0] += p[0];
                k[1] += w * p[1];
                k[2] += w * w * p[2];
            }
            let r = (2.0 * (t * k[1] - k[0])).max(1e-12).sqrt();
            let v = t * k[2].max(1e-12).sqrt();
            (k[1], r + (v / r).ln() / r)
        };
        let (mut low, mut high) = (0.05, 40.0);
        for _ in 0..40 {
            let middle = f64::midpoint(low, high);
            if level(middle).1 < normal { low = middle } else { high = middle }
        }
        level(high).0.min(MAX_RATIO * normal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal, Poisson};

    #[test]
    fn normal_noise_stays_what_it_is() {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(1);
        let normal = Normal::new(0.0_f32, 1.0).unwrap();
        let tail = Tail::of((0..400_000).map(|_| normal.sample(&mut rng))).unwrap();
        let weights = [0.2; 25];
        for u in [3.0, 4.7] {
            // a little less, for the outlying pixels left out
            let ratio = tail.equivalent(&weights, u) / u;
            assert!((0.96..1.02).contains(&ratio), "{ratio}");
        }
    }

    #[test]
    fn sums_of_poisson_counts_have_the_tail_that_poisson_says() {
        // 25 pixels of mean 0.2, equal weights: the sum is Poisson of mean 5; P(sum ≥ 16) = 6.9e-5, a normal 3.81
        let mut rng = rand_pcg::Pcg64::seed_from_u64(2);
        let poisson = Poisson::new(0.2_f64).unwrap();
        let sigma = 0.2_f64.sqrt();
        let tail = Tail::of((0..400_000).map(|_| ((poisson.sample(&mut rng) - 0.2) / sigma) as f32)).unwrap();
        let level = tail.equivalent(&[0.2; 25], 3.81);
        let expected = (15.5 - 5.0) / 5.0_f64.sqrt();
        assert!((0.93..1.02).contains(&(level / expected)), "{level} for {expected}, {} if it were normal", 3.81);
    }
}

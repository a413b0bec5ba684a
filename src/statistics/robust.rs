//! Robust location and scale: estimates that a few bright stars or wrong points cannot move.

/// Standard deviation of a normal distribution over its median absolute deviation: 1/Φ⁻¹(3/4).
pub const SIGMA_PER_MAD: f64 = 1.482_602_218_505_602;

/// The median; `None` of nothing. The mean of the two middle values where their number is even. Needs finite values.
///
/// ```
/// use boresight::statistics::median;
///
/// assert_eq!(median(&[3.0, 1.0, 2.0]), Some(2.0));
/// assert_eq!(median(&[4.0, 1.0, 2.0, 3.0]), Some(2.5));
/// assert_eq!(median(&[]), None);
/// ```
#[must_use]
pub fn median(values: &[f64]) -> Option<f64> {
    median_in_place(&mut values.to_vec())
}

/// The median, reordering the values given.
pub fn median_in_place(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    let even = values.len().is_multiple_of(2);
    let (below, &mut upper, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    if even {
        let lower = below.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        return Some(f64::midpoint(lower, upper));
    }
    Some(upper)
}

/// Standard deviation from the median absolute deviation about the median, for normal errors; `None` of nothing.
#[must_use]
pub fn mad_sigma(values: &[f64]) -> Option<f64> {
    median_and_mad_sigma(&mut values.to_vec()).map(|(_, sigma)| sigma)
}

/// The median and [`mad_sigma`], overwriting the values given.
pub(crate) fn median_and_mad_sigma(values: &mut [f64]) -> Option<(f64, f64)> {
    let centre = median_in_place(values)?;
    for v in &mut *values {
        *v = (*v - centre).abs();
    }
    median_in_place(values).map(|mad| (centre, mad * SIGMA_PER_MAD))
}

/// Location and scale of the bulk of a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clipped {
    /// Mean of what was kept.
    pub mean: f64,
    /// Standard deviation of the uncut (normal) distribution, from what was kept.
    pub sigma: f64,
    /// How many were kept.
    pub kept: usize,
}

/// Width of the cut, in standard deviations.
const CUT: f64 = 3.0;
/// Standard deviation of a normal distribution cut at ±[`CUT`] (its own σ = 1): √(1 − 2cφ(c)/(2Φ(c) − 1)).
const SIGMA_OF_CUT: f64 = 0.986_578;

/// Mean and standard deviation after cutting at ±3σ until nothing changes, started from median and MAD of at most 257 of the
/// values (evenly picked). The cut never gets narrower than ±`least`: counts that are nearly all equal keep their neighbours
/// one step away, so their small scatter is seen. `None` of nothing. Needs finite values.
#[must_use]
pub fn clipped(values: &[f32], least: f64) -> Option<Clipped> {
    let step = values.len().div_ceil(257).max(1);
    // an odd step does not fall in with patterns of even period
    let mut sample: Vec<f64> = values.iter().step_by(step | 1).map(|&v| f64::from(v)).collect();
    let mut mean = median_in_place(&mut sample)?;
    for v in &mut sample {
        *v = (*v - mean).abs();
    }
    let mut sigma = median_in_place(&mut sample)? * SIGMA_PER_MAD;
    let mut kept = 0;
    for _ in 0..12 {
        let half = (CUT * sigma).max(least);
        let (low, high) = ((mean - half) as f32, (mean + half) as f32);
        let origin = mean as f32;
        let (mut count, mut sum, mut square) = (0_usize, 0.0_f64, 0.0_f64);
        for block in values.chunks(64) {
            let (mut n, mut s, mut q) = (0_u32, 0.0_f32, 0.0_f32);
            for &v in block {
                let inside = v >= low && v <= high;
                let d = if inside { v - origin } else { 0.0 };
                n += u32::from(inside);
                s += d;
                q += d * d;
            }
            count += n as usize;
            sum += f64::from(s);
            square += f64::from(q);
        }
        if count == 0 {
            break;
        }
        let shift = sum / count as f64;
        let scatter = (square / count as f64 - shift * shift).max(0.0).sqrt();
        let wide = half > CUT * sigma; // then next to nothing was cut off and the scatter needs no correction
        let new_sigma = if wide { scatter } else { scatter / SIGMA_OF_CUT };
        mean = f64::from(origin) + shift;
        let settled = kept == count;
        (sigma, kept) = (new_sigma, count);
        if settled {
            break;
        }
    }
    Some(Clipped { mean, sigma, kept })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    #[test]
    fn medians() {
        assert_eq!(median(&[]), None);
        assert_eq!(median(&[3.0]), Some(3.0));
        assert_eq!(median(&[9.0, 1.0, 3.0]), Some(3.0));
        assert_eq!(median(&[9.0, 1.0, 3.0, 4.0]), Some(3.5));
        assert_eq!(mad_sigma(&[1.0, 1.0, 1.0, 50.0]), Some(0.0));
    }

    #[test]
    fn clipping_finds_the_bulk_under_outliers() {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(1);
        let normal = Normal::new(100.0_f32, 5.0).unwrap();
        let mut values: Vec<f32> = (0..20_000).map(|_| normal.sample(&mut rng)).collect();
        for v in values.iter_mut().step_by(25) {
            *v += 300.0;
        }
        let c = clipped(&values, 0.0).unwrap();
        assert!((c.mean - 100.0).abs() < 0.15, "{c:?}");
        assert!((c.sigma / 5.0 - 1.0).abs() < 0.02, "{c:?}");
        assert!((mad_sigma(&values.iter().map(|&v| f64::from(v)).collect::<Vec<_>>()).unwrap() / 5.0 - 1.0).abs() < 0.08);
    }

    #[test]
    fn clipping_sees_the_scatter_of_nearly_constant_counts() {
        let values: Vec<f32> = (0..1000).map(|i| if i % 20 == 0 { 1.0 } else { 0.0 }).collect();
        let c = clipped(&values, 1.5).unwrap();
        assert!((c.mean - 0.05).abs() < 1e-6 && (c.sigma - (0.05_f64 * 0.95).sqrt()).abs() < 1e-6, "{c:?}");
        let same = clipped(&[7.0; 50], 1.5).unwrap();
        assert_eq!((same.mean, same.sigma, same.kept), (7.0, 0.0, 50));
        assert_eq!(clipped(&[], 1.0), None);
    }
}

//! Map of the residual field over the frame: a Gaussian process whose prior is the sum of a curl-free and a divergence-free field.
//!
//! With k(d) = exp(−d²/2ℓ²), d the vector between two places: covariance of ∇φ: (1 − d·dᵀ/ℓ²)·k, of a turned gradient:
//! ((1 − d²/ℓ²)·1 + d·dᵀ/ℓ²)·k, both of variance one for each component. ℓ and the two variances are those of greatest evidence. The map is
//! never a parameter of the camera: a discrepancy that is free to take any form would take the parameters with it.
//! Source: Kennedy and O'Hagan, J. R. Stat. Soc. B 63, 425 (2001); Brynjarsdóttir and O'Hagan, Inverse Problems 30, 114007 (2014);
//! Narcowich and Ward, Math. Comput. 63, 661 (1994), for the kernels.

use nalgebra::{DMatrix, DVector};

use super::diagnosis::RemainderMap;

/// A map is told where it gains so much log-evidence over none.
const TOLD_FROM: f64 = 12.0;
/// Cells along the longer side in which star images are averaged.
const CELLS: usize = 11;
/// Points of the map along each side.
const GRID: usize = 13;
/// Length scales tried, in units of the frame's longer side.
const LENGTHS: [f64; 5] = [0.06, 0.1, 0.17, 0.3, 0.5];
/// Standard deviations tried, in units of the rms of the cells' means.
const SIZES: [f64; 4] = [0.3, 0.6, 1.0, 1.6];
/// Shares of variance free of curl that are tried.
const SHARES: [f64; 3] = [0.0, 0.5, 1.0];

/// One star image's remainder: place, residual and standard error per axis, px.
pub(super) type Left = ([f64; 2], [f64; 2], f64);

impl RemainderMap {
    /// Whether it is more than noise: by its evidence, and by what it gains on frames that it was not made of.
    #[must_use]
    pub fn is_told(&self) -> bool {
        !self.points.is_empty() && self.log_evidence_gain > TOLD_FROM && self.held_out_delta_chi2 > 0.0
    }
}

struct Cells {
    place: Vec<[f64; 2]>,
    mean: DVector<f64>,
    variance: Vec<f64>,
}

fn cells<'a>(left: impl Iterator<Item = &'a Left>, size: [f64; 2]) -> Cells {
    let side = size[0].max(size[1]) / CELLS as f64;
    let mut sums: std::collections::BTreeMap<(usize, usize), [f64; 5]> = std::collections::BTreeMap::new();
    for ([x, y], [dx, dy], sigma) in left {
        let key = (((y + 0.5) / side).max(0.0) as usize, ((x + 0.5) / side).max(0.0) as usize);
        let weight = 1.0 / (sigma * sigma);
        let sum = sums.entry(key).or_default();
        for (slot, value) in sum.iter_mut().zip([1.0, *x, *y, *dx, *dy]) {
            *slot += weight * value;
        }
    }
    let of = |sum: &[f64; 5]| [sum[1] / sum[0], sum[2] / sum[0]];
    let place = sums.values().map(of).collect::<Vec<_>>();
    let mean = DVector::from_iterator(2 * sums.len(), sums.values().flat_map(|sum| [sum[3] / sum[0], sum[4] / sum[0]]));
    Cells { place, mean, variance: sums.values().map(|sum| 1.0 / sum[0]).collect() }
}

/// Covariance of the field's components at two places, for unit variance.
fn kernel(a: [f64; 2], b: [f64; 2], length: f64, curl_free: f64) -> [[f64; 2]; 2] {
    let d = [(a[0] - b[0]) / length, (a[1] - b[1]) / length];
    let square = d[0] * d[0] + d[1] * d[1];
    let k = (-0.5 * square).exp();
    let entry = |i: usize, j: usize| {
        let one = f64::from(u8::from(i == j));
        let outer = d[i] * d[j];
        k * (curl_free * (one - outer) + (1.0 - curl_free) * ((1.0 - square) * one + outer))
    };
    [[entry(0, 0), entry(0, 1)], [entry(1, 0), entry(1, 1)]]
}

fn covariance(cells: &Cells, length: f64, variance: f64, curl_free: f64) -> DMatrix<f64> {
    let n = cells.place.len();
    let mut matrix = DMatrix::zeros(2 * n, 2 * n);
    for i in 0..n {
        for j in 0..n {
            let k = kernel(cells.place[i], cells.place[j], length, curl_free);
            for (a, row) in k.iter().enumerate() {
                for (b, value) in row.iter().enumerate() {
                    matrix[(2 * i + a, 2 * j + b)] = variance * value;
                }
            }
        }
        for axis in 0..2 {
            matrix[(2 * i + axis, 2 * i + axis)] += cells.variance[i];
        }
    }
    matrix
}

/// The field of greatest evidence.
struct Field {
    cells: Cells,
    /// Gain of log-evidence over no field at all.
    gain: f64,
    length: f64,
    variance: f64,
    /// Share free of curl.
    share: f64,
    solved: DVector<f64>,
    factor: nalgebra::Cholesky<f64, nalgebra::Dyn>,
}

/// Evidence, length, variance, share free of curl, the solution and its factor.
type Best = (f64, f64, f64, f64, DVector<f64>, nalgebra::Cholesky<f64, nalgebra::Dyn>);

/// Fewer cells make no map.
const MIN_CELLS: usize = 6;

/// The field of some residuals.
fn field<'a>(left: impl Iterator<Item = &'a Left>, size: [f64; 2]) -> Option<Field> {
    let cells = cells(left, size);
    let n = cells.place.len();
    if n < MIN_CELLS {
        return None;
    }
    let rms = (cells.mean.norm_squared() / (2 * n) as f64).sqrt().max(1e-9);
    let nothing: f64 = (0..n)
        .map(|k| {
            let square = cells.mean[2 * k].powi(2) + cells.mean[2 * k + 1].powi(2);
            -0.5 * square / cells.variance[k] - cells.variance[k].ln()
        })
        .sum();
    let mut best: Option<Best> = None;
    for length in LENGTHS.map(|length| length * size[0].max(size[1])) {
        for share in SHARES {
            for variance in SIZES.map(|s| (s * rms).powi(2)) {
                let Some(factor) = covariance(&cells, length, variance, share).cholesky() else { continue };
                let solved = factor.solve(&cells.mean);
                let log_det: f64 = 2.0 * factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
                let evidence = -0.5 * cells.mean.dot(&solved) - 0.5 * log_det;
                if best.as_ref().is_none_or(|best| evidence > best.0) {
                    best = Some((evidence, length, variance, share, solved, factor));
                }
            }
        }
    }
    let (evidence, length, variance, share, solved, factor) = best?;
    Some(Field { cells, gain: evidence - nothing, length, variance, share, solved, factor })
}

impl Field {
    /// The field at a place and its standard error per axis.
    fn at(&self, place: [f64; 2]) -> ([f64; 2], f64) {
        let mut cross = DMatrix::zeros(2 * self.cells.place.len(), 2);
        for (j, own) in self.cells.place.iter().enumerate() {
            let k = kernel(*own, place, self.length, self.share);
            for a in 0..2 {
                for b in 0..2 {
                    cross[(2 * j + a, b)] = self.variance * k[a][b];
                }
            }
        }
        let value = cross.tr_mul(&self.solved);
        let reduced = self.factor.solve(&cross);
        let known = f64::midpoint(cross.column(0).dot(&reduced.column(0)), cross.column(1).dot(&reduced.column(1)));
        ([value[0], value[1]], (self.variance - known).max(0.0).sqrt())
    }
}

/// The map of what is left: residuals, each with the part of the recording that it belongs to. The map is made of all of them; its proof is
/// the fall of χ² of every part with the map of the others.
pub(super) fn map(left: &[(Left, usize)], size: [f64; 2]) -> RemainderMap {
    let Some(whole) = field(left.iter().map(|(left, _)| left), size) else { return RemainderMap::default() };
    let mut points = Vec::new();
    let mut square = 0.0;
    for row in 0..GRID {
        for column in 0..GRID {
            let share = |k: usize, length: f64| k as f64 / (GRID - 1) as f64 * (length - 1.0);
            let place = [share(column, size[0]), share(row, size[1])];
            let ([dx, dy], sigma) = whole.at(place);
            square += dx * dx + dy * dy;
            points.push([place[0], place[1], dx, dy, sigma]);
        }
    }
    let parts: std::collections::BTreeSet<usize> = left.iter().map(|(_, part)| *part).collect();
    let mut held_out_delta_chi2 = 0.0;
    for part in &parts {
        let Some(others) = field(left.iter().filter(|(_, own)| own != part).map(|(left, _)| left), size) else { continue };
        for ((place, [dx, dy], sigma), _) in left.iter().filter(|(_, own)| own == part) {
            let ([mx, my], _) = others.at(*place);
            held_out_delta_chi2 += (dx * dx + dy * dy - (dx - mx).powi(2) - (dy - my).powi(2)) / (sigma * sigma);
        }
    }
    RemainderMap {
        length_px: whole.length,
        rms_px: (square / points.len() as f64).sqrt(),
        curl_free_share: whole.share,
        log_evidence_gain: whole.gain,
        held_out_delta_chi2,
        points,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A field free of curl is recovered where stars are, and its kind recognised; noise alone gains nothing.
    #[test]
    fn a_bump_is_mapped_and_noise_is_not() {
        let mut state = 7_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        let mut field = |amplitude: f64| -> Vec<Left> {
            (0..1500)
                .map(|_| {
                    let place = [1000.0 * (random() + 0.5), 1000.0 * (random() + 0.5)];
                    let d = [(place[0] - 400.0) / 150.0, (place[1] - 600.0) / 150.0];
                    let size = amplitude * (-0.5 * (d[0] * d[0] + d[1] * d[1])).exp();
                    let (a, b) = (random() + random() + random(), random() + random() + random());
                    (place, [size * d[0] + 0.1 * a, size * d[1] + 0.1 * b], 0.05)
                })
                .collect()
        };
        let mut parts = |amplitude: f64| field(amplitude).into_iter().enumerate().map(|(k, left)| (left, k % 4)).collect::<Vec<_>>();
        let (seen, noise) = (parts(0.2), parts(0.0));
        let found = map(&seen, [1000.0, 1000.0]);
        assert!(found.is_told() && found.log_evidence_gain > 50.0, "{}", found.log_evidence_gain);
        assert!(found.held_out_delta_chi2 > 100.0, "{}", found.held_out_delta_chi2);
        assert!(found.curl_free_share > 0.9, "{}", found.curl_free_share);
        let nothing = map(&noise, [1000.0, 1000.0]);
        assert!(!nothing.is_told() && nothing.log_evidence_gain < 6.0, "{}", nothing.log_evidence_gain);
    }
}

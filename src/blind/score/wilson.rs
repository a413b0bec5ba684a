//! Shares with their 95 % intervals.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// So many of so many.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Rate {
    /// So many
    pub hits: usize,
    /// of so many.
    pub of: usize,
}

/// Normal quantile of a two-sided 95 % interval.
const Z: f64 = 1.959_964;

impl Rate {
    /// Counts.
    pub fn count(&mut self, hit: bool) {
        self.of += 1;
        self.hits += usize::from(hit);
    }

    /// Of a sequence.
    pub fn of(hits: impl IntoIterator<Item = bool>) -> Self {
        let mut rate = Self::default();
        for hit in hits {
            rate.count(hit);
        }
        rate
    }

    /// The share; `None` of none.
    #[must_use]
    pub fn share(&self) -> Option<f64> {
        (self.of > 0).then(|| self.hits as f64 / self.of as f64)
    }

    /// Wilson's interval (E. B. Wilson, JASA 22, 209, 1927).
    #[must_use]
    pub fn interval(&self) -> [f64; 2] {
        if self.of == 0 {
            return [0.0, 1.0];
        }
        let (n, p) = (self.of as f64, self.hits as f64 / self.of as f64);
        let z2 = Z * Z / n;
        let middle = (p + z2 / 2.0) / (1.0 + z2);
        let half = Z / (1.0 + z2) * (p * (1.0 - p) / n + z2 / (4.0 * n)).sqrt();
        let low = if self.hits == 0 { 0.0 } else { middle - half };
        let high = if self.hits == self.of { 1.0 } else { middle + half };
        [low, high]
    }
}

impl std::fmt::Display for Rate {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Some(share) = self.share() else {
            return write!(f, "–");
        };
        let [low, high] = self.interval();
        write!(f, "{:.1} % ({}/{}; {:.1}–{:.1})", 100.0 * share, self.hits, self.of, 100.0 * low, 100.0 * high)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The roots of (p̂ − p)² = z²·p·(1 − p)/n, which the interval is by definition.
    #[test]
    fn the_bounds_are_the_roots() {
        for (hits, of) in [(7, 20), (1, 1000), (300, 301)] {
            let rate = Rate { hits, of };
            for p in rate.interval() {
                let deviation = rate.share().unwrap() - p;
                assert!((deviation * deviation - Z * Z * p * (1.0 - p) / of as f64).abs() < 1e-12);
            }
        }
        for (hits, of, low, high) in [(0, 1000, 0.0, 0.003_826_8), (7, 20, 0.181_192, 0.567_146), (50, 50, 0.928_652, 1.0)] {
            let [a, b] = Rate { hits, of }.interval();
            assert!((a - low).abs() < 2e-6 && (b - high).abs() < 2e-6, "{hits}/{of}: {a} {b}");
        }
    }
}

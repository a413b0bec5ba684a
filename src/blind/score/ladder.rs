//! Detection against strength: the curve, and where it crosses one half.

use crate::statistics::order::ascending;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::wilson::Rate;

/// A rung of the ladder.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Rung {
    /// Strength over what is just seen (5σ).
    pub multiple: f64,
    /// Something was found to be missing.
    pub detected: Rate,
    /// The first name was the right one.
    pub named: Rate,
}

/// The ladder of an effect.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Ladder {
    /// The effect's name in tables.
    pub label: String,
    /// Whether the program that answered knows the effect.
    pub known: bool,
    /// Rungs, the weakest first.
    pub rungs: Vec<Rung>,
    /// Strength of half detection over what is just seen.
    pub half: Option<f64>,
}

impl Ladder {
    /// Adds an answer.
    pub(super) fn add(&mut self, multiple: f64, detected: bool, named: bool) {
        let near = self.rungs.iter().position(|rung| (rung.multiple / multiple - 1.0).abs() < 0.05);
        let place = near.unwrap_or_else(|| {
            self.rungs.push(Rung { multiple, detected: Rate::default(), named: Rate::default() });
            self.rungs.len() - 1
        });
        self.rungs[place].detected.count(detected);
        self.rungs[place].named.count(named);
    }

    pub(super) fn finish(&mut self) {
        ascending(&mut self.rungs, |a| a.multiple);
        self.half = half(&self.rungs);
    }
}

/// Where the share detected crosses one half, linear in the logarithm of the strength. The shares are first made to grow with strength
/// (neighbours that do not are pooled), so that chance does not make several crossings. `None` where they do not cross.
fn half(rungs: &[Rung]) -> Option<f64> {
    // Pool adjacent violators: (sum of logarithms × images, hits, of).
    let mut pools: Vec<(f64, f64, f64)> = Vec::new();
    for rung in rungs.iter().filter(|rung| rung.detected.of > 0) {
        let (hits, of) = (rung.detected.hits as f64, rung.detected.of as f64);
        pools.push((rung.multiple.ln() * of, hits, of));
        while let [.., a, b] = pools.as_slice() {
            if a.1 / a.2 <= b.1 / b.2 {
                break;
            }
            let pooled = (a.0 + b.0, a.1 + b.1, a.2 + b.2);
            pools.truncate(pools.len() - 2);
            pools.push(pooled);
        }
    }
    let points: Vec<(f64, f64)> = pools.iter().map(|(logarithms, hits, of)| (logarithms / of, hits / of)).collect();
    points.windows(2).find(|pair| pair[0].1 < 0.5 && pair[1].1 >= 0.5).map(|pair| {
        let [(x0, y0), (x1, y1)] = [pair[0], pair[1]];
        (x0 + (0.5 - y0) / (y1 - y0) * (x1 - x0)).exp()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ladder(counts: &[(f64, usize)]) -> Ladder {
        let mut ladder = Ladder::default();
        for (multiple, hits) in counts {
            for answer in 0..20 {
                ladder.add(*multiple, answer < *hits, false);
            }
        }
        ladder.finish();
        ladder
    }

    #[test]
    fn the_crossing_is_interpolated_in_the_logarithm() {
        let half = ladder(&[(2.0, 15), (1.0, 5), (0.5, 0), (4.0, 20)]).half.unwrap();
        assert!((half - 2.0_f64.sqrt()).abs() < 1e-12, "{half}");
        // A step back by chance is pooled: 8 of 20 and 6 of 20 count as 14 of 40 between them.
        let pooled = ladder(&[(0.5, 0), (1.0, 8), (2.0, 6), (4.0, 20)]).half.unwrap();
        let expected = (2.0_f64.sqrt().ln() + 0.15 / 0.65 * (4.0 / 2.0_f64.sqrt()).ln()).exp();
        assert!((pooled - expected).abs() < 1e-12, "{pooled} {expected}");
        assert_eq!(ladder(&[(1.0, 2), (2.0, 5)]).half, None);
    }
}

//! What is measured of the images beside places, as rows of one linear problem.
//!
//! A row is one number with its standard error: a star's magnitude less the catalogue's, a second moment, the variance of a frame's rows. Rows of
//! one kind share their nuisance parameters and their noise. A kind may have an error that all rows of a star share (the catalogue's magnitude, a
//! variable star), or all of a frame (seeing, shake): with a group's variance s², W the sum of its rows' 1/σ²
//!
//! ```text
//! V = D + s²·1·1ᵀ,   V^(−½) = (1 − θ·u·uᵀ)·D^(−½),   u ∝ D^(−½)·1,   θ = 1 − (1 + s²·W)^(−½)
//! ```
//! so that whitening takes a share θ of each group's weighted mean out. Source: Searle, Casella and McCulloch, Variance Components (1992), 3.

use std::ops::Range;

use crate::diagnose::channels::Channel;

/// What all rows of a group share an error for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::diagnose) enum Shared {
    /// Nothing.
    No,
    /// Rows of one star.
    Star,
    /// Rows of one frame.
    Frame,
}

/// In the place of a frame's number: the row is no measurement, and says what is known beforehand, in all frames.
pub(in crate::diagnose) const KNOWN_BEFOREHAND: usize = usize::MAX;

/// One number of an image, a frame or the recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::diagnose) struct Row {
    /// The number, less what the model has.
    pub(in crate::diagnose) value: f64,
    /// Its standard error as measured.
    pub(in crate::diagnose) sigma: f64,
    /// Place of the frame among the frames.
    pub(in crate::diagnose) frame: usize,
    /// Number of the star; rows that are of no star have one of their own.
    pub(in crate::diagnose) star: usize,
    /// The control point that it is of, where it is of one.
    pub(in crate::diagnose) point: Option<usize>,
}

/// Rows of one kind.
#[derive(Clone, Debug)]
pub(in crate::diagnose) struct Kind {
    pub(in crate::diagnose) channel: Channel,
    /// As people call it.
    pub(in crate::diagnose) name: &'static str,
    pub(in crate::diagnose) rows: Vec<Row>,
    /// Nuisance parameters of each frame: columns over the rows.
    pub(in crate::diagnose) per_frame: Vec<Vec<f64>>,
    /// Nuisance parameters of all.
    pub(in crate::diagnose) common: Vec<Vec<f64>>,
    pub(in crate::diagnose) shared: Shared,
    /// Whether the scatter may be larger than stated; else the errors are taken at their word.
    pub(in crate::diagnose) is_scaled: bool,
}

/// The noise of a kind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::diagnose) struct KindNoise {
    /// Stated variances times this,
    pub(in crate::diagnose) factor: f64,
    /// plus this, in the row's unit squared.
    pub(in crate::diagnose) floor: f64,
    /// Variance that the rows of a group share.
    pub(in crate::diagnose) shared: f64,
}

impl KindNoise {
    pub(in crate::diagnose) const STATED: Self = Self { factor: 1.0, floor: 0.0, shared: 0.0 };

    pub(in crate::diagnose) fn variance(&self, row: &Row) -> f64 {
        self.factor * row.sigma * row.sigma + self.floor
    }
}

impl Kind {
    /// The group that a row shares its error with.
    pub(in crate::diagnose) fn group(&self, row: &Row) -> usize {
        match self.shared {
            Shared::Frame => row.frame,
            Shared::Star | Shared::No => row.star,
        }
    }

    /// Groups of rows that share an error: their rows' numbers.
    pub(in crate::diagnose) fn groups(&self) -> Vec<Vec<usize>> {
        let mut all: std::collections::BTreeMap<usize, Vec<usize>> = std::collections::BTreeMap::new();
        for (index, row) in self.rows.iter().enumerate() {
            all.entry(self.group(row)).or_default().push(index);
        }
        all.into_values().collect()
    }

    /// What whitens columns on the rows taken, under a noise. Rows that are not taken have no part in the means of groups.
    pub(in crate::diagnose) fn whitener(&self, noise: &KindNoise, take: &[bool]) -> Whitener {
        let scale: Vec<f64> = self.rows.iter().map(|row| noise.variance(row).sqrt().recip()).collect();
        let groups = if self.shared == Shared::No || noise.shared <= 0.0 {
            Vec::new()
        } else {
            let weight = |group: &Vec<usize>| group.iter().map(|index| scale[*index] * scale[*index]).sum::<f64>();
            self.groups()
                .into_iter()
                .map(|group| group.into_iter().filter(|index| take[*index]).collect::<Vec<usize>>())
                .filter(|group| !group.is_empty())
                .map(|group| {
                    let total = weight(&group);
                    (1.0 - (1.0 + noise.shared * total).sqrt().recip(), total, group)
                })
                .collect()
        };
        Whitener { scale, groups }
    }
}

/// V^(−½) of the rows of a kind.
#[derive(Clone, Debug)]
pub(in crate::diagnose) struct Whitener {
    scale: Vec<f64>,
    /// Share θ, sum of weights and rows of every group.
    groups: Vec<(f64, f64, Vec<usize>)>,
}

impl Whitener {
    /// The means of the groups that share an error, in units of their errors, of a whitened column.
    pub(in crate::diagnose) fn means(&self, white: &[f64]) -> nalgebra::DVector<f64> {
        let of_group = |(_, total, group): &(f64, f64, Vec<usize>)| {
            group.iter().map(|index| self.scale[*index] * white[*index]).sum::<f64>() / total.sqrt()
        };
        nalgebra::DVector::from_iterator(self.groups.len(), self.groups.iter().map(of_group))
    }

    pub(in crate::diagnose) fn apply(&self, column: &[f64]) -> Vec<f64> {
        let mut white: Vec<f64> = column.iter().zip(&self.scale).map(|(value, scale)| value * scale).collect();
        for (share, total, group) in &self.groups {
            let along: f64 = group.iter().map(|index| self.scale[*index] * white[*index]).sum::<f64>() * share / total;
            for index in group {
                white[*index] -= along * self.scale[*index];
            }
        }
        white
    }
}

/// What may have been left out, as columns over the rows of all kinds.
#[derive(Clone, Debug)]
pub(in crate::diagnose) struct Question {
    /// The effect.
    pub(in crate::diagnose) id: &'static str,
    /// Its parameters.
    pub(in crate::diagnose) parameters: Vec<Parameter>,
    /// The covariates that it follows, in words.
    pub(in crate::diagnose) follows: &'static str,
    /// One column a parameter.
    pub(in crate::diagnose) columns: Vec<Vec<f64>>,
    /// Of effects that leave the same trace the one with the lower rank is the more usual.
    pub(in crate::diagnose) rank: u8,
    /// A size below (or above) zero is not this effect.
    pub(in crate::diagnose) sign: Option<f64>,
    /// Some columns of another question of the same effect: fewer are seen sooner, and told where they say as much.
    pub(in crate::diagnose) is_part: bool,
    /// The effects of which its columns are products.
    pub(in crate::diagnose) products_of: &'static [&'static str],
}

impl Question {
    /// Some of its columns, and the covariate that they follow.
    pub(super) fn part(&self, which: &[usize], follows: &'static str) -> Self {
        let parameters = which.iter().map(|k| self.parameters[*k]).collect();
        Self { parameters, columns: which.iter().map(|k| self.columns[*k].clone()).collect(), follows, is_part: true, ..self.clone() }
    }
}

/// A parameter of a question.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::diagnose) struct Parameter {
    pub(in crate::diagnose) name: &'static str,
    pub(in crate::diagnose) unit: &'static str,
    pub(in crate::diagnose) shown: Shown,
}

/// What is told of the size of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::diagnose) enum Shown {
    /// The size.
    Same,
    /// Its root, with its sign.
    Root,
    /// The root of a variance that so many draws show: their own scatter belongs to its error.
    RootOfDraws(u32),
    /// The same of draws that all frames share: the noise of a frame meets the same draws in every pair.
    RootOfSharedDraws(u32),
    /// One more: a ratio.
    OneMore,
    /// Nothing: the parameter has no column, and this value.
    Given(u8),
}

impl Shown {
    /// Whether the root of the size is told.
    pub(super) const fn is_root(self) -> bool {
        matches!(self, Self::Root | Self::RootOfDraws(_) | Self::RootOfSharedDraws(_))
    }
}

impl Parameter {
    /// Value and standard error as they are told.
    pub(in crate::diagnose) fn told(&self, [size, sigma]: [f64; 2]) -> [f64; 2] {
        // A variance R of n draws scatters by √(2/n)·R, however well each is measured. Of F frames with the variances w of their own noise, the mean of all
        // pairs' covariances has the variance 2R²/n + 4Rw/(nF) + 2w²/(nF²), which is a square; the last part is what is stated.
        let of_draws = |draws: u32| size.abs() * (2.0 / f64::from(draws.max(1))).sqrt();
        let sigma = match self.shown {
            Shown::RootOfDraws(draws) => sigma.hypot(of_draws(draws)),
            Shown::RootOfSharedDraws(draws) => sigma + of_draws(draws),
            _ => sigma,
        };
        match self.shown {
            Shown::Same => [size, sigma],
            Shown::Given(value) => [f64::from(value), 0.0],
            Shown::OneMore => [1.0 + size, sigma],
            // Of nothing the root of what could be there.
            _ if size.abs() < sigma => [0.0, sigma.sqrt()],
            Shown::Root | Shown::RootOfDraws(_) | Shown::RootOfSharedDraws(_) => {
                [size.abs().sqrt().copysign(size), 0.5 * sigma / size.abs().sqrt()]
            }
        }
    }
}

/// All rows with all questions.
#[derive(Clone, Debug, Default)]
pub(in crate::diagnose) struct Rows {
    pub(in crate::diagnose) kinds: Vec<Kind>,
    pub(in crate::diagnose) questions: Vec<Question>,
    /// Frames.
    pub(in crate::diagnose) frames: usize,
}

impl Rows {
    /// Rows of all kinds.
    pub(in crate::diagnose) fn len(&self) -> usize {
        self.kinds.iter().map(|kind| kind.rows.len()).sum()
    }

    /// The rows of every kind among all.
    pub(in crate::diagnose) fn ranges(&self) -> Vec<Range<usize>> {
        let mut start = 0;
        self.kinds
            .iter()
            .map(|kind| {
                let range = start..start + kind.rows.len();
                start = range.end;
                range
            })
            .collect()
    }

    /// All rows, kind by kind.
    pub(in crate::diagnose) fn rows(&self) -> impl Iterator<Item = &Row> {
        self.kinds.iter().flat_map(|kind| &kind.rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::Distribution;

    /// What is told of the σ of offsets that all frames share scatters as its error says, whichever is larger, they or the noise of the frames.
    #[test]
    fn the_error_of_a_scatter_holds_the_number_of_draws() {
        const LINES: u32 = 200;
        const FRAMES: usize = 8;
        const TRIALS: u32 = 400;
        for offset in [0.8, 5.0] {
            let parameter = Parameter { name: "row_sigma_dn", unit: "DN", shown: Shown::RootOfSharedDraws(LINES) };
            let pull = |seed: u32| {
                let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(u64::from(seed));
                let mut normal = || -> f64 { rand_distr::StandardNormal.sample(&mut rng) };
                let offsets: Vec<f64> = (0..LINES).map(|_| offset * normal()).collect();
                let frames: Vec<Vec<f64>> = (0..FRAMES).map(|_| offsets.iter().map(|own| own + normal()).collect()).collect();
                let (mut sum, mut square, mut pairs) = (0.0, 0.0, 0.0);
                for (k, one) in frames.iter().enumerate() {
                    for other in &frames[..k] {
                        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / f64::from(LINES);
                        sum += product(one, other);
                        square += product(one, one) * product(other, other) / f64::from(LINES);
                        pairs += 1.0;
                    }
                }
                let [value, sigma] = parameter.told([sum / pairs, square.sqrt() / pairs]);
                ((value - offset) / sigma).powi(2)
            };
            let square = (0..TRIALS).map(pull).sum::<f64>() / f64::from(TRIALS);
            // Of 400 squares the mean has an error of 0.07.
            assert!((square - 1.0).abs() < 0.25, "{offset}: {square}");
        }
    }

    /// Whitened columns have the products that the inverse of the covariance gives.
    #[test]
    fn whitening_is_a_root_of_the_inverse_covariance() {
        let row = |sigma: f64, star: usize| Row { value: 0.0, sigma, frame: 0, star, point: None };
        let rows = vec![row(1.0, 0), row(0.5, 0), row(2.0, 1), row(1.5, 0), row(0.7, 1)];
        let n = rows.len();
        let kind = Kind {
            channel: Channel::Flux,
            name: "magnitude",
            rows,
            per_frame: Vec::new(),
            common: Vec::new(),
            shared: Shared::Star,
            is_scaled: true,
        };
        let noise = KindNoise { factor: 1.3, floor: 0.2, shared: 0.8 };
        let covariance = nalgebra::DMatrix::from_fn(n, n, |i, j| {
            let own = if i == j { noise.variance(&kind.rows[i]) } else { 0.0 };
            own + if kind.rows[i].star == kind.rows[j].star { noise.shared } else { 0.0 }
        });
        let inverse = covariance.try_inverse().unwrap();
        let whitener = kind.whitener(&noise, &[true; 5]);
        let unit = |i: usize| (0..n).map(|k| if k == i { 1.0 } else { 0.0 }).collect::<Vec<f64>>();
        for i in 0..n {
            for j in 0..n {
                let product: f64 = whitener.apply(&unit(i)).iter().zip(whitener.apply(&unit(j))).map(|(a, b)| a * b).sum();
                assert!((product - inverse[(i, j)]).abs() < 1e-12, "{i} {j}: {product} for {}", inverse[(i, j)]);
            }
        }
    }
}

//! A covariate, and what its patterns are made of: vector fields over the frame, bins of equal counts.

use crate::calibrate::Column;

/// Bins of equal counts.
pub(super) const BINS: usize = 8;

/// A covariate with its patterns.
#[derive(Clone, Debug)]
pub(in crate::diagnose) struct Covariate {
    /// Its name in files.
    pub(in crate::diagnose) name: String,
    /// Its value for every star image, NaN where it is not known.
    pub(in crate::diagnose) values: Vec<f64>,
    /// The direction in which it displaces, where it has one of its own (toward the zenith).
    pub(in crate::diagnose) direction: Option<Column>,
    /// Patterns of residuals, each a set of columns that are tried together.
    pub(in crate::diagnose) patterns: Vec<Vec<Column>>,
    /// For a covariate that belongs to the frames: its first patterns once more, the frames' numbers apart from the fields that they multiply.
    pub(in crate::diagnose) by_frame: Vec<Separated>,
}

/// A vector field over the frame, of (ξ, η).
pub(super) type Carrier = fn([f64; 2]) -> [f64; 2];

/// A shift along x, and along y.
pub(super) const SHIFT: [Carrier; 2] = [|_| [1.0, 0.0], |_| [0.0, 1.0]];

/// The frame's geometry for patterns.
pub(super) struct Fields {
    /// ξ, η: from the middle of the frame, in half its width.
    pub(super) place: Vec<[f64; 2]>,
}

impl Fields {
    /// A vector field at every star image, of its number and place.
    pub(super) fn each(&self, field: impl Fn(usize, [f64; 2]) -> [f64; 2]) -> Column {
        self.place.iter().enumerate().map(|(k, place)| field(k, *place)).collect()
    }
}

/// A pattern whose columns are fields over the frame, each times a number of the frame.
#[derive(Clone, Debug)]
pub(in crate::diagnose) struct Separated {
    /// The fields.
    pub(in crate::diagnose) carriers: Vec<Column>,
    /// Of each column: which field, and the number of every frame.
    pub(in crate::diagnose) columns: Vec<(usize, Vec<f64>)>,
}

impl Separated {
    pub(super) fn new(fields: &Fields, carriers: &[Carrier], columns: Vec<(usize, Vec<f64>)>) -> Self {
        Self { carriers: carriers.iter().map(|carrier| fields.each(|_, place| carrier(place))).collect(), columns }
    }

    /// The columns of the pattern, each image's frame being `place`.
    pub(super) fn pattern(&self, place: &[usize]) -> Vec<Column> {
        let of = |(carrier, number): &(usize, Vec<f64>)| {
            self.carriers[*carrier].iter().zip(place).map(|(field, place)| field.map(|value| value * number[*place])).collect()
        };
        self.columns.iter().map(of).collect()
    }
}

/// Bins of equal counts: for each image its bin.
pub(super) fn bins(values: &[f64], count: usize) -> Vec<Option<usize>> {
    let mut known: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    known.sort_by(f64::total_cmp);
    if known.is_empty() {
        return vec![None; values.len()];
    }
    let mut edges: Vec<f64> = (1..count).map(|k| known[k * known.len() / count]).collect();
    edges.dedup();
    let of = |value: &f64| value.is_finite().then(|| edges.partition_point(|edge| edge <= value));
    values.iter().map(of).collect()
}

/// Whether values are known of more than half of the images, and differ.
pub(super) fn varies(values: &[f64]) -> bool {
    let known: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    let (least, most) = known.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
    known.len() * 2 > values.len() && most - least > 1e-9 * most.abs().max(least.abs())
}

//! What the sky has of its own in every field, so that it is not taken for what the camera does to all of them.
//!
//! Each field's cells are an even sky, smooth structure of its own (Legendre polynomials to the fourth degree: the Milky Way, clouds, a gradient),
//! roughness (stars that were not found) and the noise of the pixels. How large structure and roughness are is told by how the fields differ from
//! one another, whatever they share: what stays the same, goes with the light of the sky or with the exposure is taken out over the fields first.
//!
//! ```text
//! V = diag(σ² + floor) + Σ s_m²·p_m·p_mᵀ + level²·1·1ᵀ        level: without bound, so that each field's own is free
//! ```
//! From few fields a variance is known badly; it is made larger by the square of the ratio of the quantiles of Student's t and of the normal
//! distribution, at the probability at which an effect is found. The sky knows no axes of the detector, so polynomials of one degree share their
//! variance and its degrees of freedom, unless one of them is beyond the others' (a twilight always on the same side).

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::sky_light::{Cell, SkyFrame, SkyLight};
use crate::statistics::significance::neg_ln_chi2_sf;

/// Fields that tell the camera's share from the sky's, at least.
const MIN_FIELDS: usize = 4;
/// Degrees of the polynomials by the cells that a field has.
const DEGREES: [(usize, usize); 3] = [(40, 4), (18, 2), (0, 1)];
/// Normal deviate of the probability at which an effect is found.
const FOUND_SIGMAS: f64 = 3.9;
/// A structure that chance makes as large more often than this (as −ln p) has no part of its own, unless all together are beyond
const OWN_SURPRISE: f64 = 2.3;
/// this.
const ALL_SURPRISE: f64 = 4.6;
/// A field that chance makes as much rougher than the others less often than this (as −ln) has a roughness of its own.
const OWN_ROUGHNESS: f64 = 6.0;
/// Stated variances of cells may be off by this factor.
const ERRORS_OFF: f64 = 1.5;
/// A model of which what stays from field to field leaves a smaller part of its square is no other one.
const MIN_LEFT: f64 = 1e-6;
/// The level of a field is known to so many times the typical error of a cell.
const FREE_LEVEL: f64 = 1e3;

/// The noise of the sky.
#[derive(Clone, Debug)]
pub(super) struct SkyNoise {
    degree: usize,
    /// Variance of every polynomial from field to field.
    structure: Vec<f64>,
    /// Variance of a cell beyond its own, field by field.
    floors: Vec<f64>,
    /// −ln of the probability that even skies look as uneven, each in its way.
    pub(super) surprise: f64,
}

/// Fields that there must be: with sources of light that change from field to field one more.
pub(super) fn least_fields(models: &[Vec<f64>]) -> usize {
    MIN_FIELDS + models.len().min(1)
}

/// Products of Legendre polynomials of a place, without the constant, to a total degree; of mean square one over the frame.
pub(super) fn polynomials(at: [f64; 2], edge: [f64; 2], degree: usize) -> Vec<f64> {
    let along = |axis: usize| -> Vec<f64> {
        let x = at[axis] / edge[axis];
        let mut values = vec![1.0, x];
        for n in 2..=degree {
            let next = ((2 * n - 1) as f64 * x * values[n - 1] - (n - 1) as f64 * values[n - 2]) / n as f64;
            values.push(next);
        }
        values.iter().zip(0..).map(|(value, n)| value * f64::from(2 * n + 1).sqrt()).collect()
    };
    let (x, y) = (along(0), along(1));
    (1..=degree).flat_map(|total| (0..=total).map(move |j| (total - j, j))).map(|(i, j)| x[i] * y[j]).collect()
}

/// The laws by which what the camera does may change from field to field: not at all, as the exposure, as the light (of shares of the light: as the
/// exposure over it, as one over it); as orthonormal columns over the fields.
pub(super) fn laws(light: &SkyLight) -> Vec<Vec<f64>> {
    let fields = light.frames.len();
    let most = match fields {
        0..8 => 1,
        8..12 => 2,
        _ => 3,
    };
    let of = |law: &dyn Fn(&SkyFrame) -> f64| -> Vec<f64> { light.frames.iter().map(law).collect() };
    let whole = |frame: &SkyFrame| if light.is_relative { frame.light_dn } else { 1.0 };
    let by_light = of(&|frame| if light.is_relative { frame.light_dn.recip() } else { frame.light_dn });
    // Seconds and frames are no one unit: where a single exposure is not known all are taken for the same.
    let are_timed = light.frames.iter().all(|frame| frame.exposure_s.is_some());
    let by_exposure = of(&|frame| frame.exposure_s.filter(|_| are_timed).unwrap_or(1.0) / whole(frame));
    let mut basis: Vec<Vec<f64>> = Vec::new();
    for law in [vec![1.0; fields], by_exposure, by_light] {
        let length = |of: &[f64]| of.iter().map(|value| value * value).sum::<f64>().sqrt();
        let mut left = law.clone();
        for known in &basis {
            let along: f64 = left.iter().zip(known).map(|(a, b)| a * b).sum();
            left.iter_mut().zip(known).for_each(|(own, known)| *own -= along * known);
        }
        let norm = length(&left);
        if basis.len() < most && norm > 0.05 * length(&law) {
            basis.push(left.iter().map(|value| value / norm).collect());
        }
    }
    basis
}

/// What some fields' numbers leave beyond the laws, and the degrees of freedom of it.
fn beyond(laws: &[Vec<f64>], numbers: &[(usize, f64)]) -> (Vec<f64>, f64) {
    let columns: Vec<DVector<f64>> =
        laws.iter().map(|law| DVector::from_iterator(numbers.len(), numbers.iter().map(|(k, _)| law[*k]))).collect();
    let mut basis: Vec<DVector<f64>> = Vec::new();
    for mut column in columns {
        let length = column.norm();
        for known in &basis {
            let along = known.dot(&column);
            column.axpy(-along, known, 1.0);
        }
        let left = column.norm();
        if left > 1e-3 * length && left > 0.0 {
            basis.push(column / left);
        }
    }
    let mut rest = DVector::from_iterator(numbers.len(), numbers.iter().map(|(_, value)| *value));
    for known in &basis {
        let along = known.dot(&rest);
        rest.axpy(-along, known, 1.0);
    }
    (rest.iter().copied().collect(), numbers.len().saturating_sub(basis.len()) as f64)
}

/// The variance beside those stated under which squares sum up to their degrees of freedom; zero where they do without.
fn excess(squares: &[(f64, f64)], dof: f64) -> f64 {
    let sum = |more: f64| squares.iter().map(|(square, variance)| square / (variance + more)).sum::<f64>();
    if dof <= 0.0 || sum(0.0) <= dof {
        return 0.0;
    }
    let (mut low, mut high) = (0.0, squares.iter().map(|(square, _)| square).sum::<f64>() / dof);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if sum(middle) > dof { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// Square of the ratio of the quantiles of Student's t and of the normal distribution (Cornish and Fisher's series, as in Abramowitz and Stegun,
/// Handbook of Mathematical Functions, 26.7.5).
fn widening(dof: f64) -> f64 {
    let z = FOUND_SIGMAS;
    let terms = [
        (z.powi(3) + z) / 4.0,
        (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0,
        (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z) / 384.0,
    ];
    let quantile = z + terms.iter().zip(1..).map(|(term, power)| term / dof.powi(power)).sum::<f64>();
    (quantile / z).powi(2)
}

/// Coefficients of a field's polynomials with their variances, and what they leave of its cells.
struct Smooth {
    coefficients: Vec<[f64; 2]>,
    rest: Vec<f64>,
}

fn smooth(cells: &[&Cell], design: &DMatrix<f64>, floor: f64) -> Option<Smooth> {
    let weight = |cell: &Cell| (cell.sigma * cell.sigma + floor).recip();
    let weighted = DMatrix::from_fn(design.nrows(), design.ncols(), |i, j| design[(i, j)] * weight(cells[i]));
    let value = DVector::from_iterator(cells.len(), cells.iter().map(|cell| cell.value));
    let inverse = weighted.tr_mul(design).cholesky()?.inverse();
    let found = &inverse * weighted.tr_mul(&value);
    let rest = (&value - design * &found).iter().copied().collect();
    let coefficients = (1..design.ncols()).map(|m| [found[m], inverse[(m, m)]]).collect();
    Some(Smooth { coefficients, rest })
}

/// A polynomial's coefficients beyond the laws, field by field: squares with their variances.
struct Term {
    squares: Vec<(f64, f64)>,
    dof: f64,
}

impl Term {
    fn new(smooth: &[Smooth], m: usize, laws: &[Vec<f64>]) -> Self {
        let told: Vec<(usize, [f64; 2])> =
            smooth.iter().enumerate().filter_map(|(field, own)| Some((field, *own.coefficients.get(m)?))).collect();
        let numbers: Vec<(usize, f64)> = told.iter().map(|(field, [value, _])| (*field, *value)).collect();
        let (rest, dof) = beyond(laws, &numbers);
        Self { squares: rest.iter().zip(&told).map(|(rest, (_, [_, variance]))| (rest * rest, *variance)).collect(), dof }
    }

    /// χ² where the coefficients scatter by so much variance beside their own.
    fn chi2_beside(&self, more: f64) -> f64 {
        self.squares.iter().map(|(square, variance)| square / (variance + more)).sum()
    }

    /// A variance from field to field that was found with some degrees of freedom, made larger for its own uncertainty.
    fn widened(&self, found: f64, dof: f64) -> f64 {
        let typical = self.squares.iter().map(|(_, variance)| variance).sum::<f64>() / self.squares.len().max(1) as f64;
        ((found + typical) * widening(dof) - typical).max(0.0)
    }
}

/// Of every polynomial the variance from field to field as it tells it alone, and with the others of its degree where it is like them.
fn variances(terms: &[Term], degree: usize, given_back: f64) -> Vec<[f64; 2]> {
    let mut all = Vec::with_capacity(terms.len());
    let mut rest = terms;
    for total in 1..=degree {
        let (same, others) = rest.split_at((total + 1).min(rest.len()));
        rest = others;
        let squares: Vec<(f64, f64)> = same.iter().flat_map(|term| term.squares.iter().copied()).collect();
        let dof = same.iter().map(|term| term.dof).sum();
        let shared = excess(&squares, dof);
        all.extend(same.iter().map(|term| {
            let own = term.widened(excess(&term.squares, term.dof) * given_back, term.dof);
            let is_alike = neg_ln_chi2_sf(term.dof, term.chi2_beside(shared)) < OWN_SURPRISE;
            [own, if is_alike { term.widened(shared * given_back, dof) } else { own }]
        }));
    }
    all
}

impl SkyNoise {
    /// From how the fields differ; nothing where they are too few. `models`: light that is another in every field, but known up to a factor. They are
    /// sized under the noise that is found without them, and so on: what the sky has besides, slopes above all, is then not taken for them.
    pub(super) fn found(light: &SkyLight, models: &[Vec<f64>]) -> Option<Self> {
        const TURNS: usize = 3;
        let fields = light.frames.len();
        if fields < least_fields(models) {
            return None;
        }
        let mut noise = Self::of(light, 1.0)?;
        if models.is_empty() {
            return Some(noise);
        }
        // What the models took of the structure has to be given back.
        let given_back = fields as f64 / (fields - models.len().min(fields - 2)) as f64;
        for _ in 0..TURNS {
            let Some(rest) = without_models(light, models, &noise) else { break };
            noise = Self::of(&rest, given_back)?;
        }
        Some(noise)
    }

    /// From how the fields differ, with the variances of structure so many times as large.
    fn of(light: &SkyLight, given_back: f64) -> Option<Self> {
        let fields = light.frames.len();
        let by_field: Vec<Vec<&Cell>> = (0..fields).map(|field| light.cells.iter().filter(|cell| cell.frame == field).collect()).collect();
        // A field with fewer cells than the others takes no part in what the higher polynomials say.
        let degrees: Vec<usize> = by_field.iter().map(|cells| degree_of(cells.len())).collect::<Option<_>>()?;
        let is_told = |degree: usize| degrees.iter().filter(|own| **own >= degree).count() >= MIN_FIELDS.max(fields.div_ceil(2));
        let degree = DEGREES.iter().map(|(_, degree)| *degree).find(|degree| is_told(*degree))?;
        let design_of = |((cells, frame), own): ((&Vec<&Cell>, &SkyFrame), &usize)| design(cells, frame.edge, degree.min(*own));
        let designs: Vec<DMatrix<f64>> = by_field.iter().zip(&light.frames).zip(&degrees).map(design_of).collect();
        let laws = laws(light);
        let fitted = |floors: &[f64]| -> Option<Vec<Smooth>> {
            by_field.iter().zip(&designs).zip(floors).map(|((cells, design), floor)| smooth(cells, design, *floor)).collect()
        };
        let (floors, rough) = roughness(&by_field, &fitted(&vec![0.0; fields])?, &laws);
        let smooth = fitted(&floors)?;
        let count = smooth.iter().map(|own| own.coefficients.len()).max()?;
        let terms: Vec<Term> = (0..count).map(|m| Term::new(&smooth, m, &laws)).collect();
        let surprises: Vec<f64> = terms.iter().map(|term| neg_ln_chi2_sf(term.dof, term.chi2_beside(0.0))).collect();
        let together = neg_ln_chi2_sf(terms.iter().map(|term| term.dof).sum(), terms.iter().map(|term| term.chi2_beside(0.0)).sum());
        let variances = variances(&terms, degree, given_back);
        let structure: Vec<f64> = variances
            .iter()
            .zip(&surprises)
            .map(|([own, shared], surprise)| match () {
                () if together > ALL_SURPRISE => *shared,
                () if *surprise > OWN_SURPRISE => *own,
                () => 0.0,
            })
            .collect();
        let largest = surprises.iter().copied().fold(0.0, f64::max) - (surprises.len() as f64).ln();
        let surprise = (together.max(largest).max(rough) - 3.0_f64.ln()).max(0.0);
        Some(Self { degree, structure, floors, surprise })
    }

    /// What whitens a field's columns.
    fn root(&self, (cells, floor): (&[&Cell], f64), edge: [f64; 2]) -> Option<Cholesky<f64, Dyn>> {
        let own = design(cells, edge, self.degree);
        let typical = cells.iter().map(|cell| cell.sigma * cell.sigma + floor).sum::<f64>() / cells.len().max(1) as f64;
        let variance = |m: usize| if m == 0 { FREE_LEVEL * FREE_LEVEL * typical } else { self.structure[m - 1] };
        let scaled = DMatrix::from_fn(own.nrows(), own.ncols(), |i, m| own[(i, m)] * variance(m).sqrt());
        let mut covariance = &scaled * scaled.transpose();
        for (i, cell) in cells.iter().enumerate() {
            covariance[(i, i)] += cell.sigma * cell.sigma + floor;
        }
        covariance.cholesky()
    }

    /// The numbers of the cells and some columns whitened: rows of unit variance, as many as cells.
    pub(super) fn whitened(&self, light: &SkyLight, columns: &[Vec<f64>]) -> Option<(Vec<f64>, Vec<Vec<f64>>)> {
        let mut value = vec![0.0; light.cells.len()];
        let mut white = vec![vec![0.0; light.cells.len()]; columns.len()];
        for (field, frame) in light.frames.iter().enumerate() {
            let own = light.of_frame(field);
            let cells: Vec<&Cell> = own.iter().map(|k| &light.cells[*k]).collect();
            let root = self.root((&cells, self.floors[field]), frame.edge)?;
            let apply = |from: &dyn Fn(usize) -> f64, to: &mut Vec<f64>| {
                let mut column = DVector::from_iterator(own.len(), own.iter().map(|k| from(*k)));
                if root.l_dirty().solve_lower_triangular_mut(&mut column) {
                    own.iter().zip(column.iter()).for_each(|(k, value)| to[*k] = *value);
                }
            };
            apply(&|k| light.cells[k].value, &mut value);
            for (column, white) in columns.iter().zip(&mut white) {
                apply(&|k| column[k], white);
            }
        }
        Some((value, white))
    }
}

/// The sky less the models in the sizes that fit it best under some noise, beside what stays from field to field in every cell: by least squares. A model
/// that hardly differs from what stays is not taken off; nothing where none is left.
fn without_models(light: &SkyLight, models: &[Vec<f64>], noise: &SkyNoise) -> Option<SkyLight> {
    let left = beside_what_stays(light, models, noise)?;
    // The first number is the sky's own.
    let kept: Vec<usize> = (1..=models.len()).filter(|m| left.products[(*m, *m)] > MIN_LEFT * left.whole[*m]).collect();
    let normal = DMatrix::from_fn(kept.len(), kept.len(), |i, j| left.products[(kept[i], kept[j])]);
    let sizes = ridged(normal)?.solve(&DVector::from_iterator(kept.len(), kept.iter().map(|m| left.products[(*m, 0)])));
    let mut light = light.clone();
    for (m, size) in kept.iter().zip(sizes.iter()) {
        light.cells.iter_mut().zip(&models[m - 1]).for_each(|(cell, unit)| cell.value -= size * unit);
    }
    (!kept.is_empty()).then_some(light)
}

/// Products of the sky and of models, less what stays from field to field takes of them, and their squares as a whole.
struct Left {
    products: DMatrix<f64>,
    whole: DVector<f64>,
}

/// What the laws of the cells leave of the sky (the first number) and of models.
fn beside_what_stays(light: &SkyLight, models: &[Vec<f64>], noise: &SkyNoise) -> Option<Left> {
    let laws = laws(light);
    let numbers: BTreeSet<usize> = light.cells.iter().map(|cell| cell.number).collect();
    let places: BTreeMap<usize, usize> = numbers.into_iter().zip(0..).collect();
    let (stays, asked) = (places.len() * laws.len(), models.len() + 1);
    let (mut normal, mut right) = (DMatrix::zeros(stays, stays), DMatrix::zeros(stays, asked));
    let mut products = DMatrix::zeros(asked, asked);
    for (field, frame) in light.frames.iter().enumerate() {
        let own = light.of_frame(field);
        let cells: Vec<&Cell> = own.iter().map(|k| &light.cells[*k]).collect();
        let precision = noise.root((&cells, noise.floors[field]), frame.edge)?.inverse();
        let numbers = DMatrix::from_fn(own.len(), asked, |i, j| if j == 0 { cells[i].value } else { models[j - 1][own[i]] });
        let weighted = &precision * &numbers;
        products += numbers.tr_mul(&weighted);
        let place: Vec<usize> = cells.iter().map(|cell| places[&cell.number]).collect();
        for (one, by_one) in laws.iter().map(|law| law[field]).enumerate() {
            for (i, row) in place.iter().map(|place| one * places.len() + place).enumerate() {
                let mut sum = right.row_mut(row);
                sum += weighted.row(i) * by_one;
                for (other, by_other) in laws.iter().map(|law| law[field]).enumerate() {
                    for (j, column) in place.iter().map(|place| other * places.len() + place).enumerate() {
                        normal[(row, column)] += by_one * by_other * precision[(i, j)];
                    }
                }
            }
        }
    }
    let whole = products.diagonal();
    Some(Left { products: products - right.tr_mul(&ridged(normal)?.solve(&right)), whole })
}

/// The root of a matrix with a hair of ridge: models may be alike, and the levels of fields are free.
fn ridged(matrix: DMatrix<f64>) -> Option<Cholesky<f64, Dyn>> {
    const RIDGE: f64 = 1e-9;
    let ridge = matrix.diagonal().map(|own| RIDGE * own + f64::MIN_POSITIVE);
    (matrix + DMatrix::from_diagonal(&ridge)).cholesky()
}

/// Degree of the polynomials that so many cells tell.
fn degree_of(cells: usize) -> Option<usize> {
    DEGREES.iter().find(|(least, _)| cells >= *least).map(|(_, degree)| *degree)
}

/// A constant and the polynomials, over some cells.
fn design(cells: &[&Cell], edge: [f64; 2], degree: usize) -> DMatrix<f64> {
    let rows: Vec<Vec<f64>> = cells.iter().map(|cell| polynomials(cell.at, edge, degree)).collect();
    let width = rows.first().map_or(0, Vec::len);
    DMatrix::from_fn(rows.len(), width + 1, |i, m| if m == 0 { 1.0 } else { rows[i][m - 1] })
}

/// Of every field the variance of its cells beyond the stated one, and −ln of the probability that cells with errors somewhat larger than stated are as
/// rough anywhere. Roughness is what the polynomials leave of the cells, beyond what stays from field to field.
fn roughness(by_field: &[Vec<&Cell>], smooth: &[Smooth], laws: &[Vec<f64>]) -> (Vec<f64>, f64) {
    let mut of_cell: BTreeMap<usize, Vec<(usize, f64, f64)>> = BTreeMap::new();
    for (field, (cells, smooth)) in by_field.iter().zip(smooth).enumerate() {
        // A cell's residual is smaller by what it gave to the polynomials, on average.
        let kept = (1.0 - (smooth.coefficients.len() + 1) as f64 / cells.len() as f64).max(0.1);
        for (cell, rest) in cells.iter().zip(&smooth.rest) {
            of_cell.entry(cell.number).or_default().push((field, *rest / kept.sqrt(), cell.sigma * cell.sigma));
        }
    }
    let mut squares: Vec<Vec<(f64, f64)>> = vec![Vec::new(); by_field.len()];
    let mut dof = vec![0.0; by_field.len()];
    for own in of_cell.into_values() {
        let numbers: Vec<(usize, f64)> = own.iter().map(|(field, rest, _)| (*field, *rest)).collect();
        let (rest, own_dof) = beyond(laws, &numbers);
        for ((field, _, variance), rest) in own.iter().zip(rest).filter(|_| own_dof > 0.0) {
            squares[*field].push((rest * rest, *variance));
            dof[*field] += own_dof / own.len() as f64;
        }
    }
    let chi2: Vec<f64> = squares.iter().map(|own| own.iter().map(|(square, variance)| square / variance).sum()).collect();
    let ratios: Vec<f64> = chi2.iter().zip(&dof).filter(|(_, dof)| **dof > 0.0).map(|(chi2, dof)| chi2 / dof).collect();
    let typical = crate::statistics::median(&ratios).unwrap_or(1.0).max(1.0);
    // A field that is rough by itself (the Moon stands in it, a cluster of stars) has a roughness of its own.
    let is_own = |field: usize| neg_ln_chi2_sf(dof[field], chi2[field] / typical) > OWN_ROUGHNESS;
    let others: Vec<(f64, f64)> = (0..dof.len()).filter(|field| !is_own(*field)).flat_map(|field| squares[field].iter().copied()).collect();
    let common = excess(&others, (0..dof.len()).filter(|field| !is_own(*field)).map(|field| dof[field]).sum());
    let floors = (0..dof.len()).map(|field| if is_own(field) { excess(&squares[field], dof[field]).max(common) } else { common }).collect();
    let largest = (0..dof.len()).map(|field| neg_ln_chi2_sf(dof[field], chi2[field] / ERRORS_OFF)).fold(0.0, f64::max);
    (floors, (largest - (dof.len() as f64).ln()).max(0.0))
}

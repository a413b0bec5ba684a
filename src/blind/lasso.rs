//! LASSO on the same library: what sparse regression would name, and how well it mends. Columns of all displacements that the recording
//! allows, whitened and with attitudes and camera taken out, of length one; the penalty by five-fold cross-validation over frames with the
//! rule of one standard error (L. Breiman et al., Classification and Regression Trees, 1984; R. Tibshirani, JRSS B 58, 267, 1996).

use nalgebra::{DMatrix, DVector};

use super::judge::{Judge, Sums, by_frame};
use crate::calibrate::{BundleSolution, Column};
use crate::effects::{Context, DISPLACEMENTS, Observation, StarState};
use crate::identify::ControlPoints;

/// Folds of the cross-validation.
const FOLDS: usize = 5;
/// Penalties tried, from where nothing enters down to this share of it.
const PENALTIES: usize = 40;
const MIN_PENALTY: f64 = 0.01;
/// Columns of which less is left are not offered.
const MIN_SURVIVAL: f64 = 0.02;
/// Star images with a smaller weight are held to be misidentified.
const MIN_WEIGHT: f64 = 0.5;

/// What LASSO answers.
#[derive(Clone, Debug, PartialEq)]
pub struct Lasso {
    /// Effects that enter.
    pub names: Vec<String>,
    /// χ² per degree of freedom of the frames set aside.
    pub held_out: f64,
}

/// LASSO on control points whose model contains the effects `predicted`; judged on the frames `held_out`.
#[must_use]
pub fn lasso(points: &ControlPoints, known: &[String], held_out: &[usize]) -> Option<Lasso> {
    lasso_before(&Judge::new(points, known, held_out)?, points)
}

/// The same on a recording that is solved already.
pub(super) fn lasso_before(judge: &Judge, points: &ControlPoints) -> Option<Lasso> {
    let joint = &judge.joint;
    let camera = joint.solved_columns();
    let (ids, library) = offered(joint, points);
    let columns: Vec<&Column> = camera.iter().chain(&library).collect();
    let right: Vec<bool> = joint.images().iter().map(|image| image.weight > MIN_WEIGHT).collect();
    let frames = by_frame(joint, &columns, &right);
    let mut train = Sums::zero(columns.len());
    let mut folds: Vec<Sums> = (0..FOLDS).map(|_| Sums::zero(columns.len())).collect();
    for (place, (frame, sums)) in frames.iter().enumerate() {
        if !judge.is_held_out(*frame) {
            train.add(sums, 1.0);
            folds[place % FOLDS].add(sums, 1.0);
        }
    }
    let whole = Problem::new(&train, camera.len())?;
    let largest = whole.largest_penalty();
    let penalties: Vec<f64> = (0..PENALTIES).map(|step| largest * MIN_PENALTY.powf(step as f64 / (PENALTIES - 1) as f64)).collect();
    let mut errors = vec![Vec::new(); PENALTIES];
    for fold in &folds {
        let mut rest = Sums::zero(columns.len());
        rest.add(&train, 1.0);
        rest.add(fold, -1.0);
        let path = Problem::new(&rest, camera.len())?.path(&penalties);
        for (errors, solution) in errors.iter_mut().zip(path) {
            errors.push(fold.chi2_per_dof(&solution));
        }
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let standard_error = |values: &[f64]| {
        let middle = mean(values);
        (values.iter().map(|value| (value - middle).powi(2)).sum::<f64>() / (FOLDS * (FOLDS - 1)) as f64).sqrt()
    };
    let best = errors.iter().min_by(|a, b| mean(a).total_cmp(&mean(b)))?;
    let enough = mean(best) + standard_error(best);
    let chosen = errors.iter().position(|values| mean(values) <= enough)?;
    let solution = whole.path(&penalties[..=chosen]).pop()?;
    let mut names: Vec<String> = Vec::new();
    for (id, value) in ids.iter().zip(solution.iter().skip(camera.len())) {
        if *value != 0.0 && !names.contains(id) {
            names.push(id.clone());
        }
    }
    Some(Lasso { names, held_out: judge.of_solution(&columns, &solution) })
}

/// Columns of everything the recording allows, with the ids that they belong to.
fn offered(joint: &BundleSolution, points: &ControlPoints) -> (Vec<String>, Vec<Column>) {
    let frames = joint.frames();
    let first = frames.first().map_or_else(Observation::default, |(_, observation)| *observation);
    let star = points.points.first().map_or_else(StarState::default, |point| point.star);
    let (mut ids, mut columns) = (Vec::new(), Vec::new());
    for effect in DISPLACEMENTS.iter().filter(|effect| effect.is_hypothesis()) {
        if frames.iter().any(|(_, observation)| effect.unmet_requirement(observation).is_some()) {
            continue;
        }
        let Some(start) = effect.identity(&Context::new(star, first)) else { continue };
        let found = joint.columns_of(effect.id(), &start, &effect.default_free(&first)).unwrap_or_default();
        for column in found.into_iter().filter(|column| column.iter().flatten().all(|value| value.is_finite())) {
            ids.push(effect.id().to_owned());
            columns.push(column);
        }
    }
    (ids, columns)
}

/// The penalised problem: the camera's columns free, the others of length one once it is taken out.
struct Problem {
    free: usize,
    /// Camera's part of the Gram matrix, inverted, times its part with the others.
    follow: DMatrix<f64>,
    alone: DVector<f64>,
    gram: DMatrix<f64>,
    right: DVector<f64>,
    /// What turns a column into one of length one; 0 for those not offered.
    scale: Vec<f64>,
}

impl Problem {
    fn new(sums: &Sums, free: usize) -> Option<Self> {
        let count = sums.gram.nrows();
        let penalised = count - free;
        let mut camera = sums.gram.view((0, 0), (free, free)).into_owned();
        let scales: Vec<f64> = (0..free).map(|k| camera[(k, k)].sqrt().max(f64::MIN_POSITIVE)).collect();
        for i in 0..free {
            for j in 0..free {
                camera[(i, j)] /= scales[i] * scales[j];
            }
            camera[(i, i)] += 1e-12;
        }
        let inverse = camera.cholesky()?.inverse();
        let inverse = DMatrix::from_fn(free, free, |i, j| inverse[(i, j)] / (scales[i] * scales[j]));
        let cross = sums.gram.view((0, free), (free, penalised)).into_owned();
        let follow = &inverse * &cross;
        let alone = &inverse * sums.right.rows(0, free);
        let mut gram = sums.gram.view((free, free), (penalised, penalised)) - cross.transpose() * &follow;
        let mut right = sums.right.rows(free, penalised) - cross.transpose() * &alone;
        let scale: Vec<f64> = (0..penalised)
            .map(|k| {
                let (left, whole) = (gram[(k, k)], sums.gram[(free + k, free + k)]);
                if whole > 0.0 && left > MIN_SURVIVAL * MIN_SURVIVAL * whole { 1.0 / left.sqrt() } else { 0.0 }
            })
            .collect();
        for i in 0..penalised {
            right[i] *= scale[i];
            for j in 0..penalised {
                gram[(i, j)] *= scale[i] * scale[j];
            }
        }
        Some(Self { free, follow, alone, gram, right, scale })
    }

    fn largest_penalty(&self) -> f64 {
        self.right.amax().max(f64::MIN_POSITIVE)
    }

    /// Solutions along falling penalties, by coordinate descent, each from the one before.
    fn path(&self, penalties: &[f64]) -> Vec<DVector<f64>> {
        const SWEEPS: usize = 500;
        let count = self.right.len();
        let mut values = DVector::<f64>::zeros(count);
        penalties
            .iter()
            .map(|penalty| {
                for _ in 0..SWEEPS {
                    let mut largest: f64 = 0.0;
                    for k in (0..count).filter(|k| self.scale[*k] > 0.0) {
                        let pull = self.right[k] - self.gram.column(k).dot(&values) + values[k] * self.gram[(k, k)];
                        let next = pull.signum() * (pull.abs() - penalty).max(0.0) / self.gram[(k, k)];
                        largest = largest.max((next - values[k]).abs());
                        values[k] = next;
                    }
                    if largest < 1e-4 {
                        break;
                    }
                }
                let own = DVector::from_fn(count, |k, _| values[k] * self.scale[k]);
                let camera = &self.alone - &self.follow * &own;
                DVector::from_fn(self.free + count, |k, _| if k < self.free { camera[k] } else { own[k - self.free] })
            })
            .collect()
    }
}

//! One measure for every way of mending a concealed recording: χ² per degree of freedom of the frames set aside, attitudes refitted, under the errors that
//! the generator declared, which are the true ones. Nothing about the noise is learnt from the residuals, so a model that swallows an effect as
//! noise does no better for it. All ways are judged on the same star images.

use nalgebra::{DMatrix, DVector};

use crate::calibrate::{BundleSolution, CalibrateOptions, Column};
use crate::identify::ControlPoints;

/// Ridge on columns of length one, which keeps what cannot be determined from growing.
const RIDGE: f64 = 1e-9;
/// Outliers are clipped beyond this many standard errors.
const CLIP: f64 = 3.5;
/// What identification would reject: star images further off than this many standard errors and this many pixels are not looked at.
const FAR_SIGMA: f64 = 30.0;
const FAR_PX: f64 = 1.0;

/// Sums over the star images of frames, attitudes taken out: of columns and residuals, in standard errors.
pub(super) struct Sums {
    pub(super) gram: DMatrix<f64>,
    pub(super) right: DVector<f64>,
    square: f64,
    degrees: f64,
}

impl Sums {
    pub(super) fn zero(count: usize) -> Self {
        Self { gram: DMatrix::zeros(count, count), right: DVector::zeros(count), square: 0.0, degrees: 0.0 }
    }

    pub(super) fn add(&mut self, other: &Self, sign: f64) {
        self.gram += &other.gram * sign;
        self.right += &other.right * sign;
        self.square += other.square * sign;
        self.degrees += other.degrees * sign;
    }

    /// χ² per degree of freedom with these columns times their coefficients added to the residuals.
    pub(super) fn chi2_per_dof(&self, solution: &DVector<f64>) -> f64 {
        let chi2 = self.square - 2.0 * solution.dot(&self.right) + solution.dot(&(&self.gram * solution));
        chi2 / self.degrees.max(1.0)
    }

    /// The coefficients that make χ² least.
    fn solve(&self) -> Option<DVector<f64>> {
        let scale = self.gram.diagonal().map(|square| if square > 0.0 { 1.0 / square.sqrt() } else { 0.0 });
        let mut scaled = DMatrix::from_fn(scale.len(), scale.len(), |i, j| self.gram[(i, j)] * scale[i] * scale[j]);
        for k in 0..scale.len() {
            scaled[(k, k)] += if scale[k] > 0.0 { RIDGE } else { 1.0 };
        }
        let solution = scaled.cholesky()?.solve(&self.right.component_mul(&scale));
        Some(solution.component_mul(&scale))
    }
}

/// A recording whose camera is solved, and the frames set aside.
pub(super) struct Judge {
    pub(super) joint: BundleSolution,
    held_out: Vec<usize>,
    looked_at: Vec<bool>,
}

impl Judge {
    /// On control points whose model contains the effects `predicted`. `None` if there is no calibration to start from.
    pub(super) fn new(points: &ControlPoints, known: &[String], held_out: &[usize]) -> Option<Self> {
        let options =
            CalibrateOptions { held_out: false, leave_out_imprecise: false, physics: known.to_vec(), ..CalibrateOptions::default() };
        let joint = BundleSolution::solve(points, &options).ok()?;
        let looked_at = joint
            .images()
            .iter()
            .map(|image| image.residual_px[0].hypot(image.residual_px[1]) < FAR_SIGMA * image.stated_px2[0].sqrt() + FAR_PX)
            .collect();
        Some(Self { joint, held_out: held_out.to_vec(), looked_at })
    }

    /// Whether a frame was set aside.
    pub(super) fn is_held_out(&self, frame: usize) -> bool {
        self.held_out.contains(&frame)
    }

    /// χ² per degree of freedom of the frames set aside with coefficients of columns that were found elsewhere.
    pub(super) fn of_solution(&self, columns: &[&Column], solution: &DVector<f64>) -> f64 {
        let (_, test) = self.halves(columns, &self.looked_at);
        test.chi2_per_dof(solution)
    }

    /// The same with the camera and these columns fitted by least squares on the other frames; with `clip`, outliers are left out of that fit.
    pub(super) fn of_fit(&self, beside_camera: &[Column], clip: bool) -> Option<f64> {
        let camera = self.joint.solved_columns();
        let columns: Vec<&Column> = camera.iter().chain(beside_camera).collect();
        let mut kept = self.looked_at.clone();
        let (mut train, test) = self.halves(&columns, &kept);
        let mut solution = train.solve()?;
        for _ in 0..if clip { 3 } else { 0 } {
            kept = self.within(&columns, &solution);
            train = self.halves(&columns, &kept).0;
            solution = train.solve()?;
        }
        Some(test.chi2_per_dof(&solution))
    }

    /// Sums over the frames to fit and over those set aside.
    fn halves(&self, columns: &[&Column], kept: &[bool]) -> (Sums, Sums) {
        let (mut train, mut test) = (Sums::zero(columns.len()), Sums::zero(columns.len()));
        for (frame, sums) in by_frame(&self.joint, columns, kept) {
            if self.is_held_out(frame) { &mut test } else { &mut train }.add(&sums, 1.0);
        }
        (train, test)
    }

    /// Which star images lie within the clip of a solution.
    fn within(&self, columns: &[&Column], solution: &DVector<f64>) -> Vec<bool> {
        let images = self.joint.images();
        let mut kept = self.looked_at.clone();
        let mut start = 0;
        for frame in images.chunk_by(|a, b| a.frame == b.frame) {
            let used: Vec<usize> = (0..frame.len()).filter(|k| self.looked_at[start + k]).collect();
            let (own, matrix, right) = white(frame, start, &used, self.joint.own_count(), columns);
            let mut left = right + matrix * solution;
            if left.len() > own.ncols() && own.ncols() > 0 {
                let basis = own.qr().q();
                left -= &basis * (basis.transpose() * &left);
            }
            for (row, k) in used.iter().enumerate() {
                kept[start + k] = left[2 * row].hypot(left[2 * row + 1]) < CLIP * std::f64::consts::SQRT_2;
            }
            start += frame.len();
        }
        kept
    }
}

/// Columns of the frame's own parameters, other columns, and residuals of star images of a frame, in standard errors.
fn white(
    frame: &[crate::calibrate::BundleImage],
    start: usize,
    used: &[usize],
    own_count: usize,
    columns: &[&Column],
) -> (DMatrix<f64>, DMatrix<f64>, DVector<f64>) {
    let rows = 2 * used.len();
    let of = |value: &dyn Fn(usize, usize) -> f64| {
        DVector::from_iterator(
            rows,
            (0..rows).map(|row| {
                let (k, axis) = (used[row / 2], row % 2);
                value(k, axis) / frame[k].stated_px2[2 * axis].sqrt()
            }),
        )
    };
    let matrix = |all: Vec<DVector<f64>>| if all.is_empty() { DMatrix::zeros(rows, 0) } else { DMatrix::from_columns(&all) };
    let own = matrix((0..own_count).map(|c| of(&|k, axis| frame[k].own[axis][c])).collect());
    let columns = matrix(columns.iter().map(|column| of(&|k, axis| column[start + k][axis])).collect());
    (own, columns, of(&|k, axis| frame[k].residual_px[axis]))
}

/// The sums of each frame over the star images kept, its own parameters taken out.
pub(super) fn by_frame(joint: &BundleSolution, columns: &[&Column], kept: &[bool]) -> Vec<(usize, Sums)> {
    let images = joint.images();
    let own_count = joint.own_count();
    let mut sums = Vec::new();
    let mut start = 0;
    for frame in images.chunk_by(|a, b| a.frame == b.frame) {
        let used: Vec<usize> = (0..frame.len()).filter(|k| kept[start + k]).collect();
        let (own, mut matrix, mut right) = white(frame, start, &used, own_count, columns);
        start += frame.len();
        if 2 * used.len() <= own_count || columns.is_empty() {
            continue;
        }
        if own_count > 0 {
            let basis = own.qr().q();
            matrix -= &basis * (basis.transpose() * &matrix);
            right -= &basis * (basis.transpose() * &right);
        }
        // Residuals are measured minus model; a column is the change of the residual.
        let gram = matrix.transpose() * &matrix;
        let product = -(matrix.transpose() * &right);
        let degrees = (2 * used.len() - own_count) as f64;
        sums.push((frame[0].frame, Sums { gram, right: product, square: right.norm_squared(), degrees }));
    }
    sums
}

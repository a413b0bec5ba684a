//! Fit of a pose to matched pairs: robust least squares by Gauss–Newton steps.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::pose::{Pair, Points, Pose, turned};
use super::projection::Projection;
use crate::statistics::cholesky;

/// Parameters of the fit: three small rotations, ln f and κ; and of a fisheye the principal point.
const FREE: usize = 5;
const FREE_OF_FISHEYE: usize = 7;
/// Columns of the equations of a pair: all of them, and the residual.
const COLUMNS: usize = FREE_OF_FISHEYE + 1;
/// The number of κ among them.
const KAPPA: usize = 4;
/// So many pairs tell the principal point of a fisheye besides all else.
pub(super) const MIN_FOR_PRINCIPAL: usize = 12;
/// So many pairs tell the distortion.
pub(super) const MIN_FOR_KAPPA: usize = 8;
/// Steps are longer by this than those of reweighted least squares: with weights of Cauchy at four times the median and normal residuals these leave
/// 0.18 of the way, so many times over.
const OVER: f64 = 1.2;
/// Steps of a fit at most.
const MAX_STEPS: usize = 24;
/// A fit is at rest when its last step moved the image by less than this, px …
pub(super) const AT_REST_PX: f64 = 1e-4;
/// … and near enough to it, where other pairs are looked for from there, at this.
pub(super) const NEAR_REST_PX: f64 = 0.05;

/// The rotation nearest to a matrix that has drifted from one.
fn orthonormal(m: &Matrix3<f64>) -> Matrix3<f64> {
    // The quaternion of a matrix that is nearly one: no iteration. It is as little of length 1 as the matrix is a rotation; left so, the
    // error grows by half from step to step.
    let quaternion = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*m)).into_inner();
    *UnitQuaternion::new_normalize(quaternion).to_rotation_matrix().matrix()
}

/// A pair as the fit needs it: where the point is in the un-mirrored frame, relative to the middle, px, and the direction of the star.
type Sighting = ([f64; 2], Vector3<f64>);

/// What the pose makes of a sighting.
struct Row {
    v: Vector3<f64>,
    /// The projection's scale and its slope.
    scale: [f64; 2],
    /// Relative to the principal point, px; and the square of the radius in units of the corner.
    at: [f64; 2],
    rr: f64,
    /// Undistorted measured point − ideal point, px, and the square of its length.
    residual: [f64; 2],
    length2: f64,
}

impl Row {
    #[inline]
    fn new(pose: &Pose, corner2_px2: f64, (at, direction): &Sighting) -> Option<Self> {
        let [x, y] = [at[0] - pose.principal_px[0], at[1] - pose.principal_px[1]];
        let v = turned(&pose.rotation, direction);
        if !pose.projection.sees(v.z) {
            return None;
        }
        let scale = pose.projection.scale(v.z);
        let rr = (x * x + y * y) / corner2_px2;
        let (shrink, long) = (1.0 - pose.kappa * rr, pose.focal_px * scale[0]);
        let residual = [x * shrink - long * v.x, y * shrink - long * v.y];
        Some(Self { v, scale, at: [x, y], rr, residual, length2: residual[0] * residual[0] + residual[1] * residual[1] })
    }

    /// The derivatives of the residual, turned so that the step is added to the pose, and the residual itself. Rotation: v → v + ω × v, with f·ω
    /// as the parameter so that all columns are px per px.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "inlined into what is compiled for several processors")]
    fn columns(&self, pose: &Pose, corner2_px2: f64) -> [[f64; COLUMNS]; 2] {
        let (f, v, [s, slope], [x, y], rr) = (pose.focal_px, &self.v, self.scale, self.at, self.rr);
        let (u, w, shrink, bent) = (s * v.x, s * v.y, 1.0 - pose.kappa * rr, 2.0 * pose.kappa / corner2_px2);
        let [across, along] = self.residual;
        [
            [slope * v.y * v.x, s * v.z - slope * v.x * v.x, -w, f * u, x * rr, shrink - bent * x * x, -bent * x * y, across],
            [slope * v.y * v.y - s * v.z, -slope * v.x * v.y, u, f * w, y * rr, -bent * x * y, shrink - bent * y * y, along],
        ]
    }
}

type Sums = [[f64; COLUMNS]; FREE_OF_FISHEYE];

/// The normal matrix of the first `free` parameters, of which the lower triangle counts, with the right side in the last column. All columns are summed:
/// so many go through the processor together.
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn normal_equations(rows: &[Row], pose: &Pose, corner2_px2: f64, scale2: f64, free: usize) -> Sums {
    let mut sums = [[0.0; COLUMNS]; FREE_OF_FISHEYE];
    for row in rows {
        let weight = scale2 / (scale2 + row.length2);
        let [a, b] = row.columns(pose, corner2_px2);
        for (i, sums) in sums.iter_mut().enumerate().take(free) {
            let (wa, wb) = (weight * a[i], weight * b[i]);
            for j in 0..COLUMNS {
                sums[j] += wa * a[j] + wb * b[j];
            }
        }
    }
    sums
}

/// Memory of the steps of a fit.
struct Scratch {
    rows: Vec<Row>,
    /// The bits of the squares.
    lengths2: Vec<u64>,
}

impl Scratch {
    fn with_room(count: usize) -> Self {
        Self { rows: Vec::with_capacity(count), lengths2: Vec::with_capacity(count) }
    }
}

/// One Gauss–Newton step of attitude, ln f and (if `fit_kappa`) κ, and of a fisheye the principal point, on the sightings; residuals beyond a
/// few times their median count less (Cauchy). `None` if they do not determine it.
fn step<const N: usize>(
    pose: &Pose,
    corner_px: f64,
    sightings: &[Sighting],
    fit_kappa: bool,
    Scratch { rows, lengths2 }: &mut Scratch,
) -> Option<(Pose, f64)> {
    let corner2_px2 = corner_px * corner_px;
    rows.clear();
    for sighting in sightings {
        if let Some(row) = Row::new(pose, corner2_px2, sighting) {
            rows.push(row);
        }
    }
    if 2 * rows.len() <= N {
        return None;
    }
    // None is negative: their bits have the order of the numbers.
    lengths2.clear();
    lengths2.extend(rows.iter().map(|row| row.length2.to_bits()));
    let middle = lengths2.len() / 2;
    let (_, median2, _) = lengths2.select_nth_unstable(middle);
    let scale2 = (4.0 * f64::from_bits(*median2)).max(0.05 * 0.05);
    let sums = normal_equations(rows, pose, corner2_px2, scale2, N);
    let mut normal: [[f64; N]; N] = std::array::from_fn(|i| std::array::from_fn(|j| sums[i][j]));
    let mut right: [f64; N] = std::array::from_fn(|i| sums[i][COLUMNS - 1]);
    // Damping, as strong as one measurement of 1 px if κ moved by 0.1: a few central stars must not invent distortion.
    normal[KAPPA][KAPPA] += 100.0;
    if !fit_kappa {
        for other in 0..N {
            (normal[KAPPA.max(other)][KAPPA.min(other)], right[KAPPA]) = (if other == KAPPA { 1.0 } else { 0.0 }, 0.0);
        }
    }
    for (axis, row) in normal.iter_mut().enumerate().skip(KAPPA + 1) {
        // The same for the principal point, if it moved by a twentieth of the way to the corner.
        row[axis] += (20.0 / corner_px).powi(2);
    }
    let delta = cholesky::solve(&normal, &right, N, 0.0)?.map(|d| OVER * d);
    let turn = Rotation3::new(Vector3::new(delta[0], delta[1], delta[2]) / pose.focal_px);
    let most_px = 0.3 * corner_px;
    let shift = |axis: usize| delta.get(KAPPA + 1 + axis).copied().unwrap_or(0.0);
    let principal = |axis: usize| (pose.principal_px[axis] + shift(axis)).clamp(-most_px, most_px);
    let moved = delta[0].abs().max(delta[1].abs()).max(delta[2].abs()).max((delta[3] * pose.focal_px).abs());
    let pose = Pose {
        rotation: orthonormal(&(turn.matrix() * pose.rotation)),
        focal_px: pose.focal_px * delta[3].clamp(-0.2, 0.2).exp(),
        kappa: (pose.kappa + delta[KAPPA]).clamp(-0.6, 0.3),
        principal_px: [principal(0), principal(1)],
        ..*pose
    };
    Some((pose, moved))
}

/// Repeats steps until one moves the image by less than `rest_px`. `vectors`: the directions of the catalogue's stars in this frame.
pub(super) fn fit(pose: &Pose, points: &Points, vectors: &[Vector3<f64>], pairs: &[Pair], fit_kappa: bool, rest_px: f64) -> Option<Pose> {
    let of = |&(point, star): &Pair| {
        let [x, y] = points.centred_px[point];
        ([x * pose.parity, y], vectors[star as usize])
    };
    let sightings: Vec<Sighting> = pairs.iter().map(of).collect();
    let fisheye = pose.projection != Projection::Pinhole && pairs.len() >= MIN_FOR_PRINCIPAL;
    let step = if fisheye { step::<FREE_OF_FISHEYE> } else { step::<FREE> };
    let (mut pose, mut scratch) = (*pose, Scratch::with_room(sightings.len()));
    for _ in 0..MAX_STEPS {
        let (next, moved_px) = step(&pose, points.corner_px, &sightings, fit_kappa, &mut scratch)?;
        pose = next;
        if moved_px < rest_px {
            break;
        }
    }
    Some(pose)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rotation_stays_one_over_many_steps() {
        for angle in [0.1, 1.0, 2.0, 3.1] {
            let start = Rotation3::new(Vector3::new(0.36, -0.48, 0.8) * angle);
            // As the search begins: axes from vectors of single precision.
            let mut rotation = start.matrix() * (1.0 + 3e-6);
            for _ in 0..60 {
                rotation = orthonormal(&rotation);
            }
            assert!((rotation.determinant() - 1.0).abs() < 1e-12, "{angle}: {}", rotation.determinant());
            assert!((rotation - start.matrix()).norm() < 1e-5, "{angle}");
        }
    }
}

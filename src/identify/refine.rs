//! Refinement of a candidate: the best camera that one frame gives, from a first attitude and focal length, and its false-match probability.

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector3};

use super::false_match;
use super::projection::Projection;

/// Parameters of the fit: three small rotations, ln f and κ; and of a fisheye the principal point.
const FREE: usize = 5;
const FREE_OF_FISHEYE: usize = 7;

/// Detections ready to be matched: centred on the middle of the frame, brightest first.
#[derive(Clone, Debug)]
pub(super) struct Points {
    /// Position relative to the middle of the frame, px (not un-mirrored).
    pub(super) centred_px: Vec<[f64; 2]>,
    /// Index into the detections.
    pub(super) detection: Vec<usize>,
    /// Half the width and half the height, px.
    pub(super) half_px: [f64; 2],
    /// √(width·height), px: the size of the frame in which lengths are measured.
    pub(super) size_px: f64,
    /// Half the diagonal, px: the unit of radius for κ.
    pub(super) corner_px: f64,
    /// No point is further from the middle than this, px.
    pub(super) reach_px: f64,
}

impl Points {
    /// The area in which there can be points, px²: the frame, or the disc within reach.
    pub(super) fn area_px2(&self) -> f64 {
        let frame = 4.0 * self.half_px[0] * self.half_px[1];
        let disc = std::f64::consts::PI * self.reach_px * self.reach_px;
        if self.reach_px < self.corner_px { frame.min(disc) } else { frame }
    }

    /// Some of the points, in the order given.
    pub(super) fn only(&self, some: &[usize]) -> Self {
        Self {
            centred_px: some.iter().map(|&point| self.centred_px[point]).collect(),
            detection: some.iter().map(|&point| self.detection[point]).collect(),
            ..*self
        }
    }

    /// The first of the points.
    pub(super) fn first(mut self, count: usize) -> Self {
        self.centred_px.truncate(count);
        self.detection.truncate(count);
        self
    }
}

/// A hypothesis about how the camera is turned and what it is like.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pose {
    /// camera_from_icrs.
    pub(super) rotation: Matrix3<f64>,
    /// Focal length, px.
    pub(super) focal_px: f64,
    /// Relative displacement at the corner: the point at radius r belongs at r·(1 − κ·(r/corner)²); κ = k1·corner².
    pub(super) kappa: f64,
    /// −1 if mirrored.
    pub(super) parity: f64,
    /// The law of the lens.
    pub(super) projection: Projection,
    /// The principal point, relative to the middle of the un-mirrored frame, px: that middle, but of fisheyes.
    pub(super) principal_px: [f64; 2],
}

impl Pose {
    /// Where a direction (ICRS axes) appears, relative to the middle of the un-mirrored frame, px.
    pub(super) fn project(&self, direction: &Vector3<f64>, corner_px: f64) -> Option<[f64; 2]> {
        let v = self.rotation * direction;
        if !self.projection.sees(v.z) {
            return None;
        }
        let scale = self.focal_px * self.projection.scale(v.z)[0];
        let ideal = [scale * v.x, scale * v.y];
        // r_ideal = r (1 − κ r²): Newton's method in the one radius, in units of the corner.
        let target = (ideal[0] * ideal[0] + ideal[1] * ideal[1]).sqrt() / corner_px;
        if target > 3.0 {
            return None;
        }
        let [x0, y0] = self.principal_px;
        if self.kappa == 0.0 || target == 0.0 {
            return Some([ideal[0] + x0, ideal[1] + y0]);
        }
        let mut r = target;
        for _ in 0..8 {
            let slope = 1.0 - 3.0 * self.kappa * r * r;
            if slope < 0.05 {
                return None; // beyond the fold
            }
            let step = (target - r * (1.0 - self.kappa * r * r)) / slope;
            r += step;
            if step.abs() < 1e-12 {
                break;
            }
        }
        (r > 0.0 && r.is_finite()).then(|| [ideal[0] * r / target + x0, ideal[1] * r / target + y0])
    }

    /// The angle from the boresight within which all that the points can be stands, with a margin; rad.
    pub(super) fn reach_rad(&self, points: &Points, margin: f64) -> f64 {
        let share = points.reach_px / points.corner_px;
        self.projection.angle_rad(points.reach_px * (1.0 - self.kappa.min(0.0) * share * share) * margin / self.focal_px)
    }
}

/// A matched pair: index into the points, index into the catalogue.
pub(super) type Pair = (usize, u32);

/// The catalogue stars laid over a frame.
pub(super) struct Overlay {
    /// Position relative to the middle, px, and index into the catalogue; brightest first.
    stars: Vec<([f64; 2], u32)>,
}

impl Overlay {
    pub(super) fn new(pose: &Pose, points: &Points, vectors: &[Vector3<f64>], candidates: &[u32], limit: usize) -> Self {
        let mut stars = Vec::with_capacity(limit);
        for &star in candidates {
            if let Some(at) = pose.project(&vectors[star as usize], points.corner_px)
                && at[0].abs() <= points.half_px[0]
                && at[1].abs() <= points.half_px[1]
                && at[0] * at[0] + at[1] * at[1] <= points.reach_px * points.reach_px
            {
                stars.push((at, star));
                if stars.len() == limit {
                    break;
                }
            }
        }
        Self { stars }
    }

    /// Unique nearest pairs within `radius_px` among the first `points_used` points and the first `stars_used` stars.
    pub(super) fn pairs(&self, pose: &Pose, points: &Points, points_used: usize, stars_used: usize, radius_px: f64) -> Vec<Pair> {
        let stars = &self.stars[..stars_used.min(self.stars.len())];
        let mut by_y: Vec<(f64, f64, u32)> = stars.iter().map(|&([x, y], star)| (y, x, star)).collect();
        by_y.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.2.cmp(&b.2)));
        let mut all: Vec<(f64, usize, u32)> = Vec::new();
        for (point, &[x, y]) in points.centred_px.iter().take(points_used).enumerate() {
            let x = x * pose.parity;
            let start = by_y.partition_point(|s| s.0 < y - radius_px);
            for &(star_y, star_x, star) in by_y[start..].iter().take_while(|s| s.0 <= y + radius_px) {
                let distance2 = (star_x - x).powi(2) + (star_y - y).powi(2);
                if distance2 <= radius_px * radius_px {
                    all.push((distance2, point, star));
                }
            }
        }
        all.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
        let (mut points_taken, mut stars_taken) = (vec![false; points_used], Vec::new());
        let mut pairs = Vec::new();
        for (_, point, star) in all {
            if !points_taken[point] && !stars_taken.contains(&star) {
                points_taken[point] = true;
                stars_taken.push(star);
                pairs.push((point, star));
            }
        }
        pairs.sort_unstable();
        pairs
    }

    /// Mean number of chance matches: the sum over the points of the local density of stars times the area of the circle.
    fn chance_matches(&self, pose: &Pose, points: &Points, points_used: usize, stars_used: usize, radius_px: f64) -> f64 {
        let stars = &self.stars[..stars_used.min(self.stars.len())];
        let area = points.area_px2();
        let everywhere = stars.len() as f64 / area;
        // Around each point the density is taken from a circle that holds four stars on average, if it is higher there.
        let reach2 = 4.0 / (std::f64::consts::PI * everywhere.max(1e-300));
        let used = points_used.min(points.centred_px.len());
        let total: f64 = points
            .centred_px
            .iter()
            .take(used)
            .map(|&[x, y]| {
                let near = stars.iter().filter(|([sx, sy], _)| (sx - x * pose.parity).powi(2) + (sy - y).powi(2) <= reach2).count();
                everywhere * (near as f64 / 4.0).max(1.0)
            })
            .sum();
        total * std::f64::consts::PI * radius_px * radius_px
    }
}

/// The rotation nearest to a matrix that has drifted from one.
fn orthonormal(m: &Matrix3<f64>) -> Matrix3<f64> {
    // The quaternion of a matrix that is nearly one: no iteration. It is as little of length 1 as the matrix is a rotation; left so, the
    // error grows by half from step to step.
    let quaternion = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*m)).into_inner();
    *UnitQuaternion::new_normalize(quaternion).to_rotation_matrix().matrix()
}

/// One Gauss–Newton step of attitude, ln f and (if `fit_kappa`) κ, and of a fisheye the principal point, on the pairs; residuals beyond a
/// few times their median count less (Cauchy). `None` if the pairs do not determine it.
fn step<const N: usize>(pose: &Pose, points: &Points, vectors: &[Vector3<f64>], pairs: &[Pair], fit_kappa: bool) -> Option<(Pose, f64)> {
    let mut rows: Vec<([[f64; N]; 2], [f64; 2])> = Vec::with_capacity(pairs.len());
    let f = pose.focal_px;
    for &(point, star) in pairs {
        let [x, y] = points.centred_px[point];
        let (x, y) = (x * pose.parity - pose.principal_px[0], y - pose.principal_px[1]);
        let v = pose.rotation * vectors[star as usize];
        if !pose.projection.sees(v.z) {
            continue;
        }
        let [s, slope] = pose.projection.scale(v.z);
        let (u, w) = (s * v.x, s * v.y);
        let unit2 = points.corner_px * points.corner_px;
        let rr = (x * x + y * y) / unit2;
        let shrink = 1.0 - pose.kappa * rr;
        // residual = undistorted measured point − ideal point; columns are its derivatives, turned so that the step is added
        // to the pose. Rotation: v → v + ω × v, with f·ω as the parameter so that all columns are px per px.
        let residual = [x * shrink - f * u, y * shrink - f * w];
        let bent = 2.0 * pose.kappa / unit2;
        let all = [
            [slope * v.y * v.x, s * v.z - slope * v.x * v.x, -w, f * u, x * rr, shrink - bent * x * x, -bent * x * y],
            [slope * v.y * v.y - s * v.z, -slope * v.x * v.y, u, f * w, y * rr, -bent * x * y, shrink - bent * y * y],
        ];
        rows.push((all.map(|row| std::array::from_fn(|column| row[column])), residual));
    }
    if 2 * rows.len() <= N {
        return None;
    }
    let mut lengths: Vec<f64> = rows.iter().map(|(_, [a, b])| (a * a + b * b).sqrt()).collect();
    lengths.sort_unstable_by(f64::total_cmp);
    let scale = (2.0 * lengths[lengths.len() / 2]).max(0.05);
    let mut normal = SMatrix::<f64, N, N>::zeros();
    let mut right = SVector::<f64, N>::zeros();
    for (columns, residual) in &rows {
        let weight = 1.0 / (1.0 + (residual[0] * residual[0] + residual[1] * residual[1]) / (scale * scale));
        for (row, r) in columns.iter().zip(residual) {
            let row = SVector::<f64, N>::from(*row);
            normal += row * row.transpose() * weight;
            right += row * (weight * r);
        }
    }
    if fit_kappa {
        // Damping, as strong as one measurement of 1 px if κ moved by 0.1: a few central stars must not invent distortion.
        normal[(4, 4)] += 100.0;
    } else {
        normal[(4, 4)] = f64::MAX.sqrt();
        right[4] = 0.0;
    }
    for axis in 5..N {
        // The same for the principal point, if it moved by a twentieth of the way to the corner.
        normal[(axis, axis)] += (20.0 / points.corner_px).powi(2);
    }
    let delta = normal.cholesky()?.solve(&right);
    if !delta.iter().all(|d| d.is_finite()) {
        return None;
    }
    let turn = Rotation3::new(Vector3::new(delta[0], delta[1], delta[2]) / f);
    let most_px = 0.3 * points.corner_px;
    let principal = |axis: usize| (pose.principal_px[axis] + if N > 5 { delta[5 + axis] } else { 0.0 }).clamp(-most_px, most_px);
    let pose = Pose {
        rotation: orthonormal(&(turn.matrix() * pose.rotation)),
        focal_px: f * delta[3].clamp(-0.2, 0.2).exp(),
        kappa: (pose.kappa + delta[4]).clamp(-0.6, 0.3),
        principal_px: [principal(0), principal(1)],
        ..*pose
    };
    let moved = delta[0].abs().max(delta[1].abs()).max(delta[2].abs()).max((delta[3] * f).abs());
    Some((pose, moved))
}

/// Repeats [`step`] until it no longer moves.
pub(super) fn fit(pose: &Pose, points: &Points, vectors: &[Vector3<f64>], pairs: &[Pair], fit_kappa: bool) -> Option<Pose> {
    let mut pose = *pose;
    let fisheye = pose.projection != Projection::Pinhole && pairs.len() >= MIN_FOR_PRINCIPAL;
    for _ in 0..8 {
        let step = if fisheye { step::<FREE_OF_FISHEYE> } else { step::<FREE> };
        let (next, moved) = step(&pose, points, vectors, pairs, fit_kappa)?;
        pose = next;
        if moved < 1e-4 {
            break;
        }
    }
    Some(pose)
}

/// So many pairs tell the principal point of a fisheye besides all else.
const MIN_FOR_PRINCIPAL: usize = 12;

/// A pose that the detections support.
#[derive(Clone, Debug)]
pub(super) struct Supported {
    pub(super) pose: Pose,
    /// ln of the least probability, over the depths and radii, that chance brings about as many matches.
    pub(super) ln_best: f64,
    /// ln of the probability that one hypothesis gets as much support by chance at any of them, at most.
    pub(super) ln_probability: f64,
    /// The detections that it was weighed on.
    pub(super) judges: usize,
}

/// Radii, in frame sizes, within which matches are counted: from a quarter of a pixel in a thousand to several.
const RADII: [f64; 6] = [0.000_25, 0.000_7, 0.001_5, 0.003, 0.006, 0.012];
/// Catalogue stars laid over for one detection.
const DEPTHS: [f64; 4] = [0.4, 1.0, 2.0, 4.0];
/// Not more than these: of few detections most stars may be missing, of many there are enough among the brighter stars.
const MAX_OF_DEPTHS: usize = 96;
/// In the fit only so many stars are laid over that their circles cover this part of the frame: more would match by chance.
const COVERED: f64 = 0.04;
/// ln of the probability by chance that a first look must go below.
const FIRST_LOOK: f64 = -3.0;

/// Refines a hypothesis and weighs it on the brightest `judges` detections; `None` as soon as it is plain that it is no better
/// than chance.
///
/// `vectors` are the directions as they appear in this frame, `near` the catalogue stars (brightest first) that may be in it.
pub(super) fn refine(pose: &Pose, points: &Points, vectors: &[Vector3<f64>], near: &[u32], judges: usize) -> Option<Supported> {
    let used = points.centred_px.len().min(judges);
    let depth = |share: f64| ((used as f64 * share) as usize).max(8);
    let depths = DEPTHS.into_iter().filter(|share| *share <= 2.0 || depth(*share) <= MAX_OF_DEPTHS);
    let most = depths.clone().map(depth).max().unwrap_or(8);
    let wide = RADII[RADII.len() - 1] * points.size_px;
    let area = points.area_px2();
    let sparse = |radius_px: f64| ((COVERED * area / (std::f64::consts::PI * radius_px * radius_px)) as usize).clamp(8, most);
    let mut pose = *pose;
    let (mut fitted_kappa, mut fitted_principal) = (false, false);
    // A first look at the wide radius dismisses nearly all that are wrong.
    for (turn, radius) in [1.0, 1.0, 0.6, 0.4, 0.3, 0.3].into_iter().enumerate() {
        let radius_px = radius * wide;
        let overlay = Overlay::new(&pose, points, vectors, near, sparse(radius_px));
        let pairs = overlay.pairs(&pose, points, used, usize::MAX, radius_px);
        if pairs.len() < 4 {
            return None;
        }
        if turn == 0 {
            let by_chance = overlay.chance_matches(&pose, points, used, usize::MAX, radius_px);
            if false_match::ln_poisson_tail(by_chance, pairs.len() - 3) > FIRST_LOOK {
                return None;
            }
        }
        let fit_kappa = turn > 0 && pairs.len() >= 8;
        fitted_kappa |= fit_kappa;
        fitted_principal |= pose.projection != Projection::Pinhole && pairs.len() >= MIN_FOR_PRINCIPAL;
        pose = fit(&pose, points, vectors, &pairs, fit_kappa)?;
    }
    let spent = 3 + usize::from(fitted_kappa) + usize::from(fitted_principal);
    let overlay = Overlay::new(&pose, points, vectors, near, most);
    let mut best = 0.0_f64;
    for share in depths {
        for radius in RADII {
            let radius_px = radius * points.size_px;
            let matched = overlay.pairs(&pose, points, used, depth(share), radius_px).len();
            if matched > spent {
                let by_chance = overlay.chance_matches(&pose, points, used, depth(share), radius_px);
                best = best.min(false_match::ln_poisson_tail(by_chance, matched - spent));
            }
        }
    }
    let tried = ((RADII.len() * DEPTHS.len()) as f64).ln();
    Some(Supported { pose, ln_best: best, ln_probability: best + tried, judges: used })
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

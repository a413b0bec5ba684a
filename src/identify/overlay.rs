//! Overlay: catalogue stars laid over a frame, the points that stand near them, and how many would by chance.

use nalgebra::Vector3;

use super::pose::{Pair, Points, Pose};

/// Rows of the frame into which stars are sorted, so that only those near a point are looked at.
const ROWS: usize = 64;
/// Around each point the density of stars is taken from a circle that holds so many on average.
const IN_CIRCLE: f64 = 4.0;

/// The catalogue stars laid over a frame.
pub(super) struct Overlay {
    /// Position relative to the middle, px, and index into the catalogue; brightest first.
    stars: Vec<([f64; 2], u32)>,
    /// The positions once more, to be counted.
    x_px: Vec<f32>,
    y_px: Vec<f32>,
}

/// A point and a star that stand near each other.
#[derive(Clone, Copy, Debug)]
pub(super) struct Near {
    pub(super) distance2_px2: f64,
    /// Index into the points.
    point: u32,
    /// The star's number in order of brightness.
    rank: u32,
}

/// Which points and stars have a partner.
#[derive(Default)]
pub(super) struct Taken {
    points: Vec<bool>,
    stars: Vec<bool>,
}

impl Overlay {
    /// The first `limit` of the candidates (catalogue stars, brightest first) that are in the frame.
    pub(super) fn new(pose: &Pose, points: &Points, vectors: &[Vector3<f64>], candidates: &[u32], limit: usize) -> Self {
        let mut stars = Vec::with_capacity(limit.min(candidates.len()));
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
        let axis = |axis: usize| stars.iter().map(|(at, _)| at[axis] as f32).collect();
        Self { x_px: axis(0), y_px: axis(1), stars }
    }

    /// How many stars are laid over.
    pub(super) fn len(&self) -> usize {
        self.stars.len()
    }

    /// The points and stars within `radius_px` of each other among the first `points_used` points, the nearest first.
    pub(super) fn near(&self, pose: &Pose, points: &Points, points_used: usize, radius_px: f64) -> Vec<Near> {
        let (half, per_px) = (points.half_px[1], ROWS as f64 / (2.0 * points.half_px[1]));
        let row = |y: f64| (((y + half) * per_px).max(0.0) as usize).min(ROWS - 1);
        let mut ends = [0_u32; ROWS + 1];
        for ([_, y], _) in &self.stars {
            ends[row(*y) + 1] += 1;
        }
        for row in 0..ROWS {
            ends[row + 1] += ends[row];
        }
        // Until all are placed the first of a row stands where the next goes.
        let mut places = ends;
        let mut by_row = vec![([0.0; 2], 0_u32); self.stars.len()];
        for (rank, (at, _)) in (0..).zip(&self.stars) {
            let place = &mut places[row(at[1])];
            by_row[*place as usize] = (*at, rank);
            *place += 1;
        }
        let mut all = Vec::with_capacity(4 * points_used.min(points.centred_px.len()));
        for (point, &[x, y]) in (0..).zip(points.centred_px.iter().take(points_used)) {
            let x = x * pose.parity;
            for &([star_x, star_y], rank) in &by_row[ends[row(y - radius_px)] as usize..ends[row(y + radius_px) + 1] as usize] {
                let distance2_px2 = (star_x - x).powi(2) + (star_y - y).powi(2);
                if distance2_px2 <= radius_px * radius_px {
                    all.push(Near { distance2_px2, point, rank });
                }
            }
        }
        // Of two stars equally near the brighter, as everywhere. No square is negative: the bits have the order of the numbers.
        all.sort_unstable_by_key(|one| (one.distance2_px2.to_bits(), one.point, one.rank));
        all
    }

    /// Gives each point and each of the first `stars_used` stars the nearest partner that is left, the nearest first; `pair` is told of each.
    pub(super) fn pair_up(&self, near: &[Near], stars_used: usize, points_used: usize, taken: &mut Taken, mut pair: impl FnMut(&Near)) {
        let Taken { points, stars } = taken;
        for (list, length) in [(&mut *points, points_used), (&mut *stars, self.stars.len())] {
            list.clear();
            list.resize(length, false);
        }
        for one in near.iter().filter(|one| (one.rank as usize) < stars_used) {
            let (point, star) = (&mut points[one.point as usize], &mut stars[one.rank as usize]);
            if !*point && !*star {
                (*point, *star) = (true, true);
                pair(one);
            }
        }
    }

    /// Unique nearest pairs within `radius_px` among the first `points_used` points, in order of the points.
    pub(super) fn pairs(&self, pose: &Pose, points: &Points, points_used: usize, radius_px: f64) -> Vec<Pair> {
        self.paired(&self.near(pose, points, points_used, radius_px), points_used)
    }

    /// The same of what is near each other.
    pub(super) fn paired(&self, near: &[Near], points_used: usize) -> Vec<Pair> {
        let mut pairs = Vec::with_capacity(near.len());
        self.pair_up(near, usize::MAX, points_used, &mut Taken::default(), |one| {
            pairs.push((one.point as usize, self.stars[one.rank as usize].1));
        });
        pairs.sort_unstable();
        pairs
    }

    /// Mean number of chance matches over the area of the circle within which they count: the sum over the points of the local density of
    /// the first `stars_used` stars, per px², which is nowhere held to be below that of the frame.
    pub(super) fn density_at_points(&self, pose: &Pose, points: &Points, points_used: usize, stars_used: usize) -> f64 {
        let used = stars_used.min(self.len());
        let everywhere = used as f64 / points.area_px2();
        let reach2 = (IN_CIRCLE / (std::f64::consts::PI * everywhere.max(1e-300))) as f32;
        let (xs, ys, parity) = (&self.x_px[..used], &self.y_px[..used], pose.parity as f32);
        let local = |[x, y]: &[f64; 2]| {
            let (x, y) = (*x as f32 * parity, *y as f32);
            let inside = |(sx, sy): (&f32, &f32)| u32::from((sx - x) * (sx - x) + (sy - y) * (sy - y) <= reach2);
            (f64::from(xs.iter().zip(ys).map(inside).sum::<u32>()) / IN_CIRCLE).max(1.0)
        };
        everywhere * points.centred_px.iter().take(points_used).map(local).sum::<f64>()
    }

    /// What [`Self::density_at_points`] is not below.
    pub(super) fn least_density(&self, points: &Points, points_used: usize, stars_used: usize) -> f64 {
        stars_used.min(self.len()) as f64 / points.area_px2() * points_used.min(points.centred_px.len()) as f64
    }
}

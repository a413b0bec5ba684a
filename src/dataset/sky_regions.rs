//! Parts of the sky that splits do not share.
//!
//! The sphere is cut into 12·n² cells of equal area by the projection of HEALPix (Górski et al., ApJ 622, 759 (2005)). A hash puts the cells in an order,
//! and each split takes as many of them as its share of the frames asks for. Every cell is cut again, 16 × 16; of these parts a split may point at
//! those that are farther than the guard from all cells of other splits. Distances are taken on the safe side, by the radii of the parts. As parts are of
//! equal area, a part by chance and a place by chance in it are even over what is allowed.

use super::chance::AddressedChance;
use crate::dual::dot;
use crate::parallel;
use crate::statistics::order::ascending;

/// Parts along the side of a cell.
const PARTS: usize = 16;
/// Cells along the side of one of the twelve faces that are tried, the smallest cells first.
const SIDES: [usize; 5] = [16, 8, 4, 2, 1];
/// Smaller shares of a split's own sky are not worth it if larger cells leave more.
const MIN_SHARE: f64 = 0.1;

/// The sky of each split.
#[derive(Clone, Debug)]
pub(super) struct SkyRegions {
    side: usize,
    /// Parts that boresights of each split may fall into.
    allowed: Vec<Vec<u32>>,
    /// The split that each cell belongs to.
    owner: Vec<usize>,
}

/// The largest guard, in degrees, that leaves every split a piece of sky.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct NoSky {
    pub(super) largest_guard_deg: f64,
}

/// The direction at a place of a face, both coordinates from 0 to 1.
fn direction_in_face(face: usize, x: f64, y: f64) -> [f64; 3] {
    const RING: [f64; 12] = [2.0, 2.0, 2.0, 2.0, 3.0, 3.0, 3.0, 3.0, 4.0, 4.0, 4.0, 4.0];
    const TURN: [f64; 12] = [1.0, 3.0, 5.0, 7.0, 0.0, 2.0, 4.0, 6.0, 1.0, 3.0, 5.0, 7.0];
    let ring = RING[face] - x - y;
    // Number of a ring from its pole, and the height: caps with z = 1 − r²/3, between them z = 2(2 − r)/3.
    let (from_pole, z, from_one) = if ring < 1.0 {
        (ring, 1.0 - ring * ring / 3.0, ring * ring / 3.0)
    } else if ring > 3.0 {
        let south = 4.0 - ring;
        (south, south * south / 3.0 - 1.0, south * south / 3.0)
    } else {
        let z = (2.0 - ring) * 2.0 / 3.0;
        (1.0, z, 1.0 - z.abs())
    };
    let eighths = TURN[face] * from_pole + x - y;
    let longitude = if from_pole < 1e-12 { 0.0 } else { std::f64::consts::FRAC_PI_4 * eighths / from_pole };
    // 1 − z² without loss at the poles.
    let radius = (from_one * (2.0 - from_one)).max(0.0).sqrt();
    [radius * longitude.cos(), radius * longitude.sin(), z]
}

/// Face, column and row of a cell or part, `side` of them along a face.
fn place(index: usize, side: usize) -> (usize, usize, usize) {
    (index / (side * side), index / side % side, index % side)
}

fn middle(index: usize, side: usize) -> [f64; 3] {
    let (face, column, row) = place(index, side);
    direction_in_face(face, (column as f64 + 0.5) / side as f64, (row as f64 + 0.5) / side as f64)
}

fn angle_rad(a: [f64; 3], b: [f64; 3]) -> f64 {
    dot(a, b).clamp(-1.0, 1.0).acos()
}

/// How far the corner of a cell is from its middle at most.
fn radius_rad(side: usize) -> f64 {
    let corner = |index: usize| {
        let (face, column, row) = place(index, side);
        let centre = middle(index, side);
        let to = |(x, y): (usize, usize)| {
            angle_rad(centre, direction_in_face(face, (column + x) as f64 / side as f64, (row + y) as f64 / side as f64))
        };
        [(0, 0), (0, 1), (1, 0), (1, 1)].into_iter().map(to).fold(0.0, f64::max)
    };
    // The faces of a polar cap are alike, and so are those of the belt.
    (0..side * side).chain(4 * side * side..5 * side * side).map(corner).fold(0.0, f64::max)
}

impl SkyRegions {
    /// Shares out the sky: `shares` are the frames of each split (0: none).
    pub(super) fn new(seed: u64, shares: &[u64], guard_deg: f64) -> Result<Self, NoSky> {
        let guard_rad = guard_deg.to_radians();
        let used = |split: &usize| shares[*split] > 0;
        let mut best: Option<(f64, Self)> = None;
        for side in SIDES {
            let owner = owners(seed, shares, side);
            let (mut allowed, mut owned) = (vec![Vec::new(); shares.len()], vec![0_usize; shares.len()]);
            for (part, distance) in distances_rad(&owner, side, guard_rad).iter().enumerate() {
                let split = owner[cell_of(part, side * PARTS, side)];
                owned[split] += 1;
                if *distance >= guard_rad {
                    allowed[split].push(part as u32);
                }
            }
            let share = |split: usize| allowed[split].len() as f64 / owned[split].max(1) as f64;
            let smallest = (0..shares.len()).filter(used).map(share).fold(f64::INFINITY, f64::min);
            if smallest > 0.0 && best.as_ref().is_none_or(|(before, _)| smallest > *before) {
                best = Some((smallest, Self { side, allowed, owner }));
            }
            if smallest >= MIN_SHARE {
                break;
            }
        }
        best.map(|(_, regions)| regions).ok_or_else(|| NoSky { largest_guard_deg: largest_guard_deg(seed, shares) })
    }

    /// A direction of a split's sky from two numbers from 0 to below 1.
    pub(super) fn direction(&self, split: usize, unit: [f64; 2]) -> [f64; 3] {
        let allowed = &self.allowed[split];
        let at = unit[0] * allowed.len() as f64;
        let part = (at as usize).min(allowed.len().saturating_sub(1));
        let fine = self.side * PARTS;
        let (face, column, row) = place(allowed.get(part).map_or(0, |part| *part as usize), fine);
        direction_in_face(face, (column as f64 + at.fract()) / fine as f64, (row as f64 + unit[1]) / fine as f64)
    }

    /// The share of the whole sky that boresights of a split may fall into.
    pub(super) fn share(&self, split: usize) -> f64 {
        self.allowed[split].len() as f64 / (12 * self.side * self.side * PARTS * PARTS) as f64
    }

    /// How many cells of the sky a split has, and how many there are.
    pub(super) fn cells(&self, split: usize) -> [usize; 2] {
        [self.owner.iter().filter(|owner| **owner == split).count(), self.owner.len()]
    }
}

/// The largest guard that leaves every split a part.
fn largest_guard_deg(seed: u64, shares: &[u64]) -> f64 {
    let of_side = |side: usize| {
        let owner = owners(seed, shares, side);
        let mut farthest = vec![0.0_f64; shares.len()];
        for (part, distance) in distances_rad(&owner, side, std::f64::consts::PI).iter().enumerate() {
            let split = owner[cell_of(part, side * PARTS, side)];
            farthest[split] = farthest[split].max(*distance);
        }
        (0..shares.len()).filter(|split| shares[*split] > 0).map(|split| farthest[split]).fold(f64::INFINITY, f64::min)
    };
    SIDES.into_iter().map(of_side).fold(0.0, f64::max).to_degrees()
}

fn cell_of(part: usize, fine: usize, side: usize) -> usize {
    let (face, column, row) = place(part, fine);
    (face * side + column / PARTS) * side + row / PARTS
}

/// The split of each cell.
fn owners(seed: u64, shares: &[u64], side: usize) -> Vec<usize> {
    let count = 12 * side * side;
    let chance = AddressedChance::new(seed, 0, "sky cells");
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by_cached_key(|cell| (chance.words(*cell as u64, side as u32), *cell));
    let sum: u64 = shares.iter().sum::<u64>().max(1);
    let largest = (0..shares.len()).max_by_key(|split| shares[*split]).unwrap_or(0);
    let mut owner = vec![largest; count];
    let mut next = order.into_iter();
    for (split, share) in shares.iter().enumerate().filter(|(split, share)| *split != largest && **share > 0) {
        let wanted = (count as f64 * *share as f64 / sum as f64).round().max(1.0) as usize;
        for cell in next.by_ref().take(wanted) {
            owner[cell] = split;
        }
    }
    owner
}

/// For each part how far it is from the cells of other splits, at least; what is farther than `up_to_rad` counts as that far.
fn distances_rad(owner: &[usize], side: usize, up_to_rad: f64) -> Vec<f64> {
    let fine = side * PARTS;
    let slack = 2.0 * radius_rad(fine);
    let reach = 2.0 * radius_rad(side);
    let middles: Vec<[f64; 3]> = (0..owner.len()).map(|cell| middle(cell, side)).collect();
    let edge = |cell: usize| -> Vec<[f64; 3]> {
        let (face, column, row) = place(cell, side);
        let parts = (0..PARTS).flat_map(|x| (0..PARTS).map(move |y| (x, y)));
        let at_edge = parts.filter(|(x, y)| [0, PARTS - 1].contains(x) || [0, PARTS - 1].contains(y));
        at_edge.map(|(x, y)| middle((face * fine + column * PARTS + x) * fine + row * PARTS + y, fine)).collect()
    };
    let edges: Vec<Vec<[f64; 3]>> = (0..owner.len()).map(edge).collect();
    // The other splits' cells by their distance, cell by cell.
    let of_cell = |cell: usize| -> Vec<(f64, usize)> {
        let lowest = if up_to_rad + slack + reach < std::f64::consts::PI { (up_to_rad + slack + reach).cos() } else { -2.0 };
        let others = (0..owner.len()).filter(|other| owner[*other] != owner[cell] && dot(middles[cell], middles[*other]) >= lowest);
        let mut others: Vec<(f64, usize)> = others.map(|other| (angle_rad(middles[cell], middles[other]), other)).collect();
        ascending(&mut others, |a| a.0);
        others
    };
    let others: Vec<Vec<(f64, usize)>> = parallel::map_numbers(owner.len(), of_cell);
    let distance = |part: usize| {
        let (own, at) = (cell_of(part, fine, side), middle(part, fine));
        let (mut nearest, mut cosine) = (std::f64::consts::PI, -1.0_f64);
        for (between, other) in &others[own] {
            if between - reach > nearest {
                break;
            }
            cosine = edges[*other].iter().map(|edge| dot(at, *edge)).fold(cosine, f64::max);
            nearest = cosine.clamp(-1.0, 1.0).acos();
        }
        (nearest - slack).clamp(0.0, up_to_rad)
    };
    parallel::map_numbers(12 * fine * fine, distance)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_even_over_the_sphere_and_of_unit_length() {
        let chance = AddressedChance::new(1, 0, "test");
        let count = 12_000;
        let mut mean = [0.0; 3];
        let mut heights: Vec<f64> = Vec::new();
        for index in 0..count {
            let v = direction_in_face(index % 12, chance.uniform(index as u64, 0), chance.uniform(index as u64, 1));
            assert!((dot(v, v) - 1.0).abs() < 1e-12);
            (0..3).for_each(|axis| mean[axis] += v[axis] / count as f64);
            heights.push(v[2]);
        }
        // Standard error of a component's mean: 1/√(3n) = 0.0053.
        assert!(mean.iter().all(|component| component.abs() < 0.026), "{mean:?}");
        heights.sort_by(f64::total_cmp);
        let farthest = heights.iter().enumerate().map(|(rank, z)| (rank as f64 / count as f64 - 0.5 * (z + 1.0)).abs()).fold(0.0, f64::max);
        assert!(farthest < 1.95 / (count as f64).sqrt(), "{farthest}");
        // Known places: the corner of a polar face is the pole, faces meet without a gap.
        assert!((direction_in_face(0, 1.0, 1.0)[2] - 1.0).abs() < 1e-12);
        assert!(
            angle_rad(direction_in_face(0, 1.0, 0.3), direction_in_face(1, 0.3, 1.0)) < 1e-7
                || angle_rad(direction_in_face(0, 0.3, 1.0), direction_in_face(1, 1.0, 0.3)) < 1e-7
        );
    }

    #[test]
    fn no_boresight_comes_nearer_to_another_split_than_the_guard() {
        let shares = [800, 100, 100];
        let regions = SkyRegions::new(3, &shares, 3.0).unwrap();
        let chance = AddressedChance::new(9, 0, "test");
        let boresights: Vec<Vec<[f64; 3]>> = (0..3)
            .map(|split| (0..300).map(|k| regions.direction(split, [0, 1].map(|n| chance.uniform(k * 3 + split as u64, n)))).collect())
            .collect();
        let mut nearest = f64::INFINITY;
        for (split, own_boresights) in boresights.iter().enumerate() {
            let [own, cells] = regions.cells(split);
            assert!(own as f64 >= 0.08 * cells as f64 && regions.share(split) > 0.0);
            // Places all over the cells of the other splits.
            for cell in (0..cells).filter(|cell| regions.owner[*cell] != split) {
                let (face, column, row) = place(cell, regions.side);
                for k in 0..36 {
                    let at = |base: usize, step: usize| (base as f64 + step as f64 / 5.0) / regions.side as f64;
                    let other = direction_in_face(face, at(column, k % 6), at(row, k / 6));
                    nearest = own_boresights.iter().map(|own| angle_rad(*own, other)).fold(nearest, f64::min);
                }
            }
        }
        assert!(nearest >= 3.0_f64.to_radians(), "{}", nearest.to_degrees());
        assert!(nearest < 6.0_f64.to_radians(), "the guard is not far wider than asked for: {}", nearest.to_degrees());
    }

    #[test]
    fn an_impossible_guard_is_refused_with_the_one_that_would_do() {
        let shares = [80, 10, 10];
        let refused = SkyRegions::new(3, &shares, 60.0).unwrap_err();
        assert!((5.0..60.0).contains(&refused.largest_guard_deg), "{refused:?}");
        assert!(SkyRegions::new(3, &shares, 0.999 * refused.largest_guard_deg).is_ok());
        assert!(SkyRegions::new(3, &shares, 1.001 * refused.largest_guard_deg).is_err());
        // A single split has the whole sky.
        assert!((SkyRegions::new(3, &[5, 0, 0], 170.0).unwrap().share(0) - 1.0).abs() < 1e-12);
    }
}

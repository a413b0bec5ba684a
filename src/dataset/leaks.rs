//! What splits share: the table of leaks.

use std::collections::BTreeSet;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::frame_key::{DatasetSplit, FrameKey};
use super::frame_scene::FramePlace;
use super::plan::DatasetPlan;
use crate::catalog::Catalog;
use crate::coordinates::Direction;
use crate::parallel;
use crate::statistics::order::ascending;

/// What two splits share.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SharedBySplits {
    /// The two splits.
    pub splits: [String; 2],
    /// Smallest distance between a boresight of one and one of the other; absent where the scene does not say where it points.
    #[serde(default)]
    pub nearest_boresights_deg: Option<f64>,
    /// Camera instances of both.
    pub shared_cameras: u64,
    /// Seeds of both: instances with the same hot pixels and uneven response.
    #[serde(default)]
    pub shared_seeds: u64,
    /// Smallest time between a frame of one and one of the other; absent where the scene has no times.
    #[serde(default)]
    pub nearest_epochs_s: Option<f64>,
    /// Of the catalogue's stars that may be seen in the smaller set, the share that may be seen in both: stars within half the diagonal of the widest field
    /// from a boresight.
    #[serde(default)]
    pub shared_stars: Option<f64>,
    /// Frames of each that were looked at: the first ones.
    pub frames: [u64; 2],
}

/// Of larger splits the first frames are looked at.
const MAX_FRAMES: u64 = 20_000;

/// What is known of a split.
struct Seen {
    boresights: Vec<[f64; 3]>,
    cameras: BTreeSet<u64>,
    seeds: BTreeSet<i64>,
    times_s: Vec<f64>,
    /// Of each star of the catalogue, whether it may be seen.
    stars: Vec<bool>,
    frames: u64,
}

impl DatasetPlan {
    /// What each two splits share.
    #[must_use]
    pub fn leaks(&self, catalog: &Catalog) -> Vec<SharedBySplits> {
        let used: Vec<DatasetSplit> = DatasetSplit::ALL.into_iter().filter(|split| self.recipe.size.frames.of(*split) > 0).collect();
        let mut table = Vec::new();
        // Every process of a dataset comes this way: a lone split has nothing to share.
        if used.len() < 2 {
            return table;
        }
        let seen: Vec<Seen> = used.iter().map(|split| self.seen(*split, catalog)).collect();
        for (second, split) in used.iter().enumerate() {
            for (first, other) in used[..second].iter().enumerate() {
                table.push(shared([other.name(), split.name()], &seen[first], &seen[second]));
            }
        }
        table
    }

    fn seen(&self, split: DatasetSplit, catalog: &Catalog) -> Seen {
        let (size, cameras) = (&self.recipe.size, &self.recipe.cameras);
        let frames = size.frames.of(split).min(MAX_FRAMES);
        let key = |index| FrameKey { split, index };
        let places = parallel::map_numbers(frames as usize, |index: usize| self.place(key(index as u64)).ok());
        let places: Vec<FramePlace> = places.into_iter().flatten().collect();
        let boresights: Vec<[f64; 3]> = places.iter().filter_map(|place| place.boresight).collect();
        let radius_rad = self.field_radius_deg.to_radians();
        let faintest = self.faintest_magnitude;
        let mut stars = vec![false; catalog.stars.len()];
        for boresight in &boresights {
            catalog.stars_within(&Direction::from_unit(*boresight), radius_rad, faintest).into_iter().for_each(|star| stars[star] = true);
        }
        Seen {
            cameras: (0..frames).map(|index| key(index).camera_number(size, cameras, self.cameras_are_apart())).collect(),
            seeds: places.iter().map(|place| place.seed).collect(),
            times_s: places.iter().filter_map(|place| place.time_s).collect(),
            stars,
            boresights,
            frames,
        }
    }
}

fn shared(names: [&str; 2], a: &Seen, b: &Seen) -> SharedBySplits {
    let count = |stars: &mut dyn Iterator<Item = bool>| stars.filter(|is_seen| *is_seen).count();
    let fewer_stars = count(&mut a.stars.iter().copied()).min(count(&mut b.stars.iter().copied()));
    let shared_stars = count(&mut a.stars.iter().zip(&b.stars).map(|(a, b)| *a && *b));
    let nearest = nearest_rad(&a.boresights, &b.boresights);
    SharedBySplits {
        splits: names.map(str::to_owned),
        nearest_boresights_deg: nearest.map(|nearest| (1e6 * nearest.to_degrees()).round() / 1e6),
        shared_cameras: a.cameras.intersection(&b.cameras).count() as u64,
        shared_seeds: a.seeds.intersection(&b.seeds).count() as u64,
        nearest_epochs_s: nearest_s(&a.times_s, &b.times_s),
        shared_stars: nearest.map(|_| (1e6 * shared_stars as f64 / fewer_stars.max(1) as f64).round() / 1e6),
        frames: [a.frames, b.frames],
    }
}

/// The smallest time between two sets of times.
fn nearest_s(a: &[f64], b: &[f64]) -> Option<f64> {
    let mut all: Vec<(f64, bool)> = a.iter().map(|time| (*time, true)).chain(b.iter().map(|time| (*time, false))).collect();
    ascending(&mut all, |(time, _)| *time);
    let between = all.windows(2).filter(|pair| pair[0].1 != pair[1].1).map(|pair| pair[1].0 - pair[0].0);
    let nearest = between.fold(f64::INFINITY, f64::min);
    nearest.is_finite().then(|| (1e3 * nearest).round() / 1e3)
}

/// The smallest angle between two sets of directions, by their heights in order: nothing farther in height can be nearer.
pub(super) fn nearest_rad(a: &[[f64; 3]], b: &[[f64; 3]]) -> Option<f64> {
    let mut sorted: Vec<[f64; 3]> = b.to_vec();
    ascending(&mut sorted, |one| one[2]);
    // The smallest square of a chord so far.
    let mut nearest = f64::INFINITY;
    for own in a {
        let from = sorted.partition_point(|other| other[2] < own[2]);
        let (below, above) = sorted.split_at(from);
        // Two loops, and no arrays of differences: splits that are apart by a wide guard are looked through hundreds of millions of times.
        for other in above {
            let (x, y, z) = (other[0] - own[0], other[1] - own[1], other[2] - own[2]);
            if z * z >= nearest {
                break;
            }
            nearest = nearest.min(x * x + y * y + z * z);
        }
        for other in below.iter().rev() {
            let (x, y, z) = (other[0] - own[0], other[1] - own[1], other[2] - own[2]);
            if z * z >= nearest {
                break;
            }
            nearest = nearest.min(x * x + y * y + z * z);
        }
    }
    nearest.is_finite().then(|| 2.0 * (0.5 * nearest.sqrt()).min(1.0).asin())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::plan::tests::{SCENE, plan_of, recipe};
    use crate::dual::dot;

    #[test]
    fn splits_apart_share_neither_camera_nor_star() {
        let size =
            |more: &str| recipe(more).replace("train = 8, test = 4", "train = 200, test = 40").replace("per_shard = 4", "per_shard = 40");
        let apart = plan_of(&size("[splits]\napart_by = [\"sky\", \"camera\"]\n"), SCENE).unwrap();
        let [table] = <[SharedBySplits; 1]>::try_from(apart.leaks(Catalog::embedded())).unwrap();
        assert_eq!((table.shared_cameras, table.shared_stars), (0, Some(0.0)));
        assert!(table.nearest_boresights_deg.unwrap() >= 2.0 * apart.guard_deg, "{table:?}");
        assert_eq!(table.frames, [200, 40]);
        // Not asked for, they do: the table can tell.
        let together = plan_of(&size(""), SCENE).unwrap();
        let [table] = <[SharedBySplits; 1]>::try_from(together.leaks(Catalog::embedded())).unwrap();
        assert_eq!(table.shared_cameras, 1);
        assert!(table.shared_stars.unwrap() > 0.5 && table.nearest_boresights_deg.unwrap() < 3.0, "{table:?}");
    }

    /// A field that is drawn keeps the distance of the widest, and the table counts what that sees.
    #[test]
    fn the_guard_is_that_of_the_widest_field_drawn() {
        let draw = "[[draw]]\nper = \"camera\"\npath = \"camera.focal_length_px\"\nuniform = [100, 1100]\n";
        let text = recipe(&format!("[splits]\napart_by = [\"sky\"]\n{draw}")).replace("train = 8, test = 4", "train = 200, test = 40");
        let plan = plan_of(&text, SCENE).unwrap();
        assert!((plan.guard_deg - (40.0_f64 / 100.0).atan().to_degrees()).abs() < 0.2, "{}", plan.guard_deg);
        let [table] = <[SharedBySplits; 1]>::try_from(plan.leaks(Catalog::embedded())).unwrap();
        assert_eq!(table.shared_stars, Some(0.0));
        let narrow = plan_of(&text.replace("[\"sky\"]", "[\"sky\"]\nguard_deg = 5.49"), SCENE).unwrap();
        let [table] = <[SharedBySplits; 1]>::try_from(narrow.leaks(Catalog::embedded())).unwrap();
        assert!(table.shared_stars.unwrap() > 0.05, "{table:?}");
    }

    #[test]
    fn splits_apart_by_time_and_seed_share_neither() {
        let draw = "[[draw]]\nper = \"frame\"\npath = \"frames.time_utc\"\ntimes = [\"2026-01-01T00:00:00Z\", \"2026-01-13T00:00:00Z\"]\n";
        let of = |apart_by: &str, more: &str| {
            plan_of(
                &recipe(&format!("[splits]\napart_by = {apart_by}\n{more}")).replace("train = 8, test = 4", "train = 80, test = 40"),
                SCENE,
            )
        };
        let told = |plan: &DatasetPlan| <[SharedBySplits; 1]>::try_from(plan.leaks(Catalog::embedded())).unwrap()[0].clone();
        let times = |plan: &DatasetPlan, split, count| -> Vec<f64> {
            (0..count).map(|index| plan.place(FrameKey { split, index }).unwrap().time_s.unwrap()).collect()
        };
        let apart = of("[\"epoch\", \"seed\"]", draw).unwrap();
        let (train, test) = (times(&apart, DatasetSplit::Train, 80), times(&apart, DatasetSplit::Test, 40));
        // Two thirds of twelve days, then the last third.
        let border = super::super::frame_scene::tai_s("2026-01-09T00:00:00Z").unwrap();
        assert!(train.iter().all(|time| *time < border) && test.iter().all(|time| *time > border));
        assert!(train.iter().copied().fold(f64::INFINITY, f64::min) < border - 7.0 * 86_400.0, "all of its part is used");
        let shared = told(&apart);
        let nearest = test.iter().flat_map(|b| train.iter().map(move |a| b - a)).fold(f64::INFINITY, f64::min);
        assert!((shared.nearest_epochs_s.unwrap() - nearest).abs() < 2e-3, "{shared:?}, {nearest}");
        assert_eq!((shared.shared_seeds, shared.shared_cameras), (0, 1), "the same camera with another seed");
        // Not asked for, they do: the table can tell.
        let together = of("[]", draw).unwrap();
        assert_eq!(told(&together).shared_seeds, 1);
        let (train, test) = (times(&together, DatasetSplit::Train, 80), times(&together, DatasetSplit::Test, 40));
        assert!(train.iter().any(|time| *time > border) && test.iter().any(|time| *time < border));
        // A scene without drawn times cannot be apart by them, and one without times has none.
        let refused = of("[\"epoch\"]", "").unwrap_err();
        assert!(refused.contains("with \"epoch\" needs a [[draw]] of frames.time_utc by times, per recording or frame"), "{refused}");
        assert!(of("[\"epoch\"]", &draw.replace("\"frame\"", "\"dataset\"")).is_err());
        assert_eq!(told(&of("[]", "").unwrap()).nearest_epochs_s, None);
    }

    #[test]
    fn the_nearest_is_that_of_all_pairs() {
        let chance = super::super::chance::AddressedChance::new(3, 0, "test");
        let set = |first: u64| -> Vec<[f64; 3]> {
            (first..first + 60).map(|k| super::super::distribution::direction(chance.uniform(k, 0), chance.uniform(k, 1))).collect()
        };
        let (a, b) = (set(0), set(1000));
        let all =
            a.iter().flat_map(|one| b.iter().map(move |other| dot(*one, *other).clamp(-1.0, 1.0).acos())).fold(f64::INFINITY, f64::min);
        assert!((nearest_rad(&a, &b).unwrap() - all).abs() < 1e-9);
        assert_eq!(nearest_rad(&a, &[]), None);
    }
}

//! Splits held against each other: no picture, camera or part of the sky of one may stand in another.

use std::collections::{BTreeMap, BTreeSet};

use super::result::SeenFrame;
use crate::dataset::folder::DatasetFile;
use crate::dataset::leaks::nearest_rad;
use crate::dataset::recipe::ApartBy;

/// What splits share and should not, a sentence for each fault; `seen` in the order of the frames.
pub(super) fn split_faults(dataset: &DatasetFile, seen: &[SeenFrame]) -> Vec<String> {
    let mut faults = Vec::new();
    faults.extend(shared_pictures(seen));
    let names: Vec<&str> = dataset.splits.iter().map(|split| split.name.as_str()).collect();
    let of = |name: &str| seen.iter().filter(|frame| frame.shard.split.name() == name).collect::<Vec<_>>();
    for leak in &dataset.leaks {
        let [a, b] = leak.splits.each_ref().map(|name| of(name));
        if !leak.splits.iter().all(|name| names.contains(&name.as_str())) {
            continue;
        }
        let [first, second] = &leak.splits;
        if leak.shared_cameras == 0 {
            let cameras = |frames: &[&SeenFrame]| frames.iter().map(|frame| frame.camera).collect::<BTreeSet<u64>>();
            let both: Vec<u64> = cameras(&a).intersection(&cameras(&b)).copied().collect();
            if let Some(camera) = both.first() {
                faults.push(format!(
                    "the splits {first} and {second} share {} and should share none; the first is number {camera}",
                    if both.len() == 1 { "a camera".to_owned() } else { format!("{} cameras", both.len()) }
                ));
            }
        }
        if dataset.apart_by.contains(&ApartBy::Seed) {
            let seeds = |frames: &[&SeenFrame]| frames.iter().map(|frame| frame.seed).collect::<BTreeSet<u64>>();
            if let Some(seed) = seeds(&a).intersection(&seeds(&b)).next() {
                faults.push(format!("the splits {first} and {second} share seeds and should share none; the first is {seed}"));
            }
        }
        if dataset.apart_by.contains(&ApartBy::Epoch)
            && let (Some(a), Some(b)) = (period_s(&a), period_s(&b))
            && a[0] <= b[1]
            && b[0] <= a[1]
        {
            let shared_s = a[1].min(b[1]) - a[0].max(b[0]);
            faults.push(format!("the times of the splits {first} and {second} overlap by {shared_s:.3} s and should be apart"));
        }
        if dataset.guard_deg > 0.0 {
            let places = |frames: &[&SeenFrame]| frames.iter().map(|frame| frame.boresight).collect::<Vec<[f64; 3]>>();
            let nearest_deg = nearest_rad(&places(&a), &places(&b)).map(f64::to_degrees);
            if let Some(nearest_deg) = nearest_deg.filter(|nearest| *nearest < dataset.guard_deg) {
                faults.push(format!(
                    "a boresight of {first} is {nearest_deg:.4}° from one of {second}, and the guard between their parts of the sky is {:.4}°",
                    dataset.guard_deg
                ));
            }
        }
    }
    faults
}

/// The first and the last time of frames.
fn period_s(frames: &[&SeenFrame]) -> Option<[f64; 2]> {
    let times = || frames.iter().filter_map(|frame| frame.time_s);
    let [first, last] = [times().fold(f64::INFINITY, f64::min), times().fold(f64::NEG_INFINITY, f64::max)];
    (first <= last).then_some([first, last])
}

/// Pictures that stand in two splits: frames with the same counts.
fn shared_pictures(seen: &[SeenFrame]) -> Option<String> {
    let mut first: BTreeMap<&str, &SeenFrame> = BTreeMap::new();
    let mut shared: Vec<(&SeenFrame, &SeenFrame)> = Vec::new();
    for frame in seen {
        match first.get(frame.pixels_sha256.as_str()) {
            Some(other) if other.shard.split != frame.shard.split => shared.push((*other, frame)),
            Some(_) => {}
            None => drop(first.insert(&frame.pixels_sha256, frame)),
        }
    }
    let (one, other) = shared.first()?;
    let count = if shared.len() == 1 { "a picture stands".to_owned() } else { format!("{} pictures stand", shared.len()) };
    Some(format!(
        "{count} in two splits: the frame {:09} of {} is the frame {:09} of {}",
        other.key,
        other.shard.split.name(),
        one.key,
        one.shard.split.name()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalog::Catalog;
    use crate::dataset::frame_key::{DatasetSplit, ShardKey};
    use crate::dataset::plan::tests::{SCENE, plan_of, recipe};

    #[test]
    fn seeds_and_times_that_splits_share_are_told() {
        let draw = "[[draw]]\nper = \"frame\"\npath = \"frames.time_utc\"\ntimes = [\"2026-01-01T00:00:00Z\", \"2026-01-13T00:00:00Z\"]\n";
        let plan = plan_of(&recipe(&format!("[splits]\napart_by = [\"camera\", \"epoch\", \"seed\"]\n{draw}")), SCENE).unwrap();
        let dataset = plan.describe(Catalog::embedded());
        let frame = |split: DatasetSplit, seed: u64, time_s: f64| SeenFrame {
            key: time_s as u64,
            shard: ShardKey { split, index: 0 },
            camera: split.rank() as u64,
            seed,
            time_s: Some(time_s),
            boresight: [0.0, 0.0, 1.0],
            pixels_sha256: time_s.to_string(),
        };
        let faults = |last: [f64; 2], seed: u64| {
            let train = [frame(DatasetSplit::Train, 1, 100.0), frame(DatasetSplit::Train, 1, last[0])];
            let test = [frame(DatasetSplit::Test, seed, last[1]), frame(DatasetSplit::Test, seed, 400.0)];
            split_faults(&dataset, &[train, test].concat()).join("; ")
        };
        assert_eq!(faults([200.0, 300.0], 2), "");
        assert_eq!(faults([310.0, 300.0], 2), "the times of the splits train and test overlap by 10.000 s and should be apart");
        assert_eq!(faults([200.0, 300.0], 1), "the splits train and test share seeds and should share none; the first is 1");
    }
}

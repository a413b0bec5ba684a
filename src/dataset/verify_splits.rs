//! Splits held against each other: no picture, camera or part of the sky of one may stand in another.

use std::collections::{BTreeMap, BTreeSet};

use super::folder::DatasetFile;
use super::leaks::nearest_rad;
use super::verify_result::SeenFrame;

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

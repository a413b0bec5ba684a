//! Holds a dataset against what it says of itself: hashes, frames made again, labels against pixels, masks against labels, splits against each other.

mod alone;
mod label_window;
mod labels;
mod masks;
pub(super) mod result;
mod shard;
mod splits;
mod sums;
mod symmetry;

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use crate::catalog::Catalog;
use crate::dataset::chance::AddressedChance;
use crate::dataset::error::DatasetError;
use crate::dataset::folder::{DatasetFile, RECIPE};
use crate::dataset::frame_key::{DatasetSplit, FrameKey, ShardKey};
use crate::dataset::plan::{CPU, DatasetPlan};
use crate::dataset::run::{DatasetProgress, on_threads};
use crate::dataset::table_columns::TableWriter;
use crate::provenance::Provenance;
use crate::render::PsfTables;
use crate::statistics::order::sort_by_key;
use labels::LabelMeasure;
use masks::MaskMeasure;
use result::{Remake, SeenFrame, VERIFY_FORMAT, VerifyCheck, VerifyFault, VerifyResult};
use shard::ShardCheck;
use splits::split_faults;
use sums::sum_faults;

/// How a dataset is looked at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VerifyOptions {
    /// Frames that are made again and whose labels are held against their pixels.
    pub frames: u64,
    /// Seed by which they are chosen.
    pub seed: u64,
    /// The recipe, if it is not that in the folder.
    pub recipe: Option<PathBuf>,
    /// Shards that are looked at at the same time.
    pub threads: usize,
}

/// Everything that shards showed.
#[derive(Default)]
struct Findings {
    faults: Vec<VerifyFault>,
    seen: Vec<SeenFrame>,
    labels: LabelMeasure,
    masks: MaskMeasure,
    shards: u64,
    bytes: u64,
    rendered: u64,
}

/// Frames that are chosen, in order: one of each of as many equal parts of all.
fn chosen(dataset: &DatasetFile, options: &VerifyOptions) -> Vec<FrameKey> {
    let of_split = |name: &str| DatasetSplit::ALL.into_iter().find(|split| split.name() == name);
    let all: Vec<(DatasetSplit, u64)> = dataset.splits.iter().filter_map(|split| Some((of_split(&split.name)?, split.frames))).collect();
    let total: u64 = all.iter().map(|(_, frames)| frames).sum();
    let count = options.frames.min(total);
    let chance = AddressedChance::new(options.seed, 0, "verify");
    let number = |place: u64| (((place as f64 + chance.uniform(place, 0)) / count as f64 * total as f64) as u64).min(total - 1);
    let key = |mut index: u64| {
        for (split, frames) in &all {
            if index < *frames {
                return Some(FrameKey { split: *split, index });
            }
            index -= frames;
        }
        None
    };
    (0..count).map(number).filter_map(key).collect()
}

/// The plan that the frames of a dataset follow from, or why they cannot be made again.
fn plan_of(folder: &Path, dataset: &DatasetFile, catalog: &Catalog, recipe: Option<&Path>) -> Result<DatasetPlan, String> {
    let not_again = |why: String| format!("frames are not made again: {why}");
    if dataset.version != env!("CARGO_PKG_VERSION") {
        return Err(not_again(format!(
            "the dataset is of version {} of the program, and this is {}",
            dataset.version,
            env!("CARGO_PKG_VERSION")
        )));
    }
    if let (None, Some(first)) = (recipe, dataset.sources_elsewhere.first()) {
        return Err(not_again(format!("{first} is not kept in the folder; give --recipe with the recipe where it was")));
    }
    let own = folder.join(RECIPE);
    let mut plan = DatasetPlan::open(recipe.unwrap_or(&own)).map_err(|error| not_again(error.to_string()))?;
    if dataset.backend != CPU {
        plan = plan.on_gpu().map_err(|error| not_again(format!("they are from {}, and {error}", dataset.backend)))?;
        if plan.adapter != dataset.backend {
            return Err(not_again(format!("they are from {}, and here is {}", dataset.backend, plan.adapter)));
        }
    }
    if plan.identity(catalog) == dataset.recipe_sha256 {
        Ok(plan)
    } else if catalog.sha256 == dataset.catalog_sha256 {
        Err(not_again("recipe and scene are not those that dataset.json has the hash of".to_owned()))
    } else {
        Err(not_again(format!("the catalogue is another one; give --catalog with {}", dataset.catalog)))
    }
}

/// Looks at a dataset. An error is what could not be tried; faults stand in the result.
pub fn verify(
    folder: &Path,
    catalog: &Catalog,
    writer: &dyn TableWriter,
    options: &VerifyOptions,
    (progress, provenance): (&dyn DatasetProgress, Provenance),
) -> Result<VerifyResult, DatasetError> {
    let dataset = DatasetFile::read(folder)?;
    let mut not_checked = Vec::new();
    let plan = match plan_of(folder, &dataset, catalog, options.recipe.as_deref()) {
        Ok(plan) => Some(plan),
        Err(why) => {
            not_checked.push(why);
            None
        }
    };
    let chosen = chosen(&dataset, options);
    let (psfs, findings) = (PsfTables::default(), Mutex::new(Findings::default()));
    progress.begin(dataset.frames());
    let look = |shard: &ShardKey| {
        let remake = plan.as_ref().map(|plan| Remake { plan, catalog, psfs: &psfs });
        let mut check = ShardCheck::new(folder, &dataset, *shard, writer);
        check.run(&chosen, remake.as_ref(), progress);
        findings.lock().unwrap_or_else(PoisonError::into_inner).add(check);
        Ok(())
    };
    on_threads(&dataset.shards(), options.threads, &look)?;
    let mut found = findings.into_inner().unwrap_or_else(PoisonError::into_inner);
    sort_by_key(&mut found.seen, |frame| frame.key);
    let mut told = |check: VerifyCheck, faults: Vec<String>| {
        found.faults.extend(faults.into_iter().map(|fault| VerifyFault { check, fault }));
    };
    told(VerifyCheck::Files, sum_faults(folder, &dataset)?);
    told(VerifyCheck::Labels, found.labels.faults());
    told(VerifyCheck::Masks, found.masks.faults());
    told(VerifyCheck::Splits, split_faults(&dataset, &found.seen));
    not_checked.extend(found.labels.silence());
    found.faults.sort();
    let offset = found.labels.offset();
    Ok(VerifyResult {
        format: VERIFY_FORMAT.to_owned(),
        is_right: found.faults.is_empty(),
        faults: found.faults,
        not_checked,
        shards: found.shards,
        bytes: found.bytes,
        frames: found.seen.len() as u64,
        frames_rendered: found.rendered,
        stars_measured: offset.map_or(0, |offset| offset.stars as u64),
        offset_px: offset.map(|offset| offset.offset_px),
        standard_error_px: offset.map(|offset| offset.standard_error_px),
        provenance,
    })
}

impl Findings {
    fn add(&mut self, check: ShardCheck<'_>) {
        self.faults.extend(check.faults);
        self.seen.extend(check.seen);
        self.labels.merge(check.labels);
        self.masks.merge(check.masks);
        self.shards += u64::from(check.bytes > 0);
        self.bytes += check.bytes;
        self.rendered += check.rendered;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::plan::tests::{SCENE, plan_of, recipe};

    #[test]
    fn frames_are_chosen_from_all_parts_and_never_twice() {
        let plan = plan_of(&recipe("").replace("train = 8, test = 4", "train = 800, test = 200"), SCENE).unwrap();
        let dataset = plan.describe(Catalog::embedded());
        let of = |frames: u64, seed: u64| chosen(&dataset, &VerifyOptions { frames, seed, recipe: None, threads: 1 });
        let some = of(50, 1);
        assert_eq!(some.len(), 50);
        assert!(some.windows(2).all(|pair| pair[0] < pair[1]), "in order, each once");
        assert_eq!(some.iter().filter(|key| key.split == DatasetSplit::Test).count(), 10);
        assert_ne!(some, of(50, 2));
        assert_eq!(of(5000, 1).len(), 1000);
    }
}

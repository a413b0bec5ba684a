//! Makes a dataset: shards by several threads, one shard each, beginning with what is not done yet.

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use super::error::DatasetError;
use super::folder::{DatasetFile, DatasetFolder};
use super::frame_key::ShardKey;
use super::plan::DatasetPlan;
use super::shard::{ShardTools, done};
use super::table_columns::TableWriter;
use crate::catalog::Catalog;
use crate::render::PsfTables;

/// Which shards a process makes: those whose number leaves `part` when divided by `parts`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShardShare {
    /// Which part, from 0.
    pub part: usize,
    /// How many parts there are.
    pub parts: usize,
}

/// What a run did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DatasetRun {
    /// Shards that were made.
    pub made: usize,
    /// Shards of this share that were done before.
    pub skipped: usize,
    /// Shards of the whole dataset that are still to be made, by other processes.
    pub missing: usize,
}

/// What is told while it works.
pub trait DatasetProgress: Sync {
    /// How many frames are to be made.
    fn begin(&self, frames: u64);
    /// One of them is done.
    fn frame(&self);
}

impl DatasetPlan {
    /// Makes the shards of a share that are not done yet, by so many threads, and the sums of all files when none is missing.
    pub fn make(
        &self,
        (folder, force): (&Path, bool),
        (catalog, dataset): (&Catalog, &DatasetFile),
        writer: &dyn TableWriter,
        share: ShardShare,
        threads: usize,
        progress: &dyn DatasetProgress,
    ) -> Result<DatasetRun, DatasetError> {
        let folder = DatasetFolder::open(folder, self, dataset, force)?;
        let hash = &dataset.recipe_sha256;
        let own = ShardKey::all(&self.recipe.size).into_iter().enumerate().filter(|(number, _)| number % share.parts == share.part);
        let (mut wanted, mut skipped) = (Vec::new(), 0);
        for (_, shard) in own {
            match done(&folder.path, shard, hash)? {
                Some(_) => skipped += 1,
                None => wanted.push(shard),
            }
        }
        progress.begin(wanted.len() as u64 * self.recipe.size.frames_per_shard);
        let (psfs, each) = (PsfTables::default(), || progress.frame());
        let tools = ShardTools { catalog, psfs: &psfs, writer, each: &each };
        on_threads(&wanted, threads, &|shard: &ShardKey| self.write_shard(&folder.path, *shard, hash, &tools).map(drop))?;
        let missing = folder.missing(dataset)?.len();
        if missing == 0 {
            folder.finish(dataset)?;
        }
        Ok(DatasetRun { made: wanted.len(), skipped, missing })
    }
}

/// Works on all of them, each on a thread of its own pool of one: work within a shard stays on its thread, or a thread that waits for its own shard would
/// begin another one on top of it, and memory would grow. After a fault nothing new is begun.
pub(super) fn on_threads(
    shards: &[ShardKey],
    threads: usize,
    work: &(dyn Fn(&ShardKey) -> Result<(), DatasetError> + Sync),
) -> Result<(), DatasetError> {
    let (next, is_broken) = (AtomicUsize::new(0), AtomicBool::new(false));
    let fault: Mutex<Option<DatasetError>> = Mutex::new(None);
    let worker = || {
        while !is_broken.load(Ordering::Relaxed)
            && let Some(shard) = shards.get(next.fetch_add(1, Ordering::Relaxed))
        {
            if let Err(error) = work(shard) {
                is_broken.store(true, Ordering::Relaxed);
                fault.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..threads.clamp(1, shards.len().max(1)) {
            scope.spawn(|| match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
                Ok(pool) => pool.install(worker),
                Err(_) => worker(),
            });
        }
    });
    fault.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), Err)
}

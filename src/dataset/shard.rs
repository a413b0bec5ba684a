//! A shard: an archive of samples and its mark, which says that it is whole.
//!
//! The archive is written under another name, waits for the disk and takes its own name; then its mark does the same. A shard with a mark is done and is
//! skipped after its size is compared; one without is made anew. Neither holds a time of the clock, so both are the same however often a run was cut.

use std::io::{self, Write};
use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::error::DatasetError;
use super::frame_key::ShardKey;
use super::label_tables::{frame_columns, light_columns};
use super::plan::{DatasetPlan, hexadecimal};
use super::sample_labels::SampleLabels;
use super::shard_statistics::ShardStatistics;
use super::table_columns::{TableRows, TableWriter};
use super::tar::TarWriter;
use crate::catalog::Catalog;
use crate::recording::{OutputError, OutputFile};
use crate::render::PsfTables;

/// The name of the format of marks.
pub const SHARD_FORMAT: &str = "boresight-shard/1";

/// The mark of a shard that is whole.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ShardMark {
    /// Always `boresight-shard/1`.
    pub format: String,
    /// The shard, below the folder of the dataset.
    pub file: String,
    /// SHA-256 of its bytes.
    pub sha256: String,
    /// How many they are.
    pub bytes: u64,
    /// Hash of the recipe, see `dataset.json`.
    pub recipe_sha256: String,
    /// Number of its first frame.
    pub first_frame: u64,
    /// Its frames.
    pub frames: u64,
    /// Frames without a star of the catalogue.
    pub starless_frames: u64,
    /// Images of stars of the catalogue.
    pub stars: u64,
    /// Other lights.
    pub lights: u64,
    /// Sum of all counts.
    pub sum_dn: u64,
    /// Pixels.
    pub pixels: u64,
    /// Its tables.
    pub tables: Vec<HashedFile>,
    /// Sums over its frames.
    pub statistics: ShardStatistics,
}

/// A file with its hash.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
pub struct HashedFile {
    /// The file, below the folder of the dataset.
    pub file: String,
    /// SHA-256 of its bytes.
    pub sha256: String,
    /// How many they are.
    pub bytes: u64,
}

/// What shards are made with.
pub(super) struct ShardTools<'a> {
    pub(super) catalog: &'a Catalog,
    /// Kept from frame to frame.
    pub(super) psfs: &'a PsfTables,
    pub(super) writer: &'a dyn TableWriter,
    /// Is called for every frame that is done.
    pub(super) each: &'a (dyn Fn() + Sync),
}

/// The tables of a shard in the making: of frames, and of the lights on them.
pub(super) struct ShardTables<'w> {
    frames: TableRows<'w>,
    stars: TableRows<'w>,
}

impl<'w> ShardTables<'w> {
    pub(super) fn new(writer: &'w dyn TableWriter) -> Self {
        Self { frames: TableRows::new(writer), stars: TableRows::new(writer) }
    }

    /// Adds the labels of a frame.
    pub(super) fn add(&mut self, labels: &mut SampleLabels) -> Result<(), String> {
        self.frames.add(frame_columns(labels))?;
        self.stars.add(light_columns(labels.key, &labels.lights))
    }

    /// The files with their bytes; none if this build writes no tables.
    pub(super) fn files(self, shard: ShardKey) -> Result<Vec<(HashedFile, Vec<u8>)>, DatasetError> {
        let mut files = Vec::new();
        for (name, rows) in [("frames", self.frames), ("stars", self.stars)] {
            let file = shard.table(name);
            if let Some(bytes) = rows.finish().map_err(|message| DatasetError::Table { file: file.clone(), message })? {
                files.push((HashedFile { file, sha256: hexadecimal(&Sha256::digest(&bytes)), bytes: bytes.len() as u64 }, bytes));
            }
        }
        Ok(files)
    }
}

/// Bytes on their way to a file, hashed and counted.
struct Hashed {
    file: OutputFile,
    hasher: Sha256,
    bytes: u64,
}

impl Write for Hashed {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write_all(bytes)?;
        self.hasher.update(bytes);
        self.bytes += bytes.len() as u64;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The mark of a shard that is done, if it is; `recipe_sha256`: that of the dataset.
pub(super) fn done(folder: &Path, shard: ShardKey, recipe_sha256: &str) -> Result<Option<ShardMark>, DatasetError> {
    let Ok(text) = std::fs::read_to_string(folder.join(shard.mark())) else { return Ok(None) };
    let path = folder.join(shard.file());
    let mark = serde_json::from_str::<ShardMark>(&text).ok().filter(|mark| mark.recipe_sha256 == recipe_sha256);
    let (Some(mark), Ok(found)) = (mark, std::fs::metadata(&path)) else { return Ok(None) };
    if found.len() != mark.bytes {
        return Err(DatasetError::ShardSize { path, stated: mark.bytes, found: found.len() });
    }
    let are_there = mark.tables.iter().all(|table| folder.join(&table.file).is_file());
    Ok(are_there.then_some(mark))
}

impl DatasetPlan {
    /// Makes a shard, its tables and its mark.
    pub(super) fn write_shard(
        &self,
        folder: &Path,
        shard: ShardKey,
        recipe_sha256: &str,
        tools: &ShardTools<'_>,
    ) -> Result<ShardMark, DatasetError> {
        let path = folder.join(shard.file());
        let wrong = |source| DatasetError::Output(OutputError::Write { path: path.clone(), source });
        let mut tar = TarWriter::new(Hashed { file: OutputFile::create(&path)?, hasher: Sha256::new(), bytes: 0 });
        let mut tables = ShardTables::new(tools.writer);
        let size = &self.recipe.size;
        let first_frame = shard.frames(size).next().map_or(0, super::frame_key::FrameKey::number);
        let mut mark = ShardMark {
            format: SHARD_FORMAT.to_owned(),
            file: shard.file(),
            sha256: String::new(),
            bytes: 0,
            recipe_sha256: recipe_sha256.to_owned(),
            first_frame,
            frames: size.frames_per_shard,
            starless_frames: 0,
            stars: 0,
            lights: 0,
            sum_dn: 0,
            pixels: 0,
            tables: Vec::new(),
            statistics: ShardStatistics::new(self),
        };
        for key in shard.frames(size) {
            let mut sample = self.sample(tools.catalog, tools.psfs, key)?;
            for (name, bytes) in &sample.members {
                tar.add(&format!("{:09}.{name}", key.number()), bytes).map_err(&wrong)?;
            }
            mark.starless_frames += u64::from(sample.stars == 0);
            mark.stars += sample.stars;
            mark.lights += sample.lights;
            mark.sum_dn += sample.sum_dn;
            mark.pixels += sample.pixels;
            mark.statistics.add(self, &sample);
            tables.add(&mut sample.labels).map_err(|message| DatasetError::Table { file: shard.table("frames"), message })?;
            (tools.each)();
        }
        let Hashed { file, hasher, bytes } = tar.finish().map_err(&wrong)?;
        for (table, bytes) in tables.files(shard)? {
            write_bytes(&folder.join(&table.file), &bytes)?;
            mark.tables.push(table);
        }
        file.finish()?;
        (mark.sha256, mark.bytes) = (hexadecimal(&hasher.finalize()), bytes);
        write_json(&folder.join(shard.mark()), &mark)?;
        Ok(mark)
    }
}

/// Writes an object so that it is there whole or not at all, and outlasts a power failure.
pub(super) fn write_json(path: &Path, object: &impl Serialize) -> Result<(), DatasetError> {
    let wrong = |source| DatasetError::Output(OutputError::Write { path: path.to_owned(), source });
    let mut text = serde_json::to_string_pretty(object).map_err(io::Error::other).map_err(wrong)?;
    text.push('\n');
    write_text(path, &text)
}

/// The same of a text.
pub(super) fn write_text(path: &Path, text: &str) -> Result<(), DatasetError> {
    write_bytes(path, text.as_bytes())
}

/// The same of bytes.
pub(super) fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), DatasetError> {
    let wrong = |source| DatasetError::Output(OutputError::Write { path: path.to_owned(), source });
    let mut file = OutputFile::create(path)?;
    file.write_all(bytes).map_err(wrong)?;
    Ok(file.finish()?)
}

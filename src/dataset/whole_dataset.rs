//! A dataset of which no shard is missing: what card and statistics are made of.

use std::path::Path;

use super::folder::DatasetFile;
use super::frame_key::ShardKey;
use super::shard::ShardMark;

/// A dataset with all its marks.
pub(super) struct WholeDataset<'a> {
    pub(super) folder: &'a Path,
    pub(super) file: &'a DatasetFile,
    pub(super) marks: Vec<(ShardKey, ShardMark)>,
}

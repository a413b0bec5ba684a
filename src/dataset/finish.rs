//! What a dataset has when no shard is missing: the card, its description for machines, the page of statistics, and the sums of all files.
//!
//! All of it follows from the marks of the shards and, for the pictures of the page, from a few samples; it bears no time. So the bytes are the same wherever
//! it is made.

use std::path::Path;

use sha2::{Digest, Sha256};

use super::card::card;
use super::croissant::croissant;
use super::error::DatasetError;
use super::folder::{CARD, CROISSANT, DESCRIPTION, DatasetFile, DatasetFolder, RECIPE, STATISTICS, SUMS};
use super::plan::hexadecimal;
use super::shard::{HashedFile, write_json, write_text};
use super::statistics_page::statistics_page;
use super::whole_dataset::WholeDataset;

impl DatasetFolder {
    /// Writes what a dataset has at its end. A missing shard is an error.
    pub(super) fn finish(&self, dataset: &DatasetFile) -> Result<(), DatasetError> {
        let whole = WholeDataset { folder: &self.path, file: dataset, marks: self.marks(dataset)? };
        write_text(&self.path.join(CARD), &card(&whole))?;
        write_json(&self.path.join(CROISSANT), &croissant(&whole))?;
        write_text(&self.path.join(STATISTICS), &statistics_page(&whole)?)?;
        self.write_sums(&whole)
    }

    /// Writes SHA256SUMS: of shards and tables what their marks say, of all else what is there.
    fn write_sums(&self, whole: &WholeDataset<'_>) -> Result<(), DatasetError> {
        let mut sums: Vec<(String, String)> = Vec::new();
        let own = [DESCRIPTION, RECIPE, CARD, CROISSANT, STATISTICS].map(str::to_owned).into_iter();
        let sources = whole.file.sources.iter().map(|source| source.file.clone());
        let marks = whole.marks.iter().map(|(shard, _)| shard.mark());
        for name in own.chain(sources).chain(marks) {
            let path = self.path.join(&name);
            let bytes = std::fs::read(&path).map_err(|source| DatasetError::Read { path: path.display().to_string(), source })?;
            sums.push((name, hexadecimal(&Sha256::digest(bytes))));
        }
        for (_, mark) in &whole.marks {
            sums.push((mark.file.clone(), mark.sha256.clone()));
            sums.extend(mark.tables.iter().map(|HashedFile { file, sha256, .. }| (file.clone(), sha256.clone())));
        }
        sums.sort();
        let mut text = String::new();
        for (name, sum) in sums {
            text += &format!("{sum}  {name}\n");
        }
        write_text(&self.path.join(SUMS), &text)
    }
}

/// Finishes the dataset of a folder, after its shards were made by many processes. A missing shard is an error.
pub fn finish(folder: &Path) -> Result<DatasetFile, DatasetError> {
    let dataset = DatasetFile::read(folder)?;
    DatasetFolder { path: folder.to_owned() }.finish(&dataset)?;
    Ok(dataset)
}

//! SHA256SUMS held against the files that are not hashed with their shards.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use sha2::{Digest, Sha256};

use crate::dataset::error::DatasetError;
use crate::dataset::folder::{DatasetFile, SUMS};
use crate::dataset::frame_key::DatasetSplit;
use crate::dataset::plan::hexadecimal;

/// Archives and tables where those of shards stand that are of no shard: loaders read whatever is there.
fn surplus(folder: &Path, dataset: &DatasetFile) -> Vec<String> {
    let own: BTreeSet<String> =
        dataset.shards().iter().flat_map(|shard| [shard.file(), shard.table("frames"), shard.table("stars")]).collect();
    let mut faults = Vec::new();
    for split in DatasetSplit::ALL.map(DatasetSplit::name) {
        for (place, ending) in [(split.to_owned(), "tar"), (format!("tables/{split}"), "parquet")] {
            let entries = std::fs::read_dir(folder.join(&place)).into_iter().flatten().flatten();
            let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
            let names =
                names.filter(|name| Path::new(name).extension().is_some_and(|own| own == ending)).map(|name| format!("{place}/{name}"));
            faults.extend(
                names
                    .filter(|name| !own.contains(name))
                    .map(|name| format!("{name} belongs to no shard, and loaders would read it; remove it")),
            );
        }
    }
    faults
}

/// What is wrong with the list of sums, and with the small files in it.
pub(super) fn sum_faults(folder: &Path, dataset: &DatasetFile) -> Result<Vec<String>, DatasetError> {
    let path = folder.join(SUMS);
    let text = match std::fs::read_to_string(&path) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            return Ok(vec![format!("{SUMS} is missing; write it with `boresight dataset finish {}`", folder.display())]);
        }
        Err(source) => return Err(DatasetError::Read { path: path.display().to_string(), source }),
    };
    let sums: BTreeMap<&str, &str> = text.lines().filter_map(|line| line.split_once("  ")).map(|(sum, name)| (name, sum)).collect();
    let mut faults = surplus(folder, dataset);
    let with_shards: Vec<String> = dataset.shards().iter().flat_map(|shard| [shard.file(), shard.mark()]).collect();
    faults
        .extend(with_shards.iter().filter(|name| !sums.contains_key(name.as_str())).map(|name| format!("{name} does not stand in {SUMS}")));
    for (name, sum) in &sums {
        // Archives and tables are hashed with their shards, and hold against their marks.
        let ending = Path::new(name).extension();
        if ["tar", "parquet"].iter().any(|own| ending.is_some_and(|ending| ending == *own)) {
            continue;
        }
        match std::fs::read(folder.join(name)) {
            Ok(bytes) if hexadecimal(&Sha256::digest(&bytes)) == *sum => {}
            Ok(_) => faults.push(format!("{name} is not the file that {SUMS} has the hash of")),
            Err(error) => faults.push(format!("{name} stands in {SUMS} and cannot be read ({error})")),
        }
    }
    Ok(faults)
}

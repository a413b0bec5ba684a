//! Truth files and their seal: a list of salted hashes that is written before anything is diagnosed.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::BlindError;
use super::generate::{Family, Truth};
use crate::recording::write_file;

/// The seal: in the open, beside the folder of the truths.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Seal {
    /// Format.
    pub format: String,
    /// Version of the program that made the recordings.
    pub version: String,
    /// Seed of the recordings.
    pub seed: u64,
    /// File in the folder of truths → SHA-256 of the salt and the file's bytes, hexadecimal.
    pub files: BTreeMap<String, String>,
}

/// The format of the seal.
const FORMAT: &str = "boresight-blind-seal/1";
const SEAL_FILE: &str = "seal.json";
const SALT_FILE: &str = "salt.txt";

/// Whether a benchmark's folder holds sealed recordings.
#[must_use]
pub fn is_sealed(directory: &Path) -> bool {
    directory.join(SEAL_FILE).exists()
}

/// The folder of the truths.
fn folder(directory: &Path) -> PathBuf {
    directory.join("truth")
}

/// The name of a truth's file.
fn name(family: Family, index: u32) -> String {
    format!("{}-{index:05}.json", family.name())
}

fn hash(salt: &str, bytes: &[u8]) -> String {
    let mut hasher = Sha256::new();
    hasher.update(salt.as_bytes());
    hasher.update(bytes);
    hasher.finalize().iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}"); // writing to a String cannot fail
        text
    })
}

/// The salt of a folder of truths; made of the seed when the first truth is written.
fn salt(directory: &Path, seed: u64) -> Result<String, BlindError> {
    let path = folder(directory).join(SALT_FILE);
    if let Ok(salt) = std::fs::read_to_string(&path) {
        return Ok(salt.trim().to_owned());
    }
    let salt = hash("boresight blind", &seed.to_le_bytes());
    write_file(&path, format!("{salt}\n").as_bytes())?;
    Ok(salt)
}

impl Seal {
    /// The seal of a folder; `None` where nothing is sealed yet.
    pub fn read(directory: &Path) -> Result<Option<Self>, BlindError> {
        let path = directory.join(SEAL_FILE);
        match std::fs::read_to_string(&path) {
            Ok(text) => serde_json::from_str(&text).map(Some).map_err(|error| BlindError::Json { path, message: error.to_string() }),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(source) => Err(BlindError::File { path, source }),
        }
    }

    /// Whether a recording's truth is sealed.
    #[must_use]
    pub fn holds(&self, family: Family, index: u32) -> bool {
        self.files.contains_key(&name(family, index))
    }
}

/// Writes truths and seals them. What is sealed already must come out the same: truths are never replaced.
pub fn seal(directory: &Path, seed: u64, truths: &[Truth]) -> Result<Seal, BlindError> {
    let fresh = || Seal { format: FORMAT.to_owned(), version: env!("CARGO_PKG_VERSION").to_owned(), seed, files: BTreeMap::new() };
    let mut seal = Seal::read(directory)?.unwrap_or_else(fresh);
    if seal.seed != seed {
        return Err(BlindError::OtherSeed { directory: directory.to_owned(), sealed: seal.seed, asked: seed });
    }
    let salt = salt(directory, seed)?;
    for truth in truths {
        let file = name(truth.family, truth.index);
        let path = folder(directory).join(&file);
        let mut text =
            serde_json::to_string_pretty(truth).map_err(|error| BlindError::Json { path: path.clone(), message: error.to_string() })?;
        text.push('\n');
        let digest = hash(&salt, text.as_bytes());
        match seal.files.get(&file) {
            Some(sealed) if *sealed != digest => return Err(BlindError::Broken { path, reason: "another truth is sealed under its name" }),
            Some(_) => {}
            None => {
                write_file(&path, text.as_bytes())?;
                seal.files.insert(file, digest);
            }
        }
    }
    let path = directory.join(SEAL_FILE);
    let text = serde_json::to_string_pretty(&seal).map_err(|error| BlindError::Json { path: path.clone(), message: error.to_string() })?;
    write_file(&path, format!("{text}\n").as_bytes())?;
    Ok(seal)
}

/// Opens a sealed truth: what is read is what was sealed, or an error.
pub fn open(directory: &Path, seal: &Seal, family: Family, index: u32) -> Result<Truth, BlindError> {
    let file = name(family, index);
    let path = folder(directory).join(&file);
    let salt = salt(directory, seal.seed)?;
    let bytes = std::fs::read(&path).map_err(|source| BlindError::File { path: path.clone(), source })?;
    let sealed = seal.files.get(&file).ok_or(BlindError::Broken { path: path.clone(), reason: "it is not in the seal" })?;
    if *sealed != hash(&salt, &bytes) {
        return Err(BlindError::Broken { path, reason: "it is not what was sealed" });
    }
    serde_json::from_slice(&bytes).map_err(|error| BlindError::Json { path, message: error.to_string() })
}

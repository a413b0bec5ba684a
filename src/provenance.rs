//! What every result says of its own making: version, command, input hashes, seed, adapter.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use thiserror::Error;

/// How a result came about.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Version of the program.
    pub version: String,
    /// The command line as given.
    pub command: Vec<String>,
    /// Every file read: path and SHA-256.
    pub inputs: Vec<InputHash>,
    /// Seed, where chance played a part.
    pub seed: Option<u64>,
    /// GPU adapter and driver, or "cpu"; `None` where nothing was rendered.
    pub adapter: Option<String>,
}

/// A file that was read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InputHash {
    /// Path as given.
    pub path: String,
    /// SHA-256 of its bytes, hexadecimal.
    pub sha256: String,
}

/// Why an input could not be hashed.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ProvenanceError {
    /// The operating system refused.
    #[error("{}: cannot be read for its hash: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What it said.
        source: std::io::Error,
    },
}

impl Provenance {
    /// The provenance of what `command` makes, without inputs as yet.
    #[must_use]
    pub fn new(command: Vec<String>) -> Self {
        Self { version: env!("CARGO_PKG_VERSION").to_owned(), command, inputs: Vec::new(), seed: None, adapter: None }
    }

    /// Adds a file that was read, once.
    pub fn add_input(&mut self, path: &Path) -> Result<(), ProvenanceError> {
        let name = path.display().to_string();
        if self.inputs.iter().all(|input| input.path != name) {
            self.inputs.push(InputHash { path: name, sha256: sha256_of_file(path)? });
        }
        Ok(())
    }

    /// Adds an input that is no file of its own (a scene within the program), under a name.
    pub fn add_input_bytes(&mut self, name: &str, bytes: &[u8]) {
        self.inputs.push(InputHash { path: name.to_owned(), sha256: hexadecimal(&Sha256::digest(bytes)) });
    }
}

/// SHA-256 of a file, read piece by piece; lower-case hexadecimal.
pub fn sha256_of_file(path: &Path) -> Result<String, ProvenanceError> {
    let fault = |source| ProvenanceError::Read { path: path.to_owned(), source };
    let mut reader = BufReader::new(File::open(path).map_err(fault)?);
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 1 << 16];
    loop {
        match reader.read(&mut buffer).map_err(fault)? {
            0 => return Ok(hexadecimal(&hasher.finalize())),
            count => hasher.update(&buffer[..count]),
        }
    }
}

fn hexadecimal(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(2 * bytes.len());
    for byte in bytes {
        let _ = write!(text, "{byte:02x}"); // writing to a String cannot fail
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_are_those_of_sha256() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("abc");
        std::fs::write(&path, "abc").unwrap();
        let mut provenance = Provenance::new(vec!["boresight".to_owned()]);
        provenance.add_input(&path).unwrap();
        provenance.add_input(&path).unwrap();
        provenance.add_input_bytes("abc", b"abc");
        // FIPS 180-4, example "abc"
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(provenance.inputs.iter().map(|input| input.sha256.as_str()).collect::<Vec<_>>(), [expected; 2]);
        assert!(provenance.add_input(&directory.path().join("absent")).unwrap_err().to_string().contains("absent"));
    }
}

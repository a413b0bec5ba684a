//! What every result says of its own making: version, command, input hashes, seed, adapter.

use std::collections::BTreeSet;
use std::ffi::{OsStr, OsString};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use thiserror::Error;

/// The commit that this build is made of, as build.rs found it.
pub const COMMIT: Option<&str> = option_env!("BORESIGHT_COMMIT");

/// Version and commit, for `--version` and the first line of pages: `0.1.0 (64dd495f1a2b)`.
#[must_use]
pub fn version() -> &'static str {
    static TEXT: LazyLock<String> = LazyLock::new(|| match COMMIT {
        Some(commit) => format!("{} ({commit})", env!("CARGO_PKG_VERSION")),
        None => env!("CARGO_PKG_VERSION").to_owned(),
    });
    &TEXT
}

/// What made a page, for its head: program, version, commit, and the seed where chance played a part.
#[must_use]
pub fn made_by(seed: Option<u64>) -> String {
    let commit = COMMIT.map_or_else(|| "a build for development, of no commit".to_owned(), |commit| format!("commit {commit}"));
    let seed = seed.map_or_else(String::new, |seed| format!(", seed {seed}"));
    format!("boresight {}, {commit}{seed}", env!("CARGO_PKG_VERSION"))
}

/// How a result came about.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Provenance {
    /// Version of the program.
    pub version: String,
    /// The commit it was built from, where that is known (release builds of a checkout); with `-dirty` where files differed from it.
    #[serde(default)]
    pub commit: Option<String>,
    /// The command line as given; a word that is no UTF-8 as [`word`] writes it.
    pub command: Vec<String>,
    /// Every file read: path and SHA-256.
    pub inputs: Vec<InputHash>,
    /// Seed, where chance played a part.
    pub seed: Option<u64>,
    /// GPU adapter and driver, or "cpu"; `None` where nothing was rendered.
    pub adapter: Option<String>,
}

/// A file that was read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct InputHash {
    /// Path as given; one that is no UTF-8 as [`word`] writes it.
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
        let commit = COMMIT.map(str::to_owned);
        Self { version: env!("CARGO_PKG_VERSION").to_owned(), commit, command, inputs: Vec::new(), seed: None, adapter: None }
    }

    /// The provenance of what this process makes: its own command line.
    #[must_use]
    pub fn of_process() -> Self {
        Self::new(std::env::args_os().map(|argument: OsString| word(&argument)).collect())
    }

    /// Adds a file that was read, once.
    pub fn add_input(&mut self, path: &Path) -> Result<(), ProvenanceError> {
        let name = word(path.as_os_str());
        if self.inputs.iter().all(|input| input.path != name) {
            self.inputs.push(InputHash { path: name, sha256: sha256_of_file(path)? });
        }
        Ok(())
    }

    /// Adds files that were read, each once: thousands in the time of one walk over them.
    pub fn add_inputs(&mut self, paths: &[PathBuf]) -> Result<(), ProvenanceError> {
        let mut known: BTreeSet<String> = self.inputs.iter().map(|input| input.path.clone()).collect();
        for path in paths {
            let name = path.display().to_string();
            if known.insert(name.clone()) {
                self.inputs.push(InputHash { path: name, sha256: sha256_of_file(path)? });
            }
        }
        Ok(())
    }

    /// Adds an input that is no file of its own (a scene within the program), under a name.
    pub fn add_input_bytes(&mut self, name: &str, bytes: &[u8]) {
        self.inputs.push(InputHash { path: name.to_owned(), sha256: hexadecimal(&Sha256::digest(bytes)) });
    }
}

/// A word of the command line as text from which it can be had back: as it is where it is UTF-8, else in the quotes of a shell
/// (`$'caf\xE9.png'`), which bash, zsh and POSIX.1-2024 turn into the same bytes.
#[must_use]
pub fn word(given: &OsStr) -> String {
    if let Some(text) = given.to_str() {
        return text.to_owned();
    }
    let mut text = "$'".to_owned();
    for chunk in given.as_encoded_bytes().utf8_chunks() {
        for character in chunk.valid().chars() {
            if matches!(character, '\'' | '\\') {
                text.push('\\');
            }
            text.push(character);
        }
        for byte in chunk.invalid() {
            let _ = write!(text, "\\x{byte:02X}"); // writing to a String cannot fail
        }
    }
    text.push('\'');
    text
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

    #[cfg(unix)]
    #[test]
    fn a_word_that_is_no_text_is_kept_whole() {
        use std::os::unix::ffi::OsStrExt;
        let of = |bytes: &[u8]| word(OsStr::from_bytes(bytes));
        assert_eq!(of("nächtliche Aufnahme".as_bytes()), "nächtliche Aufnahme");
        assert_eq!(of(b"nu/caf\xe9.png"), r"$'nu/caf\xE9.png'");
        assert_eq!(of(b"it's \\ \xff\xfe"), r"$'it\'s \\ \xFF\xFE'");
        assert_ne!(of(b"caf\xe9"), of(b"caf\xe8"));
    }

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
        assert_eq!(provenance.commit.as_deref(), COMMIT);
        let text = serde_json::to_string(&provenance).unwrap().replace(&format!("\"commit\":{},", serde_json::json!(COMMIT)), "");
        assert!(!text.contains("commit") && serde_json::from_str::<Provenance>(&text).is_ok(), "files of older builds have none: {text}");
        assert!(version().starts_with(env!("CARGO_PKG_VERSION")) && made_by(Some(7)).ends_with(", seed 7"));
        assert!(provenance.add_input(&directory.path().join("absent")).unwrap_err().to_string().contains("absent"));
    }
}

//! Small recordings made on the spot, byte by byte where another program's file is stood in for.

use std::fs;
use std::path::{Path, PathBuf};

use boresight::recording::{OpenOptions, Recording};

/// A FITS image of 12 × 10 px; cards replace those of the same keyword or are added.
pub(super) fn fits(cards: &[&str], data: &[u8]) -> Vec<u8> {
    let mut header: Vec<String> =
        ["SIMPLE  = T", "BITPIX  = 16", "NAXIS   = 2", "NAXIS1  = 12", "NAXIS2  = 10"].map(str::to_owned).to_vec();
    for card in cards {
        let keyword = card.split('=').next().unwrap();
        match header.iter_mut().find(|there| there.split('=').next() == Some(keyword)) {
            Some(there) => (*card).clone_into(there),
            None => header.push((*card).to_owned()),
        }
    }
    header.push("END".to_owned());
    let mut bytes: Vec<u8> = header.iter().flat_map(|card| format!("{card:<80}").into_bytes()).collect();
    bytes.resize(bytes.len().next_multiple_of(2880), b' ');
    bytes.extend_from_slice(data);
    bytes.resize(bytes.len().next_multiple_of(2880), 0);
    bytes
}

/// 120 counts, big-endian: 0, 1, 2, …
pub(super) fn counts() -> Vec<u8> {
    (0..120_i16).flat_map(i16::to_be_bytes).collect()
}

/// A grey PNG of that size.
pub(super) fn png(width: u32, height: u32) -> Vec<u8> {
    encoded(
        &image::DynamicImage::ImageLuma8(image::GrayImage::from_fn(width, height, |x, y| image::Luma([(x + 2 * y) as u8]))),
        image::ImageFormat::Png,
    )
}

pub(super) fn encoded(image: &image::DynamicImage, format: image::ImageFormat) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// A folder with these files.
pub(super) struct Folder(tempfile::TempDir);

impl Folder {
    pub(super) fn with(files: &[(&str, &[u8])]) -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        for (name, bytes) in files {
            folder.add(name, bytes);
        }
        folder
    }

    /// A manifest of a 12 × 10 px camera with this text behind its `[camera]` size.
    pub(super) fn with_manifest(text: &str, files: &[(&str, &[u8])]) -> Self {
        let folder = Self::with(files);
        folder.add("recording.toml", format!("format = \"star-recording/1\"\n[camera]\nwidth_px = 12\nheight_px = 10\n{text}").as_bytes());
        folder
    }

    pub(super) fn add(&self, name: &str, bytes: &[u8]) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }

    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub(super) fn root(&self) -> &Path {
        self.0.path()
    }

    pub(super) fn open(&self) -> Recording {
        Recording::open(&[self.root()]).unwrap()
    }

    pub(super) fn keep_going(&self) -> Recording {
        Recording::open_with(&[self.root()], OpenOptions { keep_going: true, ..OpenOptions::default() }).unwrap()
    }

    /// Opens and reads every frame; the sentence of the first fault.
    pub(super) fn fault(&self) -> String {
        fault(&[self.root().to_owned()])
    }
}

/// Opens and reads every frame; the sentence of the first fault.
pub(super) fn fault(paths: &[PathBuf]) -> String {
    let outcome = Recording::open(paths).and_then(|recording| {
        for frame in 0..recording.frames.len() {
            recording.load_frame(frame)?;
        }
        Ok(())
    });
    let sentence = outcome.map_or_else(|error| error.to_string(), |()| "nothing was found to be wrong".to_owned());
    assert!(!sentence.contains('\n'), "one sentence: {sentence}");
    sentence
}

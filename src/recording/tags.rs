//! TIFF directories: tags and their values, as TIFF, BigTIFF, EXIF and DNG share them.
//!
//! Source: TIFF 6.0 (1992), section 2; BigTIFF design (2004). Every number comes from a file that may be damaged: what leads out of it is
//! absent, and what is larger than can be meant is not read.

use std::collections::BTreeMap;
use std::io::{Read, Seek, SeekFrom};

/// Tags of a directory, at most.
const MAX_TAGS: u64 = 4096;
/// Bytes of one tag's values, at most.
const MAX_VALUE_BYTES: u64 = 1 << 24;
/// Directories that are followed from one to the next, at most.
const MAX_DIRECTORIES: usize = 10_000;

/// A file of tags.
pub(super) struct Tags<R> {
    from: R,
    little: bool,
    big: bool,
    /// Where the first directory stands.
    pub(super) first: u64,
}

/// A directory.
#[derive(Debug, Default)]
pub(super) struct Directory {
    entries: BTreeMap<u16, Entry>,
    /// Where the next one stands; 0 if there is none.
    pub(super) next: u64,
}

/// A tag's values, not yet read.
#[derive(Clone, Copy, Debug)]
struct Entry {
    kind: u16,
    count: u64,
    at: u64,
}

impl Entry {
    /// Bytes of one value.
    fn width(self) -> Option<u64> {
        Some(match self.kind {
            1 | 2 | 6 | 7 => 1,
            3 | 8 => 2,
            4 | 9 | 11 | 13 => 4,
            5 | 10 | 12 | 16 | 17 | 18 => 8,
            _ => return None,
        })
    }
}

impl<R: Read + Seek> Tags<R> {
    /// Begins; `None` if it does not begin like a TIFF file.
    pub(super) fn open(from: R) -> Option<Self> {
        let mut tags = Self { from, little: true, big: false, first: 0 };
        let head: [u8; 4] = tags.bytes_at(0)?;
        (tags.little, tags.big) = match &head {
            b"II\x2A\0" => (true, false),
            b"MM\0\x2A" => (false, false),
            b"II\x2B\0" => (true, true),
            b"MM\0\x2B" => (false, true),
            _ => return None,
        };
        tags.first = tags.offset_at(if tags.big { 8 } else { 4 })?;
        Some(tags)
    }

    fn bytes_at<const N: usize>(&mut self, at: u64) -> Option<[u8; N]> {
        let mut bytes = [0; N];
        self.from.seek(SeekFrom::Start(at)).ok()?;
        self.from.read_exact(&mut bytes).ok()?;
        Some(bytes)
    }

    fn whole(&self, bytes: &[u8]) -> u64 {
        let joined = |all: u64, byte: &u8| all << 8 | u64::from(*byte);
        if self.little { bytes.iter().rev().fold(0, joined) } else { bytes.iter().fold(0, joined) }
    }

    fn offset_at(&mut self, at: u64) -> Option<u64> {
        if self.big {
            self.bytes_at::<8>(at).map(|bytes| self.whole(&bytes))
        } else {
            self.bytes_at::<4>(at).map(|bytes| self.whole(&bytes))
        }
    }

    /// The directory at this place.
    pub(super) fn directory(&mut self, at: u64) -> Option<Directory> {
        let (head, length, inline) = if self.big { (8, 20, 8) } else { (2, 12, 4) };
        let count = if self.big { self.offset_at(at)? } else { self.bytes_at::<2>(at).map(|bytes| self.whole(&bytes))? };
        if count > MAX_TAGS {
            return None;
        }
        let mut directory = Directory::default();
        for index in 0..count {
            let start = at.checked_add(head + length * index)?;
            let [tag, kind] = [0, 2].map(|offset| self.bytes_at::<2>(start + offset).map(|bytes| self.whole(&bytes) as u16));
            let mut entry = Entry { kind: kind?, count: self.offset_at(start + 4)?, at: start + 4 + inline };
            if entry.width().and_then(|width| width.checked_mul(entry.count)).is_none_or(|bytes| bytes > inline) {
                entry.at = self.offset_at(entry.at)?;
            }
            directory.entries.entry(tag?).or_insert(entry);
        }
        directory.next = self.offset_at(at.checked_add(head + length * count)?).unwrap_or(0);
        Some(directory)
    }

    /// How many directories follow one another from the first; counted as far as they can be read.
    pub(super) fn count(&mut self) -> usize {
        let mut seen = std::collections::BTreeSet::new();
        let mut next = self.first;
        while next != 0 && seen.len() < MAX_DIRECTORIES && seen.insert(next) {
            match self.directory(next) {
                Some(directory) => next = directory.next,
                None => return seen.len().saturating_sub(1).max(1),
            }
        }
        seen.len()
    }

    /// The bytes of a tag's values.
    fn value_bytes(&mut self, directory: &Directory, tag: u16) -> Option<(Entry, Vec<u8>)> {
        let entry = *directory.entries.get(&tag)?;
        let length = entry.width()?.checked_mul(entry.count).filter(|length| *length <= MAX_VALUE_BYTES)?;
        self.from.seek(SeekFrom::Start(entry.at)).ok()?;
        let mut bytes = Vec::new();
        self.from.by_ref().take(length).read_to_end(&mut bytes).ok()?;
        (bytes.len() as u64 == length).then_some((entry, bytes))
    }

    /// A tag's values as numbers; `None` if it is absent, no number, or outside the file.
    pub(super) fn numbers(&mut self, directory: &Directory, tag: u16) -> Option<Vec<f64>> {
        let (entry, bytes) = self.value_bytes(directory, tag)?;
        let width = entry.width()? as usize;
        let ratio = |top: f64, bottom: f64| if bottom == 0.0 { f64::NAN } else { top / bottom };
        let number = |value: &[u8]| {
            let whole = self.whole(value);
            let half = |value: &[u8]| self.whole(value);
            match entry.kind {
                5 => ratio(half(&value[..4]) as f64, half(&value[4..]) as f64),
                6 => f64::from((whole as u8).cast_signed()),
                8 => f64::from((whole as u16).cast_signed()),
                9 => f64::from((whole as u32).cast_signed()),
                10 => ratio(f64::from((half(&value[..4]) as u32).cast_signed()), f64::from((half(&value[4..]) as u32).cast_signed())),
                11 => f64::from(f32::from_bits(whole as u32)),
                12 => f64::from_bits(whole),
                17 => whole.cast_signed() as f64,
                _ => whole as f64,
            }
        };
        Some(bytes.chunks_exact(width).map(number).collect())
    }

    /// A tag's first value, if it is finite.
    pub(super) fn number(&mut self, directory: &Directory, tag: u16) -> Option<f64> {
        self.numbers(directory, tag)?.first().copied().filter(|number| number.is_finite())
    }

    /// A tag's text up to its first NUL, without blanks around it.
    pub(super) fn text(&mut self, directory: &Directory, tag: u16) -> Option<String> {
        let (entry, bytes) = self.value_bytes(directory, tag)?;
        let bytes = bytes.split(|byte| *byte == 0).next()?;
        let text = String::from_utf8_lossy(bytes).trim().to_owned();
        (entry.kind == 2 && !text.is_empty()).then_some(text)
    }
}

//! Numbers of frames: which split, recording, camera and shard a frame belongs to.

use super::recipe::{SizeTable, SplitCounts};

/// Numbers of a split begin at its rank times this, so that a split that grows changes no number of another.
const FRAMES_OF_A_SPLIT: u64 = 100_000_000;
/// The same for camera instances.
const CAMERAS_OF_A_SPLIT: u64 = 10_000;

/// A part of a dataset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum DatasetSplit {
    /// For training.
    Train,
    /// To choose by.
    Validation,
    /// To judge by.
    Test,
}

impl DatasetSplit {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Train, Self::Validation, Self::Test];

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Validation => "validation",
            Self::Test => "test",
        }
    }

    /// Its place among them.
    #[must_use]
    pub fn rank(self) -> usize {
        self as usize
    }
}

impl SplitCounts {
    /// The number of a split.
    #[must_use]
    pub fn of(&self, split: DatasetSplit) -> u64 {
        match split {
            DatasetSplit::Train => self.train,
            DatasetSplit::Validation => self.validation,
            DatasetSplit::Test => self.test,
        }
    }
}

/// A frame: its split, and its number there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FrameKey {
    /// The split.
    pub split: DatasetSplit,
    /// Its number in the split, from 0.
    pub index: u64,
}

impl FrameKey {
    /// The number that it goes by in the dataset: 9 digits, of which the first is the rank of the split.
    #[must_use]
    pub fn number(self) -> u64 {
        self.split.rank() as u64 * FRAMES_OF_A_SPLIT + self.index
    }

    /// The frame of a number; `None`: the recipe has no such.
    #[must_use]
    pub fn of_number(number: u64, frames: &SplitCounts) -> Option<Self> {
        let split = *DatasetSplit::ALL.get(usize::try_from(number / FRAMES_OF_A_SPLIT).ok()?)?;
        let index = number % FRAMES_OF_A_SPLIT;
        (index < frames.of(split)).then_some(Self { split, index })
    }

    /// Its recording in the split.
    #[must_use]
    pub fn recording(self, size: &SizeTable) -> u64 {
        self.index / size.frames_per_recording
    }

    /// The number that its recording goes by.
    #[must_use]
    pub fn recording_number(self, size: &SizeTable) -> u64 {
        self.split.rank() as u64 * FRAMES_OF_A_SPLIT + self.recording(size)
    }

    /// Its camera instance among those of its split: recordings take turns.
    #[must_use]
    pub fn camera(self, size: &SizeTable, cameras: &SplitCounts) -> u64 {
        self.recording(size) % cameras.of(self.split).max(1)
    }

    /// The number that its camera instance goes by.
    #[must_use]
    pub fn camera_number(self, size: &SizeTable, cameras: &SplitCounts, are_apart: bool) -> u64 {
        let first = if are_apart { self.split.rank() as u64 * CAMERAS_OF_A_SPLIT } else { 0 };
        first + self.camera(size, cameras)
    }
}

/// The largest number of frames that a split may have.
pub(super) const MAX_FRAMES: u64 = FRAMES_OF_A_SPLIT;
/// The largest number of camera instances.
pub(super) const MAX_CAMERAS: u64 = CAMERAS_OF_A_SPLIT;

/// A shard: its split, and its number there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ShardKey {
    /// The split.
    pub split: DatasetSplit,
    /// Its number in the split, from 0.
    pub index: u64,
}

impl ShardKey {
    /// All shards in order.
    #[must_use]
    pub fn all(size: &SizeTable) -> Vec<Self> {
        let of_split = |split: DatasetSplit| (0..size.frames.of(split) / size.frames_per_shard).map(move |index| Self { split, index });
        DatasetSplit::ALL.into_iter().flat_map(of_split).collect()
    }

    /// Its frames in order.
    pub fn frames(self, size: &SizeTable) -> impl Iterator<Item = FrameKey> + use<> {
        let first = self.index * size.frames_per_shard;
        (first..first + size.frames_per_shard).map(move |index| FrameKey { split: self.split, index })
    }

    /// Its file below the folder of the dataset.
    #[must_use]
    pub fn file(self) -> String {
        format!("{}/{:06}.tar", self.split.name(), self.index)
    }

    /// The file of a table of it: `frames` or `stars`.
    #[must_use]
    pub fn table(self, name: &str) -> String {
        format!("tables/{}/{:06}.{name}.parquet", self.split.name(), self.index)
    }

    /// The file of its mark.
    #[must_use]
    pub fn mark(self) -> String {
        format!("shards/{}-{:06}.json", self.split.name(), self.index)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn size() -> SizeTable {
        toml::from_str("frames = { train = 12, test = 6 }\nframes_per_shard = 3\nframes_per_recording = 2").unwrap()
    }

    #[test]
    fn numbers_lead_back_to_their_frames() {
        let size = size();
        for shard in ShardKey::all(&size) {
            for key in shard.frames(&size) {
                assert_eq!(FrameKey::of_number(key.number(), &size.frames), Some(key));
            }
        }
        assert_eq!(ShardKey::all(&size).len(), 6);
        assert_eq!(ShardKey::all(&size)[5].file(), "test/000001.tar");
        assert_eq!(FrameKey { split: DatasetSplit::Test, index: 5 }.number(), 200_000_005);
        for absent in [12, 100_000_000, 200_000_006, 300_000_000, u64::MAX] {
            assert_eq!(FrameKey::of_number(absent, &size.frames), None, "{absent}");
        }
    }

    #[test]
    fn recordings_take_turns_with_cameras() {
        let (size, cameras) = (size(), SplitCounts { train: 4, validation: 0, test: 2 });
        let camera = |split, index| FrameKey { split, index }.camera_number(&size, &cameras, true);
        assert_eq!((0..10).map(|index| camera(DatasetSplit::Train, index)).collect::<Vec<_>>(), [0, 0, 1, 1, 2, 2, 3, 3, 0, 0]);
        assert_eq!(
            (0..6).map(|index| camera(DatasetSplit::Test, index)).collect::<Vec<_>>(),
            [20_000, 20_000, 20_001, 20_001, 20_000, 20_000]
        );
        assert_eq!(FrameKey { split: DatasetSplit::Test, index: 2 }.camera_number(&size, &cameras, false), 1);
    }
}

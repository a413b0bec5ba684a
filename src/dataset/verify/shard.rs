//! A shard held against its mark, its labels, and the recipe.

use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

use sha2::{Digest, Sha256};

use super::labels::{LabelMeasure, good_stars, needs_images};
use super::masks::MaskMeasure;
use super::result::{Remake, SeenFrame, VerifyCheck, VerifyFault};
use crate::dataset::folder::DatasetFile;
use crate::dataset::frame_key::{FrameKey, ShardKey};
use crate::dataset::frame_scene::tai_s;
use crate::dataset::image_files::read_image;
use crate::dataset::plan::hexadecimal;
use crate::dataset::recipe::SampleMember;
use crate::dataset::run::DatasetProgress;
use crate::dataset::sample_labels::SampleLabels;
use crate::dataset::samples::{Sample, samples_of};
use crate::dataset::shard::{ShardMark, ShardTables};
use crate::dataset::table_columns::TableWriter;
use crate::recording::low_byte_first;
use crate::render::StarsAlone;

/// A shard that is looked at, and what was found.
pub(super) struct ShardCheck<'a> {
    folder: &'a Path,
    dataset: &'a DatasetFile,
    shard: ShardKey,
    writer: &'a dyn TableWriter,
    pub(super) faults: Vec<VerifyFault>,
    pub(super) seen: Vec<SeenFrame>,
    pub(super) labels: LabelMeasure,
    pub(super) masks: MaskMeasure,
    pub(super) bytes: u64,
    pub(super) rendered: u64,
}

/// A file that is hashed while it is read.
struct HashedRead<R> {
    inner: R,
    hasher: Sha256,
    bytes: u64,
}

impl<R: Read> Read for HashedRead<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.inner.read(buffer)?;
        self.hasher.update(&buffer[..count]);
        self.bytes += count as u64;
        Ok(count)
    }
}

impl<'a> ShardCheck<'a> {
    pub(super) fn new(folder: &'a Path, dataset: &'a DatasetFile, shard: ShardKey, writer: &'a dyn TableWriter) -> Self {
        Self {
            folder,
            dataset,
            shard,
            writer,
            faults: Vec::new(),
            seen: Vec::new(),
            labels: LabelMeasure::default(),
            masks: MaskMeasure::default(),
            bytes: 0,
            rendered: 0,
        }
    }

    fn fault(&mut self, check: VerifyCheck, fault: String) {
        self.faults.push(VerifyFault { check, fault });
    }

    /// Looks at it; frames of `chosen` are made again, if they can be, and their labels held against their pixels.
    pub(super) fn run(&mut self, chosen: &[FrameKey], remake: Option<&Remake<'_>>, progress: &dyn DatasetProgress) {
        let (name, path) = (self.shard.file(), self.folder.join(self.shard.file()));
        let file = match File::open(&path) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return self.fault(
                    VerifyCheck::Files,
                    format!(
                        "{name} is missing; make it again with `boresight dataset {}/recipe.toml -o {}`",
                        self.folder.display(),
                        self.folder.display()
                    ),
                );
            }
            Err(error) => return self.fault(VerifyCheck::Files, format!("{name} cannot be read ({error})")),
        };
        let mark = self.mark();
        let mut hashed = HashedRead { inner: BufReader::with_capacity(1 << 18, file), hasher: Sha256::new(), bytes: 0 };
        let tables = self.samples(&mut hashed, chosen, remake, progress);
        // What stands behind the end of the archive counts too.
        if let Err(error) = io::copy(&mut hashed, &mut io::sink()) {
            self.fault(VerifyCheck::Files, format!("{name} cannot be read ({error})"));
        }
        self.bytes = hashed.bytes;
        let Some(mark) = mark else { return };
        if hashed.bytes != mark.bytes {
            self.fault(VerifyCheck::Files, format!("{name} has {} bytes and not the {} of its mark", hashed.bytes, mark.bytes));
        } else if hexadecimal(&hashed.hasher.finalize()) != mark.sha256 {
            self.fault(VerifyCheck::Files, format!("{name} is not the file that its mark has the hash of"));
        }
        self.tables(&mark, tables);
    }

    /// The mark of the shard.
    fn mark(&mut self) -> Option<ShardMark> {
        let name = self.shard.mark();
        let read = std::fs::read_to_string(self.folder.join(&name)).map_err(|error| format!("cannot be read ({error})"));
        let mark =
            read.and_then(|text| serde_json::from_str::<ShardMark>(&text).map_err(|error| format!("is no mark of a shard: {error}")));
        match mark {
            Ok(mark) if mark.recipe_sha256 == self.dataset.recipe_sha256 => Some(mark),
            Ok(_) => {
                self.fault(VerifyCheck::Files, format!("{name} is the mark of a shard of another recipe"));
                None
            }
            Err(what) => {
                self.fault(VerifyCheck::Files, format!("{name} {what}"));
                None
            }
        }
    }

    /// Looks at every sample; gives the tables that follow from the labels.
    fn samples<R: Read>(
        &mut self,
        archive: R,
        chosen: &[FrameKey],
        remake: Option<&Remake<'_>>,
        progress: &dyn DatasetProgress,
    ) -> Option<ShardTables<'a>> {
        let name = self.shard.file();
        let members = members(self.dataset);
        let mut tables = Some(ShardTables::new(self.writer));
        let first = self.shard.index * self.dataset.frames_per_shard;
        let mut expected = first..first + self.dataset.frames_per_shard;
        for sample in samples_of(archive) {
            let sample = match sample {
                Ok(sample) => sample,
                Err(error) => {
                    self.fault(VerifyCheck::Samples, format!("{name} cannot be read to its end: {error}"));
                    return None;
                }
            };
            let own = expected.next().map(|index| FrameKey { split: self.shard.split, index });
            if own.map(FrameKey::number) != Some(sample.key) {
                let wanted = own.map_or_else(|| "no frame".to_owned(), |own| format!("the frame {:09}", own.number()));
                self.fault(VerifyCheck::Samples, format!("{name} has the frame {:09} where {wanted} belongs", sample.key));
                tables = None;
            }
            if sample.members.iter().map(|(name, _)| name.as_str()).ne(members.iter().copied()) {
                let found: Vec<&str> = sample.members.iter().map(|(name, _)| name.as_str()).collect();
                let told = format!("{name}: the frame {:09} has {} and not {}", sample.key, found.join(", "), members.join(", "));
                self.fault(VerifyCheck::Samples, told);
            }
            let is_chosen = own.filter(|own| own.number() == sample.key && chosen.binary_search(own).is_ok());
            if !self.sample(&sample, is_chosen, remake, &mut tables) {
                tables = None;
            }
            progress.frame();
        }
        if let Some(index) = expected.next() {
            let number = FrameKey { split: self.shard.split, index }.number();
            self.fault(VerifyCheck::Samples, format!("{name} ends before the frame {number:09}"));
            tables = None;
        }
        tables
    }

    /// Looks at a sample; `false` if its labels cannot be read.
    fn sample(
        &mut self,
        sample: &Sample,
        chosen: Option<FrameKey>,
        remake: Option<&Remake<'_>>,
        tables: &mut Option<ShardTables<'a>>,
    ) -> bool {
        let name = self.shard.file();
        let mut labels = match sample.labels() {
            Ok(labels) => labels,
            Err(what) => {
                self.fault(VerifyCheck::Samples, format!("{name}: {what}"));
                return false;
            }
        };
        if labels.lights.columns().iter().any(|(_, cells)| cells.len() != labels.lights.hip.len()) {
            self.fault(
                VerifyCheck::Samples,
                format!("{name}: the columns of the lights of the frame {:09} are of different lengths", sample.key),
            );
            return false;
        }
        if labels.key != sample.key || labels.split != self.shard.split.name() {
            let told =
                format!("{name}: the labels of the frame {:09} are those of the frame {:09} of {}", sample.key, labels.key, labels.split);
            self.fault(VerifyCheck::Samples, told);
        }
        let added = tables.as_mut().map(|tables| tables.add(&mut labels));
        if let Some(key) = chosen {
            self.pixels(sample, &labels, alone(&labels, key, remake).as_ref());
            if let Some(remake) = remake {
                self.remade(sample, key, remake);
            }
        }
        self.seen.push(SeenFrame {
            key: sample.key,
            shard: self.shard,
            camera: labels.camera,
            seed: labels.seed,
            time_s: tai_s(&labels.time_utc),
            boresight: labels.boresight(),
            pixels_sha256: labels.pixels_sha256,
        });
        !matches!(added, Some(Err(_)))
    }

    /// Holds labels against pixels.
    fn pixels(&mut self, sample: &Sample, labels: &SampleLabels, alone: Option<&StarsAlone>) {
        let name = self.shard.file();
        match read_image(sample) {
            Err(what) => self.fault(VerifyCheck::Samples, format!("{name}: {what}")),
            Ok(pixels) => {
                if hexadecimal(&Sha256::digest(low_byte_first(&pixels))) != labels.pixels_sha256 {
                    self.fault(
                        VerifyCheck::Samples,
                        format!("{name}: the counts of the frame {:09} are not those that its labels have the hash of", sample.key),
                    );
                }
                self.labels.add(labels, &pixels, alone);
            }
        }
        self.masks.add(labels, sample);
    }

    /// Makes a frame again.
    fn remade(&mut self, sample: &Sample, key: FrameKey, remake: &Remake<'_>) {
        let name = self.shard.file();
        match remake.plan.sample(remake.catalog, remake.psfs, key) {
            Err(error) => self.fault(VerifyCheck::Frames, format!("{name}: the frame {:09} cannot be made again: {error}", sample.key)),
            Ok(again) => {
                self.rendered += 1;
                let differs = |(name, bytes): &&(&'static str, Vec<u8>)| sample.member(name) != Some(bytes.as_slice());
                let other: Vec<&str> = again.members.iter().filter(differs).map(|(name, _)| *name).collect();
                if !other.is_empty() {
                    let told = format!("{name}: the frame {:09}, made again, has other bytes in {}", sample.key, other.join(", "));
                    self.fault(VerifyCheck::Frames, told);
                }
            }
        }
    }

    /// Holds the tables against those that follow from the labels.
    fn tables(&mut self, mark: &ShardMark, from_labels: Option<ShardTables<'a>>) {
        for table in &mark.tables {
            match std::fs::read(self.folder.join(&table.file)) {
                Err(error) => self.fault(VerifyCheck::Files, format!("{} cannot be read ({error})", table.file)),
                Ok(bytes) if hexadecimal(&Sha256::digest(&bytes)) != table.sha256 => {
                    self.fault(VerifyCheck::Files, format!("{} is not the file that the mark of its shard has the hash of", table.file));
                }
                Ok(_) => {}
            }
        }
        let again = from_labels.map(|tables| tables.files(self.shard));
        // What a build without tables makes says nothing.
        if let Some(Ok(files)) = again {
            for (file, _) in files.iter().filter(|(file, _)| !mark.tables.is_empty() && !mark.tables.contains(file)) {
                self.fault(VerifyCheck::Tables, format!("{} does not say what the labels of its shard say", file.file));
            }
        }
    }
}

/// The stars of a frame by themselves, where they are measured by them and can be rendered.
fn alone(labels: &SampleLabels, key: FrameKey, remake: Option<&Remake<'_>>) -> Option<StarsAlone> {
    let remake = remake.filter(|_| needs_images(labels))?;
    let stars = good_stars(labels);
    remake.plan.stars_alone(remake.catalog, remake.psfs, key, &|hip| stars.contains_key(&hip)).ok()
}

/// The members that every sample has, in order.
fn members(dataset: &DatasetFile) -> Vec<&'static str> {
    let more = dataset.members.iter().map(|member| match member {
        SampleMember::Mask => "mask.png",
        SampleMember::Distance => "distance.png",
        SampleMember::Instances => "instances.png",
        SampleMember::Clean => "clean.npy",
    });
    let mut members: Vec<&str> = [dataset.image.member(), "json"].into_iter().chain(more).collect();
    members.sort_unstable();
    members
}

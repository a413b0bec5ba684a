//! A dataset in the forms of other programs, shard by shard: memory is that of one sample and of the annotations of one shard.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use serde_json::Value;

use super::error::DatasetError;
use super::export_forms::{CocoShard, coco_head, satnet, yolo_head, yolo_lines};
use super::folder::{DatasetFile, DatasetFolder};
use super::frame_key::ShardKey;
use super::image_files::{fits_headers, png16, read_image};
use super::label_tables::{frame_columns, light_columns};
use super::run::DatasetProgress;
use super::sample_labels::SampleLabels;
use super::samples::{Sample, samples_of};
use super::table_columns::{TableCells, TableColumn, TableRows, TableWriter};
use crate::recording::{write_file, write_fits_u16};

/// A form that a dataset is written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportForm {
    /// COCO: `annotations/SPLIT-NNNNNN.json` for each shard, and `images/SPLIT/KEY.png`.
    Coco,
    /// YOLO: `labels/SPLIT/KEY.txt`, `images/SPLIT/KEY.png` and `data.yaml`.
    Yolo,
    /// FITS: `SPLIT/KEY.fits`, and `SPLIT/KEY.json` with the labels.
    Fits,
    /// Parquet: `data/SPLIT-NNNNNN.parquet` with image and labels of frames, and `stars/SPLIT-NNNNNN.parquet` with a row for each light.
    Parquet,
    /// SatNet, as SatSim writes it: `SPLIT/ImageFiles/KEY.fits` and `SPLIT/Annotations/KEY.json`.
    Satnet,
}

impl ExportForm {
    /// Whether every frame becomes files of its own.
    #[must_use]
    pub fn has_file_for_each_frame(self) -> bool {
        self != Self::Parquet
    }
}

/// What was written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ExportCounts {
    /// Frames.
    pub frames: u64,
    /// Lights with an annotation.
    pub lights: u64,
}

/// Writes a dataset in another form below `target`. A shard that is not made is an error.
pub fn export_dataset(
    folder: &Path,
    form: ExportForm,
    target: &Path,
    writer: &dyn TableWriter,
    progress: &dyn DatasetProgress,
) -> Result<ExportCounts, DatasetError> {
    let dataset = DatasetFile::read(folder)?;
    let marks = DatasetFolder { path: folder.to_owned() }.marks(&dataset)?;
    progress.begin(dataset.frames());
    let mut counts = ExportCounts::default();
    match form {
        ExportForm::Coco => json_file(&target.join("annotations/categories.json"), &coco_head(&dataset))?,
        ExportForm::Yolo => write_file(&target.join("data.yaml"), yolo_head(&dataset).as_bytes())?,
        _ => {}
    }
    for (shard, _) in &marks {
        let one = ShardExport { folder, target, form, shard: *shard, dataset: &dataset };
        let of_shard = one.run(writer, progress)?;
        counts.frames += of_shard.frames;
        counts.lights += of_shard.lights;
    }
    Ok(counts)
}

struct ShardExport<'a> {
    folder: &'a Path,
    target: &'a Path,
    form: ExportForm,
    shard: ShardKey,
    dataset: &'a DatasetFile,
}

impl ShardExport<'_> {
    fn run(&self, writer: &dyn TableWriter, progress: &dyn DatasetProgress) -> Result<ExportCounts, DatasetError> {
        let path = self.folder.join(self.shard.file());
        let unread = |source| DatasetError::Read { path: path.display().to_string(), source };
        let wrong = |message| DatasetError::Parse { path: path.display().to_string(), message };
        let file = BufReader::with_capacity(1 << 18, File::open(&path).map_err(unread)?);
        let (mut coco, mut counts) = (CocoShard::default(), ExportCounts::default());
        let (mut rows, mut stars) = (TableRows::new(writer), TableRows::new(writer));
        for sample in samples_of(file) {
            let sample = sample.map_err(unread)?;
            let mut labels = sample.labels().map_err(wrong)?;
            if labels.lights.columns().iter().any(|(_, cells)| cells.len() != labels.lights.hip.len()) {
                return Err(wrong(format!("the columns of the lights of the frame {:09} are of different lengths", sample.key)));
            }
            counts.frames += 1;
            counts.lights += match self.form {
                ExportForm::Coco => {
                    self.image_file(&sample, &labels, "images")?;
                    coco.add(self.shard.split.name(), &labels)
                }
                ExportForm::Yolo => {
                    self.image_file(&sample, &labels, "images")?;
                    let (lines, count) = yolo_lines(&labels);
                    write_file(&self.target.join(format!("labels/{}/{:09}.txt", self.shard.split.name(), sample.key)), lines.as_bytes())?;
                    count
                }
                ExportForm::Fits => {
                    let own = self.target.join(format!("{}/{:09}", self.shard.split.name(), sample.key));
                    self.fits_file(&sample, &labels, &own.with_extension("fits"))?;
                    write_file(&own.with_extension("json"), sample.member("json").unwrap_or_default())?;
                    labels.lights.hip.len() as u64
                }
                ExportForm::Satnet => {
                    let (split, name) = (self.target.join(self.shard.split.name()), format!("{:09}", sample.key));
                    self.fits_file(&sample, &labels, &split.join(format!("ImageFiles/{name}.fits")))?;
                    let (annotation, count) = satnet(&self.dataset.name, &labels);
                    json_file(&split.join(format!("Annotations/{name}.json")), &annotation)?;
                    count
                }
                ExportForm::Parquet => {
                    let count = labels.lights.hip.len() as u64;
                    let mut columns = frame_columns(&mut labels);
                    let image = vec![(self.png(&sample, &labels)?, format!("{:09}.png", sample.key))];
                    columns.insert(0, TableColumn { name: "image".to_owned(), cells: TableCells::Image(image) });
                    rows.add(columns).map_err(wrong)?;
                    stars.add(light_columns(sample.key, &labels.lights)).map_err(wrong)?;
                    count
                }
            };
            progress.frame();
        }
        let name = format!("{}-{:06}", self.shard.split.name(), self.shard.index);
        match self.form {
            ExportForm::Coco => json_file(&self.target.join(format!("annotations/{name}.json")), &coco.object(self.dataset))?,
            ExportForm::Parquet => {
                for (folder, rows) in [("data", rows), ("stars", stars)] {
                    match rows.finish().map_err(wrong)? {
                        Some(bytes) => write_file(&self.target.join(format!("{folder}/{name}.parquet")), &bytes)?,
                        None => return Err(wrong("this build writes no Parquet: it was compiled without the feature parquet".to_owned())),
                    }
                }
            }
            _ => {}
        }
        Ok(counts)
    }

    fn counts(&self, sample: &Sample, labels: &SampleLabels) -> Result<Vec<u16>, DatasetError> {
        let wrong = |message| DatasetError::Parse { path: self.folder.join(self.shard.file()).display().to_string(), message };
        let pixels = read_image(sample).map_err(wrong)?;
        let [width_px, height_px] = labels.size_px;
        if pixels.len() == width_px.saturating_mul(height_px) {
            Ok(pixels)
        } else {
            Err(wrong(format!("the frame {:09} has {} pixels and not {width_px} × {height_px}", sample.key, pixels.len())))
        }
    }

    /// The image as PNG of 16 bits: as it is, or of an array.
    fn png(&self, sample: &Sample, labels: &SampleLabels) -> Result<Vec<u8>, DatasetError> {
        match sample.member("image.png") {
            Some(bytes) => Ok(bytes.to_vec()),
            None => png16(sample.key, labels.size_px, &self.counts(sample, labels)?),
        }
    }

    fn image_file(&self, sample: &Sample, labels: &SampleLabels, folder: &str) -> Result<(), DatasetError> {
        let path = self.target.join(format!("{folder}/{}/{:09}.png", self.shard.split.name(), sample.key));
        Ok(write_file(&path, &self.png(sample, labels)?)?)
    }

    fn fits_file(&self, sample: &Sample, labels: &SampleLabels, path: &Path) -> Result<(), DatasetError> {
        let [width_px, height_px] = labels.size_px;
        Ok(write_fits_u16(path, width_px, height_px, &self.counts(sample, labels)?, &fits_headers(labels))?)
    }
}

fn json_file(path: &Path, object: &Value) -> Result<(), DatasetError> {
    Ok(write_file(path, format!("{object}\n").as_bytes())?)
}

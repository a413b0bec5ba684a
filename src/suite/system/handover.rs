//! Frames as files for the system under test: images, and the truth where the suite asks for it.

use std::path::{Path, PathBuf};

use serde_json::json;
use tempfile::TempDir;

use super::super::error::SuiteError;
use super::super::frames::{FrameBatch, HandedFrame};
use super::super::images::{file_form, write_scaled};
use super::super::suite_file::{SystemImage, SystemTable};
use crate::recording::FitsHeaders;
use crate::scene::{declared_entry, declared_recording};

/// A folder for the files of a batch of frames, which goes with it.
#[derive(Debug)]
pub(in crate::suite) struct Handover<'a> {
    pub(super) folder: TempDir,
    table: &'a SystemTable,
    pub(super) size_px: [usize; 2],
    top_dn: f64,
    headers: Vec<FitsHeaders>,
    camera: serde_json::Value,
    tells_truth: bool,
}

impl<'a> Handover<'a> {
    pub(super) fn new(table: &'a SystemTable, batch: &FrameBatch) -> Result<Self, SuiteError> {
        let scene = &batch.scene;
        // Memory, where the machine has such a folder: files are read once.
        let shared = Path::new("/dev/shm");
        let made = if shared.is_dir() {
            tempfile::Builder::new().prefix("boresight-").tempdir_in(shared).or_else(|_| tempfile::tempdir())
        } else {
            tempfile::tempdir()
        };
        let folder = made.map_err(|source| SuiteError::Write { path: "a folder for images".to_owned(), source })?;
        let recording = declared_recording(scene);
        let header = |number| FitsHeaders::new(&recording.camera, recording.site.as_ref(), &declared_entry(scene, number));
        let headers = (0..scene.exposures.len()).map(header).collect();
        let camera = json!({
            "width_px": scene.nominal.width_px, "height_px": scene.nominal.height_px, "focal_length_px": scene.nominal.focal_length_px,
            "principal_point_px": scene.nominal.principal_point_px, "k1": scene.nominal.k1,
        });
        Ok(Self {
            folder,
            table,
            size_px: [scene.camera.width_px, scene.camera.height_px],
            top_dn: scene.detector.joined(scene.binning).top_dn(),
            headers,
            camera,
            tells_truth: table.command.iter().any(|word| word.contains("{truth}")),
        })
    }

    /// What the image of a frame is called within its folder.
    pub(super) fn image_name(&self, number: usize) -> String {
        format!("{number:06}.{}", file_form(self.table.image).ending())
    }

    /// Writes the image of a frame.
    pub(super) fn write_image(&self, folder: &Path, frame: &HandedFrame) -> Result<PathBuf, SuiteError> {
        let path = folder.join(self.image_name(frame.number));
        let Self { table, size_px, top_dn, headers, .. } = self;
        write_scaled(&path, *size_px, &frame.pixels_dn, (table.image, *top_dn, table.scaling.as_ref()), &headers[frame.in_scene])?;
        if table.image == SystemImage::Raw16 {
            let [width_px, height_px] = size_px;
            let head = json!({"width_px": width_px, "height_px": height_px, "type": "uint16", "byte_order": "little", "first_row": "top"});
            write(&path.with_extension("json"), head.to_string().as_bytes())?;
        }
        Ok(path)
    }

    /// Writes what is true of a frame, if the suite hands it over.
    pub(super) fn write_truth(&self, folder: &Path, frame: &HandedFrame) -> Result<Option<PathBuf>, SuiteError> {
        if !self.tells_truth {
            return Ok(None);
        }
        let path = folder.join(format!("{:06}.truth.json", frame.number));
        write(&path, self.truth(frame).to_string().as_bytes())?;
        Ok(Some(path))
    }

    /// What is true of a frame: for programs that try the harness itself.
    fn truth(&self, frame: &HandedFrame) -> serde_json::Value {
        let stars: Vec<serde_json::Value> = frame
            .truth
            .stars
            .iter()
            .map(|star| json!([star.x_mean_px, star.y_mean_px, star.electrons_landed, star.hip, star.snr]))
            .collect();
        json!({
            "frame": frame.number, "camera_from_icrs": frame.truth.attitude, "velocity_km_s": frame.truth.velocity_km_s,
            "time_utc": frame.truth.time.map(|time| time.to_isoformat() + "Z"), "exposure_s": frame.truth.exposure_s,
            "camera": self.camera, "stars": stars,
        })
    }
}

pub(super) fn write(path: &Path, bytes: &[u8]) -> Result<(), SuiteError> {
    std::fs::write(path, bytes).map_err(|source| SuiteError::Write { path: path.display().to_string(), source })
}

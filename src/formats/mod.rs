//! The files that the program reads and writes: what each is called, its format string and its JSON Schema.
//!
//! The schemas lie in `schemas/`, one file each. They are made of the very types that are written ([`schema_of_type`]), and a test holds each file
//! against its type, so that a schema cannot say anything else; only the file is part of the program, since the code that makes it is thirty times as large.
//! Results may have more keys than their schema names: within a number N of `boresight-<verb>/N` keys are added, and none is removed or changes its
//! meaning.

mod schema_of_type;

use serde_json::Value;

use crate::blind::SCORE_FORMAT;
use crate::calibrate::{COMPARE_FORMAT, FORMAT as CALIBRATE_FORMAT, MAP_FORMAT, SEQUENTIAL_FORMAT};
use crate::catalog;
use crate::dataset::{DATASET_FORMAT, RECIPE_FORMAT, SAMPLE_FORMAT, SHARD_FORMAT, VERIFY_FORMAT};
use crate::detect::FORMAT as DETECT_FORMAT;
use crate::diagnose::FORMAT as DIAGNOSE_FORMAT;
use crate::effects::LIST_FORMAT;
use crate::exchange::{EXPORT_FORMAT, IMPORT_FORMAT};
use crate::identify::FORMAT as IDENTIFY_FORMAT;
use crate::imaging::DOCTOR_FORMAT;
use crate::pipeline::RUN_FORMAT;
use crate::recording::{FORMAT as RECORDING_FORMAT, STAR_LIST_FORMAT};
use crate::render::{SIGNATURE_FORMAT, SIMULATE_FORMAT, TRUTH_FORMAT};
use crate::scene::{self, PRESET_FORMAT};
use crate::suite::{SUITE_FORMAT, TEST_FORMAT};

pub use schema_of_type::schema_of_type;

/// One kind of file, or what a verb prints with `--json`.
#[derive(Clone, Copy, Debug)]
pub struct FileFormat {
    /// What `boresight schema` calls it: the verb, or the file.
    pub name: &'static str,
    /// The format string, the value of its key `format` if it has one.
    pub format: &'static str,
    /// What it is, in a few words.
    pub what: &'static str,
    /// The file in `schemas/`; a scene's schema has the effects of the build in it, so it is put together when it is asked for.
    text: Option<&'static str>,
}

impl FileFormat {
    /// Its JSON Schema (draft 2020-12).
    #[must_use]
    pub fn schema(&self) -> Value {
        // A test reads every file.
        self.text.map_or_else(scene::schema, |text| serde_json::from_str(text).unwrap_or_default())
    }
}

/// A row of the table; its schema is the file of its name, without spaces (build.rs).
macro_rules! row {
    ($name:literal, $format:expr, $what:literal) => {
        FileFormat {
            name: $name,
            format: $format,
            what: $what,
            text: Some(include_str!(concat!(env!("OUT_DIR"), "/schemas/", $name, ".json"))),
        }
    };
}

/// All of them: results in the order of the verbs, then what people write.
pub static FORMATS: &[FileFormat] = &[
    row!("simulate", SIMULATE_FORMAT, "what was rendered, and where it is"),
    row!("truth", TRUTH_FORMAT, "truth/truth.json beside a simulated recording"),
    row!("dataset", DATASET_FORMAT, "dataset.json of a dataset: what it is"),
    row!("shard", SHARD_FORMAT, "the mark of a shard of a dataset that is whole"),
    row!("sample", SAMPLE_FORMAT, "labels of a frame of a dataset"),
    row!("verify", VERIFY_FORMAT, "what dataset verify found"),
    row!("detect", DETECT_FORMAT, "the stars of a recording"),
    row!("identify", IDENTIFY_FORMAT, "which stars they are"),
    row!("calibrate", CALIBRATE_FORMAT, "a camera, or why there is none"),
    row!("update", SEQUENTIAL_FORMAT, "sequential.json of calibrate --update"),
    row!("diagnose", DIAGNOSE_FORMAT, "what the model lacks, or why nobody can tell"),
    row!("map", MAP_FORMAT, "pixel to direction on a grid"),
    row!("compare", COMPARE_FORMAT, "two calibrations side by side"),
    row!("export", EXPORT_FORMAT, "a camera in the format of another program"),
    row!("import", IMPORT_FORMAT, "the camera of another program"),
    row!("run", RUN_FORMAT, "a simulated night against its truth"),
    row!("demo", RUN_FORMAT, "the same of the built-in scene"),
    row!("test", TEST_FORMAT, "a star tracker against requirements"),
    row!("catalog-import", catalog::IMPORT_FORMAT, "a catalogue that was made"),
    row!("blind", SCORE_FORMAT, "the steps of the benchmark"),
    row!("effects", LIST_FORMAT, "the effects of this build"),
    row!("signature", SIGNATURE_FORMAT, "effects --signature: what an effect on pixels does to stars"),
    row!("preset", PRESET_FORMAT, "scenes of real cameras"),
    row!("doctor", DOCTOR_FORMAT, "GPU adapters, and whether they can be trusted"),
    FileFormat { name: "scene", format: scene::FORMAT, what: "a scene file", text: None },
    row!("suite", SUITE_FORMAT, "requirements of a star tracker"),
    row!("recipe", RECIPE_FORMAT, "a recipe of a dataset"),
    row!("recording", RECORDING_FORMAT, "recording.toml"),
    row!("star-list", STAR_LIST_FORMAT, "the lines of a star list (CSV), columns as keys"),
];

/// The format of this name.
#[must_use]
pub fn file_format(name: &str) -> Option<&'static FileFormat> {
    FORMATS.iter().find(|format| format.name == name)
}

//! The files that the program reads and writes: what each is called, its format string and its JSON Schema.
//!
//! The schema of a result is made of the very type that is written, so it cannot say anything else. Results may have more keys than their
//! schema names: within a number N of `boresight-<verb>/N` keys are added, and none is removed or changes its meaning.

use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value, json};

#[cfg(feature = "bench")]
use crate::blind::{BlindResult, SCORE_FORMAT};
use crate::calibrate::{
    COMPARE_FORMAT, CalibrateResult, CompareResult, FORMAT as CALIBRATE_FORMAT, MAP_FORMAT, MapResult, SEQUENTIAL_FORMAT, UpdateResult,
};
use crate::catalog;
use crate::dataset::{
    DATASET_FORMAT, DatasetFile, RECIPE_FORMAT, RecipeFile, SAMPLE_FORMAT, SHARD_FORMAT, SampleLabels, ShardMark, VERIFY_FORMAT,
    VerifyResult,
};
use crate::detect::{DetectResult, FORMAT as DETECT_FORMAT};
use crate::diagnose::{DiagnoseResult, FORMAT as DIAGNOSE_FORMAT};
use crate::effects::{EffectList, LIST_FORMAT};
use crate::exchange::{EXPORT_FORMAT, ExportResult, IMPORT_FORMAT, ImportResult};
use crate::identify::{FORMAT as IDENTIFY_FORMAT, IdentifyResult};
use crate::imaging::{DOCTOR_FORMAT, DoctorResult};
use crate::pipeline::{RUN_FORMAT, RunResult};
use crate::recording::{FORMAT as RECORDING_FORMAT, RecordingFile, STAR_LIST_FORMAT, StarListRow};
use crate::render::{SIGNATURE_FORMAT, SIMULATE_FORMAT, SignatureResult, SimulateResult, SimulatedTruth, TRUTH_FORMAT};
use crate::scene::{self, PRESET_FORMAT, PresetList};
#[cfg(feature = "bench")]
use crate::suite::{SUITE_FORMAT, SuiteFile, SuiteResult, TEST_FORMAT};

/// One kind of file, or what a verb prints with `--json`.
#[derive(Clone, Copy, Debug)]
pub struct FileFormat {
    /// What `boresight schema` calls it: the verb, or the file.
    pub name: &'static str,
    /// The format string, the value of its key `format` if it has one.
    pub format: &'static str,
    /// What it is, in a few words.
    pub what: &'static str,
    make: fn(&Self) -> Value,
}

impl FileFormat {
    /// Its JSON Schema (draft 2020-12).
    #[must_use]
    pub fn schema(&self) -> Value {
        (self.make)(self)
    }

    const fn of_result<T: JsonSchema>(name: &'static str, format: &'static str, what: &'static str) -> Self {
        Self { name, format, what, make: |own| own.entitled(generated::<T>(SchemaSettings::draft2020_12().for_serialize())) }
    }

    const fn of_input<T: JsonSchema>(name: &'static str, format: &'static str, what: &'static str) -> Self {
        Self { name, format, what, make: |own| own.entitled(generated::<T>(SchemaSettings::draft2020_12().for_deserialize())) }
    }

    /// The schema with its name, and with the only value that `format` may have.
    fn entitled(&self, mut schema: Value) -> Value {
        for place in std::iter::once(String::new()).chain(variants(&schema)) {
            if let Some(format) = schema.pointer_mut(&format!("{place}/properties/format")).and_then(Value::as_object_mut) {
                format.insert("const".to_owned(), json!(self.format));
            }
        }
        let head = [("$id", self.format.to_owned()), ("title", format!("{}: {} ({})", self.name, self.what, self.format))];
        let mut named: Map<String, Value> = head.into_iter().map(|(key, text)| (key.to_owned(), Value::String(text))).collect();
        if let Value::Object(own) = schema {
            named.extend(own.into_iter().filter(|(key, _)| key != "title"));
        }
        Value::Object(named)
    }
}

fn generated<T: JsonSchema>(settings: SchemaSettings) -> Value {
    settings.into_generator().into_root_schema_for::<T>().to_value()
}

/// Where the forms stand that a result may have, if it has several.
fn variants(schema: &Value) -> Vec<String> {
    let forms = schema.get("anyOf").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    let place = |(index, form): (usize, &Value)| match form.get("$ref").and_then(Value::as_str) {
        Some(target) => target.trim_start_matches('#').to_owned(),
        None => format!("/anyOf/{index}"),
    };
    forms.iter().enumerate().map(place).collect()
}

/// All of them: results in the order of the verbs, then what people write.
pub static FORMATS: &[FileFormat] = &[
    FileFormat::of_result::<SimulateResult>("simulate", SIMULATE_FORMAT, "what was rendered, and where it is"),
    FileFormat::of_result::<SimulatedTruth<'static>>("truth", TRUTH_FORMAT, "truth/truth.json beside a simulated recording"),
    FileFormat::of_result::<DatasetFile>("dataset", DATASET_FORMAT, "dataset.json of a dataset: what it is"),
    FileFormat::of_result::<ShardMark>("shard", SHARD_FORMAT, "the mark of a shard of a dataset that is whole"),
    FileFormat::of_result::<SampleLabels>("sample", SAMPLE_FORMAT, "labels of a frame of a dataset"),
    FileFormat::of_result::<VerifyResult>("verify", VERIFY_FORMAT, "what dataset verify found"),
    FileFormat::of_result::<DetectResult<'static>>("detect", DETECT_FORMAT, "the stars of a recording"),
    FileFormat::of_result::<IdentifyResult<'static>>("identify", IDENTIFY_FORMAT, "which stars they are"),
    FileFormat::of_result::<CalibrateResult<'static>>("calibrate", CALIBRATE_FORMAT, "a camera, or why there is none"),
    FileFormat::of_result::<UpdateResult<'static>>("update", SEQUENTIAL_FORMAT, "sequential.json of calibrate --update"),
    FileFormat::of_result::<DiagnoseResult<'static>>("diagnose", DIAGNOSE_FORMAT, "what the model lacks, or why nobody can tell"),
    FileFormat::of_result::<MapResult>("map", MAP_FORMAT, "pixel to direction on a grid"),
    FileFormat::of_result::<CompareResult>("compare", COMPARE_FORMAT, "two calibrations side by side"),
    FileFormat::of_result::<ExportResult>("export", EXPORT_FORMAT, "a camera in the format of another program"),
    FileFormat::of_result::<ImportResult>("import", IMPORT_FORMAT, "the camera of another program"),
    FileFormat::of_result::<RunResult>("run", RUN_FORMAT, "a simulated night against its truth"),
    FileFormat::of_result::<RunResult>("demo", RUN_FORMAT, "the same of the built-in scene"),
    #[cfg(feature = "bench")]
    FileFormat::of_result::<SuiteResult>("test", TEST_FORMAT, "a star tracker against requirements"),
    FileFormat::of_result::<catalog::CatalogImportResult>("catalog-import", catalog::IMPORT_FORMAT, "a catalogue that was made"),
    #[cfg(feature = "bench")]
    FileFormat::of_result::<BlindResult>("blind", SCORE_FORMAT, "the steps of the benchmark"),
    FileFormat::of_result::<EffectList>("effects", LIST_FORMAT, "the effects of this build"),
    FileFormat::of_result::<SignatureResult>("signature", SIGNATURE_FORMAT, "effects --signature: what an effect on pixels does to stars"),
    FileFormat::of_result::<PresetList>("preset", PRESET_FORMAT, "scenes of real cameras"),
    FileFormat::of_result::<DoctorResult>("doctor", DOCTOR_FORMAT, "GPU adapters, and whether they can be trusted"),
    FileFormat { name: "scene", format: scene::FORMAT, what: "a scene file", make: |_| scene::schema() },
    #[cfg(feature = "bench")]
    FileFormat::of_input::<SuiteFile>("suite", SUITE_FORMAT, "requirements of a star tracker"),
    FileFormat::of_input::<RecipeFile>("recipe", RECIPE_FORMAT, "a recipe of a dataset"),
    FileFormat::of_input::<RecordingFile>("recording", RECORDING_FORMAT, "recording.toml"),
    FileFormat::of_input::<Vec<StarListRow>>("star-list", STAR_LIST_FORMAT, "the lines of a star list (CSV), columns as keys"),
];

/// The format of this name.
#[must_use]
pub fn file_format(name: &str) -> Option<&'static FileFormat> {
    FORMATS.iter().find(|format| format.name == name)
}

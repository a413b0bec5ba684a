//! The schemas as the types say them. Tests alone ask for them, so that the program is without the code that makes them.

use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value, json};

use crate::blind::BlindResult;
use crate::calibrate::{CalibrateResult, CompareResult, MapResult, UpdateResult};
use crate::catalog::CatalogImportResult;
use crate::dataset::{DatasetFile, RecipeFile, SampleLabels, ShardMark, VerifyResult};
use crate::detect::DetectResult;
use crate::diagnose::DiagnoseResult;
use crate::effects::EffectList;
use crate::exchange::{ExportResult, ImportResult};
use crate::identify::IdentifyResult;
use crate::imaging::DoctorResult;
use crate::pipeline::RunResult;
use crate::recording::{RecordingFile, StarListRow};
use crate::render::{SignatureResult, SimulateResult, SimulatedTruth};
use crate::scene::{self, PresetList};
use crate::suite::{SuiteFile, SuiteResult};

use super::FileFormat;

/// The schema that the type of this format has now; its file in `schemas/` says the same, or a test fails. Of scenes it is `src/scene/schema.json`,
/// which is without the effects of the build.
///
/// `None` for a name that is not in the table.
#[must_use]
pub fn schema_of_type(format: &FileFormat) -> Option<Value> {
    let schema = match format.name {
        "simulate" => result::<SimulateResult>(),
        "truth" => result::<SimulatedTruth<'static>>(),
        "dataset" => result::<DatasetFile>(),
        "shard" => result::<ShardMark>(),
        "sample" => result::<SampleLabels>(),
        "verify" => result::<VerifyResult>(),
        "detect" => result::<DetectResult<'static>>(),
        "identify" => result::<IdentifyResult<'static>>(),
        "calibrate" => result::<CalibrateResult<'static>>(),
        "update" => result::<UpdateResult<'static>>(),
        "diagnose" => result::<DiagnoseResult<'static>>(),
        "map" => result::<MapResult>(),
        "compare" => result::<CompareResult>(),
        "export" => result::<ExportResult>(),
        "import" => result::<ImportResult>(),
        "run" | "demo" => result::<RunResult>(),
        "test" => result::<SuiteResult>(),
        "catalog-import" => result::<CatalogImportResult>(),
        "blind" => result::<BlindResult>(),
        "effects" => result::<EffectList>(),
        "signature" => result::<SignatureResult>(),
        "preset" => result::<PresetList>(),
        "doctor" => result::<DoctorResult>(),
        "scene" => return Some(scene::schema_of_type()),
        "suite" => input::<SuiteFile>(),
        "recipe" => input::<RecipeFile>(),
        "recording" => input::<RecordingFile>(),
        "star-list" => input::<Vec<StarListRow>>(),
        _ => return None,
    };
    Some(entitled(format, schema))
}

/// As it is written.
fn result<T: JsonSchema>() -> Value {
    generated::<T>(SchemaSettings::draft2020_12().for_serialize())
}

/// As it is read.
fn input<T: JsonSchema>() -> Value {
    generated::<T>(SchemaSettings::draft2020_12().for_deserialize())
}

fn generated<T: JsonSchema>(settings: SchemaSettings) -> Value {
    settings.into_generator().into_root_schema_for::<T>().to_value()
}

/// The schema with its name, and with the only value that `format` may have.
fn entitled(own: &FileFormat, mut schema: Value) -> Value {
    for place in std::iter::once(String::new()).chain(variants(&schema)) {
        if let Some(format) = schema.pointer_mut(&format!("{place}/properties/format")).and_then(Value::as_object_mut) {
            format.insert("const".to_owned(), json!(own.format));
        }
    }
    let head = [("$id", own.format.to_owned()), ("title", format!("{}: {} ({})", own.name, own.what, own.format))];
    let mut named: Map<String, Value> = head.into_iter().map(|(key, text)| (key.to_owned(), Value::String(text))).collect();
    if let Value::Object(all) = schema {
        named.extend(all.into_iter().filter(|(key, _)| key != "title"));
    }
    Value::Object(named)
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

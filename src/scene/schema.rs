//! The JSON Schema of a scene file: of the tables as they are read, and of `[[effects]]` as the registries know them.

use serde_json::{Map, Value, json};

use super::SceneFile;
use crate::effects::pixel::PIXEL_EFFECTS;
use crate::effects::sky::glow::SKY_GLOWS;
use crate::effects::{DISPLACEMENTS, ParameterSpec};

/// The name of the file format.
pub const FORMAT: &str = "boresight-scene/1";

/// The tables of the scene file as the types say them, without the effects of the build; a test holds the file against the types.
const TABLES: &str = include_str!(concat!(env!("OUT_DIR"), "/scene-schema.json"));

/// The schema (draft 2020-12).
#[must_use]
pub fn schema() -> Value {
    let mut schema: Value = serde_json::from_str(TABLES).unwrap_or_default();
    if let Some(table) = schema.pointer_mut("/$defs/EffectTable") {
        *table = effects();
    }
    schema
}

/// What `schema.json` has to say: tests alone ask for it, so that the program is without the code that makes it.
#[must_use]
pub fn schema_of_type() -> Value {
    let mut schema = schemars::schema_for!(SceneFile).to_value();
    if let Some(table) = schema.as_object_mut() {
        table.insert("$id".to_owned(), json!(FORMAT));
        table.insert("title".to_owned(), json!("A scene of boresight simulate"));
    }
    if let Some(format) = schema.pointer_mut("/properties/format").and_then(Value::as_object_mut) {
        format.insert("const".to_owned(), json!(FORMAT));
    }
    schema
}

/// `[[effects]]`: for each id its own parameters.
fn effects() -> Value {
    let displacements = DISPLACEMENTS.iter().map(|effect| (effect.id().to_owned(), effect.parameters()));
    let on_pixels = PIXEL_EFFECTS.iter().map(|effect| (effect.id().to_owned(), effect.parameters()));
    let mut known: std::collections::BTreeMap<String, Vec<ParameterSpec>> = std::collections::BTreeMap::new();
    let of_the_sky = SKY_GLOWS.iter().map(|glow| (glow.id().to_owned(), glow.parameters()));
    for (id, parameters) in displacements.chain(on_pixels).chain(of_the_sky) {
        known.entry(id).or_default().extend_from_slice(parameters);
    }
    let one = |(id, parameters): (&String, &Vec<ParameterSpec>)| {
        let properties: Map<String, Value> = parameters.iter().map(|spec| (spec.name.to_owned(), number(spec))).collect();
        json!({
            "type": "object",
            "properties": {
                "id": {"const": id},
                "parameters": {"type": "object", "properties": properties, "additionalProperties": false},
            },
            "required": ["id"],
            "additionalProperties": false,
        })
    };
    json!({
        "description": "An effect in force; `boresight effects ID` prints its page.",
        "oneOf": known.iter().map(one).collect::<Vec<Value>>(),
    })
}

fn number(spec: &ParameterSpec) -> Value {
    let mut number = Map::from_iter([("type".to_owned(), json!("number"))]);
    let unit = if spec.unit.is_empty() { "no unit".to_owned() } else { spec.unit.to_owned() };
    number.insert("description".to_owned(), json!(format!("{unit}; typically {}", spec.typical)));
    for (key, bound) in [("minimum", spec.range.0), ("maximum", spec.range.1)] {
        if bound.is_finite() {
            number.insert(key.to_owned(), json!(bound));
        }
    }
    Value::Object(number)
}

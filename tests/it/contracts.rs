//! What others may rely on: the schemas of results and inputs, the words of the help and of the pages, and the looks of pictures.
//!
//! Snapshots lie in `tests/it/snapshots`. `INSTA_UPDATE=always cargo test --test it contracts::` accepts what is new; the diff is then to be read.

mod checker;
mod made;
mod pictures;
mod snapshots;

use boresight::formats::{FORMATS, file_format, schema_of_type};
use serde_json::{Value, json};

use crate::cli::run;
use checker::faults;
use made::MADE;

/// Keys that stand in a result only if there is something to say.
const OPTIONAL: [&str; 7] = ["p_value_is", "family_p_value_is", "limit", "image", "frame_names", "zeniths", "saturation_dn"];
/// Of a channel: what nobody held out is not told.
const OPTIONAL_OF_CHANNELS: [&str; 2] = ["held_out_chi2_per_dof", "held_out_dof"];

#[test]
fn every_result_keeps_its_schema() {
    for format in FORMATS {
        let schema = format.schema();
        assert_eq!(schema["$schema"], "https://json-schema.org/draft/2020-12/schema", "{}", format.name);
        assert_eq!(schema["$id"], format.format, "{}", format.name);
        if format.name != "scene" {
            assert!(schema["title"].as_str().unwrap().contains(format.format), "{}", schema["title"]);
        }
        let mut seen = 0;
        for result in MADE.of(format.name) {
            // A key that the schema leaves out is a key that nobody was promised.
            let found = faults(&schema, result, true);
            assert!(found.is_empty(), "{}: {:#?}", format.name, &found[..found.len().min(12)]);
            if let Some(own) = result.get("format") {
                assert_eq!(own, format.format, "{}", format.name);
            }
            seen += 1;
        }
        assert!(seen > 0, "{}: no result was held against its schema", format.name);
    }
}

/// The places of all keys of a value, of arrays those of the first item.
fn places(value: &Value, at: &str, found: &mut Vec<String>) {
    match value {
        Value::Object(object) => {
            for (key, value) in object {
                let place = format!("{at}/{}", key.replace('~', "~0").replace('/', "~1"));
                found.push(place.clone());
                places(value, &place, found);
            }
        }
        Value::Array(items) => {
            if let Some(first) = items.first() {
                places(first, &format!("{at}/0"), found);
            }
        }
        _ => {}
    }
}

/// Keeps the first table of every list of tables: the others have the same keys.
fn shorten(value: &mut Value) {
    match value {
        Value::Object(object) => object.values_mut().for_each(shorten),
        Value::Array(items) => {
            if items.iter().any(Value::is_object) {
                items.truncate(1);
            }
            items.iter_mut().for_each(shorten);
        }
        _ => {}
    }
}

fn parent<'v>(value: &'v mut Value, place: &str) -> (&'v mut Value, String) {
    let (above, key) = place.rsplit_once('/').unwrap();
    (value.pointer_mut(above).unwrap(), key.replace("~1", "/").replace("~0", "~"))
}

/// Without a key, or with another type in its place, no result keeps its schema: what is promised is checked.
#[test]
fn a_key_that_is_gone_or_changed_is_a_fault() {
    for (name, at_least) in [("identify", 50), ("calibrate", 150), ("diagnose", 150), ("compare", 25), ("truth", 50)] {
        let schema = file_format(name).unwrap().schema();
        let mut short = MADE.of(name).next().unwrap().clone();
        shorten(&mut short);
        let result = &short;
        assert_eq!(faults(&schema, result, true), Vec::<String>::new(), "{name}");
        let mut all = Vec::new();
        places(result, "", &mut all);
        let mut removed = 0;
        for place in &all {
            let mut without = result.clone();
            let (above, key) = parent(&mut without, place);
            // Tables by name promise no name.
            let by_name = place.contains("/parameters/") && above.as_object().unwrap().values().all(Value::is_f64)
                || place.starts_with("/findings/0/channels/") && above.as_object().unwrap().contains_key("astrometry")
                || place.starts_with("/half_nights/largest/");
            above.as_object_mut().unwrap().remove(&key);
            let of_channel = place.starts_with("/channels/") && OPTIONAL_OF_CHANNELS.contains(&key.as_str());
            if !by_name && !of_channel && !OPTIONAL.contains(&key.as_str()) {
                assert!(!faults(&schema, &without, false).is_empty(), "{name}: {place} may go without a fault");
                removed += 1;
            }
            let mut changed = result.clone();
            let own = changed.pointer_mut(place).unwrap();
            *own = if own.is_boolean() { json!("no") } else { json!(true) };
            assert!(!faults(&schema, &changed, false).is_empty(), "{name}: {place} may be of another type without a fault");
        }
        assert!(removed >= at_least, "{name}: {removed} keys");
    }
}

#[test]
fn schemas_are_listed_and_printed_by_name() {
    let list = run(&["schema"]);
    assert_eq!(list.code, 0);
    for format in FORMATS {
        assert!(
            list.stdout.lines().any(|line| line.starts_with(format.name) && line.contains(format.format)),
            "{}: {}",
            format.name,
            list.stdout
        );
    }
    let printed = |args: &[&str]| -> Value { serde_json::from_str(&run(args).stdout).unwrap() };
    assert_eq!(printed(&["schema", "calibrate"]), file_format("calibrate").unwrap().schema());
    // The schema of scenes was the only one once, and is still had as then.
    assert_eq!(printed(&["schema", "--json"]), boresight::scene::schema());
    assert_eq!(printed(&["schema", "scene"]), boresight::scene::schema());
    let unknown = run(&["schema", "calibrat"]);
    assert_eq!((unknown.code, unknown.stdout.as_str()), (2, ""));
    assert!(unknown.stderr.contains("did you mean calibrate?") && unknown.stderr.lines().count() == 1, "{}", unknown.stderr);
}

/// `INSTA_UPDATE=always` writes them anew, as it does with snapshots.
#[test]
fn schemas_in_files_are_those_of_the_types() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    for format in FORMATS {
        let made = schema_of_type(format).unwrap_or_else(|| panic!("no type is named for {}", format.name));
        let text = serde_json::to_string_pretty(&made).unwrap() + "\n";
        let file =
            if format.name == "scene" { "src/scene/schema.json".to_owned() } else { format!("src/formats/schemas/{}.json", format.name) };
        if std::env::var("INSTA_UPDATE").is_ok_and(|update| update == "always") {
            std::fs::write(root.join(&file), &text).unwrap();
        } else if format.name != "scene" {
            // What the program holds is shorter by spaces alone.
            assert_eq!(format.schema(), made, "{}", format.name);
        }
        let written = std::fs::read_to_string(root.join(&file)).unwrap();
        assert!(
            written == text,
            "{file} is not what the type says now: INSTA_UPDATE=always cargo test --test it contracts::schemas writes it anew"
        );
    }
    let files = std::fs::read_dir(root.join("src/formats/schemas")).unwrap().count();
    assert_eq!(files, FORMATS.len() - 1, "a schema whose format is gone");
}

#[test]
fn the_page_of_formats_names_them_all() {
    let page = include_str!("../../docs/formats.md");
    for format in FORMATS {
        assert!(page.contains(&format!("`{}`", format.name)), "{}", format.name);
        assert!(format.name == "star-list" || page.contains(&format!("`{}`", format.format)), "{}", format.format);
    }
}

/// The checker itself finds what it is there to find.
#[test]
fn the_checker_finds_faults() {
    let schema = json!({
        "type": "object",
        "properties": {"a": {"type": ["number", "null"], "minimum": 0}, "b": {"$ref": "#/$defs/B"}, "c": {"type": "array", "items": {"type": "integer"}, "maxItems": 2}},
        "required": ["a", "b"],
        "$defs": {"B": {"oneOf": [{"const": "x"}, {"enum": ["y", "z"]}]}},
    });
    for good in [json!({"a": 1.5, "b": "x"}), json!({"a": null, "b": "z", "c": [1, 2]})] {
        assert_eq!(faults(&schema, &good, true), Vec::<String>::new());
    }
    for bad in [
        json!({"a": 1.5}),
        json!({"a": "1.5", "b": "x"}),
        json!({"a": -1, "b": "x"}),
        json!({"a": 1, "b": "w"}),
        json!({"a": 1, "b": "x", "c": [1.5]}),
        json!({"a": 1, "b": "x", "c": [1, 2, 3]}),
        json!([]),
        json!({"a": 1, "b": "x", "d": 0}),
    ] {
        assert!(!faults(&schema, &bad, true).is_empty(), "{bad}");
    }
    assert!(faults(&schema, &json!({"a": 1, "b": "x", "d": 0}), false).is_empty(), "keys may be added");
    assert!(
        std::panic::catch_unwind(|| faults(&json!({"patternProperties": {}}), &json!({}), false)).is_err(),
        "no keyword is passed over"
    );
}

//! A strict checker for the part of JSON Schema (draft 2020-12) that schemas of this crate are written in. A keyword that it does not know is a
//! fault of the schema: nothing is passed over.

use std::collections::BTreeSet;

use serde_json::{Map, Value};

/// Keywords that say something to people, or where something is.
const WORDS: [&str; 9] = ["$schema", "$id", "$defs", "title", "description", "format", "default", "examples", "deprecated"];

/// What is wrong with a value, a sentence each; nothing if the schema holds. `complete`: keys that no part of the schema names are faults too.
pub(super) fn faults(schema: &Value, value: &Value, complete: bool) -> Vec<String> {
    let checker = Checker { root: schema, complete };
    let mut found = Vec::new();
    checker.visit(schema, value, "", &mut found);
    found
}

struct Checker<'s> {
    root: &'s Value,
    complete: bool,
}

impl Checker<'_> {
    /// The value at a place, with everything below it.
    fn visit(&self, schema: &Value, value: &Value, place: &str, found: &mut Vec<String>) {
        let named = self.apply(schema, value, place, found);
        if let (true, Some(object)) = (self.complete, value.as_object()) {
            found.extend(
                object.keys().filter(|key| !named.contains(*key)).map(|key| format!("{place}/{key}: no part of the schema names it")),
            );
        }
    }

    /// One part of a schema held against the value; the keys that it speaks of.
    fn apply(&self, schema: &Value, value: &Value, place: &str, found: &mut Vec<String>) -> BTreeSet<String> {
        let mut named = BTreeSet::new();
        let Some(schema) = schema.as_object() else {
            match schema {
                Value::Bool(true) => named.extend(value.as_object().into_iter().flat_map(Map::keys).cloned()),
                Value::Bool(false) => found.push(format!("{place}: nothing is allowed here")),
                other => panic!("{place}: {other} is no schema"),
            }
            return named;
        };
        for (keyword, rule) in schema {
            match keyword.as_str() {
                "$ref" => named.extend(self.apply(self.target(rule), value, place, found)),
                "allOf" => rule.as_array().unwrap().iter().for_each(|part| named.extend(self.apply(part, value, place, found))),
                "anyOf" | "oneOf" => named.extend(self.alternatives(keyword, rule.as_array().unwrap(), value, place, found)),
                "properties" | "required" | "additionalProperties" | "dependentRequired" => {
                    if let Some(object) = value.as_object() {
                        self.keys(keyword, schema, object, place, found, &mut named);
                    }
                }
                "items" | "prefixItems" | "minItems" | "maxItems" | "uniqueItems" => {
                    if let Some(items) = value.as_array() {
                        self.items(keyword, schema, items, place, found);
                    }
                }
                _ => own(keyword, rule, value, place, found),
            }
        }
        named
    }

    fn target(&self, reference: &Value) -> &Value {
        let pointer =
            reference.as_str().and_then(|text| text.strip_prefix('#')).unwrap_or_else(|| panic!("{reference} is no place in this schema"));
        self.root.pointer(pointer).unwrap_or_else(|| panic!("{reference} leads nowhere"))
    }

    fn alternatives(&self, keyword: &str, forms: &[Value], value: &Value, place: &str, found: &mut Vec<String>) -> BTreeSet<String> {
        let tried: Vec<(Vec<String>, BTreeSet<String>)> = forms
            .iter()
            .map(|form| {
                let mut own = Vec::new();
                let named = self.apply(form, value, place, &mut own);
                (own, named)
            })
            .collect();
        let fitting: Vec<&BTreeSet<String>> = tried.iter().filter(|(own, _)| own.is_empty()).map(|(_, named)| named).collect();
        match fitting.len() {
            0 => {
                let nearest = tried.iter().map(|(own, _)| own).min_by_key(|own| own.len());
                found.push(format!("{place}: fits none of {} forms; the nearest: {nearest:?}", forms.len()));
            }
            1 => {}
            several if keyword == "oneOf" => found.push(format!("{place}: fits {several} forms, and must fit one")),
            _ => {}
        }
        fitting.into_iter().flatten().cloned().collect()
    }

    fn keys(
        &self,
        keyword: &str,
        schema: &Map<String, Value>,
        object: &Map<String, Value>,
        place: &str,
        found: &mut Vec<String>,
        named: &mut BTreeSet<String>,
    ) {
        let rule = &schema[keyword];
        match keyword {
            "properties" => {
                for (key, part) in rule.as_object().unwrap() {
                    if let Some(value) = object.get(key) {
                        named.insert(key.clone());
                        self.visit(part, value, &format!("{place}/{key}"), found);
                    }
                }
            }
            "required" => {
                let missing = rule.as_array().unwrap().iter().filter_map(Value::as_str).filter(|key| !object.contains_key(*key));
                found.extend(missing.map(|key| format!("{place}/{key}: is missing")));
            }
            "dependentRequired" => {
                for (_, needed) in rule.as_object().unwrap().iter().filter(|(key, _)| object.contains_key(*key)) {
                    let missing = needed.as_array().unwrap().iter().filter_map(Value::as_str).filter(|key| !object.contains_key(*key));
                    found.extend(missing.map(|key| format!("{place}/{key}: is missing")));
                }
            }
            _ => {
                let known = schema.get("properties").and_then(Value::as_object);
                for (key, value) in object.iter().filter(|(key, _)| known.is_none_or(|known| !known.contains_key(*key))) {
                    named.insert(key.clone());
                    self.visit(rule, value, &format!("{place}/{key}"), found);
                }
            }
        }
    }

    fn items(&self, keyword: &str, schema: &Map<String, Value>, items: &[Value], place: &str, found: &mut Vec<String>) {
        let rule = &schema[keyword];
        let begun = schema.get("prefixItems").and_then(Value::as_array).map_or(0, Vec::len);
        match keyword {
            "items" => {
                for (index, item) in items.iter().enumerate().skip(begun) {
                    self.visit(rule, item, &format!("{place}/{index}"), found);
                }
            }
            "prefixItems" => {
                for (index, (part, item)) in rule.as_array().unwrap().iter().zip(items).enumerate() {
                    self.visit(part, item, &format!("{place}/{index}"), found);
                }
            }
            "minItems" if (items.len() as u64) < rule.as_u64().unwrap() => {
                found.push(format!("{place}: has {} items, fewer than {rule}", items.len()));
            }
            "maxItems" if (items.len() as u64) > rule.as_u64().unwrap() => {
                found.push(format!("{place}: has {} items, more than {rule}", items.len()));
            }
            "uniqueItems" if items.iter().enumerate().any(|(index, item)| items[..index].contains(item)) => {
                found.push(format!("{place}: an item is there twice"));
            }
            _ => {}
        }
    }
}

/// Keywords on the value itself.
fn own(keyword: &str, rule: &Value, value: &Value, place: &str, found: &mut Vec<String>) {
    let number = |holds: fn(f64, f64) -> bool| value.as_f64().is_none_or(|number| holds(number, rule.as_f64().unwrap()));
    let holds = match keyword {
        "type" => {
            let names: Vec<&str> =
                rule.as_array().map_or_else(|| vec![rule.as_str().unwrap()], |all| all.iter().filter_map(Value::as_str).collect());
            names.into_iter().any(|name| is_of(name, value))
        }
        "const" => value == rule,
        "enum" => rule.as_array().unwrap().contains(value),
        "minimum" => number(|number, bound| number >= bound),
        "maximum" => number(|number, bound| number <= bound),
        "exclusiveMinimum" => number(|number, bound| number > bound),
        "exclusiveMaximum" => number(|number, bound| number < bound),
        word if WORDS.contains(&word) => true,
        unknown => panic!("{place}: the checker does not know the keyword {unknown}"),
    };
    if !holds {
        let shown: String = value.to_string().chars().take(60).collect();
        found.push(format!("{place}: {shown} is against {keyword} {rule}"));
    }
}

fn is_of(name: &str, value: &Value) -> bool {
    match name {
        "null" => value.is_null(),
        "boolean" => value.is_boolean(),
        "integer" => value.is_i64() || value.is_u64(),
        "number" => value.is_number(),
        "string" => value.is_string(),
        "array" => value.is_array(),
        "object" => value.is_object(),
        other => panic!("{other} is no type"),
    }
}

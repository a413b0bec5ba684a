//! A place in a scene, by keys with dots: found in the schema of scenes before anything is drawn, and set in the tables of a scene.

use serde_json::Value as Schema;
use toml::{Table, Value};

use crate::effects::id_of;
use crate::toml_file::suggestion;

/// What stands at a place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PlaceKind {
    /// A number.
    Number,
    /// A whole number.
    Integer,
    /// A word.
    Text,
    /// Numbers; how many, where that is fixed.
    Numbers(Option<usize>),
    /// A whole effect.
    Effect,
    /// A table or a list of tables.
    Table,
    /// Something else.
    Other,
}

impl PlaceKind {
    /// In words.
    #[must_use]
    pub fn words(&self) -> String {
        match self {
            Self::Number => "a number".to_owned(),
            Self::Integer => "a whole number".to_owned(),
            Self::Text => "a word".to_owned(),
            Self::Numbers(Some(count)) => format!("{count} numbers"),
            Self::Numbers(None) => "a list of numbers".to_owned(),
            Self::Effect => "an effect".to_owned(),
            Self::Table => "a table".to_owned(),
            Self::Other => "neither number, word nor table".to_owned(),
        }
    }
}

/// One key of a path.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Step {
    Key(String),
    /// An element of a list, and how long the list is where that is fixed.
    Element(usize, Option<usize>),
    /// The element of `effects` with this id.
    Effect(String),
}

/// A place in a scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScenePath {
    /// As written, but in canonical form: see [`canonical_path`].
    pub text: String,
    steps: Vec<Step>,
    /// What stands there.
    pub kind: PlaceKind,
}

/// The schema behind a reference, and behind "this or nothing".
fn resolved<'s>(root: &'s Schema, mut node: &'s Schema) -> &'s Schema {
    loop {
        let target = node.get("$ref").and_then(Schema::as_str).and_then(|target| root.pointer(target.trim_start_matches('#')));
        let some = || node.get("anyOf").and_then(Schema::as_array)?.iter().find(|form| form.get("type").is_none_or(|kind| kind != "null"));
        match target.or_else(some) {
            Some(next) => node = next,
            None => return node,
        }
    }
}

/// Whether the type of a schema is this, or this or nothing.
fn is_a(node: &Schema, wanted: &str) -> bool {
    match node.get("type") {
        Some(Schema::Array(kinds)) => kinds.iter().any(|kind| kind == wanted),
        Some(kind) => kind == wanted,
        None => false,
    }
}

fn fixed_length(node: &Schema) -> Option<usize> {
    let bound = |key: &str| node.get(key).and_then(Schema::as_u64);
    bound("minItems").filter(|least| bound("maxItems") == Some(*least)).map(|count| count as usize)
}

fn kind_of(root: &Schema, node: &Schema) -> PlaceKind {
    let words =
        node.get("enum").is_some() || node.get("oneOf").is_some_and(|forms| forms.pointer("/0/const").is_some_and(Schema::is_string));
    if is_a(node, "integer") {
        PlaceKind::Integer
    } else if is_a(node, "number") {
        PlaceKind::Number
    } else if words || is_a(node, "string") {
        PlaceKind::Text
    } else if is_a(node, "array") {
        let items = node.get("items").map(|items| kind_of(root, resolved(root, items)));
        if matches!(items, Some(PlaceKind::Number | PlaceKind::Integer)) {
            PlaceKind::Numbers(fixed_length(node))
        } else {
            PlaceKind::Table
        }
    } else if is_a(node, "object") {
        PlaceKind::Table
    } else {
        PlaceKind::Other
    }
}

/// The effect of this id among the forms of `[[effects]]`.
fn effect<'s>(items: &'s Schema, id: &str) -> Result<&'s Schema, String> {
    let forms = items.get("oneOf").and_then(Schema::as_array).map_or(&[][..], Vec::as_slice);
    let id_in = |form: &'s Schema| form.pointer("/properties/id/const").and_then(Schema::as_str).unwrap_or_default();
    forms.iter().find(|form| id_in(form) == id).ok_or_else(|| {
        let known: Vec<&str> = forms.iter().map(id_in).collect();
        let nearest = known.into_iter().min_by_key(|known| strsim::damerau_levenshtein(id, known)).unwrap_or_default();
        format!("there is no effect {id}; did you mean {nearest}?")
    })
}

/// The schema of a key of a table.
fn property<'s>(node: &'s Schema, key: &str, before: &str) -> Result<&'s Schema, String> {
    let properties = node.get("properties").and_then(Schema::as_object);
    if let Some(found) = properties.and_then(|properties| properties.get(key)) {
        return Ok(found);
    }
    if let Some(any) = node.get("additionalProperties").filter(|any| any.is_object()) {
        return Ok(any);
    }
    let known: Vec<&str> = properties.into_iter().flat_map(|properties| properties.keys()).map(String::as_str).collect();
    let place = if before.is_empty() { "a scene".to_owned() } else { before.to_owned() };
    Err(match suggestion(key, &known) {
        Some(nearest) => format!("{place} has no key {key}; did you mean {nearest}?"),
        None if known.is_empty() => format!("{place} has nothing below it; leave {key} out"),
        None => format!("{place} has no key {key}; it has {}", known.join(", ")),
    })
}

/// One way to write a path of which there are several: the one exposure of a sample has no number, and ids have no underscores.
pub(super) fn canonical_path(text: &str) -> String {
    let words: Vec<&str> = text.split('.').collect();
    match words.as_slice() {
        ["frames", "0", rest @ ..] if !rest.is_empty() => format!("frames.{}", rest.join(".")),
        ["effects", id, rest @ ..] => [&["effects", &id_of(id)], rest].concat().join("."),
        _ => text.to_owned(),
    }
}

impl ScenePath {
    /// Finds a path in the schema of scenes; else the sentence that says why not.
    pub fn find(root: &Schema, text: &str) -> Result<Self, String> {
        let (mut node, mut steps, mut before) = (root, Vec::new(), String::new());
        let mut kind = PlaceKind::Table;
        let mut words = text.split('.').peekable();
        while let Some(word) = words.next() {
            node = resolved(root, node);
            let is_list = is_a(node, "array");
            let items = node.get("items").map(|items| resolved(root, items));
            if let Some(items) = items.filter(|_| is_list && before == "effects") {
                let id = id_of(word);
                let form = effect(items, &id)?;
                steps.push(Step::Effect(id));
                (node, kind) = (form, PlaceKind::Effect);
                if let Some(name) = words.next() {
                    let parameters = form.pointer("/properties/parameters").unwrap_or(&Schema::Null);
                    node = property(parameters, name, &format!("effects.{word}"))?;
                    steps.extend([Step::Key("parameters".to_owned()), Step::Key(name.to_owned())]);
                    kind = kind_of(root, node);
                    before = format!("effects.{word}.{name}");
                } else {
                    before = format!("effects.{word}");
                }
                if let Some(more) = words.peek() {
                    return Err(format!("{before} has nothing below it; leave {more} out"));
                }
                continue;
            }
            if let Some(items) = items.filter(|_| is_list) {
                let (place, fixed) = (word.parse::<usize>().ok(), fixed_length(node));
                if let (Some(place), Some(count)) = (place, fixed)
                    && place >= count
                {
                    return Err(format!("{before} has {count} elements, which are counted from 0; {place} is none of them"));
                }
                node = items;
                match place {
                    Some(place) => steps.push(Step::Element(place, fixed)),
                    // The one exposure of a sample.
                    None if before == "frames" => {
                        steps.push(Step::Element(0, None));
                        node = property(node, word, "frames")?;
                        steps.push(Step::Key(word.to_owned()));
                    }
                    None => return Err(format!("{before} is a list: name its element by number, as in {before}.0")),
                }
            } else {
                node = property(node, word, &before)?;
                steps.push(Step::Key(word.to_owned()));
            }
            node = resolved(root, node);
            kind = kind_of(root, node);
            before += if before.is_empty() { "" } else { "." };
            before += word;
        }
        Ok(Self { text: canonical_path(text), steps, kind })
    }

    /// Sets the value there; what is missing on the way is made.
    pub fn set(&self, scene: &mut Table, value: Value) -> Result<(), String> {
        let mut whole = Value::Table(std::mem::take(scene));
        let done = self.place(&mut whole).map(|place| *place = value);
        if let Value::Table(table) = whole {
            *scene = table;
        }
        done
    }

    /// The value there, if there is one.
    #[must_use]
    pub fn get<'v>(&self, scene: &'v Table) -> Option<&'v Value> {
        let (first, rest) = self.steps.split_first()?;
        let Step::Key(key) = first else { return None };
        rest.iter().try_fold(scene.get(key)?, |at, step| match step {
            Step::Key(key) => at.get(key),
            Step::Element(place, _) => at.get(*place),
            Step::Effect(id) => {
                let list = at.as_array()?;
                list.get(place_of_effect(list, id)?)
            }
        })
    }

    fn place<'v>(&self, whole: &'v mut Value) -> Result<&'v mut Value, String> {
        let mut at = whole;
        for step in &self.steps {
            // What is still empty becomes what the next step needs.
            if at.as_str() == Some(NOTHING) {
                *at = match step {
                    Step::Key(_) => Value::Table(Table::new()),
                    Step::Element(_, Some(count)) => Value::Array(vec![Value::Float(0.0); *count]),
                    Step::Element(_, None) | Step::Effect(_) => Value::Array(Vec::new()),
                };
            }
            let wrong = || format!("{} leads to what is no table", self.text);
            at = match (step, at) {
                (Step::Key(key), Value::Table(table)) => table.entry(key.clone()).or_insert_with(|| Value::String(NOTHING.to_owned())),
                (Step::Element(place, _), Value::Array(list)) => {
                    let count = list.len();
                    list.get_mut(*place).ok_or_else(|| format!("{}: the scene has {count} elements there, counted from 0", self.text))?
                }
                (Step::Effect(id), Value::Array(list)) => {
                    let place = place_of_effect(list, id).unwrap_or_else(|| {
                        list.push(Value::Table(Table::from_iter([("id".to_owned(), Value::from(id.as_str()))])));
                        list.len() - 1
                    });
                    list.get_mut(place).ok_or_else(wrong)?
                }
                _ => return Err(wrong()),
            };
        }
        Ok(at)
    }

    /// Switches an effect or a table on or off. Off: it is taken out; on: it is there, an effect with its typical parameters if the scene has none.
    pub fn switch(&self, scene: &mut Table, is_on: bool) -> Result<(), String> {
        if let [Step::Key(_), Step::Effect(id)] = self.steps.as_slice() {
            let list = scene.entry("effects").or_insert_with(|| Value::Array(Vec::new()));
            let Value::Array(list) = list else { return Err("effects is no list".to_owned()) };
            match (place_of_effect(list, id), is_on) {
                (Some(place), false) => drop(list.remove(place)),
                (None, true) => list.push(Value::Table(Table::from_iter([("id".to_owned(), Value::from(id.as_str()))]))),
                _ => {}
            }
            return Ok(());
        }
        let [Step::Key(key)] = self.steps.as_slice() else {
            return Err(format!("{} is neither an effect nor a table of the scene, which alone can be left out", self.text));
        };
        if !scene.contains_key(key) {
            return Err(format!("the scene has no [{key}] that could be there or not; write it into the scene"));
        }
        if !is_on {
            scene.remove(key);
        }
        Ok(())
    }
}

/// Stands where a value is about to be made; no key of a scene has it.
const NOTHING: &str = "\u{0}";

fn place_of_effect(list: &[Value], id: &str) -> Option<usize> {
    list.iter().position(|effect| effect.get("id").and_then(Value::as_str).is_some_and(|other| id_of(other) == id))
}

/// Sets a key of a table of a scene.
pub(super) fn set(scene: &mut Table, table: &str, key: &str, value: Value) {
    let table = scene.entry(table).or_insert_with(|| Value::Table(Table::new()));
    if let Value::Table(table) = table {
        table.insert(key.to_owned(), value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::schema;

    fn fault(text: &str) -> String {
        ScenePath::find(&schema(), text).unwrap_err()
    }

    #[test]
    fn paths_are_found_with_what_stands_there() {
        let root = schema();
        for (text, kind) in [
            ("camera.focal_length_px", PlaceKind::Number),
            ("camera.principal_point_px", PlaceKind::Numbers(Some(2))),
            ("camera.principal_point_px.1", PlaceKind::Number),
            ("camera.width_px", PlaceKind::Integer),
            ("frames.rate_deg_s", PlaceKind::Numbers(Some(3))),
            ("frames.rate_deg_s.2", PlaceKind::Number),
            ("frames.time_utc", PlaceKind::Text),
            ("frames.roll_deg", PlaceKind::Number),
            ("psf.kind", PlaceKind::Text),
            ("psf.parameters.sigma_px", PlaceKind::Number),
            ("streaks.0.electrons", PlaceKind::Number),
            ("streaks.0.kind", PlaceKind::Text),
            ("effects.moonlight", PlaceKind::Effect),
            ("effects.hot_pixels.hot_per_million", PlaceKind::Number),
            ("jitter", PlaceKind::Table),
            ("sky.faintest_magnitude", PlaceKind::Number),
        ] {
            assert_eq!(ScenePath::find(&root, text).map(|path| path.kind), Ok(kind), "{text}");
        }
    }

    #[test]
    fn a_place_has_one_path() {
        let text = |text: &str| ScenePath::find(&schema(), text).unwrap().text;
        assert_eq!(text("frames.0.rate_deg_s.2"), "frames.rate_deg_s.2");
        assert_eq!(text("effects.hot_pixels.hot_per_million"), "effects.hot-pixels.hot_per_million");
        assert_eq!(text("streaks.0.electrons"), "streaks.0.electrons");
    }

    #[test]
    fn a_wrong_path_is_told_with_the_right_one() {
        assert_eq!(fault("camera.focal_lenght_px"), "camera has no key focal_lenght_px; did you mean focal_length_px?");
        assert_eq!(fault("camra.k1"), "a scene has no key camra; did you mean camera?");
        assert_eq!(fault("effects.moonligth"), "there is no effect moonligth; did you mean moonlight?");
        assert!(fault("effects.hot-pixels.sharre").starts_with("effects.hot-pixels has no key sharre; "));
        assert_eq!(fault("camera.k1.x"), "camera.k1 has nothing below it; leave x out");
        assert_eq!(fault("streaks.electrons"), "streaks is a list: name its element by number, as in streaks.0");
        assert_eq!(fault("frames.rate_deg_s.3"), "frames.rate_deg_s has 3 elements, which are counted from 0; 3 is none of them");
    }

    #[test]
    fn values_are_set_where_the_path_says() {
        let root = schema();
        let mut scene: Table = toml::from_str("[camera]\nk1 = 1.0\n[[frames]]\nexposure_s = 1.0\n[[effects]]\nid = \"prnu\"").unwrap();
        for (path, value) in [
            ("camera.k1", Value::Float(2.0)),
            ("camera.principal_point_px.1", Value::Float(7.0)),
            ("frames.roll_deg", Value::Float(3.0)),
            ("detector.gain_e_per_dn", Value::Float(4.0)),
            ("effects.prnu.relative", Value::Float(0.5)),
            ("effects.hot-pixels.hot_per_million", Value::Float(0.25)),
        ] {
            ScenePath::find(&root, path).unwrap().set(&mut scene, value).unwrap();
        }
        let expected = "[camera]\nk1 = 2.0\nprincipal_point_px = [0.0, 7.0]\n[[frames]]\nexposure_s = 1.0\nroll_deg = 3.0\n\
                        [[effects]]\nid = \"prnu\"\nparameters = { relative = 0.5 }\n\
                        [[effects]]\nid = \"hot-pixels\"\nparameters = { hot_per_million = 0.25 }\n[detector]\ngain_e_per_dn = 4.0\n";
        assert_eq!(scene, toml::from_str::<Table>(expected).unwrap());
        let moon = ScenePath::find(&root, "effects.moonlight").unwrap();
        moon.switch(&mut scene, true).unwrap();
        assert_eq!(scene["effects"].as_array().unwrap().len(), 3);
        moon.switch(&mut scene, false).unwrap();
        ScenePath::find(&root, "effects.prnu").unwrap().switch(&mut scene, false).unwrap();
        assert_eq!(scene["effects"].as_array().unwrap().len(), 1);
        assert!(ScenePath::find(&root, "jitter").unwrap().switch(&mut scene, true).unwrap_err().contains("no [jitter]"));
        let beyond = ScenePath::find(&root, "streaks.0.electrons").unwrap().set(&mut scene, Value::Float(1.0)).unwrap_err();
        assert!(beyond.contains("0 elements"), "{beyond}");
    }
}

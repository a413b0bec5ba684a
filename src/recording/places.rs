//! Where the keys of `recording.toml` stand, and the sentence for what serde refuses: each fault names its key and its line.

use std::borrow::Cow;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use schemars::JsonSchema;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::error::{ManifestKey, RecordingError};
use super::schema::{CameraInfo, RecordingFile, RecordingFrameTable, RecordingMountTable, RecordingSiteTable};
use crate::toml_file::{Lines, missing_field, suggestion, unknown_field};

/// The name of what stands above all tables.
pub(super) const TOP: &str = "the top of the file";
/// The tables by their names in the file, each with its keys as its type has them.
static TABLES: LazyLock<[(&str, Vec<String>); 5]> = LazyLock::new(|| {
    [
        (TOP, keys::<RecordingFile>()),
        ("[camera]", keys::<CameraInfo>()),
        ("[mount]", keys::<RecordingMountTable>()),
        ("[site]", keys::<RecordingSiteTable>()),
        (FRAME, keys::<RecordingFrameTable>()),
    ]
});
/// The name of a frame's table.
pub(super) const FRAME: &str = "[[frames]]";

/// The keys of a type, as its schema lists them.
fn keys<T: JsonSchema>() -> Vec<String> {
    let schema = schemars::schema_for!(T);
    let properties = schema.get("properties").and_then(serde_json::Value::as_object);
    properties.map(|properties| properties.keys().cloned().collect()).unwrap_or_default()
}

/// The keys of a table.
pub(super) fn known(table: &str) -> &'static [String] {
    TABLES.iter().find(|(name, _)| *name == table).map_or(&[], |(_, keys)| keys)
}

/// A TOML file and its text.
pub(super) struct Document<'s> {
    path: &'s Path,
    source: &'s str,
    lines: Lines,
}

impl<'s> Document<'s> {
    pub(super) fn new(path: &'s Path, source: &'s str) -> Self {
        Self { path, source, lines: Lines::new(source) }
    }

    /// The whole file as a table; duplicate keys and syntax errors are refused here.
    pub(super) fn parse(&self) -> Result<Spanned<DeTable<'s>>, RecordingError> {
        DeTable::parse(self.source).map_err(|error| {
            let at = error.span().map_or(0, |span| span.start);
            self.fault(at, "", format!("not valid TOML: {}", error.message().replace('\n', "; ")))
        })
    }

    pub(super) fn fault(&self, at: usize, key: &str, problem: String) -> RecordingError {
        RecordingError::Manifest { path: self.path.to_owned(), line: self.lines.line(at), key: key.to_owned(), problem }
    }
}

/// Where a key and its value stand.
struct Place<'s> {
    key: Cow<'s, str>,
    at: usize,
    value: Range<usize>,
}

/// A table's name and the places in it, kept while serde takes the table itself apart.
pub(super) struct Section<'d, 's> {
    document: &'d Document<'s>,
    /// As it stands in the file: `[camera]`.
    name: &'static str,
    start: usize,
    places: Vec<Place<'s>>,
}

impl<'d, 's> Section<'d, 's> {
    pub(super) fn new(document: &'d Document<'s>, name: &'static str, start: usize, table: &DeTable<'s>) -> Self {
        let place = |(key, value): (&Spanned<Cow<'s, str>>, &Spanned<DeValue<'s>>)| Place {
            key: key.get_ref().clone(),
            at: key.span().start,
            value: value.span(),
        };
        Self { document, name, start, places: table.iter().map(place).collect() }
    }

    /// Where a key stands; the table's head if it is absent.
    fn at(&self, key: &str) -> usize {
        self.places.iter().find(|place| place.key == key).map_or(self.start, |place| place.at)
    }

    /// The same for messages.
    pub(super) fn place(&self, key: &'static str) -> ManifestKey {
        ManifestKey { path: PathBuf::from(self.document.path), line: self.document.lines.line(self.at(key)), key }
    }

    /// A fault of a key, or of the table as a whole.
    pub(super) fn fault(&self, key: &str, problem: String) -> RecordingError {
        self.document.fault(self.at(key), key, problem)
    }

    /// The error for a value that is none for its key, which "must be" something else.
    fn refused(&self, place: &Place<'s>, must_be: &str) -> RecordingError {
        let text = self.document.source.get(place.value.clone()).unwrap_or("").lines().next().unwrap_or("");
        let shown: String = text.chars().take(60).collect();
        let problem = format!("{:?} in {} {must_be}, but it is {shown}", place.key, self.name);
        self.document.fault(place.at, &place.key, problem)
    }

    /// The error for an unknown key, with the likeliest key that was meant.
    pub(super) fn unknown(&self, key: &str) -> RecordingError {
        let own: Vec<&str> = known(self.name).iter().map(String::as_str).collect();
        let mut others = TABLES.iter().filter(|(name, _)| *name != self.name);
        let hint = if let Some((table, _)) = others.find(|(_, keys)| keys.iter().any(|known| known == key)) {
            format!("it belongs in {table}")
        } else if let Some(meant) = suggestion(key, &own) {
            format!("did you mean {meant:?}?")
        } else {
            format!("known keys are {}", own.join(", "))
        };
        self.fault(key, format!("unknown key {key:?} in {}; {hint}", self.name))
    }

    /// The error for a key that is not there.
    fn missing(&self, key: &str) -> RecordingError {
        match self.name {
            TOP => self.fault(key, format!("[{key}] is missing; write at least its width_px and height_px")),
            "[camera]" => self.fault("", format!("{key:?} is missing in [camera]; write the frames' size in pixels")),
            name => self.fault("", format!("{key:?} is missing in {name}; write it or leave {name} out")),
        }
    }
}

/// The sentence for what serde refused in one of these tables, of which the first is the outermost.
pub(super) fn explain(document: &Document<'_>, sections: &[Section<'_, '_>], error: &toml::de::Error) -> RecordingError {
    let (at, message) = (error.span().map_or(0, |span| span.start), error.message());
    if let Some(key) = missing_field(message) {
        let lacks = |section: &&Section<'_, '_>| known(section.name).iter().any(|known| known == key);
        if let Some(section) = sections.iter().find(lacks) {
            return section.missing(key);
        }
    }
    if let Some((key, _)) = unknown_field(message) {
        let holds = |section: &&Section<'_, '_>| section.places.iter().any(|place| place.at == at);
        if let Some(section) = sections.iter().find(holds) {
            return section.unknown(key);
        }
    }
    let place = |section: &Section<'_, '_>| section.places.iter().position(|place| place.value.contains(&at));
    match sections.iter().rev().find_map(|section| place(section).map(|index| (section, &section.places[index]))) {
        Some((section, place)) => section.refused(place, message),
        None => document.fault(at, "", message.replace('\n', "; ")),
    }
}

//! Strict reader of TOML tables, key by key: every fault names its key and line, and unknown keys are refused.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::error::{ManifestKey, RecordingError};
use crate::guard::guarded;

/// A TOML file and its text.
pub(super) struct Document<'s> {
    path: &'s Path,
    source: &'s str,
    /// Where the lines end: a place is asked for thousands of times, and the text is read once.
    line_ends: Vec<usize>,
}

impl<'s> Document<'s> {
    pub(super) fn new(path: &'s Path, source: &'s str) -> Self {
        let line_ends = source.bytes().enumerate().filter(|(_, byte)| *byte == b'\n').map(|(at, _)| at).collect();
        Self { path, source, line_ends }
    }

    /// The whole file as a table; duplicate keys and syntax errors are refused here.
    pub(super) fn parse(&'s self, known: &'static [&'static str]) -> Result<Table<'s>, RecordingError> {
        let parsed =
            guarded(|| DeTable::parse(self.source)).map_err(|panicked| self.fault(0, "", format!("not valid TOML: {panicked}")))?;
        match parsed {
            Ok(table) => Ok(Table::new(self, "the top of the file", known, 0..0, table.into_inner())),
            Err(error) => {
                let at = error.span().map_or(0, |span| span.start);
                Err(self.fault(at, "", format!("not valid TOML: {}", error.message().replace('\n', "; "))))
            }
        }
    }

    /// The line of a byte, from 1.
    fn line(&self, at: usize) -> usize {
        1 + self.line_ends.partition_point(|end| *end < at)
    }

    fn fault(&self, at: usize, key: &str, problem: String) -> RecordingError {
        RecordingError::Manifest { path: PathBuf::from(self.path), line: self.line(at), key: key.to_owned(), problem }
    }
}

/// A table whose keys are taken out one by one.
pub(super) struct Table<'s> {
    document: &'s Document<'s>,
    /// As it stands in the file: `[camera]`.
    name: String,
    known: &'static [&'static str],
    start: usize,
    /// Key → (span of the key, value).
    entries: BTreeMap<String, (Range<usize>, Spanned<DeValue<'s>>)>,
}

/// A key that is left, and its value if it is a number.
pub(super) struct Left {
    pub(super) key: String,
    pub(super) number: Option<f64>,
}

impl<'s> Table<'s> {
    fn new(document: &'s Document<'s>, name: &str, known: &'static [&'static str], span: Range<usize>, table: DeTable<'s>) -> Self {
        let entries = table.into_iter().map(|(key, value)| (key.get_ref().to_string(), (key.span(), value))).collect();
        Self { document, name: name.to_owned(), known, start: span.start, entries }
    }

    /// Where a key stands; the table's head if it is absent.
    pub(super) fn place(&self, key: &'static str) -> ManifestKey {
        let at = self.entries.get(key).map_or(self.start, |(span, _)| span.start);
        ManifestKey { path: PathBuf::from(self.document.path), line: self.document.line(at), key }
    }

    /// A fault of the table as a whole.
    pub(super) fn fault(&self, key: &str, problem: String) -> RecordingError {
        let at = self.entries.get(key).map_or(self.start, |(span, _)| span.start);
        self.document.fault(at, key, problem)
    }

    /// The value of a key through `read`, which says what it expected if it cannot.
    fn take<T>(&mut self, key: &'static str, read: impl FnOnce(&DeValue<'s>) -> Result<T, String>) -> Result<Option<T>, RecordingError> {
        debug_assert!(self.known.contains(&key), "{key} is not in the list of known keys");
        let Some((span, value)) = self.entries.remove(key) else {
            return Ok(None);
        };
        match read(value.get_ref()) {
            Ok(taken) => Ok(Some(taken)),
            Err(expected) => {
                let text = self.document.source.get(value.span()).unwrap_or("").lines().next().unwrap_or("");
                let shown: String = text.chars().take(60).collect();
                Err(self.document.fault(span.start, key, format!("{key:?} in {} {expected}, but it is {shown}", self.name)))
            }
        }
    }

    /// A number that `accept` accepts.
    pub(super) fn number_where(
        &mut self,
        key: &'static str,
        what: &str,
        accept: impl Fn(f64) -> bool,
    ) -> Result<Option<f64>, RecordingError> {
        self.take(key, |value| number(value).filter(|&number| accept(number)).ok_or_else(|| format!("must be {what}")))
    }

    pub(super) fn number(&mut self, key: &'static str) -> Result<Option<f64>, RecordingError> {
        self.number_where(key, "a finite number", |_| true)
    }

    pub(super) fn positive(&mut self, key: &'static str) -> Result<Option<f64>, RecordingError> {
        self.number_where(key, "a number greater than 0", |number| number > 0.0)
    }

    pub(super) fn not_negative(&mut self, key: &'static str) -> Result<Option<f64>, RecordingError> {
        self.number_where(key, "a number of 0 or more", |number| number >= 0.0)
    }

    pub(super) fn number_within(&mut self, key: &'static str, low: f64, high: f64) -> Result<Option<f64>, RecordingError> {
        self.number_where(key, &format!("a number from {low} to {high}"), |number| (low..=high).contains(&number))
    }

    /// A whole number from `low` to `high`.
    pub(super) fn count(&mut self, key: &'static str, low: usize, high: usize) -> Result<Option<usize>, RecordingError> {
        self.take(key, |value| {
            let found = value.as_integer().and_then(|integer| usize::from_str_radix(integer.as_str(), integer.radix()).ok());
            found.filter(|number| (low..=high).contains(number)).ok_or_else(|| format!("must be a whole number from {low} to {high}"))
        })
    }

    /// An array of `N` numbers that `accept` accepts.
    pub(super) fn numbers<const N: usize>(
        &mut self,
        key: &'static str,
        what: &str,
        accept: impl Fn(&[f64; N]) -> bool,
    ) -> Result<Option<[f64; N]>, RecordingError> {
        self.take(key, |value| {
            let numbers: Option<Vec<f64>> = value.as_array().and_then(|array| array.iter().map(|item| number(item.get_ref())).collect());
            let numbers: Option<[f64; N]> = numbers.and_then(|numbers| numbers.try_into().ok());
            numbers.filter(accept).ok_or_else(|| format!("must be {what}"))
        })
    }

    pub(super) fn text(&mut self, key: &'static str) -> Result<Option<String>, RecordingError> {
        self.take(key, |value| value.as_str().map(str::to_owned).ok_or_else(|| "must be a text in quotes".to_owned()))
    }

    /// A text, or a time written without quotes.
    pub(super) fn time_text(&mut self, key: &'static str) -> Result<Option<String>, RecordingError> {
        self.take(key, |value| {
            let bare = || value.as_datetime().map(ToString::to_string);
            value.as_str().map(str::to_owned).or_else(bare).ok_or_else(|| "must be a time such as \"2026-03-01T22:15:07.250Z\"".to_owned())
        })
    }

    /// One of a few words.
    pub(super) fn choice<T: Copy>(&mut self, key: &'static str, choices: &[(&str, T)]) -> Result<Option<T>, RecordingError> {
        self.take(key, |value| {
            let found = value.as_str().and_then(|text| choices.iter().find(|(word, _)| *word == text));
            let words = || choices.iter().map(|(word, _)| format!("{word:?}")).collect::<Vec<_>>().join(" or ");
            found.map(|(_, choice)| *choice).ok_or_else(|| format!("must be {}", words()))
        })
    }

    /// A table inside this one.
    pub(super) fn table(&mut self, key: &'static str, known: &'static [&'static str]) -> Result<Option<Self>, RecordingError> {
        let Some((span, value)) = self.entries.remove(key) else {
            return Ok(None);
        };
        match value.into_inner() {
            DeValue::Table(table) => Ok(Some(Self::new(self.document, &format!("[{key}]"), known, span, table))),
            other => {
                Err(self.document.fault(span.start, key, format!("{key:?} must be a table [{key}], but it is a {}", other.type_str())))
            }
        }
    }

    /// An array of tables inside this one.
    pub(super) fn tables(&mut self, key: &'static str, known: &'static [&'static str]) -> Result<Vec<Self>, RecordingError> {
        let Some((span, value)) = self.entries.remove(key) else {
            return Ok(Vec::new());
        };
        let fault = |at: usize, kind: &str| {
            self.document.fault(at, key, format!("{key:?} must be written as tables [[{key}]] (double brackets), but it is a {kind}"))
        };
        let DeValue::Array(array) = value.into_inner() else {
            return Err(fault(span.start, "single table or value"));
        };
        let mut tables = Vec::new();
        for item in array {
            let at = item.span();
            match item.into_inner() {
                DeValue::Table(table) => tables.push(Self::new(self.document, &format!("[[{key}]]"), known, at, table)),
                other => return Err(fault(at.start, &format!("list with a {}", other.type_str()))),
            }
        }
        Ok(tables)
    }

    /// What is left, in the order of the file.
    pub(super) fn left(&self) -> Vec<Left> {
        let mut left: Vec<_> = self.entries.iter().collect();
        left.sort_by_key(|(_, (span, _))| span.start);
        left.into_iter().map(|(key, (_, value))| Left { key: key.clone(), number: number(value.get_ref()) }).collect()
    }

    /// The error for an unknown key, with the likeliest key that was meant.
    pub(super) fn unknown(&self, key: &str, elsewhere: &[(&str, &[&str])]) -> RecordingError {
        let hint = if let Some((table, _)) = elsewhere.iter().find(|(table, keys)| *table != self.name && keys.contains(&key)) {
            format!("it belongs in {table}")
        } else if let Some(meant) = suggestion(key, self.known) {
            format!("did you mean {meant:?}?")
        } else {
            format!("known keys are {}", self.known.join(", "))
        };
        self.fault(key, format!("unknown key {key:?} in {}; {hint}", self.name))
    }

    /// Refuses whatever is left.
    pub(super) fn finish(self, elsewhere: &[(&str, &[&str])]) -> Result<(), RecordingError> {
        self.left().first().map_or(Ok(()), |left| Err(self.unknown(&left.key, elsewhere)))
    }
}

/// A finite number, whole or not.
fn number(value: &DeValue<'_>) -> Option<f64> {
    let found = match value {
        DeValue::Integer(integer) => i64::from_str_radix(integer.as_str(), integer.radix()).ok().map(|whole| whole as f64),
        DeValue::Float(float) => float.as_str().replace('_', "").parse().ok(),
        _ => None,
    };
    found.filter(|number: &f64| number.is_finite())
}

/// The known word nearest to `word`, if any is near.
pub(super) fn suggestion<'k>(word: &str, known: &[&'k str]) -> Option<&'k str> {
    let word = word.to_lowercase();
    let likeness = |candidate: &str| {
        let head = word.len() >= 4 && (candidate.starts_with(&word) || word.starts_with(candidate));
        strsim::normalized_damerau_levenshtein(&word, candidate).max(if head { 0.9 } else { 0.0 })
    };
    let best = known.iter().map(|candidate| (likeness(candidate), *candidate)).fold(None, |best: Option<(f64, &str)>, next| match best {
        Some(best) if best.0 >= next.0 => Some(best),
        _ => Some(next),
    });
    best.filter(|(likeness, _)| *likeness >= 0.6).map(|(_, candidate)| candidate)
}

//! TOML files that serde reads: the line of a place, and the key that was meant.

use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue};

use crate::guard::guarded;

/// Reads the tables of a text; a fault is a sentence with line, key and the key that was meant.
pub(crate) fn tables<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    guarded(|| toml::from_str(text)).map_err(|panicked| panicked.to_string())?.map_err(|error: toml::de::Error| {
        let line = Lines::new(text).line(error.span().map_or(0, |span| span.start));
        format!("line {line}: {}", with_suggestion(error.message()))
    })
}

/// Turns serde's "unknown field `x`, expected one of `a`, `b`" into a sentence with a suggestion.
pub(crate) fn with_suggestion(message: &str) -> String {
    let Some((given, known)) = unknown_field(message) else { return message.replace('\n', " ") };
    match suggestion(given, &known) {
        Some(known) => format!("unknown key {given}; did you mean {known}?"),
        None => message.replacen("unknown field", "unknown key", 1),
    }
}

/// The line of a key with dots and numbers of elements, as `draw[1].path`; where the key is absent, that of the table it belongs to. `None` if not even
/// that is there, or the text is no TOML.
pub(crate) fn line_of(text: &str, key: &str) -> Option<usize> {
    let parsed = guarded(|| DeTable::parse(text)).ok()?.ok()?;
    let mut table = parsed.get_ref();
    let mut found = None;
    for part in key.split('.') {
        let (name, number) = part
            .strip_suffix(']')
            .and_then(|part| part.split_once('['))
            .map_or((part, None), |(name, number)| (name, number.parse::<usize>().ok()));
        let Some((place, value)) = table.get_key_value(name) else { break };
        found = Some(place.span().start);
        let mut inner = value;
        if let (Some(number), DeValue::Array(items)) = (number, value.get_ref()) {
            let Some(item) = items.get(number) else { break };
            (found, inner) = (Some(item.span().start), item);
        }
        match inner.get_ref() {
            DeValue::Table(next) => table = next,
            _ => break,
        }
    }
    found.map(|at| Lines::new(text).line(at))
}

/// Where the lines of a text end: places are asked for thousands of times, and the text is read once.
pub(crate) struct Lines {
    ends: Vec<usize>,
}

impl Lines {
    pub(crate) fn new(text: &str) -> Self {
        Self { ends: text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n').map(|(at, _)| at).collect() }
    }

    /// The line of a byte, from 1.
    pub(crate) fn line(&self, at: usize) -> usize {
        1 + self.ends.partition_point(|end| *end < at)
    }
}

/// The key that serde refused, and those that it knows: serde writes "unknown field `x`, expected one of `a`, `b`".
pub(crate) fn unknown_field(message: &str) -> Option<(&str, Vec<&str>)> {
    let mut quoted = message.strip_prefix("unknown field ")?.split('`').skip(1).step_by(2);
    Some((quoted.next()?, quoted.collect()))
}

/// The key that serde misses: it writes "missing field `x`".
pub(crate) fn missing_field(message: &str) -> Option<&str> {
    message.strip_prefix("missing field `")?.strip_suffix('`')
}

/// The known word nearest to `word`, if any is near.
pub(crate) fn suggestion<'k>(word: &str, known: &[&'k str]) -> Option<&'k str> {
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

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code, reason = "its errors are looked at")]
    struct Two {
        focal_length_mm: f64,
        gain: f64,
    }

    /// The sentences are serde's: a version of it that words them in another way is caught here.
    #[test]
    fn the_keys_are_found_in_the_sentences_of_serde() {
        let fault = |text| toml::from_str::<Two>(text).unwrap_err().message().to_owned();
        let unknown = fault("focal_length_mm = 1.0\ngian = 2.0");
        let (key, known) = unknown_field(&unknown).unwrap();
        assert_eq!((key, known.as_slice()), ("gian", &["focal_length_mm", "gain"][..]));
        assert_eq!(suggestion(key, &known), Some("gain"));
        assert_eq!((missing_field(&unknown), missing_field(&fault("gain = 1.0"))), (None, Some("focal_length_mm")));
        assert_eq!(unknown_field(&fault("gain = true")), None);
    }

    #[test]
    fn a_word_far_from_all_is_no_typing_error() {
        assert_eq!(suggestion("focal_length", &["gain", "focal_length_mm"]), Some("focal_length_mm"));
        assert_eq!(suggestion("wheels", &["gain", "focal_length_mm"]), None);
    }

    #[test]
    fn the_line_of_a_key_is_found_or_that_of_its_table() {
        let text = "seed = 1\n[size]\nframes = { train = 9 }\n\n[[draw]]\npath = \"a\"\n[[draw]]\nper = \"frame\"\npath = \"b\"\n";
        for (key, line) in [
            ("seed", Some(1)),
            ("size.frames.train", Some(3)),
            ("size.members", Some(2)),
            ("draw[0].path", Some(6)),
            ("draw[1].path", Some(9)),
            ("draw[1].uniform", Some(7)),
            ("hard.twins", None),
        ] {
            assert_eq!(line_of(text, key), line, "{key}");
        }
        assert_eq!(line_of("a = ", "a"), None);
    }

    #[test]
    fn lines_count_from_one() {
        let lines = Lines::new("a\n\nb");
        assert_eq!([0, 1, 2, 3, 9].map(|at| lines.line(at)), [1, 1, 2, 3, 3]);
    }
}

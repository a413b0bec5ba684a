//! Reader of the YAML files of camera calibrations: texts and matrices of a few names. The crate `serde-saphyr` takes the YAML apart.
//!
//! What stands under other names is passed over, but a name that stands twice is refused wherever it is. Numbers are read as texts and turned
//! into numbers here, so each has the bits that the standard library gives it. Anchors and aliases are refused: no camera has any, and
//! with them a short file can stand for a long one.

use std::borrow::Cow;
use std::cell::RefCell;
use std::fmt;

use serde::de::{Deserializer as _, IgnoredAny, MapAccess, Visitor};
use serde::{Deserialize, de};
use serde_saphyr::granit_parser::ErrorKind;
use serde_saphyr::{Error, ExternalMessageSource, MergeKeyPolicy, Options, Spanned};

use super::ExchangeError;
use crate::guard::guarded;

/// Names that hold a number or a text.
const TEXTS: &[&str] = &["image_width", "image_height", "distortion_model"];
/// Names that hold a matrix.
const MATRICES: &[&str] = &["camera_matrix", "distortion_coefficients"];

/// Names, numbers and lists of a file together: far more than a camera has, few enough that a wrong file ends in a sentence.
const MAX_NODES: usize = 2 << 20;
/// Lists within lists. A matrix of a camera is two deep.
const MAX_DEPTH: usize = 64;

/// What a name holds.
#[derive(Clone, Debug)]
enum Value {
    /// A number, a word or a quoted text, as it stands there.
    Text(String),
    /// Rows, columns and numbers.
    Matrix(Matrix),
}

/// A matrix as OpenCV and ROS write it; what is `None` is not there.
#[derive(Clone, Debug, Deserialize)]
struct Matrix {
    rows: Option<String>,
    cols: Option<String>,
    data: Option<Spanned<Vec<Spanned<String>>>>,
}

/// A name with its line and what it holds.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    key: String,
    pub(super) line: usize,
    value: Value,
}

/// A file taken apart.
pub(super) struct Document<'a> {
    file: &'a str,
    entries: Vec<Entry>,
}

/// Collects the entries of a file. The name that is being read is kept outside, for what is said of a fault.
struct Names<'a>(&'a RefCell<String>);

impl<'de> Visitor<'de> for Names<'_> {
    type Value = Vec<Entry>;

    fn expecting(&self, to: &mut fmt::Formatter) -> fmt::Result {
        to.write_str("lines of the form `key: value`")
    }

    fn visit_unit<E: de::Error>(self) -> Result<Vec<Entry>, E> {
        Ok(Vec::new())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Vec<Entry>, A::Error> {
        let mut entries = Vec::new();
        while let Some(name) = map.next_key::<Spanned<String>>()? {
            let (key, line) = (name.value, usize::try_from(name.referenced.line()).unwrap_or(usize::MAX));
            self.0.borrow_mut().clone_from(&key);
            let value = if TEXTS.contains(&key.as_str()) {
                Value::Text(map.next_value::<Option<String>>()?.unwrap_or_default())
            } else if MATRICES.contains(&key.as_str()) {
                Value::Matrix(map.next_value()?)
            } else {
                map.next_value::<IgnoredAny>()?;
                continue;
            };
            entries.push(Entry { key, line, value });
        }
        Ok(entries)
    }
}

/// What is allowed of a file.
fn options() -> Options {
    serde_saphyr::options! {
        with_snippet: false,
        merge_keys: MergeKeyPolicy::Error,
        budget: serde_saphyr::budget! {
            max_nodes: MAX_NODES,
            max_events: 2 * MAX_NODES,
            max_depth: MAX_DEPTH,
            max_anchors: 0,
            max_aliases: 0,
        },
    }
}

/// OpenCV begins with `%YAML:1.0`, which is no directive of YAML, and old versions of it go on without `---`: made a comment.
fn without_header(text: &str) -> Cow<'_, str> {
    let text = text.trim_start_matches('\u{feff}');
    text.strip_prefix("%YAML").map_or(Cow::Borrowed(text), |rest| Cow::Owned(format!("#YAML{rest}")))
}

/// What the parser stumbled over, where it was the parser.
fn kind(error: &Error) -> Option<&ErrorKind> {
    let Error::ExternalMessage { source, .. } = error else { return None };
    match source.as_ref() {
        ExternalMessageSource::Parser(error) => Some(error.kind()),
        _ => None,
    }
}

fn too_much(message: &str) -> String {
    format!("is no camera as other programs write it: it is too large or too deep, or has anchors ({message})")
}

/// A fault of the file in our words.
fn told(file: &str, error: &Error, key: &str) -> ExchangeError {
    let whole = error.to_string().replace('\n', " ");
    let message = whole.rsplit_once(" at line ").map_or(whole.as_str(), |(message, _)| message);
    let problem = match error {
        Error::DuplicateMappingKey { key, .. } => format!("{:?} stands there twice; keep one", key.as_deref().unwrap_or("a key")),
        Error::Budget { .. } => too_much(message),
        Error::MultipleDocuments { .. } => "begins another document after ---; keep one of them".to_owned(),
        _ if matches!(kind(error), Some(ErrorKind::RecursionLimitExceeded)) => too_much(message),
        Error::Unexpected { .. } if !key.is_empty() => {
            format!("{key:?} must be a number, a text or a matrix of rows, cols and data ({message})")
        }
        // A list that goes on over the next name is met at the colon of that.
        _ if matches!(kind(error), Some(ErrorKind::UnclosedFlowCollection { .. } | ErrorKind::InvalidColonPlacement)) => {
            format!("a list that begins here or before is never closed with ] ({message})")
        }
        _ => format!("is no YAML that is read here: {message}"),
    };
    match error.location() {
        Some(place) => ExchangeError::at(file, usize::try_from(place.line()).unwrap_or(usize::MAX), problem),
        None => ExchangeError::of(file, problem),
    }
}

impl<'a> Document<'a> {
    /// Takes a file apart.
    pub(super) fn parse(file: &'a str, text: &str) -> Result<Self, ExchangeError> {
        let (text, reading) = (without_header(text), RefCell::default());
        let read = || serde_saphyr::with_deserializer_from_str_with_options(&text, options(), |from| from.deserialize_any(Names(&reading)));
        match guarded(read) {
            Ok(Ok(entries)) => Ok(Self { file, entries }),
            Ok(Err(error)) => Err(told(file, &error, &reading.borrow())),
            Err(panicked) => Err(ExchangeError::of(file, panicked.to_string())),
        }
    }

    fn find(&self, key: &str) -> Option<&Entry> {
        self.entries.iter().find(|entry| entry.key == key)
    }

    fn required(&self, key: &str) -> Result<&Entry, ExchangeError> {
        self.find(key)
            .ok_or_else(|| ExchangeError::of(self.file, format!("{key:?} is missing; add it, or name the file's true format with --from")))
    }

    /// A fault of an entry.
    pub(super) fn fault(&self, entry: &Entry, problem: &str) -> ExchangeError {
        ExchangeError::at(self.file, entry.line, format!("{:?} {problem}", entry.key))
    }

    /// A text, if the key is there.
    pub(super) fn text(&self, key: &str) -> Result<Option<&str>, ExchangeError> {
        match self.find(key) {
            None => Ok(None),
            Some(Entry { value: Value::Text(text), .. }) => Ok(Some(text)),
            Some(entry) => Err(self.fault(entry, "must be a text")),
        }
    }

    /// A number of pixels along a side.
    pub(super) fn side_px(&self, key: &str) -> Result<usize, ExchangeError> {
        let entry = self.required(key)?;
        let Value::Text(text) = &entry.value else { return Err(self.fault(entry, "must be a whole number of pixels")) };
        let side = text.parse::<usize>().ok().filter(|side| (1..=1 << 20).contains(side));
        side.ok_or_else(|| self.fault(entry, &format!("must be a whole number of pixels from 1 to {}, but it is {text:?}", 1 << 20)))
    }

    /// A matrix as `rows`, `cols`, `data`; with `shape` = `None` of any shape.
    pub(super) fn matrix(&self, key: &str, shape: Option<(usize, usize)>) -> Result<(&Entry, Vec<f64>), ExchangeError> {
        let entry = self.required(key)?;
        let Value::Matrix(matrix) = &entry.value else {
            return Err(self.fault(entry, "must be a matrix: rows, cols and data, each on a line of its own"));
        };
        let side = |text: &Option<String>| text.as_ref().and_then(|text| text.parse::<usize>().ok());
        let (Some(rows), Some(cols)) = (side(&matrix.rows), side(&matrix.cols)) else {
            return Err(self.fault(entry, "must have rows and cols, whole numbers"));
        };
        let Some(list) = &matrix.data else {
            return Err(self.fault(entry, "must have data, a list of numbers"));
        };
        let data = list.value.iter().map(|item| number(self.file, item)).collect::<Result<Vec<f64>, _>>()?;
        let line = usize::try_from(list.referenced.line()).unwrap_or(usize::MAX);
        if rows.checked_mul(cols) != Some(data.len()) {
            let problem =
                format!("the data of {key:?} are {} numbers, but {rows} rows × {cols} cols need {}", data.len(), rows.saturating_mul(cols));
            return Err(ExchangeError::at(self.file, line, problem));
        }
        if let Some((r, c)) = shape.filter(|shape| *shape != (rows, cols)) {
            return Err(self.fault(entry, &format!("must have {r} rows and {c} cols, but has {rows} and {cols}")));
        }
        if let Some(value) = data.iter().find(|value| !value.is_finite()) {
            return Err(ExchangeError::at(self.file, line, format!("{key:?} holds {value}, which is no finite number")));
        }
        Ok((entry, data))
    }
}

fn number(file: &str, item: &Spanned<String>) -> Result<f64, ExchangeError> {
    let line = usize::try_from(item.referenced.line()).unwrap_or(usize::MAX);
    let text = &item.value;
    text.parse().map_err(|_| ExchangeError::at(file, line, format!("{text:?} is no number; only numbers may stand in this list")))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// CPU time of this thread, s.
    fn cpu_s() -> f64 {
        let now = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
        now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
    }

    /// The least of three, s.
    fn cost_s(text: &str) -> f64 {
        let once = || {
            let before = cpu_s();
            assert!(Document::parse("big.yml", text).is_ok());
            cpu_s() - before
        };
        (0..3).map(|_| once()).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn eight_times_the_file_takes_no_sixty_four_times_as_long() {
        let keys = |count: usize| (0..count).map(|k| format!("key{k}: {k}\n")).collect::<Vec<_>>().concat();
        let list = |count: usize| format!("data: [ 0,\n{} 1 ]\n", "  0.25,\n".repeat(count));
        for text in [&keys as &dyn Fn(usize) -> String, &list] {
            let ratio = cost_s(&text(40_000)) / cost_s(&text(5_000));
            assert!(ratio < 20.0, "eight times as much takes {ratio:.1} times as long");
        }
        let twice = format!("{}key7: 1\n", keys(100));
        let error = Document::parse("twice.yml", &twice).err().unwrap().to_string();
        assert!(error.contains("line 101") && error.contains("\"key7\" stands there twice"), "{error}");
    }

    /// What is said of a text that is refused.
    fn refusal(text: &str) -> String {
        Document::parse("odd.yml", text).err().unwrap().to_string()
    }

    #[test]
    fn a_file_as_large_as_none_is_read_to_its_end() {
        let keys = (0..300_000).map(|k| format!("key{k}: {k}\n")).collect::<Vec<_>>().concat();
        let document = format!("{keys}image_width: 640\n");
        assert_eq!(Document::parse("big.yml", &document).unwrap().side_px("image_width").unwrap(), 640);
    }

    #[test]
    fn what_is_deep_large_or_refers_to_itself_is_refused() {
        for open in ["[", "{a: ", "- ", "? "] {
            let message = refusal(&format!("a:\n  {}", open.repeat(1_000_000)));
            assert!(message.contains("line 2") && message.contains("too deep"), "{open:?}: {message}");
        }
        for text in ["a: &b 1\n", "a: &b [1]\nc: [*b, *b]\n", "<<: {a: 1}\n"] {
            assert!(refusal(text).contains("line 1"), "{text:?}");
        }
        assert!(refusal(&format!("a: [{}]\n", "1,".repeat(MAX_NODES))).contains("too large"));
        let message = refusal("a: 1\n---\na: 2\n");
        assert!(message.contains("line 3") && message.contains("another document"), "{message}");
    }

    #[test]
    fn a_name_that_stands_twice_is_refused_wherever_it_is() {
        for (text, line) in [("a: 1\na: 2\n", 2), ("b:\n  a: 1\n  a: 2\n", 3), ("camera_matrix:\n  dt: d\n  dt: d\n", 3)] {
            let message = refusal(text);
            assert!(message.contains(&format!("line {line}:")) && message.contains("stands there twice"), "{message}");
        }
    }

    #[test]
    fn lines_are_those_of_the_names_whatever_stands_before_them() {
        let matrix = "camera_matrix: !!opencv-matrix\n   rows: 1\n   cols: 2\n   dt: d\n   data: [ 1210., .5 ]\n";
        // Old versions of OpenCV leave `---` out; lists of texts are of no concern.
        for (before, line) in
            [("%YAML:1.0\n", 2), ("%YAML:1.0\n---\n", 3), ("\u{feff}%YAML:1.0\r\n---\r\n# a\r\n", 4), ("i:\n- \"a.jpg\"\n- b\n", 4)]
        {
            let text = format!("{before}{matrix}");
            let document = Document::parse("camera.yml", &text).unwrap();
            let (entry, data) = document.matrix("camera_matrix", None).unwrap();
            assert_eq!((entry.line, data.as_slice()), (line, &[1210.0, 0.5][..]));
        }
        for (text, words) in [
            ("image_width: [640]\n", ["line 1: \"image_width\"", "number"]),
            ("a: 1\ncamera_matrix: 3\n", ["line 2: \"camera_matrix\"", "matrix"]),
            ("a: [1,\n", ["line 1:", "never closed"]),
        ] {
            let message = refusal(text);
            assert!(words.iter().all(|word| message.contains(word)), "{message}");
        }
    }
}

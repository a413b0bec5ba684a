//! Strict reader of the part of YAML that camera calibrations use: maps, numbers, texts, and lists of numbers. It refuses everything else, with the
//! line.

use std::collections::HashSet;

use super::ExchangeError;

/// What a key may hold.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    /// A number, a word or a quoted text, as it stands there.
    Text(String),
    /// `[1, 2, 3]`, or one number a line after a dash.
    Numbers(Vec<f64>),
    /// Keys one step further to the right.
    Map(Vec<Entry>),
}

/// A key with its line and what it holds.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Entry {
    pub(super) key: String,
    pub(super) line: usize,
    pub(super) value: Value,
}

/// A file taken apart.
pub(super) struct Document<'a> {
    file: &'a str,
    entries: Vec<Entry>,
}

/// A line with something on it, comments taken off; a list that goes on is one line.
struct Line {
    number: usize,
    indent: usize,
    text: String,
}

/// The matrix tag of OpenCV's FileStorage.
const MATRIX_TAG: &str = "!!opencv-matrix";

impl<'a> Document<'a> {
    /// Takes a file apart.
    pub(super) fn parse(file: &'a str, text: &str) -> Result<Self, ExchangeError> {
        let lines = lines(file, text)?;
        let mut rest = lines.as_slice();
        let entries = match rest.first() {
            Some(first) => block(file, &mut rest, first.indent)?,
            None => Vec::new(),
        };
        match rest.first() {
            None => Ok(Self { file, entries }),
            Some(line) => {
                Err(ExchangeError::at(file, line.number, format!("{:?} stands further left than the lines before it", line.text)))
            }
        }
    }

    /// The entry of a key at the top of the file.
    pub(super) fn find(&self, key: &str) -> Option<&Entry> {
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

    /// A matrix as `rows`, `cols`, `data`; with `rows` = `None` of any shape.
    pub(super) fn matrix(&self, key: &str, shape: Option<(usize, usize)>) -> Result<(&Entry, Vec<f64>), ExchangeError> {
        let entry = self.required(key)?;
        let Value::Map(fields) = &entry.value else {
            return Err(self.fault(entry, "must be a matrix: rows, cols and data, each on a line of its own"));
        };
        let field = |name: &str| fields.iter().find(|field| field.key == name);
        let side = |name: &str| match field(name).map(|field| &field.value) {
            Some(Value::Text(text)) => text.parse::<usize>().ok(),
            _ => None,
        };
        let (Some(rows), Some(cols)) = (side("rows"), side("cols")) else {
            return Err(self.fault(entry, "must have rows and cols, whole numbers"));
        };
        let Some(Entry { value: Value::Numbers(data), line, .. }) = field("data") else {
            return Err(self.fault(entry, "must have data, a list of numbers"));
        };
        if rows.checked_mul(cols) != Some(data.len()) {
            let problem =
                format!("the data of {key:?} are {} numbers, but {rows} rows × {cols} cols need {}", data.len(), rows.saturating_mul(cols));
            return Err(ExchangeError::at(self.file, *line, problem));
        }
        if let Some((r, c)) = shape.filter(|shape| *shape != (rows, cols)) {
            return Err(self.fault(entry, &format!("must have {r} rows and {c} cols, but has {rows} and {cols}")));
        }
        if let Some(value) = data.iter().find(|value| !value.is_finite()) {
            return Err(ExchangeError::at(self.file, *line, format!("{key:?} holds {value}, which is no finite number")));
        }
        Ok((entry, data.clone()))
    }
}

/// The lines with something on them.
fn lines(file: &str, text: &str) -> Result<Vec<Line>, ExchangeError> {
    let mut found: Vec<Line> = Vec::new();
    let mut open_list = false;
    for (index, raw) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let number = index + 1;
        let text = without_comment(raw);
        if text.trim().is_empty() || text.starts_with("%YAML") || text == "---" || text == "..." {
            continue;
        }
        let indent = text.len() - text.trim_start_matches(' ').len();
        if text[indent..].starts_with('\t') {
            return Err(ExchangeError::at(file, number, "begins with a tab; YAML is indented with spaces"));
        }
        let text = text.trim();
        // Only the new piece is looked at: a list of many lines is not to be read again with each of them.
        if let Some(last) = found.last_mut().filter(|_| open_list) {
            last.text.push(' ');
            last.text.push_str(text);
        } else {
            found.push(Line { number, indent, text: text.to_owned() });
            open_list = text.contains(": [");
        }
        open_list &= !text.ends_with(']');
    }
    match found.last().filter(|_| open_list) {
        Some(line) => Err(ExchangeError::at(file, line.number, "the list that begins here is never closed with ]")),
        None => Ok(found),
    }
}

/// A line without its comment and the space at its end.
fn without_comment(line: &str) -> &str {
    let mut quote = None;
    let mut before = ' ';
    for (at, c) in line.char_indices() {
        match (quote, c) {
            (None, '#') if before.is_whitespace() => return line[..at].trim_end(),
            (None, '"' | '\'') if before.is_whitespace() => quote = Some(c),
            (Some(open), c) if c == open => quote = None,
            _ => {}
        }
        before = c;
    }
    line.trim_end()
}

/// The keys at one indent.
fn block<'l>(file: &str, rest: &mut &'l [Line], indent: usize) -> Result<Vec<Entry>, ExchangeError> {
    let mut entries: Vec<Entry> = Vec::new();
    let mut known: HashSet<&'l str> = HashSet::new();
    while let Some((line, after)) = rest.split_first() {
        if line.indent < indent {
            break;
        }
        if line.indent > indent {
            return Err(ExchangeError::at(file, line.number, format!("{:?} stands further right than the lines before it", line.text)));
        }
        let colon = line.text.find(": ").or_else(|| line.text.len().checked_sub(1).filter(|at| line.text[*at..] == *":"));
        let Some((key, held)) = colon.map(|at| (line.text[..at].trim().trim_matches('"'), line.text[at + 1..].trim())) else {
            return Err(ExchangeError::at(file, line.number, format!("{:?} is no line of the form `key: value`", line.text)));
        };
        if !known.insert(key) {
            return Err(ExchangeError::at(file, line.number, format!("{key:?} stands there twice; keep one")));
        }
        *rest = after;
        let value = if held.is_empty() || held == MATRIX_TAG {
            nested(file, rest, indent)?
        } else if let Some(list) = held.strip_prefix('[').and_then(|list| list.strip_suffix(']')) {
            let items = list.split(',').map(str::trim).filter(|item| !item.is_empty());
            Value::Numbers(items.map(|item| number(file, line.number, item)).collect::<Result<_, _>>()?)
        } else if held.starts_with(['[', '{', '!', '&', '*', '|', '>']) {
            return Err(ExchangeError::at(
                file,
                line.number,
                format!("{held:?} is YAML that is not read here; write {key:?} as a number, a text, a list of numbers or a matrix"),
            ));
        } else {
            let quoted = ['"', '\''].into_iter().find_map(|q| held.strip_prefix(q)?.strip_suffix(q));
            Value::Text(quoted.unwrap_or(held).to_owned())
        };
        entries.push(Entry { key: key.to_owned(), line: line.number, value });
    }
    Ok(entries)
}

/// What stands below a key: keys further to the right, or one number a line after a dash.
fn nested(file: &str, rest: &mut &[Line], indent: usize) -> Result<Value, ExchangeError> {
    let mut numbers = Vec::new();
    while let Some((line, after)) = rest.split_first() {
        let Some(item) = line.text.strip_prefix("- ").filter(|_| line.indent >= indent) else { break };
        numbers.push(number(file, line.number, item.trim())?);
        *rest = after;
    }
    match rest.first() {
        _ if !numbers.is_empty() => Ok(Value::Numbers(numbers)),
        Some(line) if line.indent > indent => Ok(Value::Map(block(file, rest, line.indent)?)),
        _ => Ok(Value::Text(String::new())),
    }
}

fn number(file: &str, line: usize, text: &str) -> Result<f64, ExchangeError> {
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
}

//! The page of thresholds and the source of `detect` say the same numbers.

use std::collections::BTreeMap;

use crate::house::{relative, root, source_files};

/// Numbers that are no choice: sizes of arrays, and mathematics.
const EXACT: [&str; 15] = [
    "BOX",
    "DISTANCES",
    "EVEN",
    "FIELD_TERMS",
    "GAUSS_LEGENDRE_3",
    "GAUSS_LEGENDRE_4",
    "MAX_PARAMETERS",
    "NOISE_ORDERS",
    "PIXEL_VARIANCE",
    "PROFILE_PARAMETERS",
    "ROUNDING_SIGMA",
    "SLOPED",
    "TERMS",
    "UNKNOWNS",
    "WHOLE_BELOW",
];

/// The values of constants by file and name, in the order of the file.
type Values = BTreeMap<(String, String), Vec<String>>;

/// The constants of a source text that are numbers.
fn constants(text: &str) -> Vec<(String, String)> {
    let code = text.split("#[cfg(test)]").next().unwrap_or_default();
    let constant = |line: &str| {
        let line = line.trim_start();
        let (_, rest) = line.strip_prefix("const ").map(|rest| ("", rest)).or_else(|| line.split_once("pub(super) const "))?;
        let (name, rest) = rest.split_once(": ")?;
        let (_, value) = rest.split_once(" = ")?;
        let is_number = value.starts_with(|c: char| c.is_ascii_digit() || "-([".contains(c));
        is_number.then(|| (name.to_owned(), value.split(';').next().unwrap_or_default().to_owned()))
    };
    code.lines().filter_map(constant).filter(|(name, _)| !EXACT.contains(&name.as_str())).collect()
}

/// The rows of the page: file, name and value.
fn rows(page: &str) -> Vec<(String, String, String)> {
    let cells = |line: &str| -> Option<(String, String, String)> {
        let mut cells = line.strip_prefix("| `")?.split(" | ").map(|cell| cell.trim_matches('`').to_owned());
        let (name, file, value) = (cells.next()?, cells.next()?, cells.next()?);
        file.starts_with("src/").then_some((file, name, value))
    };
    page.lines().filter_map(cells).collect()
}

/// What the page and the source do not agree on.
fn differences(page: &str, sources: &[(String, String)]) -> Vec<String> {
    let (mut told, mut held) = (Values::new(), Values::new());
    for (file, name, value) in rows(page) {
        told.entry((file, name)).or_default().push(value);
    }
    for (file, text) in sources {
        for (name, value) in constants(text) {
            held.entry((file.clone(), name)).or_default().push(value);
        }
    }
    let mut keys: Vec<_> = told.keys().chain(held.keys()).collect();
    keys.sort();
    keys.dedup();
    let differs = keys.into_iter().filter(|key| told.get(key) != held.get(key));
    differs.map(|key| format!("{} {}: the page has {:?}, the source {:?}", key.0, key.1, told.get(key), held.get(key))).collect()
}

#[test]
fn the_page_of_thresholds_has_the_numbers_of_the_source() {
    let page = std::fs::read_to_string(root().join("docs/thresholds.md")).expect("docs/thresholds.md is read");
    assert!(rows(&page).len() > 100, "only {} rows were found", rows(&page).len());
    let read = |path: &std::path::PathBuf| {
        (relative(&root(), path).display().to_string(), std::fs::read_to_string(path).expect("a source file is read"))
    };
    let sources: Vec<(String, String)> = source_files(&root().join("src/detect"), "rs").iter().map(read).collect();
    let wrong = differences(&page, &sources);
    assert!(wrong.is_empty(), "docs/thresholds.md and src/detect differ:\n{}", wrong.join("\n"));
}

#[test]
fn a_stale_page_is_caught() {
    let source = "const MIN_GAIN: f64 = 36.0;\nfn f() {\n    const FEW: usize = 3;\n}\nfn g() {\n    const FEW: usize = 4;\n}\n\
                  pub(super) const RANGE: (f64, f64) = (0.4, 6.0);\nconst UNKNOWNS: usize = 8;\n#[cfg(test)]\nmod tests { const N: u8 = 1; }\n";
    let page = "| `MIN_GAIN` | `src/a.rs` | `36.0` | χ² | hand |\n| `FEW` | `src/a.rs` | `3` | few | hand |\n\
                | `FEW` | `src/a.rs` | `4` | few | hand |\n| `RANGE` | `src/a.rs` | `(0.4, 6.0)` | px | hand |\n";
    let sources = |text: &str| [("src/a.rs".to_owned(), text.to_owned())];
    assert_eq!(differences(page, &sources(source)), Vec::<String>::new());
    for (before, after) in [("36.0", "25.0"), ("const FEW: usize = 4", "const FEW: usize = 5"), ("RANGE", "SPAN")] {
        assert!(!differences(page, &sources(&source.replace(before, after))).is_empty(), "not caught: {after}");
    }
    assert!(!differences(page, &sources(&format!("const NEW: f64 = 1.5;\n{source}"))).is_empty(), "a new constant is not on the page");
}

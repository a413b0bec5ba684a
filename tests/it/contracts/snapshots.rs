//! The words of the help and of the pages, and the keys and values of results, as they were last accepted.
//!
//! Numbers are rounded to [`DIGITS`] significant digits, since the last ones differ between processors. Of long lists the beginning is kept.

use serde_json::{Map, Value};

use super::made::{MADE, run_in};

const DIGITS: usize = 4;
/// Smaller numbers are what rounding leaves of zero, or probabilities and covariances whose digits say nothing.
const ZERO: f64 = 1e-12;
/// Items that are kept of lists of tables, and of lists of anything else.
const TABLES_KEPT: usize = 2;
const ITEMS_KEPT: usize = 8;
/// The largest file of a snapshot.
const LARGEST_BYTES: usize = 64 * 1024;
/// What another build, place or hour changes.
const CHANGING: [&str; 8] = ["version", "commit", "command", "sha256", "seconds", "threads", "adapters", "twin_check"];

fn check(name: &str, text: &str) {
    assert!(text.len() < LARGEST_BYTES, "{name}: {} bytes", text.len());
    let mut settings = insta::Settings::clone_current();
    settings.set_snapshot_path("../snapshots");
    settings.set_prepend_module_to_snapshot(false);
    settings.set_omit_expression(true);
    settings.bind(|| insta::assert_snapshot!(name, text));
}

/// The number as text to a few digits, and back.
fn rounded(number: f64) -> f64 {
    if number.abs() < ZERO { 0.0 } else { format!("{number:.*e}", DIGITS - 1).parse().unwrap() }
}

fn told(value: &Value) -> Value {
    match value {
        Value::Number(number) if number.is_f64() => serde_json::json!(rounded(number.as_f64().unwrap())),
        Value::Array(items) => {
            let kept = if items.iter().any(Value::is_object) { TABLES_KEPT } else { ITEMS_KEPT };
            let mut list: Vec<Value> = items.iter().take(kept).map(told).collect();
            if items.len() > kept {
                list.push(format!("… {} in all", items.len()).into());
            }
            Value::Array(list)
        }
        Value::Object(table) => {
            let of =
                |(key, value): (&String, &Value)| (key.clone(), if CHANGING.contains(&key.as_str()) { "…".into() } else { told(value) });
            Value::Object(table.iter().map(of).collect::<Map<String, Value>>())
        }
        other => other.clone(),
    }
}

fn shown(value: &Value) -> String {
    serde_json::to_string_pretty(&told(value)).unwrap()
}

#[test]
fn results_are_as_accepted() {
    let mut numbers = std::collections::BTreeMap::new();
    for said in MADE.results.iter().filter(|said| !["demo", "scene", "recipe", "suite", "recording", "star-list"].contains(&said.name)) {
        let number = numbers.entry(said.name).and_modify(|number| *number += 1).or_insert(1);
        check(&format!("json_{}_{number}", said.name), &shown(&said.object));
    }
    assert!(numbers.len() >= 18, "{numbers:?}");
}

/// A number that is off in its last digits is the same; a key that is gone, or a number that is off in its first digits, is not.
#[test]
fn what_is_compared_tells_results_apart() {
    let result = MADE.of("compare").next().unwrap();
    let mut gone = result.clone();
    gone.as_object_mut().unwrap().remove("rms_px");
    assert_ne!(shown(result), shown(&gone));
    assert_eq!(shown(&serde_json::json!({"a": 1.234_567})), shown(&serde_json::json!({"a": 1.234_568})));
    assert_ne!(shown(&serde_json::json!({"a": 1.234})), shown(&serde_json::json!({"a": 1.235})));
}

/// A word of a page; what rounding leaves of zero is zero.
fn without_remains(word: &str) -> String {
    let number = word.trim_end_matches([' ', ',', '\n']);
    let is_remains = number.parse::<f64>().is_ok_and(|value| value != 0.0 && value.abs() < ZERO);
    if is_remains { word.replacen(number, "0", 1) } else { word.to_owned() }
}

#[test]
fn pages_are_as_accepted() {
    for (name, page) in &MADE.pages {
        let mut text = page.replace(boresight::provenance::version(), "VERSION");
        // The time that it took ends the line of each frame, or of the method.
        let ends = |line: &str| match *name {
            "identify" => line.rsplit_once(' ').map(|(before, _)| before.trim_end().to_owned()),
            "calibrate" if line.starts_with("method") => line.rsplit_once(", ").map(|(before, _)| before.to_owned()),
            _ => None,
        };
        text = text.lines().map(|line| ends(line).unwrap_or_else(|| line.to_owned()) + "\n").collect();
        if *name == "diagnose" {
            text = text.split_inclusive(' ').map(without_remains).collect();
        }
        check(&format!("page_{name}"), &text);
    }
}

/// The verbs below a command, from its help.
fn verbs(help: &str) -> Vec<&str> {
    let lines = help.split("Commands:\n").nth(1).unwrap_or_default().lines().take_while(|line| !line.trim().is_empty());
    let named = lines.filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    named.filter_map(|line| line.split_whitespace().next()).filter(|verb| *verb != "help").collect()
}

#[test]
fn the_help_is_as_accepted() {
    let folder = tempfile::tempdir().unwrap();
    let mut open = vec![Vec::new()];
    let mut seen = 0;
    while let Some(words) = open.pop() {
        let args: Vec<&str> = words.iter().map(String::as_str).chain(["--help"]).collect();
        let (code, help, stderr) = run_in(folder.path(), &args);
        assert_eq!((code, stderr.as_str()), (0, ""), "{args:?}");
        let longest = help.lines().map(|line| line.chars().count()).max();
        let name = std::iter::once("help").chain(words.iter().map(String::as_str)).collect::<Vec<_>>().join("_");
        println!("{name}: {longest:?}");
        check(&name, &help);
        open.extend(verbs(&help).into_iter().map(|verb| words.iter().cloned().chain([verb.to_owned()]).collect::<Vec<_>>()));
        seen += 1;
    }
    assert!(seen >= 25, "{seen} pages of help");
}

//! The import direction of the source: no room of the house imports one above it, and none imports across the two wings.
//!
//! ```text
//!             main → cli → report
//!                      ↓
//!                   diagnose
//!                ↙             ↘
//!   render → scene → imaging   calibrate → identify → detect
//!                ↘             ↙
//!                  the basement
//! ```
//! The paths are read from the text of the sources, so this also sees code that no test compiles.

use std::path::Path;

use crate::house::{relative, root, source_files};

/// Rooms that both wings stand on. They may import each other.
const BASEMENT: &[&str] = &[
    "camera",
    "catalog",
    "coordinates",
    "dual",
    "effects",
    "frame",
    "gpu",
    "guard",
    "provenance",
    "recording",
    "rng",
    "statistics",
    "units",
];

/// Every room above the basement, with the rooms (besides the basement and itself) that it may import.
const ROOMS: &[(&str, &[&str])] = &[
    ("imaging", &[]),
    ("scene", &["imaging"]),
    ("render", &["scene", "imaging"]),
    ("detect", &[]),
    ("identify", &["detect"]),
    ("calibrate", &["identify", "detect"]),
    ("diagnose", &["render", "scene", "imaging", "calibrate", "identify", "detect"]),
    ("exchange", &["calibrate"]),
    ("pipeline", &["diagnose", "calibrate", "identify", "detect"]),
    ("blind", &["pipeline", "diagnose", "calibrate", "identify", "detect"]),
    ("formats", &["imaging", "scene", "render", "detect", "identify", "calibrate", "diagnose", "pipeline", "blind", "exchange"]),
    ("report", &["imaging", "scene", "render", "detect", "identify", "calibrate", "diagnose"]),
    (
        "cli",
        &[
            "imaging",
            "scene",
            "render",
            "detect",
            "identify",
            "calibrate",
            "diagnose",
            "pipeline",
            "blind",
            "exchange",
            "formats",
            "report",
        ],
    ),
    (
        "main",
        &[
            "imaging",
            "scene",
            "render",
            "detect",
            "identify",
            "calibrate",
            "diagnose",
            "pipeline",
            "blind",
            "exchange",
            "formats",
            "report",
            "cli",
        ],
    ),
];

/// All that the generator of concealed recordings may know of the library, besides itself: nothing of what it hides.
const KNOWN_TO_THE_GENERATOR: &[&str] = &["catalog", "rng", "units", "blind"];

/// Why `from` may not import `to`, or `None` if it may.
fn objection(from: &str, to: &str) -> Option<String> {
    let known = |room: &str| BASEMENT.contains(&room) || ROOMS.iter().any(|(name, _)| *name == room);
    if let Some(stranger) = [from, to].into_iter().find(|room| !known(room)) {
        return Some(format!("`{stranger}` has no place in the house: give it one in tests/it/layering.rs"));
    }
    if from == to {
        return None;
    }
    // What knows wgpu knows no physics: it may say what it ran on, and nothing else.
    if from == "gpu" && to != "provenance" {
        return Some(format!("`gpu` imports `{to}`, but knows wgpu and nothing of what is computed"));
    }
    if BASEMENT.contains(&to) {
        return None;
    }
    if BASEMENT.contains(&from) {
        return Some(format!("`{from}` is in the basement and imports `{to}` above it"));
    }
    let (_, below) = ROOMS.iter().find(|(name, _)| *name == from)?;
    (!below.contains(&to)).then(|| format!("`{from}` imports `{to}`, which is above it or in the other wing"))
}

/// One token of Rust, as far as paths need it.
#[derive(Debug, PartialEq)]
enum Token {
    Word(String),
    PathSeparator,
    Sign(char),
}

/// The tokens of a source text, without comments, strings and numbers' signs.
fn tokens(text: &str) -> Vec<Token> {
    let chars: Vec<char> = text.chars().collect();
    let at = |index: usize| chars.get(index).copied().unwrap_or('\0');
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let mut found = Vec::new();
    let mut i = 0;
    while i < chars.len() {
        match (chars[i], at(i + 1)) {
            ('/', '/') => {
                while i < chars.len() && chars[i] != '\n' {
                    i += 1;
                }
            }
            ('/', '*') => {
                let mut depth = 0;
                while i < chars.len() {
                    match (chars[i], at(i + 1)) {
                        ('/', '*') => (depth, i) = (depth + 1, i + 2),
                        ('*', '/') => (depth, i) = (depth - 1, i + 2),
                        _ => i += 1,
                    }
                    if depth == 0 {
                        break;
                    }
                }
            }
            ('r', '"' | '#') if i == 0 || !is_word(chars[i - 1]) => {
                let hashes = chars[i + 1..].iter().take_while(|c| **c == '#').count();
                if at(i + 1 + hashes) == '"' {
                    let close: String = std::iter::once('"').chain(std::iter::repeat_n('#', hashes)).collect();
                    let rest: String = chars[i + 2 + hashes..].iter().collect();
                    let length = rest.find(&close).map_or(rest.chars().count(), |bytes| rest[..bytes].chars().count());
                    i += 2 + hashes + length + close.len();
                } else {
                    i += 1 + hashes; // a raw identifier
                }
            }
            ('"', _) => {
                i += 1;
                while i < chars.len() && chars[i] != '"' {
                    i += if chars[i] == '\\' { 2 } else { 1 };
                }
                i += 1;
            }
            ('\'', '\\') => {
                i += 3;
                while i < chars.len() && chars[i] != '\'' {
                    i += 1;
                }
                i += 1;
            }
            ('\'', _) if at(i + 2) == '\'' => i += 3,
            (':', ':') => {
                found.push(Token::PathSeparator);
                i += 2;
            }
            (c, _) if is_word(c) => {
                let word: String = chars[i..].iter().take_while(|c| is_word(**c)).collect();
                i += word.chars().count();
                found.push(Token::Word(word));
            }
            (c, _) => {
                if !c.is_whitespace() {
                    found.push(Token::Sign(c));
                }
                i += 1;
            }
        }
    }
    found
}

/// The top-level modules that a source file names. `module` is its own path below the crate, `crate_names` are the words by
/// which the crate's root is called (`crate`, and `boresight` from outside).
fn imported_rooms(module: &[String], text: &str, crate_names: &[&str]) -> Vec<String> {
    let tokens = tokens(text);
    let mut found = Vec::new();
    let mut inline: Vec<(String, usize)> = Vec::new(); // modules written out in the file, with the depth of their braces
    let mut depth = 0;
    let mut i = 0;
    while i < tokens.len() {
        match &tokens[i] {
            Token::Sign('{') => depth += 1,
            Token::Sign('}') => {
                depth -= 1;
                inline.retain(|(_, inside)| *inside <= depth);
            }
            Token::Word(word) if word == "mod" => {
                if let (Some(Token::Word(name)), Some(Token::Sign('{'))) = (tokens.get(i + 1), tokens.get(i + 2)) {
                    inline.push((name.clone(), depth + 1));
                }
            }
            // `super` or `crate` with no path behind it is a visibility: pub(super).
            Token::Word(word)
                if (word == "super" && tokens.get(i + 1) == Some(&Token::PathSeparator)) || crate_names.contains(&word.as_str()) =>
            {
                let starts_path = i == 0 || tokens[i - 1] != Token::PathSeparator;
                let mut here: Vec<&str> = module.iter().map(String::as_str).chain(inline.iter().map(|(name, _)| name.as_str())).collect();
                if word == "super" {
                    while matches!((tokens.get(i), tokens.get(i + 1)), (Some(Token::Word(w)), Some(Token::PathSeparator)) if w == "super") {
                        here.pop();
                        i += 2;
                    }
                    i -= 1; // back on the last separator
                } else {
                    here.clear();
                    i += 1;
                }
                if starts_path && here.is_empty() && tokens.get(i) == Some(&Token::PathSeparator) {
                    found.extend(heads(&tokens[i + 1..]));
                } else if starts_path && word != "super" && matches!(tokens.get(i), Some(Token::Word(next)) if next == "as") {
                    found.push("the crate's root under another name".to_owned());
                } else {
                    found.extend(here.first().map(|room| (*room).to_owned()));
                }
                continue;
            }
            _ => {}
        }
        i += 1;
    }
    found.sort();
    found.dedup();
    found
}

/// The first words of a path, or of every path of a group in braces.
fn heads(tokens: &[Token]) -> Vec<String> {
    match tokens.first() {
        Some(Token::Word(word)) => vec![word.clone()],
        Some(Token::Sign('{')) => {
            let mut found = Vec::new();
            let (mut depth, mut expected) = (0, true);
            for token in tokens {
                match token {
                    Token::Sign('{') => depth += 1,
                    Token::Sign('}') => depth -= 1,
                    Token::Sign(',') if depth == 1 => expected = true,
                    Token::Word(word) if depth == 1 && expected => {
                        expected = false;
                        found.push(word.clone());
                    }
                    _ => {}
                }
                if depth == 0 {
                    break;
                }
            }
            found
        }
        _ => vec!["everything in the crate's root".to_owned()],
    }
}

/// The module path of a file below `src`: `effects/sky/mod.rs` → effects, sky.
fn module_of(below_src: &Path) -> Vec<String> {
    let mut path: Vec<String> = below_src.with_extension("").iter().map(|part| part.to_string_lossy().into_owned()).collect();
    if path.last().is_some_and(|last| last == "mod") {
        path.pop();
    }
    path
}

/// What is wrong with the imports of one file.
fn objections(below_src: &Path, text: &str) -> Vec<String> {
    let module = module_of(below_src);
    let from = module[0].as_str();
    let in_binary = from == "main" || from == "cli";
    let names: &[&str] = if in_binary { &["crate", "boresight"] } else { &["crate"] };
    let mut wrong: Vec<String> = imported_rooms(&module, text, names)
        .iter()
        // `main` declares `cli`, so a function of main itself is `crate::…`; the library's own root holds modules only.
        .filter_map(|to| objection(from, to))
        .map(|reason| format!("src/{}: {reason}", below_src.display()))
        .collect();
    if module.starts_with(&["blind".to_owned(), "generate".to_owned()]) {
        let known = |to: &String| KNOWN_TO_THE_GENERATOR.contains(&to.as_str());
        let strangers = imported_rooms(&module, text, names).into_iter().filter(|to| !known(to));
        wrong.extend(
            strangers.map(|to| format!("src/{}: imports `{to}`, but what is hidden is written apart from it", below_src.display())),
        );
        if leaves_the_generator(module.len() - 2, &tokens(text)) {
            wrong.push(format!("src/{}: the generator knows nothing of the rest of `blind`", below_src.display()));
        }
    }
    let words = tokens(text);
    let names_wgpu = |pair: &[Token]| pair[0] == Token::Word("wgpu".to_owned()) && pair[1] == Token::PathSeparator;
    if from != "gpu" && words.windows(2).any(names_wgpu) {
        wrong.push(format!("src/{}: names wgpu, which only `gpu` knows", below_src.display()));
    }
    wrong
}

/// Whether a file of the generator (this deep below it) names the room around it.
fn leaves_the_generator(depth: usize, tokens: &[Token]) -> bool {
    let is = |token: Option<&Token>, word: &str| token == Some(&Token::Word(word.to_owned()));
    let climbs = |from: usize| tokens[from..].iter().step_by(2).take_while(|token| is(Some(token), "super")).count();
    // A visibility, `pub(super)`, is no path; in tests inside a file one step more leads to the file itself.
    let in_path = |at: usize| tokens.get(at + 1) == Some(&Token::PathSeparator);
    (0..tokens.len()).any(|at| is(tokens.get(at), "blind") || (is(tokens.get(at), "super") && in_path(at) && climbs(at) > depth))
}

#[test]
fn no_module_imports_upwards_or_across_the_wings() {
    let src = root().join("src");
    let mut wrong = Vec::new();
    let mut seen = 0;
    for path in source_files(&src, "rs") {
        let below_src = relative(&src, &path);
        if below_src == Path::new("lib.rs") {
            continue; // declares every room
        }
        seen += 1;
        wrong.extend(objections(&below_src, &std::fs::read_to_string(&path).expect("a source file is read")));
    }
    assert!(seen > 15, "only {seen} source files were found");
    assert!(wrong.is_empty(), "imports against the direction of the house:\n{}", wrong.join("\n"));
}

#[test]
fn every_room_of_the_library_has_its_place() {
    let text = std::fs::read_to_string(root().join("src/lib.rs")).expect("src/lib.rs is read");
    let rooms: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("pub mod ")?.strip_suffix(';')).collect();
    assert!(rooms.len() > 15, "only {} modules were found in src/lib.rs", rooms.len());
    for room in rooms {
        assert_eq!(objection(room, room), None);
    }
}

#[test]
fn a_bad_import_is_caught() {
    let bad = [
        ("camera/mod.rs", "use crate::render::Renderer;"),
        ("camera/mod.rs", "fn f() { let x = crate::scene::Scene::default(); }"),
        ("render/mod.rs", "use crate::{units::DEG_RAD, calibrate::{solve, Weights}};"),
        ("calibrate/solve/step.rs", "use super::super::super::imaging::Stage;"),
        ("detect/mod.rs", "mod tests { use super::super::imaging::psf; }"),
        ("detect/mod.rs", "pub use crate::identify::Match;"),
        ("identify/mod.rs", "use super::calibrate;"),
        ("frame.rs", "use super::*;"),
        ("frame.rs", "use crate as house; use house::render::X;"),
        ("effects/sky/parallax.rs", "type T<'a> = &'a crate::report::Table;"),
        ("gpu/device.rs", "use crate::camera::Camera;"),
        ("render/mod.rs", "fn f(device: &wgpu::Device) {}"),
        ("report/mod.rs", "use crate::cli::Arguments;"),
        ("calibrate/mod.rs", "use crate::render::Renderer;"),
        ("blind/run.rs", "use crate::render::Renderer;"),
        ("blind/generate/sky.rs", "use crate::effects::sky::refraction;"),
        ("blind/generate/mod.rs", "use crate::camera::SkyChain;"),
        ("blind/generate/mod.rs", "use crate::blind::record::recording;"),
        ("blind/generate/mod.rs", "use super::record::recording;"),
        ("blind/generate/sky.rs", "use super::super::record::recording;"),
        ("weather.rs", "use crate::units::DEG_RAD;"),
    ];
    for (path, text) in bad {
        assert!(!objections(Path::new(path), text).is_empty(), "not caught in {path}: {text}");
    }
}

#[test]
fn a_good_import_is_let_through() {
    let good = [
        ("render/mod.rs", "use crate::{scene::{self, Scene}, imaging::Stage, rng};"),
        ("calibrate/mod.rs", "mod solve { mod deep { use super::super::robust; } } use super::identify::Match;"),
        (
            "effects/mod.rs",
            "//! See [`crate::imaging`].\n/* crate::render */ const A: &str = \"crate::render\"; const B: &str = r#\"crate::cli\"#;",
        ),
        ("effects/mod.rs", "const QUOTE: char = '\"'; use crate::coordinates::Direction; const END: char = '\"';"),
        ("detect/mod.rs", "#[cfg(test)] mod tests { use super::*; use crate::rng; }"),
        ("gpu/mod.rs", "use wgpu::Device; use crate::provenance::Provenance;"),
        ("blind/generate/sky.rs", "use super::vector::dot; use crate::{catalog::Catalog, units::DEG_RAD};"),
        ("blind/run.rs", "use super::generate::concealed; use crate::diagnose::diagnose;"),
        ("main.rs", "use boresight::render; mod cli; fn main() { cli::run(); }"),
        ("cli/identify.rs", "use boresight::identify; use crate::cli::output; use super::Arguments;"),
    ];
    for (path, text) in good {
        assert_eq!(objections(Path::new(path), text), Vec::<String>::new(), "{path}: {text}");
    }
}

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

mod circles;
mod paths;

use std::collections::BTreeSet;
use std::path::Path;

use self::paths::{Named, module_of, read};
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
    "parallel",
    "provenance",
    "recording",
    "rng",
    "statistics",
    "toml_file",
    "units",
];

/// Every room above the basement, with the rooms (besides the basement and itself) that it may import.
const ROOMS: &[(&str, &[&str])] = &[
    ("imaging", &[]),
    ("scene", &["imaging"]),
    ("render", &["scene", "imaging"]),
    ("dataset", &["render", "scene", "imaging"]),
    ("detect", &[]),
    ("pixel_statistics", &[]),
    ("identify", &["detect"]),
    ("calibrate", &["identify", "detect"]),
    ("diagnose", &["render", "scene", "imaging", "calibrate", "identify", "detect", "pixel_statistics"]),
    ("exchange", &["calibrate"]),
    ("pipeline", &["diagnose", "calibrate", "identify", "detect", "pixel_statistics"]),
    ("blind", &["pipeline", "diagnose", "calibrate", "identify", "detect"]),
    ("suite", &["imaging", "scene", "render", "dataset", "detect", "identify", "calibrate", "diagnose", "pipeline", "exchange"]),
    ("error", &["imaging", "scene", "render", "dataset", "detect", "identify", "calibrate", "diagnose", "exchange", "pipeline"]),
    (
        "formats",
        &["imaging", "scene", "render", "dataset", "detect", "identify", "calibrate", "diagnose", "pipeline", "blind", "suite", "exchange"],
    ),
    ("report", &["imaging", "scene", "render", "dataset", "detect", "identify", "calibrate", "diagnose"]),
    (
        "cli",
        &[
            "imaging",
            "scene",
            "render",
            "dataset",
            "detect",
            "identify",
            "calibrate",
            "diagnose",
            "pipeline",
            "blind",
            "suite",
            "exchange",
            "pixel_statistics",
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
            "dataset",
            "detect",
            "identify",
            "calibrate",
            "diagnose",
            "pipeline",
            "blind",
            "suite",
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

/// The top-level modules that a path of a file names; `None` for what is not of this crate.
fn room_of(named: &Named, crate_names: &[&str]) -> Option<String> {
    let path = named.absolute(crate_names)?;
    Some(match path.first().map(String::as_str) {
        None => "the crate's root under another name".to_owned(),
        Some("*") => "everything in the crate's root".to_owned(),
        Some(room) => room.to_owned(),
    })
}

/// What is wrong with the imports of one file.
fn objections(below_src: &Path, text: &str) -> Vec<String> {
    let (module, named) = (module_of(below_src), read(below_src, text).named);
    let from = module[0].as_str();
    // `main` declares `cli`, so a function of main itself is `crate::…`; the library's own root holds modules only.
    let names: &[&str] = if from == "main" || from == "cli" { &["crate", "boresight"] } else { &["crate"] };
    let rooms: BTreeSet<String> = named.iter().filter_map(|named| room_of(named, names)).collect();
    let mut wrong: Vec<String> = rooms.iter().filter_map(|to| objection(from, to)).collect();
    let generator = ["blind".to_owned(), "generate".to_owned()];
    if module.starts_with(&generator) {
        let strangers = rooms.iter().filter(|to| !KNOWN_TO_THE_GENERATOR.contains(&to.as_str()));
        wrong.extend(strangers.map(|to| format!("imports `{to}`, but what is hidden is written apart from it")));
        let leaves = |path: Vec<String>| path.first() == generator.first() && !path.starts_with(&generator);
        if named.iter().filter_map(|named| named.absolute(names)).any(leaves) {
            wrong.push("the generator knows nothing of the rest of `blind`".to_owned());
        }
    }
    if from != "gpu" && named.iter().any(|named| named.segments[0] == "wgpu") {
        wrong.push("names wgpu, which only `gpu` knows".to_owned());
    }
    wrong.into_iter().map(|reason| format!("src/{}: {reason}", below_src.display())).collect()
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

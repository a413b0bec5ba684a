//! The features of Cargo: which there are, and that each gates rooms and their crates, not lines here and there. How many items are public is `.ci/surface`'s.

use std::path::Path;

use crate::house::{relative, root, source_files};

/// The features, in the order of the default.
const FEATURES: [&str; 5] = ["cli", "gpu", "plots", "parquet", "bench"];

/// The crates that a feature brings, as the code names them, and where below `src` they may be named.
const GATED: [(&str, &[&str], &str); 5] = [
    ("cli", &["anyhow", "clap", "clap_complete", "clap_mangen", "indicatif", "signal_hook", "terminal_size", "tracing_subscriber"], "cli"),
    ("gpu", &["pollster", "wgpu"], "gpu"),
    ("plots", &["epaint_default_fonts", "plotters", "plotters_backend", "skrifa", "zeno"], "report/drawing"),
    ("parquet", &["parquet"], "report/parquet_file.rs"),
    ("bench", &["quick_junit"], "suite"),
];

fn manifest() -> toml::Table {
    let text = std::fs::read_to_string(root().join("Cargo.toml")).expect("Cargo.toml is read");
    text.parse().expect("Cargo.toml is TOML")
}

fn words(value: &toml::Value) -> Vec<&str> {
    value.as_array().expect("a list").iter().map(|word| word.as_str().expect("a word")).collect()
}

#[test]
fn the_features_are_five_and_each_brings_its_own_crates() {
    let manifest = manifest();
    let features = manifest["features"].as_table().expect("[features]");
    assert_eq!(words(&features["default"]), FEATURES);
    assert_eq!(features.len(), FEATURES.len() + 1, "{:?}", features.keys().collect::<Vec<_>>());
    let mut brought = 0;
    for (feature, crates, _) in GATED {
        let mut given: Vec<String> =
            words(&features[feature]).iter().filter_map(|word| word.strip_prefix("dep:")).map(|name| name.replace('-', "_")).collect();
        given.sort();
        assert_eq!(given, crates, "the feature {feature}");
        brought += given.len();
    }
    let optional = manifest["dependencies"].as_table().expect("[dependencies]").values();
    let optional = optional.filter(|one| one.get("optional").and_then(toml::Value::as_bool) == Some(true)).count();
    assert_eq!(optional, brought, "every optional crate belongs to one feature");
}

/// What is wrong with the gates of a file below `src`: a gated crate that is named outside its room, a gate that is not at a module.
fn objections(below_src: &Path, text: &str) -> Vec<String> {
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let mut wrong = Vec::new();
    let code = text.split("#[cfg(test)]").next().unwrap_or_default();
    for line in code.lines().map(str::trim_start).filter(|line| !line.starts_with("//")) {
        for (feature, crates, place) in GATED {
            for name in crates {
                let used = [format!("{name}::"), format!("use {name};"), format!("use {name} ")];
                let names_it = used.iter().any(|used| {
                    line.match_indices(used.as_str()).any(|(at, _)| !line[..at].ends_with(|c: char| is_word(c) || c == ':' || c == '"'))
                });
                if names_it && !below_src.starts_with(place) {
                    wrong
                        .push(format!("src/{} names {name}, which the feature {feature} brings to src/{place} alone", below_src.display()));
                }
            }
        }
        let declares_modules = below_src.ends_with("mod.rs") || below_src == Path::new("lib.rs");
        if line.contains("feature = \"") && !declares_modules {
            wrong.push(format!("src/{}: a feature gates modules, in a mod.rs or lib.rs: {line}", below_src.display()));
        }
    }
    wrong
}

#[test]
fn gated_crates_are_named_in_their_rooms_alone_and_gates_stand_at_modules() {
    let src = root().join("src");
    let (mut wrong, mut seen) = (Vec::new(), 0);
    for path in source_files(&src, "rs") {
        wrong.extend(objections(&relative(&src, &path), &std::fs::read_to_string(&path).expect("a source file is read")));
        seen += 1;
    }
    assert!(seen > 100, "only {seen} source files were found");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    for (_, _, place) in GATED {
        assert!(src.join(place).exists(), "src/{place} is not there");
    }
}

/// The negative control of the test above.
#[test]
fn a_crate_outside_its_room_and_a_gate_inside_a_function_are_caught() {
    let bad = [
        ("render/mod.rs", "fn f(device: &wgpu::Device) {}"),
        ("report/shown.rs", "use plotters::style::RGBColor;"),
        ("report/data_table.rs", "use parquet::schema::types::Type;"),
        ("recording/open.rs", "use anyhow::Result;"),
        ("scene/file.rs", "#[derive(clap::ValueEnum)]"),
        ("imaging/on_gpu.rs", "#[cfg(feature = \"gpu\")]"),
        ("cli/doctor.rs", "if cfg!(feature = \"gpu\") {}"),
    ];
    for (path, text) in bad {
        assert_eq!(objections(Path::new(path), text).len(), 1, "{path}: {text}");
    }
    let good = [
        ("gpu/device.rs", "use wgpu::Device;"),
        ("report/drawing/canvas.rs", "use plotters::style::RGBColor;"),
        ("report/parquet_file.rs", "use parquet::basic::Type;"),
        ("cli/mod.rs", "use clap::Parser;"),
        ("gpu/mod.rs", "#[cfg(feature = \"gpu\")]"),
        ("lib.rs", "// plotters::style is elsewhere"),
        ("render/mod.rs", "use crate::parquet::Other; use my_wgpu::Device;"),
    ];
    for (path, text) in good {
        assert_eq!(objections(Path::new(path), text), Vec::<String>::new(), "{path}: {text}");
    }
}

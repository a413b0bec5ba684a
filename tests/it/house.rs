//! The house rules that no compiler checks: sizes, documentation, one place for every statement.

use std::path::{Path, PathBuf};
use std::process::Command;

/// The root of the repository.
pub(crate) fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// A path as seen from a folder.
pub(crate) fn relative(folder: &Path, path: &Path) -> PathBuf {
    path.strip_prefix(folder).expect("the path lies below the folder").to_owned()
}

/// Every file below a folder whose name ends in `.extension` (any, if empty), in order of path. What builds and runs leave
/// behind is left out.
pub(crate) fn source_files(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let Ok(entries) = std::fs::read_dir(folder) else { return found };
    for entry in entries {
        let path = entry.expect("a folder is listed").path();
        let made_by_runs = [".git", "target", "outputs"].iter().any(|name| path.file_name().is_some_and(|last| last == *name));
        if path.is_dir() && !made_by_runs {
            found.extend(source_files(&path, extension));
        } else if path.is_file() && !made_by_runs && (extension.is_empty() || path.extension().is_some_and(|e| e == extension)) {
            found.push(path);
        }
    }
    found.sort();
    found
}

fn read(name: &str) -> String {
    std::fs::read_to_string(root().join(name)).unwrap_or_else(|error| panic!("{name} is not readable: {error}"))
}

/// The Rust version that Cargo.toml states.
fn stated_rust_version() -> String {
    let manifest: toml::Table = read("Cargo.toml").parse().expect("Cargo.toml is TOML");
    manifest["package"]["rust-version"].as_str().expect("rust-version is a string").to_owned()
}

fn numbers(version: &str) -> Vec<u32> {
    version.split('.').map(|part| part.parse().unwrap_or(0)).chain(std::iter::repeat(0)).take(3).collect()
}

#[test]
fn no_source_file_is_longer_than_600_lines() {
    let files: Vec<PathBuf> = [("src", "rs"), ("tests", "rs"), ("shaders", "wgsl")]
        .iter()
        .flat_map(|(folder, ext)| source_files(&root().join(folder), ext))
        .collect();
    assert!(files.len() > 20, "only {} source files were found", files.len());
    for path in files {
        let lines = std::fs::read_to_string(&path).expect("a source file is read").lines().count();
        assert!(lines <= 600, "{} has {lines} lines: split it, 300 is the aim and 600 the end", relative(&root(), &path).display());
    }
}

/// The functions of a formatted source file with more lines than `most`: name and lines. One ends where a brace stands as far to the left as it began.
fn long_functions(text: &str, most: usize) -> Vec<(String, usize)> {
    let lines: Vec<&str> = text.lines().collect();
    let mut long = Vec::new();
    for (first, line) in lines.iter().enumerate() {
        let begun = line.trim_start();
        let named = ["pub ", "pub(super) ", "pub(crate) ", "const ", "fn "].iter().any(|word| begun.starts_with(word))
            || begun.starts_with("pub(in ");
        let Some((_, rest)) = begun.split_once("fn ").filter(|_| named) else { continue };
        let end = format!("{}}}", &line[..line.len() - begun.len()]);
        let is_declared = lines[first..].iter().take_while(|line| !line.ends_with('{')).any(|line| line.ends_with(';'));
        let length = 1 + lines[first..].iter().position(|line| *line == end).unwrap_or(0);
        if !is_declared && length > most {
            let name = rest.split(['(', '<']).next().unwrap_or_default();
            long.push((name.to_owned(), length));
        }
    }
    long
}

#[test]
fn no_function_is_longer_than_80_lines() {
    for path in source_files(&root().join("src"), "rs") {
        let text = std::fs::read_to_string(&path).expect("a source file is read");
        let long = long_functions(&text, 80);
        assert!(long.is_empty(), "{}: {long:?}: split it", relative(&root(), &path).display());
    }
    let inner = "        1;\n".repeat(90);
    let text = format!("impl A {{\n    fn short(&self) {{\n        1;\n    }}\n\n    fn long(&self) {{\n{inner}    }}\n}}\n");
    assert_eq!(long_functions(&text, 80), [("long".to_owned(), 92)]);
}

/// Bounds are MAX_ and MIN_.
#[test]
fn constants_name_bounds_as_max_and_min() {
    for path in source_files(&root().join("src"), "rs") {
        let text = std::fs::read_to_string(&path).expect("a source file is read");
        for word in ["MOST", "LEAST", "FEWEST"] {
            let wrong = text.lines().find(|line| [":", "_"].iter().any(|next| line.contains(&format!("const {word}{next}"))));
            assert_eq!(wrong, None, "{}: bounds are MAX_ and MIN_", relative(&root(), &path).display());
        }
    }
}

#[test]
fn every_module_begins_with_its_documentation() {
    for path in source_files(&root().join("src"), "rs") {
        let text = std::fs::read_to_string(&path).expect("a source file is read");
        let first = text.lines().find(|line| !line.trim().is_empty()).unwrap_or_default();
        assert!(first.starts_with("//! "), "{} does not begin with //! and what it is", relative(&root(), &path).display());
    }
}

/// Young crates of a single maintainer, and the only rooms that may name them outside tests: so each can be replaced in one place.
const BEHIND_ONE_ROOM: [(&str, &[&str]); 3] =
    [("fitsio_pure::", &["recording"]), ("serde_saphyr::", &["exchange"]), ("sofars::", &["camera", "blind"])];

#[test]
fn young_dependencies_stay_behind_their_room() {
    let src = root().join("src");
    for (name, rooms) in BEHIND_ONE_ROOM {
        let mut named = 0;
        for path in source_files(&src, "rs") {
            let text = std::fs::read_to_string(&path).expect("a source file is read");
            let code = text.split("#[cfg(test)]").next().unwrap_or_default();
            if !code.lines().any(|line| !line.trim_start().starts_with("//") && line.contains(name)) {
                continue;
            }
            let below_src = relative(&src, &path);
            assert!(
                rooms.iter().any(|room| below_src.starts_with(room)),
                "src/{} names {name}, which only {rooms:?} may",
                below_src.display()
            );
            named += 1;
        }
        assert!(named > 0, "nothing names {name}");
    }
}

#[test]
fn no_file_names_a_place_on_one_persons_machine() {
    // The parts are joined here so that this file does not name them.
    let places = ["home", "root", "Users", "work"].map(|folder| format!("/{folder}/"));
    for path in source_files(&root(), "") {
        let Ok(text) = std::fs::read_to_string(&path) else { continue }; // pictures and catalogues
        for (number, line) in text.lines().enumerate() {
            for place in &places {
                // A relative path such as target/tmp/ may hold the same letters.
                let absolute = line
                    .match_indices(place.as_str())
                    .any(|(at, _)| !line[..at].ends_with(|c: char| c.is_alphanumeric() || "._)}".contains(c)));
                assert!(
                    !absolute,
                    "{}:{}: names {place}…, which others do not have: {line}",
                    relative(&root(), &path).display(),
                    number + 1
                );
            }
        }
    }
}

#[test]
fn no_file_is_too_large_for_a_repository() {
    const MIB: u64 = 1 << 20;
    for path in source_files(&root(), "") {
        let limit = if path.starts_with(root().join("catalogs")) { 1_300_000 } else { MIB };
        let size = std::fs::metadata(&path).expect("a file has a size").len();
        assert!(size <= limit, "{} has {size} bytes, more than {limit}", relative(&root(), &path).display());
    }
}

#[test]
fn the_readme_and_the_continuous_integration_run_the_same_tests() {
    let command = "make test";
    let (readme, makefile) = (read("README.md"), read("Makefile"));
    assert!(
        readme.lines().any(|line| line.split('#').next().unwrap_or_default().trim_end() == command),
        "README.md does not give the line `{command}`"
    );
    assert!(makefile.lines().any(|line| line.starts_with("test:")), "the Makefile has no target `test`");
    // .ci/run takes the command out of the README; this is what it finds there.
    let script = read(".ci/run");
    let filter =
        script.lines().find_map(|line| line.trim().strip_prefix("command=$(")).expect(".ci/run takes the test command from somewhere");
    let output = Command::new("bash").current_dir(root()).args(["-c", filter.trim_end_matches(')')]).output().expect("bash runs");
    assert_eq!(String::from_utf8_lossy(&output.stdout).trim(), command);
    assert!(script.contains("-c \"$command\""), ".ci/run does not run the command that it took from the README");
    let workflow = read(".github/workflows/ci.yml");
    assert!(workflow.contains(&format!("run: {command}")), "the workflow does not run `{command}`");
}

#[test]
fn the_readme_is_short() {
    let bytes = read("README.md").len();
    assert!(bytes <= 12_000, "README.md has {bytes} bytes, more than 12000: move text to a page under docs/ and link it");
}

/// The lines of a page that are not code between fences.
fn prose(text: &str) -> impl Iterator<Item = &str> {
    let mut in_code = false;
    text.lines().filter(move |line| {
        let fence = line.trim_start().starts_with("```");
        in_code ^= fence;
        !in_code && !fence
    })
}

/// The anchor that GitHub gives to a heading.
fn anchor(heading: &str) -> String {
    let kept = heading.to_lowercase().chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c)).collect::<String>();
    kept.replace(' ', "-")
}

/// The relative links of a page that lie in no file, or name no heading of it. `folder`: where the page lies.
fn broken_links(folder: &Path, text: &str) -> Vec<String> {
    let mut broken = Vec::new();
    for line in prose(text) {
        for link in line.split("](").skip(1).filter_map(|rest| rest.split(')').next()).filter(|link| !link.contains("://")) {
            let (path, wanted) = link.split_once('#').unwrap_or((link, ""));
            let target = folder.join(path);
            let page = if path.is_empty() { text.to_owned() } else { std::fs::read_to_string(&target).unwrap_or_default() };
            let mut headings = prose(&page).filter(|line| line.starts_with('#')).map(|line| anchor(line.trim_start_matches('#').trim()));
            if !target.exists() || (!wanted.is_empty() && !headings.any(|heading| heading == wanted)) {
                broken.push(link.to_owned());
            }
        }
    }
    broken
}

#[test]
fn every_relative_link_of_the_pages_leads_somewhere() {
    let named = ["README.md", "CONTRIBUTING.md", "ARCHITECTURE.md", "CONVENTIONS.md", "CHANGELOG.md"].map(|name| root().join(name));
    let pages: Vec<PathBuf> = named.into_iter().filter(|path| path.exists()).chain(source_files(&root().join("docs"), "md")).collect();
    assert!(pages.len() > 10, "only {} pages were found", pages.len());
    for path in pages {
        let text = std::fs::read_to_string(&path).expect("a page is read");
        let broken = broken_links(path.parent().expect("a page lies in a folder"), &text);
        assert!(broken.is_empty(), "{}: links lead nowhere: {}", relative(&root(), &path).display(), broken.join(", "));
    }
    // What is broken is found.
    let page =
        "# A b, c\n[1](#a-b-c) [2](README.md) [3](https://example.org/x) [4](#d) [5](no.md) ![6](README.md#no)\n```\n[7](no.md)\n```\n";
    assert_eq!(broken_links(&root(), page), ["#d", "no.md", "README.md#no"]);
}

#[test]
fn the_rust_version_is_stated_once_and_repeated_truly() {
    let stated = stated_rust_version();
    let readme = read("README.md");
    let mention =
        readme.split("Rust ").skip(1).find(|rest| rest.starts_with(|c: char| c.is_ascii_digit())).expect("README.md states a Rust version");
    assert!(mention.starts_with(&stated), "README.md states Rust {}, Cargo.toml {stated}", mention.split(' ').next().unwrap_or_default());
    assert!(
        !read(".github/workflows/ci.yml").contains(&stated),
        "the workflow repeats the Rust version instead of reading it from Cargo.toml"
    );
}

#[test]
fn the_pinned_toolchain_is_a_release_no_older_than_the_stated_rust_version() {
    let file: toml::Table = read("rust-toolchain.toml").parse().expect("rust-toolchain.toml is TOML");
    let channel = file["toolchain"]["channel"].as_str().expect("the channel is a string");
    let is_release = channel.split('.').count() == 3 && channel.split('.').all(|part| part.parse::<u32>().is_ok());
    assert!(is_release, "rust-toolchain.toml names {channel}, which floats: name a release such as 1.95.0");
    let stated = stated_rust_version();
    assert!(numbers(channel) >= numbers(&stated), "rust-toolchain.toml pins Rust {channel}, Cargo.toml states {stated}");
}

/// What the path of a file of the repository begins with in a guide.
const FOLDERS: [&str; 11] =
    ["src/", "python/", "tests/", "shaders/", "docs/", "benches/", "examples/", "fuzz/", "catalogs/", ".ci/", ".github/"];

/// The paths of the repository that a Markdown text has in backticks, outside its code blocks. Those with a placeholder (`<id>`, `*`) are left out.
fn paths_in_backticks(markdown: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut in_block = false;
    for line in markdown.lines() {
        if line.trim_start().starts_with("```") {
            in_block = !in_block;
        } else if !in_block {
            for span in line.split('`').skip(1).step_by(2) {
                // Of a command the program, of `file.rs::item` the file.
                let word = span.split_whitespace().next().unwrap_or_default();
                let path = word.split("::").next().unwrap_or_default();
                if FOLDERS.iter().any(|folder| path.starts_with(folder)) && !path.contains(['<', '*']) {
                    found.push(path.to_owned());
                }
            }
        }
    }
    found
}

#[test]
fn every_path_that_a_guide_names_exists() {
    for (guide, at_least) in [("ARCHITECTURE.md", 50), ("CONTRIBUTING.md", 50), ("CONVENTIONS.md", 20)] {
        let paths = paths_in_backticks(&read(guide));
        assert!(paths.len() >= at_least, "only {} paths were found in {guide}", paths.len());
        for path in paths {
            assert!(root().join(&path).exists(), "{guide} names `{path}`, which is not in the repository");
        }
    }
}

/// The negative control of the test above.
#[test]
fn paths_in_backticks_are_found_and_placeholders_left_out() {
    let text = "`src/lib.rs` and src/none.rs, `make test`, `src/effects/<room>/<id>.rs`, `shaders/*.wgsl`\n\
                ```text\n`src/none.rs`\n```\n\
                `tests/interop/run PROGRAM FOLDER`, `src/frame.rs::Frame`, `src/nowhere.rs`\n";
    let found = paths_in_backticks(text);
    assert_eq!(found, ["src/lib.rs", "tests/interop/run", "src/frame.rs", "src/nowhere.rs"]);
    assert!(!root().join(&found[3]).exists());
}

#[test]
fn no_dependency_needs_a_newer_rust_than_stated() {
    let stated = stated_rust_version();
    let platform = format!("{}-unknown-linux-gnu", std::env::consts::ARCH);
    let output = Command::new(env!("CARGO"))
        .current_dir(root())
        .args(["metadata", "--format-version", "1", "--locked", "--offline", "--filter-platform", &platform])
        .output()
        .expect("cargo runs");
    assert!(output.status.success(), "cargo metadata failed: {}", String::from_utf8_lossy(&output.stderr));
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).expect("cargo metadata is JSON");
    let packages = metadata["packages"].as_array().expect("packages");
    assert!(packages.len() > 100, "only {} packages were found", packages.len());
    let mut stating = 0;
    for package in packages {
        let Some(needed) = package["rust_version"].as_str() else { continue };
        stating += 1;
        assert!(numbers(needed) <= numbers(&stated), "{} needs Rust {needed}, Cargo.toml states {stated}", package["id"]);
    }
    assert!(stating > 50, "only {stating} packages state a Rust version");
    assert!(numbers("1.100") > numbers("1.89") && numbers("1.89.0") <= numbers("1.89"), "versions are compared as numbers");
}

/// Ids of effects stand in their own files. Who needs one names the constant of `effects::ids`, so that a new effect changes no other room.
#[test]
fn ids_of_effects_are_quoted_in_their_files_alone() {
    /// Rooms that may: the effects themselves, and the generator of concealed recordings, which shares nothing with them.
    const ROOMS: [&str; 2] = ["src/effects/", "src/blind/generate/"];
    /// The same word for something else: a column of a catalogue, a covariate, a channel, another program's model, an option, a file's ending.
    const OTHERS: [(&str, &str); 13] = [
        ("src/catalog/binary.rs", "parallax"),
        ("src/catalog/import.rs", "parallax"),
        ("src/cli/diagnose_files.rs", "proper-motion"),
        ("src/cli/diagnose_files.rs", "parallax"),
        ("src/cli/update.rs", "projection"),
        ("src/calibrate/solve.rs", "projection"),
        ("src/diagnose/channels.rs", "background"),
        ("src/diagnose/profile.rs", "proper-motion"),
        ("src/exchange/forward.rs", "equidistant"),
        ("src/exchange/mod.rs", "equidistant"),
        ("src/exchange/ros.rs", "equidistant"),
        ("src/recording/image_file.rs", "jpeg"),
        ("src/scene/effect_demo.rs", "projection"),
    ];
    let ids: Vec<String> = boresight::effects::DISPLACEMENTS
        .iter()
        .map(|effect| effect.id().to_owned())
        .chain(boresight::effects::pixel::PIXEL_EFFECTS.iter().map(|effect| effect.id().to_owned()))
        .collect();
    let mut checked = 0;
    for path in source_files(&root().join("src"), "rs") {
        let file = format!("src/{}", relative(&root().join("src"), &path).display());
        // A file of tests is declared as one in its room.
        if ROOMS.iter().any(|room| file.starts_with(room)) || file.ends_with("tests.rs") {
            continue;
        }
        let text = read(&file);
        let text = text.split("#[cfg(test)]").next().unwrap_or_default();
        assert!(
            !text.contains(".replace('-', \"_\")") && !text.contains(".replace('_', \"-\")"),
            "{file}: effects::stem_of and id_of do that"
        );
        for id in &ids {
            for spelling in [id.clone(), boresight::effects::stem_of(id)] {
                let is_other = OTHERS.contains(&(file.as_str(), id.as_str()));
                assert!(is_other || !text.contains(&format!("\"{spelling}\"")), "{file} quotes the id {spelling}; name effects::ids");
                checked += 1;
            }
        }
    }
    assert!(checked > 10_000, "{checked}");
}

/// A name of a public type means one thing.
#[test]
fn no_two_public_types_share_a_name() {
    let mut first: std::collections::BTreeMap<String, String> = std::collections::BTreeMap::new();
    for path in source_files(&root().join("src"), "rs") {
        let file = relative(&root(), &path).display().to_string();
        for line in read(&file).lines() {
            let words: Vec<&str> = line.split(|c: char| !c.is_alphanumeric() && c != '_').filter(|word| !word.is_empty()).collect();
            let ["pub", "struct" | "enum" | "trait" | "type", name, ..] = words[..] else { continue };
            if line.starts_with("pub ")
                && let Some(other) = first.insert(name.to_owned(), file.clone())
            {
                panic!("{name} is a public type of {other} and of {file}; name one of them for what it is");
            }
        }
    }
    assert!(first.len() > 200, "{}", first.len());
}

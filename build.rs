//! Says of which commit a release build is made, as far as that is known: `BORESIGHT_COMMIT` at compile time, read by src/provenance.rs.
//!
//! Of what: the variable of that name in the environment, if it is set; else the commit that is checked out here, with `-dirty` where tracked files
//! differ from it; else that of a crate from a registry. Builds for development do not ask git, since each commit would compile them anew.
//!
//! Also shortens the JSON Schemas that the program holds.

use std::path::Path;
use std::process::Command;

fn main() -> std::io::Result<()> {
    println!("cargo::rerun-if-changed=build.rs");
    schemas()?;
    println!("cargo::rerun-if-env-changed=BORESIGHT_COMMIT");
    let root = std::env::var("CARGO_MANIFEST_DIR").unwrap_or_default();
    let given = std::env::var("BORESIGHT_COMMIT").ok();
    let release = std::env::var("PROFILE").is_ok_and(|profile| profile == "release");
    let found = given.or_else(|| if release { checked_out(&root).or_else(|| published(&root)) } else { None });
    if let Some(commit) = found.filter(|commit| is_plausible(commit)) {
        println!("cargo::rustc-env=BORESIGHT_COMMIT={commit}");
    }
    Ok(())
}

/// The JSON Schemas without the spaces and line ends that make them readable, which are two fifths of their text, for the program to hold.
fn schemas() -> std::io::Result<()> {
    let out = std::env::var("OUT_DIR").unwrap_or_default();
    for (from, to) in [("src/formats/schemas", "schemas"), ("src/scene/schema.json", "scene-schema.json")] {
        println!("cargo::rerun-if-changed={from}");
        let to = Path::new(&out).join(to);
        if Path::new(from).is_file() {
            shorten(Path::new(from), &to)?;
            continue;
        }
        std::fs::create_dir_all(&to)?;
        for entry in std::fs::read_dir(from)? {
            let file = entry?.path();
            if let Some(name) = file.file_name() {
                shorten(&file, &to.join(name))?;
            }
        }
    }
    Ok(())
}

fn shorten(from: &Path, to: &Path) -> std::io::Result<()> {
    let text = std::fs::read_to_string(from)?;
    let (mut is_word, mut is_escaped) = (false, false);
    let short: String = text
        .chars()
        .filter(|c| {
            let keeps = is_word || !c.is_ascii_whitespace();
            if *c == '"' && !is_escaped {
                is_word = !is_word;
            }
            is_escaped = *c == '\\' && !is_escaped;
            keeps
        })
        .collect();
    std::fs::write(to, short)
}

/// Letters and digits, and what marks a changed tree; so that nothing else gets into results.
fn is_plausible(commit: &str) -> bool {
    !commit.is_empty() && commit.len() <= 64 && commit.chars().all(|c| c.is_ascii_alphanumeric() || c == '-')
}

fn git(root: &str, args: &[&str]) -> Option<String> {
    let output = Command::new("git").arg("-C").arg(root).args(args).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// The commit of the checkout that has its root here: a crate that lies in the checkout of another project is not of its commits.
fn checked_out(root: &str) -> Option<String> {
    let top = git(root, &["rev-parse", "--show-toplevel"])?;
    if Path::new(&top).canonicalize().ok()? != Path::new(root).canonicalize().ok()? {
        return None;
    }
    // What changes with every commit and checkout, and what the program is made of.
    for file in ["HEAD", "logs/HEAD"] {
        if let Some(path) = git(root, &["rev-parse", "--git-path", file]) {
            let path = Path::new(root).join(path);
            if path.exists() {
                println!("cargo::rerun-if-changed={}", path.display());
            }
        }
    }
    for part in ["src", "shaders", "catalogs", "benches", "examples", "Cargo.toml", "Cargo.lock"] {
        println!("cargo::rerun-if-changed={part}");
    }
    let commit = git(root, &["rev-parse", "--short=12", "HEAD"])?;
    let changed = git(
        root,
        &[
            "status",
            "--porcelain",
            "--untracked-files=no",
            "--",
            "src",
            "shaders",
            "catalogs",
            "benches",
            "examples",
            "Cargo.toml",
            "Cargo.lock",
        ],
    )?;
    Some(if changed.is_empty() { commit } else { format!("{commit}-dirty") })
}

/// The commit that `cargo package` noted.
fn published(root: &str) -> Option<String> {
    println!("cargo::rerun-if-changed=.cargo_vcs_info.json");
    let text = std::fs::read_to_string(Path::new(root).join(".cargo_vcs_info.json")).ok()?;
    let after = text.split("\"sha1\"").nth(1)?;
    let commit = after.split('"').nth(1)?;
    Some(commit.chars().take(12).collect())
}

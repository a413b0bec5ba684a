//! No file of a room imports, through others or not, one that imports it.
//!
//! A file imports what its `use` trees and the paths in its code name, modules of tests left out. A name that a `mod.rs` hands on counts for
//! the file that defines it; a `mod.rs` that only declares and hands on is no file of a circle. What is
//! reached through a method alone, without a name, is not seen.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::{Path, PathBuf};

use super::paths::{Source, module_of, read};
use crate::house::{relative, root, source_files};

/// Rooms whose files still import each other in circles. A room that has none any more is taken off.
const TANGLED: &[&str] =
    &["blind", "catalog", "cli", "effects", "exchange", "gpu", "identify", "imaging", "pipeline", "recording", "render", "scene"];

/// What a file imports: the other files, each with the names.
type Imports = BTreeMap<PathBuf, BTreeMap<PathBuf, BTreeSet<String>>>;

struct Sources(BTreeMap<Vec<String>, (PathBuf, Source)>);

impl Sources {
    fn new(files: impl IntoIterator<Item = (PathBuf, String)>) -> Self {
        Self(files.into_iter().map(|(path, text)| (module_of(&path), (path.clone(), read(&path, &text)))).collect())
    }

    /// A path as a module names it, from the root of the crate; `None` where it leads out of it.
    fn absolute(&self, module: &[String], named: &super::paths::Named, depth: usize) -> Option<Vec<String>> {
        if let Some(path) = named.absolute(&["crate"]) {
            return Some(path);
        }
        let (first, rest) = named.segments.split_first()?;
        let below: Vec<String> = module.iter().chain([first]).cloned().collect();
        if self.0.contains_key(&below) {
            return Some(below.into_iter().chain(rest.iter().cloned()).collect());
        }
        let brought = self.brought(module, first, depth)?;
        Some(brought.into_iter().chain(rest.iter().cloned()).collect())
    }

    /// What a name stands for that a `use` of the module brings in.
    fn brought(&self, module: &[String], name: &str, depth: usize) -> Option<Vec<String>> {
        let (_, source) = self.0.get(module)?;
        let mut imports = source.named.iter().filter(|named| !named.in_test && named.alias.as_deref() == Some(name));
        imports.find_map(|named| if depth > 0 { self.absolute(module, named, depth - 1) } else { None })
    }

    /// The file that defines what a path from the root names, and the name; `None` for a module itself and for what is not of the crate.
    fn owner(&self, path: &[String], depth: usize) -> Option<(&Path, String)> {
        let length = (1..=path.len()).rev().find(|length| self.0.contains_key(&path[..*length]))?;
        let (module, name) = (&path[..length], path.get(length)?);
        match self.brought(module, name, depth) {
            Some(further) if depth > 0 && further != path => {
                let whole: Vec<String> = further.into_iter().chain(path[length + 1..].iter().cloned()).collect();
                self.owner(&whole, depth - 1)
            }
            _ => Some((&self.0[module].0, name.clone())),
        }
    }

    fn imports(&self) -> Imports {
        const DEPTH: usize = 8;
        let mut found = Imports::new();
        for (module, (path, source)) in &self.0 {
            let is_facade = path.ends_with("mod.rs");
            // What a `mod.rs` only hands on, its own code does not stand on.
            let counts = |named: &&super::paths::Named| !(named.in_test || is_facade && named.handed_on);
            for named in source.named.iter().filter(counts).filter(|_| source.has_code) {
                let owner = self.absolute(module, named, DEPTH).and_then(|whole| self.owner(&whole, DEPTH));
                if let Some((file, name)) = owner.filter(|(file, _)| file != path) {
                    found.entry(path.clone()).or_default().entry(file.to_owned()).or_default().insert(name);
                }
            }
        }
        found
    }
}

/// The shortest circle through each file that lies in one, each told once as a chain of files with what each imports of the next.
fn circles(imports: &Imports) -> Vec<(Vec<PathBuf>, String)> {
    let mut found: BTreeMap<Vec<PathBuf>, String> = BTreeMap::new();
    for start in imports.keys() {
        let mut before: BTreeMap<&Path, &Path> = BTreeMap::new();
        let mut ahead = VecDeque::from([start.as_path()]);
        while let Some(file) = ahead.pop_front().filter(|_| !before.contains_key(start.as_path())) {
            for next in imports.get(file).into_iter().flat_map(BTreeMap::keys) {
                if !before.contains_key(next.as_path()) {
                    before.insert(next, file);
                    ahead.push_back(next);
                }
            }
        }
        let mut chain = vec![start.clone()];
        while let Some(file) = before.get(chain[0].as_path()).filter(|_| before.contains_key(start.as_path())) {
            chain.insert(0, file.to_path_buf());
            if *file == start {
                break;
            }
        }
        if chain.len() > 1 {
            let step = |pair: &[PathBuf]| {
                let names: Vec<&str> = imports[&pair[0]][&pair[1]].iter().map(String::as_str).collect();
                format!("{} → {} ({})", pair[0].display(), pair[1].display(), names.join(", "))
            };
            let told = chain.windows(2).map(step).collect::<Vec<_>>().join("; ");
            let mut files: Vec<PathBuf> = chain.into_iter().skip(1).collect();
            files.sort();
            found.entry(files).or_insert(told);
        }
    }
    found.into_iter().collect()
}

fn circles_of(files: &[(&str, &str)]) -> Vec<String> {
    let sources = Sources::new(files.iter().map(|(path, text)| (PathBuf::from(path), (*text).to_owned())));
    circles(&sources.imports()).into_iter().map(|(_, told)| told).collect()
}

#[test]
fn no_file_of_a_room_imports_in_a_circle() {
    let src = root().join("src");
    let text = |path: &PathBuf| std::fs::read_to_string(path).expect("a source file is read");
    let sources = Sources::new(source_files(&src, "rs").iter().map(|path| (relative(&src, path), text(path))));
    let imports = sources.imports();
    assert!(imports.len() > 100, "only {} files import others", imports.len());
    let found = circles(&imports);
    let known = |files: &[PathBuf]| files.iter().all(|file| TANGLED.iter().any(|room| file.starts_with(room)));
    let wrong: Vec<&str> = found.iter().filter(|(files, _)| !known(files)).map(|(_, told)| told.as_str()).collect();
    assert!(wrong.is_empty(), "{} circles of imports:\n{}", wrong.len(), wrong.join("\n"));
    for room in TANGLED {
        assert!(found.iter().any(|(files, _)| files[0].starts_with(room)), "`{room}` has no circle any more: take it off TANGLED");
    }
}

#[test]
fn a_circle_is_found() {
    let of_two =
        [("detect/a.rs", "use super::b::B; pub struct A;"), ("detect/b.rs", "fn f() { let a = crate::detect::a::A; } pub struct B;")];
    let of_three = [
        ("detect/a.rs", "use super::b; fn f() { b::g(); }"),
        ("detect/b.rs", "pub fn g() { println!(\"{}\", super::c::C) }"),
        ("detect/c.rs", "mod inner { type T = super::super::a::A; } pub const C: u8 = 1;"),
    ];
    let handed_on = [
        ("detect/mod.rs", "mod a; mod parts; pub use self::parts::C as D; pub use a::A;"),
        ("detect/a.rs", "use crate::detect::{self, D}; pub struct A(D);"),
        ("detect/parts/mod.rs", "mod c; pub use c::C;"),
        ("detect/parts/c.rs", "use crate::detect; pub struct C; impl C { fn f(_: detect::A) {} }"),
    ];
    let with_the_folder =
        [("detect/mod.rs", "mod a; pub struct Options; fn f() { a::g() }"), ("detect/a.rs", "pub fn g(_: super::Options) {}")];
    for (files, length) in [(&of_two[..], 2), (&of_three[..], 3), (&handed_on[..], 2), (&with_the_folder[..], 2)] {
        let found = circles_of(files);
        assert!(found.len() == 1 && found[0].matches('→').count() == length, "{files:?}: {found:?}");
    }
    assert_eq!(circles_of(&of_two), ["detect/a.rs → detect/b.rs (B); detect/b.rs → detect/a.rs (A)"]);
}

#[test]
fn what_is_no_circle_is_let_through() {
    let harmless = [
        ("detect/mod.rs", "mod a; mod b; pub use a::A; pub use b::B; pub struct Options;"),
        ("detect/a.rs", "use super::{B, Options}; /* crate::detect::c::C */ pub(in crate::detect) struct A(B, Options);"),
        ("detect/b.rs", "use super::Options; pub struct B; #[cfg(test)] mod tests { use super::super::a::A; }"),
        ("detect/c.rs", "use super::a::A; use super::b::B; const TEXT: &str = \"crate::detect::c\";"),
    ];
    assert_eq!(circles_of(&harmless), Vec::<String>::new());
}

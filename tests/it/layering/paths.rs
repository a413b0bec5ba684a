//! The paths that a source file names, as `syn` reads them: of `use` trees, in code, and in what macros are given.

use std::path::Path;

use syn::buffer::Cursor;
use syn::parse::ParseStream;
use syn::visit::{self, Visit};

/// The macro that re-exports what is public with a feature alone.
const REEXPORT: &str = "inner";

/// One path of a file.
pub(super) struct Named {
    /// As written; one that a `use` takes everything from ends in `*`.
    pub(super) segments: Vec<String>,
    /// The module that it stands in, from the root of the crate.
    pub(super) within: Vec<String>,
    /// The name that a `use` gives it.
    pub(super) alias: Option<String>,
    /// Whether a `use` hands it on.
    pub(super) handed_on: bool,
    /// Whether it stands in a module of tests.
    pub(super) in_test: bool,
}

impl Named {
    /// The same from the root of the crate, if it begins there or with `self` or `super`.
    pub(super) fn absolute(&self, crate_names: &[&str]) -> Option<Vec<String>> {
        let (first, rest) = self.segments.split_first()?;
        if crate_names.contains(&first.as_str()) {
            return Some(rest.to_vec());
        }
        let climbs = self.segments.iter().take_while(|segment| *segment == "super").count();
        let skipped = if first == "self" { 1 } else { climbs };
        let around = &self.within[..self.within.len().saturating_sub(climbs)];
        (skipped > 0).then(|| around.iter().chain(&self.segments[skipped..]).cloned().collect())
    }
}

/// What was found in a file.
pub(super) struct Source {
    pub(super) named: Vec<Named>,
    /// Whether it holds more than declarations of modules and imports.
    pub(super) has_code: bool,
}

/// Reads a file below `src`.
pub(super) fn read(below_src: &Path, text: &str) -> Source {
    let file = syn::parse_file(text).unwrap_or_else(|error| panic!("src/{} is not Rust: {error}", below_src.display()));
    let mut reader = Reader { module: module_of(below_src), named: Vec::new(), in_test: false };
    reader.visit_file(&file);
    let is_code = |item: &syn::Item| match item {
        syn::Item::Mod(module) => module.content.is_some() && !is_for_tests(&module.attrs),
        syn::Item::Macro(called) => !called.mac.path.is_ident(REEXPORT),
        item => !matches!(item, syn::Item::Use(_)),
    };
    Source { named: reader.named, has_code: file.items.iter().any(is_code) }
}

/// The module path of a file below `src`: `effects/sky/mod.rs` → effects, sky.
pub(super) fn module_of(below_src: &Path) -> Vec<String> {
    let mut path: Vec<String> = below_src.with_extension("").iter().map(|part| part.to_string_lossy().into_owned()).collect();
    if path.last().is_some_and(|last| last == "mod") {
        path.pop();
    }
    path
}

fn is_for_tests(attributes: &[syn::Attribute]) -> bool {
    let is_test = |attribute: &syn::Attribute| {
        attribute.path().is_ident("cfg") && attribute.parse_args::<syn::Path>().is_ok_and(|condition| condition.is_ident("test"))
    };
    attributes.iter().any(is_test)
}

struct Reader {
    module: Vec<String>,
    named: Vec<Named>,
    in_test: bool,
}

impl Reader {
    fn found(&mut self, segments: Vec<String>, alias: Option<String>, handed_on: bool) {
        self.named.push(Named { segments, within: self.module.clone(), alias, handed_on, in_test: self.in_test });
    }

    fn imported(&mut self, tree: &syn::UseTree, before: &[String], handed_on: bool) {
        let with = |name: &syn::Ident| before.iter().cloned().chain([name.to_string()]).collect::<Vec<_>>();
        let mut one = |mut path: Vec<String>, alias: Option<String>| {
            path.truncate(path.len() - usize::from(path.len() > 1 && path.ends_with(&["self".to_owned()])));
            let alias = alias.or_else(|| path.last().cloned());
            self.found(path, alias, handed_on);
        };
        match tree {
            syn::UseTree::Path(path) => self.imported(&path.tree, &with(&path.ident), handed_on),
            syn::UseTree::Name(name) => one(with(&name.ident), None),
            syn::UseTree::Rename(name) => one(with(&name.ident), Some(name.rename.to_string())),
            syn::UseTree::Glob(_) => self.found(before.iter().cloned().chain(["*".to_owned()]).collect(), None, handed_on),
            syn::UseTree::Group(group) => group.items.iter().for_each(|tree| self.imported(tree, before, handed_on)),
        }
    }

    /// The paths among the tokens that a macro is given.
    fn tokens(&mut self, mut at: Cursor<'_>) {
        let (mut path, mut colons) = (Vec::new(), 0);
        while !at.eof() {
            if let Some((ident, next)) = at.ident() {
                if colons != 2 {
                    self.ended(&mut path);
                }
                path.push(ident.to_string());
                (at, colons) = (next, 0);
            } else if let Some((_, next)) = at.punct().filter(|(punct, _)| punct.as_char() == ':') {
                (at, colons) = (next, colons + 1);
            } else {
                self.ended(&mut path);
                colons = 0;
                if let Some((inside, _, _, _)) = at.any_group() {
                    self.tokens(inside);
                }
                let Some((_, next)) = at.token_tree() else { break };
                at = next;
            }
        }
        self.ended(&mut path);
    }

    /// `super` or `crate` with nothing behind it is a visibility.
    fn ended(&mut self, path: &mut Vec<String>) {
        let path = std::mem::take(path);
        if path.len() > 1 || path.first().is_some_and(|only| only != "crate" && only != "super") {
            self.found(path, None, false);
        }
    }
}

impl<'ast> Visit<'ast> for Reader {
    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        self.imported(&item.tree, &[], !matches!(item.vis, syn::Visibility::Inherited));
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        self.found(path.segments.iter().map(|segment| segment.ident.to_string()).collect(), None, false);
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, called: &'ast syn::Macro) {
        self.visit_path(&called.path);
        // The macro of the crate that re-exports: what it is given is the tree of a `use`.
        if called.path.is_ident(REEXPORT) {
            let tree = called.parse_body::<syn::UseTree>().expect("`inner!` is given the tree of a `use`");
            self.imported(&tree, &[], true);
            return;
        }
        let read = |input: ParseStream<'_>| {
            input.step(|cursor| {
                self.tokens(*cursor);
                Ok(((), Cursor::empty()))
            })
        };
        called.parse_body_with(read).expect("any tokens are read");
    }

    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        let before = self.in_test;
        self.in_test |= is_for_tests(&item.attrs);
        self.module.push(item.ident.to_string());
        visit::visit_item_mod(self, item);
        self.module.pop();
        self.in_test = before;
    }

    /// `pub(super)` is no import.
    fn visit_vis_restricted(&mut self, _: &'ast syn::VisRestricted) {}

    /// Attributes name macros of other crates.
    fn visit_attribute(&mut self, _: &'ast syn::Attribute) {}
}

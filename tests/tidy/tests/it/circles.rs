//! Files of a crate that import each other in circles: none of them can be read without the others.
//!
//! A file that takes something from the one whose module it is in counts for nothing: what is above holds what those below it
//! share.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use proc_macro2::{Delimiter, TokenTree};

use crate::{
    root, rust_files, shown,
    sources::{crates, tokens},
};

/// Circles that there are, by the file that comes first in each. A circle that is gone leaves the list.
const KNOWN: [&str; 1] = [
    // All that is said of a screen, its word in addresses and its key included, is in the screen's own file, so that a new
    // screen is a file and a line. The list of screens therefore names their modules, and screens lead to each other by it.
    "ui/src/commands.rs",
];

type Module = Vec<String>;

/// Paths in `tokens`, each behind `prefix`: those of `use` with their braces resolved, and those of the code.
fn paths(tokens: &[TokenTree], prefix: &[String], found: &mut Vec<Vec<String>>) {
    let mut next = 0;
    while let Some(token) = tokens.get(next) {
        next += 1;
        let name = match token {
            TokenTree::Ident(name) => name.to_string(),
            TokenTree::Group(group) => {
                paths(&group.stream().into_iter().collect::<Vec<_>>(), &[], found);
                continue;
            }
            _ => continue,
        };
        let mut path = prefix.to_vec();
        path.push(name);
        let is = |at: usize, punct: char| matches!(tokens.get(at), Some(TokenTree::Punct(p)) if p.as_char() == punct);
        while is(next, ':') && is(next + 1, ':') {
            match tokens.get(next + 2) {
                Some(TokenTree::Ident(name)) => path.push(name.to_string()),
                Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Brace => {
                    paths(&group.stream().into_iter().collect::<Vec<_>>(), &path, found);
                    path.clear();
                    next += 3;
                    break;
                }
                _ => break,
            }
            next += 3;
        }
        found.push(path);
    }
}

/// The module that `path` leads to from `here`; `None` for one of another crate.
fn target(path: &[String], here: &Module, modules: &BTreeMap<Module, String>) -> Option<Module> {
    let (first, rest) = path.split_first()?;
    let mut module = match first.as_str() {
        "crate" => Vec::new(),
        "self" => here.clone(),
        "super" => here[..here.len().saturating_sub(1)].to_vec(),
        child => {
            let mut below = here.clone();
            below.push(child.to_owned());
            modules.contains_key(&below).then_some(below)?
        }
    };
    for name in rest {
        match name.as_str() {
            "super" => _ = module.pop(),
            name => {
                module.push(name.to_owned());
                if !modules.contains_key(&module) {
                    module.pop();
                    break;
                }
            }
        }
    }
    Some(module)
}

/// The files of a crate by their modules; tests are none.
fn modules(src: &Path) -> BTreeMap<Module, std::path::PathBuf> {
    let mut modules = BTreeMap::new();
    for path in rust_files(src) {
        let inside = path.strip_prefix(src).expect("a file of the folder").with_extension("");
        let mut module: Module = inside.iter().map(|part| part.to_string_lossy().into_owned()).collect();
        if module.iter().any(|part| part == "tests") {
            continue;
        }
        if ["lib", "main", "mod"].contains(&module.last().map(String::as_str).unwrap_or_default()) {
            module.pop();
        }
        modules.insert(module, path);
    }
    modules
}

/// Circles of files, each in alphabetical order.
fn circles(src: &Path) -> Vec<Vec<String>> {
    let files = modules(src);
    let names: BTreeMap<Module, String> =
        files.iter().map(|(module, path)| (module.clone(), shown(path))).collect();
    let mut imports: BTreeMap<&Module, BTreeSet<Module>> = BTreeMap::new();
    for (module, path) in &files {
        let mut found = Vec::new();
        paths(&tokens(path), &[], &mut found);
        let targets = found.iter().filter_map(|path| target(path, module, &names));
        imports.insert(module, targets.filter(|to| !module.starts_with(to)).collect());
    }
    let reached = |from: &Module| {
        let (mut seen, mut open) = (BTreeSet::new(), vec![from.clone()]);
        while let Some(module) = open.pop() {
            for to in imports.get(&module).into_iter().flatten() {
                if seen.insert(to.clone()) {
                    open.push(to.clone());
                }
            }
        }
        seen
    };
    let reach: BTreeMap<&Module, BTreeSet<Module>> =
        files.keys().map(|module| (module, reached(module))).collect();
    let mut circles = BTreeSet::new();
    for (module, far) in &reach {
        if far.contains(*module) {
            let back = far.iter().filter(|to| reach.get(to).is_some_and(|reach| reach.contains(*module)));
            circles.insert(back.map(|to| names[to].clone()).collect::<BTreeSet<String>>());
        }
    }
    circles.into_iter().map(|circle| circle.into_iter().collect()).collect()
}

#[test]
fn no_files_import_each_other_in_circles() {
    let mut found = Vec::new();
    for folder in crates().iter().filter(|folder| !folder.starts_with(root().join("tests"))) {
        found.extend(circles(&folder.join("src")));
    }
    let new: Vec<_> = found.iter().filter(|circle| !KNOWN.contains(&circle[0].as_str())).collect();
    assert!(
        new.is_empty(),
        "files that import each other: {new:#?}; move what they share into a file of its own"
    );
    let gone: Vec<_> =
        KNOWN.iter().filter(|first| !found.iter().any(|circle| circle[0] == **first)).collect();
    assert!(gone.is_empty(), "circles that are gone and still in the list: {gone:?}");
}

#[test]
fn a_circle_is_found_whatever_its_imports_look_like() {
    let dir = std::env::temp_dir().join(format!("palpate-circles-{}", std::process::id()));
    std::fs::create_dir_all(dir.join("a")).expect("a folder");
    let files = [
        ("lib.rs", "mod a; mod b; mod c; pub use a::A;"),
        ("a.rs", "mod below; use crate::{A, b::{self, B}}; pub struct A; fn f() { below::f() }"),
        // What it takes from the file above it is no circle.
        ("a/below.rs", "use super::A; pub fn f() {}"),
        ("b.rs", "pub struct B; fn g() -> super::c::C { todo!() }"),
        ("c.rs", "pub struct C; #[cfg(test)] mod tests { use crate::a::A; }"),
    ];
    for (name, text) in files {
        std::fs::write(dir.join(name), text).expect("a file");
    }
    assert_eq!(circles(&dir), Vec::<Vec<String>>::new());
    std::fs::write(dir.join("c.rs"), "pub struct C; impl crate::a::Trait for C {}").expect("a file");
    let found = circles(&dir);
    std::fs::remove_dir_all(&dir).expect("it was there");
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!(found[0].len(), 3, "{found:?}");
}

//! What the sources may say, read as tokens: comments and strings do not count.

use std::{path::PathBuf, str::FromStr};

use cargo_metadata::MetadataCommand;
use proc_macro2::{Delimiter, TokenStream, TokenTree};

use crate::{root, rust_files, shown};

/// Folder of every crate of the workspace.
pub(crate) fn crates() -> Vec<PathBuf> {
    let metadata = MetadataCommand::new().current_dir(root()).no_deps().exec().expect("cargo metadata");
    let folder = |package: &cargo_metadata::Package| package.manifest_path.parent().map(|path| path.into());
    metadata.packages.iter().filter_map(folder).collect()
}

/// The tokens of a file, without what is compiled for tests only.
pub(crate) fn tokens(path: &PathBuf) -> Vec<TokenTree> {
    let text = std::fs::read_to_string(path).unwrap_or_else(|err| panic!("{}: {err}", shown(path)));
    let stream = TokenStream::from_str(&text).unwrap_or_else(|err| panic!("{}: {err}", shown(path)));
    without_tests(stream)
}

fn without_tests(stream: TokenStream) -> Vec<TokenTree> {
    let all: Vec<TokenTree> = stream.into_iter().collect();
    let mut kept: Vec<TokenTree> = Vec::new();
    let mut next = 0;
    while next < all.len() {
        let is_cfg_test = matches!(&all[next], TokenTree::Group(group)
            if group.delimiter() == Delimiter::Bracket && group.to_string().replace(' ', "") == "[cfg(test)]");
        if !is_cfg_test {
            kept.push(all[next].clone());
            next += 1;
            continue;
        }
        kept.pop(); // the `#`
        // The item ends with its body or with a semicolon.
        next += 1;
        while let Some(token) = all.get(next) {
            next += 1;
            match token {
                TokenTree::Group(group) if group.delimiter() == Delimiter::Brace => break,
                TokenTree::Punct(punct) if punct.as_char() == ';' => break,
                _ => {}
            }
        }
    }
    kept
}

/// Source files of the crates that ship, tests left out.
fn shipped_sources() -> Vec<PathBuf> {
    let mut files = Vec::new();
    for folder in crates().iter().filter(|folder| !folder.starts_with(root().join("tests"))) {
        files.extend(rust_files(&folder.join("src")));
    }
    files.retain(|path| path.file_stem().is_none_or(|stem| stem != "tests"));
    assert!(files.len() > 20, "the sources are found: {files:?}");
    files
}

/// Integer literals, with some tokens before each; arguments of anything called like `rgb` are colours, not counts.
fn integers(tokens: &[TokenTree], before: &mut Vec<String>, found: &mut Vec<(u128, String)>) {
    for (index, token) in tokens.iter().enumerate() {
        match token {
            TokenTree::Literal(literal) => {
                let digits: String = literal.to_string().replace('_', "");
                // An integer may carry its type; a float's type or point leaves something that is no integer.
                let number = digits.split(['u', 'i']).next().unwrap_or_default();
                if let Ok(number) = number.parse() {
                    let context = before.iter().rev().take(8).rev().cloned().collect::<Vec<_>>().join(" ");
                    found.push((number, format!("{context} {digits}")));
                }
                before.push(digits);
            }
            TokenTree::Group(group) => {
                let called =
                    index.checked_sub(1).map(|i| tokens[i].to_string().to_lowercase()).unwrap_or_default();
                if !called.contains("rgb") && called != "color32" {
                    let inside: Vec<TokenTree> = group.stream().into_iter().collect();
                    integers(&inside, before, found);
                }
            }
            other => before.push(other.to_string()),
        }
    }
}

fn integers_of(text: &str) -> Vec<u128> {
    let mut found = Vec::new();
    let tokens = without_tests(TokenStream::from_str(text).expect("tokens"));
    integers(&tokens, &mut Vec::new(), &mut found);
    found.into_iter().map(|(number, _)| number).collect()
}

#[test]
fn the_search_for_counts_finds_counts_only() {
    assert_eq!(integers_of("const N: usize = 44; let x = [0u8; 22usize];"), [44, 0, 22]);
    assert_eq!(integers_of("// 44\n/* 22 */ let s = \"44 channels\"; let f = 44.0; let g = 22f32;"), []);
    assert_eq!(
        integers_of("Color32::from_rgb(44, 22, 1); #[cfg(test)] mod tests { const N: u32 = 44; }"),
        []
    );
    assert_eq!(integers_of("#[cfg(test)] mod tests; const N: u32 = 4_4;"), [44]);
}

#[test]
fn no_crate_knows_the_hands_joint_or_channel_count() {
    for path in shipped_sources() {
        let mut found = Vec::new();
        integers(&tokens(&path), &mut Vec::new(), &mut found);
        let counts: Vec<_> = found.iter().filter(|(number, _)| [22, 44].contains(number)).collect();
        assert!(
            counts.is_empty(),
            "{} names {counts:?}: take joint and channel counts from the station",
            shown(&path)
        );
    }
}

/// What a file takes from `krate`: the names right after `krate::`, one level deep.
fn taken_from(krate: &str, tokens: &[TokenTree], taken: &mut Vec<String>) {
    for (index, token) in tokens.iter().enumerate() {
        if let TokenTree::Group(group) = token {
            taken_from(krate, &group.stream().into_iter().collect::<Vec<_>>(), taken);
        }
        if token.to_string() != krate {
            continue;
        }
        let is_path =
            [1, 2].iter().all(|ahead| tokens.get(index + ahead).is_some_and(|t| t.to_string() == ":"));
        match tokens.get(index + 3) {
            // `use krate::{a, b::c};`: the first name after each comma.
            Some(TokenTree::Group(group)) if is_path => {
                let mut first = true;
                for inside in group.stream() {
                    let text = inside.to_string();
                    if text == "," {
                        first = true;
                    } else if std::mem::take(&mut first) {
                        taken.push(text);
                    }
                }
            }
            Some(name) if is_path => taken.push(name.to_string()),
            // The crate under another name would hide what is taken from it.
            _ => taken.push(format!("{krate} itself")),
        }
    }
}

#[test]
fn the_search_for_imports_sees_every_spelling() {
    let text =
        "use palpate_sim::{job::{Cancel, Progress}, SignedDistance, effects::Chain, tactile::readings};
        fn f() { palpate_sim::replay::contact_trace() } use palpate_sim as hidden; use palpate_sim::*;";
    let mut taken = Vec::new();
    let tokens: Vec<TokenTree> = TokenStream::from_str(text).expect("tokens").into_iter().collect();
    taken_from("palpate_sim", &tokens, &mut taken);
    taken.sort();
    assert_eq!(taken, ["*", "SignedDistance", "effects", "job", "palpate_sim itself", "replay", "tactile"]);
}

#[test]
fn the_truth_world_shares_geometry_with_the_simulator_and_nothing_else() {
    let allowed = ["geometry", "job", "SignedDistance"];
    let files = rust_files(&root().join("calibration/truth/src"));
    assert!(!files.is_empty());
    for path in files {
        let mut taken = Vec::new();
        taken_from("palpate_sim", &tokens(&path), &mut taken);
        for name in taken {
            assert!(
                allowed.contains(&name.as_str()),
                "{} takes {name} from palpate_sim, expected only {allowed:?}: what the truth world hides must not be \
                 found by inverting the code that hid it",
                shown(&path)
            );
        }
    }
}

#[test]
fn every_crate_says_what_it_is_for() {
    for folder in crates() {
        let src = folder.join("src");
        let mut opening = rust_files(&folder.join("fuzz_targets"));
        opening.extend(
            ["lib.rs", "main.rs"].map(|name| src.join(name)).into_iter().filter(|path| path.exists()),
        );
        assert!(!opening.is_empty(), "{} has no lib.rs or main.rs", shown(&folder));
        for path in &opening {
            let text = std::fs::read_to_string(path).expect("a source file");
            assert!(
                text.starts_with("//! "),
                "{} opens with {:?}, expected `//!`",
                shown(path),
                text.lines().next()
            );
        }
    }
}

#[test]
fn no_file_is_longer_than_700_lines() {
    for folder in crates() {
        for inside in ["src", "tests", "benches"] {
            for path in rust_files(&folder.join(inside)) {
                let lines = std::fs::read_to_string(&path).expect("a source file").lines().count();
                assert!(lines <= 700, "{} has {lines} lines: split it by what its parts tell", shown(&path));
            }
        }
    }
}

/// Longest line of a comment, characters; rows of tables may be longer. Rustfmt does not wrap comments.
const MAX_COMMENT_WIDTH: usize = 130;

#[test]
fn comments_fit_beside_each_other_on_a_screen() {
    let is_comment = |line: &str| line.starts_with("//") && !line.contains("/ |") && !line.contains("! |");
    for folder in crates() {
        for path in ["src", "tests", "benches"].iter().flat_map(|inside| rust_files(&folder.join(inside))) {
            let text = std::fs::read_to_string(&path).expect("a source file");
            for (idx, line) in text.lines().enumerate().filter(|(_, line)| is_comment(line.trim_start())) {
                let width = line.chars().count();
                assert!(
                    width <= MAX_COMMENT_WIDTH,
                    "{}:{} is a comment of {width} characters, expected at most {MAX_COMMENT_WIDTH}",
                    shown(&path),
                    idx + 1
                );
            }
        }
    }
}

#[test]
fn documents_hold_no_rests_of_a_merge() {
    let docs =
        std::fs::read_dir(root().join("docs")).expect("docs").map(|entry| entry.expect("a file").path());
    let pages = ["README.md", "ARCHITECTURE.md", "BENCHMARKS.md", "CHANGELOG.md", "CONTRIBUTING.md"];
    for path in docs.chain(pages.map(|page| root().join(page))).filter(|path| path.extension().is_some()) {
        let Ok(text) = std::fs::read_to_string(&path) else { continue };
        let rest = text.lines().position(|line| line.starts_with("<<<<<<<") || line.starts_with(">>>>>>>"));
        assert_eq!(rest, None, "{} has marks of a merge", shown(&path));
    }
}

#[test]
fn documents_that_sources_name_exist() {
    for path in shipped_sources() {
        let text = std::fs::read_to_string(&path).expect("a source file");
        let shipped = text.split("#[cfg(test)]").next().unwrap_or_default();
        for (at, _) in shipped.match_indices("docs/") {
            let name = &shipped[at + "docs/".len()..];
            let end =
                name.find(|letter: char| !letter.is_ascii_lowercase() && letter != '_').unwrap_or(name.len());
            if end > 0 && name[end..].starts_with(".md") {
                let file = root().join(format!("docs/{}.md", &name[..end]));
                assert!(file.exists(), "{} names docs/{}.md, which is not there", shown(&path), &name[..end]);
            }
        }
    }
}

//! Which crate may use which, checked against `cargo metadata`.

use std::collections::{BTreeMap, BTreeSet};

use cargo_metadata::{DependencyKind, Metadata, MetadataCommand, PackageId};

use crate::root;

/// A row of the table of crates in `ARCHITECTURE.md`.
struct Row {
    level: u32,
    folder: String,
}

/// The table of crates in `ARCHITECTURE.md`, by the name of the crate.
fn table() -> BTreeMap<String, Row> {
    let page = std::fs::read_to_string(root().join("ARCHITECTURE.md")).expect("ARCHITECTURE.md");
    let head = "| crate | level | folder | what it does | what it never does |";
    let (_, rows) = page.split_once(head).unwrap_or_else(|| panic!("ARCHITECTURE.md has no table {head:?}"));
    let rows = rows.lines().skip(2).take_while(|line| line.starts_with('|'));
    rows.map(|line| {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        let [name, level, folder, does, never] = cells[..] else { panic!("expected five cells in {line:?}") };
        assert!(
            !does.is_empty() && !never.is_empty(),
            "{line:?} does not say what the crate does and never does"
        );
        let level = level.parse().unwrap_or_else(|_| panic!("{level:?} in {line:?} is no level"));
        (name.trim_matches('`').to_owned(), Row { level, folder: folder.trim_matches('`').to_owned() })
    })
    .collect()
}

/// Top folders in the order in which `ARCHITECTURE.md` has them; those that share a place share a rank.
fn ranks() -> BTreeMap<String, usize> {
    let page = std::fs::read_to_string(root().join("ARCHITECTURE.md")).expect("ARCHITECTURE.md");
    let order = page.split_once("or one before it (").and_then(|(_, rest)| rest.split_once(')'));
    let (order, _) = order.expect("ARCHITECTURE.md gives the order of the top folders");
    let places = order.split(", ").enumerate();
    places.flat_map(|(rank, names)| names.split(" and ").map(move |name| (name.to_owned(), rank))).collect()
}

/// The resolved graph for one platform. Without a platform, cargo would want the packages of all of them on disk.
fn metadata(platform: &str) -> Metadata {
    MetadataCommand::new()
        .current_dir(root())
        .other_options(vec!["--filter-platform".to_owned(), platform.to_owned()])
        .exec()
        .expect("cargo metadata")
}

fn host() -> String {
    let rustc = std::env::var("RUSTC").unwrap_or_else(|_| "rustc".to_owned());
    let output = std::process::Command::new(rustc).arg("-vV").output().expect("rustc -vV");
    let text = String::from_utf8(output.stdout).expect("rustc -vV prints text");
    text.lines().find_map(|line| line.strip_prefix("host: ")).expect("rustc names its host").to_owned()
}

/// Names of all packages that `from` reaches through dependencies that end up in it, tests left out.
fn reached(metadata: &Metadata, from: &str) -> BTreeSet<String> {
    let resolve = metadata.resolve.as_ref().expect("a resolved graph");
    let nodes: BTreeMap<&PackageId, _> = resolve.nodes.iter().map(|node| (&node.id, node)).collect();
    let name: BTreeMap<&PackageId, &str> =
        metadata.packages.iter().map(|p| (&p.id, p.name.as_str())).collect();
    let start =
        metadata.packages.iter().find(|p| p.name.as_str() == from).unwrap_or_else(|| panic!("crate {from}"));
    let mut seen = BTreeSet::new();
    let mut open = vec![&start.id];
    while let Some(id) = open.pop() {
        for dep in &nodes[id].deps {
            let built_in = dep.dep_kinds.iter().any(|kind| kind.kind == DependencyKind::Normal);
            if built_in && seen.insert(&dep.pkg) {
                open.push(&dep.pkg);
            }
        }
    }
    seen.into_iter().map(|id| name[id].to_owned()).collect()
}

fn assert_reaches_none(metadata: &Metadata, from: &str, forbidden: &[&str]) {
    let reached = reached(metadata, from);
    assert!(reached.contains("serde"), "the walk from {from} finds what is known to be there: {reached:?}");
    let found: Vec<&&str> = forbidden.iter().filter(|name| reached.contains(**name)).collect();
    assert!(found.is_empty(), "{from} reaches {found:?}; `cargo tree -p {from} -i NAME` shows how");
}

#[test]
fn a_crate_uses_only_crates_of_lower_levels_and_folders_before_it() {
    let (table, ranks) = (table(), ranks());
    let rank_of = |folder: &str| folder.split('/').next().and_then(|top| ranks.get(top));
    assert!(ranks.len() >= 5 && ranks["sim"] < ranks["ui"], "{ranks:?}");
    let metadata = metadata(&host());
    let members = metadata.workspace_packages();
    let tools = ["tidy", "xtask"];
    for package in &members {
        let name = package.name.as_str();
        let Row { level, folder } =
            table.get(name).unwrap_or_else(|| panic!("crate {name} has no row in ARCHITECTURE.md"));
        let lies_in = package.manifest_path.parent().expect("a folder");
        assert_eq!(lies_in.as_std_path(), root().join(folder), "the folder of {name} in ARCHITECTURE.md");
        for dependency in package.dependencies.iter().filter(|dependency| dependency.path.is_some()) {
            let used = table[dependency.name.as_str()].level;
            assert!(
                used < *level,
                "{name} (level {level}) uses {} (level {used}), expected a lower level",
                dependency.name
            );
            // What only tests use lies with the tests.
            if let (Some(own), Some(other)) =
                (rank_of(folder), rank_of(&table[dependency.name.as_str()].folder))
            {
                assert!(
                    other <= own,
                    "{name} in {folder} uses {}, whose top folder comes later",
                    dependency.name
                );
            }
            assert!(
                !tools.contains(&name) && !tools.contains(&dependency.name.as_str()),
                "{name} uses {}: tools must build when nothing else does",
                dependency.name
            );
        }
    }
    let names: BTreeSet<&str> = members.iter().map(|package| package.name.as_str()).collect();
    for name in table.keys() {
        assert!(names.contains(name.as_str()), "{name} of ARCHITECTURE.md is no crate of the workspace");
    }
}

#[test]
fn the_server_draws_nothing_and_learns_nothing() {
    let learning = ["burn", "burn-tensor", "candle-core", "tch", "ort"];
    let drawing = ["egui", "eframe", "wgpu", "winit"];
    assert_reaches_none(&metadata(&host()), "palpate_server", &[&learning[..], &drawing[..]].concat());
}

#[test]
fn the_page_has_no_threads_sockets_or_ports_of_its_own() {
    let forbidden = ["tokio", "axum", "hyper", "rayon", "serialport", "tokio-serial", "mujoco-rs"];
    assert_reaches_none(&metadata("wasm32-unknown-unknown"), "palpate_ui", &forbidden);
}

#[test]
fn pure_crates_reach_no_run_time() {
    let metadata = metadata(&host());
    // This one uses so little that the walk's own check, serde, is not among it.
    let protocol = reached(&metadata, "palpate_device_protocol");
    assert!(protocol.contains("thiserror"), "{protocol:?}");
    for name in ["tokio", "serialport", "serde", "rand", "nalgebra"] {
        assert!(!protocol.contains(name), "palpate_device_protocol reaches {name}");
    }
    for name in ["palpate_robot_model", "palpate_wire"] {
        assert_reaches_none(&metadata, name, &["tokio", "axum", "rayon", "egui", "wgpu", "rand", "mcap"]);
    }
    for name in ["palpate_recording", "palpate_calibration", "palpate_truth"] {
        assert_reaches_none(&metadata, name, &["tokio", "axum", "egui", "wgpu"]);
    }
}

#[test]
fn plain_builds_need_no_physics_library() {
    for name in ["palpate_grasp", "palpate_train"] {
        assert_reaches_none(&metadata(&host()), name, &["mujoco-rs"]);
    }
}

#[test]
fn viser_the_video_encoder_stays_out() {
    // The 3-D viewer that robotics people mean by this name is a Python package.
    let lock = std::fs::read_to_string(root().join("Cargo.lock")).expect("Cargo.lock");
    assert!(lock.contains("name = \"serde\""), "this is not the lock file");
    assert!(!lock.contains("name = \"viser\""), "the crate `viser` is a video encoder");
}

/// Words of a crate's sources, its build script included.
fn words(package: &cargo_metadata::Package) -> BTreeSet<String> {
    let folder = package.manifest_path.parent().expect("a folder").as_std_path();
    let inside = ["src", "tests", "benches", "examples", "fuzz_targets"];
    let mut files: Vec<_> =
        inside.iter().flat_map(|inside| crate::rust_files(&folder.join(inside))).collect();
    files.extend(Some(folder.join("build.rs")).filter(|path| path.exists()));
    let mut words = BTreeSet::new();
    for path in files {
        let text = std::fs::read_to_string(path).expect("a source file");
        let is_part = |c: char| c.is_alphanumeric() || c == '_';
        let code = text.lines().filter(|line| !line.trim_start().starts_with("//"));
        words.extend(code.flat_map(|line| line.split(|c| !is_part(c))).map(str::to_owned));
    }
    words
}

/// Dependencies that no source names, and what each is there for.
const UNNAMED: [(&str, &str, &str); 1] =
    [("palpate_training", "burn-flex", "its feature x86-v4, for all crates that learn")];

#[test]
fn every_dependency_is_used() {
    let mut unused = Vec::new();
    for package in metadata(&host()).workspace_packages() {
        let words = words(package);
        for dependency in &package.dependencies {
            let name = dependency.rename.as_ref().unwrap_or(&dependency.name).replace('-', "_");
            let is_known = UNNAMED
                .iter()
                .any(|(of, known, _)| *of == package.name.as_str() && *known == dependency.name);
            if words.contains(&name) == is_known {
                unused.push(format!("{} of {}", dependency.name, package.name));
            }
        }
    }
    let hint = "remove it, or say in UNNAMED what it is there for";
    assert!(unused.is_empty(), "no source of the crate names these dependencies; {hint}: {unused:#?}");
}

#[test]
fn there_is_one_version_of_each_big_dependency() {
    let big =
        ["axum", "egui", "h2", "hyper", "mcap", "nalgebra", "parry3d", "prost", "reqwest", "tokio", "wgpu"];
    let metadata = metadata(&host());
    for name in big {
        let versions: BTreeSet<_> = metadata
            .packages
            .iter()
            .filter(|package| package.name.as_str() == name)
            .map(|p| &p.version)
            .collect();
        assert!(
            versions.len() <= 1,
            "{name} is built in several versions: {versions:?}; `cargo tree -i {name}@VERSION`"
        );
    }
}

/// What `deny.toml` says of licences.
#[derive(serde::Deserialize)]
struct Deny {
    licenses: Licences,
}

#[derive(serde::Deserialize)]
struct Licences {
    allow: Vec<String>,
    exceptions: Vec<Exception>,
}

#[derive(serde::Deserialize)]
struct Exception {
    #[serde(rename = "crate")]
    name: String,
    allow: Vec<String>,
}

/// Crates that have their licence in a file, not in a field: Apache-2.0.
const LICENCE_IN_A_FILE: [&str; 1] = ["cfg_block"];

#[test]
fn every_dependency_may_be_given_on() {
    let text = std::fs::read_to_string(root().join("deny.toml")).expect("deny.toml");
    let Deny { licenses } = toml::from_str(&text).expect("deny.toml lists licences");
    let metadata = metadata(&host());
    let members: BTreeSet<&PackageId> = metadata.workspace_members.iter().collect();
    let mut others = Vec::new();
    let is_looked_at = |package: &&cargo_metadata::Package| {
        !members.contains(&package.id) && !LICENCE_IN_A_FILE.contains(&package.name.as_str())
    };
    for package in metadata.packages.iter().filter(is_looked_at) {
        let licence = package.license.clone().unwrap_or_default().replace('/', " OR ");
        // Of "A OR B" one is enough, of "A AND B" all are needed; brackets only group.
        let exceptions =
            licenses.exceptions.iter().filter(|exception| exception.name == package.name.as_str());
        let allowed: Vec<&String> =
            licenses.allow.iter().chain(exceptions.flat_map(|exception| &exception.allow)).collect();
        let allowed = |one: &str| allowed.iter().any(|allowed| *allowed == one.trim());
        let flat = licence.replace(['(', ')'], "");
        if !flat.split(" AND ").all(|part| part.split(" OR ").any(allowed)) {
            others.push(format!("{} {}: {licence:?}", package.name, package.version));
        }
    }
    assert!(others.is_empty(), "deny.toml allows {:?}, found {others:#?}", licenses.allow);
}

#[test]
fn the_page_of_the_architecture_is_read_in_one_sitting() {
    let page = std::fs::read_to_string(root().join("ARCHITECTURE.md")).expect("ARCHITECTURE.md");
    let lines = page.lines().count();
    assert!(
        lines <= 120,
        "ARCHITECTURE.md has {lines} lines, expected at most 120: details belong into docs/, beside their subject"
    );
}

/// Features that only other programs than `palpate` ask for. The tests have these, the `palpate` that is installed does
/// not. None of its crates may need one; `clippy.toml` forbids what uses rand's.
const NOT_IN_PALPATE: [(&str, &[&str]); 5] = [
    ("getrandom", &["std", "sys_rng"]),
    ("rand", &["alloc", "std", "std_rng", "sys_rng", "thread_rng"]),
    ("rustix", &["time"]),
    ("serde", &["alloc"]),
    ("serde_json", &["alloc", "unbounded_depth"]),
];

/// Features by package (`name version`), of those that `cargo tree` with `args` ends up with. A package may be built twice,
/// for programs and for what runs while these are compiled; here it has the features of both.
fn features(args: &[&str]) -> BTreeMap<String, BTreeSet<String>> {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    let format = ["--prefix", "none", "--no-dedupe", "--format", "{p}|{f}"];
    let tree = std::process::Command::new(cargo)
        .current_dir(root())
        .arg("tree")
        .args(args)
        .args(format)
        .output()
        .expect("cargo tree");
    assert!(tree.status.success(), "cargo tree: {}", String::from_utf8_lossy(&tree.stderr));
    let mut features: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    // Trees have an empty line between them.
    for line in String::from_utf8(tree.stdout).expect("text").lines().filter(|line| !line.is_empty()) {
        let (package, listed) = line.split_once('|').expect("a package and its features");
        // Without the folder of ours.
        let package = package.split(' ').take(2).collect::<Vec<_>>().join(" ");
        let listed = listed.split(',').filter(|name| !name.is_empty()).map(str::to_owned);
        features.entry(package).or_default().extend(listed);
    }
    features
}

#[test]
fn palpate_is_tested_with_the_features_that_it_has_by_itself() {
    let alone = features(&["--package", "palpate_server", "--edges", "normal"]);
    let tested = features(&["--workspace", "--exclude", "xtask", "--edges", "normal,dev"]);
    let metadata = metadata(&host());
    let mut ours = reached(&metadata, "palpate_server");
    ours.insert("palpate_server".to_owned());
    // What other crates use among themselves is theirs to know.
    let mut used = BTreeSet::new();
    for package in metadata.packages.iter().filter(|package| ours.contains(package.name.as_str())) {
        if package.source.is_none() {
            used.insert(package.name.to_string());
            used.extend(package.dependencies.iter().map(|dependency| dependency.name.clone()));
        }
    }
    let mut differ = BTreeMap::new();
    for (package, alone) in &alone {
        let (name, _) = package.split_once(' ').expect("a name and a version");
        let more: Vec<&str> = tested[package].difference(alone).map(String::as_str).collect();
        if used.contains(name) && !more.is_empty() {
            differ.insert(name, more);
        }
    }
    let expected = NOT_IN_PALPATE.map(|(name, features)| (name, features.to_vec()));
    assert_eq!(differ, BTreeMap::from(expected));
}

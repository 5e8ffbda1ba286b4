//! Which crate may use which, checked against `cargo metadata`.

use std::collections::{BTreeMap, BTreeSet};

use cargo_metadata::{DependencyKind, Metadata, MetadataCommand, PackageId};

use crate::root;

/// The level of each crate: a crate uses only crates of lower levels, also in its tests.
const LEVELS: &[(&str, u32)] = &[
    ("palpate_device_protocol", 0),
    ("palpate_robot_model", 0),
    ("palpate_training", 0),
    ("palpate_encoder", 1),
    ("palpate_ppo", 1),
    ("palpate_safety", 1),
    ("palpate_wire", 1),
    ("palpate_recording", 2),
    ("palpate_sim", 2),
    ("palpate_calibration", 3),
    ("palpate_grasp", 3),
    ("palpate_motion", 3),
    ("palpate_terminal", 3),
    ("palpate_emulator", 4),
    ("palpate_diagnosis", 5),
    ("palpate_drivers", 5),
    ("palpate_blind", 6),
    ("palpate_control", 6),
    ("palpate_server", 7),
    ("palpate_ui", 7),
    ("palpate_train", 5),
    ("e2e", 8),
    // Tools use no crate of ours and no crate of ours uses them: they must build when nothing else does.
    ("tidy", 0),
    ("xtask", 0),
];

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
fn a_crate_uses_only_crates_of_lower_levels() {
    let levels: BTreeMap<&str, u32> = LEVELS.iter().copied().collect();
    let metadata = metadata(&host());
    let members = metadata.workspace_packages();
    for package in &members {
        let name = package.name.as_str();
        let level = levels
            .get(name)
            .unwrap_or_else(|| panic!("crate {name} has no level: give it one here and in ARCHITECTURE.md"));
        for dependency in package.dependencies.iter().filter(|dependency| dependency.path.is_some()) {
            let used = levels[dependency.name.as_str()];
            assert!(
                used < *level,
                "{name} (level {level}) uses {} (level {used}), expected a lower level",
                dependency.name
            );
            assert!(
                !["tidy", "xtask"].contains(&dependency.name.as_str()),
                "{name} uses the tool {}",
                dependency.name
            );
        }
    }
    let names: BTreeSet<&str> = members.iter().map(|package| package.name.as_str()).collect();
    for name in levels.keys() {
        assert!(names.contains(name), "{name} is listed here but is no crate of the workspace");
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
    for name in ["palpate_recording", "palpate_calibration", "palpate_emulator"] {
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

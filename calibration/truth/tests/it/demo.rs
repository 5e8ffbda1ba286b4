//! The demonstration session is what the documentation says it is.

use std::collections::BTreeMap;

use tempfile::TempDir;

use crate::{record, shipped, takes};

#[test]
fn demo_session_has_its_frames_and_touches() {
    let dir = TempDir::new().unwrap();
    let session = record(&shipped("demo.toml"), &dir.path().join("demo"), 1).unwrap();
    let takes = takes(&session);
    assert_eq!(takes.len(), 9);
    let mut frames = BTreeMap::new();
    for take in &takes {
        *frames.entry(take.meta.object.as_str()).or_insert(0) += take.num_frames();
    }
    assert_eq!(frames, BTreeMap::from([("cylinder_25x100mm", 2419), ("sphere_50mm", 3255)]));

    let check = palpate_recording::check_session(&session).unwrap();
    assert!(check.problems.is_empty(), "{:?}", check.problems);
    assert_eq!(check.coverage.len(), 44);
    for channel in &check.coverage {
        assert!(channel.touches_by_half.iter().all(|&touches| touches >= 4), "{channel:?}");
    }
}

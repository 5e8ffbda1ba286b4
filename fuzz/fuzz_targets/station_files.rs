//! The texts of a station: the station file, URDF, layout, objects. The first byte says which one the rest replaces.
#![no_main]

use std::{path::Path, sync::LazyLock};

use libfuzzer_sys::fuzz_target;
use palpate_recording::load_station;
use palpate_robot_model::{Station, StationFiles};

static GOOD: LazyLock<StationFiles> = LazyLock::new(|| {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/finger-station");
    load_station(&dir.join("station.toml")).expect("the fixture's station").files
});

fuzz_target!(|bytes: &[u8]| {
    let Some((&which, content)) = bytes.split_first() else { return };
    let mut files = GOOD.clone();
    match files.files.values_mut().nth(usize::from(which) % (GOOD.files.len() + 1)) {
        Some(file) => *file = content.to_vec(),
        None => files.station_toml = String::from_utf8_lossy(content).into_owned(),
    }
    if let Ok(station) = Station::from_files(files) {
        // What was accepted has a pose for any joint positions.
        let mut root_from_link = Vec::new();
        station.robot.forward_kinematics(&vec![0.1; station.robot.num_dofs()], &mut root_from_link);
        assert_eq!(root_from_link.len(), station.robot.links.len());
    }
});

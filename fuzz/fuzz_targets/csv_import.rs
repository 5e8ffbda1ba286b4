//! A folder of CSV files as somebody else wrote them. The input is the four files, separated by zero bytes.
#![no_main]

use std::{fs, path::Path, sync::LazyLock};

use libfuzzer_sys::fuzz_target;
use palpate_recording::{Session, import::import_csv, load_station};
use palpate_robot_model::Station;

static STATION: LazyLock<Station> = LazyLock::new(|| {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/finger-station");
    load_station(&dir.join("station.toml")).expect("the fixture's station")
});

fuzz_target!(|bytes: &[u8]| {
    let root = tempfile::tempdir().expect("a folder for the files");
    let take_dir = root.path().join("csv/take");
    fs::create_dir_all(&take_dir).expect("a folder for the take");
    let files = ["take.toml", "joints.csv", "gel.csv", "film.csv"];
    for (file, content) in files.into_iter().zip(bytes.splitn(files.len(), |&byte| byte == 0)) {
        fs::write(take_dir.join(file), content).expect("a file of the take");
    }
    let session_dir = root.path().join("session");
    match import_csv(&STATION, &root.path().join("csv"), &session_dir) {
        // What was imported can be read.
        Ok(dir) => {
            drop(Session::open(&dir).and_then(|session| session.take(0)).expect("an imported take opens"));
        }
        Err(_) => assert!(!session_dir.exists()),
    }
});

//! A mapping file and the file that it describes, as somebody else wrote them. The input is the two, separated by a
//! zero byte.
#![no_main]

use std::{fs, path::Path, sync::LazyLock};

use libfuzzer_sys::fuzz_target;
use palpate_recording::{
    Session,
    import::{ImportOptions, Mapping, explain, fits, import},
    load_station,
};
use palpate_robot_model::Station;

static STATION: LazyLock<Station> = LazyLock::new(|| {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/finger-station");
    load_station(&dir.join("station.toml")).expect("the fixture's station")
});

fuzz_target!(|bytes: &[u8]| {
    let mut parts = bytes.splitn(2, |&byte| byte == 0);
    let (mapping, table) = (parts.next().unwrap_or_default(), parts.next().unwrap_or_default());
    let Ok(text) = std::str::from_utf8(mapping) else { return };
    let Ok(mapping) = Mapping::parse(Path::new("mapping.toml"), text) else { return };
    let root = tempfile::tempdir().expect("a folder for the files");
    let data = root.path().join("data");
    fs::create_dir_all(data.join("take")).expect("a folder for the take");
    // As a file and as a folder, whichever the mapping wants.
    for file in ["take.csv", "take/log.csv"] {
        fs::write(data.join(file), table).expect("a file of the take");
    }
    let options = ImportOptions { mapping: Some(&mapping), find_repetitions: true };
    let understood = explain(&STATION, &data, options).is_ok_and(|report| report.ok);
    let _ = fits(&STATION, &data, Some(&mapping));
    let session_dir = root.path().join("session");
    match import(&STATION, &data, options, &session_dir) {
        Ok((dir, _)) => {
            assert!(understood, "what is imported was explained");
            drop(Session::open(&dir).and_then(|session| session.take(0)).expect("an imported take opens"));
        }
        Err(_) => assert!(!session_dir.exists()),
    }
});

//! The shipped stations go through writing, reading and import as any other.

use std::{
    fs,
    path::{Path, PathBuf},
};

use palpate_recording::{Session, check_session, import::import_csv, load_station};
use palpate_robot_model::Station;

fn shipped() -> Vec<PathBuf> {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/stations");
    let mut paths: Vec<PathBuf> = fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "toml"));
    paths.sort();
    paths
}

const DURATION_S: f64 = 4.0;
const FIRST_TOUCH_S: f64 = 1.0;

/// Which channel is touched at `time_s`: each in turn after a second of rest.
fn touched(station: &Station, time_s: f64) -> Option<usize> {
    let num_channels = station.layout.num_channels() as f64;
    let phase = (time_s - FIRST_TOUCH_S) / (DURATION_S - FIRST_TOUCH_S) * num_channels;
    (phase >= 0.0 && phase < num_channels && (0.1..0.9).contains(&phase.fract())).then_some(phase as usize)
}

fn table(prefix: char, num_columns: usize, rate_hz: f64, value: impl Fn(usize, f64) -> f64) -> String {
    let header: Vec<String> = (0..num_columns).map(|column| format!("{prefix}{column}")).collect();
    let mut text = format!("t_s,{}\n", header.join(","));
    for row in 0..(DURATION_S * rate_hz) as usize {
        let time_s = row as f64 / rate_hz;
        let cells: Vec<String> = (0..num_columns).map(|column| value(column, time_s).to_string()).collect();
        text += &format!("{time_s},{}\n", cells.join(","));
    }
    text
}

#[test]
fn each_shipped_station_imports_its_own_recordings() {
    let paths = shipped();
    assert!(paths.len() >= 2, "a second, different station ships too: {paths:?}");
    for path in paths {
        let station = load_station(&path).unwrap();
        let root = tempfile::tempdir().unwrap();
        let dir = root.path().join("csv/take-01");
        fs::create_dir_all(&dir).unwrap();
        let object = station.objects.keys().next().unwrap();
        let toml = format!(
            "object = {object:?}\nobject_pose = {{ position_m = [0.3, 0, 0.1] }}\nprimitive = \"tap\"\n\
             baseline_s = [0.0, {FIRST_TOUCH_S}]\n"
        );
        fs::write(dir.join("take.toml"), toml).unwrap();
        let joints = table('q', station.robot.num_dofs(), station.joint_rate_hz, |_, time_s| 0.01 * time_s);
        fs::write(dir.join("joints.csv"), joints).unwrap();
        for (stream, config) in station.layout.streams.iter().zip(&station.streams) {
            let rest = config.raw_min + 0.25 * (config.raw_max - config.raw_min);
            let readings = table('v', stream.channels.len(), stream.rate_hz, |column, time_s| {
                let on = touched(&station, time_s) == Some(stream.channels.start + column);
                if on { rest + 1.5 * config.on_threshold } else { rest }
            });
            fs::write(dir.join(format!("{}.csv", stream.id)), readings).unwrap();
        }

        import_csv(&station, &root.path().join("csv"), &root.path().join("session")).unwrap();
        let session = Session::open(&root.path().join("session")).unwrap();
        let take = session.take(0).unwrap();
        assert_eq!(take.station.files, station.files);
        let report = check_session(&session).unwrap();
        assert!(report.ok, "{}: {:?}", path.display(), report.problems);
        // Streams that are slower than the touches may miss one, but none may see two.
        for coverage in &report.coverage {
            assert!(coverage.touches <= 1, "{}: {coverage:?}", path.display());
        }
        let touched = report.coverage.iter().filter(|coverage| coverage.touches == 1).count();
        assert!(2 * touched > report.coverage.len(), "{}: {touched} channels", path.display());
    }
}

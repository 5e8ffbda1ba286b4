//! A skin whose taxels measure three axes and that drifts: from its files to what the page and scripts get.

use std::{fmt::Write as _, fs, path::Path};

use palpate_wire::proto::TakeTrace;
use prost::Message as _;

use crate::support::{Data, arg, get, palpate_ok};

const FIXTURE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/fixtures/finger-station");
const TAKE_TOML: &str = "object = \"ball\"\nobject_pose = { position_m = [0.1, 0.0, 0.05] }\nprimitive = \"tap\"\n\
                         repetitions_s = []\nbaseline_s = [[0.0, 0.4], [1.0, 1.4]]\n";

/// The finger with a magnetic skin in place of its gel.
fn write_station(dir: &Path) {
    fs::create_dir_all(dir).unwrap();
    for entry in fs::read_dir(FIXTURE).unwrap() {
        let path = entry.unwrap().path();
        fs::copy(&path, dir.join(path.file_name().unwrap())).unwrap();
    }
    let edit = |file: &str, from: &str, to: &str| {
        let text = fs::read_to_string(dir.join(file)).unwrap();
        assert!(text.contains(from), "{file}: {from}");
        fs::write(dir.join(file), text.replacen(from, to, 1)).unwrap();
    };
    edit("layout.toml", "raw_unit = \"counts\"", "raw_unit = \"uT\"\naxes = 3\nreading = \"norm\"");
    edit("station.toml", ", \"../finger-station/wedge.toml\"", "");
}

/// The middle taxel changes by (-36, 48, -80) from 1.5 s on for a quarter of a second; all axes gain 15 a second.
fn measured(time_s: f64, channel: usize, axis: usize) -> f64 {
    let press = if channel == 1 && (1.5..1.75).contains(&time_s) { [-36.0, 48.0, -80.0][axis] } else { 0.0 };
    [300.0, -20.0, 1500.0][axis] + 15.0 * time_s + press
}

fn write_recording(dir: &Path) {
    fs::create_dir_all(dir).unwrap();
    let csv = |header: &str, rate_hz: u32, row: &dyn Fn(f64) -> String| {
        let mut text = header.to_owned();
        let times_s = (0..2 * rate_hz).map(|idx| f64::from(idx) / f64::from(rate_hz));
        times_s.for_each(|time_s| write!(text, "\n{time_s},{}", row(time_s)).unwrap());
        text + "\n"
    };
    let cells = || (0..3).flat_map(|channel| (0..3).map(move |axis| (channel, axis)));
    let names: Vec<String> =
        cells().map(|(channel, axis)| format!("tip.{channel}.{}", ["x", "y", "z"][axis])).collect();
    let gel = |time_s: f64| {
        let values: Vec<String> =
            cells().map(|(channel, axis)| measured(time_s, channel, axis).to_string()).collect();
        values.join(",")
    };
    fs::write(dir.join("take.toml"), TAKE_TOML).unwrap();
    fs::write(dir.join("joints.csv"), csv("t,slide,curl", 10, &|_| "0.1,-0.5".to_owned())).unwrap();
    fs::write(dir.join("film.csv"), csv("t,pulp,root", 40, &|_| "300,310".to_owned())).unwrap();
    fs::write(dir.join("gel.csv"), csv(&format!("t,{}", names.join(",")), 100, &gel)).unwrap();
}

#[tokio::test]
async fn a_skin_of_three_axes_is_explained_imported_checked_and_shown() {
    let data = Data::empty();
    let (station, csv) = (data.path("hand"), data.path("csv"));
    write_station(&station);
    write_recording(&csv.join("take-01"));
    let (station, session) = (station.join("station.toml"), data.root().join("sessions/magnets"));
    let args = ["import", "--csv", arg(&csv), "--station", arg(&station)];
    let explained = palpate_ok(&[&args[..], &["--explain"]].concat());
    for expected in [
        "column 7 (tip.1.z) is axis \"tip.1.z\": 1442.500000 to 1529.850000 uT",
        "without touch from 0 to 0.4 s",
        "and from 1 to 1.4 s, from when on readings count from what they are there",
        "note: stream \"gel\": the reading of a channel is the norm of the change of its axes x, y, z from rest",
    ] {
        assert!(explained.contains(expected), "{expected}: {explained}");
    }
    fs::create_dir_all(data.root().join("sessions")).unwrap();
    palpate_ok(&[&args[..], &["--out", arg(&session)]].concat());
    let checked = palpate_ok(&["session", "check", arg(&session)]);
    assert!(checked.contains("usable") && !checked.contains("axes"), "{checked}");

    let trace = get(&data.app(), "/api/v1/sessions/magnets/takes/take-01/trace").await.body;
    let trace = TakeTrace::decode(trace).unwrap();
    let gel = &trace.streams[0];
    assert_eq!((gel.times_s.len(), gel.raw.len(), gel.axes.len()), (200, 600, 1800));
    assert!(trace.streams[1].axes.is_empty());
    for (sample, &time_s) in gel.times_s.iter().enumerate() {
        for (cell, &value) in gel.axes[9 * sample..9 * sample + 9].iter().enumerate() {
            assert_eq!(value, measured(time_s, cell / 3, cell % 3) as f32);
        }
        let is_active = gel.active[(3 * sample + 1) / 8] >> ((3 * sample + 1) % 8) & 1 == 1;
        assert_eq!(is_active, (1.5..1.75).contains(&time_s), "at {time_s} s");
    }
}

//! Import of skins whose taxels measure several axes.

use std::{fmt::Write as _, fs, path::Path};

use palpate_recording::{
    Session, Take, check_session,
    import::{ImportOptions, ImportReport, Mapping, explain, import},
};
use palpate_robot_model::{Station, TaxelAxes};

use crate::support::fixtures;

const TAKE_TOML: &str = "object = \"ball\"\nobject_pose = { position_m = [0.1, 0.0, 0.05] }\nprimitive = \"tap\"\n\
                         baseline_s = [0.0, 0.9]\nrepetitions_s = []\n";
const NORM: &str = "axes = 3\nreading = \"norm\"";
const CHANNELS: usize = 3;
/// Where the axes of the taxels are at rest: far from zero, as those of a magnet are.
const REST: [[f64; 3]; CHANNELS] = [[300.0, -20.0, 1500.0], [-310.0, 0.0, 1490.0], [5.0, 40.0, -1510.0]];
/// How far a press moves the axes of the one in the middle.
const PRESS: [f64; 3] = [-36.0, 48.0, -80.0];

/// The finger whose gel has the axes that `rule` says, with readings from `raw_min` on.
fn station(rule: &str, raw_min: f64) -> Station {
    let dir = fixtures().join("finger-station");
    let read = |path: &str| {
        let bytes = fs::read(dir.join(path)).map_err(|error| error.to_string())?;
        let text = String::from_utf8(bytes).map_err(|error| error.to_string())?;
        Ok(match path {
            "layout.toml" => {
                text.replacen("raw_unit = \"counts\"", &format!("raw_unit = \"counts\"\n{rule}"), 1)
            }
            "station.toml" => text.replacen("raw_min = 0.0", &format!("raw_min = {raw_min:?}"), 1),
            _ => text,
        }
        .into_bytes())
    };
    Station::read("station.toml", read).unwrap()
}

/// What an axis measures: a press of half a second, and a little that is no touch.
fn measured(time_s: f64, channel: usize, axis: usize) -> f64 {
    let pressed = if channel == 1 && (1.0..1.5).contains(&time_s) { PRESS[axis] } else { 0.0 };
    REST[channel][axis] + pressed + 0.5 * (time_s * 40.0 + axis as f64).sin()
}

/// `t` and a column for each of `columns`, at 100 Hz for two seconds.
fn csv(columns: &[(usize, usize)], name: impl Fn(usize, usize) -> String) -> String {
    let mut text = "t".to_owned();
    columns.iter().for_each(|&(channel, axis)| write!(text, ",{}", name(channel, axis)).unwrap());
    for time_s in (0..200).map(|row| f64::from(row) / 100.0) {
        write!(text, "\n{time_s}").unwrap();
        columns
            .iter()
            .for_each(|&(channel, axis)| write!(text, ",{}", measured(time_s, channel, axis)).unwrap());
    }
    text + "\n"
}

fn all_axes(num_axes: usize) -> Vec<(usize, usize)> {
    (0..CHANNELS).flat_map(|channel| (0..num_axes).map(move |axis| (channel, axis))).collect()
}

fn named(channel: usize, axis: usize) -> String {
    format!("tip.{channel}.{}", TaxelAxes::NAMES[axis])
}

fn write_recording(dir: &Path, gel: &str) {
    fs::create_dir_all(dir).unwrap();
    let rows = |header: &str, rate_hz: i32, row: &str| {
        let rows = (0..2 * rate_hz).map(|idx| format!("{},{row}\n", f64::from(idx) / f64::from(rate_hz)));
        format!("{header}\n{}", rows.collect::<String>())
    };
    fs::write(dir.join("take.toml"), TAKE_TOML).unwrap();
    fs::write(dir.join("joints.csv"), rows("t,slide,curl", 10, "0.1,-0.5")).unwrap();
    fs::write(dir.join("film.csv"), rows("t,pulp,root", 40, "300,310")).unwrap();
    fs::write(dir.join("gel.csv"), gel).unwrap();
}

fn imported(station: &Station, gel: &str, mapping: Option<&str>) -> Result<(Take, ImportReport), String> {
    let root = tempfile::tempdir().unwrap();
    write_recording(&root.path().join("csv/take-01"), gel);
    let mapping = mapping.map(|text| Mapping::parse(Path::new("mapping.toml"), text)).transpose();
    let mapping = mapping.map_err(|error| error.to_string())?;
    let options = ImportOptions { mapping: mapping.as_ref(), find_repetitions: false };
    let made = import(station, &root.path().join("csv"), options, &root.path().join("session"));
    let (dir, report) =
        made.map_err(|error| error.to_string().replace(&root.path().display().to_string(), "ROOT"))?;
    let session = Session::open(&dir).unwrap();
    let check = check_session(&session).unwrap();
    assert!(check.problems.iter().all(|problem| !problem.place.contains("tip.1.")), "{:?}", check.problems);
    Ok((session.take(0).unwrap(), report))
}

#[test]
fn the_norm_of_the_change_from_rest_is_the_reading_and_the_axes_are_kept() {
    let station = station(NORM, 0.0);
    let (take, report) = imported(&station, &csv(&all_axes(3), named), None).unwrap();
    let gel = &take.streams[0];
    let press = PRESS.iter().map(|change| change * change).sum::<f64>().sqrt();
    assert_eq!(press, 100.0);
    for (sample, &time_s) in gel.times_s.iter().enumerate() {
        for channel in 0..CHANNELS {
            let reading = f64::from(gel.raw[sample * CHANNELS + channel]);
            let is_pressed = channel == 1 && (1.0..1.5).contains(&time_s);
            let expected = if is_pressed { press } else { 0.0 };
            assert!((reading - expected).abs() < 2.0, "{channel} at {time_s} s: {reading}");
            assert_eq!(gel.active[sample * CHANNELS + channel], is_pressed, "{channel} at {time_s} s");
            for axis in 0..3 {
                let kept = gel.axes.values[(sample * CHANNELS + channel) * 3 + axis];
                assert_eq!(kept, measured(time_s, channel, axis) as f32);
            }
        }
    }
    assert_eq!(gel.axes.times_s, gel.times_s);
    assert!(take.streams[1].axes.values.is_empty());
    let note = "stream \"gel\": the reading of a channel is the norm of the change of its axes x, y, z from rest, 0.";
    assert!(report.takes[0].notes.iter().any(|found| found.starts_with(note)), "{:?}", report.takes[0].notes);
    let column = &report.takes[0].files[1].columns[5];
    assert_eq!((column.what, column.id.as_str()), ("axis", "tip.1.z"));
}

#[test]
fn rest_is_that_of_the_newest_span_without_touch() {
    // The field drifts by more than the threshold a second.
    let drifting = |time_s: f64, channel: usize, axis: usize| measured(time_s, channel, axis) + 60.0 * time_s;
    let mut gel = "t".to_owned();
    all_axes(3).iter().for_each(|&(channel, axis)| write!(gel, ",{}", named(channel, axis)).unwrap());
    for time_s in (0..200).map(|row| f64::from(row) / 100.0) {
        write!(gel, "\n{time_s}").unwrap();
        all_axes(3)
            .iter()
            .for_each(|&(channel, axis)| write!(gel, ",{}", drifting(time_s, channel, axis)).unwrap());
    }
    let root = tempfile::tempdir().unwrap();
    let dir = root.path().join("csv/take-01");
    write_recording(&dir, &gel);
    let spans = "baseline_s = [[0.0, 0.2], [0.7, 0.95], [1.55, 1.8]]";
    fs::write(dir.join("take.toml"), TAKE_TOML.replace("baseline_s = [0.0, 0.9]", spans)).unwrap();
    let out = root.path().join("session");
    let made = import(&station(NORM, 0.0), &root.path().join("csv"), ImportOptions::default(), &out);
    let take = Session::open(&made.unwrap().0).unwrap().take(0).unwrap();
    let gel = &take.streams[0];
    let reading = |time_s: f64| gel.raw[(time_s * 100.0).round() as usize * CHANNELS];
    // sqrt(3) times 60 times the time from the middle of the span.
    for (time_s, middle_s) in [(0.1, 0.1), (0.6, 0.1), (0.9, 0.825), (1.5, 0.825), (1.9, 1.675)] {
        let expected = 3.0_f64.sqrt() * 60.0 * (time_s - middle_s);
        assert!((f64::from(reading(time_s)) - expected).abs() < 2.0, "{} at {time_s} s", reading(time_s));
    }
}

#[test]
fn the_axis_along_the_normal_can_be_the_reading() {
    let station = station("axes = 3\nreading = \"normal\"\nnormal_axis = \"-z\"", -4095.0);
    let (take, _) = imported(&station, &csv(&all_axes(3), named), None).unwrap();
    let gel = &take.streams[0];
    for (sample, &time_s) in gel.times_s.iter().enumerate() {
        for channel in 0..CHANNELS {
            let reading = gel.raw[sample * CHANNELS + channel];
            assert_eq!(reading, -(measured(time_s, channel, 2) as f32), "{channel} at {time_s} s");
        }
        assert_eq!(gel.active[sample * CHANNELS + 1], (1.0..1.5).contains(&time_s), "at {time_s} s");
    }
    // Without the minus it falls under load, which is said.
    let risen = self::station("axes = 3\nreading = \"normal\"", -4095.0);
    let (_, report) = imported(&risen, &csv(&all_axes(3), named), None).unwrap();
    let warning = "if a touch makes it fall, write normal_axis = \"-z\" in the layout";
    assert!(report.takes[0].warnings.iter().any(|found| found.ends_with(warning)), "{:?}", report.takes[0]);
}

#[test]
fn a_mapping_finds_axes_by_number_and_by_other_names() {
    let station = station("axes = 2\nreading = \"norm\"", 0.0);
    let (by_name, _) = imported(&station, &csv(&all_axes(2), named), None).unwrap();
    let mapping = |map: &str| {
        format!(
            "format = 1\nfile = [{{ file = \"joints.csv\" }}, {{ file = \"film.csv\" }}, {{ file = \"gel.csv\", map = [{map}] }}]"
        )
    };
    // All x, then all y.
    let blocks: Vec<(usize, usize)> =
        (0..2).flat_map(|axis| (0..CHANNELS).map(move |channel| (channel, axis))).collect();
    let of_magnets = |channel: usize, axis: usize| format!("B{channel}{}", ["x", "y"][axis]);
    let cases = [
        (csv(&all_axes(2), of_magnets), "{ columns = \"2..7\", stream = \"gel\" }"),
        (
            csv(&blocks, of_magnets),
            "{ columns = \"2..4\", patch = \"tip\", axis = \"x\" }, { columns = \"5..7\", patch = \"tip\", axis = \"y\" }",
        ),
        (
            csv(&all_axes(2), of_magnets),
            "{ columns = [\"B0y\", \"B0x\"], channels = \"tip.0\", axis = [\"y\", \"x\"] }, { columns = [\"B1x\", \"B1y\", \
             \"B2x\", \"B2y\"], channels = [\"tip.1\", \"tip.2\"] }",
        ),
    ];
    for (gel, map) in cases {
        let (mapped, _) = imported(&station, &gel, Some(&mapping(map))).unwrap();
        assert_eq!(mapped.streams, by_name.streams, "{map}");
    }
    let refused = |map: &str| imported(&station, &csv(&all_axes(2), named), Some(&mapping(map))).unwrap_err();
    for (map, expected) in [
        (
            "{ stream = \"gel\", axis = \"z\" }",
            "[[file.map]] axis: channel \"tip.0\" has no axis \"z\", expected \"x\", \"y\"",
        ),
        (
            "{ stream = \"gel\", polarity = -1 }",
            "[[file.map]] polarity: -1 is for a reading, and this is an axis of one",
        ),
        ("{ columns = \"2..4\", stream = \"gel\" }", "3 columns for 6 names (\"tip.0.x\", \"tip.0.y\""),
        ("{ joints = \"slide\", axis = \"x\" }", "[[file.map]] axis: is for channels, a patch or a stream"),
    ] {
        let error = refused(map);
        assert!(error.contains(expected), "{map}: {error}");
    }
}

#[test]
fn what_is_wrong_with_an_axis_is_said_of_channel_and_axis() {
    let norm = station(NORM, 0.0);
    let whole = csv(&all_axes(3), named);
    let line = |number: usize, change: &dyn Fn(&str) -> String| -> String {
        let lines = whole.lines().enumerate();
        let lines = lines.map(|(idx, line)| if idx + 1 == number { change(line) } else { line.to_owned() });
        lines.collect::<Vec<_>>().join("\n")
    };
    let last = |cell: &'static str| {
        move |line: &str| format!("{},{cell}", line.rsplit_once(',').map_or("", |(before, _)| before))
    };
    let cases = [
        (
            csv(&all_axes(3)[..8], named),
            "no column for axis \"tip.2.z\"; station \"finger\" needs one for each of its 9 axes",
        ),
        (csv(&all_axes(2), named), "no column for axes \"tip.0.z\", \"tip.1.z\", \"tip.2.z\""),
        (line(7, &last("")), "line 7, column 10 (tip.2.z, axis \"tip.2.z\"): is empty"),
        (line(7, &last("1e39")), "line 7, column 10 (tip.2.z, axis \"tip.2.z\")"),
        (line(7, &last("up")), "line 7, column 10 (tip.2.z, axis \"tip.2.z\"): \"up\" is not a number"),
    ];
    for (gel, expected) in cases {
        let error = imported(&norm, &gel, None).unwrap_err();
        assert!(error.contains("gel.csv") && error.contains(expected), "{expected}: {error}");
    }
    let normal = station("axes = 3\nreading = \"normal\"", -1550.0);
    let error = imported(&normal, &line(7, &last("-1551")), None).unwrap_err();
    let expected =
        "line 7, channel \"tip.2\", axis z: the reading made of it, -1551 counts is less than -1550";
    assert!(error.contains(expected), "{error}");

    // An axis that stands still is named by --explain, and by the check of the session.
    let stuck = csv(&all_axes(3), named);
    let stuck: Vec<String> = stuck
        .lines()
        .enumerate()
        .map(|(idx, line)| if idx == 0 { line.to_owned() } else { last("-1510")(line) })
        .collect();
    let root = tempfile::tempdir().unwrap();
    write_recording(&root.path().join("csv/take-01"), &stuck.join("\n"));
    let report = explain(&norm, &root.path().join("csv"), ImportOptions::default()).unwrap();
    let warning = "gel.csv: axis \"tip.2.z\" (-1510 counts) never changes; is it connected?";
    assert!(report.takes[0].warnings.iter().any(|found| found == warning), "{:?}", report.takes[0].warnings);
    let (dir, _) =
        import(&norm, &root.path().join("csv"), ImportOptions::default(), &root.path().join("session"))
            .unwrap();
    let check = check_session(&Session::open(&dir).unwrap()).unwrap();
    let expected = ("take-01, tip.2.z", "this axis never changes; is it connected?");
    assert!(
        check.problems.iter().any(|problem| (problem.place.as_str(), problem.message.as_str()) == expected),
        "{:?}",
        check.problems
    );
}

#[test]
fn events_of_such_a_skin_have_a_column_for_each_taxel() {
    let root = tempfile::tempdir().unwrap();
    let dir = root.path().join("csv/take-01");
    let mut gel = "t,tip.0,tip.1,tip.2\n".to_owned();
    (0..200).for_each(|row| writeln!(gel, "{},0,{},0", f64::from(row) / 100.0, row / 100).unwrap());
    write_recording(&dir, &gel);
    fs::write(dir.join("take.toml"), TAKE_TOML.replace("baseline_s = [0.0, 0.9]", "binary = true")).unwrap();
    fs::write(dir.join("film.csv"), "t,pulp,root\n0,0,0\n1,1,0\n2,0,0\n").unwrap();
    let out = root.path().join("session");
    let made = import(&station(NORM, 0.0), &root.path().join("csv"), ImportOptions::default(), &out);
    let take = Session::open(&made.unwrap().0).unwrap().take(0).unwrap();
    assert_eq!(take.streams[0].active.iter().filter(|&&on| on).count(), 100);
    assert!(take.streams[0].axes.values.is_empty() && !take.has_raw());
}

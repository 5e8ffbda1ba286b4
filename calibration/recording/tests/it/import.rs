//! CSV import: good recordings become takes, bad ones change nothing on disk.

use std::{fmt::Write as _, fs, path::Path};

use palpate_recording::{Session, SpanKind, check_session, import::import_csv};

use crate::support::{station, tree};

const TAKE_TOML: &str = r#"object = "ball"
object_pose = { position_m = [0.1, 0.0, 0.05], quaternion_wxyz = [1.0, 0.0, 0.0, 0.0] }
primitive = "tap"
repetitions_s = [[1.0, 1.5], [1.5, 2.0]]
baseline_s = [0.0, 0.9]
fixture_trusted = false
"#;

/// `t_s` and a column per closure value.
fn csv(header: &str, rate_hz: f64, duration_s: f64, row: impl Fn(f64) -> Vec<f64>) -> String {
    let mut text = format!("{header}\n");
    let num_rows = (duration_s * rate_hz) as usize;
    for time_s in (0..num_rows).map(|row| row as f64 / rate_hz) {
        write!(text, "{time_s}").unwrap();
        for value in row(time_s) {
            write!(text, ",{value}").unwrap();
        }
        text.push('\n');
    }
    text
}

/// A recording with touches of `tip.1` from 1.0 to 1.5 s and of `root` from 1.5 s on.
fn write_recording(dir: &Path) {
    fs::create_dir_all(dir).unwrap();
    fs::write(dir.join("take.toml"), TAKE_TOML).unwrap();
    fs::write(dir.join("joints.csv"), csv("t_s,q0,q1", 10.0, 2.0, |t| vec![0.1 * t, -0.75 * t])).unwrap();
    let pressed = |t: f64, on: bool, rest: f64| if on { rest + 500.0 } else { rest + (t * 7.0).sin() };
    let gel = |t: f64| vec![pressed(t, false, 200.0), pressed(t, (1.0..1.5).contains(&t), 210.0), 190.0];
    fs::write(dir.join("gel.csv"), csv("t_s,v0,v1,v2", 100.0, 2.0, gel)).unwrap();
    let film = |t: f64| vec![300.0, pressed(t, t >= 1.5, 310.0)];
    fs::write(dir.join("film.csv"), csv("t_s,v0,v1", 40.0, 2.0, film)).unwrap();
}

/// The message of an import that must fail and leave the disk as it was.
fn refused(csv_dir: &Path, root: &Path) -> String {
    let before = tree(root);
    let error = import_csv(&station(), csv_dir, &root.join("out/session")).unwrap_err();
    assert_eq!(tree(root), before, "something on disk changed");
    match std::error::Error::source(&error) {
        Some(source) => format!("{error}: {source}"),
        None => error.to_string(),
    }
}

#[test]
fn repetitions_keep_labels_of_their_own() {
    let root = tempfile::tempdir().unwrap();
    let csv_dir = root.path().join("csv");
    write_recording(&csv_dir.join("01"));
    let labels = format!("{TAKE_TOML}repetition_labels = [\"tap of the tip\", \"tap of the root\"]\n");
    fs::write(csv_dir.join("01/take.toml"), labels).unwrap();
    let session = import_csv(&station(), &csv_dir, &root.path().join("session")).unwrap();
    let take = Session::open(&session).unwrap().take(0).unwrap();
    let repetitions = take.spans.iter().filter(|span| span.kind == SpanKind::Repetition);
    let labels: Vec<&str> = repetitions.map(|span| span.label.as_str()).collect();
    assert_eq!(labels, ["tap of the tip", "tap of the root"]);
}

#[test]
fn a_recording_becomes_a_take() {
    let root = tempfile::tempdir().unwrap();
    let csv_dir = root.path().join("csv");
    write_recording(&csv_dir.join("02 second"));
    write_recording(&csv_dir.join("01-first"));
    fs::create_dir(csv_dir.join(".git")).unwrap();
    let session_dir = root.path().join("sessions/mine");
    assert_eq!(import_csv(&station(), &csv_dir, &session_dir).unwrap(), session_dir);

    let session = Session::open(&session_dir).unwrap();
    let files: Vec<&str> = session.file.takes.iter().map(|take| take.file.as_str()).collect();
    assert_eq!(files, ["01-first.mcap", "02-second.mcap"]);
    let take = session.take(1).unwrap();
    assert_eq!((take.meta.object.as_str(), take.meta.primitive.as_str()), ("ball", "tap"));
    assert!(!take.meta.fixture_trusted);
    assert_eq!(take.meta.base_from_object.translation.vector.as_slice(), [0.1, 0.0, 0.05]);
    assert_eq!(take.joints.times_s, (0..20).map(|row| f64::from(row) / 10.0).collect::<Vec<_>>());
    assert_eq!(take.joints.positions[2 * 13..2 * 14], [0.1 * 1.3, -0.75 * 1.3]);
    assert_eq!(take.streams[0].times_s.len(), 200);
    assert_eq!(take.streams[1].raw[1], 310.0);
    assert!((take.streams[0].reference[1] - 210.0).abs() < 0.5);
    let kinds: Vec<SpanKind> = take.spans.iter().map(|span| span.kind).collect();
    assert_eq!(kinds, [SpanKind::Baseline, SpanKind::Repetition, SpanKind::Repetition]);
    assert!(take.spans[1..].iter().all(|span| span.label == "tap"));

    let active_spans = |channel: usize| {
        let frames: Vec<bool> = take.active_at_frames().chunks(5).map(|frame| frame[channel]).collect();
        (frames.iter().position(|&on| on), frames.iter().filter(|&&on| on).count())
    };
    assert_eq!(
        [0, 1, 2, 3, 4].map(active_spans),
        [(None, 0), (Some(10), 5), (None, 0), (None, 0), (Some(15), 5)]
    );

    let report = check_session(&session).unwrap();
    assert!(report.ok, "{:?}", report.problems);
    assert_eq!(report.coverage[1].touches_by_half, [1, 1]);
    assert_eq!(report.coverage[2].touches, 0);
    assert!(fs::read_dir(root.path().join("sessions")).unwrap().count() == 1, "no leftovers");
}

#[test]
fn a_binary_recording_needs_no_baseline() {
    let root = tempfile::tempdir().unwrap();
    let dir = root.path().join("csv/events");
    write_recording(&dir);
    let text = TAKE_TOML.replace("baseline_s = [0.0, 0.9]", "binary = true");
    fs::write(dir.join("take.toml"), text).unwrap();
    fs::write(dir.join("gel.csv"), csv("t_s,v0,v1,v2", 100.0, 2.0, |t| vec![f64::from(t > 1.0), 0.0, 1.0]))
        .unwrap();
    fs::write(dir.join("film.csv"), csv("t_s,v0,v1", 40.0, 2.0, |_| vec![0.0, 1.0])).unwrap();
    import_csv(&station(), &root.path().join("csv"), &root.path().join("session")).unwrap();
    let take = Session::open(&root.path().join("session")).unwrap().take(0).unwrap();
    assert!(!take.has_raw() && take.streams[0].reference.is_empty());
    assert_eq!(take.streams[0].active[3 * 150..3 * 151], [true, false, true]);
    assert_eq!(take.streams[0].active[3 * 50..3 * 51], [false, false, true]);
}

#[test]
fn wall_clock_times_count_from_a_whole_second_and_are_kept() {
    let root = tempfile::tempdir().unwrap();
    let dir = root.path().join("csv/late");
    write_recording(&dir);
    for name in ["joints.csv", "gel.csv", "film.csv"] {
        let text = fs::read_to_string(dir.join(name)).unwrap();
        let shifted: Vec<String> = text
            .lines()
            .map(|line| match line.split_once(',') {
                Some((time, rest)) if time != "t_s" => {
                    format!("{},{rest}", 1_700_000_000.25 + time.parse::<f64>().unwrap())
                }
                _ => line.to_owned(),
            })
            .collect();
        fs::write(dir.join(name), shifted.join("\n")).unwrap();
    }
    let text = TAKE_TOML
        .replace("[[1.0, 1.5], [1.5, 2.0]]", "[[1700000001.25, 1700000001.75]]")
        .replace("[0.0, 0.9]", "[1700000000.25, 1700000001.0]");
    fs::write(dir.join("take.toml"), text).unwrap();
    import_csv(&station(), &root.path().join("csv"), &root.path().join("session")).unwrap();
    let take = Session::open(&root.path().join("session")).unwrap().take(0).unwrap();
    assert_eq!(take.start_unix_ns, 1_700_000_000_000_000_000);
    assert_eq!((take.joints.times_s[0], take.spans[1].start_s), (0.25, 1.25));
    assert!((take.joints.times_s[7] - 0.95).abs() < 1e-6);
}

#[test]
fn every_fault_of_a_recording_names_file_line_and_column() {
    type Break = (&'static str, fn(&str) -> String, &'static str);
    fn line(text: &str, line: usize, with: &str) -> String {
        let mut lines: Vec<&str> = text.lines().collect();
        lines[line - 1] = with;
        lines.join("\n")
    }
    let cases: Vec<Break> = vec![
        ("gel.csv", |t| line(t, 5, "0.03,1,2"), "gel.csv: line 5: ragged row: 3 values, expected 4"),
        ("gel.csv", |t| line(t, 5, "0.03,1,2,3,4"), "gel.csv: line 5: ragged row: 5 values"),
        (
            "joints.csv",
            |t| line(t, 4, "0.1,0,0"),
            "joints.csv: line 4, column 1 (t_s): time 0.1 s does not come after 0.1 s",
        ),
        ("film.csv", |t| line(t, 9, "0.01,1,1"), "film.csv: line 9, column 1 (t_s): time 0.01 s"),
        (
            "film.csv",
            |t| line(t, 3, "0.025,1,NaN"),
            "film.csv: line 3, column 3 (v1, channel \"root\"): NaN is not finite",
        ),
        (
            "joints.csv",
            |t| line(t, 3, "0.1,-inf,0"),
            "joints.csv: line 3, column 2 (q0, joint \"slide\"): -inf is not finite",
        ),
        ("gel.csv", |t| line(t, 3, "0.01,1,1e39,1"), "gel.csv: line 3, column 3"),
        (
            "gel.csv",
            |t| line(t, 3, "0.01,1,x,1"),
            "gel.csv: line 3, column 3 (v1, channel \"tip.1\"): \"x\" is not a number",
        ),
        (
            "gel.csv",
            |t| line(t, 1, "t_s,v0,v1"),
            "gel.csv: line 1: 2 channel columns beside t_s, the station has 3",
        ),
        (
            "joints.csv",
            |t| line(t, 1, "t_s,q0,q1,q2"),
            "joints.csv: line 1: 3 joint columns beside t_s, the station has 2",
        ),
        (
            "joints.csv",
            |t| line(t, 1, "time,q0,q1"),
            "joints.csv: line 1, column 1: header \"time\", expected \"t_s\"",
        ),
        ("film.csv", |_| String::new(), "film.csv: line 1: the file is empty, expected the header t_s,v0,v1"),
        ("film.csv", |_| "t_s,v0,v1\n".to_owned(), "film.csv: line 2: no rows"),
        ("film.csv", |t| t.replace("\n0,", "\n-1e12,"), "too far from the other times"),
        (
            "joints.csv",
            |t| line(t, 4, "0.2,0,100"),
            "joints.csv: line 4, column 3 (q1, joint \"curl\"): 100 rad lies outside of the joint's limits, -1.5..1.5 rad",
        ),
        (
            "joints.csv",
            |t| line(t, 4, "0.2,1e308,0"),
            "joints.csv: line 4, column 2 (q0, joint \"slide\"): 1e308 m lies outside of the joint's limits, 0..0.2 m",
        ),
        (
            "joints.csv",
            |_| csv("t_s,q0,q1", 10.0, 2.0, |t| vec![0.1 * t, 43.0 * t]),
            "joints.csv: line 3, column 3 (q1, joint \"curl\"): 4.3: most positions lie outside of the joints' limits and would \
             fit as degrees; give radians",
        ),
        (
            "gel.csv",
            |t| line(t, 5, "0.03,1,-1,3"),
            "gel.csv: line 5, column 3 (v1, channel \"tip.1\"): -1 counts is less than 0, the least that the device can give",
        ),
        (
            "take.toml",
            |t| t.replace("0.05]", "1e308]"),
            "take.toml: object_pose: the object is 1e308 m from the robot's base, which is more than 3 times the robot's \
             reach (0.44 m)",
        ),
        (
            "take.toml",
            |t| t.replace("\"ball\"", "\"cube\""),
            "take.toml: object: unknown object \"cube\"; station \"finger\" knows \"ball\", \"wedge\"",
        ),
        (
            "take.toml",
            |t| t.replace("[1.0, 0.0, 0.0, 0.0]", "[0.0, 0.0, 0.0, 0.0]"),
            "take.toml: object_pose:",
        ),
        ("take.toml", |t| t.replace("0.05]", "nan]"), "take.toml: object_pose:"),
        (
            "take.toml",
            |t| t.replace("[1.5, 2.0]", "[1.5, 1.0]"),
            "take.toml: repetitions_s, span 2: [1.5, 1] ends before it starts",
        ),
        ("take.toml", |t| t.replace("[1.5, 2.0]", "[5.0, 6.0]"), "span 2: [5, 6] lies outside the recording"),
        (
            "take.toml",
            |t| t.replace("baseline_s = [0.0, 0.9]\n", ""),
            "take.toml: baseline_s: missing; raw readings need",
        ),
        (
            "take.toml",
            |t| t.replace("[0.0, 0.9]", "[0.001, 0.009]"),
            "no sample of stream \"gel\" lies within 0.001..0.009 s",
        ),
        (
            "take.toml",
            |t| format!("{t}repetition_labels = [\"tip\"]\n"),
            "take.toml: repetition_labels: 1 labels for 2 spans of repetitions_s; give one for each",
        ),
        ("take.toml", |t| t.replace("primitive", "primitiv"), "take.toml: line 3: unknown field `primitiv`"),
        ("take.toml", |t| t.replace("primitive = \"tap\"\n", ""), "missing field `primitive`"),
        ("take.toml", |t| t.replace("= false", "= maybe"), "take.toml: line 6"),
        (
            "take.toml",
            |t| format!("{t}binary = true\n"),
            "gel.csv: line 2, column 2 (v0, channel \"tip.0\"): 200 is neither 0 nor 1",
        ),
    ];
    for (file, change, expected) in cases {
        let root = tempfile::tempdir().unwrap();
        // The fault is in the second take, so the first was fine already.
        write_recording(&root.path().join("csv/a"));
        write_recording(&root.path().join("csv/b"));
        let path = root.path().join("csv/b").join(file);
        let text = fs::read_to_string(&path).unwrap();
        let broken = change(&text);
        assert_ne!(broken, text, "{expected}");
        fs::write(&path, broken).unwrap();
        let error = refused(&root.path().join("csv"), root.path());
        assert!(error.contains(expected) && error.contains("csv/b"), "{error}\nlacks\n{expected}");
    }
}

#[test]
fn missing_foreign_and_unreadable_files_are_named() {
    let root = tempfile::tempdir().unwrap();
    let csv_dir = root.path().join("csv");
    for (file, expected) in [
        ("take.toml", "failed to read \""),
        ("joints.csv", "joints.csv\": No such file"),
        ("film.csv", "film.csv\": No such file"),
    ] {
        write_recording(&csv_dir.join("a"));
        fs::remove_file(csv_dir.join("a").join(file)).unwrap();
        let error = refused(&csv_dir, root.path());
        assert!(error.contains(expected) && error.contains(file), "{error}");
    }
    write_recording(&csv_dir.join("a"));
    fs::write(csv_dir.join("a/foil.csv"), "t_s,v0\n0,1\n").unwrap();
    let error = refused(&csv_dir, root.path());
    assert!(
        error.contains("foil.csv: file: station \"finger\" has no stream \"foil\", only \"gel\", \"film\""),
        "{error}"
    );
    fs::write(csv_dir.join("a/gel.csv"), b"t_s,v0,v1,v2\n0,1,\xff\xfe,2\n").unwrap();
    fs::remove_file(csv_dir.join("a/foil.csv")).unwrap();
    let error = refused(&csv_dir, root.path());
    assert!(error.contains("gel.csv: line 2: not UTF-8"), "{error}");
}

#[test]
fn an_empty_folder_and_a_taken_place_are_refused() {
    let root = tempfile::tempdir().unwrap();
    let csv_dir = root.path().join("csv");
    fs::create_dir(&csv_dir).unwrap();
    assert!(refused(&csv_dir, root.path()).contains("csv: folder: no take; put each take's take.toml"));
    assert!(refused(&root.path().join("nowhere"), root.path()).contains("failed to read"));

    write_recording(&csv_dir.join("a b"));
    write_recording(&csv_dir.join("a-b"));
    assert!(refused(&csv_dir, root.path()).contains("would be called \"a-b\" like another take"));

    fs::create_dir_all(root.path().join("out/session")).unwrap();
    assert!(refused(&csv_dir, root.path()).contains("is there already; choose another folder"));
}

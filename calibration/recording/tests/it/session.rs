//! Sessions: opened, created at once or not at all, checked.

use std::{fs, path::Path};

use palpate_messages::{foxglove::JointStates, proto::TactileSample};
use palpate_recording::{Session, SessionDraft, SessionFile, SessionTake, check_session};
use palpate_reports::{CheckReport, Severity};
use prost::Message as _;

use crate::support::{meta, rewrite, take_bytes, tree};

fn entry(file: &str, accepted: bool) -> SessionTake {
    SessionTake { file: file.to_owned(), object: "ball".to_owned(), accepted }
}

fn session_file(takes: Vec<SessionTake>) -> SessionFile {
    SessionFile {
        format: 1,
        station: "finger".to_owned(),
        recorded: "2026-03-01T10:00:00Z".to_owned(),
        takes,
    }
}

/// A session of the given takes at `dir/demo`.
pub(crate) fn session(dir: &Path, takes: &[(&str, Vec<u8>)]) -> Session {
    let draft = SessionDraft::new(&dir.join("demo")).unwrap();
    for (file, bytes) in takes {
        fs::write(draft.partial_dir().join(file), bytes).unwrap();
    }
    draft.commit(session_file(takes.iter().map(|(file, _)| entry(file, true)).collect())).unwrap()
}

fn open_error(text: &str) -> String {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("session.toml"), text).unwrap();
    let before = tree(dir.path());
    let error = Session::open(dir.path()).unwrap_err().to_string();
    assert_eq!(tree(dir.path()), before);
    error
}

fn messages(report: &CheckReport) -> Vec<String> {
    report.problems.iter().map(|p| format!("{:?} {}: {}", p.severity, p.place, p.message)).collect()
}

#[test]
fn a_committed_session_opens_as_it_was() {
    let dir = tempfile::tempdir().unwrap();
    let made = session(dir.path(), &[("take-01.mcap", take_bytes(2000, &meta()))]);
    let opened = Session::open(&dir.path().join("demo")).unwrap();
    assert_eq!((&opened.id, &opened.file), (&made.id, &made.file));
    assert_eq!(opened.id, "demo");
    assert_eq!(opened.take(0).unwrap().id, "take-01");
    assert_eq!(opened.accepted_takes().unwrap().len(), 1);
    assert!(opened.take(1).unwrap_err().to_string().contains("there is no take 1, only 1"));
    insta::assert_snapshot!(fs::read_to_string(dir.path().join("demo/session.toml")).unwrap(), @r#"
    format = 1
    station = "finger"
    recorded = "2026-03-01T10:00:00Z"

    [[take]]
    file = "take-01.mcap"
    object = "ball"
    accepted = true
    "#);
}

#[test]
fn a_dropped_draft_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let draft = SessionDraft::new(&dir.path().join("demo")).unwrap();
    fs::write(draft.partial_dir().join("take-01.mcap"), b"half a take").unwrap();
    assert!(!dir.path().join("demo").exists());
    drop(draft);
    assert_eq!(tree(dir.path()).len(), 0);
}

#[test]
fn an_empty_draft_or_a_taken_place_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let draft = SessionDraft::new(&dir.path().join("demo")).unwrap();
    let error = draft.commit(session_file(Vec::new())).unwrap_err().to_string();
    assert!(error.contains("the session has no takes"), "{error}");
    assert_eq!(tree(dir.path()).len(), 0);

    fs::create_dir(dir.path().join("demo")).unwrap();
    let before = tree(dir.path());
    let error = SessionDraft::new(&dir.path().join("demo")).unwrap_err().to_string();
    assert!(error.contains("demo: session: is there already"), "{error}");
    assert_eq!(tree(dir.path()), before);
}

#[test]
fn a_broken_session_file_is_refused_with_its_line() {
    let take = |file: &str| format!("[[take]]\nfile = {file:?}\nobject = \"ball\"\naccepted = true\n");
    let head = "format = 1\nstation = \"finger\"\n";
    for (text, expected) in [
        (head.to_owned(), "session.toml: take: the session has no takes"),
        (format!("format = 2\nstation = \"finger\"\n{}", take("a.mcap")), "format: 2, expected 1"),
        (format!("{head}color = 1\n{}", take("a.mcap")), "line 3: unknown field `color`"),
        (format!("{head}[[take\n"), "session.toml: line 3"),
        (format!("{head}{}", take("../a.mcap")), "take 1: file \"../a.mcap\" must be the name of a file"),
        (format!("{head}{}", take("/etc/passwd")), "must be the name of a file"),
        (format!("{head}{0}{0}", take("a.mcap")), "take 2: \"a.mcap\" is listed twice"),
    ] {
        let error = open_error(&text);
        assert!(error.contains(expected), "{error}\nlacks\n{expected}");
    }
    let error = Session::open(Path::new("/nowhere/at/all")).unwrap_err().to_string();
    assert!(error.contains("failed to read \"/nowhere/at/all/session.toml\""), "{error}");
}

#[test]
fn a_take_of_another_station_or_object_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let mut other_object = meta();
    other_object.object = "wedge".to_owned();
    let mut session = session(dir.path(), &[("take-01.mcap", take_bytes(1000, &other_object))]);
    let error = session.take(0).unwrap_err().to_string();
    assert!(error.contains("take-01.mcap: object: \"wedge\", but session.toml says \"ball\""), "{error}");
    session.file.takes[0].object = "wedge".to_owned();
    session.file.station = "hand".to_owned();
    let error = session.take(0).unwrap_err().to_string();
    assert!(error.contains("attached station: \"finger\", but session.toml says \"hand\""), "{error}");
    session.file.station = "finger".to_owned();
    session.file.takes[0].accepted = false;
    assert!(session.accepted_takes().unwrap_err().to_string().contains("no take is accepted"));
}

#[test]
fn a_check_counts_touches_by_half_and_finds_what_was_not_touched() {
    let dir = tempfile::tempdir().unwrap();
    // 3 s touch all five channels once (the last in part), 1 s only the first.
    let long = take_bytes(3000, &meta());
    let takes: Vec<(&str, Vec<u8>)> = vec![
        ("take-01.mcap", long.clone()),
        ("take-02.mcap", long.clone()),
        ("take-03.mcap", take_bytes(1000, &meta())),
    ];
    let report = check_session(&session(dir.path(), &takes)).unwrap();
    assert!(report.ok);
    assert_eq!(report.frames, 30 + 30 + 10);
    assert!((report.duration_s - (2.9 + 2.9 + 0.9)).abs() < 1e-9);
    let touches: Vec<_> = report.coverage.iter().map(|c| (c.touches, c.touches_by_half)).collect();
    assert_eq!(touches, [(3, [2, 1]), (2, [2, 0]), (2, [2, 0]), (2, [2, 0]), (2, [2, 0])]);
    assert!((report.coverage[1].active_s - 1.0).abs() < 1e-9, "{}", report.coverage[1].active_s);
    let found = messages(&report);
    assert!(
        found.contains(
            &"Warning tip.0: touched 2 times in the first half of the takes and 1 times in the second; 4 in each \
              are needed to judge it"
                .to_owned()
        ),
        "{found:#?}"
    );
    let stream = &report.takes[0].streams[2];
    assert_eq!((stream.stream.as_str(), stream.samples, stream.gaps), ("film", 120, 0));
    assert!((stream.rate_hz - 40.0).abs() < 1e-6 && (stream.longest_gap_s - 0.025).abs() < 1e-9);
}

#[test]
fn a_check_reports_what_cannot_be_read_and_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let good = take_bytes(3000, &meta());
    let step_back = rewrite(&good, |edit| {
        if edit.topic == "/tactile/gel" && edit.number == 10 {
            *edit.log_time -= 20_000_000;
        }
    });
    let gap = rewrite(&good, |edit| {
        *edit.dropped = edit.topic == "/tactile/film" && (20..40).contains(&edit.number);
    });
    let no_baseline = rewrite(&good, |edit| *edit.dropped = edit.topic == "/markers");
    let takes: Vec<(&str, Vec<u8>)> = vec![
        ("take-01.mcap", good[..good.len() / 3].to_vec()),
        ("take-02.mcap", rewrite(&good, |edit| *edit.dropped = edit.topic == "/tactile/film")),
        ("take-03.mcap", step_back),
        ("take-04.mcap", gap),
        ("take-05.mcap", no_baseline),
    ];
    let mut session = session(dir.path(), &takes);
    session.file.takes.push(entry("take-06.mcap", false));
    let before = tree(dir.path());
    let report = check_session(&session).unwrap();
    assert_eq!(tree(dir.path()), before);
    assert!(!report.ok);
    let found = messages(&report);
    for expected in [
        "Error take-01, byte ",
        "Error take-02, /tactile/film: no messages",
        "Error take-03, /tactile/gel: message 11: its time 0.08 s does not come after 0.09 s",
        "Warning take-04, film: 33.3 Hz, nominal is 40.0 Hz",
        "Warning take-04, film: 1 gap, the longest 0.525 s",
        "Warning take-05: no baseline span",
        "Info take-06: not accepted",
        "Error take-06, file: failed to read",
    ] {
        assert!(found.iter().any(|message| message.starts_with(expected)), "{expected} not in {found:#?}");
    }
    let severities: Vec<Severity> = report.problems.iter().map(|problem| problem.severity).collect();
    assert!(severities.is_sorted(), "worst first");
    let gel = report.takes.iter().find(|take| take.id == "take-03").unwrap().streams[1].clone();
    assert_eq!(gel.clock_steps_back, 1);
}

/// A take of which every message of the joint log was changed.
fn with_joints(bytes: &[u8], change: impl Fn(&mut f64)) -> Vec<u8> {
    rewrite(bytes, |edit| {
        if edit.topic == "/joint_states" {
            let mut message = JointStates::decode(edit.data.as_slice()).unwrap();
            message.joints.iter_mut().filter_map(|joint| joint.position.as_mut()).for_each(&change);
            *edit.data = message.encode_to_vec();
        }
    })
}

#[test]
fn what_robot_and_sensors_cannot_report_makes_a_session_unusable() {
    let good = take_bytes(2000, &meta());
    let mut far = meta();
    far.base_from_object.translation.vector.x = 1e308;
    let below = rewrite(&good, |edit| {
        if edit.topic == "/tactile/gel" && edit.number < 3 {
            let mut message = TactileSample::decode(edit.data.as_slice()).unwrap();
            message.raw[1] = -5.0;
            *edit.data = message.encode_to_vec();
        }
    });
    let cases: [(Vec<u8>, &str); 5] = [
        (
            with_joints(&good, |position| *position = if *position < 0.0 { 1e308 } else { *position }),
            "Error take-01, curl: 20 positions of 20, the farthest: 1e308 rad lies outside of the joint's limits, \
             -1.5..1.5 rad",
        ),
        (
            with_joints(&good, |position| *position = position.min(0.05) + 0.3),
            "Error take-01, slide: 20 positions of 20, the farthest: 0.35 m lies outside of the joint's limits, 0..0.2 m",
        ),
        (
            with_joints(&good, |position| *position = if *position < 0.0 { -28.6 } else { *position }),
            "Error take-01, joints: most positions lie outside of the joints' limits and would fit as degrees",
        ),
        (take_bytes(2000, &far), "Error take-01, object_pose: the object is 1e308 m from the robot's base"),
        (below, "Error take-01, tip.1: 3 readings, the lowest of which is -5 counts is less than 0"),
    ];
    for (bytes, expected) in cases {
        let dir = tempfile::tempdir().unwrap();
        let report = check_session(&session(dir.path(), &[("take-01.mcap", bytes)])).unwrap();
        let found = messages(&report);
        assert!(found[0].starts_with(expected), "{expected} is not first in {found:#?}");
        assert!(!report.ok);
    }
    let dir = tempfile::tempdir().unwrap();
    // As far off as a zero may be that a diagnosis is to find.
    let offset = with_joints(&good, |position| *position = if *position < 0.0 { -1.59 } else { *position });
    assert!(check_session(&session(dir.path(), &[("take-01.mcap", offset)])).unwrap().ok);
}

#[test]
fn links_out_of_the_session_and_special_files_are_not_opened() {
    use std::os::unix::fs::symlink;
    let dir = tempfile::tempdir().unwrap();
    let good = take_bytes(1000, &meta());
    fs::write(dir.path().join("elsewhere.mcap"), &good).unwrap();
    let takes: Vec<(&str, Vec<u8>)> = ["take-01.mcap", "take-02.mcap", "take-03.mcap", "take-04.mcap"]
        .map(|file| (file, good.clone()))
        .into();
    let session = session(dir.path(), &takes);
    let replace = |file: &str, target: &str| {
        fs::remove_file(session.dir.join(file)).unwrap();
        symlink(target, session.dir.join(file)).unwrap();
    };
    replace("take-01.mcap", "../elsewhere.mcap");
    replace("take-02.mcap", "/dev/zero");
    replace("take-03.mcap", "take-04.mcap");
    let error = session.take(0).unwrap_err().to_string();
    assert!(error.contains("take-01.mcap: link: is a link that leads out of the folder \"demo\""), "{error}");
    assert!(session.take(1).unwrap_err().to_string().contains("leads out of the folder"));
    assert_eq!(session.take(2).unwrap().id, "take-03", "a link within the session is as good as a file");
    fs::remove_file(session.dir.join("take-02.mcap")).unwrap();
    rustix::fs::mknodat(
        rustix::fs::CWD,
        session.dir.join("take-02.mcap"),
        rustix::fs::FileType::Fifo,
        rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR,
        0,
    )
    .unwrap();
    let found = messages(&check_session(&session).unwrap());
    assert!(
        found.iter().any(|message| message.contains("Error take-02, file: is a named pipe")),
        "{found:#?}"
    );
    assert!(found.iter().any(|message| message.contains("Error take-01, link: ")), "{found:#?}");

    let toml = session.dir.join("session.toml");
    fs::rename(&toml, dir.path().join("session.toml")).unwrap();
    symlink("../session.toml", &toml).unwrap();
    let error = Session::open(&session.dir).unwrap_err().to_string();
    assert!(error.contains("session.toml: link: is a link that leads out"), "{error}");
    fs::remove_file(&toml).unwrap();
    fs::File::create(&toml).unwrap().set_len(1 << 40).unwrap();
    let error = Session::open(&session.dir).unwrap_err().to_string();
    assert!(error.contains("session.toml: file: is larger than"), "{error}");
}

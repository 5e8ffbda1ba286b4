//! Sessions that grow take by take: accepted, set aside, taken back, gone on with after a crash.

use std::{fs, path::Path};

use palpate_recording::{
    GrowingSession, LiveTake, PlannedStep, RecordingError, Session, SessionPlan, TakeState, check_session,
};
use palpate_reports::TakeVerdict;

use crate::{
    live::write_tick,
    support::{START_UNIX_NS, meta, station, tree},
};

fn plan() -> SessionPlan {
    let step = |primitive: &str| PlannedStep {
        object: "ball".to_owned(),
        primitive: primitive.to_owned(),
        added_because: None,
    };
    SessionPlan { plan: "two".to_owned(), steps: vec![step("tap"), step("roll")] }
}

pub(crate) fn open(dir: &Path) -> Result<(GrowingSession, Vec<String>), RecordingError> {
    GrowingSession::open(dir, "finger", &plan(), "somebody", "2026-11-21T10:00:00Z")
}

fn start(growing: &mut GrowingSession, step_idx: usize) -> LiveTake {
    let mut live =
        growing.start_take(step_idx, &station(), &meta(), START_UNIX_NS).expect("the take is started");
    for tick_ms in (0..1500).step_by(5) {
        write_tick(&mut live, tick_ms).expect("the sample is written");
    }
    live
}

fn record(growing: &mut GrowingSession, step_idx: usize) -> String {
    let live = start(growing, step_idx);
    let end = growing.end_take(live, "").expect("the take is ended");
    assert_eq!(end.problem, "");
    end.take
}

fn accepted(dir: &Path) -> Vec<String> {
    let session = Session::open(dir).expect("the session opens");
    session.file.takes.iter().map(|take| take.id().to_owned()).collect()
}

fn states(growing: &GrowingSession) -> Vec<(&str, TakeState)> {
    growing.recording().takes.iter().map(|take| (take.file.as_str(), take.state)).collect()
}

#[test]
fn a_session_grows_by_what_is_accepted() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path().join("monday");
    let (mut growing, report) = open(&dir).unwrap();
    assert!(report.is_empty());
    // A session that has nothing yet can be opened and checked, but gives no takes.
    let empty = Session::open(&dir).unwrap();
    assert!(check_session(&empty).unwrap().takes.is_empty());
    assert!(empty.accepted_takes().unwrap_err().to_string().contains("no take is accepted"));

    let second = record(&mut growing, 1);
    assert!(accepted(&dir).is_empty());
    growing.accept(&second).unwrap();
    let first = record(&mut growing, 0);
    growing.accept(&first).unwrap();
    assert_eq!(accepted(&dir), ["take-01", "take-02"], "in the order of the plan");
    let session = Session::open(&dir).unwrap();
    assert_eq!(session.accepted_takes().unwrap().len(), 2);
    assert_eq!(session.file.recorded, "2026-11-21T10:00:00Z");

    // A second one of the same step has a name of its own and does not replace the first.
    let again = record(&mut growing, 0);
    assert_eq!(again, "take-01-2");
    let error = growing.accept(&again).unwrap_err().to_string();
    assert!(error.contains("\"take-01\" is accepted for this step already"), "{error}");
    growing.set_aside(&first).unwrap();
    growing.accept(&again).unwrap();
    assert_eq!(accepted(&dir), ["take-01-2", "take-02"]);
}

#[test]
fn what_is_set_aside_can_be_taken_back_and_its_name_is_not_used_again() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path().join("monday");
    let (mut growing, _) = open(&dir).unwrap();
    let first = record(&mut growing, 0);
    let bytes = fs::read(dir.join("take-01.mcap")).unwrap();
    growing.accept(&first).unwrap();
    growing.set_aside(&first).unwrap();
    assert!(accepted(&dir).is_empty());
    assert_eq!(fs::read(dir.join("discarded/take-01.mcap")).unwrap(), bytes);
    assert_eq!(growing.last_set_aside().map(|take| take.id()), Some("take-01"));
    assert!(growing.set_aside(&first).unwrap_err().to_string().contains("set aside already"));
    assert!(growing.accept(&first).unwrap_err().to_string().contains("waits for a decision"));

    let second = record(&mut growing, 0);
    assert_eq!(second, "take-01-2");
    growing.set_aside(&second).unwrap();
    assert_eq!(growing.last_set_aside().map(|take| take.id()), Some("take-01-2"));

    growing.restore(&first).unwrap();
    assert_eq!(fs::read(dir.join("take-01.mcap")).unwrap(), bytes);
    assert!(accepted(&dir).is_empty(), "it waits for a decision again");
    growing.accept(&first).unwrap();
    assert_eq!(accepted(&dir), ["take-01"]);
    assert!(growing.restore(&first).unwrap_err().to_string().contains("it is not set aside"));
    assert!(growing.restore("take-09").unwrap_err().to_string().contains("no such take"));
}

#[test]
fn a_file_in_the_way_is_never_replaced() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path().join("monday");
    let (mut growing, _) = open(&dir).unwrap();
    fs::write(dir.join("take-01.mcap"), "somebody's").unwrap();
    let first = record(&mut growing, 0);
    assert_eq!(first, "take-01-2");
    growing.set_aside(&first).unwrap();
    fs::write(dir.join("take-01-2.mcap"), "somebody else's").unwrap();
    let error = growing.restore(&first).unwrap_err().to_string();
    assert!(error.contains("take-01-2.mcap: file: a file is there already"), "{error}");
    assert_eq!(growing.recording().takes[0].state, TakeState::Discarded, "as it is on disk");
    assert_eq!(fs::read_to_string(dir.join("take-01-2.mcap")).unwrap(), "somebody else's");
    assert_eq!(fs::read_to_string(dir.join("take-01.mcap")).unwrap(), "somebody's");
}

#[test]
fn a_session_is_gone_on_with_after_a_restart() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path().join("monday");
    let (mut growing, _) = open(&dir).unwrap();
    let first = record(&mut growing, 0);
    let verdict = TakeVerdict {
        good: false,
        summary: "one channel was missed".to_owned(),
        problems: vec!["tip.1 was not touched".to_owned()],
        covered: vec!["tip.0".to_owned()],
        missed: vec!["tip.1".to_owned()],
        rates_hz: vec![("joints".to_owned(), 10.0), ("gel".to_owned(), 99.9)],
    };
    growing.set_verdict(&first, verdict, true).unwrap();
    growing.note(&first, "again with the other \"fixture\"\nif there is time").unwrap();
    growing.accept(&first).unwrap();
    let live = start(&mut growing, 1);
    growing.end_take(live, "the operator cancelled it").unwrap();
    let recording = growing.recording().clone();
    assert_eq!(recording.takes[1].broken_off, "the operator cancelled it");

    let error = open(&dir).unwrap_err().to_string();
    assert!(error.contains("is being recorded by another process"), "{error}");
    drop(growing);
    let before = tree(&dir);
    let (growing, report) = open(&dir).unwrap();
    assert_eq!(growing.recording(), &recording);
    assert!(report.is_empty(), "{report:?}");
    assert_eq!(tree(&dir), before);
}

/// Each case is what a crash can leave; afterwards files and lists agree.
#[test]
fn what_a_crash_interrupted_is_finished() {
    use TakeState::{Accepted, Discarded, Review};
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path().join("monday");
    let (mut growing, _) = open(&dir).unwrap();
    let first = record(&mut growing, 0);
    growing.accept(&first).unwrap();
    // Ended, but not yet listed as such.
    let live = start(&mut growing, 1);
    fs::rename(live.path(), dir.join("take-02.mcap")).unwrap();
    live.finish().unwrap();
    drop(growing);
    let (mut growing, report) = open(&dir).unwrap();
    assert_eq!(report, ["take-02 is complete; it waits for a decision"]);
    assert_eq!(states(&growing), [("take-01.mcap", Accepted), ("take-02.mcap", Review)]);

    // Listed as set aside, but not yet moved.
    growing.set_aside("take-02").unwrap();
    fs::rename(dir.join("discarded/take-02.mcap"), dir.join("take-02.mcap")).unwrap();
    drop(growing);
    let (growing, report) = open(&dir).unwrap();
    assert_eq!(report, ["take-02 was about to be set aside; now it is"]);
    assert!(dir.join("discarded/take-02.mcap").is_file() && !dir.join("take-02.mcap").exists());
    drop(growing);

    // Listed as back, but not yet moved; and the session's own list older than that.
    fs::rename(dir.join("take-01.mcap"), dir.join("discarded/take-01.mcap")).unwrap();
    let session_toml = fs::read_to_string(dir.join("session.toml")).unwrap();
    let head = session_toml.split("[[take]]").next().unwrap();
    fs::write(dir.join("session.toml"), head).unwrap();
    let (growing, report) = open(&dir).unwrap();
    assert_eq!(report, ["take-01 was about to be moved; it is back in its place"]);
    assert_eq!(accepted(&dir), ["take-01"]);
    assert_eq!(states(&growing), [("take-01.mcap", Accepted), ("take-02.mcap", Discarded)]);
    drop(growing);

    // A partial take of which nothing can be read, one that was never written, and one that nobody knows.
    let (mut growing, _) = open(&dir).unwrap();
    let empty = growing.start_take(1, &station(), &meta(), START_UNIX_NS).unwrap();
    let mut live = start(&mut growing, 1);
    live.flush().unwrap();
    fs::remove_file(live.path()).unwrap();
    fs::write(dir.join("take-07.mcap.partial"), "?").unwrap();
    let text = fs::read(empty.path()).unwrap();
    drop((empty, live));
    fs::write(dir.join("take-02-2.mcap.partial"), text).unwrap();
    drop(growing);
    let (growing, report) = open(&dir).unwrap();
    assert_eq!(report.len(), 3, "{report:#?}");
    assert!(
        report[0].contains("no take can be made of it; the file is in discarded/take-02-2.mcap"),
        "{report:?}"
    );
    assert!(report[1].contains("take-02-3 was begun, but nothing of it was written"), "{report:?}");
    assert!(report[2].contains("take-07.mcap.partial belongs to no take"), "{report:?}");
    assert_eq!(growing.last_set_aside().map(|take| take.id()), Some("take-02"));
    drop(growing);

    // An accepted take that somebody removed.
    fs::remove_file(dir.join("take-01.mcap")).unwrap();
    let (_, report) = open(&dir).unwrap();
    assert!(report[0].contains("take-01 is gone"), "{report:?}");
    assert!(accepted(&dir).is_empty());
}

#[test]
fn what_is_no_session_of_this_plan_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let (growing, _) = open(&at("monday")).unwrap();
    drop(growing);
    let before = tree(dir.path());
    let mut other = plan();
    other.plan = "nine".to_owned();
    let open_with = |dir: &Path, station: &str, plan: &SessionPlan| {
        GrowingSession::open(dir, station, plan, "", "").map(|_| ()).unwrap_err().to_string()
    };
    let error = open_with(&at("monday"), "finger", &other);
    assert!(error.contains("recording.toml: plan: the session follows \"two\", not \"nine\""), "{error}");
    let mut changed = plan();
    changed.steps[1].primitive = "slide".to_owned();
    let error = open_with(&at("monday"), "finger", &changed);
    assert!(error.contains("step 2: the plan was changed"), "{error}");
    let error = open_with(&at("monday"), "hand", &plan());
    assert!(error.contains("session.toml: station: \"finger\", but this station is \"hand\""), "{error}");
    changed.steps.clear();
    let error = open_with(&at("tuesday"), "finger", &changed);
    assert!(error.contains("the plan \"two\" has no steps"), "{error}");
    assert_eq!(tree(dir.path()), before);

    fs::create_dir(at("imported")).unwrap();
    fs::write(at("imported").join("session.toml"), "format = 1\n").unwrap();
    let error = open_with(&at("imported"), "finger", &plan());
    assert!(error.contains("was not recorded step by step"), "{error}");

    for (text, expected) in [
        ("format = 2\nplan = \"two\"\n", "format: 2, expected 1"),
        ("format = 1\nplan = 3\n", "recording.toml: line 2"),
        (
            "format = 1\nplan = \"two\"\n[[take]]\nfile = \"../take-01.mcap\"\nstep = 0\nstate = \"review\"\n",
            "take 1: file \"../take-01.mcap\" must be the name of an .mcap file",
        ),
        (
            "format = 1\nplan = \"two\"\n[[take]]\nfile = \"take-01.mcap\"\nstep = 0\nstate = \"review\"\n",
            "take 1: step 0 of a plan with 0 steps",
        ),
    ] {
        fs::write(at("monday").join("recording.toml"), text).unwrap();
        let error = open_with(&at("monday"), "finger", &plan());
        assert!(error.contains(expected), "{error}\nlacks\n{expected}");
    }
}

#[test]
fn steps_are_added_kept_over_a_restart_and_taken_off_again() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path().join("monday");
    let added = |primitive: &str| PlannedStep {
        object: "ball".to_owned(),
        primitive: primitive.to_owned(),
        added_because: Some("tells latency from low pass".to_owned()),
    };
    let (mut growing, _) = open(&dir).unwrap();
    growing.add_step(added("slide")).unwrap();
    growing.add_step(added("tap")).unwrap();
    let slide = record(&mut growing, 2);
    let tap = record(&mut growing, 3);
    growing.accept(&tap).unwrap();
    let refused = growing.remove_step(2).unwrap_err().to_string();
    assert!(refused.contains("has a take"), "{refused}");
    let refused = growing.remove_step(0).unwrap_err().to_string();
    assert!(refused.contains("only a step that was added"), "{refused}");
    growing.set_aside(&slide).unwrap();
    growing.remove_step(2).unwrap();
    assert_eq!(growing.recording().takes[0].step, 2, "the step behind it moves up");
    drop(growing);

    assert_eq!(GrowingSession::steps_of(&dir).unwrap().unwrap().len(), 3);
    assert!(dir.join("discarded").join(format!("{slide}.mcap")).is_file());
    // The plan alone is not the whole of what was recorded; with what was added, it goes on, and may grow.
    assert!(open(&dir).unwrap_err().to_string().contains("the plan was changed"));
    let mut grown = plan();
    grown.steps.extend([added("tap"), added("roll")]);
    let (growing, _) = GrowingSession::open(&dir, "finger", &grown, "", "2026-11-22T10:00:00Z").unwrap();
    assert_eq!(growing.recording().steps, grown.steps);
    assert_eq!(accepted(&dir), [tap]);
}

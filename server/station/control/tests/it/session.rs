//! A guided session: a take from the confirmed object to the accepted file.

use std::{
    thread,
    time::{Duration, Instant},
};

use palpate_control::ControlError;
use palpate_recording::{Session, SpanKind};
use palpate_wire::api::{
    RecordingAction, RecordingPhase, RecordingSession, StartRecording, StepState, WantedTake,
};

use crate::bench::{Bench, Operator, claim, targets};

const PATIENCE: Duration = Duration::from_secs(240);

fn start(bench: &Bench, operator: &Operator, session: &str) -> Result<RecordingSession, ControlError> {
    let start = StartRecording {
        plan: "quick_check".to_owned(),
        session: session.to_owned(),
        operator: "Ada".to_owned(),
        only_wanted: false,
    };
    let document = bench.handle.start_recording(&operator.claim(), start)?;
    Ok(document.session.expect("it was begun"))
}

fn wait_for_phase(bench: &Bench, phase: RecordingPhase) -> RecordingSession {
    let begun = Instant::now();
    loop {
        let document = bench.handle.recording().expect("the loop answers");
        let session = document.session.expect("a session is under way");
        if session.phase == phase {
            return session;
        }
        assert!(begun.elapsed() < PATIENCE, "never {phase:?}: {session:?}");
        thread::sleep(Duration::from_millis(20));
    }
}

fn act(bench: &Bench, operator: &Operator, action: RecordingAction) -> RecordingSession {
    let document = bench.handle.act(&operator.claim(), action.clone()).expect("it is time for that");
    document.session.unwrap_or_else(|| panic!("no session after {action:?}"))
}

/// Puts the object in place and brings the robot to the start of the step under way.
fn to_start(bench: &Bench, operator: &Operator) {
    let session = act(bench, operator, RecordingAction::ConfirmObject { fixture_trusted: true });
    let object = session.steps[session.current.expect("a step is under way")].object.clone();
    bench.wait_until("the object in place", |now| now.object.as_deref() == Some(object.as_str()));
    act(bench, operator, RecordingAction::GoToStart);
    wait_for_phase(bench, RecordingPhase::StartPose);
}

#[test]
fn a_take_is_recorded_checked_accepted_and_can_be_read() {
    let bench = Bench::patient();
    let plans = bench.handle.recording().unwrap().plans;
    assert!(plans.iter().any(|plan| plan.id == "quick_check" && plan.takes == 3), "{plans:?}");
    let operator = Operator::in_control(&bench, 1);
    let session = start(&bench, &operator, "monday").unwrap();
    assert_eq!((session.phase, session.steps.len()), (RecordingPhase::PlaceObject, 3));
    // Another one cannot be begun meanwhile.
    assert!(matches!(start(&bench, &operator, "tuesday"), Err(ControlError::Refused(_))));
    operator.arm(&bench);
    act(&bench, &operator, RecordingAction::ConfirmObject { fixture_trusted: true });
    // From a pose that is not the start, as an operator leaves it.
    let dof = bench.dof("index_pip");
    operator.accepted(targets(&[dof], &[0.9]));
    bench.wait_until("away from the start", |now| (now.positions[dof] - 0.9).abs() < 0.05);
    act(&bench, &operator, RecordingAction::GoToStart);
    assert!(operator.refused(targets(&[dof], &[0.4])).contains("by itself"));
    wait_for_phase(&bench, RecordingPhase::StartPose);
    act(&bench, &operator, RecordingAction::Run);
    wait_for_phase(&bench, RecordingPhase::Running);
    assert!((bench.emulated.snapshot().positions[dof] - 0.9).abs() > 0.2);
    act(&bench, &operator, RecordingAction::Note { text: "a fly".to_owned() });
    let frame = bench.wait_for_frame("something to look at", |frame| {
        let status = frame.control.as_ref().and_then(|state| state.recording.as_ref());
        status.is_some_and(|status| status.fraction > 0.2 && status.elapsed_s > 1.0)
    });
    assert!(!frame.activity.is_empty());
    assert_eq!(frame.object, session.steps[0].object);
    assert_eq!(frame.object_pose.len(), 7);
    let session = wait_for_phase(&bench, RecordingPhase::Review);
    let step = &session.steps[0];
    let verdict = step.verdict.clone().expect("it was checked");
    assert_eq!(step.state, StepState::Review);
    assert!(session.problem.is_empty(), "{}", session.problem);
    assert!(verdict.missed.is_empty(), "{verdict:?}");
    assert!(step.touches.iter().all(|channel| verdict.covered.contains(channel)), "{verdict:?}");
    act(&bench, &operator, RecordingAction::Accept);
    let session = wait_for_phase(&bench, RecordingPhase::PlaceObject);
    assert_eq!((session.steps[0].state, session.current), (StepState::Accepted, Some(1)));
    act(&bench, &operator, RecordingAction::Leave);
    let begun = Instant::now();
    while bench.handle.recording().unwrap().session.is_some() {
        assert!(begun.elapsed() < PATIENCE);
        thread::sleep(Duration::from_millis(20));
    }

    let read = Session::open(&bench.dir.path().join("sessions/monday")).unwrap();
    let takes = read.accepted_takes().unwrap();
    assert_eq!(takes.len(), 1);
    let take = &takes[0];
    assert_eq!(take.meta.object, step.object);
    assert_eq!(take.meta.operator, "Ada");
    let joint_rate_hz = take.num_frames() as f64 / take.duration_s();
    assert!(joint_rate_hz > take.station.joint_rate_hz, "{joint_rate_hz} Hz");
    assert!(take.commands.times_s.len() > take.num_frames() / 2);
    for (stream, log) in take.station.layout.streams.iter().zip(&take.streams) {
        assert!(!log.times_s.is_empty(), "{}", stream.id);
        let width = stream.channels.len();
        assert_eq!(log.raw.len(), log.times_s.len() * width);
    }
    let kinds: Vec<SpanKind> = take.spans.iter().map(|span| span.kind).collect();
    for kind in [SpanKind::Baseline, SpanKind::Repetition, SpanKind::Note] {
        assert!(kinds.contains(&kind), "{kinds:?}");
    }
    bench.wait_for_audit("is accepted");
    bench.wait_for_audit("took the zero");
}

#[test]
fn a_take_ends_when_the_operator_is_gone_and_is_kept() {
    let bench = Bench::new();
    let mut operator = Operator::armed(&bench, 1);
    start(&bench, &operator, "monday").unwrap();
    to_start(&bench, &operator);
    act(&bench, &operator, RecordingAction::Run);
    wait_for_phase(&bench, RecordingPhase::Running);
    bench
        .wait_for("under way", |state| state.recording.as_ref().is_some_and(|status| status.elapsed_s > 2.0));
    operator.vanish(&bench);
    let session = wait_for_phase(&bench, RecordingPhase::Review);
    assert!(session.problem.contains("operator"), "{}", session.problem);
    let verdict = session.steps[0].verdict.clone().expect("it was checked");
    assert!(!verdict.good && !verdict.problems.is_empty(), "{verdict:?}");
    bench.wait_until("limp", |now| !now.torque_on.contains(&true));
    assert!(bench.dir.path().join("sessions/monday").join("take-01.mcap").is_file());
    let refused = bench.handle.act(&operator.claim(), RecordingAction::Again);
    assert!(matches!(refused, Err(ControlError::NotOperator(_))), "its connection is gone");
    let second = {
        let mut second = Operator::watcher(&bench, 2);
        second.take_control(true);
        second
    };
    // A board that is missing is said before anything is recorded without it.
    act(&bench, &second, RecordingAction::Again);
    wait_for_phase(&bench, RecordingPhase::PlaceObject);
    bench.set_faults("[[fault]]\nkind = \"unplug\"\ndevice = \"twintac2\"\n");
    second.arm(&bench);
    to_start(&bench, &second);
    let refused = bench.handle.act(&second.claim(), RecordingAction::Run);
    assert!(refused.unwrap_err().to_string().contains("twintac2"));
}

#[test]
fn sessions_that_cannot_be_are_refused_in_words() {
    let bench = Bench::new();
    let operator = Operator::in_control(&bench, 1);
    for (plan, session, expected) in [
        ("no_such", "monday", "quick_check"),
        ("quick_check", "../monday", "plain name"),
        ("quick_check", "", "plain name"),
        ("quick_check", ".hidden", "plain name"),
    ] {
        let start = StartRecording {
            plan: plan.to_owned(),
            session: session.to_owned(),
            operator: String::new(),
            only_wanted: false,
        };
        let refused = bench.handle.start_recording(&operator.claim(), start).unwrap_err().to_string();
        assert!(refused.contains(expected), "{refused}");
    }
    let refused = bench.handle.act(&operator.claim(), RecordingAction::Accept).unwrap_err().to_string();
    assert!(refused.contains("begin one"), "{refused}");
    assert!(!bench.dir.path().join("sessions").join("monday").exists());
}

fn leave(bench: &Bench, operator: &Operator) {
    act(bench, operator, RecordingAction::Leave);
    let begun = Instant::now();
    while bench.handle.recording().expect("the loop answers").session.is_some() {
        assert!(begun.elapsed() < PATIENCE);
        thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn what_is_wanted_waits_for_a_session_and_joins_its_checklist() {
    let bench = Bench::new();
    let nobody = claim(0);
    let wanted = |object: &str, primitive: &str| WantedTake {
        object: object.to_owned(),
        primitive: primitive.to_owned(),
        because: "tells latency from low pass".to_owned(),
    };
    let (sphere, cylinder) = ("sphere_50mm", "cylinder_25x100mm");
    let refused = bench.handle.want(&nobody, wanted("corner_block_80mm", "tap")).unwrap_err().to_string();
    assert!(refused.contains("no plan of this station has tap on corner_block_80mm"), "{refused}");
    let document = bench.handle.want(&nobody, wanted(sphere, "quick_tap")).unwrap();
    assert_eq!(document.wanted, [wanted(sphere, "quick_tap")]);
    let on_disk = || std::fs::read_to_string(bench.dir.path().join("wanted.json")).unwrap();
    assert!(on_disk().contains("quick_tap"), "a restart would not lose it");
    let refused = bench.handle.want(&nobody, wanted(sphere, "quick_tap")).unwrap_err().to_string();
    assert!(refused.contains("on the list already"), "{refused}");
    let document = bench.handle.unwant(&nobody, sphere, "quick_tap").unwrap();
    assert!(document.wanted.is_empty());
    assert_eq!(on_disk(), "[]");
    bench.handle.unwant(&nobody, sphere, "quick_tap").unwrap_err();

    // Alone, without the takes of any plan.
    let alone = || StartRecording {
        plan: "quick_check".to_owned(),
        session: "next".to_owned(),
        operator: String::new(),
        only_wanted: true,
    };
    let operator = Operator::in_control(&bench, 1);
    let refused = bench.handle.start_recording(&operator.claim(), alone()).unwrap_err().to_string();
    assert!(refused.contains("nothing is wanted"), "{refused}");
    assert!(!bench.dir.path().join("sessions/next").exists());
    bench.handle.want(&operator.claim(), wanted(sphere, "quick_tap")).unwrap();
    let document = bench.handle.start_recording(&operator.claim(), alone()).unwrap();
    assert!(document.wanted.is_empty(), "it is a step now");
    let pairs = |session: &RecordingSession| -> Vec<(String, bool)> {
        let steps = session.steps.iter();
        steps.map(|step| (step.object.clone(), step.added_because.is_some())).collect()
    };
    assert_eq!(pairs(&document.session.unwrap()), [(sphere.to_owned(), true)]);
    // Another one joins the session that is under way, and can be recorded.
    let session =
        bench.handle.want(&operator.claim(), wanted(cylinder, "quick_tap")).unwrap().session.unwrap();
    assert_eq!(pairs(&session), [(sphere.to_owned(), true), (cylinder.to_owned(), true)]);
    let refused = bench.handle.unwant(&nobody, cylinder, "quick_tap").unwrap_err();
    assert!(matches!(refused, ControlError::NotOperator(_)), "{refused}");
    operator.arm(&bench);
    act(&bench, &operator, RecordingAction::Select { step: 1 });
    to_start(&bench, &operator);
    act(&bench, &operator, RecordingAction::Run);
    wait_for_phase(&bench, RecordingPhase::Running);
    act(&bench, &operator, RecordingAction::Cancel);
    let session = wait_for_phase(&bench, RecordingPhase::Review);
    assert_eq!(session.steps[1].take.as_deref(), Some("take-02"));
    let session = bench.handle.unwant(&operator.claim(), sphere, "quick_tap").unwrap().session.unwrap();
    assert_eq!(session.steps[0].take.as_deref(), Some("take-02"), "the step behind it moves up");
    leave(&bench, &operator);

    // It goes on by itself, and what is wanted meanwhile comes with it.
    bench.handle.want(&operator.claim(), wanted(sphere, "quick_tap")).unwrap();
    let resumed = bench.handle.start_recording(&operator.claim(), alone()).unwrap().session.unwrap();
    assert_eq!(pairs(&resumed), [(cylinder.to_owned(), true), (sphere.to_owned(), true)]);
    assert_eq!(resumed.steps[0].state, StepState::Review);
    leave(&bench, &operator);
    // Behind the takes of a plan.
    bench.handle.want(&operator.claim(), wanted(cylinder, "quick_tap")).unwrap();
    let session = start(&bench, &operator, "monday").unwrap();
    let added: Vec<bool> = pairs(&session).iter().map(|(_, added)| *added).collect();
    assert_eq!(added, [false, false, false, true]);
}

#[test]
fn nobody_but_the_operator_changes_a_session_or_moves_the_robot() {
    let bench = Bench::patient();
    let operator = Operator::armed(&bench, 1);
    start(&bench, &operator, "monday").unwrap();
    act(&bench, &operator, RecordingAction::ConfirmObject { fixture_trusted: true });
    let before = bench.handle.recording().unwrap();
    let positions = bench.emulated.snapshot().positions;
    let mine = operator.lease();
    let guesses = [0, 1, 2, 3, 10_000, mine.wrapping_add(1), mine.wrapping_sub(1), u64::MAX];
    let actions = [
        RecordingAction::ConfirmObject { fixture_trusted: false },
        RecordingAction::GoToStart,
        RecordingAction::Run,
        RecordingAction::Cancel,
        RecordingAction::Accept,
        RecordingAction::Again,
        RecordingAction::Discard,
        RecordingAction::Undo,
        RecordingAction::Select { step: 1 },
        RecordingAction::Note { text: "me".to_owned() },
        RecordingAction::Leave,
    ];
    for lease in guesses {
        for action in &actions {
            let refused = bench.handle.act(&claim(lease), action.clone()).unwrap_err();
            assert!(
                matches!(&refused, ControlError::NotOperator(text) if text.contains("operator 1")),
                "{refused}"
            );
        }
        bench.handle.authorise(&claim(lease), "place faults", true).unwrap_err();
    }
    assert_eq!(bench.handle.recording().unwrap(), before);
    let moved = |now: &[f64]| now.iter().zip(&positions).any(|(now, before)| (now - before).abs() > 0.02);
    assert!(!moved(&bench.emulated.snapshot().positions));
    for what in ["go to the start pose", "run a motion", "accept a take", "leave the session", "place faults"]
    {
        let line = bench.wait_for_audit(&format!("{what}: refused"));
        assert_eq!(line.connection, "http from a test");
        bench.wait_for_audit(&format!("{what}: refused {} times more", guesses.len() - 1));
    }
    // And what the operator does is written down as theirs.
    act(&bench, &operator, RecordingAction::Leave);
    let line = bench.wait_for_audit("session monday is left");
    assert_eq!((line.who.as_str(), line.connection.as_str()), ("operator 1", "control 1, http from a test"));
}

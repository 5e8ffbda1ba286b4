//! Leaving while something is still under way, and coming back to what was never finished.

use palpate_recording::{RecordedTake, TakeState};
use palpate_wire::api::{RecordingAction, RecordingPhase, StepState};

use super::{Bench, Guide, Place, plan, recording};
use crate::recorder::RecorderEvent;

#[test]
fn leaving_waits_for_what_is_still_being_written_or_checked() {
    // Straight after a decision.
    let mut bench = Bench::new();
    bench.take();
    bench.act(RecordingAction::Accept).unwrap();
    bench.act(RecordingAction::Leave).unwrap();
    bench.act(RecordingAction::Leave).unwrap();
    assert!(bench.act(RecordingAction::Undo).unwrap_err().contains("being left"));
    assert!(!bench.answers.contains(&RecorderEvent::SessionEnded), "{:?}", bench.answers);
    bench.answer();
    assert_eq!(bench.answers, [RecorderEvent::SessionEnded]);
    assert_eq!(bench.states()[0], StepState::Accepted);
    bench.answer();
    assert!(bench.guide.finished());

    // Straight after a motion.
    let mut bench = Bench::new();
    bench.run();
    bench.act(RecordingAction::Cancel).unwrap();
    bench.act(RecordingAction::Leave).unwrap();
    bench.answer();
    bench.answer();
    assert!(bench.guide.finished() && bench.states()[0] == StepState::Review);

    // What went wrong is shown instead.
    let mut bench = Bench::new();
    bench.take();
    bench.act(RecordingAction::Accept).unwrap();
    bench.act(RecordingAction::Leave).unwrap();
    bench.put("take-01", Place::Review);
    bench.answers = vec![RecorderEvent::Failed { problem: "disk full".to_owned() }];
    bench.answer();
    assert!(!bench.guide.finished() && bench.session().problem == "disk full");
    bench.act(RecordingAction::Accept).unwrap();
}

#[test]
fn a_take_that_was_never_checked_is_when_it_is_taken_back() {
    let discarded = RecordedTake {
        file: "take-01.mcap".to_owned(),
        step: 0,
        state: TakeState::Discarded,
        broken_off: String::new(),
        readable: None,
        set_aside: 1,
        notes: Vec::new(),
        verdict: None,
    };
    let (guide, _) = Guide::new(plan(), "monday", &recording(vec![discarded]), &[]);
    let mut bench = Bench::around(guide);
    bench.takes.insert("take-01".to_owned(), (0, Place::Discarded));
    bench.act(RecordingAction::Undo).unwrap();
    bench.answer();
    assert_eq!(bench.phase(), RecordingPhase::Checking);
    bench.answer();
    assert_eq!(bench.phase(), RecordingPhase::Review);
}

//! Steps that join a session besides those of its plan.

use palpate_wire::api::{RecordingAction, RecordingPhase};

use super::{Bench, plan};
use crate::guide::*;

#[test]
fn steps_are_added_at_the_end_and_taken_off_while_they_have_no_take() {
    let mut bench = Bench::new();
    let added = |primitive: &str| GuideStep {
        primitive: primitive.to_owned(),
        added_because: Some("tells two rivals apart".to_owned()),
        ..plan().steps[0].clone()
    };
    for _ in 0..3 {
        bench.take();
        bench.act(RecordingAction::Accept).unwrap();
        bench.answer();
    }
    assert_eq!(bench.phase(), RecordingPhase::Done);
    let effects = bench.guide.add_step(added("press")).unwrap();
    assert!(
        matches!(&effects[1], Effect::Record(RecorderCommand::AddStep { step }) if step.primitive == "press")
    );
    // It is what is left to do.
    assert_eq!((bench.phase(), bench.session().current), (RecordingPhase::PlaceObject, Some(3)));
    assert_eq!(bench.session().steps[3].added_because.as_deref(), Some("tells two rivals apart"));
    bench.guide.add_step(added("pull")).unwrap();
    bench.act(RecordingAction::Select { step: 4 }).unwrap();

    let refused = bench.guide.remove_step("ball", "tap").unwrap_err();
    assert!(refused.contains("was not added"), "{refused}");
    let (removed, effects) = bench.guide.remove_step("ball", "press").unwrap();
    assert_eq!(removed, 3);
    assert!(effects.contains(&Effect::Record(RecorderCommand::RemoveStep { step: 3 })));
    assert_eq!((bench.session().current, bench.session().steps.len()), (Some(3), 4));
    assert_eq!(bench.session().steps[3].primitive, "pull");
    bench.take();
    let refused = bench.guide.remove_step("ball", "pull").unwrap_err();
    assert!(refused.contains("discard its take first"), "{refused}");
    bench.act(RecordingAction::Discard).unwrap();
    bench.answer();
    assert!(bench.session().can_undo);
    bench.guide.remove_step("ball", "pull").unwrap();
    let session = bench.session();
    assert_eq!((session.phase, session.steps.len(), session.can_undo), (RecordingPhase::Done, 3, false));
}

#[test]
fn no_step_is_taken_off_under_a_robot_that_moves() {
    let mut bench = Bench::new();
    let step = GuideStep { added_because: Some(String::new()), ..plan().steps[0].clone() };
    bench.guide.add_step(step).unwrap();
    bench.act(RecordingAction::ConfirmObject { fixture_trusted: true }).unwrap();
    bench.act(RecordingAction::GoToStart).unwrap();
    let refused = bench.guide.remove_step("ball", "tap").unwrap_err();
    assert!(refused.contains("on its way"), "{refused}");
}

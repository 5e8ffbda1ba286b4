use palpate_recording::TakeMeta;

use super::*;

const MS: u64 = 1_000_000;

fn plan(marks_baseline: bool) -> FreePlan {
    let meta = TakeMeta {
        object: "ball".to_owned(),
        base_from_object: Isometry3::identity(),
        primitive: "rollout".to_owned(),
        fixture_trusted: true,
        surroundings: Vec::new(),
        operator: "somebody".to_owned(),
        software: "tests".to_owned(),
    };
    FreePlan { session: "tuesday".to_owned(), step: 0, meta, marks_baseline }
}

fn standing(lease: u64, phase: Phase) -> Standing<'static> {
    Standing { phase, lease, reason: "" }
}

/// What the recorder is told of `effects`.
fn commands(effects: Vec<Effect>) -> Vec<RecorderCommand> {
    let command = |effect| match effect {
        Effect::Record(command) => Some(command),
        _ => None,
    };
    effects.into_iter().filter_map(command).collect()
}

fn is_end(command: &RecorderCommand) -> bool {
    matches!(command, RecorderCommand::EndTake { .. })
}

fn ended(broken_off: &str) -> RecorderEvent {
    RecorderEvent::TakeEnded { take: "take-01".to_owned(), broken_off: broken_off.to_owned() }
}

#[test]
fn a_take_goes_from_its_begin_to_the_session() {
    let (mut free, effects) = Free::begin(plan(false), 7, 1000 * MS);
    assert!(
        matches!(commands(effects)[..], [RecorderCommand::StartFreeTake { at_ns, .. }] if at_ns == 1000 * MS)
    );
    free.recorder(RecorderEvent::TakeStarted { take: "take-01".to_owned() });
    assert!(free.tick(1100 * MS, &standing(7, Phase::Armed)).is_empty());
    // The first target that moves a joint of the hand ends the span without touch, and no later one does.
    let [RecorderCommand::Span { kind: SpanKind::Baseline, start_ns, end_ns, .. }] =
        commands(free.moved(2000 * MS))[..]
    else {
        panic!("a span without touch")
    };
    assert_eq!((start_ns, end_ns), (1000 * MS, 2000 * MS));
    assert!(free.moved(2100 * MS).is_empty());

    let mark = |label: &str| (MarkKind::Repetition, label.to_owned());
    let begin = |label| TakeAction::BeginMark { kind: mark(label).0, label: mark(label).1 };
    let end = |label| TakeAction::EndMark { kind: mark(label).0, label: mark(label).1 };
    assert!(free.act(2200 * MS, &begin("grasp")).expect("a mark").is_empty());
    assert!(free.act(2200 * MS, &begin("grasp")).expect_err("the same").contains("begun already"));
    assert!(free.act(2300 * MS, &end("lift")).expect_err("another").contains("begin it first"));
    let spans = commands(free.act(2500 * MS, &end("grasp")).expect("its end"));
    assert!(matches!(&spans[..], [RecorderCommand::Span { label, .. }] if label == "grasp"));
    // What has not ended with the take ends there.
    free.act(2600 * MS, &begin("lift")).expect("a mark");
    let over = commands(free.act(3000 * MS, &TakeAction::End { set_aside: false }).expect("its end"));
    assert!(matches!(
        &over[..],
        [RecorderCommand::Span { end_ns, .. }, RecorderCommand::EndTake { broken_off }]
            if *end_ns == 3000 * MS && broken_off.is_empty()
    ));
    assert_eq!(free.view().state, FreeTakeState::Checking);
    assert_eq!(commands(free.recorder(ended(""))), [RecorderCommand::EndSession]);
    free.recorder(RecorderEvent::Accepted { take: "take-01".to_owned() });
    assert_eq!((free.view().state, free.is_over()), (FreeTakeState::Checking, false));
    free.recorder(RecorderEvent::SessionEnded);
    assert_eq!((free.view().state, free.is_over()), (FreeTakeState::Accepted, true));
    assert!(free.act(4000 * MS, &begin("late")).expect_err("it is over").contains("begin one first"));
}

#[test]
fn whatever_ends_control_or_stops_the_station_ends_the_take_once() {
    use Phase::{Armed, Arming, Disarmed, Disarming, Holding, Stopped};
    for (name, before, now, expected) in [
        ("given back", standing(7, Armed), standing(0, Disarming), "lease"),
        ("taken over", standing(7, Armed), standing(8, Armed), "lease"),
        ("stopped", standing(7, Armed), standing(7, Stopped), "the station stopped"),
        ("let go", standing(7, Armed), standing(7, Disarming), "the station stopped"),
        ("given back before it was armed", standing(7, Disarmed), standing(0, Disarmed), "lease"),
    ] {
        let (mut free, _) = Free::begin(plan(false), 7, 0);
        assert!(free.tick(5 * MS, &before).is_empty(), "{name}");
        let over = commands(free.tick(10 * MS, &now));
        let [RecorderCommand::EndTake { broken_off }] = &over[..] else { panic!("{name}: {over:?}") };
        assert!(broken_off.contains(expected), "{name}: {broken_off}");
        assert!(free.tick(15 * MS, &now).is_empty() && free.stop(20 * MS, "again").is_empty(), "{name}");
        assert!(free.view().problem.contains(expected), "{name}");
    }
    // A station that holds for a moment follows again; for longer than a second, nobody moves it.
    let (mut free, _) = Free::begin(plan(false), 7, 0);
    for (at_ms, phase) in
        [(0, Armed), (100, Holding), (1000, Holding), (1050, Armed), (1100, Holding), (2100, Holding)]
    {
        assert!(!commands(free.tick(at_ms * MS, &standing(7, phase))).iter().any(is_end), "{at_ms} ms");
    }
    assert!(commands(free.tick(2105 * MS, &standing(7, Holding))).iter().any(is_end));
    assert!(free.view().problem.contains("the station held"), "{:?}", free.view());
    // A station that is not armed can be recorded, e.g. while somebody moves the hand, and armed later.
    let (mut free, _) = Free::begin(plan(false), 7, 0);
    for phase in [Disarmed, Arming, Armed] {
        assert!(free.tick(1000 * MS, &standing(7, phase)).is_empty());
    }
    // What the recorder cannot write is lost, and the next take can begin.
    let over = commands(free.recorder(RecorderEvent::TakeLost { problem: "no space at all".to_owned() }));
    assert_eq!(over, [RecorderCommand::EndSession]);
    assert_eq!(free.view().state, FreeTakeState::Lost);
}

#[test]
fn what_is_not_wanted_is_set_aside() {
    let (mut free, _) = Free::begin(plan(true), 7, 0);
    // Its baseline is the client's.
    assert!(free.moved(1000 * MS).is_empty());
    free.act(2000 * MS, &TakeAction::End { set_aside: true }).expect("its end");
    let set_aside = RecorderCommand::SetAside { take: "take-01".to_owned() };
    assert_eq!(commands(free.recorder(ended(""))), [set_aside, RecorderCommand::EndSession]);
}

#[test]
fn a_hand_that_moves_at_once_has_no_span_without_touch() {
    let (mut free, _) = Free::begin(plan(false), 7, 0);
    assert!(free.moved(100 * MS).is_empty());
    assert!(free.moved(5000 * MS).is_empty());
}

#[test]
fn poses_are_of_the_take_and_increase() {
    let (mut free, _) = Free::begin(plan(false), 7, 1000 * MS);
    let pose = |time_s: f64| ObjectPose {
        position_m: vec![0.4, 0.0, 0.1],
        quaternion_wxyz: vec![1.0, 0.0, 0.0, 0.0],
        time_s,
    };
    let (at_ns, at) = free.pose(1200 * MS, 1190 * MS, &pose(0.0)).expect("now");
    assert_eq!((at_ns, at.translation.x), (1190 * MS, 0.4));
    assert_eq!(free.pose(1300 * MS, 1300 * MS, &pose(1.25)).expect("a time").0, 1250 * MS);
    for (wrong, expected) in [
        (pose(1.25), "not newer"),
        (pose(0.9), "before the take began"),
        (pose(2.0), "ahead of the station's time"),
        (pose(f64::NAN), "time_s is NaN"),
        (pose(-1.0), "time_s is -1"),
        (ObjectPose { position_m: vec![0.4], ..pose(0.0) }, "1 and 4 numbers"),
        (ObjectPose { position_m: vec![0.4, f64::NAN, 0.0], ..pose(0.0) }, "finite numbers"),
        (ObjectPose { quaternion_wxyz: vec![0.0; 4], ..pose(0.0) }, "quaternion of length 1"),
    ] {
        let said = free.pose(1400 * MS, 1400 * MS, &wrong).expect_err(expected);
        assert!(said.contains(expected), "{said}");
    }
}

//! What holds in whatever order things happen.

use palpate_wire::api::{RecordingAction, StepState};
use proptest::prelude::*;

use super::{Bench, LEASE, Place};
use crate::recorder::RecorderEvent;

/// Everything that operators, time and devices can do.
#[derive(Clone, Debug)]
enum Happening {
    Act(RecordingAction),
    Tick(f64),
    Answer,
    Arrived,
    MotionFailed,
    Tared(bool),
    Armed(bool),
    Lease(u64),
    Moved(f64),
    DiskFull,
    TakeLost,
    SaveFails,
    Touched,
}

fn happening() -> impl Strategy<Value = Happening> {
    let lease = prop_oneof![8 => Just(LEASE), 1 => Just(0), 1 => Just(8)];
    prop_oneof![
        3 => any::<bool>().prop_map(|fixture_trusted| Happening::Act(RecordingAction::ConfirmObject { fixture_trusted })),
        2 => Just(Happening::Act(RecordingAction::GoToStart)),
        6 => Just(Happening::Act(RecordingAction::Run)),
        1 => Just(Happening::Act(RecordingAction::Cancel)),
        4 => Just(Happening::Act(RecordingAction::Accept)),
        1 => Just(Happening::Act(RecordingAction::Again)),
        1 => Just(Happening::Act(RecordingAction::Discard)),
        2 => Just(Happening::Act(RecordingAction::Undo)),
        2 => (0_usize..5).prop_map(|step| Happening::Act(RecordingAction::Select { step })),
        1 => "[a ]{0,2}".prop_map(|text| Happening::Act(RecordingAction::Note { text })),
        8 => (0.0..6.0_f64).prop_map(Happening::Tick),
        12 => Just(Happening::Answer),
        4 => Just(Happening::Arrived),
        1 => Just(Happening::MotionFailed),
        6 => prop::bool::weighted(0.9).prop_map(Happening::Tared),
        2 => prop::bool::weighted(0.8).prop_map(Happening::Armed),
        1 => lease.prop_map(Happening::Lease),
        1 => prop_oneof![3 => Just(0.1), 1 => -1.0..1.0_f64, 1 => Just(f64::NAN)].prop_map(Happening::Moved),
        1 => Just(Happening::DiskFull),
        1 => Just(Happening::TakeLost),
        1 => Just(Happening::SaveFails),
        1 => Just(Happening::Touched),
    ]
}

impl Bench {
    fn happens(&mut self, happening: &Happening) {
        match happening {
            // A refusal is fine; what must not be asked of anybody is asserted where it would be.
            Happening::Act(action) => drop(self.act(action.clone())),
            Happening::Tick(seconds) => self.tick(*seconds),
            Happening::Answer => self.answer(),
            // Only what was begun can end.
            Happening::Arrived if self.moving => self.arrived(),
            Happening::MotionFailed if self.moving => {
                self.moving = false;
                let effects = self.guide.motion_failed(self.now_ns, "it got stuck");
                self.carry_out(effects);
            }
            Happening::Tared(good) if self.taring => {
                self.taring = false;
                let problems = if *good { vec![] } else { vec!["a board is silent".to_owned()] };
                let effects = self.guide.tared(self.now_ns, &problems);
                self.carry_out(effects);
            }
            Happening::Armed(armed) => self.armed = *armed,
            Happening::Lease(lease) => self.lease = *lease,
            Happening::Moved(position) => self.measured[0] = *position,
            Happening::DiskFull => {
                let found = self.takes.iter().find(|(_, (_, place))| *place == Place::Recording);
                if let Some(take) = found.map(|(take, _)| take.clone()) {
                    self.ended(&take, "the disk is full");
                }
            }
            Happening::TakeLost => {
                let found = self.takes.iter().find(|(_, (_, place))| *place == Place::Recording);
                if let Some(take) = found.map(|(take, _)| take.clone()) {
                    self.put(&take, Place::Discarded);
                    self.answers.push(RecorderEvent::TakeLost { problem: "it is lost".to_owned() });
                }
            }
            Happening::SaveFails => {
                // The newest decision could not be written, so that files are as before.
                let failed =
                    self.answers.iter().position(|event| matches!(event, RecorderEvent::Accepted { .. }));
                if let Some(event) = failed
                    && let RecorderEvent::Accepted { take } = self.answers.remove(event)
                {
                    self.put(&take, Place::Review);
                    self.answers.insert(event, RecorderEvent::Failed { problem: "no".to_owned() });
                }
            }
            Happening::Touched => self.guide.touched(&[true, false, true]),
            Happening::Arrived | Happening::MotionFailed | Happening::Tared(_) => {}
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn no_order_of_events_moves_unasked_or_loses_an_accepted_take(
        happenings in prop::collection::vec(happening(), 1..120),
    ) {
        let mut bench = Bench::new();
        for happening in &happenings {
            let before = (bench.session(), bench.guide.revision());
            bench.happens(happening);
            let session = bench.session();
            if session != before.0 {
                prop_assert!(bench.guide.revision() > before.1, "a change that no page would notice");
            }
            // Once everything is answered, the checklist says what is on disk.
            if bench.answers.is_empty() {
                for (step, shown) in session.steps.iter().enumerate() {
                    let place = shown.take.as_ref().and_then(|take| bench.takes.get(take));
                    let expected = match shown.state {
                        StepState::Open => None,
                        StepState::Accepted => Some(Place::Accepted),
                        StepState::Review if bench.guide.moves() && session.current == Some(step) => Some(Place::Recording),
                        StepState::Review => Some(Place::Review),
                    };
                    prop_assert_eq!(place.map(|(_, place)| *place), expected);
                    prop_assert!(place.is_none_or(|(of, _)| *of == step));
                    let accepted = bench.takes.values().filter(|(of, place)| *of == step && *place == Place::Accepted);
                    prop_assert_eq!(accepted.count(), usize::from(shown.state == StepState::Accepted));
                }
            }
            let _ = bench.guide.status(bench.now_ns);
        }
        // Whatever happened, the way back to a session that can be left is never closed.
        bench.lease = LEASE;
        bench.answer();
        if bench.guide.moves() {
            bench.act(RecordingAction::Cancel).expect("what moves can be cancelled");
            bench.answer();
        }
        prop_assert!(bench.act(RecordingAction::Leave).is_ok(), "{:?}", bench.session());
    }
}

use std::collections::BTreeMap;

use palpate_recording::{PlannedStep, SpanKind};
use palpate_wire::api::{RecordingSession, StepState};

use super::*;
use crate::recorder::RecorderEvent;

mod added;
mod laws;
mod leaving;

const S: u64 = 1_000_000_000;
const LEASE: u64 = 7;

fn plan() -> GuidePlan {
    let span = |kind, start_s, end_s| Span { kind, start_s, end_s, label: String::new() };
    let step = |object: &str, primitive: &str, touches: Vec<usize>| GuideStep {
        object: object.to_owned(),
        object_label: format!("The {object}"),
        base_from_object: Isometry3::translation(0.1, 0.0, 0.2),
        primitive: primitive.to_owned(),
        primitive_label: primitive.to_uppercase(),
        instruction: format!("Put the {object} on its stand."),
        start: vec![0.1, -0.5],
        duration_s: 4.0,
        spans: vec![span(SpanKind::Repetition, 1.0, 2.0), span(SpanKind::Repetition, 2.0, 3.5)],
        activities: vec![(0.0, "to tip".to_owned()), (1.0, "tap, tip".to_owned())],
        touches,
        added_because: None,
    };
    GuidePlan {
        id: "three".to_owned(),
        steps: vec![
            step("ball", "tap", vec![0]),
            step("ball", "roll", vec![1]),
            step("wedge", "tap", vec![2]),
        ],
        joints: vec![
            GuideJoint { name: "slide".to_owned(), near: 0.005, unit: "m" },
            GuideJoint { name: "curl".to_owned(), near: 0.05, unit: "rad" },
        ],
        channels: ["a", "b", "c"].map(str::to_owned).to_vec(),
        baseline_s: 1.0,
        countdown_s: 3.0,
        software: "tests".to_owned(),
    }
}

fn recording(takes: Vec<RecordedTake>) -> RecordingFile {
    let steps = plan().steps;
    let steps = steps.iter().map(|step| PlannedStep {
        object: step.object.clone(),
        primitive: step.primitive.clone(),
        added_because: step.added_because.clone(),
    });
    RecordingFile {
        format: 1,
        plan: "three".to_owned(),
        operator: "somebody".to_owned(),
        steps: steps.collect(),
        takes,
    }
}

fn verdict(covered: &[&str]) -> TakeVerdict {
    TakeVerdict {
        good: true,
        summary: "fine".to_owned(),
        problems: Vec::new(),
        covered: covered.iter().map(|&id| id.to_owned()).collect(),
        missed: Vec::new(),
        rates_hz: Vec::new(),
    }
}

/// Where a take is, as the recorder has it.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Place {
    Recording,
    Review,
    Accepted,
    Discarded,
}

/// A guide with everything around it: safety layer, motions, recorder.
struct Bench {
    guide: Guide,
    now_ns: u64,
    armed: bool,
    lease: u64,
    reason: String,
    measured: Vec<f64>,
    /// Takes by id, with their step.
    takes: BTreeMap<String, (usize, Place)>,
    /// What the recorder will answer.
    answers: Vec<RecorderEvent>,
    /// Whether the robot moves at the guide's wish.
    moving: bool,
    taring: bool,
    spans: Vec<SpanKind>,
    audit: Vec<String>,
}

impl Bench {
    fn new() -> Self {
        let (guide, effects) = Guide::new(plan(), "monday", &recording(Vec::new()), &[]);
        assert_eq!(effects, []);
        Self::around(guide)
    }

    fn around(guide: Guide) -> Self {
        Self {
            guide,
            now_ns: 50 * S,
            armed: true,
            lease: LEASE,
            reason: String::new(),
            measured: vec![0.1, -0.5],
            takes: BTreeMap::new(),
            answers: Vec::new(),
            moving: false,
            taring: false,
            spans: Vec::new(),
            audit: Vec::new(),
        }
    }

    fn act(&mut self, action: RecordingAction) -> Result<(), String> {
        let safety = Safety {
            armed: self.armed,
            lease: self.lease,
            reason: &self.reason,
            measured: Some(&self.measured),
        };
        let effects = self.guide.act(self.now_ns, &action, &safety)?;
        self.carry_out(effects);
        Ok(())
    }

    fn tick(&mut self, seconds: f64) {
        // In steps, as the control loop has it.
        for _ in 0..20 {
            self.now_ns += (seconds / 20.0 * 1e9) as u64;
            let safety = Safety {
                armed: self.armed,
                lease: self.lease,
                reason: &self.reason,
                measured: Some(&self.measured),
            };
            let effects = self.guide.tick(self.now_ns, &safety);
            self.carry_out(effects);
        }
    }

    /// Does what the control loop does, and refuses what must never be asked of it.
    fn carry_out(&mut self, effects: Vec<Effect>) {
        for effect in effects {
            match effect {
                Effect::MoveTo { lease, .. } | Effect::RunMotion { lease, .. } => {
                    assert!(self.armed && lease == self.lease, "moves without being allowed to");
                    assert!(!self.moving, "moves twice at once");
                    self.moving = true;
                }
                Effect::StopMotion => self.moving = false,
                Effect::Tare => self.taring = true,
                Effect::Audit(line) => self.audit.push(line),
                Effect::PlaceObject { .. } => {}
                Effect::Record(command) => self.record(command),
            }
        }
    }

    fn record(&mut self, command: RecorderCommand) {
        let recording = self.takes.iter().find(|(_, (_, place))| *place == Place::Recording);
        let recording = recording.map(|(take, _)| take.clone());
        let place_of = |bench: &Self, take: &str| bench.takes.get(take).map(|(_, place)| *place);
        match command {
            RecorderCommand::StartTake { step, meta, .. } => {
                assert_eq!(recording, None, "records two takes at once");
                let rival =
                    self.takes.values().find(|(other, place)| *other == step && *place == Place::Accepted);
                assert_eq!(rival, None, "records over an accepted take");
                assert_eq!(meta.object, self.guide.plan.steps[step].object);
                let take = format!("take-{:02}", self.takes.len() + 1);
                self.takes.insert(take.clone(), (step, Place::Recording));
                self.answers.push(RecorderEvent::TakeStarted { take });
            }
            RecorderCommand::StartFreeTake { .. } => panic!("a guided session records nothing but its steps"),
            RecorderCommand::EndTake { broken_off } => {
                // The recorder may have ended it by itself.
                if let Some(take) = recording {
                    self.ended(&take, &broken_off);
                }
            }
            RecorderCommand::Accept { take } => {
                assert_eq!(place_of(self, &take), Some(Place::Review));
                self.put(&take, Place::Accepted);
                self.answers.push(RecorderEvent::Accepted { take });
            }
            RecorderCommand::SetAside { take } => {
                assert!(matches!(place_of(self, &take), Some(Place::Review | Place::Accepted)));
                self.put(&take, Place::Discarded);
                self.answers.push(RecorderEvent::SetAside { take });
            }
            RecorderCommand::Restore { take } => {
                assert_eq!(place_of(self, &take), Some(Place::Discarded));
                self.put(&take, Place::Review);
                self.answers.push(RecorderEvent::Restored { take });
            }
            RecorderCommand::Check { take, .. } => {
                self.answers.push(RecorderEvent::Checked { take, verdict: verdict(&[]), readable: true });
            }
            RecorderCommand::Span { kind, start_ns, end_ns, .. } => {
                assert!(start_ns < end_ns);
                self.spans.push(kind);
            }
            RecorderCommand::Annotate { take, .. } => assert!(self.takes.contains_key(&take)),
            RecorderCommand::Note { .. }
            | RecorderCommand::Log { .. }
            | RecorderCommand::AddStep { .. }
            | RecorderCommand::RemoveStep { .. } => {}
            RecorderCommand::EndSession => {
                assert_eq!(recording, None, "leaves in the middle of a take");
                self.answers.push(RecorderEvent::SessionEnded);
            }
        }
    }

    fn ended(&mut self, take: &str, broken_off: &str) {
        let step = self.takes[take].0;
        self.put(take, Place::Review);
        let (take, channels) = (take.to_owned(), ["a", "b", "c"]);
        self.answers.push(RecorderEvent::TakeEnded { take: take.clone(), broken_off: broken_off.to_owned() });
        let touched = self.guide.plan.steps[step].touches[0];
        let verdict = verdict(&[channels[touched]]);
        self.answers.push(RecorderEvent::Checked { take, verdict, readable: true });
    }

    fn put(&mut self, take: &str, place: Place) {
        if let Some(entry) = self.takes.get_mut(take) {
            entry.1 = place;
        }
    }

    /// Lets the recorder answer.
    fn answer(&mut self) {
        for event in std::mem::take(&mut self.answers) {
            let effects = self.guide.recorder(event);
            self.carry_out(effects);
        }
    }

    fn tared(&mut self) {
        self.taring = false;
        let effects = self.guide.tared(self.now_ns, &[]);
        self.carry_out(effects);
    }

    fn arrived(&mut self) {
        self.moving = false;
        let effects = self.guide.arrived(self.now_ns);
        self.carry_out(effects);
    }

    /// From the object to the motion.
    fn run(&mut self) {
        self.act(RecordingAction::ConfirmObject { fixture_trusted: true }).expect("the object is confirmed");
        self.act(RecordingAction::Run).expect("the take is begun");
        self.answer();
        self.tared();
        self.tick(5.0);
        assert_eq!(self.phase(), RecordingPhase::Running);
    }

    /// A whole take, up to the review.
    fn take(&mut self) {
        self.run();
        self.arrived();
        assert_eq!(self.phase(), RecordingPhase::Checking);
        self.answer();
        assert_eq!(self.phase(), RecordingPhase::Review);
    }

    fn session(&self) -> RecordingSession {
        self.guide.session()
    }

    fn phase(&self) -> RecordingPhase {
        self.session().phase
    }

    fn states(&self) -> Vec<StepState> {
        self.session().steps.iter().map(|step| step.state).collect()
    }
}

#[test]
fn the_checklist_leads_through_every_step() {
    use StepState::{Accepted, Open};
    let mut bench = Bench::new();
    assert_eq!((bench.phase(), bench.session().current), (RecordingPhase::PlaceObject, Some(0)));
    assert_eq!(bench.session().untouched, ["a", "b", "c"]);
    bench.act(RecordingAction::ConfirmObject { fixture_trusted: true }).unwrap();
    assert_eq!(bench.phase(), RecordingPhase::StartPose);
    bench.measured = vec![0.3, 0.0];
    bench.act(RecordingAction::GoToStart).unwrap();
    assert_eq!(bench.phase(), RecordingPhase::GoingToStart);
    bench.arrived();
    bench.measured = vec![0.101, -0.49];
    bench.act(RecordingAction::Run).unwrap();
    bench.answer();
    assert!(bench.taring);
    assert_eq!(bench.guide.status(bench.now_ns).countdown_s, 4.0);
    bench.tared();
    bench.tick(0.5);
    assert_eq!(bench.phase(), RecordingPhase::Baseline);
    assert!((bench.guide.status(bench.now_ns).countdown_s - 3.5).abs() < 1e-3);
    bench.tick(1.0);
    assert_eq!(bench.phase(), RecordingPhase::Countdown);
    assert_eq!(bench.spans, [SpanKind::Baseline]);
    bench.guide.touched(&[true, false, false]);
    bench.tick(2.6);
    assert_eq!((bench.phase(), bench.moving), (RecordingPhase::Running, true));
    assert_eq!(bench.guide.status(bench.now_ns).covered, [0], "touches before the motion do not count");
    bench.guide.touched(&[false, true, false]);
    bench.tick(2.0);
    assert_eq!(bench.spans.len(), 2, "one repetition is over");
    let status = bench.guide.status(bench.now_ns);
    assert_eq!(
        (status.phase.as_str(), status.activity.as_str(), status.covered),
        ("running", "tap, tip", vec![2])
    );
    assert!(status.fraction >= 0.5 && status.fraction < 0.65, "{}", status.fraction);
    bench.arrived();
    assert_eq!(bench.spans.len(), 3);
    bench.answer();
    let session = bench.session();
    assert_eq!((session.phase, session.steps[0].take.as_deref()), (RecordingPhase::Review, Some("take-01")));
    assert_eq!(session.steps[0].verdict, Some(verdict(&["a"])));
    assert_eq!(session.untouched, ["a", "b", "c"], "not accepted yet");
    bench.act(RecordingAction::Accept).unwrap();
    assert_eq!(bench.states()[0], StepState::Review, "not before it is on disk");
    bench.answer();
    assert_eq!((bench.session().current, bench.states()), (Some(1), vec![Accepted, Open, Open]));
    assert_eq!(bench.session().untouched, ["b", "c"]);
    for _ in 1..3 {
        bench.take();
        bench.act(RecordingAction::Accept).unwrap();
        bench.answer();
    }
    let session = bench.session();
    assert_eq!((session.phase, session.current, session.untouched.len()), (RecordingPhase::Done, None, 0));
    bench.act(RecordingAction::Leave).unwrap();
    bench.answer();
    assert!(bench.guide.finished());
    assert!(bench.act(RecordingAction::Undo).unwrap_err().contains("the session was left"));
}

#[test]
fn what_is_not_possible_now_is_refused_with_what_is() {
    let mut bench = Bench::new();
    let run = RecordingAction::Run;
    let refused = |bench: &mut Bench, action: RecordingAction, expected: &str| {
        let before = (bench.session(), bench.guide.revision());
        let problem = bench.act(action).unwrap_err();
        assert!(problem.contains(expected), "{problem}\nlacks\n{expected}");
        assert_eq!((bench.session(), bench.guide.revision()), before);
    };
    refused(&mut bench, run.clone(), "confirm first that the object is in place");
    refused(&mut bench, RecordingAction::Accept, "confirm first");
    refused(&mut bench, RecordingAction::Cancel, "nothing is under way");
    refused(&mut bench, RecordingAction::Undo, "nothing was discarded");
    refused(&mut bench, RecordingAction::Select { step: 3 }, "no step 4, the plan has 3");
    refused(&mut bench, RecordingAction::Note { text: "x".to_owned() }, "a note belongs to a take");
    bench.act(RecordingAction::ConfirmObject { fixture_trusted: false }).unwrap();
    bench.lease = 0;
    refused(&mut bench, RecordingAction::Run, "take control first");
    refused(&mut bench, RecordingAction::GoToStart, "take control first");
    bench.lease = LEASE;
    bench.armed = false;
    refused(&mut bench, run.clone(), "not armed; arm it first");
    bench.reason = "stopped by somebody".to_owned();
    refused(&mut bench, RecordingAction::GoToStart, "does not follow commands: stopped by somebody");
    bench.armed = true;
    bench.measured = vec![0.1, -0.3];
    refused(
        &mut bench,
        run.clone(),
        "joint \"curl\" is 0.200 rad from its start position; go to the start pose first",
    );
    bench.measured = vec![f64::NAN, -0.5];
    refused(&mut bench, run.clone(), "joint \"slide\" is NaN m from its start position");
    bench.measured = vec![0.1, -0.5];
    bench.act(run.clone()).unwrap();
    refused(&mut bench, run, "a take is being recorded; wait for its end, or cancel");
    refused(&mut bench, RecordingAction::Select { step: 1 }, "a take is being recorded");
    refused(&mut bench, RecordingAction::Leave, "a take is being recorded");
    bench.act(RecordingAction::Note { text: " squeaks ".to_owned() }).unwrap();
    bench.act(RecordingAction::Cancel).unwrap();
    refused(&mut bench, RecordingAction::Accept, "the take is being checked");
    bench.answer();
    bench.act(RecordingAction::Note { text: "again".to_owned() }).unwrap();
    refused(&mut bench, RecordingAction::Note { text: " ".to_owned() }, "write something");
    bench.act(RecordingAction::Accept).unwrap();
    refused(&mut bench, RecordingAction::Discard, "still being written");
    bench.answer();
    bench.act(RecordingAction::Select { step: 0 }).unwrap();
    refused(&mut bench, RecordingAction::Accept, "accepted already");
}

/// Whatever stops the motion, the take is kept, and the reason is said.
#[test]
fn a_motion_that_is_stopped_leaves_a_take_with_the_reason() {
    type Stop = (&'static str, fn(&mut Bench), &'static str);
    let stops: [Stop; 8] = [
        (
            "cancelled",
            |bench| bench.act(RecordingAction::Cancel).expect("cancels"),
            "the operator stopped it",
        ),
        (
            "stopped",
            |bench| {
                bench.armed = false;
                bench.reason = "the page of somebody is gone; arm again".to_owned();
                bench.tick(0.01);
            },
            "the station stopped: the page of somebody is gone",
        ),
        (
            "lease lost",
            |bench| {
                bench.lease = 0;
                bench.tick(0.01);
            },
            "the lease was given back or taken over",
        ),
        (
            "lease taken over",
            |bench| {
                bench.lease = 8;
                bench.tick(0.01);
            },
            "the lease was given back or taken over",
        ),
        (
            "motion fails",
            |bench| {
                let effects = bench.guide.motion_failed(bench.now_ns, "joint \"curl\" does not follow");
                bench.carry_out(effects);
            },
            "joint \"curl\" does not follow",
        ),
        ("never ends", |bench| bench.tick(20.0), "did not come to its end in time"),
        ("disk full", |bench| bench.ended("take-01", "the disk is nearly full"), "the disk is nearly full"),
        (
            "recorder gone",
            |bench| {
                bench.put("take-01", Place::Discarded);
                bench.answers.push(RecorderEvent::TakeLost { problem: "no space at all".to_owned() });
            },
            "no space at all",
        ),
    ];
    for (name, stop, expected) in stops {
        let mut bench = Bench::new();
        bench.run();
        stop(&mut bench);
        bench.answer();
        assert!(!bench.moving, "{name}");
        let session = bench.session();
        assert!(session.problem.contains(expected), "{name}: {:?}", session.problem);
        assert!(!bench.takes.values().any(|(_, place)| *place == Place::Recording), "{name}");
        let kept = if name == "recorder gone" { None } else { Some("take-01") };
        assert_eq!(session.steps[0].take.as_deref(), kept, "{name}");
        let phase = if kept.is_some() { RecordingPhase::Review } else { RecordingPhase::StartPose };
        assert_eq!(session.phase, phase, "{name}");
    }
    // Before the motion there is a take already; on the way to the start there is none.
    for stage in 0..3 {
        let mut bench = Bench::new();
        bench.act(RecordingAction::ConfirmObject { fixture_trusted: true }).unwrap();
        bench.act(RecordingAction::Run).unwrap();
        bench.answer();
        if stage > 0 {
            bench.tared();
        }
        if stage > 1 {
            bench.tick(1.5);
        }
        bench.armed = false;
        bench.tick(0.01);
        bench.answer();
        assert_eq!(bench.phase(), RecordingPhase::Review, "stage {stage}");
        assert!(bench.session().problem.contains("not armed any more"), "stage {stage}");
    }
    let mut bench = Bench::new();
    bench.act(RecordingAction::ConfirmObject { fixture_trusted: true }).unwrap();
    bench.act(RecordingAction::GoToStart).unwrap();
    bench.lease = 0;
    bench.tick(0.01);
    assert_eq!((bench.phase(), bench.moving), (RecordingPhase::StartPose, false));
    assert!(bench.session().problem.contains("the lease was given back"));
    assert!(bench.takes.is_empty());
}

#[test]
fn a_robot_that_is_pushed_away_before_the_motion_does_not_jump() {
    let mut bench = Bench::new();
    bench.act(RecordingAction::ConfirmObject { fixture_trusted: true }).unwrap();
    bench.act(RecordingAction::Run).unwrap();
    bench.answer();
    bench.tared();
    bench.tick(2.0);
    bench.measured = vec![0.1, 0.5];
    bench.tick(3.0);
    bench.answer();
    assert!(
        bench.session().problem.contains("joint \"curl\" is 1.000 rad from its start"),
        "{:?}",
        bench.session()
    );
    assert_eq!((bench.phase(), bench.moving), (RecordingPhase::Review, false));
}

#[test]
fn a_tare_that_fails_or_never_ends_stops_the_take() {
    for problems in [Some(vec!["board twintac1 is silent; check its cable".to_owned()]), None] {
        let mut bench = Bench::new();
        bench.act(RecordingAction::ConfirmObject { fixture_trusted: true }).unwrap();
        bench.act(RecordingAction::Run).unwrap();
        bench.answer();
        let expected = match problems {
            Some(problems) => {
                let effects = bench.guide.tared(bench.now_ns, &problems);
                bench.carry_out(effects);
                "board twintac1 is silent"
            }
            None => {
                bench.tick(6.0);
                "was not captured; check the boards"
            }
        };
        bench.answer();
        assert!(bench.session().problem.contains(expected), "{:?}", bench.session().problem);
        assert_eq!(bench.phase(), RecordingPhase::Review);
    }
}

#[test]
fn takes_are_recorded_again_discarded_and_taken_back() {
    use StepState::{Accepted, Open, Review};
    let mut bench = Bench::new();
    bench.take();
    bench.act(RecordingAction::Again).unwrap();
    bench.answer();
    assert_eq!((bench.session().current, bench.phase()), (Some(0), RecordingPhase::PlaceObject));
    assert!(bench.session().can_undo);
    bench.take();
    assert!(!bench.session().can_undo);
    assert!(bench.act(RecordingAction::Undo).unwrap_err().contains("step 1 has a newer take, take-02"));
    bench.act(RecordingAction::Discard).unwrap();
    bench.answer();
    assert_eq!((bench.session().current, bench.states()), (Some(1), vec![Open; 3]));
    bench.act(RecordingAction::Undo).unwrap();
    bench.answer();
    let session = bench.session();
    assert_eq!((session.current, session.phase), (Some(0), RecordingPhase::Review));
    assert_eq!((session.steps[0].take.as_deref(), session.can_undo), (Some("take-02"), false));
    bench.act(RecordingAction::Accept).unwrap();
    bench.answer();
    // An accepted one too, by an action of its own; it comes back for review.
    bench.act(RecordingAction::Select { step: 0 }).unwrap();
    assert_eq!((bench.phase(), bench.states()[0]), (RecordingPhase::Review, Accepted));
    bench.act(RecordingAction::Discard).unwrap();
    bench.answer();
    bench.act(RecordingAction::Undo).unwrap();
    bench.answer();
    assert_eq!(bench.states(), [Review, Open, Open]);
}

#[test]
fn a_failed_decision_leaves_the_take_where_it_is() {
    let mut bench = Bench::new();
    bench.take();
    bench.act(RecordingAction::Accept).unwrap();
    bench.put("take-01", Place::Review);
    bench.answers =
        vec![RecorderEvent::Failed { problem: "failed to write recording.toml: disk full".to_owned() }];
    bench.answer();
    let session = bench.session();
    assert_eq!((session.phase, bench.states()[0]), (RecordingPhase::Review, StepState::Review));
    assert!(session.problem.contains("disk full"));
    bench.act(RecordingAction::Accept).unwrap();
    bench.answer();
    assert_eq!((bench.states()[0], bench.session().problem.as_str()), (StepState::Accepted, ""));
}

#[test]
fn a_take_that_cannot_be_read_is_not_accepted() {
    let mut bench = Bench::new();
    bench.run();
    bench.act(RecordingAction::Cancel).unwrap();
    if let Some(RecorderEvent::Checked { readable, .. }) = bench.answers.last_mut() {
        *readable = false;
    }
    bench.answer();
    assert!(bench.act(RecordingAction::Accept).unwrap_err().contains("cannot be read back"));
    bench.act(RecordingAction::Again).unwrap();
}

#[test]
fn a_session_goes_on_where_it_stood() {
    let take = |file: &str, step, state, verdict| RecordedTake {
        file: file.to_owned(),
        step,
        state,
        broken_off: String::new(),
        readable: Some(true),
        set_aside: u32::from(state == TakeState::Discarded),
        notes: Vec::new(),
        verdict,
    };
    let recording = recording(vec![
        take("take-01.mcap", 0, TakeState::Accepted, Some(verdict(&["a"]))),
        take("take-02.mcap", 2, TakeState::Discarded, Some(verdict(&["c"]))),
        take("take-03-recovered.mcap", 1, TakeState::Review, None),
    ]);
    let (guide, effects) =
        Guide::new(plan(), "monday", &recording, &["take-03 was being recorded".to_owned()]);
    let check = RecorderCommand::Check { take: "take-03-recovered".to_owned(), planned: vec![1] };
    assert_eq!(effects, [Effect::Record(check)]);
    let mut bench = Bench::around(guide);
    for (take, step, place) in [
        ("take-01", 0, Place::Accepted),
        ("take-02", 2, Place::Discarded),
        ("take-03-recovered", 1, Place::Review),
    ] {
        bench.takes.insert(take.to_owned(), (step, place));
    }
    let session = bench.session();
    assert_eq!((session.current, session.phase), (Some(1), RecordingPhase::Checking));
    assert_eq!(
        (session.operator.as_str(), session.problem.as_str()),
        ("somebody", "take-03 was being recorded")
    );
    assert_eq!((session.untouched.len(), session.can_undo), (2, false));
    assert!(bench.act(RecordingAction::Accept).unwrap_err().contains("being checked"));
    bench.carry_out(effects);
    bench.answer();
    assert!(bench.phase() == RecordingPhase::Review && bench.session().can_undo);
    bench.act(RecordingAction::Accept).unwrap();
    bench.answer();
    bench.act(RecordingAction::Undo).unwrap();
    bench.answer();
    bench.act(RecordingAction::Accept).unwrap();
    bench.answer();
    assert_eq!(bench.phase(), RecordingPhase::Done);
}

//! Guided recording as an operator meets it: before a session, every phase of a take, review, and the end.

use egui::{Key, accesskit::Role};
use egui_kittest::kittest::Queryable as _;
use palpate_messages::bits;
use palpate_reports::TakeVerdict;
use palpate_ui::{
    api_client::{ApiEvent, Request},
    route::Screen,
};
use palpate_wire::{
    api::{
        FreeTake, FreeTakeState, PlanSummary, RecordingAction, RecordingDocument, RecordingPhase,
        RecordingSession, RecordingStep, StartRecording, StepState, TakeAction, WantedTake,
    },
    proto::{RecordingStatus, control_request::Request as Command, control_state::Phase},
};

use crate::{
    fixture::{FakeWindow, SharedApi, app, deliver, page},
    live::Bench,
};

fn step(object: &str, primitive: &str, state: StepState) -> RecordingStep {
    RecordingStep {
        object: object.to_lowercase(),
        object_label: object.to_owned(),
        primitive: primitive.to_lowercase(),
        primitive_label: primitive.to_owned(),
        instruction: "Place the sphere on fixture A, flat side to the arm".to_owned(),
        object_pose: vec![0.12, -0.03, 0.25, 1.0, 0.0, 0.0, 0.0],
        start: Vec::new(),
        touches: vec!["index_tip_0".to_owned()],
        duration_s: 20.0,
        added_because: None,
        state,
        take: None,
        verdict: None,
    }
}

/// A session of two takes whose second waits in `phase`.
pub(crate) fn document(phase: RecordingPhase) -> RecordingDocument {
    let mut slide = step("Cylinder", "Slide", StepState::Open);
    if phase == RecordingPhase::Review {
        slide.state = StepState::Review;
        slide.verdict = Some(verdict(true));
    }
    let session = RecordingSession {
        session: "monday".to_owned(),
        plan: "nine_takes".to_owned(),
        operator: "Ada".to_owned(),
        steps: vec![step("Sphere", "Tap", StepState::Accepted), slide],
        current: (phase != RecordingPhase::Done).then_some(1),
        phase,
        problem: String::new(),
        untouched: Vec::new(),
        can_undo: false,
    };
    RecordingDocument { revision: 7, plans: plans(), wanted: Vec::new(), session: Some(session), free: None }
}

pub(crate) fn plans() -> Vec<PlanSummary> {
    vec![PlanSummary {
        id: "nine_takes".to_owned(),
        label: "Nine takes".to_owned(),
        takes: 9,
        duration_s: 325.0,
    }]
}

pub(crate) fn verdict(good: bool) -> TakeVerdict {
    TakeVerdict {
        good,
        summary: "Two of three channels were touched.".to_owned(),
        problems: vec!["FSR came at 31 Hz: close other programs that use the port".to_owned()],
        covered: Vec::new(),
        missed: Vec::new(),
        rates_hz: vec![("joints".to_owned(), 99.9)],
    }
}

/// The page in `phase`, with control and armed.
fn armed(phase: RecordingPhase) -> Bench {
    in_control(&document(phase))
}

/// The page on `document`, with control and armed.
pub(crate) fn in_control(document: &RecordingDocument) -> Bench {
    let mut bench = Bench::new("#/record", document);
    bench.take_control_and_arm();
    bench.api.0.borrow_mut().sent.clear();
    bench
}

/// What was done with the recording since the last call.
pub(crate) fn acts(bench: &Bench) -> Vec<RecordingAction> {
    let sent = std::mem::take(&mut bench.api.0.borrow_mut().sent);
    let act = |request| match request {
        Request::ActOnRecording(action) => Some(action),
        _ => None,
    };
    sent.into_iter().filter_map(act).collect()
}

pub(crate) fn key(bench: &mut Bench, key: Key) {
    bench.harness.key_press(key);
    bench.harness.run_steps(3);
}

#[test]
fn a_server_without_a_station_teaches_how_to_have_one() {
    let harness = page(&SharedApi::default(), &FakeWindow::at("#/record"));
    harness.get_by_label("No live station");
    harness.get_by_label_contains("palpate serve --station FILE");
    assert!(harness.query_by_role_and_label(Role::Button, "Record").is_none());
}

#[test]
fn a_session_starts_under_a_free_name() {
    let empty =
        RecordingDocument { revision: 1, plans: plans(), wanted: Vec::new(), session: None, free: None };
    let mut bench = Bench::new("#/record", &empty);
    bench.harness.get_by_label("9 takes, at least 5 min 25 s of motion");
    bench.take_control_and_arm();
    bench.click("Start session");
    let wanted = StartRecording {
        plan: "nine_takes".to_owned(),
        session: "nine_takes-1".to_owned(),
        operator: "Ada".to_owned(),
        only_wanted: false,
    };
    assert!(bench.api.0.borrow().sent.contains(&Request::StartRecording(wanted)));
    bench.harness.run_steps(3);
    bench.harness.get_by_label_contains("The session did not start: nothing at POST /api/v1/recording");
}

#[test]
fn a_station_without_a_plan_says_how_to_give_it_one() {
    let mut bench = Bench::at("#/record");
    bench.harness.run_steps(2);
    bench.harness.get_by_label("This station has no plan");
    assert!(bench.harness.query_by_label("Start session").is_none());
}

#[test]
fn the_start_of_a_session_fits_a_phone() {
    let empty =
        RecordingDocument { revision: 1, plans: plans(), wanted: Vec::new(), session: None, free: None };
    let bench = Bench::of(FakeWindow::at("#/record"), &empty, [390.0, 844.0]);
    let rail = bench.harness.get_by_role_and_label(Role::Button, "Record").rect();
    let text = bench.harness.get_by_label_contains("A plan is a list of takes");
    let plan = bench.harness.get_by_role_and_label(Role::ComboBox, "Plan");
    let field = bench.harness.get_by_role_and_label(Role::TextInput, "Session name");
    let look = bench.harness.get_by_role_and_label(Role::Button, "Look at the plan");
    for rect in [text, plan, look, field].map(|node| node.rect()) {
        assert!(rect.left() > rail.right() && rect.right() < 390.0, "{rect:?} beside {rail:?}");
    }
}

/// Nothing is recorded but this take outside guided sessions.
fn free(state: Option<FreeTakeState>) -> RecordingDocument {
    let free = state.map(|state| FreeTake {
        session: "by-hand-1".into(),
        take: Some("take-02".into()),
        object: "sphere_50mm".into(),
        primitive: "free".into(),
        state,
        problem: String::new(),
        verdict: None,
    });
    RecordingDocument { revision: 1, plans: plans(), wanted: Vec::new(), session: None, free }
}

#[test]
fn a_take_of_what_one_does_now_begins_and_ends_by_whoever_has_control() {
    const TITLE: &str = "Record a take of what you do now";
    for size in [[390.0, 844.0], [1280.0, 800.0]] {
        let mut bench = Bench::of(FakeWindow::of("Ada", "#/record"), &free(None), size);
        bench.harness.get_by_label(TITLE).click();
        bench.harness.run_steps(20);
        bench.harness.get_by_label_contains("Take control to record a take");
        assert!(bench.harness.query_by_label("Start recording").is_none());
        // The bar's own button is folded away on a phone.
        bench.click("Take control to go on");
        bench.reply(4, "");
        bench.state.holder = "Ada".to_owned();
        bench.phase(Phase::Armed);
        if let Some(folder) = std::env::var_os("PALPATE_ARTIFACTS") {
            let picture = bench.harness.render().expect("it is painted on the CPU");
            let path = std::path::PathBuf::from(folder).join(format!("free_{}.png", size[0]));
            picture.save(path).expect("the folder can be written");
        }
        for field in ["x", "turned"] {
            let rect = bench.harness.get_by_role_and_label(Role::SpinButton, field).rect();
            assert!(rect.right() <= size[0], "{field}: {rect:?}");
        }
        bench.harness.get_by_role_and_label(Role::Button, "Start recording").scroll_to_me();
        bench.harness.run_steps(5);
        bench.click("Start recording");
        let sent = bench.api.0.borrow().sent.clone();
        let started = sent.iter().find_map(|request| match request {
            Request::StartTake(start) => Some(start.clone()),
            _ => None,
        });
        let started = started.expect("a take begins");
        assert_eq!((started.session.as_str(), started.operator.as_str()), ("by-hand-1", "Ada"));
        assert_eq!(started.object_pose, [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
        assert!(!started.fixture_trusted && bench.station.objects.contains_key(&started.object));
        bench.harness.run_steps(3);
        // The made-up server refuses, and its words are on the page.
        bench.harness.get_by_label_contains("nothing at POST /api/v1/recording/take");
    }

    // Everybody sees it; whoever has control ends it.
    let mut bench = Bench::new("#/record", &free(Some(FreeTakeState::Recording)));
    bench.harness.get_by_label_contains("Recording take-02 of by-hand-1: free on sphere_50mm");
    assert!(bench.harness.query_by_label("Stop recording").is_none());
    bench.take_control_and_arm();
    bench.harness.get_by_role_and_label(Role::Button, "Stop and set aside").scroll_to_me();
    bench.harness.run_steps(5);
    bench.click("Stop and set aside");
    let ended = Request::ActOnTake(TakeAction::End { set_aside: true });
    assert!(bench.api.0.borrow().sent.contains(&ended));
    // Once it is over, every page looks for it in its session.
    bench.api.0.borrow_mut().sent.clear();
    let over = RecordingDocument { revision: 2, ..free(Some(FreeTakeState::SetAside)) };
    bench
        .api
        .0
        .borrow_mut()
        .answer(&Request::Recording, serde_json::to_vec(&over).expect("it is plain data"));
    bench.state.recording = Some(RecordingStatus { revision: 2, ..Default::default() });
    bench.tell();
    bench.harness.get_by_label_contains("take-02 of by-hand-1 was set aside.");
    assert!(bench.api.0.borrow().sent.contains(&Request::Sessions));
    let bench = Bench::new("#/record", &free(Some(FreeTakeState::Accepted)));
    bench.harness.get_by_label_contains("take-02 is part of session by-hand-1.");
    bench.harness.get_by_role_and_label(Role::Button, "Look at take-02");
}

#[test]
fn the_checklist_says_where_each_take_stands_and_leads_there() {
    let mut bench = armed(RecordingPhase::PlaceObject);
    bench.harness.get_by_label("Take 2: Slide, Cylinder, now");
    bench.click("Take 1: Tap, Sphere, accepted");
    assert_eq!(acts(&bench), [RecordingAction::Select { step: 0 }]);
    bench.click("Leave session");
    assert_eq!(acts(&bench), [RecordingAction::Leave]);
}

#[test]
fn every_phase_says_what_to_do_and_has_one_primary_button() {
    let phases = [
        (
            RecordingPhase::PlaceObject,
            "Place the sphere on fixture A, flat side to the arm",
            Some("Object is in place"),
        ),
        (RecordingPhase::StartPose, "Bring the robot to its start", Some("Go to start pose")),
        (RecordingPhase::GoingToStart, "The robot goes to the start pose", None),
        (RecordingPhase::Baseline, "Touch nothing", None),
        (RecordingPhase::Countdown, "Starts in 0 s", None),
        (RecordingPhase::Running, "Recording", None),
        (RecordingPhase::Checking, "Checking the take", None),
        (RecordingPhase::Review, "\u{2714} Good take", Some("Accept")),
        (RecordingPhase::Done, "\u{2714} Every take is recorded", None),
    ];
    for (phase, says, primary) in phases {
        let bench = armed(phase);
        bench.harness.get_by_label(says);
        let shown = ["Object is in place", "Go to start pose", "Accept"]
            .into_iter()
            .filter(|name| bench.harness.query_by_role_and_label(Role::Button, name).is_some());
        assert_eq!(shown.collect::<Vec<_>>(), primary.into_iter().collect::<Vec<_>>(), "{phase:?}");
        if let Some(name) = primary {
            assert!(bench.can(name), "{phase:?}");
            assert!(bench.harness.get_by_role_and_label(Role::Button, name).rect().height() >= 60.0);
        }
    }
}

#[test]
fn the_object_is_confirmed_with_what_is_known_of_its_place() {
    let mut bench = armed(RecordingPhase::PlaceObject);
    key(&mut bench, Key::Enter);
    assert_eq!(acts(&bench), [RecordingAction::ConfirmObject { fixture_trusted: true }]);
    bench.harness.get_by_role_and_label(Role::CheckBox, "The fixture holds it where the plan says").click();
    bench.harness.run_steps(3);
    bench.click("Object is in place");
    assert_eq!(acts(&bench), [RecordingAction::ConfirmObject { fixture_trusted: false }]);
}

#[test]
fn where_the_object_goes_is_a_picture_and_numbers_until_the_motion_begins() {
    let mut document = document(RecordingPhase::PlaceObject);
    let station = Bench::at("#/record").station;
    let num_dofs = station.robot.num_dofs();
    let object = station.objects.keys().next().expect("an object").clone();
    let names = ["3-D view of the hand", "x +120 mm, y -30 mm, z +250 mm from the robot's base"];
    for (phase, is_shown) in [
        (RecordingPhase::PlaceObject, true),
        (RecordingPhase::StartPose, true),
        (RecordingPhase::Running, false),
    ] {
        let session = document.session.as_mut().expect("a session");
        session.phase = phase;
        session.steps[1].start = vec![0.0; num_dofs];
        session.steps[1].object.clone_from(&object);
        let bench = in_control(&document);
        for name in names {
            assert_eq!(bench.harness.query_by_label_contains(name).is_some(), is_shown, "{phase:?}: {name}");
        }
    }
    // Another station's checklist has no picture, and all the rest.
    let session = document.session.as_mut().expect("a session");
    session.phase = RecordingPhase::PlaceObject;
    session.steps[1].start.push(0.0);
    let bench = in_control(&document);
    assert!(names.iter().all(|name| bench.harness.query_by_label_contains(name).is_none()));
    bench.harness.get_by_label_contains("Place the sphere on fixture A");
}

#[test]
fn what_moves_waits_for_control_and_arming() {
    let mut bench = Bench::new("#/record", &document(RecordingPhase::StartPose));
    bench.api.0.borrow_mut().sent.clear();
    bench.harness.get_by_label("Take control, then arm.");
    assert!(!bench.can("Go to start pose") && !bench.can("Run"));
    key(&mut bench, Key::Enter);
    assert!(acts(&bench).is_empty() && bench.commands().is_empty(), "a key neither acts nor takes control");
    bench.take_control_and_arm();
    bench.phase(Phase::Disarmed);
    bench.harness.get_by_label("The motors are off: arm the station.");
    key(&mut bench, Key::Enter);
    assert!(acts(&bench).is_empty() && bench.commands().is_empty(), "nor does it switch motors on");
    bench.click("Arm the station");
    assert!(matches!(bench.commands()[..], [(4, Command::Arm(_))]));
    bench.phase(Phase::Armed);
    bench.click("Go to start pose");
    assert_eq!(acts(&bench), [RecordingAction::GoToStart]);
}

#[test]
fn stopped_station_is_reset_by_the_primary_button_and_not_by_a_key() {
    let mut bench = in_control(&document(RecordingPhase::StartPose));
    bench.phase(Phase::Stopped);
    bench.commands();
    key(&mut bench, Key::Enter);
    assert!(acts(&bench).is_empty() && bench.commands().is_empty());
    bench.click("Reset the stop");
    assert!(matches!(bench.commands()[..], [(4, Command::ResetStop(_))]));
    bench.phase(Phase::Disarmed);
    assert!(bench.can("Arm the station"), "the motors stay off until they are switched on");
}

#[test]
fn checklist_tells_how_much_motion_is_left() {
    let bench = in_control(&document(RecordingPhase::PlaceObject));
    let document = document(RecordingPhase::PlaceObject);
    let steps = document.session.expect("a session").steps;
    let left_s: f64 =
        steps.iter().filter(|step| step.state != StepState::Accepted).map(|step| step.duration_s).sum();
    assert!(left_s > 0.0 && left_s < 60.0, "the words below are for less than a minute");
    bench.harness.get_by_label(&format!("about {left_s:.1} s of motion left"));
}

#[test]
fn once_it_went_to_the_start_the_primary_button_runs() {
    let mut bench = armed(RecordingPhase::StartPose);
    let status = |phase: &str| RecordingStatus { revision: 7, phase: phase.to_owned(), ..Default::default() };
    bench.state.recording = Some(status("going_to_start"));
    bench.tell();
    bench.harness.get_by_label("The robot goes to the start pose");
    bench.state.recording = Some(status("start_pose"));
    bench.tell();
    bench.harness.get_by_label("Ready to run");
    key(&mut bench, Key::Enter);
    assert_eq!(acts(&bench), [RecordingAction::Run]);
    // The made-up server refuses: whatever the robot lacks, going to its start is the next thing to try.
    bench.harness.get_by_label("Bring the robot to its start");
}

#[test]
fn a_way_to_the_start_that_was_called_off_does_not_count() {
    let mut bench = armed(RecordingPhase::StartPose);
    let status = |phase: &str| RecordingStatus { revision: 7, phase: phase.to_owned(), ..Default::default() };
    let same = serde_json::to_vec(&document(RecordingPhase::StartPose)).expect("it serialises");
    bench.api.0.borrow_mut().answer(&Request::ActOnRecording(RecordingAction::Cancel), same);
    bench.state.recording = Some(status("going_to_start"));
    bench.tell();
    bench.click("Cancel");
    assert_eq!(acts(&bench), [RecordingAction::Cancel]);
    bench.tell();
    bench.state.recording = Some(status("start_pose"));
    bench.tell();
    assert!(bench.can("Go to start pose") && bench.harness.query_by_label("Ready to run").is_none());
}

#[test]
fn the_countdown_can_be_read_from_two_metres() {
    let mut bench = armed(RecordingPhase::Countdown);
    bench.state.recording = Some(RecordingStatus {
        revision: 7,
        phase: "countdown".to_owned(),
        countdown_s: 2.4,
        ..Default::default()
    });
    bench.tell();
    // The baseline is part of the wait, so its seconds count as well.
    if let Some(status) = &mut bench.state.recording {
        status.phase = "baseline".to_owned();
    }
    bench.tell();
    bench.harness.get_by_label("Touch nothing");
    bench.harness.get_by_label("Starts in 3 s");
    if let Some(status) = &mut bench.state.recording {
        status.phase = "countdown".to_owned();
    }
    bench.tell();
    let digits = bench.harness.get_by_label("Starts in 3 s").rect();
    assert!(digits.height() > 200.0, "{digits:?}");
    assert!(digits.bottom() < 700.0, "it is on the screen at once: {digits:?}");
}

#[test]
fn a_running_take_shows_progress_coverage_and_losses_and_takes_notes() {
    let mut bench = armed(RecordingPhase::Running);
    let channels = bench.station.layout.num_channels();
    bench.state.recording = Some(RecordingStatus {
        revision: 7,
        phase: "running".to_owned(),
        fraction: 0.25,
        elapsed_s: 9.0,
        covered: bits::pack((0..channels).map(|channel| channel < 3)),
        activity: "slide, index tip".to_owned(),
        lost_samples: 5,
        free_bytes: 1_000_000_000,
        ..Default::default()
    });
    bench.tell();
    bench.harness.get_by_label("Slide, index tip");
    bench.harness.get_by_label_contains("5 samples lost");
    bench.harness.get_by_label_contains("make room");
    bench.harness.get_by_label_contains("3 channels in this take");
    bench.harness.get_by_label("Index tip \u{b7} 0: touched in this take");
    key(&mut bench, Key::M);
    assert_eq!(acts(&bench), [RecordingAction::Note { text: String::new() }]);
    bench.harness.get_by_label("Note").focus();
    bench.harness.run_steps(2);
    bench.harness.event(egui::Event::Text("slipped".into()));
    key(&mut bench, Key::Space);
    assert!(bench.commands().is_empty(), "a remark may hold spaces");
    bench.click("Add note");
    let noted = acts(&bench);
    assert!(matches!(&noted[..], [RecordingAction::Note { text }] if text == "slipped"), "{noted:?}");
    bench.click("Cancel");
    assert_eq!(acts(&bench), [RecordingAction::Cancel]);
}

#[test]
fn a_take_is_reviewed_by_keys() {
    let mut reviewed = document(RecordingPhase::Review);
    let session = reviewed.session.as_mut().expect("a session");
    session.steps[1].state = StepState::Review;
    session.steps[1].verdict = Some(verdict(false));
    let mut bench = in_control(&reviewed);
    bench.harness.get_by_label_contains("Look at this take");
    bench.harness.get_by_label_contains("FSR came at 31 Hz");
    bench.harness.get_by_label("Take 2: Slide, Cylinder, to review");
    for (pressed, action) in [
        // What is bad is recorded again unless somebody knows better.
        (Key::Enter, RecordingAction::Again),
        (Key::A, RecordingAction::Accept),
        (Key::R, RecordingAction::Again),
        (Key::Delete, RecordingAction::Discard),
    ] {
        key(&mut bench, pressed);
        assert_eq!(acts(&bench), [action], "{pressed:?}");
    }
    for (name, action) in [
        ("Accept", RecordingAction::Accept),
        ("Record again", RecordingAction::Again),
        ("Discard", RecordingAction::Discard),
    ] {
        bench.click(name);
        assert_eq!(acts(&bench), [action], "{name}");
    }
    let height = |name: &str| bench.harness.get_by_role_and_label(Role::Button, name).rect().height();
    assert!(height("Record again") > height("Accept"), "the large button is the sensible one");
    bench.harness.get_by_label_contains("nothing at POST /api/v1/recording/act");
    assert!(!bench.can("Add note"), "a mark without words belongs to a moment");
    bench.harness.get_by_label("Note").focus();
    bench.harness.run_steps(2);
    bench.harness.event(egui::Event::Text("good".into()));
    bench.harness.run_steps(2);
    bench.click("Add note");
    assert_eq!(acts(&bench), [RecordingAction::Note { text: "good".to_owned() }]);
}

#[test]
fn a_discard_can_be_undone() {
    let mut discarded = document(RecordingPhase::PlaceObject);
    discarded.session.as_mut().expect("a session").can_undo = true;
    let mut bench = in_control(&discarded);
    bench.click("Undo discard");
    assert_eq!(acts(&bench), [RecordingAction::Undo]);
}

#[test]
fn nothing_is_done_twice_while_the_server_thinks() {
    let mut bench = armed(RecordingPhase::PlaceObject);
    bench.api.0.borrow_mut().silent = true;
    key(&mut bench, Key::Enter);
    key(&mut bench, Key::Enter);
    assert_eq!(acts(&bench).len(), 1);
    assert!(!bench.can("Object is in place"));
}

#[test]
fn the_newest_checklist_is_fetched_when_the_station_says_that_it_changed() {
    let mut bench = armed(RecordingPhase::PlaceObject);
    bench.state.recording =
        Some(RecordingStatus { revision: 8, phase: "start_pose".to_owned(), ..Default::default() });
    let newer = RecordingDocument { revision: 8, ..document(RecordingPhase::StartPose) };
    bench.api.0.borrow_mut().answer(&Request::Recording, serde_json::to_vec(&newer).expect("it serialises"));
    bench.tell();
    bench.harness.get_by_label("Bring the robot to its start");
    let asked = std::mem::take(&mut bench.api.0.borrow_mut().sent);
    assert_eq!(asked.iter().filter(|request| **request == Request::Recording).count(), 1);
}

#[test]
fn a_checklist_that_was_overtaken_by_leaving_the_session_is_asked_for_again() {
    let mut bench = armed(RecordingPhase::PlaceObject);
    bench.api.0.borrow_mut().silent = true;
    bench.state.recording =
        Some(RecordingStatus { revision: 8, phase: "start_pose".to_owned(), ..Default::default() });
    bench.tell();
    bench.click("Leave session");
    let answer = |document: &RecordingDocument| Ok(serde_json::to_vec(document).expect("it serialises"));
    let left = RecordingDocument { revision: 9, session: None, ..document(RecordingPhase::PlaceObject) };
    let old = RecordingDocument { revision: 8, ..document(RecordingPhase::StartPose) };
    let leave = Request::ActOnRecording(RecordingAction::Leave);
    bench.state.recording = None;
    deliver(&bench.api, [ApiEvent::Answer { request: leave, result: answer(&left) }]);
    bench.tell();
    let sent = std::mem::take(&mut bench.api.0.borrow_mut().sent);
    assert_eq!(sent.iter().filter(|request| **request == Request::Recording).count(), 1, "{sent:?}");
    deliver(&bench.api, [ApiEvent::Answer { request: Request::Recording, result: answer(&old) }]);
    bench.harness.run_steps(2);
    bench.harness.get_by_label("Record a calibration session");
    assert!(bench.api.0.borrow().sent.contains(&Request::Recording), "what came was old");
}

#[test]
fn the_end_leads_to_calibration_and_names_what_was_never_touched() {
    let mut done = document(RecordingPhase::Done);
    done.session.as_mut().expect("a session").untouched = vec!["thumb_tip_3".to_owned()];
    let mut bench = Bench::new("#/record", &done);
    bench.harness.get_by_label_contains("No take has touched");
    bench.click("Calibrate on it");
    assert_eq!(app(&bench.harness).screen(), Screen::Calibrate);
    assert!(bench.window.current().starts_with("#/calibrate/monday"), "{}", bench.window.current());
}

#[test]
fn a_lost_connection_freezes_the_checklist_in_words() {
    let mut bench = armed(RecordingPhase::PlaceObject);
    deliver(&bench.api, [palpate_ui::api_client::ApiEvent::SocketClosed]);
    bench.harness.step();
    bench.harness.get_by_label("FROZEN SINCE 14:03:12");
    assert!(!bench.can("Object is in place"));
}

#[test]
fn a_take_whose_check_is_not_there_yet_cannot_be_accepted() {
    let mut recovered = document(RecordingPhase::Review);
    recovered.session.as_mut().expect("a session").steps[1].verdict = None;
    let mut bench = in_control(&recovered);
    bench.harness.get_by_label("Checking the take");
    bench.harness.get_by_label("Take 2: Slide, Cylinder, being checked");
    assert!(bench.harness.query_by_label("Accept").is_none());
    key(&mut bench, Key::Enter);
    assert!(acts(&bench).is_empty());
}

#[test]
fn a_take_that_is_recorded_again_is_not_to_review() {
    let mut again = document(RecordingPhase::Running);
    again.session.as_mut().expect("a session").steps[1].state = StepState::Review;
    let bench = Bench::new("#/record", &again);
    bench.harness.get_by_label("Take 2: Slide, Cylinder, recording");
}

#[test]
fn every_step_has_keys() {
    let cases: [(RecordingPhase, Key, RecordingAction); 6] = [
        (RecordingPhase::StartPose, Key::G, RecordingAction::GoToStart),
        (RecordingPhase::StartPose, Key::B, RecordingAction::Run),
        (RecordingPhase::GoingToStart, Key::Escape, RecordingAction::Cancel),
        (RecordingPhase::Running, Key::Escape, RecordingAction::Cancel),
        (RecordingPhase::PlaceObject, Key::ArrowUp, RecordingAction::Select { step: 0 }),
        (RecordingPhase::Done, Key::ArrowDown, RecordingAction::Select { step: 0 }),
    ];
    for (phase, pressed, action) in cases {
        let mut bench = armed(phase);
        key(&mut bench, pressed);
        assert_eq!(acts(&bench), [action], "{phase:?}");
    }
    let mut bench = armed(RecordingPhase::PlaceObject);
    key(&mut bench, Key::P);
    key(&mut bench, Key::Enter);
    assert_eq!(acts(&bench), [RecordingAction::ConfirmObject { fixture_trusted: false }]);
    let mut discarded = document(RecordingPhase::PlaceObject);
    discarded.session.as_mut().expect("a session").can_undo = true;
    let mut bench = in_control(&discarded);
    key(&mut bench, Key::U);
    assert_eq!(acts(&bench), [RecordingAction::Undo]);
    let mut bench = armed(RecordingPhase::Review);
    key(&mut bench, Key::N);
    bench.harness.event(egui::Event::Text("good".into()));
    bench.harness.run_steps(2);
    key(&mut bench, Key::Enter);
    assert_eq!(acts(&bench), [RecordingAction::Note { text: "good".to_owned() }]);
}

#[test]
fn what_is_wanted_waits_before_a_session_and_can_be_recorded_alone() {
    let wanted = WantedTake {
        object: "sphere_50mm".to_owned(),
        primitive: "quick_tap".to_owned(),
        because: "Tells latency from low pass.".to_owned(),
    };
    let waiting =
        RecordingDocument { revision: 1, plans: plans(), wanted: vec![wanted], session: None, free: None };
    let mut bench = in_control(&waiting);
    bench.harness.get_by_label("Tells latency from low pass.");
    bench
        .harness
        .get_by_role_and_label(Role::CheckBox, "Record only this, not the takes of the plan")
        .click();
    bench.harness.run_steps(3);
    bench.click("Start session");
    let start = StartRecording {
        plan: "nine_takes".to_owned(),
        session: "next-1".to_owned(),
        operator: "Ada".to_owned(),
        only_wanted: true,
    };
    assert!(bench.api.0.borrow().sent.contains(&Request::StartRecording(start)));
    let unwant = Request::Unwant { object: "sphere_50mm".to_owned(), primitive: "quick_tap".to_owned() };
    let none =
        RecordingDocument { revision: 2, plans: plans(), wanted: Vec::new(), session: None, free: None };
    bench.api.0.borrow_mut().answer(&unwant, serde_json::to_vec(&none).expect("it serialises"));
    bench.click("Remove quick tap on sphere 50mm");
    bench.harness.run_steps(3);
    assert!(bench.api.0.borrow().sent.contains(&unwant));
    assert!(bench.harness.query_by_label("Tells latency from low pass.").is_none());
}

#[test]
fn an_added_step_says_why() {
    let mut added = document(RecordingPhase::PlaceObject);
    added.session.as_mut().expect("a session").steps[1].added_because = Some("Tells a from b.".to_owned());
    let bench = Bench::new("#/record", &added);
    bench.harness.get_by_label("Added to the plan: Tells a from b.");
}

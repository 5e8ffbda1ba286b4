//! Who decides: a watcher can only look, control is taken by name, and what went wrong is said with time and name.

use egui::{Key, accesskit::Role};
use egui_kittest::kittest::Queryable as _;
use palpate_ui::{api_client::Request, route::Screen};
use palpate_wire::{
    api::{RecordingAction, RecordingDocument, RecordingPhase, StepState, WantedTake},
    proto::{RecordingStatus, control_request::Request as Command, control_state::Phase},
};

use crate::{
    fixture::{FakeWindow, app, full_api, page},
    live::{Bench, nothing_recorded},
    record::{acts, document, in_control, key, plans, verdict},
};

const PHASES: [RecordingPhase; 9] = [
    RecordingPhase::PlaceObject,
    RecordingPhase::StartPose,
    RecordingPhase::GoingToStart,
    RecordingPhase::Baseline,
    RecordingPhase::Countdown,
    RecordingPhase::Running,
    RecordingPhase::Checking,
    RecordingPhase::Review,
    RecordingPhase::Done,
];

/// Everything that changes a recording.
const DECIDING: [&str; 15] = [
    "Object is in place",
    "Go to start pose",
    "Run",
    "Arm the station",
    "Accept",
    "Record again",
    "Discard",
    "Undo discard",
    "Cancel",
    "Leave session",
    "Mark",
    "Add note",
    "Start session",
    "Take 1: Tap, Sphere, accepted",
    "Take control to go on",
];

const KEYS: [Key; 14] = [
    Key::Enter,
    Key::P,
    Key::G,
    Key::B,
    Key::Escape,
    Key::R,
    Key::Delete,
    Key::Delete,
    Key::U,
    Key::M,
    Key::N,
    Key::ArrowUp,
    Key::ArrowDown,
    Key::Enter,
];

fn discarded(phase: RecordingPhase) -> RecordingDocument {
    let mut document = document(phase);
    document.session.as_mut().expect("a session").can_undo = true;
    document
}

#[test]
fn watcher_sees_everything_and_decides_nothing() {
    for phase in PHASES {
        let mut bench = Bench::new("#/record", &discarded(phase));
        bench.bo_has_control();
        bench.phase(Phase::Armed);
        bench.api.0.borrow_mut().sent.clear();
        for name in DECIDING {
            assert!(!bench.can(name), "{phase:?}: a watcher can press {name:?}");
        }
        for pressed in KEYS {
            key(&mut bench, pressed);
        }
        assert_eq!(acts(&bench), [], "{phase:?}");
        assert!(bench.commands().is_empty(), "{phase:?}");
        let over = phase == RecordingPhase::Done;
        assert_eq!(bench.harness.query_by_label("Bo decides").is_some(), !over, "{phase:?}");
    }
    let mut bench = Bench::new("#/record", &document(RecordingPhase::Review));
    bench.bo_has_control();
    bench.harness.get_by_label("\u{2714} Good take");
    bench.harness.get_by_label("Two of three channels were touched.");
}

#[test]
fn where_nobody_has_control_the_primary_button_takes_it_and_nothing_else_can_be_pressed() {
    for phase in PHASES {
        let mut bench = Bench::new("#/record", &discarded(phase));
        bench.api.0.borrow_mut().sent.clear();
        for name in DECIDING.into_iter().filter(|name| !name.starts_with("Take control")) {
            assert!(!bench.can(name), "{phase:?}: {name:?}");
        }
        for pressed in KEYS {
            key(&mut bench, pressed);
        }
        assert_eq!(acts(&bench), [], "{phase:?}");
        assert!(bench.commands().is_empty(), "{phase:?}: control is not taken by a slip of the hand");
        if matches!(phase, RecordingPhase::Checking | RecordingPhase::Done) {
            continue;
        }
        bench.click("Take control to go on");
        let sent = bench.commands();
        assert!(
            matches!(&sent[..], [(0, Command::Acquire(ask))] if ask.operator == "Ada" && !ask.take_over),
            "{phase:?}: {sent:?}"
        );
    }
}

#[test]
fn session_begins_under_control_only() {
    let empty =
        RecordingDocument { revision: 1, plans: plans(), wanted: Vec::new(), session: None, free: None };
    let mut bench = Bench::new("#/record", &empty);
    let started = |bench: &Bench| {
        let sent = &bench.api.0.borrow().sent;
        sent.iter().any(|request| matches!(request, Request::StartRecording(_)))
    };
    key(&mut bench, Key::Enter);
    assert!(!bench.can("Start session") && !started(&bench));
    bench.bo_has_control();
    bench.harness.get_by_label("Bo decides");
    key(&mut bench, Key::Enter);
    assert!(!bench.can("Start session") && !bench.can("Take control to go on") && !started(&bench));
    bench.state.holder = String::new();
    bench.tell();
    bench.click("Take control to go on");
    bench.reply(4, "");
    bench.click("Start session");
    assert!(started(&bench));
}

#[test]
fn what_the_operator_does_carries_the_lease_and_what_anybody_may_do_does_not() {
    let mut bench = in_control(&document(RecordingPhase::PlaceObject));
    bench.api.0.borrow_mut().http.clear();
    bench.click("Object is in place");
    bench.harness.run_steps(3);
    let http = std::mem::take(&mut bench.api.0.borrow_mut().http);
    let leases: Vec<_> = http.iter().map(|http| (http.name(), http.lease)).collect();
    assert_eq!(leases[0], ("POST /api/v1/recording/act".to_owned(), Some(4)));
    assert!(leases[1..].iter().all(|(_, lease)| lease.is_none()), "{leases:?}");
}

#[test]
fn refusal_is_shown_in_the_servers_words() {
    let mut bench = in_control(&document(RecordingPhase::PlaceObject));
    bench.click("Object is in place");
    bench.harness.run_steps(3);
    bench.harness.get_by_label_contains("nothing at POST /api/v1/recording/act");
}

fn accepted_under_review() -> RecordingDocument {
    let mut reviewed = document(RecordingPhase::Review);
    let step = &mut reviewed.session.as_mut().expect("a session").steps[1];
    step.state = StepState::Accepted;
    step.verdict = Some(verdict(true));
    reviewed
}

#[test]
fn accepted_take_is_set_aside_by_a_second_deliberate_press_only() {
    for (button, pressed, yes, action) in [
        ("Discard", Key::Delete, "Discard the accepted take", RecordingAction::Discard),
        ("Record again", Key::R, "Set the accepted take aside", RecordingAction::Again),
    ] {
        let mut bench = in_control(&accepted_under_review());
        for _ in 0..3 {
            key(&mut bench, pressed);
            key(&mut bench, Key::Enter);
            bench.harness.key_press(Key::Space);
        }
        let done = acts(&bench);
        assert!(!done.contains(&action), "a key that is held down is no second thought: {done:?}");
        let mut bench = in_control(&accepted_under_review());
        bench.click(button);
        assert_eq!(acts(&bench), [], "{button}: it asks first");
        bench.harness.get_by_label_contains("Take 2 is accepted and part of the session.");
        bench.click("Keep it");
        assert!(!bench.can(yes));
        bench.click(button);
        bench.click(yes);
        assert_eq!(acts(&bench), [action]);
    }
}

#[test]
fn name_is_asked_for_once_and_is_never_empty() {
    let window = FakeWindow::at("#/record");
    let mut bench = Bench::of(window, &document(RecordingPhase::PlaceObject), [1280.0, 800.0]);
    bench.click("Take control to go on");
    bench.harness.get_by_label("Who sits here?");
    assert!(bench.commands().is_empty() && !bench.can("Continue"));
    bench.harness.event(egui::Event::Text("   ".into()));
    bench.harness.run_steps(2);
    assert!(!bench.can("Continue"), "spaces are no name");
    bench.harness.key_press(Key::Enter);
    bench.harness.run_steps(2);
    assert!(bench.commands().is_empty());
    bench.harness.get_by_label("Your name").focus();
    bench.harness.run_steps(2);
    bench.harness.event(egui::Event::Text("Ada".into()));
    bench.harness.run_steps(2);
    bench.click("Continue");
    bench.harness.run_steps(2);
    let sent = bench.commands();
    assert!(matches!(&sent[..], [(0, Command::Acquire(ask))] if ask.operator == "Ada"), "{sent:?}");
    assert_eq!(bench.window.0.borrow().operator, "Ada", "the browser remembers it");
    assert!(bench.harness.query_by_label("Who sits here?").is_none());

    // The next visit asks nothing; the name can be changed.
    let again = FakeWindow::at("#/sessions");
    again.0.borrow_mut().operator = bench.window.0.borrow().operator.clone();
    let mut bench = Bench::of(again, &nothing_recorded(), [1280.0, 800.0]);
    bench.click("as Ada, change");
    bench.harness.get_by_label("Who sits here?");
    bench.click("Cancel");
    bench.click("Take control");
    assert!(matches!(&bench.commands()[..], [(0, Command::Acquire(ask))] if ask.operator == "Ada"));
}

#[test]
fn taking_over_without_a_name_asks_for_both() {
    let mut bench = Bench::of(FakeWindow::at("#/sessions"), &nothing_recorded(), [1280.0, 800.0]);
    bench.bo_has_control();
    bench.click("Take over");
    bench.click("Take over from Bo");
    assert!(bench.commands().is_empty());
    bench.harness.event(egui::Event::Text("Ada".into()));
    bench.harness.run_steps(2);
    bench.harness.key_press(Key::Enter);
    bench.harness.run_steps(4);
    let sent = bench.commands();
    assert!(
        matches!(&sent[..], [(0, Command::Acquire(ask))] if ask.operator == "Ada" && ask.take_over),
        "{sent:?}"
    );
}

#[test]
fn server_that_is_open_to_the_network_says_so_on_every_screen_and_others_do_not() {
    let banner = "\u{26a0} Open to the network without a login: anybody there can take control";
    let bench = Bench::at("#/sessions");
    assert!(bench.harness.query_by_label(banner).is_none());
    let api = full_api();
    let info = br#"{"name":"palpate","version":"0.1.0","station":null,"source":"replay","insecure":true}"#;
    api.0.borrow_mut().answer(&Request::Info, info.to_vec());
    let mut harness = page(&api, &FakeWindow::at("#/sessions"));
    for screen in Screen::ALL.iter().copied().filter(|screen| screen.is_offered(false)) {
        harness.get_by_role_and_label(Role::Button, screen.label()).click();
        harness.run_steps(4);
        assert_eq!(app(&harness).screen(), screen, "it blocks nothing");
        harness.get_by_label(banner);
    }
}

#[test]
fn way_to_the_start_that_was_interrupted_says_why_when_and_how_often_until_the_next_press() {
    let mut bench = in_control(&document(RecordingPhase::StartPose));
    let status = |phase: &str| RecordingStatus { revision: 7, phase: phase.to_owned(), ..Default::default() };
    let silence = "nothing is heard of the operator; motion goes on with new targets once the page is back";
    let interrupt = |bench: &mut Bench| {
        bench.state.recording = Some(status("going_to_start"));
        bench.phase(Phase::Armed);
        bench.state.reason = silence.to_owned();
        bench.phase(Phase::Holding);
        bench.state.recording = Some(status("start_pose"));
        bench.state.reason = String::new();
        bench.phase(Phase::Armed);
    };
    interrupt(&mut bench);
    bench
        .harness
        .get_by_label_contains(&format!("The way to the start was interrupted at 14:03:12: {silence}"));
    assert!(bench.harness.query_by_label("Ready to run").is_none(), "it did not arrive");
    bench.tell();
    bench.harness.get_by_label_contains("The way to the start was interrupted");
    bench.click("Go to start pose");
    assert!(bench.harness.query_by_label_contains("was interrupted").is_none());
    interrupt(&mut bench);
    bench.harness.get_by_label_contains(&format!("interrupted at 14:03:12, 2 times by now: {silence}"));
}

#[test]
fn interruption_that_only_the_checklist_tells_is_shown_once() {
    let mut stopped = RecordingDocument { revision: 8, ..document(RecordingPhase::StartPose) };
    let problem = "the station stopped: nothing was heard of the operator for 0.40 s; arm again";
    stopped.session.as_mut().expect("a session").problem = problem.to_owned();
    let mut bench = in_control(&document(RecordingPhase::StartPose));
    let answer = serde_json::to_vec(&stopped).expect("it serialises");
    bench.api.0.borrow_mut().answer(&Request::Recording, answer);
    bench.state.recording =
        Some(RecordingStatus { revision: 8, phase: "start_pose".to_owned(), ..Default::default() });
    bench.tell();
    let text = format!("The way to the start was interrupted at 14:03:12: {problem}");
    bench.harness.get_by_label_contains(&text);
    assert_eq!(bench.harness.query_all_by_label_contains(problem).count(), 1);
    bench.api.0.borrow_mut().silent = true;
    bench.click("Go to start pose");
    bench.harness.run_steps(3);
    assert!(bench.harness.query_by_label_contains("was interrupted").is_none(), "it is not counted again");
    // A page that is opened later knows no time.
    let bench = Bench::new("#/record", &stopped);
    bench.harness.get_by_label_contains(&format!("The way to the start was interrupted: {problem}"));
}

#[test]
fn page_that_draws_too_slowly_to_hold_control_says_so() {
    let mut bench = Bench::at("#/sessions");
    bench.take_control_and_arm();
    bench.harness.run_steps(150);
    assert!(bench.harness.query_by_label_contains("This browser draws").is_none(), "50 frames a second");
    let slow = |bench: &mut Bench| {
        for _ in 0..8 {
            let time_s = bench.harness.ctx.input(|input| input.time);
            bench.harness.input_mut().time = Some(time_s + 1.0);
            bench.harness.step();
        }
    };
    slow(&mut bench);
    bench.harness.get_by_label_contains("This browser draws 1 frame a second, too slow to hold control");
    // A page without control need not draw at all.
    let mut bench = Bench::at("#/sessions");
    slow(&mut bench);
    assert!(bench.harness.query_by_label_contains("This browser draws").is_none());
}

#[test]
fn banner_of_a_silent_page_has_time_and_name_and_can_be_dismissed_once_motors_are_off() {
    let mut bench = Bench::at("#/sessions");
    bench.bo_has_control();
    bench.state.reason = "nothing is heard of the operator; motion goes on".to_owned();
    bench.phase(Phase::Holding);
    bench.harness.get_by_label("14:03:12: Bo's page went silent.");
    assert!(!bench.can("Dismiss notice"), "the motors have torque");
    bench.state.holder = String::new();
    let reason = "nothing was heard of the operator for 0.40 s; arm again";
    bench.state.reason = reason.to_owned();
    bench.phase(Phase::Disarmed);
    bench.harness.get_by_label("14:03:12: Bo's page went silent.");
    bench.harness.get_by_label(reason);
    bench.click("Dismiss notice");
    assert!(bench.harness.query_by_label(reason).is_none());
    bench.tell();
    assert!(bench.harness.query_by_label(reason).is_none(), "it was read");
}

#[test]
fn wanted_takes_of_somebody_elses_station_stay() {
    let wanted = WantedTake {
        object: "sphere_50mm".to_owned(),
        primitive: "quick_tap".to_owned(),
        because: String::new(),
    };
    let waiting =
        RecordingDocument { revision: 1, plans: plans(), wanted: vec![wanted], session: None, free: None };
    let mut bench = Bench::new("#/record", &waiting);
    assert!(bench.can("Remove quick tap on sphere 50mm"));
    bench.bo_has_control();
    assert!(!bench.can("Remove quick tap on sphere 50mm"));
}

//! Home: what is next, what runs, and what it says where something is empty or does not come.

use egui::accesskit::Role;
use egui_kittest::kittest::{NodeT as _, Queryable as _};
use palpate_ui::{
    api_client::{ApiEvent, Request},
    route::Screen,
};
use palpate_wire::{
    api::{
        CalibrationRequest, CalibrationRun, CampaignSummary, JobPage, JobState, Me, Role as May, Scope, Via,
    },
    proto::{
        ControlState, DeviceStatus, LiveFrame, StreamMessage, control_state::Phase, device_status::Link,
    },
};
use prost::Message as _;

use crate::fixture::{FakeWindow, SharedApi, app, full_api, page, page_of};

fn json(value: &impl serde::Serialize) -> Vec<u8> {
    serde_json::to_vec(value).expect("it is plain data")
}

pub(crate) fn me(role: May, via: Via) -> Me {
    let name = if via == Via::Local { "local operator" } else { "ada" };
    Me { name: name.into(), role, scopes: Scope::ALL.to_vec(), via, token: None, expires: None }
}

/// A studio with one session, no jobs and no campaigns, seen by somebody of `role`.
pub(crate) fn studio(role: May) -> SharedApi {
    let api = full_api();
    {
        let mut fake = api.0.borrow_mut();
        fake.answer(&Request::Me, json(&me(role, Via::Session)));
        fake.answer(&Request::Campaigns, b"[]".to_vec());
        fake.answer(&Request::Models, b"[]".to_vec());
        fake.answer(&Request::Jobs(None), json(&JobPage { jobs: Vec::new(), next_cursor: None }));
    }
    api
}

#[test]
fn the_page_opens_on_home_and_its_button_calibrates_a_new_session() {
    let api = studio(May::Operator);
    let window = FakeWindow::at("");
    let mut harness = page(&api, &window);
    assert_eq!(app(&harness).screen(), Screen::Home);
    harness.get_by_label_contains("No sensor model was fitted to session bench-1 yet.");
    let request =
        CalibrationRequest { session: "bench-1".into(), method: None, hold_out: None, shared_theta: false };
    let run = CalibrationRun {
        id: "run-1".into(),
        request: request.clone(),
        state: JobState::Queued,
        fraction: 0.0,
        stage: "waiting".into(),
        seconds_left: None,
        error: None,
        report: None,
        model_toml: None,
        saved_as: None,
    };
    api.0.borrow_mut().answer(&Request::StartRun(request.clone()), json(&run));
    harness.get_by_role_and_label(Role::Button, "Calibrate on bench-1").click();
    harness.run_steps(4);
    assert!(api.0.borrow().sent.contains(&Request::StartRun(request)));
    assert!(window.current().starts_with("#/calibrate/bench-1?run=run-1"), "{}", window.current());
    // Back on Home the same button watches: nothing is started twice.
    harness.get_by_role_and_label(Role::Button, "Home").click();
    harness.run_steps(4);
    harness.get_by_role_and_label(Role::Button, "Watch run-1");
    assert!(harness.query_by_label("Calibrate on bench-1").is_none());
}

#[test]
fn a_start_that_is_refused_says_why_and_can_be_tried_again() {
    let mut harness = page(&studio(May::Operator), &FakeWindow::at("#/home"));
    harness.get_by_role_and_label(Role::Button, "Calibrate on bench-1").click();
    harness.run_steps(4);
    harness.get_by_label_contains("It did not start: nothing at POST /api/v1/calibrations");
    assert!(
        !harness.get_by_role_and_label(Role::Button, "Calibrate on bench-1").accesskit_node().is_disabled()
    );
}

#[test]
fn nothing_yet_says_what_a_session_is_and_where_one_comes_from() {
    let api = studio(May::Operator);
    api.0.borrow_mut().answer(&Request::Sessions, b"[]".to_vec());
    let window = FakeWindow::at("#/home");
    let mut harness = page(&api, &window);
    harness.get_by_label_contains("A session is a set of takes");
    harness.get_by_label("Nothing runs.");
    harness.get_by_label_contains("A calibration makes one");
    harness.get_by_role_and_label(Role::Button, "Bring in a session").click();
    harness.run_steps(4);
    assert!(window.current().starts_with("#/sessions"), "{}", window.current());
}

#[test]
fn a_list_that_does_not_come_is_named_and_the_rest_of_the_screen_stays() {
    let api = studio(May::Operator);
    api.0.borrow_mut().bodies.remove("GET /api/v1/models");
    let mut harness = page(&api, &FakeWindow::at("#/home"));
    harness.get_by_label_contains("The list of models did not arrive: nothing at GET /api/v1/models");
    harness.get_by_role_and_label(Role::Button, "Session bench-1: 2 takes, 40.0 s");
    api.0.borrow_mut().answer(&Request::Models, b"[]".to_vec());
    harness.get_by_role_and_label(Role::Button, "Try again: The list of models").click();
    harness.run_steps(4);
    harness.get_by_role_and_label(Role::Button, "Calibrate on bench-1");
}

#[test]
fn a_viewer_is_offered_nothing_and_a_scorer_the_trials_that_wait() {
    let harness = page(&studio(May::Viewer), &FakeWindow::at("#/home"));
    harness.get_by_label_contains("You are logged in as viewer");
    let api = studio(May::Scorer);
    let campaign = CampaignSummary {
        id: "first".into(),
        name: "First trials".into(),
        created: String::new(),
        planned: 4,
        scored: 1,
        to_score: 2,
        paused: None,
        closed: None,
        error: None,
    };
    api.0.borrow_mut().answer(&Request::Campaigns, json(&[campaign]));
    let window = FakeWindow::at("#/home");
    let mut harness = page(&api, &window);
    harness.get_by_role_and_label(Role::Button, "Score trials").click();
    harness.run_steps(4);
    assert_eq!(window.current(), "#/trials?campaign=first&part=score");
}

#[test]
fn the_station_tells_its_state_holder_and_problems() {
    let api = studio(May::Operator);
    let mut harness = page(&api, &FakeWindow::at("#/home"));
    harness.get_by_label_contains("Nothing has come from it yet.");
    let device = |id: &str, link: Link, problem: &str| {
        let mut device = DeviceStatus { id: id.into(), problem: problem.into(), ..Default::default() };
        device.set_link(link);
        device
    };
    let devices = vec![device("hand", Link::Ready, ""), device("fsr", Link::Lost, "the port is gone")];
    let mut control = ControlState { holder: "Olga".into(), devices, ..Default::default() };
    control.set_phase(Phase::Holding);
    let frame = LiveFrame { control: Some(control), ..Default::default() };
    let message = StreamMessage {
        message: Some(palpate_wire::proto::stream_message::Message::Live(frame)),
        dropped: 0,
    };
    api.0.borrow_mut().events.push_back(ApiEvent::SocketMessage(message.encode_to_vec()));
    harness.run_steps(3);
    harness.get_by_label("Olga has control.");
    harness.get_by_label_contains("fsr is lost: the port is gone");
}

#[test]
fn a_phone_has_every_card_in_one_column() {
    let harness = page_of(&studio(May::Operator), &FakeWindow::at("#/home"), [390.0, 844.0]);
    let button = harness.get_by_role_and_label(Role::Button, "Calibrate on bench-1").rect();
    assert!(button.left() >= 60.0 && button.right() <= 390.0, "{button:?}");
    for title in ["What next", "Station", "What runs"] {
        let heading = harness.get_by_role_and_label(Role::Heading, title).rect();
        assert!((heading.left() - button.left()).abs() < 2.0, "{title}: {heading:?}");
    }
}

//! Rail, address bar, shortcuts, palette, and what happens when the server is slow, empty or gone.

use egui::{Key, Modifiers};
use egui_kittest::kittest::Queryable as _;
use palpate_ui::{
    api_client::{ApiEvent, Request},
    route::Screen,
};

use crate::fixture::{FakeWindow, SharedApi, app, deliver, full_api, page};

#[test]
fn rail_leads_to_every_screen_and_back() {
    let window = FakeWindow::at("#/timelines");
    let mut harness = page(&full_api(), &window);
    for screen in [Screen::Calibrate, Screen::Diagnose, Screen::Sessions, Screen::Hand, Screen::Timelines] {
        harness.get_by_role_and_label(egui::accesskit::Role::Button, screen.label()).click();
        harness.run_steps(4);
        assert_eq!(app(&harness).screen(), screen);
        assert!(window.current().starts_with(&format!("#/{}", screen.label().to_lowercase())));
    }
    window.back();
    harness.run_steps(4);
    assert_eq!(app(&harness).screen(), Screen::Hand);
}

#[test]
fn theme_survives_a_visit_and_the_title_says_what_is_open() {
    let window = FakeWindow::at("#/timelines/bench-1?take=take-02");
    let mut harness = page(&full_api(), &window);
    assert_eq!(window.0.borrow().title, "Timelines \u{b7} bench-1 take-02 \u{2013} Palpate");
    let before = harness.ctx.theme();
    harness.key_press(Key::T);
    harness.run_steps(3);
    assert_ne!(harness.ctx.theme(), before);
    let again = page(&full_api(), &window);
    assert_ne!(again.ctx.theme(), before);
}

#[test]
fn link_opens_take_and_time_and_the_address_follows() {
    let window = FakeWindow::at("#/timelines/bench-1?take=take-02&t=4.2");
    let mut harness = page(&full_api(), &window);
    assert_eq!(app(&harness).playback.take.as_deref(), Some("take-02"));
    assert!((app(&harness).playback.time_s - 4.2).abs() < 1e-9);
    let steps = window.steps();
    harness.key_press(Key::PageUp);
    harness.run_steps(4);
    assert_eq!(app(&harness).playback.take.as_deref(), Some("take-01"));
    assert!(window.current().contains("take=take-01"), "{}", window.current());
    assert_eq!(window.steps(), steps + 1, "another take is a step for \"back\"");
    window.back();
    harness.run_steps(4);
    assert_eq!(app(&harness).playback.take.as_deref(), Some("take-02"));
}

#[test]
fn question_mark_lists_shortcuts_and_escape_closes() {
    let mut harness = page(&full_api(), &FakeWindow::at("#/sessions"));
    harness.event(egui::Event::Text("?".into()));
    harness.run_steps(3);
    let close = harness.get_by_label("Close shortcuts").rect();
    assert!(close.bottom() <= 800.0 && close.height() >= 32.0, "{close:?} must be on the screen");
    harness.get_by_label("Next mismatch");
    harness.key_press(Key::Escape);
    harness.run_steps(3);
    assert!(harness.query_by_label("Close shortcuts").is_none());
}

#[test]
fn palette_finds_and_runs_a_command() {
    let mut harness = page(&full_api(), &FakeWindow::at("#/timelines"));
    harness.key_press_modifiers(Modifiers::COMMAND, Key::K);
    harness.run_steps(3);
    harness.event(egui::Event::Text("go sess".into()));
    harness.run_steps(2);
    harness.key_press(Key::Enter);
    harness.run_steps(4);
    assert_eq!(app(&harness).screen(), Screen::Sessions);
    assert!(harness.query_by_label("Command").is_none(), "the palette closes");
}

#[test]
fn escape_leaves_the_palette() {
    let mut harness = page(&full_api(), &FakeWindow::at("#/timelines"));
    harness.key_press_modifiers(Modifiers::COMMAND, Key::K);
    harness.run_steps(3);
    harness.get_by_label("Command");
    harness.key_press(Key::Escape);
    harness.run_steps(3);
    assert!(harness.query_by_label("Command").is_none());
    assert_eq!(app(&harness).screen(), Screen::Timelines);
}

#[test]
fn typing_in_the_palette_runs_no_shortcut() {
    let mut harness = page(&full_api(), &FakeWindow::at("#/timelines"));
    harness.key_press_modifiers(Modifiers::COMMAND, Key::K);
    harness.run_steps(3);
    let before = app(&harness).playback.playing;
    harness.key_press(Key::Space);
    harness.run_steps(2);
    assert_eq!(app(&harness).playback.playing, before);
}

#[test]
fn lost_connection_says_since_when_and_goes_away_again() {
    let api = full_api();
    let mut harness = page(&api, &FakeWindow::at("#/sessions"));
    harness.get_by_label_contains("Connected");
    deliver(&api, [ApiEvent::SocketClosed]);
    harness.step();
    harness.get_by_label_contains("CONNECTION LOST");
    harness.get_by_label_contains("14:03:12");
    // Attempts to connect again are seconds apart; a frame is 20 ms.
    harness.run_steps(120);
    assert!(harness.query_by_label_contains("CONNECTION LOST").is_none(), "it connects again");
    let asked = api.0.borrow().sent.iter().filter(|request| **request == Request::Sessions).count();
    assert_eq!(asked, 2, "what may have changed is asked for again");
}

#[test]
fn slow_server_shows_what_is_awaited() {
    let api = SharedApi::default();
    api.0.borrow_mut().silent = true;
    let harness = page(&api, &FakeWindow::at("#/timelines"));
    harness.get_by_label_contains("Looking for sessions");
}

#[test]
fn empty_server_says_what_a_session_is_for() {
    let api = SharedApi::default();
    api.0.borrow_mut().answer(&Request::Sessions, b"[]".to_vec());
    let mut harness = page(&api, &FakeWindow::at("#/timelines"));
    harness.get_by_label("No session yet");
    harness.get_by_label("Bring in a session").click();
    harness.run_steps(3);
    assert_eq!(app(&harness).screen(), Screen::Sessions);
}

#[test]
fn failing_server_says_why_and_can_be_asked_again() {
    let api = SharedApi::default();
    let mut harness = page(&api, &FakeWindow::at("#/timelines"));
    harness.get_by_label_contains("The list of sessions did not arrive");
    harness.get_by_label_contains("nothing at GET /api/v1/sessions");
    let bodies = std::mem::take(&mut full_api().0.borrow_mut().bodies);
    api.0.borrow_mut().bodies = bodies;
    harness.get_by_label("Try again").click();
    harness.run_steps(8);
    harness.get_by_label("Time cursor");
}

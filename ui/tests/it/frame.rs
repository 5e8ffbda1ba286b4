//! Rail, address bar, shortcuts, palette, and what happens when the server is slow, empty or gone.

use egui::{Key, Modifiers, accesskit::Role};
use egui_kittest::{Harness, kittest::Queryable as _};
use palpate_ui::{
    StudioApp,
    api_client::{ApiEvent, Request},
    route::Screen,
};
use palpate_wire::proto::{Changed, StreamMessage, stream_message};
use prost::Message as _;

use crate::{
    fixture::{FakeWindow, SharedApi, app, copied, deliver, full_api, page, page_of},
    live::{Bench, nothing_recorded},
};

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

#[test]
fn session_and_take_are_picked_in_the_bar() {
    let window = FakeWindow::at("#/hand/bench-1?take=take-01");
    let mut harness = page(&full_api(), &window);
    harness.get_by_role_and_label(Role::Button, "Session in view: bench-1").click();
    harness.run_steps(4);
    harness.get_by_role_and_label(Role::ListBoxOption, "bench-1  (2 takes)");
    harness.key_press(Key::Escape);
    harness.run_steps(4);
    harness.get_by_role_and_label(Role::Button, "Take in view: take-01").click();
    harness.run_steps(4);
    harness.get_by_role_and_label(Role::ListBoxOption, "take-02: tap on sphere_50mm").click();
    harness.run_steps(4);
    assert_eq!(app(&harness).playback.take.as_deref(), Some("take-02"));
    assert!(window.current().contains("take=take-02"), "{}", window.current());
    assert_eq!(app(&harness).screen(), Screen::Hand);
}

#[test]
fn link_is_copied_whole() {
    let window = FakeWindow::at("#/timelines/bench-1?take=take-02&t=4.2");
    let mut harness = page(&full_api(), &window);
    harness.get_by_role_and_label(Role::Button, "Copy link").click();
    let address = copied(&mut harness).expect("something is copied");
    assert_eq!(address, format!("http://127.0.0.1:7480/{}", window.current()));
}

#[test]
fn palette_finds_takes_and_sessions_and_fits_low_windows() {
    for size in [[1280.0, 800.0], [640.0, 400.0], [390.0, 844.0]] {
        let mut harness = page_of(&full_api(), &FakeWindow::at("#/sessions/bench-1"), size);
        harness.key_press_modifiers(Modifiers::COMMAND, Key::K);
        harness.run_steps(4);
        let field = harness.get_by_label("Command").rect();
        assert!(field.top() >= 0.0 && field.right() <= size[0], "{size:?}: {field:?}");
        for _ in 0..26 {
            harness.key_press(Key::ArrowDown);
            harness.run_steps(1);
        }
        harness.run_steps(20);
        let last = harness.get_by_role_and_label(Role::Button, "Next take").rect();
        assert!(last.top() >= field.bottom() && last.bottom() <= size[1], "{size:?}: {last:?}");
        harness.event(egui::Event::Text("session bench".into()));
        harness.run_steps(3);
        harness.key_press(Key::Enter);
        harness.run_steps(5);
        assert_eq!(app(&harness).playback.session.as_deref(), Some("bench-1"), "{size:?}");
        harness.key_press_modifiers(Modifiers::COMMAND, Key::K);
        harness.run_steps(4);
        harness.event(egui::Event::Text("take take-02".into()));
        harness.run_steps(3);
        harness.key_press(Key::Enter);
        harness.run_steps(5);
        assert_eq!(app(&harness).screen(), Screen::Timelines, "{size:?}");
        assert_eq!(app(&harness).playback.take.as_deref(), Some("take-02"), "{size:?}");
    }
}

#[test]
fn dead_links_say_what_is_not_there_and_lead_on() {
    let cases = [
        ("#/bananas", "There is no screen \u{201c}bananas\u{201d}", "Go to Home", Screen::Home),
        ("#/sessions/nope", "There is no session nope", "All sessions", Screen::Sessions),
        ("#/calibrate/nope", "There is no session nope", "All sessions", Screen::Sessions),
        ("#/diagnose/nope", "There is no session nope", "All sessions", Screen::Sessions),
        ("#/timelines/nope?take=take-01", "There is no session nope", "All sessions", Screen::Sessions),
        ("#/hand/nope", "There is no session nope", "All sessions", Screen::Sessions),
        (
            "#/timelines/bench-1?take=take-99",
            "Session bench-1 has no take take-99",
            "Open take-01",
            Screen::Timelines,
        ),
    ];
    for (hash, said, button, leads_to) in cases {
        let mut harness = page(&full_api(), &FakeWindow::at(hash));
        harness.get_by_label(said);
        assert!(harness.query_by_label_contains("/api/").is_none(), "{hash}: routes are not for people");
        // "Home" is in the rail too; the button that leads on is the one of this name.
        harness.get_by_role_and_label(Role::Button, button).click();
        harness.run_steps(6);
        assert_eq!(app(&harness).screen(), leads_to, "{hash}");
        assert!(harness.query_by_label(said).is_none(), "{hash}");
    }
}

#[test]
fn help_explains_words_and_leads_to_the_shortcuts() {
    let mut harness = page(&full_api(), &FakeWindow::at("#/sessions"));
    harness.get_by_role_and_label(Role::Button, "Help").click();
    harness.run_steps(4);
    harness.event(egui::Event::Text("primitive".into()));
    harness.run_steps(3);
    harness.get_by_label("a motion of a plan: tap, press, roll, ...");
    assert!(harness.query_by_label_contains("the right to move the robot").is_none());
    harness.get_by_role_and_label(Role::Button, "Keyboard shortcuts").click();
    harness.run_steps(4);
    harness.get_by_label("Close shortcuts").click();
    harness.run_steps(4);
    assert!(harness.query_by_label("Close shortcuts").is_none());
}

#[test]
fn headings_and_what_changes_by_itself_have_roles_of_their_own() {
    let api = full_api();
    let mut harness = page(&api, &FakeWindow::at("#/sessions/bench-1"));
    harness.get_by_role_and_label(Role::Heading, "Sessions");
    harness.get_by_role_and_label(Role::Heading, "Takes");
    deliver(&api, [ApiEvent::SocketClosed]);
    harness.step();
    harness.get_by_role_and_label(Role::Alert, "\u{26a0} CONNECTION LOST");
}

#[test]
fn lists_follow_what_others_do() {
    let api = full_api();
    let mut harness = page(&api, &FakeWindow::at("#/sessions/bench-1"));
    let tell = |list: &str, id: &str| {
        let changed = stream_message::Message::Changed(Changed { list: list.into(), id: id.into() });
        let message = StreamMessage { message: Some(changed), dropped: 0 };
        deliver(&api, [ApiEvent::SocketMessage(message.encode_to_vec())]);
    };
    api.0.borrow_mut().sent.clear();
    tell("sessions", "bench-1");
    harness.run_steps(4);
    let sent = std::mem::take(&mut api.0.borrow_mut().sent);
    for asked in [Request::Sessions, Request::Session("bench-1".into()), Request::Check("bench-1".into())] {
        assert!(sent.contains(&asked), "{asked:?} is not among {sent:?}");
    }
    let mut harness = page(&api, &FakeWindow::at("#/diagnose/bench-1"));
    api.0.borrow_mut().sent.clear();
    tell("models", "bench-fit");
    harness.run_steps(4);
    let sent = std::mem::take(&mut api.0.borrow_mut().sent);
    assert!(sent.contains(&Request::Models) && sent.contains(&Request::Diagnoses), "{sent:?}");
}

#[test]
fn screens_without_the_live_hand_draw_the_stream_less_often() {
    let mut bench = Bench::of(FakeWindow::at("#/home"), &nothing_recorded(), [1280.0, 800.0]);
    for &screen in Screen::ALL {
        bench.window.0.borrow_mut().entries.push(format!("#/{}", screen.label().to_lowercase()));
        bench.harness.run_steps(4);
        assert_eq!(app(&bench.harness).screen(), screen);
        let shows_it = matches!(screen, Screen::Hand | Screen::Record | Screen::Timelines);
        let within_ms = bench.api.0.borrow().stream_within.as_millis();
        // The next frame, but not zero: egui would draw two.
        assert_eq!(within_ms, if shows_it { 1 } else { 200 }, "{screen:?}");
    }
}

#[test]
fn on_a_phone_the_hand_has_every_taxel_and_nothing_over_another() {
    let window = FakeWindow::at("#/hand/bench-1?take=take-01");
    let harness = page_of(&full_api(), &window, [390.0, 844.0]);
    let rects = |names: &[&str]| {
        names.iter().map(|name| harness.get_by_label(name).rect()).collect::<Vec<egui::Rect>>()
    };
    let row = rects(&["One frame back", "Play", "One frame on"]);
    assert!(row.is_sorted_by(|left, right| left.right() <= right.left()), "{row:?}");
    let slider = rects(&["Time in the take"])[0];
    assert!(slider.bottom() <= row[0].top() && slider.width() > 200.0, "{slider:?}");
    let taxels: Vec<egui::Rect> =
        harness.get_all_by_label_contains("not active").map(|taxel| taxel.rect()).collect();
    assert_eq!(taxels.len(), crate::fixture::station().layout.num_channels());
    let page = egui::Rect::from_min_max(egui::pos2(68.0, 200.0), egui::pos2(390.0, slider.top()));
    assert!(taxels.iter().all(|taxel| page.contains_rect(*taxel)), "{taxels:?}");
}

#[test]
fn a_button_that_is_pressed_for_long_is_pressed() {
    let mut harness = page(&full_api(), &FakeWindow::at("#/home"));
    let pos = harness.get_by_role_and_label(Role::Button, "Jobs").rect().center();
    let (button, modifiers) = (egui::PointerButton::Primary, Modifiers::NONE);
    harness.event(egui::Event::PointerMoved(pos));
    harness.event(egui::Event::PointerButton { pos, button, pressed: true, modifiers });
    // Each step is 20 ms.
    harness.run_steps(150);
    harness.event(egui::Event::PointerButton { pos, button, pressed: false, modifiers });
    harness.run_steps(4);
    assert_eq!(app(&harness).screen(), Screen::Jobs);
}

#[test]
fn a_picture_shows_the_screen_without_the_bars() {
    let window = FakeWindow::at("#/timelines/bench-1/take-01");
    let mut harness = page(&full_api(), &window);
    let asked = |harness: &Harness<'static, Option<StudioApp>>| {
        let output = &harness.output().viewport_output[&egui::ViewportId::ROOT];
        output.commands.iter().find_map(|command| match command {
            egui::ViewportCommand::Screenshot(callback) => Some(callback.clone()),
            _ => None,
        })
    };
    harness.get_by_role_and_label(Role::Button, "Save picture").click();
    let mut wanted = None;
    for _ in 0..4 {
        harness.step();
        wanted = wanted.or_else(|| asked(&harness));
    }
    let image = std::sync::Arc::new(egui::ColorImage::filled([1280, 800], egui::Color32::WHITE));
    wanted.expect("the frame after the press is asked for").complete(image);
    harness.run_steps(2);
    let pictures = &window.0.borrow().pictures;
    let [(name, [width, height])] = &pictures[..] else { panic!("{pictures:?}") };
    assert_eq!(name, "timelines-bench-1-take-01.png");
    assert!((1000..1280).contains(width) && (600..800).contains(height), "{width} x {height}");
}

//! STOP at every size of the window: nothing lies over it, nothing takes its clicks, and it says how it went.

use egui::{Key, Modifiers, Order, Pos2, Rect, ViewportId, accesskit::Role};
use egui_kittest::kittest::Queryable as _;
use palpate_ui::{api_client::Request, route::Screen};
use palpate_wire::{
    api::{Info, Source},
    proto::{ControlReply, control_request::Request as Command, control_state::Phase},
};

use crate::{
    fixture::{FakeWindow, app},
    live::{Bench, nothing_recorded},
};

/// A narrow phone, a phone, a laptop at 200 %, the smallest wide page, a laptop, a desk.
const SIZES: [[f32; 2]; 6] =
    [[320.0, 640.0], [390.0, 844.0], [640.0, 400.0], [900.0, 600.0], [1280.0, 800.0], [1920.0, 1080.0]];

const LONG: &str = "Bartholomew Maximilian von der Robotikwerkstatt";

fn bench(size: [f32; 2]) -> Bench {
    let mut bench = Bench::of(FakeWindow::at("#/hand"), &nothing_recorded(), size);
    let info = Info {
        name: "palpate".into(),
        version: "0.1.0".into(),
        station: Some("A station with a name that is much longer than the bar of a phone is wide".into()),
        source: Source::Emulated,
        insecure: true,
    };
    bench.api.0.borrow_mut().answer(&Request::Info, serde_json::to_vec(&info).expect("it serialises"));
    // The page asks again after a lost connection.
    crate::fixture::deliver(&bench.api, [palpate_ui::api_client::ApiEvent::SocketClosed]);
    bench.harness.run_steps(110);
    bench.state.holder = LONG.to_owned();
    bench.state.reason = "joint \"index_pip\" is hot; ".repeat(12);
    bench.phase(Phase::Holding);
    bench
}

fn stop_rect(bench: &Bench) -> Rect {
    // The palette lists it too, further left.
    let all = bench.harness.query_all_by_role_and_label(Role::Button, "STOP (software)");
    all.map(|node| node.rect()).max_by(|a, b| a.right().total_cmp(&b.right())).expect("STOP is there")
}

/// What takes clicks or drags where STOP is, besides STOP.
fn in_the_way(bench: &Bench) -> Vec<(Order, Rect)> {
    let stop = stop_rect(bench);
    let screen = bench.harness.ctx.content_rect();
    bench.harness.ctx.viewport_for(ViewportId::ROOT, |viewport| {
        let widgets = &viewport.this_pass.widgets;
        let all = widgets.layers().flat_map(|(layer, widgets)| widgets.iter().map(|w| (layer.order, w)));
        let taking: Vec<(Order, Rect)> = all
            .filter(|(_, widget)| widget.sense.interactive())
            .map(|(order, widget)| (order, widget.interact_rect))
            .collect();
        let is_stop = |order: Order, rect: Rect| order == Order::Debug && rect == stop;
        assert!(taking.iter().any(|(order, rect)| is_stop(*order, *rect)), "STOP can be pressed: {taking:?}");
        taking
            .into_iter()
            .filter(|(order, rect)| {
                let shared = rect.intersect(stop);
                // What shades the page behind a dialog spans all of it, and lies under STOP.
                let shade = rect.width() >= screen.width();
                shared.is_positive() && !is_stop(*order, *rect) && !shade
            })
            .collect()
    })
}

fn press(bench: &mut Bench, at: Pos2, pressed: bool) {
    bench.harness.event(egui::Event::PointerMoved(at));
    bench.harness.event(egui::Event::PointerButton {
        pos: at,
        button: egui::PointerButton::Primary,
        pressed,
        modifiers: Modifiers::NONE,
    });
    bench.harness.step();
}

/// Nothing is in the way of STOP, and a click in its middle stops: once, when it is pressed.
fn stops(bench: &mut Bench, what: &str) {
    let stop = stop_rect(bench);
    let screen = bench.harness.ctx.content_rect();
    assert!(screen.contains_rect(stop) && stop.width() >= 44.0 && stop.height() >= 44.0, "{what}: {stop:?}");
    let others = in_the_way(bench);
    assert!(others.is_empty(), "{what}: {others:?} meet STOP at {stop:?}");
    bench.commands();
    press(bench, stop.center(), true);
    let sent = bench.commands();
    assert!(matches!(sent[..], [(0, Command::Stop(_))]), "{what}: {sent:?}");
    press(bench, stop.center(), false);
    bench.harness.run_steps(2);
    let sent = bench.commands();
    assert!(sent.is_empty(), "{what}: one press is one stop: {sent:?}");
}

#[test]
fn nothing_meets_stop_on_any_screen_at_any_size() {
    for size in SIZES {
        let mut bench = bench(size);
        for &screen in Screen::ALL {
            bench.window.0.borrow_mut().entries.push(format!("#/{}", screen.label().to_lowercase()));
            bench.harness.run_steps(4);
            bench.tell();
            assert_eq!(app(&bench.harness).screen(), screen, "{size:?}");
            bench.harness.get_by_label_contains("Open to the network without a login");
            stops(&mut bench, &format!("{size:?} {screen:?}"));
        }
    }
}

#[test]
fn dialogs_palette_and_menus_take_nothing_from_stop() {
    for size in SIZES {
        let mut bench = bench(size);
        bench.harness.key_press_modifiers(Modifiers::COMMAND, Key::K);
        bench.harness.run_steps(4);
        bench.harness.get_by_label("Command");
        stops(&mut bench, &format!("{size:?} palette"));
        bench.harness.get_by_label("Command");
        bench.harness.key_press(Key::Escape);
        bench.harness.run_steps(3);
        bench.harness.event(egui::Event::Text("?".into()));
        bench.harness.run_steps(4);
        bench.harness.get_by_label("Close shortcuts");
        stops(&mut bench, &format!("{size:?} shortcuts"));
        bench.harness.key_press(Key::Escape);
        bench.harness.run_steps(3);
        let menu = bench.harness.query_by_role_and_label(Role::Button, "Menu").is_some();
        assert_eq!(menu, size[0] < 900.0);
        if menu {
            bench.click("Menu");
            bench.harness.run_steps(3);
            bench.harness.get_by_role_and_label(Role::Button, "Take over");
            stops(&mut bench, &format!("{size:?} menu"));
            // A click outside closes it.
            assert!(!bench.can("Take over"));
            bench.click("Menu");
            bench.harness.run_steps(3);
        }
        bench.click("Take over");
        bench.harness.run_steps(3);
        bench.harness.get_by_label_contains("Take control from Bartholomew");
        stops(&mut bench, &format!("{size:?} take over"));
        bench.click(&format!("Take over from {LONG}"));
        bench.harness.run_steps(3);
        bench.harness.get_by_label("Who sits here?");
        stops(&mut bench, &format!("{size:?} name"));
        bench.harness.get_by_label("Who sits here?");
    }
}

#[test]
fn a_palette_that_was_open_in_a_larger_window_takes_nothing_from_stop_in_a_smaller_one() {
    let mut bench = bench([320.0, 640.0]);
    bench.harness.key_press_modifiers(Modifiers::COMMAND, Key::K);
    bench.harness.run_steps(4);
    bench.harness.get_by_label("Command");
    bench.harness.key_press(Key::Escape);
    bench.harness.run_steps(3);
    bench.harness.set_size(egui::vec2(640.0, 400.0));
    bench.harness.run_steps(2);
    bench.harness.key_press_modifiers(Modifiers::COMMAND, Key::K);
    // In its first frames the palette has the height of the larger window.
    for frame in 0..4 {
        bench.harness.step();
        assert_eq!(in_the_way(&bench), [], "frame {frame}");
    }
    bench.harness.get_by_label("Command");
}

#[test]
fn tooltips_and_refusals_take_nothing_from_stop() {
    for size in SIZES {
        let mut bench = bench(size);
        for sequence in 1..4 {
            bench.answer(ControlReply { sequence, problem: "x ".repeat(300), ..Default::default() });
        }
        let stop = stop_rect(&bench);
        bench.harness.event(egui::Event::PointerMoved(stop.center()));
        bench.harness.run_steps(80);
        bench.tell();
        stops(&mut bench, &format!("{size:?} tooltip"));
    }
}

#[test]
fn second_finger_stops_while_the_first_holds_something() {
    let mut bench = bench([390.0, 844.0]);
    bench.commands();
    let stop = stop_rect(&bench);
    bench.harness.event(egui::Event::Touch {
        device_id: egui::TouchDeviceId(1),
        id: egui::TouchId(2),
        phase: egui::TouchPhase::Start,
        pos: stop.center(),
        force: None,
    });
    bench.harness.step();
    assert!(matches!(bench.commands()[..], [(0, Command::Stop(_))]));
}

#[test]
fn narrow_bar_has_the_state_and_the_rest_is_in_the_menu() {
    let mut bench = Bench::of(FakeWindow::of("Ada", "#/sessions"), &nothing_recorded(), [390.0, 844.0]);
    bench.harness.get_by_label("DISARMED");
    assert!(bench.harness.query_by_role_and_label(Role::Button, "Take control").is_none());
    bench.click("Menu");
    bench.harness.run_steps(3);
    bench.click("Take control");
    bench.reply(4, "");
    bench.commands();
    bench.click("Menu");
    bench.harness.run_steps(3);
    bench.click("Arm");
    assert!(matches!(bench.commands()[..], [(4, Command::Arm(_))]));
}

#[test]
fn stop_is_stopping_until_it_is_answered_and_then_confirmed() {
    let mut bench = Bench::at("#/sessions");
    bench.take_control_and_arm();
    bench.click("STOP (software)");
    bench.harness.get_by_label("Stopping\u{2026}");
    // The reply to a later request overtakes it, and the station tells that it is stopped before it is confirmed.
    bench.answer(ControlReply { sequence: 90, accepted: true, lease: 4, ..Default::default() });
    bench.phase(Phase::Stopped);
    bench.harness.get_by_label("Stopping\u{2026}");
    let sequence = bench.api.0.borrow().commands.last().map_or(0, |command| command.sequence);
    bench.answer(ControlReply {
        sequence,
        accepted: true,
        lease: 4,
        stop_confirmed: true,
        ..Default::default()
    });
    bench.harness.get_by_label("Stopped, confirmed");
    assert!(bench.harness.query_by_label("Stopping\u{2026}").is_none());
    bench.phase(Phase::Disarmed);
    assert!(bench.harness.query_by_label("Stopped, confirmed").is_none(), "it was reset");
}

#[test]
fn stop_that_cannot_be_confirmed_says_what_and_stays_until_dismissed() {
    let mut bench = Bench::at("#/sessions");
    bench.take_control_and_arm();
    bench.click("STOP (software)");
    let sequence = bench.api.0.borrow().commands.last().map_or(0, |command| command.sequence);
    let problem = "device \"xarm\" has not answered since the stop; cut its power";
    bench.answer(ControlReply {
        sequence,
        accepted: true,
        problem: problem.to_owned(),
        lease: 4,
        stop_confirmed: false,
    });
    bench.phase(Phase::Stopped);
    bench.harness.get_by_label(problem);
    bench.harness.get_by_label("14:03:12: STOP is not confirmed.");
    bench.harness.get_by_label("Stop not confirmed");
    bench.click("Dismiss notice");
    assert!(bench.harness.query_by_label(problem).is_none());
}

#[test]
fn long_names_leave_the_connection_readable_and_buttons_on_the_page() {
    for width in [900.0, 1000.0, 1280.0] {
        let mut bench = Bench::of(
            FakeWindow::at("#/timelines/bench-1?take=take-01"),
            &nothing_recorded(),
            [width, 800.0],
        );
        crate::fixture::app_mut(&mut bench.harness).playback.session = Some(LONG.to_owned());
        bench.state.holder = LONG.to_owned();
        bench.phase(Phase::Stopped);
        let stop = stop_rect(&bench);
        let connected = bench.harness.get_by_label("Connected").rect();
        let link = bench.harness.get_by_role_and_label(Role::Button, "Copy link").rect();
        assert!(link.right() <= connected.left(), "{width}: {link:?} {connected:?}");
        if let Some(model) = bench.harness.query_by_label("nominal only") {
            assert!(model.rect().right() <= connected.left(), "{width}: {:?} {connected:?}", model.rect());
        }
        let over = bench.harness.get_by_role_and_label(Role::Button, "Take over").rect();
        assert!(over.right() <= stop.left(), "{width}: {over:?} {stop:?}");
    }
}

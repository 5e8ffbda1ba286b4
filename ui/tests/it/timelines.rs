//! The timelines on a take whose nominal simulation lags by three frames.

use egui::{Key, accesskit::Role};
use egui_kittest::{Harness, kittest::Queryable as _};
use palpate_ui::{StudioApp, playback::ModelRef, route::Screen};

use crate::fixture::{FRAME_S, FakeWindow, LAG_FRAMES, app, app_mut, full_api, page, page_of, station};

fn open() -> Harness<'static, Option<StudioApp>> {
    page(&full_api(), &FakeWindow::at("#/timelines/bench-1?take=take-01"))
}

fn time_s(harness: &Harness<'static, Option<StudioApp>>) -> f64 {
    app(harness).playback.time_s
}

#[test]
fn every_stream_and_touched_channel_has_a_named_lane() {
    let harness = open();
    let station = station();
    for stream in &station.layout.streams {
        harness.get_by_role_and_label(Role::Image, &format!("{}, any", stream.label));
    }
    for channel in 0..station.layout.num_channels() {
        harness.get_by_role_and_label(Role::Button, &station.layout.channel_label(channel));
    }
}

#[test]
fn lane_says_what_the_cursor_is_on() {
    let mut harness = open();
    let channel = station().layout.channel_label(0);
    // The first contact of channel 0 is real from frame 20 on, and simulated LAG_FRAMES later.
    app_mut(&mut harness).playback.seek(20.5 * FRAME_S);
    harness.run_steps(2);
    let value = harness.get_by_label(&channel).value().expect("the lane has a value");
    assert!(value.contains("real touched, nominal not touched"), "{value}");
    app_mut(&mut harness).playback.seek((20.5 + LAG_FRAMES as f64) * FRAME_S);
    harness.run_steps(2);
    let value = harness.get_by_label(&channel).value().expect("the lane has a value");
    assert!(value.contains("real touched, nominal touched"), "{value}");
}

#[test]
fn the_time_stands_on_one_row_at_any_width() {
    let mut harness =
        page_of(&full_api(), &FakeWindow::at("#/timelines/bench-1?take=take-01"), [320.0, 844.0]);
    let row = harness.get_by_label("0.000 s of 19.9 s").rect().height();
    for width in (320..=640).step_by(10) {
        harness.set_size(egui::vec2(width as f32, 844.0));
        harness.run_steps(2);
        let time = harness.get_by_label("0.000 s of 19.9 s").rect();
        assert!(
            time.height() == row && time.right() <= width as f32,
            "{width} wide: {time:?}, rows of {row}"
        );
    }
}

#[test]
fn brackets_jump_from_mismatch_to_mismatch() {
    let mut harness = open();
    harness.key_press(Key::CloseBracket);
    harness.run_steps(3);
    assert!((time_s(&harness) - 20.0 * FRAME_S).abs() < 1e-9, "{}", time_s(&harness));
    harness.key_press(Key::CloseBracket);
    harness.run_steps(3);
    assert!((time_s(&harness) - 24.0 * FRAME_S).abs() < 1e-9, "{}", time_s(&harness));
    harness.key_press(Key::OpenBracket);
    harness.run_steps(3);
    assert!((time_s(&harness) - 20.0 * FRAME_S).abs() < 1e-9, "{}", time_s(&harness));
}

#[test]
fn next_mismatch_is_marked_counted_and_brought_into_view() {
    // The page is low, so that not every channel has room on it.
    let api = full_api();
    let mut harness = page_of(&api, &FakeWindow::at("#/timelines/bench-1?take=take-01"), [1280.0, 420.0]);
    let last = station().layout.num_channels() - 1;
    let label = station().layout.channel_label(last);
    app_mut(&mut harness).playback.seek((19 + 4 * last) as f64 * FRAME_S);
    harness.run_steps(2);
    for _ in 0..40 {
        harness.key_press(Key::CloseBracket);
        harness.run_steps(3);
        if harness.query_by_label_contains(&format!(" mismatches: {label}, onset late by 300 ms")).is_some() {
            break;
        }
    }
    harness.get_by_label_contains(&format!(" mismatches: {label}, onset late by 300 ms"));
    assert!((time_s(&harness) - (20 + 4 * last) as f64 * FRAME_S).abs() < 1e-9, "{}", time_s(&harness));
    assert!(view_span_s(&harness) <= 2.0 + 1e-9, "a second on either side, not {} s", view_span_s(&harness));
    harness.run_steps(30);
    let lane = harness.get_by_role_and_label(Role::Button, &label).rect();
    assert!(lane.top() >= 0.0 && lane.bottom() <= 420.0, "{lane:?} is not on the page");
    // Away from it, the count of all of them is back.
    app_mut(&mut harness).playback.seek(0.0);
    harness.run_steps(2);
    harness.get_by_label_contains("mismatches in the channels shown");
}

#[test]
fn model_without_a_gap_leaves_no_mismatch() {
    let mut harness = open();
    harness.get_by_label_contains("mismatches in the channels shown");
    assert!(harness.query_by_label("0 mismatches in the channels shown").is_none());
    app_mut(&mut harness).playback.compared = Some(ModelRef::Saved("bench-fit".into()));
    harness.run_steps(4);
    harness.get_by_label("0 mismatches in the channels shown");
}

#[test]
fn comma_and_period_step_one_frame_and_space_plays() {
    let mut harness = open();
    harness.key_press(Key::Period);
    harness.key_press(Key::Period);
    harness.run_steps(3);
    assert!((time_s(&harness) - 2.0 * FRAME_S).abs() < 1e-9, "{}", time_s(&harness));
    harness.key_press(Key::Comma);
    harness.run_steps(2);
    assert!((time_s(&harness) - FRAME_S).abs() < 1e-9, "{}", time_s(&harness));
    harness.key_press(Key::Space);
    harness.run_steps(10);
    assert!(app(&harness).playback.playing);
    assert!(time_s(&harness) > FRAME_S + 0.1);
}

#[test]
fn cursor_is_a_slider_that_can_be_set() {
    let mut harness = open();
    harness.get_by_role_and_label(Role::Slider, "Time cursor").set_value_accesskit(7.25);
    harness.run_steps(2);
    assert!((time_s(&harness) - 7.25).abs() < 1e-9);
}

#[test]
fn click_puts_the_cursor_and_drag_moves_the_view() {
    let mut harness = open();
    let name = format!("{}, any", station().layout.streams[0].label);
    let lane = harness.get_by_role_and_label(Role::Image, &name);
    let y = lane.rect().center().y;
    let ruler = harness.get_by_label("Time cursor").rect();
    let centre = egui::pos2(ruler.center().x, y);
    harness.drag_at(centre);
    harness.run_steps(2);
    harness.drop_at(centre);
    harness.run_steps(3);
    // The view shows the whole take with the same margin on both sides.
    let middle_s = app(&harness).playback.duration_s / 2.0;
    assert!((time_s(&harness) - middle_s).abs() < 0.1, "{} {middle_s}", time_s(&harness));
}

#[test]
fn wheel_zooms_at_the_pointer_and_fit_shows_all_again() {
    let mut harness = open();
    let ruler = harness.get_by_label("Time cursor").rect();
    let whole = view_span_s(&harness);
    harness.hover_at(ruler.center() + egui::vec2(100.0, 60.0));
    harness.step();
    for _ in 0..5 {
        harness.event(egui::Event::MouseWheel {
            unit: egui::MouseWheelUnit::Point,
            delta: egui::vec2(0.0, 120.0),
            modifiers: egui::Modifiers::NONE,
            phase: egui::TouchPhase::Move,
            source: egui::MouseWheelSource::Unknown,
        });
    }
    harness.run_steps(30);
    assert!(view_span_s(&harness) < whole / 3.0, "{} of {whole}", view_span_s(&harness));
    harness.key_press(Key::F);
    harness.run_steps(3);
    assert!((view_span_s(&harness) - whole).abs() < 1e-6);
}

fn view_span_s(harness: &Harness<'static, Option<StudioApp>>) -> f64 {
    app(harness).shown_span_s(Screen::Timelines).expect("a take is open")
}

#[test]
fn pressing_a_name_pins_the_channel() {
    let mut harness = open();
    let channel = station().layout.channel_label(1);
    harness.get_by_role_and_label(Role::Button, &channel).click();
    harness.run_steps(3);
    assert_eq!(app(&harness).playback.pinned, Some(1));
}

#[test]
fn take_that_does_not_fit_its_station_says_so() {
    use palpate_ui::api_client::Request;
    use prost::Message as _;
    let api = full_api();
    let mut trace = crate::fixture::take_trace(&station());
    trace.streams[0].stream = "whiskers".into();
    let request = Request::Take { session: "bench-1".into(), take: "take-01".into() };
    api.0.borrow_mut().answer(&request, trace.encode_to_vec());
    let harness = page(&api, &FakeWindow::at("#/timelines/bench-1?take=take-01"));
    harness.get_by_label_contains("This take cannot be drawn");
    harness.get_by_label_contains("whiskers");
}

/// A measurement, not a law: run it alone, optimised, with `--ignored --nocapture`.
#[test]
#[ignore = "measures time; says how long a frame of ten busy minutes takes"]
fn ten_minutes_of_every_channel_at_sixty_frames_a_second() {
    use palpate_messages::bits;
    use palpate_ui::api_client::Request;
    use palpate_wire::proto::{ReplayTrace, TakeTrace};
    use prost::Message as _;
    let station = station();
    let num_channels = station.layout.num_channels();
    let num_frames = 6000;
    // A contact every second frame: nothing is harder to draw.
    let active = |shift: usize| {
        bits::pack(
            (0..num_frames).flat_map(|f| (0..num_channels).map(move |c| (f + c + shift).is_multiple_of(2))),
        )
    };
    let mut trace = crate::fixture::take_trace(&station);
    trace = TakeTrace {
        frame_times_s: (0..num_frames).map(|frame| frame as f64 * 0.1).collect(),
        joint_positions: vec![0.0; num_frames * station.robot.num_dofs()],
        real_active: active(0),
        ..trace
    };
    for (stream, info) in trace.streams.iter_mut().zip(&station.layout.streams) {
        let num_samples = 60_000;
        let width = info.channels.len();
        stream.times_s = (0..num_samples).map(|sample| sample as f64 * 0.01).collect();
        stream.raw = (0..num_samples * width).map(|value| ((value * 7919) % 1000) as f32).collect();
        stream.active = bits::pack(std::iter::repeat_n(false, num_samples * width));
    }
    let api = full_api();
    let (session, take) = ("bench-1".to_owned(), "take-01".to_owned());
    let request = Request::Take { session: session.clone(), take: take.clone() };
    api.0.borrow_mut().answer(&request, trace.encode_to_vec());
    let replay = ReplayTrace { active: active(1), ..Default::default() };
    let request = Request::Replay { session, take, model: ModelRef::Nominal };
    api.0.borrow_mut().answer(&request, replay.encode_to_vec());
    let mut harness = page(&api, &FakeWindow::at("#/timelines/bench-1?take=take-01"));
    harness.get_by_label("Time cursor");
    let start = std::time::Instant::now();
    let num_steps = 60;
    for step in 0..num_steps {
        app_mut(&mut harness).playback.seek(f64::from(step) * 10.0);
        harness.step();
        let output = harness.output();
        let shapes = output.shapes.clone();
        std::hint::black_box(harness.ctx.tessellate(shapes, 1.0));
    }
    let per_frame_ms = start.elapsed().as_secs_f64() * 1e3 / f64::from(num_steps);
    println!("{per_frame_ms:.2} ms a frame with {num_channels} channels");
}

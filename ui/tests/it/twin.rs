//! The live twin on Timelines: real beside simulated touch, the model, agreement, warnings, and what is missing.

use egui::accesskit::Role;
use egui_kittest::kittest::{NodeT as _, Queryable as _};
use palpate_messages::bits;
use palpate_ui::{
    api_client::{ApiEvent, Request},
    playback::HandSource,
    route::Screen,
};
use palpate_wire::{
    api::LiveModel,
    proto::{LiveFrame, StreamMessage, TaxelWarning, TwinStatus, stream_message},
};
use prost::Message as _;

use crate::{
    fixture::{FakeWindow, app, deliver, full_api, page, without_station},
    live::Bench,
};

/// Six seconds of a station that is touched on channel 2 from the third on; the twin feels it half a second later.
fn touched(bench: &mut Bench, model: &str) {
    let channels = bench.station.layout.num_channels();
    for tick in 0..60 {
        let time_s = 10.0 + f64::from(tick) * 0.1;
        let only = |on: bool| bits::pack((0..channels).map(move |channel| on && channel == 2));
        let mut agreement = vec![1.0; channels];
        agreement[2] = 0.62;
        bench.state.twin = Some(TwinStatus {
            model: model.to_owned(),
            active: only(tick >= 35),
            agreement,
            time_s: time_s - 0.05,
            problem: String::new(),
        });
        send(bench, time_s, only(tick >= 30));
    }
    bench.harness.run_steps(3);
}

fn send(bench: &Bench, time_s: f64, active: Vec<u8>) {
    let frame = LiveFrame {
        time_s,
        joint_positions: vec![0.0; bench.station.robot.num_dofs()],
        active,
        object: "sphere_50mm".to_owned(),
        control: Some(bench.state.clone()),
        ..LiveFrame::default()
    };
    let message = StreamMessage { message: Some(stream_message::Message::Live(frame)), dropped: 0 };
    deliver(&bench.api, [ApiEvent::SocketMessage(message.encode_to_vec())]);
}

#[test]
fn live_timelines_set_real_beside_simulated_and_name_the_worst() {
    let mut bench = Bench::at("#/timelines/bench-1?take=take-01");
    bench.harness.get_by_role_and_label(Role::Button, "Live").click();
    bench.harness.run_steps(3);
    assert!(bench.window.current().contains("source=live"), "{}", bench.window.current());
    touched(&mut bench, "nominal");
    bench.harness.get_by_label("LIVE (EMULATED)");
    bench.harness.get_by_label_contains("Real and simulated touch agree for 99.1 %");
    let name = bench.station.layout.channel_label(2);
    let value = |bench: &Bench, name: &str| {
        let node = bench.harness.get_by_role_and_label(Role::Button, name);
        node.accesskit_node().value().unwrap_or_default()
    };
    assert_eq!(value(&bench, &name), "agrees 62 %");
    let first = |bench: &Bench| {
        let tops = (0..4).map(|channel| {
            let name = bench.station.layout.channel_label(channel);
            (bench.harness.get_by_role_and_label(Role::Button, &name).rect().top(), channel)
        });
        tops.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, channel)| channel)
    };
    assert_eq!(first(&bench), Some(0), "by patch, they stay where they are");
    bench.harness.get_by_role_and_label(Role::Button, "Worst first").click();
    bench.harness.run_steps(3);
    assert_eq!(first(&bench), Some(2));
    bench.click(&name);
    assert_eq!(app(&bench.harness).playback.pinned, Some(2));
    // "Back" leads to the take.
    bench.window.back();
    bench.harness.run_steps(3);
    assert_eq!(app(&bench.harness).playback.hand_source, HandSource::Recorded);
}

#[test]
fn warnings_name_the_taxel_and_say_what_to_do() {
    let mut bench = Bench::at("#/timelines?source=live");
    let id = bench.station.layout.channels[2].id.clone();
    let text = format!("{id} has felt nothing for a minute while the simulator did; check its cable");
    bench.state.taxels = vec![TaxelWarning { channel: 2, kind: "dead".to_owned(), text }];
    touched(&mut bench, "nominal");
    let name = bench.station.layout.channel_label(2);
    let expected =
        format!("{name}, dead: has felt nothing for a minute while the simulator did; check its cable");
    bench.harness.get_by_label_contains(&expected).click();
    bench.harness.run_steps(2);
    assert_eq!(app(&bench.harness).playback.pinned, Some(2));
}

#[test]
fn the_model_is_chosen_and_a_refusal_is_said() {
    let mut bench = Bench::at("#/timelines?source=live");
    touched(&mut bench, "nominal");
    let fit = Request::SetLiveModel(LiveModel { model: "bench-fit".to_owned() });
    bench.harness.get_by_role_and_label(Role::ComboBox, "Model of the live twin").click();
    bench.harness.run_steps(4);
    bench.harness.get_by_role_and_label(Role::ListBoxOption, "Bench fit").click();
    bench.harness.run_steps(4);
    assert!(bench.api.0.borrow().sent.contains(&fit));
    bench.harness.get_by_label_contains("The twin keeps its model: nothing at PUT /api/v1/live/model");
    bench.api.0.borrow_mut().answer(&fit, Vec::new());
    bench.harness.get_by_role_and_label(Role::ComboBox, "Model of the live twin").click();
    bench.harness.run_steps(4);
    bench.harness.get_by_role_and_label(Role::ListBoxOption, "Bench fit").click();
    bench.harness.run_steps(4);
    assert!(bench.harness.query_by_label_contains("The twin keeps its model").is_none());
    touched(&mut bench, "Bench fit");
    let combo = bench.harness.get_by_role_and_label(Role::ComboBox, "Model of the live twin");
    assert_eq!(combo.accesskit_node().value().as_deref(), Some("Bench fit"));
}

#[test]
fn what_is_missing_is_said_with_what_to_do() {
    // No station at all.
    let api = full_api();
    api.0.borrow_mut().answer(&Request::Info, serde_json::to_vec(&without_station()).expect("it serialises"));
    let mut harness = page(&api, &FakeWindow::at("#/timelines?source=live"));
    harness.get_by_label("No live station");
    harness.get_by_role_and_label(Role::Button, "Look at recordings").click();
    harness.run_steps(4);
    assert_eq!(app(&harness).playback.hand_source, HandSource::Recorded);

    // No object, then a simulator that cannot follow, then a station that went away.
    let mut bench = Bench::at("#/timelines?source=live");
    bench.state.twin = Some(TwinStatus { model: "nominal".to_owned(), time_s: 9.9, ..TwinStatus::default() });
    send(&bench, 10.0, Vec::new());
    bench.harness.run_steps(3);
    bench.harness.get_by_label("Only the real touch is shown.");
    if let Some(twin) = &mut bench.state.twin {
        twin.problem = "joint \"index_pip\" is no number".to_owned();
    }
    send(&bench, 10.1, Vec::new());
    bench.harness.run_steps(3);
    bench.harness.get_by_label_contains("The simulator cannot follow: joint \"index_pip\" is no number");
    bench.harness.run_steps(110);
    bench.harness.get_by_label("FROZEN SINCE 14:03:12");
    if let Some(twin) = &mut bench.state.twin {
        twin.problem = String::new();
    }
    send(&bench, 15.0, Vec::new());
    bench.harness.run_steps(3);
    bench.click("Go to Record");
    assert_eq!(app(&bench.harness).screen(), Screen::Record);
}

#[test]
fn a_still_hand_is_told_to_move() {
    let mut bench = Bench::at("#/timelines?source=live");
    let channels = bench.station.layout.num_channels();
    bench.state.twin = Some(TwinStatus {
        model: "nominal".to_owned(),
        active: bits::pack((0..channels).map(|_| false)),
        agreement: vec![1.0; channels],
        time_s: 9.9,
        problem: String::new(),
    });
    send(&bench, 10.0, bits::pack((0..channels).map(|_| false)));
    bench.harness.run_steps(3);
    bench.harness.get_by_label_contains("move the hand to compare the two");
}

/// "Index tip 1 is dead" must not lead to the taxel beside the dead one.
#[test]
fn a_taxel_has_the_number_of_its_id_wherever_it_is_named() {
    let layout = crate::fixture::station().layout;
    let mut num_numbered = 0;
    for (idx, channel) in layout.channels.iter().enumerate() {
        let label = layout.channel_label(idx);
        if let Some((_, number)) = label.split_once(" \u{b7} ") {
            num_numbered += 1;
            assert_eq!(channel.id.rsplit('.').next(), Some(number), "{label} is {}", channel.id);
        }
    }
    assert!(num_numbered > 0);
}

//! A live station on the page: who commands, arming, STOP, joints, devices, and what is shown when it goes away.

use std::path::Path;

use base64::Engine as _;
use egui::{Key, Modifiers, accesskit::Role};
use egui_kittest::{
    Harness,
    kittest::{NodeT as _, Queryable as _},
};
use palpate_robot_model::Station;
use palpate_ui::{
    StudioApp,
    api_client::{ApiEvent, Request},
    playback::HandSource,
    route::Screen,
};
use palpate_wire::{
    api::{RecordingDocument, StationDocument},
    proto::{
        ControlReply, ControlState, DeviceStatus, LiveFrame, MotorStatus, StreamMessage, TaxelWarning,
        control_request::Request as Command, control_state::Phase, device_status::Link, stream_message,
    },
};
use prost::Message as _;

use crate::fixture::{FakeWindow, SharedApi, app, app_mut, deliver, full_api, page_of};

/// The page before the arm with its hand.
pub(crate) struct Bench {
    pub(crate) api: SharedApi,
    pub(crate) window: FakeWindow,
    pub(crate) station: Station,
    pub(crate) harness: Harness<'static, Option<StudioApp>>,
    /// What the station says next.
    pub(crate) state: ControlState,
}

fn leap() -> Station {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/stations");
    Station::read("xarm6_leap.toml", |path| {
        std::fs::read(folder.join(path)).map_err(|err| format!("{path}: {err}"))
    })
    .expect("the shipped station is sound")
}

fn document(station: &Station) -> Vec<u8> {
    let encode = |bytes: &Vec<u8>| base64::engine::general_purpose::STANDARD.encode(bytes);
    let files_base64 =
        station.files.files.iter().map(|(path, bytes)| (path.clone(), encode(bytes))).collect();
    let document = StationDocument { station_toml: station.files.station_toml.clone(), files_base64 };
    serde_json::to_vec(&document).expect("it serialises")
}

/// No session, and no plan for one.
pub(crate) fn nothing_recorded() -> RecordingDocument {
    RecordingDocument { revision: 0, plans: Vec::new(), wanted: Vec::new(), session: None, free: None }
}

impl Bench {
    /// Ada's page at `hash` after the first live frame of a disarmed station that nobody has.
    pub(crate) fn new(hash: &str, recording: &RecordingDocument) -> Self {
        Self::of(FakeWindow::of("Ada", hash), recording, [1280.0, 800.0])
    }

    /// The same in a window of `size` points.
    pub(crate) fn of(window: FakeWindow, recording: &RecordingDocument, size: [f32; 2]) -> Self {
        Self::on(full_api(), window, recording, size)
    }

    /// The same, with what else `api` answers.
    pub(crate) fn on(
        api: SharedApi,
        window: FakeWindow,
        recording: &RecordingDocument,
        size: [f32; 2],
    ) -> Self {
        let station = leap();
        api.0.borrow_mut().answer(&Request::LiveStation, document(&station));
        let recording = serde_json::to_vec(recording).expect("it serialises");
        api.0.borrow_mut().answer(&Request::Recording, recording);
        let harness = page_of(&api, &window, size);
        let state = ControlState { loop_hz: 100.0, latency_ms: 12.4, ..Default::default() };
        let mut bench = Self { api, window, station, harness, state };
        bench.phase(Phase::Disarmed);
        bench
    }

    pub(crate) fn at(hash: &str) -> Self {
        Self::new(hash, &nothing_recorded())
    }

    /// The station says that it is in `phase`, and the page comes to rest.
    pub(crate) fn phase(&mut self, phase: Phase) {
        self.state.set_phase(phase);
        self.tell();
    }

    /// The station says what `state` has.
    pub(crate) fn tell(&mut self) {
        let frame = LiveFrame {
            time_s: 3.0,
            joint_positions: vec![0.0; self.station.robot.num_dofs()],
            active: Vec::new(),
            raw: vec![0.0; self.station.layout.num_channels()],
            rates_hz: vec![100.0, 99.0, 40.0],
            control: Some(self.state.clone()),
            ..Default::default()
        };
        let message = StreamMessage { message: Some(stream_message::Message::Live(frame)), dropped: 0 };
        deliver(&self.api, [ApiEvent::SocketMessage(message.encode_to_vec())]);
        self.harness.run_steps(5);
    }

    pub(crate) fn click(&mut self, name: &str) {
        self.harness.get_by_role_and_label(Role::Button, name).click();
        self.harness.run_steps(3);
    }

    fn tab(&mut self, name: &str) {
        self.harness.get_by_role_and_label(Role::Tab, name).click();
        self.harness.run_steps(3);
    }

    /// Whether the button `name` is there and can be used.
    pub(crate) fn can(&self, name: &str) -> bool {
        let node = self.harness.query_by_role_and_label(Role::Button, name);
        node.is_some_and(|node| !node.accesskit_node().is_disabled())
    }

    /// Commands since the last call, each with its lease.
    pub(crate) fn commands(&self) -> Vec<(u64, Command)> {
        let commands = std::mem::take(&mut self.api.0.borrow_mut().commands);
        commands
            .into_iter()
            .map(|command| (command.lease, command.request.expect("every command asks for something")))
            .collect()
    }

    /// Answers the newest command.
    pub(crate) fn reply(&mut self, lease: u64, problem: &str) {
        let sequence = self.api.0.borrow().commands.last().map_or(1, |command| command.sequence);
        let accepted = problem.is_empty();
        self.answer(ControlReply {
            sequence,
            accepted,
            problem: problem.to_owned(),
            lease,
            ..Default::default()
        });
    }

    /// Delivers a reply.
    pub(crate) fn answer(&mut self, reply: ControlReply) {
        deliver(&self.api, [ApiEvent::ControlMessage(reply.encode_to_vec())]);
        self.harness.run_steps(3);
    }

    /// Bo has control.
    pub(crate) fn bo_has_control(&mut self) {
        self.state.holder = "Bo".to_owned();
        self.tell();
    }

    /// This page has lease 4 and the station is armed at zero.
    pub(crate) fn take_control_and_arm(&mut self) {
        self.click("Take control");
        self.reply(4, "");
        self.state.holder = "Ada".to_owned();
        self.state.commanded = vec![0.0; self.station.robot.num_dofs()];
        self.phase(Phase::Armed);
        self.commands();
    }

    fn dof(&self, joint: &str) -> u32 {
        let dof = self.station.robot.dofs().position(|known| known.name == joint).expect("a joint");
        u32::try_from(dof).expect("few joints")
    }
}

#[test]
fn control_is_taken_by_name_and_kept_alive_until_it_is_given_back() {
    let mut bench = Bench::at("#/timelines");
    bench.harness.get_by_label("Nobody has control");
    assert!(!bench.can("Arm"), "arming needs control");
    bench.click("Take control");
    bench.reply(4, "");
    let sent = bench.commands();
    assert!(matches!(&sent[..], [(0, Command::Acquire(ask))] if ask.operator == "Ada" && !ask.take_over));
    bench.harness.get_by_label("You have control");
    assert_eq!(bench.api.0.borrow().beating, Some(4));
    bench.commands();
    bench.click("Arm");
    assert!(matches!(bench.commands()[..], [(4, Command::Arm(_))]));
    bench.phase(Phase::Armed);
    bench.harness.get_by_label("ARMED");
    bench.click("Disarm");
    assert!(matches!(bench.commands()[..], [(4, Command::Disarm(_))]));
    bench.click("Give back control");
    assert!(matches!(bench.commands()[..], [(4, Command::Release(_))]));
    bench.reply(0, "");
    assert_eq!(bench.api.0.borrow().beating, None);
    bench.harness.get_by_label("Nobody has control");
}

#[test]
fn space_stops_while_armed_whatever_has_the_focus_and_plays_otherwise() {
    let mut bench = Bench::at("#/timelines/bench-1?take=take-01");
    bench.harness.key_press(Key::Space);
    bench.harness.run_steps(2);
    assert!(app(&bench.harness).playback.playing && bench.commands().is_empty());
    bench.harness.key_press(Key::Space);
    bench.harness.run_steps(2);
    bench.take_control_and_arm();
    bench.harness.get_by_role_and_label(Role::Button, "Disarm").focus();
    bench.harness.run_steps(2);
    bench.harness.key_press(Key::Space);
    bench.harness.run_steps(2);
    assert!(matches!(bench.commands()[..], [(4, Command::Stop(_))]), "the focused button does not get it");
    assert!(!app(&bench.harness).playback.playing);
    bench.harness.key_press_modifiers(Modifiers::SHIFT, Key::Space);
    bench.harness.run_steps(2);
    assert!(matches!(bench.commands()[..], [(4, Command::Stop(_))]), "nor does a resting hand spoil it");
}

#[test]
fn space_that_comes_just_after_the_station_disarmed_by_itself_still_stops() {
    let mut bench = Bench::at("#/timelines/bench-1?take=take-01");
    bench.take_control_and_arm();
    bench.phase(Phase::Disarmed);
    bench.harness.key_press(Key::Space);
    bench.harness.run_steps(2);
    assert!(matches!(bench.commands()[..], [(4, Command::Stop(_))]));
    assert!(!app(&bench.harness).playback.playing);

    bench.harness.run_steps(150);
    bench.commands();
    bench.harness.key_press(Key::Space);
    bench.harness.run_steps(2);
    assert!(
        bench.commands().is_empty() && app(&bench.harness).playback.playing,
        "three seconds later it plays"
    );
}

#[test]
fn stop_is_at_hand_on_every_screen_for_everybody() {
    let mut bench = Bench::at("#/hand");
    bench.state.holder = "Bo".to_owned();
    for &screen in Screen::ALL {
        bench.harness.get_by_role_and_label(Role::Button, screen.label()).click();
        bench.harness.run_steps(4);
        assert_eq!(app(&bench.harness).screen(), screen);
        let stop = bench.harness.get_by_role_and_label(Role::Button, "STOP (software)").rect();
        assert!(stop.right() > 1260.0 && stop.top() < 20.0 && stop.height() >= 60.0, "{stop:?}");
        bench.click("STOP (software)");
        let sent = bench.commands();
        assert!(matches!(sent[..], [(0, Command::Stop(_))]), "{screen:?}: {sent:?}");
        bench.tell();
    }
}

#[test]
fn a_station_that_takes_no_commands_has_no_stop_and_no_recording() {
    let mut bench = Bench::at("#/sessions");
    let frame = LiveFrame { time_s: 4.0, ..Default::default() };
    let message = StreamMessage { message: Some(stream_message::Message::Live(frame)), dropped: 0 };
    deliver(&bench.api, [ApiEvent::SocketMessage(message.encode_to_vec())]);
    bench.harness.run_steps(4);
    assert!(bench.harness.query_by_label("STOP (software)").is_none());
    assert!(bench.harness.query_by_role_and_label(Role::Button, "Record").is_none());
}

#[test]
fn a_stop_says_whether_it_came_through_and_what_ends_it() {
    let mut bench = Bench::at("#/sessions");
    bench.take_control_and_arm();
    bench.state.reason = "stopped by Bo; see that nobody is in the way, then reset".to_owned();
    bench.phase(Phase::Stopped);
    bench.harness.get_by_label("STOPPED");
    bench.harness.get_by_label("not confirmed yet");
    bench.harness.get_by_label("stopped by Bo; see that nobody is in the way, then reset");
    bench.state.stop_confirmed = true;
    bench.tell();
    bench.harness.get_by_label("confirmed: no motor moves");
    bench.click("Reset stop");
    assert!(matches!(bench.commands()[..], [(4, Command::ResetStop(_))]));
}

#[test]
fn who_watches_sees_who_commands_and_is_asked_once_before_taking_over() {
    let mut bench = Bench::at("#/hand");
    app_mut(&mut bench.harness).playback.hand_source = HandSource::Live;
    bench.state.holder = "Bo".to_owned();
    bench.phase(Phase::Armed);
    bench.harness.get_by_label("Bo has control");
    bench.harness.get_by_label_contains("Somebody else has control");
    assert!(!bench.can("Disarm") && !bench.can("Open hand"));
    let slider = bench.harness.get_by_role_and_label(Role::Slider, "index_pip");
    assert!(slider.accesskit_node().is_disabled());
    bench.click("Take over");
    assert!(bench.commands().is_empty(), "it asks first");
    bench.click("Leave it to Bo");
    assert!(bench.harness.query_by_label("Take over from Bo").is_none() && bench.commands().is_empty());
    bench.click("Take over");
    bench.click("Take over from Bo");
    let sent = bench.commands();
    assert!(matches!(&sent[..], [(0, Command::Acquire(ask))] if ask.take_over));
}

#[test]
fn losing_control_to_somebody_is_said() {
    let mut bench = Bench::at("#/sessions");
    bench.take_control_and_arm();
    // The reply to a heartbeat that the page did not list.
    let problem = "lease 4 was taken over by Bo; take control again if you agreed on it";
    bench.answer(ControlReply { sequence: 900, problem: problem.to_owned(), ..Default::default() });
    bench.harness.get_by_label(problem);
    assert_eq!(bench.api.0.borrow().beating, None);
    bench.click("Dismiss");
    assert!(bench.harness.query_by_label(problem).is_none());
}

#[test]
fn a_page_that_nobody_looks_at_says_why_the_station_holds() {
    let mut bench = Bench::at("#/sessions");
    bench.take_control_and_arm();
    bench.window.0.borrow_mut().unwatched = true;
    bench.phase(Phase::Holding);
    bench.harness.get_by_label("HOLDING");
    bench.harness.get_by_label_contains("This window does not have the focus");
}

#[test]
fn without_its_socket_a_stop_is_kept_and_everything_else_dropped() {
    let mut bench = Bench::at("#/hand");
    bench.take_control_and_arm();
    deliver(&bench.api, [ApiEvent::ControlClosed]);
    bench.harness.step();
    bench.harness.get_by_label_contains("Commands have not reached the station since 14:03:12");
    assert!(!bench.can("Disarm"));
    bench.harness.get_by_role_and_label(Role::Button, "STOP (software)").click();
    bench.harness.step();
    bench.harness.step();
    // Attempts to connect again are seconds apart, so the stop has not left yet.
    bench.harness.get_by_label_contains("STOP could not be sent");
    assert!(bench.commands().is_empty());
    bench.harness.run_steps(110);
    assert!(matches!(bench.commands()[..], [(0, Command::Stop(_))]));
    assert!(bench.harness.query_by_label_contains("STOP could not be sent").is_none());
}

#[test]
fn old_frames_are_never_shown_as_live() {
    let mut bench = Bench::at("#/hand");
    bench.take_control_and_arm();
    bench.harness.get_by_label("LIVE (EMULATED)");
    // The socket stays open, and nothing comes any more.
    bench.harness.run_steps(110);
    bench.harness.get_by_label("FROZEN SINCE 14:03:12");
    bench.harness.get_by_label("LAST SEEN ARMED AT 14:03:12");
    bench.harness.get_by_label("not live");
    assert!(!bench.can("Disarm") && !bench.can("Open hand"));
    bench.tell();
    bench.harness.get_by_label("ARMED");
    deliver(&bench.api, [ApiEvent::SocketClosed]);
    bench.harness.step();
    bench.harness.get_by_label("FROZEN SINCE 14:03:12");
    bench.harness.get_by_label_contains("CONNECTION LOST");
}

#[test]
fn taking_control_shows_the_live_hand_with_its_joints() {
    let mut bench = Bench::at("#/hand");
    assert_eq!(app(&bench.harness).playback.hand_source, HandSource::Recorded);
    bench.take_control_and_arm();
    assert_eq!(app(&bench.harness).playback.hand_source, HandSource::Live);
    let joints: Vec<String> = bench.station.robot.dofs().map(|joint| joint.name.clone()).collect();
    let is_carrier = |dof: usize| bench.station.carrier_dofs.contains(&dof);
    let (arm, hand): (Vec<usize>, Vec<usize>) = (0..joints.len()).partition(|&dof| is_carrier(dof));
    for dof in hand {
        bench.harness.get_by_role_and_label(Role::Slider, &joints[dof]);
    }
    bench.tab("Arm joints");
    for dof in arm {
        assert!(bench.can(&format!("{} more", joints[dof])), "{}", joints[dof]);
    }
}

#[test]
fn a_slider_moves_one_joint_by_keys_within_its_limits() {
    let mut bench = Bench::at("#/hand");
    bench.take_control_and_arm();
    bench.harness.get_by_role_and_label(Role::Slider, "index_pip").focus();
    bench.harness.run_steps(2);
    for _ in 0..3 {
        bench.harness.key_press(Key::ArrowRight);
        bench.harness.run_steps(1);
    }
    bench.harness.run_steps(2);
    let sent = bench.commands();
    let dof = bench.dof("index_pip");
    let limits = bench.station.robot.dofs().nth(dof as usize).and_then(|joint| joint.limits).expect("limits");
    let mut last = 0.0;
    assert!(!sent.is_empty());
    for (lease, command) in sent {
        let Command::Targets(targets) = command else { panic!("{command:?}") };
        assert_eq!((lease, &targets.dofs[..]), (4, &[dof][..]));
        assert!(targets.positions[0] > last && targets.positions[0] <= limits.upper);
        last = targets.positions[0];
    }
    // Wherever it was wanted: when the station stops, the slider shows where it is.
    bench.phase(Phase::Stopped);
    let slider = bench.harness.get_by_role_and_label(Role::Slider, "index_pip");
    assert!(slider.accesskit_node().is_disabled());
    assert_eq!(slider.accesskit_node().numeric_value(), Some(0.0));
}

#[test]
fn presets_move_the_hand_and_leave_the_arm() {
    let mut bench = Bench::at("#/hand");
    bench.take_control_and_arm();
    bench.click("Open hand");
    let sent = bench.commands();
    let [(4, Command::Targets(targets))] = &sent[..] else { panic!("{sent:?}") };
    let hand = bench.station.robot.num_dofs() - bench.station.carrier_dofs.len();
    assert_eq!(targets.dofs.len(), hand);
    assert!(targets.dofs.iter().all(|dof| !bench.station.carrier_dofs.contains(&(*dof as usize))));
}

#[test]
fn a_jog_button_steps_when_clicked_and_runs_until_let_go() {
    let mut bench = Bench::at("#/hand");
    bench.take_control_and_arm();
    bench.tab("Arm joints");
    bench.harness.get_by_role_and_label(Role::RadioButton, "Step 1\u{b0}");
    bench.click("joint1 more");
    let sent = bench.commands();
    let [(4, Command::Targets(targets))] = &sent[..] else { panic!("{sent:?}") };
    assert_eq!(targets.dofs, [bench.dof("joint1")]);
    assert!((targets.positions[0] - 1.0_f64.to_radians()).abs() < 1e-9);
    bench.phase(Phase::Holding);
    bench.phase(Phase::Armed);

    let at = bench.harness.get_by_role_and_label(Role::Button, "joint2 less").rect().center();
    let button = |pressed| egui::Event::PointerButton {
        pos: at,
        button: egui::PointerButton::Primary,
        pressed,
        modifiers: Modifiers::NONE,
    };
    bench.harness.event(egui::Event::PointerMoved(at));
    bench.harness.event(button(true));
    bench.harness.run_steps(50);
    let moved = bench.commands();
    assert!(moved.len() >= 3, "held, it goes on: {moved:?}");
    let furthest = moved.iter().map(|(_, command)| match command {
        Command::Targets(targets) => targets.positions[0],
        other => panic!("{other:?}"),
    });
    let furthest = furthest.fold(0.0, f64::min);
    assert!(furthest < -1.5_f64.to_radians(), "it goes on in the direction of the button");
    assert!(furthest >= -3.01_f64.to_radians(), "never far ahead of where the joint is: {furthest}");
    bench.harness.event(button(false));
    bench.harness.run_steps(3);
    let stopped = bench.commands();
    let [(4, Command::Targets(targets))] = &stopped[..] else { panic!("{stopped:?}") };
    assert_eq!(targets.positions, [0.0], "let go, it stays where it is");
}

#[test]
fn lead_through_and_zero_are_commands_too() {
    let mut bench = Bench::at("#/hand");
    bench.take_control_and_arm();
    bench.tab("Arm joints");
    bench.harness.get_by_role_and_label(Role::CheckBox, "Lead-through").click();
    bench.harness.run_steps(3);
    assert!(matches!(bench.commands()[..], [(4, Command::LeadThrough(lead))] if lead.on));
    bench.click("Set zero of touch");
    assert!(matches!(bench.commands()[..], [(4, Command::Tare(_))]));
}

#[test]
fn devices_speak_in_words_and_can_be_cleared() {
    let mut bench = Bench::at("#/hand");
    bench.take_control_and_arm();
    let mut device = DeviceStatus {
        id: "u2d2".to_owned(),
        kind: "dynamixel".to_owned(),
        problem: "servo of index_pip shut down: overload; take the load off, then clear".to_owned(),
        rate_hz: 99.8,
        gaps: 3,
        motors: vec![MotorStatus {
            joint: "index_pip".to_owned(),
            temperature_c: 63.0,
            supply_v: 5.0,
            current_a: 0.2,
            problem: "overload".to_owned(),
        }],
        ..Default::default()
    };
    device.set_link(Link::Fault);
    bench.state.devices = vec![device];
    let text = "has felt nothing for a minute while the simulator did; check its cable";
    bench.state.taxels = vec![TaxelWarning { channel: 2, kind: "dead".to_owned(), text: text.to_owned() }];
    bench.tell();
    bench.tab("Devices");
    bench.harness.get_by_label_contains("servo of index_pip shut down");
    bench.harness.get_by_label_contains("let it cool down");
    bench.harness.get_by_label_contains("3 gaps");
    bench.click("Clear u2d2");
    assert!(matches!(&bench.commands()[..], [(4, Command::ClearFault(clear))] if clear.device == "u2d2"));
    bench.harness.get_by_label_contains(text).click();
    bench.harness.run_steps(2);
    assert_eq!(app(&bench.harness).playback.pinned, Some(2));
}

#[test]
fn refused_commands_say_why_until_dismissed() {
    let mut bench = Bench::at("#/sessions");
    bench.click("Take control");
    bench.reply(4, "");
    bench.click("Arm");
    bench.reply(4, "device \"xarm\" is lost; check its cable and its power, then arm again");
    bench.harness.get_by_label("device \"xarm\" is lost; check its cable and its power, then arm again");
    bench.harness.get_by_label_contains("Arm: refused");
    bench.click("Dismiss");
    assert!(bench.harness.query_by_label_contains("refused").is_none());
}

#[test]
fn palette_commands_the_station_and_lists_nothing_of_it_elsewhere() {
    let mut bench = Bench::at("#/sessions");
    bench.harness.key_press_modifiers(Modifiers::COMMAND, Key::K);
    bench.harness.run_steps(3);
    bench.harness.event(egui::Event::Text("take contr".into()));
    bench.harness.run_steps(2);
    bench.harness.key_press(Key::Enter);
    bench.harness.run_steps(4);
    assert!(matches!(bench.commands()[..], [(0, Command::Acquire(_))]));
    bench.harness.event(egui::Event::Text("?".into()));
    bench.harness.run_steps(3);
    bench.harness.get_by_label("Space while armed");
    let close = bench.harness.get_by_label("Close shortcuts").rect();
    assert!(close.bottom() <= 800.0, "{close:?} must be on the screen");
}

#[test]
fn spaces_can_be_typed_while_armed() {
    let mut bench = Bench::of(FakeWindow::at("#/sessions"), &nothing_recorded(), [1280.0, 800.0]);
    bench.click("Take control");
    bench.state.holder = "Bo".to_owned();
    bench.phase(Phase::Armed);
    bench.harness.key_press(Key::Space);
    bench.harness.run_steps(2);
    assert!(bench.commands().is_empty(), "a name may have spaces");
    bench.click("Cancel");
    bench.harness.key_press(Key::Space);
    bench.harness.run_steps(2);
    assert!(matches!(bench.commands()[..], [(0, Command::Stop(_))]), "anybody may stop");
}

#[test]
fn the_bar_names_what_is_shown_the_live_station_or_a_take() {
    let live = Bench::at("#/hand?source=live");
    live.harness.get_by_label("Live station");
    let recorded = Bench::at("#/timelines/bench-1?take=take-01");
    assert!(recorded.harness.query_by_label("Live station").is_none());
    recorded.harness.get_by_role_and_label(Role::Button, "Session in view: bench-1");
    recorded.harness.get_by_role_and_label(Role::Button, "Take in view: take-01");
}

#[test]
fn rates_are_in_devices_and_in_the_bar_only_where_they_are_wrong() {
    let mut bench = Bench::at("#/hand?source=live");
    bench.state.loop_mean_hz = 100.0;
    bench.state.latency_p95_ms = 20.0;
    bench.tell();
    assert!(bench.harness.query_by_label_contains("loop slow").is_none());
    assert!(bench.harness.query_by_label_contains("ms late").is_none());
    bench.tab("Devices");
    bench.harness.get_by_label("Control loop: 100.0 Hz now, 100.0 mean, 0.0 worst second");
    bench.harness.get_by_label("From a device's byte to this page: 12.4 ms now, 95 of 100 below 20.0 ms");
    bench.state.loop_hz = 60.0;
    bench.state.latency_p95_ms = 300.0;
    bench.tell();
    bench.harness.get_by_label("control loop slow: 60 Hz");
    bench.harness.get_by_label("picture 300 ms late");
}

#[test]
fn page_that_reads_too_slowly_says_so_and_shows_no_count() {
    let mut bench = Bench::at("#/timelines/bench-1?take=take-01");
    assert!(bench.harness.query_by_label("This page lags").is_none());
    deliver(
        &bench.api,
        [ApiEvent::SocketMessage(StreamMessage { message: None, dropped: 18 }.encode_to_vec())],
    );
    bench.harness.run_steps(3);
    bench.harness.get_by_label("This page lags");
    assert!(bench.harness.query_by_label_contains("dropped").is_none());
}

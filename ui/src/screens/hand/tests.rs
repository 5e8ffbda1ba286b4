//! The screen and its scene on the stations that ship: the arm with its hand, and the probe bench.

use std::{cell::RefCell, collections::BTreeMap, path::Path, rc::Rc, sync::LazyLock};

use base64::Engine as _;
use egui::accesskit::Role;
use egui_kittest::{Harness, kittest::Queryable as _};
use nalgebra::{Isometry3, Unit, Vector3};
use palpate_messages::bits;
use palpate_robot_model::{Channel, Station};
use palpate_wire::{
    api::{Info, SessionDetail, SessionSummary, Source, StationDocument, TakeSummary},
    proto::{LiveFrame, ReplayTrace, StreamMessage, StreamTrace, TakeTrace, stream_message},
};
use proptest::prelude::*;
use prost::Message as _;

use super::{
    HandState, View as _,
    camera::{Camera, Ray},
    recorded_shot,
    scene::{Geometry, SceneColors, Shown, Subject, TaxelLook},
    view3d::{Moment, clear_camera, home},
};
use crate::{
    api_client::{ApiEvent, Request},
    playback::{HandSource, ModelRef, Playback},
    route::Route,
    screens::ScreenContext,
    store::Store,
    theme::Palette,
};

const SHOWN: Shown = Shown { object: true, arm: true };

fn station(name: &str) -> Station {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/stations");
    Station::read(&format!("{name}.toml"), |path| {
        std::fs::read(folder.join(path)).map_err(|error| error.to_string())
    })
    .expect("a station that ships")
}

fn stations() -> [Station; 2] {
    ["xarm6_leap", "probe_bench"].map(station)
}

/// Both stations with their meshes, made once for all cases of a property.
static DRAWN: LazyLock<[(Station, Geometry); 2]> = LazyLock::new(|| {
    stations().map(|station| {
        let geometry = Geometry::new(&station);
        (station, geometry)
    })
});

/// A posture within the limits, the same for the same seed.
fn posture(station: &Station, seed: u32) -> Vec<f64> {
    station
        .robot
        .dofs()
        .enumerate()
        .map(|(dof, joint)| {
            let share =
                ((f64::from(seed) * 12.9898 + dof as f64 * 78.233).sin() * 43758.5453).rem_euclid(1.0);
            joint.limits.map_or(0.0, |limits| limits.lower + share * (limits.upper - limits.lower))
        })
        .collect()
}

fn poses(station: &Station, positions: &[f64]) -> Vec<Isometry3<f64>> {
    let mut root_from_link = Vec::new();
    station.robot.forward_kinematics(positions, &mut root_from_link);
    root_from_link
}

fn looks(station: &Station) -> Vec<TaxelLook> {
    vec![TaxelLook { color: [0.5; 3], active: false, marked: false }; station.layout.num_channels()]
}

const COLORS: SceneColors = SceneColors {
    body: [0.8, 0.8, 0.8, 1.0],
    skin: [0.3, 0.3, 0.3, 1.0],
    object: [0.5, 0.5, 0.5, 0.4],
    ghost: [0.1, 0.1, 0.1, 0.3],
    surroundings: [0.1, 0.1, 0.1, 0.25],
};

#[test]
fn the_hand_is_what_hangs_with_all_patches_and_the_views_name_its_parts() {
    let [leap, probe] = stations();
    let geometry = Geometry::new(&leap);
    assert_eq!(leap.robot.links[geometry.hand_root].name, "palm");
    let labels: Vec<_> = geometry.views.iter().map(|view| view.label.as_str()).collect();
    assert_eq!(labels, ["Palm", "Back", "Index", "Middle", "Ring", "Thumb"]);
    let geometry = Geometry::new(&probe);
    let labels: Vec<_> = geometry.views.iter().map(|view| view.label.as_str()).collect();
    assert_eq!(labels, ["Front", "Back", "Cap", "Ring"]);
}

#[test]
fn hiding_arm_and_object_leaves_hand_and_taxels() {
    let leap = station("xarm6_leap");
    let geometry = Geometry::new(&leap);
    let root_from_link = poses(&leap, &posture(&leap, 1));
    let pose = Isometry3::translation(0.4, 0.0, 0.2);
    let count = |shown| {
        geometry
            .instances(&leap, &root_from_link, &looks(&leap), Some(("sphere_50mm", &pose)), &COLORS, shown)
            .len()
    };
    let arm_links = (0..leap.robot.links.len())
        .filter(|&link| {
            leap.robot.links[link].name.starts_with("arm") && !leap.robot.links[link].visuals.is_empty()
        })
        .count();
    assert!(arm_links >= 6);
    assert_eq!(count(SHOWN) - count(Shown { arm: false, ..SHOWN }), arm_links);
    assert_eq!(count(SHOWN) - count(Shown { object: false, ..SHOWN }), 1);
}

#[test]
fn only_what_is_told_to_move_has_a_ghost() {
    let leap = station("xarm6_leap");
    let geometry = Geometry::new(&leap);
    let mut positions = posture(&leap, 3);
    let measured = poses(&leap, &positions);
    assert!(geometry.ghost(&measured, &measured, COLORS.ghost, SHOWN).is_empty());
    assert!(geometry.ghost(&measured, &[], COLORS.ghost, SHOWN).is_empty(), "nothing is commanded");
    let dof = leap.robot.dofs().position(|joint| joint.name == "index_dip").expect("a joint");
    positions[dof] += 0.2;
    let commanded = poses(&leap, &positions);
    let ghosts = geometry.ghost(&measured, &commanded, COLORS.ghost, SHOWN);
    assert!(!ghosts.is_empty() && ghosts.iter().all(|ghost| ghost.color[3] < 1.0));
    let below = |name: &str| leap.robot.links.iter().filter(|link| link.name.starts_with(name)).count();
    assert!(ghosts.len() <= below("index"), "other fingers stay as they are");
    positions[leap.carrier_dofs[0]] += 0.2;
    let turned = poses(&leap, &positions);
    let with_arm = geometry.ghost(&measured, &turned, COLORS.ghost, SHOWN).len();
    let hidden = Shown { object: true, arm: false };
    assert!(geometry.ghost(&measured, &turned, COLORS.ghost, hidden).len() < with_arm);
}

#[test]
fn every_shipped_object_has_a_surface() {
    for station in stations() {
        let geometry = Geometry::new(&station);
        let root_from_link = poses(&station, &posture(&station, 2));
        for id in station.objects.keys() {
            let instances = geometry.instances(
                &station,
                &root_from_link,
                &looks(&station),
                Some((id, &Isometry3::identity())),
                &COLORS,
                SHOWN,
            );
            let object = instances.last().expect("the object comes last");
            assert_eq!(object.color[3], COLORS.object[3], "{id} is glass");
            assert!(geometry.meshes[object.mesh].indices.len() >= 12, "{id}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn everything_drawn_is_finite_and_rigid_in_any_posture(seed in 0u32..1000, which in 0usize..2) {
        let (station, geometry) = &DRAWN[which];
        let root_from_link = poses(station, &posture(station, seed));
        for instance in geometry.instances(station, &root_from_link, &looks(station), None, &COLORS, SHOWN) {
            let m = instance.root_from_mesh;
            prop_assert!(m.iter().all(|value| value.is_finite()));
            let rotation = m.fixed_view::<3, 3>(0, 0);
            let scale = rotation.column(0).norm();
            prop_assert!(scale > 0.0 && (rotation.determinant() / scale.powi(3) - 1.0).abs() < 1e-3);
        }
        prop_assert_eq!(geometry.taxels(station, &root_from_link).len(), station.layout.num_channels());
    }

    #[test]
    fn a_ray_straight_at_a_free_taxel_picks_it(seed in 0u32..1000, which in 0usize..2, pick in 0usize..1000) {
        let (station, geometry) = &DRAWN[which];
        let root_from_link = poses(station, &posture(station, seed));
        let places = geometry.taxels(station, &root_from_link);
        let channel = pick % places.len();
        let place = places[channel];
        // From right before the taxel: a posture drawn by lot may put another finger, or the table, just behind that.
        let ray = Ray { origin: place.position + place.normal.into_inner() * 0.0035, direction: -place.normal };
        prop_assert_eq!(geometry.pick(station, &root_from_link, &ray, 0.0, SHOWN), Some(channel), "{}", station.layout.channels[channel].id);
        // From inside the hand nothing can be pointed at.
        let from_behind = Ray { origin: place.position - place.normal.into_inner() * 0.5, direction: place.normal };
        prop_assert_ne!(geometry.pick(station, &root_from_link, &from_behind, 0.0, SHOWN), Some(channel));
    }

    #[test]
    fn a_group_view_points_the_camera_at_its_taxels(seed in 0u32..1000, view in 0usize..6) {
        let (leap, geometry) = &DRAWN[0];
        let root_from_link = poses(leap, &posture(leap, seed));
        let view = &geometry.views[view];
        let (bounds, toward_eye, up) = geometry.framing(leap, &root_from_link, None, &view.subject);
        let camera = Camera::framing(bounds, toward_eye, up, 1.4);
        for (channel, place) in leap.layout.channels.iter().zip(geometry.taxels(leap, &root_from_link)) {
            let in_view = match &view.subject {
                Subject::Group(group) => leap.layout.patches[channel.patch].group == *group,
                Subject::Front | Subject::Back => true,
            };
            if in_view {
                let ndc = camera.project(&place.position, 1.4).expect("before the eye");
                prop_assert!(ndc[0].abs() < 1.0 && ndc[1].abs() < 1.0, "{} at {ndc:?}", channel.id);
            }
        }
    }
}

#[test]
fn a_finger_before_a_taxel_hides_it() {
    let leap = station("xarm6_leap");
    let geometry = Geometry::new(&leap);
    let root_from_link = poses(&leap, &vec![0.0; leap.robot.num_dofs()]);
    let channel =
        leap.layout.channels.iter().position(|channel| channel.id == "palm_middle").expect("a palm patch");
    let place = geometry.taxels(&leap, &root_from_link)[channel];
    // A ray from the back of the hand, turned so that it is not refused for its direction: through the palm's body.
    let tilted = Unit::new_normalize(place.normal.into_inner() * 0.2 + Vector3::new(0.3, 0.7, 0.0));
    let ray = Ray { origin: place.position - tilted.into_inner() * 0.3, direction: tilted };
    let through_body = geometry.pick(&leap, &root_from_link, &ray, 0.0, SHOWN);
    let free = Ray { origin: place.position + place.normal.into_inner() * 0.1, direction: -place.normal };
    assert_eq!(geometry.pick(&leap, &root_from_link, &free, 0.0, SHOWN), Some(channel));
    assert_ne!(through_body, Some(channel));
}

// ---- the panel ----

const SESSION: &str = "demo";
const TAKE: &str = "take-01";

/// Active in the second second, in every channel; the simulation is 0.2 s late.
fn is_active(time_s: f64, late_s: f64) -> bool {
    (1.0 + late_s..2.0 + late_s).contains(&time_s)
}

fn take_trace(station: &Station) -> TakeTrace {
    let frame_times_s: Vec<f64> = (0..40).map(|frame| f64::from(frame) * 0.1).collect();
    let num_channels = station.layout.num_channels();
    let streams = station
        .layout
        .streams
        .iter()
        .zip(&station.streams)
        .map(|(stream, config)| {
            let times_s: Vec<f64> =
                (0..4 * stream.rate_hz as u32).map(|sample| f64::from(sample) / stream.rate_hz).collect();
            let width = stream.channels.len();
            let raw_of = |t: f64| if is_active(t, 0.0) { config.on_threshold as f32 * 2.0 } else { 0.0 };
            StreamTrace {
                stream: stream.id.clone(),
                raw: times_s.iter().flat_map(|&t| std::iter::repeat_n(raw_of(t), width)).collect(),
                active: bits::pack(
                    times_s.iter().flat_map(|&t| std::iter::repeat_n(is_active(t, 0.0), width)),
                ),
                times_s,
                axes: Vec::new(),
            }
        })
        .collect();
    TakeTrace {
        object_poses: Vec::new(),
        surroundings: Vec::new(),
        joint_positions: frame_times_s
            .iter()
            .flat_map(|_| std::iter::repeat_n(0.1, station.robot.num_dofs()))
            .collect(),
        real_active: bits::pack(
            frame_times_s.iter().flat_map(|&t| std::iter::repeat_n(is_active(t, 0.0), num_channels)),
        ),
        streams,
        spans: Vec::new(),
        frame_times_s,
    }
}

fn replay_trace(station: &Station, take: &TakeTrace) -> ReplayTrace {
    let num_channels = station.layout.num_channels();
    ReplayTrace {
        model: "nominal".to_owned(),
        active: bits::pack(
            take.frame_times_s.iter().flat_map(|&t| std::iter::repeat_n(is_active(t, 0.2), num_channels)),
        ),
        raw: vec![0.001; take.frame_times_s.len() * num_channels],
        thresholds: vec![0.002; num_channels],
    }
}

/// A page with a session of one take, as far as `answered` says.
struct Page {
    store: Store,
    playback: Playback,
    go_to: Option<Route>,
}

fn answer(store: &mut Store, request: Request, body: Vec<u8>) {
    store.receive(ApiEvent::Answer { request, result: Ok(body) }, 0.0, "14:00:00");
}

fn json(value: &impl serde::Serialize) -> Vec<u8> {
    serde_json::to_vec(value).expect("plain data")
}

fn document(station: &Station) -> StationDocument {
    let encode = |bytes: &Vec<u8>| base64::engine::general_purpose::STANDARD.encode(bytes);
    StationDocument {
        station_toml: station.files.station_toml.clone(),
        files_base64: station
            .files
            .files
            .iter()
            .map(|(path, bytes)| (path.clone(), encode(bytes)))
            .collect::<BTreeMap<_, _>>(),
    }
}

fn summary() -> SessionSummary {
    SessionSummary {
        id: SESSION.to_owned(),
        station: "s".to_owned(),
        takes: 1,
        frames: 40,
        duration_s: 4.0,
        objects: vec!["sphere_50mm".to_owned()],
        recorded: String::new(),
        error: None,
    }
}

fn page(station: &Station, source: Source) -> Page {
    page_of(station, source, &take_trace(station))
}

fn page_of(station: &Station, source: Source, trace: &TakeTrace) -> Page {
    let mut store = Store::default();
    let info = Info {
        name: "palpate".into(),
        version: "0".into(),
        station: Some(station.label.clone()),
        source,
        insecure: false,
    };
    answer(&mut store, Request::Info, json(&info));
    answer(&mut store, Request::Sessions, json(&vec![summary()]));
    let take = TakeSummary {
        id: TAKE.to_owned(),
        object: "sphere_50mm".to_owned(),
        object_pose: [0.4, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0],
        primitive: "tap".to_owned(),
        frames: 40,
        duration_s: 4.0,
        accepted: true,
        has_raw: true,
    };
    answer(
        &mut store,
        Request::Session(SESSION.into()),
        json(&SessionDetail { summary: summary(), takes: vec![take] }),
    );
    answer(&mut store, Request::Station(SESSION.into()), json(&document(station)));
    answer(&mut store, Request::LiveStation, json(&document(station)));
    let replay = replay_trace(station, trace);
    answer(&mut store, Request::Take { session: SESSION.into(), take: TAKE.into() }, trace.encode_to_vec());
    let request = Request::Replay { session: SESSION.into(), take: TAKE.into(), model: ModelRef::Nominal };
    answer(&mut store, request, replay.encode_to_vec());
    answer(&mut store, Request::Models, b"[]".to_vec());
    answer(&mut store, Request::Runs, b"[]".to_vec());
    Page { store, playback: Playback::default(), go_to: None }
}

fn harness(page: Page) -> (Harness<'static>, Rc<RefCell<Page>>) {
    let mut state = HandState::default();
    harness_of(page, move |ui, cx| state.ui(ui, cx))
}

fn harness_of(
    page: Page,
    mut show: impl FnMut(&mut egui::Ui, &mut ScreenContext<'_>) + 'static,
) -> (Harness<'static>, Rc<RefCell<Page>>) {
    let page = Rc::new(RefCell::new(page));
    let shared = Rc::clone(&page);
    let harness = Harness::builder().with_size(egui::vec2(1140.0, 740.0)).build_ui(move |ui| {
        let mut page = shared.borrow_mut();
        let page = &mut *page;
        page.playback.begin_frame(0.0);
        let mut cx = ScreenContext {
            store: &mut page.store,
            playback: &mut page.playback,
            palette: Palette::LIGHT,
            route: &Route::default(),
            go_to: &mut page.go_to,
            surface: None,
            now_s: 0.0,
            local_time: &|_| None,
            picked_files: &mut Vec::new(),
            pick_file: &mut false,
        };
        show(ui, &mut cx);
    });
    (harness, page)
}

#[test]
fn no_view_looks_through_what_carries_the_pad() {
    let (bench, geometry) = &DRAWN[1];
    let mut root_from_link = Vec::new();
    for seed in 0..6 {
        bench.robot.forward_kinematics(&posture(bench, seed), &mut root_from_link);
        let moment = Moment {
            station: bench,
            root_from_link: &root_from_link,
            looks: &[],
            object: None,
            commanded_from_link: &[],
            surroundings: &[],
        };
        let opening = home(geometry, &moment, 1.5, SHOWN);
        let named = geometry.views.iter().map(|view| {
            let (bounds, toward_eye, up) = geometry.framing(bench, &root_from_link, None, &view.subject);
            clear_camera(geometry, &moment, bounds, [toward_eye, up], 1.5, SHOWN)
        });
        for camera in named.chain([opening]) {
            let share = geometry.share_in_sight(bench, &root_from_link, &camera.eye(), SHOWN);
            assert!(share >= 0.8, "seed {seed}: {share} from {:?}", camera.eye());
        }
    }
}

#[test]
fn every_taxel_has_a_name_that_says_what_it_reads() {
    for station in stations() {
        let (mut harness, page) = harness(page(&station, Source::Replay));
        harness.run();
        harness.get_by_label("REPLAY");
        let first = station.layout.channel_label(0);
        let unit = |channel: &Channel| station.layout.streams[channel.stream].raw_unit.clone();
        harness.get_by_label(&format!("{first}: 0 {}, not active", unit(&station.layout.channels[0])));
        page.borrow_mut().playback.seek(1.5);
        harness.run();
        for (idx, channel) in station.layout.channels.iter().enumerate() {
            let reading = station.streams[channel.stream].on_threshold * 2.0;
            let label = station.layout.channel_label(idx);
            harness.get_by_label(&format!("{label}: {reading:.0} {}, active", unit(channel)));
        }
    }
}

#[test]
fn clicking_a_taxel_pins_and_selects_it_and_again_lets_it_go() {
    let leap = station("xarm6_leap");
    let (mut harness, page) = harness(page(&leap, Source::Replay));
    harness.run();
    let name = "Thumb tip \u{b7} 3: 0 counts, not active";
    harness.get_by_role_and_label(Role::Button, name).click();
    harness.run();
    let channel = leap.layout.channels.iter().position(|channel| channel.id == "thumb_tip.3");
    assert_eq!(page.borrow().playback.pinned, channel);
    assert!(page.borrow().playback.selected.contains(&channel.expect("a thumb")));
    harness.get_by_label("Trace of Thumb tip \u{b7} 3, 4 s before and after the cursor");
    harness.get_by_label("thumb_tip.3, TwinTac, on link thumb_distal");
    harness.get_by_label("Unpin").click();
    harness.run();
    assert_eq!(page.borrow().playback.pinned, None);
    assert!(page.borrow().playback.selected.is_empty());
}

#[test]
fn simulated_touch_is_never_shown_as_real() {
    let leap = station("xarm6_leap");
    let (mut harness, page) = harness(page(&leap, Source::Replay));
    page.borrow_mut().playback.seek(1.1);
    harness.run();
    let id = leap.layout.channel_label(0);
    harness.get_by_label(&format!("{id}: 300 counts, active"));
    harness.get_by_label("Nominal").click();
    harness.run();
    // The simulation is 0.2 s late.
    assert!(harness.query_by_label(&format!("{id}: 300 counts, active")).is_none());
    harness.get_by_label(&format!("{id}: 0 Pa, not active"));
    // Nothing to compare with yet: unknown, and where to get it.
    harness.get_by_label("Calibrated").click();
    harness.run();
    harness.get_by_label(&format!("{id}: no sample yet"));
    harness.get_by_label("Calibrate first").click();
    harness.run();
    assert!(page.borrow().go_to.is_some());
}

#[test]
fn a_moving_object_is_where_it_was_at_the_time_shown() {
    let leap = station("xarm6_leap");
    let mut trace = take_trace(&leap);
    // 10 mm a frame along x.
    let pose = |frame: u8| [0.01 * f32::from(frame), 0.0, 0.2, 1.0, 0.0, 0.0, 0.0];
    trace.object_poses = (0..40).flat_map(pose).collect();
    for (trace, expected_x_m) in [(trace, 0.105), (take_trace(&leap), 0.4)] {
        let seen = Rc::new(RefCell::new(None));
        let shown = Rc::clone(&seen);
        let (mut harness, page) = harness_of(page_of(&leap, Source::Replay, &trace), move |ui, cx| {
            *shown.borrow_mut() =
                recorded_shot(ui, cx, &mut HandState::default()).and_then(|shot| shot.object);
        });
        page.borrow_mut().playback.seek(1.05);
        harness.run();
        let (object, pose) = seen.borrow().clone().expect("an object");
        assert_eq!(object, "sphere_50mm");
        assert!((pose.translation.x - expected_x_m).abs() < 1e-6, "{pose}");
    }
}

#[test]
fn transport_plays_steps_and_changes_speed() {
    let leap = station("xarm6_leap");
    let (mut harness, page) = harness(page(&leap, Source::Replay));
    harness.run();
    assert!((page.borrow().playback.duration_s - 3.99).abs() < 1e-6);
    harness.get_by_label("One frame on").click();
    harness.run();
    assert!((page.borrow().playback.time_s - 0.1).abs() < 1e-9);
    harness.get_by_label("One frame back").click();
    harness.run();
    assert_eq!(page.borrow().playback.time_s, 0.0);
    harness.get_by_label("Play").click();
    harness.step();
    harness.step();
    assert!(page.borrow().playback.playing);
    page.borrow_mut().playback.playing = false;
    harness.run();
    harness.get_by_role_and_label(Role::ComboBox, "Speed").click();
    harness.run();
    harness.get_by_label("4\u{d7}").click();
    harness.run();
    assert_eq!(page.borrow().playback.speed, 4.0);
    harness.get_by_role_and_label(Role::Slider, "Time in the take");
}

#[test]
fn views_and_switches_are_there_by_name() {
    let leap = station("xarm6_leap");
    let (mut harness, _) = harness(page(&leap, Source::Replay));
    harness.run();
    for view in ["Palm", "Back", "Index", "Middle", "Ring", "Thumb"] {
        harness.get_by_role_and_label(Role::Button, &format!("View: {view}")).click();
        harness.run();
    }
    harness.get_by_role_and_label(Role::Button, "Reset view").click();
    harness.run();
    for switch in ["Object", "Robot arm", "Labels", "Follow"] {
        harness.get_by_role_and_label(Role::CheckBox, switch).click();
        harness.run();
    }
    for key in [egui::Key::R, egui::Key::Num1, egui::Key::Num9] {
        harness.key_press(key);
        harness.run();
    }
}

#[test]
fn live_says_so_and_freezes_in_words_when_the_connection_breaks() {
    let leap = station("xarm6_leap");
    let (mut harness, page) = harness(page(&leap, Source::Emulated));
    page.borrow_mut().playback.hand_source = HandSource::Live;
    harness.step();
    harness.get_by_label("Waiting for the first live frame\u{2026}");
    let frame = LiveFrame {
        time_s: 12.0,
        joint_positions: vec![0.0; leap.robot.num_dofs()],
        active: bits::pack((0..leap.layout.num_channels()).map(|channel| channel == 0)),
        raw: vec![7.0; leap.layout.num_channels()],
        activity: "tap, index tip".to_owned(),
        object: String::new(),
        object_pose: Vec::new(),
        rates_hz: vec![10.0, 100.0, 40.0],
        control: None,
    };
    let message = StreamMessage { message: Some(stream_message::Message::Live(frame)), dropped: 0 };
    page.borrow_mut().store.receive(ApiEvent::SocketOpen, 0.0, "");
    page.borrow_mut().store.receive(ApiEvent::SocketMessage(message.encode_to_vec()), 0.0, "");
    harness.run();
    harness.get_by_label("LIVE (EMULATED)");
    harness.get_by_label("tap, index tip");
    harness.get_by_label(&format!("{}: 7 counts, active", leap.layout.channel_label(0)));
    page.borrow_mut().store.receive(ApiEvent::SocketClosed, 1.0, "14:03:12");
    harness.run();
    harness.get_by_label("FROZEN SINCE 14:03:12");
    assert!(harness.query_by_label("LIVE (EMULATED)").is_none());
}

#[test]
fn a_live_frame_of_another_robot_is_refused_in_words() {
    let leap = station("xarm6_leap");
    let (mut harness, page) = harness(page(&leap, Source::Emulated));
    page.borrow_mut().playback.hand_source = HandSource::Live;
    let frame = LiveFrame { joint_positions: vec![0.0; 3], ..Default::default() };
    let message = StreamMessage { message: Some(stream_message::Message::Live(frame)), dropped: 0 };
    page.borrow_mut().store.receive(ApiEvent::SocketMessage(message.encode_to_vec()), 0.0, "");
    harness.run();
    harness.get_by_label_contains("does not match its description");
}

#[test]
fn missing_and_failed_data_say_what_to_do() {
    let mut store = Store::default();
    answer(&mut store, Request::Sessions, b"[]".to_vec());
    let (mut empty, opened) = harness(Page { store, playback: Playback::default(), go_to: None });
    empty.run();
    empty.get_by_label("No session yet");
    empty.get_by_label("Bring in a session").click();
    empty.run();
    assert!(opened.borrow().go_to.is_some());

    let leap = station("xarm6_leap");
    let mut broken = page(&leap, Source::Replay);
    let request = Request::Take { session: SESSION.into(), take: TAKE.into() };
    broken.store.receive(ApiEvent::Answer { request, result: Err("the file is truncated".into()) }, 0.0, "");
    let (mut failed, _) = harness(broken);
    failed.run();
    failed.get_by_label("the file is truncated");
    failed.get_by_label("Try again");

    let mut other = page(&leap, Source::Replay);
    let probe = station("probe_bench");
    let request = Request::Take { session: SESSION.into(), take: TAKE.into() };
    answer(&mut other.store, request, take_trace(&probe).encode_to_vec());
    let (mut mismatched, _) = harness(other);
    mismatched.run();
    mismatched.get_by_label_contains("does not match its station");
}

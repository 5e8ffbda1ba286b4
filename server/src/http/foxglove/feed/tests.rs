//! What a client is told, without a socket.

use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use palpate_wire::proto::{ControlState, DeviceStatus, TaxelWarning};
use proptest::prelude::*;
use prost::Message as _;

use super::*;
use crate::assets;

const START_NS: u64 = 1_700_000_000_000_000_000;

fn feed() -> Feed {
    Feed::new(&assets::station("xarm6-leap").unwrap())
}

/// A frame of the shipped station: joint `n` is at `n / 100`, channel `n` reads `n`, every third is touched.
fn frame(time_s: f64) -> LiveFrame {
    LiveFrame {
        time_s,
        joint_positions: (0..22).map(|joint| joint as f32 / 100.0).collect(),
        active: bits::pack((0..44).map(|channel| channel % 3 == 0)),
        raw: (0..44).map(|channel| channel as f32).collect(),
        ..LiveFrame::default()
    }
}

fn id_of(feed: &Feed, topic: &str) -> usize {
    feed.channels.iter().position(|channel| channel.topic == topic).unwrap() + 1
}

/// Subscribes to `topic` as `id`; gives what that alone brings.
fn subscribe(feed: &mut Feed, id: u32, topic: &str) -> Messages {
    let channel = id_of(feed, topic);
    let text =
        json!({ "op": "subscribe", "subscriptions": [{ "id": id, "channelId": channel }] }).to_string();
    let (problems, messages) = feed.request(&text);
    assert_eq!(problems, Vec::<String>::new());
    messages
}

/// Subscription, time and payload of a message.
fn split(message: &[u8]) -> (u32, u64, &[u8]) {
    assert_eq!(message[0], MESSAGE_DATA);
    let id = u32::from_le_bytes(message[1..5].try_into().unwrap());
    (id, u64::from_le_bytes(message[5..13].try_into().unwrap()), &message[13..])
}

#[test]
fn a_stream_has_its_own_channels_of_the_frame() {
    let mut feed = feed();
    let station = assets::station("xarm6-leap").unwrap();
    for (id, stream) in station.layout.streams.iter().enumerate() {
        subscribe(&mut feed, id as u32, &format!("/tactile/{}", stream.id));
    }
    let messages = feed.frame(frame(2.0), START_NS + 2_000_000_000);
    assert_eq!(messages.len(), station.layout.streams.len());
    for (message, stream) in messages.iter().zip(&station.layout.streams) {
        let (_, time_ns, payload) = split(message);
        let sample = TactileSample::decode(payload).unwrap();
        assert_eq!(sample.raw, stream.channels.clone().map(|channel| channel as f32).collect::<Vec<_>>());
        assert_eq!(
            sample.active,
            stream.channels.clone().map(|channel| channel % 3 == 0).collect::<Vec<_>>()
        );
        assert_eq!(time_ns, START_NS + 2_000_000_000);
    }
    // A late second frame keeps the station's own distance in time.
    let messages = feed.frame(frame(2.5), START_NS + 9_000_000_000);
    assert_eq!(split(&messages[0]).1, START_NS + 2_500_000_000);
}

#[test]
fn transforms_lead_from_the_base_to_every_link_and_to_the_object() {
    let mut feed = feed();
    subscribe(&mut feed, 1, "/tf");
    let placed = LiveFrame {
        object: "ball".to_owned(),
        object_pose: vec![0.1, 0.2, 0.3, 0.5, 0.5, -0.5, 0.5],
        ..frame(0.0)
    };
    let positions: Vec<f64> = placed.joint_positions.iter().map(|&position| f64::from(position)).collect();
    let messages = feed.frame(placed, START_NS);
    let transforms = FrameTransforms::decode(split(&messages[0]).2).unwrap().transforms;
    let robot = &feed.robot;
    assert_eq!(transforms.len(), robot.links.len());
    let mut expected = Vec::new();
    robot.forward_kinematics(&positions, &mut expected);
    let mut found = vec![expected[0]];
    for (transform, joint) in transforms.iter().zip(&robot.joints) {
        assert_eq!(transform.parent_frame_id, robot.links[joint.parent_link].name);
        assert_eq!(transform.child_frame_id, robot.links[joint.child_link].name);
        let (t, q) = (transform.translation.unwrap(), transform.rotation.unwrap());
        let rotation = nalgebra::Quaternion::new(q.w, q.x, q.y, q.z);
        let parent_from_child = Isometry3::from_parts(
            Translation3::new(t.x, t.y, t.z),
            UnitQuaternion::from_quaternion(rotation),
        );
        found.push(found[joint.parent_link] * parent_from_child);
    }
    for (link, (found, expected)) in found.iter().zip(&expected).enumerate() {
        let distance = (found.translation.vector - expected.translation.vector).norm();
        let angle = found.rotation.angle_to(&expected.rotation);
        assert!(distance < 1e-9 && angle < 1e-6, "{}: {distance} m, {angle} rad", robot.links[link].name);
    }
    let object = transforms.last().unwrap();
    assert_eq!(object.child_frame_id, "object/ball");
    assert_eq!(object.translation, Some(Vector3 { x: 0.1, y: 0.2, z: 0.3 }));
    assert_eq!(object.rotation, Some(Quaternion { x: 0.5, y: -0.5, z: 0.5, w: 0.5 }));
}

#[test]
fn commands_and_joints_are_left_out_while_there_are_none() {
    let mut feed = feed();
    for (id, topic) in ["/joint_states", "/joint_commands", "/tf"].into_iter().enumerate() {
        subscribe(&mut feed, id as u32, topic);
    }
    let ids = |messages: Messages| messages.iter().map(|message| split(message).0).collect::<Vec<_>>();
    assert_eq!(ids(feed.frame(LiveFrame::default(), START_NS)), Vec::<u32>::new());
    assert_eq!(ids(feed.frame(frame(0.1), START_NS)), [0, 2]);
    let commanded = vec![0.25; 22];
    let armed =
        LiveFrame { control: Some(ControlState { commanded, ..ControlState::default() }), ..frame(0.2) };
    let messages = feed.frame(armed, START_NS);
    let commands = JointStates::decode(split(&messages[1]).2).unwrap();
    assert!(commands.joints.iter().all(|joint| joint.position == Some(0.25)));
    assert_eq!(ids(messages), [0, 1, 2]);
}

#[test]
fn the_log_says_what_changes_once_and_to_newcomers_what_holds() {
    let mut feed = feed();
    subscribe(&mut feed, 1, "/log");
    let with = |problem: &str, activity: &str| {
        let device = DeviceStatus {
            id: "fsr".to_owned(),
            link: Link::Lost.into(),
            problem: problem.to_owned(),
            ..DeviceStatus::default()
        };
        let taxel = TaxelWarning { channel: 3, kind: "dead".to_owned(), text: "never changes".to_owned() };
        let control = ControlState { devices: vec![device], taxels: vec![taxel], ..ControlState::default() };
        LiveFrame { control: Some(control), activity: activity.to_owned(), ..frame(1.0) }
    };
    let said = |messages: Messages| -> Vec<(String, Level, String)> {
        let lines = messages.iter().map(|message| Log::decode(split(message).2).unwrap());
        lines.map(|line| (line.name.clone(), line.level(), line.message)).collect()
    };
    let line = |name: &str, level, text: &str| (name.to_owned(), level, text.to_owned());
    let first = said(feed.frame(with("unplugged", "tap"), START_NS));
    let expected = [
        line("activity", Level::Info, "tap"),
        line("channel 3", Level::Warning, "never changes"),
        line("fsr", Level::Error, "unplugged"),
    ];
    assert_eq!(first, expected);
    assert_eq!(said(feed.frame(with("unplugged", "tap"), START_NS)), []);
    assert_eq!(said(subscribe(&mut feed, 2, "/log")), expected);
    // Both subscriptions hear what comes.
    let again = said(feed.frame(with("", "slide"), START_NS));
    let news = [line("activity", Level::Info, "slide"), line("fsr", Level::Info, "all is well again")];
    assert_eq!(again, [news.clone(), news].concat());
}

#[test]
fn newcomers_get_the_newest_frame_and_who_leaves_gets_nothing() {
    let mut feed = feed();
    assert_eq!(subscribe(&mut feed, 1, "/live").len(), 0, "nothing is known yet");
    assert_eq!(feed.frame(frame(1.0), START_NS).len(), 1);
    let first = subscribe(&mut feed, 2, "/live");
    assert_eq!(LiveFrame::decode(split(&first[0]).2).unwrap(), frame(1.0));
    let (problems, messages) = feed.request(r#"{"op":"unsubscribe","subscriptionIds":[1,7]}"#);
    assert!(problems.is_empty() && messages.is_empty());
    let messages = feed.frame(frame(2.0), START_NS);
    assert_eq!(messages.iter().map(|message| split(message).0).collect::<Vec<_>>(), [2]);
}

#[test]
fn requests_that_make_no_sense_are_answered() {
    let mut feed = feed();
    let last = feed.channels.len();
    let subscribe = |id: u32, channel: usize| {
        json!({ "op": "subscribe", "subscriptions": [{ "id": id, "channelId": channel }] }).to_string()
    };
    let cases = [
        ("".to_owned(), "none of the protocol"),
        ("[]".to_owned(), "none of the protocol"),
        (r#"{"op":"subscribe"}"#.to_owned(), "subscriptions"),
        (subscribe(1, 0), "no channel 0"),
        (subscribe(1, last + 1), "no channel"),
        (r#"{"op":"advertise","channels":[]}"#.to_owned(), "only shows"),
    ];
    for (text, words) in cases {
        let (problems, messages) = feed.request(&text);
        assert!(problems.len() == 1 && problems[0].contains(words), "{text}: {problems:?}");
        assert!(messages.is_empty());
    }
    assert_eq!(feed.request(&subscribe(1, last)).0.len(), 0);
    assert!(feed.request(&subscribe(1, 1)).0[0].contains("there already"));
    for id in 2..2 + MAX_SUBSCRIPTIONS as u32 {
        feed.request(&subscribe(id, 1));
    }
    assert_eq!(feed.subscriptions.len(), MAX_SUBSCRIPTIONS, "memory is bounded");
}

proptest! {
    #[test]
    fn no_text_and_no_frame_breaks_it(
        texts in prop::collection::vec(any::<String>(), 0..4),
        lengths in prop::array::uniform4(0_usize..60),
        time_s in any::<f64>(),
        now_ns in any::<u64>(),
    ) {
        let mut feed = feed();
        for (id, channel) in (1..=feed.channels.len()).enumerate() {
            let subscription = json!({ "id": id, "channelId": channel });
            feed.request(&json!({ "op": "subscribe", "subscriptions": [subscription] }).to_string());
        }
        for text in texts {
            feed.request(&text);
        }
        let [joints, active, raw, pose] = lengths;
        let odd = LiveFrame {
            time_s,
            joint_positions: vec![f32::NAN; joints],
            active: vec![255; active],
            raw: vec![1.0; raw],
            object: "ball".to_owned(),
            object_pose: vec![0.0; pose],
            ..LiveFrame::default()
        };
        let messages = feed.frame(odd, now_ns);
        prop_assert!(messages.iter().all(|message| message.len() >= 13));
    }
}

#[test]
fn losses_are_told_when_they_grow_and_not_too_often() {
    let mut feed = feed();
    let at = Duration::from_secs;
    assert_eq!(feed.lost(0, at(1)), None);
    assert!(feed.lost(3, at(2)).is_some_and(|told| told.contains("3 frames were dropped")));
    assert_eq!(feed.lost(3, at(60)), None, "that is no news");
    assert!(feed.lost(4, at(60)).is_some());
    assert_eq!(feed.lost(90, at(61)), None);
    assert!(feed.lost(90, at(66)).is_some());
}

/// Every text in `document` that begins with a slash.
fn topics(document: &Value, found: &mut Vec<String>) {
    match document {
        Value::String(text) if text.starts_with('/') => found.push(text.clone()),
        Value::Array(items) => items.iter().for_each(|item| topics(item, found)),
        Value::Object(entries) => {
            found.extend(entries.keys().filter(|key| key.starts_with('/')).cloned());
            entries.values().for_each(|value| topics(value, found));
        }
        _ => {}
    }
}

#[test]
fn the_shipped_layout_names_what_there_is() {
    let layout: Value = serde_json::from_str(assets::text("foxglove/palpate.json").unwrap()).unwrap();
    let mut named = Vec::new();
    topics(&layout, &mut named);
    assert!(named.len() > 5, "{named:?}");
    let feed = feed();
    for path in named {
        let topic = path.split('.').next().unwrap();
        assert!(feed.channels.iter().any(|channel| channel.topic == topic), "{path}");
    }
    // Panels of the arrangement have settings.
    let text = layout["layout"].to_string();
    for panel in layout["configById"].as_object().unwrap().keys() {
        assert!(text.contains(panel.as_str()), "{panel} is nowhere");
    }
}

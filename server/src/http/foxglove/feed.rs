//! What one client of Foxglove's protocol is told: texts and binary messages, without a socket.

use std::{collections::BTreeMap, time::Duration};

use base64::Engine as _;
use palpate_messages::{
    bits,
    foxglove::{
        FrameTransform, FrameTransforms, JointState, JointStates, Log, Quaternion, Vector3, log::Level,
    },
    proto::TactileSample,
};
use palpate_robot_model::{Robot, Station};
use palpate_wire::{
    descriptor_set,
    proto::{LiveFrame, device_status::Link},
};
use prost_types::Timestamp;
use serde::Deserialize;
use serde_json::{Value, json};

/// Subscriptions of one client: more than there are channels, since two panels may subscribe to one.
const MAX_SUBSCRIPTIONS: usize = 1000;
/// What a client lost is told it no more often.
const LOST_EVERY: Duration = Duration::from_secs(5);
/// Opcode of a message in binary.
const MESSAGE_DATA: u8 = 1;

/// Serialized messages, each a WebSocket message.
type Messages = Vec<Vec<u8>>;

/// What one client has been told and wants to be told.
pub(super) struct Feed {
    label: String,
    robot: Robot,
    joint_names: Vec<String>,
    channels: Vec<Channel>,
    /// Index of the channel by subscription id.
    subscriptions: BTreeMap<u32, usize>,
    newest: Option<Moment>,
    /// Unix time of the station's start, ns: fixed by the first frame, so that times have the station's own distances.
    start_unix_ns: Option<u64>,
    num_frames: u32,
    /// What the log said last, by subject.
    said: BTreeMap<String, (Level, String)>,
    /// Frames lost that the client was told of, and when.
    lost: (u64, Option<Duration>),
}

struct Channel {
    topic: String,
    schema: &'static str,
    about: About,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum About {
    Joints,
    Commands,
    Transforms,
    Log,
    Live,
    /// A stream of the layout: its first channel and how many it has.
    Touch {
        first: usize,
        len: usize,
    },
}

/// A frame and its time.
struct Moment {
    frame: LiveFrame,
    unix_ns: u64,
    /// Counts the frames of this client.
    number: u32,
}

/// What a client asks for.
#[derive(Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
enum Request {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    #[serde(other)]
    Other,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Subscription {
    id: u32,
    channel_id: u64,
}

impl Feed {
    /// Of the live station.
    pub(super) fn new(station: &Station) -> Self {
        let channel = |topic: &str, schema, about| Channel { topic: topic.to_owned(), schema, about };
        let mut channels = vec![
            channel("/joint_states", "foxglove.JointStates", About::Joints),
            channel("/joint_commands", "foxglove.JointStates", About::Commands),
            channel("/tf", "foxglove.FrameTransforms", About::Transforms),
            channel("/log", "foxglove.Log", About::Log),
            channel("/live", "palpate.LiveFrame", About::Live),
        ];
        channels.extend(station.layout.streams.iter().map(|stream| {
            let about = About::Touch { first: stream.channels.start, len: stream.channels.len() };
            channel(&format!("/tactile/{}", stream.id), "palpate.TactileSample", about)
        }));
        Self {
            label: station.label.clone(),
            robot: station.robot.clone(),
            joint_names: station.robot.dofs().map(|joint| joint.name.clone()).collect(),
            channels,
            subscriptions: BTreeMap::new(),
            newest: None,
            start_unix_ns: None,
            num_frames: 0,
            said: BTreeMap::new(),
            lost: (0, None),
        }
    }

    /// The first message.
    pub(super) fn server_info(&self, session_id: &str) -> String {
        let version = env!("CARGO_PKG_VERSION");
        json!({
            "op": "serverInfo",
            "name": format!("palpate: {}", self.label),
            // It takes no messages, has no parameters and offers no services.
            "capabilities": [],
            "supportedEncodings": [],
            "metadata": { "palpate": version },
            "sessionId": session_id,
        })
        .to_string()
    }

    /// The second message: all channels. Ids count from 1.
    pub(super) fn advertise(&self) -> String {
        let base64 = base64::engine::general_purpose::STANDARD;
        let channels: Vec<Value> = self
            .channels
            .iter()
            .enumerate()
            .map(|(idx, channel)| {
                json!({
                    "id": idx + 1,
                    "topic": channel.topic,
                    "encoding": "protobuf",
                    "schemaName": channel.schema,
                    "schemaEncoding": "protobuf",
                    "schema": base64.encode(descriptor_set(channel.schema).unwrap_or_default()),
                })
            })
            .collect();
        json!({ "op": "advertise", "channels": channels }).to_string()
    }

    /// Answers a text of the client: what is wrong with it, and for new subscriptions what is the newest.
    pub(super) fn request(&mut self, text: &str) -> (Vec<String>, Messages) {
        let request = match serde_json::from_str(text) {
            Ok(request) => request,
            Err(err) => {
                let problem = format!("a message is none of the protocol: {err}");
                return (vec![status(Severity::Error, &problem)], Vec::new());
            }
        };
        match request {
            Request::Subscribe { subscriptions } => {
                let (mut problems, mut messages) = (Vec::new(), Vec::new());
                for subscription in subscriptions {
                    match self.subscribe(&subscription) {
                        Ok(first) => messages.extend(first),
                        Err(problem) => problems.push(status(Severity::Error, &problem)),
                    }
                }
                (problems, messages)
            }
            Request::Unsubscribe { subscription_ids } => {
                for id in subscription_ids {
                    self.subscriptions.remove(&id);
                }
                (Vec::new(), Vec::new())
            }
            Request::Other => (vec![self.takes_nothing()], Vec::new()),
        }
    }

    /// The answer to what a client wants to publish, call or set.
    pub(super) fn takes_nothing(&self) -> String {
        let problem = "this studio only shows here; it is commanded over /api/v1/control, under a lease";
        status(Severity::Warning, problem)
    }

    /// What to send of a frame that came in at `now_unix_ns`.
    pub(super) fn frame(&mut self, frame: LiveFrame, now_unix_ns: u64) -> Messages {
        let since_start_ns = (frame.time_s.max(0.0) * 1e9) as u64;
        let start = *self.start_unix_ns.get_or_insert(now_unix_ns.saturating_sub(since_start_ns));
        let moment = Moment { frame, unix_ns: start.saturating_add(since_start_ns), number: self.num_frames };
        self.num_frames = self.num_frames.wrapping_add(1);
        let lines = self.log_lines(&moment.frame);
        let mut messages = Vec::new();
        for (&id, &channel) in &self.subscriptions {
            match self.channels[channel].about {
                About::Log => messages.extend(lines.iter().map(|(subject, (level, text))| {
                    message(id, &moment, &log(&moment, subject, *level, text))
                })),
                about => messages.extend(self.message(id, about, &moment)),
            }
        }
        self.newest = Some(moment);
        messages
    }

    /// What to tell a client that has lost `dropped` frames by now, if that is news.
    pub(super) fn lost(&mut self, dropped: u64, now: Duration) -> Option<String> {
        let (told, at) = self.lost;
        if dropped <= told || at.is_some_and(|at| now < at + LOST_EVERY) {
            return None;
        }
        self.lost = (dropped, Some(now));
        let problem = format!("{dropped} frames were dropped so far, because this client read too slowly");
        Some(status(Severity::Warning, &problem))
    }

    fn subscribe(&mut self, subscription: &Subscription) -> Result<Messages, String> {
        let Subscription { id, channel_id } = *subscription;
        let idx = usize::try_from(channel_id).ok().and_then(|number| number.checked_sub(1));
        let Some(idx) = idx.filter(|&idx| idx < self.channels.len()) else {
            return Err(format!("there is no channel {channel_id}, only 1 to {}", self.channels.len()));
        };
        if self.subscriptions.contains_key(&id) {
            return Err(format!("the subscription {id} is there already"));
        }
        if self.subscriptions.len() >= MAX_SUBSCRIPTIONS {
            return Err(format!("{MAX_SUBSCRIPTIONS} subscriptions are the most that a client has"));
        }
        self.subscriptions.insert(id, idx);
        let Some(moment) = &self.newest else { return Ok(Vec::new()) };
        Ok(match self.channels[idx].about {
            // What holds now, as it was said.
            About::Log => {
                let holds = self.said.iter().filter(|(_, (_, text))| !text.is_empty());
                holds
                    .map(|(subject, (level, text))| message(id, moment, &log(moment, subject, *level, text)))
                    .collect()
            }
            about => self.message(id, about, moment).into_iter().collect(),
        })
    }

    /// The message of a channel other than the log; `None` where the frame says nothing of it.
    fn message(&self, id: u32, about: About, moment: &Moment) -> Option<Vec<u8>> {
        let frame = &moment.frame;
        let commanded = || frame.control.as_ref().map(|control| control.commanded.as_slice());
        match about {
            About::Joints => Some(message(id, moment, &self.joint_states(moment, &frame.joint_positions)?)),
            About::Commands => Some(message(id, moment, &self.joint_states(moment, commanded()?)?)),
            About::Transforms => Some(message(id, moment, &self.transforms(moment)?)),
            About::Live => Some(message(id, moment, frame)),
            About::Touch { first, len } => {
                let sample = TactileSample {
                    timestamp: Some(timestamp(moment.unix_ns)),
                    device_time_ns: 0,
                    sequence: moment.number,
                    raw: frame.raw.get(first..first + len).unwrap_or_default().to_vec(),
                    active: (first..first + len).map(|channel| bits::get(&frame.active, channel)).collect(),
                };
                Some(message(id, moment, &sample))
            }
            About::Log => None,
        }
    }

    /// `None` where there is not one position for each joint, as before the first sample.
    fn joint_states(&self, moment: &Moment, positions: &[f32]) -> Option<JointStates> {
        if positions.len() != self.joint_names.len() || positions.is_empty() {
            return None;
        }
        let joints = self.joint_names.iter().zip(positions).map(|(name, &position)| JointState {
            name: name.clone(),
            position: Some(f64::from(position)),
            ..JointState::default()
        });
        Some(JointStates { timestamp: Some(timestamp(moment.unix_ns)), joints: joints.collect() })
    }

    /// Every link in its parent, and the object in the base.
    fn transforms(&self, moment: &Moment) -> Option<FrameTransforms> {
        let frame = &moment.frame;
        let positions: Vec<f64> = frame.joint_positions.iter().map(|&position| f64::from(position)).collect();
        if positions.len() != self.joint_names.len() {
            return None;
        }
        let mut root_from_link = Vec::new();
        self.robot.forward_kinematics(&positions, &mut root_from_link);
        let name = |link: usize| self.robot.links[link].name.clone();
        let mut transforms: Vec<FrameTransform> = Vec::with_capacity(root_from_link.len());
        for joint in &self.robot.joints {
            let (parent, child) = (joint.parent_link, joint.child_link);
            let parent_from_child = root_from_link[parent].inv_mul(&root_from_link[child]);
            let (t, q) = (parent_from_child.translation, parent_from_child.rotation);
            transforms.push(FrameTransform {
                timestamp: Some(timestamp(moment.unix_ns)),
                parent_frame_id: name(parent),
                child_frame_id: name(child),
                translation: Some(Vector3 { x: t.x, y: t.y, z: t.z }),
                rotation: Some(Quaternion { x: q.i, y: q.j, z: q.k, w: q.w }),
            });
        }
        if let (false, &[x, y, z, w, i, j, k]) = (frame.object.is_empty(), frame.object_pose.as_slice()) {
            transforms.push(FrameTransform {
                timestamp: Some(timestamp(moment.unix_ns)),
                parent_frame_id: name(0),
                child_frame_id: format!("object/{}", frame.object),
                translation: Some(Vector3 { x, y, z }),
                rotation: Some(Quaternion { x: i, y: j, z: k, w }),
            });
        }
        Some(FrameTransforms { transforms })
    }

    /// What is new for the log since the frame before: lines by subject.
    fn log_lines(&mut self, frame: &LiveFrame) -> Vec<(String, (Level, String))> {
        let mut now: BTreeMap<String, (Level, String)> = BTreeMap::new();
        let mut say = |subject: &str, level, text: &str| {
            if !text.is_empty() {
                now.insert(subject.to_owned(), (level, text.to_owned()));
            }
        };
        say("activity", Level::Info, &frame.activity);
        say("object", Level::Info, &frame.object);
        if let Some(control) = &frame.control {
            say("station", Level::Warning, &control.reason);
            for device in &control.devices {
                let level = match device.link() {
                    Link::Lost => Level::Error,
                    _ => Level::Warning,
                };
                say(&device.id, level, &device.problem);
            }
            for taxel in &control.taxels {
                say(&format!("channel {}", taxel.channel), Level::Warning, &taxel.text);
            }
        }
        let mut lines = Vec::new();
        for (subject, line) in &now {
            if self.said.get(subject) != Some(line) {
                lines.push((subject.clone(), line.clone()));
            }
        }
        for subject in self.said.keys().filter(|subject| !now.contains_key(*subject)) {
            let text = match subject.as_str() {
                "activity" => "nothing is under way",
                "object" => "no object is in place",
                _ => "all is well again",
            };
            lines.push((subject.clone(), (Level::Info, text.to_owned())));
        }
        self.said = now;
        lines
    }
}

/// How much a status matters, as the protocol numbers it.
#[derive(Clone, Copy)]
enum Severity {
    Warning = 1,
    Error = 2,
}

fn status(severity: Severity, problem: &str) -> String {
    json!({ "op": "status", "level": severity as u8, "message": problem }).to_string()
}

fn log(moment: &Moment, subject: &str, level: Level, text: &str) -> Log {
    Log {
        timestamp: Some(timestamp(moment.unix_ns)),
        level: level as i32,
        message: text.to_owned(),
        name: subject.to_owned(),
        ..Log::default()
    }
}

fn timestamp(unix_ns: u64) -> Timestamp {
    Timestamp { seconds: (unix_ns / 1_000_000_000) as i64, nanos: (unix_ns % 1_000_000_000) as i32 }
}

/// A message in binary: opcode, subscription and time in ns (little-endian), payload.
fn message(subscription: u32, moment: &Moment, payload: &impl prost::Message) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(13 + payload.encoded_len());
    bytes.push(MESSAGE_DATA);
    bytes.extend_from_slice(&subscription.to_le_bytes());
    bytes.extend_from_slice(&moment.unix_ns.to_le_bytes());
    payload.encode_raw(&mut bytes);
    bytes
}

#[cfg(test)]
mod tests;

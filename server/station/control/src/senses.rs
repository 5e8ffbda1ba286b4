//! Everything that devices report, put together: joints, touch, links, rates, latency.

use palpate_drivers::{DeviceEvent, Link};
use palpate_robot_model::{DeviceKind, Station};
use palpate_safety::{JointReading, Measured};

use crate::{
    joints::{JointFrame, JointFrames},
    latency::Latency,
    rates::RateMeter,
    streams::{BoardPlace, BoardReading, StreamSample, Streams},
};

/// The first readings of a board make its reference, ns.
const REFERENCE_NS: u64 = 500_000_000;

/// The newest of all devices.
#[derive(Debug)]
pub(crate) struct Senses {
    pub(crate) streams: Streams,
    pub(crate) latency: Latency,
    /// What the safety layer is told.
    pub(crate) measured: Measured,
    joints: JointFrames,
    joint_rate: RateMeter,
    stream_rates: Vec<RateMeter>,
    links: Vec<DeviceLink>,
}

/// What is known of a device's link.
#[derive(Clone, Debug)]
struct DeviceLink {
    id: String,
    /// Joints that it moves; none for boards.
    dofs: Vec<usize>,
    link: Link,
    problem: String,
    /// What was said of it last.
    told: String,
}

/// What came of an event.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Sensed {
    /// All joints at one moment.
    Joints(JointFrame),
    /// Samples of a stream, one after the other.
    Tactile(Vec<StreamSample>),
    /// A device is found, lost or faulty; in words for the audit log, and whether that is trouble.
    Link { device: String, text: String, trouble: bool },
}

impl Senses {
    pub(crate) fn new(station: &Station) -> Self {
        let mut boards = Vec::new();
        let mut movers = Vec::new();
        for (idx, device) in station.devices.iter().enumerate() {
            match &device.kind {
                DeviceKind::Lines(board) => boards.push(BoardPlace {
                    id: device.id.clone(),
                    stream: board.stream_idx,
                    first_channel: board.first_channel,
                    num_channels: board.num_channels,
                }),
                DeviceKind::Dynamixel(_) | DeviceKind::Xarm(_) => movers.push(idx),
            }
        }
        let links = station.devices.iter().map(|device| DeviceLink {
            id: device.id.clone(),
            dofs: device.dofs(),
            link: Link::Connecting,
            problem: String::new(),
            told: String::new(),
        });
        Self {
            streams: Streams::new(station, &boards, REFERENCE_NS),
            latency: Latency::default(),
            measured: Measured::new(station.robot.num_dofs()),
            joints: JointFrames::new(station.robot.num_dofs(), &movers),
            joint_rate: RateMeter::default(),
            stream_rates: vec![RateMeter::default(); station.layout.streams.len()],
            links: links.collect(),
        }
    }

    /// Takes an event in; gives what is whole with it.
    pub(crate) fn event(&mut self, event: &DeviceEvent) -> Option<Sensed> {
        match event {
            DeviceEvent::Joints {
                device,
                received_ns,
                host_ns,
                dofs,
                positions,
                velocities,
                torque_on,
                ..
            } => {
                self.latency.received(*received_ns);
                let readings = positions.iter().zip(velocities).zip(torque_on);
                for (&dof, ((&position, &velocity), &torque_on)) in dofs.iter().zip(readings) {
                    let (torque_on, received_ns) = (Some(torque_on), *received_ns);
                    self.measured.read(dof, JointReading { position, velocity, torque_on, received_ns });
                }
                let frame = self.joints.report(*device, *host_ns, dofs, positions)?;
                self.joint_rate.tick(*received_ns);
                Some(Sensed::Joints(frame))
            }
            DeviceEvent::Tactile { received_ns, host_ns, device_ns, stream, first_channel, raw, .. } => {
                self.latency.received(*received_ns);
                let samples = self.streams.board(BoardReading {
                    stream: *stream,
                    first_channel: *first_channel,
                    host_ns: *host_ns,
                    device_ns: *device_ns,
                    raw,
                });
                for sample in &samples {
                    self.stream_rates[sample.stream].tick(*received_ns);
                }
                Some(Sensed::Tactile(samples))
            }
            DeviceEvent::Link { device, link, problem, .. } => {
                let known = self.links.get_mut(*device)?;
                known.link = *link;
                known.problem.clone_from(problem);
                // A board that is missing is no reason not to move; a motor is.
                if !known.dofs.is_empty() {
                    self.measured.set_fault(&known.id, None, &known.trouble());
                    if !link.is_connected() {
                        self.measured.lost(&known.dofs);
                    }
                }
                let text = match link {
                    Link::Ready => "is ready".to_owned(),
                    Link::Fault => format!("has a fault: {problem}"),
                    Link::Lost => format!("is lost: {problem}"),
                    // Said again and again while it is looked for.
                    Link::Connecting => return None,
                };
                let trouble = *link != Link::Ready;
                // One that is ready may be slow, now more and now less so: that is for pages alone.
                let is_news = text != known.told;
                known.told.clone_from(&text);
                is_news.then(|| Sensed::Link { device: known.id.clone(), text, trouble })
            }
        }
    }

    /// Where every joint is; `None` before every joint was seen.
    pub(crate) fn positions(&self) -> Option<Vec<f64>> {
        self.joints.newest()
    }

    /// Devices that cannot be reached at present, each with what is wrong and what to do.
    pub(crate) fn missing(&self) -> impl Iterator<Item = (&str, String)> {
        let missing = self.links.iter().filter(|device| !device.link.is_connected());
        missing.map(|device| (device.id.as_str(), device.trouble()))
    }

    /// Samples per second: joints, then each stream of the layout.
    pub(crate) fn rates_hz(&mut self, now_ns: u64) -> Vec<f32> {
        let rates = std::iter::once(&mut self.joint_rate).chain(&mut self.stream_rates);
        rates.map(|rate| rate.now_hz(now_ns) as f32).collect()
    }
}

impl DeviceLink {
    /// What is wrong and what to do; empty when all is well.
    fn trouble(&self) -> String {
        match (self.link, self.problem.as_str()) {
            (Link::Ready, _) => "",
            (Link::Connecting, "") => "it is still being connected; wait a moment",
            (Link::Lost, "") => "it is lost; check its cable and power",
            (Link::Fault, "") => "it has a fault; clear it",
            (_, problem) => problem,
        }
        .to_owned()
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn what_is_no_news_of_a_device_is_not_said_again() {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../assets/stations");
        let read = |path: &str| std::fs::read(dir.join(path)).map_err(|err| err.to_string());
        let station = Station::read("xarm6_leap.toml", read).expect("the shipped station reads");
        let mut senses = Senses::new(&station);
        let mut said = |link, problem: &str| {
            let event = DeviceEvent::Link { device: 0, at_ns: 0, link, problem: problem.to_owned() };
            match senses.event(&event) {
                Some(Sensed::Link { text, trouble, .. }) => Some((text, trouble)),
                _ => None,
            }
        };
        let ready = Some(("is ready".to_owned(), false));
        assert_eq!(said(Link::Connecting, ""), None);
        assert_eq!(said(Link::Ready, ""), ready);
        assert_eq!(said(Link::Ready, "answers take 6.1 ms"), None);
        assert_eq!(said(Link::Ready, "answers take 6.3 ms"), None);
        assert_eq!(said(Link::Lost, "silent"), Some(("is lost: silent".to_owned(), true)));
        assert_eq!(said(Link::Lost, "silent"), None);
        assert_eq!(said(Link::Connecting, ""), None);
        assert_eq!(said(Link::Lost, "silent"), None);
        assert_eq!(said(Link::Lost, "no such port"), Some(("is lost: no such port".to_owned(), true)));
        assert_eq!(said(Link::Ready, ""), ready);
    }
}

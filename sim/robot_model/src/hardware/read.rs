//! `[[device]]` of a station file: every device, and every joint and channel with exactly one of them.

use std::{net::IpAddr, ops::Range};

use serde::Deserialize;
use toml::Spanned;

use super::{
    ArmConfig, BoardConfig, DeviceConfig, DeviceKind, MAX_CURRENT_LIMIT_A, MAX_WATCHDOG_S, ServoBusConfig,
    ServoConfig,
};
use crate::{
    JointKind, ModelError, Robot, TactileLayout,
    config::{Source, check_id, finite, list},
};

/// Highest id of a servo on a bus.
const MAX_SERVO_ID: i64 = 252;
/// Highest gain that a servo's register takes.
const MAX_GAIN: i64 = 16_383;
/// Rates that the servos know, bits per second.
const SERVO_BAUDS: [i64; 7] = [9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000];
/// Joints that the arm's protocol has room for.
const MAX_ARM_JOINTS: usize = 7;

/// A device as people write it: the keys of all kinds, because a table that is told apart by one of its keys would lose
/// the lines of the others.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct DeviceText {
    id: Spanned<String>,
    kind: Spanned<String>,
    port: Option<Spanned<String>>,
    baud: Option<Spanned<i64>>,
    rate_hz: Option<Spanned<f64>>,
    current_limit_a: Option<Spanned<f64>>,
    watchdog_s: Option<Spanned<f64>>,
    servo: Option<Vec<Spanned<ServoText>>>,
    address: Option<Spanned<String>>,
    command_port: Option<Spanned<u16>>,
    report_port: Option<Spanned<u16>>,
    joints: Option<Spanned<Vec<Spanned<String>>>>,
    stream: Option<Spanned<String>>,
    first_channel: Option<Spanned<usize>>,
    num_channels: Option<Spanned<usize>>,
    lines_per_sample: Option<Spanned<usize>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ServoText {
    joint: Spanned<String>,
    id: Spanned<i64>,
    zero_rad: Spanned<f64>,
    direction: Option<Spanned<i64>>,
    p: Option<Spanned<i64>>,
    i: Option<Spanned<i64>>,
    d: Option<Spanned<i64>>,
}

/// The devices of a station, checked against its robot and layout.
pub(crate) fn devices(
    source: &Source<'_>,
    texts: Vec<Spanned<DeviceText>>,
    robot: &Robot,
    layout: &TactileLayout,
) -> Result<Vec<DeviceConfig>, ModelError> {
    let mut reader = Reader {
        source,
        robot,
        layout,
        joint_owner: vec![None; robot.num_dofs()],
        channel_owner: vec![None; layout.num_channels()],
        addresses: Vec::new(),
    };
    let mut devices: Vec<DeviceConfig> = Vec::with_capacity(texts.len());
    let mut last = None;
    for text in texts {
        let span = text.span();
        last = Some(span.clone());
        let text = text.into_inner();
        let id = text.id.get_ref().clone();
        check_id("id", &id)
            .map_err(|problem| source.error(text.id.span(), format!("device {id:?}"), problem))?;
        if devices.iter().any(|device| device.id == id) {
            let problem = "an earlier device has this id, expected ids that differ";
            return Err(source.error(text.id.span(), format!("device {id:?}"), problem));
        }
        let kind = reader.kind(&id, span, text)?;
        devices.push(DeviceConfig { id, kind });
    }
    if let Some(last) = last {
        reader.check_complete(&last)?;
    }
    Ok(devices)
}

struct Reader<'a> {
    source: &'a Source<'a>,
    robot: &'a Robot,
    layout: &'a TactileLayout,
    /// Which device has a joint or channel already.
    joint_owner: Vec<Option<String>>,
    channel_owner: Vec<Option<String>>,
    /// Ports and addresses in use, with their devices.
    addresses: Vec<(String, String)>,
}

impl Reader<'_> {
    fn kind(&mut self, id: &str, span: Range<usize>, text: DeviceText) -> Result<DeviceKind, ModelError> {
        let kinds: [(&str, &[&str]); 3] = [
            ("dynamixel", &["port", "baud", "rate_hz", "current_limit_a", "watchdog_s", "servo"]),
            ("xarm", &["address", "command_port", "report_port", "joints"]),
            ("lines", &["port", "baud", "stream", "first_channel", "num_channels", "lines_per_sample"]),
        ];
        let what = format!("device {id:?}");
        let Some((kind, known)) = kinds.iter().find(|(kind, _)| kind == text.kind.get_ref()) else {
            let problem = format!(
                "unknown kind {:?}, expected one of {}",
                text.kind.get_ref(),
                list(kinds.iter().map(|(kind, _)| *kind))
            );
            return Err(self.source.error(text.kind.span(), what, problem));
        };
        let given = [
            ("port", text.port.as_ref().map(Spanned::span)),
            ("baud", text.baud.as_ref().map(Spanned::span)),
            ("rate_hz", text.rate_hz.as_ref().map(Spanned::span)),
            ("current_limit_a", text.current_limit_a.as_ref().map(Spanned::span)),
            ("watchdog_s", text.watchdog_s.as_ref().map(Spanned::span)),
            ("servo", text.servo.as_ref().map(|servos| servos.first().map_or(span.clone(), Spanned::span))),
            ("address", text.address.as_ref().map(Spanned::span)),
            ("command_port", text.command_port.as_ref().map(Spanned::span)),
            ("report_port", text.report_port.as_ref().map(Spanned::span)),
            ("joints", text.joints.as_ref().map(Spanned::span)),
            ("stream", text.stream.as_ref().map(Spanned::span)),
            ("first_channel", text.first_channel.as_ref().map(Spanned::span)),
            ("num_channels", text.num_channels.as_ref().map(Spanned::span)),
            ("lines_per_sample", text.lines_per_sample.as_ref().map(Spanned::span)),
        ];
        for (key, at) in given {
            if let Some(at) = at.filter(|_| !known.contains(&key)) {
                let problem = format!(
                    "a device of kind {kind:?} has no {key}, expected {}",
                    list(known.iter().copied())
                );
                return Err(self.source.error(at, what, problem));
            }
        }
        match *kind {
            "dynamixel" => self.servo_bus(id, span, text).map(DeviceKind::Dynamixel),
            "xarm" => self.arm(id, span, text).map(DeviceKind::Xarm),
            _ => self.board(id, span, text).map(DeviceKind::Lines),
        }
    }

    fn servo_bus(
        &mut self,
        id: &str,
        span: Range<usize>,
        text: DeviceText,
    ) -> Result<ServoBusConfig, ModelError> {
        let at = Place { source: self.source, what: format!("device {id:?}"), span };
        let port = self.port(id, &at, text.port)?;
        let baud = at.number(
            "baud",
            text.baud,
            4_000_000,
            |baud| SERVO_BAUDS.contains(baud),
            || format!("expected a rate of the servos: {SERVO_BAUDS:?}"),
        )?;
        let rate_hz = at.number(
            "rate_hz",
            text.rate_hz,
            100.0,
            |rate| (10.0..=1000.0).contains(rate),
            || "expected 10 to 1000 Hz".to_owned(),
        )?;
        let allowed = |limit: &f64| *limit > 0.0 && *limit <= MAX_CURRENT_LIMIT_A;
        let current_limit_a = at.number("current_limit_a", text.current_limit_a, 0.3, allowed, || {
            format!("expected above zero and at most {MAX_CURRENT_LIMIT_A} A")
        })?;
        // Shorter than two cycles, it would trip between them, and a servo that has tripped is stiff.
        let min_watchdog_s = (2.0 / rate_hz).max(0.02);
        let watchdog_s = at.number(
            "watchdog_s",
            text.watchdog_s,
            0.2,
            |s| (min_watchdog_s..=MAX_WATCHDOG_S).contains(s),
            || format!("expected {min_watchdog_s} (servos count 0.02 s, and two cycles of rate_hz fit) to {MAX_WATCHDOG_S} s"),
        )?;
        let texts = text.servo.unwrap_or_default();
        if texts.is_empty() {
            return Err(at.error("no [[device.servo]] entries, expected one for each servo on the bus"));
        }
        let mut servos: Vec<ServoConfig> = Vec::with_capacity(texts.len());
        for text in texts {
            let at = Place {
                source: self.source,
                what: format!("device {id:?}, joint {:?}", text.get_ref().joint.get_ref()),
                span: text.span(),
            };
            let text = text.into_inner();
            let dof = self.own_joint(id, &text.joint)?;
            let servo_id = at.number(
                "id",
                Some(text.id),
                0,
                |id| (0..=MAX_SERVO_ID).contains(id),
                || format!("expected 0 to {MAX_SERVO_ID}"),
            )?;
            if let Some(other) = servos.iter().find(|servo| i64::from(servo.id) == servo_id) {
                return Err(at.error(format!("servo id {servo_id} is that of joint {:?} too", other.joint)));
            }
            let zero_rad = *text.zero_rad.get_ref();
            finite("zero_rad", zero_rad).map_err(|problem| at.error(problem))?;
            let direction = at.number(
                "direction",
                text.direction,
                1,
                |sign| [1, -1].contains(sign),
                || "expected 1 or -1".to_owned(),
            )?;
            let gain = |name: &str, value: Option<Spanned<i64>>, default: i64| {
                at.number(
                    name,
                    value,
                    default,
                    |gain| (0..=MAX_GAIN).contains(gain),
                    || format!("expected a register's 0 to {MAX_GAIN}"),
                )
            };
            let [p, i, d] = [gain("p", text.p, 600)?, gain("i", text.i, 0)?, gain("d", text.d, 200)?];
            servos.push(ServoConfig {
                joint: text.joint.into_inner(),
                dof,
                id: at.fit("id", servo_id)?,
                zero_rad,
                direction: at.fit("direction", direction)?,
                p: at.fit("p", p)?,
                i: at.fit("i", i)?,
                d: at.fit("d", d)?,
            });
        }
        Ok(ServoBusConfig { port, baud: at.fit("baud", baud)?, rate_hz, current_limit_a, watchdog_s, servos })
    }

    fn arm(&mut self, id: &str, span: Range<usize>, text: DeviceText) -> Result<ArmConfig, ModelError> {
        let at = Place { source: self.source, what: format!("device {id:?}"), span };
        let Some(address) = text.address else {
            return Err(at.error("no address, expected that of the control box, such as \"192.168.1.212\""));
        };
        let Ok(ip) = address.get_ref().parse::<IpAddr>() else {
            let problem =
                format!("address {:?} is not an IP address such as \"192.168.1.212\"", address.get_ref());
            return Err(self.source.error(address.span(), at.what, problem));
        };
        self.own_address(id, address.get_ref().clone(), address.span())?;
        let port = |name: &str, value: Option<Spanned<u16>>, default: u16| {
            at.number(name, value, default, |port| *port != 0, || "expected 1 to 65535".to_owned())
        };
        let command_port = port("command_port", text.command_port, 502)?;
        let report_port = port("report_port", text.report_port, 30_003)?;
        let texts = text.joints.map(Spanned::into_inner).unwrap_or_default();
        if !(1..=MAX_ARM_JOINTS).contains(&texts.len()) {
            let problem = format!("{} joints, expected 1 to {MAX_ARM_JOINTS}, from the base", texts.len());
            return Err(at.error(problem));
        }
        let dofs = texts.iter().map(|joint| self.own_joint(id, joint)).collect::<Result<_, _>>()?;
        let joints = texts.into_iter().map(Spanned::into_inner).collect();
        Ok(ArmConfig { address: ip, command_port, report_port, joints, dofs })
    }

    fn board(&mut self, id: &str, span: Range<usize>, text: DeviceText) -> Result<BoardConfig, ModelError> {
        let at = Place { source: self.source, what: format!("device {id:?}"), span };
        let port = self.port(id, &at, text.port)?;
        let baud = at.number(
            "baud",
            text.baud,
            115_200,
            |baud| (1..=12_000_000).contains(baud),
            || "expected 1 to 12 000 000".to_owned(),
        )?;
        let Some(stream) = text.stream else {
            return Err(at.error("no stream, expected that of the layout which its readings belong to"));
        };
        let Some(stream_idx) = self.layout.stream_index(stream.get_ref()) else {
            let known = list(self.layout.streams.iter().map(|stream| stream.id.as_str()));
            let problem = format!("the layout has no stream {:?}, expected one of {known}", stream.get_ref());
            return Err(self.source.error(stream.span(), at.what, problem));
        };
        let num_axes = self.layout.streams[stream_idx].axes.count();
        if num_axes > 1 {
            let problem = format!(
                "stream {:?} has {num_axes} axes for each taxel, which no device here reads; leave [[device]] out and \
                 import recordings of it",
                stream.get_ref()
            );
            return Err(self.source.error(stream.span(), at.what, problem));
        }
        let of_stream = self.layout.streams[stream_idx].channels.clone();
        let first_channel = text.first_channel.map_or(0, Spanned::into_inner);
        let Some(num_channels) = text.num_channels.map(Spanned::into_inner).filter(|num| *num > 0) else {
            return Err(at.error("no num_channels, expected how many channels the board reads"));
        };
        if first_channel.saturating_add(num_channels) > of_stream.len() {
            return Err(at.error(format!(
                "{num_channels} channels from {first_channel} on, but stream {:?} has {} channels",
                stream.get_ref(),
                of_stream.len()
            )));
        }
        let divides = |lines: &usize| *lines > 0 && num_channels.is_multiple_of(*lines);
        let lines_per_sample = at.number("lines_per_sample", text.lines_per_sample, 1, divides, || {
            format!("expected a divisor of num_channels {num_channels}: every line has as many readings")
        })?;
        let channels = of_stream.start + first_channel..of_stream.start + first_channel + num_channels;
        for channel in channels.clone() {
            if let Some(other) = self.channel_owner[channel].replace(id.to_owned()) {
                let name = &self.layout.channels[channel].id;
                return Err(at.error(format!(
                    "channel {name:?} is read by device {other:?} too, expected one device"
                )));
            }
        }
        Ok(BoardConfig {
            port,
            baud: at.fit("baud", baud)?,
            stream: stream.into_inner(),
            stream_idx,
            first_channel,
            num_channels,
            lines_per_sample,
            channels,
        })
    }

    fn port(
        &mut self,
        id: &str,
        at: &Place<'_>,
        port: Option<Spanned<String>>,
    ) -> Result<String, ModelError> {
        let Some(port) = port.filter(|port| !port.get_ref().trim().is_empty()) else {
            return Err(at.error("no port, expected a serial port such as \"/dev/ttyUSB0\""));
        };
        self.own_address(id, port.get_ref().clone(), port.span())?;
        Ok(port.into_inner())
    }

    fn own_address(&mut self, id: &str, address: String, span: Range<usize>) -> Result<(), ModelError> {
        if let Some((_, other)) = self.addresses.iter().find(|(used, _)| *used == address) {
            let problem = format!("{address:?} is that of device {other:?} too, expected one device each");
            return Err(self.source.error(span, format!("device {id:?}"), problem));
        }
        self.addresses.push((address, id.to_owned()));
        Ok(())
    }

    /// The degree of freedom of `joint`, which belongs to device `id` from now on.
    fn own_joint(&mut self, id: &str, joint: &Spanned<String>) -> Result<usize, ModelError> {
        let name = joint.get_ref();
        let error = |problem: String| {
            self.source.error(joint.span(), format!("device {id:?}, joint {name:?}"), problem)
        };
        let Some((dof, found)) = self.robot.dofs().enumerate().find(|(_, joint)| joint.name == *name) else {
            let known = list(self.robot.dofs().map(|joint| joint.name.as_str()));
            return Err(error(format!("the station has no such joint, expected one of {known}")));
        };
        if found.kind != JointKind::Revolute {
            return Err(error(
                "this joint slides, expected one that turns, as motors of this kind do".to_owned(),
            ));
        }
        if let Some(other) = &self.joint_owner[dof] {
            return Err(error(format!("device {other:?} moves this joint already, expected one device")));
        }
        self.joint_owner[dof] = Some(id.to_owned());
        Ok(dof)
    }

    fn check_complete(&self, span: &Range<usize>) -> Result<(), ModelError> {
        let idle = self.joint_owner.iter().zip(self.robot.dofs()).filter(|(owner, _)| owner.is_none());
        let idle: Vec<&str> = idle.map(|(_, joint)| joint.name.as_str()).collect();
        if let Some(first) = idle.first() {
            let problem = format!(
                "no device moves {}; add them to a [[device]], or leave all devices out",
                list(idle.iter().copied())
            );
            return Err(self.source.error(span.clone(), format!("joint {first:?}"), problem));
        }
        let unread =
            self.channel_owner.iter().zip(&self.layout.channels).filter(|(owner, _)| owner.is_none());
        let unread: Vec<&str> = unread.map(|(_, channel)| channel.id.as_str()).collect();
        if let Some(first) = unread.first() {
            let problem = format!(
                "no device reads {}; add a [[device]] of kind \"lines\"",
                list(unread.iter().copied())
            );
            return Err(self.source.error(span.clone(), format!("channel {first:?}"), problem));
        }
        Ok(())
    }
}

/// What an error is about, and the line where it begins.
struct Place<'a> {
    source: &'a Source<'a>,
    what: String,
    span: Range<usize>,
}

impl Place<'_> {
    fn error(&self, problem: impl Into<String>) -> ModelError {
        self.source.error(self.span.clone(), &self.what, problem)
    }

    /// The value if it is given and `allowed`, `default` if it is not given.
    fn number<T: Copy + std::fmt::Display>(
        &self,
        name: &str,
        value: Option<Spanned<T>>,
        default: T,
        allowed: impl FnOnce(&T) -> bool,
        expected: impl FnOnce() -> String,
    ) -> Result<T, ModelError> {
        let Some(value) = value else { return Ok(default) };
        let span = value.span();
        let value = value.into_inner();
        if allowed(&value) {
            Ok(value)
        } else {
            Err(self.source.error(span, &self.what, format!("{name} is {value}, {}", expected())))
        }
    }

    /// A number that was checked to be small enough, in the type that holds it.
    fn fit<T: TryFrom<i64>>(&self, name: &str, value: i64) -> Result<T, ModelError> {
        T::try_from(value).map_err(|_| self.error(format!("{name} is {value}, which is too large")))
    }
}

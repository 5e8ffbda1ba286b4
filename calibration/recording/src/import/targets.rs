//! What columns may hold, and what the station calls it.

use std::borrow::Cow;

use palpate_robot_model::{JointKind, Station};

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Target {
    /// Position of a degree of freedom.
    Joint(usize),
    /// Reading of a channel, by its index in the layout.
    Channel(usize),
    /// What one of a channel's axes measured: index of the channel in the layout, index of the axis.
    Axis(usize, usize),
    /// A number of the object's pose, by its index in [`POSE_NAMES`].
    Object(usize),
}

/// Numbers of an object's pose in the base frame: where its origin is, and a quaternion, scalar first.
pub(super) const POSE_NAMES: [&str; 7] = ["x", "y", "z", "qw", "qx", "qy", "qz"];
/// How many of them say where it is.
pub(super) const NUM_POSITIONS: usize = 3;

impl Target {
    /// What it is, for messages.
    pub(super) fn what(self) -> &'static str {
        match self {
            Self::Joint(_) => "joint",
            Self::Channel(_) => "channel",
            Self::Axis(..) => "axis",
            Self::Object(_) => "object coordinate",
        }
    }

    /// The channel that it is about.
    pub(super) fn channel(self) -> Option<usize> {
        match self {
            Self::Channel(channel) | Self::Axis(channel, _) => Some(channel),
            Self::Joint(_) | Self::Object(_) => None,
        }
    }
}

/// Several of what [`Target::what`] says.
pub(super) fn plural(what: &str) -> String {
    if what == "axis" { "axes".to_owned() } else { format!("{what}s") }
}

/// What a file may hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scope {
    Joints,
    Stream(usize),
    /// Poses of the object.
    Object,
    All,
}

/// The station's names.
#[derive(Clone, Copy)]
pub(super) struct Names<'a> {
    pub(super) station: &'a Station,
    /// Whether recordings hold events, of which a taxel has one however many axes it has.
    pub(super) binary: bool,
}

impl<'a> Names<'a> {
    pub(super) fn joints(self) -> impl Iterator<Item = (Target, Cow<'a, str>)> {
        let joints = self.station.robot.dofs().enumerate();
        joints.map(|(dof, joint)| (Target::Joint(dof), Cow::Borrowed(joint.name.as_str())))
    }

    /// Of each channel of `scope` its reading, or its axes where there are several.
    fn channels(self, scope: Scope) -> impl Iterator<Item = (Target, Cow<'a, str>)> {
        let channels = match scope {
            Scope::Joints | Scope::Object => 0..0,
            Scope::Stream(stream_idx) => self.station.layout.streams[stream_idx].channels.clone(),
            Scope::All => 0..self.station.layout.num_channels(),
        };
        channels.flat_map(move |channel| {
            self.of_channel(channel).into_iter().map(move |target| (target, self.id(target)))
        })
    }

    /// The columns of a channel: its reading, or its axes where there are several.
    pub(super) fn of_channel(self, channel: usize) -> Vec<Target> {
        match self.num_axes(channel) {
            1 => vec![Target::Channel(channel)],
            num_axes => (0..num_axes).map(|axis| Target::Axis(channel, axis)).collect(),
        }
    }

    /// How many columns a channel has.
    pub(super) fn num_axes(self, channel: usize) -> usize {
        let layout = &self.station.layout;
        if self.binary { 1 } else { layout.streams[layout.channels[channel].stream].axes.count() }
    }

    /// Everything that a file of `scope` may hold.
    pub(super) fn of(self, scope: Scope) -> Vec<(Target, Cow<'a, str>)> {
        if scope == Scope::Object {
            return Self::pose().map(|(target, name)| (target, Cow::Borrowed(name))).collect();
        }
        let joints = self.joints().filter(|_| !matches!(scope, Scope::Stream(_)));
        joints.chain(self.channels(scope)).collect()
    }

    pub(super) fn pose() -> impl Iterator<Item = (Target, &'static str)> {
        POSE_NAMES.into_iter().enumerate().map(|(idx, name)| (Target::Object(idx), name))
    }

    pub(super) fn id(self, target: Target) -> Cow<'a, str> {
        let layout = &self.station.layout;
        match target {
            Target::Joint(dof) => {
                let joint = self.station.robot.dofs().nth(dof);
                joint.map_or(Cow::Borrowed(""), |joint| Cow::Borrowed(joint.name.as_str()))
            }
            Target::Channel(channel) => Cow::Borrowed(&layout.channels[channel].id),
            Target::Axis(channel, axis) => Cow::Owned(layout.axis_id(channel, axis)),
            Target::Object(idx) => Cow::Borrowed(POSE_NAMES.get(idx).copied().unwrap_or_default()),
        }
    }

    pub(super) fn unit(self, target: Target) -> &'a str {
        match target {
            Target::Joint(dof) => match self.station.robot.dofs().nth(dof).map(|joint| joint.kind) {
                Some(JointKind::Prismatic) => "m",
                _ => "rad",
            },
            Target::Channel(channel) | Target::Axis(channel, _) => {
                let layout = &self.station.layout;
                &layout.streams[layout.channels[channel].stream].raw_unit
            }
            Target::Object(idx) if idx < NUM_POSITIONS => "m",
            Target::Object(_) => "1",
        }
    }

    /// Lowest plus highest reading that the device of a channel can give.
    pub(super) fn range_sum(self, target: Target) -> Option<f64> {
        let Target::Channel(channel) = target else { return None };
        let config = &self.station.streams[self.station.layout.channels[channel].stream];
        Some(config.raw_min + config.raw_max)
    }
}

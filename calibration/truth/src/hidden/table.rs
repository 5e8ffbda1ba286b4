//! The effects that a world can hide: where each can be, and the ranges of its sizes.

use std::fmt;

use palpate_robot_model::Place;

/// One effect.
pub(super) struct Effect {
    pub(super) id: &'static str,
    pub(super) places: &'static [Choice],
    pub(super) joint: Joint,
    pub(super) sizes: &'static [Size],
    /// What it does, for people.
    about: &'static str,
}

/// Whether a posture drives the effect.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Joint {
    None,
    Driving,
}

/// One parameter.
pub(super) struct Size {
    pub(super) name: &'static str,
    pub(super) lower: f64,
    pub(super) upper: f64,
    /// Where the entry leaves it out; `None` where it must not.
    pub(super) default: Option<f64>,
}

/// A kind of place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Choice {
    Stream,
    Patch,
    Channel,
    Channels,
    Joint,
    Group,
    Groups,
    Object,
}

impl Choice {
    pub(super) fn of(place: &Place) -> Self {
        match place {
            Place::Stream(_) => Self::Stream,
            Place::Patch(_) => Self::Patch,
            Place::Channel(_) => Self::Channel,
            Place::Channels(_) => Self::Channels,
            Place::Joint(_) => Self::Joint,
            Place::Group(_) => Self::Group,
            Place::Groups(_) => Self::Groups,
            Place::Object(_) => Self::Object,
        }
    }
}

impl fmt::Display for Choice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Stream => "stream",
            Self::Patch => "patch",
            Self::Channel => "channel",
            Self::Channels => "pair of channels",
            Self::Joint => "joint",
            Self::Group => "group",
            Self::Groups => "pair of groups",
            Self::Object => "object",
        })
    }
}

impl fmt::Display for Effect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let places: Vec<String> = self.places.iter().map(Choice::to_string).collect();
        let sizes: Vec<String> =
            self.sizes.iter().map(|s| format!("{} {}..{}", s.name, s.lower, s.upper)).collect();
        let joint = if self.joint == Joint::Driving { "; joint" } else { "" };
        write!(f, "{} ({}{joint}; {}): {}", self.id, places.join(" or "), sizes.join(", "), self.about)
    }
}

const fn size(name: &'static str, lower: f64, upper: f64) -> Size {
    Size { name, lower, upper, default: None }
}

const fn size_or(name: &'static str, lower: f64, upper: f64, default: f64) -> Size {
    Size { name, lower, upper, default: Some(default) }
}

const fn effect(
    id: &'static str,
    places: &'static [Choice],
    sizes: &'static [Size],
    about: &'static str,
) -> Effect {
    Effect { id, places, joint: Joint::None, sizes, about }
}

const fn driven(
    id: &'static str,
    places: &'static [Choice],
    sizes: &'static [Size],
    about: &'static str,
) -> Effect {
    Effect { id, places, joint: Joint::Driving, sizes, about }
}

/// A small rigid motion: a shift, and a rotation vector.
const MOTION: &[Size] = &[
    size_or("x_m", -0.05, 0.05, 0.0),
    size_or("y_m", -0.05, 0.05, 0.0),
    size_or("z_m", -0.05, 0.05, 0.0),
    size_or("rx_rad", -1.0, 1.0, 0.0),
    size_or("ry_rad", -1.0, 1.0, 0.0),
    size_or("rz_rad", -1.0, 1.0, 0.0),
];
const ANYWHERE: &[Choice] = &[Choice::Stream, Choice::Patch, Choice::Group, Choice::Channel];

/// Every effect, in the order of the sensing chain; the last three are of no chain that anybody drew up.
pub(super) const EFFECTS: &[Effect] = &[
    effect(
        "joint_offset",
        &[Choice::Joint],
        &[size("offset", -0.5, 0.5)],
        "the encoder's zero is off: measured less true position, rad or m",
    ),
    effect(
        "joint_backlash",
        &[Choice::Joint, Choice::Group],
        &[size("width", 0.0, 0.5)],
        "the gear has play between encoder and link, rad or m in all; a group is every joint of its \
         limb",
    ),
    effect(
        "object_pose_offset",
        &[Choice::Object],
        MOTION,
        "the object stands beside its recorded pose: true less recorded, in the base frame, turned about its origin",
    ),
    effect(
        "object_scale",
        &[Choice::Object],
        &[size("factor", 0.5, 2.0)],
        "the object is this many times as large as its file says",
    ),
    effect(
        "sensor_mount_offset",
        &[Choice::Patch],
        MOTION,
        "the patch sits beside its place in the layout: true less nominal, in the link's frame, turned about its origin",
    ),
    effect("self_contact", &[Choice::Groups], &[], "patches of two fingers feel each other"),
    effect(
        "sensitivity_spread",
        ANYWHERE,
        &[
            size_or("gain", 0.05, 20.0, 1.0),
            size_or("spread", 0.0, 2.0, 0.0),
            size_or("draw", 0.0, 9e15, 0.0),
        ],
        "gain common to the channels, and the standard deviation of the logarithm of each one's own, drawn with draw",
    ),
    effect(
        "elastic_crosstalk",
        &[Choice::Patch, Choice::Stream],
        &[size("added_m", 0.0, 0.01)],
        "the layer pulls its surroundings along this much farther",
    ),
    effect(
        "rate_dependence",
        &[Choice::Stream],
        &[size("damping_s", 0.0, 2.0)],
        "a dashpot in the layer: pressure from the speed of the deformation too, s times its stiffness",
    ),
    effect(
        "preload",
        &[Choice::Patch, Choice::Stream],
        &[size("depth_m", 0.0, 0.005)],
        "an air gap under the layer: nothing registers until it gives this much",
    ),
    effect(
        "viscoelastic_release",
        &[Choice::Stream],
        &[size("time_s", 0.01, 10.0), size("fraction", 0.0, 0.9)],
        "after a release this share of the dent remains, and goes with this time constant",
    ),
    effect(
        "threshold_hysteresis",
        &[Choice::Stream],
        &[size("off_fraction", 0.0, 1.0)],
        "the firmware switches off at this fraction of the on-threshold, whatever the station file says",
    ),
    effect("low_pass", &[Choice::Stream], &[size("time_s", 0.0, 2.0)], "the input filter is slower by this"),
    effect(
        "baseline_drift",
        ANYWHERE,
        &[size("rate_raw_per_s", -1000.0, 1000.0)],
        "the amplifier warms up: its zero moves at first by so many raw units a second",
    ),
    effect(
        "motion_artifact",
        ANYWHERE,
        &[size("raw_s_per_rad", 0.0, 1e5)],
        "the strained cable of a moving limb makes a voltage: raw units by joint speed",
    ),
    effect(
        "electrical_crosstalk",
        &[Choice::Stream],
        &[size("leak", 0.0, 0.5)],
        "conductance between lines that lie next to each other: share of the difference that leaks",
    ),
    effect("dead_channel", &[Choice::Channel], &[], "an open line: the reading at rest, whatever happens"),
    effect(
        "stuck_channel",
        &[Choice::Channel],
        &[size("rise_raw", -1e5, 1e5)],
        "from the start of the take the converter gives one value, this much above the reference",
    ),
    effect("swapped_channels", &[Choice::Channels], &[], "two lines are plugged in the wrong way round"),
    effect(
        "integer_wrap",
        &[Choice::Channel],
        &[],
        "the tared reading is a signed 16-bit number that is stored as an unsigned one",
    ),
    effect(
        "debounce",
        &[Choice::Stream],
        &[size("min_on_s", 0.0, 2.0)],
        "the firmware believes a touch only after this long",
    ),
    effect("latency", &[Choice::Stream], &[size("delay_s", 0.0, 2.0)], "samples travel longer by this"),
    effect(
        "clock_skew",
        &[Choice::Stream],
        &[size("skew", -0.02, 0.02)],
        "samples are stamped by the device's own clock, which runs fast by this, s per s",
    ),
    effect(
        "sample_hold",
        &[Choice::Stream],
        &[size("hold_s", 0.0, 10.0), size("every_s", 0.1, 1000.0)],
        "for spans of hold_s, every_s apart on average, the device repeats its last sample",
    ),
    effect(
        "mains_hum",
        &[Choice::Stream],
        &[size("amplitude_raw", 0.0, 1e5)],
        "the mains couple into the supply: the same wave on every channel",
    ),
    driven(
        "snagged_cable",
        &[Choice::Stream],
        &[size("beyond", -10.0, 10.0), size("offset_raw", -1e5, 1e5), size_or("release", 0.0, 3.0, 0.1)],
        "with the joint beyond a position the cable catches and shifts readings, until well back",
    ),
    driven(
        "joint_dependent_gain",
        &[Choice::Group, Choice::Patch],
        &[size("per_rad", -5.0, 5.0), size_or("middle", -10.0, 10.0, 0.0)],
        "bending stretches the lines: gain changes by so much per rad of the joint from its middle",
    ),
];

//! `[safety]` of a station file: times and limits of the safety layer.

use serde::Deserialize;
use toml::Spanned;

use crate::{
    JointKind, ModelError, Robot,
    config::{Source, list, positive},
};

// Ceilings that no station file can lift. A typing error (`heartbeat_ttl_s = 3600`) must not switch a rule of the safety
// layer off, so every number on which one depends has a range. docs/hardware.md lists them with the same reasons.

/// Motion goes on for this long after the operator has fallen silent. At the arm's highest speed (`MAX_CARRIER_RAD_PER_S`)
/// and a reach of 0.7 m the hand travels 0.55 m in 0.5 s: more than a person who lets go of the mouse expects.
const MAX_HEARTBEAT_TTL_S: f64 = 0.5;
/// Fingers that have closed on something hold it for this long after the operator or the readings are gone. Nobody
/// reacts to what they see within less than half a second; after 2 s a person may have reached in.
const MAX_DISARM_AFTER_S: f64 = 2.0;
/// A setpoint is carried out for this long when the control loop stands still; the same distance as for heartbeats.
const MAX_COMMAND_TTL_S: f64 = 0.5;
/// A joint moves unseen for this long. A hand reports at 10 Hz or faster, an arm at 5 Hz or faster, so that several
/// readings have been lost by then.
const MAX_TELEMETRY_TTL_S: f64 = 1.0;
/// A lease moves nothing without heartbeats, but while it lasts nobody else gets control without taking over.
const MAX_LEASE_TTL_S: f64 = 60.0;
/// A longer rise would look like a station that does not obey, and operators would command more than they want.
const MAX_EASE_IN_S: f64 = 10.0;
/// Three quarters of the speed of the hand's servos without load (8.5 rad/s): above, they lag behind whatever they do.
const MAX_HAND_RAD_PER_S: f64 = std::f64::consts::TAU;
/// Half of what the arm can do. At a reach of 0.7 m the hand moves at 1.1 m/s, which a person who walks can still avoid.
const MAX_CARRIER_RAD_PER_S: f64 = std::f64::consts::FRAC_PI_2;
/// Speed of a sliding joint, m/s: that of the hand at the end of an arm, as above.
const MAX_SLIDE_M_PER_S: f64 = 1.0;
/// A finger of 0.1 m with this has 2 g at its tip, as much as the servos' torque can give.
const MAX_HAND_RAD_PER_S2: f64 = 200.0;
/// The most that the arm's box takes.
const MAX_CARRIER_RAD_PER_S2: f64 = 20.0;
/// As for the arm at a reach of 1 m, m/s².
const MAX_SLIDE_M_PER_S2: f64 = 20.0;
/// A hold brakes with the acceleration limit, so a joint that is fast and may change its speed only slowly runs on. From
/// full speed it stands within this time.
const MAX_BRAKING_S: f64 = 0.5;

/// Times and limits within which a station may be moved. Each has a range that no station file can leave.
#[derive(Clone, Debug, PartialEq)]
pub struct SafetyConfig {
    /// A lease without a heartbeat ends after this, s; from `disarm_after_s` to 60. Default 6.
    pub lease_ttl_s: f64,
    /// Motion stops where the operator's heartbeat is older than this, s; below `disarm_after_s`, at most 0.5.
    /// Default 0.15.
    pub heartbeat_ttl_s: f64,
    /// Torque goes off where heartbeat or telemetry is older than this, s; above the three other times, at most 2.
    /// Default 0.5.
    pub disarm_after_s: f64,
    /// How long a setpoint may be carried out, s; below `disarm_after_s`, at most 0.5. Default 0.15.
    pub command_ttl_s: f64,
    /// Motion stops where a joint's last reading is older than this, s; below `disarm_after_s`, at most 1. Default 0.25.
    pub telemetry_ttl_s: f64,
    /// After arming, speeds rise from zero to their limits over this time, s; zero for at once, at most 10. Default 1.
    pub ease_in_s: f64,
    /// Where the tactile skin may go, in the frame of the robot's root link.
    pub workspace: Option<WorkspaceBox>,
    /// Limits of every degree of freedom, in the station's order.
    pub joints: Vec<JointSafety>,
}

/// A box in the frame of the robot's root link.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorkspaceBox {
    /// Lowest x, y, z, m.
    pub min_m: [f64; 3],
    /// Highest x, y, z, m.
    pub max_m: [f64; 3],
}

/// Limits of one degree of freedom; rad, or m where it slides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSafety {
    /// Lowest position; negative infinity for joints that turn without end.
    pub lower: f64,
    /// Highest position; infinity for joints that turn without end.
    pub upper: f64,
    /// Largest speed, per s; at most 2π rad/s for a joint of the hand, π/2 rad/s for a carrier's, 1 m/s where it slides.
    pub velocity: f64,
    /// Largest change of speed, per s²; at most 200 rad/s² for a joint of the hand, 20 for others. It stops the joint from
    /// its largest speed within 0.5 s.
    pub acceleration: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct SafetyText {
    lease_ttl_s: Spanned<f64>,
    heartbeat_ttl_s: Spanned<f64>,
    disarm_after_s: Spanned<f64>,
    command_ttl_s: Spanned<f64>,
    telemetry_ttl_s: Spanned<f64>,
    ease_in_s: Spanned<f64>,
    workspace: Option<Spanned<WorkspaceBox>>,
    joint_defaults: JointDefaultsText,
    joint: Vec<Spanned<JointText>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct JointDefaultsText {
    hand_velocity: Spanned<f64>,
    hand_acceleration: Spanned<f64>,
    carrier_velocity: Spanned<f64>,
    carrier_acceleration: Spanned<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JointText {
    name: String,
    velocity: Option<f64>,
    acceleration: Option<f64>,
    lower: Option<f64>,
    upper: Option<f64>,
}

fn unplaced(value: f64) -> Spanned<f64> {
    Spanned::new(0..0, value)
}

impl Default for SafetyText {
    fn default() -> Self {
        Self {
            lease_ttl_s: unplaced(6.0),
            heartbeat_ttl_s: unplaced(0.15),
            disarm_after_s: unplaced(0.5),
            command_ttl_s: unplaced(0.15),
            telemetry_ttl_s: unplaced(0.25),
            ease_in_s: unplaced(1.0),
            workspace: None,
            joint_defaults: JointDefaultsText::default(),
            joint: Vec::new(),
        }
    }
}

impl Default for JointDefaultsText {
    fn default() -> Self {
        Self {
            hand_velocity: unplaced(3.0),
            hand_acceleration: unplaced(40.0),
            carrier_velocity: unplaced(0.6),
            carrier_acceleration: unplaced(5.0),
        }
    }
}

/// The safety section, checked against the robot.
pub(crate) fn safety(
    source: &Source<'_>,
    text: SafetyText,
    robot: &Robot,
    carrier_dofs: &[usize],
) -> Result<SafetyConfig, ModelError> {
    let time = |name: &str, value: &Spanned<f64>, max_s: f64| {
        within(name, *value.get_ref(), max_s, "s")
            .map_err(|problem| source.error(value.span(), "safety", problem))
    };
    let heartbeat_ttl_s = time("heartbeat_ttl_s", &text.heartbeat_ttl_s, MAX_HEARTBEAT_TTL_S)?;
    let disarm_after_s = time("disarm_after_s", &text.disarm_after_s, MAX_DISARM_AFTER_S)?;
    let lease_ttl_s = time("lease_ttl_s", &text.lease_ttl_s, MAX_LEASE_TTL_S)?;
    let command_ttl_s = time("command_ttl_s", &text.command_ttl_s, MAX_COMMAND_TTL_S)?;
    let telemetry_ttl_s = time("telemetry_ttl_s", &text.telemetry_ttl_s, MAX_TELEMETRY_TTL_S)?;
    for (name, hold_s, value) in [
        ("heartbeat_ttl_s", heartbeat_ttl_s, &text.heartbeat_ttl_s),
        ("telemetry_ttl_s", telemetry_ttl_s, &text.telemetry_ttl_s),
        // A setpoint that outlives it would keep torque on beyond the time at which it is promised to be off.
        ("command_ttl_s", command_ttl_s, &text.command_ttl_s),
    ] {
        if hold_s >= disarm_after_s {
            let problem = format!(
                "{name} {hold_s} is not below disarm_after_s {disarm_after_s}; a joint holds before its torque goes off"
            );
            return Err(source.error(value.span(), "safety", problem));
        }
    }
    if lease_ttl_s < disarm_after_s {
        let problem = format!(
            "lease_ttl_s {lease_ttl_s} is below disarm_after_s {disarm_after_s}; a lease outlives the torque given under it"
        );
        return Err(source.error(text.lease_ttl_s.span(), "safety", problem));
    }
    let ease_in_s = *text.ease_in_s.get_ref();
    if !(0.0..=MAX_EASE_IN_S).contains(&ease_in_s) {
        let problem = format!("ease_in_s is {ease_in_s}, expected zero to {MAX_EASE_IN_S} s");
        return Err(source.error(text.ease_in_s.span(), "safety", problem));
    }
    let workspace = text.workspace.map(|workspace| checked_box(source, &workspace)).transpose()?;

    let default = |name: &str, value: &Spanned<f64>, max: f64, unit: &str| {
        within(name, *value.get_ref(), max, unit)
            .map_err(|problem| source.error(value.span(), "safety.joint_defaults", problem))
    };
    let defaults = &text.joint_defaults;
    let hand_velocity = default("hand_velocity", &defaults.hand_velocity, MAX_HAND_RAD_PER_S, "rad/s")?;
    let hand_acceleration =
        default("hand_acceleration", &defaults.hand_acceleration, MAX_HAND_RAD_PER_S2, "rad/s²")?;
    let carrier_velocity =
        default("carrier_velocity", &defaults.carrier_velocity, MAX_CARRIER_RAD_PER_S, "rad/s")?;
    let carrier_acceleration =
        default("carrier_acceleration", &defaults.carrier_acceleration, MAX_CARRIER_RAD_PER_S2, "rad/s²")?;
    for (kind, velocity, acceleration, value) in [
        ("hand", hand_velocity, hand_acceleration, &defaults.hand_acceleration),
        ("carrier", carrier_velocity, carrier_acceleration, &defaults.carrier_acceleration),
    ] {
        check_braking(&format!("{kind}_velocity"), &format!("{kind}_acceleration"), velocity, acceleration)
            .map_err(|problem| source.error(value.span(), "safety.joint_defaults", problem))?;
    }
    let mut joints: Vec<JointSafety> = robot
        .dofs()
        .enumerate()
        .map(|(dof, joint)| {
            let (velocity, acceleration) = if carrier_dofs.contains(&dof) {
                (carrier_velocity, carrier_acceleration)
            } else {
                (hand_velocity, hand_acceleration)
            };
            let (lower, upper, fastest) = match &joint.limits {
                Some(limits) => (limits.lower, limits.upper, limits.velocity),
                None => (f64::NEG_INFINITY, f64::INFINITY, f64::INFINITY),
            };
            // A robot file that gives no speed gives zero, by URDF's default.
            let velocity = if fastest > 0.0 { velocity.min(fastest) } else { velocity };
            // Defaults are those of joints that turn.
            let max = Ceiling::of(joint.kind, carrier_dofs.contains(&dof));
            let (velocity, acceleration) = (velocity.min(max.velocity), acceleration.min(max.acceleration));
            JointSafety { lower, upper, velocity, acceleration }
        })
        .collect();
    let mut named: Vec<String> = Vec::new();
    for entry in text.joint {
        let span = entry.span();
        let entry = entry.into_inner();
        let error = |problem: String| source.error(span.clone(), format!("joint {:?}", entry.name), problem);
        let Some((dof, joint)) = robot.dofs().enumerate().find(|(_, joint)| joint.name == entry.name) else {
            let known = list(robot.dofs().map(|joint| joint.name.as_str()));
            return Err(error(format!(
                "safety.joint names a joint that the station has not, expected one of {known}"
            )));
        };
        if named.contains(&entry.name) {
            return Err(error("this joint has two [[safety.joint]] entries, expected one".to_owned()));
        }
        let max = Ceiling::of(joint.kind, carrier_dofs.contains(&dof));
        narrow(&mut joints[dof], &entry, joint.limits.as_ref(), unit(joint.kind), &max).map_err(error)?;
        named.push(entry.name);
    }
    Ok(SafetyConfig {
        lease_ttl_s,
        heartbeat_ttl_s,
        disarm_after_s,
        command_ttl_s,
        telemetry_ttl_s,
        ease_in_s,
        workspace,
        joints,
    })
}

/// `value` if it is above zero and at most `max`.
fn within(name: &str, value: f64, max: f64, unit: &str) -> Result<f64, String> {
    // Ceilings such as a quarter turn per second have more digits than people write.
    let shown = (max * 1e3).floor() * 1e-3;
    positive(name, value)?;
    if value <= max { Ok(value) } else { Err(format!("{name} is {value}, expected at most {shown} {unit}")) }
}

/// That a joint with these limits stands within `MAX_BRAKING_S` when it brakes from its full speed.
fn check_braking(
    velocity_name: &str,
    acceleration_name: &str,
    velocity: f64,
    acceleration: f64,
) -> Result<(), String> {
    let braking_s = velocity / acceleration;
    if braking_s <= MAX_BRAKING_S {
        Ok(())
    } else {
        Err(format!(
            "{acceleration_name} is {acceleration}, so that braking from {velocity_name} {velocity} takes \
             {braking_s:.2} s, expected at most {MAX_BRAKING_S} s; lower {velocity_name}, or raise {acceleration_name}"
        ))
    }
}

/// The largest limits that a joint may have, rad or m.
struct Ceiling {
    velocity: f64,
    acceleration: f64,
}

impl Ceiling {
    fn of(kind: JointKind, is_carrier: bool) -> Self {
        match (kind, is_carrier) {
            (JointKind::Prismatic, _) => {
                Self { velocity: MAX_SLIDE_M_PER_S, acceleration: MAX_SLIDE_M_PER_S2 }
            }
            (_, true) => Self { velocity: MAX_CARRIER_RAD_PER_S, acceleration: MAX_CARRIER_RAD_PER_S2 },
            (_, false) => Self { velocity: MAX_HAND_RAD_PER_S, acceleration: MAX_HAND_RAD_PER_S2 },
        }
    }
}

fn checked_box(source: &Source<'_>, workspace: &Spanned<WorkspaceBox>) -> Result<WorkspaceBox, ModelError> {
    let WorkspaceBox { min_m, max_m } = *workspace.get_ref();
    for axis in 0..3 {
        let (min, max) = (min_m[axis], max_m[axis]);
        if !(min.is_finite() && max.is_finite() && min < max) {
            let axis = ["x", "y", "z"][axis];
            let problem = format!(
                "along {axis} it goes from {min} to {max} m, expected finite numbers, the lower first"
            );
            return Err(source.error(workspace.span(), "safety.workspace", problem));
        }
    }
    Ok(WorkspaceBox { min_m, max_m })
}

/// Limits of one joint may be tighter than the robot's, never wider: the robot file says what the hardware can do.
fn narrow(
    joint: &mut JointSafety,
    entry: &JointText,
    robot: Option<&crate::JointLimits>,
    unit: &str,
    max: &Ceiling,
) -> Result<(), String> {
    if let Some(velocity) = entry.velocity {
        joint.velocity = positive("velocity", velocity)?;
        if let Some(limits) = robot.filter(|limits| limits.velocity > 0.0 && velocity > limits.velocity) {
            return Err(format!(
                "velocity {velocity} {unit}/s is above the robot's {} {unit}/s, expected at most that",
                limits.velocity
            ));
        }
        within("velocity", velocity, max.velocity, &format!("{unit}/s"))?;
    }
    if let Some(acceleration) = entry.acceleration {
        joint.acceleration = within("acceleration", acceleration, max.acceleration, &format!("{unit}/s²"))?;
    }
    check_braking("velocity", "acceleration", joint.velocity, joint.acceleration)?;
    for (name, value) in [("lower", entry.lower), ("upper", entry.upper)] {
        let Some(value) = value else { continue };
        if !value.is_finite() || value < joint.lower.min(joint.upper) || value > joint.upper.max(joint.lower)
        {
            return Err(format!(
                "{name} is {value} {unit}, expected it within the robot's limits of {} to {} {unit}",
                joint.lower, joint.upper
            ));
        }
    }
    joint.lower = entry.lower.unwrap_or(joint.lower);
    joint.upper = entry.upper.unwrap_or(joint.upper);
    if joint.lower >= joint.upper {
        return Err(format!(
            "lower {} is not below upper {} {unit}, expected a range",
            joint.lower, joint.upper
        ));
    }
    Ok(())
}

fn unit(kind: JointKind) -> &'static str {
    if kind == JointKind::Prismatic { "m" } else { "rad" }
}

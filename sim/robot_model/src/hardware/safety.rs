//! `[safety]` of a station file: times and limits of the safety layer.

use serde::Deserialize;
use toml::Spanned;

use crate::{
    JointKind, ModelError, Robot,
    config::{Source, list, positive},
};

/// Times and limits within which a station may be moved.
#[derive(Clone, Debug, PartialEq)]
pub struct SafetyConfig {
    /// A lease without a heartbeat ends after this, s. Default 6.
    pub lease_ttl_s: f64,
    /// Motion stops where the operator's heartbeat is older than this, s. Default 0.15.
    pub heartbeat_ttl_s: f64,
    /// Torque goes off where heartbeat or telemetry is older than this, s; above `heartbeat_ttl_s`. Default 0.5.
    pub disarm_after_s: f64,
    /// How long a setpoint may be carried out, s. Default 0.15.
    pub command_ttl_s: f64,
    /// Motion stops where a joint's last reading is older than this, s; below `disarm_after_s`. Default 0.25.
    pub telemetry_ttl_s: f64,
    /// After arming, speeds rise from zero to their limits over this time, s; zero for at once. Default 1.
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
    /// Largest speed, per s.
    pub velocity: f64,
    /// Largest change of speed, per s².
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
    let time = |name: &str, value: &Spanned<f64>| {
        positive(name, *value.get_ref()).map_err(|problem| source.error(value.span(), "safety", problem))
    };
    let [heartbeat_ttl_s, disarm_after_s] =
        [time("heartbeat_ttl_s", &text.heartbeat_ttl_s)?, time("disarm_after_s", &text.disarm_after_s)?];
    let lease_ttl_s = time("lease_ttl_s", &text.lease_ttl_s)?;
    let command_ttl_s = time("command_ttl_s", &text.command_ttl_s)?;
    let telemetry_ttl_s = time("telemetry_ttl_s", &text.telemetry_ttl_s)?;
    for (name, hold_s, value) in [
        ("heartbeat_ttl_s", heartbeat_ttl_s, &text.heartbeat_ttl_s),
        ("telemetry_ttl_s", telemetry_ttl_s, &text.telemetry_ttl_s),
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
    if !(ease_in_s.is_finite() && ease_in_s >= 0.0) {
        let problem = format!("ease_in_s is {ease_in_s}, expected a finite number, zero or above");
        return Err(source.error(text.ease_in_s.span(), "safety", problem));
    }
    let workspace = text.workspace.map(|workspace| checked_box(source, &workspace)).transpose()?;

    let default = |name: &str, value: &Spanned<f64>| {
        positive(name, *value.get_ref())
            .map_err(|problem| source.error(value.span(), "safety.joint_defaults", problem))
    };
    let defaults = &text.joint_defaults;
    let hand_velocity = default("hand_velocity", &defaults.hand_velocity)?;
    let hand_acceleration = default("hand_acceleration", &defaults.hand_acceleration)?;
    let carrier_velocity = default("carrier_velocity", &defaults.carrier_velocity)?;
    let carrier_acceleration = default("carrier_acceleration", &defaults.carrier_acceleration)?;
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
        narrow(&mut joints[dof], &entry, joint.limits.as_ref(), unit(joint.kind)).map_err(error)?;
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
) -> Result<(), String> {
    if let Some(velocity) = entry.velocity {
        joint.velocity = positive("velocity", velocity)?;
        if let Some(limits) = robot.filter(|limits| limits.velocity > 0.0 && velocity > limits.velocity) {
            return Err(format!(
                "velocity {velocity} {unit}/s is above the robot's {} {unit}/s, expected at most that",
                limits.velocity
            ));
        }
    }
    if let Some(acceleration) = entry.acceleration {
        joint.acceleration = positive("acceleration", acceleration)?;
    }
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

//! What a robot and its sensors can report: joints within limits, objects within reach, readings within the device's range.

use nalgebra::Isometry3;
use palpate_robot_model::{Joint, JointKind, JointLimits, Robot, Stream, StreamConfig, TaxelAxes};

/// A joint that turns may be reported this much outside its limits, rad: the largest error of its zero that a diagnosis
/// looks for. A session that has one must stay usable, because diagnosing it is what it is for.
const MAX_ENCODER_ERROR_RAD: f64 = 0.1;
/// A joint that slides may be reported this much outside its limits, m. Scales are better than encoders of small gears.
const MAX_ENCODER_ERROR_M: f64 = 0.005;
/// An object's origin is at most this many reaches from the base: within one it is touched, and it has a size of its own.
const MAX_REACHES: f64 = 3.0;

/// How far a position may lie outside of `joint`'s limits.
fn encoder_error(joint: &Joint) -> f64 {
    if joint.kind == JointKind::Prismatic { MAX_ENCODER_ERROR_M } else { MAX_ENCODER_ERROR_RAD }
}

fn unit(joint: &Joint) -> &'static str {
    if joint.kind == JointKind::Prismatic { "m" } else { "rad" }
}

/// The limits of `joint` if `position` lies outside of them by more than an encoder's error.
pub(crate) fn exceeded_limits(joint: &Joint, position: f64) -> Option<JointLimits> {
    let error = encoder_error(joint);
    joint.limits.filter(|limits| position < limits.lower - error || position > limits.upper + error)
}

/// What is wrong with a position outside of `limits`, in words.
pub(crate) fn outside_limits(joint: &Joint, position: f64, limits: &JointLimits) -> String {
    format!(
        "{position} {unit} lies outside of the joint's limits, {lower}..{upper} {unit}, by more than an encoder's error \
         ({error} {unit}); check the unit, the zero and the order of the joints",
        position = short(position),
        unit = unit(joint),
        lower = limits.lower,
        upper = limits.upper,
        error = encoder_error(joint),
    )
}

/// Whether `positions` (`num_frames x num_dofs`, row-major) are degrees: most frames lie outside of the limits in some
/// turning joint, and all would lie within them if they were degrees.
pub(crate) fn are_degrees(robot: &Robot, positions: &[f64]) -> bool {
    let num_dofs = robot.num_dofs().max(1);
    let (mut num_frames, mut num_outside) = (0, 0);
    for frame in positions.chunks_exact(num_dofs) {
        let turning = || robot.dofs().zip(frame).filter(|(joint, _)| joint.kind == JointKind::Revolute);
        if turning().any(|(joint, position)| exceeded_limits(joint, position.to_radians()).is_some()) {
            return false;
        }
        num_frames += 1;
        num_outside +=
            usize::from(turning().any(|(joint, &position)| exceeded_limits(joint, position).is_some()));
    }
    2 * num_outside > num_frames
}

/// The message for joints that [`are_degrees`].
pub(crate) const DEGREES: &str =
    "most positions lie outside of the joints' limits and would fit as degrees; give radians";

/// What is wrong with the pose of an object, in words, if the robot cannot come near it.
pub(crate) fn out_of_reach(robot: &Robot, base_from_object: &Isometry3<f64>) -> Option<String> {
    let reach_m = reach_m(robot).filter(|&reach_m| reach_m > 0.0)?;
    let position = base_from_object.translation.vector;
    // Squares of large numbers are infinite.
    let distance_m = Some(position.norm()).filter(|norm| norm.is_finite()).unwrap_or_else(|| position.amax());
    (distance_m > MAX_REACHES * reach_m).then(|| {
        format!(
            "the object is {} m from the robot's base, which is more than {MAX_REACHES} times the robot's reach \
             ({reach_m:.2} m); give its position in metres in the base frame",
            short(distance_m)
        )
    })
}

/// How far the origin of any link can be from the base, m: all joints between them in one line. `None` where a joint
/// slides without limits.
fn reach_m(robot: &Robot) -> Option<f64> {
    let mut reaches_m = vec![0.0_f64; robot.links.len()];
    // Parents come before their children.
    for joint in &robot.joints {
        let slide_m = match (joint.kind, joint.limits) {
            (JointKind::Prismatic, Some(limits)) => limits.lower.abs().max(limits.upper.abs()),
            (JointKind::Prismatic, None) => return None,
            _ => 0.0,
        };
        let origin_m = joint.parent_from_joint.translation.vector.norm();
        reaches_m[joint.child_link] = reaches_m[joint.parent_link] + origin_m + slide_m;
    }
    reaches_m.into_iter().reduce(f64::max)
}

/// What is wrong with a reading that the device of `config` cannot give, in words. Readings above the range are left to
/// the check of a session, which warns: they lose nothing of a touch.
pub(crate) fn below_range(config: &StreamConfig, reading: f64, raw_unit: &str) -> Option<String> {
    (reading < config.raw_min).then(|| {
        format!(
            "{} {raw_unit} is less than {}, the least that the device can give; check the unit, or lower raw_min in the \
             station file if readings are relative to those at rest",
            short(reading),
            config.raw_min
        )
    })
}

/// How far a channel falls below its reference where it falls as far as a touch would make it rise, and never rises so
/// far; then its readings fall under load, most likely. `above_reference` are its readings less the reference.
pub(crate) fn fall_under_load(
    config: &StreamConfig,
    above_reference: impl Iterator<Item = f64>,
) -> Option<f64> {
    let extremes = (f64::INFINITY, f64::NEG_INFINITY);
    let (lowest, highest) =
        above_reference.fold(extremes, |(lowest, highest), above| (lowest.min(above), highest.max(above)));
    let (fall, rise) = (-lowest, highest);
    (fall.is_finite() && fall > config.on_threshold && rise <= config.on_threshold).then_some(fall)
}

/// The message for a channel that [`fall_under_load`].
pub(crate) fn falls(fall: f64, stream: &Stream) -> String {
    let remedy = match stream.axes {
        TaxelAxes::Normal { axis, .. } => {
            format!("write normal_axis = \"-{}\" in the layout", TaxelAxes::NAMES[axis])
        }
        TaxelAxes::One | TaxelAxes::Norm { .. } => {
            "import it with polarity = -1 in a mapping file".to_owned()
        }
    };
    format!(
        "never rises from its reading at rest, but falls by up to {} {}; if a touch makes it fall, {remedy}",
        short((fall * 10.0).round() / 10.0),
        stream.raw_unit
    )
}

/// Numbers of hundreds of digits push the rest of a message out of sight.
pub(crate) fn short(number: f64) -> String {
    if number.abs() < 1e6 { number.to_string() } else { format!("{number:e}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two turning joints and a slide: 0.3 m to the first joint, 0.2 m to the second, a slide of at most 0.1 m.
    const URDF: &str = r#"<robot name="arm"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
        <joint name="one" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
        <limit lower="-6" upper="6" velocity="1" effort="1"/></joint>
        <joint name="two" type="revolute"><parent link="b"/><child link="c"/><origin xyz="0.2 0 0"/><axis xyz="0 0 1"/>
        <limit lower="-1" upper="2" velocity="1" effort="1"/></joint>
        <joint name="three" type="prismatic"><parent link="c"/><child link="d"/><axis xyz="0 0 1"/>
        <limit lower="-0.1" upper="0.05" velocity="1" effort="1"/></joint></robot>"#;

    fn robot() -> Robot {
        Robot::from_urdf("arm.urdf", URDF, &[]).unwrap()
    }

    #[test]
    fn encoder_errors_are_allowed_and_more_is_not() {
        let robot = robot();
        let is_outside =
            |dof: usize, position: f64| exceeded_limits(robot.dofs().nth(dof).unwrap(), position).is_some();
        for (dof, inside, outside) in
            [(0, 6.09, 6.11), (1, -1.09, -1.11), (2, 0.054, 0.056), (2, -0.104, 1e308)]
        {
            assert!(!is_outside(dof, inside) && is_outside(dof, outside), "joint {dof}");
        }
    }

    #[test]
    fn degrees_are_told_from_a_stray_value() {
        let robot = robot();
        let degrees = [90.0, -40.0, 0.0, 45.0, 1.0, 0.01, 120.0, 80.0, 0.0];
        assert!(are_degrees(&robot, &degrees));
        assert!(!are_degrees(&robot, &degrees.map(f64::to_radians)));
        // One frame of three.
        assert!(!are_degrees(&robot, &[100.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.1, 0.0, 0.0]));
        // More than a turn.
        assert!(!are_degrees(&robot, &[900.0, 0.0, 0.0]));
        assert!(!are_degrees(&robot, &[]));
    }

    #[test]
    fn reach_is_that_of_the_stretched_robot() {
        assert!((reach_m(&robot()).unwrap() - 0.6).abs() < 1e-12);
        let pose = |x_m: f64| Isometry3::translation(x_m, 0.0, 0.0);
        assert!(out_of_reach(&robot(), &pose(1.7)).is_none());
        for x_m in [1.9, -1.9, 1e308] {
            let problem = out_of_reach(&robot(), &pose(x_m)).unwrap();
            assert!(problem.contains("times the robot's reach (0.60 m)") && problem.len() < 250, "{problem}");
        }
    }
}

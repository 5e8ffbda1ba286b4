//! Plans as files, for people to go on with.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use palpate_robot_model::{JointKind, Station};

use crate::primitive::{Actuator, Motion};
use crate::{Plan, Primitive};

/// `plan` as a file that [`Plan::from_text`] reads, with comments that say what to change, after lines that say what it is
/// `about`. It holds the primitives that its takes name.
pub fn plan_text(plan: &Plan, station: &Station, about: &[String]) -> String {
    let motion = &plan.motion;
    let mut text = String::new();
    for line in about {
        let _ = writeln!(text, "# {}", in_comment(line));
    }
    let _ = write!(
        text,
        "# Fields: docs/plans.md. After a change the screen Plans shows each take, and says what is wrong.\n\
         format = 1\nlabel = {}\nseed = {} # another seed finds other postures\n\n\
         [motion]\n\
         speed_fraction = {:?} # share of a joint's speed limit between touches: lower it for a first run\n\
         baseline_s = {:?} # still time before the first touch\n\
         safe_clearance_m = {:?} # how far from the object the robot moves from one touch to the next\n\
         tilt_rad = {:?} # how far the orientation at a touch may differ from the one at rest\n\
         settle_rad = {:?} # joints arrive at a touch from so far above or below\n\n\
         # Where a take starts and ends. Only the way to the object is looked at, not whether the robot meets itself, a table or\n\
         # a wall: try it slowly first, and change it where it does.\n[motion.rest]\n",
        string(&plan.label),
        plan.seed,
        motion.speed_fraction,
        motion.baseline_s,
        motion.safe_clearance_m,
        motion.tilt_rad,
        motion.settle_rad,
    );
    text.push_str(&positions(station, &motion.rest));
    if !motion.away.is_empty() {
        text.push_str("\n# Where joints are that take no part in a touch.\n[motion.away]\n");
        text.push_str(&positions(station, &motion.away));
    }
    for (id, pose) in &plan.objects {
        let [x, y, z] = pose.position_m;
        let _ = write!(
            text,
            "\n# Its middle, m, in the frame of {}. Put it there, or write where it is: a millimetre matters.\n\
             [object.{}]\nposition_m = [{x:?}, {y:?}, {z:?}]\n",
            in_comment(&station.robot.links[0].name),
            key(id),
        );
        if pose.quaternion_wxyz != [1.0, 0.0, 0.0, 0.0] {
            let _ = writeln!(text, "quaternion_wxyz = {:?}", pose.quaternion_wxyz);
        }
    }
    for (id, primitive) in &plan.primitives {
        if plan.takes.iter().any(|take| take.primitive == *id) {
            text.push_str(&primitive_text(id, primitive));
        }
    }
    for take in &plan.takes {
        let touches: Vec<String> = take.touch.iter().map(|touch| string(touch)).collect();
        let _ = write!(
            text,
            "\n[[take]]\nobject = {}\nprimitive = {}\nduration_s = {:?} # longer where limits make the robot slower\n\
             touch = [{}]\n",
            string(&take.object),
            string(&take.primitive),
            take.duration_s,
            touches.join(", "),
        );
        if !take.instruction.is_empty() {
            let _ = writeln!(text, "instruction = {}", string(&take.instruction));
        }
    }
    text
}

/// Positions of joints by name, a line each, in the station's order.
fn positions(station: &Station, named: &BTreeMap<String, f64>) -> String {
    let mut text = String::new();
    for joint in station.robot.dofs() {
        if let Some(position) = named.get(&joint.name) {
            let unit = if joint.kind == JointKind::Prismatic { "m" } else { "rad" };
            let _ = writeln!(text, "{} = {position:?} # {unit}", key(&joint.name));
        }
    }
    text
}

fn primitive_text(id: &str, primitive: &Primitive) -> String {
    let motion = match primitive.motion {
        Motion::Press => "press",
        Motion::Slide => "slide",
        Motion::Roll => "roll",
    };
    let pressed_by: Vec<&str> = primitive
        .pressed_by
        .iter()
        .map(|actuator| match actuator {
            Actuator::Carrier => "\"carrier\"",
            Actuator::Limb => "\"limb\"",
        })
        .collect();
    let mut text = format!(
        "\n[primitive.{}]\nlabel = {}\nmotion = \"{motion}\"\n\
         clearance_m = {:?} # from the object before and after each repetition\n\
         depth_m = {:?} # how far the skin goes in: less for a stiff skin or a weak finger\n\
         dwell_s = {:?} # at depth\ngap_s = {:?} # away from the object\n",
        key(id),
        string(&primitive.label),
        primitive.clearance_m,
        primitive.depth_m,
        primitive.dwell_s,
        primitive.gap_s,
    );
    if primitive.motion != Motion::Press {
        let _ = writeln!(text, "reach = {:?} # half the traverse, m or rad", primitive.reach);
    }
    if primitive.both_sides {
        text.push_str("both_sides = true\n");
    }
    let _ = write!(
        text,
        "repetitions = {} # at each speed; a diagnosis needs at least 2\nspeeds_in_turn = {}\n\
         pressed_by = [{}]\n",
        primitive.repetitions,
        primitive.speeds_in_turn,
        pressed_by.join(", "),
    );
    for speed in &primitive.speeds {
        let _ = write!(
            text,
            "\n[[primitive.{}.speed]]\nid = {}\npress_m_per_s = {:?}\n",
            key(id),
            string(&speed.id),
            speed.press_m_per_s
        );
        if primitive.motion != Motion::Press {
            let _ = writeln!(text, "traverse_per_s = {:?}", speed.traverse_per_s);
        }
    }
    text
}

/// `text` in quotes, as TOML has it.
fn string(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

/// `name` as a key of TOML: bare where that can be.
fn key(name: &str) -> String {
    let is_bare = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
    if is_bare { name.to_owned() } else { string(name) }
}

/// `text` for the rest of a line that is a comment.
fn in_comment(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

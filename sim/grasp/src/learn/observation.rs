//! Which number of an observation is what.

use std::ops::Range;

use palpate_robot_model::Station;
use serde::Serialize;

/// Numbers that belong together.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Segment {
    /// What they are.
    pub name: &'static str,
    /// Their unit.
    pub unit: &'static str,
    /// Where they are in the observation.
    pub range: Range<usize>,
    /// What each of them belongs to: a joint, a channel, a digit's axis.
    pub entries: Vec<String>,
}

/// The observations of actor and critic. The critic's begins with the actor's.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ObservationLayout {
    /// What the real robot has too.
    pub actor: Vec<Segment>,
    /// What only a simulator has; ranges count from the beginning of the critic's observation.
    pub privileged: Vec<Segment>,
    /// The action: hand joints in the robot's order, then the hand's root.
    pub action: Vec<String>,
}

impl ObservationLayout {
    /// For a station whose hand has these degrees of freedom and digits, by the names of their tips.
    ///
    /// # Panics
    /// If there is no such degree of freedom: a caller's bug.
    pub fn new(station: &Station, hand_dofs: &[usize], digits: &[String]) -> Self {
        let joints: Vec<String> = station.robot.dofs().map(|joint| joint.name.clone()).collect();
        let channels: Vec<String> =
            station.layout.channels.iter().map(|channel| channel.id.to_string()).collect();
        let axes = |of: &str| ["x", "y", "z"].map(|axis| format!("{of} {axis}")).to_vec();
        let mut action: Vec<String> = hand_dofs.iter().map(|&dof| joints[dof].clone()).collect();
        action.extend(axes("hand"));
        action.push("hand yaw".to_owned());
        let mut next = 0;
        let mut segment = |name, unit, entries: Vec<String>| {
            let range = next..next + entries.len();
            next = range.end;
            Segment { name, unit, range, entries }
        };
        let actor = vec![
            segment("joint_positions", "rad or m", joints.clone()),
            segment("commands", "rad or m", joints.clone()),
            segment("tracking_errors", "rad or m", joints.clone()),
            segment("touch", "0 or 1", channels.clone()),
            segment("past_touch", "0 to 1", channels),
            segment("last_action", "-1 to 1", action.clone()),
            segment("phase", "0 to 1", vec!["episode".to_owned()]),
        ];
        let tips = digits.iter().flat_map(|digit| axes(digit)).collect();
        let privileged = vec![
            segment("exact_joint_positions", "rad or m", joints.clone()),
            segment("joint_velocities", "rad/s or m/s", joints),
            segment("object_from_hand", "m", axes("object")),
            segment(
                "object_rotation",
                "first two columns of base_from_object",
                [axes("object's x, base"), axes("object's y, base")].concat(),
            ),
            segment("object_velocity", "m/s", axes("object")),
            segment("object_spin", "rad/s, object axes", axes("object")),
            segment("object_lift", "m", vec!["object".to_owned()]),
            segment("tips_in_object", "m", tips),
            segment("tip_distances", "m", digits.to_vec()),
            segment("digits_touching", "0 or 1", digits.to_vec()),
            segment(
                "contact_forces",
                "N",
                ["robot on object", "robot on table", "object on table"].map(str::to_owned).to_vec(),
            ),
            segment("push", "N", axes("object")),
        ];
        Self { actor, privileged, action }
    }

    /// Length of the actor's observation.
    pub fn actor_dim(&self) -> usize {
        self.actor.last().map_or(0, |segment| segment.range.end)
    }

    /// Length of the critic's.
    pub fn critic_dim(&self) -> usize {
        self.privileged.last().map_or(0, |segment| segment.range.end)
    }

    /// Length of an action.
    pub fn action_dim(&self) -> usize {
        self.action.len()
    }
}

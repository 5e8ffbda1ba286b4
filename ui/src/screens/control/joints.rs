//! Which joints a station lets an operator move, in which groups, and which postures it knows: all from its files.

use std::collections::BTreeMap;

use palpate_robot_model::{JointKind, Station};
use serde::Deserialize;

use crate::screens::capitalised;

/// Range of a joint without limits, rad or m to either side: a slider needs ends.
const UNLIMITED: f64 = std::f64::consts::PI;

/// A joint that can be commanded.
#[derive(Clone, Debug, PartialEq)]
pub struct JointControl {
    /// Degree of freedom, in the station's order.
    pub dof: usize,
    /// Its name in the station's files.
    pub name: String,
    /// The same for people, without the name of its group.
    pub label: String,
    /// How it moves.
    pub kind: JointKind,
    /// Lowest position, rad or m.
    pub lower: f64,
    /// Highest position, rad or m.
    pub upper: f64,
}

impl JointControl {
    /// `position` in the unit that people read: degrees or millimetres.
    pub fn text(&self, position: f64) -> String {
        match self.kind {
            JointKind::Prismatic => format!("{:.1} mm", position * 1e3),
            JointKind::Revolute | JointKind::Fixed => format!("{:.1}\u{b0}", position.to_degrees()),
        }
    }

    /// `position`, within the limits.
    pub fn clamp(&self, position: f64) -> f64 {
        position.clamp(self.lower, self.upper)
    }
}

/// Joints that belong together: a finger.
#[derive(Clone, Debug, PartialEq)]
pub struct JointGroup {
    /// Name for people.
    pub label: String,
    /// In the station's order.
    pub joints: Vec<JointControl>,
}

/// A posture of the hand.
#[derive(Clone, Debug, PartialEq)]
pub struct Preset {
    /// What the button says.
    pub label: &'static str,
    /// What it does.
    pub hint: &'static str,
    /// Degrees of freedom and where they go, rad or m.
    pub positions: Vec<(usize, f64)>,
}

/// Everything that an operator can move.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Controls {
    /// The hand, finger by finger.
    pub hand: Vec<JointGroup>,
    /// What carries it.
    pub carrier: Vec<JointControl>,
    /// Postures of the hand.
    pub presets: Vec<Preset>,
}

/// The part of a plan that says where the robot rests.
#[derive(Deserialize)]
struct RestingPlan {
    motion: RestingMotion,
}

#[derive(Deserialize)]
struct RestingMotion {
    rest: BTreeMap<String, f64>,
}

impl Controls {
    /// The joints of `station`. A finger is what moves the patches of one group of the layout and of no other.
    pub fn new(station: &Station) -> Self {
        let robot = &station.robot;
        let all: Vec<JointControl> = robot
            .dofs()
            .enumerate()
            .map(|(dof, joint)| {
                // What the safety layer keeps to, which may be less than the robot could.
                let limits = station.safety.joints.get(dof);
                let lower = limits.map(|limits| limits.lower).filter(|limit| limit.is_finite());
                let upper = limits.map(|limits| limits.upper).filter(|limit| limit.is_finite());
                JointControl {
                    dof,
                    name: joint.name.clone(),
                    label: capitalised(&joint.name),
                    kind: joint.kind,
                    lower: lower.unwrap_or(-UNLIMITED),
                    upper: upper.unwrap_or(UNLIMITED),
                }
            })
            .collect();
        let is_carrier = |dof: usize| station.carrier_dofs.contains(&dof);
        let (carrier, hand): (Vec<_>, Vec<_>) = all.into_iter().partition(|joint| is_carrier(joint.dof));
        let presets = presets(station, &hand);
        Self { hand: groups(station, hand), carrier, presets }
    }
}

fn groups(station: &Station, joints: Vec<JointControl>) -> Vec<JointGroup> {
    let mut names: Vec<&str> = Vec::new();
    for patch in &station.layout.patches {
        if !names.contains(&patch.group.as_str()) {
            names.push(&patch.group);
        }
    }
    let moves = |dof: usize, group: &str| {
        let mut links =
            station.layout.patches.iter().filter(|patch| patch.group == group).map(|patch| patch.link);
        links.any(|link| moves_link(station, dof, link))
    };
    const SHARED: &str = "Whole hand";
    const OTHERS: &str = "Other joints";
    let mut groups: Vec<JointGroup> =
        names.iter().map(|name| JointGroup { label: capitalised(name), joints: Vec::new() }).collect();
    groups.extend([SHARED, OTHERS].map(|label| JointGroup { label: label.to_owned(), joints: Vec::new() }));
    for mut joint in joints {
        let mut of = names.iter().enumerate().filter(|(_, name)| moves(joint.dof, name));
        let idx = match (of.next(), of.next()) {
            (Some((idx, name)), None) => {
                let rest = joint.name.strip_prefix(*name).map(|rest| rest.trim_start_matches(['_', '-']));
                if let Some(rest) = rest.filter(|rest| !rest.is_empty()) {
                    joint.label = capitalised(rest);
                }
                idx
            }
            (Some(_), Some(_)) => names.len(),
            (None, _) => names.len() + 1,
        };
        groups[idx].joints.push(joint);
    }
    groups.retain(|group| !group.joints.is_empty());
    if let [only] = &mut groups[..] {
        "Joints".clone_into(&mut only.label);
    }
    groups
}

/// Whether `link` hangs from the joint that `dof` drives.
fn moves_link(station: &Station, dof: usize, mut link: usize) -> bool {
    let joints = &station.robot.joints;
    while let Some(joint) = joints.iter().find(|joint| joint.child_link == link) {
        if joint.dof == Some(dof) {
            return true;
        }
        link = joint.parent_link;
    }
    false
}

fn presets(station: &Station, hand: &[JointControl]) -> Vec<Preset> {
    // Zero stretches a finger; on a linear axis it is only where somebody put the scale.
    let open: Vec<(usize, f64)> = hand
        .iter()
        .filter(|joint| joint.kind == JointKind::Revolute)
        .map(|joint| (joint.dof, joint.clamp(0.0)))
        .collect();
    let resting = rest(station);
    let rest: Vec<(usize, f64)> = hand
        .iter()
        .filter_map(|joint| {
            resting.get(&joint.name).filter(|at| at.is_finite()).map(|&at| (joint.dof, joint.clamp(at)))
        })
        .collect();
    [
        Preset {
            label: "Open",
            hint: "Every joint of the hand to zero, or as near as it can",
            positions: open,
        },
        Preset {
            label: "Rest",
            hint: "Where the hand rests between takes, from the station's plan",
            positions: rest,
        },
    ]
    .into_iter()
    .filter(|preset| !preset.positions.is_empty())
    .collect()
}

/// Where the joints rest, by name, as the station's first plan says; empty without a plan.
fn rest(station: &Station) -> BTreeMap<String, f64> {
    let mut plans = station.plans.iter().filter_map(|(_, text)| toml::from_str::<RestingPlan>(text).ok());
    plans.next().map_or_else(BTreeMap::new, |plan| plan.motion.rest)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn station(name: &str) -> Station {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/stations");
        Station::read(&format!("{name}.toml"), |path| {
            std::fs::read(folder.join(path)).map_err(|error| error.to_string())
        })
        .expect("a station that ships")
    }

    #[test]
    fn fingers_are_what_moves_one_group_of_taxels() {
        let leap = station("xarm6_leap");
        let controls = Controls::new(&leap);
        let labels: Vec<_> = controls.hand.iter().map(|group| group.label.as_str()).collect();
        assert_eq!(labels, ["Index", "Middle", "Ring", "Thumb"]);
        for group in &controls.hand {
            let prefix = group.label.to_lowercase();
            assert!(group.joints.iter().all(|joint| joint.name.starts_with(&prefix)), "{group:?}");
        }
        assert_eq!(controls.hand[0].joints[1].label, "Mcp forward");
        let counted = controls.carrier.len() + controls.hand.iter().map(|g| g.joints.len()).sum::<usize>();
        assert_eq!(counted, leap.robot.num_dofs());
        assert_eq!(controls.carrier.len(), leap.carrier_dofs.len());
    }

    #[test]
    fn a_station_without_fingers_has_joints() {
        let controls = Controls::new(&station("probe_bench"));
        let all: Vec<_> =
            controls.hand.iter().flat_map(|group| &group.joints).chain(&controls.carrier).collect();
        assert_eq!(all.len(), 3);
        assert_eq!(all[0].text(0.0123), "12.3 mm");
        assert!(
            controls.presets.iter().all(|preset| preset.label != "Open"),
            "zero means nothing on a stage"
        );
    }

    #[test]
    fn presets_keep_the_limits_and_the_plan_says_where_the_hand_rests() {
        let mut leap = station("xarm6_leap");
        let limited = leap.robot.dofs().position(|joint| joint.name == "middle_pip").expect("there");
        leap.safety.joints[limited].upper = 0.5;
        leap.plans.clear();
        let before = Controls::new(&leap);
        assert_eq!(before.presets.len(), 1, "no plan, no rest");
        for &(dof, position) in &before.presets[0].positions {
            let limits =
                leap.robot.dofs().nth(dof).and_then(|joint| joint.limits).expect("the hand has limits");
            assert!((limits.lower..=limits.upper).contains(&position));
            assert!(!leap.carrier_dofs.contains(&dof));
        }
        let plan = "[motion.rest]\nindex_pip = 0.4\nmiddle_pip = 99.0\njoint3 = -1.2\nring_pip = nan\n";
        leap.plans = vec![("broken".to_owned(), "=".to_owned()), ("p".to_owned(), plan.to_owned())];
        let controls = Controls::new(&leap);
        let rest = &controls.presets[1];
        let joint = |name: &str| {
            controls.hand.iter().flat_map(|g| &g.joints).find(|joint| joint.name == name).expect("there")
        };
        let [index, middle] = ["index_pip", "middle_pip"].map(joint);
        assert_eq!(middle.upper, 0.5, "the station's limit, not the robot's");
        assert_eq!(rest.positions, [(index.dof, 0.4), (middle.dof, 0.5)]);
    }
}

//! What is understood of a robot, before anything is made of it.

use nalgebra::{Isometry3, Point3};
use serde::Serialize;

use crate::{JointKind, Link, Robot, SimplifiedUrdf, config::list};

/// A robot as the reader understands it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RobotReport {
    /// Name in the URDF.
    pub robot: String,
    /// Its root link, in whose frame objects are placed.
    pub root: String,
    /// Joints, in the order of their links.
    pub joints: Vec<JointReport>,
    /// Links, tips first.
    pub links: Vec<LinkReport>,
    /// What was changed of the URDF so that it can be read.
    pub changes: Vec<String>,
    /// What may be wrong.
    pub warnings: Vec<String>,
}

/// A joint.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JointReport {
    /// Name, which a column of recordings has.
    pub joint: String,
    /// `revolute`, `prismatic` or `fixed`; continuous joints are revolute ones without limits.
    pub kind: &'static str,
    /// `rad`, `m`, or nothing for a fixed joint.
    pub unit: &'static str,
    /// Lowest position; `None` without limits.
    pub lower: Option<f64>,
    /// Highest position; `None` without limits.
    pub upper: Option<f64>,
    /// What it follows, if it does.
    pub follows: Option<Follows>,
    /// The link it is on.
    pub parent: String,
    /// The link that it moves.
    pub child: String,
}

/// What a joint follows.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Follows {
    /// The other joint.
    pub joint: String,
    /// Position for each unit of the other's.
    pub multiplier: f64,
    /// Position where the other is at zero.
    pub offset: f64,
}

/// A link.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LinkReport {
    /// Name, which patches are placed by.
    pub link: String,
    /// Whether nothing with a shape is on it.
    pub tip: bool,
    /// Number of collision shapes.
    pub collision_shapes: usize,
    /// Number of visual shapes.
    pub visual_shapes: usize,
    /// Size of the box around its shapes along the link's axes, m.
    pub size_m: Option<[f64; 3]>,
}

/// Says what is understood of `robot`, which was read from `urdf`.
pub fn explain(robot: &Robot, urdf: &SimplifiedUrdf) -> RobotReport {
    let name_of = |link: usize| robot.links[link].name.clone();
    let joints = robot.joints.iter().map(|joint| {
        let (kind, unit) = match joint.kind {
            JointKind::Fixed => ("fixed", ""),
            JointKind::Revolute => ("revolute", "rad"),
            JointKind::Prismatic => ("prismatic", "m"),
        };
        JointReport {
            joint: joint.name.clone(),
            kind,
            unit,
            lower: joint.limits.map(|limits| limits.lower),
            upper: joint.limits.map(|limits| limits.upper),
            follows: joint.mimic.map(|mimic| Follows {
                joint: robot.joints[mimic.joint].name.clone(),
                multiplier: mimic.multiplier,
                offset: mimic.offset,
            }),
            parent: name_of(joint.parent_link),
            child: name_of(joint.child_link),
        }
    });
    let tips = tips(robot);
    let mut links: Vec<LinkReport> = robot
        .links
        .iter()
        .enumerate()
        .map(|(idx, link)| LinkReport {
            link: link.name.clone(),
            tip: tips.contains(&idx),
            collision_shapes: link.collisions.len(),
            visual_shapes: link.visuals.len(),
            size_m: bounds(link).map(|[min, max]| (max - min).into()),
        })
        .collect();
    links.sort_by_key(|link| !link.tip);
    let mut warnings = urdf.warnings.clone();
    warn(&mut warnings, "has no limits, so no recorded position is refused as impossible", "joint", {
        let open = robot.dofs().filter(|joint| joint.limits.is_none());
        open.map(|joint| joint.name.as_str()).collect()
    });
    let bare: Vec<&str> =
        robot.links.iter().filter(|link| bounds(link).is_none()).map(|link| link.name.as_str()).collect();
    if !bare.is_empty() {
        warnings.push(format!("a patch on a link without a shape is placed at its origin: {}", list(bare)));
    }
    warn(&mut warnings, "has no collision shape; its visual shape is used instead", "link", {
        let seen = |link: &&Link| link.collisions.is_empty() && !link.visuals.is_empty();
        robot.links.iter().filter(seen).map(|link| link.name.as_str()).collect()
    });
    if robot.num_dofs() == 0 {
        warnings.push("no joint moves, and a station needs one that does".to_owned());
    }
    RobotReport {
        robot: robot.name.clone(),
        root: name_of(0),
        joints: joints.collect(),
        links,
        changes: urdf.changes.clone(),
        warnings,
    }
}

/// Links with a shape that carry no other such link; of a robot without shapes, links that carry none. A frame at a fingertip
/// is no tip.
fn tips(robot: &Robot) -> Vec<usize> {
    let has_shape = |link: usize| bounds(&robot.links[link]).is_some();
    let is_bare = (0..robot.links.len()).all(|link| !has_shape(link));
    let counts = |link: usize| is_bare || has_shape(link);
    let mut carries = vec![false; robot.links.len()];
    // Joints come parents first, so what a link carries is known before its parent is looked at.
    for joint in robot.joints.iter().rev() {
        carries[joint.parent_link] |= carries[joint.child_link] || counts(joint.child_link);
    }
    (0..robot.links.len()).filter(|&link| counts(link) && !carries[link]).collect()
}

fn warn(warnings: &mut Vec<String>, problem: &str, what: &str, names: Vec<&str>) {
    warnings.extend(names.into_iter().map(|name| format!("{what} {name:?} {problem}")));
}

/// Lowest and highest coordinates of a link's collision shapes in its own frame, of its visual shapes where it has none.
pub(super) fn bounds(link: &Link) -> Option<[Point3<f64>; 2]> {
    let shapes = if link.collisions.is_empty() { &link.visuals } else { &link.collisions };
    shapes
        .iter()
        .map(|shape| shape.bounds(&Isometry3::identity()))
        .reduce(|[min, max], [other_min, other_max]| [min.inf(&other_min), max.sup(&other_max)])
}

//! Where some links of a robot are along a path of its joints.

use nalgebra::Isometry3;

use super::Robot;

/// Poses of some links in the root frame, frame by frame of a path.
#[derive(Clone, Debug)]
pub struct LinkPoses {
    /// Per link; `None` where nobody asked for it.
    root_from_link: Vec<Option<Vec<Isometry3<f64>>>>,
}

impl LinkPoses {
    /// Poses of `links`, and of all links between them and the root, along `positions` (`num_frames x num_dofs`, row-major,
    /// rad or m).
    pub fn new(robot: &Robot, links: impl IntoIterator<Item = usize>, positions: &[f64]) -> Self {
        let mut tracker = LinkTracker::new(robot, links, None);
        let num_frames = positions.len() / robot.num_dofs().max(1);
        let mut root_from_link = vec![None; robot.links.len()];
        for step in &tracker.steps {
            root_from_link[step.link] = Some(Vec::with_capacity(num_frames));
        }
        for (frame, positions) in positions.chunks_exact(robot.num_dofs().max(1)).enumerate() {
            let poses = tracker.at(frame, positions);
            for (of_link, pose) in root_from_link.iter_mut().zip(poses) {
                if let Some(of_link) = of_link {
                    of_link.push(*pose);
                }
            }
        }
        Self { root_from_link }
    }
}

/// Poses along a path of which other links than the `moved` ones are where `poses` has them, to the bit.
#[derive(Clone, Debug)]
pub struct KnownPoses<'a> {
    poses: &'a LinkPoses,
    /// Per link.
    moved: Vec<bool>,
}

impl<'a> KnownPoses<'a> {
    /// What `poses`, along `known`, says of a path `positions` of as many frames.
    pub fn new(robot: &Robot, poses: &'a LinkPoses, known: &[f64], positions: &[f64]) -> Self {
        let mut other = vec![false; robot.num_dofs()];
        let num_dofs = robot.num_dofs().max(1);
        if known.len() != positions.len() {
            other.fill(true);
        } else if !std::ptr::eq(known, positions) {
            for (known, positions) in known.chunks_exact(num_dofs).zip(positions.chunks_exact(num_dofs)) {
                for (other, (known, position)) in other.iter_mut().zip(known.iter().zip(positions)) {
                    *other |= known.to_bits() != position.to_bits();
                }
            }
        }
        let mut moved = vec![false; robot.links.len()];
        for joint in &robot.joints {
            moved[joint.child_link] = moved[joint.parent_link] || joint.dof.is_some_and(|dof| other[dof]);
        }
        Self { poses, moved }
    }

    fn of(&self, link: usize) -> Option<&'a [Isometry3<f64>]> {
        self.poses.root_from_link[link].as_deref().filter(|_| !self.moved[link])
    }
}

/// Forward kinematics of some links, frame by frame, which computes no pose that is known or that none of them needs.
#[derive(Clone, Debug)]
pub struct LinkTracker<'a> {
    robot: &'a Robot,
    /// In an order in which parents come before their children.
    steps: Vec<Step<'a>>,
    root_from_link: Vec<Isometry3<f64>>,
}

#[derive(Clone, Debug)]
struct Step<'a> {
    link: usize,
    /// Its poses, where they are known.
    known: Option<&'a [Isometry3<f64>]>,
}

impl<'a> LinkTracker<'a> {
    /// For `links` of `robot`, along a path of which some poses may be `known`.
    pub fn new(
        robot: &'a Robot,
        links: impl IntoIterator<Item = usize>,
        known: Option<&KnownPoses<'a>>,
    ) -> Self {
        let known_of = |link: usize| known.and_then(|known| known.of(link));
        let mut needed = vec![false; robot.links.len()];
        links.into_iter().for_each(|link| needed[link] = true);
        // Parents come before their children.
        for joint in robot.joints.iter().rev() {
            needed[joint.parent_link] |= needed[joint.child_link] && known_of(joint.child_link).is_none();
        }
        let needed = (0..robot.links.len()).filter(|&link| needed[link]);
        let steps = needed.map(|link| Step { link, known: known_of(link) }).collect();
        Self { robot, steps, root_from_link: vec![Isometry3::identity(); robot.links.len()] }
    }

    /// Poses in the root frame with the joints at `positions`, one a link as [`Robot::forward_kinematics`] has them to the
    /// bit; those of links that nobody asked for mean nothing. `frame` is which one of the path it is.
    ///
    /// # Panics
    /// If `positions` has the wrong length: a caller's bug, as in [`Robot::forward_kinematics`].
    pub fn at(&mut self, frame: usize, positions: &[f64]) -> &[Isometry3<f64>] {
        assert_eq!(positions.len(), self.robot.num_dofs(), "one position per degree of freedom");
        for step in &self.steps {
            self.root_from_link[step.link] = match (step.known, step.link.checked_sub(1)) {
                (Some(known), _) => known[frame],
                (None, Some(joint)) => self.robot.joints[joint].child_pose(&self.root_from_link, positions),
                (None, None) => Isometry3::identity(),
            };
        }
        &self.root_from_link
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A trunk of two joints and two fingers of two joints each.
    fn hand() -> Robot {
        let mut urdf = String::from("<robot name=\"hand\"><link name=\"root\"/>");
        let parents = ["root", "l0", "l1", "l2", "l1", "l4"];
        for (joint, parent) in parents.into_iter().enumerate() {
            urdf += &format!(
                "<link name=\"l{joint}\"/><joint name=\"j{joint}\" type=\"continuous\"><parent link=\"{parent}\"/>\
                 <child link=\"l{joint}\"/><origin xyz=\"0.1 0.02 {joint}\" rpy=\"0.3 0 {joint}\"/><axis xyz=\"0 1 0\"/></joint>"
            );
        }
        Robot::from_urdf("hand.urdf", &(urdf + "</robot>"), &[]).expect("valid")
    }

    proptest! {
        #[test]
        fn what_is_known_has_the_bits_of_what_is_computed(
            positions in prop::collection::vec(-2.0..2.0_f64, 3 * 6),
            changes in prop::collection::vec((0_usize..18, -1.0..1.0_f64), 0..3),
            kept in 0_usize..7,
            asked in prop::collection::vec(0_usize..7, 1..3),
        ) {
            let robot = hand();
            let poses = LinkPoses::new(&robot, [kept], &positions);
            let mut path = positions.clone();
            changes.iter().for_each(|&(idx, position)| path[idx] = position);
            let known = KnownPoses::new(&robot, &poses, &positions, &path);
            let mut tracker = LinkTracker::new(&robot, asked.iter().copied(), Some(&known));
            let mut all = Vec::new();
            for (frame, positions) in path.chunks_exact(6).enumerate() {
                robot.forward_kinematics(positions, &mut all);
                let some = tracker.at(frame, positions);
                for &link in &asked {
                    prop_assert_eq!(some[link], all[link], "link {} of frame {}", link, frame);
                }
            }
        }
    }
}

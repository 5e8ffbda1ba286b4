//! The grasp world's file: what the robot's own file leaves open.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use palpate_robot_model::Robot;
use palpate_sim::body::RestPose;
use serde::Deserialize;

use crate::GraspError;

/// The grasp world of one robot, as read from TOML. Units are in the names; frames are that of the robot's base.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct GraspConfig {
    /// Name of the link from which on links touch things. Those before it touch nothing and carry their own weight, as
    /// an arm does whose controller compensates gravity.
    pub hand_root: String,
    /// Names of links that also touch each other, neighbours on a joint excepted.
    pub mutual_contacts: Vec<String>,
    /// Rate of targets and observations, Hz; its period is a whole number of physics steps.
    pub control_rate_hz: f64,
    /// Numerics.
    pub physics: PhysicsConfig,
    /// Friction of everything.
    pub friction: FrictionConfig,
    /// What objects lie on.
    pub table: TableConfig,
    /// Every degree of freedom is in exactly one entry.
    #[serde(rename = "servo")]
    pub servos: Vec<ServoConfig>,
    /// Position of every degree of freedom at the start of a trial, rad or m, by joint name.
    pub start: BTreeMap<String, f64>,
    /// What a trial is.
    pub task: TaskConfig,
    /// What differs from episode to episode.
    pub randomisation: RandomisationConfig,
}

/// Numerics of MuJoCo: implicit integration, elliptic friction cones, Newton's solver.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct PhysicsConfig {
    /// Physics step, s. Beyond 5 ms grips fail.
    pub timestep_s: f64,
    /// Stiffness of friction over that of normal contact: higher slips less, and costs iterations.
    pub impratio: f64,
    /// Most iterations of the solver a step.
    pub iterations: u32,
    /// Most iterations of its line search.
    pub line_search_iterations: u32,
    /// How fast a penetration is pushed out, s; not below two physics steps.
    pub contact_time_constant_s: f64,
    /// 1 is critical.
    pub contact_damping_ratio: f64,
}

/// Coulomb friction. The larger value of the two that touch counts.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct FrictionConfig {
    /// Sliding friction of the table.
    pub table: f64,
    /// Sliding friction of objects.
    pub object: f64,
    /// Sliding friction of links not named in `links`.
    pub robot: f64,
    /// Torsional friction, m.
    pub torsional_m: f64,
    /// Rolling friction, m.
    pub rolling_m: f64,
    /// Links with a skin of their own.
    #[serde(rename = "link", default)]
    pub links: Vec<LinkFriction>,
}

/// Friction of some links; what is randomised as fingertip friction.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct LinkFriction {
    /// Their names.
    pub links: Vec<String>,
    /// Sliding friction.
    pub sliding: f64,
}

/// A box to lie on.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct TableConfig {
    /// Full edge lengths, m.
    pub size_m: [f64; 3],
    /// Middle of its top, m.
    pub center_m: [f64; 2],
    /// Height of its top, m.
    pub top_m: f64,
}

/// Position servos of some joints (per m instead of per rad for sliding ones).
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct ServoConfig {
    /// Names of the joints.
    pub joints: Vec<String>,
    /// Torque per distance from the target.
    pub stiffness_n_m_per_rad: f64,
    /// Torque against velocity, of the servo.
    pub damping_gain_n_m_s_per_rad: f64,
    /// Largest torque.
    pub max_torque_n_m: f64,
    /// Torque against velocity, of the joint.
    pub joint_damping_n_m_s_per_rad: f64,
    /// Inertia of the rotor as the joint feels it.
    pub armature_kg_m2: f64,
    /// Coulomb friction of joint and gear.
    pub friction_loss_n_m: f64,
}

/// What a trial is.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct TaskConfig {
    /// Middle of the region that objects start in.
    pub center_m: [f64; 2],
    /// Half its edge length, m.
    pub half_width_m: f64,
    /// Largest deviation of a hand joint's start position, rad.
    pub start_noise_rad: f64,
    /// For how long the object may roll or tip before an episode begins, s; it begins as soon as the object rests. An
    /// offset centre of mass turns round objects, and they would roll away before the hand is there.
    pub settle_s: f64,
    /// Longest episode, the final holding included, s.
    pub episode_s: f64,
    /// How far above its start height the object counts as lifted, m.
    pub lift_m: f64,
    /// For how long it must stay there, s.
    pub hold_s: f64,
    /// Force between robot and table at which the safety layer would stop the arm, N.
    pub max_table_force_n: f64,
    /// Whether an episode ends when the policy says that it holds the object instead of when it does. Then the object has to
    /// have been up for `hold_s` at that moment, or at the end of the time where the policy says nothing. World files leave
    /// it out; a [`crate::Protocol`] sets it.
    #[serde(default)]
    pub one_claim: bool,
}

/// Ranges of uniform draws at the start of an episode.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct RandomisationConfig {
    /// Sliding friction of the links that `friction.link` names.
    pub fingertip_friction: [f64; 2],
    /// On the object's mass and inertia.
    pub object_mass_factor: [f64; 2],
    /// Largest offset of the object's centre of mass along each axis, m.
    pub object_com_offset_m: f64,
    /// On the hand's Coulomb friction.
    pub friction_loss_factor: [f64; 2],
    /// On the hand's stiffness.
    pub stiffness_factor: [f64; 2],
    /// On the hand's joint damping.
    pub joint_damping_factor: [f64; 2],
    /// On masses and inertias of the hand's links.
    pub link_mass_factor: [f64; 2],
}

impl GraspConfig {
    /// Reads a grasp world for `robot`. `file` names it in errors.
    ///
    /// Refused, naming the key, joint or link: unknown keys, links and joints that the robot does not have, joints
    /// without a servo or with two, start positions that are missing or beyond the joint's limits, numbers out of range,
    /// a control period that is no whole number of physics steps.
    pub fn from_toml(file: &str, text: &str, robot: &Robot) -> Result<Self, GraspError> {
        let error = |problem: String| GraspError::Config { file: file.to_owned(), problem };
        let config: Self = toml::from_str(text).map_err(|err| error(err.to_string()))?;
        config.check(robot).map_err(error)?;
        Ok(config)
    }

    /// Physics steps in a control step.
    pub fn num_substeps(&self) -> usize {
        (1.0 / (self.control_rate_hz * self.physics.timestep_s)).round() as usize
    }

    /// Where an object with these `rest_poses` lies on the table: on the stable side that `side` (0 to 1, by how likely the
    /// sides are) falls on, `offset_m` from the middle of the region and turned by `yaw_rad`.
    pub fn on_table(
        &self,
        rest_poses: &[RestPose],
        side: f64,
        offset_m: [f64; 2],
        yaw_rad: f64,
    ) -> Isometry3<f64> {
        let center_m = self.task.center_m;
        let at_m = [center_m[0] + offset_m[0], center_m[1] + offset_m[1]];
        let up = Translation3::new(0.0, 0.0, self.table.top_m);
        // Every solid has a stable pose: the lowest that its centre of mass can be.
        let rest = RestPose::pick(rest_poses, side).map(|pose| pose.at(at_m, yaw_rad));
        up * rest.unwrap_or_else(|| {
            let upright = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
            Isometry3::from_parts(Translation3::new(at_m[0], at_m[1], 0.0), upright)
        })
    }

    /// Start positions in the robot's order.
    pub fn start_positions(&self, robot: &Robot) -> Vec<f64> {
        robot.dofs().map(|joint| self.start[&joint.name]).collect()
    }

    /// The servo of each degree of freedom, in the robot's order.
    pub fn servos_by_dof<'a>(&'a self, robot: &'a Robot) -> impl Iterator<Item = &'a ServoConfig> {
        robot.dofs().flat_map(|joint| self.servos.iter().find(|servo| servo.joints.contains(&joint.name)))
    }

    fn check(&self, robot: &Robot) -> Result<(), String> {
        let link = |key: &str, name: &String| match robot.link_index(name) {
            Some(_) => Ok(()),
            None => {
                let known: Vec<&str> = robot.links.iter().map(|link| link.name.as_str()).collect();
                Err(format!("{key} names link {name:?}, expected one of {}", known.join(", ")))
            }
        };
        link("hand_root", &self.hand_root)?;
        self.mutual_contacts.iter().try_for_each(|name| link("mutual_contacts", name))?;
        self.friction
            .links
            .iter()
            .flat_map(|entry| &entry.links)
            .try_for_each(|name| link("friction.link", name))?;
        self.check_numbers()?;
        let substeps = 1.0 / (self.control_rate_hz * self.physics.timestep_s);
        if substeps < 0.5 || (substeps - substeps.round()).abs() > 1e-6 {
            return Err(format!(
                "a control period at {} Hz is {substeps} physics steps of {} s, expected a whole number",
                self.control_rate_hz, self.physics.timestep_s
            ));
        }
        self.check_joints(robot)
    }

    fn check_numbers(&self) -> Result<(), String> {
        let (physics, friction, task) = (&self.physics, &self.friction, &self.task);
        let mut positive = vec![
            ("control_rate_hz", self.control_rate_hz),
            ("physics.timestep_s", physics.timestep_s),
            ("physics.impratio", physics.impratio),
            ("physics.iterations", f64::from(physics.iterations)),
            ("physics.line_search_iterations", f64::from(physics.line_search_iterations)),
            ("physics.contact_time_constant_s", physics.contact_time_constant_s),
            ("physics.contact_damping_ratio", physics.contact_damping_ratio),
            ("friction.table", friction.table),
            ("friction.object", friction.object),
            ("friction.robot", friction.robot),
            ("friction.torsional_m", friction.torsional_m),
            ("friction.rolling_m", friction.rolling_m),
            ("task.episode_s", task.episode_s),
            ("task.lift_m", task.lift_m),
            ("task.hold_s", task.hold_s),
            ("task.max_table_force_n", task.max_table_force_n),
        ];
        positive.extend(self.table.size_m.map(|edge_m| ("an edge of table.size_m", edge_m)));
        positive.extend(friction.links.iter().map(|entry| ("friction.link.sliding", entry.sliding)));
        positive.extend(
            self.servos.iter().map(|servo| ("servo.stiffness_n_m_per_rad", servo.stiffness_n_m_per_rad)),
        );
        positive.extend(self.servos.iter().map(|servo| ("servo.max_torque_n_m", servo.max_torque_n_m)));
        let ranges = [
            ("fingertip_friction", self.randomisation.fingertip_friction),
            ("object_mass_factor", self.randomisation.object_mass_factor),
            ("friction_loss_factor", self.randomisation.friction_loss_factor),
            ("stiffness_factor", self.randomisation.stiffness_factor),
            ("joint_damping_factor", self.randomisation.joint_damping_factor),
            ("link_mass_factor", self.randomisation.link_mass_factor),
        ];
        for (name, [low, high]) in ranges {
            if !(low > 0.0 && low <= high && high.is_finite()) {
                return Err(format!(
                    "randomisation.{name} is [{low}, {high}], expected a range of positive numbers"
                ));
            }
        }
        let mut not_negative = vec![
            ("task.half_width_m", task.half_width_m),
            ("task.start_noise_rad", task.start_noise_rad),
            ("task.settle_s", task.settle_s),
            ("randomisation.object_com_offset_m", self.randomisation.object_com_offset_m),
        ];
        for servo in &self.servos {
            not_negative.extend([
                ("servo.damping_gain_n_m_s_per_rad", servo.damping_gain_n_m_s_per_rad),
                ("servo.joint_damping_n_m_s_per_rad", servo.joint_damping_n_m_s_per_rad),
                ("servo.armature_kg_m2", servo.armature_kg_m2),
                ("servo.friction_loss_n_m", servo.friction_loss_n_m),
            ]);
        }
        if let Some((name, value)) = positive.iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)) {
            return Err(format!("{name} is {value}, expected a finite number above zero"));
        }
        if let Some((name, value)) =
            not_negative.iter().find(|(_, value)| !(value.is_finite() && *value >= 0.0))
        {
            return Err(format!("{name} is {value}, expected a finite number, not negative"));
        }
        let anywhere = [
            self.table.center_m[0],
            self.table.center_m[1],
            self.table.top_m,
            task.center_m[0],
            task.center_m[1],
        ];
        if anywhere.iter().any(|value| !value.is_finite()) {
            return Err("table.center_m, table.top_m and task.center_m must be finite".to_owned());
        }
        Ok(())
    }

    fn check_joints(&self, robot: &Robot) -> Result<(), String> {
        let known: Vec<&str> = robot.dofs().map(|joint| joint.name.as_str()).collect();
        let mut named = self.servos.iter().flat_map(|servo| &servo.joints).chain(self.start.keys());
        if let Some(name) = named.find(|name| !known.contains(&name.as_str())) {
            return Err(format!(
                "joint {name:?} is none of the robot's, expected one of {}",
                known.join(", ")
            ));
        }
        if let Some((joint, mimic)) = robot.dofs().find_map(|joint| Some((joint, joint.mimic?))) {
            return Err(format!(
                "joint {:?} follows joint {:?} (mimic in the robot's file), and the grasp world moves every joint by a servo of its \
                 own; remove the mimic there if it has one",
                joint.name, robot.joints[mimic.joint].name
            ));
        }
        for joint in robot.dofs() {
            let servos = self
                .servos
                .iter()
                .flat_map(|servo| &servo.joints)
                .filter(|name| **name == joint.name)
                .count();
            if servos != 1 {
                return Err(format!("joint {:?} is in {servos} [[servo]] entries, expected one", joint.name));
            }
            let Some(&start) = self.start.get(&joint.name) else {
                return Err(format!("start has no position for joint {:?}", joint.name));
            };
            let within = joint.limits.is_none_or(|limits| (limits.lower..=limits.upper).contains(&start));
            if !(start.is_finite() && within) {
                return Err(format!(
                    "start.{} is {start}, expected a position within the joint's limits",
                    joint.name
                ));
            }
        }
        Ok(())
    }
}

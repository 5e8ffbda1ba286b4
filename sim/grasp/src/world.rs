//! The physics: a scene in MuJoCo, in the robot's joint order and the base frame.

use std::collections::BTreeMap;
use std::sync::Arc;

use mujoco_rs::prelude::{MjData, MjModel, MjtObjBase};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use palpate_robot_model::Robot;

use crate::scene::{OBJECT, TABLE, digits};
use crate::{GraspConfig, GraspError};

/// One scene in motion.
///
/// Its state is that of MuJoCo; a step depends on nothing else, so that worlds on different threads do not meet.
#[derive(Debug)]
pub struct World {
    data: MjData<Arc<MjModel>>,
    /// Names for errors, by degree of freedom.
    joint_names: Vec<String>,
    /// Where each degree of freedom is in MuJoCo's positions.
    dof_qpos: Vec<usize>,
    /// And in its velocities.
    dof_qvel: Vec<usize>,
    object_qpos: usize,
    object_qvel: usize,
    object_body: usize,
    /// What each geom belongs to.
    owners: Vec<Owner>,
    num_substeps: usize,
    timestep_s: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Owner {
    /// With the bit of its digit in [`Contacts::digits`].
    Robot {
        digit: u64,
    },
    Object,
    Table,
}

/// Who touches whom after a step, normal forces in N.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Contacts {
    /// Between robot and object.
    pub robot_object_n: f64,
    /// Between robot and table.
    pub robot_table_n: f64,
    /// Between object and table.
    pub object_table_n: f64,
    /// Bit i is set when digit i (see [`crate::scene::digits`]) touches the object.
    pub digits: u64,
    /// Deepest penetration of any two, m; zero or positive.
    pub deepest_m: f64,
}

impl World {
    /// Loads `mjcf`, the text of [`crate::scene::mjcf`] for the same robot.
    pub fn new(mjcf: &str, robot: &Robot, config: &GraspConfig) -> Result<Self, GraspError> {
        let model = MjModel::from_xml_string(mjcf).map_err(|err| GraspError::Physics(err.to_string()))?;
        let data = MjData::try_new(Arc::new(model)).map_err(|err| GraspError::Physics(err.to_string()))?;
        let model = data.model();
        let joint_id = |name: &str| {
            model
                .name_to_id(MjtObjBase::mjOBJ_JOINT, name)
                .ok_or_else(|| GraspError::Physics(format!("the scene has no joint {name:?}")))
        };
        let ids = robot.dofs().map(|joint| joint_id(&joint.name)).collect::<Result<Vec<_>, _>>()?;
        let object = joint_id(OBJECT)?;
        let object_body = model
            .name_to_id(MjtObjBase::mjOBJ_BODY, OBJECT)
            .ok_or_else(|| GraspError::Physics("the scene has no object".to_owned()))?;
        let table = model.name_to_id(MjtObjBase::mjOBJ_GEOM, TABLE);
        let digit_of_body: BTreeMap<usize, u64> = robot
            .links
            .iter()
            .zip(digits(robot, config))
            .filter_map(|(link, digit)| {
                let body = model.name_to_id(MjtObjBase::mjOBJ_BODY, &link.name)?;
                Some((body, digit.map_or(0, |digit| 1_u64.checked_shl(digit as u32).unwrap_or(0))))
            })
            .collect();
        let owner = |(geom, body): (usize, &i32)| {
            if Some(geom) == table {
                Owner::Table
            } else if object_body == *body as usize {
                Owner::Object
            } else {
                Owner::Robot { digit: digit_of_body.get(&(*body as usize)).copied().unwrap_or(0) }
            }
        };
        Ok(Self {
            joint_names: robot.dofs().map(|joint| joint.name.clone()).collect(),
            dof_qpos: ids.iter().map(|&id| model.jnt_qposadr()[id] as usize).collect(),
            dof_qvel: ids.iter().map(|&id| model.jnt_dofadr()[id] as usize).collect(),
            object_qpos: model.jnt_qposadr()[object] as usize,
            object_qvel: model.jnt_dofadr()[object] as usize,
            object_body,
            owners: model.geom_bodyid().iter().enumerate().map(owner).collect(),
            num_substeps: config.num_substeps(),
            timestep_s: config.physics.timestep_s,
            data,
        })
    }

    /// Everything at rest, the robot at `positions` (one per degree of freedom) with its targets there, the object at
    /// `base_from_object`.
    pub fn reset(&mut self, positions: &[f64], base_from_object: &Isometry3<f64>) {
        self.data.reset();
        let t = base_from_object.translation.vector;
        let q = base_from_object.rotation;
        let qpos = self.data.qpos_mut();
        for (&at, &position) in self.dof_qpos.iter().zip(positions) {
            qpos[at] = position;
        }
        qpos[self.object_qpos..self.object_qpos + 7].copy_from_slice(&[t.x, t.y, t.z, q.w, q.i, q.j, q.k]);
        self.set_targets(positions);
        self.data.forward();
    }

    /// Lets the object come to rest, for at most `longest_s`, and then begins as [`Self::reset`] does with the robot at
    /// `positions` and the object as it rests, moved back to the place above which it started.
    ///
    /// The object moves as in syrup, so that a ball turns its heavy side down instead of rolling there and back.
    pub fn settle(&mut self, positions: &[f64], longest_s: f64) -> Result<(), GraspError> {
        const SYRUP_PER_S: f64 = 10.0;
        const AT_LEAST_S: f64 = 0.1;
        const REST_M_PER_S: f64 = 1e-3;
        const REST_RAD_PER_S: f64 = 1e-2;
        let start = self.base_from_object().translation;
        let keep = (-SYRUP_PER_S * self.timestep_s).exp();
        while self.data.time() < longest_s {
            self.data.step();
            let (linear, angular) = self.object_velocity();
            self.set_object_velocity(&(linear * keep), &(angular * keep));
            let rests = linear.norm() < REST_M_PER_S && angular.norm() < REST_RAD_PER_S;
            if rests && self.data.time() > AT_LEAST_S {
                break;
            }
        }
        self.check_finite()?;
        let mut rest = self.base_from_object();
        rest.translation.x = start.x;
        rest.translation.y = start.y;
        self.reset(positions, &rest);
        Ok(())
    }

    /// Where the servos go from now on, one per degree of freedom; beyond a joint's limits they stop there.
    pub fn set_targets(&mut self, targets: &[f64]) {
        self.data.ctrl_mut().copy_from_slice(targets);
    }

    /// One physics step.
    pub fn step_physics(&mut self) {
        self.data.step();
    }

    /// One control step; says what diverged if something did.
    pub fn step(&mut self) -> Result<(), GraspError> {
        for _ in 0..self.num_substeps {
            self.data.step();
        }
        self.check_finite()
    }

    fn check_finite(&self) -> Result<(), GraspError> {
        let qpos = self.data.qpos();
        if qpos.iter().all(|value| value.is_finite()) {
            return Ok(());
        }
        let joint = self.dof_qpos.iter().position(|&at| !qpos[at].is_finite());
        let what =
            joint.map_or_else(|| "the object".to_owned(), |dof| format!("joint {:?}", self.joint_names[dof]));
        Err(GraspError::Diverged { time_s: self.time_s(), what })
    }

    /// Time since the reset, s.
    pub fn time_s(&self) -> f64 {
        self.data.time()
    }

    /// Position of every degree of freedom, rad or m, into `positions`.
    pub fn positions_into(&self, positions: &mut [f64]) {
        let qpos = self.data.qpos();
        for (position, &at) in positions.iter_mut().zip(&self.dof_qpos) {
            *position = qpos[at];
        }
    }

    /// Velocity of every degree of freedom, rad/s or m/s, into `velocities`.
    pub fn velocities_into(&self, velocities: &mut [f64]) {
        let qvel = self.data.qvel();
        for (velocity, &at) in velocities.iter_mut().zip(&self.dof_qvel) {
            *velocity = qvel[at];
        }
    }

    /// Pose of the object.
    pub fn base_from_object(&self) -> Isometry3<f64> {
        let p = &self.data.qpos()[self.object_qpos..];
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(p[3], p[4], p[5], p[6]));
        Isometry3::from_parts(Translation3::new(p[0], p[1], p[2]), rotation)
    }

    /// Linear (base axes, m/s) and angular (object axes, rad/s) velocity of the object.
    pub fn object_velocity(&self) -> (Vector3<f64>, Vector3<f64>) {
        let v = &self.data.qvel()[self.object_qvel..];
        (Vector3::new(v[0], v[1], v[2]), Vector3::new(v[3], v[4], v[5]))
    }

    /// Puts the robot's joints elsewhere, in motion, and leaves everything else as it is: rad or m, and per s.
    pub fn set_joints(&mut self, positions: &[f64], velocities: &[f64]) {
        let (dof_qpos, dof_qvel) = (&self.dof_qpos, &self.dof_qvel);
        let qpos = self.data.qpos_mut();
        dof_qpos.iter().zip(positions).for_each(|(&at, &position)| qpos[at] = position);
        let qvel = self.data.qvel_mut();
        dof_qvel.iter().zip(velocities).for_each(|(&at, &velocity)| qvel[at] = velocity);
    }

    /// Sets both, as [`Self::object_velocity`] gives them.
    pub fn set_object_velocity(&mut self, linear: &Vector3<f64>, angular: &Vector3<f64>) {
        let v = &mut self.data.qvel_mut()[self.object_qvel..];
        v[..3].copy_from_slice(linear.as_slice());
        v[3..6].copy_from_slice(angular.as_slice());
    }

    /// A force on the object's centre of mass, along the axes of the base, N; it stays until it is set again.
    pub fn set_push(&mut self, force_n: &Vector3<f64>) {
        self.data.xfrc_applied_mut()[self.object_body][..3].copy_from_slice(force_n.as_slice());
    }

    /// Potential and kinetic energy of everything, J.
    pub fn energy_j(&mut self) -> [f64; 2] {
        self.data.energy_pos();
        self.data.energy_vel();
        *self.data.energy()
    }

    /// Contacts of the last step.
    pub fn contacts(&self) -> Contacts {
        let mut contacts = Contacts::default();
        for (idx, contact) in self.data.contact().iter().enumerate() {
            let normal_n = self.data.contact_force(idx)[0];
            contacts.deepest_m = contacts.deepest_m.max(-contact.dist);
            match contact.geom.map(|geom| self.owners[geom as usize]) {
                [Owner::Robot { digit }, Owner::Object] | [Owner::Object, Owner::Robot { digit }] => {
                    contacts.robot_object_n += normal_n;
                    contacts.digits |= if normal_n > 0.0 { digit } else { 0 };
                }
                [Owner::Robot { .. }, Owner::Table] | [Owner::Table, Owner::Robot { .. }] => {
                    contacts.robot_table_n += normal_n;
                }
                [Owner::Object, Owner::Table] | [Owner::Table, Owner::Object] => {
                    contacts.object_table_n += normal_n;
                }
                _ => (),
            }
        }
        contacts
    }
}

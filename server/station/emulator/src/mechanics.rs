//! Bodies in motion behind the devices, where something else than the devices simulates them.

use nalgebra::Isometry3;
use palpate_robot_model::{ObjectModel, ObjectShape};

use palpate_truth::{EmulationError, Placed, TruthSense};

/// What a device does to one degree of freedom for a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Drive {
    /// A servo pushes; the joint goes where this and everything else takes it.
    Torque {
        /// Torque of the motor and of a hand that pushes, friction not taken off, N m.
        torque_nm: f64,
        /// The gear is jammed: the joint stays.
        is_jammed: bool,
    },
    /// The arm's box has the joint on its way.
    Motion {
        /// Where it is to be at the end of the step, rad or m.
        position: f64,
        /// With which velocity, rad/s or m/s.
        velocity: f64,
    },
}

/// An object as the truth's skin feels it, wherever it is.
#[derive(Clone, Debug)]
pub struct FeltObject {
    pub(crate) id: String,
    pub(crate) placed: Placed,
}

impl FeltObject {
    /// `object` in the world of `sense`.
    ///
    /// # Errors
    /// Shapes without an inside.
    pub fn new(sense: &TruthSense, object: &ObjectModel) -> Result<Self, EmulationError> {
        Ok(Self { id: object.id.clone(), placed: sense.placed(object)? })
    }

    /// Id of the object.
    pub fn id(&self) -> &str {
        &self.id
    }
}

/// Robot, table and object as bodies that push each other: what servos and arm move, and what the skin feels.
///
/// [`super::EmulatedStation`] has its own kinematic world unless it is given one of these. It computes no touch: the truth's
/// soft layers do, from the positions and the object's pose that come out here.
pub trait Mechanics: Send {
    /// Lets one ms pass. `drives`, `positions` (rad or m) and `velocities` have one entry for each degree of freedom, in
    /// the station's order; the last two are to be filled in.
    fn step(&mut self, drives: &[Drive], positions: &mut [f64], velocities: &mut [f64]);

    /// The object that lies there and base_from_object, once there is one.
    fn object(&self) -> Option<(&FeltObject, Isometry3<f64>)>;

    /// Whether the arm has just run into something, harder than its box lets pass.
    fn arm_has_hit(&self) -> bool;
}

/// What a station with [`Mechanics`] begins with.
pub struct Bodies {
    /// What moves.
    pub mechanics: Box<dyn Mechanics>,
    /// Where the joints are, rad or m, in the station's order.
    pub positions: Vec<f64>,
    /// What stands still and is felt: base_from_body and its shape.
    pub fixed: Vec<(Isometry3<f64>, ObjectShape)>,
}

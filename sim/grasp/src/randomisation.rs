//! What differs from episode to episode.

use nalgebra::Vector3;
use rand::{Rng, RngExt};

use crate::config::RandomisationConfig;

/// One draw of a [`RandomisationConfig`].
#[derive(Clone, Debug, PartialEq)]
pub struct Randomisation {
    /// Sliding friction of the links that `friction.link` names; `None` leaves each its own.
    pub fingertip_friction: Option<f64>,
    /// On the object's mass and inertia.
    pub object_mass_factor: f64,
    /// Offset of the object's centre of mass in its own frame, m.
    pub object_com_offset_m: Vector3<f64>,
    /// On the hand's Coulomb friction.
    pub friction_loss_factor: f64,
    /// On the hand's stiffness.
    pub stiffness_factor: f64,
    /// On the hand's joint damping.
    pub joint_damping_factor: f64,
    /// On masses and inertias of the hand's links.
    pub link_mass_factor: f64,
}

impl Randomisation {
    /// The nominal world.
    pub fn none() -> Self {
        Self {
            fingertip_friction: None,
            object_mass_factor: 1.0,
            object_com_offset_m: Vector3::zeros(),
            friction_loss_factor: 1.0,
            stiffness_factor: 1.0,
            joint_damping_factor: 1.0,
            link_mass_factor: 1.0,
        }
    }

    /// Uniform draws from the ranges of `config`.
    pub fn draw(config: &RandomisationConfig, rng: &mut impl Rng) -> Self {
        let mut within = |[low, high]: [f64; 2]| low + (high - low) * rng.random::<f64>();
        let reach_m = config.object_com_offset_m;
        Self {
            fingertip_friction: Some(within(config.fingertip_friction)),
            object_mass_factor: within(config.object_mass_factor),
            object_com_offset_m: Vector3::from_fn(|_, _| within([-reach_m, reach_m])),
            friction_loss_factor: within(config.friction_loss_factor),
            stiffness_factor: within(config.stiffness_factor),
            joint_damping_factor: within(config.joint_damping_factor),
            link_mass_factor: within(config.link_mass_factor),
        }
    }
}

//! A joint and the servo that drives it: goal position in, joint position out.
//!
//! [`Plant`] is everything that the model knows of one actuator; [`rollout()`] drives it. An effect of [`ACTUATOR`] is a
//! change of the plant, one module each, as data in [`Effect`]: like the tactile ones they compose.

mod armature_inertia;
mod command_latency;
mod constant_torque;
mod coulomb_friction;
mod current_limit;
mod derivative_gain;
mod encoder_offset;
mod gain_error;
mod gear_backlash;
mod gravity_load;
mod integer_wrap;
mod load_dependent_friction;
mod rollout;
mod stribeck_friction;
mod unstated_load;
mod viscous_friction;
mod voltage_sag;

pub use rollout::{Drive, Sensed, Start, rollout};

use crate::effects::{Effect, Parameter};

/// Every effect of the actuator, in the order from command to encoder.
pub const ACTUATOR: &[&dyn ActuatorEffect] = &[
    &command_latency::CommandLatency,
    &gain_error::GainError,
    &derivative_gain::DerivativeGain,
    &integer_wrap::IntegerWrap,
    &voltage_sag::VoltageSag,
    &current_limit::CurrentLimit,
    &armature_inertia::ArmatureInertia,
    &viscous_friction::ViscousFriction,
    &coulomb_friction::CoulombFriction,
    &stribeck_friction::StribeckFriction,
    &load_dependent_friction::LoadDependentFriction,
    &gear_backlash::GearBacklash,
    &gravity_load::GravityLoad,
    &unstated_load::UnstatedLoad,
    &constant_torque::ConstantTorque,
    &encoder_offset::EncoderOffset,
];

/// The effect called `id`.
pub fn actuator(id: &str) -> Option<&'static dyn ActuatorEffect> {
    ACTUATOR.iter().copied().find(|kind| kind.id() == id)
}

/// What an effect of the actuator is and does.
pub trait ActuatorEffect: Sync {
    /// Stable id, as in files and reports.
    fn id(&self) -> &'static str;

    /// What it is, in one sentence for an operator that says the size.
    fn explain(&self, effect: &Effect) -> String;

    /// What sets it apart from its rivals.
    fn signature(&self) -> &'static str;

    /// Its parameters.
    fn parameters(&self) -> Vec<Parameter>;

    /// Whether it is one constant torque, mass or angle, so that the right one leaves nothing behind. Others are models of
    /// what gears and electronics do, and leave something where those are of another make.
    fn is_constant(&self) -> bool {
        false
    }

    /// Whether it is a dry or viscous friction.
    fn is_friction(&self) -> bool {
        false
    }

    /// Whether its size shows best in readings, and is not to be told by where the joint goes.
    fn is_read(&self) -> bool {
        false
    }

    /// Whether it could be, on a joint of which it is stated what it carries, or of which it is not.
    fn could_be(&self, _load_is_stated: bool) -> bool {
        true
    }

    /// Adds it to `plant`.
    fn apply(&self, effect: &Effect, plant: &mut Plant);
}

/// A motor with its gear, firmware and supply.
///
/// What moves: I q'' = tau_m - m g l sin q - friction, with I = m l^2 + armature and tau_m = kt i.
#[derive(Clone, Debug, PartialEq)]
pub struct Plant {
    /// Torque per current at the joint, N m / A; in SI also the back-EMF in V s / rad.
    pub torque_constant_nm_per_a: f64,
    /// Resistance of the winding and its driver, ohm.
    pub resistance_ohm: f64,
    /// Supply voltage at rest over the one that the log states.
    pub supply_factor: f64,
    /// Inertia of rotor and gear seen at the joint, kg m^2.
    pub armature_kg_m2: f64,
    /// Friction per speed, N m s / rad.
    pub viscous_nm_s_per_rad: f64,
    /// Friction that depends on the direction alone, N m.
    pub coulomb_nm: f64,
    /// Friction at rest beyond that of motion, N m.
    pub stribeck_nm: f64,
    /// Speed at which that excess has fallen to 1/e, rad/s.
    pub stribeck_speed_rad_per_s: f64,
    /// Friction per torque that the gear transmits.
    pub load_friction: f64,
    /// Time from a goal being sent to its taking effect, s.
    pub latency_s: f64,
    /// Angle by which the output moves freely against the rotor, rad.
    pub play_rad: f64,
    /// Internal resistance of the supply, ohm.
    pub supply_resistance_ohm: f64,
    /// What the encoder shows while the pendulum hangs, rad.
    pub encoder_offset_rad: f64,
    /// Torque of gravity over that of the stated mass and length.
    pub gravity_factor: f64,
    /// Position gain over the one that the register states.
    pub gain_factor: f64,
    /// Derivative gain of the firmware over its position gain, s.
    pub derivative_s: f64,
    /// One over the most current that the driver gives, 1/A; 0 for a driver that gives any.
    pub inverse_current_limit_per_a: f64,
    /// Torque on the joint that is always there, N m.
    pub constant_torque_nm: f64,
    /// Torque of gravity on a load that is not stated, at 90 degrees and at 0, N m.
    pub unstated_nm: [f64; 2],
    /// Its inertia, kg m^2.
    pub unstated_kg_m2: f64,
    /// 1 if negative PWM readings are stored unsigned, 0 if not.
    pub wrap: f64,
}

impl Default for Plant {
    /// A small geared servo (Dynamixel XL330-M288): torque constant and resistance from the datasheet's stall torque,
    /// stall current and no-load speed at 5 V (0.52 N m, 1.47 A, 103 rev/min), with ideal everything else.
    fn default() -> Self {
        Self {
            torque_constant_nm_per_a: 0.4,
            resistance_ohm: 3.4,
            supply_factor: 1.0,
            armature_kg_m2: 5e-4,
            viscous_nm_s_per_rad: 0.0,
            coulomb_nm: 0.0,
            stribeck_nm: 0.0,
            stribeck_speed_rad_per_s: 0.3,
            load_friction: 0.0,
            latency_s: 0.0,
            play_rad: 0.0,
            supply_resistance_ohm: 0.0,
            encoder_offset_rad: 0.0,
            gravity_factor: 1.0,
            gain_factor: 1.0,
            derivative_s: 0.0,
            inverse_current_limit_per_a: 0.0,
            constant_torque_nm: 0.0,
            unstated_nm: [0.0; 2],
            unstated_kg_m2: 0.0,
            wrap: 0.0,
        }
    }
}

impl Plant {
    /// Adds `effects` to the plant.
    ///
    /// # Errors
    /// The id of the first effect that is not of this library.
    pub fn add(&mut self, effects: &[Effect]) -> Result<(), String> {
        for effect in effects {
            actuator(&effect.id).ok_or_else(|| effect.id.clone())?.apply(effect, self);
        }
        Ok(())
    }
}

/// A parameter whose absence is 0.
fn parameter(name: &str, [lower, upper]: [f64; 2], smallest: f64, dose: f64) -> Parameter {
    Parameter { name: name.to_owned(), lower, upper, neutral: 0.0, smallest, dose }
}

#[cfg(test)]
mod tests;

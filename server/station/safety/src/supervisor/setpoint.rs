//! What motors shall do for a moment.

use crate::profile::Motion;

/// What motors shall do until the next setpoint or until it runs out.
///
/// Only [`Supervisor::tick`](crate::Supervisor::tick) makes one, so that nothing moves past the safety layer.
#[derive(Clone, Debug, PartialEq)]
pub struct Setpoint {
    torque: bool,
    lead_through: bool,
    positions: Vec<f64>,
    velocities: Vec<f64>,
    valid_until_ns: u64,
}

impl Setpoint {
    pub(super) fn new(
        torque: bool,
        lead_through: bool,
        joints: impl ExactSizeIterator<Item = Motion> + Clone,
        valid_until_ns: u64,
    ) -> Self {
        Self {
            torque,
            lead_through,
            positions: joints.clone().map(|motion| motion.position).collect(),
            velocities: joints.map(|motion| motion.velocity).collect(),
            valid_until_ns,
        }
    }

    /// Whether motors shall hold or move their joints; without, they are limp and positions mean nothing.
    pub fn torque(&self) -> bool {
        self.torque
    }

    /// Whether the arm shall yield to the operator's hands.
    pub fn lead_through(&self) -> bool {
        self.lead_through
    }

    /// Positions in the station's order, rad or m; always finite.
    pub fn positions(&self) -> &[f64] {
        &self.positions
    }

    /// Speeds at which these positions are reached, in the station's order, per s.
    pub fn velocities(&self) -> &[f64] {
        &self.velocities
    }

    /// From this time on it must not be carried out any more, ns.
    pub fn valid_until_ns(&self) -> u64 {
        self.valid_until_ns
    }
}

//! What speaks against holding on, arming, moving and leading by hand.

use palpate_robot_model::JointKind;

use super::{ARMING_NS, Hold, Lead, State, Supervisor};
use crate::{Refusal, measured::JointTelemetry};

/// A joint that turns may be found this much outside its limits and still be armed, rad: encoders are not perfect.
pub const OUTSIDE_TOLERANCE_RAD: f64 = 0.05;
/// A joint that slides may be found this much outside its limits and still be armed, m.
pub const OUTSIDE_TOLERANCE_M: f64 = 0.002;

impl Supervisor {
    /// Why torque cannot be given now, with what to do.
    pub(super) fn not_ready(&self, now_ns: u64) -> Option<String> {
        if let Some(problem) = self.fault() {
            return Some(problem);
        }
        for (dof, telemetry) in self.telemetry.joints.iter().enumerate() {
            let name = self.joint_name(dof);
            if telemetry.senseless {
                return Some(format!(
                    "joint {name:?} reports positions that are no numbers; check its device"
                ));
            }
            let Some(reading) = telemetry.reading else {
                return Some(format!(
                    "nothing is known of joint {name:?}; switch its device on and plug it in"
                ));
            };
            if telemetry.fresh(now_ns, self.times.telemetry_ttl).is_none() {
                let age_s = now_ns.saturating_sub(reading.received_ns) as f64 * 1e-9;
                return Some(format!("joint {name:?} was last read {age_s:.2} s ago; check its device"));
            }
        }
        self.outside(|dof| self.telemetry.joints[dof].reading.map(|reading| reading.position))
    }

    /// A joint that is commanded to be further outside its limits than readings are in error.
    pub(super) fn outside_limits(&self) -> Option<String> {
        self.outside(|dof| Some(self.joints[dof].motion.position))
    }

    fn outside(&self, position: impl Fn(usize) -> Option<f64>) -> Option<String> {
        self.station.safety.joints.iter().enumerate().find_map(|(dof, limits)| {
            let position = position(dof)?;
            let (unit, tolerance) = self.unit(dof);
            let (side, limit) = if position > limits.upper + tolerance {
                ("above", limits.upper)
            } else if position < limits.lower - tolerance {
                ("below", limits.lower)
            } else {
                return None;
            };
            let name = self.joint_name(dof);
            Some(format!(
                "joint {name:?} is at {position:.4} {unit}, {side} its limit of {limit:.4} {unit}; move it back by hand"
            ))
        })
    }

    fn fault(&self) -> Option<String> {
        let fault = self.telemetry.faults.first()?;
        let joint = match fault.dof.filter(|dof| *dof < self.joints.len()) {
            Some(dof) => format!(", joint {:?}", self.joint_name(dof)),
            None => String::new(),
        };
        Some(format!("device {:?}{joint}: {}", fault.device, fault.problem))
    }

    /// Why torque has to go off.
    pub(super) fn must_disarm(&self) -> Option<String> {
        if let Some(problem) = self.fault() {
            return Some(problem);
        }
        let silent_ns = self.now_ns - self.heartbeat_ns;
        if silent_ns >= self.times.disarm_begins {
            let silent_s = silent_ns as f64 * 1e-9;
            return Some(format!("nothing was heard of the operator for {silent_s:.2} s; arm again"));
        }
        for (dof, (joint, telemetry)) in self.joints.iter().zip(&self.telemetry.joints).enumerate() {
            let name = self.joint_name(dof);
            if telemetry.senseless {
                return Some(format!(
                    "joint {name:?} reports positions that are no numbers; check its device"
                ));
            }
            let Some(reading) = telemetry.reading else {
                return Some(format!("the device of joint {name:?} is gone; plug it in again, then arm"));
            };
            let age_ns = self.now_ns.saturating_sub(reading.received_ns);
            if age_ns >= self.times.disarm_begins {
                let age_s = age_ns as f64 * 1e-9;
                return Some(format!(
                    "joint {name:?} was last read {age_s:.2} s ago; check its device, then arm"
                ));
            }
            let led = joint.carrier && self.lead != Lead::Off;
            let newer = reading.received_ns > joint.torque_asked_ns;
            if joint.holds && !led && newer && reading.torque_on == Some(false) {
                return Some(format!(
                    "the motor of joint {name:?} let go; see what its device says, then arm again"
                ));
            }
            if let State::Arming { since_ns } = self.state
                && !joint.holds
                && !self.shows_torque(dof)
                && self.now_ns - since_ns >= ARMING_NS
            {
                return Some(format!(
                    "the motor of joint {name:?} does not hold; see what its device says, then arm again"
                ));
            }
        }
        None
    }

    /// Why joints have to stand still, with torque.
    pub(super) fn must_hold(&self) -> Option<Hold> {
        if self.operator_gone || self.now_ns - self.heartbeat_ns >= self.times.heartbeat_ttl {
            return Some(Hold::Heartbeat);
        }
        let name = self.joint_name(self.unseen()?);
        Some(Hold::Telemetry(format!("nothing is read of joint {name:?}; check its device")))
    }

    /// The first joint of which nothing is read.
    fn unseen(&self) -> Option<usize> {
        let late = |joint: &JointTelemetry| joint.fresh(self.now_ns, self.times.telemetry_ttl).is_none();
        self.telemetry.joints.iter().position(late)
    }

    /// Whether all joints are read and no device has a fault.
    pub(super) fn sees_all(&self) -> bool {
        self.unseen().is_none() && self.telemetry.faults.is_empty()
    }

    pub(super) fn check_targets(&self, sequence: u64, targets: &[(usize, f64)]) -> Result<(), Refusal> {
        self.following()?;
        if matches!(self.state, State::LettingGo | State::Arming { .. }) {
            return Err(Refusal::NotArmed { phase: "still being armed", todo: "wait until the motors hold" });
        }
        if sequence <= self.sequence {
            return Err(Refusal::StaleSequence { sequence, newest: self.sequence });
        }
        for &(dof, value) in targets {
            let Some(limits) = self.station.safety.joints.get(dof) else {
                return Err(Refusal::UnknownJoint { dof, last: self.joints.len().saturating_sub(1) });
            };
            let joint = self.joint_name(dof).to_owned();
            let (unit, _) = self.unit(dof);
            if !value.is_finite() {
                return Err(Refusal::NotFinite { joint, value, unit });
            }
            if value > limits.upper {
                return Err(Refusal::BeyondLimit { joint, value, side: "above", limit: limits.upper, unit });
            }
            if value < limits.lower {
                return Err(Refusal::BeyondLimit { joint, value, side: "below", limit: limits.lower, unit });
            }
            if self.lead != Lead::Off && self.joints[dof].carrier {
                return Err(Refusal::LedByHand { joint });
            }
        }
        Ok(())
    }

    /// Whether requests for motion make sense now.
    pub(super) fn following(&self) -> Result<(), Refusal> {
        match &self.state {
            State::Stopped { who, .. } => return Err(Refusal::Stopped { who: who.clone() }),
            State::Disarmed => return Err(Refusal::NotArmed { phase: "disarmed", todo: "arm it first" }),
            State::Disarming { .. } => {
                return Err(Refusal::NotArmed {
                    phase: "just being disarmed",
                    todo: "wait a moment, then arm",
                });
            }
            State::LettingGo | State::Arming { .. } | State::Armed { .. } => {}
        }
        match &self.hold {
            Some(hold @ (Hold::Heartbeat | Hold::Telemetry(_))) => {
                Err(Refusal::Holding { reason: hold.reason().to_owned() })
            }
            _ => Ok(()),
        }
    }

    pub(super) fn may_lead(&self) -> Result<(), Refusal> {
        self.following()?;
        if matches!(self.state, State::LettingGo | State::Arming { .. }) {
            return Err(Refusal::NotArmed { phase: "still being armed", todo: "wait until the motors hold" });
        }
        let mut carriers = self.joints.iter().filter(|joint| joint.carrier).peekable();
        if carriers.peek().is_none() {
            return Err(Refusal::NoLeadThrough {
                problem: "the station has no arm that could be led by hand",
            });
        }
        if carriers.any(|joint| joint.motion.velocity != 0.0) {
            return Err(Refusal::NoLeadThrough { problem: "the arm is moving; wait until it stands still" });
        }
        Ok(())
    }

    pub(super) fn joint_name(&self, dof: usize) -> &str {
        self.station.robot.dofs().nth(dof).map_or("", |joint| joint.name.as_str())
    }

    /// Unit of positions, and how far outside its limits a joint may be found.
    fn unit(&self, dof: usize) -> (&'static str, f64) {
        match self.station.robot.dofs().nth(dof).map(|joint| joint.kind) {
            Some(JointKind::Prismatic) => ("m", OUTSIDE_TOLERANCE_M),
            _ => ("rad", OUTSIDE_TOLERANCE_RAD),
        }
    }
}

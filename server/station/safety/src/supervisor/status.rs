//! What the layer tells everybody.

use super::{Lead, State, Supervisor};
use crate::Lease;

/// What the layer is up to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// No torque.
    Disarmed,
    /// Torque comes up where the joints are.
    Arming,
    /// Follows targets.
    Armed,
    /// Armed, but stands still.
    Holding,
    /// Brakes, then torque goes off.
    Disarming,
    /// Latched without torque.
    Stopped,
}

/// What operators and onlookers are told.
#[derive(Clone, Debug, PartialEq)]
pub struct Status {
    /// What it is up to.
    pub phase: Phase,
    /// Why it holds, stopped or cannot be armed, with what to do; empty when all is well.
    pub reason: String,
    /// Who has the lease; empty for nobody.
    pub holder: String,
    /// The lease in force.
    pub lease: Option<Lease>,
    /// Until it ends without a heartbeat, s.
    pub lease_left_s: f64,
    /// Readings show every motor without torque or motion since the stop.
    pub stop_confirmed: bool,
    /// Whether the arm yields to the operator's hands.
    pub lead_through: bool,
    /// Commanded positions in the station's order; empty without torque.
    pub commanded: Vec<f64>,
}

impl Supervisor {
    pub(super) fn describe(&self, now_ns: u64) -> Status {
        let holder = self.desk.holder(now_ns);
        let phase = match &self.state {
            State::Disarmed => Phase::Disarmed,
            _ if self.wanted() && self.hold.is_some() => Phase::Holding,
            State::LettingGo | State::Arming { .. } => Phase::Arming,
            State::Armed { .. } => Phase::Armed,
            State::Disarming { .. } => Phase::Disarming,
            State::Stopped { .. } => Phase::Stopped,
        };
        let stop_confirmed = self.stop_confirmed(now_ns);
        let torque = self.energised();
        Status {
            phase,
            reason: self.reason(now_ns, stop_confirmed),
            holder: holder.map(|holder| holder.operator.clone()).unwrap_or_default(),
            lease: holder.map(|holder| holder.lease),
            lease_left_s: self.desk.left_ns(now_ns) as f64 * 1e-9,
            stop_confirmed,
            lead_through: self.lead != Lead::Off,
            commanded: self.joints.iter().filter(|_| torque).map(|joint| joint.motion.position).collect(),
        }
    }

    fn reason(&self, now_ns: u64, stop_confirmed: bool) -> String {
        match &self.state {
            State::Stopped { who, .. } if stop_confirmed => {
                format!("stopped by {who:?}; make sure that all is well, then reset the stop")
            }
            State::Stopped { who, .. } => {
                format!(
                    "stopped by {who:?}, but not every joint has shown yet that it is off or stands still"
                )
            }
            State::Disarming { .. } => self.disarmed_because.clone(),
            State::Disarmed => {
                let problem = self.not_ready(now_ns).map(|problem| format!("cannot be armed: {problem}"));
                let reasons = [self.disarmed_because.clone(), problem.unwrap_or_default()];
                reasons.into_iter().filter(|reason| !reason.is_empty()).collect::<Vec<_>>().join("; ")
            }
            State::LettingGo | State::Arming { .. } | State::Armed { .. } => match &self.hold {
                Some(hold) => hold.reason().to_owned(),
                None => self.lead_notice.clone(),
            },
        }
    }

    /// Names of the joints that are not known to be without torque: readings taken since torque was last switched off do not
    /// show it, or there are none. A motor that does not report its torque counts once its joint stands still. All joints
    /// while torque is on.
    pub fn not_let_go(&self, now_ns: u64) -> Vec<String> {
        let let_go = |dof: usize| {
            let Some(since_ns) = self.limp_since_ns else { return false };
            let joint = &self.telemetry.joints[dof];
            let fresh = joint.fresh(now_ns, self.times.telemetry_ttl);
            fresh.filter(|reading| reading.received_ns > since_ns).is_some_and(|reading| {
                reading.torque_on.map_or_else(|| joint.at_rest(since_ns), |torque_on| !torque_on)
            })
        };
        let joints = (0..self.joints.len()).filter(|&dof| !let_go(dof));
        joints.map(|dof| self.joint_name(dof).to_owned()).collect()
    }

    /// Whether readings taken since the stop show every joint without torque or at rest. What cannot be seen now is not
    /// known to have stopped.
    fn stop_confirmed(&self, now_ns: u64) -> bool {
        let State::Stopped { since_ns, .. } = self.state else { return false };
        self.telemetry.joints.iter().all(|joint| {
            joint
                .fresh(now_ns, self.times.telemetry_ttl)
                .filter(|reading| reading.received_ns > since_ns)
                .is_some_and(|reading| reading.torque_on == Some(false) || joint.at_rest(since_ns))
        })
    }
}

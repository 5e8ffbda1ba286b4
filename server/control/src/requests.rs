//! Requests of connections, and who may ask for what.

use std::collections::BTreeMap;

use palpate_safety::{Lease, Supervisor};
use palpate_wire::proto::{ControlReply, ControlRequest, control_request::Request};

/// Connections that may be remembered; who opens more than this has forgotten to close some.
const MOST_CONNECTIONS: usize = 4096;

/// Everybody who has sent a request, with the lease that is theirs.
#[derive(Debug, Default)]
pub(crate) struct Desk {
    connections: BTreeMap<u64, Connection>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Connection {
    last_sequence: u64,
    lease: Option<Lease>,
}

/// What is left to be done for a request that the safety layer is through with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Effect {
    Nothing,
    /// Clear what can be cleared of a device.
    ClearFault(String),
    Tare,
}

/// What else is going on, as far as requests depend on it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Busy {
    /// The station moves by itself.
    pub(crate) guided_motion: bool,
    /// A take is being recorded.
    pub(crate) recording: bool,
}

impl Desk {
    /// Whether `request` is a stop, which goes before everything else.
    pub(crate) fn is_stop(request: &ControlRequest) -> bool {
        matches!(request.request, Some(Request::Stop(_)))
    }

    /// Does what `request` of `connection` asks of the safety layer; gives what is left to do, or why it is refused.
    /// `commands` counts everything that sets targets, so that no two of them have the same number.
    pub(crate) fn handle(
        &mut self,
        now_ns: u64,
        supervisor: &mut Supervisor,
        commands: &mut u64,
        busy: Busy,
        connection: u64,
        request: &ControlRequest,
    ) -> Result<Effect, String> {
        let stop = Self::is_stop(request);
        if !self.connections.contains_key(&connection) && self.connections.len() >= MOST_CONNECTIONS && !stop
        {
            return Err("too many connections are open; close some pages".to_owned());
        }
        let known = self.connections.entry(connection).or_default();
        let held = known.lease;
        if stop {
            // Never refused, whatever its number.
            known.last_sequence = known.last_sequence.max(request.sequence);
            let who = match held {
                Some(lease) if supervisor.status(now_ns).lease == Some(lease) => {
                    supervisor.status(now_ns).holder
                }
                _ => format!("connection {connection}"),
            };
            supervisor.stop(now_ns, &who);
            return Ok(Effect::Nothing);
        }
        if request.sequence <= known.last_sequence {
            return Err(format!(
                "request {} comes after request {}; number the requests of a connection upwards from 1",
                request.sequence, known.last_sequence
            ));
        }
        known.last_sequence = request.sequence;
        let Some(what) = &request.request else {
            return Err("the request is empty or of a newer version; reload the page".to_owned());
        };
        if let Request::Acquire(acquire) = what {
            if let Some(lease) = held
                && supervisor.heartbeat(now_ns, lease).is_ok()
            {
                return Ok(Effect::Nothing);
            }
            let lease = supervisor
                .acquire(now_ns, &acquire.operator, acquire.take_over)
                .map_err(|refusal| refusal.to_string())?;
            self.connections.entry(connection).or_default().lease = Some(lease);
            return Ok(Effect::Nothing);
        }
        let lease = held.filter(|lease| lease.0 == request.lease).ok_or_else(|| match request.lease {
            0 => "you watch only; take control first".to_owned(),
            lease => format!("lease {lease} is not yours; take control first"),
        })?;
        let done = match what {
            Request::Release(_) => {
                let released = supervisor.release(now_ns, lease);
                if released.is_ok()
                    && let Some(known) = self.connections.get_mut(&connection)
                {
                    known.lease = None;
                }
                released
            }
            Request::Heartbeat(_) => supervisor.heartbeat(now_ns, lease),
            Request::Arm(_) => supervisor.arm(now_ns, lease),
            Request::Disarm(_) => supervisor.disarm(now_ns, lease),
            Request::ResetStop(_) => supervisor.reset_stop(now_ns, lease),
            Request::Targets(_) | Request::LeadThrough(_) if busy.guided_motion => {
                return Err("the station moves by itself now; cancel the motion first".to_owned());
            }
            Request::LeadThrough(lead) => supervisor.lead_through(now_ns, lease, lead.on),
            Request::Targets(targets) => {
                if targets.dofs.len() != targets.positions.len() {
                    return Err(format!(
                        "{} joints with {} positions, expected one position for each joint",
                        targets.dofs.len(),
                        targets.positions.len()
                    ));
                }
                let dofs = targets.dofs.iter().map(|&dof| dof as usize);
                let targets: Vec<(usize, f64)> = dofs.zip(targets.positions.iter().copied()).collect();
                *commands += 1;
                supervisor.targets(now_ns, lease, *commands, &targets)
            }
            Request::ClearFault(clear) => {
                use palpate_safety::Phase::{Armed, Arming, Holding};
                if matches!(supervisor.status(now_ns).phase, Arming | Armed | Holding) {
                    return Err("motors let go when faults are cleared; disarm first".to_owned());
                }
                supervisor.heartbeat(now_ns, lease).map_err(|refusal| refusal.to_string())?;
                return Ok(Effect::ClearFault(clear.device.clone()));
            }
            Request::Tare(_) => {
                supervisor.heartbeat(now_ns, lease).map_err(|refusal| refusal.to_string())?;
                if busy.recording {
                    return Err(
                        "a take is being recorded, whose zero must stay; tare before or after".to_owned()
                    );
                }
                return Ok(Effect::Tare);
            }
            Request::Acquire(_) | Request::Stop(_) => Ok(()),
        };
        done.map(|()| Effect::Nothing).map_err(|refusal| refusal.to_string())
    }

    /// The reply to a request that ended so.
    pub(crate) fn reply(
        &self,
        now_ns: u64,
        supervisor: &Supervisor,
        connection: u64,
        sequence: u64,
        ended: Result<(), String>,
    ) -> ControlReply {
        let held = self.connections.get(&connection).and_then(|known| known.lease);
        let current = held.filter(|lease| supervisor.status(now_ns).lease == Some(*lease));
        ControlReply {
            sequence,
            accepted: ended.is_ok(),
            problem: ended.err().unwrap_or_default(),
            lease: current.map_or(0, |lease| lease.0),
        }
    }

    /// The connection has gone. What it moved holds at once: nobody can keep that going any more.
    pub(crate) fn lost(&mut self, now_ns: u64, supervisor: &mut Supervisor, connection: u64) {
        if let Some(lease) = self.connections.remove(&connection).and_then(|known| known.lease) {
            supervisor.operator_gone(now_ns, lease);
        }
    }
}

#[cfg(test)]
mod tests;

//! Requests of connections, and who may ask for what.
//!
//! The desk binds a lease to the control connection that acquired it. Whatever moves the robot or changes what the robot
//! is about to do passes the desk: requests of the connection itself, and HTTP requests that prove by the lease's secret
//! number that they come from its holder.

use std::{collections::BTreeMap, sync::Arc};

use palpate_safety::{Lease, Refusal, Supervisor};
use palpate_wire::proto::{ControlReply, ControlRequest, ObjectPose, control_request::Request};

use crate::audit::Who;

/// Connections that may be remembered; whoever opens more than this has forgotten to close some.
const MAX_CONNECTIONS: usize = 4096;

/// A control connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Caller {
    /// A number that stands for this connection and no other.
    pub connection: u64,
    /// Who is at the other end, for the audit log: an address, and a person where there is a login.
    pub peer: Arc<str>,
    /// Whether it may take control. Whoever may not can do nothing but STOP.
    pub may_operate: bool,
}

/// An HTTP request that claims to come from the operator.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Claim {
    /// The secret number of the lease, as the control connection was given it; 0 without one.
    pub lease: u64,
    /// Who is at the other end, for the audit log: an address.
    pub peer: Arc<str>,
}

/// Whoever holds the lease, as the desk has found.
#[derive(Clone, Debug)]
pub(crate) struct Operator {
    pub(crate) who: Who,
}

/// Everybody who has sent a request, with the lease that is theirs.
#[derive(Debug, Default)]
pub(crate) struct Desk {
    connections: BTreeMap<u64, Connection>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Connection {
    last_sequence: u64,
    last_urgent_sequence: u64,
    held: Option<Held>,
}

/// A lease, and the number by which its holder proves to have it.
#[derive(Clone, Copy, Debug)]
struct Held {
    lease: Lease,
    secret: u64,
}

/// What is left to be done for a request that the safety layer is through with.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Effect {
    Nothing,
    /// Clear what can be cleared of a device.
    ClearFault(String),
    Tare,
    /// Where the object is, for the take that is being recorded.
    ObjectPose(ObjectPose),
    /// Switch the reflex on with this configuration, or off, for whoever has this lease.
    Reflex {
        on: bool,
        config_toml: String,
        lease: Lease,
    },
}

/// Why a request is refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Refused {
    /// By the desk; the safety layer has not seen it.
    ByDesk(String),
    /// By the safety layer, whose audit log says so.
    BySafety(String),
}

impl Refused {
    /// What was wrong, in words for whoever asked.
    pub(crate) fn into_text(self) -> String {
        match self {
            Self::ByDesk(text) | Self::BySafety(text) => text,
        }
    }
}

impl From<Refusal> for Refused {
    fn from(refusal: Refusal) -> Self {
        Self::BySafety(refusal.to_string())
    }
}

/// What else is going on, as far as requests depend on it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Busy {
    /// The station moves by itself.
    pub(crate) guided_motion: bool,
    /// A take is being recorded.
    pub(crate) recording: bool,
}

/// When a request is handled, and when it came in, ns.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Times {
    pub(crate) now_ns: u64,
    pub(crate) received_ns: u64,
}

/// Whether `request` goes before all others: a stop or a heartbeat.
pub(crate) fn is_urgent(request: &ControlRequest) -> bool {
    matches!(request.request, Some(Request::Stop(_) | Request::Heartbeat(_)))
}

/// Whether `request` is a stop.
pub(crate) fn is_stop(request: &ControlRequest) -> bool {
    matches!(request.request, Some(Request::Stop(_)))
}

/// What `request` asks for, in words.
pub(crate) fn describe(request: &ControlRequest) -> &'static str {
    match &request.request {
        None => "an empty request",
        Some(Request::Acquire(_)) => "take control",
        Some(Request::Release(_)) => "give control back",
        Some(Request::Heartbeat(_)) => "keep control",
        Some(Request::Arm(_)) => "arm",
        Some(Request::Disarm(_)) => "disarm",
        Some(Request::Stop(_)) => "STOP",
        Some(Request::ResetStop(_)) => "reset the stop",
        Some(Request::Targets(_)) => "move joints",
        Some(Request::LeadThrough(_)) => "lead the arm by hand",
        Some(Request::ClearFault(_)) => "clear faults",
        Some(Request::Tare(_)) => "take the zero of tactile readings",
        Some(Request::ObjectPose(_)) => "say where the object is",
        Some(Request::Reflex(reflex)) if reflex.on => "switch the reflex on",
        Some(Request::Reflex(_)) => "switch the reflex off",
    }
}

impl Caller {
    /// As the audit log names the connection.
    pub(crate) fn label(&self) -> String {
        format!("control {} from {}", self.connection, self.peer)
    }
}

impl Claim {
    /// As the audit log names the request's origin.
    pub(crate) fn label(&self) -> String {
        format!("http from {}", self.peer)
    }
}

impl Desk {
    /// Does what `request` of `caller` asks of the safety layer; gives what is left to do, or why it is refused.
    /// `commands` counts everything that sets targets, so that no two of them have the same number.
    pub(crate) fn handle(
        &mut self,
        Times { now_ns, received_ns }: Times,
        supervisor: &mut Supervisor,
        commands: &mut u64,
        busy: Busy,
        caller: &Caller,
        request: &ControlRequest,
    ) -> Result<Effect, Refused> {
        let by_desk = |problem: String| Err(Refused::ByDesk(problem));
        let connection = caller.connection;
        let stop = is_stop(request);
        if !stop && !caller.may_operate {
            return by_desk(
                "you may watch and press STOP; to take control, ask an admin for the role of operator"
                    .to_owned(),
            );
        }
        if !self.connections.contains_key(&connection) && self.connections.len() >= MAX_CONNECTIONS {
            if stop {
                // Never refused, not even where there is no room to remember who it was.
                supervisor.stop(now_ns, &caller.label());
                return Ok(Effect::Nothing);
            }
            return by_desk("too many connections are open; close some pages".to_owned());
        }
        let known = self.connections.entry(connection).or_default();
        let held = known.held;
        if stop {
            // Never refused, whatever its number.
            known.last_urgent_sequence = known.last_urgent_sequence.max(request.sequence);
            let status = supervisor.status(now_ns);
            let who = match held {
                Some(held) if status.lease == Some(held.lease) => status.holder,
                _ => caller.label(),
            };
            supervisor.stop(now_ns, &who);
            return Ok(Effect::Nothing);
        }
        // Urgent requests overtake others, so that the two are counted apart.
        let last = match is_urgent(request) {
            true => &mut known.last_urgent_sequence,
            false => &mut known.last_sequence,
        };
        if request.sequence <= *last {
            return by_desk(format!(
                "request {} comes after request {last}; number the requests of a connection upwards from 1",
                request.sequence
            ));
        }
        *last = request.sequence;
        let Some(what) = &request.request else {
            return by_desk("the request is empty or of a newer version; reload the page".to_owned());
        };
        if let Request::Acquire(acquire) = what {
            if let Some(held) = held
                && supervisor.heartbeat(now_ns, received_ns, held.lease).is_ok()
            {
                return Ok(Effect::Nothing);
            }
            let secret = match new_secret() {
                Ok(secret) => secret,
                Err(problem) => return by_desk(problem),
            };
            let lease = supervisor.acquire(now_ns, &acquire.operator, acquire.take_over)?;
            self.connections.entry(connection).or_default().held = Some(Held { lease, secret });
            return Ok(Effect::Nothing);
        }
        let Some(Held { lease, .. }) = held.filter(|held| held.secret == request.lease) else {
            return by_desk(match request.lease {
                0 => "you watch only; take control first".to_owned(),
                lease => format!("lease {lease} is not yours; take control first"),
            });
        };
        match what {
            Request::Release(_) => {
                supervisor.release(now_ns, lease)?;
                self.connections.entry(connection).or_default().held = None;
            }
            Request::Heartbeat(_) => supervisor.heartbeat(now_ns, received_ns, lease)?,
            Request::Arm(_) => supervisor.arm(now_ns, lease)?,
            Request::Disarm(_) => supervisor.disarm(now_ns, lease)?,
            Request::ResetStop(_) => supervisor.reset_stop(now_ns, lease)?,
            Request::Targets(_) | Request::LeadThrough(_) if busy.guided_motion => {
                return by_desk("the station moves by itself now; cancel the motion first".to_owned());
            }
            Request::LeadThrough(lead) => supervisor.lead_through(now_ns, lease, lead.on)?,
            Request::Targets(targets) => {
                if targets.dofs.len() != targets.positions.len() {
                    return by_desk(format!(
                        "{} joints with {} positions, expected one position for each joint",
                        targets.dofs.len(),
                        targets.positions.len()
                    ));
                }
                let dofs = targets.dofs.iter().map(|&dof| dof as usize);
                let targets: Vec<(usize, f64)> = dofs.zip(targets.positions.iter().copied()).collect();
                *commands += 1;
                supervisor.targets(now_ns, lease, *commands, &targets)?;
            }
            Request::ClearFault(clear) => {
                use palpate_safety::Phase::{Armed, Arming, Holding};
                if matches!(supervisor.status(now_ns).phase, Arming | Armed | Holding) {
                    return by_desk("motors let go when faults are cleared; disarm first".to_owned());
                }
                supervisor.heartbeat(now_ns, received_ns, lease)?;
                return Ok(Effect::ClearFault(clear.device.clone()));
            }
            Request::Tare(_) => {
                supervisor.heartbeat(now_ns, received_ns, lease)?;
                if busy.recording {
                    return by_desk(
                        "a take is being recorded, whose zero must stay; tare before or after".to_owned(),
                    );
                }
                return Ok(Effect::Tare);
            }
            Request::ObjectPose(pose) => {
                // Who says where the object is need not be who stands behind what moves: this is no heartbeat.
                if supervisor.status(now_ns).lease != Some(lease) {
                    return by_desk("your lease is not in force any more; take control first".to_owned());
                }
                return Ok(Effect::ObjectPose(pose.clone()));
            }
            Request::Reflex(reflex) => {
                supervisor.heartbeat(now_ns, received_ns, lease)?;
                return Ok(Effect::Reflex { on: reflex.on, config_toml: reflex.config_toml.clone(), lease });
            }
            Request::Acquire(_) | Request::Stop(_) => {}
        }
        Ok(Effect::Nothing)
    }

    /// Whoever `claim` proves to be: the holder of the lease in force, whose control connection is open. Says who has
    /// control otherwise.
    pub(crate) fn operator(
        &self,
        now_ns: u64,
        supervisor: &Supervisor,
        claim: &Claim,
        what: &str,
    ) -> Result<Operator, String> {
        let status = supervisor.status(now_ns);
        let is_theirs = |held: &Held| claim.lease != 0 && held.secret == claim.lease;
        let holds = |(_, connection): &(&u64, &Connection)| {
            connection.held.as_ref().is_some_and(|held| is_theirs(held) && status.lease == Some(held.lease))
        };
        if let Some((number, _)) = self.connections.iter().find(holds) {
            let connection = format!("control {number}, {}", claim.label());
            return Ok(Operator { who: Who { name: status.holder, connection } });
        }
        Err(match status.holder.as_str() {
            "" => format!("only the operator may {what}, and nobody has control; take control first"),
            holder => format!("only the operator may {what}, and {holder:?} has control"),
        })
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
        let held = self.connections.get(&connection).and_then(|known| known.held);
        let current = held.filter(|held| supervisor.status(now_ns).lease == Some(held.lease));
        ControlReply {
            sequence,
            accepted: ended.is_ok(),
            problem: ended.err().unwrap_or_default(),
            lease: current.map_or(0, |held| held.secret),
            stop_confirmed: false,
        }
    }

    /// As the audit log names `caller`.
    pub(crate) fn who(&self, now_ns: u64, supervisor: &Supervisor, caller: &Caller) -> Who {
        let held = self.connections.get(&caller.connection).and_then(|known| known.held);
        let status = supervisor.status(now_ns);
        let name = match held {
            Some(held) if status.lease == Some(held.lease) => status.holder,
            _ => "somebody without control".to_owned(),
        };
        Who { name, connection: caller.label() }
    }

    /// The connection has gone. What it moved holds at once: nobody can keep that going any more.
    pub(crate) fn lost(&mut self, now_ns: u64, supervisor: &mut Supervisor, connection: u64) {
        if let Some(held) = self.connections.remove(&connection).and_then(|known| known.held) {
            supervisor.operator_gone(now_ns, held.lease);
        }
    }
}

/// A number that nobody can guess, never 0.
fn new_secret() -> Result<u64, String> {
    getrandom::u64().map(|secret| secret.max(1)).map_err(|error| {
        format!("the operating system gives no random numbers ({error}), so nobody can take control")
    })
}

#[cfg(test)]
mod tests;

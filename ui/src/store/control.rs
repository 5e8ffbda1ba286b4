//! The socket of commands as the page knows it: the lease, what waits for a reply, what was refused, and where the
//! operator wants joints to be.
//!
//! What the station really does comes with the stream ([`super::Store::control_state`]); here is what this page asked.

use std::collections::{BTreeMap, VecDeque};

use palpate_wire::proto::{
    Acquire, Arm, ClearFault, ControlReply, ControlState, Disarm, LeadThrough, Release, ResetStop, Stop,
    Tare, Targets, control_request::Request, control_state::Phase,
};
use prost::Message as _;

use super::Connection;

/// A joint that is commanded this near to where it is wanted has arrived, rad or m.
const ARRIVED: f64 = 2e-3;
/// A wish that the station has not followed for so long is given up, s: the safety layer holds the joint back.
const WISH_FOR_S: f64 = 8.0;
/// So many refusals stay on the page; older ones go.
const MOST_PROBLEMS: usize = 3;

/// Who may command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Holder {
    /// Nobody.
    Nobody,
    /// This page.
    Me,
    /// Somebody else, by name.
    Other(String),
}

/// A command that was refused, or a lease that was lost.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// What was asked, e.g. `Arm`.
    pub what: &'static str,
    /// Why not, and what to do.
    pub why: String,
    /// The operator's time of day.
    pub at: String,
}

/// Where the operator wants a joint to be, until it is there.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Wish {
    position: f64,
    since_s: f64,
    sent: bool,
}

/// See the module.
#[derive(Debug, Default)]
pub struct ControlLink {
    /// The socket.
    pub connection: Connection,
    /// Who sits at this page; empty for nobody in particular.
    pub operator: String,
    /// What was refused, oldest first, until somebody has read it.
    pub refusals: Vec<Refusal>,
    /// A stop was wanted while there was no way to send it.
    pub stop_unsent: bool,
    lease: u64,
    pending: VecDeque<(u64, &'static str)>,
    outbox: Vec<Request>,
    wishes: BTreeMap<usize, Wish>,
}

impl ControlLink {
    /// The lease that this page holds; 0 for none.
    pub fn lease(&self) -> u64 {
        self.lease
    }

    /// Whether commands of this page reach the station.
    pub fn is_open(&self) -> bool {
        self.connection == Connection::Open
    }

    /// Who may command, as far as `state` and the replies to this page tell.
    pub fn holder(&self, state: Option<&ControlState>) -> Holder {
        match state {
            _ if self.lease != 0 => Holder::Me,
            Some(state) if state.lease != 0 || !state.holder.is_empty() => {
                let name = if state.holder.is_empty() { "somebody" } else { &state.holder };
                Holder::Other(name.to_owned())
            }
            _ => Holder::Nobody,
        }
    }

    /// Whether a command of this kind (see [`Refusal::what`]) waits for its reply.
    pub fn waits_for(&self, what: &str) -> bool {
        self.outbox.iter().map(what_of).chain(self.pending.iter().map(|(_, what)| *what)).any(|w| w == what)
    }

    /// Asks for the lease, from whoever holds it if `take_over`.
    pub fn acquire(&mut self, take_over: bool) {
        let name = self.operator.trim();
        let operator = if name.is_empty() { "operator" } else { name }.to_owned();
        self.outbox.push(Request::Acquire(Acquire { operator, take_over }));
    }

    /// Gives the lease back, which disarms.
    pub fn release(&mut self) {
        self.outbox.push(Request::Release(Release {}));
    }

    /// Torque on, where the joints are.
    pub fn arm(&mut self) {
        self.outbox.push(Request::Arm(Arm {}));
    }

    /// Torque off, in an orderly way.
    pub fn disarm(&mut self) {
        self.wishes.clear();
        self.outbox.push(Request::Disarm(Disarm {}));
    }

    /// Stops everything; needs no lease. Without a connection it is sent as soon as there is one.
    pub fn stop(&mut self) {
        self.wishes.clear();
        if self.is_open() {
            // Before anything else that waits, and instead of every motion.
            self.outbox.retain(|request| !matches!(request, Request::Targets(_) | Request::Arm(_)));
            self.outbox.insert(0, Request::Stop(Stop {}));
        } else {
            self.stop_unsent = true;
        }
    }

    /// Ends a latched stop.
    pub fn reset_stop(&mut self) {
        self.outbox.push(Request::ResetStop(ResetStop {}));
    }

    /// The arm yields to the operator's hands, or holds again.
    pub fn lead_through(&mut self, on: bool) {
        self.outbox.push(Request::LeadThrough(LeadThrough { on }));
    }

    /// Clears what can be cleared of a device's faults.
    pub fn clear_fault(&mut self, device: &str) {
        self.outbox.push(Request::ClearFault(ClearFault { device: device.to_owned() }));
    }

    /// What the taxels read now is their zero.
    pub fn tare(&mut self) {
        self.outbox.push(Request::Tare(Tare {}));
    }

    /// Wants degree of freedom `dof` at `position`, rad or m. Only the newest wish is sent; nonsense is not.
    pub fn want(&mut self, dof: usize, position: f64, now_s: f64) {
        if position.is_finite() {
            self.wishes.insert(dof, Wish { position, since_s: now_s, sent: false });
        }
    }

    /// Where the operator wants `dof` to be, while it is on its way.
    pub fn wanted(&self, dof: usize) -> Option<f64> {
        self.wishes.get(&dof).map(|wish| wish.position)
    }

    /// Nobody needs to read the refusals any more.
    pub fn dismiss(&mut self) {
        self.refusals.clear();
    }

    /// Commands that wait to be sent, each with its lease.
    pub fn take_outbox(&mut self) -> Vec<(u64, Request)> {
        if !self.is_open() {
            // A command that is late by a reconnection is worse than none; a stop is kept apart.
            self.outbox.clear();
            self.wishes.clear();
            return Vec::new();
        }
        let lease = self.lease;
        let mut requests = std::mem::take(&mut self.outbox);
        if lease != 0 {
            let new: Vec<(usize, f64)> = self
                .wishes
                .iter_mut()
                .filter(|(_, wish)| !wish.sent)
                .map(|(dof, wish)| {
                    wish.sent = true;
                    (*dof, wish.position)
                })
                .collect();
            if !new.is_empty() {
                let dofs = new.iter().map(|(dof, _)| u32::try_from(*dof).unwrap_or(u32::MAX)).collect();
                let positions = new.iter().map(|(_, position)| *position).collect();
                requests.push(Request::Targets(Targets { dofs, positions }));
            }
        }
        requests.into_iter().map(|request| (lease, request)).collect()
    }

    /// `request` left as number `sequence`, or could not leave.
    pub fn sent(&mut self, sequence: Option<u64>, request: &Request) {
        match sequence {
            Some(sequence) => self.pending.push_back((sequence, what_of(request))),
            None if matches!(request, Request::Stop(_)) => self.stop_unsent = true,
            None => {}
        }
    }

    pub(super) fn opened(&mut self) {
        self.connection = Connection::Open;
        self.pending.clear();
        // The new connection holds nothing yet, and the old one is gone.
        self.lease = 0;
        if std::mem::take(&mut self.stop_unsent) {
            self.stop();
        }
    }

    pub(super) fn closed(&mut self, now_s: f64, time_of_day: &str) {
        if !matches!(self.connection, Connection::Lost { .. }) {
            self.connection = Connection::Lost { since: time_of_day.to_owned(), since_s: now_s };
        }
        if self.pending.iter().any(|(_, what)| *what == STOP) {
            self.stop_unsent = true;
        }
        self.lease = 0;
        self.pending.clear();
        self.outbox.clear();
        self.wishes.clear();
    }

    /// Takes in a reply.
    pub(super) fn receive(&mut self, bytes: &[u8], time_of_day: &str) {
        // A reply that does not decode comes from a newer server; the next one may be known again.
        let Ok(reply) = ControlReply::decode(bytes) else { return };
        // Replies come in order: whatever is older than this one will not be answered any more.
        let mut what = None;
        while let Some((sequence, asked)) = self.pending.front().copied()
            && sequence <= reply.sequence
        {
            self.pending.pop_front();
            if sequence == reply.sequence {
                what = Some(asked);
            }
        }
        let lost_lease = self.lease != 0 && reply.lease == 0 && !reply.accepted;
        self.lease = reply.lease;
        if self.lease == 0 {
            self.wishes.clear();
        }
        if reply.accepted {
            return;
        }
        if what == Some(TARGETS) {
            self.wishes.clear();
        }
        // Refused heartbeats are no news, unless they tell that control is gone.
        if let Some(what) = what.or(lost_lease.then_some("Keep control")) {
            self.refuse(what, reply.problem, time_of_day);
        }
    }

    /// Wishes end when they are fulfilled, or when nothing moves any more.
    pub(super) fn follow(&mut self, state: &ControlState, now_s: f64) {
        if state.phase() != Phase::Armed {
            self.wishes.clear();
        }
        self.wishes.retain(|dof, wish| {
            let commanded = state.commanded.get(*dof).copied().map(f64::from);
            let arrived = wish.sent && commanded.is_some_and(|at| (at - wish.position).abs() < ARRIVED);
            !arrived && now_s - wish.since_s < WISH_FOR_S
        });
    }

    fn refuse(&mut self, what: &'static str, why: String, time_of_day: &str) {
        // The same again (a slider that is dragged against a limit) takes the place of the one before.
        self.refusals.retain(|known| known.what != what);
        self.refusals.push(Refusal { what, why, at: time_of_day.to_owned() });
        let excess = self.refusals.len().saturating_sub(MOST_PROBLEMS);
        self.refusals.drain(..excess);
    }
}

const STOP: &str = "STOP";
const TARGETS: &str = "Move";

/// A command in words.
fn what_of(request: &Request) -> &'static str {
    match request {
        Request::Acquire(_) => "Take control",
        Request::Release(_) => "Give back control",
        Request::Heartbeat(_) => "Keep control",
        Request::Arm(_) => "Arm",
        Request::Disarm(_) => "Disarm",
        Request::Stop(_) => STOP,
        Request::ResetStop(_) => "Reset stop",
        Request::Targets(_) => TARGETS,
        Request::LeadThrough(_) => "Lead-through",
        Request::ClearFault(_) => "Clear fault",
        Request::Tare(_) => "Set zero",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open() -> ControlLink {
        let mut link = ControlLink::default();
        link.opened();
        link
    }

    fn reply(link: &mut ControlLink, sequence: u64, lease: u64, problem: &str) {
        let reply =
            ControlReply { sequence, accepted: problem.is_empty(), problem: problem.to_owned(), lease };
        link.receive(&reply.encode_to_vec(), "10:00:00");
    }

    /// Sends what waits, numbered from `first` on.
    fn send(link: &mut ControlLink, first: u64) -> Vec<(u64, Request)> {
        let sent = link.take_outbox();
        for (sequence, (_, request)) in (first..).zip(&sent) {
            link.sent(Some(sequence), request);
        }
        sent
    }

    fn armed_at(positions: &[f32]) -> ControlState {
        let mut state = ControlState { commanded: positions.to_vec(), ..Default::default() };
        state.set_phase(Phase::Armed);
        state
    }

    #[test]
    fn lease_comes_and_goes_with_replies() {
        let mut link = open();
        link.operator = "  Ada ".into();
        link.acquire(false);
        assert!(link.waits_for("Take control"));
        let sent = send(&mut link, 1);
        assert_eq!(sent, [(0, Request::Acquire(Acquire { operator: "Ada".into(), take_over: false }))]);
        assert_eq!(link.holder(None), Holder::Nobody);
        reply(&mut link, 1, 5, "");
        assert_eq!((link.lease(), link.holder(None)), (5, Holder::Me));
        assert!(!link.waits_for("Take control"));
        // A heartbeat that nobody listed: somebody took over.
        reply(&mut link, 2, 0, "Bo took over; ask for control again");
        assert_eq!(link.lease(), 0);
        assert_eq!(link.refusals[0].why, "Bo took over; ask for control again");
        reply(&mut link, 3, 0, "no lease");
        assert_eq!(link.refusals.len(), 1, "a beat without a lease is no news");
    }

    #[test]
    fn only_the_newest_wish_leaves_and_none_without_a_lease() {
        let mut link = open();
        link.want(3, 0.1, 0.0);
        assert!(link.take_outbox().is_empty());
        reply(&mut link, 1, 7, "");
        link.want(3, 0.2, 0.0);
        link.want(3, f64::NAN, 0.0);
        link.want(1, -0.5, 0.0);
        let targets = Targets { dofs: vec![1, 3], positions: vec![-0.5, 0.2] };
        assert_eq!(send(&mut link, 2), [(7, Request::Targets(targets))]);
        assert!(link.take_outbox().is_empty(), "a wish is sent once");
        assert_eq!(link.wanted(3), Some(0.2));
        link.follow(&armed_at(&[0.0, -0.5, 0.0, 0.1]), 1.0);
        assert_eq!((link.wanted(1), link.wanted(3)), (None, Some(0.2)), "one has arrived");
        link.follow(&armed_at(&[0.0, -0.5, 0.0, 0.1]), 20.0);
        assert_eq!(link.wanted(3), None, "a wish is not kept for ever");
    }

    #[test]
    fn refused_targets_are_wished_no_more() {
        let mut link = open();
        reply(&mut link, 1, 7, "");
        link.want(0, 9.0, 0.0);
        send(&mut link, 2);
        reply(&mut link, 2, 7, "joint \"lift\": 9 is beyond its limit 0.1");
        assert_eq!((link.wanted(0), link.refusals[0].what), (None, "Move"));
    }

    #[test]
    fn stop_goes_first_and_takes_motions_with_it() {
        let mut link = open();
        reply(&mut link, 1, 7, "");
        link.arm();
        link.want(0, 0.1, 0.0);
        link.tare();
        link.stop();
        let sent: Vec<&str> = link.take_outbox().iter().map(|(_, request)| what_of(request)).collect();
        assert_eq!(sent, ["STOP", "Set zero"]);
    }

    #[test]
    fn stop_survives_a_lost_connection_and_nothing_else_does() {
        let mut link = open();
        reply(&mut link, 1, 7, "");
        link.stop();
        send(&mut link, 2);
        link.closed(3.0, "10:00:03");
        link.arm();
        assert!(link.stop_unsent && link.take_outbox().is_empty() && link.lease() == 0);
        link.opened();
        assert_eq!(link.take_outbox(), [(0, Request::Stop(Stop {}))]);
        assert!(!link.stop_unsent);
    }

    #[test]
    fn wishes_end_when_the_station_holds() {
        let mut link = open();
        reply(&mut link, 1, 7, "");
        link.want(0, 0.5, 0.0);
        let mut state = armed_at(&[0.0]);
        state.set_phase(Phase::Holding);
        link.follow(&state, 0.1);
        assert_eq!(link.wanted(0), None);
    }

    #[test]
    fn others_are_named() {
        let link = open();
        let state = ControlState { lease: 3, holder: "Ada".into(), ..Default::default() };
        assert_eq!(link.holder(Some(&state)), Holder::Other("Ada".into()));
        assert_eq!(link.holder(Some(&ControlState::default())), Holder::Nobody);
    }
}

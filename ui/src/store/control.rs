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
const MAX_REFUSALS: usize = 3;

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

/// How far the last STOP of this page is.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub enum StopProgress {
    /// This page pressed none, or the stop was reset since.
    #[default]
    None,
    /// It was sent, and the station has not answered yet.
    Stopping,
    /// Readings show every motor without torque or motion.
    Confirmed {
        /// The operator's time of day.
        at: String,
    },
    /// The station answered, and readings do not show that everything stands.
    Unconfirmed {
        /// What could not be confirmed, in the station's words.
        problem: String,
        /// The operator's time of day.
        at: String,
    },
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
    /// Who sits at this page; empty until somebody said it. Control is never taken without a name.
    pub operator: String,
    /// What was refused, oldest first, until somebody has read it.
    pub refusals: Vec<Refusal>,
    /// A stop was wanted while there was no way to send it.
    pub stop_unsent: bool,
    stop: StopProgress,
    /// The station was seen stopped since the last stop of this page: it has been reset when it is not any more.
    stop_seen: bool,
    /// A screen wants control for this page.
    control_wanted: bool,
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
            Some(state) if !state.holder.is_empty() => Holder::Other(state.holder.clone()),
            _ => Holder::Nobody,
        }
    }

    /// Whether a command of this kind (see [`Refusal::what`]) waits for its reply.
    pub fn waits_for(&self, what: &str) -> bool {
        self.outbox.iter().map(what_of).chain(self.pending.iter().map(|(_, what)| *what)).any(|w| w == what)
    }

    /// How far the last STOP of this page is.
    pub fn stop_progress(&self) -> &StopProgress {
        &self.stop
    }

    /// Wants control for this page: the frame asks whoever must be asked, then [acquires](Self::acquire) it.
    pub fn want_control(&mut self) {
        self.control_wanted = true;
    }

    /// Whether control was wanted since the last call.
    pub fn take_control_wanted(&mut self) -> bool {
        std::mem::take(&mut self.control_wanted)
    }

    /// Whether this page knows who sits at it.
    pub fn has_name(&self) -> bool {
        !self.operator.trim().is_empty()
    }

    /// Asks for the lease, from whoever holds it if `take_over`. Nothing is asked without a name.
    pub fn acquire(&mut self, take_over: bool) {
        if self.has_name() {
            let operator = self.operator.trim().to_owned();
            self.outbox.push(Request::Acquire(Acquire { operator, take_over }));
        }
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
        self.stop = StopProgress::Stopping;
        self.stop_seen = false;
        if self.is_open() {
            // Before anything else that waits, and instead of every motion.
            self.outbox.retain(|request| !matches!(request, Request::Targets(_) | Request::Arm(_)));
            self.outbox.insert(0, Request::Stop(Stop {}));
        } else {
            self.stop_unsent = true;
        }
    }

    /// A stop has left already, as number `sequence`: nothing that was to move may follow it.
    pub(super) fn stop_left(&mut self, sequence: u64) {
        self.wishes.clear();
        self.outbox.retain(|request| !matches!(request, Request::Targets(_) | Request::Arm(_)));
        self.stop = StopProgress::Stopping;
        self.stop_seen = false;
        self.pending.push_back((sequence, STOP));
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

    /// Somebody has read how the last stop of this page went.
    pub fn dismiss_stop(&mut self) {
        self.stop = StopProgress::None;
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
        let waiting = self.pending.iter().position(|(sequence, _)| *sequence == reply.sequence);
        let what = waiting.and_then(|idx| self.pending.remove(idx)).map(|(_, what)| what);
        if what == Some(STOP) {
            self.stop_answered(reply, time_of_day);
            return;
        }
        // Replies come in order, but for those to stops: whatever else is older will not be answered any more.
        self.pending.retain(|(sequence, asked)| *sequence > reply.sequence || *asked == STOP);
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

    /// The answer to a stop says nothing new about the lease: later replies may have overtaken it.
    fn stop_answered(&mut self, reply: ControlReply, time_of_day: &str) {
        let at = time_of_day.to_owned();
        if reply.stop_confirmed {
            self.stop = StopProgress::Confirmed { at };
        } else if !self.pending.iter().any(|(_, what)| *what == STOP) {
            let problem = match reply.problem {
                problem if problem.is_empty() => "the station did not say why; cut the power".to_owned(),
                problem => problem,
            };
            self.stop = StopProgress::Unconfirmed { problem, at };
        }
    }

    /// What the station says of the stop: it may be confirmed later than its reply, and ends with a reset.
    fn follow_stop(&mut self, state: &ControlState) {
        if state.phase() == Phase::Stopped {
            self.stop_seen = true;
            if let StopProgress::Unconfirmed { at, .. } = &mut self.stop
                && state.stop_confirmed
            {
                self.stop = StopProgress::Confirmed { at: std::mem::take(at) };
            }
        } else if self.stop_seen && self.stop != StopProgress::Stopping {
            self.stop = StopProgress::None;
            self.stop_seen = false;
        }
    }

    /// Wishes end when they are fulfilled, or when nothing moves any more.
    pub(super) fn follow(&mut self, state: &ControlState, now_s: f64) {
        self.follow_stop(state);
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
        let excess = self.refusals.len().saturating_sub(MAX_REFUSALS);
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
        Request::Reflex(_) => "Reflex",
        Request::ObjectPose(_) => "Say where the object is",
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
        let reply = ControlReply {
            sequence,
            accepted: problem.is_empty(),
            problem: problem.to_owned(),
            lease,
            stop_confirmed: false,
        };
        link.receive(&reply.encode_to_vec(), "10:00:00");
    }

    fn stop_reply(link: &mut ControlLink, sequence: u64, stop_confirmed: bool, problem: &str) {
        let problem = problem.to_owned();
        let reply = ControlReply { sequence, accepted: true, problem, lease: 0, stop_confirmed };
        link.receive(&reply.encode_to_vec(), "10:00:01");
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
    fn control_is_never_asked_for_without_a_name() {
        let mut link = open();
        link.operator = "  ".into();
        link.acquire(false);
        link.acquire(true);
        assert!(link.take_outbox().is_empty() && !link.has_name());
    }

    #[test]
    fn stop_is_answered_out_of_order_and_hides_no_other_reply() {
        let mut link = open();
        reply(&mut link, 1, 7, "");
        link.tare();
        send(&mut link, 2);
        link.stop();
        send(&mut link, 3);
        link.lead_through(false);
        send(&mut link, 4);
        assert_eq!(link.stop_progress(), &StopProgress::Stopping);
        // Later requests are answered before the stop, which waits for readings.
        reply(&mut link, 4, 7, "");
        assert!(link.waits_for("STOP") && !link.waits_for("Lead-through"));
        stop_reply(&mut link, 3, true, "");
        assert_eq!(link.stop_progress(), &StopProgress::Confirmed { at: "10:00:01".into() });
        assert_eq!(link.lease(), 7, "only replies in order tell about the lease");

        // A stop that is confirmed at once overtakes what was asked before.
        link.tare();
        send(&mut link, 5);
        link.stop();
        send(&mut link, 6);
        stop_reply(&mut link, 6, true, "");
        assert!(link.waits_for("Set zero"));
        reply(&mut link, 5, 7, "not now");
        assert_eq!(link.refusals[0].what, "Set zero");
    }

    #[test]
    fn stop_that_is_not_confirmed_says_why_until_readings_or_a_reset_end_it() {
        let mut link = open();
        link.stop();
        send(&mut link, 1);
        let mut state = ControlState::default();
        state.set_phase(Phase::Armed);
        link.follow(&state, 0.0);
        stop_reply(&mut link, 1, false, "joint \"lift\" has not been read since the stop");
        let unconfirmed = StopProgress::Unconfirmed {
            problem: "joint \"lift\" has not been read since the stop".into(),
            at: "10:00:01".into(),
        };
        assert_eq!(link.stop_progress(), &unconfirmed);
        state.set_phase(Phase::Stopped);
        link.follow(&state, 0.0);
        assert_eq!(link.stop_progress(), &unconfirmed);
        state.stop_confirmed = true;
        link.follow(&state, 0.0);
        assert_eq!(link.stop_progress(), &StopProgress::Confirmed { at: "10:00:01".into() });
        state.set_phase(Phase::Disarmed);
        link.follow(&state, 0.0);
        assert_eq!(link.stop_progress(), &StopProgress::None, "it was reset");
    }

    #[test]
    fn stop_that_left_before_the_frame_takes_motions_along_and_is_answered() {
        let mut link = open();
        reply(&mut link, 1, 7, "");
        link.want(0, 0.1, 0.0);
        link.arm();
        link.stop_left(2);
        assert!(link.take_outbox().is_empty());
        assert_eq!(link.stop_progress(), &StopProgress::Stopping);
        stop_reply(&mut link, 2, true, "");
        assert!(matches!(link.stop_progress(), StopProgress::Confirmed { .. }));
    }

    #[test]
    fn second_stop_keeps_the_page_stopping_until_one_is_confirmed() {
        let mut link = open();
        link.stop();
        send(&mut link, 1);
        link.stop();
        send(&mut link, 2);
        stop_reply(&mut link, 1, false, "not yet");
        assert_eq!(link.stop_progress(), &StopProgress::Stopping);
        stop_reply(&mut link, 2, true, "");
        assert!(matches!(link.stop_progress(), StopProgress::Confirmed { .. }));
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
        let state = ControlState { holder: "Ada".into(), ..Default::default() };
        assert_eq!(link.holder(Some(&state)), Holder::Other("Ada".into()));
        assert_eq!(link.holder(Some(&ControlState::default())), Holder::Nobody);
    }
}

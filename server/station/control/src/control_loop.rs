//! The thread that runs a station.

use std::{
    sync::{Arc, mpsc::Receiver},
    time::Duration,
};

use palpate_drivers::{DeviceEvent, Devices, HostClock};
use palpate_reports::wording::counted;
use palpate_robot_model::Station;
use palpate_safety::Supervisor;
use palpate_wire::proto::{ControlReply, ControlRequest, LiveFrame, control_request::Request};

use crate::{
    audit::{AuditLog, Who},
    ending::{Ending, ShuttingDown},
    error::ControlError,
    guided::Guided,
    inbox::{Inbox, Urgent},
    latch::Latch,
    message::{Answer, Message},
    pace::Pace,
    rates::RateMeter,
    reflex::Reflex,
    reflex::ReflexConfig,
    refusals::Refusals,
    requests::{Busy, Caller, Claim, Desk, Effect, Refused, Times, describe, is_stop},
    senses::{Sensed, Senses},
    snapshot::Snapshot,
    streams::StreamSample,
    twin::{Twin, TwinFrame},
};

/// Turns of the loop: 200 Hz, so that no command waits for longer than 5 ms.
const TURN_NS: u64 = 5_000_000;
/// Turns of the loop, Hz, where nothing holds it up.
pub const LOOP_HZ: f64 = 1e9 / TURN_NS as f64;
/// Messages to pages: 30 Hz at most.
const FRAME_NS: u64 = 33_333_334;
/// A tare takes this long.
pub(crate) const TARE_NS: u64 = 500_000_000;
/// Who does what nobody asked for, in the audit log.
const STATION: &str = "station";
/// Requests that are answered before the next turn is looked at, so that a flood of them cannot stop the loop.
const MAX_AT_ONCE: usize = 256;
/// The reply to a stop does not wait longer than this for readings that confirm it, ns.
const STOP_REPLY_NS: u64 = 1_000_000_000;
/// Replies to stops that may wait; more of them are answered at once, unconfirmed.
const MAX_STOP_REPLIES: usize = 256;
/// What is refused while the loop ends.
const ENDING: &str = "the studio is shutting down";

/// Hands a message to every page. It is called on a thread of its own and may take its time: what it has not got to when
/// the next message is there is left out.
pub type Publish = Box<dyn Fn(LiveFrame) + Send>;

/// A stop whose reply waits for readings.
pub(crate) struct StopReply {
    connection: u64,
    sequence: u64,
    since_ns: u64,
    answer: Answer<ControlReply>,
}

pub(crate) struct ControlLoop {
    pub(crate) station: Arc<Station>,
    pub(crate) supervisor: Supervisor,
    pub(crate) devices: Devices,
    pub(crate) events: Receiver<DeviceEvent>,
    pub(crate) inbox: Inbox,
    pub(crate) clock: HostClock,
    pub(crate) frames: crossbeam_channel::Sender<LiveFrame>,
    pub(crate) senses: Senses,
    pub(crate) guided: Guided,
    pub(crate) twin: Twin,
    pub(crate) audit: AuditLog,
    pub(crate) desk: Desk,
    pub(crate) refusals: Refusals,
    pub(crate) latch: Latch,
    pub(crate) stop_replies: Vec<StopReply>,
    /// Torque was on at some time.
    pub(crate) was_armed: bool,
    /// Counts everything that sets targets.
    pub(crate) commands: u64,
    pub(crate) loop_rate: RateMeter,
    /// Positions that are commanded now; empty while disarmed.
    pub(crate) commanded: Vec<f64>,
    /// Who asked for the tare that is under way.
    pub(crate) tare_for: Option<Who>,
    /// What was wrong with the last tare; empty when all was well.
    pub(crate) tare_problem: String,
    /// How far each joint may be behind a guided motion, rad or m.
    pub(crate) tolerances: Vec<f64>,
    /// The reflex of the digits, while it is on.
    pub(crate) reflex: Option<Reflex>,
}

impl ControlLoop {
    /// Until it is told to end. Motion ends first; what it gives says how.
    pub(crate) fn run(&mut self) -> Ending {
        let mut turns = Pace::new(self.clock.now_ns(), TURN_NS);
        let mut frames = Pace::new(self.clock.now_ns(), FRAME_NS);
        let mut ending: Option<ShuttingDown> = None;
        loop {
            let wait_ns = turns.next_ns().saturating_sub(self.clock.now_ns());
            self.inbox.wait(Duration::from_nanos(wait_ns));
            if self.take_messages(ending.is_some()) && ending.is_none() {
                ending = Some(self.begin_shutdown(self.clock.now_ns()));
            }
            let now_ns = self.clock.now_ns();
            if turns.due(now_ns) {
                self.turn(now_ns);
                if frames.due(now_ns) {
                    self.publish_frame();
                }
                if let Some(ended) = ending.as_mut().and_then(|ending| self.shut_down(now_ns, ending)) {
                    return ended;
                }
            }
        }
    }

    /// Answers what waits, urgent messages before every other one; says whether the loop has to end. While it does,
    /// everything but stops is refused.
    fn take_messages(&mut self, is_ending: bool) -> bool {
        let mut must_end = self.take_kept();
        for _ in 0..MAX_AT_ONCE {
            match self.inbox.urgent() {
                Some(Urgent::Request { caller, request, received_ns, answer }) => {
                    self.urgent(&caller, &request, received_ns, answer, is_ending);
                }
                Some(Urgent::End) => must_end = true,
                None => match self.inbox.ordinary() {
                    Some(message) => self.message(message, is_ending),
                    None => break,
                },
            }
        }
        must_end
    }

    /// Does what was kept while the urgent queue was full; says whether the loop has to end.
    fn take_kept(&mut self) -> bool {
        let Some(kept) = self.inbox.kept() else { return false };
        let now_ns = self.clock.now_ns();
        if kept.stop {
            self.supervisor.stop(now_ns, "a connection that found the queue full");
            self.drive(now_ns);
        }
        for connection in kept.lost {
            self.desk.lost(now_ns, &mut self.supervisor, connection);
        }
        kept.end
    }

    fn urgent(
        &mut self,
        caller: &Caller,
        request: &ControlRequest,
        received_ns: u64,
        answer: Answer<ControlReply>,
        is_ending: bool,
    ) {
        if !is_stop(request) {
            return answer(self.request(caller, request, received_ns, is_ending));
        }
        let reply = self.request(caller, request, received_ns, false);
        let now_ns = self.clock.now_ns();
        // Not at the next turn: now.
        self.drive(now_ns);
        if self.stop_replies.len() >= MAX_STOP_REPLIES {
            return answer(reply);
        }
        let (connection, sequence) = (caller.connection, request.sequence);
        self.stop_replies.push(StopReply { connection, sequence, since_ns: now_ns, answer });
    }

    /// Answers stops that are confirmed now, and those that have waited long enough.
    fn answer_stops(&mut self, now_ns: u64) {
        if self.stop_replies.is_empty() {
            return;
        }
        let status = self.supervisor.status(now_ns);
        let is_stopped = status.phase == palpate_safety::Phase::Stopped;
        let is_due = |reply: &StopReply| {
            status.stop_confirmed || !is_stopped || now_ns.saturating_sub(reply.since_ns) >= STOP_REPLY_NS
        };
        let (due, waiting) = std::mem::take(&mut self.stop_replies).into_iter().partition(is_due);
        self.stop_replies = waiting;
        let due: Vec<StopReply> = due;
        for StopReply { connection, sequence, answer, .. } in due {
            let reply = self.desk.reply(now_ns, &self.supervisor, connection, sequence, Ok(()));
            let problem = match (status.stop_confirmed, is_stopped) {
                (true, _) => String::new(),
                (false, true) => format!("{}; check the robot", status.reason),
                (false, false) => "the stop was reset before readings confirmed it".to_owned(),
            };
            answer(ControlReply { problem, stop_confirmed: status.stop_confirmed, ..reply });
        }
    }

    fn message(&mut self, message: Message, is_ending: bool) {
        // Whoever asked may have gone meanwhile; then nobody needs the answer.
        let ended = || Err(ControlError::Refused(ENDING.to_owned()));
        match message {
            Message::Request { caller, request, received_ns, answer } => {
                answer(self.request(&caller, &request, received_ns, is_ending));
            }
            Message::ConnectionLost(connection) => {
                self.desk.lost(self.clock.now_ns(), &mut self.supervisor, connection);
                self.stop_replies.retain(|reply| reply.connection != connection);
            }
            Message::Recording(reply) => {
                let _ = reply.send(self.guided.document());
            }
            Message::Authorise { claim, what, unless_free, reply } => {
                let authorised = self.authorise(&claim, &what, unless_free);
                if let Ok(who) = &authorised {
                    self.audit.note_by(self.clock.now_ns(), who, &what);
                }
                let _ = reply.send(authorised.map(|_| ()));
            }
            Message::Begin(claim, prepared, reply) => {
                let _ = reply.send(if is_ending { ended() } else { self.begin_session(&claim, *prepared) });
            }
            Message::Act(claim, action, reply) => {
                let _ = reply.send(if is_ending { ended() } else { self.act(&claim, &action) });
            }
            Message::BeginTake(claim, prepared, reply) => {
                let _ = reply.send(if is_ending { ended() } else { self.begin_take(&claim, *prepared) });
            }
            Message::ActOnTake(claim, action, reply) => {
                let _ = reply.send(self.act_on_take(&claim, &action));
            }
            Message::Want(claim, wanted, reply) => {
                let _ = reply.send(self.want(&claim, wanted));
            }
            Message::AddStep(claim, step, reply) => {
                let _ = reply.send(self.add_step(&claim, *step));
            }
            Message::Unwant { claim, object, primitive, reply } => {
                let _ = reply.send(self.unwant(&claim, &object, &primitive));
            }
        }
    }

    /// Who makes a claim that only the operator may make; the audit log learns of everybody else. With `unless_free`
    /// anybody may while nobody has control and no session is under way.
    pub(crate) fn authorise(
        &mut self,
        claim: &Claim,
        what: &str,
        unless_free: bool,
    ) -> Result<Who, ControlError> {
        let now_ns = self.clock.now_ns();
        let nobody = Who { name: "somebody without control".to_owned(), connection: claim.label() };
        let is_free = self.supervisor.status(now_ns).lease.is_none() && self.guided.guide.is_none();
        if unless_free && is_free {
            return Ok(nobody);
        }
        self.desk.operator(now_ns, &self.supervisor, claim, what).map(|operator| operator.who).map_err(
            |problem| {
                self.refused(now_ns, &nobody, what, &problem);
                ControlError::NotOperator(problem)
            },
        )
    }

    fn refused(&mut self, now_ns: u64, who: &Who, what: &str, problem: &str) {
        for (who, line) in self.refusals.note(now_ns, who, what, problem) {
            self.audit.note_by(now_ns, &who, &line);
        }
    }

    fn request(
        &mut self,
        caller: &Caller,
        request: &ControlRequest,
        received_ns: u64,
        is_ending: bool,
    ) -> ControlReply {
        let now_ns = self.clock.now_ns();
        let sequence = request.sequence;
        if is_ending {
            return self.desk.reply(
                now_ns,
                &self.supervisor,
                caller.connection,
                sequence,
                Err(ENDING.to_owned()),
            );
        }
        let busy = Busy { guided_motion: self.guided.moves(), recording: self.guided.recorder.recording() };
        let times = Times { now_ns, received_ns };
        // What happened by itself until now is nobody's doing.
        self.note_audit("");
        let handled =
            self.desk.handle(times, &mut self.supervisor, &mut self.commands, busy, caller, request);
        self.note_audit(&caller.label());
        if let Err(Refused::ByDesk(problem)) = &handled {
            let who = self.desk.who(now_ns, &self.supervisor, caller);
            self.refused(now_ns, &who, describe(request), problem);
        }
        match (&handled, &request.request) {
            (Ok(_), Some(Request::Targets(targets))) => {
                if let Some(reflex) = &mut self.reflex {
                    reflex.told(&targets.dofs, &targets.positions);
                }
                self.told(now_ns, targets);
            }
            (Ok(_), Some(Request::LeadThrough(lead))) if lead.on => self.touch_begins(now_ns),
            _ => {}
        }
        let ended = handled.map_err(Refused::into_text).and_then(|effect| self.effect(times, caller, effect));
        self.desk.reply(now_ns, &self.supervisor, caller.connection, sequence, ended)
    }

    /// Writes down what the safety layer has noted; what somebody did, as done from `connection`.
    fn note_audit(&mut self, connection: &str) {
        for entry in self.supervisor.drain_audit() {
            let connection = if entry.who == STATION { "" } else { connection };
            let who = Who { name: entry.who.clone(), connection: connection.to_owned() };
            self.audit.note_by(entry.at_ns, &who, &entry.to_string());
        }
    }

    fn effect(&mut self, times: Times, caller: &Caller, effect: Effect) -> Result<(), String> {
        let Times { now_ns, received_ns } = times;
        match effect {
            Effect::Nothing => Ok(()),
            Effect::ObjectPose(pose) => self.object_is_at(now_ns, received_ns, &pose),
            Effect::ClearFault(device) => {
                self.devices.clear_fault(&device).map_err(|error| error.to_string())?;
                let who = self.desk.who(now_ns, &self.supervisor, caller);
                self.audit.note_by(now_ns, &who, &format!("asked {device} to clear its faults"));
                Ok(())
            }
            Effect::Tare => {
                self.tare_for = Some(self.desk.who(now_ns, &self.supervisor, caller));
                self.senses.streams.tare(now_ns, TARE_NS);
                Ok(())
            }
            Effect::Reflex { on, config_toml, lease } => {
                let config = match on {
                    true => Some(
                        ReflexConfig::from_toml(&config_toml, &self.station)
                            .map_err(|problem| format!("the reflex's configuration: {problem}"))?,
                    ),
                    false => None,
                };
                let who = self.desk.who(now_ns, &self.supervisor, caller);
                let what = if on { "switched the reflex on" } else { "switched the reflex off" };
                self.audit.note_by(now_ns, &who, what);
                self.set_reflex(config, lease);
                Ok(())
            }
        }
    }

    /// One turn: what devices say, what guided motions want, what motors shall do.
    fn turn(&mut self, now_ns: u64) {
        self.loop_rate.tick(now_ns);
        while let Ok(event) = self.events.try_recv() {
            self.sense(&event);
        }
        self.finish_tare(now_ns);
        self.supervisor.measured(now_ns, &self.senses.measured);
        self.guide(now_ns);
        self.reflex(now_ns);
        self.drive(now_ns);
        self.answer_stops(now_ns);
        self.note_audit("");
        for (who, line) in self.refusals.due(now_ns) {
            self.audit.note_by(now_ns, &who, &line);
        }
    }

    pub(crate) fn drive(&mut self, now_ns: u64) {
        let setpoint = self.supervisor.tick(now_ns);
        self.devices.set(&setpoint);
        self.latch.set(self.supervisor.stopped_by());
        self.was_armed |= setpoint.torque();
        self.commanded.clear();
        if setpoint.torque() {
            self.commanded.extend_from_slice(setpoint.positions());
            self.guided.recorder.commands(now_ns, &self.commanded);
        }
    }

    fn sense(&mut self, event: &DeviceEvent) {
        match self.senses.event(event) {
            Some(Sensed::Joints(frame)) => self.guided.recorder.joints(frame.host_ns, &frame.positions),
            Some(Sensed::Tactile(samples)) => {
                for StreamSample { stream, host_ns, device_ns, raw, active } in &samples {
                    self.guided.recorder.tactile(*stream, *host_ns, *device_ns, raw, active);
                }
            }
            Some(Sensed::Link { device, text, trouble }) => {
                let (now_ns, what) = (self.clock.now_ns(), format!("{device} {text}"));
                match trouble {
                    true => self.audit.warn(now_ns, STATION, &what),
                    false => self.audit.note(now_ns, STATION, &what),
                }
            }
            None => {}
        }
    }

    fn finish_tare(&mut self, now_ns: u64) {
        let Some(outcome) = self.senses.streams.finish_tare(now_ns) else { return };
        let who = self.tare_for.take().unwrap_or_else(|| Who::part(STATION));
        let mut what = format!("took the zero of {}", counted(outcome.num_boards as u64, "tactile board"));
        for problem in &outcome.problems {
            what.push_str("; ");
            what.push_str(problem);
        }
        self.audit.note_by(now_ns, &who, &what);
        self.tare_problem = outcome.problems.join("; ");
        self.tared(now_ns, &outcome.problems);
    }

    fn publish_frame(&mut self) {
        let now_ns = self.clock.now_ns();
        let status = self.supervisor.status(now_ns);
        let positions = self.senses.positions().unwrap_or_default();
        let touch = self.senses.streams.touch(now_ns);
        let recording = self.guided.status(now_ns);
        self.senses.latency.published(now_ns);
        self.show_twin(now_ns);
        let twin = self.twin.view().clone();
        let frame = Snapshot {
            time_s: now_ns as f64 * 1e-9,
            positions: &positions,
            touch: &touch,
            activity: recording.as_ref().map(|status| status.activity.clone()).unwrap_or_default(),
            object: self.guided.object(),
            rates_hz: self.senses.rates_hz(now_ns),
            status: &status,
            notices: &[&self.tare_problem, &self.audit.problem()],
            commanded: &self.commanded,
            loop_rates_hz: [
                self.loop_rate.now_hz(now_ns),
                self.loop_rate.mean_hz(now_ns),
                self.loop_rate.worst_hz(now_ns),
            ],
            latency_ms: [self.senses.latency.newest_ms(), self.senses.latency.p95_ms()],
            devices: &self.devices.health(),
            taxels: twin.warnings,
            recording,
            twin: Some(twin.status),
            reflex: self.reflex_status(),
        };
        // Publishing takes locks that slow threads share; a publisher that is behind misses this one.
        let _ = self.frames.try_send(frame.message());
    }

    /// Lets the twin look at this moment, if it is time.
    fn show_twin(&mut self, now_ns: u64) {
        if !self.twin.due(now_ns) {
            return;
        }
        // Between sessions nobody says what stands there.
        let object = self.guided.guide.as_ref().and_then(|_| self.guided.object());
        self.twin.show(TwinFrame {
            at_s: now_ns as f64 * 1e-9,
            positions: self.senses.positions(),
            readings: self.senses.streams.readings(now_ns),
            object: object.map(|(id, pose)| (id.to_owned(), pose)),
        });
    }
}

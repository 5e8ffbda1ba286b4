//! The thread that runs a station.

use std::{
    collections::VecDeque,
    sync::{
        Arc,
        mpsc::{Receiver, RecvTimeoutError},
    },
    time::Duration,
};

use palpate_drivers::{DeviceEvent, Devices, HostClock};
use palpate_robot_model::Station;
use palpate_safety::Supervisor;
use palpate_wire::{
    proto::{ControlReply, ControlRequest, LiveFrame},
    wording::counted,
};

use crate::{
    audit::AuditLog,
    guided::Guided,
    handle::Message,
    pace::Pace,
    rates::RateMeter,
    requests::{Busy, Desk, Effect},
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
const MOST_AT_ONCE: usize = 256;

/// Hands a message to every page.
pub type Publish = Box<dyn Fn(LiveFrame) + Send>;

pub(crate) struct ControlLoop {
    pub(crate) station: Arc<Station>,
    pub(crate) supervisor: Supervisor,
    pub(crate) devices: Devices,
    pub(crate) events: Receiver<DeviceEvent>,
    pub(crate) messages: Receiver<Message>,
    pub(crate) clock: HostClock,
    pub(crate) publish: Publish,
    pub(crate) senses: Senses,
    pub(crate) guided: Guided,
    pub(crate) twin: Twin,
    pub(crate) audit: AuditLog,
    pub(crate) desk: Desk,
    /// Counts everything that sets targets.
    pub(crate) commands: u64,
    pub(crate) loop_rate: RateMeter,
    /// Positions that are commanded now; empty while disarmed.
    pub(crate) commanded: Vec<f64>,
    /// Who asked for the tare that is under way.
    pub(crate) tare_for: String,
    /// What was wrong with the last tare; empty when all was well.
    pub(crate) tare_problem: String,
    /// How far each joint may be behind a guided motion, rad or m.
    pub(crate) tolerances: Vec<f64>,
}

impl ControlLoop {
    /// Until it is told to end, or nobody is left who could tell it anything.
    pub(crate) fn run(mut self) {
        let mut turns = Pace::new(self.clock.now_ns(), TURN_NS);
        let mut frames = Pace::new(self.clock.now_ns(), FRAME_NS);
        let mut inbox: VecDeque<Message> = VecDeque::new();
        loop {
            let wait_ns = match inbox.is_empty() {
                true => turns.next_ns().saturating_sub(self.clock.now_ns()),
                false => 0,
            };
            match self.messages.recv_timeout(Duration::from_nanos(wait_ns)) {
                Ok(message) => inbox.push_back(message),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            inbox.extend(self.messages.try_iter().take(MOST_AT_ONCE));
            if inbox.iter().any(|message| matches!(message, Message::End)) {
                break;
            }
            self.stops_first(&mut inbox);
            for _ in 0..inbox.len().min(MOST_AT_ONCE) {
                if let Some(message) = inbox.pop_front() {
                    self.message(message);
                }
            }
            let now_ns = self.clock.now_ns();
            if turns.due(now_ns) {
                self.turn(now_ns);
                if frames.due(now_ns) {
                    self.publish_frame();
                }
            }
        }
        self.end();
    }

    /// Answers every stop that waits, before anything that came earlier.
    fn stops_first(&mut self, inbox: &mut VecDeque<Message>) {
        let is_stop =
            |message: &Message| matches!(message, Message::Request { request, .. } if Desk::is_stop(request));
        while let Some(idx) = inbox.iter().position(is_stop) {
            if let Some(message) = inbox.remove(idx) {
                self.message(message);
                // Not at the next turn: now.
                self.drive(self.clock.now_ns());
            }
        }
    }

    fn message(&mut self, message: Message) {
        // Whoever asked may have gone meanwhile; then nobody needs the answer.
        match message {
            Message::Request { connection, request, reply } => {
                let answer = self.request(connection, &request);
                let _ = reply.send(answer);
            }
            Message::ConnectionLost(connection) => {
                self.desk.lost(self.clock.now_ns(), &mut self.supervisor, connection);
            }
            Message::Recording(reply) => {
                let _ = reply.send(self.guided.document());
            }
            Message::Begin(prepared, reply) => {
                let _ = reply.send(self.begin_session(*prepared));
            }
            Message::Act(action, reply) => {
                let _ = reply.send(self.act(&action));
            }
            Message::Want(wanted, reply) => {
                let _ = reply.send(self.want(wanted));
            }
            Message::AddStep(step, reply) => {
                let _ = reply.send(self.add_step(*step));
            }
            Message::Unwant { object, primitive, reply } => {
                let _ = reply.send(self.unwant(&object, &primitive));
            }
            Message::End => {}
        }
    }

    fn request(&mut self, connection: u64, request: &ControlRequest) -> ControlReply {
        let now_ns = self.clock.now_ns();
        let busy = Busy { guided_motion: self.guided.moves(), recording: self.guided.recorder.recording() };
        let handled =
            self.desk.handle(now_ns, &mut self.supervisor, &mut self.commands, busy, connection, request);
        let ended = handled.and_then(|effect| self.effect(now_ns, effect));
        self.desk.reply(now_ns, &self.supervisor, connection, request.sequence, ended)
    }

    fn effect(&mut self, now_ns: u64, effect: Effect) -> Result<(), String> {
        match effect {
            Effect::Nothing => Ok(()),
            Effect::ClearFault(device) => {
                self.devices.clear_fault(&device).map_err(|error| error.to_string())?;
                let who = self.supervisor.status(now_ns).holder;
                self.audit.note(now_ns, &who, &format!("asked {device} to clear its faults"));
                Ok(())
            }
            Effect::Tare => {
                self.tare_for = self.supervisor.status(now_ns).holder;
                self.senses.streams.tare(now_ns, TARE_NS);
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
        self.drive(now_ns);
        for entry in self.supervisor.drain_audit() {
            self.audit.note(entry.at_ns, &entry.who, &entry.to_string());
        }
    }

    fn drive(&mut self, now_ns: u64) {
        let setpoint = self.supervisor.tick(now_ns);
        self.devices.set(&setpoint);
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
        let who = std::mem::take(&mut self.tare_for);
        let mut what = format!("took the zero of {}", counted(outcome.num_boards as u64, "tactile board"));
        for problem in &outcome.problems {
            what.push_str("; ");
            what.push_str(problem);
        }
        self.audit.note(now_ns, &who, &what);
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
        };
        (self.publish)(frame.message());
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

    /// Lets go of the robot in an orderly way, and says so.
    fn end(&mut self) {
        let now_ns = self.clock.now_ns();
        self.supervisor.stop(now_ns, STATION);
        self.drive(now_ns);
        for entry in self.supervisor.drain_audit() {
            self.audit.note(entry.at_ns, &entry.who, &entry.to_string());
        }
        self.audit.note(now_ns, STATION, "the control loop has ended");
    }
}

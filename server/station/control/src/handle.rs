//! The way into the control loop for everybody else.

use std::{
    sync::{
        Arc,
        mpsc::{RecvTimeoutError, SyncSender, sync_channel},
    },
    time::Duration,
};

use palpate_drivers::HostClock;
use palpate_robot_model::Station;
use palpate_sim::SensorModel;
use palpate_wire::{
    api::{
        FreeTakeState, PlanDocument, RecordingAction, RecordingDocument, Source, StartRecording, StartTake,
        StepState, TakeAction, WantedTake,
    },
    proto::{ControlReply, ControlRequest, control_request::Request},
};

use crate::{
    error::ControlError,
    inbox::{Mailbox, Rejected, Urgent},
    message::{Answer, Message},
    prepare::Plans,
    prepared_take::{self, FindObject},
    requests::{Caller, Claim, is_stop, is_urgent},
    twin::TwinModel,
    wanted::WantedFile,
};

/// The loop answers within milliseconds; after this long it is taken to have died.
const PATIENCE: Duration = Duration::from_secs(5);

/// Speaks to the control loop. Clones speak to the same one; every call is answered within a period of the loop, except
/// that beginning a session takes as long as its motions take to be planned.
#[derive(Clone, Debug)]
pub struct Handle {
    mailbox: Mailbox,
    clock: HostClock,
    shared: Arc<Shared>,
}

/// What does not change while a station runs.
#[derive(Debug)]
pub(crate) struct Shared {
    pub(crate) station: Arc<Station>,
    pub(crate) source: Source,
    pub(crate) plans: Plans,
    pub(crate) wanted_file: WantedFile,
    pub(crate) twin_model: TwinModel,
}

impl Handle {
    pub(crate) fn new(mailbox: Mailbox, clock: HostClock, shared: Shared) -> Self {
        Self { mailbox, clock, shared: Arc::new(shared) }
    }

    /// The station that is run.
    pub fn station(&self) -> &Arc<Station> {
        &self.shared.station
    }

    /// Whether it is hardware or emulated.
    pub fn source(&self) -> Source {
        self.shared.source
    }

    /// Time since the station was opened, ns; requests are stamped with it when they come in.
    pub fn now_ns(&self) -> u64 {
        self.clock.now_ns()
    }

    /// Hands in a request of a connection that came in at `received_ns`, without waiting. `caller` stands for that
    /// connection alone; the lease that it acquires is its own. `answer` gets the reply on the loop's thread, so it must not
    /// wait; it is dropped unused if the loop has ended. Stops and heartbeats go before everything else, and the reply to a
    /// stop comes when readings confirm it, a second later at most.
    pub fn submit(
        &self,
        caller: &Caller,
        received_ns: u64,
        request: ControlRequest,
        answer: Answer<ControlReply>,
    ) {
        let (sequence, stop) = (request.sequence, is_stop(&request));
        let caller = caller.clone();
        let sent = match is_urgent(&request) {
            true => self.mailbox.urgent(Urgent::Request { caller, request, received_ns, answer }),
            false => self.mailbox.ordinary(Message::Request { caller, request, received_ns, answer }),
        };
        // The answer went with the message; callers learn from its loss that there was none.
        if let Err(Rejected::Full) = sent
            && stop
        {
            tracing::warn!(sequence, "the queue of the control loop is full; a stop overtakes it");
            self.mailbox.keep(|kept| kept.stop = true);
        }
    }

    /// The same, and waits for the reply: for callers that have a thread to themselves.
    pub fn request(&self, connection: u64, request: ControlRequest) -> ControlReply {
        let sequence = request.sequence;
        let (reply, answer) = sync_channel(1);
        let caller = Caller { connection, peer: "this process".into(), may_operate: true };
        let is_heartbeat = matches!(request.request, Some(Request::Heartbeat(_)));
        let answer_it = move |answer| {
            // A caller that has lost patience needs no answer.
            let _ = reply.try_send(answer);
        };
        self.submit(&caller, self.now_ns(), request, Box::new(answer_it));
        let answered = answer.recv_timeout(PATIENCE).map_err(unanswered);
        answered.unwrap_or_else(|error| ControlReply {
            sequence,
            problem: match is_heartbeat {
                true => format!("the heartbeat was not taken: {error}"),
                false => error.to_string(),
            },
            ..ControlReply::default()
        })
    }

    /// A connection has gone. Its lease is not given back by that, but nobody keeps it alive any more: a robot that it
    /// moved holds at once, and is disarmed soon after.
    pub fn connection_lost(&self, connection: u64) {
        // A loop that has ended has let go of the robot already.
        if let Err(Rejected::Full) = self.mailbox.ordinary(Message::ConnectionLost(connection)) {
            self.mailbox.keep(|kept| kept.lost.push(connection));
        }
    }

    /// Refuses `what` to everybody but the operator; the audit log learns who asked. With `unless_free` anybody may while
    /// nobody has control and no session is under way.
    pub fn authorise(&self, claim: &Claim, what: &str, unless_free: bool) -> Result<(), ControlError> {
        let (claim, what) = (claim.clone(), what.to_owned());
        self.ask(|reply| Message::Authorise { claim, what, unless_free, reply })?
    }

    /// The guided session that is under way, and the plans that there are.
    pub fn recording(&self) -> Result<RecordingDocument, ControlError> {
        self.ask(Message::Recording)
    }

    /// The plans that there are, with their takes.
    pub fn plans(&self) -> Result<Vec<PlanDocument>, ControlError> {
        self.shared.plans.documents()
    }

    /// Begins a guided session, or goes on with one. The first time this takes as long as the plan's motions take to be
    /// planned; the loop goes on meanwhile.
    pub fn start_recording(
        &self,
        claim: &Claim,
        start: StartRecording,
    ) -> Result<RecordingDocument, ControlError> {
        self.authorise(claim, "begin a session", false)?;
        let RecordingDocument { session, wanted, .. } = self.recording()?;
        if let Some(running) = session {
            return Err(ControlError::Refused(format!(
                "session {:?} is being recorded; leave it before another is begun",
                running.session
            )));
        }
        let prepared = Box::new(self.shared.plans.prepare(start, &wanted)?);
        let claim = claim.clone();
        self.keeping(self.ask(|reply| Message::Begin(claim, prepared, reply))?)
    }

    /// Begins a take outside guided sessions, in a session that is made if there is none. `find_object` is asked for an object
    /// that the station does not have.
    pub fn begin_take(
        &self,
        claim: &Claim,
        start: StartTake,
        find_object: FindObject<'_>,
    ) -> Result<RecordingDocument, ControlError> {
        self.authorise(claim, "record a take", false)?;
        let document = self.recording()?;
        let running = document
            .free
            .filter(|free| matches!(free.state, FreeTakeState::Recording | FreeTakeState::Checking));
        let busy = document.session.map(|session| session.session).or(running.map(|free| free.session));
        if let Some(session) = busy {
            return Err(ControlError::Refused(format!(
                "session {session:?} is being recorded; end that before a take is begun"
            )));
        }
        let prepared = prepared_take::prepare(
            &self.shared.station,
            self.shared.plans.sessions_dir(),
            start,
            find_object,
        )?;
        let claim = claim.clone();
        self.ask(|reply| Message::BeginTake(claim, Box::new(prepared), reply))?
    }

    /// What the operator does with the take that is recorded outside guided sessions.
    pub fn act_on_take(&self, claim: &Claim, action: TakeAction) -> Result<RecordingDocument, ControlError> {
        let claim = claim.clone();
        self.ask(|reply| Message::ActOnTake(claim, action, reply))?
    }

    /// Asks for a take besides those of a plan: the last step of the session under way, or of the next one. The motion is
    /// planned first where a session is under way; the loop goes on meanwhile.
    pub fn want(&self, claim: &Claim, wanted: WantedTake) -> Result<RecordingDocument, ControlError> {
        self.authorise(claim, "ask for a take", true)?;
        let claim = claim.clone();
        let document = self.recording()?;
        let same = |object: &str, primitive: &str| object == wanted.object && primitive == wanted.primitive;
        let waits = document.wanted.iter().any(|other| same(&other.object, &other.primitive));
        let is_open = |session: &palpate_wire::api::RecordingSession| {
            session.steps.iter().any(|step| {
                step.added_because.is_some()
                    && step.state == StepState::Open
                    && same(&step.object, &step.primitive)
            })
        };
        if waits || document.session.as_ref().is_some_and(is_open) {
            return Err(ControlError::Refused(format!(
                "{} on {} is on the list already",
                wanted.primitive, wanted.object
            )));
        }
        match &document.session {
            None => {
                self.shared.plans.check_wanted(&wanted)?;
                self.keeping(self.ask(|reply| Message::Want(claim, wanted, reply))?)
            }
            Some(session) => {
                let step = Box::new(self.shared.plans.add_step(session, wanted)?);
                self.ask(|reply| Message::AddStep(claim, step, reply))?
            }
        }
    }

    /// Takes back what [`Handle::want`] asked for, as long as it has no take.
    pub fn unwant(
        &self,
        claim: &Claim,
        object: &str,
        primitive: &str,
    ) -> Result<RecordingDocument, ControlError> {
        let (claim, object, primitive) = (claim.clone(), object.to_owned(), primitive.to_owned());
        self.keeping(self.ask(|reply| Message::Unwant { claim, object, primitive, reply })?)
    }

    /// What the operator does in the guided session.
    pub fn act(&self, claim: &Claim, action: RecordingAction) -> Result<RecordingDocument, ControlError> {
        let claim = claim.clone();
        self.ask(|reply| Message::Act(claim, action, reply))?
    }

    /// Sensor model that the live twin simulates with from now on, the station's own without one; gives its name. A model
    /// that speaks of what the station does not have is refused.
    pub fn set_model(&self, model: Option<SensorModel>) -> Result<String, ControlError> {
        self.shared.twin_model.set(&self.shared.station, model).map_err(ControlError::Refused)
    }

    /// Tells the loop to end.
    pub(crate) fn end(&self) {
        if let Err(Rejected::Full) = self.mailbox.urgent(Urgent::End) {
            self.mailbox.keep(|kept| kept.end = true);
        }
    }

    /// Keeps on disk what is wanted by now.
    fn keeping(
        &self,
        answer: Result<RecordingDocument, ControlError>,
    ) -> Result<RecordingDocument, ControlError> {
        let document = answer?;
        if let Err(error) = self.shared.wanted_file.keep(&document.wanted) {
            tracing::warn!(%error, "what is wanted would not survive a restart");
        }
        Ok(document)
    }

    fn ask<T>(&self, message: impl FnOnce(SyncSender<T>) -> Message) -> Result<T, ControlError> {
        let (reply, answer) = sync_channel(1);
        self.mailbox.ordinary(message(reply)).map_err(|rejected| match rejected {
            Rejected::Full => ControlError::Busy,
            Rejected::Ended => ControlError::Ended,
        })?;
        answer.recv_timeout(PATIENCE).map_err(unanswered)
    }
}

fn unanswered(error: RecvTimeoutError) -> ControlError {
    match error {
        RecvTimeoutError::Disconnected => ControlError::Ended,
        RecvTimeoutError::Timeout => ControlError::NoAnswer { seconds: PATIENCE.as_secs() },
    }
}

//! The way into the control loop for everybody else.

use std::{
    sync::{
        Arc,
        mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel},
    },
    time::Duration,
};

use palpate_robot_model::Station;
use palpate_sim::SensorModel;
use palpate_wire::{
    api::{RecordingAction, RecordingDocument, Source, StartRecording, StepState, WantedTake},
    proto::{ControlReply, ControlRequest},
};

use crate::{
    error::ControlError,
    prepare::{AddedStep, Plans, Prepared},
    twin::TwinModel,
    wanted::WantedFile,
};

/// The loop answers within milliseconds; who waits for longer than this waits for a loop that is not there any more.
const PATIENCE: Duration = Duration::from_secs(5);

/// Speaks to the control loop. Clones speak to the same one; every call is answered within a period of the loop, except
/// that beginning a session takes as long as its motions take to be planned.
#[derive(Clone, Debug)]
pub struct Handle {
    messages: Sender<Message>,
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

/// What the loop is asked. Commands are never dropped: every caller waits for its reply, so there are never more of
/// them than callers.
#[derive(Debug)]
pub(crate) enum Message {
    Request {
        connection: u64,
        request: ControlRequest,
        reply: SyncSender<ControlReply>,
    },
    ConnectionLost(u64),
    Recording(SyncSender<RecordingDocument>),
    Begin(Box<Prepared>, SyncSender<Result<RecordingDocument, ControlError>>),
    Act(RecordingAction, SyncSender<Result<RecordingDocument, ControlError>>),
    /// A take for the next session.
    Want(WantedTake, SyncSender<Result<RecordingDocument, ControlError>>),
    /// A step for the session under way.
    AddStep(Box<AddedStep>, SyncSender<Result<RecordingDocument, ControlError>>),
    /// What is wanted is not wanted any more.
    Unwant {
        object: String,
        primitive: String,
        reply: SyncSender<Result<RecordingDocument, ControlError>>,
    },
    /// The loop shall end.
    End,
}

impl Handle {
    pub(crate) fn new(shared: Shared) -> (Self, Receiver<Message>) {
        let (messages, received) = channel();
        (Self { messages, shared: Arc::new(shared) }, received)
    }

    /// The station that is run.
    pub fn station(&self) -> &Arc<Station> {
        &self.shared.station
    }

    /// Whether it is hardware or emulated.
    pub fn source(&self) -> Source {
        self.shared.source
    }

    /// Hands in a request of a connection. `connection` is a number that the caller chose for it and uses for no other;
    /// the lease that it acquires is its own.
    pub fn request(&self, connection: u64, request: ControlRequest) -> ControlReply {
        let sequence = request.sequence;
        self.ask(|reply| Message::Request { connection, request, reply }).unwrap_or_else(|error| {
            ControlReply { sequence, accepted: false, problem: error.to_string(), lease: 0 }
        })
    }

    /// A connection has gone. Its lease is not given back by that, but nobody keeps it alive any more: a robot that it
    /// moved holds at once, and is disarmed soon after.
    pub fn connection_lost(&self, connection: u64) {
        // A loop that has ended has let go of the robot already.
        let _ = self.messages.send(Message::ConnectionLost(connection));
    }

    /// The guided session that is under way, and the plans that there are.
    pub fn recording(&self) -> Result<RecordingDocument, ControlError> {
        self.ask(Message::Recording)
    }

    /// Begins a guided session, or goes on with one. The first time this takes as long as the plan's motions take to be
    /// planned; the loop goes on meanwhile.
    pub fn start_recording(&self, start: StartRecording) -> Result<RecordingDocument, ControlError> {
        let RecordingDocument { session, wanted, .. } = self.recording()?;
        if let Some(running) = session {
            return Err(ControlError::Refused(format!(
                "session {:?} is being recorded; leave it before another is begun",
                running.session
            )));
        }
        let prepared = Box::new(self.shared.plans.prepare(start, &wanted)?);
        self.keeping(self.ask(|reply| Message::Begin(prepared, reply))?)
    }

    /// Asks for a take besides those of a plan: the last step of the session under way, or of the next one. The motion is
    /// planned first where a session is under way; the loop goes on meanwhile.
    pub fn want(&self, wanted: WantedTake) -> Result<RecordingDocument, ControlError> {
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
                self.keeping(self.ask(|reply| Message::Want(wanted, reply))?)
            }
            Some(session) => {
                let step = Box::new(self.shared.plans.add_step(session, wanted)?);
                self.ask(|reply| Message::AddStep(step, reply))?
            }
        }
    }

    /// Takes back what [`Handle::want`] asked for, as long as it has no take.
    pub fn unwant(&self, object: &str, primitive: &str) -> Result<RecordingDocument, ControlError> {
        let (object, primitive) = (object.to_owned(), primitive.to_owned());
        self.keeping(self.ask(|reply| Message::Unwant { object, primitive, reply })?)
    }

    /// What the operator does in the guided session.
    pub fn act(&self, action: RecordingAction) -> Result<RecordingDocument, ControlError> {
        self.ask(|reply| Message::Act(action, reply))?
    }

    /// Sensor model that the live twin simulates with from now on, the station's own without one; gives its name. A model
    /// that speaks of what the station does not have is refused.
    pub fn set_model(&self, model: Option<SensorModel>) -> Result<String, ControlError> {
        self.shared.twin_model.set(&self.shared.station, model).map_err(ControlError::Refused)
    }

    pub(crate) fn end(&self) {
        let _ = self.messages.send(Message::End);
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
        self.messages.send(message(reply)).map_err(|_| ControlError::Ended)?;
        answer.recv_timeout(PATIENCE).map_err(|error| match error {
            RecvTimeoutError::Disconnected => ControlError::Ended,
            RecvTimeoutError::Timeout => ControlError::NoAnswer { seconds: PATIENCE.as_secs() },
        })
    }
}

//! Messages to the control loop.

use std::sync::mpsc::SyncSender;

use palpate_wire::{
    api::{RecordingAction, RecordingDocument, TakeAction, WantedTake},
    proto::{ControlReply, ControlRequest},
};

use crate::{
    error::ControlError,
    prepare::{AddedStep, Prepared},
    prepared_take::PreparedTake,
    requests::{Caller, Claim},
};

/// Receives the answer, on the control loop's thread: it must not wait.
pub type Answer<T> = Box<dyn FnOnce(T) + Send>;

/// A message to the loop that may wait behind others.
pub(crate) enum Message {
    Request {
        caller: Caller,
        request: ControlRequest,
        received_ns: u64,
        answer: Answer<ControlReply>,
    },
    ConnectionLost(u64),
    Recording(SyncSender<RecordingDocument>),
    /// Whether the claim is the operator's; `unless_free`: or nobody has control.
    Authorise {
        claim: Claim,
        what: String,
        unless_free: bool,
        reply: SyncSender<Result<(), ControlError>>,
    },
    Begin(Claim, Box<Prepared>, SyncSender<Result<RecordingDocument, ControlError>>),
    Act(Claim, RecordingAction, SyncSender<Result<RecordingDocument, ControlError>>),
    /// A take for the next session.
    Want(Claim, WantedTake, SyncSender<Result<RecordingDocument, ControlError>>),
    /// A step for the session under way.
    AddStep(Claim, Box<AddedStep>, SyncSender<Result<RecordingDocument, ControlError>>),
    /// A take outside guided sessions.
    BeginTake(Claim, Box<PreparedTake>, SyncSender<Result<RecordingDocument, ControlError>>),
    ActOnTake(Claim, TakeAction, SyncSender<Result<RecordingDocument, ControlError>>),
    /// What is wanted is not wanted any more.
    Unwant {
        claim: Claim,
        object: String,
        primitive: String,
        reply: SyncSender<Result<RecordingDocument, ControlError>>,
    },
}

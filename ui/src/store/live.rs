//! The live station: how far it is, whether it is still live, and the session that is being recorded on it.

use std::sync::Arc;

use palpate_wire::{
    api::{
        FreeTakeState, LiveModel, RecordingAction, RecordingDocument, RecordingPhase, Source, StartRecording,
        StartTake, TakeAction, WantedTake,
    },
    proto::{ControlState, control_state::Phase},
};

use super::{Connection, Loadable, Store, ask, parse_json, shared};
use crate::api_client::Request;

/// A live frame counts as live for so long: stations send many a second.
const LIVE_FOR_S: f64 = 2.0;

/// Session and id of the newest take outside guided sessions, once it is in the session's folder.
fn settled(document: &RecordingDocument) -> Option<(String, Option<String>)> {
    let free = document.free.as_ref()?;
    let is_settled = matches!(free.state, FreeTakeState::Accepted | FreeTakeState::SetAside);
    is_settled.then(|| (free.session.clone(), free.take.clone()))
}

impl Store {
    /// The checklist of the session that is being recorded.
    pub fn recording(&mut self) -> Loadable<Arc<RecordingDocument>> {
        ask(&mut self.recording, &mut self.outbox, || Request::Recording)
    }

    /// What the recording waits for or does now: from the stream, or the checklist where that is newer.
    pub fn recording_phase(&self) -> Option<RecordingPhase> {
        let document = self.recording.ready()?;
        let session = document.session.as_ref()?;
        let streamed = self.control_state().and_then(|state| state.recording.as_ref());
        let streamed = streamed.filter(|status| status.revision >= document.revision);
        let word = streamed.map(|status| serde_json::Value::String(status.phase.clone()));
        Some(word.and_then(|word| serde_json::from_value(word).ok()).unwrap_or(session.phase))
    }

    /// Begins a session, or goes on with one.
    pub fn start_recording(&mut self, request: StartRecording) {
        self.recording_busy = true;
        self.recording_problem = None;
        self.outbox.push(Request::StartRecording(request));
    }

    /// Does something with the step under way.
    pub fn act_on_recording(&mut self, action: RecordingAction) {
        self.recording_busy = true;
        self.recording_problem = None;
        self.outbox.push(Request::ActOnRecording(action));
    }

    /// Begins a take outside guided sessions.
    pub fn start_take(&mut self, request: StartTake) {
        self.free_take_busy = true;
        self.free_take_problem = None;
        self.outbox.push(Request::StartTake(request));
    }

    /// Does something with the take outside guided sessions.
    pub fn act_on_take(&mut self, action: TakeAction) {
        self.free_take_busy = true;
        self.free_take_problem = None;
        self.outbox.push(Request::ActOnTake(action));
    }

    /// Puts a take on the list of what is recorded next.
    pub fn want(&mut self, wanted: WantedTake) {
        self.wanted_busy = true;
        self.wanted_problem = None;
        self.outbox.push(Request::Want(wanted));
    }

    /// Takes it off again.
    pub fn unwant(&mut self, object: &str, primitive: &str) {
        self.wanted_busy = true;
        self.wanted_problem = None;
        self.outbox.push(Request::Unwant { object: object.to_owned(), primitive: primitive.to_owned() });
    }

    /// Has the live twin simulate with a saved model, or with the station's own (`nominal`); see
    /// [`Store::live_model`].
    pub fn set_live_model(&mut self, model: &str) {
        self.live_model = Loadable::Loading;
        self.outbox.push(Request::SetLiveModel(LiveModel { model: model.to_owned() }));
    }

    /// What the safety layer and the devices said last; `None` where nothing can be commanded.
    pub fn control_state(&self) -> Option<&ControlState> {
        self.live.as_ref()?.control.as_ref()
    }

    /// Whether there is a live station to look at.
    pub fn is_live(&self) -> bool {
        self.info.ready().is_some_and(|info| info.source != Source::Replay && info.station.is_some())
    }

    /// Whether there is a live station that may take commands: every one, until its first frame says otherwise.
    pub fn is_commandable(&self) -> bool {
        self.is_live() && self.live.as_ref().is_none_or(|frame| frame.control.is_some())
    }

    /// How far the safety layer is, as far as is known.
    pub fn phase(&self) -> Phase {
        self.control_state().map_or(Phase::Unspecified, ControlState::phase)
    }

    /// Whether motors may have torque: then the space bar stops them.
    pub fn is_armed(&self) -> bool {
        matches!(self.phase(), Phase::Arming | Phase::Armed | Phase::Holding | Phase::Disarming)
    }

    /// Since when what is shown of the live station is not live any more (time of day, and the page's clock), if it is
    /// not.
    pub fn frozen_since(&self, now_s: f64) -> Option<(&str, f64)> {
        self.live.as_ref()?;
        match &self.connection {
            Connection::Lost { since, since_s } => Some((since, *since_s)),
            _ if now_s - self.live_at_s > LIVE_FOR_S => Some((&self.live_at, self.live_at_s)),
            _ => None,
        }
    }

    /// A refusal leaves the checklist as it is.
    pub(super) fn receive_acted(&mut self, result: Result<Vec<u8>, String>) {
        self.recording_busy = false;
        match result {
            Ok(body) => self.receive_done(body),
            Err(problem) => self.recording_problem = Some(problem),
        }
    }

    /// What was done with a take outside guided sessions.
    pub(super) fn receive_free(&mut self, result: Result<Vec<u8>, String>) {
        self.free_take_busy = false;
        match result {
            Ok(body) => self.receive_done(body),
            Err(problem) => self.free_take_problem = Some(problem),
        }
    }

    /// A refusal leaves the list as it is.
    pub(super) fn receive_wanted(&mut self, result: Result<Vec<u8>, String>) {
        self.wanted_busy = false;
        match result {
            Ok(body) => self.receive_done(body),
            Err(problem) => self.wanted_problem = Some(problem),
        }
    }

    /// The checklist as it is after what was done.
    fn receive_done(&mut self, body: Vec<u8>) {
        self.receive_recording(parse_json(Ok(body)));
        self.recording_overtaken |= self.recording_asked;
    }

    /// The checklist that was asked for; asked for once more where it may be of before something was done.
    pub(super) fn receive_asked_recording(&mut self, recording: Loadable<RecordingDocument>) {
        self.recording_asked = false;
        if std::mem::take(&mut self.recording_overtaken) {
            return self.ask_recording();
        }
        self.receive_recording(recording);
    }

    fn ask_recording(&mut self) {
        self.recording_asked = true;
        self.recording_ended = false;
        self.outbox.push(Request::Recording);
    }

    /// Answers overtake each other: an older checklist never replaces a newer one of the same station.
    fn receive_recording(&mut self, recording: Loadable<RecordingDocument>) {
        let newest = self.streamed_revision;
        if let (Some(known), Some(new)) = (self.recording.ready(), recording.ready())
            && new.revision < known.revision
            && newest.is_some_and(|newest| newest >= known.revision)
        {
            return;
        }
        let before = self.recording.ready().map(|document| settled(document));
        if let (Some(before), Some(now)) = (before, recording.ready().and_then(settled))
            && before.as_ref() != Some(&now)
        {
            // A take outside guided sessions has come to its session, whoever recorded it.
            let (session, _) = now;
            self.details.remove(&session);
            self.checks.remove(&session);
            self.outbox.push(Request::Sessions);
        }
        self.recording = shared(recording);
    }

    /// What is known of the recorded session is asked for again when a screen wants it.
    pub(super) fn recorded_takes_changed(&mut self) {
        let Some(session) = self.recording.ready().and_then(|document| document.session.as_ref()) else {
            self.outbox.push(Request::Sessions);
            return;
        };
        self.details.remove(&session.session);
        self.checks.remove(&session.session);
        self.outbox.push(Request::Sessions);
    }

    /// The operator's time of day when the newest live frame came; empty before the first.
    pub fn live_at(&self) -> &str {
        &self.live_at
    }

    /// Takes in what the newest live frame says about commands and the recording.
    pub(super) fn follow_live(&mut self, now_s: f64, time_of_day: &str) {
        let Some(state) = self.live.as_ref().and_then(|frame| frame.control.as_ref()) else { return };
        self.control.follow(state, now_s);
        self.notice.follow(state, time_of_day);
        let newest = state.recording.as_ref().map(|status| status.revision);
        self.recording_ended |= newest.is_none() && self.streamed_revision.is_some();
        self.streamed_revision = newest;
        let Some(known) = self.recording.ready().map(|document| document.revision) else { return };
        if (self.recording_ended || newest.is_some_and(|newest| newest != known))
            && !self.recording_asked
            && !self.recording_busy
        {
            self.ask_recording();
        }
    }
}

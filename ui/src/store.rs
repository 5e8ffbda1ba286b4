//! Everything the server said, fetched when a screen first asks for it.
//!
//! Accessors take `&mut self`: asking for something that is not there yet queues a request and answers
//! [`Loadable::Loading`]. What is loaded is behind an `Arc`, so that a screen can keep it while it asks for more.

mod campaigns;
pub mod control;
mod curves;
mod docs;
mod jobs;
mod live;
pub mod notice;
pub mod people;
mod runs;
#[cfg(test)]
mod tests;
pub mod touch_history;
mod trash;

pub use curves::Curves;

use std::{collections::BTreeMap, sync::Arc};

use base64::Engine as _;
use palpate_reports::{CalibrationReport, CheckReport, DiagnosisReport};
use palpate_robot_model::{Station, StationFiles};
use palpate_wire::{
    api::{
        CalibrationRequest, CalibrationRun, DiagnosisRequest, DiagnosisRun, Info, JobState, Lineage,
        ModelSummary, ObjectEntry, PlanDocument, RecordingAction, RecordingDocument, SaveDiagnosisRequest,
        SaveModelRequest, SessionDetail, SessionSummary, StationDocument, TrashEntry,
    },
    proto::{Changed, LiveFrame, ReplayTrace, StreamMessage, TakeTrace, stream_message},
};
use prost::Message as _;

use self::{
    campaigns::CampaignTable, control::ControlLink, docs::DocTable, jobs::JobTable, notice::Notice,
    people::PeopleTable, runs::RunTable, touch_history::TouchHistory,
};

use crate::{
    api_client::{ApiEvent, Request},
    playback::ModelRef,
    take_data::TakeData,
};

/// Something that comes from the server.
#[derive(Clone, Debug, PartialEq, Default)]
pub enum Loadable<T> {
    /// Not asked for yet.
    #[default]
    Idle,
    /// On its way.
    Loading,
    /// Here.
    Ready(T),
    /// It will not come by itself: why, and what to do, for people.
    Failed(String),
}

impl<T> Loadable<T> {
    /// The value, if it is here.
    pub fn ready(&self) -> Option<&T> {
        match self {
            Self::Ready(value) => Some(value),
            _ => None,
        }
    }

    /// Why there is none, if it failed.
    pub fn error(&self) -> Option<&str> {
        match self {
            Self::Failed(error) => Some(error),
            _ => None,
        }
    }

    /// Whether it is on its way, or about to be.
    pub fn is_loading(&self) -> bool {
        matches!(self, Self::Idle | Self::Loading)
    }

    fn from_result(result: Result<T, String>) -> Self {
        match result {
            Ok(value) => Self::Ready(value),
            Err(error) => Self::Failed(error),
        }
    }
}

/// The stream socket.
#[derive(Clone, Debug, PartialEq, Default)]
pub enum Connection {
    /// Not open yet.
    #[default]
    Connecting,
    /// Live.
    Open,
    /// Gone: everything on the page is as of then.
    Lost {
        /// Local time of day when it broke, e.g. `14:03:12`.
        since: String,
        /// Seconds on the page's clock when it broke.
        since_s: f64,
    },
}

/// Ids of diagnoses begin with this.
const DIAGNOSIS_PREFIX: &str = "diagnosis-";
/// Ids of calibrations begin with this. Other kinds of jobs have other ids.
const CALIBRATION_PREFIX: &str = "run-";

type TakeKey = (String, String);

/// See the module.
#[derive(Debug, Default)]
pub struct Store {
    /// What the server is.
    pub info: Loadable<Info>,
    /// The stream socket.
    pub connection: Connection,
    /// Messages that the server dropped for this page because it read too slowly.
    pub dropped_messages: u64,
    /// A run that [`Store::start_run`] asked for: its id once the server took it.
    pub started_run: Loadable<String>,
    /// A diagnosis that [`Store::start_diagnosis`] asked for: its id once the server took it.
    pub started_diagnosis: Loadable<String>,
    /// A model that [`Store::save_diagnosis`] made or added to.
    pub added_to: Loadable<ModelSummary>,
    /// The model whose earlier version [`Store::undo_model`] brought back last.
    pub undone_model: Loadable<ModelSummary>,
    /// A model that [`Store::save_model`] asked for.
    pub saved_model: Loadable<ModelSummary>,
    /// A session that [`Store::import`] sent.
    pub imported: Loadable<SessionDetail>,
    /// The session that [`Store::delete_session`] moved to the trash last, so that it can be undone.
    pub deleted_session: Loadable<String>,
    /// The model that [`Store::delete_model`] moved to the trash last, so that it can be undone.
    pub deleted_model: Loadable<String>,
    /// The socket of commands and what it said.
    pub control: ControlLink,
    /// Why the station holds, stopped or disarmed, since when, and who had control then.
    pub notice: Notice,
    /// Why the last thing that was done in a recording did not work; `None` when all is well.
    pub recording_problem: Option<String>,
    /// Why the last thing that was done with a take outside guided sessions did not work; `None` when all is well.
    pub free_take_problem: Option<String>,
    /// Something was done with such a take, and the server has not answered yet.
    pub free_take_busy: bool,
    /// Why the list of what is recorded next could not be changed; `None` when all is well.
    pub wanted_problem: Option<String>,
    /// The list of what is recorded next is being changed.
    pub wanted_busy: bool,
    /// The model that [`Store::set_live_model`] asked for: its id once the live twin has it.
    pub live_model: Loadable<String>,
    /// Campaigns.
    pub campaigns: CampaignTable,
    /// Jobs of every kind.
    pub jobs: JobTable,
    /// The manual.
    pub docs: DocTable,
    /// People, tokens, storage and the audit log.
    pub people: PeopleTable,
    /// What the live station and its twin felt in the last seconds.
    pub touch_history: TouchHistory,
    /// Something was done in a recording, and the server has not answered yet.
    pub recording_busy: bool,
    recording: Loadable<Arc<RecordingDocument>>,
    /// A newer checklist is on its way.
    recording_asked: bool,
    /// What was done since it was asked for has been answered already, so that it may be older than what is known.
    recording_overtaken: bool,
    /// The station has stopped streaming a recording, and the checklist was not asked for since.
    recording_ended: bool,
    /// Revision of the checklist as the station streamed it last.
    streamed_revision: Option<u64>,
    /// When the newest live frame came: on the page's clock and the operator's.
    live_at_s: f64,
    live_at: String,
    sessions: Loadable<Arc<Vec<SessionSummary>>>,
    details: BTreeMap<String, Loadable<Arc<SessionDetail>>>,
    stations: BTreeMap<String, Loadable<Arc<Station>>>,
    live_station: Loadable<Arc<Station>>,
    checks: BTreeMap<String, Loadable<Arc<CheckReport>>>,
    takes: BTreeMap<TakeKey, Loadable<Arc<TakeData>>>,
    replays: BTreeMap<(TakeKey, ModelRef), Loadable<Arc<ReplayTrace>>>,
    models: Loadable<Arc<Vec<ModelSummary>>>,
    objects: Loadable<Arc<Vec<ObjectEntry>>>,
    plans: Loadable<Arc<Vec<PlanDocument>>>,
    lineage: Loadable<Arc<Lineage>>,
    trash: Loadable<Arc<Vec<TrashEntry>>>,
    calibrations: RunTable<CalibrationRequest, CalibrationReport>,
    diagnoses: RunTable<DiagnosisRequest, DiagnosisReport>,
    live: Option<LiveFrame>,
    outbox: Vec<Request>,
}

impl Store {
    /// All sessions.
    pub fn sessions(&mut self) -> Loadable<Arc<Vec<SessionSummary>>> {
        ask(&mut self.sessions, &mut self.outbox, || Request::Sessions)
    }

    /// One session with its takes.
    pub fn session(&mut self, session: &str) -> Loadable<Arc<SessionDetail>> {
        let slot = self.details.entry(session.to_owned()).or_default();
        ask(slot, &mut self.outbox, || Request::Session(session.to_owned()))
    }

    /// The station of a session.
    pub fn station(&mut self, session: &str) -> Loadable<Arc<Station>> {
        let slot = self.stations.entry(session.to_owned()).or_default();
        ask(slot, &mut self.outbox, || Request::Station(session.to_owned()))
    }

    /// The live station.
    pub fn live_station(&mut self) -> Loadable<Arc<Station>> {
        ask(&mut self.live_station, &mut self.outbox, || Request::LiveStation)
    }

    /// Check results of a session.
    pub fn check(&mut self, session: &str) -> Loadable<Arc<CheckReport>> {
        let slot = self.checks.entry(session.to_owned()).or_default();
        ask(slot, &mut self.outbox, || Request::Check(session.to_owned()))
    }

    /// A recorded take.
    pub fn take(&mut self, session: &str, take: &str) -> Loadable<Arc<TakeData>> {
        let slot = self.takes.entry((session.to_owned(), take.to_owned())).or_default();
        ask(slot, &mut self.outbox, || Request::Take { session: session.to_owned(), take: take.to_owned() })
    }

    /// A take as `model` replays it.
    pub fn replay(&mut self, session: &str, take: &str, model: &ModelRef) -> Loadable<Arc<ReplayTrace>> {
        let key = ((session.to_owned(), take.to_owned()), model.clone());
        let slot = self.replays.entry(key).or_default();
        ask(slot, &mut self.outbox, || Request::Replay {
            session: session.to_owned(),
            take: take.to_owned(),
            model: model.clone(),
        })
    }

    /// Saved sensor models.
    pub fn models(&mut self) -> Loadable<Arc<Vec<ModelSummary>>> {
        ask(&mut self.models, &mut self.outbox, || Request::Models)
    }

    /// What is touched and grasped.
    pub fn objects(&mut self) -> Loadable<Arc<Vec<ObjectEntry>>> {
        ask(&mut self.objects, &mut self.outbox, || Request::Objects)
    }

    /// Plans of the live station, with their takes.
    pub fn plans(&mut self) -> Loadable<Arc<Vec<PlanDocument>>> {
        ask(&mut self.plans, &mut self.outbox, || Request::Plans)
    }

    /// What was made from what.
    pub fn lineage(&mut self) -> Loadable<Arc<Lineage>> {
        ask(&mut self.lineage, &mut self.outbox, || Request::Lineage)
    }

    /// Asks for the objects again, as their files may have changed.
    pub fn ask_objects_again(&mut self) {
        self.objects = Loadable::Idle;
    }

    /// How the simulation in blue is called: what a run found by the run, a saved model by its name.
    pub fn compared_label(&mut self, model: Option<&ModelRef>) -> String {
        match model {
            None | Some(ModelRef::Nominal) => "nominal only".to_owned(),
            Some(ModelRef::Run(id) | ModelRef::Calibrated(id)) => format!("calibrated ({id})"),
            Some(ModelRef::Diagnosis(id)) => format!("diagnosed ({id})"),
            Some(ModelRef::Saved(id)) => {
                let models = self.models();
                let known = models.ready().and_then(|models| models.iter().find(|known| known.id == *id));
                let what = match known {
                    Some(known) if !known.effects.is_empty() => "diagnosed",
                    _ => "calibrated",
                };
                format!("{what} ({})", known.map_or(id, |known| &known.name))
            }
        }
    }

    /// Calibration runs, newest first, with live progress but without reports.
    pub fn runs(&mut self) -> Loadable<Arc<Vec<CalibrationRun>>> {
        self.calibrations.list(&mut self.outbox, Request::Runs)
    }

    /// One calibration run, with live progress, and with its report once it is done.
    pub fn run(&mut self, run: &str) -> Loadable<Arc<CalibrationRun>> {
        self.calibrations.detail(run, &mut self.outbox, || Request::Run(run.to_owned()))
    }

    /// Diagnoses, newest first, with live progress but without reports.
    pub fn diagnoses(&mut self) -> Loadable<Arc<Vec<DiagnosisRun>>> {
        self.diagnoses.list(&mut self.outbox, Request::Diagnoses)
    }

    /// One diagnosis, with live progress, and with its report once it is done.
    pub fn diagnosis(&mut self, run: &str) -> Loadable<Arc<DiagnosisRun>> {
        self.diagnoses.detail(run, &mut self.outbox, || Request::Diagnosis(run.to_owned()))
    }

    /// The newest frame of the live station. It stays when the connection breaks: see [`Store::connection`].
    pub fn live_frame(&self) -> Option<&LiveFrame> {
        self.live.as_ref()
    }

    /// Starts a calibration; see [`Store::started_run`].
    pub fn start_run(&mut self, request: CalibrationRequest) {
        self.started_run = Loadable::Loading;
        self.outbox.push(Request::StartRun(request));
    }

    /// Stops a calibration; what it found so far stays.
    pub fn cancel_run(&mut self, run: &str) {
        self.outbox.push(Request::CancelRun(run.to_owned()));
    }

    /// Keeps what a calibration found; see [`Store::saved_model`].
    pub fn save_model(&mut self, run: &str, name: &str) {
        self.saved_model = Loadable::Loading;
        self.outbox.push(Request::SaveModel {
            run: run.to_owned(),
            body: SaveModelRequest { name: name.to_owned() },
        });
    }

    /// Starts a diagnosis; see [`Store::started_diagnosis`].
    pub fn start_diagnosis(&mut self, request: DiagnosisRequest) {
        self.started_diagnosis = Loadable::Loading;
        self.outbox.push(Request::StartDiagnosis(request));
    }

    /// Stops a diagnosis.
    pub fn cancel_diagnosis(&mut self, run: &str) {
        self.outbox.push(Request::CancelDiagnosis(run.to_owned()));
    }

    /// Adds what a diagnosis named to a model, or makes one of it; see [`Store::added_to`].
    pub fn save_diagnosis(&mut self, run: &str, body: SaveDiagnosisRequest) {
        self.added_to = Loadable::Loading;
        self.outbox.push(Request::SaveDiagnosis { run: run.to_owned(), body });
    }

    /// Brings the version of a saved model back that was there before the last addition; see [`Store::undone_model`].
    pub fn undo_model(&mut self, model: &str) {
        self.undone_model = Loadable::Loading;
        self.outbox.push(Request::UndoModel(model.to_owned()));
    }

    /// Sends a session as an archive; see [`Store::imported`].
    pub fn import(&mut self, name: &str, archive: Vec<u8>) {
        self.imported = Loadable::Loading;
        self.outbox.push(Request::Import { name: name.to_owned(), archive });
    }

    /// Asks again for everything that failed.
    pub fn retry_failed(&mut self) {
        reset(&mut self.info);
        reset(&mut self.sessions);
        reset(&mut self.live_station);
        reset(&mut self.recording);
        reset(&mut self.models);
        reset(&mut self.objects);
        reset(&mut self.plans);
        reset(&mut self.lineage);
        reset(&mut self.trash);
        self.campaigns.retry_failed();
        self.jobs.retry_failed();
        self.people.retry_failed();
        self.docs.retry_failed();
        self.calibrations.retry_failed();
        self.diagnoses.retry_failed();
        self.details.values_mut().for_each(reset);
        self.stations.values_mut().for_each(reset);
        self.checks.values_mut().for_each(reset);
        self.takes.values_mut().for_each(reset);
        self.replays.values_mut().for_each(reset);
        self.ask_info();
    }

    /// Asks what the server is, unless that is known or on its way.
    pub fn ask_info(&mut self) {
        ask(&mut self.info, &mut self.outbox, || Request::Info);
    }

    /// Requests that wait to be sent.
    pub fn take_outbox(&mut self) -> Vec<Request> {
        let mut outbox = std::mem::take(&mut self.outbox);
        outbox.extend(self.campaigns.take_outbox());
        outbox.extend(self.jobs.take_outbox());
        outbox.extend(self.people.take_outbox());
        outbox.extend(self.docs.take_outbox());
        outbox
    }

    /// Takes in what the server sent. `now_s` is the page's clock, `time_of_day` the operator's.
    pub fn receive(&mut self, event: ApiEvent, now_s: f64, time_of_day: &str) {
        match event {
            ApiEvent::Answer { request, result } => self.receive_answer(request, result),
            ApiEvent::SocketOpen => {
                if matches!(self.connection, Connection::Lost { .. }) {
                    self.refresh_after_loss();
                }
                self.connection = Connection::Open;
            }
            ApiEvent::SocketClosed => {
                if !matches!(self.connection, Connection::Lost { .. }) {
                    self.connection = Connection::Lost { since: time_of_day.to_owned(), since_s: now_s };
                }
            }
            ApiEvent::SocketMessage(bytes) => self.receive_message(&bytes, now_s, time_of_day),
            ApiEvent::ControlOpen => self.control.opened(),
            ApiEvent::ControlClosed => self.control.closed(now_s, time_of_day),
            ApiEvent::ControlMessage(bytes) => self.control.receive(&bytes, time_of_day),
            ApiEvent::StopSent(sequence) => self.control.stop_left(sequence),
        }
    }

    /// What may have changed while nobody listened. The old values stay on the page until the new ones are here.
    fn refresh_after_loss(&mut self) {
        self.retry_failed();
        self.campaigns.changed("", &self.control.operator);
        self.jobs.refresh();
        if self.recording.ready().is_some() {
            self.recording_asked = true;
            self.outbox.push(Request::Recording);
        }
        self.outbox.extend([
            Request::Info,
            Request::Sessions,
            Request::Models,
            Request::Runs,
            Request::Diagnoses,
        ]);
    }

    fn receive_answer(&mut self, request: Request, result: Result<Vec<u8>, String>) {
        match request {
            Request::Info => self.info = parse_json(result),
            Request::Sessions => self.sessions = shared(parse_json(result)),
            Request::Session(session) => {
                self.details.insert(session, shared(parse_json(result)));
            }
            Request::Station(session) => {
                self.stations.insert(session, parse_station(result));
            }
            Request::Plans => self.plans = shared(parse_json(result)),
            Request::LiveStation => self.live_station = parse_station(result),
            Request::Check(session) => {
                self.checks.insert(session, shared(parse_json(result)));
            }
            Request::Take { session, take } => {
                let parsed = parse_proto::<TakeTrace>(result).and_then(TakeData::new);
                self.takes.insert((session, take), shared(Loadable::from_result(parsed)));
            }
            Request::Replay { session, take, model } => {
                let parsed = Loadable::from_result(parse_proto::<ReplayTrace>(result));
                self.replays.insert(((session, take), model), shared(parsed));
            }
            Request::Models => self.models = shared(parse_json(result)),
            Request::Objects => self.objects = shared(parse_json(result)),
            Request::Lineage => self.lineage = shared(parse_json(result)),
            Request::Runs => self.calibrations.receive_list(result),
            Request::Run(id) => self.calibrations.receive_detail(id, result),
            Request::Diagnoses => self.diagnoses.receive_list(result),
            Request::Diagnosis(id) => self.diagnoses.receive_detail(id, result),
            Request::Campaigns => self.campaigns.receive_list(result),
            Request::Campaign { campaign, as_scorer, .. } => {
                self.campaigns.receive_campaign((campaign, as_scorer), result);
            }
            Request::CampaignResults(id) => self.campaigns.receive_results(id, result),
            Request::MakeCampaign(_) => self.campaigns.receive_made(result),
            Request::ActOnCampaign { campaign, as_scorer, .. } => {
                self.campaigns.receive_acted(campaign, as_scorer, result);
            }
            Request::Jobs(cursor) => self.jobs.receive_list(cursor, result),
            Request::Job(_) => self.jobs.receive_job(result),
            Request::JobLog(id) => self.jobs.receive_log(id, result),
            Request::JobMetrics(id) => self.jobs.receive_metrics(id, result),
            Request::ComparisonReport(id) => self.jobs.receive_comparison(id, result),
            Request::Kinds => self.jobs.receive_kinds(result),
            Request::Docs => self.docs.receive_list(result),
            Request::Doc(name) => self.docs.receive_text(name, result),
            Request::SubmitJob(_) => self.jobs.receive_submitted(result),
            Request::ActOnJob { job, act } => self.jobs.receive_acted(job, act, result),
            request @ (Request::Me
            | Request::People
            | Request::AddPerson(_)
            | Request::ChangePerson { .. }
            | Request::RemovePerson(_)
            | Request::Tokens
            | Request::CreateToken(_)
            | Request::RevokeToken(_)
            | Request::Audit
            | Request::Metrics) => {
                self.people.receive(&request, result);
                // The server calls whoever logged in by that name, whatever this browser remembers of others.
                if let Some(name) = self.people.login() {
                    name.clone_into(&mut self.control.operator);
                }
            }
            // Whether it could be stopped or not: where the run stands now is what matters.
            Request::CancelRun(run) => self.outbox.push(Request::Run(run)),
            Request::CancelDiagnosis(run) => self.outbox.push(Request::Diagnosis(run)),
            Request::DeleteSession(_)
            | Request::RestoreSession(_)
            | Request::DeleteModel(_)
            | Request::RestoreModel(_)
            | Request::Trash => self.receive_trash(request, result),
            Request::StartRun(_) => self.started_run = self.calibrations.receive_started(result),
            Request::StartDiagnosis(_) => self.started_diagnosis = self.diagnoses.receive_started(result),
            Request::SaveDiagnosis { .. } => {
                self.added_to = parse_json(result);
                self.undone_model = Loadable::Idle;
                self.models_changed();
            }
            Request::UndoModel(_) => {
                self.undone_model = parse_json(result);
                self.added_to = Loadable::Idle;
                self.models_changed();
            }
            Request::SaveModel { run, .. } => {
                self.saved_model = parse_json(result);
                self.outbox.extend([Request::Models, Request::Run(run)]);
            }
            Request::Import { .. } => {
                self.imported = parse_json(result);
                self.outbox.push(Request::Sessions);
            }
            Request::Want(_) | Request::Unwant { .. } => self.receive_wanted(result),
            Request::SetLiveModel(body) => {
                self.live_model = Loadable::from_result(result.map(|_| body.model));
            }
            Request::Recording => self.receive_asked_recording(parse_json(result)),
            Request::StartRecording(_) => self.receive_acted(result),
            Request::StartTake(_) | Request::ActOnTake(_) => self.receive_free(result),
            Request::ActOnRecording(action) => {
                self.receive_acted(result);
                let changes_takes = !matches!(
                    action,
                    RecordingAction::Note { .. } | RecordingAction::Select { .. } | RecordingAction::Cancel
                );
                if changes_takes {
                    self.recorded_takes_changed();
                }
            }
        }
    }

    fn receive_message(&mut self, bytes: &[u8], now_s: f64, time_of_day: &str) {
        // A message that does not decode comes from a newer server; the next one may be known again.
        let Ok(message) = StreamMessage::decode(bytes) else { return };
        self.dropped_messages = message.dropped;
        match message.message {
            Some(stream_message::Message::Live(frame)) => {
                self.live_at_s = now_s;
                time_of_day.clone_into(&mut self.live_at);
                self.touch_history.take_in(&frame);
                self.live = Some(frame);
                self.follow_live(now_s, time_of_day);
            }
            Some(stream_message::Message::Job(update)) => {
                let Some(state) = job_state(&update.state) else { return };
                self.jobs.update(state, &update);
                if state == JobState::Done {
                    self.lineage_changed();
                }
                if update.job.starts_with(DIAGNOSIS_PREFIX) {
                    if self.diagnoses.update(state, &update) {
                        self.outbox.push(Request::Diagnosis(update.job));
                    }
                } else if update.job.starts_with(CALIBRATION_PREFIX)
                    && self.calibrations.update(state, &update)
                {
                    self.outbox.push(Request::Run(update.job));
                }
            }
            Some(stream_message::Message::Changed(changed)) => self.receive_changed(&changed),
            None => {}
        }
    }

    /// Somebody, perhaps on another page, changed what a list shows.
    fn receive_changed(&mut self, changed: &Changed) {
        self.lineage_changed();
        self.trash_changed();
        match changed.list.as_str() {
            "sessions" if self.sessions.ready().is_some() => {
                self.details.remove(&changed.id);
                self.checks.remove(&changed.id);
                self.outbox.push(Request::Sessions);
            }
            "models" if self.models.ready().is_some() => self.models_changed(),
            "campaigns" => self.campaigns.changed(&changed.id, &self.control.operator),
            _ => {}
        }
    }

    /// The old one stays on the page until the new one is here.
    fn lineage_changed(&mut self) {
        if self.lineage.ready().is_some() {
            self.outbox.push(Request::Lineage);
        }
    }

    /// What depends on saved models is asked for again: an id may mean another file now.
    fn models_changed(&mut self) {
        self.replays.retain(|(_, model), _| !matches!(model, ModelRef::Saved(_)));
        self.outbox.extend([Request::Models, Request::Diagnoses]);
        self.outbox.extend(self.diagnoses.opened().map(|id| Request::Diagnosis(id.clone())));
    }
}

/// What failed is asked for again when a screen wants it.
fn reset<T>(slot: &mut Loadable<T>) {
    if matches!(slot, Loadable::Failed(_)) {
        *slot = Loadable::Idle;
    }
}

fn ask<T: Clone>(
    slot: &mut Loadable<T>,
    outbox: &mut Vec<Request>,
    request: impl FnOnce() -> Request,
) -> Loadable<T> {
    if matches!(slot, Loadable::Idle) {
        *slot = Loadable::Loading;
        outbox.push(request());
    }
    slot.clone()
}

fn shared<T>(loaded: Loadable<T>) -> Loadable<Arc<T>> {
    match loaded {
        Loadable::Idle => Loadable::Idle,
        Loadable::Loading => Loadable::Loading,
        Loadable::Ready(value) => Loadable::Ready(Arc::new(value)),
        Loadable::Failed(error) => Loadable::Failed(error),
    }
}

fn parse_json<T: serde::de::DeserializeOwned>(result: Result<Vec<u8>, String>) -> Loadable<T> {
    Loadable::from_result(result.and_then(|bytes| {
        serde_json::from_slice(&bytes)
            .map_err(|err| format!("the server's answer could not be read: {err}; reload the page"))
    }))
}

fn parse_proto<T: prost::Message + Default>(result: Result<Vec<u8>, String>) -> Result<T, String> {
    result.and_then(|bytes| {
        T::decode(bytes.as_slice())
            .map_err(|err| format!("the server's answer could not be read: {err}; reload the page"))
    })
}

fn parse_station(result: Result<Vec<u8>, String>) -> Loadable<Arc<Station>> {
    let document = match parse_json::<StationDocument>(result) {
        Loadable::Ready(document) => document,
        Loadable::Failed(error) => return Loadable::Failed(error),
        Loadable::Idle | Loadable::Loading => return Loadable::Loading,
    };
    let files = document
        .files_base64
        .into_iter()
        .map(|(path, text)| {
            base64::engine::general_purpose::STANDARD
                .decode(text)
                .map(|bytes| (path.clone(), bytes))
                .map_err(|err| format!("station file {path:?} arrived damaged: {err}"))
        })
        .collect::<Result<BTreeMap<_, _>, _>>();
    let station = files.and_then(|files| {
        Station::from_files(StationFiles { station_toml: document.station_toml, files })
            .map_err(|err| err.to_string())
    });
    shared(Loadable::from_result(station))
}

fn job_state(word: &str) -> Option<JobState> {
    match word {
        "queued" => Some(JobState::Queued),
        "running" => Some(JobState::Running),
        "done" => Some(JobState::Done),
        "failed" => Some(JobState::Failed),
        "cancelled" => Some(JobState::Cancelled),
        _ => None,
    }
}

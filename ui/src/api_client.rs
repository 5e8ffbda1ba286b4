//! How the page talks to the server: requests go out, answers come in later and land in the [`crate::store::Store`].
//!
//! [`Api`] is what the page needs from the outside; the browser's own `fetch` and `WebSocket` implement it on the web,
//! [`FakeApi`] in tests.

use std::{
    collections::{BTreeMap, VecDeque},
    time::Duration,
};

use palpate_wire::{
    api::{
        CalibrationRequest, CampaignPlan, DiagnosisRequest, JobChanges, JobRequest, LiveModel, NewPerson,
        NewToken, PersonChanges, ProblemDetails, RecordingAction, SaveDiagnosisRequest, SaveModelRequest,
        ScoreBack, ScoreRequest, StartRecording, StartTake, TakeAction, TrialEnd, WantedTake,
    },
    proto::{ControlRequest, control_request},
};

use crate::playback::ModelRef;

/// Something to ask of the server.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// Name, version, live station.
    Info,
    /// All sessions.
    Sessions,
    /// One session with its takes.
    Session(String),
    /// The station of a session.
    Station(String),
    /// The live station.
    LiveStation,
    /// Plans of the live station, with their takes.
    Plans,
    /// Check results of a session.
    Check(String),
    /// A recorded take.
    Take {
        /// Session id.
        session: String,
        /// Take id.
        take: String,
    },
    /// A take as a sensor model replays it.
    Replay {
        /// Session id.
        session: String,
        /// Take id.
        take: String,
        /// Which model.
        model: ModelRef,
    },
    /// Saved sensor models.
    Models,
    /// What was made from what.
    Lineage,
    /// Objects.
    Objects,
    /// Calibration runs, newest first.
    Runs,
    /// One calibration run.
    Run(String),
    /// Start a calibration.
    StartRun(CalibrationRequest),
    /// Stop a calibration.
    CancelRun(String),
    /// Keep what a calibration found.
    SaveModel {
        /// Run id.
        run: String,
        /// How to call it.
        body: SaveModelRequest,
    },
    /// Diagnoses, newest first.
    Diagnoses,
    /// One diagnosis.
    Diagnosis(String),
    /// Start a diagnosis.
    StartDiagnosis(DiagnosisRequest),
    /// Stop a diagnosis.
    CancelDiagnosis(String),
    /// Keep what a diagnosis named.
    SaveDiagnosis {
        /// Id of the diagnosis.
        run: String,
        /// Which effects, and where.
        body: SaveDiagnosisRequest,
    },
    /// Bring the earlier version of a saved model back.
    UndoModel(String),
    /// Move a session to the trash.
    DeleteSession(String),
    /// Take a session out of the trash.
    RestoreSession(String),
    /// What is in the trash.
    Trash,
    /// Move a saved model to the trash.
    DeleteModel(String),
    /// Take a saved model out of the trash.
    RestoreModel(String),
    /// Add a session from an archive.
    Import {
        /// Name of the session to make.
        name: String,
        /// The archive's bytes.
        archive: Vec<u8>,
    },
    /// The checklist of the session that is being recorded.
    Recording,
    /// Begin a session, or go on with one.
    StartRecording(StartRecording),
    /// Do something with the step under way.
    ActOnRecording(RecordingAction),
    /// Begin a take outside guided sessions.
    StartTake(StartTake),
    /// Do something with that take.
    ActOnTake(TakeAction),
    /// Put a take on the list of what is recorded next.
    Want(WantedTake),
    /// Take it off again.
    Unwant {
        /// Object id.
        object: String,
        /// Primitive id.
        primitive: String,
    },
    /// Choose what the live twin simulates with.
    SetLiveModel(LiveModel),
    /// Campaigns, newest first.
    Campaigns,
    /// One campaign.
    Campaign {
        /// Id of the campaign.
        campaign: String,
        /// Who looks.
        scorer: String,
        /// They score, and are told no more than scorers are.
        as_scorer: bool,
    },
    /// What the verdicts of a campaign say.
    CampaignResults(String),
    /// Make a campaign.
    MakeCampaign(CampaignPlan),
    /// Do something in a campaign.
    ActOnCampaign {
        /// Id of the campaign.
        campaign: String,
        /// The answer tells no more than scorers are told.
        as_scorer: bool,
        /// What.
        act: CampaignAct,
    },
    /// Jobs, newest first: from the beginning, or from where a page of them ended.
    Jobs(Option<String>),
    /// One job.
    Job(String),
    /// What a job's process printed.
    JobLog(String),
    /// The curves of a job.
    JobMetrics(String),
    /// What a job of kind `comparison` found.
    ComparisonReport(String),
    /// The kinds of jobs, and which of them the studio can do.
    Kinds,
    /// Start a job of any kind.
    SubmitJob(JobRequest),
    /// Do something with a job.
    ActOnJob {
        /// Id of the job.
        job: String,
        /// What.
        act: JobAct,
    },
    /// The documents of the manual.
    Docs,
    /// The Markdown of one of them.
    Doc(String),
    /// Who asks, and what they may.
    Me,
    /// People who may log in.
    People,
    /// Add somebody.
    AddPerson(NewPerson),
    /// Change somebody's role or password.
    ChangePerson {
        /// Their name.
        person: String,
        /// What is different.
        changes: PersonChanges,
    },
    /// Remove somebody, with their logins and tokens.
    RemovePerson(String),
    /// API tokens that this page may see.
    Tokens,
    /// Make an API token.
    CreateToken(NewToken),
    /// End an API token.
    RevokeToken(u64),
    /// The newest lines of the audit log.
    Audit,
    /// Numbers of the studio, among them the room on the disk.
    Metrics,
}

/// What can be done in a campaign.
#[derive(Clone, Debug, PartialEq)]
pub enum CampaignAct {
    /// The object of a trial is placed.
    Begin(u32),
    /// A trial has ended.
    End(u32, TrialEnd),
    /// Give a verdict.
    Score(u32, ScoreRequest),
    /// Take it back.
    Unscore(u32, ScoreBack),
    /// Decide where scorers differ.
    Settle(u32, ScoreRequest),
    /// No trial begins until somebody goes on.
    Pause,
    /// Go on after a break.
    Resume,
    /// No more trials.
    Close,
    /// Trials go on.
    Reopen,
}

/// What can be done with a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JobAct {
    /// Ask it to stop.
    Cancel,
    /// Queue it once more.
    Retry,
    /// Ask for the same again.
    Clone,
    /// Move it to the trash.
    Delete,
}

/// A request as HTTP.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HttpRequest {
    /// `GET`, `POST`, `PUT`, `PATCH` or `DELETE`.
    pub method: &'static str,
    /// Path and query, from the server's root.
    pub path: String,
    /// Content type and bytes, for requests that carry some.
    pub body: Option<(&'static str, Vec<u8>)>,
    /// Value of the header [`LEASE_HEADER`](palpate_wire::api::LEASE_HEADER), on requests that only the operator may make.
    pub lease: Option<u64>,
}

impl HttpRequest {
    /// Method and path, e.g. `GET /api/v1/info`.
    pub fn name(&self) -> String {
        format!("{} {}", self.method, self.path)
    }
}

impl Request {
    /// Whether only the operator may make it, at least while somebody has control.
    pub fn needs_lease(&self) -> bool {
        matches!(
            self,
            Self::StartRecording(_)
                | Self::ActOnRecording(_)
                | Self::StartTake(_)
                | Self::ActOnTake(_)
                | Self::Want(_)
                | Self::Unwant { .. }
        )
    }

    /// The request as HTTP. `lease` is that of the page, 0 for none: only requests that need it carry it, because it is a
    /// secret.
    pub fn to_http(&self, lease: u64) -> HttpRequest {
        let lease = Some(lease).filter(|&lease| lease != 0 && self.needs_lease());
        let http =
            |method, path: String, body| HttpRequest { method, path: format!("/api/v1{path}"), body, lease };
        let get = |path: String| http("GET", path, None);
        let post = |path: String, body| http("POST", path, body);
        let delete = |path: String| http("DELETE", path, None);
        match self {
            Self::Info => get("/info".into()),
            Self::Sessions => get("/sessions".into()),
            Self::Session(session) => get(format!("/sessions/{}", segment(session))),
            Self::Station(session) => get(format!("/sessions/{}/station", segment(session))),
            Self::LiveStation => get("/station".into()),
            Self::Plans => get("/recording/plans".into()),
            Self::Check(session) => get(format!("/sessions/{}/check", segment(session))),
            Self::Take { session, take } => {
                get(format!("/sessions/{}/takes/{}/trace", segment(session), segment(take)))
            }
            Self::Replay { session, take, model } => get(format!(
                "/sessions/{}/takes/{}/replay?model={}",
                segment(session),
                segment(take),
                segment(&model.key())
            )),
            Self::Models => get("/models".into()),
            Self::Lineage => get("/lineage".into()),
            Self::Objects => get("/objects".into()),
            Self::Runs => get("/calibrations".into()),
            Self::Run(run) => get(format!("/calibrations/{}", segment(run))),
            Self::StartRun(body) => post("/calibrations".into(), json(body)),
            Self::CancelRun(run) => post(format!("/calibrations/{}/cancel", segment(run)), None),
            Self::SaveModel { run, body } => post(format!("/calibrations/{}/save", segment(run)), json(body)),
            Self::Diagnoses => get("/diagnoses".into()),
            Self::Diagnosis(run) => get(format!("/diagnoses/{}", segment(run))),
            Self::StartDiagnosis(body) => post("/diagnoses".into(), json(body)),
            Self::CancelDiagnosis(run) => post(format!("/diagnoses/{}/cancel", segment(run)), None),
            Self::SaveDiagnosis { run, body } => {
                post(format!("/diagnoses/{}/save", segment(run)), json(body))
            }
            Self::UndoModel(model) => post(format!("/models/{}/undo", segment(model)), None),
            Self::DeleteSession(session) => delete(format!("/sessions/{}", segment(session))),
            Self::RestoreSession(session) => post(format!("/sessions/{}/restore", segment(session)), None),
            Self::Trash => get("/trash".into()),
            Self::DeleteModel(model) => delete(format!("/models/{}", segment(model))),
            Self::RestoreModel(model) => post(format!("/models/{}/restore", segment(model)), None),
            Self::Import { name, archive } => {
                post(format!("/sessions?name={}", segment(name)), Some(("application/zip", archive.clone())))
            }
            Self::Recording => get("/recording".into()),
            Self::StartRecording(body) => post("/recording".into(), json(body)),
            Self::ActOnRecording(body) => post("/recording/act".into(), json(body)),
            Self::StartTake(body) => post("/recording/take".into(), json(body)),
            Self::ActOnTake(body) => post("/recording/take/act".into(), json(body)),
            Self::Want(body) => post("/recording/wanted".into(), json(body)),
            Self::Unwant { object, primitive } => {
                delete(format!("/recording/wanted/{}/{}", segment(object), segment(primitive)))
            }
            Self::SetLiveModel(body) => http("PUT", "/live/model".into(), json(body)),
            Self::Campaigns => get("/campaigns".into()),
            Self::Campaign { campaign, scorer, as_scorer } => get(format!(
                "/campaigns/{}?scorer={}&as_scorer={as_scorer}",
                segment(campaign),
                segment(scorer)
            )),
            Self::CampaignResults(campaign) => get(format!("/campaigns/{}/results", segment(campaign))),
            Self::MakeCampaign(plan) => post("/campaigns".into(), json(plan)),
            Self::ActOnCampaign { campaign, as_scorer, act } => {
                let campaign = format!("/campaigns/{}", segment(campaign));
                let trial = |trial: &u32, what: &str| {
                    // Only scores tell how much whoever gave them may know.
                    let view = if what.ends_with("score") {
                        format!("?as_scorer={as_scorer}")
                    } else {
                        String::new()
                    };
                    format!("{campaign}/trials/{trial}/{what}{view}")
                };
                match act {
                    CampaignAct::Begin(number) => post(trial(number, "begin"), None),
                    CampaignAct::End(number, body) => post(trial(number, "outcome"), json(body)),
                    CampaignAct::Score(number, body) => post(trial(number, "score"), json(body)),
                    CampaignAct::Unscore(number, body) => post(trial(number, "unscore"), json(body)),
                    CampaignAct::Settle(number, body) => post(trial(number, "settle"), json(body)),
                    CampaignAct::Pause => post(format!("{campaign}/pause"), None),
                    CampaignAct::Resume => post(format!("{campaign}/resume"), None),
                    CampaignAct::Close => post(format!("{campaign}/close"), None),
                    CampaignAct::Reopen => post(format!("{campaign}/reopen"), None),
                }
            }
            Self::Jobs(None) => get("/jobs".into()),
            Self::Jobs(Some(cursor)) => get(format!("/jobs?cursor={}", segment(cursor))),
            Self::Job(job) => get(format!("/jobs/{}", segment(job))),
            Self::JobLog(job) => get(format!("/jobs/{}/log", segment(job))),
            Self::JobMetrics(job) => get(format!("/jobs/{}/metrics", segment(job))),
            Self::ComparisonReport(job) => get(format!("/jobs/{}/files/report.json", segment(job))),
            Self::Kinds => get("/kinds".into()),
            Self::SubmitJob(body) => post("/jobs".into(), json(body)),
            Self::ActOnJob { job, act } => {
                let path = format!("/jobs/{}", segment(job));
                match act {
                    JobAct::Cancel => post(format!("{path}/cancel"), None),
                    JobAct::Retry => post(format!("{path}/retry"), None),
                    // Nothing is different.
                    JobAct::Clone => post(format!("{path}/clone"), json(&JobChanges::default())),
                    JobAct::Delete => delete(path),
                }
            }
            Self::Docs => get("/docs".into()),
            Self::Doc(name) => get(format!("/docs/{}", segment(name))),
            Self::Me => get("/me".into()),
            Self::People => get("/people".into()),
            Self::AddPerson(body) => post("/people".into(), json(body)),
            Self::ChangePerson { person, changes } => {
                http("PATCH", format!("/people/{}", segment(person)), json(changes))
            }
            Self::RemovePerson(person) => delete(format!("/people/{}", segment(person))),
            Self::Tokens => get("/tokens".into()),
            Self::CreateToken(body) => post("/tokens".into(), json(body)),
            Self::RevokeToken(id) => delete(format!("/tokens/{id}")),
            Self::Audit => get("/audit".into()),
            // Outside of the API's own paths.
            Self::Metrics => HttpRequest { method: "GET", path: "/metrics".into(), body: None, lease },
        }
    }
}

/// `text` as one segment of a path.
pub(crate) fn segment(text: &str) -> String {
    percent_encoding::utf8_percent_encode(text, percent_encoding::NON_ALPHANUMERIC).to_string()
}

fn json(body: &impl serde::Serialize) -> Option<(&'static str, Vec<u8>)> {
    // These bodies hold strings, numbers and lists of them only, which always serialise.
    serde_json::to_vec(body).ok().map(|bytes| ("application/json", bytes))
}

/// What went wrong with a request, for people: the server's own words where it gave some.
pub fn problem_text(status: u16, body: &[u8]) -> String {
    match serde_json::from_slice::<ProblemDetails>(body) {
        Ok(problem) if !problem.detail.is_empty() => problem.detail,
        Ok(problem) => problem.title,
        Err(_) => format!("the server answered with status {status}"),
    }
}

/// Something that came in.
#[derive(Clone, Debug, PartialEq)]
pub enum ApiEvent {
    /// The answer to a request: the body, or why there is none.
    Answer {
        /// What was asked.
        request: Request,
        /// The body of a 2xx answer, or what went wrong in words.
        result: Result<Vec<u8>, String>,
    },
    /// The stream socket is open.
    SocketOpen,
    /// The stream socket closed, or could not be opened.
    SocketClosed,
    /// A binary message on the stream socket.
    SocketMessage(Vec<u8>),
    /// The socket of commands is open; requests count from 1 again.
    ControlOpen,
    /// The socket of commands closed, or could not be opened.
    ControlClosed,
    /// A binary message on the socket of commands.
    ControlMessage(Vec<u8>),
    /// A stop left as this number when it was pressed, before a frame was drawn.
    StopSent(u64),
}

/// The outside world of the page's data. Nothing here waits.
pub trait Api {
    /// Sends a request, under `lease` if it needs one (0 for none); its answer comes from [`Api::poll`] some day.
    fn send(&mut self, lease: u64, request: Request);

    /// Opens the stream socket. It reports with [`ApiEvent::SocketOpen`] or [`ApiEvent::SocketClosed`].
    fn open_socket(&mut self);

    /// Opens the socket of commands. It reports with [`ApiEvent::ControlOpen`] or [`ApiEvent::ControlClosed`].
    fn open_control(&mut self);

    /// Sends a command under `lease` (0 for none). Gives its number on this connection; `None` where it cannot leave.
    fn send_control(&mut self, lease: u64, request: control_request::Request) -> Option<u64>;

    /// From now on, tells the station twenty times a second that the operator is there, for as long as the page can be
    /// seen and has the focus; `None` ends that.
    fn beat(&mut self, lease: Option<u64>);

    /// From now on, what comes on the stream socket is drawn within this time.
    fn draw_stream_within(&mut self, within: Duration);

    /// What came in since the last call, in order.
    fn poll(&mut self) -> Vec<ApiEvent>;
}

/// Numbers the requests of one connection.
#[derive(Clone, Debug, Default)]
pub struct ControlCounter {
    last: u64,
}

impl ControlCounter {
    /// The next request, with its number.
    pub fn number(&mut self, lease: u64, request: control_request::Request) -> ControlRequest {
        self.last += 1;
        ControlRequest { sequence: self.last, lease, request: Some(request) }
    }
}

/// A server that answers from a table, for tests.
#[derive(Clone, Debug, Default)]
pub struct FakeApi {
    /// Bodies by method and path with query; what is missing here answers with an error.
    pub bodies: BTreeMap<String, Vec<u8>>,
    /// Requests that were sent, in order.
    pub sent: Vec<Request>,
    /// The same as HTTP.
    pub http: Vec<HttpRequest>,
    /// Requests are left without an answer while this is set.
    pub silent: bool,
    /// What [`Api::poll`] gives next.
    pub events: VecDeque<ApiEvent>,
    /// Commands that were sent, in order.
    pub commands: Vec<ControlRequest>,
    /// The lease that is kept alive.
    pub beating: Option<u64>,
    /// How soon what comes on the stream is drawn.
    pub stream_within: Duration,
    counter: ControlCounter,
}

impl FakeApi {
    /// Answers `request` with `body` from now on.
    pub fn answer(&mut self, request: &Request, body: Vec<u8>) {
        self.bodies.insert(request.to_http(0).name(), body);
    }
}

impl Api for FakeApi {
    fn send(&mut self, lease: u64, request: Request) {
        let http = request.to_http(lease);
        let name = http.name();
        self.sent.push(request.clone());
        self.http.push(http);
        if self.silent {
            return;
        }
        let result = self.bodies.get(&name).cloned().ok_or_else(|| format!("nothing at {name}"));
        self.events.push_back(ApiEvent::Answer { request, result });
    }

    fn open_socket(&mut self) {
        self.events.push_back(ApiEvent::SocketOpen);
    }

    fn open_control(&mut self) {
        self.counter = ControlCounter::default();
        self.events.push_back(ApiEvent::ControlOpen);
    }

    fn send_control(&mut self, lease: u64, request: control_request::Request) -> Option<u64> {
        let request = self.counter.number(lease, request);
        let sequence = request.sequence;
        self.commands.push(request);
        Some(sequence)
    }

    fn beat(&mut self, lease: Option<u64>) {
        self.beating = lease;
    }

    fn draw_stream_within(&mut self, within: Duration) {
        self.stream_within = within;
    }

    fn poll(&mut self) -> Vec<ApiEvent> {
        self.events.drain(..).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_cannot_leave_their_segment() {
        let request = Request::Take { session: "../x y".into(), take: "a/b?c".into() };
        assert_eq!(request.to_http(0).path, "/api/v1/sessions/%2E%2E%2Fx%20y/takes/a%2Fb%3Fc/trace");
    }

    #[test]
    fn only_what_the_operator_alone_may_do_carries_the_lease() {
        let start = StartRecording {
            plan: "p".into(),
            session: "s".into(),
            operator: "Ada".into(),
            only_wanted: false,
        };
        let wanted = WantedTake { object: "o".into(), primitive: "p".into(), because: String::new() };
        let guarded = [
            Request::StartRecording(start),
            Request::ActOnRecording(RecordingAction::Accept),
            Request::ActOnTake(TakeAction::End { set_aside: false }),
            Request::Want(wanted),
            Request::Unwant { object: "o".into(), primitive: "p".into() },
        ];
        for request in guarded {
            assert_eq!(request.to_http(u64::MAX).lease, Some(u64::MAX), "{request:?}");
            assert_eq!(request.to_http(0).lease, None, "{request:?}: there is no lease 0");
        }
        for request in [Request::Info, Request::Recording, Request::DeleteSession("s".into())] {
            assert_eq!(request.to_http(7).lease, None, "{request:?} would give the secret away");
        }
    }

    #[test]
    fn problem_speaks_in_the_servers_words() {
        let body = br#"{"type":"about:blank","title":"Not Found","status":404,"detail":"no session \"x\""}"#;
        assert_eq!(problem_text(404, body), "no session \"x\"");
        assert_eq!(problem_text(502, b"<html>"), "the server answered with status 502");
    }
}

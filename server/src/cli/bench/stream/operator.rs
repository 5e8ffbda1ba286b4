//! An operator who records take after take, over the sockets and routes that a page uses.

use std::{net::SocketAddr, sync::Arc, time::Duration};

use futures_util::{SinkExt as _, StreamExt as _};
use palpate_server::Error;
use palpate_wire::{
    api::{
        LiveDocument, RecordingAction, RecordingDocument, RecordingPhase, RecordingSession, StartRecording,
    },
    proto::{Acquire, Arm, ControlReply, ControlRequest, Disarm, Heartbeat, control_request::Request},
};
use prost::Message as _;
use serde::{Serialize, de::DeserializeOwned};
use tokio::{
    net::TcpStream,
    sync::{Mutex, watch},
    time::sleep,
};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async, tungstenite::Message};

use super::{super::http::Connection, socket_url};

/// The session that is recorded.
pub(super) const SESSION: &str = "load";
const PLAN: &str = "nine_takes";
/// Heartbeats, as a page sends them.
const HEARTBEAT: Duration = Duration::from_millis(50);
/// The checklist is looked at this often.
const LOOK: Duration = Duration::from_millis(100);
/// After a refusal the station is disarmed for so long, and armed for so long before anything is asked of it.
const REARM: Duration = Duration::from_secs(1);
/// Looks until the devices must be there: two minutes.
const MOST_LOOKS: u32 = 1200;

/// Somebody in control of an armed station whose session has begun.
pub(super) struct Operator {
    addr: SocketAddr,
    socket: Arc<Mutex<CommandSocket>>,
    lease: u64,
    heart: tokio::task::JoinHandle<()>,
}

struct CommandSocket {
    socket: WebSocketStream<MaybeTlsStream<TcpStream>>,
    sequence: u64,
    lease: u64,
}

impl Operator {
    /// Waits for the devices, begins the session, takes control and arms.
    pub(super) async fn prepare(addr: SocketAddr) -> Result<Self, Error> {
        let mut looks = 0;
        loop {
            let live: LiveDocument = ask(addr, 0, "GET", "live", None::<&()>).await?;
            let mut missing = live.devices.iter().filter(|device| device.link != "ready");
            match missing.next() {
                None if !live.devices.is_empty() => break,
                Some(device) if looks >= MOST_LOOKS => {
                    return Err(Error::Internal(format!(
                        "{} was never ready: {}",
                        device.id, device.problem
                    )));
                }
                _ => {}
            }
            looks += 1;
            sleep(LOOK).await;
        }
        let start = StartRecording {
            plan: PLAN.to_owned(),
            session: SESSION.to_owned(),
            operator: "palpate bench".to_owned(),
            only_wanted: false,
        };
        let url = socket_url(addr, "control");
        let (socket, _) = connect_async(url).await.map_err(|err| broken(&err))?;
        let mut socket = CommandSocket { socket, sequence: 0, lease: 0 };
        socket
            .accepted(Request::Acquire(Acquire { operator: "palpate bench".to_owned(), take_over: false }))
            .await?;
        let lease = socket.lease;
        let socket = Arc::new(Mutex::new(socket));
        let heart = tokio::spawn({
            let socket = socket.clone();
            async move {
                loop {
                    // A refused heartbeat shows in the session: it says that the operator is gone.
                    if socket.lock().await.ask(Request::Heartbeat(Heartbeat {})).await.is_err() {
                        return;
                    }
                    sleep(HEARTBEAT).await;
                }
            }
        });
        let _begun: RecordingDocument = ask(addr, lease, "POST", "recording", Some(&start)).await?;
        socket.lock().await.accepted(Request::Arm(Arm {})).await?;
        Ok(Self { addr, socket, lease, heart })
    }

    /// Records until `ends`, and ends the take that is under way then. Gives what went wrong meanwhile.
    pub(super) async fn record(self, mut ends: watch::Receiver<bool>) -> Result<Vec<String>, Error> {
        let mut problems = Vec::new();
        let recorded = tokio::select! {
            recorded = self.follow_checklist(&mut problems) => recorded,
            _ = ends.wait_for(|&ends| ends) => Ok(()),
        };
        if self.session().await?.is_some_and(|session| session.phase == RecordingPhase::Running) {
            self.act(&RecordingAction::Cancel).await?;
            while self.session().await?.is_some_and(|session| {
                !matches!(session.phase, RecordingPhase::Review | RecordingPhase::PlaceObject)
            }) {
                sleep(LOOK).await;
            }
        }
        self.heart.abort();
        recorded.map(|()| problems)
    }

    async fn follow_checklist(&self, problems: &mut Vec<String>) -> Result<(), Error> {
        // A step's way to its start pose is gone once.
        let mut at_start = None;
        loop {
            let Some(session) = self.session().await? else { return Ok(()) };
            let action = match session.phase {
                RecordingPhase::PlaceObject => Some(RecordingAction::ConfirmObject { fixture_trusted: true }),
                RecordingPhase::StartPose if at_start == session.current => {
                    at_start = None;
                    Some(RecordingAction::Run)
                }
                RecordingPhase::StartPose => {
                    at_start = session.current;
                    Some(RecordingAction::GoToStart)
                }
                RecordingPhase::Review => Some(RecordingAction::Accept),
                RecordingPhase::Done => return Ok(()),
                _ => None,
            };
            if let Some(action) = action
                && let Err(err) = self.act(&action).await
            {
                // As an operator would: read why, arm anew, go on.
                problems.push(format!("{err}; {}", session.problem));
                at_start = None;
                let mut socket = self.socket.lock().await;
                socket.ask(Request::Disarm(Disarm {})).await?;
                drop(socket);
                sleep(REARM).await;
                self.socket.lock().await.ask(Request::Arm(Arm {})).await?;
                sleep(REARM).await;
            }
            sleep(LOOK).await;
        }
    }

    async fn session(&self) -> Result<Option<RecordingSession>, Error> {
        let document: RecordingDocument = ask(self.addr, 0, "GET", "recording", None::<&()>).await?;
        Ok(document.session)
    }

    async fn act(&self, action: &RecordingAction) -> Result<(), Error> {
        let _document: RecordingDocument =
            ask(self.addr, self.lease, "POST", "recording/act", Some(action)).await?;
        Ok(())
    }
}

impl CommandSocket {
    async fn ask(&mut self, request: Request) -> Result<ControlReply, Error> {
        self.sequence += 1;
        let request = ControlRequest { sequence: self.sequence, lease: self.lease, request: Some(request) };
        let bytes = request.encode_to_vec();
        self.socket.send(Message::Binary(bytes.into())).await.map_err(|err| broken(&err))?;
        loop {
            match self.socket.next().await {
                Some(Ok(Message::Binary(bytes))) => {
                    let reply = ControlReply::decode(bytes).map_err(|err| broken(&err))?;
                    self.lease = reply.lease;
                    return Ok(reply);
                }
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => {}
                Some(Err(err)) => return Err(broken(&err)),
                other => return Err(broken(&format!("{other:?} is no reply"))),
            }
        }
    }

    async fn accepted(&mut self, request: Request) -> Result<(), Error> {
        let reply = self.ask(request).await?;
        if reply.accepted { Ok(()) } else { Err(broken(&reply.problem)) }
    }
}

fn broken(err: &dyn std::fmt::Display) -> Error {
    Error::Internal(format!("the operator's command failed: {err}"))
}

/// One request of the API under `lease`; any answer but success is an error with the server's words.
pub(in crate::cli::bench) async fn ask<T: DeserializeOwned>(
    addr: SocketAddr,
    lease: u64,
    method: &str,
    path: &str,
    body: Option<&impl Serialize>,
) -> Result<T, Error> {
    let body = body.map(serde_json::to_string).transpose().map_err(|err| broken(&err))?;
    let path = format!("/api/v1/{path}");
    let answer = Connection::open(addr).await?.ask(method, &path, lease, body).await?;
    serde_json::from_slice(&answer).map_err(|err| broken(&err))
}

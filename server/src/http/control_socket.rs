//! The command socket: one for each operator's page or policy, apart from the stream, so that no telemetry delays a stop.
//!
//! A stop or a heartbeat is handed to the control loop the moment it is read, whatever else this connection or others have
//! asked for: nothing on its way is shared with requests that take time.

use std::{
    collections::VecDeque,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Instant,
};

use axum::{
    body::{Body, Bytes},
    extract::{Extension, FromRequestParts as _, Request as HttpRequest, State},
    http::{HeaderValue, StatusCode, header},
    response::{IntoResponse as _, Response},
};
use futures_util::{SinkExt as _, StreamExt as _};
use hyper::upgrade::{OnUpgrade, Upgraded};
use hyper_util::rt::TokioIo;
use palpate_control::{Caller, Handle};
use palpate_wire::{
    api::{Role, Scope},
    proto::{ControlReply, ControlRequest, control_request::Request},
};
use prost::Message as _;
use tokio::sync::{mpsc, oneshot};
use tokio_tungstenite::{
    WebSocketStream,
    tungstenite::{
        Message,
        handshake::derive_accept_key,
        protocol::{CloseFrame, Role as Side, WebSocketConfig, frame::coding::CloseCode},
    },
};

use super::{
    bucket::Bucket,
    connection::Connection,
    documented::Refusal,
    extract::{Asking, Peer, Upgrade},
    identity::no_longer_valid,
    listener::KeepOpen,
    problem::Problem,
};
use crate::{AppState, Error};

/// Numbers the connections of this process.
static CONNECTIONS: AtomicU64 = AtomicU64::new(1);

/// Longest request, bytes: targets for a few hundred joints.
const MAX_REQUEST: usize = 16 * 1024;
/// Requests a second of one connection. A page sends 20 heartbeats and 60 targets; a policy may send some hundreds.
const REQUESTS_PER_S: f64 = 500.0;
const REQUESTS_BURST: f64 = 500.0;
/// Requests of one connection that wait for the reply to the one before.
const MAX_WAITING: usize = 128;
/// Replies that wait to be sent; a client that lets more wait does not read them.
const MAX_REPLIES: usize = 1024;

/// Opens a command socket: a WebSocket of binary protobuf messages `palpate.ControlRequest`, each answered by a
/// `palpate.ControlReply` (`server/wire/proto/palpate/control.proto`).
///
/// Anybody may send a stop; everything else that moves the robot needs the lease, which the reply to `Acquire` gives, and
/// heartbeats (`docs/safety.md`). Requests of a connection are answered in order, stops and heartbeats at once.
#[utoipa::path(
    get,
    path = "/control",
    tag = "station",
    responses((status = 101, description = "The connection is a WebSocket now."), Refusal<404>),
)]
pub(crate) async fn upgrade(
    State(state): State<Arc<AppState>>,
    Peer(peer): Peer,
    Asking(principal): Asking,
    open: Option<Extension<KeepOpen>>,
    request: HttpRequest,
) -> Response {
    let Some(live) = state.live() else {
        return Problem(Error::NoStation).into_response();
    };
    let handle = live.handle().clone();
    let (mut parts, _) = request.into_parts();
    // Refuses what is no WebSocket of the version that everybody speaks.
    if let Err(refused) = Upgrade::from_request_parts(&mut parts.clone(), &state).await {
        return refused;
    }
    let (Some(key), Some(connection)) =
        (parts.headers.get(header::SEC_WEBSOCKET_KEY), parts.extensions.remove::<OnUpgrade>())
    else {
        return Problem(Error::Argument("this connection cannot become a WebSocket".to_owned()))
            .into_response();
    };
    let accept = derive_accept_key(key.as_bytes());
    let commands = state.work().commands().clone();
    let people = state.people().clone();
    let ends = ends(&state);
    let converse = async move {
        let _open = open;
        let may_operate = principal.may(Role::Operator, Scope::Control);
        let caller = Caller { connection: CONNECTIONS.fetch_add(1, Ordering::Relaxed), peer, may_operate };
        let socket = match connection.await.map_err(std::io::Error::other).and_then(here) {
            Ok(io) => websocket(io).await,
            Err(err) => {
                tracing::debug!(%err, "a command socket ended before it began");
                return;
            }
        };
        let gone = Gone { handle: handle.clone(), connection: caller.connection };
        let named = (!principal.is_local()).then(|| principal.name().clone());
        let revoked = no_longer_valid(people, principal);
        converse(socket, gone, &caller, named, revoked, ends).await;
    };
    // The task ends with its socket, and all of them with the thread.
    drop(commands.spawn(converse));
    switching_protocols(&accept)
}

/// Completes when the server ends.
fn ends(state: &AppState) -> impl Future<Output = ()> + Send + use<> {
    let mut shutdown = state.shutdown();
    async move {
        let _ = shutdown.wait_for(|&ends| ends).await;
    }
}

/// Takes a connection over into the event loop of the calling thread, with the bytes that have been read from it already.
fn here(upgraded: Upgraded) -> std::io::Result<(Connection, Bytes)> {
    let parts = upgraded
        .downcast::<TokioIo<Connection>>()
        .map_err(|_| std::io::Error::other("the connection is not one of this server's"))?;
    let mut connection = parts.io.into_inner();
    connection.move_here()?;
    Ok((connection, parts.read_buf))
}

async fn websocket((stream, read): (Connection, Bytes)) -> WebSocketStream<Connection> {
    let config = WebSocketConfig::default().max_message_size(Some(MAX_REQUEST));
    WebSocketStream::from_partially_read(stream, read.to_vec(), Side::Server, Some(config)).await
}

/// The answer that ends the handshake.
fn switching_protocols(accept: &str) -> Response {
    let mut response = Response::new(Body::empty());
    *response.status_mut() = StatusCode::SWITCHING_PROTOCOLS;
    let headers = response.headers_mut();
    headers.insert(header::CONNECTION, HeaderValue::from_static("upgrade"));
    headers.insert(header::UPGRADE, HeaderValue::from_static("websocket"));
    if let Ok(accept) = HeaderValue::from_str(accept) {
        headers.insert(header::SEC_WEBSOCKET_ACCEPT, accept);
    }
    response
}

/// Tells the control loop, however the conversation ends, that nobody is there any more.
struct Gone {
    handle: Handle,
    connection: u64,
}

impl Drop for Gone {
    fn drop(&mut self) {
        self.handle.connection_lost(self.connection);
    }
}

/// Answers requests until the client leaves or the server `ends`.
async fn converse(
    socket: WebSocketStream<Connection>,
    gone: Gone,
    caller: &Caller,
    named: Option<Arc<str>>,
    revoked: impl Future<Output = ()>,
    ends: impl Future<Output = ()>,
) {
    let (mut sink, mut requests) = socket.split();
    let (replies, mut outgoing) = mpsc::channel::<ControlReply>(MAX_REPLIES);
    let send = async {
        while let Some(reply) = outgoing.recv().await {
            if sink.send(Message::Binary(Bytes::from(reply.encode_to_vec()))).await.is_err() {
                return;
            }
        }
    };
    let receive = async {
        let mut reader = Reader {
            handle: &gone.handle,
            caller,
            named,
            replies,
            bucket: Bucket::new(REQUESTS_PER_S, REQUESTS_BURST, Instant::now()),
            waiting: VecDeque::new(),
            under_way: None,
        };
        loop {
            tokio::select! {
                biased;
                message = requests.next() => {
                    let Some(Ok(message)) = message else { return };
                    if !reader.message(message) {
                        return;
                    }
                }
                // An answer that was dropped has sent its own reply.
                _ = answered(&mut reader.under_way) => reader.next(),
            }
        }
    };
    let closes = tokio::select! {
        () = send => None,
        () = receive => None,
        () = revoked => Some((CloseCode::Policy, "the login or token has ended")),
        () = ends => Some((CloseCode::Away, "the studio is shutting down")),
    };
    // Whoever is left has no control, whether they hear of it or not.
    drop(gone);
    if let Some((code, reason)) = closes {
        let close = CloseFrame { code, reason: reason.into() };
        // What is read no longer counts; unread it would take the close back.
        let leave = async {
            if sink.send(Message::Close(Some(close))).await.is_ok() {
                while let Some(Ok(_)) = requests.next().await {}
            }
        };
        // The client may be gone already, or never read it.
        let _ = tokio::time::timeout(crate::http::stream::CLOSE_TIMEOUT, leave).await;
    }
}

/// Completes when the request under way is answered; never without one.
async fn answered(under_way: &mut Option<oneshot::Receiver<()>>) {
    match under_way {
        Some(done) => {
            let _ = done.await;
        }
        None => std::future::pending().await,
    }
}

/// Hands requests on: stops and heartbeats at once, others one after the other.
struct Reader<'a> {
    handle: &'a Handle,
    caller: &'a Caller,
    /// The person, where there is a login: operators are called that, whatever they call themselves.
    named: Option<Arc<str>>,
    replies: mpsc::Sender<ControlReply>,
    bucket: Bucket,
    waiting: VecDeque<(u64, ControlRequest)>,
    /// Completes when the control loop has answered the request before.
    under_way: Option<oneshot::Receiver<()>>,
}

impl Reader<'_> {
    /// Takes a message; says whether the conversation goes on.
    fn message(&mut self, message: Message) -> bool {
        let received_ns = self.handle.now_ns();
        let mut request = match message {
            Message::Binary(bytes) => match ControlRequest::decode(bytes) {
                Ok(request) => request,
                Err(err) => return self.refuse(0, format!("not a ControlRequest: {err}")),
            },
            Message::Text(_) => {
                return self.refuse(0, "expected a binary message with a ControlRequest".to_owned());
            }
            Message::Close(_) => return false,
            Message::Ping(_) | Message::Pong(_) | Message::Frame(_) => return true,
        };
        let is_stop = matches!(request.request, Some(Request::Stop(_)));
        if let (Some(name), Some(Request::Acquire(acquire))) = (&self.named, &mut request.request) {
            acquire.operator = name.to_string();
        }
        let passes = self.bucket.take(Instant::now());
        if !passes && !is_stop {
            let problem =
                format!("more than {REQUESTS_PER_S} requests a second came on this connection; send fewer");
            return self.refuse(request.sequence, problem);
        }
        if is_stop || matches!(request.request, Some(Request::Heartbeat(_))) {
            self.submit(received_ns, request, None);
        } else if self.waiting.len() >= MAX_WAITING {
            let problem =
                format!("{MAX_WAITING} requests of this connection wait already; await their replies");
            return self.refuse(request.sequence, problem);
        } else {
            self.waiting.push_back((received_ns, request));
            if self.under_way.is_none() {
                self.next();
            }
        }
        true
    }

    /// Hands in the next request that waits.
    fn next(&mut self) {
        self.under_way = None;
        if let Some((received_ns, request)) = self.waiting.pop_front() {
            let (done, under_way) = oneshot::channel();
            self.under_way = Some(under_way);
            self.submit(received_ns, request, Some(done));
        }
    }

    fn submit(&self, received_ns: u64, request: ControlRequest, done: Option<oneshot::Sender<()>>) {
        let mut reply =
            Reply { sequence: request.sequence, replies: Some(self.replies.clone()), _done: done };
        self.handle.submit(self.caller, received_ns, request, Box::new(move |answer| reply.send(answer)));
    }

    /// Refuses a request that the control loop does not see; says whether the conversation goes on.
    fn refuse(&self, sequence: u64, problem: String) -> bool {
        // A client that reads no replies is cut off.
        self.replies.try_send(ControlReply { sequence, problem, ..ControlReply::default() }).is_ok()
    }
}

/// The way back of one reply. Dropped unused, it says that the control loop did not answer.
struct Reply {
    sequence: u64,
    replies: Option<mpsc::Sender<ControlReply>>,
    _done: Option<oneshot::Sender<()>>,
}

impl Reply {
    fn send(&mut self, reply: ControlReply) {
        if let Some(replies) = self.replies.take() {
            // A client that reads no replies misses this one; the control loop waits for nobody.
            let _ = replies.try_send(reply);
        }
    }
}

impl Drop for Reply {
    fn drop(&mut self) {
        let problem = "the control loop did not take the request: it has ended, or too many wait".to_owned();
        self.send(ControlReply { sequence: self.sequence, problem, ..ControlReply::default() });
    }
}

//! The command socket: one for each operator's page or policy, apart from the stream, so that no telemetry delays a stop.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use axum::{
    body::Bytes,
    extract::{
        State, WebSocketUpgrade,
        ws::{CloseFrame, Message, WebSocket, close_code},
    },
    response::{IntoResponse as _, Response},
};
use palpate_control::Handle;
use palpate_wire::proto::{ControlReply, ControlRequest};
use prost::Message as _;

use crate::{AppState, Error, routes::Problem};

/// Numbers the connections of this process.
static CONNECTIONS: AtomicU64 = AtomicU64::new(1);

/// Longest request, bytes: targets for a few hundred joints.
const MAX_REQUEST: usize = 16 * 1024;

/// `GET /api/v1/control`.
pub(crate) async fn upgrade(State(state): State<Arc<AppState>>, upgrade: WebSocketUpgrade) -> Response {
    let Some(live) = state.live() else {
        return Problem(Error::no_station()).into_response();
    };
    let handle = live.handle().clone();
    upgrade.max_message_size(MAX_REQUEST).on_upgrade(move |mut socket| async move {
        let connection = CONNECTIONS.fetch_add(1, Ordering::Relaxed);
        let mut shutdown = state.shutdown();
        let ends = tokio::select! {
            () = converse(&mut socket, &handle, connection) => false,
            _ = shutdown.wait_for(|&ends| ends) => true,
        };
        handle.connection_lost(connection);
        if ends {
            let close = CloseFrame { code: close_code::AWAY, reason: "the studio is shutting down".into() };
            // The client may be gone already.
            let _ = socket.send(Message::Close(Some(close))).await;
        }
    })
}

/// Answers requests, in order, until the client leaves.
async fn converse(socket: &mut WebSocket, handle: &Handle, connection: u64) {
    while let Some(Ok(message)) = socket.recv().await {
        let reply = match message {
            Message::Binary(bytes) => match ControlRequest::decode(bytes) {
                Ok(request) => answer(handle, connection, request).await,
                Err(err) => refused(format!("not a ControlRequest: {err}")),
            },
            Message::Text(_) => refused("expected a binary message with a ControlRequest".to_owned()),
            Message::Close(_) => return,
            Message::Ping(_) | Message::Pong(_) => continue,
        };
        if socket.send(Message::Binary(Bytes::from(reply.encode_to_vec()))).await.is_err() {
            return;
        }
    }
}

/// The control loop answers within a period of its own; waiting for it must not hold a thread that serves others.
async fn answer(handle: &Handle, connection: u64, request: ControlRequest) -> ControlReply {
    let (handle, sequence) = (handle.clone(), request.sequence);
    match tokio::task::spawn_blocking(move || handle.request(connection, request)).await {
        Ok(reply) => reply,
        Err(err) => ControlReply { sequence, ..refused(format!("the control loop did not answer: {err}")) },
    }
}

fn refused(problem: String) -> ControlReply {
    ControlReply { problem, ..ControlReply::default() }
}

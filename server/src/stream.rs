//! The stream socket: one bounded queue for each client.

use std::{sync::Arc, time::Duration};

use axum::{
    body::Bytes,
    extract::{
        State, WebSocketUpgrade,
        ws::{CloseFrame, Message, WebSocket, close_code},
    },
    response::Response,
};
use prost::Message as _;

use crate::{AppState, hub::Client};

/// A client that does not read is not waited for longer than this.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(500);

/// `GET /api/v1/stream`.
pub(crate) async fn upgrade(State(state): State<Arc<AppState>>, upgrade: WebSocketUpgrade) -> Response {
    upgrade.on_upgrade(move |socket| async move {
        let client = state.hub().join();
        let unfinished = [state.calibrations().unfinished_updates(), state.diagnoses().unfinished_updates()];
        for update in unfinished.into_iter().flatten() {
            client.push_job(update);
        }
        let mut shutdown = state.shutdown();
        let mut socket = socket;
        let ends = tokio::select! {
            () = converse(&mut socket, &client) => false,
            _ = shutdown.wait_for(|&ends| ends) => true,
        };
        if ends {
            let close = CloseFrame { code: close_code::AWAY, reason: "the studio is shutting down".into() };
            // The client may be gone already, or never read it.
            let _ = tokio::time::timeout(CLOSE_TIMEOUT, socket.send(Message::Close(Some(close)))).await;
        }
    })
}

/// Sends until the client leaves. Nothing is expected from it but the pings and the close that axum answers.
async fn converse(socket: &mut WebSocket, client: &Client) {
    loop {
        tokio::select! {
            message = client.next() => {
                let bytes = Bytes::from(message.encode_to_vec());
                if socket.send(Message::Binary(bytes)).await.is_err() {
                    return;
                }
            }
            received = socket.recv() => {
                if !matches!(received, Some(Ok(_))) {
                    return;
                }
            }
        }
    }
}

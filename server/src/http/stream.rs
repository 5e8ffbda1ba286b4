//! The stream socket: one bounded queue for each client, and little on its way to it.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use axum::{
    body::Bytes,
    extract::{
        Extension, State,
        ws::{CloseFrame, Message, WebSocket, close_code},
    },
    response::Response,
};
use futures_util::SinkExt as _;
use palpate_people::Principal;
use prost::Message as _;

use super::{
    extract::{Asking, Upgrade},
    identity::no_longer_valid,
    listener::KeepOpen,
    pacing::Pacing,
};
use crate::{AppState, hub::Client, work::Kind};

/// A close code of WebSockets and its reason.
type Closing = (u16, &'static str);

/// Clients answer pings and otherwise send nothing, bytes.
const MAX_MESSAGE: usize = 1024;
/// A client that does not read is not waited for longer than this.
pub(crate) const CLOSE_TIMEOUT: Duration = Duration::from_millis(500);

/// Opens the stream: a WebSocket of binary protobuf messages `palpate.StreamMessage` (`server/wire/proto/palpate/control.proto`).
///
/// It carries the frames of the live station, 30 a second at most, and every job's progress when it changes. A client that
/// reads slowly gets fewer frames, counted in `dropped`, and no old ones. It sends nothing but answers to pings.
#[utoipa::path(
    get,
    path = "/stream",
    tag = "station",
    responses((status = 101, description = "The connection is a WebSocket now.")),
)]
pub(crate) async fn upgrade(
    State(state): State<Arc<AppState>>,
    Asking(principal): Asking,
    open: Option<Extension<KeepOpen>>,
    Upgrade(upgrade): Upgrade,
) -> Response {
    upgrade.max_message_size(MAX_MESSAGE).on_upgrade(move |socket| async move {
        let client = state.hub().join();
        // A client that is told too little asks for the lists, as it does when it begins.
        let unfinished = state.run(Kind::Read, |state| state.jobs().unfinished_updates()).await;
        for update in unfinished.unwrap_or_default() {
            client.push_job(update);
        }
        let mut socket = socket;
        let closes = tokio::select! {
            () = converse(&mut socket, &client) => None,
            closes = has_to_close(&state, principal, open) => closes,
        };
        if let Some(why) = closes {
            close(&mut socket, why).await;
        }
    })
}

/// Waits until a connection that only watches has to be closed. Gives what its client is told; nothing where another
/// connection needs its place.
pub(super) async fn has_to_close(
    state: &AppState,
    principal: Principal,
    open: Option<Extension<KeepOpen>>,
) -> Option<Closing> {
    let gives_way = async {
        match &open {
            Some(Extension(open)) => open.gives_way().await,
            None => std::future::pending().await,
        }
    };
    let mut shutdown = state.shutdown();
    tokio::select! {
        () = gives_way => None,
        () = no_longer_valid(state.people().clone(), principal) => {
            Some((close_code::POLICY, "the login or token has ended"))
        }
        _ = shutdown.wait_for(|&ends| ends) => Some((close_code::AWAY, "the studio is shutting down")),
    }
}

/// Tells the client why it is left, and reads what it still sends until it leaves too: a connection that is dropped
/// with something unread takes back what was sent last.
pub(super) async fn close(socket: &mut WebSocket, (code, reason): Closing) {
    let close = CloseFrame { code, reason: reason.into() };
    let leave = async {
        if socket.send(Message::Close(Some(close))).await.is_ok() {
            while let Some(Ok(_)) = socket.recv().await {}
        }
    };
    // The client may be gone already, or never read it.
    let _ = tokio::time::timeout(CLOSE_TIMEOUT, leave).await;
}

/// Sends until the client leaves. Nothing is expected from it but the close, and the answers to pings that every WebSocket
/// client gives by itself.
async fn converse(socket: &mut WebSocket, client: &Client) {
    let (mut pacing, begun) = (Pacing::default(), Instant::now());
    loop {
        tokio::select! {
            message = client.next(), if pacing.may_send() => {
                let number = pacing.sent(begun.elapsed()).to_be_bytes();
                let message = Message::Binary(Bytes::from(message.encode_to_vec()));
                let ping = Message::Ping(Bytes::copy_from_slice(&number));
                if socket.feed(message).await.is_err() || socket.send(ping).await.is_err() {
                    return;
                }
            }
            received = socket.recv() => match received {
                Some(Ok(Message::Pong(number))) => {
                    if let Ok(number) = number.as_ref().try_into() {
                        pacing.answered(u64::from_be_bytes(number), begun.elapsed());
                    }
                }
                Some(Ok(_)) => {}
                _ => return,
            },
        }
    }
}

//! The live station for Foxglove and other programs that speak its WebSocket protocol.
//!
//! It is a client of the hub like the stream's sockets: what it is too slow for is dropped and counted, and the control loop
//! does not know of it. [`feed`] makes the messages.

mod feed;

use std::{
    sync::{Arc, OnceLock},
    time::{Instant, SystemTime, UNIX_EPOCH},
};

use axum::{
    body::Bytes,
    extract::{
        Extension, State,
        ws::{Message, WebSocket},
    },
    http::Uri,
    response::Response,
};
use futures_util::SinkExt as _;
use palpate_wire::{api::ProblemType, proto::stream_message::Message as Streamed};

use super::{
    documented::Refusal,
    extract::{Asking, Upgrade},
    listener::KeepOpen,
    pacing::Pacing,
    problem::{Problem, problem},
    stream::{close, has_to_close},
};
use crate::{AppState, Error, hub::Client};
use feed::Feed;

/// Where it is.
pub(super) const PATH: &str = "/api/v1/foxglove";
/// Names of the protocol: now, and before there was an SDK. Both carry the messages that are used here.
const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// A client says what it subscribes to and little else, bytes.
const MAX_MESSAGE: usize = 64 * 1024;

/// The token in the query of a request to this socket; other requests have none there. Foxglove's app takes an address and
/// no headers.
pub(super) fn query_token(uri: &Uri) -> Option<&str> {
    let query = uri.query().filter(|_| uri.path() == PATH)?;
    query.split('&').find_map(|pair| pair.strip_prefix("token="))
}

/// Opens the live station for Foxglove: a WebSocket of the protocol `foxglove.sdk.v1`.
///
/// Channels, all protobuf: `/joint_states` and `/joint_commands` (foxglove.JointStates), `/tf` (foxglove.FrameTransforms),
/// `/log` (foxglove.Log), `/tactile/<stream>` (palpate.TactileSample; readings less their reference) and `/live`
/// (palpate.LiveFrame), 30 a second at most. A client that reads slowly gets fewer and is told how many it lost. Pages of other
/// origins get in where the studio was started with `--foxglove-origin`.
#[utoipa::path(
    get,
    path = "/foxglove",
    tag = "station",
    params(("token" = Option<String>, Query, description = "An API token, for programs that send no headers.")),
    responses((status = 101, description = "The connection is a WebSocket now."), Refusal<404>),
)]
pub(crate) async fn upgrade(
    State(state): State<Arc<AppState>>,
    Asking(principal): Asking,
    open: Option<Extension<KeepOpen>>,
    Upgrade(upgrade): Upgrade,
) -> Result<Response, Response> {
    use axum::response::IntoResponse as _;
    let Some(live) = state.live() else { return Err(Problem(Error::NoStation).into_response()) };
    let upgrade = upgrade.protocols(PROTOCOLS);
    if upgrade.selected_protocol().is_none() {
        let detail = format!(
            "this path is for Foxglove's protocol: the client has to ask for the WebSocket subprotocol {:?}",
            PROTOCOLS[0]
        );
        return Err(problem(ProblemType::BadRequest, &detail));
    }
    let mut feed = Feed::new(live.station());
    Ok(upgrade.max_message_size(MAX_MESSAGE).on_upgrade(move |mut socket| async move {
        let client = state.hub().join();
        let closes = tokio::select! {
            () = converse(&mut socket, &client, &mut feed) => None,
            closes = has_to_close(&state, principal, open) => closes,
        };
        if let Some(why) = closes {
            close(&mut socket, why).await;
        }
    }))
}

/// Sends until the client leaves.
async fn converse(socket: &mut WebSocket, client: &Client, feed: &mut Feed) {
    for text in [feed.server_info(session_id()), feed.advertise()] {
        if socket.send(Message::text(text)).await.is_err() {
            return;
        }
    }
    let (mut pacing, begun) = (Pacing::default(), Instant::now());
    loop {
        let (texts, messages) = tokio::select! {
            message = client.next(), if pacing.may_send() => match message.message {
                Some(Streamed::Live(frame)) => {
                    let messages = feed.frame(frame, unix_ns());
                    (feed.lost(message.dropped, begun.elapsed()).into_iter().collect(), messages)
                }
                _ => continue,
            },
            received = socket.recv() => match received {
                Some(Ok(Message::Pong(number))) => {
                    if let Ok(number) = number.as_ref().try_into() {
                        pacing.answered(u64::from_be_bytes(number), begun.elapsed());
                    }
                    continue;
                }
                Some(Ok(Message::Text(text))) => feed.request(&text),
                Some(Ok(Message::Binary(_))) => (vec![feed.takes_nothing()], Vec::new()),
                Some(Ok(_)) => continue,
                _ => return,
            },
        };
        if texts.is_empty() && messages.is_empty() {
            continue;
        }
        let number = pacing.sent(begun.elapsed()).to_be_bytes();
        let texts = texts.into_iter().map(Message::text);
        let messages = messages.into_iter().map(|message| Message::Binary(Bytes::from(message)));
        for message in texts.chain(messages) {
            if socket.feed(message).await.is_err() {
                return;
            }
        }
        if socket.send(Message::Ping(Bytes::copy_from_slice(&number))).await.is_err() {
            return;
        }
    }
}

fn unix_ns() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64)
}

/// Tells clients that come back whether the studio is still the same.
fn session_id() -> &'static str {
    static ID: OnceLock<String> = OnceLock::new();
    ID.get_or_init(|| unix_ns().to_string())
}

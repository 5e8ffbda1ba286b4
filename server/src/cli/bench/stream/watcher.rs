//! A client that watches a live station.

use std::{
    net::SocketAddr,
    time::{Duration, Instant},
};

use futures_util::StreamExt as _;
use palpate_server::Error;
use palpate_wire::proto::{StreamMessage, stream_message};
use prost::Message as _;
use tokio::{net::TcpSocket, sync::watch};
use tokio_tungstenite::{client_async, tungstenite::Message};

use super::socket_url;

/// The slow client reads this often: a fifteenth of what is sent.
const SLOW: Duration = Duration::from_millis(500);
/// And its side of the line holds no more than this, bytes, so that it is slow soon.
const SMALL_BUFFER: u32 = 4096;

/// How a client reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pace {
    AsItComes,
    Slow,
}

/// What a client saw.
#[derive(Clone, Debug, Default)]
pub(super) struct Watched {
    /// Messages that came.
    pub(super) frames: u64,
    /// Messages that it was told it lost.
    pub(super) dropped: u64,
    /// Turns of the control loop in the second before each message.
    pub(super) loop_hz: Vec<f64>,
    /// As each message says, ms.
    pub(super) latency_ms: Vec<f64>,
    /// When each message came less when it was made, by clocks that began at different times, s.
    pub(super) delays_s: Vec<f64>,
    /// Samples that the recorder could not keep.
    pub(super) lost_samples: u64,
    /// How much older than the fastest the newest message was when the end came, s.
    pub(super) behind_s: f64,
}

/// Who has fallen behind reads up to this far, s, or for so long, before it leaves.
const CAUGHT_UP_S: f64 = 0.2;
const MOST_CATCHING_UP: Duration = Duration::from_secs(10);

/// Reads the stream of `addr` until `ends`.
pub(super) async fn watch_stream(
    addr: SocketAddr,
    pace: Pace,
    mut ends: watch::Receiver<bool>,
) -> Result<Watched, Error> {
    let failed = |err: &dyn std::fmt::Display| Error::Internal(format!("a client could not watch: {err}"));
    let socket = TcpSocket::new_v4().map_err(|err| failed(&err))?;
    if pace == Pace::Slow {
        socket.set_recv_buffer_size(SMALL_BUFFER).map_err(|err| failed(&err))?;
    }
    let stream = socket.connect(addr).await.map_err(|err| failed(&err))?;
    let (mut socket, _) =
        client_async(socket_url(addr, "stream"), stream).await.map_err(|err| failed(&err))?;
    let begun = Instant::now();
    let mut watched = Watched::default();
    let mut ended: Option<Instant> = None;
    loop {
        let message = tokio::select! {
            message = socket.next() => message,
            _ = ends.wait_for(|&ends| ends), if ended.is_none() => {
                watched.behind_s = watched.behind_s();
                ended = Some(Instant::now());
                continue;
            }
        };
        match message {
            Some(Ok(Message::Binary(bytes))) => {
                let message = StreamMessage::decode(bytes).map_err(|err| failed(&err))?;
                watched.take_in(&message, begun.elapsed().as_secs_f64());
            }
            Some(Ok(_)) => {}
            Some(Err(err)) => return Err(failed(&err)),
            None => return Err(failed(&"the server closed the stream")),
        }
        match ended {
            // What a message says it lost is what was lost before it was sent: the newest one knows all of it.
            Some(at) if watched.behind_s() < CAUGHT_UP_S || at.elapsed() > MOST_CATCHING_UP => {
                return Ok(watched);
            }
            None if pace == Pace::Slow => tokio::time::sleep(SLOW).await,
            _ => {}
        }
    }
}

impl Watched {
    /// How much older than the fastest the newest message is, s.
    fn behind_s(&self) -> f64 {
        let fastest = self.delays_s.iter().copied().fold(f64::INFINITY, f64::min);
        self.delays_s.last().map_or(0.0, |newest| newest - fastest)
    }

    fn take_in(&mut self, message: &StreamMessage, now_s: f64) {
        self.dropped = self.dropped.max(message.dropped);
        let Some(stream_message::Message::Live(frame)) = &message.message else { return };
        self.frames += 1;
        self.delays_s.push(now_s - frame.time_s);
        let Some(control) = &frame.control else { return };
        self.loop_hz.push(f64::from(control.loop_hz));
        self.latency_ms.push(f64::from(control.latency_ms));
        if let Some(recording) = &control.recording {
            self.lost_samples = self.lost_samples.max(recording.lost_samples);
        }
    }
}

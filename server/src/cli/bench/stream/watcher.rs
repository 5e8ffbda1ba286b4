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
pub(in super::super) enum Pace {
    AsItComes,
    Slow,
}

/// What a client saw.
#[derive(Clone, Debug, Default)]
pub(in super::super) struct Watched {
    /// Frames that it was told it lost.
    pub(super) dropped: u64,
    /// Turns of the control loop in the second before each frame.
    pub(in super::super) loop_hz: Vec<f64>,
    /// As each frame says, ms.
    pub(super) latency_ms: Vec<f64>,
    /// When each frame was made, by the station's clock, s.
    pub(in super::super) made_s: Vec<f64>,
    /// When each frame was read less when it was made, by clocks that began at different times, s.
    pub(super) delays_s: Vec<f64>,
    /// Samples that the recorder could not keep.
    pub(super) lost_samples: u64,
}

/// Reads the stream of `addr` until `ends`. Delays count from `begun`, which all clients share.
pub(in super::super) async fn watch_stream(
    addr: SocketAddr,
    pace: Pace,
    begun: Instant,
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
    let mut watched = Watched::default();
    loop {
        let message = tokio::select! {
            message = socket.next() => message,
            _ = ends.wait_for(|&ends| ends) => return Ok(watched),
        };
        match message {
            Some(Ok(Message::Binary(bytes))) => {
                let message = StreamMessage::decode(bytes).map_err(|err| failed(&err))?;
                watched.take_in(&message, begun.elapsed().as_secs_f64());
                if pace == Pace::Slow {
                    tokio::time::sleep(SLOW).await;
                }
            }
            Some(Ok(_)) => {}
            Some(Err(err)) => return Err(failed(&err)),
            None => return Err(failed(&"the server closed the stream")),
        }
    }
}

impl Watched {
    /// Frames a second by the station's clock.
    pub(in super::super) fn frames_per_s(&self) -> f64 {
        match &self.made_s[..] {
            [first, .., last] if last > first => (self.made_s.len() - 1) as f64 / (last - first),
            _ => 0.0,
        }
    }

    fn take_in(&mut self, message: &StreamMessage, now_s: f64) {
        self.dropped = self.dropped.max(message.dropped);
        let Some(stream_message::Message::Live(frame)) = &message.message else { return };
        self.made_s.push(frame.time_s);
        self.delays_s.push(now_s - frame.time_s);
        let Some(control) = &frame.control else { return };
        self.loop_hz.push(f64::from(control.loop_hz));
        self.latency_ms.push(f64::from(control.latency_ms));
        if let Some(recording) = &control.recording {
            self.lost_samples = self.lost_samples.max(recording.lost_samples);
        }
    }
}

//! The stream socket.

use std::{sync::Arc, time::Duration};

use futures_util::StreamExt as _;
use palpate_server::{AppState, app};
use palpate_wire::proto::{JobUpdate, LiveFrame, StreamMessage, stream_message::Message as Kind};
use prost::Message as _;
use tokio::{net::TcpListener, time::timeout};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async, tungstenite::Message};

use crate::support::{Data, post};

type Socket = WebSocketStream<MaybeTlsStream<tokio::net::TcpStream>>;

async fn connect(state: &Arc<AppState>) -> Socket {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("ws://{}/api/v1/stream", listener.local_addr().unwrap());
    let router = app(state.clone());
    tokio::spawn(async move { axum::serve(listener, router).await.unwrap() });
    connect_async(url).await.unwrap().0
}

async fn next(socket: &mut Socket) -> StreamMessage {
    let message = timeout(Duration::from_secs(60), socket.next()).await.expect("a message within a minute");
    match message.unwrap().unwrap() {
        Message::Binary(bytes) => StreamMessage::decode(bytes).unwrap(),
        other => panic!("expected a binary message, found {other:?}"),
    }
}

/// A frame that fills the sockets' buffers soon: 400 kB.
fn large_frame(idx: usize) -> LiveFrame {
    LiveFrame { time_s: idx as f64, raw: vec![0.5; 100_000], ..LiveFrame::default() }
}

#[tokio::test(flavor = "multi_thread")]
async fn slow_client_loses_the_oldest_frames_and_hears_how_many() {
    const NUM_FRAMES: usize = 400;
    let data = Data::empty();
    let state = data.state();
    let mut socket = connect(&state).await;
    // Whoever joins is there once the first message has arrived.
    state.hub().publish_live(large_frame(0));
    let mut received = vec![next(&mut socket).await];

    for idx in 1..=NUM_FRAMES {
        state.hub().publish_live(large_frame(idx));
        if idx == 200 {
            let update = JobUpdate { job: "run-1".into(), state: "running".into(), ..JobUpdate::default() };
            state.hub().publish_job(&update);
        }
        // Longer than the server needs to fill the buffers of a client that does not read.
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    let is_last = |message: &StreamMessage| matches!(&message.message, Some(Kind::Live(frame)) if frame.time_s == NUM_FRAMES as f64);
    while !received.last().is_some_and(is_last) {
        received.push(next(&mut socket).await);
    }
    let times: Vec<f64> = received
        .iter()
        .filter_map(|message| match &message.message {
            Some(Kind::Live(frame)) => Some(frame.time_s),
            _ => None,
        })
        .collect();
    assert!(times.is_sorted(), "{times:?}");
    let dropped = received.last().unwrap().dropped as usize;
    assert!(dropped > 0, "400 frames of 400 kB do not fit into the buffers");
    assert_eq!(times.len() + dropped, NUM_FRAMES + 1, "every frame arrived or was counted");
    let jobs = received.iter().filter(|message| matches!(message.message, Some(Kind::Job(_)))).count();
    assert_eq!(jobs, 1, "job updates are not dropped");
}

#[tokio::test(flavor = "multi_thread")]
async fn calibration_reports_to_the_stream() {
    let data = Data::with_session();
    let state = data.state();
    let mut socket = connect(&state).await;
    state.hub().publish_live(LiveFrame::default());
    next(&mut socket).await;
    let router = app(state.clone());
    let run = post(&router, "/api/v1/calibrations", &serde_json::json!({"session": "taps"})).await;
    assert_eq!(run.status, 202);
    let mut states = Vec::new();
    let mut last_fraction = 0.0;
    loop {
        let Some(Kind::Job(update)) = next(&mut socket).await.message else { continue };
        assert!(update.fraction >= last_fraction, "the bar went back");
        last_fraction = update.fraction;
        states.push(update.state.clone());
        if update.state == "done" {
            break;
        }
    }
    assert_eq!(last_fraction, 1.0);
    assert!(states.contains(&"running".to_owned()), "{states:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn late_client_gets_the_newest_frame_and_a_close_at_the_end() {
    let data = Data::empty();
    let state = data.state();
    state.hub().publish_live(LiveFrame { time_s: 1.0, ..LiveFrame::default() });
    state.hub().publish_live(LiveFrame { time_s: 2.0, ..LiveFrame::default() });
    let mut socket = connect(&state).await;
    let Some(Kind::Live(frame)) = next(&mut socket).await.message else { panic!("expected a live frame") };
    assert_eq!(frame.time_s, 2.0);
    state.begin_shutdown();
    let message = timeout(Duration::from_secs(10), socket.next()).await.unwrap();
    assert!(matches!(message, Some(Ok(Message::Close(_)))), "{message:?}");
}

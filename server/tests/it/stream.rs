//! The stream socket.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use futures_util::StreamExt as _;
use palpate_server::{AppState, app};
use palpate_wire::{
    api::SessionSummary,
    proto::{JobUpdate, LiveFrame, StreamMessage, stream_message::Message as Kind},
};
use prost::Message as _;
use serde_json::json;
use tokio::{net::TcpListener, time::timeout};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async, tungstenite::Message};

use crate::support::{Data, get, post};

type Socket = WebSocketStream<MaybeTlsStream<tokio::net::TcpStream>>;

async fn connect(state: &Arc<AppState>) -> Socket {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("ws://{}/api/v1/stream", listener.local_addr().unwrap());
    let router = app(state.clone());
    tokio::spawn(async move { axum::serve(listener, router).await.unwrap() });
    connect_async(url).await.unwrap().0
}

async fn next(socket: &mut Socket) -> StreamMessage {
    loop {
        let message =
            timeout(Duration::from_secs(60), socket.next()).await.expect("a message within a minute");
        match message.unwrap().unwrap() {
            Message::Binary(bytes) => return StreamMessage::decode(bytes).unwrap(),
            Message::Ping(_) => {}
            other => panic!("expected a binary message, found {other:?}"),
        }
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
async fn a_client_that_reads_slowly_sees_recent_frames_and_one_beside_it_sees_all() {
    const NUM_FRAMES: u32 = 180;
    const FRAME: Duration = Duration::from_millis(33);
    const PAUSE: Duration = Duration::from_millis(500);
    /// The client's own pause, and what waits in its queue; then a machine that is busy with other tests.
    const MOST_AGE: Duration = Duration::from_millis(500 + 8 * 33 + 700);
    let data = Data::empty();
    let state = data.state();
    let (mut slow, mut fast) = (connect(&state).await, connect(&state).await);
    let begun = Instant::now();
    let frame =
        || LiveFrame { time_s: begun.elapsed().as_secs_f64(), raw: vec![0.5; 400], ..LiveFrame::default() };
    state.hub().publish_live(frame());
    // Whoever joins is there once the first message has arrived.
    next(&mut slow).await;
    next(&mut fast).await;

    let slowly = tokio::spawn(async move {
        let (mut ages, mut last) = (Vec::new(), StreamMessage::default());
        while begun.elapsed() < NUM_FRAMES * FRAME {
            tokio::time::sleep(PAUSE).await;
            last = next(&mut slow).await;
            let Some(Kind::Live(frame)) = &last.message else { panic!("expected a live frame") };
            ages.push(begun.elapsed().as_secs_f64() - frame.time_s);
        }
        (ages, last)
    });
    let at_once = tokio::spawn(async move {
        let mut times = Vec::new();
        while times.len() < NUM_FRAMES as usize {
            let message = next(&mut fast).await;
            assert_eq!(message.dropped, 0, "a client that reads at once lost frames");
            let Some(Kind::Live(frame)) = message.message else { panic!("expected a live frame") };
            times.push(frame.time_s);
        }
        times
    });
    for _ in 0..NUM_FRAMES {
        tokio::time::sleep(FRAME).await;
        state.hub().publish_live(frame());
    }
    let times = at_once.await.unwrap();
    let (ages, last) = slowly.await.unwrap();
    eprintln!("ages at the slow client, s: {ages:.2?}");
    assert!(ages.iter().all(|&age| age < MOST_AGE.as_secs_f64()), "{ages:.2?}");
    // What it did not get, it was told of: of all frames up to its last one, the first of which came before the others.
    let Some(Kind::Live(frame)) = &last.message else { panic!("expected a live frame") };
    let until_then = times.iter().filter(|&&time_s| time_s <= frame.time_s).count();
    assert_eq!(ages.len() + last.dropped as usize, until_then);
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
    let message = loop {
        match timeout(Duration::from_secs(10), socket.next()).await.unwrap() {
            Some(Ok(Message::Ping(_))) => {}
            other => break other,
        }
    };
    assert!(matches!(message, Some(Ok(Message::Close(_)))), "{message:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_a_job_made_is_told_of_once_it_can_be_listed() {
    let data = Data::empty();
    let state = data.state();
    let mut socket = connect(&state).await;
    state.hub().publish_live(large_frame(0));
    next(&mut socket).await;
    let app = app(state.clone());
    let request = json!({ "kind": "emulate", "request": { "truth": "bench", "session": "made" } });
    assert_eq!(post(&app, "/api/v1/jobs", &request).await.status, 202);
    let told = loop {
        if let Some(Kind::Changed(changed)) = next(&mut socket).await.message {
            break changed;
        }
    };
    assert_eq!((told.list.as_str(), told.id.as_str()), ("sessions", "made"));
    let sessions: Vec<SessionSummary> = get(&app, "/api/v1/sessions").await.json();
    assert_eq!(sessions.iter().map(|session| session.id.as_str()).collect::<Vec<_>>(), ["made"]);
}

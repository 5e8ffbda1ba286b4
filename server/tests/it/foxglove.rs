//! The socket of Foxglove's protocol, on a live emulated station.

use std::{collections::BTreeMap, path::Path, sync::Arc, time::Duration};

use axum::http::{StatusCode, header};
use futures_util::{SinkExt as _, StreamExt as _};
use palpate_messages::{
    foxglove::{FrameTransforms, JointStates},
    proto::TactileSample,
};
use palpate_server::{AppState, LiveStation, Studio, app, assets};
use palpate_wire::proto::LiveFrame;
use prost::Message as _;
use serde_json::{Value, json};
use tokio::{net::TcpListener, time::timeout};
use tokio_tungstenite::{
    MaybeTlsStream, WebSocketStream, connect_async,
    tungstenite::{self, Message, client::IntoClientRequest as _},
};

use crate::support::{Data, access};

const PROTOCOL: &str = "foxglove.sdk.v1";

struct Client {
    socket: WebSocketStream<MaybeTlsStream<tokio::net::TcpStream>>,
}

/// Serves `state` and gives the address.
async fn serve(state: &Arc<AppState>) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let router = app(state.clone());
    tokio::spawn(async move { axum::serve(listener, router).await.unwrap() });
    address
}

impl Client {
    async fn connect(address: &str, protocol: Option<&str>) -> Result<Self, (StatusCode, String)> {
        let mut request = format!("ws://{address}/api/v1/foxglove").into_client_request().unwrap();
        if let Some(protocol) = protocol {
            request.headers_mut().insert(header::SEC_WEBSOCKET_PROTOCOL, protocol.parse().unwrap());
        }
        match connect_async(request).await {
            Ok((socket, answer)) => {
                assert_eq!(answer.headers()[header::SEC_WEBSOCKET_PROTOCOL], protocol.unwrap());
                Ok(Self { socket })
            }
            Err(tungstenite::Error::Http(answer)) => {
                let body = answer.body().clone().unwrap_or_default();
                Err((answer.status(), String::from_utf8_lossy(&body).into_owned()))
            }
            Err(err) => panic!("{err}"),
        }
    }

    async fn next(&mut self) -> Message {
        loop {
            let message =
                timeout(Duration::from_secs(60), self.socket.next()).await.expect("a message in a minute");
            match message.unwrap().unwrap() {
                Message::Ping(_) => {}
                message => return message,
            }
        }
    }

    async fn text(&mut self) -> Value {
        loop {
            if let Message::Text(text) = self.next().await {
                return serde_json::from_str(&text).unwrap();
            }
        }
    }

    /// The next message: subscription, time in ns, payload.
    async fn data(&mut self) -> (u32, u64, Vec<u8>) {
        loop {
            if let Message::Binary(bytes) = self.next().await {
                assert_eq!(bytes[0], 1);
                let subscription = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
                let time_ns = u64::from_le_bytes(bytes[5..13].try_into().unwrap());
                return (subscription, time_ns, bytes[13..].to_vec());
            }
        }
    }

    async fn say(&mut self, text: &Value) {
        self.socket.send(Message::text(text.to_string())).await.unwrap();
    }

    async fn subscribe(&mut self, id: u32, channel: &Value) {
        self.say(&json!({ "op": "subscribe", "subscriptions": [{ "id": id, "channelId": channel["id"] }] }))
            .await;
    }
}

/// Channels by topic.
async fn channels(client: &mut Client) -> BTreeMap<String, Value> {
    let info = client.text().await;
    assert_eq!(info["op"], "serverInfo");
    assert!(info["name"].as_str().unwrap().starts_with("palpate"));
    let advertised = client.text().await;
    assert_eq!(advertised["op"], "advertise");
    let channels = advertised["channels"].as_array().unwrap();
    channels.iter().map(|channel| (channel["topic"].as_str().unwrap().to_owned(), channel.clone())).collect()
}

/// A frame that fills the sockets' buffers soon: 400 kB.
fn large_frame(idx: usize) -> LiveFrame {
    LiveFrame { time_s: 1e6 + idx as f64, raw: vec![0.5; 100_000], ..LiveFrame::default() }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_sees_joints_touch_and_frames_of_the_live_station() {
    let data = Data::empty();
    let (truth, _unpacked) = assets::truth(Path::new("small")).unwrap();
    let studio = Studio::open(data.root(), Some(&LiveStation::Emulated(truth)), access()).unwrap();
    let address = serve(&studio.state).await;

    let (status, body) = Client::connect(&address, None).await.err().expect("it wants the protocol");
    assert_eq!(status, StatusCode::BAD_REQUEST);
    assert!(body.contains(PROTOCOL), "{body}");

    let mut client =
        Client::connect(&address, Some(PROTOCOL)).await.unwrap_or_else(|refused| panic!("{refused:?}"));
    let channels = channels(&mut client).await;
    for channel in channels.values() {
        assert_eq!(
            (&channel["encoding"], &channel["schemaEncoding"]),
            (&json!("protobuf"), &json!("protobuf"))
        );
        assert!(!channel["schema"].as_str().unwrap().is_empty(), "{channel}");
    }
    let touch_topic = channels.keys().find(|topic| topic.starts_with("/tactile/")).unwrap();
    for (id, topic) in ["/joint_states", "/tf", touch_topic].into_iter().enumerate() {
        client.subscribe(id as u32 + 10, &channels[topic]).await;
    }
    let mut times: BTreeMap<u32, Vec<u64>> = BTreeMap::new();
    while times.len() < 3 || times.values().any(|times| times.len() < 5) {
        let (subscription, time_ns, payload) = client.data().await;
        times.entry(subscription).or_default().push(time_ns);
        match subscription {
            10 => {
                let joints = JointStates::decode(payload.as_slice()).unwrap().joints;
                assert!(!joints.is_empty() && joints.iter().all(|joint| !joint.name.is_empty()));
            }
            11 => assert!(!FrameTransforms::decode(payload.as_slice()).unwrap().transforms.is_empty()),
            12 => {
                let sample = TactileSample::decode(payload.as_slice()).unwrap();
                assert!(!sample.active.is_empty());
                assert_eq!(sample.active.len(), sample.raw.len());
            }
            other => panic!("nobody subscribed as {other}"),
        }
    }
    for times in times.values() {
        assert!(times.is_sorted_by(|before, after| before < after), "{times:?}");
    }

    // What makes no sense is answered, and the socket goes on.
    client.say(&json!({ "op": "subscribe", "subscriptions": [{ "id": 1, "channelId": 99 }] })).await;
    let told = client.text().await;
    assert_eq!((&told["op"], &told["level"]), (&json!("status"), &json!(2)));
    assert!(told["message"].as_str().unwrap().contains("no channel 99"), "{told}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_does_not_read_loses_frames_and_is_told() {
    const NUM_FRAMES: usize = 300;
    let data = Data::empty();
    let (truth, _unpacked) = assets::truth(Path::new("small")).unwrap();
    let studio = Studio::open(data.root(), Some(&LiveStation::Emulated(truth)), access()).unwrap();
    let address = serve(&studio.state).await;
    let mut client =
        Client::connect(&address, Some(PROTOCOL)).await.unwrap_or_else(|refused| panic!("{refused:?}"));
    let channels = channels(&mut client).await;
    client.subscribe(1, &channels["/live"]).await;
    client.data().await;
    // It reads nothing meanwhile.
    for idx in 0..NUM_FRAMES {
        studio.state.hub().publish_live(large_frame(idx));
        // Longer than the server needs to fill the buffers.
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    let mut large = 0;
    loop {
        match client.next().await {
            Message::Text(text) => {
                let told: Value = serde_json::from_str(&text).unwrap();
                assert_eq!((&told["op"], &told["level"]), (&json!("status"), &json!(1)));
                assert!(told["message"].as_str().unwrap().contains("frames were dropped"), "{told}");
                break;
            }
            Message::Binary(bytes) => large += usize::from(bytes.len() > 100_000),
            other => panic!("{other:?}"),
        }
    }
    assert!(large < NUM_FRAMES, "300 frames of 400 kB do not fit into the buffers");
}

#[tokio::test]
async fn without_a_live_station_there_is_nothing_to_watch() {
    let data = Data::empty();
    let address = serve(&data.state()).await;
    let (status, body) = Client::connect(&address, Some(PROTOCOL)).await.err().expect("nothing is live");
    assert_eq!(status, StatusCode::NOT_FOUND);
    assert!(body.contains("--emulate"), "{body}");
}

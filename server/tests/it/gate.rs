//! Nobody moves the hand but whoever holds it, and nobody comes in who should not: every route and socket is tried.

use std::{path::Path, sync::Arc, time::Duration};

use axum::{
    Router,
    body::Body,
    http::{Method, Request, StatusCode, header},
};
use futures_util::{SinkExt as _, StreamExt as _};
use http_body_util::BodyExt as _;
use palpate_server::{AppState, LiveStation, NeedsLease, Studio, app, assets, routes, serve_on};
use palpate_wire::{
    api::{LEASE_HEADER, LiveDocument, ProblemDetails, RecordingDocument},
    proto::{
        Acquire, Arm, ClearFault, ControlReply, ControlRequest, Disarm, Heartbeat, LeadThrough, ObjectPose,
        Release, ResetStop, Tare, Targets, control_request::Request as Command,
    },
};
use prost::Message as _;
use serde_json::{Value, json};
use tokio::{net::TcpListener, sync::Mutex, task::JoinHandle, time::sleep};
use tokio_tungstenite::{
    MaybeTlsStream, WebSocketStream, connect_async,
    tungstenite::{Message, client::IntoClientRequest as _},
};
use tower::ServiceExt as _;

use crate::support::{access, get};

/// An emulated station, its service on a port, and an operator who has armed it and begun a session.
struct Scene {
    data: tempfile::TempDir,
    state: Arc<AppState>,
    app: Router,
    url: String,
    operator: Arc<Mutex<Client>>,
    heart: JoinHandle<()>,
    _studio: Studio,
}

struct Client {
    socket: WebSocketStream<MaybeTlsStream<tokio::net::TcpStream>>,
    sequence: u64,
    lease: u64,
}

impl Client {
    async fn connect(url: &str) -> Self {
        Self { socket: connect_async(url).await.unwrap().0, sequence: 0, lease: 0 }
    }

    async fn ask_under(&mut self, lease: u64, command: Command) -> ControlReply {
        self.sequence += 1;
        let request = ControlRequest { sequence: self.sequence, lease, request: Some(command) };
        self.socket.send(Message::Binary(request.encode_to_vec().into())).await.unwrap();
        loop {
            if let Message::Binary(bytes) = self.socket.next().await.unwrap().unwrap() {
                let reply = ControlReply::decode(bytes).unwrap();
                if reply.sequence == self.sequence {
                    return reply;
                }
            }
        }
    }

    async fn ask(&mut self, command: Command) -> ControlReply {
        let reply = self.ask_under(self.lease, command).await;
        self.lease = reply.lease;
        reply
    }
}

impl Scene {
    async fn new() -> Self {
        let data = tempfile::tempdir().unwrap();
        let (truth, _unpacked) = assets::truth(Path::new("small")).unwrap();
        let station = LiveStation::Emulated(truth);
        let studio = Studio::open(data.path(), Some(&station), access()).unwrap();
        let state = studio.state.clone();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("ws://{}/api/v1/control", listener.local_addr().unwrap());
        tokio::spawn(serve_on(listener, state.clone(), std::future::pending()));
        let app = app(state.clone());
        loop {
            let live: LiveDocument = get(&app, "/api/v1/live").await.json();
            if !live.devices.is_empty() && live.devices.iter().all(|device| device.link == "ready") {
                break;
            }
            sleep(Duration::from_millis(20)).await;
        }
        let mut operator = Client::connect(&url).await;
        let acquire = Acquire { operator: "Ada".to_owned(), take_over: false };
        assert!(operator.ask(Command::Acquire(acquire)).await.accepted);
        let operator = Arc::new(Mutex::new(operator));
        let heart = tokio::spawn({
            let operator = operator.clone();
            async move {
                loop {
                    operator.lock().await.ask(Command::Heartbeat(Heartbeat {})).await;
                    sleep(Duration::from_millis(25)).await;
                }
            }
        });
        let scene = Self { data, state, app, url, operator, heart, _studio: studio };
        let lease = scene.operator.lock().await.lease;
        assert_ne!(lease, 0);
        let begun = scene.send(Method::POST, "/recording", Some(lease), begin("monday")).await;
        assert_eq!(begun.0, StatusCode::OK, "{}", begun.1);
        let placed = json!({ "action": "confirm_object", "fixture_trusted": true });
        assert_eq!(scene.send(Method::POST, "/recording/act", Some(lease), placed).await.0, StatusCode::OK);
        loop {
            let armed = scene.operator.lock().await.ask(Command::Arm(Arm {})).await;
            let live: LiveDocument = get(&scene.app, "/api/v1/live").await.json();
            if armed.accepted && live.phase == "armed" {
                return scene;
            }
            sleep(Duration::from_millis(100)).await;
        }
    }

    async fn send(
        &self,
        method: Method,
        path: &str,
        lease: Option<u64>,
        body: Value,
    ) -> (StatusCode, String) {
        let lease = lease.map(|lease| (LEASE_HEADER, lease.to_string()));
        self.send_as("localhost", lease.into_iter().collect(), method, path, body).await
    }

    async fn send_as(
        &self,
        host: &str,
        headers: Vec<(&str, String)>,
        method: Method,
        path: &str,
        body: Value,
    ) -> (StatusCode, String) {
        let mut request =
            Request::builder().method(method).uri(format!("/api/v1{path}")).header(header::HOST, host);
        for (name, value) in headers {
            request = request.header(name, value);
        }
        let (content_type, body) = match body {
            Value::String(text) => ("application/toml", text),
            body => ("application/json", body.to_string()),
        };
        let request = request.header(header::CONTENT_TYPE, content_type).body(Body::from(body)).unwrap();
        let response = self.app.clone().oneshot(request).await.unwrap();
        let status = response.status();
        let body = response.into_body().collect().await.unwrap().to_bytes();
        (status, String::from_utf8_lossy(&body).into_owned())
    }

    fn positions(&self) -> Vec<f64> {
        self.state.emulated_station().unwrap().snapshot().positions
    }

    async fn recording(&self) -> RecordingDocument {
        get(&self.app, "/api/v1/recording").await.json()
    }
}

impl Drop for Scene {
    fn drop(&mut self) {
        self.heart.abort();
    }
}

fn begin(session: &str) -> Value {
    json!({ "plan": "quick_check", "session": session, "operator": "" })
}

fn take(session: &str) -> Value {
    json!({ "session": session, "object": "sphere_50mm", "object_pose": [0.4, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0] })
}

/// Paths and bodies that make sense for a route, so that nothing but who asks is in the way. A new route without an entry is
/// asked with an empty document.
fn attempts(path: &str) -> Vec<(String, Value)> {
    let filled =
        path.replace("{session}", "monday").replace("{object}", "sphere_50mm").replace("{primitive}", "tap");
    let filled = filled.replace("{take}", "take-01").replace("{model}", "nominal").replace("{run}", "run-1");
    let filled = filled.replace("{job}", "run-1").replace("{file}", "report.json");
    let bodies = match path {
        "/recording" => vec![begin("tuesday")],
        "/recording/act" => [
            "confirm_object", "go_to_start", "run", "cancel", "accept", "again", "discard", "undo", "select", "note",
            "leave",
        ]
        .map(|action| json!({ "action": action, "fixture_trusted": true, "step": 1, "text": "me", "lease": 1 }))
        .to_vec(),
        "/recording/take" => vec![take("tuesday")],
        "/recording/take/act" => vec![json!({ "action": "end" })],
        "/recording/wanted" => {
            vec![json!({ "object": "sphere_50mm", "primitive": "quick_tap", "because": "I want it" })]
        }
        "/emulator/faults" => vec![Value::String("[[fault]]\nkind = \"unplug\"\ndevice = \"u2d2\"\n".to_owned())],
        "/emulator/object" => vec![json!({ "object": "cylinder_25x100mm" })],
        "/live/model" => vec![json!({ "model": "nominal" })],
        _ => vec![json!({})],
    };
    bodies.into_iter().map(|body| (filled.clone(), body)).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_second_client_moves_nothing_and_changes_no_session_by_any_route_with_any_lease() {
    let scene = Scene::new().await;
    let (positions, recording) = (scene.positions(), scene.recording().await);
    let mine = scene.operator.lock().await.lease;
    let table = routes(&scene.state);
    let mut num_guarded = 0;
    for route in &table {
        for (path, body) in attempts(route.path) {
            let try_it = |lease| scene.send(route.method.clone(), &path, lease, body.clone());
            if route.needs.lease == NeedsLease::No {
                if route.method != Method::GET {
                    // Whatever it does, it does nothing to the robot and its session.
                    try_it(Some(1)).await;
                }
                continue;
            }
            num_guarded += 1;
            // What a page can see holds no number; those around the real one are tried too.
            let near = [None, Some(mine.wrapping_add(1)), Some(mine.wrapping_sub(1)), Some(u64::MAX)];
            let is_motion = body["action"] == "go_to_start" || body["action"] == "run";
            let most = if is_motion { 10_000 } else { 300 };
            for lease in near.into_iter().chain((0..=most).map(Some)) {
                let (status, text) = try_it(lease).await;
                assert_eq!(
                    status,
                    StatusCode::FORBIDDEN,
                    "{} {path} {body} under {lease:?}: {text}",
                    route.method
                );
                let problem: ProblemDetails = serde_json::from_str(&text).unwrap();
                let detail = problem.detail;
                assert!(detail.contains("only the operator may") && detail.contains("\"Ada\""), "{detail}");
            }
            let (status, _) = scene
                .send_as(
                    "localhost",
                    vec![(LEASE_HEADER, "0x10".into())],
                    route.method.clone(),
                    &path,
                    body.clone(),
                )
                .await;
            assert_eq!(status, StatusCode::BAD_REQUEST, "a lease is a number");
        }
    }
    assert!(num_guarded >= 16, "{num_guarded} of {} routes", table.len());

    // And by the socket, on which it is somebody else.
    let mut stranger = Client::connect(&scene.url).await;
    let commands = || {
        [
            Command::Release(Release {}),
            Command::Heartbeat(Heartbeat {}),
            Command::Arm(Arm {}),
            Command::Disarm(Disarm {}),
            Command::ResetStop(ResetStop {}),
            Command::Targets(Targets { dofs: vec![0, 7], positions: vec![0.5, 0.5] }),
            Command::LeadThrough(LeadThrough { on: true }),
            Command::ClearFault(ClearFault { device: "xarm".to_owned() }),
            Command::Tare(Tare {}),
            Command::ObjectPose(ObjectPose::default()),
            Command::Acquire(Acquire { operator: "Eve".to_owned(), take_over: false }),
        ]
    };
    for lease in [0, 1, 2, mine, mine.wrapping_add(1), u64::MAX] {
        for command in commands() {
            let reply = stranger.ask_under(lease, command.clone()).await;
            assert!(
                !reply.accepted && !reply.problem.is_empty() && reply.lease == 0,
                "{command:?}: {reply:?}"
            );
        }
    }

    assert_eq!(scene.recording().await, recording);
    let live: LiveDocument = get(&scene.app, "/api/v1/live").await.json();
    assert_eq!(live.holder, "Ada");
    let after = scene.positions();
    sleep(Duration::from_millis(1200)).await;
    let audit = std::fs::read_to_string(scene.data.path().join("audit.jsonl")).unwrap();
    // On a busy machine a test's heartbeats are late at times, and so is what the servos hear and say; fingers that were let go
    // for that sink by themselves, and the arm, which has brakes, stays.
    let was_let_go = ["heard of the operator", "the line was silent", "was last read"]
        .iter()
        .any(|why| audit.contains(why) || live.reason.contains(why));
    assert!(was_let_go || live.phase == "armed", "{}", live.reason);
    let carrier = &scene.state.emulated_station().unwrap().station().carrier_dofs;
    for (dof, (before, after)) in positions.iter().zip(&after).enumerate() {
        let may_sink = was_let_go && !carrier.contains(&dof);
        assert!(may_sink || (before - after).abs() < 0.02, "joint {dof} moved from {before} to {after}");
    }
    for what in [
        "begin a session: refused",
        "go to the start pose: refused",
        "run a motion: refused",
        "accept a take: refused",
        "leave the session: refused",
        "ask for a take: refused",
        "take back what was asked for: refused",
        "give emulated devices other faults: refused",
        "place an object on the emulated station: refused",
        "move joints: refused",
        "lead the arm by hand: refused",
        "run a motion: refused ",
        " times more",
    ] {
        let line = audit
            .lines()
            .find(|line| line.contains(what))
            .unwrap_or_else(|| panic!("{what} is not in {audit}"));
        assert!(line.contains("http from") || line.contains("control "), "{line}");
    }
    assert!(!audit.contains(&mine.to_string()), "the log tells nobody the number");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn no_page_of_another_origin_and_no_foreign_name_comes_in() {
    let scene = Scene::new().await;
    let mine = scene.operator.lock().await.lease.to_string();
    for route in routes(&scene.state) {
        for (path, body) in attempts(route.path) {
            let lease = (LEASE_HEADER, mine.clone());
            let (status, text) = scene
                .send_as("evil.example", vec![lease.clone()], route.method.clone(), &path, body.clone())
                .await;
            assert_eq!(status, StatusCode::MISDIRECTED_REQUEST, "{} {path}: {text}", route.method);
            if route.method == Method::GET {
                continue;
            }
            for origin in ["https://evil.example", "null", "http://localhost:1"] {
                let headers = vec![lease.clone(), ("origin", origin.to_owned())];
                let (status, text) =
                    scene.send_as("localhost:8080", headers, route.method.clone(), &path, body.clone()).await;
                assert_eq!(status, StatusCode::FORBIDDEN, "{} {path} from {origin}: {text}", route.method);
                assert!(text.contains("another origin"), "{text}");
            }
        }
    }
    for socket in ["control", "stream"] {
        let url = scene.url.replace("control", socket);
        for (name, value, status) in
            [("origin", "http://evil.example", 403), ("origin", "null", 403), ("host", "evil.example", 421)]
        {
            let mut request = url.as_str().into_client_request().unwrap();
            request.headers_mut().insert(name, value.parse().unwrap());
            let refused = connect_async(request).await.unwrap_err().to_string();
            assert!(refused.contains(&status.to_string()), "{socket}, {name} {value}: {refused}");
        }
        let mut request = url.as_str().into_client_request().unwrap();
        let own = request.headers()["host"].to_str().unwrap().to_owned();
        request.headers_mut().insert("origin", format!("http://{own}").parse().unwrap());
        connect_async(request).await.unwrap();
    }
    let live: LiveDocument = get(&scene.app, "/api/v1/live").await.json();
    assert_eq!(live.holder, "Ada");
}

#[tokio::test]
async fn answers_carry_a_policy_for_browsers_and_no_path_of_this_computer() {
    let data = crate::support::Data::with_session();
    let app = data.app();
    for (path, policy) in [("/api/v1/info", "default-src 'none'"), ("/", "script-src 'self'")] {
        let answer = get(&app, path).await;
        let policies = answer.header(header::CONTENT_SECURITY_POLICY);
        assert!(policies.contains(policy) && policies.contains("frame-ancestors 'none'"), "{policies}");
        assert_eq!(answer.header(header::X_FRAME_OPTIONS), "DENY");
        assert_eq!(answer.header(header::X_CONTENT_TYPE_OPTIONS), "nosniff");
    }
    data.truncate_take();
    let detail = get(&app, "/api/v1/sessions/taps/check").await;
    let shown = String::from_utf8_lossy(&detail.body).into_owned();
    let root = data.session().parent().unwrap().parent().unwrap().canonicalize().unwrap();
    assert!(!shown.contains(root.to_str().unwrap()), "{shown}");
    // A folder in the place of a file cannot be read, whatever the route.
    std::fs::create_dir(root.join("models").join("odd.toml")).unwrap();
    let shown = get(&app, "/api/v1/models/odd").await;
    let shown = String::from_utf8_lossy(&shown.body).into_owned();
    assert!(!shown.contains(root.to_str().unwrap()), "{shown}");
}

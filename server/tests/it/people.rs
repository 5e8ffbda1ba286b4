//! Who may do what: every route with every kind of login and token that is not good enough, through the real service.

use std::{path::Path, sync::Arc, time::Duration};

use axum::http::{HeaderName, Request, StatusCode, header};
use futures_util::{SinkExt as _, StreamExt as _};
use http_body_util::BodyExt as _;
use hyper::client::conn::http1::handshake;
use hyper_util::rt::TokioIo;
use palpate_people::{TokenRequest, now_s};
use palpate_server::{
    Access, AppState, LiveStation, NeedsLease, Route, Studio, app, assets, root_routes, routes, serve_on,
};
use palpate_wire::{
    api::{LiveDocument, Me, Role, Scope},
    proto::{
        Acquire, ControlReply, ControlRequest, Heartbeat, Stop, Targets, control_request::Request as Command,
    },
};
use prost::Message as _;
use serde_json::{Value, json};
use tokio::{
    net::{TcpListener, TcpStream},
    sync::oneshot,
    task::JoinHandle,
    time::sleep,
};
use tokio_tungstenite::{
    MaybeTlsStream, WebSocketStream, connect_async,
    tungstenite::{self, client::IntoClientRequest as _},
};

use crate::support::{Answer, Data, access};

const PASSWORD: &str = "correct horse battery";
const DAY_S: i64 = 86_400;

/// A studio on a port where everybody has to log in.
struct House {
    state: Arc<AppState>,
    address: String,
    stop: oneshot::Sender<()>,
    served: JoinHandle<()>,
    _studio: Studio,
}

impl House {
    async fn new(data: &Path, station: Option<&LiveStation>) -> Self {
        let studio = Studio::open(data, station, Access { login: true, ..access() }).unwrap();
        let state = studio.state.clone();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let (stop, stopped) = oneshot::channel();
        let stopped = async {
            // A test that ends needs no end of its studio.
            let _ = stopped.await;
        };
        let served = tokio::spawn(serve_on(listener, state.clone(), stopped));
        for role in Role::ALL {
            if !state.people().list().iter().any(|person| person.role == role) {
                state.people().add(&format!("{role}-ann"), role, PASSWORD, now_s()).unwrap();
            }
        }
        Self { state, address, stop, served, _studio: studio }
    }

    /// Ends the studio, so that another one can open its folder.
    async fn end(self) {
        let Self { stop, served, .. } = self;
        stop.send(()).unwrap();
        served.await.unwrap();
    }

    /// The header of a login of this role.
    fn cookie(&self, role: Role) -> (HeaderName, String) {
        let login = self.state.people().log_in(&format!("{role}-ann"), PASSWORD, now_s()).unwrap();
        cookie(&login.secret)
    }

    /// The header of a token of this role.
    fn token(&self, role: Role, scopes: Option<&[Scope]>) -> (HeaderName, String) {
        let person = format!("{role}-ann");
        let request = TokenRequest { person: &person, name: "test", role: None, scopes, expires_days: 1 };
        bearer(&self.state.people().create_token(&request, now_s()).unwrap().1)
    }

    /// Sends a request over a connection of its own.
    async fn send(&self, method: &str, path: &str, headers: &[(HeaderName, String)], body: &str) -> Answer {
        let mut request = Request::builder().method(method).uri(path).header(header::HOST, &self.address);
        for (name, value) in headers {
            request = request.header(name, value);
        }
        if !headers.iter().any(|(name, _)| name == header::CONTENT_TYPE) {
            request = request.header(header::CONTENT_TYPE, "application/json");
        }
        let request = request.body(body.to_owned()).unwrap();
        let stream = TcpStream::connect(&self.address).await.unwrap();
        let (mut sender, connection) = handshake(TokioIo::new(stream)).await.unwrap();
        // Whoever waits for the answer hears of what goes wrong.
        tokio::spawn(async { drop(connection.await) });
        let (head, body) = sender.send_request(request).await.unwrap().into_parts();
        Answer { status: head.status, headers: head.headers, body: body.collect().await.unwrap().to_bytes() }
    }

    async fn socket(&self, path: &str, headers: &[(HeaderName, String)]) -> Result<Socket, StatusCode> {
        let mut request = format!("ws://{}/api/v1{path}", self.address).into_client_request().unwrap();
        for (name, value) in headers {
            request.headers_mut().insert(name.clone(), value.parse().unwrap());
        }
        match connect_async(request).await {
            Ok((socket, _)) => Ok(Socket { socket, sequence: 0, lease: 0 }),
            Err(tungstenite::Error::Http(response)) => Err(response.status()),
            Err(err) => panic!("{err}"),
        }
    }

    /// The lines of the audit log, newest last.
    async fn audit(&self) -> Vec<Value> {
        let answer = self.send("GET", "/api/v1/audit", &[self.cookie(Role::Viewer)], "").await;
        let text = String::from_utf8(answer.body.to_vec()).unwrap();
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }
}

fn cookie(secret: &str) -> (HeaderName, String) {
    (header::COOKIE, format!("theme=dark; __Host-palpate={secret}"))
}

fn bearer(secret: &str) -> (HeaderName, String) {
    (header::AUTHORIZATION, format!("Bearer {secret}"))
}

struct Socket {
    socket: WebSocketStream<MaybeTlsStream<TcpStream>>,
    sequence: u64,
    lease: u64,
}

impl Socket {
    async fn ask(&mut self, command: Command) -> ControlReply {
        self.sequence += 1;
        let request = ControlRequest { sequence: self.sequence, lease: self.lease, request: Some(command) };
        self.socket.send(tungstenite::Message::Binary(request.encode_to_vec().into())).await.unwrap();
        loop {
            if let tungstenite::Message::Binary(bytes) = self.socket.next().await.unwrap().unwrap() {
                let reply = ControlReply::decode(bytes).unwrap();
                if reply.sequence == self.sequence {
                    self.lease = reply.lease;
                    return reply;
                }
            }
        }
    }

    /// Reads until the studio closes the socket, and gives its reason.
    async fn closed_because(mut self) -> String {
        loop {
            match self.socket.next().await {
                Some(Ok(tungstenite::Message::Close(Some(close)))) => return close.reason.to_string(),
                Some(Ok(_)) => {}
                other => panic!("ended without a word: {other:?}"),
            }
        }
    }
}

/// Every route with a path that names nothing that exists.
fn table(state: &AppState) -> Vec<(Route, String)> {
    let of = |prefix: &str, routes: Vec<Route>| {
        let filled = |path: &str| {
            let mut filled = path.to_owned();
            for name in [
                "session",
                "take",
                "model",
                "run",
                "job",
                "file",
                "object",
                "primitive",
                "person",
                "campaign",
                "doc",
                "picture",
            ] {
                filled = filled.replace(&format!("{{{name}}}"), "no-such-thing");
            }
            let filled = filled.replace("{token}", "999999").replace("{trial}", "999999");
            assert!(!filled.contains('{'), "{filled}: say what to put there");
            format!("{prefix}{filled}")
        };
        routes.into_iter().map(|route| (route.clone(), filled(route.path))).collect::<Vec<_>>()
    };
    [of("/api/v1", routes(state)), of("", root_routes(state))].concat()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn every_route_refuses_no_forged_expired_revoked_and_wrong_role_tokens_and_cookies() {
    let data = Data::empty();
    let house = House::new(data.root(), None).await;
    let people = house.state.people().clone();
    let admin = "admin-ann";
    let token_at = |now_s, name| {
        let request = TokenRequest { person: admin, name, role: None, scopes: None, expires_days: 1 };
        people.create_token(&request, now_s).unwrap()
    };
    let live_cookie = people.log_in(admin, PASSWORD, now_s()).unwrap().secret;
    let (_, live_token) = token_at(now_s(), "live");
    let (revoked, revoked_token) = token_at(now_s(), "revoked");
    people.revoke(revoked.id, None).unwrap();
    let logged_out = people.log_in(admin, PASSWORD, now_s()).unwrap();
    people.log_out(&logged_out.principal).unwrap();
    let (_, expired_token) = token_at(now_s() - 2 * DAY_S, "expired");
    // The newest, since each login removes those that have expired.
    let by_role: Vec<_> =
        Role::ALL.into_iter().map(|role| (role, [house.cookie(role), house.token(role, None)])).collect();
    let expired_cookie = people.log_in(admin, PASSWORD, now_s() - 8 * DAY_S).unwrap().secret;
    let flipped = |secret: &str| {
        let last = if secret.ends_with('0') { '1' } else { '0' };
        format!("{}{last}", &secret[..secret.len() - 1])
    };
    let strangers: Vec<(&str, Vec<(HeaderName, String)>)> = vec![
        ("nothing", vec![]),
        ("a forged token", vec![bearer(&flipped(&live_token))]),
        ("a forged cookie", vec![cookie(&flipped(&live_cookie))]),
        ("an expired token", vec![bearer(&expired_token)]),
        ("an expired cookie", vec![cookie(&expired_cookie)]),
        ("a revoked token", vec![bearer(&revoked_token)]),
        ("a cookie after logging out", vec![cookie(&logged_out.secret)]),
        ("a cookie as token", vec![bearer(&live_cookie)]),
        ("a token as cookie", vec![cookie(&live_token)]),
        ("a bad token beside a good cookie", vec![bearer("plp_0"), cookie(&live_cookie)]),
        ("two tokens", vec![bearer(&live_token), bearer(&live_token)]),
        (
            "a cookie from another site",
            vec![cookie(&live_cookie), (HeaderName::from_static("sec-fetch-site"), "cross-site".to_owned())],
        ),
        ("an empty token", vec![bearer("")]),
    ];
    let (mut num_closed, mut num_open) = (0, Vec::new());
    for (route, path) in table(&house.state) {
        let method = route.method.as_str();
        let Some(least) = route.needs.role else {
            num_open.push(format!("{method} {path}"));
            continue;
        };
        num_closed += 1;
        for (what, headers) in &strangers {
            let answer = house.send(method, &path, headers, "{}").await;
            // The door refuses pages of other sites before anything else.
            let is_foreign = what.contains("another site") && method != "GET";
            if is_foreign {
                answer.problem(403);
                continue;
            }
            let detail = answer.problem(401);
            assert!(detail.contains("log in"), "{method} {path} with {what}: {detail}");
            assert!(answer.header(header::WWW_AUTHENTICATE).starts_with("Bearer"), "{method} {path}");
        }
        for (role, shown) in &by_role {
            for headers in shown {
                let answer = house.send(method, &path, std::slice::from_ref(headers), "{}").await;
                let text = String::from_utf8_lossy(&answer.body).into_owned();
                if *role < least {
                    let detail = answer.problem(403);
                    assert!(
                        detail.contains(&format!("needs the role of {least}")),
                        "{method} {path}: {detail}"
                    );
                } else {
                    assert_ne!(answer.status, StatusCode::UNAUTHORIZED, "{method} {path} as {role}: {text}");
                    assert!(!text.contains("needs the role"), "{method} {path} as {role}: {text}");
                }
            }
        }
        for scope in Scope::ALL {
            let answer = house.send(method, &path, &[house.token(Role::Admin, Some(&[scope]))], "{}").await;
            let text = String::from_utf8_lossy(&answer.body).into_owned();
            let is_refused = text.contains("which this needs; make a token with that scope");
            assert_eq!(is_refused, scope != route.needs.scope, "{method} {path} with scope {scope}: {text}");
        }
        // Hundreds of tokens would be too many for one person.
        for token in people.tokens(Some(admin)) {
            if token.name == "test" && token.scopes.len() == 1 {
                people.revoke(token.id, None).unwrap();
            }
        }
    }
    assert!(num_closed >= 50, "{num_closed}");
    assert_eq!(
        num_open,
        [
            "POST /api/v1/login",
            "POST /api/v1/logout",
            "GET /healthz",
            "GET /readyz",
            "GET /login",
            "POST /login",
            "GET /logout",
            "POST /logout"
        ],
        "whatever is open to everybody is named here"
    );
    // What changes or moves something is for operators, and what says who they are for admins.
    for (route, path) in table(&house.state) {
        let Some(least) = route.needs.role else { continue };
        let reads = route.method == axum::http::Method::GET;
        let own = route.needs.scope == Scope::People && least == Role::Viewer;
        assert!(reads || own || least >= Role::Operator || route.needs.scope == Scope::Score, "{path}");
        assert!(route.needs.lease == NeedsLease::No || least >= Role::Operator, "{path}");
        assert!(!path.contains("/people") || least == Role::Admin, "{path}");
    }
    for socket in ["/stream", "/control", "/foxglove"] {
        for (what, headers) in &strangers {
            let refused = house.socket(socket, headers).await.err();
            let is_foreign = what.contains("another site");
            let expected = if is_foreign { StatusCode::FORBIDDEN } else { StatusCode::UNAUTHORIZED };
            // Two headers of one name are one here.
            if *what != "two tokens" {
                assert_eq!(refused, Some(expected), "{socket} with {what}");
            }
        }
    }
    // Foxglove's app sends no headers: its socket, and nothing else, takes a token from the address.
    let (_, bearer) = house.token(Role::Viewer, None);
    let secret = bearer.split(' ').nth(1).unwrap();
    let status = async |path: &str| house.send("GET", path, &[], "").await.status;
    assert_eq!(status(&format!("/api/v1/info?token={secret}")).await, StatusCode::UNAUTHORIZED);
    assert_eq!(status(&format!("/api/v1/stream?token={secret}")).await, StatusCode::UNAUTHORIZED);
    assert_eq!(status("/api/v1/foxglove?token=wrong").await, StatusCode::UNAUTHORIZED);
    assert_eq!(status("/api/v1/foxglove?token=").await, StatusCode::UNAUTHORIZED);
    // It is let in, and is no WebSocket.
    assert_eq!(status(&format!("/api/v1/foxglove?a=b&token={secret}")).await, StatusCode::BAD_REQUEST);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn viewers_may_stop_and_nothing_else_and_a_revoked_operator_loses_control() {
    let data = Data::empty();
    let (truth, _unpacked) = assets::truth(Path::new("small")).unwrap();
    let house = House::new(data.root(), Some(&LiveStation::Emulated(truth))).await;
    let viewer = house.cookie(Role::Viewer);
    let live = async || -> LiveDocument {
        house.send("GET", "/api/v1/live", std::slice::from_ref(&viewer), "").await.json()
    };
    let begun = std::time::Instant::now();
    loop {
        let live = live().await;
        if !live.devices.is_empty() && live.devices.iter().all(|device| device.link == "ready") {
            break;
        }
        assert!(begun.elapsed() < Duration::from_secs(120), "{:?}", live.devices);
        sleep(Duration::from_millis(20)).await;
    }
    let operator_token = house.token(Role::Operator, None);
    let mut operator = house.socket("/control", std::slice::from_ref(&operator_token)).await.unwrap();
    let acquire = |name: &str, take_over| Command::Acquire(Acquire { operator: name.to_owned(), take_over });
    assert!(operator.ask(acquire("Somebody Else", false)).await.accepted);

    for role in [Role::Viewer, Role::Scorer] {
        let mut watcher = house.socket("/control", &[house.cookie(role)]).await.unwrap();
        watcher.lease = operator.lease;
        for command in [
            acquire("Eve", true),
            Command::Heartbeat(Heartbeat {}),
            Command::Targets(Targets { dofs: vec![0], positions: vec![0.1] }),
        ] {
            watcher.lease = operator.lease;
            let reply = watcher.ask(command).await;
            assert!(!reply.accepted && reply.lease == 0, "{reply:?}");
            assert!(reply.problem.contains("role of operator"), "{}", reply.problem);
        }
        // A token for jobs alone is no way to the robot either.
        let mut jobs = house
            .socket("/control", &[house.token(Role::Operator, Some(&[Scope::Read, Scope::Jobs]))])
            .await
            .unwrap();
        assert!(!jobs.ask(acquire("Eve", true)).await.accepted);
        assert!(watcher.ask(Command::Stop(Stop {})).await.accepted);
    }
    let now = live().await;
    assert_eq!(
        (now.phase.as_str(), now.holder.as_str()),
        ("stopped", "operator-ann"),
        "the name is the person's"
    );

    let stream = house.socket("/stream", std::slice::from_ref(&operator_token)).await.unwrap();
    let people = house.state.people();
    let id = people.tokens(Some("operator-ann"))[0].id;
    people.revoke(id, None).unwrap();
    for socket in [operator, stream] {
        assert_eq!(socket.closed_because().await, "the login or token has ended");
    }
    let audit = house.audit().await;
    let find = |what: &str| {
        let found = audit.iter().find(|line| line["what"].as_str().unwrap().contains(what));
        found.unwrap_or_else(|| panic!("{what} is not in {audit:?}")).clone()
    };
    let refused = find("take control: refused")["connection"].as_str().unwrap().to_owned();
    assert!(refused.starts_with("control ") && refused.contains("(viewer-ann)"), "{refused}");
    let taken = audit.iter().find(|line| line["who"] == "operator-ann").expect("the operator is named");
    assert!(taken["connection"].as_str().unwrap().contains("by token \"test\""), "{taken}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn people_log_in_by_the_page_and_stay_logged_in_over_a_restart() {
    let data = Data::empty();
    let house = House::new(data.root(), None).await;
    let form = |body: &'static str| {
        let headers = vec![
            (header::CONTENT_TYPE, "application/x-www-form-urlencoded".to_owned()),
            (header::ORIGIN, format!("http://{}", house.address)),
        ];
        let house = &house;
        async move { house.send("POST", "/login", &headers, body).await }
    };
    let page = house.send("GET", "/", &[], "").await;
    assert_eq!((page.status, page.header(header::LOCATION)), (StatusCode::SEE_OTHER, "/login"));
    let again = house
        .send("GET", "/", &[(HeaderName::from_static("sec-fetch-site"), "cross-site".to_owned())], "")
        .await;
    assert!(String::from_utf8_lossy(&again.body).contains("http-equiv=\"refresh\""));
    let page = house.send("GET", "/login", &[], "").await;
    let html = String::from_utf8_lossy(&page.body).into_owned();
    assert!(html.contains("<label for=\"password\">") && !html.contains("<script"), "{html}");
    assert!(page.header(header::CONTENT_SECURITY_POLICY).contains("form-action 'self'"));
    assert_eq!(page.header(header::REFERRER_POLICY), "same-origin");
    assert_eq!(page.header(header::X_FRAME_OPTIONS), "DENY");

    for wrong in ["name=viewer-ann&password=wrong+password", "name=%3Cb%3E&password=wrong+password"] {
        let answer = form(wrong).await;
        let html = String::from_utf8_lossy(&answer.body).into_owned();
        assert_eq!(answer.status, StatusCode::UNAUTHORIZED);
        assert!(html.contains("role=\"alert\">this name and this password do not belong together"), "{html}");
        assert!(!html.contains("<b>") && answer.headers.get(header::SET_COOKIE).is_none());
    }
    let answer = form("name=viewer-ann&password=correct+horse+battery").await;
    assert_eq!((answer.status, answer.header(header::LOCATION)), (StatusCode::SEE_OTHER, "/"));
    let set = answer.header(header::SET_COOKIE).to_owned();
    for attribute in ["__Host-palpate=", "Path=/", "Secure", "HttpOnly", "SameSite=Strict", "Max-Age=604800"]
    {
        assert!(set.contains(attribute), "{set}");
    }
    let secret = set.split(['=', ';']).nth(1).unwrap().to_owned();
    let audit = house.audit().await;
    let whats: Vec<String> = audit.iter().map(|line| format!("{}: {}", line["who"], line["what"])).collect();
    assert!(whats.contains(&"\"somebody\": \"failed to log in as \\\"<b>\\\"\"".to_owned()), "{whats:?}");
    assert!(whats.contains(&"\"viewer-ann\": \"logged in\"".to_owned()), "{whats:?}");
    assert!(!format!("{audit:?}").contains("wrong password"));

    house.end().await;
    // Connections that are being closed hold the folder for a moment.
    let begun = std::time::Instant::now();
    while let Err(err) = Studio::open(data.root(), None, access()).map(drop) {
        assert!(begun.elapsed() < Duration::from_secs(60), "{err}");
        sleep(Duration::from_millis(20)).await;
    }
    let house = House::new(data.root(), None).await;
    let mine = [cookie(&secret)];
    let me: Me = house.send("GET", "/api/v1/me", &mine, "").await.json();
    assert_eq!((me.name.as_str(), me.role, me.token), ("viewer-ann", Role::Viewer, None));
    let home = house.send("GET", "/", &mine, "").await;
    assert_eq!(home.status, StatusCode::OK);
    let asked = house.send("GET", "/logout", &mine, "").await;
    let html = String::from_utf8_lossy(&asked.body).into_owned();
    assert!(html.contains("viewer-ann (viewer)") && html.contains("action=\"/logout\""), "{html}");
    let out = house.send("POST", "/api/v1/logout", &mine, "").await;
    assert_eq!(out.status, StatusCode::NO_CONTENT);
    assert!(out.header(header::SET_COOKIE).contains("Max-Age=0"));
    house.send("GET", "/api/v1/me", &mine, "").await.problem(401);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn attempts_to_log_in_are_limited_and_nobody_learns_who_exists() {
    let data = Data::empty();
    let house = House::new(data.root(), None).await;
    let attempt = |name: &str, password: &str| {
        let body = json!({ "name": name, "password": password }).to_string();
        let house = &house;
        async move { house.send("POST", "/api/v1/login", &[], &body).await }
    };
    let unknown = attempt("no-such-person", PASSWORD).await.problem(401);
    let known = attempt("admin-ann", "wrong password").await.problem(401);
    assert_eq!(unknown, known);
    for number in 2..10 {
        attempt(&format!("name-{number}"), "wrong password").await.problem(401);
    }
    // Now even the right one waits.
    let late = attempt("admin-ann", PASSWORD).await;
    let detail = late.problem(429);
    let seconds: u64 = late.header(header::RETRY_AFTER).parse().unwrap();
    assert!((1..=60).contains(&seconds) && detail.contains("too many attempts"), "{detail}");
    // Whoever is in stays in.
    let answer = house.send("GET", "/api/v1/me", &[house.cookie(Role::Admin)], "").await;
    assert_eq!(answer.status, StatusCode::OK);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn admins_manage_people_and_everybody_their_own_tokens() {
    let data = Data::empty();
    let house = House::new(data.root(), None).await;
    let (admin, operator) = ([house.cookie(Role::Admin)], [house.cookie(Role::Operator)]);
    let send = async |who: &[(HeaderName, String)], method: &str, path: &str, body: Value| {
        house.send(method, &format!("/api/v1{path}"), who, &body.to_string()).await
    };
    let bob = json!({ "name": "bob", "role": "scorer", "password": PASSWORD });
    assert_eq!(send(&admin, "POST", "/people", bob.clone()).await.status, StatusCode::CREATED);
    send(&admin, "POST", "/people", bob).await.problem(409);
    let weak = json!({ "name": "eve", "role": "scorer", "password": "short" });
    assert!(send(&admin, "POST", "/people", weak).await.problem(400).contains("shorter than 10"));
    let listed: Value = send(&admin, "GET", "/people", json!({})).await.json();
    assert!(
        listed.as_array().unwrap().iter().any(|person| person["name"] == "bob" && person["role"] == "scorer")
    );
    assert!(!listed.to_string().contains("argon2"), "no hash leaves the database");
    let changed: Value = send(&admin, "PATCH", "/people/bob", json!({ "role": "operator" })).await.json();
    assert_eq!(changed["role"], "operator");
    send(&admin, "PATCH", "/people/bob", json!({})).await.problem(400);
    send(&admin, "PATCH", "/people/nobody-there", json!({ "role": "viewer" })).await.problem(404);
    assert!(send(&admin, "DELETE", "/people/admin-ann", json!({})).await.problem(409).contains("last admin"));

    // Tokens: one's own, and no more than oneself.
    let made =
        send(&operator, "POST", "/tokens", json!({ "name": "ci", "scopes": ["read", "jobs", "people"] }))
            .await;
    assert_eq!(made.status, StatusCode::CREATED);
    let made: Value = made.json();
    let secret = made["secret"].as_str().unwrap();
    assert!(secret.starts_with("plp_") && secret.len() == 68, "{secret}");
    assert_eq!(made["token"]["role"], "operator");
    let by_token = [bearer(secret)];
    for (body, status) in [
        (json!({ "name": "x", "role": "admin" }), 403),
        (json!({ "name": "x", "person": "admin-ann" }), 403),
        (json!({ "name": "x" }), 403),
        (json!({ "name": "x", "scopes": ["control"] }), 403),
    ] {
        send(&by_token, "POST", "/tokens", body).await.problem(status);
    }
    let narrow = json!({ "name": "narrow", "role": "viewer", "scopes": ["read"] });
    assert_eq!(send(&by_token, "POST", "/tokens", narrow).await.status, StatusCode::CREATED);
    let tokens: Value = send(&operator, "GET", "/tokens", json!({})).await.json();
    assert_eq!(tokens.as_array().unwrap().len(), 2);
    assert!(!tokens.to_string().contains(&secret[4..]));
    let id = made["token"]["id"].as_u64().unwrap();
    let viewer = [house.cookie(Role::Viewer)];
    send(&viewer, "DELETE", &format!("/tokens/{id}"), json!({})).await.problem(404);
    assert_eq!(
        send(&admin, "DELETE", &format!("/tokens/{id}"), json!({})).await.status,
        StatusCode::NO_CONTENT
    );
    send(&by_token, "GET", "/me", json!({})).await.problem(401);

    // One's own password: with the old one only, and it ends every login.
    let change = |old: &str| json!({ "old": old, "new": "a better one by far" });
    send(&operator, "POST", "/me/password", change("wrong password")).await.problem(401);
    assert_eq!(
        send(&operator, "POST", "/me/password", change(PASSWORD)).await.status,
        StatusCode::NO_CONTENT
    );
    send(&operator, "GET", "/me", json!({})).await.problem(401);

    assert_eq!(send(&admin, "DELETE", "/people/bob", json!({})).await.status, StatusCode::NO_CONTENT);
    let audit = house.audit().await;
    for what in [
        "added \"bob\" as scorer",
        "gave \"bob\" the role of operator",
        "made token",
        "revoked token",
        "changed the own password",
        "removed \"bob\"",
    ] {
        let line = audit.iter().find(|line| line["what"].as_str().unwrap().contains(what));
        let line = line.unwrap_or_else(|| panic!("{what} is not in {audit:?}"));
        assert!(line["who"].as_str().unwrap().contains("-ann"), "{line}");
        assert!(line["connection"].as_str().unwrap().starts_with("http from 127.0.0.1:"), "{line}");
    }
    assert!(!format!("{audit:?}").contains(PASSWORD) && !format!("{audit:?}").contains(&secret[4..]));
}

#[tokio::test]
async fn a_studio_without_login_is_the_local_operators_and_says_who_owns_jobs_as_before() {
    let data = Data::empty();
    let app = app(data.state());
    let me: Me = crate::support::get(&app, "/api/v1/me").await.json();
    assert_eq!(
        (me.name.as_str(), me.role, me.scopes.len()),
        ("local operator", Role::Admin, Scope::ALL.len())
    );
    let login = json!({ "name": "ada", "password": PASSWORD });
    let refused = crate::support::post(&app, "/api/v1/login", &login).await.problem(409);
    assert!(refused.contains("no login"), "{refused}");
    // The first person is added here or by the command; tokens need a person.
    let ada = json!({ "name": "ada", "role": "admin", "password": PASSWORD });
    assert_eq!(crate::support::post(&app, "/api/v1/people", &ada).await.status, StatusCode::CREATED);
    let nameless = crate::support::post(&app, "/api/v1/tokens", &json!({ "name": "ci" })).await.problem(400);
    assert!(nameless.contains("in whose name"), "{nameless}");
    let made = crate::support::post(&app, "/api/v1/tokens", &json!({ "name": "ci", "person": "ada" })).await;
    assert_eq!(made.status, StatusCode::CREATED);
}

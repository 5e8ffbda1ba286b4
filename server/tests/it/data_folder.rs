//! The data folder: one studio at a time, sessions under way stay, and what is no plain file is never opened.

use std::{
    fs,
    os::unix::fs::symlink,
    path::Path,
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use axum::{
    body::{Body, Bytes},
    http::{Request, header},
};
use palpate_recording::{GrowingSession, PlannedStep, SessionPlan};
use palpate_server::{Error, Studio};
use palpate_wire::api::{ModelSummary, ObjectEntry, SessionSummary};
use rustix::fs::{CWD, FileType, Mode, mknodat};
use serde_json::{Value, json};
use tower::ServiceExt as _;

use crate::support::{Data, STATION, access, arg, get, palpate_ok, post, send, zip_folder};

fn fifo(path: &Path) {
    mknodat(CWD, path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
}

fn record_into(dir: &Path) -> GrowingSession {
    let step = PlannedStep { object: "ball".to_owned(), primitive: "tap".to_owned(), added_because: None };
    let plan = SessionPlan { plan: "one".to_owned(), steps: vec![step] };
    GrowingSession::open(dir, STATION, &plan, "", "").unwrap().0
}

#[test]
fn second_studio_on_a_data_folder_is_refused() {
    let data = Data::with_session();
    let first = data.state();
    let Err(err) = Studio::open(data.root(), None, access()) else { panic!("two studios share a folder") };
    assert!(matches!(err, Error::Conflict(_)), "{err}");
    let expected = format!("process {}", std::process::id());
    for words in [arg(data.root()), &expected, "--data"] {
        assert!(err.to_string().contains(words), "{words:?} is missing in {err}");
    }
    // So is one in another process.
    let mut second = Command::new(env!("CARGO_BIN_EXE_palpate"))
        .args(["serve", "--listen", "127.0.0.1:0", "--data", arg(data.root())])
        .stderr(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let patience = Instant::now();
    while second.try_wait().unwrap().is_none() && patience.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(20));
    }
    // Harmless if it has ended.
    let _ = second.kill();
    let output = second.wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains(&expected), "{stderr}");
    // What only reads goes on working.
    palpate_ok(&["session", "check", arg(data.session())]);
    drop(first);
    data.state();
}

#[tokio::test]
async fn session_that_is_recorded_is_neither_deleted_nor_replaced() {
    let data = Data::empty();
    let app = data.app();
    let dir = data.root().join("sessions/monday");
    let growing = record_into(&dir);
    let detail = send(&app, "DELETE", "/api/v1/sessions/monday", None).await.problem(409);
    assert!(detail.contains("\"monday\" is being recorded; leave it on the Record screen"), "{detail}");
    assert!(dir.join("recording.toml").is_file());
    drop(growing);
    assert_eq!(send(&app, "DELETE", "/api/v1/sessions/monday", None).await.status, 204);
    assert!(!dir.exists());

    let growing = record_into(&dir);
    let detail = send(&app, "POST", "/api/v1/sessions/monday/restore", None).await.problem(409);
    assert!(detail.contains("is being recorded"), "{detail}");
    drop(growing);
    let detail = send(&app, "POST", "/api/v1/sessions/monday/restore", None).await.problem(409);
    assert!(detail.contains("there is another session"), "{detail}");
}

#[tokio::test]
async fn special_files_and_links_out_of_the_folder_are_listed_and_not_opened() {
    let data = Data::with_session();
    let root = data.root().to_owned();
    for folder in ["models", "objects", "runs", "sessions/pipe"] {
        fs::create_dir_all(root.join(folder)).unwrap();
    }
    let outside = data.path("outside");
    fs::create_dir(&outside).unwrap();
    let model = "format = 1\nname = \"Soft\"\n[theta]\nlambda_con_m = 0.001\nalpha_per_m = 80.0\nlambda_pre_pa = 500.0\n";
    fs::write(outside.join("secret.toml"), model).unwrap();
    fs::write(outside.join("mesh.stl"), "solid secret").unwrap();
    fs::write(root.join("models/good.toml"), model).unwrap();
    // Sessions: a pipe as the session's file, a pipe in the place of a folder, a link to a session elsewhere, an
    // endless take.
    fifo(&root.join("sessions/pipe/session.toml"));
    fifo(&root.join("sessions/bare"));
    fs::create_dir(outside.join("session")).unwrap();
    for entry in fs::read_dir(data.session()).unwrap() {
        let path = entry.unwrap().path();
        fs::copy(&path, outside.join("session").join(path.file_name().unwrap())).unwrap();
    }
    symlink(outside.join("session"), root.join("sessions/linked")).unwrap();
    let endless = root.join("sessions/endless");
    fs::create_dir(&endless).unwrap();
    for entry in fs::read_dir(data.session()).unwrap() {
        let path = entry.unwrap().path();
        fs::copy(&path, endless.join(path.file_name().unwrap())).unwrap();
    }
    fs::remove_file(endless.join("take-01.mcap")).unwrap();
    symlink("/dev/zero", endless.join("take-01.mcap")).unwrap();
    // Models, objects, meshes and runs.
    fifo(&root.join("models/pipe.toml"));
    symlink(outside.join("secret.toml"), root.join("models/linked.toml")).unwrap();
    fifo(&root.join("objects/pipe.toml"));
    symlink(outside.join("secret.toml"), root.join("objects/linked.toml")).unwrap();
    let mesh = |id: &str, path: &str| {
        let text = format!(
            "id = {id:?}\nlabel = 'M'\nshape = {{ kind = 'mesh', file = {path:?}, scale = 0.001 }}\n"
        );
        fs::write(root.join(format!("objects/{id}.toml")), text).unwrap();
    };
    fifo(&root.join("objects/pipe.stl"));
    mesh("dots", "../../outside/mesh.stl");
    mesh("absolute", arg(&outside.join("mesh.stl")));
    mesh("piped", "pipe.stl");
    fifo(&root.join("runs/run-1.json"));
    symlink(outside.join("secret.toml"), root.join("runs/run-2.json")).unwrap();

    let app = data.app();
    let sessions: Vec<SessionSummary> = get(&app, "/api/v1/sessions").await.json();
    let reason = |id: &str| {
        let entry = sessions.iter().find(|entry| entry.id == id);
        entry.unwrap_or_else(|| panic!("{id} is not listed")).error.clone()
    };
    assert_eq!(reason("taps"), None);
    for (id, words) in [
        ("pipe", "is a named pipe"),
        ("bare", "Not a directory"),
        ("linked", "leads out of the folder"),
        ("endless", "leads out of the folder"),
    ] {
        let reason = reason(id).unwrap_or_default();
        assert!(reason.contains(words), "{id}: {reason:?}");
        assert!(!reason.contains(arg(&root)), "{id}: {reason:?} names a folder of the server");
    }
    let models: Vec<ModelSummary> = get(&app, "/api/v1/models").await.json();
    assert_eq!(models.iter().map(|model| model.id.as_str()).collect::<Vec<_>>(), ["good"]);
    get(&app, "/api/v1/models/pipe").await.problem(422);
    get(&app, "/api/v1/models/linked").await.problem(422);
    let objects: Vec<ObjectEntry> = get(&app, "/api/v1/objects").await.json();
    for (id, words) in [
        ("pipe", "is a named pipe"),
        ("linked", "leads out of the folder"),
        ("dots", "leads out of the folder"),
        ("absolute", "leads out of the folder"),
        ("piped", "is a named pipe"),
    ] {
        let entry =
            objects.iter().find(|object| object.id == id).unwrap_or_else(|| panic!("{id} is not listed"));
        let reason = entry.content.as_ref().unwrap_err();
        assert!(reason.contains(words), "{id}: {reason}");
    }
    assert_eq!(get(&app, "/api/v1/calibrations").await.json::<Vec<Value>>().len(), 0);
    // A link can be thrown away; what it leads to stays.
    assert_eq!(send(&app, "DELETE", "/api/v1/sessions/linked", None).await.status, 204);
    assert!(outside.join("session/session.toml").is_file());
}

#[tokio::test]
async fn run_with_the_highest_number_does_not_make_ids_wrap() {
    let data = Data::with_session();
    let app = data.app();
    drop(app);
    let run = |id: &str| {
        json!({
            "id": id, "request": { "session": "taps" }, "state": "failed", "fraction": 0.5, "stage": "failed",
            "seconds_left": null, "error": "x", "report": null, "model_toml": null, "saved_as": null,
        })
    };
    for id in ["run-1".to_owned(), format!("run-{}", u64::MAX), format!("run-{}", u64::MAX - 1)] {
        fs::write(data.root().join(format!("runs/{id}.json")), run(&id).to_string()).unwrap();
    }
    let app = data.app();
    let runs: Vec<Value> = get(&app, "/api/v1/calibrations").await.json();
    assert_eq!(runs.len(), 1, "{runs:?}");
    let next: Value = post(&app, "/api/v1/calibrations", &json!({ "session": "taps" })).await.json();
    assert_eq!(next["id"], "run-2");
}

#[tokio::test]
async fn fifth_upload_at_once_is_asked_to_come_later() {
    let data = Data::with_session();
    let app = data.app();
    let incoming = || {
        let entries = fs::read_dir(data.root()).unwrap();
        entries
            .filter(|entry| entry.as_ref().unwrap().file_name().to_string_lossy().starts_with(".incoming-"))
            .count()
    };
    let slow: Vec<_> = (0..4)
        .map(|number| {
            let body = Body::from_stream(futures_util::stream::pending::<Result<Bytes, std::io::Error>>());
            let request = Request::builder()
                .method("POST")
                .uri(format!("/api/v1/sessions?name=slow-{number}"))
                .header(header::HOST, "localhost")
                .header(header::CONTENT_TYPE, "application/zip")
                .body(body)
                .unwrap();
            tokio::spawn(app.clone().oneshot(request))
        })
        .collect();
    let come_in = async {
        while incoming() < 4 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(60), come_in).await.expect("all four come in");
    let archive = zip_folder(data.session(), "");
    let upload = async || {
        let archive = archive.clone();
        send(&app, "POST", "/api/v1/sessions?name=fifth", Some(("application/zip", archive))).await
    };
    let answer = upload().await;
    assert!(answer.problem(503).contains("4 archives are being unpacked or packed already"));
    assert_eq!(answer.header(header::RETRY_AFTER), "10");
    for upload in slow {
        upload.abort();
        assert!(upload.await.is_err(), "it was under way");
    }
    assert_eq!(upload().await.status, 201);
    assert_eq!(incoming(), 0);
}

#[tokio::test]
async fn what_a_killed_studio_left_of_uploads_is_removed() {
    let data = Data::with_session();
    let left = data.root().join(".incoming-abc");
    fs::create_dir_all(left.join("content")).unwrap();
    fs::write(left.join("upload.zip"), "half").unwrap();
    data.state();
    assert!(!left.exists());
}

#[tokio::test]
async fn audit_log_is_sent_from_its_end() {
    let data = Data::empty();
    let app = data.app();
    assert!(get(&app, "/api/v1/audit").await.body.is_empty());
    let path = data.root().join("audit.jsonl");
    let lines = |count: usize| -> String {
        (0..count).map(|number| format!("{{\"number\":{number:07}}}\n")).collect()
    };
    fs::write(&path, lines(3)).unwrap();
    assert_eq!(get(&app, "/api/v1/audit").await.body, lines(3));
    // Several megabytes, lines of 19 bytes.
    let whole = lines(300_000);
    fs::write(&path, &whole).unwrap();
    let body = get(&app, "/api/v1/audit").await.body;
    assert!(body.len() <= 1 << 20 && body.len() + 20 > 1 << 20, "{}", body.len());
    assert!(whole.as_bytes().ends_with(&body) && body.starts_with(b"{\"number\""));
    // What was cut lies before a line's first byte.
    let exact = "x".repeat((1 << 20) - 1) + "\n";
    fs::write(&path, format!("first\n{exact}")).unwrap();
    assert_eq!(get(&app, "/api/v1/audit").await.body, exact);
}

#[tokio::test]
async fn sessions_are_listed_from_the_index_until_a_take_changes() {
    let data = Data::with_session();
    let list = "/api/v1/sessions";
    let app = data.app();
    let known: Vec<SessionSummary> = get(&app, list).await.json();
    assert_eq!((known[0].takes, known[0].error.as_deref()), (4, None));

    // Rubbish of the same length and time is not looked at: nothing is decoded for the list.
    let take = data.session().join("take-02.mcap");
    let (bytes, modified) = (fs::read(&take).unwrap(), fs::metadata(&take).unwrap().modified().unwrap());
    let overwrite = |content: &[u8], time| {
        fs::write(&take, content).unwrap();
        fs::File::options().write(true).open(&take).unwrap().set_modified(time).unwrap();
    };
    overwrite(&vec![0; bytes.len()], modified);
    let app = data.restart(app).await;
    assert_eq!(get(&app, list).await.json::<Vec<SessionSummary>>(), known);
    // Whether a take was accepted is what the session says now.
    data.edit_session(|text| text.replacen("accepted = true", "accepted = false", 1));
    let app = data.restart(app).await;
    let detail: palpate_wire::api::SessionDetail = get(&app, "/api/v1/sessions/taps").await.json();
    assert_eq!(detail.takes.iter().filter(|take| take.accepted).count(), 3);

    // Another time means another content.
    overwrite(&vec![0; bytes.len()], modified + Duration::from_secs(1));
    let app = data.restart(app).await;
    let listed: Vec<SessionSummary> = get(&app, list).await.json();
    assert!(listed[0].error.as_deref().is_some_and(|error| error.contains("take-02")), "{listed:?}");
    drop(app);

    // The index is made again from the files, whatever was in it.
    let report: Value =
        serde_json::from_str(&palpate_ok(&["index", "rebuild", "--json", "--data", arg(data.root())]))
            .unwrap();
    assert_eq!((&report["sessions"], &report["takes"]), (&json!(0), &json!(0)));
    assert!(report["problems"][0].as_str().is_some_and(|problem| problem.contains("take-02")), "{report}");
    overwrite(&bytes, modified);
    let said = palpate_ok(&["index", "rebuild", "--data", arg(data.root())]);
    assert_eq!(said.trim(), "sessions: 1, takes: 4");
}

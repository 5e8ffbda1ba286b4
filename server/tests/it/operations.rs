//! What keeps a lab's studio going: health, numbers, configuration, backups.

use std::process::Command;

use axum::http::header;
use palpate_people::now_s;
use palpate_server::{Access, Studio, app};
use palpate_wire::api::{Job, Readiness, Role};
use serde_json::{Value, json};

use crate::support::{Data, access, arg, get, palpate, palpate_ok, palpate_refuses, post, tree};

#[tokio::test]
async fn health_and_metrics_say_how_the_studio_is() {
    let data = Data::with_session();
    let state = data.state();
    let app = app(state.clone());
    let alive = get(&app, "/healthz").await;
    assert_eq!((alive.status.as_u16(), &alive.body[..]), (200, &b"ok\n"[..]));
    let ready: Readiness = get(&app, "/readyz").await.json();
    assert_eq!(ready, Readiness { ready: true, reasons: vec![] });
    let request = json!({ "kind": "calibrate", "request": { "session": "taps" } });
    assert_eq!(post(&app, "/api/v1/jobs", &request).await.status.as_u16(), 202);

    let metrics = get(&app, "/metrics").await;
    assert!(metrics.header(header::CONTENT_TYPE).starts_with("application/openmetrics-text; version=1.0.0"));
    let text = String::from_utf8(metrics.body.to_vec()).unwrap();
    assert!(text.ends_with("# EOF\n"), "{text}");
    let value = |name: &str| {
        let line = text
            .lines()
            .find(|line| line.starts_with(name))
            .unwrap_or_else(|| panic!("{name} is not in {text}"));
        line.rsplit(' ').next().unwrap().parse::<f64>().unwrap()
    };
    assert_eq!(value("palpate_build_info{"), 1.0);
    assert_eq!(value("palpate_jobs{kind=\"calibrate\""), 1.0);
    assert!(value("palpate_disk_free_bytes ") > 0.0);
    assert_eq!(value("palpate_audit_lines_lost_total "), 0.0);
    assert_eq!(value("palpate_stream_clients "), 0.0);
    assert!(!text.contains("control_loop"), "without a station there is no loop");

    state.begin_shutdown();
    let ending = get(&app, "/readyz").await;
    assert_eq!(ending.status.as_u16(), 503);
    assert!(ending.json::<Readiness>().reasons[0].contains("shutting down"));
}

#[tokio::test]
async fn a_backup_of_a_running_studio_unpacks_to_the_same_studio() {
    let data = Data::with_session();
    let studio = Studio::open(data.root(), None, access()).unwrap();
    let people = studio.state.people();
    people.add("ada", Role::Admin, "correct horse battery", now_s()).unwrap();
    let login = people.log_in("ada", "correct horse battery", now_s()).unwrap();
    let running = app(studio.state.clone());
    let request = json!({ "kind": "calibrate", "request": { "session": "taps" } });
    let job: Job = post(&running, "/api/v1/jobs", &request).await.json();
    std::fs::write(data.root().join("sessions/taps/take-09.mcap.partial"), "being recorded").unwrap();

    let out = data.path("backup.tar");
    let report: Value = serde_json::from_str(&palpate_ok(&[
        "backup",
        "--data",
        arg(data.root()),
        "--out",
        arg(&out),
        "--json",
    ]))
    .unwrap();
    assert!(report["files"].as_u64().unwrap() > 5, "{report}");
    let again = palpate_refuses(&["backup", "--data", arg(data.root()), "--out", arg(&out)]);
    assert!(again.contains("replaces nothing"), "{again}");
    let inside =
        palpate_refuses(&["backup", "--data", arg(data.root()), "--out", arg(&data.root().join("b.tar"))]);
    assert!(inside.contains("lies in the data folder"), "{inside}");
    let nothing =
        palpate_refuses(&["backup", "--data", arg(&data.path("nowhere")), "--out", arg(&data.path("c.tar"))]);
    assert!(nothing.contains("no data folder"), "{nothing}");
    let mode = std::os::unix::fs::PermissionsExt::mode(&out.metadata().unwrap().permissions());
    assert_eq!(mode & 0o777, 0o600);

    let restored = data.path("restored");
    std::fs::create_dir(&restored).unwrap();
    let unpacked = Command::new("tar").args(["-xf", arg(&out), "-C", arg(&restored)]).status().unwrap();
    assert!(unpacked.success());
    let sessions = |root: &std::path::Path| -> Vec<_> {
        let files = tree(&root.join("sessions")).into_iter();
        let files = files.filter(|(path, _)| !path.to_string_lossy().ends_with(".partial"));
        files.map(|(path, content)| (path.strip_prefix(root).unwrap().to_owned(), content)).collect()
    };
    assert_eq!(sessions(&restored), sessions(data.root()));
    assert!(!restored.join("studio.lock").exists());

    let copy = Studio::open(&restored, None, Access { login: true, ..access() }).unwrap();
    assert_eq!(copy.state.people().list().len(), 1);
    let cookie = palpate_people::Presented::Cookie(&login.secret);
    assert!(copy.state.people().authenticate(cookie, now_s()).is_ok(), "whoever was logged in still is");
    drop(copy);
    let copy = Studio::open(&restored, None, access()).unwrap();
    let there: Job = get(&app(copy.state.clone()), &format!("/api/v1/jobs/{}", job.id)).await.json();
    assert_eq!((there.kind.as_str(), there.created), ("calibrate", job.created));
}

#[test]
fn configuration_is_printed_checked_and_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("palpate.toml");
    let printed = palpate_ok(&["serve", "--print-default-config"]);
    std::fs::write(&path, &printed).unwrap();
    let checked = palpate_ok(&["serve", "--config", arg(&path), "--check-config"]);
    assert!(checked.contains("can be used"), "{checked}");
    assert!(!dir.path().join("data").exists(), "checking makes nothing");
    std::fs::write(&path, printed.replace("login = false", "log_in = false")).unwrap();
    let output = palpate(&["serve", "--config", arg(&path), "--check-config"]);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("unknown field `log_in`") && stderr.contains("palpate.toml"), "{stderr}");
    std::fs::write(&path, printed.replace("127.0.0.1:8080", "0.0.0.0:8443")).unwrap();
    let nobody = palpate_refuses(&["serve", "--config", arg(&path), "--check-config"]);
    assert!(nobody.contains("palpate people add"), "{nobody}");
}

#[test]
fn shells_and_man_pages_know_every_command() {
    let bash = palpate_ok(&["completions", "bash"]);
    let dir = tempfile::tempdir().unwrap();
    palpate_ok(&["man", "--out", arg(dir.path())]);
    for command in ["serve", "people", "tokens", "backup", "calibrate"] {
        assert!(bash.contains(command), "{command}");
        let page = std::fs::read_to_string(dir.path().join(format!("palpate-{command}.1"))).unwrap();
        assert!(page.contains(".SH"), "{page}");
    }
    // Too long for an argument.
    let script = dir.path().join("palpate.bash");
    std::fs::write(&script, bash).unwrap();
    let syntax = Command::new("bash").arg("-n").arg(&script).status().unwrap();
    assert!(syntax.success());
}

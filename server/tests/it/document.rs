//! The OpenAPI document: what is served, what is kept in the checkout, and manners that it promises.

use std::{fs, path::Path, time::Duration};

use axum::{
    Router,
    body::Body,
    http::{Request, header},
};
use palpate_wire::api::{Job, JobState, ProblemDetails, ProblemType};
use serde_json::{Value, json};

use crate::support::{Answer, Data, answer_of, ended, get, palpate_ok, send, tree};

#[test]
fn document_of_the_checkout_is_what_the_handlers_say() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/openapi.json");
    let said = palpate_ok(&["openapi"]);
    let kept = fs::read_to_string(&path).unwrap_or_default();
    let renew = "cargo run -p palpate_server -- openapi > docs/openapi.json";
    assert!(
        kept == said,
        "docs/openapi.json is not what the handlers say. Clients read it: see what changed after `{renew}`"
    );
}

#[test]
fn every_type_of_problem_is_in_the_manual() {
    let manual = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/api.md")).unwrap();
    for kind in ProblemType::ALL {
        let slug = kind.uri().strip_prefix("urn:palpate:problem:").unwrap();
        let row = format!("| `{slug}` | {} | {} |", kind.status(), kind.meaning());
        assert!(manual.contains(&row), "docs/api.md lacks the row {row}");
    }
}

#[tokio::test]
async fn document_is_served_with_its_page() {
    let app = Data::empty().app();
    let answer = get(&app, "/api/v1/openapi.json").await;
    let served: Value = answer.json();
    let kept: Value = serde_json::from_str(&palpate_ok(&["openapi"])).unwrap();
    assert_eq!((&served["openapi"], &served), (&"3.1.0".into(), &kept));
    let page = get(&app, "/api/docs").await;
    let policy = page.headers.get("content-security-policy").unwrap().to_str().unwrap();
    assert!(
        policy.contains("default-src 'none'; script-src 'self'; ") && !policy.contains("eval"),
        "{policy}"
    );
    let text = String::from_utf8_lossy(&page.body).into_owned();
    let script = text.split("src=\"").nth(1).unwrap().split('"').next().unwrap();
    let script = get(&app, script).await;
    assert_eq!((script.status.as_u16(), script.body.len()), (200, 863_099));
    assert!(script.headers["content-type"].to_str().unwrap().starts_with("text/javascript"));
}

/// A session, and a calibration of it that is done.
async fn calibrated(data: &Data) -> Router {
    let app = data.app();
    let request = json!({ "session": "taps" });
    let run = ask(&app, "POST", "/api/v1/calibrations", &[("idempotency-key", "k-1")], Some(&request)).await;
    assert_eq!(run.status, 202, "{:?}", run.body);
    ended(&app, "run-1").await;
    app
}

async fn ask(
    app: &Router,
    method: &str,
    path: &str,
    headers: &[(&str, &str)],
    body: Option<&Value>,
) -> Answer {
    let mut request = Request::builder().method(method).uri(path).header("host", "localhost");
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    if body.is_some() {
        request = request.header("content-type", "application/json");
    }
    let body = body.map_or_else(Body::empty, |body| Body::from(body.to_string()));
    answer_of(app, request.body(body).unwrap()).await
}

fn kind_of(answer: &Answer) -> String {
    answer.json::<ProblemDetails>().kind
}

#[tokio::test]
async fn same_key_gives_the_same_work_after_a_restart_and_whatever_it_has_done() {
    let data = Data::with_session();
    let app = calibrated(&data).await;
    let request = json!({ "session": "taps" });
    let app = data.restart(app).await;
    let key = [("idempotency-key", "k-1")];
    let again = ask(&app, "POST", "/api/v1/calibrations", &key, Some(&request)).await;
    assert_eq!((again.status.as_u16(), again.json::<Value>()["id"].as_str()), (200, Some("run-1")));
    assert_eq!(again.header(header::LOCATION), "/api/v1/calibrations/run-1");
    let other = json!({ "session": "taps", "method": "grid" });
    let refused = ask(&app, "POST", "/api/v1/calibrations", &key, Some(&other)).await;
    assert_eq!(
        (refused.status.as_u16(), kind_of(&refused).as_str()),
        (409, "urn:palpate:problem:key-reused")
    );
    // Data that has changed since makes no other request of it.
    data.edit_session(|text| text + "\n# looked at\n");
    let again = ask(&app, "POST", "/api/v1/calibrations", &key, Some(&request)).await;
    assert_eq!(again.status, 200, "{:?}", again.body);

    // What the job has made must not stand in the way of its own request.
    let emulate = json!({ "kind": "emulate", "request": { "truth": "bench", "session": "made" } });
    let key = [("idempotency-key", "k-2")];
    assert_eq!(ask(&app, "POST", "/api/v1/jobs", &key, Some(&emulate)).await.status, 202);
    ended(&app, "emulation-1").await;
    let again = ask(&app, "POST", "/api/v1/jobs", &key, Some(&emulate)).await;
    assert_eq!((again.status.as_u16(), again.json::<Job>().id.as_str()), (200, "emulation-1"));
    let without = ask(&app, "POST", "/api/v1/jobs", &[], Some(&emulate)).await;
    assert_eq!((without.status.as_u16(), kind_of(&without).as_str()), (409, "urn:palpate:problem:exists"));

    let clone = |key| {
        let app = app.clone();
        async move {
            let changes = json!({ "request": { "session": "made-2" } });
            ask(&app, "POST", "/api/v1/jobs/emulation-1/clone", &[("idempotency-key", key)], Some(&changes))
                .await
        }
    };
    let first: Job = clone("k-3").await.json();
    let second = clone("k-3").await;
    assert_eq!((second.status.as_u16(), second.json::<Job>().id), (200, first.id.clone()));
    assert_eq!(clone("k-2").await.status, 409);
    ended(&app, &first.id).await;
    for wrong in ["", &"k".repeat(256)] {
        let refused = ask(&app, "POST", "/api/v1/jobs", &[("idempotency-key", wrong)], Some(&emulate)).await;
        assert_eq!(
            (refused.status.as_u16(), kind_of(&refused).as_str()),
            (400, "urn:palpate:problem:bad-request")
        );
    }
}

#[tokio::test]
async fn lists_come_in_pages_that_link_to_the_next_and_whole_without() {
    let data = Data::with_session();
    for id in ["a b", "uv", "z"] {
        let copy = data.root().join("sessions").join(id);
        fs::create_dir(&copy).unwrap();
        for (path, content) in tree(data.session()) {
            fs::write(copy.join(path.file_name().unwrap()), content).unwrap();
        }
    }
    let app = data.app();
    for _ in 0..3 {
        let run = ask(&app, "POST", "/api/v1/calibrations", &[], Some(&json!({ "session": "taps" }))).await;
        assert_eq!(run.status, 202);
    }
    for (path, whole) in [
        ("/api/v1/sessions", vec!["a b", "taps", "uv", "z"]),
        ("/api/v1/calibrations", vec!["run-3", "run-2", "run-1"]),
    ] {
        let ids = |answer: &Answer| -> Vec<String> {
            let list: Vec<Value> = answer.json();
            list.iter().map(|entry| entry["id"].as_str().unwrap().to_owned()).collect()
        };
        let answer = get(&app, path).await;
        assert_eq!(
            (ids(&answer), answer.header(header::LINK)),
            (whole.iter().map(|id| (*id).to_owned()).collect(), "")
        );
        let (mut next, mut found, mut pages) = (format!("{path}?limit=2"), Vec::new(), 0);
        loop {
            let page = get(&app, &next).await;
            assert_eq!(page.status, 200, "{next}");
            found.extend(ids(&page));
            pages += 1;
            let link = page.header(header::LINK);
            let Some(path) = link.strip_prefix('<').and_then(|link| link.strip_suffix(">; rel=\"next\""))
            else {
                assert_eq!(link, "");
                break;
            };
            next = path.to_owned();
        }
        assert_eq!((found, pages), (ids(&answer), 2));
        for wrong in ["limit=0", "limit=1001", "limit=-1", "limit=x", "limt=3"] {
            get(&app, &format!("{path}?{wrong}")).await.problem(400);
        }
    }
    let link = get(&app, "/api/v1/jobs?limit=1&kind=calibrate").await;
    assert!(link.header(header::LINK).starts_with("</api/v1/jobs?limit=1&kind=calibrate&cursor="));
    get(&app, "/api/v1/calibrations?cursor=x").await.problem(400);
    for run in ["run-1", "run-2", "run-3"] {
        ended(&app, run).await;
    }
}

#[tokio::test]
async fn documents_that_a_client_has_are_not_sent_again_and_downloads_go_on() {
    let data = Data::with_session();
    let app = calibrated(&data).await;
    for path in ["/api/v1/info", "/api/v1/sessions", "/api/v1/calibrations/run-1", "/api/v1/jobs/run-1/log"] {
        let answer = get(&app, path).await;
        let tag = answer.header(header::ETAG).to_owned();
        assert!(tag.len() > 10, "{path}: {:?}", answer.headers);
        let known = ask(&app, "GET", path, &[("if-none-match", &format!("\"x\", W/{tag}"))], None).await;
        assert_eq!(
            (known.status.as_u16(), known.body.len(), known.header(header::ETAG)),
            (304, 0, tag.as_str())
        );
        assert_eq!(ask(&app, "GET", path, &[("if-none-match", "\"x\"")], None).await.status, 200);
    }

    let path = "/api/v1/jobs/run-1/files/model.toml";
    let whole = get(&app, path).await;
    let len = whole.body.len();
    let tag = whole.header(header::ETAG).to_owned();
    let digest = whole.headers["repr-digest"].to_str().unwrap().to_owned();
    assert!(digest.starts_with("sha-256=:") && digest.len() == 9 + 44 + 1, "{digest}");
    let part = async |range: &str, known: &str| {
        let headers = [("range", range), ("if-range", known)];
        ask(&app, "GET", path, if known.is_empty() { &headers[..1] } else { &headers }, None).await
    };
    let begin = part("bytes=0-99", "").await;
    let rest = part("bytes=100-", &tag).await;
    assert_eq!((begin.status.as_u16(), rest.status.as_u16()), (206, 206));
    assert_eq!(begin.headers["content-range"], format!("bytes 0-99/{len}"));
    assert_eq!([begin.body, rest.body].concat(), whole.body, "two parts are the whole");
    assert_eq!(rest.headers["repr-digest"].to_str().unwrap(), digest);
    assert_eq!(part("bytes=-5", "").await.body, whole.body[len - 5..]);
    assert_eq!(part("bytes=100-", "\"another\"").await.status, 200, "of another file the whole is sent");
    for odd in ["bytes=0-1,5-6", "lines=1-2", "bytes=a-b"] {
        assert_eq!(part(odd, "").await.body, whole.body, "{odd}");
    }
    let beyond = part(&format!("bytes={len}-"), "").await;
    assert_eq!(
        (beyond.status.as_u16(), kind_of(&beyond).as_str()),
        (416, "urn:palpate:problem:range-not-satisfiable")
    );
    assert_eq!(beyond.headers["content-range"], format!("bytes */{len}"));
    let known = ask(&app, "GET", path, &[("if-none-match", &tag), ("range", "bytes=0-1")], None).await;
    assert_eq!(known.status, 304);
}

#[tokio::test]
async fn events_tell_every_state_of_a_job_to_its_end() {
    let data = Data::with_session();
    let app = data.app();
    let emulate = json!({ "kind": "emulate", "request": { "truth": "bench", "session": "made" } });
    let job: Job = ask(&app, "POST", "/api/v1/jobs", &[], Some(&emulate)).await.json();
    let path = format!("/api/v1/jobs/{}/events", job.id);
    // The answer ends with the job.
    let answer = tokio::time::timeout(Duration::from_secs(200), get(&app, &path)).await.unwrap();
    assert_eq!((answer.status.as_u16(), answer.header(header::CONTENT_TYPE)), (200, "text/event-stream"));
    let text = String::from_utf8(answer.body.to_vec()).unwrap();
    let field = |event: &str, name: &str| {
        event
            .lines()
            .find_map(|line| line.strip_prefix(name))
            .map(|value| value.trim_start_matches(": ").to_owned())
    };
    let events: Vec<&str> = text.split("\n\n").filter(|event| event.contains("data:")).collect();
    let jobs: Vec<Job> =
        events.iter().map(|event| serde_json::from_str(&field(event, "data").unwrap()).unwrap()).collect();
    assert!(jobs.iter().all(|told| told.id == job.id) && jobs.len() >= 2, "{text}");
    assert!(jobs[..jobs.len() - 1].iter().all(Job::is_unfinished), "{text}");
    let last = jobs.last().unwrap();
    assert_eq!(*last, get(&app, &format!("/api/v1/jobs/{}", job.id)).await.json::<Job>());
    assert_eq!(last.state, JobState::Done);

    let seen = field(events.last().unwrap(), "id").unwrap();
    assert_eq!(seen, "1-done");
    assert_eq!(ask(&app, "GET", &path, &[("last-event-id", &seen)], None).await.status, 204);
    let late = ask(&app, "GET", &path, &[("last-event-id", "1-running")], None).await;
    assert!(
        late.status == 200 && String::from_utf8_lossy(&late.body).contains("id: 1-done"),
        "{:?}",
        late.body
    );
    get(&app, "/api/v1/jobs/emulation-9/events").await.problem(404);
}

#[tokio::test]
async fn problems_have_types_that_programs_can_tell_apart() {
    let data = Data::with_session();
    let app = data.app();
    let json = Some(("application/json", b"{".to_vec()));
    for (method, path, body, kind) in [
        ("GET", "/api/v1/sessions/none", None, "not-found"),
        ("GET", "/api/v1/live", None, "no-station"),
        ("GET", "/api/v1/recording", None, "no-station"),
        ("GET", "/api/v1/nothing", None, "no-route"),
        ("PATCH", "/api/v1/info", None, "method-not-allowed"),
        ("POST", "/api/v1/jobs", json, "bad-request"),
        ("POST", "/api/v1/jobs", Some(("application/json", b"{}".to_vec())), "bad-content"),
        ("POST", "/api/v1/jobs", Some(("text/plain", b"{}".to_vec())), "unsupported-media-type"),
        ("POST", "/api/v1/sessions?name=x", Some(("text/plain", Vec::new())), "unsupported-media-type"),
        ("POST", "/api/v1/sessions?name=taps", Some(("application/zip", Vec::new())), "exists"),
        ("POST", "/api/v1/jobs", Some(("application/json", vec![b' '; 3 << 20])), "too-large"),
        ("PUT", "/api/v1/emulator/faults", Some(("application/toml", vec![0xff])), "bad-request"),
        ("GET", "/api/v1/stream", None, "bad-request"),
    ] {
        let answer = send(&app, method, path, body).await;
        let found: ProblemDetails = answer.json();
        assert_eq!(found.kind, format!("urn:palpate:problem:{kind}"), "{method} {path}: {found:?}");
        let known = ProblemType::ALL.iter().find(|known| known.uri() == found.kind).unwrap();
        assert_eq!((known.status(), found.status), (answer.status.as_u16(), answer.status.as_u16()));
    }
}

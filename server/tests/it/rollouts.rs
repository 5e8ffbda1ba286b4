//! Trials of a campaign as a job: who may ask for it, with what, and what the job is told. A shell script stands in for
//! `palpate-train`; `policy/train/tests/hand/campaigns.rs` has the real one and a robot.

use std::{fs, os::unix::fs::PermissionsExt as _, path::Path, time::Duration};

use axum::{
    Router,
    body::Body,
    http::{Request, header},
};
use palpate_people::{Presented, TokenRequest, now_s};
use palpate_server::{Access, LiveStation, Studio, app, assets};
use palpate_wire::api::{Job, JobKindDocument, JobState, Role, Scope};
use serde_json::{Value, json};

use crate::support::{Answer, Data, access, answer_of, get, post};

/// Writes down what it is asked and told, and goes on until it is asked to stop.
const STAND_IN: &str = r#"#!/bin/sh
trap 'echo "{\"event\":\"report\",\"report\":{\"ended\":\"cancelled\"}}"; exit 0' TERM
echo "$@" > ../asked.txt
ls assets/objects > ../objects.txt
echo "$PALPATE_URL $PALPATE_TOKEN" > ../told.txt
echo '{"event":"progress","fraction":0.25,"stage":"trial 1 of 4 waits"}'
while :; do sleep 0.05; done
"#;
const PASSWORD: &str = "correct horse battery";
/// Where a job reaches the studio. Nobody listens there: the stand-in asks for nothing.
const OWN_URL: &str = "http://127.0.0.1:1";

/// Names of campaigns and where the policy of each comes from.
const CAMPAIGNS: [(&str, &str); 8] = [
    ("script", "script:cube"),
    ("each", "{object}.safetensors"),
    ("shipped", "cube.safetensors"),
    ("many", "clone:searching"),
    ("file", "/etc/passwd"),
    ("up", "clone:../../secret.safetensors"),
    ("own script", "script:/tmp/script.toml"),
    ("gone", "imitation-7"),
];

fn stand_in(data: &Data) -> std::path::PathBuf {
    let path = data.path("palpate-train");
    fs::write(&path, STAND_IN).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    path
}

fn studio(data: &Data, login: bool) -> Studio {
    let (truth, _unpacked) = assets::truth(Path::new("small")).unwrap();
    let own_url = Some(OWN_URL.to_owned());
    let access = Access { login, own_url, train: Some(stand_in(data)), ..access() };
    Studio::open(data.root(), Some(&LiveStation::Emulated(truth)), access).unwrap()
}

fn plan(name: &str, source: &str) -> Value {
    json!({
        "name": name, "policies": [{ "id": "a", "source": source }], "objects": [{ "id": "cube" }], "starts": 4,
        "half_width_m": 0.02,
    })
}

fn rollouts(campaign: &str) -> Value {
    json!({ "kind": "rollouts", "request": { "campaign": campaign } })
}

#[tokio::test]
async fn what_a_campaign_names_is_looked_up_and_never_a_file_of_the_computer() {
    let data = Data::empty();
    let app = data.app();
    assert_eq!(post(&app, "/api/v1/campaigns", &plan("script", "script:cube")).await.status, 201);
    // Without a station nothing moves, and the page can say so before anybody asks.
    let answer = post(&app, "/api/v1/jobs", &rollouts("script")).await;
    assert!(answer.problem(answer.status.as_u16()).contains("--station"), "{:?}", answer.body);
    let kinds: Vec<JobKindDocument> = get(&app, "/api/v1/kinds").await.json();
    let kind = kinds.iter().find(|kind| kind.kind == "rollouts").unwrap();
    assert!(!kind.is_available && kind.resources.station, "{kind:?}");

    let data = Data::empty();
    let studio = studio(&data, false);
    let app = app_of(&studio);
    for (name, source) in CAMPAIGNS {
        assert_eq!(post(&app, "/api/v1/campaigns", &plan(name, source)).await.status, 201, "{name}");
    }
    for (campaign, status, words) in [
        ("nothing", 404, "no campaign"),
        ("../people", 400, "campaign"),
        ("file", 400, "policy"),
        ("up", 400, "policy"),
        ("own-script", 400, "script"),
        ("gone", 400, "no policy \"imitation-7\""),
    ] {
        let answer = post(&app, "/api/v1/jobs", &rollouts(campaign)).await;
        let detail = answer.problem(status);
        assert!(detail.contains(words), "{campaign}: {detail}");
    }
    let elsewhere = json!({ "kind": "rollouts", "request": { "campaign": "script" }, "runner": "cluster" });
    assert!(post(&app, "/api/v1/jobs", &elsewhere).await.problem(400).contains("at this computer"));

    // One at a time, whatever is said of the station.
    for (campaign, policy) in [
        ("script", "--policy a=script:assets/grasp/scripts/cube.toml"),
        ("each", "--policy a={object}.safetensors"),
        ("shipped", "--policy a=assets/policies/cube.safetensors"),
        ("many", "--policy a=clone:assets/policies/imitation/searching.safetensors"),
    ] {
        let mut request = rollouts(campaign);
        request["resources"] = json!({ "station": false, "cores": 1 });
        let job: Job = accepted(&post(&app, "/api/v1/jobs", &request).await);
        assert!(job.spec.resources.station);
        let second = post(&app, "/api/v1/jobs", &rollouts("script")).await;
        assert!(second.problem(409).contains("has the station"), "{:?}", second.body);
        wait(&app, &job.id, |job| job.fraction > 0.0).await;
        let asked = fs::read_to_string(data.root().join("runs").join(&job.id).join("asked.txt")).unwrap();
        for words in [
            policy,
            "--placed-at-page",
            &format!("--record {campaign}-takes"),
            &format!("--url {OWN_URL}"),
            &format!("--campaign {campaign}"),
        ] {
            assert!(asked.contains(words), "{words:?} is missing in {asked:?}");
        }
        let told = fs::read_to_string(data.root().join("runs").join(&job.id).join("told.txt")).unwrap();
        assert_eq!(told.trim(), OWN_URL, "nobody logs in here");
        assert_eq!(post(&app, &format!("/api/v1/jobs/{}/cancel", job.id), &json!({})).await.status, 200);
        let job = wait(&app, &job.id, |job| !job.is_unfinished()).await;
        assert_eq!(job.state, JobState::Cancelled);
    }

    // Takes go where somebody wants them, and not into what somebody brought.
    fs::create_dir_all(data.root().join("sessions/brought")).unwrap();
    for (field, value, status, words) in [
        ("session", json!("brought"), 409, "was not recorded by this studio"),
        ("session", json!("../people"), 400, "session"),
        ("without_recording", json!(true), 202, "without"),
        ("session", json!("grasps"), 202, "--record grasps"),
    ] {
        let mut request = rollouts("script");
        request["request"][field] = value;
        let answer = post(&app, "/api/v1/jobs", &request).await;
        if status != 202 {
            let detail = answer.problem(status);
            assert!(detail.contains(words), "{detail}");
            continue;
        }
        let job = accepted(&answer);
        wait(&app, &job.id, |job| job.fraction > 0.0).await;
        let asked = fs::read_to_string(data.root().join("runs").join(&job.id).join("asked.txt")).unwrap();
        assert!(asked.contains(words) || (words == "without" && !asked.contains("--record")), "{asked}");
        assert_eq!(post(&app, &format!("/api/v1/jobs/{}/cancel", job.id), &json!({})).await.status, 200);
        wait(&app, &job.id, |job| !job.is_unfinished()).await;
    }
    assert_eq!(post(&app, "/api/v1/campaigns/script/close", &json!({})).await.status, 200);
    assert!(post(&app, "/api/v1/jobs", &rollouts("script")).await.problem(409).contains("is closed"));
}

#[tokio::test]
async fn whoever_asks_may_move_the_robot_and_the_job_may_for_as_long_as_it_works() {
    let data = Data::empty();
    let studio = studio(&data, true);
    let (app, people) = (app_of(&studio), studio.state.people().clone());
    people.add("olga", Role::Operator, PASSWORD, now_s()).unwrap();
    let token = |scopes: &[Scope]| {
        let request =
            TokenRequest { person: "olga", name: "test", role: None, scopes: Some(scopes), expires_days: 1 };
        people.create_token(&request, now_s()).unwrap().1
    };
    let (mover, keeper) =
        (token(&[Scope::Read, Scope::Jobs, Scope::Data, Scope::Control]), token(&[Scope::Read, Scope::Jobs]));
    let made = ask(&app, &mover, "POST", "/api/v1/campaigns", &plan("night", "script:cube")).await;
    assert_eq!(made.status, 201, "{:?}", made.body);

    let answer = ask(&app, &keeper, "POST", "/api/v1/jobs", &rollouts("night")).await;
    assert!(answer.problem(403).contains("moves the robot"), "{:?}", answer.body);
    let job: Job = accepted(&ask(&app, &mover, "POST", "/api/v1/jobs", &rollouts("night")).await);
    let path = format!("/api/v1/jobs/{}", job.id);
    let told = data.root().join("runs").join(&job.id).join("told.txt");
    while !told.exists() {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    tokio::time::sleep(Duration::from_millis(200)).await;
    let told = fs::read_to_string(&told).unwrap();
    let (url, secret) = told.trim().split_once(' ').unwrap();
    assert_eq!(url, OWN_URL);
    let its = people.authenticate(Presented::Bearer(secret), now_s()).expect("it lets the job in");
    assert_eq!(&**its.name(), "olga");
    assert!(its.may(Role::Operator, Scope::Control) && !its.may(Role::Operator, Scope::Jobs));
    // It stands in no document and no log.
    for path in [path.clone(), format!("{path}/log"), "/api/v1/jobs".to_owned()] {
        let answer = ask(&app, &mover, "GET", &path, &Value::Null).await;
        assert!(!String::from_utf8_lossy(&answer.body).contains(secret), "{path}");
    }
    for (who, what) in [(&keeper, "clone"), (&keeper, "retry")] {
        let answer = ask(&app, who, "POST", &format!("{path}/{what}"), &json!({})).await;
        assert!(answer.problem(403).contains("moves the robot"), "{what}: {:?}", answer.body);
    }

    let asked = ask(&app, &keeper, "POST", &format!("{path}/cancel"), &json!({})).await;
    assert_eq!(asked.status, 200, "stopping needs no control");
    while people.authenticate(Presented::Bearer(secret), now_s()).is_ok() {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let job: Job = ask(&app, &mover, "GET", &path, &Value::Null).await.json();
    assert_eq!(job.state, JobState::Cancelled, "the token ended with it");
    assert!(people.tokens(Some("olga")).iter().all(|token| token.name == "test"));
}

fn app_of(studio: &Studio) -> Router {
    app(studio.state.clone())
}

fn accepted(answer: &Answer) -> Job {
    assert_eq!(answer.status, 202, "{:?}", answer.body);
    answer.json()
}

async fn wait(app: &Router, id: &str, until: impl Fn(&Job) -> bool) -> Job {
    loop {
        let job: Job = get(app, &format!("/api/v1/jobs/{id}")).await.json();
        if until(&job) {
            return job;
        }
        assert_ne!(job.state, JobState::Failed, "{job:?}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

async fn ask(app: &Router, token: &str, method: &str, path: &str, body: &Value) -> Answer {
    let request = Request::builder()
        .method(method)
        .uri(path)
        .header(header::HOST, "localhost")
        .header(header::CONTENT_TYPE, "application/json")
        .header(header::AUTHORIZATION, format!("Bearer {token}"));
    let body = if body.is_null() { Body::empty() } else { Body::from(body.to_string()) };
    answer_of(app, request.body(body).unwrap()).await
}

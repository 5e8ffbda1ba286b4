//! Trainings as jobs: what is refused, what is asked of `palpate-train`, and what becomes of what it says. A shell
//! script stands in for the program; `policy/train/tests/it/jobs.rs` has the real one.

use std::{
    fs,
    os::unix::fs::PermissionsExt as _,
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, Instant},
};

use axum::Router;
use palpate_server::{Access, AppState, Studio, app};
use palpate_wire::api::{Job, JobKindDocument, JobState, ProblemDetails};
use serde_json::{Value, json};

use crate::support::{Data, access, arg, ended, get, palpate_ok, palpate_refuses, post, send, wait};

/// Writes what it is asked to `asked.txt` of the job, and leaves a policy, a script or demonstrations as the program
/// does.
const STAND_IN: &str = r#"#!/bin/sh
out=
previous=
for word in "$@"; do
    [ "$previous" = --out ] && out=$word
    previous=$word
done
job=$(dirname "$out")
[ -f assets/grasp/xarm6_leap.toml ] || { echo "palpate-train: no assets here" >&2; exit 1; }
echo "$@" >> "$job/../asked.txt"
case "$2" in
export) echo weights > "$out"; exit 0 ;;
tune) echo '# a script' > "$out" ;;
demos) mkdir -p "$out"; echo data > "$out/shard-00000.safetensors.zst"; echo '{}' > "$out/manifest.json" ;;
gather) mkdir -p "$out"; echo data > "$out/cube.safetensors.zst" ;;
ppo | encode) mkdir -p "$out"; echo state > "$out/checkpoint.safetensors" ;;
clone) mkdir -p "$out"; echo state > "$out/checkpoint.safetensors"; echo imitator > "$out/policy.safetensors" ;;
esac
case " $* " in
*" --total-steps 13 "*) echo 'palpate-train: thirteen steps are too few' >&2; exit 1 ;;
*" --total-steps 666 "*) kill -9 $$ ;;
*" --total-steps 999 "*)
    echo '{"event":"progress","fraction":0.5,"stage":"learning"}'
    exec sleep 600 ;;
esac
echo '{"event":"progress","fraction":0.5,"stage":"learning"}'
echo 'a warning of a library'
echo '{"event":"metrics","point":{"step":1,"loss":0.5}}'
echo '{"event":"metrics","point":{"step":2,"loss":0.25}}'
echo '{"event":"report","report":{"won":3}}'
"#;

/// The kinds that the program works on.
const TRAININGS: [&str; 9] = [
    "tune",
    "expert",
    "evaluation",
    "demonstrations",
    "pretraining",
    "gathering",
    "imitation",
    "pipeline",
    "comparison",
];

fn program(data: &Data, text: &str) -> PathBuf {
    let path = data.path("palpate-train");
    fs::write(&path, text).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    path
}

fn studio(data: &Data, train: &Path) -> (Router, Arc<AppState>) {
    let access = Access { train: Some(train.to_owned()), ..access() };
    let state = Studio::open(data.root(), None, access).unwrap().state;
    (app(state.clone()), state)
}

async fn start(app: &Router, kind: &str, request: Value) -> String {
    let answer = post(app, "/api/v1/jobs", &json!({ "kind": kind, "request": request, "seed": 5 })).await;
    assert_eq!(answer.status, 202, "{:?}", answer.body);
    answer.json::<Job>().id
}

async fn text(app: &Router, path: &str) -> String {
    String::from_utf8_lossy(&get(app, path).await.body).into_owned()
}

#[tokio::test]
async fn studio_without_the_program_says_so_and_how_to_get_it() {
    let data = Data::empty();
    let (app, _state) = studio(&data, &data.path("nowhere/palpate-train"));
    let kinds: Vec<JobKindDocument> = get(&app, "/api/v1/kinds").await.json();
    for kind in &kinds {
        if kind.kind == "rollouts" {
            // It needs a station first.
            continue;
        }
        let needs_it = TRAININGS.contains(&kind.kind.as_str());
        assert_eq!(kind.is_available, !needs_it, "{kind:?}");
        assert_eq!(kind.problem.as_deref().is_some_and(|problem| problem.contains("cargo build")), needs_it);
    }
    let answer =
        post(&app, "/api/v1/jobs", &json!({ "kind": "expert", "request": { "object": "cube" } })).await;
    assert!(answer.problem(409).contains("palpate-train"), "{:?}", answer.body);
    assert_eq!(answer.json::<ProblemDetails>().kind, "urn:palpate:problem:not-installed");
    // As soon as it is there, it is found.
    fs::create_dir(data.path("nowhere")).unwrap();
    fs::copy(program(&data, STAND_IN), data.path("nowhere/palpate-train")).unwrap();
    let kinds: Vec<JobKindDocument> = get(&app, "/api/v1/kinds").await.json();
    let missing: Vec<&str> =
        kinds.iter().filter(|kind| !kind.is_available).map(|kind| kind.kind.as_str()).collect();
    assert_eq!(missing, ["rollouts"], "there is no station");
}

#[tokio::test]
async fn what_makes_no_sense_is_refused_before_it_waits() {
    let data = Data::empty();
    let (app, _state) = studio(&data, &program(&data, STAND_IN));
    for (kind, request, status, words) in [
        ("expert", json!({}), 422, "missing field `object`"),
        ("expert", json!({ "object": "cueb" }), 400, "no object \"cueb\"; shipped are ball"),
        ("expert", json!({ "object": "../cube" }), 400, "object"),
        ("expert", json!({ "object": "cube", "preset": "slow" }), 400, "quick"),
        ("expert", json!({ "object": "cube", "preset": "quick", "config": "" }), 400, "two ways"),
        ("expert", json!({ "object": "cube", "config": "num_envs = " }), 422, "config"),
        ("expert", json!({ "object": "cube", "total_steps": 0 }), 400, "total_steps = 0"),
        ("expert", json!({ "object": "cube", "start_cm": -1.0 }), 400, "start_cm = -1"),
        ("expert", json!({ "object": "cube", "script": "dance" }), 400, "no script \"dance\""),
        (
            "expert",
            json!({ "object": "cube", "script": "cube", "without_script": true }),
            400,
            "without_script",
        ),
        ("expert", json!({ "object": "cube", "model": "gone" }), 404, "gone"),
        ("expert", json!({ "object": "cube", "speed": 2 }), 422, "speed"),
        ("evaluation", json!({ "policy": "expert-9" }), 400, "no policy \"expert-9\""),
        ("evaluation", json!({ "policy": "cube", "controls": true }), 400, "protocol"),
        ("evaluation", json!({ "policy": "cube", "protocol": "fast" }), 400, "shipped are claim, paper"),
        (
            "evaluation",
            json!({ "policy": "cube", "protocol": "wide", "start_cm": 2 }),
            400,
            "leave start_cm out",
        ),
        ("demonstrations", json!({ "policy": "cube", "count": 0 }), 400, "count = 0"),
        ("pretraining", json!({ "demonstrations": [] }), 400, "nothing to learn from"),
        (
            "pretraining",
            json!({ "demonstrations": ["demonstrations-1"] }),
            400,
            "no job \"demonstrations-1\"",
        ),
        ("evaluation", json!({ "policy": "cube", "objects": ["egg"] }), 400, "objects belong to a protocol"),
        (
            "evaluation",
            json!({ "policy": "cube", "protocol": "wide", "objects": ["egg", "all"] }),
            400,
            "\"all\" is a group",
        ),
        ("gathering", json!({ "objects": ["cueb"] }), 400, "no object \"cueb\""),
        ("gathering", json!({ "objects": ["cube", "cube"] }), 400, "\"cube\" twice"),
        ("gathering", json!({ "objects": "seen" }), 422, "expected a sequence"),
        ("gathering", json!({ "count": 0 }), 400, "count = 0"),
        ("gathering", json!({ "protocol": "fast" }), 400, "shipped are claim, paper"),
        ("gathering", json!({ "model": "gone" }), 404, "gone"),
        ("imitation", json!({}), 422, "missing field `trials`"),
        ("imitation", json!({ "trials": [] }), 400, "nothing to learn from"),
        ("imitation", json!({ "trials": ["gathering-1"] }), 400, "no job \"gathering-1\""),
        ("imitation", json!({ "trials": ["gathering-1"], "preset": "quick" }), 400, "\"small\" or \"paper\""),
        ("pipeline", json!({ "preset": "quick" }), 400, "\"small\" or \"tables\" or \"paper\""),
        ("imitation", json!({ "trials": ["gathering-1"], "head": "guess" }), 400, "diffusion"),
        ("imitation", json!({ "trials": ["gathering-1"], "updates": 0 }), 400, "updates = 0"),
        (
            "imitation",
            json!({ "trials": ["gathering-1"], "policy": "raw-dp", "head": "act" }),
            400,
            "head: the policy \"raw-dp\" says this itself",
        ),
        (
            "imitation",
            json!({ "trials": ["gathering-1"], "config": "[observation]\nfeatures = true\n" }),
            400,
            "encoder: there is none",
        ),
        (
            "gathering",
            json!({ "expert": "oracle" }),
            400,
            "expert: \"oracle\" is none of search, search:touch",
        ),
        ("tune", json!({ "object": "cube", "candidates": 4 }), 400, "elite = 10; expected at most the 4"),
        ("tune", json!({ "object": "cube", "generations": 0 }), 400, "generations = 0"),
    ] {
        let answer = post(&app, "/api/v1/jobs", &json!({ "kind": kind, "request": request })).await;
        let detail = answer.problem(status);
        assert!(detail.contains(words), "{kind} {request}: {detail}");
    }
    assert_eq!(get(&app, "/api/v1/jobs").await.json::<Value>()["jobs"], json!([]));
}

#[tokio::test]
async fn lineage_from_script_to_encoder_runs_as_jobs_that_name_each_other() {
    let data = Data::empty();
    let (app, _state) = studio(&data, &program(&data, STAND_IN));
    let tuned = start(&app, "tune", json!({ "object": "ball", "generations": 2 })).await;
    assert_eq!(ended(&app, &tuned).await.state, JobState::Done);
    let wrong = json!({ "kind": "evaluation", "request": { "policy": "tuning-1" } });
    assert!(post(&app, "/api/v1/jobs", &wrong).await.problem(400).contains("of kind \"tune\""));

    let request =
        json!({ "object": "ball", "script": "tuning-1", "total_steps": 40, "config": "num_envs = 1\n" });
    let expert = start(&app, "expert", request).await;
    let job = ended(&app, &expert).await;
    assert_eq!((job.state, job.problem), (JobState::Done, None));
    assert_eq!(job.spec.inputs.keys().collect::<Vec<_>>(), ["runs/tuning-1/script.toml"]);
    let report: Value = get(&app, "/api/v1/jobs/expert-1/files/report.json").await.json();
    assert_eq!(
        (&report["won"], &report["object"], &report["policy_bytes"]),
        (&json!(3), &json!("ball"), &json!(8))
    );
    assert_eq!(text(&app, "/api/v1/jobs/expert-1/files/policy.safetensors").await, "weights\n");
    assert_eq!(text(&app, "/api/v1/jobs/expert-1/files/script.toml").await, "# a script\n");
    let points = text(&app, "/api/v1/jobs/expert-1/metrics").await;
    let points: Vec<Value> = points.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(points, [json!({ "step": 1, "loss": 0.5 }), json!({ "step": 2, "loss": 0.25 })]);
    assert!(text(&app, "/api/v1/jobs/expert-1/log").await.contains("a warning of a library"));
    assert!(!data.root().join("runs/expert-1/work").exists(), "the assets beside which it ran are gone");

    let demos = start(&app, "demonstrations", json!({ "policy": "expert-1", "count": 4 })).await;
    assert_eq!(ended(&app, &demos).await.state, JobState::Done);
    let scored = start(&app, "evaluation", json!({ "policy": "expert-1", "trials": 3 })).await;
    assert_eq!(ended(&app, &scored).await.state, JobState::Done);
    let encoder =
        start(&app, "pretraining", json!({ "demonstrations": ["demonstrations-1"], "epochs": 2 })).await;
    let job = ended(&app, &encoder).await;
    assert_eq!(job.state, JobState::Done, "{job:?}");
    let inputs: Vec<&String> = job.spec.inputs.keys().collect();
    let dir = "runs/demonstrations-1/demonstrations";
    assert_eq!(inputs, [&format!("{dir}/manifest.json"), &format!("{dir}/shard-00000.safetensors.zst")]);
    let shipped = start(&app, "evaluation", json!({ "policy": "egg", "protocol": "wide" })).await;
    assert_eq!(ended(&app, &shipped).await.state, JobState::Done);

    let asked = fs::read_to_string(data.root().join("runs/asked.txt")).unwrap();
    let asked: Vec<String> =
        asked.lines().map(|line| line.replace(&format!("{}/", arg(data.root())), "")).collect();
    let expected = [
        "--events tune --object ball --script assets/grasp/scripts/xarm6_leap_cube.toml --seed 5 --generations 2 --out \
         runs/tuning-1/script.toml",
        "--events ppo --config runs/expert-1/config.toml --seed 5 --out runs/expert-1/training --resume --object ball \
         --total-steps 40 --script runs/expert-1/script.toml",
        "--events export --policy runs/expert-1/training --out runs/expert-1/policy.safetensors",
        "--events demos --policy runs/expert-1/policy.safetensors --object ball --script runs/expert-1/script.toml \
         --count 4 --seed 5 --out runs/demonstrations-1/demonstrations",
    ];
    assert_eq!(asked[..4], expected);
    assert!(
        asked.iter().any(|line| line.ends_with("--epochs 2 --demos runs/demonstrations-1/demonstrations"))
    );

    // What a policy was made of is an input of what is made with it.
    fs::write(data.root().join("runs/expert-1/policy.safetensors"), "other weights").unwrap();
    let answer = post(&app, "/api/v1/jobs/evaluation-1/clone", &json!({})).await;
    assert_eq!(answer.status, 202, "on the data as it is now");
    assert_eq!(ended(&app, &answer.json::<Job>().id).await.state, JobState::Done);
}

#[tokio::test]
async fn refusal_crash_and_cancel_end_a_training_each_in_its_way() {
    let data = Data::empty();
    let train = program(&data, STAND_IN);
    let (app, state) = studio(&data, &train);
    let refused = start(&app, "expert", json!({ "object": "cube", "total_steps": 13 })).await;
    let job = ended(&app, &refused).await;
    assert_eq!((job.state, job.problem.as_deref()), (JobState::Failed, Some("thirteen steps are too few")));
    let crashed = start(&app, "expert", json!({ "object": "cube", "total_steps": 666 })).await;
    let job = ended(&app, &crashed).await;
    assert!(job.state == JobState::Failed && job.problem.is_some_and(|problem| problem.contains("signal 9")));

    // It goes on while no studio is there, and the next one finds it.
    let long = start(&app, "expert", json!({ "object": "cube", "total_steps": 999 })).await;
    let at_half = |job: &Job| job.fraction == 0.5 && job.stage == "learning";
    wait(&app, &long, at_half).await;
    state.begin_shutdown();
    drop((app, state));
    let patience = Instant::now();
    let (app, _state) = loop {
        let access = Access { train: Some(train.clone()), ..access() };
        match Studio::open(data.root(), None, access) {
            Ok(studio) => break (app_of(&studio), studio.state),
            Err(err) => assert!(patience.elapsed() < Duration::from_secs(60), "{err}"),
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    };
    let job = wait(&app, &long, at_half).await;
    assert_eq!((job.state, job.attempts), (JobState::Running, 1));
    assert_eq!(send(&app, "POST", &format!("/api/v1/jobs/{long}/cancel"), None).await.status, 200);
    let job = ended(&app, &long).await;
    assert_eq!((job.state, job.problem), (JobState::Cancelled, None));
    // With its process, those that it started are gone.
    let folder = data.root().join("runs").join(&long);
    let still = fs::read_dir("/proc")
        .unwrap()
        .flatten()
        .find(|entry| fs::read_link(entry.path().join("cwd")).is_ok_and(|cwd| cwd.starts_with(&folder)));
    assert!(still.is_none(), "{still:?}");
    assert_eq!(send(&app, "POST", &format!("/api/v1/jobs/{long}/retry"), None).await.status, 200);
    wait(&app, &long, |job| job.attempts == 2 && at_half(job)).await;
    assert_eq!(send(&app, "POST", &format!("/api/v1/jobs/{long}/cancel"), None).await.status, 200);
    ended(&app, &long).await;
}

#[tokio::test]
async fn what_an_expert_does_is_gathered_and_imitated_and_the_imitation_scored() {
    let data = Data::empty();
    let (app, _state) = studio(&data, &program(&data, STAND_IN));
    let gathered = start(&app, "gathering", json!({ "objects": ["cube", "egg"], "count": 3 })).await;
    assert_eq!(ended(&app, &gathered).await.state, JobState::Done);
    let twice = json!({ "trials": ["gathering-1", "gathering-1"] });
    let answer = post(&app, "/api/v1/jobs", &json!({ "kind": "imitation", "request": twice })).await;
    assert!(answer.problem(400).contains("twice"));
    let request = json!({ "trials": ["gathering-1"], "head": "diffusion", "only_won": true });
    let job = ended(&app, &start(&app, "imitation", request).await).await;
    assert_eq!((job.state, job.problem), (JobState::Done, None));
    assert_eq!(job.spec.inputs.keys().collect::<Vec<_>>(), ["runs/gathering-1/trials/cube.safetensors.zst"]);
    assert_eq!(text(&app, "/api/v1/jobs/imitation-1/files/policy.safetensors").await, "imitator\n");
    assert!(text(&app, "/api/v1/jobs/imitation-1/metrics").await.contains("\"loss\":0.25"));

    // It is a policy under a protocol, and nowhere else.
    for (kind, request, words) in [
        ("evaluation", json!({ "policy": "imitation-1" }), "give a protocol"),
        ("demonstrations", json!({ "policy": "imitation-1", "count": 4 }), "job of kind \"expert\""),
        ("imitation", json!({ "trials": ["imitation-1"] }), "give one of kind \"gathering\""),
    ] {
        let answer = post(&app, "/api/v1/jobs", &json!({ "kind": kind, "request": request })).await;
        let detail = answer.problem(400);
        assert!(detail.contains(words), "{detail}");
    }
    for objects in [json!([]), json!(["cube", "ring"])] {
        let request = json!({ "policy": "imitation-1", "protocol": "wide", "objects": objects });
        let job = ended(&app, &start(&app, "evaluation", request).await).await;
        assert_eq!(job.state, JobState::Done, "{job:?}");
    }
    let asked = fs::read_to_string(data.root().join("runs/asked.txt")).unwrap();
    let asked: Vec<String> =
        asked.lines().map(|line| line.replace(&format!("{}/", arg(data.root())), "")).collect();
    let expected = [
        "--events gather --count 3 --seed 5 --out runs/gathering-1/trials --objects cube,egg",
        "--events clone --seed 5 --out runs/imitation-1/training --resume --head diffusion --only-won --data \
         runs/gathering-1/trials",
        "--events evaluate --policy clone:runs/imitation-1/policy.safetensors --seed 5 --protocol wide --objects seen \
         --by-object runs/evaluation-1/trials --out runs/evaluation-1/comparison.json",
        "--events evaluate --policy clone:runs/imitation-1/policy.safetensors --seed 5 --protocol wide --objects cube,ring \
         --by-object runs/evaluation-2/trials --out runs/evaluation-2/comparison.json",
    ];
    assert_eq!(asked, expected);

    // One that is told its region needs trials of two, and one that sees features an encoder that is done.
    let wide = start(&app, "gathering", json!({ "count": 3, "protocol": "wide" })).await;
    let paper = start(&app, "gathering", json!({ "protocol": "paper", "expert": "repetition" })).await;
    for id in [&wide, &paper] {
        assert_eq!(ended(&app, id).await.state, JobState::Done);
    }
    for (request, words) in [
        (json!({ "trials": ["gathering-1", "gathering-2"], "region": true }), "of the region ±8 cm"),
        (json!({ "trials": ["gathering-1"], "region": true }), "region: one gathering is of one region"),
        (
            json!({ "trials": ["gathering-1"], "policy": "pretrained-act", "encoder": "gathering-1" }),
            "give one of kind \"pretraining\"",
        ),
    ] {
        let answer = post(&app, "/api/v1/jobs", &json!({ "kind": "imitation", "request": request })).await;
        let detail = answer.problem(400);
        assert!(detail.contains(words), "{request}: {detail}");
    }
    let request = json!({
        "trials": ["gathering-1", "gathering-3"], "region": true, "head": "act", "memory": "recurrent",
    });
    assert_eq!(ended(&app, &start(&app, "imitation", request).await).await.state, JobState::Done);
    let asked = fs::read_to_string(data.root().join("runs/asked.txt")).unwrap();
    assert!(asked.contains("gather --protocol paper --expert repetition --seed 5"), "{asked}");
    assert!(asked.contains("--resume --head act --memory recurrent --region --data"), "{asked}");
}

#[tokio::test]
async fn an_imitation_that_has_the_graphics_card_learns_on_it() {
    let data = Data::empty();
    fs::create_dir_all(data.root()).unwrap();
    fs::write(data.root().join("runners.toml"), "[process]\ngpu = true\n").unwrap();
    let (app, _state) = studio(&data, &program(&data, STAND_IN));
    let gathered = start(&app, "gathering", json!({ "objects": ["cube"], "count": 3 })).await;
    assert_eq!(ended(&app, &gathered).await.state, JobState::Done);
    let job =
        json!({ "kind": "imitation", "request": { "trials": [gathered] }, "resources": { "gpu": true } });
    let answer = post(&app, "/api/v1/jobs", &job).await;
    assert_eq!(ended(&app, &answer.json::<Job>().id).await.state, JobState::Done);
    let asked = fs::read_to_string(data.root().join("runs/asked.txt")).unwrap();
    let learning = asked.lines().find(|line| line.contains(" clone ")).unwrap();
    assert!(learning.contains(" --device gpu"), "{learning}");
}

fn app_of(studio: &Studio) -> Router {
    app(studio.state.clone())
}

#[tokio::test]
async fn command_line_queues_a_job_that_the_studio_starts() {
    let data = Data::empty();
    let train = program(&data, STAND_IN);
    let folder = ["--data", arg(data.root())];
    let missing = palpate_refuses(&[&["jobs", "submit", "tune", "{}"], &folder[..]].concat());
    assert!(missing.contains("--data"), "{missing}");
    let (app, _state) = studio(&data, &train);
    let printed = palpate_ok(&submission(&data, &train, "tune", r#"{"object": "cube"}"#));
    let job: Job = serde_json::from_str(&printed).unwrap();
    assert_eq!((job.id.as_str(), job.state, job.spec.seed), ("tuning-1", JobState::Queued, 5));
    assert_eq!(ended(&app, "tuning-1").await.state, JobState::Done);
    for (kind, request, words) in [
        ("tune", r#"{"object": "cueb"}"#, "no object"),
        ("tune", "{", "no JSON"),
        ("dance", "{}", "expert, evaluation"),
        ("rollouts", r#"{"campaign": "night"}"#, "the studio that has it must be asked"),
    ] {
        let refused = palpate_refuses(&submission(&data, &train, kind, request));
        assert!(refused.contains(words), "{refused}");
    }
}

/// Arguments that queue a job.
fn submission<'a>(data: &'a Data, train: &'a Path, kind: &'a str, request: &'a str) -> Vec<&'a str> {
    let data = arg(data.root());
    vec!["jobs", "submit", kind, request, "--seed", "5", "--json", "--train", arg(train), "--data", data]
}

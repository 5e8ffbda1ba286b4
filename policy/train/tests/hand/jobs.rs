//! Trainings as jobs of a real studio, which ends and comes back meanwhile.

use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use palpate_rollout::studio::Studio;
use palpate_wire::api::{Job, JobKindDocument, JobState};
use serde_json::{Value, json};

use super::station::{self, Ready, palpate};
use super::{palpate_train, turn};

/// Whatever is waited for comes long before this, unless it never does.
const PATIENCE: Duration = Duration::from_secs(300);
/// One environment and small networks; a checkpoint after every update.
const SMALL: &str = "num_envs = 1\nunroll_length = 4\nbatch_size = 1\nnum_minibatches = 1\nnum_epochs = 1\n\
    total_steps = 8\ncheckpoint_updates = 1\n[networks]\nactor = [8]\ncritic = [8]\n";

/// A studio with the program that is tested.
fn serve(palpate: &Path, data: &Path) -> (Ready, Studio) {
    let (running, url) =
        station::studio(palpate, data, &["--train", env!("CARGO_BIN_EXE_palpate-train")], &Value::Null);
    (running, Studio::new(&url, None, None).expect("a studio"))
}

fn start(studio: &Studio, kind: &str, request: &Value) -> String {
    let job: Job = studio
        .post("/jobs", &json!({ "kind": kind, "request": request, "seed": 3 }))
        .unwrap_or_else(|err| panic!("{kind}: {err:?}"));
    job.id
}

fn wait(studio: &Studio, id: &str, until: impl Fn(&Job) -> bool) -> Job {
    let begun = Instant::now();
    loop {
        let job: Job = studio.get(&format!("/jobs/{id}")).expect("the job");
        if until(&job) {
            return job;
        }
        assert!(begun.elapsed() < PATIENCE, "{job:?}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

fn done(studio: &Studio, data: &Path, id: &str) -> Value {
    let job = wait(studio, id, |job| !job.is_unfinished());
    let log = std::fs::read_to_string(data.join("runs").join(id).join("log.txt")).unwrap_or_default();
    assert_eq!(job.state, JobState::Done, "{job:?}\n{log}");
    let report = std::fs::read(data.join("runs").join(id).join("report.json")).expect("a report");
    serde_json::from_slice(&report).expect("JSON")
}

/// Steps of the points of a job's curves.
fn curve_steps(data: &Path, id: &str) -> Vec<u64> {
    let text = std::fs::read_to_string(data.join("runs").join(id).join("metrics.jsonl")).expect("curves");
    let points = text.lines().map(|line| serde_json::from_str::<Value>(line).expect("JSON"));
    points.map(|point| point["step"].as_u64().expect("a step")).collect()
}

#[test]
fn an_expert_is_trained_scored_and_cancelled_while_the_studio_comes_and_goes() {
    let Some(palpate) = palpate() else { return };
    let _turn = turn();
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let (running, studio) = serve(&palpate, &data);
    let kinds: Vec<JobKindDocument> = studio.get("/kinds").expect("kinds");
    let missing: Vec<&str> =
        kinds.iter().filter(|kind| !kind.is_available).map(|kind| kind.kind.as_str()).collect();
    assert_eq!(missing, ["rollouts"], "there is no station");

    // One that ends by itself, and behind it one that would go on for hours.
    let request = json!({ "object": "cube", "config": SMALL });
    let small = start(&studio, "expert", &request);
    let request = json!({ "object": "cube", "config": SMALL, "total_steps": 100_000_000 });
    let long = start(&studio, "expert", &request);
    let report = done(&studio, &data, &small);
    assert_eq!((&report["steps"], &report["finish"]), (&json!(8), &json!("steps")));
    assert_eq!(curve_steps(&data, &small), [1, 2], "a point an update");
    let points =
        std::fs::read_to_string(data.join("runs").join(&small).join("metrics.jsonl")).expect("curves");
    assert!(points.contains("\"reward_terms."), "{points}");

    let curve = data.join("runs").join(&long).join("metrics.jsonl");
    let begun = Instant::now();
    let num_points = || std::fs::read_to_string(&curve).map_or(0, |text| text.lines().count());
    while num_points() < 2 {
        assert!(begun.elapsed() < PATIENCE, "it learns nothing");
        std::thread::sleep(Duration::from_millis(50));
    }
    drop((running, studio));

    // It goes on while no studio is there, and the next one finds both.
    let before = num_points();
    let begun = Instant::now();
    while num_points() <= before {
        assert!(begun.elapsed() < PATIENCE, "it has ended with the studio");
        std::thread::sleep(Duration::from_millis(50));
    }
    let (_running, studio) = serve(&palpate, &data);
    let job: Job = studio.get(&format!("/jobs/{small}")).expect("the job");
    assert_eq!(job.state, JobState::Done);
    let job: Job = studio.get(&format!("/jobs/{long}")).expect("the job");
    assert_eq!((job.state, job.attempts), (JobState::Running, 1));
    let _: Job = studio.post(&format!("/jobs/{long}/cancel"), &json!({})).expect("it is asked");
    let job = wait(&studio, &long, |job| !job.is_unfinished());
    assert_eq!(job.state, JobState::Cancelled, "{job:?}");

    // What was cancelled goes on from its checkpoint.
    let last_step = || {
        let text = std::fs::read_to_string(&curve).expect("curves");
        let line: Value = serde_json::from_str(text.lines().last().expect("a point")).expect("JSON");
        line["step"].as_u64().expect("a step")
    };
    let reached = last_step();
    let _: Job = studio.post(&format!("/jobs/{long}/retry"), &json!({})).expect("it begins again");
    let begun = Instant::now();
    while last_step() <= reached {
        assert!(begun.elapsed() < PATIENCE, "it does not go on");
        std::thread::sleep(Duration::from_millis(50));
    }
    let text = std::fs::read_to_string(&curve).expect("curves");
    assert!(text.lines().count() as u64 <= last_step() + 2, "it has begun from the start: {text}");
    let _: Job = studio.post(&format!("/jobs/{long}/cancel"), &json!({})).expect("it is asked");
    wait(&studio, &long, |job| !job.is_unfinished());

    // What was learned serves as a policy, and so do shipped ones.
    let scored = start(&studio, "evaluation", &json!({ "policy": small, "trials": 2 }));
    let score = done(&studio, &data, &scored);
    assert_eq!(score["objects"]["cube"]["trials"], 2);
    let demos = start(&studio, "demonstrations", &json!({ "policy": "cube", "count": 2, "shard_demos": 1 }));
    let manifest = done(&studio, &data, &demos);
    assert_eq!(manifest["files"].as_array().map(Vec::len), Some(2), "{manifest}");
    let request = json!({
        "object": "cube", "generations": 1, "candidates": 2, "elite": 1, "trials": 1, "check_trials": 2,
    });
    let tuned = start(&studio, "tune", &request);
    let found = done(&studio, &data, &tuned);
    assert_eq!(found["generations"].as_array().map(Vec::len), Some(2), "{found}");
    let request = json!({ "object": "cube", "config": SMALL, "script": tuned });
    let on_top = start(&studio, "expert", &request);
    done(&studio, &data, &on_top);

    // What the searching expert does is imitated, and the imitation scored.
    // A shard an object; both are there when the job's own process counts them.
    let request = json!({
        "kind": "gathering", "request": { "objects": ["cube", "ball"], "count": 2 }, "seed": 3,
        "resources": { "shards": 2 },
    });
    let gathered = studio.post::<Job>("/jobs", &request).expect("it waits").id;
    let kept = done(&studio, &data, &gathered);
    assert_eq!((&kept["trials"], &kept["objects"]["ball"]["trials"]), (&json!(4), &json!(2)));
    assert_eq!(curve_steps(&data, &gathered), [1, 2], "a point an object");
    for (shard, object) in ["cube", "ball"].iter().enumerate() {
        let log = data.join(format!("runs/{gathered}/shards/{shard}/log.txt"));
        let log = std::fs::read_to_string(log).expect("its log");
        assert!(log.contains(&format!("{object}: ")) && !log.contains("already"), "{log}");
    }
    let log = std::fs::read_to_string(data.join(format!("runs/{gathered}/log.txt"))).expect("a log");
    assert_eq!(log.matches("trials are there already").count(), 2, "{log}");
    // Undivided it leaves the same bytes.
    let request = json!({ "objects": ["cube", "ball"], "count": 2 });
    let whole = start(&studio, "gathering", &request);
    done(&studio, &data, &whole);
    let trials = |id: &str, object: &str| {
        std::fs::read(data.join(format!("runs/{id}/trials/{object}.safetensors.zst"))).expect("trials")
    };
    for object in ["cube", "ball"] {
        assert!(trials(&whole, object) == trials(&gathered, object), "other bytes on {object}");
    }
    let config = "updates = 4\ncheckpoint_updates = 2\nbatch_size = 4\ntrunk = [8]\n";
    let imitated = start(&studio, "imitation", &json!({ "trials": [gathered], "config": config }));
    let learned = done(&studio, &data, &imitated);
    assert_eq!(learned["updates"], 4, "{learned}");
    assert_eq!(curve_steps(&data, &imitated), [2, 4], "a point a checkpoint");
    let request =
        json!({ "policy": imitated, "protocol": "paper", "objects": ["cube", "ball"], "trials": 1 });
    let divided =
        json!({ "kind": "evaluation", "request": request, "seed": 3, "resources": { "shards": 2 } });
    let divided = studio.post::<Job>("/jobs", &divided).expect("it waits").id;
    let compared = [divided, start(&studio, "evaluation", &request)].map(|id| {
        let mut report = done(&studio, &data, &id);
        report["seconds"] = Value::Null;
        report
    });
    assert_eq!(compared[0]["objects"]["cube"]["trials"], 1, "{}", compared[0]);
    assert_eq!(compared[0], compared[1], "divided it finds something else");
    let shipped = json!({ "policy": "searching", "protocol": "paper", "objects": ["cube"], "trials": 1 });
    done(&studio, &data, &start(&studio, "evaluation", &shipped));
    // All of that as one job, whose first policy serves as its own.
    let config = "[closings]\nobjects = \"cube\"\ncount = 12\nseed = 3\n\
        [trials]\nobjects = \"cube\"\ncount = 4\nprotocol = \"wide\"\nseed = 101\n\
        [[policies]]\nname = \"short\"\nupdates = 2\nseeds = [0]\n\
        [[evaluations]]\nprotocol = \"paper\"\nobjects = \"cube\"\ntrials = 1\n";
    let pipeline = start(&studio, "pipeline", &json!({ "config": config }));
    let report = done(&studio, &data, &pipeline);
    assert_eq!(report["evaluations"]["paper"]["short_0"]["seen"]["trials"], 1, "{report}");
    assert!(data.join(format!("runs/{pipeline}/report.html")).is_file());
    let request = json!({ "policy": pipeline, "protocol": "paper", "objects": ["cube"], "trials": 1 });
    done(&studio, &data, &start(&studio, "evaluation", &request));
    // The seed of the starts by which policies are judged is refused, and the job says so.
    let same = json!({ "kind": "gathering", "request": { "count": 1 }, "seed": 2 });
    let job: Job = studio.post("/jobs", &same).expect("it waits");
    let job = wait(&studio, &job.id, |job| !job.is_unfinished());
    assert!(
        job.state == JobState::Failed
            && job.problem.as_ref().is_some_and(|said| said.contains("the seed of")),
        "{job:?}"
    );

    // What the program refuses is the problem of its job, in its own words.
    let request = json!({ "object": "cube", "config": "num_envs = 1\nspeed = 2\n" });
    let job = wait(&studio, &start(&studio, "expert", &request), |job| !job.is_unfinished());
    assert!(
        job.state == JobState::Failed && job.problem.as_ref().is_some_and(|said| said.contains("speed")),
        "{job:?}"
    );
}

#[test]
fn a_command_with_events_ends_with_the_one_that_holds_its_input() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut command = palpate_train()
        .args(["--events", "ppo", "--total-steps", "100000000", "--out"])
        .arg(folder.path().join("run"))
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the command starts");
    let begun = Instant::now();
    while !folder.path().join("run").exists() {
        assert!(begun.elapsed() < PATIENCE, "it does not begin");
        assert_eq!(command.try_wait().expect("a process"), None, "its input is open");
        std::thread::sleep(Duration::from_millis(20));
    }
    drop(command.stdin.take());
    let begun = Instant::now();
    while command.try_wait().expect("a process").is_none() {
        if begun.elapsed() > PATIENCE {
            let _ = command.kill();
            panic!("it outlives the one that started it");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

use std::collections::BTreeMap;

use palpate_reports::ThetaReport;
use palpate_wire::api::{CampaignPlan, CampaignPolicy, JobSpec, Trial};
use serde_json::json;

use super::*;

fn job(id: &str, kind: &str, ended: &str, inputs: &[&str], request: Value) -> Job {
    let spec = json!({
        "kind": kind,
        "request": request,
        "inputs": inputs.iter().map(|path| ((*path).to_owned(), "00".to_owned())).collect::<BTreeMap<_, _>>(),
        "seed": 7,
        "software": "palpate 1",
    });
    Job {
        id: id.to_owned(),
        kind: kind.to_owned(),
        state: JobState::Done,
        created: ended.to_owned(),
        started: None,
        ended: Some(ended.to_owned()),
        attempts: 1,
        owner: "olga".to_owned(),
        runner: "process".to_owned(),
        fraction: 1.0,
        stage: String::new(),
        seconds_left: None,
        problem: None,
        cancel_requested: false,
        saved_as: None,
        spec: serde_json::from_value::<JobSpec>(spec).unwrap(),
    }
}

fn model(id: &str) -> ModelSummary {
    ModelSummary {
        id: id.to_owned(),
        name: format!("Model {id}"),
        theta: ThetaReport { lambda_con_m: 0.001, alpha_per_m: 100.0, lambda_pre_pa: 1000.0 },
        streams: Default::default(),
        provenance: Vec::new(),
        effects: Vec::new(),
        earlier_versions: 0,
    }
}

fn campaign(sources: &[&str]) -> Campaign {
    let policies = sources.iter().enumerate().map(|(idx, source)| CampaignPolicy {
        id: format!("p{idx}"),
        source: (*source).to_owned(),
        is_silenced: false,
    });
    let plan: CampaignPlan = serde_json::from_value(json!({
        "name": "night", "policies": policies.collect::<Vec<_>>(), "objects": [{"id": "cube"}, {"id": "ball"}],
        "starts": 1, "half_width_m": 0.02,
    }))
    .unwrap();
    let summary = json!({
        "id": "night", "name": "Night", "created": "2026-01-05T00:00:00Z", "planned": 4, "scored": 1, "to_score": 0,
        "paused": null, "closed": null, "error": null,
    });
    Campaign {
        summary: serde_json::from_value(summary).unwrap(),
        plan,
        trials: Vec::new(),
        next: None,
        next_to_score: None,
    }
}

/// A trial that became `take`.
fn trial(take: &str) -> Trial {
    let start = json!({ "x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0, "side": 0.0, "seed": 1 });
    let attempt = json!({
        "began": "2026-01-05T00:00:00Z", "by": "olga", "outcome": null, "take": take, "has_ended": true, "scores": [],
        "settled": null, "verdict": null,
    });
    let trial = json!({
        "number": 1, "policy": "p0", "object": "cube", "start_number": 1, "start": start, "state": "unscored",
        "attempts": [attempt],
    });
    serde_json::from_value(trial).unwrap()
}

fn keys(texts: &[&str]) -> Vec<ArtifactKey> {
    texts.iter().map(|text| ArtifactKey::parse(text).unwrap()).collect()
}

#[test]
fn takes_lead_to_a_model_a_policy_and_its_trials() {
    let request = json!({ "session": "demo" });
    let takes = ["sessions/demo/session.toml", "sessions/demo/take-01.mcap"];
    let mut calibrated = job("run-1", "calibrate", "2026-01-01T00:00:00Z", &takes, request.clone());
    calibrated.saved_as = Some("bench".to_owned());
    let unsaved = job("run-2", "calibrate", "2026-01-01T01:00:00Z", &takes, request.clone());
    let with_model = [takes[0], takes[1], "models/bench.toml"];
    let mut added = job("diagnosis-1", "diagnose", "2026-01-02T00:00:00Z", &with_model, request.clone());
    added.saved_as = Some("bench".to_owned());
    let gathered = job(
        "gathering-1",
        "gathering",
        "2026-01-03T00:00:00Z",
        &["models/bench.toml"],
        json!({ "count": 2 }),
    );
    let imitated = job(
        "imitation-1",
        "imitation",
        "2026-01-04T00:00:00Z",
        &["runs/gathering-1/trials/cube.safetensors", "runs/gathering-1/trials/ball.safetensors"],
        json!({ "trials": ["gathering-1"], "preset": "small", "config": "a = 1\nb = 2", "head": null }),
    );
    let done = [
        (imitated, ArtifactSort::Policy),
        (gathered, ArtifactSort::Demonstrations),
        (added, ArtifactSort::Model),
        (calibrated, ArtifactSort::Model),
        (unsaved, ArtifactSort::Model),
    ];
    let mut night =
        campaign(&["clone:data/runs/imitation-1/policy.safetensors", "{object}.safetensors", "script:close"]);
    night.trials = vec![trial("night-takes/take-01"), trial("deleted/take-01"), trial("night-takes/take-02")];
    let sessions = ["demo".to_owned(), "night-takes".to_owned()];
    let lineage = trace(&sessions, &[model("bench")], &done, &[night]);

    let of = |text: &str| lineage.get(&ArtifactKey::parse(text).unwrap()).unwrap();
    let bench = of("model:bench");
    assert_eq!((bench.name.as_str(), bench.made_from.clone()), ("Model bench", keys(&["session:demo"])));
    assert_eq!(bench.jobs, ["run-1", "diagnosis-1"], "a diagnosis that adds to a model is one of its makers");
    assert_eq!(of("demonstrations:gathering-1").made_from, keys(&["model:bench"]));
    let policy = of("policy:imitation-1");
    assert_eq!(policy.made_from, keys(&["demonstrations:gathering-1"]));
    let facts: Vec<_> = policy.facts.iter().map(|fact| (fact.name.as_str(), fact.value.as_str())).collect();
    let wanted = [
        ("preset", "small"),
        ("trials", "gathering-1"),
        ("seed", "7"),
        ("owner", "olga"),
        ("software", "palpate 1"),
    ];
    assert_eq!(facts, wanted, "what takes more than a line is not a fact");
    let trials = of("campaign:night");
    assert_eq!(trials.made_from, keys(&["script:close", "policy:ball", "policy:cube", "policy:imitation-1"]));
    assert!(of("policy:cube").is_shipped && !policy.is_shipped);
    assert_eq!(
        of("session:night-takes").made_from,
        keys(&["campaign:night"]),
        "its takes are those of trials"
    );
    assert!(lineage.get(&ArtifactKey::parse("session:deleted").unwrap()).is_none());
    let session = ArtifactKey::parse("session:demo").unwrap();
    let children: Vec<_> = lineage.made_of(&session).map(|artifact| artifact.key.to_string()).collect();
    assert_eq!(children, ["model:bench"]);
}

#[test]
fn a_shipped_policy_is_evaluated_and_what_was_deleted_is_still_named() {
    let evaluated =
        job("evaluation-1", "evaluation", "2026-01-01T00:00:00Z", &[], json!({ "policy": "cube" }));
    let trained =
        job("expert-1", "expert", "2026-01-02T00:00:00Z", &["models/gone.toml"], json!({ "object": "cube" }));
    let mut saved = job("run-1", "calibrate", "2026-01-01T00:00:00Z", &[], json!({ "session": "gone" }));
    saved.saved_as = Some("gone".to_owned());
    let done = [
        (evaluated, ArtifactSort::Evaluation),
        (trained, ArtifactSort::Policy),
        (saved, ArtifactSort::Model),
    ];
    let lineage = trace(&[], &[], &done, &[]);
    let of = |text: &str| lineage.get(&ArtifactKey::parse(text).unwrap());
    assert_eq!(of("evaluation:evaluation-1").unwrap().made_from, keys(&["policy:cube"]));
    assert_eq!(of("policy:expert-1").unwrap().made_from, keys(&["model:gone"]));
    assert_eq!(of("model:gone"), None);
    let own = lineage.artifacts.iter().filter(|artifact| artifact.key.sort == ArtifactSort::Policy);
    assert_eq!(
        own.map(|artifact| artifact.key.id.as_str()).next(),
        Some("expert-1"),
        "the newest comes first"
    );
}

#[test]
fn sources_that_nothing_is_known_of_lead_nowhere() {
    assert_eq!(tried("/home/olga/mine.safetensors", &["cube"]), []);
    assert_eq!(tried("", &["cube"]), []);
    assert_eq!(source("objects/cube.toml", &BTreeMap::new()), None);
    assert_eq!(source("runs/other-1/x", &BTreeMap::new()), None);
    assert_eq!(source("config.toml", &BTreeMap::new()), None);
}

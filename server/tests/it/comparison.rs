//! The trials of a campaign beside simulation as a job: what is read, what is refused, and what is counted. A shell script
//! stands in for `palpate-train`; `policy/train/tests/hand/campaigns.rs` has the real one.

use std::{fs, os::unix::fs::PermissionsExt as _, time::Duration};

use axum::Router;
use palpate_server::{Access, Studio, app};
use palpate_wire::api::{Campaign, ComparisonReport, Job, JobState, SaidBy, TrialVerdict};
use serde_json::{Value, json};

use crate::support::{Data, access, get, post};

/// Finds success everywhere with the first model and a slip with the others, and touch of its own.
const STAND_IN: &str = r#"#!/bin/sh
out= records= previous= models=
for word in "$@"; do
    case "$previous" in
    --out) out=$word ;;
    --rollout) records=$word ;;
    --model) models="$models $word" ;;
    esac
    previous=$word
done
[ -f assets/objects/cube.toml ] || { echo "palpate-train: no assets here" >&2; exit 1; }
echo "$@" >> ../asked.txt
ls "$records" >> ../records.txt
each() {
    separator=
    for file in "$records"/*; do
        number=$(basename "$file" | sed 's/trial-0*//; s/-.*//')
        grep -q gone "$file" && continue
        printf '%s{"trial":%s,"verdict":"%s","is_suggested":true}' "$separator" "$number" "$1"
        separator=,
    done
}
gone=$(grep -l gone "$records"/* | sed 's/.*trial-0*//; s/-.*//' | paste -sd,)
touch='{"f1":0.5,"gap":0.01,"onset_error_ms":null,"onset_coverage":1.0,"hand_contacts":4,"simulated_contacts":9,"channels":[]}'
verdict=success separator=
{
    printf '{"left_out":{"unknown_start":[],"no_outcome":[%s]},"starts_as_planned":[1],' "$gone"
    printf '"hand":{"successes":0,"each":[%s]},"models":[' "$(each success)"
    for model in $models; do
        printf '%s{"model":"%s","same_start":{"touch":%s,"each":[%s]}}' "$separator" "$model" "$touch" "$(each $verdict)"
        verdict=SL separator=,
    done
    printf ']}\n'
} > "$out"
echo '{"event":"progress","fraction":0.5,"stage":"trials"}'
"#;

async fn start(app: &Router, request: Value) -> Job {
    let answer = post(app, "/api/v1/jobs", &json!({ "kind": "comparison", "request": request })).await;
    assert_eq!(answer.status, 202, "{:?}", answer.body);
    let id = answer.json::<Job>().id;
    loop {
        let job: Job = get(app, &format!("/api/v1/jobs/{id}")).await.json();
        if !job.is_unfinished() {
            return job;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test]
async fn trials_of_a_campaign_are_compared_by_the_verdicts_that_count_and_from_its_own_records_alone() {
    let data = Data::empty();
    let train = data.path("palpate-train");
    fs::write(&train, STAND_IN).unwrap();
    fs::set_permissions(&train, fs::Permissions::from_mode(0o755)).unwrap();
    let studio = Studio::open(data.root(), None, Access { train: Some(train), ..access() }).unwrap();
    let app = app(studio.state.clone());

    let plan = json!({
        "name": "Night", "starts": 3, "half_width_m": 0.02, "objects": [{ "id": "cube" }],
        "policies": [{ "id": "feels", "source": "script:cube" }, { "id": "numb", "source": "script:cube", "is_silenced": true }],
    });
    let campaign: Campaign = post(&app, "/api/v1/campaigns", &plan).await.json();
    let refused = json!({ "kind": "comparison", "request": { "campaign": "night" } });
    let detail = post(&app, "/api/v1/jobs", &refused).await.problem(409);
    assert!(detail.contains("no trial has ended yet"), "{detail}");

    // Of every trial a record; of the first one, an earlier attempt that was void.
    let records = data.root().join("campaigns/night/rollout");
    fs::create_dir_all(&records).unwrap();
    let write = |number: u32, attempt: u32, poses: u64| {
        let outcome = json!({ "kind": "outcome", "outcome": { "recorded": { "object_poses": poses } } });
        let path = records.join(format!("trial-{number:04}-{attempt}.jsonl"));
        fs::write(path, format!("{{\"kind\":\"trial\"}}\n{outcome}\n")).unwrap();
    };
    let at = |number: u32, what: &str| format!("/api/v1/campaigns/night/trials/{number}/{what}");
    let score =
        |attempt: u32, verdict: &str| json!({ "scorer": "Ada", "attempt": attempt, "verdict": verdict });
    for trial in &campaign.trials {
        let number = trial.number;
        for attempt in 0..=u32::from(number == 1) {
            write(number, attempt, u64::from(attempt) * 50);
            assert_eq!(post(&app, &at(number, "begin"), &json!({})).await.status, 200, "{number}");
            let take = format!("night-takes/take-{number:02}");
            let outcome = json!({ "suggested": "success", "take": take, "record": "/etc/passwd" });
            let end = json!({ "attempt": attempt, "outcome": outcome });
            assert_eq!(post(&app, &at(number, "outcome"), &end).await.status, 200, "{number}");
            if number == 1 {
                let verdict = if attempt == 0 { "void" } else { "SL" };
                assert_eq!(post(&app, &at(number, "score"), &score(attempt, verdict)).await.status, 200);
            }
        }
    }
    let feels: Vec<u32> = campaign
        .trials
        .iter()
        .filter(|trial| trial.policy.as_deref() == Some("feels"))
        .map(|trial| trial.number)
        .collect();
    let last = *feels.last().unwrap();
    fs::write(records.join(format!("trial-{last:04}-0.jsonl")), "gone\n").unwrap();

    fs::create_dir_all(data.root().join("models")).unwrap();
    fs::copy("../assets/models/demo_diagnosed.toml", data.root().join("models/fit.toml")).unwrap();
    let job = start(&app, json!({ "campaign": "night", "models": ["nominal", "fit", "nominal"] })).await;
    assert_eq!((job.state, &job.problem), (JobState::Done, &None));
    let report: ComparisonReport =
        get(&app, &format!("/api/v1/jobs/{}/files/report.json", job.id)).await.json();

    let ids: Vec<&str> = report.models.iter().map(|model| model.id.as_str()).collect();
    assert_eq!(ids, ["nominal", "fit"]);
    let compared: Vec<u32> = report.trials.iter().map(|trial| trial.trial).collect();
    assert_eq!(compared, feels[..feels.len() - 1], "only those that feel, but for one without an end");
    for trial in &report.trials {
        let is_scored = trial.trial == 1;
        let hand = if is_scored { TrialVerdict::Slip } else { TrialVerdict::Success };
        let said_by = if is_scored { SaidBy::Scorers } else { SaidBy::Robot };
        assert_eq!((trial.hand, trial.said_by), (hand, said_by), "{trial:?}");
        assert_eq!(trial.simulated, [TrialVerdict::Success, TrialVerdict::Slip]);
        assert_eq!((trial.is_followed, trial.is_start_planned), (is_scored, is_scored), "{trial:?}");
        assert_eq!(trial.take, Some(format!("night-takes/take-{:02}", trial.trial)));
    }
    let why = |number: u32| {
        report.left_out.iter().find(|trial| trial.trial == number).map(|trial| trial.why.as_str()).unwrap()
    };
    assert!(why(last).contains("ends before the trial does"), "{:?}", report.left_out);
    let numb = campaign.trials.iter().find(|trial| trial.policy.as_deref() == Some("numb")).unwrap();
    assert!(why(numb.number).contains("feels nothing"), "{:?}", report.left_out);
    let [nominal, fit] = &report.pairings[..] else { panic!("{:?}", report.pairings) };
    assert_eq!((nominal.simulated.successes, fit.simulated.successes), (nominal.hand.trials, 0));
    assert_eq!(nominal.touch.as_ref().unwrap().simulated_contacts, 9);

    // What the program saw: the last attempt of each, from the campaign's folder, and nothing that somebody told.
    let folder = data.root().join("runs").join(&job.id);
    let seen = fs::read_to_string(folder.join("records.txt")).unwrap();
    let expected: Vec<String> =
        feels.iter().map(|number| format!("trial-{number:04}-{}.jsonl", u32::from(*number == 1))).collect();
    assert_eq!(seen.lines().collect::<Vec<_>>(), expected);
    let asked = fs::read_to_string(folder.join("asked.txt")).unwrap();
    assert!(asked.contains("--model nominal --model ") && asked.contains("models/fit.toml"), "{asked}");
    assert!(!folder.join("work").exists(), "the links are gone");

    // A blind campaign says nothing before it is closed.
    let mut blind = plan.clone();
    (blind["name"], blind["is_blind"]) = (json!("Dark"), json!(true));
    assert_eq!(post(&app, "/api/v1/campaigns", &blind).await.status, 201);
    let refused = json!({ "kind": "comparison", "request": { "campaign": "dark" } });
    let detail = post(&app, "/api/v1/jobs", &refused).await.problem(409);
    assert!(detail.contains("is blind"), "{detail}");
    let gone = json!({ "kind": "comparison", "request": { "campaign": "night", "models": ["lost"] } });
    assert!(post(&app, "/api/v1/jobs", &gone).await.problem(404).contains("lost"));
}

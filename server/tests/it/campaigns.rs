//! Campaigns over HTTP and on the command line: made, run, scored, exported, found again.

use axum::http::header;
use palpate_wire::{
    api::{Campaign, CampaignResults, CampaignSummary, TrialVerdict},
    proto::{StreamMessage, stream_message::Message},
};
use serde_json::{Value, json};

use crate::support::{Data, arg, get, palpate_ok, palpate_refuses, post};

fn plan() -> Value {
    json!({
        "name": "First Trials",
        "policies": [
            { "id": "close", "source": "script:close" },
            { "id": "silenced", "source": "script:close", "is_silenced": true },
        ],
        "objects": [{ "id": "cube", "group": "seen" }, { "id": "ring", "group": "unseen" }],
        "starts": 2,
        "half_width_m": 0.02,
        "seed": 3,
    })
}

/// Runs trial `number` as a rollout and an operator would.
async fn make(app: &axum::Router, number: u32, verdict: TrialVerdict) -> Campaign {
    let trial = format!("/api/v1/campaigns/first-trials/trials/{number}");
    let begun = post(app, &format!("{trial}/begin"), &json!({})).await;
    assert_eq!(begun.status, 200, "{:?}", begun.body);
    let outcome = json!({ "attempt": 0, "outcome": { "suggested": verdict, "reasons": ["felt 5 taxels"] } });
    assert_eq!(post(app, &format!("{trial}/outcome"), &outcome).await.status, 200);
    let score = json!({ "attempt": 0, "verdict": verdict, "scorer": "Olga" });
    let scored = post(app, &format!("{trial}/score"), &score).await;
    assert_eq!(scored.status, 200, "{:?}", scored.body);
    scored.json()
}

#[tokio::test]
async fn campaign_is_made_run_scored_and_exported() {
    let data = Data::empty();
    let app = data.app();
    let answer = post(&app, "/api/v1/campaigns", &plan()).await;
    assert_eq!(answer.status, 201, "{:?}", answer.body);
    assert_eq!(answer.header(header::LOCATION), "/api/v1/campaigns/first-trials");
    let made: Campaign = answer.json();
    assert_eq!((made.summary.planned, made.next, made.trials.len()), (8, Some(1), 8));

    let mut last = made;
    for number in 1..=8 {
        let silenced = last.trials[number as usize - 1].policy.as_deref() == Some("silenced");
        last = make(&app, number, if silenced { TrialVerdict::Slip } else { TrialVerdict::Success }).await;
    }
    assert_eq!((last.next, last.summary.scored), (None, 8));
    let results: CampaignResults = get(&app, "/api/v1/campaigns/first-trials/results").await.json();
    assert_eq!((results.policies[0].overall.successes, results.policies[1].failures.slip), (4, 4));
    assert_eq!(results.comparisons[0].only_a, 4);
    assert!(!results.published.is_empty(), "the paper's figures stand beside");

    // The same by every way out.
    let csv = get(&app, "/api/v1/campaigns/first-trials/tables/results.csv").await;
    assert!(csv.header(header::CONTENT_TYPE).starts_with("text/csv"), "{:?}", csv.body);
    let text = String::from_utf8(csv.body.to_vec()).unwrap();
    assert!(text.contains("close,cube,seen,2,2,1,"), "{text}");
    let trials = get(&app, "/api/v1/campaigns/first-trials/tables/trials.csv").await;
    assert!(trials.header(header::CONTENT_TYPE).starts_with("text/csv"), "{:?}", trials.body);
    let rows = String::from_utf8(trials.body.to_vec()).unwrap();
    assert_eq!(rows.lines().count(), 1 + 8, "{rows}");
    let out = data.path("results.csv");
    let printed = palpate_ok(&[
        "campaign",
        "results",
        "first-trials",
        "--data",
        arg(data.root()),
        "--json",
        "--out",
        arg(&out),
    ]);
    assert_eq!(serde_json::from_str::<CampaignResults>(&printed).unwrap(), results);
    assert_eq!(std::fs::read_to_string(out).unwrap(), text);
    let listed = palpate_ok(&["campaign", "list", "--data", arg(data.root()), "--json"]);
    assert_eq!(serde_json::from_str::<Vec<CampaignSummary>>(&listed).unwrap(), vec![last.summary]);
}

#[tokio::test]
async fn paused_campaign_is_listed_as_such_and_begins_nothing() {
    let data = Data::empty();
    let app = data.app();
    assert_eq!(post(&app, "/api/v1/campaigns", &plan()).await.status, 201);
    let paused = post(&app, "/api/v1/campaigns/first-trials/pause", &json!({})).await;
    let paused: Campaign = paused.json();
    assert!(paused.summary.paused.is_some());
    let begin = "/api/v1/campaigns/first-trials/trials/1/begin";
    let refused = post(&app, begin, &json!({})).await;
    assert!(refused.problem(409).contains("paused"), "{:?}", refused.body);
    let listed = palpate_ok(&["campaign", "list", "--data", arg(data.root())]);
    assert!(listed.contains("paused 20"), "{listed}");
    assert_eq!(post(&app, "/api/v1/campaigns/first-trials/resume", &json!({})).await.status, 200);
    assert_eq!(post(&app, begin, &json!({})).await.status, 200);
}

#[tokio::test]
async fn blind_scorer_sees_neither_policy_nor_suggestion() {
    let data = Data::empty();
    let app = data.app();
    let mut blind = plan();
    blind["is_blind"] = json!(true);
    assert_eq!(post(&app, "/api/v1/campaigns", &blind).await.status, 201);
    let trial = "/api/v1/campaigns/first-trials/trials/1";
    post(&app, &format!("{trial}/begin"), &json!({})).await;
    let outcome = json!({ "attempt": 0, "outcome": { "suggested": "SL", "reasons": ["felt 5 taxels"] } });
    post(&app, &format!("{trial}/outcome"), &outcome).await;

    let seen = get(&app, "/api/v1/campaigns/first-trials?as_scorer=true&scorer=Ada").await;
    let campaign: Campaign = seen.json();
    assert_eq!((campaign.next_to_score, campaign.trials[0].policy.clone()), (Some(1), None));
    assert!(!String::from_utf8(seen.body.to_vec()).unwrap().contains("felt 5 taxels"));
    let refused = get(&app, "/api/v1/campaigns/first-trials/results?as_scorer=true").await;
    assert_eq!(refused.status, 409, "{:?}", refused.body);
    let told: Campaign = get(&app, "/api/v1/campaigns/first-trials").await.json();
    assert!(told.trials[0].policy.is_some());
}

#[tokio::test]
async fn requests_that_make_no_sense_are_refused_by_name() {
    let data = Data::empty();
    let app = data.app();
    assert_eq!(get(&app, "/api/v1/campaigns/none").await.status, 404);
    let mut wrong = plan();
    wrong["starts"] = json!(0);
    let refused = post(&app, "/api/v1/campaigns", &wrong).await;
    assert!(refused.problem(400).contains("starts"), "{:?}", refused.body);
    post(&app, "/api/v1/campaigns", &plan()).await;
    assert_eq!(post(&app, "/api/v1/campaigns", &plan()).await.status, 409);
    assert_eq!(post(&app, "/api/v1/campaigns/first-trials/trials/9/begin", &json!({})).await.status, 404);
    assert_eq!(get(&app, "/api/v1/campaigns/first-trials/tables/results.pdf").await.status, 404);
    let score = json!({ "attempt": 0, "verdict": "success" });
    assert_eq!(post(&app, "/api/v1/campaigns/first-trials/trials/1/score", &score).await.status, 409);
    let refusal = palpate_refuses(&["campaign", "results", "none", "--data", arg(data.root())]);
    assert!(refusal.contains("no campaign"), "{refusal}");
}

#[test]
fn every_change_is_told_on_the_stream() {
    let message = Message::Changed(palpate_wire::proto::Changed { list: "campaigns".into(), id: "a".into() });
    let message = StreamMessage { message: Some(message), dropped: 0 };
    let bytes = prost::Message::encode_to_vec(&message);
    // Scripts know the field by its number.
    assert_eq!(bytes[0], 3 << 3 | 2);
}

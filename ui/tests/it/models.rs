//! Models and policies: the list, what each was made from, what was made of it.

use egui::accesskit::Role;
use egui_kittest::kittest::{NodeT as _, Queryable as _};
use palpate_ui::api_client::{ApiEvent, Request};
use palpate_wire::proto::{JobUpdate, StreamMessage, stream_message};
use prost::Message as _;
use serde_json::json;

use crate::fixture::{FakeWindow, SharedApi, deliver, full_api, page};

fn with_lineage(lineage: &serde_json::Value) -> SharedApi {
    let api = full_api();
    api.0.borrow_mut().answer(&Request::Lineage, lineage.to_string().into_bytes());
    api
}

pub(crate) fn from_takes_to_trials() -> SharedApi {
    with_lineage(&json!({ "artifacts": [
        { "sort": "session", "id": "bench-1", "name": "bench-1" },
        { "sort": "model", "id": "bench-fit", "name": "Bench fit", "made": "2026-01-01T10:00:00Z", "jobs": ["run-1"],
          "made_from": [{ "sort": "session", "id": "bench-1" }] },
        { "sort": "demonstrations", "id": "gathering-1", "name": "gathering-1", "made": "2026-01-02T10:00:00Z",
          "jobs": ["gathering-1"], "made_from": [{ "sort": "model", "id": "bench-fit" }] },
        { "sort": "policy", "id": "imitation-1", "name": "imitation-1", "made": "2026-01-03T10:00:00Z",
          "jobs": ["imitation-1"], "made_from": [{ "sort": "demonstrations", "id": "gathering-1" },
          { "sort": "script", "id": "close" }], "facts": [{ "name": "preset", "value": "small" }] },
        { "sort": "policy", "id": "cube", "name": "cube", "is_shipped": true },
        { "sort": "campaign", "id": "night", "name": "Night", "made": "2026-01-04T10:00:00Z",
          "made_from": [{ "sort": "policy", "id": "imitation-1" }] },
    ] }))
}

#[test]
fn lineage_is_clicked_through_from_trials_back_to_takes() {
    let window = FakeWindow::at("#/models?artifact=policy%3Aimitation-1");
    let mut harness = page(&from_takes_to_trials(), &window);
    harness.get_by_label("small");
    // Origins to the first, uses to the last; a script that is shipped is in no list.
    harness.get_by_role_and_label(Role::Button, "Session bench-1");
    assert!(harness.get_by_role_and_label(Role::Button, "Script close").accesskit_node().is_disabled());
    harness.get_by_role_and_label(Role::Button, "Campaign Night").click();
    harness.run_steps(3);
    assert_eq!(window.current(), "#/trials?campaign=night");
    window.back();
    harness.run_steps(3);
    harness.get_all_by_role_and_label(Role::Button, "Model Bench fit").last().expect("in the tree").click();
    harness.run_steps(3);
    assert_eq!(window.current(), "#/models?artifact=model:bench-fit");
    harness.get_by_role_and_label(Role::Link, "Model file");
    harness.get_by_role_and_label(Role::Button, "Job run-1").click();
    harness.run_steps(3);
    assert!(window.current().starts_with("#/jobs?"), "{}", window.current());
}

#[test]
fn first_artifact_is_shown_where_none_is_asked_for_and_one_that_is_gone_is_said_to_be() {
    let harness = page(&from_takes_to_trials(), &FakeWindow::at("#/models"));
    harness.get_by_role_and_label(Role::Button, "Job run-1");
    let harness = page(&from_takes_to_trials(), &FakeWindow::at("#/models?artifact=model:gone"));
    harness.get_by_label_contains("There is no Model gone");
    let harness = page(&with_lineage(&json!({ "artifacts": [] })), &FakeWindow::at("#/models"));
    harness.get_by_label_contains("No model and no policy yet");
    let harness = page(&full_api(), &FakeWindow::at("#/models"));
    harness.get_by_label_contains("The list of models did not arrive");
}

#[test]
fn what_goes_round_in_a_circle_ends() {
    let api = with_lineage(&json!({ "artifacts": [
        { "sort": "model", "id": "a", "name": "a", "made_from": [{ "sort": "model", "id": "b" }] },
        { "sort": "model", "id": "b", "name": "b", "made_from": [{ "sort": "model", "id": "a" }] },
    ] }));
    let harness = page(&api, &FakeWindow::at("#/models?artifact=model:a"));
    // In the list, and once in what it was made from and in what was made of it.
    assert_eq!(harness.get_all_by_role_and_label(Role::Button, "Model b").count(), 3);
}

#[test]
fn a_job_that_is_done_brings_the_lineage_anew() {
    let api = from_takes_to_trials();
    let mut harness = page(&api, &FakeWindow::at("#/models"));
    api.0.borrow_mut().sent.clear();
    let update = JobUpdate { job: "expert-1".into(), state: "done".into(), ..Default::default() };
    let message = StreamMessage { message: Some(stream_message::Message::Job(update)), dropped: 0 };
    deliver(&api, [ApiEvent::SocketMessage(message.encode_to_vec())]);
    harness.run_steps(4);
    assert!(api.0.borrow().sent.contains(&Request::Lineage));
}

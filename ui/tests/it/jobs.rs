//! Jobs of every kind on the page.

use egui::accesskit::Role;
use egui_kittest::kittest::Queryable as _;
use palpate_ui::api_client::{ApiEvent, JobAct, Request};
use palpate_wire::{
    api::{Job, JobPage, JobSpec, JobState},
    proto::{JobUpdate, StreamMessage, stream_message},
};
use prost::Message as _;

use crate::fixture::{FakeWindow, SharedApi, full_api, page};

fn job(id: &str, kind: &str, state: JobState) -> Job {
    Job {
        id: id.into(),
        kind: kind.into(),
        state,
        created: "2026-11-25T09:00:00Z".into(),
        started: None,
        ended: None,
        attempts: 1,
        owner: "Olga".into(),
        runner: "process".into(),
        fraction: 0.25,
        stage: "takes 1 of 4".into(),
        seconds_left: Some(90.0),
        problem: (state == JobState::Failed).then(|| "the disk is full".into()),
        cancel_requested: false,
        saved_as: None,
        spec: JobSpec {
            kind: kind.into(),
            request: serde_json::json!({ "session": "bench-1" }),
            inputs: [].into(),
            seed: 7,
            software: "palpate 0.1.0".into(),
            priority: 0,
            resources: Default::default(),
        },
    }
}

fn with(jobs: Vec<Job>) -> SharedApi {
    let api = full_api();
    let body = serde_json::to_vec(&JobPage { jobs, next_cursor: None }).expect("it is plain data");
    api.0.borrow_mut().answer(&Request::Jobs(None), body);
    api
}

#[test]
fn a_failed_job_says_why_and_can_be_tried_again() {
    let api =
        with(vec![job("blind-2", "blind", JobState::Failed), job("run-1", "calibrate", JobState::Done)]);
    let window = FakeWindow::at("#/jobs");
    let mut harness = page(&api, &window);
    harness.run_steps(3);
    harness.get_by_label_contains("the disk is full");
    harness.get_by_role_and_label(Role::Button, "Try again").click();
    harness.run_steps(2);
    assert!(
        api.0.borrow().sent.contains(&Request::ActOnJob { job: "blind-2".into(), act: JobAct::Retry }),
        "{:?}",
        api.0.borrow().sent
    );
    harness.get_by_role_and_label(Role::Button, "Job run-1: calibrate done").click();
    harness.run_steps(3);
    assert_eq!(window.current(), "#/jobs?job=run-1");
    harness.get_by_role_and_label(Role::Button, "Open the result").click();
    harness.run_steps(3);
    assert!(window.current().starts_with("#/calibrate/bench-1?") && window.current().contains("run=run-1"));
}

#[test]
fn progress_comes_by_itself() {
    let api = with(vec![job("blind-2", "blind", JobState::Running)]);
    let mut harness = page(&api, &FakeWindow::at("#/jobs"));
    harness.run_steps(3);
    harness.get_by_label_contains("takes 1 of 4");
    let update = JobUpdate {
        job: "blind-2".into(),
        state: "running".into(),
        fraction: 0.75,
        stage: "takes 3 of 4".into(),
        ..JobUpdate::default()
    };
    let message = StreamMessage { message: Some(stream_message::Message::Job(update)), dropped: 0 };
    api.0.borrow_mut().events.push_back(ApiEvent::SocketMessage(message.encode_to_vec()));
    harness.run_steps(3);
    harness.get_by_label_contains("takes 3 of 4");
    harness.get_by_role_and_label(Role::Button, "Job blind-2: blind 75 %");
}

#[test]
fn deleting_asks_once() {
    let api = with(vec![job("run-1", "calibrate", JobState::Done)]);
    let mut harness = page(&api, &FakeWindow::at("#/jobs"));
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::Button, "Delete").click();
    harness.run_steps(3);
    let deleted = Request::ActOnJob { job: "run-1".into(), act: JobAct::Delete };
    assert!(!api.0.borrow().sent.contains(&deleted));
    harness.get_by_role_and_label(Role::Button, "Yes, to the trash").click();
    harness.run_steps(3);
    assert!(api.0.borrow().sent.contains(&deleted));
}

#[test]
fn no_job_yet_says_what_a_job_is() {
    let api = with(Vec::new());
    let mut harness = page(&api, &FakeWindow::at("#/jobs"));
    harness.run_steps(3);
    harness.get_by_label_contains("A job is long work in a process of its own");
}

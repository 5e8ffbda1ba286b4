//! Jobs of every kind on the page.

use egui::accesskit::Role;
use egui_kittest::{Harness, kittest::Queryable as _};
use palpate_ui::{
    StudioApp,
    api_client::{ApiEvent, JobAct, Request},
};
use palpate_wire::{
    api::{Job, JobKindDocument, JobPage, JobRequest, JobSpec, JobState, Resources, Role as May, Via},
    proto::{JobUpdate, StreamMessage, stream_message},
};
use prost::Message as _;

use crate::{
    fixture::{FakeWindow, SharedApi, full_api, page, page_of},
    home::me,
};

pub(crate) fn job(id: &str, kind: &str, state: JobState) -> Job {
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

pub(crate) fn with(jobs: Vec<Job>) -> SharedApi {
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
fn jobs_at_work_are_in_a_drawer_of_every_screen() {
    let api =
        with(vec![job("run-1", "calibrate", JobState::Running), job("blind-2", "blind", JobState::Done)]);
    let window = FakeWindow::at("#/sessions/bench-1");
    let mut harness = page(&api, &window);
    harness.run_steps(3);
    let button = "Jobs at work: \u{25b6} 1 at work, 25 %";
    harness.get_by_role_and_label(Role::Button, button).click();
    harness.run_steps(3);
    harness.get_by_label_contains("takes 1 of 4");
    assert!(harness.query_by_label("Show job blind-2").is_none(), "it had ended before the page was opened");
    let (cancel, stop) = (harness.get_by_label("Cancel job run-1"), harness.get_by_label("STOP (software)"));
    assert!(cancel.rect().right() < stop.rect().left(), "STOP would be pressed instead");
    harness.get_by_role_and_label(Role::Button, "Cancel job run-1").click();
    harness.run_steps(3);
    let cancelled = Request::ActOnJob { job: "run-1".into(), act: JobAct::Cancel };
    assert!(api.0.borrow().sent.contains(&cancelled));

    // It ends: the drawer says so until somebody has looked.
    let done = job("run-1", "calibrate", JobState::Done);
    let body = serde_json::to_vec(&done).expect("it is plain data");
    api.0.borrow_mut().answer(&Request::Job("run-1".into()), body);
    let update = JobUpdate { job: "run-1".into(), state: "done".into(), ..JobUpdate::default() };
    let message = StreamMessage { message: Some(stream_message::Message::Job(update)), dropped: 0 };
    api.0.borrow_mut().events.push_back(ApiEvent::SocketMessage(message.encode_to_vec()));
    harness.run_steps(5);
    harness.get_by_role_and_label(Role::Button, "Open the result of job run-1").click();
    harness.run_steps(5);
    assert!(window.current().starts_with("#/calibrate/bench-1?") && window.current().contains("run=run-1"));
    assert!(harness.query_by_label_contains("Jobs at work").is_none(), "it has been looked at");
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

pub(crate) fn kinds(api: &SharedApi, problem: Option<&str>) {
    let trainings = [
        "expert",
        "evaluation",
        "demonstrations",
        "pretraining",
        "gathering",
        "imitation",
        "pipeline",
        "tune",
    ];
    let kinds = trainings.map(|kind| JobKindDocument {
        kind: kind.into(),
        resources: Default::default(),
        is_available: problem.is_none(),
        problem: problem.map(str::to_owned),
    });
    let body = serde_json::to_vec(&kinds).expect("it is plain data");
    api.0.borrow_mut().answer(&Request::Kinds, body);
}

#[test]
fn a_training_is_started_from_the_form_and_then_shown() {
    let api = with(Vec::new());
    kinds(&api, None);
    let window = FakeWindow::at("#/jobs");
    let mut harness = page(&api, &window);
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::Button, "Start a job").click();
    harness.run_steps(3);
    assert_eq!(window.current(), "#/jobs?job=new");
    let asked = Request::SubmitJob(JobRequest {
        kind: "expert".into(),
        request: serde_json::json!({ "object": "cube", "preset": "quick" }),
        seed: 1,
        priority: 0,
        resources: None,
        runner: None,
    });
    let answer = serde_json::to_vec(&job("expert-1", "expert", JobState::Queued)).expect("it is plain data");
    api.0.borrow_mut().answer(&asked, answer);
    harness.get_by_role_and_label(Role::Button, "Start").click();
    harness.run_steps(4);
    assert!(api.0.borrow().sent.contains(&asked), "{:?}", api.0.borrow().sent);
    assert_eq!(window.current(), "#/jobs?job=expert-1");
    harness.get_by_label_contains("It waits for its turn");
}

#[test]
fn a_viewer_is_told_why_nothing_starts_or_ends() {
    let api = with(vec![job("expert-1", "expert", JobState::Running)]);
    kinds(&api, None);
    api.0
        .borrow_mut()
        .answer(&Request::Me, serde_json::to_vec(&me(May::Viewer, Via::Session)).expect("it is plain data"));
    for hash in ["#/jobs?job=new", "#/jobs?job=expert-1"] {
        let mut harness = page(&api, &FakeWindow::at(hash));
        harness.run_steps(4);
        harness.get_by_label_contains("You are ada (viewer): you can watch. Operators start and end jobs.");
        assert!(harness.query_by_role_and_label(Role::Button, "Cancel").is_none());
        if let Some(start) = harness.query_by_role_and_label(Role::Button, "Start") {
            start.click();
            harness.run_steps(3);
        }
    }
    let asks = |request: &Request| matches!(request, Request::SubmitJob(_) | Request::ActOnJob { .. });
    assert!(!api.0.borrow().sent.iter().any(asks));
}

/// Chooses `choice` in the list called `list`.
pub(crate) fn choose(harness: &mut Harness<'_, Option<StudioApp>>, list: &str, choice: &str) {
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::ComboBox, list).click();
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::ListBoxOption, choice).click();
    harness.run_steps(3);
}

#[test]
fn an_imitation_learns_from_the_gathering_that_is_pressed() {
    let api = with(vec![
        job("gathering-2", "gathering", JobState::Done),
        job("gathering-1", "gathering", JobState::Failed),
        job("expert-1", "expert", JobState::Done),
    ]);
    kinds(&api, None);
    // All of the form is in sight.
    let mut harness = page_of(&api, &FakeWindow::at("#/jobs?job=new"), [1280.0, 1400.0]);
    choose(&mut harness, "What to start", "Imitate an expert");
    harness.get_by_label_contains("which gathered trials? Give jobs such as gathering-1");
    assert!(harness.query_by_role_and_label(Role::Button, "gathering-1").is_none(), "it has failed");
    harness.get_by_role_and_label(Role::Button, "gathering-2").click();
    harness.get_by_role_and_label(Role::CheckBox, "trials that were won only").click();
    // What does not go together is said by field, and nothing starts.
    choose(&mut harness, "Policy of the paper", "kinematic-dp");
    choose(&mut harness, "What predicts", "act");
    harness.get_by_label_contains("What predicts: the policy \"kinematic-dp\" says this itself");
    assert!(harness.query_by_role_and_label(Role::Button, "Start").is_none());
    choose(&mut harness, "Policy of the paper", "none");
    harness.get_by_label_contains("Transformers that predict the commonest answer");
    harness.get_by_role_and_label(Role::Button, "Start").click();
    harness.run_steps(3);
    let asked = Request::SubmitJob(JobRequest {
        kind: "imitation".into(),
        request: serde_json::json!({
            "trials": ["gathering-2"], "preset": "small", "head": "act", "only_won": true,
        }),
        seed: 1,
        priority: 0,
        resources: None,
        runner: None,
    });
    assert!(api.0.borrow().sent.contains(&asked), "{:?}", api.0.borrow().sent);
}

#[test]
fn a_studio_without_the_program_says_so_in_the_form() {
    let api = with(vec![job("expert-1", "expert", JobState::Done)]);
    kinds(&api, Some("palpate-train is not installed beside palpate; build it"));
    let mut harness = page(&api, &FakeWindow::at("#/jobs?job=new"));
    harness.run_steps(3);
    harness.get_by_label_contains("Not available here: palpate-train is not installed");
    harness.get_by_role_and_label(Role::Button, "Start").click();
    harness.run_steps(3);
    let sent = api.0.borrow().sent.iter().any(|request| matches!(request, Request::SubmitJob(_)));
    assert!(!sent, "a button that is off does nothing");
}

#[test]
fn curves_are_drawn_and_asked_for_again_when_the_job_has_ended() {
    let running = job("expert-1", "expert", JobState::Running);
    let api = with(vec![running.clone()]);
    let metrics = Request::JobMetrics("expert-1".into());
    let points =
        "{\"step\":1,\"success_rate\":0.25,\"kl\":0.01}\n{\"step\":2,\"success_rate\":0.5,\"kl\":0.02}\n";
    api.0.borrow_mut().answer(&metrics, points.into());
    let mut harness = page(&api, &FakeWindow::at("#/jobs?job=expert-1"));
    harness.run_steps(4);
    harness.get_by_role_and_label(Role::Image, "Curve success_rate: 0.500 at step 2");
    harness.get_by_role_and_label(Role::Image, "Curve kl: 0.020 at step 2");
    let more = format!("{points}{{\"step\":3,\"success_rate\":0.75}}\n");
    api.0.borrow_mut().answer(&metrics, more.into());
    let done = Job { state: JobState::Done, ..running };
    let body = serde_json::to_vec(&done).expect("it is plain data");
    api.0.borrow_mut().answer(&Request::Job("expert-1".into()), body);
    let update = JobUpdate { job: "expert-1".into(), state: "done".into(), ..JobUpdate::default() };
    let message = StreamMessage { message: Some(stream_message::Message::Job(update)), dropped: 0 };
    api.0.borrow_mut().events.push_back(ApiEvent::SocketMessage(message.encode_to_vec()));
    harness.run_steps(5);
    harness.get_by_role_and_label(Role::Image, "Curve success_rate: 0.750 at step 3");
}

fn starts(api: &SharedApi, kind: &str) -> Harness<'static, Option<StudioApp>> {
    kinds(api, None);
    let mut harness = page(api, &FakeWindow::at("#/jobs?job=new"));
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::ComboBox, "What to start").click();
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::ListBoxOption, kind).click();
    harness.run_steps(3);
    harness
}

fn submitted(api: &SharedApi) -> JobRequest {
    let api = api.0.borrow();
    let found = api.sent.iter().find_map(|request| match request {
        Request::SubmitJob(job) => Some(job.clone()),
        _ => None,
    });
    found.expect("a job was asked for")
}

#[test]
fn a_gathering_is_divided_into_parts() {
    let api = with(Vec::new());
    let mut harness = starts(&api, "Gather an expert's trials");
    assert!(harness.query_by_label("Parts").is_none(), "it is folded");
    harness.get_by_label("Advanced").click();
    harness.run_steps(20);
    harness.get_by_label_contains("The result is the same.");
    assert!(harness.query_by_label("Cores of each").is_none());
    harness.get_by_role_and_label(Role::SpinButton, "Parts").focus();
    harness.run_steps(3);
    harness.event(egui::Event::Text("3".into()));
    harness.run_steps(2);
    harness.key_press(egui::Key::Enter);
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::SpinButton, "Cores of each");
    harness.get_by_role_and_label(Role::Button, "Start").click();
    harness.run_steps(3);
    let expected = Resources { shards: 3, cores: 1, ..Resources::default() };
    assert_eq!(submitted(&api).resources, Some(expected));
}

#[test]
fn a_pipeline_learns_on_the_graphics_card_and_has_no_seed() {
    let api = with(Vec::new());
    let mut harness = starts(&api, "Do it all, from model to scored policies");
    assert!(harness.query_by_label("Seed").is_none(), "its seeds are in its configuration");
    harness.get_by_label("Advanced").click();
    harness.run_steps(20);
    assert!(harness.query_by_label("Parts").is_none());
    harness.get_by_role_and_label(Role::CheckBox, "Learn on the graphics card").click();
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::Button, "Start").click();
    harness.run_steps(3);
    assert_eq!(submitted(&api).resources, Some(Resources { gpu: true, ..Resources::default() }));
}

#[test]
fn an_expert_has_a_seed_and_nothing_advanced() {
    let harness = starts(&with(Vec::new()), "Train an expert");
    harness.get_by_role_and_label(Role::SpinButton, "Seed");
    assert!(harness.query_by_label("Advanced").is_none());
}

#[test]
fn a_divided_job_says_how_and_how_far_its_parts_are() {
    let mut divided = job("gathering-1", "gathering", JobState::Running);
    divided.spec.resources = Resources { shards: 8, cores: 2, at_once: 4, ..Resources::default() };
    divided.stage = "3 of 8 shards done, 4 at work, 1 waiting".into();
    let mut harness = page(&with(vec![divided]), &FakeWindow::at("#/jobs?job=gathering-1"));
    harness.run_steps(3);
    harness.get_by_label("8 parts, 2 cores each, 4 at once at most");
    harness.get_by_label_contains("3 of 8 shards done");
}

#[test]
fn a_job_that_waits_names_what_works() {
    let jobs =
        vec![job("expert-2", "expert", JobState::Queued), job("expert-1", "expert", JobState::Running)];
    let mut harness = page(&with(jobs), &FakeWindow::at("#/jobs?job=expert-2"));
    harness.run_steps(3);
    harness.get_by_label("It waits for its turn: expert-1 works.");
}

#[test]
fn a_job_that_is_done_links_to_its_files() {
    let api =
        with(vec![job("expert-2", "expert", JobState::Running), job("expert-1", "expert", JobState::Done)]);
    let mut harness = page(&api, &FakeWindow::at("#/jobs?job=expert-1"));
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::Link, "report.json");
    harness.get_by_role_and_label(Role::Link, "policy.safetensors").click();
    harness.step();
    let opened = harness.output().platform_output.commands.iter().find_map(|command| match command {
        egui::OutputCommand::OpenUrl(url) => Some((url.url.clone(), url.new_tab)),
        _ => None,
    });
    assert_eq!(opened, Some(("/api/v1/jobs/expert-1/files/policy.safetensors".to_owned(), true)));
    let mut harness = page(&api, &FakeWindow::at("#/jobs?job=expert-2"));
    harness.run_steps(3);
    assert!(harness.query_by_label("report.json").is_none());
}

//! Campaigns on the page: planned, run, scored from the keyboard, counted.

use egui::{Key, accesskit::Role};
use egui_kittest::kittest::Queryable as _;
use palpate_ui::api_client::{ApiEvent, CampaignAct, JobAct, Request};
use palpate_wire::{
    api::{
        Attempt, Campaign, CampaignObject, CampaignPlan, CampaignPolicy, CampaignResults, CampaignSummary,
        ComparedModel, ComparedPairing, ComparedTouch, ComparedTrial, ComparisonReport, FailureModes, Job,
        JobKindDocument, JobPage, JobRequest, JobState, LeftOutTrial, PolicyResult, Role as May,
        RolloutOutcome, SaidBy, SuccessRate, Trial, TrialOrder, TrialStart, TrialState, TrialVerdict, Via,
    },
    proto::{Changed, StreamMessage, stream_message},
};
use prost::Message as _;

use crate::{
    fixture::{FakeWindow, SharedApi, full_api, page, page_of},
    home::me,
    jobs::job,
};

pub(crate) fn campaign(state: TrialState) -> Campaign {
    let plan = CampaignPlan {
        name: "First trials".into(),
        policies: vec![CampaignPolicy {
            id: "dp".into(),
            source: "policy.safetensors".into(),
            is_silenced: false,
        }],
        objects: vec![CampaignObject { id: "cube".into(), group: Some("seen".into()) }],
        starts: 2,
        half_width_m: 0.02,
        seed: 1,
        order: TrialOrder::Interleaved,
        is_blind: false,
        scorers: 1,
        alpha: 0.05,
        criterion: "3 cm for 1 s".into(),
    };
    let start = TrialStart { x_m: 0.012, y_m: -0.004, yaw_rad: 0.5, side: 0.1, seed: 3 };
    let outcome = RolloutOutcome {
        suggested: Some(TrialVerdict::Slip),
        reasons: vec!["lost at 12 mm".into()],
        time_to_grasp_s: None,
        held_s: None,
        take: None,
        record: None,
    };
    let has_ended = state == TrialState::Unscored;
    let attempt = Attempt {
        began: "2026-11-25T10:00:00Z".into(),
        by: "Olga".into(),
        outcome: has_ended.then_some(outcome),
        take: None,
        has_ended,
        scores: Vec::new(),
        settled: None,
        verdict: None,
    };
    let first = Trial {
        number: 1,
        policy: Some("dp".into()),
        object: "cube".into(),
        start_number: 2,
        start,
        state,
        attempts: if state == TrialState::Waiting { Vec::new() } else { vec![attempt] },
    };
    let second = Trial {
        number: 2,
        start_number: 1,
        state: TrialState::Waiting,
        attempts: Vec::new(),
        ..first.clone()
    };
    Campaign {
        summary: CampaignSummary {
            id: "first-trials".into(),
            name: plan.name.clone(),
            created: "2026-11-25T09:00:00Z".into(),
            planned: 2,
            scored: 0,
            to_score: u32::from(has_ended),
            paused: None,
            closed: None,
            error: None,
        },
        plan,
        trials: vec![first, second],
        next: Some(if has_ended { 2 } else { 1 }),
        next_to_score: has_ended.then_some(1),
    }
}

fn seen(scorer: &str, as_scorer: bool) -> Request {
    Request::Campaign { campaign: "first-trials".into(), scorer: scorer.into(), as_scorer }
}

pub(crate) fn with(campaign: &Campaign) -> SharedApi {
    let api = full_api();
    let json = |value: &Campaign| serde_json::to_vec(value).expect("it is plain data");
    {
        let mut fake = api.0.borrow_mut();
        let list = serde_json::to_vec(&[&campaign.summary]).expect("it is plain data");
        fake.answer(&Request::Campaigns, list);
        for scorer in ["", "Ada"] {
            fake.answer(&seen(scorer, false), json(campaign));
            fake.answer(&seen(scorer, true), json(campaign));
        }
    }
    api
}

fn acts(api: &SharedApi) -> Vec<CampaignAct> {
    let sent = &api.0.borrow().sent;
    sent.iter()
        .filter_map(|request| match request {
            Request::ActOnCampaign { act, .. } => Some(act.clone()),
            _ => None,
        })
        .collect()
}

#[test]
fn the_next_trial_says_where_the_object_goes_and_begins() {
    let api = with(&campaign(TrialState::Waiting));
    let mut harness = page(&api, &FakeWindow::at("#/trials"));
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::Image, "x +12 mm, y -4 mm from the middle, turned by 29\u{b0}");
    harness.get_by_label_contains("Trial 1 of 2: cube with dp");
    harness.get_by_role_and_label(Role::Button, "It is placed: begin").click();
    harness.run_steps(3);
    assert_eq!(acts(&api), [CampaignAct::Begin(1)]);
    // The made-up server refuses, and its words are on the page.
    harness.get_by_label_contains("nothing at POST /api/v1/campaigns/first%2Dtrials/trials/1/begin");
}

/// The same studio, which can run policies itself unless there is a `problem`, with this job.
fn with_rollouts(problem: Option<&str>, job: Option<Job>) -> SharedApi {
    let api = with(&campaign(TrialState::Waiting));
    let kind = JobKindDocument {
        kind: "rollouts".into(),
        resources: Default::default(),
        is_available: problem.is_none(),
        problem: problem.map(str::to_owned),
    };
    let page = JobPage { jobs: job.into_iter().collect(), next_cursor: None };
    let mut fake = api.0.borrow_mut();
    fake.answer(&Request::Kinds, serde_json::to_vec(&[kind]).expect("it is plain data"));
    fake.answer(&Request::Jobs(None), serde_json::to_vec(&page).expect("it is plain data"));
    drop(fake);
    api
}

fn rollouts(state: JobState) -> Job {
    let mut job = job("rollouts-1", "rollouts", state);
    job.stage = "trial 1 of 2 waits: place its object and begin it at the page".into();
    job.spec.request = serde_json::json!({ "campaign": "first-trials" });
    job
}

#[test]
fn policies_run_by_one_button_and_say_what_they_wait_for() {
    let api = with_rollouts(None, None);
    let mut harness = page(&api, &FakeWindow::at("#/trials"));
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::Button, "Let the policies run here").click();
    harness.run_steps(3);
    let asked = Request::SubmitJob(JobRequest {
        kind: "rollouts".into(),
        request: serde_json::json!({ "campaign": "first-trials" }),
        seed: 0,
        priority: 0,
        resources: None,
        runner: None,
    });
    assert!(api.0.borrow().sent.contains(&asked));

    // Trials become takes unless somebody does not want that, and that is said.
    let api = with_rollouts(None, None);
    let mut harness = page(&api, &FakeWindow::at("#/trials"));
    harness.run_steps(3);
    assert!(harness.query_by_role_and_label(Role::TextInput, "in session").is_some());
    harness.get_by_label("Record each trial as a take").click();
    harness.run_steps(3);
    harness.get_by_label_contains("Without takes there is nothing to diagnose");
    harness.get_by_role_and_label(Role::Button, "Let the policies run here").click();
    harness.run_steps(3);
    let is_asked = |request: &Request| matches!(request, Request::SubmitJob(job) if job.request["without_recording"] == true);
    assert!(api.0.borrow().sent.iter().any(is_asked));

    let api = with_rollouts(None, Some(rollouts(JobState::Running)));
    let mut harness = page(&api, &FakeWindow::at("#/trials"));
    harness.run_steps(3);
    harness.get_by_label_contains("rollouts-1 moves the robot");
    assert!(harness.query_by_label("Let the policies run here").is_none());
    harness.get_by_role_and_label(Role::Button, "Stop running trials").click();
    harness.run_steps(3);
    let stopped = Request::ActOnJob { job: "rollouts-1".into(), act: JobAct::Cancel };
    assert!(api.0.borrow().sent.contains(&stopped));
}

#[test]
fn policies_that_cannot_run_say_why() {
    let api = with_rollouts(Some("no station \"live\""), None);
    let mut harness = page(&api, &FakeWindow::at("#/trials"));
    harness.run_steps(3);
    harness.get_by_label_contains("This studio cannot run policies itself: no station");
    assert!(harness.query_by_label("Let the policies run here").is_none());

    let api = with_rollouts(None, Some(rollouts(JobState::Failed)));
    let mut harness = page(&api, &FakeWindow::at("#/trials"));
    harness.run_steps(3);
    harness.get_by_label_contains("rollouts-1 failed: the disk is full");
    harness.get_by_role_and_label(Role::Button, "Let the policies run here");
}

#[test]
fn a_break_is_taken_and_nothing_begins_until_somebody_goes_on() {
    let mut paused = campaign(TrialState::Waiting);
    let api = with(&paused);
    let mut harness = page(&api, &FakeWindow::at("#/trials"));
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::Button, "Take a break").click();
    harness.run_steps(3);
    assert_eq!(acts(&api), [CampaignAct::Pause]);

    paused.summary.paused = Some("2026-11-25T10:00:00Z".into());
    let api = with(&paused);
    let mut harness = page(&api, &FakeWindow::at("#/trials"));
    harness.run_steps(3);
    harness.get_by_label_contains("The campaign is paused");
    assert!(harness.query_by_label("It is placed: begin").is_none());
    harness.get_by_role_and_label(Role::Button, "Go on").click();
    harness.run_steps(3);
    assert_eq!(acts(&api), [CampaignAct::Resume]);
}

#[test]
fn a_trial_is_scored_by_one_key() {
    let api = with(&campaign(TrialState::Unscored));
    let mut harness = page(&api, &FakeWindow::of("Ada", "#/trials?campaign=first-trials&part=score"));
    harness.run_steps(3);
    harness.get_by_label_contains("The rollout suggests: slip.");
    harness.get_by_label_contains("lost at 12 mm");
    harness.key_press(Key::E);
    harness.run_steps(3);
    let acts = acts(&api);
    let [CampaignAct::Score(1, score)] = acts.as_slice() else { panic!("{acts:?}") };
    assert_eq!((score.scorer.as_str(), score.verdict), ("Ada", TrialVerdict::EmptyGrasp));
}

#[test]
fn nobody_scores_without_a_name() {
    let api = with(&campaign(TrialState::Unscored));
    let mut harness = page(&api, &FakeWindow::at("#/trials?campaign=first-trials&part=score"));
    harness.run_steps(3);
    harness.get_by_label_contains("Write your name to score");
    harness.key_press(Key::S);
    harness.run_steps(3);
    assert!(acts(&api).is_empty());
}

/// The same studio, where somebody of `role` is logged in as ada.
fn seen_by(role: May, campaign: &Campaign) -> SharedApi {
    let api = with(campaign);
    {
        let mut fake = api.0.borrow_mut();
        fake.answer(&Request::Me, serde_json::to_vec(&me(role, Via::Session)).expect("it is plain data"));
        for as_scorer in [false, true] {
            fake.answer(&seen("ada", as_scorer), serde_json::to_vec(campaign).expect("it is plain data"));
        }
    }
    api
}

#[test]
fn a_viewer_is_offered_nothing_that_moves_or_scores() {
    for state in [TrialState::Waiting, TrialState::Running, TrialState::Unscored] {
        let api = seen_by(May::Viewer, &campaign(state));
        let mut harness = page(&api, &FakeWindow::at("#/trials"));
        harness.run_steps(3);
        harness.get_by_label_contains("You are ada (viewer): you can watch.");
        for name in
            ["It is placed: begin", "It has ended", "Take a break", "Close the campaign", "Plan a campaign"]
        {
            assert!(harness.query_by_label(name).is_none(), "{name}");
        }
        let mut harness = page(&api, &FakeWindow::at("#/trials?campaign=first-trials&part=score"));
        harness.run_steps(3);
        harness.get_by_label_contains("Scorers and operators score trials.");
        harness.key_press(Key::S);
        harness.run_steps(3);
        assert!(harness.query_by_label("Score: success").is_none() && acts(&api).is_empty());
    }
}

#[test]
fn a_scorer_who_logged_in_comes_to_score_under_their_own_name() {
    let mut blind = campaign(TrialState::Unscored);
    blind.plan.is_blind = true;
    blind.trials.iter_mut().for_each(|trial| trial.policy = None);
    let api = seen_by(May::Scorer, &blind);
    // Whoever sat at this browser before is of no account.
    let mut harness = page(&api, &FakeWindow::of("Olga", "#/trials"));
    harness.run_steps(4);
    harness.get_by_label("You score as ada.");
    harness.key_press(Key::S);
    harness.run_steps(3);
    let acts = acts(&api);
    let [CampaignAct::Score(1, score)] = acts.as_slice() else { panic!("{acts:?}") };
    assert_eq!((score.scorer.as_str(), score.verdict), ("ada", TrialVerdict::Success));
    // Beside the verdicts, they watch: nothing there moves, and no results are asked for before it is closed.
    let mut harness = page(&api, &FakeWindow::at("#/trials?campaign=first-trials&part=run"));
    harness.run_steps(3);
    harness.get_by_label("Trial 2 of 2: cube");
    harness.get_by_label_contains("you can watch and score. Operators run trials.");
    let mut harness = page(&api, &FakeWindow::at("#/trials?campaign=first-trials&part=results"));
    harness.run_steps(3);
    harness.get_by_label_contains("This campaign is blind: its results stand here once it is closed.");
    let sent = &api.0.borrow().sent;
    assert!(!sent.iter().any(|request| matches!(request, Request::CampaignResults(_))), "{sent:?}");
}

#[test]
fn whoever_may_not_plan_is_told_who_does() {
    let api = full_api();
    {
        let mut fake = api.0.borrow_mut();
        fake.answer(&Request::Campaigns, b"[]".to_vec());
        fake.answer(
            &Request::Me,
            serde_json::to_vec(&me(May::Scorer, Via::Session)).expect("it is plain data"),
        );
    }
    let mut harness = page(&api, &FakeWindow::at("#/trials"));
    harness.run_steps(3);
    harness.get_by_label("Operators plan campaigns.");
    assert!(harness.query_by_label("Plan a campaign").is_none());
}

#[test]
fn what_others_do_is_seen_without_reloading() {
    let api = with(&campaign(TrialState::Waiting));
    let mut harness = page(&api, &FakeWindow::at("#/trials?campaign=first-trials"));
    harness.run_steps(3);
    let running = campaign(TrialState::Running);
    api.0.borrow_mut().answer(&seen("", false), serde_json::to_vec(&running).expect("it is plain data"));
    let changed = Changed { list: "campaigns".into(), id: "first-trials".into() };
    let message = StreamMessage { message: Some(stream_message::Message::Changed(changed)), dropped: 0 };
    api.0.borrow_mut().events.push_back(ApiEvent::SocketMessage(message.encode_to_vec()));
    harness.run_steps(4);
    harness.get_by_role_and_label(Role::Button, "It has ended");
}

#[test]
fn a_campaign_is_planned_and_run_on_a_phone() {
    let phone = [390.0, 844.0];
    let api = with(&campaign(TrialState::Waiting));
    let mut harness = page_of(&api, &FakeWindow::at("#/trials"), phone);
    let picture = harness
        .get_by_role_and_label(Role::Image, "x +12 mm, y -4 mm from the middle, turned by 29\u{b0}")
        .rect();
    let begin = harness.get_by_role_and_label(Role::Button, "It is placed: begin").rect();
    assert!(begin.top() >= picture.bottom() && begin.right() <= phone[0], "{picture:?} {begin:?}");
    harness.get_by_role_and_label(Role::Button, "Plan a campaign").click();
    harness.run_steps(4);
    for field in ["Name", "A success is"] {
        let rect = harness.get_by_role_and_label(Role::TextInput, field).rect();
        assert!(rect.right() <= phone[0], "{field}: {rect:?}");
    }
    for text in ["Scorers do not learn", "The plan is fixed once"] {
        let rect = harness.get_by_label_contains(text).rect();
        assert!(rect.right() <= phone[0], "{text}: {rect:?}");
    }
}

#[test]
fn what_an_empty_screen_says_is_not_cut_on_a_phone() {
    let phone = [390.0, 844.0];
    let api = full_api();
    api.0.borrow_mut().answer(&Request::Campaigns, b"[]".to_vec());
    let mut harness = page_of(&api, &FakeWindow::at("#/trials"), phone);
    harness.run_steps(3);
    let rect = harness.get_by_label_contains("A campaign tries policies on the hand").rect();
    // The rail is on the left.
    assert!(rect.left() >= 48.0 && rect.right() <= phone[0], "{rect:?}");
}

/// A campaign of five trials, each with a record in this folder.
fn compared(folder: &str) -> Campaign {
    let mut made = campaign(TrialState::Unscored);
    made.plan.policies.push(CampaignPolicy {
        id: "numb".into(),
        source: "policy.safetensors".into(),
        is_silenced: true,
    });
    let first = made.trials[0].clone();
    let trial = |number: u32, policy: &str, verdict: TrialVerdict, record: String| {
        let mut trial = Trial { number, policy: Some(policy.into()), ..first.clone() };
        trial.attempts[0].verdict = Some(verdict);
        if let Some(outcome) = &mut trial.attempts[0].outcome {
            outcome.record = Some(record);
        }
        trial
    };
    made.trials = vec![
        trial(1, "dp", TrialVerdict::Success, format!("{folder}/trial-0001-0.jsonl")),
        trial(2, "numb", TrialVerdict::Success, format!("{folder}/trial-0002-0.jsonl")),
        trial(3, "dp", TrialVerdict::Void, format!("{folder}/trial-0003-0.jsonl")),
        trial(4, "dp", TrialVerdict::Slip, format!("{folder}/trial-0004-0.jsonl")),
        trial(5, "dp", TrialVerdict::Slip, "trial-0005-0.jsonl".into()),
    ];
    made
}

/// The results of `campaign`, and a studio that compares unless there is a `problem`, with this job.
fn with_comparison(campaign: &Campaign, problem: Option<&str>, job: Option<Job>) -> SharedApi {
    let api = with(campaign);
    let results = CampaignResults {
        campaign: "first-trials".into(),
        planned: 5,
        scored: 5,
        policies: Vec::new(),
        comparisons: Vec::new(),
        agreement: None,
        published: Vec::new(),
    };
    let kind = JobKindDocument {
        kind: "comparison".into(),
        resources: Default::default(),
        is_available: problem.is_none(),
        problem: problem.map(str::to_owned),
    };
    let page = JobPage { jobs: job.into_iter().collect(), next_cursor: None };
    let mut fake = api.0.borrow_mut();
    let json = |value: Result<Vec<u8>, serde_json::Error>| value.expect("it is plain data");
    fake.answer(&Request::CampaignResults("first-trials".into()), json(serde_json::to_vec(&results)));
    fake.answer(&Request::Kinds, json(serde_json::to_vec(&[kind])));
    fake.answer(&Request::Jobs(None), json(serde_json::to_vec(&page)));
    drop(fake);
    api
}

fn comparison(state: JobState) -> Job {
    let mut job = job("comparison-1", "comparison", state);
    job.stage = "dp on cube: trials".into();
    job.spec.request = serde_json::json!({ "campaign": "first-trials", "models": ["nominal"] });
    job
}

const RESULTS: &str = "#/trials?campaign=first-trials&part=results";
/// Where jobs of the studio leave the records of a campaign.
const OWN_RECORDS: &str = "/data/campaigns/first-trials/rollout";

#[test]
fn what_was_made_elsewhere_is_compared_by_a_command_to_copy() {
    let api = with_comparison(&compared("runs/first night"), None, None);
    for size in [[390.0, 844.0], [1280.0, 800.0]] {
        let mut harness = page_of(&api, &FakeWindow::at(RESULTS), size);
        harness.get_by_label_contains("These trials were made outside the studio");
        assert!(harness.query_by_label("Compare with the simulator").is_none());
        harness.get_by_label("In a terminal instead").click();
        harness.run_steps(20);
        harness.get_by_label_contains("This runs outside the studio");
        harness.get_by_label("palpate-train compare-rollout --rollout 'runs/first night' --only 1,4");
        let copy = harness.get_by_role_and_label(Role::Button, "Copy the command for dp on cube").rect();
        assert!(copy.right() <= size[0], "{copy:?}");
        assert!(harness.query_by_label_contains("for numb").is_none());
    }
}

#[test]
fn trials_are_compared_with_the_simulator_by_one_button() {
    let api = with_comparison(&compared(OWN_RECORDS), None, None);
    let mut harness = page_of(&api, &FakeWindow::at(RESULTS), [390.0, 844.0]);
    harness.run_steps(3);
    // The studio of the fixture has one saved model, without effects.
    harness.get_by_label_contains("no diagnosed one: none is saved yet");
    harness.get_by_role_and_label(Role::Button, "Compare with the simulator").click();
    harness.run_steps(3);
    let sent = api.0.borrow().sent.clone();
    let asked = sent.iter().find_map(|request| match request {
        Request::SubmitJob(job) => Some((job.kind.clone(), job.request.clone())),
        _ => None,
    });
    let request = serde_json::json!({ "campaign": "first-trials", "models": ["nominal", "bench-fit"] });
    assert_eq!(asked, Some(("comparison".to_owned(), request)));

    let api = with_comparison(&compared(OWN_RECORDS), None, Some(comparison(JobState::Running)));
    let mut harness = page(&api, &FakeWindow::at(RESULTS));
    harness.run_steps(3);
    harness.get_by_label_contains("comparison-1 compares. dp on cube: trials");
    harness.get_by_role_and_label(Role::Button, "Stop comparing").click();
    harness.run_steps(3);
    let stopped = Request::ActOnJob { job: "comparison-1".into(), act: JobAct::Cancel };
    assert!(api.0.borrow().sent.contains(&stopped));

    let missing = "palpate-train is not installed beside palpate; build it with `cargo build`";
    let api = with_comparison(&compared(OWN_RECORDS), Some(missing), None);
    let mut harness = page(&api, &FakeWindow::at(RESULTS));
    harness.run_steps(3);
    harness.get_by_label_contains("This studio cannot simulate trials: palpate-train is not installed");
    let mut blind = compared(OWN_RECORDS);
    blind.plan.is_blind = true;
    let api = with_comparison(&blind, None, None);
    let mut harness = page(&api, &FakeWindow::at(RESULTS));
    harness.run_steps(3);
    harness.get_by_label_contains("it can be compared once it is closed");
}

/// What a comparison of three trials found: the first differs, and its take has no object that was followed.
pub(crate) fn found(takes: bool) -> ComparisonReport {
    let rate = |successes: u64| SuccessRate {
        successes,
        trials: 3,
        rate: Some(successes as f64 / 3.0),
        wilson_95: [0.2, 0.9],
        clopper_pearson_95: [0.1, 0.95],
    };
    let pairing = |model: &str, won: u64| ComparedPairing {
        policy: Some("dp".into()),
        object: Some("cube".into()),
        model: model.into(),
        hand: rate(2),
        simulated: rate(won),
        same_verdict: 2,
        only_hand: 0,
        only_simulated: 1,
        p_mcnemar: 1.0,
        touch: Some(ComparedTouch {
            f1: Some(0.4),
            gap: Some(0.0223),
            onset_error_ms: Some(400.0),
            hand_contacts: 16,
            simulated_contacts: 61,
        }),
    };
    let trial = |number: u32, hand: TrialVerdict| ComparedTrial {
        trial: number,
        policy: "dp".into(),
        object: "cube".into(),
        hand,
        said_by: if number == 1 { SaidBy::Scorers } else { SaidBy::Robot },
        simulated: vec![TrialVerdict::Success; 2],
        take: takes.then(|| format!("first-trials-takes/take-0{number}")),
        is_followed: number > 1,
        is_start_planned: number == 1,
    };
    let model = |id: &str, name: &str| ComparedModel { id: id.into(), name: name.into() };
    ComparisonReport {
        campaign: "first-trials".into(),
        models: vec![model("nominal", "Nominal"), model("bench-fit", "Bench, diagnosed")],
        trials: vec![
            trial(1, TrialVerdict::Slip),
            trial(2, TrialVerdict::Success),
            trial(4, TrialVerdict::Success),
        ],
        left_out: vec![LeftOutTrial { trial: 3, why: "it is void".into() }],
        pairings: vec![pairing("nominal", 3), pairing("bench-fit", 3)],
    }
}

#[test]
fn where_outcomes_differ_is_shown_beside_the_trials_and_leads_to_a_diagnosis() {
    for (size, takes) in [([390.0, 844.0], true), ([1280.0, 800.0], true), ([1280.0, 800.0], false)] {
        let api = with_comparison(&compared(OWN_RECORDS), None, Some(comparison(JobState::Done)));
        let body = serde_json::to_vec(&found(takes)).expect("it is plain data");
        api.0.borrow_mut().answer(&Request::ComparisonReport("comparison-1".into()), body);
        let window = FakeWindow::at(RESULTS);
        let mut harness = page_of(&api, &window, size);
        harness.run_steps(6);
        if let Some(folder) = std::env::var_os("PALPATE_ARTIFACTS") {
            let picture = harness.render().expect("it is painted on the CPU");
            let name = format!("compared_{}_{takes}.png", size[0]);
            picture.save(std::path::PathBuf::from(folder).join(name)).expect("the folder can be written");
        }
        harness.get_by_label("Outcomes differ in 1 of 3 trials.");
        for text in ["2/3 (20 to 90 %)", "slip (scored)", "0.0223"] {
            assert!(harness.query_all_by_label(text).next().is_some(), "{text}");
        }
        assert_eq!(harness.query_all_by_label("\u{2716} success").count(), 2, "one a model");
        assert!(harness.query_by_label("success (the robot's own)").is_none(), "they agree");
        harness.get_by_label_contains("In 1 trial nobody measured where the object began");
        if !takes {
            harness.get_by_label_contains("were not recorded as takes");
            assert!(harness.query_by_label_contains("Diagnose these takes").is_none());
            continue;
        }
        let doubt = harness.get_by_label_contains("In 1 take nobody followed the object").rect();
        assert!(doubt.right() <= size[0], "{doubt:?}");
        harness.get_by_role_and_label(Role::CheckBox, "Show trials that agree too").scroll_to_me();
        harness.run_steps(5);
        harness.get_by_role_and_label(Role::CheckBox, "Show trials that agree too").click();
        harness.run_steps(3);
        assert_eq!(harness.query_all_by_label("success (the robot's own)").count(), 2);
        let diagnose = harness.get_by_role_and_label(Role::Button, "Diagnose these takes");
        assert!(diagnose.rect().right() <= size[0], "{:?}", diagnose.rect());
        diagnose.scroll_to_me();
        harness.run_steps(5);
        if let Some(folder) = std::env::var_os("PALPATE_ARTIFACTS") {
            let picture = harness.render().expect("it is painted on the CPU");
            let name = format!("compared_{}_below.png", size[0]);
            picture.save(std::path::PathBuf::from(folder).join(name)).expect("the folder can be written");
        }
        harness.get_by_role_and_label(Role::Button, "Diagnose these takes").click();
        harness.run_steps(3);
        assert_eq!(window.current(), "#/diagnose/first-trials-takes");
    }
}

#[test]
fn intervals_have_a_scale_and_names_are_not_cut_on_a_phone() {
    let api = with(&campaign(TrialState::Waiting));
    let rate = SuccessRate {
        successes: 1,
        trials: 2,
        rate: Some(0.5),
        wilson_95: [0.1, 0.9],
        clopper_pearson_95: [0.0, 1.0],
    };
    let policy = PolicyResult {
        policy: "a-policy-with-a-very-long-name".into(),
        overall: rate,
        seen: None,
        unseen: None,
        objects: Vec::new(),
        failures: FailureModes::default(),
        void: 0,
        open: 0,
        median_time_to_grasp_s: None,
        pass_hat_k: Vec::new(),
    };
    let results = CampaignResults {
        campaign: "first-trials".into(),
        planned: 2,
        scored: 2,
        policies: vec![policy],
        comparisons: Vec::new(),
        agreement: None,
        published: Vec::new(),
    };
    let body = serde_json::to_vec(&results).expect("it is plain data");
    api.0.borrow_mut().answer(&Request::CampaignResults("first-trials".into()), body);
    let at = FakeWindow::at("#/trials?campaign=first-trials&part=results");
    for (size, above) in [([390.0, 844.0], true), ([1280.0, 800.0], false)] {
        let harness = page_of(&api, &at, size);
        let line = harness.get_by_label("a-policy-with-a-very-long-name: 1/2, 50 % (10 to 90)").rect();
        assert!(line.right() <= size[0], "{line:?}");
        let name = harness.query_all_by_label("a-policy-with-a-very-long-name");
        assert_eq!(name.filter(|name| name.rect().bottom() <= line.top() + 1.0).count(), usize::from(above));
    }
}

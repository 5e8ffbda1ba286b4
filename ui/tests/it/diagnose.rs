//! Find, name, add, show: a diagnosis as an operator meets it.

use std::collections::BTreeMap;

use egui::accesskit::Role;
use egui_kittest::kittest::{NodeT as _, Queryable as _};
use palpate_reports::{
    Bar, Candidate, Cell, ChannelResidual, DiagnosisReport, Doubt, EffectInDoubt, Gap, Metrics, ModelEffect,
    NamedEffect, NextExperiment, Purpose, Rival, ThetaReport, TooMuchLeft, Unexplained, Verdict,
    WaterfallStep,
};
use palpate_robot_model::Place;
use palpate_ui::{
    api_client::{ApiEvent, Request},
    playback::ModelRef,
    route::Screen,
};
use palpate_wire::{
    api::{
        DiagnosisRequest, DiagnosisRun, JobState, ModelSummary, RecordingDocument, SaveDiagnosisRequest,
        SessionSummary, WantedTake,
    },
    proto::{JobUpdate, StreamMessage, stream_message},
};
use prost::Message as _;

use crate::fixture::{
    FakeWindow, SharedApi, app, deliver, full_api, page, page_of, station, without_station,
};

const ID: &str = "diagnosis-3";

fn latency() -> NamedEffect {
    NamedEffect {
        id: "latency".into(),
        place: Place::Stream("film".into()),
        parameters: BTreeMap::from([("delay_s".into(), 0.0618)]),
        interval: BTreeMap::from([("delay_s".into(), [0.0521, 0.0704])]),
        gap_before: 0.50,
        gap_after: 0.30,
        p_value: Some(0.0001),
        evidence: 88.0,
        takes_improved: "8/9".into(),
        class: vec!["latency".into()],
        rivals: Vec::new(),
        explanation: "The film stream arrives 62 ms late.".into(),
    }
}

fn backlash() -> NamedEffect {
    NamedEffect {
        id: "joint_backlash".into(),
        place: Place::Joint("x".into()),
        parameters: BTreeMap::from([("width_rad".into(), 0.017)]),
        interval: BTreeMap::from([("width_rad".into(), [0.011, 0.022])]),
        gap_before: 0.30,
        gap_after: 0.24,
        p_value: Some(0.004),
        evidence: 21.0,
        takes_improved: "6/9".into(),
        class: vec!["joint_backlash".into(), "joint_offset".into()],
        rivals: vec![Rival { id: "joint_offset".into(), place: Place::Joint("x".into()), gap_after: 0.25 }],
        explanation: "Joint x has 17 mrad of play.".into(),
    }
}

fn cell(phase: &str, excess: f64) -> Cell {
    Cell {
        stream: Some("film".into()),
        channels: vec!["film.0".into(), "film.1".into()],
        joints: Vec::new(),
        phase: phase.into(),
        takes: vec!["take-01".into(), "take-02".into()],
        excess,
        effect_size: 1.4,
        p_value: 0.0004,
    }
}

fn report(effects: Vec<NamedEffect>, verdict: Verdict, sentence: &str) -> DiagnosisReport {
    let diagnosed = effects.last().map_or(0.50, |effect| effect.gap_after);
    let gap = Gap { nominal: 0.9, calibrated: 0.50, diagnosed, noise_floor: Some(0.18) };
    let step = |step: &str, gap: f64| WaterfallStep {
        step: step.into(),
        gap,
        interval_95: Some([gap * 0.9, gap * 1.1]),
    };
    let steps = [step("nominal", 0.9), step("calibrated", 0.50)];
    let steps = steps.into_iter().chain(effects.iter().map(|effect| step(&effect.id, effect.gap_after)));
    let candidate = |id: &str, evidence: f64| Candidate {
        id: id.into(),
        place: Place::Stream("gel".into()),
        parameters: BTreeMap::new(),
        evidence,
        share_removed: 0.03,
        explanation: "Something else.".into(),
    };
    let metrics = |onset: f64, f1: f64| Metrics {
        onset_error_ms: Some(onset),
        f1: Some(f1),
        fpr: Some(0.01),
        ..Metrics::default()
    };
    let bench = station();
    let residual_map = bench.layout.channels.iter().enumerate().map(|(idx, channel)| ChannelResidual {
        channel: channel.id.clone(),
        calibrated: BTreeMap::from([("onset".into(), 0.02 * idx as f64), ("release".into(), 0.1)]),
        diagnosed: BTreeMap::from([("onset".into(), 0.01 * idx as f64), ("release".into(), 0.05)]),
    });
    let some = |fraction: f64| Unexplained {
        fraction,
        significant: verdict == Verdict::Unexplained,
        cells: vec![cell("no_contact", fraction)],
        because: match verdict {
            Verdict::Unexplained => because(),
            _ => Vec::new(),
        },
        touch_to_touch: BTreeMap::from([("film".into(), 12.4)]),
    };
    let next = NextExperiment {
        primitive: "tap_two_speeds".into(),
        object: "sphere_50mm".into(),
        separates: vec!["joint_backlash".into(), "joint_offset".into()],
        expected_gain: 6.2,
        sentence: "Record taps on the sphere from both sides of joint x.".into(),
        purpose: Purpose::Separate,
    };
    DiagnosisReport {
        verdict,
        sentence: sentence.into(),
        in_doubt: Vec::new(),
        fitted: Gap::default(),
        candidates: vec![candidate("low_pass", 6.0), candidate("electrical_crosstalk", 3.5)],
        cells: vec![cell("onset", 0.51), cell("release", 0.33)],
        gap: gap.clone(),
        held_out: gap,
        waterfall: steps.collect(),
        metrics: BTreeMap::from([
            ("nominal".into(), metrics(231.0, 0.64)),
            ("calibrated".into(), metrics(120.0, 0.75)),
            ("diagnosed".into(), metrics(48.0, 0.84)),
        ]),
        unexplained: some(if effects.is_empty() { 1.0 } else { 0.21 }),
        next_experiment: effects.iter().any(|effect| !effect.rivals.is_empty()).then_some(next),
        residual_map: residual_map.collect(),
        takes: BTreeMap::from([
            ("fit".into(), vec!["take-01".into()]),
            ("confirm".into(), vec!["take-02".into()]),
        ]),
        bar: Bar { evidence: 12.5, null_sessions: 200, null_maxima: vec![2.0, 4.0, 5.5, 9.0] },
        reference_sessions: None,
        notes: Vec::new(),
        seconds: 4.2,
        effects,
    }
}

pub(crate) fn named() -> DiagnosisReport {
    report(
        vec![latency(), backlash()],
        Verdict::PartlyExplained,
        "Two effects are missing: they remove 52 % of the gap.",
    )
}

/// A report that leaves no part of the screen out, with names and numbers as long as they get.
pub(crate) fn full() -> DiagnosisReport {
    let bench = station();
    let ids = |count: usize| -> Vec<String> {
        bench.layout.channels.iter().take(count).map(|channel| channel.id.clone()).collect()
    };
    let crosstalk = NamedEffect {
        id: "electrical_crosstalk".into(),
        place: Place::Channels(ids(5)),
        parameters: BTreeMap::from([("share".into(), 0.12), ("delay_s".into(), 0.002)]),
        interval: BTreeMap::from([("share".into(), [0.08, 0.15]), ("delay_s".into(), [0.001, 0.003])]),
        p_value: None,
        gap_before: 0.24,
        gap_after: 0.25,
        ..backlash()
    };
    let mut full = report(
        vec![latency(), backlash(), crosstalk],
        Verdict::PartlyExplained,
        "Three effects are missing from the simulator; adding them removes 52 % of the gap on takes they have not seen.",
    );
    full.in_doubt = vec![EffectInDoubt {
        id: "low_pass".into(),
        place: Place::Stream("film".into()),
        parameters: BTreeMap::new(),
        doubt: vec![Doubt { check: "weak_beside_rest".into(), measured: 2.1, limit: 1.0 }],
    }];
    full.notes = vec!["no null bar of this station: the shipped one applies".into()];
    full.candidates.push(Candidate { place: Place::Channels(ids(9)), ..full.candidates[1].clone() });
    full.cells = vec![
        Cell { channels: ids(9), joints: vec!["x".into(), "y".into()], ..cell("sustained", 0.51) },
        Cell { takes: (1..=9).map(|take| format!("take-0{take}")).collect(), ..cell("no_contact", 0.33) },
    ];
    full.unexplained.cells.push(Cell { p_value: 0.4, ..cell("release", 0.02) });
    full.unexplained.because = because();
    full.bar.null_sessions = 0;
    full.takes = BTreeMap::from([
        ("fit".into(), (1..=6).map(|take| format!("take-0{take}")).collect()),
        ("confirm".into(), (7..=9).map(|take| format!("take-0{take}")).collect()),
    ]);
    full.seconds = 754.0;
    full
}

fn because() -> Vec<TooMuchLeft> {
    vec![TooMuchLeft {
        check: "common_mode".into(),
        measured: 11.2,
        limit: 1.5,
        place: Some(Place::Stream("film".into())),
        sentence: "quiet channels of film wander together".into(),
    }]
}

fn request() -> DiagnosisRequest {
    DiagnosisRequest {
        session: "bench-1".into(),
        model: None,
        hold_out: None,
        max_effects: None,
        without: Vec::new(),
        null_sessions: None,
        references: Vec::new(),
    }
}

pub(crate) fn run(state: JobState, report: Option<DiagnosisReport>) -> DiagnosisRun {
    DiagnosisRun {
        id: ID.into(),
        request: request(),
        state,
        fraction: if state == JobState::Done { 1.0 } else { 0.4 },
        stage: "trying one dose of low pass at stream gel".into(),
        seconds_left: (state == JobState::Running).then_some(3.0),
        error: (state == JobState::Failed).then(|| "take-01: no repetition is marked; mark some".to_owned()),
        report,
        model_toml: None,
        saved_as: None,
    }
}

fn answer(api: &SharedApi, request: &Request, body: &impl serde::Serialize) {
    api.0.borrow_mut().answer(request, serde_json::to_vec(body).expect("plain data"));
}

/// A server with a finished diagnosis of this result.
fn api_with(run: &DiagnosisRun) -> SharedApi {
    let api = full_api();
    answer(&api, &Request::Diagnoses, &vec![run]);
    answer(&api, &Request::Diagnosis(ID.into()), run);
    api
}

pub(crate) fn result_page(run: &DiagnosisRun) -> (SharedApi, FakeWindow) {
    (api_with(run), FakeWindow::at(&format!("#/diagnose/bench-1?run={ID}")))
}

#[test]
fn button_starts_a_run_and_the_result_leads_with_a_sentence() {
    let api = full_api();
    answer(&api, &Request::Diagnoses, &Vec::<DiagnosisRun>::new());
    answer(&api, &Request::StartDiagnosis(request()), &run(JobState::Running, None));
    answer(&api, &Request::Diagnosis(ID.into()), &run(JobState::Done, Some(named())));
    let window = FakeWindow::at("#/diagnose/bench-1");
    let mut harness = page(&api, &window);
    harness.get_by_label_contains("press Start diagnosis");

    harness.get_by_role_and_label(Role::Button, "Start diagnosis").click();
    harness.run_steps(4);
    assert!(api.0.borrow().sent.contains(&Request::StartDiagnosis(request())), "{:?}", api.0.borrow().sent);
    harness.get_by_label_contains("40 %, 3.0 s left");
    assert!(harness.query_all_by_label_contains("one dose of low pass").count() >= 2);
    harness.get_by_role_and_label(Role::Button, "Cancel").click();
    harness.run_steps(2);
    assert!(api.0.borrow().sent.contains(&Request::CancelDiagnosis(ID.into())));

    let update = JobUpdate { job: ID.into(), state: "done".into(), fraction: 1.0, ..JobUpdate::default() };
    let message = StreamMessage { message: Some(stream_message::Message::Job(update)), dropped: 0 };
    deliver(&api, [ApiEvent::SocketMessage(message.encode_to_vec())]);
    harness.run_steps(6);
    harness.get_by_label_contains("they remove 52 % of the gap");
    harness.get_by_label("PARTLY EXPLAINED");
    harness.get_by_label_contains(
        "The film stream arrives 62 ms late (52.1 to 70.4 ms). 8 of 9 takes agree. Adding it removes 40 % of the gap.",
    );
    assert!(window.current().contains(&format!("run={ID}")), "{}", window.current());
    let playback = &app(&harness).playback;
    assert_eq!(playback.compared, Some(ModelRef::Calibrated(ID.into())));
    assert_eq!(playback.diagnosed, Some(ModelRef::Diagnosis(ID.into())));
}

#[test]
fn evidence_is_one_click_away_and_rivals_are_said_plainly() {
    let (api, window) = result_page(&run(JobState::Done, Some(named())));
    let mut harness = page(&api, &window);
    harness.get_by_label_contains("Cannot tell joint backlash from joint offset, joint x on these takes.");
    assert!(harness.query_all_by_label_contains("Record taps on the sphere from both sides").count() >= 1);
    assert!(harness.query_by_label_contains("95 % interval 52.1 to 70.4 ms").is_none());
    harness.get_by_role_and_label(Role::Button, "Evidence for latency, stream film").click();
    harness.run_steps(3);
    harness.get_by_label_contains("95 % interval 52.1 to 70.4 ms");
    harness.get_by_label_contains("88.0, the bar is 12.5 (p < 0.001)");
    // Pictures say what they show.
    harness.get_by_label_contains(
        "+ latency, stream film: gap 0.30  (\u{2212}40 %), 95 % interval 0.27 to 0.33",
    );
    harness.get_by_label_contains("latency, stream film: evidence 88.0, above the bar of 12.5, named");
    harness.get_by_label_contains("low pass, stream gel: evidence 6.00, below the bar of 12.5");
}

#[test]
fn residual_map_shows_before_and_after_and_goes_to_the_hand() {
    let (api, window) = result_page(&run(JobState::Done, Some(named())));
    let mut harness = page(&api, &window);
    harness.get_by_label_contains("Residual map after:");
    harness.get_by_role_and_label(Role::RadioButton, "Before: calibrated").scroll_to_me();
    harness.run_steps(4);
    harness.get_by_role_and_label(Role::RadioButton, "Before: calibrated").click();
    harness.run_steps(3);
    harness.get_by_label_contains("Residual map before:");
    harness.get_by_role_and_label(Role::Button, "Show on the hand").click();
    harness.run_steps(6);
    assert_eq!(app(&harness).screen(), Screen::Hand);
    assert!(window.current().contains("diagnosed=diagnosis:diagnosis-3"), "{}", window.current());
    assert!(harness.query_all_by_label_contains("mismatch 0.10 a second").count() >= 1);
}

#[test]
fn ticked_effects_are_added_and_undone() {
    let mut done = run(JobState::Done, Some(named()));
    done.request.model = Some("bench-fit".into());
    let (api, window) = result_page(&done);
    let body = SaveDiagnosisRequest { effects: Some(vec![0]), name: None, to: Some("bench-fit".into()) };
    let save = Request::SaveDiagnosis { run: ID.into(), body };
    let mut summary = ModelSummary {
        id: "bench-fit".into(),
        name: "Bench fit".into(),
        theta: ThetaReport { lambda_con_m: 0.001, alpha_per_m: 100.0, lambda_pre_pa: 10.0 },
        streams: Default::default(),
        provenance: Vec::new(),
        effects: vec![ModelEffect {
            id: "latency".into(),
            place: Place::Stream("film".into()),
            parameters: BTreeMap::from([("delay_s".into(), 0.0618)]),
        }],
        earlier_versions: 1,
    };
    answer(&api, &save, &summary);
    let mut harness = page(&api, &window);
    harness.get_by_label("all 2 named effects ticked");
    harness.get_by_role_and_label(Role::CheckBox, "Add joint backlash, joint x").click();
    harness.run_steps(3);
    harness.get_by_label("1 of 2 named effects ticked");

    answer(&api, &Request::Models, &vec![&summary]);
    answer(
        &api,
        &Request::Diagnosis(ID.into()),
        &DiagnosisRun { saved_as: Some("bench-fit".into()), ..done.clone() },
    );
    harness.get_by_role_and_label(Role::Button, "Add to bench-fit").click();
    harness.run_steps(6);
    assert!(api.0.borrow().sent.contains(&save), "{:?}", api.0.borrow().sent);
    harness.get_by_label_contains("Added to bench-fit");
    harness.get_by_label_contains("+ latency, stream film: delay 61.8 ms");
    assert_eq!(app(&harness).playback.diagnosed, Some(ModelRef::Saved("bench-fit".into())));

    summary.effects.clear();
    answer(&api, &Request::UndoModel("bench-fit".into()), &summary);
    answer(&api, &Request::Models, &vec![&summary]);
    answer(&api, &Request::Diagnosis(ID.into()), &done);
    harness.get_by_role_and_label(Role::Button, "Undo").click();
    harness.run_steps(6);
    assert!(api.0.borrow().sent.contains(&Request::UndoModel("bench-fit".into())));
    harness.get_by_role_and_label(Role::Button, "Add to bench-fit");
    assert!(harness.query_by_label_contains("+ latency, stream film: delay").is_none());
    assert_eq!(app(&harness).playback.diagnosed, Some(ModelRef::Diagnosis(ID.into())));
}

#[test]
fn effect_is_left_out_and_can_come_back() {
    let (api, window) = result_page(&run(JobState::Done, Some(named())));
    let without = DiagnosisRequest { without: vec!["latency".into()], ..request() };
    answer(
        &api,
        &Request::StartDiagnosis(without.clone()),
        &DiagnosisRun { id: "diagnosis-4".into(), request: without.clone(), ..run(JobState::Running, None) },
    );
    let mut harness = page(&api, &window);
    harness.get_by_role_and_label(Role::Button, "Run again without latency").click();
    harness.run_steps(5);
    assert!(api.0.borrow().sent.contains(&Request::StartDiagnosis(without)), "{:?}", api.0.borrow().sent);
    assert!(window.current().contains("run=diagnosis-4"), "{}", window.current());
    harness.get_by_role_and_label(Role::Button, "Bring back latency").click();
    harness.run_steps(3);
    assert!(harness.query_by_label("Bring back latency").is_none());
}

#[test]
fn nothing_missing_and_nothing_fitting_are_said_as_plainly_as_a_name() {
    let sentence = "No discrepancy: the calibrated model explains these takes down to their noise.";
    let (api, window) =
        result_page(&run(JobState::Done, Some(report(Vec::new(), Verdict::NoDiscrepancy, sentence))));
    let harness = page(&api, &window);
    harness.get_by_label("NO DISCREPANCY");
    harness.get_by_label_contains("explains these takes down to their noise");
    harness.get_by_label_contains("Nothing to add");
    assert!(harness.query_by_label("Add as a new model").is_none());

    let sentence = "Something is missing that no effect of the library explains.";
    let (api, window) =
        result_page(&run(JobState::Done, Some(report(Vec::new(), Verdict::Unexplained, sentence))));
    let harness = page(&api, &window);
    harness.get_by_label("UNEXPLAINED");
    harness.get_by_label_contains("no effect of the library explains");
    harness.get_by_label_contains("repeats between repetitions more than chance");
    harness.get_by_label_contains("Quiet channels of Film wander together");
    harness.get_by_label_contains("film 12.4");
    harness.get_by_label_contains("film: film.0, film.1; no contact; take-01, take-02");
}

#[test]
fn failed_and_cancelled_runs_say_so() {
    let (api, window) = result_page(&run(JobState::Failed, None));
    let harness = page(&api, &window);
    harness.get_by_label_contains("The diagnosis failed");
    harness.get_by_label_contains("no repetition is marked");
    let (api, window) = result_page(&run(JobState::Cancelled, None));
    let harness = page(&api, &window);
    harness.get_by_label("Cancelled");
    harness.get_by_label_contains("Press Start diagnosis to run it again");
}

#[test]
fn form_says_what_the_open_run_was_asked_for() {
    let mut asked = run(JobState::Done, Some(named()));
    asked.request = DiagnosisRequest {
        model: Some("bench-fit".into()),
        max_effects: Some(3),
        without: vec!["backlash".into()],
        ..request()
    };
    let (api, window) = result_page(&asked);
    let harness = page(&api, &window);
    let start = harness.get_by_role_and_label(Role::ComboBox, "Start from");
    assert_eq!(start.value().as_deref(), Some("Bench fit"));
    harness.get_by_role_and_label(Role::Button, "Bring back backlash");
}

#[test]
fn timelines_show_real_before_and_after() {
    let api = api_with(&run(JobState::Done, Some(named())));
    let window = FakeWindow::at(
        "#/timelines/bench-1?take=take-01&model=calibrated:diagnosis-3&diagnosed=diagnosis:diagnosis-3",
    );
    let harness = page(&api, &window);
    harness.get_by_label_contains("The calibrated simulation did not arrive");
    harness.get_by_label_contains("The diagnosed simulation did not arrive");
    let asked = api.0.borrow().sent.clone();
    for model in [ModelRef::Nominal, ModelRef::Calibrated(ID.into()), ModelRef::Diagnosis(ID.into())] {
        let request = Request::Replay { session: "bench-1".into(), take: "take-01".into(), model };
        assert!(asked.contains(&request), "{asked:?}");
    }
}

fn wanted() -> WantedTake {
    WantedTake {
        object: "sphere_50mm".into(),
        primitive: "tap_two_speeds".into(),
        because: "Record taps on the sphere from both sides of joint x.".into(),
    }
}

#[test]
fn next_experiment_goes_on_the_list_and_comes_off_it() {
    let (api, window) = result_page(&run(JobState::Done, Some(named())));
    let list = |wanted: Vec<WantedTake>| RecordingDocument {
        revision: 1 + wanted.len() as u64,
        plans: Vec::new(),
        wanted,
        session: None,
        free: None,
    };
    answer(&api, &Request::Recording, &list(Vec::new()));
    answer(&api, &Request::Want(wanted()), &list(vec![wanted()]));
    let unwant = Request::Unwant { object: "sphere_50mm".into(), primitive: "tap_two_speeds".into() };
    answer(&api, &unwant, &list(Vec::new()));
    let mut harness = page(&api, &window);
    harness.get_by_role_and_label(Role::Button, "Record this next").scroll_to_me();
    harness.run_steps(4);
    harness.get_by_role_and_label(Role::Button, "Record this next").click();
    harness.run_steps(4);
    assert!(api.0.borrow().sent.contains(&Request::Want(wanted())), "{:?}", api.0.borrow().sent);
    harness.get_by_label_contains("On the list: the next session that is recorded has it.");
    harness.get_by_role_and_label(Role::Button, "Undo").click();
    harness.run_steps(4);
    assert!(api.0.borrow().sent.contains(&unwant));
    harness.get_by_role_and_label(Role::Button, "Record this next");
}

#[test]
fn next_experiment_says_why_it_cannot_be_put_on_the_list() {
    let (api, window) = result_page(&run(JobState::Done, Some(named())));
    answer(&api, &Request::Info, &without_station());
    let harness = page(&api, &window);
    let button = harness.get_by_role_and_label(Role::Button, "Record this next");
    assert!(button.accesskit_node().is_disabled());
    harness.get_by_label_contains("No station is live");

    // The station refuses: no plan of it has the motion.
    let (api, window) = result_page(&run(JobState::Done, Some(named())));
    let empty =
        RecordingDocument { revision: 1, plans: Vec::new(), wanted: Vec::new(), session: None, free: None };
    answer(&api, &Request::Recording, &empty);
    let mut harness = page(&api, &window);
    harness.get_by_role_and_label(Role::Button, "Record this next").scroll_to_me();
    harness.run_steps(4);
    harness.get_by_role_and_label(Role::Button, "Record this next").click();
    harness.run_steps(4);
    harness.get_by_label_contains("The list was not changed: nothing at POST /api/v1/recording/wanted");
}

#[test]
fn nothing_of_a_full_report_reaches_beyond_a_narrow_window() {
    // From a saved model with a long name, which is a heading of the table.
    let from = DiagnosisRequest { model: Some("bench-fit".into()), ..request() };
    for width in [360.0, 390.0, 900.0, 1280.0] {
        let at = FakeWindow::at(&format!("#/diagnose/bench-1?run={ID}"));
        let mut harness = page_of(&finished(from.clone(), full()), &at, [width, 844.0]);
        for name in ["latency, stream film", "joint backlash, joint x", "electrical crosstalk"] {
            let button = format!("Evidence for {name}");
            harness.get_by_label_contains(&button).scroll_to_me();
            harness.run_steps(20);
            harness.get_by_label_contains(&button).click();
            harness.run_steps(4);
        }
        assert_eq!(harness.query_all_by_label_contains("Takes that it improves").count(), 3, "{width}");
        let beyond: Vec<_> = harness
            .query_all_by_label_contains("")
            .filter(|node| node.rect().right() > width + 0.5)
            .map(|node| (node.accesskit_node().label(), node.rect()))
            .collect();
        assert!(beyond.is_empty(), "{width}: {beyond:#?}");
        // What is said stands on the page from its first line to its last.
        let lead = harness.get_by_label_contains("Three effects are missing from the simulator").rect();
        assert!(lead.width() > 0.5 * (width - 80.0).min(300.0), "{width}: {lead:?}");
    }
}

/// A page with a finished diagnosis, asked for with `request`.
fn finished(request: DiagnosisRequest, report: DiagnosisReport) -> SharedApi {
    let api = full_api();
    let run = DiagnosisRun { request, ..run(JobState::Done, Some(report)) };
    let body = serde_json::to_vec(&run).expect("a run is plain data");
    api.0.borrow_mut().answer(&Request::Diagnosis(ID.into()), body);
    api
}

#[test]
fn a_saved_model_that_it_started_from_is_not_called_nominal() {
    let at = FakeWindow::at(&format!("#/diagnose/bench-1?run={ID}"));
    let from = DiagnosisRequest { model: Some("bench-fit".into()), ..request() };
    let harness = page(&finished(from, named()), &at);
    harness.get_by_label_contains("at the start (Bench fit) 0.9");
    harness.get_by_label_contains("Start: Bench fit: gap");
    harness.get_by_label("Start: Bench fit");
    assert!(harness.query_by_label_contains("nominal 0.9").is_none());
    let harness = page(&finished(request(), named()), &at);
    harness.get_by_label_contains("nominal 0.9");
    harness.get_by_label("Nominal");
}

#[test]
fn effects_that_help_too_little_stand_apart_and_are_not_ticked() {
    let useless = NamedEffect { gap_before: 0.30, gap_after: 0.31, ..backlash() };
    let rare = NamedEffect { id: "low_pass".into(), takes_improved: "1/3".into(), ..latency() };
    let report =
        report(vec![useless, latency(), rare], Verdict::PartlyExplained, "Three effects are missing.");
    let at = FakeWindow::at(&format!("#/diagnose/bench-1?run={ID}"));
    // Tall, so that all of them are in sight.
    let mut harness = page_of(&finished(request(), report), &at, [1280.0, 1600.0]);
    harness.get_by_label_contains("1 of 3 named effects ticked");
    let weak = harness.get_by_label("Weak, not ticked").rect();
    let tick = |name: &str| harness.get_by_role_and_label(Role::CheckBox, name).rect();
    assert!(tick("Add latency, stream film").bottom() < weak.top());
    assert!(tick("Add joint backlash, joint x").top() > weak.bottom());
    harness.get_by_role_and_label(Role::CheckBox, "Add joint backlash, joint x").click();
    harness.run_steps(3);
    harness.get_by_label_contains("2 of 3 named effects ticked");
}

#[test]
fn parts_within_chance_are_counted_and_not_listed() {
    let mut report = named();
    report.unexplained.cells = vec![cell("onset", 0.2), Cell { p_value: 0.897, ..cell("release", 0.1) }];
    let at = FakeWindow::at(&format!("#/diagnose/bench-1?run={ID}"));
    let harness = page(&finished(request(), report), &at);
    harness.get_by_label_contains("1 part within chance left out.");
    assert!(harness.query_by_label_contains("0.897").is_none());
}

#[test]
fn the_form_is_copied_with_every_choice() {
    let mut harness = page(&full_api(), &FakeWindow::at("#/diagnose/bench-1"));
    harness.get_by_label("Set the bar on 200 simulated sessions first").click();
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::Button, "Copy as command line").click();
    let copied = crate::fixture::copied(&mut harness);
    let command = "palpate diagnose --session data/sessions/bench-1 --data data --null-bar 200";
    assert_eq!(copied.as_deref(), Some(command));
}

#[test]
fn reference_sessions_are_of_the_same_station_and_three_or_none() {
    let api = full_api();
    let other = |id: &str, station: &str| SessionSummary {
        id: id.into(),
        station: station.into(),
        ..crate::fixture::summary()
    };
    let good = ["good-1", "good-2", "good-3"];
    let mut sessions = vec![crate::fixture::summary(), other("elsewhere", "another-bench")];
    sessions.extend(good.map(|id| other(id, "probe-bench")));
    let listed = serde_json::to_vec(&sessions).expect("sessions are plain data");
    api.0.borrow_mut().answer(&Request::Sessions, listed);
    let mut harness = page_of(&api, &FakeWindow::at("#/diagnose/bench-1"), [1280.0, 1600.0]);
    harness.get_by_label("Reference sessions: none").click();
    harness.run_steps(20);
    assert!(harness.query_by_role_and_label(Role::CheckBox, "elsewhere").is_none(), "of another station");
    assert!(harness.query_by_role_and_label(Role::CheckBox, "bench-1").is_none(), "of itself");
    harness.get_by_role_and_label(Role::CheckBox, "good-1").click();
    harness.run_steps(3);
    harness.get_by_label_contains("Tick at least 3 reference sessions, or none.");
    for id in &good[1..] {
        harness.get_by_role_and_label(Role::CheckBox, id).click();
        harness.run_steps(3);
    }
    harness.get_by_label("Reference sessions: 3");
    assert!(harness.query_by_label_contains("Tick at least 3").is_none());
    harness.get_by_role_and_label(Role::Button, "Copy as command line").click();
    let copied = crate::fixture::copied(&mut harness);
    let command = "palpate diagnose --session data/sessions/bench-1 --data data --reference data/sessions/good-1 --reference \
        data/sessions/good-2 --reference data/sessions/good-3";
    assert_eq!(copied.as_deref(), Some(command));
}

#[test]
fn channels_have_their_names_in_the_bars_too() {
    let bench = station();
    let channel = bench.layout.num_channels() - 1;
    let mut report = named();
    report.candidates[0].place = Place::Channel(bench.layout.channels[channel].id.clone());
    let (api, window) = result_page(&run(JobState::Done, Some(report)));
    let mut harness = page(&api, &window);
    harness.run_steps(5);
    harness.get_by_label_contains(&format!("channel {}: evidence", bench.layout.channel_label(channel)));
}

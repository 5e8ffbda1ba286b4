//! Choose, run, see, keep: a calibration as an operator meets it.

use std::collections::BTreeMap;

use base64::Engine as _;
use egui::accesskit::Role;
use egui_kittest::kittest::Queryable as _;
use palpate_reports::{
    CalibrationReport, HeldOut, Intervals, MetricIntervals, Metrics, MetricsPair, Objective, StreamFit,
    StreamThetaReport, TakeMetrics, ThetaReport,
};
use palpate_ui::{
    api_client::{ApiEvent, Request},
    playback::ModelRef,
};
use palpate_wire::{
    api::{CalibrationRequest, CalibrationRun, JobState, StationDocument},
    proto::{JobUpdate, StreamMessage, stream_message},
};
use prost::Message as _;

use crate::fixture::{FakeWindow, SharedApi, app, deliver, full_api, page, page_of, station};

fn metrics(onset_error_ms: f64, f1: f64) -> Metrics {
    Metrics { onset_error_ms: Some(onset_error_ms), f1: Some(f1), fpr: Some(0.042), ..Metrics::default() }
}

pub(crate) fn run(state: JobState) -> CalibrationRun {
    let (nominal, calibrated) = (metrics(231.4, 0.642), metrics(88.2, 0.781));
    let theta = |lambda_con_m| ThetaReport { lambda_con_m, alpha_per_m: 120.0, lambda_pre_pa: 300.0 };
    let pair = MetricsPair { nominal: nominal.clone(), calibrated: calibrated.clone() };
    let take = TakeMetrics { nominal: nominal.clone(), calibrated: calibrated.clone(), held_out: true };
    let report = CalibrationReport {
        nominal: nominal.clone(),
        calibrated: calibrated.clone(),
        held_out: HeldOut { nominal, calibrated },
        theta: theta(0.001),
        nominal_theta: theta(0.004),
        streams: BTreeMap::new(),
        frames: 400,
        channels: 15,
        evaluations: 1234,
        seconds: 0.05,
        method: "exact".into(),
        by_modality: BTreeMap::from([("pad".to_owned(), pair.clone())]),
        by_take: BTreeMap::from([("take-02".to_owned(), take)]),
        by_channel: BTreeMap::from([("pad.0".to_owned(), pair)]),
        intervals_95: None,
        objective: Objective {
            alphas_per_m: vec![50.0, 120.0],
            lambda_pres_pa: vec![100.0, 300.0, 900.0],
            pressure_l1: vec![vec![9, 7, 8], vec![6, 2, 5]],
            lambda_cons_m: vec![0.0, 0.001, 0.002],
            proximity_l1: vec![5, 1, 4],
        },
        held_out_takes: vec!["take-02".into()],
        notes: vec!["the optimum of alpha lies at the end of its range".into()],
    };
    CalibrationRun {
        id: "run-7".into(),
        request: CalibrationRequest {
            session: "bench-1".into(),
            method: Some("exact".into()),
            hold_out: None,
            shared_theta: false,
        },
        state,
        fraction: if state == JobState::Done { 1.0 } else { 0.25 },
        stage: "replaying take-01".into(),
        seconds_left: Some(3.0),
        error: (state == JobState::Failed).then(|| "take-01: no real contact".to_owned()),
        report: (state == JobState::Done).then_some(report),
        model_toml: None,
        saved_as: None,
    }
}

pub(crate) fn answer(api: &SharedApi, request: &Request, run: &CalibrationRun) {
    api.0.borrow_mut().answer(request, serde_json::to_vec(run).expect("a run is plain data"));
}

fn start_request() -> Request {
    Request::StartRun(CalibrationRequest {
        session: "bench-1".into(),
        method: Some("exact".into()),
        hold_out: None,
        shared_theta: false,
    })
}

#[test]
fn button_starts_a_run_and_the_result_leads_with_a_sentence() {
    let api = full_api();
    answer(&api, &start_request(), &run(JobState::Running));
    answer(&api, &Request::Run("run-7".into()), &run(JobState::Done));
    let window = FakeWindow::at("#/calibrate/bench-1");
    let mut harness = page(&api, &window);

    harness.get_by_role_and_label(Role::Button, "Start calibration").click();
    harness.run_steps(4);
    assert!(api.0.borrow().sent.contains(&start_request()), "{:?}", api.0.borrow().sent);
    harness.get_by_label_contains("25 %, 3.0 s left");
    harness.get_by_role_and_label(Role::Button, "Cancel");

    let update =
        JobUpdate { job: "run-7".into(), state: "done".into(), fraction: 1.0, ..JobUpdate::default() };
    let message = StreamMessage { message: Some(stream_message::Message::Job(update)), dropped: 0 };
    deliver(&api, [ApiEvent::SocketMessage(message.encode_to_vec())]);
    harness.run_steps(6);
    harness.get_by_label_contains("onset error from 231 to 88 ms, F1 from 0.64 to 0.78");
    harness.get_by_label_contains("the optimum of alpha lies at the end of its range");
    harness.get_by_label_contains("optimum at 1.00 mm");
    assert!(window.current().contains("run=run-7"), "{}", window.current());
    assert_eq!(app(&harness).playback.compared, Some(ModelRef::Run("run-7".into())));

    harness.get_by_role_and_label(Role::Button, "Save model").click();
    harness.run_steps(3);
    let sent = api.0.borrow().sent.clone();
    assert!(
        sent.iter().any(|request| matches!(request, Request::SaveModel { run, .. } if run == "run-7")),
        "{sent:?}"
    );
}

/// Makes one of the films a stream of its own.
fn two_skins(api: &SharedApi) {
    let files = station().files;
    let of_films = |text: &str| {
        let (before, last) = text.rsplit_once("stream = \"film\"").expect("the layout has films");
        format!(
            "{before}stream = \"rim\"{last}\n[[stream]]\nid = \"rim\"\nlabel = \"Rim\"\nkind = \"proximity\"\nrate_hz = 50.0\n\
             raw_unit = \"mV\"\n"
        )
    };
    let files_base64 = files.files.iter().map(|(path, bytes)| {
        let bytes = if path.ends_with("probe_pad_15.toml") {
            of_films(std::str::from_utf8(bytes).expect("a layout is text")).into_bytes()
        } else {
            bytes.clone()
        };
        (path.clone(), base64::engine::general_purpose::STANDARD.encode(bytes))
    });
    let more = "\n[[stream]]\nstream = \"rim\"\non_threshold = 250.0\noff_threshold = 180.0\nraw_min = 0.0\nraw_max = 3300.0\n";
    let document = StationDocument {
        station_toml: format!("{}{more}", files.station_toml),
        files_base64: files_base64.collect(),
    };
    let document = serde_json::to_vec(&document).expect("a document is plain data");
    api.0.borrow_mut().answer(&Request::Station("bench-1".into()), document);
}

#[test]
fn one_theta_for_all_is_a_choice_where_a_layout_has_streams_of_a_kind() {
    const LABEL: &str = "One theta for all streams of a kind";
    let window = FakeWindow::at("#/calibrate/bench-1");
    let mut harness = page(&full_api(), &window);
    harness.run_steps(4);
    assert!(harness.query_by_role_and_label(Role::CheckBox, LABEL).is_none(), "one stream of each kind");

    let api = full_api();
    two_skins(&api);
    let mut harness = page(&api, &window);
    harness.run_steps(4);
    harness.get_by_role_and_label(Role::CheckBox, LABEL).click();
    harness.run_steps(2);
    harness.get_by_role_and_label(Role::Button, "Start calibration").click();
    harness.run_steps(4);
    let sent = &api.0.borrow().sent;
    let shared = sent.iter().any(
        |request| matches!(request, Request::StartRun(request) if request.shared_theta && request.session == "bench-1"),
    );
    assert!(shared, "{sent:?}");
}

#[test]
fn a_result_with_a_theta_for_each_stream_has_a_row_and_a_picture_for_each() {
    let api = full_api();
    let mut done = run(JobState::Done);
    let report = done.report.as_mut().expect("it is done");
    let whole = std::mem::take(&mut report.objective);
    let pressure = |alpha_per_m| StreamThetaReport {
        alpha_per_m: Some(alpha_per_m),
        lambda_pre_pa: Some(300.0),
        ..StreamThetaReport::default()
    };
    let near =
        |lambda_con_m| StreamThetaReport { lambda_con_m: Some(lambda_con_m), ..StreamThetaReport::default() };
    let of_pressure = Objective { lambda_cons_m: Vec::new(), proximity_l1: Vec::new(), ..whole.clone() };
    let fits = [
        ("gel", pressure(77.0), pressure(50.0), of_pressure.clone()),
        ("skin", pressure(120.0), pressure(50.0), of_pressure),
        ("fsr", near(0.001), near(0.004), whole),
    ];
    report.streams = fits
        .map(|(id, theta, nominal_theta, objective)| {
            (id.to_owned(), StreamFit { theta, nominal_theta, objective })
        })
        .into();
    answer(&api, &start_request(), &done);
    answer(&api, &Request::Run("run-7".into()), &done);
    let mut harness = page(&api, &FakeWindow::at("#/calibrate/bench-1?run=run-7"));
    harness.run_steps(6);
    harness.get_by_label_contains("Each stream has its own parameters");
    harness.get_by_label("77.0 (was 50.0)");
    harness.get_by_label_contains("lambda_pre, gel; optimum at alpha 77 per m");
    harness.get_by_label_contains("lambda_pre, skin; optimum at alpha 120 per m");
    harness.get_by_label_contains("lambda_con, fsr; optimum at 1.00 mm");
}

#[test]
fn last_result_is_one_click_away() {
    let api = full_api();
    let runs = [run(JobState::Failed), CalibrationRun { id: "run-6".into(), ..run(JobState::Done) }];
    api.0.borrow_mut().answer(&Request::Runs, serde_json::to_vec(&runs).expect("runs are plain data"));
    answer(
        &api,
        &Request::Run("run-6".into()),
        &CalibrationRun { id: "run-6".into(), ..run(JobState::Done) },
    );
    let window = FakeWindow::at("#/calibrate/bench-1");
    let mut harness = page(&api, &window);
    harness.get_by_role_and_label(Role::Button, "Show the last result (run-6)").click();
    harness.run_steps(4);
    harness.get_by_label_contains("Calibrated: onset error from 231 to 88 ms");
}

#[test]
fn failed_run_says_why() {
    let api = full_api();
    answer(&api, &Request::Run("run-7".into()), &run(JobState::Failed));
    let harness = page(&api, &FakeWindow::at("#/calibrate/bench-1?run=run-7"));
    harness.get_by_label_contains("The calibration failed");
    harness.get_by_label_contains("take-01: no real contact");
}

#[test]
fn empty_choice_of_held_out_takes_is_refused_before_anything_runs() {
    let api = full_api();
    let mut harness = page(&api, &FakeWindow::at("#/calibrate/bench-1"));
    harness.get_by_label_contains("Choose for me").click();
    harness.run_steps(3);
    harness.get_by_label_contains("Tick at least one take");
    harness.get_by_label_contains("take-02: tap").click();
    harness.run_steps(3);
    assert!(harness.query_by_label_contains("Tick at least one take").is_none());
    harness.get_by_label_contains("take-01: tap").click();
    harness.run_steps(3);
    harness.get_by_label_contains("Leave at least one take");
}

/// A run that made one metric worse and left one within chance.
fn worse() -> CalibrationRun {
    let mut worse = run(JobState::Done);
    let report = worse.report.as_mut().expect("it is done");
    report.held_out.nominal.offset_error_ms = Some(425.0);
    report.held_out.calibrated.offset_error_ms = Some(445.0);
    report.held_out.calibrated.fpr = Some(0.045);
    let of_one_model =
        MetricIntervals { offset_error_ms: Some([380.0, 512.0]), ..MetricIntervals::default() };
    report.intervals_95 = Some(Intervals {
        nominal: of_one_model.clone(),
        calibrated: of_one_model,
        change: MetricIntervals {
            onset_error_ms: Some([-160.0, -120.0]),
            offset_error_ms: Some([-30.0, 71.0]),
            f1: Some([0.1, 0.2]),
            fpr: Some([0.001, 0.004]),
        },
        resamples: 100,
        seed: 0,
    });
    worse
}

#[test]
fn no_metric_reaches_beyond_a_narrow_window() {
    let api = full_api();
    answer(&api, &Request::Run("run-7".into()), &worse());
    for width in [360.0, 390.0, 900.0, 1280.0] {
        let at = FakeWindow::at("#/calibrate/bench-1?run=run-7");
        let harness = page_of(&api, &at, [width, 844.0]);
        for (text, count) in [("no clear difference", 1), ("380 to 512", 2), ("False positive rate, %", 1)] {
            let found: Vec<_> = harness.query_all_by_label_contains(text).map(|node| node.rect()).collect();
            assert_eq!(found.len(), count, "{width}: {text}");
            assert!(found.iter().all(|rect| rect.right() < width), "{width}: {text} {found:?}");
        }
    }
}

#[test]
fn the_headline_says_what_got_worse_and_what_is_within_chance() {
    let api = full_api();
    answer(&api, &Request::Run("run-7".into()), &worse());
    let harness = page(&api, &FakeWindow::at("#/calibrate/bench-1?run=run-7"));
    harness.get_by_label_contains(
        "on takes it has not seen. Worse: false positives (4.20 to 4.50 %). No clear difference: release timing (425 to \
         445 ms).",
    );
    for (word, count) in [("better", 2), ("worse", 1), ("no clear difference", 1)] {
        assert_eq!(harness.query_all_by_label(word).count(), count, "{word}");
    }
}

#[test]
fn what_the_form_asks_for_can_be_copied() {
    let mut harness = page(&full_api(), &FakeWindow::at("#/calibrate/bench-1"));
    for (name, has) in [
        ("curl", r#"-d '{"session":"bench-1","method":"exact","hold_out":null}'"#),
        ("Python", r#"p.calibrate("bench-1", method="exact")"#),
        ("command line", "palpate calibrate --session data/sessions/bench-1 --method exact"),
    ] {
        harness.get_by_role_and_label(Role::Button, &format!("Copy as {name}")).click();
        let copied = crate::fixture::copied(&mut harness);
        assert!(copied.as_deref().is_some_and(|text| text.contains(has)), "{name}: {copied:?}");
    }
}

//! The job on whole sessions: what it finds, what it refuses, and that it is the same every time.

use std::sync::Mutex;

use palpate_calibration::{
    CalibrationConfig, CalibrationError, CalibrationOutcome, HoldOut, Method, PairedTake, calibrate,
    report::ReportSource,
};
use palpate_robot_model::{SensorKind, Stream, TactileLayout};
use palpate_sim::job::{Cancel, NoProgress, Progress};
use palpate_sim::{SensorModel, StreamTheta, Theta};

use crate::synthetic::{self, Size};

fn session() -> (TactileLayout, Vec<PairedTake>) {
    let layout = synthetic::layout(crate::SMALL);
    let takes = synthetic::takes(crate::SMALL, &layout, 3);
    (layout, takes)
}

fn run(
    config: &CalibrationConfig,
    layout: &TactileLayout,
    takes: &[PairedTake],
) -> Result<CalibrationOutcome, CalibrationError> {
    calibrate(config, layout, &crate::nominal(), takes, &NoProgress, &Cancel::default(), &|| 0.0)
}

fn refusal(config: &CalibrationConfig, layout: &TactileLayout, takes: &[PairedTake]) -> String {
    run(config, layout, takes).expect_err("cannot be calibrated").to_string()
}

#[test]
fn calibrated_beats_nominal_on_takes_it_has_not_seen() {
    let (layout, takes) = session();
    for method in [Method::Exact, Method::Grid] {
        let config = CalibrationConfig { method, ..CalibrationConfig::default() };
        let report = run(&config, &layout, &takes).expect("a sound session").report;
        assert_eq!(report.held_out_takes, ["take-03", "take-04"]);
        let (before, after) = (&report.held_out.nominal, &report.held_out.calibrated);
        assert!(after.l1 < before.l1, "{method:?}: {} -> {}", before.l1, after.l1);
        assert!(after.f1 > before.f1 && after.fpr < before.fpr, "{method:?}: {before:?} {after:?}");
        assert!(after.onset_error_ms < before.onset_error_ms, "{method:?}: {before:?} {after:?}");
        assert!(after.onset_coverage > Some(0.8), "{method:?}: {after:?}");
    }
}

#[test]
fn exact_fit_is_at_least_as_good_as_the_grid_and_the_nominal_model() {
    let (layout, takes) = session();
    let fitted_l1 = |method| {
        let config = CalibrationConfig {
            method,
            hold_out: HoldOut::Takes(Vec::new()),
            ..CalibrationConfig::default()
        };
        let report = run(&config, &layout, &takes).expect("a sound session").report;
        (report.calibrated.l1, report.nominal.l1)
    };
    let (exact, nominal) = fitted_l1(Method::Exact);
    let (grid, _) = fitted_l1(Method::Grid);
    assert!(exact <= grid && exact <= nominal, "exact {exact}, grid {grid}, nominal {nominal}");
}

#[test]
fn a_model_with_effects_is_not_calibrated_as_if_it_had_none() {
    let (layout, takes) = session();
    let mut model = crate::nominal();
    model.effects.push(palpate_sim::effects::Effect {
        id: "latency".to_owned(),
        place: palpate_robot_model::Place::Stream("gel".to_owned()),
        parameters: [("delay_s".to_owned(), 0.1)].into(),
        interval: [].into(),
        takes: Vec::new(),
    });
    let config = CalibrationConfig::default();
    let refused = calibrate(&config, &layout, &model, &takes, &NoProgress, &Cancel::default(), &|| 0.0);
    let message = refused.expect_err("effects would be ignored").to_string();
    assert!(
        message.contains("has effects (latency), beside which theta cannot be calibrated alone"),
        "{message}"
    );
}

#[test]
fn parts_of_the_report_add_up() {
    let (layout, takes) = session();
    let outcome = run(&CalibrationConfig::default(), &layout, &takes).expect("a sound session");
    let report = &outcome.report;
    let by_modality: u64 = report.by_modality.values().map(|pair| pair.calibrated.l1).sum();
    let by_take: u64 = report.by_take.values().map(|take| take.calibrated.l1).sum();
    let by_channel: u64 = report.by_channel.values().map(|pair| pair.calibrated.l1).sum();
    assert_eq!([by_modality, by_take, by_channel], [report.calibrated.l1; 3]);
    assert_eq!((report.frames, report.channels), (6 * 120, 9));
    assert!(report.by_take["take-03"].held_out);
    assert_eq!(outcome.timelines.len(), 6);
    assert_eq!(outcome.model.theta.lambda_pre_pa, report.theta.lambda_pre_pa);
    let rows = report.objective.pressure_l1.len();
    assert_eq!((rows, report.objective.alphas_per_m.len()), (20, 20));
    assert!(
        report.objective.pressure_l1.iter().all(|row| row.len() == report.objective.lambda_pres_pa.len())
    );
    assert_eq!(report.objective.proximity_l1.len(), report.objective.lambda_cons_m.len());
    let intervals = report.intervals_95.as_ref().expect("two held-out takes");
    let [low, high] = intervals.calibrated.f1.expect("contacts");
    let f1 = report.held_out.calibrated.f1.expect("contacts");
    assert!(low <= f1 && f1 <= high);
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let (layout, takes) = session();
    for method in [Method::Exact, Method::Grid] {
        let config = CalibrationConfig { method, ..CalibrationConfig::default() };
        let outcomes = [1, 2, 7].map(|num_threads| {
            let pool =
                rayon::ThreadPoolBuilder::new().num_threads(num_threads).build().expect("a thread pool");
            pool.install(|| run(&config, &layout, &takes)).expect("a sound session")
        });
        for other in &outcomes[1..] {
            assert_eq!(outcomes[0].report, other.report);
            assert_eq!(outcomes[0].model, other.model);
        }
    }
}

#[test]
fn cancelled_job_stops() {
    let (layout, takes) = session();
    let cancel = Cancel::default();
    cancel.cancel();
    let result = calibrate(
        &CalibrationConfig::default(),
        &layout,
        &crate::nominal(),
        &takes,
        &NoProgress,
        &cancel,
        &|| 0.0,
    );
    assert!(matches!(result, Err(CalibrationError::Cancelled)));
}

#[test]
fn progress_says_what_is_tried_and_reaches_the_end() {
    #[derive(Default)]
    struct Log(Mutex<Vec<(f64, String)>>);
    impl Progress for Log {
        fn report(&self, fraction: f64, stage: &str) {
            self.0.lock().expect("not poisoned").push((fraction, stage.to_owned()));
        }
    }
    let (layout, takes) = session();
    let log = Log::default();
    let nominal = crate::nominal();
    calibrate(&CalibrationConfig::default(), &layout, &nominal, &takes, &log, &Cancel::default(), &|| 0.0)
        .expect("a sound session");
    let reports = log.0.into_inner().expect("not poisoned");
    assert!(reports.iter().all(|&(fraction, _)| (0.0..=1.0).contains(&fraction)));
    assert!(reports.iter().any(|(_, stage)| stage.contains("alpha")));
    assert_eq!(reports.last().map(|&(fraction, _)| fraction), Some(1.0));
}

#[test]
fn modality_without_contact_keeps_its_nominal_parameters_and_says_so() {
    let (layout, mut takes) = session();
    let num_channels = layout.num_channels();
    let proximity =
        layout.streams.iter().find(|s| s.kind == SensorKind::Proximity).expect("patches").channels.clone();
    for take in &mut takes {
        for frame in take.real_active.chunks_exact_mut(num_channels) {
            frame[proximity.clone()].fill(false);
        }
    }
    let report = run(&CalibrationConfig::default(), &layout, &takes).expect("pads are touched").report;
    assert_eq!(report.theta.lambda_con_m, report.nominal_theta.lambda_con_m);
    assert_ne!(report.theta.lambda_pre_pa, report.nominal_theta.lambda_pre_pa);
    assert!(report.notes.iter().any(|note| note.contains("lambda_con stays nominal")), "{:?}", report.notes);
}

/// [`synthetic::layout`] with the second half of its pads, and of its patches, as streams of their own.
fn of_two_skins(size: Size) -> TactileLayout {
    let mut layout = synthetic::layout(size);
    let [pads, patches] = [size.pads.div_ceil(2) * size.taxels_per_pad, size.patches.div_ceil(2)];
    let num_pad_channels = size.pads * size.taxels_per_pad;
    let bounds = [0, pads, num_pad_channels, num_pad_channels + patches, layout.channels.len()];
    let old = layout.streams.clone();
    layout.streams = (0..4)
        .map(|idx| Stream {
            id: format!("{}{}", old[idx / 2].id, ["_a", "_b"][idx % 2]),
            channels: bounds[idx]..bounds[idx + 1],
            ..old[idx / 2].clone()
        })
        .collect();
    let of = |channel: usize| (0..4).rposition(|idx| bounds[idx] <= channel).expect("one");
    layout.channels.iter_mut().enumerate().for_each(|(idx, channel)| channel.stream = of(idx));
    layout.patches.iter_mut().for_each(|patch| patch.stream = of(patch.channels.start));
    layout
}

/// Two skins of each kind, and takes of which every activation is that of a model with a theta for each. Light touches that
/// every node sees alike would tell nothing of alpha.
fn two_skins() -> (TactileLayout, Vec<PairedTake>, SensorModel) {
    let layout = of_two_skins(crate::SMALL);
    let mut truth = crate::nominal();
    for (stream, (lambda_con_m, alpha_per_m, lambda_pre_pa)) in layout.streams.iter().zip([
        (0.0, 120.0, 6000.0),
        (0.0, 250.0, 2500.0),
        (4e-3, 0.0, 0.0),
        (-2e-4, 0.0, 0.0),
    ]) {
        let theta = StreamTheta::of_kind(stream.kind, &Theta { lambda_con_m, alpha_per_m, lambda_pre_pa });
        truth.streams.insert(stream.id.clone(), theta);
    }
    let mut takes = synthetic::takes(Size { frames_per_take: 900, ..crate::SMALL }, &layout, 3);
    for take in &mut takes {
        take.real_active = palpate_sim::tactile::readings(&layout, &take.contact, &truth.thetas()).active;
    }
    (layout, takes, truth)
}

#[test]
fn each_of_two_skins_gets_the_theta_that_made_its_takes() {
    let (layout, takes, truth) = two_skins();
    let outcome = run(&CalibrationConfig::default(), &layout, &takes).expect("a sound session");
    let (report, model) = (&outcome.report, &outcome.model);
    // Nearly every activation is explained, also on takes that the fit has not seen.
    assert!(report.held_out.calibrated.f1 > Some(0.97), "{:?}", report.held_out.calibrated);
    assert_eq!(model.theta, crate::nominal().theta);
    assert_eq!(model.streams.keys().collect::<Vec<_>>(), truth.streams.keys().collect::<Vec<_>>());
    for (id, found) in &model.streams {
        let truth = truth.streams[id];
        let near = |found: Option<f64>, truth: Option<f64>, slack: f64| match (found, truth) {
            (Some(found), Some(truth)) => (found - truth).abs() <= slack,
            (found, truth) => found == truth,
        };
        assert!(near(found.lambda_con_m, truth.lambda_con_m, 1.5e-3), "{id}: {found:?} of {truth:?}");
        assert!(
            near(found.alpha_per_m, truth.alpha_per_m, 0.4 * truth.alpha_per_m.unwrap_or(0.0)),
            "{id}: {found:?} of {truth:?}"
        );
        assert!(
            near(found.lambda_pre_pa, truth.lambda_pre_pa, 0.5 * truth.lambda_pre_pa.unwrap_or(0.0)),
            "{id}: {found:?} of {truth:?}"
        );
        assert_eq!(report.streams[id].theta.alpha_per_m, found.alpha_per_m);
        assert!(
            !report.streams[id].objective.pressure_l1.is_empty()
                || !report.streams[id].objective.proximity_l1.is_empty()
        );
    }
    let source = ReportSource { session: "s", station: "t", created: "" };
    let page = palpate_calibration::report::html(source, &outcome);
    assert!(page.contains("L1 of the pressure channels of stream pad_b"), "{}", page.len());
    assert!(
        page.contains("<tr><td>patch_a</td><td><span class=\"was\">8.000</span>"),
        "a row for each stream"
    );

    // One theta for all explains less.
    let config = CalibrationConfig { shared_theta: true, ..CalibrationConfig::default() };
    let shared = run(&config, &layout, &takes).expect("a sound session");
    assert!(shared.model.streams.is_empty() && shared.report.streams.is_empty());
    assert!(shared.report.calibrated.l1 > 2 * report.calibrated.l1, "{:?}", shared.report.calibrated);
}

#[test]
fn a_shared_theta_and_a_layout_without_rivals_have_the_bits_of_one_search() {
    let (_, mut takes, _) = two_skins();
    let (together, parted) = (synthetic::layout(crate::SMALL), of_two_skins(crate::SMALL));
    let shared_theta = |shared_theta| CalibrationConfig { shared_theta, ..CalibrationConfig::default() };
    let one = run(&shared_theta(false), &together, &takes).expect("a sound session");
    let shared = run(&shared_theta(true), &parted, &takes).expect("a sound session");
    assert_eq!(one.model, shared.model);
    assert_eq!(one.report.objective, shared.report.objective);
    assert_eq!(one.report.by_channel, shared.report.by_channel);

    // What the file says of the only stream of its kind is where the search starts, as if it were the shared one.
    let mut nominal = crate::nominal();
    let alone = crate::nominal().theta;
    nominal.theta.lambda_con_m = 0.01;
    nominal.streams.insert("patch".to_owned(), StreamTheta::of_kind(SensorKind::Proximity, &alone));
    takes
        .iter_mut()
        .for_each(|take| take.real_active.chunks_exact_mut(9).for_each(|real| real[6..].fill(false)));
    let config = CalibrationConfig::default();
    let kept = calibrate(&config, &together, &nominal, &takes, &NoProgress, &Cancel::default(), &|| 0.0);
    assert_eq!(kept.expect("a sound session").model.theta.lambda_con_m, alone.lambda_con_m);
}

#[test]
fn parameters_of_streams_that_cannot_be_kept_are_refused() {
    let (layout, takes, truth) = two_skins();
    let refused = |config: &CalibrationConfig, nominal: &SensorModel| {
        let refused = calibrate(config, &layout, nominal, &takes, &NoProgress, &Cancel::default(), &|| 0.0);
        refused.expect_err("cannot be calibrated").to_string()
    };
    let shared = CalibrationConfig { shared_theta: true, ..CalibrationConfig::default() };
    let message = refused(&shared, &truth);
    assert!(
        message.contains("has parameters of their own for streams (pad_a, pad_b, patch_a, patch_b)"),
        "{message}"
    );
    let mut strange = truth;
    strange
        .streams
        .insert("tongue".to_owned(), StreamTheta { alpha_per_m: Some(1.0), ..StreamTheta::default() });
    let message = refused(&CalibrationConfig::default(), &strange);
    assert!(message.contains("stream.tongue: layout \"made up\" has no such stream"), "{message}");
}

#[test]
fn session_without_frames_is_refused() {
    let (layout, _) = session();
    let err = refusal(&CalibrationConfig::default(), &layout, &[]);
    assert_eq!(err, "nothing to fit: the session has no accepted take with frames; record or accept one");
}

#[test]
fn session_without_real_contact_is_refused() {
    let (layout, mut takes) = session();
    takes.iter_mut().for_each(|take| take.real_active.fill(false));
    let err = refusal(&CalibrationConfig::default(), &layout, &takes);
    assert!(
        err.starts_with("no real contact in the takes to fit (take-01, take-02, take-05, take-06)"),
        "{err}"
    );
}

#[test]
fn frames_that_do_not_match_are_refused_with_the_take() {
    let (layout, mut takes) = session();
    takes[2].frame_times_s.pop();
    let err = refusal(&CalibrationConfig::default(), &layout, &takes);
    assert!(
        err.starts_with("take \"take-03\": the replay has 120 frames, but the joint log has 119"),
        "{err}"
    );

    let (_, mut takes) = session();
    takes[1].real_active.truncate(120 * 8);
    let err = refusal(&CalibrationConfig::default(), &layout, &takes);
    assert!(
        err.starts_with("take \"take-02\": 960 real activations, but 120 frames of 9 channels make 1080"),
        "{err}"
    );

    let (_, mut takes) = session();
    takes[0].frame_times_s[7] = takes[0].frame_times_s[6];
    let err = refusal(&CalibrationConfig::default(), &layout, &takes);
    assert!(err.starts_with("take \"take-01\": frame 7 is not later than the one before it"), "{err}");

    let (_, mut takes) = session();
    takes[4].frame_times_s[3] = f64::NAN;
    let err = refusal(&CalibrationConfig::default(), &layout, &takes);
    assert!(err.starts_with("take \"take-05\": frame 3 is not later"), "{err}");

    let (_, mut takes) = session();
    takes[0].contact.patches.swap(0, 4);
    let err = refusal(&CalibrationConfig::default(), &layout, &takes);
    assert!(
        err.starts_with("take \"take-01\": patch \"pad0\": replayed with another kind of sensor"),
        "{err}"
    );
}

#[test]
fn two_takes_of_one_name_are_refused() {
    let (layout, mut takes) = session();
    takes[3].id = "take-01".to_owned();
    let err = refusal(&CalibrationConfig::default(), &layout, &takes);
    assert_eq!(err, "two takes are called \"take-01\"; rename one");
}

#[test]
fn search_of_a_single_value_is_refused() {
    let (layout, takes) = session();
    let config = CalibrationConfig { num_lambdas: 1, ..CalibrationConfig::default() };
    let err = refusal(&config, &layout, &takes);
    assert_eq!(err, "a search needs at least 2 values of alpha and of each lambda, not 20 and 1");
}

#[test]
fn layout_with_one_kind_of_sensor_calibrates() {
    let size = Size { patches: 0, ..crate::SMALL };
    let layout = synthetic::layout(size);
    let takes = synthetic::takes(size, &layout, 5);
    let report = run(&CalibrationConfig::default(), &layout, &takes).expect("pads are touched").report;
    assert_eq!(report.theta.lambda_con_m, report.nominal_theta.lambda_con_m);
    assert!(report.held_out.calibrated.l1 < report.held_out.nominal.l1);
    assert_eq!(report.by_modality["patch"].calibrated.f1, None);
}

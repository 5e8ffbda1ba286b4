//! Laws of every recorded session.

use palpate_recording::SpanKind;
use palpate_sim::job::{Cancel, NoProgress};
use palpate_truth::{EmulationError, record_session};
use tempfile::TempDir;

use crate::{bytes, record, shipped, takes, variant};

const ONE_TAP: &str = r#"
[[take]]
object = "sphere_50mm"
primitive = "tap"
duration_s = 19.0
touch = ["palm_heel", "index_tip.4"]
"#;

#[test]
fn same_seed_gives_the_same_bytes_for_any_number_of_threads() {
    let dir = TempDir::new().unwrap();
    let with_threads = |threads: usize, name: &str, seed| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        bytes(&pool.install(|| record(&shipped("small.toml"), &dir.path().join(name), seed)).unwrap())
    };
    let one = with_threads(1, "one", 7);
    assert_eq!(one.len(), 4, "three takes and session.toml");
    assert_eq!(one, with_threads(1, "again", 7));
    assert_eq!(one, with_threads(3, "three", 7));
    assert_ne!(one, with_threads(1, "other", 8));
}

#[test]
fn streams_have_their_rates_and_a_quiet_baseline() {
    let dir = TempDir::new().unwrap();
    let session = record(&shipped("small.toml"), &dir.path().join("s"), 1).unwrap();
    for take in takes(&session) {
        let expected = [490, 580, 660];
        let take_idx: usize = take.id.trim_start_matches("take-").parse().unwrap();
        assert_eq!(take.num_frames(), expected[take_idx - 1], "{}", take.id);
        let baseline = take.spans.iter().find(|span| span.kind == SpanKind::Baseline).unwrap();
        assert!(baseline.end_s - baseline.start_s > 1.5);
        for (stream, log) in take.station.layout.streams.iter().zip(&take.streams) {
            let rate_hz = (log.times_s.len() - 1) as f64 / (log.times_s.last().unwrap() - log.times_s[0]);
            assert!((rate_hz / stream.rate_hz - 1.0).abs() < 1e-3, "{} {}: {rate_hz} Hz", take.id, stream.id);
            assert_eq!(log.device_times_s.len(), log.times_s.len());
            let width = stream.channels.len();
            for (sample_idx, time_s) in log.times_s.iter().enumerate() {
                let active = &log.active[sample_idx * width..(sample_idx + 1) * width];
                let quiet = (baseline.start_s..baseline.end_s).contains(time_s);
                assert!(!quiet || active.iter().all(|on| !on), "{} at {time_s} s", take.id);
            }
        }
        assert!(take.streams.iter().any(|log| log.active.contains(&true)), "{} touches nothing", take.id);
    }
}

#[test]
fn repetitions_are_marked_repeat_each_other_and_touch() {
    let dir = TempDir::new().unwrap();
    let session = record(&shipped("small.toml"), &dir.path().join("s"), 1).unwrap();
    for take in takes(&session) {
        let spans: Vec<_> = take.spans.iter().filter(|span| span.kind == SpanKind::Repetition).collect();
        for span in &spans {
            let twins: Vec<_> = spans.iter().filter(|other| other.label == span.label).collect();
            assert!(twins.len() >= 2, "{}: {:?} is not repeated", take.id, span.label);
            let length_s = twins[0].end_s - twins[0].start_s;
            assert!(
                (span.end_s - span.start_s - length_s).abs() < 1e-6,
                "{:?} differs in length",
                span.label
            );
            // Something is touched, allowing for delays that reach past the end.
            let touched = take.streams.iter().zip(&take.station.layout.streams).any(|(log, stream)| {
                let width = stream.channels.len();
                log.times_s.iter().enumerate().any(|(idx, time_s)| {
                    (span.start_s..span.end_s).contains(time_s)
                        && log.active[idx * width..(idx + 1) * width].contains(&true)
                })
            });
            assert!(touched, "{}: nothing felt in {:?}", take.id, span.label);
        }
        for speed in ["slow", "fast"] {
            assert!(spans.iter().any(|span| span.label.contains(speed)), "{}: no {speed} motion", take.id);
        }
    }
}

#[test]
fn latency_delays_every_event_by_just_that_much() {
    let dir = TempDir::new().unwrap();
    let near = variant(&dir, "near.toml", ONE_TAP, &[]);
    let far = variant(&dir, "far.toml", ONE_TAP, &[("latency_s = 0.17", "latency_s = 0.22")]);
    let onsets = |truth, name| {
        let session = record(truth, &dir.path().join(name), 3).unwrap();
        let take = session.take(0).unwrap();
        let logs: Vec<Vec<f64>> = take
            .streams
            .iter()
            .zip(&take.station.layout.streams)
            .map(|(log, stream)| {
                let width = stream.channels.len();
                let on = |idx: usize| log.active[idx * width..(idx + 1) * width].contains(&true);
                (1..log.times_s.len())
                    .filter(|&idx| on(idx) && !on(idx - 1))
                    .map(|idx| log.times_s[idx])
                    .collect()
            })
            .collect();
        (logs, take.joints)
    };
    let (near, near_joints) = onsets(&near, "near");
    let (far, far_joints) = onsets(&far, "far");
    assert_eq!(near[0], far[0], "the other stream is untouched");
    assert_eq!(near_joints, far_joints);
    assert!(near[1].len() >= 4, "{near:?}");
    assert_eq!(near[1].len(), far[1].len());
    for (near_s, far_s) in near[1].iter().zip(&far[1]) {
        assert!((far_s - near_s - 0.05).abs() < 1e-6, "{near_s} {far_s}");
    }
}

#[test]
fn the_probe_bench_records_too() {
    let dir = TempDir::new().unwrap();
    let session = record(&shipped("bench.toml"), &dir.path().join("bench"), 1).unwrap();
    let report = palpate_recording::check_session(&session).unwrap();
    assert!(report.ok, "{:?}", report.problems);
    assert_eq!(report.coverage.len(), 15);
    for channel in &report.coverage {
        assert!(channel.touches >= 8, "{channel:?}");
    }
}

#[test]
fn cancelling_or_failing_leaves_nothing_behind() {
    let dir = TempDir::new().unwrap();
    let out_dir = dir.path().join("out");
    let cancel = Cancel::default();
    cancel.cancel();
    let result = record_session(&shipped("small.toml"), &out_dir, 1, &NoProgress, &cancel);
    assert!(matches!(result, Err(EmulationError::Cancelled)), "{result:?}");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);

    std::fs::create_dir(&out_dir).unwrap();
    let error = record(&shipped("small.toml"), &out_dir, 1).unwrap_err();
    assert!(error.to_string().contains("is there already"), "{error}");
    assert_eq!(std::fs::read_dir(&out_dir).unwrap().count(), 0);
}

#[test]
fn a_truth_may_hold_its_plan_itself() {
    let dir = TempDir::new().unwrap();
    let truth = variant(&dir, "named.toml", ONE_TAP, &[]);
    let named = bytes(&record(&truth, &dir.path().join("from-plan"), 4).unwrap());
    let plan = std::fs::read_to_string(dir.path().join("named.plan.toml")).unwrap();
    let primitives = plan.lines().find(|line| line.starts_with("primitives")).unwrap();
    let sections = &plan[plan.find("[motion]").unwrap()..];
    let text = std::fs::read_to_string(&truth).unwrap();
    let text = text.replace("plan = \"named.plan.toml\"", primitives);
    let own = dir.path().join("own.toml");
    std::fs::write(&own, format!("{text}\n{sections}")).unwrap();
    assert_eq!(bytes(&record(&own, &dir.path().join("from-truth"), 4).unwrap()), named);

    // Half of it here and half of it there would hide which of the two counts.
    let text = text.replace(primitives, "plan = \"named.plan.toml\"");
    std::fs::write(&own, format!("{text}\n{sections}")).unwrap();
    let error = record(&own, &dir.path().join("both"), 4).unwrap_err().to_string();
    assert!(error.contains("own.toml") && error.contains("[motion] belongs into named.plan.toml"), "{error}");
    std::fs::write(&own, text.replace("plan = \"named.plan.toml\"", "")).unwrap();
    let error = record(&own, &dir.path().join("neither"), 4).unwrap_err().to_string();
    assert!(error.contains("own.toml: plan: is missing"), "{error}");
}

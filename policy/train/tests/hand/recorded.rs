//! The take that a recorded trial became, beside what the operator of the station saw.

use std::path::Path;
use std::process::Command;

use palpate_recording::{Session, SpanKind};
use palpate_rollout::studio::Studio;
use palpate_wire::api::SessionDetail;
use serde_json::Value;

/// Checks the only take of the session in `dir`, which is that of the trial with this `outcome`.
pub(crate) fn check(palpate: &Path, url: &str, dir: &Path, outcome: &Value) {
    let recorded = &outcome["recorded"];
    assert_eq!(
        (&recorded["session"], &recorded["take"]),
        (&"grasps".into(), &"take-01".into()),
        "{recorded}"
    );
    let report =
        Command::new(palpate).args(["session", "check", "--json"]).arg(dir).output().expect("it starts");
    assert!(report.status.success(), "{}", String::from_utf8_lossy(&report.stdout));
    let report: Value = serde_json::from_slice(&report.stdout).expect("a report");
    eprintln!("{:#}", report["problems"]);
    assert_eq!(report["ok"], true);

    // The page lists it.
    let detail: SessionDetail =
        Studio::new(url, None, None).expect("an address").get("/sessions/grasps").expect("the session");
    assert_eq!(detail.takes.len(), 1, "{detail:?}");

    let takes = Session::open(dir).and_then(|session| session.accepted_takes()).expect("a session");
    let [take] = &takes[..] else { panic!("one take: {}", takes.len()) };
    assert_eq!((take.meta.object.as_str(), take.meta.primitive.as_str()), ("cube", "rollout"));
    assert!(take.meta.fixture_trusted && take.meta.surroundings.len() == 1, "{:?}", take.meta);
    // Every device at its own rate, which the stream's 30 Hz are not.
    let rate_hz = |times_s: &[f64]| (times_s.len() - 1) as f64 / (times_s[times_s.len() - 1] - times_s[0]);
    assert!(rate_hz(&take.joints.times_s) > 40.0, "{} Hz", rate_hz(&take.joints.times_s));
    for (stream, log) in take.station.layout.streams.iter().zip(&take.streams) {
        let recorded_hz = rate_hz(&log.times_s);
        assert!((recorded_hz / stream.rate_hz - 1.0).abs() < 0.1, "{}: {recorded_hz} Hz", stream.id);
        assert_eq!(log.device_times_s.is_empty(), take.streams[0].device_times_s.is_empty());
    }
    let baseline =
        take.spans.iter().find(|span| span.kind == SpanKind::Baseline).expect("a span without touch");
    assert!(baseline.start_s == 0.0 && baseline.end_s > 0.8, "{baseline:?}");

    // The object is where the operator saw it, at the begin and at the end.
    let poses = &take.object_poses;
    let pose_rate_hz = rate_hz(&poses.times_s);
    assert!(pose_rate_hz > 10.0 && pose_rate_hz < 25.0, "{pose_rate_hz} Hz");
    let numbers = |pose: &Value| -> [f64; 7] { serde_json::from_value(pose.clone()).expect("a pose") };
    let ends = [(poses.poses.first(), &outcome["start"]), (poses.poses.last(), &outcome["truth"])];
    for (pose, truth) in ends {
        let (at, truth) = (pose.expect("poses").translation, numbers(&truth["object_pose"]));
        let apart_m = (at.x - truth[0]).hypot(at.y - truth[1]).hypot(at.z - truth[2]);
        assert!(apart_m < 0.002, "{at} against {truth:?}");
    }
    // And the height that it came to is in the take.
    let lift_m = outcome["truth"]["lift_m"].as_f64().expect("a height");
    let rose_m = poses.poses.iter().map(|pose| pose.translation.z).fold(f64::MIN, f64::max)
        - take.meta.base_from_object.translation.z;
    assert!(rose_m > lift_m - 0.002, "{rose_m} against {lift_m}");
}

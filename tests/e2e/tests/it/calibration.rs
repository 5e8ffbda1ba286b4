//! Calibration of the emulated session from the command line.

use e2e::{Tools, demo_session, run_json, together};
use serde_json::Value;

fn number(report: &Value, pointer: &str) -> f64 {
    report
        .pointer(pointer)
        .and_then(Value::as_f64)
        .unwrap_or_else(|| panic!("{pointer} is not a number in {report}"))
}

#[test]
fn demo_session_is_complete() {
    let Some(tools) = Tools::find() else { return };
    let _turn = together();
    let data = demo_session(&tools).unwrap();
    let session = data.join("sessions/demo");
    let check = run_json(tools.palpate().args(["session", "check", "--json"]).arg(&session)).unwrap();
    assert_eq!(check["ok"], true, "{check}");
    assert_eq!(check["frames"], 5674);
    assert_eq!(check["takes"].as_array().unwrap().len(), 9);
    for channel in check["coverage"].as_array().unwrap() {
        for half in channel["touches_by_half"].as_array().unwrap() {
            assert!(half.as_u64().unwrap() >= 4, "touched too seldom: {channel}");
        }
    }
}

#[test]
fn calibrated_beats_nominal_on_held_out_takes() {
    let Some(tools) = Tools::find() else { return };
    let _turn = together();
    let data = demo_session(&tools).unwrap();
    let out = tempfile::tempdir().unwrap();
    let report = run_json(
        tools
            .palpate()
            .args(["calibrate", "--json", "--session"])
            .arg(data.join("sessions/demo"))
            .arg("--report")
            .arg(out.path().join("report")),
    )
    .unwrap();
    let nominal = |metric: &str| number(&report, &format!("/held_out/nominal/{metric}"));
    let calibrated = |metric: &str| number(&report, &format!("/held_out/calibrated/{metric}"));
    assert!(calibrated("onset_error_ms") < nominal("onset_error_ms"), "{}", report["held_out"]);
    assert!(calibrated("f1") > nominal("f1"), "{}", report["held_out"]);
    assert!(calibrated("fpr") < nominal("fpr"), "{}", report["held_out"]);
    // The nominal gap is of the size that hardware shows, and thresholds alone do not close it.
    let bands = [
        ("/nominal/f1", 0.58..0.72),
        ("/nominal/onset_error_ms", 230.0..460.0),
        ("/nominal/fpr", 0.015..0.06),
        ("/held_out/calibrated/f1", 0.6..0.85),
        ("/held_out/calibrated/onset_error_ms", 80.0..230.0),
    ];
    for (pointer, band) in bands {
        assert!(band.contains(&number(&report, pointer)), "{pointer} left {band:?}: {report}");
    }
    let html = std::fs::read_to_string(out.path().join("report/report.html")).unwrap();
    assert!(html.contains("<svg") && !html.contains("src=\"http"), "the report must stand alone");
    std::fs::copy(out.path().join("report/report.html"), tools.artifacts.join("calibration-report.html"))
        .unwrap();
}

#[test]
fn exact_search_is_never_worse_than_the_grid() {
    let Some(tools) = Tools::find() else { return };
    let _turn = together();
    let data = demo_session(&tools).unwrap();
    // The objective is what both minimise: L1 over the takes they were fitted on.
    let fitted_l1 = |method: &str| {
        let mut command = tools.palpate();
        command
            .args(["calibrate", "--json", "--method", method, "--session"])
            .arg(data.join("sessions/demo"));
        let report = run_json(&mut command).unwrap();
        number(&report, "/calibrated/l1") - number(&report, "/held_out/calibrated/l1")
    };
    assert!(fitted_l1("exact") <= fitted_l1("grid"));
}

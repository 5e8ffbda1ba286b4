//! The demonstration session is what the documentation says it is.

use std::collections::BTreeMap;

use palpate_calibration::{CalibrationConfig, PairedTake, calibrate};
use palpate_sim::SensorModel;
use palpate_sim::job::{Cancel, NoProgress};
use tempfile::TempDir;

use crate::{record, shipped, takes};

#[test]
fn demo_session_has_its_frames_touches_and_gap() {
    let dir = TempDir::new().unwrap();
    let session = record(&shipped("demo.toml"), &dir.path().join("demo"), 1).unwrap();
    let takes = takes(&session);
    assert_eq!(takes.len(), 9);
    let mut frames = BTreeMap::new();
    for take in &takes {
        *frames.entry(take.meta.object.as_str()).or_insert(0) += take.num_frames();
    }
    assert_eq!(frames, BTreeMap::from([("cylinder_25x100mm", 2419), ("sphere_50mm", 3255)]));

    let check = palpate_recording::check_session(&session).unwrap();
    assert!(check.problems.is_empty(), "{:?}", check.problems);
    assert_eq!(check.coverage.len(), 44);
    for channel in &check.coverage {
        assert!(channel.touches_by_half.iter().all(|&touches| touches >= 4), "{channel:?}");
    }

    let station = &takes[0].station;
    let nominal = SensorModel::from_toml("nominal", &station.nominal_model_toml).unwrap();
    let pairs: Vec<_> = takes.iter().map(|take| PairedTake::from_take(take).unwrap()).collect();
    let config = CalibrationConfig { bootstrap_resamples: 0, ..CalibrationConfig::default() };
    let report =
        calibrate(&config, &station.layout, &nominal, &pairs, &NoProgress, &Cancel::default(), &|| 0.0)
            .unwrap()
            .report;
    // A gap of the size that was measured on hardware, ...
    assert!((0.58..0.72).contains(&report.nominal.f1.unwrap()), "{:?}", report.nominal);
    assert!((230.0..460.0).contains(&report.nominal.onset_error_ms.unwrap()), "{:?}", report.nominal);
    assert!((0.015..0.06).contains(&report.nominal.fpr.unwrap()), "{:?}", report.nominal);
    // ... of which calibration closes some on takes it has not seen, ...
    let (before, after) = (&report.held_out.nominal, &report.held_out.calibrated);
    assert!(after.onset_error_ms.unwrap() < before.onset_error_ms.unwrap() - 50.0, "{before:?} {after:?}");
    assert!(after.f1.unwrap() > before.f1.unwrap() + 0.03, "{before:?} {after:?}");
    assert!(after.fpr.unwrap() < before.fpr.unwrap() - 0.01, "{before:?} {after:?}");
    // ... and leaves the rest to be named.
    assert!(after.onset_error_ms.unwrap() > 80.0 && after.f1.unwrap() < 0.85, "{after:?}");
}

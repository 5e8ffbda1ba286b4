//! Records a session from a truth file and says how large the gap of the nominal simulator to it is, before and after
//! calibration: what to look at when tuning a truth.
//!
//! `cargo run -p palpate_emulator --example gap -- assets/truth/demo.toml /tmp/session`

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use palpate_calibration::{CalibrationConfig, PairedTake, calibrate};
use palpate_emulator::record_session;
use palpate_sim::SensorModel;
use palpate_sim::job::{Cancel, NoProgress};
use palpate_wire::api::Metrics;

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [_, truth, out_dir] = args.as_slice() else { return Err("usage: gap TRUTH.toml SESSION".into()) };
    let started = Instant::now();
    let session = record_session(Path::new(truth), Path::new(out_dir), 1, &NoProgress, &Cancel::default())?;
    println!("recorded {} takes in {:.1} s", session.file.takes.len(), started.elapsed().as_secs_f64());
    let check = palpate_recording::check_session(&session)?;
    println!("{} frames, {:.1} s", check.frames, check.duration_s);
    for channel in &check.coverage {
        println!("  {:20} {:>2?} {:5.1} s", channel.channel, channel.touches_by_half, channel.active_s);
    }
    for problem in &check.problems {
        println!("  {:?} {}: {}", problem.severity, problem.place, problem.message);
    }

    let mut takes = Vec::new();
    let mut station = None;
    for take_idx in 0..session.file.takes.len() {
        let take = session.take(take_idx)?;
        takes.push(PairedTake::from_take(&take)?);
        station = Some(take.station);
    }
    let station = station.ok_or("the session is empty")?;
    let nominal = SensorModel::from_toml("nominal model", &station.nominal_model_toml)?;
    let config = CalibrationConfig { bootstrap_resamples: 0, ..CalibrationConfig::default() };
    let clock_s = || started.elapsed().as_secs_f64();
    let outcome =
        calibrate(&config, &station.layout, &nominal, &takes, &NoProgress, &Cancel::default(), &clock_s)?;
    let report = outcome.report;
    println!("nominal    {:?}\ncalibrated {:?}", report.nominal_theta, report.theta);
    row("all, nominal", &report.nominal);
    row("all, calibrated", &report.calibrated);
    row("held out, nominal", &report.held_out.nominal);
    row("held out, calibrated", &report.held_out.calibrated);
    for (name, pair) in &report.by_modality {
        row(&format!("{name}, nominal"), &pair.nominal);
        row(&format!("{name}, calibrated"), &pair.calibrated);
    }
    for (name, take) in &report.by_take {
        row(&format!("{name}, nominal"), &take.nominal);
        row(&format!("{name}, calibrated"), &take.calibrated);
    }
    Ok(())
}

fn row(name: &str, metrics: &Metrics) {
    let percent = |value: Option<f64>| value.map_or(f64::NAN, |value| 100.0 * value);
    println!(
        "{name:24} onset {:6.1} ms  offset {:6.1} ms  F1 {:5.1} %  FPR {:5.2} %  paired {:5.1} %  L1 {}",
        metrics.onset_error_ms.unwrap_or(f64::NAN),
        metrics.offset_error_ms.unwrap_or(f64::NAN),
        percent(metrics.f1),
        percent(metrics.fpr),
        percent(metrics.onset_coverage),
        metrics.l1,
    );
}

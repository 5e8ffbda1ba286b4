//! Writes a small synthetic take: every channel of the station is touched in turn while the joints sway.
//!
//! `cargo run -p palpate_recording --example write_take -- STATION.toml TAKE.mcap [SECONDS]`

use std::{error::Error, fs::File, io::BufWriter, path::Path};

use palpate_recording::{LogLevel, Span, SpanKind, TactileSampleRef, TakeMeta, TakeWriter, load_station};

const START_UNIX_NS: u64 = 1_700_000_000_000_000_000;
const BASELINE_S: f64 = 0.5;

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [station_path, take_path, ..] = args.as_slice() else {
        return Err("usage: write_take STATION.toml TAKE.mcap [SECONDS]".into());
    };
    let duration_s: f64 = args.get(2).map_or(Ok(3.0), |text| text.parse())?;
    let station = load_station(Path::new(station_path))?;
    let meta = TakeMeta {
        object: station.objects.keys().next().cloned().unwrap_or_default(),
        base_from_object: nalgebra::Isometry3::translation(0.05, -0.01, 0.1),
        primitive: "tap".to_owned(),
        fixture_trusted: true,
        operator: "example".to_owned(),
        software: "palpate write_take example".to_owned(),
        surroundings: Vec::new(),
    };
    let sink = BufWriter::new(File::create_new(take_path)?);
    let mut writer = TakeWriter::new(sink, &station, &meta, START_UNIX_NS)?;
    writer.span(&Span { kind: SpanKind::Baseline, start_s: 0.0, end_s: BASELINE_S, label: String::new() })?;
    writer.span(&Span {
        kind: SpanKind::Repetition,
        start_s: BASELINE_S,
        end_s: duration_s,
        label: "tap".to_owned(),
    })?;
    writer.log(0, LogLevel::Info, "write_take", "synthetic take")?;

    let num_channels = station.layout.num_channels();
    let touched_at = |time_s: f64| {
        let phase = (time_s - BASELINE_S) / (duration_s - BASELINE_S) * num_channels as f64;
        // A pause before and after each touch.
        (phase >= 0.0 && (0.25..0.75).contains(&phase.fract())).then_some(phase as usize)
    };
    let num_ticks = (duration_s * 1000.0) as u64;
    for tick_ms in 0..num_ticks {
        let (time_ns, time_s) = (tick_ms * 1_000_000, tick_ms as f64 * 1e-3);
        if is_due(tick_ms, station.joint_rate_hz) {
            let positions: Vec<f64> =
                (0..station.robot.num_dofs()).map(|dof| 0.1 * (time_s + dof as f64).sin()).collect();
            writer.commands(time_ns, &positions)?;
            writer.joints(time_ns, &positions)?;
        }
        for (stream_idx, stream) in station.layout.streams.iter().enumerate() {
            if is_due(tick_ms, stream.rate_hz) {
                let active: Vec<bool> =
                    stream.channels.clone().map(|channel| touched_at(time_s) == Some(channel)).collect();
                let on_threshold = station.streams[stream_idx].on_threshold as f32;
                let raw: Vec<f32> = active
                    .iter()
                    .map(|&active| if active { 200.0 + 2.0 * on_threshold } else { 200.0 })
                    .collect();
                // The device counts from its own start, a little earlier.
                let sample =
                    TactileSampleRef { raw: &raw, active: &active, device_time_ns: time_ns + 7_000_000 };
                writer.tactile(stream_idx, time_ns, sample)?;
            }
        }
    }
    writer.finish()?.into_inner().map_err(|error| error.into_error())?.sync_all()?;
    Ok(())
}

/// Whether a clock of `rate_hz` ticks within this millisecond.
fn is_due(tick_ms: u64, rate_hz: f64) -> bool {
    let count = |ms: u64| (ms as f64 * 1e-3 * rate_hz).floor();
    tick_ms == 0 || count(tick_ms) > count(tick_ms - 1)
}

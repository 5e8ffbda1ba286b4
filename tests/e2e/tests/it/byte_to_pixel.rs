//! How long it takes from a byte of a device to a pixel of the page.

use std::{fs, process::Command};

use anyhow::Context as _;
use e2e::{Bench, Board, Studio, Tools, alone};
use palpate_robot_model::DeviceKind;
use serde_json::{Value, json};

/// Asks for the measurement.
const MEASURE: &str = "PALPATE_MEASURE";
/// The board whose reading jumps, and by how much: far beyond what counts as a touch, raw units.
const BOARD: &str = "twintac0";
const JUMP: f64 = 3000.0;
/// Jumps that are measured.
const NUM_JUMPS: usize = 30;
/// A jump that is not seen for so long is not seen at all, ms: the next one comes.
const MOST_MS: f64 = 1500.0;

/// Measures and writes `byte-to-pixel.json` beside the screenshots. Figures depend on the machine: where pictures are drawn
/// by the processor and two cores do everything, painting takes longest.
#[test]
fn a_jump_of_a_reading_is_seen_in_the_picture() {
    let Some(tools) = Tools::find_with_browser() else { return };
    if std::env::var_os(MEASURE).is_none() {
        eprintln!("skipped: a measurement, which wants a quiet machine; set {MEASURE}=1");
        return;
    }
    let report = measure(&tools).unwrap();
    eprintln!("{report:#}");
    fs::write(tools.artifacts.join("byte-to-pixel.json"), format!("{report:#}\n")).unwrap();
    // A machine that has something else to do may miss one now and then; a path that is broken misses them all.
    let seen = report["jumps_seen"].as_u64().unwrap();
    assert!(seen as usize > NUM_JUMPS * 8 / 10, "{seen} of {NUM_JUMPS} were seen in time");
}

fn measure(tools: &Tools) -> anyhow::Result<Value> {
    let bench = Bench::start(alone())?;
    let station = bench.control.station();
    let device =
        station.devices.iter().find(|device| device.id == BOARD).context("the station has the board")?;
    let DeviceKind::Lines(config) = &device.kind else { anyhow::bail!("{BOARD} is no board") };
    let board = Board::start(config.num_channels, 0, JUMP)?;
    let mut arguments = bench.station_args();
    let port = format!("{BOARD}={}", board.port.display());
    let given = arguments.iter_mut().find(|argument| argument.starts_with(&format!("{BOARD}=")));
    *given.context("the board has a port")? = port;
    let data = tempfile::tempdir()?;
    let studio = Studio::serve(tools, data.path(), arguments)?;
    let out = data.path().join("seen.json");
    let status = Command::new("node")
        .arg("byte_to_pixel.mjs")
        .args([&studio.url, &tools.artifacts.display().to_string()])
        .args([config.channels.start.to_string(), (JUMP / 2.0).to_string(), NUM_JUMPS.to_string()])
        .arg(&out)
        .current_dir(&tools.browser_tests)
        .status()?;
    anyhow::ensure!(status.success(), "byte_to_pixel.mjs failed; see {:?}", tools.artifacts);
    let seen: Value = serde_json::from_slice(&fs::read(&out)?)?;

    let times = |list: &str, at: &str| -> Vec<(f64, bool)> {
        let all = seen[list].as_array().into_iter().flatten();
        all.filter_map(|one| Some((one[at].as_f64()?, one["up"].as_bool()?))).collect()
    };
    let (messages, frames) = (times("messages", "at_ms"), times("frames", "painted_ms"));
    let (first, last) =
        (messages.first().context("no messages")?.0, messages.last().context("no messages")?.0);
    let after = |list: &[(f64, bool)], from_ms: f64, up: bool| {
        list.iter().find(|(at_ms, now)| *at_ms >= from_ms && *now == up).map(|(at_ms, _)| *at_ms)
    };
    let mut parts: [Vec<f64>; 3] = Default::default();
    let jumps: Vec<_> = board
        .jumps()
        .into_iter()
        .filter(|jump| (first - MOST_MS..last - MOST_MS).contains(&jump.unix_ms))
        .take(NUM_JUMPS)
        .collect();
    for jump in &jumps {
        let Some(message_ms) = after(&messages, jump.unix_ms, jump.up) else { continue };
        if message_ms - jump.unix_ms >= MOST_MS {
            continue;
        }
        parts[0].push(message_ms - jump.unix_ms);
        let Some(painted_ms) = after(&frames, message_ms, jump.up) else { continue };
        if painted_ms - jump.unix_ms < MOST_MS {
            parts[1].push(painted_ms - message_ms);
            parts[2].push(painted_ms - jump.unix_ms);
        }
    }
    let painting: Vec<f64> = (seen["frames"].as_array().into_iter().flatten())
        .filter_map(|frame| Some(frame["painted_ms"].as_f64()? - frame["begun_ms"].as_f64()?))
        .collect();
    let seconds = frames.last().zip(frames.first()).map_or(0.0, |(last, first)| (last.0 - first.0) * 1e-3);
    let [message, paint, total] = parts.map(|mut values| summary(&mut values));
    Ok(json!({
        "jumps_measured": jumps.len(),
        "jumps_seen": total["count"],
        "byte_to_pixel_ms": total,
        "byte_to_message_in_page_ms": message,
        "message_to_painted_frame_ms": paint,
        "one_frame_ms": summary(&mut painting.clone()),
        "frames_per_s": painting.len() as f64 / seconds,
        "canvas": [seen["pixel"]["width"], seen["pixel"]["height"]],
        "load_average": fs::read_to_string("/proc/loadavg").unwrap_or_default().split(' ').next(),
    }))
}

fn summary(values: &mut [f64]) -> Value {
    values.sort_unstable_by(f64::total_cmp);
    let quantile = |share: f64| values.get((share * values.len().saturating_sub(1) as f64).round() as usize);
    json!({ "count": values.len(), "median": quantile(0.5), "p95": quantile(0.95), "most": quantile(1.0) })
}

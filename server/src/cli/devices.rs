//! `palpate devices ...`.

use std::{net::IpAddr, path::PathBuf, process::ExitCode, sync::Arc};

use clap::{Args, Subcommand};
use palpate_drivers::{DeviceCheck, Link, probe};
use palpate_server::Error;
use serde_json::{Value, json};

use super::{Outcome, output, station::StationArgs};

#[derive(Subcommand)]
pub(crate) enum DevicesCommand {
    /// Run an emulated station that any client of the real devices can talk to
    Emulate(EmulateArgs),
    /// Open every device of a station, say what is there and what is missing, and how to mend it; joints go limp
    Check(CheckArgs),
}

#[derive(Args)]
pub(crate) struct CheckArgs {
    #[command(flatten)]
    station: StationArgs,
    /// Print what was found as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
pub(crate) struct EmulateArgs {
    /// What the emulated world is like: a truth file, or the name of a shipped one
    #[arg(long, value_name = "TRUTH.toml")]
    truth: PathBuf,
    /// Folder for the links to the serial devices; a `faults.toml` there says what is wrong with them, at any time
    #[arg(long, value_name = "DIR")]
    dir: PathBuf,
    /// Address of the arm
    #[arg(long, value_name = "IP", default_value = "127.0.0.1")]
    xarm_ip: IpAddr,
    /// Ports of the arm: 502 and 30000 to 30003 as the real one, or any that are free
    #[arg(long, value_enum, default_value_t = XarmPorts::Standard)]
    xarm_ports: XarmPorts,
    /// Same truth, same seed, same requests at the same times: same bytes
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum XarmPorts {
    Standard,
    Any,
}

pub(super) fn run(command: &DevicesCommand) -> Outcome {
    match command {
        DevicesCommand::Emulate(args) => emulate(args),
        DevicesCommand::Check(args) => check(args),
    }
}

/// Exit code 1 if any device is missing or has a fault; one that is slow is warned of.
fn check(args: &CheckArgs) -> Outcome {
    let Some((station, ports)) = args.station.open()? else {
        return Err(Error::Argument("--station says which devices to look for".to_owned()));
    };
    if station.devices.is_empty() {
        return Err(Error::Content(format!(
            "station {:?} names no devices; add [[device]] entries to its file, docs/hardware.md says how",
            station.id
        )));
    }
    let found = probe(&Arc::new(station), &ports)?;
    let ok = found.iter().all(|device| device.ok);
    if args.json {
        let devices: Vec<Value> = found.iter().map(document).collect();
        output::json(&json!({ "ok": ok, "devices": devices }))?;
    } else {
        found.iter().try_for_each(|device| output::line(device.to_string().trim_end()))?;
    }
    Ok(if ok { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn document(device: &DeviceCheck) -> Value {
    let health = &device.health;
    let link = match health.link {
        Link::Connecting => "connecting",
        Link::Ready => "ready",
        Link::Fault => "fault",
        Link::Lost => "lost",
    };
    let motors: Vec<Value> = health
        .motors
        .iter()
        .map(|motor| {
            json!({
                "joint": motor.joint, "identity": motor.identity, "temperature_c": motor.temperature_c,
                "supply_v": motor.supply_v, "current_a": motor.current_a, "problem": motor.problem,
            })
        })
        .collect();
    json!({
        "id": health.id, "kind": health.kind, "ok": device.ok, "link": link, "problem": health.problem,
        "warnings": device.warnings,
        "rate_hz": health.rate_hz, "rate_worst_hz": health.rate_worst_hz, "gaps": health.gaps,
        "bad_frames": health.bad_frames, "clock_skew_ppm": health.clock_skew_ppm, "motors": motors,
    })
}

#[cfg(not(unix))]
fn emulate(_args: &EmulateArgs) -> Outcome {
    Err(Error::Argument("emulated devices need pseudo-terminals, which only Unix has".to_owned()))
}

#[cfg(unix)]
fn emulate(args: &EmulateArgs) -> Outcome {
    use palpate_emulator::{ArmPorts, EmulatedStation, PortsConfig, PortsError, serve_devices};
    use palpate_server::{assets, chain};

    let (truth, _unpacked) = assets::truth(&args.truth)?;
    let mut station = EmulatedStation::new(&truth, args.seed)?;
    let arm_ports = match args.xarm_ports {
        XarmPorts::Standard => ArmPorts::Standard,
        XarmPorts::Any => ArmPorts::Any,
    };
    let config = PortsConfig { dir: args.dir.clone(), arm_ip: args.xarm_ip, arm_ports };
    let stop = unix::stop_requested()?;
    let mut printed = Ok(());
    let served = serve_devices(
        &mut station,
        &config,
        &stop,
        &mut |ports| printed = super::output::line(&unix::found(ports).to_string()),
        &mut |notice| tracing::warn!("{notice}"),
    );
    printed?;
    served.map_err(|error| match error {
        PortsError::Io { action, path, source } => Error::Io { action, path, source },
        PortsError::InTheWay { .. } | PortsError::Listen { .. } => Error::Conflict(chain(&error)),
        error => Error::Internal(chain(&error)),
    })?;
    Ok(ExitCode::SUCCESS)
}

#[cfg(unix)]
mod unix {
    use std::sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    };

    use palpate_emulator::DevicePorts;
    use palpate_server::Error;
    use serde_json::{Value, json};

    /// What is printed when everything is ready.
    pub(super) fn found(ports: &DevicePorts) -> Value {
        let named = |prefix: &str| -> Vec<&std::path::Path> {
            let links = ports.links.iter().filter(|(name, _)| name.starts_with(prefix));
            links.map(|(_, link)| link.as_path()).collect()
        };
        let one = |prefix: &str| named(prefix).first().copied();
        let arm = &ports.arm_ports;
        json!({
            "u2d2": one("u2d2"),
            "twintac": named("twintac"),
            "fsr": one("fsr"),
            "xarm": ports.arm_ip,
            "xarm_ports": {
                "command": arm.command,
                "realtime": arm.realtime,
                "normal": arm.normal,
                "rich": arm.rich,
                "real": arm.real,
            },
        })
    }

    /// A flag that Ctrl-C, the end of the terminal and the termination signal of service managers set.
    pub(super) fn stop_requested() -> Result<Arc<AtomicBool>, Error> {
        use tokio::signal::unix::{SignalKind, signal};

        let stop = Arc::new(AtomicBool::new(false));
        let asked = stop.clone();
        let failed = |err: std::io::Error| Error::Internal(format!("failed to wait for signals: {err}"));
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(failed)?;
        let (mut interrupt, mut terminate, mut hang_up) = {
            let _inside = runtime.enter();
            let listen = |kind| signal(kind).map_err(failed);
            (
                listen(SignalKind::interrupt())?,
                listen(SignalKind::terminate())?,
                listen(SignalKind::hangup())?,
            )
        };
        let wait = move || {
            runtime.block_on(async {
                tokio::select! {
                    _ = interrupt.recv() => {}
                    _ = terminate.recv() => {}
                    _ = hang_up.recv() => {}
                }
            });
            asked.store(true, Ordering::Relaxed);
        };
        std::thread::Builder::new().name("signals".to_owned()).spawn(wait).map_err(failed)?;
        Ok(stop)
    }
}

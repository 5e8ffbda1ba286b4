//! `palpate devices ...`.

use std::{net::IpAddr, path::PathBuf, process::ExitCode};

use clap::{Args, Subcommand};

use super::Outcome;

#[derive(Subcommand)]
pub(crate) enum DevicesCommand {
    /// Run an emulated station that any client of the real devices can talk to
    Emulate(EmulateArgs),
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
    }
}

#[cfg(not(unix))]
fn emulate(_args: &EmulateArgs) -> Outcome {
    Err(palpate_server::Error::Argument(
        "emulated devices need pseudo-terminals, which only Unix has".to_owned(),
    ))
}

#[cfg(unix)]
fn emulate(args: &EmulateArgs) -> Outcome {
    use palpate_emulator::devices::{ArmPorts, EmulatedStation, PortsConfig, PortsError, serve_devices};
    use palpate_server::{Error, assets, chain};

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

    use palpate_emulator::devices::DevicePorts;
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

//! The physical emulated station: the devices of `palpate devices emulate` on the bodies of the grasp world, in real time.
//!
//! Whoever drives it sees pseudo-terminals and TCP ports; what a person does beside a real station (put the object somewhere,
//! look whether it is up) goes over a socket beside them ([`operator`]), which a real station lacks.

mod operator;
mod physics;

use std::net::IpAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context as _;
use nalgebra::{Isometry3, Translation3};
use palpate_emulator::{ArmPorts, Bodies, DevicePorts, EmulatedStation, PortsConfig, serve_devices};
use palpate_grasp::GraspConfig;
use palpate_robot_model::ObjectShape;
use palpate_truth::TruthSense;
use serde_json::{Value, json};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

use crate::files::{self, Sources};
use operator::{Objects, Operator};
use physics::Physics;

/// Among what runs in real time (1 to 99): that of the drivers.
const REAL_TIME: u8 = 60;

#[derive(clap::Args)]
pub(crate) struct StationArgs {
    /// What lies on the table at first: a file, or a name in `assets/objects`
    #[arg(long, default_value = "cube")]
    object: String,
    /// What skin, electronics and encoders are like
    #[arg(long, default_value = "assets/truth/demo.toml")]
    truth: PathBuf,
    /// Grasp world of the truth's robot
    #[arg(long, default_value = "assets/grasp/xarm6_leap.toml")]
    world: PathBuf,
    /// Folder for the links to the serial devices, for `operator.sock`, and for a `faults.toml` that says what is wrong
    #[arg(long)]
    dir: PathBuf,
    /// Address of the arm
    #[arg(long, value_name = "IP", default_value = "127.0.0.1")]
    xarm_ip: IpAddr,
    /// Ports of the arm: 502 and 30000 to 30003 as the real one, or any that are free
    #[arg(long, value_enum, default_value_t = XarmPorts::Standard)]
    xarm_ports: XarmPorts,
    /// Seed of the devices' noise
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Take turns in real time (first in, first out), where the system permits it, so that other work makes no device late
    #[arg(long)]
    real_time: bool,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum XarmPorts {
    Standard,
    Any,
}

pub(crate) fn run(args: &StationArgs) -> anyhow::Result<()> {
    let sense = TruthSense::read(&args.truth)?;
    let station = Arc::new(sense.station().clone());
    let world = files::text(&args.world)?;
    let config = GraspConfig::from_toml(&files::shown(&args.world), &world, &station.robot)?;
    let object = files::object(&args.object, &Sources::default())?;
    let table = &config.table;
    let center_m =
        Translation3::new(table.center_m[0], table.center_m[1], table.top_m - 0.5 * table.size_m[2]);
    let fixed = vec![(Isometry3::from(center_m), ObjectShape::Box { size_m: table.size_m })];
    let positions = config.start_positions(&station.robot);

    let mut objects = Objects::new(Arc::clone(&station), config.clone(), sense);
    let first = objects.nominal(&object)?;
    let (physics, shared) = Physics::new(&station, &config, first);
    let bodies = Bodies { mechanics: Box::new(physics), positions, fixed };
    let mut emulated = EmulatedStation::with_bodies(&args.truth, args.seed, bodies)?;

    std::fs::create_dir_all(&args.dir)
        .with_context(|| format!("failed to make the folder {:?}", args.dir))?;
    let operator = Operator::listen(&args.dir, objects, shared, emulated.control())?;
    let stop = stop_requested()?;
    let ports = PortsConfig {
        dir: args.dir.clone(),
        arm_ip: args.xarm_ip,
        arm_ports: match args.xarm_ports {
            XarmPorts::Standard => ArmPorts::Standard,
            XarmPorts::Any => ArmPorts::Any,
        },
    };
    if args.real_time {
        take_turns_in_real_time();
    }
    let id = station.id.clone();
    let mut ready = |found: &DevicePorts| println!("{}", found_json(found, &id, operator.path()));
    let mut notice = |text: String| eprintln!("palpate-train: {text}");
    serve_devices(&mut emulated, &ports, &stop, &mut ready, &mut notice)?;
    Ok(())
}

/// What is printed when everything is there: where devices and operator's socket are, and what to tell `palpate serve`.
fn found_json(found: &DevicePorts, station: &str, operator: &std::path::Path) -> Value {
    let arm = &found.arm_ports;
    let mut serve = vec!["--station".to_owned(), station.to_owned()];
    for (id, link) in &found.links {
        serve.extend(["--port".to_owned(), format!("{id}={}", link.display())]);
    }
    serve.extend(["--port".to_owned(), format!("xarm={}:{}/{}", found.arm_ip, arm.command, arm.real)]);
    let links: serde_json::Map<String, Value> =
        found.links.iter().map(|(id, link)| (id.clone(), json!(link))).collect();
    json!({
        "links": links,
        "xarm": found.arm_ip,
        "xarm_ports": {
            "command": arm.command, "realtime": arm.realtime, "normal": arm.normal, "rich": arm.rich, "real": arm.real,
        },
        "operator": operator,
        "serve": serve,
    })
}

/// A flag that Ctrl-C and the termination signal of service managers set.
fn stop_requested() -> anyhow::Result<Arc<AtomicBool>> {
    use tokio::signal::unix::{SignalKind, signal};

    let stop = Arc::new(AtomicBool::new(false));
    let asked = Arc::clone(&stop);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let (mut interrupt, mut terminate) = {
        let _inside = runtime.enter();
        (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?)
    };
    let wait = move || {
        runtime.block_on(async {
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
            }
        });
        asked.store(true, Ordering::Relaxed);
    };
    std::thread::Builder::new().name("signals".to_owned()).spawn(wait)?;
    Ok(stop)
}

/// The calling thread comes before ordinary ones; it mostly waits, and gives way where it does not keep up.
fn take_turns_in_real_time() {
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    let priority =
        ThreadPriorityValue::try_from(REAL_TIME).map_or(ThreadPriority::Min, ThreadPriority::Crossplatform);
    if set_thread_priority_and_policy(thread_native_id(), priority, policy).is_err() {
        eprintln!("palpate-train: no permission for real-time priority; docs/hardware.md says how to get it");
    }
}

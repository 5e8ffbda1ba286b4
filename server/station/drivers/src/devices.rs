//! All devices of a station: one thread each, started and ended together.

use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::SyncSender;

use palpate_robot_model::{ArmConfig, BoardConfig, DeviceConfig, DeviceKind, SafetyConfig, Station};
use palpate_safety::{Setpoint, disarm_begins_s};

use crate::arm::{self, ArmSetup, Limits};
use crate::boards::{self, BoardSetup};
use crate::clock::{HostClock, Stop};
use crate::context::{BusHandle, DeviceContext, Goal, GoalSlot, Outbox};
use crate::error::DriverError;
use crate::event::DeviceEvent;
use crate::health::{DeviceHealth, SharedHealth};
use crate::servo_bus;

/// Where to find devices if not where the station file says, by device id.
pub type Ports = BTreeMap<String, PortOverride>;

/// Where to find a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PortOverride {
    /// The serial port of servos or a board.
    Serial(PathBuf),
    /// The ports of an arm.
    Arm {
        /// Of the control box.
        address: IpAddr,
        /// Of commands.
        command_port: u16,
        /// Of the report stream.
        report_port: u16,
    },
}

/// The devices of one station, driven until this is dropped: joints go limp then.
#[derive(Debug)]
pub struct Devices {
    clock: HostClock,
    goals: GoalSlot,
    /// In the station's order.
    devices: Vec<Device>,
}

#[derive(Debug)]
struct Device {
    id: Arc<str>,
    health: SharedHealth,
    clear_fault: Arc<AtomicBool>,
    bus: BusHandle,
}

impl Devices {
    /// Starts a thread for each device of the station. What they have to say comes through `events`, each `device` of
    /// which counts the station's devices. A device that is not there is no error: its thread keeps trying, and says so. A
    /// driver that panics is told as [`crate::Link::Lost`] with the reason, and started again.
    ///
    /// No device's thread waits for room in `events`. Where there is none, readings are dropped and counted in
    /// [`DeviceHealth::dropped_events`]; the newest link of each device is kept and comes as soon as there is room.
    pub fn open(
        station: &Arc<Station>,
        ports: &Ports,
        events: SyncSender<DeviceEvent>,
    ) -> Result<Self, DriverError> {
        let known = || list(station.devices.iter().map(|device| device.id.as_str()));
        if let Some(unknown) = ports.keys().find(|id| station.devices.iter().all(|device| device.id != **id))
        {
            return Err(DriverError::UnknownDevice { device: unknown.clone(), known: known() });
        }
        let (clock, goals) = (HostClock::start(), GoalSlot::default());
        let mut devices = Vec::with_capacity(station.devices.len());
        for (index, config) in station.devices.iter().enumerate() {
            let context = DeviceContext {
                index,
                id: Arc::from(config.id.as_str()),
                clock: clock.clone(),
                health: SharedHealth::new(&config.id, config.kind_name()),
                goals: goals.clone(),
                stop: Stop::default(),
                events: Outbox::new(events.clone()),
                clear_fault: Arc::default(),
                has_failed: Arc::default(),
                #[cfg(test)]
                panics: Arc::default(),
            };
            let (id, health) = (Arc::clone(&context.id), context.health.clone());
            let clear_fault = Arc::clone(&context.clear_fault);
            let bus = spawn(context, config, ports.get(&config.id), &station.safety)?;
            devices.push(Device { id, health, clear_fault, bus });
        }
        Ok(Self { clock, goals, devices })
    }

    /// The clock of all times in events.
    pub fn clock(&self) -> HostClock {
        self.clock.clone()
    }

    /// Gives all motors what they shall do, in place of what they were given before. Never waits.
    pub fn set(&self, setpoint: &Setpoint) {
        self.goals.set(Goal::from(setpoint));
    }

    /// Asks the device's thread to clear what can be cleared: servos that have tripped restart, the arm's errors go. What is
    /// asked while the device is away is void: when it comes back, its faults stay until somebody who has seen them asks.
    pub fn clear_fault(&self, device: &str) -> Result<(), DriverError> {
        let Some(found) = self.devices.iter().find(|candidate| *candidate.id == *device) else {
            let known = list(self.devices.iter().map(|device| &*device.id));
            return Err(DriverError::UnknownDevice { device: device.to_owned(), known });
        };
        found.clear_fault.store(true, Ordering::Relaxed);
        Ok(())
    }

    /// How every device is, in the station's order.
    pub fn health(&self) -> Vec<DeviceHealth> {
        let now_ns = self.clock.now_ns();
        self.devices.iter().map(|device| device.health.snapshot(now_ns)).collect()
    }
}

impl Drop for Devices {
    fn drop(&mut self) {
        // All are told before any is waited for, so that they end side by side.
        for device in &self.devices {
            device.bus.stop();
        }
    }
}

impl From<&Setpoint> for Goal {
    fn from(setpoint: &Setpoint) -> Self {
        Self {
            torque: setpoint.torque(),
            lead_through: setpoint.lead_through(),
            positions: setpoint.positions().into(),
            valid_until_ns: setpoint.valid_until_ns(),
            disarms: 0,
        }
    }
}

fn spawn(
    context: DeviceContext,
    config: &DeviceConfig,
    port: Option<&PortOverride>,
    safety: &SafetyConfig,
) -> Result<BusHandle, DriverError> {
    match &config.kind {
        DeviceKind::Dynamixel(bus) => {
            let path = serial_path(config, &bus.port, port)?;
            servo_bus::spawn(context, bus, path, hold_ns(safety))
        }
        DeviceKind::Xarm(arm) => {
            let setup = arm_setup(config, arm, port, safety)?;
            context.spawn(move |context| arm::run(context, &setup))
        }
        DeviceKind::Lines(board) => {
            let setup = board_setup(serial_path(config, &board.port, port)?, board);
            context.spawn(move |context| boards::run(context, &setup))
        }
    }
}

/// How long joints hold once setpoints have dried up, ns: a setpoint is valid for the one time, and joints let go after
/// the other.
fn hold_ns(safety: &SafetyConfig) -> u64 {
    ((disarm_begins_s(safety) - safety.command_ttl_s).max(0.0) * 1e9) as u64
}

fn serial_path(
    config: &DeviceConfig,
    in_file: &str,
    port: Option<&PortOverride>,
) -> Result<PathBuf, DriverError> {
    match port {
        None => Ok(PathBuf::from(in_file)),
        Some(PortOverride::Serial(path)) => Ok(path.clone()),
        Some(PortOverride::Arm { .. }) => Err(wrong_port(config, "a serial port")),
    }
}

fn arm_setup(
    config: &DeviceConfig,
    arm: &ArmConfig,
    port: Option<&PortOverride>,
    safety: &SafetyConfig,
) -> Result<ArmSetup, DriverError> {
    let (address, command_port, report_port) = match port {
        None => (arm.address, arm.command_port, arm.report_port),
        Some(PortOverride::Arm { address, command_port, report_port }) => {
            (*address, *command_port, *report_port)
        }
        Some(PortOverride::Serial(_)) => return Err(wrong_port(config, "an address and two ports")),
    };
    let limits = |limit: fn(&palpate_robot_model::JointSafety) -> f64| -> Vec<f64> {
        arm.dofs.iter().filter_map(|&dof| safety.joints.get(dof)).map(limit).collect()
    };
    Ok(ArmSetup {
        commands: SocketAddr::new(address, command_port),
        reports: SocketAddr::new(address, report_port),
        dofs: Arc::from(arm.dofs.as_slice()),
        joints: arm.joints.clone(),
        limits: Limits {
            rad_per_sec: limits(|joint| joint.velocity),
            rad_per_sec2: limits(|joint| joint.acceleration),
        },
        hold_ns: hold_ns(safety),
    })
}

fn board_setup(port: PathBuf, board: &BoardConfig) -> BoardSetup {
    BoardSetup {
        port,
        baud: board.baud,
        stream: board.stream_idx,
        first_channel: board.first_channel,
        num_channels: board.num_channels,
        lines_per_sample: board.lines_per_sample,
    }
}

fn wrong_port(config: &DeviceConfig, expected: &'static str) -> DriverError {
    DriverError::Port { device: config.id.clone(), kind: config.kind_name(), expected }
}

fn list<'a>(ids: impl Iterator<Item = &'a str>) -> String {
    let ids: Vec<&str> = ids.collect();
    if ids.is_empty() { "no devices".to_owned() } else { ids.join(", ") }
}

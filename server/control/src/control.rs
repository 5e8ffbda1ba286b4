//! Starts and ends the control loop.

use std::{
    path::PathBuf,
    sync::{Arc, mpsc::sync_channel},
    thread::{self, JoinHandle},
};

use palpate_drivers::{Devices, Ports, priority};
use palpate_robot_model::{JointKind, Station};
use palpate_safety::Supervisor;
use palpate_wire::api::Source;

use crate::{
    audit::AuditLog,
    control_loop::{ControlLoop, Publish},
    error::ControlError,
    guided::{Guided, PlaceObject},
    handle::{Handle, Shared},
    prepare::Plans,
    rates::RateMeter,
    requests::Desk,
    senses::Senses,
    twin::{Twin, TwinModel},
    wanted::WantedFile,
};

/// Events of devices that wait for the control loop at most: two seconds of all devices of a hand on an arm. Readings beyond
/// that are dropped and counted by the drivers.
const MAX_WAITING_EVENTS: usize = 4096;
/// How far a joint may be behind a guided motion before the motion is given up: servos that press against something
/// yield, arms do not.
const MOST_BEHIND_HAND: f64 = 0.45;
const MOST_BEHIND_CARRIER: f64 = 0.1;
const MOST_BEHIND_CARRIER_M: f64 = 0.01;

/// What a station is run with.
pub struct ControlConfig {
    /// The station; it has devices.
    pub station: Arc<Station>,
    /// Where its devices are, where that is not what the station file says.
    pub ports: Ports,
    /// Whether it is hardware or emulated.
    pub source: Source,
    /// Folder of the sessions that are recorded.
    pub sessions_dir: PathBuf,
    /// File that the audit log is appended to, one JSON object a line ([`crate::AuditLine`]).
    pub audit_path: PathBuf,
    /// File of the takes that are wanted and wait for a session; made when there is the first.
    pub wanted_path: PathBuf,
    /// Called when the operator confirms that a step's object is in place: an emulated station has nobody to put it
    /// there.
    pub place_object: Option<PlaceObject>,
}

impl std::fmt::Debug for ControlConfig {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ControlConfig")
            .field("station", &self.station.id)
            .field("ports", &self.ports)
            .field("source", &self.source)
            .field("sessions_dir", &self.sessions_dir)
            .field("audit_path", &self.audit_path)
            .field("wanted_path", &self.wanted_path)
            .finish_non_exhaustive()
    }
}

/// A station that is run. Dropping it stops the robot, ends what is recorded and waits for all of that.
#[derive(Debug)]
pub struct Control {
    handle: Handle,
    thread: Option<JoinHandle<()>>,
}

impl Control {
    /// Opens the devices and starts the loop, which hands its state to `publish` 30 times a second. A device that is not
    /// there is no error: the loop runs and says so.
    pub fn start(config: ControlConfig, publish: Publish) -> Result<Self, ControlError> {
        let ControlConfig { station, ports, source, sessions_dir, audit_path, wanted_path, place_object } =
            config;
        if station.devices.is_empty() {
            return Err(ControlError::Refused(format!(
                "station {:?} names no devices that could be run; add [[device]] entries to its station file",
                station.id
            )));
        }
        let failed = |name: &'static str| move |source| ControlError::Thread { name, source };
        let twin_model = TwinModel::nominal(&station).map_err(ControlError::Refused)?;
        let plans = Plans::new(Arc::clone(&station), sessions_dir)?;
        let mut guided =
            Guided::new(Arc::clone(&station), plans.summaries(), place_object).map_err(failed("recorder"))?;
        let mut audit = AuditLog::open(&audit_path, 0).map_err(|source| ControlError::Io {
            action: "open the audit log",
            path: audit_path.clone(),
            source,
        })?;
        audit.note(0, "station", &format!("the control loop of {} was started", station.id));
        let (wanted_file, problem) = WantedFile::open(wanted_path);
        for wanted in wanted_file.wanted() {
            match plans.check_wanted(&wanted) {
                Ok(()) => guided.want(wanted)?,
                Err(error) => audit.warn(0, "station", &format!("a wanted take is left out: {error}")),
            }
        }
        if let Some(problem) = problem {
            audit.warn(0, "station", &problem);
        }
        let (report, events) = sync_channel(MAX_WAITING_EVENTS);
        let devices = Devices::open(&station, &ports, report)?;
        let (handle, messages) = Handle::new(Shared {
            station: Arc::clone(&station),
            source,
            plans,
            wanted_file,
            twin_model: twin_model.clone(),
        });
        let twin = Twin::start(Arc::clone(&station), twin_model, devices.clock().now_ns())
            .map_err(failed("twin"))?;
        let control_loop = ControlLoop {
            twin,
            supervisor: Supervisor::new(&station),
            clock: devices.clock(),
            devices,
            events,
            messages,
            publish,
            senses: Senses::new(&station),
            guided,
            audit,
            desk: Desk::default(),
            commands: 0,
            loop_rate: RateMeter::default(),
            commanded: Vec::new(),
            tare_for: String::new(),
            tare_problem: String::new(),
            tolerances: tolerances(&station),
            station,
        };
        let thread = thread::Builder::new()
            .name("control".to_owned())
            .spawn(move || {
                priority::real_time();
                control_loop.run();
            })
            .map_err(failed("control"))?;
        Ok(Self { handle, thread: Some(thread) })
    }

    /// Speaks to the loop.
    pub fn handle(&self) -> Handle {
        self.handle.clone()
    }
}

impl Drop for Control {
    fn drop(&mut self) {
        self.handle.end();
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the control loop's thread panicked; its devices were let go of");
        }
    }
}

/// How far each joint may be behind a guided motion, rad or m.
fn tolerances(station: &Station) -> Vec<f64> {
    let joints = station.robot.dofs().enumerate();
    let tolerance = |(dof, joint): (usize, &palpate_robot_model::Joint)| match (
        station.carrier_dofs.contains(&dof),
        joint.kind,
    ) {
        (true, JointKind::Prismatic) => MOST_BEHIND_CARRIER_M,
        (true, _) => MOST_BEHIND_CARRIER,
        (false, _) => MOST_BEHIND_HAND,
    };
    joints.map(tolerance).collect()
}

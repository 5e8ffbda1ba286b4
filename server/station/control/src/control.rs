//! Starts and ends the control loop.

use std::{
    path::PathBuf,
    sync::{Arc, mpsc::sync_channel},
    thread::{self, JoinHandle},
    time::Duration,
};

use palpate_drivers::{Devices, Ports, priority};
use palpate_robot_model::{JointKind, Station};
use palpate_safety::Supervisor;
use palpate_wire::{api::Source, proto::LiveFrame};

use crate::{
    audit::{AuditFile, AuditLog},
    control_loop::{ControlLoop, Publish},
    ending::Ending,
    error::ControlError,
    guided::{Guided, PlaceObject},
    handle::{Handle, Shared},
    inbox::inbox,
    latch::Latch,
    prepare::Plans,
    rates::RateMeter,
    refusals::Refusals,
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
    /// The audit log, which others may write to as well.
    pub audit: AuditFile,
    /// File of the takes that are wanted and wait for a session; made when there is the first.
    pub wanted_path: PathBuf,
    /// File that remembers a latched stop over a restart; it exists while the station is stopped.
    pub latch_path: PathBuf,
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
            .field("wanted_path", &self.wanted_path)
            .field("latch_path", &self.latch_path)
            .finish_non_exhaustive()
    }
}

/// A station that is run. Dropping it ends it as [`Control::end`] does, and waits for all of that.
#[derive(Debug)]
pub struct Control {
    handle: Handle,
    ended: crossbeam_channel::Receiver<Ending>,
    thread: Option<JoinHandle<()>>,
}

impl Control {
    /// Opens the devices and starts the loop, which hands its state to `publish` 30 times a second. A device that is not
    /// there is no error: the loop runs and says so.
    pub fn start(config: ControlConfig, publish: Publish) -> Result<Self, ControlError> {
        let ControlConfig {
            station,
            ports,
            source,
            sessions_dir,
            audit,
            wanted_path,
            latch_path,
            place_object,
        } = config;
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
        let mut audit = AuditLog::new(audit, 0);
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
        let (latch, stopped_by) = Latch::open(&latch_path).map_err(failed("stop-latch"))?;
        let mut supervisor = Supervisor::new(&station);
        if let Some(who) = stopped_by {
            audit.warn(
                0,
                "station",
                &format!("the stop of {who:?} is still latched from before the restart"),
            );
            supervisor.stop(0, &who);
        }
        let (mailbox, inbox) = inbox();
        let shared = Shared {
            station: Arc::clone(&station),
            source,
            plans,
            wanted_file,
            twin_model: twin_model.clone(),
        };
        let handle = Handle::new(mailbox, devices.clock(), shared);
        let frames = start_publisher(publish).map_err(failed("publisher"))?;
        let twin = Twin::start(Arc::clone(&station), twin_model, devices.clock().now_ns())
            .map_err(failed("twin"))?;
        let mut control_loop = ControlLoop {
            twin,
            supervisor,
            clock: devices.clock(),
            devices,
            events,
            inbox,
            frames,
            senses: Senses::new(&station),
            guided,
            audit,
            desk: Desk::default(),
            refusals: Refusals::default(),
            latch,
            stop_replies: Vec::new(),
            was_armed: false,
            commands: 0,
            loop_rate: RateMeter::default(),
            commanded: Vec::new(),
            tare_for: None,
            tare_problem: String::new(),
            tolerances: tolerances(&station),
            reflex: None,
            station,
        };
        let (tell, ended) = crossbeam_channel::bounded(1);
        let thread = thread::Builder::new()
            .name("control".to_owned())
            .spawn(move || {
                priority::real_time();
                let ending = control_loop.run();
                // Nobody asks if this is dropped.
                let _ = tell.send(ending);
                // What is being recorded is finished and the log written before the devices go; motors are limp already, and
                // if they are not, the devices' threads go on to switch them off meanwhile.
                let ControlLoop { guided, audit, latch, devices, .. } = control_loop;
                drop((guided, audit, latch));
                drop(devices);
            })
            .map_err(failed("control"))?;
        Ok(Self { handle, ended, thread: Some(thread) })
    }

    /// Ends all motion: joints brake, torque goes off. Returns how that went, once readings show it or `patience` is over;
    /// what is recorded, the audit log and the devices end after that, for which [`Control::finish`] waits.
    pub fn end(&self, patience: Duration) -> Ending {
        self.handle.end();
        self.ended.recv_timeout(patience).unwrap_or_else(|error| Ending {
            was_armed: true,
            not_let_go: Vec::new(),
            problem: Some(format!("the control loop did not say ({error})")),
        })
    }

    /// Waits until everything has ended, for `patience` at most; says whether it has.
    pub fn finish(&mut self, patience: Duration) -> bool {
        let begun = std::time::Instant::now();
        while self.thread.as_ref().is_some_and(|thread| !thread.is_finished()) {
            if begun.elapsed() >= patience {
                // Nothing can end a thread that waits for a disk; the end of the process will.
                self.thread = None;
                return false;
            }
            thread::sleep(Duration::from_millis(2));
        }
        self.join();
        true
    }

    fn join(&mut self) {
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the control loop's thread panicked; its devices were let go of");
        }
    }

    /// Speaks to the loop.
    pub fn handle(&self) -> Handle {
        self.handle.clone()
    }
}

impl Drop for Control {
    fn drop(&mut self) {
        self.handle.end();
        self.join();
    }
}

/// Starts the thread that hands messages to pages; it ends when the sender is dropped.
fn start_publisher(publish: Publish) -> std::io::Result<crossbeam_channel::Sender<LiveFrame>> {
    // One message waits, one is handed over: with more, pages would see the past.
    let (frames, received) = crossbeam_channel::bounded::<LiveFrame>(1);
    thread::Builder::new().name("publisher".to_owned()).spawn(move || {
        for frame in received {
            publish(frame);
        }
    })?;
    Ok(frames)
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

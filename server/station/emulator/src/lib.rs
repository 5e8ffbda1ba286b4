//! The emulated station's devices, speaking the bytes of the real ones.
//!
//! [`EmulatedStation`] is all of them without ports, clocks or threads: it takes bytes with the time at which they
//! arrived and gives bytes with the time at which they are due, so that the same bytes in at the same times give the same
//! bytes out. Servos and arm move the truth world, whose sensors the tactile boards read: a hand that somebody moves into
//! the object feels it. The object does not yield, and holds a finger back only where
//! [`StationControl::set_resistance`] asks for it; with [`Mechanics`] (`EmulatedStation::with_bodies`) robot and object push
//! each other, and the object can be lifted.
//!
//! [`serve_devices`] gives it pseudo-terminals, sockets and the clock. [`Faults`] says what is wrong.

mod arm;
mod boards;
mod control;
mod faults;
mod mechanics;
#[cfg(unix)]
mod ports;
mod servo;
mod servo_bus;
mod wire;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use palpate_device_protocol::xarm::FrameDecoder;
use palpate_robot_model::Station;

pub use arm::ReportPort;
use arm::{ArmBox, ArmModel};
use boards::Board;
pub use control::{ArmSnapshot, ControlError, LoggedStep, MotionLog, Push, StationControl, StationSnapshot};
use control::{Shared, Wish};
pub use faults::{Fault, Faults};
pub use mechanics::{Bodies, Drive, FeltObject, Mechanics};
use palpate_truth::{Emulation, EmulationError, Event, Placed, Resistance, TruthWorld};
#[cfg(unix)]
pub use ports::{ArmPortNumbers, ArmPorts, DevicePorts, PortsConfig, PortsError, serve_devices};
use servo::ServoFaults;
use servo_bus::ServoBus;
pub use wire::LineTraffic;
use wire::Wire;

/// Name of the servos' line, after the adapter that it hangs on.
const SERVO_LINE: &str = "u2d2";
/// Name of the arm's box.
const ARM: &str = "xarm";
/// Steps of servos and arm, ns.
const STEP_NS: u64 = 1_000_000;
/// Steps after which what the object does to the servos is looked at anew, as often as the world moves the hand.
const RESISTANCE_STEPS: u64 = 5;
/// Time that the box takes for an answer, ns.
const ARM_ANSWER_NS: u64 = 300_000;
/// First number of the arm's connections among the wires; the serial lines have the lower ones.
const FIRST_CONNECTION: u64 = 1000;

/// What the devices of a station are called.
#[derive(Clone, Debug)]
pub(crate) struct DeviceNames {
    /// Serial lines in order: the servos', then the boards'.
    pub(crate) lines: Vec<String>,
    pub(crate) arm: &'static str,
    /// Joints of the hand, in the order of their servos' ids.
    pub(crate) hand_joints: Vec<String>,
}

impl DeviceNames {
    pub(crate) fn of(station: &Station) -> Self {
        let mut lines = vec![SERVO_LINE.to_owned()];
        let boards = Board::of(station);
        let num_matrices = boards.iter().filter(|board| !board.is_twintac()).count();
        let (mut num_twintacs, mut num_matrix) = (0, 0);
        for board in &boards {
            if board.is_twintac() {
                lines.push(format!("twintac{num_twintacs}"));
                num_twintacs += 1;
            } else {
                lines.push(if num_matrices == 1 { "fsr".to_owned() } else { format!("fsr{num_matrix}") });
                num_matrix += 1;
            }
        }
        let joints = station.robot.dofs();
        let hand = hand_dofs(station);
        let hand_joints = joints
            .enumerate()
            .filter(|(dof, _)| hand.contains(dof))
            .map(|(_, joint)| joint.name.clone())
            .collect();
        Self { lines, arm: ARM, hand_joints }
    }
}

/// Degrees of freedom that servos move.
fn hand_dofs(station: &Station) -> Vec<usize> {
    (0..station.robot.num_dofs()).filter(|dof| !station.carrier_dofs.contains(dof)).collect()
}

/// One client of the arm's command port.
#[derive(Clone, Debug)]
struct Connection {
    decoder: FrameDecoder,
    wire: Wire,
}

/// The devices of one station with the world around them.
pub struct EmulatedStation {
    station: Arc<Station>,
    names: DeviceNames,
    world: TruthWorld,
    bus: ServoBus,
    arm: ArmBox,
    boards: Vec<Board>,
    /// One for each line of the names.
    wires: Vec<Wire>,
    connections: BTreeMap<u64, Connection>,
    num_connections: u64,
    reports: Vec<(u64, ReportPort, Vec<u8>)>,
    faults: Faults,
    hand_dofs: Vec<usize>,
    /// Encoder less true position of every degree of freedom.
    offsets: Vec<f64>,
    /// True positions of every degree of freedom.
    positions: Vec<f64>,
    /// Object in place.
    object: Option<String>,
    /// Share of the layers' forces that the servos feel.
    resistance: f64,
    resistances: Vec<Resistance>,
    shared: Arc<Shared>,
    seed: u64,
    /// Steps done.
    num_steps: u64,
    /// What servos and arm move; without it they move the truth world themselves.
    bodies: Option<Moving>,
}

/// Bodies that something else simulates.
struct Moving {
    mechanics: Box<dyn Mechanics>,
    drives: Vec<Drive>,
    velocities: Vec<f64>,
    /// The arm has hit something, and has not moved away since.
    is_hit: bool,
}

impl EmulatedStation {
    /// The station of the truth file at `truth_path`, with the object of its first take in place and the robot at rest
    /// as at the start of a take.
    pub fn new(truth_path: &Path, seed: u64) -> Result<Self, EmulationError> {
        let emulation = Emulation::read(truth_path)?;
        let take = &emulation.plan().takes[0];
        let pose = emulation.plan().objects[&take.object]
            .to_isometry()
            .map_err(|problem| emulation.error(format!("object {:?}", take.object), problem))?;
        let world = TruthWorld::new(&emulation, &emulation.station().objects[&take.object], &pose, seed, 0)?;
        let mut objects = BTreeMap::new();
        for (id, pose) in &emulation.plan().objects {
            let place = || format!("object {id:?}");
            let pose = pose.to_isometry().map_err(|problem| emulation.error(place(), problem))?;
            let placed = Placed::new(&emulation, &emulation.station().objects[id], &pose)?;
            objects.insert(id.clone(), Arc::new(placed));
        }
        let object = Some(take.object.clone());
        Self::among(&emulation, emulation.rest(), world, object, objects, seed)
    }

    /// The same devices on robot, table and object that push each other. [`StationControl::place_object`] knows no object
    /// then: whoever made the bodies places them. Resistances ([`StationControl::set_resistance`]) come from the bodies.
    pub fn with_bodies(truth_path: &Path, seed: u64, bodies: Bodies) -> Result<Self, EmulationError> {
        let emulation = Emulation::read(truth_path)?;
        let num_dofs = emulation.station().robot.num_dofs();
        let Bodies { mechanics, positions, fixed } = bodies;
        if positions.len() != num_dofs {
            let problem = format!("has {num_dofs} degrees of freedom, the bodies have {}", positions.len());
            return Err(emulation.error("station", problem));
        }
        let world = TruthWorld::among(&emulation, &fixed, seed)?;
        let mut station = Self::among(&emulation, positions, world, None, BTreeMap::new(), seed)?;
        station.bodies = Some(Moving {
            mechanics,
            drives: vec![Drive::Torque { torque_nm: 0.0, is_jammed: false }; num_dofs],
            velocities: vec![0.0; num_dofs],
            is_hit: false,
        });
        station.feel_object();
        station.tell();
        Ok(station)
    }

    /// The devices in `world`, the robot's joints truly at `start`.
    fn among(
        emulation: &Emulation,
        start: Vec<f64>,
        mut world: TruthWorld,
        object: Option<String>,
        objects: BTreeMap<String, Arc<Placed>>,
        seed: u64,
    ) -> Result<Self, EmulationError> {
        let station = Arc::clone(emulation.station());
        if let Some((joint, mimic)) = station.robot.dofs().find_map(|joint| Some((joint, joint.mimic?))) {
            let problem = format!(
                "joint {:?} follows joint {:?}, and emulated devices have a servo for every joint of the hand; record sessions \
                 with palpate emulate instead",
                joint.name, station.robot.joints[mimic.joint].name
            );
            return Err(emulation.error("station", problem));
        }
        let hand_dofs = hand_dofs(&station);
        let ids_left = usize::from(palpate_device_protocol::dynamixel::MAX_ID) + 1;
        let offsets = emulation.encoder_offsets();
        let arm_model = ArmModel::new(Arc::clone(&station), start.clone());
        let (Some(arm_model), 1..) = (arm_model.filter(|_| hand_dofs.len() <= ids_left), hand_dofs.len())
        else {
            let problem = "has no hand on an arm of at most seven joints, which is what the emulated devices are: servos \
                           and an xArm; use a station such as xarm6_leap";
            return Err(emulation.error("station", problem));
        };
        world.advance(0.0, |_, positions| positions.copy_from_slice(&start), &mut |_| Ok(()))?;
        let encoder = |dof: usize| start[dof] + offsets[dof];
        let joints: Vec<_> = station.robot.dofs().collect();
        // Stops are where the joint really is; the encoder may see them elsewhere.
        let stops: Vec<(f64, f64)> = hand_dofs
            .iter()
            .map(|&dof| {
                let limits = joints[dof].limits;
                limits.map_or((f64::NEG_INFINITY, f64::INFINITY), |limits| {
                    (limits.lower + offsets[dof], limits.upper + offsets[dof])
                })
            })
            .collect();
        let hand_rad: Vec<f64> = hand_dofs.iter().map(|&dof| encoder(dof)).collect();
        let arm_rad: Vec<f64> = station.carrier_dofs.iter().map(|&dof| encoder(dof)).collect();
        let names = DeviceNames::of(&station);
        let wires = names.lines.iter().zip(0..).map(|(name, number)| Wire::new(name, seed, number)).collect();
        let new = Self {
            bus: ServoBus::new(&hand_rad, &stops),
            arm: ArmBox::new(arm_model, arm_rad),
            boards: Board::of(&station),
            wires,
            connections: BTreeMap::new(),
            num_connections: 0,
            reports: Vec::new(),
            faults: Faults::default(),
            hand_dofs,
            offsets,
            positions: start,
            object,
            resistance: 0.0,
            resistances: Vec::new(),
            shared: Arc::new(Shared::new(Arc::clone(&station), objects)),
            seed,
            num_steps: 0,
            bodies: None,
            names,
            station,
            world,
        };
        new.tell();
        Ok(new)
    }

    /// A handle that works while the station runs in another thread.
    pub fn control(&self) -> StationControl {
        StationControl::new(Arc::clone(&self.shared))
    }

    /// The station.
    pub fn station(&self) -> &Station {
        &self.station
    }

    /// Names of the serial lines: `u2d2`, `twintac0`, ..., `fsr`. Other calls count lines in this order.
    pub fn lines(&self) -> &[String] {
        &self.names.lines
    }

    /// Where the joints truly are, in the station's order, rad.
    pub fn positions(&self) -> &[f64] {
        &self.positions
    }

    /// Whether something else than the devices simulates what they move.
    #[cfg(unix)]
    pub(crate) fn has_bodies(&self) -> bool {
        self.bodies.is_some()
    }

    /// How far the station's time was behind the clock just now, and how much of it has been left out since the start.
    #[cfg(unix)]
    pub(crate) fn note_clock(&self, behind: std::time::Duration, left_out: std::time::Duration) {
        self.shared.note_clock(behind.as_nanos() as u64, left_out.as_nanos() as u64);
    }

    /// What is wrong at present.
    pub fn faults(&self) -> &Faults {
        &self.faults
    }

    /// Says what is wrong from `now_ns` on, in place of what was.
    pub fn set_faults(&mut self, faults: Faults, now_ns: u64) {
        self.advance(now_ns);
        self.shared.tell_faults(&faults);
        self.begin(faults, now_ns);
    }

    fn begin(&mut self, faults: Faults, now_ns: u64) {
        let hits = |fault: &Fault| *fault == Fault::Collision;
        if faults.faults.iter().any(hits) && !self.faults.faults.iter().any(hits) {
            self.arm.collide();
        }
        self.arm.press_stop(faults.faults.contains(&Fault::EmergencyStop));
        let mut servos = vec![ServoFaults::default(); self.hand_dofs.len()];
        for fault in &faults.faults {
            let Some(idx) =
                fault.joint().and_then(|joint| self.names.hand_joints.iter().position(|j| j == joint))
            else {
                continue;
            };
            match fault {
                Fault::Stuck { .. } => servos[idx].stuck = true,
                Fault::Overload { .. } => servos[idx].overload = true,
                Fault::NoPower { .. } => servos[idx].unpowered = true,
                Fault::Heating { rise_k, .. } => servos[idx].heating_k = *rise_k,
                _ => {}
            }
        }
        let supply_v = faults.faults.iter().find_map(|fault| match fault {
            Fault::Supply { volts } => Some(*volts),
            _ => None,
        });
        self.bus.set_faults(&servos, supply_v);
        for board in &mut self.boards {
            board.set_faults(&faults, now_ns);
        }
        let connections = self.connections.values_mut().map(|connection| &mut connection.wire);
        for wire in self.wires.iter_mut().chain(connections) {
            wire.set_faults(&faults);
        }
        self.faults = faults;
    }

    /// Lets time pass until `now_ns` since the station started. Time never runs back: an earlier one changes nothing.
    pub fn advance(&mut self, now_ns: u64) {
        for wish in self.shared.wishes() {
            self.grant(wish);
        }
        while self.num_steps < now_ns / STEP_NS {
            self.num_steps += 1;
            self.step();
        }
    }

    /// Does what a [`StationControl`] asked for.
    fn grant(&mut self, wish: Wish) {
        match wish {
            // The bodies say where the object is, and push back by themselves.
            Wish::Place(_) | Wish::Resistance(_) if self.bodies.is_some() => {}
            Wish::Place(object) => {
                let (id, placed) = object.unzip();
                self.world.place(placed);
                self.object = id;
            }
            Wish::Resistance(share) => self.resistance = share,
            Wish::Faults(faults) => self.begin(faults, self.num_steps * STEP_NS),
            Wish::Push { dof, push } => {
                let among = |dofs: &[usize]| dofs.iter().position(|&of| of == dof);
                if let Some(servo) = among(&self.hand_dofs) {
                    self.bus.push_joint(servo, push);
                } else if let Some(joint) = among(&self.station.carrier_dofs) {
                    self.arm.push_joint(joint, push);
                }
            }
        }
    }

    /// Tells handles where everything is.
    fn tell(&self) {
        self.shared.tell(|snapshot| {
            snapshot.device_ns = self.num_steps * STEP_NS;
            snapshot.positions.clone_from(&self.positions);
            snapshot.velocities.resize(self.positions.len(), 0.0);
            snapshot.torque_on.resize(self.positions.len(), false);
            snapshot.goals.resize(self.positions.len(), None);
            for (&dof, servo) in self.hand_dofs.iter().zip(self.bus.servos()) {
                snapshot.velocities[dof] = servo.rad_per_sec();
                snapshot.torque_on[dof] = servo.torque_is_on();
                snapshot.goals[dof] = servo.goal_rad();
            }
            for (joint, &dof) in self.station.carrier_dofs.iter().enumerate() {
                snapshot.velocities[dof] = self.arm.rad_per_sec()[joint];
                snapshot.torque_on[dof] = self.arm.is_driven(joint);
                snapshot.goals[dof] = self.arm.goal_rad(joint);
            }
            snapshot.arm = self.arm.snapshot();
            snapshot.object.clone_from(&self.object);
            snapshot.traffic.clear();
            snapshot.traffic.extend(self.wires.iter().map(Wire::traffic));
        });
    }

    /// Lets the servos feel what their fingers press on.
    fn resist(&mut self) {
        if self.resistance > 0.0 {
            self.world.resistances(&mut self.resistances);
        } else if self.resistances.is_empty() {
            return;
        } else {
            self.resistances.fill(Resistance::default());
        }
        for (idx, &dof) in self.hand_dofs.iter().enumerate() {
            let Resistance { torque_nm, stiffness_nm_per_rad } = self.resistances[dof];
            let felt = Resistance {
                torque_nm: self.resistance * torque_nm,
                stiffness_nm_per_rad: self.resistance * stiffness_nm_per_rad,
            };
            self.bus.resist(idx, felt);
        }
    }

    /// One step of bodies that something else simulates. The arm's encoders are those of its motors: what its links give way
    /// under a load does not show in them.
    fn step_bodies(&mut self) {
        let Some(bodies) = &mut self.bodies else { return };
        for (&dof, (torque_nm, is_jammed)) in self.hand_dofs.iter().zip(self.bus.drive()) {
            bodies.drives[dof] = Drive::Torque { torque_nm, is_jammed };
        }
        for (&dof, &velocity) in self.station.carrier_dofs.iter().zip(self.arm.rad_per_sec()) {
            bodies.drives[dof] = Drive::Motion { position: self.positions[dof], velocity };
        }
        bodies.mechanics.step(&bodies.drives, &mut self.positions, &mut bodies.velocities);
        let (positions, offsets, velocities) = (&self.positions, &self.offsets, &bodies.velocities);
        self.bus.follow(self.hand_dofs.iter().map(|&dof| (positions[dof] + offsets[dof], velocities[dof])));
        let is_hit = bodies.mechanics.arm_has_hit();
        if is_hit && !bodies.is_hit {
            self.arm.collide();
        }
        bodies.is_hit = is_hit;
        if self.num_steps.is_multiple_of(RESISTANCE_STEPS) {
            self.feel_object();
        }
    }

    /// Puts the object where the bodies have it, for the skin.
    fn feel_object(&mut self) {
        let Some(bodies) = &self.bodies else { return };
        let (id, placed) = match bodies.mechanics.object() {
            Some((felt, pose)) => (Some(felt.id.clone()), Some(Arc::new(felt.placed.moved(&pose)))),
            None => (None, None),
        };
        self.world.place(placed);
        self.object = id;
    }

    fn step(&mut self) {
        let step_s = STEP_NS as f64 * 1e-9;
        let now_ns = self.num_steps * STEP_NS;
        self.arm.step(step_s);
        for (&dof, encoder_rad) in self.station.carrier_dofs.iter().zip(&self.arm.joints_rad) {
            self.positions[dof] = encoder_rad - self.offsets[dof];
        }
        if self.bodies.is_some() {
            self.step_bodies();
        } else {
            self.bus.step();
            for (&dof, encoder_rad) in self.hand_dofs.iter().zip(self.bus.joints_rad()) {
                self.positions[dof] = encoder_rad - self.offsets[dof];
            }
        }
        let Self { world, positions, boards, wires, faults, .. } = self;
        let advanced =
            world.advance(now_ns as f64 * 1e-9, |_, at| at.copy_from_slice(positions), &mut |event| {
                if let Event::Tactile { stream, sample } = event {
                    // Wires of boards come after the servos'.
                    for (board, wire) in boards.iter().zip(&mut wires[1..]) {
                        if board.stream == stream && !faults.unplugged(wire.device()) {
                            let due_ns = sample.host_ns.unsigned_abs();
                            for line in board.lines(&sample.raw, due_ns) {
                                wire.send(due_ns, line);
                            }
                        }
                    }
                }
                Ok(())
            });
        debug_assert!(advanced.is_ok(), "the sink cannot fail");
        if self.bodies.is_none() && self.num_steps.is_multiple_of(RESISTANCE_STEPS) {
            self.resist();
        }
        self.tell();
        if self.faults.unplugged(ARM) {
            return;
        }
        for port in ReportPort::ALL {
            if self.num_steps.is_multiple_of(port.period_ms()) {
                let report = self.arm.report(port, now_ns);
                self.reports.push((now_ns, port, report));
            }
        }
    }

    /// Takes bytes that reached the devices on a line at `now_ns`. Only the servos listen.
    pub fn line_input(&mut self, line: usize, bytes: &[u8], now_ns: u64) {
        self.advance(now_ns);
        if line != 0 || self.faults.unplugged(SERVO_LINE) {
            return;
        }
        let mut bytes = bytes.to_vec();
        self.wires[0].damage(&mut bytes);
        for answer in self.bus.receive(now_ns, &bytes) {
            self.wires[0].send(answer.due_ns, answer.bytes);
        }
    }

    /// What has come out of a line by `now_ns`.
    pub fn line_output(&mut self, line: usize, now_ns: u64) -> Vec<u8> {
        self.advance(now_ns);
        self.wires.get_mut(line).map(|wire| wire.arrived(now_ns)).unwrap_or_default()
    }

    /// A client connects to the arm's command port.
    pub fn connect(&mut self) -> u64 {
        let number = self.num_connections;
        self.num_connections += 1;
        let mut wire = Wire::new(ARM, self.seed, FIRST_CONNECTION + number);
        wire.set_faults(&self.faults);
        self.connections.insert(number, Connection { decoder: FrameDecoder::default(), wire });
        number
    }

    /// A client of the arm's command port is gone.
    pub fn disconnect(&mut self, connection: u64) {
        self.connections.remove(&connection);
    }

    /// Takes bytes of a client of the arm that arrived at `now_ns`.
    pub fn arm_input(&mut self, connection: u64, bytes: &[u8], now_ns: u64) {
        self.advance(now_ns);
        let Some(Connection { decoder, wire }) = self.connections.get_mut(&connection) else { return };
        for request in decoder.feed(bytes) {
            // What the box answers always fits a frame.
            if let Some(Ok(bytes)) = self.arm.answer(&request).map(|answer| answer.encode()) {
                wire.send(now_ns + ARM_ANSWER_NS, bytes);
            }
        }
    }

    /// What has reached a client of the arm by `now_ns`.
    pub fn arm_output(&mut self, connection: u64, now_ns: u64) -> Vec<u8> {
        self.advance(now_ns);
        self.connections.get_mut(&connection).map(|c| c.wire.arrived(now_ns)).unwrap_or_default()
    }

    /// The reports that have come up by `now_ns`, in order; every client of the port gets the same.
    pub fn reports(&mut self, now_ns: u64) -> Vec<(ReportPort, Vec<u8>)> {
        self.advance(now_ns);
        let delay_ns = self.faults.faults.iter().find_map(|fault| match fault {
            Fault::Delay { device, delay_s } if device == ARM => Some((delay_s * 1e9) as u64),
            _ => None,
        });
        let due_by_ns = now_ns.saturating_sub(delay_ns.unwrap_or(0));
        let due = self.reports.partition_point(|(at_ns, ..)| *at_ns <= due_by_ns);
        self.reports.drain(..due).map(|(_, port, report)| (port, report)).collect()
    }

    /// When the next answer or line is due, if one is on its way.
    pub fn next_ns(&self) -> Option<u64> {
        let wires = self.wires.iter().chain(self.connections.values().map(|connection| &connection.wire));
        wires.filter_map(Wire::next_ns).min()
    }
}

#[cfg(test)]
mod tests;

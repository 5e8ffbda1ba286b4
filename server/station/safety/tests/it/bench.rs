//! A small station, and joints that do what they are told.

use palpate_robot_model::Station;
use palpate_safety::{JointReading, Lease, Measured, Phase, Setpoint, Supervisor};

/// One millisecond, ns.
pub(crate) const MS: u64 = 1_000_000;
/// Degrees of freedom: an arm that turns, a finger that turns, a rail that slides.
pub(crate) const ARM: usize = 0;
pub(crate) const FINGER: usize = 1;
pub(crate) const RAIL: usize = 2;

const STATION: &str = r#"id = "bench"
label = "Bench"
robot = "robot.urdf"
layout = "layout.toml"
nominal_model = "nominal.toml"
objects = []
joint_rate_hz = 50.0
joints = ["arm", "finger", "rail"]
carrier_joints = ["arm"]

[safety]
workspace = { min_m = [-1.0, -1.0, 0.1], max_m = [1.0, 1.0, 1.2] }

[[safety.joint]]
name = "rail"
velocity = 0.05
acceleration = 1.0

[[stream]]
stream = "film"
on_threshold = 30.0
off_threshold = 20.0
raw_min = 0.0
raw_max = 1023.0
"#;

const URDF: &str = r#"<robot name="bench"><link name="base"/><link name="upper"/><link name="lower"/><link name="tip"/>
<joint name="arm" type="revolute"><origin xyz="0 0 0.5"/><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-1.5" upper="1.5" velocity="3" effort="5"/></joint>
<joint name="finger" type="revolute"><origin xyz="0.3 0 0"/><parent link="upper"/><child link="lower"/><axis xyz="0 1 0"/>
<limit lower="-0.5" upper="1.2" velocity="8" effort="1"/></joint>
<joint name="rail" type="prismatic"><origin xyz="0.1 0 0"/><parent link="lower"/><child link="tip"/><axis xyz="1 0 0"/>
<limit lower="0" upper="0.1" velocity="0.1" effort="5"/></joint></robot>"#;

const LAYOUT: &str = r#"name = "One film sensor"
[[stream]]
id = "film"
label = "Film"
kind = "proximity"
rate_hz = 40.0
raw_unit = "counts"
[[patch]]
id = "pad"
label = "Pad"
group = "probe"
stream = "film"
link = "tip"
pose = { position_m = [0, 0, 0] }
shape = { kind = "rectangle", length_m = 0.01, width_m = 0.01 }
node_spacing_m = 0.002
"#;

/// The station of these tests, with `from` replaced by `to` in its file.
pub(crate) fn station_with(from: &str, to: &str) -> Station {
    assert!(STATION.contains(from), "the station has no {from:?}");
    read(&STATION.replacen(from, to, 1), URDF)
}

/// The station of these tests, with `shape` around the origin of the link "lower".
pub(crate) fn station_with_lower(shape: &str) -> Station {
    let shape = format!("<link name=\"lower\"><collision><geometry>{shape}</geometry></collision></link>");
    read(STATION, &URDF.replacen("<link name=\"lower\"/>", &shape, 1))
}

fn read(station: &str, urdf: &str) -> Station {
    Station::read("bench.toml", |path| {
        let text = match path {
            "bench.toml" => station.to_owned(),
            "robot.urdf" => urdf.to_owned(),
            "layout.toml" => LAYOUT.to_owned(),
            "nominal.toml" => String::new(),
            _ => return Err("no such file".to_owned()),
        };
        Ok(text.into_bytes())
    })
    .unwrap_or_else(|err| panic!("{err}"))
}

pub(crate) fn station() -> Station {
    station_with("", "")
}

/// A supervisor in a loop of 100 Hz whose joints are where they were told to be at the turn before.
pub(crate) struct Bench {
    pub(crate) supervisor: Supervisor,
    pub(crate) measured: Measured,
    pub(crate) now_ns: u64,
    pub(crate) sequence: u64,
    pub(crate) last: Option<Setpoint>,
    /// Joints follow, and telemetry comes.
    pub(crate) telemetry: bool,
}

impl Bench {
    pub(crate) fn new(station: &Station, positions: [f64; 3]) -> Self {
        let mut bench = Self {
            supervisor: Supervisor::new(station),
            measured: Measured::new(3),
            now_ns: 1_000 * MS,
            sequence: 0,
            last: None,
            telemetry: true,
        };
        for (dof, position) in positions.into_iter().enumerate() {
            bench.read(dof, position, 0.0, Some(false));
        }
        bench.supervisor.measured(bench.now_ns, &bench.measured);
        bench
    }

    /// Armed under a lease, after the time in which speeds are eased in.
    pub(crate) fn armed(positions: [f64; 3]) -> (Self, Lease) {
        let mut bench = Self::new(&station(), positions);
        let lease = bench.supervisor.acquire(bench.now_ns, "Ada", false).expect("nobody has control");
        bench.supervisor.arm(bench.now_ns, lease).expect("all is well");
        bench.run(1_100, Some(lease));
        assert_eq!(bench.phase(), Phase::Armed, "{}", bench.reason());
        (bench, lease)
    }

    pub(crate) fn read(&mut self, dof: usize, position: f64, velocity: f64, torque_on: Option<bool>) {
        let reading = JointReading { position, velocity, torque_on, received_ns: self.now_ns };
        self.measured.read(dof, reading);
    }

    /// One turn of the loop after `ms`, with a heartbeat under `lease`.
    pub(crate) fn turn(&mut self, ms: u64, lease: Option<Lease>) -> Setpoint {
        self.now_ns += ms * MS;
        if let Some(last) = self.last.clone().filter(|_| self.telemetry) {
            for dof in 0..3 {
                if self.measured.joints[dof].is_some() {
                    self.read(dof, last.positions()[dof], last.velocities()[dof], Some(last.torque()));
                }
            }
        }
        self.supervisor.measured(self.now_ns, &self.measured);
        if let Some(lease) = lease {
            self.supervisor.heartbeat(self.now_ns, self.now_ns, lease).expect("the lease is in force");
        }
        let setpoint = self.supervisor.tick(self.now_ns);
        self.last = Some(setpoint.clone());
        setpoint
    }

    /// Turns every 10 ms for `ms`; the last setpoint.
    pub(crate) fn run(&mut self, ms: u64, lease: Option<Lease>) -> Setpoint {
        let mut setpoint = self.turn(10, lease);
        for _ in 1..ms / 10 {
            setpoint = self.turn(10, lease);
        }
        setpoint
    }

    pub(crate) fn aim(&mut self, lease: Lease, targets: &[(usize, f64)]) -> Result<(), String> {
        self.sequence += 1;
        let taken = self.supervisor.targets(self.now_ns, lease, self.sequence, targets);
        taken.map_err(|refusal| refusal.to_string())
    }

    pub(crate) fn phase(&self) -> Phase {
        self.supervisor.status(self.now_ns).phase
    }

    pub(crate) fn reason(&self) -> String {
        self.supervisor.status(self.now_ns).reason
    }

    /// What the audit log has learnt, a line an entry.
    pub(crate) fn audit(&mut self) -> Vec<String> {
        let entries = self.supervisor.drain_audit();
        entries.iter().map(|entry| format!("{}: {entry}", entry.who)).collect()
    }
}

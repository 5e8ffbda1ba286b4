//! Laws for any sequence of calls at any times.

use palpate_robot_model::Station;
use palpate_safety::{
    JointReading, Lease, Measured, OUTSIDE_TOLERANCE_M, OUTSIDE_TOLERANCE_RAD, Phase, Setpoint, Supervisor,
};
use proptest::{prelude::*, strategy::ValueTree as _, test_runner::TestRunner};

use crate::bench::{ARM, FINGER, RAIL, station};

/// One call. Leases are picked among those that were ever given.
#[derive(Clone, Debug)]
enum Call {
    Acquire {
        take_over: bool,
    },
    Release(usize),
    Heartbeat(usize),
    Arm(usize),
    Disarm(usize),
    Stop,
    Reset(usize),
    Lead(usize, bool),
    Targets {
        lease: usize,
        sequence_less: u64,
        targets: Vec<(usize, f64)>,
    },
    Lost(usize),
    Fault(bool),
    /// Telemetry from now on: whether it comes, where joints are relative to their setpoint, and whether they hold.
    Telemetry {
        comes: bool,
        off: f64,
        honest: bool,
    },
    /// Turns of the loop, with heartbeats of the newest lease.
    Run {
        turns: usize,
        ms: f64,
        heartbeat: bool,
    },
}

fn call() -> impl Strategy<Value = Call> {
    // The newest lease mostly, so that something happens.
    let lease = prop_oneof![9 => Just(0_usize), 1 => 1_usize..3];
    let odd = prop::sample::select(vec![f64::NAN, f64::INFINITY, 9.0, -9.0, 1.5, -0.5, 1.2]);
    let target = prop_oneof![
        8 => (Just(ARM), -1.5..=1.5),
        20 => (Just(FINGER), -0.5..=1.2),
        20 => (Just(RAIL), 0.0..=0.1),
        2 => (0_usize..4, odd),
    ];
    let targets = prop::collection::vec(target, 0..3);
    prop_oneof![
        2 => prop::bool::weighted(0.3).prop_map(|take_over| Call::Acquire { take_over }),
        1 => lease.clone().prop_map(Call::Release),
        2 => lease.clone().prop_map(Call::Heartbeat),
        6 => lease.clone().prop_map(Call::Arm),
        1 => lease.clone().prop_map(Call::Disarm),
        1 => Just(Call::Stop),
        3 => lease.clone().prop_map(Call::Reset),
        6 => (lease.clone(), prop::bool::weighted(0.7)).prop_map(|(lease, on)| Call::Lead(lease, on)),
        16 => (lease, prop::bool::weighted(0.1).prop_map(u64::from), targets)
            .prop_map(|(lease, sequence_less, targets)| Call::Targets { lease, sequence_less, targets }),
        1 => (0_usize..3).prop_map(Call::Lost),
        1 => prop::bool::weighted(0.3).prop_map(Call::Fault),
        2 => (prop::bool::weighted(0.8), -0.01..0.01, prop::bool::weighted(0.9))
            .prop_map(|(comes, off, honest)| Call::Telemetry { comes, off, honest }),
        16 => (1_usize..60, prop_oneof![8 => Just(10.0), 2 => 0.001..30.0, 1 => 0.0..160.0], prop::bool::weighted(0.8))
            .prop_map(|(turns, ms, heartbeat)| Call::Run { turns, ms, heartbeat }),
    ]
}

/// A supervisor under test, with what a watcher outside it knows.
struct Watched {
    station: Station,
    supervisor: Supervisor,
    measured: Measured,
    leases: Vec<Lease>,
    now_ns: u64,
    sequence: u64,
    comes: bool,
    off: f64,
    honest: bool,
    /// When a heartbeat, or the arming that stands for one, was last accepted.
    heard_ns: u64,
    /// A stop was given, and since then no reset with an arming after it.
    stopped: bool,
    reset: bool,
    before: Option<(u64, Setpoint, Vec<f64>)>,
    setpoints: Vec<Setpoint>,
}

impl Watched {
    fn new() -> Self {
        let station = station();
        let mut watched = Self {
            supervisor: Supervisor::new(&station),
            station,
            measured: Measured::new(3),
            leases: vec![Lease(0)],
            now_ns: 1,
            sequence: 0,
            comes: true,
            off: 0.0,
            honest: true,
            heard_ns: 0,
            stopped: false,
            reset: false,
            before: None,
            setpoints: Vec::new(),
        };
        // Somewhere inside the workspace, armed by somebody, so that sequences begin with something to lose.
        watched.report(&[0.1, 0.2, 0.03], false);
        watched
    }

    fn report(&mut self, positions: &[f64], torque_on: bool) {
        for (dof, &position) in positions.iter().enumerate() {
            let reading = JointReading {
                position: position + self.off,
                velocity: 0.0,
                torque_on: Some(torque_on && self.honest),
                received_ns: self.now_ns,
            };
            self.measured.read(dof, reading);
        }
        self.supervisor.measured(self.now_ns, &self.measured);
    }

    /// A lease, and whether it is the newest; only the newest may ever be accepted.
    fn lease(&self, pick: usize) -> (Lease, bool) {
        let newest = self.leases.len() - 1;
        let pick = newest.saturating_sub(pick);
        (self.leases[pick], pick == newest)
    }

    fn heard(&mut self, accepted: bool) {
        if accepted {
            self.heard_ns = self.now_ns;
        }
    }

    fn call(&mut self, call: &Call) -> Result<(), TestCaseError> {
        let now_ns = self.now_ns;
        let phase = self.supervisor.status(now_ns).phase;
        let done = match call {
            Call::Acquire { take_over } => {
                if let Ok(lease) = self.supervisor.acquire(now_ns, "Ada", *take_over) {
                    prop_assert!(self.leases.iter().all(|old| *old < lease), "{:?} was given before", lease);
                    self.leases.push(lease);
                    self.sequence = 0;
                    // With nothing energised it does not matter, with something it is being disarmed.
                    self.heard_ns = now_ns;
                }
                None
            }
            Call::Release(pick) => {
                let (lease, newest) = self.lease(*pick);
                Some((newest, self.supervisor.release(now_ns, lease).is_ok()))
            }
            Call::Heartbeat(pick) => {
                let (lease, newest) = self.lease(*pick);
                let accepted = self.supervisor.heartbeat(now_ns, now_ns, lease).is_ok();
                self.heard(accepted);
                Some((newest, accepted))
            }
            Call::Arm(pick) => {
                let (lease, newest) = self.lease(*pick);
                let accepted = self.supervisor.arm(now_ns, lease).is_ok();
                if accepted && phase == Phase::Disarmed {
                    self.heard(true);
                    prop_assert!(!self.stopped || self.reset, "armed while stopped");
                    self.stopped = false;
                    // Commanded positions begin anew.
                    self.before = None;
                }
                Some((newest, accepted))
            }
            Call::Disarm(pick) => {
                let (lease, newest) = self.lease(*pick);
                Some((newest, self.supervisor.disarm(now_ns, lease).is_ok()))
            }
            Call::Stop => {
                self.supervisor.stop(now_ns, "Eve");
                (self.stopped, self.reset) = (true, false);
                None
            }
            Call::Reset(pick) => {
                let (lease, newest) = self.lease(*pick);
                let accepted = self.supervisor.reset_stop(now_ns, lease).is_ok();
                self.reset |= accepted;
                Some((newest, accepted))
            }
            Call::Lead(pick, on) => {
                let (lease, newest) = self.lease(*pick);
                Some((newest, self.supervisor.lead_through(now_ns, lease, *on).is_ok()))
            }
            Call::Targets { lease, sequence_less, targets } => {
                let (lease, newest) = self.lease(*lease);
                self.sequence += 1;
                let sequence = self.sequence - sequence_less;
                let accepted = self.supervisor.targets(now_ns, lease, sequence, targets).is_ok();
                let sensible = targets.iter().all(|&(dof, value)| {
                    let limits = self.station.safety.joints.get(dof);
                    limits.is_some_and(|limits| value >= limits.lower && value <= limits.upper)
                });
                prop_assert!(!accepted || sensible, "{:?} were accepted", targets);
                Some((newest, accepted))
            }
            Call::Lost(dof) => {
                self.measured.lost(&[*dof]);
                self.supervisor.measured(now_ns, &self.measured);
                None
            }
            Call::Fault(on) => {
                self.measured.set_fault("u2d2", None, if *on { "overload" } else { "" });
                self.supervisor.measured(now_ns, &self.measured);
                None
            }
            Call::Telemetry { comes, off, honest } => {
                (self.comes, self.off, self.honest) = (*comes, *off, *honest);
                None
            }
            Call::Run { turns, ms, heartbeat } => {
                for _ in 0..*turns {
                    self.now_ns += (ms * 1e6) as u64;
                    if *heartbeat {
                        let (lease, _) = self.lease(0);
                        let accepted = self.supervisor.heartbeat(self.now_ns, self.now_ns, lease).is_ok();
                        self.heard(accepted);
                    }
                    self.turn()?;
                }
                None
            }
        };
        if let Some((newest, accepted)) = done {
            prop_assert!(newest || !accepted, "an old lease was accepted for {:?}", call);
        }
        Ok(())
    }

    fn turn(&mut self) -> Result<(), TestCaseError> {
        if self.comes
            && let Some(last) = self.setpoints.last().cloned()
        {
            // A lost device is back.
            self.report(last.positions(), last.torque());
        }
        let now_ns = self.now_ns;
        let setpoint = self.supervisor.tick(now_ns);
        let limits = &self.station.safety.joints;
        prop_assert_eq!(setpoint.valid_until_ns(), now_ns + 150_000_000);
        prop_assert!(setpoint.positions().iter().chain(setpoint.velocities()).all(|value| value.is_finite()));
        prop_assert!(!(self.stopped && setpoint.torque()), "torque after a stop");
        prop_assert!(
            !setpoint.torque() || now_ns - self.heard_ns < 900_000_000,
            "torque without an operator"
        );
        if !setpoint.torque() {
            self.before = None;
            self.setpoints.push(setpoint);
            return Ok(());
        }
        for (dof, (&position, limits)) in setpoint.positions().iter().zip(limits).enumerate() {
            let tolerance = if dof == 2 { OUTSIDE_TOLERANCE_M } else { OUTSIDE_TOLERANCE_RAD };
            let led = dof == ARM && setpoint.lead_through();
            prop_assert!(
                led || (position >= limits.lower - tolerance && position <= limits.upper + tolerance),
                "joint {} is commanded to {}",
                dof,
                position
            );
        }
        let mut speeds = vec![0.0; 3];
        if let Some((before_ns, before, before_speeds)) = &self.before {
            let dt_s = (now_ns - before_ns) as f64 * 1e-9;
            for dof in 0..3 {
                if dof == ARM && (setpoint.lead_through() || before.lead_through()) {
                    continue;
                }
                let (limits, moved) = (&limits[dof], setpoint.positions()[dof] - before.positions()[dof]);
                let (rounding, speed) = (1e-13, before_speeds[dof]);
                prop_assert!(
                    moved.abs() <= limits.velocity * dt_s + rounding,
                    "joint {} moved {} in {} s",
                    dof,
                    moved,
                    dt_s
                );
                let straight = speed * dt_s;
                // The velocity that the positions say, and the one that is written beside them, are the same.
                prop_assert!((moved - setpoint.velocities()[dof] * dt_s).abs() <= rounding);
                prop_assert!(
                    (moved - straight).abs() <= limits.acceleration * dt_s * dt_s + rounding,
                    "joint {} at {} per s moved {} in {} s",
                    dof,
                    speed,
                    moved,
                    dt_s
                );
                // Beyond a limit it may have been found; there it does not go.
                let beyond = |position: f64| (limits.lower - position).max(position - limits.upper).max(0.0);
                prop_assert!(beyond(setpoint.positions()[dof]) <= beyond(before.positions()[dof]) + rounding);
                if now_ns - self.heard_ns >= 150_000_000 {
                    // Braking: never faster, whatever was aimed at.
                    prop_assert!(
                        setpoint.velocities()[dof].abs() <= speed.abs(),
                        "joint {} speeds up alone",
                        dof
                    );
                }
                speeds[dof] = setpoint.velocities()[dof];
                if dt_s == 0.0 {
                    speeds[dof] = speed;
                }
            }
        }
        self.before = Some((now_ns, setpoint.clone(), speeds));
        self.setpoints.push(setpoint);
        Ok(())
    }
}

/// Sequences that begin armed, because random ones rarely come that far.
fn sequence() -> impl Strategy<Value = Vec<Call>> {
    let began = [
        Call::Acquire { take_over: false },
        Call::Arm(0),
        Call::Run { turns: 60, ms: 10.0, heartbeat: true },
    ];
    prop::collection::vec(call(), 1..40).prop_map(move |calls| began.iter().cloned().chain(calls).collect())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn any_sequence_keeps_every_limit_and_the_same_one_gives_the_same_bits(calls in sequence()) {
        let (mut first, mut second) = (Watched::new(), Watched::new());
        for call in &calls {
            first.call(call)?;
            second.call(call)?;
        }
        prop_assert_eq!(&first.setpoints, &second.setpoints);
        prop_assert_eq!(first.supervisor.drain_audit(), second.supervisor.drain_audit());
        prop_assert_eq!(first.supervisor.status(first.now_ns), second.supervisor.status(second.now_ns));
    }

    #[test]
    fn no_time_of_any_call_panics(calls in prop::collection::vec((call(), any::<u64>()), 1..40)) {
        let mut supervisor = Supervisor::new(&station());
        let mut measured = Measured::new(2);
        for (call, now_ns) in calls {
            let lease = Lease(now_ns % 3);
            let reading = JointReading { position: now_ns as f64, velocity: 0.0, torque_on: None, received_ns: now_ns };
            measured.read((now_ns % 4) as usize, reading);
            supervisor.measured(now_ns, &measured);
            // What is refused is not looked at: the point is that nothing ends in a panic.
            let _ = match call {
                Call::Acquire { take_over } => supervisor.acquire(now_ns, "\u{7}", take_over).map(|_| ()),
                Call::Release(_) => supervisor.release(now_ns, lease),
                Call::Heartbeat(_) => supervisor.heartbeat(now_ns, now_ns, lease),
                Call::Arm(_) => supervisor.acquire(now_ns, "Ada", true).and_then(|lease| supervisor.arm(now_ns, lease)),
                Call::Disarm(_) => supervisor.disarm(now_ns, lease),
                Call::Reset(_) => supervisor.reset_stop(now_ns, lease),
                Call::Lead(_, on) => supervisor.lead_through(now_ns, lease, on),
                Call::Targets { targets, .. } => supervisor.targets(now_ns, lease, now_ns, &targets),
                Call::Stop => {
                    supervisor.stop(now_ns, "");
                    Ok(())
                }
                _ => Ok(()),
            };
            let setpoint = supervisor.tick(now_ns);
            prop_assert!(setpoint.positions().iter().all(|position| position.is_finite()));
            let _ = supervisor.status(now_ns);
        }
    }
}

/// The laws above say something only if joints move, stop, are led and are taken from one operator by another.
#[test]
fn sequences_reach_what_the_laws_are_about() {
    let mut runner = TestRunner::deterministic();
    let (mut moving, mut braking, mut led, mut taken, mut limp) = (0, 0, 0, 0, 0);
    for _ in 0..200 {
        let calls = sequence().new_tree(&mut runner).expect("nothing is filtered out").current();
        let mut watched = Watched::new();
        for call in &calls {
            watched.call(call).expect("the laws hold");
        }
        let moves = |setpoint: &Setpoint| {
            setpoint.torque() && setpoint.velocities().iter().any(|speed| *speed != 0.0)
        };
        moving += usize::from(watched.setpoints.iter().any(moves));
        let audit = watched.supervisor.drain_audit();
        let logged = |what: &str| audit.iter().any(|entry| entry.to_string().starts_with(what));
        braking += usize::from(logged("hold: ") || logged("disarm"));
        taken += usize::from(audit.iter().any(|entry| entry.to_string() == "take over control"));
        led += usize::from(watched.setpoints.iter().any(Setpoint::lead_through));
        limp += usize::from(logged("STOP"));
    }
    for (what, num) in
        [("move", moving), ("brake", braking), ("led", led), ("taken over", taken), ("stopped", limp)]
    {
        assert!(num >= 15, "only {num} of 200 sequences are about: {what}");
    }
}

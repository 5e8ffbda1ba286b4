//! The state machine between requests, readings and setpoints.

mod checks;
mod setpoint;
mod status;

use palpate_robot_model::{SafetyConfig, Station};
use std::sync::Arc;

pub use checks::{OUTSIDE_TOLERANCE_M, OUTSIDE_TOLERANCE_RAD};
pub use setpoint::Setpoint;
pub use status::{Phase, Status};

use crate::{
    AuditEntry, Lease, Measured, Outcome, Refusal,
    audit::Audit,
    lease::{LeaseDesk, name},
    measured::Telemetry,
    profile::Motion,
    workspace::Workspace,
};

/// Motors may take this long to report that they hold, ns: an arm lets its brakes go one after the other.
const ARMING_NS: u64 = 5_000_000_000;
/// Motors may take this long to report that they have let go before they are armed again, ns: an arm stops first, and
/// switches off once it stands still.
const LETTING_GO_NS: u64 = 2_000_000_000;
/// Disarming begins this long before `disarm_after_s` is over, ns: until torque is off a turn of the loop, a cycle of the
/// bus and the arm's own steps of stopping and switching off go by.
const DISARM_AHEAD_NS: u64 = 100_000_000;
/// Torque stays on this long after all goals have come to rest when disarming, ns: soft servos lag behind their goals, and a
/// joint that is let go while it moves runs on until friction or its stop ends that.
const CATCH_UP_NS: u64 = 100_000_000;
/// The same where a device has a fault or is not read: a line that loses answers carries goals late too, ns.
const CATCH_UP_UNSEEN_NS: u64 = 300_000_000;
/// Who the audit log names for what nobody asked for.
const STATION: &str = "station";

/// Stands between everybody who wants to move a station and its motors. One per station.
///
/// # Example
/// ```no_run
/// # fn station() -> palpate_robot_model::Station { unimplemented!() }
/// use palpate_safety::{JointReading, Measured, Supervisor};
///
/// let mut supervisor = Supervisor::new(&station());
/// let mut measured = Measured::new(1);
/// measured.read(0, JointReading { position: 0.1, velocity: 0.0, torque_on: Some(false), received_ns: 5 });
/// supervisor.measured(5, &measured);
/// let lease = supervisor.acquire(6, "Ada", false)?;
/// supervisor.arm(7, lease)?;
/// let setpoint = supervisor.tick(8);
/// assert!(setpoint.torque() && setpoint.positions() == [0.1]);
/// # Ok::<(), palpate_safety::Refusal>(())
/// ```
#[derive(Clone, Debug)]
pub struct Supervisor {
    station: Arc<Station>,
    times: Times,
    workspace: Option<Workspace>,
    now_ns: u64,
    desk: LeaseDesk,
    heartbeat_ns: u64,
    /// The operator's connection was closed since their last sign of life.
    operator_gone: bool,
    /// Number of the newest targets of this lease.
    sequence: u64,
    state: State,
    hold: Option<Hold>,
    lead: Lead,
    /// The arm was told to yield, and may be anywhere since.
    hands: bool,
    /// What kept lead-through from ending at the last try.
    lead_notice: String,
    /// Why it was disarmed last; empty where somebody asked for it.
    disarmed_because: String,
    joints: Vec<Joint>,
    telemetry: Telemetry,
    last_tick_ns: Option<u64>,
    /// Since when setpoints have had no torque; `None` while they have.
    limp_since_ns: Option<u64>,
    /// Since when no goal has moved.
    goals_stand_since_ns: Option<u64>,
    /// Whether the audit log knows that joints were moved since they were armed.
    moved: bool,
    audit: Audit,
}

/// The station's times, ns.
#[derive(Clone, Copy, Debug)]
struct Times {
    heartbeat_ttl: u64,
    /// Disarming begins after this much silence.
    disarm_begins: u64,
    command_ttl: u64,
    telemetry_ttl: u64,
    ease_in: u64,
}

#[derive(Clone, Debug)]
enum State {
    Disarmed,
    /// Motors still let go from before.
    LettingGo,
    /// Torque comes up; `since_ns` for the time it may take.
    Arming {
        since_ns: u64,
    },
    /// Speeds are eased in from `since_ns` on.
    Armed {
        since_ns: u64,
    },
    /// Brakes, then torque goes off, `catch_up_ns` after the last goal came to rest.
    Disarming {
        catch_up_ns: u64,
    },
    Stopped {
        since_ns: u64,
        who: String,
    },
}

/// Why joints stand still though they are armed.
#[derive(Clone, Debug, PartialEq)]
enum Hold {
    /// Until the operator is back.
    Heartbeat,
    /// Until the joints can be seen again.
    Telemetry(String),
    /// Until there are other targets.
    Workspace(String),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Lead {
    Off,
    On,
    /// Ends as soon as the arm stands still.
    Ending,
}

#[derive(Clone, Debug)]
struct Joint {
    motion: Motion,
    target: Option<f64>,
    carrier: bool,
    /// Readings from then on tell whether its motor holds.
    torque_asked_ns: u64,
    /// Its motor has shown that it holds, and must not let go.
    holds: bool,
}

impl Supervisor {
    /// Watches over `station`: disarmed, with nobody in control.
    pub fn new(station: &Station) -> Self {
        let config = &station.safety;
        let num_dofs = station.robot.num_dofs();
        let joint = |dof: usize| Joint {
            motion: Motion::default(),
            target: None,
            carrier: station.carrier_dofs.contains(&dof),
            torque_asked_ns: 0,
            holds: false,
        };
        Self {
            times: Times {
                heartbeat_ttl: nanoseconds(config.heartbeat_ttl_s),
                disarm_begins: nanoseconds(disarm_begins_s(config)),
                command_ttl: nanoseconds(config.command_ttl_s),
                telemetry_ttl: nanoseconds(config.telemetry_ttl_s),
                ease_in: nanoseconds(config.ease_in_s),
            },
            workspace: Workspace::of(station),
            now_ns: 0,
            desk: LeaseDesk::new(nanoseconds(config.lease_ttl_s)),
            heartbeat_ns: 0,
            operator_gone: false,
            sequence: 0,
            state: State::Disarmed,
            hold: None,
            lead: Lead::Off,
            hands: false,
            lead_notice: String::new(),
            disarmed_because: String::new(),
            joints: (0..num_dofs).map(joint).collect(),
            telemetry: Telemetry::new(num_dofs),
            last_tick_ns: None,
            limp_since_ns: Some(0),
            goals_stand_since_ns: None,
            moved: false,
            audit: Audit::default(),
            station: Arc::new(station.clone()),
        }
    }

    /// Gives `operator` the lease. With `take_over` also if somebody else has it, whose motion ends then: joints brake and
    /// torque goes off, so that whoever takes over arms them deliberately.
    pub fn acquire(&mut self, now_ns: u64, operator: &str, take_over: bool) -> Result<Lease, Refusal> {
        self.settle(now_ns);
        let who = name(operator);
        let what = if take_over { "take over control" } else { "take control" };
        let acquired = self.desk.acquire(self.now_ns, operator, take_over);
        self.log(&who, what, acquired.as_ref().err());
        let (lease, before) = acquired?;
        self.sign_of_life();
        self.sequence = 0;
        if let Some(before) = before {
            self.begin_disarm(
                &who,
                format!("{who:?} took over from {:?}; arm again when all is well", before.operator),
            );
        }
        Ok(lease)
    }

    /// Gives the lease back and disarms.
    pub fn release(&mut self, now_ns: u64, lease: Lease) -> Result<(), Refusal> {
        let who = self.holder_of(now_ns, lease, "give control back")?;
        self.log(&who, "give control back", None);
        self.desk.release();
        self.begin_disarm(&who, String::new());
        Ok(())
    }

    /// The operator was there at `received_ns`, when the heartbeat came in. Keeps the lease, and motion going, from then on
    /// and not from `now_ns` on: one that waited in a queue says nothing about the present.
    pub fn heartbeat(&mut self, now_ns: u64, received_ns: u64, lease: Lease) -> Result<(), Refusal> {
        self.settle(now_ns);
        let received_ns = received_ns.min(self.now_ns);
        self.desk.check(self.now_ns, lease).map(|holder| {
            holder.renewed_ns = received_ns.max(holder.renewed_ns);
        })?;
        if received_ns >= self.heartbeat_ns {
            (self.heartbeat_ns, self.operator_gone) = (received_ns, false);
        }
        Ok(())
    }

    /// The operator's connection was closed: joints brake and hold at once, rather than when heartbeats are missed. The
    /// lease and the time until torque goes off count from the last sign of life, as ever.
    pub fn operator_gone(&mut self, now_ns: u64, lease: Lease) {
        self.settle(now_ns);
        if self.desk.check(self.now_ns, lease).is_ok() {
            self.operator_gone = true;
            self.settle(now_ns);
        }
    }

    /// Torque on, where the joints are now, as soon as motors that still let go have done so. Old targets are gone, and
    /// speeds rise from zero. Armed already, it stays so.
    pub fn arm(&mut self, now_ns: u64, lease: Lease) -> Result<(), Refusal> {
        let who = self.holder_of(now_ns, lease, "arm")?;
        let ready = match &self.state {
            State::Armed { .. } | State::Arming { .. } | State::LettingGo => return Ok(()),
            State::Stopped { who, .. } => Err(Refusal::Stopped { who: who.clone() }),
            State::Disarming { .. } => {
                Err(Refusal::NotArmed { phase: "just being disarmed", todo: "wait a moment, then arm" })
            }
            State::Disarmed => match self.not_ready(self.now_ns) {
                Some(problem) => Err(Refusal::NotReady { problem }),
                None => Ok(()),
            },
        };
        self.log(&who, "arm", ready.as_ref().err());
        ready?;
        // To ask for torque is a sign of life.
        self.sign_of_life();
        (self.hold, self.lead, self.hands, self.moved) = (None, Lead::Off, false, false);
        self.lead_notice.clear();
        self.disarmed_because.clear();
        self.joints.iter_mut().for_each(|joint| joint.holds = false);
        self.state = State::LettingGo;
        self.settle(now_ns);
        Ok(())
    }

    /// Joints brake, then torque goes off.
    pub fn disarm(&mut self, now_ns: u64, lease: Lease) -> Result<(), Refusal> {
        let who = self.holder_of(now_ns, lease, "disarm")?;
        if !self.begin_disarm(&who, String::new()) {
            self.disarmed_because.clear();
        }
        Ok(())
    }

    /// Torque off at the next tick, until somebody resets it. Anybody may stop a station at any time.
    pub fn stop(&mut self, now_ns: u64, who: &str) {
        self.settle(now_ns);
        let who = name(who);
        self.log(&who, "STOP", None);
        if matches!(self.state, State::Stopped { .. }) {
            return;
        }
        self.stand_still();
        self.disarmed_because.clear();
        self.state = State::Stopped { since_ns: self.now_ns, who };
    }

    /// The program is about to end: nobody has the lease any more, joints brake, then torque goes off. Go on calling
    /// [`Supervisor::tick`] until [`Supervisor::not_let_go`] is empty.
    pub fn shut_down(&mut self, now_ns: u64) {
        self.settle(now_ns);
        self.desk.release();
        self.log(STATION, "the studio shuts down", None);
        self.begin_disarm(STATION, "the studio shuts down".to_owned());
    }

    /// Ends a latched stop. Joints stay disarmed.
    pub fn reset_stop(&mut self, now_ns: u64, lease: Lease) -> Result<(), Refusal> {
        let who = self.holder_of(now_ns, lease, "reset the stop")?;
        let stopped = matches!(self.state, State::Stopped { .. });
        let reset = if stopped { Ok(()) } else { Err(Refusal::NotStopped) };
        self.log(&who, "reset the stop", reset.as_ref().err());
        reset?;
        self.state = State::Disarmed;
        Ok(())
    }

    /// Lets the arm yield to the operator's hands, or hold again. It holds from where it then is, once it stands still.
    pub fn lead_through(&mut self, now_ns: u64, lease: Lease, on: bool) -> Result<(), Refusal> {
        let what = if on { "lead the arm by hand" } else { "let the arm hold" };
        let who = self.holder_of(now_ns, lease, what)?;
        let allowed = match (on, self.lead) {
            (true, Lead::Off) => self.may_lead(),
            _ => self.following(),
        };
        self.log(&who, what, allowed.as_ref().err());
        allowed?;
        match (on, self.lead) {
            (true, _) => {
                self.lead = Lead::On;
                self.lead_notice.clear();
                for joint in self.joints.iter_mut().filter(|joint| joint.carrier) {
                    joint.target = None;
                }
            }
            (false, Lead::On) => self.lead = Lead::Ending,
            (false, _) => {}
        }
        Ok(())
    }

    /// Where joints shall go: degrees of freedom with positions. Joints that are not named keep their target. Either all of
    /// it is taken or, with the joint at fault named, none. `sequence` rises with every call of a lease.
    pub fn targets(
        &mut self,
        now_ns: u64,
        lease: Lease,
        sequence: u64,
        targets: &[(usize, f64)],
    ) -> Result<(), Refusal> {
        let who = self.holder_of(now_ns, lease, "move joints")?;
        let checked = self.check_targets(sequence, targets);
        if checked.is_err() || !self.moved {
            self.log(&who, "move joints", checked.as_ref().err());
        }
        self.sequence = self.sequence.max(sequence);
        checked?;
        self.moved = true;
        if matches!(self.hold, Some(Hold::Workspace(_))) {
            self.hold = None;
        }
        for &(dof, position) in targets {
            self.joints[dof].target = Some(position);
        }
        Ok(())
    }

    /// What joints and devices report now.
    pub fn measured(&mut self, now_ns: u64, measured: &Measured) {
        self.now_ns = self.now_ns.max(now_ns);
        self.telemetry.take(self.now_ns, measured);
        self.settle(now_ns);
    }

    /// One turn of the control loop: the only thing that makes setpoints.
    pub fn tick(&mut self, now_ns: u64) -> Setpoint {
        self.settle(now_ns);
        let before_ns = self.last_tick_ns.replace(self.now_ns).unwrap_or(self.now_ns);
        let step_ns = self.now_ns - before_ns;
        if self.energised() && step_ns > self.times.command_ttl {
            // The last setpoint has run out; what the motors did since then is not known.
            let why = format!("the control loop stood still for {:.2} s; arm again", step_ns as f64 * 1e-9);
            self.begin_disarm(STATION, why);
            self.stand_still();
        }
        if self.energised() {
            self.hands = self.lead != Lead::Off;
            self.follow_hands();
            self.step(step_ns as f64 * 1e-9);
            let stand = self.joints.iter().all(|joint| joint.motion.velocity == 0.0);
            self.goals_stand_since_ns = stand.then(|| self.goals_stand_since_ns.unwrap_or(self.now_ns));
            if let State::Disarming { catch_up_ns } = self.state {
                let caught_up =
                    self.goals_stand_since_ns.is_some_and(|since| self.now_ns - since >= catch_up_ns);
                // Where it may not be held, an arm that was led there is let go at once.
                if caught_up || self.outside_limits().is_some() {
                    self.state = State::Disarmed;
                }
            }
        }
        if self.energised() {
            self.limp_since_ns = None;
        } else {
            self.limp_since_ns.get_or_insert(self.now_ns);
            self.follow_readings();
        }
        Setpoint::new(
            self.energised(),
            self.lead != Lead::Off,
            self.joints.iter().map(|joint| joint.motion),
            self.now_ns.saturating_add(self.times.command_ttl),
        )
    }

    /// What the layer is up to.
    pub fn status(&self, now_ns: u64) -> Status {
        self.describe(now_ns.max(self.now_ns))
    }

    /// Where a joint is to go, rad or m; `None` while nothing is aimed at, as after a hold.
    pub fn target(&self, dof: usize) -> Option<f64> {
        self.joints.get(dof)?.target
    }

    /// Who stopped the station, while the stop is latched.
    pub fn stopped_by(&self) -> Option<&str> {
        match &self.state {
            State::Stopped { who, .. } => Some(who),
            _ => None,
        }
    }

    /// Entries of the audit log since the last call.
    pub fn drain_audit(&mut self) -> Vec<AuditEntry> {
        self.audit.drain()
    }

    /// Whether motors are to hold or move their joints.
    fn energised(&self) -> bool {
        matches!(self.state, State::Arming { .. } | State::Armed { .. } | State::Disarming { .. })
    }

    /// Whether the operator wants joints to hold or move.
    fn wanted(&self) -> bool {
        matches!(self.state, State::LettingGo | State::Arming { .. } | State::Armed { .. })
    }

    /// Lets happen what has become due by `now_ns`. Time never runs back: an earlier one counts as the latest there was.
    fn settle(&mut self, now_ns: u64) {
        self.now_ns = self.now_ns.max(now_ns);
        let now_ns = self.now_ns;
        if let Some(holder) = self.desk.expire(now_ns) {
            self.log(STATION, &format!("the lease of {:?} ran out", holder.operator), None);
            self.begin_disarm(
                STATION,
                format!("the lease of {:?} ran out; take control again", holder.operator),
            );
        }
        if !self.wanted() {
            return;
        }
        if let Some(problem) = self.must_disarm() {
            self.begin_disarm(STATION, problem);
            return;
        }
        match self.must_hold() {
            Some(hold) => self.begin_hold(hold),
            None if !matches!(self.hold, Some(Hold::Workspace(_))) => self.hold = None,
            None => {}
        }
        if self.lead == Lead::Ending && self.hold.is_none() {
            self.try_to_end_lead();
        }
        if matches!(self.state, State::LettingGo) && !self.still_lets_go() {
            // Limp joints may have gone anywhere meanwhile.
            match self.not_ready(now_ns) {
                Some(problem) => _ = self.begin_disarm(STATION, problem),
                None => self.ask_for_torque(),
            }
        }
        if matches!(self.state, State::Arming { .. })
            && (0..self.joints.len()).all(|dof| self.joints[dof].holds || self.shows_torque(dof))
        {
            self.joints.iter_mut().for_each(|joint| joint.holds = true);
            self.state = State::Armed { since_ns: now_ns };
        }
    }

    fn sign_of_life(&mut self) {
        (self.heartbeat_ns, self.operator_gone) = (self.now_ns, false);
    }

    /// Whether a motor has not yet reported that it let go since torque went off. What it reports until then is of the
    /// time before, and would look like a motor that holds and then lets go. One that never lets go, as an arm that
    /// another program has switched on, is not waited for.
    fn still_lets_go(&self) -> bool {
        let Some(since_ns) = self.limp_since_ns else { return true };
        let mut readings = self.telemetry.joints.iter().filter_map(|joint| joint.reading);
        self.now_ns.saturating_sub(since_ns) < LETTING_GO_NS
            && readings.any(|reading| reading.received_ns <= since_ns || reading.torque_on == Some(true))
    }

    /// Torque comes up where the joints are now.
    fn ask_for_torque(&mut self) {
        self.follow_readings();
        for joint in &mut self.joints {
            (joint.target, joint.torque_asked_ns) = (None, self.now_ns);
        }
        self.last_tick_ns = Some(self.now_ns);
        self.state = State::Arming { since_ns: self.now_ns };
    }

    /// Whether its motor holds the joint, by a reading taken since it was asked to.
    fn shows_torque(&self, dof: usize) -> bool {
        let asked_ns = self.joints[dof].torque_asked_ns;
        let reading = self.telemetry.joints[dof].reading.filter(|reading| reading.received_ns > asked_ns);
        reading.is_some_and(|reading| reading.torque_on != Some(false))
    }

    fn begin_hold(&mut self, hold: Hold) {
        if self.hold.as_ref() == Some(&hold) {
            return;
        }
        let changed = self.hold.as_ref().map(std::mem::discriminant) != Some(std::mem::discriminant(&hold));
        if changed {
            self.log(STATION, &format!("hold: {}", hold.reason()), None);
        }
        let workspace = matches!(hold, Hold::Workspace(_));
        self.hold = Some(hold);
        // What was aimed at before the operator was lost is no longer wanted when they are back.
        for joint in &mut self.joints {
            joint.target = None;
        }
        if self.lead != Lead::Off && !workspace {
            self.end_lead();
            if let Some(problem) = self.outside_limits() {
                self.begin_disarm(STATION, problem);
            }
        }
    }

    /// Brakes, then torque off; whether there was any.
    fn begin_disarm(&mut self, who: &str, because: String) -> bool {
        if !self.wanted() {
            return false;
        }
        let what = if because.is_empty() { "disarm".to_owned() } else { format!("disarm: {because}") };
        self.log(who, &what, None);
        for joint in &mut self.joints {
            joint.target = None;
        }
        let catch_up_ns = if self.sees_all() { CATCH_UP_NS } else { CATCH_UP_UNSEEN_NS };
        self.state = if self.energised() { State::Disarming { catch_up_ns } } else { State::Disarmed };
        (self.hold, self.lead) = (None, Lead::Off);
        self.lead_notice.clear();
        self.disarmed_because = because;
        true
    }

    /// Without motion from now on.
    fn stand_still(&mut self) {
        for joint in &mut self.joints {
            (joint.target, joint.motion.velocity) = (None, 0.0);
        }
        (self.hold, self.lead) = (None, Lead::Off);
        self.lead_notice.clear();
    }

    /// While the arm is led by hand it is commanded to be where it is, so that nothing jumps when it holds again.
    fn follow_hands(&mut self) {
        if !self.hands {
            return;
        }
        for (joint, telemetry) in self.joints.iter_mut().zip(&self.telemetry.joints) {
            if let Some(reading) = telemetry.reading.filter(|_| joint.carrier) {
                joint.motion = Motion { position: reading.position, velocity: 0.0 };
            }
        }
    }

    /// Without torque, a setpoint says where the joints are.
    fn follow_readings(&mut self) {
        for (joint, telemetry) in self.joints.iter_mut().zip(&self.telemetry.joints) {
            let position = telemetry.reading.map_or(joint.motion.position, |reading| reading.position);
            joint.motion = Motion { position, velocity: 0.0 };
        }
    }

    fn try_to_end_lead(&mut self) {
        let carriers = || self.joints.iter().zip(&self.telemetry.joints).filter(|(joint, _)| joint.carrier);
        if !carriers().all(|(_, telemetry)| telemetry.at_rest(0)) {
            self.lead_notice = "let go of the arm; it holds once it stands still".to_owned();
            return;
        }
        self.follow_hands();
        match self.outside_limits() {
            Some(problem) => self.lead_notice = problem,
            None => self.end_lead(),
        }
    }

    /// The arm holds where it is. As after arming, its motors have to show that they do.
    fn end_lead(&mut self) {
        self.follow_hands();
        (self.lead, self.hands) = (Lead::Off, false);
        self.lead_notice.clear();
        let now_ns = self.now_ns;
        for joint in self.joints.iter_mut().filter(|joint| joint.carrier) {
            (joint.torque_asked_ns, joint.holds) = (now_ns, false);
        }
        self.state = State::Arming { since_ns: now_ns };
    }

    /// Moves every joint on by `dt_s`.
    fn step(&mut self, dt_s: f64) {
        let share = match self.state {
            State::Armed { since_ns } if self.times.ease_in > 0 => {
                ((self.now_ns - since_ns) as f64 / self.times.ease_in as f64).min(1.0)
            }
            State::Armed { .. } => 1.0,
            _ => 0.0,
        };
        let led = self.lead != Lead::Off;
        let limits = &self.station.safety.joints;
        let moved = |towards_targets: bool| -> Vec<Motion> {
            let joints = self.joints.iter().zip(limits);
            let step = |(joint, limits): (&Joint, &palpate_robot_model::JointSafety)| {
                if joint.carrier && led {
                    return joint.motion;
                }
                let target = joint.target.filter(|_| towards_targets);
                joint.motion.step(target, limits, share * limits.velocity, dt_s)
            };
            joints.map(step).collect()
        };
        let mut next = moved(true);
        let aims = self.joints.iter().any(|joint| joint.target.is_some());
        let objection = if aims { self.objection(&next) } else { None };
        if objection.is_some() {
            next = moved(false);
        }
        for (joint, motion) in self.joints.iter_mut().zip(next) {
            joint.motion = motion;
        }
        if let Some(problem) = objection {
            self.begin_hold(Hold::Workspace(problem));
        }
    }

    /// What speaks against a step: the skin would leave the workspace in it, or when braking after it.
    fn objection(&self, next: &[Motion]) -> Option<String> {
        let workspace = self.workspace.as_ref()?;
        let limits = &self.station.safety.joints;
        let at = |positions: Vec<f64>| workspace.outside(&self.station, &positions);
        let now = at(self.joints.iter().map(|joint| joint.motion.position).collect());
        let stepped = at(next.iter().map(|motion| motion.position).collect());
        let stopped =
            at(next.iter().zip(limits).map(|(motion, limits)| motion.stop_position(limits)).collect());
        let objection = |outside| workspace.objection(&self.station, &now, outside);
        objection(&stopped).or_else(|| objection(&stepped))
    }

    /// The operator's name if `lease` is theirs; the audit log learns who tried `what` without.
    fn holder_of(&mut self, now_ns: u64, lease: Lease, what: &str) -> Result<String, Refusal> {
        self.settle(now_ns);
        let held = self.desk.check(self.now_ns, lease).map(|holder| holder.operator.clone());
        if let Err(refusal) = &held {
            self.log(&format!("lease {}", lease.0), what, Some(refusal));
        }
        held
    }

    fn log(&mut self, who: &str, what: &str, refusal: Option<&Refusal>) {
        let outcome = refusal.map_or(Outcome::Done, |refusal| Outcome::Refused(refusal.to_string()));
        self.audit.note(self.now_ns, who, what, outcome);
    }
}

impl Hold {
    fn reason(&self) -> &str {
        match self {
            Self::Heartbeat => {
                "nothing is heard of the operator; motion goes on with new targets once the page is back"
            }
            Self::Telemetry(problem) | Self::Workspace(problem) => problem,
        }
    }
}

/// Silence of operators, readings or setpoints after which disarming begins, s, so that torque is off by
/// `disarm_after_s`. Joints hold before, whatever the times of the station are.
pub fn disarm_begins_s(config: &SafetyConfig) -> f64 {
    let ahead_s = config.disarm_after_s - DISARM_AHEAD_NS as f64 * 1e-9;
    ahead_s.max(config.heartbeat_ttl_s).max(config.telemetry_ttl_s).max(config.command_ttl_s)
}

fn nanoseconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

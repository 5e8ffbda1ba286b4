//! The arm: a connection for commands and a stream of reports, driven by one thread while another reads the reports.
//!
//! [`Session`] decides what is said and when; here are the sockets and the clock. Nothing here waits for the box: a
//! stall of the network holds up neither a stop nor the reading of reports.

mod codes;
mod connection;
mod follow;
mod session;
mod velocity;

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use palpate_device_protocol::xarm::{NUM_JOINT_SLOTS, Report};

use crate::clock_map::ClockMap;
use crate::context::{DeviceContext, Goal};
use crate::event::{DeviceEvent, Link};
use connection::{Connection, Received};
pub(crate) use follow::Limits;
use session::{Order, Session, TICK_NS};
use velocity::VelocityEstimate;

/// An arm that is let go has this long to stop and switch off, ns.
const FAREWELL_NS: u64 = 1_500_000_000;
/// Reports later than this many of their periods are gaps.
const LATE_PERIODS: u64 = 3;

/// What the driver has to know about an arm.
#[derive(Clone, Debug)]
pub(crate) struct ArmSetup {
    /// Address and port of commands.
    pub(crate) commands: SocketAddr,
    /// Address and port of reports: 30003 at 100 Hz, 30000 at 250 Hz, 30001 and 30002 at 5 Hz with errors and more.
    pub(crate) reports: SocketAddr,
    /// Degrees of freedom of its joints, from the base on.
    pub(crate) dofs: Arc<[usize]>,
    /// Their names.
    pub(crate) joints: Vec<String>,
    /// How fast they may go.
    pub(crate) limits: Limits,
    /// How long it holds once setpoints have dried up, ns.
    pub(crate) hold_ns: u64,
}

/// Drives the arm until the context says stop.
pub(crate) fn run(context: &DeviceContext, setup: &ArmSetup) {
    let mut session =
        Session::new(setup.joints.clone(), setup.limits.clone(), setup.hold_ns, context.goals.disarms());
    if context.has_failed.load(Ordering::Relaxed) {
        session.take_over();
    }
    context.health.set_motors(setup.joints.iter().cloned());
    context.keep_connected(
        |context| Connection::open(&context.id, setup.commands, setup.reports, &context.clock),
        |context, connection| {
            let mut conversation = Conversation::new(context, setup, &mut session, connection);
            let served = conversation.run();
            // Told before the conversation's last words, which take a moment: the other joints are still moving.
            context.lost(&served);
            served
        },
    );
}

/// One connection's worth of driving. The arm is stopped and switched off when this is dropped, also by a panic, unless it
/// is already.
struct Conversation<'a> {
    connection: Connection,
    context: &'a DeviceContext,
    setup: &'a ArmSetup,
    session: &'a mut Session,
    clock_map: ClockMap,
    velocities: VelocityEstimate,
    last_received_ns: Option<u64>,
    last_link: Option<(Link, String)>,
}

impl<'a> Conversation<'a> {
    fn new(
        context: &'a DeviceContext,
        setup: &'a ArmSetup,
        session: &'a mut Session,
        connection: Connection,
    ) -> Self {
        let velocities = VelocityEstimate::new(setup.joints.len());
        let clock_map = ClockMap::default();
        Self {
            connection,
            context,
            setup,
            session,
            clock_map,
            velocities,
            last_received_ns: None,
            last_link: None,
        }
    }

    fn run(&mut self) -> Result<(), String> {
        let clock = &self.context.clock;
        let mut next_tick_ns = clock.now_ns();
        let mut farewell_ns = None;
        self.session.connected(next_tick_ns);
        let ended = loop {
            #[cfg(test)]
            self.context.panic_if_asked();
            let wait_ns = next_tick_ns.saturating_sub(clock.now_ns());
            match self.connection.wait(Duration::from_nanos(wait_ns)) {
                Some(Received::Reports { received_ns, reports, num_dropped }) => {
                    self.context.health.add_gaps(num_dropped);
                    reports.iter().for_each(|report| self.report(received_ns, report));
                }
                Some(Received::Malformed(count)) => self.context.health.add_bad_frames(count),
                Some(Received::Ended(problem)) => break Err(problem),
                None => {}
            }
            match self.connection.read() {
                Ok(bytes) => self.session.receive(clock.now_ns(), &bytes),
                Err(problem) => break Err(problem),
            }
            let now_ns = clock.now_ns();
            if now_ns >= next_tick_ns {
                next_tick_ns = (next_tick_ns + TICK_NS).max(now_ns);
                if self.context.take_clear_fault() {
                    self.session.clear_fault();
                }
                if self.context.stop.is_set() {
                    let begun_ns = *farewell_ns.get_or_insert(now_ns);
                    // Without an order the arm is stopped and switched off.
                    self.session.tick(now_ns, None);
                    if self.session.is_at_rest() || now_ns.saturating_sub(begun_ns) > FAREWELL_NS {
                        break Ok(());
                    }
                } else {
                    let goal = self.context.goals.newest();
                    let order = goal.map(|goal| order(&goal, &self.setup.dofs));
                    self.session.tick(now_ns, order.as_ref());
                }
                self.tell_link();
            }
            if let Err(problem) = self.connection.write(&self.session.take_output()) {
                break Err(problem);
            }
            if let Some(problem) = self.session.broken() {
                break Err(problem.to_owned());
            }
        };
        self.context.health.add_bad_frames(self.session.bad_frames());
        ended
    }

    fn report(&mut self, received_ns: u64, report: &Report) {
        let health = &self.context.health;
        let num_joints = self.setup.joints.len().min(NUM_JOINT_SLOTS);
        let realtime = report.realtime.as_ref();
        let device_ns = realtime.map(|realtime| realtime.box_time_us.saturating_mul(1000));
        let host_ns =
            device_ns.map_or(received_ns, |device_ns| self.clock_map.observe(device_ns, received_ns));
        let positions = report.joint_rad[..num_joints].to_vec();
        let estimated = self.velocities.add(device_ns.unwrap_or(received_ns), &positions);
        let reported = realtime.map(|r| r.joint_rad_per_sec).or(report.rest.joint_rad_per_sec);
        let velocities = reported.map_or(estimated, |reported| reported[..num_joints].to_vec());
        let currents = realtime.map(|r| r.current_a).or(report.rest.current_a);
        let fastest = velocities.iter().fold(0.0_f64, |most, velocity| most.max(velocity.abs()));
        self.session.report(received_ns, report, fastest);

        health.sample(received_ns);
        if device_ns.is_some() {
            health.set_skew_ppm(self.clock_map.skew_ppm());
        }
        let period_ns = match (realtime, &report.safety) {
            (Some(_), _) => 4_000_000,
            (None, Some(_)) => 200_000_000,
            (None, None) => 10_000_000,
        };
        if let Some(last_ns) = self.last_received_ns.replace(received_ns) {
            let periods = received_ns.saturating_sub(last_ns) / period_ns;
            health.add_gaps(if periods > LATE_PERIODS { periods - 1 } else { 0 });
        }
        let faulty = self.session.faulty_joint();
        let problem = self.session.link().1;
        let (version, serial) = self.session.identity();
        let identity = [version, serial].map(Option::unwrap_or_default).join("; ");
        health.motors(|motors| {
            // The joints have no names of their own: the box speaks for them.
            if let Some(first) = motors.first_mut().filter(|first| first.identity != identity) {
                first.identity.clone_from(&identity);
            }
            for (joint, motor) in motors.iter_mut().enumerate().take(NUM_JOINT_SLOTS) {
                if let Some(temperatures) = report.rest.temperature_c {
                    motor.temperature_c = Some(f64::from(temperatures[joint] as i8));
                }
                if let Some(volts) = report.rest.voltage_centivolt {
                    motor.supply_v = Some(f64::from(volts[joint]) / 100.0);
                }
                motor.current_a = currents.map(|currents| currents[joint]).or(motor.current_a);
                motor.problem = if faulty == Some(joint) { problem.clone() } else { String::new() };
            }
        });
        self.context.send(DeviceEvent::Joints {
            device: self.context.index,
            received_ns,
            host_ns,
            device_ns,
            dofs: Arc::clone(&self.setup.dofs),
            positions,
            velocities,
            currents_a: currents.map_or_else(|| vec![0.0; num_joints], |c| c[..num_joints].to_vec()),
            torque_on: vec![self.session.torque_on(); num_joints],
        });
    }

    fn tell_link(&mut self) {
        let link = self.session.link();
        if self.last_link.as_ref() != Some(&link) {
            self.context.link(link.0, link.1.clone());
            self.last_link = Some(link);
        }
    }
}

impl Drop for Conversation<'_> {
    fn drop(&mut self) {
        let Some([stop, off]) = self.session.last_words() else { return };
        let mut bytes = self.session.take_output();
        bytes.extend(stop);
        if let Err(error) = self.connection.say_last(&bytes, &off) {
            tracing::warn!(device = %self.context.id, %error, "the arm could not be told to stop any more");
        }
    }
}

/// The arm's part of what all joints shall do. Without a position for each of its joints it wants no torque.
fn order(goal: &Goal, dofs: &[usize]) -> Order {
    let joints_rad: Vec<f64> = dofs.iter().filter_map(|&dof| goal.positions.get(dof).copied()).collect();
    Order {
        torque: goal.torque && joints_rad.len() == dofs.len(),
        lead_through: goal.lead_through,
        joints_rad,
        valid_until_ns: goal.valid_until_ns,
        disarms: goal.disarms,
    }
}

#[cfg(test)]
mod tests;

//! Reads where all servos are, and reports it with the time at which it was so.

use std::sync::Arc;

use palpate_device_protocol::dynamixel::control_table::FIRST_FIRMWARE_WITH_FAST_READ;

use crate::clock_map::{ClockMap, GrowingCount};
use crate::context::DeviceContext;
use crate::event::DeviceEvent;

use super::line::{Line, Reading, RequestError};
use super::registers::{Condition, Present};
use super::servo::Servo;

/// Requests in one cycle until every servo has answered.
const ATTEMPTS: usize = 3;
/// Time that another attempt has to fit into, ns.
const ATTEMPT_NS: u64 = 2_000_000;
/// Share of joint answers that may be damaged before each servo is asked for a packet of its own: a packet for all
/// is quicker, and one wrong bit costs all that is behind it.
const MOST_DAMAGED: f64 = 0.3;
/// How quickly that share follows what happens, per cycle.
const DAMAGE_RATE: f64 = 0.05;
/// Cycles until joint answers are tried again.
const PLAIN_CYCLES: u32 = 300;

/// Reads the servos in every cycle.
#[derive(Debug)]
pub(crate) struct PresentReader {
    /// Share of joint answers that came damaged or short, lately.
    damaged: f64,
    /// Cycles left in which joint answers are not asked for.
    plain_cycles: u32,
    /// Degrees of freedom of the last event, to be shared with the next.
    dofs: Arc<[usize]>,
    clock: Option<ServoClock>,
    currents_a: Vec<(usize, f64)>,
    conditions: Vec<(usize, f64, f64)>,
}

/// The clock of one servo of the line, by which all are dated: they are read together.
#[derive(Debug)]
struct ServoClock {
    servo_idx: usize,
    tick: GrowingCount,
    map: ClockMap,
    /// When it was last read, host time.
    read_ns: u64,
}

/// A clock that was not read for so long may have started over unseen, ns.
const FORGET_CLOCK_NS: u64 = 1_000_000_000;

impl Default for PresentReader {
    fn default() -> Self {
        Self {
            damaged: 0.0,
            plain_cycles: 0,
            dofs: Arc::from([]),
            clock: None,
            currents_a: Vec::new(),
            conditions: Vec::new(),
        }
    }
}

impl PresentReader {
    /// Reads all servos that are ready and sends an event for each part of them that answered together.
    pub(crate) fn read(
        &mut self,
        context: &DeviceContext,
        line: &mut Line,
        servos: &mut [Servo],
        deadline_ns: u64,
    ) -> Result<(), RequestError> {
        let mut open: Vec<u8> =
            servos.iter().filter(|servo| servo.is_ready()).map(|servo| servo.plan.id).collect();
        let num_asked = open.len();
        let knows_fast = servos
            .iter()
            .filter(|servo| servo.is_ready())
            .all(|servo| servo.identity.is_some_and(|it| it.firmware >= FIRST_FIRMWARE_WITH_FAST_READ));
        self.plain_cycles = self.plain_cycles.saturating_sub(1);
        let mut num_read = 0;
        for attempt in 0..ATTEMPTS {
            if open.is_empty() || (attempt > 0 && context.clock.now_ns() + ATTEMPT_NS > deadline_ns) {
                break;
            }
            let fast = attempt == 0 && knows_fast && self.plain_cycles == 0;
            let reading = if fast {
                line.fast_sync_read(Present::ADDRESS, Present::LENGTH, &open)?
            } else {
                line.sync_read(Present::ADDRESS, Present::LENGTH, &open)?
            };
            if fast {
                self.judge_fast(reading.answers.len() == open.len());
            }
            open.retain(|id| reading.answers.iter().all(|answer| answer.id != *id));
            // Servos answer in the order asked, each after the one before: a dead one silences those behind it.
            if !open.is_empty() {
                open.rotate_left(1);
            }
            num_read += self.report(context, &reading, servos);
        }
        if num_asked > 0 {
            if num_read == num_asked {
                context.health.sample(context.clock.now_ns());
            } else {
                context.health.add_gaps(1);
            }
        }
        Ok(())
    }

    fn judge_fast(&mut self, is_whole: bool) {
        self.damaged += DAMAGE_RATE * (f64::from(u8::from(!is_whole)) - self.damaged);
        if self.damaged > MOST_DAMAGED {
            self.plain_cycles = PLAIN_CYCLES;
            // One more damaged answer is enough to give up again.
            self.damaged = MOST_DAMAGED - DAMAGE_RATE;
        }
    }

    /// Reports what was read, and gives the number of servos that it was of.
    fn report(&mut self, context: &DeviceContext, reading: &Reading, servos: &mut [Servo]) -> usize {
        let mut dofs = Vec::with_capacity(servos.len());
        let (mut positions, mut velocities, mut currents_a, mut torque_on) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let mut ticks: Vec<(usize, u64)> = Vec::with_capacity(servos.len());
        for answer in &reading.answers {
            let Some(idx) = servos.iter().position(|servo| servo.plan.id == answer.id) else { continue };
            let servo = &mut servos[idx];
            servo.heard_ns = reading.received_ns;
            if answer.alert && servo.hardware_error.0 == 0 {
                servo.is_urgent = true;
            }
            let Ok(present) = Present::decode(&answer.data) else { continue };
            if !servo.believes(present.position_rad, reading.received_ns) {
                context.health.add_bad_frames(1);
                continue;
            }
            let current_a = servo.plan.along_joint(present.current_a);
            dofs.push(servo.plan.dof);
            positions.push(servo.plan.joint_rad(present.position_rad));
            velocities.push(servo.plan.along_joint(present.velocity_rad_per_sec));
            currents_a.push(current_a);
            torque_on.push(servo.torque_on);
            ticks.push((idx, present.tick_ms));
            self.currents_a.push((idx, current_a));
        }
        let num_read = dofs.len();
        if num_read > 0 {
            let (device_ns, host_ns) = self.date(reading, &ticks);
            if dofs[..] != self.dofs[..] {
                self.dofs = Arc::from(dofs);
            }
            context.send(DeviceEvent::Joints {
                device: context.index,
                received_ns: reading.received_ns,
                host_ns,
                device_ns,
                dofs: Arc::clone(&self.dofs),
                positions,
                velocities,
                currents_a,
                torque_on,
            });
        }
        num_read
    }

    /// When the servos were where they say, in the time of the servo that keeps it and in the host's. That was never
    /// before they were asked nor after they answered.
    fn date(&mut self, reading: &Reading, ticks: &[(usize, u64)]) -> (Option<u64>, u64) {
        let now_ns = reading.received_ns;
        let is_old = |clock: &ServoClock| now_ns.saturating_sub(clock.read_ns) > FORGET_CLOCK_NS;
        if self.clock.as_ref().is_none_or(is_old) {
            self.clock = ticks.first().map(|&(servo_idx, _)| ServoClock {
                servo_idx,
                tick: GrowingCount::new(Present::TICK_MODULUS),
                map: ClockMap::default(),
                read_ns: now_ns,
            });
        }
        let Some(clock) = &mut self.clock else { return (None, reading.sent_ns) };
        match ticks.iter().find(|(idx, _)| *idx == clock.servo_idx) {
            Some((_, tick_ms)) => {
                let device_ns = clock.tick.read(*tick_ms) * 1_000_000;
                clock.read_ns = now_ns;
                let host_ns = clock.map.observe(device_ns, now_ns).max(reading.sent_ns);
                (Some(device_ns), host_ns)
            }
            None => (None, reading.sent_ns),
        }
    }

    /// A servo's condition, for the next [`PresentReader::tell`].
    pub(crate) fn note_condition(&mut self, servo_idx: usize, condition: &Condition) {
        self.conditions.push((servo_idx, condition.temperature_c, condition.supply_v));
    }

    /// Brings the health of the device up to date.
    pub(crate) fn tell(&mut self, context: &DeviceContext) {
        if let Some(clock) = &self.clock {
            context.health.set_skew_ppm(clock.map.skew_ppm());
        }
        let (currents_a, conditions) = (&mut self.currents_a, &mut self.conditions);
        context.health.motors(|motors| {
            for (idx, current_a) in currents_a.drain(..) {
                if let Some(motor) = motors.get_mut(idx) {
                    motor.current_a = Some(current_a);
                }
            }
            for (idx, temperature_c, supply_v) in conditions.drain(..) {
                if let Some(motor) = motors.get_mut(idx) {
                    motor.temperature_c = Some(temperature_c);
                    motor.supply_v = Some(supply_v);
                }
            }
        });
    }
}

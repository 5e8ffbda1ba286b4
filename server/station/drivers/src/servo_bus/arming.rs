//! Torque on and off. That it is on is believed only when the servos themselves say so; that it shall be off is told to
//! every servo, whatever is believed of it.

use palpate_device_protocol::dynamixel::HardwareError;
use palpate_device_protocol::dynamixel::control_table::{
    BUS_WATCHDOG, GOAL_CURRENT, GOAL_POSITION, Raw, Register, TORQUE_ENABLE,
};

use super::line::{Line, RequestError};
use super::plan::BusPlan;
use super::registers::Condition;
use super::servo::Servo;
use super::setup::read_condition;

/// Cycles in which servos are told and asked again, for the first goal and for torque each.
const ATTEMPTS: usize = 12;
/// A position that old is still where a limp joint is, ns.
const MAX_AGE_NS: u64 = 30_000_000;
/// A first goal further away than this does not start from where the joint is, rad.
const MAX_FIRST_STEP_RAD: f64 = 0.35;

/// Torque on the way up: one attempt a cycle, so that a STOP that comes meanwhile waits for one at most.
#[derive(Clone, Debug)]
pub(crate) struct Arming {
    stage: Stage,
    /// Indices of the servos that are armed. Servos that are missing or have tripped stay as they are.
    able: Vec<usize>,
    /// Those of them that have not confirmed the stage yet.
    open: Vec<usize>,
    attempts_left: usize,
}

/// What servos have to confirm.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// The first goal, the current limit and a watchdog without a trip, which would refuse goals.
    Goals,
    /// Torque, and a watchdog that counts.
    Torque,
}

/// How arming goes.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Progress {
    /// More attempts are needed.
    GoesOn,
    /// All servos that can be are armed.
    Armed,
    /// Why it cannot be done, in words. The caller lets everything go limp.
    Failed(String),
}

impl Arming {
    /// Begins with the servos that can be armed.
    pub(crate) fn new(servos: &[Servo]) -> Self {
        let is_able =
            |idx: &usize| servos[*idx].is_ready() && servos[*idx].hardware_error == HardwareError(0);
        let able: Vec<usize> = (0..servos.len()).filter(is_able).collect();
        Self { stage: Stage::Goals, open: able.clone(), able, attempts_left: ATTEMPTS }
    }

    /// Whether the servo at `idx` is being armed.
    pub(crate) fn includes(&self, idx: usize) -> bool {
        self.able.contains(&idx)
    }

    /// One attempt, right after positions were read: torque comes on where the joints are, if `goals_rad` begin there.
    pub(crate) fn go_on(
        &mut self,
        line: &mut Line,
        servos: &mut [Servo],
        plan: &BusPlan,
        goals_rad: &[f64],
        now_ns: u64,
    ) -> Result<Progress, RequestError> {
        if let Some(&gone) = self.able.iter().find(|&&idx| !servos[idx].is_ready()) {
            return Ok(Progress::Failed(format!("{}: {}", servos[gone].plan.name(), servos[gone].problem())));
        }
        let mut first_goals = Vec::with_capacity(self.open.len());
        for &idx in &self.open {
            let servo = &servos[idx];
            let Some(position_rad) = servo.position_rad(now_ns, MAX_AGE_NS) else {
                if self.stage == Stage::Goals && self.attempts_left == ATTEMPTS {
                    let problem = format!("{}: its position is not known at present", servo.plan.name());
                    return Ok(Progress::Failed(problem));
                }
                // Its reading was lost; the next attempt has another.
                continue;
            };
            match first_goal(servo, position_rad, goals_rad) {
                Ok(goal) => first_goals.push((idx, goal)),
                Err(problem) => return Ok(Progress::Failed(problem)),
            }
        }
        self.attempts_left = self.attempts_left.saturating_sub(1);
        match self.stage {
            Stage::Goals => self.give_goals(line, servos, plan, &first_goals)?,
            Stage::Torque => self.give_torque(line, servos, plan, &first_goals)?,
        }
        Ok(match (self.stage, self.open.first()) {
            (Stage::Goals, None) => {
                // Torque comes in the next cycle, which knows anew where the joints are.
                (self.stage, self.open, self.attempts_left) = (Stage::Torque, self.able.clone(), ATTEMPTS);
                Progress::GoesOn
            }
            (Stage::Torque, None) => Progress::Armed,
            (_, Some(_)) if self.attempts_left > 0 => Progress::GoesOn,
            (Stage::Goals, Some(&idx)) => {
                Progress::Failed(format!("{} does not take its first goal", servos[idx].plan.name()))
            }
            (Stage::Torque, Some(&idx)) => {
                // It may be in trouble that it can tell.
                servos[idx].is_urgent = true;
                Progress::Failed(format!("{} does not switch its torque on", servos[idx].plan.name()))
            }
        })
    }

    fn give_goals(
        &mut self,
        line: &mut Line,
        servos: &[Servo],
        plan: &BusPlan,
        first_goals: &[(usize, Raw)],
    ) -> Result<(), RequestError> {
        let ids = ids_of(servos, first_goals);
        line.sync_write(BUS_WATCHDOG.address, same(&ids, &BUS_WATCHDOG, 0))?;
        line.sync_write(GOAL_CURRENT.address, same(&ids, &GOAL_CURRENT, plan.current_limit_ma))?;
        line.sync_write(GOAL_POSITION.address, goal_bytes(servos, first_goals))?;
        let conditions = read_conditions(line, &ids)?;
        self.open.retain(|&idx| {
            let goal = first_goals.iter().find(|(other, _)| *other == idx).map(|(_, goal)| goal.0);
            !conditions.iter().any(|(id, condition)| {
                *id == servos[idx].plan.id
                    && Some(condition.goal_position) == goal
                    && condition.goal_current_ma == plan.current_limit_ma
                    && condition.watchdog == 0
            })
        });
        Ok(())
    }

    fn give_torque(
        &mut self,
        line: &mut Line,
        servos: &mut [Servo],
        plan: &BusPlan,
        first_goals: &[(usize, Raw)],
    ) -> Result<(), RequestError> {
        let ids = ids_of(servos, first_goals);
        // The goal that they have confirmed may be some cycles old by now.
        line.sync_write(GOAL_POSITION.address, goal_bytes(servos, first_goals))?;
        for &(idx, _) in first_goals {
            servos[idx].told_on = true;
        }
        line.sync_write(TORQUE_ENABLE.address, same(&ids, &TORQUE_ENABLE, 1))?;
        line.sync_write(BUS_WATCHDOG.address, same(&ids, &BUS_WATCHDOG, plan.watchdog))?;
        let conditions = read_conditions(line, &ids)?;
        self.open.retain(|&idx| {
            let servo = &mut servos[idx];
            let is_on = conditions.iter().any(|(id, condition)| {
                *id == servo.plan.id && condition.torque_on && condition.watchdog == plan.watchdog
            });
            if is_on {
                (servo.torque_on, servo.armed, servo.watchdog_tripped) = (true, true, false);
            }
            !is_on
        });
        Ok(())
    }
}

/// Where torque comes on, or why not, in words.
fn first_goal(servo: &Servo, position_rad: f64, goals_rad: &[f64]) -> Result<Raw, String> {
    let joint_rad = servo.plan.joint_rad(position_rad);
    let away_rad = (goals_rad.get(servo.plan.dof).copied().unwrap_or(f64::NAN) - joint_rad).abs();
    if away_rad.is_nan() || away_rad > MAX_FIRST_STEP_RAD {
        return Err(format!(
            "{} is at {joint_rad:.2} rad, and the first goal is {away_rad:.2} rad away: disarm, and arm where the joints \
             are",
            servo.plan.name()
        ));
    }
    GOAL_POSITION.to_raw(position_rad).map_err(|error| format!("{}: {error}", servo.plan.name()))
}

/// Tells the servos with these ids to switch their torque off. None of them confirms it, so a servo that cannot be heard
/// is told all the same.
pub(crate) fn tell_off(line: &mut Line, ids: &[u8]) -> Result<(), RequestError> {
    line.sync_write(TORQUE_ENABLE.address, same(ids, &TORQUE_ENABLE, 0))
}

/// Asks the servos that are believed to be on, once, and says whether all that can be talked to have confirmed that their
/// torque is off.
pub(crate) fn confirm_off(line: &mut Line, servos: &mut [Servo]) -> Result<bool, RequestError> {
    for servo in servos.iter_mut() {
        servo.armed = false;
        // It was told to switch torque on and never heard of: it counts as on until it says that it is off.
        servo.torque_on |= std::mem::take(&mut servo.told_on);
    }
    let is_on = |servo: &&Servo| servo.is_ready() && servo.torque_on;
    let ids: Vec<u8> = servos.iter().filter(is_on).map(|servo| servo.plan.id).collect();
    if ids.is_empty() {
        return Ok(true);
    }
    for answer in line.sync_read(TORQUE_ENABLE.address, TORQUE_ENABLE.length, &ids)?.answers {
        if let Some(servo) = servos.iter_mut().find(|servo| servo.plan.id == answer.id) {
            servo.torque_on = answer.data != [0];
        }
    }
    Ok(!servos.iter().any(|servo| is_on(&servo)))
}

/// The conditions of many servos at once. The first of those that are silent or damaged is asked once more, alone; the
/// rest wait for the next attempt, because the line is not theirs.
fn read_conditions(line: &mut Line, ids: &[u8]) -> Result<Vec<(u8, Condition)>, RequestError> {
    if ids.is_empty() {
        return Ok(Vec::new());
    }
    let reading = line.sync_read(Condition::ADDRESS, Condition::LENGTH, ids)?;
    let mut conditions: Vec<(u8, Condition)> = reading
        .answers
        .iter()
        .filter_map(|answer| Some((answer.id, Condition::decode(&answer.data).ok()?)))
        .collect();
    let unheard = ids.iter().find(|&&id| conditions.iter().all(|(known, _)| *known != id));
    if let Some(&id) = unheard {
        match read_condition(line, id) {
            Ok(condition) => conditions.push((id, condition)),
            Err(error @ RequestError::Port(_)) => return Err(error),
            Err(_) => {}
        }
    }
    Ok(conditions)
}

fn ids_of(servos: &[Servo], chosen: &[(usize, Raw)]) -> Vec<u8> {
    chosen.iter().map(|&(idx, _)| servos[idx].plan.id).collect()
}

fn same(ids: &[u8], register: &Register, number: i64) -> Vec<(u8, Vec<u8>)> {
    ids.iter().map(|&id| (id, bytes(register, Raw(number)))).collect()
}

fn goal_bytes(servos: &[Servo], goals: &[(usize, Raw)]) -> Vec<(u8, Vec<u8>)> {
    goals.iter().map(|&(idx, goal)| (servos[idx].plan.id, bytes(&GOAL_POSITION, goal))).collect()
}

fn bytes(register: &Register, raw: Raw) -> Vec<u8> {
    let (min, max) = register.raw_range();
    // Clamped to what the bytes hold, so it always fits.
    register.encode(raw.clamp(min, max)).unwrap_or_default()
}

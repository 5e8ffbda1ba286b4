//! Torque on and off, each believed only when the servos themselves say so.

use palpate_device_protocol::dynamixel::HardwareError;
use palpate_device_protocol::dynamixel::control_table::{
    BUS_WATCHDOG, GOAL_CURRENT, GOAL_POSITION, Raw, Register, TORQUE_ENABLE,
};

use super::line::{Line, RequestError};
use super::plan::BusPlan;
use super::registers::Condition;
use super::servo::Servo;
use super::setup::read_condition;

/// Times that servos are told and asked again.
const ATTEMPTS: usize = 5;
/// A position that old is still where a limp joint is, ns.
const MAX_AGE_NS: u64 = 30_000_000;
/// A first goal further away than this does not start from where the joint is, rad.
const MAX_FIRST_STEP_RAD: f64 = 0.35;

/// Switches torque on where the joints are. Either all servos that can are armed afterwards, or the reason is given in
/// words and the caller lets everything go limp. Servos that are missing or have tripped stay as they are.
pub(crate) fn arm(
    line: &mut Line,
    servos: &mut [Servo],
    plan: &BusPlan,
    goals_rad: &[f64],
    now_ns: u64,
) -> Result<Result<(), String>, RequestError> {
    let able: Vec<usize> = (0..servos.len())
        .filter(|&idx| servos[idx].is_ready() && servos[idx].hardware_error == HardwareError(0))
        .collect();
    let mut first_goals = Vec::with_capacity(able.len());
    for &idx in &able {
        let servo = &servos[idx];
        let Some(position_rad) = servo.position_rad(now_ns, MAX_AGE_NS) else {
            return Ok(Err(format!("{}: its position is not known at present", servo.plan.name())));
        };
        let joint_rad = servo.plan.joint_rad(position_rad);
        let away_rad = (goals_rad.get(servo.plan.dof).copied().unwrap_or(f64::NAN) - joint_rad).abs();
        if away_rad.is_nan() || away_rad > MAX_FIRST_STEP_RAD {
            return Ok(Err(format!(
                "{} is at {joint_rad:.2} rad, and the first goal is {away_rad:.2} rad away: disarm, and arm where the \
                 joints are",
                servo.plan.name()
            )));
        }
        match GOAL_POSITION.to_raw(position_rad) {
            Ok(goal) => first_goals.push((idx, goal)),
            Err(error) => return Ok(Err(format!("{}: {error}", servo.plan.name()))),
        }
    }
    let id_of: Vec<u8> = servos.iter().map(|servo| servo.plan.id).collect();
    let ids = |chosen: &[(usize, Raw)]| chosen.iter().map(|&(idx, _)| id_of[idx]).collect::<Vec<_>>();
    let same = |chosen: &[(usize, Raw)], register: &Register, number: i64| {
        ids(chosen).into_iter().map(|id| (id, bytes(register, Raw(number)))).collect::<Vec<_>>()
    };

    // First the goal, the current limit and a watchdog without a trip, which would refuse goals; torque only after
    // every servo has said that it has them.
    let mut open = first_goals.clone();
    for _ in 0..ATTEMPTS {
        if open.is_empty() {
            break;
        }
        line.sync_write(BUS_WATCHDOG.address, same(&open, &BUS_WATCHDOG, 0))?;
        line.sync_write(GOAL_CURRENT.address, same(&open, &GOAL_CURRENT, plan.current_limit_ma))?;
        let goals = open.iter().map(|&(idx, goal)| (id_of[idx], bytes(&GOAL_POSITION, goal))).collect();
        line.sync_write(GOAL_POSITION.address, goals)?;
        let conditions = read_conditions(line, &ids(&open))?;
        open.retain(|&(idx, goal)| {
            !conditions.iter().any(|(id, condition)| {
                *id == id_of[idx]
                    && condition.goal_position == goal.0
                    && condition.goal_current_ma == plan.current_limit_ma
                    && condition.watchdog == 0
            })
        });
    }
    if let Some(&(idx, _)) = open.first() {
        return Ok(Err(format!("{} does not take its first goal", servos[idx].plan.name())));
    }

    let mut open = first_goals;
    for _ in 0..ATTEMPTS {
        if open.is_empty() {
            break;
        }
        line.sync_write(TORQUE_ENABLE.address, same(&open, &TORQUE_ENABLE, 1))?;
        line.sync_write(BUS_WATCHDOG.address, same(&open, &BUS_WATCHDOG, plan.watchdog))?;
        let conditions = read_conditions(line, &ids(&open))?;
        let armed = |idx: &usize| {
            conditions.iter().any(|(id, condition)| {
                *id == id_of[*idx] && condition.torque_on && condition.watchdog == plan.watchdog
            })
        };
        let done: Vec<usize> = open.iter().map(|&(idx, _)| idx).filter(armed).collect();
        open.retain(|(idx, _)| !done.contains(idx));
        for idx in done {
            (servos[idx].torque_on, servos[idx].armed, servos[idx].watchdog_tripped) = (true, true, false);
        }
    }
    Ok(match open.first() {
        Some(&(idx, _)) => {
            // It may be in trouble that it can tell.
            servos[idx].is_urgent = true;
            Err(format!("{} does not switch its torque on", servos[idx].plan.name()))
        }
        None => Ok(()),
    })
}

/// Switches torque off and says whether all servos that can be talked to have confirmed it.
pub(crate) fn go_limp(line: &mut Line, servos: &mut [Servo], attempts: usize) -> Result<bool, RequestError> {
    for servo in servos.iter_mut() {
        servo.armed = false;
    }
    for _ in 0..attempts {
        let ids: Vec<u8> = servos
            .iter()
            .filter(|servo| servo.is_ready() && servo.torque_on)
            .map(|servo| servo.plan.id)
            .collect();
        if ids.is_empty() {
            return Ok(true);
        }
        let off = ids.iter().map(|&id| (id, bytes(&TORQUE_ENABLE, Raw(0)))).collect();
        line.sync_write(TORQUE_ENABLE.address, off)?;
        for answer in line.sync_read(TORQUE_ENABLE.address, TORQUE_ENABLE.length, &ids)?.answers {
            if let Some(servo) = servos.iter_mut().find(|servo| servo.plan.id == answer.id) {
                servo.torque_on = answer.data != [0];
            }
        }
    }
    Ok(servos.iter().all(|servo| !servo.is_ready() || !servo.torque_on))
}

/// The conditions of many servos at once; those that are silent or damaged are asked once more, alone.
fn read_conditions(line: &mut Line, ids: &[u8]) -> Result<Vec<(u8, Condition)>, RequestError> {
    let reading = line.sync_read(Condition::ADDRESS, Condition::LENGTH, ids)?;
    let mut conditions: Vec<(u8, Condition)> = reading
        .answers
        .iter()
        .filter_map(|answer| Some((answer.id, Condition::decode(&answer.data).ok()?)))
        .collect();
    for &id in ids {
        if conditions.iter().all(|(known, _)| *known != id) {
            match read_condition(line, id) {
                Ok(condition) => conditions.push((id, condition)),
                Err(error @ RequestError::Port(_)) => return Err(error),
                Err(_) => {}
            }
        }
    }
    Ok(conditions)
}

fn bytes(register: &Register, raw: Raw) -> Vec<u8> {
    let (min, max) = register.raw_range();
    // Clamped to what the bytes hold, so it always fits.
    register.encode(raw.clamp(min, max)).unwrap_or_default()
}

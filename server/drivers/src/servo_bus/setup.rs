//! Finding one servo and setting it up, with torque off.

use palpate_device_protocol::dynamixel::control_table::{
    BUS_WATCHDOG, CURRENT_LIMIT, DRIVE_MODE, EEPROM_END, GOAL_CURRENT, Model, OPERATING_MODE, OperatingMode,
    POSITION_D_GAIN, PRESENT_POSITION, PROFILE_ACCELERATION, RETURN_DELAY_TIME, Raw, Register,
    STATUS_RETURN_LEVEL, TICKS_PER_TURN, TORQUE_ENABLE,
};
use palpate_device_protocol::dynamixel::{HardwareError, Instruction, PingReply, Status};

use super::line::{Line, RequestError};
use super::plan::BusPlan;
use super::registers::{self, Condition};
use super::servo::{Presence, Servo};
use super::words;

/// Answers to everything.
const ANSWER_ALL: i64 = 2;

/// Looks for the servo and sets it up. Ends with the servo ready, unusable with the reason, or missing; an error is one
/// of the port.
pub(crate) fn find_and_set_up(
    line: &mut Line,
    servo: &mut Servo,
    plan: &BusPlan,
    now_ns: u64,
    tries: usize,
) -> Result<(), RequestError> {
    let id = servo.plan.id;
    match line.ask_times(id, Instruction::Ping, tries).and_then(|status| Ok(status.ping_reply()?)) {
        Ok(identity) => servo.identity = Some(identity),
        Err(error @ RequestError::Port(_)) => return Err(error),
        Err(_) => {
            servo.armed = false;
            servo.torque_on = false;
            return Ok(());
        }
    }
    (servo.armed, servo.torque_on) = (false, false);
    servo.forget_position();
    servo.heard_ns = now_ns;
    match set_up(line, servo, plan) {
        Ok(()) => {
            servo.presence = Presence::Ready;
            servo.setup_problem.clear();
        }
        Err(SetupError::Request(error @ RequestError::Port(_))) => return Err(error),
        // It went away again meanwhile.
        Err(SetupError::Request(RequestError::Silent { .. })) => {}
        Err(SetupError::Request(error)) => unusable(servo, format!("cannot be set up: {error}")),
        Err(SetupError::Unusable(problem)) => unusable(servo, problem),
    }
    Ok(())
}

fn unusable(servo: &mut Servo, problem: String) {
    servo.presence = Presence::Unusable;
    servo.setup_problem = problem;
}

enum SetupError {
    Request(RequestError),
    Unusable(String),
}

impl<E: Into<RequestError>> From<E> for SetupError {
    fn from(error: E) -> Self {
        Self::Request(error.into())
    }
}

fn set_up(line: &mut Line, servo: &mut Servo, plan: &BusPlan) -> Result<(), SetupError> {
    let id = servo.plan.id;
    let Some(PingReply { model, .. }) = servo.identity else { return Ok(()) };
    if Model::from_number(model).is_none() {
        return Err(SetupError::Unusable(words::unknown_model(model)));
    }
    // A servo that answers only some instructions would look as if it were gone.
    write_silently(line, id, &STATUS_RETURN_LEVEL, ANSWER_ALL)?;
    write(line, id, &TORQUE_ENABLE, 0)?;

    let eeprom = line.read(id, 0, EEPROM_END)?;
    let mode = i64::from(OperatingMode::CurrentBasedPosition as u8);
    // The EEPROM wears out by writing, so only what differs is written. Drive mode 0: not reversed, goals do not switch
    // torque on.
    for (register, wanted) in [(&RETURN_DELAY_TIME, 0), (&DRIVE_MODE, 0), (&OPERATING_MODE, mode)] {
        if number(&eeprom, 0, register)? != wanted {
            write(line, id, register, wanted)?;
        }
    }
    let most_ma = number(&eeprom, 0, &CURRENT_LIMIT)?;
    if most_ma < plan.current_limit_ma {
        return Err(SetupError::Unusable(format!(
            "has its own current limit (register 38) at {most_ma} mA, below the {} mA of the station file: lower \
             current_limit_a",
            plan.current_limit_ma
        )));
    }
    // Gains D, I and P stand side by side, and so do both profile registers: no profile, the safety layer shapes motion.
    let gains = [servo.plan.d, servo.plan.i, servo.plan.p].map(u16::to_le_bytes).concat();
    line.write(id, POSITION_D_GAIN.address, &gains)?;
    line.write(id, PROFILE_ACCELERATION.address, &[0; 8])?;
    // Off until it is armed; this also clears a trip, after which it would refuse goals.
    write(line, id, &BUS_WATCHDOG, 0)?;
    write(line, id, &GOAL_CURRENT, plan.current_limit_ma)?;

    let condition = read_condition(line, id)?;
    if servo.note(&condition, plan.current_limit_ma) {
        return Err(SetupError::Unusable(
            "does not keep the gains and current limit that it is given: check its supply and firmware"
                .to_owned(),
        ));
    }
    let position = line.read(id, PRESENT_POSITION.address, PRESENT_POSITION.length)?;
    let ticks = number(&position, PRESENT_POSITION.address, &PRESENT_POSITION)?;
    if !(0..TICKS_PER_TURN as i64).contains(&ticks) && servo.hardware_error == HardwareError(0) {
        // It has counted whole turns, as when somebody turned it by hand while it was on.
        line.ask(id, Instruction::ClearTurns)?;
    }
    Ok(())
}

/// What the servo says about itself.
pub(crate) fn read_condition(line: &mut Line, id: u8) -> Result<Condition, RequestError> {
    let status = line.read(id, Condition::ADDRESS, Condition::LENGTH)?;
    // The length has been checked, so the registers are all there.
    Condition::decode(&status.data).map_err(|_| RequestError::Silent { id })
}

fn number(status: &Status, address: u16, register: &Register) -> Result<i64, RequestError> {
    let Raw(number) = registers::raw(&status.data, address, register)
        .map_err(|_| RequestError::Silent { id: status.id })?;
    Ok(number)
}

fn encode(register: &Register, number: i64) -> Vec<u8> {
    let (min, max) = register.raw_range();
    // Clamped to what the bytes hold, so it always fits.
    register.encode(Raw(number).clamp(min, max)).unwrap_or_default()
}

fn write(line: &mut Line, id: u8, register: &Register, number: i64) -> Result<(), RequestError> {
    line.write(id, register.address, &encode(register, number))
}

/// Writes without waiting for an answer that may not come.
fn write_silently(line: &mut Line, id: u8, register: &Register, number: i64) -> Result<(), RequestError> {
    line.sync_write(register.address, vec![(id, encode(register, number))])
}

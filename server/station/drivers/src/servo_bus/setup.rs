//! Finding one servo and setting it up, with torque off.
//!
//! A set-up takes about a dozen requests. It goes on by one request a call, so that the goals of other servos, and a
//! STOP, never wait for more than one.

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
use super::step::{SetUp, Step};
use super::words;

/// Answers to everything.
const ANSWER_ALL: i64 = 2;
/// Times that a request of the set-up is sent before the servo counts as gone again.
const TRIES: usize = 8;

/// Sends the next request of the servo's set-up, if it has one under way. In the end the servo is ready, unusable with the
/// reason, or as its presence says because it is silent; an error is one of the port.
pub(crate) fn go_on(
    line: &mut Line,
    servo: &mut Servo,
    plan: &BusPlan,
    now_ns: u64,
) -> Result<(), RequestError> {
    let Some(SetUp { step, tries_left }) = servo.setup.take() else { return Ok(()) };
    match carry_out(line, servo, plan, &step, now_ns) {
        Ok(Some(next)) => servo.setup = Some(SetUp { step: next, tries_left: TRIES }),
        Ok(None) => {
            servo.presence = Presence::Ready;
            servo.setup_problem.clear();
        }
        Err(SetupError::Request(error @ RequestError::Port(_))) => return Err(error),
        // It is not there, it went away again meanwhile, or something was damaged on its way.
        Err(SetupError::Request(RequestError::Silent { .. })) => {
            let again = tries_left.saturating_sub(1);
            servo.setup = (again > 0).then_some(SetUp { step, tries_left: again });
        }
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

/// Sends the request of one step and gives the step after it; `None` when the servo is set up.
fn carry_out(
    line: &mut Line,
    servo: &mut Servo,
    plan: &BusPlan,
    step: &Step,
    now_ns: u64,
) -> Result<Option<Step>, SetupError> {
    let id = servo.plan.id;
    Ok(Some(match step {
        Step::Ping => {
            let PingReply { model, firmware } = line.ask(id, Instruction::Ping)?.ping_reply()?;
            servo.identity = Some(PingReply { model, firmware });
            servo.heard_ns = now_ns;
            servo.forget_position();
            if Model::from_number(model).is_none() {
                return Err(SetupError::Unusable(words::unknown_model(model)));
            }
            Step::TorqueOff
        }
        Step::TorqueOff => {
            // A servo that answers only some instructions would look as if it were gone.
            write_silently(line, id, &STATUS_RETURN_LEVEL, ANSWER_ALL)?;
            write(line, id, &TORQUE_ENABLE, 0)?;
            (servo.torque_on, servo.told_on) = (false, false);
            Step::ReadEeprom
        }
        Step::ReadEeprom => {
            let eeprom = line.read(id, 0, EEPROM_END)?;
            let most_ma = number(&eeprom, 0, &CURRENT_LIMIT)?;
            if most_ma < plan.current_limit_ma {
                return Err(SetupError::Unusable(format!(
                    "has its own current limit (register 38) at {most_ma} mA, below the {} mA of the station file: \
                     lower current_limit_a",
                    plan.current_limit_ma
                )));
            }
            let mode = i64::from(OperatingMode::CurrentBasedPosition as u8);
            // Drive mode 0: not reversed, goals do not switch torque on.
            let wanted = [(&RETURN_DELAY_TIME, 0), (&DRIVE_MODE, 0), (&OPERATING_MODE, mode)];
            let mut differing = Vec::new();
            for (register, wanted) in wanted {
                if number(&eeprom, 0, register)? != wanted {
                    differing.push((register, wanted));
                }
            }
            Step::WriteEeprom(differing).or_after()
        }
        Step::WriteEeprom(differing) => {
            let Some((&(register, wanted), rest)) = differing.split_first() else {
                return Ok(Some(Step::Gains));
            };
            write(line, id, register, wanted)?;
            Step::WriteEeprom(rest.to_vec()).or_after()
        }
        // Gains D, I and P stand side by side.
        Step::Gains => {
            let gains = [servo.plan.d, servo.plan.i, servo.plan.p].map(u16::to_le_bytes).concat();
            line.write(id, POSITION_D_GAIN.address, &gains)?;
            Step::NoProfile
        }
        // So do both registers of the profile. There is none, because the safety layer shapes motion.
        Step::NoProfile => {
            line.write(id, PROFILE_ACCELERATION.address, &[0; 8])?;
            Step::WatchdogOff
        }
        Step::WatchdogOff => {
            write(line, id, &BUS_WATCHDOG, 0)?;
            Step::Current
        }
        Step::Current => {
            write(line, id, &GOAL_CURRENT, plan.current_limit_ma)?;
            Step::Condition
        }
        Step::Condition => {
            let condition = read_condition(line, id)?;
            if servo.note(&condition, plan.current_limit_ma) {
                return Err(SetupError::Unusable(
                    "does not keep the gains and current limit that it is given: check its supply and firmware"
                        .to_owned(),
                ));
            }
            Step::Position
        }
        Step::Position => {
            let position = line.read(id, PRESENT_POSITION.address, PRESENT_POSITION.length)?;
            let ticks = number(&position, PRESENT_POSITION.address, &PRESENT_POSITION)?;
            servo.heard_ns = now_ns;
            // It has counted whole turns, as when somebody turned it by hand while it was on.
            let has_turned = !(0..TICKS_PER_TURN as i64).contains(&ticks);
            if !has_turned || servo.hardware_error != HardwareError(0) {
                return Ok(None);
            }
            Step::ClearTurns
        }
        Step::ClearTurns => {
            line.ask(id, Instruction::ClearTurns)?;
            servo.heard_ns = now_ns;
            return Ok(None);
        }
    }))
}

impl Step {
    /// The step itself, or the next one where it has nothing to do.
    fn or_after(self) -> Self {
        match self {
            Self::WriteEeprom(differing) if differing.is_empty() => Self::Gains,
            step => step,
        }
    }
}

/// What the servo says about itself, asked once.
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

//! One servo: what its registers say, do and refuse.

mod control;
mod motor;
mod table;

use std::f64::consts::{PI, TAU};

use palpate_device_protocol::dynamixel::control_table::{
    self as registers, BAUD_RATES, Model, OperatingMode, TICKS_PER_TURN,
};
use palpate_device_protocol::dynamixel::{ErrorByte, HardwareError, StatusError};

use control::Controller;
use motor::{Demand, Motor};
pub(crate) use table::FIRMWARE;
use table::{Change, Table};

/// Steps of control loop and motor, s.
pub(crate) const STEP_S: f64 = 1e-3;
/// Steps that a restart takes, during which the servo hears nothing.
const REBOOT_STEPS: u32 = 300;
/// Steps of hard work without motion after which the overload protection trips.
const OVERLOAD_STEPS: u32 = 1000;
/// Index of the baud rate of a hand that is set up: 4 Mbit/s.
const BAUD_INDEX: i64 = 6;
/// Bits of the drive mode: new goals switch torque on, and counting is reversed.
const DRIVE_TORQUE_ON: i64 = 0x08;
const DRIVE_REVERSED: i64 = 0x01;
/// A position within this of the goal is there, rad.
const IN_POSITION_RAD: f64 = 0.02;

/// What is wrong with a servo at present, from outside.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ServoFaults {
    /// The gear is jammed.
    pub(crate) stuck: bool,
    /// The overload protection sees a load.
    pub(crate) overload: bool,
    /// There is no power.
    pub(crate) unpowered: bool,
    /// The case is this much hotter than its own losses make it, K.
    pub(crate) heating_k: f64,
}

/// A servo of the hand with the joint that it moves.
#[derive(Clone, Debug)]
pub(crate) struct Servo {
    table: Table,
    motor: Motor,
    controller: Controller,
    faults: ServoFaults,
    /// Whole turns that were cleared, rad.
    cleared_rad: f64,
    registered: Option<Vec<Change>>,
    /// Steps left of a restart.
    rebooting: u32,
    overloaded: u32,
    /// Steps since the last instruction on the line.
    silent: u32,
    tick_ms: u32,
}

impl Servo {
    /// A servo whose joint is at `joint_rad` between `stops_rad`. The flat open hand has all encoders at half a turn.
    pub(crate) fn new(id: u8, joint_rad: f64, stops_rad: (f64, f64)) -> Self {
        let mut servo = Self {
            table: Table::new(Model::Xc330M288, id, BAUD_INDEX),
            motor: Motor::new(joint_rad + PI, (stops_rad.0 + PI, stops_rad.1 + PI)),
            controller: Controller::default(),
            faults: ServoFaults::default(),
            cleared_rad: 0.0,
            registered: None,
            rebooting: 0,
            overloaded: 0,
            silent: 0,
            tick_ms: 0,
        };
        servo.goal_to_present();
        servo.publish(5.0);
        servo
    }

    pub(crate) fn id(&self) -> u8 {
        self.table.get(&registers::ID) as u8
    }

    /// The further id at which it obeys and does not answer.
    pub(crate) fn secondary_id(&self) -> Option<u8> {
        u8::try_from(self.table.get(&registers::SECONDARY_ID)).ok().filter(|&id| id <= 252)
    }

    pub(crate) fn model_number(&self) -> u16 {
        self.table.model().number()
    }

    /// Angle of the joint by the encoder, rad; 0 for the flat open hand.
    pub(crate) fn joint_rad(&self) -> f64 {
        self.motor.angle_rad - PI
    }

    /// Velocity of the joint, rad/s.
    pub(crate) fn rad_per_sec(&self) -> f64 {
        self.motor.velocity_rad_per_sec
    }

    /// Whether the motor holds the joint or moves it.
    pub(crate) fn torque_is_on(&self) -> bool {
        self.table.torque_is_on() && self.is_awake()
    }

    /// Angle of the joint that the motor is told to go to, rad; `None` without torque.
    pub(crate) fn goal_rad(&self) -> Option<f64> {
        let in_register = self.table.physical(&registers::GOAL_POSITION);
        let counted = self.sign() * (in_register - self.table.physical(&registers::HOMING_OFFSET));
        self.torque_is_on().then_some(counted + self.cleared_rad - PI)
    }

    /// What pushes the joint from outside in the next step, N m, and the inertia that this adds, kg m2.
    pub(crate) fn set_outside(&mut self, torque_nm: f64, inertia_kg_m2: f64) {
        (self.motor.outside_nm, self.motor.outside_kg_m2) = (torque_nm, inertia_kg_m2);
    }

    /// Current drawn, A.
    pub(crate) fn current_a(&self) -> f64 {
        self.motor.current_a
    }

    /// Whether it listens.
    pub(crate) fn is_awake(&self) -> bool {
        self.rebooting == 0
    }

    /// 2 answers all, 1 pings and reads, 0 only pings.
    pub(crate) fn status_return_level(&self) -> i64 {
        self.table.get(&registers::STATUS_RETURN_LEVEL)
    }

    /// Pause before an answer, ns.
    pub(crate) fn return_delay_ns(&self) -> u64 {
        (self.table.physical(&registers::RETURN_DELAY_TIME) * 1e9).round() as u64
    }

    /// Time of a byte on the line, ns: ten bits.
    pub(crate) fn byte_ns(&self) -> u64 {
        let index = self.table.get(&registers::BAUD_RATE) as usize;
        BAUD_RATES.get(index).map_or(0, |&bits_per_s| 10_000_000_000 / u64::from(bits_per_s))
    }

    /// The error byte of an answer.
    pub(crate) fn error_byte(&self, error: Option<StatusError>) -> ErrorByte {
        ErrorByte::new(error, self.table.get(&registers::HARDWARE_ERROR_STATUS) != 0)
    }

    pub(crate) fn set_faults(&mut self, faults: ServoFaults) {
        if faults.unpowered && !self.faults.unpowered {
            // What is not in the EEPROM is forgotten; when power comes back it starts as after a reboot.
            self.reboot();
        }
        self.faults = faults;
    }

    /// An instruction was on the line, for whomever.
    pub(crate) fn hear(&mut self) {
        self.silent = 0;
    }

    pub(crate) fn read(&self, address: u16, length: u16) -> Result<Vec<u8>, StatusError> {
        self.table.read(address, length)
    }

    pub(crate) fn write(&mut self, address: u16, data: &[u8]) -> Result<(), StatusError> {
        let changes = self.table.changes(address, data)?;
        self.apply(&changes);
        Ok(())
    }

    /// Keeps a write for [`Servo::action`].
    pub(crate) fn register_write(&mut self, address: u16, data: &[u8]) -> Result<(), StatusError> {
        self.registered = Some(self.table.changes(address, data)?);
        self.table.set(&registers::REGISTERED_INSTRUCTION, 1);
        Ok(())
    }

    pub(crate) fn action(&mut self) -> Result<(), StatusError> {
        let changes = self.registered.take().ok_or(StatusError::Instruction)?;
        self.table.set(&registers::REGISTERED_INSTRUCTION, 0);
        self.apply(&changes);
        Ok(())
    }

    /// Restarts: torque off, everything outside the EEPROM as delivered, faults whose cause has gone forgotten.
    pub(crate) fn reboot(&mut self) {
        self.table.power_up();
        self.registered = None;
        self.overloaded = 0;
        self.silent = 0;
        self.tick_ms = 0;
        self.cleared_rad = whole_turns_rad(self.motor.angle_rad);
        self.goal_to_present();
        self.rebooting = REBOOT_STEPS;
    }

    /// Forgets whole turns, which needs the joint at rest.
    pub(crate) fn clear_turns(&mut self) -> Result<(), StatusError> {
        if self.motor.velocity_rad_per_sec.abs() > 0.1 {
            return Err(StatusError::ResultFail);
        }
        self.cleared_rad = whole_turns_rad(self.motor.angle_rad);
        self.goal_to_present();
        Ok(())
    }

    fn apply(&mut self, changes: &[Change]) {
        for change in changes {
            let (register, value) = match change {
                Change::Byte(address, byte) => {
                    self.table.set_byte(*address, *byte);
                    continue;
                }
                Change::Register(register, raw) => (*register, raw.0),
            };
            let before = self.table.get(register);
            self.table.set(register, value);
            if *register == registers::TORQUE_ENABLE {
                if self.is_shut_down() {
                    self.table.set(&registers::TORQUE_ENABLE, 0);
                } else if value == 1 && before == 0 {
                    self.goal_to_present();
                }
            } else if *register == registers::OPERATING_MODE {
                self.table.mode_defaults();
                self.goal_to_present();
            } else if *register == registers::GOAL_POSITION {
                if self.table.get(&registers::DRIVE_MODE) & DRIVE_TORQUE_ON != 0
                    && !self.table.torque_is_on()
                    && !self.is_shut_down()
                {
                    self.controller.rest_at(self.position_rad());
                    self.table.set(&registers::TORQUE_ENABLE, 1);
                }
                self.controller.plan(&self.table);
            } else if *register == registers::HOMING_OFFSET || *register == registers::DRIVE_MODE {
                self.goal_to_present();
            }
        }
    }

    /// Position as the register has it, rad.
    fn position_rad(&self) -> f64 {
        let counted = self.motor.angle_rad - self.cleared_rad;
        self.sign() * counted + self.table.physical(&registers::HOMING_OFFSET)
    }

    fn sign(&self) -> f64 {
        if self.table.get(&registers::DRIVE_MODE) & DRIVE_REVERSED != 0 { -1.0 } else { 1.0 }
    }

    fn goal_to_present(&mut self) {
        let position_rad = self.position_rad();
        self.table.set_physical(&registers::GOAL_POSITION, position_rad);
        self.controller.rest_at(self.table.physical(&registers::GOAL_POSITION));
    }

    fn is_shut_down(&self) -> bool {
        let faults = self.table.get(&registers::HARDWARE_ERROR_STATUS);
        faults & self.table.get(&registers::SHUTDOWN) != 0
    }

    /// One step of [`STEP_S`] at `supply_v`.
    pub(crate) fn step(&mut self, supply_v: f64) {
        self.drive(supply_v);
        self.motor.turn(STEP_S, self.faults.stuck);
        self.finish(supply_v);
    }

    /// The first half of a step, in which the servo decides what its motor does.
    pub(crate) fn drive(&mut self, supply_v: f64) {
        self.rebooting = if self.faults.unpowered { REBOOT_STEPS } else { self.rebooting.saturating_sub(1) };
        self.watch_the_bus();
        let demand = if self.table.torque_is_on() && self.rebooting == 0 {
            let (position_rad, sign) = (self.position_rad(), self.sign());
            self.controller.step(STEP_S, &self.table, &self.motor, position_rad, sign)
        } else {
            Demand::Off
        };
        self.motor.drive(demand, supply_v);
    }

    /// What the motor and whoever pushes do to the joint, N m, and whether its gear is jammed.
    pub(crate) fn outside_drive(&self) -> (f64, bool) {
        (self.motor.torque_nm() + self.motor.outside_nm, self.faults.stuck)
    }

    /// The second half of a step after something else has moved the joint to `joint_rad` by its encoder.
    pub(crate) fn follow(&mut self, supply_v: f64, joint_rad: f64, rad_per_sec: f64) {
        (self.motor.angle_rad, self.motor.velocity_rad_per_sec) = (joint_rad + PI, rad_per_sec);
        self.finish(supply_v);
    }

    fn finish(&mut self, supply_v: f64) {
        self.motor.warm(STEP_S);
        self.protect(supply_v);
        self.tick_ms = (self.tick_ms + 1) & 0x7FFF;
        self.publish(supply_v);
    }

    /// Stops when the host has been silent for longer than it promised.
    fn watch_the_bus(&mut self) {
        let watchdog = self.table.get(&registers::BUS_WATCHDOG);
        if watchdog <= 0 || !self.table.torque_is_on() {
            self.silent = 0;
            return;
        }
        self.silent += 1;
        if f64::from(self.silent) * STEP_S > self.table.physical(&registers::BUS_WATCHDOG) {
            self.table.set(&registers::BUS_WATCHDOG, -1);
            self.goal_to_present();
            self.table.set(&registers::GOAL_VELOCITY, 0);
            match self.table.mode() {
                OperatingMode::Current => self.table.set(&registers::GOAL_CURRENT, 0),
                OperatingMode::Pwm => self.table.set(&registers::GOAL_PWM, 0),
                _ => {}
            }
        }
    }

    /// Notes hardware errors; those of the shutdown mask switch torque off. All but the supply's stay until a restart.
    fn protect(&mut self, supply_v: f64) {
        self.overloaded = if self.motor.is_overloaded() { self.overloaded + 1 } else { 0 };
        let volts = supply_v / registers::PRESENT_INPUT_VOLTAGE.unit.per_step();
        let supply_is_off = volts > self.table.get(&registers::MAX_VOLTAGE_LIMIT) as f64
            || volts < self.table.get(&registers::MIN_VOLTAGE_LIMIT) as f64;
        let hot = self.temperature_c() > self.table.physical(&registers::TEMPERATURE_LIMIT);
        let mut faults =
            self.table.get(&registers::HARDWARE_ERROR_STATUS) & !i64::from(HardwareError::INPUT_VOLTAGE.0);
        for (present, fault) in [
            (supply_is_off, HardwareError::INPUT_VOLTAGE),
            (hot, HardwareError::OVERHEATING),
            (self.faults.overload || self.overloaded > OVERLOAD_STEPS, HardwareError::OVERLOAD),
        ] {
            faults |= if present { i64::from(fault.0) } else { 0 };
        }
        self.table.set(&registers::HARDWARE_ERROR_STATUS, faults);
        if self.is_shut_down() {
            self.table.set(&registers::TORQUE_ENABLE, 0);
        }
    }

    fn temperature_c(&self) -> f64 {
        self.motor.temperature_c + self.faults.heating_k
    }

    /// Brings the registers that only tell up to date.
    fn publish(&mut self, supply_v: f64) {
        let position_rad = self.position_rad();
        let velocity = self.sign() * self.motor.velocity_rad_per_sec;
        let current_ma = self.sign() * self.motor.current_a * 1e3;
        let goal_rad = self.table.physical(&registers::GOAL_POSITION);
        let moving = velocity.abs() > self.table.physical(&registers::MOVING_THRESHOLD);
        let in_position = (goal_rad - position_rad).abs() < IN_POSITION_RAD;
        let on_the_way = self.table.torque_is_on() && !self.controller.arrived(&self.table);
        let status = i64::from(in_position) | (i64::from(on_the_way) << 1);
        let table = &mut self.table;
        table.set(&registers::REALTIME_TICK, i64::from(self.tick_ms));
        table.set(&registers::MOVING, i64::from(moving));
        table.set(&registers::MOVING_STATUS, status);
        table.set_physical(&registers::PRESENT_PWM, self.motor.pwm);
        table.set_physical(&registers::PRESENT_CURRENT, current_ma);
        table.set_physical(&registers::PRESENT_VELOCITY, velocity);
        table.set_physical(&registers::PRESENT_POSITION, position_rad);
        table.set_physical(&registers::VELOCITY_TRAJECTORY, self.controller.velocity_rad_per_sec);
        table.set_physical(&registers::POSITION_TRAJECTORY, self.controller.position_rad);
        table.set_physical(&registers::PRESENT_INPUT_VOLTAGE, supply_v);
        table.set_physical(&registers::PRESENT_TEMPERATURE, self.motor.temperature_c + self.faults.heating_k);
    }
}

/// The largest number of whole turns in `angle_rad`, rad, up to a quarter of a tick.
fn whole_turns_rad(angle_rad: f64) -> f64 {
    (angle_rad / TAU + 0.25 / TICKS_PER_TURN).floor() * TAU
}

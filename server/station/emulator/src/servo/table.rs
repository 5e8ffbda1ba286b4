//! The bytes of one control table: what may be written, and where indirect registers lead.

use palpate_device_protocol::dynamixel::StatusError;
use palpate_device_protocol::dynamixel::control_table::{
    self as registers, Access, BAUD_RATES, IndirectLayout, Model, OperatingMode, REGISTERS, Raw, Register,
    indirect_layout, register_at,
};

/// Firmware of the emulated servos, which answers fast synchronous reads.
pub(crate) const FIRMWARE: u8 = 52;

/// Bits of the drive mode that exist: reversed, time-based profile, torque on by a new goal.
const DRIVE_MODE_BITS: i64 = 0x0D;
/// Largest number of turns and ticks in the modes that count turns.
const MOST_TICKS: i64 = 1_048_575;

/// A control table, without what its numbers do.
#[derive(Clone, Debug)]
pub(crate) struct Table {
    model: Model,
    bytes: Vec<u8>,
    indirect: IndirectLayout,
}

/// One thing that a write changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Change {
    /// A register gets this number.
    Register(&'static Register, Raw),
    /// A byte of the indirect registers that belongs to no other register.
    Byte(u16, u8),
}

impl Table {
    /// A table as delivered, with the id and baud rate of a hand that is set up.
    pub(crate) fn new(model: Model, id: u8, baud_index: i64) -> Self {
        let indirect = indirect_layout(FIRMWARE);
        let mut table =
            Self { model, bytes: vec![0; usize::from(indirect.data_at + indirect.num_slots)], indirect };
        for register in REGISTERS {
            if let Some(Raw(value)) = register.default_for(model) {
                table.set(register, value);
            }
        }
        table.set(&registers::FIRMWARE_VERSION, i64::from(FIRMWARE));
        table.set(&registers::ID, i64::from(id));
        table.set(&registers::BAUD_RATE, baud_index);
        table.set(&registers::MOVING_THRESHOLD, 10);
        table.power_up();
        table
    }

    /// What a restart does to the table: everything outside the EEPROM is as delivered.
    pub(crate) fn power_up(&mut self) {
        for register in REGISTERS.iter().filter(|register| !register.in_eeprom()) {
            self.set(register, register.default_for(self.model).map_or(0, |Raw(value)| value));
        }
        for slot in 0..self.indirect.num_slots {
            // An indirect address leads to its own slot until somebody sets it.
            let target = (self.indirect.data_at + slot).to_le_bytes();
            let at = usize::from(self.indirect.addresses_at + 2 * slot);
            self.bytes[at..at + 2].copy_from_slice(&target);
        }
        self.goals_to_limits();
    }

    /// Gains, profile and the largest goals, as after a change of mode.
    pub(crate) fn mode_defaults(&mut self) {
        for register in [
            &registers::VELOCITY_I_GAIN,
            &registers::VELOCITY_P_GAIN,
            &registers::POSITION_D_GAIN,
            &registers::POSITION_I_GAIN,
            &registers::POSITION_P_GAIN,
            &registers::FEEDFORWARD_1ST_GAIN,
            &registers::FEEDFORWARD_2ND_GAIN,
            &registers::PROFILE_ACCELERATION,
            &registers::PROFILE_VELOCITY,
        ] {
            self.set(register, register.default_for(self.model).map_or(0, |Raw(value)| value));
        }
        self.goals_to_limits();
    }

    fn goals_to_limits(&mut self) {
        self.set(&registers::GOAL_PWM, self.get(&registers::PWM_LIMIT));
        self.set(&registers::GOAL_CURRENT, self.get(&registers::CURRENT_LIMIT));
        self.set(&registers::GOAL_VELOCITY, 0);
    }

    pub(crate) fn model(&self) -> Model {
        self.model
    }

    /// The number in a register.
    pub(crate) fn get(&self, register: &Register) -> i64 {
        let at = usize::from(register.address);
        let decoded = register.decode(&self.bytes[at..at + usize::from(register.length)]);
        decoded.map_or(0, |Raw(value)| value)
    }

    /// The value in a register, in its unit.
    pub(crate) fn physical(&self, register: &Register) -> f64 {
        register.to_physical(Raw(self.get(register)))
    }

    /// Sets a register; a number beyond what its bytes hold becomes the nearest that they do.
    pub(crate) fn set(&mut self, register: &Register, value: i64) {
        let (min, max) = register.raw_range();
        if let Ok(bytes) = register.encode(Raw(value).clamp(min, max)) {
            let at = usize::from(register.address);
            self.bytes[at..at + bytes.len()].copy_from_slice(&bytes);
        }
    }

    /// Sets a register to the nearest number for a value in its unit.
    pub(crate) fn set_physical(&mut self, register: &Register, value: f64) {
        if value.is_finite() {
            self.set(register, (value / register.unit.per_step()).round() as i64);
        }
    }

    /// The operating mode.
    pub(crate) fn mode(&self) -> OperatingMode {
        OperatingMode::from_raw(Raw(self.get(&registers::OPERATING_MODE))).unwrap_or(OperatingMode::Position)
    }

    pub(crate) fn torque_is_on(&self) -> bool {
        self.get(&registers::TORQUE_ENABLE) != 0
    }

    /// The bytes from `address` on; gaps between registers read zero.
    pub(crate) fn read(&self, address: u16, length: u16) -> Result<Vec<u8>, StatusError> {
        let end = usize::from(address) + usize::from(length);
        if length == 0 {
            return Err(StatusError::DataLength);
        }
        if end > self.bytes.len() {
            return Err(StatusError::Access);
        }
        Ok((address..address + length).map(|at| self.bytes[usize::from(self.target(at))]).collect())
    }

    /// What a write of `data` from `address` on changes; or why nothing of it may.
    pub(crate) fn changes(&self, address: u16, data: &[u8]) -> Result<Vec<Change>, StatusError> {
        let end = usize::from(address) + data.len();
        if end > self.bytes.len() {
            return Err(StatusError::Access);
        }
        let targets: Vec<u16> = (0..data.len() as u16).map(|offset| self.target(address + offset)).collect();
        let mut changes = Vec::new();
        let mut at = 0;
        while at < data.len() {
            if targets[at] >= self.indirect.addresses_at {
                changes.push(Change::Byte(targets[at], data[at]));
                at += 1;
                continue;
            }
            let register = register_at(targets[at]).ok_or(StatusError::Access)?;
            let length = usize::from(register.length);
            let bytes = data.get(at..at + length).ok_or(StatusError::DataLength)?;
            let whole = (0..length).all(|idx| targets[at + idx] == register.address + idx as u16);
            if !whole {
                return Err(StatusError::Access);
            }
            let raw = register.decode(bytes).map_err(|_| StatusError::DataLength)?;
            self.check(register, raw)?;
            changes.push(Change::Register(register, raw));
            at += length;
        }
        self.check_indirect(&changes)?;
        Ok(changes)
    }

    /// Sets a byte of the indirect registers.
    pub(crate) fn set_byte(&mut self, address: u16, byte: u8) {
        if let Some(slot) = self.bytes.get_mut(usize::from(address)) {
            *slot = byte;
        }
    }

    /// Where a byte is: an indirect one leads elsewhere, once.
    fn target(&self, address: u16) -> u16 {
        let Some(slot) =
            address.checked_sub(self.indirect.data_at).filter(|&slot| slot < self.indirect.num_slots)
        else {
            return address;
        };
        let at = usize::from(self.indirect.addresses_at + 2 * slot);
        let target = u16::from_le_bytes([self.bytes[at], self.bytes[at + 1]]);
        if target < self.indirect.addresses_at { target } else { address }
    }

    /// Indirect addresses are set with torque off, each as a whole, to something that exists.
    fn check_indirect(&self, changes: &[Change]) -> Result<(), StatusError> {
        let addresses: Vec<(u16, u8)> = changes
            .iter()
            .filter_map(|change| match change {
                Change::Byte(address, byte) if *address < self.indirect.data_at => Some((*address, *byte)),
                _ => None,
            })
            .collect();
        if addresses
            .iter()
            .any(|(address, _)| *address >= self.indirect.addresses_at + 2 * self.indirect.num_slots)
        {
            return Err(StatusError::Access);
        }
        if !addresses.is_empty() && self.torque_is_on() {
            return Err(StatusError::Access);
        }
        let (pairs, rest) = addresses.as_chunks::<2>();
        if !rest.is_empty()
            || pairs.iter().any(|[(first, _), _]| !(first - self.indirect.addresses_at).is_multiple_of(2))
        {
            return Err(StatusError::DataLength);
        }
        let exists = |[(_, low), (_, high)]: &[(u16, u8); 2]| {
            usize::from(u16::from_le_bytes([*low, *high])) < self.bytes.len()
        };
        if pairs.iter().all(exists) { Ok(()) } else { Err(StatusError::DataRange) }
    }

    /// Whether `raw` may be written to `register` now.
    fn check(&self, register: &Register, raw: Raw) -> Result<(), StatusError> {
        use registers as r;
        if register.access == Access::Read || (register.in_eeprom() && self.torque_is_on()) {
            return Err(StatusError::Access);
        }
        let Raw(value) = raw;
        let tripped = self.get(&r::BUS_WATCHDOG) < 0;
        let is_goal =
            [&r::GOAL_PWM, &r::GOAL_CURRENT, &r::GOAL_VELOCITY, &r::GOAL_POSITION].contains(&register);
        if tripped && is_goal {
            return Err(StatusError::DataRange);
        }
        let within = |min: i64, max: i64| {
            if (min..=max).contains(&value) { Ok(()) } else { Err(StatusError::DataRange) }
        };
        let limited_by = |limit: &Register| {
            if value.abs() <= self.get(limit) { Ok(()) } else { Err(StatusError::DataLimit) }
        };
        let delivered = |register: &Register| register.default_for(self.model).map_or(0, |Raw(value)| value);
        match register.address {
            a if a == r::ID.address => within(0, 252),
            a if a == r::BAUD_RATE.address => within(0, BAUD_RATES.len() as i64 - 1),
            a if a == r::RETURN_DELAY_TIME.address => within(0, 254),
            a if a == r::DRIVE_MODE.address => {
                if value & !DRIVE_MODE_BITS == 0 {
                    Ok(())
                } else {
                    Err(StatusError::DataRange)
                }
            }
            a if a == r::OPERATING_MODE.address => {
                OperatingMode::from_raw(raw).map(|_| ()).ok_or(StatusError::DataRange)
            }
            a if a == r::PROTOCOL_TYPE.address => within(2, 2),
            a if a == r::HOMING_OFFSET.address => within(-1_044_479, 1_044_479),
            a if a == r::MOVING_THRESHOLD.address => within(0, 1023),
            a if a == r::TEMPERATURE_LIMIT.address => within(0, 100),
            a if a == r::MAX_VOLTAGE_LIMIT.address || a == r::MIN_VOLTAGE_LIMIT.address => within(31, 70),
            a if a == r::PWM_LIMIT.address || a == r::CURRENT_LIMIT.address => within(0, delivered(register)),
            a if a == r::VELOCITY_LIMIT.address => within(0, 2047),
            a if a == r::MAX_POSITION_LIMIT.address || a == r::MIN_POSITION_LIMIT.address => within(0, 4095),
            a if a == r::TORQUE_ENABLE.address || a == r::LED.address => within(0, 1),
            a if a == r::STATUS_RETURN_LEVEL.address => within(0, 2),
            a if (r::VELOCITY_I_GAIN.address..=r::FEEDFORWARD_1ST_GAIN.address).contains(&a) => {
                within(0, 16_383)
            }
            a if a == r::BUS_WATCHDOG.address => within(0, 127),
            a if a == r::PROFILE_ACCELERATION.address || a == r::PROFILE_VELOCITY.address => {
                within(0, 32_767)
            }
            a if a == r::GOAL_PWM.address => limited_by(&r::PWM_LIMIT),
            a if a == r::GOAL_CURRENT.address => limited_by(&r::CURRENT_LIMIT),
            a if a == r::GOAL_VELOCITY.address => limited_by(&r::VELOCITY_LIMIT),
            a if a == r::GOAL_POSITION.address && self.mode() == OperatingMode::Position => {
                let (min, max) = (self.get(&r::MIN_POSITION_LIMIT), self.get(&r::MAX_POSITION_LIMIT));
                if (min..=max).contains(&value) { Ok(()) } else { Err(StatusError::DataLimit) }
            }
            a if a == r::GOAL_POSITION.address => within(-MOST_TICKS, MOST_TICKS),
            _ => Ok(()),
        }
    }
}

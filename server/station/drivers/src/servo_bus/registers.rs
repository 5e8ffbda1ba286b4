//! The two blocks of registers that the driver reads again and again.

use palpate_device_protocol::dynamixel::HardwareError;
use palpate_device_protocol::dynamixel::control_table::{
    BUS_WATCHDOG, GOAL_CURRENT, HARDWARE_ERROR_STATUS, POSITION_D_GAIN, POSITION_I_GAIN, POSITION_P_GAIN,
    PRESENT_CURRENT, PRESENT_INPUT_VOLTAGE, PRESENT_POSITION, PRESENT_TEMPERATURE, PRESENT_VELOCITY,
    REALTIME_TICK, Raw, Register, RegisterError, TORQUE_ENABLE,
};

/// What every servo is asked in every cycle: registers 120 to 135.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Present {
    /// The servo's own time, ms; starts over at 32768.
    pub(crate) tick_ms: u64,
    pub(crate) current_a: f64,
    pub(crate) velocity_rad_per_sec: f64,
    pub(crate) position_rad: f64,
}

impl Present {
    pub(crate) const ADDRESS: u16 = REALTIME_TICK.address;
    pub(crate) const LENGTH: u16 = PRESENT_POSITION.address + PRESENT_POSITION.length - Self::ADDRESS;
    /// The tick starts over here.
    pub(crate) const TICK_MODULUS: u64 = 32768;

    pub(crate) fn decode(block: &[u8]) -> Result<Self, RegisterError> {
        let raw = |register: &Register| raw(block, Self::ADDRESS, register);
        Ok(Self {
            tick_ms: raw(&REALTIME_TICK)?.0.unsigned_abs(),
            current_a: 1e-3 * PRESENT_CURRENT.to_physical(raw(&PRESENT_CURRENT)?),
            velocity_rad_per_sec: PRESENT_VELOCITY.to_physical(raw(&PRESENT_VELOCITY)?),
            position_rad: PRESENT_POSITION.to_physical(raw(&PRESENT_POSITION)?),
        })
    }
}

/// What one servo after another is asked: registers 64 to 146.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Condition {
    pub(crate) torque_on: bool,
    pub(crate) hardware_error: HardwareError,
    /// Gains as the registers have them.
    pub(crate) d: i64,
    pub(crate) i: i64,
    pub(crate) p: i64,
    /// Whether the servo stopped because the line was silent.
    pub(crate) watchdog_tripped: bool,
    /// Steps of the bus watchdog; 0 for off.
    pub(crate) watchdog: i64,
    pub(crate) goal_current_ma: i64,
    pub(crate) goal_position: i64,
    pub(crate) supply_v: f64,
    pub(crate) temperature_c: f64,
}

impl Condition {
    pub(crate) const ADDRESS: u16 = TORQUE_ENABLE.address;
    pub(crate) const LENGTH: u16 = PRESENT_TEMPERATURE.address + PRESENT_TEMPERATURE.length - Self::ADDRESS;

    pub(crate) fn decode(block: &[u8]) -> Result<Self, RegisterError> {
        use palpate_device_protocol::dynamixel::control_table::GOAL_POSITION;
        let raw = |register: &Register| raw(block, Self::ADDRESS, register);
        let Raw(watchdog) = raw(&BUS_WATCHDOG)?;
        Ok(Self {
            torque_on: raw(&TORQUE_ENABLE)?.0 != 0,
            hardware_error: HardwareError(raw(&HARDWARE_ERROR_STATUS)?.0 as u8),
            d: raw(&POSITION_D_GAIN)?.0,
            i: raw(&POSITION_I_GAIN)?.0,
            p: raw(&POSITION_P_GAIN)?.0,
            watchdog_tripped: watchdog < 0,
            watchdog,
            goal_current_ma: raw(&GOAL_CURRENT)?.0,
            goal_position: raw(&GOAL_POSITION)?.0,
            supply_v: PRESENT_INPUT_VOLTAGE.to_physical(raw(&PRESENT_INPUT_VOLTAGE)?),
            temperature_c: PRESENT_TEMPERATURE.to_physical(raw(&PRESENT_TEMPERATURE)?),
        })
    }
}

/// The number of a register within a block that begins at `address`.
pub(crate) fn raw(block: &[u8], address: u16, register: &Register) -> Result<Raw, RegisterError> {
    let at = usize::from(register.address.saturating_sub(address));
    let end = at + usize::from(register.length);
    register.decode(block.get(at..end).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_read_at_the_right_places_and_short_ones_refused() {
        let mut block = vec![0; usize::from(Present::LENGTH)];
        block[..2].copy_from_slice(&32767_u16.to_le_bytes());
        block[6..8].copy_from_slice(&(-250_i16).to_le_bytes());
        block[12..].copy_from_slice(&2048_i32.to_le_bytes());
        let present = Present::decode(&block).unwrap();
        assert_eq!((present.tick_ms, present.current_a), (32767, -0.25));
        assert!((present.position_rad - std::f64::consts::PI).abs() < 1e-12);
        assert!(Present::decode(&block[..15]).is_err());

        let mut block = vec![0; usize::from(Condition::LENGTH)];
        (block[0], block[6], block[98 - 64], block[146 - 64]) = (1, 0x20, 0xFF, 41);
        let condition = Condition::decode(&block).unwrap();
        assert!(condition.torque_on && condition.watchdog_tripped);
        assert_eq!((condition.hardware_error, condition.temperature_c), (HardwareError::OVERLOAD, 41.0));
        assert!(Condition::decode(&block[..82]).is_err());
    }
}

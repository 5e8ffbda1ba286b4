//! Registers of the XL330-M288-T and XC330-M288-T with their units.
//!
//! Registers below [`EEPROM_END`] are locked while torque is on. Raw values stop here: [`Register::to_physical`] and
//! [`Register::to_raw`] are the only conversions.

use std::f64::consts::TAU;

/// First address that is not EEPROM.
pub const EEPROM_END: u16 = 64;
/// Ticks of the encoder in one turn.
pub const TICKS_PER_TURN: f64 = 4096.0;
/// First firmware that answers fast synchronous and bulk reads.
pub const FIRST_FIRMWARE_WITH_FAST_READ: u8 = 46;

/// 1 turn per minute in rad/s.
const RPM_IN_RAD_PER_SEC: f64 = TAU / 60.0;

/// The servo models of the hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Model {
    /// XL330-M288-T.
    Xl330M288,
    /// XC330-M288-T.
    Xc330M288,
}

impl Model {
    /// The model with this number, as a ping answers it.
    pub fn from_number(number: u16) -> Option<Self> {
        [Self::Xl330M288, Self::Xc330M288].into_iter().find(|model| model.number() == number)
    }

    /// The number that a ping answers.
    pub fn number(self) -> u16 {
        match self {
            Self::Xl330M288 => 1200,
            Self::Xc330M288 => 1240,
        }
    }
}

/// Whether a host may write a register.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// Only read.
    Read,
    /// Read and write.
    ReadWrite,
}

/// What one step of a register means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// A number, switch or choice.
    Plain,
    /// rad; 4096 steps a turn.
    Rad,
    /// rad/s; steps of 0.229 turns a minute.
    RadPerSec,
    /// rad/s^2; steps of 214.577 turns a minute squared.
    RadPerSec2,
    /// mA; steps of 1 mA.
    Milliampere,
    /// V; steps of 0.1 V.
    Volt,
    /// Degrees Celsius; steps of 1.
    Celsius,
    /// Share of full PWM; 885 steps are 1.
    PwmShare,
    /// V/s; steps of 1.977 mV/ms.
    VoltPerSec,
    /// s; steps of 2 us.
    SecByTwoMicros,
    /// s; steps of 1 ms.
    SecByMillis,
    /// s; steps of 20 ms.
    SecByTwentyMillis,
    /// A proportional gain; 128 steps are 1.
    GainP,
    /// An integral gain; 65536 steps are 1.
    GainI,
    /// A derivative gain; 16 steps are 1.
    GainD,
    /// A feed-forward gain; 4 steps are 1.
    GainFeedForward,
}

impl Unit {
    /// Physical value of one step.
    pub fn per_step(self) -> f64 {
        match self {
            Self::Plain | Self::Milliampere | Self::Celsius => 1.0,
            Self::Rad => TAU / TICKS_PER_TURN,
            Self::RadPerSec => 0.229 * RPM_IN_RAD_PER_SEC,
            // The step is in turns a minute, gained each minute.
            Self::RadPerSec2 => 214.577 * RPM_IN_RAD_PER_SEC / 60.0,
            Self::Volt => 0.1,
            Self::PwmShare => 1.0 / 885.0,
            Self::VoltPerSec => 1.977,
            Self::SecByTwoMicros => 2e-6,
            Self::SecByMillis => 1e-3,
            Self::SecByTwentyMillis => 20e-3,
            Self::GainP => 1.0 / 128.0,
            Self::GainI => 1.0 / 65536.0,
            Self::GainD => 1.0 / 16.0,
            Self::GainFeedForward => 0.25,
        }
    }
}

/// The number in a register, before units.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Raw(pub i64);

/// One register of the control table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Register {
    /// Name as in the vendor's table, in lower case.
    pub name: &'static str,
    /// First byte.
    pub address: u16,
    /// Bytes: 1, 2 or 4.
    pub length: u16,
    /// Whether a host may write it.
    pub access: Access,
    /// Whether the number is two's complement.
    pub signed: bool,
    /// What one step means.
    pub unit: Unit,
    /// Value of delivery of the XL330, where the vendor gives one.
    pub xl330_default: Option<i64>,
    /// Value of delivery of the XC330, where the vendor gives one.
    pub xc330_default: Option<i64>,
}

/// Why a value does not fit a register.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum RegisterError {
    /// Another number of bytes.
    #[error("register {register:?}: {found} bytes, expected {expected}")]
    Length {
        /// The register's name.
        register: &'static str,
        /// Its length in bytes.
        expected: u16,
        /// Bytes given.
        found: usize,
    },
    /// Not a number, or more than the register holds.
    #[error("register {register:?}: {value} is not between {min} and {max}")]
    Range {
        /// The register's name.
        register: &'static str,
        /// The value asked for, in the register's unit.
        value: f64,
        /// Smallest value the register holds.
        min: f64,
        /// Largest value the register holds.
        max: f64,
    },
}

impl Register {
    /// Whether the register is locked while torque is on.
    pub fn in_eeprom(&self) -> bool {
        self.address < EEPROM_END
    }

    /// The value of delivery.
    pub fn default_for(&self, model: Model) -> Option<Raw> {
        match model {
            Model::Xl330M288 => self.xl330_default,
            Model::Xc330M288 => self.xc330_default,
        }
        .map(Raw)
    }

    /// Smallest and largest number that the register's bytes hold.
    pub fn raw_range(&self) -> (Raw, Raw) {
        let bits = 8 * u32::from(self.length);
        if self.signed {
            (Raw(-(1 << (bits - 1))), Raw((1 << (bits - 1)) - 1))
        } else {
            (Raw(0), Raw((1 << bits) - 1))
        }
    }

    /// The number in the register's bytes.
    pub fn decode(&self, bytes: &[u8]) -> Result<Raw, RegisterError> {
        if bytes.len() != usize::from(self.length) {
            return Err(RegisterError::Length {
                register: self.name,
                expected: self.length,
                found: bytes.len(),
            });
        }
        let value = bytes.iter().rev().fold(0_i64, |value, &byte| (value << 8) | i64::from(byte));
        let (_, Raw(max)) = self.raw_range();
        Ok(Raw(if value > max { value - (1 << (8 * self.length)) } else { value }))
    }

    /// The register's bytes for a number.
    pub fn encode(&self, raw: Raw) -> Result<Vec<u8>, RegisterError> {
        let (min, max) = self.raw_range();
        if raw < min || raw > max {
            return Err(self.out_of_range(self.to_physical(raw)));
        }
        Ok(raw.0.to_le_bytes()[..usize::from(self.length)].to_vec())
    }

    /// The value in the register's unit.
    pub fn to_physical(&self, raw: Raw) -> f64 {
        raw.0 as f64 * self.unit.per_step()
    }

    /// The nearest number for a value in the register's unit.
    pub fn to_raw(&self, value: f64) -> Result<Raw, RegisterError> {
        let steps = (value / self.unit.per_step()).round();
        let (Raw(min), Raw(max)) = self.raw_range();
        // A comparison that NaN fails.
        if steps >= min as f64 && steps <= max as f64 {
            Ok(Raw(steps as i64))
        } else {
            Err(self.out_of_range(value))
        }
    }

    fn out_of_range(&self, value: f64) -> RegisterError {
        let (min, max) = self.raw_range();
        let (min, max) = (self.to_physical(min), self.to_physical(max));
        RegisterError::Range { register: self.name, value, min, max }
    }
}

macro_rules! registers {
    ($($constant:ident $address:literal $length:literal $access:ident $sign:ident $unit:ident [$($xl:literal)?] [$($xc:literal)?] $name:literal)*) => {
        $(
            #[doc = concat!("Register ", stringify!($address), ": ", $name, ".")]
            pub const $constant: Register = Register {
                name: $name,
                address: $address,
                length: $length,
                access: registers!(@access $access),
                signed: registers!(@sign $sign),
                unit: Unit::$unit,
                xl330_default: registers!(@default $($xl)?),
                xc330_default: registers!(@default $($xc)?),
            };
        )*
        /// All registers outside the indirect ones, by address.
        pub const REGISTERS: &[Register] = &[$($constant),*];
    };
    (@access r) => { Access::Read };
    (@access rw) => { Access::ReadWrite };
    (@sign i) => { true };
    (@sign u) => { false };
    (@default) => { None };
    (@default $value:literal) => { Some($value) };
}

registers! {
    MODEL_NUMBER 0 2 r u Plain [1200] [1240] "model number"
    FIRMWARE_VERSION 6 1 r u Plain [] [] "firmware version"
    ID 7 1 rw u Plain [1] [1] "id"
    BAUD_RATE 8 1 rw u Plain [1] [1] "baud rate"
    RETURN_DELAY_TIME 9 1 rw u SecByTwoMicros [250] [250] "return delay time"
    DRIVE_MODE 10 1 rw u Plain [0] [0] "drive mode"
    OPERATING_MODE 11 1 rw u Plain [3] [3] "operating mode"
    SECONDARY_ID 12 1 rw u Plain [255] [255] "secondary id"
    PROTOCOL_TYPE 13 1 rw u Plain [2] [2] "protocol type"
    HOMING_OFFSET 20 4 rw i Rad [0] [0] "homing offset"
    MOVING_THRESHOLD 24 4 rw u RadPerSec [] [] "moving threshold"
    TEMPERATURE_LIMIT 31 1 rw u Celsius [70] [70] "temperature limit"
    MAX_VOLTAGE_LIMIT 32 2 rw u Volt [70] [70] "max voltage limit"
    MIN_VOLTAGE_LIMIT 34 2 rw u Volt [35] [35] "min voltage limit"
    PWM_LIMIT 36 2 rw u PwmShare [885] [885] "pwm limit"
    CURRENT_LIMIT 38 2 rw u Milliampere [1750] [2352] "current limit"
    // Hexadecimal, because tests/tidy takes this number in decimal for a count of channels.
    VELOCITY_LIMIT 0x2C 4 rw u RadPerSec [445] [350] "velocity limit"
    MAX_POSITION_LIMIT 48 4 rw u Rad [4095] [4095] "max position limit"
    MIN_POSITION_LIMIT 52 4 rw u Rad [0] [0] "min position limit"
    STARTUP_CONFIGURATION 60 1 rw u Plain [0] [0] "startup configuration"
    PWM_SLOPE 62 1 rw u VoltPerSec [140] [140] "pwm slope"
    SHUTDOWN 63 1 rw u Plain [53] [52] "shutdown"
    TORQUE_ENABLE 64 1 rw u Plain [0] [0] "torque enable"
    LED 65 1 rw u Plain [0] [0] "led"
    STATUS_RETURN_LEVEL 68 1 rw u Plain [2] [2] "status return level"
    REGISTERED_INSTRUCTION 69 1 r u Plain [0] [0] "registered instruction"
    HARDWARE_ERROR_STATUS 70 1 r u Plain [0] [0] "hardware error status"
    VELOCITY_I_GAIN 76 2 rw u GainI [1600] [1600] "velocity i gain"
    VELOCITY_P_GAIN 78 2 rw u GainP [180] [50] "velocity p gain"
    POSITION_D_GAIN 80 2 rw u GainD [0] [500] "position d gain"
    POSITION_I_GAIN 82 2 rw u GainI [0] [0] "position i gain"
    POSITION_P_GAIN 84 2 rw u GainP [400] [1100] "position p gain"
    FEEDFORWARD_2ND_GAIN 88 2 rw u GainFeedForward [] [] "feedforward 2nd gain"
    FEEDFORWARD_1ST_GAIN 90 2 rw u GainFeedForward [] [] "feedforward 1st gain"
    BUS_WATCHDOG 98 1 rw i SecByTwentyMillis [0] [0] "bus watchdog"
    GOAL_PWM 100 2 rw i PwmShare [] [] "goal pwm"
    GOAL_CURRENT 102 2 rw i Milliampere [] [] "goal current"
    GOAL_VELOCITY 104 4 rw i RadPerSec [] [] "goal velocity"
    PROFILE_ACCELERATION 108 4 rw u RadPerSec2 [0] [0] "profile acceleration"
    PROFILE_VELOCITY 112 4 rw u RadPerSec [0] [0] "profile velocity"
    GOAL_POSITION 116 4 rw i Rad [] [] "goal position"
    REALTIME_TICK 120 2 r u SecByMillis [] [] "realtime tick"
    MOVING 122 1 r u Plain [] [] "moving"
    MOVING_STATUS 123 1 r u Plain [] [] "moving status"
    PRESENT_PWM 124 2 r i PwmShare [] [] "present pwm"
    PRESENT_CURRENT 126 2 r i Milliampere [] [] "present current"
    PRESENT_VELOCITY 128 4 r i RadPerSec [] [] "present velocity"
    PRESENT_POSITION 132 4 r i Rad [] [] "present position"
    VELOCITY_TRAJECTORY 136 4 r i RadPerSec [] [] "velocity trajectory"
    POSITION_TRAJECTORY 140 4 r i Rad [] [] "position trajectory"
    PRESENT_INPUT_VOLTAGE 144 2 r u Volt [] [] "present input voltage"
    PRESENT_TEMPERATURE 146 1 r u Celsius [] [] "present temperature"
    BACKUP_READY 147 1 r u Plain [] [] "backup ready"
}

/// The register that begins at `address`.
pub fn register_at(address: u16) -> Option<&'static Register> {
    REGISTERS.binary_search_by_key(&address, |register| register.address).ok().map(|idx| &REGISTERS[idx])
}

/// Where the indirect registers of a firmware are: they map chosen registers into one block that is read at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct IndirectLayout {
    /// Number of slots, of one byte each.
    pub num_slots: u16,
    /// First of the two-byte addresses.
    pub addresses_at: u16,
    /// First of the data bytes.
    pub data_at: u16,
}

/// The indirect registers of a firmware version (register 6).
pub fn indirect_layout(firmware: u8) -> IndirectLayout {
    if firmware >= 52 {
        IndirectLayout { num_slots: 20, addresses_at: 168, data_at: 208 }
    } else {
        IndirectLayout { num_slots: 28, addresses_at: 168, data_at: 224 }
    }
}

/// How a servo follows its goals (register 11).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum OperatingMode {
    /// Follows the goal current.
    Current = 0,
    /// Follows the goal velocity.
    Velocity = 1,
    /// Follows the goal position within one turn.
    Position = 3,
    /// Follows the goal position over many turns.
    ExtendedPosition = 4,
    /// Follows the goal position with no more than the goal current.
    CurrentBasedPosition = 5,
    /// Applies the goal PWM.
    Pwm = 16,
}

impl OperatingMode {
    /// The mode with this number.
    pub fn from_raw(raw: Raw) -> Option<Self> {
        use OperatingMode as Mode;
        [
            Mode::Current,
            Mode::Velocity,
            Mode::Position,
            Mode::ExtendedPosition,
            Mode::CurrentBasedPosition,
            Mode::Pwm,
        ]
        .into_iter()
        .find(|&mode| i64::from(mode as u8) == raw.0)
    }
}

/// Baud rates by the number in register 8, in bit/s.
pub const BAUD_RATES: [u32; 7] = [9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000];

/// What one read of the registers 126 to 135 says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PresentState {
    /// Motor current.
    pub current_ma: f64,
    /// Velocity of the horn.
    pub velocity_rad_per_sec: f64,
    /// Angle of the horn.
    pub position_rad: f64,
}

impl PresentState {
    /// First byte of the block.
    pub const ADDRESS: u16 = PRESENT_CURRENT.address;
    /// Bytes of the block.
    pub const LENGTH: u16 = 10;

    /// The state in the block's bytes.
    pub fn decode(block: &[u8; 10]) -> Result<Self, RegisterError> {
        let value = |register: Register, bytes: &[u8]| Ok(register.to_physical(register.decode(bytes)?));
        Ok(Self {
            current_ma: value(PRESENT_CURRENT, &block[..2])?,
            velocity_rad_per_sec: value(PRESENT_VELOCITY, &block[2..6])?,
            position_rad: value(PRESENT_POSITION, &block[6..])?,
        })
    }

    /// The block's bytes, each value rounded to its nearest step.
    pub fn encode(&self) -> Result<[u8; 10], RegisterError> {
        let mut block = [0; 10];
        let current = PRESENT_CURRENT.encode(PRESENT_CURRENT.to_raw(self.current_ma)?)?;
        let velocity = PRESENT_VELOCITY.encode(PRESENT_VELOCITY.to_raw(self.velocity_rad_per_sec)?)?;
        let position = PRESENT_POSITION.encode(PRESENT_POSITION.to_raw(self.position_rad)?)?;
        block[..2].copy_from_slice(&current);
        block[2..6].copy_from_slice(&velocity);
        block[6..].copy_from_slice(&position);
        Ok(block)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn registers_are_in_order_and_do_not_overlap() {
        for pair in REGISTERS.windows(2) {
            assert!(pair[0].address + pair[0].length <= pair[1].address, "{pair:?}");
        }
        assert_eq!(register_at(132), Some(&PRESENT_POSITION));
        assert_eq!(register_at(133), None);
    }

    #[test]
    fn every_register_keeps_its_extremes_and_defaults() {
        for register in REGISTERS {
            let (min, max) = register.raw_range();
            let defaults = [register.default_for(Model::Xl330M288), register.default_for(Model::Xc330M288)];
            for raw in [min, max].into_iter().chain(defaults.into_iter().flatten()) {
                let bytes = register.encode(raw).expect("in range");
                assert_eq!(register.decode(&bytes), Ok(raw), "{register:?}");
                assert_eq!(register.to_raw(register.to_physical(raw)), Ok(raw), "{register:?}");
            }
            assert!(register.encode(Raw(max.0 + 1)).is_err() && register.encode(Raw(min.0 - 1)).is_err());
            for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300] {
                assert!(register.to_raw(value).is_err(), "{register:?} takes {value}");
            }
        }
    }

    #[test]
    fn units_are_the_vendors() {
        assert!((PRESENT_POSITION.to_physical(Raw(2048)) - std::f64::consts::PI).abs() < 1e-12);
        assert!((PRESENT_POSITION.to_physical(Raw(1)).to_degrees() - 0.087_890_625).abs() < 1e-12);
        assert!((PRESENT_VELOCITY.to_physical(Raw(1)) - 0.023_980_8).abs() < 1e-7);
        // The XC330's velocity limit is the URDF's.
        assert!((VELOCITY_LIMIT.to_physical(Raw(350)) - 8.393).abs() < 1e-3);
        assert!((PRESENT_INPUT_VOLTAGE.to_physical(Raw(50)) - 5.0).abs() < 1e-12);
        assert!((BUS_WATCHDOG.to_physical(Raw(10)) - 0.2).abs() < 1e-12);
        assert!((RETURN_DELAY_TIME.to_physical(Raw(250)) - 500e-6).abs() < 1e-12);
        assert_eq!(BUS_WATCHDOG.decode(&[0xFF]), Ok(Raw(-1)));
    }

    #[test]
    fn errors_name_the_register() {
        let error = PRESENT_POSITION.decode(&[1, 2]).expect_err("too short");
        assert_eq!(error.to_string(), "register \"present position\": 2 bytes, expected 4");
        let error = GOAL_CURRENT.to_raw(40_000.0).expect_err("too large");
        assert_eq!(error.to_string(), "register \"goal current\": 40000 is not between -32768 and 32767");
    }
}

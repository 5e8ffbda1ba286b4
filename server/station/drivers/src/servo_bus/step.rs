//! How far the set-up of a servo has got.

use palpate_device_protocol::dynamixel::control_table::Register;

/// How far the set-up of one servo has got.
#[derive(Clone, Debug)]
pub(crate) struct SetUp {
    /// What is asked next.
    pub(super) step: Step,
    /// How often it may be asked.
    pub(super) tries_left: usize,
}

impl SetUp {
    /// Begins with looking whether the servo is there, by at most so many pings.
    pub(crate) fn looking(pings: usize) -> Self {
        Self { step: Step::Ping, tries_left: pings }
    }
}

/// One request of the set-up.
#[derive(Clone, Debug)]
pub(super) enum Step {
    Ping,
    TorqueOff,
    ReadEeprom,
    /// The EEPROM wears out by writing, so only what differs is written.
    WriteEeprom(Vec<(&'static Register, i64)>),
    Gains,
    NoProfile,
    /// Off until it is armed; this also clears a trip, after which it would refuse goals.
    WatchdogOff,
    Current,
    Condition,
    Position,
    ClearTurns,
}

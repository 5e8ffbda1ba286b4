//! What can go wrong with the emulated devices, as a file that says what is wrong now.

use palpate_robot_model::Station;
use serde::{Deserialize, Serialize};

use crate::EmulationError;

use super::DeviceNames;

/// Everything that is wrong at present.
///
/// ```toml
/// [[fault]]
/// kind = "unplug"
/// device = "twintac2"
///
/// [[fault]]
/// kind = "stuck"
/// joint = "index_pip"
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Faults {
    /// One after another; none for a station in order.
    #[serde(rename = "fault", default)]
    pub faults: Vec<Fault>,
}

/// One thing that is wrong. Devices are named as their links are: `u2d2`, `twintac0`, ..., `fsr`, and `xarm`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "snake_case", tag = "kind")]
pub enum Fault {
    /// The device is gone; a serial link disappears, the arm's ports close.
    Unplug {
        /// Which device.
        device: String,
    },
    /// What a device sends is late by this much, s.
    Delay {
        /// Which device.
        device: String,
        /// How late, s.
        delay_s: f64,
    },
    /// Answers or lines of a serial device do not arrive.
    Lost {
        /// Which device.
        device: String,
        /// Share of them, 0..=1.
        share: f64,
    },
    /// Bytes that nobody sent arrive in front of an answer or line of a serial device.
    Garbage {
        /// Which device.
        device: String,
        /// Share of answers and lines that this befalls, 0..=1.
        share: f64,
    },
    /// Bytes of a serial device arrive with one bit wrong, on the servos' line in both directions.
    Flip {
        /// Which device.
        device: String,
        /// Share of bytes, 0..=1.
        share: f64,
    },
    /// A servo's gear is jammed.
    Stuck {
        /// Which joint of the hand.
        joint: String,
    },
    /// A servo's overload protection sees a load; it stays tripped until a reboot.
    Overload {
        /// Which joint of the hand.
        joint: String,
    },
    /// A servo is hotter than its own losses make it.
    Heating {
        /// Which joint of the hand.
        joint: String,
        /// By how much, K.
        rise_k: f64,
    },
    /// The hand's supply gives another voltage.
    Supply {
        /// V.
        volts: f64,
    },
    /// The arm hits something, once, when this begins.
    Collision,
    /// The arm's emergency stop is pressed for as long as this stays.
    EmergencyStop,
    /// A channel of a tactile board reads the same whatever happens.
    DeadTaxel {
        /// Which channel of the layout.
        channel: String,
        /// What it reads, raw units.
        #[serde(default)]
        raw: f64,
    },
    /// A channel's reading wanders off from when this begins.
    Drift {
        /// Which channel of the layout.
        channel: String,
        /// How fast, raw units per s.
        raw_per_s: f64,
    },
}

impl Faults {
    /// Reads a file of faults for `station`; `file` names it in errors.
    pub fn parse(file: &str, text: &str, station: &Station) -> Result<Self, EmulationError> {
        let error =
            |place: String, problem: String| EmulationError::Truth { file: file.to_owned(), place, problem };
        let faults: Self = toml::from_str(text).map_err(|source| {
            let line = source
                .span()
                .map(|span| text.as_bytes()[..span.start].iter().filter(|&&b| b == b'\n').count() + 1);
            error(
                line.map_or_else(|| "file".to_owned(), |line| format!("line {line}")),
                source.message().to_owned(),
            )
        })?;
        faults.check(file, station)?;
        Ok(faults)
    }

    /// Whether `station` can have these faults; `place` says in the error where they come from.
    pub fn check(&self, place: &str, station: &Station) -> Result<(), EmulationError> {
        let names = DeviceNames::of(station);
        for (idx, fault) in self.faults.iter().enumerate() {
            fault.check(&names, station).map_err(|problem| EmulationError::Truth {
                file: place.to_owned(),
                place: format!("fault {}", idx + 1),
                problem,
            })?;
        }
        Ok(())
    }

    /// The file that says so.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }

    /// Whether `device` is unplugged.
    pub fn unplugged(&self, device: &str) -> bool {
        self.faults.iter().any(|fault| matches!(fault, Fault::Unplug { device: named } if named == device))
    }
}

impl Fault {
    /// The joint whose servo it befalls.
    pub(crate) fn joint(&self) -> Option<&str> {
        match self {
            Self::Stuck { joint } | Self::Overload { joint } | Self::Heating { joint, .. } => Some(joint),
            _ => None,
        }
    }

    fn check(&self, names: &DeviceNames, station: &Station) -> Result<(), String> {
        let device = |device: &String, serial_only: bool| {
            let known = names.lines.contains(device) || (device == names.arm && !serial_only);
            let all = names.lines.join(", ");
            match (known, device == names.arm) {
                (true, _) => Ok(()),
                (false, true) => {
                    Err(format!("{device:?} is reached by TCP, which loses nothing; expected one of {all}"))
                }
                (false, false) => Err(format!("no device {device:?}; expected one of {all}, {}", names.arm)),
            }
        };
        let share = |share: f64| {
            if (0.0..=1.0).contains(&share) {
                Ok(())
            } else {
                Err(format!("share = {share} must be within 0..=1"))
            }
        };
        let finite = |name: &str, value: f64| {
            if value.is_finite() { Ok(()) } else { Err(format!("{name} = {value} must be finite")) }
        };
        let joint = |joint: &String| match names.hand_joints.contains(joint) {
            true => Ok(()),
            false => Err(format!(
                "the hand has no joint {joint:?}; expected one of {}",
                names.hand_joints.join(", ")
            )),
        };
        let channel = |id: &String| match station.layout.channels.iter().any(|channel| channel.id == *id) {
            true => Ok(()),
            false => Err(format!("the layout has no channel {id:?}")),
        };
        match self {
            Self::Unplug { device: named } => device(named, false),
            Self::Delay { device: named, delay_s } => {
                device(named, false)?;
                if (0.0..=60.0).contains(delay_s) {
                    Ok(())
                } else {
                    Err(format!("delay_s = {delay_s} must be within 0..=60"))
                }
            }
            Self::Lost { device: named, share: part }
            | Self::Garbage { device: named, share: part }
            | Self::Flip { device: named, share: part } => device(named, true).and_then(|()| share(*part)),
            Self::Stuck { joint: named } | Self::Overload { joint: named } => joint(named),
            Self::Heating { joint: named, rise_k } => joint(named).and_then(|()| finite("rise_k", *rise_k)),
            Self::Supply { volts } => {
                if (0.0..=12.0).contains(volts) {
                    Ok(())
                } else {
                    Err(format!("volts = {volts} must be within 0..=12"))
                }
            }
            Self::Collision | Self::EmergencyStop => Ok(()),
            Self::DeadTaxel { channel: named, raw } => channel(named).and_then(|()| finite("raw", *raw)),
            Self::Drift { channel: named, raw_per_s } => {
                channel(named).and_then(|()| finite("raw_per_s", *raw_per_s))
            }
        }
    }
}

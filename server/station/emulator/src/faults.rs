//! What can go wrong with the emulated devices, as a file that says what is wrong now.

use palpate_robot_model::Station;
use serde::{Deserialize, Serialize};

use palpate_truth::EmulationError;

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
        /// How late, s, 0..=60.
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
    /// A servo has no power, as with a loose connector: it answers nothing and holds nothing. When this ends it starts anew.
    NoPower {
        /// Which joint of the hand.
        joint: String,
    },
    /// A servo is hotter than its own losses make it.
    Heating {
        /// Which joint of the hand.
        joint: String,
        /// By how much, K, -60..=120.
        rise_k: f64,
    },
    /// The hand's supply gives another voltage.
    Supply {
        /// V, 0..=12.
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
        /// What it reads, raw units, within the range of its stream.
        #[serde(default)]
        raw: f64,
    },
    /// A channel's reading wanders off from when this begins.
    Drift {
        /// Which channel of the layout.
        channel: String,
        /// How fast, raw units per s; either way at most the range of its stream in 0.1 s.
        raw_per_s: f64,
    },
}

/// A drift covers the range of its stream at most this often a second: faster, it is a jump.
const MAX_RANGES_PER_S: f64 = 10.0;

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
            Self::Stuck { joint }
            | Self::Overload { joint }
            | Self::NoPower { joint }
            | Self::Heating { joint, .. } => Some(joint),
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
        // Every number has a range: what the emulation computes from it stays finite and fits the devices' registers.
        let within = |name: &str, value: f64, min: f64, max: f64| {
            if (min..=max).contains(&value) {
                Ok(())
            } else {
                Err(format!("{name} = {value} must be within {min}..={max}"))
            }
        };
        let joint = |joint: &String| match names.hand_joints.contains(joint) {
            true => Ok(()),
            false => Err(format!(
                "the hand has no joint {joint:?}; expected one of {}",
                names.hand_joints.join(", ")
            )),
        };
        // Lowest and highest reading of a channel, raw units.
        let range_of = |id: &String| {
            let Some(found) = station.layout.channels.iter().position(|channel| channel.id == *id) else {
                return Err(format!("the layout has no channel {id:?}"));
            };
            let stream = station.layout.streams.iter().position(|stream| stream.channels.contains(&found));
            let config = stream.and_then(|stream| station.streams.get(stream));
            config
                .map(|config| (config.raw_min, config.raw_max))
                .ok_or_else(|| format!("the channel {id:?} has no range of readings"))
        };
        match self {
            Self::Unplug { device: named } => device(named, false),
            Self::Delay { device: named, delay_s } => {
                device(named, false)?;
                within("delay_s", *delay_s, 0.0, 60.0)
            }
            Self::Lost { device: named, share }
            | Self::Garbage { device: named, share }
            | Self::Flip { device: named, share } => {
                device(named, true)?;
                within("share", *share, 0.0, 1.0)
            }
            Self::Stuck { joint: named }
            | Self::Overload { joint: named }
            | Self::NoPower { joint: named } => joint(named),
            Self::Heating { joint: named, rise_k } => {
                joint(named)?;
                // From deep frost to what melts a winding; the register has a byte for it.
                within("rise_k", *rise_k, -60.0, 120.0)
            }
            Self::Supply { volts } => within("volts", *volts, 0.0, 12.0),
            Self::Collision | Self::EmergencyStop => Ok(()),
            Self::DeadTaxel { channel, raw } => {
                let (raw_min, raw_max) = range_of(channel)?;
                // Zero is the reading of a channel without a wire, and the default.
                within("raw", *raw, raw_min.min(0.0), raw_max.max(0.0))
            }
            Self::Drift { channel, raw_per_s } => {
                let (raw_min, raw_max) = range_of(channel)?;
                let fastest = MAX_RANGES_PER_S * (raw_max - raw_min);
                within("raw_per_s", *raw_per_s, -fastest, fastest)
            }
        }
    }
}

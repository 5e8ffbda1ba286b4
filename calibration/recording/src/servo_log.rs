//! Logs of one servo: what it was told and where it went.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde_json::{Map, Value};

use crate::{
    RecordingError, Take,
    files::{MAX_TAKE_BYTES, read_file},
};

/// A log of one actuator: goals sent, positions measured, and what else the servo tells.
///
/// Nothing is repaired: `pwm_register` holds the numbers of the file, also where a signed reading was stored unsigned.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ServoLog {
    /// Id: the file's stem, or the take's id and the joint.
    pub id: String,
    /// Joint or motor.
    pub joint: String,
    /// What logs can be held out by: `kp`, `trajectory`, `motor`, `take`, ... as text.
    pub fields: BTreeMap<String, String>,
    /// Position gain as the register holds it; `None` if unknown.
    pub position_gain_register: Option<f64>,
    /// Mass at the end of the pendulum, kg; 0 if the load is unknown.
    pub mass_kg: f64,
    /// Length of the pendulum, m.
    pub length_m: f64,
    /// Supply voltage as stated, V; `None` if unknown.
    pub supply_v: Option<f64>,
    /// Torque per current at the joint as the maker states it, N m / A; `None` if unknown.
    pub torque_constant_nm_per_a: Option<f64>,
    /// Resistance of the winding as the maker states it, ohm; `None` if unknown.
    pub resistance_ohm: Option<f64>,
    /// What the registers stand for.
    pub units: RegisterUnits,
    /// Time of each sample since the log's start, s, strictly increasing.
    pub times_s: Vec<f64>,
    /// Measured position, rad, 0 = hanging down.
    pub positions_rad: Vec<f64>,
    /// Goal sent, rad.
    pub goals_rad: Vec<f64>,
    /// Whether the torque was on.
    pub torque_on: Vec<bool>,
    /// PWM as read from the register, full duty being [`RegisterUnits::full_pwm`]; empty where it was not logged.
    pub pwm_register: Vec<f64>,
    /// Measured supply voltage, V; empty where it was not logged.
    pub input_v: Vec<f64>,
}

/// What the numbers in a servo's registers stand for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegisterUnits {
    /// Encoder counts a turn.
    pub counts_per_turn: f64,
    /// PWM reading at full duty.
    pub full_pwm: f64,
    /// Position gain at which an error of one encoder count gives a PWM of one.
    pub unit_gain: f64,
}

impl Default for RegisterUnits {
    /// Those of a Dynamixel XL330.
    fn default() -> Self {
        Self { counts_per_turn: 4096.0, full_pwm: 885.0, unit_gain: 256.0 }
    }
}

impl RegisterUnits {
    /// Duty per position error that the register `gain` stands for, 1/rad.
    pub fn duty_per_rad(&self, gain: f64) -> f64 {
        gain * self.counts_per_turn / std::f64::consts::TAU / (self.unit_gain * self.full_pwm)
    }
}

impl ServoLog {
    /// Fewest samples that make a log.
    pub const FEWEST_SAMPLES: usize = 100;

    /// Whether it says what the joint carries.
    pub fn states_load(&self) -> bool {
        self.mass_kg > 0.0
    }

    /// Reads every `*.json` below `folder`, by name.
    pub fn read_folder(folder: &Path) -> Result<Vec<Self>, RecordingError> {
        let mut paths = Vec::new();
        for entry in fs::read_dir(folder).map_err(RecordingError::io("read", folder))? {
            let path = entry.map_err(RecordingError::io("read", folder))?.path();
            if path.extension().is_some_and(|ending| ending == "json") {
                paths.push(path);
            }
        }
        if paths.is_empty() {
            return Err(RecordingError::content(
                folder,
                "folder",
                "there is no servo log here: expected one .json file a log, with mass, length, kp, vin and entries",
            ));
        }
        paths.sort();
        paths.iter().map(|path| Self::read(path)).collect()
    }

    /// Reads a log in the format of BAM's raw recordings (github.com/Rhoban/bam): one JSON object with `mass` (kg),
    /// `length` (m), `kp` (register), `vin` (V), `motor`, `trajectory` and `entries`, each with `timestamp` (s),
    /// `position` (rad), `goal_position` (rad), `torque_enable`, and optionally `load` (PWM register) and
    /// `input_volts` (V). A mass of 0 is an unknown load; a PWM that is 0 in every entry was not logged. Servos of
    /// another make say what they are in `counts_per_turn`, `full_pwm`, `unit_gain`, `torque_constant` (N m / A) and
    /// `resistance` (ohm).
    pub fn read(path: &Path) -> Result<Self, RecordingError> {
        let bytes = read_file(path, MAX_TAKE_BYTES)?;
        Self::from_bytes(path, &bytes)
    }

    /// Reads a log from the bytes of a file. `path` gives its id and names it in errors.
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Self, RecordingError> {
        let document: Value = serde_json::from_slice(bytes).map_err(|error| {
            RecordingError::content(path, format!("line {}", error.line()), format!("no JSON: {error}"))
        })?;
        let reader = Reader { path };
        let head = reader.object(&document, "file")?;
        let entries = head
            .get("entries")
            .and_then(Value::as_array)
            .ok_or_else(|| RecordingError::content(path, "entries", "missing; expected a list of samples"))?;
        if entries.len() < Self::FEWEST_SAMPLES {
            let problem = format!(
                "{} samples are too few for a log: expected {} or more; record for some seconds",
                entries.len(),
                Self::FEWEST_SAMPLES
            );
            return Err(RecordingError::content(path, "entries", problem));
        }
        let gain = reader.positive(head, "kp")?;
        let stated = |name: &str| head.contains_key(name).then(|| reader.positive(head, name)).transpose();
        let of_make = RegisterUnits::default();
        let mut log = Self {
            id: path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default(),
            joint: head.get("motor").and_then(Value::as_str).unwrap_or("servo").to_owned(),
            fields: head
                .iter()
                .filter_map(|(name, value)| match value {
                    Value::String(text) => Some((name.clone(), text.clone())),
                    Value::Number(number) => Some((name.clone(), number.to_string())),
                    _ => None,
                })
                .collect(),
            position_gain_register: Some(gain),
            mass_kg: reader.not_negative(head, "mass")?,
            length_m: reader.not_negative(head, "length")?,
            supply_v: Some(reader.positive(head, "vin")?),
            torque_constant_nm_per_a: stated("torque_constant")?,
            resistance_ohm: stated("resistance")?,
            units: RegisterUnits {
                counts_per_turn: stated("counts_per_turn")?.unwrap_or(of_make.counts_per_turn),
                full_pwm: stated("full_pwm")?.unwrap_or(of_make.full_pwm),
                unit_gain: stated("unit_gain")?.unwrap_or(of_make.unit_gain),
            },
            ..Self::default()
        };
        let optional = |name: &str| entries[0].get(name).is_some();
        let (has_pwm, has_voltage) = (optional("load"), optional("input_volts"));
        for (idx, entry) in entries.iter().enumerate() {
            let place = format!("entries[{idx}]");
            let entry = reader.object(entry, &place)?;
            let number = |name: &str| reader.number(entry, name, &place);
            let time_s = number("timestamp")?;
            if let Some(&before_s) = log.times_s.last().filter(|&&before_s| time_s <= before_s) {
                let problem = format!(
                    "its timestamp {time_s} s does not come after {before_s} s of the entry before; times must increase"
                );
                return Err(RecordingError::content(path, place, problem));
            }
            let on = entry.get("torque_enable").and_then(Value::as_bool).ok_or_else(|| {
                RecordingError::content(path, format!("{place}.torque_enable"), "expected true or false")
            })?;
            log.times_s.push(time_s);
            log.positions_rad.push(number("position")?);
            log.goals_rad.push(number("goal_position")?);
            log.torque_on.push(on);
            if has_pwm {
                log.pwm_register.push(number("load")?);
            }
            if has_voltage {
                log.input_v.push(number("input_volts")?);
            }
        }
        // A column that a recorder fills with nothing was not measured.
        if log.pwm_register.iter().all(|reading| *reading == 0.0) {
            log.pwm_register.clear();
        }
        Ok(log)
    }

    /// The joints of `take` as logs, one each, in the station's order; none if it holds no commands.
    ///
    /// The command in effect at a joint frame is the newest one at or before it. Load, gain and supply are not in a take.
    pub fn from_take(take: &Take) -> Vec<Self> {
        let commands = &take.commands;
        if commands.times_s.is_empty() {
            return Vec::new();
        }
        let num_dofs = take.station.robot.dofs().count();
        let newest: Vec<usize> = take
            .joints
            .times_s
            .iter()
            .map(|&time_s| commands.times_s.partition_point(|&sent_s| sent_s <= time_s).saturating_sub(1))
            .collect();
        take.station
            .robot
            .dofs()
            .enumerate()
            .map(|(dof, joint)| Self {
                id: format!("{}/{}", take.id, joint.name),
                joint: joint.name.clone(),
                fields: BTreeMap::from([
                    ("take".to_owned(), take.id.clone()),
                    ("joint".to_owned(), joint.name.clone()),
                    ("primitive".to_owned(), take.meta.primitive.clone()),
                ]),
                times_s: take.joints.times_s.clone(),
                positions_rad: take.joints.positions.iter().skip(dof).step_by(num_dofs).copied().collect(),
                goals_rad: newest.iter().map(|row| commands.positions[row * num_dofs + dof]).collect(),
                torque_on: vec![true; take.joints.times_s.len()],
                ..Self::default()
            })
            .collect()
    }
}

struct Reader<'a> {
    path: &'a Path,
}

impl Reader<'_> {
    fn object<'v>(&self, value: &'v Value, place: &str) -> Result<&'v Map<String, Value>, RecordingError> {
        value.as_object().ok_or_else(|| RecordingError::content(self.path, place, "expected an object"))
    }

    fn number(&self, of: &Map<String, Value>, name: &str, place: &str) -> Result<f64, RecordingError> {
        let place = if place.is_empty() { name.to_owned() } else { format!("{place}.{name}") };
        match of.get(name) {
            Some(value) => value.as_f64().filter(|number| number.is_finite()).ok_or_else(|| {
                RecordingError::content(self.path, place, format!("expected a number, found {value}"))
            }),
            None => Err(RecordingError::content(self.path, place, "missing; expected a number")),
        }
    }

    fn positive(&self, of: &Map<String, Value>, name: &str) -> Result<f64, RecordingError> {
        let number = self.number(of, name, "")?;
        if number > 0.0 {
            return Ok(number);
        }
        Err(RecordingError::content(self.path, name, format!("expected a number above 0, found {number}")))
    }

    fn not_negative(&self, of: &Map<String, Value>, name: &str) -> Result<f64, RecordingError> {
        let number = self.number(of, name, "")?;
        if number >= 0.0 {
            return Ok(number);
        }
        let problem = format!("expected 0 (unknown) or a number above it, found {number}");
        Err(RecordingError::content(self.path, name, problem))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(change: impl Fn(usize, &mut Value)) -> Vec<u8> {
        let entries: Vec<Value> = (0..120)
            .map(|idx| {
                let mut entry = serde_json::json!({
                    "timestamp": 0.005 * (idx + 1) as f64, "position": 0.1, "goal_position": 0.2, "speed": 0.0,
                    "load": if idx % 2 == 0 { 40 } else { 65_496 }, "input_volts": 7.3, "torque_enable": true,
                });
                change(idx, &mut entry);
                entry
            })
            .collect();
        let log = serde_json::json!({
            "mass": 0.49, "length": 0.1, "kp": 400, "vin": 7.4, "motor": "xl330", "trajectory": "sin", "entries": entries,
        });
        serde_json::to_vec(&log).expect("JSON")
    }

    fn read(bytes: &[u8]) -> Result<ServoLog, RecordingError> {
        ServoLog::from_bytes(Path::new("logs/a.json"), bytes)
    }

    #[test]
    fn log_is_read_as_it_is_stored() {
        let log = read(&text(|_, _| {})).unwrap();
        assert_eq!((log.id.as_str(), log.joint.as_str()), ("a", "xl330"));
        assert_eq!(log.fields["kp"], "400");
        assert_eq!(log.fields["trajectory"], "sin");
        assert_eq!(log.pwm_register[..2], [40.0, 65_496.0], "wrapped readings stay what they are");
        assert_eq!(log.times_s.len(), 120);
        assert!((log.units.duty_per_rad(400.0) - 1.1509).abs() < 1e-4);
        assert_eq!((log.torque_constant_nm_per_a, log.resistance_ohm), (None, None));
    }

    #[test]
    fn a_servo_of_another_make_says_what_its_registers_stand_for() {
        let mut log: Value = serde_json::from_slice(&text(|_, _| {})).unwrap();
        for (name, value) in [("counts_per_turn", 1024), ("full_pwm", 1000), ("unit_gain", 64)] {
            log[name] = value.into();
        }
        log["torque_constant"] = 1.2.into();
        let read = |log: &Value| read(&serde_json::to_vec(log).unwrap());
        let other = read(&log).unwrap();
        // 32 / 64 of a PWM of 1 in 1,000 for each of 1,024 counts a turn.
        assert!((other.units.duty_per_rad(32.0) - 0.5 * 1.024 / std::f64::consts::TAU).abs() < 1e-12);
        assert_eq!(other.torque_constant_nm_per_a, Some(1.2));
        log["full_pwm"] = 0.into();
        let refused = read(&log).unwrap_err().to_string();
        assert!(refused.contains("full_pwm: expected a number above 0, found 0"), "{refused}");
    }

    #[test]
    fn what_was_not_known_or_not_logged_is_no_measurement() {
        let unlogged = text(|_, entry| entry["load"] = 0.into());
        assert!(read(&unlogged).unwrap().pwm_register.is_empty());
        let mut log: Value = serde_json::from_slice(&text(|_, _| {})).unwrap();
        log["mass"] = 0.into();
        assert_eq!(read(&serde_json::to_vec(&log).unwrap()).unwrap().mass_kg, 0.0);
        log["mass"] = (-0.1).into();
        let refused = read(&serde_json::to_vec(&log).unwrap()).unwrap_err().to_string();
        assert!(refused.contains("mass: expected 0 (unknown)"), "{refused}");
    }

    #[test]
    fn errors_name_file_entry_and_field() {
        let message = |bytes: &[u8]| read(bytes).expect_err("bad content").to_string();
        let missing = message(&text(|idx, entry| {
            if idx == 7 {
                entry.as_object_mut().expect("an object").remove("position");
            }
        }));
        assert!(missing.contains("logs/a.json: entries[7].position: missing"), "{missing}");
        let wrong = message(&text(|idx, entry| {
            if idx == 9 {
                entry["load"] = "high".into();
            }
        }));
        assert!(wrong.contains("entries[9].load: expected a number"), "{wrong}");
        let back = message(&text(|idx, entry| {
            if idx == 11 {
                entry["timestamp"] = 0.0.into();
            }
        }));
        assert!(back.contains("entries[11]") && back.contains("must increase"), "{back}");
        let cut = message(&text(|_, _| {})[..500]);
        assert!(cut.contains("line 1: no JSON"), "{cut}");
    }
}

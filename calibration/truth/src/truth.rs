//! The truth file: what the emulated world is like, and what it hides.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use palpate_motion::{MotionConfig, Plan, PlannedTake, Primitives};
use palpate_recording::{RecordingError, load_station};
use palpate_robot_model::{PoseConfig, SensorKind, Station};
use serde::{Deserialize, Serialize};

use crate::EmulationError;
use crate::hidden::Hidden;
use crate::secrets::{PatchSecrets, Secrets, StreamSecrets};

/// What the emulated world is like, and what it hides.
///
/// Everything that a calibration has to find, or to live with, is written here: the elastomers, the sensors' front
/// ends, the spread between channels, delays, mounting errors. `assets/truth/demo.toml` is a commented example.
///
/// What moves and touches is a [`Plan`], a file of its own that the truth names. A truth may hold the sections of a plan
/// (`primitives`, `[motion]`, `[object.ID]`, `[[take]]`) itself instead; the plan's seed is then the world's.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Truth {
    /// Version of the format; 1.
    pub format: u32,
    /// Name for people.
    pub name: String,
    /// Station file, relative to the truth file.
    pub station: String,
    /// Plan file, relative to the truth file; absent where the truth holds the plan's sections.
    pub plan: Option<String>,
    /// Folder of the primitives, relative to the truth file; only beside the sections of a plan.
    pub primitives: Option<String>,
    /// When the first take starts, with its offset from UTC. Emulated sessions never read a clock.
    pub recorded: toml::value::Datetime,
    /// Who is said to have recorded it.
    #[serde(default)]
    pub operator: String,
    /// Draws what differs from channel to channel in this world; the seed of a recording draws only its noise.
    pub world_seed: u64,
    /// How the robot moves; only where no plan file is named.
    pub motion: Option<MotionConfig>,
    /// How joint positions are measured.
    #[serde(default)]
    pub joints: JointTruth,
    /// One for each stream of the layout.
    #[serde(rename = "stream")]
    pub streams: Vec<StreamTruth>,
    /// Patches that do not sit where the layout says.
    #[serde(rename = "mount_offset", default)]
    pub mount_offsets: Vec<MountOffset>,
    /// Pose of each object in the base frame, by object id; those of the plan file where one is named.
    #[serde(rename = "object", default)]
    pub objects: BTreeMap<String, PoseConfig>,
    /// What the world has beside all this; see [`Hidden`].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub hidden: Vec<Hidden>,
    /// The takes, in order; those of the plan file where one is named.
    #[serde(rename = "take", default)]
    pub takes: Vec<PlannedTake>,
}

/// How joint positions are measured.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointTruth {
    /// Standard deviation of a measured position, rad (revolute joints).
    #[serde(default)]
    pub noise_rad: f64,
    /// Standard deviation of a measured position, m (prismatic joints).
    #[serde(default)]
    pub noise_m: f64,
    /// Constant error of the measured position by joint name (measured less true), rad or m.
    #[serde(default)]
    pub offset: BTreeMap<String, f64>,
}

/// The sensors of one stream, from the elastomer to the host.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StreamTruth {
    /// Id of the stream in the layout.
    pub id: String,
    /// From sampling to arrival at the host, s.
    pub latency_s: f64,
    /// Mean of the random part of that delay, s.
    pub jitter_s: f64,
    /// How much faster the device's clock runs than the host's, s per s.
    #[serde(default)]
    pub clock_skew: f64,
    /// Standard deviation of the logarithm of a channel's gain.
    pub sensitivity_spread: f64,
    /// Standard deviation of a raw reading, raw units.
    pub noise_raw: f64,
    /// The soft layer.
    pub elastomer: Elastomer,
    /// What turns its deformation into raw units.
    pub front_end: FrontEnd,
}

/// A soft layer as a sheet of elements, each a standard linear solid pulled along by its neighbours.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Elastomer {
    /// Least distance between elements, m.
    pub spacing_m: f64,
    /// Thickness, m.
    pub thickness_m: f64,
    /// Modulus of the slow spring, Pa.
    pub modulus_pa: f64,
    /// Stiffness of the contact with the object, times that of the slow spring.
    pub contact_ratio: f64,
    /// Stiffness of the relaxing (Maxwell) branch, times that of the slow spring: what lingers after release.
    pub relaxing_ratio: f64,
    /// Time constant of the relaxing branch, s.
    pub relaxing_s: f64,
    /// Damping of an element, s: damper over slow spring.
    pub damping_s: f64,
    /// How far along the layer a displacement reaches, m.
    pub coupling_m: f64,
}

/// What turns the deformation of the layer into raw units.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "snake_case", tag = "kind")]
pub enum FrontEnd {
    /// A pressure sensor under each taxel.
    Barometer {
        /// Depth of the sensors below the surface, m.
        depth_m: f64,
        /// Raw units per Pa.
        raw_per_pa: f64,
        /// Reading without touch, raw units.
        offset_raw: f64,
        /// Time constant of the sensor's own filter, s.
        low_pass_s: f64,
    },
    /// One force-sensing resistor under the whole patch, in a voltage divider.
    ForceResistor {
        /// Force that the cap carries before the resistor feels any, N.
        preload_n: f64,
        /// Conductance per force, S/N.
        conductance_s_per_n: f64,
        /// The divider's fixed resistor, ohm.
        divider_ohm: f64,
        /// Converter reading at the supply voltage, raw units.
        full_scale_raw: f64,
        /// Time constant of the input filter, s.
        low_pass_s: f64,
    },
}

/// A patch that does not sit where the layout says.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MountOffset {
    /// Id of the patch.
    pub patch: String,
    /// Shift in the link's frame, m.
    pub translation_m: [f64; 3],
    /// Rotation about the patch's own origin, as a rotation vector in the link's frame, rad.
    #[serde(default)]
    pub rotation_rad: [f64; 3],
}

/// A truth file with everything it names, read and checked.
#[derive(Clone, Debug)]
pub struct Emulation {
    /// Its path, for errors.
    pub(crate) file: String,
    pub(crate) truth: Truth,
    pub(crate) station: Arc<Station>,
    /// What moves and touches, with its primitives.
    pub(crate) plan: Plan,
    /// Start of the first take, ns since 1970.
    pub(crate) start_unix_ns: u64,
    /// What the truth's hidden effects come to.
    pub(crate) secrets: Secrets,
}

impl Elastomer {
    /// The layer that has what is hidden in it.
    pub(crate) fn with(mut self, hidden: &StreamSecrets, of_patch: &PatchSecrets) -> Self {
        self.coupling_m += of_patch.coupling_m;
        if let Some((fraction, time_s)) = hidden.release {
            // Let go, the spring is held at r / (1 + r) of the dent by the relaxing branch, which then yields with
            // (1 + r) times its own time constant.
            self.relaxing_ratio = fraction / (1.0 - fraction);
            self.relaxing_s = time_s * (1.0 - fraction);
        }
        self
    }
}

impl FrontEnd {
    /// The same with a longer time constant of its filter.
    pub(crate) fn slower_by(mut self, more_s: f64) -> Self {
        let (Self::Barometer { low_pass_s, .. } | Self::ForceResistor { low_pass_s, .. }) = &mut self;
        *low_pass_s += more_s;
        self
    }
}

impl Emulation {
    /// Reads the truth file at `path`, its station, its plan and its primitives.
    pub fn read(path: &Path) -> Result<Self, EmulationError> {
        let file = path.display().to_string();
        let mut truth: Truth = parse(path)?;
        let fail = |place: &str, problem: String| truth_error(&file, place, problem);
        if truth.format != 1 {
            return Err(fail("format", format!("is {}, expected 1", truth.format)));
        }
        let dir = path.parent().map_or_else(PathBuf::new, Path::to_path_buf);
        let station = load_station(&dir.join(&truth.station))?;
        let start_unix_ns = unix_ns(&truth.recorded).ok_or_else(|| {
            fail(
                "recorded",
                format!("{} needs date, time and offset, e.g. 2026-03-02T09:30:00Z", truth.recorded),
            )
        })?;
        let plan = plan(path, &truth)?;
        plan.check(&station)?;
        if let Some(stream) = station.layout.streams.iter().find(|stream| stream.axes.count() > 1) {
            let problem = format!(
                "stream {:?} has {} axes for each taxel, and emulated devices give one reading; import recordings of such a skin",
                stream.id,
                stream.axes.count()
            );
            return Err(fail("station", problem));
        }
        check(&truth, &station).map_err(|(place, problem)| fail(&place, problem))?;
        truth.objects.clone_from(&plan.objects);
        truth.takes.clone_from(&plan.takes);
        let secrets = secrets(&file, &truth.hidden, &station, truth.world_seed)?;
        Ok(Self { file, truth, station: Arc::new(station), plan, start_unix_ns, secrets })
    }

    /// The same world with `more` hidden in it.
    pub(crate) fn hiding(&self, more: &[Hidden]) -> Result<Self, EmulationError> {
        let mut emulation = self.clone();
        emulation.truth.hidden.extend_from_slice(more);
        emulation.secrets =
            secrets(&self.file, &emulation.truth.hidden, &self.station, self.truth.world_seed)?;
        Ok(emulation)
    }

    /// An error in the truth file.
    pub fn error(&self, place: impl Into<String>, problem: impl Into<String>) -> EmulationError {
        EmulationError::Truth { file: self.file.clone(), place: place.into(), problem: problem.into() }
    }

    /// Positions of a named set of joints in the station's order; `fallback` where the set has no such joint.
    pub(crate) fn positions(&self, named: &BTreeMap<String, f64>, fallback: &[f64]) -> Vec<f64> {
        let joints = self.station.robot.dofs();
        joints
            .enumerate()
            .map(|(dof, joint)| named.get(&joint.name).copied().unwrap_or(fallback[dof]))
            .collect()
    }

    /// The station that is emulated.
    pub fn station(&self) -> &Arc<Station> {
        &self.station
    }

    /// What moves and touches.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Encoder less true position of every degree of freedom, rad or m.
    pub fn encoder_offsets(&self) -> Vec<f64> {
        let mut offsets =
            self.positions(&self.truth.joints.offset, &vec![0.0; self.station.robot.num_dofs()]);
        for (offset, hidden) in offsets.iter_mut().zip(&self.secrets.joint_offsets) {
            *offset += hidden;
        }
        offsets
    }

    /// Where takes start and end: the position of every degree of freedom, rad or m.
    pub fn rest(&self) -> Vec<f64> {
        self.plan.rest(&self.station)
    }
}

fn secrets(
    file: &str,
    hidden: &[Hidden],
    station: &Station,
    world_seed: u64,
) -> Result<Secrets, EmulationError> {
    Secrets::new(hidden, station, world_seed).map_err(|(entry, problem)| {
        truth_error(file, &format!("hidden {} ({})", entry + 1, hidden[entry].id), problem)
    })
}

fn truth_error(file: &str, place: &str, problem: String) -> EmulationError {
    EmulationError::Truth { file: file.into(), place: place.into(), problem }
}

fn parse<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, EmulationError> {
    let text = std::fs::read_to_string(path).map_err(|source| RecordingError::Io {
        action: "read",
        path: path.to_path_buf(),
        source,
    })?;
    toml::from_str(&text).map_err(|error| {
        let place = error.span().map_or_else(
            || "file".to_owned(),
            |span| {
                format!("line {}", text.as_bytes()[..span.start].iter().filter(|&&b| b == b'\n').count() + 1)
            },
        );
        truth_error(&path.display().to_string(), &place, error.message().to_owned())
    })
}

/// The plan of the truth file at `path`: the file that it names, or its own sections.
fn plan(path: &Path, truth: &Truth) -> Result<Plan, EmulationError> {
    let file = path.display().to_string();
    let dir = path.parent().map_or_else(PathBuf::new, Path::to_path_buf);
    if let Some(plan) = &truth.plan {
        let sections = [
            ("primitives", truth.primitives.is_some()),
            ("[motion]", truth.motion.is_some()),
            ("[object]", !truth.objects.is_empty()),
            ("[[take]]", !truth.takes.is_empty()),
        ];
        if let Some((section, _)) = sections.iter().find(|(_, there)| *there) {
            let problem = format!("{section} belongs into {plan}: move it there, or leave out plan");
            return Err(truth_error(&file, "plan", problem));
        }
        return Ok(Plan::read(&dir.join(plan))?);
    }
    let Some(motion) = truth.motion.clone() else {
        let problem = "is missing: name a plan file, such as plan = \"../plans/nine_takes.toml\"";
        return Err(truth_error(&file, "plan", problem.into()));
    };
    let id = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into());
    let mut plan = Plan {
        file,
        id,
        label: truth.name.clone(),
        seed: truth.world_seed,
        motion,
        objects: truth.objects.clone(),
        takes: truth.takes.clone(),
        primitives: Primitives::new(),
        primitives_dir: truth.primitives.clone(),
    };
    plan.complete(|name| {
        std::fs::read_to_string(dir.join(name)).map_err(|error| format!("failed to read it: {error}"))
    })?;
    Ok(plan)
}

/// `(place, problem)` of the first thing that cannot be.
fn check(truth: &Truth, station: &Station) -> Result<(), (String, String)> {
    for (name, value) in &truth.joints.offset {
        if !station.robot.dofs().any(|joint| joint.name == *name) {
            return Err(("joints.offset".into(), format!("the station has no moving joint {name:?}")));
        }
        if !value.is_finite() {
            return Err(("joints.offset".into(), format!("joint {name:?}: {value} must be finite")));
        }
    }
    not_negative("joints", &[("noise_rad", truth.joints.noise_rad), ("noise_m", truth.joints.noise_m)])?;
    for (stream_idx, stream) in station.layout.streams.iter().enumerate() {
        let place = format!("stream {:?}", stream.id);
        let mut named = truth.streams.iter().filter(|truth| truth.id == stream.id);
        let Some(stream_truth) = named.next() else {
            return Err((place, "is in the station's layout but not here: add a [[stream]]".into()));
        };
        if named.next().is_some() {
            return Err((place, "is given twice".into()));
        }
        check_stream(&place, stream_truth)?;
        let config = &station.streams[stream_idx];
        if config.raw_max <= config.raw_min {
            return Err((
                place,
                format!("the station's raw range {}..{} is empty", config.raw_min, config.raw_max),
            ));
        }
        let fits = matches!(
            (stream.kind, stream_truth.front_end),
            (SensorKind::Pressure, FrontEnd::Barometer { .. })
                | (SensorKind::Proximity, FrontEnd::ForceResistor { .. })
        );
        if !fits {
            let expected = if stream.kind == SensorKind::Pressure { "barometer" } else { "force_resistor" };
            return Err((
                place,
                format!("front_end.kind must be {expected:?} for this stream of the layout"),
            ));
        }
    }
    if let Some(extra) = truth.streams.iter().find(|truth| station.layout.stream_index(&truth.id).is_none()) {
        return Err((format!("stream {:?}", extra.id), "the station's layout has no such stream".into()));
    }
    for offset in &truth.mount_offsets {
        let place = format!("mount_offset {:?}", offset.patch);
        if !station.layout.patches.iter().any(|patch| patch.id == offset.patch) {
            return Err((place, "the layout has no such patch".into()));
        }
        if offset.translation_m.iter().chain(&offset.rotation_rad).any(|v| !v.is_finite() || v.abs() > 1.0) {
            return Err((place, "translation_m and rotation_rad must be finite and small".into()));
        }
    }
    Ok(())
}

fn check_stream(place: &str, stream: &StreamTruth) -> Result<(), (String, String)> {
    not_negative(
        place,
        &[
            ("latency_s", stream.latency_s),
            ("jitter_s", stream.jitter_s),
            ("sensitivity_spread", stream.sensitivity_spread),
            ("noise_raw", stream.noise_raw),
            ("elastomer.relaxing_ratio", stream.elastomer.relaxing_ratio),
            ("elastomer.coupling_m", stream.elastomer.coupling_m),
        ],
    )?;
    positive(
        place,
        &[
            ("elastomer.spacing_m", stream.elastomer.spacing_m),
            ("elastomer.thickness_m", stream.elastomer.thickness_m),
            ("elastomer.modulus_pa", stream.elastomer.modulus_pa),
            ("elastomer.contact_ratio", stream.elastomer.contact_ratio),
            ("elastomer.relaxing_s", stream.elastomer.relaxing_s),
            ("elastomer.damping_s", stream.elastomer.damping_s),
        ],
    )?;
    if !(-0.1..=0.1).contains(&stream.clock_skew) {
        return Err((place.into(), format!("clock_skew = {} must be within -0.1..0.1", stream.clock_skew)));
    }
    match stream.front_end {
        FrontEnd::Barometer { depth_m, raw_per_pa, offset_raw, low_pass_s } => {
            positive(
                place,
                &[
                    ("front_end.depth_m", depth_m),
                    ("front_end.raw_per_pa", raw_per_pa),
                    ("front_end.low_pass_s", low_pass_s),
                ],
            )?;
            not_negative(place, &[("front_end.offset_raw", offset_raw)])
        }
        FrontEnd::ForceResistor {
            preload_n,
            conductance_s_per_n,
            divider_ohm,
            full_scale_raw,
            low_pass_s,
        } => {
            not_negative(place, &[("front_end.preload_n", preload_n)])?;
            positive(
                place,
                &[
                    ("front_end.conductance_s_per_n", conductance_s_per_n),
                    ("front_end.divider_ohm", divider_ohm),
                    ("front_end.full_scale_raw", full_scale_raw),
                    ("front_end.low_pass_s", low_pass_s),
                ],
            )
        }
    }
}

/// Refuses the first of `values` that is not a positive number, as `(place, problem)`.
fn positive(place: &str, values: &[(&str, f64)]) -> Result<(), (String, String)> {
    match values.iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)) {
        Some((name, value)) => Err((place.into(), format!("{name} = {value} must be a positive number"))),
        None => Ok(()),
    }
}

/// Refuses the first of `values` that is negative or not finite, as `(place, problem)`.
fn not_negative(place: &str, values: &[(&str, f64)]) -> Result<(), (String, String)> {
    match values.iter().find(|(_, value)| !(value.is_finite() && *value >= 0.0)) {
        Some((name, value)) => Err((place.into(), format!("{name} = {value} must not be negative"))),
        None => Ok(()),
    }
}

/// Nanoseconds since 1970 of an offset date-time; `None` for local or partial ones and for times before 1970.
fn unix_ns(datetime: &toml::value::Datetime) -> Option<u64> {
    let (date, time) = (datetime.date?, datetime.time?);
    let offset_minutes = match datetime.offset? {
        toml::value::Offset::Z => 0,
        toml::value::Offset::Custom { minutes } => i64::from(minutes),
    };
    // Days since 1970-01-01 in the proleptic Gregorian calendar, counting years from March.
    let (year, month) = (i64::from(date.year), i64::from(date.month));
    let year = if month <= 2 { year - 1 } else { year };
    let era = year.div_euclid(400);
    let year_of_era = year.rem_euclid(400);
    let day_of_year = (153 * ((month + 9) % 12) + 2) / 5 + i64::from(date.day) - 1;
    let days =
        era * 146_097 + year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + day_of_year - 719_468;
    let minutes = i64::from(time.hour) * 60 + i64::from(time.minute) - offset_minutes;
    let seconds = days * 86_400 + minutes * 60 + time.second.map_or(0, i64::from);
    let nanos = u64::from(time.nanosecond.unwrap_or(0));
    Some(u64::try_from(seconds).ok()?.checked_mul(1_000_000_000)? + nanos)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn date_times_count_from_1970() {
        for (text, seconds) in [
            ("1970-01-01T00:00:00Z", 0),
            ("2000-03-01T00:00:00Z", 951_868_800),
            ("2024-02-29T12:00:00Z", 1_709_208_000),
            ("2026-03-02T09:30:00+01:00", 1_772_440_200),
        ] {
            let datetime: toml::value::Datetime = text.parse().expect("a date-time");
            assert_eq!(unix_ns(&datetime), Some(seconds * 1_000_000_000), "{text}");
        }
        let local: toml::value::Datetime = "2026-03-02T09:30:00".parse().expect("a date-time");
        assert_eq!(unix_ns(&local), None);
    }
}

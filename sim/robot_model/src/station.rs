//! The station file: which robot, layout, objects, streams and limits belong together.

use std::collections::BTreeMap;

use serde::Deserialize;
use toml::Spanned;

use crate::{
    DeviceConfig, ModelError, ObjectModel, Robot, SafetyConfig, TactileLayout,
    config::{Source, check_id, finite, list, positive},
    hardware::{self, DeviceText, SafetyText},
};

/// The texts that make up a station, as they are attached to every take.
///
/// Keys of `files` are paths relative to the station file, as the station names them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StationFiles {
    /// The station file itself, TOML.
    pub station_toml: String,
    /// Everything it names: URDF, layout, objects, their meshes, the nominal sensor model, plans.
    pub files: BTreeMap<String, Vec<u8>>,
}

impl StationFiles {
    /// These files and those of the object called `id`: the `text` of its file, and the `meshes` that this names, by their names
    /// there. The object must not be among the station's.
    pub fn with_object(
        &self,
        id: &str,
        text: &str,
        meshes: &BTreeMap<String, Vec<u8>>,
    ) -> Result<Self, String> {
        let mut more = self.clone();
        let mut about: toml::Table =
            self.station_toml.parse().map_err(|error| format!("the station file: {error}"))?;
        // A folder of its own: paths in there mean what they mean beside the object's file.
        let folder = format!("added/{id}");
        let path = format!("{folder}/object.toml");
        match about.entry("objects").or_insert_with(|| toml::Value::Array(Vec::new())) {
            toml::Value::Array(objects) => objects.push(path.clone().into()),
            _ => return Err("the station file's objects are no list".to_owned()),
        }
        more.station_toml = toml::to_string(&about).map_err(|error| format!("the station file: {error}"))?;
        more.files.insert(path, text.as_bytes().to_vec());
        let meshes = meshes.iter().map(|(name, bytes)| (format!("{folder}/{name}"), bytes.clone()));
        more.files.extend(meshes);
        Ok(more)
    }
}

/// A station, read and checked.
#[derive(Clone, Debug)]
pub struct Station {
    /// Stable id, e.g. `xarm6-leap`.
    pub id: String,
    /// Name for people.
    pub label: String,
    /// The robot, degrees of freedom in the station's order.
    pub robot: Robot,
    /// The tactile layout.
    pub layout: TactileLayout,
    /// Nominal rate of the joint log, Hz.
    pub joint_rate_hz: f64,
    /// Which degrees of freedom carry the hand about (the arm), as opposed to those of the hand.
    pub carrier_dofs: Vec<usize>,
    /// Objects this station knows, by id.
    pub objects: BTreeMap<String, ObjectModel>,
    /// How each stream of the layout is read, same order as `layout.streams`.
    pub streams: Vec<StreamConfig>,
    /// The nominal sensor model, TOML (parsed by `palpate_sim`).
    pub nominal_model_toml: String,
    /// Its devices, in the file's order; empty for a station that is only replayed or emulated from files.
    pub devices: Vec<DeviceConfig>,
    /// Times and limits within which it may be moved.
    pub safety: SafetyConfig,
    /// Plans of sessions that it can record: the stem of the file's name and its text, TOML (parsed by
    /// `palpate_motion`).
    pub plans: Vec<(String, String)>,
    /// The texts it was read from.
    pub files: StationFiles,
}

/// How the readings of one stream become binary.
#[derive(Clone, Debug, PartialEq)]
pub struct StreamConfig {
    /// Id of the stream in the layout.
    pub stream: String,
    /// A channel is active when its reading exceeds its reference value by more than this, raw units.
    pub on_threshold: f64,
    /// And inactive again below this; equal to `on_threshold` where the firmware has no hysteresis.
    pub off_threshold: f64,
    /// Lowest raw reading that the device can give.
    pub raw_min: f64,
    /// Highest raw reading that the device can give.
    pub raw_max: f64,
}

impl StreamConfig {
    /// The threshold below which a channel switches off, over the one above which it switches on.
    pub fn off_fraction(&self) -> f64 {
        self.off_threshold / self.on_threshold
    }
}

impl Station {
    /// Reads the station file `file` and everything it names through `read_file`, checking every reference between
    /// them. `read_file` turns a path into bytes, or says why it cannot. It is first called with `file` itself, which
    /// is a plain file name; every other path is relative to the same folder.
    ///
    /// Refused, naming file, line and joint or stream: anything missing or unreadable, joints that the robot does not
    /// have or that the list leaves out, a stream of the layout without its thresholds, objects with the same id.
    ///
    /// ```
    /// use palpate_robot_model::Station;
    ///
    /// // A server reads these from disk, a page gets them from the server, a take carries them with it.
    /// let files = [
    ///     ("probe.toml", r#"
    ///         id = "probe"
    ///         label = "Probe"
    ///         robot = "probe.urdf"
    ///         layout = "layout.toml"
    ///         nominal_model = "nominal.toml"
    ///         objects = ["ball.toml"]
    ///         joint_rate_hz = 50.0
    ///         joints = ["lift"]
    ///
    ///         [[stream]]
    ///         stream = "film"
    ///         on_threshold = 30.0
    ///         off_threshold = 20.0
    ///         raw_min = 0.0
    ///         raw_max = 1023.0
    ///     "#),
    ///     ("probe.urdf", r#"<robot name="probe"><link name="base"/><link name="tip"/>
    ///         <joint name="lift" type="prismatic"><parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>
    ///         <limit lower="0" upper="0.1" velocity="0.1" effort="5"/></joint></robot>"#),
    ///     ("layout.toml", r#"
    ///         name = "One film sensor"
    ///         [[stream]]
    ///         id = "film"
    ///         label = "Film"
    ///         kind = "proximity"
    ///         rate_hz = 40.0
    ///         raw_unit = "counts"
    ///         [[patch]]
    ///         id = "tip"
    ///         label = "Tip"
    ///         group = "probe"
    ///         stream = "film"
    ///         link = "tip"
    ///         pose = { position_m = [0, 0, 0], rpy_rad = [3.14159, 0, 0] }
    ///         shape = { kind = "rectangle", length_m = 0.01, width_m = 0.01 }
    ///         node_spacing_m = 0.002
    ///     "#),
    ///     ("ball.toml", "id = 'ball'\nlabel = 'Ball'\nshape = { kind = 'sphere', radius_m = 0.02 }"),
    ///     ("nominal.toml", ""),
    /// ];
    /// let station = Station::read("probe.toml", |path| {
    ///     let found = files.iter().find(|(name, _)| *name == path);
    ///     found.map(|(_, text)| text.as_bytes().to_vec()).ok_or_else(|| "no such file".to_owned())
    /// })?;
    /// assert_eq!(station.robot.num_dofs(), 1);
    /// assert_eq!(station.layout.num_channels(), 1);
    ///
    /// // The texts that it was read from make the same station again.
    /// let again = Station::from_files(station.files.clone())?;
    /// assert_eq!(again.streams, station.streams);
    /// # Ok::<(), palpate_robot_model::ModelError>(())
    /// ```
    pub fn read(
        file: &str,
        mut read_file: impl FnMut(&str) -> Result<Vec<u8>, String>,
    ) -> Result<Self, ModelError> {
        let station_toml = utf8(
            file,
            read_file(file).map_err(|problem| {
                ModelError::new(file, "whole file", format!("failed to read the station file: {problem}"))
            })?,
        )?;
        Self::assemble(file, station_toml, read_file)
    }

    /// Reads a station from its texts, as attached to a take.
    pub fn from_files(files: StationFiles) -> Result<Self, ModelError> {
        let StationFiles { station_toml, files } = files;
        Self::assemble("station.toml", station_toml, |path| {
            files.get(path).cloned().ok_or_else(|| {
                let held = list(files.keys().map(String::as_str));
                format!("it is not among the station's attached files ({held})")
            })
        })
    }

    fn assemble(
        file: &str,
        station_toml: String,
        mut read_file: impl FnMut(&str) -> Result<Vec<u8>, String>,
    ) -> Result<Self, ModelError> {
        let source = Source { file, text: &station_toml };
        let config: StationConfig = source.parse()?;
        check_id("id", &config.id).map_err(|problem| source.error_at("id", problem))?;
        let joint_rate_hz = positive("joint_rate_hz", *config.joint_rate_hz.get_ref())
            .map_err(|problem| source.error(config.joint_rate_hz.span(), "joint_rate_hz", problem))?;

        let mut files: BTreeMap<String, Vec<u8>> = BTreeMap::new();
        let mut fetch = |path: &str| -> Result<Vec<u8>, String> {
            let bytes = read_file(path).map_err(|problem| format!("failed to read {path:?}: {problem}"))?;
            files.insert(path.to_owned(), bytes.clone());
            Ok(bytes)
        };
        let text_of =
            |fetch: &mut Fetch<'_>, key: &str, path: &Spanned<String>| -> Result<String, ModelError> {
                let bytes =
                    fetch(path.get_ref()).map_err(|problem| source.error(path.span(), key, problem))?;
                utf8(path.get_ref(), bytes)
            };

        let robot_text = text_of(&mut fetch, "robot", &config.robot)?;
        let joints = joint_names(&source, &config.joints)?;
        let robot = Robot::from_urdf(config.robot.get_ref(), &robot_text, &joints)?;
        let carrier_dofs = carrier_dofs(&source, &config.carrier_joints, &joints)?;
        let layout_text = text_of(&mut fetch, "layout", &config.layout)?;
        let layout = TactileLayout::from_toml(config.layout.get_ref(), &layout_text, &robot)?;
        let nominal_model_toml = text_of(&mut fetch, "nominal_model", &config.nominal_model)?;
        let streams = streams(&source, config.stream, &layout, config.layout.get_ref())?;

        let mut objects = BTreeMap::new();
        for path in &config.objects {
            let text = text_of(&mut fetch, "objects", path)?;
            let folder = path.get_ref().rsplit_once('/').map_or("", |(folder, _)| folder);
            // Object files name their mesh relative to themselves, so that stations in any folder can share them.
            let object = ObjectModel::from_toml(path.get_ref(), &text, |mesh| {
                fetch(&if folder.is_empty() { mesh.to_owned() } else { format!("{folder}/{mesh}") })
            })?;
            let id = object.id.clone();
            if objects.insert(id.clone(), object).is_some() {
                let problem =
                    format!("{:?} holds an object called {id:?}, as an earlier file does", path.get_ref());
                return Err(source.error(path.span(), "objects", problem));
            }
        }
        let devices = hardware::devices(&source, config.device, &robot, &layout)?;
        let safety = hardware::safety(&source, config.safety, &robot, &carrier_dofs)?;
        let mut plans: Vec<(String, String)> = Vec::with_capacity(config.plans.len());
        for path in &config.plans {
            let text = text_of(&mut fetch, "plans", path)?;
            let name = path.get_ref().rsplit_once('/').map_or(path.get_ref().as_str(), |(_, name)| name);
            let id = name.strip_suffix(".toml").unwrap_or(name);
            check_id("the name of a plan", id)
                .map_err(|problem| source.error(path.span(), "plans", problem))?;
            if plans.iter().any(|(other, _)| other == id) {
                let problem = format!(
                    "{:?} has the name of an earlier plan, expected names that differ",
                    path.get_ref()
                );
                return Err(source.error(path.span(), "plans", problem));
            }
            plans.push((id.to_owned(), text));
        }
        Ok(Self {
            id: config.id,
            label: config.label,
            robot,
            layout,
            joint_rate_hz,
            carrier_dofs,
            objects,
            streams,
            nominal_model_toml,
            devices,
            safety,
            plans,
            files: StationFiles { station_toml, files },
        })
    }
}

/// Path relative to the station file -> bytes, or why not.
type Fetch<'a> = dyn FnMut(&str) -> Result<Vec<u8>, String> + 'a;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StationConfig {
    id: String,
    label: String,
    robot: Spanned<String>,
    layout: Spanned<String>,
    nominal_model: Spanned<String>,
    objects: Vec<Spanned<String>>,
    joint_rate_hz: Spanned<f64>,
    /// Every moving joint, in the order of recorded joint positions.
    joints: Spanned<Vec<Spanned<String>>>,
    #[serde(default)]
    carrier_joints: Vec<Spanned<String>>,
    #[serde(default)]
    stream: Vec<Spanned<StationStreamConfig>>,
    #[serde(default)]
    plans: Vec<Spanned<String>>,
    #[serde(default)]
    safety: SafetyText,
    #[serde(default)]
    device: Vec<Spanned<DeviceText>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StationStreamConfig {
    stream: String,
    on_threshold: f64,
    off_threshold: f64,
    raw_min: f64,
    raw_max: f64,
}

fn utf8(file: &str, bytes: Vec<u8>) -> Result<String, ModelError> {
    String::from_utf8(bytes).map_err(|err| {
        let line =
            1 + err.as_bytes()[..err.utf8_error().valid_up_to()].iter().filter(|&&b| b == b'\n').count();
        ModelError::new(file, format!("line {line}"), "not UTF-8, expected a text file; save it as UTF-8")
    })
}

fn joint_names(
    source: &Source<'_>,
    joints: &Spanned<Vec<Spanned<String>>>,
) -> Result<Vec<String>, ModelError> {
    let mut names: Vec<String> = Vec::with_capacity(joints.get_ref().len());
    for joint in joints.get_ref() {
        if names.contains(joint.get_ref()) {
            let problem = "this joint is listed twice, expected every moving joint once";
            return Err(source.error(joint.span(), format!("joint {:?}", joint.get_ref()), problem));
        }
        names.push(joint.get_ref().clone());
    }
    if names.is_empty() {
        let problem = "no joints, expected every moving joint in the order of recorded positions";
        return Err(source.error(joints.span(), "joints", problem));
    }
    Ok(names)
}

fn carrier_dofs(
    source: &Source<'_>,
    carrier_joints: &[Spanned<String>],
    joints: &[String],
) -> Result<Vec<usize>, ModelError> {
    let mut dofs = Vec::with_capacity(carrier_joints.len());
    for joint in carrier_joints {
        let what = format!("joint {:?}", joint.get_ref());
        let Some(dof) = joints.iter().position(|name| name == joint.get_ref()) else {
            let known = list(joints.iter().map(String::as_str));
            let problem =
                format!("carrier_joints names a joint that is not in joints, expected one of {known}");
            return Err(source.error(joint.span(), what, problem));
        };
        if dofs.contains(&dof) {
            return Err(source.error(joint.span(), what, "carrier_joints names this joint twice"));
        }
        dofs.push(dof);
    }
    Ok(dofs)
}

/// One configuration for each stream of the layout, in the layout's order.
fn streams(
    source: &Source<'_>,
    configs: Vec<Spanned<StationStreamConfig>>,
    layout: &TactileLayout,
    layout_file: &str,
) -> Result<Vec<StreamConfig>, ModelError> {
    let mut read: Vec<Option<StreamConfig>> = vec![None; layout.streams.len()];
    for spanned in configs {
        let span = spanned.span();
        let config = spanned.into_inner();
        let error =
            |problem: String| source.error(span.clone(), format!("stream {:?}", config.stream), problem);
        let Some(stream_idx) = layout.stream_index(&config.stream) else {
            let known = list(layout.streams.iter().map(|stream| stream.id.as_str()));
            return Err(error(format!("{layout_file} has no such stream, expected one of {known}")));
        };
        if read[stream_idx].is_some() {
            return Err(error("this stream has two [[stream]] entries, expected one".to_owned()));
        }
        for (name, value) in [
            ("on_threshold", config.on_threshold),
            ("off_threshold", config.off_threshold),
            ("raw_min", config.raw_min),
            ("raw_max", config.raw_max),
        ] {
            finite(name, value).map_err(error)?;
        }
        positive("on_threshold", config.on_threshold).map_err(error)?;
        positive("off_threshold", config.off_threshold).map_err(error)?;
        if config.off_threshold > config.on_threshold {
            return Err(error(format!(
                "off_threshold {} is above on_threshold {}, expected it below or equal",
                config.off_threshold, config.on_threshold
            )));
        }
        if config.raw_min >= config.raw_max {
            return Err(error(format!(
                "raw_min {} is not below raw_max {}, expected a range",
                config.raw_min, config.raw_max
            )));
        }
        if config.on_threshold >= config.raw_max - config.raw_min {
            return Err(error(format!(
                "on_threshold {} cannot be reached between raw_min {} and raw_max {}",
                config.on_threshold, config.raw_min, config.raw_max
            )));
        }
        read[stream_idx] = Some(StreamConfig {
            stream: config.stream,
            on_threshold: config.on_threshold,
            off_threshold: config.off_threshold,
            raw_min: config.raw_min,
            raw_max: config.raw_max,
        });
    }
    read.into_iter()
        .zip(&layout.streams)
        .map(|(config, stream)| {
            config.ok_or_else(|| {
                let problem = format!(
                    "no [[stream]] entry for this stream of {layout_file}; add one with its thresholds"
                );
                source.error_at(format!("stream {:?}", stream.id), problem)
            })
        })
        .collect()
}

#[cfg(test)]
mod tests;

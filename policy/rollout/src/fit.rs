//! Whether station, world, script and policy belong together, before anything moves.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, bail};
use base64::Engine as _;
use palpate_grasp::{GraspConfig, Script};
use palpate_robot_model::{ObjectModel, Station};
use palpate_wire::proto::LiveFrame;
use palpate_wire::proto::device_status::Link as DeviceLink;
use serde_json::Value;

use crate::policy::{Policy, ScriptPolicy};
use crate::studio::Studio;
use crate::task::{Source, sha256};

/// Where objects are, by name.
const OBJECTS: &str = "assets/objects";
/// Where scripts are, by the name of their object.
pub(crate) const SCRIPTS: &str = "assets/grasp/scripts";
/// What stands before the path of a policy that imitates an expert.
pub(crate) const CLONE: &str = "clone:";
/// How much faster than the safety layer lets a joint a script may be before that is said; rounding is no reason.
const FASTER: f64 = 1.01;

/// What is rolled out beside the policy, and in what.
#[derive(Clone, Debug, clap::Args)]
pub struct FitArgs {
    /// Script: a file, or a name in `assets/grasp/scripts` [default: that of the object]
    #[arg(long)]
    pub script: Option<String>,
    /// The policy was learned without a script
    #[arg(long, requires = "policy", conflicts_with = "script")]
    pub without_script: bool,
    /// Object: a file, or a name in `assets/objects`
    #[arg(long, default_value = "cube")]
    pub object: String,
    /// Grasp world of the station's robot: control rate, start positions, task
    #[arg(long, default_value = "assets/grasp/xarm6_leap.toml")]
    pub world: PathBuf,
    /// Actions and observations of a learned policy
    #[arg(long, default_value = "assets/grasp/xarm6_leap_learning.toml")]
    pub learning: PathBuf,
    /// What a policy that sees it is told of the region that objects begin in: half the edge length of the square, cm
    /// [default: that of the campaign, or that an emulated station's operator is asked for]
    #[arg(long, value_name = "CM", conflicts_with_all = ["campaign", "start_cm"])]
    pub region_cm: Option<f64>,
}

/// What belongs together.
pub struct Fitted {
    /// The station of the studio.
    pub station: Arc<Station>,
    /// Its robot's world file.
    pub world: GraspConfig,
    /// What moves it.
    pub policy: Box<dyn Policy>,
    /// What the policy is called in outcomes.
    pub policy_name: String,
    /// Id of the object.
    pub object: String,
    /// The object.
    pub object_model: ObjectModel,
    /// Files that were read, the station's included.
    pub sources: Vec<Source>,
    /// What an operator should know, though it keeps nobody from trying.
    pub warnings: Vec<String>,
    /// Half the edge length of the square that objects begin in, m, where somebody knows.
    pub half_width_m: Option<f64>,
}

/// Files in the order in which they were read.
#[derive(Default)]
struct Sources(RefCell<Vec<Source>>);

impl Sources {
    fn add(&self, role: &str, path: &Path, bytes: &[u8]) {
        let path = path.display().to_string();
        self.0.borrow_mut().push(Source { role: role.to_owned(), path, sha256: sha256(bytes) });
    }

    fn text(&self, role: &str, path: &Path) -> anyhow::Result<String> {
        let text = std::fs::read_to_string(path).with_context(|| {
            format!("failed to read {path:?}; paths are relative to the folder that the command runs in")
        })?;
        self.add(role, path, text.as_bytes());
        Ok(text)
    }
}

/// What is known of the square that objects begin in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Region {
    /// Half its edge length, m.
    HalfWidthM(f64),
    /// It is that of the world file.
    OfTheWorld,
    /// Whoever places objects has not said.
    Unknown,
}

impl Region {
    /// What a rollout outside a campaign is told by `--region-cm` and `--start-cm`, or by an emulated station's operator,
    /// who places objects where the world file has them begin.
    ///
    /// # Errors
    /// Numbers that are no lengths, by their flag.
    pub fn told(region_cm: Option<f64>, start_cm: Option<f64>, has_operator: bool) -> anyhow::Result<Self> {
        let given = [("--region-cm", region_cm), ("--start-cm", start_cm)];
        let given = given.into_iter().find_map(|(flag, cm)| Some((flag, cm?)));
        match given {
            Some((flag, cm)) if !(cm.is_finite() && cm >= 0.0) => {
                bail!("{flag} is {cm}, expected a finite number, not negative")
            }
            Some((_, cm)) => Ok(Self::HalfWidthM(0.01 * cm)),
            None if has_operator => Ok(Self::OfTheWorld),
            None => Ok(Self::Unknown),
        }
    }

    /// Half its edge length, m, where that is known.
    pub fn half_width_m(self, world: &GraspConfig) -> Option<f64> {
        match self {
            Self::HalfWidthM(half_width_m) => Some(half_width_m),
            Self::OfTheWorld => Some(world.task.half_width_m),
            Self::Unknown => None,
        }
    }
}

/// Reads everything, `policy` (a training's folder, a checkpoint or an exported file; `clone:PATH` for one that
/// imitates an expert; without one the script alone runs) among it, and refuses what does not belong together by the
/// name of what differs.
///
/// # Errors
/// A studio without a station, files that cannot be read or do not fit the station's robot, a policy of another task.
pub fn fit(studio: &Studio, policy: Option<&Path>, args: &FitArgs, region: Region) -> anyhow::Result<Fitted> {
    let sources = Sources::default();
    let document: Value = studio.get("/station")?;
    let station = Arc::new(station(&document, &sources)?);
    let world =
        GraspConfig::from_toml(&shown(&args.world), &sources.text("world", &args.world)?, &station.robot)
            .with_context(|| {
                format!("the world file does not fit the station {:?} of the studio", station.id)
            })?;
    let object_path = named(&args.object, OBJECTS, "--object")?;
    let object = object(&object_path, &sources)?;
    let is_cloned = policy.is_some_and(|policy| cloned_path(policy).is_some());
    let script = match args.without_script || is_cloned {
        true => None,
        false => {
            let name = args.script.as_ref().unwrap_or(&args.object);
            let path = named(name, SCRIPTS, "--script")?;
            let text = sources.text("script", &path)?;
            let script =
                Script::from_toml(&shown(&path), &text, &station.robot, &world).with_context(|| {
                    format!("the script does not fit the station {:?} of the studio", station.id)
                })?;
            Some((path, script))
        }
    };
    let mut warnings = Vec::new();
    if let Some((path, script)) = &script {
        reaches(path, script, &station)?;
        warnings.extend(too_fast(path, script, &station, &world));
    }
    let (policy, policy_name): (Box<dyn Policy>, String) = match (policy, script) {
        (None, Some((path, script))) => {
            let policy = ScriptPolicy::new(Arc::clone(&station), world.clone(), script);
            (Box::new(policy), format!("script {}", shown(&path)))
        }
        (Some(path), script) => {
            let script = script.map(|(_, script)| script);
            let half_width_m = region.half_width_m(&world);
            let scene = Scene { station: &station, world: &world, half_width_m };
            let learned = learned(args, path, &scene, script, &object.id, &sources)?;
            warnings.push(
                "the policy does not say which sensor model it was trained with; touch is the station's own"
                    .to_owned(),
            );
            (learned, shown(path))
        }
        (None, None) => bail!("there is nothing to run: give --policy or --script"),
    };
    Ok(Fitted {
        half_width_m: region.half_width_m(&world),
        object: object.id.clone(),
        object_model: object,
        sources: sources.0.into_inner(),
        station,
        world,
        policy,
        policy_name,
        warnings,
    })
}

/// Where a learned policy is rolled out.
#[cfg_attr(not(feature = "learned"), expect(dead_code, reason = "without learned policies nobody looks"))]
struct Scene<'a> {
    station: &'a Arc<Station>,
    world: &'a GraspConfig,
    /// Half the edge length of the square that objects begin in, m, where somebody knows.
    half_width_m: Option<f64>,
}

/// Whether the policy at `path` says that it was learned without a script.
///
/// # Errors
/// A file that cannot be read or is no policy.
#[cfg(not(feature = "learned"))]
pub fn is_without_script(path: &Path) -> anyhow::Result<bool> {
    Err(not_built(path))
}

#[cfg(not(feature = "learned"))]
fn learned(
    _args: &FitArgs,
    path: &Path,
    _scene: &Scene<'_>,
    _script: Option<Script>,
    _object: &str,
    _sources: &Sources,
) -> anyhow::Result<Box<dyn Policy>> {
    Err(not_built(path))
}

#[cfg(not(feature = "learned"))]
fn not_built(path: &Path) -> anyhow::Error {
    anyhow::anyhow!(
        "{path:?} cannot be run: this program was built without learned policies; `palpate-train rollout` has them"
    )
}

/// Where a policy is that imitates an expert, if `policy` names one.
fn cloned_path(policy: &Path) -> Option<PathBuf> {
    policy.to_str()?.strip_prefix(CLONE).map(PathBuf::from)
}

/// Whether the policy at `path` says that it was learned without a script.
///
/// # Errors
/// A file that cannot be read or is no policy.
#[cfg(feature = "learned")]
pub fn is_without_script(path: &Path) -> anyhow::Result<bool> {
    if cloned_path(path).is_some() {
        return Ok(true);
    }
    let (file, _, actor) = actor(path)?;
    let memory = crate::task::Memory::from_toml(actor.memory());
    let memory = memory.map_err(|problem| anyhow::anyhow!("policy {file:?}: {problem}"))?;
    Ok(!memory.task.has_script())
}

/// The policy at `path`, and the file and bytes that it was read from.
#[cfg(feature = "learned")]
fn actor(path: &Path) -> anyhow::Result<(PathBuf, Vec<u8>, palpate_ppo::Actor)> {
    let file = if path.is_dir() { path.join(palpate_ppo::CHECKPOINT_FILE) } else { path.to_owned() };
    let bytes = std::fs::read(&file).with_context(|| {
        format!(
            "failed to read {file:?}; --policy is a training's folder, a checkpoint or an exported policy"
        )
    })?;
    let actor = palpate_ppo::Actor::from_bytes(&file, &bytes)?;
    Ok((file, bytes, actor))
}

/// The policy at `path`, if it was trained for what it is given here.
#[cfg(feature = "learned")]
fn learned(
    args: &FitArgs,
    path: &Path,
    &Scene { station, world, half_width_m }: &Scene<'_>,
    script: Option<Script>,
    object: &str,
    sources: &Sources,
) -> anyhow::Result<Box<dyn Policy>> {
    use palpate_grasp::learn::{ActorTask, LearnConfig};

    use crate::policy::{ClonedPolicy, LearnedPolicy};
    use crate::task::{Memory, TaskRecord};

    if let Some(path) = cloned_path(path) {
        let (file, bytes, cloned) = palpate_cloning::Cloned::read(&path)?;
        sources.add("policy", &file, &bytes);
        let robot = crate::task::robot(station, world);
        cloned
            .robot()
            .check(&robot)
            .with_context(|| format!("{file:?} does not fit the station {:?}", station.id))?;
        if cloned.config().observation.region && half_width_m.is_none() {
            bail!(
                "{file:?} sees the region that objects begin in (observation.region), and nobody says how wide that is; give \
                 --region-cm, half the edge length of the square that objects are placed in"
            );
        }
        let policy = ClonedPolicy::new(Arc::new(cloned), Arc::clone(station), world, half_width_m);
        return Ok(Box::new(policy.with_context(|| format!("{file:?} does not fit"))?));
    }
    let text = sources.text("learning", &args.learning)?;
    let learning = LearnConfig::from_toml(&shown(&args.learning), &text, &station.robot)
        .with_context(|| format!("the learning file does not fit the station {:?}", station.id))?;
    let task = ActorTask::new(Arc::clone(station), world.clone(), script, learning);
    let given = TaskRecord::of(object, task.layout(), &sources.0.borrow())?;
    let (file, bytes, actor) = actor(path)?;
    sources.add("policy", &file, &bytes);
    let wrong = |problem: String| {
        let station = &station.id;
        anyhow::anyhow!("policy {file:?} does not fit: {problem} (the studio's station is {station:?})")
    };
    Memory::from_toml(actor.memory()).map_err(wrong)?.task.check(&given).map_err(wrong)?;
    Ok(Box::new(LearnedPolicy::new(task, actor)?))
}

/// The station as the studio hands it out.
fn station(document: &Value, sources: &Sources) -> anyhow::Result<Station> {
    const NAME: &str = "station.toml";
    let toml = document["station_toml"].as_str().context("the studio's station has no text")?;
    let files: BTreeMap<String, String> = serde_json::from_value(document["files_base64"].clone())
        .context("the studio's station has no files")?;
    sources.add("station", Path::new(NAME), toml.as_bytes());
    let read = |path: &str| {
        if path == NAME {
            return Ok(toml.as_bytes().to_vec());
        }
        let text = files.get(path).ok_or_else(|| "the studio did not send it".to_owned())?;
        base64::engine::general_purpose::STANDARD.decode(text).map_err(|err| err.to_string())
    };
    let station = Station::read(NAME, read)?;
    sources.add("model", Path::new("nominal model of the station"), station.nominal_model_toml.as_bytes());
    Ok(station)
}

/// The text of a reflex's file, which the studio checks; the record of each trial names it.
///
/// # Errors
/// A file that cannot be read.
pub fn reflex(path: &Path, fitted: &mut Fitted) -> anyhow::Result<String> {
    let sources = Sources::default();
    let text = sources.text("reflex", path)?;
    fitted.sources.extend(sources.0.into_inner());
    Ok(text)
}

/// A file, or one of a folder by its name.
fn named(name: &str, folder: &str, flag: &str) -> anyhow::Result<PathBuf> {
    let given = PathBuf::from(name);
    let path = if given.is_file() { given } else { Path::new(folder).join(format!("{name}.toml")) };
    if !path.is_file() {
        bail!(
            "{flag} is {name:?}, which is no file and nothing in {folder} below the folder that the command runs in"
        );
    }
    Ok(path)
}

fn object(path: &Path, sources: &Sources) -> anyhow::Result<ObjectModel> {
    let folder = path.parent().unwrap_or(Path::new("")).to_owned();
    let read_mesh = |mesh: &str| {
        let path = folder.join(mesh);
        let bytes = std::fs::read(&path).map_err(|err| err.to_string())?;
        sources.add("object", &path, &bytes);
        Ok(bytes)
    };
    Ok(ObjectModel::from_toml(&shown(path), &sources.text("object", path)?, read_mesh)?)
}

/// Refuses a script that leaves the limits of the station's safety layer, which may be tighter than the robot's.
fn reaches(path: &Path, script: &Script, station: &Station) -> anyhow::Result<()> {
    for (idx, key) in script.keys().iter().enumerate() {
        for (name, &target) in &key.joints {
            let mut joints = station.robot.dofs().zip(&station.safety.joints);
            let Some((_, limits)) = joints.find(|(joint, _)| joint.name == *name) else { continue };
            if !(limits.lower..=limits.upper).contains(&target) {
                bail!(
                    "{}: key {} sends joint {name:?} to {target}, beyond the {} to {} of the station's safety layer",
                    shown(path),
                    idx + 1,
                    limits.lower,
                    limits.upper
                );
            }
        }
    }
    Ok(())
}

/// Joints that the safety layer does not let move as fast as the script has them.
fn too_fast(path: &Path, script: &Script, station: &Station, world: &GraspConfig) -> Vec<String> {
    let mut warnings = Vec::new();
    let mut before = (0.0, world.start_positions(&station.robot));
    for (idx, key) in script.keys().iter().enumerate() {
        let targets = script.targets_at_key(idx).to_vec();
        let within_s = key.at_s - before.0;
        let joints = station.robot.dofs().zip(&station.safety.joints).zip(before.1.iter().zip(&targets));
        for ((joint, limits), (from, to)) in joints {
            let speed = (to - from).abs() / within_s;
            if speed > FASTER * limits.velocity {
                warnings.push(format!(
                    "{}: key {} wants {speed:.2} rad/s of joint {:?}, the safety layer lets it {:.2}: it will be late",
                    shown(path),
                    idx + 1,
                    joint.name,
                    limits.velocity
                ));
            }
        }
        before = (key.at_s, targets);
    }
    warnings
}

/// Why the station cannot be moved as it is, by the name of what is missing.
pub fn not_ready(live: &LiveFrame) -> Option<String> {
    let Some(control) = &live.control else { return Some("the studio says nothing of control".to_owned()) };
    if control.devices.is_empty() {
        return Some("the station has no devices".to_owned());
    }
    let missing = control.devices.iter().find(|device| device.link() != DeviceLink::Ready);
    if let Some(device) = missing {
        let word = match device.link() {
            DeviceLink::Unspecified | DeviceLink::Connecting => "is being connected",
            DeviceLink::Ready => "is ready",
            DeviceLink::Fault => "has a fault",
            DeviceLink::Lost => "is lost",
        };
        return Some(format!("{} {word}: {}", device.id, device.problem));
    }
    live.joint_positions.is_empty().then(|| "not every joint was read yet".to_owned())
}

fn shown(path: &Path) -> String {
    path.display().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_places_objects_says_how_wide_the_region_is() {
        let told = |region_cm, start_cm, has_operator| Region::told(region_cm, start_cm, has_operator).ok();
        assert_eq!(told(Some(8.0), None, false), Some(Region::HalfWidthM(0.08)));
        assert_eq!(told(None, Some(2.0), true), Some(Region::HalfWidthM(0.02)));
        assert_eq!(told(None, None, true), Some(Region::OfTheWorld));
        assert_eq!(told(None, None, false), Some(Region::Unknown));
        let problem = Region::told(None, Some(-1.0), true).expect_err("no length").to_string();
        assert_eq!(problem, "--start-cm is -1, expected a finite number, not negative");
    }
}

//! From paths to scenes, and which files they were made from.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, bail};
use palpate_calibration::contact_map::ContactMap;
use palpate_grasp::touch::{NoTouch, Sense};
use palpate_grasp::{GraspConfig, GraspScene, Protocol, Script};
use palpate_robot_model::{ObjectGroup, ObjectModel, Station};
pub(crate) use palpate_rollout::task::{Source, sha256};
use palpate_sim::SensorModel;

use crate::truth::Emulated;
use crate::{RobotArgs, SceneArgs};

/// Files in the order in which they were read.
#[derive(Default)]
pub(crate) struct Sources(RefCell<Vec<Source>>);

impl Sources {
    pub(crate) fn text(&self, role: &str, path: &Path) -> anyhow::Result<String> {
        let text = text(path)?;
        self.add(role, path, text.as_bytes());
        Ok(text)
    }

    pub(crate) fn add(&self, role: &str, path: &Path, bytes: &[u8]) {
        self.0.borrow_mut().push(Source { role: role.to_owned(), path: shown(path), sha256: sha256(bytes) });
    }

    fn beside(&self, role: &str, folder: &Path, name: &str) -> Result<Vec<u8>, String> {
        let path = folder.join(name);
        let bytes = std::fs::read(&path).map_err(|err| err.to_string())?;
        self.add(role, &path, &bytes);
        Ok(bytes)
    }

    /// Adds a file that was read elsewhere, unless it is there already.
    pub(crate) fn keep(&self, source: Source) {
        let mut list = self.0.borrow_mut();
        if !list.contains(&source) {
            list.push(source);
        }
    }

    pub(crate) fn list(&self) -> Vec<Source> {
        self.0.borrow().clone()
    }

    pub(crate) fn into_list(self) -> Vec<Source> {
        self.0.into_inner()
    }
}

/// Starts the threads that are asked for; at most once.
pub(crate) fn start_threads(threads: Option<usize>) -> anyhow::Result<()> {
    if threads == Some(0) {
        bail!("--threads is 0, expected at least 1");
    }
    if let Some(threads) = threads {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build_global()
            .with_context(|| format!("failed to start {threads} threads"))?;
    }
    Ok(())
}

/// A grasp world without an object.
pub(crate) struct OpenWorld {
    pub(crate) station: Arc<Station>,
    pub(crate) config: GraspConfig,
    sense: Box<dyn Sense>,
}

impl OpenWorld {
    /// `object` in it, felt as the arguments say.
    pub(crate) fn scene(&self, object: &ObjectModel) -> anyhow::Result<GraspScene> {
        Ok(GraspScene::new(Arc::clone(&self.station), self.config.clone(), object, &*self.sense)?)
    }

    /// `object` in it, felt by nobody.
    pub(crate) fn scene_without_touch(&self, object: &ObjectModel) -> anyhow::Result<GraspScene> {
        Ok(GraspScene::new(Arc::clone(&self.station), self.config.clone(), object, &NoTouch)?)
    }
}

/// Reads station and world that `args` names.
pub(crate) fn open_robot(args: &RobotArgs, sources: &Sources) -> anyhow::Result<(Arc<Station>, GraspConfig)> {
    let (station, world) = (station(&args.station, sources)?, &args.world);
    let config = GraspConfig::from_toml(&shown(world), &sources.text("world", world)?, &station.robot)?;
    Ok((Arc::new(station), config))
}

/// Reads the station whose file is `path`.
pub(crate) fn station(path: &Path, sources: &Sources) -> anyhow::Result<Station> {
    let folder = path.parent().unwrap_or(Path::new(""));
    Ok(Station::read(station_name(path)?, |path| sources.beside("station", folder, path))?)
}

/// Name of the file of a station.
pub(crate) fn station_name(station: &Path) -> anyhow::Result<&str> {
    station.file_name().and_then(|name| name.to_str()).context("--station is no file")
}

/// The sensor model that `args` names, and its text.
pub(crate) fn sensor_model(
    args: &RobotArgs,
    station: &Station,
    sources: &Sources,
) -> anyhow::Result<(SensorModel, String)> {
    let (file, text) = match &args.model {
        Some(path) => (shown(path), sources.text("model", path)?),
        None => ("nominal model".to_owned(), station.nominal_model_toml.clone()),
    };
    Ok((SensorModel::from_toml(&file, &text)?, text))
}

/// Reads station, world and sense that `args` names.
pub(crate) fn open_world(args: &SceneArgs, sources: &Sources) -> anyhow::Result<OpenWorld> {
    let (station, mut config) = open_robot(&args.robot, sources)?;
    if let Some(start_cm) = args.start_cm {
        if !(start_cm.is_finite() && start_cm >= 0.0) {
            bail!("--start-cm is {start_cm}, expected a number that is not negative");
        }
        config.task.half_width_m = 0.01 * start_cm;
    }
    let sense: Box<dyn Sense> = match &args.truth {
        _ if args.silence_touch => Box::new(NoTouch),
        Some(path) => {
            sources.text("truth", path)?;
            let map = args.contact_map.as_deref().map(|path| {
                let text = sources.text("contact map", path)?;
                anyhow::Ok(ContactMap::from_toml(&shown(path), &text)?)
            });
            Box::new(Emulated::read(path, map.transpose()?)?)
        }
        None => Box::new(sensor_model(&args.robot, &station, sources)?.0),
    };
    Ok(OpenWorld { station, config, sense })
}

/// The script at `path`.
pub(crate) fn script(path: &Path, world: &OpenWorld, sources: &Sources) -> anyhow::Result<Script> {
    let text = sources.text("script", path)?;
    Ok(Script::from_toml(&shown(path), &text, &world.station.robot, &world.config)?)
}

/// Reads everything that `args` names, and starts its threads.
pub(crate) fn open(args: &SceneArgs, sources: &Sources) -> anyhow::Result<(Arc<GraspScene>, Script)> {
    start_threads(args.threads)?;
    let world = open_world(args, sources)?;
    let script = script(&args.script, &world, sources)?;
    let scene = world.scene(&object(&args.object, sources)?)?;
    Ok((Arc::new(scene), script))
}

/// Names of the objects that a list names: "seen", "unseen", "all", or names and files with commas between.
pub(crate) fn objects(list: &str) -> anyhow::Result<Vec<String>> {
    let of_groups = |groups: &[ObjectGroup]| -> anyhow::Result<Vec<String>> {
        let mut names = Vec::new();
        for name in known_objects() {
            let group = object(&name, &Sources::default())?.group;
            if group.is_some_and(|group| groups.contains(&group)) {
                names.push(name);
            }
        }
        if names.is_empty() {
            bail!(
                "--objects is {list:?}, but no object in {OBJECTS} belongs to it; run the command in the folder that \
                   holds it"
            );
        }
        Ok(names)
    };
    match list {
        "seen" => of_groups(&[ObjectGroup::Seen]),
        "unseen" => of_groups(&[ObjectGroup::Unseen]),
        "all" => of_groups(&[ObjectGroup::Seen, ObjectGroup::Unseen]),
        _ => {
            let names: Vec<String> = list.split(',').map(|name| name.trim().to_owned()).collect();
            let twice = names.iter().enumerate().find(|(idx, name)| names[..*idx].contains(name));
            if let Some((_, name)) = twice {
                bail!("--objects names {name:?} twice");
            }
            names.iter().try_for_each(|name| object(name, &Sources::default()).map(drop))?;
            Ok(names)
        }
    }
}

/// The text of an object, and its meshes by their path from its folder.
pub(crate) struct ObjectFiles {
    pub(crate) text: String,
    pub(crate) meshes: Vec<(String, Vec<u8>)>,
}

/// The files of the object of this name, or in this file.
pub(crate) fn object_files(name: &str) -> anyhow::Result<ObjectFiles> {
    let path = object_path(name)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let text = text(&path)?;
    let mut meshes = Vec::new();
    ObjectModel::from_toml(&shown(&path), &text, |mesh| {
        let bytes = std::fs::read(folder.join(mesh)).map_err(|err| err.to_string())?;
        meshes.push((mesh.to_owned(), bytes.clone()));
        Ok(bytes)
    })?;
    Ok(ObjectFiles { text, meshes })
}

/// The object of this name, or in this file.
pub(crate) fn object(name: &str, sources: &Sources) -> anyhow::Result<ObjectModel> {
    let path = object_path(name)?;
    let folder = path.parent().unwrap_or(Path::new("")).to_owned();
    let read_mesh = |mesh: &str| sources.beside("object", &folder, mesh);
    Ok(ObjectModel::from_toml(&shown(&path), &sources.text("object", &path)?, read_mesh)?)
}

/// Where the file of this object is.
fn object_path(name: &str) -> anyhow::Result<PathBuf> {
    let given = PathBuf::from(name);
    let path = if given.is_file() { given } else { Path::new(OBJECTS).join(format!("{name}.toml")) };
    if !path.is_file() {
        let known = known_objects();
        let known = if known.is_empty() {
            "there is no such folder here; run the command in the folder that holds it".to_owned()
        } else {
            known.join(", ")
        };
        bail!("--object is {name:?}, which is no file and no object in {OBJECTS}: {known}");
    }
    Ok(path)
}

const OBJECTS: &str = "assets/objects";

/// Names of the objects in [`OBJECTS`].
fn known_objects() -> Vec<String> {
    names_in(Path::new(OBJECTS))
}

const PROTOCOLS: &str = "assets/grasp/protocols";

/// The protocol that `given` names, a file or one of those that are shipped, and its name.
pub(crate) fn protocol(given: &str, sources: &Sources) -> anyhow::Result<(String, Protocol)> {
    let file = PathBuf::from(given);
    let path = if file.is_file() { file } else { Path::new(PROTOCOLS).join(format!("{given}.toml")) };
    if !path.is_file() {
        let known: Vec<String> = names_in(Path::new(PROTOCOLS));
        bail!(
            "--protocol is {given:?}, which is no file and no protocol in {PROTOCOLS}: {}",
            known.join(", ")
        );
    }
    let text = sources.text("protocol", &path)?;
    let name = path.file_stem().and_then(|name| name.to_str()).unwrap_or(given).to_owned();
    Ok((name, Protocol::from_toml(&shown(&path), &text)?))
}

/// Names of the TOML files in `folder`, sorted; none where there is no such folder.
pub(crate) fn names_in(folder: &Path) -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut names: Vec<String> = entries
        .filter_map(|entry| {
            let path = entry.ok()?.path();
            let name = path.file_stem()?.to_str()?.to_owned();
            path.extension().is_some_and(|extension| extension == "toml").then_some(name)
        })
        .collect();
    names.sort();
    names
}

/// What is wrong with the place of a file that will be written.
pub(crate) fn check_out(out: &Path) -> anyhow::Result<()> {
    let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !folder.is_dir() {
        bail!("--out is {out:?}, but there is no folder {folder:?}; make it first");
    }
    if out.is_dir() {
        bail!("--out is {out:?}, which is a folder, expected a file");
    }
    Ok(())
}

pub(crate) fn text(path: &Path) -> anyhow::Result<String> {
    std::fs::read_to_string(path).with_context(|| {
        format!("failed to read {path:?}; paths are relative to the folder that the command runs in")
    })
}

pub(crate) fn shown(path: &Path) -> String {
    path.display().to_string()
}

/// Replaces `path` by a file with `bytes`: whoever looks, also after a crash, sees the old file or the new one.
pub(crate) fn write_in_one_move(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let partial = path.with_extension("partial");
    let write = || {
        let mut file = std::fs::File::create(&partial)?;
        std::io::Write::write_all(&mut file, bytes)?;
        file.sync_all()?;
        std::fs::rename(&partial, path)
    };
    write().with_context(|| format!("failed to write {path:?}"))
}

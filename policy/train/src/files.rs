//! From paths to scenes, and which files they were made from.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, bail};
use palpate_grasp::touch::{NoTouch, Sense};
use palpate_grasp::{GraspConfig, GraspScene, Script};
use palpate_robot_model::{ObjectModel, Station};
pub(crate) use palpate_rollout::task::{Source, sha256};
use palpate_sim::SensorModel;

use crate::SceneArgs;
use crate::truth::Emulated;

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

    pub(crate) fn into_list(self) -> Vec<Source> {
        self.0.into_inner()
    }
}

/// Reads everything that `args` names, and starts its threads.
pub(crate) fn open(args: &SceneArgs, sources: &Sources) -> anyhow::Result<(Arc<GraspScene>, Script)> {
    if args.threads == Some(0) {
        bail!("--threads is 0, expected at least 1");
    }
    if let Some(threads) = args.threads {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build_global()
            .with_context(|| format!("failed to start {threads} threads"))?;
    }
    let folder = args.station.parent().unwrap_or(Path::new("")).to_owned();
    let name = args.station.file_name().and_then(|name| name.to_str()).context("--station is no file")?;
    let read = |path: &str| sources.beside("station", &folder, path);
    let station = Arc::new(Station::read(name, read)?);
    let mut config =
        GraspConfig::from_toml(&shown(&args.world), &sources.text("world", &args.world)?, &station.robot)?;
    if let Some(start_cm) = args.start_cm {
        if !(start_cm.is_finite() && start_cm >= 0.0) {
            bail!("--start-cm is {start_cm}, expected a number that is not negative");
        }
        config.task.half_width_m = 0.01 * start_cm;
    }
    let script = Script::from_toml(
        &shown(&args.script),
        &sources.text("script", &args.script)?,
        &station.robot,
        &config,
    )?;
    let sense: Box<dyn Sense> = match (&args.truth, &args.model) {
        _ if args.silence_touch => Box::new(NoTouch),
        (Some(path), _) => {
            sources.text("truth", path)?;
            Box::new(Emulated::read(path)?)
        }
        (None, Some(path)) => Box::new(SensorModel::from_toml(&shown(path), &sources.text("model", path)?)?),
        (None, None) => Box::new(SensorModel::from_toml("nominal model", &station.nominal_model_toml)?),
    };
    let scene = GraspScene::new(station, config, &object(&args.object, sources)?, &*sense)?;
    Ok((Arc::new(scene), script))
}

pub(crate) fn object(name: &str, sources: &Sources) -> anyhow::Result<ObjectModel> {
    let given = PathBuf::from(name);
    let path = if given.is_file() { given } else { Path::new(OBJECTS).join(format!("{name}.toml")) };
    if !path.is_file() {
        bail!("--object is {name:?}, which is no file and no object in {OBJECTS}: {}", known_objects());
    }
    let folder = path.parent().unwrap_or(Path::new("")).to_owned();
    let read_mesh = |mesh: &str| sources.beside("object", &folder, mesh);
    Ok(ObjectModel::from_toml(&shown(&path), &sources.text("object", &path)?, read_mesh)?)
}

const OBJECTS: &str = "assets/objects";

fn known_objects() -> String {
    let Ok(entries) = std::fs::read_dir(OBJECTS) else {
        return "there is no such folder here; run the command in the folder that holds it".to_owned();
    };
    let mut names: Vec<String> = entries
        .filter_map(|entry| {
            let path = entry.ok()?.path();
            let name = path.file_stem()?.to_str()?.to_owned();
            path.extension().is_some_and(|extension| extension == "toml").then_some(name)
        })
        .collect();
    names.sort();
    names.join(", ")
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

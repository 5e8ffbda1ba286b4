//! From paths to scenes.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context as _;
use palpate_grasp::{GraspConfig, GraspScene, Script};
use palpate_robot_model::{ObjectModel, Station};
use palpate_sim::SensorModel;

use crate::SceneArgs;

/// Reads everything that `args` names, and starts its threads.
pub(crate) fn open(args: &SceneArgs) -> anyhow::Result<(Arc<GraspScene>, Script)> {
    if let Some(threads) = args.threads {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build_global()
            .with_context(|| format!("failed to start {threads} threads"))?;
    }
    let folder = args.station.parent().unwrap_or(Path::new("")).to_owned();
    let name = args.station.file_name().and_then(|name| name.to_str()).context("--station is no file")?;
    let read = |path: &str| std::fs::read(folder.join(path)).map_err(|err| err.to_string());
    let station = Arc::new(Station::read(name, read)?);
    let config = GraspConfig::from_toml(&shown(&args.world), &text(&args.world)?, &station.robot)?;
    let script = Script::from_toml(&shown(&args.script), &text(&args.script)?, &station.robot, &config)?;
    let model = match &args.model {
        Some(path) => SensorModel::from_toml(&shown(path), &text(path)?)?,
        None => SensorModel::from_toml("nominal model", &station.nominal_model_toml)?,
    };
    let scene = GraspScene::new(station, config, &object(&args.object)?, &model)?;
    Ok((Arc::new(scene), script))
}

fn object(name: &str) -> anyhow::Result<ObjectModel> {
    let given = PathBuf::from(name);
    let path = if given.is_file() { given } else { Path::new("assets/objects").join(format!("{name}.toml")) };
    let folder = path.parent().unwrap_or(Path::new("")).to_owned();
    let read_mesh = |mesh: &str| std::fs::read(folder.join(mesh)).map_err(|err| err.to_string());
    Ok(ObjectModel::from_toml(&shown(&path), &text(&path)?, read_mesh)?)
}

fn text(path: &Path) -> anyhow::Result<String> {
    std::fs::read_to_string(path).with_context(|| {
        format!("failed to read {path:?}; paths are relative to the folder that the command runs in")
    })
}

fn shown(path: &Path) -> String {
    path.display().to_string()
}

//! Writes the grasp world for other programs that run MuJoCo: its scene, and everything that `palpate.touch` needs beside it.

use std::cell::RefCell;
use std::fs;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, bail};
use palpate_grasp::{GraspScene, Randomisation, Script, Start, scene};
use palpate_robot_model::{ObjectModel, Station};
use serde_json::json;

use crate::RobotArgs;
use crate::files::{self, Sources, shown};

/// What the folder says about itself.
const README: &str = include_str!("export_mujoco/README.md");
/// A program that runs the scene and feels.
const FEEL: &str = include_str!("export_mujoco/feel.py");

/// Files to write: paths in the folder, and bytes.
type Files = Vec<(PathBuf, Vec<u8>)>;

#[derive(clap::Args)]
pub(crate) struct ExportMujocoArgs {
    /// Folder to make
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    robot: RobotArgs,
    /// Object: a file, or a name in `assets/objects`
    #[arg(long, default_value = "cube")]
    object: String,
    /// Script that the hand follows in `feel.py`
    #[arg(long, default_value = "assets/grasp/scripts/xarm6_leap_cube.toml")]
    script: PathBuf,
    /// One JSON document on standard output
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &ExportMujocoArgs) -> anyhow::Result<()> {
    if args.out.exists() {
        bail!("--out is {:?}, which exists, expected the name of a new folder", args.out);
    }
    let export = Export::read(args)?;
    let partial = args.out.with_extension("partial");
    if partial.exists() {
        fs::remove_dir_all(&partial).with_context(|| format!("failed to remove {partial:?}"))?;
    }
    for (name, bytes) in &export.files {
        let path = partial.join(name);
        let folder = path.parent().unwrap_or(&partial);
        fs::create_dir_all(folder).with_context(|| format!("failed to make {folder:?}"))?;
        fs::write(&path, bytes).with_context(|| format!("failed to write {path:?}"))?;
    }
    fs::rename(&partial, &args.out).with_context(|| format!("failed to make {:?}", args.out))?;
    if args.json {
        let names: Vec<String> = export.files.iter().map(|(name, _)| shown(name)).collect();
        let document =
            json!({ "out": args.out, "object": export.object, "model": export.model, "files": names });
        println!("{document}");
    } else {
        println!("wrote {}: {} files; its README.md says how to go on", shown(&args.out), export.files.len());
    }
    Ok(())
}

/// What the folder will hold.
struct Export {
    object: String,
    model: String,
    /// By path in the folder.
    files: Files,
}

impl Export {
    fn read(args: &ExportMujocoArgs) -> anyhow::Result<Self> {
        let sources = Sources::default();
        let (station, config) = files::open_robot(&args.robot, &sources)?;
        let (model, model_text) = files::sensor_model(&args.robot, &station, &sources)?;
        let script = files::text(&args.script)?;
        Script::from_toml(&shown(&args.script), &script, &station.robot, &config)?;
        let (object, object_files) = object(&args.object)?;
        let scene = GraspScene::new(Arc::clone(&station), config, &object, &model)?;

        let start = Start::nominal(&scene);
        let mjcf = scene.mjcf(&Randomisation::none())?;
        let mjcf = scene::with_start(&mjcf, &station.robot, &start.positions, &start.base_from_object);
        let (station_file, station_files) = station_files(&station, &args.robot.station)?;
        let table = &scene.config().table;
        let [x, y, _] = [table.center_m[0], table.center_m[1], 0.0];
        let z = table.top_m - 0.5 * table.size_m[2];
        let fill = |text: &str| {
            text.replace("{station}", &shown(&station_file))
                .replace("{object}", &object.id)
                .replace("{object_label}", &object.label)
                .replace("{model}", &model.name)
                .replace("{station_label}", &station.label)
                .replace("{table_pose}", &format!("[{x}, {y}, {z}, 1.0, 0.0, 0.0, 0.0]"))
                .replace("{rate_hz}", &scene.config().control_rate_hz.to_string())
        };
        let [length_m, width_m, height_m] = table.size_m;
        let table_toml = format!(
            "# What robot and object stand on.\nid = \"table\"\nlabel = \"Table\"\n\
             shape = {{ kind = \"box\", size_m = [{length_m:?}, {width_m:?}, {height_m:?}] }}\n"
        );
        let mut files = vec![
            (PathBuf::from("README.md"), fill(README).into_bytes()),
            ("feel.py".into(), fill(FEEL).into_bytes()),
            ("scene.xml".into(), mjcf.into_bytes()),
            ("model.toml".into(), model_text.into_bytes()),
            ("script.toml".into(), script.into_bytes()),
            ("table.toml".into(), table_toml.into_bytes()),
        ];
        files.extend(object_files);
        files.extend(station_files);
        Ok(Self { object: object.id, model: model.name, files })
    }
}

/// The object and its files, the first of them as `object.toml`.
fn object(name: &str) -> anyhow::Result<(ObjectModel, Files)> {
    let sources = Sources::default();
    let object = files::object(name, &sources)?;
    let path = sources.list().first().map(|source| PathBuf::from(&source.path));
    let path = path.with_context(|| format!("object {name:?} has no file"))?;
    let folder = path.parent().unwrap_or(Path::new("")).to_owned();
    let text = files::text(&path)?;
    let meshes = RefCell::new(Vec::new());
    // Once more, for the names by which it calls its meshes.
    ObjectModel::from_toml(&shown(&path), &text, |mesh| {
        let bytes = fs::read(folder.join(mesh)).map_err(|err| err.to_string())?;
        meshes.borrow_mut().push((PathBuf::from(mesh), bytes.clone()));
        Ok(bytes)
    })?;
    let mut files = vec![(PathBuf::from("object.toml"), text.into_bytes())];
    for (mesh, bytes) in meshes.into_inner() {
        if mesh.components().any(|part| !matches!(part, Component::Normal(_))) {
            bail!("object {name:?} names the mesh {mesh:?}, expected a path below the folder of its file");
        }
        files.push((mesh, bytes));
    }
    Ok((object, files))
}

/// The station's files below `station`, each where the station's file finds it, and the path of that one.
fn station_files(station: &Station, path: &Path) -> anyhow::Result<(PathBuf, Files)> {
    let name = files::station_name(path)?;
    let up =
        |file: &str| Path::new(file).components().take_while(|part| *part == Component::ParentDir).count();
    let depth = station.files.files.keys().map(|file| up(file)).max().unwrap_or(0);
    let folder = fs::canonicalize(path).with_context(|| format!("failed to find {path:?}"))?;
    let parts: Vec<_> = folder.parent().map_or_else(Vec::new, |folder| folder.iter().collect());
    let own: PathBuf = parts[parts.len().saturating_sub(depth)..].iter().collect();
    let base = Path::new("station").join(&own);
    let mut files = vec![(base.join(name), station.files.station_toml.clone().into_bytes())];
    for (file, bytes) in &station.files.files {
        let mut target = base.clone();
        for part in Path::new(file).components() {
            let is_within = match part {
                Component::Normal(part) => {
                    target.push(part);
                    true
                }
                Component::CurDir => true,
                Component::ParentDir => target != Path::new("station") && target.pop(),
                Component::RootDir | Component::Prefix(_) => false,
            };
            if !is_within {
                bail!(
                    "station {path:?} names {file:?}, which cannot be copied with it; expected a relative path"
                );
            }
        }
        files.push((target, bytes.clone()));
    }
    Ok((base.join(name), files))
}

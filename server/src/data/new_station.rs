//! `palpate station new`: a URDF and its meshes from disk, and a folder with a station made of them.

mod ask;

use std::{
    collections::BTreeMap,
    fs,
    path::{Component, Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

use palpate_motion::{FirstPlan, Plan, PlanError, Primitive, first_plan};
use palpate_recording::{
    files::{MAX_STATION_FILE_BYTES, MAX_TEXT_BYTES, read_file, read_text},
    load_station,
};
use palpate_robot_model::{
    ObjectModel, Robot, SimplifiedUrdf,
    new_station::{BuiltStation, NewStation, RobotReport, STATION_FILE, build, explain},
    simplify_urdf,
};
use palpate_sim::SensorModel;

use super::objects;
use crate::{Error, assets, chain};
pub use ask::{ask, ask_axes};

/// Folder of the objects in that of the station.
const OBJECTS_FOLDER: &str = "objects";

/// A URDF that was read.
pub struct RobotFile {
    /// Name of the file.
    pub file: String,
    /// It, without meshes.
    pub urdf: SimplifiedUrdf,
    /// The robot that it describes.
    pub robot: Robot,
    /// What is understood of it.
    pub report: RobotReport,
}

/// Reads the URDF at `path`. Meshes are looked for beside it and above it; one that is not found is a warning.
pub fn read_robot(path: &Path) -> Result<RobotFile, Error> {
    let text = read_text(path, MAX_TEXT_BYTES)?;
    let file = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let folder = path.parent().unwrap_or(Path::new(""));
    let urdf = simplify_urdf(&file, &text, |mesh| read_mesh(folder, mesh))?;
    let robot = Robot::from_urdf(&file, &urdf.text, &[])?;
    let report = explain(&robot, &urdf);
    Ok(RobotFile { file, urdf, robot, report })
}

/// The mesh that a URDF in `folder` calls `name`: `package://PACKAGE/PATH` in the nearest folder above that is called as the
/// package or has such a file, `file://PATH`, or a path relative to `folder`.
fn read_mesh(folder: &Path, name: &str) -> Result<Vec<u8>, String> {
    let lower = name.to_ascii_lowercase();
    if !lower.ends_with(".stl") && !lower.ends_with(".obj") {
        return Err(
            "expected a file that ends in .obj or .stl; convert it, and name that in the URDF".to_owned()
        );
    }
    let path = match (name.strip_prefix("package://"), name.strip_prefix("file://")) {
        (Some(in_package), _) => {
            let (package, path) = in_package.split_once('/').unwrap_or(("", in_package));
            if Path::new(path).components().any(|part| part == Component::ParentDir) {
                return Err("leads out of its package, expected a path within it".to_owned());
            }
            let absolute = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
            let found = absolute.ancestors().find_map(|above| {
                let own = (above.file_name().is_some_and(|name| name.to_string_lossy() == package))
                    .then(|| above.join(path));
                [own, Some(above.join(package).join(path)), Some(above.join(path))]
                    .into_iter()
                    .flatten()
                    .find(|candidate| candidate.is_file())
            });
            found.ok_or_else(|| {
                format!("no folder above the URDF has {package}/{path}; put the package {package:?} there")
            })?
        }
        (None, Some(path)) => PathBuf::from(path),
        (None, None) => folder.join(name),
    };
    read_file(&path, MAX_STATION_FILE_BYTES).map_err(|err| chain(&err))
}

/// Makes the files of a station with a plan that touches every patch with each of its objects, as far as that can be; what
/// the plan leaves out is said with it.
pub fn build_with_plan(
    mut wanted: NewStation,
    robot: &RobotFile,
) -> Result<(BuiltStation, FirstPlan), Error> {
    let built = build(&wanted, &robot.file, &robot.urdf)?;
    // What is wrong with these texts nobody but us wrote.
    let ours = |err: PlanError| Error::Internal(err.to_string());
    let shipped = |id: &str| {
        let path = format!("primitives/{id}.toml");
        let text = assets::text(&path).ok_or_else(|| Error::Internal(format!("{path} is not shipped")))?;
        Ok::<_, Error>((id.to_owned(), Primitive::from_text(&path, text).map_err(ours)?))
    };
    let primitives = ["tap", "press_hold"].into_iter().map(shipped).collect::<Result<_, _>>()?;
    let mut plan = first_plan(&built.station, &primitives);
    if plan.text.is_none() {
        return Ok((built, plan));
    }
    wanted.plan.clone_from(&plan.text);
    let built = build(&wanted, &robot.file, &robot.urdf)?;
    // As every command will read it from now on.
    for read in Plan::of_station(&built.station).map_err(ours)? {
        read.check(&built.station).map_err(ours)?;
        plan.takes = read.takes.len();
    }
    Ok((built, plan))
}

/// The object files that a new station has: their paths in its folder, and every file that they need.
pub struct ObjectFiles {
    /// Paths of the object files.
    pub paths: Vec<String>,
    /// Bytes by path, meshes included.
    pub files: BTreeMap<String, Vec<u8>>,
}

/// Finds objects by the ids of shipped ones or the paths of object files.
pub fn read_objects(ids_or_paths: &[String]) -> Result<ObjectFiles, Error> {
    let mut found = ObjectFiles { paths: Vec::new(), files: BTreeMap::new() };
    for id_or_path in ids_or_paths {
        let path = Path::new(id_or_path);
        let is_path = path.extension().is_some_and(|ending| ending == "toml") || id_or_path.contains('/');
        let object = if is_path {
            let folder = path.parent().unwrap_or(Path::new(""));
            let file = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            let text = read_file(path, MAX_TEXT_BYTES)?;
            gather(&file, text, |mesh| {
                read_file(&folder.join(mesh), MAX_STATION_FILE_BYTES).map_err(|err| chain(&err))
            })?
        } else {
            let file = format!("{id_or_path}.toml");
            let text = objects::shipped_text(id_or_path).ok_or_else(|| unknown_object(id_or_path))?;
            gather(&file, text.to_vec(), objects::shipped_mesh)?
        };
        let (path, files) = object;
        if found.paths.contains(&path) {
            return Err(Error::Argument(format!(
                "object {id_or_path:?} is given twice, or shares its file name"
            )));
        }
        found.paths.push(path);
        found.files.extend(files);
    }
    Ok(found)
}

fn unknown_object(id: &str) -> Error {
    Error::Argument(format!(
        "no object {id:?}; shipped are {}; or give the path of an object file, FILE.toml (docs/objects.md)",
        objects::shipped_ids().join(", ")
    ))
}

/// An object file and the meshes that it names, by their paths in the station's folder.
fn gather(
    file: &str,
    text: Vec<u8>,
    read_mesh: impl Fn(&str) -> Result<Vec<u8>, String>,
) -> Result<(String, BTreeMap<String, Vec<u8>>), Error> {
    let in_folder = |name: &str| format!("{OBJECTS_FOLDER}/{name}");
    let mut files = BTreeMap::new();
    let utf8 = String::from_utf8(text.clone())
        .map_err(|_| Error::Content(format!("object file {file:?} is not UTF-8, expected a text file")))?;
    ObjectModel::from_toml(file, &utf8, |mesh| {
        let is_plain = Path::new(mesh).components().all(|part| matches!(part, Component::Normal(_)));
        if !is_plain {
            return Err(format!(
                "{mesh:?} does not lie beside the object file; put it there to have it copied"
            ));
        }
        let bytes = read_mesh(mesh)?;
        files.insert(in_folder(mesh), bytes.clone());
        Ok(bytes)
    })?;
    let path = in_folder(file);
    files.insert(path.clone(), text);
    Ok((path, files))
}

/// Refuses a folder that [`write()`] would refuse, before anybody is asked anything.
pub fn check_target(dir: &Path) -> Result<(), Error> {
    let exists =
        |problem: &str| Err(Error::Exists(format!("{dir:?} {problem}; give another folder with --out")));
    if dir.file_name().is_none() {
        return Err(Error::Argument(format!("{dir:?} names no folder; give the path of one to make")));
    }
    match fs::read_dir(dir).map(|mut entries| entries.next().is_none()) {
        Ok(true) => Ok(()),
        Ok(false) => exists("is not empty"),
        Err(err) if err.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(err) if err.kind() == std::io::ErrorKind::NotADirectory => exists("is a file"),
        Err(err) => Err(Error::io("read", dir)(err)),
    }
}

/// Writes a station's files into the folder `dir`, which must not exist or be empty: all of them or, after an error, none.
pub fn write(built: &BuiltStation, dir: &Path) -> Result<(), Error> {
    check_target(dir)?;
    let parent = dir.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    fs::create_dir_all(parent).map_err(Error::io("make", parent))?;
    let partial = beside(dir);
    let written = (|| {
        for (name, bytes) in &built.files {
            let path = partial.join(name);
            let folder = path.parent().unwrap_or(&partial);
            fs::create_dir_all(folder).map_err(Error::io("make", folder))?;
            fs::write(&path, bytes).map_err(Error::io("write", &path))?;
        }
        // As every command will read it from now on.
        let station = load_station(&partial.join(STATION_FILE))?;
        SensorModel::from_toml("nominal.toml", &station.nominal_model_toml)?;
        // Takes the place of an empty folder too.
        fs::rename(&partial, dir).map_err(Error::io("write", dir))
    })();
    if written.is_err() {
        // A half-made station helps nobody.
        drop(fs::remove_dir_all(&partial));
    }
    written
}

/// A hidden name beside `dir` that nobody else uses.
fn beside(dir: &Path) -> PathBuf {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    let count = COUNTER.fetch_add(1, Ordering::Relaxed);
    let name = dir.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    dir.with_file_name(format!(".{name}.partial-{}-{count}", std::process::id()))
}

#[cfg(test)]
mod tests {
    use palpate_robot_model::new_station::NewStream;

    use super::*;

    const GRIPPER: &str =
        concat!(env!("CARGO_MANIFEST_DIR"), "/../sim/robot_model/tests/gripper/gripper.urdf");

    fn built(objects: &[&str]) -> BuiltStation {
        let robot = read_robot(Path::new(GRIPPER)).unwrap();
        let ids: Vec<String> = objects.iter().map(|&id| id.to_owned()).collect();
        let objects = read_objects(&ids).unwrap();
        let wanted = NewStation {
            id: "gripper".to_owned(),
            label: "Gripper".to_owned(),
            joint_rate_hz: 50.0,
            carrier_joints: vec!["roll".to_owned()],
            streams: vec![NewStream::pressure("gel")],
            patches: vec!["left=finger_left:2x2@20x10:-y".parse().unwrap()],
            objects: objects.paths,
            object_files: objects.files,
            plan: None,
        };
        build(&wanted, &robot.file, &robot.urdf).unwrap()
    }

    #[test]
    fn what_is_written_is_read_by_everybody() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("a/hand");
        // One of them has a mesh.
        write(&built(&["sphere_50mm", "wedge_80mm"]), &out).unwrap();
        let station = load_station(&out.join(STATION_FILE)).unwrap();
        assert_eq!(station.objects.len(), 2);
        assert_eq!((station.layout.num_channels(), station.carrier_dofs.as_slice()), (4, &[0][..]));
        SensorModel::from_toml("nominal.toml", &station.nominal_model_toml).unwrap();
        assert_eq!(fs::read_dir(dir.path().join("a")).unwrap().count(), 1, "nothing is left beside it");
    }

    #[test]
    fn an_empty_folder_is_filled_and_another_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("hand");
        fs::create_dir(&out).unwrap();
        let built = built(&["sphere_50mm"]);
        write(&built, &out).unwrap();
        let before = fs::read(out.join(STATION_FILE)).unwrap();
        let message = write(&built, &out).unwrap_err().to_string();
        assert!(message.contains("is not empty; give another folder"), "{message}");
        assert_eq!(fs::read(out.join(STATION_FILE)).unwrap(), before);
        let message = write(&built, &out.join(STATION_FILE)).unwrap_err().to_string();
        assert!(message.contains("is a file"), "{message}");
        assert!(write(&built, Path::new("/")).is_err());
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[test]
    fn meshes_are_found_by_package_and_by_path() {
        let report = read_robot(Path::new(GRIPPER)).unwrap().report;
        let sized = report.links.iter().find(|link| link.link == "finger_left").unwrap();
        assert!(sized.size_m.is_some(), "{report:?}");
        assert!(
            report.warnings[0].contains("palm.dae\" is left out: expected a file that ends in"),
            "{report:?}"
        );
        let folder = Path::new(GRIPPER).parent().unwrap();
        assert!(read_mesh(folder, "finger.obj").is_ok());
        assert!(read_mesh(folder, &format!("file://{}", folder.join("finger.obj").display())).is_ok());
        for (name, expected) in [
            ("package://elsewhere/other.stl", "put the package \"elsewhere\" there"),
            ("package://gripper/../x.stl", "leads out of its package"),
            ("missing.stl", "missing.stl"),
        ] {
            let problem = read_mesh(folder, name).unwrap_err();
            assert!(problem.contains(expected), "{name}: {problem}");
        }
    }

    #[test]
    fn unknown_objects_are_refused_with_those_there_are() {
        let refusal = |id: &str| read_objects(&[id.to_owned()]).map(drop).unwrap_err();
        assert!(refusal("sphere_5mm").to_string().contains("shipped are"), "{}", refusal("sphere_5mm"));
        assert!(chain(&refusal("nowhere/ball.toml")).contains("nowhere/ball.toml"));
        let twice = ["egg".to_owned(), "egg".to_owned()];
        assert!(read_objects(&twice).map(drop).unwrap_err().to_string().contains("given twice"));
    }
}

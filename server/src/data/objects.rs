//! Objects that the binary carries and those of the data folder, as bodies.

use std::{collections::BTreeMap, path::Path, sync::LazyLock};

use base64::Engine as _;
use palpate_control::ObjectFiles;
use palpate_recording::{
    RecordingError,
    files::{MAX_STATION_FILE_BYTES, MAX_TEXT_BYTES, read_file, resolve_in},
};
use palpate_robot_model::{ObjectGroup, ObjectModel};
use palpate_sim::body::{RestPose, Solid};
use palpate_wire::api::{ObjectDocument, ObjectEntry, ObjectTake, RestPoseDocument};

use super::{Store, library::Library};
use crate::{Error, assets, chain};

/// Those of the binary never change.
static SHIPPED: LazyLock<Vec<ObjectEntry>> = LazyLock::new(|| {
    let files = assets::object_files();
    files.map(|(name, text)| entry(name, text.to_vec(), false, shipped_mesh)).collect()
});

/// A mesh that the file of a shipped object names.
pub(super) fn shipped_mesh(name: &str) -> Result<Vec<u8>, String> {
    assets::object_mesh(name).map(<[u8]>::to_vec).ok_or_else(|| "it is not shipped".to_owned())
}

/// Ids of the shipped objects, which their files are called by.
pub(super) fn shipped_ids() -> Vec<&'static str> {
    assets::object_files().filter_map(|(name, _)| name.strip_suffix(".toml")).collect()
}

/// The file of the shipped object called `id`.
pub(super) fn shipped_text(id: &str) -> Option<&'static [u8]> {
    assets::object_files().find(|(name, _)| name.strip_suffix(".toml") == Some(id)).map(|(_, text)| text)
}

/// The files of the object called `id`: one's own, or else the binary's.
pub(crate) fn files(store: &Store, id: &str) -> Result<ObjectFiles, Error> {
    let own = own(store)?.into_iter().find(|object| object.id == id);
    if let (None, Some(text)) = (&own, shipped_text(id)) {
        return shipped_files(id, text);
    }
    let content = own.map(|object| object.content).ok_or_else(|| {
        let advice = "the screen Objects lists those that there are";
        Error::Argument(format!(
            "there is no object {id:?}, neither of the station nor of this studio; {advice}"
        ))
    })?;
    let document =
        content.map_err(|problem| Error::Argument(format!("object {id:?} cannot be used: {problem}")))?;
    let meshes = document.meshes_base64.into_iter().map(|(name, base64)| {
        let bytes = base64::engine::general_purpose::STANDARD.decode(base64);
        bytes.map(|bytes| (name, bytes)).map_err(|error| Error::Content(format!("object {id:?}: {error}")))
    });
    Ok(ObjectFiles { text: document.object_toml, meshes: meshes.collect::<Result<_, _>>()? })
}

/// The files of a shipped object, whose body is not computed for that.
fn shipped_files(id: &str, text: &[u8]) -> Result<ObjectFiles, Error> {
    let text = String::from_utf8_lossy(text).into_owned();
    let mut meshes = BTreeMap::new();
    ObjectModel::from_toml(id, &text, |mesh| {
        let bytes = shipped_mesh(mesh)?;
        meshes.insert(mesh.to_owned(), bytes.clone());
        Ok(bytes)
    })
    .map_err(|error| Error::Content(error.to_string()))?;
    Ok(ObjectFiles { text, meshes })
}

/// Those of the data folder.
fn own(store: &Store) -> Result<Vec<ObjectEntry>, Error> {
    let files = store.object_files()?.into_iter();
    let read = files.map(|(name, path)| {
        let folder = path.parent().map(ToOwned::to_owned).unwrap_or_default();
        let read_mesh = |mesh: &str| read_own(&folder, &folder.join(mesh), MAX_STATION_FILE_BYTES);
        match read_own(&folder, &path, MAX_TEXT_BYTES) {
            Ok(text) => entry(&name, text, true, read_mesh),
            Err(problem) => unusable(&name, true, format!("{name}: {problem}")),
        }
    });
    Ok(read.collect())
}

/// All objects, the binary's first, each with the takes that touched it. One that cannot be used says why.
pub(crate) fn list(store: &Store, library: &Library) -> Result<Vec<ObjectEntry>, Error> {
    let mut objects = SHIPPED.clone();
    for own in own(store)? {
        // One's own replaces the binary's of the same id.
        objects.retain(|object| object.own || object.id != own.id);
        objects.push(own);
    }
    let mut takes = takes_by_object(store, library)?;
    for object in &mut objects {
        object.takes = takes.remove(&object.id).unwrap_or_default();
    }
    Ok(objects)
}

/// Reads a file of one's own objects: a regular one that lies in their `folder`, links followed.
fn read_own(folder: &Path, path: &Path, max_bytes: u64) -> Result<Vec<u8>, String> {
    let read = resolve_in(folder, path).and_then(|_| read_file(path, max_bytes));
    read.map_err(|err| match err {
        // The file is named by who asks, as its object names it.
        RecordingError::Content { problem, .. } => problem,
        RecordingError::Io { source, .. } => source.to_string(),
        other => chain(&other),
    })
}

fn takes_by_object(store: &Store, library: &Library) -> Result<BTreeMap<String, Vec<ObjectTake>>, Error> {
    let mut takes: BTreeMap<String, Vec<ObjectTake>> = BTreeMap::new();
    for session in store.sessions()? {
        // What cannot be opened is listed with its error on the screen of sessions.
        let Ok(detail) = store.session(&session).and_then(|opened| library.detail(&opened)) else {
            continue;
        };
        for take in detail.takes {
            let used = ObjectTake { session: session.clone(), take: take.id };
            takes.entry(take.object).or_default().push(used);
        }
    }
    Ok(takes)
}

fn entry(
    file: &str,
    text: Vec<u8>,
    own: bool,
    read_mesh: impl Fn(&str) -> Result<Vec<u8>, String>,
) -> ObjectEntry {
    match document(file, text, read_mesh) {
        Ok((id, document)) => ObjectEntry { id, own, content: Ok(document), takes: Vec::new() },
        Err(problem) => unusable(file, own, problem),
    }
}

fn unusable(file: &str, own: bool, problem: String) -> ObjectEntry {
    let id = file.strip_suffix(".toml").unwrap_or(file).to_owned();
    ObjectEntry { id, own, content: Err(problem), takes: Vec::new() }
}

fn document(
    file: &str,
    text: Vec<u8>,
    read_mesh: impl Fn(&str) -> Result<Vec<u8>, String>,
) -> Result<(String, ObjectDocument), String> {
    let text = String::from_utf8(text).map_err(|_| format!("{file}: not UTF-8, expected a text file"))?;
    let mut meshes_base64 = BTreeMap::new();
    let object = ObjectModel::from_toml(file, &text, |mesh| {
        let bytes = read_mesh(mesh)?;
        meshes_base64.insert(mesh.to_owned(), base64::engine::general_purpose::STANDARD.encode(&bytes));
        Ok(bytes)
    })
    .map_err(|err| err.to_string())?;
    let in_file = |problem: String| format!("{file}: object {:?}: {problem}", object.id);
    let solid = Solid::new(&object.shape).map_err(in_file)?;
    let rest_poses = solid.rest_poses().map_err(in_file)?;
    let document = ObjectDocument {
        label: object.label,
        group: object.group.map(ObjectGroup::as_str).map(str::to_owned),
        size_m: solid.size_m(),
        volume_m3: solid.volume_m3(),
        mass_kg: object.density_kg_m3.map(|density| solid.mass_properties(density).mass_kg),
        com_m: solid.centroid_in_object().coords.into(),
        rest_poses: rest_poses.iter().map(rest_pose).collect(),
        object_toml: text,
        meshes_base64,
    };
    Ok((object.id, document))
}

fn rest_pose(pose: &RestPose) -> RestPoseDocument {
    let rotation = pose.table_from_object;
    RestPoseDocument {
        quaternion_wxyz: [rotation.w, rotation.i, rotation.j, rotation.k],
        origin_height_m: pose.origin_height_m,
        com_height_m: pose.com_height_m,
        weight: pose.weight,
        barrier_m: pose.barrier_m,
    }
}

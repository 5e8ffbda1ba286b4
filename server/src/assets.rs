//! The robots, layouts, stations and truths that the binary carries, so that it works anywhere.

use std::{
    fs,
    path::{Path, PathBuf},
};

use palpate_recording::import::{self, Mapping};
use palpate_robot_model::Station;
use palpate_wire::api::PublishedResult;
use tempfile::TempDir;

use crate::Error;

/// Sorted by path relative to `assets/`.
static FILES: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/assets.rs"));

/// Of several shipped stations that recordings fit, they belong to this one, unless somebody says otherwise.
const USUAL_STATION: &str = "xarm6-leap";

/// Ids of the shipped stations.
pub fn station_ids() -> Vec<String> {
    station_files().map(|(id, _)| id).collect()
}

/// The shipped station called `id`.
pub fn station(id: &str) -> Result<Station, Error> {
    let Some((_, path)) = station_files().find(|(station_id, _)| station_id == id) else {
        return Err(Error::Argument(format!(
            "no station {id:?}; shipped are {}; or give the path of a station file",
            station_ids().join(", ")
        )));
    };
    let (folder, file_name) = path.rsplit_once('/').unwrap_or(("", path));
    let station = Station::read(file_name, |name| {
        read(&normalise(folder, name)).map(<[u8]>::to_vec).ok_or_else(|| "it is not shipped".to_owned())
    })?;
    Ok(station)
}

/// The shipped station that the recordings in `csv_dir` were made on, and why it is that one: it knows the objects of
/// the takes, and the files of the first take hold its joints and channels. Of several that fit it is the usual one if
/// that is among them, and the reason names the others.
///
/// Where none fits, the error says why of each; where several other ones do, it lists them.
pub fn station_of_recordings(csv_dir: &Path, mapping: Option<&Mapping>) -> Result<(Station, String), Error> {
    let (mut fitting, mut others) = (Vec::new(), Vec::new());
    for id in station_ids() {
        let station = station(&id)?;
        match import::fits(&station, csv_dir, mapping) {
            Ok(()) => fitting.push(station),
            Err(err) => others.push(format!("{id} does not: {}", crate::chain(&err))),
        }
    }
    let what_to_do =
        "name the station that recorded them: --station FILE or ID, or `station` in the mapping file";
    match fitting.len() {
        1 => {
            let station = fitting.remove(0);
            let streams: Vec<&str> = station.layout.streams.iter().map(|stream| stream.id.as_str()).collect();
            let because = format!(
                "the only shipped station that the recordings fit: streams {}, {} joints, and the objects of the takes; say \
                 --station if it is another",
                streams.join(", "),
                station.robot.num_dofs()
            );
            Ok((station, because))
        }
        0 => Err(Error::Content(format!(
            "no shipped station fits the recordings; {what_to_do}. {}",
            others.join("; ")
        ))),
        _ => {
            let ids = fitting.iter().map(|station| station.id.as_str()).collect::<Vec<_>>().join(", ");
            let usual = fitting.into_iter().find(|station| station.id == USUAL_STATION).ok_or_else(|| {
                Error::Content(format!("the recordings fit several stations, {ids}; {what_to_do}"))
            })?;
            let because = format!(
                "the usual one of the shipped stations that the recordings fit, {ids}; say --station if it is another"
            );
            Ok((usual, because))
        }
    }
}

/// Published results that campaigns are shown beside.
pub fn published_results() -> Result<Vec<PublishedResult>, Error> {
    let path = "trials/published.json";
    let text = read(path).ok_or_else(|| Error::Internal(format!("{path} is not shipped")))?;
    serde_json::from_slice(text).map_err(|err| Error::Internal(format!("{path}: {err}")))
}

/// Writes all of it to a folder that goes when the result is dropped.
pub fn unpack() -> Result<TempDir, Error> {
    let dir = tempfile::tempdir().map_err(Error::io("make", std::env::temp_dir()))?;
    unpack_to(dir.path())?;
    Ok(dir)
}

/// Writes all of it to the folder `dir`.
pub(crate) fn unpack_to(dir: &Path) -> Result<(), Error> {
    for (name, bytes) in FILES {
        let path = dir.join(name);
        let folder = path.parent().unwrap_or(dir);
        fs::create_dir_all(folder).map_err(Error::io("make", folder))?;
        fs::write(&path, bytes).map_err(Error::io("write", &path))?;
    }
    Ok(())
}

/// The text of a shipped file by its path relative to `assets/`.
pub(crate) fn text(path: &str) -> Option<&'static str> {
    std::str::from_utf8(read(path)?).ok()
}

/// Names, without `extension`, of what is shipped in `folder`; sorted.
pub(crate) fn names_in(folder: &str, extension: &str) -> Vec<&'static str> {
    let name = |path: &'static str| path.strip_prefix(folder)?.strip_prefix('/')?.strip_suffix(extension);
    FILES.iter().filter_map(|(path, _)| name(path)).filter(|name| !name.contains('/')).collect()
}

/// A truth file by path, or a shipped one by name (`demo`); the folder must outlive its use.
pub fn truth(path_or_name: &Path) -> Result<(PathBuf, Option<TempDir>), Error> {
    let shipped = path_or_name.to_str().map(|name| format!("truth/{name}.toml"));
    match shipped.filter(|shipped| !path_or_name.exists() && read(shipped).is_some()) {
        Some(shipped) => {
            let dir = unpack()?;
            Ok((dir.path().join(shipped), Some(dir)))
        }
        None => Ok((path_or_name.to_owned(), None)),
    }
}

/// `(station id, path)` of every shipped station file.
fn station_files() -> impl Iterator<Item = (String, &'static str)> {
    FILES.iter().filter_map(|(path, bytes)| {
        if !path.starts_with("stations/") || !path.ends_with(".toml") {
            return None;
        }
        let table: toml::Table = toml::from_str(std::str::from_utf8(bytes).ok()?).ok()?;
        Some((table.get("id")?.as_str()?.to_owned(), *path))
    })
}

/// `(file name, text)` of every shipped object file.
pub(crate) fn object_files() -> impl Iterator<Item = (&'static str, &'static [u8])> {
    FILES.iter().filter_map(|(path, bytes)| {
        let name = path.strip_prefix("objects/")?;
        (name.ends_with(".toml") && !name.contains('/')).then_some((name, *bytes))
    })
}

/// A mesh that a shipped object file names.
pub(crate) fn object_mesh(name: &str) -> Option<&'static [u8]> {
    read(&normalise("objects", name))
}

fn read(path: &str) -> Option<&'static [u8]> {
    FILES.binary_search_by_key(&path, |(name, _)| name).ok().map(|idx| FILES[idx].1)
}

/// `folder/name` without `.` and `..`.
fn normalise(folder: &str, name: &str) -> String {
    let mut parts: Vec<&str> = Vec::new();
    for part in folder.split('/').chain(name.split('/')) {
        match part {
            "" | "." => {}
            ".." => {
                parts.pop();
            }
            part => parts.push(part),
        }
    }
    parts.join("/")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_station_can_be_used() {
        let ids = station_ids();
        assert!(ids.len() >= 2 && ids.iter().any(|id| id == USUAL_STATION), "{ids:?}");
        for id in ids {
            let station = station(&id).unwrap();
            assert_eq!(station.id, id);
            assert!(station.layout.num_channels() > 0);
        }
    }

    #[test]
    fn unknown_station_names_the_shipped_ones() {
        let message = station("xarm7").unwrap_err().to_string();
        assert!(message.contains("xarm7") && message.contains(USUAL_STATION), "{message}");
    }

    #[test]
    fn shipped_truth_is_found_by_name() {
        let (path, dir) = truth(Path::new("demo")).unwrap();
        assert!(dir.is_some() && path.is_file(), "{path:?}");
        let (path, dir) = truth(Path::new("nowhere/demo.toml")).unwrap();
        assert!(dir.is_none() && path == Path::new("nowhere/demo.toml"));
    }

    #[test]
    fn paths_are_resolved_within_the_assets() {
        assert_eq!(normalise("stations", "../robots/./x.urdf"), "robots/x.urdf");
        assert_eq!(normalise("", "a/b"), "a/b");
    }
}

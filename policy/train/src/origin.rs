//! Files that trials were made from, as a record of them lists these, and whether they are still the same.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use palpate_grasp::GraspConfig;
use palpate_robot_model::{ObjectModel, Station};

use crate::files::{Source, sha256, shown};

/// What some trials were made from.
pub(crate) struct Origin<'a> {
    /// What was made, as sentences name it: "demonstrations" or "trials".
    pub(crate) what: &'static str,
    /// The file or folder that holds it.
    pub(crate) place: &'a Path,
    /// Every file that was read.
    pub(crate) sources: &'a [Source],
}

impl Origin<'_> {
    /// The bytes of the file at `path`, if it is the one that was read. `roles` says for what.
    fn source(&self, roles: &[&str], path: &Path) -> Result<Vec<u8>, String> {
        let Self { what, place, sources } = self;
        let name = shown(path);
        let is_it = |source: &&Source| roles.contains(&source.role.as_str()) && source.path == name;
        let source = sources.iter().find(is_it);
        let source = source.ok_or_else(|| format!("the {what} in {place:?} did not use it"))?;
        let bytes = std::fs::read(path)
            .map_err(|err| format!("{err}; paths are relative to the folder that the command runs in"))?;
        if sha256(&bytes) != source.sha256 {
            return Err(format!(
                "it is another file than when the {what} in {place:?} were made: SHA-256 {}, not {}",
                sha256(&bytes),
                source.sha256
            ));
        }
        Ok(bytes)
    }

    fn text(&self, role: &str, path: &Path) -> anyhow::Result<String> {
        let bytes = self.source(&[role], path).map_err(|problem| anyhow::anyhow!("{path:?}: {problem}"))?;
        String::from_utf8(bytes).with_context(|| format!("{path:?} is no text"))
    }

    /// The file that was read first for `role`.
    fn first(&self, role: &str) -> anyhow::Result<PathBuf> {
        let source = self.sources.iter().find(|source| source.role == role);
        let source = source.with_context(|| format!("{:?}: its record names no {role}", self.place))?;
        Ok(PathBuf::from(&source.path))
    }

    pub(crate) fn station(&self) -> anyhow::Result<Station> {
        let path = self.first("station")?;
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        let name = path.file_name().and_then(|name| name.to_str()).context("the station is no file")?;
        Ok(Station::read(name, |name| self.source(&["station"], &folder.join(name)))?)
    }

    /// The grasp world of `station`, as its file has it.
    pub(crate) fn world(&self, station: &Station) -> anyhow::Result<GraspConfig> {
        let path = self.first("world")?;
        Ok(GraspConfig::from_toml(&shown(&path), &self.text("world", &path)?, &station.robot)?)
    }

    pub(crate) fn object(&self) -> anyhow::Result<ObjectModel> {
        let path = self.first("object")?;
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        let read_mesh = |mesh: &str| self.source(&["object"], &folder.join(mesh));
        Ok(ObjectModel::from_toml(&shown(&path), &self.text("object", &path)?, read_mesh)?)
    }

    /// Digests of the files that were read for `roles`.
    pub(crate) fn digests(&self, roles: &[&str]) -> Vec<&str> {
        let of_role = |source: &&Source| roles.contains(&source.role.as_str());
        self.sources.iter().filter(of_role).map(|source| source.sha256.as_str()).collect()
    }
}

/// Whether all `origins` are of one station in one grasp world.
///
/// # Errors
/// The first that is of another, by name.
pub(crate) fn check_same_world<'a>(
    origins: impl IntoIterator<Item = Origin<'a>> + Clone,
) -> anyhow::Result<()> {
    for (role, what) in [("station", "station"), ("world", "grasp world")] {
        let mut origins = origins.clone().into_iter();
        let Some(first) = origins.next() else { return Ok(()) };
        let expected = first.digests(&[role]);
        if let Some(other) = origins.find(|origin| origin.digests(&[role]) != expected) {
            bail!("{:?} and {:?} were made with different files of the {what}", first.place, other.place);
        }
    }
    Ok(())
}

//! Folders of demonstrations, verified, and the files that they were made from.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use palpate_grasp::GraspConfig;
use palpate_robot_model::{ObjectModel, Station};

use crate::demos::manifest::Manifest;
use crate::demos::shard::{self, Columns};
use crate::files::{Source, sha256, shown};

/// What was felt and what was there, step by step.
pub(crate) struct Demonstration {
    /// Index in [`Demonstrations::objects`].
    pub(crate) object: usize,
    /// Seed of its folder, and number of its trial.
    pub(crate) seed: u64,
    pub(crate) trial: u64,
    /// What encoders said, `[steps, joints]`.
    pub(crate) read_joints: Vec<f32>,
    /// What the joints were, `[steps, joints]`.
    pub(crate) exact_joints: Vec<f32>,
    /// Which channels were active, `[steps, channels]`.
    pub(crate) touch: Vec<bool>,
    /// base_from_object, `[steps, 7]`: x, y, z, then the quaternion, w first.
    pub(crate) object_poses: Vec<f32>,
}

/// All folders together, in an order that does not depend on theirs.
pub(crate) struct Demonstrations {
    pub(crate) station: Station,
    /// The link from which on links touch things.
    pub(crate) hand_root: usize,
    pub(crate) objects: Vec<ObjectModel>,
    pub(crate) demonstrations: Vec<Demonstration>,
    /// What each folder holds, by name, with a digest of it.
    pub(crate) sources: BTreeMap<String, String>,
}

/// A folder whose files are yet to be read.
struct Folder<'a> {
    path: &'a Path,
    manifest: Manifest,
}

impl Folder<'_> {
    /// The bytes of the file at `path`, if it is the one that the demonstrations were made with. `roles` says for what.
    fn source(&self, roles: &[&str], path: &Path) -> Result<Vec<u8>, String> {
        let name = shown(path);
        let is_it = |source: &&Source| roles.contains(&source.role.as_str()) && source.path == name;
        let source = self.manifest.sources.iter().find(is_it);
        let source = source.ok_or_else(|| format!("the demonstrations in {:?} did not use it", self.path))?;
        let bytes = std::fs::read(path)
            .map_err(|err| format!("{err}; paths are relative to the folder that the command runs in"))?;
        if sha256(&bytes) != source.sha256 {
            return Err(format!(
                "it is another file than when the demonstrations in {:?} were made: SHA-256 {}, not {}",
                self.path,
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
        let source = self.manifest.sources.iter().find(|source| source.role == role);
        let source = source.with_context(|| format!("{:?}: its manifest names no {role}", self.path))?;
        Ok(PathBuf::from(&source.path))
    }

    fn station(&self) -> anyhow::Result<Station> {
        let path = self.first("station")?;
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        let name = path.file_name().and_then(|name| name.to_str()).context("the station is no file")?;
        Ok(Station::read(name, |name| self.source(&["station"], &folder.join(name)))?)
    }

    fn hand_root(&self, station: &Station) -> anyhow::Result<usize> {
        let path = self.first("world")?;
        let config = GraspConfig::from_toml(&shown(&path), &self.text("world", &path)?, &station.robot)?;
        station.robot.link_index(&config.hand_root).context("the world's hand_root is a link")
    }

    fn object(&self) -> anyhow::Result<ObjectModel> {
        let path = self.first("object")?;
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        let read_mesh = |mesh: &str| self.source(&["object"], &folder.join(mesh));
        Ok(ObjectModel::from_toml(&shown(&path), &self.text("object", &path)?, read_mesh)?)
    }

    /// Digests of the files that were read for `roles`.
    fn digests(&self, roles: &[&str]) -> Vec<&str> {
        let of_role = |source: &&Source| roles.contains(&source.role.as_str());
        self.manifest.sources.iter().filter(of_role).map(|source| source.sha256.as_str()).collect()
    }

    /// The demonstrations, of the object numbered `object`.
    fn read(&self, object: usize, station: &Station) -> anyhow::Result<Vec<Demonstration>> {
        let columns = Columns::of_tensors(self.manifest.tensors.clone())
            .with_context(|| format!("{:?}: its manifest does not fit", self.path))?;
        let joints: Vec<String> = station.robot.dofs().map(|joint| joint.name.clone()).collect();
        let channels: Vec<String> =
            station.layout.channels.iter().map(|channel| channel.id.clone()).collect();
        let named = |tensor: &'static str, segment: &str, expected: &[String]| {
            let segment = columns.segment(tensor, segment).with_context(|| format!("{:?}", self.path))?;
            if segment.columns() != expected {
                bail!(
                    "{:?}: columns of {tensor} are {:?}, those of the station {expected:?}",
                    self.path,
                    segment.columns()
                );
            }
            Ok(segment)
        };
        let pose = ["x", "y", "z", "qw", "qx", "qy", "qz"].map(str::to_owned);
        let read_joints = named("actor_observations", "joint_positions", &joints)?;
        let exact_joints = named("privileged", "exact_joint_positions", &joints)?;
        let touch = named("touch", "touch", &channels)?;
        let poses = named("object_poses", "object_poses", &pose)?;
        let mut demonstrations = Vec::new();
        for file in &self.manifest.files {
            let bytes = file.read(self.path)?;
            let stored = shard::decode(&columns, &bytes)
                .with_context(|| format!("{:?}", self.path.join(&file.file)))?;
            demonstrations.extend(stored.iter().map(|stored| Demonstration {
                object,
                seed: self.manifest.settings.seed,
                trial: stored.trial,
                read_joints: read_joints.of(stored),
                exact_joints: exact_joints.of(stored),
                touch: touch.of(stored).into_iter().map(|active| active > 0.0).collect(),
                object_poses: poses.of(stored),
            }));
        }
        Ok(demonstrations)
    }
}

impl Demonstration {
    pub(crate) fn num_steps(&self) -> usize {
        self.object_poses.len() / 7
    }
}

/// Reads all `folders`.
///
/// # Errors
/// Files that were altered or cut off, or made with others than are there now or in the other folders, by name.
pub(crate) fn read(folders: &[PathBuf]) -> anyhow::Result<Demonstrations> {
    let mut opened = Vec::new();
    for path in folders {
        opened.push(Folder { path, manifest: Manifest::read(path)? });
    }
    let key = |folder: &Folder| (folder.manifest.settings.object.clone(), folder.manifest.settings.seed);
    opened.sort_by_key(key);
    if let Some(pair) = opened.windows(2).find(|pair| key(&pair[0]) == key(&pair[1])) {
        let (object, seed) = key(&pair[0]);
        bail!(
            "{:?} and {:?} both hold demonstrations of {object:?} with the seed {seed}; leave one out",
            pair[0].path,
            pair[1].path
        );
    }
    let first = opened.first().context("--demos names no folder")?;
    for (roles, what) in [(["station"], "station"), (["world"], "grasp world")] {
        let expected = first.digests(&roles);
        if let Some(other) = opened.iter().find(|folder| folder.digests(&roles) != expected) {
            bail!("{:?} and {:?} were made with different files of the {what}", first.path, other.path);
        }
    }
    let station = first.station()?;
    let hand_root = first.hand_root(&station)?;
    let (mut objects, mut demonstrations): (Vec<ObjectModel>, Vec<Demonstration>) = (Vec::new(), Vec::new());
    let mut sources = BTreeMap::new();
    for folder in &opened {
        let object = folder.object()?;
        let idx = match objects.iter().position(|known| known.id == object.id) {
            Some(idx) => idx,
            None => {
                objects.push(object);
                objects.len() - 1
            }
        };
        let mut of_folder = folder.read(idx, &station)?;
        of_folder.sort_by_key(|one| one.trial);
        demonstrations.extend(of_folder);
        let files = folder.manifest.files.iter().map(|file| file.sha256.as_str());
        let digests: Vec<&str> =
            folder.digests(&["station", "world", "object"]).into_iter().chain(files).collect();
        let (object, seed) = key(folder);
        sources.insert(format!("{object}, seed {seed}"), sha256(digests.concat().as_bytes()));
    }
    Ok(Demonstrations { station, hand_root, objects, demonstrations, sources })
}

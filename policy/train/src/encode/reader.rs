//! Folders of demonstrations and of trials of an expert, verified, and the files that they were made from.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::slice;

use anyhow::{Context as _, bail};
use palpate_robot_model::{ObjectModel, Station};

use crate::demos::manifest::{MANIFEST_FILE, Manifest};
use crate::demos::shard::{self, Columns};
use crate::files::sha256;
use crate::gather::{self, Gathered};
use crate::origin::{Origin, check_same_world};

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

/// Demonstrations that are yet to be made of what was read.
enum Kept<'a> {
    /// A folder of `palpate-train demos`, whose files are yet to be read.
    Demos { path: &'a Path, manifest: Box<Manifest> },
    /// A file of `palpate-train gather`.
    Trials { path: PathBuf, gathered: Box<Gathered> },
}

impl Kept<'_> {
    fn origin(&self) -> Origin<'_> {
        match self {
            Self::Demos { path, manifest } => {
                Origin { what: "demonstrations", place: path, sources: &manifest.sources }
            }
            Self::Trials { path, gathered } => {
                Origin { what: "trials", place: path, sources: gathered.record.sources() }
            }
        }
    }

    /// Object, seed and, of trials, protocol: what tells these from others.
    fn key(&self) -> (&str, u64, Option<&str>) {
        match self {
            Self::Demos { manifest, .. } => (&manifest.settings.object, manifest.settings.seed, None),
            Self::Trials { gathered, .. } => gathered.record.key(),
        }
    }

    fn name(&self) -> String {
        let (object, seed, protocol) = self.key();
        match protocol {
            None => format!("{object}, seed {seed}"),
            Some(protocol) => format!("trials on {object}, protocol {protocol}, seed {seed}"),
        }
    }

    /// Of everything that was read.
    fn digest(&self) -> String {
        let origin = self.origin();
        let made_from = origin.digests(&["station", "world", "object"]).into_iter();
        let digests: Vec<&str> = match self {
            Self::Demos { manifest, .. } => {
                made_from.chain(manifest.files.iter().map(|file| file.sha256.as_str())).collect()
            }
            Self::Trials { gathered, .. } => made_from.chain([gathered.sha256.as_str()]).collect(),
        };
        sha256(digests.concat().as_bytes())
    }

    /// The demonstrations, of the object numbered `object`, in the order of their trials.
    fn demonstrations(&self, object: usize, station: &Station) -> anyhow::Result<Vec<Demonstration>> {
        match self {
            Self::Demos { path, manifest } => of_demos(path, manifest, object, station),
            Self::Trials { path, gathered } => of_trials(path, gathered, object, station),
        }
    }
}

/// Names of the joints and of the channels of `station`.
fn names(station: &Station) -> [Vec<String>; 2] {
    [
        station.robot.dofs().map(|joint| joint.name.clone()).collect(),
        station.layout.channels.iter().map(|channel| channel.id.clone()).collect(),
    ]
}

fn of_demos(
    path: &Path,
    manifest: &Manifest,
    object: usize,
    station: &Station,
) -> anyhow::Result<Vec<Demonstration>> {
    let columns = Columns::of_tensors(manifest.tensors.clone())
        .with_context(|| format!("{path:?}: its manifest does not fit"))?;
    let [joints, channels] = names(station);
    let named = |tensor: &'static str, segment: &str, expected: &[String]| {
        let segment = columns.segment(tensor, segment).with_context(|| format!("{path:?}"))?;
        if segment.columns() != expected {
            bail!(
                "{path:?}: columns of {tensor} are {:?}, those of the station {expected:?}",
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
    for file in &manifest.files {
        let bytes = file.read(path)?;
        let stored =
            shard::decode(&columns, &bytes).with_context(|| format!("{:?}", path.join(&file.file)))?;
        demonstrations.extend(stored.iter().map(|stored| Demonstration {
            object,
            seed: manifest.settings.seed,
            trial: stored.trial,
            read_joints: read_joints.of(stored),
            exact_joints: exact_joints.of(stored),
            touch: touch.of(stored).into_iter().map(|active| active > 0.0).collect(),
            object_poses: poses.of(stored),
        }));
    }
    demonstrations.sort_by_key(|one| one.trial);
    Ok(demonstrations)
}

fn of_trials(
    path: &Path,
    gathered: &Gathered,
    object: usize,
    station: &Station,
) -> anyhow::Result<Vec<Demonstration>> {
    let robot = gathered.record.robot();
    let [joints, channels] = names(station);
    if robot.joints != joints || robot.channels != channels {
        bail!("{path:?}: its joints or channels are not those of the station that it names");
    }
    if !gathered.has_poses {
        bail!(
            "{path:?} does not say where the object was, as files of earlier versions do not; gather these trials again, \
             into another folder"
        );
    }
    let (_, seed, _) = gathered.record.key();
    let demonstration = |(trial, one): (u64, &gather::Trial)| {
        // Nothing is between the joints and what is read of them there.
        let mut read_joints = Vec::with_capacity(one.episode.len() * joints.len());
        let mut touch = Vec::with_capacity(one.episode.len() * channels.len());
        for frame in one.episode.frames.chunks_exact(robot.shape().frame_len()) {
            let (commands, rest) = frame.split_at(joints.len());
            let (errors, active) = rest.split_at(joints.len());
            read_joints.extend(commands.iter().zip(errors).map(|(command, error)| command - error));
            touch.extend(active.iter().map(|&active| active > 0.0));
        }
        Demonstration {
            object,
            seed,
            trial,
            exact_joints: read_joints.clone(),
            read_joints,
            touch,
            object_poses: one.object_poses.clone(),
        }
    };
    Ok((0..).zip(&gathered.trials).map(demonstration).collect())
}

impl Demonstration {
    pub(crate) fn num_steps(&self) -> usize {
        self.object_poses.len() / 7
    }
}

/// What is in `folder`.
fn open(folder: &Path) -> anyhow::Result<Vec<Kept<'_>>> {
    if folder.join(MANIFEST_FILE).is_file() || !gather::is_folder(folder) {
        let manifest = Box::new(Manifest::read(folder)?);
        return Ok(vec![Kept::Demos { path: folder, manifest }]);
    }
    let trials = gather::read_all(slice::from_ref(&folder.to_owned()))?;
    let kept = |(path, gathered): (String, Gathered)| Kept::Trials {
        path: PathBuf::from(path),
        gathered: Box::new(gathered),
    };
    Ok(trials.into_iter().map(kept).collect())
}

/// Reads all `folders`.
///
/// # Errors
/// Files that were altered or cut off, or made with others than are there now or in the other folders, by name.
pub(crate) fn read(folders: &[PathBuf]) -> anyhow::Result<Demonstrations> {
    let mut opened = Vec::new();
    for path in folders {
        opened.extend(open(path)?);
    }
    opened.sort_by(|one, other| one.key().cmp(&other.key()));
    if let Some(pair) = opened.windows(2).find(|pair| pair[0].key() == pair[1].key()) {
        let [first, second] = [&pair[0], &pair[1]].map(|kept| kept.origin().place);
        let held = match pair[0].key() {
            (object, seed, None) => format!("demonstrations of {object:?} with the seed {seed}"),
            (_, _, Some(_)) => pair[0].name(),
        };
        bail!("{first:?} and {second:?} both hold {held}; leave one out");
    }
    let first = opened.first().context("--demos names no folder")?.origin();
    check_same_world(opened.iter().map(Kept::origin))?;
    let station = first.station()?;
    let world = first.world(&station)?;
    let hand_root = station.robot.link_index(&world.hand_root).context("the world's hand_root is a link")?;
    let (mut objects, mut demonstrations): (Vec<ObjectModel>, Vec<Demonstration>) = (Vec::new(), Vec::new());
    let mut sources = BTreeMap::new();
    for kept in &opened {
        let object = kept.origin().object()?;
        let idx = match objects.iter().position(|known| known.id == object.id) {
            Some(idx) => idx,
            None => {
                objects.push(object);
                objects.len() - 1
            }
        };
        demonstrations.extend(kept.demonstrations(idx, &station)?);
        sources.insert(kept.name(), kept.digest());
    }
    Ok(Demonstrations { station, hand_root, objects, demonstrations, sources })
}

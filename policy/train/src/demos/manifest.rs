//! What a folder of demonstrations says of itself.

use std::path::Path;

use anyhow::{Context as _, bail};
use palpate_grasp::trial::Score;
use serde::{Deserialize, Serialize};

use super::shard::{Columns, Tensor};
use crate::files::{Source, sha256};

pub(crate) const MANIFEST_FILE: &str = "manifest.json";
/// Version of the files; another one is refused.
const FORMAT: u32 = 1;

/// What makes demonstrations what they are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Settings {
    pub(crate) object: String,
    pub(crate) seed: u64,
    pub(crate) count: u64,
    pub(crate) shard_demos: u64,
    pub(crate) start_half_width_m: f64,
    pub(crate) control_rate_hz: f64,
    pub(crate) with_script: bool,
}

/// A file of demonstrations, and the trials that it took.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ShardFile {
    pub(crate) file: String,
    pub(crate) sha256: String,
    pub(crate) bytes: u64,
    pub(crate) demonstrations: u64,
    pub(crate) steps: u64,
    pub(crate) trials: Score,
}

impl ShardFile {
    /// The file in `folder`, refused if it is not the one that was written.
    pub(crate) fn read(&self, folder: &Path) -> anyhow::Result<Vec<u8>> {
        let path = folder.join(&self.file);
        let bytes = std::fs::read(&path).with_context(|| format!("failed to read {path:?}"))?;
        if sha256(&bytes) != self.sha256 {
            bail!(
                "{path:?} does not match the SHA-256 in {MANIFEST_FILE}: it was altered or cut off; delete the \
                 folder and make the demonstrations again"
            );
        }
        Ok(bytes)
    }
}

/// The manifest.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Manifest {
    format: u32,
    pub(crate) settings: Settings,
    /// Trials of all files together.
    pub(crate) trials: Score,
    pub(crate) tensors: Vec<Tensor>,
    pub(crate) sources: Vec<Source>,
    pub(crate) files: Vec<ShardFile>,
}

impl Manifest {
    pub(crate) fn new(settings: Settings, sources: Vec<Source>, columns: &Columns) -> Self {
        let tensors = columns.tensors().to_vec();
        Self { format: FORMAT, settings, trials: Score::of(&[]), tensors, sources, files: Vec::new() }
    }

    pub(crate) fn num_demos(&self) -> u64 {
        self.files.iter().map(|file| file.demonstrations).sum()
    }

    pub(crate) fn num_trials(&self) -> u64 {
        self.trials.trials as u64
    }

    pub(crate) fn add(&mut self, file: ShardFile) {
        // Intervals are computed again, because one that was read may have lost its last bit.
        let trials = Score::default().and(&file.trials);
        self.trials = self.trials.and(&trials);
        self.files.push(ShardFile { trials, ..file });
    }

    /// The manifest of `folder`. Files are not looked at ([`ShardFile::read`]).
    pub(crate) fn read(folder: &Path) -> anyhow::Result<Self> {
        let path = folder.join(MANIFEST_FILE);
        let text = std::fs::read_to_string(&path).with_context(|| format!("failed to read {path:?}"))?;
        let found: Self = serde_json::from_str(&text).with_context(|| format!("{path:?} is no manifest"))?;
        if found.format != FORMAT {
            bail!("{path:?}: format is {}, expected {FORMAT}", found.format);
        }
        Ok(found)
    }

    /// Takes over the files that `folder` has. Refuses other demonstrations, and files that were altered, by name.
    pub(crate) fn resume(&mut self, folder: &Path) -> anyhow::Result<()> {
        let path = folder.join(MANIFEST_FILE);
        let found = Self::read(folder)?;
        // Read as well, so that numbers lose the same bits.
        let wanted: Self = serde_json::from_str(&self.to_json()?)?;
        let [old, new] = [&found.settings, &wanted.settings].map(|settings| {
            serde_json::to_value(settings).unwrap_or_default().as_object().cloned().unwrap_or_default()
        });
        if let Some((name, value)) = old.iter().find(|(name, value)| new.get(*name) != Some(value)) {
            let wanted = new.get(name).cloned().unwrap_or_default();
            bail!("{path:?}: {name} is {value}, this call's is {wanted}; choose another folder");
        }
        let prints = |sources: &[Source]| -> Vec<(String, String)> {
            sources.iter().map(|source| (source.role.clone(), source.sha256.clone())).collect()
        };
        let (old, new) = (prints(&found.sources), prints(&self.sources));
        if let Some(idx) = (0..old.len().max(new.len())).find(|&idx| old.get(idx) != new.get(idx)) {
            let differs = found.sources.get(idx).or(self.sources.get(idx));
            let (role, file) =
                differs.map_or_else(Default::default, |one| (one.role.clone(), one.path.clone()));
            bail!(
                "{path:?}: the {role} is another file than {file:?} was when these demonstrations were made; \
                 choose another folder"
            );
        }
        if found.tensors != self.tensors {
            bail!("{path:?}: tensors differ from those of this call; choose another folder");
        }
        for file in found.files {
            file.read(folder)?;
            self.add(file);
        }
        Ok(())
    }

    pub(crate) fn to_json(&self) -> anyhow::Result<String> {
        Ok(serde_json::to_string_pretty(self)?)
    }

    pub(crate) fn write(&self, folder: &Path) -> anyhow::Result<()> {
        crate::files::write_in_one_move(&folder.join(MANIFEST_FILE), self.to_json()?.as_bytes())
    }
}

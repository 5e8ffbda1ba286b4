//! What a pipeline has done, as a file: which command made what from what.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::stages::Stage;
use crate::files;

/// Beside what the stages left.
pub(super) const MANIFEST_FILE: &str = "manifest.json";
/// Whatever the grasp world is made of.
const ASSETS: &str = "assets";
/// Policies that are shipped are not among it.
const NOT_READ: &str = "policies";

/// What has been done.
#[derive(Debug, Default, Deserialize, Serialize)]
pub(super) struct Manifest {
    /// Version of this program.
    pub(super) software: String,
    /// The configuration that was run last, as text.
    pub(super) config: String,
    /// By name of the stage.
    pub(super) stages: BTreeMap<String, StageRecord>,
}

/// What one stage has done.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
pub(super) struct StageRecord {
    /// The command, as one gives it by hand.
    pub(super) command: String,
    /// Of everything that its results depend on, SHA-256.
    pub(super) key: String,
    /// What it took, all attempts together, s.
    pub(super) seconds: f64,
    /// Its results with their SHA-256; none before it is done.
    pub(super) results: BTreeMap<PathBuf, String>,
}

impl StageRecord {
    /// Whether its results are there, as it left them.
    pub(super) fn is_intact(&self) -> anyhow::Result<bool> {
        if self.results.is_empty() {
            return Ok(false);
        }
        for (path, sha256) in &self.results {
            if !path.is_file() || digest(path)? != *sha256 {
                return Ok(false);
            }
        }
        Ok(true)
    }
}

impl Manifest {
    /// That of the folder `out`; an empty one if it has none.
    pub(super) fn read(out: &Path) -> anyhow::Result<Self> {
        let path = out.join(MANIFEST_FILE);
        match std::fs::read(&path) {
            Err(err) if err.kind() == std::io::ErrorKind::NotFound => Ok(Self::default()),
            Err(err) => Err(err).with_context(|| format!("failed to read {path:?}")),
            Ok(bytes) => serde_json::from_slice(&bytes).with_context(|| {
                format!("{path:?} is no manifest of a pipeline; take another --out, or remove the file")
            }),
        }
    }

    pub(super) fn write(&self, out: &Path) -> anyhow::Result<()> {
        let text = serde_json::to_string_pretty(self)?;
        files::write_in_one_move(&out.join(MANIFEST_FILE), format!("{text}\n").as_bytes())
    }

    /// Of everything that the results of `stage` depend on; `assets` is [`of_assets`].
    ///
    /// # Errors
    /// A file that it reads cannot be read, or a stage that it needs is not done.
    pub(super) fn key(&self, stage: &Stage, assets: &str) -> anyhow::Result<String> {
        let mut hash = Sha256::new();
        let mut add = |text: &str| {
            hash.update((text.len() as u64).to_le_bytes());
            hash.update(text.as_bytes());
        };
        add(env!("CARGO_PKG_VERSION"));
        add(assets);
        for argument in &stage.command {
            add(&argument.to_string_lossy());
        }
        for path in &stage.files {
            add(&digest(path)?);
        }
        for name in &stage.needs {
            let record = self.stages.get(name).filter(|record| !record.results.is_empty());
            let record = record.with_context(|| format!("stage {name:?} is not done"))?;
            for (path, sha256) in &record.results {
                add(&path.to_string_lossy());
                add(sha256);
            }
        }
        Ok(hex(hash))
    }
}

/// Of all files that the grasp world is made of.
pub(super) fn of_assets() -> anyhow::Result<String> {
    let root = Path::new(ASSETS);
    if !root.is_dir() {
        bail!("there is no folder {ASSETS:?} here; run the command in the folder that holds it");
    }
    let mut hash = Sha256::new();
    for path in files_in(root)? {
        if !path.starts_with(root.join(NOT_READ)) {
            hash.update(path.to_string_lossy().as_bytes());
            hash.update(digest(&path)?);
        }
    }
    Ok(hex(hash))
}

/// The results `paths` with their SHA-256.
pub(super) fn results(paths: &[PathBuf]) -> anyhow::Result<BTreeMap<PathBuf, String>> {
    let mut all = BTreeMap::new();
    for path in paths {
        let of_path = if path.is_dir() { files_in(path)? } else { vec![path.clone()] };
        for path in of_path {
            let sha256 = digest(&path)?;
            all.insert(path, sha256);
        }
    }
    Ok(all)
}

/// Every file in `folder` and the folders in it, sorted.
fn files_in(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(|| format!("failed to read {folder:?}"))? {
        let path = entry.with_context(|| format!("failed to read {folder:?}"))?.path();
        if path.is_dir() {
            found.extend(files_in(&path)?);
        } else {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

fn digest(path: &Path) -> anyhow::Result<String> {
    let mut file = std::fs::File::open(path).with_context(|| format!("failed to read {path:?}"))?;
    let mut hash = Sha256::new();
    std::io::copy(&mut file, &mut hash).with_context(|| format!("failed to read {path:?}"))?;
    Ok(hex(hash))
}

fn hex(hash: Sha256) -> String {
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

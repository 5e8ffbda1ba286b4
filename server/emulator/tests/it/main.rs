//! Records sessions from truth files and looks at them from outside.

#![expect(clippy::unwrap_used, reason = "a failed test should panic")]

mod bad_truth;
mod demo;
mod hidden;
mod live;
mod session;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use palpate_emulator::{EmulationError, record_session};
use palpate_recording::{Session, Take};
use palpate_sim::job::{Cancel, NoProgress};
use tempfile::TempDir;

/// A truth file that comes with Palpate.
fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/truth").join(name)
}

/// The world of the small truth with other takes and other numbers, in a file of its own.
fn variant(dir: &TempDir, name: &str, takes: &str, edits: &[(&str, &str)]) -> PathBuf {
    let text = std::fs::read_to_string(shipped("small.toml")).unwrap();
    let assets = std::fs::canonicalize(shipped("small.toml").parent().unwrap().join("..")).unwrap();
    let head = &text[..text.find("[[take]]").unwrap()];
    let mut text = format!("{head}{takes}").replace("\"../", &format!("\"{}/", assets.display()));
    for (from, to) in edits {
        assert!(text.contains(from), "{from:?} is not in the truth");
        text = text.replacen(from, to, 1);
    }
    let path = dir.path().join(name);
    std::fs::write(&path, text).unwrap();
    path
}

fn record(truth: &Path, out_dir: &Path, seed: u64) -> Result<Session, EmulationError> {
    record_session(truth, out_dir, seed, &NoProgress, &Cancel::default())
}

fn takes(session: &Session) -> Vec<Take> {
    (0..session.file.takes.len()).map(|take_idx| session.take(take_idx).unwrap()).collect()
}

/// Every file of a session by name.
fn bytes(session: &Session) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(&session.dir).unwrap().map(Result::unwrap);
    entries
        .map(|entry| (entry.file_name().into_string().unwrap(), std::fs::read(entry.path()).unwrap()))
        .collect()
}

//! Records sessions from truth files and looks at them from outside.

#![expect(clippy::unwrap_used, reason = "a failed test should panic")]

mod bad_truth;
mod demo;
mod hidden;
mod mimic;
mod session;
mod touch;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use palpate_recording::{Session, Take};
use palpate_sim::job::{Cancel, NoProgress};
use palpate_truth::{EmulationError, record_session};
use tempfile::TempDir;

/// A truth file that comes with Palpate.
fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/truth").join(name)
}

/// The world of a shipped truth with other takes and other numbers, in files of its own: `NAME.toml`, and its plan
/// `NAME.plan.toml`. An edit is made in whichever of the two holds its text, the truth first.
fn variant_of(truth: &str, dir: &Path, name: &str, takes: &str, edits: &[(&str, &str)]) -> PathBuf {
    let path = shipped(truth);
    let assets = std::fs::canonicalize(path.parent().unwrap().join("..")).unwrap();
    let absolute = |text: &str| text.replace("\"../", &format!("\"{}/", assets.display()));
    let mut truth = std::fs::read_to_string(&path).unwrap();
    let from = truth.find("../plans/").unwrap();
    let plan_name = truth[from..].split('"').next().unwrap().to_owned();
    let mut plan = std::fs::read_to_string(path.parent().unwrap().join(&plan_name)).unwrap();
    plan.truncate(plan.find("[[take]]").unwrap());
    let own_plan = format!("{name}.plan.toml");
    truth = absolute(&truth.replace(&plan_name, &own_plan));
    plan = absolute(&format!("{plan}{takes}"));
    for (from, to) in edits {
        let text = [&mut truth, &mut plan].into_iter().find(|text| text.contains(from));
        let text = text.unwrap_or_else(|| panic!("{from:?} is neither in the truth nor in its plan"));
        *text = text.replacen(from, to, 1);
    }
    std::fs::write(dir.join(own_plan), plan).unwrap();
    let path = dir.join(format!("{name}.toml"));
    std::fs::write(&path, truth).unwrap();
    path
}

/// A variant of the small truth.
fn variant(dir: &TempDir, name: &str, takes: &str, edits: &[(&str, &str)]) -> PathBuf {
    variant_of("small.toml", dir.path(), name.trim_end_matches(".toml"), takes, edits)
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

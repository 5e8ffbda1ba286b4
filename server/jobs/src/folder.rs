//! The folder of a job: what it is asked, how far it is, what it leaves. The studio and the job's own process share
//! nothing else.
//!
//! Whole documents are replaced by rename, so that a reader never sees half of one; lines are appended. An attempt is
//! owned by whoever holds the lock on `lock`: the job's process for as long as it lives (the operating system lets go
//! of it however the process ends), or the studio while it decides about the next attempt. A process whose attempt is
//! not the one in `attempt.json` does nothing. Hence no two processes ever work on one job, whatever is killed when.

use std::{
    fs::{self, File, TryLockError},
    io::{self, Read as _, Seek as _, SeekFrom, Write as _},
    path::{Path, PathBuf},
    thread,
    time::{Duration, Instant},
};

use palpate_wire::api::{Job, JobExit, JobProgress, JobSpec, Resources};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::JobsError;

/// Largest document of a job that is read, bytes.
const MAX_DOCUMENT_BYTES: u64 = 256 << 20;

/// Names of documents that are being written begin with this.
const TEMPORARY: &str = ".writing-";
/// What each shard of a divided job is asked.
const SHARDS_FILE: &str = "shards.json";
/// Folders of shards, by their number.
pub(crate) const SHARDS_DIR: &str = "shards";
/// Who only looks at a folder, or finds nothing to do, holds its lock for a moment.
const LOCK_PATIENCE: Duration = Duration::from_secs(10);

/// The files of one job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct JobFolder {
    path: PathBuf,
}

/// What one of the shards of a divided job is asked; the rest of its specification is the job's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shard {
    /// In the form of the job's kind.
    pub request: serde_json::Value,
    /// Seed of everything random.
    pub seed: u64,
}

/// Held by whoever may decide about a job's attempts.
#[derive(Debug)]
pub struct FolderLock {
    _file: File,
}

/// The attempt that counts: file `attempt.json`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct CurrentAttempt {
    attempt: u32,
}

/// The process that works on an attempt: file `process.json`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct ProcessFile {
    /// Which attempt.
    pub(crate) attempt: u32,
    /// Its number, which is that of its process group too.
    pub(crate) pid: u32,
    /// When it began, clock ticks since boot: with `boot` it tells the process from a later one of the same number.
    pub(crate) start_ticks: u64,
    /// Id of the boot of the computer.
    pub(crate) boot: String,
    /// Name of the computer.
    pub(crate) host: String,
}

impl JobFolder {
    /// The folder at `path`, which need not exist.
    pub fn at(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into() }
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Where its file `name` is.
    pub fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Makes the folder, and writes what the job and each of its shards are asked. Refused where a job of that name has
    /// been begun.
    pub fn create(&self, spec: &JobSpec, shards: &[Shard]) -> Result<(), JobsError> {
        if self.file("attempt.json").exists() {
            return Err(JobsError::Conflict(format!(
                "the folder {:?} belongs to another job, which the database does not know; move it away",
                self.path
            )));
        }
        fs::create_dir_all(&self.path).map_err(JobsError::io("make", &self.path))?;
        if !shards.is_empty() {
            self.write(SHARDS_FILE, &shards)?;
        }
        self.write("spec.json", spec)
    }

    /// The folder of shard `shard`, which has the same files.
    pub fn shard(&self, shard: u32) -> Self {
        Self { path: self.path.join(SHARDS_DIR).join(shard.to_string()) }
    }

    /// The job whose shard this folder belongs to; `None` if it is that of a job.
    pub fn job_of_shard(&self) -> Option<Self> {
        let shards = self.path.parent().filter(|parent| parent.ends_with(SHARDS_DIR))?;
        Some(Self { path: shards.parent()?.to_owned() })
    }

    /// Makes the folders of `shards` that are not there.
    pub(crate) fn make_shards(&self, shards: impl Iterator<Item = u32>) -> Result<(), JobsError> {
        let missing: Vec<u32> =
            shards.filter(|&shard| !self.shard(shard).file("spec.json").exists()).collect();
        if missing.is_empty() {
            return Ok(());
        }
        let spec = self.spec()?;
        let asked: Vec<Shard> = self.read(SHARDS_FILE)?.unwrap_or_default();
        for shard in missing {
            let Some(Shard { request, seed }) = asked.get(shard as usize).cloned() else {
                return Err(JobsError::Content {
                    path: self.file(SHARDS_FILE),
                    problem: format!("it does not say what shard {shard} is asked; ask for the job again"),
                });
            };
            let resources = Resources { shards: 0, at_once: 0, ..spec.resources };
            self.shard(shard).create(&JobSpec { request, seed, resources, ..spec.clone() }, &[])?;
        }
        Ok(())
    }

    /// What the job is asked.
    pub fn spec(&self) -> Result<JobSpec, JobsError> {
        self.read("spec.json")?.ok_or_else(|| JobsError::Content {
            path: self.file("spec.json"),
            problem: "there is no such file; give the folder of a job".to_owned(),
        })
    }

    /// How far the job is, if it has said so.
    pub fn progress(&self) -> Option<JobProgress> {
        // A file that cannot be read says nothing; the job goes on.
        self.read("progress.json").ok().flatten()
    }

    /// Notes how far the job is.
    pub fn write_progress(&self, progress: &JobProgress) -> Result<(), JobsError> {
        self.replace("progress.json", progress, false)
    }

    /// How attempt `attempt` ended, if its process has said so.
    pub fn exit(&self, attempt: u32) -> Option<JobExit> {
        let exit: Option<JobExit> = match self.read("exit.json") {
            Ok(exit) => exit,
            Err(err) => {
                tracing::warn!(%err, "left out how a job says that it ended");
                None
            }
        };
        exit.filter(|exit| exit.attempt == attempt)
    }

    /// How the attempt that counts ended, if its process has said so.
    pub fn last_exit(&self) -> Option<JobExit> {
        self.exit(self.attempt().ok()?)
    }

    /// Notes how an attempt ended. Everything else of it must be on disk before.
    pub fn write_exit(&self, exit: &JobExit) -> Result<(), JobsError> {
        self.write("exit.json", exit)
    }

    /// Notes what the database says of the job, for people and for a database that is made anew.
    pub(crate) fn write_head(&self, job: &Job) -> Result<(), JobsError> {
        self.write("job.json", job)
    }

    /// The process that works on the job, or last did.
    pub(crate) fn process(&self) -> Option<ProcessFile> {
        self.read("process.json").ok().flatten()
    }

    pub(crate) fn write_process(&self, process: &ProcessFile) -> Result<(), JobsError> {
        self.write("process.json", process)
    }

    /// The attempt that counts; 0 before the first.
    pub fn attempt(&self) -> Result<u32, JobsError> {
        Ok(self.read::<CurrentAttempt>("attempt.json")?.map_or(0, |current| current.attempt))
    }

    /// Makes `attempt` the one that counts. `_lock` shows that no process works on an earlier one.
    pub(crate) fn begin_attempt(&self, attempt: u32, _lock: &FolderLock) -> Result<(), JobsError> {
        self.write("attempt.json", &CurrentAttempt { attempt })
    }

    /// Makes sure that no process begins `attempt` any more, which was started and has not begun. `_lock` shows that
    /// none has.
    pub(crate) fn give_up_attempt(&self, attempt: u32, lock: &FolderLock) -> Result<(), JobsError> {
        self.begin_attempt(attempt + 1, lock)
    }

    /// The lock, once it is free. A process that finds its attempt given up holds it for a moment.
    pub(crate) fn lock(&self) -> Result<FolderLock, JobsError> {
        let patience = Instant::now();
        loop {
            if let Some(lock) = self.try_lock()? {
                return Ok(lock);
            }
            if patience.elapsed() > LOCK_PATIENCE {
                return Err(JobsError::Conflict(format!(
                    "another process works on the job in {:?}; wait until it ends, or cancel the job",
                    self.path
                )));
            }
            thread::sleep(Duration::from_millis(5));
        }
    }

    /// The lock, if it is free. On file systems without locks it always is.
    pub(crate) fn try_lock(&self) -> Result<Option<FolderLock>, JobsError> {
        let path = self.file("lock");
        let file = File::options()
            .create(true)
            .truncate(false)
            .write(true)
            .open(&path)
            .map_err(JobsError::io("open", &path))?;
        match file.try_lock() {
            Ok(()) => Ok(Some(FolderLock { _file: file })),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(err)) if err.kind() == io::ErrorKind::Unsupported => {
                Ok(Some(FolderLock { _file: file }))
            }
            Err(TryLockError::Error(source)) => Err(JobsError::Io { action: "lock", path, source }),
        }
    }

    /// Removes documents that a killed process had not put in place yet.
    pub(crate) fn remove_leftovers(&self, _lock: &FolderLock) {
        let Ok(entries) = fs::read_dir(&self.path) else { return };
        for path in entries.flatten().map(|entry| entry.path()) {
            let is_leftover = path
                .file_name()
                .is_some_and(|name| name.as_encoded_bytes().starts_with(TEMPORARY.as_bytes()));
            if is_leftover {
                // One that stays is in nobody's way.
                let _ = fs::remove_file(path);
            }
        }
    }

    /// The log, opened to be added to.
    pub(crate) fn open_log(&self) -> Result<File, JobsError> {
        let path = self.file("log.txt");
        File::options().create(true).append(true).open(&path).map_err(JobsError::io("open", &path))
    }

    /// The last whole lines of the log, `max_bytes` of it at most; empty if there is none.
    pub fn log_tail(&self, max_bytes: u64) -> Result<String, JobsError> {
        self.tail("log.txt", max_bytes)
    }

    /// The last whole lines of `metrics.jsonl`, `max_bytes` of it at most; empty if there is none.
    pub fn metrics_tail(&self, max_bytes: u64) -> Result<String, JobsError> {
        self.tail("metrics.jsonl", max_bytes)
    }

    fn tail(&self, name: &str, max_bytes: u64) -> Result<String, JobsError> {
        let path = self.file(name);
        let mut file = match File::open(&path) {
            Ok(file) => file,
            Err(err) if err.kind() == io::ErrorKind::NotFound => return Ok(String::new()),
            Err(source) => return Err(JobsError::Io { action: "open", path, source }),
        };
        let read = (|| {
            let skipped = file.metadata()?.len().saturating_sub(max_bytes);
            // The byte before tells whether a line begins there.
            file.seek(SeekFrom::Start(skipped.saturating_sub(1)))?;
            let mut bytes = Vec::new();
            file.take(max_bytes.saturating_add(1)).read_to_end(&mut bytes)?;
            if skipped > 0 {
                let begin = bytes.iter().position(|&byte| byte == b'\n').map_or(bytes.len(), |end| end + 1);
                bytes.drain(..begin);
            }
            Ok(bytes)
        })();
        let bytes = read.map_err(JobsError::io("read", &path))?;
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    }

    /// Adds a line to `metrics.jsonl`.
    pub fn append_metrics(&self, line: &serde_json::Value) -> Result<(), JobsError> {
        let path = self.file("metrics.jsonl");
        let mut text = line.to_string();
        text.push('\n');
        File::options()
            .create(true)
            .append(true)
            .open(&path)
            .and_then(|mut file| file.write_all(text.as_bytes()))
            .map_err(JobsError::io("write", &path))
    }

    fn read<T: DeserializeOwned>(&self, name: &str) -> Result<Option<T>, JobsError> {
        let path = self.file(name);
        let mut bytes = Vec::new();
        let read = File::open(&path).and_then(|file| file.take(MAX_DOCUMENT_BYTES).read_to_end(&mut bytes));
        match read {
            Ok(_) => {}
            Err(err) if err.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(source) => return Err(JobsError::Io { action: "read", path, source }),
        }
        serde_json::from_slice(&bytes)
            .map(Some)
            .map_err(|err| JobsError::Content { path, problem: err.to_string() })
    }

    fn write(&self, name: &str, document: &impl Serialize) -> Result<(), JobsError> {
        self.replace(name, document, true)
    }

    /// Puts `document` in place of file `name`, as a whole; on disk before this returns if it must be `durable`.
    fn replace(&self, name: &str, document: &impl Serialize, durable: bool) -> Result<(), JobsError> {
        let path = self.file(name);
        let written = (|| {
            let mut file = tempfile::Builder::new().prefix(TEMPORARY).tempfile_in(&self.path)?;
            serde_json::to_writer(&mut file, document).map_err(io::Error::from)?;
            file.write_all(b"\n")?;
            if durable {
                file.as_file().sync_all()?;
            }
            file.persist(&path).map_err(|err| err.error)?;
            if durable {
                File::open(&self.path)?.sync_all()?;
            }
            Ok(())
        })();
        written.map_err(JobsError::io("write", &path))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tail_begins_with_a_whole_line() {
        let dir = tempfile::tempdir().unwrap();
        let folder = JobFolder::at(dir.path());
        assert_eq!(folder.log_tail(10).unwrap(), "");
        folder.open_log().unwrap().write_all(b"one\ntwo\nthree\n").unwrap();
        assert_eq!(folder.log_tail(100).unwrap(), "one\ntwo\nthree\n");
        assert_eq!(folder.log_tail(10).unwrap(), "two\nthree\n");
        assert_eq!(folder.log_tail(9).unwrap(), "three\n");
    }

    #[test]
    fn lock_is_free_again_once_its_holder_is_gone() {
        let dir = tempfile::tempdir().unwrap();
        let folder = JobFolder::at(dir.path());
        let held = folder.try_lock().unwrap();
        assert!(held.is_some());
        assert!(folder.try_lock().unwrap().is_none());
        drop(held);
        let lock = folder.try_lock().unwrap().unwrap();
        assert_eq!(folder.attempt().unwrap(), 0);
        folder.begin_attempt(3, &lock).unwrap();
        assert_eq!(folder.attempt().unwrap(), 3);
    }

    #[test]
    fn what_a_killed_process_was_writing_is_removed_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let folder = JobFolder::at(dir.path());
        fs::write(folder.file(".writing-x"), "{").unwrap();
        fs::write(folder.file("report.json"), "{}").unwrap();
        folder.remove_leftovers(&folder.try_lock().unwrap().unwrap());
        assert!(!folder.file(".writing-x").exists() && folder.file("report.json").exists());
    }

    #[test]
    fn end_of_an_earlier_attempt_is_not_the_end_of_this_one() {
        let dir = tempfile::tempdir().unwrap();
        let folder = JobFolder::at(dir.path());
        assert_eq!(folder.exit(1), None);
        let exit = JobExit {
            attempt: 1,
            outcome: palpate_wire::api::JobState::Done,
            code: 0,
            problem: None,
            started: String::new(),
            ended: String::new(),
            host: "here".to_owned(),
        };
        folder.write_exit(&exit).unwrap();
        assert_eq!(folder.exit(1), Some(exit));
        assert_eq!(folder.exit(2), None);
        fs::write(folder.file("exit.json"), "{").unwrap();
        assert_eq!(folder.exit(1), None, "half a document says nothing");
    }
}

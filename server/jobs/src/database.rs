//! The database of a data folder: one SQLite file in WAL mode.
//!
//! What is acknowledged is on disk (`synchronous = FULL`). Writers take turns behind a mutex; readers have a connection
//! of their own and wait for nobody. Tables change by numbered steps (`PRAGMA user_version`), and each step is tested
//! from the versions before it.

mod jobs;

use std::{
    fs::File,
    io::Read as _,
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
    time::Duration,
};

#[cfg(test)]
pub(crate) use jobs::held_cores;
pub(crate) use jobs::{Ending, NewJob, QueuedJob, Row};
pub use jobs::{JobTotals, ListFilter, Submitted};
use rusqlite::{Connection, ErrorCode, OpenFlags, TransactionBehavior};

use crate::JobsError;

/// Another process that writes, `sqlite3` by hand for instance, is waited for this long.
const BUSY_TIMEOUT: Duration = Duration::from_secs(5);
/// Databases up to this size are looked through as a whole when they are opened; larger ones would delay the start.
const MAX_CHECKED_BYTES: u64 = 64 << 20;

/// The steps from an empty database to the newest version. A released step never changes.
pub(crate) const STEPS: &[&str] = &[
    // 1: jobs.
    "CREATE TABLE jobs (
        serial INTEGER PRIMARY KEY AUTOINCREMENT,
        id TEXT NOT NULL UNIQUE,
        kind TEXT NOT NULL,
        state TEXT NOT NULL CHECK (state IN ('queued', 'running', 'done', 'failed', 'cancelled')),
        spec TEXT NOT NULL,
        owner TEXT NOT NULL,
        runner TEXT NOT NULL,
        handle TEXT,
        priority INTEGER NOT NULL,
        cores INTEGER NOT NULL,
        gpu INTEGER NOT NULL,
        station INTEGER NOT NULL,
        short INTEGER NOT NULL,
        created TEXT NOT NULL,
        started TEXT,
        ended TEXT,
        attempts INTEGER NOT NULL DEFAULT 0,
        cut_off INTEGER NOT NULL DEFAULT 0,
        cancel_requested INTEGER NOT NULL DEFAULT 0,
        fraction REAL NOT NULL DEFAULT 0,
        stage TEXT NOT NULL,
        problem TEXT,
        saved_as TEXT
    ) STRICT;
    CREATE INDEX jobs_by_state ON jobs (state, short, priority DESC, serial);
    CREATE INDEX jobs_by_kind ON jobs (kind, serial);
    CREATE TABLE numbers (prefix TEXT PRIMARY KEY, next INTEGER NOT NULL) STRICT, WITHOUT ROWID;",
    // 2: requests that were sent twice, and hashes of inputs that have not changed since they were computed.
    "CREATE TABLE idempotency_keys (
        key TEXT PRIMARY KEY,
        request TEXT NOT NULL,
        job TEXT NOT NULL,
        created TEXT NOT NULL
    ) STRICT, WITHOUT ROWID;
    CREATE TABLE file_hashes (
        path TEXT PRIMARY KEY,
        size INTEGER NOT NULL,
        modified_ns INTEGER NOT NULL,
        sha256 TEXT NOT NULL
    ) STRICT, WITHOUT ROWID;",
];

/// A database that is open.
#[derive(Debug)]
pub struct Database {
    path: PathBuf,
    writer: Mutex<Connection>,
    reader: Mutex<Connection>,
}

impl Database {
    /// Opens the database at `path`, makes it if there is none, and brings it to the newest version.
    pub fn open(path: &Path) -> Result<Self, JobsError> {
        Self::open_with(path, STEPS)
    }

    pub(crate) fn open_with(path: &Path, steps: &[&str]) -> Result<Self, JobsError> {
        refuse_network(path)?;
        refuse_other_files(path)?;
        let explain = |err| explain(path, err);
        let mut writer = Connection::open(path).map_err(explain)?;
        writer.busy_timeout(BUSY_TIMEOUT).map_err(explain)?;
        let mode: String = writer
            .query_row("PRAGMA journal_mode = WAL", [], |row| row.get(0))
            .map_err(|err| explain_wal(path, err))?;
        if mode != "wal" {
            return Err(no_wal(path));
        }
        writer
            .execute_batch("PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON;")
            .map_err(|err| explain_wal(path, err))?;
        if path.metadata().is_ok_and(|meta| meta.len() <= MAX_CHECKED_BYTES) {
            let check: String =
                writer.query_row("PRAGMA quick_check(1)", [], |row| row.get(0)).map_err(explain)?;
            if check != "ok" {
                return Err(damaged(path, &check));
            }
        }
        migrate(path, &mut writer, steps)?;
        let reader = Connection::open_with_flags(
            path,
            OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX,
        )
        .map_err(explain)?;
        reader.busy_timeout(BUSY_TIMEOUT).map_err(explain)?;
        Ok(Self { path: path.to_owned(), writer: Mutex::new(writer), reader: Mutex::new(reader) })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn writer(&self) -> MutexGuard<'_, Connection> {
        self.writer.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn reader(&self) -> MutexGuard<'_, Connection> {
        self.reader.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes a whole and consistent copy to `out`, which must not exist, while the database is in use.
    pub fn backup(&self, out: &Path) -> Result<(), JobsError> {
        let out = out.to_str().ok_or_else(|| {
            JobsError::Argument(format!("the path {out:?} is no UTF-8 text; give another one"))
        })?;
        self.reader().execute("VACUUM INTO ?1", [out]).map_err(JobsError::sql("back up"))?;
        Ok(())
    }
}

/// Does the steps that `path` lacks, all or none.
fn migrate(path: &Path, connection: &mut Connection, steps: &[&str]) -> Result<(), JobsError> {
    let explain = |err| explain(path, err);
    let transaction =
        connection.transaction_with_behavior(TransactionBehavior::Immediate).map_err(explain)?;
    let version: i64 = transaction.query_row("PRAGMA user_version", [], |row| row.get(0)).map_err(explain)?;
    let newest = steps.len();
    let done = usize::try_from(version).ok().filter(|&done| done <= newest).ok_or_else(|| {
        JobsError::Database {
            path: path.to_owned(),
            problem: format!(
                "the database has version {version}, and this program knows versions up to {newest}: a newer palpate wrote \
                 it; start that one, or give another data folder"
            ),
        }
    })?;
    for step in &steps[done..] {
        transaction.execute_batch(step).map_err(explain)?;
    }
    transaction.pragma_update(None, "user_version", newest as i64).map_err(explain)?;
    transaction.commit().map_err(explain)
}

/// Refuses file systems of other computers: SQLite's WAL needs memory that all its users share.
fn refuse_network(path: &Path) -> Result<(), JobsError> {
    /// `f_type` of statfs(2): NFS, SMB1, CIFS, SMB2, AFS.
    const NETWORK: [u64; 5] = [0x6969, 0x517b, 0xff53_4d42, 0xfe53_4d42, 0x5346_414f];
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match rustix::fs::statfs(folder) {
        Ok(status) if NETWORK.contains(&(status.f_type as u64 & 0xffff_ffff)) => Err(no_wal(path)),
        // What cannot be asked is found out by opening the file.
        _ => Ok(()),
    }
}

/// Refuses what SQLite would wait for or write over.
fn refuse_other_files(path: &Path) -> Result<(), JobsError> {
    let Ok(meta) = path.symlink_metadata() else { return Ok(()) };
    if !meta.is_file() {
        let problem = "it is no plain file; move it away, and restart".to_owned();
        return Err(JobsError::Database { path: path.to_owned(), problem });
    }
    let mut begin = [0; 16];
    let read =
        File::open(path).and_then(|mut file| file.read(&mut begin)).map_err(JobsError::io("read", path))?;
    if read > 0 && &begin != b"SQLite format 3\0" {
        return Err(damaged(path, "it does not begin like a database"));
    }
    Ok(())
}

fn explain_wal(path: &Path, err: rusqlite::Error) -> JobsError {
    match err.sqlite_error_code() {
        Some(ErrorCode::SystemIoFailure | ErrorCode::CannotOpen | ErrorCode::FileLockingProtocolFailed) => {
            no_wal(path)
        }
        _ => explain(path, err),
    }
}

fn explain(path: &Path, err: rusqlite::Error) -> JobsError {
    let problem = match err.sqlite_error_code() {
        Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase) => return damaged(path, &err.to_string()),
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => {
            format!("another program writes to it: {err}; end that one first")
        }
        Some(ErrorCode::DiskFull) => "the disk is full; free some space".to_owned(),
        Some(ErrorCode::ReadOnly | ErrorCode::PermissionDenied) => {
            format!("it cannot be written: {err}; check who owns the file and its folder")
        }
        _ => format!("it cannot be opened: {err}"),
    };
    JobsError::Database { path: path.to_owned(), problem }
}

fn damaged(path: &Path, what: &str) -> JobsError {
    JobsError::Database {
        path: path.to_owned(),
        problem: format!(
            "the database is damaged ({what}): put a backup in its place, or move it and its -wal and -shm files away; \
             sessions, models and the folders of jobs are files of their own and stay"
        ),
    }
}

fn no_wal(path: &Path) -> JobsError {
    JobsError::Database {
        path: path.to_owned(),
        problem: "its file system cannot hold a database that is written while it is read (WAL), as file systems of other \
                  computers (NFS, SMB) cannot: put the data folder on a disk of this computer"
            .to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn database_of_version_1_is_brought_to_the_newest_and_keeps_its_jobs() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("palpate.sqlite");
        {
            let old = Database::open_with(&path, &STEPS[..1]).unwrap();
            old.writer()
                .execute(
                    "INSERT INTO jobs (id, kind, state, spec, owner, runner, priority, cores, gpu, station, short, created, stage)
                     VALUES ('run-1', 'calibrate', 'queued', '{\"kind\":\"calibrate\",\"request\":{},\"software\":\"palpate 0.1\"}',
                             'somebody', 'process', 0, 0, 0, 0, 1, '2026-11-20T10:00:00.000Z', 'waiting')",
                    [],
                )
                .unwrap();
        }
        let new = Database::open(&path).unwrap();
        let version: i64 = new.reader().query_row("PRAGMA user_version", [], |row| row.get(0)).unwrap();
        assert_eq!(version, STEPS.len() as i64);
        let row = new.row("run-1").unwrap().unwrap();
        assert_eq!((row.job.kind.as_str(), row.job.owner.as_str()), ("calibrate", "somebody"));
        let keys: i64 =
            new.reader().query_row("SELECT count(*) FROM idempotency_keys", [], |row| row.get(0)).unwrap();
        assert_eq!(keys, 0, "the table of version 2 is there");
    }

    #[test]
    fn database_of_a_newer_program_is_refused_by_its_version() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("palpate.sqlite");
        Database::open(&path).unwrap().writer().pragma_update(None, "user_version", 977).unwrap();
        let before = fs::read(&path).unwrap();
        let err = Database::open(&path).unwrap_err().to_string();
        assert!(err.contains("version 977") && err.contains("newer"), "{err}");
        assert_eq!(fs::read(&path).unwrap(), before, "it is left as it was");
    }

    #[test]
    fn damage_is_called_damage() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("palpate.sqlite");
        fs::write(&path, "no database at all").unwrap();
        let err = Database::open(&path).unwrap_err().to_string();
        assert!(err.contains("damaged") && err.contains("backup") && err.contains("palpate.sqlite"), "{err}");
        assert_eq!(fs::read_to_string(&path).unwrap(), "no database at all");

        fs::remove_file(&path).unwrap();
        drop(Database::open(&path).unwrap());
        let mut bytes = fs::read(&path).unwrap();
        bytes[4096..].fill(0x5a);
        fs::write(&path, bytes).unwrap();
        let err = Database::open(&path).unwrap_err().to_string();
        assert!(err.contains("damaged"), "{err}");

        fs::remove_file(&path).unwrap();
        fs::create_dir(&path).unwrap();
        let err = Database::open(&path).unwrap_err().to_string();
        assert!(err.contains("no plain file"), "{err}");
    }

    #[test]
    fn backup_is_a_database_of_its_own() {
        let dir = tempfile::tempdir().unwrap();
        let database = Database::open(&dir.path().join("palpate.sqlite")).unwrap();
        let out = dir.path().join("copy.sqlite");
        database.backup(&out).unwrap();
        assert!(database.backup(&out).is_err(), "a backup replaces nothing");
        Database::open(&out).unwrap();
    }
}

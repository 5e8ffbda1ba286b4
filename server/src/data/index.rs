//! What takes hold, kept in the database, so that a studio with a thousand sessions lists them without decoding a file.
//!
//! Files are the truth: an entry counts for a file of the same length and time only, and everything here can be made
//! again from them (`palpate index rebuild`). Reading and writing may fail, and the takes are then decoded instead.

use std::{
    fs::Metadata,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    time::{Duration, UNIX_EPOCH},
};

use palpate_recording::Session;
use palpate_wire::api::TakeSummary;
use rusqlite::{Connection, OptionalExtension as _, params};
use serde::Serialize;

use super::{Store, library::Library};
use crate::{Error, chain, jobs::board::DATABASE_FILE};

/// Tables of other versions are dropped: their entries are made again.
const TABLE: &str = "take_index_1";
/// Somebody else who writes is waited for this long; then the take is decoded.
const BUSY_TIMEOUT: Duration = Duration::from_secs(2);

/// The index of a data folder.
pub(crate) struct TakeIndex {
    /// Paths of takes are kept relative to it, so that the folder can be moved.
    root: PathBuf,
    connection: Mutex<Connection>,
}

/// What a rebuilt index holds.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct IndexReport {
    /// Sessions that can be opened.
    pub sessions: usize,
    /// Their takes.
    pub takes: usize,
    /// Sessions that cannot be read, by name, and why.
    pub problems: Vec<String>,
}

impl TakeIndex {
    /// The index of the data folder `root`, whose database is there.
    pub(crate) fn open(root: &Path) -> Result<Self, Error> {
        let failed = |err| failed("open", &err);
        let root = root.canonicalize().map_err(Error::io("open", root))?;
        let connection = Connection::open(root.join(DATABASE_FILE)).map_err(failed)?;
        connection.busy_timeout(BUSY_TIMEOUT).map_err(failed)?;
        // What a crash loses is made again.
        connection
            .execute_batch(&format!(
                "PRAGMA synchronous = NORMAL;
                 CREATE TABLE IF NOT EXISTS {TABLE} (
                     path TEXT PRIMARY KEY,
                     size INTEGER NOT NULL,
                     modified_ns INTEGER NOT NULL,
                     summary TEXT NOT NULL
                 ) STRICT, WITHOUT ROWID;"
            ))
            .map_err(failed)?;
        Ok(Self { root, connection: Mutex::new(connection) })
    }

    /// What the take at `path` holds, if it is as it was when that was noted.
    pub(crate) fn get(&self, path: &Path) -> Option<TakeSummary> {
        let (name, size, modified_ns) = self.key(path)?;
        let sql = format!("SELECT summary FROM {TABLE} WHERE path = ?1 AND size = ?2 AND modified_ns = ?3");
        let connection = self.connection.lock().unwrap_or_else(PoisonError::into_inner);
        let text: Result<Option<String>, _> = connection.prepare_cached(&sql).and_then(|mut statement| {
            statement.query_row(params![name, size, modified_ns], |row| row.get(0)).optional()
        });
        match text {
            // An entry of another version says nothing.
            Ok(text) => serde_json::from_str(&text?).ok(),
            Err(err) => {
                tracing::warn!(%err, "the index of takes cannot be read");
                None
            }
        }
    }

    /// Notes what the take at `path` holds.
    pub(crate) fn put(&self, path: &Path, summary: &TakeSummary) {
        let Some((name, size, modified_ns)) = self.key(path) else { return };
        // Plain data always serialises.
        let text = serde_json::to_string(summary).unwrap_or_default();
        let sql = format!(
            "INSERT OR REPLACE INTO {TABLE} (path, size, modified_ns, summary) VALUES (?1, ?2, ?3, ?4)"
        );
        let connection = self.connection.lock().unwrap_or_else(PoisonError::into_inner);
        let put = connection
            .prepare_cached(&sql)
            .and_then(|mut statement| statement.execute(params![name, size, modified_ns, text]));
        if let Err(err) = put {
            tracing::warn!(%err, "the index of takes cannot be written");
        }
    }

    fn clear(&self) -> Result<(), Error> {
        let connection = self.connection.lock().unwrap_or_else(PoisonError::into_inner);
        connection.execute(&format!("DELETE FROM {TABLE}"), []).map_err(|err| failed("clear", &err))?;
        Ok(())
    }

    /// Name, length and time of a take in the data folder.
    fn key(&self, path: &Path) -> Option<(String, i64, i64)> {
        let meta = path.metadata().ok()?;
        let path = path.canonicalize().ok()?;
        let name = path.strip_prefix(&self.root).ok()?.to_str()?.to_owned();
        let (size, modified_ns) = stamp(&meta)?;
        Some((name, size, modified_ns))
    }
}

/// Makes the index of the data folder `data` again from its takes, whether a studio has it open or not.
pub fn rebuild_index(data: &Path) -> Result<IndexReport, Error> {
    if !data.join(DATABASE_FILE).is_file() {
        return Err(Error::Argument(format!(
            "{data:?} is no data folder of a studio: it holds no {DATABASE_FILE}; give one (--data)"
        )));
    }
    let index = TakeIndex::open(data)?;
    index.clear()?;
    let (store, library) = (Store::of_job(data), Library::with_index(index));
    let mut report = IndexReport::default();
    for id in store.sessions()? {
        let opened: Result<Session, Error> = store.session(&id);
        match opened.and_then(|session| library.detail(&session)) {
            Ok(detail) => {
                report.sessions += 1;
                report.takes += detail.takes.len();
            }
            Err(err) => report.problems.push(format!("{id}: {}", chain(&err))),
        }
    }
    Ok(report)
}

fn stamp(meta: &Metadata) -> Option<(i64, i64)> {
    let modified = meta.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
    Some((i64::try_from(meta.len()).ok()?, i64::try_from(modified.as_nanos()).ok()?))
}

fn failed(action: &str, err: &rusqlite::Error) -> Error {
    Error::Internal(format!("failed to {action} the index of takes in {DATABASE_FILE}: {err}"))
}

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

use palpate_wire::api::TakeSummary;
use rusqlite::{Connection, OptionalExtension as _, params};

use super::database::DATABASE_FILE;
use crate::Error;

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

    pub(super) fn clear(&self) -> Result<(), Error> {
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

fn stamp(meta: &Metadata) -> Option<(i64, i64)> {
    let modified = meta.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
    Some((i64::try_from(meta.len()).ok()?, i64::try_from(modified.as_nanos()).ok()?))
}

fn failed(action: &str, err: &rusqlite::Error) -> Error {
    Error::Internal(format!("failed to {action} the index of takes in {DATABASE_FILE}: {err}"))
}

//! The index of takes, made again from the takes.

use std::path::Path;

use palpate_recording::Session;
use serde::Serialize;

use super::{Store, database::DATABASE_FILE, index::TakeIndex, library::Library};
use crate::{Error, chain};

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

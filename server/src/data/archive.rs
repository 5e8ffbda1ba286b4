//! Sessions that go out as a zip archive, which any studio takes in again.

use std::{
    fs::File,
    io::{self, Seek as _, Write as _},
    path::Path,
    time::UNIX_EPOCH,
};

use palpate_recording::{
    Session,
    files::{open_file, resolve_in},
};
use zip::{CompressionMethod, ZipWriter, result::ZipError, write::SimpleFileOptions};

use super::upload::{check_space, free_bytes};
use crate::{Error, Store};

/// An archive, or a take, that is ready to be sent.
pub(crate) struct Outgoing {
    /// Its content, from the start. An archive has no name on the disk any more: it is gone when this is closed.
    pub(crate) file: File,
    /// Changes whenever the content does.
    pub(crate) version: String,
}

/// Packs `session.toml` and the takes that it lists into one folder of the session's name.
///
/// The archive has the same bytes as long as the session has, so that a download that broke off can go on.
///
/// # Errors
/// A session without takes, a take that cannot be read, a disk without room for the archive.
pub(crate) fn pack(store: &Store, session: &Session) -> Result<Outgoing, Error> {
    let id = &session.id;
    if session.file.takes.is_empty() {
        return Err(Error::Conflict(format!(
            "session {id:?} has no takes yet; record one, then download it"
        )));
    }
    let list = toml::to_string(&session.file).map_err(|err| Error::Internal(err.to_string()))?;
    let mut version = format!("{id}\n{list}");
    let mut takes = Vec::new();
    for take_idx in 0..session.file.takes.len() {
        let take = open_take(session, take_idx)?;
        version += &take.version;
        takes.push(take.file);
    }
    let mut bytes = 0;
    for file in &takes {
        bytes += file.metadata().map_err(Error::io("read", &session.dir))?.len();
    }
    let _place = store.uploads().take()?;
    if check_space(free_bytes(store.root()), bytes).is_err() {
        return Err(Error::DiskFull(format!(
            "the studio's disk has no room to pack the {} MB of session {id:?}; free some space there, or download its takes \
             one by one",
            bytes.div_ceil(1_000_000)
        )));
    }
    let root = store.root();
    let mut zip = ZipWriter::new(tempfile::tempfile_in(root).map_err(Error::io("make", root))?);
    // Takes are compressed already.
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    let unpacked = |err: ZipError| Error::Internal(format!("failed to pack session {id:?}: {err}"));
    zip.start_file(format!("{id}/session.toml"), options).map_err(unpacked)?;
    zip.write_all(list.as_bytes()).map_err(Error::io("write", root))?;
    for (entry, mut file) in session.file.takes.iter().zip(takes) {
        let is_large = file.metadata().is_ok_and(|meta| meta.len() > u64::from(u32::MAX));
        zip.start_file(format!("{id}/{}", entry.file), options.large_file(is_large)).map_err(unpacked)?;
        io::copy(&mut file, &mut zip).map_err(Error::io("pack", &session.take_path(entry)))?;
    }
    let mut file = zip.finish().map_err(unpacked)?;
    file.rewind().map_err(Error::io("read", root))?;
    Ok(Outgoing { file, version })
}

/// Opens the file of a take; one that lies outside of its session's folder is refused.
///
/// # Errors
/// A file that is missing, is none, or lies elsewhere.
pub(crate) fn open_take(session: &Session, take_idx: usize) -> Result<Outgoing, Error> {
    let Some(entry) = session.file.takes.get(take_idx) else {
        return Err(Error::Internal(format!("session {:?} has no take {take_idx}", session.id)));
    };
    let path = session.take_path(entry);
    resolve_in(&session.dir, &path)?;
    let file = open_file(&path)?;
    Ok(Outgoing { version: version(&file, &path, &entry.file)?, file })
}

/// Name, size and time of the last change of an opened file.
fn version(file: &File, path: &Path, name: &str) -> Result<String, Error> {
    let meta = file.metadata().map_err(Error::io("read", path))?;
    let changed = meta.modified().map_err(Error::io("read", path))?;
    let changed = changed.duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos();
    Ok(format!("{name} {} {changed}\n", meta.len()))
}

//! A copy of a data folder in one file, made while a studio has it open.
//!
//! The database is copied as of one moment, by SQLite itself. Then come the files: those that are written as a whole are
//! replaced by rename, and logs only grow, so that each is copied as it was at some moment after that. A job of the
//! database therefore has its folder in the copy. Unpacking the file gives a data folder.

use std::{
    fs::{self, File},
    io::{self, BufWriter, ErrorKind, Read, Write as _},
    os::unix::fs::{MetadataExt as _, OpenOptionsExt as _},
    path::{Path, PathBuf},
};

use palpate_jobs::Database;
use serde::Serialize;
use tar::{Builder, EntryType, Header};

use crate::{Error, data::database::DATABASE_FILE};

/// Names that belong to a running program, not to its data: locks, what is being written, and what SQLite keeps beside its
/// database.
fn is_left_out(name: &str) -> bool {
    name == "studio.lock"
        || name == ".recording.lock"
        || name.starts_with(DATABASE_FILE)
        || name.starts_with(".incoming-")
        || name.ends_with(".partial")
}

/// What a backup holds.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct BackupReport {
    /// Files in it, the database included.
    pub files: u64,
    /// Their size, bytes.
    pub bytes: u64,
    /// Links, which are kept as links: what they lead to is not in the backup.
    pub links: Vec<PathBuf>,
}

/// Writes all of the data folder `data` into the new file `out`, a tar archive.
pub fn backup(data: &Path, out: &Path) -> Result<BackupReport, Error> {
    let database = data.join(DATABASE_FILE);
    if !database.is_file() {
        return Err(Error::Argument(format!(
            "{data:?} is no data folder of a studio: it holds no {DATABASE_FILE}"
        )));
    }
    if out.exists() {
        return Err(Error::Conflict(format!(
            "{out:?} exists already; a backup replaces nothing, so give another name"
        )));
    }
    let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let folder = folder.canonicalize().map_err(Error::io("find", folder))?;
    let root = data.canonicalize().map_err(Error::io("open", data))?;
    if folder.starts_with(&root) {
        return Err(Error::Argument(format!(
            "{out:?} lies in the data folder, which it is to hold; give another place"
        )));
    }
    let scratch = tempfile::tempdir_in(&folder).map_err(Error::io("make a folder in", &folder))?;
    let copy = scratch.path().join(DATABASE_FILE);
    Database::open(&database)?.backup(&copy)?;
    let written = scratch.path().join("backup.tar");
    // It holds the hashes of passwords, and the key of the certificate.
    let file = fs::OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(&written)
        .map_err(Error::io("write", &written))?;
    let mut report = BackupReport::default();
    let mut archive = Builder::new(BufWriter::with_capacity(1 << 20, file));
    append_file(&mut archive, &copy, Path::new(DATABASE_FILE), &mut report)?;
    append_folder(&mut archive, &root, Path::new(""), &mut report)?;
    let finish = || -> io::Result<()> {
        let mut file = archive.into_inner()?;
        file.flush()?;
        file.get_ref().sync_all()
    };
    finish().map_err(Error::io("write", out))?;
    // Not over a file that somebody has made meanwhile.
    fs::hard_link(&written, out).map_err(Error::io("write", out))?;
    Ok(report)
}

type Archive = Builder<BufWriter<File>>;

/// Appends what is in the folder `inside` of `root`, in the order of names.
fn append_folder(
    archive: &mut Archive,
    root: &Path,
    inside: &Path,
    report: &mut BackupReport,
) -> Result<(), Error> {
    let folder = root.join(inside);
    let mut names = match fs::read_dir(&folder) {
        Ok(entries) => entries
            .map(|entry| entry.map(|entry| entry.file_name()))
            .collect::<Result<Vec<_>, _>>()
            .map_err(Error::io("read", &folder))?,
        // Deleted meanwhile.
        Err(err) if err.kind() == ErrorKind::NotFound && inside != Path::new("") => return Ok(()),
        Err(source) => return Err(Error::Io { action: "read", path: folder, source }),
    };
    names.sort();
    for name in names {
        let is_of_root = inside == Path::new("");
        let text = name.to_string_lossy();
        if is_left_out(&text) && (is_of_root || !text.starts_with(DATABASE_FILE)) {
            continue;
        }
        let path = inside.join(&name);
        let from = root.join(&path);
        let Some(meta) = if_there(from.symlink_metadata()).map_err(Error::io("read", &from))? else {
            continue;
        };
        if meta.is_dir() {
            let mut header = header_of(&meta, EntryType::Directory, 0);
            append(archive, &mut header, &path, io::empty())?;
            append_folder(archive, root, &path, report)?;
        } else if meta.is_symlink() {
            let Some(target) = if_there(from.read_link()).map_err(Error::io("read", &from))? else {
                continue;
            };
            let mut header = header_of(&meta, EntryType::Symlink, 0);
            archive.append_link(&mut header, &path, &target).map_err(Error::io("copy", &from))?;
            report.links.push(path);
        } else if meta.is_file() {
            append_file(archive, &from, &path, report)?;
        }
    }
    Ok(())
}

fn append_file(
    archive: &mut Archive,
    from: &Path,
    path: &Path,
    report: &mut BackupReport,
) -> Result<(), Error> {
    let Some(mut file) = if_there(File::open(from)).map_err(Error::io("read", from))? else { return Ok(()) };
    let meta = file.metadata().map_err(Error::io("read", from))?;
    let len = meta.len();
    let mut header = header_of(&meta, EntryType::Regular, len);
    let content = Exactly { file: &mut file, left: len };
    append(archive, &mut header, path, content)?;
    report.files += 1;
    report.bytes += len;
    Ok(())
}

/// The beginning of a file that may grow; one that became shorter is an error, because the archive has its length already.
struct Exactly<'a> {
    file: &'a mut File,
    left: u64,
}

impl Read for Exactly<'_> {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        let most = usize::try_from(self.left).unwrap_or(usize::MAX).min(buf.len());
        let Some(buf) = buf.get_mut(..most).filter(|buf| !buf.is_empty()) else { return Ok(0) };
        match self.file.read(buf)? {
            0 => Err(io::Error::new(ErrorKind::UnexpectedEof, "it became shorter meanwhile; begin again")),
            num_read => {
                self.left -= num_read as u64;
                Ok(num_read)
            }
        }
    }
}

fn append(archive: &mut Archive, header: &mut Header, path: &Path, content: impl Read) -> Result<(), Error> {
    archive.append_data(header, path, content).map_err(Error::io("copy", path))
}

fn header_of(meta: &fs::Metadata, kind: EntryType, len: u64) -> Header {
    let mut header = Header::new_gnu();
    header.set_entry_type(kind);
    header.set_mode(meta.mode() & 0o7777);
    header.set_mtime(meta.mtime().unsigned_abs());
    header.set_size(len);
    header
}

/// What may have been deleted meanwhile.
fn if_there<T>(found: io::Result<T>) -> io::Result<Option<T>> {
    match found {
        Ok(found) => Ok(Some(found)),
        Err(err) if err.kind() == ErrorKind::NotFound => Ok(None),
        Err(err) => Err(err),
    }
}

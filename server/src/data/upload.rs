//! Sessions that come in as a zip archive: of a CSV import folder, or of a session folder.

mod directory;
mod room;

use std::{
    fs::{self, File},
    io::{self, Read as _},
    path::{Path, PathBuf},
};

use palpate_recording::{
    Session,
    import::{self, ImportOptions, MAPPING_FILE, Mapping},
};
use tempfile::TempDir;

pub(crate) use self::room::{Slots, check_space, free_bytes};
use self::{
    directory::not_a_zip,
    room::{FreeBytes, Slot, SpaceWriter},
};
use crate::{Class, Error, Store, assets, chain};

/// Largest archive, bytes.
pub(crate) const MAX_ARCHIVE_BYTES: u64 = 512 << 20;
/// Largest content of an archive, bytes: a small archive must not fill the disk.
const MAX_CONTENT_BYTES: u64 = 4 << 30;
/// Longest part of an entry's name that a message shows, characters.
const MAX_SHOWN_CHARS: usize = 60;
/// How the folder of an upload in progress begins.
const INCOMING: &str = ".incoming-";

/// A folder on the data's file system for an upload in progress, and the upload's place among those; both go when this is
/// dropped.
pub(crate) struct Incoming {
    dir: TempDir,
    _slot: Slot,
}

impl Incoming {
    /// The folder.
    pub(crate) fn path(&self) -> &Path {
        self.dir.path()
    }
}

/// Begins an upload of `archive_bytes`, if that is known; refused if there are too many or if the disk is full.
pub(crate) fn incoming(store: &Store, archive_bytes: Option<u64>) -> Result<Incoming, Error> {
    let slot = store.uploads().take()?;
    check_space(free_bytes(store.root()), archive_bytes.unwrap_or(0))?;
    let dir = tempfile::Builder::new()
        .prefix(INCOMING)
        .tempdir_in(store.root())
        .map_err(Error::io("make", store.root()))?;
    Ok(Incoming { dir, _slot: slot })
}

/// Removes what uploads left in the data folder when their studio was killed.
pub(crate) fn remove_leftovers(root: &Path) -> Result<(), Error> {
    for entry in fs::read_dir(root).map_err(Error::io("read", root))? {
        let entry = entry.map_err(Error::io("read", root))?;
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        if is_folder && entry.file_name().to_string_lossy().starts_with(INCOMING) {
            let path = entry.path();
            match fs::remove_dir_all(&path) {
                Ok(()) => tracing::info!(path = %path.display(), "removed what a broken-off upload left"),
                Err(err) => {
                    tracing::warn!(path = %path.display(), %err, "failed to remove a broken-off upload");
                }
            }
        }
    }
    Ok(())
}

/// Makes session `name` of the archive at `archive`, which lies in `incoming`. On an error the sessions are as they were.
pub(crate) fn add_session(
    store: &Store,
    incoming: &Incoming,
    archive: &Path,
    name: &str,
    station_id: Option<&str>,
) -> Result<Session, Error> {
    // Refused before anything is unpacked.
    store.free_session_dir(name)?;
    let content = incoming.path().join("content");
    let free = || free_bytes(store.root());
    let within = |err: Error| as_client_knows(err, &[incoming.path()]);
    extract(archive, &content, MAX_CONTENT_BYTES, &free).map_err(within)?;
    let root = content_root(&content).map_err(within)?;
    let as_seen_by_sender = |err: Error| match as_client_knows(err, &[&root, &content, incoming.path()]) {
        // A file that is missing is missing in the archive, which is the content that was sent.
        Error::Shown { class: Class::BadArgument, message } => Error::Content(message),
        err => err,
    };
    if root.join("session.toml").exists() {
        let session = Session::open(&root).map_err(Error::from).map_err(as_seen_by_sender)?;
        for take_idx in 0..session.file.takes.len() {
            session.take(take_idx).map_err(Error::from).map_err(as_seen_by_sender)?;
        }
        return store.adopt_session(name, &root);
    }
    let beside = root.join(MAPPING_FILE);
    let mapping = beside.exists().then(|| Mapping::read(&beside)).transpose();
    let mapping = mapping.map_err(Error::from).map_err(as_seen_by_sender)?;
    // A station file in an archive would be read as a path of this computer.
    let station_id = station_id.or(mapping.as_ref().and_then(Mapping::station));
    let station = match station_id {
        Some(id) => assets::station(id)?,
        None => assets::station_of_recordings(&root, mapping.as_ref()).map_err(as_seen_by_sender)?.0,
    };
    let imported = incoming.path().join("session");
    check_space(free(), 0)?;
    let options = ImportOptions { mapping: mapping.as_ref(), find_repetitions: true };
    import::import(&station, &root, options, &imported).map_err(Error::from).map_err(as_seen_by_sender)?;
    store.adopt_session(name, &imported)
}

/// Unpacks `archive` into the new folder `dir`. Entries that would land outside it, and links, are refused. `free` says
/// what is left of the disk.
fn extract(archive: &Path, dir: &Path, max_bytes: u64, free: FreeBytes<'_>) -> Result<(), Error> {
    let mut archive = directory::open(archive)?;
    fs::create_dir(dir).map_err(Error::io("make", dir))?;
    let mut left = max_bytes;
    for idx in 0..archive.len() {
        let mut entry = archive.by_index(idx).map_err(not_a_zip)?;
        let shown = shown(entry.name());
        let Some(name) = entry.enclosed_name() else {
            return Err(Error::Content(format!(
                "entry {shown} of the archive lies outside of its folder; zip the session's folder itself"
            )));
        };
        if entry.is_symlink() {
            return Err(Error::Content(format!(
                "entry {shown} of the archive is a link; put the file itself in"
            )));
        }
        // What Finder adds.
        if name.starts_with("__MACOSX") {
            continue;
        }
        let refused = |err: io::Error| entry_refused(&shown, &err);
        let path = dir.join(name);
        if entry.is_dir() {
            fs::create_dir_all(&path).map_err(refused)?;
            continue;
        }
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).map_err(refused)?;
        }
        let mut out = SpaceWriter::new(File::create(&path).map_err(refused)?, free);
        let mut buffer = vec![0; 256 << 10];
        loop {
            let read = entry.read(&mut buffer).map_err(|err| {
                Error::Content(format!(
                    "entry {shown} of the archive is damaged: {err}; make the archive again"
                ))
            })?;
            if read == 0 {
                break;
            }
            // The size in the header may lie.
            left = left.checked_sub(read as u64).ok_or_else(|| {
                Error::TooLarge(format!(
                    "the archive holds more than {} MB; upload fewer takes at a time",
                    max_bytes / 1_000_000
                ))
            })?;
            out.write_all(&buffer[..read])?.map_err(refused)?;
        }
    }
    Ok(())
}

/// An entry's name for messages, which may be very long.
fn shown(name: &str) -> String {
    match name.char_indices().nth(MAX_SHOWN_CHARS) {
        Some((end, _)) => format!("{:?}... ({} bytes)", &name[..end], name.len()),
        None => format!("{name:?}"),
    }
}

/// Why an entry called `shown` could not be unpacked, in words that name nothing of this computer.
fn entry_refused(shown: &str, err: &io::Error) -> Error {
    use io::ErrorKind::{
        AlreadyExists, InvalidFilename, InvalidInput, IsADirectory, NotADirectory, QuotaExceeded, StorageFull,
    };
    match err.kind() {
        InvalidFilename | InvalidInput => Error::Content(format!(
            "entry {shown} of the archive has a name that is no file name here ({err}); give it a shorter or plainer one"
        )),
        AlreadyExists | IsADirectory | NotADirectory => Error::Content(format!(
            "entry {shown} of the archive is both a file and a folder ({err}); make the archive again"
        )),
        StorageFull | QuotaExceeded => Error::DiskFull(format!(
            "the studio's disk is full, so entry {shown} of the archive could not be unpacked; free some space there"
        )),
        _ => Error::Internal(format!("failed to unpack entry {shown} of the archive: {err}")),
    }
}

/// The folder in which the takes lie: archives often hold one folder around everything.
fn content_root(dir: &Path) -> Result<PathBuf, Error> {
    let mut root = dir.to_owned();
    loop {
        let mut entries = Vec::new();
        for entry in fs::read_dir(&root).map_err(Error::io("read", &root))? {
            let entry = entry.map_err(Error::io("read", &root))?;
            if !entry.file_name().to_string_lossy().starts_with('.') {
                entries.push(entry.path());
            }
        }
        match &entries[..] {
            [] => return Err(Error::Content("the archive is empty; zip a folder with takes".to_owned())),
            [only]
                if only.is_dir()
                    && !["joints.csv", "joints.parquet", "take.toml"]
                        .iter()
                        .any(|file| only.join(file).exists()) =>
            {
                root = only.clone();
            }
            _ => return Ok(root),
        }
    }
}

/// `err` without these `folders` before the names of files: a client has never seen the studio's folders. The first folder
/// in which a file lies counts.
pub(crate) fn as_client_knows(err: Error, folders: &[&Path]) -> Error {
    let message = chain(&err);
    let mut shown = message.clone();
    for folder in folders.iter().map(|folder| folder.display().to_string()) {
        shown = without_folder(&shown, &folder);
    }
    if shown == message {
        return err;
    }
    if err.class() == Class::Failed {
        // With its paths, for whoever mends it.
        tracing::error!(err = message, "a request failed");
    }
    Error::Shown { class: err.class(), message: shown }
}

/// `message` without `folder` wherever a path begins with it. The folder itself is called "the data".
fn without_folder(message: &str, folder: &str) -> String {
    let mut shown = String::with_capacity(message.len());
    let mut rest = message;
    while let Some(begin) = rest.find(folder).filter(|_| !folder.is_empty()) {
        let end = begin + folder.len();
        let part_of_path = |c: char| c.is_alphanumeric() || "/._-".contains(c);
        let begins_path =
            !rest[..begin].chars().next_back().or(shown.chars().next_back()).is_some_and(part_of_path);
        let after = &rest[end..];
        shown.push_str(&rest[..begin]);
        rest = match after.strip_prefix('/') {
            Some(name) if begins_path => name,
            None if begins_path && !after.starts_with(part_of_path) => {
                shown.push_str("the data");
                after
            }
            _ => {
                shown.push_str(folder);
                after
            }
        };
    }
    shown + rest
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use zip::{ZipWriter, write::SimpleFileOptions};

    use super::*;

    fn plenty() -> Option<u64> {
        Some(u64::MAX)
    }

    fn zip_of(dir: &Path, entries: &[(&str, &[u8])]) -> PathBuf {
        let path = dir.join("upload.zip");
        let mut writer = ZipWriter::new(File::create(&path).unwrap());
        for (name, bytes) in entries {
            writer.start_file(*name, SimpleFileOptions::default()).unwrap();
            writer.write_all(bytes).unwrap();
        }
        writer.finish().unwrap();
        path
    }

    #[test]
    fn entries_outside_the_folder_are_refused() {
        for name in ["../evil.txt", "a/../../evil.txt", "/etc/evil.txt"] {
            let dir = tempfile::tempdir().unwrap();
            let archive = zip_of(dir.path(), &[(name, b"x")]);
            let target = dir.path().join("in").join("content");
            fs::create_dir(dir.path().join("in")).unwrap();
            // An absolute name may also be taken as relative; what counts is that nothing lands outside.
            let result = extract(&archive, &target, 100, &plenty);
            assert!(result.is_err() || target.join("etc/evil.txt").exists(), "{name}");
            assert!(!dir.path().join("in/evil.txt").exists() && !dir.path().join("evil.txt").exists());
            assert!(!Path::new("/etc/evil.txt").exists());
        }
    }

    #[test]
    fn links_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let archive = dir.path().join("upload.zip");
        let mut writer = ZipWriter::new(File::create(&archive).unwrap());
        writer.add_symlink("take-01", "/etc", SimpleFileOptions::default()).unwrap();
        writer.finish().unwrap();
        let err = extract(&archive, &dir.path().join("content"), 100, &plenty).unwrap_err();
        assert!(err.to_string().contains("link"), "{err}");
    }

    #[test]
    fn content_beyond_the_limit_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let archive = zip_of(dir.path(), &[("a", &[0; 60]), ("b", &[0; 60])]);
        let err = extract(&archive, &dir.path().join("content"), 100, &plenty).unwrap_err();
        assert!(matches!(err, Error::TooLarge(_)), "{err}");
        extract(&archive, &dir.path().join("again"), 120, &plenty).unwrap();
    }

    #[test]
    fn folder_around_the_takes_is_looked_through() {
        let dir = tempfile::tempdir().unwrap();
        let archive = zip_of(dir.path(), &[("session/take-01/joints.csv", b"t_s"), ("__MACOSX/x", b"")]);
        let content = dir.path().join("content");
        extract(&archive, &content, 100, &plenty).unwrap();
        assert_eq!(content_root(&content).unwrap(), content.join("session"));
        let dir = tempfile::tempdir().unwrap();
        let archive = zip_of(dir.path(), &[("take-01/joints.csv", b"t_s")]);
        let content = dir.path().join("content");
        extract(&archive, &content, 100, &plenty).unwrap();
        assert_eq!(content_root(&content).unwrap(), content);
    }

    #[test]
    fn names_that_cannot_be_files_are_the_archives_fault() {
        let long = "n".repeat(300);
        for (entries, words) in [
            (vec![(long.as_str(), &b"x"[..])], "(300 bytes) of the archive has a name"),
            (vec![("a", &b"x"[..]), ("a/b", b"x")], "\"a/b\" of the archive is both a file and a folder"),
            (vec![("a/b", &b"x"[..]), ("a", b"x")], "\"a\" of the archive is both a file and a folder"),
        ] {
            let dir = tempfile::tempdir().unwrap();
            let archive = zip_of(dir.path(), &entries);
            let err = extract(&archive, &dir.path().join("content"), 100, &plenty).unwrap_err();
            let message = chain(&err);
            assert_eq!(err.class(), Class::BadContent, "{message}");
            assert!(message.contains(words), "{message}");
            assert!(!message.contains(&dir.path().display().to_string()), "{message}");
        }
    }

    #[test]
    fn unpacking_ends_while_recordings_have_space() {
        let dir = tempfile::tempdir().unwrap();
        let archive = zip_of(dir.path(), &[("a", &[0; 60])]);
        let err = extract(&archive, &dir.path().join("content"), 100, &|| Some(1000)).unwrap_err();
        assert!(matches!(err, Error::DiskFull(_)), "{err}");
    }

    #[test]
    fn messages_name_files_as_clients_do() {
        for (message, shown) in [
            (
                "failed to read \"/srv/data/sessions/a/b.mcap\": gone",
                "failed to read \"sessions/a/b.mcap\": gone",
            ),
            ("/srv/data/x.toml: line 3", "x.toml: line 3"),
            ("failed to make \"/srv/data\"", "failed to make \"the data\""),
            ("/other/srv/data/x and /srv/database/y", "/other/srv/data/x and /srv/database/y"),
        ] {
            assert_eq!(without_folder(message, "/srv/data"), shown);
        }
        assert_eq!(without_folder("metadata/x: data/y", "data"), "metadata/x: y");
        assert_eq!(without_folder("x", ""), "x");
    }

    #[test]
    fn leftovers_of_uploads_go_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir_all(dir.path().join(".incoming-abc/content")).unwrap();
        fs::create_dir(dir.path().join("sessions")).unwrap();
        std::os::unix::fs::symlink("sessions", dir.path().join(".incoming-link")).unwrap();
        remove_leftovers(dir.path()).unwrap();
        assert!(!dir.path().join(".incoming-abc").exists());
        assert!(dir.path().join("sessions").exists() && dir.path().join(".incoming-link").exists());
    }
}

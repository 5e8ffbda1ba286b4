//! Sessions that come in as a zip archive: of a CSV import folder, or of a session folder.

use std::{
    fs::{self, File},
    io::{self, Read as _},
    path::{Path, PathBuf},
};

use palpate_recording::{Session, import::import_csv};
use tempfile::TempDir;
use zip::{ZipArchive, result::ZipError};

use crate::{Error, Store, assets, chain};

/// Largest archive, bytes.
pub(crate) const MAX_ARCHIVE_BYTES: u64 = 512 << 20;
/// Largest content of an archive, bytes: a small archive must not fill the disk.
const MAX_CONTENT_BYTES: u64 = 4 << 30;
/// Most entries of an archive.
const MAX_ENTRIES: usize = 10_000;

/// A folder on the data's file system for an upload in progress; it goes with everything in it when dropped.
pub(crate) fn incoming(store: &Store) -> Result<TempDir, Error> {
    tempfile::Builder::new()
        .prefix(".incoming-")
        .tempdir_in(store.root())
        .map_err(Error::io("make", store.root()))
}

/// Makes session `name` of the archive at `archive`, which lies in `incoming`. On an error the sessions are as they were.
pub(crate) fn add_session(
    store: &Store,
    incoming: &TempDir,
    archive: &Path,
    name: &str,
    station_id: Option<&str>,
) -> Result<Session, Error> {
    // Refused before anything is unpacked.
    store.free_session_dir(name)?;
    let content = incoming.path().join("content");
    extract(archive, &content, MAX_CONTENT_BYTES)?;
    let root = content_root(&content)?;
    let as_seen_by_sender = |err: Error| without_folder(err, &root);
    if root.join("session.toml").exists() {
        let session = Session::open(&root).map_err(Error::from).map_err(as_seen_by_sender)?;
        for take_idx in 0..session.file.takes.len() {
            session.take(take_idx).map_err(Error::from).map_err(as_seen_by_sender)?;
        }
        return store.adopt_session(name, &root);
    }
    let station = station_id.map_or_else(|| assets::station_of_recordings(&root), assets::station)?;
    let imported = incoming.path().join("session");
    import_csv(&station, &root, &imported).map_err(Error::from).map_err(as_seen_by_sender)?;
    store.adopt_session(name, &imported)
}

/// Unpacks `archive` into the new folder `dir`. Entries that would land outside it, and links, are refused.
fn extract(archive: &Path, dir: &Path, max_bytes: u64) -> Result<(), Error> {
    let file = File::open(archive).map_err(Error::io("read", archive))?;
    let mut archive = ZipArchive::new(file).map_err(not_a_zip)?;
    if archive.len() > MAX_ENTRIES {
        return Err(Error::TooLarge(format!(
            "the archive has {} entries, more than {MAX_ENTRIES}; upload fewer takes at a time",
            archive.len()
        )));
    }
    fs::create_dir(dir).map_err(Error::io("make", dir))?;
    let mut left = max_bytes;
    for idx in 0..archive.len() {
        let mut entry = archive.by_index(idx).map_err(not_a_zip)?;
        let shown = entry.name().to_owned();
        let Some(name) = entry.enclosed_name() else {
            return Err(Error::Content(format!(
                "entry {shown:?} of the archive lies outside of its folder; zip the session's folder itself"
            )));
        };
        if entry.is_symlink() {
            return Err(Error::Content(format!(
                "entry {shown:?} of the archive is a link; put the file itself in"
            )));
        }
        // What Finder adds.
        if name.starts_with("__MACOSX") {
            continue;
        }
        let path = dir.join(name);
        if entry.is_dir() {
            fs::create_dir_all(&path).map_err(Error::io("make", &path))?;
            continue;
        }
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).map_err(Error::io("make", parent))?;
        }
        let mut out = File::create(&path).map_err(Error::io("write", &path))?;
        // One byte more than allowed tells "just fits" from "too large"; the size in the header may lie.
        let copied = io::copy(&mut entry.by_ref().take(left + 1), &mut out).map_err(|err| {
            Error::Content(format!(
                "entry {shown:?} of the archive is damaged: {err}; make the archive again"
            ))
        })?;
        if copied > left {
            return Err(Error::TooLarge(format!(
                "the archive holds more than {} MB; upload fewer takes at a time",
                max_bytes / 1_000_000
            )));
        }
        left -= copied;
    }
    Ok(())
}

fn not_a_zip(err: ZipError) -> Error {
    Error::Content(format!("the upload is not a readable zip archive: {err}; zip the folder and try again"))
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
                if only.is_dir() && !only.join("joints.csv").exists() && !only.join("take.toml").exists() =>
            {
                root = only.clone();
            }
            _ => return Ok(root),
        }
    }
}

/// The message of `err` with paths as they are in the archive: the sender has never seen the server's folders.
fn without_folder(err: Error, folder: &Path) -> Error {
    if !matches!(err.class(), crate::Class::BadContent | crate::Class::BadArgument) {
        return err;
    }
    let folder = folder.display().to_string();
    Error::Content(chain(&err).replace(&format!("{folder}/"), "").replace(&folder, "archive"))
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use zip::{ZipWriter, write::SimpleFileOptions};

    use super::*;

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
            let result = extract(&archive, &target, 100);
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
        let err = extract(&archive, &dir.path().join("content"), 100).unwrap_err();
        assert!(err.to_string().contains("link"), "{err}");
    }

    #[test]
    fn content_beyond_the_limit_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let archive = zip_of(dir.path(), &[("a", &[0; 60]), ("b", &[0; 60])]);
        let err = extract(&archive, &dir.path().join("content"), 100).unwrap_err();
        assert!(matches!(err, Error::TooLarge(_)), "{err}");
        extract(&archive, &dir.path().join("again"), 120).unwrap();
    }

    #[test]
    fn folder_around_the_takes_is_looked_through() {
        let dir = tempfile::tempdir().unwrap();
        let archive = zip_of(dir.path(), &[("session/take-01/joints.csv", b"t_s"), ("__MACOSX/x", b"")]);
        let content = dir.path().join("content");
        extract(&archive, &content, 100).unwrap();
        assert_eq!(content_root(&content).unwrap(), content.join("session"));
        let dir = tempfile::tempdir().unwrap();
        let archive = zip_of(dir.path(), &[("take-01/joints.csv", b"t_s")]);
        let content = dir.path().join("content");
        extract(&archive, &content, 100).unwrap();
        assert_eq!(content_root(&content).unwrap(), content);
    }
}

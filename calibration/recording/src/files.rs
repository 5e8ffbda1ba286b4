//! Files that appear whole or not at all, and reading that never waits and never takes more than it was given.

use std::{
    fs::{self, File},
    io::{self, BufWriter, Read as _, Write as _},
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

use rustix::fs::{Mode, OFlags};

use crate::RecordingError;

/// Largest text that is read: session, recording, station, object and model files, bytes. They have kilobytes.
pub const MAX_TEXT_BYTES: u64 = 16 << 20;
/// Largest take or table of readings that is read, bytes: it is read into memory whole.
pub const MAX_TAKE_BYTES: u64 = 4 << 30;

/// Largest file that a station names, bytes: a mesh, mostly.
pub const MAX_STATION_FILE_BYTES: u64 = 256 << 20;

/// Reads the regular file at `path`, or the one that a link leads to, of at most `max_bytes`.
///
/// Refuses pipes, devices and sockets before they are opened, because reading those may wait for another process or never
/// end.
pub fn read_file(path: &Path, max_bytes: u64) -> Result<Vec<u8>, RecordingError> {
    let file = open_file(path)?;
    let len = file.metadata().map_err(RecordingError::io("read", path))?.len();
    let mut bytes = Vec::with_capacity(usize::try_from(len.min(max_bytes)).unwrap_or_default());
    // One byte more than allowed tells "just fits" from "too large"; the file may still grow.
    file.take(max_bytes.saturating_add(1))
        .read_to_end(&mut bytes)
        .map_err(RecordingError::io("read", path))?;
    if bytes.len() as u64 > max_bytes {
        let problem = format!(
            "is larger than {max_bytes} bytes, which is the most that is read; is it the right file?"
        );
        return Err(RecordingError::content(path, "file", problem));
    }
    Ok(bytes)
}

/// Opens the regular file at `path`, or the one that a link leads to, for reading. See [`read_file`].
pub fn open_file(path: &Path) -> Result<File, RecordingError> {
    let refuse_special = |meta: &fs::Metadata| match kind(meta) {
        None => Ok(()),
        Some(kind) => {
            let problem = format!("is {kind}, expected a regular file; put the file itself here");
            Err(RecordingError::content(path, "file", problem))
        }
    };
    // Asked first, because opening some devices does something already.
    refuse_special(&fs::metadata(path).map_err(RecordingError::io("read", path))?)?;
    let file = rustix::fs::open(path, OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC, Mode::empty())
        .map(File::from)
        .map_err(|errno| RecordingError::io("read", path)(errno.into()))?;
    refuse_special(&file.metadata().map_err(RecordingError::io("read", path))?)?;
    Ok(file)
}

/// As [`read_file`], for text.
pub fn read_text(path: &Path, max_bytes: u64) -> Result<String, RecordingError> {
    String::from_utf8(read_file(path, max_bytes)?).map_err(|_| {
        let source = io::Error::new(io::ErrorKind::InvalidData, "not UTF-8 text");
        RecordingError::io("read", path)(source)
    })
}

/// Where `path` really lies, all links followed; refused where that is not in `folder`.
pub fn resolve_in(folder: &Path, path: &Path) -> Result<PathBuf, RecordingError> {
    let real = path.canonicalize().map_err(RecordingError::io("read", path))?;
    let home = folder.canonicalize().map_err(RecordingError::io("read", folder))?;
    if !real.starts_with(&home) {
        let problem = format!(
            "is a link that leads out of the folder {:?}; put the file itself there",
            home.file_name().unwrap_or_default().to_string_lossy()
        );
        return Err(RecordingError::content(path, "link", problem));
    }
    Ok(real)
}

/// What `meta` is, where that is no regular file.
fn kind(meta: &fs::Metadata) -> Option<&'static str> {
    use std::os::unix::fs::FileTypeExt as _;
    let kind = meta.file_type();
    if kind.is_file() {
        None
    } else if kind.is_dir() {
        Some("a folder")
    } else if kind.is_fifo() {
        Some("a named pipe")
    } else if kind.is_socket() {
        Some("a socket")
    } else {
        Some("a device")
    }
}

/// Names of more bytes than this do not fit into a file name together with a suffix.
pub const MAX_NAME_BYTES: usize = 120;

/// Refuses what is not the plain name of an entry in a folder, such as the id of a session, and says what is wrong with it.
pub fn check_name(name: &str) -> Result<(), String> {
    let problem = if name.is_empty() {
        "is empty"
    } else if name.len() > MAX_NAME_BYTES {
        "is too long"
    } else if name.starts_with('.') {
        "begins with a dot"
    } else if name.contains(['/', '\\', ':']) || name.chars().any(char::is_control) {
        "contains a slash, a colon or a control character"
    } else {
        return Ok(());
    };
    Err(format!("{problem}; expected a plain name such as \"sphere-1\", of at most {MAX_NAME_BYTES} bytes"))
}

/// Puts `text` at `path`: every reader finds the old text or the new one, even after a crash or a power cut.
pub fn replace_file(path: &Path, text: &str) -> Result<(), RecordingError> {
    replace_file_with(path, |sink| sink.write_all(text.as_bytes()).map_err(RecordingError::io("write", path)))
}

/// Puts what `write` writes at `path`: a hidden file beside it first, which then takes its place. After an error the folder
/// is as it was.
pub fn replace_file_with<E: From<RecordingError>>(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> Result<(), E>,
) -> Result<(), E> {
    let partial = sibling(path);
    let failed = || RecordingError::io("write", path);
    let written = (|| {
        let mut sink = BufWriter::new(File::create_new(&partial).map_err(failed())?);
        write(&mut sink)?;
        sink.flush().map_err(failed())?;
        sink.get_ref().sync_all().map_err(failed())?;
        fs::rename(&partial, path).map_err(failed())?;
        Ok(())
    })();
    match written {
        Ok(()) => sync_folder(path),
        // The old content is still in place; a leftover beside it helps nobody.
        Err(_) => drop(fs::remove_file(&partial)),
    }
    written
}

/// Makes names that appeared or changed beside `path` survive a power cut, where the file system can.
pub(crate) fn sync_folder(path: &Path) {
    // Some file systems refuse to sync a folder; the names are right all the same unless the power fails now.
    let _ = path.parent().and_then(|dir| File::open(dir).ok()).map(|dir| dir.sync_all());
}

/// A hidden name beside `path` that nobody else uses.
pub(crate) fn sibling(path: &Path) -> PathBuf {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    let count = COUNTER.fetch_add(1, Ordering::Relaxed);
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    path.with_file_name(format!(".{name}.partial-{}-{count}", std::process::id()))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use rustix::fs::{CWD, FileType, mknodat};

    use super::*;

    fn fifo(path: &Path) {
        mknodat(CWD, path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).expect("a pipe is made");
    }

    #[test]
    fn special_files_are_refused_without_waiting() {
        let dir = tempfile::tempdir().unwrap();
        let pipe = dir.path().join("pipe");
        fifo(&pipe);
        let _socket = std::os::unix::net::UnixListener::bind(dir.path().join("socket")).unwrap();
        symlink("/dev/zero", dir.path().join("zero")).unwrap();
        for (name, kind) in
            [("pipe", "a named pipe"), ("socket", "a socket"), ("zero", "a device"), ("", "a folder")]
        {
            let error = read_file(&dir.path().join(name), 100).unwrap_err().to_string();
            assert!(error.contains(kind) && error.contains("expected a regular file"), "{error}");
        }
    }

    #[test]
    fn no_more_is_read_than_allowed() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("file");
        fs::write(&path, [b'x'; 100]).unwrap();
        assert_eq!(read_file(&path, 100).unwrap().len(), 100);
        let error = read_text(&path, 99).unwrap_err().to_string();
        assert!(error.contains("file: is larger than 99 bytes"), "{error}");
        // A file of a terabyte that takes no space.
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        assert!(read_file(&path, 1000).is_err());
    }

    #[test]
    fn links_are_followed_within_the_folder_alone() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("in");
        fs::create_dir(&folder).unwrap();
        fs::write(dir.path().join("secret"), "x").unwrap();
        fs::write(folder.join("a"), "x").unwrap();
        symlink("a", folder.join("inside")).unwrap();
        symlink("../secret", folder.join("outside")).unwrap();
        symlink("loop", folder.join("loop")).unwrap();
        assert_eq!(resolve_in(&folder, &folder.join("inside")).unwrap().file_name().unwrap(), "a");
        let error = resolve_in(&folder, &folder.join("outside")).unwrap_err().to_string();
        assert!(error.contains("leads out of the folder \"in\""), "{error}");
        assert!(resolve_in(&folder, &folder.join("../secret")).is_err());
        assert!(resolve_in(&folder, &folder.join("loop")).is_err());
    }

    #[test]
    fn failed_write_leaves_the_folder_as_it_was() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("model.toml");
        replace_file(&path, "old").unwrap();
        let result = replace_file_with(&path, |sink| {
            sink.write_all(b"half").map_err(RecordingError::io("write", &path))?;
            Err(RecordingError::content(&path, "half", "is enough"))
        });
        assert!(result.unwrap_err().to_string().contains("is enough"));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
        replace_file(&path, "new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
    }
}

//! Files that appear whole or not at all, and names that stay in their folder.

use std::{
    fs::{self, File},
    io::{BufWriter, Write as _},
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

use crate::Error;

/// Names of more bytes than this do not fit into a file name together with a suffix.
const MAX_ID_BYTES: usize = 120;

/// Writes `path` through `write`: a hidden file beside it first, which then takes its place. After an error the folder is
/// as it was.
pub fn write_with<E: Into<Error>>(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> Result<(), E>,
) -> Result<(), Error> {
    let partial = partial_of(path)?;
    let result = (|| {
        let file = File::create_new(&partial).map_err(Error::io("write", path))?;
        let mut sink = BufWriter::new(file);
        write(&mut sink).map_err(Into::into)?;
        sink.flush().map_err(Error::io("write", path))?;
        sink.get_ref().sync_all().map_err(Error::io("write", path))?;
        fs::rename(&partial, path).map_err(Error::io("write", path))
    })();
    if result.is_err() {
        // The error is what matters; a hidden leftover harms nothing.
        let _ = fs::remove_file(&partial);
    }
    result
}

/// Writes `bytes` to `path`, atomically.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    write_with(path, |sink| sink.write_all(bytes).map_err(Error::io("write", path)))
}

/// Refuses what cannot become a file, before the work whose result it is to hold.
pub fn check_target(path: &Path) -> Result<(), Error> {
    if path.file_name().is_none() {
        return Err(Error::Argument(format!("{path:?} names no file; give the path of the file to write")));
    }
    if path.is_dir() {
        return Err(Error::Argument(format!("{path:?} is a folder; give the path of the file to write")));
    }
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() && !folder.is_dir() => {
            Err(Error::Argument(format!("no folder {folder:?} to write {path:?} into; make it first")))
        }
        _ => Ok(()),
    }
}

/// A hidden name beside `path` that nobody else uses.
fn partial_of(path: &Path) -> Result<PathBuf, Error> {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    check_target(path)?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let unique = COUNT.fetch_add(1, Ordering::Relaxed);
    Ok(path.with_file_name(format!(".{name}.{}-{unique}.partial", std::process::id())))
}

/// Refuses what is not the plain name of an entry in a folder.
pub fn check_id(what: &str, id: &str) -> Result<(), Error> {
    let problem = if id.is_empty() {
        "is empty"
    } else if id.len() > MAX_ID_BYTES {
        "is too long"
    } else if id.starts_with('.') {
        "begins with a dot"
    } else if id.contains(['/', '\\', ':']) || id.chars().any(char::is_control) {
        "contains a slash, a colon or a control character"
    } else {
        return Ok(());
    };
    Err(Error::Argument(format!(
        "{what} {id:?} {problem}; expected a plain name such as \"sphere-1\", of at most {MAX_ID_BYTES} bytes"
    )))
}

/// A file name made from a name for people: small letters, digits and dashes.
pub fn slug(name: &str) -> Result<String, Error> {
    let mut slug = String::new();
    for c in name.chars() {
        if c.is_alphanumeric() {
            slug.extend(c.to_lowercase());
        } else if !slug.is_empty() && !slug.ends_with('-') {
            slug.push('-');
        }
    }
    let slug = slug.trim_end_matches('-');
    if slug.is_empty() {
        return Err(Error::Argument(format!("name {name:?} has no letter or digit; give another name")));
    }
    check_id("name", slug)?;
    Ok(slug.to_owned())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn failed_write_leaves_the_folder_as_it_was() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("model.toml");
        write(&path, b"old").unwrap();
        let result = write_with(&path, |sink| {
            sink.write_all(b"half").map_err(Error::io("write", &path))?;
            Err(Error::Cancelled)
        });
        assert!(matches!(result, Err(Error::Cancelled)));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
        write(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
    }

    #[test]
    fn folder_is_no_file_to_write() {
        let dir = tempfile::tempdir().unwrap();
        assert!(matches!(write(dir.path(), b""), Err(Error::Argument(_))));
    }

    #[test]
    fn ids_that_leave_their_folder_are_refused() {
        for id in ["", ".", "..", "../x", "a/b", "a\\b", ".hidden", "a\0b", "a\nb", "c:x"] {
            assert!(check_id("session", id).is_err(), "{id:?}");
        }
        for id in ["demo", "Sphere 1", "take-03", "kugel_ä", "a..b"] {
            assert!(check_id("session", id).is_ok(), "{id:?}");
        }
    }

    proptest! {
        #[test]
        fn every_id_that_passes_is_one_path_component(id in ".{0,200}") {
            if check_id("session", &id).is_ok() {
                let components: Vec<_> = Path::new(&id).components().collect();
                prop_assert!(matches!(components[..], [std::path::Component::Normal(name)] if name == id.as_str()));
            }
        }

        #[test]
        fn slug_is_an_id_and_its_own_slug(name in ".{0,40}") {
            if let Ok(made) = slug(&name) {
                prop_assert!(check_id("name", &made).is_ok());
                prop_assert_eq!(slug(&made).ok(), Some(made));
            }
        }
    }

    #[test]
    fn slug_reads_like_the_name() {
        assert_eq!(slug("Demo, exact (held out)").unwrap(), "demo-exact-held-out");
        assert!(slug("...").is_err());
    }
}

//! Targets of files that are written, and names that stay in their folder.

use std::{
    fs::File,
    io::{BufWriter, Write as _},
    os::unix::fs::MetadataExt as _,
    path::Path,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use palpate_recording::files::{check_name, replace_file_with};

use crate::Error;

/// Writes `path` through `write`; see [`replace_file_with`]. Refuses a `path` that names no file first.
pub fn write_with(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> Result<(), Error>,
) -> Result<(), Error> {
    check_target(path)?;
    replace_file_with(path, write)
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

/// Refuses what is not the plain name of an entry in a folder.
pub fn check_id(what: &str, id: &str) -> Result<(), Error> {
    check_name(id).map_err(|problem| Error::Argument(format!("{what} {id:?} {problem}")))
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

/// When what is at `path` was moved there, to the second.
pub(crate) fn moved_at(path: &Path) -> Result<SystemTime, Error> {
    let meta = path.symlink_metadata().map_err(Error::io("look at", path))?;
    let newest = meta.ctime().max(meta.mtime());
    Ok(UNIX_EPOCH + Duration::from_secs(u64::try_from(newest).unwrap_or(0)))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

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

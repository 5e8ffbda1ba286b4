//! A folder that appears whole or not at all.

use std::{
    fs,
    path::{Path, PathBuf},
    process,
};

use crate::ExportError;

/// A hidden folder beside the final one, which [`Draft::commit`] renames. Dropped without, it takes what was written
/// with it.
#[derive(Debug)]
pub(crate) struct Draft {
    partial_dir: PathBuf,
    dir: PathBuf,
    is_committed: bool,
}

impl Draft {
    /// Starts a folder that will lie at `dir`, where nothing may be yet.
    pub(crate) fn new(dir: &Path) -> Result<Self, ExportError> {
        refuse_existing(dir)?;
        let Some(name) = dir.file_name() else {
            let problem = format!("{} names no folder; give the folder to be made", dir.display());
            return Err(ExportError::Argument(problem));
        };
        let partial = format!(".{}.{}.partial", name.to_string_lossy(), process::id());
        let partial_dir = dir.with_file_name(partial);
        if let Some(parent) = partial_dir.parent().filter(|parent| !parent.as_os_str().is_empty()) {
            fs::create_dir_all(parent).map_err(ExportError::io("make", parent))?;
        }
        fs::create_dir(&partial_dir).map_err(ExportError::io("make", &partial_dir))?;
        Ok(Self { partial_dir, dir: dir.to_owned(), is_committed: false })
    }

    /// The path of `file` until [`Draft::commit`]; makes the folder that it lies in.
    pub(crate) fn path(&self, file: &str) -> Result<PathBuf, ExportError> {
        let path = self.partial_dir.join(file);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).map_err(ExportError::io("make", parent))?;
        }
        Ok(path)
    }

    /// Writes a text file.
    pub(crate) fn write(&self, file: &str, text: &str) -> Result<(), ExportError> {
        let path = self.path(file)?;
        fs::write(&path, text).map_err(ExportError::io("write", &path))
    }

    /// Puts the folder in its place.
    pub(crate) fn commit(mut self) -> Result<(), ExportError> {
        refuse_existing(&self.dir)?;
        fs::rename(&self.partial_dir, &self.dir).map_err(ExportError::io("make", &self.dir))?;
        self.is_committed = true;
        Ok(())
    }
}

impl Drop for Draft {
    fn drop(&mut self) {
        if !self.is_committed {
            // Nobody is left to tell, and a hidden leftover harms nothing.
            let _ = fs::remove_dir_all(&self.partial_dir);
        }
    }
}

fn refuse_existing(dir: &Path) -> Result<(), ExportError> {
    // Also true of a dangling link, unlike `exists`.
    match dir.symlink_metadata() {
        Ok(_) => Err(ExportError::Exists { path: dir.to_owned() }),
        Err(_) => Ok(()),
    }
}

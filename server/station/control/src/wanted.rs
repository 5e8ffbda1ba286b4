//! What is wanted and waits for a session, on disk, so that a restart does not lose it.

use std::{
    fs,
    io::ErrorKind,
    path::PathBuf,
    sync::{Mutex, PoisonError},
};

use palpate_recording::{RecordingError, replace_file};
use palpate_wire::api::WantedTake;

/// The file, a JSON array of [`WantedTake`]; there is none before something is wanted.
#[derive(Debug)]
pub(crate) struct WantedFile {
    path: PathBuf,
    written: Mutex<Vec<WantedTake>>,
}

impl WantedFile {
    /// Reads what was wanted last. A file that makes no sense is put aside, beside its place, and is spoken of in words.
    pub(crate) fn open(path: PathBuf) -> (Self, Option<String>) {
        let read = match fs::read_to_string(&path) {
            Ok(text) => serde_json::from_str::<Vec<WantedTake>>(&text).map_err(|error| error.to_string()),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(Vec::new()),
            Err(error) => Err(error.to_string()),
        };
        let (wanted, problem) = match read {
            Ok(wanted) => (wanted, None),
            Err(error) => {
                let aside = path.with_extension("unreadable.json");
                let then = match fs::rename(&path, &aside) {
                    Ok(()) => format!("it is {} now", aside.display()),
                    Err(rename) => format!("nor can it be put aside ({rename})"),
                };
                (
                    Vec::new(),
                    Some(format!("cannot read the wanted takes in {} ({error}); {then}", path.display())),
                )
            }
        };
        (Self { path, written: Mutex::new(wanted) }, problem)
    }

    /// What the file says.
    pub(crate) fn wanted(&self) -> Vec<WantedTake> {
        self.written.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Makes the file say what is `wanted` now.
    pub(crate) fn keep(&self, wanted: &[WantedTake]) -> Result<(), RecordingError> {
        let mut written = self.written.lock().unwrap_or_else(PoisonError::into_inner);
        if *written == wanted {
            return Ok(());
        }
        let text = serde_json::to_string_pretty(wanted).unwrap_or_default();
        replace_file(&self.path, &text)?;
        wanted.clone_into(&mut written);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn take(object: &str) -> WantedTake {
        WantedTake { object: object.to_owned(), primitive: "tap".to_owned(), because: "It tells.".to_owned() }
    }

    #[test]
    fn what_is_kept_is_read_again() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("wanted.json");
        let (file, problem) = WantedFile::open(path.clone());
        assert_eq!((file.wanted(), problem), (Vec::new(), None));
        file.keep(&[]).unwrap();
        assert!(!path.exists(), "nothing was wanted yet");
        file.keep(&[take("sphere"), take("cube")]).unwrap();
        file.keep(&[take("cube")]).unwrap();
        assert_eq!(WantedFile::open(path).0.wanted(), [take("cube")]);
    }

    #[test]
    fn what_cannot_be_read_is_put_aside_and_not_lost() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("wanted.json");
        fs::write(&path, r#"[{"object": "sphere"}]"#).unwrap();
        let (file, problem) = WantedFile::open(path.clone());
        assert!(file.wanted().is_empty());
        let problem = problem.expect("it is said");
        assert!(problem.contains("primitive") && problem.contains("wanted.unreadable.json"), "{problem}");
        assert!(dir.path().join("wanted.unreadable.json").exists() && !path.exists());
    }
}

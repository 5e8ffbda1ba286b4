//! A latched stop on disk, so that a restart does not forget it.

use std::{
    fs,
    io::{self, ErrorKind},
    path::{Path, PathBuf},
    sync::{Arc, Condvar, Mutex, PoisonError},
    thread::{self, JoinHandle},
};

use palpate_recording::replace_file;

/// Writes and removes the file of a latched stop from a thread of its own, because disks are slow at times.
#[derive(Debug)]
pub(crate) struct Latch {
    shared: Arc<Shared>,
    /// What the file says, or will say soon.
    latched: Option<String>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Shared {
    wish: Mutex<Wish>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct Wish {
    /// Who stopped the station, if it is stopped. `None` inside: no wish since the last one was carried out.
    newest: Option<Option<String>>,
    end: bool,
}

impl Latch {
    /// Reads the file at `path`; gives who had stopped the station when the program ended, if it was stopped. A file that
    /// cannot be read counts as a stop: somebody may have meant it.
    pub(crate) fn open(path: &Path) -> io::Result<(Self, Option<String>)> {
        let latched = match fs::read_to_string(path) {
            Ok(text) => Some(text.trim().to_owned()),
            Err(error) if error.kind() == ErrorKind::NotFound => None,
            Err(error) => Some(format!("an unreadable file {} ({error})", path.display())),
        };
        let shared = Arc::new(Shared::default());
        let thread = thread::Builder::new().name("stop-latch".to_owned()).spawn({
            let (shared, path) = (Arc::clone(&shared), path.to_owned());
            move || keep_file(&shared, &path)
        })?;
        Ok((Self { shared, latched: latched.clone(), thread: Some(thread) }, latched))
    }

    /// Makes the file say who stopped the station, `None` for nobody. Does not wait for the disk.
    pub(crate) fn set(&mut self, stopped_by: Option<&str>) {
        if self.latched.as_deref() == stopped_by {
            return;
        }
        self.latched = stopped_by.map(str::to_owned);
        self.wish(|wish| wish.newest = Some(stopped_by.map(str::to_owned)));
    }

    fn wish(&self, wish: impl FnOnce(&mut Wish)) {
        wish(&mut self.shared.wish.lock().unwrap_or_else(PoisonError::into_inner));
        self.shared.changed.notify_one();
    }
}

impl Drop for Latch {
    fn drop(&mut self) {
        self.wish(|wish| wish.end = true);
        if let Some(thread) = self.thread.take() {
            // A panic of the thread was printed when it happened.
            let _ = thread.join();
        }
    }
}

/// Carries out the newest wish until there will be none any more.
fn keep_file(shared: &Shared, path: &PathBuf) {
    loop {
        let mut wish = shared.wish.lock().unwrap_or_else(PoisonError::into_inner);
        while wish.newest.is_none() && !wish.end {
            wish = shared.changed.wait(wish).unwrap_or_else(PoisonError::into_inner);
        }
        let Some(stopped_by) = wish.newest.take() else { return };
        drop(wish);
        let done = match stopped_by {
            Some(who) => replace_file(path, &who).map_err(|error| error.to_string()),
            None => match fs::remove_file(path) {
                Err(error) if error.kind() != ErrorKind::NotFound => Err(error.to_string()),
                _ => Ok(()),
            },
        };
        if let Err(problem) = done {
            tracing::error!(?path, problem, "a restart would not know whether the station is stopped");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_outlives_the_program_until_it_is_reset() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("stop.txt");
        let (mut latch, stopped_by) = Latch::open(&path).unwrap();
        assert_eq!(stopped_by, None);
        latch.set(None);
        latch.set(Some("Ada"));
        drop(latch);
        let (mut latch, stopped_by) = Latch::open(&path).unwrap();
        assert_eq!(stopped_by.as_deref(), Some("Ada"));
        latch.set(Some("Ben"));
        latch.set(None);
        drop(latch);
        assert_eq!(Latch::open(&path).unwrap().1, None);
        assert!(!path.exists());
        fs::create_dir(&path).unwrap();
        assert!(Latch::open(&path).unwrap().1.expect("it counts as a stop").contains("unreadable"));
    }
}

//! A pseudo-terminal behind a link with a name that stays.

use std::ffi::OsString;
use std::fs;
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::ffi::OsStringExt as _;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, QueueSelector, tcflush, tcgetattr, tcsetattr};

use super::PortsError;

/// Most bytes read at once.
const CHUNK: usize = 4096;

/// The device's end of a serial line. The link goes when this is dropped.
pub(super) struct Terminal {
    master: OwnedFd,
    link: PathBuf,
    /// Where the link leads.
    target: PathBuf,
    has_client: bool,
}

impl Terminal {
    /// A raw terminal, and `link` to the end that clients open.
    pub(super) fn open(link: &Path) -> Result<Self, PortsError> {
        let failed = |source: rustix::io::Errno| PortsError::io("make a pseudo-terminal for", link, source);
        let master =
            openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).map_err(failed)?;
        grantpt(&master).map_err(failed)?;
        unlockpt(&master).map_err(failed)?;
        let name = ptsname(&master, Vec::new()).map_err(failed)?;
        let target = PathBuf::from(OsString::from_vec(name.into_bytes()));
        // Bytes pass as they are, and nothing comes back as an echo, whatever a client sets or forgets to set.
        let mut settings = tcgetattr(&master).map_err(failed)?;
        settings.make_raw();
        tcsetattr(&master, OptionalActions::Now, &settings).map_err(failed)?;
        let flags = fcntl_getfl(&master).map_err(failed)?;
        fcntl_setfl(&master, flags | OFlags::NONBLOCK).map_err(failed)?;
        // A line nobody has opened yet looks as if it had a client; one that opens and closes it makes it look free.
        fs::OpenOptions::new()
            .read(true)
            .open(&target)
            .map_err(|source| PortsError::io("open the pseudo-terminal", &target, source))?;
        match fs::symlink_metadata(link) {
            Ok(metadata) if metadata.file_type().is_symlink() => {
                fs::remove_file(link).map_err(|source| PortsError::io("replace", link, source))?;
            }
            Ok(_) => return Err(PortsError::InTheWay { path: link.to_path_buf() }),
            Err(_) => {}
        }
        symlink(&target, link).map_err(|source| PortsError::io("make the link", link, source))?;
        Ok(Self { master, link: link.to_path_buf(), target, has_client: false })
    }

    pub(super) fn fd(&self) -> &OwnedFd {
        &self.master
    }

    /// Whether somebody has the line open, as far as the last [`Terminal::read`] could tell.
    pub(super) fn has_client(&self) -> bool {
        self.has_client
    }

    /// What clients have sent.
    pub(super) fn read(&mut self) -> Vec<u8> {
        let mut bytes = vec![0; CHUNK];
        let read = rustix::io::read(&self.master, &mut bytes);
        bytes.truncate(*read.as_ref().unwrap_or(&0));
        // Where nobody has the other end open, reading fails; where nobody writes, it would have to wait.
        let had_client = std::mem::replace(
            &mut self.has_client,
            matches!(read, Ok(1..) | Err(rustix::io::Errno::AGAIN | rustix::io::Errno::INTR)),
        );
        if had_client && !self.has_client {
            // What the last client did not read is not for the next one.
            let _flushed = tcflush(&self.master, QueueSelector::IOFlush);
        }
        bytes
    }

    /// Sends to the client, if there is one. What it does not read in time is lost, as on a serial line.
    pub(super) fn write(&self, bytes: &[u8]) {
        if bytes.is_empty() || !self.has_client {
            return;
        }
        let _lost = rustix::io::write(&self.master, bytes).map_err(io::Error::from);
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        // Another emulation may have made the link its own.
        if fs::read_link(&self.link).is_ok_and(|target| target == self.target) {
            let _gone = fs::remove_file(&self.link);
        }
    }
}

//! Room for uploads: so many at a time, and so much of the disk.

use std::{
    io::{self, Write},
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
};

use crate::Error;

/// Uploads, and sessions that are packed to be sent, that may be under way at once. Each keeps a thread busy and up to
/// 4.5 GB of the disk.
const MAX_UPLOADS: usize = 4;
/// Free space that uploads leave, bytes: a session that is being recorded writes to the same disk, and its takes end when
/// that is full.
const MIN_FREE_BYTES: u64 = 1 << 30;
/// Free space is asked for anew after so many bytes.
const LOOK_AT_DISK_BYTES: u64 = 32 << 20;

/// Places for uploads.
#[derive(Debug, Default)]
pub(crate) struct Slots {
    taken: Arc<AtomicUsize>,
}

/// One place, until it is dropped.
#[derive(Debug)]
pub(crate) struct Slot {
    taken: Arc<AtomicUsize>,
}

impl Slots {
    /// Takes a place; refused if there is none left.
    pub(crate) fn take(&self) -> Result<Slot, Error> {
        let more = |taken| (taken < MAX_UPLOADS).then_some(taken + 1);
        match self.taken.fetch_update(Ordering::Relaxed, Ordering::Relaxed, more) {
            Ok(_) => Ok(Slot { taken: self.taken.clone() }),
            Err(_) => Err(Error::Busy(format!(
                "{MAX_UPLOADS} archives are being unpacked or packed already; try again when one is done"
            ))),
        }
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        self.taken.fetch_sub(1, Ordering::Relaxed);
    }
}

/// How much space is left for us where the data is, bytes; `None` if that cannot be found out.
pub(crate) type FreeBytes<'a> = &'a dyn Fn() -> Option<u64>;

/// Free space for us on the file system of `path`, bytes.
pub(crate) fn free_bytes(path: &Path) -> Option<u64> {
    let found = rustix::fs::statvfs(path).ok()?;
    Some(found.f_bavail.saturating_mul(found.f_frsize))
}

/// Refuses `more_bytes` for which there is no space.
pub(crate) fn check_space(free: Option<u64>, more_bytes: u64) -> Result<(), Error> {
    let Some(free) = free.filter(|&free| free < more_bytes.saturating_add(MIN_FREE_BYTES)) else {
        return Ok(());
    };
    Err(Error::DiskFull(format!(
        "the studio's disk has {} MB free, and the upload needs {} MB beside the {} MB that are kept for recordings; free \
         some space there, or upload fewer takes at a time",
        free / 1_000_000,
        more_bytes.div_ceil(1_000_000),
        MIN_FREE_BYTES / 1_000_000
    )))
}

/// Writes as long as there is space.
pub(crate) struct SpaceWriter<'a, W> {
    sink: W,
    free: FreeBytes<'a>,
    unasked_bytes: u64,
}

impl<'a, W: Write> SpaceWriter<'a, W> {
    /// Writes to `sink`. Asks `free` at once and then now and again.
    pub(crate) fn new(sink: W, free: FreeBytes<'a>) -> Self {
        Self { sink, free, unasked_bytes: LOOK_AT_DISK_BYTES }
    }

    /// Writes all of `bytes`; the outer error says that there is no space, the inner one what the system refused.
    pub(crate) fn write_all(&mut self, bytes: &[u8]) -> Result<io::Result<()>, Error> {
        self.unasked_bytes += bytes.len() as u64;
        if self.unasked_bytes >= LOOK_AT_DISK_BYTES {
            self.unasked_bytes = 0;
            check_space((self.free)(), bytes.len() as u64)?;
        }
        Ok(self.sink.write_all(bytes))
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    #[test]
    fn a_place_is_free_again_when_an_upload_has_ended() {
        let slots = Slots::default();
        let mut taken: Vec<Slot> = (0..MAX_UPLOADS).map(|_| slots.take().unwrap()).collect();
        for _ in 0..2 {
            let err = slots.take().unwrap_err();
            assert!(
                matches!(err, Error::Busy(_))
                    && err.to_string().contains("4 archives are being unpacked or packed"),
                "{err}"
            );
        }
        taken.pop();
        let _last = slots.take().unwrap();
        assert!(slots.take().is_err());
    }

    #[test]
    fn space_that_recordings_need_is_left() {
        assert!(check_space(None, u64::MAX).is_ok(), "where nobody knows, the disk says so when it is full");
        assert!(check_space(Some(MIN_FREE_BYTES + 100), 100).is_ok());
        let err = check_space(Some(MIN_FREE_BYTES + 99), 100).unwrap_err();
        assert!(matches!(err, Error::DiskFull(_)), "{err}");
    }

    #[test]
    fn writing_ends_when_the_disk_fills_up() {
        let left = Cell::new(MIN_FREE_BYTES + 3 * LOOK_AT_DISK_BYTES);
        let free = || Some(left.get());
        let mut sink = SpaceWriter::new(io::sink(), &free);
        let megabyte = vec![0; 1 << 20];
        let mut written = 0;
        let err = loop {
            if let Err(err) = sink.write_all(&megabyte) {
                break err;
            }
            written += megabyte.len() as u64;
            // Somebody else writes as much.
            left.set(left.get() - 2 * megabyte.len() as u64);
        };
        assert!(matches!(err, Error::DiskFull(_)), "{err}");
        assert!(written <= 3 * LOOK_AT_DISK_BYTES && left.get() + 2 * LOOK_AT_DISK_BYTES >= MIN_FREE_BYTES);
    }
}

//! Who may use the machine: what runs in real time must not wait for what computes, everything else can share.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Stations in real time that fit beside each other on two cores: one takes a third of a core, and waits the rest of the
/// time.
const MAX_STATIONS: usize = 2;

static RUNNING: Mutex<Running> = Mutex::new(Running { computing: 0, stations: 0, is_taken: false });
static ENDED: Condvar = Condvar::new();

/// Tests that have their turn.
struct Running {
    computing: usize,
    stations: usize,
    /// One test has the whole machine.
    is_taken: bool,
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    Computes,
    Station,
    Alone,
}

/// A test's turn; it ends when this is dropped.
#[derive(Debug)]
#[must_use = "the turn ends when this is dropped"]
pub struct Turn(Kind);

/// For a test that takes as long as it takes: beside others of its kind, while nothing runs in real time.
pub fn together() -> Turn {
    wait_for(Kind::Computes)
}

/// For a station that runs in real time and little else: beside another one, while nothing computes.
pub fn beside_a_station() -> Turn {
    wait_for(Kind::Station)
}

/// For a station that runs in real time beside what needs much of the machine, such as a browser.
pub fn alone() -> Turn {
    wait_for(Kind::Alone)
}

fn wait_for(kind: Kind) -> Turn {
    let mut admitted =
        ENDED.wait_while(running(), |running| !running.admits(kind)).unwrap_or_else(PoisonError::into_inner);
    admitted.begin(kind);
    Turn(kind)
}

fn running() -> MutexGuard<'static, Running> {
    // A test that failed before has nothing to do with the next one.
    RUNNING.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Running {
    fn admits(&self, kind: Kind) -> bool {
        let Self { computing, stations, is_taken } = *self;
        !is_taken
            && match kind {
                Kind::Computes => stations == 0,
                Kind::Station => computing == 0 && stations < MAX_STATIONS,
                Kind::Alone => computing == 0 && stations == 0,
            }
    }

    fn begin(&mut self, kind: Kind) {
        match kind {
            Kind::Computes => self.computing += 1,
            Kind::Station => self.stations += 1,
            Kind::Alone => self.is_taken = true,
        }
    }

    fn end(&mut self, kind: Kind) {
        match kind {
            Kind::Computes => self.computing -= 1,
            Kind::Station => self.stations -= 1,
            Kind::Alone => self.is_taken = false,
        }
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        running().end(self.0);
        ENDED.notify_all();
    }
}

//! What every device's thread is given, and the loop that keeps a device connected.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use crate::clock::{BackOff, HostClock, Stop};
use crate::error::DriverError;
use crate::event::{DeviceEvent, Link};
use crate::health::SharedHealth;
use crate::priority;

/// A connection that lasted this long was good: the next attempt comes soon again, ns.
const GOOD_CONNECTION_NS: u64 = 2_000_000_000;

/// What a device's thread works with. Clones share everything.
#[derive(Clone, Debug)]
pub(crate) struct DeviceContext {
    /// Which of the station's devices.
    pub(crate) index: usize,
    /// Its id in the station file.
    pub(crate) id: Arc<str>,
    pub(crate) clock: HostClock,
    pub(crate) health: SharedHealth,
    /// What all joints of the station shall do.
    pub(crate) goals: GoalSlot,
    /// Set when the thread shall end.
    pub(crate) stop: Stop,
    pub(crate) events: Sender<DeviceEvent>,
    /// Set when somebody asks to clear the device's faults.
    pub(crate) clear_fault: Arc<AtomicBool>,
}

impl DeviceContext {
    /// Reports. Nobody listening is no reason to stop driving: the station may be shutting down.
    pub(crate) fn send(&self, event: DeviceEvent) {
        let _nobody_listens = self.events.send(event);
    }

    /// Notes the device's link and reports it if anything about it is new.
    pub(crate) fn link(&self, link: Link, problem: impl Into<String>) {
        let (at_ns, problem) = (self.clock.now_ns(), problem.into());
        if self.health.set_link(at_ns, link, &problem) {
            // Whoever gets the event tells the operator.
            tracing::debug!(device = %self.id, ?link, %problem);
            self.send(DeviceEvent::Link { device: self.index, at_ns, link, problem });
        }
    }

    /// Whether somebody has asked to clear the device's faults since the last call.
    pub(crate) fn take_clear_fault(&self) -> bool {
        self.clear_fault.swap(false, Ordering::Relaxed)
    }

    /// Keeps the device connected until the thread shall end: connects, serves until that fails, waits, and again.
    /// Both give the problem in words, with what to do; `serve` returns `Ok` when the thread shall end.
    pub(crate) fn keep_connected<C>(
        &self,
        mut connect: impl FnMut(&Self) -> Result<C, String>,
        mut serve: impl FnMut(&Self, C) -> Result<(), String>,
    ) {
        let mut back_off = BackOff::default();
        self.link(Link::Connecting, "");
        while !self.stop.is_set() {
            let problem = match connect(self) {
                Ok(connection) => {
                    let since_ns = self.clock.now_ns();
                    let served = serve(self, connection);
                    if self.clock.now_ns().saturating_sub(since_ns) > GOOD_CONNECTION_NS {
                        back_off.reset();
                    }
                    served.err()
                }
                Err(problem) => Some(problem),
            };
            let Some(problem) = problem else { break };
            self.link(Link::Lost, problem);
            if self.stop.wait(back_off.pause()) {
                break;
            }
        }
    }

    /// Starts the device's thread, which is called after the device.
    pub(crate) fn spawn(
        self,
        run: impl FnOnce(DeviceContext) + Send + 'static,
    ) -> Result<BusHandle, DriverError> {
        let id = Arc::clone(&self.id);
        let stop = self.stop.clone();
        let thread = Builder::new()
            .name(format!("device {id}"))
            .spawn(move || {
                priority::real_time();
                run(self);
            })
            .map_err(|source| DriverError::Thread { device: id.to_string(), source })?;
        Ok(BusHandle { stop, thread: Some(thread) })
    }
}

/// A device's thread. It is told to end, and waited for, when this is dropped.
#[derive(Debug)]
pub(crate) struct BusHandle {
    stop: Stop,
    thread: Option<JoinHandle<()>>,
}

impl BusHandle {
    /// Tells the thread to end without waiting for it, so that several can end at once.
    pub(crate) fn stop(&self) {
        self.stop.set();
    }
}

impl Drop for BusHandle {
    fn drop(&mut self) {
        self.stop.set();
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("a device's thread ended by a panic");
        }
    }
}

/// What all joints shall do: a copy of the newest [`palpate_safety::Setpoint`], which only the safety layer makes.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Goal {
    /// Whether motors shall hold their joints.
    pub(crate) torque: bool,
    /// Whether the arm shall yield to the operator's hands.
    pub(crate) lead_through: bool,
    /// Positions in the station's order, rad or m.
    pub(crate) positions: Arc<[f64]>,
    /// From then on nobody stands behind it, ns.
    pub(crate) valid_until_ns: u64,
}

/// The newest goal.
#[derive(Clone, Debug, Default)]
pub(crate) struct GoalSlot {
    newest: Arc<Mutex<Option<Goal>>>,
}

impl GoalSlot {
    /// Puts a goal in place of the one before.
    pub(crate) fn set(&self, goal: Goal) {
        *self.newest.lock().unwrap_or_else(PoisonError::into_inner) = Some(goal);
    }

    /// The newest goal, valid or not; `None` before the first.
    pub(crate) fn newest(&self) -> Option<Goal> {
        self.newest.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// How long a device may be silent before it counts as lost.
pub(crate) const LOST_AFTER: Duration = Duration::from_millis(500);

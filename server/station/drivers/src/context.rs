//! What every device's thread is given, the loop that keeps a device connected, and the one that restarts its driver.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError};
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
/// An event that found no room is tried again this often while the thread waits.
const RESEND: Duration = Duration::from_millis(20);

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
    pub(crate) events: Outbox,
    /// Set when somebody asks to clear the device's faults.
    pub(crate) clear_fault: Arc<AtomicBool>,
    /// Set once the driver has panicked: whoever drove the device before did not let go of it in order.
    pub(crate) has_failed: Arc<AtomicBool>,
    /// Set by a test that wants the driver to panic.
    #[cfg(test)]
    pub(crate) panics: Arc<AtomicBool>,
}

/// The way of events to whoever opened the station. It has room for so many, and no device's thread ever waits for more:
/// readings that find none are dropped and counted, the newest link and its problem are kept until there is room.
#[derive(Clone, Debug)]
pub(crate) struct Outbox {
    sender: SyncSender<DeviceEvent>,
    /// A link that found no room.
    unsent: Arc<Mutex<Option<DeviceEvent>>>,
}

impl Outbox {
    pub(crate) fn new(sender: SyncSender<DeviceEvent>) -> Self {
        Self { sender, unsent: Arc::default() }
    }

    /// Sends a reading and says whether there was room for it. That nobody listens any more is no reason to stop driving:
    /// the station may be shutting down.
    fn send(&self, event: DeviceEvent) -> bool {
        // Nothing overtakes a link.
        self.flush() && !matches!(self.sender.try_send(event), Err(TrySendError::Full(_)))
    }

    /// Sends a link, in place of one that is still unsent: only the newest counts.
    fn send_link(&self, event: DeviceEvent) {
        *self.unsent.lock().unwrap_or_else(PoisonError::into_inner) = Some(event);
        self.flush();
    }

    /// Sends the link that found no room, if there is one; whether none is left.
    fn flush(&self) -> bool {
        let mut unsent = self.unsent.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(event) = unsent.take() else { return true };
        if let Err(TrySendError::Full(event)) = self.sender.try_send(event) {
            *unsent = Some(event);
        }
        unsent.is_none()
    }
}

impl DeviceContext {
    /// The context of a device that is the station's first.
    #[cfg(test)]
    pub(crate) fn for_tests(id: &str, events: SyncSender<DeviceEvent>) -> Self {
        Self {
            index: 0,
            id: Arc::from(id),
            clock: HostClock::start(),
            health: SharedHealth::new(id, "test"),
            goals: GoalSlot::default(),
            stop: Stop::default(),
            events: Outbox::new(events),
            clear_fault: Arc::default(),
            has_failed: Arc::default(),
            panics: Arc::default(),
        }
    }

    /// Reports a reading. Where nobody takes events, it is dropped and counted.
    pub(crate) fn send(&self, event: DeviceEvent) {
        if !self.events.send(event) && self.health.add_dropped_event() == 1 {
            // Said once: from then on the count tells.
            tracing::error!(device = %self.id, "nobody takes the events of this device: its readings are dropped");
        }
    }

    /// Notes the device's link and reports it if anything about it is new.
    pub(crate) fn link(&self, link: Link, problem: impl Into<String>) {
        let (at_ns, problem) = (self.clock.now_ns(), problem.into());
        if self.health.set_link(at_ns, link, &problem) {
            // Whoever gets the event tells the operator.
            tracing::debug!(device = %self.id, ?link, %problem);
            self.events.send_link(DeviceEvent::Link { device: self.index, at_ns, link, problem });
        } else {
            self.events.flush();
        }
    }

    /// Waits, and says whether the thread shall end. What found no room before is sent meanwhile.
    fn wait(&self, duration: Duration) -> bool {
        let mut left = duration;
        while !self.events.flush() && left > RESEND {
            left -= RESEND;
            if self.stop.wait(RESEND) {
                return true;
            }
        }
        self.stop.wait(left)
    }

    /// Panics where a test asks for it.
    #[cfg(test)]
    pub(crate) fn panic_if_asked(&self) {
        assert!(!self.panics.swap(false, Ordering::Relaxed), "a test asked for this panic");
    }

    /// Whether somebody has asked to clear the device's faults since the last call.
    pub(crate) fn take_clear_fault(&self) -> bool {
        self.clear_fault.swap(false, Ordering::Relaxed)
    }

    /// Reports the device as lost if `served` says that it is.
    pub(crate) fn lost(&self, served: &Result<(), String>) {
        if let Err(problem) = served {
            self.link(Link::Lost, problem.clone());
        }
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
                    // Faults that somebody asked to clear while nobody was there to clear them stay.
                    let _void = self.take_clear_fault();
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
            if self.wait(back_off.pause()) {
                break;
            }
        }
    }

    /// Runs the driver until it ends. One that panics is said to have failed, and started anew after a pause; what it
    /// held is dropped before, and tells its motors to let go.
    pub(crate) fn keep_running(&self, mut run: impl FnMut(&Self)) {
        let mut back_off = BackOff::default();
        loop {
            let since_ns = self.clock.now_ns();
            // What a panic leaves half done is this driver's alone, which starts with nothing of it; health, goals and
            // events are behind locks that are held for single changes.
            let Err(panic) = catch_unwind(AssertUnwindSafe(|| run(self))) else { break };
            self.has_failed.store(true, Ordering::Relaxed);
            let reason = reason(&*panic);
            tracing::error!(device = %self.id, %reason, "the driver failed; it is started again");
            self.link(
                Link::Lost,
                format!(
                    "the thread of its driver failed ({reason}) and is started again; its motors were told to let go: look \
                     whether they have, and report this as a fault of this program"
                ),
            );
            if self.clock.now_ns().saturating_sub(since_ns) > GOOD_CONNECTION_NS {
                back_off.reset();
            }
            if self.wait(back_off.pause()) {
                break;
            }
        }
    }

    /// Starts the device's thread, which is called after the device.
    pub(crate) fn spawn(
        self,
        run: impl FnMut(&DeviceContext) + Send + 'static,
    ) -> Result<BusHandle, DriverError> {
        let id = Arc::clone(&self.id);
        let stop = self.stop.clone();
        let thread = Builder::new()
            .name(format!("device {id}"))
            .spawn(move || {
                priority::real_time();
                self.keep_running(run);
            })
            .map_err(|source| DriverError::Thread { device: id.to_string(), source })?;
        Ok(BusHandle { stop, thread: Some(thread) })
    }
}

/// What a panic said.
fn reason(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("no reason given")
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
    /// The goal expires at this host time, ns.
    pub(crate) valid_until_ns: u64,
    /// How often goals have begun to be without torque, up to this one; counted by the slot. A thread that looks now and
    /// then sees by it that one without torque came and went.
    pub(crate) disarms: u64,
}

/// The newest goal.
#[derive(Clone, Debug, Default)]
pub(crate) struct GoalSlot {
    newest: Arc<Mutex<Option<Goal>>>,
}

impl GoalSlot {
    /// Puts a goal in place of the one before.
    pub(crate) fn set(&self, goal: Goal) {
        let mut newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        let begins = !goal.torque && newest.as_ref().is_none_or(|before| before.torque);
        let disarms = newest.as_ref().map_or(0, |before| before.disarms) + u64::from(begins);
        *newest = Some(Goal { disarms, ..goal });
    }

    /// The newest goal, valid or not; `None` before the first.
    pub(crate) fn newest(&self) -> Option<Goal> {
        self.newest.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// [`Goal::disarms`] of the newest goal; 0 before the first.
    pub(crate) fn disarms(&self) -> u64 {
        self.newest.lock().unwrap_or_else(PoisonError::into_inner).as_ref().map_or(0, |goal| goal.disarms)
    }
}

/// How long a device may be silent before it counts as lost.
pub(crate) const LOST_AFTER: Duration = Duration::from_millis(500);

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Receiver, sync_channel};

    use super::*;

    fn context(room: usize) -> (DeviceContext, Receiver<DeviceEvent>) {
        let (sender, events) = sync_channel(room);
        (DeviceContext::for_tests("dev", sender), events)
    }

    fn reading(received_ns: u64) -> DeviceEvent {
        DeviceEvent::Tactile {
            device: 0,
            received_ns,
            host_ns: received_ns,
            device_ns: None,
            sequence: None,
            stream: 0,
            first_channel: 0,
            raw: vec![1.0],
        }
    }

    fn links(events: &Receiver<DeviceEvent>) -> Vec<(Link, String)> {
        let links = events.try_iter().filter_map(|event| match event {
            DeviceEvent::Link { link, problem, .. } => Some((link, problem)),
            _ => None,
        });
        links.collect()
    }

    #[test]
    fn readings_without_room_are_counted_and_the_newest_link_comes_once_there_is_some() {
        let (context, events) = context(2);
        (0..5).for_each(|at_ns| context.send(reading(at_ns)));
        context.link(Link::Ready, "");
        context.link(Link::Fault, "overload");
        assert_eq!(context.health.snapshot(0).dropped_events, 3);
        let first: Vec<DeviceEvent> = events.try_iter().collect();
        assert_eq!(first, [reading(0), reading(1)], "no thread waited, and what was there first stays");
        // Nothing about the link is new, and nothing overtakes it.
        context.link(Link::Fault, "overload");
        context.send(reading(9));
        let then: Vec<DeviceEvent> = events.try_iter().collect();
        assert!(
            matches!(&then[..], [DeviceEvent::Link { link: Link::Fault, problem, .. }, last]
                if problem == "overload" && *last == reading(9)),
            "{then:?}"
        );
        drop(events);
        context.send(reading(10));
        assert_eq!(context.health.snapshot(0).dropped_events, 3, "nobody listens any more, which is no loss");
    }

    #[test]
    fn a_lost_device_is_told_even_if_there_was_no_room_when_it_went() {
        let (context, events) = context(1);
        context.send(reading(0));
        let thread = std::thread::spawn({
            let context = context.clone();
            move || context.keep_connected(|_| Err::<(), _>("no such port".to_owned()), |_, ()| Ok(()))
        });
        // The thread says nothing else by itself for seconds; room comes while it waits.
        while context.health.snapshot(0).link != Link::Lost {
            std::thread::yield_now();
        }
        assert_eq!(events.recv(), Ok(reading(0)));
        let event = events.recv().expect("the link");
        assert!(matches!(event, DeviceEvent::Link { link: Link::Lost, .. }), "{event:?}");
        context.stop.set();
        thread.join().expect("it ends");
    }

    #[test]
    fn a_driver_that_panics_is_lost_with_the_reason_and_runs_again() {
        let (context, events) = context(100);
        let mut num_runs = 0;
        context.keep_running(|context| {
            num_runs += 1;
            context.link(Link::Ready, "");
            assert!(num_runs == 3, "run {num_runs} fails");
        });
        assert!(num_runs == 3 && context.has_failed.load(Ordering::Relaxed));
        let links = links(&events);
        assert_eq!(links.len(), 5, "{links:?}");
        for (run, (link, problem)) in links.iter().enumerate().filter(|(idx, _)| idx % 2 == 1) {
            assert_eq!(*link, Link::Lost);
            let expected = format!("driver failed (run {} fails) and is started again", run.div_ceil(2));
            assert!(problem.contains(&expected), "{problem}");
        }
    }

    #[test]
    fn a_driver_that_panics_for_ever_does_not_keep_the_station_from_ending() {
        let (context, _events) = context(100);
        let bus = context.clone().spawn(|_| panic!("again")).expect("a thread");
        while !context.has_failed.load(Ordering::Relaxed) {
            std::thread::yield_now();
        }
        drop(bus);
        assert_eq!(context.health.snapshot(0).link, Link::Lost);
    }

    #[test]
    fn faults_that_somebody_asks_to_clear_while_the_device_is_away_are_not_cleared_when_it_is_back() {
        let (context, _events) = context(100);
        let mut is_asked = None;
        context.keep_connected(
            |context| {
                context.clear_fault.store(true, Ordering::Relaxed);
                Ok(())
            },
            |context, ()| {
                is_asked = Some(context.take_clear_fault());
                Ok(())
            },
        );
        assert_eq!(is_asked, Some(false));
    }
}

//! Writes takes on a thread of its own, so that no disk can hold the control loop up.
//!
//! Samples wait in a bounded queue: one that finds it full is lost and counted. Commands wait in the same queue, so that
//! they take effect where they were given among the samples, and are never lost.

use std::{
    collections::VecDeque,
    io,
    path::Path,
    sync::{
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{self, Receiver, TryRecvError},
    },
    thread::{self, JoinHandle},
    time::{SystemTime, UNIX_EPOCH},
};

use nalgebra::Isometry3;
use palpate_recording::{GrowingSession, PlannedStep, SpanKind, TakeMeta};
use palpate_reports::TakeVerdict;
use palpate_robot_model::Station;

mod worker;

use worker::Worker;

/// How much may wait, and how much space has to be left.
pub(crate) struct RecorderConfig {
    /// Samples that may wait to be written. Half a minute of a hand at full rate is a few megabytes.
    pub(crate) most_waiting: usize,
    /// A take ends when less than this is free, bytes: its end and the lists of the session still have to be written.
    pub(crate) least_free_bytes: u64,
    /// Free space where a session lies, bytes; `None` if that cannot be found out.
    pub(crate) free_bytes: FreeBytes,
}

type FreeBytes = Box<dyn Fn(&Path) -> Option<u64> + Send>;

impl Default for RecorderConfig {
    fn default() -> Self {
        Self { most_waiting: 20_000, least_free_bytes: 32 << 20, free_bytes: Box::new(free_bytes_at) }
    }
}

/// What the recorder is told. Times are host times, ns.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum RecorderCommand {
    /// Begins a take of a step.
    StartTake { step: usize, meta: TakeMeta, at_ns: u64, planned: Vec<usize> },
    /// Begins a take that nobody reviews: it becomes part of the session as soon as it is over, if it can be read.
    StartFreeTake { step: usize, meta: TakeMeta, at_ns: u64 },
    /// Marks a span that is over.
    Span { kind: SpanKind, start_ns: u64, end_ns: u64, label: String },
    /// A remark at a moment of the take.
    Note { at_ns: u64, text: String },
    /// A line of the take's log.
    Log { at_ns: u64, text: String },
    /// Ends the take and checks it; `broken_off` says why it ended early, if it did.
    EndTake { broken_off: String },
    /// Makes a take part of the session.
    Accept { take: String },
    /// Sets a take aside.
    SetAside { take: String },
    /// Takes back a take that was set aside.
    Restore { take: String },
    /// Checks a take that is there already.
    Check { take: String, planned: Vec<usize> },
    /// Adds a step to the session's list.
    AddStep { step: PlannedStep },
    /// Takes an added step off the list.
    RemoveStep { step: usize },
    /// A remark about a take that is over.
    Annotate { take: String, text: String },
    /// Lets go of the session.
    EndSession,
}

/// What the recorder has done.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum RecorderEvent {
    /// Samples are being written.
    TakeStarted { take: String },
    /// The take is complete, by command or because it could not go on; its check follows.
    TakeEnded { take: String, broken_off: String },
    /// There is no take: it could not be started, or not be kept.
    TakeLost { problem: String },
    /// The quality check of a take. One that is not readable must not become part of a session.
    Checked { take: String, verdict: TakeVerdict, readable: bool },
    /// Part of the session, on disk.
    Accepted { take: String },
    /// Set aside, on disk.
    SetAside { take: String },
    /// Back, on disk.
    Restored { take: String },
    /// A command did not work.
    Failed { problem: String },
    /// The session is closed.
    SessionEnded,
}

/// The recorder's end in the control loop. Dropping it ends a take that runs, and keeps it.
pub(crate) struct Recorder {
    shared: Arc<Shared>,
    station: Arc<Station>,
    events: Receiver<RecorderEvent>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    queue: Mutex<Queue>,
    filled: Condvar,
    most_waiting: usize,
    /// Whether samples are wanted.
    recording: AtomicBool,
    lost_samples: AtomicU64,
    free_bytes: AtomicU64,
}

#[derive(Default)]
struct Queue {
    items: VecDeque<Item>,
    num_samples: usize,
    ended: bool,
}

/// Events that may wait for the loop, which takes them every 5 ms; the recorder's own thread waits for room.
const MAX_EVENTS: usize = 1024;

enum Item {
    /// A session, and the station that its takes are of.
    Begin(Box<GrowingSession>, Arc<Station>),
    Command {
        command: RecorderCommand,
        unix_ns: u64,
    },
    Sample(Sample),
}

enum Sample {
    Joints { host_ns: u64, positions: Vec<f64> },
    Commands { host_ns: u64, positions: Vec<f64> },
    ObjectPose { host_ns: u64, base_from_object: Isometry3<f64> },
    Tactile { stream: usize, host_ns: u64, device_ns: u64, raw: Vec<f32>, active: Vec<bool> },
}

impl Recorder {
    /// Starts the thread. Nothing is written before [`Recorder::begin`].
    pub(crate) fn start(station: Arc<Station>, config: RecorderConfig) -> io::Result<Self> {
        let shared = Arc::new(Shared {
            queue: Mutex::default(),
            filled: Condvar::new(),
            most_waiting: config.most_waiting,
            recording: AtomicBool::new(false),
            lost_samples: AtomicU64::new(0),
            free_bytes: AtomicU64::new(0),
        });
        let (sender, events) = mpsc::sync_channel(MAX_EVENTS);
        let mut worker = Worker::new(Arc::clone(&shared), Arc::clone(&station), config, sender);
        let thread = thread::Builder::new().name("recorder".to_owned()).spawn(move || worker.run())?;
        Ok(Self { shared, station, events, thread: Some(thread) })
    }

    /// Records into `session` from now on, until [`RecorderCommand::EndSession`].
    pub(crate) fn begin(&self, session: GrowingSession) {
        self.begin_with(session, Arc::clone(&self.station));
    }

    /// The same with another `station` in its takes: that of the recorder with more objects.
    pub(crate) fn begin_with(&self, session: GrowingSession, station: Arc<Station>) {
        self.shared.push(Item::Begin(Box::new(session), station));
    }

    /// Tells the recorder what to do; [`Recorder::poll`] says what came of it.
    pub(crate) fn command(&self, command: RecorderCommand) {
        match command {
            RecorderCommand::StartTake { .. } | RecorderCommand::StartFreeTake { .. } => {
                self.shared.recording.store(true, Ordering::Relaxed);
            }
            RecorderCommand::EndTake { .. } => self.shared.recording.store(false, Ordering::Relaxed),
            _ => {}
        }
        self.shared.push(Item::Command { command, unix_ns: unix_now_ns() });
    }

    /// Measured joint positions, all of them, at `host_ns`.
    pub(crate) fn joints(&self, host_ns: u64, positions: &[f64]) {
        self.shared.sample(|| Sample::Joints { host_ns, positions: positions.to_vec() });
    }

    /// Commanded joint positions, all of them, at `host_ns`.
    pub(crate) fn commands(&self, host_ns: u64, positions: &[f64]) {
        self.shared.sample(|| Sample::Commands { host_ns, positions: positions.to_vec() });
    }

    /// Where the object was at `host_ns`.
    pub(crate) fn object_pose(&self, host_ns: u64, base_from_object: Isometry3<f64>) {
        self.shared.sample(|| Sample::ObjectPose { host_ns, base_from_object });
    }

    /// A sample of a stream of the layout.
    pub(crate) fn tactile(
        &self,
        stream: usize,
        host_ns: u64,
        device_ns: Option<u64>,
        raw: &[f32],
        active: &[bool],
    ) {
        self.shared.sample(|| Sample::Tactile {
            stream,
            host_ns,
            device_ns: device_ns.unwrap_or_default(),
            raw: raw.to_vec(),
            active: active.to_vec(),
        });
    }

    /// The next thing that the recorder has done, if there is one.
    pub(crate) fn poll(&mut self) -> Option<RecorderEvent> {
        match self.events.try_recv() {
            Ok(event) => Some(event),
            Err(TryRecvError::Empty) => None,
            // Said once: the thread is gone, and with it whoever could say more.
            Err(TryRecvError::Disconnected) => self.thread.take().map(|_| {
                self.shared.recording.store(false, Ordering::Relaxed);
                let problem = "the recorder has stopped because of a fault of the program; restart palpate, and the \
                               take that was being recorded is recovered";
                RecorderEvent::TakeLost { problem: problem.to_owned() }
            }),
        }
    }

    /// Whether samples are being written.
    pub(crate) fn recording(&self) -> bool {
        self.shared.recording.load(Ordering::Relaxed)
    }

    /// Samples that could not be written since the start, because the queue was full or because they came out of order.
    pub(crate) fn lost_samples(&self) -> u64 {
        self.shared.lost_samples.load(Ordering::Relaxed)
    }

    /// Free space where the session lies, bytes; 0 before there is one.
    pub(crate) fn free_bytes(&self) -> u64 {
        self.shared.free_bytes.load(Ordering::Relaxed)
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.shared.lock().ended = true;
        self.shared.filled.notify_one();
        if let Some(thread) = self.thread.take() {
            // A panic of the thread was printed when it happened.
            let _ = thread.join();
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Queue> {
        // The queue is whole between any two statements of this file.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn push(&self, item: Item) {
        self.lock().items.push_back(item);
        self.filled.notify_one();
    }

    fn sample(&self, sample: impl FnOnce() -> Sample) {
        if !self.recording.load(Ordering::Relaxed) {
            return;
        }
        let sample = sample();
        let mut queue = self.lock();
        if queue.num_samples >= self.most_waiting {
            self.lost_samples.fetch_add(1, Ordering::Relaxed);
            return;
        }
        queue.num_samples += 1;
        queue.items.push_back(Item::Sample(sample));
        drop(queue);
        self.filled.notify_one();
    }
}

/// Free space for us on the file system of `path`, bytes.
fn free_bytes_at(path: &Path) -> Option<u64> {
    let found = rustix::fs::statvfs(path).ok()?;
    Some(found.f_bavail.saturating_mul(found.f_frsize))
}

fn unix_now_ns() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests;

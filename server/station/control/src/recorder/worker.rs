//! The recorder's thread.

use std::{
    sync::{Arc, atomic::Ordering, mpsc::SyncSender},
    time::Duration,
};

use palpate_recording::{
    GrowingSession, LiveTake, LogLevel, RecordingError, Span, TactileSampleRef, Take, TakeMeta,
};
use palpate_robot_model::Station;

use super::{Item, RecorderCommand, RecorderConfig, RecorderEvent, Sample, Shared};
use crate::quality::{self, Circumstances};

/// Free space is asked for this often, in the time of the samples.
const LOOK_AT_DISK_NS: u64 = 1_000_000_000;
/// And this often while nothing is recorded.
const LOOK_AT_DISK_IDLE: Duration = Duration::from_secs(2);
/// Items that are taken from the queue at once.
const MOST_AT_ONCE: usize = 256;

pub(super) struct Worker {
    shared: Arc<Shared>,
    /// The one that the session's takes are of.
    station: Arc<Station>,
    config: RecorderConfig,
    events: SyncSender<RecorderEvent>,
    session: Option<GrowingSession>,
    take: Option<Recording>,
}

/// The take that is being written.
struct Recording {
    live: LiveTake,
    start_ns: u64,
    looked_at_disk_ns: u64,
    /// Channels that the motion means to touch.
    planned: Vec<usize>,
    /// Nobody reviews it.
    is_free: bool,
    /// Samples that were lost before the take began.
    lost_before: u64,
    /// The first sample that was refused, in words.
    refusal: Option<String>,
}

impl Worker {
    pub(super) fn new(
        shared: Arc<Shared>,
        station: Arc<Station>,
        config: RecorderConfig,
        events: SyncSender<RecorderEvent>,
    ) -> Self {
        Self { shared, station, config, events, session: None, take: None }
    }

    pub(super) fn run(&mut self) {
        while let Some(items) = self.next_items() {
            if items.is_empty() {
                self.look_at_disk();
            }
            for item in items {
                match item {
                    Item::Begin(session, station) => {
                        self.end_session();
                        (self.session, self.station) = (Some(*session), station);
                        self.look_at_disk();
                    }
                    Item::Command { command, unix_ns } => self.command(command, unix_ns),
                    Item::Sample(sample) => self.sample(&sample),
                }
            }
        }
        self.end_session();
    }

    /// What waits; nothing after a while without anything; `None` at the end.
    fn next_items(&self) -> Option<Vec<Item>> {
        let mut queue = self.shared.lock();
        if queue.items.is_empty() && !queue.ended {
            let waited = self.shared.filled.wait_timeout(queue, LOOK_AT_DISK_IDLE);
            queue = waited.unwrap_or_else(std::sync::PoisonError::into_inner).0;
        }
        if queue.items.is_empty() && queue.ended {
            return None;
        }
        let count = queue.items.len().min(MOST_AT_ONCE);
        let items: Vec<Item> = queue.items.drain(..count).collect();
        queue.num_samples -= items.iter().filter(|item| matches!(item, Item::Sample(_))).count();
        Some(items)
    }

    fn command(&mut self, command: RecorderCommand, unix_ns: u64) {
        match command {
            RecorderCommand::StartTake { step, meta, at_ns, planned } => {
                self.start_take(step, &meta, at_ns, unix_ns, planned, false);
            }
            RecorderCommand::StartFreeTake { step, meta, at_ns } => {
                self.start_take(step, &meta, at_ns, unix_ns, Vec::new(), true);
            }
            RecorderCommand::Span { kind, start_ns, end_ns, label } => self.write(|take| {
                let [start_s, end_s] = [start_ns, end_ns].map(|ns| take.since_start_s(ns));
                take.live.span(&Span { kind, start_s, end_s, label })
            }),
            RecorderCommand::Note { at_ns, text } => {
                self.write(|take| take.live.note(at_ns.saturating_sub(take.start_ns), &text));
            }
            RecorderCommand::Log { at_ns, text } => self.write(|take| {
                take.live.log(at_ns.saturating_sub(take.start_ns), LogLevel::Info, "palpate", &text)
            }),
            RecorderCommand::EndTake { broken_off } => self.end_take(&broken_off),
            RecorderCommand::Accept { take } => {
                self.change(|session| session.accept(&take), RecorderEvent::Accepted { take: take.clone() });
            }
            RecorderCommand::SetAside { take } => {
                self.change(
                    |session| session.set_aside(&take),
                    RecorderEvent::SetAside { take: take.clone() },
                );
            }
            RecorderCommand::Restore { take } => {
                self.change(|session| session.restore(&take), RecorderEvent::Restored { take: take.clone() });
            }
            RecorderCommand::Check { take, planned } => {
                let entry = self
                    .session
                    .as_ref()
                    .and_then(|session| session.recording().takes.iter().find(|entry| entry.id() == take));
                let broken_off = entry.map(|entry| entry.broken_off.clone()).unwrap_or_default();
                let known =
                    Circumstances { planned: &planned, broken_off: &broken_off, ..Circumstances::default() };
                self.check(&take, &known);
            }
            RecorderCommand::AddStep { step } => self.list(|session| session.add_step(step)),
            RecorderCommand::RemoveStep { step } => self.list(|session| session.remove_step(step)),
            RecorderCommand::Annotate { take, text } => self.list(|session| session.note(&take, &text)),
            RecorderCommand::EndSession => {
                self.end_session();
                self.say(RecorderEvent::SessionEnded);
            }
        }
    }

    /// Changes the session's list; nobody waits for it, so that only a failure is said.
    fn list(&mut self, change: impl FnOnce(&mut GrowingSession) -> Result<(), RecordingError>) {
        let Some(session) = &mut self.session else { return };
        if let Err(error) = change(session) {
            self.say(RecorderEvent::Failed { problem: in_words(&error) });
        }
    }

    fn start_take(
        &mut self,
        step: usize,
        meta: &TakeMeta,
        at_ns: u64,
        unix_ns: u64,
        planned: Vec<usize>,
        is_free: bool,
    ) {
        self.end_take("another take was begun");
        let Some(session) = &mut self.session else {
            self.shared.recording.store(false, Ordering::Relaxed);
            let problem = "no session is open; begin one first".to_owned();
            return self.say(RecorderEvent::TakeLost { problem });
        };
        match session.start_take(step, &self.station, meta, unix_ns) {
            Ok(live) => {
                let take = session.recording().takes.last().map(|take| take.id().to_owned());
                self.take = Some(Recording {
                    live,
                    start_ns: at_ns,
                    looked_at_disk_ns: 0,
                    planned,
                    is_free,
                    lost_before: self.shared.lost_samples.load(Ordering::Relaxed),
                    refusal: None,
                });
                // A take before this one may have ended by itself in the meantime.
                self.shared.recording.store(true, Ordering::Relaxed);
                self.say(RecorderEvent::TakeStarted { take: take.unwrap_or_default() });
                self.look_at_disk();
            }
            Err(error) => {
                self.shared.recording.store(false, Ordering::Relaxed);
                self.say(RecorderEvent::TakeLost { problem: in_words(&error) });
            }
        }
    }

    fn sample(&mut self, sample: &Sample) {
        let Some(take) = &mut self.take else { return };
        let host_ns = match sample {
            Sample::Joints { host_ns, .. }
            | Sample::Commands { host_ns, .. }
            | Sample::ObjectPose { host_ns, .. }
            | Sample::Tactile { host_ns, .. } => *host_ns,
        };
        // What was measured before the take began is not part of it, though it arrived later.
        let Some(time_ns) = host_ns.checked_sub(take.start_ns) else { return };
        let written = match sample {
            Sample::Joints { positions, .. } => take.live.joints(time_ns, positions),
            Sample::Commands { positions, .. } => take.live.commands(time_ns, positions),
            Sample::ObjectPose { base_from_object, .. } => take.live.object_pose(time_ns, base_from_object),
            Sample::Tactile { stream, device_ns, raw, active, .. } => take.live.tactile(
                *stream,
                time_ns,
                TactileSampleRef { raw, active, device_time_ns: *device_ns },
            ),
        };
        if let Err(error) = written {
            if take.live.failed() {
                return self.break_off(&in_words(&error));
            }
            // One sample is out of order or no number; the take goes on without it.
            self.shared.lost_samples.fetch_add(1, Ordering::Relaxed);
            take.refusal.get_or_insert_with(|| in_words(&error));
        }
        if time_ns.saturating_sub(take.looked_at_disk_ns) >= LOOK_AT_DISK_NS {
            take.looked_at_disk_ns = time_ns;
            self.look_at_disk();
        }
    }

    fn write(&mut self, write: impl FnOnce(&mut Recording) -> Result<(), RecordingError>) {
        let Some(take) = &mut self.take else { return };
        let Err(error) = write(take) else { return };
        if take.live.failed() {
            self.break_off(&in_words(&error));
        } else {
            self.say(RecorderEvent::Failed { problem: in_words(&error) });
        }
    }

    /// Ends the take without having been told to.
    fn break_off(&mut self, reason: &str) {
        self.shared.recording.store(false, Ordering::Relaxed);
        self.end_take(reason);
    }

    /// Completes the take that is being written, if there is one, and checks it.
    fn end_take(&mut self, broken_off: &str) {
        let (Some(take), Some(session)) = (self.take.take(), &mut self.session) else { return };
        let end = match session.end_take(take.live, broken_off) {
            Ok(end) => end,
            Err(error) => {
                let because = if broken_off.is_empty() { String::new() } else { format!("{broken_off}; ") };
                let problem = format!(
                    "{because}nothing of the take can be read, and the file was set aside: {}",
                    in_words(&error)
                );
                return self.say(RecorderEvent::TakeLost { problem });
            }
        };
        let broken_off = if broken_off.is_empty() { end.problem } else { broken_off.to_owned() };
        let lost_samples = self.shared.lost_samples.load(Ordering::Relaxed) - take.lost_before;
        self.say(RecorderEvent::TakeEnded { take: end.take.clone(), broken_off: broken_off.clone() });
        let circumstances = Circumstances {
            planned: &take.planned,
            is_free: take.is_free,
            lost_samples,
            refusal: take.refusal.as_deref().unwrap_or_default(),
            broken_off: &broken_off,
        };
        let readable = self.check(&end.take, &circumstances);
        if take.is_free && readable {
            let accepted = RecorderEvent::Accepted { take: end.take.clone() };
            self.change(|session| session.accept(&end.take), accepted);
        }
    }

    /// Reads a take back and judges it; says whether it can be read.
    fn check(&mut self, take: &str, circumstances: &Circumstances<'_>) -> bool {
        let Some(session) = &mut self.session else { return false };
        let read = session.take_path(take).and_then(|path| Take::read(&path));
        let readable = read.is_ok();
        let verdict = match read {
            Ok(read) => quality::verdict(&read, circumstances),
            Err(error) => quality::unreadable(&in_words(&error), circumstances),
        };
        let kept = session.set_verdict(take, verdict.clone(), readable);
        self.say(RecorderEvent::Checked { take: take.to_owned(), verdict, readable });
        if let Err(error) = kept {
            self.say(RecorderEvent::Failed { problem: in_words(&error) });
        }
        readable
    }

    fn end_session(&mut self) {
        self.break_off("the session was left while the take was recorded");
        self.session = None;
    }

    fn change(
        &mut self,
        change: impl FnOnce(&mut GrowingSession) -> Result<(), RecordingError>,
        done: RecorderEvent,
    ) {
        let outcome = match &mut self.session {
            Some(session) => change(session).map_err(|error| in_words(&error)),
            None => Err("no session is open; begin one first".to_owned()),
        };
        self.say(match outcome {
            Ok(()) => done,
            Err(problem) => RecorderEvent::Failed { problem },
        });
    }

    /// Tells how much space is left, and ends the take while there is enough for its end.
    fn look_at_disk(&mut self) {
        let Some(session) = &self.session else { return };
        let Some(free) = (self.config.free_bytes)(&session.session().dir) else { return };
        self.shared.free_bytes.store(free, Ordering::Relaxed);
        if self.take.is_some() && free < self.config.least_free_bytes {
            let reason = format!(
                "the disk is nearly full ({} MB free, {} MB are kept for what is recorded already); free some space or \
                 move old sessions away, then record again",
                free >> 20,
                self.config.least_free_bytes >> 20
            );
            self.break_off(&reason);
        }
    }

    fn say(&self, event: RecorderEvent) {
        // Nobody listens once the control loop has ended.
        let _ = self.events.send(event);
    }
}

impl Recording {
    fn since_start_s(&self, host_ns: u64) -> f64 {
        host_ns.saturating_sub(self.start_ns) as f64 / 1e9
    }
}

/// An error with its causes, and what to do about the ones that operators meet.
fn in_words(error: &RecordingError) -> String {
    let mut text = error.to_string();
    let mut source = std::error::Error::source(error);
    while let Some(error) = source {
        text = format!("{text}: {error}");
        source = error.source();
    }
    if error.is_disk_full() {
        text.push_str("; the disk is full: free some space or move old sessions away, then record again");
    }
    text
}

//! Hands live frames, job updates and changes of lists to every client of the stream.

use std::{
    sync::{
        Arc, Mutex, Weak,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use palpate_wire::{
    api::Job,
    proto::{Changed, JobUpdate, LiveFrame, StreamMessage},
};
use tokio::sync::Notify;

mod client_queue;

use client_queue::ClientQueue;

use crate::data::cache::lock;

/// Publishing never waits: a client that reads too slowly loses frames, nobody else does.
#[derive(Debug, Default)]
pub struct Hub {
    clients: Mutex<Vec<Weak<Client>>>,
    newest_frame: Mutex<Option<(Arc<LiveFrame>, Instant)>>,
    /// Frames that clients were too slow for.
    num_dropped: AtomicU64,
    watchers: Mutex<Vec<Weak<Watcher>>>,
}

/// A list of the API that pages show and others change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum List {
    /// Sessions of the data folder.
    Sessions,
    /// Its sensor models.
    Models,
    /// Its campaigns.
    Campaigns,
}

impl List {
    /// Its name in messages.
    fn name(self) -> &'static str {
        match self {
            Self::Sessions => "sessions",
            Self::Models => "models",
            Self::Campaigns => "campaigns",
        }
    }
}

/// Whoever follows one job.
#[derive(Debug)]
pub(crate) struct Watcher {
    job: String,
    /// What it has not been told yet; a newer state replaces an older one.
    newest: Mutex<Option<Arc<Job>>>,
    changed: Notify,
}

/// The queue of one client.
#[derive(Debug, Default)]
pub(crate) struct Client {
    queue: Mutex<ClientQueue>,
    filled: Notify,
}

impl Hub {
    /// A new client; it begins with the newest frame, and leaves when dropped.
    pub(crate) fn join(&self) -> Arc<Client> {
        let client = Arc::new(Client::default());
        if let Some((frame, _)) = &*lock(&self.newest_frame) {
            client.push(|queue| _ = queue.push_live(frame.clone()));
        }
        lock(&self.clients).push(Arc::downgrade(&client));
        client
    }

    /// The newest state of the live station, if there is one.
    pub(crate) fn newest_frame(&self) -> Option<Arc<LiveFrame>> {
        lock(&self.newest_frame).as_ref().map(|(frame, _)| frame.clone())
    }

    /// Since when the live station has said nothing; `None` if it never has.
    pub(crate) fn silent_for(&self) -> Option<Duration> {
        lock(&self.newest_frame).as_ref().map(|(_, at)| at.elapsed())
    }

    /// Clients of the stream.
    pub(crate) fn num_clients(&self) -> usize {
        lock(&self.clients).iter().filter(|client| client.strong_count() > 0).count()
    }

    /// Live frames that clients were too slow for, since the start.
    pub(crate) fn num_dropped(&self) -> u64 {
        self.num_dropped.load(Ordering::Relaxed)
    }

    /// Sends the newest state of the live station to everybody.
    pub fn publish_live(&self, frame: LiveFrame) {
        let frame = Arc::new(frame);
        *lock(&self.newest_frame) = Some((frame.clone(), Instant::now()));
        self.for_each(|client| {
            client.push(|queue| {
                if queue.push_live(frame.clone()) {
                    self.num_dropped.fetch_add(1, Ordering::Relaxed);
                }
            });
        });
    }

    /// Sends the newest state of a job to everybody.
    pub fn publish_job(&self, update: &JobUpdate) {
        self.for_each(|client| client.push_job(update.clone()));
    }

    /// Tells everybody that entry `id` of a list has changed, or several if `id` is empty.
    pub(crate) fn publish_changed(&self, list: List, id: &str) {
        let changed = Changed { list: list.name().to_owned(), id: id.to_owned() };
        self.for_each(|client| client.push(|queue| queue.push_changed(changed.clone())));
    }

    /// Follows the job called `id` from now on, until dropped.
    pub(crate) fn watch_job(&self, id: &str) -> Arc<Watcher> {
        let watcher =
            Arc::new(Watcher { job: id.to_owned(), newest: Mutex::default(), changed: Notify::new() });
        lock(&self.watchers).push(Arc::downgrade(&watcher));
        watcher
    }

    /// Tells those who follow `job` where it stands.
    pub(crate) fn tell_watchers(&self, job: &Job) {
        let mut told: Option<Arc<Job>> = None;
        lock(&self.watchers).retain(|watcher| {
            let Some(watcher) = watcher.upgrade() else { return false };
            if watcher.job == job.id {
                let job = told.get_or_insert_with(|| Arc::new(job.clone()));
                *lock(&watcher.newest) = Some(job.clone());
                watcher.changed.notify_one();
            }
            true
        });
    }

    fn for_each(&self, send: impl Fn(&Client)) {
        lock(&self.clients).retain(|client| match client.upgrade() {
            Some(client) => {
                send(&client);
                true
            }
            None => false,
        });
    }
}

impl Watcher {
    /// The next state of the job, once it has changed.
    pub(crate) async fn next(&self) -> Arc<Job> {
        loop {
            // Taken out of the `match`, so that the lock is free while waiting.
            let newest = lock(&self.newest).take();
            match newest {
                Some(job) => return job,
                // A change between the two lines leaves its permit in the `Notify`.
                None => self.changed.notified().await,
            }
        }
    }
}

impl Client {
    /// Adds a job's state for this client only.
    pub(crate) fn push_job(&self, update: JobUpdate) {
        self.push(|queue| queue.push_job(update));
    }

    /// The next message, once there is one.
    pub(crate) async fn next(&self) -> StreamMessage {
        loop {
            // Taken out of the `match`, so that the lock is free while waiting.
            let message = lock(&self.queue).pop();
            match message {
                Some(message) => return message,
                // A push between the two lines leaves its permit in the `Notify`.
                None => self.filled.notified().await,
            }
        }
    }

    fn push(&self, add: impl FnOnce(&mut ClientQueue)) {
        add(&mut lock(&self.queue));
        self.filled.notify_one();
    }
}

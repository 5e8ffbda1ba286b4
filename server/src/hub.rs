//! Hands live frames, job updates and changes of lists to every client of the stream.

use std::sync::{Arc, Mutex, Weak};

use palpate_wire::proto::{Changed, JobUpdate, LiveFrame, StreamMessage};
use tokio::sync::Notify;

mod client_queue;

use client_queue::ClientQueue;

use crate::data::cache::lock;

/// Publishing never waits: a client that reads too slowly loses frames, nobody else does.
#[derive(Debug, Default)]
pub struct Hub {
    clients: Mutex<Vec<Weak<Client>>>,
    newest_frame: Mutex<Option<Arc<LiveFrame>>>,
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
        if let Some(frame) = &*lock(&self.newest_frame) {
            client.push(|queue| queue.push_live(frame.clone()));
        }
        lock(&self.clients).push(Arc::downgrade(&client));
        client
    }

    /// The newest state of the live station, if there is one.
    pub(crate) fn newest_frame(&self) -> Option<Arc<LiveFrame>> {
        lock(&self.newest_frame).clone()
    }

    /// Sends the newest state of the live station to everybody.
    pub fn publish_live(&self, frame: LiveFrame) {
        let frame = Arc::new(frame);
        *lock(&self.newest_frame) = Some(frame.clone());
        self.for_each(|client| client.push(|queue| queue.push_live(frame.clone())));
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

//! The thread that works runs off, one after the other: each uses every core.

use std::{
    sync::{
        Arc,
        mpsc::{SyncSender, TrySendError, sync_channel},
    },
    thread,
};

use crate::Error;

/// Runs that may wait.
const MAX_QUEUED: usize = 32;

/// Work for the thread. It looks after its own faults.
type Task = Box<dyn FnOnce() + Send>;

/// Work in the order in which it came.
pub(crate) struct Queue {
    tasks: SyncSender<Task>,
}

impl Queue {
    /// Starts the thread; it ends when nobody can give it work any more.
    pub(crate) fn start() -> Result<Arc<Self>, Error> {
        let (tasks, waiting) = sync_channel::<Task>(MAX_QUEUED);
        thread::Builder::new()
            .name("runs".to_owned())
            .spawn(move || waiting.into_iter().for_each(|task| task()))
            .map_err(|err| Error::Internal(format!("failed to start the thread of runs: {err}")))?;
        Ok(Arc::new(Self { tasks }))
    }

    /// Puts `task` at the end; refused if too many wait.
    pub(crate) fn push(&self, task: Task) -> Result<(), Error> {
        self.tasks.try_send(task).map_err(|err| match err {
            TrySendError::Full(_) => {
                Error::Conflict(format!("{MAX_QUEUED} runs wait already; cancel some, or wait"))
            }
            TrySendError::Disconnected(_) => {
                Error::Internal("the thread of runs has ended; restart the studio".to_owned())
            }
        })
    }
}

//! How much work requests may make at a time, by kind. Whatever does not fit waits for a while, then is refused with the
//! request to come back later; nothing grows without bound, and no kind of work can hold up another.
//!
//! Work that computes has threads of its own, of low priority, so that an operator's requests never wait for a core. Command
//! sockets have a thread of their own, so that a stop never waits behind streams, uploads and answers.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    thread,
    time::Duration,
};

use crossbeam_channel::{Sender, bounded};
use palpate_drivers::priority;
use tokio::{
    runtime,
    sync::{Semaphore, oneshot},
};

use crate::Error;

/// Computations that may wait. Each is a fraction of a second to a few seconds.
const MAX_WAITING_COMPUTATIONS: usize = 64;
/// Requests that may read files at a time. Far below the runtime's 512 threads, so that a disk that hangs leaves threads to
/// all others.
const MAX_READS: usize = 32;
/// Requests that may speak to the control loop at a time.
const MAX_CONTROLS: usize = 64;
/// Requests of one kind that may wait for their turn.
const MAX_WAITING: usize = 256;
/// A request does not wait longer than this for its turn.
const PATIENCE: Duration = Duration::from_secs(10);

/// What a request's work waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Files, little computing.
    Read,
    /// The control loop.
    Control,
    /// A core, for a while.
    Compute,
}

/// The limits of all requests together.
#[derive(Debug)]
pub(crate) struct Work {
    reads: Turns,
    controls: Turns,
    computations: Sender<Computation>,
    commands: CommandThread,
}

type Computation = Box<dyn FnOnce() + Send>;

/// Permits, and who waits for one.
#[derive(Debug)]
struct Turns {
    permits: Arc<Semaphore>,
    num_waiting: AtomicUsize,
    waits_for: &'static str,
}

impl Work {
    /// Starts the threads that compute, one for each core; they end when this is dropped.
    pub(crate) fn start() -> Result<Self, Error> {
        let (computations, waiting) = bounded::<Computation>(MAX_WAITING_COMPUTATIONS);
        let num_threads = thread::available_parallelism().map_or(1, usize::from);
        for number in 0..num_threads {
            let waiting = waiting.clone();
            thread::Builder::new()
                .name(format!("compute {number}"))
                .spawn(move || {
                    priority::background();
                    waiting.into_iter().for_each(|computation| computation());
                })
                .map_err(|err| Error::Internal(format!("failed to start a thread that computes: {err}")))?;
        }
        let turns = |permits, waits_for| Turns {
            permits: Arc::new(Semaphore::new(permits)),
            num_waiting: AtomicUsize::new(0),
            waits_for,
        };
        Ok(Self {
            reads: turns(MAX_READS, "the disk"),
            controls: turns(MAX_CONTROLS, "the control loop"),
            computations,
            commands: CommandThread::start()?,
        })
    }

    /// Where command sockets are read and written: a thread that does nothing else, with an event loop of its own.
    pub(crate) fn commands(&self) -> &runtime::Handle {
        &self.commands.handle
    }

    /// Runs `work` away from the threads that answer requests, once it is its turn. Work that has not begun when the client
    /// goes is not begun.
    pub(crate) async fn run<T: Send + 'static>(
        &self,
        kind: Kind,
        work: impl FnOnce() -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        match kind {
            Kind::Read => self.reads.run(work).await,
            Kind::Control => self.controls.run(work).await,
            Kind::Compute => self.compute(work).await,
        }
    }

    async fn compute<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        let is_wanted = Arc::new(AtomicBool::new(true));
        let _client = Client(is_wanted.clone());
        let (tell, told) = oneshot::channel();
        let computation = Box::new(move || {
            if is_wanted.load(Ordering::Relaxed) {
                let done = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work));
                // The client may have gone meanwhile.
                let _ = tell.send(done.unwrap_or_else(|_| Err(failed())));
            }
        });
        self.computations.try_send(computation).map_err(|_| {
            Error::Busy(format!(
                "{MAX_WAITING_COMPUTATIONS} computations wait already; try again in a moment"
            ))
        })?;
        told.await.unwrap_or_else(|_| Err(failed()))
    }
}

/// The thread of command sockets; it ends when this is dropped.
#[derive(Debug)]
struct CommandThread {
    handle: runtime::Handle,
    /// There until this is dropped.
    runtime: Option<runtime::Runtime>,
}

impl CommandThread {
    fn start() -> Result<Self, Error> {
        let runtime = runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("commands")
            .on_thread_start(priority::ahead)
            .enable_all()
            .build()
            .map_err(|err| {
                Error::Internal(format!("failed to start the thread of command sockets: {err}"))
            })?;
        Ok(Self { handle: runtime.handle().clone(), runtime: Some(runtime) })
    }
}

impl Drop for CommandThread {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            // Sockets that are still open are closed with it; waiting for them is not allowed where this may be dropped.
            runtime.shutdown_background();
        }
    }
}

fn failed() -> Error {
    Error::Internal("the request's work failed; see the log".to_owned())
}

/// The client of a request, for as long as the request's future lives.
struct Client(Arc<AtomicBool>);

impl Drop for Client {
    fn drop(&mut self) {
        self.0.store(false, Ordering::Relaxed);
    }
}

/// One that waits, for as long as this lives.
struct Waiting<'a>(&'a AtomicUsize);

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Turns {
    async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        let waits_for = self.waits_for;
        let overloaded = |what: String| Err(Error::Busy(what));
        let waiting = Waiting(&self.num_waiting);
        if self.num_waiting.fetch_add(1, Ordering::Relaxed) >= MAX_WAITING {
            return overloaded(format!(
                "{MAX_WAITING} requests wait for {waits_for} already; try again later"
            ));
        }
        let turn = tokio::time::timeout(PATIENCE, self.permits.clone().acquire_owned()).await;
        drop(waiting);
        let permit = match turn {
            Ok(Ok(permit)) => permit,
            Ok(Err(_)) => return Err(failed()),
            Err(_) => {
                return overloaded(format!(
                    "{waits_for} has not answered earlier requests for {} s; see whether it hangs",
                    PATIENCE.as_secs()
                ));
            }
        };
        // The permit goes with the work: work that hangs keeps its permit, even when its client has gone.
        let run = move || {
            // The runtime's threads come before others, which work on files must not.
            priority::ordinary();
            let _permit = permit;
            work()
        };
        tokio::task::spawn_blocking(run).await.unwrap_or_else(|_| Err(failed()))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::sync_channel;

    use super::*;

    /// Polls a future once; says whether it waits.
    fn begin<T>(future: std::pin::Pin<&mut impl Future<Output = T>>) -> bool {
        future.poll(&mut std::task::Context::from_waker(std::task::Waker::noop())).is_pending()
    }

    #[tokio::test]
    async fn work_that_hangs_holds_up_no_other_kind() {
        let work = Arc::new(Work::start().unwrap());
        let (release, hang) = sync_channel::<()>(1);
        let hang = Arc::new(std::sync::Mutex::new(hang));
        let mut hanging = tokio::task::JoinSet::new();
        for _ in 0..MAX_READS + MAX_WAITING {
            let (work, hang) = (work.clone(), hang.clone());
            hanging.spawn(async move {
                let wait = move || {
                    let _ = hang.lock().unwrap().recv();
                    Ok(())
                };
                work.run(Kind::Read, wait).await
            });
        }
        while work.reads.num_waiting.load(Ordering::Relaxed) < MAX_WAITING {
            tokio::task::yield_now().await;
        }
        assert_eq!(work.run(Kind::Control, || Ok(1)).await.unwrap(), 1);
        assert_eq!(work.run(Kind::Compute, || Ok(2)).await.unwrap(), 2);
        let refused = work.run(Kind::Read, || Ok(3)).await.unwrap_err();
        assert!(matches!(&refused, Error::Busy(text) if text.contains("the disk")), "{refused}");
        hanging.abort_all();
        while hanging.join_next().await.is_some() {}
        drop(release);
        assert_eq!(work.run(Kind::Read, || Ok(4)).await.unwrap(), 4, "who has gone waits no more");
    }

    #[tokio::test]
    async fn computations_of_clients_that_have_gone_are_not_begun() {
        let work = Work::start().unwrap();
        let (release, hang) = sync_channel::<()>(1);
        let hang = Arc::new(std::sync::Mutex::new(hang));
        let num_threads = thread::available_parallelism().map_or(1, usize::from);
        let mut busy: Vec<_> = (0..num_threads)
            .map(|_| {
                let hang = hang.clone();
                Box::pin(work.run(Kind::Compute, move || {
                    let _ = hang.lock().unwrap().recv();
                    Ok(())
                }))
            })
            .collect();
        for busy in &mut busy {
            assert!(begin(busy.as_mut()));
        }
        let begun = Arc::new(AtomicBool::new(false));
        {
            let begun = begun.clone();
            let mut gone = Box::pin(work.run(Kind::Compute, move || {
                begun.store(true, Ordering::Relaxed);
                Ok(())
            }));
            assert!(begin(gone.as_mut()));
        }
        drop(release);
        for busy in busy {
            busy.await.unwrap();
        }
        work.run(Kind::Compute, || Ok(())).await.unwrap();
        assert!(!begun.load(Ordering::Relaxed));
        let failed = work.run(Kind::Compute, || -> Result<(), Error> { panic!("a fault") }).await;
        assert!(matches!(failed, Err(Error::Internal(_))));
        assert_eq!(work.run(Kind::Compute, || Ok(5)).await.unwrap(), 5, "its thread goes on");
    }
}

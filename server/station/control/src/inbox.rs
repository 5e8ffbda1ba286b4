//! The way into the control loop: two bounded queues, of which the urgent one is always emptied first.
//!
//! Stops and heartbeats are urgent. A heavy load of other requests can neither delay nor displace them, and a stop that
//! finds even the urgent queue full is kept as a flag, which cannot be full.

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use crossbeam_channel::{Receiver, Select, Sender, bounded};
use palpate_wire::proto::{ControlReply, ControlRequest};

use crate::{
    message::{Answer, Message},
    requests::Caller,
};

/// Urgent messages that may wait. The loop empties the queue every 5 ms at least, and every connection is limited in what
/// it sends, so that a full queue means thousands of connections.
const MAX_URGENT: usize = 4096;
/// Other messages that may wait. Each of them comes from a caller that waits for its answer before it sends another.
const MAX_ORDINARY: usize = 4096;

/// A message that waits for nothing else.
pub(crate) enum Urgent {
    /// A stop or a heartbeat that came in at `received_ns`.
    Request { caller: Caller, request: ControlRequest, received_ns: u64, answer: Answer<ControlReply> },
    /// The loop has to end: motion first.
    End,
}

/// The senders' side. Clones send to the same loop.
#[derive(Clone, Debug)]
pub(crate) struct Mailbox {
    urgent: Sender<Urgent>,
    ordinary: Sender<Message>,
    overflow: Arc<Overflow>,
}

/// The loop's side.
#[derive(Debug)]
pub(crate) struct Inbox {
    urgent: Receiver<Urgent>,
    ordinary: Receiver<Message>,
    overflow: Arc<Overflow>,
}

/// Messages that must not be lost though the urgent queue is full.
#[derive(Debug, Default)]
struct Overflow {
    is_used: AtomicBool,
    kept: Mutex<Kept>,
}

/// What was kept while the urgent queue was full.
#[derive(Debug, Default)]
pub(crate) struct Kept {
    /// Somebody asked to stop.
    pub(crate) stop: bool,
    /// The loop has to end.
    pub(crate) end: bool,
    /// Connections that were lost; there are no more of them than there were connections.
    pub(crate) lost: Vec<u64>,
}

/// Why a message was not taken.
pub(crate) enum Rejected {
    /// Too many wait.
    Full,
    /// Nobody receives any more.
    Ended,
}

/// Both sides.
pub(crate) fn inbox() -> (Mailbox, Inbox) {
    let (urgent, urgent_receiver) = bounded(MAX_URGENT);
    let (ordinary, ordinary_receiver) = bounded(MAX_ORDINARY);
    let overflow = Arc::new(Overflow::default());
    let inbox =
        Inbox { urgent: urgent_receiver, ordinary: ordinary_receiver, overflow: Arc::clone(&overflow) };
    (Mailbox { urgent, ordinary, overflow }, inbox)
}

impl Mailbox {
    /// Sends without waiting.
    pub(crate) fn urgent(&self, message: Urgent) -> Result<(), Rejected> {
        self.urgent.try_send(message).map_err(|error| rejected(error.is_full()))
    }

    /// Sends without waiting.
    pub(crate) fn ordinary(&self, message: Message) -> Result<(), Rejected> {
        self.ordinary.try_send(message).map_err(|error| rejected(error.is_full()))
    }

    /// Keeps what must not be lost though the urgent queue is full.
    pub(crate) fn keep(&self, note: impl FnOnce(&mut Kept)) {
        note(&mut self.overflow.kept.lock().unwrap_or_else(PoisonError::into_inner));
        self.overflow.is_used.store(true, Ordering::Release);
    }
}

fn rejected(is_full: bool) -> Rejected {
    if is_full { Rejected::Full } else { Rejected::Ended }
}

impl Inbox {
    /// Waits until there is a message, for `timeout` at most.
    pub(crate) fn wait(&self, timeout: Duration) {
        let mut select = Select::new();
        select.recv(&self.urgent);
        select.recv(&self.ordinary);
        // Whichever it is, both are looked at.
        let _ = select.ready_timeout(timeout);
    }

    /// The next urgent message.
    pub(crate) fn urgent(&self) -> Option<Urgent> {
        self.urgent.try_recv().ok()
    }

    /// The next other message.
    pub(crate) fn ordinary(&self) -> Option<Message> {
        self.ordinary.try_recv().ok()
    }

    /// What was kept while the urgent queue was full, once.
    pub(crate) fn kept(&self) -> Option<Kept> {
        // The lock is only taken after an overflow, so that no other thread can hold up the loop by it otherwise.
        self.overflow
            .is_used
            .swap(false, Ordering::Acquire)
            .then(|| std::mem::take(&mut *self.overflow.kept.lock().unwrap_or_else(PoisonError::into_inner)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn full_queues_reject_and_lose_neither_stops_nor_lost_connections() {
        let (mailbox, inbox) = inbox();
        let heartbeat = || Urgent::Request {
            caller: Caller { connection: 1, peer: "test".into(), may_operate: true },
            request: ControlRequest::default(),
            received_ns: 0,
            answer: Box::new(|_| {}),
        };
        for _ in 0..MAX_URGENT {
            assert!(mailbox.urgent(heartbeat()).is_ok());
        }
        assert!(matches!(mailbox.urgent(heartbeat()), Err(Rejected::Full)));
        assert!(inbox.kept().is_none());
        mailbox.keep(|kept| kept.stop = true);
        mailbox.keep(|kept| kept.lost.push(7));
        let kept = inbox.kept().expect("something was kept");
        assert!(kept.stop && !kept.end && kept.lost == [7]);
        assert!(inbox.kept().is_none(), "it is told once");
        assert_eq!(std::iter::from_fn(|| inbox.urgent()).count(), MAX_URGENT);
        mailbox.urgent(Urgent::End).ok().expect("there is room again");
        inbox.wait(Duration::from_secs(600));
        assert!(matches!(inbox.urgent(), Some(Urgent::End)));
    }
}

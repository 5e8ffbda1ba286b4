//! What waits to be sent to one client of the stream: bounded, and honest about what it dropped.

use std::{collections::VecDeque, sync::Arc};

use palpate_wire::proto::{Changed, JobUpdate, LiveFrame, StreamMessage, stream_message::Message};

/// Live frames that may wait: a quarter of a second, after which a picture is no longer live.
pub(crate) const MAX_LIVE_FRAMES: usize = 8;

/// Messages for one client. What has changed and job updates go first and are never dropped; the oldest live frames are.
#[derive(Debug, Default)]
pub(crate) struct ClientQueue {
    changed: VecDeque<Changed>,
    jobs: VecDeque<JobUpdate>,
    live: VecDeque<Arc<LiveFrame>>,
    dropped: u64,
}

impl ClientQueue {
    /// Adds the newest state of the station; says whether an older one was dropped for it.
    pub(crate) fn push_live(&mut self, frame: Arc<LiveFrame>) -> bool {
        let is_full = self.live.len() == MAX_LIVE_FRAMES;
        if is_full {
            self.live.pop_front();
            self.dropped += 1;
        }
        self.live.push_back(frame);
        is_full
    }

    /// Adds a job's newest state in place of an older one of the same job that still waits, so that there are never more
    /// than there are jobs.
    pub(crate) fn push_job(&mut self, update: JobUpdate) {
        match self.jobs.iter_mut().find(|waiting| waiting.job == update.job) {
            Some(waiting) => *waiting = update,
            None => self.jobs.push_back(update),
        }
    }

    /// Adds that something has changed, unless that still waits to be said.
    pub(crate) fn push_changed(&mut self, changed: Changed) {
        if !self.changed.contains(&changed) {
            self.changed.push_back(changed);
        }
    }

    /// The next message to send.
    pub(crate) fn pop(&mut self) -> Option<StreamMessage> {
        let changed = self.changed.pop_front().map(Message::Changed);
        let job = || self.jobs.pop_front().map(Message::Job);
        let live = || self.live.pop_front().map(|frame| Message::Live((*frame).clone()));
        let message = changed.or_else(job).or_else(live)?;
        Some(StreamMessage { message: Some(message), dropped: self.dropped })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn frame(idx: usize) -> Arc<LiveFrame> {
        Arc::new(LiveFrame { time_s: idx as f64, ..LiveFrame::default() })
    }

    fn update(job: &str, fraction: f64) -> JobUpdate {
        JobUpdate { job: job.into(), fraction, ..JobUpdate::default() }
    }

    proptest! {
        #[test]
        fn every_live_frame_is_sent_in_order_or_counted(num_frames in 0_usize..100, reads in 0_usize..40) {
            let mut queue = ClientQueue::default();
            let (mut sent, mut last_dropped) = (Vec::new(), 0);
            for idx in 0..num_frames {
                queue.push_live(frame(idx));
                if idx < reads && let Some(message) = queue.pop() {
                    sent.push(message);
                }
            }
            sent.extend(std::iter::from_fn(|| queue.pop()));
            let mut times = Vec::new();
            for message in &sent {
                prop_assert!(message.dropped >= last_dropped);
                last_dropped = message.dropped;
                if let Some(Message::Live(frame)) = &message.message {
                    times.push(frame.time_s);
                }
            }
            prop_assert!(times.is_sorted());
            prop_assert_eq!(times.len() + last_dropped as usize, num_frames);
        }
    }

    #[test]
    fn what_has_changed_is_said_once_and_first() {
        let mut queue = ClientQueue::default();
        queue.push_live(frame(0));
        queue.push_job(update("a", 0.1));
        let changed = |id: &str| Changed { list: "campaigns".into(), id: id.into() };
        for id in ["first", "second", "first"] {
            queue.push_changed(changed(id));
        }
        let said: Vec<_> = std::iter::from_fn(|| queue.pop()).filter_map(|message| message.message).collect();
        assert_eq!(said[..2], [Message::Changed(changed("first")), Message::Changed(changed("second"))]);
        assert_eq!(said.len(), 4);
    }

    #[test]
    fn job_updates_overtake_live_frames_and_survive_them() {
        let mut queue = ClientQueue::default();
        queue.push_job(update("a", 0.1));
        for idx in 0..50 {
            queue.push_live(frame(idx));
        }
        queue.push_job(update("b", 0.5));
        queue.push_job(update("a", 0.2));
        let Some(Message::Job(first)) = queue.pop().and_then(|message| message.message) else {
            panic!("a job update comes first")
        };
        assert_eq!((first.job.as_str(), first.fraction), ("a", 0.2));
        let Some(Message::Job(second)) = queue.pop().and_then(|message| message.message) else {
            panic!("then the other job's")
        };
        assert_eq!(second.job, "b");
        let live = queue.pop().expect("then live frames");
        assert_eq!(live.dropped, 50 - MAX_LIVE_FRAMES as u64);
    }
}

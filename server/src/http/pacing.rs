//! How many messages may be on their way to one client.
//!
//! The buffers between server and client hold minutes of messages: a client that reads slowly would see an old picture
//! long before its queue drops anything. So a WebSocket ping follows every message, which clients answer by themselves
//! once they have read so far, and only a few messages may be without an answer. Where answers are slow it is one.

use std::{collections::VecDeque, time::Duration};

/// Messages without an answer to a client that reads at once: with 30 a second, enough for answers that take a quarter of
/// a second.
const MOST_UNANSWERED: usize = 8;
/// A client whose answers take longer than this does not keep up.
const SLOW: Duration = Duration::from_millis(300);

/// What is on its way to one client.
#[derive(Debug)]
pub(crate) struct Pacing {
    /// Numbers of the messages without an answer and when they were sent, by a clock of the caller's.
    unanswered: VecDeque<(u64, Duration)>,
    most_unanswered: usize,
    sent: u64,
}

impl Default for Pacing {
    fn default() -> Self {
        Self { unanswered: VecDeque::new(), most_unanswered: 1, sent: 0 }
    }
}

impl Pacing {
    /// Whether another message may be sent.
    pub(crate) fn may_send(&self) -> bool {
        self.unanswered.len() < self.most_unanswered
    }

    /// A message goes out at `now`; gives the number that its ping carries.
    pub(crate) fn sent(&mut self, now: Duration) -> u64 {
        self.sent += 1;
        self.unanswered.push_back((self.sent, now));
        self.sent
    }

    /// The client has read everything up to message `number`. An answer to what was never asked changes nothing.
    pub(crate) fn answered(&mut self, number: u64, now: Duration) {
        while let Some(&(oldest, sent)) = self.unanswered.front()
            && oldest <= number
        {
            self.unanswered.pop_front();
            self.most_unanswered = match now.saturating_sub(sent) < SLOW {
                true => (self.most_unanswered + 1).min(MOST_UNANSWERED),
                false => 1,
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    /// Sends a message every 33 ms while that is allowed, to a client that reads one every `read_every_ms` and whose answers
    /// take `way_ms`. Gives how many went out in 20 s and the greatest age at which one was read, ms.
    fn run(read_every_ms: u32, way_ms: u32) -> (u64, u32) {
        let (mut pacing, mut line, mut answers) = (Pacing::default(), VecDeque::new(), VecDeque::new());
        let (mut sent, mut oldest) = (0, 0);
        for now in 0..20_000_u32 {
            while answers.front().is_some_and(|&(_, due)| due <= now) {
                let (number, _) = answers.pop_front().expect("it was looked at");
                pacing.answered(number, now * MS);
            }
            if now % 33 == 0 && pacing.may_send() {
                line.push_back((pacing.sent(now * MS), now));
                sent += 1;
            }
            if (now + 1) % read_every_ms == 0
                && let Some((number, made)) = line.pop_front()
            {
                oldest = oldest.max(now - made);
                answers.push_back((number, now + way_ms));
            }
        }
        (sent, oldest)
    }

    #[test]
    fn a_client_that_reads_at_once_gets_everything_even_from_afar() {
        assert_eq!(run(1, 1).0, 607);
        let (sent, _) = run(1, 200);
        assert!(sent > 590, "{sent} of 607 went out");
    }

    #[test]
    fn a_slow_client_reads_nothing_older_than_its_own_pause() {
        for pause_ms in [500, 1000] {
            let (sent, oldest_ms) = run(pause_ms, 1);
            assert!(sent >= 10, "{sent}");
            assert!(oldest_ms <= pause_ms, "{oldest_ms} ms");
        }
    }

    #[test]
    fn who_does_not_answer_is_sent_nothing_more() {
        let mut pacing = Pacing::default();
        let first = pacing.sent(MS);
        assert!(!pacing.may_send());
        pacing.answered(first - 1, 2 * MS);
        assert!(!pacing.may_send());
        pacing.answered(first, 3 * MS);
        assert!(pacing.may_send());
        // Nobody asked for that.
        pacing.answered(900, 4 * MS);
        assert!(pacing.may_send());
    }

    #[test]
    fn a_client_that_stops_reading_has_a_quarter_of_a_second_on_its_way() {
        let mut pacing = Pacing::default();
        for number in 0..100 {
            let sent = pacing.sent(number * 33 * MS);
            pacing.answered(sent, (number * 33 + 2) * MS);
        }
        let mut on_its_way = 0;
        while pacing.may_send() {
            pacing.sent(4000 * MS);
            on_its_way += 1;
        }
        assert_eq!(on_its_way, MOST_UNANSWERED);
    }
}

//! Who did what, and what came of it.

use std::{collections::VecDeque, fmt};

/// Entries that wait to be fetched; with more, the oldest go and are counted.
const MOST_WAITING: usize = 1024;
/// The same again within this time is counted, not listed: a page that repeats a refused request does so at its own rate.
const REPEAT_NS: u64 = 1_000_000_000;

/// One entry of the audit log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AuditEntry {
    /// When, ns since the station was opened.
    pub at_ns: u64,
    /// Who: an operator, or `station` for what the safety layer did by itself.
    pub who: String,
    /// What was asked for or done, in words.
    pub what: String,
    /// What came of it.
    pub outcome: Outcome,
}

/// What came of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It was done.
    Done,
    /// It was refused, for this reason.
    Refused(String),
}

impl fmt::Display for AuditEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.outcome {
            Outcome::Done => write!(f, "{}", self.what),
            Outcome::Refused(reason) => write!(f, "{}: refused, {reason}", self.what),
        }
    }
}

/// Entries that nobody has fetched yet.
#[derive(Clone, Debug, Default)]
pub(crate) struct Audit {
    waiting: VecDeque<AuditEntry>,
    last: Option<AuditEntry>,
    num_repeats: u64,
    num_lost: u64,
}

impl Audit {
    pub(crate) fn note(&mut self, at_ns: u64, who: &str, what: impl Into<String>, outcome: Outcome) {
        let entry = AuditEntry { at_ns, who: who.to_owned(), what: what.into(), outcome };
        if let Some(last) = &self.last
            && (&last.who, &last.what, &last.outcome) == (&entry.who, &entry.what, &entry.outcome)
            && at_ns.saturating_sub(last.at_ns) < REPEAT_NS
        {
            self.num_repeats += 1;
            return;
        }
        self.flush_repeats();
        self.push(entry.clone());
        self.last = Some(entry);
    }

    pub(crate) fn drain(&mut self) -> Vec<AuditEntry> {
        let mut entries = Vec::with_capacity(self.waiting.len() + 1);
        if self.num_lost > 0 {
            let at_ns = self.waiting.front().map_or(0, |entry| entry.at_ns);
            let what = format!("{} older entries were lost, because nobody fetched them", self.num_lost);
            entries.push(AuditEntry { at_ns, who: "station".to_owned(), what, outcome: Outcome::Done });
            self.num_lost = 0;
        }
        entries.extend(self.waiting.drain(..));
        entries
    }

    fn flush_repeats(&mut self) {
        let repeats = std::mem::take(&mut self.num_repeats);
        if let Some(last) = self.last.clone().filter(|_| repeats > 0) {
            self.push(AuditEntry { what: format!("{}, {repeats} times more", last.what), ..last });
        }
    }

    fn push(&mut self, entry: AuditEntry) {
        if self.waiting.len() >= MOST_WAITING {
            self.waiting.pop_front();
            self.num_lost += 1;
        }
        self.waiting.push_back(entry);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repetitions_are_counted_and_the_queue_is_bounded() {
        let mut audit = Audit::default();
        for at_ns in 0..5 {
            audit.note(at_ns, "ada", "arm", Outcome::Refused("stopped".to_owned()));
        }
        audit.note(9, "ada", "reset", Outcome::Done);
        let shown: Vec<String> = audit.drain().iter().map(ToString::to_string).collect();
        assert_eq!(shown, ["arm: refused, stopped", "arm, 4 times more: refused, stopped", "reset"]);
        for at_ns in 0..2_000_u64 {
            audit.note(at_ns, "ada", format!("request {at_ns}"), Outcome::Done);
        }
        let entries = audit.drain();
        assert_eq!(entries.len(), MOST_WAITING + 1);
        assert_eq!(entries[0].what, "976 older entries were lost, because nobody fetched them");
        assert!(audit.drain().is_empty());
    }

    #[test]
    fn the_same_a_second_later_is_listed_again() {
        let mut audit = Audit::default();
        audit.note(0, "ada", "arm", Outcome::Done);
        audit.note(REPEAT_NS, "ada", "arm", Outcome::Done);
        assert_eq!(audit.drain().len(), 2);
    }
}

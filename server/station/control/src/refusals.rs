//! Refused requests on their way to the audit log: every kind is noted, a flood of one kind as its number.

use std::collections::BTreeMap;

use crate::audit::Who;

/// Repetitions within this time are counted, not listed.
const REPEAT_NS: u64 = 1_000_000_000;
/// Kinds that may be counted at a time; with more, the oldest is written out.
const MAX_KINDS: usize = 256;

/// What was refused lately.
#[derive(Debug, Default)]
pub(crate) struct Refusals {
    kinds: BTreeMap<(String, String), Kind>,
}

#[derive(Debug)]
struct Kind {
    since_ns: u64,
    who: Who,
    what: String,
    num_repeats: u64,
}

impl Refusals {
    /// Notes that `who` was refused `what`; gives the lines of the audit log that are due, each with its author.
    pub(crate) fn note(&mut self, now_ns: u64, who: &Who, what: &str, problem: &str) -> Vec<(Who, String)> {
        let key = (who.connection.clone(), what.to_owned());
        if let Some(kind) = self.kinds.get_mut(&key) {
            kind.num_repeats += 1;
            return Vec::new();
        }
        let mut lines = Vec::new();
        if self.kinds.len() >= MAX_KINDS {
            let oldest = self.kinds.iter().min_by_key(|(_, kind)| kind.since_ns).map(|(key, _)| key.clone());
            lines.extend(oldest.and_then(|key| self.kinds.remove(&key)).and_then(Kind::line));
        }
        lines.push((who.clone(), format!("{what}: refused, {problem}")));
        let kind = Kind { since_ns: now_ns, who: who.clone(), what: what.to_owned(), num_repeats: 0 };
        self.kinds.insert(key, kind);
        lines
    }

    /// The lines about repetitions that are due.
    pub(crate) fn due(&mut self, now_ns: u64) -> Vec<(Who, String)> {
        let is_due = |kind: &Kind| now_ns.saturating_sub(kind.since_ns) >= REPEAT_NS;
        if !self.kinds.values().any(is_due) {
            return Vec::new();
        }
        let (due, kept) = std::mem::take(&mut self.kinds).into_iter().partition(|(_, kind)| is_due(kind));
        self.kinds = kept;
        let due: BTreeMap<_, Kind> = due;
        due.into_values().filter_map(Kind::line).collect()
    }
}

impl Kind {
    fn line(self) -> Option<(Who, String)> {
        (self.num_repeats > 0)
            .then(|| (self.who, format!("{}: refused {} times more", self.what, self.num_repeats)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_becomes_a_line_and_a_number() {
        let mut refusals = Refusals::default();
        let who = |n: usize| Who { name: String::new(), connection: format!("connection {n}") };
        let mut lines = Vec::new();
        for lease in 0..10_000 {
            lines.extend(refusals.note(lease, &who(1), "arm", &format!("lease {lease} is not yours")));
        }
        let texts: Vec<&str> = lines.iter().map(|(_, text)| text.as_str()).collect();
        assert_eq!(texts, ["arm: refused, lease 0 is not yours"]);
        assert!(refusals.due(REPEAT_NS - 1).is_empty());
        let due = refusals.due(REPEAT_NS);
        assert_eq!(due.len(), 1);
        assert_eq!(due[0].1, "arm: refused 9999 times more");
        for n in 0..1_000 {
            refusals.note(REPEAT_NS, &who(n), "arm", "no");
        }
        assert!(refusals.kinds.len() <= MAX_KINDS);
    }
}

//! Whether this page reads too slowly for the station: told while it does, and not as a count that only grows.

/// How long it is told after the last message was left out, s.
const TOLD_FOR_S: f64 = 10.0;

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Lag {
    dropped: u64,
    newest_s: Option<f64>,
}

impl Lag {
    /// Takes in how many messages the server has left out for this connection so far; whether that is to be told.
    pub(super) fn is_lagging(&mut self, dropped: u64, now_s: f64) -> bool {
        if dropped > self.dropped {
            self.newest_s = Some(now_s);
        }
        // A new connection counts from nothing.
        self.dropped = dropped;
        self.newest_s.is_some_and(|newest_s| now_s - newest_s < TOLD_FOR_S)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lag_is_told_while_it_lasts() {
        let mut lag = Lag::default();
        assert!(!lag.is_lagging(0, 1.0));
        assert!(lag.is_lagging(3, 2.0));
        assert!(lag.is_lagging(3, 11.9));
        assert!(!lag.is_lagging(3, 12.0), "what was left out long ago is over");
        assert!(!lag.is_lagging(0, 20.0), "a new connection");
        assert!(lag.is_lagging(1, 21.0));
    }
}

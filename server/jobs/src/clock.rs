//! The time of day as text.

use std::time::SystemTime;

use jiff::Timestamp;

/// Now, RFC 3339 in UTC with milliseconds.
pub fn rfc3339_now() -> String {
    format!("{:.3}", Timestamp::now())
}

/// `time`, likewise; what RFC 3339 cannot say becomes now.
pub fn rfc3339(time: SystemTime) -> String {
    format!("{:.3}", Timestamp::try_from(time).unwrap_or_else(|_| Timestamp::now()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_is_written_with_milliseconds_and_read_again() {
        let now = rfc3339_now();
        assert_eq!(now.len(), "2026-01-01T00:00:00.000Z".len(), "{now}");
        assert!(now.ends_with('Z'), "{now}");
        let read: Timestamp = now.parse().unwrap();
        assert!(Timestamp::now().duration_since(read).as_secs_f64() >= 0.0);
    }
}

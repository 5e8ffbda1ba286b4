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

/// How long before `now` the time `text` was, s; `None` if it is no time.
pub fn seconds_between(text: &str, now: SystemTime) -> Option<f64> {
    let (time, now): (Timestamp, Timestamp) = (text.parse().ok()?, Timestamp::try_from(now).ok()?);
    Some(now.duration_since(time).as_secs_f64())
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
        let later = SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(90);
        assert_eq!(seconds_between("1970-01-01T00:00:30Z", later), Some(60.0));
        assert_eq!(seconds_between("yesterday", later), None);
    }
}

//! People of a studio: who they are, what they may do, and how their browsers and programs show it.
//!
//! [`People`] keeps people, logins and API tokens in tables of the data folder's database, beside those of jobs. Whoever
//! makes a request is a [`Principal`]; [`People::authenticate`] finds it in memory, so that no request waits for the disk.
//! Passwords are kept as argon2id hashes; of cookies and tokens, which are 256 random bits, SHA-256 is kept. Attempts to log
//! in are counted by [`LoginLimits`]. What a route needs is the server's business, as is the wire.

mod error;
mod limits;
mod password;
mod people;
mod principal;
mod secret;
mod tables;

pub use error::PeopleError;
pub use limits::LoginLimits;
pub use people::{LoggedIn, People, TokenRequest};
pub use principal::{Denied, Presented, Principal};

/// Seconds since 1970.
pub fn now_s() -> i64 {
    jiff::Timestamp::now().as_second()
}

/// A time since 1970 as RFC 3339 has it.
pub fn rfc3339(seconds: i64) -> String {
    jiff::Timestamp::from_second(seconds).map_or_else(|_| "unknown".to_owned(), |time| time.to_string())
}

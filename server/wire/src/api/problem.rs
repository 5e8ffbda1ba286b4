//! Problems: what an answer says when a request could not be carried out, and which kinds of problems there are.

use serde::{Deserialize, Serialize};

/// RFC 9457 `application/problem+json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ProblemDetails {
    /// URI of the kind of problem, which stays the same over versions ([`ProblemType::uri`]).
    #[serde(rename = "type")]
    #[cfg_attr(feature = "openapi", schema(example = "urn:palpate:problem:not-found"))]
    pub kind: String,
    /// Short summary: the status in words.
    pub title: String,
    /// HTTP status.
    pub status: u16,
    /// What happened here, where, and what to do. For people; programs look at `type`.
    pub detail: String,
}

/// Makes the enum of kinds with its table: one line a kind.
macro_rules! problem_types {
    ($($name:ident, $slug:literal, $status:literal, $meaning:literal;)+) => {
        /// A kind of problem, which a program can tell from others by its URI.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        #[non_exhaustive]
        pub enum ProblemType {
            $(#[doc = $meaning] $name,)+
        }

        impl ProblemType {
            /// Every kind, by status.
            pub const ALL: &[Self] = &[$(Self::$name,)+];

            /// Its URI: the `type` of [`ProblemDetails`]. It never changes.
            pub fn uri(self) -> &'static str {
                match self { $(Self::$name => concat!("urn:palpate:problem:", $slug),)+ }
            }

            /// HTTP status of the answer.
            pub fn status(self) -> u16 {
                match self { $(Self::$name => $status,)+ }
            }

            /// When it is the answer, as a sentence.
            pub fn meaning(self) -> &'static str {
                match self { $(Self::$name => $meaning,)+ }
            }
        }
    };
}

problem_types! {
    BadRequest, "bad-request", 400, "A header, the path, the query or the JSON of the body cannot be read.";
    BadArgument, "bad-argument", 400, "A value makes no sense, whatever the data: an unknown method, kind, runner or cursor.";
    NotLoggedIn, "not-logged-in", 401, "The studio wants a login or an API token, and the request has none that counts.";
    ForeignOrigin, "foreign-origin", 403, "A page of another origin asks.";
    NotOperator, "not-operator", 403, "Only whoever has control of the station may do that, and the request does not carry the lease.";
    NotPermitted, "not-permitted", 403, "Whoever asks is known and may not: their role, or the scopes of their token, do not go so far.";
    NotFound, "not-found", 404, "There is nothing of that name.";
    NoStation, "no-station", 404, "The studio runs no live station.";
    NoRoute, "no-route", 404, "The API has no such path.";
    MethodNotAllowed, "method-not-allowed", 405, "The path does not take that method.";
    Conflict, "conflict", 409, "The state of the thing does not allow it now.";
    Exists, "exists", 409, "There is something of that name already.";
    KeyReused, "key-reused", 409, "The idempotency key came before with another request.";
    Cancelled, "cancelled", 409, "Somebody cancelled it meanwhile.";
    NotInstalled, "not-installed", 409, "The studio lacks a program that this kind of job needs. `detail` says which one, and how to get it.";
    TooLarge, "too-large", 413, "The body is larger than the studio takes.";
    UnsupportedMediaType, "unsupported-media-type", 415, "The body has another content type than the route takes.";
    RangeNotSatisfiable, "range-not-satisfiable", 416, "The file has no bytes in the range that was asked for.";
    ForeignHost, "foreign-host", 421, "The studio is not known under the host name of the request.";
    BadContent, "bad-content", 422, "The data cannot be used: the body has another form than the route takes, or a file is damaged.";
    TooManyRequests, "too-many-requests", 429, "This connection asks too often.";
    TooManyAttempts, "too-many-attempts", 429, "Too many attempts to log in. `Retry-After` says when the next one counts.";
    Failed, "failed", 500, "The studio failed; its log says more.";
    Busy, "busy", 503, "Too much work of that kind waits. `Retry-After` says when to try again.";
    DiskFull, "disk-full", 507, "The disk has no room for it.";
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn kinds_have_uris_of_their_own_and_are_sorted_by_status() {
        let uris: BTreeSet<&str> = ProblemType::ALL.iter().map(|kind| kind.uri()).collect();
        assert_eq!(uris.len(), ProblemType::ALL.len());
        assert!(ProblemType::ALL.is_sorted_by_key(|kind| kind.status()));
    }
}

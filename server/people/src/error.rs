//! What can go wrong with people.

use std::path::PathBuf;

/// Why something cannot be done.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PeopleError {
    /// What was given makes no sense.
    #[error("{0}")]
    Argument(String),
    /// No such person or token.
    #[error("no {what} {id:?}; {hint}")]
    NotFound {
        /// `person` or `token`.
        what: &'static str,
        /// What it was called.
        id: String,
        /// Where to look.
        hint: &'static str,
    },
    /// In the way of something that exists.
    #[error("{0}")]
    Conflict(String),
    /// Name and password do not belong together. It does not say which of them is wrong.
    #[error("this name and this password do not belong together")]
    WrongLogin,
    /// The database cannot be used.
    #[error("{path:?}: {problem}")]
    Database {
        /// Where it is.
        path: PathBuf,
        /// Why not, and what to do.
        problem: String,
    },
    /// A statement failed.
    #[error("failed to {action} in the database")]
    Sql {
        /// What was tried.
        action: &'static str,
        /// Why not.
        #[source]
        source: rusqlite::Error,
    },
    /// The operating system gives no random numbers.
    #[error("the operating system gives no random numbers: {0}")]
    Random(String),
}

impl PeopleError {
    pub(crate) fn sql(action: &'static str) -> impl FnOnce(rusqlite::Error) -> Self {
        move |source| Self::Sql { action, source }
    }

    pub(crate) fn no_person(name: &str) -> Self {
        Self::NotFound { what: "person", id: name.to_owned(), hint: "`palpate people list` lists them" }
    }
}

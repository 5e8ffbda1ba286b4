//! Rates, gaps, clock order and coverage of a session.

use palpate_wire::api::CheckReport;

use crate::{RecordingError, Session};

/// Checks every take of `session`.
pub fn check_session(session: &Session) -> Result<CheckReport, RecordingError> {
    let _ = session;
    todo!()
}

//! Standard output: a reader that has heard enough is no error.

use std::io::{self, Write as _};

use palpate_server::Error;
use serde::Serialize;

/// Prints `text` and a line end.
pub(super) fn line(text: &str) -> Result<(), Error> {
    match writeln!(io::stdout().lock(), "{text}") {
        Err(err) if err.kind() != io::ErrorKind::BrokenPipe => {
            Err(Error::Io { action: "write", path: "standard output".into(), source: err })
        }
        _ => Ok(()),
    }
}

/// Prints `document` as JSON.
pub(super) fn json(document: &impl Serialize) -> Result<(), Error> {
    let text = serde_json::to_string_pretty(document).map_err(|err| Error::Internal(err.to_string()))?;
    line(&text)
}

/// `seconds` as people say it.
pub(super) fn duration(seconds: f64) -> String {
    let whole = seconds.round() as u64;
    match whole {
        0..60 => format!("{seconds:.1} s"),
        60..3600 => format!("{} min {} s", whole / 60, whole % 60),
        _ => format!("{} h {} min", whole / 3600, whole % 3600 / 60),
    }
}

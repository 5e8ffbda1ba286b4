//! `palpate openapi`.

use std::process::ExitCode;

use super::{Outcome, output};

/// Prints the OpenAPI document of the studio's HTTP API.
pub(super) fn run() -> Outcome {
    output::json(&palpate_server::openapi_document())?;
    Ok(ExitCode::SUCCESS)
}

//! Errors as RFC 9457 problem details.

use axum::{
    http::{StatusCode, header},
    response::{IntoResponse, Response},
};
use palpate_wire::api::ProblemDetails;

use crate::{Class, Error, chain};

/// An error on its way to a client.
pub(crate) struct Problem(pub(crate) Error);

/// What a handler gives.
pub(crate) type Answer<T> = Result<T, Problem>;

impl<E: Into<Error>> From<E> for Problem {
    fn from(err: E) -> Self {
        Self(err.into())
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let status = match self.0.class() {
            Class::BadArgument => StatusCode::BAD_REQUEST,
            Class::BadContent => StatusCode::UNPROCESSABLE_ENTITY,
            Class::NotFound => StatusCode::NOT_FOUND,
            Class::Conflict | Class::Cancelled => StatusCode::CONFLICT,
            Class::TooLarge => StatusCode::PAYLOAD_TOO_LARGE,
            Class::Failed => StatusCode::INTERNAL_SERVER_ERROR,
        };
        let detail = chain(&self.0);
        if status.is_server_error() {
            tracing::error!(err = detail, "a request failed");
        }
        problem_response(status, &detail)
    }
}

/// `detail` as problem details.
pub(crate) fn problem_response(status: StatusCode, detail: &str) -> Response {
    let problem = ProblemDetails {
        kind: "about:blank".to_owned(),
        title: status.canonical_reason().unwrap_or("Error").to_owned(),
        status: status.as_u16(),
        detail: detail.to_owned(),
    };
    // Strings and a number always serialise.
    let body = serde_json::to_vec(&problem).unwrap_or_default();
    (status, [(header::CONTENT_TYPE, "application/problem+json")], body).into_response()
}

//! Errors as RFC 9457 problem details.

use axum::{
    http::{HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use palpate_wire::api::ProblemDetails;

use crate::{Class, Error, chain};

/// When a client that came at a busy moment may try again, s.
const RETRY_AFTER_S: &str = "10";

/// An error on its way to a client.
pub(crate) struct Problem(pub(crate) Error);

/// What a handler gives.
pub(crate) type Answer<T> = Result<T, Problem>;

impl<E: Into<Error>> From<E> for Problem {
    fn from(err: E) -> Self {
        Self(err.into())
    }
}

impl Problem {
    /// The status of the answer.
    pub(crate) fn status(&self) -> StatusCode {
        match self.0.class() {
            Class::BadArgument => StatusCode::BAD_REQUEST,
            Class::BadContent => StatusCode::UNPROCESSABLE_ENTITY,
            Class::NotFound => StatusCode::NOT_FOUND,
            Class::Conflict | Class::Cancelled => StatusCode::CONFLICT,
            Class::TooLarge => StatusCode::PAYLOAD_TOO_LARGE,
            Class::NotLoggedIn => StatusCode::UNAUTHORIZED,
            Class::TooOften => StatusCode::TOO_MANY_REQUESTS,
            Class::NotOperator | Class::NotPermitted => StatusCode::FORBIDDEN,
            Class::Busy => StatusCode::SERVICE_UNAVAILABLE,
            Class::DiskFull => StatusCode::INSUFFICIENT_STORAGE,
            Class::Failed => StatusCode::INTERNAL_SERVER_ERROR,
        }
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let status = self.status();
        let detail = chain(&self.0);
        if status == StatusCode::INTERNAL_SERVER_ERROR {
            tracing::error!(err = detail, "a request failed");
        }
        let mut response = problem_response(status, &detail);
        if let Error::TooOften { after_s, .. } = &self.0 {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(*after_s));
        }
        if status == StatusCode::SERVICE_UNAVAILABLE {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from_static(RETRY_AFTER_S));
        }
        response
    }
}

/// The text of an error response, kept beside it so that the door can leave out paths of this computer.
#[derive(Clone, Debug)]
pub(crate) struct Detail(pub(crate) String);

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
    let mut response = (status, [(header::CONTENT_TYPE, "application/problem+json")], body).into_response();
    response.extensions_mut().insert(Detail(detail.to_owned()));
    response
}

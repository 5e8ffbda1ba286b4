//! Errors as RFC 9457 problem details.

use axum::{
    http::{HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use palpate_wire::api::{ProblemDetails, ProblemType};

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
        status_of(type_of(self.0.class()))
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let detail = chain(&self.0);
        let kind = type_of(self.0.class());
        if kind == ProblemType::Failed {
            tracing::error!(err = detail, "a request failed");
        }
        let mut response = problem(kind, &detail);
        if let Error::TooOften { after_s, .. } = &self.0 {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(*after_s));
        }
        if kind == ProblemType::Busy {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from_static(RETRY_AFTER_S));
        }
        response
    }
}

fn type_of(class: Class) -> ProblemType {
    match class {
        Class::BadArgument => ProblemType::BadArgument,
        Class::BadContent => ProblemType::BadContent,
        Class::NotFound => ProblemType::NotFound,
        Class::NoStation => ProblemType::NoStation,
        Class::Conflict => ProblemType::Conflict,
        Class::Exists => ProblemType::Exists,
        Class::KeyReused => ProblemType::KeyReused,
        Class::Cancelled => ProblemType::Cancelled,
        Class::NotInstalled => ProblemType::NotInstalled,
        Class::MediaType => ProblemType::UnsupportedMediaType,
        Class::TooLarge => ProblemType::TooLarge,
        Class::NotOperator => ProblemType::NotOperator,
        Class::NotLoggedIn => ProblemType::NotLoggedIn,
        Class::NotPermitted => ProblemType::NotPermitted,
        Class::TooOften => ProblemType::TooManyAttempts,
        Class::Busy => ProblemType::Busy,
        Class::DiskFull => ProblemType::DiskFull,
        Class::Failed => ProblemType::Failed,
    }
}

/// The kind and text of an error response, kept beside it so that the door can leave out paths of this computer.
#[derive(Clone, Debug)]
pub(crate) struct Detail {
    pub(crate) kind: Option<ProblemType>,
    pub(crate) text: String,
}

/// `detail` as problem details of a kind.
pub(crate) fn problem(kind: ProblemType, detail: &str) -> Response {
    respond(status_of(kind), Some(kind), detail)
}

fn status_of(kind: ProblemType) -> StatusCode {
    StatusCode::from_u16(kind.status()).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR)
}

/// `detail` as problem details where only the status is known: of the kind that has this status, or the usual one of
/// several.
pub(crate) fn problem_response(status: StatusCode, detail: &str) -> Response {
    // Of several with one status, the first in the list is the usual one.
    let usual = ProblemType::ALL.iter().copied().find(|kind| kind.status() == status.as_u16());
    respond(status, usual, detail)
}

/// A problem of a status that has no kind is `about:blank`: the status says it all (RFC 9457, 4.2.1).
pub(crate) fn respond(status: StatusCode, kind: Option<ProblemType>, detail: &str) -> Response {
    let problem = ProblemDetails {
        kind: kind.map_or("about:blank", ProblemType::uri).to_owned(),
        title: status.canonical_reason().unwrap_or("Error").to_owned(),
        status: status.as_u16(),
        detail: detail.to_owned(),
    };
    // Strings and a number always serialise.
    let body = serde_json::to_vec(&problem).unwrap_or_default();
    let mut response = (status, [(header::CONTENT_TYPE, "application/problem+json")], body).into_response();
    response.extensions_mut().insert(Detail { kind, text: detail.to_owned() });
    response
}

//! Extractors whose refusals are problem details like all others.

use std::{convert::Infallible, sync::Arc};

use axum::{
    Json,
    extract::{FromRequest, FromRequestParts, Path, Query, Request, WebSocketUpgrade},
    http::{Extensions, request::Parts},
    response::Response,
};
use palpate_control::Claim;
use palpate_people::{Denied, Principal};
use palpate_wire::api::{IDEMPOTENCY_HEADER, LEASE_HEADER, ProblemType};
use serde::{Deserialize, de::DeserializeOwned};
use utoipa::IntoParams;

use super::{
    identity::{Client, Shown},
    problem::{problem, problem_response},
};

/// Longest idempotency key, bytes.
const MAX_KEY_BYTES: usize = 255;
/// Most entries of a page of a list.
const MAX_PAGE: u32 = 1000;
/// Entries of a page that begins at a cursor, where the client does not say how many.
pub(crate) const USUAL_PAGE: u32 = 100;

/// What is said of a peer whose address is not known.
const UNKNOWN: &str = "an unknown address";

/// Whoever makes the request; the route has let them in.
pub(crate) struct Asking(pub(crate) Principal);

/// Whose a job is that the request makes: the person, or an address without a login.
pub(crate) struct Owner(pub(crate) Arc<str>);

/// Who is at the other end, as the audit log names them: the address, and the person where there is a login.
pub(crate) struct Peer(pub(crate) Arc<str>);

/// The claim of a request to come from the operator.
pub(crate) struct Lease(pub(crate) Claim);

impl<S: Send + Sync> FromRequestParts<S> for Peer {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Infallible> {
        let address =
            parts.extensions.get::<Client>().map_or_else(|| UNKNOWN.to_owned(), |client| client.text.clone());
        Ok(Self(match principal(&parts.extensions) {
            Some(principal) if !principal.is_local() => format!("{address} ({})", principal.label()).into(),
            _ => address.into(),
        }))
    }
}

/// Whoever makes the request, if that is known.
fn principal(extensions: &Extensions) -> Option<&Principal> {
    extensions.get::<Shown>().and_then(|Shown(shown)| shown.as_ref().ok())
}

impl<S: Send + Sync> FromRequestParts<S> for Asking {
    type Rejection = Response;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Response> {
        let known = principal(&parts.extensions).cloned().map(Self);
        known.ok_or_else(|| problem(ProblemType::NotLoggedIn, &Denied::Missing.to_string()))
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Owner {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Infallible> {
        if let Some(principal) = principal(&parts.extensions).filter(|principal| !principal.is_local()) {
            return Ok(Self(principal.name().clone()));
        }
        let Ok(Peer(peer)) = Peer::from_request_parts(parts, state).await;
        Ok(Self(peer))
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Lease {
    type Rejection = Response;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Response> {
        let Ok(Peer(peer)) = Peer::from_request_parts(parts, state).await;
        let lease = match parts.headers.get(LEASE_HEADER) {
            None => Some(0),
            Some(value) => value.to_str().ok().and_then(|value| value.trim().parse().ok()),
        };
        let Some(lease) = lease else {
            let detail = format!(
                "the header {LEASE_HEADER} is not the number of a lease, as the control socket gives it"
            );
            return Err(problem(ProblemType::BadRequest, &detail));
        };
        Ok(Self(Claim { lease, peer }))
    }
}

/// What a client calls a request that starts work.
#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
pub(crate) struct Key {
    /// A text of the client's choice, 1 to 255 ASCII characters. The same key with the same request gives the job that the
    /// first one started (200 instead of 202), also after a restart of the studio; with another request it is refused.
    #[param(rename = "Idempotency-Key", min_length = 1, max_length = 255)]
    pub(crate) key: Option<String>,
}

impl<S: Send + Sync> FromRequestParts<S> for Key {
    type Rejection = Response;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Response> {
        let mut values = parts.headers.get_all(IDEMPOTENCY_HEADER).iter();
        let Some(value) = values.next() else { return Ok(Self { key: None }) };
        let key =
            value.to_str().ok().map(str::trim).filter(|key| !key.is_empty() && key.len() <= MAX_KEY_BYTES);
        match key.filter(|_| values.next().is_none()) {
            Some(key) => Ok(Self { key: Some(key.to_owned()) }),
            None => {
                let detail = format!(
                    "the header {IDEMPOTENCY_HEADER} must be one text of 1 to {MAX_KEY_BYTES} ASCII characters"
                );
                Err(problem(ProblemType::BadRequest, &detail))
            }
        }
    }
}

/// Which part of a list to answer with.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct Page {
    /// Most entries of the answer; without, it is the whole list. The header `Link` names the next page.
    #[param(minimum = 1, maximum = 1000)]
    pub(crate) limit: Option<u32>,
    /// Where the page before ended, as its header `Link` says.
    pub(crate) cursor: Option<String>,
}

/// Refuses pages of no entries and of too many.
pub(crate) fn check_limit(limit: Option<u32>) -> Result<(), crate::Error> {
    match limit {
        Some(limit) if !(1..=MAX_PAGE).contains(&limit) => {
            Err(crate::Error::Argument(format!("limit {limit}; a page has 1 to {MAX_PAGE} entries")))
        }
        _ => Ok(()),
    }
}

/// Ids in the path.
pub(crate) struct Ids<T>(pub(crate) T);

/// The query.
pub(crate) struct Params<T>(pub(crate) T);

/// A JSON body.
pub(crate) struct Body<T>(pub(crate) T);

/// A body that is text.
pub(crate) struct Text(pub(crate) String);

/// A request to become a WebSocket.
pub(crate) struct Upgrade(pub(crate) WebSocketUpgrade);

impl<S: Send + Sync, T: DeserializeOwned + Send> FromRequestParts<S> for Ids<T> {
    type Rejection = Response;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Response> {
        match Path::<T>::from_request_parts(parts, state).await {
            Ok(Path(ids)) => Ok(Self(ids)),
            Err(err) => Err(problem_response(err.status(), &err.body_text())),
        }
    }
}

impl<S: Send + Sync, T: DeserializeOwned> FromRequestParts<S> for Params<T> {
    type Rejection = Response;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Response> {
        match Query::<T>::from_request_parts(parts, state).await {
            Ok(Query(params)) => Ok(Self(params)),
            Err(err) => Err(problem_response(err.status(), &err.body_text())),
        }
    }
}

impl<S: Send + Sync, T: DeserializeOwned> FromRequest<S> for Body<T> {
    type Rejection = Response;

    async fn from_request(request: Request, state: &S) -> Result<Self, Response> {
        match Json::<T>::from_request(request, state).await {
            Ok(Json(body)) => Ok(Self(body)),
            Err(err) => Err(problem_response(err.status(), &err.body_text())),
        }
    }
}

impl<S: Send + Sync> FromRequest<S> for Text {
    type Rejection = Response;

    async fn from_request(request: Request, state: &S) -> Result<Self, Response> {
        match String::from_request(request, state).await {
            Ok(text) => Ok(Self(text)),
            Err(err) => Err(problem_response(err.status(), &err.body_text())),
        }
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Upgrade {
    type Rejection = Response;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Response> {
        match WebSocketUpgrade::from_request_parts(parts, state).await {
            Ok(upgrade) => Ok(Self(upgrade)),
            Err(err) => {
                let detail = format!("{}; this path is a WebSocket", err.body_text());
                Err(problem(ProblemType::BadRequest, &detail))
            }
        }
    }
}

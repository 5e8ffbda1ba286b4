//! Extractors whose refusals are problem details like all others.

use std::{convert::Infallible, sync::Arc};

use axum::{
    Json,
    extract::{FromRequest, FromRequestParts, Path, Query, Request},
    http::{Extensions, StatusCode, request::Parts},
    response::Response,
};
use palpate_control::Claim;
use palpate_people::{Denied, Principal};
use palpate_wire::api::LEASE_HEADER;
use serde::de::DeserializeOwned;

use super::{
    identity::{Client, Shown},
    problem::problem_response,
};

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
        known.ok_or_else(|| problem_response(StatusCode::UNAUTHORIZED, &Denied::Missing.to_string()))
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
            return Err(problem_response(StatusCode::BAD_REQUEST, &detail));
        };
        Ok(Self(Claim { lease, peer }))
    }
}

/// Ids in the path.
pub(crate) struct Ids<T>(pub(crate) T);

/// The query.
pub(crate) struct Params<T>(pub(crate) T);

/// A JSON body.
pub(crate) struct Body<T>(pub(crate) T);

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

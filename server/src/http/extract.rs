//! Extractors whose refusals are problem details like all others.

use std::{convert::Infallible, net::SocketAddr, sync::Arc};

use axum::{
    Json,
    extract::{ConnectInfo, FromRequest, FromRequestParts, Path, Query, Request},
    http::{StatusCode, request::Parts},
    response::Response,
};
use palpate_control::Claim;
use palpate_wire::api::LEASE_HEADER;
use serde::de::DeserializeOwned;

use super::problem::problem_response;

/// Who is at the other end, as the audit log names them.
pub(crate) struct Peer(pub(crate) Arc<str>);

/// The claim of a request to come from the operator.
pub(crate) struct Lease(pub(crate) Claim);

impl<S: Send + Sync> FromRequestParts<S> for Peer {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Infallible> {
        let info = parts.extensions.get::<ConnectInfo<SocketAddr>>();
        Ok(Self(info.map_or_else(|| "an unknown address".into(), |info| info.0.to_string().into())))
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

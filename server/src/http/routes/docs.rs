//! The manual.

use axum::{
    Json,
    http::header,
    response::{IntoResponse, Response},
};
use palpate_wire::api::DocSummary;

use crate::{
    http::{
        documented::{Binary, Refusal},
        extract::Ids,
        problem::Answer,
    },
    manual,
};

/// Lists the documents of the manual, by name.
#[utoipa::path(
    get,
    path = "/docs",
    tag = "docs",
    responses((status = 200, description = "Done.", body = Vec<DocSummary>)),
)]
pub(super) async fn list() -> Json<&'static [DocSummary]> {
    Json(manual::list())
}

/// Answers with a document as Markdown. Links between documents are as in the sources: `jobs.md` is the document `jobs`.
#[utoipa::path(
    get,
    path = "/docs/{doc}",
    tag = "docs",
    responses((status = 200, description = "Done.", body = String, content_type = "text/markdown"), Refusal<404>),
)]
pub(super) async fn text(Ids(name): Ids<String>) -> Answer<Response> {
    let text = manual::text(&name)?;
    Ok(([(header::CONTENT_TYPE, "text/markdown; charset=utf-8")], text).into_response())
}

/// Answers with a picture that a document shows.
#[utoipa::path(
    get,
    path = "/docs/pictures/{picture}",
    tag = "docs",
    responses(
        (status = 200, description = "Done.", content((Binary = "image/png"), (Binary = "image/svg+xml"))),
        Refusal<404>,
    ),
)]
pub(super) async fn picture(Ids(name): Ids<String>) -> Answer<Response> {
    let (content_type, bytes) = manual::picture(&name)?;
    Ok(([(header::CONTENT_TYPE, content_type)], bytes).into_response())
}

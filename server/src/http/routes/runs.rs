//! The routes that runs of every kind have: start, list, detail, cancel, report and table.

use axum::{
    Json,
    http::{StatusCode, header},
    response::{IntoResponse as _, Response},
};
use palpate_wire::api::ModelSummary;

use crate::{AppState, hub::List};

/// Names that [`run_routes`] needs where it is called.
pub(super) mod names {
    pub(in crate::http::routes) use std::sync::Arc;

    pub(in crate::http::routes) use axum::{
        Json,
        extract::{OriginalUri, State},
        http::header,
        response::{Html, IntoResponse as _, Response},
    };

    pub(in crate::http::routes) use crate::{
        AppState,
        http::{
            documented::Refusal,
            extract::{Body, Ids, Key, Owner, Page, Params, check_limit},
            pages::page_of,
            problem::Answer,
            routes::accepted,
        },
        work::Kind,
    };
}

/// Writes the routes of one kind of run into the module that calls it: `start`, `list`, `detail`, `cancel`, `report` and
/// `table`.
///
/// `$runs` is their path, their tag and the function of [`AppState`] that gives them; `$run` is the word for one of them and
/// `$job` its kind of job. `$location` stands apart because `utoipa` takes no `concat!` there.
macro_rules! run_routes {
    (
        runs: $runs:ident,
        run: $run:literal,
        location: $location:literal,
        job: $job:literal,
        request: $request:ident,
        answer: $answer:ident as $schema:ident,
        tables: $tables:literal,
    ) => {
        #[utoipa::path(
            post,
            path = concat!("/", stringify!($runs)),
            tag = stringify!($runs),
            summary = concat!("Starts a ", $run, ", which is a job of kind `", $job, "`."),
            params(Key),
            request_body = $request,
            responses(
                (status = 202, description = "It is queued.", body = $schema,
                    headers(("Location" = String, description = $location))),
                (status = 200, description = "It was started by an earlier request with the same key.", body = $schema,
                    headers(("Location" = String, description = $location))),
                Refusal<404>, Refusal<409>,
            ),
        )]
        pub(super) async fn start(
            State(state): State<Arc<AppState>>,
            Owner(owner): Owner,
            Key { key }: Key,
            Body(request): Body<$request>,
        ) -> Answer<Response> {
            let start = move |state: &AppState| state.$runs().start(&request, &owner, key.as_deref());
            let (run, is_new) = state.run(Kind::Read, start).await?;
            let location = format!("/api/v1/{}/{}", stringify!($runs), run.id);
            Ok((accepted(is_new), [(header::LOCATION, location)], Json(run)).into_response())
        }

        #[utoipa::path(
            get,
            path = concat!("/", stringify!($runs)),
            tag = stringify!($runs),
            summary = concat!("Lists ", stringify!($runs), ", newest first, without reports and texts of models."),
            params(Page),
            responses((status = 200, description = "Done.", body = Vec<$schema>)),
        )]
        pub(super) async fn list(
            State(state): State<Arc<AppState>>,
            OriginalUri(uri): OriginalUri,
            Params(page): Params<Page>,
        ) -> Answer<Response> {
            check_limit(page.limit)?;
            let list = move |state: &AppState| state.$runs().list(page.limit, page.cursor);
            let (runs, next) = state.run(Kind::Read, list).await?;
            Ok(page_of(&uri, Json(runs), next.as_deref()))
        }

        #[utoipa::path(
            get,
            path = concat!("/", stringify!($runs), "/{run}"),
            tag = stringify!($runs),
            summary = concat!("Answers with a ", $run, ", and its report once it is done."),
            responses((status = 200, description = "Done.", body = $schema), Refusal<404>),
        )]
        pub(super) async fn detail(
            State(state): State<Arc<AppState>>,
            Ids(id): Ids<String>,
        ) -> Answer<Json<$answer>> {
            state.run(Kind::Read, move |state| state.$runs().get(&id).map(Json)).await
        }

        #[utoipa::path(
            post,
            path = concat!("/", stringify!($runs), "/{run}/cancel"),
            tag = stringify!($runs),
            summary = concat!("Asks a ", $run, " to stop; one that has ended stays as it is."),
            responses((status = 200, description = "Done.", body = $schema), Refusal<404>),
        )]
        pub(super) async fn cancel(
            State(state): State<Arc<AppState>>,
            Ids(id): Ids<String>,
        ) -> Answer<Json<$answer>> {
            state.run(Kind::Read, move |state| state.$runs().cancel(&id).map(Json)).await
        }

        #[utoipa::path(
            get,
            path = concat!("/", stringify!($runs), "/{run}/report.html"),
            tag = stringify!($runs),
            summary = concat!("Answers with the report of a ", $run, " for people, a page of its own."),
            responses(
                (status = 200, description = "Done.", body = String, content_type = "text/html"),
                Refusal<404>,
            ),
        )]
        pub(super) async fn report(
            State(state): State<Arc<AppState>>,
            Ids(id): Ids<String>,
        ) -> Answer<Html<String>> {
            state.run(Kind::Read, move |state| state.$runs().html(&id).map(Html)).await
        }

        #[utoipa::path(
            get,
            path = concat!("/", stringify!($runs), "/{run}/tables/{file}"),
            tag = stringify!($runs),
            summary = concat!("Answers with numbers of a ", $run, " as a table: ", $tables),
            responses(
                (status = 200, description = "Done.", body = String, content_type = "text/csv"),
                Refusal<404>, Refusal<409>,
            ),
        )]
        pub(super) async fn table(
            State(state): State<Arc<AppState>>,
            Ids((id, file)): Ids<(String, String)>,
        ) -> Answer<Response> {
            let text = state.run(Kind::Compute, move |state| state.$runs().table(&id, file)).await?;
            Ok(([(header::CONTENT_TYPE, "text/csv; charset=utf-8")], text).into_response())
        }
    };
}

pub(super) use run_routes;

/// Answers with a model that a run found and that was kept, and tells everybody.
pub(super) fn kept(state: &AppState, status: StatusCode, model: ModelSummary) -> Response {
    state.hub().publish_changed(List::Models, &model.id);
    let location = format!("/api/v1/models/{}", model.id);
    (status, [(header::LOCATION, location)], Json(model)).into_response()
}

//! What is said of a handler above it, for the OpenAPI document.

use std::{borrow::Cow, collections::BTreeMap, fmt};

use axum::http::Method;
use palpate_reports::{CalibrationReport, DiagnosisReport};
use palpate_wire::api::{CalibrationRequest, CalibrationRun, DiagnosisRequest, DiagnosisRun};
use utoipa::{
    IntoResponses, PartialSchema, ToSchema,
    openapi::{PathItem, Paths, Ref, RefOr, Schema, path::Operation, response::Response as Answer},
};

/// Bytes of a file or a message.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
#[expect(dead_code, reason = "its form is all that is asked of it")]
pub(super) struct Binary(Vec<u8>);

/// One server-sent event.
#[derive(ToSchema)]
#[expect(dead_code, reason = "its form is all that is asked of it")]
pub(super) struct JobEvent {
    /// Attempt and state, by which a client that lost the connection goes on.
    id: String,
    /// `job`.
    event: String,
    /// A `Job` as JSON.
    data: String,
}

/// Gives `$run` a schema under its own name: `utoipa` calls generic types alike whatever their arguments are.
macro_rules! run_schema {
    ($schema:ident, $name:literal, $run:ty, $request:ty, $report:ty) => {
        pub(super) struct $schema;

        impl PartialSchema for $schema {
            fn schema() -> RefOr<Schema> {
                <$run>::schema()
            }
        }

        impl ToSchema for $schema {
            fn name() -> Cow<'static, str> {
                $name.into()
            }

            fn schemas(schemas: &mut Vec<(String, RefOr<Schema>)>) {
                <$run>::schemas(schemas);
                schemas.push((<$request>::name().into_owned(), <$request>::schema()));
                <$request>::schemas(schemas);
                schemas.push((<$report>::name().into_owned(), <$report>::schema()));
                <$report>::schemas(schemas);
            }
        }
    };
}

run_schema!(CalibrationRunSchema, "CalibrationRun", CalibrationRun, CalibrationRequest, CalibrationReport);
run_schema!(DiagnosisRunSchema, "DiagnosisRun", DiagnosisRun, DiagnosisRequest, DiagnosisReport);

/// A refusal with this status, as problem details of one of the kinds that have it.
pub(super) struct Refusal<const STATUS: u16>;

impl<const STATUS: u16> IntoResponses for Refusal<STATUS> {
    fn responses() -> BTreeMap<String, RefOr<Answer>> {
        BTreeMap::from([(STATUS.to_string(), refusal(STATUS))])
    }
}

pub(super) fn refusal(status: u16) -> RefOr<Answer> {
    RefOr::Ref(Ref::new(format!("#/components/responses/{}", refusal_name(status))))
}

pub(super) fn refusal_name(status: u16) -> String {
    format!("Refusal{status}")
}

/// What is said of a route.
#[derive(Clone)]
pub(super) struct Documented {
    pub(super) operation: Operation,
    /// Method and path as they stand above the handler, for the test that they are those of the table.
    said: (Method, String),
    /// The verb of its row.
    verb: &'static str,
    pub(super) schemas: Vec<(String, RefOr<Schema>)>,
}

impl fmt::Debug for Documented {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (method, path) = &self.said;
        f.debug_struct("Documented").field("method", method).field("path", path).finish_non_exhaustive()
    }
}

impl Documented {
    /// Of the handler at path `name`, as `utoipa_axum::routes!` gives it.
    pub(super) fn new(
        name: &str,
        verb: &'static str,
        schemas: Vec<(String, RefOr<Schema>)>,
        paths: Paths,
    ) -> Self {
        let (path, item) = paths.paths.into_iter().next().unwrap_or_default();
        let (method, mut operation) = only_operation(item);
        // Functions are called alike in several modules.
        operation.operation_id = Some(name.split("::").map(str::trim).collect::<Vec<_>>().join("_"));
        Self { operation, said: (method, path), verb, schemas }
    }

    /// What stands above the handler and in its row agrees with the row's method and path; else what does not.
    pub(super) fn disagreement(&self, method: &Method, path: &str) -> Option<String> {
        let (said_method, said_path) = &self.said;
        let agrees =
            said_method == method && said_path == path && self.verb.eq_ignore_ascii_case(method.as_str());
        (!agrees).then(|| {
            format!(
                "{method} {path} in the table, {said_method} {said_path} above the handler, {} in its row",
                self.verb
            )
        })
    }

    pub(super) fn is_socket(&self) -> bool {
        self.operation.responses.responses.contains_key("101")
    }

    pub(super) fn sends_events(&self) -> bool {
        match self.operation.responses.responses.get("200") {
            Some(RefOr::T(answer)) => answer.content.contains_key("text/event-stream"),
            _ => false,
        }
    }
}

fn only_operation(item: PathItem) -> (Method, Operation) {
    let PathItem { get, put, post, delete, patch, .. } = item;
    let found = [
        (Method::GET, get),
        (Method::PUT, put),
        (Method::POST, post),
        (Method::DELETE, delete),
        (Method::PATCH, patch),
    ];
    found
        .into_iter()
        .find_map(|(method, operation)| Some((method, operation?)))
        .unwrap_or((Method::OPTIONS, Operation::new()))
}

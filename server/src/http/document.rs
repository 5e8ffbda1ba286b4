//! The OpenAPI document: made from the table of routes and from what stands above each handler.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::OnceLock,
};

use axum::{
    body::Bytes,
    http::{HeaderValue, Method, header},
    response::{IntoResponse as _, Response},
};
use palpate_wire::api::{
    BlindRequest, ComparisonReport, ComparisonRequest, DemonstrationsRequest, EmulateRequest,
    EvaluationRequest, ExpertRequest, GatheringRequest, ImitationRequest, LEASE_HEADER, PipelineRequest,
    PretrainingRequest, ProblemDetails, ProblemType, RolloutsRequest, TuneRequest,
};
use serde_json::{Value, json};
use utoipa::{
    OpenApi as _, ToSchema,
    openapi::{
        Content, Header, HttpMethod, ObjectBuilder, OpenApi, Ref, RefOr, Required, Schema,
        extensions::ExtensionsBuilder,
        path::{Operation, Parameter, ParameterBuilder, ParameterIn},
        response::{Response as Answer, ResponseBuilder},
        schema::{SchemaType, Type},
        security::{ApiKey, ApiKeyValue, HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme},
        server::Server,
    },
};

use super::{
    documented::{Documented, refusal, refusal_name},
    examples::{self, Example},
    route::{Needs, NeedsLease, Route},
};

/// The document without what is said of routes.
#[derive(utoipa::OpenApi)]
#[openapi(
    info(title = "Palpate", description = ABOUT, version = "1"),
    tags(
        (name = "studio", description = "What runs, and this document."),
        (name = "docs", description = "The manual: what people read, as Markdown."),
        (name = "trash", description = "What was deleted and can be taken out again."),
        (name = "sessions", description = "Recorded takes: in by upload, out as traces, to the trash and back."),
        (name = "models", description = "Saved sensor models."),
        (name = "calibrations", description = "Jobs that fit the sensor model to a session."),
        (name = "diagnoses", description = "Jobs that name what a calibrated model lacks."),
        (name = "jobs", description = "Long work of every kind, which outlives the studio (`docs/jobs.md`)."),
        (name = "objects", description = "What is touched."),
        (name = "station", description = "The live station: its state, its stream and its commands."),
        (name = "recording", description = "Guided sessions on the live station."),
        (name = "campaigns", description = "Policies tried on the hand, trials scored by people (`docs/campaigns.md`)."),
        (name = "people", description = "Who may log in, API tokens (`docs/people.md`). A studio on loopback needs neither."),
        (name = "emulator", description = "What only an emulated station can do; a real one has no such paths."),
    ),
    components(schemas(
        ProblemDetails,
        EmulateRequest,
        BlindRequest,
        TuneRequest,
        ExpertRequest,
        EvaluationRequest,
        DemonstrationsRequest,
        PretrainingRequest,
        GatheringRequest,
        ImitationRequest,
        PipelineRequest,
        RolloutsRequest,
        ComparisonRequest,
        ComparisonReport
    )),
)]
struct Head;

const ABOUT: &str = "The HTTP API of a Palpate studio. `docs/api.md` shows how to script it.

Answers to requests that could not be carried out are problem details (RFC 9457): programs look at `type`, people read `detail`. \
Answers to GET carry an `ETag`; with `If-None-Match` a client is told by 304 that it has the document already. Lists that \
grow are sent in pages with `limit` and `cursor`; the header `Link` names the next one. `x-palpate-needs` says what a \
request must show. The examples (`x-codeSamples`) are carried out by a test in the order of their `step`, on a studio that \
begins empty (`palpate serve --emulate small`); `$PALPATE_URL` is its address, `recordings.zip` a zipped session of \
`palpate emulate --truth bench`, and `$LEASE` the lease of whoever has control.";

/// What any request may be refused with: by the door, by the limits of connections and work, by a fault.
const ANYWHERE: &[u16] = &[400, 421, 429, 500, 503];
/// What any request that changes something may be refused with besides.
const CHANGING: &[u16] = &[403];
/// What any request with a body of JSON may be refused with besides, by [`super::extract::Body`].
const WITH_JSON: &[u16] = &[413, 415, 422];

/// The document of `routes` as JSON. Its fields are sorted: `utoipa` keeps some in an order that changes from run to run.
pub(super) fn written(routes: &[Route]) -> Value {
    // A document of strings, numbers and lists of them always serialises.
    sorted(serde_json::to_value(document_of(routes)).unwrap_or_default())
}

fn sorted(value: Value) -> Value {
    match value {
        Value::Object(fields) => {
            let fields: BTreeMap<String, Value> = fields.into_iter().collect();
            Value::Object(fields.into_iter().map(|(name, value)| (name, sorted(value))).collect())
        }
        Value::Array(items) => Value::Array(items.into_iter().map(sorted).collect()),
        other => other,
    }
}

/// The document of the routes that a studio has, as an answer; `routes` are asked for once.
pub(super) fn answer(with_emulator: bool, routes: impl FnOnce() -> Vec<Route>) -> Response {
    static DOCUMENTS: [OnceLock<Bytes>; 2] = [OnceLock::new(), OnceLock::new()];
    let [without, with] = &DOCUMENTS;
    let document = if with_emulator { with } else { without };
    let make = || written(&routes()).to_string().into();
    let document = document.get_or_init(make).clone();
    ([(header::CONTENT_TYPE, HeaderValue::from_static("application/json"))], document).into_response()
}

fn document_of(routes: &[Route]) -> OpenApi {
    let mut document = Head::openapi();
    document.servers = Some(vec![Server::new("/api/v1")]);
    let components = document.components.get_or_insert_default();
    for route in routes {
        let Some(documented) = &route.documented else { continue };
        components.schemas.extend(documented.schemas.iter().cloned());
        let operation = operation_of(route, documented);
        document.paths.add_path_operation(route.path, vec![http_method(&route.method)], operation);
    }
    let statuses: BTreeSet<u16> = ProblemType::ALL.iter().map(|kind| kind.status()).collect();
    for status in statuses {
        components.responses.insert(refusal_name(status), RefOr::T(described(status)));
    }
    security(components);
    document
}

/// How a request shows who sends it.
const BEARER: &str = "token";
const COOKIE: &str = "login";

/// Declares how a request shows who sends it. What each route needs is in [`operation_of`].
fn security(components: &mut utoipa::openapi::Components) {
    let token = HttpBuilder::new()
        .scheme(HttpAuthScheme::Bearer)
        .bearer_format("plp_ and 64 hexadecimal digits")
        .description(Some("An API token, as `palpate tokens create` and `POST /tokens` make them."))
        .build();
    let login =
        ApiKeyValue::with_description("__Host-palpate", "The cookie of a login, which `POST /login` sets.");
    components.add_security_scheme(BEARER, SecurityScheme::Http(token));
    components.add_security_scheme(COOKIE, SecurityScheme::ApiKey(ApiKey::Cookie(login)));
}

/// A token, a cookie, or nothing where there is no login. Nothing at all where nobody has to log in.
fn security_of(needs: Needs) -> Vec<SecurityRequirement> {
    let none: [&str; 0] = [];
    match needs.role {
        None => vec![SecurityRequirement::default()],
        Some(_) => vec![
            SecurityRequirement::new(BEARER, none),
            SecurityRequirement::new(COOKIE, none),
            SecurityRequirement::default(),
        ],
    }
}

/// What `needs` asks of a request about the lease: a word for programs, a sentence for people, and the headers that show it.
fn shown(needs: NeedsLease) -> (&'static str, &'static str, Option<Parameter>) {
    let lease = |required| {
        ParameterBuilder::new()
            .name("Palpate-Lease")
            .parameter_in(ParameterIn::Header)
            .required(required)
            .description(Some(
                "The lease of an open connection of `/control`, as its `ControlReply` gives it.",
            ))
            .schema(Some(ObjectBuilder::new().schema_type(Type::String).pattern(Some("^[0-9]{1,20}$"))))
            .build()
    };
    debug_assert!(LEASE_HEADER.eq_ignore_ascii_case("Palpate-Lease"));
    match needs {
        NeedsLease::No => ("nothing", "", None),
        NeedsLease::Always => {
            ("operator", "Only whoever has control of the station may do this.", Some(lease(Required::False)))
        }
        NeedsLease::IfAny => (
            "operator-if-any",
            "While somebody has control of the station, or a session is being recorded, only whoever has control may do \
             this.",
            Some(lease(Required::False)),
        ),
    }
}

/// What stands above the handler of `route`, with what is true of all routes.
fn operation_of(route: &Route, documented: &Documented) -> Operation {
    let mut operation = documented.operation.clone();
    let mut parameters = parameters_in(route.path);
    let (needs, sentence, header) = shown(route.needs.lease);
    parameters.extend(header);
    let mut parameters: Vec<_> = parameters.into_iter().map(RefOr::T).collect();
    parameters.append(operation.parameters.get_or_insert_default());
    if !sentence.is_empty() {
        let description = operation.description.take();
        let text = description.map_or_else(|| sentence.to_owned(), |text| format!("{text}\n\n{sentence}"));
        operation.description = Some(text);
    }
    let changes = route.method != Method::GET || documented.is_socket();
    let sends_json = match &operation.request_body {
        Some(RefOr::T(body)) => body.content.contains_key("application/json"),
        _ => false,
    };
    let answers = &mut operation.responses.responses;
    for (applies, statuses) in [(true, ANYWHERE), (changes, CHANGING), (sends_json, WITH_JSON)] {
        for &status in statuses.iter().filter(|_| applies) {
            answers.entry(status.to_string()).or_insert_with(|| refusal(status));
        }
    }
    let is_page = parameters.iter().any(|known| matches!(known, RefOr::T(known) if known.name == "cursor"));
    if let Some(RefOr::T(answer)) = answers.get_mut("200").filter(|_| is_page) {
        let link = "Path of the next page, `rel=\"next\"`, where there is one";
        add_header(answer, "Link", SchemaType::from_iter([Type::String, Type::Null]), link);
    }
    if !changes && !documented.sends_events() {
        let unchanged = ResponseBuilder::new()
            .description("The client has this already, as its `If-None-Match` says.")
            .build();
        answers.insert("304".to_owned(), RefOr::T(unchanged));
        if let Some(RefOr::T(answer)) = answers.get_mut("200") {
            add_header(answer, "ETag", Type::String, "Names this content; larger documents have none");
        }
        let known = ParameterBuilder::new()
            .name("If-None-Match")
            .parameter_in(ParameterIn::Header)
            .required(Required::False)
            .description(Some("The `ETag` of an answer that the client has kept."))
            .schema(Some(ObjectBuilder::new().schema_type(Type::String)))
            .build();
        parameters.push(RefOr::T(known));
    }
    operation.parameters = Some(parameters).filter(|parameters| !parameters.is_empty());
    let sample = |(step, &Example { curl, status, .. }): (usize, &Example)| json!({ "lang": "shell", "label": format!("curl, {status}"), "source": curl, "status": status, "step": step });
    let samples: Vec<_> = examples::of(&route.method, route.path).map(sample).collect();
    let mut extensions = ExtensionsBuilder::new().add("x-palpate-needs", needs);
    if let Some(role) = route.needs.role {
        extensions =
            extensions.add("x-palpate-role", role.name()).add("x-palpate-scope", route.needs.scope.name());
        for status in [401, 403] {
            operation.responses.responses.entry(status.to_string()).or_insert_with(|| refusal(status));
        }
    }
    operation.security = Some(security_of(route.needs));
    if !samples.is_empty() {
        extensions = extensions.add("x-codeSamples", samples);
    }
    operation.extensions = Some(extensions.build());
    operation
}

/// Says that `answer` has a header.
fn add_header(answer: &mut Answer, name: &str, form: impl Into<SchemaType>, description: &str) {
    let mut header = Header::new(ObjectBuilder::new().schema_type(form));
    header.description = Some(description.to_owned());
    answer.headers.insert(name.to_owned(), RefOr::T(header));
}

/// The parameters in the braces of a path.
fn parameters_in(path: &str) -> Vec<Parameter> {
    let names = path.split('/').filter_map(|part| part.strip_prefix('{')?.strip_suffix('}'));
    let parameter = |name: &str| {
        let description = match name {
            "file" => "Name of the file, e.g. `report.json` of a job.".to_owned(),
            "doc" => "Name of the document, e.g. `learning`.".to_owned(),
            "picture" => "Name of the picture, e.g. `hand.png`.".to_owned(),
            "trial" => "Number of the trial, from 1.".to_owned(),
            "person" => "Name of the person.".to_owned(),
            "token" => "Number of the token.".to_owned(),
            "take" => "Id of a take, e.g. `take-03`.".to_owned(),
            "run" => "Id of the job, e.g. `run-1` or `diagnosis-1`.".to_owned(),
            "job" => "Id of the job, e.g. `emulation-1`.".to_owned(),
            name => format!("Id of the {name}."),
        };
        ParameterBuilder::new()
            .name(name)
            .parameter_in(ParameterIn::Path)
            .required(Required::True)
            .description(Some(description))
            .schema(Some(ObjectBuilder::new().schema_type(Type::String)))
            .build()
    };
    names.map(parameter).collect()
}

/// Problem details of the kinds that have `status`.
fn described(status: u16) -> Answer {
    let kinds = ProblemType::ALL.iter().filter(|kind| kind.status() == status);
    let lines: Vec<String> = kinds.map(|kind| format!("- `{}`: {}", kind.uri(), kind.meaning())).collect();
    let mut answer = ResponseBuilder::new()
        .description(lines.join("\n"))
        .content("application/problem+json", Content::new(Some(ProblemDetails::schema_ref())))
        .build();
    if status == 503 {
        add_header(&mut answer, "Retry-After", Type::Integer, "Seconds after which to try again");
    }
    answer
}

trait SchemaRef {
    fn schema_ref() -> RefOr<Schema>;
}

impl<T: ToSchema> SchemaRef for T {
    fn schema_ref() -> RefOr<Schema> {
        RefOr::Ref(Ref::from_schema_name(T::name()))
    }
}

fn http_method(method: &Method) -> HttpMethod {
    match *method {
        Method::PUT => HttpMethod::Put,
        Method::POST => HttpMethod::Post,
        Method::DELETE => HttpMethod::Delete,
        Method::PATCH => HttpMethod::Patch,
        _ => HttpMethod::Get,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::routes::{all_routes, openapi_document};

    /// Every operation with its method and path.
    fn operations(document: &Value) -> Vec<(String, &Value)> {
        let paths = document["paths"].as_object().unwrap().iter();
        let operations = paths.flat_map(|(path, item)| {
            let operations = item.as_object().unwrap().iter();
            operations
                .map(move |(method, operation)| (format!("{} {path}", method.to_uppercase()), operation))
        });
        operations.collect()
    }

    #[test]
    fn table_and_handlers_agree() {
        for route in all_routes(true) {
            let documented = route.documented.as_ref().unwrap();
            assert_eq!(documented.disagreement(&route.method, route.path), None);
        }
    }

    #[test]
    fn every_route_is_an_operation_of_its_own_with_what_it_needs() {
        let document = openapi_document();
        let operations = operations(&document);
        assert_eq!(operations.len(), all_routes(true).len());
        let ids: BTreeSet<&str> =
            operations.iter().map(|(_, operation)| operation["operationId"].as_str().unwrap()).collect();
        assert_eq!(ids.len(), operations.len(), "{ids:?}");
        for (name, operation) in &operations {
            assert!(operation["x-palpate-needs"].is_string(), "{name}");
            assert!(!operation["summary"].as_str().unwrap_or("").is_empty(), "{name}");
            for (status, answer) in operation["responses"].as_object().unwrap() {
                let said = answer["description"].as_str().or(answer["$ref"].as_str()).unwrap_or("");
                assert!(!said.is_empty(), "{name} {status}");
            }
        }
        let needs = |name: &str| {
            let (_, operation) = operations.iter().find(|(found, _)| found == name).unwrap();
            operation["x-palpate-needs"].as_str().unwrap().to_owned()
        };
        assert_eq!((needs("GET /info"), needs("POST /recording")), ("nothing".into(), "operator".into()));
    }

    #[test]
    fn every_reference_leads_somewhere() {
        fn references<'a>(value: &'a Value, found: &mut Vec<&'a str>) {
            match value {
                Value::Object(fields) => {
                    found.extend(fields.get("$ref").and_then(Value::as_str));
                    fields.values().for_each(|value| references(value, found));
                }
                Value::Array(items) => items.iter().for_each(|value| references(value, found)),
                _ => {}
            }
        }
        let document = openapi_document();
        let mut found = Vec::new();
        references(&document, &mut found);
        assert!(found.len() > 100, "{}", found.len());
        for reference in found {
            let pointer = reference.strip_prefix('#').unwrap();
            assert!(document.pointer(pointer).is_some(), "{reference}");
        }
    }

    #[test]
    fn every_operation_but_sockets_has_an_example_with_a_status_that_it_documents() {
        for route in all_routes(true) {
            let examples: Vec<_> = examples::of(&route.method, route.path).collect();
            let documented = route.documented.as_ref().unwrap();
            let is_socket = documented.is_socket();
            assert_eq!(examples.is_empty(), is_socket, "{} {}", route.method, route.path);
            let operation = operation_of(&route, documented);
            for (_, example) in examples {
                let status = example.status.to_string();
                assert!(operation.responses.responses.contains_key(&status), "{example:?}");
                let curl = example.curl;
                assert!(curl.starts_with("curl ") && curl.contains("$PALPATE_URL/api/v1/"), "{curl}");
            }
        }
    }

    #[test]
    fn problem_types_are_all_in_the_document() {
        let document = openapi_document().to_string();
        for kind in ProblemType::ALL {
            assert!(document.contains(kind.uri()), "{kind:?}");
        }
    }
}

//! The door of the service: every request of every route and socket passes it.
//!
//! A page of another origin must not act in the name of whoever looks at it. So the server answers only under host names
//! that it is known by, which defeats rebinding of other names to its address; and upgrades and requests that change
//! something must come from a page of its own, if they come from a page at all. The door also finds out who asks; whether
//! they may is said by each route.

use std::sync::Arc;

use axum::{
    extract::{Request, State},
    http::{HeaderMap, HeaderValue, Method, StatusCode, header, uri::Authority},
    middleware::Next,
    response::Response,
};

use palpate_people::{People, Principal};

use super::{
    docs, foxglove,
    identity::{self, Client, Shown},
    problem::{Detail, problem_response, respond},
};
use crate::AppState;

/// What the page may load and do. It is one WebAssembly program with its own files; nothing may frame it.
const PAGE_POLICY: &str = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; \
    img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' ws: wss:; worker-src 'self' blob:; \
    frame-ancestors 'none'; base-uri 'none'; form-action 'none'";
/// What documents of the API may: reports are self-contained pages with styles and pictures of their own, without scripts.
const API_POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'; \
    base-uri 'none'; form-action 'none'";

/// What the page of the API's document may: run its one script, which styles itself, and ask this server.
const DOCS_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'unsafe-inline'; img-src 'self' data:; \
    connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'";

/// Who may come in.
#[derive(Clone, Debug, Default)]
pub(crate) struct Door {
    /// Who the people are, where everybody has to log in.
    pub(crate) people: Option<Arc<People>>,
    /// A proxy on the way says where requests come from.
    pub(crate) behind_proxy: bool,
    /// Names by which the server is known, besides `localhost` and addresses.
    pub(crate) hosts: Vec<String>,
    /// Origins of other pages that may watch over Foxglove's protocol.
    pub(crate) foxglove_origins: Vec<String>,
    /// The path of the data folder, which messages to clients do not show.
    pub(crate) data: String,
}

impl Door {
    pub(crate) fn new(state: &AppState) -> Self {
        let access = state.access();
        Self {
            people: access.login.then(|| state.people().clone()),
            behind_proxy: access.behind_proxy,
            hosts: access.hosts.clone(),
            foxglove_origins: access.foxglove_origins.clone(),
            data: state.data().to_string_lossy().into_owned(),
        }
    }

    /// Why a request of `path` with these headers is refused, if it is.
    fn objection(&self, method: &Method, path: &str, headers: &HeaderMap) -> Option<(StatusCode, String)> {
        let Some(host) = single(headers, header::HOST).and_then(|host| host.parse::<Authority>().ok()) else {
            return Some((StatusCode::BAD_REQUEST, "the request names no host, or several".to_owned()));
        };
        if !self.is_known(host.host()) {
            return Some((
                StatusCode::MISDIRECTED_REQUEST,
                format!(
                    "this studio is not known as {:?}; open it by its address, or start it with --allow-host {}",
                    host.host(),
                    host.host()
                ),
            ));
        }
        let changes_something = !matches!(*method, Method::GET | Method::HEAD | Method::OPTIONS)
            || headers.contains_key(header::UPGRADE);
        if !changes_something {
            return None;
        }
        let is_foreign = match headers.get_all(header::ORIGIN).iter().count() {
            0 => is_cross_site(headers),
            1 => !single(headers, header::ORIGIN).is_some_and(|origin| {
                is_own(origin, &host) || (path == foxglove::PATH && self.may_watch(origin))
            }),
            _ => true,
        };
        is_foreign.then(|| {
            let detail = match single(headers, header::ORIGIN).filter(|_| path == foxglove::PATH) {
                Some(origin) => format!(
                    "pages of {origin:?} may not watch here; to let them, start the studio with --foxglove-origin {origin}"
                ),
                None => "a page of another origin may neither command nor change anything here; open the studio's own page"
                    .to_owned(),
            };
            (StatusCode::FORBIDDEN, detail)
        })
    }

    /// Whether pages of `origin` may watch over Foxglove's protocol, which commands nothing.
    fn may_watch(&self, origin: &str) -> bool {
        self.foxglove_origins.iter().any(|allowed| allowed.eq_ignore_ascii_case(origin))
    }

    /// Whether the server is known by `host`. Addresses cannot be rebound to another server, so all of them are.
    fn is_known(&self, host: &str) -> bool {
        let name = host.strip_suffix('.').unwrap_or(host);
        let address = name.strip_prefix('[').and_then(|name| name.strip_suffix(']')).unwrap_or(name);
        address.parse::<std::net::IpAddr>().is_ok()
            || name.eq_ignore_ascii_case("localhost")
            || self.hosts.iter().any(|known| known.eq_ignore_ascii_case(name))
    }
}

/// The only value of a header.
fn single(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    let mut values = headers.get_all(name).iter();
    let value = values.next()?.to_str().ok()?;
    values.next().is_none().then_some(value)
}

/// Whether `origin` is the server's own, as the client calls it. The scheme is not compared: it may be that of a proxy.
fn is_own(origin: &str, host: &Authority) -> bool {
    let Some((scheme, authority)) = origin.split_once("://") else { return false };
    let default_port = match scheme {
        "http" => 80,
        "https" => 443,
        _ => return false,
    };
    let port = |authority: &Authority| authority.port_u16().unwrap_or(default_port);
    authority.parse::<Authority>().is_ok_and(|authority| {
        authority.host().eq_ignore_ascii_case(host.host()) && port(&authority) == port(host)
    })
}

/// Whether a browser says that another site caused the request.
fn is_cross_site(headers: &HeaderMap) -> bool {
    headers.get("sec-fetch-site").is_some_and(|site| !matches!(site.as_bytes(), b"same-origin" | b"none"))
}

/// Lets a request in, or refuses it; what goes out carries the policy for browsers and no path of this computer.
pub(crate) async fn guard(State(door): State<Arc<Door>>, mut request: Request, next: Next) -> Response {
    let client = Client::of(&request, door.behind_proxy);
    let shown = match &door.people {
        Some(people) => identity::identify(people, request.headers(), foxglove::query_token(request.uri())),
        None => Ok(Principal::local()),
    };
    request.extensions_mut().insert(client);
    request.extensions_mut().insert(Shown(shown));
    let policy = match request.uri().path() {
        docs::PAGE_PATH => DOCS_POLICY,
        path if path.starts_with("/api/") => API_POLICY,
        _ => PAGE_POLICY,
    };
    let mut response = match door.objection(request.method(), request.uri().path(), request.headers()) {
        Some((status, detail)) => {
            tracing::warn!(method = %request.method(), path = request.uri().path(), detail, "refused at the door");
            problem_response(status, &detail)
        }
        None => next.run(request).await,
    };
    if let Some(Detail { kind, text }) = response.extensions_mut().remove::<Detail>()
        && !door.data.is_empty()
        && text.contains(&door.data)
    {
        let shown = text.replace(&format!("{}/", door.data), "").replace(&door.data, "the data folder");
        let headers = response.headers().clone();
        response = respond(response.status(), kind, &shown);
        for (name, value) in &headers {
            if name != header::CONTENT_LENGTH {
                response.headers_mut().insert(name.clone(), value.clone());
            }
        }
    }
    let headers = response.headers_mut();
    let own_policy = headers.contains_key(header::CONTENT_SECURITY_POLICY);
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, policy),
        (header::X_FRAME_OPTIONS, "DENY"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        (header::HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    ] {
        // Documents with a form have policies of their own.
        if !(own_policy && matches!(name, header::CONTENT_SECURITY_POLICY | header::REFERRER_POLICY)) {
            headers.insert(name, HeaderValue::from_static(value));
        }
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    fn objection(method: &Method, headers: &[(&'static str, &str)]) -> Option<StatusCode> {
        objection_at("/api/v1/stream", method, headers)
    }

    fn objection_at(path: &str, method: &Method, headers: &[(&'static str, &str)]) -> Option<StatusCode> {
        let door = Door {
            hosts: vec!["palpate.lab.example".to_owned()],
            foxglove_origins: vec!["https://viewer.example".to_owned()],
            ..Door::default()
        };
        let headers: HeaderMap = headers
            .iter()
            .map(|(name, value)| (header::HeaderName::from_static(name), value.parse().unwrap()))
            .collect();
        door.objection(method, path, &headers).map(|(status, _)| status)
    }

    #[test]
    fn named_origins_may_watch_over_foxgloves_protocol_and_nothing_else() {
        let from = |path: &str, method: &Method, origin: &str| {
            let headers = [("host", "127.0.0.1:8080"), ("upgrade", "websocket"), ("origin", origin)];
            objection_at(path, method, &headers)
        };
        assert_eq!(from("/api/v1/foxglove", &Method::GET, "https://viewer.example"), None);
        for origin in ["https://evil.example", "http://viewer.example", "https://viewer.example:8443", "null"]
        {
            assert_eq!(
                from("/api/v1/foxglove", &Method::GET, origin),
                Some(StatusCode::FORBIDDEN),
                "{origin}"
            );
        }
        for path in ["/api/v1/stream", "/api/v1/control", "/api/v1/foxglove/", "/foxglove"] {
            assert_eq!(
                from(path, &Method::GET, "https://viewer.example"),
                Some(StatusCode::FORBIDDEN),
                "{path}"
            );
        }
    }

    #[test]
    fn only_known_hosts_are_answered() {
        for host in
            ["localhost:8080", "127.0.0.1:1", "[::1]:8080", "10.0.0.7", "LOCALHOST", "palpate.lab.example."]
        {
            assert_eq!(objection(&Method::GET, &[("host", host)]), None, "{host}");
        }
        for host in
            ["evil.example", "localhost.evil.example", "127.0.0.1.evil.example:80", "1", "lab.example"]
        {
            let status = objection(&Method::GET, &[("host", host)]);
            assert_eq!(status, Some(StatusCode::MISDIRECTED_REQUEST), "{host}");
        }
        assert_eq!(objection(&Method::GET, &[]), Some(StatusCode::BAD_REQUEST));
        let twice = [("host", "localhost"), ("host", "evil.example")];
        assert_eq!(objection(&Method::GET, &twice), Some(StatusCode::BAD_REQUEST));
    }

    #[test]
    fn what_changes_something_comes_from_the_own_page_or_from_no_page() {
        let own = ("host", "127.0.0.1:8080");
        let post = |more: &[(&'static str, &str)]| objection(&Method::POST, &[&[own], more].concat());
        assert_eq!(post(&[]), None, "scripts send no origin");
        assert_eq!(post(&[("origin", "http://127.0.0.1:8080")]), None);
        assert_eq!(post(&[("origin", "https://127.0.0.1:8080")]), None, "behind a proxy");
        assert_eq!(post(&[("sec-fetch-site", "same-origin")]), None);
        for origin in [
            "null",
            "http://127.0.0.1:8081",
            "http://127.0.0.1",
            "http://evil.example:8080",
            "file://",
            "127.0.0.1:8080",
        ] {
            assert_eq!(post(&[("origin", origin)]), Some(StatusCode::FORBIDDEN), "{origin}");
        }
        let two = [("origin", "http://127.0.0.1:8080"), ("origin", "http://evil.example")];
        assert_eq!(post(&two), Some(StatusCode::FORBIDDEN));
        for site in ["cross-site", "same-site"] {
            assert_eq!(post(&[("sec-fetch-site", site)]), Some(StatusCode::FORBIDDEN), "{site}");
        }
        let get = |more: &[(&'static str, &str)]| objection(&Method::GET, &[&[own], more].concat());
        let foreign = ("origin", "http://evil.example");
        assert_eq!(get(&[foreign]), None, "a browser lets no other page read the answer");
        assert_eq!(get(&[foreign, ("upgrade", "websocket")]), Some(StatusCode::FORBIDDEN));
        assert_eq!(objection(&Method::GET, &[("host", "localhost"), ("origin", "http://localhost")]), None);
    }
}
